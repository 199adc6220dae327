"""Model discrepancy: what was measured is found again at every feature, and only where it was measured."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY, Discrepancy, DiscrepancyEntry, measured_discrepancy
from impact_rs_analysis.evidence.features import layout


def entry(hit: bool, value: float, by_bin: tuple[float, ...] = ()) -> DiscrepancyEntry:
    return DiscrepancyEntry(
        hit=hit, phase="impact", signal="contact force", index="x", unit="N", value=value, by_bin=by_bin
    )


def feature(number: int, index: str = "x") -> Feature:
    return Feature("impact", "contact force", index, number, "N", 1.0)


def test_contact_and_free_motion_have_their_own() -> None:
    known = Discrepancy(provenance=None, variants={}, entries=(entry(True, 3.0), entry(False, 0.5)))
    assert known.of([feature(0)], hit=True) == pytest.approx(3.0)
    assert known.of([feature(0)], hit=False) == pytest.approx(0.5)


def test_a_bin_is_half_its_own_and_half_the_signal_s() -> None:
    known = Discrepancy(provenance=None, variants={}, entries=(entry(True, 3.0, (1.0, 5.0)),))
    np.testing.assert_allclose(known.of([feature(0), feature(1)], True), np.sqrt([(9 + 1) / 2, (9 + 25) / 2]))


def test_both_arms_have_the_discrepancy_of_one_and_what_was_not_measured_has_none() -> None:
    known = Discrepancy(provenance=None, variants={}, entries=(entry(True, 3.0),))
    assert known.of([feature(0, "left.x"), feature(0, "right.x"), feature(0, "y")], True).tolist() == [3.0, 3.0, 0.0]
    assert not np.any(NO_DISCREPANCY.of([feature(0)], True))


@pytest.mark.parametrize("hit", [True, False])
def test_the_shipped_one_covers_every_feature_of_a_trial_in_its_unit(hit: bool) -> None:
    known = measured_discrepancy()
    features = layout(("arm",), 7, hit)
    entries = {(e.phase, e.signal, e.index): e for e in known.entries if e.hit == hit}
    assert {f.group for f in features} <= entries.keys()
    assert all(entries[f.group].unit == f.unit for f in features)
    assert np.all(np.isfinite(known.of(features, hit)))
    assert known.provenance is not None and known.provenance.command
