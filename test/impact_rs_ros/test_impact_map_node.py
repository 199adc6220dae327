# SPDX-License-Identifier: Apache-2.0
"""The service answers good questions like the library, and bad ones with a reason."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Twist, Vector3
from impact_rs.msg import ObjectDescription, RobotState
from impact_rs.srv import ComputeImpactMap

from impact_msgs_py.conversions import pose_to_message, twist_from_message
from impact_rs_ros.graph import Graph
from impact_rs_sim.impact_map import ENGINES, compute_impact_map, settle
from impact_rs_sim.impact_map.derivatives import differentiate, velocity_names
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.uncertainty import predict
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.paths import config_directory
from impact_rs_sim.scenarios.scenario import load_scenario
from impact_rs_sim.scene import Scene

Ask = Callable[..., ComputeImpactMap.Response]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.resolve(load_scenario("push"), "cat_food", "2")


@pytest.fixture
def ask(graph: Graph) -> Ask:
    def call(**changes: object) -> ComputeImpactMap.Response:
        values: dict[str, object] = {
            "scenario": "push",
            "object_name": "cat_food",
            "case_name": "2",
            "motor_inertia": "reduced",
            "restitution": -1.0,
            "engine": "exact",
        }
        request = ComputeImpactMap.Request(**values | changes)
        return graph.call(ComputeImpactMap, "compute_impact_map", request, timeout=60.0)

    return call


def state(scene: Scene, **changes: object) -> RobotState:
    arm = scene.arms["arm"]
    values = {"robot": "arm", "joint_position": arm.position.tolist(), "joint_velocity": arm.velocity.tolist()}
    return RobotState(**values | changes)


def described(scene: Scene, **changes: object) -> ObjectDescription:
    x, y, z = scene.physics.object.size.tolist()
    values: dict[str, object] = {
        "name": "box",
        "mass": scene.physics.object.mass,
        "size": Vector3(x=x, y=y, z=z),
        "pose": pose_to_message(np.append(scene.object.position, [0.0, 0.0, 0.0, 1.0])),
        "twist": Twist(),
        "pad_friction": scene.physics.pad_friction,
        "support_friction": scene.physics.support_friction,
        "support_height": float(scene.physics.support_height or 0.0),
        "has_support": True,
    }
    return ObjectDescription(**values | changes)


def described_by(scene: Scene, **changes: object) -> dict[str, object]:
    return {"use_object_description": True, "object_description": described(scene, **changes)}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("model", ["reduced", "rotor", "zero"])
def test_the_answer_is_that_of_the_library(ask: Ask, scene: Scene, engine: str, model: str) -> None:
    answer = ask(engine=engine, motor_inertia=model)
    expected = compute_impact_map(ImpactProblem.at_nominal_impact(scene, model), engine)
    assert answer.success, answer.message
    assert answer.engine == engine
    np.testing.assert_allclose(answer.post[0].joint_velocity, expected.joint_velocity["arm"], atol=1e-9)
    twist = twist_from_message(answer.end_effector_twists[0].twist)
    np.testing.assert_allclose(twist, expected.end_effector_twist["arm"], atol=1e-9)
    assert len(answer.contacts) == len(expected.contacts)
    assert answer.contact == "first"


def test_the_settled_contact_is_asked_for_by_name(ask: Ask) -> None:
    scene = Scene.resolve(load_scenario("grab"), "cat_food", "2")
    expected = settle(ImpactProblem.at_nominal_impact(scene))
    answer = ask(scenario="grab", contact="settled")
    assert answer.success, answer.message
    assert (answer.contact, answer.engine) == ("settled", "exact")
    for post in answer.post:
        np.testing.assert_allclose(post.joint_velocity, expected.joint_velocity[post.robot], atol=1e-9)
    assert answer.elapsed > 0.0


def test_intervals_and_derivatives_come_where_they_are_requested(ask: Ask, scene: Scene) -> None:
    problem = ImpactProblem.at_nominal_impact(scene)
    plain, answer = ask(), ask(uncertainty=True, derivatives=True)
    assert not (plain.velocity_names or plain.velocity or plain.velocity_low or plain.parameter_names)
    assert plain.spread == answer.spread == pytest.approx(uniqueness_of(problem).relative, abs=1e-9)
    assert tuple(answer.velocity_names) == velocity_names(problem)
    expected = predict(problem, load_scenario("push").uncertainty)
    np.testing.assert_allclose(answer.velocity_low, expected.low, atol=1e-9)
    np.testing.assert_allclose(answer.velocity_high, expected.high, atol=1e-9)
    assert np.all(np.array(answer.velocity_low) <= np.array(answer.velocity) + 1e-9)
    found = differentiate(problem)
    assert list(zip(answer.parameter_names, answer.parameter_units, strict=True)) == [
        (parameter.name, parameter.unit) for parameter in found.parameters
    ]
    table = np.reshape(answer.derivatives, (len(answer.velocity_names), -1))
    np.testing.assert_allclose(table, found.jacobian, atol=1e-7)
    twist = twist_from_message(answer.end_effector_twists[0].twist)
    of_pad = [answer.velocity_names.index(f"arm.velocity.{axis}") for axis in "xyz"]
    np.testing.assert_allclose(np.array(answer.velocity)[of_pad], twist[:3], atol=1e-4)


def test_intervals_of_the_settled_contact_are_refused(ask: Ask) -> None:
    answer = ask(contact="settled", uncertainty=True)
    assert not answer.success
    assert "first contact" in answer.message


def test_explicit_values_give_the_same_answer_as_the_scenario(ask: Ask, scene: Scene) -> None:
    diagonal = scene.physics.arms["arm"].motor_inertia_reduced.tolist()
    answer = ask(
        robots=[state(scene)],
        **described_by(scene),
        motor_inertia="diagonal",
        motor_inertia_diagonal=diagonal,
        restitution=scene.physics.restitution,
    )
    assert answer.success, answer.message
    assert answer.body_twists[0].body == "box"
    np.testing.assert_allclose(answer.post[0].joint_velocity, ask().post[0].joint_velocity, atol=1e-9)


BAD: dict[str, tuple[Callable[[Scene], dict[str, object]], str]] = {
    "scenario": (lambda s: {"scenario": "nowhere"}, "no scenario"),
    "object": (lambda s: {"object_name": "piano"}, "no object 'piano'"),
    "case": (lambda s: {"case_name": "9"}, "no case '9'"),
    "engine": (lambda s: {"engine": "steam"}, "engine 'steam'"),
    "contact": (lambda s: {"contact": "last"}, "no contact 'last'; known: first, settled"),
    "motor-inertia model": (lambda s: {"motor_inertia": "large"}, "motor-inertia model"),
    "robot": (lambda s: {"robots": [state(s, robot="leg")]}, "no robot 'leg'"),
    "non-finite position": (lambda s: {"robots": [state(s, joint_position=[math.nan] * 7)]}, "finite"),
    "infinite velocity": (lambda s: {"robots": [state(s, joint_velocity=[math.inf] * 7)]}, "finite"),
    "too few joints": (lambda s: {"robots": [state(s, joint_position=[0.0] * 6)]}, "7 values"),
    "position out of limits": (lambda s: {"robots": [state(s, joint_position=[9.0] * 7)]}, "outside its limits"),
    "velocity out of limits": (lambda s: {"robots": [state(s, joint_velocity=[9.0] * 7)]}, "faster than its limit"),
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
    "negative mass": (lambda s: described_by(s, mass=-1.0), "mass > 0"),
    "flat object": (lambda s: described_by(s, size=Vector3()), "values > 0"),
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
