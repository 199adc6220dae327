# SPDX-License-Identifier: Apache-2.0
"""The question whether packages that only some files need shall be installed now."""

from __future__ import annotations

import importlib
import subprocess
import sys

from impact_rs_cli.terminal import Terminal
from impact_rs_sim.optional_packages import installer


def offer() -> bool:
    """Ask on a terminal, and install after a yes; True: the packages are there now.

    No question without a terminal, or in an environment not made by ``./run``.
    """
    command = installer()
    if command is None or not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    if not Terminal(as_json=False).ask("Install it now, and go on?"):
        return False
    installation = subprocess.run(command, stdout=sys.stderr)
    importlib.invalidate_caches()
    return installation.returncode == 0
