# SPDX-License-Identifier: Apache-2.0
"""One URDF, two engines: Pinocchio and Bullet must see the same arm."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.bullet_world import BulletWorld
from impact_rs_sim.errors import UnreachablePose
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.urdf import write_urdf


def random_configurations(model, count, seed=0):
    return np.random.default_rng(seed).uniform(model.position_min, model.position_max, (count, model.joint_count))


def test_pinocchio_and_bullet_agree_on_mass_matrix_and_gravity_torque(scene):
    model = scene.models["arm"]
    world = BulletWorld.load(
        scene.physics, time_step=1e-3, gravity=True, compliant_pads=False, iterations=50, residual_threshold=0.0
    )
    still = [0.0] * model.joint_count
    for q in random_configurations(model, 50):
        bullet_mass = np.array(world.client.calculateMassMatrix(world.arms["arm"], q.tolist()))
        mass = model.mass_matrix(q)
        assert np.abs(mass - bullet_mass).max() < 1e-6 * np.abs(mass).max()
        bullet_gravity = np.array(world.client.calculateInverseDynamics(world.arms["arm"], q.tolist(), still, still))
        gravity = model.gravity_torque(q)
        assert np.abs(gravity - bullet_gravity).max() < 1e-6 * np.abs(gravity).max()
    world.close()


def test_drift_is_the_time_derivative_of_the_jacobian_times_velocity(scene):
    model = scene.models["arm"]
    rng = np.random.default_rng(1)
    step = 1e-6
    for q in random_configurations(model, 5):
        dq = rng.standard_normal(model.joint_count)
        ahead, behind = model.jacobian(q + step * dq), model.jacobian(q - step * dq)
        numeric = (ahead - behind) @ dq / (2.0 * step)
        np.testing.assert_allclose(model.terms(q, dq).drift, numeric, atol=1e-6)


def test_bias_at_rest_is_gravity_and_twist_is_jacobian_times_velocity(scene):
    model = scene.models["arm"]
    q = scene.arms["arm"].position
    dq = scene.arms["arm"].velocity
    np.testing.assert_allclose(model.terms(q, np.zeros(7)).bias, model.gravity_torque(q), atol=1e-12)
    terms = model.terms(q, dq)
    np.testing.assert_allclose(terms.twist, [0.0, -0.7, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    (twist,) = model.chain.momentum(q[None], dq[None])[2]
    np.testing.assert_allclose(twist, terms.twist, atol=1e-12)
    np.testing.assert_allclose(terms.mass_matrix, terms.mass_matrix.T, atol=1e-12)


def test_effective_masses_at_impact_are_those_the_paper_implies(scene):
    """Table II implies 3.92 / 4.52 / 5.43 kg for B = 0 / B_theta / B_rho."""
    model, arm = scene.models["arm"], scene.physics.arms["arm"]
    q = scene.arms["arm"].position
    masses = [model.effective_mass(q, np.array([0, 1, 0]), arm.motor_inertia(b)) for b in ("zero", "reduced", "rotor")]
    np.testing.assert_allclose(masses, [3.92, 4.52, 5.43], rtol=2e-3)


def test_more_motor_inertia_is_never_felt_as_less_mass(scene):
    model = scene.models["arm"]
    rng = np.random.default_rng(2)
    for q in random_configurations(model, 20):
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        inertia = rng.uniform(0.0, 1.0, 7)
        lighter = model.effective_mass(q, direction, inertia)
        assert model.effective_mass(q, direction, inertia + rng.uniform(0.0, 1.0, 7)) >= lighter


def test_inverse_kinematics_reaches_the_pose_with_joint_1_given(scene):
    model = scene.models["arm"]
    target = scene.scenario.robots["arm"].impact.placement
    for joint_1 in (-0.4, 0.0, 0.5):
        q = model.inverse_kinematics(target, {0: joint_1}, scene.arms["arm"].position)
        assert q[0] == joint_1
        assert np.linalg.norm(pin.log6(model.placement(q).actInv(target)).vector) < 1e-8
        assert np.all(q >= model.position_min) and np.all(q <= model.position_max)


def test_inverse_kinematics_by_newton_finds_the_joints_that_made_the_pose(scene):
    model = scene.models["arm"]
    rng = np.random.default_rng(4)
    free = np.arange(1, 7)
    for q in random_configurations(model, 30):
        guess = q + np.concatenate(([0.0], rng.uniform(-0.05, 0.05, 6)))
        found = model._newton(model.placement(q), guess, free)
        if np.linalg.cond(model.jacobian(q)[:, 1:]) < 30.0:
            np.testing.assert_allclose(found, q, atol=1e-9)


def test_inverse_kinematics_stays_inside_the_joint_limits(scene, monkeypatch):
    model = scene.models["arm"]
    q = scene.arms["arm"].position
    target = model.placement(q)
    narrow = model.position_min.copy()
    narrow[3] = q[3] + 0.2
    monkeypatch.setattr(model, "position_min", narrow)
    with pytest.raises(UnreachablePose, match="nearest pose is"):
        model.inverse_kinematics(target, {0: float(q[0])}, q, further_starts=0)


def test_unreachable_pose_says_so(scene):
    model = scene.models["arm"]
    far = pin.SE3(np.eye(3), np.array([2.0, 0.0, 0.5]))
    with pytest.raises(
        UnreachablePose, match=r"cannot be at \[2.0, 0.0, 0.5\] m, joint 1 at 0 rad: the nearest pose is 1.\d+ m and"
    ):
        model.inverse_kinematics(far, {0: 0.0}, scene.arms["arm"].position)
    with pytest.raises(UnreachablePose, match="limits"):
        model.inverse_kinematics(far, {0: 4.0}, scene.arms["arm"].position)


@pytest.mark.parametrize("name", ["push", "push_ur5e", "push_iiwa7"])
def test_an_arm_with_other_masses_is_the_one_that_its_urdf_describes(name):
    """In both orders, for the second arm of one geometry takes it from the first."""
    arm = Physics.nominal(load_scenario(name), "parcel").arms["arm"]
    changed = {"mass": 3.0, "com": (0.01, -0.02, 0.03), "inertia": (-0.01, 0.0, 0.0, 0.02, 0.0, 0.02)}  # of no body
    heavier = tuple(link.model_copy(update=changed) for link in arm.facts.links)
    other = arm.facts.model_copy(update={"links": heavier})
    loaded = replace(arm.end_effector, mass=2.0, com=np.array([0.02, 0.01, -0.03]))
    longer = replace(loaded, length=arm.end_effector.length + 0.1)
    for facts, effector in ((arm.facts, arm.end_effector), (other, loaded), (other, longer), (arm.facts, loaded)):
        ours = RobotModel(facts, effector).pinocchio
        theirs = pin.buildModelFromXML(write_urdf(facts, effector))
        for mine, described in zip(ours.inertias, theirs.inertias, strict=True):
            assert mine.toDynamicParameters() == pytest.approx(described.toDynamicParameters(), abs=1e-14)
        assert ours.frames[-1].placement.isApprox(theirs.frames[-1].placement, 1e-14)
