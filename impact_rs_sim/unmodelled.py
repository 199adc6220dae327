# SPDX-License-Identifier: Apache-2.0
"""Effects that are *not* in the library: the diagnosis must report that no effect of the library explains them.

Each acts inside the plant and is parametrised by a magnitude (1: noticeable) and the number of the repeat.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from impact_rs_sim.bullet_world import pybullet
from impact_rs_sim.drive import Drive
from impact_rs_sim.plant import Plant, PlantExtension
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel


class LooseContents(PlantExtension):
    """A slab that slides on top of the object: part of its mass moves with a delay."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._share = min(0.2 * magnitude, 0.8)
        self._friction = 0.15

    def begin(self, plant: Plant) -> None:
        """Put the slab on the object, and take its mass off the object."""
        world, object_ = plant.world, plant.physics.object
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
    """The base gives way along y like a table on legs, 60 kg over the magnitude at 4 Hz, and shakes the arm."""

    def __init__(self, magnitude: float, repeat: int) -> None:
        self._mass, self._frequency, self._ratio = 60.0, 2.0 * np.pi * 4.0, 0.03
        self._gain = magnitude
        self._position = self._velocity = 0.0
        self._momentum: float | None = None
        self._model: RobotModel | None = None

    def joint_torque(self, plant: Plant, arm: str) -> Array | None:
        """Inertial torque -J^T m a of the shaking base: the gravity torque of the model for the gravity a."""
        if self._model is None:
            self._model = RobotModel(
                plant.physics.arms[arm].facts, plant.physics.arms[arm].end_effector, plant.physics.arms[arm].base
            )
        model, q = self._model, plant.link_state(arm).position
        period = 0.001
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
