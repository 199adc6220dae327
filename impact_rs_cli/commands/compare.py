"""``impact-rs compare``: where a model fails."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from impact_rs_cli.arguments import add_jobs, add_runs, number, on_local_runs, read, started
from impact_rs_cli.commands.recordings import add_mapping, mapping_of, run_compare
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder

if TYPE_CHECKING:
    from impact_rs_analysis.diagnosis.compare import Comparison
    from impact_rs_analysis.evidence.runs import Runs
    from impact_rs_sim.model import Model
    from impact_rs_trials.workers import Map

TEXT = f"""\
Compare a model with measurements, and show where it fails.

On three levels: the velocity jump of the impact map, free motion, and the whole trial with the model's twin in closed
loop. Differences are given in their units and in multiples of what repeating a trial explains; one score stands for
all. Only measured signals are read.

example:
  {PROGRAM} compare campaigns/blind/runs --model config/models/nominal.yaml -o report
  {PROGRAM} compare campaigns/blind/runs --model model_2.yaml --mcap aligned --json

A recording of a real robot in free motion (a bag with sensor_msgs/JointState, CSV or NPZ) is compared on joint torque:
  {PROGRAM} compare recording.db3 --mapping joint_state

Units: each difference says its own; scores are multiples of what repetition explains."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    add_runs(parser)
    add_mapping(parser)
    parser.add_argument("-o", dest="output", type=Path, metavar="REPORT_DIR", help="folder for an HTML report")
    parser.add_argument(
        "--mcap", type=Path, metavar="DIR", help="folder for aligned bags: measured, predicted and residual signals"
    )
    add_jobs(parser)
    add_json(parser)


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if (mapping := mapping_of(args)) is not None:
        return run_compare(args, mapping, terminal)
    from impact_rs_sim.model import load_model

    model = load_model(args.model)
    with started(args) as map_tasks:
        runs = read(args.runs, map_tasks, terminal)
        comparison = comparison_of(runs, model, map_tasks, terminal)
        if args.output is not None or args.mcap is not None:
            _write(args, runs, model, comparison, map_tasks, terminal)
    terminal.result(comparison.to_json())
    return 0


def comparison_of(runs: Runs, model: Model, map_tasks: Map, terminal: Terminal) -> Comparison:
    """Compare, and show the result."""
    from impact_rs_analysis.diagnosis.compare import compare

    with terminal.stages() as tell:
        comparison = compare(runs, model, map_tasks, tell)
    _show(comparison, terminal)
    return comparison


def _write(
    args: argparse.Namespace, runs: Runs, model: Model, comparison: Comparison, map_tasks: Map, terminal: Terminal
) -> None:
    from impact_rs_analysis.diagnosis.history import history
    from impact_rs_analysis.evidence.aligned import aligned_trials, check_free, write_aligned
    from impact_rs_analysis.report.loop import write_comparison

    if args.mcap is not None:
        check_free(runs, args.mcap)
    aligned = aligned_trials(runs, model, map_tasks)
    if args.mcap is not None:
        with output_folder(args.mcap), terminal.progress("aligned bags") as tell:
            for count, trial in enumerate(aligned, start=1):
                write_aligned(trial, args.mcap)
                tell(count, len(aligned))
        terminal.say(f"aligned bags: {len(aligned)} in {args.mcap.resolve()}")
    if args.output is not None:
        versions = None
        if model.parent is not None:
            with terminal.stages() as stage:
                versions = history(args.model, runs, map_tasks, stage, [comparison])
        with output_folder(args.output):
            path = write_comparison(comparison, aligned, versions, args.output)
        terminal.say(f"report: {path.resolve()}")


def _show(comparison: Comparison, terminal: Terminal) -> None:
    from rich.table import Table

    from impact_rs_analysis.diagnosis.jump import JOINTS

    document = comparison.to_json()
    floor = comparison.noise_floor
    terminal.say(
        f"Model {comparison.model!r} against {len(comparison.runs.trials)} trials in "
        f"{len(comparison.evidence)} conditions: score {number(comparison.score)}"
        + ("" if floor is None else f", repetition alone would give {number(floor)}")
    )
    table = Table(title="How large the differences are [multiples of what repetition explains]")
    table.add_column("level")
    table.add_column("difference", justify="right")
    table.add_column("worst signal")
    for level, content in document["levels"].items():
        rows = content.get("signals") or [row for row in content["entries"] if row["signal"] != JOINTS]
        if not rows:
            continue
        worst = max(rows, key=lambda row: float(row["times_noise"]))
        name = " ".join(filter(None, (worst["signal"], worst.get("index"))))
        table.add_row(
            level.replace("_", " "),
            number(content["times_noise"]),
            f"{name}: {worst['error']:+.3g} {worst['unit']}" if "index" in worst else
            f"{name}: {number(worst['error'])} {worst['unit']} rms",
        )  # fmt: skip
    terminal.say(table)
    places = Table(title="Where it fails (measured minus model)")
    for heading in ("object", "case", "phase", "signal", ""):
        places.add_column(heading)
    places.add_column("error", justify="right")
    places.add_column("x noise", justify="right")
    for cell in comparison.where[:8]:
        places.add_row(
            cell.object, cell.case, cell.phase, cell.signal, cell.index, f"{cell.error:+.3g} {cell.unit}",
            number(cell.times_noise),
        )  # fmt: skip
    terminal.say(places)
    for remark in comparison.remarks:
        terminal.say(f"note: {remark}")
