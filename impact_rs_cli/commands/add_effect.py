# SPDX-License-Identifier: Apache-2.0
"""``impact-rs add``: a new model file with diagnosed effects, and a calibration with faults of the readings."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from impact_rs_analysis.diagnosis.add import add_effects, add_faults, calibration_file, faults_among
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document
from impact_rs_analysis.evidence.calibration import (
    NO_CALIBRATION,
    LaboratoryCalibration,
    calibration_in,
    write_calibration,
)
from impact_rs_cli.terminal import Terminal, output_folder
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, load_model, save_model
from impact_rs_sim.numbers import estimate_in_line


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    model = load_model(args.model)
    document = read_document(args.source)
    faults = faults_among(args.effect, model, document)
    physics = [name for name in args.effect if name not in faults]
    if physics and args.output is None:
        raise InputError(f"{', '.join(physics)} of the physics goes into a new model file; name it with -o FILE.yaml")
    child, calibration = None, None
    if physics:
        child = add_effects(model, args.model, document, args.source, physics, args.output, args.force)
    if faults:
        file = calibration_file(document, args.source) if args.calibration is None else args.calibration
        calibration = add_faults(calibration_in(file), document, args.source, faults, args.force)
    _write(child, args.output, calibration)
    now, known = child or model, calibration or NO_CALIBRATION
    added = [item for item in now.effects if item.name in physics]
    wrong = [item for item in known.faults.effects if item.name in faults]
    terminal.result(
        {
            "file": None if child is None else str(args.output),
            "model": {"name": now.name, "digest": now.digest},
            "parent": None if child is None else child.parent,
            "effects": [item.model_dump(mode="json") for item in added],
            "calibration": None if known.file is None else str(known.file),
            "faults": [item.model_dump(mode="json") for item in wrong],
        }
    )
    if calibration is not None:
        _show(f"{calibration.file}: calibration with", wrong, document, terminal)
    if child is not None:
        _show(f"{args.output}: {model.name!r} and", added, document, terminal)
    elif args.output is not None:
        terminal.say(f"{args.output} is not written: no effect of the physics was added to {model.name!r}")
    return 0


def _write(child: Model | None, output: Path, calibration: LaboratoryCalibration | None) -> None:
    """Write both files or neither."""
    if child is not None:
        with output_folder(output.parent):
            save_model(child, output)
    if calibration is not None:
        try:
            write_calibration(calibration)
        except InputError:
            if child is not None:
                output.unlink()
            raise


def _show(what: str, items: Sequence[ModelEffect], document: DiagnosisDocument, terminal: Terminal) -> None:
    """Say which effects a file now has, with their parameters."""
    said = []
    for item in items:
        found = document.effect(item.name)
        said.append(f"{item.name} ({found.verdict if found else ''})")
    terminal.say(f"{what} {', '.join(said)}")
    for item in items:
        for name, value in item.parameters.items():
            terminal.say(f"  {name} = {estimate_in_line(value.estimate, value.ci95)} {value.unit}")
