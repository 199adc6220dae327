# SPDX-License-Identifier: Apache-2.0
"""The full diagnosis that a change calls for: ``impact-rs diagnose --since`` in a process of its own.

That process holds one end of a pipe as its standard input. The other end is closed when the process that started it has
ended, however that was, and then the diagnosis ends as by Ctrl-C, with its workers.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from impact_rs_analysis.diagnosis.document import read_document
from impact_rs_analysis.following.documents import ChangeDiagnosis
from impact_rs_cli import main as program
from impact_rs_cli.parser import command_line
from impact_rs_commands.explaining import DIAGNOSE
from impact_rs_sim.errors import InputError

DIAGNOSIS_STOP_TIMEOUT_S = 5.0  # of a diagnosis that is being stopped
ORPHAN_KILL_TIMEOUT_S = 60.0  # of one whose follower has ended: a kill leaves its folder behind


@dataclass(frozen=True)
class _Running:
    """A diagnosis that has been started."""

    since: str
    process: subprocess.Popen[bytes]
    errors: IO[bytes]
    makes_folder: bool


class FullDiagnosis:
    """Starts, stops and reads the diagnosis of the hits since a change, one at a time.

    Args:
        options: Options of ``impact-rs diagnose`` by name, without ``since`` and ``output``.
        folder: Folder of its files.
    """

    def __init__(self, options: Mapping[str, Any], folder: Path) -> None:
        self._options, self._folder = options, folder
        self._running: _Running | None = None

    def command(self, since: str) -> str:
        """The command of a terminal that does the same."""
        return command_line("diagnose", self._of(since))

    def file(self, since: str) -> Path:
        """The file of the diagnosis of the hits since one of them."""
        return self._folder / f"diagnosis_since_{re.sub(r'[^A-Za-z0-9.]+', '_', since)}.json"

    @property
    def running(self) -> bool:
        """Whether a diagnosis has been started and its end was not reported yet."""
        return self._running is not None

    def start(self, since: str) -> None:
        """Start the diagnosis of the hits since one of them; a running diagnosis is stopped.

        Raises:
            InputError: No process can be started.
        """
        self.stop()
        errors = tempfile.TemporaryFile()  # noqa: SIM115
        makes_folder = not self._folder.exists()
        cores = max(1, len(os.sched_getaffinity(0)) // 2)  # the next hits are followed meanwhile
        words = DIAGNOSE.words({**self._of(since), "jobs": cores})
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "impact_rs_cli.full_diagnosis", *words],
                stdin=subprocess.PIPE,  # nothing is written; see the module
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,  # so that stopping it reaches its workers, and Ctrl-C of ours does not
            )
        except OSError as error:
            raise InputError(f"no diagnosis can be started: {error}") from None
        self._running = _Running(since, process, errors, makes_folder)

    def ended(self, wait: bool = False) -> ChangeDiagnosis | None:
        """Result of the diagnosis, once; None: it runs, or was not started.

        Args:
            wait: Whether to wait for its end.
        """
        running = self._running
        if running is None or (running.process.poll() is None and not wait):
            return None
        code = running.process.wait()
        self._running = None
        _hang_up(running.process)
        running.errors.seek(0)
        lines = running.errors.read().decode("utf-8", "replace").strip().splitlines()
        running.errors.close()
        verdict, text = "", f"exit code {code}{f': {lines[-1]}' if lines else ''}"
        if code == 0:
            document = read_document(self.file(running.since))
            verdict, text = str(document.verdict), f"{document.verdict}: {document.summary}"
            if document.next_experiment is not None:
                text += f" Next experiment: {document.next_experiment.advice}."
        return ChangeDiagnosis(
            command=self.command(running.since), file=str(self.file(running.since)), verdict=verdict, words=text
        )

    def stop(self) -> None:
        """Stop the running diagnosis, with its workers."""
        running, self._running = self._running, None
        if running is None:
            return
        _hang_up(
            running.process
        )  # it interrupts itself, as soon as it can be: a signal is lost on one that still starts
        if running.process.poll() is None:
            try:
                running.process.wait(DIAGNOSIS_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                os.killpg(running.process.pid, signal.SIGKILL)
                running.process.wait()
        running.errors.close()
        if running.makes_folder:  # a killed diagnosis has not removed it
            with contextlib.suppress(OSError):
                self._folder.rmdir()

    def _of(self, since: str) -> dict[str, Any]:
        """Options of the diagnosis of the hits since one of them."""
        return {**self._options, "since": since, "output": self.file(since)}


def _hang_up(process: subprocess.Popen[bytes]) -> None:
    """Close our end of the pipe of a process that has ended."""
    if process.stdin is not None:
        process.stdin.close()


def _end_with_the_other_end(pipe: int) -> None:
    """Wait until the other end of a pipe is closed; then end this process and its group."""
    os.read(pipe, 1)
    os.killpg(0, signal.SIGINT)
    time.sleep(ORPHAN_KILL_TIMEOUT_S)
    os.killpg(0, signal.SIGKILL)


def main() -> int:
    """Run a command of ``impact-rs`` that ends when the other end of its standard input is closed."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job that a script has put behind it ignores it
    threading.Thread(target=_end_with_the_other_end, args=(sys.stdin.fileno(),), daemon=True).start()
    return program.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
