# SPDX-License-Identifier: Apache-2.0
"""All figures of the reports for Plotly, in one style."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go

from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_analysis.report.figures import BLACK, BLUE, GREEN, ORANGE, RED, Curve, Figure, Panel
from impact_rs_analysis.report.labels import Tag, location_text, phase_text, tag_of
from impact_rs_analysis.report.page import quantity_text
from impact_rs_sim.robots.robot import Array, joined_units

if TYPE_CHECKING:  # figures of an analysis do not need the diagnosis package
    from impact_rs_analysis.diagnosis.document import DiagnosisDocument, JointError
    from impact_rs_analysis.diagnosis.history import VersionError
    from impact_rs_analysis.evidence.levels import Cell, SignalLevel
    from impact_rs_analysis.evidence.rollouts import RolloutDocument

GREY, GRID, ZERO = "#BBBBBB", "#E6E6E6", "#999999"
TAG_COLOURS = {Tag.GOOD: GREEN, Tag.MAYBE: ORANGE, Tag.NO: GREY}
DASHES = {"solid": "solid", "dashed": "dash", "none": "solid"}
# Heat maps have one scale in all reports: 2 times repeatability is nearly white, 10 and more are darkest.
DARKEST_RATIO = 10.0  # in multiples of the larger of repeatability and relevance limit
DIVERGING_COLOURS = [
    [0.0, "#B2182B"],
    [0.2, "#EF8A62"],
    [0.4, "#F7EFEC"],
    [0.5, "#F7F7F7"],
    [0.6, "#ECF2F6"],
    [0.8, "#67A9CF"],
    [1.0, "#2166AC"],
]
MAX_PLOTTED_EFFECTS = 12  # rows of the figure
MIN_LOG_AXIS_RATIO = 10.0  # largest over smallest value, from which an axis is logarithmic
MIN_SHOWN_RATIO = 2.0  # residual over repeatability, from which a cell above its relevance limit is shown

_AXIS = {
    "automargin": True,
    "gridcolor": GRID,
    "zerolinecolor": ZERO,
    "zerolinewidth": 2,
    "title": {"standoff": 6, "font": {"size": 13}},
}
_BELOW = {"orientation": "h", "yref": "container", "y": 0, "yanchor": "bottom", "x": 0, "xanchor": "left"}
TEMPLATE = {  # plain data: a Plotly template object would load 0.2 s of modules at import
    "layout": {
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#1A1A1A"},
        "margin": {"l": 10, "r": 10, "t": 26, "b": 10},
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "legend": _BELOW,
        "hoverlabel": {"namelength": -1},
        "paper_bgcolor": "white",
        "plot_bgcolor": "rgba(0,0,0,0)",  # keeps lines below the data visible
    }
}


def _figure(data: Any = None) -> go.Figure:
    """A figure with our template alone; the default template of Plotly would add 6 kB."""
    return go.Figure(data, layout={"template": TEMPLATE})


def curves_plot(figure: Figure, max_points: int | None = None) -> go.Figure:
    """Plotly figure from the description that also gives the PNG.

    Args:
        figure: Description of the figure.
        max_points: Largest number of points of a curve over time; None: all.
    """
    if max_points is not None and figure.over_time:
        figure = replace(figure, panels=tuple(_decimated(panel, max_points) for panel in figure.panels))
    panels = len(figure.panels)
    drawn = _figure()
    gap = 0.045
    height = (1.0 - gap * (panels - 1)) / panels
    for number, panel in enumerate(figure.panels, start=1):
        suffix = "" if number == 1 else str(number)
        drawn.add_traces([_curve(curve, f"y{suffix}", panels > 1) for curve in panel.curves])
        top = 1.0 - (number - 1) * (height + gap)
        axis: dict[str, Any] = {"title": {"text": panel.y_label}, "domain": [max(0.0, top - height), top]}
        if panel.y_range is not None:
            axis["range"] = list(panel.y_range)
        drawn.update_layout({f"yaxis{suffix}": axis})
    for note in figure.notes:
        drawn.add_shape(_vertical(note.x))
        drawn.add_annotation(
            x=note.x, y=1.0, xref="x", yref="paper", text=note.label, showarrow=False, yanchor="bottom",
            font={"color": "#555555"},
        )  # fmt: skip
    return drawn.update_layout(
        height=720 if panels > 1 else 560,
        margin={"t": 58},
        xaxis={
            "title": {"text": figure.x_label},
            "range": None if figure.x_range is None else list(figure.x_range),
            "anchor": f"y{panels}" if panels > 1 else "y",
            "zeroline": False,
        },
    )


def _decimated(panel: Panel, max_points: int) -> Panel:
    """Decimated points of every curve."""
    strides = [max(1, math.ceil(curve.x.size / max_points)) for curve in panel.curves]
    curves = [
        replace(curve, x=curve.x[::stride], y=curve.y[::stride])
        for curve, stride in zip(panel.curves, strides, strict=True)
    ]
    return replace(panel, curves=tuple(curves))


def _curve(curve: Curve, axis: str, shared: bool) -> go.Scatter:
    # An estimate is hollow and large: it must not hide a prediction at the same value.
    size = 17 if curve.error else 11 if curve.x.size == 1 else 7
    error = None
    if curve.error is not None:
        low, high = curve.error
        error = {"type": "data", "symmetric": False, "array": [high], "arrayminus": [low], "thickness": 2}
    return go.Scatter(
        **_x_coordinates(curve.x),
        y=curve.y.astype(np.float32) if curve.y.size else [None],
        name=curve.label,
        showlegend=bool(curve.label),
        legendgroup=curve.colour if shared else None,
        mode="lines" if curve.line != "none" else "markers",
        line={"color": curve.colour, "dash": DASHES[curve.line], "width": 1 if curve.line == "dashed" else 2},
        marker={
            "symbol": f"{curve.marker}-open" if curve.error else curve.marker or "circle",
            "color": curve.colour,
            "size": size,
            "line": {"width": 2 if curve.error else 0},
        },
        opacity=0.7 if curve.line == "dashed" else 1.0,
        error_x=error,
        hovertemplate="%{x:.4g}, %{y:.4g}" + f"<extra>{curve.label}</extra>",
        xaxis="x",
        yaxis=axis,
    )


def _x_coordinates(x: Array) -> dict[str, Any]:
    """x coordinates of a curve; only start and step if they are evenly spaced, which keeps pages small."""
    if not x.size:  # a curve without points keeps its legend entry only with one invisible point
        return {"x": [None]}
    steps = np.diff(x)
    if steps.size > 1 and np.ptp(steps) < 1e-6 * abs(steps[0]):
        return {"x0": float(x[0]), "dx": float(x[-1] - x[0]) / steps.size}
    return {"x": x.astype(np.float32)}


def effects_plot(document: DiagnosisDocument) -> go.Figure | None:
    """Held-out error of the best effects, alone and added to the chosen ones; None if none was measured."""
    shown = [
        (effect, effect.held_out_error_after) for effect in document.effects if effect.held_out_error_after is not None
    ][:MAX_PLOTTED_EFFECTS]
    if not shown:
        return None
    names = [_plain(effect.name) for effect, _ in shown]
    colours = [TAG_COLOURS[tag_of(effect.verdict)] for effect, _ in shown]
    # Documents of earlier versions lack the error of an effect alone.
    alone = [effect.held_out_error_alone for effect, _ in shown]
    without_effect = [effect.held_out_error_without for effect, _ in shown]
    drawn = _figure()
    # Without a chosen effect every effect is alone.
    with_chosen = len(document.named) > 0 or not any(error is not None for error in alone)
    if with_chosen:
        for name, colour, without, (_, error) in zip(names, colours, without_effect, shown, strict=True):
            drawn.add_trace(
                go.Scatter(
                    y=[name, name], x=[without, error], mode="lines", line={"color": colour, "width": 3},
                    hoverinfo="skip", showlegend=False,
                )
            )  # fmt: skip
    for label, errors, symbol, size in (
        ("with the chosen effects", [error for _, error in shown] if with_chosen else [], "line-ns", 12),
        ("alone", alone if any(error is not None for error in alone) else [], "circle", 12),
    ):
        if not errors:
            continue
        drawn.add_trace(
            go.Scatter(
                y=names,
                x=errors,
                name=label,
                mode="markers",
                marker={"symbol": symbol, "color": colours, "size": size, "line": {"width": 2, "color": colours}},
                hovertemplate=f"%{{y}}, {label}: %{{x:.3g}}<extra></extra>",
            )
        )
    reference_lines = {"model as it is": (document.held_out_error_before, "#555555", "dash")}
    reference_lines["noise alone"] = (document.noise_floor, GREEN, "dot")
    for label, (value, colour, dash) in reference_lines.items():
        line = {"color": colour, "width": 2, "dash": dash}
        drawn.add_shape(_vertical(value) | {"line": line}, name=label, showlegend=True)
    numbers = [document.held_out_error_before, document.noise_floor, *(error for _, error in shown)]
    numbers += [error for error in (*alone, *without_effect) if error is not None]
    unit = "× repeatability" if document.error_unit == TIMES else document.error_unit
    return drawn.update_layout(
        height=130 + 24 * len(shown),
        xaxis={"title": {"text": f"held-out error [{_plain(unit)}]"}, "fixedrange": True} | _range(numbers),
        yaxis={"autorange": "reversed", "fixedrange": True},
    )


def _range(numbers: Sequence[float]) -> dict[str, Any]:
    """An axis from zero, or a logarithmic one if the smallest number would be invisible."""
    smallest, largest = min(numbers), max(numbers)
    if smallest <= 0.0 or largest < MIN_LOG_AXIS_RATIO * smallest:
        return {"range": [0.0, 1.05 * largest]}
    low, high = math.log10(smallest), math.log10(largest)
    margin = 0.05 * (high - low)
    return {"type": "log", "range": [low - margin, high + margin], "dtick": 1}


def joints_plot(rows: Sequence[JointError]) -> go.Figure:
    """Torque error of every joint before and after, and the noise of its torque."""
    groups = [("before", GREY, [row.before for row in rows]), ("after", GREEN, [row.after for row in rows])]
    return _joint_bars(
        [row.joint for row in rows], groups, [row.noise for row in rows], joined_units(row.unit for row in rows)
    )


def signals_plot(rows: Sequence[SignalLevel]) -> go.Figure:
    """Error and noise of signals listed joint by joint; all have one unit."""
    groups = [("model", BLUE, [row.error for row in rows])]
    return _joint_bars([row.index for row in rows], groups, [row.noise_floor for row in rows], rows[0].unit)


def _joint_bars(
    joints: Sequence[str], groups: Sequence[tuple[str, str, list[float]]], noise: list[float], unit: str
) -> go.Figure:
    names = [_plain(joint) for joint in joints]
    drawn = _figure([go.Bar(name=label, x=names, y=values, marker_color=colour) for label, colour, values in groups])
    marker = {"symbol": "line-ew", "size": 24, "color": BLACK, "line": {"width": 2, "color": BLACK}}
    drawn.add_trace(go.Scatter(x=names, y=noise, name="noise alone", mode="markers", marker=marker))
    return drawn.update_layout(
        height=320,
        barmode="group",
        yaxis={"title": {"text": f"error [{_plain(unit)} rms]"}, "fixedrange": True},
        xaxis={"type": "category", "fixedrange": True},
    ).update_traces(hovertemplate="%{x}: %{y:.3g}")


def noticeable(cell: Cell) -> bool:
    """Whether a residual exceeds noise and its relevance limit."""
    return cell.times_noise > MIN_SHOWN_RATIO and cell.matters


def residual_maps(cells: Sequence[Cell], by_phase: bool, yardstick: str) -> list[tuple[str, go.Figure]]:
    """Heat maps of signed residuals, with their titles.

    Args:
        cells: Places, largest first.
        by_phase: Whether there is one map with a column per phase, as for recordings; otherwise there is a map per
            phase with a column per object and case.
        yardstick: Unit of the residuals, in words.
    """
    if by_phase:
        drawn = _heat_map(cells, [(phase_text(cell.phase), cell) for cell in cells], yardstick)
        title = "By joint and motion" if all(cell.signal == "torque" for cell in cells) else "By signal"
        return [] if drawn is None else [(title, drawn)]
    several_scenarios = len({cell.scenario for cell in cells}) > 1
    maps = []
    for phase in sorted({cell.phase for cell in cells}, key=_order_of_phase):
        of_phase = [cell for cell in cells if cell.phase == phase]
        columns = [(location_text(cell, several_scenarios), cell) for cell in of_phase]
        drawn = _heat_map(of_phase, sorted(columns, key=lambda entry: entry[0]), yardstick)
        if drawn is not None:
            maps.append((phase_text(phase), drawn))
    return maps


def _order_of_phase(phase: str) -> tuple[int, str]:
    order = ("free", "impact", "push")
    return (order.index(phase) if phase in order else len(order), phase)


def _arm_first(row: tuple[str, str]) -> tuple[bool, str, tuple[str, str]]:
    """Sort key of signals: by arm, signals without an arm last."""
    arm = row[1].rpartition(".")[0]
    return not arm, arm, row


def _heat_map(cells: Sequence[Cell], columns: Sequence[tuple[str, Cell]], yardstick: str) -> go.Figure | None:
    """Heat map with a row per signal and joint or axis that has a :func:`noticeable` cell; None without such a row."""
    shown = {(cell.signal, cell.index) for cell in cells if noticeable(cell)}
    if not shown:
        return None
    rows = sorted(shown, key=_arm_first)
    names = list(dict.fromkeys(name for name, _ in columns))
    by_position = {(cell.signal, cell.index, name): cell for name, cell in columns}
    grid = [[by_position.get((*row, name)) for name in names] for row in rows]
    drawn = _figure(
        go.Heatmap(
            z=[
                [None if cell is None else round(math.copysign(cell.size, cell.error), 2) for cell in row]
                for row in grid
            ],
            x=[_plain(name) for name in names],
            y=[_plain(f"{signal} {index}") for signal, index in rows],
            text=[["" if cell is None else quantity_text(cell.error, cell.unit) for cell in row] for row in grid],
            hovertemplate=f"%{{y}}<br>%{{x}}<br>%{{z:.1f}} × {yardstick}<br>%{{text}}<extra></extra>",
            zmin=-DARKEST_RATIO,
            zmax=DARKEST_RATIO,
            colorscale=DIVERGING_COLOURS,
            colorbar={"orientation": "h", "thickness": 8, "y": 0, "yanchor": "top", "ypad": 6, "outlinewidth": 0},
            xgap=1,
            ygap=1,
        )
    )
    return drawn.update_layout(
        # Names of columns are vertical where they do not fit side by side.
        height=90 + 20 * len(rows) + 6 * max(len(name) for name in names),
        xaxis={
            "side": "top",
            "fixedrange": True,
            "type": "category",
            "tickfont": {"size": 11},
            "autotickangles": [0, 90],
            "showgrid": False,
        },
        yaxis={"autorange": "reversed", "fixedrange": True, "type": "category", "tickfont": {"size": 11}},
    )


def history_plot(versions: Sequence[VersionError], unit: str) -> go.Figure:
    """Error of every version of a model, with the parameters of its file and held out."""
    numbers = list(range(len(versions)))
    lines: list[tuple[str, list[float | None], str, str]] = [
        ("error, parameters of the file", [entry.error_fit for entry in versions], BLUE, "solid"),
        ("error, held out", [entry.error_held_out for entry in versions], RED, "dash"),
        ("noise alone", [entry.noise_floor for entry in versions], GREEN, "dot"),
    ]
    drawn = _figure(
        [
            go.Scatter(
                x=numbers,
                y=values,
                name=label,
                mode="lines" if dash == "dot" and len(versions) > 1 else "lines+markers",
                line={"color": colour, "dash": dash},
                marker={"size": 9},
                hovertemplate="%{y:.3g}",
            )
            for label, values, colour, dash in lines
            if any(value is not None for value in values)
        ]
    )
    return drawn.update_layout(
        height=360,
        yaxis={"rangemode": "tozero", "title": {"text": _plain(unit)}, "fixedrange": True},
        xaxis={
            "tickvals": numbers,
            "ticktext": [_plain(entry.version.model.name) for entry in versions],
            "range": [-0.3, len(versions) - 0.7],
            "zeroline": False,
            "fixedrange": True,
        },
    )


def rollouts_plot(rollouts: RolloutDocument) -> go.Figure:
    """Error of the end effector over time, and the quadratic growth under a constant torque error."""
    time, error = list(rollouts.time_s), list(rollouts.tool_mm)
    first_row = next(row for row, t in enumerate(time) if t >= rollouts.horizons[0].horizon_s - 1e-9)
    quadratic = [error[first_row] * (t / time[first_row]) ** 2 for t in time[first_row:]]
    drawn = _figure(
        [
            go.Scatter(
                x=time, y=error, name="rollouts, rms over starts", mode="lines", line={"color": BLUE, "width": 2}
            ),
            go.Scatter(
                x=time[first_row:],
                y=quadratic,
                name="growth of a constant torque error, with the square of the time",
                mode="lines",
                line={"color": GREY, "dash": "dash"},
            ),
        ]
    )
    return drawn.update_layout(
        height=320,
        xaxis={"type": "log", "title": {"text": "time after the start [s]"}, "fixedrange": True},
        yaxis={"type": "log", "title": {"text": "tool error [mm]"}, "fixedrange": True},
    ).update_traces(hovertemplate="%{x:.3g} s: %{y:.3g} mm")


def tracks_plot() -> go.Figure:
    """Measured against predicted over time with the residual below it; the page's script fills in the numbers."""
    drawn = _figure(
        [
            go.Scatter(name="measured", mode="lines", line={"color": BLACK, "width": 2}),
            go.Scatter(name="model", mode="lines", line={"color": BLUE, "width": 2, "dash": "dash"}),
            go.Scatter(name="measured − model", mode="lines", line={"color": RED, "width": 2}, yaxis="y2"),
        ]
    )
    return drawn.update_layout(
        height=480,
        shapes=[_vertical(0.0)],
        xaxis={"title": {"text": "time [s]"}, "anchor": "y2", "zeroline": False},
        yaxis={"domain": [0.42, 1.0]},
        yaxis2={"domain": [0.0, 0.36]},
    )


def scatter_plot(sets: Sequence[Track]) -> go.Figure:
    """Measured over predicted numbers, a panel per quantity; the last prediction is on top."""
    groups = list(dict.fromkeys(signal.name.rsplit(" ", 1)[0] for signal in sets[0].curves))
    drawn = _figure()
    gap = 0.12
    width = (1.0 - gap * (len(groups) - 1)) / len(groups)
    for number, group in enumerate(groups):
        suffix = "" if number == 0 else str(number + 1)
        extremes: list[float] = []
        for index, track in enumerate(sets):
            signals = [signal for signal in track.curves if signal.name.rsplit(" ", 1)[0] == group]
            x = np.concatenate([signal.predicted for signal in signals])
            y = np.concatenate([signal.measured for signal in signals])
            names = [
                name for signal in signals for name in [_plain(signal.name.rsplit(" ", 1)[1])] * signal.measured.size
            ]
            extremes += [float(min(x.min(), y.min())), float(max(x.max(), y.max()))]
            on_top = index == len(sets) - 1
            drawn.add_trace(
                go.Scatter(
                    x=x.astype(np.float32),
                    y=y.astype(np.float32),
                    text=[
                        f"{name}, row {row:g}"
                        for name, row in zip(names, np.tile(track.time, len(signals)), strict=True)
                    ],
                    name=_plain(track.label),
                    legendgroup=track.label,
                    showlegend=number == 0 and len(sets) > 1,
                    mode="markers",
                    marker={"color": BLUE if on_top else GREY, "size": 5, "opacity": 0.7},
                    hovertemplate="%{text}: predicted %{x:.3g}, measured %{y:.3g}<extra></extra>",
                    xaxis=f"x{suffix}",
                    yaxis=f"y{suffix}",
                )
            )
        low, high = min(extremes), max(extremes)
        drawn.add_shape(
            type="line", x0=low, y0=low, x1=high, y1=high, xref=f"x{suffix}", yref=f"y{suffix}", layer="below",
            line={"color": ZERO, "width": 1},
        )  # fmt: skip
        unit = _plain(next(signal.unit for signal in sets[0].curves if signal.name.startswith(group)))
        start = number * (width + gap)
        drawn.update_layout(
            {
                f"xaxis{suffix}": {
                    "domain": [start, start + width],
                    "anchor": f"y{suffix}",
                    "title": {"text": f"predicted [{unit}]"},
                },
                f"yaxis{suffix}": {"anchor": f"x{suffix}", "title": {"text": f"{_plain(group)}, measured [{unit}]"}},
            }
        )
    return drawn.update_layout(height=380)


def _vertical(x: float) -> dict[str, Any]:
    line = {"color": ZERO, "width": 1, "dash": "dot"}
    ends = {"x0": x, "x1": x, "y0": 0, "y1": 1, "xref": "x", "yref": "paper"}
    return {"type": "line", "line": line, "layer": "below"} | ends


def _plain(text: str) -> str:
    """A name that Plotly shows as it is; Plotly reads labels as HTML."""
    return html.escape(text, quote=False)
