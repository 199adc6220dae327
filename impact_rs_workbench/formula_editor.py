# SPDX-License-Identifier: Apache-2.0
"""User-defined effects: checked while they are written, and saved as a file for ``diagnose --formulas``."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from impact_rs_analysis.application.loop_steps import check_formulas
from impact_rs_sim.effects import library
from impact_rs_sim.effects.dimensions import check_units
from impact_rs_sim.effects.formula import FormulaEffect, FormulaFile
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.schema import Schema, parse_yaml, validate
from impact_rs_workbench.workspace import Workspace

UNSAVED = "formulas"  # name of a text without a file, in errors


class FormulaText(Schema):
    """Input of the page."""

    text: str = Field(max_length=100_000, description="YAML of a formula file")
    path: str = Field("", description="where it is kept")


def check(text: str, file: str = UNSAVED) -> dict[str, Any]:
    """Check syntax, units and numbers of formulas, and describe each effect in lines.

    Raises:
        InputError: A formula is wrong; the message names the place in ``file``.
    """
    effects = [FormulaEffect(spec) for spec in validate(FormulaFile, parse_yaml(text, file), file).effects]
    units = {effect.name: check_units(effect.spec) for effect in effects}
    check_formulas(effects, library(), file)
    return {
        "effects": [
            {
                "name": effect.name,
                "sentence": effect.sentence,
                "lines": [
                    *(
                        f"{formula}: {f'gives {unit}' if unit else 'a number in it leaves the unit open'}"
                        for formula, unit in units[effect.name].items()
                    ),
                    *(
                        f"{name}: {spec.lower:g} … {spec.upper:g} {spec.unit}, does nothing at {spec.nominal:g}"
                        for name, spec in effect.spec.parameters.items()
                    ),
                ],
            }
            for effect in effects
        ]
    }


def keep(workspace: Workspace, content: FormulaText) -> str:
    """Write formulas into a file of the folder; an earlier one is replaced.

    Returns:
        The file as it is seen from the folder.

    Raises:
        InputError: They are not right, or the file lies outside the folder.
    """
    path = workspace.inside(content.path)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError("expected a name that ends in .yaml", file=content.path)
    check(content.text, content.path)
    if path.exists() and workspace.name(path) not in workspace.contents().formulas:
        raise InputError("there is a file of another kind; choose another name", file=content.path)
    write_whole(path, content.text)
    return workspace.name(path)
