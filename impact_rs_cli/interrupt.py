# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C: the first ends a search with its best answer so far, the second ends the command."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from impact_rs_analysis.diagnosis.search.budget import StopRequest
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.progress import VARIABLE as PROGRESS_FILE

INTERRUPTED = 130  # exit code after SIGINT, as shells have it


@contextmanager
def ends_at_interrupt(terminal: Terminal) -> Iterator[StopRequest]:
    """A request that the first Ctrl-C makes; jobs of a page end at once, and so does a second Ctrl-C.

    Args:
        terminal: Says that the search ends.
    """
    request = StopRequest()
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler or PROGRESS_FILE in os.environ:
        yield request
        return

    def interrupted(*_: object) -> None:
        if request.made:
            raise KeyboardInterrupt
        request.made = True
        terminal.warn("ending with the best answer so far; Ctrl-C again ends at once")

    signal.signal(signal.SIGINT, interrupted)
    try:
        yield request
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
