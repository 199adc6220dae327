# SPDX-License-Identifier: Apache-2.0
"""What import writes is what a reader of YAML reads, whatever columns are called."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from impact_rs_trials.recordings.import_texts import Line, flow, mapping_text

NAMES = [
    "on", "off", "On", "OFF", "null", "Null", "true", "True", "No", "Yes", "y", "N", "a ", " a", "a b", "q.1", "a: b",
    "a #b", "[q]", "a,b", "1e3", "_1", "0x1f", ".inf", "nan", "~", "-", "q/1", "{joint}", "é", "'q'", '"q"', "",
]  # fmt: skip


def both(text: str) -> list[object]:
    """What readers of YAML 1.1 and 1.2 read."""
    return [yaml.safe_load(text), YAML(typ="safe").load(text)]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_read_back_as_it_is(name: str) -> None:
    assert both(f"column: {flow(name)}") == [{"column": name}] * 2
    assert both(f"columns: {flow([name, name])}") == [{"columns": [name, name]}] * 2
    assert both(f"time: {flow({'column': name})}") == [{"time": {"column": name}}] * 2


@given(name=st.text(st.characters(exclude_categories=["Cs", "Cc"])))
def test_any_name_is_read_back_as_it_is(name: str) -> None:
    assert both(f"columns: {flow([name])}") == [{"columns": [name]}] * 2


@pytest.mark.parametrize("value", [1e-5, 3e10, 2.5e-7, 0.1, 3.0, -4e-6, True, False, 12])
def test_numbers_stay_numbers(value: float) -> None:
    assert both(f"value: {flow(value)}") == [{"value": value}] * 2


def test_plain_names_stay_without_quotation_marks() -> None:
    text = mapping_text({"robot": "ur10e", "signals": {"position": {"column": "q"}}}, [Line("robot", "ur10e", "given")])
    assert "robot: ur10e   # given" in text and "column: q\n" in text
