"""A page of a report: one HTML file with Plotly inside, which works offline and on a phone."""

from __future__ import annotations

import html
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from plotly.offline import get_plotlyjs

from impact_rs_analysis.report.figures import BLUE, RED
from impact_rs_analysis.report.html import STYLE
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array

MORE_STYLE = """
.answer { font-size: 1.15rem; border-left: 4px solid #0072B2; padding: .4rem .8rem; background: #f3f8fc; }
.answer b { overflow-wrap: anywhere; }
.tag { white-space: nowrap; border-radius: .6rem; padding: .1rem .5rem; font-size: .85em; background: #eee; }
.tag.good { background: #d9f0e6; } .tag.maybe { background: #fdf0d0; } .tag.no { background: #eee; color: #555; }
select { font: inherit; padding: .35rem; max-width: 100%; margin: .2rem .6rem .2rem 0; }
td.text { white-space: normal; text-align: left; min-width: 9rem; } th.text { text-align: left; }
td.values { text-align: left; font-size: .9em; }
"""
PLOTLY = {"responsive": True, "displaylogo": False, "modeBarButtonsToRemove": ["select2d", "lasso2d", "autoScale2d"]}
MOST_POINTS = 500
SCRIPT = """
var CONFIG = %(config)s;
function read(id) { return JSON.parse(document.getElementById(id).textContent); }
document.querySelectorAll('.plot[data-figure]').forEach(function (plot) {
  var figure = read(plot.dataset.figure);
  Plotly.newPlot(plot, figure.data, figure.layout, {responsive: true, displayModeBar: false});
});
(function () {
  var trial = document.getElementById('trial'), signal = document.getElementById('signal');
  if (!trial) return;
  var data = read('tracks'), plot = document.getElementById('tracks-plot'), last = null;
  function fill() {
    var names = data[trial.value].signals;
    last = signal.value || last;
    signal.innerHTML = '';
    names.forEach(function (entry, number) {
      var option = document.createElement('option');
      option.value = number; option.textContent = entry.name; signal.appendChild(option);
    });
    if (last !== null && last < names.length) signal.value = last;
  }
  function draw() {
    var set = data[trial.value], entry = set.signals[signal.value], t = set.time;
    var rest = entry.measured.map(function (value, i) { return value - entry.predicted[i]; });
    var lines = (set.impact === null ? [] : [{type: 'line', x0: set.impact, x1: set.impact, y0: 0, y1: 1, xref: 'x',
      yref: 'paper', line: {color: '#999', width: 1, dash: 'dot'}}]);
    Plotly.react(plot, [
      {x: t, y: entry.measured, name: 'measured', mode: 'lines', line: {color: '#000', width: 2}},
      {x: t, y: entry.predicted, name: 'model', mode: 'lines', line: {color: '%(blue)s', width: 2, dash: 'dash'}},
      {x: t, y: rest, name: 'measured \\u2212 model', mode: 'lines', line: {color: '%(red)s', width: 2}, yaxis: 'y2'}
    ], {template: 'plotly_white', height: 460, margin: {l: 10, r: 10, t: 20, b: 10}, shapes: lines,
      xaxis: {title: {text: 'time [s]', standoff: 6}, anchor: 'y2', automargin: true, gridcolor: '#e6e6e6',
              zeroline: false},
      yaxis: {domain: [0.4, 1], automargin: true, gridcolor: '#e6e6e6', zerolinecolor: '#999',
              title: {text: entry.unit, standoff: 6}},
      yaxis2: {domain: [0, 0.34], automargin: true, gridcolor: '#e6e6e6', zerolinecolor: '#999',
               title: {text: 'residual', standoff: 6}},
      legend: {orientation: 'h', y: -0.2, yanchor: 'top', x: 0}}, CONFIG);
  }
  trial.addEventListener('change', function () { fill(); draw(); });
  signal.addEventListener('change', draw);
  fill(); draw();
})();
"""


class Page:
    """An HTML page in the making."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._body: list[str] = []
        self._data: list[str] = []

    def add(self, text: str) -> None:
        """Append HTML."""
        self._body.append(text)

    def data(self, name: str, content: Any) -> None:
        """Lay JSON beside the page, for its script."""
        text = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
        self._data.append(f'<script type="application/json" id="{name}">{text}</script>')

    def figure(self, name: str, data: list[dict[str, Any]], layout: dict[str, Any]) -> None:
        """Append a Plotly figure."""
        base: dict[str, Any] = {"template": "plotly_white", "margin": {"l": 10, "r": 10, "t": 26, "b": 10}}
        self.data(name, {"data": data, "layout": base | layout})
        self.add(f'<div class="plot" data-figure="{name}"></div>')

    def remarks(self, remarks: Sequence[str]) -> None:
        """Append what a reader should know, as a list."""
        if remarks:
            self.add("<ul>" + "".join(f"<li>{html.escape(remark)}</li>" for remark in remarks) + "</ul>")

    def tracks(self, note: str, labels: Sequence[str], sets: list[dict[str, Any]]) -> None:
        """Append measured against predicted over time, with the residual under it; set and signal can be chosen.

        Args:
            note: What is shown.
            labels: One per set.
            sets: ``time``, ``impact`` (or None) and ``signals`` with ``name``, ``unit``, ``measured``, ``predicted``.
        """
        options = "".join(f'<option value="{i}">{html.escape(label)}</option>' for i, label in enumerate(labels))
        self.data("tracks", sets)
        self.add(
            f"<h2>Measured and predicted over time</h2><p class=note>{html.escape(note)}</p>"
            f'<select id="trial" aria-label="what is shown">{options}</select>'
            '<select id="signal" aria-label="signal"></select><div class="plot" id="tracks-plot"></div>'
        )

    def write(self, directory: Path, name: str, document: dict[str, Any]) -> Path:
        """Write ``NAME.html`` and ``NAME.json``.

        Raises:
            InputError: They cannot be written.
        """
        script = SCRIPT % {"config": json.dumps(PLOTLY), "blue": BLUE, "red": RED}
        text = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>impact_rs: {html.escape(self._title)}</title><style>{STYLE}{MORE_STYLE}</style></head><body>
<h1>{html.escape(self._title)}</h1>
{"".join(self._body)}
{"".join(self._data)}
<script>{get_plotlyjs()}</script><script>{script}</script>
</body></html>
"""
        path = directory / f"{name}.html"
        files = {path: text, directory / f"{name}.json": json.dumps(document, indent=2, allow_nan=False) + "\n"}
        try:
            directory.mkdir(parents=True, exist_ok=True)
            for file, content in files.items():
                temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
                temporary.write_text(content, encoding="utf-8")
                temporary.replace(file)
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=directory) from None
        return path


def number(value: float | None, digits: int = 3) -> str:
    """A number for people."""
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def p_text(value: float) -> str:
    """A p value with its sign of comparison."""
    return "&lt; 10⁻⁶" if value < 1e-6 else f"= {value:.2g}"


def short(values: Array) -> list[float]:
    """Five digits, for plots."""
    return [float(f"{value:.5g}") for value in values]
