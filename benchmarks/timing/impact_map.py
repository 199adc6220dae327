# SPDX-License-Identifier: Apache-2.0
"""Processor time of one warm call of the impact map."""

from __future__ import annotations

import argparse
import time

from benchmarks.harness import Case, Row, Work, quantiles
from benchmarks.results import Table
from impact_rs_sim.impact_map import ENGINES, BulletEngine, ExactEngine, ImpactProblem
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene

SCENARIOS = ("push", "grab")
CALLS = {"exact": ExactEngine, "bullet": BulletEngine}


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many calls."""
    parser.add_argument("--calls", type=int, default=150, help="number of timed calls")


def cases(options: argparse.Namespace) -> list[Case]:
    """Calls of the engines."""
    del options
    assert set(CALLS) == set(ENGINES)
    return [Case(f"one warm call, engine {name} [us]", kind) for name, kind in CALLS.items()]


def run(case: Case, work: Work) -> Row:
    """Both scenarios."""
    problems = {
        name: ImpactProblem.at_nominal_impact(Scene.resolve(load_scenario(name), "cat_food", "case_2"))
        for name in SCENARIOS
    }
    return {name: warm_calls(problem, case.inputs, work.options.calls) for name, problem in problems.items()}


def warm_calls(problem: ImpactProblem, kind: type[ExactEngine | BulletEngine], calls: int) -> str:
    """Times of calls [us]."""
    engine, times = kind(problem.physics), []
    for _ in range(calls + 1):
        began = time.process_time()
        engine.solve(problem)
        times.append(1e6 * (time.process_time() - began))
    engine.close()
    return quantiles(times[1:])


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Scenarios beside each other."""
    del options
    lines = [(row["name"], *(row[name] for name in SCENARIOS)) for row in rows]
    return Table(("Impact map, median (10 to 90 %)", "`push`, 8 points", "`grab`, 12 points"), tuple(lines))
