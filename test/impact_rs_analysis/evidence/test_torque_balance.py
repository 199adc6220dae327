# SPDX-License-Identifier: Apache-2.0
"""Torque balance: linear in the inertial parameters, and with the motors only where their torque was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy
from joint_recordings import Columns, swinging, write_npz
from slender_arm import mapping_of, slender_arm, swung, with_effects
from wrong_readings import FAULTS, SCALE, Fault

from impact_rs_analysis.evidence.free_motion.torque_balance import FILTER_ORDER, TorqueBalance, prepare
from impact_rs_sim.physics import Physics
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import ARM, read_recordings

EFFECTS = (
    {},
    {"link_mass": {"scale_joint2": 1.4}},
    {"link_com": {"com_y_joint3": 0.05}, "link_inertia": {"inertia_joint1": 0.1}},
    {"base_tilt": {"roll": 0.1, "pitch": -0.05}},
    {"base_tilt": {"roll": 0.2}},
    {"end_effector_payload": {"mass": 0.8, "com_x": 0.1}},
)


def balance_of(folder: Path, mapping: Mapping) -> TorqueBalance:
    path = write_npz(folder / "run.npz", swung(mapping, {}, seconds=12.0))
    return TorqueBalance([prepare(run, mapping.low_pass) for run in read_recordings(path, mapping)], at_motor=True)


def newton_euler(balance: TorqueBalance, physics: Physics) -> np.ndarray:
    """Inverse dynamics sample by sample, low-passed."""
    (motion,), model = balance.motions, physics.robot_model(ARM)
    states = zip(motion.position, motion.velocity, motion.acceleration, strict=True)
    return motion.low_pass(np.array([model.inverse_dynamics(*state) for state in states]))[motion.inner]


def test_the_torque_of_any_links_is_that_of_inverse_dynamics(tmp_path: Path) -> None:
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3))
    balance = balance_of(tmp_path, mapping)
    for effects in (*EFFECTS, *EFFECTS):  # again, when other directions of gravity came between
        physics = with_effects(mapping, effects)
        np.testing.assert_allclose(balance.predict(physics), newton_euler(balance, physics), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("effects", [{}, {"link_mass": {"scale_joint1": 1.4}}, {"base_tilt": {"pitch": 0.1}}])
def test_the_torque_of_a_single_joint_follows_its_motion(effects: dict[str, dict[str, float]], tmp_path: Path) -> None:
    mapping = mapping_of(tmp_path, slender_arm(("revolute",)))
    balance, physics = balance_of(tmp_path, mapping), with_effects(mapping, effects)
    np.testing.assert_allclose(balance.predict(physics), newton_euler(balance, physics), rtol=0.0, atol=1e-9)
    assert np.ptp(balance.predict(physics)) > 0.5  # N m


def test_the_low_pass_is_that_of_scipy(tmp_path: Path) -> None:
    """Kills another continuation beyond the ends, and a filter that starts at rest."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",)))
    (motion,) = balance_of(tmp_path, mapping).motions
    values = np.cumsum(np.random.default_rng(1).normal(size=(100, 3)), axis=0)
    sections = scipy.signal.butter(FILTER_ORDER, motion.cut_off, fs=motion.rate, output="sos")
    np.testing.assert_allclose(motion.low_pass(values), scipy.signal.sosfiltfilt(sections, values, axis=0), atol=1e-12)


@pytest.mark.parametrize("at_motor", [True, False])
def test_motors_are_accelerated_by_the_torque_that_was_measured_at_them(at_motor: bool, tmp_path: Path) -> None:
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3))
    balance = TorqueBalance(balance_of(tmp_path, mapping).motions, at_motor)
    (motion,) = balance.motions
    inertia = np.array([0.3, 0.2, 0.1])
    effect = {"added_motor_inertia": {f"inertia_joint{joint + 1}": value for joint, value in enumerate(inertia)}}
    change = balance.predict(with_effects(mapping, effect)) - balance.predict(with_effects(mapping, {}))
    expected = motion.low_pass(inertia * motion.acceleration)[motion.inner] if at_motor else np.zeros_like(change)
    np.testing.assert_allclose(change, expected, atol=1e-9)


def test_noise_is_what_the_torque_has_beside_friction_that_jumps_and_weight_that_swings(tmp_path: Path) -> None:
    """White noise of 0.02 N m at 50 Hz has 0.02 sqrt(3 / 25) N m below 3 Hz."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3))
    dry = {"joint_coulomb_friction": {"coulomb_joint1": 2.0, "coulomb_joint2": 1.0, "coulomb_joint3": 0.5}}
    (run,) = read_recordings(write_npz(tmp_path / "run.npz", swung(mapping, dry, noise=0.02)), mapping)
    white = 0.02 * np.sqrt(3.0 / 25.0)
    noise = prepare(run, mapping.low_pass).noise
    assert np.all(noise > 0.6 * white) and np.all(noise < 2.0 * white)


def test_a_fast_motion_is_no_noise(tmp_path: Path) -> None:
    """Inertia and friction at 5 and 6 Hz, above the low-pass, go with the motion; white noise of 0.02 N m does not.

    What is left is that inertia varies with the pose.
    """
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3), torque_measured_at="motor")
    physics = with_effects(mapping, {"added_motor_inertia": {f"inertia_joint{joint}": 0.2 for joint in (1, 2, 3)}})
    fast = np.array([5.1, 5.6, 6.2]), np.array([0.3, 0.4, 0.5])
    columns = swinging(physics.robot_model(ARM), np.arange(0.0, 24.0, 0.002), 0.0, fast, (0.02, 0.4))
    inertia = physics.arms[ARM].motor_inertia_reduced * np.gradient(columns["velocity"], 0.002, axis=0)
    noise = np.random.default_rng(2).normal(0.0, 0.02, inertia.shape)
    columns["effort"] += inertia + 0.3 * np.tanh(columns["velocity"] / 0.005) + noise
    (run,) = read_recordings(write_npz(tmp_path / "run.npz", columns), mapping)
    found = prepare(run, mapping.low_pass).noise
    white = 0.02 * np.sqrt(mapping.low_pass / 250.0)
    assert np.all(found > 0.6 * white) and np.all(found < 0.03 * columns["effort"].std(axis=0))
    still = run.signals.arms[ARM].torque.std(axis=0)
    assert np.all(still > 2.0)  # N m, most of it above the low-pass


def balance_of_links(folder: Path, mapping: Mapping, columns: Columns) -> TorqueBalance:
    path = write_npz(folder / "run.npz", columns)
    return TorqueBalance([prepare(run, mapping.low_pass) for run in read_recordings(path, mapping)])


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.effect)
def test_a_wrong_reading_is_predicted_from_the_motion_that_it_stands_for(fault: Fault, tmp_path: Path) -> None:
    """As well as a right one; kills the other sign, which makes the error twice as large."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3))
    right = swung(mapping, {}, noise=0.0, seconds=12.0)

    def rest(columns: Columns, effects: dict[str, dict[str, float]]) -> np.ndarray:
        balance = balance_of_links(tmp_path, mapping, columns)
        return balance.recorded - balance.predict(with_effects(mapping, effects))

    of_filters = rest(right, {})
    wrong = np.std(rest(fault.made(right), {}))
    assert wrong > 0.01  # N m
    assert np.std(rest(fault.made(right), fault.planted) - of_filters) < 0.01 * wrong


def test_a_filter_that_is_none_but_for_the_rounding_changes_nothing(tmp_path: Path) -> None:
    """A fit ends at a bound up to the rounding; kills exp(period / 1e-19), which overflows."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",)))
    balance = balance_of(tmp_path, mapping)
    none, rounded = ({"torque_sensor_lag": {"lag": lag}} for lag in (0.0, -1e-19))
    assert np.array_equal(*(balance.predict(with_effects(mapping, effects)) for effects in (none, rounded)))


def test_a_deflection_shows_the_scale_of_the_encoder_of_the_link(tmp_path: Path) -> None:
    """Motor less link: one that reads 2 % too much shows -0.02 q; kills readings that change the torque alone."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3))
    place = mapping.signals["position"].model_copy(update={"array": "motor"})
    mapping = mapping.model_copy(update={"signals": mapping.signals | {"motor_position": place}})
    right = swung(mapping, {}, noise=0.0, seconds=12.0)
    rng = np.random.default_rng(1)
    motors = {"motor": right["position"] + rng.normal(0.0, 1e-6, right["position"].shape)}
    balance = balance_of_links(tmp_path, mapping, SCALE.made(right) | motors)
    predicted = balance.predict(with_effects(mapping, SCALE.planted))
    assert np.abs(predicted - balance.recorded)[:, 3:].max() < 1e-4  # rad
    assert np.ptp(balance.recorded[:, 4]) > 0.01


def test_dry_friction_turns_where_the_joint_does_and_not_where_its_low_passed_velocity_does(tmp_path: Path) -> None:
    """A shake at 4 Hz reverses the joint between reversals below the low-pass of 3 Hz; kills the filtered sign."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",)))
    model, coulomb = with_effects(mapping, {}).robot_model(ARM), 3.0
    columns = swinging(model, np.arange(0.0, 24.0, 0.004), 0.0, (np.array([0.2]), np.array([4.0])), (0.5, 0.03))
    columns["effort"] += coulomb * np.tanh(columns["velocity"] / 0.005)
    balance = balance_of_links(tmp_path, mapping, columns)
    dry = {"joint_coulomb_friction": {"coulomb_joint1": coulomb}}
    rest = balance.recorded - balance.predict(with_effects(mapping, dry))
    assert np.std(rest) < 0.02 * coulomb


@pytest.mark.parametrize("rate", [50.0, 500.0])
def test_the_torque_of_a_fast_motion_is_predicted_down_to_its_noise(rate: float, tmp_path: Path) -> None:
    """Swings of 1.6 Hz, half the cut-off. Kills: the model of a motion that is smoothed at the cut-off itself."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 3))
    model, noise = with_effects(mapping, {}).robot_model(ARM), 0.02  # N m
    frequencies = np.array([0.31, 0.43, 0.29]), np.array([1.6, 1.3, 1.1])
    columns = swinging(model, np.arange(0.0, 40.0, 1.0 / rate), 0.0, frequencies, (0.5, 0.3))
    columns["effort"] += np.random.default_rng(4).normal(0.0, noise, columns["effort"].shape)
    balance = balance_of_links(tmp_path, mapping, columns)
    residual = balance.recorded - balance.predict(with_effects(mapping, {}))
    white = noise * np.sqrt(mapping.low_pass / (0.5 * rate))
    assert np.all(0.7 * white < residual.std(axis=0)) and np.all(residual.std(axis=0) < 1.4 * white)


def test_a_velocity_from_differences_of_a_coarse_encoder_does_not_stand_still_at_reversals(tmp_path: Path) -> None:
    """16 bits a turn in 2 ms are steps of 0.05 rad/s. Kills: friction by the recorded velocity."""
    mapping, time = mapping_of(tmp_path, slender_arm(("revolute",))), np.arange(0.0, 40.0, 0.002)
    model, coulomb = with_effects(mapping, {}).robot_model(ARM), 1.0
    columns = swinging(model, time, 0.0, (np.array([0.2]), np.array([0.5])), (0.3, 0.05))
    columns["effort"] += coulomb * np.tanh(columns["velocity"] / 0.005)
    step = 2.0 * np.pi / 2**16
    columns["position"] = step * np.round(columns["position"] / step)
    columns["velocity"] = np.gradient(columns["position"], 0.002, axis=0)
    balance = balance_of_links(tmp_path, mapping, columns)
    residual = balance.recorded - balance.predict(
        with_effects(mapping, {"joint_coulomb_friction": {"coulomb_joint1": coulomb}})
    )
    assert np.std(residual) < 0.02 * coulomb
