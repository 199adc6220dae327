# SPDX-License-Identifier: Apache-2.0
"""Page of a comparison: where a model fails, for trials, recordings and impact tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from impact_rs_analysis.diagnosis.compare import ComparisonDocument
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.history import VersionError
from impact_rs_analysis.evidence.cluster import SCALE, TIMES
from impact_rs_analysis.evidence.levels import Cell, JumpLevel, SignalLevel
from impact_rs_analysis.evidence.rollouts import RolloutDocument
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_analysis.measure.arms import arm_titles
from impact_rs_analysis.report.agreement_graph import AgreementGraph, agreement_graph
from impact_rs_analysis.report.animation import ReplayPart
from impact_rs_analysis.report.error_history import HistoryPart, history_part
from impact_rs_analysis.report.labels import (
    LEVELS,
    NOISE,
    RELEVANCE_LIMIT,
    REPEATABILITY,
    SPREAD,
    location_text,
    phase_text,
    signal_text,
)
from impact_rs_analysis.report.page import (
    Plot,
    number_text,
    quantity_text,
    render,
    track_data,
    write_files,
)
from impact_rs_analysis.report.page_names import COMPARISON_DATA, COMPARISON_PAGE
from impact_rs_analysis.report.plots import residual_maps, rollouts_plot, scatter_plot, signals_plot, tracks_plot

MIN_NAMED_SCORE = 1.3  # in multiples of noise; below this score no label is named
MAX_LISTED_RESIDUALS = 8  # rows of the table of the largest residuals


@dataclass(frozen=True)
class ResidualRow:
    """One row of a table.

    Attributes:
        label: Its name.
        content: Its numbers.
    """

    label: str
    content: Cell | JumpLevel | SignalLevel


@dataclass(frozen=True)
class LevelPart:
    """One level of the comparison.

    Attributes:
        title: Its heading.
        quantities: Compared quantities.
        times_noise: Size of the difference in multiples of repeatability [-].
        jumps: Rows of predicted and measured jumps.
        signals: Rows of signals over time.
        plot: Bars of signals listed joint by joint.
        open: Whether the section is open at first.
    """

    title: str
    quantities: str
    times_noise: float
    jumps: tuple[ResidualRow, ...]
    signals: tuple[ResidualRow, ...]
    plot: Plot | None
    open: bool

    def has(self, column: str) -> bool:
        """Whether some signal has a value in a column."""
        return any(getattr(row.content, column) for row in self.signals)


@dataclass(frozen=True)
class JointTable:
    """Signals of one arm, joint by joint.

    Attributes:
        title: The arm.
        signals: Headings of the columns.
        rows: A cell per column, by joint; None: not measured.
        small: Signals below their relevance limit in every joint, with the largest difference; they have no column.
    """

    title: str
    signals: tuple[str, ...]
    rows: dict[str, list[SignalLevel | None]]
    small: tuple[str, ...]


@dataclass(frozen=True)
class ResidualsPart:
    """Residuals by signal, joint and condition.

    Attributes:
        plots: Heat maps.
        yardstick: Unit of the residuals, in words.
        largest: The largest residuals.
    """

    plots: tuple[Plot, ...]
    yardstick: str
    largest: tuple[ResidualRow, ...]


@dataclass(frozen=True)
class TracksPart:
    """Measured against predicted over time.

    Attributes:
        sets: Tracks as the script of the page reads them; empty: nothing is shown.
        plot: The empty figure that the script fills.
        of_trials: Whether the tracks show trials; otherwise recordings.
        scatter: Measured against predicted numbers of an impact table, which has no time; None: tracks.
        replay: The same runs in 3D; None if positions are not known.
    """

    sets: list[dict[str, Any]]
    plot: Plot
    of_trials: bool
    scatter: Plot | None = None
    replay: ReplayPart | None = None


@dataclass(frozen=True)
class ComparisonPage:
    """Content of ``comparison.html.j2``.

    Attributes:
        title: Heading.
        headline: Summary in two sentences.
        yardstick: Unit of the differences, in words.
        unit: Unit of the score; empty: multiples of the yardstick.
        document: The comparison.
        levels: Its levels.
        joints: A table per arm; empty: no trials.
        residuals: Residuals by signal, joint and condition.
        tracks: Measured against predicted over time.
        history: Errors of the model and its parents; None without a parent.
        links: Titles of pages of the same measurements, by their relative paths.
        agreement: Which readings agree; None: no relation between them was measured.
        rollouts_plot: Error of the tool in rollouts over time; None: no rollouts, or a tool that does not move.
    """

    title: str
    headline: str
    yardstick: str
    unit: str
    document: ComparisonDocument
    levels: tuple[LevelPart, ...]
    joints: tuple[JointTable, ...]
    residuals: ResidualsPart
    tracks: TracksPart
    history: HistoryPart | None
    links: Mapping[str, str]
    agreement: AgreementGraph | None
    rollouts_plot: Plot | None


def write_comparison(
    document: ComparisonDocument,
    tracks: Sequence[Track],
    versions: Sequence[VersionError] | None,
    directory: Path,
    links: Mapping[str, str] = MappingProxyType({}),
) -> Path:
    """Write ``compare.html`` and ``compare.json``.

    Args:
        document: Model against measurement.
        tracks: Measured and predicted signals over time.
        versions: Errors of the model and its parents; None without a parent.
        directory: Folder of the report.
        links: Titles of pages of the same measurements to link, by their relative paths.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    page = ComparisonPage(
        title=f"Model '{document.model.name}' against measurement",
        headline=comparison_in_words(document),
        yardstick=yardstick_of(document),
        unit="" if on_scale(document) else document.score_unit,
        document=document,
        levels=level_parts(document),
        joints=joint_tables(document),
        residuals=residuals_part(document),
        tracks=tracks_part(document, tracks),
        history=history_part(versions) if versions else None,
        links=links,
        agreement=agreement_graph(document.agreement),
        rollouts_plot=_rollouts_plot(document.rollouts),
    )
    data = json.dumps(document.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"
    text = render("comparison.html.j2", page, replay=page.tracks.replay is not None)
    files = {COMPARISON_PAGE: text, COMPARISON_DATA: data}
    return write_files(directory, files)[0]


def _rollouts_plot(rollouts: RolloutDocument | None) -> Plot | None:
    """Error of the tool over time; None without rollouts, or if the tool does not move."""
    if rollouts is None or not any(rollouts.tool_mm):
        return None
    return Plot("rollouts", rollouts_plot(rollouts))


def comparison_in_words(document: ComparisonDocument) -> str:
    """Score and worst place in two sentences."""
    name, score, noise = document.model.name, number_text(document.score), document.noise_floor
    yardstick = yardstick_of(document)
    if document.source == "recordings":
        text = f"Torque residual of model '{name}': {score} {document.score_unit} rms"
        text += "." if noise is None else f" (noise alone: {number_text(noise)} {document.score_unit})."
    elif not on_scale(document):
        text = f"Velocity residual of model '{name}' after {document.trials} impacts: {score} {document.score_unit} rms"
        text += "." if noise is None else f" (noise alone: {number_text(noise)} {document.score_unit})."
    else:
        scale = SCALE if noise is None else yardstick
        text = f"Residual of model '{name}' in {document.trials} {document.source}: {score} × {scale}."
    if noise is not None and document.score < MIN_NAMED_SCORE * noise:
        return f"{text} This is close to noise."
    worst = next((cell for cell in document.where if cell.matters), None)
    if worst is None:
        return f"{text} All residuals are below their relevance limits." if document.where else text
    return (
        f"{text} Largest in {worst.signal} {worst.index} ({_location(worst)}): "
        f"{quantity_text(worst.error, worst.unit)}, {number_text(worst.times_noise)} × {yardstick}."
    )


def on_scale(document: ComparisonDocument) -> bool:
    """Whether the score is a multiple of the yardstick; otherwise it has a unit."""
    return document.source == "trials" or document.score_unit == TIMES


def yardstick_of(document: ComparisonDocument) -> str:
    """Reference of relative differences: repeatability, relevance limit, or noise."""
    if document.source == "impacts" and document.noise_floor is None:
        return SPREAD
    if not on_scale(document):
        return NOISE
    return RELEVANCE_LIMIT if document.noise_floor is None else REPEATABILITY


def yardstick_of_residuals(document: ComparisonDocument) -> str:
    """Reference of single residuals: the larger of :func:`yardstick_of` and relevance limit, if one is set."""
    yardstick = yardstick_of(document)
    limited = yardstick != RELEVANCE_LIMIT and any(cell.floor for cell in document.where)
    return f"the larger of {yardstick} and relevance limit" if limited else yardstick


def yardstick_of_unexplained(document: DiagnosisDocument) -> str:
    """Reference of the residuals that a diagnosis leaves unexplained."""
    if document.source == "trials":
        return REPEATABILITY if document.design.freedom else RELEVANCE_LIMIT
    if document.error_unit == TIMES:
        return REPEATABILITY
    return NOISE if document.noise_floor else SPREAD


def _location(cell: Cell, scenario: bool = False) -> str:
    return ", ".join(filter(None, (location_text(cell, scenario=scenario), phase_text(cell.phase).lower())))


def level_parts(document: ComparisonDocument) -> tuple[LevelPart, ...]:
    """The levels with content; the last one is open."""
    parts = []
    several_scenarios = len({entry.scenario for level in document.levels.values() for entry in level.entries}) > 1
    levels = {name: level for name, level in document.levels.items() if level.signals or level.entries}
    for name, level in levels.items():
        by_joint = level.signals if level.signals and all(row.index for row in level.signals) else ()
        parts.append(
            LevelPart(
                title=LEVELS.get(name, name),
                quantities=level.what,
                times_noise=level.times_noise,
                jumps=tuple(
                    ResidualRow(f"{location_text(row, scenario=several_scenarios)}: {row.signal} {row.index}", row)
                    for row in level.entries
                ),
                signals=tuple(ResidualRow(f"{signal_text(row)} {row.index}".rstrip(), row) for row in level.signals),
                plot=Plot(f"level-{name}", signals_plot(by_joint)) if by_joint else None,
                open=name == list(levels)[-1],
            )
        )
    return tuple(parts)


def joint_tables(document: ComparisonDocument) -> tuple[JointTable, ...]:
    """Signals joint by joint, a table per arm."""
    tables = []
    for arm in dict.fromkeys(row.arm for row in document.joints):
        rows_of_arm = {(row.index, row.phase, row.signal): row for row in document.joints if row.arm == arm}
        joints = sorted({index for index, *_ in rows_of_arm}, key=lambda index: int(index.removeprefix("joint")))
        columns: dict[tuple[str, str], list[SignalLevel]] = {}
        for (_, *signal), row in rows_of_arm.items():
            columns.setdefault((signal[0], signal[1]), []).append(row)
        largest = {signal: max(rows, key=lambda row: row.error) for signal, rows in columns.items()}
        signals = [signal for signal, row in largest.items() if row.error >= row.floor]
        tables.append(
            JointTable(
                title=arm_titles(document.arms, arm),
                signals=tuple(f"{phase_text(phase)}: {signal}" for phase, signal in signals),
                rows={joint: [rows_of_arm.get((joint, *signal)) for signal in signals] for joint in joints}
                if signals
                else {},
                small=tuple(
                    f"{phase_text(phase)}: {signal} ({quantity_text(row.error, row.unit)})"
                    for (phase, signal), row in largest.items()
                    if (phase, signal) not in signals
                ),
            )
        )
    return tuple(tables)


def residuals_part(document: ComparisonDocument) -> ResidualsPart:
    """Heat maps, and the largest residuals as numbers."""
    of_recordings = not on_scale(document)
    several = len({cell.scenario for cell in document.where}) > 1
    yardstick = yardstick_of_residuals(document)
    return ResidualsPart(
        plots=tuple(
            Plot(f"where-{number}", drawn, title=title)
            for number, (title, drawn) in enumerate(residual_maps(document.where, of_recordings, yardstick))
        ),
        yardstick=yardstick,
        largest=tuple(
            ResidualRow(f"{_location(cell, several)}: {cell.signal} {cell.index}", cell)
            for cell in [cell for cell in document.where if cell.matters][:MAX_LISTED_RESIDUALS]
        ),
    )


def tracks_part(document: ComparisonDocument, tracks: Sequence[Track]) -> TracksPart:
    """Tracks, with the data of the selection in the page."""
    if document.source == "impacts":
        scatter = Plot("scatter", scatter_plot(tracks), zoom=True) if tracks else None
        return TracksPart([], Plot("tracks-plot", tracks_plot(), zoom=True), False, scatter)
    return TracksPart(
        track_data(tracks),
        Plot("tracks-plot", tracks_plot(), zoom=True),
        document.source == "trials",
        replay=ReplayPart.of(tracks, choose=False) if all(track.in_3d for track in tracks) else None,
    )
