# SPDX-License-Identifier: Apache-2.0
"""The loop on the command line: compare, diagnose, add, compare, history; and every way to get it wrong."""

from __future__ import annotations

import argparse
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import documents
import fsspec
import numpy as np
import pytest
from intervals import assert_covers

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_cli.arguments import on_local_runs
from impact_rs_cli.commands.demo import Demonstration, walk_the_loop
from impact_rs_cli.commands.diagnose import show
from impact_rs_cli.main import main
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.model import Model, load_model

EFFECT, HIDDEN_FRICTION = "support_friction", 0.18  # that hidden_campaign hides
Document = Callable[..., dict[str, Any]]
Refused = Callable[..., str]
Rewrite = Callable[..., None]


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No replay of another test is used."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_the_hidden_effect_is_named_with_its_interval_and_the_score_falls(
    document: Document, hidden_campaign: Path, diagnosed: Path, model_2: Path, tmp_path: Path, own_cache: None
) -> None:
    """The whole loop of the fast tier; kills: add writes another value than was found, history another model."""
    found = read_document(diagnosed)
    assert (found.named, str(found.effects[0].verdict)) == ((EFFECT,), "CONFIRMED")
    friction = found.effects[0].parameters["friction"]
    assert_covers(friction.ci95, HIDDEN_FRICTION, 0.04)
    assert load_model(model_2).effects[0].parameters["friction"].estimate == pytest.approx(friction.estimate)
    after = document("compare", hidden_campaign, "--model", model_2, "--mcap", tmp_path / "aligned", "--jobs", "1")
    assert len(list((tmp_path / "aligned").glob("*/*.mcap"))) == 3
    history = document("history", model_2, "--runs", hidden_campaign, "--jobs", "1")["history"]
    assert [entry["effect_added"] for entry in history] == [None, EFFECT]
    assert after["score"] < 0.5 * history[0]["error_fit"]
    assert history[1]["error_fit"] == pytest.approx(after["score"], rel=1e-6)
    assert history[1]["error_held_out"] < 0.1 * history[0]["error_held_out"]
    assert history[1]["runs_digest"] == after["runs_digest"] == found.runs.digest
    assert history[1]["rollouts"]["horizons"] == after["rollouts"]["horizons"]


def test_runs_at_a_url_become_a_folder_for_the_command() -> None:
    files = fsspec.filesystem("memory")
    for name in ("push/one", "excite/two", "excite/.three"):
        files.pipe({f"/runs/{name}/metadata.yaml": b"complete", f"/runs/{name}/{Path(name).name}.mcap": b"signals"})
    files.pipe("/runs/push/half/half.mcap", b"uploaded by half")
    found = []

    @on_local_runs
    def command(args: argparse.Namespace, terminal: Terminal) -> int:
        del terminal
        found.extend(path.relative_to(args.runs).as_posix() for path in args.runs.rglob("*.mcap"))
        return 7

    try:
        assert command(argparse.Namespace(runs="memory://runs", scheduler=None), Terminal(as_json=False)) == 7
    finally:
        files.rm("/runs", recursive=True)
    assert sorted(found) == ["excite/two/two.mcap", "push/one/one.mcap"]


def test_effects_lists_parameters_with_units(document: Document) -> None:
    everything = {effect["name"]: effect for effect in document("effects")["effects"]}
    assert {"torque_offset", EFFECT, "object_mass"} <= set(everything)
    assert document("effects", "torque_offset")["effects"] == [everything["torque_offset"]]
    (parameter,) = everything["torque_offset"]["parameters"]
    assert (parameter["unit"], parameter["per_joint"]) == ("N m", True)


FORMULAS = {
    "import os": "does not parse",
    "__import__('os')": "unknown function",
    "c * dq9": "unknown symbol 'dq9'",
    "c * exp(exp(20))": "blows up",
}


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_formula_that_cannot_be_computed(
    refused: Refused, hidden_campaign: Path, tmp_path: Path, own_cache: None, formula: str
) -> None:
    (tmp_path / "f.yaml").write_text(
        f'effects:\n- name: drag\n  sentence: It drags.\n  joint_torque: {{joint2: "{formula}"}}\n'
        "  parameters: {c: {unit: N m, nominal: 0, lower: 0, upper: 3, scale: 0.1}}\n"
    )
    words = ["-o", tmp_path / "d.json", "--effects", "drag", "--formulas", tmp_path / "f.yaml"]
    assert FORMULAS[formula] in refused("diagnose", hidden_campaign, *words)
    assert not (tmp_path / "d.json").exists()


@pytest.mark.slow
def test_the_formula_of_the_manual_is_diagnosed_in_two_processes(
    document: Document, hidden_campaign: Path, tmp_path: Path, own_cache: None
) -> None:
    manual = (Path(__file__).parents[2] / "docs" / "effects.md").read_text()
    cable, model, output = tmp_path / "cable.yaml", tmp_path / "model_2.yaml", tmp_path / "diagnosis.json"
    cable.write_text(manual.split("```yaml\n")[1].split("```")[0])
    words = ["-o", output, "--formulas", cable, "--jobs", "2", "--effects", "cable_drag", EFFECT]
    found = document("diagnose", hidden_campaign, *words)
    cable_drag = next(effect for effect in found["effects"] if effect["name"] == "cable_drag")
    low, high = cable_drag["parameters"]["drag"]["ci95"]
    assert (found["named"], cable_drag["measured"]) == ([EFFECT], True)
    assert low == 0.0 < high  # there is no cable
    assert main(["add", "cable_drag", "--from", str(output), "-o", str(model), "--force"]) == 0
    assert load_model(model).formulas[0].end_effector_force == {"y": "-drag * vy"}


@pytest.mark.slow
def test_the_demonstration_keeps_the_page_of_the_nominal_model(
    capsys: pytest.CaptureFixture,
    hidden_campaign: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    own_cache: None,
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # more processes only start
    hidden = {"name": EFFECT, "parameters": {"friction": {"estimate": 0.18, "unit": "-"}}}
    demonstration = Demonstration(hidden=Model(name="hidden", effects=(hidden,)), considered=(EFFECT,))
    story = walk_the_loop(demonstration, tmp_path, hidden_campaign, Terminal(as_json=False))
    assert story["correct"]
    lacks, better, fails = (Path(path) for path in story["reports"])
    assert json.loads(fails.with_suffix(".json").read_text())["model"]["name"] == "nominal"
    assert json.loads(better.with_suffix(".json").read_text())["model"]["name"] == "model_2"
    out = capsys.readouterr().out
    assert all(str(page.resolve()) in out for page in (lacks, better, fails))
    for page in (better, fails):
        links = re.findall(r'<a href="(.*?)">', page.read_text(encoding="utf-8"))
        assert {(page.parent / link).resolve() for link in links} == {lacks, better, fails} - {page}


@pytest.mark.parametrize("kind", ["trials", "recordings", "joints", "minimal"])
def test_a_diagnosis_begins_with_its_verdict_in_words(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    """And prints no type of the program. Kills: a verdict that is printed as an object."""
    found = documents.diagnosis(kind)
    show(found, Terminal(as_json=False))
    out = capsys.readouterr().out
    assert out.startswith(f"{found.verdict}\n") and "DiagnosisVerdict" not in out


def test_one_condition_is_too_few_for_a_diagnosis(refused: Refused, hidden_campaign: Path, tmp_path: Path) -> None:
    shutil.copytree(hidden_campaign / "push", tmp_path / "push")
    assert "impact-rs compare" in refused("diagnose", tmp_path, "-o", tmp_path / "d.json", "--jobs", "1")
    assert not (tmp_path / "d.json").exists()


def test_a_damaged_bag_is_named_and_left_out(document: Document, hidden_campaign: Path, tmp_path: Path) -> None:
    runs = Path(shutil.copytree(hidden_campaign, tmp_path / "runs"))
    broken = next((runs / "push" / "parcel__case_1__s1.000__r0").glob("*.mcap"))
    broken.write_bytes(broken.read_bytes()[:2000])
    (left_out,) = document("compare", runs, "--jobs", "1")["skipped"]
    assert left_out["name"] == "push/parcel__case_1__s1.000__r0"
    assert "damaged" in left_out["reason"] or "readable" in left_out["reason"]


def _not_a_number(message: Any) -> None:
    message.velocity = np.where(np.arange(7) == 3, np.nan, message.velocity)


def _backwards(message: Any) -> None:
    message.header.stamp.nanosec -= 5_000_000


def _late(message: Any) -> None:
    seconds, message.header.stamp.nanosec = divmod(message.header.stamp.nanosec + 9_000_000, 1_000_000_000)
    message.header.stamp.sec += seconds


@pytest.mark.parametrize(
    ("spoil", "until", "complaint"),
    [
        (_not_a_number, 701, "not finite at t = 0.700 s"),
        (_backwards, 701, "run backwards at t = 0.6"),
        (_late, 10**6, "gap of 0.01"),
    ],
)
def test_a_spoilt_signal_is_named_with_its_time(
    refused: Refused,
    hidden_campaign: Path,
    tmp_path: Path,
    rewrite_bag: Rewrite,
    spoil: Callable[[Any], None],
    until: int,
    complaint: str,
) -> None:
    """Joint states from sample 700 on, at 1 kHz."""
    name, count = "push/juice__case_1__s1.000__r0", iter(range(10**6))

    def change(topic: str, message: Any) -> None:
        if topic == "/arm/joint_states" and 700 <= next(count) < until:
            spoil(message)

    rewrite_bag(hidden_campaign / name, tmp_path / "runs" / name, lambda topic: True, change)
    assert complaint in refused("compare", tmp_path / "runs", "-o", tmp_path / "report", warned=True)
    assert not (tmp_path / "report").exists()
