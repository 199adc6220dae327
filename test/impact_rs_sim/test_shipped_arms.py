# SPDX-License-Identifier: Apache-2.0
"""Shipped robot facts: where the flange is, against figures that their makers publish, and how much they weigh."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.robot import EndEffector, load_facts
from impact_rs_sim.robot_model import RobotModel

NO_TOOL = EndEffector(1e-6, np.zeros(3), 1e-9 * np.eye(3), 0.0, 0.0, (0.01, 0.01, 0.001))


def flange_of(name: str, joints: list[float]) -> np.ndarray:
    """Origin of the flange in the base [m]."""
    model = RobotModel(load_facts(name), NO_TOOL, pin.SE3.Identity())
    return np.asarray(model.placement(np.array(joints)).translation)


@pytest.mark.parametrize(
    ("name", "joints", "place"),
    [
        ("kuka_lwr4plus", [0.0] * 7, [0.0, 0.0, 0.3105 + 0.4 + 0.39 + 0.078]),  # stretched out
        ("kuka_lwr4plus", [0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0], [0.4 + 0.39 + 0.078, 0.0, 0.3105]),
        ("xarm6", [0.0] * 6, [0.207, 0.0, 0.112]),  # as its controller shows it
        ("xarm7", [0.0] * 7, [0.206, 0.0, 0.1205]),
    ],
)
def test_the_flange_is_where_the_maker_says(name: str, joints: list[float], place: list[float]) -> None:
    assert flange_of(name, joints) == pytest.approx(place, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "lightest", "whole"), [("kuka_lwr4plus", 11.0, 16.0), ("xarm6", 9.0, 12.2), ("xarm7", 10.0, 13.7)]
)
def test_moving_links_weigh_most_of_the_arm(name: str, lightest: float, whole: float) -> None:
    assert lightest < sum(link.mass for link in load_facts(name).links) < whole


def test_what_is_guessed_is_said() -> None:
    assert any("guessed" in text for text in load_facts("kuka_lwr4plus").assumed)
    assert load_facts("xarm7").assumed == () and not load_facts("xarm7").joint_torque_loop
