# SPDX-License-Identifier: Apache-2.0
"""Pages of single runs of a folder, in 3D and over time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from impact_rs_analysis.report.trial import TrialPage, trial_page, write_trial
from impact_rs_sim.errors import InputError
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.file_names import experiment_file_in
from impact_rs_trials.recordings.experiment import load_experiment, read_runs
from impact_rs_trials.recordings.laboratory import Laboratory
from impact_rs_trials.recordings.laboratory_runs import read_one
from impact_rs_trials.runs import Run
from impact_rs_trials.store import is_bag
from impact_rs_trials.workers import Map


@contextmanager
def _unreadable_is_an_input_error(path: Path) -> Iterator[None]:
    """Errors of a bag occur while its page is made, because topics are read one by one."""
    try:
        yield
    except BagError as error:
        raise InputError(error.reason, file=path) from None


def page_of_trial(path: Path) -> TrialPage:
    """Content of the page of a recorded trial.

    Raises:
        InputError: It is no trial, or it cannot be read.
    """
    with _unreadable_is_an_input_error(path):
        return trial_page(TrialBag.open(path))


def write_page_of_trial(path: Path, page: Path) -> Path:
    """Write the page of a recorded trial, and return its path.

    Args:
        path: The trial.
        page: The page; an earlier one is replaced.

    Raises:
        InputError: As :func:`page_of_trial`, or the page cannot be written.
    """
    with _unreadable_is_an_input_error(path):
        return write_trial(TrialBag.open(path), page)


def run_names(folder: Path) -> list[str]:
    """Names of the trials in a folder, in order; for a described laboratory the paths of the runs in its table.

    Raises:
        InputError: There is no such folder, or the table of runs of a laboratory cannot be read.
    """
    if not folder.is_dir():
        raise InputError("expected the folder of a campaign", file=folder)
    if (file := experiment_file_in(folder)) is None:
        return sorted(path.name for path in folder.iterdir() if is_bag(path))
    experiment = load_experiment(file)
    table = read_runs(folder, experiment, Laboratory.of(experiment).scenario)
    return sorted(os.path.relpath(row.path, folder) for row in table)


def laboratory_run(folder: Path, experiment: Path | None, name: str, map_tasks: Map = map) -> Run:
    """A run of a described laboratory, as a comparison reads it.

    Args:
        folder: Folder of the runs.
        experiment: Experiment file; None: the file in the folder.
        name: Name of the run, or its path in the folder.
        map_tasks: Parallel map.

    Raises:
        InputError: The folder is not described, there is no such run, or the run cannot be read.
    """
    file = experiment_file_in(folder) if experiment is None else experiment
    if file is None:
        raise InputError("no experiment file here; describe the recordings first", file=folder)
    return read_one(folder, load_experiment(file), name, map_tasks)
