# SPDX-License-Identifier: Apache-2.0
"""A joint with the wrong sign or unit is named with its remedy, and right recordings raise no doubt."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from joint_recordings import swinging, write_npz
from measured_data import measured_data
from slender_arm import lighter, mapping_of, slender_arm
from slender_arm import swung as slender_swung

from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.checks.joint_checks import arm_warnings
from impact_rs_trials.recordings.experiment import Experiment
from impact_rs_trials.recordings.laboratory_runs import read_laboratory
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import read_recordings
from impact_rs_trials.recordings.remarks import merged
from impact_rs_trials.runs import ArmSignals

MAPPING = load_mapping("joint_state")
MODEL = RobotModel(MAPPING.facts, MAPPING.end_effector.build(), pin.SE3.Identity())
CENTRE = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5])  # rad
TIME = np.arange(0.0, 20.0, 0.005)
RATES = np.array([[0.11, 0.13, 0.17, 0.19, 0.23, 0.29, 0.31], [0.53, 0.59, 0.61, 0.67, 0.71, 0.73, 0.79]])  # Hz
FRICTION = 1.0  # N m


def swung(friction: float = FRICTION) -> dict[str, np.ndarray]:
    """All joints swing against friction."""
    columns = swinging(MODEL, TIME, CENTRE, (RATES[0], RATES[1]), (0.4, 0.05))
    return columns | {"effort": columns["effort"] + friction * np.tanh(columns["velocity"] / 0.01)}


def doubts(factors: dict[str, tuple[int, float]]) -> list[str]:
    """Of a recording in which a signal of one joint is multiplied by a factor."""
    columns = swung()
    for name, (joint, factor) in factors.items():
        columns[name] = columns[name] * np.where(np.arange(7) == joint, factor, 1.0)
    arm = ArmSignals(columns["position"], columns["velocity"], columns["effort"])
    return arm_warnings(TIME, arm, MAPPING, MODEL)


@pytest.mark.parametrize("friction", [0.0, 1.0, 3.0])
def test_a_right_recording_raises_no_doubt_whatever_its_friction(friction: float) -> None:
    columns = swung(friction)
    arm = ArmSignals(columns["position"], columns["velocity"], columns["effort"])
    assert arm_warnings(TIME, arm, MAPPING, MODEL) == []


def test_zeros_of_encoders_at_right_angles_are_named_by_their_offsets() -> None:
    """Kills: a factor of one joint's torque as the remedy where two encoders have another zero."""
    columns, moved = swung(), 0.5 * np.pi * np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    arm = ArmSignals(columns["position"] + moved, columns["velocity"], columns["effort"])
    said = [str(doubt) for doubt in arm_warnings(TIME, arm, MAPPING, MODEL)]
    assert any("signals.position.offset: [0, -1.5708, 0, -1.5708, 0, 0, 0]" in one for one in said), said
    assert not any("torque.factor" in one for one in said)


@pytest.mark.parametrize("joint", range(7))
def test_the_sign_of_a_velocity_is_named(joint: int) -> None:
    (doubt,) = doubts({"velocity": (joint, -1.0)})
    remedy = ", ".join("-1" if number == joint else "1" for number in range(7))
    assert doubt.startswith(f"velocity of joint {joint + 1} is -1 times")
    assert doubt.endswith(f"signals.velocity.factor: [{remedy}]")


def test_a_sensor_that_is_off_in_every_run_is_one_remark_with_the_median_as_remedy() -> None:
    """A velocity 1.19 to 1.25 times what it should be, in sixteen recordings."""
    columns, factors = swung(), np.linspace(1.19, 1.25, 16)
    remarks = []
    for run, factor in enumerate(factors):
        speed = columns["velocity"] * np.where(np.arange(7) == 2, factor, 1.0)
        arm = ArmSignals(columns["position"], speed, columns["effort"])
        remarks += [(f"run_{run}", remark) for remark in arm_warnings(TIME, arm, MAPPING, MODEL)]
    assert len({remark for _, remark in remarks}) == 16
    (one,) = merged(remarks)
    assert one.startswith("16 runs: velocity of joint 3 is 1.19 to 1.25 times the derivative of its position")
    assert one.endswith(f"signals.velocity.factor: [1, 1, {np.median(1.0 / factors):.3g}, 1, 1, 1, 1]")


def test_degrees_per_second_are_named() -> None:
    (doubt,) = doubts({"velocity": (2, 180.0 / np.pi)})
    assert "57.3 times the derivative" in doubt and "0.0175" in doubt


def test_velocities_of_two_joints_in_each_other_s_column_are_named() -> None:
    """Also beside the steps of an encoder, which alone raise no doubt."""
    columns = swung()
    coarse = np.round(columns["position"] / 1e-3) * 1e-3
    mixed = columns["velocity"][:, [0, 1, 5, 3, 4, 2, 6]]
    assert arm_warnings(TIME, ArmSignals(coarse, columns["velocity"], columns["effort"]), MAPPING, MODEL) == []
    (doubt,) = arm_warnings(TIME, ArmSignals(coarse, mixed, columns["effort"]), MAPPING, MODEL)
    assert re.fullmatch(r"velocity of joint 3 \(.*\), of joint 6 \(.*\) is not .*: columns of other joints\?", doubt)


def older(values: np.ndarray, seconds: float) -> np.ndarray:
    """A signal as it was some time before."""
    return np.column_stack([np.interp(TIME - seconds, TIME, column) for column in values.T])


def said_of(position: np.ndarray, velocity: np.ndarray, torque: np.ndarray) -> list[str]:
    return arm_warnings(TIME, ArmSignals(position, velocity, torque), MAPPING, MODEL)


@pytest.mark.parametrize("factor", [1.28, 0.8])
def test_a_velocity_that_is_a_quarter_off_is_named_with_its_joint_and_size(factor: float) -> None:
    """0.50 rad/s recorded where positions say 0.39."""
    (doubt,) = doubts({"velocity": (2, factor)})
    assert doubt.startswith(f"velocity of joint 3 is {factor:g} times the derivative of its position (+- ")
    assert doubt.endswith(f"signals.velocity.factor: [1, 1, {1.0 / factor:.3g}, 1, 1, 1, 1]")


def test_a_velocity_that_is_a_little_off_is_a_low_pass() -> None:
    assert doubts({"velocity": (2, 0.95)}) == []


@pytest.mark.parametrize("lag", [0.04, -0.03])
def test_velocities_of_another_age_are_named_with_their_lag(lag: float) -> None:
    columns = swung()
    (doubt,) = said_of(columns["position"], older(columns["velocity"], lag), columns["effort"])
    assert f"velocities are {1e3 * abs(lag):.0f} ms (+- " in doubt
    assert float(doubt.rpartition("signals.velocity.delay: ")[2]) == pytest.approx(-lag, abs=1e-3)


@pytest.mark.parametrize(("lag", "friction"), [(0.04, 0.0), (0.04, 3.0), (-0.03, 1.0)])
def test_torques_of_another_age_are_named_with_their_lag(lag: float, friction: float) -> None:
    columns = swung(friction)
    noise = 0.1 * np.random.default_rng(0).standard_normal(columns["effort"].shape)
    (doubt,) = said_of(columns["position"], columns["velocity"], older(columns["effort"], lag) + noise)
    assert doubt.startswith("torques are ") and ("behind" in doubt) == (lag > 0.0)
    assert float(doubt.rpartition("signals.torque.delay: ")[2]) == pytest.approx(-lag, abs=3e-3)


@pytest.mark.parametrize("inertia", [0.3, 1.0])
def test_the_inertia_of_motors_is_no_lag(inertia: float) -> None:
    """A torque that was measured behind it seems 5 to 18 ms ahead of what the links take; beside it a lag is seen."""
    columns = swung()
    torque = columns["effort"] + inertia * np.gradient(columns["velocity"], TIME, axis=0)
    assert said_of(columns["position"], columns["velocity"], torque) == []
    (doubt,) = said_of(columns["position"], columns["velocity"], older(torque, -0.03))
    assert float(doubt.rpartition("signals.torque.delay: ")[2]) == pytest.approx(0.03, abs=3e-3)


def doubts_of_light_arm(folder: Path, effects: dict[str, dict[str, float]], factor: float = 1.0) -> list[str]:
    """Of an arm of three links of 0.4 kg; the torque of the first joint times a factor."""
    mapping = mapping_of(folder, lighter(slender_arm(("revolute",) * 3), 0.2))
    columns = slender_swung(mapping, effects)
    columns["effort"][:, 0] *= factor
    arm = ArmSignals(columns["position"], columns["velocity"], columns["effort"])
    return arm_warnings(columns["time"], arm, mapping, RobotModel(mapping.facts, mapping.end_effector.build()))


def test_a_heavy_load_is_no_factor_of_the_torque(tmp_path: Path) -> None:
    """Factors of 0.39, 0.29 and 0.16 would hide it, and give a gain of the torque later."""
    friction = {"coulomb_joint1": 0.3}
    load = {"end_effector_payload": {"mass": 0.926, "com_z": 0.05}, "joint_coulomb_friction": friction}
    (doubt,) = doubts_of_light_arm(tmp_path, load)
    assert doubt.startswith("torques hold 0.92 kg more at the end effector than the mapping says")
    assert "factor:" not in doubt and "Remedy in the mapping: end_effector" in doubt


def test_a_factor_of_one_joint_is_no_load(tmp_path: Path) -> None:
    (doubt,) = doubts_of_light_arm(tmp_path, {}, 2.5)
    assert doubt.startswith("torque of joint 1 is 2.5 times the gravity torque")
    assert doubt.endswith("signals.torque.factor: [0.401, 1, 1]")


@pytest.mark.parametrize("signals", [("position", "velocity", "effort"), ("velocity",)])
def test_rows_that_are_repeated_are_named_with_the_true_rate(signals: tuple[str, ...]) -> None:
    columns = swung()
    held = 3 * (np.arange(TIME.size) // 3)
    for name in signals:
        columns[name] = columns[name][held]
    found = said_of(columns["position"], columns["velocity"], columns["effort"])
    (doubt,) = (text for text in found if " behind " not in text)  # numbers that are held are late as well
    assert doubt.startswith(f"{', '.join('torque' if name == 'effort' else name for name in signals)} of all joints")
    assert "every number occurs 3 times, as if measured at 66.7 Hz and written at 200 Hz" in doubt


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_single_rows_that_are_repeated_are_said(share: float) -> None:
    """A writer that now and then finds no new sample and writes the last one again."""
    columns = swung()
    rows = np.arange(TIME.size)
    rows = rows - (np.random.default_rng(0).uniform(size=rows.size) < share) * (rows > 0)
    found = said_of(*(columns[name][rows] for name in ("position", "velocity", "effort")))
    (doubt,) = (text for text in found if " behind " not in text)
    assert doubt.startswith("position, velocity, torque of all joints stay the same in ")
    assert float(doubt.split("same in ")[1].split()[0]) == pytest.approx(100.0 * share, rel=0.2)


@pytest.mark.parametrize("step", [1e-5, 1e-4, 1e-3])
def test_encoders_noise_and_rests_are_no_repeats_lags_or_factors(step: float) -> None:
    """Every joint rests for a quarter of the time; noise of 10 mrad/s and 0.5 N m."""
    rng, columns = np.random.default_rng(1), swung()
    still = np.clip(np.arange(TIME.size), 0, round(0.75 * TIME.size))
    position = np.round(columns["position"][still] / step) * step
    moving = (still < still[-1])[:, None]
    velocity = columns["velocity"][still] * moving + 0.01 * rng.standard_normal(position.shape)
    assert said_of(position, velocity, columns["effort"][still] + 0.5 * rng.standard_normal(position.shape)) == []


def test_in_contact_torques_say_nothing_of_weight_and_friction() -> None:
    columns = swung()
    arm = ArmSignals(columns["position"], -columns["velocity"], -columns["effort"])
    (doubt,) = arm_warnings(TIME, arm, MAPPING, MODEL, contact=True)
    assert doubt.startswith("velocity") and doubt.endswith("signals.velocity.factor: -1")


@pytest.mark.parametrize(("joint", "words"), [(1, "gravity torque"), (3, "gravity torque"), (0, "against its motion")])
def test_the_sign_of_a_torque_is_named_by_gravity_or_friction(joint: int, words: str) -> None:
    (doubt,) = doubts({"effort": (joint, -1.0)})
    assert doubt.startswith(f"torque of joint {joint + 1}") and words in doubt


def test_the_remedy_puts_the_recording_right(tmp_path: Path) -> None:
    columns = swung()
    columns["velocity"] = columns["velocity"] * np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    path = write_npz(tmp_path / "a.npz", columns)
    (run,) = read_recordings(path, MAPPING)
    assert any("signals.velocity.factor: [1, 1, -1, 1, 1, 1, 1]" in remark for remark in run.remarks)
    source = MAPPING.signals["velocity"].model_copy(update={"factor": (1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0)})
    (run,) = read_recordings(path, MAPPING.model_copy(update={"signals": {**MAPPING.signals, "velocity": source}}))
    assert run.remarks == ()


@pytest.mark.slow
@pytest.mark.parametrize("bench", ["bench_0", "bench_1", "bench_2"])
def test_recordings_of_another_laboratory_raise_no_doubt(bench: str) -> None:
    runs, _ = read_laboratory(measured_data("lab", bench), Experiment(scenario="push"), map)
    assert [remark for run in runs for remark in run.remarks if "factor" in remark] == []
    free = next(run for run in runs if not run.hit)
    arm = free.signals.arms["arm"]
    wrong = replace(arm, torque=arm.torque * np.where(np.arange(7) == 3, -1.0, 1.0))
    assert arm_warnings(free.signals.time, wrong, MAPPING, free.physics.robot_model("arm"))
