# SPDX-License-Identifier: Apache-2.0
"""Version and git revision of the software."""

from __future__ import annotations

import functools
import logging
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

logger = logging.getLogger(__name__)


REVISION_FILE = "git_revision.txt"  # written by CMakeLists.txt, beside this file in an installation


@functools.cache
def git_revision() -> str:
    """Revision of the sources, with ``+`` if they have uncommitted changes; empty if unknown.

    The revision of the source tree or, if colcon or pip installed it, the revision recorded by the build.
    """
    folder = Path(__file__).resolve().parent
    return described_by_git(folder) if (folder.parent / ".git").exists() else recorded_revision(folder)


def recorded_revision(folder: Path) -> str:
    """Revision that the build recorded in a folder; empty if there is no record."""
    try:
        return (folder / REVISION_FILE).read_text(encoding="utf-8").strip()
    except OSError as error:
        logger.debug("no git revision: %s", error)
        return ""


def described_by_git(folder: Path) -> str:
    """Revision of the repository of a folder, with ``+`` if it has uncommitted changes; empty without repository."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--abbrev=12"],
            cwd=folder,
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
