# SPDX-License-Identifier: Apache-2.0
"""``impact-rs investigate``: the loop that closes itself."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rs_analysis.application.plant_bench import NO_SECRET, PlantBench
from impact_rs_analysis.investigation.endings import Ending
from impact_rs_analysis.investigation.loop import Investigation
from impact_rs_analysis.investigation.rounds import read_rounds
from impact_rs_analysis.investigation.settings import BlindChoice, Settings, begin
from impact_rs_analysis.investigation.story import LOG_FILE
from impact_rs_analysis.report.family_tree import write_investigation
from impact_rs_analysis.report.page_names import INVESTIGATION_PAGE
from impact_rs_cli.arguments import check_robots, started_workers
from impact_rs_cli.cell_guard import CellGuard
from impact_rs_cli.commands.diagnose import check_effects
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import load
from impact_rs_trials.blind import Secret
from impact_rs_trials.envelope import CellEnvelope
from impact_rs_trials.store import Folder, owned
from impact_rs_trials.workers import Map

REPORT = "report"


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    settings, directory = settings_of(args), Path(args.directory)
    for name in settings.scenarios:
        check_robots(load_scenario(name), terminal)
    secret = secret_of(settings)
    with output_folder(directory), owned(Folder(directory), "investigation"), started_workers(args) as map_tasks:
        secret.check(directory)
        settings = begin(directory, settings)
        if settings.blind is not None:
            secret.write(directory)
        bench = bench_of(args, settings, secret, map_tasks, terminal)

        def show() -> None:
            write_investigation(settings, read_rounds(directory, settings), directory / REPORT)

        ending = Investigation(directory, settings, args.budget, bench, terminal.say, show).run()
    _show(directory, ending, terminal)
    terminal.result({**ending.model_dump(mode="json"), "directory": str(directory)})
    return 0


def settings_of(args: argparse.Namespace) -> Settings:
    """Settings of the investigation, by the options.

    Raises:
        InputError: Options that exclude each other, or unknown names.
    """
    model = load_model(args.model)
    check_effects(model, args.effects)
    for name in args.scenarios:
        if (arms := len(load_scenario(name).robots)) > 1:
            raise InputError(
                f"scenario {name!r} has {arms} arms, and an investigation has one; measure it with campaign {name} -o "
                "DIR, and go on with diagnose DIR"
            )
    if args.blind is None and (args.kind != "single" or args.effect is not None):
        raise InputError("--kind and --effect say what --blind SEED hides; give it, too")
    if args.blind is not None and args.via == "cell":
        raise InputError("--blind hides an effect in our plant; a cell has its own, leave it out with --via cell")
    if args.blind is not None and args.kind == "outside" and args.via == "nodes":
        raise InputError("--kind outside goes with --via inprocess only: the plant node knows effects of the library")
    if args.via == "cell" and args.envelope is None:
        raise InputError("--via cell needs --envelope FILE.yaml, which says what may run (docs/safety.md)")
    if args.via != "cell" and args.yes:
        raise InputError("--yes answers questions of --via cell; no other trials ask")
    blind = None
    if args.blind is not None:
        if args.blind < 0:
            raise InputError(f"argument --blind: expected a whole number >= 0, got {args.blind}")
        blind = BlindChoice(seed=args.blind, kind=args.kind, effect=args.effect)
    return Settings(
        scenarios=tuple(args.scenarios),
        model=str(args.model),
        model_digest=model.digest,
        via=args.via,
        seed=args.seed if blind is None else blind.seed,
        effects=tuple(args.effects or ()),
        blind=blind,
        envelope=None if args.envelope is None else load(CellEnvelope, args.envelope),
    )


def secret_of(settings: Settings) -> Secret:
    """Hidden effect of the plant, drawn by the seed, not read from the file with the truth."""
    if (blind := settings.blind) is None:
        return NO_SECRET
    return Secret.drawn(blind.seed, blind.kind, blind.effect, blind.magnitude)


def bench_of(
    args: argparse.Namespace, settings: Settings, secret: Secret, map_tasks: Map, terminal: Terminal
) -> PlantBench:
    """Bench that runs the trials."""
    directory = Path(args.directory)
    if settings.via == "inprocess":
        return PlantBench(directory, settings, map_tasks, terminal, secret)
    # Only --via nodes and cell need ROS 2: without it trials still run in this program.
    from impact_rs_cli.node_benches import CellBench, NodesBench

    if settings.via == "nodes":
        return NodesBench(directory, settings, map_tasks, terminal, secret.model, namespace=args.namespace)
    assert settings.envelope is not None
    guard = CellGuard(directory, settings.envelope, terminal.ask, args.yes)
    return CellBench(directory, settings, map_tasks, terminal, guard, args.namespace, args.mapping)


def _show(directory: Path, ending: Ending, terminal: Terminal) -> None:
    terminal.say("", ending.verdict, ending.summary, f"{ending.trials} trials in {ending.rounds} rounds")
    if ending.effects:
        terminal.say(f"model: {directory / ending.model}")
    terminal.say(f"log: {directory / LOG_FILE}", f"report: {(directory / REPORT / INVESTIGATION_PAGE).resolve()}")
