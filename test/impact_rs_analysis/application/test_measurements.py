# SPDX-License-Identifier: Apache-2.0
"""Measurements of any kind are opened by one function, which command line and Python call."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from impact_table_cases import CUBE_HEADER, cube, cube_rows, write_csv

from impact_rs_analysis.application.loop_steps import compare_measurements
from impact_rs_analysis.application.measurements import (
    MeasurementKind,
    MeasurementOptions,
    open_measurements,
    read_trials,
)
from impact_rs_analysis.application.observer import MAX_SHOWN_FILES, Silent, warn_skipped
from impact_rs_cli.main import main
from impact_rs_sim.model import load_model


class Listener(Silent):
    """Keeps warnings."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def warn(self, text: str) -> None:
        self.warnings.append(text)


def test_the_kind_of_measurements_follows_from_the_options_and_from_what_is_there(tmp_path: Path) -> None:
    """Kills a branch that looks into the files before it looks at the options."""
    (tmp_path / "empty").mkdir()
    table, experiment = tmp_path / "table.csv", tmp_path / "experiment.yaml"
    table.write_text("time,q1\n0,0\n")
    kinds = {
        MeasurementKind.IMPACTS: MeasurementOptions(impacts=table),
        MeasurementKind.LABORATORY: MeasurementOptions(runs=tmp_path, experiment=experiment),
        MeasurementKind.RECORDINGS: MeasurementOptions(runs=tmp_path),
        MeasurementKind.TRIALS: MeasurementOptions(runs=tmp_path / "empty"),
    }
    assert {kind: options.kind for kind, options in kinds.items()} == {kind: kind for kind in kinds}
    assert MeasurementOptions(runs=tmp_path / "empty", mapping="franka_fer").kind == MeasurementKind.RECORDINGS


def test_an_experiment_file_in_the_folder_describes_its_runs(tmp_path: Path) -> None:
    """Kills hits that are read as free motion, whose contact force then becomes a payload of many kilograms."""
    (tmp_path / "log.csv").write_text("time,q1\n0,0\n")
    (tmp_path / "experiment.yaml").write_text("scenario: push\n")
    assert MeasurementOptions(runs=tmp_path).experiment == tmp_path / "experiment.yaml"
    assert MeasurementOptions(runs=tmp_path).kind == MeasurementKind.LABORATORY
    for given in ({"mapping": "franka_fer"}, {"minus": tmp_path}):
        assert MeasurementOptions(runs=tmp_path, **given).kind == MeasurementKind.RECORDINGS


def test_python_and_command_line_find_the_same_in_a_table_of_impacts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kills an option that the command line does not hand on, here the rows since one of them."""
    table = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(), 12))
    options = MeasurementOptions(impacts=table, since="row 6")
    found = compare_measurements(open_measurements(options), load_model("nominal")).model_dump(mode="json")
    assert main(["compare", "--impacts", str(table), "--since", "row 6", "--jobs", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == found
    assert found["trials"] < 12


def test_bags_that_were_left_out_are_warned_of_and_only_the_first_by_name() -> None:
    """Kills a list of a thousand warnings, and a path that is repeated in its reason."""
    listener = Listener()
    warn_skipped([(f"/runs/{name}", f"/runs/{name}: cut off") for name in range(MAX_SHOWN_FILES + 2)], listener)
    assert listener.warnings[0] == "left out 0: cut off"
    assert listener.warnings[MAX_SHOWN_FILES:] == ["left out 2 more bags; --json lists all"]


def test_few_runs_are_read_without_worker_processes(hidden_campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def map_tasks(function: Callable, items: Sequence[Path]) -> Iterator:
        asked.append(len(items))
        return map(function, items)

    few = read_trials(hidden_campaign, map_tasks)
    assert asked == []
    monkeypatch.setattr("impact_rs_analysis.application.measurements.MIN_PARALLEL_RUNS", len(few.runs))
    many = read_trials(hidden_campaign, map_tasks)
    assert asked == [len(few.runs)]
    assert [run.path for run in many.runs] == [run.path for run in few.runs]
