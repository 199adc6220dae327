# SPDX-License-Identifier: Apache-2.0
"""A workbench in a folder of its own, as the tests of the server and of the page use it."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from processes import running
from starlette.testclient import TestClient

from impact_rs_trials.snapshot import Snapshot
from impact_rs_workbench.request_guard import Guard
from impact_rs_workbench.server import Workbench, application

PORT, TOKEN = 8123, "the-key-of-the-tests"
HOST = f"127.0.0.1:{PORT}"


@pytest.fixture(autouse=True, scope="session")
def interruptible() -> Iterator[None]:
    """Ctrl-C reaches what the tests start, also where they run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class NoNodes:
    """No nodes."""

    def look(self) -> Snapshot:
        return Snapshot("absent", "nowhere")


@pytest.fixture
def workbench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Workbench]:
    """A workbench of ``tmp_path``, whose jobs end with the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path.parent / "cache"))
    made = Workbench(tmp_path, "impact-rs", lambda _: nullcontext(NoNodes()))
    yield made
    made.jobs.close()


@pytest.fixture
def client(workbench: Workbench) -> TestClient:
    """Somebody who knows the key and asks from the page."""
    app = application(workbench, TOKEN, PORT)
    assert isinstance(app, Guard)
    return TestClient(
        app,
        base_url=f"http://{HOST}",
        headers={"origin": f"http://{HOST}"},
        cookies={app.cookie: TOKEN},
        follow_redirects=False,
    )


@pytest.fixture(scope="session")
def served() -> Iterator[Callable[[Path], str]]:
    """Starts ``impact-rs workbench`` for a folder, and gives its address; all of them end with the tests."""
    with contextlib.ExitStack() as held:

        def start(folder: Path) -> str:
            command = [sys.executable, "-m", "impact_rs_cli.main", "workbench", str(folder), "--no-browser"]
            cache = {"XDG_CACHE_HOME": str(folder.parent / "cache")}
            page = held.enter_context(running(command, cache, signal.SIGINT, cwd=folder.parent))
            return page.address()

        yield start
