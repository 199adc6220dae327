# SPDX-License-Identifier: Apache-2.0
"""Questions of a job: a yes is one to this very question, by a page that is open; everything else is a no."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from cell_investigations import about_to_move
from processes import until
from pydantic import ValidationError
from starlette.testclient import TestClient

from impact_rs_sim.errors import InputError
from impact_rs_sim.questions import PageQuestions
from impact_rs_workbench import jobs as module
from impact_rs_workbench.jobs import Jobs, Order, PageAnswer
from impact_rs_workbench.server import Workbench

ASKS = """
import subprocess, sys
from impact_rs_cli.terminal import Terminal
terminal = Terminal(as_json=False)
below = "import os; from impact_rs_cli.terminal import Terminal; print(Terminal(as_json=False).ask('below'))"
inner = subprocess.run([sys.executable, "-c", below], capture_output=True, text=True)
print("below:", inner.stdout.strip(), flush=True)
for text in ("first", "second"):
    print(f"{text}: {terminal.ask(text)}", flush=True)
"""


@pytest.fixture
def asked() -> Callable[[Jobs], int]:
    """Starts a job that asks twice; gives its number."""
    return lambda jobs: jobs.start(Order("investigate", (), ())).number


@pytest.fixture
def jobs(tmp_path: Path) -> Jobs:
    return Jobs(tmp_path / "jobs", "impact-rs", executable=(sys.executable, "-c", ASKS))


def question(jobs: Jobs, text: str) -> int:
    """Number of the question of the newest job, once it is this one."""
    found = until(
        lambda: (one := jobs.all()[0]["question"]) and one["text"] == text and one, lambda: time.sleep(0.02), text
    )
    return int(found["number"])


def answers(jobs: Jobs, job: int) -> list[str]:
    """What the job was answered, when it has ended."""
    assert jobs.wait(job).exit_code == 0, jobs.log(job)
    return [line for line in jobs.log(job).splitlines() if ": " in line and not line.startswith("impact-rs")]


def test_a_yes_is_one_to_the_question_that_stands_and_counts_once(jobs: Jobs, asked: Callable[[Jobs], int]) -> None:
    with jobs.open_page():
        job = asked(jobs)
        first = question(jobs, "first")
        with pytest.raises(InputError, match="no longer asks this"):
            jobs.answer(PageAnswer(job=job, question=first + 1, yes=True))
        jobs.answer(PageAnswer(job=job, question=first, yes=True))
        second = question(jobs, "second")
        for _ in range(2):  # a second click on the first one, in this tab or another
            with pytest.raises(InputError, match="the answer is ignored"):
                jobs.answer(PageAnswer(job=job, question=first, yes=True))
        jobs.answer(PageAnswer(job=job, question=second, yes=False))
        found = answers(jobs, job)
    assert "first: True" in found and "second: False" in found


def test_a_program_that_a_job_starts_asks_no_one(jobs: Jobs, asked: Callable[[Jobs], int]) -> None:
    with jobs.open_page():
        job = asked(jobs)
        for text in ("first", "second"):
            jobs.answer(PageAnswer(job=job, question=question(jobs, text), yes=False))
        assert "below: False" in answers(jobs, job)


def test_a_closed_page_is_a_no(jobs: Jobs, asked: Callable[[Jobs], int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_PAGE_GAP_S", 0.3)
    with jobs.open_page():
        job = asked(jobs)
        question(jobs, "first")
    found = answers(jobs, job)
    assert "first: False" in found and "second: False" in found


def test_where_no_page_was_ever_open_the_answer_is_no(jobs: Jobs, asked: Callable[[Jobs], int]) -> None:
    assert "first: False" in answers(jobs, asked(jobs))


def test_a_page_that_is_loaded_again_or_a_second_one_keeps_the_question(
    jobs: Jobs, asked: Callable[[Jobs], int]
) -> None:
    with ExitStack() as pages:
        pages.enter_context(jobs.open_page())
        job = asked(jobs)
        first = question(jobs, "first")
        pages.close()
        pages.enter_context(jobs.open_page())
        with jobs.open_page():
            pass  # another tab is closed
        jobs.answer(PageAnswer(job=job, question=first, yes=True))
        jobs.answer(PageAnswer(job=job, question=question(jobs, "second"), yes=True))
        assert "first: True" in answers(jobs, job)


def test_a_job_that_is_being_stopped_takes_no_yes(
    jobs: Jobs, asked: Callable[[Jobs], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    with jobs.open_page():
        job = asked(jobs)
        first = question(jobs, "first")
        monkeypatch.setattr(module, "_signal", lambda *_: None)  # the signal is on its way
        jobs.stop(job)
        with pytest.raises(InputError, match="the answer is ignored"):
            jobs.answer(PageAnswer(job=job, question=first, yes=True))
        monkeypatch.undo()
        jobs.stop(job)
        assert jobs.wait(job).exit_code not in (0, None)
    assert jobs.all()[0]["question"] is None


@pytest.mark.parametrize(
    ("line", "agreed"),
    [
        ('{"number": 1, "yes": true}', True),
        ('{"number": 1, "yes": false}', False),
        ('{"number": 1, "yes": "true"}', False),
        ('{"number": 2, "yes": true}', False),
        ('{"number": 1, "yes": true, "but": "not now"}', False),
        ("yes", False),
        ("[1, true]", False),
        ("", False),
    ],
)
def test_only_a_clear_yes_to_this_question_is_one(line: str, agreed: bool) -> None:
    """An empty line; and after it the end of the workbench."""
    ours, its = socket.socketpair()
    asking = PageQuestions(its.detach())
    ours.sendall(f"{line}\n".encode())
    assert asking.ask("May it run?") is agreed
    ours.close()
    assert not asking.ask("And now?")


def test_the_end_of_the_workbench_is_a_no_to_a_question_that_waits() -> None:
    ours, its = socket.socketpair()
    found: list[bool] = []
    waiting = Thread(target=lambda: found.append(PageQuestions(its.detach()).ask("May it run?")))
    waiting.start()
    assert b"May it run?" in ours.recv(1000)
    ours.close()
    waiting.join()
    assert found == [False]


@pytest.mark.parametrize("given", ["", "x", "-1", "987654", "0"])
def test_what_is_no_socket_asks_no_one(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMPACT_RS_QUESTIONS", given)
    assert PageQuestions.of_environment() is None


@pytest.mark.parametrize("yes", ["true", "yes", 1, None, [True]])
def test_an_answer_is_yes_or_no_and_nothing_like_it(client: TestClient, yes: Any) -> None:
    answer = client.post("/api/answer", json={"job": 1, "question": 1, "yes": yes})
    assert answer.status_code == 400 and "yes" in answer.json()["error"]
    with pytest.raises(ValidationError):
        PageAnswer(job=1, question=1, yes=yes)


def test_an_investigation_on_a_cell_asks_in_the_page_and_moves_nothing_without_a_yes(
    client: TestClient, workbench: Workbench, tmp_path: Path
) -> None:
    about_to_move(tmp_path / "cell", tmp_path / "envelope.yaml")
    form = {"command": "investigate", "directory": "cell", "scenarios": ["push"], "via": "cell", "budget": 6}
    with workbench.jobs.open_page():
        started = client.post("/api/jobs", json=form | {"envelope": "envelope.yaml"})
        assert started.status_code == 200, started.json()
        text = "The last run stopped at push/r0: LIMIT. Is the cell safe, the arm at rest, and shall it go on?"
        number = question(workbench.jobs, text)
        assert client.post("/api/answer", json={"job": 1, "question": number, "yes": False}).status_code == 200
        job = workbench.jobs.wait(1)
    assert job.exit_code == 1 and "Nothing was moved" in job.line
    assert (tmp_path / "cell" / "stopped.json").exists() and not (tmp_path / "cell" / "runs").exists()
