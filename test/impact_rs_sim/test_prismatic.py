# SPDX-License-Identifier: Apache-2.0
"""Joints that slide, in metres, newtons and kilograms: closed forms of a cart with a pendulum, and of a rail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from trials import nominal_physics

from impact_rs_sim.assumed_drive import SPEED, assumed_drive
from impact_rs_sim.bullet_mechanics import BulletMechanics
from impact_rs_sim.bullet_world import mass_matrices
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.impact_map.derivatives import chain_derivative
from impact_rs_sim.impact_map.perturbation import parameters_of
from impact_rs_sim.impact_map.problem import check_problem
from impact_rs_sim.physics import JointFriction, Physics
from impact_rs_sim.robot import EndEffector, RobotFacts
from impact_rs_sim.robot_check import check_drives, check_facts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import DriveSettings, load_scenario
from impact_rs_sim.scene import ArmState, BodyState

PERIOD = 2.5e-4  # s
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


def test_drift_is_the_change_of_the_jacobian_with_sliding_joints() -> None:
    kinds = ("revolute", "prismatic", "revolute", "prismatic", "revolute")
    axes = ("z", "x", "y", "z", "x")
    facts = chain(*((kind, axis, 1.0, (0.1, 0.2, 0.3), 0.1) for kind, axis in zip(kinds, axes, strict=True)))
    model = RobotModel(facts, replace(NOTHING, length=0.3))
    q, step = np.array([0.3, -0.4, 0.5, 0.6, -0.7]), 1e-6
    told = chain_derivative(model.jacobian(q))
    for joint, direction in enumerate(np.eye(5)):
        slope = (model.jacobian(q + step * direction) - model.jacobian(q - step * direction)) / (2.0 * step)
        np.testing.assert_allclose(told[joint], slope, atol=1e-8)


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
    radius = 3.0 / SPEED
    turns = chain(("revolute", "x", CART * radius**2, (0.0, 0.0, 0.0), CART * radius**2))
    limits = turns.limits.model_copy(update={"torque_Nm": (200.0 * radius,)})
    theirs = assumed_drive(turns.model_copy(update={"limits": limits}), NOTHING, PERIOD)
    ours = assumed_drive(RAIL, NOTHING, PERIOD)
    for name, values in ours.items():
        assert values == pytest.approx([theirs[name][0] / radius**2], rel=1e-2), name
