# SPDX-License-Identifier: Apache-2.0
"""Recordings of arms with few joints, and of a cart: friction is found in its unit, and no payload is invented."""

from __future__ import annotations

from pathlib import Path

import pytest
from joint_recordings import write_npz
from slender_arm import FLAT, UPRIGHT, lighter, mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.robot import JointType
from impact_rs_trials.recordings.recording import read_recordings

NOISE = 0.02  # N m, N

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


@pytest.mark.parametrize("name", ARMS)
def test_friction_is_found_in_its_joint_s_unit_and_no_payload_is_invented(name: str, tmp_path: Path) -> None:
    found = diagnosed(tmp_path, name)
    assert found.named == ("joint_coulomb_friction",)
    effects = {effect.name: effect for effect in found.effects}
    kinds, _, planted = ARMS[name]
    for joint, (kind, true) in enumerate(zip(kinds, planted, strict=True), start=1):
        value = effects["joint_coulomb_friction"].parameters[f"coulomb_joint{joint}"]
        assert value.unit == ("N" if kind == "prismatic" else "N m")
        assert value.estimate == pytest.approx(true, abs=0.05, rel=0.05)
    assert effects["end_effector_payload"].verdict != "CONFIRMED"
    assert [row.unit for row in found.joints] == ["N" if kind == "prismatic" else "N m" for kind in kinds]


@pytest.mark.parametrize(("name", "payload"), [("planar", 0.3), ("pendulum", 0.3), ("cart", 0.7)])
def test_a_payload_that_is_there_is_found_beside_friction(name: str, payload: float, tmp_path: Path) -> None:
    found = diagnosed(tmp_path, name, payload)
    assert set(found.named) == {"joint_coulomb_friction", "end_effector_payload"}
    mass = {effect.name: effect for effect in found.effects}["end_effector_payload"].parameters["mass"]
    assert mass.interval[0] <= payload <= mass.interval[1]


@pytest.mark.parametrize(("links", "inertia", "coulomb"), [(0.01, 0.0269, 0.3), (0.01, 0.5, 2.0), (0.001, 0.0269, 1.0)])
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
