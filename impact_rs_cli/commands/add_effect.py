# SPDX-License-Identifier: Apache-2.0
"""``impact-rs add``: a new model file with a diagnosed effect."""

from __future__ import annotations

import argparse

from impact_rs_analysis.diagnosis.add import add_effect
from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.model import load_model, save_model
from impact_rs_sim.numbers import estimate_in_line


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
