# SPDX-License-Identifier: Apache-2.0
"""Figures as PNG by Matplotlib, without a browser."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from impact_rs_analysis.report.figures import Curve, Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINES = {"solid": "-", "dashed": "--", "none": ""}
MARKERS = {"": None, "circle": "o", "square": "s", "diamond": "D", "triangle-up": "^"}
FONT = {"font.family": "DejaVu Sans"}


def _text(text: str) -> str:
    """HTML subscripts as Matplotlib's mathtext."""
    return re.sub(r"<sub>(.*?)</sub>", r"$_{\\mathrm{\1}}$", text)


def write_png(figure: Figure, path: Path) -> Path:
    """Draw a figure, 150 dots per inch."""
    # Imported here, because Matplotlib takes half a second to load.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    panels = len(figure.panels)
    canvas = Canvas(figsize=(7.2, 2.3 * panels + 1.2 if panels > 1 else 5.2), layout="constrained")
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(panels, 1, sharex=True, squeeze=False)[:, 0]
    for panel, axis in zip(figure.panels, axes, strict=True):
        axis.axhline(0.0, color="#999999", linewidth=0.8, zorder=0)
        for curve in panel.curves:
            _draw(axis, curve)
        axis.set_ylabel(_text(panel.y_label))
        axis.grid(True, color="#e6e6e6", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
        for note in figure.notes:
            axis.axvline(note.x, color="#999999", linewidth=0.8, linestyle=":", zorder=0)
        if panel.y_range is not None:
            axis.set_ylim(*panel.y_range)
    for note in figure.notes:
        axes[0].annotate(
            _text(note.label), (note.x, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 3),
            textcoords="offset points", ha="center", va="bottom", fontsize=9, color="#555555",
        )  # fmt: skip
    if figure.x_range is not None:
        axes[-1].set_xlim(*figure.x_range)
    axes[-1].set_xlabel(_text(figure.x_label))
    canvas.suptitle(_text(figure.title), fontsize=11)
    handles, labels = axes[0].get_legend_handles_labels()
    columns = 3 if panels > 1 else 2
    canvas.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize=8.5)
    canvas.savefig(path, dpi=150, format="png")
    return path


def _draw(axis: Axes, curve: Curve) -> None:
    label = _text(curve.label) if curve.label else "_nolegend_"
    large = curve.x.size == 1
    if curve.error is not None:
        axis.errorbar(
            curve.x, curve.y, xerr=[[curve.error[0]], [curve.error[1]]], color=curve.colour, linestyle="",
            marker=MARKERS[curve.marker], markersize=13, markerfacecolor="none", markeredgewidth=1.8,
            capsize=5, elinewidth=2, label=label, zorder=4,
        )  # fmt: skip
        return
    axis.plot(
        curve.x, curve.y, color=curve.colour, linestyle=LINES[curve.line], marker=MARKERS[curve.marker],
        markersize=8 if large else 4.5, linewidth=1.0 if curve.line == "dashed" else 1.4,
        alpha=0.8 if curve.line == "dashed" else 1.0, label=label, zorder=3 if large else 2,
    )  # fmt: skip
