# SPDX-License-Identifier: Apache-2.0
"""A discovery as a file (``discovery.json``), written by ``impact-rs discover`` and read by ``impact-rs add``."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import Field

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.verdict import DiagnosisVerdict
from impact_rs_sim.files import write_whole
from impact_rs_sim.schema import Schema

FOUND = "LAW-FOUND"
DESCRIBED = "CURVE-FOUND"
NO_LAW = "NO-LAW-HOLDS"
LIBRARY = "LIBRARY-EXPLAINS"


class NumberDocument(Schema):
    """One estimated number of a law."""

    estimate: float = Field(description="estimate, in its unit")
    ci95: tuple[float, float] | None = Field(description="95 % interval, in its unit; null: no interval is known")
    unit: str = Field(description="unit, '-' where it has none")


class DomainDocument(Schema):
    """Range of a quantity in which a law was measured."""

    quantity: str = Field(description="the quantity that it depends on, in symbols of formulas")
    low: float = Field(description="smallest value that was measured, in the unit")
    high: float = Field(description="largest value that was measured, in the unit")
    unit: str = Field(description="unit")


class PointDocument(Schema):
    """A value of a free curve in the place of a law, fitted to the same data."""

    at: float = Field(description="the quantity, in its unit")
    force: float = Field(description="force or torque at this value, in the unit")
    ci95: tuple[float, float] = Field(description="95 % interval, in the unit")
    law: float = Field(description="force or torque of the law at this value, in the unit")


class CurveDocument(Schema):
    """Force of a law over its quantity, and of a free curve."""

    at: tuple[float, ...] = Field(description="values of the quantity, in its unit")
    law: tuple[float, ...] = Field(description="force or torque of the law at these values, in the unit")
    law_ci95: tuple[tuple[float, float], ...] = Field(description="its 95 % band, in the unit")
    points: tuple[PointDocument, ...] = Field(description="free curve, at knots that the data determine")
    unit: str = Field(description="unit of force or torque")


class LawDocument(Schema):
    """One law with its evidence."""

    name: str = Field(description="name, for add")
    sentence: str = Field(description="the law in one sentence")
    place: str = Field(description="torque, force or coefficient that it adds to, with its unit")
    formula: str = Field(description="the law")
    curved: bool = Field(False, description="whether it is a free curve, whose parameters are its values at knots")
    parameters: dict[str, NumberDocument] = Field(description="estimates by name")
    verdict: DiagnosisVerdict = Field(description="verdict, as on an effect of a diagnosis")
    held_out_error_before: float = Field(description="error on unseen conditions without it")
    held_out_error_after: float = Field(description="error on unseen conditions with it")
    p_value: float = Field(description="p-value, adjusted for all tried laws and effects")
    tied_with: tuple[str, ...] = Field((), description="laws and effects that predict as well in its place")
    tie: str = Field("", description="why they cannot be distinguished, and which measurement would; empty: no tie")
    valid: DomainDocument | None = Field(None, description="measured range; null: the quantity was not measured")
    curve: CurveDocument | None = Field(None, description="free curve in place of the law; null: not fitted")


class DiscoveryDocument(Schema):
    """``discovery.json``."""

    format: int = Field(1, description="version of this format")
    verdict: str = Field(
        description="LAW-FOUND, CURVE-FOUND, NO-LAW-HOLDS, LIBRARY-EXPLAINS, NOTHING-MISSING, PRESENT-BUT-SMALL, "
        "TOO-FEW-REPEATS or IMPOSSIBLE-DATA"
    )
    summary: str = Field(description="the verdict in words")
    laws: tuple[LawDocument, ...] = Field((), description="the law and those tied with it, best first")
    others: tuple[LawDocument, ...] = Field((), description="other laws in place of the first, best first")
    looked_at: int = Field(0, description="number of tried laws and effects")
    starts: int = Field(0, description="number of tried laws and effects, once per start of a shape")
    error_unit: str = Field(description="unit of the held-out errors")
    diagnosis: DiagnosisDocument | None = Field(None, description="the search as a diagnosis; null: no search")


def is_discovery(path: Path) -> bool:
    """Whether a file, which :func:`~impact_rs_analysis.diagnosis.document.read_document` reads, is a discovery."""
    return "laws" in json.loads(path.read_text(encoding="utf-8"))


def write_discovery(document: DiscoveryDocument, path: Path) -> None:
    """Write ``discovery.json`` atomically; an earlier one is replaced.

    Raises:
        InputError: It cannot be written.
    """
    write_whole(path, json.dumps(document.model_dump(mode="json"), indent=2, allow_nan=False) + "\n")
