# SPDX-License-Identifier: Apache-2.0
"""Designed campaigns against fixed and random ones.

Every campaign is measured in three ways with the same hidden effect: the fixed campaign of ``blind make`` (18 trials),
and half as many trials by design and at random. Each is diagnosed and judged. Where one ends in a tie, ``TIE_BUDGET``
further trials are proposed by design and at random, and all are diagnosed again.

Few of these end in a tie. ``--only tie`` hides every effect in six pushes of one object, clearly and very clearly.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks.boards.blind import MAGNITUDES
from benchmarks.harness import Row, Work, share
from benchmarks.hidden import Entry, diagnosed, entries, hidden_in, judged, plant_option, recorder, reseeded
from benchmarks.results import Table
from impact_rs_analysis.design.design import WHICH_EFFECT, planned
from impact_rs_analysis.design.forecast import Forecast, forecast_of
from impact_rs_analysis.design.possible_trials import possible_trials
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.verdicts.next_experiment import left_open
from impact_rs_analysis.evidence.replays.measured_runs import Runs, read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_sim.model import load_model
from impact_rs_trials.blind import RUNS, SCENARIOS, TRUTH, BlindTask, Hidden, Secret, make
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import (
    ExperimentPlan,
    Method,
    PlannedCampaign,
    manifests_of,
    read_plan,
    write_plan,
)
from impact_rs_trials.workers import Map

BUDGET = 9  # half of the fixed campaign
TIE_BUDGET = 4
METHODS: tuple[Method, ...] = ("design", "random")
WAYS = ("fixed", *METHODS)
CLEAR = (3.0, 8.0)  # parameter scales, of effects that few trials should show
SURE = 0.95
FEW = ExperimentPlan(
    model="nominal",
    model_digest=load_model("nominal").digest,
    aim="effects",
    method="fixed",
    budget=6,
    campaigns=(
        PlannedCampaign(
            folder="push",
            scenario="push",
            conditions=tuple(
                PlannedTrials(object="parcel", case=case, trials=2) for case in ("case_1", "case_2", "case_3")
            ),
        ),
    ),
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is hidden, and where."""
    plant_option(parser, "plant", "cell")
    parser.add_argument("--seeds", type=int, default=1, help="campaigns of every effect and magnitude")
    parser.add_argument("--nulls", type=int, default=8, help="campaigns with nothing hidden")


def cases(options: argparse.Namespace) -> list[Entry]:
    """Whole campaigns in random order, so that those done in time are a sample; then ties."""
    names = hidden_in(options.on)
    singles = [("single", name, size) for size in MAGNITUDES["plant"] for name in names]
    hidden: list[tuple[str, str | None, float | None]] = [
        *singles * options.seeds,
        *[("null", None, None)] * options.nulls,
    ]
    campaigns = entries(hidden)
    order = np.random.default_rng(0).permutation(len(campaigns))
    ties = entries([("tie", name, size) for size in CLEAR for name in names], 500)
    return reseeded([*(campaigns[number] for number in order), *ties], options)


def hidden_of(directory: Path) -> tuple[tuple[Hidden, ...], str | None, float]:
    """What ``blind make`` hides in a campaign, for further trials on the same plant."""
    truth = json.loads((directory / TRUTH).read_text(encoding="utf-8"))
    hidden = tuple(
        Hidden(item["name"], tuple(parameter["value"] for parameter in item["parameters"].values()), item["magnitude"])
        for item in truth["effects"]
    )
    return hidden, truth["outside"], truth["outside_magnitude"]


def record(plan: ExperimentPlan, runs: Path, work: Work) -> Path:
    """Run a plan on the plant of a blind campaign; bags that exist are kept. Returns their folder."""
    hidden, outside, magnitude = hidden_of(work.folder)
    runs.mkdir(parents=True, exist_ok=True)
    tasks = [
        BlindTask(str(runs.absolute()), manifest.trial(key), hidden, outside, magnitude)
        for manifest in manifests_of(plan).values()
        for key in manifest.in_order
    ]
    for _ in work.map_tasks(recorder(work.options.on), tasks):
        pass
    return runs


def stored_plan(path: Path, make_plan: Callable[[], ExperimentPlan]) -> ExperimentPlan:
    """A plan; one that exists is kept."""
    if not path.exists():
        write_plan(make_plan(), path)
    return read_plan(path)


@cache
def first_forecast(map_tasks: Map) -> Forecast:
    """What the nominal model says of all trials, simulated once for all campaigns."""
    return forecast_of(load_model("nominal"), possible_trials(SCENARIOS), ReplayCache(map_tasks))


@cache
def designed(map_tasks: Map) -> ExperimentPlan:
    """The designed plan from nothing, which is the same for all campaigns but for its seed."""
    forecast = first_forecast(map_tasks)
    return planned(forecast, WHICH_EFFECT(forecast.source), BUDGET, "design", 0)


def first_plan(method: Method, seed: int, map_tasks: Map) -> ExperimentPlan:
    """The plan of a campaign from nothing."""
    if method == "design":
        return designed(map_tasks).model_copy(update={"seed": seed})
    forecast = first_forecast(map_tasks)
    return planned(forecast, WHICH_EFFECT(forecast.source), BUDGET, method, seed)


def run(entry: Entry, work: Work) -> Row:
    """Measure, diagnose and judge one campaign in all ways, or a few trials that may end in a tie."""
    folder, map_tasks = work.folder, work.map_tasks
    runs = {"few" if entry.kind == "tie" else "fixed": folder / RUNS}
    if entry.kind == "tie":
        Secret.drawn(entry.seed, "single", entry.effect, entry.magnitude).write(folder)
        record(FEW.model_copy(update={"seed": entry.seed}), folder / RUNS, work)
    else:
        recording_options = (map_tasks, entry.kind, entry.effect, "small", entry.magnitude, recorder(work.options.on))
        for _ in make(folder, entry.seed, *recording_options):
            pass
        for method in METHODS:
            plan = stored_plan(folder / f"{method}.yaml", partial(first_plan, method, 1000 + entry.seed, map_tasks))
            runs[method] = record(plan, folder / method, work)
    documents = {
        method_name: diagnosed(folder / f"{method_name}.json", partial(read_runs, folder_of_runs, map_tasks), map_tasks)
        for method_name, folder_of_runs in runs.items()
    }
    ties = [
        split(method_name, method, entry.seed, runs[method_name], document, work)
        for method_name, document in documents.items()
        if document.confusable
        for method in METHODS
    ]
    summary = [f"{method_name} {document.verdict}" for method_name, document in documents.items()]
    summary += [f"then by {tie['method']} {tie['verdict']}" for tie in ties]
    judged_by_kind = {method_name: judged(folder, document) for method_name, document in documents.items()}
    return {"kind": entry.kind, "ways": judged_by_kind, "ties": ties, "said": ", ".join(summary)}


def split(kind: str, method: Method, seed: int, runs: Path, tied: DiagnosisDocument, work: Work) -> Row:
    """Whether the first proposal after a tie splits it."""
    decide = left_open(tied, load_model("nominal"))
    assert decide is not None
    folder, map_tasks = work.folder / f"{kind}_tie_{method}", work.map_tasks
    before = read_runs(runs, map_tasks)

    def proposed() -> ExperimentPlan:
        cache_ = ReplayCache(map_tasks)
        trials = possible_trials(SCENARIOS)
        forecast = forecast_of(load_model("nominal"), trials, cache_, runs=before, seed=2000 + seed)
        return planned(forecast, decide(forecast.source), TIE_BUDGET, method, 2000 + seed)

    def together() -> Runs:
        """Repeats of a condition have the features that all of them have."""
        return Runs.of(before.directory, [*before.runs, *read_runs(folder, map_tasks).runs])

    plan = stored_plan(folder.with_suffix(".yaml"), proposed)
    record(plan, folder, work)
    after = diagnosed(folder.with_suffix(".json"), together, map_tasks)
    return judged(work.folder, after) | {
        "way": kind,
        "method": method,
        "split": not after.confusable,
        "said_before": min((pair.after for pair in plan.pairs), default=1.0),
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Ways beside each other, then how ties were split."""
    del options
    whole = [row["ways"] for row in rows if row["kind"] != "tie"]
    tied = {kind: [tie for row in rows for tie in row["ties"] if tie["method"] == kind] for kind in METHODS}
    sure = {kind: [tie for tie in ties if tie["said_before"] >= SURE] for kind, ties in tied.items()}
    lines = [
        ("hidden effect named, or in a tie", *(share(row[kind]["correct"] for row in whole) for kind in WAYS)),
        ("exactly the hidden effect named", *(share(row[kind]["exact"] for row in whole) for kind in WAYS)),
        (
            "the effect and nothing else in the headline",
            *(share(row[kind]["headline"] for row in whole) for kind in WAYS),
        ),
        (
            "the same effects named as by the fixed campaign",
            "",
            *(share(set(row[kind]["named"]) == set(row["fixed"]["named"]) for row in whole) for kind in METHODS),
        ),
        (
            "right where the fixed campaign is right",
            "",
            *(share(row[kind]["correct"] for row in whole if row["fixed"]["correct"]) for kind in METHODS),
        ),
        (
            f"ties split by {TIE_BUDGET} further trials",
            "",
            *(share(tie["split"] for tie in tied[kind]) for kind in METHODS),
        ),
        ("... and right", "", *(share(tie["correct"] for tie in tied[kind]) for kind in METHODS)),
        (f"... promised with {SURE:.0%}: split", "", *(share(tie["split"] for tie in sure[kind]) for kind in METHODS)),
    ]
    return Table(("", "Fixed, 18 trials", "Design, 9", "Random, 9"), tuple(lines))
