# SPDX-License-Identifier: Apache-2.0
"""Processor time of control tick, plant substep and trial without bag, by plant and by twin.

A substep is free until the pads touch the object, and with contact afterwards.
"""

from __future__ import annotations

import argparse
import time
from functools import partial

from benchmarks.harness import Case, Row, Work, in_turns, quantiles
from benchmarks.results import Table
from impact_rs_control.closed_loop import make_plant, run_closed_loop, without_garbage_collection
from impact_rs_control.controller import Controller
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene

PARTS = {
    "ticks": ("control tick, all arms [us]", 1e6),
    "free": ("plant substep before the impact [us]", 1e6),
    "touching": ("plant substep with contact [us]", 1e6),
    "bullet": ("trial without bag, plant [s]", 1.0),
    "twin": ("trial without bag, twin in the plant's place [s]", 1.0),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which trials, and how many."""
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--scenarios", nargs="+", default=["push", "grab"], help="shipped ones, or files")


def cases(options: argparse.Namespace) -> list[Case]:
    """Scenarios."""
    return [Case(name) for name in options.scenarios]


def whole(plan: TrialPlan, simulator: str) -> None:
    """A trial without a bag."""
    plant = make_plant(plan, 0, simulator=simulator)
    with without_garbage_collection():
        for _ in run_closed_loop(plan, plant):
            pass
    plant.close()


def run(case: Case, work: Work) -> Row:
    """Times of all parts, in the units of ``PARTS``."""
    scenario = load_scenario(case.name)
    plan = plan_trial(Scene.resolve(scenario, next(iter(scenario.objects)), next(iter(scenario.cases))))
    timing = plan.scene.scenario.timing
    impact = round(timing.nominal_impact / timing.control_period)
    times: dict[str, list[float]] = {name: [] for name in ("ticks", "free", "touching")}
    for seed in range(work.options.trials):
        plant, controller = make_plant(plan, seed), Controller(plan)
        with without_garbage_collection():
            for tick in range(timing.ticks):
                measured = plant.measure()
                began = time.process_time()
                commands = controller.update(tick, measured.arms)
                decided = time.process_time()
                plant.step({name: command.torque for name, command in commands.items()})
                times["free" if tick < impact else "touching"].append((time.process_time() - decided) / timing.substeps)
                times["ticks"].append(decided - began)
        plant.close()
    calls = {name: partial(whole, plan, name) for name in ("bullet", "twin")}
    times |= in_turns(calls, work.options.trials)
    return {name: quantiles([PARTS[name][1] * value for value in values]) for name, values in times.items()}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Scenarios beside each other."""
    del options
    lines = [(words, *(row[name] for row in rows)) for name, (words, _) in PARTS.items()]
    return Table(("Processor time, median (10 to 90 %)", *(f"`{row['name']}`" for row in rows)), tuple(lines))
