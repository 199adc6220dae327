# SPDX-License-Identifier: Apache-2.0
"""Verdict on a model, an effect, a joint of an effect, or a dependence; the text of verdicts is defined here alone."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, PlainSerializer, PlainValidator


class Kind(StrEnum):
    """Kind of a verdict: its word in files and reports."""

    NAMED = "NAMED"  # verdict on a model: names of the missing effects, without this word
    NOTHING = "NOTHING-MISSING"
    NONE = "NONE-EXPLAINS"
    PARTLY = "PARTLY"  # with the effects that explain a part
    IMPOSSIBLE = "IMPOSSIBLE-DATA"
    TOO_FEW = "TOO-FEW-REPEATS"
    SMALL = "PRESENT-BUT-SMALL"
    CONFIRMED = "CONFIRMED"
    CONFUSABLE = "CONFUSABLE-WITH"  # with the rivals
    UNIDENTIFIABLE = "NOT-IDENTIFIABLE"
    NO_IMPROVEMENT = "NO-IMPROVEMENT"
    AT_BOUND = "AT-BOUND"


WITH_NAMES = re.compile(rf"({Kind.PARTLY}|{Kind.CONFUSABLE})\{{(.*)\}}")


@dataclass(frozen=True)
class DiagnosisVerdict:
    """A verdict.

    Its text is the word of its kind, for ``PARTLY`` and ``CONFUSABLE`` followed by the names in braces, and for
    ``NAMED`` the names joined by ``+``. Documents have this text, and validate to a verdict.

    Attributes:
        kind: Its kind.
        names: The effects that explain (``NAMED``, ``PARTLY``), or the rivals (``CONFUSABLE``); else empty.
    """

    kind: Kind
    names: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.kind is Kind.NAMED:
            return "+".join(self.names)
        return self.kind.value if self.kind in WITHOUT_NAMES else f"{self.kind}{{{', '.join(self.names)}}}"

    @property
    def leaves_residuals(self) -> bool:
        """Whether something remains that no effect explains."""
        return self.kind in (Kind.NONE, Kind.PARTLY)

    @classmethod
    def parse(cls, text: str | DiagnosisVerdict) -> DiagnosisVerdict:
        """The verdict with a text; any text that is no other verdict names effects."""
        if isinstance(text, DiagnosisVerdict):
            return text
        if not isinstance(text, str):
            raise ValueError("expected a verdict")
        if (match := WITH_NAMES.fullmatch(text)) is not None:
            return cls(Kind(match[1]), tuple(match[2].split(", ")))
        return cls(Kind(text)) if text in WITHOUT_NAMES else cls(Kind.NAMED, tuple(text.split("+")))

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Read from its text, written as its text."""
        text = Annotated[Any, PlainValidator(cls.parse), PlainSerializer(str)]
        return handler.generate_schema(text)


WITHOUT_NAMES = frozenset(Kind) - {Kind.NAMED, Kind.PARTLY, Kind.CONFUSABLE}  # without names

NOTHING = DiagnosisVerdict(Kind.NOTHING)
NONE = DiagnosisVerdict(Kind.NONE)
IMPOSSIBLE = DiagnosisVerdict(Kind.IMPOSSIBLE)
TOO_FEW = DiagnosisVerdict(Kind.TOO_FEW)
SMALL = DiagnosisVerdict(Kind.SMALL)
CONFIRMED = DiagnosisVerdict(Kind.CONFIRMED)
UNIDENTIFIABLE = DiagnosisVerdict(Kind.UNIDENTIFIABLE)
NO_IMPROVEMENT = DiagnosisVerdict(Kind.NO_IMPROVEMENT)
AT_BOUND = DiagnosisVerdict(Kind.AT_BOUND)
