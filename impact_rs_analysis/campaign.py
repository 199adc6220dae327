"""Campaigns: a folder of trials with a manifest, run in parallel, resumed where they stopped.

A trial is a pure function of scenario file, key and campaign seed, so it does not matter where or in which order trials
run. ``manifest.yaml`` says what the folder holds; a finished bag is never run again, a half-written one is.
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml
from pydantic import Field

from impact_rs_analysis.bags.reader import BagError, TrialBag
from impact_rs_analysis.bags.record import record_trial
from impact_rs_analysis.bags.trial_info import Outcome, TrialInfo, TrialKey
from impact_rs_analysis.bags.writer import partial_path
from impact_rs_analysis.workers import local_client
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenario import Scenario, load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import PositiveVector, Schema, load

MANIFEST = "manifest.yaml"


class Manifest(Schema):
    """What a campaign folder holds (``manifest.yaml``)."""

    scenario: str = Field(description="name or path of the scenario file")
    objects: tuple[str, ...] = Field(min_length=1, description="names of the objects")
    cases: tuple[str, ...] = Field(min_length=1, description="full names of the cases")
    velocity_scales: PositiveVector = Field(min_length=1, description="post-impact references [-]")
    trials: int = Field(ge=1, description="repeats of every scale")
    seed: int = Field(ge=0, description="seed of the campaign")
    motor_inertia: str = Field("reduced", description="motor-inertia model of the reference")

    @property
    def keys(self) -> list[TrialKey]:
        """Every trial of the campaign, in order."""
        return [
            TrialKey(name, case, scale, repeat)
            for name in self.objects
            for case in self.cases
            for scale in self.velocity_scales
            for repeat in range(self.trials)
        ]


@dataclass(frozen=True)
class TrialReport:
    """How one trial of a campaign went.

    Attributes:
        key: Which trial.
        outcome: OK, NO-IMPACT, DROPPED or ABORTED.
        message: What went wrong, if anything.
    """

    key: TrialKey
    outcome: Outcome
    message: str = ""


def make_manifest(
    scenario_name: str,
    objects: list[str] | None = None,
    cases: list[str] | None = None,
    scales: list[float] | None = None,
    trials: int | None = None,
    seed: int = 0,
) -> Manifest:
    """A manifest with the scenario's own values where nothing is given.

    Raises:
        InputError: Unknown scenario, object or case, a pose that cannot be reached, a set without friction compensation
            where the scenario has one, a scale that is not positive, or fewer than one trial.
    """
    scenario = load_scenario(scenario_name)
    for name in objects or []:
        scenario.object(name)
    for scale in scales or []:
        if not scale > 0.0:
            raise InputError(f"velocity scale = {scale!r}: expected a number > 0 [-]")
    if trials is not None and trials < 1:
        raise InputError(f"trials = {trials}: expected at least 1")
    if seed < 0:
        raise InputError(f"seed = {seed}: expected a whole number >= 0")
    manifest = Manifest(
        scenario=scenario_name,
        objects=tuple(dict.fromkeys(objects or scenario.objects)),
        cases=tuple(dict.fromkeys(scenario.case_name(case) for case in cases or scenario.cases)),
        velocity_scales=tuple(dict.fromkeys(scales or scenario.velocity_scales)),
        trials=trials or scenario.trials,
        seed=seed,
        motor_inertia="reduced",
    )
    for name in manifest.objects:
        for case in manifest.cases:
            Scene.resolve(scenario, name, case)
            if scenario.friction_compensation is not None:
                scenario.friction_compensation.arms(name, case)
    return manifest


def open_campaign(directory: Path, manifest: Manifest) -> list[TrialKey]:
    """Prepare a folder and return the trials that are still to be run.

    Raises:
        InputError: The folder holds another campaign.
    """
    path = directory / MANIFEST
    if path.exists():
        present = load(Manifest, path)
        if present != manifest:
            changed = [name for name in Manifest.model_fields if getattr(present, name) != getattr(manifest, name)]
            raise InputError(
                f"this folder holds another campaign (it differs in {', '.join(changed)}); choose another folder",
                file=path,
            )
    else:
        try:
            directory.mkdir(parents=True, exist_ok=True)
            path.write_text(yaml.safe_dump(manifest.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=path) from None
    return [key for key in manifest.keys if not (directory / key.name).exists()]


@functools.lru_cache(maxsize=16)
def _scene(scenario: str, object_name: str, case_name: str) -> Scene:
    return Scene.resolve(Scenario.model_validate_json(scenario), object_name, case_name)


@functools.lru_cache(maxsize=16)
def _plan(scenario: str, object_name: str, case_name: str, scale: float, inertia: str) -> TrialPlan:
    """Repeats of a trial share its plan: inverse kinematics and impact map are solved once per worker.

    The key is the scenario's content, for the file may be edited, or one that it names.
    """
    return plan_trial(_scene(scenario, object_name, case_name), scale, inertia)


def run_one(directory: Path, manifest: Manifest, key: TrialKey) -> TrialReport:
    """Run one trial in-process and write its bag.

    A half-written bag of it is thrown away first; a finished one stands (a worker can die between writing a bag and
    telling so).
    """
    path = directory / key.name
    if path.exists():
        return TrialReport(key, _outcome(path))
    shutil.rmtree(partial_path(path), ignore_errors=True)
    plan = _plan(
        load_scenario(manifest.scenario).model_dump_json(), key.object, key.case, key.scale, manifest.motor_inertia
    )
    info = TrialInfo.of(plan, key, key.seed(manifest.seed), "inprocess")
    outcome, _ = record_trial(plan, info, path)
    return TrialReport(key, outcome)


def _outcome(path: Path) -> Outcome:
    try:
        found = TrialBag(path).outcome
    except BagError:
        return "ABORTED"
    return found if found in ("OK", "NO-IMPACT", "DROPPED") else "ABORTED"  # type: ignore[return-value]


TrialRunner = Callable[[Path, Manifest, TrialKey], TrialReport]


def run_campaign(
    directory: Path, manifest: Manifest, jobs: int = 1, run: TrialRunner = run_one
) -> Iterator[TrialReport]:
    """Run what is missing; yields a report per trial as it ends.

    Stopping the iteration, or an interrupt, leaves a folder in which the campaign can be resumed.

    Args:
        directory: Campaign folder.
        manifest: What to run.
        jobs: Worker processes of a local ``dask.distributed`` cluster; 1 runs in this process.
        run: Runs one trial.

    Raises:
        InputError: The folder holds another campaign, or ``jobs`` is below 1.
    """
    if jobs < 1:
        raise InputError(f"jobs = {jobs}: expected at least 1 worker process")
    todo = open_campaign(directory, manifest)
    if jobs == 1 or len(todo) <= 1:
        for key in todo:
            yield _guarded(run, directory, manifest, key)
        return
    yield from _run_on_cluster(directory, manifest, min(jobs, len(todo)), run, todo)


def _run_on_cluster(
    directory: Path, manifest: Manifest, jobs: int, run: TrialRunner, todo: list[TrialKey]
) -> Iterator[TrialReport]:
    """Run trials on a local cluster; a trial whose worker dies is run again on another one."""
    from distributed import as_completed

    with local_client(jobs) as client:
        # One key to a task, in order: repeats of a trial follow each other and share their plan.
        futures = client.map(
            _guarded, *zip(*((run, directory, manifest, key) for key in todo), strict=True), pure=False, retries=2
        )
        keys = {future.key: key for future, key in zip(futures, todo, strict=True)}
        for future in as_completed(futures, loop=client.loop):
            if future.status == "finished":
                yield future.result()
            else:  # its workers died, again and again
                yield TrialReport(keys[future.key], "ABORTED", f"its worker process died ({future.exception()})")


def _guarded(run: TrialRunner, directory: Path, manifest: Manifest, key: TrialKey) -> TrialReport:
    """One broken trial does not end a campaign."""
    try:
        return run(directory, manifest, key)
    except InputError as error:
        return TrialReport(key, "ABORTED", str(error))
    except Exception as error:  # whatever it is, it is reported and the other trials go on
        return TrialReport(key, "ABORTED", f"{type(error).__name__}: {error}")
