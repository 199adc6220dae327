# SPDX-License-Identifier: Apache-2.0
"""Measurements that a command line names, read with progress bars and warnings."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from impact_rs_analysis.application.measurements import (
    MeasurementKind,
    MeasurementOptions,
    Measurements,
    open_measurements,
)
from impact_rs_analysis.diagnosis.search.bounds import read_ranges
from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_trials.file_names import experiment_file_in

EXPECTED_RANGE = "expected NAME=LOW:HIGH, for example size_z=0.09:0.11, or a YAML file"
NO_MINUS = "--minus goes with recordings of free motion: RUNS and UNLOADED are recordings with one mapping (--mapping)"


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
    options = measurement_options(args, terminal, each_arm, unsure)
    with started_workers(args) as map_tasks:
        measurements = open_measurements(options, map_tasks, terminal)
        if measurements.calibration:
            terminal.say(f"calibration of the readings: {measurements.calibration.text}")
        yield measurements


def measurement_options(
    args: argparse.Namespace, terminal: Terminal, each_arm: bool = False, unsure: Sequence[str] = ()
) -> MeasurementOptions:
    """Measurements that a command line selects, see :func:`measured`.

    Raises:
        InputError: Options that do not go together, or a range or path that there is not.
    """
    _check_options(args, unsure)
    experiment_option = args.experiment
    experiment = None if experiment_option is None else experiment_file(experiment_option, Path(args.runs), terminal)
    options = MeasurementOptions(
        runs=None if args.runs is None else Path(args.runs),
        impacts=None if args.impacts is None else Path(args.impacts),
        experiment=experiment,
        mapping=args.mapping,
        minus=args.minus,
        scenario=args.scenario,
        contact_tolerance=args.contact_tolerance,
        covariates=args.covariates,
        unsure=read_ranges(unsure, "--unsure", EXPECTED_RANGE),
        since=args.since,
        calibration=args.calibration,
        exact=args.no_discrepancy,
        each_arm=each_arm,
    )
    if experiment_option is None and options.experiment is not None:
        _say_experiment(options.experiment, terminal)
    recordings = options.kind == MeasurementKind.RECORDINGS
    if args.minus is not None and not recordings:
        raise InputError(NO_MINUS)
    if args.since is not None and recordings:
        raise InputError("--since goes with trials and with --impacts; leave it out for recordings")
    return options


def _check_options(args: argparse.Namespace, unsure: Sequence[str]) -> None:
    """Refuse options of one kind of measurements that are given with another."""
    tolerance = args.contact_tolerance
    if args.impacts is None:
        if args.scenario is not None:
            raise InputError(
                "--scenario goes with --impacts only: trials contain their scenario, and recordings have a mapping"
            )
        if tolerance is not None:
            raise InputError("--contact-tolerance goes with --impacts only: trials are replayed from their poses")
        if unsure:
            raise InputError("--unsure goes with --impacts only; ranges of effects are given with --bounds")
        if args.covariates:
            raise InputError("--covariates goes with --impacts only: they are columns of the table")
        if args.experiment is not None and args.minus is not None:
            raise InputError(NO_MINUS)
        if args.experiment is not None and args.mapping is not None:
            raise InputError("--mapping and --experiment exclude each other: the experiment file names the mapping")
        return
    if tolerance is not None and not tolerance >= 0.0:
        raise InputError("expected a distance >= 0 m", key="--contact-tolerance", value=tolerance)
    if args.minus is not None:
        raise InputError(NO_MINUS)
    if args.experiment is not None:
        raise InputError(
            "--experiment is for folders of runs; leave it out with --impacts (--scenario names the robots)"
        )
    if args.mapping is not None:
        raise InputError("--mapping is for recordings; leave it out with --impacts, whose columns are fixed")


def experiment_file(option_path: Path | None, directory: Path, terminal: Terminal) -> Path | None:
    """The experiment file that a path on the command line names, or that is in the folder of the runs.

    A path is relative to the working directory as any path, or else to the folder of the runs.

    Args:
        option_path: The path; None: the file in the folder, if there is one.
        directory: Folder of the runs.
        terminal: Reports the chosen file if both are possible.

    Raises:
        InputError: There is no such file in either folder.
    """
    if option_path is None:
        if (default_file := experiment_file_in(directory)) is not None:
            _say_experiment(default_file, terminal)
        return default_file
    in_runs_folder = directory / option_path
    if option_path.is_absolute() or in_runs_folder.absolute() == option_path.absolute():
        return option_path
    if not option_path.exists() and not in_runs_folder.exists():
        raise InputError(f"no such file in {Path.cwd()} or in the folder of the runs, {directory}", file=option_path)
    file = option_path if option_path.exists() else in_runs_folder
    _say_experiment(file, terminal)
    if file is option_path and in_runs_folder.exists() and not option_path.samefile(in_runs_folder):
        terminal.warn(
            f"there is another {option_path} in the folder of the runs, which was not read: {in_runs_folder.absolute()}"
        )
    return file


def _say_experiment(file: Path, terminal: Terminal) -> None:
    """Name the experiment file that is read."""
    terminal.say(f"experiment: {file.absolute()}")


def only_trials(measurements: Measurements, option: str) -> Runs:
    """The trials, for an option that does not exist for recordings.

    Raises:
        InputError: Recordings or a table of impacts were read.
    """
    if measurements.trials is None:
        raise InputError(f"{option} is for trials; for {measurements.kind} use --json or the report")
    return measurements.trials
