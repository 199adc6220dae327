# SPDX-License-Identifier: Apache-2.0
"""``impact-rs follow``: a change on the screen and in the document, a state file, and mistakes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from impact_table_cases import arm_table, write_csv

from impact_rs_cli.main import main


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty-six quiet impacts, then six of a heavier object."""
    header, quiet = arm_table({}, 6, 1)
    _, heavier = arm_table({"object_mass": [1.3]}, 1, 2)
    order = np.random.default_rng(0).permutation(len(quiet))
    rows = [*(quiet[n] for n in order), *heavier]
    return write_csv(tmp_path_factory.mktemp("table") / "hits.csv", header, rows)


def test_a_change_is_announced_with_its_cause_and_the_next_command(
    table: Path, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    model = tmp_path / "now.yaml"
    assert main(["follow", "--impacts", str(table), "--scenario", "push", "-o", str(model)]) == 0
    out = " ".join(capfd.readouterr().out.split())
    assert "CHANGE at row" in out and "object_mass: scale +0." in out
    assert "the object is 0." in out and "kg heavier (object_mass: scale" in out
    assert f"diagnose --impacts {table} --scenario push --since 'row 37' -o " in out
    assert "object_mass.scale" in out and "Next hit of" in out
    assert "name: object_mass" in model.read_text()


def test_the_document_has_every_hit_and_a_later_run_with_the_state_has_none_again(
    table: Path, tmp_path: Path, document: Callable[..., dict[str, Any]]
) -> None:
    words = ("follow", table, "--scenario", "push", "--state", tmp_path / "state.npz")
    first = document(*words)
    assert len(first["hits"]) == 42
    (change,) = [hit["change"] for hit in first["hits"] if hit["change"] is not None]
    assert change["causes"][0]["effect"] == "object_mass"
    again = document(*words)
    assert again["hits"] == []
    assert again["followed"] == first["followed"] and again["prediction"] == first["prediction"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--live", "--json"), "leave --json out"),
        (("--mean-time", "0"), "expected a number of hits >= 1"),
        (("--contact-tolerance", "-1"), "expected a distance >= 0 m"),
    ],
)
def test_a_mistake_is_named(table: Path, refused: Callable[..., str], words: tuple[str, ...], said: str) -> None:
    assert said in refused("follow", "--impacts", table, "--scenario", "push", *words)


def test_a_scenario_goes_with_a_table_only(tmp_path: Path, refused: Callable[..., str]) -> None:
    assert "goes with --impacts only" in refused("follow", tmp_path, "--scenario", "push")


def test_a_state_file_that_is_none_is_named_and_kept(table: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    state = tmp_path / "state.npz"
    state.write_text("mine")
    line = refused("follow", "--impacts", table, "--scenario", "push", "--state", state)
    assert "not a state file" in line and str(state) in line
    assert state.read_text() == "mine"
