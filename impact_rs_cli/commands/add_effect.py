# SPDX-License-Identifier: Apache-2.0
"""``impact-rs add``: a new model file with diagnosed effects, and a calibration with faults of the readings."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import nullcontext

from impact_rs_analysis.application.loop_steps import addition_of
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.model import ModelEffect
from impact_rs_sim.numbers import estimate_in_line


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    addition = addition_of(args.effect, args.model, args.source, args.output, args.calibration, args.force)
    with nullcontext() if args.output is None else output_folder(args.output.parent):
        addition.write(args.output)
    child, calibration, document = addition.child, addition.calibration, addition.document
    result_model = child or addition.model
    terminal.result(
        {
            "file": None if child is None else str(args.output),
            "model": {"name": result_model.name, "digest": result_model.digest},
            "parent": None if child is None else child.parent,
            "effects": [item.model_dump(mode="json") for item in addition.physics],
            "calibration": None if calibration is None else str(calibration.file),
            "faults": [item.model_dump(mode="json") for item in addition.faults],
        }
    )
    if calibration is not None:
        _show(f"{calibration.file}: calibration with", addition.faults, document, terminal)
    if child is not None:
        _show(f"{args.output}: {addition.model.name!r} and", addition.physics, document, terminal)
    elif args.output is not None:
        terminal.say(f"{args.output} is not written: no effect of the physics was added to {result_model.name!r}")
    return 0


def _show(heading: str, items: Sequence[ModelEffect], document: DiagnosisDocument, terminal: Terminal) -> None:
    """Say which effects a file now has, with their parameters."""
    descriptions = []
    for item in items:
        effect = document.effect(item.name)
        descriptions.append(f"{item.name} ({effect.verdict if effect else ''})")
    terminal.say(f"{heading} {', '.join(descriptions)}")
    for item in items:
        for name, value in item.parameters.items():
            terminal.say(f"  {name} = {estimate_in_line(value.estimate, value.ci95)} {value.unit}".removesuffix(" -"))
