# SPDX-License-Identifier: Apache-2.0
"""A workbench in a folder of its own, as the tests of the server and of the page use it."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from pathlib import Path
from threading import Thread

import pytest
import reports
import uvicorn
from browser import Visit, chromium, opened
from page_steps import DESK
from playwright.sync_api import Browser, expect
from processes import PATIENCE
from starlette.testclient import TestClient
from stub_job import Stub

from impact_rs_trials.experiment_plan import write_plan
from impact_rs_trials.snapshot import Snapshot
from impact_rs_workbench.local import listening
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


@pytest.fixture
def stub(workbench: Workbench, tmp_path_factory: pytest.TempPathFactory) -> Stub:
    """Jobs do as they are told, and are done at once unless they are."""
    made = Stub(tmp_path_factory.mktemp("stub"))
    made.tells()
    workbench.jobs.executable = made.command
    return made


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One process for the pages of a file."""
    with chromium() as made:
        yield made


@pytest.fixture
def address(workbench: Workbench) -> Iterator[str]:
    """Serves the workbench beside the test."""
    with listening(0) as listener:
        port = listener.getsockname()[1]
        app = application(workbench, TOKEN, port)
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=1))
        beside = Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        beside.start()
        yield f"http://127.0.0.1:{port}/?token={TOKEN}"
        server.should_exit = True
        beside.join(PATIENCE)


@pytest.fixture
def visit(browser: Browser, address: str) -> Iterator[Visit]:
    """Opens the page at a step, or a tab of it, in a window of its own."""
    with ExitStack() as windows:

        def at(place: str, **options: object) -> object:
            page = windows.enter_context(opened(browser, f"{address}#{place}", **{"viewport": DESK} | options))
            expect(page.locator("#root")).not_to_be_empty()  # the folder has come
            return page

        yield at  # type: ignore[misc]


@pytest.fixture(scope="session")
def prepared(made_once: Callable[..., Path]) -> Path:
    """Results of every kind, as the commands would have written them."""

    def make(folder: Path) -> None:
        for path, write in {
            "reports/seen": reports.comparison,
            "reports/diagnosed": reports.diagnosis,
            "reports/history": reports.REPORTS["history"],
            "limits/push": reports.limits,
            "rehearsals/push": reports.rehearsal,
        }.items():
            write(folder / path)
        reports.investigated(folder / "investigations" / "1")
        (folder / "plans").mkdir()
        write_plan(reports.PLAN, folder / "plans" / "plan_1.yaml")

    return made_once("prepared results", make)


@pytest.fixture
def full(tmp_path: Path, prepared: Path, push_campaign: Path) -> Path:
    """The folder of the workbench with results of every kind and a campaign."""
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    shutil.copytree(push_campaign, tmp_path / "campaigns" / "push")
    return tmp_path
