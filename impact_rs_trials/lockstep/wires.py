# SPDX-License-Identifier: Apache-2.0
"""Messages of a trial on any transport: DDS between nodes, simulated time in a rehearsal, a list in a test."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol


class Incoming(Protocol):
    """Received messages, serialized (CDR)."""

    def wait(self, timeout: float) -> None:
        """Return when messages have come, or after ``timeout`` [s]."""

    def take(self) -> Iterator[tuple[str, bytes]]:
        """Everything that has been received: topic and message."""


class Outgoing(Protocol):
    """Messages to publish: samples of the streams of a trial, and others."""

    @property
    def due(self) -> bool:
        """Whether the next burst is large or old enough."""

    def begin(self, origin_ns: int) -> None:
        """Tick 0 has this stamp [ns]."""

    def now(self, topic: str, tick: int, sample: Any) -> bytes:
        """Publish a sample at once; returns its bytes."""

    def repeat(self, topic: str, data: bytes) -> None:
        """Publish a message again that may have been lost."""

    def keep(self, topic: str, tick: int, sample: Any) -> None:
        """Publish a sample with the next burst."""

    def later(self, topic: str, message: Any) -> None:
        """Publish a message, serialized or not, with the next burst."""

    def flush(self) -> None:
        """Publish the burst."""
