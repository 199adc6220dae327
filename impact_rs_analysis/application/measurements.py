# SPDX-License-Identifier: Apache-2.0
"""Measurements to compare with a model: trials, runs of a laboratory, recordings of free motion, a table of impacts.

``MeasurementOptions`` selects measurements, ``open_measurements`` reads them once, and ``Measurements.against``
compares them with any model::

    measurements = open_measurements(MeasurementOptions(runs=Path("campaigns/example")))
    source = measurements.against(load_model("nominal"))
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from impact_rs_analysis.application.observer import SILENT, Observer, Report, warn_skipped
from impact_rs_analysis.evidence.calibration import NO_CALIBRATION, LaboratoryCalibration, calibration_of
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY, Discrepancy
from impact_rs_analysis.evidence.replays.command_clock import read_laboratory_runs
from impact_rs_analysis.evidence.replays.measured_runs import Runs, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.file_names import experiment_file_in
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable, read_impact_table
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.recording import is_foreign, read_long_enough
from impact_rs_trials.workers import Map

DEFAULT_MAPPING = "joint_state"

MIN_PARALLEL_RUNS = 50  # fewer are read faster in one process: 0.2 s per run, against seconds to start workers
SourceOfModel = Callable[[Model, ReplayCache], Source]  # the cache keeps the replays of runs


class MeasurementKind(StrEnum):
    """Kinds of measurements, in words."""

    TRIALS = "trials"
    LABORATORY = "runs of a laboratory"
    RECORDINGS = "recordings without a scenario"
    IMPACTS = "tables of impacts"


@dataclass(frozen=True)
class MeasurementOptions:
    """Which measurements are read, and how. Either ``runs`` or ``impacts`` is given.

    Attributes:
        runs: Folder of trials, of runs or of recordings, or one recording.
        impacts: Table of impacts.
        experiment: Experiment file of a laboratory's runs; None: the file in their folder, unless ``mapping`` or
            ``minus`` marks them as recordings of free motion. Without such a file they are trials or recordings.
        mapping: Mapping of recordings, by name or path; None: ``joint_state`` where the files are no trials.
        minus: Recordings of the same motion without the payload, whose torque is subtracted.
        scenario: Scenario of a table of impacts, by name or path; None: free bodies.
        contact_tolerance: Largest distance of a contact point of a table of impacts beyond the nearest one [m]; None:
            the default.
        covariates: Further columns of a table of impacts on which an effect may depend.
        unsure: Ranges of uncertain quantities of an impact table, by name.
        since: Time, run or row; earlier measurements are left out.
        calibration: Model file of faults of the readings; None: the file next to the measurements, if there is one.
        exact: Whether the model discrepancy of simulation or impact map is ignored.
        each_arm: Whether arms of one kind have separate parameters.
    """

    runs: Path | None = None
    impacts: Path | None = None
    experiment: Path | None = None
    mapping: str | None = None
    minus: Path | None = None
    scenario: str | None = None
    contact_tolerance: float | None = None
    covariates: Sequence[str] = ()
    unsure: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    since: str | None = None
    calibration: Path | str | None = None
    exact: bool = False
    each_arm: bool = False

    def __post_init__(self) -> None:
        """Find the experiment file of the folder."""
        if self.experiment is None and self.runs is not None and self.mapping is None and self.minus is None:
            object.__setattr__(self, "experiment", experiment_file_in(self.runs))

    @property
    def data(self) -> Path:
        """Folder or file of the measurements."""
        data = self.runs if self.impacts is None else self.impacts
        assert data is not None
        return Path(data)

    @functools.cached_property
    def kind(self) -> MeasurementKind:
        """Kind of the measurements; files without a description are opened to find whether they are trials."""
        if self.impacts is not None:
            return MeasurementKind.IMPACTS
        if self.experiment is not None:
            return MeasurementKind.LABORATORY
        if self.mapping is not None or is_foreign(self.data):
            return MeasurementKind.RECORDINGS
        return MeasurementKind.TRIALS


class Measurements:
    """Measurements read once, for comparison with any model.

    Args:
        map_tasks: Parallel map.
        observer: Shows progress and warnings.
        source: Makes the source of evidence for a model.
        trials: Trials or runs; None for other measurements.
        kind: Kind of the measurements.
        calibration: Faults of the readings.
    """

    def __init__(
        self,
        map_tasks: Map,
        observer: Observer,
        source: SourceOfModel,
        trials: Runs | None = None,
        kind: MeasurementKind = MeasurementKind.TRIALS,
        calibration: LaboratoryCalibration = NO_CALIBRATION,
    ) -> None:
        self.trials, self.kind, self.calibration = trials, kind, calibration
        self._map, self._observer, self._source = map_tasks, observer, source
        self._stage = lambda *_: None
        self._cache = ReplayCache(map_tasks, lambda what, done, total: self._stage(what, done, total))
        self._sources: dict[str, Source] = {}

    @contextmanager
    def progress(self) -> Iterator[None]:
        """Show the progress of the work inside."""
        with self._observer.stages() as stage:
            self._stage = stage
            try:
                yield
            finally:
                self._stage = lambda *_: None

    def against(self, model: Model) -> Source:
        """The measurements against a model, with the faults of the readings.

        Raises:
            InputError: No hit occurs with this model, or the model diverges; a recording cannot be used; model and
                calibration exclude each other.
        """
        return self.uncalibrated(self.calibration.of(model))

    def uncalibrated(self, model: Model) -> Source:
        """As :meth:`against`, without the faults of the readings."""
        key = f"{model.digest} {[spec.name for spec in model.formulas]} {model.arms}"
        if key not in self._sources:
            self._sources[key] = self._source(model, self._cache)
            self._sources[key].progress = lambda stage, done, total: self._stage(stage, done, total)
        return self._sources[key]

    def tracks(self, model: Model, added: Added = ()) -> tuple[Track, ...]:
        """Measured and predicted signals over time, for reports.

        Args:
            model: The model.
            added: Further effects; for recordings and impacts they are shown next to the model.
        """
        return self.against(model).tracks(self._map, added)


def open_measurements(options: MeasurementOptions, map_tasks: Map = map, observer: Observer = SILENT) -> Measurements:
    """Read measurements of any kind.

    Args:
        options: Which measurements, and how they are read.
        map_tasks: Parallel map; the built-in one works in this process.
        observer: Shows progress and warnings.

    Raises:
        InputError: There is no usable measurement, or a file cannot be used.
    """
    calibration = calibration_of(options.data, options.calibration)
    trials: Runs | None = None
    if options.kind == MeasurementKind.IMPACTS:
        source = _source_of_table(options, map_tasks)
    elif options.kind == MeasurementKind.RECORDINGS:
        source = _source_of_recordings(options)
    else:
        if options.experiment is not None:
            trials = read_laboratory(options.data, options.experiment, map_tasks, observer)
        else:
            trials = read_trials(options.data, map_tasks, observer)
        if options.since is not None:
            trials = trials.since(options.since)
        source = _source_of_runs(trials, NO_DISCREPANCY if options.exact else None, options.each_arm)
    return Measurements(map_tasks, observer, source, trials, options.kind, calibration)


def measurements_of_trials(trials: Runs, map_tasks: Map = map, observer: Observer = SILENT) -> Measurements:
    """Trials that were read already, without a calibration.

    Args:
        trials: The trials.
        map_tasks: Parallel map.
        observer: Shows progress and warnings.
    """
    return Measurements(map_tasks, observer, _source_of_runs(trials, None, False), trials)


def read_measurements(data: str | Path, model: Model | str | Path = "nominal", map_tasks: Map = map) -> Source:
    """Measurements of a folder next to the predictions of a model.

    A folder has trials of impact_rs, runs of a laboratory with an ``experiment.yaml``, or recordings of free motion.
    A ``calibration.yaml`` in it corrects the readings.

    Args:
        data: Folder of the bags, or one recording.
        model: A model, its file, or the name of a shipped one.
        map_tasks: Parallel map; the built-in one works in this process.

    Raises:
        InputError: There is no usable run; a file cannot be used; no hit occurs with this model.
    """
    data = Path(data).absolute()
    options = MeasurementOptions(runs=data)
    model = model if isinstance(model, Model) else load_model(model)
    return open_measurements(options, map_tasks).against(model)


def read_trials(directory: Path, map_tasks: Map = map, observer: Observer = SILENT) -> Runs:
    """Read every trial below a folder, and warn of omitted ones.

    Args:
        directory: The folder.
        map_tasks: Parallel map.
        observer: Shows progress and warnings.

    Raises:
        InputError: There is no usable trial.
    """
    with observer.progress("reading bags") as report:
        runs = read_runs(
            directory.absolute(), _with_progress(map_tasks, report)
        )  # workers may have another working directory
    warn_skipped(runs.skipped, observer)
    return runs


def read_laboratory(directory: Path, experiment: Path, map_tasks: Map = map, observer: Observer = SILENT) -> Runs:
    """Read the runs of an experiment file, and warn of omitted ones.

    Args:
        directory: Folder of the runs.
        experiment: The experiment file.
        map_tasks: Parallel map.
        observer: Shows progress and warnings.

    Raises:
        InputError: The file, its table or a recording cannot be used.
    """
    described = load_experiment(experiment)
    with observer.progress("reading runs") as report:
        runs = read_laboratory_runs(directory.absolute(), described, _with_progress(map_tasks, report))
    warn_skipped(runs.skipped, observer)
    return runs


def read_table(options: MeasurementOptions) -> ImpactTable:
    """Read a table of impacts.

    Raises:
        InputError: There is no such table or scenario, or a row cannot be used.
    """
    table = read_impact_table(
        options.data,
        None if options.scenario is None else load_scenario(options.scenario),
        tolerance=GAP_TOLERANCE if options.contact_tolerance is None else options.contact_tolerance,
        covariates=options.covariates,
        unsure=options.unsure,
    )
    return table if options.since is None else table.since(options.since)


def _source_of_runs(runs: Runs, discrepancy: Discrepancy | None, each_arm: bool) -> SourceOfModel:
    """Replays of runs under a model; ``discrepancy`` None: the discrepancy of the shipped simulators."""
    return lambda model, cache: ReplaySource.of(runs, model, cache, discrepancy, each_arm)


def _source_of_table(options: MeasurementOptions, map_tasks: Map) -> SourceOfModel:
    """A table of impacts against a model."""
    table = read_table(options)
    discrepancy = NO_MAP_DISCREPANCY if options.exact else None
    return lambda model, _: ImpactTableSource(table, model, options.each_arm, discrepancy, map_tasks=map_tasks)


def _source_of_recordings(options: MeasurementOptions) -> SourceOfModel:
    """Recordings of free motion against a model."""
    mapping = load_mapping(options.mapping or DEFAULT_MAPPING)
    recordings, skipped = read_long_enough(options.data, mapping)
    minus, skipped_minus = ([], []) if options.minus is None else read_long_enough(options.minus, mapping)
    return lambda model, _: RecordingSource.of(recordings, mapping, model, minus, [*skipped, *skipped_minus])


def _with_progress(map_tasks: Map, report: Report) -> Map:
    """A map that reports its progress; few runs are read in this process."""

    def mapped(function: Any, items: Any) -> Iterator[Any]:
        map_items = map_tasks if len(items) >= MIN_PARALLEL_RUNS else map
        for number, result in enumerate(map_items(function, items), start=1):
            report(number, len(items))
            yield result

    return mapped
