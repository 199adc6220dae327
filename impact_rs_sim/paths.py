# SPDX-License-Identifier: Apache-2.0
"""Location of the configuration files, installed or not."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path


def _candidates() -> Iterator[Path]:
    """Folders that may hold the configuration files, the most specific first."""
    if override := os.environ.get("IMPACT_RS_CONFIG"):
        yield Path(override)
        return  # a folder that the user names is the only one: without it there must be an error
    yield Path(__file__).resolve().parent.parent / "config"
    yield Path(sys.prefix) / "share" / "impact_rs" / "config"
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / "impact_rs" / "config"


def config_directory() -> Path:
    """Return the folder of scenarios, models, robots and node parameters.

    Candidates are the environment variable ``IMPACT_RS_CONFIG`` (alone, if it is set), the source tree of this module,
    ``share/impact_rs/config`` of the Python environment, and all prefixes in ``AMENT_PREFIX_PATH``.

    Raises:
        FileNotFoundError: No such folder exists; the message lists the candidates.
    """
    searched = []
    for candidate in _candidates():
        if candidate.is_dir():
            return candidate
        searched.append(candidate)
    folders = "\n".join(f"  {folder}" for folder in searched)
    raise FileNotFoundError(
        f"no configuration folder of impact_rs found; looked at\n{folders}\n"
        "Set IMPACT_RS_CONFIG to the folder, or install impact_rs."
    )
