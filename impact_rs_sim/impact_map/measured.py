# SPDX-License-Identifier: Apache-2.0
"""The impact map at a measured state: one arm or two and an object, or one free body on a plane.

The laws of :mod:`impact_rs_sim.impact_map.problem` are solved by the compiled map of
:mod:`impact_rs_sim.impact_map.solve`, at all impacts of a table in one call. One impact is looked at by itself, so its
contact points have more laws than the points of a push that goes on (:mod:`impact_rs_sim.impact_map.contact_laws`).

The contact points have another source than in a planned impact. Poses are measured to a millimetre or so, and
bodies that touch seem to overlap or to stay apart; so the nearest points of two bodies are taken for touching, whatever
their distance, and all points with them that are no more than a tolerance further off.

A body that hits something fixed is an object without arms: H is its own inertia, and what it hits is the support. Its
mass cancels: H, and with it L, grows with the mass, and u^+ stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim import _kernel
from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map.contact_laws import laws_of, table_of
from impact_rs_sim.impact_map.contacts import (
    GAP_TOLERANCE,
    SUPPORT,
    ContactPoint,
    contact_pairs,
    find_contacts,
)
from impact_rs_sim.impact_map.laws import System, build_system
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem, Residual
from impact_rs_sim.impact_map.solve import RULES, Compiled, ExactEngine, check_energy
from impact_rs_sim.physics import ArmPhysics, ContactCondition, Physics
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import Array, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scene import ArmState, BodyState, pad_placements
from impact_rs_sim.shapes import BOX, ConvexShape
from impact_rs_sim.twist_readings import TwistReadings

FRICTION, RESTITUTION = "friction", "restitution"  # what tables call the two numbers of a contact,
SUPPORT_FRICTION = "support_friction"  # and the friction of the support on which an object slides on
PAD_REACH = 0.02  # m, between pad and object; measured poses are off by less, and beyond it nothing was hit
SUPPORT_REACH = 0.005  # m, between object and support; beyond it the object is in the air
_MODELS = 64  # rigid-body models of arms, some ten effects on the links each way
_KEPT = 8  # kinematics of all impacts with one set of links; 0.8 kB an impact


@dataclass(frozen=True)
class MeasuredImpact:
    """The state just before an impact, and where it takes place.

    Attributes:
        arms: Configuration and ante-impact velocity by arm; empty: a free body hits something fixed.
        object: Pose and ante-impact twist of the object, or of the free body.
        points: Contact points; their friction comes from the physics at hand.
        points_measured: Whether the points were measured in A; if not, they belong to the body in its measured pose.
    """

    arms: dict[str, ArmState]
    object: BodyState
    points: tuple[ContactPoint, ...]
    points_measured: bool = False

    def as_read(self, readings: TwistReadings) -> MeasuredImpact:
        """The impact whose readings this one is: with the true twist, and the centre beside the tracked point."""
        body = self.object
        off = readings.lever(body.rotation) if self.points_measured else np.zeros(3)  # else the points move as well
        twist = readings.twist_of(body.twist, body.rotation)
        return replace(self, object=BodyState(body.position - off, body.rotation, twist))

    def system(self, physics: Physics, models: Mapping[str, RobotModel]) -> System:
        """Inertia and kinematics under some physics; ``models`` are the rigid-body models by arm."""
        return build_system(self._problem(physics), models)

    def closing_speed(self, physics: Physics, models: Mapping[str, RobotModel]) -> float:
        """Largest closing speed of a contact, ``max_i -n_i . (J_c u^-)_i`` [m/s]; below 0: none closes."""
        system = self.system(physics, models)
        relative = (system.jacobian(self.points) @ system.velocity).reshape(-1, 3)
        normals = np.array([point.normal for point in self.points])
        return float(np.max(-np.sum(normals * relative, axis=1)))

    def _problem(self, physics: Physics) -> ImpactProblem:
        return ImpactProblem(
            physics=physics,
            arms=self.arms,
            object=self.object,
            motor_inertia={name: arm.motor_inertia_reduced for name, arm in physics.arms.items()},
            restitution=restitution_of(physics),
        )


class MeasuredImpacts:
    """Impacts with the same arms, solved together.

    Physics of a fit differ little, and so do their impulses: all others begin at the impulses of the first solution,
    which takes a tenth of the steps. The answer depends on the first physics and on its own, not on what was solved in
    between.

    Args:
        impacts: The impacts; at least one.
        physics: The physics of each.
    """

    def __init__(self, impacts: Sequence[MeasuredImpact], physics: Sequence[Physics]) -> None:
        self._impacts = tuple(impacts)
        physics[0].object.check_free("a table of impacts")
        self._pads = {name: pad for name, pad in physics[0].pads.items() if pad.arm in impacts[0].arms}
        self._names = tuple(self._pads)
        bodies = [impact.object for impact in impacts]
        self._body = (
            np.array([body.position for body in bodies]),
            np.array([body.rotation for body in bodies]),
            np.array([body.twist for body in bodies]),
        )
        counts = [len(impact.points) for impact in impacts]
        points = [point for impact in impacts for point in impact.points]
        self._first = np.concatenate(([0], np.cumsum(counts))).tolist()
        self._owner = np.repeat(np.arange(len(impacts)), counts)
        self._position = np.array([point.position for point in points])
        self._normal = np.array([point.normal for point in points])
        self._gap = np.array([point.gap for point in points])
        self._partner = np.array(
            [self._names.index(p.partner) if p.partner in self._names else len(self._names) for p in points]
        )
        self._near: Array | None = None  # impulses of the first solution, (M, 3) [N s]
        self._arms = Recent[tuple[list[RobotFacts], tuple[Array, ...]]](_KEPT)
        self._closing, self._slip = self._approach(physics)

    def __getstate__(self) -> dict[str, object]:
        """All but the kinematics: their keys name objects of this process."""
        return {**vars(self), "_arms": Recent[tuple[list[RobotFacts], tuple[Array, ...]]](_KEPT)}

    @property
    def closing_speeds(self) -> Array:
        """Largest closing speed of the contacts of every impact, ``(N,)`` [m/s]."""
        return np.maximum.reduceat(self._closing, self._first[:-1])

    def _approach(self, physics: Sequence[Physics]) -> tuple[Array, Array]:
        """Closing and sliding speed of every contact point, ``(M,)`` each [m/s]; inertia has no part in them."""
        position, _, twist = (values[self._owner] for values in self._body)
        moving = twist[:, :3] + np.cross(twist[:, 3:], self._position - position)
        on_partner = self._position - self._gap[:, None] * self._normal
        for number, name in enumerate(self._names):
            _, jacobian, place, _ = self._kinematics(name, physics)
            velocity = np.array([impact.arms[self._pads[name].arm].velocity for impact in self._impacts])
            of_frame = np.einsum("nij,nj->ni", jacobian, velocity)[self._owner]
            there = of_frame[:, :3] + np.cross(of_frame[:, 3:], on_partner - place[self._owner])
            moving = np.where((self._partner == number)[:, None], moving - there, moving)
        opening = np.sum(self._normal * moving, axis=1)
        return -opening, np.linalg.norm(moving - opening[:, None] * self._normal, axis=1)

    def _kinematics(self, name: str, physics: Sequence[Physics]) -> tuple[Array, ...]:
        """M, J, and origin and axes of frame E of one pad at all impacts; kept for some sets of links."""
        distinct, (arm, hand, _) = {id(one): one for one in physics}, self._pads[name]
        key = (name, *(_links_of(one.arms[arm]) for one in distinct.values()))

        def made() -> tuple[list[RobotFacts], tuple[Array, ...]]:
            models = {number: _model_of(one, arm) for number, one in distinct.items()}
            found = [
                tuple(np.array(part) for part in (inertia, jacobian, place.translation, place.rotation))
                for impact, one in zip(self._impacts, physics, strict=True)
                for inertia, jacobian, place in [models[id(one)].at_impact(impact.arms[arm].position, hand)]
            ]
            facts = [one.arms[arm].facts for one in distinct.values()]  # alive, for the key has their ids
            return facts, tuple(np.array(parts) for parts in zip(*found, strict=True))

        return self._arms.of(key, made)[1]

    def contacts(self, physics: Sequence[Physics]) -> ContactCondition:
        """State and laws of all contact points, impact by impact, ``(M,)`` each."""
        on_support = self._partner == len(self._names)
        distinct = {id(one): one for one in physics}
        if len(distinct) == 1:
            return laws_of(physics[0], self._closing, self._slip, on_support)
        numbers = np.array([id(one) for one in physics])[self._owner]
        found = {
            number: vars(laws_of(one, self._closing[own], self._slip[own], on_support[own]))
            for number, one in distinct.items()
            for own in [numbers == number]
        }
        together = {name: np.empty(len(self._owner)) for name in next(iter(found.values()))}
        for number, of_one in found.items():
            for name, values in of_one.items():
                together[name][numbers == number] = values
        return ContactCondition(**together)

    def solve(self, physics: Sequence[Physics]) -> tuple[Array, Compiled]:
        """Post-impact velocities.

        Args:
            physics: The physics of each impact.

        Returns:
            u^+, ``(N, nv)`` [rad/s, m/s], nan where no answer obeys the laws; and what the compiled map returns.
        """
        if any(not one.twist_readings.exact for one in physics):
            return self._solve_readings(physics)
        contact = self.contacts(physics)
        arms = []
        for name in self._names:
            inertia, jacobian, place, axes = self._kinematics(name, physics)
            arm = self._pads[name].arm
            states = [impact.arms[arm] for impact in self._impacts]
            velocity = np.array([state.velocity for state in states])
            position = np.zeros_like(velocity)  # limits are no part of a measured impact
            free = np.full(velocity.shape[1], np.finfo(float).max)
            motor = np.array([one.arms[arm].motor_inertia_reduced for one in physics])
            of_base = np.zeros((len(motor), velocity.shape[1] - motor.shape[1]))  # no motor drives a base that floats
            motor = np.hstack((of_base, motor))
            no_pad = (np.zeros(3), np.eye(3), np.ones(3), None, self._names.index(arm))  # contact points are given
            arms.append((position, velocity, motor, -free, free, free, inertia, jacobian, place, axes, *no_pad))
        objects = [one.object for one in physics]
        body = (
            np.array([item.mass for item in objects]),
            np.ones(3),
            np.array([item.inertia for item in objects]),
            np.array([item.com_offset for item in objects]),
        )
        points = (self._first, self._partner.tolist(), self._position, self._normal, self._gap, table_of(contact))
        found = Compiled(
            *_kernel.solve_impacts(
                len(self._impacts),
                arms,
                (*self._body, *body),
                (0.0, 0.0, 0.0),
                None,
                RULES,
                points=points,
                near=self._near,
            )
        )
        if self._near is None:
            self._near = np.nan_to_num(found.impulse) if len(found.impulse) == len(self._owner) else None
        answers = np.array(found.velocity)
        answers[~(np.max(found.residual, axis=1) <= ExactEngine.tolerance)] = np.nan
        return answers, found

    def _solve_readings(self, physics: Sequence[Physics]) -> tuple[Array, Compiled]:
        """Solution for twists as sensors read them: the map takes true twists, and u^+ is converted to readings."""
        impacts = [impact.as_read(one.twist_readings) for impact, one in zip(self._impacts, physics, strict=True)]
        distinct = {id(one): replace(one, twist_readings=TwistReadings()) for one in physics}
        exact = [distinct[id(one)] for one in physics]
        true = MeasuredImpacts(impacts, exact)
        true._near = self._near
        velocity, found = true.solve(exact)
        for own, impact, one in zip(velocity, self._impacts, physics, strict=True):
            own[-6:] = one.twist_readings.twist(own[-6:], impact.object.rotation)
        return velocity, found


# To make one takes a hundred times as long as to use it. Facts are kept alive, because the key has their id.
_models = Recent[tuple[RobotFacts, RobotModel]](_MODELS)


def _model_of(physics: Physics, name: str) -> RobotModel:
    """The rigid-body model of one arm."""
    arm = physics.arms[name]
    key = _links_of(arm), physics.gravity.tobytes()
    return _models.of(key, lambda: (arm.facts, physics.robot_model(name)))[1]


def _links_of(arm: ArmPhysics) -> tuple[object, ...]:
    """Everything that the kinematics and the link inertia of an arm depend on."""
    return id(arm.facts), arm.end_effector, *arm.hands.items(), arm.base.homogeneous.tobytes()


def restitution_of(physics: Physics) -> float:
    """Newton restitution of a single impact, between 0 and 1 [-]."""
    return min(max(physics.restitution + physics.bounce, 0.0), 1.0)


def solve_measured(
    physics: Physics,
    impact: MeasuredImpact,
    models: Mapping[str, RobotModel] | None = None,
    may_gain_energy: bool = False,
) -> tuple[Array, System]:
    """Post-impact velocity of one measured impact.

    Args:
        physics: Friction, restitution, object, motor inertia.
        impact: State just before, and contact points.
        models: Rigid-body models by arm under these physics, where the caller has them already.
        may_gain_energy: Whether an answer with more energy than there was is given: a fit passes such on its way.

    Returns:
        u^+, ``(nv,)`` [rad/s, m/s], and the terms of the system.

    Raises:
        EnergyGain: The answer gains energy.
        ImpactMapError: The answer breaks a law by more than the engine's tolerance.
    """
    system = impact.system(physics, physics.robot_models() if models is None else models)
    (velocity,), found = MeasuredImpacts([impact], [physics]).solve([physics])
    residual = Residual(*found.residual[0].tolist())
    if not np.isfinite(velocity).all():
        law, amount = residual.worst
        count = len(impact.points)
        raise ImpactMapError(f"the impact map breaks {law} by {amount:.3g} m/s with {count} contact points")
    if not may_gain_energy:
        before, gain = found.energy[0].tolist()
        check_energy(before, gain, found.impulse, residual, restitution_of(physics))
    return velocity, system


def points_that_touch(
    body: BodyState, size: Array, normal: Array, tolerance: float = GAP_TOLERANCE, shape: ConvexShape = BOX
) -> tuple[ContactPoint, ...]:
    """Points of a body that come first to a plane: the lowest along its normal, and all as low up to the tolerance.

    Args:
        body: Pose of the body.
        size: Extent along its own axes, ``(3,)`` [m].
        normal: Unit normal of the plane, into the body, in A, ``(3,)``.
        tolerance: Largest distance of a touching point beyond the distance of the first [m].
        shape: Its shape.
    """
    points = body.position + shape.first_points(size, -body.rotation.T @ normal, tolerance) @ body.rotation.T
    height = points @ normal
    near = points[height <= height.min() + tolerance]
    return points_on_plane(near, normal)


def points_on_plane(positions: Sequence[Array] | Array, normal: Array) -> tuple[ContactPoint, ...]:
    """Contact points of a free body on a plane.

    Args:
        positions: In A, ``(3,)`` each [m].
        normal: Unit normal of the plane, into the body, in A, ``(3,)``.
    """
    return tuple(ContactPoint(SUPPORT, np.asarray(position), normal, 0.0, 0.0) for position in positions)


def points_of_scene(
    physics: Physics,
    arms: Mapping[str, ArmState],
    body: BodyState,
    models: Mapping[str, RobotModel],
    on_pad: Mapping[str, tuple[Sequence[Array], Array | None]] | None = None,
    tolerance: float = GAP_TOLERANCE,
) -> tuple[ContactPoint, ...]:
    """Contact points of pads with the object, and of the object with its support.

    Args:
        physics: Sizes of pads, object and support.
        arms: Configurations by arm.
        body: Pose of the object.
        models: Rigid-body models by arm.
        on_pad: By arm, contact points in A that were measured, ``(3,)`` each [m], and the normal into the object, which
            is that of the nearest faces where it is None; else all points come from the geometry.
        tolerance: Largest gap of a touching point beyond the smallest gap of its two bodies [m].

    Raises:
        Infeasible: No pad is near the object.
    """
    placements = pad_placements(physics, models, arms)
    found: list[ContactPoint] = []
    nearest = np.inf
    for pair in contact_pairs(physics, body, placements):
        name = pair.partner
        if name != SUPPORT:
            nearest = min(nearest, abs(pair.separation))
        if name != SUPPORT and on_pad is not None and name in on_pad:
            positions, normal = on_pad[name]
            normal = pair.normal if normal is None else normal
            found += [ContactPoint(name, np.asarray(position), normal, 0.0, 0.0) for position in positions]
        elif abs(pair.separation) <= (SUPPORT_REACH if name == SUPPORT else PAD_REACH):
            near = find_contacts(physics, [pair], PAD_REACH)
            first = min((point.gap for point in near), default=0.0)
            found += [point for point in near if point.gap <= first + tolerance]
    if all(point.partner == SUPPORT for point in found):
        raise Infeasible(
            f"no pad touches the object: the nearest is {1e3 * nearest:.3g} mm away, expected at most "
            f"{1e3 * PAD_REACH:.3g} mm"
        )
    return tuple(found)
