# SPDX-License-Identifier: Apache-2.0
"""Timestamps at which samples were not taken are noticed; noise, encoders and honest jitter are not taken for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from measured_data import measured_data

from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.importing import Wishes, draft_import
from impact_rs_trials.recordings.sampling_times import doubt_of_timestamps

COUNT = 1000


def swing(time: Array, noise: float = 1e-4, joints: int = 6) -> Array:
    """Joints at two frequencies each, with the noise of their encoders [rad]."""
    number = np.arange(joints)
    t = time[:, None]
    q = 0.5 * np.sin((0.9 + 0.2 * number) * t + number) + 0.1 * np.sin((2.5 + 0.3 * number) * t)
    return q + np.random.default_rng(1).normal(0.0, noise, q.shape)


def taken(period: float, spread: float, seed: int = 0) -> Array:
    """True times of samples whose periods vary."""
    return np.cumsum(period * (1.0 + spread * np.random.default_rng(seed).uniform(-1.7, 1.7, COUNT)))


@pytest.mark.parametrize("rate", [15.0, 30.0, 60.0])
@pytest.mark.parametrize("spread", [0.08, 0.18])
@pytest.mark.parametrize("joints", [2, 6])
def test_even_timestamps_of_uneven_samples_are_nominal(rate: float, spread: float, joints: int) -> None:
    said = doubt_of_timestamps(np.arange(COUNT) / rate, swing(taken(1.0 / rate, spread), joints=joints))
    assert said is not None and said.startswith(f"timestamps are nominal: exactly even ({rate:g} Hz)")
    found = float(said.split("vary by ")[1].split()[0]) / 100.0
    assert 0.7 * spread < found < 1.3 * spread


def test_timestamps_of_a_log_differ_from_when_samples_were_taken() -> None:
    true = taken(0.02, 0.1)
    logged = true + np.random.default_rng(2).uniform(0.0, 0.005, COUNT)
    said = doubt_of_timestamps(logged, swing(true))
    assert said is not None and said.startswith("samples were not taken at their timestamps")


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("spread", [0.0, 0.18])
@pytest.mark.parametrize("rate", [15.0, 30.0, 100.0, 1000.0])
def test_samples_at_their_timestamps_raise_no_doubt(noise: float, spread: float, rate: float) -> None:
    time = taken(1.0 / rate, spread)
    assert doubt_of_timestamps(time, swing(time, noise)) is None


@pytest.mark.parametrize("step", [1e-4, 1e-3])
def test_the_resolution_of_encoders_raises_no_doubt(step: float) -> None:
    time = np.arange(COUNT) / 50.0
    assert doubt_of_timestamps(time, step * np.round(swing(time) / step)) is None


def test_gaps_and_repeated_samples_are_left_to_those_who_look_for_them() -> None:
    time = np.delete(np.arange(COUNT) / 100.0, np.arange(300, 340))
    q = swing(time)
    q[500::50] = q[499:-1:50]
    assert doubt_of_timestamps(time, q) is None


def test_of_one_joint_nothing_can_be_said() -> None:
    assert doubt_of_timestamps(np.arange(COUNT) / 30.0, swing(taken(1.0 / 30.0, 0.2), joints=1)) is None


@pytest.mark.parametrize("file", ["nominal_stamps/episode.csv", "small/nominal_stamps.csv"])
def test_frame_numbers_over_a_rate_are_said_when_a_recording_is_imported(file: str, tmp_path: Path) -> None:
    """True periods vary by 17 % (true_times.txt)."""
    draft = draft_import([measured_data("cases", file)], tmp_path, Wishes(robot="franka_fer"))
    (said,) = [remark for remark in draft.remarks if "timestamps are nominal" in remark]
    assert 13.0 < float(said.split("vary by ")[1].split()[0]) < 20.0
