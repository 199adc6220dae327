# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C of a workbench: one line, whatever its pages and jobs are doing."""

from __future__ import annotations

import json
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from http.cookiejar import CookieJar
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import HTTPCookieProcessor, Request, build_opener

from processes import running, until

from impact_rs_workbench.jobs import RECORD

ENDS = "Ctrl-C ends it and stops running jobs\n"
CAMPAIGN = {"command": "campaign", "scenario": "push", "objects": ["cat_food"], "cases": ["case_2"], "output": "c"}


class Client:
    """A page of a workbench, as far as requests go."""

    def __init__(self, address: str) -> None:
        self._base = address.partition("/?")[0]
        self._opener = build_opener(HTTPCookieProcessor(CookieJar()))
        self._opener.open(address).read()

    def open(self, path: str, data: Any = None) -> Any:
        """An answer, which may be a stream."""
        body = None if data is None else json.dumps(data).encode()
        return self._opener.open(Request(self._base + path, data=body, headers={"origin": self._base}))

    def status(self, path: str, data: Any) -> int:
        """Status of an answer; 0: the server did not take the connection any more."""
        try:
            return int(self.open(path, data).status)
        except HTTPError as error:
            return error.code
        except OSError:
            return 0


def command(folder: Path) -> list[str]:
    return [sys.executable, "-m", "impact_rs_cli.main", "workbench", str(folder), "--no-browser"]


def test_ctrl_c_ends_an_open_page_and_stops_its_jobs_in_one_line_however_often_it_is_pressed(tmp_path: Path) -> None:
    with running(command(tmp_path)) as workbench:
        client = Client(workbench.address())
        events = client.open("/api/events")
        client.open("/api/jobs", CAMPAIGN | {"trials": 300, "scales": [1.0]})
        until(lambda: json.loads(client.open("/api/jobs").read())[0]["progress"], lambda: events.readline())
        for _ in range(3):
            workbench.process.send_signal(signal.SIGINT)
        code, printed = workbench.end()
    assert code == 0
    assert printed.partition(ENDS)[2] == "the workbench has ended; stopped: job 1 (campaign)\n"
    record = json.loads((tmp_path / ".workbench" / "jobs" / "0001" / RECORD).read_text())
    assert record["exit_code"] == 130 and record["ended"] is not None
    events.read()  # it is complete; a connection that breaks off would raise


def test_ctrl_c_waits_for_no_answer_that_takes_long(tmp_path: Path) -> None:
    """Predictions wait for each other; the last of them would come seconds later."""
    question = {"scenario": "push", "object": "cat_food", "case": "case_2"}
    with running(command(tmp_path)) as workbench, ThreadPoolExecutor(20) as pages:
        client = Client(workbench.address())
        client.open("/api/predict", question).read()
        answers = [pages.submit(client.status, "/api/predict", question) for _ in range(20)]
        client.open("/api/jobs").read()
        until(lambda: any(answer.done() for answer in answers), lambda: client.open("/api/jobs").read())
        code, printed = workbench.end(signal.SIGINT)
        statuses = [answer.result() for answer in answers]
    assert (code, printed.partition(ENDS)[2]) == (0, "the workbench has ended; no job was running\n")
    assert set(statuses) <= {200, 503, 0} and statuses.count(503) > 10 and 200 in statuses
