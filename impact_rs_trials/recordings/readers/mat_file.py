# SPDX-License-Identifier: Apache-2.0
"""MAT files of level 5 (MATLAB 5 to 7.2, ``save -v7``, SciPy): arrays of real numbers, alone and in structures.

A file is a header of 128 bytes and data elements; an element is a tag, type and number of bytes, and its data, padded
to 8 bytes. A small element has its data in the tag. A matrix is an element of elements: flags with its class,
dimensions, name, and numbers, column by column (MathWorks, MAT-File Format). All sizes are checked against the bytes of
the file: SciPy's reader, which reads more kinds of files, ends the process at some damaged files.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.errors import InputError

HEADER_BYTES = 128
MATRIX, COMPRESSED = 14, 15
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}  # by type
STORED = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}  # by class
CELL, STRUCTURE = 1, 2
COMPLEX_FLAG = 0x08
MAX_NESTED_STRUCTURES = 8
MAX_ELEMENT_BYTES = 2_000_000_000  # of a compressed element


class _Damaged(Exception):
    """Bytes that are no element."""


def read_mat(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of real numbers by name; fields of structures as ``structure/field``. Other contents are left out.

    Raises:
        InputError: It is no such file.
    """
    data = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise InputError("not a readable MAT file (no file of level 5; expected save -v7 or -v7.3)", file=path)
    arrays: dict[str, NDArray[Any]] = {}
    try:
        for kind, body in _elements(memoryview(data)[HEADER_BYTES:], order):
            if kind == COMPRESSED:
                unpack = zlib.decompressobj()
                unpacked = unpack.decompress(bytes(body), MAX_ELEMENT_BYTES)
                if not unpack.eof:
                    raise _Damaged("a compressed element goes on beyond its end")
                kind, body = next(_elements(memoryview(unpacked), order))
            if kind == MATRIX:
                for name, array in _matrix(body, order, "", MAX_NESTED_STRUCTURES):
                    if name in arrays:
                        raise _Damaged(f"two arrays are called {name!r}")
                    arrays[name] = array
    except (_Damaged, zlib.error, StopIteration, UnicodeDecodeError) as error:
        raise InputError(f"not a readable MAT file ({error or 'an element is empty'})", file=path) from None
    return arrays


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and data of consecutive elements."""
    position = 0
    while position < len(data):
        if position + 8 > len(data):
            raise _Damaged("the file ends within a tag")
        kind, size = struct.unpack_from(f"{order}II", data, position)
        if kind >> 16:  # a small element: size and type share four bytes
            kind, size, start, end = kind & 0xFFFF, kind >> 16, position + 4, position + 8
            if size > 4:
                raise _Damaged(f"a small element of {size} bytes")
        else:
            start = position + 8
            end = start + size + (-size % 8 if kind != COMPRESSED else 0)
        if start + size > len(data):
            raise _Damaged("the file ends within an element")
        yield kind, data[start : start + size]
        position = end


def _matrix(body: memoryview, order: str, name: str, depth: int) -> Iterator[tuple[str, NDArray[Any]]]:
    """Arrays of a matrix element, by name."""
    parts = list(_elements(body, order))
    if len(parts) < 3 or len(parts[0][1]) < 8:
        if parts:
            raise _Damaged("a matrix without flags, dimensions and name")
        return
    (flags,) = struct.unpack_from(f"{order}I", parts[0][1])
    kind, shape = flags & 0xFF, tuple(int(length) for length in _numbers(*parts[1], order))
    name = name or bytes(parts[2][1]).decode("ascii")
    if any(length < 0 for length in shape):
        raise _Damaged(f"array {name!r} has the dimensions {shape}")
    if kind in STORED and not flags >> 8 & COMPLEX_FLAG:
        if len(parts) != 4:
            raise _Damaged(f"array {name!r} has {len(parts)} parts, expected 4")
        values = _numbers(*parts[3], order)
        if values.size != int(np.prod(shape, dtype=float)):
            raise _Damaged(f"array {name!r} has {values.size} numbers, its dimensions are {shape}")
        yield name, values.astype(STORED[kind]).reshape(shape, order="F")
    elif kind in (CELL, STRUCTURE) and int(np.prod(shape, dtype=float)) == 1 and depth > 0:
        fields = [name] if kind == CELL else [f"{name}/{field}" for field in _fields(parts, order)]
        inner = parts[3:] if kind == CELL else parts[5:]
        if len(inner) != len(fields):
            raise _Damaged(f"{name!r} has {len(inner)} fields, expected {len(fields)}")
        for field, (field_kind, field_body) in zip(fields, inner, strict=True):
            if field_kind != MATRIX:
                raise _Damaged(f"field {field!r} is no matrix")
            yield from _matrix(field_body, order, field, depth - 1)


def _fields(parts: list[tuple[int, memoryview]], order: str) -> list[str]:
    """Names of the fields of a structure."""
    if len(parts) < 5 or len(parts[3][1]) < 4:
        raise _Damaged("a structure without names")
    (length,) = struct.unpack_from(f"{order}i", parts[3][1])
    text = bytes(parts[4][1])
    if length < 1 or len(text) % length:
        raise _Damaged("a structure whose names have no length")
    return [text[start : start + length].split(b"\0")[0].decode("ascii") for start in range(0, len(text), length)]


def _numbers(kind: int, data: memoryview, order: str) -> NDArray[Any]:
    if kind not in NUMBERS:
        raise _Damaged(f"numbers of the unknown type {kind}")
    dtype = np.dtype(f"{order}{NUMBERS[kind]}")
    if len(data) % dtype.itemsize:
        raise _Damaged(f"{len(data)} bytes of numbers of {dtype.itemsize} bytes each")
    return np.frombuffer(data, dtype)
