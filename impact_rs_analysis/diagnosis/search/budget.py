# SPDX-License-Identifier: Apache-2.0
"""Processor time of a diagnosis, and the steps omitted to stay within it.

A search checks between two fits whether its time is spent. If so, it keeps the best answer so far, starts nothing new,
and lists the steps that it did not try. The current step may exceed the limit, and so may the reported fit
(:meth:`Budget.without_limit`). After a request to stop, as by Ctrl-C, the remaining time is 0, except in worker
processes, which have a copy of the request.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

SEARCH_TIME_SHARE = 0.5  # of the processor time; the other half is for the hold-out, which repeats the search

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
        clock: Processor time of this process and of its workers [s].
        stop: Request of the user; after it the remaining time is 0.

    Attributes:
        left_out: Steps of the search that were not tried because the time was spent, in words, in order.
    """

    def __init__(
        self, limit: float = math.inf, clock: Clock = time.process_time, stop: StopRequest = NEVER_STOPPED
    ) -> None:
        self.limit, self.clock, self.stop = limit, clock, stop
        self._begin = None if math.isinf(limit) else clock()
        self.left_out: dict[str, None] = {}

    @property
    def remaining(self) -> float:
        """Remaining processor time, not below 0 [s]."""
        if self.stop():
            return 0.0
        return math.inf if self._begin is None else max(0.0, self.limit - (self.clock() - self._begin))

    @property
    def spent(self) -> bool:
        """Whether the time is spent; then no new step starts."""
        return self.remaining <= 0.0

    def leaves_out(self, step: str) -> bool:
        """Whether the time is spent; if so, ``step`` is listed as not tried."""
        if self.spent:
            self.left_out[step] = None
            return True
        return False

    def part(self, share: float) -> Budget:
        """A share of the remaining time; steps that it leaves out are listed here as well."""
        budget = Budget(share * self.remaining, self.clock, self.stop)
        budget.left_out = self.left_out
        return budget

    def without_limit(self) -> Budget:
        """Unlimited time for a reported fit, unless the user stops it; steps that it leaves out are listed here."""
        budget = Budget(clock=self.clock, stop=self.stop)
        budget.left_out = self.left_out
        return budget

    def add(self, *left_out: str) -> None:
        """List steps as not tried."""
        self.left_out.update(dict.fromkeys(left_out))


UNLIMITED = Budget()
