# SPDX-License-Identifier: Apache-2.0
"""``impact-rs history``: how the error fell from model to model."""

from __future__ import annotations

import argparse

from rich.markup import escape
from rich.table import Table

from impact_rs_analysis.diagnosis.history import VersionError, history, versions
from impact_rs_analysis.evidence.rollouts import RolloutDocument
from impact_rs_analysis.report.error_history import write_history
from impact_rs_cli.arguments import number, on_local_runs
from impact_rs_cli.reading import measured
from impact_rs_cli.terminal import Terminal, output_folder


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    versions(args.model)  # a missing parent is reported before the runs are read
    with measured(args, terminal) as measurements, measurements.progress():
        found = history(args.model, measurements.uncalibrated, measurements.calibration)
    terminal.result({"history": [entry.to_json() for entry in found]})
    path = None
    if args.output is not None:
        with output_folder(args.output):
            path = write_history(found, args.output)
    show_history(found, terminal)
    if path is not None:
        terminal.say(f"plot: {path.resolve()}")
    return 0


def show_history(found: list[VersionError], terminal: Terminal) -> None:
    """The table."""
    table = Table(title=escape(f"Error per model version [{found[0].unit}]"))
    for heading in ("model", "effect added"):
        table.add_column(heading)
    for heading in ("fit", "held out", "noise"):
        table.add_column(heading, justify="right")
    every = [entry.rollouts for entry in found if entry.rollouts is not None]
    rolled = max(every, key=lambda rollouts: len(rollouts.horizons), default=None)
    if rolled is not None:
        horizons = " / ".join(f"{one.horizon_s:g}" for one in rolled.horizons)
        table.add_column(f"tool after {horizons} s [mm]", justify="right")
    for entry in found:
        table.add_row(
            entry.version.model.name,
            entry.version.effect_added or "–",
            number(entry.error_fit),
            "–" if entry.error_held_out is None else number(entry.error_held_out),
            "–" if entry.noise_floor is None else number(entry.noise_floor),
            *([_tool_errors(entry.rollouts, len(rolled.horizons))] if rolled is not None else []),
        )
    terminal.say(table)
    if rolled is not None:
        terminal.say(f"tool: error of rollouts in {rolled.loop}, rms over measured starts")


def _tool_errors(rollouts: RolloutDocument | None, horizons: int) -> str:
    """Errors of the tool at every horizon of the table."""
    if rollouts is None:
        return "–"
    reached = [number(one.tool_mm) for one in rollouts.horizons]
    return " / ".join([*reached, *["diverged"] * (horizons - len(reached))])
