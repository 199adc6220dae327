"""The report of an analysis: one HTML file that works offline, and the same figures as PNG."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from impact_rs_analysis.measure.analyze import Analysis
from impact_rs_analysis.report.figures import figures_of
from impact_rs_analysis.report.html import write_html
from impact_rs_analysis.report.png import write_png
from impact_rs_sim.errors import InputError


def write_report(analysis: Analysis, directory: Path, progress: Callable[[int, int], None] | None = None) -> list[Path]:
    """Write ``report.html``, ``analysis.json`` and a PNG per figure; files of an earlier report are replaced.

    Args:
        analysis: What to report.
        directory: Where to; made if it does not exist.
        progress: Told how many of how many files are written.

    Returns:
        The files written, the HTML first.

    Raises:
        InputError: The folder cannot be written.
    """
    figures = [(entry, figures_of(entry)) for entry in analysis.sets]
    total = 2 + sum(len(drawn) for _, drawn in figures)
    written: list[Path] = []

    def note(path: Path) -> None:
        written.append(path)
        if progress is not None:
            progress(len(written), total)

    try:
        directory.mkdir(parents=True, exist_ok=True)
        note(write_html(analysis, figures, directory / "report.html"))
        document = json.dumps(analysis.to_json(), indent=2, allow_nan=False)
        (directory / "analysis.json").write_text(document + "\n", encoding="utf-8")
        note(directory / "analysis.json")
        for _, drawn in figures:
            for figure in drawn:
                note(write_png(figure, directory / f"{figure.name}.png"))
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=directory) from None
    return written
