# SPDX-License-Identifier: Apache-2.0
"""What friction compensation is worth: ``./run python benchmarks/friction.py [--objects NAME ...] [--trials N]``.

The same trials three times: a plant without joint friction, one with the robot's identified friction, and that one with
the compensation identified on it. Prints one JSON document: experimental estimates, and how far the last two are from
the first. The seeds are the same, so scatter and noise drop out of the differences.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

from impact_rs_analysis.measure.analyze import ExperimentSet, analyze_campaign
from impact_rs_sim.scenario import load_scenario, scenario_path
from impact_rs_trials.campaign import make_manifest, run_campaign
from impact_rs_trials.friction import identify, write_compensation
from impact_rs_trials.workers import Workforce, workers


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenario", default="push")
    parser.add_argument("--objects", nargs="+", default=["cat_food"])
    parser.add_argument("--cases", nargs="+", default=["case_2"])
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="of campaigns and identification")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rough = folder / "rough.yaml"
        text = scenario_path(args.scenario).read_text(encoding="utf-8")
        rough.write_text(text.replace("friction: none", "friction: identified"), encoding="utf-8")
        began = time.perf_counter()
        with workers(Workforce(args.jobs)) as map_tasks:
            found = identify(
                load_scenario(str(rough)), args.objects, args.cases, args.runs, args.seed, None, map_tasks, _silent
            )
        took = time.perf_counter() - began
        compensated = write_compensation(found, str(rough), folder / "friction.yaml")
        estimates = {}
        for kind, scenario in (
            ("frictionless", args.scenario),
            ("uncompensated", str(rough)),
            ("compensated", str(compensated)),
        ):
            manifest = make_manifest(scenario, args.objects, args.cases, trials=args.trials, seed=args.seed)
            list(run_campaign(folder / kind, manifest, Workforce(args.jobs)))
            estimates[kind] = {f"{one.object} {one.case}": one for one in analyze_campaign(folder / kind).sets}
    sets = {}
    for name, smooth in estimates["frictionless"].items():
        sets[name] = {kind: _row(table.get(name), smooth) for kind, table in estimates.items()}
    print(
        json.dumps(
            {
                "identification_s": took,
                "trials_per_estimate": len(manifest.velocity_scales) * args.trials,
                "sets": sets,
            },
            indent=2,
        )
    )


def _row(one: ExperimentSet | None, smooth: ExperimentSet) -> dict[str, float] | None:
    if one is None:
        return None
    low, high = one.interval or (float("nan"), float("nan"))
    return {
        "estimate_m_s": one.estimate,
        "half_interval_m_s": (high - low) / 2.0,
        "slope": one.fit.slope,
        "from_frictionless_percent": 100.0 * (one.estimate - smooth.estimate) / smooth.estimate,
        "reduced_error_percent": one.predictions["reduced"].error,
    }


def _silent(done: int, total: int) -> None:
    del done, total


if __name__ == "__main__":
    main()
