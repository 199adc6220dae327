# SPDX-License-Identifier: Apache-2.0
"""Residuals of the contact laws, computed from the solution alone and by the same code for every engine.

With w = J_n u^+ + e J_n u^- and, per point, the inverse mass g = tr(G_ii) / 3 that turns impulses into velocities,

    penetration      max(0, -w)
    complementarity  max(w, 0) L_n / max(L_n),  g max(0, -L_n)
    friction         g |L_t - P(L_t - J_t u^+ / g)|,   P: projection onto the disk of radius mu max(L_n, 0)
    momentum         |H^-1 (H (u^+ - u^-) - J_c^T L)|

The friction term is the natural map of Coulomb's law: zero exactly when the point sticks inside the cone or slides
with the impulse on its edge, against the sliding velocity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.problem import Residual
from impact_rs_sim.impact_map.system import System
from impact_rs_sim.robot import Array

SLIDING = 1e-7  # m/s, slower points stick


@dataclass(frozen=True)
class ContactTerms:
    """Terms of a problem at its contact points, for the residuals of any number of solutions.

    Attributes:
        contacts: The m contact points.
        restitution: Newton restitution e [-].
        before: u^-, ``(nv,)`` [rad/s, m/s].
        jacobian: J_c, ``(3 m, nv)``.
        response: H^-1 J_c^T, ``(nv, 3 m)``.
        normals: Unit normals into the object, ``(m, 3)``.
        friction: Coulomb coefficients, ``(m,)`` [-].
        rebound: e J_n u^-, ``(m,)`` [m/s].
        inverse_mass: Mean over the directions of a point of its J_c H^-1 J_c^T, ``(m,)`` [1/kg].
        mobility: 1 / m of the object [1/kg].
    """

    contacts: Sequence[ContactPoint]
    restitution: float
    before: Array
    jacobian: Array
    response: Array
    normals: Array
    friction: Array
    rebound: Array
    inverse_mass: Array
    mobility: float

    @classmethod
    def of(cls, system: System, contacts: Sequence[ContactPoint], restitution: float) -> ContactTerms:
        """The terms of a problem.

        Args:
            system: Terms of the problem.
            contacts: The m contact points of the answer.
            restitution: Newton restitution e [-].
        """
        jacobian = system.jacobian(contacts)
        response = np.asarray(np.linalg.solve(system.inertia, jacobian.T), dtype=np.float64)
        normals = np.array([contact.normal for contact in contacts]).reshape(-1, 3)
        approach = np.sum(normals * (jacobian @ system.velocity).reshape(-1, 3), axis=1)
        return cls(
            contacts=contacts,
            restitution=restitution,
            before=system.velocity,
            jacobian=jacobian,
            response=response,
            normals=normals,
            friction=np.array([contact.friction for contact in contacts]),
            rebound=restitution * approach,
            inverse_mass=np.einsum("ij,ji->i", jacobian, response).reshape(-1, 3).mean(axis=1),
            mobility=float(1.0 / system.inertia[system.columns["object"].start, system.columns["object"].start]),
        )

    @cached_property
    def kernel(self) -> _kernel.Terms:
        """The same terms for the compiled laws."""
        return _kernel.Terms(
            self.jacobian @ self.response,
            self.jacobian @ self.before,
            self.normals,
            self.friction,
            self.rebound,
            self.inverse_mass,
            self.mobility,
        )

    def split(self, vectors: Array) -> tuple[Array, Array]:
        """Normal components ``(m,)`` and tangential parts ``(m, 3)`` of one vector per point, ``(m, 3)``."""
        along = np.sum(self.normals * vectors, axis=1)
        return along, vectors - along[:, None] * self.normals

    def sliding(self, impulses: Array, velocity: Array) -> tuple[Array, Array]:
        """Which points slide with their friction at its limit ``(m,)``, and unit vectors against sliding ``(m, 3)``."""
        pressing, tangential = self.split(impulses)
        _, sliding = self.split((self.jacobian @ velocity).reshape(-1, 3))
        speed = np.linalg.norm(sliding, axis=1)
        limit = self.friction * np.maximum(pressing, 0.0)
        slides = (np.linalg.norm(tangential, axis=1) >= limit * (1.0 - 1e-9)) & (speed > SLIDING)
        return slides, -sliding / np.maximum(speed, SLIDING)[:, None]

    def residual(self, impulses: Array, velocity: Array, least: Array | float = 0.0) -> Residual:
        """Residuals of a solution.

        Args:
            impulses: L on the object in axes of A, ``(m, 3)`` [N s].
            velocity: u^+, ``(nv,)`` [rad/s, m/s].
            least: What every point presses at least; L_n beyond it is complementary to opening [N s].
        """
        jump = velocity - self.before
        momentum = float(np.max(np.abs(jump - self.response @ impulses.ravel())))
        if not len(impulses):
            return Residual(0.0, 0.0, 0.0, momentum)
        return Residual(*self.kernel.judge(impulses, self.jacobian @ velocity, least), momentum)
