# SPDX-License-Identifier: Apache-2.0
"""The paper's result tables, and which row a set of trials (one scenario, object and case) repeats.

A set is compared with a published row only if robot, object and ante-impact velocity are equal: a scenario with another
arm or a heavier box may still be called ``push``.
"""

from __future__ import annotations

from pydantic import Field, RootModel

from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import Schema, parse_yaml

PAPER_ROBOT = "franka_fer"  # paper sec. Experimental setup


class PaperRow(Schema):
    """One row of the paper's tables."""

    estimate: float = Field(description="experimental estimate of the post-impact speed [m/s]")
    reduced: float = Field(description="mismatch of the prediction with B_theta [%]")
    rotor: float = Field(description="mismatch of the prediction with B_rho [%]")
    zero: float = Field(description="mismatch of the prediction with B = 0 [%]")

    @property
    def errors(self) -> dict[str, float]:
        """Mismatch by motor-inertia model [%]."""
        return {"reduced": self.reduced, "rotor": self.rotor, "zero": self.zero}


class PaperTables(RootModel[dict[str, dict[str, dict[str, PaperRow]]]]):
    """``config/paper/tables.yaml``: rows by scenario, object and case."""


def paper_row(scenario: str, object_name: str, case: str) -> PaperRow | None:
    """Row of the paper by names; None if the paper has no such row."""
    path = config_directory() / "paper" / "tables.yaml"
    if not path.is_file():
        return None
    tables = PaperTables.model_validate(parse_yaml(path.read_text(encoding="utf-8"), path)).root
    return tables.get(scenario, {}).get(object_name, {}).get(case)


def published(scenario: Scenario, object_name: str, case: str) -> PaperRow | None:
    """Row of the paper with the robot, object and ante-impact velocity of a set; None if there is no such row.

    Args:
        scenario: The scenario as it was recorded.
        object_name: Name of the object.
        case: Full name of the case.
    """
    row = paper_row(scenario.name, object_name, case)
    if row is None:
        return None
    shipped, facts = load_scenario(scenario.name), load_facts(PAPER_ROBOT)
    same_conditions = (
        all(robot.robot_facts == facts for robot in scenario.robots.values())
        and _object(scenario, object_name) == _object(shipped, object_name)
        and _velocities(scenario, case) == _velocities(shipped, case)
    )
    return row if same_conditions else None


def _object(scenario: Scenario, name: str) -> dict[str, object]:
    """Physical properties of an object, without its name."""
    return scenario.object(name).model_dump(exclude={"label"})


def _velocities(scenario: Scenario, case: str) -> dict[str, object]:
    """Ante-impact velocity by arm [m/s]."""
    return {name: robot.ante_velocity for name, robot in scenario.case(case).robots.items()}
