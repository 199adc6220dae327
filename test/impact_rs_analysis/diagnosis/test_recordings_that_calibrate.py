# SPDX-License-Identifier: Apache-2.0
"""Recordings calibrate an arm: links, motors, gears that yield, torque constants and clocks, each planted and found.

Arms of few joints and a cart among them: friction in its unit, and no payload that is none. A gear that yields turns
about a vertical axis, so its signals are sums of sines in closed form: tau_J = J ddq, theta = q + tau_J / K, and the
motor takes B ddtheta and its friction.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from intervals import assert_covers
from joint_recordings import Columns, write_npz
from measured_data import measured_data
from slender_arm import FLAT, LENGTH, UPRIGHT, lighter, mapping_of, slender_arm, swung

from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.effects import library, of_trials
from impact_rs_sim.model import Model
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import JointType
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.recording import read_recordings

FRICTION = {"joint_coulomb_friction": {f"coulomb_joint{joint}": 0.8 / joint for joint in (1, 2, 3)}}  # N m
CONSIDERED = (  # all that are fast
    "joint_coulomb_friction",
    "joint_viscous_friction",
    "torque_offset",
    "torque_gain",
    "end_effector_payload",
    "link_mass",
    "link_com",
    "link_inertia",
    "added_motor_inertia",
    "torque_delay",
)
HALF_WIDTHS = {  # of what is planted, most of it for the scale of the torque
    "scale_joint2": 0.1, "com_x_joint1": 0.035, "com_y_joint3": 0.00046, "inertia_joint2": 0.0135, "delay": 0.00093
}  # fmt: skip
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2


def diagnosed(folder: Path, mapping: Mapping, planted: dict[str, dict[str, float]]) -> DiagnosisDocument:
    write_npz(folder / "run.npz", swung(mapping, FRICTION | planted))
    source = RecordingSource.of(read_recordings(folder / "run.npz", mapping), mapping, Model(name="nominal"))
    return diagnose(source, source.model, CONSIDERED)


def effect(found: DiagnosisDocument, name: str) -> EffectDocument:
    entry = found.effect(name)
    assert entry is not None
    return entry


@pytest.mark.parametrize(
    "planted",
    [
        {"link_com": {"com_x_joint1": -0.03, "com_y_joint3": 0.04}},
        *(
            pytest.param(planted, marks=pytest.mark.slow)
            for planted in (
                {"link_mass": {"scale_joint2": 1.25}},
                {"link_inertia": {"inertia_joint2": 0.1}},
                {"torque_delay": {"delay": -0.012}},
            )
        ),
    ],
)
def test_what_is_planted_in_an_upright_arm_is_named_and_its_interval_holds(
    planted: dict[str, dict[str, float]], tmp_path: Path
) -> None:
    found = diagnosed(tmp_path, mapping_of(tmp_path, slender_arm(("revolute",) * 3)), planted)
    ((name, values),) = planted.items()
    assert set(found.named) == {"joint_coulomb_friction", name}
    for key, value in values.items():
        estimate = effect(found, name).parameters[key]
        assert_covers(estimate.interval, value, HALF_WIDTHS[key])


def test_centres_that_no_torque_feels_are_not_determined(tmp_path: Path) -> None:
    """On vertical axes nothing weighs: of the first link the moment alone is felt, wherever its centre lies."""
    facts = slender_arm(("revolute",) * 3, FLAT)
    found = diagnosed(tmp_path, mapping_of(tmp_path, facts), {})
    assert found.named == ("joint_coulomb_friction",)
    centre, moment = effect(found, "link_com").parameters["com_y_joint1"], effect(found, "link_inertia").parameters
    reach = Proportion.of_robots([facts], GRAVITY).length
    bound = reach * library()["link_com"].parameters[1].upper
    assert centre.interval == pytest.approx((-bound, bound))
    low, high = moment["inertia_joint1"].interval
    assert low <= 0.0 <= high and high - low < 0.1  # kg m^2, most of it for the scale of the torque


@pytest.mark.slow
def test_motor_inertia_and_torque_constants_are_found_from_currents(tmp_path: Path) -> None:
    constants = [20.0, 10.0, 5.0]  # N m/A
    mapping = mapping_of(
        tmp_path,
        slender_arm(("revolute",) * 3),
        {"unit": "A"},
        torque_measured_at="motor",
        torque_constant=constants,
    )
    planted = {"added_motor_inertia": {"inertia_joint1": 0.5, "inertia_joint2": 0.3, "inertia_joint3": 0.1}}
    columns = swung(mapping, FRICTION | planted | {"torque_gain": {"gain_joint2": 0.85}})
    write_npz(tmp_path / "run.npz", columns | {"effort": columns["effort"] / np.array(constants)})
    source = RecordingSource.of(read_recordings(tmp_path / "run.npz", mapping), mapping, Model(name="nominal"))
    found = diagnose(source, source.model, CONSIDERED)
    assert set(found.named) == {"joint_coulomb_friction", "added_motor_inertia", "torque_gain"}
    for joint, value in ((1, 0.5), (2, 0.3), (3, 0.1)):
        assert effect(found, "added_motor_inertia").parameters[f"inertia_joint{joint}"].estimate == pytest.approx(
            value, rel=0.15
        )
    assert_covers(effect(found, "torque_gain").parameters["gain_joint2"].interval, 0.85, 5e-5)


def test_what_calibrates_an_arm_is_no_candidate_in_trials() -> None:
    calibrating = {name for name, effect in library().items() if effect.calibrates}
    links = {"link_mass", "link_com", "link_inertia"}
    shafts = {"joint_sum_friction", "joint_difference_friction"}
    motors = {"added_motor_inertia", "joint_elasticity", "joint_reversal_width"}
    assert calibrating == links | shafts | motors | {"torque_delay"}
    assert not calibrating & set(of_trials())


NOISE = 0.02  # N m, N
WIDTHS = {"planar": 0.08, "pendulum": 0.09, "cart": 0.04}  # kg, half of the interval of a payload

ARMS: dict[str, tuple[tuple[JointType, ...], tuple[float, ...], tuple[float, ...]]] = {
    # joints, rpy of the first, friction that is planted [N m, N]
    "planar": (("revolute",) * 3, FLAT, (0.6, 0.4, 0.2)),
    "upright": (("revolute",) * 3, UPRIGHT, (0.8, 0.5, 0.3)),
    "pendulum": (("revolute",) * 2, UPRIGHT, (0.6, 0.3)),
    "cart": (("prismatic", "revolute"), UPRIGHT, (12.0, 0.3)),
}


def of_arm(folder: Path, name: str, payload: float = 0.0) -> DiagnosisDocument:
    """Diagnosis of a recording in which every joint swings at its own frequencies."""
    kinds, rpy, coulomb = ARMS[name]
    exact = {"link_deviation": 0.01}  # a load on links that may be 10 % off could be an error of theirs
    mapping = mapping_of(folder, slender_arm(kinds, rpy).model_copy(update=exact))
    friction = {f"coulomb_joint{joint}": value for joint, value in enumerate(coulomb, start=1)}
    effects = {"joint_coulomb_friction": friction, "end_effector_payload": {"mass": payload, "com_z": 0.0}}
    write_npz(folder / "run.npz", swung(mapping, effects, NOISE))
    source = RecordingSource.of(read_recordings(folder / "run.npz", mapping), mapping, Model(name="nominal"))
    return diagnose(source, source.model)


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "payload"),
    [
        ("cart", 0.7),
        *(pytest.param(name, 0.0, marks=SLOW) for name in ARMS),
        pytest.param("planar", 0.3, marks=SLOW),
        pytest.param("pendulum", 0.3, marks=SLOW),
    ],
)
def test_friction_is_found_in_its_joint_s_unit_and_a_payload_where_there_is_one(
    name: str, payload: float, tmp_path: Path
) -> None:
    found = of_arm(tmp_path, name, payload)
    assert set(found.named) == {"joint_coulomb_friction", *(["end_effector_payload"] if payload else [])}
    effects = {effect.name: effect for effect in found.effects}
    kinds, _, planted = ARMS[name]
    for joint, (kind, true) in enumerate(zip(kinds, planted, strict=True), start=1):
        value = effects["joint_coulomb_friction"].parameters[f"coulomb_joint{joint}"]
        assert value.unit == ("N" if kind == "prismatic" else "N m")
        assert value.estimate == pytest.approx(true, abs=0.05, rel=0.05)
    assert [row.unit for row in found.joints] == ["N" if kind == "prismatic" else "N m" for kind in kinds]
    mass = effects["end_effector_payload"]
    assert (str(mass.verdict) == "CONFIRMED") == bool(payload)
    if payload:
        assert_covers(mass.parameters["mass"].interval, payload, WIDTHS[name])


@pytest.mark.parametrize(
    ("links", "inertia", "coulomb"),
    [
        (0.01, 0.5, 2.0),
        pytest.param(0.01, 0.0269, 0.3, marks=SLOW),
        pytest.param(0.001, 0.0269, 1.0, marks=SLOW),
    ],
)
def test_drives_that_are_large_beside_light_links_are_measured_as_others(
    links: float, inertia: float, coulomb: float, tmp_path: Path
) -> None:
    """The weight of a small robot is no scale of its gears: neither range, nor prior, nor width follows from it."""
    mapping = mapping_of(tmp_path, lighter(slender_arm(("revolute",) * 2), links), torque_measured_at="motor")
    planted = {
        "joint_coulomb_friction": {"coulomb_joint1": coulomb, "coulomb_joint2": coulomb / 2.0},
        "added_motor_inertia": {"inertia_joint1": inertia, "inertia_joint2": inertia / 2.0},
    }
    write_npz(tmp_path / "run.npz", swung(mapping, planted, 0.002 * coulomb))
    source = RecordingSource.of(read_recordings(tmp_path / "run.npz", mapping), mapping, Model(name="nominal"))
    considered = [*planted, "joint_viscous_friction", "torque_offset", "torque_delay", "end_effector_payload"]
    found = diagnose(source, source.model, considered)
    assert set(found.named) == set(planted)
    effects = {effect.name: effect for effect in found.effects}
    for name, values in planted.items():
        assert str(effects[name].verdict) == "CONFIRMED"
        for key, true in values.items():
            estimate = effects[name].parameters[key]
            low, high = estimate.interval
            assert low - 0.002 * true <= true <= high + 0.002 * true and high - low < 0.2 * true


def seldom_moved(folder: Path, noise: float = NOISE) -> RecordingSource:
    """A pendulum of two joints with viscous friction; the second turns for 4 of 36 s."""
    mapping = mapping_of(folder, slender_arm(("revolute",) * 2))
    time = np.arange(0.0, 36.0, 0.02)
    often = np.sin(2.0 * np.pi * 0.31 * time) + 0.4 * np.sin(2.0 * np.pi * 0.73 * time)
    seldom = np.where((time > 16.0) & (time < 20.0), np.sin(2.0 * np.pi * 0.5 * (time - 16.0)) ** 3, 0.0)
    q = np.column_stack((0.5 * often, 0.6 * seldom))
    dq = np.gradient(q, time, axis=0)
    ddq = np.gradient(dq, time, axis=0)
    model = RobotModel(mapping.facts, mapping.end_effector.build())
    torque = np.array([model.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)]) + 0.95 * dq
    torque += np.random.default_rng(4).normal(0.0, noise, torque.shape)
    write_npz(folder / "run.npz", {"time": time, "position": q, "velocity": dq, "effort": torque})
    return RecordingSource.of(read_recordings(folder / "run.npz", mapping), mapping, Model(name="nominal"))


def test_the_p_of_a_joint_that_moves_seldom_agrees_with_its_interval(tmp_path: Path) -> None:
    """Signs of the few stretches in which it moves decide nothing, and the friction in them is known to 10 %."""
    source = seldom_moved(tmp_path)
    found = diagnose(source, source.model, ["joint_viscous_friction"])
    (effect,) = found.effects
    often, seldom = (effect.parameters[f"viscous_joint{joint}"] for joint in (1, 2))
    for own in (often, seldom):
        assert_covers(own.interval, 0.95, 0.01 if own is often else 0.02)
        assert str(own.verdict) == "CONFIRMED" and own.p_value is not None and own.p_value < 0.01
    assert often.interval[1] - often.interval[0] < seldom.interval[1] - seldom.interval[0] < 0.5


def test_few_stretches_have_few_degrees_of_freedom(tmp_path: Path) -> None:
    source = seldom_moved(tmp_path)
    fit = Search(effects_for(source, ["joint_viscous_friction"]), Evidence.of(source)).fit_alone(
        "joint_viscous_friction"
    )
    null, inverse = fit.evidence.null, np.linalg.inv(fit.problem.total)
    often, seldom = null.freedoms(fit.candidate.jacobians, inverse)
    assert 10.0 < often < len(source.clusters) - 1 and 1.0 <= seldom < 8.0


def test_stretches_of_a_recording_say_about_as_much(tmp_path: Path) -> None:
    """Of a motion that ends after a third of the recording, most stretches are in that third, and none is too short."""
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 2))
    columns = swung(mapping, {}, NOISE)
    still = np.minimum(np.arange(1800), 600)
    held = columns | {"position": columns["position"][still], "velocity": columns["velocity"][still]}
    held["velocity"][600:] = 0.0
    write_npz(tmp_path / "run.npz", held | {"effort": columns["effort"][still]})
    source = RecordingSource.of(read_recordings(tmp_path / "run.npz", mapping), mapping, Model(name="nominal"))
    ends = [float(item.name.split()[3]) for item in source.clusters]
    starts = [float(item.name.split()[1]) for item in source.clusters]
    assert sum(end <= 12.5 for end in ends) >= 0.6 * len(ends)
    assert min(end - start for start, end in zip(starts, ends, strict=True)) >= 0.4


LINK = 2.0 * (LENGTH / 2.0) ** 2 + 0.03  # kg m^2, about the axis
MOTOR, STIFFNESS = 0.08, 100.0  # kg m^2, N m/rad: it resonates at 4.8 Hz behind a motor that is held
COULOMB, VISCOUS = 0.35, 0.3  # N m, N m s/rad
DRIVE_NOISE = 0.02  # N m
EFFECTS = ["joint_elasticity", "added_motor_inertia", "joint_coulomb_friction", "joint_viscous_friction"]
OF_DRIVES = [*EFFECTS, "torque_delay", "torque_offset", "link_inertia", "end_effector_payload"]


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
    torque += np.random.default_rng(0).normal(0.0, DRIVE_NOISE, torque.size)
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
    found = diagnose(source, source.model, [*EFFECTS, "torque_delay", "torque_offset"])
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


@pytest.mark.slow
def test_a_harmonic_drive_that_resonates_is_not_taken_for_damping_and_delay(tmp_path: Path) -> None:
    """A chirp through the resonance, most of it above the low-pass; K is 7 Hz with 0.05 kg m^2."""
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "mapping.yaml").write_text(MAPPING)
    mapping = load_mapping(tmp_path / "mapping.yaml")
    path = measured_data("cases", "harmonic_drive_resonance", "chirp_with_motor_encoder.csv")
    source = RecordingSource.of(read_recordings(path, mapping), mapping, Model(name="nominal"))
    assert np.all(source.balance.noise < [0.02, 2e-5])
    found = diagnose(source, source.model, OF_DRIVES)
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
