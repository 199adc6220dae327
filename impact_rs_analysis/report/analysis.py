# SPDX-License-Identifier: Apache-2.0
"""Report of an analysis: predicted and measured velocity jumps as one page, as numbers and as PNG."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from impact_rs_analysis.evidence.tracks import Track, track_of_bag
from impact_rs_analysis.measure.analyze import Analysis, ArmSet, ExperimentSet
from impact_rs_analysis.measure.arms import ArmDocument, arm_titles, assumptions
from impact_rs_analysis.measure.far import far_words
from impact_rs_analysis.measure.sensitivity import setting_words
from impact_rs_analysis.measure.table import Row, result_table, shown_contacts
from impact_rs_analysis.report.animation import ReplayPart
from impact_rs_analysis.report.figures import Figure, figures_of
from impact_rs_analysis.report.page import MAX_CURVE_POINTS, Plot, render, write_files
from impact_rs_analysis.report.page_names import ANALYSIS_PAGE
from impact_rs_analysis.report.plots import curves_plot
from impact_rs_analysis.report.png import write_png
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole_folder
from impact_rs_trials.bags.reader import BagError, TrialBag, reason_of

logger = logging.getLogger(__name__)
MAX_PAGE_POINTS = 2400  # total of all curves over time; keeps the page below 3 MB


@dataclass(frozen=True)
class TableRow:
    """One row of the table of results.

    Attributes:
        row: Its numbers.
        best: Motor-inertia model with the smallest error, by contact.
        fits: Whether its prediction agrees with the estimate, by contact.
    """

    row: Row
    best: dict[str, str]
    fits: dict[str, bool]


@dataclass(frozen=True)
class SensitivityRow:
    """Sensitivity of the estimates of one object to settings.

    Attributes:
        label: Scenario and object.
        shifts: Change of the estimate by words for setting and factor [%].
        band: Systematic band, low then high [%].
    """

    label: str
    shifts: dict[str, float]
    band: tuple[float, float]


@dataclass(frozen=True)
class Listing:
    """Sets and trials with a remark.

    Attributes:
        title: Heading of the list.
        items: Names with their remarks.
    """

    title: str
    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class SetPart:
    """One set of trials.

    Attributes:
        entry: Its estimate and errors.
        plots: Its figures.
    """

    entry: ExperimentSet
    plots: tuple[Plot, ...]


@dataclass(frozen=True)
class AnalysisPage:
    """Content of ``analysis.html.j2``.

    Attributes:
        title: Heading.
        campaign: Name of the folder.
        trials: Number of trials in the fits.
        rows: The table of results; empty: no set has an estimate.
        arms: Arms of the trials.
        by_arm: Table of results of every arm, by its title; empty with a single arm.
        with_paper: Whether a row has published numbers.
        contacts: Contacts whose errors are shown; the first alone if both have the same errors.
        none_fit: Whether the nearest prediction of some row disagrees with the estimate.
        sensitivity: Sensitivity of the estimates to settings; empty if none was varied.
        far: Warning about predictions far from the measurement; empty without such predictions.
        left_out: Sets and trials with remarks.
        sets: Sets with an estimate.
        contact: Contact whose predictions the figures show.
        replay: The trial with the least net feedback of every set in 3D; None if positions are not known.
    """

    title: str
    campaign: str
    trials: int
    rows: tuple[TableRow, ...]
    arms: tuple[ArmDocument, ...]
    by_arm: dict[str, list[tuple[str, ArmSet]]]
    with_paper: bool
    contacts: tuple[str, ...]
    none_fit: bool
    sensitivity: tuple[SensitivityRow, ...]
    far: str
    left_out: tuple[Listing, ...]
    sets: tuple[SetPart, ...]
    contact: str
    replay: ReplayPart | None

    @property
    def assumptions(self) -> list[str]:
        """Assumptions about the arms, as one sentence; empty without assumptions."""
        return assumptions(self.arms)

    @property
    def setting_words(self) -> list[str]:
        """Rows of the table of settings."""
        return list(dict.fromkeys(words for row in self.sensitivity for words in row.shifts))


def write_analysis_report(
    analysis: Analysis,
    directory: Path,
    progress: Callable[[int, int], None] | None = None,
    contact: str = "first",
) -> list[Path]:
    """Write ``report.html``, ``analysis.json`` and a PNG per figure, all or none; an earlier report is replaced.

    Args:
        analysis: The analysis.
        directory: Output folder; made if missing.
        progress: Called with the number of files written and the number of all files.
        contact: Contact whose predictions the figures show, ``first`` or ``settled``; the table has both.

    Returns:
        The files written, the HTML first.

    Raises:
        InputError: The folder cannot be written.
    """
    figures = [
        (entry, figures_of(entry, contact, analysis.sensitivity.band(entry.scenario, entry.object)))
        for entry in analysis.sets
    ]
    all_figures = [figure for _, set_figures in figures for figure in set_figures]
    data = json.dumps(analysis.to_json(), indent=2, allow_nan=False) + "\n"
    page = _page(analysis, figures, contact)
    text = render("analysis.html.j2", page, replay=page.replay is not None)
    with whole_folder(directory) as aside:
        written = write_files(aside, {ANALYSIS_PAGE: text, "analysis.json": data})
        for count in range(len(all_figures) + 1):
            if progress is not None:
                progress(len(written), 2 + len(all_figures))
            if count < len(all_figures):
                written.append(write_png(all_figures[count], aside / f"{all_figures[count].name}.png"))
    return [directory / file.name for file in written]


def _page(analysis: Analysis, figures: Sequence[tuple[ExperimentSet, list[Figure]]], contact: str) -> AnalysisPage:
    rows = result_table(analysis)
    contacts = shown_contacts(rows)
    tracks = {number: _animation(entry) for number, entry in enumerate(analysis.sets)}
    shown_tracks = {number: track for number, track in tracks.items() if track is not None}
    run_numbers = {number: run for run, number in enumerate(shown_tracks)}
    points = min(MAX_CURVE_POINTS, MAX_PAGE_POINTS // max(len(analysis.sets), 1))
    return AnalysisPage(
        title="Predicted and measured velocity jumps",
        campaign=analysis.directory.resolve().name,
        trials=sum(entry.fit.count for entry in analysis.sets),
        rows=_table_rows(rows, contacts),
        arms=analysis.arms,
        by_arm=arm_rows(analysis),
        with_paper=any(row.paper_errors is not None for row in rows),
        contacts=contacts,
        none_fit=any(not row.fits(contact) for row in rows for contact in contacts),
        sensitivity=tuple(sensitivity_rows(analysis)),
        far=far_words(analysis.jumps),
        left_out=tuple(listing for listing in _left_out(analysis) if listing.items),
        sets=tuple(
            SetPart(
                entry,
                tuple(
                    Plot(
                        figure.name,
                        curves_plot(figure, points),
                        figure.caption,
                        zoom=True,
                        run=run_numbers.get(number) if figure.over_time else None,
                    )
                    for figure in set_figures
                ),
            )
            for number, (entry, set_figures) in enumerate(figures)
        ),
        contact=contact,
        replay=ReplayPart.of(list(shown_tracks.values())),
    )


def _table_rows(rows: Sequence[Row], contacts: Sequence[str]) -> tuple[TableRow, ...]:
    """Rows with their shading; rows of averages are shaded if the nearest prediction of some set fits."""
    any_fits = {contact: any(row.fits(contact) for row in rows if row.estimate is not None) for contact in contacts}
    return tuple(
        TableRow(
            row,
            {contact: row.nearest(contact) for contact in contacts},
            {contact: row.fits(contact) if row.estimate is not None else any_fits[contact] for contact in contacts},
        )
        for row in rows
    )


def _animation(entry: ExperimentSet) -> Track | None:
    """The trial of a set with the least feedback, nearest to the estimate; None if it cannot be shown."""
    trial = min(entry.trials, key=lambda trial: abs(trial.net))
    try:
        return replace(track_of_bag(TrialBag.open(trial.path)), label=f"{entry.label}: {trial.name}")
    except (BagError, InputError) as error:  # the estimate needs fewer topics than the 3D view
        logger.warning("%s is not shown in 3D: %s", trial.name, reason_of(error))
        return None


def arm_rows(analysis: Analysis) -> dict[str, list[tuple[str, ArmSet]]]:
    """Sets with their labels, by title of the arm; empty if every set has one arm."""
    rows: dict[str, list[tuple[str, ArmSet]]] = {}
    for entry in analysis.sets:
        for arm in entry.arms:
            rows.setdefault(arm_titles(analysis.arms, arm.name), []).append((entry.label, arm))
    return rows


def sensitivity_rows(analysis: Analysis) -> Iterator[SensitivityRow]:
    """One row per object with estimates under varied settings."""
    sensitivity = analysis.sensitivity
    for scenario, name in dict.fromkeys((shift.scenario, shift.object) for shift in sensitivity.shifts):
        shifts = {
            setting_words(setting, factor): percent
            for setting, values in sensitivity.of(scenario, name).items()
            for factor, percent in sorted(values.items())
        }
        band = sensitivity.band(scenario, name)
        assert band is not None
        yield SensitivityRow(f"{scenario}: {name}", shifts, band)


def _left_out(analysis: Analysis) -> list[Listing]:
    return [
        Listing(
            "Sets without an estimate",
            tuple((f"{entry.object} {entry.case}", entry.reason) for entry in analysis.incomplete),
        ),
        Listing("Trials without impact, not in the fit", tuple((name, "") for name in analysis.no_impact)),
        Listing(
            "Sets whose object does not stay at the pad",
            tuple((f"{departure.object} {departure.case}", departure.words) for departure in analysis.departed),
        ),
        Listing(
            "Trials in which one arm hit long before another",
            tuple((name, f"{1e3 * spread:.0f}\N{NO-BREAK SPACE}ms") for name, spread in analysis.apart),
        ),
        Listing(
            "Trials with a joint at its torque limit, whose net feedback is not valid",
            tuple((name, f"{joint}, {1e3 * time:.0f}\N{NO-BREAK SPACE}ms") for name, joint, time in analysis.limited),
        ),
        Listing("Settings whose effect could not be evaluated", analysis.sensitivity.missing),
        Listing("Bags skipped", tuple((entry.name, entry.reason) for entry in analysis.skipped)),
        Listing("Trials of the manifest that are missing", tuple((name, "") for name in analysis.missing)),
    ]
