# SPDX-License-Identifier: Apache-2.0
"""The node publishes what a follower of hits says, and no file ends it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, get_args

import pytest

from impact_rs_analysis.following.documents import ChangeDiagnosis, PublishedChange, PublishedPrediction, RefusedHit
from impact_rs_ros.identify_node import TOPICS, HitReport, Identifier, IdentifyNode
from impact_rs_ros.message_types import message_type
from impact_rs_sim.errors import InputError
from impact_rs_sim.schema import Schema


class HitReports:
    """Hits that have been followed elsewhere."""

    def __init__(self, *looks: Sequence[HitReport] | Exception) -> None:
        self._looks = list(looks)

    def arrived(self) -> Sequence[HitReport]:
        found = self._looks.pop(0) if self._looks else ()
        if isinstance(found, Exception):
            raise found
        return found

    def prediction(self) -> dict[str, Any]:
        value = {
            "signal": "v",
            "index": "y",
            "phase": "push",
            "bin": 1,
            "value": -0.5,
            "ci95": (-0.6, -0.4),
            "unit": "m/s",
        }
        return {"condition": "", "like": "row 1", "values": (value,), "followed": ()}

    def close(self) -> None:
        """Nothing was started."""


class Log:
    """Keeps its lines."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __getattr__(self, level: str) -> object:
        return lambda line, **_: self.lines.append((level, line))


class Offline(IdentifyNode):
    """The node without a middleware; every look is due."""

    def __init__(self, followed: Identifier) -> None:
        self.log = Log()  # type: ignore[assignment]
        self.said: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
        self._publishers = {topic: SimpleNamespace(publish=said.append) for topic, said in self.said.items()}  # type: ignore[misc]
        self._refusals, self._refusal = 0, ""
        self._identifier, self._last_poll = followed, -float("inf")
        self._hits, self._changes, self._poll_duration, self._last, self._complaint = 0, 0, 0.0, "", ""

    def parameter(self, name: str) -> object:
        assert name == "poll_period"
        return 0.0

    def identifier(self) -> Identifier:
        raise AssertionError("it has one")

    def look(self) -> None:
        self._poll()


def test_a_change_is_published_and_warned_of_and_stays_on_diagnostics() -> None:
    cause = {"effect": "object_mass", "share": 1.0, "since": "row 1", "parameters": (), "words": "heavier"}
    text = dict.fromkeys(("instead", "apart", "diagnose"), "") | {"since": "row 1", "words": "since row 1 heavier"}
    numbers = {"since_time": None, "hits": 2, "log10_ratio": 9.0, "false_alarm": 1e5, "again": False}
    change = HitReport("row 2: off", "change", {"hit": "row 2", "causes": (cause,), **text, **numbers})
    node = Offline(HitReports([HitReport("row 1: off"), change], []))
    node.look()
    node.look()
    (changed,), (predicted,) = node.said["change"], node.said["prediction"]  # of the last hit, once
    assert (changed.hit, changed.causes[0].effect, changed.hits) == ("row 2", "object_mass", 2)
    assert math.isnan(changed.since_time)
    assert (predicted.like, predicted.values[0].ci95.tolist()) == ("row 1", [-0.6, -0.4])
    assert ("warning", "changed since row 1 heavier") in node.log.lines
    line, numbers = node.status()
    assert line == "changed: since row 1 heavier"
    assert (numbers["hits"], numbers["changes"]) == (2, 1)


def test_a_diagnosis_that_has_ended_is_published_and_is_no_hit() -> None:
    document = {"command": "", "file": "", "verdict": "object_mass", "words": ""}
    ended = HitReport("full diagnosis: CONFIRMED", "diagnosis", document, hit=False)
    node = Offline(HitReports([HitReport("row 1: off")], [ended]))
    node.look()
    node.look()
    assert [message.verdict for message in node.said["diagnosis"]] == ["object_mass"]
    assert ("info", "full diagnosis: CONFIRMED") in node.log.lines
    assert node.status()[1]["hits"] == 1 and len(node.said["prediction"]) == 1


@pytest.mark.parametrize("error", [InputError("no such folder"), ValueError("bytes")])
def test_hits_that_cannot_be_read_are_a_warning_and_the_next_ones_are_taken(error: Exception) -> None:
    node = Offline(HitReports(error, [HitReport("row 1: off")]))
    node.look()
    line, _ = node.status()
    assert str(error) in line
    assert len(node.said["refused"]) == (not isinstance(error, InputError))  # a look that failed for a reason unknown
    node.look()
    assert node.status()[0] == "ok"
    assert len(node.said["prediction"]) == 1


def test_what_gives_no_hit_is_published_warned_of_and_counted() -> None:
    refused = HitReport("r3: velocity is not finite", "refused", {"hit": "r3", "reason": "nan"}, hit=False)
    node = Offline(HitReports([refused, HitReport("r4: off")], []))
    node.look()
    node.look()
    assert [(message.hit, message.reason) for message in node.said["refused"]] == [("r3", "nan")]
    assert ("warning", "refused r3: velocity is not finite") in node.log.lines
    line, numbers = node.status()
    assert (line, numbers["hits"], numbers["refused"]) == ("ok", 1, 1)
    assert numbers["last refused"] == "r3: velocity is not finite"


@pytest.mark.parametrize(
    ("topic", "schema"),
    [("prediction", PublishedPrediction), ("change", PublishedChange), ("diagnosis", ChangeDiagnosis),
     ("refused", RefusedHit)],
)  # fmt: skip
def test_a_message_has_every_field_of_its_document_down_to_the_parameters(topic: str, schema: type[Schema]) -> None:
    """Fails where a field is added to a document of ``follow --json`` and not to the message, or the other way."""

    def same(kind: Any, schema: type[Schema]) -> None:
        fields = kind.get_fields_and_field_types()
        assert set(fields) == set(schema.model_fields)
        for name, field in fields.items():
            if field.startswith("sequence<"):
                (inner, _) = get_args(schema.model_fields[name].annotation)
                same(message_type(f"impact_rs/msg/{field[len('sequence<impact_rs/') : -1]}"), inner)

    same(TOPICS[topic], schema)
