# SPDX-License-Identifier: Apache-2.0
"""Recordings that nobody here made: read right, refused clearly, and diagnosed as planted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, read_document
from impact_rs_analysis.diagnosis.hold_out import folds_of
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_cli.main import main
from impact_rs_sim.effects.formula import FormulaParameter, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.bag_file import typestore_for
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import is_foreign, read_recordings

RATE = 50.0  # Hz
DURATION = 36.0  # s
TRUE_COULOMB = np.array([0.4, 0.5, 0.3, 0.45, 0.35, 0.25, 0.3])  # N m
TRUE_OFFSET = np.array([0.5, -0.6, 0.0, 0.4, 0.0, 0.0, 0.0])  # N m
TRUE_PAYLOAD = 0.7  # kg, at the flange
NOISE = 0.05  # N m
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad

Columns = dict[str, Any]


def synthetic(coulomb: Any = 0.0, offset: Any = 0.0, payload: float = 0.0) -> Columns:
    """An arm that swings every joint at its own frequencies, with what is planted; tau = ID - friction - offset."""
    mapping = load_mapping("joint_state")
    end = mapping.end_effector.model_copy(update={"mass": payload}).build()
    model = RobotModel(mapping.facts, end)
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    joints = np.arange(7)
    low, high = 2 * np.pi * (0.11 + 0.017 * joints), 2 * np.pi * (0.31 - 0.013 * joints)
    t = time[:, None]
    q = CENTRE + 0.45 * np.sin(low * t + joints) + 0.12 * np.sin(high * t)
    dq = 0.45 * low * np.cos(low * t + joints) + 0.12 * high * np.cos(high * t)
    ddq = -0.45 * low**2 * np.sin(low * t + joints) - 0.12 * high**2 * np.sin(high * t)
    torque = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)])
    noise = np.random.default_rng(1).normal(0.0, NOISE, q.shape)
    torque = torque + coulomb * np.tanh(dq / 0.005) - offset + noise
    return {"time": time, "position": q, "velocity": dq, "effort": torque}


def write_npz(path: Path, columns: Columns) -> Path:
    np.savez(path, **columns)
    return path


def write_bag(path: Path, columns: Columns, storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    """A bag of JointState messages; returns the single file in it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/JointState"
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    shuffled = [6, 0, 1, 2, 3, 4, 5]  # drivers do not agree on an order
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for index, time in enumerate(columns["time"]):
            nanoseconds = round(time * 1e9)
            seconds, rest = divmod(nanoseconds, 10**9)
            message = store.types[kind](
                header=header(stamp=stamp(sec=seconds, nanosec=rest), frame_id=""),
                name=[f"fer_joint{joint + 1}" for joint in shuffled],
                **{name: columns[name][index][shuffled] for name in ("position", "velocity", "effort")},
            )
            writer.write(connection, nanoseconds, store.serialize_cdr(message, kind))
    return next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))


def source_of(path: Path, model: Model | None = None) -> RecordingSource:
    mapping = load_mapping("joint_state")
    return RecordingSource.of(read_recordings(path, mapping), mapping, model or Model(name="nominal"))


def diagnosed_recording(path: Path) -> DiagnosisDocument:
    source = source_of(path)
    return diagnose(source, source.model)


def effect(found: DiagnosisDocument, name: str) -> EffectDocument:
    return next(entry for entry in found.effects if entry.name == name)


@pytest.fixture(scope="module")
def planted() -> Columns:
    return synthetic(TRUE_COULOMB, TRUE_OFFSET)


def test_planted_friction_and_offset_are_found_joint_by_joint(planted: Columns, tmp_path: Path) -> None:
    found = diagnosed_recording(write_npz(tmp_path / "planted.npz", planted))
    assert set(found.named) == {"joint_coulomb_friction", "torque_offset"}
    friction = effect(found, "joint_coulomb_friction")
    for joint, true in enumerate(TRUE_COULOMB):
        assert friction.parameters[f"coulomb_joint{joint + 1}"].estimate == pytest.approx(true, abs=0.08)
    offset = effect(found, "torque_offset")
    for joint, true in enumerate(TRUE_OFFSET):
        assert offset.parameters[f"offset_joint{joint + 1}"].estimate == pytest.approx(true, abs=0.08)
    verdicts = [value.verdict for value in offset.parameters.values()]
    assert verdicts[0] == verdicts[1] == verdicts[3] == "CONFIRMED"
    assert {verdicts[index] for index in (2, 4, 5, 6)} == {"NO-IMPROVEMENT"}
    assert effect(found, "end_effector_payload").verdict == "NO-IMPROVEMENT"
    assert effect(found, "restitution").reason == "not measured: no contact was measured"
    assert found.held_out_error_after < 0.3 * found.held_out_error_before
    json.dumps(found.model_dump(mode="json"), allow_nan=False)


def test_a_diagnosed_recording_makes_a_better_model(
    planted: Columns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, diagnosis, model = (str(tmp_path / name) for name in ("planted.npz", "d.json", "model_2.yaml"))
    write_npz(Path(recording), planted)
    report = tmp_path / "report"
    assert main(["diagnose", recording, "-o", diagnosis, "--report", str(report)]) == 0
    page = (report / "diagnosis.html").read_text()
    assert "joint_coulomb_friction" in page and "torque of joint 7" in page
    assert main(["add", "joint_coulomb_friction", "--from", diagnosis, "-o", model]) == 0
    capsys.readouterr()
    scores = []
    for arguments in ([], ["--model", model]):
        assert main(["compare", recording, "--json", "-o", str(report), *arguments]) == 0
        scores.append(json.loads(capsys.readouterr().out)["score"])
    offsets = float(np.sqrt(np.mean(np.square(TRUE_OFFSET))))
    assert scores[0] > 1.3 * offsets and scores[1] == pytest.approx(offsets, rel=0.1)
    assert main(["add", "torque_offset", "--model", model, "--from", diagnosis, "-o", str(tmp_path / "m3.yaml")]) == 2
    assert "not of 'model_2'" in capsys.readouterr().err


def test_planted_payload_is_found(tmp_path: Path) -> None:
    found = diagnosed_recording(write_npz(tmp_path / "loaded.npz", synthetic(TRUE_COULOMB, payload=TRUE_PAYLOAD)))
    assert set(found.named) == {"joint_coulomb_friction", "end_effector_payload"}
    mass = effect(found, "end_effector_payload").parameters["mass"]
    assert mass.interval[0] <= TRUE_PAYLOAD <= mass.interval[1]
    assert mass.estimate == pytest.approx(TRUE_PAYLOAD, abs=0.05)


def test_friction_written_as_a_formula_explains_as_much_as_the_library_s_own(planted: Columns, tmp_path: Path) -> None:
    """Both act on the motors; a formula that does was not measured in a recording before."""
    joints = [f"joint{joint + 1}" for joint in range(7)]
    spec = FormulaSpec(
        name="dry",
        sentence="Friction of the test.",
        motor_torque={joint: f"-c{n} * tanh(dq{n} / 0.005)" for n, joint in enumerate(joints, start=1)},
        parameters={
            f"c{n}": FormulaParameter(unit="N m", lower=0.0, upper=5.0, scale=0.1) for n in range(1, len(joints) + 1)
        },
    )
    source = source_of(write_npz(tmp_path / "planted.npz", planted), Model(name="own", formulas=(spec,)))
    found = diagnose(source, source.model, ["dry", "torque_offset"])
    assert set(found.named) == {"dry", "torque_offset"}
    for number, true in enumerate(TRUE_COULOMB, start=1):
        assert effect(found, "dry").parameters[f"c{number}"].estimate == pytest.approx(true, abs=0.08)


def test_whole_recordings_are_held_out_where_there_are_several(planted: Columns, tmp_path: Path) -> None:
    for number in range(3):
        rows = slice(600 * number, 600 * (number + 1))
        write_npz(tmp_path / f"part_{number}.npz", {name: values[rows] for name, values in planted.items()})
    source = source_of(tmp_path)
    folds = folds_of(source)
    assert len(folds) == 3
    for fold in folds:
        assert len({source.clusters[number].unit for number in fold.held}) == 1
        units = {source.clusters[number].unit for number in fold.training}
        assert len(units) == 2 and not units & {source.clusters[number].unit for number in fold.held}


def test_a_diagnosis_of_version_0_1_0_is_still_read(tmp_path: Path) -> None:
    old = {
        "kind": "recording",
        "verdict": "end_effector_payload",
        "effects": [
            {
                "name": "end_effector_payload",
                "sentence": "Something is mounted.",
                "verdict": "CONFIRMED",
                "reason": None,
                "parameters": {
                    "mass": {"estimate": 0.5, "ci95": [0.4, 0.6], "unit": "kg", "meaning": "added mass"},
                    "first_moment_z": {"estimate": -0.05, "ci95": [-0.1, 0.0], "unit": "kg m", "meaning": "moment"},
                },
                "joints": [],
                "held_out_error_before": 0.4,
                "held_out_error_after": 0.2,
                "p_value": 1e-6,
            }
        ],
        "confusable": [],
        "named": ["end_effector_payload"],
        "noise_floor": 0.1,
        "held_out_error_before": 0.4,
        "held_out_error_after": 0.2,
        "unexplained": {"share_of_excess": 0.1, "where": []},
        "next_experiment": {"advice": "hold still", "splits": []},
        "remarks": [],
        "recording": {"files": ["/somewhere/a.db3"]},
        "model": {"name": "nominal", "digest": "0"},
        "formulas": [],
    }
    old["recording"] |= {"robot": "franka_fer", "end_effector_mass_kg": 0.0, "samples": 700, "recorded_s": 24.0}
    old["recording"] |= {"used_s": 22.0, "sampled_Hz": 30.0, "low_pass_Hz": 3.0, "low_pass": "Butterworth"}
    path = tmp_path / "old.json"
    path.write_text(json.dumps(old))
    found = read_document(path)
    assert (found.source, found.runs.conditions, found.error_unit) == ("recordings", ("a.db3",), "N m")
    assert effect(found, "end_effector_payload").parameters["com_z"].estimate == pytest.approx(-0.1)


def test_a_rigid_robot_lacks_nothing(tmp_path: Path) -> None:
    found = diagnosed_recording(write_npz(tmp_path / "rigid.npz", synthetic()))
    assert (found.verdict, found.named) == ("NOTHING-MISSING", ())


def test_all_kinds_of_files_say_the_same(planted: Columns, tmp_path: Path) -> None:
    few = {name: values[:600] for name, values in planted.items()}
    mapping = load_mapping("joint_state")
    csv = tmp_path / "r.csv"
    names = ["time"] + [f"{signal}_{joint + 1}" for signal in ("position", "velocity", "effort") for joint in range(7)]
    table = np.column_stack([few["time"], few["position"], few["velocity"], few["effort"]])
    np.savetxt(csv, table, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    paths = [
        write_bag(tmp_path / "sqlite", few),
        write_bag(tmp_path / "mcap", few, StoragePlugin.MCAP),
        csv,
        write_npz(tmp_path / "r.npz", few),
        tmp_path / "sqlite",
    ]
    recordings = [read_recordings(path, mapping)[0] for path in paths]
    for recording in recordings:
        assert np.allclose(recording.time, few["time"], atol=1e-9)
        for name, column in (("position", "position"), ("velocity", "velocity"), ("torque", "effort")):
            assert np.array_equal(getattr(recording, name), few[column])
    assert all(is_foreign(path) for path in paths)


def test_what_a_frozen_or_wild_sensor_spoiled_is_left_out_and_told(planted: Columns, tmp_path: Path) -> None:
    """Left are the stretches before and after, with names of their own, and their residuals as without the faults."""
    whole = source_of(write_npz(tmp_path / "whole.npz", planted))
    position, velocity = planted["position"].copy(), planted["velocity"].copy()
    stuck = (planted["time"] >= 12.0) & (planted["time"] < 20.0)
    position[stuck, 3] = position[stuck, 3][0]
    velocity[100, 5] = 50.0
    source = source_of(write_npz(tmp_path / "spoiled.npz", {**planted, "position": position, "velocity": velocity}))
    told = "; ".join(source.remarks)
    assert "spoiled.npz: array 'position' (position): joint 4: frozen at" in told
    assert "(velocity): joint 6: 1 of" in told
    assert told.count("joint 4") == 1
    names = [item.name for item in source.clusters]
    assert len(set(names)) == len(names)
    assert not any(12.0 < float(name.split()[1]) < 20.0 for name in names)
    assert source.facts.files == (str(tmp_path / "spoiled.npz"),)
    np.testing.assert_allclose(source.sigma, whole.sigma, rtol=0.2)
    assert compare(source).remarks == source.remarks[-2:]


def test_a_campaign_is_not_foreign(push_campaign: Path) -> None:
    assert not is_foreign(push_campaign)


def test_franka_robot_state_is_read_without_its_package(planted: Columns, tmp_path: Path) -> None:
    mapping = load_mapping("franka_robot_state")
    store = typestore_for(mapping)
    kind = "franka_msgs/msg/FrankaRobotState"

    def blank(name: str) -> Any:
        """A message with zeros everywhere."""
        values: dict[str, Any] = {}
        for field, (node, what) in store.fielddefs[name][1]:
            number = int(node)
            if number == 2:
                values[field] = blank(str(what))
            elif number == 1:
                base = what[0]
                values[field] = "" if base == "string" else False if base == "bool" else 0
            elif number == 3:
                values[field] = np.zeros(what[1])
            else:
                values[field] = [] if what[0][1][0] == "string" else np.zeros(0)
        return store.types[name](**values)

    rng = np.random.default_rng(0)
    others = {name: rng.normal(size=(200, 7)) for name in ("theta", "dtheta", "tau_J_d", "dtau_J")}
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/franka_robot_state_broadcaster/robot_state", kind, typestore=store)
        for index in range(200):
            message = blank(kind)
            seconds, rest = divmod(round(planted["time"][index] * 1e9), 10**9)
            message.header.stamp.sec, message.header.stamp.nanosec = seconds, rest
            names = [f"fr3_joint{joint + 1}" for joint in range(7)]
            state, motor, desired = (
                message.measured_joint_state, message.measured_joint_motor_state, message.desired_joint_state
            )  # fmt: skip
            state.name = motor.name = desired.name = names
            state.position, state.velocity = planted["position"][index], planted["velocity"][index]
            state.effort = planted["effort"][index]
            motor.position, motor.velocity = others["theta"][index], others["dtheta"][index]
            desired.effort, message.dtau_j = others["tau_J_d"][index], others["dtau_J"][index]
            writer.write(connection, index + 1, store.serialize_cdr(message, kind))
    recording = read_recordings(tmp_path / "bag", mapping)[0]
    assert np.array_equal(recording.torque, planted["effort"][:200])
    for name, key in (
        ("motor_position", "theta"), ("motor_velocity", "dtheta"), ("command", "tau_J_d"), ("torque_rate", "dtau_J")
    ):  # fmt: skip
        assert np.array_equal(recording.others[name], others[key])


def _nan(columns: Columns) -> None:
    columns["effort"][50, 2] = np.nan


def _gap(columns: Columns) -> None:
    columns["time"][300:] += 1.0


def _backwards(columns: Columns) -> None:
    columns["time"][200:] -= 0.5


def _degrees(columns: Columns) -> None:
    columns["position"] = np.rad2deg(columns["position"])


def _fast(columns: Columns) -> None:
    columns["velocity"] = 0.3 * columns["velocity"]


def _missing_joint(columns: Columns) -> None:
    columns["position"] = columns["position"][:, :6]


def _short(columns: Columns) -> None:
    for name in columns:
        columns[name] = columns[name][:50]


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (_nan, "torque of joint 3 is not a number at t = 1.000 s"),
        (_gap, "gap of 1.020 s at t = 5.980 s"),
        (_backwards, "time stamps run backwards"),
        (_degrees, "wrong unit (now rad)"),
        (_fast, "times the derivative of position, expected 1"),
        (_missing_joint, "expected 1800 samples x 7 joints"),
        (_short, "50 samples, at least 100 are needed"),
    ],
)
def test_bad_recordings_are_refused_in_one_line(
    planted: Columns, tmp_path: Path, spoil: Callable[[Columns], None], expected: str
) -> None:
    columns = {name: values.copy() for name, values in planted.items()}
    spoil(columns)
    path = write_npz(tmp_path / "bad.npz", columns)
    with pytest.raises(InputError) as caught:
        source_of(path)
    assert str(path) in str(caught.value) and expected in str(caught.value)


def test_foreign_topics_and_empty_files_end_with_code_2(
    planted: Columns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", {name: values[:200] for name, values in planted.items()})
    empty = tmp_path / "empty.db3"
    empty.touch()
    for path, mapping, expected in (
        (bag, "franka_robot_state", "expected topic *robot_state"),
        (empty, "joint_state", "this file is empty"),
        (bag, "joint_stat", "did you mean 'joint_state'?"),
        (tmp_path / "nowhere", "joint_state", "no such file or folder"),
    ):
        for command in ("compare", "diagnose"):
            assert main([command, str(path), "--mapping", mapping]) == 2
            error = capsys.readouterr().err
            assert expected in error and len(error.splitlines()) == 1


def test_a_real_robot_lacks_joint_friction_and_no_payload(real_bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(real_bag), "--json"]) == 0
    compared = json.loads(capsys.readouterr().out)
    rigid = [row["error"] for row in compared["levels"]["recording"]["signals"]]
    assert rigid == pytest.approx([0.48, 0.31, 0.33, 0.46, 0.44, 0.31, 0.27], abs=0.02)
    assert main(["diagnose", str(real_bag), "--mapping", "joint_state", "--json"]) == 0
    found = DiagnosisDocument.model_validate_json(capsys.readouterr().out)
    friction = effect(found, "joint_coulomb_friction")
    assert friction.verdict == "CONFIRMED"
    assert sum(value.verdict == "CONFIRMED" for value in friction.parameters.values()) >= 4
    payload = effect(found, "end_effector_payload")
    assert payload.verdict != "CONFIRMED" and abs(payload.parameters["mass"].estimate) < 0.2
    after = np.array([row.after for row in found.joints])
    assert np.all(after < [0.34, 0.27, 0.25, 0.25, 0.25, 0.12, 0.11])  # of searches that have not seen it
