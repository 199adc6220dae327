# SPDX-License-Identifier: Apache-2.0
"""Rigid-body terms of one arm, by Pinocchio.

    (M(q) + B) ddq + h(q, dq) = tau_d + tau_fric + J(q)^T f_c          (paper eq. eom)

M, h and J come from here. The Jacobian is geometric, of frame E, written in E[A]: origin at E, axes of the inertial
frame A; rows 0..2 are linear, rows 3..5 angular. Units per joint are those of :data:`impact_rs_sim.robots.robot.UNITS`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_sim._kernel import Chain
from impact_rs_sim.errors import UnreachablePose
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts
from impact_rs_sim.robots.urdf import write_urdf

TIP = "end_effector"
GRAVITY_M_S2 = 9.81
STANDARD_GRAVITY = (0.0, 0.0, -GRAVITY_M_S2)  # m/s^2, z up
MAX_IK_RESTARTS = 30  # of inverse kinematics, where the guess leads nowhere
MAX_IK_NEWTON_STEPS = 30  # of inverse kinematics; from a guess within a radian it takes six to ten
MAX_IK_STEP = 0.5  # of any joint in one Newton step [rad or m]


_SKELETONS: Recent[tuple[object, pin.Model]] = Recent(64)


@dataclass
class RigidTerms:
    """Terms of the equations of motion at one state; arrays are reused by the next call.

    Attributes:
        mass_matrix: M, ``(n, n)`` [kg m^2].
        bias: h = C dq + g, ``(n,)`` [N m].
        jacobian: J, ``(6, n)``.
        drift: dJ/dt dq, ``(6,)`` [m/s^2, rad/s^2].
        position: Origin of E in A, ``(3,)`` [m].
        rotation: Axes of E in A, ``(3, 3)``.
        twist: J dq, ``(6,)`` [m/s, rad/s].
    """

    mass_matrix: Array
    bias: Array
    jacobian: Array
    drift: Array
    position: Array
    rotation: Array
    twist: Array


class RobotModel:
    """One arm with its end effector, mounted in the inertial frame A.

    Args:
        facts: Kinematics, inertials and limits.
        end_effector: Mass, inertia and pad.
        base: Placement of the arm's base in A.
        gravity: Acceleration of gravity in A, ``(3,)`` [m/s^2].
    """

    def __init__(
        self,
        facts: RobotFacts,
        end_effector: EndEffector,
        base: pin.SE3 | None = None,
        gravity: Array | tuple[float, float, float] = STANDARD_GRAVITY,
    ) -> None:
        self.facts = facts
        self.end_effector = end_effector
        self.base = pin.SE3.Identity() if base is None else base
        model = _built(facts, end_effector)
        model.jointPlacements[1] = self.base * model.jointPlacements[1]
        model.gravity.linear = np.asarray(gravity, dtype=float)
        self.pinocchio = model
        self.data = model.createData()
        self.joint_count = model.nq
        self._frame = model.getFrameId(TIP)
        self._zero = np.zeros(model.nv)
        self.position_min = np.array(facts.limits.position_min_rad)
        self.position_max = np.array(facts.limits.position_max_rad)
        self.velocity_max = np.array(facts.limits.velocity_rad_s)
        self.torque_max = np.array(facts.limits.torque_Nm)

    @property
    def urdf(self) -> str:
        """The arm on a base at the origin."""
        return write_urdf(self.facts, self.end_effector)

    @functools.cached_property
    def chain(self) -> Chain:
        """Compiled model of the arm for simulations."""
        model, tip = self.pinocchio, self.pinocchio.frames[self._frame].placement
        inertias = list(model.inertias)[1:]
        return Chain(
            np.array([placement.rotation for placement in list(model.jointPlacements)[1:]]),
            np.array([placement.translation for placement in list(model.jointPlacements)[1:]]),
            [kind == "prismatic" for kind in self.facts.joint_types],
            np.array([inertia.mass for inertia in inertias]),
            np.array([inertia.lever for inertia in inertias]),
            np.array([inertia.inertia for inertia in inertias]),
            model.gravity.linear,
            tip.translation,
        )

    def terms(self, q: Array, dq: Array) -> RigidTerms:
        """All terms at joint positions ``q`` ``(n,)`` [rad] and velocities ``dq`` ``(n,)`` [rad/s]."""
        model, data, frame = self.pinocchio, self.data, self._frame
        pin.computeAllTerms(model, data, q, dq)
        jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, self.joint_count)
        pin.forwardKinematics(model, data, q, dq, self._zero)
        placement = pin.updateFramePlacement(model, data, frame)
        drift = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        return RigidTerms(
            mass_matrix=data.M,
            bias=data.nle,
            jacobian=jacobian,
            drift=drift.vector,
            position=placement.translation,
            rotation=placement.rotation,
            twist=jacobian @ dq,
        )

    def mass_matrix(self, q: Array) -> Array:
        """M(q), ``(n, n)`` [kg m^2], a copy."""
        return symmetric(pin.crba(self.pinocchio, self.data, q))

    def gravity_torque(self, q: Array) -> Array:
        """g(q), ``(n,)`` [N m], a copy."""
        return np.array(pin.computeGeneralizedGravity(self.pinocchio, self.data, q))

    def jacobian(self, q: Array) -> Array:
        """J(q) of frame E in E[A], ``(6, n)``."""
        jacobian = pin.computeFrameJacobian(self.pinocchio, self.data, q, self._frame, pin.LOCAL_WORLD_ALIGNED)
        return np.array(jacobian).reshape(6, self.joint_count)  # of one joint Pinocchio makes a vector

    def placement(self, q: Array) -> pin.SE3:
        """Placement of frame E in A."""
        pin.framesForwardKinematics(self.pinocchio, self.data, q)
        return self.data.oMf[self._frame].copy()

    def at_impact(self, q: Array) -> tuple[Array, Array, pin.SE3]:
        """Terms of an impact at q, from one pass over the chain.

        Returns:
            M(q), of which only the upper triangle counts, ``(n, n)`` [kg m^2]; J(q) of frame E in E[A], ``(6, n)``; and
            the placement of E in A. M and the placement are overwritten by the next call.
        """
        model, data = self.pinocchio, self.data
        pin.crba(model, data, q, pin.Convention.WORLD)  # leaves placements and Jacobian of the joints behind
        placement = pin.updateFramePlacement(model, data, self._frame)
        jacobian = pin.getFrameJacobian(model, data, self._frame, pin.LOCAL_WORLD_ALIGNED)
        return data.M, jacobian.reshape(6, self.joint_count), placement

    def link_placements(self, q: Array) -> dict[str, pin.SE3]:
        """Placement in A of every link, by its name in the URDF."""
        pin.framesForwardKinematics(self.pinocchio, self.data, q)
        frames = {
            frame.name: self.data.oMf[index].copy()
            for index, frame in enumerate(self.pinocchio.frames)
            if frame.type == pin.FrameType.BODY and frame.name != "universe"
        }
        return {**frames, "base": self.base}

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        """M ddq + h, ``(n,)`` [N m], a copy."""
        return np.array(pin.rnea(self.pinocchio, self.data, q, dq, ddq))

    def inverse_kinematics(
        self,
        target: pin.SE3,
        held: Mapping[int, float],
        guess: Array,
        tolerance: float = 1e-9,
        further_starts: int = MAX_IK_RESTARTS,
    ) -> Array:
        """Joint positions that reach ``target`` with frame E while some joints are held.

        Newton's method for six free joints; outside the limits, without convergence, or for another number of joints,
        bounded least squares. If the guess fails, other starts are tried, and the solution nearest to the guess is
        returned.

        Args:
            target: Wanted placement of E in A.
            held: Positions of the joints of the posture task, which resolve the redundancy, by number from 0 [rad]
                (paper sec. Reference generation).
            guess: Where to start, ``(n,)`` [rad].
            tolerance: Largest accepted residual [m, rad].
            further_starts: Number of other starts if the guess fails.

        Raises:
            UnreachablePose: The pose cannot be reached within the joint limits.
        """
        lower, upper = self.position_min, self.position_max
        for joint, position in held.items():
            if not lower[joint] <= position <= upper[joint]:
                unit = self.facts.units[joint].position
                raise UnreachablePose(
                    f"joint {joint + 1} at {position:.4g} {unit} is outside its limits "
                    f"[{lower[joint]:.4g}, {upper[joint]:.4g}] {unit}"
                )
        free = np.array([joint for joint in range(self.joint_count) if joint not in held], dtype=int)
        q = np.array(guess, dtype=float)
        q[list(held)] = list(held.values())

        if free.size == 6 and (found := self._newton(target, q.copy(), free)) is not None:
            return found
        inside = np.clip(q, lower + 1e-6, upper - 1e-6)[free]
        bounds = (lower[free], upper[free])

        def error(angles: Array) -> Array:
            q[free] = angles
            return _pose_error(target, self.placement(q))

        best = _least(error, inside, bounds)
        if np.max(np.abs(best.fun)) > tolerance:
            rng = np.random.default_rng(0)
            others = [_least(error, rng.uniform(*bounds), bounds) for _ in range(further_starts)]
            reached = [found for found in others if np.max(np.abs(found.fun)) <= tolerance]
            best = min(reached, key=lambda found: float(np.linalg.norm(found.x - inside)), default=None) or min(
                [best, *others], key=lambda found: float(found.cost)
            )
        if np.max(np.abs(best.fun)) > tolerance:
            units = self.facts.units
            held_at = "".join(f", joint {joint + 1} at {at:.4g} {units[joint].position}" for joint, at in held.items())
            raise UnreachablePose(
                f"E cannot be at {np.round(target.translation, 4).tolist()} m{held_at}: the nearest pose is "
                f"{np.linalg.norm(best.fun[:3]):.3g} m and {np.linalg.norm(best.fun[3:]):.3g} rad off"
            )
        q[free] = best.x
        return q

    def _newton(self, target: pin.SE3, q: Array, free: Array) -> Array | None:
        """Joint positions that reach ``target`` up to rounding by six joints; None: not converged or outside limits."""
        least = np.inf
        for _ in range(MAX_IK_NEWTON_STEPS):
            placement = self.placement(q)
            error = _pose_error(target, placement)
            size = float(np.abs(error).max())
            if size < 1e-12 or (size < 1e-10 and size >= least):
                return q if np.all((self.position_min <= q) & (q <= self.position_max)) else None
            least = min(least, size)
            jacobian = self.jacobian(q)[:, free]
            jacobian[3:] = placement.rotation.T @ jacobian[3:]
            try:
                step = np.linalg.solve(jacobian, error)
            except np.linalg.LinAlgError:
                return None
            q[free] += step * min(1.0, MAX_IK_STEP / float(np.abs(step).max()))
        return None

    def mobility(self, q: Array, direction: Array, motor_inertia: Array) -> float:
        """Velocity of E along ``direction`` per impulse there: ``n^T J (M + B)^-1 J^T n`` [1/kg].

        Args:
            q: Joint positions, ``(n,)`` [rad].
            direction: Unit vector n in A, ``(3,)``.
            motor_inertia: Diagonal of B, ``(n,)`` [kg m^2].
        """
        row = np.asarray(direction) @ self.jacobian(q)[:3]
        inertia = self.mass_matrix(q) + np.diag(motor_inertia)
        return float(row @ np.linalg.solve(inertia, row))

    def effective_mass(self, q: Array, direction: Array, motor_inertia: Array) -> float:
        """Effective mass along ``direction`` at E, the inverse of :meth:`mobility` [kg]; arguments as there."""
        return 1.0 / self.mobility(q, direction, motor_inertia)


def symmetric(upper: Array) -> Array:
    """Symmetric matrices with given upper triangles, which are all that Pinocchio computes, ``(..., n, n)``; copies."""
    return np.where(np.tri(upper.shape[-1], dtype=bool), upper.swapaxes(-1, -2), upper)


def mounted_inertia(facts: RobotFacts, end_effector: EndEffector) -> pin.Inertia:
    """Inertia of the last link with its end effector, in frame E."""
    model, link = _skeleton(facts, end_effector), facts.links[-1]
    tip = model.frames[model.getFrameId(TIP)].placement
    bare = _inertia(link.mass, np.array(link.com), link.inertia_matrix)
    return tip.actInv(bare) + _inertia(end_effector.mass, end_effector.com, end_effector.inertia)


def _built(facts: RobotFacts, end_effector: EndEffector) -> pin.Model:
    """The arm on a base at the origin."""
    model = _skeleton(facts, end_effector).copy()
    for index, link in enumerate(facts.links, start=1):
        model.inertias[index] = _inertia(link.mass, np.array(link.com), link.inertia_matrix)
    mounted = _inertia(end_effector.mass, end_effector.com, end_effector.inertia)
    model.inertias[model.njoints - 1] += model.frames[model.getFrameId(TIP)].placement.act(mounted)
    return model


def _skeleton(facts: RobotFacts, end_effector: EndEffector) -> pin.Model:
    """Cached kinematic model of an arm of the same geometry on a base at the origin; its inertias are placeholders.

    A search changes the masses of few arms thousands of times, so only the inertias are set anew. The cache key is the
    identity of the objects: hashing all numbers would take longer than building the model.
    """
    parts = facts.joints, facts.flange, facts.limits
    place = end_effector.mount_numbers
    kept, skeleton = _SKELETONS.of(
        (*map(id, parts), *place), lambda: (parts, pin.buildModelFromXML(write_urdf(facts, end_effector)))
    )
    del kept  # as long as it is known, no other object has its identity
    return skeleton


def _inertia(mass: float, com: Array, inertia: Array) -> pin.Inertia:
    """Inertia without Pinocchio's check: a removed payload is a body with negative mass."""
    found = pin.Inertia.Zero()
    found.mass, found.lever, found.inertia = mass, com, inertia
    return found


def _pose_error(target: pin.SE3, placement: pin.SE3) -> Array:
    """Pose error, ``(6,)``: translation in A [m], then the rotation vector in its own axes [rad]."""
    return np.concatenate(
        (target.translation - placement.translation, pin.log3(placement.rotation.T @ target.rotation))
    )


def _least(error: Callable[[Array], Array], start: Array, bounds: tuple[Array, Array]) -> scipy.optimize.OptimizeResult:
    return scipy.optimize.least_squares(error, start, bounds=bounds, xtol=1e-15, ftol=1e-15, gtol=1e-15)
