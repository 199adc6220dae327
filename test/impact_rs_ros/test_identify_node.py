# SPDX-License-Identifier: Apache-2.0
"""The node publishes what a follower of hits says, and no file ends it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from types import SimpleNamespace

import pytest
from std_msgs.msg import String

from impact_rs_ros.identify_node import Identifier, IdentifyNode, Lesson
from impact_rs_sim.errors import InputError


class Lessons:
    """Hits that have been followed elsewhere."""

    def __init__(self, *looks: Sequence[Lesson] | Exception) -> None:
        self._looks = list(looks)

    def arrived(self) -> Sequence[Lesson]:
        found = self._looks.pop(0) if self._looks else ()
        if isinstance(found, Exception):
            raise found
        return found

    def prediction(self) -> str:
        return json.dumps({"like": "row 1"})

    def close(self) -> None:
        """Nothing was started."""


class Log:
    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __getattr__(self, level: str) -> object:
        return lambda line, **_: self.lines.append((level, line))


class Offline(IdentifyNode):
    """The node without a middleware; every look is due."""

    def __init__(self, followed: Identifier) -> None:
        self.log = Log()  # type: ignore[assignment]
        self.predicted: list[String] = []
        self.changed: list[String] = []
        self._prediction = SimpleNamespace(publish=self.predicted.append)  # type: ignore[assignment]
        self._change = SimpleNamespace(publish=self.changed.append)  # type: ignore[assignment]
        self.diagnosed: list[String] = []
        self._diagnosis = SimpleNamespace(publish=self.diagnosed.append)  # type: ignore[assignment]
        self.refused: list[String] = []
        self._refused = SimpleNamespace(publish=self.refused.append)  # type: ignore[assignment]
        self._refusals, self._refusal = 0, ""
        self._identifier, self._looked = followed, -float("inf")
        self._hits, self._changes, self._spent, self._last, self._complaint = 0, 0, 0.0, "", ""

    def parameter(self, name: str) -> object:
        assert name == "poll_period"
        return 0.0

    def identifier(self) -> Identifier:
        raise AssertionError("it has one")

    def look(self) -> None:
        self._look()


def test_a_change_is_published_and_warned_of_and_stays_on_diagnostics() -> None:
    change = Lesson("row 2: off", json.dumps({"hit": "row 2"}), "since row 1 heavier")
    node = Offline(Lessons([Lesson("row 1: off"), change], []))
    node.look()
    node.look()
    assert [json.loads(message.data) for message in node.changed] == [{"hit": "row 2"}]
    assert [json.loads(message.data) for message in node.predicted] == [{"like": "row 1"}]  # of the last hit, once
    assert ("warning", "changed since row 1 heavier") in node.log.lines
    line, numbers = node.status()
    assert line == "changed: since row 1 heavier"
    assert (numbers["hits"], numbers["changes"]) == (2, 1)


def test_a_diagnosis_that_has_ended_is_published_and_is_no_hit() -> None:
    ended = Lesson("full diagnosis: CONFIRMED", diagnosis=json.dumps({"verdict": "object_mass"}), hit=False)
    node = Offline(Lessons([Lesson("row 1: off")], [ended]))
    node.look()
    node.look()
    assert [json.loads(message.data) for message in node.diagnosed] == [{"verdict": "object_mass"}]
    assert ("info", "full diagnosis: CONFIRMED") in node.log.lines
    assert node.status()[1]["hits"] == 1 and len(node.predicted) == 1


@pytest.mark.parametrize("error", [InputError("no such folder"), ValueError("bytes")])
def test_hits_that_cannot_be_read_are_a_warning_and_the_next_ones_are_taken(error: Exception) -> None:
    node = Offline(Lessons(error, [Lesson("row 1: off")]))
    node.look()
    line, _ = node.status()
    assert str(error) in line
    assert len(node.refused) == (not isinstance(error, InputError))  # a look that failed for a reason unknown
    node.look()
    assert node.status()[0] == "ok"
    assert len(node.predicted) == 1


def test_what_gives_no_hit_is_published_warned_of_and_counted() -> None:
    refused = Lesson("r3: velocity is not finite", refused=json.dumps({"hit": "r3", "reason": "nan"}), hit=False)
    node = Offline(Lessons([refused, Lesson("r4: off")], []))
    node.look()
    node.look()
    assert [json.loads(message.data) for message in node.refused] == [{"hit": "r3", "reason": "nan"}]
    assert ("warning", "refused r3: velocity is not finite") in node.log.lines
    line, numbers = node.status()
    assert (line, numbers["hits"], numbers["refused"]) == ("ok", 1, 1)
    assert numbers["last refused"] == "r3: velocity is not finite"
