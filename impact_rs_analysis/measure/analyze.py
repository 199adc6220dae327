# SPDX-License-Identifier: Apache-2.0
"""Experimental estimates and prediction errors from a folder of trials.

Damaged, foreign or unfinished bags are reported and left out. Trials without impact are reported and do not enter a
fit. Missing trials of the manifest are listed.
"""

from __future__ import annotations

import functools
import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from impact_rs_analysis.measure.arms import ArmDocument, arms_of
from impact_rs_analysis.measure.departure import ObjectDeparture, object_departures
from impact_rs_analysis.measure.far import Jump, far_jumps
from impact_rs_analysis.measure.linear_fit import FitError, LineFit, fit_zero_crossing
from impact_rs_analysis.measure.net_feedback import TrialFeedback, net_feedback
from impact_rs_analysis.measure.predictions import predict_arms, prediction_interval
from impact_rs_analysis.measure.published import PaperRow, published
from impact_rs_analysis.measure.sensitivity import Sensitivity, sensitivity_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import CONTACTS, ImpactMapError
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, Physics
from impact_rs_sim.schema import load
from impact_rs_trials.bags.reader import TrialBag, reason_of
from impact_rs_trials.campaign import MANIFEST, Manifest
from impact_rs_trials.file_names import BAG_METADATA
from impact_rs_trials.spec import recorded_scenario
from impact_rs_trials.store import trials_in
from impact_rs_trials.varied_settings import varied_folders
from impact_rs_trials.workers import Map

MIN_PARALLEL_BAGS = 100  # fewer are read faster in one process
MAX_IMPACT_SPREAD_S = 0.05  # between the impacts of two arms; later, velocity feedback disturbs the second one


@dataclass(frozen=True)
class SkippedBag:
    """A bag that did not enter the analysis.

    Attributes:
        name: Folder or file name.
        reason: The reason.
    """

    name: str
    reason: str


@dataclass(frozen=True)
class Prediction:
    """Prediction of one motor-inertia model for a set.

    Attributes:
        velocity: Post-impact velocity along the measured axis [m/s].
        error: (prediction - estimate) / estimate [%].
    """

    velocity: float
    error: float

    @classmethod
    def of(cls, velocity: float, fit: LineFit) -> Prediction:
        """A predicted velocity with its error against the estimate of a fit."""
        return cls(velocity, 100.0 * (velocity - fit.estimate) / fit.estimate)


@dataclass(frozen=True)
class ArmSet:
    """Result of a set for one of its arms.

    Attributes:
        name: The arm.
        fit: Line through the net feedback of this arm, with its zero crossing, signed along the axis.
        predictions: Predictions by motor-inertia model for the first contact, signed along the axis.
        predictions_settled: Predictions by motor-inertia model for the settled contact, signed along the axis.
    """

    name: str
    fit: LineFit
    predictions: dict[str, Prediction]
    predictions_settled: dict[str, Prediction]

    @property
    def speed(self) -> float:
        """Experimental estimate as a speed [m/s]."""
        return abs(self.fit.estimate)

    @property
    def half_interval(self) -> float | None:
        """Larger half of the 95 % interval of the estimate [m/s]; None without an interval."""
        interval = self.fit.interval
        return None if interval is None else max(abs(bound - self.fit.estimate) for bound in interval)

    def of_contact(self, contact: str) -> dict[str, Prediction]:
        """Predictions by motor-inertia model for the ``first`` or the ``settled`` contact."""
        return {"first": self.predictions, "settled": self.predictions_settled}[contact]

    def nearest(self, contact: str) -> str:
        """Motor-inertia model with the smallest mismatch."""
        return _nearest(self.of_contact(contact))

    def to_json(self) -> dict[str, Any]:
        """One entry of ``arms``; speeds in m/s, errors in percent."""
        sign = -1.0 if self.fit.estimate < 0.0 else 1.0
        interval = self.fit.interval
        return {
            "arm": self.name,
            "estimate_m_s": self.speed,
            "ci95_m_s": None if interval is None else sorted(sign * bound for bound in interval),
            "r_squared": self.fit.r_squared,
            "predictions": _signed(self.predictions, sign),
            "predictions_settled": _signed(self.predictions_settled, sign),
        }


@dataclass(frozen=True)
class ExperimentSet:
    """All trials of one object and case, with their result.

    Attributes:
        scenario: Name of the scenario.
        object: Name of the object.
        case: Full name of the case.
        axis: Measured axis.
        label: Object and case in words.
        trials: Trials with impact.
        fit: The line and its zero crossing, signed along the axis.
        predictions: Predictions by motor-inertia model for the first contact, signed along the axis.
        predictions_settled: Predictions by motor-inertia model for the settled contact, signed along the axis.
        prediction_interval: 95 % interval of the nominal prediction (B_theta, first contact) from the uncertainties
            that the scenario states, signed along the axis, low then high [m/s]; None if unavailable.
        ante_velocity: Ante-impact velocity, signed along the axis [m/s]; NaN where it is not known.
        published: Row of the paper with the same robot, object and velocity; None if the paper has no such row.
        arms: Results by arm, if there are several.
    """

    scenario: str
    object: str
    case: str
    axis: str
    label: str
    trials: tuple[TrialFeedback, ...]
    fit: LineFit
    predictions: dict[str, Prediction]
    predictions_settled: dict[str, Prediction]
    prediction_interval: tuple[float, float] | None = None
    ante_velocity: float = math.nan
    published: PaperRow | None = None
    arms: tuple[ArmSet, ...] = ()

    @property
    def jump(self) -> Jump:
        """Nominal prediction (B_theta, first contact) and estimate, signed along the axis."""
        return Jump(self.label, self.ante_velocity, self.predictions["reduced"].velocity, self.fit.estimate)

    def of_contact(self, contact: str) -> dict[str, Prediction]:
        """Predictions by motor-inertia model for the ``first`` or the ``settled`` contact."""
        return {"first": self.predictions, "settled": self.predictions_settled}[contact]

    @property
    def sign(self) -> float:
        """Direction of the motion along the axis: speed = sign * velocity."""
        return -1.0 if self.fit.estimate < 0.0 else 1.0

    @property
    def estimate(self) -> float:
        """Experimental estimate as a speed [m/s]."""
        return self.sign * self.fit.estimate

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval of the estimate as speeds [m/s]."""
        speeds = self._speeds(self.fit.interval)
        return None if speeds is None else (speeds[0], speeds[1])

    @property
    def tolerance(self) -> float | None:
        """Error up to which a prediction agrees with the estimate [%]; None where the estimate has no interval.

        The wider halves of the 95 % intervals of estimate and nominal prediction, added in squares. The uncertainties
        of the scenario apply to every motor inertia and contact, so all predictions have this tolerance.
        """
        if self.fit.interval is None:
            return None
        nominal = self.predictions["reduced"].velocity
        halves = [max(abs(bound - self.fit.estimate) for bound in self.fit.interval)]
        halves += [max(abs(bound - nominal) for bound in self.prediction_interval or (nominal,))]
        return 100.0 * math.hypot(*halves) / abs(self.fit.estimate)

    def _speeds(self, interval: tuple[float, float] | None) -> list[float] | None:
        return None if interval is None else sorted(self.sign * bound for bound in interval)

    def to_json(self) -> dict[str, Any]:
        """One entry of ``sets``; speeds in m/s, errors in percent."""
        return {
            "scenario": self.scenario,
            "object": self.object,
            "case": self.case,
            "axis": self.axis,
            "estimate_m_s": self.estimate,
            "ci95_m_s": None if self.interval is None else list(self.interval),
            "r_squared": self.fit.r_squared,
            "trials": self.fit.count,
            "predictions": _signed(self.predictions, self.sign),
            "prediction_ci95_m_s": self._speeds(self.prediction_interval),
            "tolerance_percent": self.tolerance,
            "predictions_settled": _signed(self.predictions_settled, self.sign),
            "arms": [arm.to_json() for arm in self.arms],
        }


def _signed(predictions: dict[str, Prediction], sign: float) -> dict[str, dict[str, float]]:
    return {
        model: {"v_m_s": sign * prediction.velocity, "error_percent": prediction.error}
        for model, prediction in predictions.items()
    }


@dataclass(frozen=True)
class Incomplete:
    """A set without an estimate.

    Attributes:
        scenario: Name of the scenario.
        object: Name of the object.
        case: Full name of the case.
        reason: Missing data.
    """

    scenario: str
    object: str
    case: str
    reason: str


@dataclass(frozen=True)
class Analysis:
    """Result of a folder of trials.

    Attributes:
        directory: The folder.
        sets: One per object and case that has enough trials.
        incomplete: Sets with too few trials.
        skipped: Bags that could not be used.
        missing: Trials of the manifest that do not exist.
        no_impact: Trials without impact.
        apart: Trials whose arms hit more than ``MAX_IMPACT_SPREAD_S`` apart, with the time between the impacts [s];
            they stay in the fit.
        limited: Trials with a joint at its torque limit in the window, with the joint and the duration [s]; they stay
            in the fit.
        departed: Sets whose object left the pad after the hit, while predictions assume lasting contact; they stay in
            the fit.
        sensitivity: Sensitivity of the estimates to settings; empty if none was varied.
        unsealed: Bags without checksums, in which changes are not detected.
        arms: Arms of the trials.
    """

    directory: Path
    sets: tuple[ExperimentSet, ...]
    incomplete: tuple[Incomplete, ...]
    skipped: tuple[SkippedBag, ...]
    missing: tuple[str, ...]
    no_impact: tuple[str, ...]
    apart: tuple[tuple[str, float], ...] = ()
    limited: tuple[tuple[str, str, float], ...] = ()
    departed: tuple[ObjectDeparture, ...] = ()
    sensitivity: Sensitivity = Sensitivity()
    unsealed: tuple[str, ...] = ()
    arms: tuple[ArmDocument, ...] = ()

    @property
    def jumps(self) -> list[Jump]:
        """Nominal prediction and estimate of every set."""
        return [entry.jump for entry in self.sets]

    def errors(self, model: str, contact: str) -> list[float]:
        """Percentage mismatch of a model in every set [%]."""
        return [entry.of_contact(contact)[model].error for entry in self.sets]

    def average_error(self, contact: str) -> dict[str, float | None]:
        """Mean of the percentage mismatch by model: the bias [%]; None without sets."""
        return {model: _mean(self.errors(model, contact)) for model in MOTOR_INERTIA_MODELS}

    def absolute_error(self, contact: str) -> dict[str, float | None]:
        """Mean of the absolute mismatch by model: the quality [%]; None without sets."""
        return {model: _mean([abs(error) for error in self.errors(model, contact)]) for model in MOTOR_INERTIA_MODELS}

    def nearest(self, contact: str) -> dict[str, int]:
        """Number of sets in which each model is nearest to the estimate."""
        counts = Counter(_nearest(entry.of_contact(contact)) for entry in self.sets)
        return {model: counts[model] for model in MOTOR_INERTIA_MODELS}

    def to_json(self) -> dict[str, Any]:
        """Document of ``analyze --json``."""
        return {
            "arms": [arm.model_dump(mode="json") for arm in self.arms],
            "sets": [
                entry.to_json() | {"systematic_percent": self.sensitivity.band(entry.scenario, entry.object)}
                for entry in self.sets
            ],
            "sensitivity": self.sensitivity.to_json(),
            "average_error_percent": self.average_error("first"),
            "average_error_percent_settled": self.average_error("settled"),
            "absolute_error_percent": self.absolute_error("first"),
            "absolute_error_percent_settled": self.absolute_error("settled"),
            "nearest_sets": self.nearest("first"),
            "nearest_sets_settled": self.nearest("settled"),
            "far": [vars(jump) | {"mismatch": jump.mismatch} for jump in far_jumps(self.jumps)],
            "incomplete": [vars(entry) for entry in self.incomplete],
            "skipped": [vars(entry) for entry in self.skipped],
            "unsealed": list(self.unsealed),
            "missing": list(self.missing),
            "no_impact": list(self.no_impact),
            "limited": [{"trial": name, "joint": joint, "time_s": time} for name, joint, time in self.limited],
            "object_left": [entry.to_json() for entry in self.departed],
            "apart": [{"trial": name, "between_impacts_s": spread} for name, spread in self.apart],
        }


def _nearest(predictions: dict[str, Prediction]) -> str:
    return min(MOTOR_INERTIA_MODELS, key=lambda model: abs(predictions[model].error))


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def feedback_of(path: Path) -> tuple[TrialFeedback | str, bool]:
    """Net feedback of a bag, or the reason why it cannot be used; and whether the bag has complete checksums."""
    try:
        bag = TrialBag.open(path)
        return net_feedback(bag), bag.sealed
    except Exception as error:  # a damaged bag must not stop the others
        return reason_of(error), True


def _bags_of(directory: Path) -> list[Path]:
    """Bags of a folder of trials; an :class:`InputError` if it has none."""
    if not directory.is_dir():
        raise InputError("no such folder", file=directory)
    if (directory / BAG_METADATA).is_file():
        raise InputError("this is a single trial; give the folder it lies in", file=directory)
    bags = trials_in(directory)
    if not bags:
        raise InputError("this folder holds no trials (a trial is a subfolder with a rosbag2 bag)", file=directory)
    return bags


def _sets_of(
    directory: Path, groups: Mapping[tuple[str, str, str], Sequence[TrialFeedback]]
) -> tuple[list[ExperimentSet], list[Incomplete]]:
    """Results of the sets, from trials by scenario, object and case, and the sets without a result."""
    sets, incomplete = [], []
    for key, trials in groups.items():
        try:
            sets.append(_evaluate(directory, [trial for trial in trials if trial.impact], trials[0]))
        except (FitError, InputError, ImpactMapError) as error:
            incomplete.append(Incomplete(*key, str(error)))
    return sets, incomplete


class _BagReader:
    """Reads bags, and lists the unusable ones and those without checksums."""

    def __init__(self, map_tasks: Map, progress: Callable[[int, int], None] | None, total: int) -> None:
        self.skipped: list[SkippedBag] = []
        self.unsealed: list[str] = []
        self._map, self._progress, self._total, self._count = map_tasks, progress, total, 0

    def read(self, paths: Sequence[Path], prefix: str = "") -> list[TrialFeedback]:
        """Net feedback of the usable trials."""
        usable = []
        map_paths = self._map if len(paths) > MIN_PARALLEL_BAGS else map
        for path, (feedback, sealed) in zip(paths, map_paths(feedback_of, paths), strict=True):
            if isinstance(feedback, str):
                self.skipped.append(SkippedBag(f"{prefix}{path.name}", feedback))
            else:
                usable.append(feedback)
            if not sealed:
                self.unsealed.append(f"{prefix}{path.name}")
            self._count += 1
            if self._progress is not None:
                self._progress(self._count, self._total)
        return usable


def analyze_campaign(
    directory: Path, progress: Callable[[int, int], None] | None = None, map_tasks: Map = map
) -> Analysis:
    """Analyse a folder of trials.

    Args:
        directory: Folder whose subfolders are bags.
        progress: Called with the number of bags read and the number of all bags.
        map_tasks: Parallel map, for campaigns of many trials.

    Raises:
        InputError: No such folder, or no usable trial in it.
    """
    bags = _bags_of(directory)
    varied_folder_names = varied_folders(directory)
    varied_bags = {key: trials_in(directory / folder) for key, folder in varied_folder_names.items()}
    total = len(bags) + sum(map(len, varied_bags.values()))
    reader = _BagReader(map_tasks, progress, total)
    trials_read = reader.read(bags)
    if not trials_read:
        first = reader.skipped[0]
        raise InputError(
            f"none of its {len(bags)} bags is a trial that can be used; {first.name}: {first.reason}",
            file=directory,
        )
    varied_trials = {key: reader.read(paths, f"{varied_folder_names[key]}/") for key, paths in varied_bags.items()}
    missing = _missing(directory, reader.skipped)
    trials_read = _one_scenario_each(trials_read, reader.skipped)
    groups: dict[tuple[str, str, str], list[TrialFeedback]] = defaultdict(list)
    for trial in trials_read:
        groups[trial.info.scenario, trial.info.object, trial.info.case_name].append(trial)
    sets, incomplete = _sets_of(directory, groups)
    return Analysis(
        directory=directory,
        sets=tuple(_in_order(sets, trials_read)),
        incomplete=tuple(incomplete),
        skipped=tuple(reader.skipped),
        unsealed=tuple(reader.unsealed),
        missing=tuple(missing),
        no_impact=tuple(trial.name for trial in trials_read if not trial.impact),
        apart=tuple(
            (trial.name, trial.spread) for trial in trials_read if trial.impact and trial.spread > MAX_IMPACT_SPREAD_S
        ),
        limited=tuple(
            (prefix + trial.name, *entry)
            for prefix, trials in [
                ("", trials_read),
                *((f"{varied_folder_names[key]}/", varied_set) for key, varied_set in varied_trials.items()),
            ]
            for trial in trials
            for entry in trial.limited
        ),
        departed=tuple(
            object_departures(
                {key: [trial.departures for trial in set_trials if trial.impact] for key, set_trials in groups.items()}
            )
        ),
        sensitivity=sensitivity_of(trials_read, varied_trials),
        arms=arms_of(
            Physics.nominal(scenario, next(iter(scenario.objects)))
            for text in dict.fromkeys(trial.info.scenario_json for trial in trials_read)
            for scenario in [recorded_scenario(text, directory)]
        ),
    )


def _missing(directory: Path, skipped: list[SkippedBag]) -> list[str]:
    """Trials of the manifest without a folder; a broken manifest is only reported."""
    if not (directory / MANIFEST).exists():
        return []
    try:
        manifest = load(Manifest, directory / MANIFEST)
    except InputError as error:
        skipped.append(SkippedBag(MANIFEST, error.message))
        return []
    return [key.name for key in manifest.keys if not (directory / key.name).exists()]


@functools.lru_cache(maxsize=64)
def _version_of(scenario_json: str) -> str:
    """A recorded scenario without its uncertainties and assumptions, which do not change a trial."""
    try:
        data = json.loads(scenario_json)
        data.pop("uncertainty", None)
        for robot in data["robots"].values():
            robot["drive"].pop("assumed", None)
    except (ValueError, KeyError, AttributeError):  # the reader of the trial reports the error
        return scenario_json
    return json.dumps(data)


def _one_scenario_each(trials: list[TrialFeedback], skipped: list[SkippedBag]) -> list[TrialFeedback]:
    """Trials of the most frequent version of every scenario; the others are skipped."""
    versions: dict[str, Counter[str]] = defaultdict(Counter)
    for trial in trials:
        versions[trial.info.scenario][_version_of(trial.info.scenario_json)] += 1
    common_version = {name: counter.most_common(1)[0][0] for name, counter in versions.items()}
    matching = []
    for trial in trials:
        if _version_of(trial.info.scenario_json) == common_version[trial.info.scenario]:
            matching.append(trial)
        else:
            reason = f"recorded with another version of scenario {trial.info.scenario!r} than most trials of the folder"
            skipped.append(SkippedBag(trial.name, reason))
    return matching


def _evaluate(directory: Path, trials: list[TrialFeedback], first_trial: TrialFeedback) -> ExperimentSet:
    info = first_trial.info
    scenario = recorded_scenario(info.scenario_json, directory / first_trial.name)
    if scenario.object(info.object).fixed:
        raise FitError(
            f"{info.object} is fixed: it stops the pad whatever the reference is, so that no net feedback measures the "
            "velocity after the impact; compare and diagnose judge the model by all signals"
        )
    references = np.array([trial.info.reference_post_velocity for trial in trials])
    fit = fit_zero_crossing(references, np.array([trial.net for trial in trials]))
    by_contact = [predict_arms(scenario, info.object, info.case_name, contact) for contact in CONTACTS]
    first, settled = (
        {model: Prediction.of(float(np.mean(list(velocities.values()))), fit) for model, velocities in by_model.items()}
        for by_model in by_contact
    )
    arms = []
    for arm in info.robots if len(info.robots) > 1 else ():
        with suppress(FitError):  # the mean of the arms may have an estimate even if one arm has none
            arm_fit = fit_zero_crossing(references, np.array([trial.nets[arm] for trial in trials]))
            first_settled = [
                {model: Prediction.of(entry[arm], arm_fit) for model, entry in by_model.items()}
                for by_model in by_contact
            ]
            arms.append(ArmSet(arm, arm_fit, *first_settled))
    return ExperimentSet(
        scenario=info.scenario,
        object=info.object,
        case=info.case_name,
        axis=info.axis,
        label=f"{scenario.object(info.object).label}: {scenario.case(info.case_name).label}",
        trials=tuple(trials),
        fit=fit,
        predictions=first,
        predictions_settled=settled,
        prediction_interval=prediction_interval(info.scenario_json, info.object, info.case_name),
        ante_velocity=info.ante_velocity,
        published=published(scenario, info.object, info.case_name),
        arms=tuple(arms),
    )


def _in_order(sets: list[ExperimentSet], trials: list[TrialFeedback]) -> list[ExperimentSet]:
    """Sets in the order of objects and cases in the scenario."""
    order: dict[tuple[str, str, str], tuple[str, int, int]] = {}
    for scenario_json, scenario_name in {(trial.info.scenario_json, trial.info.scenario) for trial in trials}:
        scenario = recorded_scenario(scenario_json, scenario_name)
        for object_index, object_name in enumerate(scenario.objects):
            for case_index, case in enumerate(scenario.cases):
                order[scenario_name, object_name, case] = (scenario_name, object_index, case_index)
    return sorted(sets, key=lambda entry: order[entry.scenario, entry.object, entry.case])
