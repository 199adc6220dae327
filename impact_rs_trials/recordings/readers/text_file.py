# SPDX-License-Identifier: Apache-2.0
"""Names and characters of files as other programs write them: capital suffixes, text that is not in UTF-8."""

from __future__ import annotations

import codecs
from pathlib import Path

from impact_rs_sim.errors import InputError

UTF_16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def suffix_of(path: Path) -> str:
    """Suffix of a file in small letters: data loggers write ``LOG.CSV``."""
    return path.suffix.lower()


def read_text(path: Path) -> str:
    """Text in UTF-8, in UTF-16 with its byte order mark, or in Windows-1252; lines end with a line feed.

    Raises:
        InputError: It cannot be read, or holds no text.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=path) from None
    marked = data.startswith(UTF_16_MARKS)
    if not marked and b"\0" in data:
        raise InputError("not a text: it holds zero bytes", file=path)
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252"):
        try:
            return data.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
        except UnicodeDecodeError:
            continue
    raise InputError("not a text in UTF-8, UTF-16 or Windows-1252", file=path)
