# SPDX-License-Identifier: Apache-2.0
"""``impact-rs add``: a new model file with diagnosed effects."""

from __future__ import annotations

import argparse

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.model import load_model, save_model
from impact_rs_sim.numbers import estimate_in_line


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    model = load_model(args.model)
    document = read_document(args.source)
    child = add_effects(model, args.model, document, args.source, args.effect, args.output, args.force)
    with output_folder(args.output.parent):
        save_model(child, args.output)
    added = [item for item in child.effects if item.name in args.effect]
    terminal.result(
        {
            "file": str(args.output),
            "model": {"name": child.name, "digest": child.digest},
            "parent": child.parent,
            "effects": [item.model_dump(mode="json") for item in added],
        }
    )
    said = []
    for item in added:
        found = document.effect(item.name)
        said.append(f"{item.name} ({found.verdict if found else ''})")
    terminal.say(f"{args.output}: {model.name!r} and {', '.join(said)}")
    for item in added:
        for name, value in item.parameters.items():
            terminal.say(f"  {name} = {estimate_in_line(value.estimate, value.ci95)} {value.unit}")
    return 0
