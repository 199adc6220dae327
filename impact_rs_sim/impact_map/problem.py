# SPDX-License-Identifier: Apache-2.0
"""The impact problem and its result, independent of the engine.

Given the configuration, the ante-impact velocities v^- of all bodies and the motor inertia B, find v^+ and contact
impulses L such that, with the generalised inertia of arms (M + B) and object,

    (M + B) (v^+ - v^-) = J_c^T L                              momentum balance; v^+ = v^- = 0 for a fixed object
    0 <= L_n  perpendicular to  J_n v^+ + e min(J_n v^-, 0) >= 0   Newton restitution, per contact point (Poisson's:
                                                               :mod:`impact_rs_sim.impact_map.solve`)
    |L_t| <= mu L_n, opposing the sliding velocity J_t v^+     Coulomb friction

(paper sec. Simulation framework; Glocker 2006; Acary and Brogliato 2008). The impact is instantaneous: positions,
gravity and every other finite force drop out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE, OBJECT, SUPPORT, ContactPair, contact_pairs
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, RESTITUTION_LAWS, ObjectPhysics, Physics
from impact_rs_sim.robots.robot import BASE_COLUMNS, BASE_POSE_SIZE, Array, joined_units
from impact_rs_sim.robots.robot_model import MAX_QUATERNION_ERROR, RobotModel
from impact_rs_sim.scene import ArmState, BodyState, Scene, pad_placements, standing


@dataclass(frozen=True)
class ImpactProblem:
    """One impact problem.

    Attributes:
        physics: Parameters of the scene; motor inertia and restitution are taken from the fields below instead.
        arms: Configuration and ante-impact velocity by arm.
        object: Pose and ante-impact twist of the object.
        motor_inertia: Diagonal of B by arm, ``(n,)`` [kg m^2].
        restitution: Restitution e of every closing contact [-].
        measured: Whether the state was measured; measured joint positions and velocities may exceed their limits.
        restitution_law: ``newton`` or ``poisson``.
        neighbours: States of the neighbours of the object; None: each at rest at its place beside the object.
    """

    physics: Physics
    arms: dict[str, ArmState]
    object: BodyState
    motor_inertia: dict[str, Array]
    restitution: float = 0.0
    measured: bool = False
    restitution_law: str = "newton"
    neighbours: tuple[BodyState, ...] | None = None

    @property
    def neighbour_states(self) -> tuple[BodyState, ...]:
        """States of the neighbours of the object."""
        return standing(self.physics, self.object) if self.neighbours is None else self.neighbours

    @property
    def bodies(self) -> dict[str, tuple[ObjectPhysics, BodyState]]:
        """All objects with their states, by name: the one that is hit first as ``object``, then its neighbours."""
        neighbours = zip(self.physics.neighbours, self.neighbour_states, strict=True)
        return {
            OBJECT: (self.physics.object, self.object),
            **{neighbour.name: (neighbour.body, state) for neighbour, state in neighbours},
        }

    @staticmethod
    def at_nominal_impact(scene: Scene, motor_inertia: str = "reduced") -> ImpactProblem:
        """The scene at its nominal impact, as the references need it.

        A tilted pad gets there with an edge first; the object is where that edge touches it.

        Raises:
            InputError: ``motor_inertia`` is neither ``reduced``, ``rotor`` nor ``zero``.
        """
        if motor_inertia not in MOTOR_INERTIA_MODELS:
            raise InputError(f"no motor-inertia model {motor_inertia!r}; known: {', '.join(MOTOR_INERTIA_MODELS)}")
        return ImpactProblem(
            physics=scene.physics,
            arms=scene.arms,
            object=_object_at_first_contact(scene),
            motor_inertia={name: arm.motor_inertia(motor_inertia) for name, arm in scene.physics.arms.items()},
            restitution=scene.physics.restitution,
            restitution_law=scene.physics.restitution_law,
        )


def _object_at_first_contact(scene: Scene) -> BodyState:
    """The object, moved until it touches the pads where these are round, tilted or offset, or belong to hands."""
    physics, object_ = scene.physics, scene.object
    pads = [pad.end_effector for pad in physics.pads.values()]
    curved = any(not pad.shape.is_box for pad in pads) or len(pads) > len(physics.arms)
    if not curved and not any(any((*pad.pad_tilt, *pad.pad_offset)) for pad in pads):
        return object_
    close_gaps = curved or any(any(pad.pad_offset) for pad in pads)
    placements = pad_placements(physics, physics.robot_models(), scene.arms)
    depths = [
        (-pair.separation if close_gaps else max(-pair.separation, 0.0)) * pair.normal
        for pair in contact_pairs(physics, object_, placements)
        if pair.partner != SUPPORT
    ]
    moved = replace(object_, position=object_.position + np.mean(depths, axis=0))
    if len(pads) > len(physics.arms):
        _check_hands_touch(physics, moved, placements)
    return moved


def _check_hands_touch(physics: Physics, object_: BodyState, placements: Mapping[str, pin.SE3]) -> None:
    """Refuse a robot whose hands do not all touch the object at the nominal impact."""
    for pair in contact_pairs(physics, object_, placements):
        if pair.partner != SUPPORT and not abs(pair.separation) <= GAP_TOLERANCE:
            raise Infeasible(
                f"the pads of a robot with several hands hit at once, and {pair.partner!r} is "
                f"{1e3 * pair.separation:.3g} mm from the object, accepted are {1e3 * GAP_TOLERANCE:.3g} mm; expected "
                "other joint positions, another size of the object, or fewer hands"
            )


class ContactImpulse(NamedTuple):
    """One contact point of a result.

    Attributes:
        body_a: ``object``, or name of a neighbour.
        body_b: Name of the pad (of an arm or a hand), ``support``, or an object before ``body_a``.
        position: Contact point on the object in A, ``(3,)`` [m].
        normal: Unit normal on the object, pointing from ``body_b`` into the object, in A, ``(3,)``.
        impulse: Impulse on the object, in A, ``(3,)`` [N s].
        gap: Distance from the surface of ``body_b`` along the normal [m]; points within the gap tolerance touch.
    """

    body_a: str
    body_b: str
    position: Array
    normal: Array
    impulse: Array
    gap: float = 0.0


@dataclass(frozen=True)
class Residual:
    """Distance of a result from the laws above; each is a maximum over the contact points.

    Attributes:
        penetration_velocity: Largest violation of J_n v^+ + e min(J_n v^-, 0) >= 0 [m/s].
        complementarity: Largest separation velocity J_n v^+ + e min(J_n v^-, 0) of a point that carries an impulse,
            weighted with its share of the largest impulse [m/s].
        friction_cone: Largest violation of the friction law: impulse outside the cone, or not opposed to sliding, as
            a velocity [m/s].
        momentum: Largest entry of (M + B)^-1 ((M + B)(v^+ - v^-) - J_c^T L): momentum balance as a joint velocity
            [rad/s] or body velocity [m/s, rad/s].
    """

    penetration_velocity: float
    complementarity: float
    friction_cone: float
    momentum: float

    @property
    def largest(self) -> float:
        """The largest of the four."""
        return self.worst[1]

    @property
    def worst(self) -> tuple[str, float]:
        """Name and size of the largest entry."""
        laws = {
            "Newton restitution (penetration)": self.penetration_velocity,
            "complementarity (impulse at a separating point, or pull)": self.complementarity,
            "Coulomb friction": self.friction_cone,
            "momentum balance": self.momentum,
        }
        law = max(laws, key=lambda name: laws[name] if laws[name] == laws[name] else np.inf)
        return law, laws[law]


@dataclass(frozen=True)
class ImpactResult:
    """Result of an engine.

    Attributes:
        joint_velocity: Post-impact v by arm, ``(nv,)``: joint velocities, behind the twist of a floating base [rad/s].
        end_effector_twist: Post-impact twist of frame E by pad (arm or hand), in E[A], ``(6,)`` [m/s, rad/s].
        object_twist: Post-impact twist of the object at its geometric centre, axes of A, ``(6,)`` [m/s, rad/s].
        contacts: Contact points with their impulses.
        residual: Distance of the solution from the laws.
        engine: Name of the engine.
        iterations: Iterations of the engine's outer loop.
        elapsed: Wall-clock time [s].
        neighbour_twists: Post-impact twists of the neighbours by name, as ``object_twist``.
    """

    joint_velocity: dict[str, Array]
    end_effector_twist: dict[str, Array]
    object_twist: Array
    contacts: tuple[ContactImpulse, ...]
    residual: Residual
    engine: str
    iterations: int
    elapsed: float
    neighbour_twists: dict[str, Array] = field(default_factory=dict)

    @property
    def twists(self) -> dict[str, Array]:
        """Post-impact twists of all objects by name, ``object`` first."""
        return {OBJECT: self.object_twist, **self.neighbour_twists}


class ImpactMapError(RuntimeError):
    """An engine found no solution that obeys the laws; the message names the law and the error."""


class EnergyGain(ImpactMapError):
    """A solution obeys its laws and has more kinetic energy than the state before the impact."""


GUIDE_SLACK = 1e-9  # m/s or rad/s; rounding of a twist across its hinge or slide
LIMIT_SLACK = 1e-9  # rad or m; a configuration on its limit passes
PENETRATION_TOLERANCE = 1e-3  # m, deepest accepted overlap of pad and object, or object and support


def check_problem(problem: ImpactProblem, models: Mapping[str, RobotModel] | None = None) -> list[ContactPair]:
    """Refuse a problem without solution.

    Args:
        problem: The problem.
        models: Rigid-body models by arm, where the caller has them already.

    Returns:
        Contact pairs of the objects with pads, support and each other.

    Raises:
        InputError: Non-finite or wrong-length state, negative mass or motor inertia, restitution outside [0, 1], or a
            matrix that is no rotation.
        Infeasible: Joint positions or velocities beyond their limits, or initial penetration.
    """
    physics = problem.physics
    for table, key in ((problem.arms, "arms"), (problem.motor_inertia, "motor_inertia")):
        if set(table) != set(physics.arms):
            raise InputError(
                f"expected one entry per arm of the scene ({', '.join(physics.arms)}), got {sorted(table)}", key=key
            )
    for name, state in problem.arms.items():
        _check_arm(problem, name, state)
    _check_restitution(problem)
    check_physics(physics)
    for name, (physical, body) in problem.bodies.items():
        _check_body(name, physical, body)
    if models is None:
        models = physics.robot_models()
    pairs = contact_pairs(
        physics, problem.object, pad_placements(physics, models, problem.arms), problem.neighbour_states
    )
    for pair in pairs:
        depth = -pair.separation
        if depth > PENETRATION_TOLERANCE:
            label = "the object" if pair.body == OBJECT else repr(pair.body)
            raise Infeasible(
                f"{label} penetrates {pair.partner!r} by {1e3 * depth:.3g} mm, accepted are "
                f"{1e3 * PENETRATION_TOLERANCE:.3g} mm",
                key=f"{pair.body}.position",
            )
    return pairs


def _check_body(name: str, physical: ObjectPhysics, body: BodyState) -> None:
    """Refuse an invalid state of an object."""
    _vector(body.position, 3, f"{name}.position", "m")
    _vector(body.twist, 6, f"{name}.twist", "m/s and rad/s")
    if physical.fixed and np.any(body.twist):
        raise InputError("a fixed object does not move: expected zeros [m/s, rad/s]", key=f"{name}.twist")
    if (freedom := physical.freedom_at(body.rotation)) is not None:
        along = freedom @ np.linalg.lstsq(freedom, body.twist, rcond=None)[0]
        if not np.allclose(along, body.twist, atol=GUIDE_SLACK):
            raise InputError(
                f"its hinge or slide leaves a multiple of {freedom[:, 0].tolist()} [m/s, rad/s]; the nearest is "
                f"{along.tolist()}",
                key=f"{name}.twist",
                value=body.twist.tolist(),
            )
    rotation = np.asarray(body.rotation)
    if rotation.shape != (3, 3) or not np.all(np.isfinite(rotation)):
        raise InputError("expected a finite 3 x 3 rotation matrix [-]", key=f"{name}.rotation")
    if np.max(np.abs(rotation @ rotation.T - np.eye(3))) > 1e-6 or np.linalg.det(rotation) < 0.0:
        raise InputError("expected a rotation matrix: orthonormal, determinant +1 [-]", key=f"{name}.rotation")


def _vector(values: Array, length: int, key: str, unit: str) -> None:
    values = np.asarray(values)
    if values.shape != (length,):
        raise InputError(f"expected {length} values [{unit}], got shape {values.shape}", key=key)
    if not np.all(np.isfinite(values)):
        raise InputError(f"expected finite values [{unit}], got {values.tolist()}", key=key)


def _check_arm(problem: ImpactProblem, name: str, state: ArmState) -> None:
    """Refuse joint states and motor inertias that are invalid or beyond the limits of the arm."""
    facts = problem.physics.arms[name].facts
    limits, units = facts.limits, facts.units
    if facts.floating_base is not None:
        state = _check_base(name, state, len(units))
    for key, values, quantity in (
        (f"arms.{name}.position", state.position, "position"),
        (f"arms.{name}.velocity", state.velocity, "velocity"),
        (f"motor_inertia.{name}", problem.motor_inertia[name], "inertia"),
    ):
        _vector(values, len(units), key, joined_units(getattr(unit, quantity) for unit in units))
    slack = math.inf if problem.measured else LIMIT_SLACK
    for index, value in enumerate(state.position):
        low, high = limits.position_min_rad[index], limits.position_max_rad[index]
        if not low - slack <= value <= high + slack:
            raise Infeasible(
                f"joint {index + 1} is outside its limits [{low:.4g}, {high:.4g}] {units[index].position}",
                key=f"arms.{name}.position[{index}]",
                value=float(value),
            )
    for index, value in enumerate(state.velocity):
        limit = limits.velocity_rad_s[index]
        if abs(value) > limit + slack:
            raise Infeasible(
                f"joint {index + 1} is faster than its limit {limit:.4g} {units[index].velocity}",
                key=f"arms.{name}.velocity[{index}]",
                value=float(value),
            )
    for index, value in enumerate(problem.motor_inertia[name]):
        if value < 0.0:
            raise InputError(
                f"expected motor inertia >= 0 {units[index].inertia}",
                key=f"motor_inertia.{name}[{index}]",
                value=float(value),
            )


def _check_base(name: str, state: ArmState, count: int) -> ArmState:
    """State of the joints alone of a robot with a floating base; refuses an invalid pose or twist of the base."""
    key = f"arms.{name}"
    _vector(state.position, BASE_POSE_SIZE + count, f"{key}.position", "m, - and rad: pose of the base, then joints")
    _vector(state.velocity, len(BASE_COLUMNS) + count, f"{key}.velocity", "m/s and rad/s: base, then joints")
    length = float(np.linalg.norm(state.position[3:BASE_POSE_SIZE]))
    if abs(length - 1.0) > MAX_QUATERNION_ERROR:
        raise InputError("expected a unit quaternion x, y, z, w of the base [-]", key=f"{key}.position", value=length)
    return ArmState(state.position[BASE_POSE_SIZE:], state.velocity[len(BASE_COLUMNS) :])


def _check_restitution(problem: ImpactProblem) -> None:
    if problem.restitution_law not in RESTITUTION_LAWS:
        raise InputError(
            f"expected one of {', '.join(RESTITUTION_LAWS)}", key="restitution_law", value=problem.restitution_law
        )
    if not 0.0 <= problem.restitution <= 1.0:
        raise InputError("expected a restitution between 0 and 1 [-]", key="restitution", value=problem.restitution)


def check_physics(physics: Physics) -> None:
    """Refuse an impossible object or friction.

    Raises:
        InputError: Mass, size or moment of inertia that is not positive, a fixed or guided object on a support, or
            friction that is negative.
    """
    guided_or_fixed = physics.object.fixed or physics.object.freedom is not None
    if guided_or_fixed and physics.support_height is not None:
        raise InputError("an object that is fixed or guided rests on no support: expected None", key="support_height")
    for name, object_ in (
        (OBJECT, physics.object),
        *((neighbour.name, neighbour.body) for neighbour in physics.neighbours),
    ):
        if not object_.mass > 0.0:
            raise InputError(
                "expected a mass > 0 kg, infinite for a fixed object", key=f"{name}.mass", value=object_.mass
            )
        for key, unit, values in (("size", "m", object_.size), ("inertia", "kg m^2", object_.inertia)):
            if not (object_.fixed and key == "inertia"):
                _vector(values, 3, f"{name}.{key}", unit)
            if np.min(values) <= 0.0:
                raise InputError(f"expected three values > 0 {unit}", key=f"{name}.{key}", value=values.tolist())
        _vector(object_.com_offset, 3, f"{name}.com_offset", "m")
    for key in ("pad_friction", "support_friction", "object_friction"):
        value = getattr(physics, key)
        if not (np.isfinite(value) and value >= 0.0):
            raise InputError("expected a finite friction coefficient >= 0 [-]", key=key, value=value)


def kinetic_energy(problem: ImpactProblem, result: ImpactResult | None = None) -> float:
    """Kinetic energy with (M + B), before the impact or, with ``result``, after it [J]."""
    twists = {} if result is None else result.twists
    energy = 0.0
    for name, (physical, state) in problem.bodies.items():
        twist = twists.get(name, state.twist)
        linear = twist[:3] + np.cross(twist[3:], state.rotation @ physical.com_offset)
        angular = state.rotation.T @ twist[3:]
        if not physical.fixed:
            energy += 0.5 * float(physical.mass * linear @ linear + physical.inertia @ np.square(angular))
    for name, arm in problem.arms.items():
        dq = arm.velocity if result is None else result.joint_velocity[name]
        inertia = problem.physics.robot_model(name).inertia(arm.position, problem.motor_inertia[name])
        energy += 0.5 * float(dq @ inertia @ dq)
    return energy
