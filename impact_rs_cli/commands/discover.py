# SPDX-License-Identifier: Apache-2.0
"""``impact-rs discover``: a formula for what no effect of the library explains."""

from __future__ import annotations

import argparse

from rich.table import Table

from impact_rs_analysis.application.loop_steps import check_effects, check_uncalibrated
from impact_rs_analysis.diagnosis.laws.discover import discover
from impact_rs_analysis.diagnosis.laws.discovery_document import DiscoveryDocument, LawDocument, write_discovery
from impact_rs_analysis.diagnosis.laws.grammar import load_grammar
from impact_rs_analysis.report.discovery import write_report
from impact_rs_cli.arguments import on_local_runs, three_digits
from impact_rs_cli.commands.diagnose import add_command
from impact_rs_cli.reading import measured
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.numbers import estimate_in_line


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    model, grammar = load_model(args.model), load_grammar(args.grammar)
    check_effects(model, args.effects)
    if args.output is not None and args.output.is_dir():
        raise InputError("this is a folder; name a file, for example discovery.json", file=args.output)
    with measured(args, terminal) as measurements, measurements.progress():
        check_uncalibrated(measurements.calibration, args.effects)
        document = discover(measurements.against, model, grammar, args.effects, terminal.rank)
    if args.output is not None:
        with output_folder(args.output.parent):
            write_discovery(document, args.output)
    if args.report is not None:
        with output_folder(args.report):
            terminal.say(f"report: {write_report(document, args.report).resolve()}")
    _show(document, terminal)
    terminal.result(document.model_dump(mode="json"))
    if args.output is not None:
        terminal.say(f"discovery: {args.output}")
        if document.laws:
            named = document.diagnosis.named if document.diagnosis is not None else ()
            effects = named or (document.laws[0].name,)
            terminal.say(f"next: {add_command(effects, args.model, args.output, document.diagnosis)}")
    return 0


def _show(document: DiscoveryDocument, terminal: Terminal) -> None:
    terminal.say(document.verdict, document.summary)
    for law in document.laws:
        _show_law(law, terminal)
    if document.others:
        where = "in its place" if document.laws else "alone"
        table = Table(title=f"Other laws {where}, best first (error on unseen data, {document.error_unit})")
        table.add_column("law", no_wrap=True)
        table.add_column("formula", overflow="fold")
        table.add_column("without → with", justify="right", no_wrap=True)
        for law in document.others:
            table.add_row(law.name, "a curve" if law.curved else law.formula, _errors(law))
        terminal.say(table)
    if document.looked_at:
        terminal.say(f"looked at {document.looked_at} laws and effects from {document.starts} starts")


def _show_law(law: LawDocument, terminal: Terminal) -> None:
    terminal.say(f"\n{law.name}: {law.sentence}")
    if not law.curved:
        terminal.say(f"  {law.place} = {law.formula}")
        for name, value in law.parameters.items():
            terminal.say(f"  {name} = {estimate_in_line(value.estimate, value.ci95)} {value.unit.strip('-')}")
    terminal.say(f"  error on unseen data {_errors(law)}, {law.verdict}")
    domain, curve = law.valid, law.curve
    if domain is None:
        return
    terminal.say(f"  seen for {domain.quantity} from {domain.low:.3g} to {domain.high:.3g} {domain.unit}")
    if curve is None:
        return
    explanation = "straight between these values" if law.curved else "the law, and a free curve fitted to the same data"
    table = Table(title=f"{law.place} [{curve.unit}]: {explanation}")
    for heading in (domain.quantity, *(() if law.curved else ("law",)), "free curve", "95 % interval"):
        table.add_column(heading, justify="right", no_wrap=True)
    for point in curve.points:
        interval = f"{three_digits(point.ci95[0])} ... {three_digits(point.ci95[1])}"
        law_cells = () if law.curved else (three_digits(point.law),)
        table.add_row(three_digits(point.at), *law_cells, three_digits(point.force), interval)
    terminal.say(table)


def _errors(law: LawDocument) -> str:
    return f"{three_digits(law.held_out_error_before)} → {three_digits(law.held_out_error_after)}"
