# SPDX-License-Identifier: Apache-2.0
"""Logs without torque: what MuJoCo hides in an arm under position servos is named from q, q_desired and the gains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from intervals import assert_covers
from joint_recordings import write_npz
from servo_arm import KD, KP, Servos, servo_log, servo_mapping

from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.verdict import UNIDENTIFIABLE
from impact_rs_analysis.evidence.rollouts import CLOSED_LOOP
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import read_recordings

CONSIDERED = (
    "joint_coulomb_friction",
    "joint_viscous_friction",
    "torque_gain",
    "link_mass",
    "added_motor_inertia",
    "actuation_delay",
    "encoder_offset",
)
FEW = ("joint_coulomb_friction", "added_motor_inertia", "actuation_delay")
FRICTION = (0.8, 0.5)  # N m
UNKNOWN = {"kp": [1.1 * one for one in KP], "kd": [1.1 * one for one in KD], "gains": "estimated"}


def source_of(folder: Path, servos: Servos, mapping: Mapping, seconds: float = 29.0) -> RecordingSource:
    log = servo_log(servos, seconds)
    del log["torque"]
    runs = read_recordings(write_npz(folder / "run.npz", log), mapping)
    return RecordingSource.of(runs, mapping, Model(name="nominal"))


def diagnosed(
    folder: Path, servos: Servos, considered: tuple[str, ...] = CONSIDERED, servo: dict[str, Any] | None = None
) -> DiagnosisDocument:
    source = source_of(folder, servos, servo_mapping(folder, servo))
    return diagnose(source, source.model, considered)


def intervals(found: DiagnosisDocument, name: str) -> dict[str, tuple[float, float]]:
    entry = found.effect(name)
    assert entry is not None
    return {key: (value.interval[0], value.interval[1]) for key, value in entry.parameters.items()}


def test_a_perfect_servo_log_names_nothing_and_rolls_out_in_closed_loop(tmp_path: Path) -> None:
    """Kills kd of the wrong sign, a target of another time, and a rollout whose servos see no gravity."""
    source = source_of(tmp_path, Servos(), servo_mapping(tmp_path))
    assert diagnose(source, source.model, FEW).named == ()
    rollouts = compare(source).rollouts
    assert rollouts is not None and rollouts.what == CLOSED_LOOP and rollouts.growth is None
    assert rollouts.in_words.startswith("rollouts in closed loop from")
    assert rollouts.last.tool_mm < 0.5  # the noise of the encoders at the start, 5e-4 rad over 0.8 m


@pytest.mark.slow
def test_friction_armature_and_delay_are_named_together_with_their_intervals(tmp_path: Path) -> None:
    """Kills a delay of the measured position, a delay of the wrong sign, and an armature that is left out."""
    planted = Servos(coulomb=FRICTION, armature=(0.12, 0.06), delay=0.012)
    found = diagnosed(tmp_path, planted, FEW)
    assert set(found.named) == set(FEW)
    friction, inertia = (intervals(found, name) for name in FEW[:2])
    assert_covers(intervals(found, "actuation_delay")["delay"], 0.012, 0.0003)
    for joint, half, of_inertia in ((0, 0.1, 0.028), (1, 0.039, 0.0071)):
        assert_covers(friction[f"coulomb_joint{joint + 1}"], FRICTION[joint], half)
        assert_covers(inertia[f"inertia_joint{joint + 1}"], planted.armature[joint], of_inertia)
    assert found.rollouts is not None
    assert found.rollouts.after.last.tool_mm < 0.1 * found.rollouts.before.last.tool_mm


@pytest.mark.slow
def test_offsets_of_encoders_show_in_gravity_alone(tmp_path: Path) -> None:
    """Servo and log have one reading, so that an offset changes neither error nor torque of the servo."""
    found = diagnosed(tmp_path, Servos(offset=(0.02, -0.03)))
    assert found.named == ("encoder_offset",)
    offsets = intervals(found, "encoder_offset")
    assert_covers(offsets["offset_joint1"], 0.02, 0.017)
    assert_covers(offsets["offset_joint2"], -0.03, 0.026)


@pytest.mark.slow
def test_the_gain_of_one_servo_is_named_and_that_of_all_is_not_told_from_masses(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, Servos(gain=(1.0, 0.85)))
    assert found.named == ("torque_gain",)
    low, high = intervals(found, "torque_gain")["gain_joint2"]
    assert low == pytest.approx(0.85, abs=0.002) and high == pytest.approx(0.85, abs=0.002)
    found = diagnosed(tmp_path, Servos(gain=(0.9, 0.9)))
    gain = found.effect("torque_gain")
    assert gain is not None and "link_mass" in str(gain.verdict)


@pytest.mark.slow
def test_without_known_gains_friction_is_found_and_masses_are_not(tmp_path: Path) -> None:
    """Friction is known in proportion to the masses, and these as well as the gains. Kills gains that are exact."""
    found = diagnosed(tmp_path, Servos(coulomb=FRICTION), CONSIDERED, UNKNOWN)
    assert found.named == ("joint_coulomb_friction",)
    for joint, value in enumerate(FRICTION):  # to 2 %, for the friction of MuJoCo creeps
        assert intervals(found, "joint_coulomb_friction")[f"coulomb_joint{joint + 1}"] == pytest.approx(
            (value, value), rel=0.02
        )
    for name, key in (("link_mass", "scale_joint2"), ("torque_gain", "gain_joint2")):
        low, high = intervals(found, name)[key]
        assert 0.7 < high - low < 1.6  # 1.96 times 30 % to either side
    gain = found.effect("torque_gain")
    assert gain is not None and gain.verdict == UNIDENTIFIABLE
    assert any("cannot distinguish masses from gains" in remark for remark in found.remarks)


@pytest.mark.slow
def test_unknown_gains_hide_neither_armature_nor_delay_and_are_in_the_rollouts(tmp_path: Path) -> None:
    """Kills a delay that is scaled by the gains, and rollouts with those of the mapping."""
    planted = Servos(coulomb=FRICTION, armature=(0.12, 0.06), delay=0.012)
    found = diagnosed(tmp_path, planted, FEW, UNKNOWN)
    assert set(found.named) == set(FEW)
    friction, inertia = (intervals(found, name) for name in FEW[:2])
    assert intervals(found, "actuation_delay")["delay"] == pytest.approx((0.012, 0.012), abs=2e-4)
    for joint in range(2):  # not covered: links count as exact, and joints at rest stick
        name = f"joint{joint + 1}"
        assert friction[f"coulomb_{name}"] == pytest.approx((FRICTION[joint],) * 2, rel=0.04)
        assert inertia[f"inertia_{name}"] == pytest.approx((planted.armature[joint],) * 2, rel=0.06)
    assert found.rollouts is not None and found.rollouts.after.last.tool_mm < 1.0


@pytest.mark.slow
def test_with_unknown_gains_alone_nothing_is_missing(tmp_path: Path) -> None:
    """A servo that gives 15 % less than the others is within what is known. Kills gains as an effect of the arm."""
    assert diagnosed(tmp_path, Servos(gain=(1.0, 0.85)), CONSIDERED, UNKNOWN).named == ()


def test_what_the_torque_is_stands_in_comparison_and_remarks(tmp_path: Path) -> None:
    source = source_of(tmp_path, Servos(), servo_mapping(tmp_path, {"kp": KP}), 12.0)
    said = compare(source)
    assert said.recording is not None
    law = "no torque was recorded: it is computed by the law of position servos, kp (q_desired - q)"
    assert said.recording.torque.startswith(law)
    assert "viscous friction includes the damping" in said.recording.torque
    assert said.recording.torque in said.remarks
    assert said.recording.signals == ("position", "q_desired", "velocity")
    assert np.all(source.balance.noise > 0.0)
    assert said.agreement.readings_of("link torque balance") == (
        "servo (desired position and gains)", "encoder", "velocity"
    )  # fmt: skip
    assert said.rollouts is not None and said.rollouts.loop == "closed loop"


@pytest.mark.slow
def test_friction_does_not_enlarge_the_inertia_of_motors(tmp_path: Path) -> None:
    """By 4 % where friction had the sign of the low-passed velocity, with gains that are known or not."""
    planted = Servos(coulomb=FRICTION, armature=(0.12, 0.06))
    source = source_of(tmp_path, planted, servo_mapping(tmp_path))
    found = diagnose(source, source.model, FEW).effect("added_motor_inertia")
    assert found is not None
    for joint, true in enumerate(planted.armature):
        assert found.parameters[f"inertia_joint{joint + 1}"].estimate == pytest.approx(true, rel=0.03)
