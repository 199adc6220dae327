# SPDX-License-Identifier: Apache-2.0
"""The controller's quadratic programs beside quadprog, daqp, piqp and osqp.

    ./run python benchmarks/peers_qp.py [--tighten 0.95] [--every 1]

The peers are optional: ``./run python -m pip install quadprog daqp piqp osqp`` (or the extra ``peers``); what is
not installed is skipped.

The programs are those of one closed-loop trial of ``push``, as the controller met them, and the same ones with the
torque limits of every joint at ``--tighten`` times its largest torque in that trial, so that limits are active. Every
solver gets them in the order of the trial and starts warm where it can. The best solution is the one whose active
limits, solved as equations, leave no limit broken and no multiplier of the wrong sign.
"""

from __future__ import annotations

import argparse
import copy
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from importlib.util import find_spec
from typing import Any

import numpy as np
from proxsuite import proxqp
from rich.console import Console
from rich.table import Table
from scipy import sparse
from scipy.linalg.lapack import dposv

from impact_rs_control.closed_loop import make_plant, run_closed_loop, without_garbage_collection
from impact_rs_control.plan import plan_trial
from impact_rs_control.qp import ACCURACY, AccelerationProblem, AccelerationQp, QpSolution, QpStatus, QuadraticProgram
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene

PEERS = ("quadprog", "daqp", "piqp", "osqp")
NEAR = 1e-5  # of a limit's range: a row that close to its limit is taken for active
MOST_CHANGES = 50
BROKEN = 1e-9  # rad/s^2, N m
WRONG_SIGN = 1e-7  # of the gradient: largest multiplier of the wrong sign

console = Console(width=130)


@dataclass(frozen=True)
class Program(QuadraticProgram):
    """A program and what it is made from.

    Attributes:
        problem: What the controller asked.
    """

    problem: AccelerationProblem

    @classmethod
    def of(cls, qp: AccelerationQp, problem: AccelerationProblem) -> Program:
        """What :meth:`AccelerationQp.solve` makes of a problem."""
        made = qp.program(problem)
        return cls(**{field.name: getattr(made, field.name) for field in fields(made)}, problem=problem)

    @property
    def rows(self) -> tuple[Array, Array, Array]:
        """All limits as one: matrix ``(2 n, n)`` and its lower and upper limits ``(2 n,)``."""
        matrix = np.vstack((np.eye(self.gradient.size), self.inertia))
        return matrix, np.concatenate((self.lower, self.torque_lower)), np.concatenate((self.upper, self.torque_upper))

    def violation(self, answer: Array) -> float:
        """Largest violation of a limit [rad/s^2, N m]."""
        matrix, lower, upper = self.rows
        value = matrix @ answer
        return float(np.max(np.maximum(np.maximum(lower - value, value - upper), 0.0)))

    def best(self, answer: Array) -> tuple[Array, int]:
        """The exact solution, and its number of active limits, by changing those of ``answer`` one by one.

        Raises:
            ArithmeticError: Not found.
        """
        matrix, lower, upper = self.rows
        value, near, size = matrix @ answer, NEAR * (upper - lower), self.gradient.size
        active = np.where(upper - value < near, 1, np.where(value - lower < near, -1, 0))  # 1 upper, -1 lower
        for _ in range(MOST_CHANGES):
            held = matrix[active != 0]
            system = np.block([[self.hessian, held.T], [held, np.zeros((len(held), len(held)))]])
            limits = np.where(active > 0, upper, lower)[active != 0]
            solved = np.linalg.solve(system, np.concatenate((-self.gradient, limits)))
            exact, pull = solved[:size], np.zeros(active.size)
            pull[active != 0] = solved[size:] * -active[active != 0]
            value = matrix @ exact
            broken = np.maximum(value - upper, lower - value)
            if np.max(pull) > WRONG_SIGN * np.max(np.abs(self.gradient)):
                active[np.argmax(pull)] = 0
            elif np.max(broken) > BROKEN:
                worst = int(np.argmax(broken))
                active[worst] = 1 if value[worst] > upper[worst] else -1
            else:
                return exact, len(held)
        raise ArithmeticError("no exact solution of a program")


class Solver(ABC):
    """One solver, warm from program to program."""

    @abstractmethod
    def solve(self, program: Program) -> Array:
        """Minimiser, ``(n,)``."""


class Ours(Solver):
    """The controller's solver, which also makes the program out of the tick."""

    def __init__(self, qp: AccelerationQp) -> None:
        self._qp = AccelerationQp(qp.limits, qp.period)

    def solve(self, program: Program) -> Array:
        """Cholesky, and ProxQP where a limit is near."""
        solution = self._qp.solve(program.problem)
        if solution.status is not QpStatus.SOLVED:
            raise ArithmeticError(solution.status.name)
        return solution.acceleration


class Cholesky(Solver):
    """No limits at all: what the answer costs where none is near."""

    def solve(self, program: Program) -> Array:
        """Minimiser without limits."""
        return np.asarray(dposv(program.hessian, -program.gradient)[1])


class ProxQp(Solver):
    """ProxQP for every program, set as the controller sets it."""

    def __init__(self, count: int) -> None:
        self._qp = proxqp.dense.QP(count, 0, count, True)
        self._qp.settings.eps_abs = ACCURACY
        self._qp.settings.max_iter = 200
        self._qp.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._qp.settings.compute_timings = False
        self._set = self._qp.init

    def solve(self, program: Program) -> Array:
        """Warm."""
        p = program
        self._set(p.hessian, p.gradient, None, None, p.inertia, p.torque_lower, p.torque_upper, p.lower, p.upper)
        self._set = self._qp.update
        self._qp.solve()
        return np.array(self._qp.results.x)


class Quadprog(Solver):
    """Goldfarb and Idnani's dual method; knows no warm start."""

    def __init__(self) -> None:
        import quadprog

        self._solve = quadprog.solve_qp

    def solve(self, program: Program) -> Array:
        """Cold."""
        p, identity = program, np.eye(program.gradient.size)
        matrix = np.hstack((identity, -identity, p.inertia.T, -p.inertia.T))
        limits = np.concatenate((p.lower, -p.upper, p.torque_lower, -p.torque_upper))
        return np.asarray(self._solve(p.hessian, -p.gradient, matrix, limits)[0])


class Daqp(Solver):
    """Dual active-set method; starts from the last active set."""

    def __init__(self) -> None:
        import daqp

        self._model = daqp.Model()
        self._model.settings = {"primal_tol": ACCURACY, "dual_tol": ACCURACY}
        self._ready = False

    def solve(self, program: Program) -> Array:
        """Warm."""
        p = program
        upper, lower = np.concatenate((p.upper, p.torque_upper)), np.concatenate((p.lower, p.torque_lower))
        if self._ready:
            self._model.update(H=p.hessian, f=p.gradient, A=p.inertia, bupper=upper, blower=lower)
        else:
            self._model.setup(p.hessian, p.gradient, np.ascontiguousarray(p.inertia), upper, lower)
            self._ready = True
        answer, _, flag, _ = self._model.solve()
        if flag <= 0:
            raise ArithmeticError(f"exit flag {flag}")
        return np.asarray(answer)


class Piqp(Solver):
    """Proximal interior-point method; keeps its memory, and starts from the middle."""

    def __init__(self) -> None:
        import piqp

        self._solved = piqp.PIQP_SOLVED
        self._solver = piqp.DenseSolver()
        self._solver.settings.eps_abs = ACCURACY
        self._solver.settings.eps_rel = 0.0
        self._solver.settings.eps_duality_gap_abs = ACCURACY
        self._solver.settings.eps_duality_gap_rel = 0.0
        self._set = self._solver.setup

    def solve(self, program: Program) -> Array:
        """Update and solve."""
        p = program
        self._set(
            P=np.asfortranarray(p.hessian),
            c=p.gradient,
            G=np.asfortranarray(p.inertia),
            h_l=p.torque_lower,
            h_u=p.torque_upper,
            x_l=p.lower,
            x_u=p.upper,
        )
        self._set = self._solver.update
        if self._solver.solve() != self._solved:
            raise ArithmeticError("not solved")
        return np.array(self._solver.result.x)


class Osqp(Solver):
    """Operator splitting with warm start."""

    def __init__(self, count: int) -> None:
        import osqp

        self._solver = osqp.OSQP()
        self._triangle = np.tril_indices(count)
        self._pattern: Array | None = None

    def solve(self, program: Program) -> Array:
        """Warm."""
        p, count = program, program.gradient.size
        _, lower, upper = p.rows
        matrix = np.vstack((np.eye(count), p.inertia))
        if self._pattern is not None:
            cost = p.hessian[self._triangle]  # the upper triangle, column by column
            self._solver.update(Px=cost, Ax=matrix.T[self._pattern], q=p.gradient, l=lower, u=upper)
        else:
            self._pattern = matrix.T != 0.0
            self._solver.setup(
                sparse.csc_matrix(np.triu(p.hessian)),
                p.gradient,
                sparse.csc_matrix(matrix),
                lower,
                upper,
                eps_abs=ACCURACY,
                eps_rel=0.0,
                max_iter=20000,
                verbose=False,
            )
        result = self._solver.solve()
        if result.info.status != "solved":
            raise ArithmeticError(result.info.status)
        return np.asarray(result.x)


def record() -> tuple[list[AccelerationProblem], AccelerationQp]:
    """Every problem of a trial, and the solver that met them."""
    problems: list[AccelerationProblem] = []
    solvers: list[AccelerationQp] = []
    solve = AccelerationQp.solve

    def listen(qp: AccelerationQp, problem: AccelerationProblem) -> QpSolution:
        problems.append(copy.deepcopy(problem))  # its arrays are reused in the next tick
        solvers.append(qp)
        return solve(qp, problem)

    AccelerationQp.solve = listen  # type: ignore[method-assign]
    try:
        plan = plan_trial(Scene.resolve(load_scenario("push"), "cat_food", "case_2"))
        plant = make_plant(plan, seed=0)
        for _ in run_closed_loop(plan, plant):
            pass
        plant.close()
    finally:
        AccelerationQp.solve = solve  # type: ignore[method-assign]
    return problems, solvers[0]


def row(name: str, make: Any, programs: Sequence[Program], best: Sequence[Array]) -> list[str]:
    """Times, violation and distance of one solver over all programs."""
    solver = make()
    times, violations, distances, failures = [], [], [], 0
    with without_garbage_collection():
        for program, exact in zip(programs, best, strict=True):
            start = time.perf_counter()
            try:
                answer = solver.solve(program)
            except (ArithmeticError, ValueError):
                failures += 1
                solver = make()
                continue
            times.append(1e6 * (time.perf_counter() - start))
            violations.append(program.violation(answer))
            distances.append(float(np.max(np.abs(answer - exact))))
    if not times:
        return [name, "-", "-", "-", "-", str(failures)]
    low, middle, high = np.percentile(times, (10, 50, 90))
    cells = (f"{middle:.1f}", f"{low:.1f} .. {high:.1f}", f"{max(violations):.1e}", f"{max(distances):.1e}")
    return [name, *cells, str(failures)]


def compare(table: Table, title: str, qp: AccelerationQp, problems: Sequence[AccelerationProblem]) -> None:
    """One section of the table."""
    making, programs = [], []
    for problem in problems:
        start = time.perf_counter()
        programs.append(Program.of(qp, problem))
        making.append(1e6 * (time.perf_counter() - start))
    count = programs[0].gradient.size
    finder = ProxQp(count)
    solutions = [program.best(finder.solve(program)) for program in programs]
    best, active = [exact for exact, _ in solutions], sum(number > 0 for _, number in solutions)
    makers = {
        "ours, making included": lambda: Ours(qp),
        "Cholesky without limits": Cholesky,
        "ProxQP for all": lambda: ProxQp(count),
        "quadprog": Quadprog,
        "daqp": Daqp,
        "piqp": Piqp,
        "osqp": lambda: Osqp(count),
    }
    low, middle, high = np.percentile(making, (10, 50, 90))
    table.add_section()
    table.add_row(title, f"active in {active} of {len(programs)}")
    table.add_row("making the program", f"{middle:.1f}", f"{low:.1f} .. {high:.1f}")
    for name, make in makers.items():
        if name not in PEERS or find_spec(name) is not None:
            table.add_row(*row(name, make, programs, best))


def main() -> None:
    """Record a trial, solve its programs, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--tighten", type=float, default=0.95, help="torque limits over the largest torque in the trial"
    )
    parser.add_argument("--every", type=int, default=1, help="take every so many-th tick only")
    options = parser.parse_args()
    problems, qp = record()
    free = AccelerationQp(qp.limits, qp.period)
    torques = [abs(one.inertia @ free.solve(one).acceleration + one.bias) for one in problems]
    tight = AccelerationQp(replace(qp.limits, torque_max=options.tighten * np.max(torques, axis=0)), qp.period)
    for name in PEERS:
        if find_spec(name) is None:
            console.print(f"{name} is not installed and skipped: ./run python -m pip install {name}")
    table = Table("solver", "median, us", "10 .. 90 %, us", "max violation", "max distance", "failures")
    compare(table, "limits of the trial", qp, problems[:: options.every])
    compare(table, f"torque limits x {options.tighten:g}", tight, problems[:: options.every])
    console.print(table)
    console.print("violation in rad/s^2 or N m, distance from the best solution in rad/s^2; all at 1e-9 where they can")


if __name__ == "__main__":
    main()
