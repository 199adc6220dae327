# SPDX-License-Identifier: Apache-2.0
"""Processor time of control tick, plant substep and trial: ``./run python benchmarks/tick.py [trials] [scenario]``.

A substep is free until the pads touch the object, and with contact afterwards. It needs nothing that other versions
lack: run it in a worktree of one of them as well, in turns, to compare the two on a host that changes its speed.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from impact_rs_control.closed_loop import make_plant, run_closed_loop, without_garbage_collection
from impact_rs_control.controller import Controller
from impact_rs_control.plan import plan_trial
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene


def main() -> None:
    """Print median and spread."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trials", type=int, nargs="?", default=5, help="how many")
    parser.add_argument("scenario", nargs="?", default="push", help="a shipped one, or a file")
    arguments = parser.parse_args()
    scenario = load_scenario(arguments.scenario)
    plan = plan_trial(Scene.resolve(scenario, next(iter(scenario.objects)), next(iter(scenario.cases))))
    timing = plan.scene.scenario.timing
    impact = round(timing.nominal_impact / timing.control_period)
    ticks, free, touching, whole = [], [], [], []
    for seed in range(arguments.trials):
        plant, controller = make_plant(plan, seed), Controller(plan)
        with without_garbage_collection():
            for tick in range(timing.ticks):
                measured = plant.measure()
                start = time.process_time()
                commands = controller.update(tick, measured.arms)
                decided = time.process_time()
                plant.step({name: command.torque for name, command in commands.items()})
                (free if tick < impact else touching).append((time.process_time() - decided) / timing.substeps)
                ticks.append(decided - start)
        plant.close()
        plant, began = make_plant(plan, seed), time.process_time()
        with without_garbage_collection():
            for _ in run_closed_loop(plan, plant):
                pass
        whole.append(time.process_time() - began)
        plant.close()
    parts = (("control tick", ticks), ("substep, free", free), ("substep, contact", touching))
    for name, values in parts:
        low, middle, high = np.percentile(np.array(values) * 1e6, (10, 50, 90))
        print(f"{name:16s} median {middle:6.1f} us, 10..90 %: {low:.1f} .. {high:.1f} us")
    spread = f"{min(whole):.3f} .. {max(whole):.3f} s"
    print(f"trial of {timing.duration} s without bag: median {np.median(whole):.3f} s, {spread}")


if __name__ == "__main__":
    main()
