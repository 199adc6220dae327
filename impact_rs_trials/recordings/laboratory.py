# SPDX-License-Identifier: Apache-2.0
"""Runs of a laboratory with its own controller: from its files to checked signals on one clock.

Joint signals are on a regular grid with the median period of the joint states, interpolated where stamps are off the
grid. Command and object pose keep their own stamps, because a command is held until the next and the pose is slower.
Invalid data is refused in one line. Gaps split a run into pieces on the same grid; the gaps between them are listed, so
that interpolated samples are not used as measurements. A run whose pieces are all too short is left out, with the
reason.

Several arms share the grid of the arm with the highest rate of joint states, over the time in which all of them were
recorded.
"""

from __future__ import annotations

import functools
import itertools
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import MAX_NORM_ERROR
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import BodyState, resting_pose
from impact_rs_trials.bags.types import STAMP_ROUNDING_S
from impact_rs_trials.recordings.checks.clock_offset import OBJECT_SIGNALS, on_one_clock, shifted_to_impact
from impact_rs_trials.recordings.checks.faults import without_faults
from impact_rs_trials.recordings.checks.joint_checks import arm_warnings
from impact_rs_trials.recordings.checks.joint_jumps import impact_time
from impact_rs_trials.recordings.checks.plausibility import (
    FIRST_POSE_S,
    check_gravity_torque,
    check_object,
    check_touch,
    gravity_torques,
    height_on_support,
)
from impact_rs_trials.recordings.contact_frame import CARRIED_S, FLAT_CONTACT_S, ContactFrame, PadOnFace, contact_frame
from impact_rs_trials.recordings.experiment import (
    FRICTION_SIGMA_SHARE,
    Experiment,
    MotionCapture,
    RunRow,
    read_runs,
    run_named,
)
from impact_rs_trials.recordings.mapping import REQUIRED, SignalName
from impact_rs_trials.recordings.mapping import Mapping as SignalMapping
from impact_rs_trials.recordings.readers.clock import (
    MAX_GRID_ERROR_PERIODS,
    Gap,
    check_jumps,
    check_stamps,
    even_grid,
    gaps,
    gaps_in_words,
    grid_from,
)
from impact_rs_trials.recordings.readers.series import Names, Series
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.recording import TooShort, check_arm
from impact_rs_trials.recordings.remarks import remark
from impact_rs_trials.runs import NONE, ArmSignals, Run, Signals
from impact_rs_trials.since import MIN_WALL_CLOCK_S
from impact_rs_trials.workers import Map

logger = logging.getLogger(__name__)

ARM_SIGNALS: tuple[SignalName, ...] = (*REQUIRED, "motor_position", "motor_velocity")

MIN_RUN_SAMPLES = 20
MIN_PIECE_S = 0.3  # of a piece between gaps
MIN_GAP_PERIODS = 3.0  # a gap is longer than so many sampling periods, and
MIN_REPORTED_GAP_S = 0.005  # longer than this; a shorter one fits into the window of the velocity fit at an impact
MAX_INTERPOLATED_GAP_S = 0.010  # longer gaps separate two pieces
MIN_CLOCK_JUMP_S = 0.1  # a longer step is a jump of the clock
MAX_JITTER_PERIODS = 0.2  # of timestamps about the regular grid, without a warning
MIN_JOINT_RATE_HZ = 200.0  # without a warning
MIN_POSE_RATE_HZ = 60.0  # without a warning
MAX_IMPACT_SHARE = 0.02  # of the samples, in which an impact may take a velocity or torque beyond the data sheet
OUT_OF_REACH_M = 5.0  # distance of the object in free motion
BEYOND_S = 0.1  # of command and pose that are kept before and after the joint signals

ArmSeries = dict[SignalName, Series]


@dataclass(frozen=True)
class Laboratory:
    """Common properties of the runs of an experiment.

    Attributes:
        scenario: Robots, objects and support.
        mappings: Where the signals of each arm are.
        motion_capture: Placement of its world.
        estimated_frame: Its estimate from hits; None: it was given.
        friction_noise: Relative standard deviation of the friction of the scenario's support [-].
    """

    scenario: Scenario
    mappings: Mapping[str, SignalMapping]
    motion_capture: MotionCapture
    estimated_frame: ContactFrame | None = None
    friction_noise: float = FRICTION_SIGMA_SHARE

    @classmethod
    def of(cls, experiment: Experiment) -> Laboratory:
        """Scenario and mappings of an experiment, which must fit each other.

        Raises:
            InputError: They do not fit, or signals of two arms are the same.
        """

        def location(arm: str | None) -> dict[str, Any]:
            mapping = experiment.mapping
            if isinstance(mapping, str):
                return {"file": experiment.file, "key": "mapping", "value": mapping}
            if arm is None:
                return {"file": experiment.file, "key": "mapping"}
            return {"file": experiment.file, "key": f"mapping.{arm}", "value": mapping[arm]}

        scenario = experiment.load_scenario()
        mappings = experiment.load_mappings(scenario.robots)
        laboratory = cls.checked(scenario, mappings, experiment.motion_capture, location)
        return replace(laboratory, friction_noise=experiment.friction_noise)

    @classmethod
    def checked(
        cls,
        scenario: Scenario,
        mappings: Mapping[str, SignalMapping],
        motion_capture: MotionCapture,
        location: Callable[[str | None], Mapping[str, Any]],
    ) -> Laboratory:
        """Scenario and mappings, which must fit each other.

        Args:
            scenario: Robots, objects and support.
            mappings: Where the signals of each arm are.
            motion_capture: Placement of its world.
            location: File, key and value for errors about the mapping of an arm; None: about the mappings of all arms.

        Raises:
            InputError: They do not fit, or signals of two arms are the same.
        """
        for arm, mapping in mappings.items():
            robot = scenario.robots[arm]
            if robot.robot_facts != mapping.facts:
                raise InputError(
                    f"the mapping is for robot {mapping.robot!r}, arm {arm!r} of scenario {scenario.name!r} is "
                    f"{robot.facts_name!r}; expected the same",
                    **location(arm),
                )
            if mapping.torque_measured_at != "link":
                raise InputError(
                    "torque_measured_at is 'motor' in the mapping; runs with contact need the torque behind the gears "
                    "(link), the commanded torque of the motors is signals.command",
                    **location(arm),
                )
        for first, second in itertools.combinations(mappings, 2):
            common_signals = mappings[first].signals.keys() & mappings[second].signals.keys()
            for name in (name for name in REQUIRED if name in common_signals):
                if _where(mappings[first], first, name) == _where(mappings[second], second, name):
                    raise InputError(
                        f"{name} of arms {first!r} and {second!r} would be the same numbers; expected {{arm}} for the "
                        "name of an arm in a topic, a column or the joints, or a mapping for each arm, mapping: "
                        f"{{{first}: ..., {second}: ...}}",
                        **location(None),
                    )
        return cls(scenario, mappings, motion_capture)

    @functools.cached_property
    def models(self) -> dict[str, RobotModel]:
        """Nominal rigid-body models of the arms."""
        physics = Physics.nominal(self.scenario, next(iter(self.scenario.objects)))
        return {arm: physics.robot_model(arm) for arm in self.mappings}

    @property
    def tracker(self) -> str:
        """The arm whose mapping has the pose of the object; the first arm if no mapping has it."""
        tracking = (arm for arm, mapping in self.mappings.items() if set(OBJECT_SIGNALS) & set(mapping.signals))
        return next(tracking, next(iter(self.mappings)))

    def series(self, run: RunRow, wanted: Sequence[SignalName], needed: Sequence[SignalName]) -> dict[str, ArmSeries]:
        """Signals of every arm at the timestamps of the files; :attr:`tracker` has the object's signals.

        Args:
            run: The run.
            wanted: Signals to read, as far as a mapping has them.
            needed: Those of them that must be there.

        Raises:
            InputError: A needed signal is missing, or a signal cannot be used.
        """
        series = {}
        for arm, mapping in self.mappings.items():
            names = Names(object=run.object or "*", arm=arm, run=run.name)
            names_of_arm = [name for name in wanted if name not in OBJECT_SIGNALS or arm == self.tracker]
            with self.errors_of(arm):
                series[arm] = read_series(run.path, mapping, names_of_arm, set(needed) & set(names_of_arm), names)
        return series

    def without_faults(self, arm: str, series: ArmSeries, hit: bool) -> tuple[ArmSeries, list[str]]:
        """Signals of an arm without outliers and frozen samples, and warnings about them."""
        return without_faults(series, self.mappings[arm], self.models[arm], hit)

    @contextmanager
    def errors_of(self, arm: str) -> Iterator[None]:
        """Prefix errors raised inside with the arm's name if there are several arms."""
        try:
            yield
        except InputError as error:
            if len(self.mappings) == 1:
                raise
            message = f"{self.label(arm)}{error.message}"
            raise type(error)(message, file=error.file, key=error.key, value=error.value) from None

    def label(self, arm: str) -> str:
        """Prefix of a message about an arm; empty with a single arm."""
        return f"arm {arm!r}: " if len(self.mappings) > 1 else ""

    def with_frame_from(self, touches: Sequence[PadOnFace]) -> Laboratory:
        """The laboratory with the motion-capture frame estimated from hits.

        Raises:
            InputError: There is no hit.
        """
        given = self.motion_capture
        frame = contact_frame(touches, np.array(given.position), given.rpy[2])
        x, y, z = (float(number) for number in frame.position)
        update = {"position": (x, y, z), "rpy": (*given.rpy[:2], frame.yaw)}
        return replace(self, motion_capture=given.model_copy(update=update), estimated_frame=frame)


def _where(mapping: SignalMapping, arm: str, name: SignalName) -> tuple[str | None, ...]:
    """Topic, file and fields of a signal of an arm."""
    source, names = mapping.signals[name], Names(arm=arm)
    parts = (source.topic, source.field, source.file, source.column, source.array, *(source.columns or ()))
    joints = mapping.joints if source.names else ()
    return tuple(None if part is None else names.fill(part) for part in (*parts, *joints))


def read_laboratory(directory: Path, experiment: Experiment, map_tasks: Map) -> tuple[list[Run], list[tuple[str, str]]]:
    """Every run of an experiment.

    Args:
        directory: Folder of the recordings.
        experiment: Describes them.
        map_tasks: Maps the reader over the runs.

    Returns:
        Runs in the order of the table; path and reason of the skipped runs.

    Raises:
        InputError: Experiment, table or a recording cannot be used; or no run remains.
    """
    laboratory = Laboratory.of(experiment)
    table = read_runs(directory, experiment, laboratory.scenario)
    read: list[Run] = []
    skipped: list[tuple[str, str]] = []
    laboratory = with_tracker_frame(laboratory, table, map_tasks)
    tasks = [(laboratory, run) for run in table]
    for run, result in zip(table, map_tasks(_try_to_read, tasks), strict=True):
        if isinstance(result, Run):
            read.append(result)
        elif isinstance(result, TooShort):
            skipped.append((str(run.path), result.message))
        else:
            raise result
    if not read:
        raise InputError(f"no run can be used; {Path(skipped[0][0]).name}: {skipped[0][1]}", file=directory)
    return read, skipped


def read_one(directory: Path, experiment: Experiment, name: str, map_tasks: Map) -> Run:
    """One run of an experiment; other runs are read only to place the motion capture.

    Args:
        directory: Folder of the recordings.
        experiment: Describes them.
        name: Name of the run (:func:`~impact_rs_trials.recordings.experiment.run_named`).
        map_tasks: Maps the reader over the runs.

    Raises:
        InputError: There is no such run, or experiment, table or recording cannot be used.
    """
    laboratory = Laboratory.of(experiment)
    table = read_runs(directory, experiment, laboratory.scenario)
    row = run_named(table, directory, name)
    return read_run(with_tracker_frame(laboratory, table, map_tasks), row)


def with_tracker_frame(laboratory: Laboratory, table: Sequence[RunRow], map_tasks: Map) -> Laboratory:
    """The laboratory with the frame of its motion capture, estimated from the hits if the experiment asks for it.

    Raises:
        InputError: No hit can be used for the estimate.
    """
    if not laboratory.motion_capture.estimate:
        return laboratory
    hits = [(laboratory, run) for run in table if run.hit]
    return laboratory.with_frame_from([touch for touches in map_tasks(touches_of, hits) for touch in touches])


def _try_to_read(task: tuple[Laboratory, RunRow]) -> Run | InputError:
    """:func:`read_run`; errors are returned, because dask retries tasks that raise."""
    try:
        return read_run(*task)
    except InputError as error:
        return error


def read_run(laboratory: Laboratory, run: RunRow) -> Run:
    """One run, checked.

    Raises:
        TooShort: The pieces between gaps are too short.
        InputError: The run cannot be used; the message states place, reason and remedy.
    """
    path, tracker = run.path, laboratory.tracker
    wanted: list[SignalName] = [*ARM_SIGNALS, "command", "wrench", *(OBJECT_SIGNALS if run.hit else ())]
    remarks: list[str] = []
    arms = on_clock_of_joints(laboratory, run, wanted, _needed(laboratory, run), remarks)
    faults: list[str] = []
    for arm, series in arms.items():
        with laboratory.errors_of(arm):
            for name, signal in series.items():
                _check(path, name, signal)
            arms[arm], left_out = laboratory.without_faults(arm, series, run.hit)
            faults += [f"{laboratory.label(arm)}{warning}" for warning in left_out]
            if any(arms[arm][name].time.size < MIN_RUN_SAMPLES for name in REQUIRED):
                raise TooShort("; ".join(faults), file=path)
    remarks += faults
    base = _fastest(arms)
    for arm, series in arms.items():
        with laboratory.errors_of(arm):
            _check_overlap(path, arms[base]["position"], series)
    origin = float(arms[base]["position"].time[0])  # numbers of the wall clock have no room for microseconds
    position = arms[base]["position"]
    began = origin if position.log is None or origin > MIN_WALL_CLOCK_S else float(position.log[0])
    arms = {
        arm: {name: replace(signal, time=signal.time - origin) for name, signal in series.items()}
        for arm, series in arms.items()
    }
    pose_series = arms[tracker].pop("object_pose", None)

    try:
        pieces, main = _pieces(run, arms, pose_series, remarks)
    except TooShort as error:
        raise TooShort("; ".join([error.message, *faults]), file=error.file) from None
    raw = arms[base]["position"].time
    grid = grid_from(raw[_inside(raw, pieces)], raw[_inside(raw, [main])])
    for arm, series in arms.items():
        _warn_of_rates(series["position"], grid, pieces, main if arm != base else None, remarks)
    _warn_of_pose_rate(pose_series, remarks)
    time = grid - grid[0]
    signals_of_arms = {arm: _arm_of(laboratory, run, arm, series, grid, remarks) for arm, series in arms.items()}
    object_time, pose = _part(pose_series, grid, np.zeros((0, 7)))
    if object_time.size:
        if laboratory.estimated_frame is not None:
            remarks.append(str(laboratory.estimated_frame))
        pose = in_inertial_frame(laboratory.motion_capture, run, pose)
        for arm, joints in signals_of_arms.items():
            with laboratory.errors_of(arm):
                remarks += _check_object(laboratory, run, arm, time, joints.position, object_time, pose)
    elif run.hit:
        remarks.append("the object was not tracked: it starts where the scenario places it")
    signals = Signals(time, _alike(signals_of_arms), object_time, pose[:, :3], pose[:, 3:])
    gaps_between = tuple((end - grid[0], start - grid[0]) for (_, end), (start, _) in itertools.pairwise(pieces))
    result = _in_scene(laboratory.scenario, run, signals, gaps_between, tuple(dict.fromkeys(remarks)))
    return replace(result, recorded=began if began > MIN_WALL_CLOCK_S else None)


def _alike(arms: Mapping[str, ArmSignals]) -> dict[str, ArmSignals]:
    """The arms with their common signals, because all arms of a replay have the same drive."""
    common = set.intersection(*(set(signals.measured) for signals in arms.values()))
    left_out = {name: NONE for signals in arms.values() for name in signals.measured if name not in {*common, "wrench"}}
    left_out |= {"command_time": NONE} if "command" in left_out else {}
    return {name: replace(signals, **left_out) for name, signals in arms.items()}


def _in_scene(
    scenario: Scenario, row: RunRow, signals: Signals, gaps: tuple[tuple[float, float], ...], remarks: tuple[str, ...]
) -> Run:
    """The run of a row of the table in the scene of its scenario."""
    object_name = row.object or next(iter(scenario.objects))
    object_state = resting_pose(scenario, object_name)
    if not row.hit:
        away = object_state.position + [OUT_OF_REACH_M, OUT_OF_REACH_M, 0.0]
        object_state = BodyState(away, object_state.rotation, object_state.twist)
    return Run(
        path=row.path,
        name=row.name,
        condition="/".join(part for part in (row.object or "free motion", row.condition) if part),
        condition_key=(scenario.name, row.object or "none", row.condition),
        hit=row.hit,
        physics=Physics.nominal(scenario, object_name),
        signals=signals,
        object=object_state,
        drive_period=scenario.timing.drive_period,
        axis=scenario.axis_index,
        gaps=gaps,
        remarks=remarks,
    )


def _needed(laboratory: Laboratory, run: RunRow) -> list[SignalName]:
    """Required signals of a run: the joints' signals, and further signals of the mappings."""
    in_mappings = {name for mapping in laboratory.mappings.values() for name in mapping.signals}
    optional: tuple[SignalName, ...] = ("command", *(OBJECT_SIGNALS if run.hit else ()))
    return [*REQUIRED, *(name for name in optional if name in in_mappings)]


def _fastest(arms: Mapping[str, ArmSeries]) -> str:
    """The arm with the shortest period of joint states; of equal ones the first."""
    return min(arms, key=lambda arm: round(float(np.median(np.diff(arms[arm]["position"].time))), 6))


def _arm_of(
    laboratory: Laboratory, run: RunRow, arm: str, series: ArmSeries, grid: Array, remarks: list[str]
) -> ArmSignals:
    """One arm on the grid of the run; warnings are appended to the remarks."""
    mapping, path = laboratory.mappings[arm], run.path
    joints = ArmSignals(**{name: _on_grid(series[name], grid) for name in ARM_SIGNALS if name in series})
    time, none = grid - grid[0], np.zeros((0, len(mapping.joints)))
    with laboratory.errors_of(arm):
        check_arm(path, time, joints, mapping, MAX_IMPACT_SHARE if run.hit else 0.0)
        remedy = "wrong sign or unit, or without the gravity torque?"
        check_gravity_torque(path, "torque", laboratory.models[arm], joints.position, joints.torque, remedy)
        warnings = arm_warnings(time, joints, mapping, laboratory.models[arm], run.hit)
        remarks += [remark("{}{}", laboratory.label(arm), warning) for warning in warnings]
        command_time, command = _part(series.get("command"), grid, none)
        if command_time.size:
            command = _with_gravity(laboratory, path, arm, time, joints.position, command_time, command)
        else:
            remarks.append(
                f"{laboratory.label(arm)}no command was recorded: the joint torque has to drive the replay, which "
                "hides gears and motors"
            )
    wrench_time, wrench = _part(series.get("wrench"), grid, np.zeros((0, 6)))
    return replace(joints, command_time=command_time, command=command, wrench_time=wrench_time, wrench=wrench)


# ---- stamps and gaps ------------------------------------------------------------------------------------------------


def with_object(path: Path, series: ArmSeries, remarks: list[str]) -> ArmSeries:
    """Signals with the pose as one signal, without the samples in which the object was not tracked.

    Args:
        path: File, for messages.
        series: Signals of an arm, or of an object alone.
        remarks: Warnings, appended to.

    Raises:
        InputError: Position and quaternion have different stamps, quaternions no unit length, or the object is never
            tracked.
    """
    series = dict(series)
    position, quaternion = series.pop("object_position", None), series.pop("object_quaternion", None)
    if position is not None and quaternion is not None:
        period = float(np.ptp(position.time)) / max(position.time.size - 1, 1)
        closest = max(MAX_GRID_ERROR_PERIODS * period, STAMP_ROUNDING_S)
        if position.time.size != quaternion.time.size or not np.allclose(
            position.time, quaternion.time, rtol=0.0, atol=closest
        ):
            raise InputError(
                f"{position.label} and {quaternion.label} have different time stamps; expected the same", file=path
            )
        values = np.hstack((position.values, quaternion.values))
        series["object_pose"] = replace(position, values=values)
    pose = series.get("object_pose")
    if pose is None:
        return series
    norm = np.linalg.norm(pose.values[:, 3:], axis=1)
    tracked = ~(np.isnan(pose.values[:, :3]).all(axis=1) | np.isnan(pose.values[:, 3:]).all(axis=1) | (norm == 0.0))
    if not np.any(tracked):
        raise InputError(f"{pose.label}: the object is not seen in any of {tracked.size} samples", file=path)
    lengths = norm[tracked & np.isfinite(norm)]
    if np.any(np.abs(lengths - 1.0) > MAX_NORM_ERROR):
        raise InputError(
            f"{pose.label}: quaternions have lengths of {lengths.min():.3g} ... {lengths.max():.3g}, expected 1: "
            "columns of something else?",
            file=path,
        )
    if not np.all(tracked):
        words = "{}: the object is not seen in {:d} of {:d} samples"
        remarks.append(remark(words, pose.label, int(np.sum(~tracked)), tracked.size))
    series["object_pose"] = pose.in_rows(tracked)
    return series


def on_clock_of_joints(
    laboratory: Laboratory,
    run: RunRow,
    wanted: Sequence[SignalName],
    needed: Sequence[SignalName],
    remarks: list[str],
) -> dict[str, ArmSeries]:
    """Signals of every arm, all on the clock of its joint positions, with the object's pose as one signal.

    Args:
        laboratory: Knows arms and mappings.
        run: The run.
        wanted: Signals to read, as far as a mapping has them.
        needed: Those of them that must be there.
        remarks: Warnings, appended to.

    Raises:
        InputError: A needed signal is missing, or a signal cannot be used.
    """
    arms = laboratory.series(run, wanted, needed)
    for arm, series in arms.items():
        with laboratory.errors_of(arm):
            arms[arm] = on_one_clock(run.path, series, laboratory.mappings[arm], laboratory.models[arm])
    remarks += dict.fromkeys(
        warning for series in arms.values() for signal in series.values() for warning in signal.remarks
    )
    if run.hit:
        arms[laboratory.tracker] = with_object(run.path, arms[laboratory.tracker], remarks)
        _start_in_the_impact(laboratory, run, arms, remarks)
    return arms


def _start_in_the_impact(laboratory: Laboratory, run: RunRow, arms: dict[str, ArmSeries], remarks: list[str]) -> None:
    """Bring the object's pose to the clock of the joints, where it has one of its own."""
    tracker, mapping = laboratory.tracker, laboratory.mappings[laboratory.tracker]
    name = next((name for name in OBJECT_SIGNALS if name in mapping.signals), None)
    if "object_pose" not in arms[tracker] or name is None or mapping.signals[name].clock == "shared":
        return
    pose = arms[tracker]["object_pose"]
    shifted_pose = shifted_to_impact(run.path, pose, arms[tracker]["position"], f"signals.{name}.clock")
    remarks += [warning for warning in shifted_pose.remarks if warning not in pose.remarks]
    arms[tracker] = {**arms[tracker], "object_pose": shifted_pose}


def _check(path: Path, name: SignalName, series: Series) -> None:
    """Check that stamps increase without a jump, and that numbers are finite."""
    if name in REQUIRED and series.time.size < MIN_RUN_SAMPLES:
        raise TooShort(f"{series.label}: {series.time.size} samples, at least {MIN_RUN_SAMPLES} are needed", file=path)
    check_stamps(path, series.label, series.time)
    if series.time.size > 1:
        largest = max(MIN_CLOCK_JUMP_S, 5.0 * float(np.median(np.diff(series.time))))
        check_jumps(path, series.label, series.time, series.log, largest, pauses=name in (*ARM_SIGNALS, "command"))
    not_finite = ~np.isfinite(series.values)
    if np.any(not_finite):
        row, column = np.argwhere(not_finite)[0]
        raise InputError(
            f"{series.label}: number {column + 1} is {series.values[row, column]} at t = "
            f"{series.time[row] - series.time[0]:.3f} s ({int(np.sum(not_finite.any(axis=1)))} of "
            f"{not_finite.shape[0]} samples); repair the file, or take the run out of the table",
            file=path,
        )


def _check_overlap(path: Path, base: Series, series: ArmSeries) -> None:
    """Check that every signal overlaps with the joint positions ``base`` in time."""
    for signal in series.values():
        if signal.time[-1] < base.time[0] or signal.time[0] > base.time[-1]:
            raise InputError(
                f"{signal.label} spans {signal.time[0]:.3f} ... {signal.time[-1]:.3f} s, {base.label} "
                f"{base.time[0]:.3f} ... {base.time[-1]:.3f} s: another clock, or another run? In the "
                "mapping signals.NAME.delay shifts a signal, and clock: own finds the offset from the motion",
                file=path,
            )


def _pieces(
    run: RunRow, arms: Mapping[str, ArmSeries], pose: Series | None, remarks: list[str]
) -> tuple[list[tuple[float, float]], tuple[float, float]]:
    """Pieces between gaps that are long enough, in order, and the main piece.

    The main piece is the longest piece. In a hit it is the piece with the impact, and no later piece is used.
    """
    start = max(float(series["position"].time[0]) for series in arms.values())
    end = min(float(series["position"].time[-1]) for series in arms.values())
    cuts: list[Gap] = []
    signals = [series.get(name) for series in arms.values() for name in (*ARM_SIGNALS, "command")]
    checked_times: list[Array] = []  # stamps that several signals share are checked once
    for signal in (*signals, pose):
        if signal is None or signal.time.size < 2 or any(np.array_equal(signal.time, time) for time in checked_times):
            continue
        checked_times.append(signal.time)
        periods = MIN_GAP_PERIODS * float(np.median(np.diff(signal.time)))
        signal_gaps = gaps(signal.time, max(MIN_REPORTED_GAP_S, periods))
        if not signal_gaps:
            continue
        remarks.append(
            f"{signal.label}: {'gaps' if len(signal_gaps) > 1 else 'a gap'} of {gaps_in_words(signal_gaps, start)}"
        )
        if signal is not pose:
            cuts += [
                gap
                for gap in signal_gaps
                if gap.length > MAX_INTERPOLATED_GAP_S and gap.end > start and gap.start < end
            ]
    if end - start < MIN_PIECE_S:
        raise TooShort(f"it lasts {end - start:.3f} s, at least {MIN_PIECE_S} s are needed", file=run.path)
    for series in arms.values():
        for time in (series["velocity"].time, series["torque"].time):  # missing samples at either end are a gap as well
            end_gaps = [Gap(start, float(time[0]) - start), Gap(float(time[-1]), end - float(time[-1]))]
            cuts += [gap for gap in end_gaps if gap.length > MAX_INTERPOLATED_GAP_S]
    impacts = [impact_time(series["position"], series["velocity"]) for series in arms.values()] if run.hit else []
    if any(not start <= impact <= end for impact in impacts):
        raise TooShort("the joint positions do not reach to the impact", file=run.path)
    if not cuts:
        return [(start, end)], (start, end)
    inside = [gap for gap in cuts if impacts and gap.start <= max(impacts) and min(impacts) <= gap.end]
    if inside:
        longest = max(inside, key=lambda gap: gap.length)
        raise TooShort(f"the impact falls into a gap of {gaps_in_words([longest], start)}", file=run.path)
    first = [start, *sorted(gap.end for gap in cuts)]
    last = [*sorted(gap.start for gap in cuts), end]
    between = [(a, b) for a, b in zip(first, last, strict=True) if b > a]
    if not between:
        raise TooShort("velocity and torque were never recorded at the same time", file=run.path)
    pieces = [piece for piece in between if piece[1] - piece[0] >= MIN_PIECE_S]
    main = max([p for p in between if all(p[0] <= impact <= p[1] for impact in impacts)], key=_length)
    if impacts:
        pieces = [piece for piece in pieces if piece[0] <= max(impacts)]
    if main not in pieces:
        with_impact = "with the impact " if run.hit else ""
        raise TooShort(
            f"gaps leave {_length(main):.3f} s {with_impact}in one piece, at least {MIN_PIECE_S} s are needed: gaps of "
            f"{gaps_in_words(sorted(cuts, key=lambda gap: gap.start), start)}",
            file=run.path,
        )
    remarks.append(f"cut to {_intervals(pieces, start)}, because of gaps > {MAX_INTERPOLATED_GAP_S:g} s")
    short = [piece for piece in between if _length(piece) < MIN_PIECE_S]
    after_impact = [piece for piece in between if piece not in pieces and piece not in short]
    if short:
        remarks.append(f"skipped, because it is shorter than {MIN_PIECE_S} s: {_intervals(short, start)}")
    if after_impact:
        remarks.append(f"skipped, because it comes after the impact and a gap: {_intervals(after_impact, start)}")
    return pieces, main


def _length(piece: tuple[float, float]) -> float:
    return piece[1] - piece[0]


def _intervals(pieces: list[tuple[float, float]], start: float) -> str:
    return ", ".join(f"{first - start:.3f} ... {last - start:.3f} s" for first, last in pieces)


def _inside(time: Array, pieces: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Which stamps lie in one of the pieces, ``(k,)``."""
    return np.any([(time >= first) & (time <= last) for first, last in pieces], axis=0)


def _on_grid(series: Series, grid: Array) -> Array:
    """One signal of the arm on the even grid, ``(k, n)``: samples where they lie on it, interpolated elsewhere."""
    nearest = np.clip(np.searchsorted(series.time, grid), 1, series.time.size - 1)
    nearest -= grid - series.time[nearest - 1] < series.time[nearest] - grid
    close = np.abs(series.time[nearest] - grid) < MAX_GRID_ERROR_PERIODS * (grid[1] - grid[0])
    return np.where(close[:, None], series.values[nearest], series.at(grid))


def _part(series: Series | None, grid: Array, none: Array) -> tuple[Array, Array]:
    """Stamps from the start of the grid, ``(p,)`` [s], and numbers of a signal around it, ``(p, c)``.

    A sample on the grid up to rounding gets exactly the time of the grid.
    """
    if series is None:
        return np.zeros(0), none
    inside = (series.time >= grid[0] - BEYOND_S) & (series.time <= grid[-1] + BEYOND_S)
    period = grid[1] - grid[0]
    nearest = grid[0] + period * np.rint((series.time[inside] - grid[0]) / period)
    time = np.where(np.abs(series.time[inside] - nearest) < STAMP_ROUNDING_S, nearest, series.time[inside])
    return time - grid[0], series.values[inside]


def _warn_of_rates(
    position: Series,
    grid: Array,
    pieces: Sequence[tuple[float, float]],
    main: tuple[float, float] | None,
    remarks: list[str],
) -> None:
    """Warn of uneven stamps of joints, and of a rate too low for contact forces.

    Args:
        position: Joint positions of one arm.
        grid: Grid of the run, ``(k,)`` [s].
        pieces: Used pieces.
        main: Main piece, for an arm whose stamps did not make the grid; None: they did.
        remarks: Warnings, appended to.
    """
    raw = position.time[_inside(position.time, pieces)]
    period = float(grid[1] - grid[0])
    if main is not None:
        arm_grid = even_grid(position.time[_inside(position.time, [main])])
        period = max(period, float(arm_grid[1] - arm_grid[0]))
    deviation = np.abs(raw - grid[0] - period * np.rint((raw - grid[0]) / period)) / period
    worst = float(np.percentile(deviation, 99.0))
    if worst > MAX_JITTER_PERIODS:
        words = "{}: stamps deviate by up to {:.0f} % of a period from an even grid; samples are interpolated onto it"
        remarks.append(remark(words, position.label, 100.0 * worst))
    if 1.0 / period < MIN_JOINT_RATE_HZ:
        words = "joints at {:.0f} Hz: the jump of an impact is seen, its force is not"
        remarks.append(remark(words, 1.0 / period))


def _warn_of_pose_rate(pose: Series | None, remarks: list[str]) -> None:
    """Warn of a tracker too slow for velocities right after an impact."""
    if pose is not None and pose.time.size > 1:
        rate = 1.0 / float(np.median(np.diff(pose.time)))
        if rate < MIN_POSE_RATE_HZ:
            words = (
                "object pose at {:.0f} Hz: where the object goes is seen, its velocity right after the impact is not"
            )
            remarks.append(remark(words, rate))


# ---- torques --------------------------------------------------------------------------------------------------------


def _with_gravity(
    laboratory: Laboratory, path: Path, arm: str, time: Array, position: Array, command_time: Array, command: Array
) -> Array:
    """Desired torque with gravity, ``(m, n)`` [N m]; checks ``command_includes_gravity`` against the numbers."""
    position_at_commands = np.column_stack([np.interp(command_time, time, column) for column in position.T])
    included, model = laboratory.mappings[arm].command_includes_gravity, laboratory.models[arm]
    with_gravity = command if included else command + gravity_torques(model, position_at_commands)
    remedy = (
        "command_includes_gravity: false in the mapping, where it comes without the gravity torque"
        if included
        else "command_includes_gravity: true in the mapping, where it holds the gravity torque already"
    )
    check_gravity_torque(path, "command", model, position_at_commands, with_gravity, remedy)
    return with_gravity


# ---- object ---------------------------------------------------------------------------------------------------------


def touches_of(task: tuple[Laboratory, RunRow]) -> list[PadOnFace]:
    """Pad and face of every arm in a hit, for the estimate of the motion-capture frame; empty if it cannot be read."""
    laboratory, run = task
    wanted: tuple[SignalName, ...] = ("position", "velocity", *OBJECT_SIGNALS)
    try:
        arms = on_clock_of_joints(laboratory, run, wanted, wanted[:2], [])
        pose = arms[laboratory.tracker].get("object_pose")
        cleaned = {arm: laboratory.without_faults(arm, series, run.hit)[0] for arm, series in arms.items()}
        touches = [_touch(laboratory, run, arm, series, pose) for arm, series in cleaned.items()]
    except InputError as error:
        logger.debug("%s: not used to place the motion capture: %s", run.name, error)
        return []
    # Arms that clamp an object move towards each other; the object moves with their mean.
    mean_displacement = np.mean([touch.pad_displacement for touch in touches], axis=0)
    return [replace(touch, pad_displacement=mean_displacement) for touch in touches]


def _touch(laboratory: Laboratory, run: RunRow, arm: str, series: ArmSeries, pose_series: Series | None) -> PadOnFace:
    assert run.object is not None
    joints, model = series["position"], laboratory.models[arm]
    if pose_series is None or pose_series.time.size < 2:
        raise InputError("the object was not tracked", file=run.path)
    motion_capture = laboratory.motion_capture
    tilted = motion_capture.model_copy(update={"position": (0.0, 0.0, 0.0), "rpy": (*motion_capture.rpy[:2], 0.0)})
    pose = in_inertial_frame(tilted, run, pose_series.values)  # with roll and pitch, which hits do not determine
    impact = impact_time(joints, series["velocity"])
    first, last = (impact + moment for moment in FLAT_CONTACT_S)
    times = pose_series.time[(pose_series.time >= first) & (pose_series.time <= last)]
    times = times if times.size else np.array([0.5 * (first + last)])
    pads = [model.placement(q) for q in joints.at(times)]
    in_tilted_frame = replace(pose_series, values=pose)
    objects = [pin.XYZQUATToSE3(row) for row in in_tilted_frame.at(times)]
    initial_pose = np.median(pose[pose_series.time <= pose_series.time[0] + FIRST_POSE_S], axis=0)
    size = np.array(laboratory.scenario.object(run.object).size)
    ends = np.array([impact, min(impact + CARRIED_S, float(joints.time[-1]), float(pose_series.time[-1]))])
    pad_displacement = np.diff([model.placement(q).translation[:2] for q in joints.at(ends)], axis=0)[0]
    return PadOnFace(
        run=run.name,
        pad=np.array([pad.translation for pad in pads]),
        pad_normal=np.array([pad.rotation[:, 2] for pad in pads]),
        position=np.array([placement.translation for placement in objects]),
        rotation=np.array([placement.rotation for placement in objects]),
        size=size,
        standing=height_on_support(laboratory.scenario, run.object, pin.XYZQUATToSE3(pose[0]).rotation),
        standing_height=float(initial_pose[2]),
        pad_displacement=pad_displacement,
        object_displacement=np.diff(in_tilted_frame.at(ends)[:, :2], axis=0)[0],
    )


def in_inertial_frame(motion_capture: MotionCapture, run: RunRow, pose: Array) -> Array:
    """Poses of the object in A, ``(p, 7)``, from poses of the tracked frame in the world of the motion capture.

    Args:
        motion_capture: Where its world is, and the object in the frame that is tracked.
        run: Knows the object.
        pose: As tracked, ``(p, 7)``.
    """
    assert run.object is not None
    world = motion_capture.placement
    body = motion_capture.bodies.get(run.object)
    inner = pin.SE3.Identity() if body is None else body.placement
    placed = np.empty_like(pose)
    for row, numbers in enumerate(pose):
        quaternion = numbers[3:] / np.linalg.norm(numbers[3:])
        placement = world * pin.SE3(pin.Quaternion(quaternion).matrix(), numbers[:3]) * inner
        placed[row] = pin.SE3ToXYZQUAT(placement)
        if row and placed[row, 3:] @ placed[row - 1, 3:] < 0.0:  # the same attitude has two quaternions
            placed[row, 3:] *= -1.0
    return placed


def _check_object(
    laboratory: Laboratory, run: RunRow, arm: str, time: Array, position: Array, object_time: Array, pose: Array
) -> list[str]:
    """Check that the object rests on the support and that the pad of an arm reaches it; returns warnings."""
    assert run.object is not None
    scenario = laboratory.scenario
    remarks = check_object(run.path, scenario, arm, run.object, object_time, pose)
    overlap = (object_time >= time[0]) & (object_time <= time[-1])
    if not np.any(overlap):
        return remarks
    position_at_poses = np.column_stack([np.interp(object_time[overlap], time, column) for column in position.T])
    model = laboratory.models[arm]
    touch_warnings = check_touch(run.path, scenario, model, run.object, position_at_poses, pose[overlap])
    slow_tracker = object_time.size > 1 and float(np.median(np.diff(object_time))) > 1.0 / MIN_POSE_RATE_HZ
    if slow_tracker:  # which does not record where pad and object meet
        return remarks
    return [*remarks, *(remark("{}{}", laboratory.label(arm), warning) for warning in touch_warnings)]
