# SPDX-License-Identifier: Apache-2.0
"""Argument parsers: an error is one line with a suggestion, and a command is imported when it is used."""

from __future__ import annotations

import argparse
import re
import sys
from importlib import import_module
from typing import Any, NoReturn

from impact_rs_sim.errors import did_you_mean, shortened

LONGEST_MESSAGE = 1000  # characters; what the user typed is repeated in it


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one line and suggest the nearest name.

    Every parser has ``--debug``: it may stand before or after the command.
    """

    def __init__(self, *args: Any, **settings: Any) -> None:
        settings.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(*args, **settings)
        self.add_argument(
            "--debug",
            action="store_true",
            default=argparse.SUPPRESS,  # a subparser must not overwrite what its parent has read
            help="show the traceback of an error, and the log",
        )

    def error(self, message: str) -> NoReturn:
        """Print one line and leave with exit code 2."""
        message = shortened(message, LONGEST_MESSAGE)
        print(f"{self.prog}: {message}{self._suggestion(message)} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)

    def _suggestion(self, message: str) -> str:
        """Suggestion: the choice or option nearest to the refused word."""
        if found := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            word, known = found[1], re.findall(r"'(.*?)'", found[2])
        elif found := re.search(r"unrecognized arguments: .*?(--[\w-]+)", message):
            word, known = found[1], self._options()
        else:
            return ""
        return did_you_mean(word, known)

    def _options(self) -> list[str]:
        """Long options of this parser and its subcommands."""
        options = [option for option in self._option_string_actions if option.startswith("--")]
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                options += [option for parser in action.choices.values() for option in parser._options()]
        return options


class CommandParser(Parser):
    """Parser of one command, which its module completes when the command is used.

    Args:
        module: Name of the module; its ``add(parser)`` is called.
    """

    def __init__(self, *args: Any, module: str, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._module: str | None = module

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse with the arguments that the module of the command declares."""
        if self._module is not None:
            module, self._module = import_module(self._module), None
            module.add(self)
        for argument in args or ():
            if not argument or re.fullmatch(r"--?[\w-]+=", argument):  # a variable of a shell that is not set
                self.error(f"an argument is empty ({argument!r}): expected a value")
        return super().parse_known_args(args, namespace)
