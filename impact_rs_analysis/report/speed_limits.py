# SPDX-License-Identifier: Apache-2.0
"""Page of speed limits: allowed and planned speeds, what limits them, and a map over places of the hit."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from impact_rs_analysis.limits.hit_bounds import KIND_WORDS, KINDS
from impact_rs_analysis.limits.poses import PlacedLimit
from impact_rs_analysis.limits.speed import HOLD_PROBABILITY, SpeedLimit
from impact_rs_analysis.report.figures import BLACK, BLUE, GREEN, ORANGE, RED, SKY
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.page_names import LIMITS_DATA, LIMITS_PAGE, LIMITS_TABLE
from impact_rs_analysis.report.plots import GREY, TEMPLATE
from impact_rs_sim.scenarios.scenario import Scenario

KIND_COLOURS = {"jump": BLUE, "speed": GREEN, "torque": ORANGE, "reflex": RED, "force": GREY}
COLOUR_SCALE_END = 2.0  # limit over planned speed, at the end of the colour scale of the map


@dataclass(frozen=True)
class SpeedLimitPage:
    """Content of ``speed_limits.html.j2``.

    Attributes:
        title: Heading.
        answer: Result in a sentence.
        limits: Rows of the table.
        kinds: Kinds of bounds that are known, with their names.
        unknown: Names of the others.
        plots: Figures.
    """

    title: str
    answer: str
    limits: tuple[SpeedLimit, ...]
    kinds: dict[str, str]
    unknown: tuple[str, ...]
    plots: tuple[Plot, ...]


def write_limits(
    scenario: Scenario, limits: Sequence[SpeedLimit], places: Sequence[PlacedLimit], directory: Path
) -> Path:
    """Write ``limits.html``, ``limits.json`` and ``limits.csv``.

    Args:
        scenario: The scenario.
        limits: Limits of its objects and cases.
        places: Limits at other places of the hit, row by row upwards; empty: none.
        directory: Folder of the report.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    plots = [Plot("limits", limits_plot(limits), "Allowed closing speed by kind of bound; line: planned.")]
    if places:
        caption = (
            "Allowed closing speed [m/s] where the hit is moved along x and z, with pad, object and support; empty: "
            "the arm cannot hit there. 0, 0 is the place of the scenario. Red: slower than planned; blue: faster."
        )
        plots.append(Plot("places", places_plot(places), caption, "Over places of the hit"))
    slow = [one for one in limits if not one.allowed]
    least = min(limits, key=lambda one: one.speed)
    answer = (
        f"{len(limits) - len(slow)} of {len(limits)} planned hits are allowed. The least is {least.speed:.3f} m/s "
        f"({least.object_name}, {least.case_name}; {least.binding})."
    )
    page = SpeedLimitPage(
        title=f"How fast may {scenario.name} hit?",
        answer=answer,
        limits=tuple(limits),
        kinds={kind: KIND_WORDS[kind] for kind in KINDS if kind not in limits[0].unknown},
        unknown=tuple(KIND_WORDS[kind] for kind in limits[0].unknown),
        plots=tuple(plots),
    )
    files = {
        LIMITS_PAGE: render("speed_limits.html.j2", page),
        LIMITS_DATA: json.dumps(limits_document(scenario, limits, places), indent=2, allow_nan=False) + "\n",
        LIMITS_TABLE: _csv(limits, places),
    }
    return write_files(directory, files)[0]


def limits_document(scenario: Scenario, limits: Sequence[SpeedLimit], places: Sequence[PlacedLimit]) -> dict[str, Any]:
    """Speed limits as JSON."""
    return {
        "scenario": scenario.name,
        "level": HOLD_PROBABILITY,
        "limits": [one.to_json() for one in limits],
        "places": [
            {
                "x_m": one.x,
                "z_m": one.z,
                "limit": None if one.limit is None else one.limit.to_json(),
                **({"reason": one.reason} if one.reason else {}),
            }
            for one in places
        ],
    }


def limits_plot(limits: Sequence[SpeedLimit]) -> go.Figure:
    """Bars of the allowed speed by kind of bound, with the planned speed."""
    names = [f"{one.object_name}, {one.case_name}" for one in limits]
    figure = go.Figure(layout={"template": TEMPLATE, "barmode": "group"})
    for kind in KINDS:
        if kind in limits[0].by_kind:
            speeds = [one.to_json()["by_kind_m_s"][kind] for one in limits]  # type: ignore[index]
            figure.add_bar(x=names, y=speeds, name=KIND_WORDS[kind], marker={"color": KIND_COLOURS[kind]})
    planned = [one.planned for one in limits]
    marker = {"symbol": "line-ew-open", "size": 30, "color": BLACK}
    figure.add_scatter(x=names, y=planned, mode="markers", name="planned", marker=marker)
    return figure.update_layout(height=400, yaxis={"title": {"text": "closing speed [m/s]"}, "rangemode": "tozero"})


def places_plot(places: Sequence[PlacedLimit]) -> go.Figure:
    """Map of the allowed speed over places of the hit, in colours of its share of the planned one, from 0 to 2."""
    x, z = (sorted({getattr(one, axis) for one in places}) for axis in ("x", "z"))
    found = {(one.x, one.z): one.limit for one in places if one.limit is not None}
    grid = [[found.get((along, up)) for along in x] for up in z]
    heat = go.Heatmap(
        x=x,
        y=z,
        z=[[None if one is None else min(one.speed / one.planned, COLOUR_SCALE_END) for one in row] for row in grid],
        text=[["" if one is None else _speed(one.speed) for one in row] for row in grid],
        texttemplate="%{text}",
        hovertemplate="x %{x} m, z %{y} m: %{text} m/s<extra></extra>",
        colorscale=[[0.0, RED], [0.5, "#F7F7F7"], [1.0, SKY]],
        zmin=0.0,
        zmax=COLOUR_SCALE_END,
        colorbar={"title": {"text": "of the<br>planned"}, "tickformat": ".0%"},
    )
    return go.Figure([heat], layout={"template": TEMPLATE}).update_layout(
        height=420, xaxis={"title": {"text": "x [m]"}}, yaxis={"title": {"text": "z [m]"}}
    )


def _speed(value: float) -> str:
    """A speed as text."""
    return f"{value:.2f}" if math.isfinite(value) else "any"


def _csv(limits: Sequence[SpeedLimit], places: Sequence[PlacedLimit]) -> str:
    """All limits as a table, a row each."""
    text = io.StringIO()
    kinds = [f"{kind} [m/s]" for kind in KINDS]
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["object", "case", "x [m]", "z [m]", "planned [m/s]", "limit [m/s]", *kinds, "nearest bound"])
    rows = [(0.0, 0.0, one) for one in limits]
    rows += [(one.x, one.z, one.limit) for one in places if one.limit is not None]
    for x, z, one in rows:
        speeds = [one.planned, one.speed, *(one.by_kind.get(kind, float("inf")) for kind in KINDS)]
        numbers = ["" if speed == float("inf") else f"{speed:.4f}" for speed in speeds]
        table.writerow([one.object_name, one.case_name, f"{x:g}", f"{z:g}", *numbers, one.binding])
    return text.getvalue()
