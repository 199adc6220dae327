# SPDX-License-Identifier: Apache-2.0
"""``impact-rs add``: a new model file with a diagnosed effect."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rs_analysis.diagnosis.add import add_effect
from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_cli.arguments import add_model
from impact_rs_cli.terminal import PROGRAM, Terminal, add_json, declare, output_folder
from impact_rs_sim.model import load_model, save_model
from impact_rs_sim.numbers import estimate_in_line

TEXT = f"""\
Write a new model file: the old model and one effect with the parameters of a diagnosis.

The new file names its parent, so {PROGRAM} history can list all versions. Model files are never overwritten. The
command refuses a diagnosis of another model, and an effect that the trials do not determine; --force adds an effect
whose verdict is NO-IMPROVEMENT.

example:
  {PROGRAM} add torque_offset --model config/models/nominal.yaml --from diagnosis.json -o model_2.yaml
  {PROGRAM} compare campaigns/blind/runs --model model_2.yaml

Units: those of the diagnosis and the model file."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the command."""
    declare(parser, run, TEXT)
    parser.add_argument("effect", metavar="EFFECT", help="name of an effect of the diagnosis")
    add_model(parser)
    parser.add_argument(
        "--from", dest="source", type=Path, required=True, metavar="FILE.json", help="diagnosis of the model"
    )
    parser.add_argument("-o", dest="output", type=Path, required=True, metavar="FILE.yaml", help="new model file")
    parser.add_argument("--force", action="store_true", help="add the effect even if its verdict is NO-IMPROVEMENT")
    add_json(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    model = load_model(args.model)
    document = read_document(args.source)
    child = add_effect(model, args.model, document, args.source, args.effect, args.output, args.force)
    with output_folder(args.output.parent):
        save_model(child, args.output)
    item = child.effects[-1]
    terminal.result(
        {
            "file": str(args.output),
            "model": {"name": child.name, "digest": child.digest},
            "parent": child.parent,
            "effect": item.model_dump(mode="json"),
        }
    )
    found = document.effect(args.effect)
    terminal.say(f"{args.output}: {model.name!r} and {args.effect} ({found.verdict if found else ''})")
    for name, value in item.parameters.items():
        terminal.say(f"  {name} = {estimate_in_line(value.estimate, value.ci95)} {value.unit}")
    return 0
