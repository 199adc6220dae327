# SPDX-License-Identifier: Apache-2.0
"""Where nothing is known to do, an arm holds its weight and comes to rest."""

from __future__ import annotations

import numpy as np
import pytest
from trials import scene_of

from impact_rs_control.controller import fallback_command
from impact_rs_control.fallback import FRESH, SETTLE, SHARE, holding_torque
from impact_rs_control.qp import QpStatus

SCENE = scene_of("push", "juice", "case_1")
MODEL = SCENE.models["arm"]
MOTORS = SCENE.physics.arms["arm"].motor_inertia_reduced
REST = 0.5 * (MODEL.position_min + MODEL.position_max)


def test_an_arm_at_rest_is_held_against_gravity() -> None:
    np.testing.assert_allclose(holding_torque(MODEL, MOTORS, REST, np.zeros(7)), MODEL.gravity_torque(REST))


def test_velocities_decay_with_the_time_constant() -> None:
    velocity, position, step = np.full(7, 0.01), REST.copy(), 1e-3
    for _ in range(round(SETTLE / step)):
        terms = MODEL.terms(position, velocity)
        torque = holding_torque(MODEL, MOTORS, position, velocity)
        velocity = velocity + step * np.linalg.solve(terms.mass_matrix + np.diag(MOTORS), torque - terms.bias)
        position = position + step * velocity
    np.testing.assert_allclose(velocity, 0.01 / np.e, rtol=0.05)


def test_the_brake_torque_is_bounded_whatever_the_velocity() -> None:
    weight = MODEL.gravity_torque(REST)
    for speed in (10.0, 1e3, 1e9):
        brake = holding_torque(MODEL, MOTORS, REST, np.full(7, speed)) - weight
        assert np.all(np.abs(brake) <= SHARE * MODEL.torque_max * (1.0 + 1e-12))
        assert np.any(np.abs(brake) >= SHARE * MODEL.torque_max * (1.0 - 1e-9))
    assert np.all(np.abs(holding_torque(MODEL, MOTORS, REST, np.full(7, 1e9))) <= MODEL.torque_max)


def test_the_brake_never_drives_the_arm() -> None:
    """Power -s dq^T M dq / T. Cut off joint by joint, as a torque limit does, the same brake drives some motions."""
    rng = np.random.default_rng(2)
    powers, cut = [], []
    for _ in range(300):
        position = rng.uniform(MODEL.position_min, MODEL.position_max)
        velocity = rng.standard_normal(7) * 10.0 ** rng.uniform(-1.0, 3.0)
        brake = -MODEL.mass_matrix(position) @ velocity / SETTLE
        cut.append(velocity @ np.clip(brake, -0.1 * MODEL.torque_max, 0.1 * MODEL.torque_max))
        held = holding_torque(MODEL, MOTORS, position, velocity) - MODEL.gravity_torque(position)
        powers.append(velocity @ held)
    assert max(powers) < 0.0 < max(cut)


@pytest.mark.parametrize(
    ("delay", "oscillates", "diverges"), [(FRESH, False, False), (0.1, True, False), (0.2, True, True)]
)
def test_a_brake_on_old_states_oscillates_then_diverges(delay: float, oscillates: bool, diverges: bool) -> None:
    """dq' = -dq(t - d) / T (Hayes 1950): no sign change for d <= T / e = 0.037 s, stable for d < pi T / 2 = 0.157 s."""
    step, duration = 1e-3, 3.0
    back = round(delay / step)
    velocity = [0.1] * (back + 1)
    for _ in range(round(duration / step)):
        velocity.append(velocity[-1] - step * velocity[-1 - back] / SETTLE)
    after = np.array(velocity)
    assert bool(np.any(after < 0.0)) is oscillates
    assert bool(np.abs(after[-500:]).max() > 0.1) is diverges


@pytest.mark.parametrize("tasks", [6, 7])
def test_as_a_command_it_says_that_there_was_no_answer(tasks: int) -> None:
    command = fallback_command(MODEL, MOTORS, REST, np.full(7, 0.1), tasks)
    assert command.qp_status is QpStatus.FAILED
    assert command.task_feedback.shape == (tasks,)
    np.testing.assert_allclose(command.twist, MODEL.jacobian(REST) @ np.full(7, 0.1))
