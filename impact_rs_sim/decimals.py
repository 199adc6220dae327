# SPDX-License-Identifier: Apache-2.0
"""Decimal numbers in text files, more strictly than Python's ``float``."""

from __future__ import annotations

import re

_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|[+-]?(?:nan|inf)", re.IGNORECASE)


def decimal(text: str) -> float:
    """The number that a cell or attribute holds.

    ``float`` also accepts ``3_7`` for 37 and digits of other scripts; here both are errors, as is a comma.

    Args:
        text: Digits 0 to 9 with sign, point and exponent; ``nan`` or ``inf``; blanks around it.

    Raises:
        ValueError: The text is not such a number.
    """
    word = text.strip(" \t\r\n")
    if _DECIMAL.fullmatch(word) is None:
        shown = word if len(word) <= 40 else f"{word[:40]}..."
        raise ValueError(f"could not convert string to float: {shown!r}")
    return float(word)
