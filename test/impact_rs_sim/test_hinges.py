# SPDX-License-Identifier: Apache-2.0
"""Hits on doors and drawers, which a hinge or slide leaves one velocity: closed forms, limits, refusals."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from impact_rs_analysis.limits.drawn_hits import Hits
from impact_rs_analysis.limits.hit_bounds import NO_THRESHOLDS
from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, kinetic_energy, predict_impact
from impact_rs_sim.impact_map.contacts import contact_pairs, find_contacts
from impact_rs_sim.impact_map.derivatives import differentiate
from impact_rs_sim.impact_map.measured import MeasuredImpact, solve_measured
from impact_rs_sim.impact_map.uncertainty import predict
from impact_rs_sim.paths import config_directory
from impact_rs_sim.plant.unmodelled import LooseContents
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.trial_settings import Uncertainties
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import validate
from impact_rs_sim.shapes import SPHERE

WALL = yaml.safe_load((config_directory() / "scenarios" / "hit_wall.yaml").read_text(encoding="utf-8"))
MASS, WIDTH, THICK = 9.0, 0.6, 0.1  # kg and m, of the door
INERTIA = [0.8, 1.0, MASS * (WIDTH**2 + THICK**2) / 12.0]  # kg m^2; the last about z, of an even door
Z = [0.0, 0.0, 1.0]
EDGE = {"axis": Z, "point": [-WIDTH / 2.0, 0.0, 0.0]}


def scenario_of(**keys: Any) -> dict[str, Any]:
    """The scenario hit_wall with a door in place of the wall."""
    data: dict[str, Any] = json.loads(json.dumps(WALL))
    wall = {"label": "Door", "size": [WIDTH, THICK, 1.0], "mass": MASS, "inertia": INERTIA}
    data["objects"] = {"door": {key: value for key, value in (wall | keys).items() if value is not None}}
    return data


def problem_of(
    shift: float = 0.0, restitution: float = 0.0, friction: float = 0.0, round_pad: bool = True, **keys: Any
) -> ImpactProblem:
    """The arm of hit_wall at rest of the door, which it hits ``shift`` from its middle along x [m]."""
    scene = Scene.resolve(validate(Scenario, scenario_of(**keys), "door.yaml"), "door", "case_1")
    arm = scene.physics.arms["arm"]
    hand = replace(arm.end_effector, pad_size=(0.04, 0.04, 0.04), shape=SPHERE) if round_pad else arm.end_effector
    physics = replace(scene.physics, arms={"arm": replace(arm, end_effector=hand)}, pad_friction=friction)
    problem = ImpactProblem.at_nominal_impact(scene.under(physics))
    body = replace(problem.object, position=problem.object.position - [shift, 0.0, 0.0])
    return replace(problem, object=body, restitution=restitution)


def pad_mobility(problem: ImpactProblem, point: Array, normal: Array) -> tuple[float, float]:
    """n^T J (M + B)^-1 J^T n [1/kg] at a point of the pad, and n . v before [m/s]."""
    state, model = problem.arms["arm"], problem.physics.robot_model("arm")
    jacobian, place = model.jacobian(state.position), model.placement(state.position).translation
    row = normal @ (jacobian[:3] - pin.skew(point - place) @ jacobian[3:])
    inertia = model.inertia(state.position, problem.motor_inertia["arm"])
    return float(row @ np.linalg.solve(inertia, row)), float(row @ state.velocity)


@pytest.mark.parametrize("shift", [-0.2, 0.0, 0.25])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_door_takes_the_angular_momentum_of_the_impulse_about_its_hinge(shift: float, restitution: float) -> None:
    """I_h omega = r L with L = (1 + e) c / (1/m_arm + r^2 / I_h), I_h = I_z + m d^2; dT = (1 - e^2) c^2 / (2 ...).

    Kills: the door's own I_z in place of I_h, a free door, the lever from its middle.
    """
    problem = problem_of(shift, restitution, hinge=EDGE)
    result = compute_impact_map(problem)
    (point,) = result.contacts
    np.testing.assert_allclose(point.normal, [0.0, -1.0, 0.0], atol=1e-12)
    mobility, closing = pad_mobility(problem, point.position, point.normal)
    hinge = problem.object.position + EDGE["point"]
    lever = float((point.position - hinge)[0])
    about_hinge = INERTIA[2] + MASS * (WIDTH / 2.0) ** 2
    impulse = (1.0 + restitution) * closing / (mobility + lever**2 / about_hinge)
    np.testing.assert_allclose(point.impulse, impulse * point.normal, atol=1e-9)
    omega = -lever * impulse / about_hinge  # about z, of an impulse along -y
    expected = [*np.cross([0.0, 0.0, omega], problem.object.position - hinge), 0.0, 0.0, omega]
    np.testing.assert_allclose(result.object_twist, expected, atol=1e-9)
    lost = kinetic_energy(problem) - kinetic_energy(problem, result)
    assert lost == pytest.approx(
        0.5 * (1.0 - restitution**2) * closing**2 / (mobility + lever**2 / about_hinge), abs=1e-9
    )


def test_a_free_door_hit_at_its_centre_of_percussion_turns_about_the_hinge() -> None:
    """At I_z / (m d) beyond the middle a hinge at distance d gets no impulse: both doors move alike, elsewhere not."""
    percussion = INERTIA[2] / (MASS * WIDTH / 2.0)
    for shift, alike in ((percussion, True), (0.0, False)):
        hinged, free = (
            compute_impact_map(replace(one, physics=replace(one.physics, support_height=None)))
            for one in (problem_of(shift, 0.3, hinge=EDGE), problem_of(shift, 0.3))
        )
        place = hinged.contacts[0].position
        assert place[2] == pytest.approx(problem_of(shift, hinge=EDGE).object.position[2], abs=0.02)
        near = [np.allclose(hinged.object_twist[own], free.object_twist[own], atol=2e-3) for own in (1, 5)]
        assert all(near) == alike


def test_a_door_hit_on_the_line_of_its_hinge_is_a_wall() -> None:
    door = compute_impact_map(problem_of(restitution=0.4, hinge={"axis": Z, "point": [0.0, THICK / 2.0, 0.0]}))
    wall = compute_impact_map(problem_of(restitution=0.4, fixed=True, mass=None, inertia=None))
    np.testing.assert_allclose(door.joint_velocity["arm"], wall.joint_velocity["arm"], atol=1e-9)
    np.testing.assert_allclose(door.object_twist, 0.0, atol=1e-9)


def test_a_drawer_is_a_door_whose_hinge_is_far_away() -> None:
    """With friction, which a slide takes as well; the drawer has the mass m along y, and nothing turns it."""
    far = {"axis": Z, "point": [-1e5, 0.0, 0.0]}
    for law in ("newton", "poisson"):
        drawer, door = (
            compute_impact_map(replace(problem_of(0.1, 0.2, 0.5, **keys), restitution_law=law))
            for keys in ({"slide": [0.0, 1.0, 0.0]}, {"hinge": far})
        )
        np.testing.assert_allclose(drawer.object_twist, door.object_twist, atol=1e-5)
        np.testing.assert_allclose(drawer.joint_velocity["arm"], door.joint_velocity["arm"], atol=1e-5)
        assert drawer.object_twist[1] < -0.1
        np.testing.assert_allclose(np.delete(drawer.object_twist, 1), 0.0, atol=1e-12)


SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, restitution=st.floats(0.0, 1.0))
def test_a_moving_door_on_any_hinge_obeys_a_solve_with_the_impulses_of_its_bearing(
    seed: int, restitution: float
) -> None:
    """All 6 velocities of the door, 5 constraint impulses of its bearing (KKT), and four smooth points by L >= 0.

    Kills: S not turned into A, a centre of mass in the middle, u^- of a door that moves already.
    """
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    hinge = {"axis": (axis / np.linalg.norm(axis)).tolist(), "point": rng.uniform(-0.4, 0.4, 3).tolist()}
    keys = {"slide": hinge["axis"]} if rng.random() < 0.3 else {"hinge": hinge}
    offset = rng.uniform(-0.05, 0.05, 3)
    problem = problem_of(0.1, restitution, round_pad=False, com_offset=offset.tolist(), rpy=[0.0, 0.0, 0.0], **keys)
    body, object_ = problem.object, problem.physics.object
    body = replace(body, rotation=pin.exp3(np.array([0.0, rng.uniform(-1.0, 1.0), 0.0])))  # its face stays where it is
    along, to_hinge = body.rotation @ hinge["axis"], body.rotation @ hinge["point"]
    freedom = np.append(along, np.zeros(3)) if "slide" in keys else np.append(np.cross(-along, to_hinge), along)
    body = replace(body, twist=freedom * rng.uniform(-0.3, 0.3))
    problem = replace(problem, object=body)
    constraints = scipy.linalg.null_space(freedom[None]).T
    own = pin.SE3(body.rotation, np.zeros(3)).act(pin.Inertia(MASS, offset, np.diag(object_.inertia))).matrix()
    whole = np.block([[own, constraints.T], [constraints, np.zeros((5, 5))]])
    state, model = problem.arms["arm"], problem.physics.robot_model("arm")
    inertia = model.inertia(state.position, problem.motor_inertia["arm"])
    jacobian, place = model.jacobian(state.position), model.placement(state.position)
    points = find_contacts(problem.physics, contact_pairs(problem.physics, body, {"arm": place}))
    assert len(points) == 4
    of_door = np.array([[*p.normal, *np.cross(p.position - body.position, p.normal)] for p in points])
    levers = [p.partner_position - place.translation for p in points]
    of_arm = np.array([[*p.normal, *np.cross(r, p.normal)] for p, r in zip(points, levers, strict=True)]) @ jacobian
    response = np.linalg.solve(whole, np.vstack((of_door.T, np.zeros((5, 4)))))[:6]
    delassus = of_door @ response + of_arm @ np.linalg.solve(inertia, of_arm.T)
    speed = of_door @ body.twist - of_arm @ state.velocity
    wanted = speed + restitution * np.minimum(speed, 0.0)
    values, vectors = np.linalg.eigh(delassus)
    kept = values > 1e-9 * values[-1]  # four points of a face move in three ways
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = np.linalg.lstsq(root.T, wanted, rcond=None)[0]
    if np.max(np.abs(root.T @ target - wanted)) > 1e-9:  # of a face that closes and opens at once, with e > 0
        return
    impulse, _ = scipy.optimize.nnls(root, -target)
    result = compute_impact_map(problem)
    np.testing.assert_allclose(result.object_twist, body.twist + response @ impulse, atol=1e-6)
    after = state.velocity - np.linalg.solve(inertia, of_arm.T @ impulse)
    np.testing.assert_allclose(result.joint_velocity["arm"], after, atol=1e-6)
    assert result.residual.largest < 1e-8


def test_friction_settling_and_derivatives_know_the_hinge() -> None:
    """No energy is gained, the pad rests on the door in the end, and derivatives are differences of the map."""
    problem = problem_of(0.1, 0.0, 0.5, hinge=EDGE)
    result, settled = (
        compute_impact_map(problem),
        predict_impact(problem_of(0.1, round_pad=False, friction=0.5, hinge=EDGE), "settled"),
    )
    assert kinetic_energy(problem, result) < kinetic_energy(problem) and result.residual.largest < 1e-9
    assert settled.object_twist[1] < -0.05
    found = differentiate(problem)
    names = {one.name for one in found.parameters}
    assert {"object.mass", "object.inertia.z", "object.com_offset.x"} <= names
    assert not any(name.startswith(("object.velocity", "object.angular_velocity")) for name in names)
    step, sides = 1e-3, []
    for sign in (1.0, -1.0):
        heavier = replace(problem.physics.object, mass=MASS + sign * step)
        changed = replace(problem, physics=replace(problem.physics, object=heavier))
        sides.append(compute_impact_map(changed).object_twist)
    rows = [name.startswith("object.") for name in found.names]
    np.testing.assert_allclose(found.of("object.mass")[rows], (sides[0] - sides[1]) / (2.0 * step), atol=1e-6)
    low, high = predict(problem, Uncertainties(), draws=20).interval_of({"object.angular_velocity.z": 1.0})
    assert low < result.object_twist[5] < high < 0.0 or 0.0 < low < result.object_twist[5] < high


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"hinge": {"axis": [0.0, 0.0, 2.0], "point": [0.0, 0.0, 0.0]}}, "objects.door.hinge: axis must be a unit vector"),
    ({"hinge": {"axis": Z}}, "objects.door.hinge.point"),
    ({"hinge": EDGE, "slide": Z}, "slide stands beside hinge, expected one of them"),
    ({"hinge": EDGE, "fixed": True, "mass": None, "inertia": None}, "hinge stands beside fixed, expected one of them"),
    ({"slide": [1.0, 1.0, 0.0]}, "objects.door: slide must be a unit vector"),
    ({"hinge": EDGE | {"axes": Z}}, "objects.door.hinge.axes"),
]


@pytest.mark.parametrize(("keys", "message"), REFUSED)
def test_mistakes_in_hinges_name_key_and_remedy(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        validate(Scenario, scenario_of(**keys), "door.yaml")


def test_neighbours_are_not_hit_by_a_door_and_have_no_hinge() -> None:
    data = yaml.safe_load((config_directory() / "scenarios" / "push_two_boxes.yaml").read_text(encoding="utf-8"))
    name, own = next(iter(data["neighbours"].items()))
    data["neighbours"][name] = own | {"hinge": EDGE}
    with pytest.raises(InputError, match="neighbours on a hinge or slide are not supported"):
        validate(Scenario, data, "two.yaml")
    data["neighbours"][name] = own
    first = next(iter(data["objects"].values()))
    first["hinge"] = EDGE
    with pytest.raises(InputError, match="is on a hinge or slide and hits no neighbour: leave neighbours out"):
        validate(Scenario, data, "two.yaml")


def test_a_door_that_moves_in_another_way_is_refused() -> None:
    problem = problem_of(hinge=EDGE)
    with pytest.raises(InputError, match="object.twist = .*its hinge or slide leaves a multiple of"):
        compute_impact_map(replace(problem, object=replace(problem.object, twist=np.ones(6))))


def given_points(scene: Scene) -> object:
    problem = ImpactProblem.at_nominal_impact(scene)
    placements = {"arm": scene.models["arm"].placement(scene.arms["arm"].position)}
    points = tuple(find_contacts(scene.physics, contact_pairs(scene.physics, problem.object, placements)))
    return solve_measured(scene.physics, MeasuredImpact(problem.arms, problem.object, points))


REFUSERS: dict[str, Callable[[Scene], object]] = {
    "the engine bullet": lambda scene: predict_impact(ImpactProblem.at_nominal_impact(scene), engine="bullet"),
    "loose contents": lambda scene: LooseContents(1.0, 0).begin(SimpleNamespace(world=None, physics=scene.physics)),  # type: ignore[arg-type]
    "the search for a speed limit": lambda scene: Hits(scene, NO_THRESHOLDS),
    "a table of impacts": given_points,
}


@pytest.mark.parametrize("keys", [{"hinge": EDGE}, {"slide": [0.0, 1.0, 0.0]}])
@pytest.mark.parametrize("what", REFUSERS)
def test_what_knows_free_objects_alone_refuses_a_door(what: str, keys: dict[str, Any]) -> None:
    scene = Scene.resolve(validate(Scenario, scenario_of(**keys), "door.yaml"), "door", "case_1")
    predict_impact(ImpactProblem.at_nominal_impact(scene))
    said = f"{what} takes objects that are free or fixed, and this one has a hinge or slide; impact-rs map takes it"
    with pytest.raises(InputError, match=said):
        REFUSERS[what](scene)


def test_the_command_of_the_manual_opens_the_door(capsys: pytest.CaptureFixture[str]) -> None:
    """Hit in the middle, 0.3 m from the hinge, on the side of -y; omega and v of the middle belong together."""
    page = (Path(__file__).parents[2] / "docs" / "physics.md").read_text(encoding="utf-8")
    (command,) = [line for line in page.splitlines() if "impact-rs map hit_wall" in line]
    assert main([*shlex.split(command)[2:], "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    twist = answer["post"]["object_twist"]
    assert -0.2 < twist[1] < -0.05
    np.testing.assert_allclose(twist, [0.0, twist[1], 0.0, 0.0, 0.0, twist[1] / 0.3], atol=1e-12)
