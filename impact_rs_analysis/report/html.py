"""The interactive report: one HTML file with Plotly inside, which opens anywhere, offline, on a phone as well."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from impact_rs_analysis.measure.analyze import Analysis, ExperimentSet
from impact_rs_analysis.measure.table import Row, result_table
from impact_rs_analysis.report.figures import Figure

HEADINGS = ("B<sub>θ</sub> (nominal)", "B<sub>ρ</sub>", "B = 0")

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; margin: 0 auto; padding: 1rem;
       max-width: 60rem; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: .5rem 0; } h2 { font-size: 1.2rem; margin: 2rem 0 .5rem; }
p { margin: .5rem 0; } .note { color: #555; font-size: .9rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .95rem; }
th, td { padding: .35rem .45rem; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap; }
th { vertical-align: bottom; white-space: normal; font-weight: 600; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0; background: #fff; }
tr.group th { text-align: left; padding-bottom: 0; border: 0; color: #555; font-size: .85rem; }
tr.mean td { font-weight: 600; } td small { color: #666; font-size: .85em; margin-left: .4em; }
td.best { background: #e6f2fa; }
details { border-top: 1px solid #ddd; padding: .25rem 0; } summary { cursor: pointer; padding: .5rem 0;
          font-weight: 600; }
summary span { font-weight: 400; color: #555; }
ul { margin: .3rem 0; padding-left: 1.3rem; } code { font-size: .9em; overflow-wrap: anywhere; }
.plot { width: 100%; }
"""

SCRIPT = """
function draw(details) {
  details.querySelectorAll('.plot').forEach(function (plot) {
    if (!plot.dataset.drawn) {
      plot.dataset.drawn = '1';
      var figure = JSON.parse(document.getElementById(plot.dataset.figure).textContent);
      Plotly.newPlot(plot, figure.data, figure.layout, {responsive: true, displaylogo: false,
        modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d']});
    } else { Plotly.Plots.resize(plot); }
  });
}
document.querySelectorAll('details.set').forEach(function (details) {
  details.addEventListener('toggle', function () { if (details.open) draw(details); });
  if (details.open) draw(details);
});
"""

DASHES = {"solid": "solid", "dashed": "dash", "none": "solid"}


def plotly_figure(figure: Figure) -> go.Figure:
    """The figure for Plotly, from the same description as the PNG."""
    panels = len(figure.panels)
    drawn = go.Figure()
    gap = 0.045
    height = (1.0 - gap * (panels - 1)) / panels
    for number, panel in enumerate(figure.panels, start=1):
        suffix = "" if number == 1 else str(number)
        for curve in panel.curves:
            width = 1 if curve.line == "dashed" else 2
            # Hollow and large: an estimate must not hide the prediction that it agrees with.
            size = 17 if curve.error else 11 if curve.x.size == 1 else 7
            error = None
            if curve.error is not None:
                low, high = curve.error
                error = {"type": "data", "symmetric": False, "array": [high], "arrayminus": [low], "thickness": 2}
            drawn.add_trace(
                go.Scatter(
                    # A curve without points keeps its legend entry only with one invisible point.
                    x=curve.x.astype(np.float32) if curve.x.size else [None],
                    y=curve.y.astype(np.float32) if curve.y.size else [None],
                    name=curve.label,
                    showlegend=bool(curve.label),
                    legendgroup=curve.colour if panels > 1 else None,
                    mode="lines" if curve.line != "none" else "markers",
                    line={
                        "color": curve.colour,
                        "dash": DASHES[curve.line],
                        "width": width,
                    },
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
                    yaxis=f"y{suffix}",
                )
            )
        top = 1.0 - (number - 1) * (height + gap)
        axis: dict[str, Any] = {
            "title": {"text": panel.y_label, "standoff": 6},
            "domain": [max(0.0, top - height), top],
            "gridcolor": "#e6e6e6",
            "zerolinecolor": "#999999",
            "automargin": True,
        }
        if panel.y_range is not None:
            axis["range"] = list(panel.y_range)
        drawn.update_layout({f"yaxis{suffix}": axis})
    for note in figure.notes:
        drawn.add_shape(
            type="line", x0=note.x, x1=note.x, y0=0, y1=1, xref="x", yref="paper",
            line={"color": "#999999", "width": 1, "dash": "dot"}, layer="below",
        )  # fmt: skip
        drawn.add_annotation(
            x=note.x, y=1.0, xref="x", yref="paper", text=note.label, showarrow=False, yanchor="bottom",
            font={"color": "#555555", "size": 12},
        )  # fmt: skip
    drawn.update_layout(
        template="plotly_white",
        height=720 if panels > 1 else 560,
        margin={"l": 10, "r": 10, "t": 58, "b": 10},
        xaxis={
            "title": {"text": figure.x_label, "standoff": 6},
            "range": None if figure.x_range is None else list(figure.x_range),
            "anchor": f"y{panels}" if panels > 1 else "y",
            "gridcolor": "#e6e6e6",
            "zeroline": False,
            "automargin": True,
        },
        # Below the axis title, in rows that wrap where the screen is narrow.
        legend={
            "orientation": "h",
            "yanchor": "top",
            "y": -0.09 if panels > 1 else -0.14,
            "x": 0,
            "xanchor": "left",
            "font": {"size": 13},
        },
        hoverlabel={"namelength": -1},
    )
    return drawn


def _percent(value: float, signed: bool = True) -> str:
    return (f"{value:+.2f}" if signed else f"{value:.2f}").replace("-", "−") + "&nbsp;%"


def _cells(row: Row, with_paper: bool) -> str:
    average = row.estimate is None
    estimate = "–" if row.estimate is None else f"{row.estimate:.3f}"
    if row.half_interval is not None:
        estimate += f"<small>± {row.half_interval:.3f}</small>"
    best = min(row.errors, key=lambda model: abs(row.errors[model]))
    cells = [f"<td>{html.escape(row.label)}</td>", f"<td>{estimate}</td>"]
    for model, error in row.errors.items():
        shade = ' class="best"' if model == best else ""
        cells.append(f"<td{shade}>{_percent(error, row.signed)}</td>")
    if with_paper:
        paper = "–" if row.paper_estimate is None else f"{row.paper_estimate:.3f}"
        cells.append(f"<td>{paper}</td>")
        for model in row.errors:
            cells.append(
                f"<td>{'–' if row.paper_errors is None else _percent(row.paper_errors[model], row.signed)}</td>"
            )
    return f"<tr{' class=mean' if average else ''}>{''.join(cells)}</tr>"


def _table(rows: Sequence[Row]) -> str:
    with_paper = any(row.paper_errors is not None for row in rows)
    names = "".join(f"<th>{text}</th>" for text in HEADINGS)
    columns = f"<th>estimate [m/s]</th>{names}"
    group = '<th colspan="4">this campaign: experimental estimate, errors of the predictions</th>'
    if with_paper:
        columns += columns
        group += '<th colspan="4">published experiment</th>'
    head = f"<tr class=group><th></th>{group}</tr><tr><th></th>{columns}</tr>"
    body = "".join(_cells(row, with_paper) for row in rows)
    return f'<div class="wide"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>'


def _listing(title: str, items: Sequence[str]) -> str:
    if not items:
        return ""
    entries = "".join(f"<li>{item}</li>" for item in items)
    return f"<details><summary>{html.escape(title)} <span>({len(items)})</span></summary><ul>{entries}</ul></details>"


def _left_out(analysis: Analysis) -> str:
    def code(text: str) -> str:
        return f"<code>{html.escape(text)}</code>"

    return (
        _listing(
            "Sets without an estimate",
            [f"{code(f'{s.object} {s.case}')}: {html.escape(s.reason)}" for s in analysis.incomplete],
        )
        + _listing("Trials without impact, not in the fit", [code(name) for name in analysis.no_impact])
        + _listing(
            "Trials in which one arm hit long before another",
            [f"{code(name)}: {1e3 * spread:.0f}&nbsp;ms" for name, spread in analysis.apart],
        )
        + _listing("Bags skipped", [f"{code(s.name)}: {html.escape(s.reason)}" for s in analysis.skipped])
        + _listing("Trials of the manifest that are missing", [code(name) for name in analysis.missing])
    )


def _summary(entry: ExperimentSet) -> str:
    interval = "" if entry.interval is None else f" [{entry.interval[0]:.3f}, {entry.interval[1]:.3f}]"
    return (
        f"{html.escape(entry.label)} <span>— {entry.estimate:.3f}{interval} m/s, "
        f"nominal prediction {_percent(entry.predictions['reduced'].error)}</span>"
    )


def write_html(analysis: Analysis, figures: Sequence[tuple[ExperimentSet, list[Figure]]], path: Path) -> Path:
    """Write the report."""
    sections, data = [], []
    for number, (entry, drawn) in enumerate(figures):
        plots = []
        for figure in drawn:
            document = str(plotly_figure(figure).to_json()).replace("</", "<\\/")
            data.append(f'<script type="application/json" id="{figure.name}">{document}</script>')
            plots.append(f'<div class="plot" data-figure="{figure.name}"></div><p class="note">{figure.caption}</p>')
        is_open = " open" if number == 0 else ""
        sections.append(f'<details class="set"{is_open}><summary>{_summary(entry)}</summary>{"".join(plots)}</details>')
    trials = sum(entry.fit.count for entry in analysis.sets)
    rows = result_table(analysis)
    text = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>impact_rs: {html.escape(analysis.directory.resolve().name)}</title><style>{STYLE}</style></head><body>
<h1>Predicted and measured velocity jumps</h1>
<p>Campaign <code>{html.escape(str(analysis.directory.resolve().name))}</code>: {trials} trials in
{len(analysis.sets)} set{"" if len(analysis.sets) == 1 else "s"}.</p>
<h2>Estimates and prediction errors</h2>
{_table(rows) if rows else "<p>No set has enough trials for an estimate yet.</p>"}
<p class="note">Errors are (prediction − estimate) / estimate; a positive one overestimates the post-impact speed. The
best prediction of a row is shaded. ± is the wider half of the 95&nbsp;% interval. Average error: bias. Absolute error:
mean of the absolute values, the quality of a model.</p>
{_left_out(analysis)}
<h2>Figures</h2>
<p class="note">Tap a set to open it. Figures can be zoomed; a tap on a legend entry hides it.</p>
{"".join(sections)}
{"".join(data)}
<script>{get_plotlyjs()}</script><script>{SCRIPT}</script>
</body></html>
"""
    path.write_text(text, encoding="utf-8")
    return path
