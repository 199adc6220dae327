# SPDX-License-Identifier: Apache-2.0
"""A mistake of the user is one line that says what was meant, exit code 2, and nothing on the disk."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from two_joints import URDF

from impact_rs_cli.main import main
from impact_rs_sim.paths import config_directory

BAG = "cat_food__case_2__s1.000__r0"
PUSH = config_directory() / "scenarios" / "push.yaml"
CAMPAIGN = "campaign push -o {}/new/out"
FRICTION = "friction identify push -o {}/a.yaml --jobs 1"
EXPORT = "export --mjcf {}/new/out.xml --scenario push"
FOLLOW = "follow --impacts CUBES"
FILES = {  # that stand in the folder {} where a line names them
    "file": "in the way",
    "broken.json": "{",
    "arm.urdf": URDF,
    "envelope.yaml": "scenarios: [push]\nspeed: 0.6\nimpulse: 2.0\nforce: 3\n",
    "typo.yaml": "name: m\neffects: [{name: torque_ofset, parameters: {}}]\n",
    "far.yaml": "name: m\neffects: [{name: support_friction, parameters: {friction: {estimate: 900, unit: '-'}}}]\n",
    "unit.yaml": "name: m\neffects: [{name: support_friction, parameters: {friction: {estimate: 1, unit: kg}}}]\n",
    "key.yaml": "name: m\nefects: []\n",
    "mine.yaml": PUSH.read_text().replace("mass: 1.30", "mas: 1.30"),
}

# A command line, and words that its complaint has: option, key, value, unit, file, or the name that was meant. {} is a
# folder; CUBES a table of impacts; RUNS, D and M2 are trials, the diagnosis of them, and the model with what it named.
MISTAKES = {
    "--debug": "COMMAND",
    "anlyze x": "'analyze'",
    "map pus cat_food 2": "'push'",
    "map push catfood 2": "parcel, cat_food, juice|'cat_food'",
    "map push cat_food case_9": "case_1, case_2, case_3",
    "map push cat_food 2 --json --motor-inertia rotro": "'rotor'",
    "map push cat_food 2 --engin": "'--engine'",
    "map push cat_food 2 --enginee bullet": "'--engine'",
    "map push": "SCENARIO OBJECT CASE|--table FILE",
    "map push juice 1 --contact settled --engine bullet": "first contact",
    "map push juice 1 --model nowhere.yaml": "nowhere.yaml",
    "map --table x.csv -o {}/new/out.csv --model nowhere.yaml": "--model",
    "map {}/mine.yaml cat_food 1": "mine.yaml|objects.cat_food.mas|'mass'",
    "study -o {}/new --job 2": "'--jobs'",
    "study-design -o {}/new --draws 1": "--draws|2|1",
    "up pus": "'push'",
    "up push --without plant wall": "'wall'|plant, impact_map",
    "up push --namespace cell,a": "namespace = 'cell,a'",
    "trial push cat_food 2 --scale 0 -o {}/new/out": "velocity scale = 0.0",
    "trial push cat_food 2 --scale fast -o {}/new/out": "--scale|'fast'",
    "campaign -o {}/new/out": "SCENARIO|--plan FILE.yaml",
    "campaign push --plan plan.yaml -o {}/new/out": "SCENARIO|--plan",
    "campaign --plan {}/none.yaml -o {}/new/out": "none.yaml",
    "campaign --plan plan.yaml --order listed -o {}/new/out": "--order|--plan",  # kills: it is ignored without a word
    "campaign push -o {}/new --trials x": "--trials|'x'",
    f"{CAMPAIGN} --trials 0": "--trials|1|0",
    f"{CAMPAIGN} --seed -1": "--seed|0|-1",
    f"{CAMPAIGN} --jobs 0": "--jobs|1|0",
    f"{CAMPAIGN} --jobs 2 --via nodes": "--via inprocess",
    f"{CAMPAIGN} --sensitivity --via nodes": "--via inprocess",
    f"{CAMPAIGN} --plant twin --via nodes": "Bullet",
    f"{CAMPAIGN} --without plant": "--via nodes",
    f"{CAMPAIGN} --via nodes --without plnat": "'plant'",
    f"{CAMPAIGN} --namespace cell_a": "--via nodes",
    f"{CAMPAIGN} --namespace 1st --via nodes": "1st|digit",
    f"{CAMPAIGN} --set control.clamp_forse=3": "'clamp_force'",
    f"{CAMPAIGN} --set control.clamp_force=-3": "control.clamp_force|-3",
    f"{CAMPAIGN} --set trials.many=3": "trials|no keys",
    f"{CAMPAIGN} --set trials": "KEY=VALUE",
    f"{CAMPAIGN} --set trials=[1": "YAML",
    f"{CAMPAIGN} --jobs 2 --scheduler tcp://127.0.0.1:1": "--jobs",
    f"{CAMPAIGN} --scheduler nonsense": "tcp://host:port",
    f"{CAMPAIGN} --objects juce": "'juice'",
    "campaign push -o memory://out --sensitivity": "path",
    "campaign push -o nowhere://out": "nowhere",
    "campaign push -o memory://out --via nodes": "folder of this machine",
    "campaign push -o {}/file/out": "file|cannot be written",
    "design --budget 5 -o {}/new/plan.yaml": "--budget|6",
    "design --budget 9 --scenarios pus": "'push'",
    "design --budget 9 --speed -1": "speed = -1",
    "design --budget 9 --after {}/none.json": "none.json",
    "design --budget 6 --envelope {}/envelope.yaml": "envelope.yaml|force",
    "compare": "RUNS",
    "compare {}": "no usable trials",
    "compare RUNS --model /nowhere.yaml": "/nowhere.yaml|cannot be read",
    "compare RUNS --model {}/typo.yaml": "typo.yaml|'torque_ofset'",
    "compare RUNS --model {}/far.yaml": "far.yaml|900|-100 ... 100",
    "compare RUNS --model {}/unit.yaml": "unit.yaml|unit|kg",
    "compare RUNS --model {}/key.yaml": "key.yaml|efects",
    "compare RUNS --jobs 0": "--jobs|1|0",
    "compare runs --impacts CUBES": "RUNS|runs",
    "compare --impacts CUBES --mapping joint_state": "--mapping",
    "compare --impacts CUBES --mcap {}/mcap": "--mcap|--json",
    "diagnose s3://bucket/push --scheduler tcp://127.0.0.1:1": "folder|workers",
    "diagnose memory://runs": "memory://runs|no bags",
    "diagnose RUNS --effects suport_friction": "'support_friction'",
    "diagnose RUNS --model M2 --effects support_friction": "already",
    "diagnose --impacts nowhere.csv": "nowhere.csv|No such file",
    "diagnose --impacts CUBES --scenario push": "'q1 [rad]'",
    "diagnose runs --scenario push": "--scenario|--impacts",
    "diagnose runs --covariates session": "--covariates|--impacts",
    "diagnose --impacts CUBES --covariates session": "--covariates|'session'",
    "diagnose runs --unsure size_z=0.09:0.11": "--unsure|--impacts",
    "diagnose --impacts CUBES --unsure size_z=0.09": "NAME=LOW:HIGH|size_z=0.09:0.11",
    "diagnose --impacts CUBES --unsure size=0.09:0.11": "'size'",
    "discover memory://runs": "no bags",
    "discover --impacts CUBES --covariates session": "--covariates|'session'",
    "discover {} --effects torque_ofset": "'torque_offset'",
    "discover {} --grammar {}/no.yaml": "no.yaml",
    "discover {} --grammar {}/file": "file",
    "add base_tilt --from D -o {}/new/m.yaml": "'base_tilt'",
    "add support_friction --from /nowhere.json -o {}/new/m.yaml": "/nowhere.json|cannot be read",
    "add support_friction --from {}/broken.json -o {}/new/m.yaml": "broken.json|JSON",
    "add support_friction --from D --model M2 -o {}/new/m.yaml": "'model_2'",
    "add support_friction --from D -o M2": "overwritten",
    "history nominal.yaml": "RUNS",
    "analyze /nowhere/at/all": "/nowhere/at/all|no such folder",
    "analyze memory://push": "folder for the report",
    "analyze {}": "no trials",
    "effects torque_ofset": "'torque_offset'",
    "blind make -1 -o {}/new": "-1",
    "blind make 1 -o {}/new --effect frictoin": "'frictoin'",
    "blind make 1 -o {}/new --scenarios hit_wall": "2 condition(s), expected at least 3",  # a diagnosis holds one out
    "blind score {} --diagnosis D": "no blind campaign",
    "show": "BAG|--live",
    "show {} --no-browser": "metadata.yaml|.mcap",
    "show {}/file --no-browser": "folder of a trial",
    "show {}/nothing -o {}/new/page.html --no-browser": "nothing|no such folder",
    "show {} --live": "BAG",
    "show --live -o {}/new/page.html": "-o",
    "show --live --json": "--json",
    "show --live --namespace cell,a": "namespace = 'cell,a'",
    "show --live --port 70000": "70000|65535",
    "show {} --namespace cell_a": "--namespace",
    "show {} --run run_1": "--run",
    "show {} --experiment {}/file": "--run NAME",
    "friction identify pusch -o {}/a.yaml": "'push'",
    f"{FRICTION} --objects catfood": "cat_food",
    f"{FRICTION} --runs 0": "--runs|1|0",
    f"{FRICTION} --seed -1": "--seed|0|-1",
    f"{FRICTION} --effects {{}}/no.yaml": "no.yaml",
    "friction identify push -o {}/push_compensated.yaml": "copy",
    "friction identify excite -o {}/a.yaml --jobs 1": "hits nothing",
    "friction identify push -o {}/new/a.yaml --runs 0 --jobs 1": "--runs|1|0",
    "friction identify push -o {}/file/a.yaml --jobs 1": "file|cannot be written",
    "workbench {}/file --no-browser": "file|folder",
    "workbench {}/new --port 70000": "70000|65535",
    "export": "nothing to write",
    "export {} -o {}/new/push.txt": ".parquet",
    "export --mjcf {}/new/out.xml": "--scenario",
    f"{EXPORT.replace('.xml', '.txt')} --object cat_food --case 2": ".xml|.mjcf",
    f"{EXPORT.replace('export', 'export RUNS')} --object cat_food --case 2": "twice",
    f"{EXPORT} --object cat --case 2": "'cat'",
    "robot": "ACTION",
    "robot import {}/nothing.urdf -o {}/new/a.yaml": "nothing.urdf|cannot be read",
    "robot import {}/arm.urdf -o {}/new/a.yaml --tip for": "'fore'",
    "robot import {}/arm.urdf -o {}/new/a.txt": ".yaml",
    "robot import {}/arm.urdf": "-o",
    "robot check franka_frr": "franka_fer",
    "robot check franka_fr3 --scenario push": "'push'",
    f"{FOLLOW} --live --json": "--json",
    f"{FOLLOW} --mean-time 0": "hits >= 1",
    f"{FOLLOW} --contact-tolerance -1": ">= 0 m",
    f"{FOLLOW} --state {{}}/file": "file|state file",
    "follow {} --scenario push": "--impacts",
    "investigate {}/d --budget 5": "--budget|6|5",
    "investigate {}/d --kind pair": "--blind SEED",
    "investigate {}/d --blind 3 --via cell --envelope {}/envelope.yaml": "cell",
    "investigate {}/d --blind 3 --kind outside --via nodes": "plant node",
    "investigate {}/d --via cell": "--envelope FILE.yaml",
    "investigate {}/d --yes": "--via cell",
    "investigate {}/d --via cell --envelope {}/envelope.yaml": "envelope.yaml|force",
    "investigate {}/d --blind 3 --effect suport_friction": "'suport_friction'",
    "investigate {}/d --effects suport_friction": "'support_friction'",
    "investigate {}/d --model nowhere.yaml": "nowhere.yaml",
    "investigate {}/d --scenarios nowhere": "nowhere",
    "investigate {}/d --scenarios push grab": "'grab'|2 arms|campaign grab",
    "blind score {}/d": "d|not ended",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_one_line_with_key_value_and_remedy_and_leaves_nothing(
    refused: Callable[..., str], request: pytest.FixtureRequest, tmp_path: Path, line: str
) -> None:
    """Kills: a check of an option that is gone or comes after something was written."""
    there = [name for name in FILES if f"{{}}/{name}" in line]
    for name in there:
        (tmp_path / name).write_text(FILES[name])
    words = line.replace("{}", str(tmp_path)).split()
    known = {"CUBES": "cubes", "RUNS": "hidden_campaign", "D": "diagnosed", "M2": "model_2"}
    said = refused(*(request.getfixturevalue(known[word]) if word in known else word for word in words))
    assert all(word in said for word in MISTAKES[line].split("|")), said
    left = {path.name for path in tmp_path.iterdir()}
    assert left == set(there)


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
    assert "mine.yaml: objects." in line and "letters" in line
    assert os.listdir(tmp_path) == ["mine.yaml"]


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
