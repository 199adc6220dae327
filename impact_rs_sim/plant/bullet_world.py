# SPDX-License-Identifier: Apache-2.0
"""One Bullet world: arms, object and support, with explicit values for every setting that affects the result.

Shared by the plant (many small steps with compliant pads) and the ``bullet`` impact map (single rigid steps). How
Bullet combines the parameters of two bodies:

* It multiplies friction coefficients. So the object has 1, and its partner the coefficient of the pair. Several objects
  have the root of the coefficient between objects, and a partner the coefficient of the pair over this root.
* It adds rolling frictions, each times the friction coefficient of the other body. So only the partner has the lever of
  the pair.
* It adds compliances.

Its friction cone weights two fixed axes with the inverse mass along them, so that the friction of a sliding box has the
magnitude of Coulomb's law but not the direction: it opposes ``D^-1 v_t`` instead of the sliding velocity ``v_t``, an
error of at most 13 degrees for the boxes of the paper. A world with small steps corrects the direction: at every corner
that slid in the previous step, an external force replaces Bullet's friction by ``-mu N v_t / |v_t|``.

An object on a hinge or slide is the only link of a multibody, on a fixed base at its pose. The state is the joint
coordinate (Featherstone, Rigid Body Dynamics Algorithms, ch. 7), so that it does not drift from its hinge.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.effects.formula import MIN_SLIDING_SPEED_M_S
from impact_rs_sim.errors import NotABody
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.plant.pad_shear import ContactBody, PadContacts, PadShear
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts
from impact_rs_sim.robots.urdf import joint_names, write_urdf
from impact_rs_sim.rotations import continuous, quaternion_of
from impact_rs_sim.scene import ArmState, BodyState, standing
from impact_rs_sim.shapes import ConvexShape


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress Bullet's banners on the C-level standard output and error."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved, null = (os.dup(1), os.dup(2)), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        os.dup2(null, 2)
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # the C library buffers the banner if the output is no terminal
        for stream, original in enumerate(saved, start=1):
            os.dup2(original, stream)
            os.close(original)
        os.close(null)


with _quiet():
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

FACE_CONTACT_POINTS = 4  # Bullet keeps four points of a face contact; each gets a quarter of the face's stiffness
SUPPORT_DAMPING_RATIO = 0.5  # of the object on a compliant support
MAX_BULLET_STEPS = 8  # Bullet steps per step of a world
GUIDED_LINK = 0  # link of the multibody of an object on a hinge or slide
# An empty interval switches Bullet's joint stops off.
FREE_JOINT = {"jointDamping": 0.0, "maxJointVelocity": 1e3, "jointLowerLimit": 1.0, "jointUpperLimit": -1.0}
MARGIN_M = 1e-4  # radius at the rims of a cylinder and around a hull


class BulletWorld:
    """Arms, object and support in a separate Bullet world; :meth:`load` makes one.

    Args:
        physics: Parameters of the scene.
        client: Connection to the world.
        arms: Body of every arm in Bullet, by name.
        object_: Body of the object.
        neighbours: Bodies of its neighbours.
        support: Body of the support; None: no support.
        shears: Shear models of pads, by arm.
        small_steps: Whether the direction of the support's friction is corrected, one step late.
        substeps: Steps of Bullet per step of this world.
    """

    def __init__(
        self,
        physics: Physics,
        client: BulletClient,
        arms: dict[str, int],
        object_: int,
        neighbours: tuple[int, ...],
        support: int | None,
        shears: dict[str, PadShear],
        small_steps: bool,
        substeps: int,
    ) -> None:
        self.physics = physics
        self.client = client
        self._open = True
        self.arms = arms
        counts = {name: arm.facts.joint_count for name, arm in physics.arms.items()}
        self.joints = {name: list(range(count)) for name, count in counts.items()}
        self.end_effector_link = counts
        self.object = object_
        self.objects = (object_, *neighbours)
        self.support = support
        self._object_friction = _object_friction(physics)
        self._shears = shears
        self._substeps = substeps
        self._torques: dict[str, list[float]] = {}
        self._pushes: list[tuple[str | None, Array, Array, Array]] = []
        self._support_friction = physics.support_friction
        self._corrects_friction = small_steps and support is not None and physics.support_friction > 0.0
        self._models = {name: physics.robot_model(name) for name in shears}
        self._com_is_offset = bool(np.any(physics.object.com_offset))
        guided = physics.object.guide is not None
        self._object_link = GUIDED_LINK if guided else -1
        # Bound once: the attribute look-up of the wrapper costs more than some of the calls in the inner loop.
        self._step = client.stepSimulation
        self._get_joints = client.getJointStates
        self._set_torques = client.setJointMotorControlArray
        self._get_pose = self._guided_pose if guided else client.getBasePositionAndOrientation
        self._get_velocity = self._guided_velocity if guided else client.getBaseVelocity
        self._get_contacts = client.getContactPoints
        self._push = client.applyExternalForce

    @classmethod
    def load(
        cls,
        physics: Physics,
        *,
        time_step: float,
        gravity: bool,
        compliant_pads: bool,
        iterations: int,
        residual_threshold: float,
        contact_erp: float = 0.2,
        small_steps: bool = True,
    ) -> BulletWorld:
        """Load arms, object and support into a new world.

        Args:
            physics: Parameters of the scene.
            time_step: Step [s]; Bullet takes several substeps if a pad has little damping (:func:`_substeps`).
            gravity: Whether gravity acts.
            compliant_pads: Whether contacts have stiffness and damping of pads and support, shear of pads and
                resistance to rolling, or are rigid.
            iterations: Largest number of solver iterations in a step.
            residual_threshold: The solver stops when the largest squared change of a row is below this.
            contact_erp: Share of a penetration that a rigid contact removes in one step.
            small_steps: Whether small steps follow each other; each then corrects the friction of the previous one.

        Raises:
            NotABody: Mass and inertia of an end effector are physically inconsistent; Bullet would continue with zero
                inertia.
        """
        for name, arm in physics.arms.items():
            check_body(name, arm.end_effector)
        substeps = _substeps(physics, time_step) if compliant_pads else 1
        step = time_step / substeps
        client = _connected()
        client.setPhysicsEngineParameter(
            fixedTimeStep=step,
            numSubSteps=0,
            numSolverIterations=iterations,
            solverResidualThreshold=residual_threshold,
            useSplitImpulse=0,
            contactERP=contact_erp,
            erp=contact_erp,
            frictionERP=0.0,
            globalCFM=0.0,
            contactSlop=0.0,
            restitutionVelocityThreshold=0.0,
            enableConeFriction=1,
            deterministicOverlappingPairs=1,
            constraintSolverType=pybullet.CONSTRAINT_SOLVER_LCP_SI,
        )
        client.setGravity(*(physics.gravity if gravity else np.zeros(3)))
        arms = {name: _load_arm(client, physics, name, compliant_pads, step) for name in physics.arms}
        friction = _object_friction(physics)
        object_ = _make_object(client, physics.object, friction)
        neighbours = tuple(_make_object(client, neighbour.body, friction) for neighbour in physics.neighbours)
        support = _make_support(client, physics, arms, compliant_pads, step)
        shears = _shears(physics, step) if compliant_pads else {}
        for name in shears:
            client.changeDynamics(arms[name], physics.arms[name].facts.joint_count, lateralFriction=0.0)
        return cls(physics, client, arms, object_, neighbours, support, shears, small_steps, substeps)

    def close(self) -> None:
        """Release the connection."""
        if self._open:
            self._open = False
            _give_back(self.client)

    def set_arm(self, name: str, state: ArmState) -> None:
        """Set the joint state of an arm."""
        body = self.arms[name]
        for joint, q, dq in zip(self.joints[name], state.position, state.velocity, strict=True):
            self.client.resetJointState(body, joint, float(q), float(dq))

    def set_object(self, state: BodyState) -> None:
        """Set the state of the object at its geometric centre; its neighbours stand beside it at rest."""
        bodies = (self.physics.object, *(neighbour.body for neighbour in self.physics.neighbours))
        for number, body, body_state in zip(self.objects, bodies, (state, *standing(self.physics, state)), strict=True):
            if body.guide is not None:
                self.client.resetBasePositionAndOrientation(
                    number, body_state.position.tolist(), _quaternion(body_state.rotation)
                )
                self.client.resetJointState(
                    number, GUIDED_LINK, 0.0, body.guided_speed(body_state.rotation, body_state.twist)
                )
                continue
            offset = body_state.rotation @ body.com_offset
            velocity = body_state.twist[:3] + np.cross(body_state.twist[3:], offset)
            self.client.resetBasePositionAndOrientation(
                number, (body_state.position + offset).tolist(), _quaternion(body_state.rotation)
            )
            self.client.resetBaseVelocity(number, velocity.tolist(), body_state.twist[3:].tolist())
        for shear in self._shears.values():
            shear.release()

    def rest_object(self) -> None:
        """Put the objects to sleep until a body comes near; simulating an object at rest costs as much as an arm.

        Bullet wakes an object when its bounding box overlaps that of a moving body, before any contact.
        """
        for state in (pybullet.ACTIVATION_STATE_ENABLE_SLEEPING, pybullet.ACTIVATION_STATE_SLEEP):
            for body in self.objects:
                self.client.changeDynamics(body, -1, activationState=state)

    def _guided_pose(self, body: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Centre of mass and orientation on a hinge or slide, in the form of ``getBasePositionAndOrientation``."""
        state = self.client.getLinkState(body, GUIDED_LINK, computeForwardKinematics=1)
        return state[0], state[1]

    def _guided_velocity(self, body: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Velocity of its centre of mass and angular velocity, in the form of ``getBaseVelocity``."""
        state = self.client.getLinkState(body, GUIDED_LINK, computeLinkVelocity=1, computeForwardKinematics=1)
        return state[6], state[7]

    def joint_motion(self, name: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Joint positions [rad] and velocities [rad/s] of an arm, as returned by Bullet."""
        position, velocity, *_ = zip(*self._get_joints(self.arms[name], self.joints[name]), strict=True)
        return position, velocity

    def arm_state(self, name: str) -> ArmState:
        """Joint positions and velocities of an arm."""
        position, velocity = self.joint_motion(name)
        return ArmState(np.array(position), np.array(velocity))

    def object_pose(self) -> tuple[float, ...]:
        """Centre of mass [m] and quaternion x y z w of the object in A, as returned by Bullet: seven numbers."""
        position, quaternion = self._get_pose(self.object)
        return position + quaternion

    def tracked(self, poses: Array) -> Array:
        """Trajectory of the object as a tracker measures it: geometric centre instead of centre of mass.

        Args:
            poses: Rows of :meth:`object_pose`, ``(k, 7)``.

        Returns:
            Its geometric centre [m] and orientation x y z w, without changes of sign between rows, ``(k, 7)``.
        """
        poses = np.column_stack((poses[:, :3], continuous(poses[:, 3:])))
        if not self._com_is_offset:
            return poses
        axis, w, offset = poses[:, 3:6], poses[:, 6:], self.physics.object.com_offset
        turned = np.cross(axis, offset)
        poses[:, :3] -= offset + 2.0 * (w * turned + np.cross(axis, turned))
        return poses

    def object_state(self, number: int = 0) -> BodyState:
        """State of the object at its geometric centre, or of one of its neighbours, counted from 1."""
        position, quaternion = self._get_pose(self.objects[number])
        linear, angular = self._get_velocity(self.objects[number])
        rotation = pin.Quaternion(np.array(quaternion)).matrix()
        centre, twist = np.array(position), np.array(linear + angular)
        body = self.physics.neighbours[number - 1].body if number else self.physics.object
        if np.any(body.com_offset):
            offset = rotation @ body.com_offset
            centre -= offset
            twist[:3] -= np.cross(twist[3:], offset)
        return BodyState(centre, rotation, twist)

    def apply_torque(self, name: str, torque: Array) -> None:
        """Joint torque of an arm over the next step, ``(n,)`` [N m]."""
        self._torques[name] = torque.tolist()

    def push(self, arm: str | None, point: Array, force: Array, moment: Array | None = None) -> None:
        """Apply a force at a point, and a moment, over the next step; in A.

        Args:
            arm: The arm whose end effector it acts on; None: the object.
            point: Point of action, ``(3,)`` [m].
            force: Force, ``(3,)`` [N].
            moment: Moment, ``(3,)`` [N m]; None: 0.
        """
        self._pushes.append((arm, point, force, np.zeros(3) if moment is None else moment))

    def contact_points(self, arm: str | None) -> tuple[tuple[Any, ...], ...]:
        """Contact points of the last step between object and arm (None: support)."""
        if arm is None:
            return self._get_contacts(self.object, self.support) if self.support is not None else ()
        return self._get_contacts(self.arms[arm], self.object)

    def set_support_friction(self, coefficient: float) -> None:
        """Set the friction coefficient of the support, from the next step on; for extensions of a plant."""
        self._support_friction = coefficient
        self.client.changeDynamics(self.support, -1, lateralFriction=coefficient / self._object_friction)

    def step(self) -> None:
        """Advance by one step."""
        for _ in range(self._substeps):
            for name, torque in self._torques.items():  # Bullet clears torques after every step
                self._set_torques(self.arms[name], self.joints[name], pybullet.TORQUE_CONTROL, forces=torque)
            for name, shear in self._shears.items():
                self._shear(name, shear)
            for arm, point, force, moment in self._pushes:
                body, link = (
                    (self.object, self._object_link) if arm is None else (self.arms[arm], self.end_effector_link[arm])
                )
                self._push(body, link, force.tolist(), point.tolist(), pybullet.WORLD_FRAME)
                if np.any(moment):
                    self.client.applyExternalTorque(body, link, moment.tolist(), pybullet.WORLD_FRAME)
            for body in self.objects if self._corrects_friction else ():
                self._correct_friction_direction(body)
            self._step()
        self._torques.clear()
        self._pushes.clear()

    def _correct_friction_direction(self, body: int) -> None:
        """Correct the direction of the support's friction on a sliding object, over the next step.

        The normal of the support is z of A. Scalars are used, because arrays would cost more than Bullet's step.
        """
        (vx, vy, _), (wx, wy, wz) = self._get_velocity(body)
        if max(abs(vx), abs(vy), abs(wz)) < MIN_SLIDING_SPEED_M_S:
            return
        cx, cy, cz = self._get_pose(body)[0]
        for point in self._get_contacts(body, self.support):
            position, first, second = point[5], point[11], point[13]
            x, y, z = position[0] - cx, position[1] - cy, position[2] - cz
            ux, uy = vx + wy * z - wz * y, vy + wz * x - wx * z
            speed, radius = math.hypot(ux, uy), self._support_friction * point[9]
            friction_x = point[10] * first[0] + point[12] * second[0]
            friction_y = point[10] * first[1] + point[12] * second[1]
            if speed > MIN_SLIDING_SPEED_M_S and math.hypot(friction_x, friction_y) > 0.99 * radius:
                force = (-radius * ux / speed - friction_x, -radius * uy / speed - friction_y, 0.0)
                self._push(body, -1, force, position, pybullet.WORLD_FRAME)

    def _shear(self, name: str, shear: PadShear) -> None:
        """Friction of a pad that is compliant along its face, over the next step."""
        points = self._get_contacts(self.arms[name], self.object)
        contacts = PadContacts(
            points=np.array([point[6] for point in points]).reshape(-1, 3),
            loads=np.array([max(point[9], 0.0) for point in points]),
            normal=np.array(points[0][7] if points else np.zeros(3)),
        )
        if not np.any(contacts.loads):
            shear.release()
            return
        position, velocity = self.joint_motion(name)
        upper, jacobian, placement = self._models[name].at_impact(np.array(position))
        factor = np.linalg.cholesky(upper.T)  # it reads the lower triangle only
        half_mobility = np.linalg.solve(factor, jacobian.T)
        pad = ContactBody(placement.translation, jacobian @ np.array(velocity), half_mobility.T @ half_mobility)
        forces = shear.step(contacts, self._object_side(), pad, placement.rotation)
        arm, link = self.arms[name], self.end_effector_link[name]
        for point, (x, y, z) in zip(contacts.points.tolist(), forces.tolist(), strict=True):
            self._push(self.object, self._object_link, (x, y, z), point, pybullet.WORLD_FRAME)
            self._push(arm, link, (-x, -y, -z), point, pybullet.WORLD_FRAME)

    def _object_side(self) -> ContactBody:
        """The object at its centre of mass."""
        position, quaternion = self._get_pose(self.object)
        linear, angular = self._get_velocity(self.object)
        rotation = pin.Quaternion(np.array(quaternion)).matrix()
        object_, mobility = self.physics.object, np.zeros((6, 6))
        if object_.guide is not None:
            along = object_.guide_at(rotation, rotation @ object_.com_offset)
            mobility = np.outer(along, along) / object_.guided_inertia
        else:
            mobility[:3, :3] = np.eye(3) / object_.mass  # 0 for a fixed object, and so below
            mobility[3:, 3:] = rotation / object_.inertia @ rotation.T
        return ContactBody(np.array(position), np.array(linear + angular), mobility)

    def pad_force(self, name: str) -> Array:
        """Force of the objects on an arm's pad in the last step, in A, ``(3,)`` [N]."""
        points = [point for body in self.objects for point in self._get_contacts(self.arms[name], body)]
        if not points:
            return np.zeros(3)
        sizes = np.array([(point[9], point[10], point[12]) for point in points])  # normal and both tangents
        directions = np.array([(point[7], point[11], point[13]) for point in points])
        force = np.asarray(sizes.ravel() @ directions.reshape(-1, 3))
        return force - self._shears[name].force if name in self._shears else force


_idle: list[BulletClient] = []
_MAX_IDLE_CONNECTIONS = 4  # kept for reuse; opening one takes as long as half a window of a replay


def _connected() -> BulletClient:
    """A connection to an empty world."""
    if _idle:
        client = _idle.pop()
        client.resetSimulation()
        return client
    with _quiet():
        return BulletClient(connection_mode=pybullet.DIRECT)


def _give_back(client: BulletClient) -> None:
    if len(_idle) < _MAX_IDLE_CONNECTIONS:
        _idle.append(client)
        return
    client.disconnect()
    client._client = -1


def mass_matrices(facts: RobotFacts, end_effector: EndEffector, positions: Array) -> Array:
    """Bullet's mass matrices of a single arm, ``(k, n, n)`` [kg m^2].

    Args:
        facts: Kinematics, inertials and limits.
        end_effector: End effector on its flange.
        positions: Joint positions, ``(k, n)`` [rad].
    """
    client = _connected()
    body = _load_urdf(client, facts, end_effector, pin.SE3.Identity())
    matrices = np.array([client.calculateMassMatrix(body, row) for row in positions.tolist()])
    _give_back(client)
    return matrices


def _load_urdf(client: BulletClient, facts: RobotFacts, end_effector: EndEffector, base: pin.SE3) -> int:
    with tempfile.TemporaryDirectory(prefix="impact_rs_") as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(write_urdf(facts, end_effector), encoding="utf-8")
        body = client.loadURDF(
            str(path),
            basePosition=base.translation.tolist(),
            baseOrientation=_quaternion(base.rotation),
            useFixedBase=1,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_IGNORE_VISUAL_SHAPES,
        )
    return int(body)


def _substeps(physics: Physics, period: float) -> int:
    """Number of Bullet steps per period, so that the implicit spring does not overdamp a pad (:func:`_compliance`)."""
    numbers = [
        period * arm.pad_stiffness / max(arm.pad_damping, 1e-9)
        for arm in physics.arms.values()
        if arm.pad_stiffness is not None
    ]
    return min(math.ceil(max(numbers, default=1.0)), MAX_BULLET_STEPS)


def _compliance(stiffness: float, damping: float, step: float) -> dict[str, float]:
    """Stiffness and damping of one of the contact points of a face, from those of the whole face.

    Bullet's spring is implicit in the depth, k (d - h u), which adds the damping h k; it is subtracted here.
    """
    remaining = max(damping - step * stiffness, 0.0)
    return {"contactStiffness": stiffness / FACE_CONTACT_POINTS, "contactDamping": remaining / FACE_CONTACT_POINTS}


def _load_arm(client: BulletClient, scene: Physics, name: str, compliant: bool, step: float) -> int:
    physics = scene.arms[name]
    body = _load_urdf(client, physics.facts, physics.end_effector, physics.base)
    joints = list(range(len(joint_names(physics.facts))))
    client.setJointMotorControlArray(body, joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(joints))
    for link in range(-1, client.getNumJoints(body)):
        client.changeDynamics(
            body,
            link,
            linearDamping=0.0,
            angularDamping=0.0,
            spinningFriction=0.0,
            rollingFriction=0.0,
            restitution=0.0,
            **FREE_JOINT,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        )
        # A separate call: together with maxJointVelocity or activationState Bullet ignores it silently.
        client.changeDynamics(body, link, lateralFriction=scene.pad_friction / _object_friction(scene))
    if physics.end_effector.shape.kind == "cylinder":
        client.changeDynamics(body, len(joints), collisionMargin=MARGIN_M)
    if compliant and scene.rolling_arm:
        client.changeDynamics(body, len(joints), rollingFriction=scene.rolling_arm / _object_friction(scene))
    if compliant and physics.pad_stiffness is not None:
        client.changeDynamics(body, len(joints), **_compliance(physics.pad_stiffness, physics.pad_damping, step))
    return body


def _geometry(shape: ConvexShape, size: Array) -> dict[str, Any]:
    """A shape as Bullet takes it."""
    radius, height = float(size[0]) / 2.0, float(size[2])
    if shape.kind == "sphere":
        return {"shapeType": pybullet.GEOM_SPHERE, "radius": radius}
    if shape.kind == "capsule":  # Bullet's height is that of the tube, without the caps
        return {"shapeType": pybullet.GEOM_CAPSULE, "radius": radius, "height": height - 2.0 * radius}
    if shape.kind == "cylinder":
        return {"shapeType": pybullet.GEOM_CYLINDER, "radius": radius, "height": height}
    if shape.kind == "hull":
        return {"shapeType": pybullet.GEOM_MESH, "vertices": [list(corner) for corner in shape.corners]}
    return {"shapeType": pybullet.GEOM_BOX, "halfExtents": (size / 2.0).tolist()}


def _object_friction(physics: Physics) -> float:
    """Lateral friction of every object in Bullet."""
    return math.sqrt(physics.object_friction) if physics.neighbours else 1.0


def _make_object(client: BulletClient, object_: ObjectPhysics, friction: float) -> int:
    if object_.guide is not None:
        return _make_guided(client, object_, friction)
    shape = client.createCollisionShape(
        **_geometry(object_.shape, object_.size), collisionFramePosition=(-object_.com_offset).tolist()
    )
    mass = 0.0 if object_.fixed else object_.mass  # 0: fixed
    body = client.createMultiBody(baseMass=mass, baseCollisionShapeIndex=shape)
    _set_dynamics(client, body, -1, object_, friction)
    return int(body)


def _set_dynamics(client: BulletClient, body: int, link: int, object_: ObjectPhysics, friction: float) -> None:
    """Set all dynamic parameters of a link of an object, instead of Bullet's defaults."""
    if object_.shape.kind in ("cylinder", "hull"):  # Bullet rounds the rims of a cylinder, and adds a margin to a hull
        client.changeDynamics(body, link, collisionMargin=MARGIN_M)
    client.changeDynamics(
        body,
        link,
        localInertiaDiagonal=[0.0] * 3 if object_.fixed else object_.inertia.tolist(),
        linearDamping=0.0,
        angularDamping=0.0,
        lateralFriction=friction,
        spinningFriction=0.0,
        rollingFriction=0.0,
        restitution=0.0,
        activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
    )


def _make_guided(client: BulletClient, object_: ObjectPhysics, friction: float) -> int:
    """An object on a hinge or slide."""
    guide = object_.guide
    assert guide is not None
    turns = bool(np.any(guide[3:]))
    axis = guide[3:] if turns else guide[:3]
    joint = np.cross(axis, guide[:3]) if turns else np.zeros(3)  # a point of the hinge
    shape = client.createCollisionShape(
        **_geometry(object_.shape, object_.size), collisionFramePosition=(-joint).tolist()
    )
    body = client.createMultiBody(
        baseMass=0.0,
        linkMasses=[object_.mass],
        linkCollisionShapeIndices=[shape],
        linkVisualShapeIndices=[-1],
        linkPositions=[joint.tolist()],
        linkOrientations=[[0.0, 0.0, 0.0, 1.0]],
        linkInertialFramePositions=[(object_.com_offset - joint).tolist()],
        linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]],
        linkParentIndices=[0],
        linkJointTypes=[pybullet.JOINT_REVOLUTE if turns else pybullet.JOINT_PRISMATIC],
        linkJointAxis=[axis.tolist()],
    )
    _set_dynamics(client, body, GUIDED_LINK, object_, friction)
    client.changeDynamics(body, GUIDED_LINK, **FREE_JOINT)
    # Separate calls: together with activationState Bullet ignores them silently.
    client.changeDynamics(body, GUIDED_LINK, lateralFriction=friction)
    client.changeDynamics(body, GUIDED_LINK, localInertiaDiagonal=object_.inertia.tolist())
    client.changeDynamics(body, -1, activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING)
    client.setJointMotorControl2(body, GUIDED_LINK, pybullet.VELOCITY_CONTROL, force=0.0)
    return int(body)


def _shears(physics: Physics, period: float) -> dict[str, PadShear]:
    """Shear models of the pads with shear compliance or creep."""
    yielding = {name: arm for name, arm in physics.arms.items() if arm.pad_shear_compliance or arm.pad_creep}
    return {
        name: PadShear(arm.pad_shear_compliance, arm.pad_creep, physics.pad_friction, period, pads=len(yielding))
        for name, arm in yielding.items()
    }


def _make_support(
    client: BulletClient, physics: Physics, arms: dict[str, int], compliant: bool, step: float
) -> int | None:
    if physics.support_height is None:
        return None
    thickness, height = 0.1, physics.support_height
    yielding = compliant and physics.support_compliance > 0.0
    if yielding:  # without load it is higher, by the compression under the weight of the object
        height -= float(physics.gravity[2]) * physics.object.mass * physics.support_compliance
    half = (physics.support_size[0] / 2.0, physics.support_size[1] / 2.0, thickness / 2.0)
    shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
    body = client.createMultiBody(
        baseMass=0.0,
        baseCollisionShapeIndex=shape,
        basePosition=[0.0, 0.0, height - thickness / 2.0],
    )
    client.changeDynamics(
        body,
        -1,
        lateralFriction=physics.support_friction / _object_friction(physics),
        spinningFriction=0.0,
        rollingFriction=physics.rolling_arm / _object_friction(physics) if compliant else 0.0,
        restitution=0.0,
    )
    if yielding:
        stiffness = 1.0 / physics.support_compliance
        damping = 2.0 * SUPPORT_DAMPING_RATIO * float(np.sqrt(stiffness * physics.object.mass))
        client.changeDynamics(body, -1, **_compliance(stiffness, damping, step))
    for arm in arms.values():
        for link in range(-1, client.getNumJoints(arm)):
            client.setCollisionFilterPair(arm, body, link, -1, 0)
    return int(body)


def check_body(name: str, end_effector: EndEffector) -> None:
    """Refuse an end effector without a physically consistent inertia.

    Raises:
        NotABody: Its mass is not positive, or its moments of inertia are physically inconsistent.
    """
    smallest, middle, largest = np.linalg.eigvalsh(end_effector.inertia)
    if end_effector.mass <= 0.0 or smallest <= 0.0 or largest > (1.0 + 1e-6) * (smallest + middle):
        raise NotABody(
            f"end effector of arm {name!r}: mass {end_effector.mass:.4g} kg with principal moments of inertia "
            f"{smallest:.3g}, {middle:.3g}, {largest:.3g} kg m^2 is no rigid body"
        )


def _quaternion(rotation: Array) -> list[float]:
    return quaternion_of(rotation).tolist()
