# SPDX-License-Identifier: Apache-2.0
"""The impact map at a measured state: one arm or two and an object, or one free body on a plane.

The laws are those of :mod:`impact_rs_sim.impact_map.problem`, solved as in :mod:`impact_rs_sim.impact_map.exact`,

    H (u^+ - u^-) = J_c^T L,    0 <= L_n  perpendicular to  J_n u^+ + e J_n u^- >= 0,    |L_t| <= mu L_n against J_t u^+

with e = ``restitution + bounce`` of the physics, for one impact is looked at by itself. What differs from a planned
impact is where the contact points come from. Poses are measured to a millimetre or so, and bodies that touch seem to
overlap or to stay apart; so the nearest points of two bodies are taken for touching, whatever their distance, and all
points with them that are no more than ``GAP_TOLERANCE`` further off.

A body that hits something fixed is an object without arms: H is its own inertia, and what it hits is the support. Its
mass cancels: H, and with it L, grows with the mass, and u^+ stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map.cones import solve_contacts
from impact_rs_sim.impact_map.contacts import (
    GAP_TOLERANCE,
    SUPPORT,
    ContactPoint,
    find_contacts,
    meetings,
)
from impact_rs_sim.impact_map.engine import Answer, check_energy
from impact_rs_sim.impact_map.exact import ExactEngine
from impact_rs_sim.impact_map.laws import ContactTerms, System, build_system
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scene import ArmState, BodyState

FRICTION, RESTITUTION = "friction", "restitution"  # what tables call the two numbers of a contact
PAD_REACH = 0.02  # m, between pad and object; measured poses are off by less, and beyond it nothing was hit
SUPPORT_REACH = 0.005  # m, between object and support; beyond it the object is in the air


@dataclass(frozen=True)
class MeasuredImpact:
    """The state just before an impact, and where it takes place.

    Attributes:
        arms: Configuration and ante-impact velocity by arm; empty: a free body hits something fixed.
        object: Pose and ante-impact twist of the object, or of the free body.
        points: Contact points; their friction is that of the physics at hand.
    """

    arms: dict[str, ArmState]
    object: BodyState
    points: tuple[ContactPoint, ...]

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


def restitution_of(physics: Physics) -> float:
    """Newton restitution of a single impact, between 0 and 1 [-]."""
    return min(max(physics.restitution + physics.bounce, 0.0), 1.0)


def solve_measured(
    physics: Physics,
    impact: MeasuredImpact,
    models: Mapping[str, RobotModel] | None = None,
    may_gain_energy: bool = False,
) -> tuple[Array, System]:
    """Post-impact velocity of a measured impact.

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
    if models is None:
        models = physics.robot_models()
    system = impact.system(physics, models)
    points = [replace(point, friction=_friction(physics, point)) for point in impact.points]
    terms = ContactTerms.of(system, points, restitution_of(physics))
    impulses, iterations = solve_contacts(terms)
    velocity = np.asarray(system.velocity + terms.response @ impulses.ravel())
    residual = terms.residual(impulses, velocity)
    if not residual.largest <= ExactEngine.tolerance:
        law, amount = residual.worst
        raise ImpactMapError(f"the impact map breaks {law} by {amount:.3g} m/s with {len(points)} contact points")
    if not may_gain_energy:
        answer = Answer(terms, impulses, velocity, iterations)
        check_energy(system.kinetic_energy, answer.energy_gain, impulses, residual, restitution_of(physics))
    return velocity, system


def _friction(physics: Physics, point: ContactPoint) -> float:
    """Coulomb coefficient of a point: of the support, or of the pads [-]."""
    return physics.support_friction if point.partner == SUPPORT else physics.pad_friction


def corners_that_touch(body: BodyState, size: Array, normal: Array) -> tuple[ContactPoint, ...]:
    """Corners of a box that come first to a plane: the lowest along its normal, and all as low up to the tolerance.

    Args:
        body: Pose of the box.
        size: Extent along its own axes, ``(3,)`` [m].
        normal: Unit normal of the plane, into the body, in A, ``(3,)``.
    """
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    corners = body.position + (signs * size / 2.0) @ body.rotation.T
    height = corners @ normal
    near = corners[height <= height.min() + GAP_TOLERANCE]
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
) -> tuple[ContactPoint, ...]:
    """Contact points of pads with the object, and of the object with its support.

    Args:
        physics: Sizes of pads, object and support.
        arms: Configurations by arm.
        body: Pose of the object.
        models: Rigid-body models by arm.
        on_pad: By arm, contact points in A that were measured, ``(3,)`` each [m], and the normal into the object, which
            is that of the nearest faces where it is None; else all points come from the geometry.

    Raises:
        Infeasible: No pad is near the object.
    """
    placements = {name: models[name].placement(state.position) for name, state in arms.items()}
    found: list[ContactPoint] = []
    nearest = np.inf
    for meeting in meetings(physics, body, placements):
        name = meeting.partner
        if name != SUPPORT:
            nearest = min(nearest, abs(meeting.separation))
        if name != SUPPORT and on_pad is not None and name in on_pad:
            positions, normal = on_pad[name]
            normal = meeting.normal if normal is None else normal
            found += [ContactPoint(name, np.asarray(position), normal, 0.0, 0.0) for position in positions]
        elif abs(meeting.separation) <= (SUPPORT_REACH if name == SUPPORT else PAD_REACH):
            near = find_contacts(physics, [meeting], PAD_REACH)
            first = min((point.gap for point in near), default=0.0)
            found += [point for point in near if point.gap <= first + GAP_TOLERANCE]
    if all(point.partner == SUPPORT for point in found):
        raise Infeasible(
            f"no pad touches the object: the nearest is {1e3 * nearest:.3g} mm away, expected at most "
            f"{1e3 * PAD_REACH:.3g} mm"
        )
    return tuple(found)
