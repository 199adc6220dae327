# SPDX-License-Identifier: Apache-2.0
"""Declarations of commands, the only source of their options, help, forms and command lines.

    argparse parser   impact_rs_cli/parser.py
    form of the page  impact_rs_workbench/forms.py, with its check
    command line      :meth:`Command.words`, which the page shows and a job runs

Only the standard library is imported, and named tuples stand for dataclasses, whose import alone would take a tenth of
the time of ``impact-rs --help``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

Kind = Literal[
    "text", "name", "address", "setting", "whole", "number", "switch", "json",
    "scenario", "mapping", "robot", "object", "case", "effect",
    "runs", "model", "experiment", "diagnosis", "formulas", "file", "folder", "new_file", "new_folder",
]  # fmt: skip

NAMED: tuple[Kind, ...] = ("scenario", "mapping", "robot")  # a name shipped with impact_rs, or a file
READ: tuple[Kind, ...] = ("runs", "model", "experiment", "diagnosis", "formulas", "file", "folder")
WRITTEN: tuple[Kind, ...] = ("new_file", "new_folder")


class Option(NamedTuple):
    """One argument of a command.

    Attributes:
        name: Its name in the program and in a form.
        help: Description without unit and default.
        flags: How a command line spells it; empty: by its position.
        kind: Kind of its value: a number, a name, or a kind of path.
        metavar: How the help writes the value.
        label: How a form calls it.
        unit: Unit; ``-``: a number without one.
        choices: All values that it may have; empty: any of its kind.
        former: Names of choices in earlier versions, with their present names.
        default: Value if it is omitted.
        otherwise: Description of the default; empty: ``default`` itself.
        least: Smallest number.
        most: Largest number.
        required: Whether it must be given.
        many: Whether it takes several values.
        url: Whether its path may be a URL as well.
        advanced: Whether a form shows it among further options.
    """

    name: str
    help: str = ""
    flags: tuple[str, ...] = ()
    kind: Kind = "text"
    metavar: str = ""
    label: str = ""
    unit: str = ""
    choices: tuple[str, ...] = ()
    former: tuple[tuple[str, str], ...] = ()
    default: Any = None
    otherwise: str = ""
    least: float | None = None
    most: float | None = None
    required: bool = False
    many: bool = False
    url: bool = False
    advanced: bool = False

    @property
    def help_text(self) -> str:
        """Description with unit and default."""
        description = f"{self.help} [{self.unit}]" if self.unit else self.help
        values = self.default if isinstance(self.default, tuple) else (self.default,)
        default = self.otherwise or ("" if self.default is None else " ".join(map(str, values)))
        return "; ".join(part for part in (description, f"default: {default}" if default else "") if part)

    def words(self, value: Any) -> list[str]:
        """The option with a value as words of a command line; empty for the default.

        A single word that begins with ``-`` is written ``--option=-word``, so that it is not read as an option.
        """
        words = _words(value)
        if value is None or value is False or (value is not True and (not words or words == _words(self.default))):
            return []
        if self.flags and len(words) == 1 and words[0].startswith("-"):
            return [f"{self.flags[-1]}={words[0]}"]
        return [*self.flags[:1], *words]


class Command(NamedTuple):
    """A command of ``impact-rs``.

    Attributes:
        name: Its word or words, for example ``blind make``.
        summary: Description for the list of commands.
        about: Description for its help; empty: the help of the command above it.
        examples: Command lines; lines with ``#`` explain the next one.
        output: Printed and written results.
        units: Units of the printed numbers.
        options: Its arguments, positional ones first.
        actions: Commands below it.
        module: Module of ``impact_rs_cli.commands`` that runs it; empty: named as its first word.
        function: The function there.
        resumable: Whether the same command goes on after Ctrl-C.
    """

    name: str
    summary: str
    about: str = ""
    examples: str = ""
    output: str = ""
    units: str = ""
    options: tuple[Option, ...] = ()
    actions: tuple[Command, ...] = ()
    module: str = ""
    function: str = "run"
    resumable: bool = False

    @property
    def help_text(self) -> str:
        """The help before the list of arguments; the program is called ``impact-rs`` in it."""
        example = "".join(f"  {line}\n" for line in self.examples.splitlines())
        units = f"\n\nUnits: {self.units}" if self.units else ""
        return f"{self.about}\n\nexample:\n{example}\noutput: {self.output}{units}"

    @property
    def file(self) -> str:
        """Name of the module that runs it."""
        return self.module or self.name.split()[0]

    @property
    def written(self) -> tuple[str, ...]:
        """Names of the options with paths of results."""
        return tuple(option.name for option in self.options if option.kind in WRITTEN)

    def words(self, values: Mapping[str, Any]) -> list[str]:
        """Words of the command line that gives options these values, by name."""
        return [
            *self.name.split(),
            *(word for option in self.options for word in option.words(values.get(option.name))),
        ]


def argument(name: str, help: str = "", **more: Any) -> Option:
    """An option that is given by its position, required unless ``required=False``."""
    return Option(name, help, **{"required": True, **more})


def option(*flags: str, name: str = "", help: str = "", **more: Any) -> Option:
    """An option that is given by a flag, and named after the last one."""
    return Option(name or flags[-1].lstrip("-").replace("-", "_"), help, flags, **more)


def _words(value: Any) -> list[str]:
    """One value or several as words; empty for a switch."""
    if value is None or isinstance(value, bool):
        return []
    return [_word(item) for item in (value if isinstance(value, (tuple, list)) else (value,))]


def _word(value: Any) -> str:
    """The shortest text that is read back as the same value."""
    if not isinstance(value, float):
        return str(value)
    short = f"{value:g}"
    return short if float(short) == value else repr(value)
