# SPDX-License-Identifier: Apache-2.0
"""Arms of the twin that touch nothing move as Pinocchio and the drive in Python say, and as Bullet does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Load, LoadState, Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState
from impact_rs_sim.twin import Result, TwinJob, simulate

PERIOD, SUBSTEPS, TICKS = 0.00025, 4, 100
FAR = BodyState(np.array([5.0, 5.0, 0.485]), np.eye(3), np.zeros(6))
close = partial(np.testing.assert_allclose, atol=1e-10, rtol=1e-10)


@pytest.fixture(scope="module")
def physics() -> Physics:
    return Physics.nominal(load_scenario("push"), "juice")


@dataclass(frozen=True)
class Stretch:
    """State of an arm at ``time`` [s], and its driving torque in every period of the torque loop, ``(s, n)`` [N m]."""

    arm: ArmState
    drive: DriveStart
    torque: Array
    time: float


def stretch(physics: Physics, seed: int = 0) -> Stretch:
    """An arm in some state, pulled by a torque that changes in every period."""
    rng = np.random.default_rng(seed)
    q = np.array([-0.3, -0.3, 0.5, -2.3, -1.3, 1.4, -0.7]) + 0.1 * rng.standard_normal(7)
    load = physics.robot_model("arm").gravity_torque(q)
    start = DriveStart(load + rng.standard_normal(7), 20.0 * rng.standard_normal(7))
    torque = load + np.cumsum(0.3 * rng.standard_normal((SUBSTEPS * TICKS, 7)), axis=0)
    return Stretch(ArmState(q, 0.3 * rng.standard_normal(7)), start, torque, 0.2)


def job(physics: Physics, one: Stretch, joint_torque: bool = False) -> TwinJob:
    periods = len(one.torque)
    return TwinJob(
        physics,
        {"arm": one.arm},
        {"arm": one.drive},
        {"arm": one.torque},
        {"arm": np.arange(periods, dtype=np.int32)},
        one.time + np.arange(periods // SUBSTEPS + 1) * (PERIOD * SUBSTEPS),
        PERIOD,
        joint_torque=joint_torque,
    )


def stepped(physics: Physics, one: Stretch, joint_torque: bool = False) -> ArmMotion:
    """The same motion by Pinocchio's accelerations and :class:`Drive`, or tau_J + D K^-1 dtau_J, step by step."""
    model, arm = physics.robot_model("arm"), physics.arms["arm"]
    drive, q, dq = Drive(arm, PERIOD), one.arm.position, one.arm.velocity
    drive.start(one.arm, one.drive)
    tau, rate = one.drive.torque, one.drive.torque_rate
    rows, memory = [], Memory()
    for number, torque in enumerate(one.torque):
        if number % SUBSTEPS == 0:
            time = one.time + number * PERIOD
            state = (tau, q + tau / arm.stiffness, dq + rate / arm.stiffness)
            rows.append((q, dq, *(state if joint_torque else (drive.elastic_torque, drive.position, drive.velocity))))
            on_links, on_motors = physics.load_torques("arm", model, time, q, dq, memory=memory)
            drive.load(on_motors)
        if joint_torque:
            rate, tau = (torque - tau) / PERIOD, torque
            passed = tau + arm.damping / arm.stiffness * rate
        else:
            passed = drive.transmission_torque
            drive.step(torque)
        dq = dq + PERIOD * pin.aba(model.pinocchio, model.data, q, dq, passed + on_links)
        q = q + PERIOD * dq
        drive.sense(q, dq)
    return ArmMotion(*np.swapaxes(np.array(rows), 0, 1))


def same(path: ArmMotion, other: ArmMotion) -> None:
    ticks = len(other.position)
    close(path.position[:ticks], other.position)
    close(path.velocity[:ticks], other.velocity)
    np.testing.assert_allclose(path.torque[:ticks], other.torque, atol=1e-7)  # 1e-11 rad at 1e4 N m/rad
    close(path.motor_position[:ticks], other.motor_position)
    close(path.motor_velocity[:ticks], other.motor_velocity)


def alone(job: TwinJob) -> Result:
    (result,) = simulate([job])
    assert not result.failure and not result.failed
    return result


@pytest.mark.parametrize("joint_torque", [False, True])
@pytest.mark.parametrize(
    ("effect", "vector"),
    [
        ("friction, gain and offset", None),
        ("motor_inertia_scale", (1.4,)),
        ("joint_stiffness", (0.7,)),
        ("end_effector_payload", (0.4, 0.02, 0.0, -0.05)),
        ("base_tilt", (0.03, -0.02)),
        ("external_spring", (4.0, -2.0, 3.0, 30.0)),
    ],
)
def test_free_motion_is_that_of_pinocchio(
    physics: Physics, joint_torque: bool, effect: str, vector: tuple[float, ...] | None
) -> None:
    if vector is None:
        arm = physics.arms["arm"]
        rubs = replace(arm.friction, coulomb=np.full(7, 0.4), viscous=np.full(7, 0.2), stribeck=np.full(7, 0.3))
        gain, offset = np.linspace(0.9, 1.1, 7), np.linspace(-0.5, 0.4, 7)
        believed = replace(physics, arms={"arm": replace(arm, friction=rubs, torque_gain=gain, torque_offset=offset)})
    else:
        believed = load_model("nominal").known_effects[effect].apply_vector(physics, np.array(vector))
    one = stretch(believed)
    same(alone(job(believed, one, joint_torque)).arms["arm"], stepped(believed, one, joint_torque))


def late(physics: Physics) -> tuple[Physics, Stretch]:
    """Commands that arrive half a millisecond and a bit late: a period has the mean of two."""
    delayed = replace(physics, arms={"arm": replace(physics.arms["arm"], actuation_delay=0.00056)})
    one = stretch(delayed)
    before = ((-0.003, one.drive.torque + 1.0), (-0.0004, one.drive.torque - 2.0))
    return delayed, replace(one, drive=replace(one.drive, earlier=before))


def test_held_commands_arrive_late_as_in_the_drive(physics: Physics) -> None:
    delayed, one = late(physics)
    same(alone(job(delayed, one)).arms["arm"], stepped(delayed, one))


@pytest.mark.parametrize("effect", ["external_spring", "delay"])
def test_bullet_moves_a_free_arm_alike(physics: Physics, effect: str) -> None:
    if effect == "delay":
        believed, one = late(physics)
    else:
        values = np.array([4.0, -2.0, 3.0, 30.0])
        believed = load_model("nominal").known_effects[effect].apply_vector(physics, values)
        one = stretch(believed)
    mechanics = BulletMechanics.load(believed, PERIOD, may_sleep=False)
    held = one.torque[::SUBSTEPS]
    twin = alone(job(believed, replace(one, torque=np.repeat(held, SUBSTEPS, axis=0)))).arms["arm"]
    try:
        mechanics.start({"arm": one.arm}, {"arm": one.drive}, FAR)
        for number, torque in enumerate(held):
            mechanics.step({"arm": torque}, SUBSTEPS, one.time + number * SUBSTEPS * PERIOD)
        motion = mechanics.arm("arm")
    finally:
        mechanics.close()
    np.testing.assert_allclose(twin.position[-1], motion.position, atol=1e-9)
    np.testing.assert_allclose(twin.velocity[-1], motion.velocity, atol=1e-7)
    np.testing.assert_allclose(twin.torque[-1], motion.torque, atol=1e-6)
    np.testing.assert_allclose(twin.motor_velocity[-1], motion.motor_velocity, atol=1e-7)


def formula(**changes: object) -> FormulaEffect:
    described = {
        "name": "cable_drag",
        "sentence": "A cable drags.",
        "joint_torque": {"joint5": "0.2 * sin(3 * q5) * exp(-abs(x - 0.4)) + min(t, 1) ** 2 - max(pi, dq2) / 9"},
        "motor_torque": {"joint2": "-c * tanh(dq2 / 0.02) + 0.1 * sign(q1)"},
        "end_effector_force": {"y": "-drag * vy", "z": "cos(t) * sqrt(abs(z)) + log(1 + x * x) - tan(0.1 * y)"},
        "parameters": {
            "drag": {"unit": "N s/m", "nominal": 0.0, "lower": 0.0, "upper": 50.0, "scale": 1.0},
            "c": {"unit": "N m", "nominal": 0.0, "lower": 0.0, "upper": 3.0, "scale": 0.1},
        },
    }
    return FormulaEffect(FormulaSpec.model_validate(described | changes))


def test_a_formula_acts_as_its_python_form(physics: Physics) -> None:
    believed = formula().apply_vector(physics, np.array([5.0, 0.3]))
    one = stretch(believed)
    same(alone(job(believed, one)).arms["arm"], stepped(believed, one))


def test_a_formula_with_memory_acts_as_its_python_form(physics: Physics) -> None:
    """A Maxwell element, friction of Dahl, and a lag of a lag; two simulations of one physics share nothing."""
    laws = {
        "joint_torque": {"joint5": "-40 * c * (q5 - lag(q5, 0.02)) + lag(lag(x * dq2, 0.01), 0.03, z / 2)"},
        "motor_torque": {"joint2": "-c * lag(sign(dq2), 0.003 / max(abs(dq2), 1e-6))"},
        "end_effector_force": {"y": "-drag * lag(vy, 0.05)"},
    }
    believed = formula(**laws).apply_vector(physics, np.array([20.0, 2.0]))
    one, other = stretch(believed), stretch(believed, 1)
    results = simulate([job(believed, one), job(believed, other), job(believed, one)])
    same(results[0].arms["arm"], stepped(believed, one))
    same(results[1].arms["arm"], stepped(believed, other))
    np.testing.assert_array_equal(results[0].arms["arm"].velocity, results[2].arms["arm"].velocity)
    without = formula(**laws).apply_vector(physics, np.array([0.0, 0.0]))
    away = results[0].arms["arm"].velocity[-1] - alone(job(without, one)).arms["arm"].velocity[-1]
    assert np.max(np.abs(away)) > 0.01


def test_a_window_remembers_what_was_before_it(physics: Physics) -> None:
    """A simulation that begins in the middle of another, with its samples before, goes on as that one."""
    laws = {"joint_torque": {"joint5": "-c * (q5 - lag(q5, 0.05))", "joint1": "lag(t * vx, 0.1)"}}
    believed = formula(**laws, motor_torque={}, end_effector_force={}).apply_vector(physics, np.array([0.0, 900.0]))
    one, middle = stretch(believed), TICKS // 2
    whole = job(believed, one, joint_torque=True)
    path, torque = alone(whole).arms["arm"], one.torque[: SUBSTEPS * middle][-2:]
    rest = Stretch(
        ArmState(path.position[middle], path.velocity[middle]),
        DriveStart(torque[1], (torque[1] - torque[0]) / PERIOD),
        one.torque[SUBSTEPS * middle :],
        whole.time[middle],
    )
    samples = np.column_stack((whole.time, path.position, path.velocity, path.torque))[:middle]
    cut = job(believed, rest, joint_torque=True)
    ends = [alone(replace(cut, before=before)).arms["arm"].velocity[-1] for before in ({"arm": samples}, {})]
    close(ends[0], path.velocity[-1])
    assert np.max(np.abs(ends[1] - path.velocity[-1])) > 1e-3


def test_a_formula_that_blows_up_ends_its_own_job_only(physics: Physics) -> None:
    effect = formula(joint_torque={"joint1": "c * sqrt(0.2045 - t)"}, motor_torque={}, end_effector_force={})
    bad = effect.apply_vector(physics, np.array([0.0, 1.0]))
    one = stretch(physics)
    result, other = simulate([job(bad, one), job(physics, one)])
    assert result.failure == "effect 'cable_drag' blows up at t = 0.205 s"
    assert np.isfinite(result.arms["arm"].position[:5]).all() and np.isnan(result.arms["arm"].position[6:]).all()
    assert not other.failure and np.isfinite(other.arms["arm"].position).all()


@dataclass(frozen=True)
class Magnet(Load):
    """A load of a class of the user's own."""

    def end_effector_force(self, state: LoadState) -> Array | None:
        return 2.0 * np.sin(state.time) * state.velocity + np.array([0.0, 1.0, 0.0])

    def motor_torque(self, state: LoadState) -> Array | None:
        return -0.1 * state.joint_velocity


@dataclass(frozen=True)
class Broken(Load):
    """A load whose Python class fails."""

    def joint_torque(self, state: LoadState) -> Array | None:
        raise InputError("no magnet")


@pytest.mark.parametrize("threads", [1, 3])
def test_a_load_of_a_python_class_acts_as_itself(physics: Physics, threads: int) -> None:
    believed = replace(physics, arms={"arm": replace(physics.arms["arm"], loads=(Magnet(),))})
    copies = [stretch(believed, seed) for seed in range(3)]
    for result, one in zip(simulate([job(believed, one) for one in copies], threads), copies, strict=True):
        same(result.arms["arm"], stepped(believed, one))


def test_an_error_of_a_python_load_is_raised(physics: Physics) -> None:
    believed = replace(physics, arms={"arm": replace(physics.arms["arm"], loads=(Broken(),))})
    with pytest.raises(InputError, match="no magnet"):
        simulate([job(believed, stretch(physics, seed)) for seed in range(2)], threads=2)


def test_numbers_do_not_depend_on_the_number_of_threads(physics: Physics) -> None:
    jobs = [job(physics, stretch(physics, seed)) for seed in range(6)]
    for one, other in zip(simulate(jobs, 1), simulate(jobs, 4), strict=True):
        np.testing.assert_array_equal(one.arms["arm"].velocity, other.arms["arm"].velocity)
