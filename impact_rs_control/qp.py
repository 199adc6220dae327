# SPDX-License-Identifier: Apache-2.0
"""The controller's quadratic program, by ProxQP.

    min_ddq  ||A ddq - b||^2_W                                              (paper eq. QP_ante)
    s.t.     lower <= ddq <= upper                                          (paper eqs. const_q, const_dq)
             -tau_max <= (M + B_theta) ddq + h <= tau_max                   (paper eq. const_tau)

Far from every limit the unconstrained minimiser is the solution. It is computed first, by Cholesky, and ProxQP is
called only if it violates a limit. When the limits contradict each other, for instance beyond a joint stop at full
speed, the program is solved again with a slack on every constraint, and the status is RELAXED. A program with a number
that is not finite, or whose relaxed solution is not, is FAILED: the acceleration is then zero and means nothing, and
the controller brakes instead (:func:`impact_rs_control.fallback.holding_torque`).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from proxsuite import proxqp

from impact_rs_sim import _kernel
from impact_rs_sim.robots.robot import Array

SLACK_WEIGHT = 1e6  # cost of a squared violation, relative to that of a squared task error
QP_ACCURACY = 1e-9  # ProxQP's eps_abs, absolute tolerance of its residuals
MAX_RELAXED_ITERATIONS = 50  # of the program with slack; in fast motion at most 25 were observed


class QpStatus(IntEnum):
    """How the program was solved; values as in ``ControllerState.qp_status``."""

    SOLVED = 0
    RELAXED = 1
    FAILED = 2


@dataclass(frozen=True, slots=True)
class AccelerationProblem:
    """Inputs of one control tick: k tasks of n joints, and the state from which the limits follow.

    Attributes:
        tasks: A, ``(k, n)``.
        targets: b, ``(k,)``, in the units of the tasks.
        weights: Diagonal of W, ``(k,)``.
        inertia: M + B_theta, ``(n, n)`` [kg m^2].
        bias: h, ``(n,)`` [N m].
        position: q, ``(n,)`` [rad].
        velocity: dq, ``(n,)`` [rad/s].
    """

    tasks: Array
    targets: Array
    weights: Array
    inertia: Array
    bias: Array
    position: Array
    velocity: Array


@dataclass(frozen=True, slots=True)
class QuadraticProgram:
    """``min 1/2 x^T H x + g^T x`` with ``lower <= x <= upper`` and ``torque_lower <= C x <= torque_upper``.

    Attributes:
        hessian: H, ``(n, n)``.
        gradient: g, ``(n,)``.
        lower: ``(n,)`` [rad/s^2].
        upper: ``(n,)`` [rad/s^2].
        inertia: C = M + B_theta, ``(n, n)`` [kg m^2].
        torque_lower: ``(n,)`` [N m].
        torque_upper: ``(n,)`` [N m].
    """

    hessian: Array
    gradient: Array
    lower: Array
    upper: Array
    inertia: Array
    torque_lower: Array
    torque_upper: Array

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite; after an invalid measurement they may not be."""
        parts = (
            self.hessian,
            self.gradient,
            self.lower,
            self.upper,
            self.inertia,
            self.torque_lower,
            self.torque_upper,
        )
        return all(np.isfinite(part).all() for part in parts)


@dataclass(frozen=True)
class QpSolution:
    """Answer of one solve.

    Attributes:
        acceleration: Joint acceleration, ``(n,)`` [rad/s^2]; finite, and zero where the status is FAILED.
        status: How it was found.
        iterations: ProxQP iterations; 0 where no limit was near.
        solve_time: Wall-clock time [s].
    """

    acceleration: Array
    status: QpStatus
    iterations: int
    solve_time: float


@dataclass(frozen=True)
class JointLimits:
    """Limits of the joints of an arm.

    Attributes:
        position_min: Lower joint limits, ``(n,)`` [rad].
        position_max: Upper joint limits, ``(n,)`` [rad].
        velocity_max: Joint velocity limits, ``(n,)`` [rad/s].
        torque_max: Joint torque limits, ``(n,)`` [N m].
    """

    position_min: Array
    position_max: Array
    velocity_max: Array
    torque_max: Array


class AccelerationQp:
    """QP over joint accelerations with warm start.

    Args:
        limits: Limits of the n joints.
        period: Control period Delta t [s].
        regularisation: Added to the diagonal of the Hessian; keeps a singular pose solvable.
    """

    def __init__(self, limits: JointLimits, period: float, regularisation: float = 1e-9) -> None:
        self.limits = limits
        self.period = period
        self._count = joint_count = limits.torque_max.size
        self._program = _kernel.Program(
            limits.position_min, limits.position_max, limits.velocity_max, limits.torque_max, period, regularisation
        )
        self._qp = proxqp.dense.QP(joint_count, 0, joint_count, True)
        self._qp.settings.eps_abs = QP_ACCURACY
        self._qp.settings.max_iter = 200
        self._qp.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._qp.settings.compute_timings = False
        self._ready = False
        self._torque_max = limits.torque_max

    def program(self, problem: AccelerationProblem) -> QuadraticProgram:
        """The quadratic program of a problem."""
        self._set(problem)
        return QuadraticProgram(*self._program.parts())

    def solve(self, problem: AccelerationProblem) -> QpSolution:
        """Solve for one tick; the status says whether constraints had to be relaxed."""
        started = time.perf_counter()
        self._set(problem)
        free = self._program.free()
        if free is not None:
            return QpSolution(free, QpStatus.SOLVED, 0, time.perf_counter() - started)
        program = QuadraticProgram(*self._program.parts())
        if not program.is_finite:  # ProxQP would iterate for many seconds
            return QpSolution(np.zeros(self._count), QpStatus.FAILED, 0, time.perf_counter() - started)
        if (program.lower <= program.upper).all():
            answer, iterations, solved = self._solve_exactly(program)
            if solved:
                return QpSolution(answer, QpStatus.SOLVED, iterations, time.perf_counter() - started)
        self._ready = False  # do not warm-start from a failed solve
        answer, iterations, status = self._solve_relaxed(program)
        return QpSolution(answer, status, iterations, time.perf_counter() - started)

    def _set(self, problem: AccelerationProblem) -> None:
        p = problem
        self._program.set(p.tasks, p.targets, p.weights, p.inertia, p.bias, p.position, p.velocity)

    def _solve_exactly(self, program: QuadraticProgram) -> tuple[Array, int, bool]:
        """Acceleration, iterations, and whether the solver converged."""
        p, qp = program, self._qp
        matrices = (p.hessian, p.gradient, None, None, p.inertia, p.torque_lower, p.torque_upper, p.lower, p.upper)
        if self._ready:
            qp.update(*matrices)
        else:
            qp.init(*matrices)
            self._ready = True
        qp.solve()
        result = qp.results
        answer = result.x.copy()
        solved = result.info.status == proxqp.QPSolverOutput.PROXQP_SOLVED and math.isfinite(answer.sum())
        return answer, result.info.iter, solved

    def _solve_relaxed(self, program: QuadraticProgram) -> tuple[Array, int, QpStatus]:
        """Solve the program with a slack per constraint row; rows are scaled to be comparable."""
        count = self._count
        period = self.period
        middle = (program.lower + program.upper) / 2.0
        box_lower, box_upper = np.minimum(program.lower, middle), np.maximum(program.upper, middle)
        rows = np.vstack((np.eye(count) * period, program.inertia / self._torque_max[:, None]))
        row_lower = np.concatenate((box_lower * period, program.torque_lower / self._torque_max))
        row_upper = np.concatenate((box_upper * period, program.torque_upper / self._torque_max))
        qp = proxqp.dense.QP(3 * count, 0, 2 * count)
        qp.settings.eps_abs = 1e-7
        qp.settings.max_iter = qp.settings.max_iter_in = MAX_RELAXED_ITERATIONS
        cost = np.zeros((3 * count, 3 * count))
        cost[:count, :count] = program.hessian
        cost[count:, count:] = SLACK_WEIGHT * np.eye(2 * count)
        linear = np.concatenate((program.gradient, np.zeros(2 * count)))
        qp.init(cost, linear, None, None, np.hstack((rows, np.eye(2 * count))), row_lower, row_upper)
        qp.solve()
        acceleration, iterations = qp.results.x[:count], int(qp.results.info.iter)
        if not np.isfinite(acceleration).all():
            return np.zeros(count), iterations, QpStatus.FAILED
        return np.array(acceleration), iterations, QpStatus.RELAXED
