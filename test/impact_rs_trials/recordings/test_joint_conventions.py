# SPDX-License-Identifier: Apache-2.0
"""Joints that count in another direction or from another zero are named, with a remedy that leaves no warning."""

from __future__ import annotations

import re

import numpy as np
import pytest
from joint_recordings import swinging

from impact_rs_sim.robots.robot import Array, load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.joint_checks import arm_warnings
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.runs import ArmSignals

TIME = np.arange(0.0, 20.0, 0.005)  # s
FRICTION = 0.5  # N m
RATES = (
    np.array([0.11, 0.13, 0.17, 0.19, 0.23, 0.29, 0.31]),
    np.array([0.53, 0.59, 0.61, 0.67, 0.71, 0.73, 0.79]),
)  # Hz
CENTRES = {
    "ur5e": (0.0, -1.2, 1.0, -1.0, -1.5, 0.3),
    "kinova_gen3": (0.0, 0.5, 0.0, 1.6, 0.0, 0.8, 0.0),
    "xarm6": (0.0, -0.5, -0.7, 0.0, 0.6, 0.0),
}  # rad


def recorded(robot: str) -> tuple[Mapping, RobotModel, ArmSignals]:
    """An arm that swings against friction, in the convention of its model."""
    shipped, centre = load_mapping("joint_state"), np.array(CENTRES[robot])
    size = centre.size
    mapping = shipped.model_copy(update={"robot": robot, "joints": shipped.joints[:size]})
    model = RobotModel(load_facts(robot), mapping.end_effector.build())
    columns = swinging(model, TIME, centre, (RATES[0][:size], RATES[1][:size]), (0.4, 0.05))
    torque = columns["effort"] + FRICTION * np.tanh(columns["velocity"] / 0.01)
    return mapping, model, ArmSignals(columns["position"], columns["velocity"], torque)


def in_convention(arm: ArmSignals, direction: Array, zero: Array) -> ArmSignals:
    """The same motion, recorded in another convention."""
    return ArmSignals(direction * (arm.position - zero), direction * arm.velocity, direction * arm.torque)


def remedied(arm: ArmSignals, warning: str) -> ArmSignals:
    """The recording with the factors and offsets that a warning proposes."""

    def values(key: str, default: float) -> Array:
        listed = re.search(rf"signals\.{key}: \[([^\]]*)\]", warning)
        return np.array([float(number) for number in listed[1].split(",")]) if listed else np.array(default)

    return ArmSignals(
        values("position.factor", 1.0) * arm.position + values("position.offset", 0.0),
        values("velocity.factor", 1.0) * arm.velocity,
        values("torque.factor", 1.0) * arm.torque,
    )


@pytest.mark.parametrize(
    "robot", ["kinova_gen3", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ur5e", "xarm6"))]
)
def test_a_joint_in_another_convention_is_named_with_a_remedy_that_leaves_no_warning(robot: str) -> None:
    """Several conventions may describe one arm, so that torques decide. Kills: one of the keys."""
    mapping, model, arm = recorded(robot)
    rng, warned = np.random.default_rng(3), 0
    for _ in range(6):
        direction = np.where(rng.random(arm.position.shape[1]) < 0.35, -1.0, 1.0)
        zero = 0.5 * np.pi * rng.integers(0, 4, direction.size) * (rng.random(direction.size) < 0.2)
        other = in_convention(arm, direction, zero)
        for warning in arm_warnings(TIME, other, mapping, model):
            if "torques belong to joints with other" in warning:
                assert arm_warnings(TIME, remedied(other, warning), mapping, model) == []
                warned += 1
    assert warned >= 4  # the others turn light joints, or all


@pytest.mark.parametrize("robot", CENTRES)
@pytest.mark.parametrize("scale", [1.0, 1.15])
def test_a_recording_in_the_convention_of_the_model_is_not_suspected(robot: str, scale: float) -> None:
    """Also with torques that are 15 % too large. Kills: any gain of a mirrored light joint is a finding."""
    mapping, model, arm = recorded(robot)
    louder = ArmSignals(arm.position, arm.velocity, scale * arm.torque)
    assert not any("directions" in one or "zeros" in one for one in arm_warnings(TIME, louder, mapping, model))


def test_a_torque_of_the_wrong_sign_keeps_its_own_remedy() -> None:
    """Kills: a mirrored joint in place of a negative factor of its torque."""
    mapping, model, arm = recorded("ur5e")
    sign = np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    (warning,) = arm_warnings(TIME, ArmSignals(arm.position, arm.velocity, sign * arm.torque), mapping, model)
    assert "signals.torque.factor: [1, 1, -1, 1, 1, 1]" in warning


def test_the_remedy_is_in_the_units_of_the_mapping_and_keeps_its_factors() -> None:
    """Degrees, and an offset: q = s (f q_file + o) + z. Kills: a mirrored joint keeps its offset."""
    mapping, model, arm = recorded("ur5e")
    position = mapping.signals["position"].model_copy(update={"unit": ("deg",) * 6, "factor": 2.0, "offset": 10.0})
    signals = mapping.signals | {"position": position}
    mirrored = in_convention(arm, np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]), np.zeros(6))
    (warning,) = arm_warnings(TIME, mirrored, mapping.model_copy(update={"signals": signals}), model)
    assert "signals.position.factor: [2, -2, 2, 2, 2, 2]" in warning
    assert "signals.position.offset: [10, -10, 10, 10, 10, 10]" in warning
    assert "signals.velocity.factor: [1, -1, 1, 1, 1, 1]" in warning
    assert "signals.torque.factor: [1, -1, 1, 1, 1, 1]" in warning
