# SPDX-License-Identifier: Apache-2.0
"""What of a scenario may be unsure: another value reaches the robot, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from impact_table_cases import arm_table, write_csv

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.impact_table import read_impact_table
from impact_rs_trials.recordings.unsure_scene import known_of_scene, with_another

PUSH, GRAB = load_scenario("push"), load_scenario("grab")


def pad_at(scenario: object, joints: np.ndarray) -> np.ndarray:
    """Origin of frame E [m]."""
    physics = Physics.nominal(scenario, next(iter(scenario.objects)))  # type: ignore[attr-defined]
    return np.asarray(next(iter(physics.robot_models().values())).placement(joints).translation)


def test_an_offset_of_the_flange_moves_the_pad_by_as_much_and_one_of_the_first_joint_along_its_axes() -> None:
    joints = np.array(next(iter(PUSH.robots.values())).impact.joint_guess)
    before = pad_at(PUSH, joints)
    moved = pad_at(with_another(PUSH, "flange_x", 0.01), joints) - before
    assert np.linalg.norm(moved) == pytest.approx(0.01)
    base = next(iter(PUSH.robots.values())).base.placement.rotation
    assert pad_at(with_another(PUSH, "joint1_z", 0.02), joints) - before == pytest.approx(0.02 * base[:, 2])


def test_a_longer_tool_moves_the_pad_along_its_axis_and_a_heavier_one_keeps_its_radii() -> None:
    joints = np.array(next(iter(PUSH.robots.values())).impact.joint_guess)
    (robot,) = PUSH.robots.values()
    longer = with_another(PUSH, "tool_length", robot.end_effector.length + 0.05)
    assert np.linalg.norm(pad_at(longer, joints) - pad_at(PUSH, joints)) == pytest.approx(0.05)
    (heavy,) = with_another(PUSH, "tool_mass", 2.0 * robot.end_effector.mass).robots.values()
    assert heavy.end_effector.inertia == pytest.approx(2.0 * np.array(robot.end_effector.inertia))


def test_every_name_changes_what_it_says_and_nothing_else() -> None:
    for scenario in (PUSH, GRAB):
        for name, (value, unit) in known_of_scene(scenario).items():
            other = with_another(scenario, name, value + 0.003)
            changed = [
                own for own, (now, _) in known_of_scene(other).items() if now != known_of_scene(scenario)[own][0]
            ]
            assert changed == ([] if "joint" in name or "flange" in name else [name])
            assert other != scenario and unit in {"m", "kg", "-"}


def test_what_is_unknown_here_is_refused_with_what_is_known(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "pushes.csv", *arm_table({}, 1))
    with pytest.raises(InputError, match="did you mean 'tool_mass'"):
        read_impact_table(path, PUSH, unsure={"tol_mass": (0.1, 0.2)})
