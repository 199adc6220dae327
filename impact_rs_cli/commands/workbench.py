# SPDX-License-Identifier: Apache-2.0
"""``impact-rs workbench``: the loop as a page in the browser."""

from __future__ import annotations

import argparse
import os
import sys
import threading
from contextlib import AbstractContextManager

from impact_rs_cli.parser import PROGRAM
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_workbench.live_page import SnapshotSource
from impact_rs_workbench.server import serve


def run(args: argparse.Namespace, terminal: Terminal) -> int:
    """Run the command."""
    if args.directory.exists() and not args.directory.is_dir():
        raise InputError("is a file; expected a folder for the workbench", file=args.directory)

    def announce(address: str) -> None:
        terminal.say(f"workbench of {args.directory}: {address}", "Ctrl-C ends it and stops running jobs")

    stopped = serve(args.directory, PROGRAM, _nodes, args.port, not args.no_browser, announce)
    jobs = ", ".join(f"job {job.number} ({job.step})" for job in stopped)
    terminal.say(f"the workbench has ended; stopped: {jobs}" if jobs else "the workbench has ended; no job was running")
    if threading.active_count() > 1:  # a long request, whose answer no page awaits
        sys.stdout.flush()
        os._exit(0)
    return 0


def _nodes(namespace: str) -> AbstractContextManager[SnapshotSource]:
    """The running nodes of a namespace, watched."""
    from impact_rs_ros.spectator import Spectator  # ROS 2, once a page looks at nodes

    return Spectator.watching(namespace)
