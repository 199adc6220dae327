"""The QP obeys its limits, and says so when it cannot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_control.qp import AccelerationQp, QpStatus

COUNT, PERIOD = 7, 1e-3
POSITION, SPEED, TORQUE = np.full(COUNT, 2.5), np.full(COUNT, 2.0), np.array([87.0] * 4 + [12.0] * 3)


def make_qp():
    return AccelerationQp(COUNT, -POSITION, POSITION, SPEED, TORQUE, PERIOD)


def random_problem(seed, target_scale=5.0):
    rng = np.random.default_rng(seed)
    tasks = rng.standard_normal((COUNT, COUNT))
    root = rng.standard_normal((COUNT, COUNT))
    inertia = root @ root.T / COUNT + 0.3 * np.eye(COUNT)
    return tasks, target_scale * rng.standard_normal(COUNT), np.ones(COUNT), inertia, rng.standard_normal(COUNT)


@given(st.integers(0, 10_000))
def test_without_active_limits_the_tasks_are_met_exactly(seed):
    tasks, targets, weights, inertia, bias = random_problem(seed, target_scale=1e-3)
    solution = make_qp().solve(tasks, targets, weights, inertia, bias, np.zeros(COUNT), np.zeros(COUNT))
    assert solution.status is QpStatus.SOLVED
    condition = np.linalg.cond(tasks)
    np.testing.assert_allclose(tasks @ solution.acceleration, targets, atol=1e-6 * condition)


@given(st.integers(0, 10_000))
def test_torque_limits_hold_whatever_the_tasks_want(seed):
    tasks, targets, weights, inertia, bias = random_problem(seed, target_scale=1e3)
    solution = make_qp().solve(tasks, targets, weights, inertia, bias, np.zeros(COUNT), np.zeros(COUNT))
    assert solution.status is QpStatus.SOLVED
    assert np.all(np.abs(inertia @ solution.acceleration + bias) <= TORQUE + 1e-6)


def test_velocity_limit_is_not_crossed_in_the_next_step():
    """Paper eq. const_dq."""
    qp = make_qp()
    velocity = np.full(COUNT, 1.999)
    solution = qp.solve(
        np.eye(COUNT),
        np.full(COUNT, 50.0),
        np.ones(COUNT),
        0.1 * np.eye(COUNT),
        np.zeros(COUNT),
        np.zeros(COUNT),
        velocity,
    )
    assert solution.status is QpStatus.SOLVED
    assert np.all(velocity + PERIOD * solution.acceleration <= SPEED + 1e-9)


def test_position_limit_is_not_crossed_in_the_next_step():
    """Paper eq. const_q."""
    position = POSITION - 1e-6
    solution = make_qp().solve(
        np.eye(COUNT),
        np.full(COUNT, 50.0),
        np.ones(COUNT),
        1e-3 * np.eye(COUNT),
        np.zeros(COUNT),
        position,
        np.zeros(COUNT),
    )
    assert solution.status is QpStatus.SOLVED
    assert np.all(position + 0.5 * PERIOD**2 * solution.acceleration <= POSITION + 1e-9)


@pytest.mark.parametrize("overshoot", [1e-4, 0.1])
def test_contradicting_limits_are_relaxed_and_reported_never_nan(overshoot):
    """Beyond the joint stop at speed: position, velocity and torque limits cannot all hold."""
    position, velocity = POSITION + overshoot, np.full(COUNT, 1.5)
    qp = make_qp()
    tasks, targets, weights, inertia, bias = random_problem(1)
    solution = qp.solve(tasks, targets, weights, inertia, bias, position, velocity)
    assert solution.status is QpStatus.RELAXED
    assert np.isfinite(solution.acceleration).all()
    assert solution.acceleration.mean() < 0.0  # it brakes

    healthy = qp.solve(tasks, 1e-3 * targets, weights, inertia, bias, np.zeros(COUNT), np.zeros(COUNT))
    assert healthy.status is QpStatus.SOLVED


def test_singular_tasks_still_have_an_answer():
    tasks = np.zeros((COUNT, COUNT))
    tasks[0, 0] = 1.0
    solution = make_qp().solve(
        tasks, np.ones(COUNT), np.ones(COUNT), np.eye(COUNT), np.zeros(COUNT), np.zeros(COUNT), np.zeros(COUNT)
    )
    assert solution.status is QpStatus.SOLVED
    np.testing.assert_allclose(solution.acceleration, [1.0] + [0.0] * 6, atol=1e-6)


def test_warm_start_does_not_change_the_answer():
    warm = make_qp()
    for seed in range(20):
        problem = random_problem(seed, target_scale=100.0)
        still = np.zeros(COUNT)
        cold = make_qp().solve(*problem, still, still)
        np.testing.assert_allclose(warm.solve(*problem, still, still).acceleration, cold.acceleration, atol=1e-5)
