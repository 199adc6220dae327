# SPDX-License-Identifier: Apache-2.0
"""The compiled arm of a replay against Pinocchio, energy, and the drive that goes step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trials import nominal_physics

from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.physics import JointFriction
from impact_rs_sim.robot import EndEffector, RobotFacts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scene import ArmState

PERIOD = 2.5e-4  # s
PHYSICS = nominal_physics("parcel")
ARM = PHYSICS.arms["arm"]
TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0), np.array([0.4, -1.0, 0.7]))


def sliding() -> RobotModel:
    """The second and fifth joint slide, gravity and base are askew."""
    facts = ARM.facts.model_dump()
    for joint in (1, 4):
        facts["joints"][joint]["type"] = "prismatic"
    return RobotModel(RobotFacts.model_validate(facts), ARM.end_effector, TILTED, (1.0, -2.0, -9.0))


MODELS = {"turning": PHYSICS.robot_model("arm"), "sliding": sliding()}


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@given(seed=st.integers(0, 10_000))
def test_accelerations_momentum_and_twist_are_those_of_pinocchio(model: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, dq, torque = rng.uniform(-2.5, 2.5, 7), rng.normal(0.0, 2.0, 7), rng.normal(0.0, 30.0, 7)
    wanted = pin.aba(model.pinocchio, model.data, q, dq, torque)
    position, velocity = model.chain.advance(q, dq, torque, PERIOD)
    np.testing.assert_allclose((velocity - dq) / PERIOD, wanted, rtol=1e-8, atol=1e-8 * np.abs(wanted).max())
    np.testing.assert_allclose(position, q + PERIOD * velocity, rtol=1e-14)

    ((momentum,), (known,), (twist,)) = model.chain.momentum(q[None], dq[None])
    coriolis = pin.computeCoriolisMatrix(model.pinocchio, model.data, q, dq)
    np.testing.assert_allclose(momentum, model.mass_matrix(q) @ dq, rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(known, dq @ coriolis - model.gravity_torque(q), rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(twist, model.terms(q, dq).twist, rtol=1e-10, atol=1e-11)


def energy(model: RobotModel, q: np.ndarray, dq: np.ndarray) -> float:
    """Kinetic and potential [J]."""
    kinetic = pin.computeKineticEnergy(model.pinocchio, model.data, q, dq)
    return float(kinetic + pin.computePotentialEnergy(model.pinocchio, model.data, q))


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_a_falling_arm_keeps_its_energy_better_with_smaller_steps(model: RobotModel) -> None:
    rng = np.random.default_rng(3)
    q, dq = rng.uniform(-1.0, 1.0, 7), rng.normal(0.0, 1.0, 7)
    before, lost = energy(model, q, dq), []
    for steps in (400, 800):
        after = model.chain.advance(q, dq, np.zeros((steps, 7)), 0.05 / steps)
        lost.append(abs(energy(model, *after) - before))
    assert lost[0] < 0.01
    assert lost[1] / lost[0] == pytest.approx(0.5, abs=0.05)  # first order, as semi-implicit Euler is


def test_an_arm_that_is_no_set_of_bodies_is_said_by_what_is_not_a_number() -> None:
    hollow = replace(ARM.end_effector, mass=-30.0)
    chain = RobotModel(ARM.facts, hollow).chain
    _, velocity = chain.advance(np.full(7, 0.5), np.zeros(7), np.zeros(7), PERIOD)
    assert np.isnan(velocity).all()


def test_a_number_per_joint_is_wanted() -> None:
    with pytest.raises(ValueError, match="velocity: expected 7 numbers, got 6"):
        MODELS["turning"].chain.advance(np.zeros(7), np.zeros(6), np.zeros(7), PERIOD)
    with pytest.raises(ValueError, match="torque"):
        MODELS["turning"].chain.advance(np.zeros(7), np.zeros(7), np.zeros(8), PERIOD)


FRICTION = JointFriction(
    *np.random.default_rng(5).uniform(0.1, 0.6, (3, 7)), np.full(7, 0.06), ARM.facts.friction, smoothing=0.01
)


@pytest.mark.parametrize("friction", [FRICTION, replace(FRICTION, sigmoid=None)], ids=["with sigmoid", "without"])
def test_motor_friction_is_scaled_like_the_shaped_inertia(friction: JointFriction) -> None:
    drive = Drive(replace(ARM, friction=friction), PERIOD)
    for speed in (-1.5, -0.03, 0.0, 0.004, 0.3):
        drive.velocity = np.full(7, speed)
        drive.step(np.zeros(7))
        shaping = ARM.motor_inertia_rotor / ARM.motor_inertia_reduced
        wanted = shaping * friction.torque(np.full(7, speed))
        np.testing.assert_allclose(drive.friction_torque, wanted, rtol=1e-13, atol=1e-15)


def test_several_arms_at_once_move_freely_as_each_does_step_by_step() -> None:
    rng = np.random.default_rng(8)
    physics = replace(
        ARM, friction=FRICTION, torque_gain=rng.uniform(0.9, 1.1, 7), torque_offset=rng.normal(0.0, 0.5, 7)
    )
    model, rows, steps = MODELS["turning"], 3, 40
    q, dq = rng.uniform(-1.0, 1.0, (2, rows, 7))
    torque, rate, load = rng.normal(0.0, 5.0, (3, rows, 7))
    desired = rng.normal(0.0, 20.0, (steps, rows, 7))
    drives = Drive(physics, PERIOD)
    drives.start(ArmState(q, dq), DriveStart(torque, rate))
    after = drives.step_free(model.chain, ArmState(q, dq), desired, load)
    for row in range(rows):
        one, position, velocity = Drive(physics, PERIOD), q[row], dq[row]
        one.start(ArmState(position, velocity), DriveStart(torque[row], rate[row]))
        for wanted in desired[:, row]:
            passed = one.link_torque(wanted) + load[row]
            one.step(wanted)
            velocity = velocity + PERIOD * pin.aba(model.pinocchio, model.data, position, velocity, passed)
            position = position + PERIOD * velocity
            one.sense(position, velocity)
        np.testing.assert_allclose(after.position[row], position, rtol=1e-11)
        np.testing.assert_allclose(after.velocity[row], velocity, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(drives.elastic_torque[row], one.elastic_torque, rtol=1e-8, atol=1e-9)


def test_end_effectors_of_the_same_numbers_are_one_and_share_a_model() -> None:
    same = replace(ARM.end_effector, com=ARM.end_effector.com.copy())
    heavier = replace(ARM.end_effector, mass=ARM.end_effector.mass + 0.1)
    assert same == ARM.end_effector and hash(same) == hash(ARM.end_effector)
    assert heavier != ARM.end_effector
    masses = [pin.computeTotalMass(RobotModel(ARM.facts, one).pinocchio) for one in (same, heavier)]
    assert masses[1] - masses[0] == pytest.approx(0.1)


def test_models_of_one_arm_do_not_write_into_each_other() -> None:
    first, second = (RobotModel(ARM.facts, ARM.end_effector, base) for base in (None, TILTED))
    first.pinocchio.gravity.linear = np.zeros(3)
    assert second.pinocchio.gravity.linear[2] == -9.81
    effector: EndEffector = second.end_effector
    assert effector is ARM.end_effector
    third = RobotModel(ARM.facts, ARM.end_effector)
    np.testing.assert_array_equal(third.pinocchio.jointPlacements[1].translation, ARM.facts.joints[0].xyz)
