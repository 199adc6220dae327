"""A local ``dask.distributed`` cluster for work that splits into pure tasks."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from distributed import Client

Map = Callable[[Callable[..., Any], Sequence[Any]], Iterator[Any]]


@contextmanager
def local_client(jobs: int) -> Iterator[Client]:
    """A client of a quiet cluster of ``jobs`` worker processes on this machine, gone when the context is left.

    Args:
        jobs: Number of worker processes.
    """
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
            memory_limit=0,  # a task needs little memory and keeps none
            local_directory=scratch,
            preload=["impact_rs_analysis.worker"],
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


@contextmanager
def workers(jobs: int) -> Iterator[Map]:
    """A ``map`` over ``jobs`` worker processes that yields results in order; one job runs in this process.

    Args:
        jobs: Number of worker processes.
    """
    if jobs <= 1:
        yield lambda function, items: map(function, items)
        return
    with local_client(jobs) as client:

        def distributed_map(function: Callable[..., Any], items: Sequence[Any]) -> Iterator[Any]:
            futures = client.map(function, list(items), pure=False, retries=2)
            for future in futures:
                yield future.result()

        yield distributed_map
