# SPDX-License-Identifier: Apache-2.0
"""Page of speed limits: allowed and planned speeds, their bounds, and a map over positions of the hit."""

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
from impact_rs_analysis.limits.speed import HOLD_PROBABILITY, SpeedLimit, speed_words
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
        kinds: Kinds with a bound, with their names.
        unknown: Names of kinds without a bound.
        plots: Figures.
    """

    title: str
    answer: str
    limits: tuple[SpeedLimit, ...]
    kinds: dict[str, str]
    unknown: tuple[str, ...]
    plots: tuple[Plot, ...]


def write_limits(
    scenario: Scenario, limits: Sequence[SpeedLimit], positions: Sequence[PlacedLimit], directory: Path
) -> Path:
    """Write ``limits.html``, ``limits.json`` and ``limits.csv``.

    Args:
        scenario: The scenario.
        limits: Limits of its objects and cases.
        positions: Limits at other positions of the hit, row by row upwards; may be empty.
        directory: Folder of the report.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    plots = [Plot("limits", limits_plot(limits), "Allowed closing speed by kind of bound; line: planned.")]
    if positions:
        caption = (
            "Allowed closing speed [m/s] where the hit is moved along x and z, with pad, object and support; empty: "
            "the arm cannot hit there. 0, 0 is the place of the scenario. Red: slower than planned; blue: faster."
        )
        plots.append(Plot("places", places_plot(positions), caption, "Over places of the hit"))
    too_fast = [limit for limit in limits if not limit.allowed]
    slowest = min(limits, key=lambda limit: limit.speed)
    answer = (
        f"{len(limits) - len(too_fast)} of {len(limits)} planned hits are allowed. The least is "
        f"{speed_words(slowest.speed)} ({slowest.object_name}, {slowest.case_name}; {slowest.binding})."
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
        LIMITS_DATA: json.dumps(limits_document(scenario, limits, positions), indent=2, allow_nan=False) + "\n",
        LIMITS_TABLE: _csv(limits, positions),
    }
    return write_files(directory, files)[0]


def limits_document(
    scenario: Scenario, limits: Sequence[SpeedLimit], positions: Sequence[PlacedLimit]
) -> dict[str, Any]:
    """Speed limits as JSON."""
    return {
        "scenario": scenario.name,
        "level": HOLD_PROBABILITY,
        "limits": [entry.to_json() for entry in limits],
        "places": [
            {
                "x_m": entry.x,
                "z_m": entry.z,
                "limit": None if entry.limit is None else entry.limit.to_json(),
                **({"reason": entry.reason} if entry.reason else {}),
            }
            for entry in positions
        ],
    }


def limits_plot(limits: Sequence[SpeedLimit]) -> go.Figure:
    """Bars of the allowed speed by kind of bound, with the planned speed."""
    names = [f"{limit.object_name}, {limit.case_name}" for limit in limits]
    figure = go.Figure(layout={"template": TEMPLATE, "barmode": "group"})
    for kind in KINDS:
        if kind in limits[0].by_kind:
            speeds = [limit.to_json()["by_kind_m_s"][kind] for limit in limits]  # type: ignore[index]
            figure.add_bar(x=names, y=speeds, name=KIND_WORDS[kind], marker={"color": KIND_COLOURS[kind]})
    planned = [limit.planned for limit in limits]
    marker = {"symbol": "line-ew-open", "size": 30, "color": BLACK}
    figure.add_scatter(x=names, y=planned, mode="markers", name="planned", marker=marker)
    return figure.update_layout(height=400, yaxis={"title": {"text": "closing speed [m/s]"}, "rangemode": "tozero"})


def places_plot(positions: Sequence[PlacedLimit]) -> go.Figure:
    """Map of the allowed speed over positions of the hit; the colour is its ratio to the planned speed, from 0 to 2."""
    x, z = (sorted({getattr(limit, axis) for limit in positions}) for axis in ("x", "z"))
    limits = {(limit.x, limit.z): limit.limit for limit in positions if limit.limit is not None}
    grid = [[limits.get((x_value, z_value)) for x_value in x] for z_value in z]
    heat = go.Heatmap(
        x=x,
        y=z,
        z=[
            [None if limit is None else min(limit.speed / limit.planned, COLOUR_SCALE_END) for limit in row]
            for row in grid
        ],
        text=[["" if limit is None else _speed(limit.speed) for limit in row] for row in grid],
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


def _csv(limits: Sequence[SpeedLimit], positions: Sequence[PlacedLimit]) -> str:
    """All limits as CSV, one row per limit."""
    text = io.StringIO()
    kinds = [f"{kind} [m/s]" for kind in KINDS]
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["object", "case", "x [m]", "z [m]", "planned [m/s]", "limit [m/s]", *kinds, "nearest bound"])
    rows = [(0.0, 0.0, limit) for limit in limits]
    rows += [(limit.x, limit.z, limit.limit) for limit in positions if limit.limit is not None]
    for x, z, limit in rows:
        speeds = [limit.planned, limit.speed, *(limit.by_kind.get(kind, float("inf")) for kind in KINDS)]
        numbers = ["" if speed == float("inf") else f"{speed:.4f}" for speed in speeds]
        table.writerow([limit.object_name, limit.case_name, f"{x:g}", f"{z:g}", *numbers, limit.binding])
    return text.getvalue()
