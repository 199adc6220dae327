# SPDX-License-Identifier: Apache-2.0
"""The page of a discovery shows the law as a formula, and its force with band and points."""

from __future__ import annotations

from pathlib import Path

import pytest

from impact_rs_analysis.diagnosis.discovery_document import (
    DESCRIBED,
    FOUND,
    NO_LAW,
    CurveDocument,
    DiscoveryDocument,
    DomainDocument,
    LawDocument,
    NumberDocument,
    PointDocument,
)
from impact_rs_analysis.report.discovery import law_plot, write_report

LAW = LawDocument(
    name="object_drag_square",
    sentence="Drag on the object, with the square of its speed.",
    place="force on the object",
    formula="-(c * object_speed) * (object_vx, object_vy, object_vz)",
    parameters={"c": NumberDocument(estimate=8.0, ci95=(7.5, 8.5), unit="N s^2/m^2")},
    verdict="CONFIRMED",
    held_out_error_before=12.6,
    held_out_error_after=0.7,
    p_value=0.0005,
    valid=DomainDocument(quantity="object_speed", low=0.0, high=0.5, unit="m/s"),
    curve=CurveDocument(
        at=(0.0, 0.5),
        law=(0.0, 2.0),
        law_ci95=((0.0, 0.0), (1.9, 2.1)),
        points=(PointDocument(at=0.4, force=1.2, ci95=(1.0, 1.5), law=1.3),),
        unit="N",
    ),
)


def document(verdict: str, *laws: LawDocument) -> DiscoveryDocument:
    return DiscoveryDocument(verdict=verdict, summary="In words.", laws=laws, error_unit="times repeatability")


def test_the_page_says_the_law_and_draws_it(tmp_path: Path) -> None:
    page = write_report(document(FOUND, LAW), tmp_path).read_text()
    for text in ("LAW-FOUND", "-(c * object_speed)", "N s^2/m^2", "from 0 to 0.5"):
        assert text in page
    points = law_plot(LAW).data[-1]
    assert (points.error_y.array[0], points.error_y.arrayminus[0]) == pytest.approx((0.3, 0.2))


def test_the_page_of_a_curve_shows_its_values_and_no_formula(tmp_path: Path) -> None:
    curve = LAW.model_copy(update={"name": "object_drag_curve_5", "formula": "f0 * max(0, 1)", "curved": True})
    page = write_report(document(DESCRIBED, curve), tmp_path).read_text()
    assert "f0 * max" not in page
    for text in ("CURVE-FOUND", "What remains, as a curve", "over object_speed", "1 values [N", "it falls to 0"):
        assert text in page


def test_a_page_without_a_law_has_no_picture(tmp_path: Path) -> None:
    page = write_report(document(NO_LAW), tmp_path).read_text()
    assert "NO-LAW-HOLDS" in page and 'data-figure="law"' not in page
