# SPDX-License-Identifier: Apache-2.0
"""Least-recently-used (LRU) cache."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Made = TypeVar("Made")

# One for all caches: to make one result may need another's, and a lock cannot be pickled with its cache.
_turn = threading.RLock()


class Recent(Generic[Made]):
    """The most recently used results by key.

    Args:
        most: Capacity.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Hashable, Made] = OrderedDict()

    def of(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """The result for a key, made if missing; threads wait for each other."""
        with _turn:
            if key not in self._kept:
                self._kept[key] = make()
                if len(self._kept) > self._most:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(key)
            return self._kept[key]
