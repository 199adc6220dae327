# SPDX-License-Identifier: Apache-2.0
"""Time of one control tick and of its parts, along a trial: ``./run python benchmarks/tick.py [trials]``."""

from __future__ import annotations

import sys
import time

import numpy as np

from impact_rs_control.closed_loop import make_plant, without_garbage_collection
from impact_rs_control.controller import Controller
from impact_rs_control.plan import plan_trial
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene


def main() -> None:
    """Print median and spread."""
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    plan = plan_trial(Scene.resolve(load_scenario("push"), "cat_food", "case_2"))
    timing = plan.scene.scenario.timing
    ticks, steps, qps, whole = [], [], [], []
    for seed in range(trials):
        plant, controller = make_plant(plan, seed), Controller(plan)
        began = time.perf_counter()
        with without_garbage_collection():
            for tick in range(timing.ticks):
                measured = plant.measure()
                start = time.perf_counter()
                commands = controller.update(tick, measured.arms)
                decided = time.perf_counter()
                plant.step({name: command.torque for name, command in commands.items()})
                steps.append((time.perf_counter() - decided) / timing.substeps)
                ticks.append(decided - start)
                qps.extend(command.qp_solve_time for command in commands.values())
        whole.append(time.perf_counter() - began)
        plant.close()
    for name, values in (("control tick", ticks), ("  of which QP", qps), ("plant substep", steps)):
        low, middle, high = np.percentile(np.array(values) * 1e6, (10, 50, 90))
        print(f"{name:14s} median {middle:6.1f} us, 10..90 %: {low:.1f} .. {high:.1f} us")
    spread = f"{min(whole):.3f} .. {max(whole):.3f} s"
    print(f"trial of {timing.duration} s without bag: median {np.median(whole):.3f} s, {spread}")


if __name__ == "__main__":
    main()
