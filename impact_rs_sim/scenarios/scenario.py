# SPDX-License-Identifier: Apache-2.0
"""A scenario: the scene, the motion of the robots, and the measurement.

It holds nominal values; estimated physics is in model files. An unknown name of an object, case or robot raises an
:class:`InputError` that lists the known ones.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from impact_rs_sim.errors import InputError, did_you_mean, shortened
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import STANDARD_GRAVITY
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scenarios.friction_compensation import FrictionCompensation
from impact_rs_sim.scenarios.object_spec import Contact, NeighbourSpec, ObjectSpec, Support, guided_object
from impact_rs_sim.scenarios.robot_spec import HandPose, Robot
from impact_rs_sim.scenarios.trial_settings import (
    Case,
    CaseRobot,
    Control,
    Excursion,
    Scatter,
    Sensors,
    Timing,
    Uncertainties,
)
from impact_rs_sim.schema import Name, NonNegative, PositiveVector, Schema, Vector3, omitted, validate

Item = TypeVar("Item")


class Scenario(Schema):
    """A whole experiment (``config/scenarios/*.yaml``)."""

    name: Name = Field(description="name of the scenario")
    description: str = Field(description="what happens, in a sentence")
    axis: Literal["x", "y", "z"] = Field(description="axis of the measure")
    object_position: tuple[float, float] | None = Field(
        None,
        description="middle of the object, x and y [m]; absent: at the only pad",
    )
    object_gap: NonNegative = Field(
        0.0, description="distance between pad and object at the impact pose [m]; 0: the pad hits"
    )
    excursion: Excursion | None = Field(None, description="a motion there and back without contact; absent: a hit")
    robots: dict[Name, Robot] = Field(min_length=1, description="arms by name")
    objects: dict[Name, ObjectSpec] = Field(min_length=1, description="objects by name")
    neighbours: dict[Name, NeighbourSpec] = omitted(
        {},
        description="further, tracked objects in a row, which the object hits, by name",
    )
    support: Support = Field(description="what the object lies on")
    contact: Contact = Field(description="contact between pad and object")
    cases: dict[Name, Case] = Field(min_length=1, description="cases by name")
    velocity_scales: PositiveVector = Field(description="post-impact references, as fractions of the prediction [-]")
    trials: Annotated[int, Field(ge=1)] = Field(description="repeats of every scale")
    timing: Timing = Field(description="times")
    control: Control = Field(description="controller")
    sensors: Sensors = Field(description="measurement")
    scatter: Scatter = Field(description="trial-to-trial scatter")
    gravity: Vector3 = omitted(
        STANDARD_GRAVITY,
        description="gravity; x and y components tilt the table [m/s^2]",
    )
    uncertainty: Uncertainties = omitted(
        Uncertainties(),
        description="assumed half widths of 95 % intervals, for `impact-rs map --uncertainty`",
    )
    friction_compensation: FrictionCompensation | None = omitted(
        None,
        description="file of `impact-rs friction identify`, a path from the scenario's folder",
    )

    @model_validator(mode="after")
    def _friction_compensation_fits(self) -> Self:
        if self.friction_compensation is not None:
            check_compensation(self.friction_compensation, self)
        return self

    @model_validator(mode="after")
    def _every_case_moves_every_robot(self) -> Self:
        for case_name, case in self.cases.items():
            if set(case.robots) != set(self.robots):
                raise ValueError(
                    f"cases.{case_name}.robots names {sorted(case.robots)}, expected {sorted(self.robots)}"
                )
            for name, robot in case.robots.items():
                count = self.robots[name].robot_facts.joint_count
                if missing := [joint + 1 for joint in robot.posture_joints if joint >= count]:
                    key_path = f"cases.{case_name}.robots.{name}.posture"
                    raise ValueError(f"{key_path} names joint_{missing[0]}, but the arm has {count} joints")
                if set(robot.hands) != set(self.robots[name].hands):
                    key_path = f"cases.{case_name}.robots.{name}.hands"
                    raise ValueError(
                        f"{key_path} names {sorted(robot.hands)}, expected a velocity of each hand of the robot [m/s]: "
                        f"{sorted(self.robots[name].hands)}"
                    )
        return self

    @model_validator(mode="after")
    def _bodies_with_names_of_their_own(self) -> Self:
        names = {"object", "support"}
        hands = {f"robots.{name}.hands": set(robot.hands) for name, robot in self.robots.items()}
        for key, bodies in {"robots": set(self.robots), "neighbours": set(self.neighbours), **hands}.items():
            if repeated := names & bodies:
                raise ValueError(f"{key}.{min(repeated)}: another body has this name; choose another one")
            names |= bodies
        return self

    @model_validator(mode="after")
    def _neighbours_of_a_free_object(self) -> Self:
        if not self.neighbours:
            return self
        if fixed := [name for name, spec in self.objects.items() if spec.fixed]:
            raise ValueError(f"objects.{fixed[0]} is fixed and hits no neighbour: leave neighbours out")
        if guided := [name for name, spec in self.objects.items() if spec.freedom is not None]:
            raise ValueError(f"objects.{guided[0]} is on a hinge or slide and hits no neighbour: leave neighbours out")
        return self

    @model_validator(mode="after")
    def _given_joints_say_where_everything_is(self) -> Self:
        for name, robot in self.robots.items():
            if robot.impact.joint_position is None:
                continue
            key = f"robots.{name}.impact.joint_position"
            if self.object_position is not None:
                raise ValueError(f"{key} says where the object stands, at the pad: leave object_position out [m]")
            for case_name, case in self.cases.items():
                if case.robots[name].posture_joints:
                    raise ValueError(
                        f"{key} holds every joint: leave joint_1 and posture out of cases.{case_name}.robots.{name}"
                    )
        return self

    @model_validator(mode="after")
    def _several_arms_need_an_object_between_them(self) -> Self:
        if len(self.robots) > 1 and self.object_position is None:
            raise ValueError("with several arms, object_position must say where the object stands [m]")
        for name, robot in self.robots.items():
            if robot.hands and robot.impact.joint_position is None and self.object_position is None:
                raise ValueError(f"object_position: missing; it says where the hands of {name} meet the object [m]")
        return self

    @model_validator(mode="after")
    def _excursion_fits(self) -> Self:
        if self.excursion is None:
            return self
        if self.object_gap <= 0.0:
            raise ValueError("an excursion is a motion without contact: object_gap must be > 0 [m]")
        if self.excursion.start == self.excursion.end:
            raise ValueError("excursion.end must differ from start [m]: the motion has the speed of ante_velocity")
        for name, case in self.cases.items():
            for arm, robot in case.robots.items():
                if not any(robot.ante_velocity):
                    raise ValueError(
                        f"cases.{name}.robots.{arm}.ante_velocity is 0: expected the excursion's peak speed, > 0 [m/s]"
                    )
                if self.excursion.joint_1 != 0.0 and 0 not in robot.posture_joints:
                    raise ValueError(f"excursion.joint_1 moves joint 1, which cases.{name} does not hold: give joint_1")
                end = self.excursion_end(robot)
                if end > self.timing.duration:
                    raise ValueError(
                        f"cases.{name}: there and back at this speed ends at {end:.2f} s, after timing.duration [s]"
                    )
        return self

    def impact_placement(self, robot: str, object_name: str, hand: str = "") -> pin.SE3:
        """Placement of frame E of an arm, or of its ``hand``, in the inertial frame when its pad touches an object."""
        pose = self.robots[robot].hands[hand].impact if hand else self.robots[robot]
        assert pose is not None  # a hand without pose has given joints, and is not asked for
        placement = pose.placement if isinstance(pose, HandPose) else pose.impact_placement
        if self.object_position is not None:
            normal = placement.rotation[:, 2]
            centre = np.append(self.object_position, placement.translation[2])
            depth = self.object(object_name).reach(-normal) + self.object_gap
            placement.translation += normal * ((centre - placement.translation) @ normal - depth)
        return placement

    def neighbour_shifts(self, object_name: str) -> list[Array]:
        """Centres of the neighbours at rest from the centre of an object, in A, ``(3,)`` each [m]."""
        down, previous = np.array([0.0, 0.0, -1.0]), self.object(object_name)
        position, height, shifts = np.zeros(3), previous.reach(down), []
        for neighbour in self.neighbours.values():
            along = np.append(neighbour.direction, 0.0)
            position = position + along * (previous.reach(along) + neighbour.gap + neighbour.reach(-along))
            shifts.append(position + [0.0, 0.0, neighbour.reach(down) - height])
            previous = neighbour
        return shifts

    def excursion_leg(self, robot: CaseRobot) -> float:
        """Duration of one leg of the excursion [s]; a quintic from rest to rest peaks at 15/8 of its mean speed."""
        assert self.excursion is not None
        distance = np.linalg.norm(np.array(self.excursion.end) - np.array(self.excursion.start))
        return float(15.0 / 8.0 * distance / np.linalg.norm(robot.ante_velocity))

    def excursion_end(self, robot: CaseRobot) -> float:
        """End of the excursion [s]."""
        assert self.excursion is not None
        return self.excursion.begin + 2.0 * self.excursion_leg(robot) + self.excursion.rest

    def with_settings(self, settings: Mapping[str, Any]) -> Scenario:
        """The scenario with other values.

        Args:
            settings: Values by dotted key, as in ``control.clamp_force``; lists and mappings as in YAML.
        """
        if not settings:
            return self
        settings_data = self.model_dump(mode="json")
        for key, value in settings.items():
            section: Any = settings_data
            *parents, last = key.split(".")
            for part in parents:
                section = section.setdefault(part, {})
                if not isinstance(section, dict):
                    raise InputError(f"{part!r} is a value and has no keys of its own", key=key)
            section[last] = value
        return validate(Scenario, settings_data, f"scenario {self.name!r}")

    @property
    def digest(self) -> str:
        """Digest of the motion of the arms, without names, number of trials and velocity scales."""
        excluded: dict[str, Any] = dict.fromkeys(
            ("name", "description", "velocity_scales", "trials", "friction_compensation", "uncertainty"), True
        )
        excluded["robots"] = {"__all__": {"drive": {"assumed"}}}
        return hashlib.sha256(self.model_dump_json(exclude=excluded).encode()).hexdigest()[:16]

    @property
    def axis_index(self) -> int:
        """0, 1 or 2 for x, y, z."""
        return AXES.index(self.axis)

    def check_chains(self, consumer: str) -> None:
        """Refuse trees, and objects on hinges and slides, because ``consumer`` takes serial arms and other objects.

        Raises:
            InputError: A robot is a tree, or its base floats; or an object has a hinge or a slide.
        """
        for name, robot in self.robots.items():
            robot.robot_facts.check_chain(consumer, f"robots.{name}", self.name)
        for name, spec in self.objects.items():
            if spec.freedom is not None:
                raise guided_object(consumer, f"objects.{name}", self.name)

    def object(self, name: str) -> ObjectSpec:
        """The object ``name``."""
        return _choose("object", name, self.objects, self.name)

    def case(self, name: str) -> Case:
        """The case ``name``; ``1`` is short for ``case_1``."""
        return self.cases[self.case_name(name)]

    def case_name(self, name: str) -> str:
        """Full name of the case ``name``; ``1`` is short for ``case_1``."""
        full = f"case_{name}" if f"case_{name}" in self.cases else name
        _choose("case", full, self.cases, self.name)
        return full


def _choose(kind: str, name: str, table: dict[str, Item], scenario: str) -> Item:
    if name not in table:
        names = ", ".join(table)
        suggestion = did_you_mean(name, table)
        raise InputError(f"scenario {scenario!r} has no {kind} {shortened(name)!r}; it has: {names}{suggestion}")
    return table[name]


def check_compensation(compensation: FrictionCompensation, scenario: Scenario) -> None:
    """Refuse a friction compensation that does not fit the scenario (:meth:`FrictionCompensation.check`)."""
    cases = {name: set(case.robots) for name, case in scenario.cases.items()}
    sets = dict.fromkeys(scenario.objects, cases)
    compensation.check(scenario.name, scenario.digest, sets, scenario.timing.duration)
