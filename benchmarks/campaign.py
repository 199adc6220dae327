# SPDX-License-Identifier: Apache-2.0
"""Time of a trial, its bag, a campaign and its analysis: ``./run python benchmarks/campaign.py [trials] [jobs]``.

Prints one JSON document. CPU seconds tell the work, wall seconds what a user waits; on a busy machine they differ.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from impact_rs_analysis.measure.analyze import analyze_campaign
from impact_rs_analysis.report import write_report
from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_control.plan import plan_trial
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags.writer import BagWriter
from impact_rs_trials.campaign import make_manifest, open_campaign, run_campaign, run_one
from impact_rs_trials.workers import Workforce

REPEATS = 10


def timed(call: Callable[[], Any]) -> tuple[float, float]:
    """Wall and CPU time of a call [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - wall, time.process_time() - cpu


def spread(samples: list[tuple[float, float]]) -> dict[str, float]:
    """Median, smallest and largest wall time, and median CPU time [s]."""
    wall, cpu = [sample[0] for sample in samples], [sample[1] for sample in samples]
    return {
        "median_s": statistics.median(wall),
        "min_s": min(wall),
        "max_s": max(wall),
        "cpu_median_s": statistics.median(cpu),
    }


def simulate() -> None:
    """One trial without a bag."""
    plan = plan_trial(Scene.resolve(load_scenario("push"), "cat_food", "case_2"))
    plant = make_plant(plan, seed=0)
    for _ in run_closed_loop(plan, plant):
        pass
    plant.close()


def main() -> None:
    """Measure and print."""
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    jobs = int(sys.argv[2]) if len(sys.argv) > 2 else 2
    with tempfile.TemporaryDirectory() as folder:
        single = make_manifest("push", ["cat_food"], ["case_2"], [1.0], REPEATS + 1)
        keys = open_campaign(Path(folder) / "single", single)
        writing = 0.0
        close = BagWriter.finish

        def finish(bag: BagWriter, *ending: Any) -> None:
            nonlocal writing
            start = time.process_time()
            close(bag, *ending)
            writing += time.process_time() - start

        run_one(Path(folder) / "single", single.trial(keys[0]))  # imports and caches
        BagWriter.finish = finish  # type: ignore[method-assign, assignment]
        trials = [timed(lambda key=key: run_one(Path(folder) / "single", single.trial(key))) for key in keys[1:]]
        BagWriter.finish = close  # type: ignore[method-assign]
        total_cpu = sum(cpu for _, cpu in trials)
        manifest = make_manifest("push", trials=repeats)
        campaign = timed(lambda: list(run_campaign(Path(folder) / "campaign", manifest, Workforce(jobs))))
        analysis = timed(lambda: analyze_campaign(Path(folder) / "campaign"))
        found = analyze_campaign(Path(folder) / "campaign")
        report = timed(lambda: write_report(found, Path(folder) / "report"))
        print(
            json.dumps(
                {
                    "simulation": spread([timed(simulate) for _ in range(REPEATS)]),
                    "trial_with_bag": spread(trials),
                    "bag_write_share": writing / total_cpu,
                    "campaign": {
                        "trials": len(manifest.keys),
                        "jobs": jobs,
                        "wall_s": campaign[0],
                        "wall_per_trial_s": campaign[0] / len(manifest.keys),
                    },
                    "analysis": {"wall_s": analysis[0], "per_trial_s": analysis[0] / len(manifest.keys)},
                    "report": {"wall_s": report[0]},
                },
                indent=2,
            )
        )


if __name__ == "__main__":
    main()
