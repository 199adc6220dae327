# SPDX-License-Identifier: Apache-2.0
"""Recordings of arms with few joints, and of a cart: friction is found in its unit, and no payload is invented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from intervals import assert_covers
from joint_recordings import write_npz
from slender_arm import FLAT, UPRIGHT, lighter, mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.fit import Evidence
from impact_rs_analysis.diagnosis.search import Search
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.robot import JointType
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.recording import read_recordings

NOISE = 0.02  # N m, N
WIDTHS = {"planar": 0.01, "pendulum": 0.01, "cart": 0.1}  # kg, half of the interval of a payload

ARMS: dict[str, tuple[tuple[JointType, ...], tuple[float, ...], tuple[float, ...]]] = {
    # joints, rpy of the first, friction that is planted [N m, N]
    "planar": (("revolute",) * 3, FLAT, (0.6, 0.4, 0.2)),
    "upright": (("revolute",) * 3, UPRIGHT, (0.8, 0.5, 0.3)),
    "pendulum": (("revolute",) * 2, UPRIGHT, (0.6, 0.3)),
    "cart": (("prismatic", "revolute"), UPRIGHT, (12.0, 0.3)),
}


def diagnosed(folder: Path, name: str, payload: float = 0.0) -> DiagnosisDocument:
    """Diagnosis of a recording in which every joint swings at its own frequencies."""
    kinds, rpy, coulomb = ARMS[name]
    mapping = mapping_of(folder, slender_arm(kinds, rpy))
    friction = {f"coulomb_joint{joint}": value for joint, value in enumerate(coulomb, start=1)}
    effects = {"joint_coulomb_friction": friction, "end_effector_payload": {"mass": payload, "com_z": 0.0}}
    write_npz(folder / "run.npz", swung(mapping, effects, NOISE))
    source = RecordingSource.of(read_recordings(folder / "run.npz", mapping), mapping, Model(name="nominal"))
    return diagnose(source, source.model)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "payload"),
    [
        ("cart", 0.7),
        *(pytest.param(name, 0.0, marks=SLOW) for name in ARMS),
        pytest.param("planar", 0.3, marks=SLOW),
        pytest.param("pendulum", 0.3, marks=SLOW),
    ],
)
def test_friction_is_found_in_its_joint_s_unit_and_a_payload_where_there_is_one(
    name: str, payload: float, tmp_path: Path
) -> None:
    found = diagnosed(tmp_path, name, payload)
    assert set(found.named) == {"joint_coulomb_friction", *(["end_effector_payload"] if payload else [])}
    effects = {effect.name: effect for effect in found.effects}
    kinds, _, planted = ARMS[name]
    for joint, (kind, true) in enumerate(zip(kinds, planted, strict=True), start=1):
        value = effects["joint_coulomb_friction"].parameters[f"coulomb_joint{joint}"]
        assert value.unit == ("N" if kind == "prismatic" else "N m")
        assert value.estimate == pytest.approx(true, abs=0.05, rel=0.05)
    assert [row.unit for row in found.joints] == ["N" if kind == "prismatic" else "N m" for kind in kinds]
    mass = effects["end_effector_payload"]
    assert (mass.verdict == "CONFIRMED") == bool(payload)
    if payload:
        assert_covers(mass.parameters["mass"].interval, payload, WIDTHS[name])


@pytest.mark.parametrize(
    ("links", "inertia", "coulomb"),
    [
        (0.01, 0.5, 2.0),
        pytest.param(0.01, 0.0269, 0.3, marks=SLOW),
        pytest.param(0.001, 0.0269, 1.0, marks=SLOW),
    ],
)
def test_drives_that_are_large_beside_light_links_are_measured_as_others(
    links: float, inertia: float, coulomb: float, tmp_path: Path
) -> None:
    """The weight of a small robot is no scale of its gears: neither range, nor prior, nor width follows from it."""
    mapping = mapping_of(tmp_path, lighter(slender_arm(("revolute",) * 2), links), torque_measured_at="motor")
    planted = {
        "joint_coulomb_friction": {"coulomb_joint1": coulomb, "coulomb_joint2": coulomb / 2.0},
        "added_motor_inertia": {"inertia_joint1": inertia, "inertia_joint2": inertia / 2.0},
    }
    write_npz(tmp_path / "run.npz", swung(mapping, planted, 0.002 * coulomb))
    source = RecordingSource.of(read_recordings(tmp_path / "run.npz", mapping), mapping, Model(name="nominal"))
    considered = [*planted, "joint_viscous_friction", "torque_offset", "torque_delay", "end_effector_payload"]
    found = diagnose(source, source.model, considered)
    assert set(found.named) == set(planted)
    effects = {effect.name: effect for effect in found.effects}
    for name, values in planted.items():
        assert effects[name].verdict == "CONFIRMED"
        for key, true in values.items():
            estimate = effects[name].parameters[key]
            low, high = estimate.interval
            assert low - 0.002 * true <= true <= high + 0.002 * true and high - low < 0.2 * true


def seldom_moved(folder: Path, noise: float = NOISE) -> RecordingSource:
    """A pendulum of two joints with viscous friction; the second turns for 4 of 36 s."""
    mapping = mapping_of(folder, slender_arm(("revolute",) * 2))
    time = np.arange(0.0, 36.0, 0.02)
    often = np.sin(2.0 * np.pi * 0.31 * time) + 0.4 * np.sin(2.0 * np.pi * 0.73 * time)
    seldom = np.where((time > 16.0) & (time < 20.0), np.sin(2.0 * np.pi * 0.5 * (time - 16.0)) ** 3, 0.0)
    q = np.column_stack((0.5 * often, 0.6 * seldom))
    dq = np.gradient(q, time, axis=0)
    ddq = np.gradient(dq, time, axis=0)
    model = RobotModel(mapping.facts, mapping.end_effector.build())
    torque = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)]) + 0.95 * dq
    torque += np.random.default_rng(4).normal(0.0, noise, torque.shape)
    write_npz(folder / "run.npz", {"time": time, "position": q, "velocity": dq, "effort": torque})
    return RecordingSource.of(read_recordings(folder / "run.npz", mapping), mapping, Model(name="nominal"))


def test_the_p_of_a_joint_that_moves_seldom_agrees_with_its_interval(tmp_path: Path) -> None:
    """Signs of the few stretches in which it moves decide nothing, and the friction in them is known to 10 %."""
    source = seldom_moved(tmp_path)
    found = diagnose(source, source.model, ["joint_viscous_friction"])
    (effect,) = found.effects
    often, seldom = (effect.parameters[f"viscous_joint{joint}"] for joint in (1, 2))
    for own in (often, seldom):
        assert own.interval[0] <= 0.95 <= own.interval[1]
        assert own.verdict == "CONFIRMED" and own.p_value is not None and own.p_value < 0.01
    assert often.interval[1] - often.interval[0] < seldom.interval[1] - seldom.interval[0] < 0.5


def test_few_stretches_have_few_degrees_of_freedom(tmp_path: Path) -> None:
    source = seldom_moved(tmp_path)
    fit = Search(effects_for(source, ["joint_viscous_friction"]), Evidence.of(source)).alone("joint_viscous_friction")
    null, inverse = fit.evidence.null, np.linalg.inv(fit.problem.total)
    often, seldom = null.freedoms(fit.candidate.jacobians, inverse)
    assert 10.0 < often < len(source.clusters) - 1 and 1.0 <= seldom < 8.0


def test_stretches_of_a_recording_say_about_as_much(tmp_path: Path) -> None:
    """Of a motion that ends after a third of the recording, most stretches are in that third, and none is too short."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 2))
    columns = swung(mapping, {}, NOISE)
    still = np.minimum(np.arange(1800), 600)
    held = columns | {"position": columns["position"][still], "velocity": columns["velocity"][still]}
    held["velocity"][600:] = 0.0
    write_npz(tmp_path / "run.npz", held | {"effort": columns["effort"][still]})
    source = RecordingSource.of(read_recordings(tmp_path / "run.npz", mapping), mapping, Model(name="nominal"))
    ends = [float(item.name.split()[3]) for item in source.clusters]
    starts = [float(item.name.split()[1]) for item in source.clusters]
    assert sum(end <= 12.5 for end in ends) >= 0.6 * len(ends)
    assert min(end - start for start, end in zip(starts, ends, strict=True)) >= 0.4
