# SPDX-License-Identifier: Apache-2.0
"""Measured runs: windows, start of the replay and features of each; and all runs of a folder."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.replays.features import extract, layout, pushes_recorded
from impact_rs_analysis.evidence.replays.impacts import impacts_of
from impact_rs_analysis.evidence.replays.replay import Window, free_starts, replays, windows_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.bags.checksums import declares_checksums, unsealed_words
from impact_rs_trials.bags.reader import BagError, TrialBag, reason_of, recorded_at, stamped_at
from impact_rs_trials.runs import DriveName, Run, Signals, label_of
from impact_rs_trials.since import measured_since
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.store import trials_below
from impact_rs_trials.workers import Map

Made = TypeVar("Made")
CACHED_MODELS = 64  # per process
MAX_DROPPED_WINDOW_SHARE = 0.5  # of the windows of free motion, dropped from all runs because some have a gap there
MAX_FEATURE = 1e9  # in its SI unit; squares of such numbers overflow, and leave no belief


@dataclass(frozen=True)
class Setup:
    """Start state and inputs of a replay; small, because it is sent to worker processes.

    Attributes:
        windows: The windows of the replay.
        physics: Nominal physics of the scene.
        drive_period: Period of the torque loop [s].
        drive: Model between the recorded torque and the links.
        motor: Whether motor position and velocity are used.
        bodies: Names of the tracked objects whose features are used: ``object``, then its neighbours.
        pushes: Number of bins of the push; None: free motion.
        used: Indices of the features that are used, in the layout.
        levels: By arm, loss of speed that marks the begin of the impact [m/s].
    """

    windows: tuple[Window, ...]
    physics: Physics
    drive_period: float
    drive: DriveName
    motor: bool
    bodies: tuple[str, ...]
    pushes: int | None
    used: tuple[int, ...]
    levels: dict[str, float]

    @cached_property
    def digest(self) -> str:
        """Digest of the content."""
        facts = self.physics, self.drive_period, self.drive, self.motor, bool(self.bodies), self.pushes, self.used
        with np.printoptions(floatmode="unique", threshold=sys.maxsize):  # to the last bit
            text = [repr((facts, self.levels)), *self.bodies[1:]]  # digests of documents from before stay
            text += [repr(arm.tool_spring) for arm in self.physics.arms.values() if arm.tool_spring is not None]
            text += [repr(self.physics.object.guide)] if self.physics.object.guide is not None else []
        for window in self.windows:
            text.append(repr(window.contact))
            text += [hashlib.sha256(times.tobytes()).hexdigest() for times in window.neighbour_times.values()]
            arrays = [
                window.time,
                window.tracked_times,
                window.object.position,
                window.object.rotation,
                window.object.twist,
            ]
            for name, arm in window.arms.items():
                drive = window.drives[name]
                arrays += [arm.position, arm.velocity, drive.torque, drive.torque_rate]
                arrays += [np.append(moment, torque) for moment, torque in drive.earlier]
                arrays += [window.torque[name], window.acting[name].astype(float), window.before.get(name, np.zeros(0))]
                arrays += [window.start_from_velocity(name), np.array([window.age])]
            text += [hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest() for array in arrays]
        return hashlib.sha256("\n".join(text).encode()).hexdigest()

    @property
    def free_motion_part(self) -> Setup:
        """The windows of free motion, with their features."""
        return self._part(contact=False)

    def _part(self, contact: bool) -> Setup:
        """The window about the impact, or the windows of free motion, with their features."""
        windows = tuple(window for window in self.windows if window.contact == contact)
        part_features = [index for index, feature in enumerate(self._layout) if (feature.phase != "free") == contact]
        used = tuple(part_features.index(index) for index in self.used if index in part_features)
        if contact:
            return replace(self, windows=windows, used=used)
        return replace(self, windows=windows, used=used, pushes=None, bodies=())

    @cached_property
    def parts(self) -> tuple[tuple[Setup, NDArray[np.intp]], ...]:
        """Free motion and contact as separate setups, each with the indices of its features.

        The windows of a replay do not depend on each other, and an effect may act in one part only.
        """
        contact = np.array([self._layout[number].phase != "free" for number in self.used])
        if np.all(contact == contact[:1]):
            return ((self, np.arange(contact.size)),)
        return tuple((self._part(which), np.flatnonzero(contact == which)) for which in (False, True))

    @property
    def contact(self) -> bool:
        """Whether it has the window about an impact."""
        return self.pushes is not None

    @property
    def _layout(self) -> tuple[Feature, ...]:
        """Every feature of its windows, used or not."""
        free = sum(not window.contact for window in self.windows)
        return layout(self.physics.arm_joints, free, self.pushes, self.drive == "command", self.motor, self.bodies)

    @cached_property
    def _nominal(self) -> str:
        """Nominal physics of the arms as text; setups of equal arms share their rigid-body models."""
        with np.printoptions(floatmode="unique", threshold=sys.maxsize):  # to the last bit
            return repr((self.physics.arms, self.physics.gravity))

    def features_of(self, signals: Sequence[Signals]) -> Array | None:
        """Features of its windows, measured or replayed, ``(F,)``; None without an expected impact."""
        return self.features_of_all([signals])[0]

    def features_of_all(self, simulations: Sequence[Sequence[Signals]]) -> list[Array | None]:
        """Features of several simulations of its windows, ``(F,)`` each; None without an expected impact.

        Features of an unstable simulation are NaN.
        """
        stable = [all(map(_finite, windows)) for windows in simulations]
        if not all(stable):
            rows = iter(
                self.features_of_all([windows for windows, finite in zip(simulations, stable, strict=True) if finite])
            )
            return [next(rows) if finite else np.full(len(self.used), np.nan) for finite in stable]
        if not simulations:
            return []
        arms = {
            name: (arm, _models.of((self._nominal, name), partial(self.physics.robot_model, name)))
            for name, arm in self.physics.arms.items()
        }
        features = extract(
            [Signals.stack(windows) for windows in zip(*simulations, strict=True)],
            [
                {name: window.commanded(name) for name in window.torque} if self.drive == "command" else {}
                for window in self.windows
            ],
            [window.contact for window in self.windows],
            arms,
            self.motor,
            self.bodies,
            self.pushes,
            self.levels,
        )
        columns = list(self.used)
        return [None if row is None else row[columns] for row in features]

    def replayed(self, physics: Physics) -> list[Signals]:
        """Simulation of the windows under other physics.

        Raises:
            NotABody: Mass and inertia of an end effector are not those of a body.
        """
        return self.replayed_all([physics])[0]

    def replayed_all(self, physics: Sequence[Physics], threads: int = 1) -> list[list[Signals]]:
        """Simulations of the windows, one under each physics, as :meth:`replayed`."""
        return replays([(self.windows, variant) for variant in physics], self.drive_period, self.drive, threads)


def _finite(signals: Signals) -> bool:
    """Whether the signals of all arms are finite."""
    return all(np.isfinite(arm.torque).all() and np.isfinite(arm.velocity).all() for arm in signals.arms.values())


@dataclass(frozen=True, kw_only=True)
class MeasuredRun(Run):
    """A run with its features.

    Attributes:
        setup: Start state and inputs of a replay.
        features: Description of the entries of its feature vector.
        measured: Measured features, ``(F,)``.
        impacts: Begin of the impact by arm [s]; empty in free motion.
        free: Number of windows of free motion, including those with gaps.
    """

    setup: Setup
    features: tuple[Feature, ...]
    measured: Array
    impacts: dict[str, float]
    free: int

    @classmethod
    def of(cls, run: Run) -> MeasuredRun:
        """Find the impact, cut the run into windows, and compute their features.

        Raises:
            InputError: An expected impact is missing, or the signals do not cover the windows.
        """
        impact_levels = impacts_of(run) if run.hit else {}
        impacts = {name: begin for name, (begin, _) in impact_levels.items()}
        windows = windows_of(run, impacts)
        starts = free_starts(run, impacts)
        if not windows:
            reason = "gaps leave no window" if starts else "no joint moves for the length of a window"
            raise InputError(f"{reason} of free motion")
        pushes = pushes_recorded(max(impacts.values()), float(windows[-1].time[-1])) if impacts else None
        tracked = tuple(name for name, poses in run.signals.poses.items() if impacts and poses.time.size > 1)
        bodies = tracked if "object" in tracked else ()
        numbers = [window.number for window in windows if not window.contact]
        features = layout(
            run.physics.arm_joints,
            len(numbers),
            pushes,
            run.commanded,
            run.motor_measured,
            bodies,
        )
        size = Proportion.of(run.physics)
        features = tuple(replace(f, relevance_limit=f.relevance_limit * size.factor(f.unit)) for f in features)
        if run.gaps:  # a window keeps its number among all windows, so that repeats agree
            features = tuple(replace(f, bin=numbers[f.bin]) if f.phase == "free" else f for f in features)
        setup = Setup(
            windows=tuple(windows),
            physics=run.physics,
            drive_period=run.drive_period,
            drive=run.drive,
            motor=run.motor_measured,
            bodies=bodies,
            pushes=pushes,
            used=tuple(range(len(features))),
            levels={name: level for name, (_, level) in impact_levels.items()},
        )
        measured = setup.features_of([_within(run.signals, window) for window in windows])
        if measured is None:
            raise InputError("no impact found: the end effector loses no speed")
        if not np.isfinite(measured).all():
            raise InputError("its signals do not cover the windows about the impact")
        largest = int(np.argmax(np.abs(measured)))
        if abs(measured[largest]) > MAX_FEATURE:
            feature = features[largest]
            raise InputError(
                f"{feature.signal} {feature.index} of {measured[largest]:.3g} {feature.unit}, which no sensor measures"
            )
        return cls(
            **vars(run),
            setup=setup,
            features=features,
            measured=measured,
            impacts=impacts,
            free=len(starts),
        )

    @property
    def windowed(self) -> tuple[Signals, ...]:
        """Signals in its windows."""
        return tuple(_within(self.signals, window) for window in self.setup.windows)

    @property
    def lost(self) -> tuple[int, ...]:
        """Windows of free motion dropped for gaps, in this run or in a repeat."""
        return tuple(sorted(set(range(self.free)) - {f.bin for f in self.features if f.phase == "free"}))

    @property
    def family(self) -> tuple[object, ...]:
        """Key of runs that have equal features without gaps."""
        further = tuple(feature for feature in self.features if feature.phase != "free")
        return (self.hit, *self.setup.physics.arms, self.free, further)

    def only(self, features: set[Feature]) -> MeasuredRun:
        """The run with some of its features."""
        rows = [number for number, feature in enumerate(self.features) if feature in features]
        if len(rows) == len(self.features):
            return self
        used = tuple(self.setup.used[row] for row in rows)
        return replace(
            self,
            setup=replace(self.setup, used=used),
            features=tuple(self.features[row] for row in rows),
            measured=self.measured[rows],
        )

    def aged(self, age: float) -> MeasuredRun:
        """The run with another time since the first run [s]."""
        windows = tuple(replace(window, age=age) for window in self.setup.windows)
        return replace(self, setup=replace(self.setup, windows=windows))


def _within(signals: Signals, window: Window) -> Signals:
    """Signals in a window."""
    first = int(np.argmin(np.abs(signals.time - window.time[0])))
    rows = slice(first, first + window.time.size)
    arms = {name: arm.at(rows) for name, arm in signals.arms.items()}
    poses = signals.object.at(window.tracked_times)
    neighbours = {name: signals.neighbours[name].at(times) for name, times in window.neighbour_times.items()}
    return Signals(window.time, arms, poses.time, poses.position, poses.quaternion, neighbours)


_models = Recent[RobotModel](CACHED_MODELS)


@dataclass(frozen=True)
class Runs:
    """The usable runs of a folder.

    Attributes:
        directory: The folder.
        runs: Measured runs; repeats of a condition have the same features.
        skipped: Path and reason of every bag that cannot be used.
        remarks: Remarks on how they were read.
        clock: See :class:`~impact_rs_analysis.evidence.source.Source` [s].
        late: By condition, its first run with commands that act one standard deviation of their clock later; empty if
            the clock is known.
        part: Whether the user left out runs of the folder.
    """

    directory: Path
    runs: tuple[MeasuredRun, ...]
    skipped: tuple[tuple[str, str], ...]
    remarks: tuple[str, ...] = ()
    clock: float = 0.0
    late: Mapping[str, MeasuredRun] = field(default_factory=dict)
    part: bool = False

    @property
    def digest(self) -> str:
        """Digest of the runs, independent of their location."""
        if all(run.spec is not None for run in self.runs):
            return _digest([run.path for run in self.runs]) if self.part else runs_digest(self.directory)
        rows = sorted(f"{run.condition} {run.setup.digest}" for run in self.runs)
        return hashlib.sha256("\n".join(rows).encode()).hexdigest()[:16]

    @property
    def recorded(self) -> float | None:
        """Time of the last trial, simulated or not, seconds since 1970; None: not known."""
        stamps = (stamped_at(run.path) if run.recorded is None else run.recorded for run in self.runs)
        return max((stamp for stamp in stamps if stamp is not None), default=None)

    @property
    def conditions(self) -> dict[str, list[MeasuredRun]]:
        """Repeats by condition, in order of appearance."""
        repeats: dict[str, list[MeasuredRun]] = {}
        for run in self.runs:
            repeats.setdefault(run.condition, []).append(run)
        return repeats

    def since(self, when: str) -> Runs:
        """The runs that were measured from a given time on.

        Args:
            when: A run by its path in the folder, or a time (:func:`impact_rs_trials.since.measured_since`).

        Raises:
            InputError: There is no such time.
        """
        names = {run.path: run.path.relative_to(self.directory).as_posix() for run in self.runs}
        stamps = {names[run.path]: recorded_at(run.path) if run.recorded is None else run.recorded for run in self.runs}
        names_since = measured_since(when, stamps)
        runs = tuple(run for run in self.runs if names[run.path] in names_since)
        return replace(self.only(runs, f"only runs since {when}: {len(runs)} of {len(self.runs)}"), part=True)

    def only(self, runs: Sequence[MeasuredRun], remark: str) -> Runs:
        """Some of the runs, with a remark on the others."""
        paths = {run.path for run in runs}
        late = {condition: run for condition, run in self.late.items() if run.path in paths}
        return replace(self, runs=tuple(runs), remarks=(*self.remarks, remark), late=late)

    def named(self, specs: Mapping[Path, TrialSpec]) -> Runs:
        """The runs with the condition names of the planned trials.

        Args:
            specs: Planned trials, by the path of each run.
        """

        def named(run: MeasuredRun) -> MeasuredRun:
            spec = specs[run.path]
            return replace(run, condition=label_of(spec), condition_key=(spec.scenario.name, spec.object, spec.case))

        late = {label_of(specs[run.path]): named(run) for run in self.late.values()}
        return replace(self, runs=tuple(map(named, self.runs)), late=late)

    @staticmethod
    def of(directory: Path, results: Iterable[MeasuredRun | tuple[str, str]]) -> Runs:
        """Runs from the results of reading.

        Raises:
            InputError: No run can be used.
        """
        listed = list(results)
        runs = [result for result in listed if isinstance(result, MeasuredRun)]
        skipped = tuple(result for result in listed if not isinstance(result, MeasuredRun))
        if not runs:
            reason = f"; {len(skipped)} bag(s) cannot be used, the first because: {skipped[0][1]}" if skipped else ""
            raise InputError(f"no usable trials here{reason}", file=directory)
        common: dict[str, set] = {}
        free: dict[str, int] = {}  # a shorter repeat has fewer windows, even without gaps
        for run in runs:
            common.setdefault(run.condition, set(run.features)).intersection_update(run.features)
            free[run.condition] = min(run.free, free.get(run.condition, run.free))
        shared = [replace(run.only(common[run.condition]), free=free[run.condition]) for run in runs]
        return Runs(directory, _with_equal_windows(_with_ages(shared)), skipped)


def _with_ages(runs: list[MeasuredRun]) -> list[MeasuredRun]:
    """The runs with the mean time of their condition since the first run [s], where all times are known."""
    times: dict[str, list[float]] = {}
    for run in runs:
        times.setdefault(run.condition, []).append(np.nan if run.recorded is None else run.recorded)
    first = min(min(recorded) for recorded in times.values())
    if any(np.isnan(recorded).any() for recorded in times.values()):
        return runs
    return [run.aged(float(np.mean(times[run.condition])) - first) for run in runs]


def _with_equal_windows(runs: list[MeasuredRun]) -> tuple[MeasuredRun, ...]:
    """The runs without windows that have a gap in any run of their family, so that conditions share a pure error.

    If that would drop more than ``MAX_DROPPED_WINDOW_SHARE`` of the windows, the runs stay unchanged.
    """
    shared: dict[tuple[object, ...], set[Feature]] = {}
    for run in runs:
        shared.setdefault(run.family, set(run.features)).intersection_update(run.features)
    alike = [run.only(shared[run.family]) for run in runs]
    torn = {run.family for run in alike if len(run.lost) > MAX_DROPPED_WINDOW_SHARE * run.free}
    return tuple(old if old.family in torn else new for old, new in zip(runs, alike, strict=True))


def read_trial(path: Path) -> MeasuredRun | tuple[str, str]:
    """One trial, or its path and the reason why it cannot be used."""
    try:
        bag = TrialBag.open(path)
        if bag.outcome not in ("OK", "DROPPED", "EARLY"):
            return str(path), f"{bag.outcome}: {bag.reason}"
        return MeasuredRun.of(bag.run())
    except Exception as error:  # a damaged bag must not stop the others
        return str(path), reason_of(error)


def read_runs(directory: Path, map_tasks: Map) -> Runs:
    """Read every trial below a folder.

    Raises:
        InputError: The folder does not exist or holds no usable trial.
    """
    bags = trials_below(directory)
    runs = Runs.of(directory, map_tasks(read_trial, bags))
    skipped = {path for path, _ in runs.skipped}
    remark = unsealed_words(sum(not declares_checksums(bag) for bag in bags if str(bag) not in skipped))
    of_runs = dict.fromkeys(remark for run in runs.runs for remark in run.remarks)
    return replace(runs, remarks=(*((remark,) if remark else ()), *of_runs))


def runs_digest(directory: Path) -> str:
    """Digest of the trials in a folder: names, scenarios and seeds, independent of its location."""
    return _digest(trials_below(directory))


def _digest(bags: Iterable[Path]) -> str:
    """Digest of some trials."""
    rows = []
    for path in bags:
        try:
            info = TrialBag.open(path).info
        except BagError:  # not a usable trial
            continue
        scenario = hashlib.sha256(info.scenario_json.encode()).hexdigest()
        rows.append(f"{path.name} {scenario} {info.seed}")
    return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()[:16]
