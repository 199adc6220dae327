# SPDX-License-Identifier: Apache-2.0
"""Where nothing is known to do, an arm holds its weight; a motion that no robot makes is noticed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from trials import scene_of

from impact_rs_control.controller import fallback_command
from impact_rs_control.fallback import MAX_BRAKE_SHARE, MAX_STATE_AGE_S, SETTLING_TIME_S, holding_torque
from impact_rs_control.motion_monitor import FROZEN_TORQUE_RATIO, MAX_VELOCITY_LAG_S, WINDOW_S, MotionMonitor
from impact_rs_control.qp import QpStatus

# ---- fallback -------------------------------------------------------------------------------------------------------

SCENE = scene_of("push", "juice", "case_1")
MODEL = SCENE.models["arm"]
MOTORS = SCENE.physics.arms["arm"].motor_inertia_reduced
REST = 0.5 * (MODEL.position_min + MODEL.position_max)


def test_an_arm_at_rest_is_held_against_gravity() -> None:
    np.testing.assert_allclose(holding_torque(MODEL, MOTORS, REST, np.zeros(7)), MODEL.gravity_torque(REST))


def test_velocities_decay_with_the_time_constant() -> None:
    velocity, position, step = np.full(7, 0.01), REST.copy(), 1e-3
    for _ in range(round(SETTLING_TIME_S / step)):
        terms = MODEL.terms(position, velocity)
        torque = holding_torque(MODEL, MOTORS, position, velocity)
        velocity = velocity + step * np.linalg.solve(terms.mass_matrix + np.diag(MOTORS), torque - terms.bias)
        position = position + step * velocity
    np.testing.assert_allclose(velocity, 0.01 / np.e, rtol=0.05)


def test_the_brake_torque_is_bounded_whatever_the_velocity() -> None:
    weight = MODEL.gravity_torque(REST)
    for speed in (10.0, 1e3, 1e9):
        brake = holding_torque(MODEL, MOTORS, REST, np.full(7, speed)) - weight
        assert np.all(np.abs(brake) <= MAX_BRAKE_SHARE * MODEL.torque_max * (1.0 + 1e-12))
        assert np.any(np.abs(brake) >= MAX_BRAKE_SHARE * MODEL.torque_max * (1.0 - 1e-9))
    assert np.all(np.abs(holding_torque(MODEL, MOTORS, REST, np.full(7, 1e9))) <= MODEL.torque_max)


def test_the_brake_never_drives_the_arm() -> None:
    """Power -s dq^T M dq / T. Cut off joint by joint, as a torque limit does, the same brake drives some motions."""
    rng = np.random.default_rng(2)
    powers, cut = [], []
    for _ in range(300):
        position = rng.uniform(MODEL.position_min, MODEL.position_max)
        velocity = rng.standard_normal(7) * 10.0 ** rng.uniform(-1.0, 3.0)
        brake = -MODEL.mass_matrix(position) @ velocity / SETTLING_TIME_S
        cut.append(velocity @ np.clip(brake, -0.1 * MODEL.torque_max, 0.1 * MODEL.torque_max))
        held = holding_torque(MODEL, MOTORS, position, velocity) - MODEL.gravity_torque(position)
        powers.append(velocity @ held)
    assert max(powers) < 0.0 < max(cut)


@pytest.mark.parametrize(
    ("delay", "oscillates", "diverges"), [(MAX_STATE_AGE_S, False, False), (0.1, True, False), (0.2, True, True)]
)
def test_a_brake_on_old_states_oscillates_then_diverges(delay: float, oscillates: bool, diverges: bool) -> None:
    """dq' = -dq(t - d) / T (Hayes 1950): no sign change for d <= T / e = 0.037 s, stable for d < pi T / 2 = 0.157 s."""
    step, duration = 1e-3, 3.0
    back = round(delay / step)
    velocity = [0.1] * (back + 1)
    for _ in range(round(duration / step)):
        velocity.append(velocity[-1] - step * velocity[-1 - back] / SETTLING_TIME_S)
    after = np.array(velocity)
    assert bool(np.any(after < 0.0)) is oscillates
    assert bool(np.abs(after[-500:]).max() > 0.1) is diverges


@pytest.mark.parametrize("tasks", [6, 7])
def test_as_a_command_it_says_that_there_was_no_answer(tasks: int) -> None:
    command = fallback_command(MODEL, MOTORS, REST, np.full(7, 0.1), tasks)
    assert command.qp_status is QpStatus.FAILED
    assert command.task_feedback.shape == (tasks,)
    np.testing.assert_allclose(command.twist, MODEL.jacobian(REST) @ np.full(7, 0.1))


# ---- monitor of motions: jumps, stuck velocities, frozen encoders, and motions that are none of these ---------------

JOINTS = [f"arm_joint{number + 1}" for number in range(7)]
STEP = 0.001  # s
Signals = Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray | None]]


def first_complaint(signals: Signals, duration: float = 1.0) -> tuple[float, str]:
    """When and what; ``signals`` of time are position, velocity and commanded torque."""
    monitor = MotionMonitor(MODEL, JOINTS)
    for time in np.arange(0.0, duration, STEP):
        if complaint := monitor.complaint(float(time), *signals(float(time))):
            return float(time), complaint
    return np.inf, ""


def one(value: float, joint: int = 2) -> np.ndarray:
    values = np.zeros(7)
    values[joint] = value
    return values


def sine(time: float) -> tuple[np.ndarray, np.ndarray]:
    """All joints swing, at up to nine tenths of their velocity limits."""
    rate = 2.0 * np.pi * np.linspace(0.5, 3.0, 7)
    speed = 0.9 * MODEL.velocity_max
    return speed / rate * np.sin(rate * time), speed * np.cos(rate * time)


def test_a_fast_motion_with_noise_and_a_coarse_encoder_is_no_complaint() -> None:
    rng = np.random.default_rng(1)

    def signals(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        position, velocity = sine(time)
        return (
            np.round(position, 3),
            velocity + 0.02 * rng.standard_normal(7),
            0.3 * MODEL.torque_max * np.sin(9 * time),
        )

    assert first_complaint(signals) == (np.inf, "")


def test_the_filtered_velocity_jump_of_an_impact_is_no_complaint() -> None:
    """A filter with time constant T is behind by T times the jump: 0.6 LAG of a jump by the whole velocity limit."""

    def signals(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        since = max(0.0, time - 0.3)
        filtered = 0.5 - (1.0 - np.exp(-since / (0.6 * MAX_VELOCITY_LAG_S))) if since else 0.5
        travelled = 0.5 * min(time, 0.3) - 0.5 * since
        return travelled * MODEL.velocity_max, filtered * MODEL.velocity_max, 0.2 * MODEL.torque_max * np.sin(9 * time)

    assert first_complaint(signals, 0.7) == (np.inf, "")


def test_a_position_that_jumps_is_noticed_at_once() -> None:
    when, complaint = first_complaint(lambda time: (one(0.8 if time >= 0.3 else 0.0), np.zeros(7), None))
    assert when == pytest.approx(0.3)
    assert complaint.startswith("position of arm_joint3 changed by 0.8 rad more than its velocity says")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stuck_velocity_sensor_is_noticed_within_the_window(sign: float) -> None:
    """A still arm that reports half of its velocity limit: after LAG / 0.5."""
    speed = 0.5 * sign * MODEL.velocity_max[2]
    when, complaint = first_complaint(lambda time: (np.zeros(7), one(speed if time >= 0.3 else 0.0), None))
    assert when == pytest.approx(0.3 + MAX_VELOCITY_LAG_S / 0.5, abs=2.0 * STEP)
    assert "arm_joint3" in complaint


def test_a_frozen_position_is_noticed_by_the_velocity() -> None:
    def signals(time: float) -> tuple[np.ndarray, np.ndarray, None]:
        position, velocity = sine(time)
        position[4] = sine(min(time, 0.2))[0][4]
        return position, velocity, None

    when, complaint = first_complaint(signals)
    assert 0.2 < when < 0.3
    assert "arm_joint5" in complaint


@pytest.mark.parametrize("joints", [[3], list(range(7))])
def test_a_joint_that_reports_the_same_while_it_is_driven_is_frozen(joints: list[int]) -> None:
    def signals(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        position, velocity = sine(time)
        position[joints], velocity[joints] = 0.1, 0.0
        return position, velocity, 0.5 * MODEL.torque_max * np.sin(10.0 * time)

    when, complaint = first_complaint(signals)
    assert WINDOW_S <= when < WINDOW_S + 0.01
    assert complaint.startswith(f"arm_joint{joints[0] + 1} reports the same position and velocity for 0.1")


def test_a_joint_that_was_found_frozen_stays_so_until_its_signals_change() -> None:
    """Kills a check that forgets it once no controller drives the joint."""
    monitor, still, complaints = MotionMonitor(MODEL, JOINTS), np.zeros(7), []
    for time in np.arange(0.0, 0.5, STEP):
        torque = 0.5 * MODEL.torque_max * np.sin(10.0 * time) if time < 0.2 else None
        complaints.append(monitor.complaint(float(time), still + 1e-9 * (time >= 0.4), still, torque))
    assert all("a frozen sensor" in complaint for complaint in complaints[110:400])
    assert not any(complaints[:90] + complaints[401:])


@pytest.mark.parametrize(("speed", "frozen"), [(0.05, True), (-0.05, True), (0.015, False)])
def test_a_held_joint_that_reports_one_position_at_speed_is_frozen(speed: float, frozen: bool) -> None:
    when, complaint = first_complaint(lambda time: (np.zeros(7), one(speed), None))
    assert when == (pytest.approx(WINDOW_S) if frozen else np.inf)
    assert ("while its velocity is 0.05 rad/s: a frozen sensor" in complaint) is frozen


def test_a_resting_or_braked_joint_is_not_taken_as_frozen() -> None:
    steady = 0.9 * MODEL.torque_max
    assert first_complaint(lambda time: (np.zeros(7), np.zeros(7), steady)) == (np.inf, "")
    assert first_complaint(lambda time: (np.zeros(7), np.zeros(7), None)) == (np.inf, "")
    noise = np.random.default_rng(4)  # of the velocity, behind an encoder too coarse to show the motion
    driven = lambda time: 0.9 * MODEL.torque_max * np.sin(9.0 * time)  # noqa: E731
    assert first_complaint(lambda time: (np.zeros(7), 1e-3 * noise.standard_normal(7), driven(time))) == (np.inf, "")
    little = 0.4 * FROZEN_TORQUE_RATIO * MODEL.torque_max
    assert first_complaint(lambda time: (np.zeros(7), np.zeros(7), little * np.sin(50 * time))) == (np.inf, "")


def test_the_torque_that_a_controller_begins_with_is_no_change_of_torque() -> None:
    weight = 0.4 * MODEL.torque_max

    def signals(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        return np.zeros(7), np.zeros(7), weight if time > 0.3 else None

    assert first_complaint(signals) == (np.inf, "")


def test_torques_of_before_the_last_change_do_not_make_a_joint_frozen() -> None:
    def signals(time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        torque = 0.5 * MODEL.torque_max if time < 0.5 else np.zeros(7)
        return np.full(7, 1e-6 * min(time, 0.5)), np.full(7, 1e-6 if time < 0.5 else 0.0), torque

    assert first_complaint(signals) == (np.inf, "")


def test_states_are_usable_again_a_window_after_a_jump() -> None:
    monitor = MotionMonitor(MODEL, JOINTS)
    complaints = [
        bool(monitor.complaint(time, one(0.5 if time > 0.3 else 0.0), np.zeros(7), None))
        for time in np.arange(0.0, 0.6, STEP)
    ]
    assert complaints.index(True) in (300, 301)
    assert sum(complaints) == pytest.approx(WINDOW_S / STEP, abs=2)
    assert monitor.complaint(0.0, np.zeros(7), np.zeros(7), None) == ""
