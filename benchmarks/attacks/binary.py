# SPDX-License-Identifier: Apache-2.0
"""Attacks on the bytes of a file, whatever it is."""

from __future__ import annotations

import gzip
import io
import zipfile
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks.clean_files import Rng


def zipped(content: bytes) -> bytes:
    """As the only file of an archive."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("log.csv", content)
    return file.getvalue()


BYTES: dict[str, Callable[[bytes, Rng], bytes]] = {
    "empty": lambda content, rng: b"",
    "cut": lambda content, rng: content[: int(rng.integers(len(content)))],
    "cut at the end": lambda content, rng: content[: -int(rng.integers(1, 60))],
    "bytes": lambda content, rng: rng.bytes(2000),
    "text": lambda content, rng: b"t,q_1,q_2\n0,1,2\n",
    "gzip": lambda content, rng: gzip.compress(content),
    "zip": lambda content, rng: zipped(content),
    "head lost": lambda content, rng: content[16:],
}  # fmt: skip
PLACES = ("folder", "dead link", "link to itself", "link")


def as_something_else(path: Path, attack: str) -> None:
    """A folder or a link in place of a file."""
    if attack == "folder":
        path.unlink()
        path.mkdir()
    elif attack in ("dead link", "link to itself"):
        path.unlink()
        path.symlink_to(path if attack == "link to itself" else path.with_name("nothing"))
    elif attack == "link":
        path.rename(path.with_name("real"))
        path.symlink_to("real")
