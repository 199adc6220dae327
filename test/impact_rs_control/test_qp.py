# SPDX-License-Identifier: Apache-2.0
"""The QP obeys its limits, and says so when it cannot."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_control.qp import AccelerationProblem, AccelerationQp, JointLimits, QpStatus

COUNT, PERIOD = 7, 1e-3
POSITION, SPEED, TORQUE = np.full(COUNT, 2.5), np.full(COUNT, 2.0), np.array([87.0] * 4 + [12.0] * 3)


def make_qp():
    return AccelerationQp(JointLimits(-POSITION, POSITION, SPEED, TORQUE), PERIOD)


def problem(**values):
    """Decoupled unit joints at rest that want nothing, but for the values given."""
    still = {name: np.zeros(COUNT) for name in ("targets", "bias", "position", "velocity")}
    return AccelerationProblem(
        **{"tasks": np.eye(COUNT), "weights": np.ones(COUNT), "inertia": np.eye(COUNT), **still, **values}
    )


def random_problem(seed, target_scale=5.0, **values):
    rng = np.random.default_rng(seed)
    tasks = rng.standard_normal((COUNT, COUNT))
    root = rng.standard_normal((COUNT, COUNT))
    inertia = root @ root.T / COUNT + 0.3 * np.eye(COUNT)
    targets = target_scale * rng.standard_normal(COUNT)
    return problem(tasks=tasks, targets=targets, inertia=inertia, bias=rng.standard_normal(COUNT), **values)


@given(st.integers(0, 10_000))
def test_without_active_limits_the_tasks_are_met_exactly(seed):
    asked = random_problem(seed, target_scale=1e-3)
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    condition = np.linalg.cond(asked.tasks)
    np.testing.assert_allclose(asked.tasks @ solution.acceleration, asked.targets, atol=1e-6 * condition)


@given(st.integers(0, 10_000))
def test_torque_limits_hold_whatever_the_tasks_want(seed):
    asked = random_problem(seed, target_scale=1e3)
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    assert np.all(np.abs(asked.inertia @ solution.acceleration + asked.bias) <= TORQUE + 1e-6)


@given(st.integers(0, 10_000))
def test_the_program_is_the_weighted_least_squares_problem_of_the_paper(seed):
    """Paper eq. QP_ante: 1/2 x^T H x + g^T x is half of ||A x - b||^2_W, a constant and the regularisation aside."""
    rng = np.random.default_rng(seed)
    asked = random_problem(seed, weights=rng.uniform(0.1, 10.0, COUNT))
    program = make_qp().program(asked)

    def cost(x):
        return x @ program.hessian @ x / 2.0 + program.gradient @ x

    def paper(x):
        error = asked.tasks @ x - asked.targets
        return error @ (asked.weights * error) / 2.0

    x, y = rng.standard_normal((2, COUNT))
    assert cost(x) - cost(y) == pytest.approx(paper(x) - paper(y), rel=1e-6, abs=1e-6)


def test_velocity_limit_is_not_crossed_in_the_next_step():
    """Paper eq. const_dq."""
    asked = problem(targets=np.full(COUNT, 50.0), inertia=0.1 * np.eye(COUNT), velocity=np.full(COUNT, 1.999))
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    assert np.all(asked.velocity + PERIOD * solution.acceleration <= SPEED + 1e-9)


def test_position_limit_is_not_crossed_in_the_next_step():
    """Paper eq. const_q."""
    asked = problem(targets=np.full(COUNT, 50.0), inertia=1e-3 * np.eye(COUNT), position=POSITION - 1e-6)
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    assert np.all(asked.position + 0.5 * PERIOD**2 * solution.acceleration <= POSITION + 1e-9)


@pytest.mark.parametrize("overshoot", [1e-4, 0.1])
def test_contradicting_limits_are_relaxed_and_reported_never_nan(overshoot):
    """Beyond the joint stop at speed: position, velocity and torque limits cannot all hold."""
    qp = make_qp()
    asked = random_problem(1, position=POSITION + overshoot, velocity=np.full(COUNT, 1.5))
    solution = qp.solve(asked)
    assert solution.status is QpStatus.RELAXED
    assert np.isfinite(solution.acceleration).all()
    assert solution.acceleration.mean() < 0.0  # it brakes

    still = np.zeros(COUNT)
    healthy = qp.solve(replace(asked, targets=1e-3 * asked.targets, position=still, velocity=still))
    assert healthy.status is QpStatus.SOLVED


def test_a_problem_with_nan_gets_a_finite_answer_marked_failed():
    solution = make_qp().solve(problem(targets=np.full(COUNT, np.nan)))
    assert solution.status is QpStatus.FAILED
    np.testing.assert_array_equal(solution.acceleration, np.zeros(COUNT))


def test_limits_that_overflow_have_no_answer():
    """Neither bounds nor slack hold 1e200 rad; the minimiser without bounds would ignore them all."""
    solution = make_qp().solve(random_problem(1, position=np.full(COUNT, 1e200)))
    assert solution.status is QpStatus.FAILED
    np.testing.assert_array_equal(solution.acceleration, 0.0)


def test_singular_tasks_still_have_an_answer():
    tasks = np.zeros((COUNT, COUNT))
    tasks[0, 0] = 1.0
    solution = make_qp().solve(problem(tasks=tasks, targets=np.ones(COUNT)))
    assert solution.status is QpStatus.SOLVED
    np.testing.assert_allclose(solution.acceleration, [1.0] + [0.0] * 6, atol=1e-6)


def test_warm_start_does_not_change_the_answer():
    warm = make_qp()
    for seed in range(20):
        asked = random_problem(seed, target_scale=100.0)
        cold = make_qp().solve(asked)
        np.testing.assert_allclose(warm.solve(asked).acceleration, cold.acceleration, atol=1e-5)


@pytest.mark.parametrize("name", ["targets", "position", "velocity", "bias", "inertia"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_none_have_no_answer_and_cost_no_time(name, value):
    broken = problem()
    broken = replace(broken, **{name: np.array(getattr(broken, name))})
    getattr(broken, name).flat[3] = value
    solution = make_qp().solve(broken)
    assert solution.status is QpStatus.FAILED
    np.testing.assert_array_equal(solution.acceleration, 0.0)
    assert solution.solve_time < 0.1


def test_a_state_beyond_all_bounds_is_given_up_soon():
    solution = make_qp().solve(problem(position=np.full(COUNT, 1e4), velocity=np.full(COUNT, 1e5)))
    assert solution.status is not QpStatus.SOLVED
    assert np.isfinite(solution.acceleration).all()
    assert solution.solve_time < 1.0
