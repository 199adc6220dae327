# SPDX-License-Identifier: Apache-2.0
"""Many messages of one topic at once: CDR as a NumPy structured array.

In a trial nearly every topic sends messages of one and the same layout: strings and array lengths never change, only
numbers do. The bytes of such a topic are a table with one row per message, and NumPy reads and writes a whole column at
a time. The layout is found by walking one serialized message along its type definition (OMG XCDR1, little endian: a
value is aligned to its own size, counted from behind the four bytes of the encapsulation header).

If messages differ in layout, both directions fall back on ``rosbags``, message by message. The same fallback is taken
if ``rosbags`` reads the first, middle or last message, or writes the first or last message, differently.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import attrgetter
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from impact_rs_sim.robots.robot import Array

LITTLE_ENDIAN = b"\x00\x01"
ENCAPSULATION_BYTES = 4  # before the content of every CDR message

_FORMATS = {
    "bool": "?",
    "byte": "u1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}


class _NoColumnsError(Exception):
    """The type holds something that is no column of a table, for example an array of messages."""


@dataclass(frozen=True)
class _RowLayout:
    """Memory layout of a message.

    Attributes:
        numbers: Field path, NumPy format, shape and byte offset of all numbers that may change.
        constant: Field paths of strings, lists of strings and empty lists of messages.
        fixed: Byte ranges that are equal in all messages: byte order, lengths and strings.
    """

    numbers: tuple[tuple[str, str, tuple[int, ...], int], ...]
    constant: tuple[str, ...]
    fixed: tuple[tuple[int, int], ...]

    def dtype(self, size: int) -> np.dtype[Any]:
        """Structured type of a message of ``size`` bytes; one field per path."""
        return np.dtype(
            {
                "names": [path for path, _, _, _ in self.numbers],
                "formats": [(kind, shape) for _, kind, shape, _ in self.numbers],
                "offsets": [offset for _, _, _, offset in self.numbers],
                "itemsize": size,
            }
        )


def _fields(store: Typestore, kind: str) -> list[tuple[str, tuple[Nodetype, Any]]]:
    """Field names and their types, nested as in ``rosbags``: a node type and its arguments."""
    return store.fielddefs[kind][1]  # type: ignore[return-value]


class _Walker:
    """Follows a type definition through the bytes of one message."""

    def __init__(self, store: Typestore, data: bytes | memoryview) -> None:
        self._store = store
        self._data = data
        self._offset = ENCAPSULATION_BYTES
        self._numbers: list[tuple[str, str, tuple[int, ...], int]] = []
        self._constant: list[str] = []
        self._fixed: list[tuple[int, int]] = [(0, len(LITTLE_ENDIAN))]

    def layout(self, kind: str) -> _RowLayout:
        """Layout of a message of type ``kind``."""
        self._message(kind, "")
        if self._offset > len(self._data):
            raise _NoColumnsError
        return _RowLayout(tuple(self._numbers), tuple(self._constant), tuple(self._fixed))

    def _message(self, kind: str, prefix: str) -> None:
        for name, (node, payload) in _fields(self._store, kind):
            path: str = prefix + name
            if node == Nodetype.NAME:
                self._message(str(payload), path + ".")
            elif node == Nodetype.BASE:
                self._base(str(payload[0]), path, ())
            else:
                (inner, base), length = payload
                count = self._length() if node == Nodetype.SEQUENCE else length
                if inner == Nodetype.BASE:
                    self._base(str(base[0]), path, (count,))
                elif count:
                    raise _NoColumnsError
                else:
                    self._constant.append(path)

    def _base(self, base: str, path: str, shape: tuple[int, ...]) -> None:
        if base in ("string", "wstring"):
            for _ in range(shape[0] if shape else 1):
                length = self._length()
                self._fixed.append((self._offset, self._offset + length))
                self._offset += length
            self._constant.append(path)
            return
        kind = "<" + _FORMATS[base]
        size = np.dtype(kind).itemsize
        if shape != (0,):  # an empty array is not aligned
            self._align(size)
        self._numbers.append((path, kind, shape, self._offset))
        self._offset += size * (shape[0] if shape else 1)

    def _align(self, size: int) -> None:
        self._offset += -(self._offset - ENCAPSULATION_BYTES) % size

    def _length(self) -> int:
        self._align(4)
        self._fixed.append((self._offset, self._offset + 4))
        self._offset += 4
        return int.from_bytes(self._data[self._offset - 4 : self._offset], "little")


class Template:
    """Serializes messages from columns; strings and lengths are copied from an example.

    Args:
        data: A serialized message.
        dtype: Offsets of its numbers, by field path.
    """

    def __init__(self, data: bytes, dtype: np.dtype[Any]) -> None:
        self._data = data
        self._dtype = dtype

    @classmethod
    def of(cls, store: Typestore, kind: str, example: Any) -> Template:
        """The template that an example gives.

        Args:
            store: Type definitions.
            kind: ``package/msg/Name``, of a fixed layout.
            example: Message of the ``rosbags`` typestore.
        """
        data = bytes(store.serialize_cdr(example, kind))
        return cls(data, _Walker(store, data).layout(kind).dtype(len(data)))

    def rows(self, columns: Mapping[str, Any], count: int) -> list[bytes]:
        """Serialized messages.

        Args:
            columns: One row per message, by field path (``header.stamp.sec``); default: the example's value.
            count: Number of messages.
        """
        data = bytearray(self._data * count)
        table = np.frombuffer(data, self._dtype)
        for path, column in columns.items():
            table[path] = column
        size = len(self._data)
        return [bytes(data[i : i + size]) for i in range(0, len(data), size)]


def encode(store: Typestore, kind: str, messages: Sequence[Any]) -> list[bytes | memoryview]:
    """Serialize messages of one type, byte for byte as ``rosbags`` does.

    Args:
        store: Type definitions.
        kind: ``package/msg/Name`` of all of them.
        messages: Objects of the ``rosbags`` typestore.
    """
    first = bytes(store.serialize_cdr(messages[0], kind))
    if len(messages) > 2:
        try:
            table = _encode_table(store, kind, messages, first)
        except (_NoColumnsError, ValueError):  # ValueError: rows of different length
            table = None
        if table is not None:
            rows, size = memoryview(table.tobytes()), len(first)
            encoded: list[bytes | memoryview] = [rows[i : i + size] for i in range(0, len(rows), size)]
            if encoded[0] == first and encoded[-1] == store.serialize_cdr(messages[-1], kind):
                return encoded
    return [first, *(store.serialize_cdr(message, kind) for message in messages[1:])]


def _encode_table(store: Typestore, kind: str, messages: Sequence[Any], first: bytes) -> Array | None:
    layout = _Walker(store, first).layout(kind)
    for path in layout.constant:
        get = attrgetter(path)
        text = get(messages[0])
        if any(get(message) != text for message in messages):
            return None
    # A bytearray, because copying a structured array would lose the bytes between its fields: lengths and strings.
    table = np.frombuffer(bytearray(first * len(messages)), layout.dtype(len(first)))
    for path, _, shape, _ in layout.numbers:
        column = np.array(list(map(attrgetter(path), messages)))
        if column.shape[1:] != shape:
            return None
        table[path] = column
    return table


def decode(store: Typestore, kind: str, rows: Sequence[bytes | memoryview]) -> dict[str, Array]:
    """All numbers of messages of one type as columns, by field path (``header.stamp.sec``).

    Args:
        store: Type definitions.
        kind: ``package/msg/Name`` of all of them.
        rows: Serialized messages.

    Returns:
        ``(k,)`` for numbers, ``(k, n)`` for arrays. Strings are left out.

    Raises:
        ValueError: An array changes its length from message to message.
    """
    if not rows:
        return {}
    columns = _decode_table(store, kind, rows)
    if columns is None:
        messages = [store.deserialize_cdr(row, kind) for row in rows]
        return {path: np.array([attrgetter(path)(m) for m in messages]) for path in number_paths(store, kind)}
    return columns


def stacked(store: Typestore, kind: str, rows: Sequence[bytes | memoryview]) -> Any | None:
    """One message for many of one layout: the first, with columns ``(k,)`` or ``(k, n)`` in place of its numbers.

    Args:
        store: Type definitions.
        kind: ``package/msg/Name`` of all of them.
        rows: Serialized messages.

    Returns:
        An object of the typestore; None if layouts or strings differ.
    """
    columns = _decode_table(store, kind, rows) if rows else None
    if columns is None:
        return None
    message = store.deserialize_cdr(rows[0], kind)
    for path, column in columns.items():
        *holders, name = path.split(".")
        setattr(reduce(getattr, holders, message), name, column)
    return message


def _decode_table(store: Typestore, kind: str, rows: Sequence[bytes | memoryview]) -> dict[str, Array] | None:
    size = len(rows[0])
    if bytes(rows[0][:2]) != LITTLE_ENDIAN or any(len(row) != size for row in rows):
        return None
    try:
        layout = _Walker(store, rows[0]).layout(kind)
    except _NoColumnsError:
        return None
    data = np.frombuffer(b"".join(rows), np.uint8).reshape(-1, size)
    if any(np.any(data[:, start:end] != data[0, start:end]) for start, end in layout.fixed):
        return None
    table = data.reshape(-1).view(layout.dtype(size))
    for index in (0, len(rows) // 2, -1):
        message = store.deserialize_cdr(rows[index], kind)
        for path, _, _, _ in layout.numbers:
            if not np.array_equal(attrgetter(path)(message), table[path][index], equal_nan=True):
                return None
    return {path: np.ascontiguousarray(table[path]) for path, _, _, _ in layout.numbers}


class Readable:
    """Decides whether bytes are a message of a given type.

    A message with the layout of the one before it, strings and array lengths included, needs no decoding, because its
    numbers may have any value.

    Args:
        store: Type definitions.
        kind: ``package/msg/Name``.
    """

    def __init__(self, store: Typestore, kind: str) -> None:
        self._store = store
        self._kind = kind
        self._size = -1
        self._fixed_at = np.empty(0, np.intp)  # bytes that decide the layout
        self._fixed = b""

    def __call__(self, data: bytes) -> bool:
        """Whether this is a message."""
        if len(data) == self._size and self._fixed_of(data) == self._fixed:
            return True
        try:
            self._store.deserialize_cdr(data, self._kind)
        except Exception:  # whatever rosbags finds wrong with the bytes
            return False
        self._remember(data)
        return True

    def _fixed_of(self, data: bytes) -> bytes:
        return np.frombuffer(data, np.uint8)[self._fixed_at].tobytes()

    def _remember(self, data: bytes) -> None:
        """Keep the layout of a message, if lengths and strings alone determine it."""
        self._size = -1
        if data[:2] != LITTLE_ENDIAN:
            return
        try:
            layout = _Walker(self._store, data).layout(self._kind)
        except _NoColumnsError:
            return
        self._size = len(data)
        self._fixed_at = np.concatenate([np.arange(*part) for part in layout.fixed]).astype(np.intp)
        self._fixed = self._fixed_of(data)


def number_paths(store: Typestore, kind: str, prefix: str = "") -> list[str]:
    """Paths of all numbers and arrays of numbers of a message type."""
    paths: list[str] = []
    for name, (node, payload) in _fields(store, kind):
        if node == Nodetype.NAME:
            paths += number_paths(store, str(payload), f"{prefix}{name}.")
            continue
        base = payload if node == Nodetype.BASE else payload[0][1]
        if base[0] in _FORMATS:
            paths.append(prefix + name)
    return paths
