# SPDX-License-Identifier: Apache-2.0
"""``impact-rs history``: how the error fell from model to model."""

from __future__ import annotations

import argparse

from rich.markup import escape
from rich.table import Table

from impact_rs_analysis.diagnosis.history import VersionError, history, versions
from impact_rs_analysis.evidence.rollouts import RolloutDocument
from impact_rs_analysis.report.error_history import write_history
from impact_rs_cli.arguments import on_local_runs, three_digits
from impact_rs_cli.reading import measured
from impact_rs_cli.terminal import Terminal, output_folder


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    versions(args.model)  # a missing parent is reported before the runs are read
    with measured(args, terminal) as measurements, measurements.progress():
        errors = history(args.model, measurements.uncalibrated, measurements.calibration)
    terminal.result({"history": [entry.to_json() for entry in errors]})
    path = None
    if args.output is not None:
        with output_folder(args.output):
            path = write_history(errors, args.output)
    show_history(errors, terminal)
    if path is not None:
        terminal.say(f"plot: {path.resolve()}")
    return 0


def show_history(errors: list[VersionError], terminal: Terminal) -> None:
    """Show a table with a row per version."""
    table = Table(title=escape(f"Error per model version [{errors[0].unit}]"))
    for heading in ("model", "effect added"):
        table.add_column(heading)
    for heading in ("fit", "held out", "noise"):
        table.add_column(heading, justify="right")
    rollouts_of_versions = [entry.rollouts for entry in errors if entry.rollouts is not None]
    longest = max(rollouts_of_versions, key=lambda rollouts: len(rollouts.horizons), default=None)
    if longest is not None:
        horizons = " / ".join(f"{horizon.horizon_s:g}" for horizon in longest.horizons)
        table.add_column(f"tool after {horizons} s [mm]", justify="right")
    for entry in errors:
        table.add_row(
            entry.version.model.name,
            entry.version.effect_added or "–",
            three_digits(entry.error_fit),
            "–" if entry.error_held_out is None else three_digits(entry.error_held_out),
            "–" if entry.noise_floor is None else three_digits(entry.noise_floor),
            *([_tool_errors(entry.rollouts, len(longest.horizons))] if longest is not None else []),
        )
    terminal.say(table)
    if longest is not None:
        terminal.say(f"tool: error of rollouts in {longest.loop}, rms over measured starts")


def _tool_errors(rollouts: RolloutDocument | None, horizons: int) -> str:
    """Errors of the tool at every horizon of the table."""
    if rollouts is None:
        return "–"
    reached = [three_digits(horizon.tool_mm) for horizon in rollouts.horizons]
    return " / ".join([*reached, *["diverged"] * (horizons - len(reached))])
