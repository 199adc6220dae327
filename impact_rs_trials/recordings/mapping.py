# SPDX-License-Identifier: Apache-2.0
"""Mapping files: location, unit and sign of the signals of a foreign recording (``config/mappings/*.yaml``).

One mapping serves bags (topic, message type and field), tables (CSV, text, Parquet, NPY, JSON: a column per joint) and
files of arrays (NPZ, HDF5, MAT: an array per signal). Names of signals are data; a mapping gives meaning and unit.

In ``topic``, ``child_frame``, ``file``, ``joints`` and column names ``{object}`` stands for the object of a run,
``{arm}`` for the arm of its scenario and ``{run}`` for the name of the run.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from impact_rs_sim.errors import InputError, did_you_mean, shortened
from impact_rs_sim.files import is_file
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts, load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.schema import NonNegativeVector, PositiveVector, Schema, Vector3, load
from impact_rs_trials.recordings.file_units import CURRENTS, SLIDES, TURNS, UNITS, factors_of
from impact_rs_trials.recordings.servo import Servo, ServoLaw

QUANTITY = {  # quantity of each signal
    "position": "position",
    "velocity": "velocity",
    "torque": "torque",
    "motor_position": "position",
    "motor_velocity": "velocity",
    "command": "torque",
    "q_desired": "position",
    "dq_desired": "velocity",
    "torque_rate": "torque_rate",
    "object_pose": "length",
    "object_position": "length",
    "object_quaternion": "orientation",
    "wrench": "wrench",
    "acceleration": "acceleration",
}
SignalName = Literal[
    "position",
    "velocity",
    "torque",
    "motor_position",
    "motor_velocity",
    "command",
    "q_desired",
    "dq_desired",
    "torque_rate",
    "object_pose",
    "object_position",
    "object_quaternion",
    "wrench",
    "acceleration",
]
NO_ROBOT = "none"  # robot of a mapping whose recordings hold an object alone
REQUIRED: tuple[SignalName, ...] = ("position", "velocity", "torque")
IN_A_PLANE = 2  # columns of object_position that a camera sees: along its image, and up
HEIGHT_ALONE = 1  # column of object_position of a range finder above or below
WIDTHS: dict[SignalName, tuple[int, ...]] = {  # numbers per sample, and other numbers of columns
    "object_pose": (7,),
    "object_position": (3, IN_A_PLANE, HEIGHT_ALONE),
    "object_quaternion": (4,),
    "wrench": (6,),
    "acceleration": (3,),
}
TorqueMeaning = Literal["whole", "without_gravity", "external", "target"]
SHIFTED_SIGNALS: tuple[SignalName, ...] = (  # that the motion brings to the clock of the positions
    "velocity", "motor_position", "motor_velocity", "torque", "command", "object_pose", "object_position",
    "object_quaternion",
)  # fmt: skip
JOINT_SIGNALS: tuple[SignalName, ...] = tuple(name for name in get_args(SignalName) if name not in WIDTHS)


TimeUnit = Literal["s", "ms", "us", "ns", "date", "frames"]
StampNames = str | tuple[str, str]  # column or array of stamps; or two, of whole seconds and of nanoseconds


class TableLayout(Schema):
    """Lines of column names and rows in a text table."""

    header: Annotated[int | None, Field(ge=0)] = Field(
        None,
        description="line of the column names, from 1; 0: no names, columns are c1, c2, ...; absent: the first line "
        "that is neither empty nor a comment (#)",
    )
    first: Annotated[int | None, Field(ge=1)] = Field(None, description="line of the first row; absent: the next")
    decimal: Literal[".", ","] = Field(
        ".", description="decimal sign; with a comma, semicolons or tabs separate the cells"
    )


class SignalSource(Schema):
    """Location of one signal."""

    topic: str | None = Field(None, description="topic in a bag; * matches any text, as in */joint_states")
    type: str | None = Field(None, description="message type, package/msg/Name")
    field: str | None = Field(
        None, description="path of the array in the message, such as state.position or points.0.effort"
    )
    names: str | None = Field(
        None, description="path of the joint names in the message; absent: their order is that of joints"
    )
    stamp: Literal["header", "log"] | None = Field(
        None, description="absent: as in the mapping, or the log time without a header"
    )
    child_frame: str | None = Field(None, description="child_frame_id to take from transforms; * matches any text")
    column: str | None = Field(
        None,
        description="column of a table; {joint} is 1, 2, ...; without it a cell holds all numbers of a sample",
    )
    columns: tuple[str, ...] | None = Field(
        None,
        description="columns of a table, in order; of object_position also two, along and up, or one, up",
    )
    entries: tuple[Annotated[int, Field(ge=1)], ...] | None = Field(
        None,
        description="selected numbers of a sample without names, from 1; absent: all",
    )
    time_column: StampNames | None = Field(None, description="its own time, as time.column; absent: as in the mapping")
    array: str | None = Field(None, description="array of an NPZ, HDF5, MAT or PyTorch file, samples x joints")
    time_array: StampNames | None = Field(None, description="its own time, as time.array; absent: as in the mapping")
    time_unit: TimeUnit | None = Field(None, description="its own time, as time.unit; absent: as in the mapping")
    file: str | None = Field(None, description="file in the folder of a run; absent: the run's own file")
    table: TableLayout | None = Field(None, description="as table, for its file; absent: as in the mapping")
    quaternion_order: Literal["xyzw", "wxyz"] = Field("xyzw", description="order of a quaternion in a table")
    delay: float = Field(0.0, description="added to the timestamps [s]")
    clock: Literal["shared", "own"] = Field(
        "shared",
        description="own: another clock, whose constant offset is estimated from the motion; for velocity, torque, "
        "command, motor and object signals",
    )
    unit: str | tuple[str, ...] = Field(
        description="unit in the file; a list per joint if some joints turn and some slide"
    )
    factor: float | tuple[float, ...] = Field(
        1.0,
        description="factor of the numbers, such as -1; for joints and two columns of object_position also a list [-]",
    )
    offset: float | tuple[float, ...] = Field(
        0.0,
        description="then added, in the unit; for joints also a list, such as another zero than in the facts",
    )

    @property
    def units(self) -> tuple[str, ...]:
        """The unit, or the units of all joints."""
        return (self.unit,) if isinstance(self.unit, str) else self.unit


class TimeSource(Schema):
    """Location of the timestamps."""

    stamp: Literal["header", "log"] = Field(
        "header", description="timestamp of a message: of its header, or the log time"
    )
    column: StampNames = Field("time", description="column of a table; or two, whole seconds and nanoseconds")
    array: StampNames = Field("time", description="array of an NPZ, HDF5, MAT or PyTorch file; or two, as columns")
    unit: TimeUnit = Field(
        "s",
        description="unit of the timestamps except in bags; date: 2026-11-25 12:00:00.5, a zone may follow; frames: "
        "numbers of camera frames, over rate",
    )
    steps: bool = Field(False, description="whether they are times since the sample before (dt)")
    rate: Annotated[float | None, Field(gt=0.0)] = Field(
        None, description="sampling rate of files without timestamps [Hz]"
    )
    repeated: Literal["refuse", "keep_first"] = Field(
        "refuse", description="repeated timestamps: refuse the file, or keep the first sample"
    )


class MountedEndEffector(Schema):
    """Load mounted on the flange during the recording."""

    mass: Annotated[float, Field(ge=0.0, description="mass [kg]")] = 0.0
    com: Vector3 = Field((0.0, 0.0, 0.0), description="centre of mass in frame E [m]")
    inertia: tuple[float, float, float, float, float, float] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), description="ixx, ixy, ixz, iyy, iyz, izz about the centre of mass [kg m^2]"
    )
    length: Annotated[float, Field(ge=0.0, description="from the flange to frame E [m]")] = 0.0

    def build(self) -> EndEffector:
        """End effector of the robot model; an empty flange weighs a nanogram, because bodies need a mass."""
        ixx, ixy, ixz, iyy, iyz, izz = self.inertia
        inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        return EndEffector(
            mass=max(self.mass, 1e-12),
            com=np.array(self.com),
            inertia=inertia,
            length=self.length,
            mount_yaw=0.0,
            pad_size=(0.01, 0.01, 0.01),
        )


class Mapping(Schema):
    """A mapping file."""

    description: str = Field(description="what kind of recording this reads")
    robot: str = Field(
        description="file in config/robots, or path from the mapping's folder; none: only an object was tracked"
    )
    joints: tuple[str, ...] = Field(
        (), description="joint names in order; * matches any text, {arm} is the arm's name; required with a robot"
    )
    end_effector: MountedEndEffector = Field(
        default_factory=MountedEndEffector, description="load mounted on the flange"
    )
    base_rpy: Vector3 = Field((0.0, 0.0, 0.0), description="roll, pitch, yaw of the robot's base in the world [rad]")
    torque_measured_at: Literal["link", "motor"] = Field(
        "link",
        description="'link': sensor at the gear output; 'motor': motor torque, which also accelerates the motor",
    )
    motor_inertia: NonNegativeVector | None = Field(
        None,
        description="motor inertia at the joint, with torque_measured_at: motor; absent: 0, which diagnose corrects "
        "[kg m^2], prismatic [kg]",
    )
    torque_constant: PositiveVector | None = Field(
        None,
        description="joint torque over motor current, with gear ratio, for units A and mA [N m/A], prismatic [N/A]",
    )
    torque_meaning: TorqueMeaning = Field(
        "whole",
        description="'whole': it moves the joints; 'without_gravity': without the gravity torque; 'external': "
        "without the torque of a rigid model; 'target': a controller's feedforward, refused",
    )
    servo: Servo | None = Field(
        None,
        description="position servos: torque from signals.q_desired, in place of signals.torque",
    )
    command_includes_gravity: bool = Field(
        True, description="whether the commanded torque includes gravity; libfranka's does not"
    )
    low_pass: Annotated[float, Field(gt=0.0, description="cut-off of the zero-phase low-pass [Hz]")] = 3.0
    time: TimeSource = Field(default_factory=TimeSource, description="timestamps")
    table: TableLayout = Field(default_factory=TableLayout, description="lines of names and rows of a text table")
    run_column: str | None = Field(
        None,
        description="column with the run of each row, such as episode_index",
    )
    definitions: tuple[str, ...] = Field((), description="message packages whose definitions are in mappings/messages")
    signals: dict[SignalName, SignalSource] = Field(description="location of each signal")

    @model_validator(mode="after")
    def _pairs_are_seconds(self) -> Self:
        clocks = [("time.", self.time, "time.unit")]
        clocks += [(f"signals.{name}.time_", self.clock(source), "time_unit") for name, source in self.signals.items()]
        for before, clock, unit in clocks:
            for key, names in (("column", clock.column), ("array", clock.array)):
                if not isinstance(names, str) and (clock.unit != "s" or clock.steps):
                    raise ValueError(
                        f"{before}{key} names whole seconds and nanoseconds, expected {unit}: s and no time.steps"
                    )
            if clock.steps and clock.unit in ("date", "frames"):
                raise ValueError(f"time.steps has {unit} {clock.unit!r}, expected s, ms, us or ns")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.robot == NO_ROBOT:
            self._is_of_an_object()
        elif not self.joints:
            raise ValueError("joints is missing; expected the names of the joints, base to tip")
        self._has_joint_signals()
        for name, source in self.signals.items():
            units, widths, of_joints = UNITS[QUANTITY[name]], self._widths(name), name in JOINT_SIGNALS
            for unit in source.units:
                if unit not in units:
                    raise ValueError(f"signals.{name}.unit is {unit!r}, expected one of: {', '.join(units)}")
            for key, noun, allowed in (("columns", "columns", widths), ("entries", "numbers", widths[:1])):
                listed = getattr(source, key)
                if listed is not None and len(listed) not in allowed:
                    raise ValueError(f"signals.{name}.{key} lists {len(listed)} {noun}, expected {widths[0]}")
            per_column = "factor" if name == "object_position" and source.columns is not None else ""
            expected_count = len(source.columns) if source.columns is not None else widths[0]
            for key, noun in (("unit", "units"), ("factor", "numbers"), ("offset", "numbers")):
                listed = getattr(source, key)
                if isinstance(listed, tuple) and (
                    len(listed) != expected_count or not (of_joints or key == per_column)
                ):
                    expected = f"one or {expected_count}, one per joint" if of_joints else "one"
                    raise ValueError(f"signals.{name}.{key} lists {len(listed)} {noun}, expected {expected}")
            if not of_joints and source.offset != 0.0:
                raise ValueError(f"signals.{name}.offset is {source.offset:g}, expected none: it is for joints")
            several = (
                source.array is not None or source.field is not None or "{joint}" not in (source.column or "{joint}")
            )
            if source.entries is not None and (not several or source.names is not None):
                raise ValueError(
                    f"signals.{name}.entries is for an array, a field of messages without names, or a column whose "
                    "cells hold several numbers; for a table with a number per cell use columns, for messages with "
                    "names joints"
                )
            if source.columns is not None and source.column is not None:
                raise ValueError(f"signals.{name} has both column and columns, expected one of them")
        self._object_is_described_once()
        self._own_clocks_are_estimated()
        for holder, prefix in ((self, ""), (self.servo, "servo.")):
            for key in ("motor_inertia", "torque_constant", "kp", "kd", "torque_max"):
                gains = getattr(holder, key, None)
                if gains is not None and len(gains) != len(self.joints):
                    raise ValueError(f"{prefix}{key} has {len(gains)} entries, expected {len(self.joints)}")
        self._currents_have_constants()
        return self

    def _has_joint_signals(self) -> None:
        if self.robot == NO_ROBOT:
            return
        if "position" not in self.signals:
            raise ValueError("signals.position is missing; position and torque are needed")
        if self.servo is None:
            if "torque" not in self.signals:
                raise ValueError(
                    "signals.torque is missing; position and torque are needed, or servo and signals.q_desired"
                )
            return
        if "torque" in self.signals:
            raise ValueError("signals has a torque and servo computes one; expected one of them")
        if "q_desired" not in self.signals:
            raise ValueError("servo needs signals.q_desired, the desired positions")
        if self.torque_measured_at != "motor":
            raise ValueError("servo gives the torque of motors: expected torque_measured_at: motor")

    def _currents_have_constants(self) -> None:
        currents = [name for name, source in self.signals.items() if any(unit in CURRENTS for unit in source.units)]
        for name in currents:
            if not all(unit in CURRENTS for unit in self.signals[name].units):
                raise ValueError(f"signals.{name}.unit mixes currents and torques, expected one kind for all joints")
            if self.torque_constant is None:
                raise ValueError(
                    f"signals.{name}.unit is a current, which needs torque_constant: torque at each joint over motor "
                    "current, with the ratio of the gear [N m/A]"
                )
            if self.torque_measured_at != "motor":
                raise ValueError(
                    f"signals.{name}.unit is a current, which a motor has: expected torque_measured_at: motor"
                )
        if self.torque_constant is not None and not currents:
            raise ValueError("torque_constant is for currents, and no signal has the unit A or mA")

    def _is_of_an_object(self) -> None:
        if self.joints:
            raise ValueError("joints has names, but robot is none; expected a robot, or no joints")
        if strange := [name for name in self.signals if name in JOINT_SIGNALS]:
            raise ValueError(f"signals.{strange[0]} is a signal of joints, but robot is none; expected a robot")
        if not {"object_pose", "object_position"} & set(self.signals):
            raise ValueError("signals.object_pose is missing; an object alone needs its pose, or object_position")

    def _object_is_described_once(self) -> None:
        parts = [name for name in ("object_position", "object_quaternion") if name in self.signals]
        if parts and "object_pose" in self.signals:
            raise ValueError(f"signals has both object_pose and {parts[0]}, expected one of them")
        if len(parts) == 1 and not (self.robot == NO_ROBOT and parts == ["object_position"]):
            raise ValueError(f"signals has {parts[0]} alone, expected object_position and object_quaternion")

    def _own_clocks_are_estimated(self) -> None:
        for name, source in self.signals.items():
            if source.clock == "own" and name not in SHIFTED_SIGNALS:
                raise ValueError(
                    f"signals.{name}.clock is 'own', but the offset of {name} is not estimated; expected shared, and "
                    f"a known offset in signals.{name}.delay"
                )

    def clock(self, source: SignalSource) -> TimeSource:
        """Timestamps of a signal; keys that the signal lacks are those of the mapping."""
        signal_time = {"column": source.time_column, "array": source.time_array, "unit": source.time_unit}
        return self.time.model_copy(update={key: value for key, value in signal_time.items() if value is not None})

    @property
    def spread(self) -> bool:
        """Whether a run has several files with its name."""
        return all(source.file is not None and "{run}" in source.file for source in self.signals.values())

    @property
    def holds_runs(self) -> bool:
        """Whether a file may hold several runs: rows of a column, or groups of arrays with ``{run}`` in their names."""
        return self.run_column is not None or any("{run}" in (source.array or "") for source in self.signals.values())

    def width(self, signal: SignalName) -> int:
        """Numbers per sample of a signal."""
        return self._widths(signal)[0]

    def _widths(self, signal: SignalName) -> tuple[int, ...]:
        return WIDTHS.get(signal, (len(self.joints),))

    @property
    def facts(self) -> RobotFacts:
        """Facts of the robot.

        Raises:
            InputError: Unknown robot, a tree, a different number of joints, or an impossible unit of a joint.
        """
        if self.robot == NO_ROBOT:
            raise InputError("an object alone was tracked; expected a robot", key="robot", value=self.robot)
        facts = load_facts(self.robot)
        facts.check_chain("a recording", "robot")
        if facts.joint_count != len(self.joints):
            raise InputError(f"{self.robot} has {facts.joint_count} joints, the mapping names {len(self.joints)}")
        for name in self.signals:
            for joint, origin in enumerate(facts.joints if name in JOINT_SIGNALS else ()):
                moves, units = ("slides", SLIDES) if origin.type == "prismatic" else ("turns", TURNS)
                if (unit := self.unit(name, joint)) not in units[QUANTITY[name]]:
                    expected = " or ".join(units[QUANTITY[name]])
                    raise InputError(
                        f"joint {joint + 1} of {self.robot} {moves}, expected {expected}; a list has one for each",
                        key=f"signals.{name}.unit",
                        value=unit,
                    )
        return facts

    @property
    def base(self) -> pin.SE3:
        """Placement of the robot's base in the world, at its origin."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.base_rpy), np.zeros(3))

    def robot_model(self) -> RobotModel:
        """Nominal rigid-body model of the recorded arm with its load."""
        return RobotModel(self.facts, self.end_effector.build(), self.base)

    @property
    def servo_law(self) -> ServoLaw | None:
        """Law of the servos; None: there are no servos."""
        return None if self.servo is None else ServoLaw.of(self.servo, np.array(self.facts.limits.torque_Nm))

    def unit(self, signal: SignalName, joint: int) -> str:
        """Unit of a joint's numbers in the file."""
        units = self.signals[signal].units
        return units[joint] if len(units) > 1 else units[0]

    def factor(self, signal: SignalName) -> Array:
        """Factor from the numbers in the file to SI units, ``()`` or ``(n,)``."""
        return np.asarray(self._of_unit(signal) * np.asarray(self.signals[signal].factor))

    def offset(self, signal: SignalName) -> Array:
        """Offset added after the factor, in SI units, ``()`` or ``(n,)``."""
        return np.asarray(self._of_unit(signal) * np.asarray(self.signals[signal].offset))

    def _of_unit(self, signal: SignalName) -> Array:
        """Factor from the unit of a signal to SI, ``()`` or ``(n,)``."""
        source = self.signals[signal]
        constant = self.torque_constant if source.units[0] in CURRENTS else None
        of_unit = factors_of(QUANTITY[signal], source.unit)
        return (of_unit if of_unit.size > 1 else of_unit[0]) * np.asarray(1.0 if constant is None else constant)

    def to_si(self, signal: SignalName, values: Array) -> Array:
        """Numbers of a table or array in SI units; quaternions in the order x y z w.

        Args:
            signal: Their signal.
            values: ``(k, c)``, :meth:`width` columns.
        """
        source, factor = self.signals[signal], self.factor(signal)
        if signal in ("object_pose", "object_quaternion") and source.quaternion_order == "wxyz":
            values = np.hstack((values[:, :-4], values[:, -3:], values[:, -4:-3]))
        if signal == "object_pose":
            return np.hstack((values[:, :3] * factor, values[:, 3:]))
        if signal == "object_position" and values.shape[1] < WIDTHS[signal][0]:
            return np.insert(values * factor, [values.shape[1] - 1] * (3 - values.shape[1]), 0.0, axis=1)
        return values * factor + self.offset(signal)


def mapping_names() -> list[str]:
    """Names of the shipped mappings."""
    return sorted(path.stem for path in (config_directory() / "mappings").glob("*.yaml"))


def load_mapping(name: str | Path) -> Mapping:
    """A mapping by name (``config/mappings/NAME.yaml``) or by path.

    Raises:
        InputError: There is no such mapping, or it breaks the schema.
    """
    path = Path(name)
    if path.suffix not in (".yaml", ".yml"):
        path = config_directory() / "mappings" / f"{name}.yaml"
        if not is_file(path):
            names, given = mapping_names(), shortened(str(name))
            raise InputError(f"no mapping {given!r}{did_you_mean(given, names)}; known: {', '.join(names)}")
    mapping = load(Mapping, path)
    if not mapping.robot.endswith((".yaml", ".yml")):
        return mapping
    return mapping.model_copy(update={"robot": os.path.normpath(path.parent / mapping.robot)})
