# SPDX-License-Identifier: Apache-2.0
"""The simulated plant: mechanics of one of two simulators, and sensors.

Every control period the caller reads :meth:`Plant.measure`, decides on torques and calls :meth:`Plant.step`, which
runs torque loop, links and contacts at the drive's period. The truth is for recording under ``/truth`` and for
tests; no controller and no analyzer sees it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import numpy as np
import pinocchio as pin

from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.plant.mechanics import Mechanics, Simulator
from impact_rs_sim.plant.sensors import ArmMeasurement, ArmSensors, ObjectMeasurement, ObjectTracker
from impact_rs_sim.plant.twin_mechanics import TwinMechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.trial_settings import Scatter
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState

Tracked = TypeVar("Tracked", ObjectMeasurement, BodyState)

SIMULATORS: Final[dict[Simulator, type[Mechanics]]] = {"bullet": BulletMechanics, "twin": TwinMechanics}


@dataclass(frozen=True)
class Measurement:
    """Measurements of a real robot cell at one control tick.

    Attributes:
        time: Time since the start of the trial [s].
        arms: Measured arms by name.
        object: A new sample of the object tracker, or None between samples.
        neighbours: New samples of the neighbours by name; empty between samples.
    """

    time: float
    arms: dict[str, ArmMeasurement]
    object: ObjectMeasurement | None
    neighbours: dict[str, ObjectMeasurement] = field(default_factory=dict)


@dataclass(frozen=True)
class ArmTruth(ArmMotion):
    """True state of one arm.

    Attributes:
        pad_force: Force of the object on its pad, in A, ``(3,)`` [N].
    """

    pad_force: Array


@dataclass(frozen=True)
class Truth:
    """True state of the plant at one control tick.

    Attributes:
        time: Time since the start of the trial [s].
        arms: Arms by name.
        object: State of the object when the tracker takes a sample; None between samples.
        neighbours: States of the neighbours by name when their trackers take a sample; empty between samples.
    """

    time: float
    arms: dict[str, ArmTruth]
    object: BodyState | None
    neighbours: dict[str, BodyState] = field(default_factory=dict)


class PlantExtension:
    """Hooks for behaviour of a Bullet plant that :class:`Physics` cannot express; subclasses override what they need.

    For tests of the diagnosis with mechanisms that its library lacks.
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
        trackers: Tracker of the object, then of its neighbours.
        extension: Behaviour that the physics cannot express.

    Attributes:
        free_motion: Whether the arms move without contact; the object then stands out of reach.
    """

    def __init__(
        self,
        scenario: Scenario,
        mechanics: Mechanics,
        sensors: dict[str, ArmSensors],
        trackers: Sequence[ObjectTracker],
        extension: PlantExtension | None = None,
    ) -> None:
        self.physics = mechanics.physics
        self._mechanics = mechanics
        self.free_motion = scenario.excursion is not None
        self._timing = scenario.timing
        self._substeps = scenario.timing.substeps
        self._samples = scenario.timing.ticks + 1
        self._tick = 0
        self._arm_sensors = sensors
        self._trackers = tuple(trackers)
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
        simulator: Simulator = "bullet",
    ) -> Plant:
        """The plant of one trial, at rest where the trial starts.

        Args:
            scenario: Times, sensors and scatter.
            physics: The true physics, possibly with effects hidden from the model.
            initial: Initial joint positions by arm, ``(n,)`` [rad].
            object_state: Nominal pose of the object; the scatter comes on top.
            seed: Seed of scatter and noise. Same seed, same trial, bit by bit.
            extension: Behaviour that the physics cannot express, in Bullet only.
            simulator: Simulator of the mechanics.

        Raises:
            NotABody: Mass and inertia of an end effector are physically inconsistent.
            InputError: There is an extension, but the simulator is not Bullet.
        """
        timing, samples = scenario.timing, scenario.timing.ticks + 1
        bodies, arms = 1 + len(physics.neighbours), len(physics.arms)
        scatter_seed, first, *seeds = np.random.SeedSequence(seed).spawn(1 + arms + bodies)
        arm_seeds, tracker_seeds = seeds[:arms], [first, *seeds[arms:]]
        physics, initial, object_state = _scatter(
            scenario.scatter, physics, initial, object_state, np.random.default_rng(scatter_seed)
        )
        if extension is None:
            mechanics = SIMULATORS[simulator].load(physics, timing.drive_period)
        elif simulator == "bullet":
            mechanics = BulletMechanics.load(physics, timing.drive_period, may_sleep=False)
        else:
            raise InputError(f"an extension acts in the plant 'bullet' only, not in {simulator!r}")
        at_rest = {name: np.zeros_like(q) for name, q in initial.items()}
        gravity_torques = {name: physics.robot_model(name).gravity_torque(q) for name, q in initial.items()}
        mechanics.start(
            {name: ArmState(q, at_rest[name]) for name, q in initial.items()},
            {name: DriveStart(gravity_torques[name], at_rest[name]) for name in initial},
            object_state,
        )
        sensors = {
            name: ArmSensors(
                scenario.sensors,
                initial[name].size,
                samples,
                np.random.default_rng(arm_seed),
                physics.arms[name].readings,
                timing.control_period,
            )
            for name, arm_seed in zip(physics.arms, arm_seeds, strict=True)
        }
        samples_tracked = samples // _tracker_ticks(scenario) + 1
        trackers = [
            ObjectTracker(
                scenario.sensors,
                samples_tracked,
                np.random.default_rng(tracker_seed),
                physics.tracker,
                _tracker_ticks(scenario) * timing.control_period,
            )
            for tracker_seed in tracker_seeds
        ]
        plant = cls(scenario, mechanics, sensors, trackers, extension)
        if extension is not None:
            extension.begin(plant)
        return plant

    @property
    def bullet(self) -> BulletMechanics:
        """The mechanics of a Bullet plant, for extensions."""
        assert isinstance(self._mechanics, BulletMechanics)
        return self._mechanics

    @property
    def world(self) -> BulletWorld:
        """The Bullet world, for extensions."""
        return self.bullet.world

    def link_state(self, arm: str) -> ArmState:
        """True joint state of an arm, for extensions."""
        return self.bullet.links[arm]

    @property
    def control_period(self) -> float:
        """Period of the controller [s], for extensions."""
        return self._timing.control_period

    @property
    def time(self) -> float:
        """Time since the start of the trial [s]."""
        return self._tick * self._timing.control_period

    @property
    def _tracked(self) -> bool:
        return self._tick % self._tracker_ticks == 0

    def measure(self) -> Measurement:
        """Present sensor values; a second call returns the same."""
        arms = {
            name: sensors.measure(self._tick, self._mechanics.arm(name)) for name, sensors in self._arm_sensors.items()
        }
        if not self._tracked:
            return Measurement(self.time, arms, None)
        sample, measurements = self._tick // self._tracker_ticks, []
        for number, tracker in enumerate(self._trackers):
            state = self.object_state(number)
            measurements.append(tracker.measure(sample, self.time, state.position, state.rotation))
        return Measurement(self.time, arms, measurements[0], self._by_neighbour_name(measurements[1:]))

    def truth(self) -> Truth:
        """The true state now."""
        mechanics = self._mechanics
        arms = {
            name: ArmTruth(**vars(mechanics.arm(name)), pad_force=mechanics.pad_force(name))
            for name in self.physics.arms
        }
        if not self._tracked:
            return Truth(self.time, arms, None)
        object_, *neighbours = map(self.object_state, range(len(self._trackers)))
        return Truth(self.time, arms, object_, self._by_neighbour_name(neighbours))

    def object_state(self, number: int = 0) -> BodyState:
        """True state of the object at its geometric centre, or of one of its neighbours, counted from 1."""
        return self._mechanics.object_state(number)

    def _by_neighbour_name(self, values: Sequence[Tracked]) -> dict[str, Tracked]:
        """Samples or states of the neighbours, by name."""
        return dict(zip((neighbour.name for neighbour in self.physics.neighbours), values, strict=True))

    def step(self, desired: dict[str, Array]) -> None:
        """Advance by one control period with desired torques ``(n,)`` [N m] by arm.

        Raises:
            InputError: A torque is not finite or has the wrong length.
        """
        for name, arm in self.physics.arms.items():
            torque, count = desired[name], arm.facts.joint_count
            # The sum of squares is not finite if any value is not.
            if torque.shape != (count,) or not math.isfinite(torque @ torque):
                raise InputError(
                    f"desired torque of arm {name!r} must be {count} finite numbers [N m], got {torque.tolist()}"
                )
        if self._tick + 1 >= self._samples:
            raise InputError(f"the trial is over after {self._timing.duration} s")
        extension = self._extension
        if extension is None:
            self._mechanics.step(desired, self._substeps, self.time)
        else:
            further_torques = {name: extension.joint_torque(self, name) for name in desired}
            self.bullet.step(
                desired,
                self._substeps,
                self.time,
                {name: torque for name, torque in further_torques.items() if torque is not None},
                lambda name: extension.after_sense(self, name, self.bullet.drives[name]),
            )
        self._tick += 1

    def close(self) -> None:
        """Release resources."""
        self._mechanics.close()


def check_hidden(physics: Physics) -> None:
    """Refuse sensor models that the trials of a plant cannot show.

    Raises:
        InputError: A torque sensor drifts with the time since the first run, which a plant does not know, or commands
            do not act at their stamps.
    """
    for name, arm in physics.arms.items():
        if np.any(arm.readings.torque_drift) or arm.readings.command_delay != 0.0:
            raise InputError(
                f"arm {name!r}: a plant cannot hide torque_sensor_drift and command_clock_offset, because it knows no "
                "time since the first run and its commands act at their stamps; hide torque_sensor_offset or "
                "actuation_delay instead"
            )


def _tracker_ticks(scenario: Scenario) -> int:
    """Control ticks per sample of the object tracker."""
    return max(1, round(scenario.sensors.object_period / scenario.timing.control_period))


def _scatter(
    scatter: Scatter,
    physics: Physics,
    initial: dict[str, Array],
    object_state: BodyState,
    rng: np.random.Generator,
) -> tuple[Physics, dict[str, Array], BodyState]:
    """Draw the scatter from trial to trial; the object stays on its support."""
    shift = scatter.object_position * rng.standard_normal(2)
    yaw = scatter.object_yaw * rng.standard_normal()
    friction = physics.support_friction * (1.0 + scatter.support_friction * rng.standard_normal())
    moved = replace(
        object_state,
        position=object_state.position + np.append(shift, 0.0),
        rotation=pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ object_state.rotation,  # about z of A
    )
    started = {name: q + scatter.joint_position * rng.standard_normal(q.size) for name, q in initial.items()}
    return replace(physics, support_friction=max(0.0, friction)), started, moved
