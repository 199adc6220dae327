"""RUNS: a folder of bags, read into feature vectors with what they are to be compared with."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.features import Feature, extract, layout
from impact_rs_analysis.evidence.signals import signals_of_bag
from impact_rs_analysis.evidence.twin import Start
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.workers import Map


@dataclass(frozen=True)
class Condition:
    """What repeats have in common.

    Attributes:
        spec: What was run.
    """

    spec: TrialSpec

    @property
    def scenario(self) -> str:
        """Name of the scenario."""
        return self.spec.scenario.name

    @property
    def object(self) -> str:
        """Name of the object."""
        return self.spec.object

    @property
    def case(self) -> str:
        """Full name of the case."""
        return self.spec.case

    @property
    def scale(self) -> float:
        """Post-impact reference velocity over predicted velocity [-]."""
        return self.spec.scale

    @property
    def label(self) -> str:
        """Short name for tables."""
        text = f"{self.scenario}/{self.object}/{self.case}"
        return text if self.scale == 1.0 else f"{text}/s{self.scale:.2f}"

    @property
    def plan(self) -> TrialPlan:
        """References and nominal physics; the same for all repeats."""
        return self.spec.plan

    @property
    def features(self) -> tuple[Feature, ...]:
        """What the entries of its feature vectors are."""
        plan = self.plan
        joint_count = next(iter(plan.arms.values())).initial.size
        return layout(tuple(plan.arms), joint_count, plan.expects_impact)


@dataclass(frozen=True)
class MeasuredTrial:
    """One trial, boiled down.

    Attributes:
        path: Its bag.
        condition: What it shares with its repeats.
        features: Measured feature vector.
        start: Where it started.
    """

    path: Path
    condition: Condition
    features: Array
    start: Start


@dataclass(frozen=True)
class Runs:
    """Everything readable in a folder.

    Attributes:
        directory: The folder.
        trials: Trials with an impact, or without one where none was meant.
        skipped: Path and reason of every bag that cannot be used.
    """

    directory: Path
    trials: tuple[MeasuredTrial, ...]
    skipped: tuple[tuple[str, str], ...]

    @property
    def conditions(self) -> list[Condition]:
        """Conditions in order of appearance."""
        return list(dict.fromkeys(trial.condition for trial in self.trials))


def find_bags(directory: Path) -> list[Path]:
    """Folders below ``directory`` that look like bags; hidden ones are half-written."""
    if not directory.is_dir():
        raise InputError("no such folder", file=directory)
    found = {path.parent for pattern in ("*.mcap", "*.db3", "metadata.yaml") for path in directory.rglob(pattern)}
    return sorted(path for path in found if not any(part.startswith(".") for part in path.relative_to(directory).parts))


def read_trial(path: Path) -> MeasuredTrial | tuple[str, str]:
    """One trial, or path and reason why it cannot be used."""
    try:
        bag = TrialBag.open(path)
        if bag.outcome == "NO-IMPACT":
            return str(path), "NO-IMPACT: nothing was hit"
        if bag.outcome not in ("OK", "DROPPED"):
            return str(path), f"{bag.outcome}: the trial did not end"
        condition = Condition(bag.info.spec)
        plan = condition.plan
        signals = signals_of_bag(bag)
        features = extract(signals, plan)
        if features is None:
            return str(path), "NO-IMPACT: nothing was hit"
        if not np.isfinite(features).all():
            return str(path), "its signals do not cover the windows of the scenario"
        return MeasuredTrial(path, condition, features, Start.measured(signals, plan))
    except (BagError, InputError, ValueError, IndexError) as error:
        return str(path), str(error)


def read_runs(directory: Path, map_tasks: Map) -> Runs:
    """Read every trial below a folder.

    Raises:
        InputError: The folder does not exist or holds no usable trial.
    """
    results = list(map_tasks(read_trial, find_bags(directory)))
    trials = tuple(result for result in results if isinstance(result, MeasuredTrial))
    skipped = tuple(result for result in results if not isinstance(result, MeasuredTrial))
    if not trials:
        reason = f"; {len(skipped)} bag(s) cannot be used, the first because: {skipped[0][1]}" if skipped else ""
        raise InputError(f"no usable trials here{reason}", file=directory)
    return Runs(directory, trials, skipped)


def runs_digest(directory: Path) -> str:
    """Identity of the trials in a folder: names, scenarios and seeds; where the folder lies does not count."""
    rows = []
    for path in find_bags(directory):
        try:
            info = TrialBag.open(path).info
        except BagError:
            continue
        scenario = hashlib.sha256(info.scenario_json.encode()).hexdigest()
        rows.append(f"{path.name} {scenario} {info.seed}")
    return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()[:16]
