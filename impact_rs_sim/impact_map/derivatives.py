# SPDX-License-Identifier: Apache-2.0
"""Parameters of the impact map, and the derivatives of u^+ with respect to each.

====================================  ========  ==============================================================
name                                  unit      quantity
====================================  ========  ==============================================================
``object.mass``                       kg        mass, at the same moments about the centre of mass
``object.inertia.x`` ...              kg m^2    principal moments about the centre of mass
``object.com_offset.x`` ...           m         centre of mass from the geometric centre, axes of the object
``object.position.x`` ...             m         geometric centre, axes of A
``object.rotation.x`` ...             rad       rotation vector of a rotation of the object, axes of A
``object.velocity.x`` ...             m/s       ante-impact velocity of the centre, axes of A
``object.angular_velocity.x`` ...     rad/s     ante-impact angular velocity, axes of A
``ARM.motor_inertia.1`` ...           kg m^2    diagonal of B
``ARM.link_inertia``                  -         factor on M(q): masses and moments of all links
``ARM.position.1`` ...                rad       joint positions q
``ARM.velocity.1`` ...                rad/s     ante-impact joint velocities
``PAD.contact_point.x`` ``.y``        m         shift of the contact points along the pad, axes of frame E
``pad_friction`` ``support_friction``  -        Coulomb coefficients
``restitution``                       -         Newton restitution
====================================  ========  ==============================================================

A prismatic joint has kg, m and m/s instead of kg m^2, rad and rad/s.

**Derivatives.** Every contact point keeps its state, open, stick or slide. With the laws F(L, s, mu) = 0 of
:mod:`impact_rs_sim.impact_map.laws`, s = J u^+ + e min(J_n u^-, 0) n + (rho / m) L and u^+ = u^- + H^-1 J^T L, the
implicit function theorem gives for a parameter theta

    (F_L + F_s G) dL = -(F_s ds|_L + F_mu dmu),         du^+ = du^+|_L + H^-1 J^T dL

with the derivatives ds|_L, dmu and du^+|_L at constant L, where L and s rotate with the contact normals. These are
central differences of the smooth terms u^-, H, J and n, with ds|_L = J du^+|_L + dJ u^+ + ...: the rounding error of
the first term is then a motion of the bodies, which redundant contact points do not amplify. (Central differences of
the map itself fail at aligned faces, where any rotation lets contact points change their state.)

The derivatives hold as long as no contact changes its state, and with e > 0 as long as no point changes from closing to
opening before the impact; ``margin`` is the distance to either. A point at rest, J_n u^- = 0, has the derivative of
closing points; columns of the velocity of its body hold on that side.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import (
    GAP_TOLERANCE,
    OBJECT,
    ContactPair,
    ContactPoint,
    contact_pairs,
    find_contacts,
)
from impact_rs_sim.impact_map.laws import (
    COMPLIANCE,
    ContactTerms,
    System,
    build_system,
    delassus,
    linearise,
    newton,
    slope,
    solve_contacts,
    yielding_velocity,
)
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem, check_problem
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scene import ArmState, BodyState, pad_placements

COMPLIANCES = (COMPLIANCE, 1e-5)  # rho of the derivatives; the second where Newton's method fails with the first
# Step of a central difference over the scale of the parameter: truncation and rounding are near 1e-8 of a derivative.
RELATIVE_STEP = 1e-4
LENGTH_SCALE_M = 0.1  # of pads and objects
MAX_SHIFT_M = 5e-3  # a contact point that is further away after a step is another corner
MAX_GAP_AFTER_STEP_M = 2.0 * GAP_TOLERANCE  # largest gap of a contact point after a step
OBJECT_QUANTITIES = {
    "inertia": "kg m^2",
    "com_offset": "m",
    "position": "m",
    "rotation": "rad",
    "velocity": "m/s",
    "angular_velocity": "rad/s",
}
POSE_QUANTITIES = ("position", "rotation")  # the only parameters of a fixed object
TWIST_QUANTITIES = ("velocity", "angular_velocity")  # no parameters of an object on a hinge or slide
# Attribute of :class:`~impact_rs_sim.robots.robot.JointUnits` with the unit, by quantity.
JOINT_QUANTITIES = {"motor_inertia": "inertia", "position": "position", "velocity": "velocity"}


@dataclass(frozen=True)
class MapParameter:
    """Scalar parameter of a prediction; ``name`` and ``unit`` as in the table above."""

    name: str
    unit: str


def parameters_of(problem: ImpactProblem) -> tuple[MapParameter, ...]:
    """All parameters of a problem; a fixed object has only those of its pose, a guided one none of its velocity."""
    fixed = problem.physics.object.fixed
    parameters = [] if fixed else [MapParameter("object.mass", "kg")]
    guided = problem.physics.object.freedom is not None
    absent = {*OBJECT_QUANTITIES} - {*POSE_QUANTITIES} if fixed else {*TWIST_QUANTITIES} if guided else set()
    quantities = {kind: unit for kind, unit in OBJECT_QUANTITIES.items() if kind not in absent}
    parameters += [MapParameter(f"object.{kind}.{axis}", unit) for kind, unit in quantities.items() for axis in AXES]
    for name in problem.arms:
        parameters += [
            MapParameter(f"{name}.{kind}.{joint}", getattr(units, quantity))
            for kind, quantity in JOINT_QUANTITIES.items()
            for joint, units in enumerate(problem.physics.arms[name].facts.units, start=1)
        ]
        parameters.append(MapParameter(f"{name}.link_inertia", "-"))
        pads = [pad_name for pad_name, pad in problem.physics.pads.items() if pad.arm == name]
        parameters += [MapParameter(f"{pad_name}.contact_point.{axis}", "m") for pad_name in pads for axis in "xy"]
    parameters += [MapParameter(name, "-") for name in ("pad_friction", "support_friction", "restitution")]
    return tuple(parameters)


@dataclass(frozen=True)
class Changed:
    """A problem with some parameters changed.

    Attributes:
        problem: The problem with the changes that it can represent.
        link_inertia: Change of the factor on M(q) by arm [-].
        contact_point: Shift of the contact points along x and y of frame E by pad, ``(2,)`` [m].
    """

    problem: ImpactProblem
    link_inertia: dict[str, float] = field(default_factory=dict)
    contact_point: dict[str, Array] = field(default_factory=dict)

    def system(self, models: Mapping[str, RobotModel]) -> System:
        """Inertia and kinematics; ``models`` are the rigid-body models by arm, without the change."""
        system = build_system(self.problem, models)
        if not self.link_inertia:
            return system
        extra = np.zeros_like(system.inertia)
        for name, factor in self.link_inertia.items():
            block = system.columns[name]
            extra[block, block] = factor * system.link_inertia[block, block]
        return replace(system, inertia=system.inertia + extra, link_inertia=system.link_inertia + extra)

    def contacts(
        self,
        models: Mapping[str, RobotModel],
        pairs: Sequence[ContactPair] | None = None,
        tolerance: float = GAP_TOLERANCE,
    ) -> list[ContactPoint]:
        """Contact points.

        Args:
            models: Rigid-body models by arm, without the change.
            pairs: Contact pairs, where the caller has them already.
            tolerance: Largest gap [m].
        """
        if pairs is None:
            pairs = self._pairs(models)
        placements = pad_placements(self.problem.physics, models, self.problem.arms) if self.contact_point else {}
        shifts = {name: placements[name].rotation[:, :2] @ along for name, along in self.contact_point.items()}
        return [
            replace(point, position=point.position + shifts[point.partner]) if point.partner in shifts else point
            for point in find_contacts(self.problem.physics, pairs, tolerance)
        ]

    def _pairs(self, models: Mapping[str, RobotModel]) -> list[ContactPair]:
        """Contact pairs by geometry."""
        problem = self.problem
        placements = pad_placements(problem.physics, models, problem.arms)
        return contact_pairs(problem.physics, problem.object, placements, problem.neighbour_states)

    def terms(
        self, models: Mapping[str, RobotModel], pairs: Sequence[ContactPair] | None = None
    ) -> tuple[System, ContactTerms]:
        """Terms of the contact laws; arguments as for :meth:`contacts`."""
        system = self.system(models)
        return system, ContactTerms.of(system, self.contacts(models, pairs), self.problem.restitution)

    def touching_terms(self, models: Mapping[str, RobotModel], pads: Collection[str]) -> tuple[System, ContactTerms]:
        """As :meth:`terms`, with some pads moved along the contact normal until they touch."""
        system, pairs = self.system(models), []
        positions = dict(system.end_effector_position)
        for pair in self._pairs(models):
            if pair.partner in pads and pair.body == OBJECT:
                step = pair.separation * pair.normal
                positions[pair.partner] = positions[pair.partner] + step
                box = replace(pair.box, centre=pair.box.centre + step)
                pair = replace(pair, box=box, separation=0.0)
            pairs.append(pair)
        system = replace(system, end_effector_position=positions)
        return system, ContactTerms.of(system, self.contacts(models, pairs), self.problem.restitution)


def change(problem: ImpactProblem, amounts: Mapping[str, float]) -> Changed:
    """The problem with parameters changed by some amounts, in the units of the table above.

    Raises:
        InputError: There is no such parameter.
    """
    names = {parameter.name for parameter in parameters_of(problem)}
    for name in amounts:
        if name not in names:
            raise InputError(f"no parameter {name!r} of the impact map; known are: {', '.join(sorted(names))}")
    physics = problem.physics
    object_changes = {
        kind: np.array([amounts.get(f"object.{kind}.{axis}", 0.0) for axis in AXES]) for kind in OBJECT_QUANTITIES
    }
    object_, body = physics.object, problem.object
    object_ = replace(
        object_,
        mass=object_.mass + amounts.get("object.mass", 0.0),
        inertia=object_.inertia + object_changes["inertia"],
        com_offset=object_.com_offset + object_changes["com_offset"],
    )
    body = BodyState(
        body.position + object_changes["position"],
        pin.exp3(object_changes["rotation"]) @ body.rotation,
        body.twist + np.concatenate((object_changes["velocity"], object_changes["angular_velocity"])),
    )
    arms, motors, factors, points = {}, {}, {}, {}
    for name, state in problem.arms.items():
        motor = problem.motor_inertia[name]
        joint_changes = {
            kind: np.array([amounts.get(f"{name}.{kind}.{joint + 1}", 0.0) for joint in range(motor.size)])
            for kind in JOINT_QUANTITIES
        }
        moved_state = (
            _with_joint_changes(joint_changes["position"], state.position),
            _with_joint_changes(joint_changes["velocity"], state.velocity),
        )
        arms[name] = ArmState(*moved_state)
        motors[name] = motor + joint_changes["motor_inertia"]
        if factor := amounts.get(f"{name}.link_inertia", 0.0):
            factors[name] = factor
    for name in physics.pads:
        along = np.array([amounts.get(f"{name}.contact_point.{axis}", 0.0) for axis in "xy"])
        if np.any(along):
            points[name] = along
    changed = replace(
        problem,
        physics=replace(
            physics,
            object=object_,
            pad_friction=physics.pad_friction + amounts.get("pad_friction", 0.0),
            support_friction=physics.support_friction + amounts.get("support_friction", 0.0),
        ),
        arms=arms,
        object=body,
        motor_inertia=motors,
        restitution=problem.restitution + amounts.get("restitution", 0.0),
    )
    return Changed(changed, factors, points)


def _with_joint_changes(joint_change: Array, values: Array) -> Array:
    """``values`` with changed joints; these come last, behind the components of a floating base."""
    return values + np.concatenate((np.zeros(values.size - joint_change.size), joint_change))


@dataclass(frozen=True)
class Derivatives:
    """The Jacobian of a prediction.

    Attributes:
        parameters: The p parameters, in the order of the columns.
        names: Names of the k velocities, in the order of the rows: :func:`velocity_names`.
        velocities: Velocities after the impact, ``(k,)`` [rad/s, m/s].
        jacobian: Derivatives of the velocities, ``(k, p)``.
        states: State of every contact point, ``open``, ``stick`` or ``slide``.
        margin: Distance of the nearest contact from another state, or with e > 0 of a moving point from the change
            between closing and opening, as a velocity [m/s].
        smooth: Whether every contact point moves smoothly with the bodies; a point that does not is kept in its place.
    """

    parameters: tuple[MapParameter, ...]
    names: tuple[str, ...]
    velocities: Array
    jacobian: Array
    states: tuple[str, ...]
    margin: float
    smooth: bool

    def of(self, name: str) -> Array:
        """The column of one parameter, ``(k,)``.

        Raises:
            InputError: There is no such parameter.
        """
        names = [parameter.name for parameter in self.parameters]
        if name not in names:
            raise InputError(f"no parameter {name!r}; known: {', '.join(names)}")
        return np.asarray(self.jacobian[:, names.index(name)])


def velocity_names(problem: ImpactProblem) -> tuple[str, ...]:
    """Names of all predicted velocities.

    ``ARM.joint_velocity.1`` ... [rad/s] of every arm (behind the twist of a floating base in its own axes,
    ``ARM.base_vx`` ...), ``PAD.velocity.x`` ... [m/s] and ``PAD.angular_velocity.x`` ... [rad/s] of frame E of every
    pad, and ``object.velocity.x`` ... and ``object.angular_velocity.x`` ....
    """
    joints = [
        f"{name}.{column.replace('joint', 'joint_velocity.')}"
        for name in problem.arms
        for column, _ in problem.physics.arms[name].facts.velocity_columns
    ]
    twists = [
        f"{body}.{kind}.{axis}"
        for body in (*problem.physics.pads, "object")
        for kind in ("velocity", "angular_velocity")
        for axis in AXES
    ]
    return (*joints, *twists)


def all_velocities(system: System, velocity: Array) -> Array:
    """The velocities of :func:`velocity_names` from u ``(nv,)``, ``(k,)`` [rad/s, m/s]."""
    joints, twists, object_ = system.split(velocity)
    return np.concatenate((*joints.values(), *twists.values(), object_))


def differentiate(
    problem: ImpactProblem,
    models: Mapping[str, RobotModel] | None = None,
    compliances: Sequence[float] = COMPLIANCES,
) -> Derivatives:
    """Derivatives of all velocities after the impact with respect to every parameter of a problem.

    Args:
        problem: The problem; Newton's law of restitution.
        models: Rigid-body models by arm, where the caller has them already.
        compliances: rho of the contact points [-]; the first with which Newton's method converges is used.

    Raises:
        InputError: The problem is refused (see :func:`check_problem`).
        ImpactMapError: Newton's method does not converge, so that there are no contact states to keep.
    """
    if models is None:
        models = problem.physics.robot_models()
    pairs = check_problem(problem, models)
    system = build_system(problem, models)
    contacts = find_contacts(problem.physics, pairs)
    terms = ContactTerms.of(system, contacts, problem.restitution)
    guess, _ = solve_contacts(terms)
    for compliance in compliances:
        impulses, converged = newton(terms, guess, compliance=compliance)
        if converged:
            break
    else:
        raise ImpactMapError("Newton's method did not converge: there are no contact states to differentiate at")
    after = terms.before + terms.response @ impulses.ravel()
    opening = np.sum(terms.normals * (terms.jacobian @ terms.before).reshape(-1, 3), axis=1)
    point = _Point(problem, models, contacts, impulses, after, opening <= 0.0, compliance * terms.mobility)
    parameters = parameters_of(problem)
    names = [parameter.name for parameter in parameters]
    partial = [_differences(point, name, RELATIVE_STEP * _scale_of(name, problem, system)) for name in names]
    jacobian = np.array([rate.velocities for rate in partial]).T
    states: tuple[str, ...] = ()
    margin = np.inf
    if contacts:
        operator = delassus(terms, compliance)
        linear = linearise(terms, impulses, yielding_velocity(terms, operator, impulses))
        shifts = [
            np.einsum("mij,mj->mi", linear.by_velocity, rate.slip + (terms.jacobian @ rate.velocity).reshape(-1, 3))
            + linear.by_friction * rate.friction[:, None]
            for rate in partial
        ]
        impulse_rates = np.linalg.solve(slope(linear, operator), -np.array(shifts).reshape(len(shifts), -1).T)
        jacobian = (
            jacobian + np.array([all_velocities(system, column) for column in (terms.response @ impulse_rates).T]).T
        )
        states, margin = linear.state, float(np.min(linear.margin))
        if problem.restitution > 0.0:
            margin = float(np.min(np.abs(opening[opening != 0.0]), initial=margin))
    return Derivatives(
        parameters=parameters,
        names=velocity_names(problem),
        velocities=all_velocities(system, after),
        jacobian=jacobian,
        states=states,
        margin=margin,
        smooth=all(rate.smooth for rate in partial),
    )


class _Point(NamedTuple):
    """Solution at which derivatives are taken.

    Attributes:
        impulses: Impulses on the object, ``(m, 3)`` [N s].
        after: u^+, ``(nv,)`` [rad/s, m/s].
        closes: Mask of the points that close before the impact, ``(m,)``.
        yields: rho / m, velocity by which a point yields per impulse [1/kg].
    """

    problem: ImpactProblem
    models: Mapping[str, RobotModel]
    contacts: Sequence[ContactPoint]
    impulses: Array
    after: Array
    closes: Array
    yields: float


class _Terms(NamedTuple):
    """Terms at constant L, or their rates of change.

    Attributes:
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        velocities: All velocities at this u^+, ``(k,)`` [rad/s, m/s].
        slip: s at the nominal u^+, in axes that rotate with the normals, ``(m, 3)`` [m/s].
        friction: Coulomb coefficients, ``(m,)`` [-].
        smooth: Whether every contact point has a counterpart after the step.
    """

    velocity: Array
    velocities: Array
    slip: Array
    friction: Array
    smooth: bool


def _differences(point: _Point, name: str, step: float) -> _Terms:
    """Central differences of the terms at constant L."""
    high, low = (_terms_at(point, name, amount) for amount in (step, -step))
    velocity, velocities, slip, friction = (
        (above - below) / (2.0 * step) for above, below in zip(high[:-1], low[:-1], strict=True)
    )
    return _Terms(velocity, velocities, slip, friction, high.smooth and low.smooth)


def _terms_at(point: _Point, name: str, amount: float) -> _Terms:
    """The terms with one parameter changed."""
    changed = change(point.problem, {name: amount})
    system = changed.system(point.models)
    contacts, smooth = _match_contacts(point.contacts, changed.contacts(point.models, tolerance=MAX_GAP_AFTER_STEP_M))
    jacobian, yields = system.jacobian(contacts), point.yields
    if system.free:
        yields *= point.problem.physics.object.mass / changed.problem.physics.object.mass
    normals = np.array([contact.normal for contact in contacts]).reshape(-1, 3)
    pairs = zip((contact.normal for contact in point.contacts), normals, strict=True)
    rotations = np.array([_rotation_between(*pair) for pair in pairs]).reshape(-1, 3, 3)
    impulses = np.einsum("mij,mj->mi", rotations, point.impulses)
    velocity = system.velocity + np.linalg.solve(system.inertia, jacobian.T @ impulses.ravel())
    opening = np.sum(normals * (jacobian @ system.velocity).reshape(-1, 3), axis=1)
    rebound = changed.problem.restitution * np.where(point.closes, opening, 0.0)
    slip = (jacobian @ point.after).reshape(-1, 3) + rebound[:, None] * normals + yields * impulses
    return _Terms(
        velocity=velocity,
        velocities=all_velocities(system, velocity),
        slip=np.einsum("mji,mj->mi", rotations, slip),
        friction=np.array([contact.friction for contact in contacts]),
        smooth=smooth,
    )


def _match_contacts(
    contacts: Sequence[ContactPoint], changed: Sequence[ContactPoint]
) -> tuple[list[ContactPoint], bool]:
    """The counterparts of ``contacts`` after a step, and whether each has one; a point without is kept."""
    moved, smooth = [], True
    for contact in contacts:
        bodies = (contact.body, contact.partner)
        candidates = [candidate for candidate in changed if (candidate.body, candidate.partner) == bodies]
        distances = [float(np.linalg.norm(candidate.position - contact.position)) for candidate in candidates]
        nearest = min(distances, default=np.inf)
        smooth = smooth and nearest <= MAX_SHIFT_M
        moved.append(candidates[distances.index(nearest)] if nearest <= MAX_SHIFT_M else contact)
    return moved, smooth


def _rotation_between(normal: Array, target: Array) -> Array:
    """The smallest rotation of one unit vector to another near it, ``(3, 3)``."""
    axis = np.cross(normal, target)
    sine = float(np.linalg.norm(axis))
    return np.eye(3) if sine == 0.0 else np.asarray(pin.exp3(np.arcsin(min(sine, 1.0)) / sine * axis))


def _scale_of(name: str, problem: ImpactProblem, system: System) -> float:
    """Change of a parameter that changes terms by about their own size, in its unit."""
    owner, _, kind = name.partition(".")
    kind, _, which = kind.partition(".")
    if owner == "object" and kind == "mass":
        return problem.physics.object.mass
    if owner == "object" and kind == "inertia":
        return float(problem.physics.object.inertia[AXES.index(which)])
    if kind == "motor_inertia":
        joint = system.columns[owner].stop - problem.motor_inertia[owner].size + int(which) - 1
        return float(system.inertia[joint, joint])
    lengths = kind == "com_offset" or (owner == "object" and kind == "position")
    return LENGTH_SCALE_M if lengths else 1.0
