# SPDX-License-Identifier: Apache-2.0
"""What each test costs: processor time with all descendants, in trials (``impact-rs trial push``) of the same machine.

``./run test --cost=FILE`` writes it and refuses fast tests that cost more than ``LIMIT`` trials. A ratio of processor
times says the same on a fast machine and on a slow one; wall time, on a shared machine, says nothing.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

# Trials. A fast test is meant to cost three at most; on shared machines the same suite was 416, 458 and 617 trials.
LIMIT = 6.0
WORTH_SAYING = 0.5  # trials: what costs less is left out of the file
TICKS = os.sysconf("SC_CLK_TCK")
KEY, TRIAL = "cost", "seconds of a trial"
COMMAND = "import sys; from impact_rs_cli.main import main; sys.exit(main(sys.argv[1:]))"

shared_seconds = 0.0  # processor seconds of this process for what all tests share


def processor_time() -> float:
    """Processor seconds of this process and all of its descendants, with those that have ended and were waited for."""
    seconds, children = {}, defaultdict(list)
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                fields = Path("/proc", entry, "stat").read_text(errors="replace").rpartition(")")[2].split()
            except OSError:
                continue  # ended in the meantime
            children[int(fields[1])].append(int(entry))
            seconds[int(entry)] = sum(map(int, fields[11:15])) / TICKS
    total, family = 0.0, [os.getpid()]
    while family:
        process = family.pop()
        total += seconds.get(process, 0.0)
        family += children[process]
    return total


@contextmanager
def shared() -> Iterator[None]:
    """What is made here is made once for all tests, and charged to none."""
    global shared_seconds
    before = processor_time()
    yield
    shared_seconds += processor_time() - before


def seconds_of_a_trial() -> float:
    """Processor seconds of one trial in one process, recorded, as a user starts it."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-c", COMMAND, "trial", "push", "cat_food", "case_2", "-o", folder],
            check=True,
            capture_output=True,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def read_costs(path: Path) -> dict[str, float]:
    """Trials by file, as an earlier run has measured them; empty without one."""
    return json.loads(path.read_text())["files"] if path.exists() else {}


class Costs:
    """Plugin: measures every test in the process that runs it, and adds up where results are collected."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.seconds: dict[str, float] = defaultdict(float)
        self.slow: set[str] = set()
        self.dear: dict[str, float] = {}
        self.trial = 0.0  # s, measured while other tests ran
        self._began = (0.0, 0.0)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self) -> Iterator[None]:
        """Remember what had been used before the test."""
        self._began = processor_time(), shared_seconds
        yield

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
        """Add the cost to the last report of the test, which goes to the process that collects."""
        outcome = yield
        if call.when == "teardown":
            used = processor_time() - self._began[0] - (shared_seconds - self._began[1])
            outcome.get_result().user_properties.append((KEY, (used, item.get_closest_marker("slow") is not None)))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect."""
        for name, value in report.user_properties if report.when == "teardown" else ():
            if name == TRIAL:
                self.trial = value
            if name == KEY:
                used, slow = value
                self.seconds[report.nodeid] += used
                if slow:
                    self.slow.add(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the file, and fail where a fast test is dear.

        A trial costs more while other processes take the other half of a core: the dearer of two counts.
        """
        if self.path is None:
            return
        trial = max(self.trial, seconds_of_a_trial())
        trials = {test: seconds / trial for test, seconds in self.seconds.items()}
        files: dict[str, float] = defaultdict(float)
        for test, cost in trials.items():
            files[test.partition("::")[0]] += cost
        document = {
            "trial_s": round(trial, 3),
            "trials": round(sum(trials.values()), 1),
            "files": _worth_saying(files),
            "tests": _worth_saying(trials),
        }
        self.path.write_text(json.dumps(document, indent=1) + "\n")
        self.dear = {test: cost for test, cost in trials.items() if cost > LIMIT and test not in self.slow}
        if self.dear and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Name the dear ones."""
        if self.path is None:
            return
        terminalreporter.write_line(f"processor time of all tests: {sum(self.seconds.values()):.0f} s; see {self.path}")
        for test, cost in sorted(self.dear.items(), key=lambda item: -item[1]):
            terminalreporter.write_line(
                f"TOO DEAR {test}: {cost:.1f} trials, {LIMIT:g} allowed; make it cheaper or mark it slow", red=True
            )


def _worth_saying(trials: dict[str, float]) -> dict[str, float]:
    """The dear ones, dearest first."""
    ranked = sorted(trials.items(), key=lambda item: -item[1])
    return {name: round(cost, 2) for name, cost in ranked if cost >= WORTH_SAYING}
