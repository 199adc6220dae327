# SPDX-License-Identifier: Apache-2.0
"""Where nothing is known to do, an arm holds its weight and comes to rest."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_control.fallback import SETTLE, fallback_command, holding_torque
from impact_rs_control.qp import QpStatus
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene

SCENE = Scene.resolve(load_scenario("push"), "juice", "case_1")
MODEL = SCENE.models["arm"]
REST = 0.5 * (MODEL.position_min + MODEL.position_max)


def test_an_arm_at_rest_is_held_against_gravity() -> None:
    np.testing.assert_allclose(holding_torque(MODEL, REST, np.zeros(7)), MODEL.gravity_torque(REST))


def test_velocities_decay_with_the_time_constant() -> None:
    velocity, position, step = np.full(7, 0.01), REST.copy(), 1e-3
    for _ in range(round(SETTLE / step)):
        terms = MODEL.terms(position, velocity)
        torque = holding_torque(MODEL, position, velocity)
        velocity = velocity + step * np.linalg.solve(terms.mass_matrix, torque - terms.bias)
        position = position + step * velocity
    np.testing.assert_allclose(velocity, 0.01 / np.e, rtol=0.05)


def test_the_torque_stays_within_the_limits() -> None:
    torque = holding_torque(MODEL, REST, np.full(7, 100.0))
    assert np.all(np.abs(torque) <= MODEL.torque_max)
    assert np.any(np.abs(torque) == MODEL.torque_max)


@pytest.mark.parametrize("tasks", [6, 7])
def test_as_a_command_it_says_that_there_was_no_answer(tasks: int) -> None:
    command = fallback_command(MODEL, REST, np.full(7, 0.1), tasks)
    assert command.qp_status is QpStatus.FAILED
    assert command.task_feedback.shape == (tasks,)
    np.testing.assert_allclose(command.twist, MODEL.jacobian(REST) @ np.full(7, 0.1))
