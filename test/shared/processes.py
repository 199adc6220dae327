# SPDX-License-Identifier: Apache-2.0
"""Processes beside a test, whose output is read without waiting for ever."""

from __future__ import annotations

import itertools
import os
import re
import signal
import subprocess
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import Any

PATIENCE = 100.0  # s, for a line or the end of a process; never reached on a machine that works


def until(condition: Callable[[], Any], step: Callable[[], Any], what: str = "nothing comes") -> Any:
    """What the condition returns once it is true; until then ``step`` is called."""
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        step()
    return found


def killed_at_file(work: Callable[[], object], which: int | str, after: bool) -> bool:
    """Do work in a fork of this process, which is killed (SIGKILL) at a file that it writes.

    Args:
        work: What to do.
        which: The file: its number, counted from 1, or its name, the first time.
        after: Whether to kill just after the file has got its name, and not just before.

    Returns:
        Whether it was killed; False: it has ended well without that file.
    """
    child = os.fork()
    if child == 0:
        try:
            _kill_at(which, after)
            work()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    assert code in (0, -signal.SIGKILL), f"it has failed with {code}"
    return code != 0


def _kill_at(which: int | str, after: bool) -> None:
    """Kill this process when a file gets its name."""
    replace, numbers = Path.replace, itertools.count(1)

    def killing(self: Path, target: Path) -> Path:
        due = which in (next(numbers), target.name)
        if due and not after:
            os.kill(os.getpid(), signal.SIGKILL)
        found = replace(self, target)
        if due:
            os.kill(os.getpid(), signal.SIGKILL)
        return found

    Path.replace = killing  # type: ignore[method-assign, assignment]


class Running:
    """A process, and the lines that it prints.

    Attributes:
        process: The process.
        printed: What it has printed and was read, by line.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.printed: list[str] = []
        self._lines: Queue[str] = Queue()
        Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)
        self._lines.put("")

    def line(self, text: str = "") -> str:
        """The next line that holds this text, when it comes."""
        while True:
            try:
                line = self._lines.get(timeout=PATIENCE)
            except Empty:
                raise AssertionError(f"no {text!r} within {PATIENCE:g} s after {self.printed}") from None
            assert line, f"ended without {text!r} after {self.printed}"
            self.printed.append(line)
            if text in line:
                return line

    def address(self) -> str:
        """The address of the page that it serves, once it prints one."""
        found = re.search(r"http://\S+", self.line("http://"))
        assert found
        return found[0]

    def end(self, signal_number: int = 0) -> tuple[int, str]:
        """Exit code and everything that was printed, when the process has ended, by itself or by this signal."""
        if signal_number:
            self.process.send_signal(signal_number)
        code = self.process.wait(PATIENCE)
        while line := self._lines.get(timeout=PATIENCE):
            self.printed.append(line)
        self._lines.put("")
        return code, "".join(self.printed)


@contextmanager
def running(
    command: list[str], environment: Mapping[str, str] | None = None, end: int = signal.SIGTERM, **options: Any
) -> Iterator[Running]:
    """A process, which this signal ends with the context.

    Args:
        command: Program and arguments.
        environment: Variables beside those of this process.
        end: The signal.
        options: Others of ``subprocess.Popen``.
    """
    surroundings = os.environ | {"PYTHONUNBUFFERED": "1"} | dict(environment or {})
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, env=surroundings, **pipes | options) as process:
        try:
            yield Running(process)
        finally:
            process.send_signal(end)
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
