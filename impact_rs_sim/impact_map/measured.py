# SPDX-License-Identifier: Apache-2.0
"""The impact map at a measured state: one or two arms and an object, or one free body on a plane.

The compiled map of :mod:`impact_rs_sim.impact_map.solve` solves the laws of :mod:`impact_rs_sim.impact_map.problem` for
all impacts of a table in one call. A table has single impacts, not a continued push, so its contact points have the
further laws of :mod:`impact_rs_sim.impact_map.contact_laws`.

Poses are measured to about a millimetre, and touching bodies seem to overlap or to be apart. So the nearest points of
two bodies touch, whatever their distance, and with them all points that are at most a tolerance further away.

A free body that hits something fixed is an object without arms: H is its inertia, and the fixed body is the support.
Its mass cancels: H and L are proportional to the mass, and u^+ does not depend on it.
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

FRICTION, RESTITUTION = "friction", "restitution"  # column names of the coefficients of a contact in tables,
SUPPORT_FRICTION = "support_friction"  # and of the friction between an object and its support
PAD_REACH = 0.02  # m, largest distance of a pad that hits the object; errors of measured poses are smaller
SUPPORT_REACH = 0.005  # m, largest distance of an object from the support that it rests on
_MAX_MODELS = 64  # cached rigid-body models of arms: some ten effects on the links, each with a step up and down
_MAX_KINEMATICS = 8  # cached kinematics of all impacts, by set of links; 0.8 kB an impact


@dataclass(frozen=True)
class MeasuredImpact:
    """The state just before an impact, and its contact points.

    Attributes:
        arms: Configuration and ante-impact velocity by arm; empty: a free body hits something fixed.
        object: Pose and ante-impact twist of the object, or of the free body.
        points: Contact points; their friction is taken from the physics, not from here.
        points_measured: Whether the points were measured in A; if not, they follow from the measured pose of the body.
    """

    arms: dict[str, ArmState]
    object: BodyState
    points: tuple[ContactPoint, ...]
    points_measured: bool = False

    def as_read(self, readings: TwistReadings) -> MeasuredImpact:
        """The true impact, if this one has readings: true twist, and the centre instead of the tracked point."""
        body = self.object
        # Points that follow from the pose move with the centre: then nothing changes but the twist.
        offset = readings.lever(body.rotation) if self.points_measured else np.zeros(3)
        twist = readings.twist_of(body.twist, body.rotation)
        return replace(self, object=BodyState(body.position - offset, body.rotation, twist))

    def system(self, physics: Physics, models: Mapping[str, RobotModel]) -> System:
        """Inertia and kinematics under some physics; ``models`` are the rigid-body models by arm."""
        return build_system(self._problem(physics), models)

    def closing_speed(self, physics: Physics, models: Mapping[str, RobotModel]) -> float:
        """Largest closing speed of a contact, ``max_i -n_i . (J_c u^-)_i`` [m/s]; below 0 all contacts open."""
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

    A fit solves them many times, with slightly different physics. Every later solution starts from the impulses of the
    first one, which takes a tenth of the steps. So an answer depends on the first physics and on its own, but not on
    solutions in between.

    Args:
        impacts: The impacts; at least one.
        physics_by_impact: The physics of every impact.
    """

    def __init__(self, impacts: Sequence[MeasuredImpact], physics_by_impact: Sequence[Physics]) -> None:
        self._impacts = tuple(impacts)
        physics_by_impact[0].object.check_free("a table of impacts")
        self._pads = {name: pad for name, pad in physics_by_impact[0].pads.items() if pad.arm in impacts[0].arms}
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
        self._first_impulses: Array | None = None  # of the first solution, (M, 3) [N s]
        self._arms = Recent[tuple[list[RobotFacts], tuple[Array, ...]]](_MAX_KINEMATICS)
        self._closing, self._slip = self._approach(physics_by_impact)

    def __getstate__(self) -> dict[str, object]:
        """All attributes, with an empty cache of kinematics: its keys are ids of objects in this process."""
        return {**vars(self), "_arms": Recent[tuple[list[RobotFacts], tuple[Array, ...]]](_MAX_KINEMATICS)}

    @property
    def closing_speeds(self) -> Array:
        """Largest closing speed of the contacts of every impact, ``(N,)`` [m/s]."""
        return np.maximum.reduceat(self._closing, self._first[:-1])

    def _approach(self, physics_by_impact: Sequence[Physics]) -> tuple[Array, Array]:
        """Closing and sliding speed of every contact point, ``(M,)`` each [m/s]; they do not depend on inertia."""
        position, _, twist = (values[self._owner] for values in self._body)
        relative = twist[:, :3] + np.cross(twist[:, 3:], self._position - position)
        on_partner = self._position - self._gap[:, None] * self._normal
        for number, name in enumerate(self._names):
            _, jacobian, frame_position, _ = self._kinematics(name, physics_by_impact)
            velocity = np.array([impact.arms[self._pads[name].arm].velocity for impact in self._impacts])
            frame_twist = np.einsum("nij,nj->ni", jacobian, velocity)[self._owner]
            pad_velocity = frame_twist[:, :3] + np.cross(frame_twist[:, 3:], on_partner - frame_position[self._owner])
            relative = np.where((self._partner == number)[:, None], relative - pad_velocity, relative)
        opening = np.sum(self._normal * relative, axis=1)
        return -opening, np.linalg.norm(relative - opening[:, None] * self._normal, axis=1)

    def _kinematics(self, name: str, physics_by_impact: Sequence[Physics]) -> tuple[Array, ...]:
        """M, J, origin and axes of frame E of one pad at all impacts; cached by set of links."""
        distinct, (arm, hand, _) = {id(physics): physics for physics in physics_by_impact}, self._pads[name]
        key = (name, *(_links_of(physics.arms[arm]) for physics in distinct.values()))

        def computed() -> tuple[list[RobotFacts], tuple[Array, ...]]:
            models = {number: _model_of(physics, arm) for number, physics in distinct.items()}
            terms = [
                tuple(np.array(part) for part in (inertia, jacobian, placement.translation, placement.rotation))
                for impact, physics in zip(self._impacts, physics_by_impact, strict=True)
                for inertia, jacobian, placement in [models[id(physics)].at_impact(impact.arms[arm].position, hand)]
            ]
            facts = [physics.arms[arm].facts for physics in distinct.values()]  # kept alive: the key has their ids
            return facts, tuple(np.array(parts) for parts in zip(*terms, strict=True))

        return self._arms.of(key, computed)[1]

    def contacts(self, physics_by_impact: Sequence[Physics]) -> ContactCondition:
        """State and laws of all contact points, impact by impact, ``(M,)`` each."""
        on_support = self._partner == len(self._names)
        distinct = {id(physics): physics for physics in physics_by_impact}
        if len(distinct) == 1:
            return laws_of(physics_by_impact[0], self._closing, self._slip, on_support)
        numbers = np.array([id(physics) for physics in physics_by_impact])[self._owner]
        laws = {
            number: vars(laws_of(physics, self._closing[mask], self._slip[mask], on_support[mask]))
            for number, physics in distinct.items()
            for mask in [numbers == number]
        }
        merged = {name: np.empty(len(self._owner)) for name in next(iter(laws.values()))}
        for number, coefficients in laws.items():
            for name, values in coefficients.items():
                merged[name][numbers == number] = values
        return ContactCondition(**merged)

    def solve(self, physics_by_impact: Sequence[Physics]) -> tuple[Array, Compiled]:
        """Post-impact velocities.

        Args:
            physics_by_impact: The physics of every impact.

        Returns:
            u^+, ``(N, nv)`` [rad/s, m/s], nan where no answer obeys the laws; and the solution of the compiled map.
        """
        if any(not physics.twist_readings.exact for physics in physics_by_impact):
            return self._solve_readings(physics_by_impact)
        contact = self.contacts(physics_by_impact)
        arms = []
        for name in self._names:
            inertia, jacobian, frame_position, axes = self._kinematics(name, physics_by_impact)
            arm = self._pads[name].arm
            states = [impact.arms[arm] for impact in self._impacts]
            velocity = np.array([state.velocity for state in states])
            position = np.zeros_like(velocity)  # limits are no part of a measured impact
            free = np.full(velocity.shape[1], np.finfo(float).max)
            motor = np.array([physics.arms[arm].motor_inertia_reduced for physics in physics_by_impact])
            no_motor = np.zeros((len(motor), velocity.shape[1] - motor.shape[1]))  # nothing drives a floating base
            motor = np.hstack((no_motor, motor))
            no_pad = (np.zeros(3), np.eye(3), np.ones(3), None, self._names.index(arm))  # contact points are given
            arms.append(
                (position, velocity, motor, -free, free, free, inertia, jacobian, frame_position, axes, *no_pad)
            )
        objects = [physics.object for physics in physics_by_impact]
        body = (
            np.array([item.mass for item in objects]),
            np.ones(3),
            np.array([item.inertia for item in objects]),
            np.array([item.com_offset for item in objects]),
        )
        points = (self._first, self._partner.tolist(), self._position, self._normal, self._gap, table_of(contact))
        compiled = Compiled(
            *_kernel.solve_impacts(
                len(self._impacts),
                arms,
                (*self._body, *body),
                (0.0, 0.0, 0.0),
                None,
                RULES,
                points=points,
                near=self._first_impulses,
            )
        )
        if self._first_impulses is None and len(compiled.impulse) == len(self._owner):
            self._first_impulses = np.nan_to_num(compiled.impulse)
        answers = np.array(compiled.velocity)
        answers[~(np.max(compiled.residual, axis=1) <= ExactEngine.tolerance)] = np.nan
        return answers, compiled

    def _solve_readings(self, physics_by_impact: Sequence[Physics]) -> tuple[Array, Compiled]:
        """Solution for twists as sensors read them: the map takes true twists, and u^+ is converted to readings."""
        impacts = [
            impact.as_read(physics.twist_readings)
            for impact, physics in zip(self._impacts, physics_by_impact, strict=True)
        ]
        distinct = {id(physics): replace(physics, twist_readings=TwistReadings()) for physics in physics_by_impact}
        physics_without_readings = [distinct[id(physics)] for physics in physics_by_impact]
        true_impacts = MeasuredImpacts(impacts, physics_without_readings)
        true_impacts._first_impulses = self._first_impulses
        velocity, compiled = true_impacts.solve(physics_without_readings)
        for velocity_of_impact, impact, physics in zip(velocity, self._impacts, physics_by_impact, strict=True):
            velocity_of_impact[-6:] = physics.twist_readings.twist(velocity_of_impact[-6:], impact.object.rotation)
        return velocity, compiled


# Making a model takes a hundred times as long as using it. Facts are kept alive, because the key has their id.
_models = Recent[tuple[RobotFacts, RobotModel]](_MAX_MODELS)


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
        may_gain_energy: Whether an answer that gains energy is accepted: a fit may pass through such answers.

    Returns:
        u^+, ``(nv,)`` [rad/s, m/s], and the terms of the system.

    Raises:
        EnergyGain: The answer gains energy.
        ImpactMapError: The answer breaks a law by more than the engine's tolerance.
    """
    system = impact.system(physics, physics.robot_models() if models is None else models)
    (velocity,), compiled = MeasuredImpacts([impact], [physics]).solve([physics])
    residual = Residual(*compiled.residual[0].tolist())
    if not np.isfinite(velocity).all():
        law, amount = residual.worst
        count = len(impact.points)
        raise ImpactMapError(f"the impact map breaks {law} by {amount:.3g} m/s with {count} contact points")
    if not may_gain_energy:
        before, gain = compiled.energy[0].tolist()
        check_energy(before, gain, compiled.impulse, residual, restitution_of(physics))
    return velocity, system


def points_that_touch(
    body: BodyState, size: Array, normal: Array, tolerance: float = GAP_TOLERANCE, shape: ConvexShape = BOX
) -> tuple[ContactPoint, ...]:
    """Points of a body that touch a plane first: the lowest along its normal, up to a tolerance.

    Args:
        body: Pose of the body.
        size: Extent along its own axes, ``(3,)`` [m].
        normal: Unit normal of the plane, into the body, in A, ``(3,)``.
        tolerance: Largest distance of a touching point beyond the distance of the first [m].
        shape: Its shape.
    """
    points = body.position + shape.first_points(size, -body.rotation.T @ normal, tolerance) @ body.rotation.T
    height = points @ normal
    touching = points[height <= height.min() + tolerance]
    return points_on_plane(touching, normal)


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
        on_pad: By arm, measured contact points in A, ``(3,)`` each [m], and the normal into the object (None: normal of
            the nearest faces). The contact points of other arms follow from the geometry.
        tolerance: Largest gap of a touching point minus the smallest gap between its two bodies [m].

    Raises:
        Infeasible: No pad is near the object.
    """
    placements = pad_placements(physics, models, arms)
    points: list[ContactPoint] = []
    nearest = np.inf
    for pair in contact_pairs(physics, body, placements):
        name = pair.partner
        if name != SUPPORT:
            nearest = min(nearest, abs(pair.separation))
        if name != SUPPORT and on_pad is not None and name in on_pad:
            positions, normal = on_pad[name]
            normal = pair.normal if normal is None else normal
            points += [ContactPoint(name, np.asarray(position), normal, 0.0, 0.0) for position in positions]
        elif abs(pair.separation) <= (SUPPORT_REACH if name == SUPPORT else PAD_REACH):
            candidates = find_contacts(physics, [pair], PAD_REACH)
            smallest_gap = min((point.gap for point in candidates), default=0.0)
            points += [point for point in candidates if point.gap <= smallest_gap + tolerance]
    if all(point.partner == SUPPORT for point in points):
        raise Infeasible(
            f"no pad touches the object: the nearest is {1e3 * nearest:.3g} mm away, expected at most "
            f"{1e3 * PAD_REACH:.3g} mm"
        )
    return tuple(points)
