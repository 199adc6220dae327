# SPDX-License-Identifier: Apache-2.0
"""The service answers good questions like the library, and bad ones with a reason."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
import yaml
from geometry_msgs.msg import Inertia, Point, Twist, Vector3
from impact_rs.msg import ImpactObject, RobotState
from impact_rs.msg import ImpactProblem as ImpactProblemMessage
from impact_rs.srv import ComputeImpactMap, ImpactDerivatives, ImpactIntervals, PredictImpact
from sensor_msgs.msg import JointState
from shape_msgs.msg import Mesh, MeshTriangle, SolidPrimitive
from std_msgs.msg import Header

from impact_msgs_py.conversions import (
    joint_state_to_message,
    point_to_message,
    pose_to_message,
    twist_from_message,
    twist_to_message,
)
from impact_rs_ros.graph import Graph
from impact_rs_sim.impact_map import ENGINES, compute_impact_map, settle
from impact_rs_sim.impact_map.derivatives import differentiate, velocity_names
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.uncertainty import predict
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import BodyState, Scene
from impact_rs_sim.shapes import CAPSULE, hull_of

Ask = Callable[..., Any]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.resolve(load_scenario("push"), "cat_food", "2")


@pytest.fixture
def ask(graph: Graph) -> Ask:
    """Calls a service of the node; keys of the request itself are engine and contact, all others of its problem."""

    def call(kind: Any = PredictImpact, **changes: object) -> Any:
        name = {PredictImpact: "predict", ImpactIntervals: "intervals", ImpactDerivatives: "derivatives"}[kind]
        how = {key: changes.pop(key) for key in ("engine", "contact") if key in changes}
        values: dict[str, object] = {"scenario": "push", "object_name": "cat_food", "case_name": "2"}
        request = kind.Request(problem=ImpactProblemMessage(**values | changes), **how)
        return graph.call(kind, f"impact_map/{name}", request, timeout=60.0)

    return call


def joints(scene: Scene, **changes: object) -> JointState:
    """The nominal state of the arm, tip first."""
    arm = scene.arms["arm"]
    names = [f"arm_joint{number}" for number in range(7, 0, -1)]
    state = joint_state_to_message(names, arm.position[::-1], arm.velocity[::-1])
    for name, value in changes.items():
        setattr(state, name, value)
    return state


def described(scene: Scene, **changes: object) -> ImpactObject:
    values: dict[str, object] = {
        "name": "box",
        "primitive": SolidPrimitive(type=SolidPrimitive.BOX, dimensions=scene.physics.object.size.tolist()),
        "inertia": Inertia(m=scene.physics.object.mass),
        "pose": pose_to_message(np.append(scene.object.position, [0.0, 0.0, 0.0, 1.0])),
        "twist": Twist(),
        "pad_friction": scene.physics.pad_friction,
        "support_friction": scene.physics.support_friction,
        "support_height": float(scene.physics.support_height or 0.0),
        "has_support": True,
    }
    return ImpactObject(**values | changes)


def described_by(scene: Scene, **changes: object) -> dict[str, object]:
    return {"object": [described(scene, **changes)]}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("model", ["reduced", "rotor", "zero"])
def test_the_answer_is_that_of_the_library(ask: Ask, scene: Scene, engine: str, model: str) -> None:
    answer = ask(engine=engine, motor_inertia=model)
    expected = compute_impact_map(ImpactProblem.at_nominal_impact(scene, model), engine)
    assert answer.success, answer.message
    assert answer.engine == engine
    assert list(answer.joint_state.name) == [f"arm_joint{number}" for number in range(1, 8)]
    np.testing.assert_array_equal(answer.joint_state.position, scene.arms["arm"].position)
    np.testing.assert_allclose(answer.joint_state.velocity, expected.joint_velocity["arm"], atol=1e-9)
    twist = twist_from_message(answer.end_effector_twists[0].twist)
    np.testing.assert_allclose(twist, expected.end_effector_twist["arm"], atol=1e-9)
    assert len(answer.contacts) == len(expected.contacts)
    assert answer.residual.momentum == pytest.approx(expected.residual.momentum, abs=1e-12)
    assert answer.contact == "first"


def test_the_settled_contact_is_asked_for_by_name(ask: Ask) -> None:
    scene = Scene.resolve(load_scenario("grab"), "cat_food", "2")
    expected = settle(ImpactProblem.at_nominal_impact(scene))
    answer = ask(scenario="grab", contact="settled")
    assert answer.success, answer.message
    assert (answer.contact, answer.engine) == ("settled", "exact")
    velocity = np.concatenate([expected.joint_velocity[name] for name in ("left", "right")])
    assert [name[:-7] for name in answer.joint_state.name] == ["left"] * 7 + ["right"] * 7
    np.testing.assert_allclose(answer.joint_state.velocity, velocity, atol=1e-9)
    assert answer.elapsed > 0.0


def test_a_scenario_keeps_its_law_of_restitution(ask: Ask, tmp_path: Path) -> None:
    """Fails by 0.35 where the node builds its problem without the scenario's law."""
    text = yaml.safe_load((config_directory() / "scenarios" / "grab.yaml").read_text())
    text["contact"] |= {"friction": 0.1, "restitution": 0.4, "restitution_law": "poisson"}
    path = tmp_path / "poisson.yaml"
    path.write_text(yaml.safe_dump(text))
    scenario = load_scenario(str(path))
    name, case = next(iter(scenario.objects)), next(iter(scenario.cases))
    expected = compute_impact_map(ImpactProblem.at_nominal_impact(Scene.resolve(scenario, name, case)))
    answer = ask(scenario=str(path), object_name=name, case_name=case)
    assert answer.success, answer.message
    np.testing.assert_allclose(
        twist_from_message(answer.body_twists[0].twist), expected.object_twist, rtol=0, atol=1e-9
    )


def test_intervals_and_derivatives_have_services_of_their_own(ask: Ask, scene: Scene) -> None:
    problem = ImpactProblem.at_nominal_impact(scene)
    plain, intervals, derivatives = ask(), ask(ImpactIntervals), ask(ImpactDerivatives)
    assert intervals.success and derivatives.success, intervals.message + derivatives.message
    assert plain.spread == pytest.approx(uniqueness_of(problem).relative, abs=1e-9)
    assert tuple(intervals.velocity_names) == tuple(derivatives.velocity_names) == velocity_names(problem)
    expected = predict(problem, load_scenario("push").uncertainty)
    np.testing.assert_allclose(intervals.low, expected.low, atol=1e-9)
    np.testing.assert_allclose(intervals.high, expected.high, atol=1e-9)
    np.testing.assert_allclose(intervals.velocity, expected.nominal, atol=1e-9)
    found = differentiate(problem)
    assert list(zip(derivatives.parameter_names, derivatives.parameter_units, strict=True)) == [
        (parameter.name, parameter.unit) for parameter in found.parameters
    ]
    table = np.reshape(derivatives.derivatives, (len(derivatives.velocity_names), -1))
    np.testing.assert_allclose(table, found.jacobian, atol=1e-7)
    twist = twist_from_message(plain.end_effector_twists[0].twist)
    of_pad = [derivatives.velocity_names.index(f"arm.velocity.{axis}") for axis in "xyz"]
    np.testing.assert_allclose(np.array(derivatives.velocity)[of_pad], twist[:3], atol=1e-4)


def test_explicit_values_give_the_same_answer_as_the_scenario(ask: Ask, scene: Scene) -> None:
    diagonal = scene.physics.arms["arm"].motor_inertia_reduced.tolist()
    answer = ask(
        joint_state=joints(scene),
        **described_by(scene, header=Header(frame_id="world")),
        motor_inertia="diagonal",
        motor_inertia_diagonal=diagonal,
        restitution=scene.physics.restitution,
    )
    assert answer.success, answer.message
    assert answer.body_twists[0].body == "box"
    np.testing.assert_allclose(answer.joint_state.velocity, ask().joint_state.velocity, atol=1e-9)


def expected_of(scene: Scene, body: ObjectPhysics, state: BodyState) -> np.ndarray:
    """Twist of an object in the scene's object's place, after the impact."""
    problem = ImpactProblem.at_nominal_impact(scene)
    changed = replace(problem, physics=replace(scene.physics, object=body), object=state)
    return compute_impact_map(changed).object_twist


def test_a_capsule_with_an_inertia_of_its_own_is_that_of_the_library(ask: Ask, scene: Scene) -> None:
    """Fails where height and radius are swapped, where moments or centre of mass are dropped, or for a cylinder."""
    size, moments, com = scene.physics.object.size, np.array([0.004, 0.005, 0.002]), np.array([0.0, 0.004, 0.01])
    radius = float(size[1]) / 2.0
    body = ObjectPhysics(0.7, np.array([2 * radius, 2 * radius, size[2]]), moments, com, CAPSULE)
    state = BodyState(scene.object.position, np.eye(3), np.zeros(6))
    solid = SolidPrimitive(type=SolidPrimitive.CYLINDER, dimensions=[float(size[2]), radius])
    inertia = Inertia(m=0.7, com=Vector3(y=com[1], z=com[2]), ixx=moments[0], iyy=moments[1], izz=moments[2])
    answer = ask(**described_by(scene, primitive=solid, rounded=True, inertia=inertia, has_support=False))
    assert answer.success, answer.message
    free = replace(scene, physics=replace(scene.physics, support_height=None))
    np.testing.assert_allclose(
        twist_from_message(answer.body_twists[0].twist), expected_of(free, body, state), atol=1e-9
    )


def test_a_mesh_is_its_hull_wherever_its_own_frame_lies(ask: Ask, scene: Scene) -> None:
    """A box as a mesh about a corner of it, which turns: fails where pose or twist are taken at the centre."""
    size = scene.physics.object.size
    corners = np.array(list(itertools.product(*((0.0, float(extent)) for extent in size))))
    hull = scipy.spatial.ConvexHull(corners)
    triangles = [  # outwards
        one if np.cross(*(corners[one[1:]] - corners[one[0]])) @ plane[:3] > 0.0 else one[::-1]
        for one, plane in zip(hull.simplices, hull.equations, strict=True)
    ]
    mesh = Mesh(
        triangles=[MeshTriangle(vertex_indices=one.astype(np.uint32)) for one in triangles],
        vertices=[point_to_message(corner) for corner in corners],
    )
    twist = np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.3])
    pose = pose_to_message(np.append(scene.object.position - size / 2.0, [0.0, 0.0, 0.0, 1.0]))
    answer = ask(**described_by(scene, mesh=mesh, pose=pose, twist=twist_to_message(twist)))
    assert answer.success, answer.message
    middle = twist + np.append(np.cross(twist[3:], size / 2.0), np.zeros(3))
    box = scene.physics.object
    body = replace(box, com_offset=np.zeros(3), shape=hull_of(tuple(map(tuple, corners - size / 2.0))))
    expected = expected_of(scene, body, BodyState(scene.object.position, np.eye(3), middle))
    np.testing.assert_allclose(twist_from_message(answer.body_twists[0].twist), expected, atol=1e-8)


def test_a_client_of_the_former_service_gets_a_sentence(graph: Graph, ask: Ask) -> None:
    state = RobotState(robot="arm", joint_position=[0.0] * 7, joint_velocity=[0.0] * 7)
    request = ComputeImpactMap.Request(scenario="push", object_name="cat_food", case_name="2", robots=[state])
    answer = graph.call(ComputeImpactMap, "compute_impact_map", request, timeout=60.0)
    assert not answer.success
    assert "call impact_map/predict (impact_rs/srv/PredictImpact)" in answer.message
    assert ask().success


TETRAHEDRON = [Point(), Point(x=0.1), Point(y=0.1), Point(z=0.1)]
BAD: dict[str, tuple[Callable[[Scene], dict[str, object]], str]] = {
    "scenario": (lambda s: {"scenario": "nowhere"}, "no scenario"),
    "object": (lambda s: {"object_name": "piano"}, "no object 'piano'"),
    "case": (lambda s: {"case_name": "9"}, "no case '9'"),
    "engine": (lambda s: {"engine": "steam"}, "engine 'steam'"),
    "contact": (lambda s: {"contact": "last"}, "no contact 'last'; known: first, settled"),
    "motor-inertia model": (lambda s: {"motor_inertia": "large"}, "motor-inertia model"),
    "joint": (
        lambda s: {"joint_state": joints(s, name=[f"leg_joint{number}" for number in range(1, 8)])},
        "no joint leg_joint1, ",
    ),
    "joint twice": (  # kills: the last of its values counts
        lambda s: {
            "joint_state": joint_state_to_message(
                [*(f"arm_joint{number}" for number in range(1, 8)), "arm_joint1"],
                [*s.arms["arm"].position, 2.0],
                [*s.arms["arm"].velocity, 0.0],
            )
        },
        "expected every joint once, arm_joint1",
    ),
    "non-finite position": (lambda s: {"joint_state": joints(s, position=[math.nan] * 7)}, "finite"),
    "infinite velocity": (lambda s: {"joint_state": joints(s, velocity=[math.inf] * 7)}, "finite"),
    "too few positions": (lambda s: {"joint_state": joints(s, position=[0.0] * 6)}, "7 values"),
    "too few joints": (
        lambda s: {"joint_state": joint_state_to_message(["arm_joint2"], [0.0], [0.0])},
        "every joint of 'arm', arm_joint1, arm_joint3",
    ),
    "position out of limits": (lambda s: {"joint_state": joints(s, position=[9.0] * 7)}, "outside its limits"),
    "velocity out of limits": (lambda s: {"joint_state": joints(s, velocity=[9.0] * 7)}, "faster than its limit"),
    "negative motor inertia": (
        lambda s: {"motor_inertia": "diagonal", "motor_inertia_diagonal": [-0.1] * 7},
        "motor inertia >= 0",
    ),
    "too few motor inertias": (
        lambda s: {"motor_inertia": "diagonal", "motor_inertia_diagonal": [0.1] * 3},
        "one per joint",
    ),
    "restitution above one": (lambda s: {"restitution": 1.5}, "restitution between 0 and 1"),
    "restitution not a number": (lambda s: {"restitution": math.nan}, "restitution between 0 and 1"),
    "negative mass": (lambda s: described_by(s, inertia=Inertia(m=-1.0)), "object.mass = -1.0"),
    "moments of no body": (
        lambda s: described_by(s, inertia=Inertia(m=1.0, ixx=1.0, iyy=0.1, izz=0.1)),
        "no rigid body has these moments",
    ),
    "products of inertia": (
        lambda s: described_by(s, inertia=Inertia(m=1.0, ixx=0.01, iyy=0.01, izz=0.01, ixy=0.004)),
        "to its principal axes",
    ),
    "flat object": (
        lambda s: described_by(s, primitive=SolidPrimitive(type=SolidPrimitive.BOX, dimensions=[0.1, 0.0, 0.1])),
        "every entry must be > 0",
    ),
    "no shape": (lambda s: described_by(s, primitive=SolidPrimitive()), "expected BOX (1) with x, y, z"),
    "open mesh": (lambda s: described_by(s, mesh=Mesh(vertices=TETRAHEDRON)), "does not close around a volume"),
    "mesh without a corner": (
        lambda s: described_by(
            s, mesh=Mesh(vertices=TETRAHEDRON, triangles=[MeshTriangle(vertex_indices=np.array([0, 1, 9], np.uint32))])
        ),
        "object.mesh",
    ),
    "other frame": (lambda s: described_by(s, header=Header(frame_id="camera")), "object.header.frame_id = 'camera'"),
    "no orientation": (
        lambda s: described_by(s, pose=pose_to_message(np.append(s.object.position, [0.0] * 4))),
        "unit quaternion",
    ),
    "penetration": (
        lambda s: described_by(
            s, pose=pose_to_message(np.append(s.object.position + [0.0, 0.03, 0.0], [0.0, 0.0, 0.0, 1.0]))
        ),
        "penetrates",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_question_is_answered_with_a_reason(ask: Ask, scene: Scene, name: str) -> None:
    changes, reason = BAD[name]
    answer = ask(**changes(scene))
    assert not answer.success
    assert reason in answer.message
    assert ask().success


def test_an_unreachable_pose_is_refused(ask: Ask, tmp_path: Path) -> None:
    far = yaml.safe_load((config_directory() / "scenarios" / "push.yaml").read_text())
    far["robots"]["arm"]["impact"]["position"] = [2.0, 0.0, 0.5]
    path = tmp_path / "far.yaml"
    path.write_text(yaml.safe_dump(far))
    answer = ask(scenario=str(path))
    assert not answer.success
    assert "arm" in answer.message or "reach" in answer.message
