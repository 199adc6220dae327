# SPDX-License-Identifier: Apache-2.0
"""Jobs of a workbench: commands of ``impact-rs``, each with a folder for its record, progress and output.

    .workbench/jobs/0007/job.json        command, what it writes, when it began and ended, exit code
                         progress.json   how far it is (:mod:`impact_rs_sim.progress`)
                         output.txt      what it printed

A job is stopped as by Ctrl-C, and continued by the same command. Two jobs never write into one folder at a time.

A job may ask a question (:mod:`impact_rs_sim.questions`). Only :meth:`Jobs.answer` to the present question can be a
yes; while no page is open, the answer is no.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import Field, StrictBool, StrictInt

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.progress import VARIABLE
from impact_rs_sim.questions import VARIABLE as QUESTIONS
from impact_rs_sim.questions import message_of
from impact_rs_sim.schema import Schema
from impact_rs_workbench.remaining import STAGES, Remaining, remaining, smoothed

RECORD, PROGRESS, OUTPUT = "job.json", "progress.json", "output.txt"
MAX_SHOWN_CANDIDATES = 10  # effects that a running diagnosis shows
MAX_LOG_LINES = 200  # last lines of a log that are shown
MAX_TAIL_BYTES = 40_000  # of a log that is read
MAX_STOP_S = 5.0  # that a stopped job has to end when the workbench ends
MAX_PAGE_GAP_S = (
    3.0  # after the last page has gone, until questions are answered with no: one that is loaded again is back
)
PAGE_POLL_S = 0.1  # between two checks whether a page is open
LOST = "stopped when its workbench ended; run the same command again to continue"


@dataclass(frozen=True)
class Order:
    """A command to be run.

    Attributes:
        step: Name of the command.
        arguments: Arguments of ``impact-rs``, with paths as the job's working directory sees them.
        writes: Files and folders that it writes.
        directory: Its working directory; empty: that of the workbench.
    """

    step: str
    arguments: tuple[str, ...]
    writes: tuple[Path, ...]
    directory: str = ""


@dataclass(frozen=True)
class Job:
    """Record of a job.

    Attributes:
        number: Its number.
        step: Name of the command, in records of earlier versions the step of the loop.
        command: Equivalent command for a terminal.
        arguments: Arguments of ``impact-rs``.
        writes: Files or folders that it writes.
        started: When [s of the wall clock].
        ended: When [s of the wall clock]; None: it runs.
        exit_code: 0 done, 1 not done, 2 a mistake in the input, 130 stopped; None: it runs.
        line: Error in one line; empty: no error.
        stopping: Whether it was asked to stop.
        directory: Its working directory; empty in records of earlier versions.
    """

    number: int
    step: str
    command: str
    arguments: tuple[str, ...]
    writes: tuple[str, ...]
    started: float
    ended: float | None = None
    exit_code: int | None = None
    line: str = ""
    stopping: bool = False
    directory: str = ""

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self.ended is None


class PageAnswer(Schema):
    """Answer of a page to the question of a job."""

    job: StrictInt = Field(description="number of the job")
    question: StrictInt = Field(description="number of the question")
    yes: StrictBool = Field(description="whether it may go on; texts and numbers are no answer")


@dataclass
class _OpenQuestion:
    """Open question of a running job, and the socket for the answer."""

    socket: socket.socket
    number: int = 0
    text: str = ""  # empty: it asks nothing


@dataclass
class Jobs:
    """The jobs of a workbench.

    Args:
        folder: Where their records are.
        program: How a terminal calls ``impact-rs``.
        changed: Called after every change of a job.
        executable: How a job calls it.
    """

    folder: Path
    program: str
    changed: Callable[[], None] = lambda: None
    executable: tuple[str, ...] = (sys.executable, "-m", "impact_rs_cli.main")
    _jobs: dict[int, Job] = field(default_factory=dict)
    _processes: dict[int, subprocess.Popen[bytes]] = field(default_factory=dict)
    _waiters: dict[int, threading.Thread] = field(default_factory=dict)
    _estimates: dict[int, Remaining] = field(default_factory=dict)
    _questions: dict[int, _OpenQuestion] = field(default_factory=dict)
    _open_pages: int = 0
    _last_page_closed: float = -MAX_PAGE_GAP_S  # when the last page was closed [s of the monotonic clock]
    _lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self) -> None:
        """Read the records of earlier workbenches."""
        for path in sorted(self.folder.glob(f"*/{RECORD}")):
            try:
                data = json.loads(path.read_text(encoding="utf-8"))
                job = Job(**(data | {name: tuple(data[name]) for name in ("arguments", "writes")}))
            except (OSError, ValueError, TypeError, KeyError):  # half a record, after a power failure
                continue
            if job.runs:
                job = replace(job, ended=path.stat().st_mtime, exit_code=130, line=LOST)
                self._write_record(job)
            self._jobs[job.number] = job

    def start(self, order: Order) -> Job:
        """Start a command.

        Raises:
            InputError: A job that runs writes to the same place, or the process cannot be started.
        """
        with self._lock:
            for other in self._jobs.values():
                if other.runs and (shared_path := _shared_path(order.writes, other.writes)) is not None:
                    raise InputError(
                        f"job {other.number} ({other.step}) is writing to {shared_path}; wait for it, or stop it"
                    )
            numbers = [
                int(path.name) for path in self.folder.glob("*") if path.name.isdecimal()
            ]  # unreadable ones, too
            number = max(numbers, default=0) + 1
            writes = tuple(str(path) for path in order.writes)
            working_directory = os.getcwd()
            directory = order.directory or working_directory
            line = self.line(order.arguments)
            line = line if directory == working_directory else f"cd {shlex.quote(directory)} && {line}"
            job = Job(number, order.step, line, order.arguments, writes, time.time(), directory=directory)
            try:
                process, connection = self._launch(job)
            except (OSError, ValueError) as error:
                shutil.rmtree(self._folder(number), ignore_errors=True)
                raise InputError(f"the job cannot be started: {error}") from None
            self._jobs[number] = job
            self._processes[number] = process
            self._questions[number] = _OpenQuestion(connection)
            threading.Thread(target=self._take_questions, args=(number,), daemon=True).start()
            thread = threading.Thread(target=self._wait, args=(number, process), daemon=True)
            self._waiters[number] = thread
            thread.start()
        self.changed()
        return job

    def _launch(self, job: Job) -> tuple[subprocess.Popen[bytes], socket.socket]:
        """The process of a new job, and our end of the socket for its questions."""
        folder = self._folder(job.number)
        folder.mkdir(parents=True)
        self._write_record(job)
        connection, job_connection = socket.socketpair()
        try:
            with (folder / OUTPUT).open("wb") as output, job_connection:
                process = subprocess.Popen(
                    [*self.executable, *job.arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    env=os.environ
                    | {VARIABLE: str(folder / PROGRESS), QUESTIONS: str(job_connection.fileno())}
                    | {"COLUMNS": "96", "PYTHONUNBUFFERED": "1"},
                    cwd=job.directory,
                    pass_fds=(job_connection.fileno(),),
                    start_new_session=True,  # so that stopping it reaches its workers, and Ctrl-C of ours does not
                )
        except (OSError, ValueError):
            connection.close()
            raise
        return process, connection

    def line(self, arguments: Sequence[str]) -> str:
        """Arguments of ``impact-rs`` as a line for a terminal."""
        return shlex.join([*shlex.split(self.program), *arguments])

    def again(self, number: int) -> Job:
        """Run the command of an earlier job once more; where it can go on, it does.

        Raises:
            InputError: There is no such job, it still runs, or another job writes to the same place.
        """
        job = self.get(number)
        if job.runs:
            raise InputError(f"job {number} is still running")
        return self.start(Order(job.step, job.arguments, tuple(Path(path) for path in job.writes), job.directory))

    def stop(self, number: int) -> Job:
        """Stop a job as Ctrl-C would; one that has ended stays as it is.

        Raises:
            InputError: There is no such job.
        """
        with self._lock:
            job = self.get(number)
            if job.runs:
                job = self._jobs[number] = replace(job, stopping=True)
                _signal(self._processes[number], signal.SIGINT)
        self.changed()
        return job

    def answer(self, page_answer: PageAnswer) -> Job:
        """Answer the question of a job.

        Raises:
            InputError: There is no such job, or it does not ask this any more.
        """
        number, question, yes = page_answer.job, page_answer.question, page_answer.yes
        job = self.get(number)
        with self._lock:
            asking = self._questions.get(number)
            if asking is None or not asking.text or asking.number != question or (yes and self.get(number).stopping):
                raise InputError(f"job {number} no longer asks this; the answer is ignored")
            asking.text = ""
            with suppress(OSError):  # it has just ended
                asking.socket.sendall((json.dumps({"number": question, "yes": yes}) + "\n").encode())
        self.changed()
        return job

    @contextmanager
    def open_page(self) -> Iterator[None]:
        """Context in which a page is open."""
        with self._lock:
            self._open_pages += 1
        try:
            yield
        finally:
            with self._lock:
                self._open_pages -= 1
                self._last_page_closed = time.monotonic()

    def get(self, number: int) -> Job:
        """A job.

        Raises:
            InputError: There is no job with this number.
        """
        if number not in self._jobs:
            raise InputError(f"no job {number}; there are {len(self._jobs)}")
        return self._jobs[number]

    def wait(self, number: int) -> Job:
        """A job when it has ended."""
        self._waiters[number].join()
        return self.get(number)

    def all(self) -> list[dict[str, Any]]:
        """All jobs, the newest first, with their progress and, while they run, the size of what they printed [byte]."""
        with self._lock:
            jobs = sorted(self._jobs.values(), key=lambda job: -job.number)
        return [
            asdict(job)
            | {"progress": self._progress(job), "printed": self._printed(job), "question": self._question(job)}
            for job in jobs
        ]

    def log(self, number: int) -> str:
        """The last lines that a job has printed.

        Raises:
            InputError: There is no such job.
        """
        self.get(number)
        return "\n".join(_tail(self._folder(number) / OUTPUT)[-MAX_LOG_LINES:])

    def close(self) -> list[Job]:
        """Stop all running jobs, and wait for them; returns them as they have ended."""
        with self._lock:
            running = [number for number, job in self._jobs.items() if job.runs]
        for number in running:
            self.stop(number)
        for number in running:
            self._waiters[number].join(MAX_STOP_S)
            if self._waiters[number].is_alive():
                _signal(self._processes[number], signal.SIGKILL)
                self._waiters[number].join()
        return [self.get(number) for number in running]

    def _wait(self, number: int, process: subprocess.Popen[bytes]) -> None:
        code = process.wait()
        line = "" if code == 0 else _last_words(_tail(self._folder(number) / OUTPUT), code)
        with self._lock:
            code = 128 - code if code < 0 else code  # as a shell reports a signal
            job = replace(self._jobs[number], ended=time.time(), exit_code=code, line=line, stopping=False)
            self._jobs[number] = job
            self._write_record(job)
        self.changed()

    def _take_questions(self, number: int) -> None:
        """Take the questions of a job, one after the other, until it ends."""
        asking = self._questions[number]
        with asking.socket, asking.socket.makefile("r", encoding="utf-8", errors="replace") as lines:
            for line in lines:
                question = message_of(line)
                if question is None:
                    continue
                with self._lock:
                    asking.number, asking.text = int(question["number"]), str(question["text"])
                self.changed()
                self._wait_for_answer(number, asking)
        with self._lock:
            del self._questions[number]
        self.changed()

    def _wait_for_answer(self, number: int, asking: _OpenQuestion) -> None:
        """Wait until a page has answered, or the job has ended; without a page the answer becomes no."""
        while asking.text and self.get(number).runs:
            if not self._open_pages and time.monotonic() - self._last_page_closed >= MAX_PAGE_GAP_S:
                with suppress(InputError):  # answered meanwhile
                    self.answer(PageAnswer(job=number, question=asking.number, yes=False))
            time.sleep(PAGE_POLL_S)

    def _question(self, job: Job) -> dict[str, Any] | None:
        """Open question of a running job; None: it asks nothing."""
        asking = self._questions.get(job.number)
        if asking is None or not asking.text or not job.runs or job.stopping:
            return None
        return {"number": asking.number, "text": asking.text}

    def _folder(self, number: int) -> Path:
        return self.folder / f"{number:04d}"

    def _write_record(self, job: Job) -> None:
        write_whole(self._folder(job.number) / RECORD, json.dumps(asdict(job), indent=2))

    def _progress(self, job: Job) -> dict[str, Any] | None:
        """Progress of a job: its stage, and of the whole job the share that is done and the remaining time."""
        if not job.runs or (stages := self._stages(job)) is None:
            return None
        estimate = smoothed(
            self._estimates.get(job.number), remaining(stages, self._usual_stages(job.step), time.time())
        )
        self._estimates[job.number] = estimate
        stage = {name: stages[name] for name in ("what", "done", "total")}
        return stage | {
            "share": estimate.share,
            "left": estimate.seconds,
            "ranking": stages["ranking"][:MAX_SHOWN_CANDIDATES],
        }

    def _printed(self, job: Job) -> int | None:
        """Size of the output of a running job [byte]; when it has grown, pages read the log again."""
        if not job.runs:
            return None
        with suppress(OSError):
            return (self._folder(job.number) / OUTPUT).stat().st_size
        return None

    def _stages(self, job: Job) -> dict[str, Any] | None:
        """The progress file of a job; None: it has none yet."""
        try:
            document: dict[str, Any] = json.loads((self._folder(job.number) / PROGRESS).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return document

    def _usual_stages(self, step: str) -> dict[str, float]:
        """Seconds of the stages of the last job of a command that was done."""
        done = [job for job in self._jobs.values() if job.step == step and job.exit_code == 0]
        for job in sorted(done, key=lambda job: -job.number):
            if stages := (self._stages(job) or {}).get("stages"):
                return dict(stages)
        return STAGES.get(step, {})


def _shared_path(writes: Sequence[Path], others: Sequence[str]) -> Path | None:
    """A path of ``writes`` that equals, contains or lies in one of ``others``; None: there is no such path."""
    for path in writes:
        for other in map(Path, others):
            if path == other or path in other.parents or other in path.parents:
                return path
    return None


def _signal(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """Send a signal to a job and its workers."""
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:  # it has just ended
        return


def _tail(path: Path) -> list[str]:
    """Lines at the end of a log."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - MAX_TAIL_BYTES))
            return file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return []


def _last_words(lines: Sequence[str], code: int) -> str:
    """The error message of a command."""
    errors = [line for line in lines if re.match(r"impact-rs[\w -]*: ", line)]
    if errors:
        return errors[-1].partition(": ")[2]
    return next((line for line in reversed(lines) if line.strip()), f"exit code {code}")
