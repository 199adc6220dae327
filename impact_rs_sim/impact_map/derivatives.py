# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the impact map, in closed form at the active contact states.

With the laws F(L, s, mu) = 0 of :mod:`impact_rs_sim.impact_map.laws`, s = J u^- + G L + e min(J_n u^-, 0) n
and u^+ = u^- + H^-1 J^T L, a parameter theta moves u^+ by

    (F_L + F_s G) dL = -(F_s ds|_L + F_mu dmu)                       every point keeps its state: open, stick or slide
    du^+             = du^- + H^-1 (dJ^T L - dH (u^+ - u^-)) + H^-1 J^T dL

where L and s turn with the contact normals. What a parameter does to H, J and the normals is closed as well:

* a serial chain with the columns (l_i, z_i) of J in E[A], z_i = 0 where it slides: dl_i / dq_j = z_j x l_i and
  dz_i / dq_j = z_j x z_i for j <= i, else z_i x l_j and 0; (dM / dq) a from Pinocchio's derivatives of the inverse
  dynamics;
* the object: dH a = W H a - H W a for a turn dphi with W = blockdiag(dphi x, dphi x);
* contact points: :mod:`impact_rs_sim.impact_map.contact_motion`.

They hold as long as no contact changes its state, and with e > 0 as long as no point turns from closing to opening
before the impact; ``margin`` says how near that is. A point that rests, J_n u^- = 0, has the derivative of closing
points; columns of the velocity of its body hold on that side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contact_motion import PointMotion, point_motion
from impact_rs_sim.impact_map.contacts import ContactPoint, Meeting, find_contacts
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
from impact_rs_sim.impact_map.perturbation import AXES, MapParameter, parameters_of
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem, check_problem
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

SOFTER = 1e-5  # rho of the derivatives where Newton's method fails at that of the map


@dataclass(frozen=True)
class Derivatives:
    """The Jacobian of a prediction.

    Attributes:
        parameters: The p parameters, in the order of the columns.
        outputs: Names of the velocities, in the order of the rows: ``ARM.joint_velocity.1`` ... [rad/s] of every arm,
            ``object.velocity.x`` ... [m/s], ``object.angular_velocity.x`` ... [rad/s].
        velocity: u^+, ``(nv,)`` [rad/s, m/s].
        jacobian: du^+ / dtheta, ``(nv, p)``.
        states: ``open``, ``stick`` or ``slide`` of every contact point.
        margin: How far the nearest contact is from another state, or with e > 0 a moving point from turning between
            closing and opening, as a velocity [m/s].
        smooth: Whether contact points move smoothly with the bodies; else columns of poses hold on one side at best.
        end_effector: J of frame E in E[A] by arm ``(6, n)``, and du^+ of its twist at fixed u^+, ``(6, p)``.
    """

    parameters: tuple[MapParameter, ...]
    outputs: tuple[str, ...]
    velocity: Array
    jacobian: Array
    states: tuple[str, ...]
    margin: float
    smooth: bool
    end_effector: Mapping[str, tuple[Array, Array]]

    def of(self, name: str) -> Array:
        """The column of one parameter, ``(nv,)``.

        Raises:
            InputError: There is no such parameter.
        """
        for index, parameter in enumerate(self.parameters):
            if parameter.name == name:
                return np.asarray(self.jacobian[:, index])
        raise InputError(f"no parameter {name!r}; known: {', '.join(one.name for one in self.parameters)}")

    def velocities(self) -> Array:
        """The velocities of :func:`velocity_names`, ``(k,)`` [rad/s, m/s]."""
        return self._with_twists(self.velocity, dict.fromkeys(self.end_effector, 0.0))

    def of_velocities(self) -> Array:
        """Derivatives of every velocity of :func:`velocity_names`, ``(k, p)``."""
        return self._with_twists(self.jacobian, {arm: moved for arm, (_, moved) in self.end_effector.items()})

    def _with_twists(self, rows: Array, moved: Mapping[str, Array | float]) -> Array:
        """Rows of u, and between joints and object the twists of every arm, J times its rows plus the change of J."""
        start, twists = 0, []
        for arm, (jacobian, _) in self.end_effector.items():
            end = start + jacobian.shape[1]
            twists.append(jacobian @ rows[start:end] + moved[arm])
            start = end
        return np.concatenate((rows[:start], *twists, rows[start:]))


def output_names(problem: ImpactProblem) -> tuple[str, ...]:
    """Names of the entries of u."""
    names = [
        f"{name}.joint_velocity.{joint + 1}"
        for name, state in problem.arms.items()
        for joint in range(state.position.size)
    ]
    names += [f"object.{kind}.{axis}" for kind in ("velocity", "angular_velocity") for axis in AXES]
    return tuple(names)


def velocity_names(problem: ImpactProblem) -> tuple[str, ...]:
    """Names of all predicted velocities: those of the joints, ``ARM.velocity.x`` ... of frame E, and the object's."""
    *joints, vx, vy, vz, wx, wy, wz = output_names(problem)
    twists = [
        f"{arm}.{kind}.{axis}" for arm in problem.arms for kind in ("velocity", "angular_velocity") for axis in AXES
    ]
    return (*joints, *twists, vx, vy, vz, wx, wy, wz)


def differentiate_safely(problem: ImpactProblem, models: Mapping[str, RobotModel] | None = None) -> Derivatives:
    """Derivatives with the compliance of the map, or with a larger one where Newton's method fails.

    Raises:
        InputError: As :func:`differentiate`.
        ImpactMapError: No answer was found with either.
    """
    try:
        return differentiate(problem, models)
    except ImpactMapError:
        return differentiate(problem, models, SOFTER)


def differentiate(
    problem: ImpactProblem, models: Mapping[str, RobotModel] | None = None, compliance: float = COMPLIANCE
) -> Derivatives:
    """Derivatives of u^+ with respect to every parameter of a problem.

    Args:
        problem: The problem; Newton's law of restitution.
        models: Rigid-body models by arm, where the caller has them already.
        compliance: rho of the contact points [-].

    Raises:
        InputError: The problem is refused (see :func:`check_problem`).
        ImpactMapError: Newton's method does not converge, so that there are no contact states to hold.
    """
    if models is None:
        models = problem.physics.robot_models()
    found = check_problem(problem, models)
    system = build_system(problem, models)
    contacts = find_contacts(problem.physics, found)
    terms = ContactTerms.of(system, contacts, problem.restitution)
    impulses, converged = newton(terms, solve_contacts(terms)[0], compliance=compliance)
    if not converged:
        raise ImpactMapError("Newton's method found no contact states to differentiate at")
    velocity = system.velocity + terms.response @ impulses.ravel()
    changes = _Changes(problem, system, models, contacts, found, impulses, velocity)
    parameters = parameters_of(problem)
    names = [parameter.name for parameter in parameters]
    effects = [changes.of(name) for name in names]
    inverse = np.linalg.inv(system.inertia)
    started = np.array([effect.before for effect in effects]).T
    shaken = started + inverse @ np.array([effect.generalised for effect in effects]).T
    jacobian = shaken
    states: tuple[str, ...] = ()
    margin = np.inf
    if contacts:
        operator = delassus(terms, compliance)
        slip = yielding_velocity(terms, operator, impulses)
        linear = linearise(terms, impulses, slip)
        normals = terms.normals
        opening = np.sum(normals * changes.relative_before, axis=1)
        pushes = []
        for effect, moved in zip(effects, shaken.T, strict=True):
            rate = (terms.jacobian @ moved).reshape(-1, 3) + effect.of_relative
            approach = (terms.jacobian @ effect.before).reshape(-1, 3) + effect.of_relative_before
            approach = approach - np.cross(effect.turned, changes.relative_before)
            again = problem.restitution * np.where(opening <= 0.0, np.sum(normals * approach, axis=1), 0.0)
            again = again + effect.restitution * np.minimum(opening, 0.0)
            rate = rate + again[:, None] * normals - np.cross(effect.turned, changes.relative_after)
            rate = rate - compliance * terms.mobility**2 * effect.mass * impulses
            push = np.einsum("mij,mj->mi", linear.by_velocity, rate) + linear.by_friction * effect.friction[:, None]
            pushes.append(push.ravel())
        answer = np.linalg.solve(slope(linear, operator), -np.array(pushes).T)
        jacobian = shaken + terms.response @ answer
        states, margin = linear.state, float(np.min(linear.margin))
        if problem.restitution > 0.0:
            margin = float(np.min(np.abs(opening[opening != 0.0]), initial=margin))
    return Derivatives(
        parameters=parameters,
        outputs=output_names(problem),
        velocity=velocity,
        jacobian=jacobian,
        states=states,
        margin=margin,
        smooth=all(motion.smooth for motion in changes.motions),
        end_effector={name: (system.end_effector_jacobian[name], changes.twist_of(name, names)) for name in models},
    )


@dataclass
class _Effect:
    """Influence of one parameter at fixed L and u^+.

    Attributes:
        before: du^-, ``(nv,)``.
        generalised: dJ^T L - dH (u^+ - u^-), with L turned along with the normals, ``(nv,)`` [N m s, N s].
        of_relative: dJ u^+, ``(m, 3)`` [m/s].
        of_relative_before: dJ u^-, ``(m, 3)`` [m/s].
        turned: Rotation vectors of the normals, ``(m, 3)`` [rad].
        friction: Of the coefficients, ``(m,)`` [-].
        restitution: Of e [-].
        mass: Of the object [kg].
    """

    before: Array
    generalised: Array
    of_relative: Array
    of_relative_before: Array
    turned: Array
    friction: Array
    restitution: float = 0.0
    mass: float = 0.0


class _Changes:
    """Influence of the parameters on the terms of one problem."""

    def __init__(
        self,
        problem: ImpactProblem,
        system: System,
        models: Mapping[str, RobotModel],
        contacts: Sequence[ContactPoint],
        found: Sequence[Meeting],
        impulses: Array,
        velocity: Array,
    ) -> None:
        self.problem, self.system, self.models = problem, system, models
        self.contacts, self.impulses, self.velocity = contacts, impulses, velocity
        self.jump = velocity - system.velocity
        self.meetings = {meeting.partner: meeting for meeting in found}
        self.motions: list[PointMotion] = [point_motion(self.meetings[one.partner], one) for one in contacts]
        jacobian = system.jacobian(contacts)
        self.relative_before = (jacobian @ system.velocity).reshape(-1, 3)
        self.relative_after = (jacobian @ velocity).reshape(-1, 3)
        self.slopes = {name: chain_derivative(of_arm) for name, of_arm in system.end_effector_jacobian.items()}
        self.mass_slopes = {name: self._mass_slope(name) for name in models}

    def _mass_slope(self, name: str) -> Array:
        """d(M a) / dq at the jump a of an arm, ``(n, n)``."""
        model, q = self.models[name], self.problem.arms[name].position
        rest = np.zeros_like(q)
        jump = self.jump[self.system.columns[name]]
        moving = np.array(pin.computeRNEADerivatives(model.pinocchio, model.data, q, rest, jump)[0])
        still = np.array(pin.computeRNEADerivatives(model.pinocchio, model.data, q, rest, rest)[0])
        return moving - still

    def nothing(self) -> _Effect:
        """No change."""
        size, count = self.velocity.size, len(self.contacts)
        still = np.zeros((3, count, 3))
        return _Effect(np.zeros(size), np.zeros(size), still[0], still[1], still[2], np.zeros(count))

    def of(self, name: str) -> _Effect:
        """Influence of a parameter, by its name."""
        effect = self.nothing()
        if name == "restitution":
            effect.restitution = 1.0
        elif name in ("pad_friction", "support_friction"):
            of_support = name == "support_friction"
            effect.friction[:] = [(point.partner not in self.models) == of_support for point in self.contacts]
        else:
            owner, kind, *rest = name.split(".")
            if owner == "object":
                self._of_object(effect, kind, AXES.index(rest[0]) if rest else 0)
            else:
                self._of_arm(effect, owner, kind, rest[0] if rest else "")
        return effect

    def _of_object(self, effect: _Effect, kind: str, axis: int) -> None:
        problem, where = self.problem, self.system.columns["object"]
        object_, rotation = problem.physics.object, problem.object.rotation
        jump, unit = self.jump[where], np.eye(3)[axis]
        offset = rotation @ object_.com_offset
        if kind == "velocity":
            effect.before[where.start + axis] = 1.0
        elif kind == "angular_velocity":
            effect.before[where.start + 3 + axis] = 1.0
        elif kind == "mass":
            effect.mass = 1.0
            effect.generalised[where] = -pin.Inertia(1.0, offset, np.zeros((3, 3))).matrix() @ jump
        elif kind == "inertia":
            along = rotation[:, axis]
            effect.generalised[where] = np.concatenate((np.zeros(3), -along * (along @ jump[3:])))
        elif kind == "com_offset":
            moved = rotation[:, axis]
            # H (v, w): momentum m (v + w x c), and m c x (v + w x c) + I w about the centre
            of_centre = jump[:3] + np.cross(jump[3:], offset)
            linear = np.cross(jump[3:], moved)
            angular = np.cross(moved, of_centre) + np.cross(offset, linear)
            effect.generalised[where] = -object_.mass * np.concatenate((linear, angular))
        elif kind == "position":
            self._move(effect, "", np.concatenate((unit, np.zeros(3))))
        else:
            inertia = self.system.inertia[where, where]
            turn = np.zeros((6, 6))
            turn[:3, :3] = turn[3:, 3:] = pin.skew(unit)
            effect.generalised[where] = -(turn @ inertia - inertia @ turn) @ jump
            self._move(effect, "", np.concatenate((np.zeros(3), unit)))

    def _of_arm(self, effect: _Effect, name: str, kind: str, which: str) -> None:
        where = self.system.columns[name]
        if kind == "link_inertia":
            effect.generalised[where] = -self.system.link_inertia[where, where] @ self.jump[where]
        elif kind == "contact_point":
            axes = self.models[name].placement(self.problem.arms[name].position).rotation
            self._shift(effect, name, axes[:, AXES.index(which)])
        else:
            joint = int(which) - 1
            if kind == "velocity":
                effect.before[where.start + joint] = 1.0
            elif kind == "motor_inertia":
                effect.generalised[where.start + joint] = -self.jump[where][joint]
            else:
                effect.generalised[where] = -self.mass_slopes[name][:, joint]
                self._move(effect, name, self.system.end_effector_jacobian[name][:, joint], joint)

    def _move(self, effect: _Effect, arm: str, motion: Array, joint: int = 0) -> None:
        """Contact points move with the object or, with ``arm``, with a pad, by a twist of its origin ``(6,)``."""
        for index, (point, of_point) in enumerate(zip(self.contacts, self.motions, strict=True)):
            moved = np.zeros(12)
            if not arm:
                moved[:6] = motion
            elif point.partner == arm:
                # the motion refers to the centre of the pad, the twist to frame E
                lever = self.meetings[arm].box.centre - self.system.end_effector_position[arm]
                moved[6:9], moved[9:] = motion[:3] + np.cross(motion[3:], lever), motion[3:]
            effect.turned[index] = of_point.normal @ moved
            self._displace(effect, index, of_point.on_object @ moved, of_point.on_partner @ moved, arm, motion)
        if arm:
            self._bend(effect, arm, joint)
        self._turn_impulses(effect)

    def _shift(self, effect: _Effect, arm: str, along: Array) -> None:
        """Contact points of a pad move along it."""
        for index, point in enumerate(self.contacts):
            if point.partner == arm:
                self._displace(effect, index, along, along, "-", np.zeros(6))

    def _displace(self, effect: _Effect, index: int, of_thing: Array, of_partner: Array, mover: str, by: Array) -> None:
        """One contact point moves on both bodies, and the origin of the ``mover`` (empty: object) with its body."""
        point, impulse = self.contacts[index], self.impulses[index]
        object_ = self.system.columns["object"]
        lever = of_thing - (by[:3] if mover == "" else 0.0)
        for name, velocity in (("of_relative", self.velocity), ("of_relative_before", self.system.velocity)):
            getattr(effect, name)[index] += np.cross(velocity[object_][3:], lever)
        effect.generalised[object_.start + 3 : object_.stop] += np.cross(lever, impulse)
        name = point.partner
        if name in self.models:
            of_arm, where = self.system.end_effector_jacobian[name], self.system.columns[name]
            lever = of_partner - (by[:3] if mover == name else 0.0)
            effect.of_relative[index] -= np.cross(of_arm[3:] @ self.velocity[where], lever)
            effect.of_relative_before[index] -= np.cross(of_arm[3:] @ self.system.velocity[where], lever)
            effect.generalised[where] -= of_arm[3:].T @ np.cross(lever, impulse)

    def _bend(self, effect: _Effect, arm: str, joint: int) -> None:
        """J of frame E changes with a joint."""
        changed, where = self.slopes[arm][joint], self.system.columns[arm]
        for index, point in enumerate(self.contacts):
            if point.partner != arm:
                continue
            lever = point.partner_position - self.system.end_effector_position[arm]
            rows = changed[:3] - np.cross(lever, changed[3:].T).T
            effect.of_relative[index] -= rows @ self.velocity[where]
            effect.of_relative_before[index] -= rows @ self.system.velocity[where]
            effect.generalised[where] -= rows.T @ self.impulses[index]

    def _turn_impulses(self, effect: _Effect) -> None:
        """Impulses rotate with their normals."""
        turned = np.cross(effect.turned, self.impulses)
        effect.generalised += self.system.jacobian(self.contacts).T @ turned.ravel()

    def twist_of(self, arm: str, names: Sequence[str]) -> Array:
        """Change of the twist of frame E at fixed u^+, ``(6, p)``."""
        moved = np.zeros((6, len(names)))
        velocity = self.velocity[self.system.columns[arm]]
        for index, name in enumerate(names):
            owner, kind, *rest = name.split(".") if "." in name else ("", "")
            if owner == arm and kind == "position":
                moved[:, index] = self.slopes[arm][int(rest[0]) - 1] @ velocity
        return moved


def chain_derivative(jacobian: Array) -> Array:
    """dJ / dq_j of a serial chain from its J in E[A] ``(6, n)``, ``(n, 6, n)``, j first."""
    linear, axes = jacobian[:3].T, jacobian[3:].T
    count = len(axes)
    slopes = np.zeros((count, 6, count))
    for j in range(count):
        slopes[j, :3, j:] = np.cross(axes[j], linear[j:]).T
        slopes[j, 3:, j:] = np.cross(axes[j], axes[j:]).T
        slopes[j, :3, :j] = np.cross(axes[:j], linear[j]).T
    return slopes
