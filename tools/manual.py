# SPDX-License-Identifier: Apache-2.0
"""Tables of ``docs/`` that follow from declarations: keys of files from their schemas, commands from their parser.

A page has such a table between two lines::

    [//]: # (table: NAME)

    [//]: # (end of table)

``./run python -m tools.manual`` writes all of them, and ``docs/scenarios.md``, ``docs/parameters.md`` and
``docs/python.md``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from impact_rs_commands import COMMANDS
from impact_rs_commands.declaration import Command
from impact_rs_ros import node_parameters
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot import RobotFacts
from impact_rs_sim.scenarios import scenario_docs
from impact_rs_sim.scenarios.scenario_docs import key_table
from impact_rs_trials.recordings.experiment import Experiment
from impact_rs_trials.recordings.mapping import Mapping, SignalSource, TableLayout
from tools import python_reference

DOCS = Path(__file__).resolve().parents[1] / "docs"
BETWEEN = re.compile(r"(\[//\]: # \(table: (\w+)\)\n).*?(\[//\]: # \(end of table\)\n)", re.DOTALL)


def commands() -> str:
    """Every command with its positional and required arguments."""
    lines = ["| Command | What it does |", "|---|---|"]
    for command in COMMANDS.values():
        lines += [_line(action) for action in command.actions or (command,)]
    return "\n".join(lines)


def _line(command: Command) -> str:
    words = [command.name]
    for option in command.options:
        value = option.metavar or option.name.upper()
        if not option.flags:
            words.append(value if option.required else f"[{value}]")
        elif option.required:
            words.append(f"{option.flags[0]} {value}")
    again = "; resumable" if command.resumable else ""
    return f"| `{' '.join(words)}` | {command.summary[:1].upper()}{command.summary[1:]}{again} |"


TABLES: dict[str, Callable[[], str]] = {
    "commands": commands,
    "experiment": lambda: key_table("Key", Experiment),
    "mapping": lambda: key_table("Key of a mapping", Mapping, (SignalSource,)),
    "signal": lambda: key_table("Key of `signals.NAME`", SignalSource, (TableLayout,)),
    "formula": lambda: key_table("Key of an effect", FormulaSpec),
    "model": lambda: key_table("Key of a model", Model, (FormulaSpec,)),
    "robot": lambda: key_table("Key of robot facts", RobotFacts),
}


def with_tables(text: str) -> str:
    """A page with its tables made anew."""
    return BETWEEN.sub(lambda match: f"{match[1]}\n{TABLES[match[2]]()}\n\n{match[3]}", text)


def pages() -> dict[str, str]:
    """Text of every page of the manual, by its name."""
    texts = {path.name: with_tables(path.read_text(encoding="utf-8")) for path in sorted(DOCS.glob("*.md"))}
    return texts | {
        "scenarios.md": scenario_docs.markdown(),
        "parameters.md": node_parameters.markdown(),
        "python.md": python_reference.markdown(),
    }


if __name__ == "__main__":
    for name, text in pages().items():
        if not (DOCS / name).exists() or (DOCS / name).read_text(encoding="utf-8") != text:
            write_whole(DOCS / name, text)
            print(f"docs/{name}")
