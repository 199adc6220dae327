# SPDX-License-Identifier: Apache-2.0
"""Processor time of the impact map: one warm call, and many questions at once."""

from __future__ import annotations

import argparse
import time

import numpy as np

from benchmarks.harness import Case, Row, Work, quantiles
from benchmarks.results import Table
from impact_rs_sim.impact_map import ENGINES, BulletEngine, ExactEngine, ImpactProblem
from impact_rs_sim.impact_map.batch import ImpactBatch, solve_batch
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import ArmState, Scene

BATCH = 10_000  # questions
SCENARIOS = ("push", "grab")
CALLS = {"exact": ExactEngine, "bullet": BulletEngine}


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many calls."""
    parser.add_argument("--calls", type=int, default=150, help="number of timed calls")


def cases(options: argparse.Namespace) -> list[Case]:
    """Calls of the engines, and batches whose joint positions differ by so much [rad]."""
    del options
    assert set(CALLS) == set(ENGINES)
    found = [Case(f"one warm call, engine {name} [us]", kind) for name, kind in CALLS.items()]
    return found + [Case(f"batch, joint positions by {moved:g} rad [a second]", moved) for moved in (0.0, 1e-4, 1e-3)]


def run(case: Case, work: Work) -> Row:
    """Both scenarios."""
    problems = {
        name: ImpactProblem.at_nominal_impact(Scene.resolve(load_scenario(name), "cat_food", "case_2"))
        for name in SCENARIOS
    }
    if isinstance(case.given, float):
        return {name: f"{batch(problem, case.given):,.0f}" for name, problem in problems.items()}
    return {name: warm_calls(problem, case.given, work.options.calls) for name, problem in problems.items()}


def warm_calls(problem: ImpactProblem, kind: type[ExactEngine | BulletEngine], calls: int) -> str:
    """Times of calls [us]."""
    engine, times = kind(problem.physics), []
    for _ in range(calls + 1):
        began = time.process_time()
        engine.solve(problem)
        times.append(1e6 * (time.process_time() - began))
    engine.close()
    return quantiles(times[1:])


def batch(problem: ImpactProblem, moved: float) -> float:
    """Questions a second that differ in motor inertia, velocities and joint positions."""
    rng = np.random.default_rng(0)

    def about(values: np.ndarray, scale: float) -> np.ndarray:
        return values + scale * rng.standard_normal((BATCH, values.size))

    arms = {
        arm: ArmState(about(state.position, moved), about(state.velocity, 0.02)) for arm, state in problem.arms.items()
    }
    motors = {arm: b * rng.uniform(0.5, 1.5, (BATCH, b.size)) for arm, b in problem.motor_inertia.items()}
    questions = ImpactBatch(problem.physics, arms, problem.object, motors, measured=True)
    began = time.process_time()
    solve_batch(questions)
    return BATCH / (time.process_time() - began)


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Scenarios beside each other."""
    del options
    lines = [(row["name"], *(row[name] for name in SCENARIOS)) for row in rows]
    return Table(("Impact map, median (10 to 90 %)", "`push`, 8 points", "`grab`, 12 points"), tuple(lines))
