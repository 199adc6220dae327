# SPDX-License-Identifier: Apache-2.0
"""Parameters of the impact map: named scalars, and the problem with some of them changed.

====================================  ========  ==============================================================
name                                  unit      what it is
====================================  ========  ==============================================================
``object.mass``                       kg        mass, at the same moments about the centre of mass
``object.inertia.x`` ...              kg m^2    principal moments about the centre of mass
``object.com_offset.x`` ...           m         centre of mass from the geometric centre, axes of the object
``object.position.x`` ...             m         geometric centre, axes of A
``object.rotation.x`` ...             rad       rotation vector of a turn of the object, axes of A
``object.velocity.x`` ...             m/s       ante-impact velocity of the centre, axes of A
``object.angular_velocity.x`` ...     rad/s     ante-impact angular velocity, axes of A
``ARM.motor_inertia.1`` ...           kg m^2    diagonal of B
``ARM.link_inertia``                  -         factor on M(q): masses and moments of all links
``ARM.position.1`` ...                rad       joint positions q
``ARM.velocity.1`` ...                rad/s     ante-impact joint velocities
``ARM.contact_point.x`` ``.y``        m         shift of the contact points along the pad, axes of frame E
``pad_friction`` ``support_friction``  -        Coulomb coefficients
``restitution``                       -         Newton restitution
====================================  ========  ==============================================================

Of a prismatic joint kg, m and m/s stand in the place of kg m^2, rad and rad/s.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import ContactPoint, Meeting, find_contacts, meetings
from impact_rs_sim.impact_map.laws import ContactTerms, System, build_system
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scene import ArmState, BodyState

AXES = "xyz"
OF_OBJECT = {
    "inertia": "kg m^2",
    "com_offset": "m",
    "position": "m",
    "rotation": "rad",
    "velocity": "m/s",
    "angular_velocity": "rad/s",
}
OF_JOINTS = {"motor_inertia": "inertia", "position": "position", "velocity": "velocity"}  # whose unit each has


@dataclass(frozen=True)
class MapParameter:
    """A scalar that a prediction depends on; ``name`` and ``unit`` are those of the table above."""

    name: str
    unit: str


def parameters_of(problem: ImpactProblem) -> tuple[MapParameter, ...]:
    """All parameters of a problem."""
    found = [MapParameter("object.mass", "kg")]
    found += [MapParameter(f"object.{kind}.{axis}", unit) for kind, unit in OF_OBJECT.items() for axis in AXES]
    for name in problem.arms:
        found += [
            MapParameter(f"{name}.{kind}.{joint}", getattr(units, quantity))
            for kind, quantity in OF_JOINTS.items()
            for joint, units in enumerate(problem.physics.arms[name].facts.units, start=1)
        ]
        found.append(MapParameter(f"{name}.link_inertia", "-"))
        found += [MapParameter(f"{name}.contact_point.{axis}", "m") for axis in "xy"]
    found += [MapParameter(name, "-") for name in ("pad_friction", "support_friction", "restitution")]
    return tuple(found)


@dataclass(frozen=True)
class Changed:
    """A problem with some parameters changed.

    Attributes:
        problem: The problem with the changes that it can represent.
        link_inertia: Change of the factor on M(q) by arm [-].
        contact_point: Shift of the contact points along x and y of frame E by arm, ``(2,)`` [m].
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
            where = system.columns[name]
            extra[where, where] = factor * system.link_inertia[where, where]
        return replace(system, inertia=system.inertia + extra, link_inertia=system.link_inertia + extra)

    def contacts(self, models: Mapping[str, RobotModel], found: Sequence[Meeting] | None = None) -> list[ContactPoint]:
        """Contact points; ``found`` holds the meetings of the object with its partners, where already known."""
        if found is None:
            placements = {name: models[name].placement(arm.position) for name, arm in self.problem.arms.items()}
            found = meetings(self.problem.physics, self.problem.object, placements)
        shifts = {
            name: models[name].placement(self.problem.arms[name].position).rotation[:, :2] @ along
            for name, along in self.contact_point.items()
        }
        return [
            replace(point, position=point.position + shifts[point.partner]) if point.partner in shifts else point
            for point in find_contacts(self.problem.physics, found)
        ]

    def terms(
        self, models: Mapping[str, RobotModel], found: Sequence[Meeting] | None = None
    ) -> tuple[System, ContactTerms]:
        """Terms of the contact laws; arguments as above."""
        system = self.system(models)
        return system, ContactTerms.of(system, self.contacts(models, found), self.problem.restitution)

    def touching_terms(self, models: Mapping[str, RobotModel], pads: Collection[str]) -> tuple[System, ContactTerms]:
        """The same with the pads of some arms moved along the normal until they touch."""
        placements = {name: models[name].placement(arm.position) for name, arm in self.problem.arms.items()}
        system, found = self.system(models), []
        positions = dict(system.end_effector_position)
        for meeting in meetings(self.problem.physics, self.problem.object, placements):
            if meeting.partner in pads:
                step = meeting.separation * meeting.normal
                positions[meeting.partner] = positions[meeting.partner] + step
                box = replace(meeting.box, centre=meeting.box.centre + step)
                meeting = replace(meeting, box=box, separation=0.0)
            found.append(meeting)
        system = replace(system, end_effector_position=positions)
        return system, ContactTerms.of(system, self.contacts(models, found), self.problem.restitution)


def change(problem: ImpactProblem, amounts: Mapping[str, float]) -> Changed:
    """The problem with parameters changed by some amounts, in the units of the table above.

    Raises:
        InputError: There is no such parameter.
    """
    units = {parameter.name for parameter in parameters_of(problem)}
    for name in amounts:
        if name not in units:
            raise InputError(f"no parameter {name!r} of the impact map; known are: {', '.join(sorted(units))}")
    physics = problem.physics
    of_object = {kind: np.array([amounts.get(f"object.{kind}.{axis}", 0.0) for axis in AXES]) for kind in OF_OBJECT}
    object_, body = physics.object, problem.object
    object_ = replace(
        object_,
        mass=object_.mass + amounts.get("object.mass", 0.0),
        inertia=object_.inertia + of_object["inertia"],
        com_offset=object_.com_offset + of_object["com_offset"],
    )
    body = BodyState(
        body.position + of_object["position"],
        pin.exp3(of_object["rotation"]) @ body.rotation,
        body.twist + np.concatenate((of_object["velocity"], of_object["angular_velocity"])),
    )
    arms, motors, factors, points = {}, {}, {}, {}
    for name, state in problem.arms.items():
        joints = {
            kind: np.array([amounts.get(f"{name}.{kind}.{joint + 1}", 0.0) for joint in range(state.position.size)])
            for kind in OF_JOINTS
        }
        arms[name] = ArmState(state.position + joints["position"], state.velocity + joints["velocity"])
        motors[name] = problem.motor_inertia[name] + joints["motor_inertia"]
        if factor := amounts.get(f"{name}.link_inertia", 0.0):
            factors[name] = factor
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
