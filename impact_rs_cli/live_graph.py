# SPDX-License-Identifier: Apache-2.0
"""A running graph in the browser: the spectator of ROS 2 behind the page that shows it."""

from __future__ import annotations

from impact_rs_cli.parser import PROGRAM
from impact_rs_cli.terminal import Terminal
from impact_rs_ros.spectator import Spectator
from impact_rs_workbench.live_page import serve


def show_live(namespace: str, port: int, browser: bool, terminal: Terminal) -> int:
    """Show a running graph until Ctrl-C; returns the exit code.

    Args:
        namespace: ROS namespace of the graph; empty: the root.
        port: Port of the page; 0: any that is free.
        browser: Whether to open a browser.
        terminal: Shows the address and events.

    Raises:
        InputError: The namespace is not valid in ROS, or the port is taken.
    """
    with Spectator.watching(namespace) as spectator:
        serve(spectator, PROGRAM, port, browser, terminal.say)
    return 0
