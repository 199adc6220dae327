# SPDX-License-Identifier: Apache-2.0
"""Gains of servos that are known to some percent are fitted with every model, and their prior keeps what it knows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import write_npz
from servo_arm import KD, KP, Servos, servo_log, servo_mapping

from impact_rs_analysis.evidence.free_motion.servo_gains import GAIN_DEVIATION, ServoGains
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.recording import read_recordings

TORQUE = np.column_stack((np.sin(np.linspace(0.0, 20.0, 400)), np.full(400, 3.0)))  # N m
LATE = np.full((400, 2), 0.5)  # N m
NOISE = np.full(2, 0.01)  # N m


def test_the_gains_that_fit_a_model_scale_its_torque_and_not_what_late_commands_lose() -> None:
    """Kills a share of the recorded instead of the predicted torque, and commands that are late by the gain."""
    shares = np.array([0.2, -0.1])
    gains = ServoGains((1.0 + shares) * TORQUE + LATE, NOISE, 10)
    assert gains.fitted(TORQUE + LATE, LATE) == pytest.approx(shares, rel=1e-4)


def test_a_torque_below_the_noise_leaves_the_gain_to_its_prior() -> None:
    gains = ServoGains(1.5 * 1e-6 * TORQUE, NOISE, 10)
    assert np.all(np.abs(gains.fitted(1e-6 * TORQUE, 0.0 * LATE)) < 1e-3)


@pytest.mark.parametrize("stretches", [6, 7])
def test_the_measurements_for_the_prior_have_its_mean_and_its_deviation(stretches: int) -> None:
    prior = ServoGains(TORQUE, NOISE, stretches).recorded
    assert prior.mean(axis=0) == pytest.approx(0.0, abs=1e-12)
    assert prior.std(axis=0) / np.sqrt(stretches) == pytest.approx(GAIN_DEVIATION)


def test_gains_that_are_too_high_leave_no_residual_where_they_were_estimated(tmp_path: Path) -> None:
    """Given gains keep theirs. Kills gains of another joint, and rollouts under the gains of the mapping."""
    high = {"kp": [1.2 * KP[0], 0.9 * KP[1]], "kd": [1.2 * KD[0], 0.9 * KD[1]]}
    log = servo_log(Servos(), 12.0)
    del log["torque"]
    path = write_npz(tmp_path / "run.npz", log)
    errors, gain = [], np.ones(2)
    for servo in (None, high, high | {"gains": "estimated"}):
        mapping = servo_mapping(tmp_path, servo)
        source = RecordingSource.of(read_recordings(path, mapping), mapping, Model(name="nominal"))
        errors.append(source.size())
        (world,) = source._rolled(source.free_motions()[0], ()).arms.values()
        gain = np.asarray(world.torque_gain)
    right, wrong, fitted = errors
    assert wrong > 10.0 * right
    assert fitted == pytest.approx(right, rel=0.25)  # the noise of the encoders is scaled by the gains
    assert gain == pytest.approx([1.0 / 1.2, 1.0 / 0.9], rel=0.01)
