# SPDX-License-Identifier: Apache-2.0
"""Attacks on text tables: on their rows, or on their bytes."""

from __future__ import annotations

import gzip
from collections.abc import Callable

from benchmarks.attacks.binary import zipped
from benchmarks.attacks.clean_files import NAMES, Rng, Table, text_of


def _cell(word: str) -> Callable[[Table, Rng], bytes]:
    def attack(rows: Table, rng: Rng) -> bytes:
        for _ in range(int(rng.integers(1, 4))):
            rows[int(rng.integers(1, len(rows)))][int(rng.integers(len(rows[0])))] = word
        return text_of(rows)

    return attack


def _column(word: str) -> Callable[[Table, Rng], bytes]:
    def attack(rows: Table, rng: Rng) -> bytes:
        column = int(rng.integers(len(rows[0])))
        for row in rows[1:]:
            row[column] = word
        return text_of(rows)

    return attack


def _cut(rows: Table, rng: Rng) -> bytes:
    content = text_of(rows)
    end = int(rng.integers(len(content)))
    line = content[:end].rpartition(b"\n")[2]
    # Within the last cell of a row a cut leaves another valid number.
    return content[: end - len(line)] if line.count(b",") == len(rows[0]) - 1 else content[:end]


def _lost_rows(rows: Table, rng: Rng) -> bytes:
    first = int(rng.integers(len(rows) // 20, len(rows) // 2))
    return text_of(rows[:first] + rows[first + len(rows) // 4 :])


def _doubled_rows(rows: Table, rng: Rng) -> bytes:
    first = int(rng.integers(1, len(rows) - 5))
    return text_of(rows[: first + 5] + rows[first:])


def _shuffled(rows: Table, rng: Rng) -> bytes:
    return text_of([rows[0], *(rows[1 + int(number)] for number in rng.permutation(len(rows) - 1))])


def _swapped_rows(rows: Table, rng: Rng) -> bytes:
    first = int(rng.integers(1, len(rows) - 3))
    rows[first], rows[first + 2] = rows[first + 2], rows[first]
    return text_of(rows)


def _swapped_columns(rows: Table, rng: Rng) -> bytes:
    # Of a ball x and z: to swap x and y would leave a valid file.
    first, second = (1, 3) if len(rows[0]) == 4 else rng.choice(len(rows[0]) // 3, 2, replace=False) + 1
    for row in rows[1:]:
        row[first], row[second] = row[second], row[first]
    return text_of(rows)


def _mixed_units(rows: Table, rng: Rng) -> bytes:
    heavy = [NAMES.index(f"tau_{joint}") for joint in (2, 4)]  # a torque without weight may have any scale
    joints = [*range(1, 15), *heavy] if rows[0] == list(NAMES) else range(1, len(rows[0]))
    column, first = int(rng.choice(joints)), int(rng.integers(len(rows) // 4, 3 * len(rows) // 4))
    for row in rows[first:]:
        row[column] = f"{float(row[column]) * 57.29578:.7g}"
    return text_of(rows)


def _huge_offset(rows: Table, rng: Rng) -> bytes:
    column = int(rng.integers(1, len(rows[0])))  # stamps may count from any moment
    for row in rows[1:]:
        row[column] = f"{float(row[column]) + 1e12:.17g}"
    return text_of(rows)


def _missing_column(rows: Table, rng: Rng) -> bytes:
    column = int(rng.integers(len(rows[0])))
    return text_of([row[:column] + row[column + 1 :] for row in rows])


def _same_names(rows: Table, rng: Rng) -> bytes:
    first, second = rng.choice(len(rows[0]), 2, replace=False)
    rows[0][first] = rows[0][second]
    return text_of(rows)


def _short_row(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    del row[int(rng.integers(len(row))) :]
    return text_of(rows)


def _long_row(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    row.insert(int(rng.integers(len(row))), "0.5")
    return text_of(rows)


def _names_again(rows: Table, rng: Rng) -> bytes:
    rows.insert(int(rng.integers(2, len(rows))), list(rows[0]))
    return text_of(rows)


def _remark_inside(rows: Table, rng: Rng) -> bytes:
    rows.insert(int(rng.integers(2, len(rows))), ["# restarted"])
    return text_of(rows)


def _comma_for_point(rows: Table, _: Rng) -> bytes:
    return text_of(rows, ";").replace(b".", b",")


def _commas_everywhere(rows: Table, _: Rng) -> bytes:
    return text_of(rows).replace(b".", b",")


def _quoted(rows: Table, _: Rng) -> bytes:
    return text_of([[f'"{cell}"' for cell in row] for row in rows])


def _open_quote(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    row[1] = '"' + row[1]
    return text_of(rows)


def _thousands(rows: Table, rng: Rng) -> bytes:
    row = rows[int(rng.integers(1, len(rows)))]
    row[int(rng.integers(len(row)))] = '"1,234.5"'
    return text_of(rows)


def _flipped(rows: Table, rng: Rng) -> bytes:
    """Bytes that are no digits of numbers take the places of some."""
    content = bytearray(text_of(rows))
    for _ in range(int(rng.integers(1, 6))):
        content[int(rng.integers(len(content)))] = int(rng.choice([0, 7, 0x80, 0xFF, *b"x;\t\"'\\"]))
    return bytes(content)


TEXT: dict[str, Callable[[Table, Rng], bytes]] = {
    "empty": lambda rows, rng: b"",
    "blank": lambda rows, rng: b"\n \n\t\n",
    "names only": lambda rows, rng: text_of(rows[:1]),
    "one row": lambda rows, rng: text_of(rows[:2]),
    "no names": lambda rows, rng: text_of(rows[1:]),
    "cut": _cut,
    "nan": _cell("nan"),
    "inf": _cell("inf"),
    "-inf": _cell("-inf"),
    "huge": _cell("1e300"),
    "beyond float": _cell("1e999"),
    "word": _cell("abc"),
    "empty cell": _cell(""),
    "underscore": _cell("1_0"),
    "other digits": _cell("１２"),
    "hexadecimal": _cell("0x1p3"),
    "two signs": _cell("+-1"),
    "column of zeros": _column("0"),
    "column of nan": _column("nan"),
    "column of words": _column("n/a"),
    "lost rows": _lost_rows,
    "doubled rows": _doubled_rows,
    "shuffled": _shuffled,
    "swapped rows": _swapped_rows,
    "swapped columns": _swapped_columns,
    "reversed": lambda rows, rng: text_of([rows[0], *rows[:0:-1]]),
    "mixed units": _mixed_units,
    "huge offset": _huge_offset,
    "missing column": _missing_column,
    "same names": _same_names,
    "short row": _short_row,
    "long row": _long_row,
    "names again": _names_again,
    "remark inside": _remark_inside,
    "comma for point": _comma_for_point,
    "commas everywhere": _commas_everywhere,
    "quoted": _quoted,
    "open quote": _open_quote,
    "thousands": _thousands,
    "flipped": _flipped,
    "byte order mark": lambda rows, rng: b"\xef\xbb\xbf" + text_of(rows),
    "latin-1": lambda rows, rng: text_of([[f"{name} \xb0" for name in rows[0]], *rows[1:]]).decode().encode("latin-1"),
    "utf-16": lambda rows, rng: text_of(rows).decode().encode("utf-16"),
    "crlf": lambda rows, rng: text_of(rows).replace(b"\n", b"\r\n"),
    "cr": lambda rows, rng: text_of(rows).replace(b"\n", b"\r"),
    "tabs": lambda rows, rng: text_of(rows, "\t"),
    "markup": lambda rows, rng: text_of([[f"[red]{name}[/x]" for name in rows[0]], *rows[1:]]),
    "one long line": lambda rows, rng: text_of(rows).replace(b"\n", b","),
    "bytes": lambda rows, rng: rng.bytes(3000),
    "zeros": lambda rows, rng: bytes(3000),
    "gzip": lambda rows, rng: gzip.compress(text_of(rows)),
    "zip": lambda rows, rng: zipped(text_of(rows)),
}  # fmt: skip
