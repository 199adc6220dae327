# SPDX-License-Identifier: Apache-2.0
"""Recordings calibrate the arm: links, motors, torque constants and the clock of the torque, each planted and found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import write_npz
from slender_arm import FLAT, mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_sim.effects import library, of_trials
from impact_rs_sim.model import Model
from impact_rs_sim.proportion import Proportion
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import read_recordings

FRICTION = {"joint_coulomb_friction": {f"coulomb_joint{joint}": 0.8 / joint for joint in (1, 2, 3)}}  # N m
CONSIDERED = (  # all that are fast
    "joint_coulomb_friction",
    "joint_viscous_friction",
    "torque_offset",
    "torque_gain",
    "end_effector_payload",
    "link_mass",
    "link_com",
    "link_inertia",
    "added_motor_inertia",
    "torque_delay",
)
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2


def diagnosed(folder: Path, mapping: Mapping, planted: dict[str, dict[str, float]]) -> DiagnosisDocument:
    write_npz(folder / "run.npz", swung(mapping, FRICTION | planted))
    source = RecordingSource.of(read_recordings(folder / "run.npz", mapping), mapping, Model(name="nominal"))
    return diagnose(source, source.model, CONSIDERED)


def effect(found: DiagnosisDocument, name: str) -> EffectDocument:
    entry = found.effect(name)
    assert entry is not None
    return entry


@pytest.mark.parametrize(
    "planted",
    [
        {"link_com": {"com_x_joint1": -0.03, "com_y_joint3": 0.04}},
        *(
            pytest.param(planted, marks=pytest.mark.slow)
            for planted in (
                {"link_mass": {"scale_joint2": 1.25}},
                {"link_inertia": {"inertia_joint2": 0.1}},
                {"torque_delay": {"delay": -0.012}},
            )
        ),
    ],
)
def test_what_is_planted_in_an_upright_arm_is_named_and_its_interval_holds(
    planted: dict[str, dict[str, float]], tmp_path: Path
) -> None:
    found = diagnosed(tmp_path, mapping_of(tmp_path, slender_arm(("revolute",) * 3)), planted)
    ((name, values),) = planted.items()
    assert set(found.named) == {"joint_coulomb_friction", name}
    for key, value in values.items():
        estimate = effect(found, name).parameters[key]
        assert estimate.interval[0] <= value <= estimate.interval[1]
        assert estimate.estimate == pytest.approx(value, rel=0.15)


def test_centres_that_no_torque_feels_are_not_determined(tmp_path: Path) -> None:
    """On vertical axes nothing weighs: of the first link the moment alone is felt, wherever its centre lies."""
    facts = slender_arm(("revolute",) * 3, FLAT)
    found = diagnosed(tmp_path, mapping_of(tmp_path, facts), {})
    assert found.named == ("joint_coulomb_friction",)
    centre, moment = effect(found, "link_com").parameters["com_y_joint1"], effect(found, "link_inertia").parameters
    reach = Proportion.of_robots([facts], GRAVITY).length
    bound = reach * library()["link_com"].parameters[1].upper
    assert centre.interval == pytest.approx((-bound, bound))
    low, high = moment["inertia_joint1"].interval
    assert low <= 0.0 <= high and high - low < 0.1  # kg m^2, most of it for the scale of the torque


def test_motor_inertia_and_torque_constants_are_found_from_currents(tmp_path: Path) -> None:
    constants = [20.0, 10.0, 5.0]  # N m/A
    mapping = mapping_of(
        tmp_path,
        slender_arm(("revolute",) * 3),
        {"unit": "A"},
        torque_measured_at="motor",
        torque_constant=constants,
    )
    planted = {"added_motor_inertia": {"inertia_joint1": 0.5, "inertia_joint2": 0.3, "inertia_joint3": 0.1}}
    columns = swung(mapping, FRICTION | planted | {"torque_gain": {"gain_joint2": 0.85}})
    write_npz(tmp_path / "run.npz", columns | {"effort": columns["effort"] / np.array(constants)})
    source = RecordingSource.of(read_recordings(tmp_path / "run.npz", mapping), mapping, Model(name="nominal"))
    found = diagnose(source, source.model, CONSIDERED)
    assert set(found.named) == {"joint_coulomb_friction", "added_motor_inertia", "torque_gain"}
    for joint, value in ((1, 0.5), (2, 0.3), (3, 0.1)):
        assert effect(found, "added_motor_inertia").parameters[f"inertia_joint{joint}"].estimate == pytest.approx(
            value, rel=0.15
        )
    low, high = effect(found, "torque_gain").parameters["gain_joint2"].interval
    assert low <= 0.85 <= high and high - low < 0.05


def test_what_calibrates_an_arm_is_no_candidate_in_trials() -> None:
    calibrating = {name for name, effect in library().items() if effect.calibrates}
    links = {"link_mass", "link_com", "link_inertia"}
    assert calibrating == links | {"added_motor_inertia", "joint_elasticity", "torque_delay"}
    assert not calibrating & set(of_trials())
