# SPDX-License-Identifier: Apache-2.0
"""Page of a discovery: the law as a formula, its force over its quantity, and laws tied with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import plotly.graph_objects as go

from impact_rs_analysis.diagnosis.laws.discovery_document import DiscoveryDocument, LawDocument
from impact_rs_analysis.report.figures import BLUE, RED
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.page_names import DISCOVERY_PAGE
from impact_rs_analysis.report.plots import TEMPLATE

BAND = "rgba(0, 114, 178, 0.2)"


@dataclass(frozen=True)
class DiscoveryPage:
    """Content of ``discovery.html.j2``.

    Attributes:
        title: Heading.
        document: The discovery.
        plot: Force of the best law over its quantity; None without such a law.
    """

    title: str
    document: DiscoveryDocument
    plot: Plot | None


def write_report(document: DiscoveryDocument, directory: Path) -> Path:
    """Write ``discovery.html``.

    Args:
        document: The discovery.
        directory: Folder of the report.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    best = document.laws[0] if document.laws else None
    plot = None if best is None or best.curve is None else Plot("law", law_plot(best), caption=_caption(best))
    page = DiscoveryPage("Discovery of a law", document, plot)
    return write_files(directory, {DISCOVERY_PAGE: render("discovery.html.j2", page)})[0]


def law_plot(law: LawDocument) -> go.Figure:
    """The force of a law over its quantity with its band, and a free curve with 95 % intervals.

    Args:
        law: A law with a curve.
    """
    curve, domain = law.curve, law.valid
    assert curve is not None and domain is not None
    low, high = zip(*curve.law_ci95, strict=True)
    points = curve.points
    traces = [
        go.Scatter(x=curve.at, y=low, mode="lines", line={"width": 0}, showlegend=False, hoverinfo="skip"),
        go.Scatter(x=curve.at, y=high, mode="lines", line={"width": 0}, fill="tonexty", fillcolor=BAND, name="95 %"),
        go.Scatter(x=curve.at, y=curve.law, mode="lines", line={"color": BLUE}, name=law.name),
        go.Scatter(
            x=[point.at for point in points],
            y=[point.force for point in points],
            mode="markers",
            marker={"color": RED, "size": 8},
            error_y={
                "type": "data",
                "symmetric": False,
                "array": [point.ci95[1] - point.force for point in points],
                "arrayminus": [point.force - point.ci95[0] for point in points],
            },
            name="values" if law.curved else "free curve",
        ),
    ]
    return go.Figure(traces, layout={"template": TEMPLATE}).update_layout(
        height=400,
        xaxis={"title": {"text": f"{domain.quantity} [{domain.unit}]"}},
        yaxis={"title": {"text": f"{law.place} [{curve.unit}]"}},
    )


def _caption(law: LawDocument) -> str:
    if law.curved:
        return (
            "Curve of the dependence that no law explains, with its 95 % band. Points: its values with their "
            "intervals, linearly interpolated. Beyond them it falls to 0: nothing was measured there."
        )
    return (
        f"Line: {law.name} with its 95 % band. Points: a free curve in its place, fitted to the same measurements, "
        "with 95 % intervals; it assumes no form."
    )
