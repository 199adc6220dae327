# SPDX-License-Identifier: Apache-2.0
"""Trials per second against workers and size of the campaign: ``./run python benchmarks/scale.py [--sizes 10 20 40]``.

Prints a table, and what a million trials would take. Starting the workers is measured apart: it is paid once.
``--memory 2000`` tells instead how a worker's memory grows over so many trials, ``--tiny 10000`` what the scheduler
takes for so many tasks that do nothing, ``--rows 1000000`` how large a data set of so many trials is (``export``), and
what it takes to find nothing new.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from impact_rs_analysis.measure.data_set import extend
from impact_rs_analysis.measure.export import trial_row
from impact_rs_trials.campaign import Trial, make_manifest, run_campaign, run_one
from impact_rs_trials.store import Folder
from impact_rs_trials.workers import Workforce, as_they_end, client_of

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


def _nothing(item: int) -> int:
    return item


def overhead(tasks: int, jobs: int) -> None:
    """Print what tasks that do nothing cost."""
    with client_of(Workforce(jobs)) as client:
        list(as_they_end(client, _nothing, range(10)))
        start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
        list(as_they_end(client, _nothing, range(tasks)))
        took, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF)
    own = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(
        f"{tasks} tasks that do nothing, {jobs} workers: {took:.1f} s, {tasks / took:.0f} a second; for each, scheduler"
    )
    print(f"and client take {1e3 * own / tasks:.2f} ms of processor time; they hold {after.ru_maxrss / 1024:.0f} MB")


class _Listed(Folder):
    """A place that says it holds so many bags; there are none."""

    def __init__(self, bags: int) -> None:
        super().__init__("/nowhere")
        self._bags = bags

    def stamps(self) -> dict[str, int]:
        """Bags of nine repeats of so many conditions, stamps without pattern."""
        numbers = random.Random(1)
        return {
            f"cat_food__case_2__s{1 + i // 9 / 1e6:.6f}__r{i % 9}": numbers.getrandbits(64) for i in range(self._bags)
        }


def data_set(trials: int) -> None:
    """Print size of a data set of rows like that of one trial, with other numbers, and cost of finding nothing new."""
    with tempfile.TemporaryDirectory() as folder:
        key = make_manifest("push", ["cat_food"], ["case_2"], [1.0], 1)
        (report,) = run_campaign(Path(folder) / "push", key)
        row = trial_row(Path(folder) / "push" / report.key.name)
        assert isinstance(row, dict), row
        numbers = random.Random(2)

        def rows(_: object, names: Sequence[str]) -> Iterator[dict[str, Any]]:
            for name in names:
                yield row | {
                    "trial": name,
                    "seed": numbers.getrandbits(63),
                    "repeat": int(name[-1]),
                    "net_feedback_m_s": numbers.gauss(0.0, 0.1),
                    "arm_impact_time_s": round(numbers.gauss(1.0, 0.01), 3),
                }

        store, target = _Listed(trials), Path(folder) / "rows"
        extend(store, target, rows, lambda done, total: None)
        parts = [path.stat().st_size for path in target.iterdir()]
        start = time.perf_counter()
        assert extend(store, target, rows, lambda done, total: None).read == 0
        took = time.perf_counter() - start
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{trials} rows: {len(parts)} parts, {sum(parts) / 1e6:.1f} MB, {sum(parts) / trials:.0f} bytes a row")
    print(f"to find that none of these bags is new: {took:.1f} s; this process held {held:.0f} MB at most")


def _trial_and_memory(trial: Trial) -> tuple[str, int, float]:
    """How a trial ended, and process and the memory that it holds after it [MB]."""
    with tempfile.TemporaryDirectory() as folder:
        report = run_one(Path(folder), trial)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return report.outcome, os.getpid(), pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory(trials: int, jobs: int) -> None:
    """Print what workers hold along a campaign of all conditions of ``push``."""
    one = make_manifest("push", trials=1)
    manifest = make_manifest("push", trials=-(-trials // len(one.keys)))
    held: dict[int, list[float]] = defaultdict(list)
    outcomes: Counter[str] = Counter()
    start = time.perf_counter()
    with client_of(Workforce(jobs)) as client:
        ended = as_they_end(client, _trial_and_memory, map(manifest.trial, manifest.keys[:trials]))
        for _, (outcome, process, size) in ended:
            held[process].append(size)
            outcomes[outcome] += 1
    print(
        f"{trials} trials of {len(one.keys)} conditions in {time.perf_counter() - start:.0f} s, {dict(outcomes)}; "
        "MB that a worker holds"
    )
    for process, sizes in held.items():
        marks = sorted({min(count, len(sizes)) for count in (1, 10, 100, 250, 500, 750, 1000, len(sizes))})
        print(f"worker {process}: " + ", ".join(f"{sizes[count - 1]:.0f} MB after {count}" for count in marks))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--memory", type=int, metavar="TRIALS", help="memory of workers over so many trials")
    parser.add_argument("--tiny", type=int, metavar="TASKS", help="cost of so many tasks that do nothing")
    parser.add_argument("--rows", type=int, metavar="TRIALS", help="size of a data set of so many trials")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--sizes", type=int, nargs="+", default=[10, 20, 40], help="trials of a campaign")
    parser.add_argument("--scheduler", help="address of a running dask scheduler; its workers count as one row")
    arguments = parser.parse_args()
    if arguments.tiny is not None:
        overhead(arguments.tiny, max(arguments.workers))
    if arguments.memory is not None:
        memory(arguments.memory, max(arguments.workers))
    if arguments.rows is not None:
        data_set(arguments.rows)
    if any(option is not None for option in (arguments.tiny, arguments.memory, arguments.rows)):
        return
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
