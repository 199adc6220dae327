# SPDX-License-Identifier: Apache-2.0
"""Cache of files that several readers use.

    with files_read_once():
        ...   # candidates, raw numbers, and the run as its mapping describes it

Functions under :func:`once` then keep their newest results, up to a total size of their files, as long as a file does
not change its size or modification time. Callers must not change the returned values.
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

MAX_CACHED_BYTES = 200_000_000  # sizes of the files; numbers of a text take a few times as much memory

_cache: ContextVar[dict[tuple[Any, ...], tuple[int, Any]] | None] = ContextVar("_cache", default=None)


@contextmanager
def files_read_once() -> Iterator[None]:
    """Keep read files until the end of the block."""
    token = _cache.set({})
    try:
        yield
    finally:
        _cache.reset(token)


def once(read: Callable[Concatenate[Path, P], T]) -> Callable[Concatenate[Path, P], T]:
    """A reader of a file whose result is kept within :func:`files_read_once`."""

    @functools.wraps(read)
    def reading(path: Path, *args: P.args, **options: P.kwargs) -> T:
        cache = _cache.get()
        if cache is None or not path.exists():
            return read(path, *args, **options)
        state = path.stat()
        key = (read.__module__, read.__name__, path, state.st_mtime_ns, state.st_size, repr(args), repr(options))
        if key not in cache:
            cache[key] = (state.st_size, read(path, *args, **options))
            while len(cache) > 1 and sum(size for size, _ in cache.values()) > MAX_CACHED_BYTES:
                del cache[next(iter(cache))]
        result: T = cache[key][1]
        return result

    return reading
