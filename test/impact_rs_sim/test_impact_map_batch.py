# SPDX-License-Identifier: Apache-2.0
"""Answers to many questions at once are those to each of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impact_map_cases import grab, nominal

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ExactEngine
from impact_rs_sim.impact_map.batch import ImpactBatch, solve_batch
from impact_rs_sim.scene import ArmState

COUNT = 6


def batch_about(problem, rng: np.random.Generator) -> ImpactBatch:
    """Velocities, configurations, motor inertia, restitution and friction that differ."""
    arms = {
        name: ArmState(
            state.position + 1e-5 * rng.standard_normal((COUNT, state.position.size)),
            state.velocity + 0.01 * rng.standard_normal((COUNT, state.position.size)),
        )
        for name, state in problem.arms.items()
    }
    motors = {name: values * rng.uniform(0.5, 1.5, (COUNT, 1)) for name, values in problem.motor_inertia.items()}
    restitution, friction = rng.uniform(0.0, 0.3, COUNT), rng.uniform(0.1, 0.9, COUNT)
    return ImpactBatch(problem.physics, arms, problem.object, motors, restitution, pad_friction=friction)


@pytest.mark.parametrize("case", [nominal, grab])
def test_every_row_is_the_answer_to_its_question(case) -> None:
    problem = case()
    batch = batch_about(problem, np.random.default_rng(5))
    found = solve_batch(batch)
    assert not found.refused
    for number in range(COUNT):
        asked = batch.problem(number)
        answer = ExactEngine(asked.physics).solve(asked)
        for name in problem.arms:
            np.testing.assert_array_equal(found.joint_velocity[name][number], answer.joint_velocity[name])
            np.testing.assert_array_equal(found.end_effector_twist[name][number], answer.end_effector_twist[name])
        np.testing.assert_array_equal(found.object_twist[number], answer.object_twist)
        assert found.residual[number] == answer.residual.largest
        assert found.contacts[number] == len(answer.contacts)


def test_what_does_not_differ_is_given_once() -> None:
    problem = nominal()
    scales = np.array([0.5, 1.0, 2.0])
    motors = {"arm": problem.motor_inertia["arm"] * scales[:, None]}
    found = solve_batch(ImpactBatch(problem.physics, problem.arms, problem.object, motors))
    speed = found.end_effector_twist["arm"][:, 1]
    assert speed.shape == (3,)
    assert np.all(np.diff(np.abs(speed)) > 0.0)  # a heavier arm loses less
    alone = solve_batch(ImpactBatch(problem.physics, problem.arms, problem.object, problem.motor_inertia))
    np.testing.assert_array_equal(alone.object_twist[0], found.object_twist[1])


def test_a_question_without_an_answer_costs_the_others_nothing() -> None:
    problem = nominal()
    batch = batch_about(problem, np.random.default_rng(6))
    batch.arms["arm"].velocity[2] = np.nan
    batch.restitution[4] = 1.5
    found = solve_batch(batch)
    assert set(found.refused) == {2, 4}
    assert "arms.arm.velocity" in found.refused[2]
    assert "restitution" in found.refused[4]
    lost = np.isnan(found.object_twist).all(axis=1)
    np.testing.assert_array_equal(lost, [False, False, True, False, True, False])
    assert np.isnan(found.residual[2]) and found.contacts[2] == 0


@pytest.mark.parametrize("value", [-1e-3, np.nan, np.inf])
def test_a_motor_inertia_that_no_motor_has_is_refused(value: float) -> None:
    """A slightly negative one leaves M + B positive definite, so that only the check can notice."""
    batch = batch_about(nominal(), np.random.default_rng(8))
    batch.motor_inertia["arm"][3, 1] = value
    found = solve_batch(batch)
    assert set(found.refused) == {3}
    assert "motor_inertia.arm" in found.refused[3]
    assert np.isnan(found.object_twist[3]).all()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"restitution": np.zeros(4)}, "restitution"),
        ({"motor_inertia": {"arm": np.ones((6, 6))}}, r"motor_inertia\.arm"),
        ({"motor_inertia": {"other": np.ones(7)}}, "motor_inertia"),
    ],
)
def test_shapes_that_do_not_fit_are_told(changed, told: str) -> None:
    batch = replace(batch_about(nominal(), np.random.default_rng(7)), **changed)
    with pytest.raises(InputError, match=told):
        solve_batch(batch)
