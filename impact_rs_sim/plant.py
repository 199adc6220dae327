# SPDX-License-Identifier: Apache-2.0
"""The simulated plant: Bullet for links and contacts, a drive per arm, and sensors.

Every control period the caller reads :meth:`Plant.measure`, decides on torques and calls :meth:`Plant.step`, which
runs the torque loop and Bullet at the drive's period. The truth is for recording under ``/truth`` and for
tests; no controller and no analyzer sees it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.bullet_world import BulletWorld
from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.mechanics import Mechanics
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import Scatter, Scenario
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.sensors import ArmMeasurement, ArmSensors, ObjectMeasurement, ObjectTracker


@dataclass(frozen=True)
class Measurement:
    """Measurements of a real robot cell at one control tick.

    Attributes:
        time: Time since the start of the trial [s].
        arms: Measured arms by name.
        object: A new sample of the object tracker, or None between samples.
    """

    time: float
    arms: dict[str, ArmMeasurement]
    object: ObjectMeasurement | None


@dataclass(frozen=True)
class ArmTruth:
    """True state of one arm; see :class:`~impact_rs_sim.sensors.ArmMeasurement` for the entries."""

    position: Array
    velocity: Array
    torque: Array
    motor_position: Array
    motor_velocity: Array
    pad_force: Array


@dataclass(frozen=True)
class Truth:
    """True state of the plant at one control tick.

    Attributes:
        time: Time since the start of the trial [s].
        arms: Arms by name.
        object: The object whenever the tracker takes a sample, or None between samples.
    """

    time: float
    arms: dict[str, ArmTruth]
    object: BodyState | None


class PlantExtension:
    """Behaviour of a plant outside :class:`Physics`; subclasses override what they need.

    For tests of the diagnosis: what it must not find in its library has to live somewhere.
    """

    def begin(self, plant: Plant) -> None:
        """Called once, when the plant is ready."""

    def joint_torque(self, plant: Plant, arm: str) -> Array | None:
        """Further torque on the links over the next control period, ``(n,)`` [N m], or None."""
        return None

    def after_sense(self, plant: Plant, arm: str, drive: Drive) -> None:
        """Called in every period of the torque loop, after the drive has sensed the link."""


class Plant:
    """Flexible-joint arms, object and support, for one trial; :meth:`for_trial` puts one together.

    Args:
        scenario: Times and sensors.
        mechanics: Arms and object, in place.
        sensors: Sensors by arm.
        tracker: Tracker of the object.
        extension: Behaviour outside the physics.
    """

    def __init__(
        self,
        scenario: Scenario,
        mechanics: Mechanics,
        sensors: dict[str, ArmSensors],
        tracker: ObjectTracker,
        extension: PlantExtension | None = None,
    ) -> None:
        self.physics = mechanics.physics
        self._mechanics = mechanics
        self._timing = scenario.timing
        self._substeps = scenario.timing.substeps
        self._samples = scenario.timing.ticks + 1
        self._tick = 0
        self._arm_sensors = sensors
        self._tracker = tracker
        self._tracker_ticks = _tracker_ticks(scenario)
        self._extension = extension

    @classmethod
    def for_trial(
        cls,
        scenario: Scenario,
        physics: Physics,
        initial: dict[str, Array],
        object_state: BodyState,
        seed: int,
        extension: PlantExtension | None = None,
    ) -> Plant:
        """The plant of one trial, at rest where the trial starts.

        Args:
            scenario: Times, sensors and scatter.
            physics: The true physics, possibly with effects hidden from the model.
            initial: Initial joint positions by arm, ``(n,)`` [rad].
            object_state: Nominal pose of the object; the scatter comes on top.
            seed: Seed of scatter and noise. Same seed, same trial, bit by bit.
            extension: Behaviour outside the physics.

        Raises:
            NotABody: Mass and inertia of an end effector are those of no body.
        """
        timing, samples = scenario.timing, scenario.timing.ticks + 1
        scatter_seed, tracker_seed, *arm_seeds = np.random.SeedSequence(seed).spawn(2 + len(physics.arms))
        physics, initial, object_state = _scatter(
            scenario.scatter, physics, initial, object_state, np.random.default_rng(scatter_seed)
        )
        mechanics = Mechanics.load(physics, timing.drive_period)
        still = {name: np.zeros_like(q) for name, q in initial.items()}
        carried = {name: physics.robot_model(name).gravity_torque(q) for name, q in initial.items()}
        mechanics.start(
            {name: ArmState(q, still[name]) for name, q in initial.items()},
            {name: DriveStart(carried[name], still[name]) for name in initial},
            object_state,
            may_sleep=extension is None,
        )
        sensors = {
            name: ArmSensors(scenario.sensors, initial[name].size, samples, np.random.default_rng(arm_seed))
            for name, arm_seed in zip(physics.arms, arm_seeds, strict=True)
        }
        tracked = samples // _tracker_ticks(scenario) + 1
        tracker = ObjectTracker(scenario.sensors, tracked, np.random.default_rng(tracker_seed))
        plant = cls(scenario, mechanics, sensors, tracker, extension)
        if extension is not None:
            extension.begin(plant)
        return plant

    @property
    def world(self) -> BulletWorld:
        """The Bullet world, for extensions."""
        return self._mechanics.world

    def link_state(self, arm: str) -> ArmState:
        """True joint state of an arm, for extensions."""
        return self._mechanics.links[arm]

    @property
    def time(self) -> float:
        """Time since the start of the trial [s]."""
        return self._tick * self._timing.control_period

    @property
    def _tracked(self) -> bool:
        return self._tick % self._tracker_ticks == 0

    def measure(self) -> Measurement:
        """Present sensor values; a second call returns the same."""
        arms = {}
        for name, drive in self._mechanics.drives.items():
            link = self._mechanics.links[name]
            arms[name] = self._arm_sensors[name].measure(
                self._tick,
                link.position,
                link.velocity,
                drive.elastic_torque,
                drive.position,
                drive.velocity,
            )
        tracked = None
        if self._tracked:
            state = self.world.object_state()
            sample = self._tick // self._tracker_ticks
            tracked = self._tracker.measure(sample, self.time, state.position, state.rotation)
        return Measurement(self.time, arms, tracked)

    def truth(self) -> Truth:
        """The true state now."""
        arms = {}
        for name, drive in self._mechanics.drives.items():
            link = self._mechanics.links[name]
            arms[name] = ArmTruth(
                link.position,
                link.velocity,
                drive.elastic_torque,
                drive.position,
                drive.velocity,
                self.world.pad_force(name),
            )
        return Truth(self.time, arms, self.world.object_state() if self._tracked else None)

    def step(self, desired: dict[str, Array]) -> None:
        """Advance by one control period with desired torques ``(n,)`` [N m] by arm.

        Raises:
            InputError: A torque is not finite or has the wrong length.
        """
        for name, link in self._mechanics.links.items():
            torque = desired[name]
            # A sum of squares keeps every value that is not finite.
            if torque.shape != link.position.shape or not math.isfinite(torque @ torque):
                raise InputError(
                    f"desired torque of arm {name!r} must be {link.position.size} finite numbers [N m], "
                    f"got {torque.tolist()}"
                )
        if self._tick + 1 >= self._samples:
            raise InputError(f"the trial is over after {self._timing.duration} s")
        held = {name: [desired[name]] * self._substeps for name in self.physics.arms}
        extension = self._extension
        if extension is None:
            self._mechanics.step(held, self.time)
        else:
            further = {name: extension.joint_torque(self, name) for name in held}
            self._mechanics.step(
                held,
                self.time,
                {name: torque for name, torque in further.items() if torque is not None},
                self._extend_drive,
            )
        self._tick += 1

    def _extend_drive(self, name: str) -> None:
        drive = self._mechanics.drives[name]
        assert self._extension is not None and isinstance(drive, Drive)
        self._extension.after_sense(self, name, drive)

    def close(self) -> None:
        """Free the Bullet world."""
        self._mechanics.close()


def _tracker_ticks(scenario: Scenario) -> int:
    """Control ticks from one sample of the object tracker to the next."""
    return max(1, round(scenario.sensors.object_period / scenario.timing.control_period))


def _scatter(
    scatter: Scatter,
    physics: Physics,
    initial: dict[str, Array],
    object_state: BodyState,
    rng: np.random.Generator,
) -> tuple[Physics, dict[str, Array], BodyState]:
    """Scatter from trial to trial; the object stays on its support."""
    shift = scatter.object_position * rng.standard_normal(2)
    yaw = scatter.object_yaw * rng.standard_normal()
    friction = physics.support_friction * (1.0 + scatter.support_friction * rng.standard_normal())
    moved = replace(
        object_state,
        position=object_state.position + np.append(shift, 0.0),
        rotation=object_state.rotation @ pin.rpy.rpyToMatrix(0.0, 0.0, yaw),
    )
    started = {name: q + scatter.joint_position * rng.standard_normal(q.size) for name, q in initial.items()}
    return replace(physics, support_friction=max(0.0, friction)), started, moved
