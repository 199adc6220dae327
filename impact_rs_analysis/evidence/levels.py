# SPDX-License-Identifier: Apache-2.0
"""Levels of a comparison: residuals by signal and by condition, in their unit and in multiples of repeatability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from impact_rs_analysis.evidence.cluster import Cluster, size_of
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.schema import Schema


class Cell(Schema):
    """One residual by scenario, object, case, phase, signal and axis."""

    scenario: str = Field(description="scenario, or file of a recording")
    object: str = Field(description="object; empty of a recording")
    case: str = Field(description="case; empty of a recording")
    phase: str = Field(description="free, impact or push; for a recording moving up, moving down or slow")
    signal: str = Field(description="what was compared")
    index: str = Field(description="joint or axis")
    error: float = Field(
        description="measured minus model where it is largest; of a recording the mean, of impacts "
        "without repeats the root mean square with the sign of the mean; in the unit"
    )
    unit: str = Field(description="unit")
    floor: float = Field(description="relevance limit: smallest difference that matters, in the unit")
    share: float = Field(description="share of the sum of all squares")
    times_noise: float = Field(description="root mean square in multiples of repeatability")
    times_relevant: float | None = Field(
        None,
        description="root mean square in multiples of the larger of repeatability and relevance limit; null: a file of "
        "an earlier version",
    )

    @property
    def size(self) -> float:
        """Root mean square in multiples of the larger of repeatability and relevance limit [-]."""
        if self.times_relevant is not None:
            return self.times_relevant
        return min(self.times_noise, abs(self.error) / self.floor) if self.floor else self.times_noise

    @property
    def matters(self) -> bool:
        """Whether it is above its relevance limit."""
        return abs(self.error) >= self.floor


class SignalLevel(Schema):
    """Residual of one signal."""

    phase: str = Field(description="phase of the motion")
    signal: str = Field(description="name of the signal")
    index: str = Field("", description="joint, where joints are listed one by one")
    arm: str = Field("", description="arm, where there are several")
    error: float = Field(description="root mean square difference, in the unit")
    mean: float | None = Field(None, description="mean difference, in the unit")
    noise_floor: float = Field(description="repeatability, or noise, in the unit")
    discrepancy: float = Field(0.0, description="difference between equally valid simulations, in the unit")
    floor: float = Field(0.0, description="relevance limit: smallest difference that matters, in the unit")
    unit: str = Field(description="unit")
    times_noise: float = Field(description="the difference in multiples of repeatability")

    @property
    def size(self) -> float:
        """The difference in multiples of the larger of repeatability and relevance limit [-]."""
        return min(self.times_noise, self.error / self.floor) if self.floor else self.times_noise


class JumpLevel(Schema):
    """One predicted and measured jump."""

    scenario: str = Field(description="scenario")
    object: str = Field(description="object")
    case: str = Field(description="case")
    signal: str = Field(description="name of the signal")
    index: str = Field(description="joint or axis")
    measured: float = Field(description="mean over the repeats, in the unit")
    predicted: float = Field(description="by the impact map, in the unit")
    error: float = Field(description="measured minus predicted, in the unit")
    unit: str = Field(description="unit")
    times_noise: float = Field(description="the difference in multiples of repeatability")


class Level(Schema):
    """One level of the comparison."""

    what: str = Field(description="what is compared")
    times_noise: float = Field(description="root mean square difference in multiples of repeatability")
    signals: tuple[SignalLevel, ...] = Field((), description="by signal")
    entries: tuple[JumpLevel, ...] = Field((), description="by jump")


class ConditionScore(Schema):
    """Score of one condition or recording."""

    name: str = Field(description="condition, or file")
    repeats: int = Field(description="number of trials, or of stretches of time")
    score: float = Field(description="its score, in score_unit")


class RecordingDocument(Schema):
    """How recordings were read and filtered."""

    files: tuple[str, ...] = Field(description="paths")
    robot: str = Field(description="robot facts that were used")
    end_effector_mass_kg: float = Field(description="mounted mass by the mapping [kg]")
    samples: int = Field(description="samples read")
    recorded_s: float = Field(description="their duration [s]")
    used_s: float = Field(description="duration without the edges of the low-pass [s]")
    sampled_Hz: float = Field(description="sampling rate [Hz]")
    low_pass_Hz: float = Field(description="cut-off of the zero-phase low-pass [Hz]")
    signals: tuple[str, ...] = Field((), description="signals that were found")
    torque: str = Field("", description="what the torque is: where measured, what was added, or the law of servos")
    minus: tuple[str, ...] = Field((), description="paths of recordings of the same motions that were subtracted")


@dataclass(frozen=True)
class Comparison:
    """Residuals of a model, as in the report of a source.

    Attributes:
        levels: By name.
        where: Residuals by condition, signal and index, largest first.
        conditions: Score of every condition or recording.
        joints: Signals by arm and joint.
    """

    levels: dict[str, Level]
    where: tuple[Cell, ...]
    conditions: tuple[ConditionScore, ...]
    joints: tuple[SignalLevel, ...] = ()


def score_of(clusters: Sequence[Cluster]) -> float:
    """Size of mean residuals in multiples of repeatability [-]."""
    return size_of([item.error for item in clusters], [item.expected for item in clusters])


def condition_scores(clusters: Sequence[Cluster]) -> tuple[ConditionScore, ...]:
    """Score of every condition."""
    return tuple(ConditionScore(name=c.name, repeats=c.count, score=rounded(score_of([c]))) for c in clusters)


def expected_of(item: Cluster, by_limit: bool = False) -> Array:
    """Unit of the differences of a cluster, over the scale of each feature, ``(F,)`` [-].

    Repeatability, or stated noise, with the model discrepancy. With neither repeats nor stated noise it is 1: the scale
    of the feature.

    Args:
        item: The cluster.
        by_limit: Whether the unit is the relevance limit, because nothing was repeated.
    """
    repeatability = np.sqrt(item.expected_squares) if np.any(item.pure_error > 0.0) else np.zeros_like(item.sigma)
    limits = np.array([feature.relevance_limit for feature in item.features]) / item.sigma
    noise = np.where(limits > 0.0, limits, repeatability) if by_limit else repeatability
    return np.where(noise > 0.0, noise, 1.0)


def relevant_of(item: Cluster, by_limit: bool = False) -> Array:
    """The larger of :func:`expected_of` and the relevance limit, over the scale of each feature, ``(F,)`` [-].

    A smaller residual is noise or irrelevant. Repeatability alone would exaggerate the residuals of simulated trials,
    which repeat exactly.

    Args:
        item: The cluster.
        by_limit: See :func:`expected_of`.
    """
    limits = np.array([feature.relevance_limit for feature in item.features]) / item.sigma
    return np.maximum(expected_of(item, by_limit), limits)


def level_of(text: str, clusters: Sequence[Cluster], phases: tuple[str, ...], by_limit: bool = False) -> Level:
    """Root mean square differences of the signals of some phases, over all conditions, arm by arm.

    Args:
        text: Compared quantity, in words.
        clusters: The conditions.
        phases: Phases of the signals; empty: all.
        by_limit: Whether differences are multiples of the relevance limit, because nothing was repeated.
    """
    signals, ratios = signal_levels(clusters, phases, by_limit=by_limit)
    return Level(what=text, times_noise=rounded(root_mean_square(ratios)), signals=tuple(signals))


def signal_levels(
    clusters: Sequence[Cluster], phases: tuple[str, ...] = (), by_joint: bool = False, by_limit: bool = False
) -> tuple[list[SignalLevel], list[float]]:
    """Root mean square differences of signals over all conditions, and every difference over its noise.

    Args:
        clusters: The conditions.
        phases: Phases of the signals; empty: all.
        by_joint: Whether to list joint by joint; other signals are then left out.
        by_limit: Whether differences are multiples of the relevance limit, because nothing was repeated.
    """
    several = len({feature.arm for item in clusters for feature in item.features if feature.arm}) > 1
    rows_of_signal: dict[tuple[str, str, str, str, str], list[tuple[float, float, float, float, float]]] = {}
    for item in clusters:
        expected = expected_of(item, by_limit)
        for feature, mean, sigma, pure, systematic, noise in zip(
            item.features, item.mean, item.sigma, item.pure_error, item.discrepancy, expected, strict=True
        ):
            joint = feature.index.rsplit(".", 1)[-1]
            if feature.phase in (phases or (feature.phase,)) and (joint.startswith("joint") or not by_joint):
                arm, joint = feature.arm if several else "", joint if by_joint else ""
                key = (arm, feature.phase, feature.signal, joint, feature.unit)
                noise_of_mean = float(pure * sigma) / item.count**0.5
                row = (float(mean * sigma), noise_of_mean, float(systematic * sigma), feature.relevance_limit)
                rows_of_signal.setdefault(key, []).append((*row, float(mean / noise)))
    signals = []
    for (arm, phase, signal, joint, unit), rows in rows_of_signal.items():
        error, noise, discrepancy, limit, scaled = (root_mean_square(column) for column in zip(*rows, strict=True))
        signals.append(
            SignalLevel(
                phase=phase,
                signal=signal,
                index=joint,
                arm=arm,
                error=rounded(error),
                noise_floor=rounded(noise),
                discrepancy=rounded(discrepancy),
                floor=rounded(limit),
                unit=unit,
                times_noise=rounded(scaled),
            )
        )
    return signals, [row[-1] for rows in rows_of_signal.values() for row in rows]


def where_of(clusters: Sequence[Cluster], by_limit: bool = False) -> list[Cell]:
    """Residuals by object, case, phase, signal and index, largest (:attr:`Cell.size`) first.

    Args:
        clusters: The conditions.
        by_limit: Whether they are multiples of the relevance limit, because nothing was repeated.
    """
    total = sum(float(np.sum(np.square(item.mean))) for item in clusters)
    rows_of_signal: dict[tuple[str, ...], list[tuple[float, float, float, str, float, float]]] = {}
    for item in clusters:
        noise, relevant = expected_of(item, by_limit), relevant_of(item, by_limit)
        for feature, mean, sigma, unit, most in zip(item.features, item.mean, item.sigma, noise, relevant, strict=True):
            limit = feature.relevance_limit
            row = (float(mean / unit), float(mean * sigma), float(mean), feature.unit, limit, float(mean / most))
            rows_of_signal.setdefault((*item.condition_key, *feature.group), []).append(row)
    cells = []
    for (scenario, object_name, case, phase, signal, index), rows in rows_of_signal.items():
        worst = max(rows, key=lambda row: abs(row[0]))
        cells.append(
            Cell(
                scenario=scenario,
                object=object_name,
                case=case,
                phase=phase,
                signal=signal,
                index=index,
                error=rounded(worst[1]),
                unit=worst[3],
                floor=worst[4],
                share=rounded(sum(row[2] ** 2 for row in rows) / max(total, 1e-300)),
                times_noise=rounded(root_mean_square([row[0] for row in rows])),
                times_relevant=rounded(root_mean_square([row[5] for row in rows])),
            )
        )
    return sorted(cells, key=lambda cell: (-cell.size, cell.scenario, cell.object, cell.case, cell.signal, cell.index))


def where_of_blocks(clusters: Sequence[Cluster]) -> list[Cell]:
    """Every object x kind of contact x signal x index over all rows, largest share first.

    Errors are root mean squares with the sign of the mean.
    """
    total = sum(float(np.sum(np.square(item.mean))) for item in clusters)
    rows_of_signal: dict[tuple[str, str, str, str, str], list[tuple[float, float, float, float]]] = {}
    facts: dict[tuple[str, str, str], tuple[str, float]] = {}
    for item in clusters:
        for feature, mean, sigma, noise, most in zip(
            item.features, item.mean, item.sigma, expected_of(item), relevant_of(item), strict=True
        ):
            row = (float(mean * sigma), float(mean), float(mean / noise), float(mean / most))
            rows_of_signal.setdefault((*item.condition_key[:2], *feature.group), []).append(row)
            facts[feature.group] = feature.unit, feature.relevance_limit
    cells = []
    for (file, object_name, *group), rows in rows_of_signal.items():
        phase, signal, index = group
        error, scaled, times, relevant = np.array(rows).T
        unit, limit = facts[phase, signal, index]
        cells.append(
            Cell(
                scenario=file,
                object=object_name,
                case="",
                phase=phase,
                signal=signal,
                index=index,
                error=rounded(math.copysign(root_mean_square(error), float(error.mean()))),
                unit=unit,
                floor=limit,
                share=rounded(float(np.sum(np.square(scaled))) / max(total, 1e-300)),
                times_noise=rounded(root_mean_square(times)),
                times_relevant=rounded(root_mean_square(relevant)),
            )
        )
    return sorted(cells, key=lambda cell: -cell.share)


def root_mean_square(values: Sequence[float] | Array) -> float:
    """Root mean square; 0 if empty."""
    array = np.asarray(values, dtype=float)
    return float(np.sqrt(np.mean(np.square(array)))) if array.size else 0.0


def rounded(value: float) -> float:
    """Value with nine significant digits, more than any sensor resolves."""
    return float(f"{value:.9g}")
