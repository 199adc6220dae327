# SPDX-License-Identifier: Apache-2.0
"""Workers for independent pure tasks: processes of this machine, or the workers of a ``dask`` scheduler.

Processes take seconds to start, and each makes its own copy of what it needs. Tasks that spend their time in compiled
code without Python's lock are declared by :func:`on_threads`, and run on threads of this process.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from impact_rs_sim.errors import InputError
from impact_rs_sim.version import package_version

if TYPE_CHECKING:
    from distributed import Client

Map = Callable[[Callable[..., Any], Sequence[Any]], Iterator[Any]]
Task = TypeVar("Task", bound=Callable[..., Any])

MEMORY_LIMIT = "1GiB"  # of a local worker process; measured: 0.2 GiB after five trials
ANSWER_TIMEOUT_S = 10.0  # of a scheduler
WORKERS_TIMEOUT_S = 30.0  # until a scheduler has its first worker
MAX_PENDING_TASKS = 1000  # of the scheduler, so that its memory does not grow with a campaign

_on_threads: set[Callable[..., Any]] = set()
_one_trial_at_a_time = threading.Lock()  # trials of one process share models, which are not thread-safe


@dataclass
class _ProcessorTime:
    """Processor time of the finished tasks of workers [s]."""

    seconds: float = 0.0


_worker_time = _ProcessorTime()


class SchedulerLost(RuntimeError):
    """The connection to the scheduler was lost while tasks were pending."""


@dataclass(frozen=True)
class Workforce:
    """Workers to use.

    Attributes:
        jobs: Worker processes of this machine, or threads of this process (:func:`on_threads`); 1: neither.
        scheduler: Address of a running ``dask`` scheduler, whose workers are used instead.

    Raises:
        InputError: Fewer than one job.
    """

    jobs: int = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise InputError(f"jobs = {self.jobs}: expected at least 1 worker process")

    @property
    def in_process(self) -> bool:
        """Whether this process does the work itself."""
        return self.jobs == 1 and self.scheduler is None

    def at_most(self, tasks: int) -> Workforce:
        """The workforce with at most as many processes of this machine as there are tasks."""
        return Workforce(max(1, min(self.jobs, tasks)), self.scheduler)


@contextmanager
def client_of(workforce: Workforce) -> Iterator[Client]:
    """A client of the workforce's scheduler; a cluster of this machine ends with the context.

    Raises:
        InputError: No scheduler answers at that address, or its workers cannot run the tasks.
    """
    from distributed.utils import silence_logging_cmgr

    with silence_logging_cmgr(logging.CRITICAL):
        if workforce.scheduler is None:
            with _local_client(workforce.jobs) as client:
                yield client
        else:
            with _connected(workforce.scheduler) as client:
                _check_workers(client, workforce.scheduler)
                yield client


@contextmanager
def _local_client(jobs: int) -> Iterator[Client]:
    """A client of a quiet cluster of ``jobs`` worker processes on this machine."""
    from distributed import Client, LocalCluster

    with (
        tempfile.TemporaryDirectory(prefix="impact_rs_") as scratch,
        LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,  # dask sets OMP_NUM_THREADS and its like to 1 in worker processes
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # its status port; a fixed one may be taken
            memory_limit=MEMORY_LIMIT,
            local_directory=scratch,
            preload=["impact_rs_trials.worker"],
            config={"distributed.worker.profile.enabled": False},  # it would look at every worker each 10 ms
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _connected(address: str) -> Client:
    from distributed import Client

    expected = "expected tcp://host:port of a running dask scheduler"
    if not address:
        raise InputError(f"--scheduler '': {expected}")
    try:
        # A client that fails to start stays behind with a thread and closes itself whenever it is collected, on
        # whatever thread that happens, even on the starting loop of the next client, which then never starts.
        asyncio.run(_answers(address))
        return Client(address, timeout=ANSWER_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no scheduler answers at {address!r}: {expected} ({error})") from None


async def _answers(address: str) -> None:
    from distributed.comm import connect

    await (await connect(address, timeout=ANSWER_TIMEOUT_S)).close()


def _check_workers(client: Client, address: str) -> None:
    """Check that a scheduler has workers, each with one thread and with this version of the package.

    Raises:
        InputError: It has no such workers.
    """
    try:
        client.wait_for_workers(1, timeout=WORKERS_TIMEOUT_S)
    except TimeoutError:
        start = f"dask worker {address} --nthreads 1 --nworkers N"
        raise InputError(
            f"the scheduler at {address!r} has no workers after {WORKERS_TIMEOUT_S:g} s; start some: {start}"
        ) from None
    for name, worker in client.scheduler_info(n_workers=-1)["workers"].items():
        if worker["nthreads"] != 1:
            raise InputError(
                f"worker {name} has {worker['nthreads']} threads; expected 1, because a trial keeps its process busy: "
                "dask worker --nthreads 1 --nworkers N"
            )
    for name, version in client.run(package_version, on_error="return").items():
        if isinstance(version, Exception):
            raise InputError(f"worker {name} cannot run our tasks ({type(version).__name__}: {version})")
        if version != package_version():
            raise InputError(f"worker {name} has impact-rs {version}; expected {package_version()}, as here")


def on_threads(function: Task) -> Task:
    """Declare a thread-safe task that spends its time outside of Python's lock; threads of this process run it here."""
    _on_threads.add(function)
    return function


@contextmanager
def workers(workforce: Workforce) -> Iterator[Map]:
    """A ``map`` over the workforce that yields results in order.

    Processes of this machine are started at the first call with two or more tasks: starting takes some seconds, and
    earlier errors are reported without that delay. A scheduler is connected immediately.

    Raises:
        InputError: No scheduler answers at that address, or its workers cannot run the tasks.
    """
    if workforce.in_process:
        yield lambda function, items: map(function, items)
        return
    with ExitStack() as stack:
        clients = [] if workforce.scheduler is None else [stack.enter_context(client_of(workforce))]

        def distributed_map(function: Callable[..., Any], items: Sequence[Any]) -> Iterator[Any]:
            if workforce.scheduler is None and function in _on_threads:
                with ThreadPoolExecutor(workforce.jobs) as threads:
                    yield from threads.map(function, items)
                return
            if not clients:
                if len(items) < 2:
                    yield from map(function, items)
                    return
                clients.append(stack.enter_context(client_of(workforce)))
            client = clients[0]
            with warnings.catch_warnings():  # a task has all that it needs with it, so that any worker can run it again
                warnings.filterwarnings("ignore", "Sending large graph")
                futures = client.map(_work, [_packed(function, item) for item in items], pure=False, retries=2)
            for future in futures:
                yield _result(client, future)

        yield distributed_map


def as_they_end(client: Client, function: Callable[..., Any], items: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
    """Yields every item with its result in the order of completion; a task whose worker dies is repeated.

    If its workers die repeatedly, the result is a :class:`distributed.scheduler.KilledWorker`.

    Raises:
        SchedulerLost: The scheduler went away.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    remaining = iter(items)
    pending: dict[Any, Any] = {}

    def submit(item: Any) -> Any:
        future = client.submit(_work, _packed(function, item), pure=False, retries=2)
        pending[future.key] = item
        return future

    completed = as_completed([submit(item) for item in islice(remaining, MAX_PENDING_TASKS)], loop=client.loop)
    for future in completed:
        item = pending.pop(future.key)
        try:
            result = _result(client, future)
        except KilledWorker as error:
            result = error
        for item_to_submit in islice(remaining, 1):
            completed.add(submit(item_to_submit))
        yield item, result


def _packed(function: Callable[..., Any], item: Any) -> bytes:
    """A serialized task; a worker that lacks one of its modules reports that as an error of the task."""
    from distributed.protocol.pickle import dumps

    return bytes(dumps((function, item)))


def processor_time() -> float:
    """Processor time of this process, and of the tasks that its workers have ended [s]."""
    return time.process_time() + _worker_time.seconds


def _work(packed: bytes) -> tuple[Any, float]:
    """Result of a task, and its processor time [s]."""
    function, item = pickle.loads(packed)
    with _one_trial_at_a_time:
        begin = time.thread_time()
        result = function(item)
        return result, time.thread_time() - begin


def _result(client: Client, future: Any) -> Any:
    """Result of a task.

    Raises:
        SchedulerLost: The scheduler went away.
    """
    from distributed.client import FutureCancelledError

    try:
        result, seconds = future.result()
    except FutureCancelledError:
        address = client.scheduler.address if client.scheduler else "its address"
        raise SchedulerLost(f"the dask scheduler at {address} went away") from None
    _worker_time.seconds += seconds
    return result
