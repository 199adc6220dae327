# SPDX-License-Identifier: Apache-2.0
"""Measurements that commands compare with a model: own trials, recordings of other robots, tables of impacts."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from impact_rs_analysis.diagnosis.bounds import read_ranges
from impact_rs_analysis.evidence.calibration import NO_CALIBRATION, LaboratoryCalibration, calibration_of
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.command_clock import read_laboratory_runs
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY, Discrepancy
from impact_rs_analysis.evidence.impact_tables import ImpactTableSource
from impact_rs_analysis.evidence.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_analysis.evidence.measured_runs import Runs, read_runs
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_cli.arguments import started, warn_skipped
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.model import Model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.impact_table import read_impact_table
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import is_foreign, read_long_enough
from impact_rs_trials.workers import Map

DEFAULT_MAPPING = "joint_state"
EXPECTED_RANGE = "expected NAME=LOW:HIGH, for example size_z=0.09:0.11, or a YAML file"
NO_MINUS = "--minus goes with recordings of free motion: RUNS and UNLOADED are recordings with one mapping (--mapping)"


class Measurements:
    """Measurements that were read once, for comparison with any model.

    Args:
        map_tasks: Parallel map.
        terminal: Shows the progress.
        source: Makes the source of evidence for a model; replays go through the store.
        trials: Trials; None: something else.
        what: Description of the measurements.
        calibration: Faults of the readings.
    """

    def __init__(
        self,
        map_tasks: Map,
        terminal: Terminal,
        source: Callable[[Model, ReplayCache], Source],
        trials: Runs | None = None,
        what: str = "trials",
        calibration: LaboratoryCalibration = NO_CALIBRATION,
    ) -> None:
        self.trials, self.what, self.calibration = trials, what, calibration
        self._map, self._terminal, self._source = map_tasks, terminal, source
        self._stage = lambda *_: None
        self._store = ReplayCache(map_tasks, lambda what, done, total: self._stage(what, done, total))
        self._sources: dict[str, Source] = {}

    @classmethod
    def of_trials(
        cls,
        map_tasks: Map,
        terminal: Terminal,
        trials: Runs,
        discrepancy: Discrepancy | None = None,
        each_arm: bool = False,
        calibration: LaboratoryCalibration = NO_CALIBRATION,
    ) -> Self:
        """Trials, or runs of another controller.

        Args:
            map_tasks: Parallel map.
            terminal: Shows the progress.
            trials: The runs.
            discrepancy: Of the simulation; None: as measured.
            each_arm: Whether arms of one kind have parameters of their own.
            calibration: Faults of the readings.
        """

        def source(model: Model, store: ReplayCache) -> Source:
            return ReplaySource.of(trials, model, store, discrepancy, each_arm)

        return cls(map_tasks, terminal, source, trials, calibration=calibration)

    @contextmanager
    def progress(self) -> Iterator[None]:
        """Show the progress of the work inside."""
        with self._terminal.stages() as stage:
            self._stage = stage
            try:
                yield
            finally:
                self._stage = lambda *_: None

    def against(self, model: Model) -> Source:
        """The measurements against a model, with the faults of the readings.

        Raises:
            InputError: With this model nothing is hit, or the model blows up; a recording cannot be used; model and
                calibration do not fit together.
        """
        return self.uncalibrated(self.calibration.of(model))

    def uncalibrated(self, model: Model) -> Source:
        """As :meth:`against`, without the faults of the readings."""
        key = f"{model.digest} {[spec.name for spec in model.formulas]} {model.arms}"
        if key not in self._sources:
            self._sources[key] = self._source(model, self._store)
        return self._sources[key]

    def tracks(self, model: Model, added: Added = ()) -> tuple[Track, ...]:
        """Measured and predicted signals over time, for reports.

        Args:
            model: The model.
            added: Effects found in addition; for recordings and impacts shown next to the model.
        """
        return self.against(model).tracks(self._map, added)


@contextmanager
def measured(
    args: argparse.Namespace, terminal: Terminal, each_arm: bool = False, unsure: Sequence[str] = ()
) -> Iterator[Measurements]:
    """Read RUNS and warn of omitted ones; the workers end with the context.

    Args:
        args: Arguments of the command.
        terminal: Shows warnings and progress.
        each_arm: Whether arms of one kind have parameters of their own.
        unsure: Ranges of uncertain quantities of an impact table, ``NAME=LOW:HIGH``.

    Raises:
        InputError: There is no usable measurement.
    """
    if args.scenario is not None and args.impacts is None:
        raise InputError(
            "--scenario goes with --impacts only: trials contain their scenario, and recordings have a mapping"
        )
    tolerance = args.contact_tolerance
    if tolerance is not None and args.impacts is None:
        raise InputError("--contact-tolerance goes with --impacts only: trials are replayed from their poses")
    if unsure and args.impacts is None:
        raise InputError("--unsure goes with --impacts only; ranges of effects are given with --bounds")
    if args.covariates and args.impacts is None:
        raise InputError("--covariates goes with --impacts only: they are columns of the table")
    if tolerance is not None and not tolerance >= 0.0:
        raise InputError("expected a distance >= 0 m", key="--contact-tolerance", value=tolerance)
    if args.impacts is not None:
        if args.minus is not None:
            raise InputError(NO_MINUS)
        if args.experiment is not None:
            raise InputError(
                "--experiment is for folders of runs; leave it out with --impacts (--scenario names the robots)"
            )
        if args.mapping is not None:
            raise InputError("--mapping is for recordings; leave it out with --impacts, whose columns are fixed")
        scenario = None if args.scenario is None else load_scenario(args.scenario)
        table = read_impact_table(
            args.impacts,
            scenario,
            tolerance=GAP_TOLERANCE if tolerance is None else tolerance,
            covariates=args.covariates,
            unsure=read_ranges(unsure, "--unsure", EXPECTED_RANGE),
        )
        if args.since is not None:
            table = table.since(args.since)
        calibration = _calibration(Path(args.impacts), args, terminal)
        with started(args) as map_tasks:
            yield Measurements(
                map_tasks,
                terminal,
                lambda model, _: ImpactTableSource(
                    table, model, each_arm, NO_MAP_DISCREPANCY if args.no_discrepancy else None, map_tasks=map_tasks
                ),
                what="tables of impacts",
                calibration=calibration,
            )
        return
    discrepancy = NO_DISCREPANCY if args.no_discrepancy else None
    path = Path(args.runs)
    calibration = _calibration(path, args, terminal)
    if args.minus is not None and (args.experiment is not None or (args.mapping is None and not is_foreign(path))):
        raise InputError(NO_MINUS)
    with started(args) as map_tasks:
        if args.experiment is not None:
            if args.mapping is not None:
                raise InputError("--mapping and --experiment exclude each other: the experiment file names the mapping")
            trials = read_experiment(path, args.experiment, map_tasks, terminal)
        elif args.mapping is not None or is_foreign(path):
            if args.since is not None:
                raise InputError("--since goes with trials and with --impacts; leave it out for recordings")
            mapping = load_mapping(args.mapping or DEFAULT_MAPPING)
            recordings, left_out = read_long_enough(path, mapping)
            minus, short = ([], []) if args.minus is None else read_long_enough(args.minus, mapping)
            yield Measurements(
                map_tasks,
                terminal,
                lambda model, _: RecordingSource.of(recordings, mapping, model, minus, [*left_out, *short]),
                what="recordings without a scenario",
                calibration=calibration,
            )
            return
        else:
            trials = read(path, map_tasks, terminal)
        if args.since is not None:
            trials = trials.since(args.since)
        yield Measurements.of_trials(map_tasks, terminal, trials, discrepancy, each_arm, calibration)


def _calibration(data: Path, args: argparse.Namespace, terminal: Terminal) -> LaboratoryCalibration:
    """The calibration that belongs to measurements, with a word on it."""
    calibration = calibration_of(data, args.calibration)
    if calibration:
        terminal.say(f"calibration of the readings: {calibration.text}")
    return calibration


def experiment_file(given: Path, directory: Path, terminal: Terminal) -> Path:
    """The experiment file that a path on the command line names.

    Relative to the working directory as any path, or else to the folder of the runs.

    Args:
        given: The path.
        directory: Folder of the runs.
        terminal: Reports the chosen file if both are possible.

    Raises:
        InputError: There is no such file in either folder.
    """
    beside = directory / given
    if given.is_absolute() or beside.absolute() == given.absolute():
        return given
    if not given.exists() and not beside.exists():
        raise InputError(f"no such file in {Path.cwd()} or in the folder of the runs, {directory}", file=given)
    file = given if given.exists() else beside
    terminal.say(f"experiment: {file.absolute()}")
    if file is given and beside.exists() and not given.samefile(beside):
        terminal.warn(f"there is another {given} in the folder of the runs, which was not read: {beside.absolute()}")
    return file


def read_experiment(directory: Path, file: Path, map_tasks: Map, terminal: Terminal) -> Runs:
    """Read the runs of an experiment file and warn of omitted ones.

    Args:
        directory: Folder of the runs.
        file: The experiment file, see :func:`experiment_file`.
        map_tasks: Parallel map.
        terminal: Shows warnings and progress.

    Raises:
        InputError: The file, its table or a recording cannot be used.
    """
    experiment = load_experiment(experiment_file(file, directory, terminal))
    with terminal.progress("reading runs") as report_progress:
        runs = read_laboratory_runs(directory.absolute(), experiment, _counted(map_tasks, report_progress))
    warn_skipped(runs.skipped, terminal)
    return runs


def _counted(map_tasks: Map, report_progress: Callable[[int, int], None]) -> Map:
    """A map that reports its progress."""

    def counted(function: Any, items: Any) -> Iterator[Any]:
        for number, result in enumerate(map_tasks(function, items), start=1):
            report_progress(number, len(items))
            yield result

    return counted


def read(directory: Path, map_tasks: Map, terminal: Terminal) -> Runs:
    """Read trials and warn of omitted ones."""
    directory = directory.absolute()  # a worker process may stand elsewhere
    with terminal.progress("reading bags") as report_progress:
        runs = read_runs(directory, _counted(map_tasks, report_progress))
    warn_skipped(runs.skipped, terminal)
    return runs


def only_trials(measurements: Measurements, option: str) -> Runs:
    """The trials, for an option that does not exist for recordings.

    Raises:
        InputError: Recordings or a table of impacts were read.
    """
    if measurements.trials is None:
        raise InputError(f"{option} is for trials; for {measurements.what} use --json or the report")
    return measurements.trials
