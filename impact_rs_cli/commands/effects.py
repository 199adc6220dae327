# SPDX-License-Identifier: Apache-2.0
"""``impact-rs effects``: the library of physical effects."""

from __future__ import annotations

import argparse
from typing import Any

from rich.table import Table

from impact_rs_cli.parser import PROGRAM
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.effects import Effect, library
from impact_rs_sim.effects.formula import load_formulas
from impact_rs_sim.errors import InputError, did_you_mean


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    effects: dict[str, Effect] = dict(library())
    if args.formulas is not None:
        effects |= load_formulas(args.formulas)
    if args.name is not None and args.name not in effects:
        raise InputError(
            f"no effect {args.name!r}{did_you_mean(args.name, effects)}; known effects: {', '.join(sorted(effects))}"
        )
    chosen = effects if args.name is None else {args.name: effects[args.name]}
    terminal.result({"effects": [_describe(effect) for effect in chosen.values()]})
    if args.name is None:
        table = Table(title=f"Library of physical effects; {PROGRAM} effects NAME explains one")
        table.add_column("effect", no_wrap=True)
        table.add_column("acts on", no_wrap=True)
        table.add_column("description")
        for effect in chosen.values():
            table.add_row(effect.name, effect.acts_on, effect.sentence)
        terminal.say(table)
        return 0
    effect = chosen[args.name]
    phases = "free motion and contact" if len(effect.phases) == 2 else effect.phases[0]
    terminal.say(f"{effect.name}: {effect.sentence}", f"acts on: {effect.acts_on}; seen in: {phases}")
    if effect.calibration:
        purpose = "a fault of a reading; to calibrate it" if effect.of_measurement else "to determine it"
        terminal.say(f"{purpose}: {effect.calibration}")
    table = Table(title="Parameters")
    for heading in ("parameter", "unit", "no effect at", "bounds", "noticeable", "description"):
        table.add_column(heading)
    for parameter in effect.parameters:
        table.add_row(
            parameter.name + (" (per joint)" if parameter.per_joint else ""),
            parameter.unit,
            f"{parameter.nominal:g}",
            f"{parameter.lower:g} ... {parameter.upper:g}",
            f"{parameter.scale:g}",
            parameter.meaning,
        )
    terminal.say(table)
    return 0


def _describe(effect: Effect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "acts_on": effect.acts_on,
        "sentence": effect.sentence,
        "of_measurement": effect.of_measurement,
        "calibration": effect.calibration,
        "phases": list(effect.phases),
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "nominal": parameter.nominal,
                "lower": parameter.lower,
                "upper": parameter.upper,
                "scale": parameter.scale,
                "per_joint": parameter.per_joint,
                "meaning": parameter.meaning,
            }
            for parameter in effect.parameters
        ],
    }
