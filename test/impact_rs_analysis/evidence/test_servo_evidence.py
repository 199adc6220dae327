# SPDX-License-Identifier: Apache-2.0
"""Torque balance and rollouts of servo logs, in closed form: a joint about a vertical axis, tau = I ddq = 0.11 ddq."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_recordings import Columns, write_npz
from slender_arm import FLAT, mapping_of, slender_arm, with_effects

from impact_rs_analysis.evidence.rollouts import FreeMotion, rollouts_of
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.readings import ArmReadings
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.recording import ARM, read_recordings

INERTIA, KP, KD = 0.11, 30.0, 2.0  # kg m^2, N m/rad, N m s/rad
TIME = np.arange(0.0, 24.0, 0.01)  # s
OMEGAS = 2.0 * np.pi * np.array([0.31, 0.9])  # rad/s
SIZES = np.array([0.8, 0.2])  # rad
DELAY = 0.03  # s


def moved(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    phase = OMEGAS * time[:, None]
    sine, cosine = SIZES * np.sin(phase), SIZES * np.cos(phase)
    return tuple(np.sum(one, axis=1)[:, None] for one in (sine, OMEGAS * cosine, -(OMEGAS**2) * sine))  # type: ignore[return-value]


def servo_log(delay: float = 0.0, gain: float = 1.0) -> Columns:
    """Commands that act ``delay`` after their stamps, on servos that deliver ``gain`` times what they are asked."""
    q, dq, _ = moved(TIME)
    ahead, speed, acceleration = moved(TIME + delay)
    target = ahead + (INERTIA * acceleration / gain + KD * speed) / KP
    return {"time": TIME, "position": q, "velocity": dq, "q_desired": target}


def flat(folder: Path) -> Mapping:
    mapping_of(folder, slender_arm(("revolute",), FLAT))
    content = json.loads((folder / "mapping.yaml").read_text(encoding="utf-8"))
    del content["signals"]["torque"]
    content["signals"]["q_desired"] = {"array": "q_desired", "unit": "rad"}
    content |= {"torque_measured_at": "motor", "servo": {"kp": [KP], "kd": [KD]}}
    (folder / "mapping.yaml").write_text(json.dumps(content), encoding="utf-8")
    return load_mapping(folder / "mapping.yaml")


def source_of(folder: Path, log: Columns) -> RecordingSource:
    mapping = flat(folder)
    runs = read_recordings(write_npz(folder / "run.npz", log), mapping)
    return RecordingSource.of(runs, mapping, Model(name="nominal"))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_late_commands_of_a_servo_are_predicted_by_their_delay(tmp_path: Path) -> None:
    """kp d dq = 30 x 0.03 x 1.3 N m by the stamps. Kills a delay of the other sign and one that is filtered once."""
    source = source_of(tmp_path, servo_log(DELAY))
    assert rms(source.residuals) > 0.5
    assert rms(source.residuals_by((("actuation_delay", (DELAY,)),))) < 2e-3
    assert rms(source.residuals_by((("actuation_delay", (0.5 * DELAY,)),))) == pytest.approx(
        0.5 * rms(source.residuals), rel=0.1
    )


def test_what_passes_no_sensor_has_no_fault_of_one(tmp_path: Path) -> None:
    """A torque that was computed is neither filtered nor late; it may be asked late, and by a wrong gain."""
    source = source_of(tmp_path, servo_log())
    known = source.known_effects
    assert not any(source.offers(known[name]) for name in ("torque_delay", "torque_sensor_lag"))
    assert all(source.offers(known[name]) for name in ("actuation_delay", "torque_gain", "encoder_offset"))


def test_rollouts_of_servos_follow_the_recorded_targets_late_and_with_their_gain(tmp_path: Path) -> None:
    """Kills servos without the gain, the delay or the offset of the drive, and targets at the wrong time."""
    mapping = flat(tmp_path)
    planted = {"actuation_delay": {"delay": DELAY}, "torque_gain": {"gain_joint1": 0.8}}
    source = source_of(tmp_path, servo_log(DELAY, 0.8))
    (motion,) = source.free_motions()
    found = rollouts_of([motion], [with_effects(mapping, planted)])
    without = rollouts_of([motion])
    assert found is not None and without is not None
    assert found.document().last.joints[0].error < 0.02  # deg
    assert without.document().last.joints[0].error > 1.0


def test_the_torque_of_servos_by_hand(tmp_path: Path) -> None:
    """Readings, delay, gain and offset in turn; at 0.5 s a target ramp of 0.1 rad/s that acts 0.1 s late is 0.04."""
    source = source_of(tmp_path, servo_log())
    (motion,) = source.free_motions()
    ramp = 0.1 * TIME[:, None]
    motion = replace(motion, torque_time=TIME, q_desired=ramp, dq_desired=np.full_like(ramp, 0.1))
    arm = replace(
        source.physics.arms[ARM],
        readings=ArmReadings(position_offset=np.array([0.01])),
        actuation_delay=0.1,
        torque_gain=np.array([0.9]),
        torque_offset=np.array([0.2]),
    )
    servos = motion.servos(replace(source.physics, arms={ARM: arm}))
    assert servos is not None
    torque = servos(np.array([0.5]), np.array([[0.02]]), np.array([[0.3]]))
    assert torque == pytest.approx(0.9 * (KP * (0.04 - 0.03) - KD * 0.3) + 0.2)


def test_a_stiff_servo_is_rolled_out_in_smaller_steps(tmp_path: Path) -> None:
    """omega = sqrt(kp / I) = 522 rad/s: a step of 5 ms is 2.6 rad, and diverges."""
    source = source_of(tmp_path, servo_log())
    (motion,) = source.free_motions()
    assert motion.servo is not None
    stiff = replace(motion.servo, kp=np.array([3e4]), kd=np.array([60.0]), torque_max=np.array([1e4]))
    q, dq, ddq = moved(TIME)
    target = q + (INERTIA * ddq + 60.0 * dq) / 3e4
    still: FreeMotion = replace(motion, servo=stiff, torque_time=TIME, q_desired=target)
    found = rollouts_of([still])
    assert found is not None
    assert found.document().diverged == 0
    assert found.document().last.joints[0].error < 0.02  # deg
