# SPDX-License-Identifier: Apache-2.0
"""Physical parameters of a plant, a twin or an impact map.

A :class:`Physics` holds all physical parameters of a scene. The nominal one follows from scenario and object; an effect
maps one to another. There are no other physical parameters, so every effect that a plant can hide can be modelled.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from impact_rs_sim.damping_of_restitution import damping_ratio_of, restitution_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.memory import Memory
from impact_rs_sim.readings import EXACT, ArmReadings, TrackerReadings
from impact_rs_sim.robots.robot import Array, EndEffector, JointType, RobotFacts, SigmoidFriction, travel_per_rad
from impact_rs_sim.robots.robot_model import STANDARD_GRAVITY, RobotModel
from impact_rs_sim.robots.tool_spring import ToolSpring
from impact_rs_sim.robots.urdf import write_description
from impact_rs_sim.scenarios.object_spec import ObjectSpec, guided_object
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.shapes import BOX, ConvexShape
from impact_rs_sim.twist_readings import TwistReadings

MOTOR_INERTIA_MODELS = ("reduced", "rotor", "zero")
RESTITUTION_LAWS = ("newton", "poisson")
# Width of dry friction at a reversal without an effect: small against the speeds of a motion, and large against the
# change of a motor's velocity in one period of its torque loop. A prismatic joint has it behind a pinion.
SHARP_WIDTH_RAD_S = 0.005


@dataclass(frozen=True)
class ShaftFriction:
    """Friction of shafts that turn with two neighbouring joints, such as the last shaft of a wrist with a bevel gear.

    Attributes:
        coulomb: F_c of the shaft of joints i and i + 1, ``(n - 1,)`` [N m].
        viscous: F_v of the shaft of joints i and i + 1, ``(n - 1,)`` [N m s/rad].
        ratio: r, turns of the shaft with joint i + 1 over those with joint i [-].
    """

    coulomb: Array
    viscous: Array
    ratio: float

    def torque(self, velocity: Array, smoothing: float | Array) -> Array:
        """Torque on the joints, ``(..., n)`` [N m], see :class:`JointFriction`.

        Args:
            velocity: Velocity of the motors, ``(..., n)`` [rad/s].
            smoothing: v_r of all joints, or of each, ``(n,)`` [rad/s]; a shaft takes the width of its first joint.
        """
        speed = velocity[..., :-1] + self.ratio * velocity[..., 1:]
        smoothing = np.broadcast_to(smoothing, velocity.shape[-1:])[:-1]
        shaft_torque = -self.coulomb * np.tanh(speed / smoothing) - self.viscous * speed
        torque = np.zeros_like(velocity)
        torque[..., :-1] += shaft_torque
        torque[..., 1:] += self.ratio * shaft_torque
        return torque


@dataclass(frozen=True)
class JointFriction:
    """Joint friction, in terms of the desired torque: tau_fric of paper eq. EOM_motor_mod.

    The motor feels ``tau_fric,m = B_rho B_theta^-1 tau_fric`` (paper, below eq. EOM_motor_mod). With the direction
    ``s = tanh(dtheta / v_r)`` (Andersson, Söderberg and Björklund 2007, Tribology International 40), a smooth sign with
    which rest is a state and not a limit cycle,

        tau_fric = -(F_c + F_s exp(-(dtheta / v_s)^2) + a s + k |tau_J|) s - F_v dtheta

    and the shaft that turns with joints i and i + 1 adds, at its speed w = dtheta_i + r dtheta_i+1,

        tau_i = -(F_c tanh(w / v_r,i) + F_v w),    tau_i+1 = r tau_i

    Every part opposes motion (power <= 0) as long as no asymmetry exceeds the Coulomb friction of its joint.

    Attributes:
        coulomb: Coulomb friction F_c, ``(n,)`` [N m].
        viscous: Viscous friction F_v, ``(n,)`` [N m s/rad].
        stribeck: Breakaway torque above Coulomb F_s, ``(n,)`` [N m].
        stribeck_velocity: Velocity v_s at which the excess has fallen to 1/e, ``(n,)`` [rad/s].
        sigmoid: Friction identified by Gaz et al. 2019, added to the above.
        smoothing: Width v_r of a reversal, where dry friction has turned by tanh(1) = 76 %, of all joints or of each,
            ``(n,)`` [rad/s].
        asymmetry: a, half the difference of forward and backward friction, ``(n,)`` [N m]; None: 0.
        load: k, friction over transmitted torque, ``(n,)`` [-]; None: 0.
        shafts: Shafts that turn with two joints.
    """

    coulomb: Array
    viscous: Array
    stribeck: Array
    stribeck_velocity: Array
    sigmoid: SigmoidFriction | None = None
    smoothing: float | Array = SHARP_WIDTH_RAD_S
    asymmetry: Array | None = None
    load: Array | None = None
    shafts: tuple[ShaftFriction, ...] = ()

    @staticmethod
    def none(joints: int | Sequence[JointType]) -> JointFriction:
        """No friction, for joints of these types or for a number of revolute joints."""
        zero = np.zeros(joints if isinstance(joints, int) else len(joints))
        travel = np.ones_like(zero) if isinstance(joints, int) else travel_per_rad(joints)
        return JointFriction(zero, zero, zero, 0.05 * travel, smoothing=SHARP_WIDTH_RAD_S * travel)

    @property
    def is_zero(self) -> bool:
        """Whether the torque is zero at every velocity."""
        parts = (self.coulomb, self.viscous, self.stribeck, self.asymmetry, self.load)
        shaped = self.sigmoid is not None or bool(self.shafts)
        return not shaped and not any(np.any(values) for values in parts if values is not None)

    def torque(self, velocity: Array, transmitted: Array | float = 0.0) -> Array:
        """Friction torque, ``(n,)`` [N m]; both arguments may have an axis of samples in front.

        Args:
            velocity: Velocity of the motors, ``(n,)`` [rad/s].
            transmitted: Torque of the transmissions on the links, ``(n,)`` [N m].
        """
        direction = np.tanh(velocity / self.smoothing)
        size = self.coulomb + self.stribeck * np.exp(-np.square(velocity / self.stribeck_velocity))
        if self.asymmetry is not None:
            size = size + self.asymmetry * direction
        if self.load is not None:
            size = size + self.load * np.abs(transmitted)
        torque = -size * direction - self.viscous * velocity
        if self.sigmoid is not None:
            a, b, c = (np.array(values) for values in (self.sigmoid.a, self.sigmoid.b, self.sigmoid.c))
            torque -= a / (1.0 + np.exp(-b * (velocity + c))) - a / (1.0 + np.exp(-b * c))
        for shaft in self.shafts:
            torque += shaft.torque(velocity, self.smoothing)
        return np.asarray(torque)

    def viscous_torque(self, velocity: Array) -> Array:
        """Part of :meth:`torque` that is linear in the velocity ``(n,)`` [rad/s], ``(n,)`` [N m]."""
        torque = -self.viscous * velocity
        for shaft in self.shafts:
            torque += replace(shaft, coulomb=np.zeros_like(shaft.coulomb)).torque(velocity, self.smoothing)
        return np.asarray(torque)


@dataclass(frozen=True)
class LoadState:
    """Arguments of a :class:`Load`; for a vectorised load, arrays may have an axis of samples in front.

    Attributes:
        time: Time since the start of the trial [s].
        joint_position: q, ``(n,)`` [rad].
        joint_velocity: dq, ``(n,)`` [rad/s].
        position: Origin of frame E in A, ``(3,)`` [m].
        velocity: Its velocity, ``(3,)`` [m/s].
        impact_position: Position of E at the nominal impact, ``(3,)`` [m].
        joint_torque: tau_J, ``(n,)`` [N m]; None: unknown, and 0 in formulas.
        scene: Symbols of object and contact by name, in SI units; missing symbols are 0.
        memory: Memory of the arm's loads in this simulation; None: a single state, or samples along time.
    """

    time: float | Array
    joint_position: Array
    joint_velocity: Array
    position: Array
    velocity: Array
    impact_position: Array
    joint_torque: Array | None = None
    scene: Mapping[str, float] = field(default_factory=dict)
    memory: Memory | None = None

    @property
    def samples(self) -> Iterator[LoadState]:
        """The samples one by one, without contact."""
        torques = np.zeros_like(self.joint_position) if self.joint_torque is None else self.joint_torque
        rows = zip(
            np.asarray(self.time).tolist(),
            self.joint_position,
            self.joint_velocity,
            self.position,
            self.velocity,
            torques,
            strict=True,
        )
        for time, q, dq, position, velocity, torque in rows:
            yield LoadState(time, q, dq, position, velocity, self.impact_position, torque)


class ObjectLoad(ABC):
    """A load on the object, or between it and its support, from outside the model."""

    @property
    def remembers(self) -> bool:
        """Whether the support load has memory; it is then evaluated without contact as well."""
        return False

    @abstractmethod
    def wrench(self, scene: Mapping[str, float], memory: Memory) -> Array:
        """Force at the centre of the object and moment, axes of A, ``(6,)`` [N, N m].

        Args:
            scene: Symbols of time and object by name, in SI units.
            memory: Memory of the loads on the object in this simulation.
        """

    @abstractmethod
    def support_force(self, scene: Mapping[str, float], memory: Memory) -> tuple[float, float]:
        """Normal force on the object (positive: repulsive) and force against its sliding [N]."""


class Load:
    """A load on one arm from outside the model; subclasses override what they need.

    Attributes:
        touches: Whether it acts between pad and object.
        remembers: Whether its load between pad and object has memory; it is then evaluated without contact as well.
        reads_scene: Whether it depends on :attr:`LoadState.scene`.
        vectorised: Whether it takes many samples at once; if not, it is called for every sample.
    """

    @property
    def touches(self) -> bool:
        """See the class."""
        return False

    @property
    def remembers(self) -> bool:
        """See the class."""
        return False

    @property
    def reads_scene(self) -> bool:
        """See the class."""
        return False

    @property
    def vectorised(self) -> bool:
        """See the class."""
        return False

    def motor_torque(self, state: LoadState) -> Array | None:
        """Torque on the motors, as joint friction acts, ``(n,)`` [N m], or None."""
        return None

    def joint_torque(self, state: LoadState) -> Array | None:
        """Torque on the links, ``(n,)`` [N m], or None."""
        return None

    def end_effector_force(self, state: LoadState) -> Array | None:
        """Force at the origin of E, axes of A, ``(3,)`` [N], or None."""
        return None

    def pad_force(self, state: LoadState) -> tuple[float, float] | None:
        """Load at a closed pad contact: repulsive normal force and force against sliding [N], or None."""
        return None


@dataclass(frozen=True)
class ContactCondition:
    """State and laws of m contact points just before an impact (:mod:`impact_rs_sim.impact_map.contact_laws`).

    Attributes:
        closing: Closing speed of the points, ``(m,)`` [m/s].
        slip: Sliding speed of the points, ``(m,)`` [m/s].
        friction: Coulomb coefficient, ``(m,)`` [-].
        restitution: Restitution of the normal velocity, ``(m,)`` [-].
        tangential_restitution: Restitution of the sliding velocity, ``(m,)`` [-].
        drilling_arm: Largest angular impulse about the normal over the normal impulse, ``(m,)`` [m].
        rolling_arm: Largest angular impulse across the normal over the normal impulse, ``(m,)`` [m].
        spin_restitution: Restitution of the angular velocity about the normal, ``(m,)`` [-].
    """

    closing: Array
    slip: Array
    friction: Array
    restitution: Array
    tangential_restitution: Array
    drilling_arm: Array
    rolling_arm: Array
    spin_restitution: Array


class ContactLaw(ABC):
    """A law of the contact points of a single impact, beyond constant friction and restitution."""

    @abstractmethod
    def apply(self, contact: ContactCondition) -> ContactCondition:
        """The contact with this law; coefficients are limited to their ranges after the last law."""


@dataclass(frozen=True)
class ArmPhysics:
    """One arm: link side, motor side, actuation and pad.

    Attributes:
        facts: Kinematics, link inertials and limits.
        base: Placement of the base in A.
        end_effector: End effector, including everything fixed to it.
        motor_inertia_rotor: B_rho, ``(n,)`` [kg m^2].
        motor_inertia_reduced: B_theta that the torque loop aims at, ``(n,)`` [kg m^2].
        stiffness: K, ``(n,)`` [N m/rad].
        damping: D, ``(n,)`` [N m s/rad].
        friction: Joint friction.
        torque_offset: Added to the desired torque, ``(n,)`` [N m].
        torque_gain: The desired torque is multiplied by this, ``(n,)`` [-].
        actuation_delay: Delay of the desired torque [s].
        pad_stiffness: Stiffness of the whole pad face [N/m]; None: rigid.
        pad_damping: Damping of the whole pad face [N s/m].
        impact_position: Position of frame E at the nominal impact, ``(3,)`` [m].
        pad_mobility: Velocity of E along the pad's axis per impulse there, n^T J (M + B_theta)^-1 J^T n, at the joint
            guess or the given joints of the scenario [1/kg]; 0: the arm does not give way.
        loads: Further loads on links and motors.
        pad_shear_compliance: Elastic displacement of the pad along its face per friction force [m/N].
        pad_creep: Speed of creep of a sticking pad along its face, per friction force [m/(s N)].
        readings: Sensor models of the arm.
        tool_spring: Spring and damper between flange and pad; None: the tool is rigid.
        hands: End effectors of the further hands of a tree, by name.
        assumed: Assumptions in scenario and facts, in words; no part of the physics.
    """

    facts: RobotFacts
    base: pin.SE3
    end_effector: EndEffector
    motor_inertia_rotor: Array
    motor_inertia_reduced: Array
    stiffness: Array
    damping: Array
    friction: JointFriction
    torque_offset: Array
    torque_gain: Array
    actuation_delay: float
    pad_stiffness: float | None
    pad_damping: float
    impact_position: Array
    pad_mobility: float = 0.0
    loads: tuple[Load, ...] = ()
    pad_shear_compliance: float = 0.0
    pad_creep: float = 0.0
    readings: ArmReadings = EXACT
    tool_spring: ToolSpring | None = field(default=None, repr=False)  # digests of runs add it separately, if any
    hands: Mapping[str, EndEffector] = field(default_factory=dict, repr=False)  # not in digests: no run has hands
    assumed: tuple[str, ...] = field(default=(), repr=False, compare=False)

    def motor_inertia(self, model: str) -> Array:
        """Diagonal of B for ``reduced``, ``rotor`` or ``zero``, ``(n,)`` [kg m^2]."""
        return {
            "reduced": self.motor_inertia_reduced,
            "rotor": self.motor_inertia_rotor,
            "zero": np.zeros_like(self.motor_inertia_rotor),
        }[model]

    def pad_restitution(self, object_: ObjectPhysics) -> float:
        """Coefficient of restitution of a central pad impact on an object; 0 for a rigid pad [-].

        Pad and object separate when the force of spring and damper is 0
        (:mod:`impact_rs_sim.damping_of_restitution`).
        """
        critical = self._critical_damping(object_)
        return restitution_of(self.pad_damping / critical) if critical else 0.0

    def pad_damping_of(self, restitution: float, object_: ObjectPhysics) -> float:
        """Damping with which :meth:`pad_restitution` is ``restitution`` [N s/m]; 0 for a rigid pad."""
        return self._critical_damping(object_) * damping_ratio_of(restitution)

    def _critical_damping(self, object_: ObjectPhysics) -> float:
        """Critical damping of the whole face for the part that the object touches [N s/m]; 0 for a rigid pad.

        With the reduced mass m of arm and object, and the share s of stiffness and damping of the face (k, d) in
        contact, s d = 2 sqrt(s k m).
        """
        whole = 2.0 * math.sqrt((self.pad_stiffness or 0.0) / (self.pad_mobility + 1.0 / object_.mass))
        tool_share = 0.25 if self.end_effector.shape.kind == "sphere" else 1.0
        return whole / math.sqrt(min(tool_share, object_.pad_share))

    def load_torques(self, state: LoadState, jacobian: Array) -> tuple[Array, Array]:
        """Torques of all loads.

        Args:
            state: State of the arm; its arrays may have an axis of k samples in front.
            jacobian: Linear part of J(q) of frame E in E[A], ``(3, n)`` or ``(k, 3, n)``.

        Returns:
            Torque on the links and torque on the motors, ``(n,)`` or ``(k, n)`` each [N m].
        """
        on_links, on_motors = np.zeros_like(state.joint_position), np.zeros_like(state.joint_position)
        for load in self.loads:
            if jacobian.ndim == 3 and not load.vectorised:
                single = replace(self, loads=(load,))
                per_sample = [
                    single.load_torques(sample, sample_jacobian)
                    for sample, sample_jacobian in zip(state.samples, jacobian, strict=True)
                ]
                links, motors = zip(*per_sample, strict=True)
                on_links, on_motors = on_links + np.array(links), on_motors + np.array(motors)
                continue
            torque, force, motor = load.joint_torque(state), load.end_effector_force(state), load.motor_torque(state)
            if torque is not None:
                on_links += torque
            if force is not None:
                on_links += np.einsum("...an,...a->...n", jacobian, force)
            if motor is not None:
                on_motors += motor
        return on_links, on_motors


class PadOnRobot(NamedTuple):
    """A pad that hits.

    Attributes:
        arm: Name of its robot.
        hand: Name of the hand that has it; empty: the flange.
        end_effector: End effector that carries it.
    """

    arm: str
    hand: str
    end_effector: EndEffector


@dataclass(frozen=True)
class ObjectPhysics:
    """A rigid convex body, whose principal axes of inertia are its own x, y, z.

    Attributes:
        mass: Mass [kg]; infinite for a fixed object, such as a wall.
        size: Extent along its own x, y, z, ``(3,)`` [m].
        inertia: Principal moments about the centre of mass, ``(3,)`` [kg m^2]; infinite for a fixed object.
        com_offset: Centre of mass from the geometric centre, in axes of the object, ``(3,)`` [m].
        shape: Its shape.
        freedom: Twist of its centre in its own axes per velocity along its hinge or slide, ``(6, d)``; None: it is free
            or fixed.
    """

    mass: float
    size: Array
    inertia: Array
    com_offset: Array
    shape: ConvexShape = BOX
    freedom: Array | None = field(default=None, repr=False)  # digests of runs add it separately, if any

    @staticmethod
    def of(spec: ObjectSpec) -> ObjectPhysics:
        """The nominal body of an object of a scenario."""
        return ObjectPhysics(
            mass=math.inf if spec.mass is None else spec.mass,
            size=np.array(spec.size),
            inertia=spec.moments,
            com_offset=np.array(spec.com_offset),
            shape=spec.form,
            freedom=spec.freedom,
        )

    @property
    def guide(self) -> Array | None:
        """Twist of its centre in its own axes at unit speed of hinge or slide, ``(6,)``; None: it has neither."""
        return None if self.freedom is None else self.freedom[:, 0]

    def freedom_at(self, rotation: Array) -> Array | None:
        """``freedom`` in axes of A, with axes of the object ``(3, 3)``."""
        return None if self.freedom is None else np.vstack((rotation @ self.freedom[:3], rotation @ self.freedom[3:]))

    def guide_at(self, rotation: Array, lever: Array) -> Array:
        """Twist of a point of it at unit speed of its hinge or slide, axes of A, ``(6,)``.

        Args:
            rotation: Axes of the object in A, ``(3, 3)``.
            lever: The point from its centre, in A, ``(3,)`` [m].
        """
        guide = self.freedom_at(rotation)
        assert guide is not None
        velocity, axis = guide[:3, 0], guide[3:, 0]
        return np.concatenate((velocity + np.cross(axis, lever), axis))

    @property
    def guided_inertia(self) -> float:
        """S^T M S of its hinge or slide: the moment about the hinge [kg m^2], or the mass [kg]."""
        along = self.guide_at(np.eye(3), self.com_offset)
        return float(self.mass * (along[:3] @ along[:3]) + self.inertia @ np.square(along[3:]))

    def guided_speed(self, rotation: Array, twist: Array) -> float:
        """Speed that hinge or slide leaves of a twist t, (S^T M S)^-1 S^T M t (Gauss' principle) [rad/s or m/s].

        Args:
            rotation: Axes of the object in A, ``(3, 3)``.
            twist: Twist at its centre, axes of A, ``(6,)`` [m/s, rad/s].
        """
        along, spin = self.guide_at(np.eye(3), self.com_offset), rotation.T @ twist[3:]
        velocity = rotation.T @ twist[:3] + np.cross(spin, self.com_offset)
        momentum = self.mass * (along[:3] @ velocity) + along[3:] @ (self.inertia * spin)
        return float(momentum) / self.guided_inertia

    def check_free(self, consumer: str) -> None:
        """Refuse an object on a hinge or slide, because ``consumer`` takes free and fixed objects.

        Raises:
            InputError: It has a hinge or slide.
        """
        if self.freedom is not None:
            raise guided_object(consumer, "object")

    @property
    def fixed(self) -> bool:
        """Whether nothing moves it."""
        return math.isinf(self.mass)

    @property
    def pad_share(self) -> float:
        """Share of stiffness and damping of a pad's face that the object loads in a square hit [-].

        A quarter for each of up to four contact points: a ball touches at one point, a cylinder along a line at two.
        """
        return {"sphere": 0.25, "capsule": 0.5, "cylinder": 0.5}.get(self.shape.kind, 1.0)

    @property
    def round(self) -> bool:
        """Whether it is a ball, of diameter ``size``."""
        return self.shape.kind == "sphere"


def assumed_words(by_arm: Mapping[str, Sequence[str]]) -> str:
    """Assumptions about the arms (neither measured nor published) as a sentence; empty without any.

    Args:
        by_arm: Assumptions in words by name of the arm.
    """
    arms: dict[tuple[str, ...], list[str]] = {}
    for name, assumed in by_arm.items():
        if assumed:
            arms.setdefault(tuple(assumed), []).append(name)
    texts = [f"of {' and '.join(names)} {', '.join(assumed)}" for assumed, names in arms.items()]
    return f"assumed, neither measured nor published: {'; '.join(texts)}" if texts else ""


@dataclass(frozen=True)
class Neighbour:
    """A free object beside the object that is hit first.

    Attributes:
        name: Its name.
        body: The rigid body.
        position: From the middle of the object that is hit first, in its axes, ``(3,)`` [m].
        rotation: Its axes there, ``(3, 3)``.
    """

    name: str
    body: ObjectPhysics
    position: Array
    rotation: Array


@dataclass(frozen=True)
class Physics:
    """Physical parameters of one scene.

    Attributes:
        arms: Arms by name.
        object: The manipulated object.
        support_height: Height of the support's surface [m]; None: no support, for a fixed or guided object.
        support_size: Extent of the support along x and y [m].
        support_friction: Friction between object and support [-].
        pad_friction: Friction between pad and object [-].
        restitution: Restitution of the rigid impact map [-].
        bounce: Newton restitution of a single impact beyond ``restitution`` [-]. Under a constant push, a series of
            bounces has the same end as one inelastic impact, so the map of a whole push uses ``restitution`` only; the
            map of a single measured impact (:mod:`impact_rs_sim.impact_map.measured`) uses the sum.
        gravity: Acceleration of gravity in A, ``(3,)`` [m/s^2].
        support_compliance: Displacement of the support per additional load [m/N]; 0: rigid. ``support_height`` is the
            height of its surface under the weight of the object.
        rolling_arm: Largest moment that resists rolling over the normal force: |M| <= rolling_arm N [m].
        restitution_law: Law of restitution of the rigid impact map, ``newton`` or ``poisson``.
        contact_laws: Further laws of the contact points of a single measured impact, in order.
        object_loads: Further loads on the object, and between object and support.
        circumstances: Circumstances of the measurement, numbers or names of levels by covariate; an effect may depend
            on them (:mod:`impact_rs_sim.effects.depending`).
        twist_readings: Sensor model of the twist of a body at a single impact.
        tracker: Sensor model of the object tracker.
        neighbours: Further objects that the first one hits, with their poses beside it before the first impact.
        object_friction: Friction between objects [-].
    """

    arms: dict[str, ArmPhysics]
    object: ObjectPhysics
    support_height: float | None
    support_size: tuple[float, float]
    support_friction: float
    pad_friction: float
    restitution: float
    gravity: Array = field(default_factory=lambda: np.array(STANDARD_GRAVITY))
    bounce: float = 0.0
    support_compliance: float = 0.0
    rolling_arm: float = 0.0
    restitution_law: str = "newton"
    contact_laws: tuple[ContactLaw, ...] = ()
    object_loads: tuple[ObjectLoad, ...] = ()
    circumstances: Mapping[str, float | str] = field(default_factory=dict)
    twist_readings: TwistReadings = TwistReadings()
    tracker: TrackerReadings = TrackerReadings()
    neighbours: tuple[Neighbour, ...] = ()
    object_friction: float = 0.0

    @staticmethod
    def nominal(scenario: Scenario, object_name: str) -> Physics:
        """Nominal physics of a scenario, for one of its objects.

        Raises:
            InputError: The scenario has no such object.
        """
        spec = scenario.object(object_name)
        arms = {}
        for name, robot in scenario.robots.items():
            facts, drive, pad = robot.robot_facts, robot.drive, robot.end_effector.pad
            if robot.reflexes is not None:
                facts = facts.model_copy(update={"reflexes": robot.reflexes})
            friction = JointFriction.none(facts.joint_types)
            if drive.friction == "identified":
                friction = replace(friction, sigmoid=facts.friction)
            effector, base = robot.end_effector.build(), robot.base.placement
            hands = {hand: hand_spec.end_effector.build() for hand, hand_spec in robot.hands.items()}
            joint_position = robot.impact.joint_position
            model = RobotModel(facts, effector, base, hands=hands)
            pose = model.position_of(np.array(robot.impact.joint_guess if joint_position is None else joint_position))
            arms[name] = ArmPhysics(
                facts=facts,
                base=base,
                end_effector=effector,
                motor_inertia_rotor=np.array(drive.motor_inertia_rotor),
                motor_inertia_reduced=np.array(drive.reflected_inertia),
                stiffness=np.array(drive.stiffness),
                damping=np.array(drive.damping),
                friction=friction,
                torque_offset=np.zeros(facts.joint_count),
                torque_gain=np.ones(facts.joint_count),
                actuation_delay=drive.actuation_delay,
                pad_stiffness=pad.stiffness,
                pad_damping=pad.damping,
                tool_spring=robot.end_effector.tool_spring,
                impact_position=scenario.impact_placement(name, object_name).translation,
                pad_mobility=model.mobility(
                    pose, model.placement(pose).rotation[:, 2], np.array(drive.reflected_inertia)
                ),
                hands=hands,
                assumed=robot.assumed,
            )
        return Physics(
            arms=arms,
            object=ObjectPhysics.of(spec),
            support_height=None if spec.fixed or spec.freedom is not None else scenario.support.height,
            support_size=scenario.support.size,
            support_friction=scenario.support.friction,
            pad_friction=scenario.contact.friction,
            restitution=scenario.contact.restitution,
            restitution_law=scenario.contact.restitution_law,
            gravity=np.array(scenario.gravity),
            neighbours=tuple(
                Neighbour(name, ObjectPhysics.of(other), spec.rotation.T @ shift, spec.rotation.T @ other.rotation)
                for (name, other), shift in zip(
                    scenario.neighbours.items(), scenario.neighbour_shifts(object_name), strict=True
                )
            ),
            object_friction=scenario.contact.object_friction if scenario.neighbours else 0.0,
        )

    def friction_of(self, partner: str) -> float:
        """Coulomb coefficient between an object and an arm's pad, the support (``support``) or an earlier object."""
        if partner == "support":
            return self.support_friction
        return self.object_friction if partner in self.bodies else self.pad_friction

    @property
    def pads(self) -> dict[str, PadOnRobot]:
        """All pads by name: that of the arm, then those of its further hands."""
        return {
            hand or name: PadOnRobot(name, hand, tool)
            for name, arm in self.arms.items()
            for hand, tool in {"": arm.end_effector, **arm.hands}.items()
        }

    @property
    def bodies(self) -> dict[str, ObjectPhysics]:
        """The object, called ``object``, and its neighbours, by name."""
        return {"object": self.object, **{neighbour.name: neighbour.body for neighbour in self.neighbours}}

    @property
    def moved_mass(self) -> float:
        """Mass of the object and its neighbours [kg]."""
        return self.object.mass + sum(neighbour.body.mass for neighbour in self.neighbours)

    @property
    def assumed(self) -> str:
        """Assumptions about the arms as a sentence; empty without any."""
        return assumed_words({name: arm.assumed for name, arm in self.arms.items()})

    @property
    def arm_joints(self) -> tuple[tuple[str, tuple[JointType, ...]], ...]:
        """Names of the arms, each with its joint types, base to tip."""
        return tuple((name, arm.facts.joint_types) for name, arm in self.arms.items())

    @property
    def joints(self) -> tuple[JointType, ...]:
        """Joint types that all arms share, base to tip; empty without an arm.

        Raises:
            InputError: The arms have unequal numbers of joints, or joints that move otherwise.
        """
        kinds = dict(self.arm_joints)
        if len({len(kind) for kind in kinds.values()}) > 1:
            text = ", ".join(f"{name} {len(kind)}" for name, kind in kinds.items())
            raise InputError(
                f"arms with one number of joints are expected where they share a parameter per joint, found: {text}"
            )
        if len(set(kinds.values())) > 1:
            text = "; ".join(f"{name} {', '.join(kind)}" for name, kind in kinds.items())
            raise InputError(f"arms whose joints turn and slide alike are expected, found: {text}")
        return next(iter(kinds.values()), ())

    @property
    def joint_count(self) -> int:
        """Number of joints of an arm; 0 where there is no arm.

        Raises:
            InputError: As :attr:`joints`.
        """
        return len(self.joints)

    def description(self, meshes: bool = True) -> str:
        """URDF of the mounted arms beside the support (:func:`impact_rs_sim.robots.urdf.write_description`).

        Args:
            meshes: Show the meshes of arms that have some; else simple shapes.
        """
        arms = {name: (arm.facts, arm.end_effector, arm.base) for name, arm in self.arms.items()}
        support = None if self.support_height is None else (self.support_height, self.support_size)
        return write_description(arms, support, meshes)

    def robot_model(self, arm: str) -> RobotModel:
        """Rigid-body model of one arm under these physics."""
        physics = self.arms[arm]
        return RobotModel(physics.facts, physics.end_effector, physics.base, self.gravity, physics.hands)

    def robot_models(self) -> dict[str, RobotModel]:
        """Rigid-body models of all arms, by name."""
        return {name: self.robot_model(name) for name in self.arms}

    def load_torques(
        self,
        arm: str,
        model: RobotModel,
        time: float,
        position: Array,
        velocity: Array,
        torque: Array | None = None,
        scene: Mapping[str, float] | None = None,
        memory: Memory | None = None,
    ) -> tuple[Array, Array]:
        """Torques of the loads of one arm.

        Args:
            arm: Name of the arm.
            model: Its rigid-body model.
            time: Time since the start of the trial [s].
            position: q, ``(n,)`` [rad].
            velocity: dq, ``(n,)`` [rad/s].
            torque: tau_J, ``(n,)`` [N m]; None: not known.
            scene: Symbols of object and contact; None: there is neither.
            memory: Memory of its loads in this simulation; None: a single state.

        Returns:
            Torque on the links and torque on the motors, ``(n,)`` each [N m].
        """
        jacobian = model.jacobian(position)[:3]
        state = LoadState(
            time=time,
            joint_position=position,
            joint_velocity=velocity,
            position=model.placement(position).translation,
            velocity=jacobian @ velocity,
            impact_position=self.arms[arm].impact_position,
            joint_torque=torque,
            scene=scene or {},
            memory=memory,
        )
        return self.arms[arm].load_torques(state, jacobian)
