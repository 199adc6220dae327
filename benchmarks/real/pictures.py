# SPDX-License-Identifier: Apache-2.0
"""Pictures of the board: velocities after impacts, measured over predicted, without and with the effects found."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from impact_rs_analysis.diagnosis.diagnose import added_of
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_analysis.report.figures import BLUE
from impact_rs_analysis.report.plots import GREY
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table


def tracks_of(table: Path, document: DiagnosisDocument) -> tuple[Track, ...]:
    """Velocities of a table of impacts beside those of the model, and of the model with the effects of its diagnosis.

    Args:
        table: The table.
        document: Its diagnosis.

    Raises:
        InputError: The table cannot be read.
    """
    source = ImpactTableSource(read_impact_table(table), load_model("nominal"), remarks=False)
    return source.tracks(map, added_of(document, source))


def draw(tracks: tuple[Track, ...], path: Path) -> Path:
    """A PNG with a panel per quantity: a point per component of every row, grey without and blue with the effects.

    Args:
        tracks: The same measurements beside several predictions; the last is on top.
        path: File to write.
    """
    # Imported here, because Matplotlib takes half a second to load.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    groups: dict[str, str] = {}
    for signal in tracks[0].curves:
        groups.setdefault(signal.name.rsplit(" ", 1)[0], signal.unit)
    canvas = Figure(figsize=(4.6 * len(groups) + 1.6, 3.9), layout="constrained")
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(1, len(groups), squeeze=False)[0]
    for (group, unit), axis in zip(groups.items(), axes, strict=True):
        for track in tracks:
            signals = [signal for signal in track.curves if signal.name.rsplit(" ", 1)[0] == group]
            x, y = (np.concatenate([getattr(signal, name) for signal in signals]) for name in ("predicted", "measured"))
            colour = BLUE if track is tracks[-1] else GREY
            axis.plot(x, y, linestyle="", marker="o", markersize=3, alpha=0.7, color=colour, label=track.label)
            axis.axline((0.0, 0.0), slope=1.0, color="#999999", linewidth=0.8, zorder=0)
        axis.set_xlabel(f"predicted [{unit}]")
        axis.set_ylabel(f"{group}, measured [{unit}]")
        axis.grid(visible=True, color="#e6e6e6", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    handles, labels = axes[0].get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside lower center", ncols=len(tracks), frameon=False, fontsize=8.5)
    canvas.savefig(path, dpi=110, format="png")
    return path
