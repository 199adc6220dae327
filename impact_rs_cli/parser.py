# SPDX-License-Identifier: Apache-2.0
"""Argument parsers, made from the declarations of commands; an error is one line with a suggestion."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from impact_rs_commands import command_named
from impact_rs_commands.declaration import READ, WRITTEN, Command, Option
from impact_rs_sim.errors import did_you_mean, shortened

MAX_USAGE_CHARACTERS = 1000  # of an error that repeats the user's words
PROGRAM = os.environ.get("IMPACT_RS_PROGRAM", "impact-rs")  # how hints spell it: ./run sets "./run impact-rs"


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one line and suggest the nearest name.

    Every parser has ``--debug``: it may stand before or after the command.
    """

    def __init__(self, *args: Any, **settings: Any) -> None:
        settings.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        settings.setdefault("allow_abbrev", False)  # a shortened option may be a mistyped one, and start hours of work
        super().__init__(*args, **settings)
        self.add_argument(
            "--debug",
            action="store_true",
            default=argparse.SUPPRESS,  # a subparser must not overwrite what its parent has read
            help="show the traceback of an error, and the log",
        )

    def error(self, message: str) -> NoReturn:
        """Print one line and leave with exit code 2."""
        message = shortened(message, MAX_USAGE_CHARACTERS)
        print(f"{self.prog}: {message}{self._suggestion(message)} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)

    def _suggestion(self, message: str) -> str:
        """Suggestion: the choice or option nearest to the refused word."""
        if match := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            word, choices = match[1], re.findall(r"'(.*?)'", match[2])
        elif match := re.search(r"unrecognized arguments: .*?(--[\w-]+)", message):
            word, choices = match[1], self._options()
        else:
            return ""
        return did_you_mean(word, choices)

    def _options(self) -> list[str]:
        """Long options of this parser and its subcommands."""
        options = [option for option in self._option_string_actions if option.startswith("--")]
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                options += [option for parser in action.choices.values() for option in parser._options()]
        return options


class CommandParser(Parser):
    """Parser of one command, which gets its arguments when the command is used.

    Args:
        command: The command.
        helped: Whose help it has; None: its own.
    """

    def __init__(self, *args: Any, command: Command, helped: Command | None = None, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._command: Command | None = command
        self._help = helped or command

    def complete(self) -> CommandParser:
        """The parser with the arguments of its command."""
        if self._command is None:
            return self
        command, self._command = self._command, None
        self.description = spelled(self._help.help_text)
        self.set_defaults(command=command, resumable=command.resumable)
        for option in command.options:
            _add(self, option)
        if command.actions:
            actions = self.add_subparsers(title="actions", metavar="ACTION", required=True, parser_class=CommandParser)
            for action in command.actions:
                actions.add_parser(action.name.split()[-1], help=action.summary, command=action, helped=command)
        return self

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse with the arguments of the command."""
        self.complete()
        for argument in args or ():
            if not argument or re.fullmatch(r"--?[\w-]+=", argument):  # a variable of a shell that is not set
                self.error(f"an argument is empty ({argument!r}): expected a value")
        return super().parse_known_args(args, namespace)


def spelled(text: str) -> str:
    """A text of a declaration with the program as the user calls it."""
    return re.sub(r"\bimpact-rs(?= [a-z])", lambda _: PROGRAM, text)


def command_line(words: str, values: Mapping[str, Any]) -> str:
    """A command with values of its options, as a line for a terminal that reads them back.

    Args:
        words: The command, for example ``robot check``.
        values: Values by name of the option; values of unknown options are ignored.
    """
    return shlex.join([*shlex.split(PROGRAM), *command_named(words).words(values)])


def _add(parser: argparse.ArgumentParser, option: Option) -> None:
    """Add one argument."""
    settings: dict[str, Any] = {"help": spelled(option.help_text).replace("%", "%%") or None}
    if option.kind in ("switch", "json"):
        parser.add_argument(*option.flags, dest=option.name, action="store_true", **settings)
        return
    settings |= {"type": _type(option), "metavar": option.metavar or None, "choices": option.choices or None}
    settings["default"] = list(option.default) if isinstance(option.default, tuple) else option.default
    if option.many:
        settings["nargs"] = "+"
    if option.flags:
        settings |= {"dest": option.name, "required": option.required}
    elif not option.required:
        settings["nargs"] = "?"
    parser.add_argument(*(option.flags or (option.name,)), **settings)


def _type(option: Option) -> Callable[[str], Any]:
    """Function that reads a value; argparse reads defaults that are texts with it, too."""
    if option.former:
        return lambda text: dict(option.former).get(text, text)
    if option.kind in (*READ, *WRITTEN) and not option.url:
        return Path
    read: Callable[[str], Any] = {"whole": int, "number": float}.get(option.kind, str)
    return read if option.least is None else _from(option.least, read)


def _from(least: float, read: Callable[[str], float]) -> Callable[[str], float]:
    """``read``, which refuses numbers below the least one."""

    def checked(text: str) -> float:
        value = read(text)
        if not value >= least:
            raise argparse.ArgumentTypeError(f"expected at least {least:g}, got {text}")
        return value

    checked.__name__ = read.__name__  # argparse names it in the error about a text that is no number
    return checked
