# SPDX-License-Identifier: Apache-2.0
"""Page of a rehearsal: verdict, margins to all bounds, and omitted checks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from impact_rs_analysis.report.figures import BLUE, RED
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.page_names import REHEARSAL_DATA, REHEARSAL_PAGE
from impact_rs_analysis.report.plots import GREY, TEMPLATE
from impact_rs_trials.checked_bound import CheckedBound

MAX_BAR_RATIO = 1.5  # value over bound; a longer bar ends there


@dataclass(frozen=True)
class RehearsalPage:
    """Content of ``rehearsal.html.j2``.

    Attributes:
        title: Heading.
        verdict: Result of the rehearsal.
        passed: Whether the rehearsal was passed.
        driver: The emulated driver, and the source of its numbers.
        bounds: The checklist.
        unknown: Unchecked properties, with the reason.
        log: Log of the cell, and events.
        plots: Figures.
    """

    title: str
    verdict: str
    passed: bool
    driver: str
    bounds: tuple[CheckedBound, ...]
    unknown: tuple[str, ...]
    log: tuple[str, ...]
    plots: tuple[Plot, ...]


def write_rehearsal(
    title: str, driver: str, bounds: Sequence[CheckedBound], document: Mapping[str, Any], directory: Path
) -> Path:
    """Write ``rehearsal.html`` and ``rehearsal.json``.

    Args:
        title: Scenario, object and case.
        driver: The emulated driver, and the source of its numbers.
        bounds: The checklist.
        document: The rehearsal as JSON: ``verdict``, ``passed``, ``not_checked``, ``log`` and more.
        directory: Folder of the report.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    caption = "Largest value over its bound; beyond the line at 100 % the rehearsal is not passed."
    page = RehearsalPage(
        title=f"Rehearsal of {title}",
        verdict=str(document["verdict"]),
        passed=bool(document["passed"]),
        driver=driver,
        bounds=tuple(bounds),
        unknown=tuple(document["not_checked"]),
        log=tuple(document["log"]),
        plots=(Plot("margins", margins_plot(bounds), caption),)
        if any(bound.share is not None for bound in bounds)
        else (),
    )
    files = {
        REHEARSAL_PAGE: render("rehearsal.html.j2", page),
        REHEARSAL_DATA: json.dumps(document, indent=2, allow_nan=False) + "\n",
    }
    return write_files(directory, files)[0]


def margins_plot(bounds: Sequence[CheckedBound]) -> go.Figure:
    """Bars of every value over its bound, from 0 to ``MAX_BAR_RATIO``."""
    rows = [(bound.name, bound.share, bound.holds) for bound in reversed(bounds) if bound.share is not None]
    figure = go.Figure(layout={"template": TEMPLATE})
    figure.add_bar(
        y=[name for name, *_ in rows],
        x=[min(share, MAX_BAR_RATIO) for _, share, _ in rows],
        text=[f"{share:.0%}" for _, share, _ in rows],
        textposition="auto",
        orientation="h",
        marker={"color": [BLUE if holds else RED for *_, holds in rows]},
        hoverinfo="skip",
    )
    figure.add_vline(x=1.0, line={"color": GREY, "width": 2})
    return figure.update_layout(
        height=120 + 28 * len(rows),
        showlegend=False,
        xaxis={"title": {"text": "value over bound"}, "range": [0.0, MAX_BAR_RATIO], "tickformat": ".0%"},
        yaxis={"automargin": True, "ticksuffix": " "},
    )
