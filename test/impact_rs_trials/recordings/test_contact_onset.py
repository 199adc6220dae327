# SPDX-License-Identifier: Apache-2.0
"""The begin of a contact by force or acceleration: planted, between two samples of slow joints."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_trials.recordings.arm_impacts import by_onset
from impact_rs_trials.recordings.contact_onset import onset_of
from impact_rs_trials.recordings.joint_jumps import joint_jump, jump_at
from impact_rs_trials.recordings.series import Series

IMPACT = 0.5137  # s
JUMP = np.array([-0.21, 0.35, 0.04])  # rad/s


def joints(rate: float, seed: int = 0) -> Series:
    """Three joints whose velocities jump, and vibrate at 17 Hz afterwards."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = np.maximum(time - IMPACT, 0.0)[:, None]
    values = 0.5 * time[:, None] + JUMP * t + 0.0006 * (1.0 - np.cos(2.0 * np.pi * 17.0 * t))
    return Series("q", time, values + 1e-5 * np.random.default_rng(seed).standard_normal(values.shape))


def force(rate: float = 1000.0, peak: float = 60.0, seed: int = 0) -> Series:
    """A force of free motion that drifts with the weight of the tool, and the push of an impact along y."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = time - IMPACT
    push = peak * np.where(t > 0.0, 0.4 + 0.6 * np.sin(np.pi * np.clip(t / 0.008, 0.0, 1.0)), 0.0)
    values = np.zeros((time.size, 6))
    values[:, 1], values[:, 2] = push, -5.0 + 0.2 * time
    values[:, :3] += [0.3, 0.3, 1.0] * np.random.default_rng(seed).standard_normal((time.size, 3))
    return Series("wrench", time, values)


def test_the_force_says_when_slow_joints_were_hit() -> None:
    """Joints at 100 Hz that vibrate know it to some milliseconds, the force to its period of 1 ms."""
    by_joints, by_force = [], []
    for seed in range(20):
        position = joints(100.0, seed)
        jump = joint_jump(position, IMPACT + 0.004)
        assert jump is not None
        onset = onset_of(force(seed=seed), position, jump.time)
        assert onset is not None and onset.error < 3e-4
        by_joints.append(jump.time - IMPACT)
        by_force.append(onset.time - IMPACT)
    assert np.max(np.abs(by_force)) < 1e-3
    assert np.sqrt(np.mean(np.square(by_force))) < 0.5 * np.sqrt(np.mean(np.square(by_joints)))


def test_joints_are_fitted_about_the_time_of_the_force() -> None:
    position = joints(200.0)
    onset = onset_of(force(), position, IMPACT + 0.003)
    assert onset is not None
    found = jump_at(position, onset.time, onset.error)
    assert found is not None and found.time == onset.time and found.time_error == onset.error
    np.testing.assert_allclose(found.after - found.before, JUMP, atol=0.12)  # what it vibrates within the window


def test_a_run_is_timed_by_its_fastest_signal_and_says_so() -> None:
    position = joints(100.0)
    jump = joint_jump(position, IMPACT + 0.004)
    assert jump is not None
    said: list[str] = []
    (timed,) = by_onset({"arm": {"position": position, "wrench": force()}}, [{"arm": jump}], said)
    assert timed["arm"].time == pytest.approx(IMPACT, abs=1e-3)
    assert len(said) == 1 and "timed by the onset of the force" in said[0]
    (left,) = by_onset({"arm": {"position": position}}, [{"arm": jump}], said)
    assert left["arm"] is jump and len(said) == 1


def acceleration(rate: float, seed: int = 0) -> Series:
    """That of a tool: its weight turns slowly, and it rings at 300 Hz from the impact on."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = np.maximum(time - IMPACT, 0.0)
    values = np.column_stack((2.0 * np.sin(time), 0.0 * time, 9.81 * np.cos(0.2 * time)))
    values[:, 0] -= 80.0 * np.cos(2.0 * np.pi * 300.0 * t) * np.exp(-t / 0.01) * (time > IMPACT)
    return Series("acceleration", time, values + 0.1 * np.random.default_rng(seed).standard_normal(values.shape))


def test_an_accelerometer_says_when_slow_joints_were_hit() -> None:
    """To a fraction of a millisecond at 5 kHz, and of two sensors the sharper one is taken."""
    position = joints(100.0)
    jump = joint_jump(position, IMPACT + 0.004)
    assert jump is not None
    for further, error in (({}, 3e-4), ({"wrench": force()}, 3e-4)):
        said: list[str] = []
        signals = {"position": position, "acceleration": acceleration(5000.0), **further}
        (timed,) = by_onset({"arm": signals}, [{"arm": jump}], said)
        assert timed["arm"].time == pytest.approx(IMPACT, abs=error)
        assert said == ["impacts are timed by the onset of the acceleration, which is faster than the joint positions"]
    slow = {"position": position, "acceleration": acceleration(500.0), "wrench": force()}
    (timed,) = by_onset({"arm": slow}, [{"arm": jump}], said)
    assert "the force at the wrist" in said[-1]


@pytest.mark.parametrize(
    ("wrench", "rate"),
    [
        pytest.param(force(), 1000.0, id="no faster than the joints"),
        pytest.param(force(peak=0.0), 100.0, id="no force"),
        pytest.param(Series("wrench", np.arange(5) / 1000.0, np.zeros((5, 6))), 100.0, id="too few samples"),
    ],
)
def test_a_force_that_says_nothing_leaves_the_joints_alone(wrench: Series, rate: float) -> None:
    assert onset_of(wrench, joints(rate), IMPACT) is None


def test_a_single_outlier_is_no_contact() -> None:
    wrench = force(peak=0.0)
    wrench.values[510, 1] = 500.0
    assert onset_of(wrench, joints(100.0), IMPACT) is None
