"""Where a model fails: measurement against model on three levels, and one number per model.

* **jump**: the impact map with the model's physics against the measured velocity jump,
* **free motion**: torque balances and deflections in windows without contact,
* **trial**: the twin in closed loop, through impact and push.

Every difference is given in its unit and in multiples of what repetition explains, so that torques and velocities can
be ranked together. The score is the one the diagnosis lowers:

    score^2 = mean over conditions c of mean over features f of (mean over repeats of r_cf / sigma_f)^2
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_rs_analysis.diagnosis.jump import JOINTS, JumpEntry, jump_entries, root_mean_square
from impact_rs_analysis.evidence.clusters import ConditionEvidence, gather
from impact_rs_analysis.evidence.rollouts import Progress, RolloutStore, residuals
from impact_rs_analysis.evidence.runs import Runs
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array
from impact_rs_trials.workers import Map

SCORE_IS = (
    "root mean square difference between measurement and twin over all features and conditions, in multiples of what "
    "repeating a trial explains"
)
LEVEL_PHASES = {"free_motion": ("free",), "trial": ("impact", "push")}


@dataclass(frozen=True)
class Cell:
    """One place where a model may fail.

    Attributes:
        scenario: Scenario.
        object: Object.
        case: Case.
        phase: ``free``, ``impact`` or ``push``.
        signal: What was compared.
        index: Joint or axis.
        error: Measured minus twin in the worst time bin, with its sign, in ``unit``.
        unit: Unit.
        times_noise: Root mean square over the time bins, in multiples of what repetition explains [-].
    """

    scenario: str
    object: str
    case: str
    phase: str
    signal: str
    index: str
    error: float
    unit: str
    times_noise: float


@dataclass(frozen=True)
class Comparison:
    """Model against measurement.

    Attributes:
        model: Name of the model.
        digest: Digest of its content.
        runs: The measurements.
        evidence: Scaled residuals by condition.
        score: One number for the model (``SCORE_IS``).
        noise_floor: What the score would be if only repetition were left; None if nothing was repeated.
        jump: Impact map against measured jumps.
        where: Places by size.
        remarks: What a reader should know.
    """

    model: str
    digest: str
    runs: Runs
    evidence: tuple[ConditionEvidence, ...]
    score: float
    noise_floor: float | None
    jump: tuple[JumpEntry, ...]
    where: tuple[Cell, ...]
    remarks: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The document of ``compare --json``."""
        levels: dict[str, Any] = {
            "jump": {
                "what": "velocity jump of the impact map against the one measured 20 to 40 ms after the impact, when "
                "the controller has already begun to turn the joints (which are listed, and not in the number), or "
                "against the net-feedback estimate",
                "times_noise": _round(
                    root_mean_square([entry.times_noise for entry in self.jump if entry.signal != JOINTS])
                ),
                "entries": [
                    {
                        "scenario": entry.scenario,
                        "object": entry.object,
                        "case": entry.case,
                        "signal": entry.signal,
                        "index": entry.index,
                        "measured": _round(entry.measured),
                        "predicted": _round(entry.predicted),
                        "error": _round(entry.error),
                        "unit": entry.unit,
                        "times_noise": _round(entry.times_noise),
                    }
                    for entry in self.jump
                ],
            }
        }
        for level, phases in LEVEL_PHASES.items():
            levels[level] = _level(self.evidence, phases)
        return {
            "model": {"name": self.model, "digest": self.digest},
            "conditions": [
                {"name": item.condition.label, "repeats": item.count, "score": _round(root_mean_square(item.mean))}
                for item in self.evidence
            ],
            "score": _round(self.score),
            "score_is": SCORE_IS,
            "noise_floor": None if self.noise_floor is None else _round(self.noise_floor),
            "levels": levels,
            "where": [
                {**vars(cell), "error": _round(cell.error), "times_noise": _round(cell.times_noise)}
                for cell in self.where
            ],
            "skipped": [{"name": _relative(path, self.runs), "reason": reason} for path, reason in self.runs.skipped],
            "remarks": list(self.remarks),
        }


def _relative(path: str, runs: Runs) -> str:
    prefix = f"{runs.directory}/"
    return path.removeprefix(prefix)


def _round(value: float) -> float:
    """Nine digits: more than anyone can measure."""
    return float(f"{value:.9g}")


def compare(runs: Runs, model: Model, map_tasks: Map, progress: Progress | None = None) -> Comparison:
    """Compare a model with measurements.

    Args:
        runs: Measurements.
        model: What we believe.
        map_tasks: Parallel map.
        progress: Called with (what, done, total).

    Raises:
        InputError: With this model nothing is hit, or the model blows up.
    """
    evidence, remarks = scaled_evidence(runs, residuals(runs, model, RolloutStore(map_tasks, progress)))
    # The map knows no trial's own start: repetition is what the measured numbers themselves scatter, for every model.
    measured, _ = scaled_evidence(runs, [trial.features for trial in runs.trials])
    jump, more = jump_entries(runs.trials, measured, model)
    return Comparison(
        model=model.name,
        digest=model.digest,
        runs=runs,
        evidence=tuple(evidence),
        score=score_of(evidence),
        noise_floor=noise_floor_of(evidence),
        jump=tuple(jump),
        where=tuple(_where(evidence)),
        remarks=tuple(remarks + more),
    )


def scaled_evidence(runs: Runs, residuals: list[Array]) -> tuple[list[ConditionEvidence], list[str]]:
    """Residuals in multiples of what repetition explains; where nothing was repeated, of what nobody cares about.

    Returns:
        Evidence by condition in order of appearance, and remarks.
    """
    try:
        evidence = {item.condition: item for item in gather(runs, residuals)}
    except InputError:
        evidence = {}
    remarks = []
    result = []
    alone = []
    for condition in runs.conditions:
        if condition in evidence:
            result.append(evidence[condition])
            continue
        rows = np.array([r for trial, r in zip(runs.trials, residuals, strict=True) if trial.condition == condition])
        sigma = np.array([feature.floor for feature in condition.features]) / 2.0
        result.append(ConditionEvidence(condition, rows / sigma, sigma, np.zeros(sigma.size)))
        alone.append(condition.label)
    if alone:
        remarks.append(
            f"not repeated, so differences are in multiples of a fixed small size and not of pure error: "
            f"{', '.join(alone)}; two trials of one condition are enough to compare with repetition"
        )
    return result, remarks


def score_of(evidence: list[ConditionEvidence]) -> float:
    """Root mean square scaled difference [-]; see ``SCORE_IS``."""
    return math.sqrt(float(np.mean([np.mean(np.square(item.mean)) for item in evidence])))


def noise_floor_of(evidence: list[ConditionEvidence]) -> float | None:
    """What :func:`score_of` would be if only repetition were left [-]; None if nothing was repeated."""
    known = [np.mean(np.square(item.pure)) / item.count for item in evidence if np.any(item.pure > 0.0)]
    return math.sqrt(float(np.mean(known))) if known else None


def _level(evidence: tuple[ConditionEvidence, ...], phases: tuple[str, ...]) -> dict[str, Any]:
    """Root mean square differences of the signals of some phases, over all conditions."""
    errors: dict[tuple[str, str, str], list[float]] = {}
    scaled: dict[tuple[str, str, str], list[float]] = {}
    noise: dict[tuple[str, str, str], list[float]] = {}
    for item in evidence:
        columns = zip(item.condition.features, item.mean, item.sigma, item.pure, strict=True)
        for feature, mean, sigma, pure in columns:
            if feature.phase in phases:
                key = (feature.phase, feature.signal, feature.unit)
                errors.setdefault(key, []).append(float(mean * sigma))
                scaled.setdefault(key, []).append(float(mean))
                noise.setdefault(key, []).append(float(pure * sigma) / math.sqrt(item.count))
    every = [value for values in scaled.values() for value in values]
    return {
        "what": (
            "torque balances and deflection in windows without contact"
            if phases == ("free",)
            else "the twin in closed loop: velocity, contact force, feedback and object motion"
        ),
        "times_noise": _round(root_mean_square(every)),
        "signals": [
            {
                "phase": phase,
                "signal": signal,
                "error": _round(root_mean_square(errors[phase, signal, unit])),
                "noise_floor": _round(root_mean_square(noise[phase, signal, unit])),
                "unit": unit,
                "times_noise": _round(root_mean_square(scaled[phase, signal, unit])),
            }
            for phase, signal, unit in errors
        ],
    }


def _where(evidence: list[ConditionEvidence]) -> list[Cell]:
    """Every object x case x phase x signal x index, largest first."""
    cells: dict[tuple[str, str, str, str, str, str], list[tuple[float, float, str]]] = {}
    for item in evidence:
        condition = item.condition
        for feature, value, sigma in zip(condition.features, item.mean, item.sigma, strict=True):
            place = (condition.scenario, condition.object, condition.case)
            key = (*place, feature.phase, feature.signal, feature.index)
            cells.setdefault(key, []).append((float(value), float(value * sigma), feature.unit))
    found = []
    for key, values in cells.items():
        _, error, unit = max(values, key=lambda entry: abs(entry[0]))
        size = root_mean_square([value for value, _, _ in values])
        found.append(Cell(*key, error=error, unit=unit, times_noise=size))
    return sorted(found, key=lambda cell: (-cell.times_noise, *list(vars(cell).values())[:6]))
