# SPDX-License-Identifier: Apache-2.0
"""Hidden effects, diagnosed: on our plant, on the MuJoCo cell, in another laboratory.

Every effect of the library at several magnitudes, pairs, campaigns that hide nothing, and effects outside the library.
``--on plant`` and ``--on cell`` record the campaigns of ``impact-rs blind make``; ``--on laboratory`` those of
:mod:`benchmarks.foreign.laboratory`, which have other motions, names, topics and clocks.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.harness import ROW, Row, Work
from benchmarks.hidden import (
    VISIBLE,
    Entry,
    entries,
    hidden_in,
    laboratory_runs,
    plant_option,
    recorder,
    reseeded,
    table_of_diagnoses,
    timed_diagnosis,
)
from benchmarks.results import Table
from impact_rs_analysis.evidence.levels import score_of
from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.model import ModelEffect, ParameterValue, load_model
from impact_rs_sim.plant.unmodelled import OUTSIDE
from impact_rs_trials.blind import RUNS, TRUTH, make
from impact_rs_trials.workers import Map

CLEAR = 3.0  # parameter scales
MAGNITUDES = {"plant": (CLEAR, 8.0, 1.0), "cell": (CLEAR, 8.0), "laboratory": (CLEAR,)}
OUTSIDE_MAGNITUDES = {"plant": (2.0, 6.0), "cell": (2.0, 6.0), "laboratory": (4.0,)}
FIRST_SEED = {"plant": 0, "cell": 1000, "laboratory": 3000}  # no campaign of one plant is one of another
COLUMN = {"plant": "our plant", "cell": "MuJoCo cell, our controller", "laboratory": "another laboratory"}
PLAIN = "plain"  # in the place of a name: two effects that show alone, at the clear magnitude, on this board


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is hidden, and where."""
    plant_option(parser, *MAGNITUDES)
    parser.add_argument("--seeds", type=int, default=1, help="campaigns per effect and magnitude")
    parser.add_argument("--pairs", type=int, default=6, help="campaigns with two effects, on our plant")
    parser.add_argument("--nulls", type=int, default=10, help="campaigns with nothing hidden")
    parser.add_argument("--size", default="small", choices=("small", "full"), help="size of each campaign")


def outsides(plant: str) -> list[str]:
    """Effects outside the library that a plant can hide."""
    if plant == "plant":
        return list(OUTSIDE)
    from benchmarks.foreign.campaign import OUTSIDE as OF_THE_CELL

    return list(OF_THE_CELL)


def cases(options: argparse.Namespace) -> list[Entry]:
    """What is clear first; faint effects at the end."""
    plant = options.on
    singles = [("single", name, size) for size in MAGNITUDES[plant] for name in hidden_in(plant)]
    outside = [("outside", name, size) for size in OUTSIDE_MAGNITUDES[plant] for name in outsides(plant)]
    single_campaigns: list[tuple[str, str | None, float | None]] = [("null", None, None)] * options.nulls
    single_campaigns += [("pair", PLAIN, 4.0)] * (options.pairs if plant == "plant" else 0)
    campaigns = entries(
        [*singles, *outside, *single_campaigns, *(singles + outside) * (options.seeds - 1)], FIRST_SEED[plant]
    )
    campaigns.sort(key=lambda entry: entry.kind == "single" and entry.magnitude != CLEAR)
    return reseeded(campaigns, options)


def run(entry: Entry, work: Work) -> Row:
    """Record, diagnose and judge one campaign."""
    options, folder = work.options, work.folder
    document = folder / "diagnosis.json"
    if options.on == "laboratory":
        from benchmarks.foreign import laboratory

        laboratory.make(entry, folder, work.map_tasks)
        row = timed_diagnosis(document, folder, lambda: laboratory_runs(folder / RUNS, work.map_tasks), work.map_tasks)
        return row | {"magnitude": entry.magnitude}
    effect = _plain_pair(folder.parent, entry.seed) if entry.effect == PLAIN else entry.effect
    recording_options = (work.map_tasks, entry.kind, effect, options.size, entry.magnitude, recorder(options.on))
    for _ in make(folder, entry.seed, *recording_options, outsides=outsides(options.on)):
        pass
    row = timed_diagnosis(document, folder, lambda: read_runs(folder / RUNS, work.map_tasks), work.map_tasks)
    alone = _errors_alone(folder, work.map_tasks) if entry.kind == "pair" else {}
    return row | {"magnitude": entry.magnitude, "alone": alone}


def _plain_pair(board: Path, seed: int) -> str:
    """Two effects of those that stood above twice the noise when they were hidden alone at the clear magnitude."""
    rows = [json.loads(path.read_text()) for path in sorted(board.glob(f"single__*__m{CLEAR:g}__*/{ROW}"))]
    shown = sorted({row["truth"][0] for row in rows if row["before"] > VISIBLE * row["noise"]})
    return "+".join(np.random.default_rng(seed).choice(shown, size=2, replace=False))


def _errors_alone(folder: Path, map_tasks: Map) -> dict[str, float]:
    """Of each effect of a pair: the error that is left where the model has the other one at its true size.

    In multiples of what repetition alone gives, as the error before a diagnosis of a single effect is.
    """
    truth = json.loads((folder / TRUTH).read_text())["effects"]
    runs, cache = read_runs(folder / RUNS, map_tasks), ReplayCache(map_tasks)
    scores = {}
    for effect in truth:
        other_effects = tuple(
            ModelEffect(
                name=other["name"],
                parameters={
                    name: ParameterValue(estimate=number["value"], unit=number["unit"])
                    for name, number in other["parameters"].items()
                },
            )
            for other in truth
            if other is not effect
        )
        model = load_model("nominal").model_copy(update={"effects": other_effects})
        scores[effect["name"]] = score_of(ReplaySource.of(runs, model, cache).clusters)
    return scores


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Shares of right diagnoses."""
    return table_of_diagnoses(rows, COLUMN[options.on])
