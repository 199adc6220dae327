# SPDX-License-Identifier: Apache-2.0
"""Schedulers that run already: used, refused in words, and survived."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import DEVNULL
from typing import TYPE_CHECKING

import pytest

from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_trials.campaign import Manifest, Trial, TrialReport, make_manifest, run_campaign
from impact_rs_trials.workers import MEMORY_LIMIT, SchedulerLost, Workforce, as_they_end, client_of, on_threads, workers

if TYPE_CHECKING:
    from distributed import LocalCluster
from impact_rs_trials.worker import dask_setup


@contextmanager
def cluster(count: int, threads: int = 1) -> Iterator[LocalCluster]:
    """A scheduler on a port of this machine, and workers that are threads of this process."""
    import dask
    from distributed import LocalCluster

    quick = {"distributed.comm.timeouts.connect": "2s"}  # how long its end waits for a scheduler that is gone already
    with (
        dask.config.set(quick),
        LocalCluster(
            n_workers=count,
            threads_per_worker=threads,
            processes=False,
            protocol="tcp",
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            silence_logs=50,
        ) as running,
    ):
        yield running


@contextmanager
def worker_processes(address: str, count: int, scratch: Path) -> Iterator[list[subprocess.Popen]]:
    """Workers as a user starts them."""
    from distributed import Client

    command = [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    started = [subprocess.Popen([*command, "--local-directory", str(scratch)], stderr=DEVNULL) for _ in range(count)]
    try:
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=100)
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.fixture
def manifest() -> Manifest:
    return make_manifest("push", ["cat_food"], ["2"], [0.8, 1.0, 1.2], trials=2)


def test_a_killed_worker_of_a_scheduler_loses_and_doubles_no_trial(tmp_path: Path, manifest: Manifest) -> None:
    def killed_once(directory: Path, trial: Trial) -> TrialReport:
        if trial.key.scale == 1.0:
            with suppress(FileExistsError):
                (directory / "killed").touch(exist_ok=False)
                os.kill(os.getpid(), signal.SIGKILL)
        with (directory / "finished").open("a") as log:
            log.write(f"{trial.key.name}\n")
        (directory / trial.key.name).mkdir()
        return TrialReport(trial.key, "OK")

    with cluster(0) as running, worker_processes(running.scheduler_address, 2, tmp_path / "scratch") as processes:
        reports = list(run_campaign(tmp_path, manifest, Workforce(scheduler=running.scheduler_address), killed_once))
        assert sorted(process.poll() or 0 for process in processes) == [-signal.SIGKILL, 0]
    # A result that died with its worker is asked for again, and then read from the folder that stands for a bag.
    assert {report.message for report in reports} <= {"", "an empty folder"}
    names = sorted(key.name for key in manifest.keys)
    assert sorted(report.key.name for report in reports) == names
    assert sorted((tmp_path / "finished").read_text().split()) == names


def test_a_campaign_can_be_resumed_after_its_scheduler_went_away(tmp_path: Path, manifest: Manifest) -> None:
    def waits_for_the_end(directory: Path, trial: Trial) -> TrialReport:
        if trial.key != manifest.in_order[0]:
            while not (directory / "gone").exists():
                pass
        (directory / trial.key.name).mkdir()
        return TrialReport(trial.key, "OK")

    with cluster(0) as running, worker_processes(running.scheduler_address, 1, tmp_path / "scratch"):
        campaign = run_campaign(
            tmp_path, manifest, Workforce(scheduler=running.scheduler_address), run=waits_for_the_end
        )
        assert next(campaign).key == manifest.in_order[0]
        running.sync(running.scheduler.close)
        with pytest.raises(SchedulerLost, match="went away; the same command goes on where it stopped"):
            next(campaign)
        (tmp_path / "gone").write_text("")
    left = list(run_campaign(tmp_path, manifest, run=waits_for_the_end))
    assert manifest.in_order[0] not in [report.key for report in left]
    assert all((tmp_path / key.name).is_dir() for key in manifest.keys)


def test_no_scheduler_is_told_and_leaves_nothing(
    tmp_path: Path, manifest: Manifest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("impact_rs_trials.workers.ANSWER_TIMEOUT_S", 0.5)
    with socket.socket() as taken:  # nobody listens on a socket that is bound alone
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match=f"no scheduler answers at '{address}': expected tcp://host:port"):
            list(run_campaign(tmp_path, manifest, Workforce(scheduler=address)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("address", ["", "nonsense", "foo://host:1", "tcp://127.0.0.1:port"])
def test_an_address_that_is_none_is_told(address: str) -> None:
    before = threading.enumerate()
    with pytest.raises(InputError, match="expected tcp://host:port"), client_of(Workforce(scheduler=address)):
        pass
    assert threading.enumerate() == before  # a client left behind keeps the next one from starting


def test_workers_with_several_threads_are_refused() -> None:
    with (
        cluster(1, threads=2) as running,
        pytest.raises(InputError, match="has 2 threads; expected 1"),
        client_of(Workforce(scheduler=running.scheduler_address)),
    ):
        pass


def test_a_scheduler_without_workers_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("impact_rs_trials.workers.WORKERS_TIMEOUT_S", 0.1)
    with (
        cluster(0) as running,
        pytest.raises(InputError, match=r"has no workers .* --nthreads 1"),
        client_of(Workforce(scheduler=running.scheduler_address)),
    ):
        pass


@pytest.mark.slow
def test_more_tasks_than_the_scheduler_may_know_at_a_time_all_end_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("impact_rs_trials.workers.MAX_PENDING_TASKS", 2)
    with client_of(Workforce(2)) as client:
        assert sorted(as_they_end(client, abs, range(-5, 0))) == [(n, -n) for n in range(-5, 0)]
        limits = {worker["memory_limit"] for worker in client.scheduler_info()["workers"].values()}
    assert MEMORY_LIMIT == "1GiB"
    assert limits == {2**30}


def test_processes_start_when_there_is_work_to_share_and_errors_come_back_with_the_frames_of_their_worker() -> None:
    """A task that a worker cannot even read is an error like any other, and breaks nothing."""

    def process(_: int) -> int:
        return os.getpid()

    def breaks_in_the_worker(value: int) -> int:
        try:
            return 1 // (value - value)
        except ZeroDivisionError:
            raise InputError("expected a number to divide by", key="a.b", value=value) from None

    with workers(Workforce(2)) as map_tasks:
        assert list(map_tasks(process, [])) == []
        assert list(map_tasks(process, [0])) == [os.getpid()]
        assert os.getpid() not in map_tasks(process, [0, 1])
        assert os.getpid() not in map_tasks(process, [0])
        with pytest.raises(ModuleNotFoundError):
            list(map_tasks(_of_a_module_that_workers_do_not_know, [1, 2]))
        with pytest.raises(InputError, match="a.b = 1") as caught:
            list(map_tasks(breaks_in_the_worker, [1, 2]))
        assert list(map_tasks(abs, [-3, -1, -2])) == [3, 1, 2]
    trace = full_traceback(caught.value)
    assert caught.value.key == "a.b" and "in breaks_in_the_worker" in trace and "ZeroDivisionError" in trace


def test_a_declared_task_runs_on_as_many_threads_of_this_process_as_there_are_jobs() -> None:
    """Each of two tasks waits until the other runs as well; results come in the order of the items."""
    both = threading.Barrier(2, timeout=60.0)
    threads = set()

    @on_threads
    def meets_the_other(value: int) -> int:
        threads.add(threading.get_ident())
        both.wait()
        return -value

    with workers(Workforce(2)) as map_tasks:
        assert list(map_tasks(meets_the_other, range(8))) == [0, -1, -2, -3, -4, -5, -6, -7]
    assert len(threads) == 2 and threading.get_ident() not in threads
    assert not [thread for thread in threading.enumerate() if thread.ident in threads]


def test_after_an_error_of_a_declared_task_no_other_begins() -> None:
    begun = []

    @on_threads
    def breaks_at_first(value: int) -> int:
        begun.append(value)
        if value == 0:
            raise InputError("expected another value", key="a", value=value)
        threading.Event().wait(0.05)
        return value

    with workers(Workforce(2)) as map_tasks, pytest.raises(InputError, match="expected another value"):
        list(map_tasks(breaks_at_first, range(100)))
    assert begun[0] == 0 and len(begun) < 50


def test_a_declared_task_goes_to_the_workers_of_a_scheduler() -> None:
    with cluster(1) as running, workers(Workforce(scheduler=running.scheduler_address)) as map_tasks:
        assert list(map_tasks(_name_of_worker, [0])) == [0]


@on_threads
def _name_of_worker(_: int) -> object:
    from distributed import get_worker

    return get_worker().name  # an error where no worker runs this


def _of_a_module_that_workers_do_not_know(value: int) -> int:
    return value


# ---- a worker leaves Ctrl-C to the process that started it ----------------------------------------------------------


def test_a_worker_ignores_the_interrupt_of_the_terminal() -> None:
    before = signal.getsignal(signal.SIGINT)
    try:
        dask_setup(None)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
