# SPDX-License-Identifier: Apache-2.0
"""Recordings of others: read right, refused clearly, and diagnosed as planted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest
from intervals import assert_covers
from joint_recordings import SIGNALS, Columns, swinging, write_bag, write_csv, write_npz
from ros_messages import message
from rosbags.rosbag2 import StoragePlugin, Writer

from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, read_document
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, replay_and_refit
from impact_rs_analysis.diagnosis.search.hold_out import folds_of
from impact_rs_analysis.evidence.sources.recording_source import TORQUE, RecordingSource
from impact_rs_cli.main import main
from impact_rs_sim.effects.formula import FormulaParameter, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.readers.bag_file import typestore_for
from impact_rs_trials.recordings.recording import ARM, is_foreign, read_recordings

MAPPING = load_mapping("joint_state")
TRUE_COULOMB = np.array([0.4, 0.5, 0.3, 0.45, 0.35, 0.25, 0.3])  # N m
TRUE_OFFSET = np.array([0.5, -0.6, 0.0, 0.4, 0.0, 0.0, 0.0])  # N m
TRUE_PAYLOAD = 0.7  # kg, at the flange
NOISE = 0.05  # N m
CONSIDERED = ["joint_coulomb_friction", "torque_offset", "end_effector_payload", "torque_gain", "restitution"]
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad


def synthetic(coulomb: Any = 0.0, offset: Any = 0.0, payload: float = 0.0) -> Columns:
    """36 s at 50 Hz of an arm with what is planted; tau = ID - friction - offset."""
    end = MAPPING.end_effector.model_copy(update={"mass": payload}).build()
    frequencies = 0.11 + 0.017 * np.arange(7), 0.31 - 0.013 * np.arange(7)
    found = swinging(RobotModel(MAPPING.facts, end), np.arange(0.0, 36.0, 0.02), CENTRE, frequencies, (0.45, 0.12))
    found["effort"] += coulomb * np.tanh(found["velocity"] / 0.005) - offset
    found["effort"] += np.random.default_rng(1).normal(0.0, NOISE, found["effort"].shape)
    return found


def part(columns: Columns, start: int, stop: int) -> Columns:
    return {name: values[start:stop] for name, values in columns.items()}


def source_of(path: Path, model: Model | None = None) -> RecordingSource:
    return RecordingSource.of(read_recordings(path, MAPPING), MAPPING, model or Model(name="nominal"))


def diagnosed(folder: Path, columns: Columns) -> DiagnosisDocument:
    source = source_of(write_npz(folder / "a.npz", columns))
    return diagnose(source, source.model)


def effect(found: DiagnosisDocument, name: str) -> EffectDocument:
    entry = found.effect(name)
    assert entry is not None
    return entry


def estimates(found: DiagnosisDocument, name: str, parameter: str) -> list[float]:
    return [effect(found, name).parameters[parameter.format(joint)].estimate for joint in range(1, 8)]


@pytest.fixture(scope="module")
def planted() -> Columns:
    return synthetic(TRUE_COULOMB, TRUE_OFFSET)


@pytest.fixture(scope="module")
def folder(planted: Columns, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording with friction and offset, and its diagnosis by the command line."""
    made = tmp_path_factory.mktemp("planted")
    recording = str(write_npz(made / "planted.npz", planted))
    arguments = ["-o", str(made / "d.json"), "--report", str(made / "report"), "--effects", *CONSIDERED]
    assert main(["diagnose", recording, *arguments]) == 0
    return made


def test_planted_friction_and_offset_are_found_joint_by_joint(folder: Path) -> None:
    found = read_document(folder / "d.json")
    assert set(found.named) == {"joint_coulomb_friction", "torque_offset"}
    assert estimates(found, "joint_coulomb_friction", "coulomb_joint{}") == pytest.approx(TRUE_COULOMB, abs=0.08)
    assert estimates(found, "torque_offset", "offset_joint{}") == pytest.approx(TRUE_OFFSET, abs=0.08)
    verdicts = [str(value.verdict) for value in effect(found, "torque_offset").parameters.values()]
    assert verdicts == ["CONFIRMED" if true else "NO-IMPROVEMENT" for true in TRUE_OFFSET]
    assert str(effect(found, "end_effector_payload").verdict) == "NO-IMPROVEMENT"
    assert effect(found, "restitution").reason == "not measured: no contact was measured"
    assert found.held_out_error_after < 0.3 * found.held_out_error_before


def test_a_diagnosed_recording_makes_a_better_model(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (folder / "report" / "diagnosis.html").read_text()
    assert "joint_coulomb_friction" in page and "torque of joint 7" in page
    recording, diagnosis, model = (str(folder / name) for name in ("planted.npz", "d.json", "model_2.yaml"))
    assert main(["add", "joint_coulomb_friction", "--from", diagnosis, "-o", model]) == 0
    capsys.readouterr()
    scores = []
    for arguments in ([], ["--model", model]):
        assert main(["compare", recording, "--json", "-o", str(folder / "report"), *arguments]) == 0
        scores.append(json.loads(capsys.readouterr().out)["score"])
    offsets = float(np.sqrt(np.mean(np.square(TRUE_OFFSET))))
    assert scores[0] > 1.3 * offsets and scores[1] == pytest.approx(offsets, rel=0.1)
    assert main(["add", "torque_offset", "--model", model, "--from", diagnosis, "-o", str(folder / "m3.yaml")]) == 2
    assert "not of 'model_2'" in capsys.readouterr().err


def without_torque(planted: Columns, joint: int) -> Columns:
    return planted | {"effort": planted["effort"] * np.where(np.arange(7) == joint, 0.0, 1.0)}


def test_a_joint_whose_torque_was_not_measured_is_left_out(planted: Columns, tmp_path: Path) -> None:
    """A recording without any torque is refused."""
    source = source_of(write_npz(tmp_path / "a.npz", without_torque(planted, 2)))
    assert any("torque of joint 3 is 0 N m in all samples" in remark for remark in source.remarks)
    measured = {feature.index for item in source.clusters for feature in item.features if feature.signal == TORQUE}
    assert measured == {f"joint{number}" for number in (1, 2, 4, 5, 6, 7)}
    nothing = planted | {"effort": np.zeros_like(planted["effort"])}
    with pytest.raises(InputError, match="the torque of no joint ever changes"):
        source_of(write_npz(tmp_path / "b.npz", nothing))


@pytest.mark.slow
def test_beside_a_joint_without_torque_the_others_say_the_same(planted: Columns, folder: Path, tmp_path: Path) -> None:
    found, whole = diagnosed(tmp_path, without_torque(planted, 2)), read_document(folder / "d.json")
    assert set(found.named) == {"joint_coulomb_friction", "torque_offset"}
    others = np.arange(7) != 2
    for name, parameter in (("joint_coulomb_friction", "coulomb_joint{}"), ("torque_offset", "offset_joint{}")):
        pairs = zip(estimates(found, name, parameter), estimates(whole, name, parameter), strict=True)
        assert np.array([one - other for one, other in pairs])[others] == pytest.approx(0.0, abs=0.02)
        assert str(effect(found, name).parameters[parameter.format(3)].verdict) != "CONFIRMED"


@pytest.mark.slow
def test_planted_payload_is_found(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, synthetic(TRUE_COULOMB, payload=TRUE_PAYLOAD))
    assert set(found.named) == {"joint_coulomb_friction", "end_effector_payload"}
    mass = effect(found, "end_effector_payload").parameters["mass"]
    assert_covers(mass.interval, TRUE_PAYLOAD, 0.05)


def test_the_interval_of_a_payload_counts_the_scale_of_the_torque(tmp_path: Path) -> None:
    """Torques that are 1 % off look like a payload; a known motion has no other sign of them."""
    columns = synthetic(TRUE_COULOMB, payload=TRUE_PAYLOAD)
    columns["effort"] *= 1.0 + 0.01 * np.array([0.0, 1.5, 0.0, 1.5, 0.0, 0.0, 0.0])
    source = source_of(write_npz(tmp_path / "a.npz", columns))
    names = ["joint_coulomb_friction", "end_effector_payload"]
    fit = Search(effects_for(source, names), Evidence.of(source)).fitted(names)
    assert fit is not None
    fit = replay_and_refit(fit)
    index = fit.candidate.part("end_effector_payload").start
    error = abs(fit.estimate[index] - TRUE_PAYLOAD) / fit.candidate.scale[index]
    assert fit.half_widths_of_noise[index] < error < fit.half_widths[index]


@pytest.mark.slow
def test_friction_as_a_formula_explains_as_much_as_the_library_s_own(planted: Columns, tmp_path: Path) -> None:
    """Both act on the motors."""
    spec = FormulaSpec(
        name="dry",
        sentence="Friction of the test.",
        motor_torque={f"joint{n}": f"-c{n} * tanh(dq{n} / 0.005)" for n in range(1, 8)},
        parameters={f"c{n}": FormulaParameter(unit="N m", lower=0.0, upper=5.0, scale=0.1) for n in range(1, 8)},
    )
    source = source_of(write_npz(tmp_path / "planted.npz", planted), Model(name="own", formulas=(spec,)))
    found = diagnose(source, source.model, ["dry", "torque_offset"])
    assert set(found.named) == {"dry", "torque_offset"}
    assert estimates(found, "dry", "c{}") == pytest.approx(TRUE_COULOMB, abs=0.08)


def test_whole_recordings_are_held_out_where_there_are_several(planted: Columns, tmp_path: Path) -> None:
    for number in range(3):
        write_npz(tmp_path / f"part_{number}.npz", part(planted, 600 * number, 600 * (number + 1)))
    source = source_of(tmp_path)
    folds = folds_of(source)
    assert len(folds) == 3
    for fold in folds:
        held, training = ({source.clusters[n].unit for n in numbers} for numbers in (fold.held_out, fold.training))
        assert (len(held), len(training), held & training) == (1, 2, set())


def test_a_diagnosis_of_version_0_1_0_is_still_read() -> None:
    found = read_document(documents.OLD_DIAGNOSIS)
    assert (found.source, found.runs.conditions, found.error_unit) == ("recordings", ("a.db3",), "N m")
    payload = effect(found, "end_effector_payload").parameters
    assert payload["com_z"].estimate == pytest.approx(-0.1)  # -0.05 kg m of 0.5 kg


def test_a_rigid_robot_lacks_nothing(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, synthetic())
    assert (str(found.verdict), found.named) == ("NOTHING-MISSING", ())


def test_all_kinds_of_files_say_the_same(planted: Columns, tmp_path: Path) -> None:
    few, order = part(planted, 0, 600), [6, 0, 1, 2, 3, 4, 5]  # drivers do not agree on an order
    paths = [
        write_bag(tmp_path / "mcap", few, order),
        write_bag(tmp_path / "sqlite", few, order, StoragePlugin.SQLITE3),
        next((tmp_path / "sqlite").glob("*.db3")),
        next((tmp_path / "mcap").glob("*.mcap")),
        write_csv(tmp_path / "r.csv", few),
        write_npz(tmp_path / "r.npz", few),
    ]
    for path in paths:
        signals = read_recordings(path, MAPPING)[0].signals
        assert is_foreign(path) and np.allclose(signals.time, few["time"], atol=1e-9)
        for name, column in zip(("position", "velocity", "torque"), SIGNALS, strict=True):
            assert np.array_equal(getattr(signals.arms[ARM], name), few[column])


def test_what_a_frozen_or_wild_sensor_spoiled_is_left_out(planted: Columns, tmp_path: Path) -> None:
    """Left are the stretches before and after, with names of their own, and their residuals as without the faults."""
    whole = source_of(write_npz(tmp_path / "whole.npz", planted))
    position, velocity = planted["position"].copy(), planted["velocity"].copy()
    stuck = (planted["time"] >= 12.0) & (planted["time"] < 20.0)
    position[stuck, 3] = position[stuck, 3][0]
    velocity[100, 5] = 50.0
    source = source_of(write_npz(tmp_path / "spoiled.npz", planted, position=position, velocity=velocity))
    remarks = "; ".join(source.remarks)
    assert "spoiled.npz: array 'position' (position): joint 4: frozen at" in remarks
    assert "(velocity): joint 6: 1 of" in remarks and remarks.count("joint 4") == 1
    names = [item.name for item in source.clusters]
    assert len(set(names)) == len(names)
    assert not any(12.0 < float(name.split()[1]) < 20.0 for name in names)
    assert source.recording.files == (str(tmp_path / "spoiled.npz"),)
    np.testing.assert_allclose(source.sigma, whole.sigma, rtol=0.2)
    assert compare(source).remarks == source.remarks[-3:]


def test_franka_robot_state_is_read_without_its_package(planted: Columns, tmp_path: Path) -> None:
    mapping = load_mapping("franka_robot_state")
    store, kind = typestore_for(tmp_path, mapping.definitions), "franka_msgs/msg/FrankaRobotState"

    rng = np.random.default_rng(0)
    theta, dtheta, desired, rate = (rng.normal(size=(200, 7)) for _ in range(4))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/franka_robot_state_broadcaster/robot_state", kind, typestore=store)
        for row, time in enumerate(planted["time"][:200]):
            names = [f"fr3_joint{joint}" for joint in range(1, 8)]
            state = {f"measured_joint_state.{name}": planted[name][row] for name in SIGNALS}
            motor = {"position": theta[row], "velocity": dtheta[row], "name": names}
            content = {
                "header.stamp": divmod(round(time * 1e9), 10**9),
                "measured_joint_state.name": names,
                **state,
                **{f"measured_joint_motor_state.{name}": values for name, values in motor.items()},
                "desired_joint_state.name": names,
                "desired_joint_state.effort": desired[row],
                "dtau_j": rate[row],
            }
            data = store.serialize_cdr(message(kind, content, store), kind)
            writer.write(connection, row + 1, data)
    arm = read_recordings(tmp_path / "bag", mapping)[0].signals.arms[ARM]
    assert np.array_equal(arm.torque, planted["effort"][:200])
    for found, true in (
        (arm.motor_position, theta), (arm.motor_velocity, dtheta), (arm.command, desired), (arm.torque_rate, rate)
    ):  # fmt: skip
        assert np.array_equal(found, true)


def test_foreign_topics_and_empty_files_end_with_code_2(
    planted: Columns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", part(planted, 0, 200), range(7))
    (tmp_path / "empty.db3").touch()
    for path, mapping, expected in (
        (bag, "franka_robot_state", "expected topic *robot_state"),
        (tmp_path / "empty.db3", "joint_state", "this file is empty"),
        (bag, "joint_stat", "did you mean 'joint_state'?"),
        (tmp_path / "nowhere", "joint_state", "no such file or folder"),
    ):
        for command in ("compare", "diagnose"):
            assert main([command, str(path), "--mapping", mapping]) == 2
            error = capsys.readouterr().err
            assert expected in error and len(error.splitlines()) == 1


@pytest.mark.slow
def test_a_real_robot_lacks_joint_friction_and_no_payload(real_bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(real_bag), "--json"]) == 0
    compared = json.loads(capsys.readouterr().out)
    rigid = [row["error"] for row in compared["levels"]["recording"]["signals"]]
    assert rigid == pytest.approx([0.48, 0.31, 0.33, 0.46, 0.44, 0.31, 0.27], abs=0.02)
    assert main(["diagnose", str(real_bag), "--mapping", "joint_state", "--json"]) == 0
    found = DiagnosisDocument.model_validate_json(capsys.readouterr().out)
    friction = effect(found, "joint_coulomb_friction")
    assert str(friction.verdict) == "CONFIRMED"
    assert sum(str(value.verdict) == "CONFIRMED" for value in friction.parameters.values()) >= 4
    payload = effect(found, "end_effector_payload")
    assert str(payload.verdict) != "CONFIRMED" and abs(payload.parameters["mass"].estimate) < 0.2
    after = np.array([row.after for row in found.joints])
    assert np.all(after < [0.36, 0.27, 0.25, 0.25, 0.25, 0.12, 0.11])  # of searches that have not seen it


def compared(path: Path, capsys: pytest.CaptureFixture) -> Any:
    assert main(["compare", str(path), "--mapping", "joint_state", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_recording_that_is_too_short_is_left_out_of_a_folder_and_named(
    planted: Columns, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """60 samples are none; 110 are, and too few for the low-pass. The others are compared as without them."""
    write_npz(tmp_path / "a.npz", planted)
    alone = compared(tmp_path, capsys)
    write_npz(tmp_path / "few.npz", part(planted, 0, 60))
    write_npz(tmp_path / "short.npz", part(planted, 0, 110))
    found = compared(tmp_path, capsys)
    assert (found["score"], found["trials"]) == (alone["score"], alone["trials"])
    few, short = found["skipped"]
    assert few["name"].endswith("few.npz") and "60 samples, at least 100" in few["reason"]
    assert short["name"].endswith("short.npz") and "2.18 s long, at least" in short["reason"]
    left_out = [remark for remark in found["remarks"] if "is left out" in remark]
    assert [remark.split(":")[0] for remark in left_out] == ["few.npz is left out", "short.npz is left out"]


def test_recordings_that_are_all_too_short_or_named_are_refused(
    planted: Columns, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    for name in ("few", "fewer"):
        write_npz(tmp_path / f"{name}.npz", part(planted, 0, 60))
    assert main(["compare", str(tmp_path), "--mapping", "joint_state"]) == 2
    assert "none of 2 recordings is long enough: few.npz" in capsys.readouterr().err.replace("\n", " ")
    write_npz(tmp_path / "long.npz", planted)
    assert main(["compare", str(tmp_path / "few.npz"), "--mapping", "joint_state"]) == 2
    assert "60 samples, at least 100" in capsys.readouterr().err.replace("\n", " ")
