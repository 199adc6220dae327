# SPDX-License-Identifier: Apache-2.0
"""Joints and objects beside an impact: planted jumps, friction and ways are found from encoders and trackers alone."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import scipy
from known_recordings import IMPACT as HIT
from known_recordings import Signals

from impact_rs_trials.recordings.checks.joint_jumps import joint_jump, jumps_of
from impact_rs_trials.recordings.impacts.found_impacts import FoundImpacts, find_impacts
from impact_rs_trials.recordings.impacts.impact_rows import table_text
from impact_rs_trials.recordings.impacts.motion_fits import move, rest
from impact_rs_trials.recordings.readers.series import Series

if TYPE_CHECKING:
    from .conftest import LaboratoryFolder
from impact_rs_trials.recordings.checks.joint_jumps import jump_at
from impact_rs_trials.recordings.impacts.arm_impacts import refined_by_onset
from impact_rs_trials.recordings.impacts.contact_onset import onset_of

IMPACT = 0.5003  # s
JUMP = np.array([-0.21, 0.35, 0.04])  # rad/s
SPEED = np.array([0.6, -0.8, 0.1])


def joints(rate: float, noise: float, seed: int) -> Series:
    """Three joints that swing, whose velocities jump at a moment between two samples."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = time[:, None] - IMPACT
    values = SPEED * t + np.sin(3.0 * t) * 0.1 + np.maximum(t, 0.0) * JUMP + 0.8 * np.maximum(t, 0.0) ** 2
    noisy = values + noise * np.random.default_rng(seed).standard_normal(values.shape)
    return Series("q", time, noisy)


@pytest.mark.parametrize(("rate", "noise"), [(1000.0, 1e-5), (500.0, 2e-5), (200.0, 1e-5)])
def test_a_planted_jump_of_joint_velocities_is_found_with_its_noise(rate: float, noise: float) -> None:
    errors, moments = [], []
    for seed in range(30):
        found = joint_jump(joints(rate, noise, seed), IMPACT + 0.006)
        assert found is not None
        errors.append((found.after - found.before - JUMP) / found.noise)
        moments.append(found.time - IMPACT)
        np.testing.assert_allclose(found.before, SPEED + 0.3, atol=0.03)
    assert np.sqrt(np.mean(np.square(moments))) < 1.5e-3
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 2.5


@pytest.mark.parametrize(("rate", "noise"), [(1000.0, 1e-5), (500.0, 2e-5), (200.0, 1e-5)])
def test_the_time_of_an_impact_is_found_in_the_whole_run_with_its_error(rate: float, noise: float) -> None:
    errors = []
    for seed in range(20):
        (found,) = jumps_of(joints(rate, noise, seed))
        errors.append((found.time - IMPACT) / found.time_error)
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 2.5


def test_stamps_of_a_wall_clock_lose_no_digit() -> None:
    series = joints(200.0, 1e-5, 0)
    (near,), (far,) = (list(jumps_of(replace(series, time=series.time + since))) for since in (0.0, 1.7e9))
    assert far.time - 1.7e9 == pytest.approx(near.time, abs=2e-5)


def test_an_arm_that_vibrates_after_an_impact_is_hit_before_it_vibrates() -> None:
    """A wrist that goes 15 times as fast as its jump for some milliseconds, and back."""
    series = joints(1000.0, 1e-5, 0)
    t = np.maximum(series.time - IMPACT, 0.0)
    wrist = 0.6 * np.exp(-t / 0.01) * np.sin(2.0 * np.pi * 30.0 * t) / (2.0 * np.pi * 30.0)
    first = next(jumps_of(replace(series, values=series.values + np.outer(wrist, [0.0, 0.0, 1.0]))))
    assert first.time == pytest.approx(IMPACT, abs=3e-3)


def test_steps_of_a_fast_joint_are_not_those_of_its_encoder() -> None:
    """At 200 Hz joints that never turn back go 3 mrad and more from sample to sample."""
    time = np.arange(0.0, 2.0, 0.005)
    t = time[:, None] - 1.0
    values = SPEED * [1.0, 1.0, 8.0] * t - 0.2 * SPEED * np.maximum(t, 0.0)
    noise = 1e-5 * np.random.default_rng(0).standard_normal(values.shape)
    (found,) = jumps_of(Series("q", time, values + noise))
    assert found.time == pytest.approx(1.0, abs=5e-4)


def test_free_motion_and_gaps_hold_no_impact() -> None:
    """Nor does a stretch of 60 ms without samples, over which the joints go on."""
    time = np.arange(0.0, 2.0, 0.002)
    time = time[(time < 0.9) | (time > 0.96)]
    swing = 0.3 * np.sin(3.0 * time[:, None] + np.arange(3))
    noise = 1e-5 * np.random.default_rng(0).standard_normal(swing.shape)
    assert list(jumps_of(Series("q", time, swing + noise))) == []


def test_too_few_samples_about_an_impact_are_no_impact() -> None:
    series = joints(100.0, 0.0, 0)
    assert joint_jump(Series("q", series.time[48:], series.values[48:]), IMPACT) is None


def test_an_object_that_slides_shows_its_speed_and_its_friction() -> None:
    """0.9 m/s with mu = 0.25, tracked at 200 Hz to 0.1 mm."""
    errors, frictions = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        time = np.arange(0.002, 0.15, 0.005)
        way = 0.9 * time - 0.5 * 0.25 * 9.81 * time**2
        place = np.outer(way, [0.0, -1.0, 0.0]) + 1e-4 * rng.standard_normal((time.size, 3))
        motion = move(time, place, np.repeat(np.eye(3)[None], time.size, axis=0), 0.0)
        twist = motion.at(0.0)[2]
        errors.append((twist[:3] - [0.0, -0.9, 0.0]) / motion.noise[0])
        frictions.append(motion.acceleration[1] / 9.81)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.2)
    assert np.mean(frictions) == pytest.approx(0.25, abs=0.005)


def test_rest_has_the_scatter_of_the_tracker() -> None:
    rng = np.random.default_rng(0)
    place = np.array([0.4, 0.1, 0.2]) + 2e-4 * rng.standard_normal((50, 3))
    motion = rest(place, np.repeat(np.eye(3)[None], 50, axis=0), 1.0)
    assert motion.scatter[0] == pytest.approx(2e-4, rel=0.15)
    np.testing.assert_array_equal(motion.at(1.0)[2], np.zeros(6))


# ---- runs of an arm that hits a parcel ------------------------------------------------------------------------------

SPEEDS = 0.2 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])  # rad/s, of the known run before its impact
SEEN = 1e-4  # m, noise of the tracker


def noisy(signals: Signals) -> Signals:
    """With the noise of an encoder and a tracker."""
    rng = np.random.default_rng(0)
    pose = signals.pose.copy()
    pose[:, :3] += SEEN * rng.standard_normal(pose[:, :3].shape)
    return replace(signals, position=signals.position + 1e-5 * rng.standard_normal(signals.position.shape), pose=pose)


def impacts_in(laboratory: LaboratoryFolder) -> FoundImpacts:
    """Of one run with these signals."""
    laboratory.bag()
    (laboratory.path / "runs.csv").write_text("bag,object,kind\nrun_1,parcel,hit\n")
    return find_impacts(laboratory.path, laboratory.load(), map)


def late(laboratory: LaboratoryFolder, seconds: float, own: bool) -> None:
    """The clock of the tracker differs."""
    laboratory.signals = noisy(laboratory.signals)
    laboratory.change(object_time=laboratory.signals.object_time + round(seconds * 1e9))
    laboratory.mapping({"object_pose": {"clock": "own"} if own else {}})


@pytest.mark.parametrize("cutoff", [None, 20.0, 5.0, 2.0])
def test_a_low_passed_velocity_moves_no_impact(laboratory: LaboratoryFolder, cutoff: float | None) -> None:
    """Positions decide, however late the recorded velocity [Hz] jumps."""
    laboratory.signals = noisy(laboratory.signals)
    if cutoff is not None:
        filtered = scipy.signal.butter(2, cutoff / 500.0)
        start = laboratory.signals.velocity[0]
        laboratory.change(velocity=start + scipy.signal.lfilter(*filtered, laboratory.signals.velocity - start, axis=0))
    (impact,) = impacts_in(laboratory).impacts
    arm = impact.arms["arm"]
    noise = float(np.sqrt(np.mean(arm.noise**2)))
    assert impact.time == pytest.approx(HIT, abs=5e-4)
    np.testing.assert_allclose(arm.before, SPEEDS, atol=5.0 * noise)
    np.testing.assert_allclose(arm.after, 0.4 * SPEEDS, atol=5.0 * noise)
    assert noise < 5e-3


@pytest.mark.parametrize("seconds", [0.05, -3.0, 86400.0])
def test_an_offset_of_clocks_is_within_its_uncertainty(laboratory: LaboratoryFolder, seconds: float) -> None:
    late(laboratory, seconds, own=True)
    found = impacts_in(laboratory)
    (said,) = (remark for remark in found.remarks if "on another clock" in remark)
    moved = said.partition("moved by ")[2].split()
    offset, error = float(moved[0]), 1e-3 * float(moved[3])
    if abs(seconds) < 100.0:  # of a day six digits are said
        assert offset == pytest.approx(-seconds, abs=2.5 * error)
    assert error < 1e-3
    np.testing.assert_allclose(found.impacts[0].after[:3], [0.0, -0.4, 0.0], atol=5.0 * found.impacts[0].noise[0])


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0.05, "starts to move 50"),
        (-0.03, "before the joint velocities jump"),
        (86400.0, "begin +86400 s after those of the joints"),
    ],
)
def test_clocks_that_differ_are_named_with_the_remedy(laboratory: LaboratoryFolder, seconds: float, said: str) -> None:
    late(laboratory, seconds, own=False)
    (left_out,) = impacts_in(laboratory).left_out
    assert said in left_out.reason
    assert left_out.reason.endswith("Remedy in the mapping: signals.object_pose.clock: own")


def test_joints_that_never_jump_are_no_impact(laboratory: LaboratoryFolder) -> None:
    laboratory.signals = noisy(laboratory.signals)
    steady = laboratory.signals.position[:1] + SPEEDS * 1e-9 * laboratory.signals.time[:, None]
    laboratory.change(position=steady + 1e-5 * np.random.default_rng(1).standard_normal(steady.shape))
    (left_out,) = impacts_in(laboratory).left_out
    assert "never jump beyond their noise" in left_out.reason


def twice(laboratory: LaboratoryFolder, second: float) -> None:
    """0.1 s after the impact the arm loses a part of its speed again, and the object gains as much."""
    known = Signals.known(1.1)
    time, seen = 1e-9 * known.time[:, None] - HIT - 0.1, 1e-9 * known.object_time - HIT - 0.1
    pose = known.pose.copy()
    pose[:, 1] += 0.09 - second * 0.4 * np.maximum(seen, 0.0)  # at the pad
    position = known.position - second * 0.6 * SPEEDS * np.maximum(time, 0.0)
    laboratory.signals = noisy(replace(known, position=position, pose=pose))


def test_a_run_with_two_impacts_gives_two_rows(laboratory: LaboratoryFolder) -> None:
    twice(laboratory, 0.6)
    found = impacts_in(laboratory)
    assert [impact.run for impact in found.impacts] == ["run_1", "run_1, impact 2"]
    np.testing.assert_allclose([impact.time for impact in found.impacts], [HIT, HIT + 0.1], atol=5e-4)
    speeds = [(impact.before[1], impact.after[1]) for impact in found.impacts]
    np.testing.assert_allclose(speeds, [(0.0, -0.4), (-0.4, -0.64)], atol=0.01)
    np.testing.assert_allclose(found.impacts[1].arms["arm"].after, (0.4 - 0.36) * SPEEDS, atol=0.01)


def test_impacts_of_sessions_that_count_alike_stay_apart(laboratory: LaboratoryFolder) -> None:
    """Each session has a run 1; the last one hits nothing."""
    twice(laboratory, 0.6)
    laboratory.bag("monday/run_1")
    laboratory.bag("tuesday/run_1")
    still = np.repeat(laboratory.signals.position[:1], laboratory.signals.time.size, axis=0)
    laboratory.change(position=still + 1e-5 * np.random.default_rng(1).standard_normal(still.shape))
    laboratory.bag("friday/run_1")
    rows = [f"{session}/run_1,parcel,hit,{session}" for session in ("monday", "tuesday", "friday")]
    (laboratory.path / "runs.csv").write_text("\n".join(["bag,object,kind,session", *rows]) + "\n")
    found = find_impacts(laboratory.path, laboratory.load(), map)
    assert [(impact.run, impact.session) for impact in found.impacts] == [
        ("monday/run_1", "monday"), ("monday/run_1, impact 2", "monday"),
        ("tuesday/run_1", "tuesday"), ("tuesday/run_1, impact 2", "tuesday"),
    ]  # fmt: skip
    assert [one.name for one in found.left_out] == ["friday/run_1"]


def test_a_small_jump_while_the_pad_pushes_is_no_second_impact(laboratory: LaboratoryFolder) -> None:
    twice(laboratory, 0.2)
    assert [impact.run for impact in impacts_in(laboratory).impacts] == ["run_1"]


# ---- velocity after from the way to rest ----------------------------------------------------------------------------


def slid(laboratory: LaboratoryFolder) -> FoundImpacts:
    """The parcel, seen at 25 Hz, slides at 0.5 m/s until the friction of its support has stopped it."""
    known = Signals.known(1.0)
    time = np.arange(0, known.time[-1], 40_000_000)
    mu = laboratory.load().load_scenario().support.friction
    since = np.clip(1e-9 * time - HIT, 0.0, 0.5 / (mu * 9.81))
    pose = np.tile(known.pose[0], (time.size, 1))
    pose[:, 1] -= 0.5 * since - 0.5 * mu * 9.81 * since**2
    laboratory.signals = noisy(replace(known, object_time=time, pose=pose))
    return impacts_in(laboratory)


def columns(found: FoundImpacts) -> dict[str, str]:
    return next(csv.DictReader(io.StringIO(table_text(found.impacts, found.constants))))


def test_the_way_to_rest_gives_a_velocity_and_no_angular_velocity(laboratory: LaboratoryFolder) -> None:
    found = slid(laboratory)
    (impact,) = found.impacts
    assert impact.model == "sliding distance"
    assert np.linalg.norm(impact.after[:3]) == pytest.approx(0.5, abs=0.01)
    assert not any(name.startswith(("w_noise", "wx_after", "wy_after", "wz_after")) for name in columns(found))


def test_where_every_object_is_seen_too_seldom_the_way_to_rest_is_the_outcome(laboratory: LaboratoryFolder) -> None:
    """D = v^2 / (2 mu g), and its noise that of mu: a tenth."""
    found = slid(laboratory)
    mu = laboratory.load().load_scenario().support.friction
    cells = columns(found)
    assert float(cells["slide_distance [m]"]) == pytest.approx(0.5**2 / (2.0 * mu * 9.81), rel=0.03)
    assert float(cells["distance_noise [m]"]) == pytest.approx(0.1 * float(cells["slide_distance [m]"]), rel=0.05)
    assert not any(name.startswith(("vx_after", "v_noise")) for name in cells)
    assert any("no columns v_after and w_after" in remark for remark in found.remarks)


@pytest.mark.parametrize(("given", "relative"), [(None, 0.1), (0.3, 0.3)])
def test_the_noise_of_friction_is_that_of_the_experiment(
    laboratory: LaboratoryFolder, given: float | None, relative: float
) -> None:
    """v = sqrt(2 mu g D): half of the relative standard deviation of mu."""
    laboratory.experiment |= {} if given is None else {"friction_noise": given}
    (impact,) = slid(laboratory).impacts
    assert impact.noise[0] == pytest.approx(0.5 * relative * 0.5, rel=0.05)


# ---- the begin of a contact by force or acceleration ----------------------------------------------------------------


ONSET = 0.5137  # s


def ringing_joints(rate: float, seed: int = 0) -> Series:
    """Three ringing_joints whose velocities jump, and vibrate at 17 Hz afterwards."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = np.maximum(time - ONSET, 0.0)[:, None]
    values = 0.5 * time[:, None] + JUMP * t + 0.0006 * (1.0 - np.cos(2.0 * np.pi * 17.0 * t))
    return Series("q", time, values + 1e-5 * np.random.default_rng(seed).standard_normal(values.shape))


def force(rate: float = 1000.0, peak: float = 60.0, seed: int = 0) -> Series:
    """A force of free motion that drifts with the weight of the tool, and the push of an impact along y."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = time - ONSET
    push = peak * np.where(t > 0.0, 0.4 + 0.6 * np.sin(np.pi * np.clip(t / 0.008, 0.0, 1.0)), 0.0)
    values = np.zeros((time.size, 6))
    values[:, 1], values[:, 2] = push, -5.0 + 0.2 * time
    values[:, :3] += [0.3, 0.3, 1.0] * np.random.default_rng(seed).standard_normal((time.size, 3))
    return Series("wrench", time, values)


def test_the_force_says_when_slow_joints_were_hit() -> None:
    """Joints at 100 Hz that vibrate know it to some milliseconds, the force to its period of 1 ms."""
    by_joints, by_force = [], []
    for seed in range(20):
        position = ringing_joints(100.0, seed)
        jump = joint_jump(position, ONSET + 0.004)
        assert jump is not None
        onset = onset_of(force(seed=seed), position, jump.time)
        assert onset is not None and onset[1] < 3e-4
        by_joints.append(jump.time - ONSET)
        by_force.append(onset[0] - ONSET)
    assert np.max(np.abs(by_force)) < 1e-3
    assert np.sqrt(np.mean(np.square(by_force))) < 0.5 * np.sqrt(np.mean(np.square(by_joints)))


def test_joints_are_fitted_about_the_time_of_the_force() -> None:
    position = ringing_joints(200.0)
    onset = onset_of(force(), position, ONSET + 0.003)
    assert onset is not None
    found = jump_at(position, onset[0], onset[1])
    assert found is not None and found.time == onset[0] and found.time_error == onset[1]
    np.testing.assert_allclose(found.after - found.before, JUMP, atol=0.12)  # what it vibrates within the window


def test_a_run_is_timed_by_its_fastest_signal_and_says_so() -> None:
    position = ringing_joints(100.0)
    jump = joint_jump(position, ONSET + 0.004)
    assert jump is not None
    said: list[str] = []
    (timed,) = refined_by_onset({"arm": {"position": position, "wrench": force()}}, [{"arm": jump}], said)
    assert timed["arm"].time == pytest.approx(ONSET, abs=1e-3)
    assert len(said) == 1 and "timed by the onset of the force" in said[0]
    (left,) = refined_by_onset({"arm": {"position": position}}, [{"arm": jump}], said)
    assert left["arm"] is jump and len(said) == 1


def acceleration(rate: float, seed: int = 0) -> Series:
    """That of a tool: its weight turns slowly, and it rings at 300 Hz from the impact on."""
    time = np.arange(0.0, 1.0, 1.0 / rate)
    t = np.maximum(time - ONSET, 0.0)
    values = np.column_stack((2.0 * np.sin(time), 0.0 * time, 9.81 * np.cos(0.2 * time)))
    values[:, 0] -= 80.0 * np.cos(2.0 * np.pi * 300.0 * t) * np.exp(-t / 0.01) * (time > ONSET)
    return Series("acceleration", time, values + 0.1 * np.random.default_rng(seed).standard_normal(values.shape))


def test_an_accelerometer_says_when_slow_joints_were_hit() -> None:
    """To a fraction of a millisecond at 5 kHz, and of two sensors the sharper one is taken."""
    position = ringing_joints(100.0)
    jump = joint_jump(position, ONSET + 0.004)
    assert jump is not None
    for further, error in (({}, 3e-4), ({"wrench": force()}, 3e-4)):
        said: list[str] = []
        signals = {"position": position, "acceleration": acceleration(5000.0), **further}
        (timed,) = refined_by_onset({"arm": signals}, [{"arm": jump}], said)
        assert timed["arm"].time == pytest.approx(ONSET, abs=error)
        assert said == ["impacts are timed by the onset of the acceleration, which is faster than the joint positions"]
    slow = {"position": position, "acceleration": acceleration(500.0), "wrench": force()}
    (timed,) = refined_by_onset({"arm": slow}, [{"arm": jump}], said)
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
    assert onset_of(wrench, ringing_joints(rate), ONSET) is None


def test_a_single_outlier_is_no_contact() -> None:
    wrench = force(peak=0.0)
    wrench.values[510, 1] = 500.0
    assert onset_of(wrench, ringing_joints(100.0), ONSET) is None
