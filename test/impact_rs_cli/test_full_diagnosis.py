# SPDX-License-Identifier: Apache-2.0
"""A full diagnosis in a process of its own: it reports its failure, and can be stopped."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from impact_table_cases import arm_table, write_csv
from processes import until

from impact_rs_cli.full_diagnosis import FullDiagnosis


@pytest.fixture
def table(tmp_path: Path) -> Path:
    return write_csv(tmp_path / "hits.csv", *arm_table({}, 2, 1))


def test_a_diagnosis_that_fails_is_reported_with_its_reason_and_command(table: Path, tmp_path: Path) -> None:
    diagnosis = FullDiagnosis({"impacts": table, "scenario": "push"}, tmp_path / "more")
    diagnosis.start("row 99")
    assert diagnosis.running
    found = diagnosis.ended(wait=True)
    assert found is not None and found.verdict == ""
    assert found.words.startswith("exit code 2: ") and "no such run or row" in found.words
    assert found.command.endswith(f"--impacts {table} --scenario push --since 'row 99'")
    assert f"-o {tmp_path}/more/diagnosis_since_row_99.json" in found.command
    assert not diagnosis.running and diagnosis.ended() is None and not (tmp_path / "more").exists()


@pytest.mark.parametrize("patience", [60.0, 0.0])
def test_a_diagnosis_that_is_stopped_has_ended_and_leaves_nothing(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, patience: float
) -> None:
    """By Ctrl-C, and by a kill where it does not end in time."""
    monkeypatch.setattr("impact_rs_cli.full_diagnosis.PATIENCE", patience)
    diagnosis = FullDiagnosis({"impacts": table, "scenario": "push"}, tmp_path / "more")
    diagnosis.start("row 3")
    process = diagnosis._running.process  # type: ignore[union-attr]
    diagnosis.stop()
    assert process.returncode is not None and not diagnosis.running
    assert not (tmp_path / "more").exists()


FOLLOWING = """
import sys, time
from pathlib import Path
from impact_rs_cli.full_diagnosis import FullDiagnosis
diagnosis = FullDiagnosis({"impacts": sys.argv[1], "scenario": "push"}, Path(sys.argv[2]))
diagnosis.start("row 3")
print(diagnosis._running.process.pid, flush=True)
time.sleep(1000)
"""


@pytest.fixture
def starter(table: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has started a diagnosis, whose id it prints."""
    words = [sys.executable, "-c", FOLLOWING, str(table), str(tmp_path / "more")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def group_of(leader: int) -> list[int]:
    """Processes of a group that still run, those that only wait to be reaped left out."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
        except OSError:  # it has ended meanwhile
            continue
        if int(group) == leader and state not in "ZX":
            found.append(int(path.parent.name))
    return found


def test_a_diagnosis_ends_with_the_process_that_started_it_and_was_killed(
    starter: subprocess.Popen[str], tmp_path: Path
) -> None:
    assert starter.stdout is not None
    leader = int(starter.stdout.readline())
    assert leader in group_of(leader)
    os.kill(starter.pid, signal.SIGKILL)
    starter.wait()
    until(lambda: not group_of(leader), lambda: time.sleep(0.02), "the diagnosis runs on")
    assert not (tmp_path / "more").exists()
