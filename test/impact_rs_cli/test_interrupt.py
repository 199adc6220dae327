# SPDX-License-Identifier: Apache-2.0
"""The first Ctrl-C asks for the best answer so far, the second ends the command."""

from __future__ import annotations

import os
import signal
from types import SimpleNamespace
from typing import Any

import pytest

from impact_rs_cli.interrupt import ends_at_interrupt
from impact_rs_sim.progress import VARIABLE


@pytest.fixture(autouse=True)
def interrupts_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a terminal, also where a script has started the tests behind it."""
    monkeypatch.delenv(VARIABLE, raising=False)
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_a_search_is_asked_to_end_and_only_then_interrupted() -> None:
    """Kills: the first Ctrl-C ends the command; the second is another request."""
    said: list[str] = []
    terminal: Any = SimpleNamespace(warn=said.append)
    with ends_at_interrupt(terminal) as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop() and "best answer so far" in said[0]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_job_of_a_page_ends_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "progress.json")
    terminal: Any = None
    with ends_at_interrupt(terminal), pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
