# SPDX-License-Identifier: Apache-2.0
"""``impact-rs design``: a plan of trials."""

from __future__ import annotations

import argparse

from rich.table import Table

from impact_rs_analysis.application.measurements import read_trials
from impact_rs_analysis.design.design import WHICH_EFFECT, design
from impact_rs_analysis.design.possible_trials import Envelope
from impact_rs_analysis.diagnosis.document import CalibrationExperiment, read_document
from impact_rs_analysis.diagnosis.verdicts.measurement import calibration_text, experiments_of
from impact_rs_analysis.diagnosis.verdicts.next_experiment import considered, left_open
from impact_rs_cli.arguments import started_workers
from impact_rs_cli.parser import command_line
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.schema import load
from impact_rs_sim.seeds import seed_of
from impact_rs_trials.envelope import CellEnvelope
from impact_rs_trials.experiment_plan import MAX_SHOWN_PAIRS, ExperimentPlan, write_plan

FOLLOWING_SEEDS = 2**31  # range of seeds of plans that follow others


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    model = load_model(args.model)
    if args.output is not None and args.output.is_dir():
        raise InputError("this is a folder; name a file, for example plan.yaml", file=args.output)
    cell = None if args.envelope is None else load(CellEnvelope, args.envelope)
    envelope = Envelope(args.speed, args.force, cell)
    decide, earlier = WHICH_EFFECT, ""
    experiments: tuple[CalibrationExperiment, ...] = ()
    if args.after is not None:
        document = read_document(args.after)
        if document.source != "trials":
            raise InputError("expected a diagnosis of trials: a plan is one of trials", file=args.after)
        try:
            decide = left_open(document, model) or WHICH_EFFECT
        except InputError as error:
            raise error.in_file(args.after) from None
        model = considered(document, model)
        earlier, experiments = document.runs.digest, experiments_of(document)
    with started_workers(args) as map_tasks:
        runs = None if args.runs is None else read_trials(args.runs, map_tasks, terminal)
        if runs is not None:
            earlier = runs.digest
        seed = args.seed if args.seed is not None else seed_of(0, earlier) % FOLLOWING_SEEDS if earlier else 0
        with terminal.stages() as stage:
            plan = design(
                model, args.scenarios, args.budget, map_tasks, decide, runs, args.method, envelope, seed, stage
            )
    if args.output is not None:
        with output_folder(args.output.parent):
            write_plan(plan, args.output)
    _show(plan, terminal)
    for experiment in experiments:
        terminal.say(calibration_text(experiment))
    terminal.result(plan.model_dump(mode="json"))
    if args.output is not None:
        terminal.say(
            f"plan: {args.output}", f"next: {command_line('campaign', {'plan': args.output, 'output': 'DIR'})}"
        )
    return 0


def _show(plan: ExperimentPlan, terminal: Terminal) -> None:
    terminal.say(plan.summary)
    table = Table(title="Trials")
    for name, settings in (("trials", {"justify": "right"}), ("condition", {}), ("what they add", {})):
        table.add_column(name, overflow="fold", **settings)  # type: ignore[arg-type]
    for campaign in plan.campaigns:
        for condition in campaign.conditions:
            table.add_row(
                str(condition.trials),
                condition.what,
                condition.buys.removeprefix(f"{condition.trials} x {condition.what} "),
            )
    terminal.say(table)
    if plan.pairs:
        pairs = Table(title="Probability that the next diagnosis distinguishes them, least certain first")
        for name in ("explanation", "against", "before", "after"):
            pairs.add_column(name)
        for pair in plan.pairs[:MAX_SHOWN_PAIRS]:
            pairs.add_row(pair.first, pair.second, f"{pair.before:.1%}", f"{pair.after:.1%}")
        terminal.say(pairs)
