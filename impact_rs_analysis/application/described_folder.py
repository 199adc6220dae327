# SPDX-License-Identifier: Apache-2.0
"""Description of the recordings in a folder: all its files are written, or none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole_folder


def check_undescribed(folder: Path, names: Iterable[str]) -> None:
    """Check that no description is overwritten.

    Raises:
        InputError: One of the files exists.
    """
    for name in names:
        if (folder / name).exists():
            reason = (
                "this file exists already; descriptions are never overwritten: remove it to describe the folder again"
            )
            raise InputError(reason, file=folder / name)


@contextmanager
def described_folder(folder: Path, texts: Mapping[str, str]) -> Iterator[Path]:
    """Write a description; the files come into their folder when the context ends without an error.

    Args:
        folder: The folder.
        texts: Texts by name of the file.

    Yields:
        Temporary folder with the files, for a trial reading.

    Raises:
        InputError: One of the files exists, or cannot be written.
    """
    check_undescribed(folder, texts)
    with whole_folder(folder) as aside:
        for name, text in texts.items():
            (aside / name).write_text(text, encoding="utf-8")
        yield aside
