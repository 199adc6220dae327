# SPDX-License-Identifier: Apache-2.0
"""Cost against size, with its log-log slope (1: in proportion): ``./run python benchmarks/size.py [--repeats 3]``.

Arms: ``push`` has one and ``grab`` two; a control tick, a plant step and an impact map serve all of them. Contact
points: a grid on the pad, by the engine ``exact``. Trial length: ``push`` in closed loop, without bag. All in CPU
time, which other programs blur least: run it with ``OMP_NUM_THREADS=1``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence

import numpy as np
from peers_impact_map import Case, PinocchioOnGivenPoints, grid
from rich.console import Console
from rich.table import Table

from impact_rs_control.closed_loop import make_plant, run_closed_loop, without_garbage_collection
from impact_rs_control.controller import Controller
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.impact_map import Engine, ExactEngine, ImpactProblem
from impact_rs_sim.scenario import Scenario, load_scenario
from impact_rs_sim.scene import Scene

SIDES = (1, 2, 3, 4, 6, 8)  # points along a side of the grid
LENGTHS = (1.8, 3.6, 7.2)  # s
CALLS = 50  # of the impact map, per repeat

console = Console(width=110)


def plan(scenario: Scenario) -> TrialPlan:
    """The benchmark's trial of a scenario."""
    return plan_trial(Scene.resolve(scenario, "cat_food", "case_2"))


def ticks(trial: TrialPlan) -> tuple[list[float], list[float]]:
    """CPU times of every control tick and of every plant step of a trial [s]."""
    plant, controller = make_plant(trial, seed=0), Controller(trial)
    decisions, steps = [], []
    with without_garbage_collection():
        for tick in range(trial.scene.scenario.timing.ticks):
            measured = plant.measure()
            start = time.process_time()
            commands = controller.update(tick, measured.arms)
            decided = time.process_time()
            plant.step({name: command.torque for name, command in commands.items()})
            steps.append(time.process_time() - decided)
            decisions.append(decided - start)
    plant.close()
    return decisions, steps


def maps(engine: Engine, problem: ImpactProblem) -> list[float]:
    """CPU times of warm calls [s]."""
    engine.solve(problem)
    times = []
    for _ in range(CALLS):
        start = time.process_time()
        engine.solve(problem)
        times.append(time.process_time() - start)
    return times


def trial(scenario: Scenario) -> float:
    """CPU time of a closed-loop trial, without planning [s]."""
    planned = plan(scenario)
    plant = make_plant(planned, seed=0)
    start = time.process_time()
    with without_garbage_collection():
        for _ in run_closed_loop(planned, plant):
            pass
    elapsed = time.process_time() - start
    plant.close()
    return elapsed


def rows(
    table: Table, name: str, unit: str, times: Mapping[int, Sequence[float]] | Mapping[float, Sequence[float]]
) -> None:
    """One section: a row per size, the slope from each to the next, and the one through all medians."""
    sizes, medians = np.log(list(times)), np.log([np.median(values) for values in times.values()])
    slope, steps = np.polyfit(sizes, medians, 1)[0], np.diff(medians) / np.diff(sizes)
    for number, (size, values) in enumerate(times.items()):
        low, middle, high = 1e3 * np.percentile(values, (10, 50, 90))
        first = (name, f"all: {slope:.2f}") if number == 0 else ("", f"{steps[number - 1]:.2f}")
        spread = f"{low:.3g} .. {high:.3g}"
        table.add_row(first[0], f"{size:g} {unit}", f"{middle:.3g}", spread, f"{middle / size:.3g}", first[1])
    table.add_section()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3, help="repeats of every trial")
    options = parser.parse_args()
    repeats = range(options.repeats)
    table = Table("what", "size", "median, ms", "10 .. 90 %, ms", "ms / size", "log-log slope")

    scenarios = {1: load_scenario("push"), 2: load_scenario("grab")}
    planned = {arms: plan(scenario) for arms, scenario in scenarios.items()}
    measured = {arms: [ticks(each) for _ in repeats] for arms, each in planned.items()}
    for part, name in enumerate(("control tick", "plant step")):
        times = {arms: [value for run in runs for value in run[part]] for arms, runs in measured.items()}
        rows(table, name, "arms", times)
    problems = {arms: ImpactProblem.at_nominal_impact(each.scene) for arms, each in planned.items()}
    calls = {arms: maps(ExactEngine(problem.physics), problem) for arms, problem in problems.items()}
    rows(table, "impact map, 8 and 12 points", "arms", calls)

    face = Case.make("face", "nominal")
    points = {
        side**2: maps(PinocchioOnGivenPoints(face.problem.physics, grid(face.contacts, side)), face.problem)
        for side in SIDES
    }
    rows(table, "impact map, one arm", "points", points)

    push = scenarios[1]
    lengths = {
        length: push.model_copy(update={"timing": push.timing.model_copy(update={"duration": length})})
        for length in LENGTHS
    }
    rows(table, "trial", "s", {length: [trial(each) for _ in repeats] for length, each in lengths.items()})
    console.print(table)


if __name__ == "__main__":
    main()
