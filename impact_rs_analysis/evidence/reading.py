# SPDX-License-Identifier: Apache-2.0
"""Measurements of a folder beside the predictions of a model, in one call."""

from __future__ import annotations

from pathlib import Path

from impact_rs_analysis.evidence.calibration import calibration_of
from impact_rs_analysis.evidence.command_clock import read_laboratory_runs
from impact_rs_analysis.evidence.measured_runs import read_runs
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_sim.model import Model, load_model
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.workers import Map

EXPERIMENT = "experiment.yaml"


def read_measurements(folder: str | Path, model: Model | str | Path = "nominal", map_tasks: Map = map) -> ReplaySource:
    """Trials of impact_rs, or runs of a laboratory, with their replays by a model.

    Runs of a laboratory have an ``experiment.yaml`` in their folder. The ``calibration.yaml`` there, if there is one,
    corrects the readings of both.

    Args:
        folder: Folder of the bags.
        model: A model, its file, or the name of a shipped one.
        map_tasks: Parallel map; the built-in one works in this process.

    Raises:
        InputError: There is no usable run; a file cannot be used; with this model nothing is hit.
    """
    folder = Path(folder).absolute()
    model = model if isinstance(model, Model) else load_model(model)
    experiment = folder / EXPERIMENT
    if experiment.exists():
        runs = read_laboratory_runs(folder, load_experiment(experiment), map_tasks)
    else:
        runs = read_runs(folder, map_tasks)
    return ReplaySource.of(runs, calibration_of(folder).of(model), ReplayCache(map_tasks))
