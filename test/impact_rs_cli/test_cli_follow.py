# SPDX-License-Identifier: Apache-2.0
"""``impact-rs follow``: a change on the screen and in the document, a state file, and mistakes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from impact_table_cases import arm_table, write_csv
from processes import killed_at_file

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.state import save_state
from impact_rs_cli import following
from impact_rs_cli.commands import follow as follow_command
from impact_rs_cli.following import FollowedHits, HitsArguments, diagnose_options, door_of
from impact_rs_cli.full_diagnosis import FullDiagnosis
from impact_rs_cli.identify import Lessons
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


def test_the_document_has_every_hit_and_a_later_run_with_the_state_has_none_again(
    table: Path, tmp_path: Path, document: Callable[..., dict[str, Any]]
) -> None:
    words = ("follow", table, "--scenario", "push", "--state", tmp_path / "state.npz")
    first = document(*words)
    assert len(first["hits"]) == 42
    (change,) = [hit["change"] for hit in first["hits"] if hit["change"] is not None]
    causes = {cause["effect"]: cause["share"] for cause in change["causes"]}
    assert causes["object_mass"] > 0.3  # a tool that lost 0.5 kg does about as well after three hits, and is said too
    again = document(*words)
    assert again["hits"] == []
    assert again["followed"] == first["followed"] and again["prediction"] == first["prediction"]


@pytest.mark.parametrize("written", [True, False], ids=["after", "before"])
def test_a_kill_in_the_first_pass_loses_no_hit_and_resumes_as_if_there_was_none(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, document: Callable[..., dict[str, Any]], written: bool
) -> None:
    """Killed at the third state that is written: 30 of the 42 hits, just after and just before it is complete."""
    words = ("follow", table, "--scenario", "push")
    whole = document(*words)
    counts: list[int] = []

    def killed(follower: Follower, path: Path) -> None:
        counts.append(len(follower.saved()[0]["names"]))
        if written or len(counts) < 3:
            save_state(follower, path)
        if len(counts) == 3:
            raise KeyboardInterrupt

    state = tmp_path / "state.npz"
    with monkeypatch.context() as patch:
        patch.setattr(following, "save_state", killed)
        assert main([*map(str, words), "--state", str(state)]) == 130
    assert counts == [10, 20, 30]
    rest = document(*words, "--state", state)
    first = 30 if written else 20
    for own, expected in zip(rest["hits"], whole["hits"][first:], strict=True):
        assert own["name"] == expected["name"]
        assert own["error"] == (None if expected["error"] is None else pytest.approx(expected["error"], rel=1e-6))
        assert (own["change"] is None) == (expected["change"] is None)
    assert rest["followed"][0]["estimate"] == pytest.approx(whole["followed"][0]["estimate"], rel=1e-6)


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


def test_the_first_pass_says_how_far_it_is(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, document: Callable[..., dict[str, Any]]
) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "progress.json"))
    document("follow", table, "--scenario", "push")
    progress = json.loads((tmp_path / "progress.json").read_text())
    assert (progress["what"], progress["done"], progress["total"]) == ("following hits", 42, 42)


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
    assert written.named == ("object_mass",) and diagnosis["verdict"] == written.verdict
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


def test_without_hits_enough_no_diagnosis_is_started(
    table: Path, tmp_path: Path, document: Callable[..., dict[str, Any]]
) -> None:
    """Six hits of six conditions: nothing is repeated."""
    assert document("follow", table, "--scenario", "push", "--diagnoses", tmp_path / "more")["diagnosis"] is None
    assert not (tmp_path / "more").exists()


def test_the_node_takes_a_few_hits_at_a_time_and_all_in_the_end(table: Path, tmp_path: Path) -> None:
    def lessons() -> Lessons:
        source = HitsArguments(table, scenario="push")
        follower = Follower(door_of(source, NOMINAL), NOMINAL)
        diagnosis = FullDiagnosis(diagnose_options(source), tmp_path)
        return Lessons(FollowedHits(source, follower, tmp_path / "state.npz", diagnosis), diagnosis)

    first = lessons()
    looks = [first.arrived() for _ in range(7)]
    assert all(1 <= len(look) <= 3 for look in looks)
    again, later = lessons(), []
    while look := again.arrived():
        later += look
    lines = [lesson.line.partition(":")[0] for lesson in later]
    assert lines == [f"row {number}" for number in range(21, 43)]  # the state was saved after the tenth hit, twice
    (change,) = [json.loads(lesson.change) for lesson in later if lesson.change]
    assert "--since 'row 37'" in change["diagnose"]


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
