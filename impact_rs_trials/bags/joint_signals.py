# SPDX-License-Identifier: Apache-2.0
"""Received joint signals, ``sensor_msgs/JointState``: decoded by hand, and checked before they are used."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.robots.robot import Array

FIELDS = ("position", "velocity", "effort")
MAX_JOINTS = 1024  # in one message; bounds the time to decode it
MAX_NAME_BYTES = 65536  # of all names of one message; bounds its memory


@dataclass(frozen=True)
class JointSignals:
    """A ``sensor_msgs/JointState``.

    Attributes:
        stamp: Time of the signals [ns].
        names: Serialized names of the joints, with the encapsulation header before them.
        values: Position, velocity and effort, ``(n,)`` or ``(0,)`` each.
        complaint: Reason why the signals cannot be used, in one line; empty: they can.
    """

    stamp: int
    names: bytes
    values: tuple[Array, Array, Array]
    complaint: str = ""

    @property
    def readable(self) -> bool:
        """Whether the bytes were a message; otherwise timestamp, names and values are meaningless."""
        return bool(self.names)


def joint_signals(data: bytes) -> JointSignals:
    """Decode a serialized ``sensor_msgs/JointState``, ten times as fast as rclpy.

    Never raises: for bytes that are not such a message, or one of more than ``MAX_JOINTS`` joints, the result has a
    complaint, stamp 0 and no values.

    XCDR1: a value is aligned to its size, counted from the end of the encapsulation header of four bytes; a sequence
    and a string begin with their length.
    """
    try:
        return _decoded(data)
    except (ValueError, struct.error):  # a length points past the end, or is out of bounds
        empty = np.empty(0)
        return JointSignals(0, b"", (empty, empty, empty), f"joint signals cannot be read ({len(data)} bytes)")


def _decoded(data: bytes) -> JointSignals:
    """The message; raises ``ValueError`` or ``struct.error`` for other bytes."""
    if data[:2] not in (b"\0\1", b"\0\0"):
        raise ValueError("no XCDR1")
    order = "<" if data[1] else ">"
    integer = struct.Struct(order + "I").unpack_from
    seconds, nanoseconds, length = struct.unpack_from(order + "iII", data, 4)
    offset = 16 + length
    offset += -offset % 4
    first = offset
    (names,) = integer(data, offset)
    offset += 4
    if names > MAX_JOINTS:
        raise ValueError("too many joints")
    for _ in range(names):
        offset += -offset % 4
        offset += 4 + integer(data, offset)[0]
    last = offset
    if last > len(data) or last - first > MAX_NAME_BYTES:
        raise ValueError("names without end")
    values = []
    for _ in range(3):
        offset += -offset % 4
        (count,) = integer(data, offset)
        offset += 4
        if count:
            offset += -(offset - 4) % 8
        values.append(np.frombuffer(data, order + "f8", count, offset).astype(np.float64))
        offset += 8 * count
    stamp = seconds * 1_000_000_000 + nanoseconds
    return JointSignals(stamp, data[:4] + data[first:last], (values[0], values[1], values[2]))


def names_of(signals: JointSignals) -> list[str]:
    """Names of the joints; empty if the message cannot be read."""
    data = signals.names
    if not data:
        return []
    integer = struct.Struct(("<" if data[1] else ">") + "I").unpack_from
    (count,), offset = integer(data, 4), 8
    names = []
    for _ in range(count):
        offset += -offset % 4
        (length,) = integer(data, offset)
        names.append(data[offset + 4 : offset + 4 + length].rstrip(b"\0").decode(errors="replace"))
        offset += 4 + length
    return names


class JointReader:
    """Reads the signals of given joints in a fixed order, with a complaint about unusable messages.

    Args:
        names: Names of the joints, in the order of the result.
        needed: Names in ``FIELDS`` that a message must have; all its values must be finite.
    """

    def __init__(self, names: Sequence[str], needed: Sequence[str] = FIELDS) -> None:
        self._names = list(names)
        self._needed = frozenset(needed)
        self._orders: dict[bytes, list[int] | None] = {}  # by serialized names; None: already in order

    def read(self, data: bytes) -> JointSignals:
        """Signals in the order of the joints; with a ``complaint`` only the timestamp can be used.

        Never raises; for bytes that are not a message ``readable`` is false and the stamp is 0.
        """
        signals = joint_signals(data)
        if signals.complaint:
            return signals
        order = self._orders.get(signals.names, ())
        if order == ():
            complaint, order = self._order_of(names_of(signals))
            if complaint:
                return replace(signals, complaint=complaint)
            if len(self._orders) < 8:  # another publisher that makes up names must not fill the memory
                self._orders[signals.names] = order
        count = len(self._names)
        for field, values in zip(FIELDS, signals.values, strict=True):
            if values.size != count and (values.size or field in self._needed):
                return replace(signals, complaint=f"{values.size} values of {field}, expected {count}")
            if not np.isfinite(values).all():
                first = int(np.flatnonzero(~np.isfinite(values))[0])
                name = self._names[first] if order is None else self._names[order.index(first)]
                return replace(signals, complaint=f"{field} of {name} is {values[first]}")
        if order is None:
            return signals
        position, velocity, effort = (values[order] if values.size else values for values in signals.values)
        return replace(signals, values=(position, velocity, effort))

    def _order_of(self, names: list[str]) -> tuple[str, list[int] | None]:
        if names == self._names:
            return "", None
        if sorted(names) != sorted(self._names):
            shown = "".join(letter if letter.isprintable() else "?" for letter in ", ".join(names)[:200]) or "none"
            return f"joints {shown}; expected {', '.join(self._names)}", None
        return "", [names.index(name) for name in self._names]
