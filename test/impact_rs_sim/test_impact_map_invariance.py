# SPDX-License-Identifier: Apache-2.0
"""What holds for every impact, whatever is drawn: nothing closes afterwards, energy, and no frame or order matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from impact_map_cases import ENGINES, PUSH, SCENE, grab
from impact_table_cases import SIZE, UP, cube
from random_impacts import random_problem

from impact_rs_sim.impact_map import ImpactProblem, ImpactResult, compute_impact_map, kinetic_energy
from impact_rs_sim.impact_map.measured import MeasuredImpact, MeasuredImpacts, points_that_touch, solve_measured
from impact_rs_sim.impact_map.problem import EnergyGain
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.scene import BodyState

LAWS = ("newton", "poisson")
drawn = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
SAME = 1e-6  # m/s, rad/s; rounding, where points share a load in many ways
seeds, coefficients = st.integers(0, 10**6), st.floats(0.0, 1.0)


def tumbling(seed: int, restitution: float, law: str = "newton") -> ImpactProblem:
    """A push of an object that turns and moves: some of its points open while others close."""
    rng = np.random.default_rng(seed)
    problem = random_problem(PUSH, rng, restitution)
    twist = np.concatenate((rng.normal(0.0, 0.3, 3), rng.normal(0.0, 3.0, 3)))
    physics = replace(problem.physics, support_size=(50.0, 50.0))  # the same below the object from every side
    return replace(problem, physics=physics, object=replace(problem.object, twist=twist), restitution_law=law)


def opening(problem: ImpactProblem, result: ImpactResult | None, contacts: ImpactResult) -> np.ndarray:
    """J_n u of every contact point, before the impact or after it, from the twists of the bodies, ``(m,)`` [m/s]."""
    found = []
    for point in contacts.contacts:
        twist = problem.object.twist if result is None else result.object_twist
        moving = twist[:3] + np.cross(twist[3:], point.position - problem.object.position)
        if point.body_b in problem.arms:
            state, model = problem.arms[point.body_b], problem.physics.robot_model(point.body_b)
            dq = state.velocity if result is None else result.joint_velocity[point.body_b]
            of_frame = model.jacobian(state.position) @ dq
            lever = point.position - point.gap * point.normal - model.placement(state.position).translation
            moving = moving - of_frame[:3] - np.cross(of_frame[3:], lever)
        found.append(point.normal @ moving)
    return np.array(found)


def thrown(seed: int) -> MeasuredImpact:
    """A cube that comes down on an edge or a face and turns, so that some of its corners may open."""
    rng = np.random.default_rng(seed)
    turn = pin.rpy.rpyToMatrix(rng.choice([0.0, 0.4]), 0.0, rng.uniform(-3.0, 3.0))
    twist = np.concatenate((rng.uniform(-1.0, 1.0, 2), [-rng.uniform(0.1, 0.5)], rng.normal(0.0, 6.0, 3)))
    body = BodyState(rng.normal(0.0, 0.1, 3), turn, twist)
    return MeasuredImpact({}, body, points_that_touch(body, SIZE, UP))


def answered(problem: ImpactProblem, engine: str = "exact") -> ImpactResult:
    """The public map; draws that Newton's law refuses, because the answer would gain energy, are drawn again."""
    try:
        return compute_impact_map(problem, engine)
    except EnergyGain:
        assume(False)
        raise


EDGES = {"exact": 1e-6, "bullet": 1e-3}  # m/s, what an engine is off at most


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.5])
def test_an_edge_that_opens_before_the_impact_does_not_enter_the_plane_after_it(
    engine: str, restitution: float
) -> None:
    # A free box of 1 kg whose two lower edges come with -0.7 and +0.1 m/s, without friction.
    thing = ObjectPhysics(1.0, np.full(3, 0.1), np.full(3, 1.0 / 600.0), np.zeros(3))
    physics = replace(SCENE.physics, object=thing, support_friction=0.0)
    body = BodyState(
        np.array([0.3, -0.9, physics.support_height + 0.05]), np.eye(3), np.array([0.0, 0.0, -0.3, 0.0, 8.0, 0.0])
    )
    problem = replace(ImpactProblem.at_nominal_impact(SCENE), physics=physics, object=body, restitution=restitution)
    result = compute_impact_map(problem, engine)
    before, after = opening(problem, None, result), opening(problem, result, result)
    expected = np.where(before < 0.0, 0.7 * restitution, 0.0)
    np.testing.assert_allclose(np.sort(before), [-0.7, -0.7, 0.1, 0.1], atol=1e-9)
    np.testing.assert_allclose(after, expected, atol=EDGES[engine])


@pytest.mark.parametrize("law", LAWS)
@drawn
@given(seed=seeds, restitution=coefficients)
def test_no_point_closes_after_an_impact(law: str, seed: int, restitution: float) -> None:
    problem = tumbling(seed, restitution, law)
    result = answered(problem)
    assert np.min(opening(problem, result, result), initial=0.0) >= -1e-6


@drawn
@given(seed=seeds, restitution=coefficients, friction=st.booleans())
def test_an_impact_by_poissons_law_loses_energy(seed: int, restitution: float, friction: bool) -> None:
    problem = tumbling(seed, restitution, "poisson")
    if not friction:
        problem = replace(problem, physics=replace(problem.physics, pad_friction=0.0, support_friction=0.0))
    result = compute_impact_map(problem)
    assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-9)


@drawn
@given(seed=seeds, restitution=coefficients)
def test_an_answer_of_newtons_law_that_gains_energy_is_refused(seed: int, restitution: float) -> None:
    problem = tumbling(seed, restitution)
    try:
        result = compute_impact_map(problem)
    except EnergyGain:
        assert restitution > 0.0
    else:
        assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-9)


@drawn
@given(seed=seeds, restitution=coefficients)
def test_without_friction_newtons_law_gains_energy_at_opening_points_alone(seed: int, restitution: float) -> None:
    # L_n (J_n u^+ + e min(J_n u^-, 0)) = 0 at every point, so the energy (u^+ + u^-)^T J^T L / 2 that an impact adds is
    # sum L_n ((1 - e) min(J_n u^-, 0) + max(J_n u^-, 0)) / 2: closing points take, opening ones that are hit give.
    impact, physics = thrown(seed), cube(0.0, restitution)
    _, found = MeasuredImpacts([impact], [physics]).solve([physics])
    system = impact.system(physics, {})
    before = (system.jacobian(impact.points) @ system.velocity).reshape(-1, 3) @ UP
    taken = (1.0 - restitution) * np.minimum(before, 0.0)
    wanted = 0.5 * found.impulse @ UP @ (taken + np.maximum(before, 0.0))
    assert found.energy[0, 1] == pytest.approx(wanted, abs=1e-9 * found.energy[0, 0])


@pytest.mark.parametrize("law", LAWS)
@drawn
@given(seed=seeds, restitution=coefficients)
def test_no_frame_is_special(law: str, seed: int, restitution: float) -> None:
    # The whole laboratory is turned about the vertical and moved; without a support, in any way.
    problem = tumbling(seed, restitution, law)
    rng = np.random.default_rng(seed)
    place = pin.SE3(pin.utils.rotate("z", rng.uniform(-3.0, 3.0)), np.array([*rng.normal(size=2), 0.0]))
    if seed % 2:
        place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        problem = replace(problem, physics=replace(problem.physics, support_height=None))
    arms = {name: replace(arm, base=place * arm.base) for name, arm in problem.physics.arms.items()}
    body, turn = problem.object, place.rotation
    twist = np.concatenate((turn @ body.twist[:3], turn @ body.twist[3:]))
    elsewhere = replace(
        problem,
        physics=replace(problem.physics, arms=arms),
        object=BodyState(place.act(body.position), turn @ body.rotation, twist),
    )
    first, second = answered(problem), answered(elsewhere)
    np.testing.assert_allclose(second.joint_velocity["arm"], first.joint_velocity["arm"], atol=SAME)
    for of_twist in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose(second.object_twist[of_twist], turn @ first.object_twist[of_twist], atol=SAME)


@pytest.mark.parametrize("law", LAWS)
@drawn
@given(seed=seeds, restitution=coefficients)
def test_axes_of_the_object_and_with_them_the_order_of_points_do_not_matter(
    law: str, seed: int, restitution: float
) -> None:
    problem = tumbling(seed, restitution, law)
    thing, body = problem.physics.object, problem.object
    quarter = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # axes renamed, the body stays
    renamed = ObjectPhysics(
        thing.mass, np.abs(quarter.T) @ thing.size, np.abs(quarter.T) @ thing.inertia, quarter.T @ thing.com_offset
    )
    other = replace(
        problem,
        physics=replace(problem.physics, object=renamed),
        object=replace(body, rotation=body.rotation @ quarter),
    )
    first, second = answered(problem), answered(other)
    np.testing.assert_allclose(second.joint_velocity["arm"], first.joint_velocity["arm"], atol=SAME)
    np.testing.assert_allclose(second.object_twist, first.object_twist, atol=SAME)


@pytest.mark.parametrize("law", LAWS)
@drawn
@given(seed=seeds, restitution=coefficients)
def test_the_order_of_arms_does_not_matter(law: str, seed: int, restitution: float) -> None:
    problem = replace(grab(), restitution=restitution, restitution_law=law)
    rng = np.random.default_rng(seed)
    twist = np.concatenate((rng.normal(0.0, 0.2, 3), rng.normal(0.0, 2.0, 3)))
    problem = replace(problem, object=replace(problem.object, twist=twist))
    swapped = replace(
        problem,
        physics=replace(problem.physics, arms=dict(reversed(problem.physics.arms.items()))),
        arms=dict(reversed(problem.arms.items())),
        motor_inertia=dict(reversed(problem.motor_inertia.items())),
    )
    first, second = answered(problem), answered(swapped)
    assert list(first.joint_velocity) != list(second.joint_velocity)
    for name, velocity in first.joint_velocity.items():
        np.testing.assert_allclose(second.joint_velocity[name], velocity, atol=SAME)
    np.testing.assert_allclose(second.object_twist, first.object_twist, atol=SAME)


@drawn
@given(seed=seeds, restitution=coefficients, friction=st.floats(0.0, 1.0))
def test_a_measured_impact_closes_no_point_whatever_the_order_of_its_points(
    seed: int, restitution: float, friction: float
) -> None:
    impact, physics = thrown(seed), cube(friction, restitution)
    shuffled = replace(impact, points=tuple(np.random.default_rng(seed).permutation(np.array(impact.points, object))))
    first, second = (solve_measured(physics, one, may_gain_energy=True) for one in (impact, shuffled))
    after = (first[1].jacobian(impact.points) @ first[0]).reshape(-1, 3) @ UP
    assert np.min(after) >= -1e-6
    np.testing.assert_allclose(second[0], first[0], atol=SAME)
