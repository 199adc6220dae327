# SPDX-License-Identifier: Apache-2.0
"""Jobs: a command runs, tells how far it is, can be stopped and goes on; its record outlives page and server."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from processes import until
from starlette.testclient import TestClient

from impact_rs_sim.errors import InputError
from impact_rs_workbench.jobs import LOST, Job, Jobs, Order
from impact_rs_workbench.remaining import Remaining, remaining, shown
from impact_rs_workbench.server import Workbench

CAMPAIGN = {"command": "campaign", "scenario": "push", "objects": ["cat_food"], "cases": ["case_2"], "scales": [1.0]}


@pytest.fixture
def jobs(tmp_path: Path) -> Jobs:
    return Jobs(tmp_path / "jobs", "impact-rs")


def order(*words: str, writes: tuple[Path, ...] = ()) -> Order:
    return Order("measure", words, writes)


def test_a_job_is_the_command_it_tells_and_keeps_its_output(jobs: Jobs) -> None:
    job = jobs.wait(jobs.start(order("effects", "object_mass")).number)
    assert (job.command, job.exit_code, job.line) == ("impact-rs effects object_mass", 0, "")
    assert "object_mass: " in jobs.log(job.number)


def test_a_running_job_says_that_it_has_printed_more(jobs: Jobs, tmp_path: Path) -> None:
    """So a page that shows its output asks for it again."""
    job = jobs.start(order("workbench", str(tmp_path / "other"), "--no-browser"))
    until(lambda: (jobs.all()[0]["printed"] or 0) >= len("http://"), lambda: time.sleep(0.05))
    assert jobs.log(job.number).count("http://") == 1
    jobs.stop(job.number)
    jobs.wait(job.number)
    assert jobs.all()[0]["printed"] is None


def test_a_job_that_fails_tells_its_one_line(jobs: Jobs) -> None:
    job = jobs.wait(jobs.start(order("effects", "object_mas")).number)
    assert job.exit_code == 2
    assert job.line.startswith("no effect 'object_mas'; did you mean 'object_mass'?")
    job = jobs.wait(jobs.start(order("effects", "--nonsense")).number)
    assert (job.exit_code, job.line) == (2, "unrecognized arguments: --nonsense (see impact-rs --help)")


def test_a_campaign_tells_how_far_it_is_stops_as_ctrl_c_does_and_goes_on(
    client: TestClient, workbench: Workbench, tmp_path: Path
) -> None:
    trials = 4 * len(os.sched_getaffinity(0))  # each process has some left when the first is done
    started = client.post("/api/jobs", json=CAMPAIGN | {"output": "campaigns/push", "trials": trials})
    assert started.status_code == 200
    number = started.json()["number"]

    def first() -> dict[str, Any]:
        return client.get("/api/jobs").json()[0]  # type: ignore[no-any-return]

    def pause() -> None:
        time.sleep(0.05)  # who asks all the time keeps what is waited for from running

    until(lambda: (first()["progress"] or {}).get("done"), pause)
    assert first()["progress"]["what"] == "trials"
    assert first()["progress"]["total"] == trials
    assert first()["progress"]["left"] > 0.0
    client.post(f"/api/jobs/{number}/stop")
    stopped = workbench.jobs.wait(number)
    assert stopped.exit_code == 130
    assert stopped.line == "interrupted; the same command goes on where it stopped"
    bags = {path.name for path in (tmp_path / "campaigns" / "push").iterdir() if path.name.startswith("cat_food")}
    assert 1 <= len(bags) < trials
    stamps = {name: (tmp_path / "campaigns" / "push" / name / "metadata.yaml").stat().st_mtime_ns for name in bags}
    again = client.post(f"/api/jobs/{number}/again").json()
    whole = {"total": trials, "done": trials}
    counted = until(lambda: first()["progress"] or {} if not first()["ended"] else whole, pause)
    assert (counted["total"], counted["done"] >= len(bags)) == (trials, True)  # those that are there count
    assert workbench.jobs.wait(again["number"]).exit_code == 0
    (campaign,) = client.get("/api/workspace").json()["campaigns"]
    assert (campaign["present"], campaign["trials"]) == (trials, trials)
    kept = {name: (tmp_path / "campaigns" / "push" / name / "metadata.yaml").stat().st_mtime_ns for name in bags}
    assert kept == stamps


def test_two_tabs_see_the_same_jobs_and_one_folder_has_one_job_at_a_time(
    client: TestClient, workbench: Workbench
) -> None:
    first = client.post("/api/jobs", json=CAMPAIGN | {"output": "campaigns/push", "trials": 30}).json()
    for output in ("campaigns/push", "campaigns", "campaigns/push/inner"):
        second = client.post("/api/jobs", json=CAMPAIGN | {"output": output})
        assert second.status_code == 400
        assert "job 1 (campaign) is writing to" in second.json()["error"]
    assert [job["number"] for job in client.get("/api/jobs").json()] == [1]
    client.post(f"/api/jobs/{first['number']}/stop")
    client.post(f"/api/jobs/{first['number']}/stop")  # the other tab
    assert workbench.jobs.wait(1).exit_code in (130, 1)
    assert client.post("/api/jobs/1/stop").json()["exit_code"] in (130, 1)


def test_jobs_that_are_not_there_are_told_in_one_line(client: TestClient) -> None:
    for path in ("stop", "again"):
        assert client.post(f"/api/jobs/7/{path}").json() == {"error": "no job 7; there are 0"}
    assert client.get("/api/jobs/7/log").json() == {"error": "no job 7; there are 0"}


def test_the_time_left_of_a_resumed_job_is_that_of_what_it_does_itself(jobs: Jobs) -> None:
    jobs.folder.mkdir()
    job = Job(1, "measure", "impact-rs campaign", ("campaign",), (), 0.0)
    (jobs.folder / "0001").mkdir()
    found = {"what": "trials", "done": 7, "total": 10, "first": 6, "since": 100.0, "at": 105.0, "ranking": []}
    (jobs.folder / "0001" / "progress.json").write_text(json.dumps(found))
    expected = {"what": "trials", "done": 7, "total": 10, "share": 0.7, "left": 15.0, "ranking": []}
    assert jobs._progress(job) == expected
    (jobs.folder / "0001" / "progress.json").write_text(json.dumps(found | {"done": 6}))
    assert (jobs._progress(job) or {})["left"] is None


USUAL = {"reading": 10.0, "fit": 30.0}


def reported(what: str, done: int, total: int, stages: dict[str, float]) -> dict[str, Any]:
    return {"what": what, "done": done, "total": total, "first": 0, "since": 0.0, "at": stages[what], "stages": stages}


def test_a_job_of_several_stages_counts_as_a_whole() -> None:
    """A quarter of the usual time, then a job that is twice as slow as the usual one."""
    half = remaining(reported("reading", 5, 10, {"reading": 5.0}), USUAL, 5.0)
    assert (half.left, half.share) == (35.0, 5.0 / 40.0)
    slow = remaining(reported("fit", 1, 4, {"reading": 20.0, "fit": 15.0}), USUAL, 35.0)
    assert (slow.left, slow.share) == (45.0, 35.0 / 80.0)


def test_the_time_left_falls_from_look_to_look_unless_it_was_far_wrong() -> None:
    first = Remaining(0.0, 0.5, 30.0)
    assert shown(first, Remaining(1.0, 0.4, 32.0)) == Remaining(1.0, 0.5, 29.0)
    assert shown(first, Remaining(1.0, 0.6, 20.0)) == Remaining(1.0, 0.6, 20.0)
    assert shown(first, Remaining(1.0, 0.6, 90.0)) == Remaining(1.0, 0.6, 90.0)


def test_a_job_killed_by_a_signal_has_the_exit_code_of_a_shell(jobs: Jobs, tmp_path: Path) -> None:
    number = jobs.start(order("blind", "make", "1", "-o", str(tmp_path / "blind"), writes=(tmp_path / "blind",))).number
    os.killpg(jobs._processes[number].pid, signal.SIGKILL)
    assert jobs.wait(number).exit_code == 137


def test_a_number_that_was_given_is_not_given_again(jobs: Jobs) -> None:
    for name in ("0002", "0005"):
        (jobs.folder / name).mkdir(parents=True)
    assert jobs.wait(jobs.start(order("effects", "object_mass")).number).number == 6


def test_records_outlive_the_workbench_and_lost_jobs_have_ended(jobs: Jobs) -> None:
    done = jobs.wait(jobs.start(order("effects", "object_mass")).number)
    record = jobs.folder / "0001" / "job.json"
    lost = json.loads(record.read_text()) | {"number": 2, "ended": None, "exit_code": None}
    (jobs.folder / "0002").mkdir()
    (jobs.folder / "0002" / "job.json").write_text(json.dumps(lost))
    (jobs.folder / "0003").mkdir()
    (jobs.folder / "0003" / "job.json").write_text("{")
    later = Jobs(jobs.folder, "impact-rs")
    assert later.get(1) == done
    assert (later.get(2).exit_code, later.get(2).line) == (130, LOST)
    assert [job["number"] for job in later.all()] == [2, 1]
    assert later.wait(later.again(2).number).exit_code == 0


def test_a_job_that_runs_is_not_started_again(jobs: Jobs, tmp_path: Path) -> None:
    number = jobs.start(order("blind", "make", "1", "-o", str(tmp_path / "blind"), writes=(tmp_path / "blind",))).number
    with pytest.raises(InputError, match="job 1 is still running"):
        jobs.again(number)
    jobs.close()
    assert not jobs.get(number).runs


def test_the_end_of_the_workbench_stops_its_jobs(workbench: Workbench, client: TestClient) -> None:
    client.post("/api/jobs", json=CAMPAIGN | {"output": "campaigns/push", "trials": 30})
    workbench.jobs.close()
    assert workbench.jobs.get(1).exit_code not in (None, 0)
