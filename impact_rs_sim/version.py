# SPDX-License-Identifier: Apache-2.0
"""Which version of the software this is."""

from __future__ import annotations

import functools
import logging
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

logger = logging.getLogger(__name__)


@functools.cache
def git_revision() -> str:
    """Revision of the source tree this runs from, with ``+`` where it has uncommitted changes; empty if none."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--abbrev=12"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            timeout=5.0,
            check=True,
        )
    except (OSError, subprocess.SubprocessError) as error:
        logger.debug("no git revision: %s", error)
        return ""
    return described.stdout.strip()


@functools.cache
def package_version() -> str:
    """Installed version of the package; empty when it runs from a bare source tree."""
    try:
        return version("impact-rs")
    except PackageNotFoundError:
        return ""
