# SPDX-License-Identifier: Apache-2.0
"""Least-recently-used (LRU) cache."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Result = TypeVar("Result")

# One lock for all caches, because a result of one cache may need another cache, and a lock cannot be pickled with its
# cache.
_lock = threading.RLock()


class Recent(Generic[Result]):
    """The most recently used results by key.

    Args:
        most: Capacity.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: OrderedDict[Hashable, Result] = OrderedDict()

    def of(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The result for a key, computed by ``make`` if missing; threads wait for each other."""
        with _lock:
            if key not in self._results:
                self._results[key] = make()
                if len(self._results) > self._most:
                    self._results.popitem(last=False)
            self._results.move_to_end(key)
            return self._results[key]
