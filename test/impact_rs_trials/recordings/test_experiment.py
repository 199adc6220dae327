# SPDX-License-Identifier: Apache-2.0
"""Experiment files and tables of runs: paths, conditions, and every slip of the pen with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import lacking, refusal

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_trials.recordings.experiment import RunRow, load_experiment, read_runs, run_named

HEADER = "bag,object,kind"


def experiment_file(folder: Path, text: str = "scenario: push\n") -> Path:
    path = folder / "experiment.yaml"
    path.write_text(text)
    return path


def runs(folder: Path, *lines: str, header: str = HEADER) -> list[RunRow]:
    """The table of runs of a folder with two bags and two tables."""
    for name in ("run_1", "run_2"):
        (folder / name).mkdir(exist_ok=True)
    for name in ("run_3.csv", "run_4.csv", "run_4.npz"):
        (folder / name).touch()
    (folder / "runs.csv").write_text("\n".join([header, *lines]) + "\n")
    experiment = load_experiment(experiment_file(folder))
    return read_runs(folder, experiment, experiment.load_scenario())


def test_further_columns_become_the_condition_and_endings_may_be_left_out(tmp_path: Path) -> None:
    found = runs(
        tmp_path,
        "run_1, parcel, hit, fast, a",
        "",
        "# run_9 went wrong",
        "run_2, none, free motion, slow, b",
        "run_3, juice, hit, fast, b",
        header=f"{HEADER}, speed, pose",
    )
    assert found == [
        RunRow(tmp_path / "run_1", "parcel", True, "fast/a"),
        RunRow(tmp_path / "run_2", None, False, "slow/b"),
        RunRow(tmp_path / "run_3.csv", "juice", True, "fast/b"),
    ]


def test_without_further_columns_there_is_one_condition(tmp_path: Path) -> None:
    assert [run.condition for run in runs(tmp_path, "run_1,parcel,hit", "run_2,parcel,hit")] == ["", ""]


ROWS = {  # rows of the table of runs: words that the complaint has
    "run_7,parcel,hit": "line 2|bag = 'run_7'|did you mean 'run_",
    "run_1,parcl,hit": "line 2|object = 'parcl'|push|parcel, cat_food",
    "run_1,none,hit": "line 2|object = 'none'|push",
    "run_1,parcel,hits": "line 2|kind = 'hits'|did you mean 'hit'",
    "run_1,none,free_motion": "line 2|kind = 'free_motion'|did you mean 'free motion'",
    "run_1,parcel,free motion": "line 2|object = 'parcel'|'none'",
    "run_1,parcel,hit;;run_1,juice,hit": "line 4|bag = 'run_1'|line 2",
    "run_1,none,free motion;run_1,none,free motion": "line 3|bag = 'run_1'|line 2",
    "run_4,parcel,hit": "line 2|bag = 'run_4'|run_4.csv, run_4.npz",
    ",parcel,hit": "line 2|bag = ''",
    "run_1,parcel": "line 2|2 cells|3",
    'run_1,parcel,"hit;run_2,juice,hit': "line 2|quotation marks",
    '"run_1,parcel,hit;run_2",juice,hit': "line 2|quotation marks",
    "": "bag,object,kind",
}
HEADERS = {
    "bags,object,kind": "line 1|'bag'|did you mean 'bags'|bags, object, kind",
    "bag,object,kind,kind": "'kind'",
    "": "empty|bag, object, kind",
}
EXPERIMENTS = {
    "scenario: psh": "scenario = 'psh'|excite, grab, grab_cylinder, grab_fr3, hit_ball",
    "scenario: push.yaml": "no scenario",
    "{scenario: push, mapping: joint_sate}": "mapping = 'joint_sate'|did you mean",
    "{scenario: push, maping: joint_state}": "maping|did you mean 'mapping'",
    "mapping: joint_state": "scenario|body",
    "{scenario: push, motion_capture: {position: [0, 1]}}": "motion_capture.position",
    "{scenario: push, motion_capture: {bodies: {parcl: {}}}}": "'parcl'",
    "scenario: [push": "YAML|line 2",
}


@pytest.mark.parametrize("rows", ROWS)
def test_a_wrong_row_is_refused_with_line_column_and_value(tmp_path: Path, rows: str) -> None:
    """Kills: a row that is read as another one."""
    lines = rows.split(";") if rows else []
    assert not lacking(refusal(runs, tmp_path, *lines), "runs.csv: |" + ROWS[rows])


@pytest.mark.parametrize("header", HEADERS)
def test_a_wrong_header_is_refused(tmp_path: Path, header: str) -> None:
    assert not lacking(refusal(runs, tmp_path, header=header), "runs.csv: |" + HEADERS[header])


@pytest.mark.parametrize("text", EXPERIMENTS)
def test_a_wrong_experiment_file_is_refused_with_its_key(tmp_path: Path, text: str) -> None:
    said = refusal(load_experiment, experiment_file(tmp_path, text + "\n"))
    assert not lacking(said, "experiment.yaml: |" + EXPERIMENTS[text])


def test_paths_are_seen_from_the_folder_of_the_file(tmp_path: Path) -> None:
    for kind, name in (("scenarios", "push"), ("mappings", "joint_state")):
        (tmp_path / f"{kind}.yaml").write_text((config_directory() / kind / f"{name}.yaml").read_text())
    experiment = load_experiment(experiment_file(tmp_path, "{scenario: scenarios.yaml, mapping: mappings.yaml}\n"))
    assert experiment.load_scenario().name == "push"
    assert experiment.load_mappings(["arm"])["arm"].robot == "franka_fer"


def test_one_experiment_file_may_serve_several_folders_with_a_table_each(tmp_path: Path) -> None:
    experiment = load_experiment(experiment_file(tmp_path))
    for name in ("monday", "tuesday"):
        (tmp_path / name / "run_1").mkdir(parents=True)
        (tmp_path / name / "runs.csv").write_text(f"{HEADER}\nrun_1,parcel,hit\n")
        (run,) = read_runs(tmp_path / name, experiment, experiment.load_scenario())
        assert run.path == tmp_path / name / "run_1"


def test_a_file_for_a_folder_and_a_folder_for_a_file_are_refused(tmp_path: Path) -> None:
    experiment = load_experiment(experiment_file(tmp_path))
    scenario = experiment.load_scenario()
    said = refusal(read_runs, tmp_path / "experiment.yaml", experiment, scenario)
    assert "experiment.yaml: a file where the folder of the recordings is expected" in said
    assert "no such folder" in refusal(read_runs, tmp_path / "nowhere", experiment, scenario)
    assert "a folder where an experiment file is expected" in refusal(load_experiment, tmp_path)
    (tmp_path / "run.csv").touch()
    said = refusal(read_runs, tmp_path, experiment, scenario)
    assert "no table of runs 'runs.csv' in " in said and "; did you mean 'run.csv'" in said


def test_the_motion_capture_is_where_the_robot_is_by_default(tmp_path: Path) -> None:
    assert load_experiment(experiment_file(tmp_path)).motion_capture.placement.isIdentity()
    text = "{scenario: push, motion_capture: {position: [1, 2, 3], rpy: [0, 0, 1.5707963]}}\n"
    placement = load_experiment(experiment_file(tmp_path, text)).motion_capture.placement
    np.testing.assert_allclose(placement.act(np.array([1.0, 0.0, 0.0])), [1.0, 3.0, 3.0], atol=1e-6)


def test_a_run_is_found_by_its_name_with_and_without_the_ending_of_a_file(tmp_path: Path) -> None:
    table = runs(tmp_path, "run_1,parcel,hit", "run_3,juice,hit")
    for name, row in (("run_1", 0), ("run_3", 1), ("run_3.csv", 1)):
        assert run_named(table, tmp_path, name) is table[row]
    said = "run = 'rum_3': the table of runs names no such run; did you mean 'run_3'"
    assert said in refusal(run_named, table, tmp_path, "rum_3")
    assert "no such run; expected one of run_1, run_3" in refusal(run_named, table, tmp_path, "cat_food")


def test_of_runs_that_are_called_alike_one_is_named_by_its_path(tmp_path: Path) -> None:
    for folder in ("monday", "tuesday"):
        (tmp_path / folder / "run_1").mkdir(parents=True)
    table = runs(tmp_path, "monday/run_1,parcel,hit", "tuesday/run_1,parcel,hit")
    said = refusal(run_named, table, tmp_path, "run_1")
    assert "several runs have this name: monday/run_1, tuesday/run_1" in said
    assert run_named(table, tmp_path, "tuesday/run_1") is table[1]


def test_a_normal_of_zero_is_refused(tmp_path: Path) -> None:
    """Kills: a division by its length 0, after which every height is nan."""
    (tmp_path / "e.yaml").write_text("{body: {mass: 1.0, radius: 0.1}, plane: {normal: [0, 0, 0]}, mapping: m}\n")
    with pytest.raises(InputError, match="expected a vector that is not zero") as refusal:
        load_experiment(tmp_path / "e.yaml")
    assert "plane.normal" in str(refusal.value)
