# SPDX-License-Identifier: Apache-2.0
"""Output of the commands: terminal, progress bars, and output folders that are removed if they stay empty."""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from impact_rs_commands.declaration import NAMED, READ, WRITTEN, Kind
from impact_rs_sim.errors import InputError
from impact_rs_sim.progress import ProgressFile
from impact_rs_sim.questions import PageQuestions
from impact_rs_trials.store import is_bag, is_url
from impact_rs_workbench.remaining import STAGES, Remaining, remaining, smoothed

Report = Callable[[int, int], None]


class _Output(Console):
    """Standard output for people; raises ``BrokenPipeError``, where :class:`rich.console.Console` ends the program."""

    def on_broken_pipe(self) -> None:
        """Called while that error is handled."""
        raise


def add_word_column(table: Table, heading: str, cells: Iterable[str]) -> None:
    """A column for some cells that is broken between words, never within one."""
    table.add_column(heading, min_width=max((len(word) for cell in cells for word in cell.split()), default=0))


class _TimeLeft(ProgressColumn):
    """Time left of the whole command, of which a bar shows one stage; of the stage where the others are not known."""

    def __init__(self, command: str) -> None:
        super().__init__()
        self._usual = STAGES.get(command, {})
        self._estimate: Remaining | None = None

    def look(self, progress: ProgressFile) -> None:
        """Estimate it from the progress of the command."""
        if progress.document:
            new = remaining(progress.document, self._usual, time.time())
            self._estimate = smoothed(self._estimate if self._usual else None, new)

    def render(self, task: Task) -> Text:
        """The time, which falls until the next estimate."""
        del task
        if self._estimate is None or self._estimate.seconds is None:
            return Text("")
        return Text(f"{max(0.0, self._estimate.seconds - (time.time() - self._estimate.time)):.0f} s left")


class Terminal:
    """Output of a command: text for people, or one JSON document and nothing else on standard output.

    Args:
        as_json: Whether the document is wanted.
        debug: Whether tracebacks are wanted.
        command: Name of the command, for its time left.
    """

    def __init__(self, as_json: bool, debug: bool = False, command: str = "") -> None:
        self.as_json = as_json
        self.debug = debug
        self._document: dict[str, Any] | None = None
        self._errors = Console(stderr=True, highlight=False)
        self._file = ProgressFile()
        self._page = PageQuestions.of_environment()
        self._bars = 0  # that are shown
        self._time_left_column = _TimeLeft(command)

    def result(self, document: dict[str, Any]) -> None:
        """The document of ``--json``; printed when the command has ended."""
        self._document = document

    def say(self, *renderables: Any) -> None:
        """Print for people; silent with ``--json``, and once the reader has left (``| head``)."""
        if self.as_json:
            return
        console = self._errors if self._bars and sys.stdout.isatty() else _Output(highlight=False)  # above the bar
        try:
            for item in renderables:
                console.print(item, soft_wrap=isinstance(item, str), markup=False)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def warn(self, text: str) -> None:
        """One line on standard error."""
        self._errors.print(text, soft_wrap=True, markup=False)

    def ask(self, question: str) -> bool:
        """A question to the operator, at the terminal or the page that started this; False without a clear yes."""
        self._errors.print(f"{question} [y/N] ", end="", markup=False, soft_wrap=True)
        if self._page is not None:
            agreed = self._page.ask(question)
            self._errors.print("yes, in the page" if agreed else "no, or the page was closed")
            return agreed
        if not sys.stdin.isatty():
            self._errors.print("no one to answer")
            return False
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def trace(self, text: str) -> None:
        """A traceback on standard error; silent without ``--debug``."""
        if self.debug and text:
            self.warn(text)

    @contextmanager
    def _bar(self) -> Iterator[Progress]:
        """A bar on standard error, if that is a terminal."""
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            self._time_left_column,
            console=self._errors,
            disable=not self._errors.is_terminal,
            redirect_stdout=False,
            redirect_stderr=False,
        ) as bar:
            self._bars += self._errors.is_terminal
            try:
                yield bar
            finally:
                self._bars -= self._errors.is_terminal

    @contextmanager
    def progress(self, stage: str) -> Iterator[Report]:
        """A bar with the time left on standard error, if that is a terminal."""
        with self._bar() as bar:
            task = bar.add_task(stage, total=None)

            def report(done: int, total: int) -> None:
                bar.update(task, completed=done, total=total)
                self._update(stage, done, total)

            yield report

    def _update(self, stage: str, done: int, total: int | None) -> None:
        self._file.update(stage, done, total)
        self._time_left_column.look(self._file)

    @contextmanager
    def stages(self) -> Iterator[Callable[[str, int, int], None]]:
        """A bar for work in several stages; each call names the stage: (what, done, total)."""
        with self._bar() as bar:
            task = bar.add_task("", total=None)

            def report(stage: str, done: int, total: int) -> None:
                if total > 0:
                    bar.update(task, description=stage, completed=done, total=total)
                self._update(stage, done, total)

            yield report

    def rank(self, name: str, error: float) -> None:
        """Write the error of one candidate explanation to the progress file; the terminal shows none before the end."""
        self._file.rank(name, error)

    @contextmanager
    def owned_output(self) -> Iterator[None]:
        """With ``--json``, whatever a library writes to standard output goes to standard error instead."""
        if not self.as_json:
            yield
            return
        sys.stdout.flush()
        stdout_copy = os.dup(1)
        try:
            os.dup2(2, 1)
            yield
        finally:
            sys.stdout.flush()
            with suppress(OSError, AttributeError):
                ctypes.CDLL(None).fflush(None)  # buffered output of C code
            os.dup2(stdout_copy, 1)
            os.close(stdout_copy)

    def finish(self) -> None:
        """Print the document."""
        if self.as_json and self._document is not None:
            print(json.dumps(self._document, indent=2, allow_nan=False), flush=True)


@contextmanager
def output_folder(path: Path) -> Iterator[Path]:
    """A folder for results; folders that the command created and left empty are removed."""
    missing = []
    for folder in (path, *path.parents):
        if folder.exists():
            break
        missing.append(folder)
    try:
        yield path
    finally:
        for folder in missing:
            with suppress(OSError):  # not empty
                folder.rmdir()


Action = Callable[[argparse.Namespace, Terminal], int]


def check_outputs(args: argparse.Namespace) -> None:
    """Check that results are written neither into a bag, nor over one of their inputs, nor over each other.

    Raises:
        InputError: They would be.
    """
    inputs = {Path(path).resolve() for _, path in _paths(args, READ) if os.path.exists(path)}
    inputs |= {Path(path).resolve() for _, path in _paths(args, NAMED) if os.path.isfile(path)}  # not shipped
    outputs: dict[Path, Kind] = {}
    for kind, path in _paths(args, WRITTEN):
        target = Path(path).resolve()
        if bag := next((folder for folder in (target, *target.parents) if is_bag(folder)), None):
            raise InputError(f"lies inside the bag {bag}; bags are never changed, choose another folder", file=path)
        if target in inputs:
            raise InputError(
                "is an input of this command and would be overwritten; choose another path for the results", file=path
            )
        if "new_file" in (kind, outputs.get(target)) and target in outputs:
            raise InputError("is the path of two results of this command; choose another path for one", file=path)
        outputs[target] = kind


def _paths(args: argparse.Namespace, kinds: tuple[Kind, ...]) -> Iterator[tuple[Kind, str | Path]]:
    """Values of the options of these kinds, with the kind; without URLs."""
    for option in args.command.options:
        value = getattr(args, option.name, None) if option.kind in kinds else None
        for path in value if isinstance(value, (list, tuple)) else (value,):
            if isinstance(path, (str, Path)) and not is_url(path):
                yield option.kind, path


def run(action: Action, args: argparse.Namespace) -> int:
    """Run a command with a terminal; returns its exit code.

    Raises:
        InputError: The user made a mistake.
    """
    check_outputs(args)
    terminal = Terminal(args.json, args.debug, args.command.name)
    with terminal.owned_output():
        code = action(args, terminal)
    terminal.finish()
    return code
