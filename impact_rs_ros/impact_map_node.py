# SPDX-License-Identifier: Apache-2.0
"""The impact map as a service, ``/compute_impact_map``."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from impact_rs.msg import ContactPoint, ImpactResidual, ObjectDescription, RigidBodyTwist, RobotState
from impact_rs.srv import ComputeImpactMap

from impact_msgs_py.conversions import (
    point_to_message,
    pose_from_message,
    twist_from_message,
    twist_to_message,
    vector_from_message,
    vector_to_message,
)
from impact_rs_ros.process import NodeProgram, run
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.impact_map import ImpactMapError, engine_name, predict_impact
from impact_rs_sim.impact_map.derivatives import differentiate, velocity_names
from impact_rs_sim.impact_map.problem import ImpactProblem, ImpactResult
from impact_rs_sim.impact_map.uncertainty import predict
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, ObjectPhysics, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_trials.spec import TrialSpec


class ImpactMapNode(NodeProgram):
    """Serves predictions of the impact map; an invalid request is answered with the reason."""

    kind = "impact_map"

    def __init__(self) -> None:
        super().__init__()
        self._answered = 0
        self._refused = 0

    def offer(self) -> None:
        self.node.create_service(ComputeImpactMap, "compute_impact_map", self._on_request)

    def status(self) -> tuple[str, dict[str, object]]:
        return "ok", {"answered": self._answered, "refused": self._refused}

    def _on_request(
        self, request: ComputeImpactMap.Request, response: ComputeImpactMap.Response
    ) -> ComputeImpactMap.Response:
        started = time.perf_counter()
        engine = engine_name(request.engine or self.parameter("engine"))
        contact = request.contact or self.parameter("contact")
        try:
            scenario = self.scenario(request.scenario)
            problem, models = self._problem(request, scenario)
            name = request.object_description.name if request.use_object_description else request.object_name
            result = predict_impact(problem, contact, engine)
            _fill(response, problem, result, name)
            if contact == "first":
                several = uniqueness_of(problem, models)
                response.spread = several.relative
                response.message = several.warning  # empty if u^+ is unique
            _fill_more(response, request, problem, scenario, models, contact)
            engine = result.engine  # the settled contact has only one
            response.success = True
            self._answered += 1
            self.log.info(f"answered {name}, case {request.case_name!r}, by engine {engine}, contact {contact}")
        except (InputError, ImpactMapError) as error:
            self.log.warning(f"refused: {error}")
            response.message = str(error)
            self._refused += 1
        except Exception as error:  # no request ends a node
            self.log.error(full_traceback(error))
            response.message = f"the impact map failed: {type(error).__name__}: {error}"
            self._refused += 1
        response.engine = engine
        response.contact = contact
        response.elapsed = time.perf_counter() - started
        return response

    def _problem(
        self, request: ComputeImpactMap.Request, scenario: Scenario
    ) -> tuple[ImpactProblem, Mapping[str, RobotModel]]:
        """The impact of a request, and the robot models of its arms, which no request changes."""
        known = request.object_name or (next(iter(scenario.objects)) if request.use_object_description else "")
        scene = TrialSpec.of(scenario, known, request.case_name).scene  # the same one every time: its engine stays warm
        physics, body = scene.physics, scene.object
        if request.use_object_description:
            physics, body = _described(physics, request.object_description)
        arms = dict(scene.arms)
        for state in request.robots:
            if state.robot not in arms:
                raise InputError(
                    f"scenario {scenario.name!r} has no robot {state.robot!r}; it has: {', '.join(arms)}", key="robots"
                )
            count = physics.arms[state.robot].facts.joint_count
            for name in ("joint_position", "joint_velocity"):
                if len(getattr(state, name)) != count:
                    raise InputError(
                        f"expected {count} values, one per joint, got {len(getattr(state, name))}",
                        key=f"robots.{state.robot}.{name}",
                    )
            arms[state.robot] = ArmState(np.array(state.joint_position), np.array(state.joint_velocity))
        restitution = physics.restitution if request.restitution < 0.0 else request.restitution
        return ImpactProblem(physics, arms, body, _motor_inertia(request, physics), restitution), scene.models


def _described(physics: Physics, described: ObjectDescription) -> tuple[Physics, BodyState]:
    """Physics and state with the object of a request; the impact problem checks the remaining values."""
    if not (np.isfinite(described.mass) and described.mass > 0.0):
        raise InputError("expected a finite mass > 0 kg", key="object_description.mass", value=described.mass)
    size = vector_from_message(described.size)
    pose = pose_from_message(described.pose)
    if not abs(np.linalg.norm(pose[3:]) - 1.0) < 1e-3:
        raise InputError(
            "expected a unit quaternion (x, y, z, w)",
            key="object_description.pose.orientation",
            value=pose[3:].tolist(),
        )
    x, y, z = np.square(size)
    body = ObjectPhysics(described.mass, size, described.mass / 12.0 * np.array([y + z, x + z, x + y]), np.zeros(3))
    changed = replace(
        physics,
        object=body,
        pad_friction=described.pad_friction,
        support_friction=described.support_friction,
        support_height=described.support_height if described.has_support else None,
    )
    rotation = pin.Quaternion(pose[3:] / np.linalg.norm(pose[3:])).matrix()
    return changed, BodyState(pose[:3], rotation, twist_from_message(described.twist))


def _motor_inertia(request: ComputeImpactMap.Request, physics: Physics) -> dict[str, Array]:
    model = request.motor_inertia or "reduced"
    if model == "diagonal":
        diagonal = np.array(request.motor_inertia_diagonal, dtype=float)
        counts = [arm.facts.joint_count for arm in physics.arms.values()]
        if diagonal.size == sum(counts):
            parts = np.split(diagonal, np.cumsum(counts)[:-1])
        elif all(diagonal.size == count for count in counts):
            parts = [diagonal] * len(counts)
        else:
            raise InputError(
                f"expected {sum(counts)} values, one per joint [kg m^2], prismatic [kg], got {diagonal.size}",
                key="motor_inertia_diagonal",
            )
        return dict(zip(physics.arms, parts, strict=True))
    if model not in MOTOR_INERTIA_MODELS:
        raise InputError(f"no motor-inertia model {model!r}; known: {', '.join(MOTOR_INERTIA_MODELS)}, diagonal")
    return {name: arm.motor_inertia(model) for name, arm in physics.arms.items()}


def _fill(response: ComputeImpactMap.Response, problem: ImpactProblem, result: ImpactResult, object_name: str) -> None:
    response.post = [
        RobotState(
            robot=name,
            joint_position=problem.arms[name].position.tolist(),
            joint_velocity=result.joint_velocity[name].tolist(),
        )
        for name in problem.arms
    ]
    response.end_effector_twists = [_twist(name, twist) for name, twist in result.end_effector_twist.items()]
    response.body_twists = [_twist(object_name, result.object_twist)]
    response.contacts = [
        ContactPoint(
            body_a=object_name,
            body_b=contact.body_b,
            position=point_to_message(contact.position),
            normal=vector_to_message(contact.normal),
            impulse=vector_to_message(contact.impulse),
        )
        for contact in result.contacts
    ]
    response.residual = ImpactResidual(
        penetration_velocity=float(result.residual.penetration_velocity),
        complementarity=float(result.residual.complementarity),
        friction_cone=float(result.residual.friction_cone),
        momentum=float(result.residual.momentum),
    )


def _fill_more(
    response: ComputeImpactMap.Response,
    request: ComputeImpactMap.Request,
    problem: ImpactProblem,
    scenario: Scenario,
    models: Mapping[str, RobotModel],
    contact: str,
) -> None:
    """Add intervals and derivatives if requested."""
    if not (request.uncertainty or request.derivatives):
        return
    if contact != "first":
        raise InputError("intervals and derivatives are those of the first contact", key="contact", value=contact)
    response.velocity_names = list(velocity_names(problem))
    if request.uncertainty:
        prediction = predict(problem, scenario.uncertainty, models)
        response.velocity = prediction.nominal.tolist()
        response.velocity_low, response.velocity_high = prediction.low.tolist(), prediction.high.tolist()
    if request.derivatives:
        found = differentiate(problem, models)
        response.velocity = found.velocities.tolist()
        response.parameter_names = [parameter.name for parameter in found.parameters]
        response.parameter_units = [parameter.unit for parameter in found.parameters]
        response.derivatives = found.jacobian.ravel().tolist()


def _twist(body: str, twist: Any) -> RigidBodyTwist:
    return RigidBodyTwist(body=body, twist=twist_to_message(twist))


def main() -> None:
    """Run the node."""
    run(ImpactMapNode)


if __name__ == "__main__":
    main()
