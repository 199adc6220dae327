# SPDX-License-Identifier: Apache-2.0
"""``impact-rs compare``: where a model fails."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from impact_rs_analysis.application.loop_steps import compare_measurements, report_comparison
from impact_rs_analysis.application.measurements import Measurements
from impact_rs_analysis.diagnosis.agreement import AgreementDocument
from impact_rs_analysis.diagnosis.compare import ComparisonDocument
from impact_rs_analysis.diagnosis.document import TIMES
from impact_rs_analysis.diagnosis.jump import JOINT_VELOCITY_JUMP
from impact_rs_analysis.evidence.aligned_bags import check_free, write_aligned
from impact_rs_analysis.evidence.cluster import SCALE
from impact_rs_analysis.evidence.tracks import track_of_run
from impact_rs_analysis.report.comparison import yardstick_of, yardstick_of_residuals
from impact_rs_cli.arguments import on_local_runs, three_digits
from impact_rs_cli.reading import measured, only_trials
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.robots.robot import joined_units

MAX_SHOWN_CONDITIONS = 8


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    model = load_model(args.model)
    with measured(args, terminal) as measurements:
        if args.mcap is not None:
            check_free(only_trials(measurements, "--mcap"), args.mcap)
        document = comparison_of(measurements, model, terminal)
        if args.mcap is not None:
            _write_bags(args.mcap, measurements, measurements.calibration.of(model), terminal)
        if args.output is not None:
            with output_folder(args.output):
                path = report_comparison(document, measurements, args.model, model, args.output)
            terminal.say(f"report: {path.resolve()}")
    terminal.result(document.model_dump(mode="json"))
    return 0


def comparison_of(measurements: Measurements, model: Model, terminal: Terminal) -> ComparisonDocument:
    """Compare, and show the result."""
    document = compare_measurements(measurements, model)
    _show(document, terminal)
    return document


def _write_bags(directory: Path, measurements: Measurements, model: Model, terminal: Terminal) -> None:
    runs = only_trials(measurements, "--mcap")
    with output_folder(directory), terminal.progress("aligned bags") as report_progress:
        for count, (condition, group) in enumerate(runs.conditions.items(), start=1):
            write_aligned(track_of_run(group[0], model), condition, directory)
            report_progress(count, len(runs.conditions))
    terminal.say(f"aligned bags: {len(runs.conditions)} in {directory.resolve()}")


def _show(document: ComparisonDocument, terminal: Terminal) -> None:
    floor = document.noise_floor
    noise = "" if floor is None else f" (noise: {three_digits(floor)})"
    of_trials = document.source == "trials"
    source = document.source.removesuffix("s") if document.trials == 1 else document.source
    where = (
        f" in {len(document.conditions)} condition{'' if len(document.conditions) == 1 else 's'}" if of_trials else ""
    )
    unit = f" {document.score_unit}"
    if of_trials or document.score_unit == TIMES:
        unit = "" if floor is not None else f" times {SCALE}"
    terminal.say(
        f"Model {document.model.name!r} against {document.trials} {source}{where}: "
        f"score {three_digits(document.score)}{unit}{noise}"
    )
    if len(document.arms) > 1:
        terminal.say(f"arms: {'; '.join(arm.title for arm in document.arms)}")
    if (facts := document.recording) is not None:
        terminal.say(
            f"{facts.samples} samples at {three_digits(facts.sampled_Hz)} Hz, {three_digits(facts.used_s)} s used, "
            f"{facts.robot}, {facts.end_effector_mass_kg:g} kg on the flange; low-pass {facts.low_pass_Hz:g} Hz"
        )
        _show_joints(document, terminal)
    else:
        _show_levels(document, terminal)
    _show_agreement(document.agreement, yardstick_of(document), terminal)
    if document.rollouts is not None:
        terminal.say(document.rollouts.in_words)
    for remark in document.remarks:
        terminal.say(f"note: {remark}")
    if document.not_measured:
        terminal.say(f"not measured: {', '.join(document.not_measured)}")


def _show_agreement(agreement: AgreementDocument, yardstick: str, terminal: Terminal) -> None:
    """Relations between readings, joint by joint; those that fail are marked."""
    if not agreement.relations:
        return
    table = Table(
        title=escape(f"Which readings agree [times {yardstick}]"),
        caption="≠: the relation fails; large without ≠: within its discrepancy, or below its relevance limit",
    )
    table.add_column("")
    for name in agreement.names:
        table.add_column(name, justify="right")
    for joint, relations in agreement.by_joint.items():
        cells = [relations.get(name) for name in agreement.names]
        table.add_row(
            joint,
            *(
                "" if relation is None else f"{'' if relation.agrees else '≠ '}{three_digits(relation.times_noise)}"
                for relation in cells
            ),
        )
    terminal.say(table)
    for name in agreement.names:
        terminal.say(f"  {name}: between {', '.join(agreement.readings_of(name))}")
    for relation in agreement.in_common:
        terminal.say(f"  {relation.in_words}")


def _show_joints(document: ComparisonDocument, terminal: Terminal) -> None:
    table = Table(title="Torque that the model does not explain")
    rows = document.levels["recording"].signals
    unit = joined_units(row.unit for row in rows)
    for heading in ("joint", f"rms [{unit}]", f"mean [{unit}]", f"noise [{unit}]"):
        table.add_column(heading, justify="left" if heading == "joint" else "right")
    for row in rows:
        table.add_row(row.index, three_digits(row.error), f"{row.mean or 0.0:+.3g}", three_digits(row.noise_floor))
    terminal.say(table)
    for cell in document.where[:4]:
        terminal.say(f"  {100 * cell.share:.0f} %: {cell.index} {cell.phase}, mean {cell.error:+.3g} {cell.unit}")


def _show_levels(document: ComparisonDocument, terminal: Terminal) -> None:
    yardstick = yardstick_of(document)
    table = Table(title=escape(f"How large the differences are [times {yardstick}]"))
    table.add_column("level")
    table.add_column("difference", justify="right")
    table.add_column("worst signal")
    for name, level in document.levels.items():
        if level.signals:
            row = max(level.signals, key=lambda row: row.size)
            worst = f"{row.arm + ', ' if row.arm else ''}{row.signal}: {three_digits(row.error)} {row.unit} rms"
            worst += ", below its relevance limit" if row.error < row.floor else ""
        elif entries := [entry for entry in level.entries if entry.signal != JOINT_VELOCITY_JUMP]:
            entry = max(entries, key=lambda entry: entry.times_noise)
            worst = f"{entry.signal} {entry.index}: {entry.error:+.3g} {entry.unit}"
        else:
            continue
        table.add_row(name.replace("_", " "), three_digits(level.times_noise), worst)
    terminal.say(table)
    shared = document.source == "impacts" and document.noise_floor is None
    size = "" if shared else f"; size: times {yardstick_of_residuals(document)}"
    failures = Table(title=escape(f"Where it fails (measured minus model{size})"))
    for heading in ("object", "case", "phase", "signal"):
        failures.add_column(heading)
    failures.add_column("", no_wrap=True)  # of two arms it begins with the arm's name
    failures.add_column("error", justify="right")
    shown = [cell for cell in document.where if cell.matters][:MAX_SHOWN_CONDITIONS]
    if not shown:
        terminal.say("all residuals are below their relevance limits")
        return
    failures.add_column("share" if shared else "size", justify="right")
    for cell in shown:
        error = f"{cell.error:+.3g} {cell.unit}"
        size = f"{100 * cell.share:.0f} %" if shared else three_digits(cell.size)
        failures.add_row(cell.object, cell.case, cell.phase, cell.signal, cell.index, error, size)
    terminal.say(failures)
