# SPDX-License-Identifier: Apache-2.0
"""Trials per second against workers and size of the campaign: ``./run python benchmarks/scale.py [--sizes 10 20 40]``.

Prints a table, and what a million trials would take. Starting the workers is measured apart: it is paid once.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from impact_rs_trials.campaign import make_manifest, run_campaign
from impact_rs_trials.workers import Workforce

MILLION = 1_000_000
CORES = 256


@dataclass(frozen=True)
class Measured:
    """One campaign.

    Attributes:
        jobs: Worker processes.
        trials: Number of trials.
        first: From the call to the first finished trial: workers, imports, first plan [s].
        rate: Trials per second after the first.
    """

    jobs: int
    trials: int
    first: float
    rate: float


def measure(jobs: int, trials: int, scheduler: str | None) -> Measured:
    """Run one campaign of one condition into a temporary folder."""
    manifest = make_manifest("push", ["cat_food"], ["case_2"], [1.0], trials)
    workforce = Workforce(jobs) if scheduler is None else Workforce(scheduler=scheduler)
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        ends = []
        for report in run_campaign(Path(folder), manifest, workforce):
            assert report.outcome == "OK", report.message
            ends.append(time.perf_counter() - start)
    return Measured(jobs, trials, ends[0], (trials - 1) / (ends[-1] - ends[0]))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--sizes", type=int, nargs="+", default=[10, 20, 40], help="trials of a campaign")
    parser.add_argument("--scheduler", help="address of a running dask scheduler; its workers count as one row")
    arguments = parser.parse_args()
    measure(1, 2, None)  # imports and caches of this process
    print(f"{'workers':>8} {'trials':>8} {'first trial [s]':>16} {'trials/s':>10} {'trials/s per worker':>20}")
    results = []
    for jobs in arguments.workers if arguments.scheduler is None else [1]:
        for trials in arguments.sizes:
            found = measure(jobs, trials, arguments.scheduler)
            results.append(found)
            each = found.rate / found.jobs
            print(f"{found.jobs:8d} {found.trials:8d} {found.first:16.2f} {found.rate:10.3f} {each:20.3f}", flush=True)
    if arguments.scheduler is not None:
        return
    last = results[-1]
    per_worker = last.rate / last.jobs
    print(
        f"\nA million trials on {CORES} cores: {MILLION / (per_worker * CORES) / 3600:.1f} h, if every core runs "
        f"{per_worker:.3f} trials/s as each of {last.jobs} workers did here over {last.trials} trials; that scheduler "
        f"and storage keep up with {per_worker * CORES:.0f} trials/s is assumed, not measured."
    )


if __name__ == "__main__":
    main()
