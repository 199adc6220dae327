# SPDX-License-Identifier: Apache-2.0
"""Time stamps: what is wrong is found, and what is nearly even is taken as it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_data import measured_data
from refusals import refusal

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.checks.clock_offset import offset_between, start_of_motion
from impact_rs_trials.recordings.checks.sampling_times import timestamp_warning
from impact_rs_trials.recordings.importing.import_recordings import ImportOptions, draft_import
from impact_rs_trials.recordings.readers.clock import (
    check_jumps,
    check_stamps,
    even_grid,
    gaps,
    gaps_in_words,
    grid_from,
    seconds_of,
)
from impact_rs_trials.recordings.readers.series import Series

BAG = Path("bag")


def test_stamps_of_a_wall_clock_are_on_an_even_grid_but_for_rounding() -> None:
    start = 1_763_500_000.0  # s, where floating-point numbers are 0.24 us apart
    stamps = (start + 1e-3 * np.arange(100_000)) - start
    grid = even_grid(stamps)
    assert grid.size == stamps.size  # the median step, 0.99993 ms, would give eight samples more
    np.testing.assert_allclose(grid, stamps, atol=1e-6)


def test_a_grid_goes_through_gaps_at_the_usual_distance() -> None:
    stamps = np.delete(1e-3 * np.arange(1000), range(300, 340))
    grid = even_grid(stamps)
    np.testing.assert_allclose(grid, 1e-3 * np.arange(1000), atol=1e-12)
    assert gaps_in_words(gaps(stamps, 0.005), 0.0) == "0.041 s at t = 0.299 s"


def test_a_grid_is_that_of_the_piece_that_matters_carried_on() -> None:
    first, last = 1e-3 * np.arange(1000), 1.3004 + 1e-3 * np.arange(500)  # the clock has lost its beat in between
    stamps = np.concatenate((first, last))
    grid = grid_from(stamps, first)
    np.testing.assert_allclose(grid[:1000], first, atol=1e-12)
    assert grid[-1] == pytest.approx(1.799)
    np.testing.assert_allclose(grid_from(stamps, last)[-500:], last, atol=1e-9)
    assert grid_from(stamps, last)[0] == pytest.approx(0.0004)
    assert np.array_equal(grid_from(first, first), even_grid(first))


def test_nanoseconds_of_a_wall_clock_are_read_as_well_as_a_header() -> None:
    nanoseconds = 1_763_500_000 * 10**9 + np.arange(0, 50_000_000, 1_234_567)
    header = nanoseconds // 10**9 + 1e-9 * (nanoseconds % 10**9)
    assert np.array_equal(seconds_of(nanoseconds, 1e-9), header)
    assert not np.array_equal(1e-9 * nanoseconds, header)
    assert np.array_equal(seconds_of(np.array([1.5, 2.0]), 1e-3), [0.0015, 0.002])


def test_many_gaps_are_counted() -> None:
    assert gaps_in_words(gaps(np.arange(8.0), 0.5), 0.0).endswith("1.000 s at t = 4.000 s and 2 more")


@pytest.mark.parametrize(
    ("stamps", "complaint"),
    [
        ([0.0, 1.0, 1.0, 1.0, 2.0], "stand still at t = 1.000 s, 2 of 5 repeat the one before: recorded twice"),
        ([0.0, 1.0, 0.5, 2.0], "run backwards by 0.5 s at t = 1.000 s: the clock was set"),
        ([0.0, np.nan, 2.0], "sample 1 has no finite time"),
    ],
)
def test_stamps_that_do_not_increase_are_refused_with_a_remedy(stamps: list[float], complaint: str) -> None:
    with pytest.raises(InputError, match="bag: /joint_states: ") as caught:
        check_stamps(BAG, "/joint_states", np.array(stamps))
    assert complaint in str(caught.value)


def test_a_clock_that_was_set_is_told_from_a_pause_by_the_log() -> None:
    time = 1e-3 * np.arange(100.0)
    jumped = np.where(time > 0.05, time + 0.7, time)
    with pytest.raises(InputError, match=r"jump by 0.701 s at t = 0.050 s, 0.001 s by the log: the clock was set"):
        check_jumps(BAG, "/mocap", jumped, time, 0.1, pauses=False)
    check_jumps(BAG, "/mocap", jumped, jumped, 0.1, pauses=False)  # the object was out of sight
    with pytest.raises(InputError, match="a jump of the clock, or a pause"):
        check_jumps(BAG, "/joint_states", jumped, None, 0.1, pauses=True)


def test_a_log_that_was_written_late_is_no_jump_of_the_stamps() -> None:
    time = 1e-3 * np.arange(100.0)
    check_jumps(BAG, "/joint_states", time, np.where(time > 0.05, time + 0.7, time), 0.1, pauses=True)


# ---- clocks that differ by a constant -------------------------------------------------------------------------------


DAY = 86400.0  # s
FILE = Path("run.csv")


def swing(time: np.ndarray) -> np.ndarray:
    """Two joints that speed up as they swing, so that no part of the motion is like another."""
    return np.column_stack((np.sin(2.0 * time + 0.15 * time**2), np.cos(1.3 * time + 0.2 * time**2)))


def streams(offset: float, noise: float = 0.0, seed: int = 1) -> tuple[Series, Series]:
    """Positions at 200 Hz, and what another clock says of them at 90 Hz, from 1.5 s later on."""
    rng = np.random.default_rng(seed)
    one, other = np.arange(0.0, 8.0, 0.005), np.arange(1.5, 7.0, 1.0 / 90.0)
    measured = -3.0 * swing(other) + 0.4 + noise * rng.standard_normal((other.size, 2))
    return Series("q", one, swing(one)), Series("dq", other + offset, measured)


@pytest.mark.parametrize("offset", [0.0, 0.0123, -2.7, DAY])
def test_a_planted_offset_is_found_whatever_factor_and_zero(offset: float) -> None:
    found, _ = offset_between(*streams(offset), FILE, "signals.velocity.clock")
    assert found == pytest.approx(-offset, abs=2e-4)


def test_columns_may_have_factors_of_either_sign() -> None:
    """As motor encoders and currents have; kills a sum of correlations with their signs."""
    position, velocity = streams(0.3)
    mirrored = replace(velocity, values=velocity.values * [1.0, -1.0])
    found, _ = offset_between(position, mirrored, FILE, "signals.velocity.clock")
    assert found == pytest.approx(-0.3, abs=2e-4)


def test_the_standard_error_is_that_of_repeated_recordings() -> None:
    found = np.array([offset_between(*streams(0.3, 0.3, seed), FILE, "k") for seed in range(40)])
    scatter, said = float(np.std(found[:, 0])), float(np.mean(found[:, 1]))
    assert 0.5 < scatter / said < 2.0


def test_a_motion_that_repeats_itself_determines_no_offset() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    series = Series("q", time, np.sin(2.0 * np.pi * time)[:, None])
    said = refusal(offset_between, series, replace(series, time=time + 0.2), FILE, "signals.velocity.clock")
    assert "signals.velocity.clock = 'own'" in said
    assert "does not determine" in said


def test_rest_determines_no_offset() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 4.0, 0.005)
    one, other = (Series("q", time, 1e-3 * rng.standard_normal((time.size, 2))) for _ in range(2))
    assert "does not determine" in refusal(offset_between, one, other, FILE, "k")


@pytest.mark.parametrize(("rate", "noise"), [(120.0, 1e-4), (240.0, 3e-4)])
def test_an_object_starts_when_it_is_hit(rate: float, noise: float) -> None:
    """Pushed to 0.8 m/s at t = 1.2345 s, it slides with friction 0.3."""
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        time = rng.uniform(0.0, 1.0 / rate) + np.arange(0.0, 1.4, 1.0 / rate)
        after = np.maximum(time - 1.2345, 0.0)
        way = 0.8 * after - 0.5 * 0.3 * 9.81 * after**2
        place = np.outer(way, [0.6, 0.8, 0.0]) + noise * rng.standard_normal((time.size, 3))
        found, error = start_of_motion(Series("pose", time, place), FILE, "k")
        errors.append((found - 1.2345) / error)
        assert found == pytest.approx(1.2345, abs=0.5 / rate)
    assert np.sqrt(np.mean(np.square(errors))) < 2.5


def test_noise_of_interpolated_poses_is_no_motion() -> None:
    """Kills: noise from second differences, which are 0 between samples interpolated to the rate of the joints."""
    for seed in range(10):
        measured, time = np.arange(0.0, 1.5, 0.004), np.arange(0.0, 1.496, 0.001)
        way = np.outer(0.5 * np.maximum(measured - 1.2345, 0.0), [0.6, 0.8, 0.0])
        pose = Series("pose", measured, way + 1e-4 * np.random.default_rng(seed).standard_normal(way.shape))
        found, _ = start_of_motion(replace(pose, time=time, values=pose.at(time)), FILE, "k")
        assert found == pytest.approx(1.2345, abs=0.006)


def test_an_object_that_never_rests_determines_no_offset() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    said = refusal(start_of_motion, Series("pose", time, np.outer(time, [1.0, 0.0, 0.0])), FILE, "k")
    assert "does not rest at first" in said


# ---- timestamps at which samples were not taken are noticed; noise, encoders and honest jitter are not --------------


COUNT = 1000


def swinging_joints(time: Array, noise: float = 1e-4, joints: int = 6) -> Array:
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
    said = timestamp_warning(np.arange(COUNT) / rate, swinging_joints(taken(1.0 / rate, spread), joints=joints))
    assert said is not None and said.startswith(f"timestamps are nominal: exactly even ({rate:g} Hz)")
    found = float(said.split("vary by ")[1].split()[0]) / 100.0
    assert 0.7 * spread < found < 1.3 * spread


def test_timestamps_of_a_log_differ_from_when_samples_were_taken() -> None:
    true = taken(0.02, 0.1)
    logged = true + np.random.default_rng(2).uniform(0.0, 0.005, COUNT)
    said = timestamp_warning(logged, swinging_joints(true))
    assert said is not None and said.startswith("samples were not taken at their timestamps")


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("spread", [0.0, 0.18])
@pytest.mark.parametrize("rate", [15.0, 30.0, 100.0, 1000.0])
def test_samples_at_their_timestamps_raise_no_doubt(noise: float, spread: float, rate: float) -> None:
    time = taken(1.0 / rate, spread)
    assert timestamp_warning(time, swinging_joints(time, noise)) is None


@pytest.mark.parametrize("step", [1e-4, 1e-3])
def test_the_resolution_of_encoders_raises_no_doubt(step: float) -> None:
    time = np.arange(COUNT) / 50.0
    assert timestamp_warning(time, step * np.round(swinging_joints(time) / step)) is None


def test_gaps_and_repeated_samples_are_left_to_those_who_look_for_them() -> None:
    time = np.delete(np.arange(COUNT) / 100.0, np.arange(300, 340))
    q = swinging_joints(time)
    q[500::50] = q[499:-1:50]
    assert timestamp_warning(time, q) is None


def test_of_one_joint_nothing_can_be_said() -> None:
    assert timestamp_warning(np.arange(COUNT) / 30.0, swinging_joints(taken(1.0 / 30.0, 0.2), joints=1)) is None


@pytest.mark.parametrize("file", ["nominal_stamps/episode.csv", "small/nominal_stamps.csv"])
def test_frame_numbers_over_a_rate_are_said_when_a_recording_is_imported(file: str, tmp_path: Path) -> None:
    """True periods vary by 17 % (true_times.txt)."""
    draft = draft_import([measured_data("cases", file)], tmp_path, ImportOptions(robot="franka_fer"))
    (said,) = [remark for remark in draft.remarks if "timestamps are nominal" in remark]
    assert 13.0 < float(said.split("vary by ")[1].split()[0]) < 20.0
