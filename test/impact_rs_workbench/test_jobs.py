# SPDX-License-Identifier: Apache-2.0
"""Jobs: a command runs, tells how far it is, can be stopped and goes on; its record outlives page and server."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from processes import until
from starlette.testclient import TestClient
from stub_job import Stub

from impact_rs_sim.errors import InputError
from impact_rs_sim.progress import ENDS, HOLD_OUT, SEARCH
from impact_rs_workbench.jobs import LOST, Job, Jobs, Order
from impact_rs_workbench.remaining import Remaining, remaining, smoothed
from impact_rs_workbench.server import Workbench

CAMPAIGN = {"command": "campaign", "scenario": "push", "objects": ["cat_food"], "cases": ["case_2"], "scales": [1.0]}


@pytest.fixture
def jobs(tmp_path: Path) -> Jobs:
    return Jobs(tmp_path / "jobs", "impact-rs")


def order(*words: str) -> Order:
    return Order("measure", words, ())


def test_a_job_is_the_command_it_tells_and_keeps_its_output(jobs: Jobs) -> None:
    job = jobs.wait(jobs.start(order("effects", "object_mass")).number)
    assert (job.command, job.exit_code, job.line) == ("impact-rs effects object_mass", 0, "")
    assert "object_mass: " in jobs.log(job.number)


def test_a_running_job_says_that_it_has_printed_more(workbench: Workbench, stub: Stub) -> None:
    """So a page that shows its output asks for it again."""
    jobs = workbench.jobs
    stub.tells(first="so far", waits=True)
    job = jobs.start(order("compare"))
    until(lambda: (jobs.all()[0]["printed"] or 0) >= len("so far"), pause)
    assert jobs.log(job.number) == "so far"
    stub.go()
    jobs.wait(job.number)
    assert jobs.all()[0]["printed"] is None


def test_a_job_that_fails_tells_its_one_line(jobs: Jobs) -> None:
    job = jobs.wait(jobs.start(order("effects", "object_mas")).number)
    assert job.exit_code == 2
    assert job.line.startswith("no effect 'object_mas'; did you mean 'object_mass'?")
    job = jobs.wait(jobs.start(order("effects", "--nonsense")).number)
    assert (job.exit_code, job.line) == (2, "unrecognized arguments: --nonsense (see impact-rs --help)")


def progress_of(client: TestClient, done: int) -> dict[str, Any]:
    """Progress of the newest job, when it has done so many steps."""

    def found() -> Any:
        told = client.get("/api/jobs").json()[0]["progress"] or {}
        return told if told.get("done") == done else None

    return until(found, pause)  # type: ignore[no-any-return]


def pause() -> None:
    time.sleep(0.05)  # who asks all the time keeps what is waited for from running


def test_a_job_tells_how_far_it_is_stops_as_ctrl_c_does_and_goes_on(
    client: TestClient, workbench: Workbench, stub: Stub, tmp_path: Path
) -> None:
    """Kills a stop that reaches nobody, and a job that continues as another command."""
    stub.tells(total=10, done=4, waits=True)
    started = client.post("/api/jobs", json=CAMPAIGN | {"output": "campaigns/push", "trials": 10})
    assert started.status_code == 200
    number = started.json()["number"]
    told = progress_of(client, 4)
    assert (told["what"], told["total"], told["share"]) == ("trials", 10, 0.4)
    assert client.post(f"/api/jobs/{number}/stop").json()["stopping"]
    stopped = workbench.jobs.wait(number)
    assert (stopped.exit_code, stopped.line) == (130, "interrupted; the same command goes on where it stopped")
    stub.tells(total=10, done=7, waits=True)
    again = client.post(f"/api/jobs/{number}/again").json()
    progress_of(client, 7)
    stub.go()
    job = workbench.jobs.wait(again["number"])
    assert (job.exit_code, job.arguments, job.number) == (0, stopped.arguments, 2)


@pytest.mark.slow
def test_a_real_campaign_stops_and_goes_on_with_the_trials_it_has(client: TestClient, workbench: Workbench) -> None:
    """The stub stands for this one."""
    trials = 4 * len(os.sched_getaffinity(0))  # each process has some left when the first is done
    number = client.post("/api/jobs", json=CAMPAIGN | {"output": "push", "trials": trials}).json()["number"]
    until(lambda: (client.get("/api/jobs").json()[0]["progress"] or {}).get("done"), pause)
    client.post(f"/api/jobs/{number}/stop")
    stopped = workbench.jobs.wait(number)
    assert (stopped.exit_code, stopped.line) == (130, "interrupted; the same command goes on where it stopped")
    bags = list((workbench.workspace.root / "push").glob("cat_food*/metadata.yaml"))
    stamps = [bag.stat().st_mtime_ns for bag in bags]
    assert 1 <= len(bags) < trials
    assert workbench.jobs.wait(client.post(f"/api/jobs/{number}/again").json()["number"]).exit_code == 0
    (campaign,) = client.get("/api/workspace").json()["campaigns"]
    assert (campaign["present"], campaign["trials"]) == (trials, trials)
    assert [bag.stat().st_mtime_ns for bag in bags] == stamps


def test_two_tabs_see_the_same_jobs_and_one_folder_has_one_job_at_a_time(
    client: TestClient, workbench: Workbench, stub: Stub
) -> None:
    stub.tells(waits=True)
    client.post("/api/jobs", json=CAMPAIGN | {"output": "campaigns/push"})
    for output in ("campaigns/push", "campaigns", "campaigns/push/inner"):
        second = client.post("/api/jobs", json=CAMPAIGN | {"output": output})
        assert second.status_code == 400
        assert "job 1 (campaign) is writing to" in second.json()["error"]
    assert [job["number"] for job in client.get("/api/jobs").json()] == [1]
    until(lambda: workbench.jobs.log(1), pause)  # before, it would not take the signal for an interrupt
    for _ in ("a tab", "the other tab"):
        client.post("/api/jobs/1/stop")
    assert workbench.jobs.wait(1).exit_code == 130
    assert client.post("/api/jobs/1/stop").json()["exit_code"] == 130


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
    assert (half.seconds, half.share) == (35.0, 5.0 / 40.0)
    slow = remaining(reported("fit", 1, 4, {"reading": 20.0, "fit": 15.0}), USUAL, 35.0)
    assert (slow.seconds, slow.share) == (45.0, 35.0 / 80.0)


DIAGNOSIS = {"reading bags": 4.0, "sensitivities of all effects": 8.0, SEARCH: 6.0, HOLD_OUT: 18.0, ENDS: 6.0}


def test_what_is_not_expected_to_be_done_takes_no_time() -> None:
    """A model without lack of fit: no search and no hold-out. Kills their usual time, two thirds of the whole."""
    found = reported("sensitivities in free motion", 0, 900, {"reading runs": 4.0, "sensitivities in free motion": 2.0})
    assert remaining(found, DIAGNOSIS, 6.0).seconds == pytest.approx(6.0 + 6.0 + 18.0 + 6.0)
    assert remaining(found | {"empty": [HOLD_OUT, SEARCH]}, DIAGNOSIS, 6.0).seconds == pytest.approx(6.0 + 6.0)


def test_stages_that_alternate_are_one_and_say_nothing_of_the_speed_before_they_are_over() -> None:
    """Kills a pace by a third of a stage, at which a search that is half done takes forever, or no time."""
    stages = {"reading bags": 4.0, "sensitivities of all effects": 8.0, SEARCH: 1.0, "new sensitivities": 1.0}
    found = reported("new sensitivities", 3, 18, stages)
    assert remaining(found, DIAGNOSIS, 14.0).seconds == pytest.approx(4.0 + 18.0 + 6.0)
    after = reported(SEARCH, 1, 6, stages | {SEARCH: 6.0, "new sensitivities": 0.0, HOLD_OUT: 18.0})
    assert remaining(after, DIAGNOSIS, 36.0).seconds == pytest.approx(6.0)  # rivals after the hold-out


def test_the_more_steps_of_a_stage_are_done_the_more_they_say() -> None:
    """Folds of a hold-out take differently long: the first of six says a sixth, all but the last nearly all."""
    stages = {"reading bags": 4.0, "sensitivities of all effects": 8.0, SEARCH: 6.0, HOLD_OUT: 1.0}
    first = remaining(reported(HOLD_OUT, 1, 6, stages), DIAGNOSIS, 19.0).seconds
    assert first == pytest.approx(5.0 / 6.0 * 17.0 + 1.0 / 6.0 * 5.0 + 6.0)
    half = remaining(reported(HOLD_OUT, 3, 6, stages | {HOLD_OUT: 15.0}), DIAGNOSIS, 33.0).seconds
    assert half == pytest.approx(0.5 * 3.0 + 0.5 * 15.0 + 6.0)


def test_the_time_left_falls_from_look_to_look_unless_it_was_far_wrong() -> None:
    first = Remaining(0.0, 0.5, 30.0)
    assert smoothed(first, Remaining(1.0, 0.4, 32.0)) == Remaining(1.0, 0.5, 29.0)
    assert smoothed(first, Remaining(1.0, 0.6, 20.0)) == Remaining(1.0, 0.6, 20.0)
    assert smoothed(first, Remaining(1.0, 0.6, 90.0)) == Remaining(1.0, 0.6, 90.0)


def test_a_job_that_runs_is_not_started_again_and_one_that_is_killed_ends_as_in_a_shell(
    workbench: Workbench, stub: Stub
) -> None:
    jobs = workbench.jobs
    stub.tells(waits=True)
    number = jobs.start(order("blind", "make")).number
    with pytest.raises(InputError, match="job 1 is still running"):
        jobs.again(number)
    os.killpg(jobs._processes[number].pid, signal.SIGKILL)
    assert jobs.wait(number).exit_code == 137


def test_a_job_that_cannot_start_leaves_its_folder_free(workbench: Workbench, stub: Stub, tmp_path: Path) -> None:
    """Kills a job that is known before its process: it would run for ever, lock its folder, and break the end."""
    jobs = workbench.jobs
    with pytest.raises(InputError, match="cannot be started: embedded null byte"):
        jobs.start(Order("blind make", ("a\0b",), (tmp_path,)))
    assert jobs.all() == [] and jobs.close() == []
    assert jobs.wait(jobs.start(Order("blind make", ("ab",), (tmp_path,))).number).exit_code == 0


def test_a_number_that_was_given_is_not_given_again(workbench: Workbench, stub: Stub) -> None:
    for name in ("0002", "0005"):
        (workbench.jobs.folder / name).mkdir(parents=True)
    assert workbench.jobs.start(order("compare")).number == 6


def test_records_outlive_the_workbench_and_lost_jobs_have_ended(workbench: Workbench, stub: Stub) -> None:
    jobs = workbench.jobs
    done = jobs.wait(jobs.start(order("compare")).number)
    record = jobs.folder / "0001" / "job.json"
    lost = json.loads(record.read_text()) | {"number": 2, "ended": None, "exit_code": None}
    for name, text in (("0002", json.dumps(lost)), ("0003", "{")):
        (jobs.folder / name).mkdir()
        (jobs.folder / name / "job.json").write_text(text)
    later = Jobs(jobs.folder, "impact-rs", executable=stub.command)
    assert later.get(1) == done
    assert (later.get(2).exit_code, later.get(2).line) == (130, LOST)
    assert [job["number"] for job in later.all()] == [2, 1]
    assert later.wait(later.again(2).number).exit_code == 0


def test_a_job_goes_on_where_it_began_whatever_folder_the_workbench_starts_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills a relative path that is read from the folder of a later workbench."""
    pwd = (sys.executable, "-c", "import os; print(os.getcwd())")
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path)
    first = Jobs(tmp_path / "jobs", "impact-rs", executable=pwd)
    first.wait(first.start(order("trial")).number)
    monkeypatch.chdir(tmp_path / "inner")
    later = Jobs(tmp_path / "jobs", "impact-rs", executable=pwd)
    job = later.wait(later.again(1).number)
    assert later.log(2) == str(tmp_path)
    assert job.command == f"cd {tmp_path} && impact-rs trial"
    assert later.wait(later.again(2).number).directory == str(tmp_path)


def test_the_end_of_the_workbench_stops_its_jobs(workbench: Workbench, stub: Stub) -> None:
    stub.tells(waits=True)
    workbench.jobs.start(order("compare"))
    until(lambda: workbench.jobs.log(1), pause)
    (ended,) = workbench.jobs.close()
    assert ended == workbench.jobs.get(1) and ended.exit_code == 130
