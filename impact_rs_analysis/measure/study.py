# SPDX-License-Identifier: Apache-2.0
"""The published study: both scenarios with every object, case, reference and repeat, in one folder.

A study is a folder of campaigns, one per scenario; each is resumed and analysed like any campaign.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from impact_rs_analysis.measure.analyze import Analysis, analyze_campaign
from impact_rs_analysis.measure.sensitivity import Sensitivity
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_trials.campaign import Manifest, make_manifest
from impact_rs_trials.workers import Map

SCENARIOS = ("push", "grab")


def study_manifests(trials: int | None = None, seed: int = 0, plant: Simulator = "bullet") -> dict[str, Manifest]:
    """Campaigns of the study, by scenario.

    Args:
        trials: Repeats of every reference; None: the scenarios' own number.
        seed: Seed of both campaigns.
        plant: Simulator of their plants.

    Raises:
        InputError: Fewer than one trial, or a negative seed.
    """
    return {name: make_manifest(name, trials=trials, seed=seed, plant=plant) for name in SCENARIOS}


def analyze_study(
    directory: Path, progress: Callable[[int, int], None] | None = None, map_tasks: Map = map
) -> Analysis:
    """Analyse both campaigns of a study as one.

    Args:
        directory: Folder of the study.
        progress: Called with the number of bags read and the number of all bags of the present campaign.
        map_tasks: Parallel map, for many trials.

    Raises:
        InputError: A campaign has no readable trial.
    """
    parts = {name: analyze_campaign(directory / name, progress, map_tasks) for name in SCENARIOS}
    joined = {
        field: tuple(entry for part in parts.values() for entry in getattr(part, field))
        for field in ("sets", "incomplete", "skipped", "departed", "arms")
    }
    return Analysis(
        **joined,
        directory=directory,
        missing=tuple(f"{name}/{trial}" for name, part in parts.items() for trial in part.missing),
        no_impact=tuple(f"{name}/{trial}" for name, part in parts.items() for trial in part.no_impact),
        apart=tuple((f"{name}/{trial}", spread) for name, part in parts.items() for trial, spread in part.apart),
        limited=tuple((f"{name}/{entry[0]}", *entry[1:]) for name, part in parts.items() for entry in part.limited),
        unsealed=tuple(f"{name}/{trial}" for name, part in parts.items() for trial in part.unsealed),
        sensitivity=sum((part.sensitivity for part in parts.values()), Sensitivity()),
    )
