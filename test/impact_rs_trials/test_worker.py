# SPDX-License-Identifier: Apache-2.0
"""A worker leaves Ctrl-C to the process that started it."""

import signal

from impact_rs_trials.worker import dask_setup


def test_a_worker_ignores_the_interrupt_of_the_terminal() -> None:
    before = signal.getsignal(signal.SIGINT)
    try:
        dask_setup(None)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
