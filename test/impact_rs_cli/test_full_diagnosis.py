# SPDX-License-Identifier: Apache-2.0
"""A full diagnosis in a process of its own: it reports its failure, and can be stopped."""

from pathlib import Path

import pytest
from impact_table_cases import arm_table, write_csv

from impact_rs_cli.full_diagnosis import FullDiagnosis


@pytest.fixture
def table(tmp_path: Path) -> Path:
    return write_csv(tmp_path / "hits.csv", *arm_table({}, 2, 1))


def test_a_diagnosis_that_fails_is_reported_with_its_reason_and_command(table: Path, tmp_path: Path) -> None:
    diagnosis = FullDiagnosis(["--impacts", str(table), "--scenario", "push"], tmp_path / "more")
    diagnosis.start("row 99")
    assert diagnosis.running
    found = diagnosis.ended(wait=True)
    assert found is not None and found.verdict == ""
    assert found.words.startswith("exit code 2: ") and "no such run or row" in found.words
    assert found.command.endswith(f"--since 'row 99' -o {tmp_path}/more/diagnosis_since_row_99.json")
    assert not diagnosis.running and diagnosis.ended() is None and not (tmp_path / "more").exists()


@pytest.mark.parametrize("patience", [60.0, 0.0])
def test_a_diagnosis_that_is_stopped_has_ended_and_leaves_nothing(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, patience: float
) -> None:
    """By Ctrl-C, and by a kill where it does not end in time."""
    monkeypatch.setattr("impact_rs_cli.full_diagnosis.PATIENCE", patience)
    diagnosis = FullDiagnosis(["--impacts", str(table), "--scenario", "push"], tmp_path / "more")
    diagnosis.start("row 3")
    process = diagnosis._running.process  # type: ignore[union-attr]
    diagnosis.stop()
    assert process.returncode is not None and not diagnosis.running
    assert not (tmp_path / "more").exists()
