# SPDX-License-Identifier: Apache-2.0
"""A second robot cell, on MuJoCo: another simulator that shares parameters with ours and nothing else.

What a laboratory would build from the same numbers, link parameters included, and where it differs from our plant:

* One tree of bodies in MuJoCo's own description, written from the robot's facts. No URDF, no Bullet.
* Every drive is a body of its own that turns with inertia B_rho; a fixed tendon of length ``theta - q`` with stiffness
  K and damping D couples it to its link. The spring acts in every step and is damped implicitly.
* The torque law of the paper (eq. torque_control_law) runs with the loop's period, beside steps of 1/8000 s.
* The pad is no shape but four points with a quarter of its stiffness and damping each, in its corners or where they
  stand for a homogeneous layer. They do not yield along its face: MuJoCo's friction knows no displacement, and a plate
  on springs between would need a mass of its own. The object rests on a support of finite stiffness.
* Friction follows MuJoCo's elliptic cones, which its solver relaxes in its own way.

Friction laws, delay and scatter are written here once more, from their definition.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import ArmPhysics, JointFriction, LoadState, Physics, ShaftFriction
from impact_rs_sim.plant.plant import Measurement
from impact_rs_sim.plant.sensors import ArmMeasurement, ArmSensors, ObjectTracker
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmMotion, BodyState

STEP = 1.0 / 8000.0  # s
UNKNOWN_HERE = ("pad_shear", "pad_creep", "stiff_control")  # effects that this cell, which closes its loop, cannot hide
LAYER, CORNERS = float(1.0 / np.sqrt(3.0)), 1.0
ELEMENT_RADIUS = 0.005  # m, of the balls that the pad touches with
SUPPORT_THICKNESS = 0.1  # m
RIGID_PAD = (1e7, 5e3)  # N/m and N s/m, of a pad that the scenario calls rigid

Modification = Callable[[mujoco.MjSpec], None]
Further = Callable[[mujoco.MjModel, mujoco.MjData], None]


@dataclass(frozen=True)
class ContactSettings:
    """What MuJoCo wants to know of a contact beyond the parameters.

    A point contact in MuJoCo is a spring and a damper on a virtual mass m_c (the inverse of its regularisation R):
    ``f = -k r - b v - m_c a``, so that k and b are those of the parameters where m_c is small. Friction is a damper of
    its own, ``f_t = -m_t (rate v_t + a_t)`` up to the cone, with ``m_t = m_c * friction_stiffness_ratio``. MuJoCo
    lifts what slides by ``mu rate v_t m_c`` of normal force (its convex cone), which must stay below what it carries:
    that bounds rate and m_c from above, creep where it sticks bounds them from below.

    Attributes:
        pad_spread: Where the pad's four elements are, of the way from its middle to its edges [-]. In the ``CORNERS``,
            as the contact points of our plant, they are three times as stiff against tilting as a homogeneous layer
            of the same stiffness against pressing, whose elements sit in the Gauss points of the face (``LAYER``).
        pad_virtual_mass: Of each of the pad's elements [kg].
        pad_friction_rate: Rate of the pad's friction [1/s].
        support_stiffness: Stiffness of the support under each corner of the object [N/m].
        support_damping_ratio: Its damping with the object on it, over the critical one [-].
        support_virtual_mass: Of each corner, over the mass of the object [-].
        support_friction_rate: Rate of the support's friction [1/s].
        friction_stiffness_ratio: Regularisation of the normal force over that of friction [-].
    """

    pad_spread: float = CORNERS
    pad_virtual_mass: float = 0.005
    pad_friction_rate: float = 1000.0
    support_stiffness: float = 5e5
    support_damping_ratio: float = 0.5
    support_virtual_mass: float = 0.02
    support_friction_rate: float = 300.0
    friction_stiffness_ratio: float = 1e4


DEFAULT_CONTACTS = ContactSettings()


class MujocoCell:
    """Flexible-joint arms, object and support in MuJoCo, for one trial; offers what a controller needs of a plant.

    Args:
        scenario: Times, sensors and scatter.
        physics: The true physics.
        initial: Initial joint positions by arm, ``(n,)`` [rad].
        object_state: Nominal pose of the object; the scatter comes on top.
        seed: Seed of scatter and noise. Same seed, same trial, bit by bit.
        modify: Changes the description before it is compiled; for what physics cannot say.
        contacts: What MuJoCo wants to know of contacts.
        step: Largest step [s].
        further: Adds forces before every step; for laws that the physics does not have.

    Raises:
        InputError: Masses and inertias that are those of no body.
    """

    def __init__(
        self,
        scenario: Scenario,
        physics: Physics,
        initial: dict[str, Array],
        object_state: BodyState,
        seed: int,
        modify: Modification | None = None,
        contacts: ContactSettings = DEFAULT_CONTACTS,
        step: float = STEP,
        further: Further | None = None,
    ) -> None:
        timing, self._further = scenario.timing, further
        scatter_seed, object_seed, *arm_seeds = np.random.SeedSequence(seed).spawn(2 + len(physics.arms))
        physics, initial, object_state = _scattered(scenario, physics, initial, object_state, scatter_seed)
        self.physics = physics
        self._control_period = timing.control_period
        self._loops = timing.substeps
        self._last = timing.ticks
        self._tick = 0
        self._steps = max(1, round(timing.drive_period / step))
        self.model = compile_scene(physics, timing.drive_period / self._steps, contacts, modify)
        self.data = mujoco.MjData(self.model)
        if physics.support_height is not None:  # it has sunk in as far as its weight wants
            depth = -physics.object.mass * physics.gravity[2] / (4.0 * contacts.support_stiffness)
            object_state = replace(object_state, position=object_state.position - [0.0, 0.0, depth])
        self._place_object(object_state)
        self._arms = {
            name: _Arm(self.model, self.data, name, arm, initial[name], timing.drive_period)
            for name, arm in physics.arms.items()
        }
        mujoco.mj_forward(self.model, self.data)
        for arm in self._arms.values():
            arm.rest()
        samples = timing.ticks + 1
        self._sensors = {
            name: ArmSensors(scenario.sensors, initial[name].size, samples, np.random.default_rng(arm_seed))
            for name, arm_seed in zip(physics.arms, arm_seeds, strict=True)
        }
        self._tracker_ticks = max(1, round(scenario.sensors.object_period / timing.control_period))
        self._tracker = ObjectTracker(
            scenario.sensors, samples // self._tracker_ticks + 1, np.random.default_rng(object_seed)
        )

    @property
    def time(self) -> float:
        """Time since the start of the trial [s]."""
        return self._tick * self._control_period

    def measure(self) -> Measurement:
        """What the sensors say now. Calling it twice gives the same answer."""
        arms: dict[str, ArmMeasurement] = {
            name: self._sensors[name].measure(
                self._tick,
                ArmMotion(
                    arm.link_position, arm.link_velocity, arm.elastic_torque, arm.motor_position, arm.motor_velocity
                ),
            )
            for name, arm in self._arms.items()
        }
        tracked = None
        if self._tick % self._tracker_ticks == 0:
            state = self.object_state()
            sample = self._tick // self._tracker_ticks
            tracked = self._tracker.measure(sample, self.time, state.position, state.rotation)
        return Measurement(self.time, arms, tracked)

    def step(self, desired: dict[str, Array]) -> None:
        """Advance by one control period with desired torques ``(n,)`` [N m] by arm.

        Raises:
            InputError: A torque is not finite or has the wrong length, or the trial is over.
        """
        for name, arm in self._arms.items():
            torque = desired[name]
            if torque.shape != arm.link_position.shape or not np.isfinite(torque).all():
                raise InputError(f"desired torque of arm {name!r} must be finite numbers [N m], one per joint")
            arm.command(self.time, torque)
        if self._tick >= self._last:
            raise InputError(f"the trial is over after {self._last * self._control_period} s")
        for loop in range(self._loops):
            moment = self.time + loop * self._control_period / self._loops
            for arm in self._arms.values():
                arm.run_torque_loop(moment)
            for _ in range(self._steps):
                for arm in self._arms.values():
                    arm.apply()
                if self._further is not None:
                    self._further(self.model, self.data)
                mujoco.mj_step(self.model, self.data)
        self._tick += 1

    def object_state(self) -> BodyState:
        """State of the object at its geometric centre."""
        joint = self.model.joint("object")
        position, velocity = joint.qposadr[0], joint.dofadr[0]
        qpos, qvel = self.data.qpos, self.data.qvel
        w, x, y, z = qpos[position + 3 : position + 7]
        rotation = pin.Quaternion(w, x, y, z).matrix()
        twist = np.concatenate((qvel[velocity : velocity + 3], rotation @ qvel[velocity + 3 : velocity + 6]))
        return BodyState(qpos[position : position + 3].copy(), rotation, twist)

    def _place_object(self, state: BodyState) -> None:
        joint = self.model.joint("object")
        position, velocity = joint.qposadr[0], joint.dofadr[0]
        self.data.qpos[position : position + 7] = np.concatenate((state.position, _quaternion(state.rotation)))
        self.data.qvel[velocity : velocity + 6] = np.concatenate((state.twist[:3], state.rotation.T @ state.twist[3:]))

    def close(self) -> None:
        """Nothing to free; a plant has to be closed."""


class _Arm:
    """One arm of the cell: where its joints are in MuJoCo's vectors, its torque loop and what loads it."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, name: str, physics: ArmPhysics, initial: Array, period: float
    ) -> None:
        count = initial.size
        self._model, self._data, self._physics = model, data, physics
        links = [model.joint(f"{name}/joint{index + 1}") for index in range(count)]
        motors = [model.joint(f"{name}/motor{index + 1}") for index in range(count)]
        tendons = [model.tendon(f"{name}/transmission{index + 1}").id for index in range(count)]
        self._link, self._motor = (np.array([joint.qposadr[0] for joint in group]) for group in (links, motors))
        self._link_dof, self._motor_dof = (np.array([joint.dofadr[0] for joint in group]) for group in (links, motors))
        self._play = model.tendon_lengthspring[tendons].T.copy()
        self._site = model.site(f"{name}/E").id
        self._shaping = physics.motor_inertia_rotor / physics.motor_inertia_reduced
        self._friction = friction_law(physics.friction)
        self._period = period
        self._commands: deque[tuple[float, Array]] = deque()
        self._actuation = np.zeros(count)
        self._link_load = np.zeros(count)
        data.qpos[self._link] = initial

    def rest(self) -> None:
        """Hold the links against gravity where they are: motors ahead by what the springs carry."""
        load = self._data.qfrc_bias[self._link_dof].copy()
        stretch = load / self._physics.stiffness
        stretch += np.where(load < 0.0, self._play[0], self._play[1])
        self._data.qpos[self._motor] = self._data.qpos[self._link] + stretch
        self._commands.append((-np.inf, load))
        mujoco.mj_forward(self._model, self._data)

    @property
    def link_position(self) -> Array:
        """q, ``(n,)`` [rad], a copy."""
        return np.asarray(self._data.qpos[self._link])

    @property
    def link_velocity(self) -> Array:
        """dq, ``(n,)`` [rad/s], a copy."""
        return np.asarray(self._data.qvel[self._link_dof])

    @property
    def motor_position(self) -> Array:
        """Theta, ``(n,)`` [rad], a copy."""
        return np.asarray(self._data.qpos[self._motor])

    @property
    def motor_velocity(self) -> Array:
        """Velocity of the motors, ``(n,)`` [rad/s], a copy."""
        return np.asarray(self._data.qvel[self._motor_dof])

    @property
    def elastic_torque(self) -> Array:
        """tau_J, what the springs carry, ``(n,)`` [N m]."""
        stretch = self.motor_position - self.link_position
        return np.asarray(self._physics.stiffness * (stretch - np.clip(stretch, *self._play)))

    def command(self, time: float, torque: Array) -> None:
        """Take a desired torque ``(n,)`` [N m] at ``time`` [s]; it holds until the next."""
        self._commands.append((time, torque))

    def run_torque_loop(self, time: float) -> None:
        """Torque law and loads at ``time`` [s], held over one period of the loop."""
        physics = self._physics
        desired = physics.torque_gain * self._delivered(time) + physics.torque_offset
        transmission = self.elastic_torque + physics.damping * (self.motor_velocity - self.link_velocity)
        if physics.loads:
            self._link_load, on_motors = self._loads(time)
            desired = desired + on_motors
        self._actuation = self._shaping * desired + (1.0 - self._shaping) * transmission

    def _delivered(self, time: float) -> Array:
        """Mean of the delayed commands over the period that begins at ``time`` [s], ``(n,)`` [N m]."""
        start = time - self._physics.actuation_delay
        commands = self._commands
        while len(commands) > 1 and commands[1][0] <= start + 1e-9:
            commands.popleft()
        begins = np.array([begin for begin, _ in commands])
        edges = np.clip(np.append(begins, np.inf), start, start + self._period)
        shares = np.diff(edges) / self._period
        return np.asarray(shares @ np.array([torque for _, torque in commands]))

    def _loads(self, time: float) -> tuple[Array, Array]:
        """Torques on the links and on the motors of everything outside the model, ``(n,)`` each [N m]."""
        data, dofs = self._data, self._link_dof
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        jacobian = np.zeros((3, self._model.nv))
        mujoco.mj_jacSite(self._model, data, jacobian, None, self._site)
        velocity = self.link_velocity
        state = LoadState(
            time=time,
            joint_position=self.link_position,
            joint_velocity=velocity,
            position=data.site_xpos[self._site].copy(),
            velocity=jacobian @ data.qvel,
            impact_position=self._physics.impact_position,
        )
        links, motors = np.zeros_like(velocity), np.zeros_like(velocity)
        for load in self._physics.loads:
            torque, force, motor = load.joint_torque(state), load.end_effector_force(state), load.motor_torque(state)
            links += 0.0 if torque is None else torque
            links += 0.0 if force is None else jacobian[:, dofs].T @ force
            motors += 0.0 if motor is None else motor
        return links, motors

    def apply(self) -> None:
        """Torques on motors and links over the next step; friction follows the motors in every step."""
        friction = 0.0
        if self._friction is not None:
            velocity = self.motor_velocity
            transmitted = self.elastic_torque + self._physics.damping * (velocity - self.link_velocity)
            friction = self._shaping * self._friction(velocity, transmitted)
        self._data.qfrc_applied[self._motor_dof] = self._actuation + friction
        self._data.qfrc_applied[self._link_dof] = self._link_load


def friction_law(friction: JointFriction) -> Callable[[Array, Array], Array] | None:
    """Torque of joint friction against velocity and transmitted torque; None where there is none.

    Both arguments and the torque are ``(n,)`` [rad/s, N m, N m].
    """
    terms: list[Callable[[Array, Array], Array]] = []

    widths = np.zeros(friction.coulomb.size) + friction.smoothing

    def direction(velocity: Array, width: Array = widths) -> Array:
        return np.asarray(np.tanh(velocity / width))

    if np.any(friction.coulomb) or np.any(friction.stribeck):

        def dry(velocity: Array, transmitted: Array) -> Array:
            excess = friction.stribeck * np.exp(-((velocity / friction.stribeck_velocity) ** 2))
            return -direction(velocity) * (friction.coulomb + excess)

        terms.append(dry)
    if np.any(friction.viscous):
        terms.append(lambda velocity, transmitted: -friction.viscous * velocity)
    if friction.load is not None:
        share = friction.load
        terms.append(lambda velocity, transmitted: -share * direction(velocity) * np.abs(transmitted))
    if friction.asymmetry is not None:
        more = friction.asymmetry
        terms.append(lambda velocity, transmitted: -more * direction(velocity) ** 2)
    for shafts in friction.shafts:
        count = friction.coulomb.size
        turns = np.eye(count)[:-1] + shafts.ratio * np.eye(count, k=1)[:-1]  # of the shafts per turn of the joints

        def shared(velocity: Array, transmitted: Array, own: ShaftFriction = shafts, turns: Array = turns) -> Array:
            speed = turns @ velocity
            return np.asarray(-turns.T @ (own.coulomb * direction(speed, widths[:-1]) + own.viscous * speed))

        terms.append(shared)
    if friction.sigmoid is not None:
        a, b, c = (np.array(numbers) for numbers in (friction.sigmoid.a, friction.sigmoid.b, friction.sigmoid.c))
        at_rest = a / (1.0 + np.exp(-b * c))
        terms.append(lambda velocity, transmitted: at_rest - a / (1.0 + np.exp(-b * (velocity + c))))
    if not terms:
        return None
    return lambda velocity, transmitted: np.asarray(sum(term(velocity, transmitted) for term in terms))


def compile_scene(
    physics: Physics,
    step: float,
    contacts: ContactSettings = DEFAULT_CONTACTS,
    modify: Modification | None = None,
) -> mujoco.MjModel:
    """MuJoCo's model of a scene.

    Bodies are ``ARM/link1`` ..., ``ARM/rotor1`` ..., ``ARM/end_effector`` and ``object``; joints ``ARM/joint1`` ...,
    ``ARM/motor1`` ... and ``object``; tendons ``ARM/transmission1`` ...; the site ``ARM/E`` is frame E.

    Args:
        physics: The parameters.
        step: Step [s].
        contacts: What MuJoCo wants to know of contacts.
        modify: Changes the description before it is compiled.

    Raises:
        InputError: Masses and inertias that are those of no body, or a pad that yields along its face.
    """
    for name, arm in physics.arms.items():
        if arm.pad_shear_compliance or arm.pad_creep:
            raise InputError(f"the pad of arm {name!r} yields along its face; those of this cell do not")
    spec = _describe(physics, step, contacts)
    if modify is not None:
        modify(spec)
    try:
        model = spec.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo refuses these physics: {error}") from None
    mass = physics.object.mass
    if physics.support_height is not None:
        stiffness = contacts.support_stiffness
        if physics.support_compliance:
            stiffness = 1.0 / (1.0 / stiffness + 4.0 * physics.support_compliance)
        damping = 2.0 * contacts.support_damping_ratio * np.sqrt(stiffness * mass / 4.0)
        virtual = contacts.support_virtual_mass * mass
        _set_contact(model, "support", stiffness, damping, virtual, contacts.support_friction_rate)
    for name, arm in physics.arms.items():
        stiffness, damping = RIGID_PAD if arm.pad_stiffness is None else (arm.pad_stiffness, arm.pad_damping)
        for element in _pad_elements(name):
            virtual, rate = contacts.pad_virtual_mass, contacts.pad_friction_rate
            _set_contact(model, element, stiffness / 4.0, damping / 4.0, virtual, rate)
    return model


def _describe(physics: Physics, step: float, contacts: ContactSettings) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.autolimits = False
    option = spec.option
    option.timestep = step
    option.gravity = physics.gravity
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.impratio = contacts.friction_stiffness_ratio
    option.iterations, option.tolerance = 100, 1e-12
    object_ = physics.object
    body = spec.worldbody.add_body(
        name="object", mass=object_.mass, ipos=object_.com_offset, inertia=object_.inertia, explicitinertial=True
    )
    body.add_freejoint(name="object")
    _add_box(body, "object", object_.size / 2.0, np.zeros(3))
    if physics.support_height is not None:
        half = np.array([*physics.support_size, SUPPORT_THICKNESS]) / 2.0
        pressed = -physics.gravity[2] * object_.mass * physics.support_compliance
        place = np.array([0.0, 0.0, physics.support_height + pressed - half[2]])
        _add_box(spec.worldbody, "support", half, place)
        _add_contact(spec, "support", physics.support_friction, physics.rolling_arm)
    for name, arm in physics.arms.items():
        end_effector = _add_links(spec, name, arm)
        _add_drives(spec, name, arm)
        for element in _add_pad(end_effector, name, arm, contacts.pad_spread):
            _add_contact(spec, element, physics.pad_friction, physics.rolling_arm)
    return spec


def _add_links(spec: mujoco.MjSpec, name: str, arm: ArmPhysics) -> mujoco.MjsBody:
    """The chain of links from the base to the end effector; returns the last."""
    facts, hand = arm.facts, arm.end_effector
    parent = spec.worldbody.add_body(
        name=f"{name}/base",
        pos=arm.base.translation,
        quat=_quaternion(arm.base.rotation),
        mass=1.0,
        ipos=np.zeros(3),
        inertia=np.ones(3),
        explicitinertial=True,
    )
    for index, (origin, link) in enumerate(zip(facts.joints, facts.links, strict=True)):
        ixx, ixy, ixz, iyy, iyz, izz = link.inertia
        parent = parent.add_body(
            name=f"{name}/link{index + 1}",
            pos=origin.xyz,
            quat=_quaternion(pin.rpy.rpyToMatrix(*origin.rpy)),
            mass=link.mass,
            ipos=link.com,
            fullinertia=[ixx, iyy, izz, ixy, ixz, iyz],
            explicitinertial=True,
        )
        parent.add_joint(name=f"{name}/joint{index + 1}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
    body = parent.add_body(
        name=f"{name}/end_effector",
        pos=np.array(facts.flange.xyz) + facts.flange.rotation @ [0.0, 0.0, hand.length],
        quat=_quaternion(facts.flange.rotation @ pin.rpy.rpyToMatrix(0.0, 0.0, hand.mount_yaw)),
        mass=hand.mass,
        ipos=hand.com,
        fullinertia=[*np.diag(hand.inertia), hand.inertia[0, 1], hand.inertia[0, 2], hand.inertia[1, 2]],
        explicitinertial=True,
    )
    body.add_site(name=f"{name}/E")
    return body


def _add_drives(spec: mujoco.MjSpec, name: str, arm: ArmPhysics) -> None:
    """A rotor per joint, on the world, and its transmission."""
    for index in range(arm.facts.joint_count):
        rotor = spec.worldbody.add_body(
            name=f"{name}/rotor{index + 1}",
            pos=arm.base.translation,
            mass=1.0,
            ipos=np.zeros(3),
            inertia=np.full(3, arm.motor_inertia_rotor[index]),
            explicitinertial=True,
        )
        rotor.add_joint(name=f"{name}/motor{index + 1}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
        transmission = spec.add_tendon(
            name=f"{name}/transmission{index + 1}",
            stiffness=[arm.stiffness[index], 0.0, 0.0],
            damping=[arm.damping[index], 0.0, 0.0],
            springlength=[0.0, 0.0],
        )
        transmission.wrap_joint(f"{name}/motor{index + 1}", 1.0)
        transmission.wrap_joint(f"{name}/joint{index + 1}", -1.0)


def _pad_elements(name: str) -> list[str]:
    return [f"{name}/pad{number}" for number in range(4)]


def _add_pad(end_effector: mujoco.MjsBody, name: str, arm: ArmPhysics, spread: float) -> list[str]:
    """Four points in the end effector's face; returns their names."""
    x, y = spread * np.array(arm.end_effector.pad_size[:2]) / 2.0
    roll, pitch = arm.end_effector.pad_tilt
    turn = pin.rpy.rpyToMatrix(roll, pitch, 0.0)
    names = _pad_elements(name)
    for element, corner in zip(names, ((-x, -y), (-x, y), (x, -y), (x, y)), strict=True):
        end_effector.add_geom(
            name=element,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[ELEMENT_RADIUS, 0.0, 0.0],
            pos=turn @ [*corner, -ELEMENT_RADIUS] + arm.end_effector.pad_offset,
            mass=0.0,
            contype=0,
            conaffinity=0,
        )
    return names


def _add_box(body: mujoco.MjsBody, name: str, half: Array, place: Array) -> None:
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=place, mass=0.0, contype=0, conaffinity=0)


def _add_contact(spec: mujoco.MjSpec, partner: str, friction: float, rolling_arm: float) -> None:
    """Contact between the object and a partner; all others pass through each other."""
    spec.add_pair(
        name=f"object-{partner}",
        geomname1=partner,
        geomname2="object",
        condim=6 if rolling_arm else 3,
        friction=[friction, friction, 0.0, rolling_arm, rolling_arm],
    )


def _set_contact(
    model: mujoco.MjModel, partner: str, stiffness: float, damping: float, virtual_mass: float, friction_rate: float
) -> None:
    """Give a contact of the object its law, see :class:`ContactSettings`.

    MuJoCo makes the regularisation from the impedance d and the inverse weight w of both bodies, ``R = (1 - d) / d w``.

    Args:
        model: The model, changed in place.
        partner: What the object touches.
        stiffness: Of this contact point [N/m].
        damping: Of this contact point [N s/m].
        virtual_mass: Of this contact point [kg].
        friction_rate: Rate of its friction [1/s].
    """
    pair = model.pair(f"object-{partner}").id
    bodies = [model.geom_bodyid[geom[pair]] for geom in (model.pair_geom1, model.pair_geom2)]
    weight = float(model.body_invweight0[bodies, 0].sum())
    impedance = weight / (weight + 1.0 / virtual_mass)
    model.pair_solimp[pair] = (impedance, impedance, 1e-3, 0.5, 2.0)  # the same at every depth
    model.pair_solref[pair] = -impedance / virtual_mass * np.array([stiffness, damping])
    model.pair_solreffriction[pair] = (-1e-9, -impedance * friction_rate)  # a pure damper


def _quaternion(rotation: Array) -> Array:
    """w, x, y, z of a rotation matrix, ``(4,)``."""
    return np.roll(quaternion_of(rotation), 1)


def _scattered(
    scenario: Scenario,
    physics: Physics,
    initial: dict[str, Array],
    state: BodyState,
    seed: np.random.SeedSequence,
) -> tuple[Physics, dict[str, Array], BodyState]:
    """What differs from trial to trial, as the scenario says."""
    rng, scatter = np.random.default_rng(seed), scenario.scatter
    x, y = scatter.object_position * rng.standard_normal(2)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, scatter.object_yaw * rng.standard_normal())
    friction = max(0.0, physics.support_friction * (1.0 + scatter.support_friction * rng.standard_normal()))
    moved = replace(state, position=state.position + np.array([x, y, 0.0]), rotation=state.rotation @ turn)
    started = {name: q + scatter.joint_position * rng.standard_normal(q.size) for name, q in initial.items()}
    return replace(physics, support_friction=friction), started, moved
