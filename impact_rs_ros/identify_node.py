# SPDX-License-Identifier: Apache-2.0
"""Publishes results after every finished trial: prediction of the next hit, parameter estimates, changes.

Topics, latched:

    ~/prediction   HitPrediction: prediction of the next hit, with intervals, and the present parameter estimates
    ~/change       CellChange: a change of the cell, with its evidence and explanations
    ~/diagnosis    ChangeDiagnosis: how the full diagnosis of the hits since then has ended
    ~/refused      RefusedHit: a trial or row that gives no hit, with the reason

The node does not judge hits itself: the program that starts it provides an :class:`Identifier`.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from impact_rs.msg import CellChange, ChangeDiagnosis, HitPrediction, RefusedHit

from impact_rs_ros.message_types import filled
from impact_rs_ros.process import NodeProgram
from impact_rs_ros.qos import LATCHED
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_trials.spec import TrialSpec

TOPICS = {"prediction": HitPrediction, "change": CellChange, "diagnosis": ChangeDiagnosis, "refused": RefusedHit}


@dataclass(frozen=True)
class HitReport:
    """Result of one hit, or of a diagnosis after a change.

    Attributes:
        line: Result in one line.
        topic: ``change``, ``diagnosis`` or ``refused``, on which it is published; empty: on none.
        document: Fields of its message.
        hit: Whether it is the result of a hit.
    """

    line: str
    topic: str = ""
    document: Mapping[str, Any] = field(default_factory=dict)
    hit: bool = True


class Identifier(Protocol):
    """Follows hits as they arrive."""

    def arrived(self) -> Sequence[HitReport]:
        """Results of the hits since the last call; raises ``InputError`` if they cannot be read."""

    def prediction(self) -> Mapping[str, Any]:
        """Fields of the prediction of the next hit, with the parameters believed; empty: not yet."""

    def close(self) -> None:
        """Stop started processes."""


class IdentifyNode(NodeProgram):
    """Polls for finished trials, and publishes their results."""

    kind = "identify"

    def __init__(self) -> None:
        super().__init__()
        self._publishers = {
            name: self.node.create_publisher(kind, f"~/{name}", LATCHED) for name, kind in TOPICS.items()
        }
        self._identifier: Identifier | None = None
        self._last_poll = -float("inf")
        self._hits, self._changes, self._poll_duration = 0, 0, 0.0
        self._last, self._complaint = "", ""
        self._refusals, self._refusal = 0, ""

    @abstractmethod
    def identifier(self) -> Identifier:
        """Follows the hits that the parameters name.

        Raises:
            InputError: A parameter is wrong.
        """

    def rehearse(self, spec: TrialSpec) -> None:
        self._identifier = self.identifier()

    def turn(self) -> None:
        self._poll()
        super().turn()

    def close(self) -> None:
        if self._identifier is not None:
            self._identifier.close()

    def status(self) -> tuple[str, Mapping[str, object]]:
        numbers: dict[str, object] = {"hits": self._hits, "changes": self._changes, "refused": self._refusals}
        numbers["last look [s]"] = round(self._poll_duration, 3)
        if self._refusal:
            numbers["last refused"] = self._refusal
        if self._complaint:
            return self._complaint, numbers
        return f"changed: {self._last}" if self._last else "ok", numbers

    def _poll(self) -> None:
        """Take the hits that have arrived, if a poll is due."""
        now = time.monotonic()
        if self._identifier is None or now - self._last_poll < self.parameter("poll_period"):
            return
        self._last_poll = now
        try:
            reports = self._identifier.arrived()
        except InputError as error:
            if self._complaint != str(error):
                self.log.warning(f"no hits: {error}")
            self._complaint = str(error)
            return
        except Exception as error:  # no file ends a node
            self._complaint = f"hits could not be followed: {type(error).__name__}: {error}"
            self.log.error(full_traceback(error), throttle_duration_sec=5.0)
            self._refuse(self._complaint, {"hit": "", "reason": self._complaint})
            return
        self._complaint = ""
        hits = [report for report in reports if report.hit]
        self._hits += len(hits)
        if hits:
            self._last_poll = -float("inf")  # more may wait
        for report in reports:
            if report.topic == "refused":
                self.log.warning(f"refused {report.line}")
                self._refuse(report.line, report.document)
                continue
            self.log.info(report.line)
            if report.topic:
                self._publish(report.topic, report.document)
            if report.topic == "change":
                self._changes += 1
                self._last = report.document["words"]
                self.log.warning(f"changed {self._last}")
        if hits and (prediction := self._identifier.prediction()):
            self._publish("prediction", prediction)
        self._poll_duration = time.monotonic() - now

    def _refuse(self, line: str, document: Mapping[str, Any]) -> None:
        """Count and publish a refused trial."""
        self._refusals, self._refusal = self._refusals + 1, line
        self._publish("refused", document)

    def _publish(self, topic: str, document: Mapping[str, Any]) -> None:
        self._publishers[topic].publish(filled(TOPICS[topic], document))
