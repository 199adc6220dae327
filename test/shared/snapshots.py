# SPDX-License-Identifier: Apache-2.0
"""Texts that a test compares with the ones that are stored: ``IMPACT_RS_SNAPSHOTS=write`` stores them anew."""

import os
from pathlib import Path


def assert_snapshot(file: Path, text: str) -> None:
    """A text is the stored one; a difference is shown line by line.

    Args:
        file: The stored text.
        text: The text of today.
    """
    if os.environ.get("IMPACT_RS_SNAPSHOTS") == "write":
        file.parent.mkdir(exist_ok=True)
        file.write_text(text, encoding="utf-8")
    assert text.splitlines() == file.read_text(encoding="utf-8").splitlines()
