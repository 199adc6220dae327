# SPDX-License-Identifier: Apache-2.0
"""Editing YAML files: what is not changed stays, and what is new is read as what it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.schema import parse_yaml
from impact_rs_trials.edited_yaml import Noted, edited_text, in_one_line, read_edited, rounded, row, scalar, section

SCENARIOS = sorted((config_directory() / "scenarios").glob("push*.yaml"))


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_a_file_that_is_not_changed_stays_as_it_is(path: Path) -> None:
    """Kills a writer that loses comments, empty lines or the spelling of numbers (0.60, 2.0e5)."""
    text = path.read_text(encoding="utf-8")
    content = read_edited(path)
    assert [line.split() for line in edited_text(content).splitlines()] == [line.split() for line in text.splitlines()]


def test_a_changed_value_keeps_the_comment_behind_it(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("# head\na: 1.50       # m, why\n\nb: {c: yes}   # d\n# tail\n")
    content = read_edited(path)
    content["a"] = rounded(2.0 / 3.0)
    assert edited_text(content) == "# head\na: 0.666667   # m, why\n\nb: {c: yes}   # d\n# tail\n"


@pytest.mark.parametrize(
    "text", ["on", "No", "null", "3", "1_000", "12:30", "2026-11-25", "a: b", "a #b", "*x", "", " a", "a b"]
)
def test_a_new_text_is_read_as_that_text(text: str) -> None:
    """Kills a writer of YAML 1.2: a reader of YAML 1.1 takes ``on`` for true and ``12:30`` for 750."""
    assert parse_yaml(edited_text(section({"key": scalar(text)})), "file") == {"key": text}


def test_a_new_number_is_read_as_that_number() -> None:
    """Kills ``1e-05`` without a decimal point, which a reader of YAML 1.1 takes for a text."""
    made = section(
        {"small": Noted(1e-5, "m"), "row": row([1e-7, 1e22, -0.0, 1.0 / 3.0]), "flat": in_one_line({"a": 1e-9})}
    )
    expected = {"small": 1e-5, "row": [1e-7, 1e22, 0.0, 0.333333], "flat": {"a": 1e-9}}
    assert parse_yaml(edited_text(made), "file") == expected
    assert "-0.0" not in edited_text(made)


def test_long_lines_are_not_broken() -> None:
    """Kills the width of 80 characters at which lists in one line would go on in the next."""
    assert len(edited_text(section({"row": row([0.123456] * 40)})).splitlines()) == 1


def test_what_cannot_be_edited_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("a: 1\na: 2\n")
    with pytest.raises(InputError, match="cannot be edited") as caught:
        read_edited(path)
    assert caught.value.file == str(path)
    assert "\n" not in str(caught.value)
