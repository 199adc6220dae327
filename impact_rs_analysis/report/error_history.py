# SPDX-License-Identifier: Apache-2.0
"""Page of a model's history: its error from version to version."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from impact_rs_analysis.diagnosis.history import VersionError
from impact_rs_analysis.evidence.cluster import TIMES
from impact_rs_analysis.report.labels import RELEVANCE_LIMIT, REPEATABILITY
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.page_names import HISTORY_DATA, HISTORY_PAGE
from impact_rs_analysis.report.plots import history_plot


@dataclass(frozen=True)
class HistoryPart:
    """Errors of the versions of a model.

    Attributes:
        versions: From the first to the last.
        yardstick: Unit of the errors, in words.
        plot: Errors over versions.
    """

    versions: tuple[VersionError, ...]
    yardstick: str
    plot: Plot


@dataclass(frozen=True)
class HistoryPage:
    """Contents of ``history.html.j2``."""

    title: str
    history: HistoryPart


def write_history(versions: Sequence[VersionError], directory: Path) -> Path:
    """Write ``history.html`` and ``history.json``.

    Args:
        versions: From the first model to the last.
        directory: Folder of the report.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    page = HistoryPage("Error by model version", history_part(versions))
    data = json.dumps({"history": [entry.to_json() for entry in versions]}, indent=2, allow_nan=False) + "\n"
    return write_files(directory, {HISTORY_PAGE: render("history.html.j2", page), HISTORY_DATA: data})[0]


def history_part(versions: Sequence[VersionError]) -> HistoryPart:
    """The part of a page that shows a history."""
    repeated = all(entry.noise_floor is not None for entry in versions)
    yardstick = REPEATABILITY if repeated else RELEVANCE_LIMIT
    unit = f"times {yardstick}"
    if versions and versions[0].unit != TIMES:
        yardstick, unit = f"1 {versions[0].unit}", f"error [{versions[0].unit}]"
    return HistoryPart(tuple(versions), yardstick, Plot("history", history_plot(versions, unit)))
