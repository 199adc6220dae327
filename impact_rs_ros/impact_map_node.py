# SPDX-License-Identifier: Apache-2.0
"""The impact map as services: ``impact_map/predict``, ``impact_map/intervals`` and ``impact_map/derivatives``."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from impact_rs.msg import ContactPoint, ImpactObject, ImpactResidual, RigidBodyTwist
from impact_rs.msg import ImpactProblem as ImpactProblemMessage
from impact_rs.srv import ComputeImpactMap, ImpactDerivatives, ImpactIntervals, PredictImpact
from sensor_msgs.msg import JointState
from shape_msgs.msg import SolidPrimitive

from impact_msgs_py.conversions import (
    joint_state_to_message,
    point_from_message,
    point_to_message,
    pose_from_message,
    twist_from_message,
    twist_to_message,
    vector_from_message,
    vector_to_message,
)
from impact_rs_ros.process import NodeProgram, run
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.impact_map import ImpactMapError, predict_impact
from impact_rs_sim.impact_map.contacts import OBJECT
from impact_rs_sim.impact_map.derivatives import differentiate, velocity_names
from impact_rs_sim.impact_map.problem import ImpactProblem, ImpactResult
from impact_rs_sim.impact_map.uncertainty import predict
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.object_mesh import MAX_PRODUCT_SHARE, object_mesh
from impact_rs_sim.scenarios.object_spec import ObjectSpec
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.schema import validate
from impact_rs_trials.bags.messages import joints_of
from impact_rs_trials.spec import TrialSpec

WORLD = ("", "world")  # frames in which an object may be described
FORMER = (
    "ComputeImpactMap has ended: call impact_map/predict (impact_rs/srv/PredictImpact), impact_map/intervals "
    "(ImpactIntervals) or impact_map/derivatives (ImpactDerivatives); CHANGELOG.rst says which field became which"
)


class ImpactMapNode(NodeProgram):
    """Serves predictions of the impact map; an invalid request is answered with the reason."""

    kind = "impact_map"

    def __init__(self) -> None:
        super().__init__()
        self._answered = 0
        self._refused = 0

    def offer(self) -> None:
        answers: dict[type, tuple[str, Callable[[Any, Any, ImpactProblem, Scene], str]]] = {
            PredictImpact: ("predict", self._predict),
            ImpactIntervals: ("intervals", _intervals),
            ImpactDerivatives: ("derivatives", _derivatives),
        }
        for kind, (name, answer) in answers.items():
            self.node.create_service(kind, f"~/{name}", partial(self._on_request, answer))
        self.node.create_service(ComputeImpactMap, "compute_impact_map", self._on_former_request)

    def status(self) -> tuple[str, dict[str, object]]:
        return "ok", {"answered": self._answered, "refused": self._refused}

    def _on_request(self, answer: Callable[[Any, Any, ImpactProblem, Scene], str], request: Any, response: Any) -> Any:
        """Fill a response by ``answer``, which returns a summary for the log."""
        started = time.perf_counter()
        problem_message = request.problem
        try:
            scenario = self.scenario(problem_message.scenario)
            object_name = problem_message.object_name or (
                next(iter(scenario.objects)) if problem_message.object else ""
            )
            scene = TrialSpec.of(
                scenario, object_name, problem_message.case_name
            ).scene  # the same every time: its engine stays warm
            summary = answer(request, response, _problem(problem_message, scene), scene)
            response.success = True
            self._answered += 1
            self.log.info(f"answered {_object_name(problem_message)}, case {problem_message.case_name!r}, {summary}")
        except (InputError, ImpactMapError) as error:
            self._refuse(response, str(error))
        except Exception as error:  # no request ends a node
            self.log.error(full_traceback(error))
            self._refuse(response, f"the impact map failed: {type(error).__name__}: {error}")
        response.elapsed = time.perf_counter() - started
        return response

    def _on_former_request(
        self, request: ComputeImpactMap.Request, response: ComputeImpactMap.Response
    ) -> ComputeImpactMap.Response:
        del request
        self._refuse(response, FORMER)
        return response

    def _refuse(self, response: Any, reason: str) -> None:
        self.log.warning(f"refused: {reason}")
        response.message = reason
        self._refused += 1

    def _predict(
        self, request: PredictImpact.Request, response: PredictImpact.Response, problem: ImpactProblem, scene: Scene
    ) -> str:
        response.contact = request.contact or self.parameter("contact")
        result = predict_impact(problem, response.contact, request.engine or self.parameter("engine"))
        response.engine = result.engine  # the settled contact has only one
        if response.contact == "first":
            several = uniqueness_of(problem, scene.models)
            response.spread, response.message = several.relative, several.warning  # no warning if u^+ is unique
        _fill(response, problem, result, _object_name(request.problem))
        return f"by engine {response.engine}, contact {response.contact}"


def _intervals(
    request: ImpactIntervals.Request, response: ImpactIntervals.Response, problem: ImpactProblem, scene: Scene
) -> str:
    del request
    prediction = predict(problem, scene.scenario.uncertainty, scene.models)
    response.velocity_names = list(velocity_names(problem))
    response.velocity = prediction.nominal.tolist()
    response.low, response.high = prediction.low.tolist(), prediction.high.tolist()
    return "intervals"


def _derivatives(
    request: ImpactDerivatives.Request, response: ImpactDerivatives.Response, problem: ImpactProblem, scene: Scene
) -> str:
    del request
    sensitivities = differentiate(problem, scene.models)
    response.velocity_names, response.velocity = list(velocity_names(problem)), sensitivities.velocities.tolist()
    response.parameter_names = [parameter.name for parameter in sensitivities.parameters]
    response.parameter_units = [parameter.unit for parameter in sensitivities.parameters]
    response.derivatives = sensitivities.jacobian.ravel().tolist()
    return "derivatives"


def _object_name(problem_message: ImpactProblemMessage) -> str:
    return str(problem_message.object[0].name if problem_message.object else problem_message.object_name)


def _problem(problem_message: ImpactProblemMessage, scene: Scene) -> ImpactProblem:
    """Impact problem of a request: the nominal impact of the scene, with the changes of the request."""
    scene.scenario.check_chains("this service, whose messages have joints alone,")
    diagonal = problem_message.motor_inertia == "diagonal"
    problem = ImpactProblem.at_nominal_impact(
        scene, "reduced" if diagonal else problem_message.motor_inertia or "reduced"
    )
    if problem_message.object:
        physics, body = _described(scene.physics, problem_message.object[0])
        problem = replace(problem, physics=physics, object=body)
    if problem_message.joint_state.name:
        problem = replace(problem, arms=scene.arms | _arms(problem_message.joint_state, scene.physics))
    if diagonal:
        problem = replace(
            problem, motor_inertia=_diagonal(np.array(problem_message.motor_inertia_diagonal), scene.physics)
        )
    return problem if problem_message.restitution < 0.0 else replace(problem, restitution=problem_message.restitution)


def _arms(joint_state: JointState, physics: Physics) -> dict[str, ArmState]:
    """States of the arms whose joints are named."""
    for name in ("position", "velocity"):
        if len(getattr(joint_state, name)) != len(joint_state.name):
            raise InputError(
                f"expected {len(joint_state.name)} values, one per name, got {len(getattr(joint_state, name))}",
                key=f"joint_state.{name}",
            )
    if repeated := [name for name in dict.fromkeys(joint_state.name) if joint_state.name.count(name) > 1]:
        raise InputError(f"expected every joint once, {', '.join(repeated)} stands there again", key="joint_state.name")
    states = dict(zip(joint_state.name, zip(joint_state.position, joint_state.velocity, strict=True), strict=True))
    arms, all_joints = {}, joints_of(physics)
    for arm, joints in all_joints.items():
        if states.keys().isdisjoint(joints):
            continue
        if missing := [joint for joint in joints if joint not in states]:
            raise InputError(f"expected every joint of {arm!r}, {', '.join(missing)} too", key="joint_state.name")
        position, velocity = np.array([states.pop(joint) for joint in joints]).T
        arms[arm] = ArmState(position, velocity)
    if states:
        expected = ", ".join(f"{joints[0]} to {joints[-1]}" for joints in all_joints.values())
        raise InputError(f"no joint {', '.join(states)}; known: {expected}", key="joint_state.name")
    return arms


def _described(physics: Physics, described: ImpactObject) -> tuple[Physics, BodyState]:
    """Physics and state with the object of a request; the impact problem checks the remaining values."""
    pose, twist = pose_from_message(described.pose), twist_from_message(described.twist)
    if described.header.frame_id not in WORLD:
        raise InputError("expected world", key="object.header.frame_id", value=described.header.frame_id)
    if not abs(np.linalg.norm(pose[3:]) - 1.0) < 1e-3:
        raise InputError(
            "expected a unit quaternion (x, y, z, w)", key="object.pose.orientation", value=pose[3:].tolist()
        )
    body, centre = _body(described)
    rotation = pin.Quaternion(pose[3:] / np.linalg.norm(pose[3:])).matrix()
    arm = rotation @ centre  # from the origin of its own frame to its geometric centre
    twist[:3] += np.cross(twist[3:], arm)
    changed = replace(
        physics,
        object=body,
        pad_friction=described.pad_friction,
        support_friction=described.support_friction,
        support_height=described.support_height if described.has_support else None,
    )
    return changed, BodyState(pose[:3] + arm, rotation, twist)


def _body(described: ImpactObject) -> tuple[ObjectPhysics, Array]:
    """The body, and its geometric centre in its own frame, ``(3,)`` [m].

    Raises:
        InputError: No scenario could have this body.
    """
    inertia, centre = described.inertia, np.zeros(3)
    products = np.abs([inertia.ixy, inertia.ixz, inertia.iyz])
    moments = np.array([inertia.ixx, inertia.iyy, inertia.izz])
    if not products.max() <= MAX_PRODUCT_SHARE * moments.sum():
        raise InputError(
            "expected products of inertia 0: turn its own frame to its principal axes", key="object.inertia"
        )
    fields: dict[str, Any] = {"label": described.name, "mass": inertia.m}
    com = vector_from_message(inertia.com)
    if described.mesh.vertices:
        points = np.array([point_from_message(vertex) for vertex in described.mesh.vertices])
        triangles = np.array([triangle.vertex_indices for triangle in described.mesh.triangles], dtype=int)
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        try:
            mesh = object_mesh(points, triangles.reshape(-1, 3), Path("object.mesh"))
        except IndexError as error:
            raise InputError(str(error), key="object.mesh") from None
        fields |= {"shape": "hull", "corners": mesh.corners.tolist(), "size": mesh.size.tolist()}
        com = com - centre if moments.any() else mesh.com
        moments = moments if moments.any() else inertia.m * mesh.moments
    else:
        fields["shape"], fields["size"] = _filled(described.primitive, described.rounded)
    if moments.any():
        fields["inertia"] = moments.tolist()
    try:
        spec = validate(ObjectSpec, fields | {"com_offset": com.tolist()}, None)
    except InputError as error:
        raise InputError(
            error.message, key=f"object.{error.key}" if error.key else "object", value=error.value
        ) from None
    return ObjectPhysics(inertia.m, np.array(spec.size), spec.moments, com, spec.form), centre


def _filled(primitive: SolidPrimitive, rounded: bool) -> tuple[str, list[float]]:
    """Shape and extents [m] of a primitive."""
    counts = {SolidPrimitive.BOX: 3, SolidPrimitive.SPHERE: 1, SolidPrimitive.CYLINDER: 2}
    sizes = [float(size) for size in primitive.dimensions]
    if counts.get(primitive.type) != len(sizes):
        raise InputError(
            "expected BOX (1) with x, y, z, SPHERE (2) with radius, or CYLINDER (3) with height, radius",
            key="object.primitive",
            value=[primitive.type, *sizes],
        )
    if primitive.type == SolidPrimitive.BOX:
        return "box", sizes
    diameter = 2.0 * sizes[-1]
    if primitive.type == SolidPrimitive.SPHERE:
        return "sphere", [diameter] * 3
    return "capsule" if rounded else "cylinder", [diameter, diameter, sizes[0]]


def _diagonal(values: Array, physics: Physics) -> dict[str, Array]:
    """Motor inertias of a request by arm; the values of a single arm apply to every arm."""
    counts = [arm.facts.joint_count for arm in physics.arms.values()]
    if values.size == sum(counts):
        parts = np.split(values, np.cumsum(counts)[:-1])
    elif all(values.size == count for count in counts):
        parts = [values] * len(counts)
    else:
        raise InputError(
            f"expected {sum(counts)} values, one per joint [kg m^2], prismatic [kg], got {values.size}",
            key="motor_inertia_diagonal",
        )
    return dict(zip(physics.arms, parts, strict=True))


def _fill(response: PredictImpact.Response, problem: ImpactProblem, result: ImpactResult, object_name: str) -> None:
    names = [joint for joints in joints_of(problem.physics).values() for joint in joints]
    position, velocity = (
        np.concatenate([values[name] for name in problem.physics.arms])
        for values in ({name: arm.position for name, arm in problem.arms.items()}, result.joint_velocity)
    )
    response.joint_state = joint_state_to_message(names, position, velocity)
    response.end_effector_twists = [_twist(name, twist) for name, twist in result.end_effector_twist.items()]
    named = {OBJECT: object_name}
    response.body_twists = [_twist(named.get(name, name), twist) for name, twist in result.twists.items()]
    response.contacts = [
        ContactPoint(
            body_a=named.get(contact.body_a, contact.body_a),
            body_b=named.get(contact.body_b, contact.body_b),
            position=point_to_message(contact.position),
            normal=vector_to_message(contact.normal),
            impulse=vector_to_message(contact.impulse),
        )
        for contact in result.contacts
    ]
    names_of_laws = ImpactResidual.get_fields_and_field_types()
    response.residual = ImpactResidual(**{name: float(getattr(result.residual, name)) for name in names_of_laws})


def _twist(body: str, twist: Any) -> RigidBodyTwist:
    return RigidBodyTwist(body=body, twist=twist_to_message(twist))


def main() -> None:
    """Run the node."""
    run(ImpactMapNode)


if __name__ == "__main__":
    main()
