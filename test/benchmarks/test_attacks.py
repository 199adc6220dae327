# SPDX-License-Identifier: Apache-2.0
"""A part of the attack campaign on the readers of raw files: no exception, and no other numbers without a word."""

from __future__ import annotations

from pathlib import Path

import pytest

attacks = pytest.importorskip("benchmarks.attacks.campaign", reason="run from the root of the repository")

IMPORTED = ("nan", "huge", "lost rows", "comma for point", "swapped columns", "utf-16", "gzip", "link to itself")
BAGS = ("half of it in a file that is not named", "file: cut at the end", "swapped numbers later", "shuffled")
MAT = ("7.3, texts", "complex", "an array of structures", "int64 stamps in ns")
TABLES = ("huge", "short row", "latin-1", "underscore")


def chosen() -> list[attacks.Case]:
    """Attacks by what they found once, one of each kind."""
    wanted = [("import", ".csv", name) for name in IMPORTED]
    wanted += [("import", ".npz", name) for name in ("complex", "huge", "objects", "cut")]
    wanted += [("compare --impacts", ".csv", name) for name in TABLES]
    wanted += [("import", ".db3", name) for name in BAGS]
    wanted += [("import", attacks.MATLAB, name) for name in MAT]
    wanted += [("impacts", ".csv", "column of zeros")]
    return [attacks.Case(number, *words) for number, words in enumerate(wanted)]


def test_damaged_files_are_refused_or_read_as_they_are_or_spoken_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "2000")
    found = attacks.campaign(chosen(), seed=7, folder=tmp_path)
    wrong = [f"{case.verdict} {case.name}: {case.why}" for case in found if case.verdict in ("silent", "broken")]
    assert not wrong
    verdicts = {(case.command, case.attack): case.verdict for case in found}
    assert verdicts["import", "comma for point"] == "same"
    assert verdicts["import", "gzip"] == verdicts["import", "utf-16"] == "refused"
    assert verdicts["import", "lost rows"] == "said"
    assert verdicts["import", BAGS[0]] == verdicts["import", "swapped numbers later"] == "said"
    assert verdicts["import", "file: cut at the end"] == verdicts["import", "7.3, texts"] == "refused"
    assert verdicts["import", "int64 stamps in ns"] == "same"
    assert verdicts["impacts", "column of zeros"] == "said"


def test_a_silent_change_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that says nothing: the campaign sees what it does."""
    monkeypatch.setenv("COLUMNS", "2000")
    scene = attacks.Scene(tmp_path)
    answers = iter([attacks.Answer(0, "read", numbers="1"), attacks.Answer(0, "read", numbers="2")])
    monkeypatch.setattr(scene, "run", lambda case, path: next(answers))
    assert scene.judge(attacks.Case(0, "impacts", ".csv", "nan"), 1).verdict == "silent"
