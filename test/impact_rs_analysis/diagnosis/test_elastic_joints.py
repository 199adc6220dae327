# SPDX-License-Identifier: Apache-2.0
"""A transmission that yields: found with its motor where the motor has an encoder, and said where it has none.

The joint turns about a vertical axis, so all signals are sums of sines in closed form: tau_J = J ddq,
theta = q + tau_J / K, and the motor takes B ddtheta and its friction.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import Columns, write_npz
from measured_data import measured_data
from slender_arm import FLAT, LENGTH, mapping_of, slender_arm

from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import read_recordings

LINK = 2.0 * (LENGTH / 2.0) ** 2 + 0.03  # kg m^2, about the axis
MOTOR, STIFFNESS = 0.08, 100.0  # kg m^2, N m/rad: it resonates at 4.8 Hz behind a motor that is held
COULOMB, VISCOUS = 0.35, 0.3  # N m, N m s/rad
NOISE = 0.02  # N m
EFFECTS = ["joint_elasticity", "added_motor_inertia", "joint_coulomb_friction", "joint_viscous_friction"]
CONSIDERED = [*EFFECTS, "torque_delay", "torque_offset", "link_inertia", "end_effector_payload"]


def elastic(ratio: float = 1.0) -> Columns:
    """30 s at 200 Hz; positions of the motor before a gear of some ratio."""
    time = np.arange(0.0, 30.0, 0.005)[:, None]
    rates = 2.0 * np.pi * np.array([0.21, 0.53, 0.97, 1.43])  # rad/s
    sizes, phases = np.array([0.6, 0.3, 0.15, 0.1]), np.arange(4.0)

    def derivative(order: int) -> np.ndarray:
        return np.asarray(np.sum(sizes * rates**order * np.sin(rates * time + phases + order * np.pi / 2.0), axis=1))

    def of_motor(order: int) -> np.ndarray:
        return derivative(order) + LINK * derivative(order + 2) / STIFFNESS

    friction = COULOMB * np.tanh(of_motor(1) / 0.005) + VISCOUS * of_motor(1)
    torque = LINK * derivative(2) + MOTOR * of_motor(2) + friction
    torque += np.random.default_rng(0).normal(0.0, NOISE, torque.size)
    found = {"position": derivative(0), "velocity": derivative(1), "effort": torque, "motor": ratio * of_motor(0)}
    return {"time": time[:, 0]} | {name: values[:, None] for name, values in found.items()}


def source_of(folder: Path, encoder: bool, ratio: float = 1.0) -> RecordingSource:
    mapping = mapping_of(folder, slender_arm(("revolute",), FLAT), torque_measured_at="motor")
    if encoder:
        place = mapping.signals["position"].model_copy(update={"array": "motor"})
        mapping = mapping.model_copy(update={"signals": mapping.signals | {"motor_position": place}})
    write_npz(folder / "run.npz", elastic(ratio))
    return RecordingSource.of(read_recordings(folder / "run.npz", mapping), mapping, Model(name="nominal"))


def holds(found: DiagnosisDocument, name: str, parameter: str, true: float, share: float, off: float = 1e-3) -> bool:
    """Whether the interval of a parameter holds a value, and is narrow enough.

    Args:
        found: The diagnosis.
        name: Of the effect.
        parameter: Of the effect.
        true: The value.
        share: Largest width over the value.
        off: Numerical error over the value; dry friction jumps between the samples of the low-passed velocity.
    """
    effect = found.effect(name)
    assert effect is not None
    low, high = effect.parameters[parameter].interval
    return low - off * true <= true <= high + off * true and high - low < share * true


def test_stiffness_motor_and_friction_are_found_with_an_encoder_at_the_motor(tmp_path: Path) -> None:
    source = source_of(tmp_path, encoder=True)
    found = diagnose(source, source.model, CONSIDERED)
    assert set(found.named) == set(EFFECTS)
    assert holds(found, "joint_elasticity", "compliance_joint1", 1.0 / STIFFNESS, 0.02)
    assert holds(found, "added_motor_inertia", "inertia_joint1", MOTOR, 0.2)
    assert holds(found, "joint_coulomb_friction", "coulomb_joint1", COULOMB, 0.2, 0.02)
    assert holds(found, "joint_viscous_friction", "viscous_joint1", VISCOUS, 0.2, 0.02)
    assert any("deflection of the transmission is a signal of its own" in remark for remark in found.remarks)


def test_without_that_encoder_a_resemblance_to_delay_and_inertia_is_said(tmp_path: Path) -> None:
    source = source_of(tmp_path, encoder=False)
    assert source.size() == pytest.approx(source_of(tmp_path, encoder=True).size(), rel=1e-6)  # of the torques
    (said,) = (remark for remark in source.remarks if "no motor has an encoder" in remark)
    assert "resembles a delay" in said and "signals.motor_position" in said


def test_a_position_before_the_gear_is_not_used_and_said(tmp_path: Path) -> None:
    source = source_of(tmp_path, encoder=True, ratio=100.0)
    assert source.balance.elastic.size == 0
    assert any("joint 1 99.3 times" in remark and "divided by the gear ratio" in remark for remark in source.remarks)


def test_both_signals_of_a_joint_are_compared_in_their_units(tmp_path: Path) -> None:
    rows = compare(source_of(tmp_path, encoder=True)).levels["recording"].signals
    assert [(row.signal, row.index, row.unit) for row in rows] == [
        ("torque", "joint1", "N m"),
        ("deflection", "joint1", "rad"),
    ]
    assert all(row.times_noise > 20.0 for row in rows)


def test_a_harmonic_drive_that_resonates_is_not_taken_for_damping_and_delay(tmp_path: Path) -> None:
    """A chirp through the resonance, most of it above the low-pass; K is 7 Hz with 0.05 kg m^2."""
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "mapping.yaml").write_text(MAPPING)
    mapping = load_mapping(tmp_path / "mapping.yaml")
    path = measured_data("cases", "harmonic_drive_resonance", "chirp_with_motor_encoder.csv")
    source = RecordingSource.of(read_recordings(path, mapping), mapping, Model(name="nominal"))
    assert np.all(source.balance.noise < [0.02, 2e-5])
    found = diagnose(source, source.model, CONSIDERED)
    assert set(found.named) == set(EFFECTS)
    assert holds(found, "joint_elasticity", "compliance_joint1", 1.0 / (0.05 * (2.0 * np.pi * 7.0) ** 2), 0.01)
    assert holds(found, "added_motor_inertia", "inertia_joint1", 0.08, 0.05)
    assert holds(found, "joint_coulomb_friction", "coulomb_joint1", 0.35, 1.5)
    assert holds(found, "joint_viscous_friction", "viscous_joint1", 0.12, 0.6)


ROBOT = """\
source: joint.urdf
joint_torque_loop: false
joints: [{xyz: [0, 0, 0], rpy: [0, 0, 0]}]
flange: {xyz: [0, 0, 0]}
limits: {position_min_rad: [-3], position_max_rad: [3], velocity_rad_s: [20], torque_Nm: [60]}
links: [{mass: 2, com: [0, 0, 0.05], inertia: [0.02, 0, 0, 0.02, 0, 0.05]}]
"""
MAPPING = """\
description: a harmonic drive
robot: robot.yaml
joints: [joint1]
torque_measured_at: motor
time: {column: time, unit: s}
signals:
  position: {column: joint_pos, unit: rad}
  velocity: {column: joint_vel, unit: rad/s}
  torque: {column: motor_torque, unit: N m}
  motor_position: {column: motor_pos, unit: rad}
"""
