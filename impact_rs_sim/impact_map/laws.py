# SPDX-License-Identifier: Apache-2.0
"""The laws of an impact: terms of a problem, residuals of a solution, and Newton's method.

**Terms.** All bodies form one mechanical system. The generalised velocity stacks the joint velocities of every arm and
the twist of the object at its geometric centre (then of its neighbours), ``u = (dq_1, ..., dq_k, v_O, omega)``, so that

    H = blockdiag(M_1 + B_1, ..., M_k + B_k, M_object),      H (u^+ - u^-) = J_c^T L

with the laws of :mod:`impact_rs_sim.impact_map.problem` for the impulses L. Every engine shares these terms. Two hands
of one robot share its block of H: their rows of J_c are those of J_left and J_right, and J_left (M + B)^-1 J_right^T
is the mobility between the hands, the velocity of the left hand per impulse on the right one.
An object on a hinge or slide has a twist S dz, with one velocity dz in place of six: its block is S^T M_object S, its
columns of J_c are multiplied by S, and the impulses of the bearing, which do no work, are not unknowns.

**Residuals** are computed from the solution alone, by the same code for every engine. With the closing velocity
min(J_n u^-, 0) before the impact, w = J_n u^+ + e min(J_n u^-, 0) and, per point, the inverse mass g = tr(G_ii) / 3
that turns impulses into velocities,

    penetration      max(0, -w)
    complementarity  max(w, 0) L_n / max(L_n),  g max(0, -L_n)
    friction         g |L_t - P(L_t - J_t u^+ / g)|,   P: projection onto the disk of radius mu max(L_n, 0)
    momentum         |H^-1 (H (u^+ - u^-) - J_c^T L)|

The friction term is the natural map of Coulomb's law: zero exactly when the point sticks inside the cone or slides
with the impulse on its edge, against the sliding velocity.

**Newton's method.** With s_i = (J_c u^+)_i + e min(J_n u^-, 0)_i n_i + (rho / m) L_i, the mass m of the object, the
impulse L_n >= a of every contact point, r_i = 1 / g_i and the projection P onto the disk of radius mu L_n, the laws are

    F_n = L_n - max(a, L_n - r s_n) = 0,        F_t = L_t - P(L_t - r s_t) = 0

(Alart and Curnier 1991), and u^+ = u^- + H^-1 J_c^T L. a = 0 but in the second phase of Poisson's law.

**Uniqueness.** Four corners of a face share a load in many ways. Where they slide, each share has its own friction, and
u^+ is not unique. A compliance rho > 0 makes it unique: every contact point yields by rho / m per impulse. As rho goes
to 0 the impulses tend to the impulses of minimum norm with the same velocities. With ``COMPLIANCE`` a point yields
by 1e-8 of the velocity that its impulse gives the object. The solution is then :func:`hardened <harden>`: rho L / m is
replaced by rho (L - L') / m with the previous solution L' (proximal point method, Rockafellar 1976). This removes the
effect of the compliance, keeps the choice, and the result obeys the rigid laws.

The laws, their derivatives and the iterations are compiled (``src/laws.cpp``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map.contacts import OBJECT, ContactPoint
from impact_rs_sim.impact_map.problem import ImpactProblem, Residual
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scene import BodyState

COMPLIANCE = 1e-8  # rho [-]; at a tenth of it rounding errors begin to determine the shares of the load
SLIDING = 1e-7  # m/s, slower points stick
_AXES = (0, 1, 2)


@dataclass(frozen=True)
class System:
    """Inertia and kinematics at the impact.

    Attributes:
        columns: Columns of u by name: velocities of the arm for every pad, twist for every object (``object`` ...).
        inertia: H, ``(nv, nv)`` [kg m^2, kg m, kg]; a fixed object has unit inertia there, which no impulse moves.
        link_inertia: H with B = 0, ``(nv, nv)``.
        velocity: u^-, ``(nv,)`` [rad/s, m/s].
        end_effector_position: Origin of frame E in A by pad, ``(3,)`` [m].
        end_effector_jacobian: Jacobian of frame E in E[A] by pad, ``(6, n)``.
        object_position: Geometric centre of the object in A, ``(3,)`` [m].
        fixed: Whether the object is fixed: no contact point then has columns of it in J_c.
        neighbour_position: Geometric centres of its neighbours likewise, by name.
        hands: Pads of further hands; they share the velocities of their arms.
        freedom: Twist of the object per velocity along its hinge or slide, axes of A, ``(6, d)``; u then contains these
            d velocities instead of a twist, and H their inertia. None: the object is free or fixed.
    """

    columns: Mapping[str, slice]
    inertia: Array
    link_inertia: Array
    velocity: Array
    end_effector_position: Mapping[str, Array]
    end_effector_jacobian: Mapping[str, Array]
    object_position: Array
    fixed: bool = False
    neighbour_position: Mapping[str, Array] = field(default_factory=dict)
    hands: tuple[str, ...] = ()
    freedom: Array | None = None

    @property
    def free(self) -> bool:
        """Whether the object is neither fixed nor guided."""
        return not self.fixed and self.freedom is None

    @property
    def kinetic_energy(self) -> float:
        """Before the impact [J]."""
        return 0.5 * float(self.velocity @ self.inertia @ self.velocity)

    def jacobian(self, contacts: Sequence[ContactPoint]) -> Array:
        """J_c: velocity of the object relative to its partner, ``(3 m, nv)``, three rows of axes of A per point."""
        size = self.velocity.size
        jacobian = np.zeros((len(contacts), 3, size))
        positions = np.array([contact.position for contact in contacts]).reshape(-1, 3)
        centres = {OBJECT: self.object_position, **self.neighbour_position}
        for name, centre in {} if self.fixed else centres.items():
            own_rows = [row for row, contact in enumerate(contacts) if contact.body == name]
            jacobian[own_rows, :, self.columns[name]] = self._maps(name, positions[own_rows] - centre)
            partner_rows = [row for row, contact in enumerate(contacts) if contact.partner == name]
            partner_points = np.array([contacts[row].partner_position for row in partner_rows]).reshape(-1, 3)
            jacobian[partner_rows, :, self.columns[name]] = -self._maps(name, partner_points - centre)
        for name, pad_jacobian in self.end_effector_jacobian.items():
            rows = [row for row, contact in enumerate(contacts) if contact.partner == name]
            levers = np.array([contacts[row].partner_position for row in rows]).reshape(-1, 3)
            levers -= self.end_effector_position[name]
            jacobian[rows, :, self.columns[name]] = -point_maps(levers) @ pad_jacobian
        return jacobian.reshape(3 * len(contacts), size)

    def _maps(self, name: str, levers: Array) -> Array:
        """Velocities of points at ``levers`` from the centre of an object, per its velocities in u, ``(m, 3, d)``."""
        maps = point_maps(levers)
        return maps if self.freedom is None or name != OBJECT else np.asarray(maps @ self.freedom)

    def split(self, velocity: Array) -> tuple[dict[str, Array], dict[str, Array], Array]:
        """Joint velocity by arm, twist of frame E by pad, and twist of the object, out of u ``(nv,)``."""
        velocities = {name: velocity[self.columns[name]] for name in self.end_effector_jacobian}
        twists = {name: self.end_effector_jacobian[name] @ dq for name, dq in velocities.items()}
        joints = {name: dq for name, dq in velocities.items() if name not in self.hands}
        object_velocity = velocity[self.columns[OBJECT]]
        return joints, twists, object_velocity if self.freedom is None else self.freedom @ object_velocity

    def neighbour_twists(self, velocity: Array) -> dict[str, Array]:
        """Twists of the neighbours of the object by name, out of u ``(nv,)``."""
        return {name: velocity[self.columns[name]] for name in self.neighbour_position}


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
        columns[name] = slice(start, start + state.velocity.size)
        start += state.velocity.size
    bodies = problem.bodies
    freedom = problem.physics.object.freedom_at(problem.object.rotation)
    for name in bodies:
        size = 6 if freedom is None or name != OBJECT else freedom.shape[1]
        columns[name] = slice(start, start + size)
        start += size
    link_inertia = np.zeros((start, start))
    velocity = np.zeros(start)
    motor = np.zeros(start)
    positions, jacobians = {}, {}
    for name, state in problem.arms.items():
        block = columns[name]
        link_inertia[block, block] = models[name].mass_matrix(state.position)
        motor[block] = models[name].facts.columns_of(problem.motor_inertia[name])
        velocity[block] = state.velocity
    for name, pad in problem.physics.pads.items():
        model, q = models[pad.arm], problem.arms[pad.arm].position
        columns[name] = columns[pad.arm]
        jacobians[name] = model.jacobian(q, pad.hand)
        positions[name] = model.placement(q, pad.hand).translation
    for name, (object_, body) in bodies.items():
        object_inertia, twist = _object_inertia(object_, body), body.twist
        if freedom is not None and name == OBJECT:
            object_inertia = freedom.T @ object_inertia @ freedom
            twist = np.asarray(np.linalg.lstsq(freedom, twist, rcond=None)[0], dtype=np.float64)
        link_inertia[columns[name], columns[name]] = object_inertia
        velocity[columns[name]] = twist
    return System(
        columns=columns,
        inertia=link_inertia + np.diag(motor),
        link_inertia=link_inertia,
        velocity=velocity,
        end_effector_position=positions,
        end_effector_jacobian=jacobians,
        object_position=problem.object.position,
        fixed=problem.physics.object.fixed,
        neighbour_position={name: body.position for name, (_, body) in bodies.items() if name != OBJECT},
        hands=tuple(name for name, pad in problem.physics.pads.items() if pad.hand),
        freedom=freedom,
    )


def _object_inertia(object_: ObjectPhysics, body: BodyState) -> Array:
    """Spatial inertia of the object at its geometric centre, axes of A, ``(6, 6)``."""
    if object_.fixed:
        return np.eye(6)
    com, moments = body.rotation @ object_.com_offset, _rotated(object_.inertia, body.rotation)
    return np.asarray(pin.Inertia(object_.mass, com, moments).matrix())


def _rotated(moments: Array, rotation: Array) -> Array:
    return np.asarray((rotation * moments) @ rotation.T)


@dataclass(frozen=True)
class ContactTerms:
    """Terms of a problem at its contact points, for the residuals of any number of solutions.

    Attributes:
        contacts: The m contact points.
        restitution: Newton restitution e [-].
        before: Ante-impact velocity u^-, ``(nv,)`` [rad/s, m/s].
        jacobian: J_c, ``(3 m, nv)``.
        response: H^-1 J_c^T, ``(nv, 3 m)``.
        normals: Unit normals into the object, ``(m, 3)``.
        friction: Coulomb coefficients, ``(m,)`` [-].
        rebound: e min(J_n u^-, 0), 0 for points that open before the impact, ``(m,)`` [m/s].
        inverse_mass: Mean over the directions of a point of its J_c H^-1 J_c^T, ``(m,)`` [1/kg].
        mobility: 1 / m of the object, or mean of ``inverse_mass`` where it is fixed or guided [1/kg].
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
        inverse_mass = np.einsum("ij,ji->i", jacobian, response).reshape(-1, 3).mean(axis=1)
        first = system.columns["object"].start
        return cls(
            contacts=contacts,
            restitution=restitution,
            before=system.velocity,
            jacobian=jacobian,
            response=response,
            normals=normals,
            friction=np.array([contact.friction for contact in contacts]),
            rebound=restitution * np.minimum(approach, 0.0),
            inverse_mass=inverse_mass,
            mobility=float(
                inverse_mass.mean() if not system.free and len(contacts) else 1.0 / system.inertia[first, first]
            ),
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
        """Mask of points that slide with friction at its limit ``(m,)``; unit vectors against sliding ``(m, 3)``."""
        pressing, tangential = self.split(impulses)
        _, sliding = self.split((self.jacobian @ velocity).reshape(-1, 3))
        speed = np.linalg.norm(sliding, axis=1)
        limit = self.friction * np.maximum(pressing, 0.0)
        slides = (np.linalg.norm(tangential, axis=1) >= limit * (1.0 - 1e-9)) & (speed > SLIDING)
        return slides, -sliding / np.maximum(speed, SLIDING)[:, None]

    def residual(self, impulses: Array, velocity: Array, lower_bound: Array | float = 0.0) -> Residual:
        """Residuals of a solution.

        Args:
            impulses: L on the object in axes of A, ``(m, 3)`` [N s].
            velocity: u^+, ``(nv,)`` [rad/s, m/s].
            lower_bound: Lower bound of the normal impulses; L_n beyond it is complementary to opening [N s].
        """
        jump = velocity - self.before
        momentum = float(np.max(np.abs(jump - self.response @ impulses.ravel())))
        if not len(impulses):
            return Residual(0.0, 0.0, 0.0, momentum)
        return Residual(*self.kernel.judge(impulses, self.jacobian @ velocity, lower_bound), momentum)


@dataclass(frozen=True)
class Linearisation:
    """The laws at one L and their derivatives: dF_i = by_impulse dL_i + by_velocity ds_i + by_friction dmu_i.

    Attributes:
        defect: F, ``(m, 3)`` [N s].
        by_impulse: ``(m, 3, 3)`` [-].
        by_velocity: ``(m, 3, 3)`` [kg].
        by_friction: ``(m, 3)`` [N s].
        state: Per point ``open``, ``stick`` or ``slide``, ``(m,)``.
        margin: Distance to another contact state, as a velocity, ``(m,)`` [m/s].
    """

    defect: Array
    by_impulse: Array
    by_velocity: Array
    by_friction: Array
    state: tuple[str, ...]
    margin: Array


def delassus(terms: ContactTerms, compliance: float = COMPLIANCE) -> Array:
    """J_c H^-1 J_c^T + rho / m, ``(3 m, 3 m)`` [1/kg]."""
    operator = terms.jacobian @ terms.response
    if not len(operator):
        return operator
    return np.asarray((operator + operator.T) / 2.0 + compliance * terms.mobility * np.eye(len(operator)))


def linearise(terms: ContactTerms, impulses: Array, velocity: Array, lower_bound: Array | float = 0.0) -> Linearisation:
    """The laws at impulses ``(m, 3)`` [N s] and velocities s ``(m, 3)`` [m/s], with L_n >= ``lower_bound`` [N s]."""
    return Linearisation(*terms.kernel.linearise(impulses, velocity, lower_bound))


def yielding_velocity(terms: ContactTerms, operator: Array, impulses: Array) -> Array:
    """s at impulses ``(m, 3)``, ``(m, 3)`` [m/s]; ``operator`` by :func:`delassus`."""
    velocity = (terms.jacobian @ terms.before + operator @ impulses.ravel()).reshape(-1, 3)
    return np.asarray(velocity + terms.rebound[:, None] * terms.normals)


def slope(linear: Linearisation, operator: Array) -> Array:
    """dF / dL with u^+ following L, ``(3 m, 3 m)``."""
    count = len(linear.defect)
    matrix = np.einsum("mij,mjk->mik", linear.by_velocity, operator.reshape(count, 3, 3 * count))
    matrix = matrix.reshape(3 * count, 3 * count)
    for index, block in enumerate(linear.by_impulse):
        rows = slice(3 * index, 3 * index + 3)
        matrix[rows, rows] += block
    return np.asarray(matrix)


def states(terms: ContactTerms, impulses: Array, compliance: float = COMPLIANCE) -> tuple[str, ...]:
    """``open``, ``stick`` or ``slide`` of every contact point of an answer."""
    if not len(impulses):
        return ()
    return linearise(terms, impulses, yielding_velocity(terms, delassus(terms, compliance), impulses)).state


def solve_contacts(terms: ContactTerms) -> tuple[Array, int]:
    """Impulses on the object that obey the laws, ``(m, 3)`` [N s], and the number of sweeps and Newton steps.

    With a compliance of a tenth of the inverse mass at every point the solution is unique and shares loads evenly. A
    few Gauss-Seidel sweeps give a first guess of it. The compliance is then reduced to ``COMPLIANCE`` and its effect
    removed. The caller judges convergence by the residual.
    """
    impulses, _, steps = terms.kernel.solve(COMPLIANCE)
    return impulses, steps


def newton(
    terms: ContactTerms, impulses: Array, lower_bound: Array | float = 0.0, compliance: float = COMPLIANCE
) -> tuple[Array, bool]:
    """The solution that Newton's method reaches from a first guess.

    Args:
        terms: The problem at its m contact points.
        impulses: First guess on the object, ``(m, 3)`` [N s].
        lower_bound: Bound a of the normal impulses, ``(m,)`` [N s].
        compliance: rho [-].

    Returns:
        Impulses ``(m, 3)`` [N s], and whether the iteration converged; if not, they are the first guess.
    """
    return terms.kernel.newton(impulses, lower_bound, compliance)


def harden(
    terms: ContactTerms, impulses: Array, lower_bound: Array | float = 0.0, compliance: float = COMPLIANCE
) -> Array:
    """The solution of :func:`newton` without the velocity that the compliance lets points yield, ``(m, 3)`` [N s].

    Without convergence the given impulses are returned. Arguments as for :func:`newton`.
    """
    return terms.kernel.harden(impulses, lower_bound, compliance)
