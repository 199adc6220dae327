# SPDX-License-Identifier: Apache-2.0
"""Atomic file writing: a temporary file is renamed when complete, and the earlier file stays until then.

An ``OSError`` while writing, for example of a full disk, becomes an :class:`InputError` that names the file.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from impact_rs_sim.errors import InputError


def is_file(path: str | Path) -> bool:
    """Whether the file exists; False for an invalid path, for example one that is too long."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Temporary path for a file; renamed on success at the end of the context, replacing an earlier file.

    Args:
        path: The file; its folder is created if missing.
    """
    aside = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        aside.replace(path)
    except OSError as error:
        raise _unwritten(path, error) from None
    finally:
        with suppress(OSError):
            aside.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with whole(path) as aside:
        aside.write_text(text, encoding="utf-8")


@contextmanager
def whole_folder(directory: Path) -> Iterator[Path]:
    """Temporary folder for files that belong together; moved into their folder on success at the end of the context.

    Args:
        directory: Their folder; it is created if missing, and other files in it stay.
    """
    aside = directory / f".{os.getpid()}.partial"
    try:
        aside.mkdir(parents=True, exist_ok=True)
        yield aside
        for file in sorted(aside.iterdir()):
            file.replace(directory / file.name)
    except OSError as error:
        raise _unwritten(directory, error) from None
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _unwritten(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot be written: {error.strerror or error}", file=path)
