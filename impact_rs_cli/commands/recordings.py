"""What ``compare`` and ``diagnose`` do with recordings that were not made here: ``--mapping``."""

from __future__ import annotations

import argparse
import json
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from impact_rs_cli.arguments import estimates_table, number
from impact_rs_cli.terminal import PROGRAM, Terminal, output_folder

DEFAULT_MAPPING = "joint_state"


def add_mapping(parser: argparse.ArgumentParser) -> None:
    """The option ``--mapping``."""
    parser.add_argument(
        "--mapping",
        metavar="NAME",
        help="RUNS is a recording of a real robot in free motion (.db3, .mcap, .csv, .npz, or a folder of them): name "
        "of a mapping (joint_state, franka_robot_state), or path of a mapping file; default there: joint_state",
    )


def mapping_of(args: argparse.Namespace) -> str | None:
    """The mapping to read RUNS with; None: RUNS holds trials of ours."""
    from impact_rs_analysis.imports import is_foreign

    if args.mapping is not None:
        return str(args.mapping)
    return DEFAULT_MAPPING if is_foreign(args.runs) else None


def run_compare(args: argparse.Namespace, mapping: str, terminal: Terminal) -> int:
    """Compare a model with recordings."""
    from impact_rs_analysis.imports import compare_recording
    from impact_rs_sim.model import load_model

    _refuse(args, ("mcap", "--mcap"))
    with _report_folder(args.output):
        found = compare_recording(args.runs, mapping, load_model(args.model), args.output)
    terminal.result(found)
    _header(found["recording"], terminal)
    terminal.say(f"score {number(found['score'])}: {found['score_is']}; noise floor {number(found['noise_floor'])} N m")
    from rich.table import Table

    table = Table(title="Torque that the model does not explain")
    for heading in ("joint", "rms [N m]", "mean [N m]", "noise [N m]"):
        table.add_column(heading, justify="left" if heading == "joint" else "right")
    for row in found["levels"]["free_motion"]["signals"]:
        table.add_row(row["index"], f"{row['error']:.3f}", f"{row['mean']:+.3f}", f"{row['noise']:.3f}")
    terminal.say(table)
    for cell in found["where"][:4]:
        terminal.say(f"  {100 * cell['share']:.0f} %: {cell['index']} {cell['phase']}, mean {cell['error']:+.2f} N m")
    terminal.say(f"not measured: {', '.join(found['not_measured'])}")
    if args.output is not None:
        terminal.say(f"report: {(args.output / 'compare.html').resolve()}")
    return 0


def run_diagnose(args: argparse.Namespace, mapping: str, terminal: Terminal) -> int:
    """Diagnose recordings."""
    from impact_rs_analysis.imports import diagnose_recording
    from impact_rs_cli.commands.diagnose import check_effects, with_formulas
    from impact_rs_sim.errors import InputError
    from impact_rs_sim.model import load_model

    if args.output is not None and args.output.is_dir():
        raise InputError("this is a folder; name a file, for example diagnosis.json", file=args.output)
    believed = load_model(args.model)
    model = with_formulas(believed, args.formulas)
    check_effects(model, args.effects)
    with _report_folder(args.report):
        found = diagnose_recording(args.runs, mapping, model, args.effects, args.report)
    found["model"] = {"name": believed.name, "digest": believed.digest}
    terminal.result(found)
    if args.output is not None:
        with output_folder(args.output.parent):
            args.output.parent.mkdir(parents=True, exist_ok=True)
            args.output.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    _header(found["recording"], terminal)
    terminal.say(
        f"{found['verdict']}: held-out torque error {found['held_out_error_before']:.3f} → "
        f"{found['held_out_error_after']:.3f} N m rms, noise {found['noise_floor']:.3f} N m"
    )
    terminal.say(f"held out: {found['held_out']}")
    _show_joints(found, terminal)
    _show_effects(found, terminal)
    for remark in found["remarks"]:
        terminal.say(f"note: {remark}")
    terminal.say(f"next experiment: {found['next_experiment']['advice']}")
    if args.report is not None:
        terminal.say(f"report: {(args.report / 'diagnosis.html').resolve()}")
    if args.output is not None:
        terminal.say(f"diagnosis: {args.output}")
        if found["named"]:
            terminal.say(
                f"next: {PROGRAM} add {found['named'][0]} --model {args.model} --from {args.output} -o model_2.yaml"
            )
    return 0


def _report_folder(path: Path | None) -> AbstractContextManager[Path | None]:
    return nullcontext() if path is None else output_folder(path)


def _refuse(args: argparse.Namespace, *options: tuple[str, str]) -> None:
    from impact_rs_sim.errors import InputError

    for name, option in options:
        if getattr(args, name) is not None:
            raise InputError(f"{option} is for trials; a recording without scenario has --json only", file=args.runs)


def _header(recording: dict[str, Any], terminal: Terminal) -> None:
    files = ", ".join(Path(name).name for name in recording["files"])
    terminal.say(
        f"{files}: {recording['samples']} samples at {recording['sampled_Hz']:.3g} Hz, "
        f"{recording['used_s']:.3g} s used, {recording['robot']}, {recording['end_effector_mass_kg']:g} kg mounted; "
        f"low-pass {recording['low_pass_Hz']:g} Hz"
    )


def _show_joints(found: dict[str, Any], terminal: Terminal) -> None:
    from rich.table import Table

    table = Table(title="Held-out torque error by joint [N m rms]")
    for heading in ("", *(row["joint"] for row in found["joints"])):
        table.add_column(heading, justify="right")
    for name in ("before", "after", "noise"):
        table.add_row(name, *(f"{row[name]:.3f}" for row in found["joints"]))
    terminal.say(table)


def _show_effects(found: dict[str, Any], terminal: Terminal) -> None:
    from rich.table import Table

    from impact_rs_analysis.diagnosis.document import EstimateDocument

    table = Table(title="Effects (held-out error without and with it, beside the chosen ones)")
    table.add_column("effect")
    table.add_column("verdict", overflow="fold")
    table.add_column("error [N m]", justify="right", no_wrap=True)
    table.add_column("p", justify="right")
    unmeasured, estimates = [], []
    for effect in found["effects"]:
        if effect["p_value"] is None:
            unmeasured.append(effect["name"])
            continue
        table.add_row(
            effect["name"],
            effect["verdict"] + (f" ({effect['reason']})" if effect["reason"] else ""),
            f"{effect['held_out_error_before']:.3f} → {effect['held_out_error_after']:.3f}",
            f"{effect['p_value']:.1g}",
        )
        if effect["name"] not in found["named"]:
            continue
        verdicts = {entry["joint"]: entry["verdict"] for entry in effect["joints"]}
        rows = []
        for name, value in effect["parameters"].items():
            verdict = next((text for joint, text in verdicts.items() if name.endswith(joint)), "")
            rows.append((name, EstimateDocument(**value), verdict))
        estimates.append(estimates_table(effect["name"], rows))
    terminal.say(table, *estimates)
    terminal.say(f"not measured in a free motion: {', '.join(unmeasured)}")
