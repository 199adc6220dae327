# SPDX-License-Identifier: Apache-2.0
"""Page of a diagnosis: missing effects, their certainty, and the remaining residuals."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from impact_rs_analysis.diagnosis.compare import ComparisonDocument
from impact_rs_analysis.diagnosis.document import (
    DependenceDocument,
    DiagnosisDocument,
    EffectDocument,
    EstimateDocument,
)
from impact_rs_analysis.diagnosis.history import VersionError
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdicts.words import not_excluded, remaining, shown_unnamed
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_analysis.measure.arms import arm_titles
from impact_rs_analysis.report.comparison import ResidualsPart, TracksPart, residuals_part, tracks_part
from impact_rs_analysis.report.error_history import HistoryPart, history_part
from impact_rs_analysis.report.labels import Tag, signal_text, tag_of
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.page_names import DIAGNOSIS_DATA, DIAGNOSIS_PAGE
from impact_rs_analysis.report.plots import effects_plot, joints_plot


@dataclass(frozen=True)
class RelevanceLimit:
    """Relevance limit of a signal: the smallest difference that matters in practice.

    Attributes:
        label: Phase and signal.
        value: The limit, in the unit.
        discrepancy: Difference between equally valid simulations, in the unit.
        unit: Unit.
    """

    label: str
    value: float
    discrepancy: float
    unit: str


@dataclass(frozen=True)
class JointRow:
    """Verdict on one joint.

    Attributes:
        name: Parameter.
        estimate: Estimate and verdict.
        tag: Colour of the verdict.
    """

    name: str
    estimate: EstimateDocument
    tag: Tag


@dataclass(frozen=True)
class EffectRow:
    """One effect of the table.

    Attributes:
        effect: Its document.
        tag: Colour of the verdict.
        estimates: Estimates without a verdict of their own; empty if not determined.
        joints: Estimates with a verdict, joint by joint.
    """

    effect: EffectDocument
    tag: Tag
    estimates: dict[str, EstimateDocument]
    joints: tuple[JointRow, ...]


@dataclass(frozen=True)
class DependenceRow:
    """One effect by one covariate.

    Attributes:
        dependence: Its document.
        tag: Colour of the verdict.
        estimates: Estimates with their labels.
    """

    dependence: DependenceDocument
    tag: Tag
    estimates: tuple[tuple[str, EstimateDocument], ...]


@dataclass(frozen=True)
class DiagnosisPage:
    """Content of ``diagnosis.html.j2``.

    Attributes:
        title: Heading.
        on_scale: Whether errors are multiples of repeatability.
        document: The diagnosis.
        comparison: The model against the same measurements.
        arms: Titles of the arms, by name.
        limits: Relevance limit of every signal.
        ranges: Estimates with a range, by effect and parameter.
        effects: Measurable effects, best first.
        effects_plot: Their errors; None without effects.
        unmeasured: Effects without influence on the measured signals.
        not_excluded: Effects that could be there at a noticeable size, in words; empty: none.
        shown_unnamed: Effects that are not named though their interval excludes zero effect, in words; empty: none.
        dependences: Effects by covariate.
        joints_plot: Errors joint by joint; None if not known.
        remaining: Share of the error beyond noise that the effects leave, in words; empty: not known.
        residuals_are_noise: Whether the remaining residuals are consistent with noise.
        residuals: Residuals of the model without new effects.
        tracks: Measured against predicted over time.
        history: Errors of the model and its parents; None without a parent.
    """

    title: str
    on_scale: bool
    document: DiagnosisDocument
    comparison: ComparisonDocument
    arms: dict[str, str]
    limits: tuple[RelevanceLimit, ...]
    ranges: tuple[tuple[str, EstimateDocument], ...]
    effects: tuple[EffectRow, ...]
    effects_plot: Plot | None
    unmeasured: tuple[str, ...]
    not_excluded: str
    shown_unnamed: str
    dependences: tuple[DependenceRow, ...]
    joints_plot: Plot | None
    remaining: str
    residuals_are_noise: bool
    residuals: ResidualsPart
    tracks: TracksPart
    history: HistoryPart | None


def write_diagnosis(
    document: DiagnosisDocument,
    comparison: ComparisonDocument,
    tracks: Sequence[Track],
    versions: Sequence[VersionError] | None,
    directory: Path,
) -> Path:
    """Write ``diagnosis.html`` and ``diagnosis.json``.

    Args:
        document: The diagnosis.
        comparison: The diagnosed model against the same measurements.
        tracks: Measured and predicted signals over time.
        versions: Errors of the model and its parents; None without a parent.
        directory: Folder of the report.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    after = document.lack_of_fit.after
    bars = effects_plot(document)
    page = DiagnosisPage(
        title=_title(document),
        on_scale=document.error_unit == TIMES,
        document=document,
        comparison=comparison,
        arms={arm.name: arm_titles(comparison.arms, arm.name) for arm in comparison.arms},
        limits=_relevance_limits(comparison),
        ranges=tuple(
            (f"{effect.name}: {name}", estimate)
            for effect in document.effects
            for name, estimate in effect.parameters.items()
            if estimate.range is not None
        ),
        effects=tuple(_effect_row(effect) for effect in document.effects if effect.measured),
        effects_plot=None if bars is None else Plot("effects", bars),
        unmeasured=tuple(effect.name for effect in document.effects if not effect.measured),
        not_excluded=not_excluded(document),
        shown_unnamed=shown_unnamed(document),
        dependences=tuple(map(_dependence_row, document.dependences)),
        joints_plot=Plot("joints", joints_plot(document.joints)) if document.joints else None,
        remaining=remaining(document),
        residuals_are_noise=after is not None and after > SIGNIFICANCE_LEVEL,
        residuals=residuals_part(comparison),
        tracks=tracks_part(comparison, tracks),
        history=history_part(versions) if versions else None,
    )
    data = json.dumps(document.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"
    text = render("diagnosis.html.j2", page, replay=page.tracks.replay is not None)
    return write_files(directory, {DIAGNOSIS_PAGE: text, DIAGNOSIS_DATA: data})[0]


def _title(document: DiagnosisDocument) -> str:
    """Title of the page, which distinguishes sensor faults from missing physics."""
    if document.measurement and not document.missing:
        return "What is wrong with the readings"
    return f"What model '{document.model.name}' lacks"


def _relevance_limits(comparison: ComparisonDocument) -> tuple[RelevanceLimit, ...]:
    """Relevance limits of the signals that have one."""
    return tuple(
        RelevanceLimit(signal_text(row), row.floor, row.discrepancy, row.unit)
        for level in comparison.levels.values()
        for row in level.signals
        if row.floor > 0.0
    )


def _dependence_row(dependence: DependenceDocument) -> DependenceRow:
    estimates = [
        (f"{name} in {level}", estimate)
        for level, estimates_by_name in dependence.levels.items()
        for name, estimate in estimates_by_name.items()
    ]
    estimates += [
        (f"{name} at {knot}", estimate)
        for knot, estimates_by_name in dependence.curve.items()
        for name, estimate in estimates_by_name.items()
    ]
    estimates += [(f"{name} at the mean", estimate) for name, estimate in dependence.at_mean.items()]
    estimates += [(f"change of {name}", estimate) for name, estimate in dependence.per_unit.items()]
    return DependenceRow(dependence, tag_of(dependence.verdict), tuple(estimates))


def _effect_row(effect: EffectDocument) -> EffectRow:
    tag = tag_of(effect.verdict)
    parameters = effect.parameters if tag is not Tag.NO else {}
    return EffectRow(
        effect=effect,
        tag=tag,
        estimates={name: estimate for name, estimate in parameters.items() if estimate.verdict is None},
        joints=tuple(
            JointRow(name, estimate, tag_of(estimate.verdict))
            for name, estimate in parameters.items()
            if estimate.verdict is not None
        ),
    )
