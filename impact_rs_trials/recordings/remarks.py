# SPDX-License-Identifier: Apache-2.0
"""Remarks about reading runs, with their numbers, so that the same remark about many runs is printed once.

Two texts may be remarks of one kind: "is 1.07 times the derivative" and "is 1.08 times the derivative". A
:class:`Remark` stores numbers and words separately, and :func:`merged` prints the range of every number:

    remark("{}: stamps moved by {:+.6g} s", label, offset)
"""

from __future__ import annotations

import statistics
import string
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

MAX_NAMED_RUNS = 3  # of more runs only the number is printed


class Amount(NamedTuple):
    """A number in a remark.

    Attributes:
        value: The number, in the unit of the words after it.
        digits: Format specification.
        remedy: Whether it is a value for a file; several runs are merged to their median.
    """

    value: float
    digits: str = ".3g"
    remedy: bool = False

    def __str__(self) -> str:
        """Formatted number."""
        return format(self.value, self.digits)


class Remark(str):
    """A remark: its text, with its parts.

    Args:
        parts: Words, numbers, and other remarks.
    """

    parts: tuple[str | Amount, ...]

    def __new__(cls, *parts: str | Amount) -> Remark:
        """Join the parts."""
        flat: list[str | Amount] = []
        for part in (inner for item in parts for inner in (item.parts if isinstance(item, Remark) else (item,))):
            if part == "":
                continue
            if isinstance(part, Amount) or not flat or isinstance(flat[-1], Amount):
                flat.append(part)
            else:
                flat[-1] = f"{flat[-1]}{part}"
        text = super().__new__(cls, "".join(map(str, flat)))
        text.parts = tuple(flat)
        return text

    def __reduce__(self) -> tuple[type[Remark], tuple[str | Amount, ...]]:
        """Pickle by the parts."""
        return Remark, self.parts


def remark(template: str, *values: Any) -> Remark:
    """A remark from a template as of :meth:`str.format`.

    Args:
        template: Its words; ``{}`` stands for a text or another remark, ``{:.3g}`` for a number with its format, and
            ``{!r:.3g}`` for a number that is a remedy (:attr:`Amount.remedy`).
        values: Texts and numbers in that order.
    """
    parts: list[str | Amount] = []
    following = iter(values)
    for words, name, digits, kind in string.Formatter().parse(template):
        parts.append(words)
        if name is not None:
            parts.append(Amount(next(following), digits, kind == "r") if digits else next(following))
    return Remark(*parts)


def joined(separator: str, remarks: Sequence[str]) -> Remark:
    """Remarks with a separator between them, as :meth:`str.join`."""
    return Remark(*[part for text in remarks for part in (separator, text)][1:])


def merged(remarks: Iterable[tuple[str, str]], run_count: int = 0) -> list[str]:
    """Remarks, each kind once, with its runs and the range of its numbers.

    Args:
        remarks: Run and remark; a remark about all runs has the run ``""``.
        run_count: Number of all runs, to print how many share a remark; 0: up to :data:`MAX_NAMED_RUNS` are named.
    """
    groups: dict[tuple[object, ...], list[tuple[str, str]]] = {}
    for run, remark in remarks:
        text = remark if isinstance(remark, Remark) else remark.removeprefix(f"{run}: ")  # a run of one file
        groups.setdefault(_kind(text), []).append((run, text))
    return [
        _prefix(list(dict.fromkeys(run for run, _ in members if run)), run_count)
        + in_one([text for _, text in members])
        for members in groups.values()
    ]


def in_one(remarks: Sequence[str]) -> str:
    """Remarks of one kind as one text, with the range of every number."""
    parts = [remark.parts if isinstance(remark, Remark) else (remark,) for remark in remarks]
    return "".join(_together(column) for column in zip(*parts, strict=True))


def _prefix(runs: Sequence[str], run_count: int) -> str:
    """The runs of a remark, before its text."""
    if not runs or run_count == 1:
        return ""
    if run_count:
        return f"{len(runs)} of {run_count} runs: "
    return f"{len(runs)} runs: " if len(runs) > MAX_NAMED_RUNS else f"{', '.join(runs)}: "


def _kind(remark: str) -> tuple[object, ...]:
    """Key of a kind of remark: its words, and the formats of the numbers between them."""
    parts = remark.parts if isinstance(remark, Remark) else (str(remark),)
    return tuple(part[1:] if isinstance(part, Amount) else part for part in parts)


def _together(column: Sequence[str | Amount]) -> str:
    """Text or range of one part of several remarks."""
    numbers = [part for part in column if isinstance(part, Amount)]
    if not numbers:
        return str(column[0])
    if numbers[0].remedy:
        return str(numbers[0]._replace(value=statistics.median(number.value for number in numbers)))
    ends = dict.fromkeys(str(end(numbers, key=lambda number: number.value)) for end in (min, max))
    return " to ".join(ends)
