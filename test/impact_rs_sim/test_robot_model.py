# SPDX-License-Identifier: Apache-2.0
"""The rigid arm: Pinocchio's model, the compiled chain, joints that slide, bodies that can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trials import nominal_physics

from impact_rs_sim.assumed_drive import FRANKA_SPEED_LIMIT_RAD_S, assumed_drive
from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.errors import Infeasible, UnreachablePose
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.impact_map.derivatives import parameters_of
from impact_rs_sim.impact_map.problem import check_problem
from impact_rs_sim.physics import JointFriction, Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.plant.bullet_world import BulletWorld, mass_matrices
from impact_rs_sim.robot_check import check_drives, check_facts
from impact_rs_sim.robots.bodies import ellipsoid_contains, inertia_of, is_physically_consistent, second_moments
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.robots.urdf import write_urdf
from impact_rs_sim.scenarios.robot_spec import DriveSettings
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, BodyState

# ---- the rigid model ------------------------------------------------------------------------------------------------


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


# ---- the compiled chain against Pinocchio ---------------------------------------------------------------------------

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
    *np.random.default_rng(5).uniform(0.1, 0.6, (3, 7)),
    np.full(7, 0.06),
    ARM.facts.friction,
    smoothing=np.linspace(0.004, 0.02, 7),
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


# ---- joints that slide ----------------------------------------------------------------------------------------------

CART, BOB, LENGTH, OWN = 3.0, 1.2, 0.4, 0.02  # kg, kg, m, kg m^2 of the bob about its own centre
NOTHING = EndEffector(1e-12, np.zeros(3), 1e-15 * np.eye(3), 0.0, 0.0, (0.05, 0.05, 0.005))
ALONG = {"x": (0.0, np.pi / 2, 0.0), "y": (-np.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}  # rpy whose z is that axis

Joint = tuple[str, str, float, tuple[float, float, float], float]


def chain(*joints: Joint) -> RobotFacts:
    """All frames at the origin at q = 0, the flange along x.

    Each joint is its type, its axis in A, and mass [kg], centre [m] and moments [kg m^2] of its link in axes of A.
    """
    before, origins, links = np.eye(3), [], []
    for kind, axis, mass, centre, moment in joints:
        turned = pin.rpy.rpyToMatrix(*ALONG[axis])
        origins.append({"type": kind, "xyz": (0, 0, 0), "rpy": pin.rpy.matrixToRpy(before.T @ turned)})
        links.append({"mass": mass, "com": turned.T @ centre, "inertia": (moment, 0, 0, moment, 0, moment)})
        before = turned
    flange = pin.rpy.matrixToRpy(before.T @ pin.rpy.rpyToMatrix(*ALONG["x"]))
    limits = {
        "position_min_rad": [-2.0] * len(joints),
        "position_max_rad": [1.5] * len(joints),
        "velocity_rad_s": [3.0] * len(joints),
        "torque_Nm": [200.0] * len(joints),
    }
    data = {"source": "by hand", "joints": origins, "links": links, "limits": limits}
    return RobotFacts.model_validate(data | {"flange": {"xyz": (0, 0, 0), "rpy": flange}})


CART_POLE = chain(("prismatic", "x", CART, (0.0, 0.0, 0.0), 0.01), ("revolute", "y", BOB, (0.0, 0.0, -LENGTH), OWN))
RAIL = chain(("prismatic", "x", CART, (0.02, 0.0, 0.0), 0.01))


def physics_of(facts: RobotFacts, rotor: float, reduced: float, stiffness: float, damping: float) -> Physics:
    """A box without weight or friction, and the chain with one drive in every joint."""
    push = nominal_physics("cat_food")
    one = np.ones(facts.joint_count)
    arm = replace(
        push.arms["arm"],
        facts=facts,
        base=pin.SE3.Identity(),
        end_effector=NOTHING,
        motor_inertia_rotor=rotor * one,
        motor_inertia_reduced=reduced * one,
        stiffness=stiffness * one,
        damping=damping * one,
        friction=JointFriction.none(facts.joint_count),
        torque_offset=0.0 * one,
        torque_gain=one,
    )
    return replace(push, arms={"arm": arm}, support_height=None, pad_friction=0.0, restitution=0.0)


@pytest.mark.parametrize("angle", [0.0, 0.7, -1.9])
def test_a_cart_with_a_pendulum_has_its_textbook_terms(angle: float) -> None:
    """L = (M + m) dx^2 / 2 + (m l^2 + I) da^2 / 2 - m l cos(a) dx da + m g l cos(a), the bob at x - l sin(a)."""
    model, q, dq = RobotModel(CART_POLE, NOTHING), np.array([0.3, angle]), np.array([0.4, -1.1])
    coupled = -BOB * LENGTH * np.cos(angle)
    mass = np.array([[CART + BOB, coupled], [coupled, BOB * LENGTH**2 + OWN]])
    np.testing.assert_allclose(model.mass_matrix(q), mass, atol=1e-10)
    gravity = np.array([0.0, BOB * 9.81 * LENGTH * np.sin(angle)])
    np.testing.assert_allclose(model.gravity_torque(q), gravity, atol=1e-10)
    terms = model.terms(q, dq)
    bias = gravity + np.array([BOB * LENGTH * np.sin(angle) * dq[1] ** 2, 0.0])
    np.testing.assert_allclose(terms.bias, bias, atol=1e-10)
    np.testing.assert_allclose(terms.jacobian[:, 0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(model.placement(q).translation, [0.3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(mass_matrices(CART_POLE, NOTHING, q[None])[0], mass, atol=1e-6)


def test_an_upright_rail_carries_its_weight_as_a_force() -> None:
    lift = chain(("prismatic", "z", CART, (0.0, 0.0, 0.0), 0.01))
    assert RobotModel(lift, NOTHING).gravity_torque(np.array([0.2])) == pytest.approx([CART * 9.81])


def test_a_force_drives_the_mass_of_links_and_motor_along_a_rail() -> None:
    """x = F t^2 / (2 (m + B_theta)), and the joint's spring is pressed by what the link takes, m F / (m + B) / K."""
    force, reduced, stiffness, time = 8.0, 2.0, 2e5, 0.2
    physics = replace(physics_of(RAIL, 6.0, reduced, stiffness, 400.0), gravity=np.zeros(3))
    mechanics = BulletMechanics.load(physics, PERIOD, may_sleep=False)
    away = BodyState(np.array([5.0, 0.0, 0.0]), np.eye(3), np.zeros(6))
    still = np.zeros(1)
    mechanics.start({"arm": ArmState(still, still)}, {"arm": DriveStart(still, still)}, away)
    for _ in range(round(time / PERIOD)):
        mechanics.step({"arm": np.array([force])}, 1, 0.0)
    link, drive = mechanics.links["arm"], mechanics.drives["arm"]
    mechanics.close()
    acceleration = force / (CART + reduced)
    assert link.velocity == pytest.approx([acceleration * time], rel=3e-3)
    assert link.position == pytest.approx([acceleration * time**2 / 2.0], rel=3e-3)
    assert drive.elastic_torque == pytest.approx([CART * acceleration], rel=1e-2)
    assert drive.position - link.position == pytest.approx([CART * acceleration / stiffness], rel=1e-2)


@pytest.mark.parametrize("engine", ["exact", "bullet"])
@pytest.mark.parametrize("motor", [0.0, 2.0])
def test_a_rail_hits_with_its_mass_and_that_of_its_motor(engine: str, motor: float) -> None:
    """v^+ = m v^- / (m + m_box) with m = links + B along the rail."""
    physics = physics_of(RAIL, 6.0, 2.0, 2e5, 400.0)
    speed, thing = 0.6, physics.object
    box = BodyState(np.array([0.1 + thing.size[0] / 2.0, 0.0, 0.0]), np.eye(3), np.zeros(6))
    arms = {"arm": ArmState(np.array([0.1]), np.array([speed]))}
    problem = ImpactProblem(physics, arms, box, {"arm": np.array([motor])})
    result = predict_impact(problem, engine=engine)
    wanted = (CART + motor) * speed / (CART + motor + thing.mass)
    assert result.joint_velocity["arm"] == pytest.approx([wanted], rel=1e-6)
    assert result.object_twist[0] == pytest.approx(wanted, rel=1e-6)
    impulse = sum(contact.impulse for contact in result.contacts)
    np.testing.assert_allclose(impulse, [thing.mass * wanted, 0.0, 0.0], atol=1e-6)
    mass = RobotModel(RAIL, NOTHING).effective_mass(np.array([0.1]), np.array([1.0, 0.0, 0.0]), np.array([motor]))
    assert mass == pytest.approx(CART + motor)


def test_units_of_a_question_are_those_of_its_joints() -> None:
    physics = physics_of(CART_POLE, 6.0, 2.0, 2e5, 400.0)
    box = BodyState(np.array([5.0, 0.0, 0.0]), np.eye(3), np.zeros(6))
    problem = ImpactProblem(physics, {"arm": ArmState(np.zeros(2), np.zeros(2))}, box, {"arm": np.ones(2)})
    units = {parameter.name: parameter.unit for parameter in parameters_of(problem)}
    assert [units[f"arm.{kind}.1"] for kind in ("motor_inertia", "position", "velocity")] == ["kg", "m", "m/s"]
    assert [units[f"arm.{kind}.2"] for kind in ("motor_inertia", "position", "velocity")] == ["kg m^2", "rad", "rad/s"]
    for state, message in (
        (ArmState(np.array([1.6, 0.0]), np.zeros(2)), r"joint 1 is outside its limits \[-2, 1.5\] m"),
        (ArmState(np.zeros(2), np.array([-3.5, 0.0])), "joint 1 is faster than its limit 3 m/s"),
        (ArmState(np.array([0.0, 1.6]), np.zeros(2)), r"joint 2 is outside its limits \[-2, 1.5\] rad"),
    ):
        with pytest.raises(Infeasible, match=message):
            check_problem(replace(problem, arms={"arm": state}))


def test_a_check_tells_what_slides_in_metres_and_newtons() -> None:
    found = {check.name: check.found for check in check_facts(CART_POLE)}
    assert found["limits are sane"] == "joints slide by 3.5 to 3.5 m, turn by 3.5 to 3.5 rad"
    lift = chain(("prismatic", "z", CART, (0.0, 0.0, 0.0), 0.01))
    assert check_facts(lift)[-1].found == "joint 1: gravity takes up to 14.7 % of the force limit"
    push = load_scenario("push")
    drive = DriveSettings(motor_inertia_rotor=(6.0,), motor_inertia_reduced=(2.0,), stiffness=(1e9,), damping=(400.0,))
    impact = {"joint_position": (0.0,)}
    robot = push.robots["arm"].model_dump() | {"facts": RAIL, "drive": drive.model_dump(), "impact": impact}
    data = push.model_dump() | {"robots": {"arm": robot}}
    data["cases"] = {"case_1": {"label": "one", "robots": {"arm": {"ante_velocity": (0.3, 0.0, 0.0)}}}}
    told = check_drives(RAIL, type(push).model_validate(data))[0].found
    assert "kg on the link" in told and "N/m" in told and "kg m" not in told and "/rad" not in told


def test_the_drive_assumed_of_a_rail_is_that_behind_a_pinion() -> None:
    """r = 3 / 2.175 m: the torque limit r F, and B, K and D of that joint over r^2."""
    radius = 3.0 / FRANKA_SPEED_LIMIT_RAD_S
    turns = chain(("revolute", "x", CART * radius**2, (0.0, 0.0, 0.0), CART * radius**2))
    limits = turns.limits.model_copy(update={"torque_Nm": (200.0 * radius,)})
    theirs = assumed_drive(turns.model_copy(update={"limits": limits}), NOTHING, PERIOD)
    ours = assumed_drive(RAIL, NOTHING, PERIOD)
    for name, values in ours.items():
        assert values == pytest.approx([theirs[name][0] / radius**2], rel=1e-2), name


# ---- bodies: those of clouds of points, and no others ---------------------------------------------------------------


def of_points(masses: Array, places: Array) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about the centre of points."""
    mass = float(masses.sum())
    com = masses @ places / mass
    moments = np.einsum("k,ki,kj->ij", masses, places - com, places - com)
    return mass, com, inertia_of(moments)


def pseudo_inertia(mass: float, com: Array, inertia: Array) -> Array:
    """P of Wensing, Kim and Slotine 2018, ``(4, 4)``."""
    first = mass * com
    return np.block([[second_moments(inertia) + np.outer(first, com), first[:, None]], [first, mass]])


def test_points_of_any_masses_are_a_body() -> None:
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 4, 20):  # from a point and a rod on
        mass, _, inertia = of_points(rng.uniform(0.1, 2.0, count), rng.normal(size=(count, 3)))
        assert is_physically_consistent(mass, inertia)


def test_a_body_is_what_has_a_positive_definite_pseudo_inertia() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(500):
        mass, com, inertia = of_points(rng.uniform(0.1, 2.0, 5), rng.normal(size=(5, 3)))
        other = rng.normal(size=(3, 3))
        mass, inertia = mass + rng.normal(), inertia + other + other.T
        found.append(is_physically_consistent(mass, inertia))
        assert found[-1] == bool(np.linalg.eigvalsh(pseudo_inertia(mass, com, inertia))[0] > 0.0)
    assert 50 < sum(found) < 450


def test_moments_beyond_the_triangle_inequality_are_of_no_body() -> None:
    assert is_physically_consistent(1.0, np.diag([1.0, 2.0, 3.0]))  # a plate
    assert not is_physically_consistent(1.0, np.diag([1.0, 2.0, 3.001]))
    assert not is_physically_consistent(0.0, np.eye(3)) and not is_physically_consistent(-1.0, np.eye(3))


def test_second_moments_and_inertia_are_each_other_s_inverse() -> None:
    inertia = np.array([[3.0, 0.1, 0.2], [0.1, 4.0, -0.3], [0.2, -0.3, 5.0]])
    assert inertia_of(second_moments(inertia)) == pytest.approx(inertia)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)])
def test_a_homogeneous_ellipsoid_reaches_as_far_as_its_semi_axes(direction: tuple[float, float, float]) -> None:
    """Second moments of a homogeneous ellipsoid are m a^2 / 5 along each semi-axis a."""
    mass, semi, com = 2.0, np.array([0.3, 0.2, 0.05]), np.array([1.0, -2.0, 0.5])
    inertia = inertia_of(np.diag(mass * semi**2 / 5.0))
    edge = np.array(direction) / np.linalg.norm(np.array(direction) / semi)
    assert ellipsoid_contains(mass, com, inertia, com + 0.999 * edge)
    assert not ellipsoid_contains(mass, com, inertia, com + 1.001 * edge)
    rod = inertia_of(np.diag([mass * 0.3**2 / 5.0, 0.0, 0.0]))
    assert ellipsoid_contains(mass, com, rod, com + np.array([0.29, 0.0, 0.0]))
    assert not ellipsoid_contains(mass, com, rod, com + np.array([0.0, 0.001, 0.0]))
