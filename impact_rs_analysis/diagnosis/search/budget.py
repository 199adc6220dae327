# SPDX-License-Identifier: Apache-2.0
"""Processor time that a diagnosis may take, and what it left out to stay within it.

A search asks between two fits whether its time is spent. From then on it keeps the best answer so far, begins nothing
new, and notes what it did not try. The limit is exceeded by the step at hand, and by the fit that is reported
(:meth:`Budget.without_limit`). After a request to stop, as by Ctrl-C, no time is left, except in worker processes,
which have a copy of the request.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

SEARCH_TIME_SHARE = 0.5  # of the processor time; the hold-out, without which nothing is named, repeats the search

Clock = Callable[[], float]


class StopRequest:
    """Whether a user has asked for the best answer so far."""

    made = False

    def __call__(self) -> bool:
        """Whether the request was made."""
        return self.made


NEVER_STOPPED = StopRequest()


class Budget:
    """Processor time of one search.

    Args:
        limit: Processor time from now on [s].
        clock: Processor time that was spent by this process, and by its workers if there are any [s].
        stop: Request of the user; once it is made, no time is left.

    Attributes:
        left_out: Parts of the search that were not tried because the time was spent, in words, in order.
    """

    def __init__(
        self, limit: float = math.inf, clock: Clock = time.process_time, stop: StopRequest = NEVER_STOPPED
    ) -> None:
        self.limit, self.clock, self.stop = limit, clock, stop
        self._begin = None if math.isinf(limit) else clock()
        self.left_out: dict[str, None] = {}

    @property
    def remaining(self) -> float:
        """Processor time that is left, not below 0 [s]."""
        if self.stop():
            return 0.0
        return math.inf if self._begin is None else max(0.0, self.limit - (self.clock() - self._begin))

    @property
    def spent(self) -> bool:
        """Whether the time is spent, so that nothing new may start."""
        return self.remaining <= 0.0

    def leaves_out(self, what: str) -> bool:
        """Whether the time is spent; then ``what`` is noted as not tried."""
        if self.spent:
            self.left_out[what] = None
            return True
        return False

    def part(self, share: float) -> Budget:
        """A share of the remaining time; what it leaves out is listed here as well."""
        found = Budget(share * self.remaining, self.clock, self.stop)
        found.left_out = self.left_out
        return found

    def without_limit(self) -> Budget:
        """Unlimited time for a fit that is reported, unless the user stops it; what it leaves out is listed here."""
        found = Budget(clock=self.clock, stop=self.stop)
        found.left_out = self.left_out
        return found

    def add(self, *left_out: str) -> None:
        """Note what a part of the work did not try."""
        self.left_out.update(dict.fromkeys(left_out))


UNLIMITED = Budget()
