# SPDX-License-Identifier: Apache-2.0
"""Signals of one trial: of a plant, a real robot, or the model twin."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.robot import Array
from impact_rs_sim.rotations import yaw_of_quaternions
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag


@dataclass(frozen=True)
class ArmSignals:
    """Signals of one arm at the control ticks; arrays are ``(k, n)`` unless stated.

    Attributes:
        position: q [rad].
        velocity: dq [rad/s].
        torque: tau_J [N m].
        motor_position: theta [rad]; empty if not measured.
        motor_velocity: dtheta [rad/s]; empty if not measured.
        command: tau_d [N m]; empty if not known.
    """

    position: Array
    velocity: Array
    torque: Array
    motor_position: Array
    motor_velocity: Array
    command: Array

    def at(self, rows: slice | NDArray[np.bool_]) -> ArmSignals:
        """Some of the samples; empty signals stay empty."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return ArmSignals(**{name: value[rows] if value.size else value for name, value in values.items()})


@dataclass(frozen=True)
class Signals:
    """Signals of one trial.

    Attributes:
        time: Control ticks, ``(k,)`` [s].
        arms: Signals by arm.
        object_time: Times at which the object was tracked, ``(m,)`` [s].
        object_position: Position of its geometric centre in A, ``(m, 3)`` [m].
        object_yaw: Its rotation about z, ``(m,)`` [rad].
    """

    time: Array
    arms: dict[str, ArmSignals]
    object_time: Array
    object_position: Array
    object_yaw: Array


def signals_of_bag(bag: TrialBag) -> Signals:
    """Signals of a recorded trial; ``/truth`` is not read.

    Raises:
        BagError: A topic is missing, damaged, has NaN, gaps or stamps that run backwards.
    """
    arms, time = {}, None
    for arm in bag.info.robots:
        measured = bag.joints(topics.joint_states(arm))
        motor = bag.joints(topics.motor_states(arm))
        controller = bag.controller(arm)
        _check_times(bag, topics.joint_states(arm), measured.time)
        if topics.motor_states(arm) in bag.missing:
            raise BagError(
                bag.path,
                f"no {topics.motor_states(arm)}, which the replay of a model starts from: describe such bags with an "
                "experiment file (docs/laboratory.md)",
            )
        count = measured.time.size
        for topic, size in (
            (topics.motor_states(arm), motor.time.size),
            (topics.controller_state(arm), controller.time.size),
        ):
            if size != count:
                raise BagError(bag.path, f"{topic} has {size} messages, {topics.joint_states(arm)} has {count}")
        for name, values in (
            ("position", measured.position),
            ("velocity", measured.velocity),
            ("effort", measured.effort),
        ):
            if not np.isfinite(values).all():
                first = float(measured.time[np.argmax(~np.isfinite(values).all(axis=1))])
                raise BagError(bag.path, f"{topics.joint_states(arm)}: {name} is not finite at t = {first:.3f} s")
        time = measured.time
        arms[arm] = ArmSignals(
            position=measured.position,
            velocity=measured.velocity,
            torque=measured.effort,
            motor_position=motor.position,
            motor_velocity=motor.velocity,
            command=controller.commanded_torque,
        )
    if time is None:
        raise BagError(bag.path, "names no robots")
    pose = bag.poses(topics.OBJECT_POSE)
    return Signals(time, arms, pose.time, pose.position, yaw_of_quaternions(pose.quaternion))


def _check_times(bag: TrialBag, topic: str, time: Array) -> None:
    if time.size < 2:
        raise BagError(bag.path, f"{topic} has {time.size} messages")
    steps = np.diff(time)
    if np.any(steps <= 0.0):
        raise BagError(bag.path, f"{topic}: time stamps run backwards at t = {time[np.argmax(steps <= 0.0)]:.3f} s")
    if steps.max() > 1.5 * np.median(steps):
        raise BagError(bag.path, f"{topic}: gap of {steps.max():.4f} s at t = {time[np.argmax(steps)]:.3f} s")


class SignalCollector:
    """Collects :class:`Signals` from a running trial."""

    def __init__(self, plan: TrialPlan) -> None:
        ticks = plan.scene.scenario.timing.ticks + 1
        self._period = plan.scene.scenario.timing.control_period
        self._arms = {
            name: {
                field: np.zeros((ticks, arm.initial.size))
                for field in ("position", "velocity", "torque", "motor_position", "motor_velocity", "command")
            }
            for name, arm in plan.arms.items()
        }
        self._ticks = 0
        self._object: list[tuple[float, Array, float]] = []

    def add(self, tick: int, measurement: object, commands: object) -> None:
        """Add one control tick (``Measurement`` and ``dict[str, ArmCommand]``)."""
        self._ticks = tick + 1
        for name, columns in self._arms.items():
            measured, command = measurement.arms[name], commands[name]  # type: ignore[attr-defined, index]
            columns["position"][tick] = measured.position
            columns["velocity"][tick] = measured.velocity
            columns["torque"][tick] = measured.torque
            columns["motor_position"][tick] = measured.motor_position
            columns["motor_velocity"][tick] = measured.motor_velocity
            columns["command"][tick] = command.torque
        tracked = measurement.object  # type: ignore[attr-defined]
        if tracked is not None:
            yaw = pin.rpy.matrixToRpy(pin.Quaternion(tracked.quaternion).matrix())[2]
            self._object.append((tracked.time, tracked.position, float(yaw)))

    def signals(self) -> Signals:
        """The signals collected so far."""
        count = self._ticks
        arms = {
            name: ArmSignals(**{key: values[:count] for key, values in columns.items()})
            for name, columns in self._arms.items()
        }
        return Signals(
            time=np.arange(count, dtype=np.float64) * self._period,
            arms=arms,
            object_time=np.array([time for time, _, _ in self._object]),
            object_position=np.array([position for _, position, _ in self._object]),
            object_yaw=np.array([yaw for _, _, yaw in self._object]),
        )
