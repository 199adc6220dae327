# SPDX-License-Identifier: Apache-2.0
"""Sensors add what the scenario says, each its own: steps of the encoder, noise, a tracker that is a little off."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.scenario import Sensors
from impact_rs_sim.scene import ArmMotion
from impact_rs_sim.sensors import ArmSensors, ObjectTracker

SAMPLES, JOINTS = 4000, 3
NOISY = Sensors(
    joint_position_resolution=1e-3,
    joint_velocity_noise=0.02,
    joint_torque_noise=0.5,
    object_position_noise=1e-3,
    object_orientation_noise=0.01,
)
IDEAL = Sensors(**dict.fromkeys(set(Sensors.model_fields) - {"object_period"}, 0.0))
Q, DQ, TORQUE = np.array([0.30034, -1.2, 0.5]), np.array([0.1, 0.2, -0.3]), np.array([5.0, -10.0, 1.0])
THETA, DTHETA = Q + 0.01, DQ - 0.05
MOTION = ArmMotion(Q, DQ, TORQUE, THETA, DTHETA)
# Four standard deviations of a standard deviation estimated from all samples.
SHARE = 4.0 / np.sqrt(2.0 * SAMPLES * JOINTS)


@pytest.fixture(scope="module")
def errors() -> dict[str, np.ndarray]:
    """Measured less true, ``(SAMPLES, JOINTS)`` by signal."""
    sensors = ArmSensors(NOISY, JOINTS, SAMPLES, np.random.default_rng(1))
    measured = [sensors.measure(tick, MOTION) for tick in range(SAMPLES)]
    truth = {"position": Q, "velocity": DQ, "torque": TORQUE, "motor_position": THETA, "motor_velocity": DTHETA}
    return {name: np.array([getattr(each, name) for each in measured]) - value for name, value in truth.items()}


@pytest.mark.parametrize(("name", "noise"), [("velocity", 0.02), ("motor_velocity", 0.02), ("torque", 0.5)])
def test_noise_has_the_stated_size_and_no_bias(errors: dict[str, np.ndarray], name: str, noise: float) -> None:
    assert np.std(errors[name]) == pytest.approx(noise, rel=SHARE)
    assert np.abs(np.mean(errors[name])) < 4.0 * noise / np.sqrt(SAMPLES * JOINTS)


def test_noise_is_white_and_its_own_in_every_joint_and_signal(errors: dict[str, np.ndarray]) -> None:
    rows = np.hstack([errors[name] for name in ("velocity", "motor_velocity", "torque")])
    between = np.corrcoef(rows.T) - np.eye(rows.shape[1])
    in_time = [np.corrcoef(column[:-1], column[1:])[0, 1] for column in rows.T]
    assert np.abs(between).max() < 5.0 / np.sqrt(SAMPLES)
    assert np.abs(in_time).max() < 5.0 / np.sqrt(SAMPLES)


def test_an_encoder_gives_the_nearest_of_its_steps() -> None:
    sensors = ArmSensors(NOISY, JOINTS, 1, np.random.default_rng(0))
    for angle in (0.30034, 0.30066, -0.30034, -0.30066):
        q = np.full(JOINTS, angle)
        measured = sensors.measure(0, ArmMotion(q, DQ, TORQUE, -q, DTHETA))
        np.testing.assert_allclose(measured.position, np.round(angle, 3), atol=1e-12)
        np.testing.assert_allclose(measured.motor_position, np.round(-angle, 3), atol=1e-12)


def test_ideal_sensors_give_copies_of_the_truth() -> None:
    q = Q.copy()
    measured = ArmSensors(IDEAL, JOINTS, 1, np.random.default_rng(0)).measure(
        0, ArmMotion(q, DQ, TORQUE, THETA, DTHETA)
    )
    q += 1.0
    for value, truth in (
        (measured.position, Q),
        (measured.velocity, DQ),
        (measured.torque, TORQUE),
        (measured.motor_position, THETA),
        (measured.motor_velocity, DTHETA),
    ):
        np.testing.assert_array_equal(value, truth)


def test_the_same_tick_is_measured_the_same_twice() -> None:
    sensors = ArmSensors(NOISY, JOINTS, 5, np.random.default_rng(1))
    first, again, other = (sensors.measure(tick, MOTION) for tick in (2, 2, 3))
    np.testing.assert_array_equal(first.velocity, again.velocity)
    assert np.all(first.velocity != other.velocity)


def test_the_tracker_is_off_in_position_and_turn_by_what_the_scenario_says() -> None:
    tracker = ObjectTracker(NOISY, SAMPLES, np.random.default_rng(3))
    position, rotation = np.array([0.4, -0.1, 0.5]), pin.rpy.rpyToMatrix(0.3, -0.2, 1.0)
    shifts, turns = [], []
    for sample in range(SAMPLES):
        seen = tracker.measure(sample, 0.1 * sample, position, rotation)
        assert seen.time == 0.1 * sample
        shifts.append(seen.position - position)
        turns.append(pin.log3(rotation.T @ pin.Quaternion(seen.quaternion).matrix()))
    for values, noise in ((shifts, 1e-3), (turns, 0.01)):
        assert np.std(values) == pytest.approx(noise, rel=SHARE)
        assert np.abs(np.mean(values, axis=0)).max() < 4.0 * noise / np.sqrt(SAMPLES)


def test_an_ideal_tracker_tells_the_pose_as_x_y_z_w() -> None:
    seen = ObjectTracker(IDEAL, 1, np.random.default_rng(0)).measure(0, 0.0, Q, pin.rpy.rpyToMatrix(0.0, 0.0, 0.8))
    np.testing.assert_allclose(seen.quaternion, [0.0, 0.0, np.sin(0.4), np.cos(0.4)], atol=1e-12)
    np.testing.assert_array_equal(seen.position, Q)
