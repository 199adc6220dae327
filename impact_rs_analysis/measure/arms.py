# SPDX-License-Identifier: Apache-2.0
"""Facts about the arms of measurements, for all reports."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import Field

from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics, assumed_words
from impact_rs_sim.robots.robot import RobotFacts, load_facts
from impact_rs_sim.schema import Schema, omitted


class ArmDocument(Schema):
    """One arm."""

    name: str = Field(description="name in the scenario")
    robot: str = Field(description="name in config/robots, or else the source of its facts")
    joints: int = Field(description="number of joints")
    torque_loop: bool = Field(description="whether the joints have torque sensors and a torque loop")
    motor_inertia_rotor_kg_m2: tuple[float, ...] = Field(description="B_rho by joint [kg m^2]")
    motor_inertia_reduced_kg_m2: tuple[float, ...] = Field(description="reflected at the links, B_theta [kg m^2]")
    torque_limits_Nm: tuple[float, ...] = Field(description="torque limits by joint [N m]")
    assumed: tuple[str, ...] = omitted((), description="assumed quantities, neither measured nor published")

    @property
    def title(self) -> str:
        """Name and robot."""
        return f"{self.name}: {self.robot}, {self.joints} joints"


def robot_name(facts: RobotFacts) -> str:
    """Name of a robot in ``config/robots``, or else the source of its facts."""
    for file in sorted((config_directory() / "robots").glob("*.yaml")):
        if load_facts(file.stem) == facts:
            return file.stem
    return facts.source


def arms_of(physics_list: Iterable[Physics]) -> tuple[ArmDocument, ...]:
    """The distinct arms of several scenarios, in order of appearance."""
    documents: dict[ArmDocument, None] = {}
    names: dict[RobotFacts, str] = {}
    for physics in physics_list:
        for name, arm in physics.arms.items():
            if arm.facts not in names:
                names[arm.facts] = robot_name(arm.facts)
            document = ArmDocument(
                name=name,
                robot=names[arm.facts],
                joints=arm.facts.joint_count,
                torque_loop=arm.facts.joint_torque_loop,
                motor_inertia_rotor_kg_m2=tuple(arm.motor_inertia_rotor.tolist()),
                motor_inertia_reduced_kg_m2=tuple(arm.motor_inertia_reduced.tolist()),
                torque_limits_Nm=arm.facts.limits.torque_Nm,
                assumed=arm.assumed,
            )
            documents.setdefault(document)
    return tuple(documents)


def arm_titles(arms: Iterable[ArmDocument], name: str = "") -> str:
    """Titles of the arms with a name, several if scenarios have different arms of it; without a name of all arms."""
    return ", ".join(dict.fromkeys(arm.title for arm in arms if name in ("", arm.name)))


def assumptions(arms: Iterable[ArmDocument]) -> list[str]:
    """Assumptions about arms, as a list with one sentence; empty without assumptions."""
    by_arm: dict[str, tuple[str, ...]] = {}
    for arm in arms:  # an arm has one document per scenario
        by_arm[arm.name] = tuple(dict.fromkeys((*by_arm.get(arm.name, ()), *arm.assumed)))
    return [*filter(None, [assumed_words(by_arm)])]
