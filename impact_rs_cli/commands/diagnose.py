# SPDX-License-Identifier: Apache-2.0
"""``impact-rs diagnose``: which effect is missing, of the measurement or of the physics."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from impact_rs_analysis.application.loop_steps import (
    NO_OPTIONS,
    check_effects,
    diagnose_measurements,
    report_diagnosis,
    with_formulas,
)
from impact_rs_analysis.application.measurements import Measurements
from impact_rs_analysis.diagnosis.document import (
    DiagnosisDocument,
    EffectDocument,
    EstimateDocument,
    write_document,
)
from impact_rs_analysis.diagnosis.search.bounds import NO_BOUNDS, Bounds, read_bounds
from impact_rs_analysis.diagnosis.search.budget import UNLIMITED, Budget
from impact_rs_analysis.diagnosis.verdict import NO_IMPROVEMENT, TOO_FEW, UNIDENTIFIABLE, DiagnosisVerdict
from impact_rs_analysis.diagnosis.verdicts.measurement import calibration_text
from impact_rs_analysis.diagnosis.verdicts.words import not_excluded, shown_unnamed
from impact_rs_cli.arguments import on_local_runs, three_digits
from impact_rs_cli.interrupt import INTERRUPTED, ends_at_interrupt
from impact_rs_cli.parser import command_line
from impact_rs_cli.reading import measured
from impact_rs_cli.terminal import Terminal, add_word_column, output_folder
from impact_rs_commands.declaration import NAMED, READ, WRITTEN, Option
from impact_rs_commands.explaining import DIAGNOSE
from impact_rs_commands.shared import JOBS
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.numbers import estimate_text
from impact_rs_sim.robots.robot import joined_units
from impact_rs_trials.store import is_url
from impact_rs_trials.workers import processor_time

MAX_LISTED_EFFECTS = 8


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    model = load_model(args.model)
    if args.output is not None and args.output.is_dir():
        raise InputError("this is a folder; name a file, for example diagnosis.json", file=args.output)
    extended = with_formulas(model, args.formulas)
    check_effects(extended, args.effects)
    bounds = read_bounds(args.bounds, extended.known_effects)
    with measured(args, terminal, args.each_arm, args.unsure) as measurements:
        with ends_at_interrupt(terminal) as stop:
            document = diagnosis_of(
                measurements, model, extended, args.effects, terminal, args.output, bounds,
                options=options_of(args), budget=Budget(args.budget, processor_time, stop),
            )  # fmt: skip
        if args.report is not None:
            with output_folder(args.report):
                path = report_diagnosis(document, measurements, args.model, extended, args.report)
            terminal.say(f"report: {path.resolve()}")
    terminal.result(document.model_dump(mode="json"))
    if args.output is not None:
        terminal.say(f"diagnosis: {args.output}")
        if names := document.addable:
            terminal.say(f"next: {add_command(names, args.model, args.output, document)}")
    if document.verdict.leaves_residuals:
        terminal.say(f"a law that the library does not have: {discover_command(args, model)}")
    return INTERRUPTED if document.budget.stopped else 0


def options_of(args: argparse.Namespace) -> dict[str, Any]:
    """The given options that select the measurements, by name; paths are absolute, valid in every folder."""
    selecting = [option for option in DIAGNOSE.options if option not in JOBS and option.kind not in (*WRITTEN, "json")]
    given = {
        option.name: getattr(args, option.name) for option in selecting if option.words(getattr(args, option.name))
    }
    options = {option.name: option for option in selecting}
    return {name: _absolute(options[name], value, args.runs) for name, value in given.items()}


def _absolute(option: Option, value: Any, runs: str | None) -> Any:
    """A value with an absolute path; names and URLs unchanged. An experiment file may stand in the folder of runs."""
    named = option.kind in NAMED and Path(value).suffix not in (".yaml", ".yml")
    if named or option.kind not in (*NAMED, *READ) or is_url(str(value)):
        return value
    folders = [Path(), *([Path(runs)] if option.kind == "experiment" and runs is not None else [])]
    return next((str((folder / value).absolute()) for folder in folders if (folder / value).exists()), str(value))


def add_command(effects: Sequence[str], model: Path, source: Path, document: DiagnosisDocument | None = None) -> str:
    """The command that adds effects to a model.

    Args:
        effects: Their names.
        model: File of the model that was diagnosed.
        source: File of the diagnosis or discovery.
        document: The diagnosis; faults of the readings alone need no new model file.
    """
    physics = document is None or not all(map(document.is_of_measurement, effects))
    output = "model_2.yaml" if physics else None
    return command_line("add", {"effect": effects, "model": model, "source": source, "output": output})


def discover_command(args: argparse.Namespace, model: Model) -> str:
    """The command that searches a law in the same measurements.

    Args:
        args: Arguments of ``diagnose``.
        model: The model that was diagnosed; formulas beyond it are unknown to ``discover``.
    """
    effects = None if args.effects is None else [name for name in args.effects if name in model.known_effects]
    changed_options = {"effects": effects, "report": None, "output": "discovery.json", "json": False}
    return command_line("discover", vars(args) | changed_options)


def diagnosis_of(
    measurements: Measurements,
    model: Model,
    extended: Model,
    only: list[str] | None,
    terminal: Terminal,
    output: Path | None = None,
    bounds: Bounds = NO_BOUNDS,
    options: Mapping[str, Any] = NO_OPTIONS,
    budget: Budget = UNLIMITED,
) -> DiagnosisDocument:
    """Diagnose, write the result, and show it.

    Args:
        measurements: The measurements.
        model: The model as its file says it.
        extended: The same with further formulas.
        only: Names of the effects to consider; None: all.
        terminal: Where to show it.
        output: File for it, which is there before anything is shown; None: none.
        bounds: Ranges of parameters that the user knows better.
        options: Options of the command, for the document (:func:`options_of`).
        budget: Processor time of the diagnosis.
    """
    document = diagnose_measurements(measurements, model, extended, only, terminal.rank, bounds, options, budget)
    if output is not None:
        with output_folder(output.parent):
            write_document(document, output)
    show(document, terminal)
    return document


def show(document: DiagnosisDocument, terminal: Terminal) -> None:
    """Print a diagnosis for people."""
    terminal.say(str(document.verdict), document.summary)
    if document.hold_out.folds:
        terminal.say(f"held out: {document.hold_out.what}")
    if document.rollouts is not None:
        terminal.say(document.rollouts.in_words)
    if document.joints:
        terminal.say(_joints_table(document))
    shown = [effect for effect in document.effects if effect.measured]
    terminal.say(_effects_table(document, shown[:MAX_LISTED_EFFECTS]))
    for effect in shown:
        if effect.verdict not in (NO_IMPROVEMENT, UNIDENTIFIABLE, TOO_FEW):
            terminal.say(estimates_table(effect.name, effect.parameters))
            for size in effect.sizes[:1]:
                terminal.say(f"  moves {size.signal} ({size.phase}) by up to {three_digits(size.value)} {size.unit}")
    if document.dependences:
        terminal.say(dependences_table(document))
    if len(shown) > MAX_LISTED_EFFECTS:
        terminal.say(f"and {len(shown) - MAX_LISTED_EFFECTS} more effects, ranked below these")
    if missing := [effect.name for effect in document.effects if not effect.measured]:
        terminal.say(f"not measured here: {', '.join(missing)}")
    if beyond_zero := shown_unnamed(document):
        terminal.say(f"beyond zero alone, but not named: {beyond_zero}")
    if small := not_excluded(document):
        terminal.say(f"not excluded at a noticeable size: {small}")
    for remark in document.remarks:
        terminal.say(f"note: {remark}")
    for calibration in document.calibrate:
        terminal.say(calibration_text(calibration))
    if document.next_experiment is not None:
        terminal.say(f"next experiment: {document.next_experiment.advice}")


def _joints_table(document: DiagnosisDocument) -> Table:
    """Held-out torque error of every joint."""
    unit = joined_units(row.unit for row in document.joints)
    table = Table(title=escape(f"Held-out torque error by joint [{unit} rms]"))
    for heading in ("", *(row.joint for row in document.joints)):
        table.add_column(heading, justify="right")
    for name in ("before", "after", "noise"):
        table.add_row(name, *(three_digits(getattr(row, name)) for row in document.joints))
    return table


def _effects_table(document: DiagnosisDocument, shown: Sequence[EffectDocument]) -> Table:
    """Effects with verdict, errors on unseen data and p."""
    table = Table(title=f"Effects, best first (error on unseen data, {document.error_unit})")
    table.add_column("effect", no_wrap=True)
    add_word_column(table, "verdict", [_verdict_text(effect.verdict) for effect in shown])
    table.add_column("alone", justify="right", no_wrap=True)
    table.add_column("without → with", justify="right", no_wrap=True)
    table.add_column("p", justify="right", no_wrap=True)
    for effect in shown:
        before, after, alone = (
            "–" if error is None else three_digits(error)
            for error in (effect.held_out_error_without, effect.held_out_error_after, effect.held_out_error_alone)
        )
        table.add_row(
            effect.name,
            _verdict_text(effect.verdict),
            alone,
            f"{before} → {after}",
            p_text(effect.p_value, document.design.least_p),
        )
    return table


def dependences_table(document: DiagnosisDocument) -> Table:
    """Every effect that was found by covariate, with estimates where it depends on it."""
    table = Table(title="Dependences on circumstances", title_justify="left")
    table.add_column("effect", no_wrap=True)
    table.add_column("covariate", no_wrap=True)
    verdicts = []
    for dependence in document.dependences:
        reason = f": {dependence.reason}" if dependence.verdict == NO_IMPROVEMENT and dependence.reason else ""
        verdicts.append(f"{_verdict_text(dependence.verdict)}{reason}")
    add_word_column(table, "verdict", verdicts)
    table.add_column("p", justify="right", no_wrap=True)
    for dependence, verdict in zip(document.dependences, verdicts, strict=True):
        table.add_row(
            dependence.effect, dependence.covariate, verdict, p_text(dependence.p_value, document.design.least_p)
        )
    return table


def _verdict_text(verdict: DiagnosisVerdict | None) -> str:
    """Text of a verdict, which may be broken before its names and between them."""
    return "" if verdict is None else str(verdict).replace("{", " {")


def p_text(value: float | None, least: float) -> str:
    """p-value as text; a bound below the smallest p-value that is trusted."""
    if value is None:
        return "–"
    return f"< {least:g}" if value <= least else f"{value:.2g}"


def estimates_table(effect: str, parameters: dict[str, EstimateDocument]) -> Table:
    """Estimates of one effect with their intervals and the verdict on each joint."""
    table = Table(title=effect, title_justify="left")
    table.add_column("parameter", no_wrap=True)
    table.add_column("estimate", justify="right", no_wrap=True)
    table.add_column("95 % interval", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    judged = any(value.verdict is not None for value in parameters.values())
    if judged:
        add_word_column(table, "verdict", [_verdict_text(value.verdict) for value in parameters.values()])
    arm = None
    for name, value in parameters.items():
        if value.arm != arm:
            table.add_section()
        arm = value.arm
        estimate, *interval = estimate_text(value.estimate, value.ci95)
        cells = [name, estimate, " ... ".join(interval), value.unit.strip("-")]
        table.add_row(*cells, *([_verdict_text(value.verdict)] if judged else []))
    return table
