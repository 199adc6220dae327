"""The robot of the laptop: Bullet for links and contacts, a drive per arm beside it, sensors in front.

Every control period the caller reads :meth:`Plant.measure`, decides on torques and calls :meth:`Plant.step`, which
runs the torque loop and Bullet at the drive's period. The truth is for recording under ``/truth`` and for
tests; no controller and no analyzer sees it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from impact_rs_sim.bullet_world import BulletWorld
from impact_rs_sim.drive import Drive
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import Scatter, Scenario
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.sensors import ArmMeasurement, ArmSensors, ObjectMeasurement, ObjectTracker

SOLVER_ITERATIONS = 60
SOLVER_RESIDUAL = 1e-12


@dataclass(frozen=True)
class Measurement:
    """Everything a real robot cell would give at one control tick.

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
    """Something that a plant does and no :class:`Physics` can say; subclasses override what they need.

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
    """Flexible-joint arms, object and support, for one trial.

    Args:
        scenario: Times, sensors and scatter.
        physics: The true physics, possibly with effects that nobody else knows.
        initial: Initial joint positions by arm, ``(n,)`` [rad].
        object_state: Nominal pose of the object; the scatter comes on top.
        seed: Seed of scatter and noise. Same seed, same trial, bit by bit.
        extension: Something that the physics cannot say.
    """

    def __init__(
        self,
        scenario: Scenario,
        physics: Physics,
        initial: dict[str, Array],
        object_state: BodyState,
        seed: int,
        extension: PlantExtension | None = None,
    ) -> None:
        timing = scenario.timing
        self._timing = timing
        scatter_seed, *sensor_seeds = np.random.SeedSequence(seed).spawn(2 + len(physics.arms))
        physics, initial, object_state = _scatter(
            scenario.scatter, physics, initial, object_state, np.random.default_rng(scatter_seed)
        )
        self.physics = physics
        self._world = BulletWorld(
            physics,
            time_step=timing.drive_period,
            gravity=True,
            compliant_pads=True,
            iterations=SOLVER_ITERATIONS,
            residual_threshold=SOLVER_RESIDUAL,
        )
        self._world.set_object(object_state)
        if extension is None and _rests(physics, object_state):
            self._world.rest_object()
        self._tick = 0
        self._samples = timing.ticks + 1
        self._drives: dict[str, Drive] = {}
        self._links: dict[str, ArmState] = {}
        self._arm_sensors: dict[str, ArmSensors] = {}
        self._loaded = {name: physics.robot_model(name) for name, arm in physics.arms.items() if arm.loads}
        for (name, arm), sensor_seed in zip(physics.arms.items(), sensor_seeds[1:], strict=True):
            q = initial[name]
            load = physics.robot_model(name).gravity_torque(q)
            drive = Drive(arm, timing.drive_period)
            drive.reset(q, load)
            state = ArmState(q, np.zeros_like(q))
            self._world.set_arm(name, state)
            self._drives[name] = drive
            self._links[name] = state
            self._arm_sensors[name] = ArmSensors(
                scenario.sensors, q.size, self._samples, np.random.default_rng(sensor_seed)
            )
        self._extension = extension
        if extension is not None:
            extension.begin(self)
        self._substeps = timing.substeps
        self._tracker_ticks = max(1, round(scenario.sensors.object_period / timing.control_period))
        self._tracker = ObjectTracker(
            scenario.sensors,
            self._samples // self._tracker_ticks + 1,
            np.random.default_rng(sensor_seeds[0]),
        )

    @property
    def world(self) -> BulletWorld:
        """The Bullet world, for extensions."""
        return self._world

    def link_state(self, arm: str) -> ArmState:
        """True joint state of an arm, for extensions."""
        return self._links[arm]

    @property
    def time(self) -> float:
        """Time since the start of the trial [s]."""
        return self._tick * self._timing.control_period

    @property
    def _tracked(self) -> bool:
        return self._tick % self._tracker_ticks == 0

    def measure(self) -> Measurement:
        """What the sensors say now. Calling it twice gives the same answer."""
        arms = {}
        for name, drive in self._drives.items():
            link = self._links[name]
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
            state = self._world.object_state()
            sample = self._tick // self._tracker_ticks
            tracked = self._tracker.measure(sample, self.time, state.position, state.rotation)
        return Measurement(self.time, arms, tracked)

    def truth(self) -> Truth:
        """The true state now."""
        arms = {}
        for name, drive in self._drives.items():
            link = self._links[name]
            arms[name] = ArmTruth(
                link.position,
                link.velocity,
                drive.elastic_torque.copy(),
                drive.position.copy(),
                drive.velocity.copy(),
                self._world.pad_force(name),
            )
        return Truth(self.time, arms, self._world.object_state() if self._tracked else None)

    def step(self, desired: dict[str, Array]) -> None:
        """Advance by one control period with desired torques ``(n,)`` [N m] by arm.

        Raises:
            InputError: A torque is not finite or has the wrong length.
        """
        for name in self._drives:
            torque = desired[name]
            if torque.shape != self._links[name].position.shape or not np.isfinite(torque).all():
                raise InputError(
                    f"desired torque of arm {name!r} must be {self._links[name].position.size} finite numbers [N m], "
                    f"got {torque.tolist()}"
                )
        if self._tick + 1 >= self._samples:
            raise InputError(f"the trial is over after {self._timing.duration} s")
        world = self._world
        loads = {name: self._load_torque(name) for name in self._loaded}
        extension = self._extension
        if extension is not None:
            for name in self._drives:
                more = extension.joint_torque(self, name)
                if more is not None:
                    loads[name] = loads.get(name, 0.0) + more
        for _ in range(self._substeps):
            for name, drive in self._drives.items():
                torque = drive.transmission_torque
                world.apply_torque(name, torque + loads[name] if name in loads else torque)
                drive.step(desired[name])
            world.step()
            for name, drive in self._drives.items():
                link = world.arm_state(name)
                drive.sense(link.position, link.velocity)
                if extension is not None:
                    extension.after_sense(self, name, drive)
                self._links[name] = link
        self._tick += 1

    def _load_torque(self, name: str) -> Array:
        """Torque on the links of everything outside the model, ``(n,)`` [N m]; what acts on the motors goes there.

        Held over one control period.
        """
        link = self._links[name]
        on_links, on_motors = self.physics.load_torques(
            name, self._loaded[name], self.time, link.position, link.velocity
        )
        self._drives[name].load(on_motors)
        return on_links

    def close(self) -> None:
        """Free the Bullet world."""
        self._world.close()


def _rests(physics: Physics, state: BodyState) -> bool:
    """Whether the object stays where it is until it is touched: at rest on a support that does not let it slide."""
    if physics.support_height is None or np.any(state.twist):
        return False
    across, down = float(np.hypot(*physics.gravity[:2])), -float(physics.gravity[2])
    return across < physics.support_friction * down


def _scatter(
    scatter: Scatter,
    physics: Physics,
    initial: dict[str, Array],
    object_state: BodyState,
    rng: np.random.Generator,
) -> tuple[Physics, dict[str, Array], BodyState]:
    """What differs from trial to trial; the object stays on its support."""
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
