# SPDX-License-Identifier: Apache-2.0
"""Start-up of a campaign's worker process (a ``dask`` preload module)."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Ctrl-C goes to every process of a terminal; the one that started the workers stops them in order."""
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
