# SPDX-License-Identifier: Apache-2.0
"""The compiled chain against Pinocchio, and friction of the compiled motors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trials import nominal_physics

from impact_rs_sim.drive import Drive
from impact_rs_sim.physics import JointFriction
from impact_rs_sim.robot import EndEffector, RobotFacts
from impact_rs_sim.robot_model import RobotModel

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
def test_momentum_and_twist_are_those_of_pinocchio(model: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, dq = rng.uniform(-2.5, 2.5, 7), rng.normal(0.0, 2.0, 7)
    ((momentum,), (known,), (twist,)) = model.chain.momentum(q[None], dq[None])
    coriolis = pin.computeCoriolisMatrix(model.pinocchio, model.data, q, dq)
    np.testing.assert_allclose(momentum, model.mass_matrix(q) @ dq, rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(known, dq @ coriolis - model.gravity_torque(q), rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(twist, model.terms(q, dq).twist, rtol=1e-10, atol=1e-11)


def test_a_number_per_joint_is_wanted() -> None:
    with pytest.raises(ValueError, match="velocity: expected 7 numbers, got 6"):
        MODELS["turning"].chain.momentum(np.zeros(7), np.zeros(6))


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
