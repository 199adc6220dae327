# SPDX-License-Identifier: Apache-2.0
"""All bodies of an impact as one mechanical system.

The generalised velocity stacks the joint velocities of every arm and the twist of the object at its geometric centre,
``u = (dq_1, ..., dq_k, v_O, omega)``, so that

    H = blockdiag(M_1 + B_1, ..., M_k + B_k, M_object),      H (u^+ - u^-) = J_c^T L.

Engines and the residual share these terms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel

_AXES = (0, 1, 2)


@dataclass(frozen=True)
class System:
    """Inertia and kinematics at the moment of impact.

    Attributes:
        columns: Where each arm's joints, and under ``object`` the object's twist, stand in u.
        inertia: H, ``(nv, nv)`` [kg m^2, kg m, kg].
        link_inertia: H with B = 0, ``(nv, nv)``.
        velocity: u^-, ``(nv,)`` [rad/s, m/s].
        end_effector_position: Origin of frame E in A by arm, ``(3,)`` [m].
        end_effector_jacobian: Jacobian of frame E in E[A] by arm, ``(6, n)``.
        object_position: Geometric centre of the object in A, ``(3,)`` [m].
    """

    columns: Mapping[str, slice]
    inertia: Array
    link_inertia: Array
    velocity: Array
    end_effector_position: Mapping[str, Array]
    end_effector_jacobian: Mapping[str, Array]
    object_position: Array

    @property
    def kinetic_energy(self) -> float:
        """Before the impact [J]."""
        return 0.5 * float(self.velocity @ self.inertia @ self.velocity)

    def jacobian(self, contacts: Sequence[ContactPoint]) -> Array:
        """J_c: velocity of the object relative to its partner, ``(3 m, nv)``, three rows of axes of A per point."""
        size = self.velocity.size
        jacobian = np.zeros((len(contacts), 3, size))
        positions = np.array([contact.position for contact in contacts]).reshape(-1, 3)
        jacobian[:, :, self.columns["object"]] = point_maps(positions - self.object_position)
        for name, of_arm in self.end_effector_jacobian.items():
            rows = [row for row, contact in enumerate(contacts) if contact.partner == name]
            levers = np.array([contacts[row].partner_position for row in rows]).reshape(-1, 3)
            levers -= self.end_effector_position[name]
            jacobian[rows, :, self.columns[name]] = -point_maps(levers) @ of_arm
        return jacobian.reshape(3 * len(contacts), size)

    def split(self, velocity: Array) -> tuple[dict[str, Array], dict[str, Array], Array]:
        """Joint velocity by arm, twist of frame E by arm, and twist of the object, out of u ``(nv,)``."""
        joints = {name: velocity[self.columns[name]] for name in self.end_effector_jacobian}
        twists = {name: self.end_effector_jacobian[name] @ dq for name, dq in joints.items()}
        return joints, twists, velocity[self.columns["object"]]


def point_maps(levers: Array) -> Array:
    """Twist of a body at O to velocities of its points at O + ``levers`` ``(m, 3)``, ``(m, 3, 6)``."""
    maps = np.zeros((len(levers), 3, 6))
    maps[:, _AXES, _AXES] = 1.0
    maps[:, (1, 2, 0), (5, 3, 4)] = levers
    maps[:, (2, 0, 1), (4, 5, 3)] = -levers
    return maps


def build_system(problem: ImpactProblem, models: Mapping[str, RobotModel]) -> System:
    """Terms of ``problem``; ``models`` are the rigid-body models by arm."""
    columns: dict[str, slice] = {}
    start = 0
    for name, state in problem.arms.items():
        columns[name] = slice(start, start + state.position.size)
        start += state.position.size
    columns["object"] = slice(start, start + 6)
    link_inertia = np.zeros((start + 6, start + 6))
    velocity = np.zeros(start + 6)
    motor = np.zeros(start + 6)
    positions, jacobians = {}, {}
    for name, state in problem.arms.items():
        where = columns[name]
        link_inertia[where, where] = models[name].mass_matrix(state.position)
        motor[where] = problem.motor_inertia[name]
        velocity[where] = state.velocity
        jacobians[name] = models[name].jacobian(state.position)
        positions[name] = models[name].placement(state.position).translation.copy()
    object_, body = problem.physics.object, problem.object
    inertia = pin.Inertia(object_.mass, body.rotation @ object_.com_offset, _rotated(object_.inertia, body.rotation))
    link_inertia[columns["object"], columns["object"]] = inertia.matrix()
    velocity[columns["object"]] = body.twist
    return System(
        columns=columns,
        inertia=link_inertia + np.diag(motor),
        link_inertia=link_inertia,
        velocity=velocity,
        end_effector_position=positions,
        end_effector_jacobian=jacobians,
        object_position=body.position,
    )


def _rotated(moments: Array, rotation: Array) -> Array:
    return np.asarray((rotation * moments) @ rotation.T)
