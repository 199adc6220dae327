# SPDX-License-Identifier: Apache-2.0
"""Resolve the mesh addresses of a URDF to files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from urllib.parse import unquote, urlparse

PACKAGE, FILE = "package://", "file://"


def mesh_path(address: str) -> Path | None:
    """The file at a ``file://`` or ``package://`` address; None: it does not exist.

    Packages are searched in ``AMENT_PREFIX_PATH``, where ROS 2 installs them.
    """
    if address.startswith(FILE):
        candidates = [Path(unquote(urlparse(address).path))]
    else:
        package, inside = _package(address)
        prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        candidates = [Path(prefix) / "share" / package / inside for prefix in prefixes if prefix]
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def mesh_address(name: str, urdf: Path, packages: Iterable[Path] = ()) -> str | None:
    """The ``file://`` or ``package://`` address of a mesh, whether the mesh exists or not; None: another kind.

    A path is relative to the URDF. A package that ROS 2 does not know is searched in ``packages`` and in the folders
    above the URDF, for sources that are not installed; if the mesh exists there, the address of its file is returned.

    Args:
        name: Path or address in the URDF.
        urdf: The URDF.
        packages: Folders that are packages or hold some.
    """
    if name.startswith(FILE):
        return name
    if not name.startswith(PACKAGE):
        return None if "://" in name else (urdf.parent / name).resolve().as_uri()
    if mesh_path(name) is not None:
        return name
    package, inside = _package(name)
    for folder in (*packages, *urdf.resolve().parents):
        for candidate in _package_folders(folder, package):
            if (candidate / inside).is_file():
                return (candidate / inside).resolve().as_uri()
    return name


def _package(address: str) -> tuple[str, str]:
    """Package name, and path inside the package."""
    parts = urlparse(address)
    return parts.netloc, unquote(parts.path).lstrip("/")


def _package_folders(folder: Path, package: str) -> Iterator[Path]:
    """Folders that may be a package: ``folder`` itself if it has the name, and its subfolder."""
    if folder.resolve().name == package:
        yield folder
    yield folder / package
