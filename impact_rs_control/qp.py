"""The controller's quadratic program, by ProxQP.

    min_ddq  ||A ddq - b||^2_W                                              (paper eq. QP_ante)
    s.t.     lower <= ddq <= upper                                          (paper eqs. const_q, const_dq)
             -tau_max <= (M + B_theta) ddq + h <= tau_max                   (paper eq. const_tau)

Far from every limit the minimiser without constraints is the solution; it is tried first, by Cholesky, and ProxQP is
asked only where it would break a limit. When the limits contradict each other, for instance beyond a joint stop at full
speed, the program is solved once more with a slack on every constraint; the caller is told. There is never a NaN.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import scipy
from proxsuite import proxqp

from impact_rs_sim.robot import Array

SLACK_WEIGHT = 1e6  # cost of a squared violation against that of a squared task error
ACCURACY = 1e-9


class QpStatus(IntEnum):
    """How the program was solved; values as in ``ControllerState.qp_status``."""

    SOLVED = 0
    RELAXED = 1
    FAILED = 2


@dataclass(frozen=True)
class QpSolution:
    """Answer of one solve.

    Attributes:
        acceleration: Joint acceleration, ``(n,)`` [rad/s^2].
        status: How it was found.
        iterations: ProxQP iterations; 0 where no limit was near.
        solve_time: Wall-clock time [s].
    """

    acceleration: Array
    status: QpStatus
    iterations: int
    solve_time: float


class AccelerationQp:
    """QP over joint accelerations with warm start.

    Args:
        joint_count: Number of joints n.
        position_min: Lower joint limits, ``(n,)`` [rad].
        position_max: Upper joint limits, ``(n,)`` [rad].
        velocity_max: Joint velocity limits, ``(n,)`` [rad/s].
        torque_max: Joint torque limits, ``(n,)`` [N m].
        period: Control period Delta t [s].
        regularisation: Added to the diagonal of the Hessian; keeps a singular pose solvable.
    """

    def __init__(
        self,
        joint_count: int,
        position_min: Array,
        position_max: Array,
        velocity_max: Array,
        torque_max: Array,
        period: float,
        regularisation: float = 1e-9,
    ) -> None:
        self._count = joint_count
        self._position_min = position_min
        self._position_max = position_max
        self._velocity_max = velocity_max
        self._torque_max = torque_max
        self._period = period
        self._damping = regularisation * np.eye(joint_count)
        self._qp = proxqp.dense.QP(joint_count, 0, joint_count, True)
        self._qp.settings.eps_abs = ACCURACY
        self._qp.settings.max_iter = 200
        self._qp.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._qp.settings.compute_timings = False
        self._ready = False
        # Bounds of eqs. const_q and const_dq are linear in q and dq; their constants are worked out once.
        self._per_period = 1.0 / period
        self._per_square = 2.0 / period**2
        self._position_high = position_max * self._per_square
        self._position_low = position_min * self._per_square
        self._velocity_bound = velocity_max * self._per_period

    def solve(
        self, tasks: Array, targets: Array, weights: Array, inertia: Array, bias: Array, q: Array, dq: Array
    ) -> QpSolution:
        """Solve for one tick.

        Args:
            tasks: A, ``(k, n)``.
            targets: b, ``(k,)``.
            weights: Diagonal of W, ``(k,)``.
            inertia: M + B_theta, ``(n, n)`` [kg m^2].
            bias: h, ``(n,)`` [N m].
            q: Joint positions, ``(n,)`` [rad].
            dq: Joint velocities, ``(n,)`` [rad/s].
        """
        started = time.perf_counter()
        weighted = tasks.T * weights
        hessian = weighted @ tasks + self._damping
        gradient = -(weighted @ targets)
        lower, upper = self._acceleration_bounds(q, dq)
        torque_lower = -self._torque_max - bias
        torque_upper = self._torque_max - bias
        free, failed = scipy.linalg.lapack.dposv(hessian, -gradient)[1:]
        if not failed and self._within(free, lower, upper) and self._within(inertia @ free, torque_lower, torque_upper):
            return QpSolution(free, QpStatus.SOLVED, 0, time.perf_counter() - started)
        consistent = bool((lower <= upper).all())
        if consistent:
            qp = self._qp
            if self._ready:
                qp.update(hessian, gradient, None, None, inertia, torque_lower, torque_upper, lower, upper)
            else:
                qp.init(hessian, gradient, None, None, inertia, torque_lower, torque_upper, lower, upper)
                self._ready = True
            qp.solve()
            result = qp.results
            answer = result.x.copy()
            if result.info.status == proxqp.QPSolverOutput.PROXQP_SOLVED and math.isfinite(answer.sum()):
                return QpSolution(answer, QpStatus.SOLVED, result.info.iter, time.perf_counter() - started)
        self._ready = False  # a failed solve is no warm start
        return self._solve_relaxed(hessian, gradient, inertia, torque_lower, torque_upper, lower, upper, started)

    @staticmethod
    def _within(values: Array, lower: Array, upper: Array) -> bool:
        """Whether values keep their limits; a NaN does not."""
        return bool(((values >= lower) & (values <= upper)).all())

    def _acceleration_bounds(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Bounds on ddq that paper eqs. const_q and const_dq imply."""
        position = q * self._per_square + dq * (self._per_square * self._period)
        velocity = dq * self._per_period
        upper = np.minimum(self._position_high - position, self._velocity_bound - velocity)
        lower = np.maximum(self._position_low - position, -self._velocity_bound - velocity)
        return lower, upper

    def _solve_relaxed(
        self,
        hessian: Array,
        gradient: Array,
        inertia: Array,
        torque_lower: Array,
        torque_upper: Array,
        lower: Array,
        upper: Array,
        started: float,
    ) -> QpSolution:
        """The same program with a slack per constraint row, scaled so that rows are comparable."""
        count = self._count
        period = self._period
        middle = (lower + upper) / 2.0
        box_lower, box_upper = np.minimum(lower, middle), np.maximum(upper, middle)
        rows = np.vstack((np.eye(count) * period, inertia / self._torque_max[:, None]))
        row_lower = np.concatenate((box_lower * period, torque_lower / self._torque_max))
        row_upper = np.concatenate((box_upper * period, torque_upper / self._torque_max))
        qp = proxqp.dense.QP(3 * count, 0, 2 * count)
        qp.settings.eps_abs = 1e-7
        qp.settings.max_iter = 2000
        cost = np.zeros((3 * count, 3 * count))
        cost[:count, :count] = hessian
        cost[count:, count:] = SLACK_WEIGHT * np.eye(2 * count)
        linear = np.concatenate((gradient, np.zeros(2 * count)))
        qp.init(cost, linear, None, None, np.hstack((rows, np.eye(2 * count))), row_lower, row_upper)
        qp.solve()
        acceleration = qp.results.x[:count]
        status = QpStatus.RELAXED
        if not np.isfinite(acceleration).all():
            acceleration = np.linalg.solve(hessian, -gradient)
            status = QpStatus.FAILED
        if not np.isfinite(acceleration).all():
            acceleration = np.zeros(count)
        return QpSolution(np.array(acceleration), status, int(qp.results.info.iter), time.perf_counter() - started)
