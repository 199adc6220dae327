# SPDX-License-Identifier: Apache-2.0
"""Where a model fails: measurement against model, and one number per model.

Trials are compared on three levels:

* **jump**: the impact map with the model's physics against the measured velocity jump,
* **free motion**: torque balances and deflections in windows without contact,
* **trial**: the replay from before the impact through the push;

recordings on one level, the torque balance of free motion; tables of impacts on one level, the velocities just after
the impact. Every difference is given in its unit and in multiples of repeatability, so that torques and velocities can
be ranked together. The score of trials is the one that the diagnosis minimises: the size of the mean residuals over
repeatability (:func:`impact_rs_analysis.evidence.cluster.size_of`) [-]. The score of recordings is the root mean square
of the torque residual [N m], that of impacts without repeats the root mean square of the velocity residual
(:mod:`impact_rs_analysis.evidence.impact_tables`) [m/s].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Literal

import numpy as np
from pydantic import Field

from impact_rs_analysis.diagnosis.document import DiscrepancyDocument, ModelIdentity, RecordingDocument
from impact_rs_analysis.diagnosis.jump import JOINTS, JumpEntry, jump_entries
from impact_rs_analysis.evidence.cluster import TIMES, Cluster, ErrorUnit, Source, size_of
from impact_rs_analysis.evidence.impact_tables import ImpactTableSource
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_analysis.evidence.replays import ReplaySource, clusters_of
from impact_rs_analysis.evidence.torque_balance import ARM
from impact_rs_analysis.measure.arms import ArmDocument, arms_of
from impact_rs_sim.robot import Array
from impact_rs_sim.schema import Schema

LEVEL_PHASES = {"free_motion": ("free",), "trial": ("impact", "push")}
LEVEL_TEXT = {
    "jump": "velocity jump of the impact map against the jump measured 20 to 40 ms after the impact, or against the "
    "net-feedback estimate. Joint velocities are listed but not counted: by then the controller has begun to move the "
    "joints",
    "free_motion": "torque balances and deflection in windows without contact",
    "trial": "the replay from before the impact through the push: velocity, contact force and object motion",
    "recording": "torque balance of the arm in free motion, both sides low-passed",
    "impacts": "velocities just after every impact, measured and predicted by the impact map from the state before",
}


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


class SignalLevel(Schema):
    """Residual of one signal."""

    phase: str = Field(description="phase of the motion")
    signal: str = Field(description="what it is")
    index: str = Field("", description="joint, where joints are listed one by one")
    arm: str = Field("", description="arm, where there are several")
    error: float = Field(description="root mean square difference, in the unit")
    mean: float | None = Field(None, description="mean difference, in the unit")
    noise_floor: float = Field(description="repeatability, or noise, in the unit")
    discrepancy: float = Field(0.0, description="difference between equally valid simulations, in the unit")
    floor: float = Field(0.0, description="relevance limit: smallest difference that matters, in the unit")
    unit: str = Field(description="unit")
    times_noise: float = Field(description="the difference in multiples of repeatability")


class JumpLevel(Schema):
    """One predicted and measured jump."""

    scenario: str = Field(description="scenario")
    object: str = Field(description="object")
    case: str = Field(description="case")
    signal: str = Field(description="what it is")
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


class LeftOut(Schema):
    """A bag that was left out."""

    name: str = Field(description="path below the folder")
    reason: str = Field(description="why")


class ComparisonDocument(Schema):
    """``compare --json``."""

    source: Literal["trials", "recordings", "impacts"] = Field(description="what was compared")
    model: ModelIdentity = Field(description="compared model")
    trials: int = Field(description="trials, or recordings")
    conditions: tuple[ConditionScore, ...] = Field(description="by condition or recording")
    score: float = Field(description="score of the model")
    score_is: str = Field(description="definition of the score")
    score_unit: ErrorUnit = Field(description="its unit")
    noise_floor: float | None = Field(description="score if only noise is left; null: nothing was repeated")
    levels: dict[str, Level] = Field(description="jump, free_motion and trial; recording; or impacts")
    where: tuple[Cell, ...] = Field(description="residuals by place, largest first")
    arms: tuple[ArmDocument, ...] = Field((), description="arms of the measurements; empty: a free body")
    joints: tuple[SignalLevel, ...] = Field((), description="signals of trials by arm and joint")
    not_measured: tuple[str, ...] = Field((), description="quantities that were not measured")
    skipped: tuple[LeftOut, ...] = Field((), description="bags that were left out")
    recording: RecordingDocument | None = Field(None, description="how recordings were read")
    discrepancy: DiscrepancyDocument = Field(
        default_factory=DiscrepancyDocument, description="model discrepancy of the simulation"
    )
    remarks: tuple[str, ...] = Field((), description="remarks for the reader")


def compare(source: Source) -> ComparisonDocument:
    """Compare a model with measurements.

    Args:
        source: Measurements with the model's predictions.
    """
    if isinstance(source, RecordingSource):
        return _of_recordings(source)
    if isinstance(source, ImpactTableSource):
        return _of_impacts(source)
    assert isinstance(source, ReplaySource)
    return _of_runs(source)


def kind_of(source: Source) -> Literal["trials", "recordings", "impacts"]:
    """Kind of measurement, as in documents."""
    if isinstance(source, ImpactTableSource):
        return "impacts"
    return "recordings" if isinstance(source, RecordingSource) else "trials"


def score_of(clusters: Sequence[Cluster]) -> float:
    """Size of mean residuals in multiples of repeatability [-]."""
    return size_of([item.error for item in clusters], [item.expected for item in clusters])


def _of_runs(source: ReplaySource) -> ComparisonDocument:
    clusters, runs = source.clusters, source.runs
    # The map does not start from each run's own state, so repeatability is the scatter of the measured numbers.
    measured, _ = clusters_of(runs, [run.measured for run in runs.runs], source.discrepancy)
    entries, remarks = jump_entries(runs, measured, source.model)
    repeated = source.noise_size() is not None
    score_is = (
        "size of the difference between measurement and replay over all features and conditions, in multiples of "
        "repeatability"
        if repeated
        else "size of the difference between measurement and replay over all features and conditions, in multiples of "
        "the relevance limit"
    )
    levels = {"jump": _jump(entries)}
    levels |= {name: _level(name, clusters, phases) for name, phases in LEVEL_PHASES.items()}
    return ComparisonDocument(
        source="trials",
        model=ModelIdentity(name=source.model.name, digest=source.model.digest),
        trials=len(runs.runs),
        conditions=tuple(
            ConditionScore(name=item.name, repeats=item.count, score=rounded(score_of([item]))) for item in clusters
        ),
        score=rounded(source.size()),
        score_is=score_is,
        score_unit=TIMES if repeated else "-",
        noise_floor=source.noise_size(),
        levels=levels,
        where=tuple(_where(clusters)),
        arms=arms_of(source.worlds),
        joints=tuple(_signal_levels(clusters, by_joint=True)[0]),
        skipped=tuple(LeftOut(name=path.removeprefix(f"{runs.directory}/"), reason=why) for path, why in runs.skipped),
        discrepancy=discrepancy_of(source),
        remarks=(*source.remarks, *remarks),
    )


def discrepancy_of(source: Source) -> DiscrepancyDocument:
    """Model discrepancy that the comparison allows for."""
    if not isinstance(source, ReplaySource):
        return DiscrepancyDocument()
    return DiscrepancyDocument(used=bool(source.discrepancy.entries), provenance=source.discrepancy.in_words)


def _jump(entries: Sequence[JumpEntry]) -> Level:
    return Level(
        what=LEVEL_TEXT["jump"],
        times_noise=rounded(root_mean_square([entry.times_noise for entry in entries if entry.signal != JOINTS])),
        entries=tuple(
            JumpLevel(
                scenario=entry.scenario,
                object=entry.object,
                case=entry.case,
                signal=entry.signal,
                index=entry.index,
                measured=rounded(entry.measured),
                predicted=rounded(entry.predicted),
                error=rounded(entry.error),
                unit=entry.unit,
                times_noise=rounded(entry.times_noise),
            )
            for entry in entries
        ),
    )


def _level(name: str, clusters: Sequence[Cluster], phases: tuple[str, ...]) -> Level:
    """Root mean square differences of the signals of some phases, over all conditions, arm by arm."""
    signals, every = _signal_levels(clusters, phases)
    return Level(what=LEVEL_TEXT[name], times_noise=rounded(root_mean_square(every)), signals=tuple(signals))


def _signal_levels(
    clusters: Sequence[Cluster], phases: tuple[str, ...] = (), by_joint: bool = False
) -> tuple[list[SignalLevel], list[float]]:
    """Root mean square differences of signals over all conditions, and every difference over its noise.

    Args:
        clusters: The conditions.
        phases: Phases of the signals; none: all.
        by_joint: Whether to list joint by joint; signals of no joint are then left out.
    """
    several = len({feature.arm for item in clusters for feature in item.features if feature.arm}) > 1
    found: dict[tuple[str, str, str, str, str], list[tuple[float, float, float, float, float]]] = {}
    for item in clusters:
        for feature, mean, sigma, pure, own in zip(
            item.features, item.mean, item.sigma, item.pure, item.discrepancy, strict=True
        ):
            joint = feature.index.rsplit(".", 1)[-1]
            if feature.phase in (phases or (feature.phase,)) and (joint.startswith("joint") or not by_joint):
                noise = float(np.sqrt(pure**2 / item.count + own**2))
                arm, joint = feature.arm if several else "", joint if by_joint else ""
                key = (arm, feature.phase, feature.signal, joint, feature.unit)
                noise_of_mean = float(pure * sigma) / item.count**0.5
                row = (float(mean * sigma), noise_of_mean, float(own * sigma), feature.relevance_limit)
                found.setdefault(key, []).append((*row, float(mean) / max(noise, 1e-12) if noise else float(mean)))
    signals = []
    for (arm, phase, signal, joint, unit), rows in found.items():
        error, noise, own, limit, scaled = (root_mean_square(column) for column in zip(*rows, strict=True))
        signals.append(
            SignalLevel(
                phase=phase,
                signal=signal,
                index=joint,
                arm=arm,
                error=rounded(error),
                noise_floor=rounded(noise),
                discrepancy=rounded(own),
                floor=rounded(limit),
                unit=unit,
                times_noise=rounded(scaled),
            )
        )
    return signals, [row[-1] for rows in found.values() for row in rows]


def _where(clusters: Sequence[Cluster]) -> list[Cell]:
    """Residuals by object, case, phase, signal and index, largest first."""
    total = sum(float(np.sum(np.square(item.mean))) for item in clusters)
    found: dict[tuple[str, ...], list[tuple[float, float, float, str, float]]] = {}
    for item in clusters:
        noise = np.sqrt(np.square(item.pure) / item.count + np.square(item.discrepancy))
        noise = np.where(noise > 0.0, noise, 1.0)
        for feature, mean, sigma, own in zip(item.features, item.mean, item.sigma, noise, strict=True):
            row = (float(mean / own), float(mean * sigma), float(mean), feature.unit, feature.relevance_limit)
            found.setdefault((*item.place, *feature.group), []).append(row)
    cells = []
    for (scenario, object_name, case, phase, signal, index), rows in found.items():
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
            )
        )
    return sorted(
        cells, key=lambda cell: (-cell.times_noise, cell.scenario, cell.object, cell.case, cell.signal, cell.index)
    )


def _of_recordings(source: RecordingSource) -> ComparisonDocument:
    rest, noise = source.rest, np.maximum(source.balance.noise, 1e-12)
    labels = np.array([[feature.phase for feature in item.features] for item in source.clusters], dtype=object)
    phases = np.concatenate([np.array(row, dtype=object).reshape(-1, rest.shape[1]) for row in labels])
    total = float(np.sum(np.square(rest)))
    files = ", ".join(str(recording.path.name) for recording in source.recordings)
    cells, signals = [], []
    for joint, units in enumerate(source.physics.arms[ARM].facts.units):
        own = rest[:, joint]
        signals.append(
            SignalLevel(
                phase="free",
                signal="torque",
                index=f"joint{joint + 1}",
                error=rounded(root_mean_square(own)),
                mean=rounded(float(own.mean())),
                noise_floor=rounded(float(noise[joint])),
                unit=units.effort,
                times_noise=rounded(root_mean_square(own) / float(noise[joint])),
            )
        )
        for phase in dict.fromkeys(phases[:, joint]):
            part = own[phases[:, joint] == phase]
            if part.size < LEAST_SAMPLES:
                continue
            cells.append(
                Cell(
                    scenario=files,
                    object="",
                    case="",
                    phase=phase,
                    signal="torque",
                    index=f"joint{joint + 1}",
                    error=rounded(float(part.mean())),
                    unit=units.effort,
                    floor=0.0,
                    share=rounded(float(np.sum(np.square(part))) / max(total, 1e-300)),
                    times_noise=rounded(root_mean_square(part) / float(noise[joint])),
                )
            )
    by_file = {
        str(recording.path): [item for item in source.clusters if item.unit == str(recording.path)]
        for recording in source.recordings
    }
    return ComparisonDocument(
        source="recordings",
        model=ModelIdentity(name=source.model.name, digest=source.model.digest),
        trials=len(source.recordings),
        conditions=tuple(
            ConditionScore(
                name=name,
                repeats=len(items),
                score=rounded(root_mean_square(np.concatenate([item.mean * item.sigma for item in items]))),
            )
            for name, items in by_file.items()
        ),
        score=rounded(root_mean_square(rest)),
        score_is="root mean square of recorded minus predicted joint torque over all joints and samples",
        score_unit=source.residual_unit,
        arms=arms_of(source.worlds),
        noise_floor=rounded(root_mean_square(noise)),
        levels={
            "recording": Level(
                what=LEVEL_TEXT["recording"],
                times_noise=rounded(root_mean_square(np.sqrt(np.mean(np.square(rest), axis=0)) / noise)),
                signals=tuple(signals),
            )
        },
        where=tuple(sorted(cells, key=lambda cell: -cell.share)),
        not_measured=("velocity jump", "contact and impulses", "object", "controller and its references"),
        recording=RecordingDocument(**asdict(source.facts)),
        remarks=source.reading,
    )


def _of_impacts(source: ImpactTableSource) -> ComparisonDocument:
    clusters = source.clusters
    score, noise = source.size(), source.noise_size()
    if source.repeated:
        score_is = "size of the difference between measured and predicted velocities over all conditions, in multiples "
        score_is += "of repeatability"
        conditions = [ConditionScore(name=c.name, repeats=c.count, score=rounded(score_of([c]))) for c in clusters]
    else:
        score_is = "root mean square over the impacts of measured minus predicted velocity; angular and joint "
        score_is += "velocities are weighted by their kinetic energy"
        conditions = [ConditionScore(name=source.table.path.name, repeats=len(clusters), score=rounded(score))]
    phases = tuple(dict.fromkeys(feature.phase for item in clusters for feature in item.features))
    return ComparisonDocument(
        source="impacts",
        model=ModelIdentity(name=source.model.name, digest=source.model.digest),
        trials=source.identity.count,
        conditions=tuple(conditions),
        score=rounded(score),
        score_is=score_is,
        score_unit=source.size_unit,
        noise_floor=None if noise is None else rounded(noise),
        levels={"impacts": _level("impacts", clusters, phases)},
        where=tuple(_where(clusters) if source.repeated else _where_of_blocks(clusters)),
        arms=arms_of(source.worlds),
        not_measured=("motion before and after", "torques", "forces"),
        remarks=tuple(source.remarks),
    )


def _where_of_blocks(clusters: Sequence[Cluster]) -> list[Cell]:
    """Every object x kind of contact x signal x index over all rows, largest share first.

    Errors are root mean squares with the sign of the mean.
    """
    total = sum(float(np.sum(np.square(item.mean))) for item in clusters)
    found: dict[tuple[str, str, str, str, str], list[tuple[float, float, float]]] = {}
    facts: dict[tuple[str, str, str], tuple[str, float]] = {}
    for item in clusters:
        for feature, mean, sigma, pure in zip(item.features, item.mean, item.sigma, item.pure, strict=True):
            row = (float(mean * sigma), float(mean), float(mean / pure if pure else mean))
            found.setdefault((*item.place[:2], *feature.group), []).append(row)
            facts[feature.group] = feature.unit, feature.relevance_limit
    cells = []
    for (file, object_name, *group), rows in found.items():
        phase, signal, index = group
        error, scaled, times = np.array(rows).T
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
            )
        )
    return sorted(cells, key=lambda cell: -cell.share)


LEAST_SAMPLES = 5  # of a phase of one joint; fewer are not reported


def root_mean_square(values: Sequence[float] | Array) -> float:
    """Root mean square; 0 if empty."""
    array = np.asarray(values, dtype=float)
    return float(np.sqrt(np.mean(np.square(array)))) if array.size else 0.0


def rounded(value: float) -> float:
    """Rounded to nine digits, more than any sensor resolves."""
    return float(f"{value:.9g}")
