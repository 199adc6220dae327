# SPDX-License-Identifier: Apache-2.0
"""Hits on bodies that nothing moves, as a wall: closed forms in the map and in the twin, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from twin_scene import AGAINST_Y, RAIL_MASS, SIZE, rail, resting, run, scene

from impact_rs_sim.damping_of_restitution import restitution_of
from impact_rs_sim.descriptions import FORMATS, ExportedScene
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ENGINES, ImpactProblem, compute_impact_map, kinetic_energy, predict_impact
from impact_rs_sim.impact_map.derivatives import differentiate, parameters_of
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.object_spec import ObjectSpec
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import BodyState, Scene
from impact_rs_sim.shapes import SPHERE

WALL = ObjectPhysics(math.inf, SIZE, np.full(3, math.inf), np.zeros(3))
FACE = float(SIZE[1]) / 2.0  # m, from its middle to the face that is hit
SPEED = 0.4  # m/s


def hit(tilt: float = 0.0, restitution: float = 0.0, friction: float = 0.0, round_pad: bool = True) -> ImpactProblem:
    """The arm of ``hit_wall`` with a ball for a pad, or a flat one, at a wall that is tilted about x [rad]."""
    whole = Scene.resolve(load_scenario("hit_wall"), "wall", "case_1")
    arm = whole.physics.arms["arm"]
    hand = replace(arm.end_effector, pad_size=(0.04, 0.04, 0.04), shape=SPHERE) if round_pad else arm.end_effector
    physics = replace(whole.physics, arms={"arm": replace(arm, end_effector=hand)}, pad_friction=friction)
    problem = ImpactProblem.at_nominal_impact(whole.under(physics))
    turned = pin.exp3(np.array([tilt, 0.0, 0.0]))
    middle = physics.robot_model("arm").placement(problem.arms["arm"].position) * np.array([0.0, 0.0, -0.02])
    position = middle + turned @ [0.0, -0.02 - float(physics.object.size[1]) / 2.0, 0.0]
    body = BodyState(position, turned, np.zeros(6)) if round_pad else problem.object
    return replace(problem, object=body, restitution=restitution)


def heavy(problem: ImpactProblem, mass: float) -> ImpactProblem:
    """The same with a free body of a large mass."""
    body = problem.physics.object
    body = replace(body, mass=mass, inertia=np.full(3, mass))
    return replace(problem, physics=replace(problem.physics, object=body))


@pytest.mark.parametrize("tilt", [0.0, 0.3, -0.5])
@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
def test_an_arm_stops_or_bounces_with_the_impulse_of_its_effective_mass(tilt: float, restitution: float) -> None:
    """L = (1 + e) v / (n^T J (M + B)^-1 J^T n) (Khatib 1995); kills a reduced mass with one of the wall in it."""
    problem = hit(tilt, restitution)
    found = compute_impact_map(problem)
    (point,) = found.contacts
    state, model = problem.arms["arm"], problem.physics.robot_model("arm")
    place = model.placement(state.position)
    lever = point.position - place.translation
    jacobian = model.jacobian(state.position)
    jacobian = jacobian[:3] - pin.skew(lever) @ jacobian[3:]
    normal = pin.exp3(np.array([tilt, 0.0, 0.0])) @ [0.0, 1.0, 0.0]
    inertia = model.mass_matrix(state.position) + np.diag(problem.motor_inertia["arm"])
    mobility = normal @ jacobian @ np.linalg.solve(inertia, jacobian.T @ normal)
    closing = -float(normal @ jacobian @ state.velocity)
    np.testing.assert_allclose(point.normal, -normal, atol=1e-9)
    np.testing.assert_allclose(point.impulse, -(1.0 + restitution) * closing / mobility * normal, atol=1e-9)
    assert normal @ jacobian @ found.joint_velocity["arm"] == pytest.approx(restitution * closing, abs=1e-9)
    assert not np.any(found.object_twist)
    lost = kinetic_energy(problem) - kinetic_energy(problem, found)
    assert lost == pytest.approx(0.5 * (1.0 - restitution**2) * closing**2 / mobility, abs=1e-9)


@pytest.mark.parametrize("law", ["newton", "poisson"])
@pytest.mark.parametrize("round_pad", [True, False])
def test_a_wall_is_the_limit_of_a_heavy_body(law: str, round_pad: bool) -> None:
    """With friction; kills a wall that friction or a moment moves, in the compiled map and in that of Poisson's law."""
    problem = replace(hit(0.3 if round_pad else 0.0, 0.2, 0.4, round_pad), restitution_law=law)
    wall, body = compute_impact_map(problem), compute_impact_map(heavy(problem, 1e7))
    np.testing.assert_allclose(wall.joint_velocity["arm"], body.joint_velocity["arm"], atol=1e-5)
    impulses = [sum(point.impulse for point in one.contacts) for one in (wall, body)]
    np.testing.assert_allclose(*impulses, atol=1e-5)
    assert wall.residual.largest < 1e-9
    assert kinetic_energy(problem, wall) < kinetic_energy(problem)


def test_bullet_finds_the_same_hit_on_a_wall() -> None:
    """A flat pad that sticks with an edge; kills columns of the wall in J_c of the engines in Python."""
    problem = hit(round_pad=False, restitution=0.3, friction=0.5)
    exact, bullet = (compute_impact_map(problem, engine) for engine in ENGINES)
    np.testing.assert_allclose(exact.joint_velocity["arm"], bullet.joint_velocity["arm"], atol=1e-5)


def test_the_pad_rests_on_the_wall_once_all_contacts_are_closed() -> None:
    found = predict_impact(hit(round_pad=False, friction=0.5), "settled")
    np.testing.assert_allclose(found.end_effector_twist["arm"], 0.0, atol=1e-8)


def test_derivatives_at_a_wall_are_those_at_a_heavy_body() -> None:
    """Of all parameters that a wall has; it has neither mass nor velocity."""
    problem = hit(0.2, 0.3, 0.4)
    names = {one.name for one in parameters_of(problem)}
    assert {one.name for one in parameters_of(heavy(problem, 1e7))} - names == {
        "object.mass",
        *(
            f"object.{kind}.{axis}"
            for kind in ("inertia", "com_offset", "velocity", "angular_velocity")
            for axis in "xyz"
        ),
    }
    wall, body = differentiate(problem), differentiate(heavy(problem, 1e7))
    rows = [row for row, name in enumerate(wall.names) if name.startswith("arm")]
    for name in names:
        np.testing.assert_allclose(wall.of(name)[rows], body.of(name)[rows], atol=2e-4, err_msg=name)


def wall_and_rail(rotation: Array, **pad: Any) -> tuple[Physics, BodyState]:
    """A rail that hits a wall at the origin, everything turned, without gravity."""
    axes = rotation @ AGAINST_Y
    physics = scene({"rail": rail(rotation @ [0.0, FACE, 0.0], axes, **pad)}, object=WALL)
    return physics, resting(rotation=rotation)


@pytest.mark.parametrize("damping", [0.0, 700.0])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_rail_bounces_off_a_wall_in_the_twin_as_a_spring_and_damper_say(damping: float, turn: float) -> None:
    """e of spring and damper with the mass of the rail alone; kills a wall that moves, and one with a mass."""
    turned = pin.exp3(np.array([turn, 0.0, 0.4 * turn]))
    physics, body = wall_and_rail(turned, pad_damping=damping, pad_mobility=1.0 / RAIL_MASS)
    found = run(physics, [SPEED], body, duration=0.06)
    e = restitution_of(damping / (2.0 * math.sqrt(2e5 * RAIL_MASS)))
    assert found.arms["rail"].velocity[-1, 0] == pytest.approx(-e * SPEED, abs=0.01 * SPEED)
    assert np.ptp(found.poses, axis=0).max() == 0.0 and not np.any(found.twists)
    assert physics.arms["rail"].pad_restitution(WALL) == pytest.approx(e)


def test_a_rigid_rail_stops_at_a_wall_in_the_twin() -> None:
    physics, body = wall_and_rail(np.eye(3), pad_stiffness=None)
    found = run(physics, [SPEED], body, duration=0.01)
    assert abs(found.arms["rail"].velocity[-1, 0]) < 2e-3 * SPEED


def test_gravity_does_not_move_a_wall_in_the_twin() -> None:
    """Kills a wall that falls once it is touched."""
    physics, body = wall_and_rail(np.eye(3))
    found = run(replace(physics, gravity=np.array([0.0, 0.0, -9.81])), [SPEED], body, duration=0.06)
    assert np.ptp(found.poses, axis=0).max() == 0.0


def test_mujoco_hits_the_exported_wall_as_the_map() -> None:
    """Its wall has no joint; kills a keyframe with a free one in it. Frictionless: MuJoCo pushes off what slides."""
    whole = Scene.resolve(load_scenario("hit_wall"), "wall", "case_1")
    whole = whole.under(replace(whole.physics, pad_friction=0.0))
    model = mujoco.MjModel.from_xml_string(FORMATS["mjcf"].write(ExportedScene.of(whole, load_model("nominal"))).text)
    assert (model.nq, model.nv) == (7, 7)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(round(3e-4 / model.opt.timestep)):
        mujoco.mj_forward(model, data)
        data.qfrc_applied[:] = data.qfrc_bias
        mujoco.mj_step(model, data)
    found = compute_impact_map(ImpactProblem.at_nominal_impact(whole))
    np.testing.assert_allclose(data.qvel, found.joint_velocity["arm"], atol=0.02 * np.abs(data.qvel).max())


def test_effects_of_the_mass_of_the_object_leave_a_wall_as_it_is() -> None:
    physics = hit().physics
    for name in ("object_mass", "object_com_offset"):
        effect = library()[name]
        start = np.array([scalar.nominal for scalar in effect.scalars(physics.joints)])
        assert effect.apply_vector(physics, start + 0.02).object is physics.object


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"objects.wall.mass": 3.0}, "objects.wall.mass = 3.0: nothing moves a fixed object"),
        ({"objects.wall.inertia": [1.0, 1.0, 1.0]}, "objects.wall: nothing moves a fixed object"),
        ({"objects.wall.fixed": False}, "objects.wall.mass.*missing.*fixed: true"),
    ],
)
def test_a_fixed_object_has_no_mass_and_a_free_one_needs_it(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_scenario("hit_wall").with_settings(settings)


def test_a_wall_that_moves_or_rests_on_a_support_is_refused() -> None:
    problem = hit()
    moving = replace(problem, object=replace(problem.object, twist=np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])))
    with pytest.raises(InputError, match=r"object\.twist.*a fixed object does not move"):
        compute_impact_map(moving)
    standing = replace(problem, physics=replace(problem.physics, support_height=0.0))
    with pytest.raises(InputError, match="rests on no support"):
        compute_impact_map(standing)


def test_a_fixed_object_is_written_without_a_mass() -> None:
    spec = ObjectSpec(label="wall", fixed=True, size=(1.0, 0.1, 1.0))
    assert spec.model_dump(mode="json").keys() == {"label", "fixed", "size", "com_offset"}
