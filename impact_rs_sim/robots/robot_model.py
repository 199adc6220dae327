# SPDX-License-Identifier: Apache-2.0
"""Rigid-body terms of one arm, by Pinocchio.

    (M(q) + B) ddq + h(q, dq) = tau_d + tau_fric + J(q)^T f_c          (paper eq. eom)

M, h and J come from here. The Jacobian is geometric, of frame E, written in E[A]: origin at E, axes of the inertial
frame A; rows 0..2 are linear, rows 3..5 angular. Units per joint are those of :data:`impact_rs_sim.robots.robot.UNITS`.

Columns of a tree belong to the components of v (:mod:`impact_rs_sim.robots.robot`); columns of a floating base,
Pinocchio's free flyer, come first. Joints that follow others reduce M and J: with the positions G q + q_0 of all
joints,

    M = G^T M_all G,    J = J_all G,    h = G^T h_all

(Pinocchio has mimic joints too, but version 4.1 returns a wrong M if a joint follows one that carries it.)
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_sim._kernel import Chain
from impact_rs_sim.errors import UnreachablePose
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import BASE_POSE_SIZE, Array, EndEffector, RobotFacts
from impact_rs_sim.robots.urdf import write_urdf

TIP = "end_effector"
GRAVITY_M_S2 = 9.81
STANDARD_GRAVITY = (0.0, 0.0, -GRAVITY_M_S2)  # m/s^2, z up
MAX_QUATERNION_ERROR = 1e-6  # of the norm of the orientation of a floating base, for rounding [-]
MAX_IK_RESTARTS = 30  # of inverse kinematics from random starts, if the guess fails
MAX_IK_NEWTON_STEPS = 30  # of inverse kinematics; from a guess within a radian it takes six to ten
MAX_IK_STEP = 0.5  # of any joint in one Newton step [rad or m]
MAX_IK_RESIDUAL = 1e-9  # of a pose that is reached [m, rad]
NO_HANDS: Mapping[str, EndEffector] = MappingProxyType({})


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
        base: Placement of the arm's base in A; of a floating base only for :meth:`position_of`.
        gravity: Acceleration of gravity in A, ``(3,)`` [m/s^2].
        hands: End effectors of further hands of a tree, by name of the hand in the facts.
    """

    def __init__(
        self,
        facts: RobotFacts,
        end_effector: EndEffector,
        base: pin.SE3 | None = None,
        gravity: Array | tuple[float, float, float] = STANDARD_GRAVITY,
        hands: Mapping[str, EndEffector] = NO_HANDS,
    ) -> None:
        self.facts = facts
        self.end_effector = end_effector
        self.base = pin.SE3.Identity() if base is None else base
        model = _built(facts, end_effector)
        self._frame = model.getFrameId(TIP)
        self._frames = {"": self._frame, **{name: _mount_hand(model, facts, name, hands[name]) for name in hands}}
        if facts.floating_base is None:
            for joint, parent in enumerate(model.parents):
                if joint and not parent:
                    model.jointPlacements[joint] = self.base * model.jointPlacements[joint]
        model.gravity.linear = np.asarray(gravity, dtype=float)
        self.pinocchio = model
        self.data = model.createData()
        self.joint_count = facts.base_size + facts.joint_count
        pose = BASE_POSE_SIZE if facts.base_size else 0
        self._shapes = ((pose + facts.joint_count,), (self.joint_count,), (facts.joint_count,))
        follows = any(joint.mimic is not None for joint in facts.joints)
        self._reduction = facts.reduction if follows else None
        self._zero = np.zeros(model.nv)
        free, limits = np.full(facts.base_size, np.inf), facts.limits
        self.position_min = np.concatenate((-free, limits.position_min_rad))
        self.position_max = np.concatenate((free, limits.position_max_rad))
        self.velocity_max = np.concatenate((free, limits.velocity_rad_s))
        self.torque_max = np.array(limits.torque_Nm)

    @property
    def urdf(self) -> str:
        """The arm on a base at the origin."""
        return write_urdf(self.facts, self.end_effector)

    def position_of(self, joints: Array) -> Array:
        """q of joints ``(n,)``, with a floating base at :attr:`base`."""
        return np.concatenate((pin.SE3ToXYZQUAT(self.base), joints)) if self.facts.base_size else np.array(joints)

    def takes(self, position: Array, velocity: Array, motor_inertia: Array) -> bool:
        """Whether q, v and B have the sizes of this robot, and a floating base a unit quaternion."""
        if (position.shape, velocity.shape, motor_inertia.shape) != self._shapes:
            return False
        length = 1.0 if self.facts.floating_base is None else float(np.linalg.norm(position[3:BASE_POSE_SIZE]))
        return abs(length - 1.0) <= MAX_QUATERNION_ERROR

    @functools.cached_property
    def chain(self) -> Chain:
        """Compiled model of the arm for simulations.

        Raises:
            InputError: The robot is a tree.
        """
        self.facts.check_chain("the simulator", "robot")
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
        """All terms of a chain at joint positions ``q`` ``(n,)`` [rad] and velocities ``dq`` ``(n,)`` [rad/s]."""
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
        return self._reduced(symmetric(pin.crba(self.pinocchio, self.data, self._all_joints(q))))

    def gravity_torque(self, q: Array) -> Array:
        """g(q), ``(n,)`` [N m], a copy."""
        return self._reduced(np.array(pin.computeGeneralizedGravity(self.pinocchio, self.data, self._all_joints(q))))

    def jacobian(self, q: Array, hand: str = "") -> Array:
        """J(q) of frame E of the flange, or of a hand by name, in E[A], ``(6, n)``."""
        model, frame = self.pinocchio, self._frames[hand]
        jacobian = pin.computeFrameJacobian(model, self.data, self._all_joints(q), frame, pin.LOCAL_WORLD_ALIGNED)
        return self._of_independent_joints(np.array(jacobian))

    def placement(self, q: Array, hand: str = "") -> pin.SE3:
        """Placement of frame E of the flange, or of a hand by name, in A."""
        pin.framesForwardKinematics(self.pinocchio, self.data, self._all_joints(q))
        return self.data.oMf[self._frames[hand]].copy()

    def at_impact(self, q: Array, hand: str = "") -> tuple[Array, Array, pin.SE3]:
        """Terms of an impact at q, from one pass over the chain; E is on the flange, or on a hand by name.

        Returns:
            M(q), with a valid upper triangle only, ``(n, n)`` [kg m^2]; J(q) of frame E in E[A], ``(6, n)``; and the
            placement of E in A. The next call overwrites M and the placement.
        """
        model, data, frame = self.pinocchio, self.data, self._frames[hand]
        pin.crba(
            model, data, self._all_joints(q), pin.Convention.WORLD
        )  # leaves placements and Jacobian of the joints behind
        placement = pin.updateFramePlacement(model, data, frame)
        jacobian = self._of_independent_joints(pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED))
        return data.M if self._reduction is None else self._reduced(symmetric(data.M)), jacobian, placement

    def _all_joints(self, q: Array) -> Array:
        """Configuration of all joints, including those that follow others."""
        if self._reduction is None:
            return q
        matrix, offset = self._reduction
        joints = matrix @ self.facts.columns_of(self.facts.joints_of(q)) + offset
        return np.concatenate((q[: q.size - self.facts.joint_count], joints[self.facts.base_size :]))

    def _reduced(self, of_all: Array) -> Array:
        """G^T X G of a matrix of all joints, G^T x of a vector."""
        if self._reduction is None:
            return of_all
        matrix = self._reduction[0]
        return np.asarray(matrix.T @ of_all if of_all.ndim == 1 else matrix.T @ of_all @ matrix)

    def _of_independent_joints(self, jacobian: Array) -> Array:
        """J G of a Jacobian of all joints; Pinocchio returns a vector for a single joint."""
        all_columns = jacobian.reshape(6, self.pinocchio.nv)
        return all_columns if self._reduction is None else np.asarray(all_columns @ self._reduction[0])

    def link_placements(self, q: Array) -> dict[str, pin.SE3]:
        """Placement in A of every link, by its name in the URDF."""
        pin.framesForwardKinematics(self.pinocchio, self.data, self._all_joints(q))
        frames = {
            frame.name: self.data.oMf[index].copy()
            for index, frame in enumerate(self.pinocchio.frames)
            if frame.type == pin.FrameType.BODY and frame.name != "universe"
        }
        return frames if self.facts.base_size else {**frames, "base": self.base}

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        """M ddq + h, ``(n,)`` [N m], a copy."""
        if self._reduction is not None:
            dq, ddq = (self._reduction[0] @ rate for rate in (dq, ddq))
        return self._reduced(np.array(pin.rnea(self.pinocchio, self.data, self._all_joints(q), dq, ddq)))

    def inverse_kinematics(
        self,
        target: pin.SE3,
        posture: Mapping[int, float],
        guess: Array,
        further_starts: int = MAX_IK_RESTARTS,
        hands: Mapping[str, pin.SE3] = MappingProxyType({}),
    ) -> Array:
        """Joint positions that reach ``target`` with frame E, with some joints at given positions.

        Newton's method for six free joints and one pad; bounded least squares for another number of joints, for several
        hands, or if Newton's method does not converge within the limits. If the guess fails, random starts are tried,
        and the solution nearest to the guess is returned.

        Args:
            target: Wanted placement of E in A.
            posture: Positions of the joints of the posture task, which resolve the redundancy, by number from 0 [rad]
                (paper sec. Reference generation).
            guess: Start, ``(n,)`` [rad].
            further_starts: Number of random starts if the guess fails.
            hands: Wanted placements of further hands at the same time, by name.

        Raises:
            UnreachablePose: The pose cannot be reached within the joint limits.
        """
        lower, upper = self.position_min, self.position_max
        for joint, position in posture.items():
            if not lower[joint] <= position <= upper[joint]:
                unit = self.facts.units[joint].position
                raise UnreachablePose(
                    f"joint {joint + 1} at {position:.4g} {unit} is outside its limits "
                    f"[{lower[joint]:.4g}, {upper[joint]:.4g}] {unit}"
                )
        free = np.array([joint for joint in range(self.joint_count) if joint not in posture], dtype=int)
        q = np.array(guess, dtype=float)
        q[list(posture)] = list(posture.values())

        if free.size == 6 and not hands and (solution := self._newton(target, q.copy(), free)) is not None:
            return solution
        start = np.clip(q, lower + 1e-6, upper - 1e-6)[free]
        bounds = (lower[free], upper[free])

        def error(angles: Array) -> Array:
            q[free] = angles
            hand_errors = (_pose_error(hand_target, self.placement(q, hand)) for hand, hand_target in hands.items())
            return np.concatenate((_pose_error(target, self.placement(q)), *hand_errors))

        best = _least_squares(error, start, bounds)
        if np.max(np.abs(best.fun)) > MAX_IK_RESIDUAL:
            rng = np.random.default_rng(0)
            restarts = [_least_squares(error, rng.uniform(*bounds), bounds) for _ in range(further_starts)]
            successes = [solution for solution in restarts if np.max(np.abs(solution.fun)) <= MAX_IK_RESIDUAL]
            best = min(successes, key=lambda solution: float(np.linalg.norm(solution.x - start)), default=None) or min(
                [best, *restarts], key=lambda solution: float(solution.cost)
            )
        if np.max(np.abs(best.fun)) > MAX_IK_RESIDUAL:
            units = self.facts.units
            posture_text = "".join(
                f", joint {joint + 1} at {position:.4g} {units[joint].position}" for joint, position in posture.items()
            )
            positions = [np.round(placement.translation, 4).tolist() for placement in (target, *hands.values())]
            distance, rotation = np.linalg.norm(best.fun.reshape(-1, 2, 3), axis=2).max(axis=0)
            raise UnreachablePose(
                f"E cannot be at {' and '.join(map(str, positions))} m{posture_text}: the nearest pose is "
                f"{distance:.3g} m and {rotation:.3g} rad off"
            )
        q[free] = best.x
        return q

    def _newton(self, target: pin.SE3, q: Array, free: Array) -> Array | None:
        """Joint positions that reach ``target`` up to rounding by six joints; None: not converged or outside limits."""
        smallest = np.inf
        for _ in range(MAX_IK_NEWTON_STEPS):
            placement = self.placement(q)
            error = _pose_error(target, placement)
            size = float(np.abs(error).max())
            if size < 1e-12 or (size < 1e-10 and size >= smallest):
                return q if np.all((self.position_min <= q) & (q <= self.position_max)) else None
            smallest = min(smallest, size)
            jacobian = self.jacobian(q)[:, free]
            jacobian[3:] = placement.rotation.T @ jacobian[3:]
            try:
                step = np.linalg.solve(jacobian, error)
            except np.linalg.LinAlgError:
                return None
            q[free] += step * min(1.0, MAX_IK_STEP / float(np.abs(step).max()))
        return None

    def inertia(self, q: Array, motor_inertia: Array) -> Array:
        """M(q) + B with the diagonal ``(n,)`` of B, ``(nv, nv)`` [kg m^2]."""
        return self.mass_matrix(q) + np.diag(self.facts.columns_of(motor_inertia))

    def mobility(self, q: Array, direction: Array, motor_inertia: Array) -> float:
        """Velocity of E along ``direction`` per impulse on E: ``n^T J (M + B)^-1 J^T n`` [1/kg].

        Args:
            q: Joint positions, ``(n,)`` [rad].
            direction: Unit vector n in A, ``(3,)``.
            motor_inertia: Diagonal of B, ``(n,)`` [kg m^2].
        """
        row = np.asarray(direction) @ self.jacobian(q)[:3]
        return float(row @ np.linalg.solve(self.inertia(q, motor_inertia), row))

    def effective_mass(self, q: Array, direction: Array, motor_inertia: Array) -> float:
        """Effective mass along ``direction`` at E, the inverse of :meth:`mobility` [kg]; arguments as there."""
        return 1.0 / self.mobility(q, direction, motor_inertia)


def symmetric(upper: Array) -> Array:
    """Symmetric matrices from their upper triangles, which Pinocchio computes, ``(..., n, n)``; copies."""
    return np.where(np.tri(upper.shape[-1], dtype=bool), upper.swapaxes(-1, -2), upper)


def mounted_inertia(facts: RobotFacts, end_effector: EndEffector) -> pin.Inertia:
    """Inertia of the link with the flange and its end effector, in frame E."""
    model, carrier = _skeleton(facts, end_effector), facts.flange_link
    link = facts.links[carrier - 1] if carrier else facts.floating_base
    assert link is not None  # a flange on a base that is fixed is refused
    tip = model.frames[model.getFrameId(TIP)].placement
    bare = _inertia(link.mass, np.array(link.com), link.inertia_matrix)
    return tip.actInv(bare) + _inertia(end_effector.mass, end_effector.com, end_effector.inertia)


def _built(facts: RobotFacts, end_effector: EndEffector) -> pin.Model:
    """The arm on a base at the origin."""
    model = _skeleton(facts, end_effector).copy()
    bodies = facts.links if facts.floating_base is None else (facts.floating_base, *facts.links)
    for index, link in enumerate(bodies, start=1):
        model.inertias[index] = _inertia(link.mass, np.array(link.com), link.inertia_matrix)
    tip = model.frames[model.getFrameId(TIP)]
    mounted = _inertia(end_effector.mass, end_effector.com, end_effector.inertia)
    model.inertias[tip.parentJoint] += tip.placement.act(mounted)
    return model


def _mount_hand(model: pin.Model, facts: RobotFacts, name: str, tool: EndEffector) -> int:
    """Add the end effector of a further hand to its link; returns the number of its frame E."""
    (hand,) = [candidate for candidate in facts.hands if candidate.name == name]
    carrier = model.njoints - 1 - len(facts.joints) + facts.link_of(hand)
    placement = hand.placement * tool.mount
    model.inertias[carrier] += placement.act(_inertia(tool.mass, tool.com, tool.inertia))
    frame = pin.Frame(f"hand {name}", carrier, 0, placement, pin.FrameType.OP_FRAME)
    return int(model.addFrame(frame, False))


def _skeleton(facts: RobotFacts, end_effector: EndEffector) -> pin.Model:
    """Kinematic model of an arm on a base at the origin, cached by geometry; its inertias are placeholders.

    A search changes the masses of few arms thousands of times, so only the inertias are replaced. The cache key is the
    identity of the objects: hashing all numbers would take longer than building the model.
    """
    parts = facts.joints, facts.flange, facts.limits
    mount = (*end_effector.mount_numbers, facts.base_size)
    cached_parts, skeleton = _SKELETONS.of(
        (*map(id, parts), *mount),
        lambda: (
            parts,
            pin.buildModelFromXML(write_urdf(facts, end_effector)) if facts.is_chain else _tree(facts, end_effector),
        ),
    )
    del cached_parts  # the cache keeps them alive, so that no other objects get their ids
    return skeleton


def _tree(facts: RobotFacts, end_effector: EndEffector) -> pin.Model:
    """Kinematic model of a tree on a base at the origin, joints in the order of the facts."""
    model = pin.Model()
    if facts.floating_base is not None:
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    first = model.njoints - 1  # Pinocchio's number of the base
    model.addBodyFrame("base", first, pin.SE3.Identity(), 0)
    for number, (origin, parent) in enumerate(zip(facts.joints, facts.parents, strict=True), start=1):
        kind = pin.JointModelPZ() if origin.type == "prismatic" else pin.JointModelRZ()
        placement = pin.SE3(pin.rpy.rpyToMatrix(*origin.rpy), np.array(origin.xyz))
        joint = model.addJoint(first + parent, kind, placement, f"joint{number}")
        model.addBodyFrame(f"link{number}", joint, pin.SE3.Identity(), 0)
    flange = pin.SE3(facts.flange.rotation, np.array(facts.flange.xyz))
    tip = pin.Frame(TIP, first + facts.flange_link, 0, flange * end_effector.mount, pin.FrameType.BODY)
    model.addFrame(tip, False)
    return model


def _inertia(mass: float, com: Array, inertia: Array) -> pin.Inertia:
    """Inertia without Pinocchio's check, because a removed payload has a negative mass."""
    result = pin.Inertia.Zero()
    result.mass, result.lever, result.inertia = mass, com, inertia
    return result


def _pose_error(target: pin.SE3, placement: pin.SE3) -> Array:
    """Pose error, ``(6,)``: translation in A [m], then the rotation vector in its own axes [rad]."""
    return np.concatenate(
        (target.translation - placement.translation, pin.log3(placement.rotation.T @ target.rotation))
    )


def _least_squares(
    error: Callable[[Array], Array], start: Array, bounds: tuple[Array, Array]
) -> scipy.optimize.OptimizeResult:
    return scipy.optimize.least_squares(error, start, bounds=bounds, xtol=1e-15, ftol=1e-15, gtol=1e-15)
