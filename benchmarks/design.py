# SPDX-License-Identifier: Apache-2.0
"""Designed campaigns against fixed and random ones: ``./run python -m benchmarks.design -o DIR``.

Every blind campaign of the matrix is measured in three ways with the same hidden effect: the fixed campaign of
``blind make`` (18 trials), and half as many trials by design and at random. Each is diagnosed and scored. Where one
ends in a tie, ``TIE_BUDGET`` further trials are proposed by design and at random, and all are diagnosed again.

``--plant mujoco`` hides the effects in the MuJoCo cell of ``benchmarks.foreign``, in a folder of its own.

Few of these end in a tie. ``--only tie`` hides every effect in six pushes of one object, clearly and very clearly.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind import matrix
from benchmarks.board import (
    Entry,
    Row,
    arguments,
    diagnosed,
    hidden_in,
    plant_argument,
    recorder,
    run_board,
    share,
)
from impact_rs_analysis.design.design import WHICH_EFFECT, Decide, planned
from impact_rs_analysis.design.forecast import Forecast, forecast_of
from impact_rs_analysis.design.possible_trials import possible_trials
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.next_experiment import left_open
from impact_rs_analysis.diagnosis.scoring import held_against_truth
from impact_rs_analysis.evidence.measured_runs import Runs, read_runs
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_sim.effects import of_trials
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
NULLS = 8
METHODS: tuple[Method, ...] = ("design", "random")
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


def hidden_of(directory: Path) -> tuple[tuple[Hidden, ...], str | None, float]:
    """What ``blind make`` hides in a campaign, for further trials on the same plant."""
    truth = json.loads((directory / TRUTH).read_text(encoding="utf-8"))
    hidden = tuple(
        Hidden(item["name"], tuple(one["value"] for one in item["parameters"].values()), item["magnitude"])
        for item in truth["effects"]
    )
    return hidden, truth["outside"], truth["outside_magnitude"]


Record = Callable[[BlindTask], str]


def record(plan: ExperimentPlan, directory: Path, truth: Path, map_tasks: Map, work: Record) -> None:
    """Run a plan on the plant of a blind campaign; bags that exist are kept."""
    hidden, outside, magnitude = hidden_of(truth)
    directory.mkdir(parents=True, exist_ok=True)
    tasks = [
        BlindTask(str(directory.absolute()), manifest.trial(key), hidden, outside, magnitude)
        for manifest in manifests_of(plan).values()
        for key in manifest.in_order
    ]
    for _ in map_tasks(work, tasks):
        pass


def together(before: Runs, directory: Path, map_tasks: Map) -> Runs:
    """Earlier runs and those of another folder; repeats of a condition have the features that all of them have."""
    return Runs.of(before.directory, [*before.runs, *read_runs(directory, map_tasks).runs])


class Planner:
    """Plans of the nominal model, simulated once for all campaigns."""

    def __init__(self, map_tasks: Map) -> None:
        self._map = map_tasks
        self._first: Forecast | None = None
        self._designed: ExperimentPlan | None = None
        self._trials = possible_trials(SCENARIOS)

    def first(self, path: Path, method: Method, seed: int) -> ExperimentPlan:
        """The plan of a campaign from nothing; designed ones are equal but for their seed."""
        if not path.exists():
            write_plan(self._plan(method, seed), path)
        return read_plan(path)

    def _plan(self, method: Method, seed: int) -> ExperimentPlan:
        if method == "design" and self._designed is not None:
            return self._designed.model_copy(update={"seed": seed})
        if self._first is None:
            self._first = forecast_of(load_model("nominal"), self._trials, ReplayCache(self._map))
        plan = planned(self._first, WHICH_EFFECT(self._first.source), BUDGET, method, seed)
        if method == "design":
            self._designed = plan
        return plan

    def next(self, path: Path, method: Method, seed: int, runs: Runs, decide: Decide) -> ExperimentPlan:
        """The plan after a diagnosis with a tie."""
        if not path.exists():
            model = load_model("nominal")
            forecast = forecast_of(model, self._trials, ReplayCache(self._map), runs=runs, seed=seed)
            write_plan(planned(forecast, decide(forecast.source), TIE_BUDGET, method, seed), path)
        return read_plan(path)


def run(planner: Planner, entry: Entry, directory: Path, map_tasks: Map, work: Record) -> Row:
    """Measure, diagnose and score one campaign in all ways; what exists is kept."""
    for _ in make(directory, entry.seed, map_tasks, entry.kind, entry.effect, "small", entry.magnitude, work):
        pass
    began = time.perf_counter()
    fixed = diagnosed(directory / "fixed.json", partial(read_runs, directory / RUNS, map_tasks), map_tasks)
    found = {"fixed": (directory / RUNS, fixed)}
    for method in METHODS:
        plan = planner.first(directory / f"{method}.yaml", method, 1000 + entry.seed)
        record(plan, directory / method, directory, map_tasks, work)
        read = partial(read_runs, directory / method, map_tasks)
        found[method] = directory / method, diagnosed(directory / f"{method}.json", read, map_tasks)
    row: dict[str, Any] = {way: judged(directory, document) for way, (_, document) in found.items()}
    row["ties"] = [
        split(planner, directory, way, method, entry.seed, before, document, map_tasks, work)
        for way, (before, document) in found.items()
        if document.confusable
        for method in METHODS
    ]
    verdicts = ", ".join(f"{way} {document.verdict}" for way, (_, document) in found.items())
    return row | {
        "name": entry.name,
        "kind": entry.kind,
        "correct": row["design"]["correct"],
        "verdict": verdicts,
        "seconds": time.perf_counter() - began,
    }


def run_few(planner: Planner, entry: Entry, directory: Path, map_tasks: Map, work: Record) -> Row:
    """Measure few trials of one effect and, if they end in a tie, those that are proposed to split it."""
    directory.mkdir(parents=True, exist_ok=True)
    Secret.drawn(entry.seed, "single", entry.effect, entry.magnitude).keep(directory)
    began = time.perf_counter()
    runs = directory / RUNS
    record(FEW.model_copy(update={"seed": entry.seed}), runs, directory, map_tasks, work)
    first = diagnosed(directory / "few.json", partial(read_runs, runs, map_tasks), map_tasks)
    ties = [
        split(planner, directory, "few", method, entry.seed, runs, first, map_tasks, work)
        for method in METHODS
        if first.confusable
    ]
    return {
        "name": entry.name,
        "kind": entry.kind,
        "correct": judged(directory, first)["correct"],
        "verdict": ", then ".join([first.verdict, *(f"{one['method']} {one['verdict']}" for one in ties)]),
        "ties": ties,
        "seconds": time.perf_counter() - began,
    }


def split(
    planner: Planner,
    directory: Path,
    way: str,
    method: Method,
    seed: int,
    runs: Path,
    tied: DiagnosisDocument,
    map_tasks: Map,
    work: Record,
) -> dict[str, Any]:
    """Whether the first proposal after a tie splits it."""
    decide = left_open(tied, load_model("nominal"))
    assert decide is not None
    name, before = f"{way}_tie_{method}", read_runs(runs, map_tasks)
    plan = planner.next(directory / f"{name}.yaml", method, 2000 + seed, before, decide)
    record(plan, directory / name, directory, map_tasks, work)
    after = diagnosed(directory / f"{name}.json", partial(together, before, directory / name, map_tasks), map_tasks)
    return judged(directory, after) | {
        "way": way,
        "method": method,
        "split": not after.confusable,
        "said": min((pair.after for pair in plan.pairs), default=1.0),
    }


def judged(directory: Path, document: DiagnosisDocument) -> dict[str, Any]:
    """A diagnosis against the truth."""
    return asdict(held_against_truth(directory, document)) | {
        "verdict": document.verdict,
        "trials": document.runs.trials,
        "confusable": [list(group) for group in document.confusable],
    }


def scoreboard(rows: Sequence[Row]) -> str:
    """The figures, against their goals."""
    lines = [*_campaigns([row for row in rows if row["kind"] != "tie"])]
    for method in METHODS:
        tied = [one for row in rows for one in row["ties"] if one["method"] == method]
        sure = [one for one in tied if one["said"] >= SURE]
        lines.append(
            f"ties, {TIE_BUDGET} further trials, {method}: split {share([one['split'] for one in tied])}, right "
            f"{share([one['correct'] for one in tied])}; of those promised with {SURE:.0%} or more: split "
            f"{share([one['split'] for one in sure])}"
        )
    return "\n".join(lines)


def _campaigns(rows: Sequence[Row]) -> list[str]:
    """The figures of whole campaigns."""
    if not rows:
        return []
    ways = ("fixed", *METHODS)
    lines = [f"right: {way:7s} {share([row[way]['correct'] for row in rows])}" for way in ways]
    lines += [f"headline: {way:7s} {share([row[way]['headline'] for row in rows])}" for way in ways]
    for way in METHODS:
        same = [set(row[way]["named"]) == set(row["fixed"]["named"]) for row in rows]
        no_worse = [row[way]["correct"] or not row["fixed"]["correct"] for row in rows]
        lines.append(f"{way}: same effects named as by the fixed campaign {share(same)}; no worse {share(no_worse)}")
    worse = [row["name"] for row in rows if row["random"]["correct"] and not row["design"]["correct"]]
    lines.append(f"random right and design wrong: {', '.join(worse) or 'none'}")
    return lines


def main() -> None:
    """Run the board."""
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=1, help="campaigns of every effect and magnitude")
    plant_argument(parser)
    options = parser.parse_args()
    possible, work = hidden_in(options.plant), recorder(options.plant)
    entries = [
        entry
        for entry in matrix(options.seeds, 0, NULLS)
        if entry.kind == "null" or (entry.kind == "single" and entry.effect in possible) or options.plant == "bullet"
    ]
    order = np.random.default_rng(0).permutation(len(entries))  # those that are done in time are a sample
    there = [(options.output / entry.name / "fixed.json").exists() for entry in entries]
    order = sorted(order, key=lambda number: not there[number])  # fixed campaigns that exist are used first
    names = [name for name in of_trials() if name in possible]
    ties = [
        Entry("tie", name, magnitude, 500 + number)
        for number, (magnitude, name) in enumerate((magnitude, name) for magnitude in CLEAR for name in names)
    ]
    planners: dict[int, Planner] = {}

    def one(entry: Entry, directory: Path, map_tasks: Map) -> Row:
        planner = planners.setdefault(id(map_tasks), Planner(map_tasks))
        return (run_few if entry.kind == "tie" else run)(planner, entry, directory, map_tasks, work)

    print(scoreboard(run_board([*(entries[number] for number in order), *ties], options, one)))


if __name__ == "__main__":
    main()
