# SPDX-License-Identifier: Apache-2.0
"""Width of dry friction at a reversal: planted in MuJoCo, or as rest at a reversal, and found in recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from intervals import assert_covers
from joint_recordings import write_npz
from servo_arm import Servos, servo_log
from slender_arm import mapping_of, slender_arm

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.physics import SHARP_WIDTH_RAD_S
from impact_rs_trials.recordings.recording import read_recordings

NEIGHBOURS = (
    "joint_coulomb_friction",
    "joint_viscous_friction",
    "joint_stribeck_friction",
    "joint_asymmetric_friction",
    "velocity_delay",
    "joint_reversal_width",
)
COULOMB = (3.0, 2.0)  # N m
NOISE = 0.02  # N m


def diagnosed(folder: Path, servos: Servos) -> DiagnosisDocument:
    """15 s of an arm in MuJoCo with the torque of its motors; its velocity has a noise of 5 mrad/s."""
    mapping = mapping_of(folder, slender_arm(("revolute",) * 2), torque_measured_at="motor")
    log = servo_log(servos, 15.0)
    effort = log["torque"] + np.random.default_rng(2).normal(0.0, NOISE, log["torque"].shape)
    columns = {name: log[name] for name in ("time", "position", "velocity")} | {"effort": effort}
    source = RecordingSource.of(
        read_recordings(write_npz(folder / "run.npz", columns), mapping), mapping, Model(name="nominal")
    )
    return diagnose(source, source.model, NEIGHBOURS)


@pytest.mark.parametrize(
    ("width", "half"),
    [
        ((0.02, 0.05), (0.0019, 0.0018)),
        pytest.param((0.05, 0.02), (0.0045, 0.002), marks=pytest.mark.slow),
    ],
)
def test_width_at_reversals_is_found_with_the_friction_that_turns(
    tmp_path: Path, width: tuple[float, float], half: tuple[float, float]
) -> None:
    """The truth is F_c tanh(dq / w) in MuJoCo. Kills a width of the wrong joint, and one that replaces the model's."""
    found = diagnosed(tmp_path, Servos(coulomb=COULOMB, width=width))
    assert set(found.named) == {"joint_coulomb_friction", "joint_reversal_width"} and not found.confusable
    friction, turning = (found.effect(name) for name in ("joint_coulomb_friction", "joint_reversal_width"))
    assert friction is not None and turning is not None
    for joint, of_friction in enumerate((0.16, 0.083)):
        name = f"joint{joint + 1}"
        assert_covers(turning.parameters[f"width_{name}"].interval, width[joint] - SHARP_WIDTH_RAD_S, half[joint])
        assert_covers(friction.parameters[f"coulomb_{name}"].interval, COULOMB[joint], of_friction)
    assert found.held_out_error_after < 2.0 * NOISE


@pytest.mark.slow
def test_friction_that_rests_at_reversals_names_no_width(tmp_path: Path) -> None:
    """Dry friction of MuJoCo holds a joint at rest, which no width of the sign of its velocity describes."""
    assert diagnosed(tmp_path, Servos(coulomb=COULOMB)).named == ("joint_coulomb_friction",)


def test_without_friction_there_is_no_width(tmp_path: Path) -> None:
    assert diagnosed(tmp_path, Servos()).named == ()
