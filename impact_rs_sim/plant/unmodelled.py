# SPDX-License-Identifier: Apache-2.0
"""Effects that are *not* in the library: the diagnosis must report that no effect of the library explains them.

Each acts inside the plant, with a magnitude (1: noticeable) and the number of the repeat as parameters.
:data:`OUTSIDE` has whole mechanisms; :data:`LAWS` has forces as functions of the state, which ``impact-rs discover``
may find.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.drive import Drive
from impact_rs_sim.plant.bullet_world import pybullet
from impact_rs_sim.plant.plant import Plant, PlantExtension
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel


class LooseContents(PlantExtension):
    """Slab sliding on top of the object: part of its mass moves with a delay."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._share = min(0.2 * magnitude, 0.8)
        self._friction = 0.15

    def begin(self, plant: Plant) -> None:
        """Put the slab on the object, and take its mass off the object."""
        world, object_ = plant.world, plant.physics.object
        object_.check_free("loose contents")
        client, state = world.client, plant.world.object_state()
        mass = self._share * object_.mass
        client.changeDynamics(world.object, -1, mass=object_.mass - mass)
        client.changeDynamics(world.object, -1, localInertiaDiagonal=(object_.inertia * (1.0 - self._share)).tolist())
        half = [0.35 * object_.size[0], 0.35 * object_.size[1], 0.01]
        shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
        top = state.position + np.array([0.0, 0.0, object_.size[2] / 2.0 + half[2]])
        slab = client.createMultiBody(mass, shape, basePosition=top.tolist())
        client.changeDynamics(slab, -1, linearDamping=0.0, angularDamping=0.0)
        client.changeDynamics(slab, -1, lateralFriction=self._friction)
        for arm in world.arms.values():
            for link in range(-1, client.getNumJoints(arm)):
                client.setCollisionFilterPair(arm, slab, link, -1, 0)


class FlexibleBase(PlantExtension):
    """The base of every arm gives way along y like a table on legs, 60 kg over the magnitude at 4 Hz, and shakes it."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._gain = magnitude
        self._bases: dict[str, _Base] = {}

    def joint_torque(self, plant: Plant, arm: str) -> Array | None:
        """Inertial torque -J^T m a of the shaking base."""
        if arm not in self._bases:
            self._bases[arm] = _Base(self._gain, plant.physics.robot_model(arm))
        return self._bases[arm].torque(plant, arm)


class _Base:
    """The flexible base of one arm."""

    def __init__(self, gain: float, model: RobotModel) -> None:
        self._mass, self._frequency, self._ratio = 60.0, 2.0 * np.pi * 4.0, 0.03
        self._gain, self._model = gain, model
        self._position = self._velocity = 0.0
        self._momentum: float | None = None

    def torque(self, plant: Plant, arm: str) -> Array:
        """Move the base by one period; the torque is the gravity torque of the model for the gravity a."""
        model, q, period = self._model, plant.link_state(arm).position, plant.control_period
        push = float(plant.world.pad_force(arm)[1])
        # The arm's own acceleration drives the base as well: its momentum along y, by the centre-of-mass Jacobian.
        pin.centerOfMass(model.pinocchio, model.data, q, plant.link_state(arm).velocity)
        momentum = float(model.data.mass[0] * model.data.vcom[0][1])
        before = momentum if self._momentum is None else self._momentum
        force = self._gain * (push - (momentum - before) / period)
        self._momentum = momentum
        acceleration = (
            force / self._mass
            - 2.0 * self._ratio * self._frequency * self._velocity
            - self._frequency**2 * self._position
        )
        self._velocity += period * acceleration
        self._position += period * self._velocity
        model.pinocchio.gravity.linear = np.array([0.0, acceleration, 0.0])
        return np.array(pin.computeGeneralizedGravity(model.pinocchio, model.data, q))


class DriftingFriction(PlantExtension):
    """Coulomb friction on the link side that grows within a trial and from repeat to repeat."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._level = 0.3 * magnitude
        self._repeat = repeat

    def joint_torque(self, plant: Plant, arm: str) -> Array | None:
        """Friction against the link's motion."""
        level = self._level * (0.2 + plant.time + 0.5 * self._repeat)
        return np.asarray(-level * np.tanh(plant.link_state(arm).velocity / 0.03))


class Backlash(PlantExtension):
    """Play in the transmission: no torque within a dead zone around the unloaded spring."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._play = 3e-4 * magnitude  # rad

    def after_sense(self, plant: Plant, arm: str, drive: Drive) -> None:
        """Apply the dead zone to the elastic torque."""
        stiffness = plant.physics.arms[arm].stiffness
        stretch = drive.elastic_torque / stiffness
        passed = np.sign(stretch) * np.maximum(np.abs(stretch) - self._play, 0.0)
        drive.transmission_torque = drive.transmission_torque + stiffness * (passed - stretch)
        drive.elastic_torque = stiffness * passed


class LubricatedSupport(PlantExtension):
    """The support's friction grows with the speed of the object's sliding, as on a film of oil or water."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._slope = 0.5 * magnitude  # s/m, of the friction coefficient over its value at rest

    def joint_torque(self, plant: Plant, arm: str) -> Array | None:
        """Set the friction of the support for the next period; no torque on the links."""
        speed = float(np.linalg.norm(plant.world.object_state().twist[:2]))
        plant.world.set_support_friction(plant.physics.support_friction * (1.0 + self._slope * speed))
        return None


class TorqueRipple(PlantExtension):
    """Torque of the motors that is periodic in their angle, as from cogging and harmonic drives."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._amplitude = 0.1 * magnitude  # N m
        self._periods = 60.0  # along one turn of the joint

    def joint_torque(self, plant: Plant, arm: str) -> Array | None:
        """Torque on the links; the angle of the motors is that of the links, up to the springs."""
        return np.asarray(self._amplitude * np.sin(self._periods * plant.link_state(arm).position))


OUTSIDE: dict[str, Callable[[float, int], PlantExtension]] = {
    "loose_contents": LooseContents,
    "flexible_base": FlexibleBase,
    "drifting_friction": DriftingFriction,
    "backlash": Backlash,
    "lubricated_support": LubricatedSupport,
    "torque_ripple": TorqueRipple,
}


@dataclass(frozen=True)
class State:
    """Arguments of a hidden law.

    Attributes:
        t: Time since the start of the trial [s].
        q: Joint position, ``(n,)`` [rad].
        dq: Joint velocity, ``(n,)`` [rad/s].
        tau: Transmitted torque, ``(n,)`` [N m].
        x: Origin of frame E, ``(3,)`` [m].
        v: Its velocity, ``(3,)`` [m/s].
        object_x: Middle of the object, ``(3,)`` [m].
        object_v: Its velocity, ``(3,)`` [m/s].
        support_force: Weight of the object [N].
        since: Time since a pad first touched the object, 0 before [s].
    """

    t: float
    q: Array
    dq: Array
    tau: Array
    x: Array
    v: Array
    object_x: Array
    object_v: Array
    support_force: float
    since: float


class HiddenLaw(PlantExtension):
    """A force or torque as a function of the state, evaluated in every period of the torque loop.

    Args:
        acts_on: ``motor``, ``link``, ``end_effector`` or ``object``.
        law: Torques on the joints ``(n,)`` [N m], or force ``(3,)`` at E or at the middle of the object [N].
    """

    def __init__(self, acts_on: str, law: Callable[[State], Array]) -> None:
        self._acts_on, self._law = acts_on, law
        self._touched: float | None = None
        self._models: dict[str, RobotModel] = {}

    def begin(self, plant: Plant) -> None:
        """Keep the rigid-body models."""
        self._models = plant.physics.robot_models()

    def state(self, plant: Plant, arm: str) -> State:
        """The state of the plant."""
        link, model, body = plant.link_state(arm), self._models[arm], plant.world.object_state()
        if self._touched is None and any(np.any(plant.world.pad_force(name)) for name in self._models):
            self._touched = plant.time
        return State(
            t=plant.time,
            q=link.position,
            dq=link.velocity,
            tau=plant.bullet.drives[arm].elastic_torque,
            x=model.placement(link.position).translation,
            v=model.jacobian(link.position)[:3] @ link.velocity,
            object_x=body.position,
            object_v=body.twist[:3],
            support_force=-float(plant.physics.gravity[2]) * plant.physics.object.mass,
            since=0.0 if self._touched is None else plant.time - self._touched,
        )

    def joint_torque(self, plant: Plant, arm: str) -> Array | None:
        """Torque on the links over the next control period; None if the law acts on the motors or the object."""
        if self._acts_on == "object":
            if plant.time == 0.0:  # later forces are set at the end of every period, by after_sense
                self._on_object(plant, arm)
            return None
        state = self.state(plant, arm)
        load = self._law(state)
        if self._acts_on == "motor":
            plant.bullet.drives[arm].load(load)
            return None
        if self._acts_on == "link":
            return load
        return np.asarray(self._models[arm].jacobian(state.q)[:3].T @ load)

    def after_sense(self, plant: Plant, arm: str, drive: Drive) -> None:
        """Force on the object over the next period of the torque loop."""
        if self._acts_on == "object":
            self._on_object(plant, arm)

    def _on_object(self, plant: Plant, arm: str) -> None:
        if plant.free_motion or arm != next(iter(self._models)):  # the hooks are called for every arm
            return
        state = self.state(plant, arm)
        plant.world.push(None, state.object_x, self._law(state))


def _joint(acts_on: str, number: int, law: Callable[[State, float], float]) -> Callable[[float, int], PlantExtension]:
    """A law of one joint, counted from 1, with the magnitude as its second argument."""

    def make(magnitude: float, repeat: int) -> PlantExtension:
        del repeat

        def torques(state: State) -> Array:
            vector = np.zeros_like(state.q)
            vector[number - 1] = law(state, magnitude)
            return vector

        return HiddenLaw(acts_on, torques)

    return make


def _at(acts_on: str, law: Callable[[State, float], Array]) -> Callable[[float, int], PlantExtension]:
    """A law of a force, with the magnitude as its second argument."""
    return lambda magnitude, repeat: HiddenLaw(acts_on, lambda state: law(state, magnitude))


def _beyond(value: float, limit: float) -> float:
    return max(value - limit, 0.0)


def _along(axis: int, value: float) -> Array:
    vector = np.zeros(3)
    vector[axis] = value
    return vector


def _horizontal(velocity: Array) -> Array:
    return velocity * [1.0, 1.0, 0.0]


LAWS: dict[str, Callable[[float, int], PlantExtension]] = {
    "object_quadratic_drag": _at("object", lambda s, m: -2.0 * m * np.linalg.norm(s.object_v) * s.object_v),
    "object_cubic_drag": _at("object", lambda s, m: -3.0 * m * float(s.object_v @ s.object_v) * s.object_v),
    "object_linear_drag": _at("object", lambda s, m: -1.0 * m * _horizontal(s.object_v)),
    "object_spring_from_place": _at("object", lambda s, m: _along(1, m * _beyond(-s.object_x[1] - 0.25, 0.0))),
    "object_growing_force": _at("object", lambda s, m: _along(1, 1.5 * m * s.since)),
    "motor4_ripple": _joint("motor", 4, lambda s, m: 0.1 * m * np.sin(6.0 * s.q[3])),
    "motor2_ripple": _joint("motor", 2, lambda s, m: 0.1 * m * np.sin(20.0 * s.q[1])),
    "motor1_quadratic": _joint("motor", 1, lambda s, m: -0.5 * m * abs(s.dq[0]) * s.dq[0]),
    "motor4_cubic": _joint("motor", 4, lambda s, m: -0.8 * m * s.dq[3] ** 3),
    "motor2_load_friction": _joint("motor", 2, lambda s, m: -0.01 * m * abs(s.tau[1]) * np.tanh(s.dq[1] / 0.02)),
    "motor4_warm_up": _joint("motor", 4, lambda s, m: -0.15 * m * s.t * np.tanh(s.dq[3] / 0.02)),
    "motor2_gravity_like": _joint("motor", 2, lambda s, m: 0.15 * m * np.cos(s.q[1])),
    "motor6_one_way": _joint("motor", 6, lambda s, m: -0.3 * m * _beyond(s.dq[5], 0.0)),
    "motor4_stop": _joint("motor", 4, lambda s, m: -2.0 * m * _beyond(s.q[3] + 2.2, 0.0)),
    "end_effector_quadratic_drag": _at("end_effector", lambda s, m: -2.0 * m * np.linalg.norm(s.v) * s.v),
    "end_effector_cable": _at("end_effector", lambda s, m: _along(1, 6.0 * m * _beyond(-s.x[1] - 0.1, 0.0))),
    "link3_cubic_spring": _joint("link", 3, lambda s, m: -1.0 * m * (s.q[2] - 0.5) ** 3),
}
