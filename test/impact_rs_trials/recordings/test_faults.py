# SPDX-License-Identifier: Apache-2.0
"""Samples that no sensor measured are found where they were planted, and nowhere else."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import pytest
from joint_recordings import write_npz
from measured_data import measured_data

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.faults import outliers, without_faults
from impact_rs_trials.recordings.experiment import Experiment
from impact_rs_trials.recordings.laboratory_runs import read_laboratory
from impact_rs_trials.recordings.mapping import SignalName, load_mapping
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.recording import ARM, read_recordings

if TYPE_CHECKING:
    from .conftest import LaboratoryFolder

MAPPING = load_mapping("joint_state")
MODEL = RobotModel(MAPPING.facts, MAPPING.end_effector.build(), pin.SE3.Identity())
FASTEST = np.array(MAPPING.facts.limits.velocity_rad_s)
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad

Recorded = dict[SignalName, Series]


def recorded(time: np.ndarray, **signals: np.ndarray) -> Recorded:
    return {name: Series(name, time, values) for name, values in signals.items()}  # type: ignore[misc]


def faults(signals: Recorded, hit: bool = False) -> list[str]:
    """What is said of samples that no sensor measured."""
    return without_faults(signals, MAPPING, MODEL, hit)[1]


def changed(signals: Recorded, name: SignalName, values: np.ndarray) -> Recorded:
    return {**signals, name: replace(signals[name], values=values)}


def saved(folder: Path, signals: Recorded, since: float = 0.0) -> Path:
    """As an array file whose clock begins later [s]."""
    values = {name: signals[name].values for name in ("position", "velocity")}
    time, effort = since + signals["position"].time, signals["torque"].values
    return write_npz(folder / "a.npz", {"time": time, **values, "effort": effort})


def quantised(values: np.ndarray, step: float) -> np.ndarray:
    return np.round(values / step) * step if step else values


def clean(seed: int) -> Recorded:
    """A robot that moves from point to point, rests, creeps and turns back, seen by sensors of some resolution."""
    rng = np.random.default_rng(seed)
    rate = rng.choice([1000.0, 500.0, 125.0, 30.0])
    time = np.arange(1500) / rate
    position, velocity = np.empty((time.size, 7)), np.empty((time.size, 7))
    for joint in range(7):
        place, start = CENTRE[joint], 0.0
        while start < time[-1] + 1.0:
            length = rng.uniform(0.05, 0.4) * time[-1]
            speed = rng.choice([0.0, 0.002, 0.02, 0.2, 0.6]) * FASTEST[joint]  # rest, creep, move
            way = (1.0 if place < CENTRE[joint] else -1.0) * min(0.5 * speed * length, 1.0)
            share = np.clip((time - start) / length, 0.0, 1.0)
            inside = (time >= start) & (time <= start + length)
            position[inside, joint] = (place + way * share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[inside]
            velocity[inside, joint] = (30.0 * way / length * share**2 * (1.0 - share) ** 2)[inside]
            place, start = place + way, start + length
    step = 10.0 ** rng.uniform(-6.0, -3.0)
    seen = quantised(position + rng.choice([0.0, 0.3, 1.0]) * step * rng.standard_normal(position.shape), step)
    if rng.random() < 0.5:  # tachometers with offset and dead band, or the encoder's differences over 20 ms
        offset = 0.01 * FASTEST * rng.uniform(-1.0, 1.0, 7)
        noise = rng.choice([0.0, 0.003, 0.03]) * rng.standard_normal(velocity.shape)
        velocity = quantised(velocity + offset + noise, rng.choice([0.0, 1e-3, 0.02]))
        velocity = np.where(np.abs(velocity) < rng.choice([0.0, 0.015]), 0.0, velocity)
    else:
        width = max(1, int(0.02 * rate))
        later = np.minimum(np.arange(time.size) + width, time.size - 1)
        before = np.maximum(np.arange(time.size) - width, 0)
        velocity = (seen[later] - seen[before]) / (time[later] - time[before])[:, None]
    knots = np.linspace(0, time.size - 1, 300).astype(int)
    weight = np.array([MODEL.gravity_torque(q) for q in position[knots]])
    torque = np.column_stack([np.interp(time, time[knots], column) for column in weight.T])
    torque = torque + rng.choice([0.0, 0.02, 0.3]) * rng.standard_normal(torque.shape)
    return recorded(time, position=seen, velocity=velocity, torque=quantised(torque, rng.choice([0.0, 0.01, 0.1])))


@pytest.mark.parametrize("seeds", [range(50), pytest.param(range(50, 300), marks=pytest.mark.slow)], ids=len)
def test_clean_recordings_of_any_resolution_raise_no_alarm(seeds: range) -> None:
    assert {seed: alarm for seed in seeds if (alarm := faults(clean(seed)))} == {}


@pytest.mark.slow
@pytest.mark.parametrize("bench", ["bench_0", "bench_1", "bench_2"])
def test_recordings_of_another_laboratory_raise_no_alarm(bench: str) -> None:
    """As recorded, and with encoders of 0.1 and 1 mrad."""
    runs, skipped = read_laboratory(measured_data("lab", bench), Experiment(scenario="push"), map)
    assert (len(runs), skipped) == (16, [])
    assert [remark for run in runs for remark in run.remarks if "left out" in remark] == []
    for run, step in ((run, step) for run in runs for step in (1e-4, 1e-3)):
        arm = run.signals.arms["arm"]
        position, torque = quantised(arm.position, step), quantised(arm.torque, 0.05)
        seen = recorded(run.signals.time, position=position, velocity=arm.velocity, torque=torque)
        assert faults(seen, run.hit) == []


def test_a_recording_of_a_real_arm_raises_no_alarm() -> None:
    file = measured_data("unisa_panda", "panda_exciting_trajectory.db3")
    (whole,) = read_recordings(file, MAPPING)
    assert (whole.signals.time.size, whole.remarks) == (727, ())


# ---- outliers -------------------------------------------------------------------------------------------------------


@functools.cache
def moving(rate: float = 1000.0, count: int = 4000) -> Recorded:
    """All joints swing, each at its own phase, with noise of a good sensor."""
    rng, time = np.random.default_rng(7), np.arange(count) / rate
    phase = 2.0 * time[:, None] + np.arange(7)
    position = CENTRE + 0.3 * np.sin(phase) + 1e-5 * rng.standard_normal((count, 7))
    velocity = 0.6 * np.cos(phase) + 1e-3 * rng.standard_normal((count, 7))
    torque = np.array([MODEL.gravity_torque(q) for q in position]) + 0.02 * rng.standard_normal((count, 7))
    return recorded(time, position=position, velocity=velocity, torque=torque)


def planted(signals: Recorded, name: SignalName, rows: slice, joint: int, value: float | np.ndarray) -> Recorded:
    values = signals[name].values.copy()
    values[rows, joint] = value
    return changed(signals, name, values)


def stuck(signals: Recorded, rows: slice, joint: int) -> Recorded:
    """An encoder that stays where it is."""
    return planted(signals, "position", rows, joint, signals["position"].values[rows.start, joint])


@pytest.mark.parametrize(
    ("name", "value", "unit"), [("position", 0.8, "rad"), ("velocity", 50.0, "rad/s"), ("torque", 1e6, "N m")]
)
@pytest.mark.parametrize(("row", "sign"), [(0, 1.0), (1, -1.0), (1234, -1.0), (3999, 1.0)])
def test_a_single_wild_sample_is_left_out_and_named(
    name: SignalName, value: float, unit: str, row: int, sign: float
) -> None:
    """Kills: deviations that count on one side only."""
    value *= sign
    signals = planted(moving(), name, slice(row, row + 1), 2, value)
    cleaned, (said,) = without_faults(signals, MAPPING, MODEL)
    place = f"first {value:.4g} {unit} at t = {row / 1e3:.3f} s"
    assert f"{name}: joint 3: 1 of 4000 samples is an outlier, {place}" in said
    assert cleaned[name].time.size == 3999
    assert signals[name].time[row] not in cleaned[name].time


def test_wild_samples_below_the_limit_are_found_by_their_neighbours() -> None:
    (said,) = faults(planted(moving(), "velocity", slice(700, 702), 1, 2.0))  # rad/s, of 2.175
    assert "joint 2: 2 of 4000 samples are outliers, first 2 rad/s at t = 0.700 s" in said


@pytest.mark.parametrize("speed", [5.0, -5.0])
def test_a_stretch_beyond_the_data_sheet_is_left_out(speed: float) -> None:
    """Kills: a limit that holds in one direction; a stretch does not stand alone, as a single sample does."""
    signals = planted(moving(), "velocity", slice(700, 740), 1, speed)
    cleaned, (said,) = without_faults(signals, MAPPING, MODEL)
    assert "joint 2: 40 of 4000 samples are outliers" in said
    assert np.max(np.abs(cleaned["velocity"].values)) < 1.0


def test_a_step_of_the_velocity_is_no_outlier() -> None:
    velocity = moving()["velocity"]
    stepped = velocity.values + np.where(velocity.time > 1.5, 1.2, 0.0)[:, None]  # rad/s within a sample
    assert not outliers("velocity", replace(velocity, values=stepped), MAPPING, None).any()


def test_a_blow_in_one_sample_of_the_torque_is_kept_at_the_impact_alone() -> None:
    torque = moving()["torque"].values
    hit = planted(moving(), "torque", slice(2000, 2001), 5, torque[2000, 5] + 10.0)["torque"]  # N m of 12
    assert not outliers("torque", hit, MAPPING, 1.995).any()
    assert np.argwhere(outliers("torque", hit, MAPPING, 0.5)).tolist() == [[2000, 5]]


def test_many_wild_samples_are_noise_or_a_unit_and_stay() -> None:
    wild = planted(moving(), "velocity", slice(None, None, 20), 0, 50.0)["velocity"]
    assert not outliers("velocity", wild, MAPPING, None).any()


def test_a_velocity_of_fifty_in_a_hit_is_named_and_interpolated(laboratory: LaboratoryFolder) -> None:
    velocity = laboratory.signals.velocity.copy()
    velocity[200, 3] = 50.0
    laboratory.change(velocity=velocity)
    run = laboratory.run()
    assert any("(velocity): joint 4: 1 of 700 samples is an outlier, first 50 rad/s" in line for line in run.remarks)
    assert run.signals.arms["arm"].velocity[200, 3] == pytest.approx(0.2)


def test_a_bad_sample_of_a_differentiated_encoder_is_no_wrong_unit(tmp_path: Path) -> None:
    """One bad sample, and velocities that its owner differentiated."""
    signals = moving(100.0, 1200)
    position = quantised(signals["position"].values, 1e-4)
    position[600, 1] += 0.1
    velocity = np.gradient(position, signals["position"].time, axis=0)
    both = changed(changed(signals, "position", position), "velocity", velocity)
    (whole,) = read_recordings(saved(tmp_path, both), MAPPING)
    said = "; ".join(whole.remarks)
    assert "(position): joint 2: 1 of 1200 samples is an outlier" in said
    assert "(velocity): joint 2: 2 of 1200 samples are outliers, first 5.545 rad/s" in said
    assert np.max(np.abs(whole.signals.arms[ARM].velocity)) < 0.7


def test_noise_above_the_limit_in_many_samples_is_refused(tmp_path: Path) -> None:
    signals = moving()
    noise = 3.0 * np.random.default_rng(0).standard_normal((4000, 7))  # rad/s, of a differentiated encoder
    path = saved(tmp_path, changed(signals, "velocity", signals["velocity"].values + noise))
    with pytest.raises(InputError, match="wrong unit"):
        read_recordings(path, MAPPING)


# ---- frozen values --------------------------------------------------------------------------------------------------


HALF = slice(2000, 4000)


@pytest.mark.parametrize("rows", [slice(1000, 3000), HALF, slice(0, 2000), slice(0, 4000)])
def test_a_position_that_stays_while_its_velocity_moves_is_frozen(rows: slice) -> None:
    signals = stuck(moving(), rows, 3)
    cleaned, (said,) = without_faults(signals, MAPPING, MODEL)
    first, last = rows.start / 1e3, (rows.stop - 1) / 1e3
    assert f"position: joint 4: frozen at {signals['position'].values[rows.start, 3]:.4g} rad" in said
    assert f"within t = {first:.3f} ... {last:.3f} s ({rows.stop - rows.start} of 4000 samples): left out" in said
    assert cleaned["position"].time.size == 4000 - (rows.stop - rows.start)


def test_a_frozen_encoder_whose_velocity_is_its_own_difference_stops_dead() -> None:
    signals = moving()
    position = quantised(signals["position"].values, 1e-4)
    position[2300:, 3] = position[2300, 3]  # joint 4 moves at 0.3 rad/s there
    velocity = np.gradient(position, 1e-3, axis=0)
    signals = recorded(signals["position"].time, position=position, velocity=velocity)
    (said,) = faults(signals)
    assert "position: joint 4: frozen" in said and "within t = 2.300 ... 3.999 s" in said


def test_a_joint_that_brakes_and_rests_is_not_frozen() -> None:
    """With the same encoder, braking within 80 ms."""
    signals = moving()
    time = signals["position"].time
    rest = np.clip((time - 2.3) / 0.08, 0.0, 1.0)
    true = np.where(time < 2.3, 0.3 * (time - 2.3), 0.3 * 0.08 * (rest - 0.5 * rest**2))
    position = signals["position"].values.copy()
    position[:, 3] = CENTRE[3] + true
    position = quantised(position, 1e-4)
    signals = recorded(time, position=position, velocity=np.gradient(position, 1e-3, axis=0))
    assert faults(signals) == []


@pytest.mark.parametrize("value", [0.0, 0.4])
def test_a_velocity_that_stays_while_the_position_does_not_is_frozen(value: float) -> None:
    cleaned, (said,) = without_faults(planted(moving(), "velocity", HALF, 5, value), MAPPING, MODEL)
    assert f"velocity: joint 6: frozen at {value:.4g} rad/s within t = 2.000 ... 3.999 s (2000 of" in said
    assert cleaned["velocity"].time.size == 2000


def test_an_even_motion_has_one_velocity_and_is_not_frozen() -> None:
    time = np.arange(2000) * 1e-3
    speed = 0.2 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
    signals = recorded(time, position=CENTRE + speed * time[:, None], velocity=np.tile(speed, (2000, 1)))
    assert faults(signals) == []


def test_a_torque_that_stays_while_the_weight_changes_is_frozen() -> None:
    (said,) = faults(planted(moving(), "torque", HALF, 1, -20.0))
    assert "torque: joint 2: frozen at -20 N m within t = 2.000 ... 3.999 s" in said


def test_a_torque_that_stays_where_the_weight_does_is_not_frozen() -> None:
    """Joint 1 turns about the vertical: its coarse torque of 0 is what there is."""
    assert faults(planted(moving(), "torque", slice(0, 4000), 0, 0.0)) == []


def test_a_signal_that_is_held_between_slow_samples_is_not_frozen() -> None:
    """Velocities at 10 Hz in a recording at 1 kHz stay for 100 samples each."""
    signals = moving()
    held = signals["velocity"].values[np.arange(4000) // 100 * 100]
    assert faults(changed(signals, "velocity", held)) == []


def test_a_recording_is_cut_where_a_sensor_was_frozen(tmp_path: Path) -> None:
    signals = stuck(moving(100.0, 3000), slice(1000, 2000), 3)
    first, second = read_recordings(saved(tmp_path, signals, since=100.0), MAPPING)
    assert (first.begin, first.signals.time[-1]) == pytest.approx((0.0, 109.99))
    assert (second.begin, second.signals.time[0], second.signals.time[-1]) == pytest.approx((20.0, 120.0, 129.99))
    assert first.remarks[0] == second.remarks[0]
    assert "joint 4: frozen" in first.remarks[0]
    np.testing.assert_array_equal(second.signals.arms[ARM].torque, signals["torque"].values[2000:])


def test_a_recording_that_is_frozen_as_a_whole_is_refused_with_the_sensor(tmp_path: Path) -> None:
    path = saved(tmp_path, planted(moving(100.0, 1000), "position", slice(0, 1000), 3, -2.0))
    with pytest.raises(InputError, match=r"no piece is long enough: .*\(position\): joint 4: frozen at -2 rad"):
        read_recordings(path, MAPPING)


def freeze(laboratory: LaboratoryFolder, row: int) -> None:
    """Joint 3 stays where it is from a row on."""
    position = laboratory.signals.position.copy()
    position[row:, 2] = position[row, 2]
    laboratory.change(position=position)


def test_a_run_keeps_what_was_measured_before_a_sensor_froze(laboratory: LaboratoryFolder) -> None:
    laboratory.signals = laboratory.signals.known(1.6)
    freeze(laboratory, 800)
    run = laboratory.run()
    assert run.signals.time[-1] == pytest.approx(0.8, abs=2e-3)
    assert any("(position): joint 3: frozen" in remark for remark in run.remarks)


def test_a_hit_whose_impact_a_frozen_sensor_missed_is_left_out(laboratory: LaboratoryFolder) -> None:
    laboratory.bag("good")
    freeze(laboratory, 350)
    laboratory.bag("stuck")
    runs, ((path, reason),) = laboratory.read_all("good,parcel,hit,a,a", "stuck,parcel,hit,a,a")
    assert [run.name for run in runs] == ["good"]
    assert Path(path).name == "stuck"
    assert "joint 3: frozen" in reason
