# SPDX-License-Identifier: Apache-2.0
"""A mistake of the user is one line that says what was meant, exit code 2, and nothing on the disk."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_rs_cli.main import main
from impact_rs_sim.paths import config_directory

BAG = "cat_food__case_2__s1.000__r0"
PUSH = config_directory() / "scenarios" / "push.yaml"
CAMPAIGN = "campaign push -o {}/new/out"

FRICTION = "friction identify push -o {}/a.yaml --jobs 1"
MISTAKES = {  # {} is a folder with one file, CUBES a table of impacts
    "map pus cat_food 2": "did you mean 'push'",
    "map push catfood 2": "parcel, cat_food, juice; did you mean 'cat_food'",
    "map push cat_food case_9": "case_1, case_2, case_3",
    "map push cat_food 2 --json --motor-inertia rotro": "did you mean 'rotor'",
    "map push cat_food 2 --engin": "did you mean '--engine'",
    "map push cat_food 2 --enginee bullet": "did you mean '--engine'",
    "study -o {}/new --job 2": "did you mean '--jobs'",
    "map push": "expected SCENARIO OBJECT CASE, or --table FILE -o FILE",
    "map push juice 1 --contact settled --engine bullet": "are for the first contact only",
    "map push juice 1 --model nowhere.yaml": "nowhere.yaml",
    "map --table x.csv -o {}/new/out.csv --model nowhere.yaml": "--model is for one prediction",
    "anlyze x": "did you mean 'analyze'",
    "--debug": "required: COMMAND",
    "up pus": "did you mean 'push'",
    "up push --without plant wall": "no node 'wall'; expected one or more of plant, impact_map",
    "up push --namespace cell,a": "namespace = 'cell,a'",
    "trial push cat_food 2 --scale 0 -o {}/new/out": "velocity scale = 0.0",
    "trial push cat_food 2 --scale fast -o {}/new/out": "invalid float value",
    "campaign -o {}/new/out": "expected a SCENARIO, or --plan FILE.yaml",
    "campaign push --plan plan.yaml -o {}/new/out": "SCENARIO and --plan exclude each other",
    "campaign --plan {}/none.yaml -o {}/new/out": "none.yaml",
    "design --budget 5 -o {}/new/plan.yaml": "expected at least 6",
    "study-design -o {}/new --draws 1": "argument --draws: expected at least 2, got 1",
    "campaign push -o {}/new --trials x": "argument --trials: invalid int value: 'x'",
    "design --budget 9 --scenarios pus": "did you mean 'push'",
    "design --budget 9 --speed -1": "speed = -1",
    "design --budget 9 --after {}/none.json": "none.json",
    f"{CAMPAIGN} --trials 0": "argument --trials: expected at least 1, got 0",
    f"{CAMPAIGN} --seed -1": "argument --seed: expected at least 0, got -1",
    f"{CAMPAIGN} --jobs 0": "argument --jobs: expected at least 1, got 0",
    f"{CAMPAIGN} --jobs 2 --via nodes": "--via inprocess",
    f"{CAMPAIGN} --sensitivity --via nodes": "--via inprocess",
    f"{CAMPAIGN} --plant twin --via nodes": "the plant node runs Bullet",
    f"{CAMPAIGN} --without plant": "--via nodes",
    f"{CAMPAIGN} --via nodes --without plnat": "did you mean 'plant'",
    f"{CAMPAIGN} --namespace cell_a": "--via nodes",
    f"{CAMPAIGN} --namespace 1st --via nodes": "begin with no digit",
    f"{CAMPAIGN} --set control.clamp_forse=3": "did you mean 'clamp_force'",
    f"{CAMPAIGN} --set control.clamp_force=-3": "control.clamp_force",
    f"{CAMPAIGN} --set trials.many=3": "is a value and has no keys",
    f"{CAMPAIGN} --set trials": "expected KEY=VALUE",
    f"{CAMPAIGN} --set trials=[1": "not valid YAML",
    f"{CAMPAIGN} --jobs 2 --scheduler tcp://127.0.0.1:1": "--jobs counts processes of this machine",
    f"{CAMPAIGN} --scheduler nonsense": "expected tcp://host:port",
    f"{CAMPAIGN} --objects juce": "did you mean 'juice'",
    "campaign push -o memory://out --sensitivity": "expected a path",
    "campaign push -o nowhere://out": "this URL cannot be used",
    "campaign push -o memory://out --via nodes": "in a folder of this machine",
    "campaign push -o {}/file/out": "cannot be written",
    "diagnose s3://bucket/push --scheduler tcp://127.0.0.1:1": "must be a folder that all workers can read",
    "diagnose memory://runs": "memory://runs: no bags of trials here",
    "analyze /nowhere/at/all": "no such folder",
    "analyze memory://push": "expected a folder for the report",
    "analyze {}": "holds no trials",
    "compare": "nothing to read; expected RUNS",
    "history nominal.yaml": "nothing to read; expected RUNS",
    "export {} -o {}/new/push.txt": "ends with .parquet",
    "effects torque_ofset": "did you mean 'torque_offset'",
    "blind make -1 -o {}/new": "",
    "blind make 1 -o {}/new --effect frictoin": "no effect",
    "show {} --no-browser": "neither metadata.yaml nor an .mcap file, and there are none below it",
    "show {}/file --no-browser": "a file; expected the folder of a trial",
    "show": "expected BAG, the folder of a trial, or --live",
    "show {} --live": "leave BAG out",
    "show --live -o {}/new/page.html": "leave -o out",
    "show --live --json": "leave --json out",
    "show --live --namespace cell,a": "namespace = 'cell,a'",
    "show --live --port 70000": "port 70000: expected 0 (a free one) to 65535",
    "show {} --namespace cell_a": "leave --namespace out",
    "show {} --run run_1": "leave --run out",
    "show {} --experiment {}/file": "select one with --run NAME",
    "show {}/nothing -o {}/new/page.html --no-browser": "no such folder; expected the folder of a trial",
    "compare runs --impacts CUBES": "takes the place of RUNS; leave runs out",
    "diagnose --impacts nowhere.csv": "nowhere.csv: cannot be read: No such file or directory",
    "diagnose --impacts CUBES --scenario push": "no column 'q1 [rad]'",
    "diagnose runs --scenario push": "--scenario goes with --impacts only",
    "diagnose runs --covariates session": "--covariates goes with --impacts only",
    "diagnose --impacts CUBES --covariates session": "--covariates: no column 'session'",
    "diagnose runs --unsure size_z=0.09:0.11": "--unsure goes with --impacts only",
    "diagnose --impacts CUBES --unsure size_z=0.09": "expected NAME=LOW:HIGH, for example size_z=0.09:0.11",
    "diagnose --impacts CUBES --unsure size=0.09:0.11": "nothing called 'size' can be unsure here",
    "compare --impacts CUBES --mapping joint_state": "--mapping is for recordings",
    "compare --impacts CUBES --mcap {}/mcap": "--mcap is for trials; for tables of impacts use --json",
    "discover memory://runs": "no bags of trials here",
    "discover --impacts CUBES --covariates session": "--covariates: no column 'session'",
    "discover {} --effects torque_ofset": "did you mean 'torque_offset'",
    "discover {} --grammar {}/no.yaml": "no.yaml",
    "discover {} --grammar {}/file": "file",
    "friction identify pusch -o {}/a.yaml": "did you mean 'push'",
    f"{FRICTION} --objects catfood": "cat_food",
    f"{FRICTION} --runs 0": "argument --runs: expected at least 1, got 0",
    f"{FRICTION} --seed -1": "argument --seed: expected at least 0, got -1",
    f"{FRICTION} --effects {{}}/no.yaml": "no.yaml",
    "friction identify push -o {}/push_compensated.yaml": "name of the scenario's copy",
    "friction identify excite -o {}/a.yaml --jobs 1": "hits nothing",
    "friction identify push -o {}/new/a.yaml --runs 0 --jobs 1": "argument --runs: expected at least 1, got 0",
    "friction identify push -o {}/file/a.yaml --jobs 1": "cannot be written",
    "workbench {}/file --no-browser": "is a file; expected a folder for the workbench",
    "workbench {}/new --port 70000": "port 70000: expected 0 (a free one) to 65535",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_nothing(
    refused: Callable[..., str], cubes: Path, tmp_path: Path, line: str
) -> None:
    (tmp_path / "file").write_text("in the way")
    assert MISTAKES[line] in refused(*line.replace("{}", str(tmp_path)).replace("CUBES", str(cubes)).split())
    written = [path.name for path in tmp_path.iterdir() if not line.startswith("workbench")]
    assert written in (["file"], [])


@pytest.mark.parametrize(
    "arguments",
    [
        ["trial", "push", "cat_food", "2", "-o", ""],
        ["compare", "runs", "--mcap="],
        ["analyze", ""],
        ["campaign", "push", "-o", "x", "--objects", ""],
    ],
)
def test_an_empty_argument_is_no_path(refused: Callable[..., str], arguments: list[str]) -> None:
    assert "an argument is empty" in refused(*arguments)


def test_results_go_neither_into_a_bag_nor_over_an_input(
    push_campaign: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    bag, before = push_campaign / BAG, sorted(push_campaign.rglob("*"))
    for arguments in (
        ["trial", "push", "cat_food", "case_2", "-o", bag],
        ["campaign", "push", "-o", bag / "new" / "place"],
        ["analyze", push_campaign, "-o", bag],
        ["export", push_campaign, "-o", bag / "x.parquet"],
        ["compare", push_campaign, "--mcap", bag],
        ["diagnose", push_campaign, "--report", bag],
    ):
        assert "lies inside the bag" in refused(*arguments)
    assert "is an input of this command" in refused("analyze", push_campaign, "-o", push_campaign)
    model = Path(shutil.copy(config_directory() / "models" / "nominal.yaml", tmp_path / "model.yaml"))
    text, again = model.read_text(), tmp_path / "." / "model.yaml"
    assert "is an input of this command" in refused("diagnose", push_campaign, "--model", model, "-o", again)
    assert model.read_text() == text
    assert sorted(push_campaign.rglob("*")) == before


@pytest.mark.parametrize("name", ["../../escaped/o", ".hidden", '"><script>document.title=1</script>'])
def test_an_object_whose_name_is_a_path_or_markup_is_refused(
    tmp_path: Path, refused: Callable[..., str], name: str
) -> None:
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(PUSH.read_text().replace("  cat_food:", f"  '{name}':"))
    line = refused("campaign", scenario, "-o", tmp_path / "a" / "b" / "out")
    assert "mine.yaml: objects." in line and "expected a name of letters" in line
    assert os.listdir(tmp_path) == ["mine.yaml"]


def test_a_misspelt_key_names_the_key_that_was_meant(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "mine.yaml").write_text(PUSH.read_text().replace("mass: 1.30", "mas: 1.30"))
    line = refused("map", tmp_path / "mine.yaml", "cat_food", 1)
    assert "objects.cat_food.mas: unknown key; did you mean 'mass'?" in line


def test_show_names_a_trial_near_a_path_that_is_none(push_campaign: Path, refused: Callable[..., str]) -> None:
    trial = push_campaign / "cat_food__case_2__s0.800__r0"
    assert f"there are trials below it, for example {trial}" in refused("show", push_campaign, "--no-browser")
    assert f"which holds metadata.yaml; the folder of its trial is {trial}" in refused(
        "show", next(trial.glob("*.mcap")), "--no-browser"
    )
    assert "give the folder it lies in" in refused("analyze", push_campaign / BAG)
    assert not list(push_campaign.parent.glob("*.html"))


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PermissionError(13, "Permission denied", "/there"), "/there: Permission denied"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (UnicodeEncodeError("utf-8", "\ud800", 0, 1, "surrogates not allowed"), "surrogates not allowed"),
        (RecursionError("maximum recursion depth exceeded"), "nested too deeply"),
        (MemoryError(), "memory"),
    ],
)
def test_an_error_of_the_system_is_one_line_and_with_debug_a_traceback(
    error: Exception,
    said: str,
    refused: Callable[..., str],
    capfd: pytest.CaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(*arguments: object) -> None:
        raise error

    monkeypatch.setattr("impact_rs_cli.terminal.check_outputs", broken)
    assert said in refused("effects")
    assert main(["effects", "--debug"]) == 2
    assert "Traceback" in capfd.readouterr().err
