"""``impact-rs diagnose``: which physical effect is missing."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from impact_rs_cli.arguments import add_jobs, add_runs, estimates_table, number, on_local_runs, read, started
from impact_rs_cli.commands.recordings import add_mapping, mapping_of, run_diagnose
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder

if TYPE_CHECKING:
    from impact_rs_analysis.diagnosis.document import DiagnosisDocument
    from impact_rs_analysis.evidence.runs import Runs
    from impact_rs_sim.effects.formula import FormulaEffect
    from impact_rs_sim.model import Model
    from impact_rs_trials.workers import Map

TEXT = f"""\
Find out which physical effect is missing in a model.

Every effect of the library ({PROGRAM} effects lists them) and of your own formulas is fitted to the trials through the
model's twin, and judged by how well it predicts conditions that the fit has not seen. Says CONFIRMED,
CONFUSABLE-WITH{{...}}, NOT-IDENTIFIABLE, NO-IMPROVEMENT or AT-BOUND of each, and NOTHING-MISSING or NONE-EXPLAINS of
all where that is the answer.

Needs at least three conditions (object x case), some of them repeated; a free motion there and back (scenario excite)
tells friction, offset and gain of the torque apart.

example:
  {PROGRAM} diagnose campaigns/blind/runs --model config/models/nominal.yaml -o diagnosis.json
  {PROGRAM} diagnose campaigns/blind/runs -o diagnosis.json --effects torque_offset joint_coulomb_friction
  {PROGRAM} add torque_offset --model config/models/nominal.yaml --from diagnosis.json -o model_2.yaml

A recording of a real robot in free motion (a bag with sensor_msgs/JointState, CSV or NPZ) is compared on joint torque:
  {PROGRAM} diagnose recording.db3 --mapping joint_state

Units: each estimate says its own; errors are multiples of what repetition explains."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    add_runs(parser)
    add_mapping(parser)
    parser.add_argument("-o", dest="output", type=Path, metavar="FILE.json", help="file for the diagnosis")
    parser.add_argument("--effects", nargs="+", metavar="NAME", help="consider only these; default: all")
    parser.add_argument("--formulas", type=Path, metavar="FILE.yaml", help="consider your own effects as well")
    parser.add_argument("--report", type=Path, metavar="DIR", help="folder for an HTML report")
    add_jobs(parser)
    add_json(parser)


@on_local_runs
def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if (mapping := mapping_of(args)) is not None:
        return run_diagnose(args, mapping, terminal)
    from impact_rs_analysis.diagnosis.document import write_document
    from impact_rs_analysis.diagnosis.history import history
    from impact_rs_sim.errors import InputError
    from impact_rs_sim.model import load_model

    model = load_model(args.model)
    if args.output is not None and args.output.is_dir():
        raise InputError("this is a folder; name a file, for example diagnosis.json", file=args.output)
    extended = with_formulas(model, args.formulas)
    check_effects(extended, args.effects)
    with started(args) as map_tasks:
        runs = read(args.runs, map_tasks, terminal)
        document = document_of_runs(runs, model, extended, args.effects, map_tasks, terminal)
        if args.output is not None:
            with output_folder(args.output.parent):
                write_document(document, args.output)
        if args.report is not None:
            from impact_rs_analysis.diagnosis.compare import compare
            from impact_rs_analysis.evidence.aligned import aligned_trials
            from impact_rs_analysis.report.loop import write_diagnosis

            with terminal.stages() as tell:
                comparison = compare(runs, model, map_tasks, tell)
                versions = (
                    history(args.model, runs, map_tasks, tell, [comparison]) if model.parent is not None else None
                )
                aligned = aligned_trials(runs, model, map_tasks)
            with output_folder(args.report):
                path = write_diagnosis(document, comparison, aligned, versions, args.report)
            terminal.say(f"report: {path.resolve()}")
    terminal.result(document.model_dump(mode="json"))
    if args.output is not None:
        terminal.say(f"diagnosis: {args.output}")
        if document.named:
            terminal.say(
                f"next: {PROGRAM} add {document.named[0]} --model {args.model} --from {args.output} -o model_2.yaml"
            )
    return 0


def with_formulas(model: Model, path: Path | None) -> Model:
    """The model, knowing the formulas of a file as well.

    Raises:
        InputError: The file is no formula file, or a name is taken.
    """
    if path is None:
        return model
    from impact_rs_sim.effects.formula import load_formulas
    from impact_rs_sim.errors import InputError

    own = load_formulas(path)
    for name in own:
        if name in model.known_effects:
            raise InputError(f"there is already an effect called {name!r}; give yours another name", file=path)
    _try_out(own, path)
    return model.model_copy(update={"formulas": (*model.formulas, *(effect.spec for effect in own.values()))})


def _try_out(effects: dict[str, FormulaEffect], path: Path) -> None:
    """Evaluate formulas once at rest, at nominal values and a step away, before hours are spent on bags.

    Raises:
        InputError: One of them blows up.
    """
    import numpy as np

    from impact_rs_sim.errors import InputError
    from impact_rs_sim.model import JOINT_COUNT
    from impact_rs_sim.physics import LoadState
    from impact_rs_sim.scenario import load_scenario
    from impact_rs_sim.scene import Scene

    scenario = load_scenario("push")
    scene = Scene.resolve(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
    name, arm = next(iter(scene.arms.items()))
    twist = scene.models[name].jacobian(arm.position) @ arm.velocity
    place = scene.models[name].placement(arm.position).translation
    state = LoadState(0.0, arm.position, arm.velocity, place, twist[:3], place)
    for effect in effects.values():
        nominal = np.array([scalar.nominal for scalar in effect.scalars(JOINT_COUNT)])
        step = np.array([scalar.scale for scalar in effect.scalars(JOINT_COUNT)])
        for vector in (nominal, nominal + step):
            load = effect.apply_vector(scene.physics, vector).arms[name].loads[-1]
            try:
                load.joint_torque(state)
                load.motor_torque(state)
                load.end_effector_force(state)
            except InputError as error:
                raise InputError(error.message, file=path) from None


def check_effects(model: Model, names: list[str] | None) -> None:
    """Check the names of ``--effects``.

    Raises:
        InputError: An unknown effect, or one that the model has already.
    """
    from impact_rs_sim.errors import InputError, did_you_mean

    known = model.known_effects
    present = {item.name for item in model.effects}
    for name in names or []:
        if name not in known:
            raise InputError(
                f"no effect {name!r}{did_you_mean(name, known)}; known effects: {', '.join(sorted(known))}"
            )
        if name in present:
            raise InputError(f"model {model.name!r} has effect {name!r} already; diagnose looks for what is missing")


def document_of_runs(
    runs: Runs, model: Model, extended: Model, only: list[str] | None, map_tasks: Map, terminal: Terminal
) -> DiagnosisDocument:
    """Diagnose, and show the result.

    Args:
        runs: Measurements.
        model: The model as its file says it.
        extended: The same, knowing further formulas.
        only: Names of the effects to consider; None: all.
        map_tasks: Parallel map.
        terminal: Where to show it.
    """
    from impact_rs_analysis.diagnosis.diagnose import diagnose
    from impact_rs_analysis.diagnosis.document import document_of

    with terminal.stages() as tell:
        found = diagnose(runs, extended, map_tasks, tell, only)
    new = tuple(spec for spec in extended.formulas if spec not in model.formulas)
    document = document_of(found, runs, model, new)
    _show(document, terminal)
    return document


def _show(document: DiagnosisDocument, terminal: Terminal) -> None:
    from rich.table import Table

    from impact_rs_analysis.report.words import verdict_in_words

    terminal.say(f"{document.verdict}", verdict_in_words(document))
    table = Table(title="Effects, best first (error on unseen conditions, multiples of what repetition explains)")
    table.add_column("effect", no_wrap=True)
    table.add_column("verdict", overflow="fold")
    table.add_column("error", justify="right", no_wrap=True)
    table.add_column("p", justify="right")
    for effect in document.effects[:8]:
        table.add_row(
            effect.name,
            effect.verdict,
            f"{number(effect.held_out_error_before)} → {number(effect.held_out_error_after)}",
            f"{effect.p_value:.1g}",
        )
    terminal.say(table)
    chosen = [effect for effect in document.effects if effect.verdict not in ("NO-IMPROVEMENT", "NOT-IDENTIFIABLE")]
    for effect in chosen:
        terminal.say(estimates_table(effect.name, [(name, p, "") for name, p in effect.parameters.items()]))
    if len(document.effects) > 8:
        terminal.say(f"and {len(document.effects) - 8} more effects, none of them better")
    for remark in document.remarks:
        terminal.say(f"note: {remark}")
    if document.next_experiment:
        terminal.say(f"next experiment: {document.next_experiment['advice']}")
