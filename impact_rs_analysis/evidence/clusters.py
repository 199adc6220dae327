"""Residuals on a common scale: how large they are against what repetition explains.

Within a condition only repetition varies, so the spread of repeats is the pure error. Each feature is divided by

    sigma_f^2 = s_f^2 + (floor_f / 2)^2

with s_f the pure error pooled over conditions and a floor below which nobody cares. Repeats of a condition share one
sensitivity; what they average to is what a model has to explain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_rs_analysis.evidence.runs import Condition, Runs
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array


@dataclass(frozen=True)
class ConditionEvidence:
    """Scaled residuals of one condition.

    Attributes:
        condition: Which.
        residuals: One row per repeat, ``(n, F)`` [-].
        sigma: Scale of each feature in its own unit, ``(F,)``.
        pure: Pure error of each feature over its scale, ``(F,)`` [-].
    """

    condition: Condition
    residuals: Array
    sigma: Array
    pure: Array

    @property
    def count(self) -> int:
        """Number of repeats."""
        return int(self.residuals.shape[0])

    @property
    def mean(self) -> Array:
        """Mean over the repeats, ``(F,)`` [-]."""
        return np.asarray(self.residuals.mean(axis=0))

    @property
    def deviations(self) -> Array:
        """Repeats about their mean, scaled to the variance of a single trial, ``(n, F)`` [-]."""
        if self.count < 2:
            return np.zeros_like(self.residuals)
        return np.asarray((self.residuals - self.mean) * np.sqrt(self.count / (self.count - 1.0)))


def gather(runs: Runs, residuals: list[Array]) -> list[ConditionEvidence]:
    """Scale the residuals of all trials.

    Args:
        runs: The trials.
        residuals: Measured minus predicted features per trial.

    Raises:
        InputError: No condition was repeated, so there is no pure error to compare with.
    """
    grouped: dict[Condition, list[Array]] = {}
    for trial, residual in zip(runs.trials, residuals, strict=True):
        grouped.setdefault(trial.condition, []).append(residual)
    rows = {condition: np.array(values) for condition, values in grouped.items()}
    pure: dict[int, Array] = {}
    for length in {values.shape[1] for values in rows.values()}:
        same = [values for values in rows.values() if values.shape[1] == length]
        freedom = sum(values.shape[0] - 1 for values in same)
        if freedom < 1:
            continue
        squares = sum(((values - values.mean(axis=0)) ** 2).sum(axis=0) for values in same)
        pure[length] = np.sqrt(squares / freedom)
    if not pure:
        raise InputError("no condition was repeated: without repeats there is no pure error to compare with")
    evidence = []
    for condition, values in rows.items():
        if values.shape[1] not in pure:
            continue
        spread = pure[values.shape[1]]
        floor = np.array([feature.floor for feature in condition.features])
        sigma = np.sqrt(spread**2 + (floor / 2.0) ** 2)
        evidence.append(ConditionEvidence(condition, values / sigma, sigma, spread / sigma))
    return evidence


def rescale(runs: Runs, residuals: list[Array], like: list[ConditionEvidence]) -> list[ConditionEvidence]:
    """Residuals of another model on the scale of earlier ones, so that errors can be held against each other.

    Args:
        runs: The trials.
        residuals: Measured minus predicted features per trial.
        like: Evidence of the earlier model.
    """
    grouped: dict[Condition, list[Array]] = {item.condition: [] for item in like}
    for trial, residual in zip(runs.trials, residuals, strict=True):
        if trial.condition in grouped:
            grouped[trial.condition].append(residual)
    return [replace(item, residuals=np.array(grouped[item.condition]) / item.sigma) for item in like]
