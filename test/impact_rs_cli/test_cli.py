# SPDX-License-Identifier: Apache-2.0
"""The command line: help, exit codes, one document of JSON, and what each command prints and writes."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from trials import made_up

import impact_rs_cli.commands
from impact_rs_analysis.measure.analyze import ExperimentSet
from impact_rs_cli.main import PACKAGES, main, parser
from impact_rs_cli.parser import PROGRAM
from impact_rs_cli.reading import experiment_file
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_commands import COMMANDS
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import CONTACTS, DEFAULT_ENGINE, ENGINES
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, RESTITUTION_LAWS
from impact_rs_sim.progress import VARIABLE as PROGRESS_FILE
from impact_rs_trials import blind, scenario_draft
from impact_rs_trials.campaign import FAILURES

BAG = "cat_food__case_2__s1.000__r0"
SCOPE = ["--objects", "cat_food", "--cases", "case_2", "--trials", "1"]
Document = Callable[..., dict[str, Any]]


def process(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    """A command in a process of its own."""
    words = [sys.executable, "-m", "impact_rs_cli.main", *arguments]
    return subprocess.run(words, env=os.environ | environment, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches(capsys: pytest.CaptureFixture, command: str) -> None:
    assert main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"\n\nexample:\n  {PROGRAM} {command}" in text
    assert re.search(r"\n\noutput: \S", text)


def test_every_command_is_a_module_and_stands_in_the_help() -> None:
    text = parser().format_help()
    for name, command in COMMANDS.items():
        assert (Path(impact_rs_cli.commands.__file__).parent / f"{command.file}.py").is_file()
        assert name in text
        assert command.summary in " ".join(text.split())


def test_choices_are_those_of_the_physics() -> None:
    """Declarations import nothing, so that they repeat a few words."""
    offered = {
        (name, option.name): (option.choices, option.default)
        for name, command in COMMANDS.items()
        for below in command.actions or (command,)
        for option in below.options
    }
    for name in ("map", "analyze", "study"):
        assert offered[name, "contact"] == (CONTACTS, CONTACTS[0])
    assert offered["map", "engine"] == (tuple(ENGINES), DEFAULT_ENGINE)
    assert offered["map", "motor_inertia"] == (MOTOR_INERTIA_MODELS, MOTOR_INERTIA_MODELS[0])
    assert offered["map", "restitution_law"] == (RESTITUTION_LAWS, None)
    assert offered["scenario", "kind"] == (scenario_draft.KINDS, "push")
    assert offered["blind", "kind"] == (blind.KINDS, blind.KINDS[0])
    assert offered["blind", "scenarios"] == ((), blind.SCENARIOS)


def test_without_a_command_the_help_is_shown_as_for_a_mistake(
    capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["impact-rs"])
    assert main() == main([]) == 2
    assert capsys.readouterr() == ("", 2 * parser().format_help())


def modules_after(words: str) -> set[str]:
    """Modules that a process has imported when a command line has ended in it."""
    code = f"import sys; from impact_rs_cli.main import main; main({words.split()!r}); print('MODULES', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.rpartition("MODULES")[2].split())


@pytest.mark.parametrize("words", ["--help", "--version", "map --help"])
def test_no_command_is_imported_where_none_is_run(words: str) -> None:
    found = modules_after(words)
    assert not any(name.startswith("impact_rs_cli.commands.") for name in found)
    assert not found & {"dataclasses", "numpy", "pydantic", "rich", "rclpy", "pybullet", "pinocchio", "distributed"}


def test_the_help_waits_for_no_module_that_it_does_not_need() -> None:
    assert not modules_after("--help") & {"importlib.metadata", "email", "subprocess"}


def test_a_command_is_imported_alone_and_without_slow_libraries() -> None:
    found = modules_after("map push cat_food 2")
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


def test_debug_shows_the_cause_of_an_error_and_the_log(
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


def test_json_is_pure_in_a_process_of_its_own() -> None:
    """Bullet prints to the C-level standard output, which must not spoil it."""
    done = process("map", "push", "cat_food", "case_2", "--engine", "bullet", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert isinstance(json.loads(done.stdout), dict)


def test_map_prints_the_prediction(capfd: pytest.CaptureFixture) -> None:
    assert main(["map", "push", "cat_food", "2"]) == 0
    out, err = capfd.readouterr()
    assert "m/s" in out and not err


@pytest.mark.parametrize("engine", ["bullet", "exact", "pinocchio"])
@pytest.mark.parametrize("inertia", ["reduced", "rotor", "zero"])
def test_map_json_has_every_velocity(document: Document, engine: str, inertia: str) -> None:
    found = document("map", "push", "cat_food", "2", "--engine", engine, "--motor-inertia", inertia)
    post = found["post"]
    assert [len(post[name]["arm"]) for name in ("end_effector_twist", "joint_velocity")] == [6, 7]
    assert len(post["object_twist"]) == 6
    assert found["contacts"] and found["residual"] and found["elapsed_ms"] > 0.0
    assert found["engine"] == engine.replace("pinocchio", "exact")


def test_settled_arms_lift_faster_than_after_the_first_contact(document: Document) -> None:
    first, settled = (document("map", "grab", "cat_food", "2", "--contact", name) for name in ("first", "settled"))
    assert (first["contact"], settled["contact"]) == ("first", "settled")
    speed = [{name: twist[2] for name, twist in one["post"]["end_effector_twist"].items()} for one in (first, settled)]
    assert all(speed[1][name] > speed[0][name] for name in ("left", "right"))


def test_an_interrupt_ends_with_130_and_leaves_no_folder(
    capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("impact_rs_cli.commands.campaign.run_campaigns", interrupt)
    assert main(["campaign", "push", "-o", str(tmp_path / "out")]) == 130
    assert "interrupted; the same command goes on where it stopped" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_trial_is_recorded_once(document: Document, refused: Callable[..., str], tmp_path: Path) -> None:
    words = ["trial", "push", "cat_food", "2", "--seed", "3", "-o", tmp_path / "a" / "b"]
    found = document(*words)
    assert found["outcome"] == "OK" and Path(found["bag"]).is_dir()
    assert "exists already" in refused(*words, "--json")


def test_a_finished_campaign_has_nothing_to_run(
    push_campaign: Path, tmp_path: Path, document: Document, refused: Callable[..., str]
) -> None:
    """Hints spell the program as the user called it."""
    directory = shutil.copytree(push_campaign, tmp_path / "push")
    words = ["campaign", "push", "-o", str(directory), *SCOPE, "--scales", "0.8", "1", "1.2"]
    assert document(*words)["ran"] == 0
    assert "another campaign" in refused(*words, "--seed", "5")
    assert f"next: ./run impact-rs analyze {directory}" in process(*words, IMPACT_RS_PROGRAM="./run impact-rs").stdout


def test_scales_that_differ_little_have_a_bag_each(
    tmp_path: Path, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("impact_rs_trials.campaign.run_campaigns.__defaults__", (None, made_up))
    scales = ["--scales", "1.0001", "1.0002", "1", "--jobs", "1"]
    assert main(["campaign", "push", "-o", str(tmp_path / "out"), *SCOPE, *scales]) == 0
    assert "3 of 3 trials are there" in capfd.readouterr().out
    bags = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert bags == {f"cat_food__case_2__s{scale}__r0" for scale in ("1.000", "1.0001", "1.0002")}


def test_a_campaign_with_failures_is_no_success(
    capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def broken(*arguments: object) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr("impact_rs_trials.campaign.run_campaigns.__defaults__", (None, broken))
    words = ["campaign", "push", "-o", str(tmp_path / "out"), *SCOPE, "--scales", "1.0"]
    assert main(words) == 1
    err = capfd.readouterr().err
    assert "by nothing" in err and "Traceback" not in err
    assert f"full error: {tmp_path / 'out' / FAILURES}" in err
    assert main([*words, "--debug"]) == 1
    assert "in broken" in capfd.readouterr().err


def test_a_diverged_trial_is_counted_and_used_by_no_analysis(
    capfd: pytest.CaptureFixture, document: Document, tmp_path: Path
) -> None:
    """The wrist of an FR3 is too light for the dampers of push: joint 7 runs away within milliseconds."""
    out, light = str(tmp_path / "light"), ["--set", "robots.arm.facts=franka_fr3"]
    assert main(["campaign", "push", "-o", out, *SCOPE, "--scales", "0.8", "1.2", "--jobs", "1", *light]) == 1
    printed = capfd.readouterr()
    assert "robot check failed, trials may diverge: drive of arm, joint 7" in printed.err
    assert "2 of 2 trials are there (2 DIVERGED)" in printed.out
    pattern = r"DIVERGED 2: arm joint7 at [\d.]+ rad/s against 5.26 rad/s at 0.0\d\d s \(cat_food__"
    assert re.search(pattern, printed.err)
    for command in ("analyze", "compare", "diagnose"):
        assert main([command, out, "--jobs", "1"]) == 2
        err = capfd.readouterr().err
        assert "DIVERGED: arm joint7 at" in err and "Traceback" not in err
    scenario = tmp_path / "light.yaml"
    shipped = (config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8")
    scenario.write_text(shipped.replace("facts: franka_fer", "facts: franka_fr3"), encoding="utf-8")
    found = document("trial", scenario, "cat_food", "2", "-o", tmp_path / "one", code=1)
    assert (found["outcome"], found["net_feedback_m_s"]) == ("DIVERGED", None)
    assert found["message"].startswith("arm joint7 at")


def test_analyze_needs_more_than_one_trial(push_campaign: Path, tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    shutil.copytree(push_campaign / BAG, tmp_path / "one" / BAG)
    assert main(["analyze", str(tmp_path / "one")]) == 1
    assert "1 trial with impact" in capfd.readouterr().out
    assert main(["analyze", str(push_campaign), "-o", str(tmp_path / "report"), "--jobs", "1"]) == 0
    out, err = capfd.readouterr()
    assert "Cat food" in out and "report.html" in out and not err


def test_show_writes_the_page_beside_the_bag_and_opens_it(
    push_campaign: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture,
    document: Document,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address))
    bag = shutil.copytree(push_campaign / BAG, tmp_path / BAG)
    page, other = tmp_path / f"{bag.name}.html", tmp_path / "other.html"
    assert main(["show", str(bag)]) == 0
    assert opened == [page.as_uri()]
    out, err = capfd.readouterr()
    assert f"page: {page}" in out and "open the page yourself" in err  # there is no browser
    assert document("show", bag, "-o", other, "--no-browser") == {"page": str(other)}
    assert len(opened) == 1
    assert {path.name for path in tmp_path.iterdir()} == {bag.name, page.name, other.name}


def show(laboratory: Path, *further: str) -> list[str]:
    words = ["show", str(laboratory), "--experiment", str(laboratory / "experiment.yaml"), "--no-browser"]
    return [*words, *further, "--jobs", "1"]


def test_show_writes_a_run_of_a_laboratory_and_its_twin(laboratory: Path, capfd: pytest.CaptureFixture) -> None:
    assert main(show(laboratory, "--run", "run_1")) == 0
    page = laboratory.parent / "lab_run_1.html"
    assert capfd.readouterr() == (f"page: {page}\n", "")
    text = page.read_text()
    assert all(part in text for part in ("cat_food is hit; scenario push", "object tracked at ", "found at 0.90"))
    assert '"model":null' in text.replace(" ", "")
    assert main(show(laboratory, "--run", "run_2", "--model", "nominal")) == 0
    text = (laboratory.parent / "lab_run_2.html").read_text()
    assert "nominal, from the measured state at the beginning of every window" in text
    assert '"model":null' not in text.replace(" ", "")


def test_show_says_that_the_object_was_not_tracked(laboratory: Path, capfd: pytest.CaptureFixture) -> None:
    mapping = yaml.safe_load((config_directory() / "mappings" / "impact_rs.yaml").read_text())
    del mapping["signals"]["object_pose"]
    (laboratory / "mapping.yaml").write_text(yaml.safe_dump(mapping))
    (laboratory / "experiment.yaml").write_text("scenario: push\nmapping: mapping.yaml\n")
    assert main(show(laboratory, "--run", "run_1")) == 0
    assert capfd.readouterr().err == "run_1: the pose of cat_food was not recorded, so it is not shown\n"
    assert "the object was not tracked" in (laboratory.parent / "lab_run_1.html").read_text()


def test_show_of_an_unknown_run_names_the_nearest(laboratory: Path, refused: Callable[..., str]) -> None:
    line = refused(*show(laboratory, "--run", "rnu_1"))
    assert line == "impact-rs: run = 'rnu_1': the table of runs names no such run; did you mean 'run_1'?"
    assert [path.name for path in laboratory.parent.iterdir()] == ["lab"]


def test_an_output_folder_left_empty_goes_away_with_its_parents(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no"), output_folder(tmp_path / "a" / "b") as folder:
        folder.mkdir(parents=True)
        raise ValueError("no")
    assert not list(tmp_path.iterdir())
    with output_folder(tmp_path / "a" / "b") as folder:
        folder.mkdir(parents=True)
        (folder / "result").write_text("")
    assert (tmp_path / "a" / "b" / "result").exists()


# ---- which files the commands of the loop read ----------------------------------------------------------------------


NAME = Path("experiment.yaml")


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A working directory, and a folder of runs elsewhere."""
    here, runs = tmp_path / "here", tmp_path / "elsewhere" / "lab"
    for folder in (here, runs):
        folder.mkdir(parents=True)
    monkeypatch.chdir(here)
    return here, runs


def test_an_experiment_file_here_comes_before_one_beside_the_runs(
    places: tuple[Path, Path], capsys: pytest.CaptureFixture
) -> None:
    here, runs = places
    terminal = Terminal(as_json=False)
    with pytest.raises(InputError, match="no such file in .*here or in the folder of the runs, .*lab"):
        experiment_file(NAME, runs, terminal)
    (runs / NAME).write_text("scenario: push\n")
    assert experiment_file(NAME, runs, terminal) == runs / NAME
    assert capsys.readouterr() == (f"experiment: {runs / NAME}\n", "")
    shutil.copy(runs / NAME, here / NAME)
    assert experiment_file(NAME, runs, terminal).absolute() == here / NAME
    out, err = capsys.readouterr()
    assert out == f"experiment: {here / NAME}\n"
    assert "was not read" in err and str(runs / NAME) in err
    shutil.copy(runs / NAME, runs / "other.yaml")
    assert experiment_file(runs / "other.yaml", runs, terminal) == runs / "other.yaml"
    assert capsys.readouterr() == ("", "")  # a whole path leaves nothing open


@pytest.mark.parametrize("command", ["compare", "diagnose", "analyze", "show --run run_1"])
def test_every_command_finds_the_experiment_file_beside_the_runs(
    places: tuple[Path, Path], capsys: pytest.CaptureFixture, command: str
) -> None:
    _, runs = places
    (runs / NAME).write_text("scenari: push\n")
    assert main([*command.split(), str(runs), "--experiment", str(NAME), "--jobs", "1"]) == 2
    assert f"{runs / NAME}: scenari" in capsys.readouterr().err


@pytest.mark.parametrize(("tolerance", "fits"), [(50.0, True), (1e-6, False)])
def test_analyze_says_that_no_prediction_fits_and_merges_equal_contacts(
    push_campaign: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    tolerance: float,
    fits: bool,
) -> None:
    monkeypatch.setattr(ExperimentSet, "tolerance", property(lambda _: tolerance))
    assert main(["analyze", str(push_campaign), "-o", str(tmp_path / "report"), "--jobs", "1"]) == 0
    out = capsys.readouterr().out
    assert ("first contact: no prediction agrees within the 95 % intervals of both: Cat food" in out) == (not fits)
    assert out.count("Experimental estimate") == 1 and "settled contact: the same errors as the first" in out


# ---- packages that only some files need -----------------------------------------------------------------------------


TABLE = """\
x [m],y [m],z [m],qx,qy,qz,qw,vx_before [m/s],vy_before [m/s],vz_before [m/s],wx_before [rad/s],wy_before [rad/s],\
wz_before [rad/s],mass [kg],size_x [m],size_y [m],size_z [m],px [m],py [m],pz [m],friction,restitution
0,0,0.05,0,0,0,1,0,0,-1,0,0,0,1,0.1,0.1,0.1,0,0,0,0.2,0.5
"""
RUN = "/somewhere/else/run"


class Situation:
    """A command that needs pyarrow where it is missing, with an answer at the terminal and a stand-in for ``./run``."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[list[str]] = []
        self.exit_code = 0
        self.target = folder / "answers.parquet"
        self._monkeypatch = monkeypatch
        self._package = pytest.importorskip("pyarrow")
        (folder / "cube.csv").write_text(TABLE, encoding="utf-8")
        self.words = ["map", "--table", str(folder / "cube.csv"), "-o", str(self.target)]
        monkeypatch.setenv("IMPACT_RS_RUN", RUN)
        monkeypatch.setitem(sys.modules, "pyarrow", None)
        monkeypatch.setattr("impact_rs_cli.installing.subprocess.run", self._install)
        for stream in ("stdin", "stderr"):
            monkeypatch.setattr(getattr(sys, stream), "isatty", lambda: True)

    def answered(self, line: str) -> int:
        """Exit code of the command."""
        self._monkeypatch.setattr(sys.stdin, "readline", lambda: line)
        return main(self.words)

    def _install(self, command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        self.asked.append(command)
        if self.exit_code == 0:
            self._monkeypatch.setitem(sys.modules, "pyarrow", self._package)
        return subprocess.CompletedProcess(command, self.exit_code)


@pytest.fixture
def situation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Situation:
    return Situation(tmp_path, monkeypatch)


def test_after_a_yes_it_is_installed_and_the_command_goes_on(situation: Situation) -> None:
    assert situation.answered("y\n") == 0
    assert situation.asked == [[RUN, "sync", "export"]]
    assert situation.target.is_file()


@pytest.mark.parametrize("line", ["\n", "no\n", ""])
def test_without_a_yes_nothing_is_installed(
    situation: Situation, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert situation.answered(line) == 2
    assert not situation.asked and not situation.target.exists()
    assert f"this needs pyarrow, which is not installed; {RUN} sync export does it" in capsys.readouterr().err


def test_an_installation_that_fails_ends_the_command(situation: Situation) -> None:
    situation.exit_code = 7
    assert situation.answered("y\n") == 2
    assert len(situation.asked) == 1 and not situation.target.exists()


@pytest.mark.parametrize("where", ["no terminal", "json", "not made by ./run"])
def test_nobody_is_asked_where_nobody_answers_or_nothing_can_be_installed(
    situation: Situation, where: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if where == "no terminal":
        monkeypatch.setattr(sys.stdin, "isatty", lambda: False)
    elif where == "json":
        situation.words.append("--json")
    else:
        monkeypatch.delenv("IMPACT_RS_RUN")
    assert situation.answered("y\n") == 2
    out, said = capsys.readouterr()
    assert not situation.asked and out == "" and len(said.splitlines()) == 1
    assert ("pip install pyarrow" if where == "not made by ./run" else f"{RUN} sync export") in said


def test_a_job_of_a_page_can_be_stopped_where_a_script_started_the_page_in_the_background(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Shells let background jobs ignore SIGINT, and children inherit it. Kills a Stop button that stops nothing."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        main(["effects", "--json"])
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN  # the user's own choice
        monkeypatch.setenv(PROGRESS_FILE, str(tmp_path / "progress"))
        main(["effects", "--json"])
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
