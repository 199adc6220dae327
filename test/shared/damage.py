# SPDX-License-Identifier: Apache-2.0
"""What happens to files: bits, bytes, parts and lines that are changed, lost or there twice, as strategies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

FAST_TIER = 3  # of so many examples it tries one
TIERS = pytest.mark.parametrize("part", [FAST_TIER, pytest.param(1, marks=pytest.mark.slow)], ids=["third", "whole"])


def repeatable(examples: int) -> Any:
    """Settings of a test of damage: the same examples in every run."""
    checks = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],  # a file is no clearer when it is shrunk
        suppress_health_check=checks,
    )


@st.composite
def flipped(draw: st.DrawFn, data: bytes, first: int = 0, last: int | None = None) -> bytes:
    """One to three bits between two places."""
    changed = bytearray(data)
    end = len(data) if last is None else last
    for place in draw(st.lists(st.integers(8 * first, 8 * end - 1), min_size=1, max_size=3)):
        changed[place // 8] ^= 1 << place % 8
    return bytes(changed)


@st.composite
def overwritten(draw: st.DrawFn, data: bytes) -> bytes:
    """A run of bytes: noise, or zeros as a lost block of a disk leaves them."""
    start, size = draw(st.integers(0, len(data) - 1)), draw(st.sampled_from((1, 8, 512, 4096)))
    run = draw(st.sampled_from((bytes(size), draw(st.randoms(use_true_random=False)).randbytes(size))))
    return data[:start] + run[: len(data) - start] + data[start + size :]


@st.composite
def spliced(draw: st.DrawFn, data: bytes) -> bytes:
    """A run of bytes lost or there twice, or all after it."""
    start, size = draw(st.integers(0, len(data) - 1)), draw(st.sampled_from((1, 8, 100, 4096, len(data))))
    return data[:start] + draw(st.sampled_from((data[start + size :], data[max(0, start - size) :])))


def damaged(data: bytes) -> st.SearchStrategy[bytes]:
    """Any damage that knows nothing of the format."""
    return st.one_of(flipped(data), overwritten(data), spliced(data))


@st.composite
def edited(draw: st.DrawFn, text: str, words: Sequence[str], separators: str) -> bytes:
    """A text with a word replaced by one of ``words``, a line lost, twice or indented, or a special character."""
    lines = text.split("\n")
    place = draw(st.integers(0, len(lines) - 1))
    line = lines[place]
    kind = draw(st.sampled_from(("word", "word", "word", "lost", "twice", "indented", "character")))
    if kind == "word":
        cuts = [0, *(number + 1 for number, sign in enumerate(line) if sign in separators)]
        start = draw(st.sampled_from(cuts))
        stop = next((cut - 1 for cut in cuts if cut > start), len(line))
        gap = " " if line[start : start + 1] == " " else ""
        lines[place] = line[:start] + gap + draw(st.sampled_from(words)) + line[stop:]
    elif kind == "character":
        at = draw(st.integers(0, len(line)))
        lines[place] = (
            line[:at] + draw(st.sampled_from("&*!|>%@`{}[]:,#?-\"'\\\t\0\ufeff\u2028ä\U0001f600")) + line[at + 1 :]
        )
    else:
        lines[place : place + 1] = {"lost": [], "twice": [line, line], "indented": ["  " + line]}[kind]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


ACCIDENTS = ("cut", "mark", "byte", "separator", "join", "half", "blank", "word", "tail")


@st.composite
def mangled(draw: st.DrawFn, text: str) -> bytes:
    """A table of numbers after one or two accidents that leave no other valid number in it."""
    lines = text.split("\n")
    accidents = draw(st.lists(st.sampled_from(ACCIDENTS), min_size=1, max_size=2, unique=True))
    for kind in ["join"] if "join" in accidents else accidents:  # half of two joined lines may be one line less a digit
        row = draw(st.integers(0, max(len(lines) - 2, 0)))
        if kind == "cut":
            lines = [*lines[:row], lines[row][: draw(st.integers(0, len(lines[row])))]]
        elif kind == "mark":
            place = draw(st.integers(0, len(lines[row])))
            lines[row] = lines[row][:place] + '"' + lines[row][place:]
        elif kind == "byte":
            return "\n".join(lines[:row]).encode() + b"\xff\xfe\x00" + "\n".join(lines[row:]).encode()
        elif kind == "separator":
            lines[row] = lines[row].replace(",", draw(st.sampled_from([";", "\t", ",,", " , "])), 1)
        elif kind == "join" and row + 1 < len(lines):
            lines[row : row + 2] = [lines[row] + lines[row + 1]]
        elif kind == "half":
            lines[row] = lines[row][: len(lines[row]) // 2]
        elif kind == "blank":
            lines.insert(row, draw(st.sampled_from(["", "   ", "# a note", "\r"])))
        elif kind == "word":
            lines.insert(row, draw(st.text(max_size=30)).replace("\n", " "))
        elif kind == "tail":
            lines[row] += draw(st.sampled_from([",", " ", "\r", ",x", " 1"]))
    return "\n".join(lines).encode("utf-8", "surrogatepass")


@st.composite
def headless(draw: st.DrawFn, data: bytes) -> bytes:
    """A binary without checksums of its numbers: its head is overwritten, or its end is lost."""
    if draw(st.booleans()):
        return data[: len(data) - draw(st.integers(0, 300))]
    place, there = draw(st.integers(0, 200)), draw(st.binary(min_size=1, max_size=8))
    return data[:place] + there + data[place + len(there) :]
