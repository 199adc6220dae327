# SPDX-License-Identifier: Apache-2.0
"""``impact-rs analyze``: experimental estimates, prediction errors and the report."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.table import Table
from rich.text import Text

from impact_rs_analysis.application.measurements import read_laboratory
from impact_rs_analysis.measure.analyze import Analysis, ArmSet, analyze_campaign
from impact_rs_analysis.measure.arms import assumptions
from impact_rs_analysis.measure.far import far_words
from impact_rs_analysis.measure.table import Row, result_table, shown_contacts
from impact_rs_analysis.measure.velocity_jumps import jumps_of
from impact_rs_analysis.report import write_report
from impact_rs_analysis.report.analysis import arm_rows, sensitivity_rows
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.reading import experiment_file
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.numbers import speed_text
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_trials.bags.checksums import unsealed_words
from impact_rs_trials.campaign import MANIFEST
from impact_rs_trials.store import is_url, local_copy
from impact_rs_trials.workers import Map


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if not is_url(args.directory):
        args.experiment = experiment_file(args.experiment, Path(args.directory), terminal)
    if args.experiment is not None:
        return _laboratory(args, terminal)
    if is_url(args.directory) and args.output is None:
        raise InputError("expected a folder for the report: -o REPORT_DIR", file=args.directory)
    with local_copy(args.directory, (MANIFEST,)) as directory, started_workers(args) as map_tasks:
        return report_on(directory, args.output, terminal, args.contact, map_tasks)[0]


def _laboratory(args: argparse.Namespace, terminal: Terminal) -> int:
    """Compare measured with predicted jumps of runs recorded with another controller."""
    if args.output is not None:
        raise InputError(
            "-o is for trials of impact_rs; for other runs use --json, or impact-rs compare -o for a report"
        )
    with started_workers(args) as map_tasks:
        runs = read_laboratory(Path(args.directory), args.experiment, map_tasks, terminal)
    with terminal.progress("impact maps"):
        jumps = jumps_of(runs, args.contact)
    table = Table(
        title=f"Speed after the impact along its direction, and errors of the predictions, {args.contact} contact [%]"
    )
    table.add_column("", no_wrap=True)
    for heading in ("runs", "before [m/s]", "after [m/s]", "B_θ", "B_ρ", "B = 0"):
        table.add_column(heading, justify="right")
    for jump in jumps.jumps:
        half = None if jump.interval is None else (jump.interval[1] - jump.interval[0]) / 2.0
        errors = [f"{jump.errors[name]:+.2f}" for name in MOTOR_INERTIA_MODELS]
        after = " ± ".join(speed_text(jump.after, half))
        table.add_row(jump.condition, str(jump.runs), f"{jump.before:.3f}", after, *errors)
    table.add_section()
    table.add_row("mean absolute", "", "", "", *(f"{jumps.errors[name]:.2f}" for name in MOTOR_INERTIA_MODELS))
    terminal.say(table)
    for remark in jumps.remarks:
        terminal.say(f"note: {remark}")
    if warning := far_words(jumps.compared):
        terminal.warn(warning)
    terminal.result(jumps.to_json())
    return 0


def report_on(
    directory: Path, output: Path | None, terminal: Terminal, contact: str = "first", map_tasks: Map = map
) -> tuple[int, Path]:
    """Analyse, write the report and show the table; exit code and path of the report."""
    with terminal.progress("reading bags") as report_progress:
        analysis = analyze_campaign(directory, report_progress, map_tasks)
    report = publish(analysis, output or directory / "report", terminal, contact)
    if not analysis.sets:
        terminal.warn(f"no estimate for any set{_first_reason(analysis)}")
    return (0 if analysis.sets else 1), report


def _first_reason(analysis: Analysis) -> str:
    """Why the first set has no estimate; the lines above give all reasons."""
    if not analysis.incomplete:
        return ": no usable trial"
    first = analysis.incomplete[0]
    return f"; {first.object} {first.case}: {first.reason}"


def publish(analysis: Analysis, directory: Path, terminal: Terminal, contact: str = "first") -> Path:
    """Write the report, with figures of one contact, and show what is in it; returns its page."""
    with output_folder(directory) as folder, terminal.progress("report") as report_progress:
        report = write_report(analysis, folder, report_progress, contact)[0]
    terminal.result(analysis.to_json())
    _show(analysis, terminal)
    terminal.say(f"report: {report.resolve()}")
    return report


def _show(analysis: Analysis, terminal: Terminal) -> None:
    """Show the table of each contact, and the omitted trials."""
    rows = result_table(analysis)
    for contact in shown_contacts(rows) if rows else ():
        terminal.say(_table(rows, contact))
        count = analysis.nearest(contact)["reduced"]
        terminal.say(f"{contact} contact: B_θ predicts best in {count} of {len(analysis.sets)} sets")
        if unexplained := [row for row in rows if not row.fits(contact)]:
            labels = ", ".join(f"{row.label} (tolerance {row.tolerance:.1f} %)" for row in unexplained)
            terminal.say(f"{contact} contact: no prediction agrees within the 95 % intervals of both: {labels}")
    if rows and len(shown_contacts(rows)) == 1:
        terminal.say("settled contact: the same errors as the first")
    if by_arm := arm_rows(analysis):
        terminal.say(_arms_table(by_arm))
    if warning := far_words(analysis.jumps):
        terminal.warn(warning)
    for departure in analysis.departed:
        terminal.warn(f"{departure.object} {departure.case}: {departure.words}")
    if analysis.sensitivity.shifts:
        terminal.say(_bands(analysis))
    for note in assumptions(analysis.arms):
        terminal.say(f"note: {note}")
    for entry in analysis.incomplete:
        terminal.say(f"no estimate for {entry.object} {entry.case}: {entry.reason}")
    for bag in analysis.skipped:
        terminal.say(f"skipped {bag.name}: {bag.reason}")
    if note := unsealed_words(len(analysis.unsealed)):
        terminal.say(f"note: {note}")
    if analysis.no_impact:
        terminal.say(f"without impact, not in the fit: {', '.join(analysis.no_impact)}")
    for name, spread in analysis.apart:
        terminal.say(f"{name}: the arms hit {1e3 * spread:.0f} ms apart, so the net feedback is not that of one impact")
    if analysis.limited:
        trials = len({name for name, _, _ in analysis.limited})
        name, joint, time = max(analysis.limited, key=lambda entry: entry[2])
        terminal.warn(
            f"torque at its limit in {trials} trials, longest in {name} ({joint}, {1e3 * time:.0f} ms): the "
            "arm did not get the torque of the feedback, so its integral is no measure there"
        )
    if analysis.missing:
        shown = ", ".join(analysis.missing[:5]) + (", ..." if len(analysis.missing) > 5 else "")
        terminal.say(f"{len(analysis.missing)} trials of the manifest are missing: {shown}")


def _arms_table(by_arm: dict[str, list[tuple[str, ArmSet]]]) -> Table:
    """Estimates and errors of the predictions, arm by arm."""
    table = Table(title="Arm by arm, first contact [%]")
    table.add_column("", no_wrap=True)
    for heading in ("estimate [m/s]", "B_θ (nominal)", "B_ρ", "B = 0"):
        table.add_column(heading, justify="right", no_wrap=heading.startswith("estimate"))
    for title, rows in by_arm.items():
        table.add_section()
        table.add_row(Text(title, "bold"))
        for label, arm in rows:
            errors = [f"{arm.predictions[model].error:+.2f}" for model in MOTOR_INERTIA_MODELS]
            table.add_row(label, " ± ".join(speed_text(arm.speed, arm.half_interval)), *errors)
    return table


def _bands(analysis: Analysis) -> Table:
    """Table of the systematic bands."""
    table = Table(title="Systematic band of the estimates, and the setting that moves them most")
    for heading in ("", "band [%]", "most [%]", "with"):
        table.add_column(heading, justify="left" if heading in ("", "with") else "right")
    for row in sensitivity_rows(analysis):
        words, most = max(row.shifts.items(), key=lambda item: abs(item[1]))
        table.add_row(row.label, f"{row.band[0]:+.1f} to {row.band[1]:+.1f}", f"{most:+.2f}", words)
    return table


def _table(rows: list[Row], contact: str) -> Table:
    table = Table(title=f"Experimental estimate, and errors of the predictions, {contact} contact [%]")
    table.add_column("", no_wrap=True)
    table.add_column("estimate [m/s]", justify="right", no_wrap=True)
    for heading in ("B_θ (nominal)", "B_ρ", "B = 0"):
        table.add_column(heading, justify="right")
    published = any(row.paper_errors for row in rows)
    if published:
        table.add_column("published B_θ", justify="right")
    for row in rows:
        estimate = "" if row.estimate is None else " ± ".join(speed_text(row.estimate, row.half_interval))
        form = "{:+.2f}" if row.signed else "{:.2f}"
        cells = [form.format(error) for error in row.of_contact(contact).values()]
        if published:
            cells.append("" if row.paper_errors is None else form.format(row.paper_errors["reduced"]))
        table.add_row(row.label, estimate, *cells)
    return table
