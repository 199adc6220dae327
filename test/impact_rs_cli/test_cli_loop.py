# SPDX-License-Identifier: Apache-2.0
"""The loop on the command line: compare, diagnose, add, compare, history; and every way to get it wrong."""

import argparse
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pytest

from impact_rs_cli.arguments import on_local_runs
from impact_rs_cli.commands.demo import Demonstration, walk_the_loop
from impact_rs_cli.main import main
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.model import Model, load_model

CONSIDERED = ["support_friction"]  # what hidden_campaign hides


@pytest.fixture(scope="module")
def model_2(diagnosed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("models") / "model_2.yaml"
    assert main(["add", "support_friction", "--from", str(diagnosed), "-o", str(path)]) == 0
    return path


def _json(capfd: pytest.CaptureFixture, *arguments: str) -> dict:
    capfd.readouterr()
    assert main([*arguments, "--json"]) == 0
    return dict(json.loads(capfd.readouterr().out))


def test_the_loop_makes_the_score_fall(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, model_2: Path, tmp_path: Path
) -> None:
    report, aligned = tmp_path / "report", tmp_path / "aligned"
    after = _json(
        capfd, "compare", str(hidden_campaign), "--model", str(model_2), "-o", str(report), "--mcap", str(aligned)
    )
    assert (report / "compare.html").stat().st_size > 1_000_000
    assert len(list(aligned.glob("*/*.mcap"))) == 3
    history = _json(capfd, "history", str(model_2), "--runs", str(hidden_campaign), "--jobs", "1")["history"]
    assert [entry["effect_added"] for entry in history] == [None, "support_friction"]
    assert after["score"] < 0.5 * history[0]["error_fit"]
    assert history[1]["error_fit"] == pytest.approx(after["score"], rel=1e-6)
    assert history[1]["error_held_out"] < 0.5 * history[0]["error_held_out"]


def test_runs_at_a_url_become_a_folder_for_the_command(capfd: pytest.CaptureFixture) -> None:
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
    _refused(capfd, ["diagnose", "memory://runs"], "memory://runs: no bags of trials here")


def test_effects_lists_parameters_with_units(capfd: pytest.CaptureFixture) -> None:
    everything = {effect["name"]: effect for effect in _json(capfd, "effects")["effects"]}
    assert {"torque_offset", "support_friction", "object_mass"} <= set(everything)
    (one,) = _json(capfd, "effects", "torque_offset")["effects"]
    assert one == everything["torque_offset"]
    (parameter,) = one["parameters"]
    assert (parameter["unit"], parameter["per_joint"]) == ("N m", True)


def _refused(capfd: pytest.CaptureFixture, arguments: list[str], message: str) -> None:
    capfd.readouterr()
    assert main(arguments) == 2
    captured = capfd.readouterr()
    lines = [line for line in captured.err.splitlines() if line.startswith("impact-rs")]
    assert captured.out == ""
    assert len(lines) == 1
    assert message in lines[0], lines[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: m\neffects:\n- {name: torque_ofset, parameters: {}}\n", "unknown effect"),
        (
            "name: m\neffects:\n- name: support_friction\n  parameters: {scale: {estimate: 9, unit: '-'}}\n",
            "expected 0 ... 4",
        ),
        (
            "name: m\neffects:\n- name: support_friction\n  parameters: {scale: {estimate: 1, unit: kg}}\n",
            "expected the unit",
        ),
        ("name: m\nefects: []\n", "unknown key"),
    ],
)
def test_a_wrong_model_file(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, tmp_path: Path, text: str, message: str
) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(text)
    _refused(capfd, ["compare", str(hidden_campaign), "--model", str(file)], message)


@pytest.mark.parametrize(
    ("formula", "message"),
    [("import os", "does not parse"), ("__import__('os')", "unknown function"), ("c * dq9", "unknown symbol 'dq9'")],
)
def test_a_formula_that_does_not_parse(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, tmp_path: Path, formula: str, message: str
) -> None:
    _formula(tmp_path, formula)
    arguments = ["diagnose", str(hidden_campaign), "-o", str(tmp_path / "d.json"), "--formulas"]
    _refused(capfd, [*arguments, str(tmp_path / "f.yaml")], message)
    assert not (tmp_path / "d.json").exists()


def test_a_formula_that_blows_up(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    _formula(tmp_path, "c * exp(exp(20))")
    arguments = ["diagnose", str(hidden_campaign), "-o", str(tmp_path / "d.json"), "--effects", "drag", "--formulas"]
    _refused(capfd, [*arguments, str(tmp_path / "f.yaml")], "blows up")
    assert not (tmp_path / "d.json").exists()


def test_the_formula_of_the_manual_is_diagnosed_in_several_processes(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    manual = (Path(__file__).parents[2] / "docs" / "missing_effects.md").read_text()
    cable, model = tmp_path / "cable.yaml", tmp_path / "model_2.yaml"
    cable.write_text(manual.split("```yaml\n")[1].split("```")[0])
    output = tmp_path / "diagnosis.json"
    arguments = ["diagnose", str(hidden_campaign), "-o", str(output), "--formulas", str(cable), "--jobs", "2"]
    document = _json(capfd, *arguments, "--effects", "cable_drag", *CONSIDERED)
    found = {effect["name"]: effect for effect in document["effects"]}
    low, high = found["cable_drag"]["parameters"]["drag"]["ci95"]
    assert (document["named"], found["cable_drag"]["measured"]) == (CONSIDERED, True)
    assert low == 0.0 < high  # there is no cable
    assert main(["add", "cable_drag", "--from", str(output), "-o", str(model), "--force"]) == 0
    assert load_model(model).formulas[0].end_effector_force == {"y": "-drag * vy"}


def test_the_demonstration_keeps_the_page_that_shows_where_the_model_fails(
    capsys: pytest.CaptureFixture, hidden_campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # more processes only start
    hidden = {"name": "support_friction", "parameters": {"scale": {"estimate": 1.6, "unit": "-"}}}
    demonstration = Demonstration(hidden=Model(name="hidden", effects=(hidden,)), considered=tuple(CONSIDERED))
    story = walk_the_loop(demonstration, tmp_path, hidden_campaign, Terminal(as_json=False))
    assert story["correct"]
    lacks, better, fails = (Path(path) for path in story["reports"])
    assert json.loads(fails.with_suffix(".json").read_text())["model"]["name"] == "nominal"
    assert json.loads(better.with_suffix(".json").read_text())["model"]["name"] == "model_2"
    out = capsys.readouterr().out
    for page in (lacks, better, fails):
        assert str(page.resolve()) in out
    for page in (better, fails):
        links = re.findall(r'<a href="(.*?)">', page.read_text(encoding="utf-8"))
        assert {(page.parent / link).resolve() for link in links} == {lacks, better, fails} - {page}


def _formula(folder: Path, formula: str) -> None:
    parameter = "c: {unit: N m, nominal: 0, lower: 0, upper: 3, scale: 0.1}"
    (folder / "f.yaml").write_text(
        f'effects:\n- name: drag\n  sentence: It drags.\n  joint_torque: {{joint2: "{formula}"}}\n'
        f"  parameters: {{{parameter}}}\n"
    )


def test_names_and_files_that_are_not_there(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, diagnosed: Path, model_2: Path, tmp_path: Path
) -> None:
    runs, output = str(hidden_campaign), str(tmp_path / "new" / "model.yaml")
    _refused(capfd, ["compare", "/nowhere/at/all"], "no such folder")
    _refused(capfd, ["compare", str(tmp_path)], "no usable trials")
    _refused(capfd, ["compare", runs, "--model", "/nowhere.yaml"], "cannot be read")
    _refused(capfd, ["compare", runs, "--jobs", "0"], "jobs = 0")
    _refused(capfd, ["diagnose", runs, "--effects", "suport_friction"], "did you mean 'support_friction'")
    _refused(capfd, ["diagnose", runs, "--model", str(model_2), "--effects", "support_friction"], "already")
    _refused(capfd, ["effects", "torque_ofset"], "did you mean 'torque_offset'")
    _refused(capfd, ["add", "base_tilt", "--from", str(diagnosed), "-o", output], "no effect 'base_tilt'")
    _refused(capfd, ["add", "support_friction", "--from", str(tmp_path / "no.json"), "-o", output], "cannot be read")
    (tmp_path / "broken.json").write_text("{")
    _refused(
        capfd, ["add", "support_friction", "--from", str(tmp_path / "broken.json"), "-o", output], "not valid JSON"
    )
    again = ["add", "support_friction", "--from", str(diagnosed), "--model", str(model_2), "-o", output]
    _refused(capfd, again, "not of 'model_2'")
    _refused(capfd, ["add", "support_friction", "--from", str(diagnosed), "-o", str(model_2)], "never overwritten")
    _refused(capfd, ["blind", "score", str(tmp_path), "--diagnosis", str(diagnosed)], "no blind campaign")
    _refused(capfd, ["blind", "make", "-1", "-o", str(tmp_path / "blind")], "")
    _refused(capfd, ["blind", "make", "1", "-o", str(tmp_path / "blind"), "--effect", "frictoin"], "no effect")
    assert not (tmp_path / "new").exists() and not (tmp_path / "blind").exists()


def test_too_few_conditions_say_what_still_works(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, tmp_path: Path
) -> None:
    shutil.copytree(hidden_campaign / "push", tmp_path / "push")
    few = ["diagnose", str(tmp_path), "-o", str(tmp_path / "d.json"), "--jobs", "1"]
    _refused(capfd, few, "impact-rs compare")
    assert not (tmp_path / "d.json").exists()


def test_bags_that_cannot_be_used_are_named_and_left_out(
    capfd: pytest.CaptureFixture, hidden_campaign: Path, tmp_path: Path
) -> None:
    runs = Path(shutil.copytree(hidden_campaign, tmp_path / "runs"))
    broken = next((runs / "push" / "parcel__case_1__s1.000__r0").glob("*.mcap"))
    broken.write_bytes(broken.read_bytes()[:2000])
    document = _json(capfd, "compare", str(runs), "--jobs", "1")
    (left_out,) = document["skipped"]
    assert left_out["name"] == "push/parcel__case_1__s1.000__r0"
    assert "damaged" in left_out["reason"] or "readable" in left_out["reason"]


def _spoil(source: Path, target: Path, spoil: Callable[[int, Any], None]) -> None:
    """Copy a bag, as another program does (no checksums), and change some messages of the arm's joint states."""
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer

    from impact_rs_trials.bags import checksums
    from impact_rs_trials.bags.types import typestore

    store = typestore()
    target.parent.mkdir(parents=True, exist_ok=True)
    with Reader(source) as reader:
        writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
        for name, value in (reader.storage.metadata.custom or {}).items():
            if name != checksums.NAME:
                writer.set_custom_data(name, value)
        with writer:
            connections = {
                c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections
            }
            number = 0
            for connection, timestamp, data in reader.messages():
                if connection.topic == "/arm/joint_states":
                    message = store.deserialize_cdr(data, connection.msgtype)
                    spoil(number, message)
                    data = store.serialize_cdr(message, connection.msgtype)
                    number += 1
                writer.write(connections[connection.topic], timestamp, data)


def _not_a_number(number: int, message: Any) -> None:
    if number == 700:
        message.velocity = np.where(np.arange(7) == 3, np.nan, message.velocity)


def _backwards(number: int, message: Any) -> None:
    if number == 700:
        message.header.stamp.nanosec -= 5_000_000


def _gap(number: int, message: Any) -> None:
    if number >= 700:
        seconds, message.header.stamp.nanosec = divmod(message.header.stamp.nanosec + 9_000_000, 1_000_000_000)
        message.header.stamp.sec += seconds


@pytest.mark.parametrize(
    ("spoil", "message"),
    [(_not_a_number, "not finite at t = 0.700 s"), (_backwards, "run backwards at t = 0.6"), (_gap, "gap of 0.01")],
)
def test_spoilt_signals_are_told_by_place(
    capfd: pytest.CaptureFixture,
    hidden_campaign: Path,
    tmp_path: Path,
    spoil: Callable[[int, Any], None],
    message: str,
) -> None:
    name = "push/juice__case_1__s1.000__r0"
    _spoil(hidden_campaign / name, tmp_path / "runs" / name, spoil)
    _refused(capfd, ["compare", str(tmp_path / "runs"), "-o", str(tmp_path / "report")], message)
    assert not (tmp_path / "report").exists()
