# SPDX-License-Identifier: Apache-2.0
"""Packages of the extra ``export``, which Parquet and HDF5 files and messages in Protobuf need."""

from __future__ import annotations

import os
import shlex
from importlib.util import find_spec
from pathlib import Path

from impact_rs_sim.errors import MissingPackage

EXPORT_EXTRA_SIZE = "0.2 GB on disk"  # of all packages of the extra, mostly pyarrow


def require(package: str, path: Path, distribution: str = "") -> None:
    """Check that a package of the extra ``export`` is installed.

    Args:
        package: Name of the package, for example ``pyarrow``.
        path: The file that needs it.
        distribution: Name of the distribution for pip; empty: the name of the package.

    Raises:
        MissingPackage: The package is not installed.
    """
    if find_spec(package) is None:
        command = shlex.join(installer() or ["pip", "install", distribution or package])
        raise MissingPackage(
            f"this needs {package}, which is not installed; {command} does it ({EXPORT_EXTRA_SIZE})", file=path
        )


def installer() -> list[str] | None:
    """The command that installs the extra ``export``; None: ``./run`` did not create this environment."""
    run = os.environ.get("IMPACT_RS_RUN")
    return None if run is None else [run, "sync", "export"]
