# SPDX-License-Identifier: Apache-2.0
"""The gate on what a fast test may cost."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import cost
import pytest


def session_of(path: Path, monkeypatch: pytest.MonkeyPatch, **tests: tuple[float, bool]) -> SimpleNamespace:
    """A session that has passed: seconds of each test, and whether it is slow; a trial takes 2 s."""
    monkeypatch.setattr(cost, "seconds_of_a_trial", lambda: 2.0)
    costs = cost.Costs(path)
    for name, (seconds, slow) in tests.items():
        properties = [(cost.KEY, (seconds, slow))]
        costs.pytest_runtest_logreport(
            SimpleNamespace(when="teardown", nodeid=f"test_x.py::{name}", user_properties=properties)
        )
    session = SimpleNamespace(exitstatus=0)
    costs.pytest_sessionfinish(session)
    return session


def test_a_fast_test_above_the_limit_fails_the_run_and_a_slow_one_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: the limit in seconds instead of trials; slow tests judged as fast ones."""
    cheap = session_of(tmp_path / "a.json", monkeypatch, at_the_limit=(2.0 * cost.LIMIT, False), slow=(60.0, True))
    assert cheap.exitstatus == 0
    assert session_of(tmp_path / "b.json", monkeypatch, above_it=(2.0 * cost.LIMIT + 0.1, False)).exitstatus != 0
    written = json.loads((tmp_path / "a.json").read_text())
    assert written["files"] == {"test_x.py": 30.0 + cost.LIMIT}
    assert cost.read_costs(tmp_path / "a.json") == written["files"]


def test_a_trial_while_other_tests_run_is_the_measure_where_it_is_dearer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record_property: Callable[[str, object], None]
) -> None:
    """Kills: a gate that a machine fails which is idle at the end alone. Measures such a trial for this run."""
    seconds = cost.seconds_of_a_trial()
    assert seconds > 0.0
    record_property(cost.TRIAL, seconds)
    monkeypatch.setattr(cost, "seconds_of_a_trial", lambda: 1.0)
    costs = cost.Costs(tmp_path / "costs.json")
    properties = [(cost.TRIAL, 2.0), (cost.KEY, (7.9, False))]
    costs.pytest_runtest_logreport(
        SimpleNamespace(when="teardown", nodeid="test_x.py::one", user_properties=properties)
    )
    session = SimpleNamespace(exitstatus=0)
    costs.pytest_sessionfinish(session)
    assert session.exitstatus == 0 and costs.dear == {}


def test_costs_can_be_written_as_properties_of_junit(tmp_path: Path) -> None:
    """colcon asks for such a file. Kills: a property that is no pair of name and value, at which pytest ends."""
    (tmp_path / "conftest.py").write_text(
        f"import sys; sys.path.append({str(Path(cost.__file__).parent)!r})\n"
        "from cost import Costs\n\ndef pytest_configure(config):\n    config.pluginmanager.register(Costs(None))\n"
    )
    (tmp_path / "test_one.py").write_text("def test_one():\n    pass\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--junit-xml=found.xml"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout
    assert cost.KEY in (tmp_path / "found.xml").read_text()


def test_processor_time_of_children_counts_whether_they_run_or_have_ended() -> None:
    """Kills: descendants left out."""
    burn = "import time; t = time.process_time()\nwhile time.process_time() < t + 0.3: pass"
    before = cost.processor_time()
    subprocess.run([sys.executable, "-c", burn], check=True)
    ended = cost.processor_time()
    assert ended - before > 0.25  # the kernel counts in ticks of 10 ms
    with subprocess.Popen([sys.executable, "-c", f"{burn}\nprint(flush=True); input()"],
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE) as running:  # fmt: skip
        assert running.stdout is not None
        running.stdout.readline()
        assert cost.processor_time() - ended > 0.25
        running.communicate(b"\n")


def test_what_all_tests_share_is_charged_to_none() -> None:
    """Kills: shared fixtures charged to the test that happens to come first."""
    before = cost.shared_seconds
    with cost.shared():
        sum(range(10_000_000))
    assert cost.shared_seconds - before > 0.05
