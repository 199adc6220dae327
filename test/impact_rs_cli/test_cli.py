# SPDX-License-Identifier: Apache-2.0
"""The command line: exit codes, one-line errors, and a standard output that is JSON and nothing else."""

import json
import logging
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import impact_rs_cli.commands
from impact_rs_cli.main import COMMANDS, PACKAGES, main, parser
from impact_rs_cli.terminal import output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_trials.campaign import FAILURES


def test_map_prints_the_prediction(capfd: pytest.CaptureFixture) -> None:
    assert main(["map", "push", "cat_food", "2"]) == 0
    out, err = capfd.readouterr()
    assert "m/s" in out
    assert not err


@pytest.mark.parametrize("engine", ["bullet", "exact"])
@pytest.mark.parametrize("inertia", ["reduced", "rotor", "zero"])
def test_map_json_is_one_document(capfd: pytest.CaptureFixture, engine: str, inertia: str) -> None:
    assert main(["map", "push", "cat_food", "2", "--engine", engine, "--motor-inertia", inertia, "--json"]) == 0
    document = json.loads(capfd.readouterr().out)
    assert len(document["post"]["end_effector_twist"]["arm"]) == 6
    assert len(document["post"]["joint_velocity"]["arm"]) == 7
    assert len(document["post"]["object_twist"]) == 6
    assert document["contacts"]
    assert document["residual"]
    assert document["engine"] == engine
    assert document["elapsed_ms"] > 0.0


def test_map_tells_the_settled_contact(capfd: pytest.CaptureFixture) -> None:
    speeds = {}
    for contact in ("first", "settled"):
        assert main(["map", "grab", "cat_food", "2", "--contact", contact, "--json"]) == 0
        document = json.loads(capfd.readouterr().out)
        assert document["contact"] == contact
        speeds[contact] = {name: twist[2] for name, twist in document["post"]["end_effector_twist"].items()}
    assert all(speeds["settled"][name] > speeds["first"][name] for name in ("left", "right"))


def test_json_is_pure_in_a_process_of_its_own(push_campaign: Path, tmp_path: Path) -> None:
    """Libraries that print to the C-level standard output must not spoil it."""
    for arguments in (
        ["map", "push", "cat_food", "case_2", "--engine", "bullet", "--json"],
        ["analyze", str(push_campaign), "-o", str(tmp_path / "report"), "--json"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "impact_rs_cli.main", *arguments], capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        assert isinstance(json.loads(done.stdout), dict)
        assert not done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["map", "pus", "cat_food", "2"], "did you mean 'push'"),
        (["map", "push", "catfood", "2"], "parcel, cat_food, juice; did you mean 'cat_food'"),
        (["map", "push", "cat_food", "case_9"], "case_1, case_2, case_3"),
        (["map", "push", "cat_food", "2", "--json", "--motor-inertia", "rotro"], "did you mean 'rotor'"),
        (["map", "push", "cat_food", "2", "--engin"], "expected one argument"),
        (["map", "push", "cat_food", "2", "--enginee", "bullet"], "did you mean '--engine'"),
        (["map", "push"], "expected SCENARIO OBJECT CASE, or --table FILE -o FILE"),
        (
            ["map", "push", "juice", "1", "--contact", "settled", "--engine", "bullet"],
            "are for the first contact only",
        ),
        (["anlyze", "x"], "did you mean 'analyze'"),
        (["--debug"], "required: COMMAND"),
        (["up", "pus"], "did you mean 'push'"),
        (["analyze", "/nowhere/at/all"], "no such folder"),
        (["trial", "push", "cat_food", "2", "--scale", "0", "-o", "{}/new/out"], "velocity scale = 0.0"),
        (["trial", "push", "cat_food", "2", "--scale", "fast", "-o", "{}/new/out"], "invalid float value"),
        (["campaign", "push", "-o", "{}/new/out", "--trials", "0"], "trials = 0"),
        (["campaign", "push", "-o", "{}/new/out", "--seed", "-1"], "seed = -1"),
        (["campaign", "push", "-o", "{}/new/out", "--jobs", "0"], "jobs = 0"),
        (["campaign", "push", "-o", "{}/new/out", "--jobs", "2", "--via", "nodes"], "--via inprocess"),
        (["campaign", "push", "-o", "{}/new/out", "--sensitivity", "--via", "nodes"], "--via inprocess"),
        (["campaign", "push", "-o", "{}/new/out", "--without", "plant"], "--via nodes"),
        (["campaign", "push", "-o", "{}/new/out", "--via", "nodes", "--without", "plnat"], "did you mean 'plant'"),
        (["up", "push", "--without", "plant", "wall"], "no node 'wall'; expected one or more of plant, impact_map"),
        (["campaign", "push", "-o", "{}/new/out", "--namespace", "cell_a"], "--via nodes"),
        (["campaign", "push", "-o", "{}/new/out", "--namespace", "1st", "--via", "nodes"], "begin with no digit"),
        (["up", "push", "--namespace", "cell a"], "namespace = 'cell a'"),
        (["campaign", "push", "-o", "memory://out", "--sensitivity"], "expected a path"),
        (["campaign", "push", "-o", "{}/new/out", "--set", "control.clamp_forse=3"], "did you mean 'clamp_force'"),
        (["campaign", "push", "-o", "{}/new/out", "--set", "control.clamp_force=-3"], "control.clamp_force"),
        (["campaign", "push", "-o", "{}/new/out", "--set", "trials.many=3"], "is a value and has no keys"),
        (["campaign", "push", "-o", "{}/new/out", "--set", "trials"], "expected KEY=VALUE"),
        (["campaign", "push", "-o", "{}/new/out", "--set", "trials=[1"], "not valid YAML"),
        (
            ["campaign", "push", "-o", "{}/new/out", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"],
            "--jobs counts processes of this machine",
        ),
        (["campaign", "push", "-o", "{}/new/out", "--scheduler", "nonsense"], "expected tcp://host:port"),
        (["campaign", "push", "-o", "nowhere://out"], "this URL cannot be used"),
        (["campaign", "push", "-o", "memory://out", "--via", "nodes"], "in a folder of this machine"),
        (
            ["diagnose", "s3://bucket/push", "--scheduler", "tcp://127.0.0.1:1"],
            "must be a folder that all workers can read",
        ),
        (["analyze", "memory://push"], "expected a folder for the report"),
        (["export", "{}", "-o", "{}/new/push.txt"], "ends with .parquet"),
        (["campaign", "push", "-o", "{}/new/out", "--objects", "juce"], "did you mean 'juice'"),
        (["campaign", "push", "-o", "{}/file/out"], "cannot be written"),
        (["analyze", "{}"], "holds no trials"),
        (["show", "{}", "--no-browser"], "neither metadata.yaml nor an .mcap file, and there are none below it"),
        (["show", "{}/file", "--no-browser"], "a file; expected the folder of a trial"),
        (["show"], "expected BAG, the folder of a trial, or --live"),
        (["show", "{}", "--live"], "leave BAG out"),
        (["show", "--live", "-o", "{}/new/page.html"], "leave -o out"),
        (["show", "--live", "--json"], "leave --json out"),
        (["show", "--live", "--namespace", "cell a"], "namespace = 'cell a'"),
        (["show", "--live", "--port", "70000"], "port 70000: expected 0 (a free one) to 65535"),
        (["show", "{}", "--namespace", "cell_a"], "leave --namespace out"),
        (["show", "{}", "--run", "run_1"], "leave --run out"),
        (["show", "{}", "--experiment", "{}/file"], "select one with --run NAME"),
        (
            ["show", "{}/nothing", "-o", "{}/new/page.html", "--no-browser"],
            "no such folder; expected the folder of a trial",
        ),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    capfd: pytest.CaptureFixture, tmp_path: Path, arguments: list[str], message: str
) -> None:
    (tmp_path / "file").write_text("in the way")
    assert main([argument.format(tmp_path) for argument in arguments]) == 2
    out, err = capfd.readouterr()
    assert message in err
    assert err.count("\n") == 1
    assert not out
    assert [path.name for path in tmp_path.iterdir()] == ["file"], "something half-written stays behind"


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches(capsys: pytest.CaptureFixture, command: str) -> None:
    assert main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"example:\n  impact-rs {command}" in text


def test_every_command_is_a_module_and_stands_in_the_help() -> None:
    text = parser().format_help()
    for name, (module, summary) in COMMANDS.items():
        assert (Path(impact_rs_cli.commands.__file__).parent / f"{module}.py").is_file()
        assert name in text
        assert summary in " ".join(text.split())


def _modules_after(*arguments: str) -> set[str]:
    """What a process has imported when a command line has ended in it."""
    code = f"import sys; from impact_rs_cli.main import main; main({list(arguments)!r}); print('MODULES', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.rpartition("MODULES")[2].split())


def test_without_a_command_the_help_is_shown_as_for_a_mistake(
    capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["impact-rs"])
    assert main() == main([]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err == 2 * parser().format_help()


def test_show_names_a_trial_where_a_folder_of_trials_or_a_file_of_one_is_given(
    capsys: pytest.CaptureFixture, push_campaign: Path
) -> None:
    trial = push_campaign / "cat_food__case_2__s0.800__r0"
    assert main(["show", str(push_campaign), "--no-browser"]) == 2
    assert f"there are trials below it, for example {trial}" in capsys.readouterr().err
    assert main(["show", str(next(trial.glob("*.mcap"))), "--no-browser"]) == 2
    assert f"a file; expected the folder of a trial, which holds metadata.yaml; the folder of its trial is {trial}" in (
        capsys.readouterr().err
    )
    assert not list(push_campaign.parent.glob("*.html"))


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_no_command_is_imported_where_none_is_used(option: str) -> None:
    found = _modules_after(option)
    assert not any(name.startswith("impact_rs_cli.commands.") for name in found)
    assert not found & {"numpy", "pydantic", "rich", "rclpy", "pybullet", "pinocchio", "distributed"}


def test_a_command_is_imported_alone_and_waits_for_nothing_that_it_may_not_need() -> None:
    found = _modules_after("map", "--help")
    assert [name for name in found if name.startswith("impact_rs_cli.commands.")] == ["impact_rs_cli.commands.map"]
    assert not found & {
        "scipy.linalg",
        "scipy.optimize",
        "scipy.stats",
        "matplotlib",
        "distributed",
        "rclpy",
        "rosbags",
    }


@pytest.mark.parametrize("arguments", [["--debug", "effects", "no_such"], ["effects", "no_such", "--debug"]])
def test_debug_shows_the_traceback_before_the_line(capfd: pytest.CaptureFixture, arguments: list[str]) -> None:
    assert main(arguments) == 2
    *trace, line = capfd.readouterr().err.splitlines()
    assert line.startswith("impact-rs: no effect 'no_such'")
    assert trace[0].startswith("Traceback")
    assert any("commands/effects.py" in entry for entry in trace)


def test_debug_shows_what_lay_behind_an_error_and_what_was_logged(
    capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_: object) -> None:
        logging.getLogger("impact_rs_trials.something").debug("went round the hole")
        try:
            raise OSError("the disk hums")
        except OSError:
            raise InputError("cannot be read") from None

    monkeypatch.setattr("impact_rs_cli.commands.map.load_scenario", breaks)
    monkeypatch.setattr(logging, "root", logging.RootLogger(logging.WARNING))
    for package in PACKAGES:
        monkeypatch.setattr(logging.getLogger(package), "parent", logging.root)
        monkeypatch.setattr(logging.getLogger(package), "level", logging.NOTSET)
    assert main(["map", "push", "cat_food", "2"]) == 2
    assert capfd.readouterr().err == "impact-rs: cannot be read\n"
    assert main(["map", "push", "cat_food", "2", "--debug"]) == 2
    err = capfd.readouterr().err
    assert "OSError: the disk hums" in err
    assert "impact_rs_trials.something: went round the hole" in err


def test_an_interrupt_ends_with_130(
    capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("impact_rs_cli.commands.campaign.run_campaigns", interrupt)
    assert main(["campaign", "push", "-o", str(tmp_path / "out")]) == 130
    assert "interrupted; the same command goes on where it stopped" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_trial_goes_into_the_folder_and_stands(capfd: pytest.CaptureFixture, tmp_path: Path) -> None:
    arguments = ["trial", "push", "cat_food", "2", "--seed", "3", "-o", str(tmp_path / "a" / "b"), "--json"]
    assert main(arguments) == 0
    document = json.loads(capfd.readouterr().out)
    assert document["outcome"] == "OK"
    assert Path(document["bag"]).is_dir()
    assert main(arguments) == 2
    out, err = capfd.readouterr()
    assert "exists already" in err
    assert not out


def test_a_finished_campaign_has_nothing_to_run(
    push_campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    directory = shutil.copytree(push_campaign, tmp_path / "push")
    scope = ["--objects", "cat_food", "--cases", "case_2", "--scales", "0.8", "1", "1.2", "--trials", "1"]
    assert main(["campaign", "push", "-o", str(directory), *scope, "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["ran"] == 0
    assert main(["campaign", "push", "-o", str(directory), *scope, "--seed", "5"]) == 2
    assert "another campaign" in capfd.readouterr().err


def test_analyze_shows_table_and_report(push_campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    assert main(["analyze", str(push_campaign), "-o", str(tmp_path / "report")]) == 0
    out, err = capfd.readouterr()
    assert "Cat food" in out
    assert "report.html" in out
    assert not err


def test_show_opens_the_page_that_it_wrote_beside_the_bag(
    push_campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: seen.append(address) or True)
    bag = tmp_path / "cat_food__case_2__s1.000__r0"
    shutil.copytree(push_campaign / bag.name, bag)
    assert main(["show", str(bag)]) == 0
    page = tmp_path / f"{bag.name}.html"
    assert seen == [page.as_uri()]
    assert f"page: {page}" in capfd.readouterr().out
    assert main(["show", str(bag), "-o", str(tmp_path / "other.html"), "--no-browser", "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == {"page": str(tmp_path / "other.html")}
    assert len(seen) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([bag.name, page.name, "other.html"])


@pytest.fixture
def laboratory(push_campaign: Path, tmp_path: Path) -> Path:
    """Two runs of a laboratory, as our own bags."""
    folder = tmp_path / "lab"
    folder.mkdir()
    for number, scale in enumerate(("0.800", "1.000"), start=1):
        shutil.copytree(push_campaign / f"cat_food__case_2__s{scale}__r0", folder / f"run_{number}")
    (folder / "runs.csv").write_text("bag,object,kind\nrun_1,cat_food,hit\nrun_2,cat_food,hit\n")
    (folder / "experiment.yaml").write_text("scenario: push\nmapping: impact_rs\n")
    return folder


def show_run(laboratory: Path, *further: str) -> int:
    command = ["show", str(laboratory), "--experiment", str(laboratory / "experiment.yaml"), "--no-browser", *further]
    return main([*command, "--jobs", "1"])


def test_show_writes_a_run_of_a_laboratory_beside_its_folder(laboratory: Path, capfd: pytest.CaptureFixture) -> None:
    assert show_run(laboratory, "--run", "run_1") == 0
    out, err = capfd.readouterr()
    page = laboratory.parent / "lab_run_1.html"
    assert (out, err) == (f"page: {page}\n", "")
    text = page.read_text()
    assert "cat_food is hit; scenario push" in text
    assert "object tracked at " in text
    assert "found at 0.90" in text
    assert '"model":null' in text.replace(" ", "")


def test_show_writes_a_run_of_a_laboratory_beside_what_a_model_does(laboratory: Path) -> None:
    assert show_run(laboratory, "--run", "run_2", "--model", "nominal") == 0
    text = (laboratory.parent / "lab_run_2.html").read_text()
    assert "nominal, from the measured state at the begin of every window" in text
    assert '"model":null' not in text.replace(" ", "")


def test_show_tells_that_nobody_tracked_the_object(laboratory: Path, capfd: pytest.CaptureFixture) -> None:
    mapping = yaml.safe_load((config_directory() / "mappings" / "impact_rs.yaml").read_text())
    del mapping["signals"]["object_pose"]
    (laboratory / "mapping.yaml").write_text(yaml.safe_dump(mapping))
    (laboratory / "experiment.yaml").write_text("scenario: push\nmapping: mapping.yaml\n")
    assert show_run(laboratory, "--run", "run_1") == 0
    assert capfd.readouterr().err == "run_1: the pose of cat_food was not recorded, so it is not shown\n"
    assert "the object was not tracked" in (laboratory.parent / "lab_run_1.html").read_text()


def test_show_of_a_run_that_there_is_not_says_what_was_meant(laboratory: Path, capfd: pytest.CaptureFixture) -> None:
    assert show_run(laboratory, "--run", "rnu_1") == 2
    err = capfd.readouterr().err
    assert err == "impact-rs: run = 'rnu_1': the table of runs names no such run; did you mean 'run_1'?\n"
    assert sorted(path.name for path in laboratory.parent.iterdir()) == ["lab"]


def test_show_says_where_the_page_is_where_there_is_no_browser(
    push_campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("webbrowser.open", lambda address: False)
    assert main(["show", str(push_campaign / "cat_food__case_2__s1.000__r0"), "-o", str(tmp_path / "page.html")]) == 0
    assert "open the page yourself" in capfd.readouterr().err


def test_a_job_that_was_not_done_is_no_success(
    push_campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    name = "cat_food__case_2__s1.000__r0"
    shutil.copytree(push_campaign / name, tmp_path / "one" / name)
    assert main(["analyze", str(tmp_path / "one")]) == 1
    assert "1 trial with impact" in capfd.readouterr().out


def test_a_campaign_with_failures_is_no_success(
    capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def broken(*arguments: object) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr("impact_rs_trials.campaign.run_campaigns.__defaults__", (None, broken))
    scope = ["--objects", "cat_food", "--cases", "2", "--trials", "1", "--scales", "1.0"]
    assert main(["campaign", "push", "-o", str(tmp_path / "out"), *scope]) == 1
    err = capfd.readouterr().err
    assert "by nothing" in err
    assert "Traceback" not in err
    assert f"full error: {tmp_path / 'out' / FAILURES}" in err
    assert main(["campaign", "push", "-o", str(tmp_path / "out"), *scope, "--debug"]) == 1
    assert "in broken" in capfd.readouterr().err


def test_a_single_trial_is_no_campaign(push_campaign: Path, capfd: pytest.CaptureFixture) -> None:
    assert main(["analyze", str(push_campaign / "cat_food__case_2__s1.000__r0")]) == 2
    assert "give the folder it lies in" in capfd.readouterr().err


def test_a_misspelt_key_is_told_by_the_name_that_was_meant(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    text = (config_directory() / "scenarios" / "push.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("mass: 1.30", "mas: 1.30"))
    assert main(["map", str(tmp_path / "mine.yaml"), "cat_food", "1"]) == 2
    assert "objects.cat_food.mas: unknown key; did you mean 'mass'?" in capfd.readouterr().err


def test_hints_are_spelled_as_the_user_called_the_command(push_campaign: Path, tmp_path: Path) -> None:
    directory = shutil.copytree(push_campaign, tmp_path / "push")
    scope = ["--objects", "cat_food", "--cases", "case_2", "--scales", "0.8", "1", "1.2", "--trials", "1"]
    done = subprocess.run(
        [sys.executable, "-m", "impact_rs_cli.main", "campaign", "push", "-o", str(directory), *scope],
        env={**os.environ, "IMPACT_RS_PROGRAM": "./run impact-rs"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert f"next: ./run impact-rs analyze {directory}" in done.stdout


def test_an_output_folder_left_empty_goes_away_with_its_parents(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no"), output_folder(tmp_path / "a" / "b") as folder:
        folder.mkdir(parents=True)
        raise ValueError("no")
    assert not list(tmp_path.iterdir())
    with output_folder(tmp_path / "a" / "b") as folder:
        folder.mkdir(parents=True)
        (folder / "result").write_text("")
    assert (tmp_path / "a" / "b" / "result").exists()


def test_a_trial_that_went_wrong_is_counted_told_and_used_by_nothing(
    capfd: pytest.CaptureFixture, tmp_path: Path
) -> None:
    """The wrist of an FR3 is too light for the dampers of push: joint 7 runs away within milliseconds."""
    out = str(tmp_path / "light")
    scope = ["--objects", "cat_food", "--cases", "2", "--trials", "1", "--scales", "0.8", "1.2", "--jobs", "1"]
    assert main(["campaign", "push", "-o", out, *scope, "--set", "robots.arm.facts=franka_fr3"]) == 1
    told = capfd.readouterr()
    assert "robot check failed, trials may diverge: drive of arm, joint 7" in told.err
    assert "2 of 2 trials are there (2 DIVERGED)" in told.out
    assert re.search(r"DIVERGED 2: arm joint7 at [\d.]+ rad/s against 5.26 rad/s at 0.0\d\d s \(cat_food__", told.err)
    for command in ("analyze", "compare", "diagnose"):
        assert main([command, out, "--jobs", "1"]) == 2
        told = capfd.readouterr()
        assert "DIVERGED: arm joint7 at" in told.err
        assert "Traceback" not in told.err


def test_a_single_trial_that_went_wrong_has_no_net_feedback(capfd: pytest.CaptureFixture, tmp_path: Path) -> None:
    shipped = (config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8")
    scenario = tmp_path / "light.yaml"
    scenario.write_text(shipped.replace("facts: franka_fer", "facts: franka_fr3"), encoding="utf-8")
    assert main(["trial", str(scenario), "cat_food", "2", "-o", str(tmp_path / "one"), "--json"]) == 1
    document = json.loads(capfd.readouterr().out)
    assert (document["outcome"], document["net_feedback_m_s"]) == ("DIVERGED", None)
    assert document["message"].startswith("arm joint7 at")
