# SPDX-License-Identifier: Apache-2.0
"""Campaigns: a folder of trials with a manifest, run in parallel, resumed where they stopped.

A trial is a pure function of scenario, key and campaign seed, so it does not matter where or in which order trials run.
On a real robot it does: friction falls as it warms up, pads wear. Trials therefore run in randomised blocks (Fisher
1935, *The Design of Experiments*): repeat by repeat, with every condition once in each, in an order drawn from the
campaign seed. A drift is then seen between repeats, and does not look like an effect of the conditions.
``manifest.yaml`` describes the campaign. A trial with a complete bag is never run again, one with an incomplete bag is.
``.failures/TRIAL.txt`` says why a trial was aborted, with the traceback of its process, until its bag is complete.
"""

from __future__ import annotations

import functools
import logging
import shutil
import socket
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import yaml
from pydantic import Field, model_validator

from impact_rs_control.plan import check_scale
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.plant.mechanics import Simulator
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import PositiveVector, Schema, omitted, parse_yaml, validate
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.bags.trial_info import OUTCOMES, VIA, Outcome, TrialInfo, TrialKey
from impact_rs_trials.bags.writer import partial_path
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.store import Store, open_store, owned
from impact_rs_trials.workers import SchedulerLost, Workforce, as_they_end, client_of

if TYPE_CHECKING:
    from distributed import Client

MANIFEST = "manifest.yaml"
FAILURES = ".failures"

Order = Literal["random", "listed"]

logger = logging.getLogger(__name__)


class PlannedTrials(Schema):
    """One condition of a plan, with its repeats."""

    object: str = Field(description="name of the object")
    case: str = Field(description="full name of the case")
    scale: float = Field(1.0, gt=0.0, description="post-impact reference over prediction [-]")
    trials: int = Field(ge=1, description="repeats")
    what: str = Field("", description="the trial in words")
    buys: str = Field("", description="what these trials add, in words")


class Manifest(Schema):
    """Manifest of a campaign folder (``manifest.yaml``)."""

    scenario: str = Field(description="name or path of the scenario file")
    objects: tuple[str, ...] = Field(min_length=1, description="names of the objects")
    cases: tuple[str, ...] = Field(min_length=1, description="full names of the cases")
    velocity_scales: PositiveVector = Field(min_length=1, description="post-impact references [-]")
    trials: int = Field(ge=1, description="repeats of every scale")
    seed: int = Field(ge=0, description="seed of the campaign")
    motor_inertia: str = Field("reduced", description="motor-inertia model of the reference")
    settings: dict[str, Any] = Field({}, description="values that the scenario has instead of its own, by dotted key")
    plant: Simulator = Field("bullet", description="simulator of the plant: bullet or twin")
    order: Order = Field(
        "listed",
        description="random: repeat by repeat, conditions in random order, drawn from the seed; listed: condition by "
        "condition",
    )
    planned: tuple[PlannedTrials, ...] = omitted(
        (), description="the conditions of a plan, each with its own repeats; none: every object, case and scale"
    )

    @model_validator(mode="after")
    def _each_trial_has_its_bag(self) -> Self:
        repeated = [name for name, count in Counter(key.name for key in self.keys).items() if count > 1]
        if repeated:
            raise ValueError(f"{len(repeated)} bags would hold several trials, the first is {repeated[0]}")
        return self

    @property
    def keys(self) -> list[TrialKey]:
        """Every trial of the campaign, condition by condition."""
        if self.planned:
            return [
                TrialKey(condition.object, condition.case, condition.scale, repeat)
                for condition in self.planned
                for repeat in range(condition.trials)
            ]
        return [
            TrialKey(name, case, scale, repeat)
            for name in self.objects
            for case in self.cases
            for scale in self.velocity_scales
            for repeat in range(self.trials)
        ]

    @property
    def in_order(self) -> list[TrialKey]:
        """Every trial of the campaign, in the order in which they run."""
        if self.order == "listed":
            return self.keys
        rng = np.random.default_rng(self.seed)
        keys = self.keys
        conditions, wanted = [key for key in keys if key.repeat == 0], set(keys)
        shuffled = [
            replace(conditions[number], repeat=repeat)
            for repeat in range(1 + max(key.repeat for key in keys))
            for number in rng.permutation(len(conditions))
        ]
        return [key for key in shuffled if key in wanted]

    def trial(self, key: TrialKey) -> Trial:
        """One trial, complete for any worker.

        Raises:
            InputError: The scenario does not exist (any more), or has lost this object, case or setting.
        """
        scenario = load_scenario(self.scenario).with_settings(self.settings)
        spec = TrialSpec.of(scenario, key.object, key.case, key.scale, self.motor_inertia)
        return Trial.of(spec, key.repeat, self.seed, self.plant)


@dataclass(frozen=True)
class Trial:
    """One trial, with all that is needed to run it anywhere.

    Attributes:
        spec: Common properties of its repeats.
        repeat: Number of the repeat, from 0.
        seed: Seed of its random numbers.
        plant: Simulator of its plant.
    """

    spec: TrialSpec
    repeat: int
    seed: int
    plant: Simulator = "bullet"

    @classmethod
    def of(cls, spec: TrialSpec, repeat: int, campaign_seed: int, plant: Simulator = "bullet") -> Trial:
        """The trial of a campaign with this seed."""
        return cls(spec, repeat, TrialKey(spec.object, spec.case, spec.scale, repeat).seed(campaign_seed), plant)

    @property
    def key(self) -> TrialKey:
        """Key of the trial in its campaign."""
        return TrialKey(self.spec.object, self.spec.case, self.spec.scale, self.repeat)


@dataclass(frozen=True)
class TrialReport:
    """Result of one trial of a campaign.

    Attributes:
        key: Key of the trial.
        outcome: One of ``OUTCOMES``.
        message: Reason of a failure in one line; else empty.
        trace: Traceback of the process that ran it, or the output of its nodes, if any.
    """

    key: TrialKey
    outcome: Outcome
    message: str = ""
    trace: str = ""


def make_manifest(
    scenario_name: str,
    objects: Sequence[str] | None = None,
    cases: Sequence[str] | None = None,
    scales: Sequence[float] | None = None,
    trials: int | None = None,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    plant: Simulator = "bullet",
    order: Order = "random",
) -> Manifest:
    """A manifest; arguments that are None have the values of the scenario.

    Raises:
        InputError: Unknown scenario, object, case or setting, a pose that cannot be reached, a set without friction
            compensation where the scenario has one, a scale out of range, fewer than one trial,
            or two trials of one name.
    """
    scenario = load_scenario(scenario_name).with_settings(settings or {})
    for name in objects or []:
        scenario.object(name)
    for scale in scales or []:
        check_scale(scale)
    if trials is not None and trials < 1:
        raise InputError(f"trials = {trials}: expected at least 1")
    if seed < 0:
        raise InputError(f"seed = {seed}: expected a whole number >= 0")
    content = {
        "scenario": scenario_name,
        "objects": tuple(dict.fromkeys(objects or scenario.objects)),
        "cases": tuple(dict.fromkeys(scenario.case_name(case) for case in cases or scenario.cases)),
        "velocity_scales": tuple(dict.fromkeys(scales or scenario.velocity_scales)),
        "trials": trials or scenario.trials,
        "seed": seed,
        "motor_inertia": "reduced",
        "settings": dict(settings or {}),
        "plant": plant,
        "order": order,
    }
    manifest = validate(Manifest, content, f"campaign of scenario {scenario.name!r}")
    for name in manifest.objects:
        for case in manifest.cases:
            _ = TrialSpec.of(scenario, name, case).scene  # its pose can be reached
            if scenario.friction_compensation is not None:
                scenario.friction_compensation.arms(name, case)
    return manifest


def open_campaign(place: str | Path | Store, manifest: Manifest) -> list[TrialKey]:
    """Prepare the folder or URL of a campaign, and return the missing trials.

    Raises:
        InputError: It holds another campaign, or cannot be written.
    """
    store = open_store(place)
    todo = still_to_run(store, manifest)
    if not store.exists(MANIFEST):
        store.write(MANIFEST, yaml.safe_dump(manifest.model_dump(mode="json"), sort_keys=False))
    return todo


def still_to_run(store: Store, manifest: Manifest) -> list[TrialKey]:
    """The missing trials of a campaign, in the order of its start.

    Raises:
        InputError: The place holds another campaign, or cannot be read.
    """
    if store.exists(MANIFEST):
        path = f"{store}/{MANIFEST}"
        present = validate(Manifest, parse_yaml(store.read(MANIFEST), path), path)
        manifest = manifest.model_copy(update={"order": present.order})  # no trial depends on it
        if present != manifest:
            changed = [name for name in Manifest.model_fields if getattr(present, name) != getattr(manifest, name)]
            raise InputError(
                f"this folder holds another campaign (it differs in {', '.join(changed)}); choose another folder",
                file=path,
            )
    names = store.names()
    return [key for key in manifest.in_order if key.name not in names]


def run_one(directory: Path, trial: Trial) -> TrialReport:
    """Run one trial in-process and write its bag.

    An incomplete bag is removed first; a complete one is kept (a worker can die after writing a bag and before
    reporting it).
    """
    key = trial.key
    path = directory / key.name
    if path.exists():
        return report_of_bag(key, path)
    shutil.rmtree(partial_path(path), ignore_errors=True)
    plan = trial.spec.plan
    info = TrialInfo.of(plan, key, trial.seed, VIA[trial.plant])
    verdict, _ = record_trial(plan, info, path)
    return TrialReport(key, verdict.outcome, verdict.reason)


def report_of_bag(key: TrialKey, path: Path) -> TrialReport:
    """Report of a trial whose bag exists.

    Args:
        key: The trial.
        path: Its complete bag; incomplete ones have another name.
    """
    try:
        bag = TrialBag.open(path)
    except BagError as error:
        logger.info("a finished bag counts as ABORTED: %s", error)
        return TrialReport(key, "ABORTED", error.reason)
    outcome = bag.outcome if bag.outcome in OUTCOMES else "ABORTED"
    return TrialReport(key, outcome, "" if outcome == "OK" else bag.reason)  # type: ignore[arg-type]


def wrong_outcomes(reports: Iterable[TrialReport]) -> list[str]:
    """Summary of the unsuccessful trials of a campaign: a line per outcome, the gravest first.

    A line has the number of trials, and the reason and name of the first in alphabetical order. Aborted trials have no
    bag and are reported one by one elsewhere.
    """
    by_outcome: dict[str, list[TrialReport]] = {outcome: [] for outcome in OUTCOMES}
    for report in sorted(reports, key=lambda report: report.key.name):
        by_outcome[report.outcome].append(report)
    return [
        f"{outcome} {len(equal)}: {equal[0].message or OUTCOMES[outcome]} ({equal[0].key.name})"
        for outcome, equal in by_outcome.items()
        if equal and outcome not in ("OK", "ABORTED")
    ]


def record_failure(store: Store, report: TrialReport) -> TrialReport:
    """Write why a trial was aborted to ``.failures``; for a finished trial, remove the file of an earlier run.

    Returns:
        The same report.
    """
    name = f"{FAILURES}/{report.key.name}.txt"
    try:
        if report.outcome == "ABORTED":
            store.write(name, f"{report.message or 'aborted'}\n\n{report.trace}".rstrip() + "\n")
        else:
            store.remove(name)
    except InputError as error:  # a full disk may be why the trial failed
        logger.warning("%s", error)
    return report


TrialRunner = Callable[[Path, Trial], TrialReport]


def run_campaign(
    place: str | Path | Store, manifest: Manifest, workforce: Workforce | None = None, run: TrialRunner = run_one
) -> Iterator[TrialReport]:
    """Run the missing trials; yields a report at the end of each.

    Stopping the iteration, or an interrupt, leaves a folder in which the campaign can be resumed.

    Args:
        place: Campaign folder, or its URL.
        manifest: The campaign.
        workforce: Workers that run it; None: this process.
        run: Runs one trial, and writes its bag into the given folder.

    Raises:
        InputError: The folder holds another campaign, another process works on it, the scheduler cannot be used, or
            one of its workers does not see the folder.
        SchedulerLost: The scheduler went away.
    """
    store = open_store(place)
    with owned(store):
        for _, report in run_campaigns({store: manifest}, workforce, run):
            yield report


def run_campaigns(
    campaigns: Mapping[Store, Manifest], workforce: Workforce | None = None, run: TrialRunner = run_one
) -> Iterator[tuple[Store, TrialReport]]:
    """Run the missing trials of several campaigns of the caller; yields folder or URL and report at the end of each.

    Raises:
        InputError: As :func:`run_campaign`.
        SchedulerLost: The scheduler went away.
    """
    todo = {store: still_to_run(store, manifest) for store, manifest in campaigns.items()}
    count = sum(map(len, todo.values()))
    workforce = (workforce or Workforce()).at_most(count)
    tasks = ((store, campaigns[store].trial(key)) for store, keys in todo.items() for key in keys)
    if workforce.in_process or not count:
        for store, manifest in campaigns.items():
            open_campaign(store, manifest)
        for store, trial in tasks:
            yield store, record_failure(store, run_in(store, run, trial))
        return
    with client_of(workforce) as client:
        for store, manifest in campaigns.items():  # now that there are workers: without them nothing is left behind
            open_campaign(store, manifest)
        for store, report in _run_on_cluster(client, run, tasks):
            yield store, record_failure(store, report)


def _run_on_cluster(
    client: Client, run: TrialRunner, tasks: Iterable[tuple[Store, Trial]]
) -> Iterator[tuple[Store, TrialReport]]:
    """Run trials on a cluster; a worker remembers the plans of the conditions that it has met."""
    try:
        for (store, trial), report in as_they_end(client, functools.partial(_run_task, run), tasks):
            if isinstance(report, TrialReport):
                yield store, report
            else:
                reason = f"its worker process died repeatedly ({report})"
                yield store, TrialReport(trial.key, "ABORTED", reason)
    except SchedulerLost as error:
        raise SchedulerLost(f"{error}; the same command goes on where it stopped") from None


def _run_task(run: TrialRunner, task: tuple[Store, Trial]) -> TrialReport:
    return run_in(task[0], run, task[1])


def run_in(store: Store, run: TrialRunner, trial: Trial) -> TrialReport:
    """Run one trial if it is missing; a failed one does not end a campaign.

    Raises:
        InputError: This machine does not see the campaign's folder.
    """
    if not store.exists(MANIFEST):
        raise InputError(
            f"{socket.gethostname()} finds no {MANIFEST} here; expected a folder that all workers share, or a URL",
            file=str(store),
        )
    key = trial.key
    try:
        if store.exists(key.name):
            with store.getting(key.name) as directory:
                return report_of_bag(key, directory / key.name)
        with store.adding(key.name) as directory:
            return run(directory, trial)
    except InputError as error:
        return TrialReport(key, "ABORTED", str(error), full_traceback(error))
    except Exception as error:  # whatever it is, it is reported and the other trials go on
        return TrialReport(key, "ABORTED", f"{type(error).__name__}: {error}", full_traceback(error))
