# SPDX-License-Identifier: Apache-2.0
"""Recordings of arms with few joints, and of a cart: friction is found in its unit, and no payload is invented."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from joint_recordings import swinging, write_npz

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.robot import JointType, RobotFacts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import read_recordings

RATE, DURATION = 50.0, 36.0  # Hz, s
NOISE = 0.02  # N m, N
LENGTH = 0.4  # m
UPRIGHT, FLAT = (np.pi / 2.0, 0.0, 0.0), (0.0, 0.0, 0.0)  # rpy of the first joint: it turns about -y, or about z

ARMS: dict[str, tuple[tuple[JointType, ...], tuple[float, ...], tuple[float, ...]]] = {
    # joints, rpy of the first, friction that is planted [N m, N]
    "planar": (("revolute",) * 3, FLAT, (0.6, 0.4, 0.2)),
    "upright": (("revolute",) * 3, UPRIGHT, (0.8, 0.5, 0.3)),
    "pendulum": (("revolute",) * 2, UPRIGHT, (0.6, 0.3)),
    "cart": (("prismatic", "revolute"), UPRIGHT, (12.0, 0.3)),
}


def facts_of(name: str) -> RobotFacts:
    """Slender links of 0.4 m; a joint that slides does so along its own z, which lies level."""
    kinds, rpy, _ = ARMS[name]
    origins = [{"type": kind, "xyz": (LENGTH if joint else 0.0, 0, 0), "rpy": FLAT} for joint, kind in enumerate(kinds)]
    origins[0]["rpy"] = rpy
    if kinds[0] == "prismatic":
        origins[1] |= {"xyz": (0, 0, 0), "rpy": (np.pi / 2.0, 0.0, 0.0)}  # across the rail, so that it couples
    link = {"mass": 2.0, "com": (LENGTH / 2.0, 0, 0), "inertia": (0.002, 0, 0, 0.03, 0, 0.03)}
    count = len(kinds)
    return RobotFacts.model_validate(
        {
            "source": "by hand",
            "joints": origins,
            "flange": {"xyz": (LENGTH, 0, 0), "rpy": (0, np.pi / 2.0, 0)},
            "limits": {
                "position_min_rad": [-3.0] * count,
                "position_max_rad": [3.0] * count,
                "velocity_rad_s": [4.0] * count,
                "torque_Nm": [200.0] * count,
            },
            "links": [link] * count,
        }
    )


def diagnosed(folder: Path, name: str, payload: float = 0.0) -> DiagnosisDocument:
    """Diagnosis of a recording in which every joint swings at its own frequencies."""
    facts, (kinds, _, coulomb) = facts_of(name), ARMS[name]
    count = len(kinds)
    (folder / "robot.yaml").write_text(json.dumps(facts.model_dump(mode="json")), encoding="utf-8")
    names = {"position": "position", "velocity": "velocity", "torque": "effort"}
    content = {
        "description": "by hand",
        "robot": "robot.yaml",
        "joints": [f"joint{joint + 1}" for joint in range(count)],
        "signals": {
            signal: {"array": name, "unit": [getattr(joint, name) for joint in facts.units]}
            for signal, name in names.items()
        },
    }
    (folder / "mapping.yaml").write_text(json.dumps(content), encoding="utf-8")
    mapping = load_mapping(folder / "mapping.yaml")
    end = mapping.end_effector.model_copy(update={"mass": payload}).build()
    time, joints = np.arange(0.0, DURATION, 1.0 / RATE), np.arange(count)
    columns = swinging(RobotModel(facts, end), time, 0.0, (0.13 + 0.03 * joints, 0.37 - 0.02 * joints), (0.6, 0.15))
    columns["effort"] += np.array(coulomb) * np.tanh(columns["velocity"] / 0.005)
    columns["effort"] += np.random.default_rng(3).normal(0.0, NOISE, columns["effort"].shape)
    write_npz(folder / "run.npz", columns)
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
