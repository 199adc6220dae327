# SPDX-License-Identifier: Apache-2.0
"""Cache of files that several readers use.

    with files_read_once():
        ...   # candidates, raw numbers, and the run as its mapping describes it

Functions under :func:`once` then keep their results, the newest up to a size, as long as a file keeps its size and the
time of its last change. Callers must not change the returned values.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

MAX_KEPT_BYTES = 200_000_000  # sizes of the files; numbers of a text take a few times as much memory

_kept: ContextVar[dict[tuple[Any, ...], tuple[int, Any]] | None] = ContextVar("_kept", default=None)


@contextmanager
def files_read_once() -> Iterator[None]:
    """Keep read files until the end of the block."""
    token = _kept.set({})
    try:
        yield
    finally:
        _kept.reset(token)


def once(read: Callable[Concatenate[Path, P], T]) -> Callable[Concatenate[Path, P], T]:
    """A reader of a file whose result is kept within :func:`files_read_once`."""

    @functools.wraps(read)
    def reading(path: Path, *args: P.args, **options: P.kwargs) -> T:
        kept = _kept.get()
        if kept is None or not path.exists():
            return read(path, *args, **options)
        state = path.stat()
        key = (read.__module__, read.__name__, path, state.st_mtime_ns, state.st_size, repr(args), repr(options))
        if key not in kept:
            kept[key] = (state.st_size, read(path, *args, **options))
            while len(kept) > 1 and sum(size for size, _ in kept.values()) > MAX_KEPT_BYTES:
                del kept[next(iter(kept))]
        found: T = kept[key][1]
        return found

    return reading
