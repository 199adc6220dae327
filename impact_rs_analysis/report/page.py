# SPDX-License-Identifier: Apache-2.0
"""Skeleton of all reports: a page that works offline and on a phone, with a data file.

A report is a frozen dataclass with its content, and a template; templates escape all text. Figures and tracks are
embedded as JSON and drawn when they first become visible.
"""

from __future__ import annotations

import base64
import functools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup, escape
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.thresholds import MIN_REPORTED_P
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_sim.files import whole_folder
from impact_rs_sim.numbers import estimate_in_line, speed_text
from impact_rs_sim.robots.robot import Array

TEMPLATES = Path(__file__).with_name("templates")
BUNDLE = Path(__file__).with_name("bundle")
PLOTLY = BUNDLE / "plotly-cartesian.min.js"
STYLE = TEMPLATES / "page.css"
PALETTE = TEMPLATES / "palette.css"  # colours of pages and workbench
MAX_CURVE_POINTS = 500  # per curve over time; a screen resolves no more
MAX_TRACK_NUMBERS = 90_000  # in all tracks of a page, 0.5 MB
PREFIXED_UNITS = ("m", "rad")  # small values of these units have a prefix
NAME_AT_START = re.compile(r"[a-z]\S*[\d_.]\w*[:,;.]*(\s|$)")  # a first word as log_1.json, joint1: or base_tilt


@dataclass(frozen=True)
class Plot:
    """A figure of a page.

    Attributes:
        name: Its name, unique in the page.
        figure: The figure.
        caption: Explanation below it, with ``<sub>``; empty: none.
        title: Heading above it; empty: none.
        zoom: Whether it can be zoomed and saved.
        run: Index of the 3D run whose time is its x axis; None: no run.
    """

    name: str
    figure: go.Figure
    caption: str = ""
    title: str = ""
    zoom: bool = False
    run: int | None = None


def render(template: str, content: Any, replay: bool = False) -> str:
    """A page as HTML.

    Args:
        template: Name of its template.
        content: Variable ``page`` of the template; has a ``title``.
        replay: Whether the page has a 3D view.
    """
    scripts = [PLOTLY]
    if replay:
        scripts += [BUNDLE / "three.min.js", TEMPLATES / "replay.js"]
    return _environment().get_template(template).render(page=content, libraries=[script_of(path) for path in scripts])


def script_of(path: Path) -> Markup:
    """Content of a JavaScript file, for a page."""
    return Markup(path.read_text(encoding="utf-8"))


def write_files(directory: Path, files: Mapping[str, str]) -> list[Path]:
    """Write text files atomically, all or none; earlier ones are replaced.

    Args:
        directory: Output folder; made if missing.
        files: Contents by name.

    Raises:
        InputError: They cannot be written.
    """
    with whole_folder(directory) as aside:
        for name, text in files.items():
            (aside / name).write_text(text, encoding="utf-8")
    return [directory / name for name in files]


def track_data(tracks: Sequence[Track]) -> list[dict[str, Any]]:
    """Tracks as the page's script reads them: thinned out, with the gaps between windows, as base64 float32."""
    columns = sum(1 + 2 * len(track.curves) for track in tracks)
    most = min(MAX_CURVE_POINTS, MAX_TRACK_NUMBERS // max(columns, 1))
    sets = []
    for track in tracks:
        rows = np.arange(0, track.time.size, max(1, math.ceil(track.time.size / most)))
        breaks = np.searchsorted(rows, track.starts[1:])
        sets.append(
            {
                "label": track.label,
                "impact": track.impact,
                "time": packed(_broken(track.time[rows], breaks)),
                "signals": [
                    {
                        "name": curve.name,
                        "unit": unit_text(curve.unit),
                        "measured": packed(_broken(curve.measured[rows], breaks)),
                        "predicted": packed(_broken(curve.predicted[rows], breaks)),
                    }
                    for curve in track.curves
                ],
            }
        )
    return sets


def _broken(values: Array, breaks: NDArray[np.intp]) -> Array:
    """Values with a NaN before every row of ``breaks``, which interrupts the line."""
    return np.insert(values.astype(float), breaks, np.nan)


def packed(values: Array) -> str:
    """Numbers as base64 of little-endian float32, row by row, as the page's scripts read them."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def number_text(value: float | None, digits: int = 3) -> str:
    """A number as text."""
    return "–" if value is None else _minus(f"{value:.{digits}g}")


def percent_text(value: float, digits: int = 0, signed: bool = False) -> str:
    """Percent as text; the value is in percent."""
    return _minus(f"{value:{'+' if signed else ''}.{digits}f}\N{NO-BREAK SPACE}%")


def p_text(value: float | None, equals: bool = False) -> str:
    """A p-value as text, not below ``MIN_REPORTED_P``; with ``equals`` as in ``p = 0.3``."""
    if value is None:
        return "–"
    if value <= MIN_REPORTED_P:
        return f"<\N{NO-BREAK SPACE}{MIN_REPORTED_P:g}"
    return f"=\N{NO-BREAK SPACE}{value:.2g}" if equals else f"{value:.2g}"


def unit_text(unit: str) -> str:
    """A unit as text; empty for numbers without unit."""
    return "" if unit == "-" else unit.replace("^2", "²")


def quantity_text(value: float, unit: str) -> str:
    """A number with its unit; small lengths and angles with the prefix milli or micro."""
    prefix, size = "", abs(value)
    if unit.partition("/")[0] in PREFIXED_UNITS and 0.0 < size < 0.1:
        prefix, value = ("m", 1e3 * value) if size >= 1e-4 else ("µ", 1e6 * value)
    return f"{number_text(value, 2)}\N{NO-BREAK SPACE}{prefix}{unit_text(unit)}".rstrip()


def sentence_text(text: str) -> str:
    """Text with one full stop and an initial capital, unless it begins with the name of a file, joint or effect."""
    first = text[:1] if NAME_AT_START.match(text) else text[:1].upper()
    return f"{first}{text[1:].rstrip('.')}." if text else ""


def subscripts_text(text: str) -> Markup:
    """Text of a figure, whose only markup is ``<sub>``."""
    safe = str(escape(text))
    return Markup(safe.replace("&lt;sub&gt;", "<sub>").replace("&lt;/sub&gt;", "</sub>"))


def figure_json(figure: go.Figure) -> Markup:
    """A figure as JSON that cannot leave its script element."""
    return htmlsafe_json_dumps(figure, dumps=lambda drawn: str(drawn.to_json()))


def _minus(text: str) -> str:
    return text.replace("-", "−")


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters |= {
        "estimate": lambda value: _minus(estimate_in_line(value.estimate, value.ci95)),
        "interval": lambda value, ends, least=0: _minus(estimate_in_line(value, ends, least)),
        "speed": speed_text,
        "figure_json": figure_json,
        "number": number_text,
        "p_value": p_text,
        "percent": percent_text,
        "quantity": quantity_text,
        "sentence": sentence_text,
        "subscripts": subscripts_text,
        "unit": unit_text,
    }
    return environment
