# SPDX-License-Identifier: Apache-2.0
"""``impact-rs follow``: a change on the screen and in the document, a state file, and mistakes."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from impact_table_cases import arm_table, write_csv
from processes import killed_at_file, until

from impact_rs_analysis.application import followed_hits
from impact_rs_analysis.application.followed_hits import FollowedHits, diagnose_options, hit_source_of, hits_options
from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.state import save_state
from impact_rs_cli.commands import follow as follow_command
from impact_rs_cli.full_diagnosis import FullDiagnosis
from impact_rs_cli.identify import HitReports
from impact_rs_cli.main import main
from impact_rs_sim.model import load_model
from impact_rs_sim.progress import VARIABLE

NOMINAL = load_model("nominal")


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
    assert f"--impacts {table} --scenario push --since 'row 37'" in out
    assert "object_mass.scale" in out and "Next hit of" in out
    assert "name: object_mass" in model.read_text()


@pytest.fixture(scope="module")
def whole(table: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path, dict[str, Any]]:
    """The document of a pass over the whole table, the state it left, and what it said of its progress."""
    folder, said = tmp_path_factory.mktemp("whole"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.setenv(VARIABLE, str(folder / "progress.json"))
        words = ["follow", str(table), "--scenario", "push", "--state", str(folder / "state.npz"), "--json"]
        assert main([*words, "--diagnoses", str(folder / "more")]) == 0
    assert not (folder / "more").exists()  # six hits of six conditions: nothing is repeated
    return json.loads(said.getvalue()), folder / "state.npz", json.loads((folder / "progress.json").read_text())


def test_the_document_has_every_hit_and_a_later_run_with_the_state_has_none_again(
    table: Path, whole: tuple[dict[str, Any], Path, dict[str, Any]], document: Callable[..., dict[str, Any]]
) -> None:
    first, state, progress = whole
    assert len(first["hits"]) == 42 and first["diagnosis"] is None
    assert (progress["what"], progress["done"], progress["total"]) == ("following hits", 42, 42)
    (change,) = [hit["change"] for hit in first["hits"] if hit["change"] is not None]
    causes = {cause["effect"]: cause["share"] for cause in change["causes"]}
    assert causes["object_mass"] > 0.3  # a tool that lost 0.5 kg does about as well after three hits, and is said too
    again = document("follow", table, "--scenario", "push", "--state", state)
    assert again["hits"] == []
    assert again["followed"] == first["followed"] and again["prediction"] == first["prediction"]


@pytest.mark.parametrize("written", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["after", "before"])
def test_a_kill_in_the_first_pass_loses_no_hit_and_resumes_as_if_there_was_none(
    table: Path,
    whole: tuple[dict[str, Any], Path, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    document: Callable[..., dict[str, Any]],
    written: bool,
) -> None:
    """Killed at the third state that is written: 30 of the 42 hits, just after and just before it is complete."""
    words = ("follow", table, "--scenario", "push")
    counts: list[int] = []

    def killed(follower: Follower, path: Path) -> None:
        counts.append(len(follower.names))
        if written or len(counts) < 3:
            save_state(follower, path)
        if len(counts) == 3:
            raise KeyboardInterrupt

    state = tmp_path / "state.npz"
    with monkeypatch.context() as patch:
        patch.setattr(followed_hits, "save_state", killed)
        assert main([*map(str, words), "--state", str(state)]) == 130
    assert counts == [10, 20, 30]
    rest = document(*words, "--state", state)
    first = 30 if written else 20
    for own, expected in zip(rest["hits"], whole[0]["hits"][first:], strict=True):
        assert own["name"] == expected["name"]
        assert own["error"] == (None if expected["error"] is None else pytest.approx(expected["error"], rel=1e-6))
        assert (own["change"] is None) == (expected["change"] is None)
    assert rest["followed"][0]["estimate"] == pytest.approx(whole[0]["followed"][0]["estimate"], rel=1e-6)


@pytest.mark.slow
def test_sigkill_before_or_after_every_written_file_loses_no_hit_and_no_change(
    tmp_path: Path, document: Callable[..., dict[str, Any]]
) -> None:
    """A real SIGKILL at each state, and at the model; nothing is tidied up."""
    header, quiet = arm_table({}, 3, 1)
    _, heavier = arm_table({"object_mass": [1.4]}, 1, 2)
    order = np.random.default_rng(0).permutation(len(quiet))
    path = write_csv(tmp_path / "hits.csv", header, [*(quiet[n] for n in order), *heavier])
    words = ("follow", path, "--scenario", "push", "--learn", 10, "--effects", "object_mass", "--no-diagnosis")
    whole = document(*words)
    (change,) = [hit["change"] for hit in whole["hits"] if hit["change"] is not None]
    count, killed = 0, True
    while killed:
        count += 1
        for after in (False, True):
            folder = tmp_path / f"killed_{count}_{after}"
            files = ("--state", folder / "state.npz", "-o", folder / "now.yaml")
            killed = killed_at_file(lambda: main([str(word) for word in (*words, *files)]), count, after)  # noqa: B023
            model = folder / "now.yaml"
            there = model.exists()
            rest = document(*words, *(files[:2] if there else files))
            assert model.exists()
            names = [hit["name"] for hit in rest["hits"]]
            assert names == [hit["name"] for hit in whole["hits"]][len(whole["hits"]) - len(names) :]
            assert change["hit"] in names or (folder / "state.npz").exists()
            (mass,), (expected,) = rest["followed"], whole["followed"]
            assert mass["estimate"] == pytest.approx(expected["estimate"], rel=1e-6)
    assert count >= 5  # two states in the first pass, its end, the model


def test_a_change_starts_its_full_diagnosis_of_the_hits_since_then_and_says_how_it_ended(
    tmp_path: Path, document: Callable[..., dict[str, Any]]
) -> None:
    header, quiet = arm_table({}, 4, 1)
    _, heavier = arm_table({"object_mass": [1.3]}, 2, 2)
    order = np.random.default_rng(0).permutation(len(quiet))
    path = write_csv(tmp_path / "hits.csv", header, [*(quiet[n] for n in order), *heavier])
    only = ("--effects", "object_mass", "restitution", "--no-discrepancy")
    found = document("follow", path, "--scenario", "push", "--diagnoses", tmp_path / "more", *only)
    (change,) = [hit["change"] for hit in found["hits"] if hit["change"] is not None]
    diagnosis = found["diagnosis"]
    assert f"--since '{change['since']}'" in diagnosis["command"]
    written = read_document(Path(diagnosis["file"]))
    assert Path(diagnosis["file"]).parent == tmp_path / "more"
    assert written.named == ("object_mass",) and diagnosis["verdict"] == str(written.verdict)
    since = int(change["since"].removeprefix("row "))
    assert written.runs.trials == len(quiet) + len(heavier) - since + 1


def test_a_hit_that_arrives_is_followed_at_once_and_kept_in_the_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
) -> None:
    header, rows = arm_table({}, 4, 1)
    path, state = write_csv(tmp_path / "hits.csv", header, rows[:-1]), tmp_path / "state.npz"
    looks: list[int] = []

    def passes(_: float) -> None:
        with np.load(state) as saved:
            looks.append(len(json.loads(str(saved["document"]))["names"]))
        if len(looks) == 2:
            raise KeyboardInterrupt
        write_csv(path, header, rows)

    monkeypatch.setattr(follow_command.time, "sleep", passes)
    assert main(["follow", str(path), "--scenario", "push", "--live", "--state", str(state)]) == 0
    assert looks == [len(rows) - 1, len(rows)]
    out = capfd.readouterr().out
    assert "waiting for hits" in out and f"row {len(rows)}: prediction off by" in out


def test_the_node_takes_a_few_hits_at_a_time_and_all_in_the_end(table: Path, tmp_path: Path) -> None:
    def reports() -> HitReports:
        source = hits_options(table, scenario="push")
        follower = Follower(hit_source_of(source, NOMINAL), NOMINAL)
        diagnosis = FullDiagnosis(diagnose_options(source, "nominal"), tmp_path)
        return HitReports(FollowedHits(source, follower, tmp_path / "state.npz", diagnosis), diagnosis)

    first = reports()
    looks = [first.arrived() for _ in range(7)]
    assert all(1 <= len(look) <= 3 for look in looks)
    again, later = reports(), []
    while look := again.arrived():
        later += look
    lines = [report.line.partition(":")[0] for report in later]
    assert lines == [f"row {number}" for number in range(21, 43)]  # the state was saved after the tenth hit, twice
    (change,) = [report.document for report in later if report.topic == "change"]
    assert "--since 'row 37'" in change["diagnose"]


# ---- a full diagnosis in a process of its own -----------------------------------------------------------------------


@pytest.fixture
def few_hits(tmp_path: Path) -> Path:
    return write_csv(tmp_path / "hits.csv", *arm_table({}, 2, 1))


@pytest.fixture
def many_hits(tmp_path: Path) -> Path:
    """So many that a diagnosis has not ended before a slow machine stops it: one that has ended leaves its document."""
    return write_csv(tmp_path / "hits.csv", *arm_table({}, 60, 1))


def test_a_diagnosis_that_fails_is_reported_with_its_reason_and_command(few_hits: Path, tmp_path: Path) -> None:
    diagnosis = FullDiagnosis({"impacts": few_hits, "scenario": "push"}, tmp_path / "more")
    diagnosis.start("row 99")
    assert diagnosis.running
    found = diagnosis.ended(wait=True)
    assert found is not None and found.verdict == ""
    assert found.words.startswith("exit code 2: ") and "no such run or row" in found.words
    assert found.command.endswith(f"--impacts {few_hits} --scenario push --since 'row 99'")
    assert f"-o {tmp_path}/more/diagnosis_since_row_99.json" in found.command
    assert not diagnosis.running and diagnosis.ended() is None and not (tmp_path / "more").exists()


@pytest.mark.parametrize("patience", [60.0, 0.0])
def test_a_diagnosis_that_is_stopped_has_ended_and_leaves_nothing(
    many_hits: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, patience: float
) -> None:
    """By Ctrl-C, and by a kill where it does not end in time. Kills: Ctrl-C is ignored, as in a job of a script."""
    monkeypatch.setattr("impact_rs_cli.full_diagnosis.DIAGNOSIS_STOP_TIMEOUT_S", patience)
    diagnosis = FullDiagnosis({"impacts": many_hits, "scenario": "push"}, tmp_path / "more")
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        diagnosis.start("row 3")
    finally:
        signal.signal(signal.SIGINT, handler)
    process = diagnosis._running.process  # type: ignore[union-attr]
    diagnosis.stop()
    assert process.returncode is not None and not diagnosis.running
    assert not (tmp_path / "more").exists()


FOLLOWING = """
import sys, time
from pathlib import Path
from impact_rs_cli.full_diagnosis import FullDiagnosis
diagnosis = FullDiagnosis({"impacts": sys.argv[1], "scenario": "push"}, Path(sys.argv[2]))
diagnosis.start("row 3")
print(diagnosis._running.process.pid, flush=True)
time.sleep(1000)
"""


@pytest.fixture
def starter(many_hits: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has started a diagnosis, whose id it prints."""
    words = [sys.executable, "-c", FOLLOWING, str(many_hits), str(tmp_path / "more")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def group_of(leader: int) -> list[int]:
    """Processes of a group that still run, those that only wait to be reaped left out."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
        except OSError:  # it has ended meanwhile
            continue
        if int(group) == leader and state not in "ZX":
            found.append(int(path.parent.name))
    return found


def test_a_diagnosis_ends_with_the_process_that_started_it_and_was_killed(
    starter: subprocess.Popen[str], tmp_path: Path
) -> None:
    assert starter.stdout is not None
    leader = int(starter.stdout.readline())
    assert leader in group_of(leader)
    os.kill(starter.pid, signal.SIGKILL)
    starter.wait()
    until(lambda: not group_of(leader), lambda: time.sleep(0.02), "the diagnosis runs on")
    assert not (tmp_path / "more").exists()
