# SPDX-License-Identifier: Apache-2.0
"""Model discrepancy: what was measured is found again at every feature, and only where it was measured."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.thresholds import INDEPENDENT_DISCREPANCY_SHARE
from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.discrepancy import (
    NO_DISCREPANCY,
    PATTERNS_FILE,
    Discrepancy,
    DiscrepancyEntry,
    Patterns,
    measured_discrepancy,
    read_patterns,
    write_patterns,
)
from impact_rs_analysis.evidence.replays.features import layout
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory


def entry(kind: str, value: float, by_bin: tuple[float, ...] = ()) -> DiscrepancyEntry:
    return DiscrepancyEntry(
        kind=kind, phase="impact", signal="contact force", index="x", unit="N", value=value, by_bin=by_bin
    )


def of_entries(*entries: DiscrepancyEntry, patterns: tuple[Patterns, ...] = ()) -> Discrepancy:
    return Discrepancy(provenance=None, variants={}, entries=entries, patterns=patterns)


def feature(number: int, index: str = "x") -> Feature:
    return Feature("impact", "contact force", index, number, "N", 1.0)


def test_contact_and_free_motion_have_their_own() -> None:
    known = of_entries(entry("square", 3.0), entry("free", 0.5))
    assert known.of([feature(0)], "square") == pytest.approx(3.0)
    assert known.of([feature(0)], "free") == pytest.approx(0.5)


def test_a_bin_is_half_its_own_and_half_the_signal_s() -> None:
    known = of_entries(entry("square", 3.0, (1.0, 5.0)))
    np.testing.assert_allclose(known.of([feature(0), feature(1)], "square"), np.sqrt([(9 + 1) / 2, (9 + 25) / 2]))


def test_both_arms_have_the_discrepancy_of_one_the_unmeasured_has_none() -> None:
    known = of_entries(entry("square", 3.0))
    features = [feature(0, "left.x"), feature(0, "right.x"), feature(0, "y")]
    assert known.of(features, "square").tolist() == [3.0, 3.0, 0.0]
    assert not np.any(NO_DISCREPANCY.of([feature(0)], "square"))


def features_of(kind: str) -> list[Feature]:
    """All features of a run."""
    free = kind == "free"
    return list(layout((("arm", ("revolute",) * 7),), 12 if free else 4, None if free else 4, True, True, ("object",)))


def test_features_of_a_joint_that_slides_are_in_newtons_and_metres() -> None:
    features = layout((("arm", ("prismatic", "revolute")),), 1, 1, True, True, ())
    units = {(feature.signal, feature.index): feature.unit for feature in features}
    signals = ("motor torque balance", "link torque balance", "elastic deflection", "joint velocity jump")
    assert [units[signal, "joint1"] for signal in signals] == ["N", "N", "m", "m/s"]
    assert [units[signal, "joint2"] for signal in signals] == ["N m", "N m", "rad", "rad/s"]


@pytest.mark.parametrize("kind", ["free", "square", "oblique"])
def test_the_shipped_one_covers_every_feature_of_a_run_in_its_unit(kind: str) -> None:
    known, features = measured_discrepancy(), features_of(kind)
    entries = {(e.phase, e.signal, e.index): e for e in known.entries if e.kind == kind}
    assert {f.group for f in features} <= entries.keys()
    assert all(entries[f.group].unit == f.unit for f in features)
    assert np.all(np.isfinite(known.of(features, kind)))
    assert known.provenance is not None and known.provenance.command


@pytest.mark.parametrize("kind", ["free", "square", "oblique"])
def test_patterns_have_the_size_of_every_feature_and_move_several(kind: str) -> None:
    known, features = measured_discrepancy(), features_of(kind)
    patterns, size = known.patterns_of(features, kind), known.of(features, kind)
    np.testing.assert_allclose(np.sqrt(np.square(patterns).sum(axis=0)), size, rtol=1e-9, atol=1e-30)
    assert np.count_nonzero(patterns, axis=1).max() > 50


def test_a_feature_that_no_pattern_knows_moves_by_itself() -> None:
    table = Patterns(
        kind="square",
        features=(("impact", "contact force", "x", 0), ("impact", "contact force", "x", 1)),
        rows=((3.0, 4.0), (-1.0, 0.0)),
    )
    known = of_entries(entry("square", 2.0), patterns=(table,))
    patterns = known.patterns_of([feature(0), feature(1), feature(7)], "square")
    np.testing.assert_allclose(np.sqrt(np.square(patterns).sum(axis=0)), 2.0)
    np.testing.assert_allclose(patterns[0, :2], [2.0 * 3.0 / np.sqrt(10.0), 2.0])
    np.testing.assert_allclose(patterns[-1], [0.0, 0.0, 2.0])
    assert known.patterns_of([feature(0)], "oblique") is None


def test_the_table_of_patterns_is_read_as_it_was_written(tmp_path: Path) -> None:
    features = [feature(0), feature(1, "y")]
    write_patterns(tmp_path / "t.csv", {"free": (features, [("half_step", "slow", [0.5, -1e-6])])})
    (table,) = read_patterns(tmp_path / "t.csv")
    assert (table.kind, table.rows) == ("free", ((0.5, -1e-6),))
    assert table.features == (("impact", "contact force", "x", 0), ("impact", "contact force", "y", 1))
    (tmp_path / "t.csv").write_text("free,half_step,slow,much\n")
    with pytest.raises(InputError, match=r"t\.csv: no table of patterns"):
        read_patterns(tmp_path / "t.csv")


def test_of_a_simulator_left_out_a_third_is_no_sum_of_the_others() -> None:
    """Share of its differences, on the scale of the discrepancy; the mean over kinds of trials and simulators.

    Left out are Bullet, MuJoCo or the twin with finer steps, each with all its variants: those of one span each other.
    """
    known = measured_discrepancy()
    shares = []
    with (config_directory() / PATTERNS_FILE).open(encoding="utf-8") as file:
        table = [row for row in csv.reader(file) if row]
    for patterns in known.patterns:
        features = [Feature(*place, "-", 0.0) for place in patterns.features]
        size = known.of(features, patterns.kind)
        rows = np.array(patterns.rows)[:, size > 0.0] / size[size > 0.0]
        simulators = np.array([row[1].split("_")[0] for row in table if row[0] == patterns.kind])
        assert len(simulators) == len(rows) and len(np.unique(simulators)) == 3
        for simulator in np.unique(simulators):
            own, others = rows[simulators == simulator], rows[simulators != simulator]
            span = np.linalg.svd(others, full_matrices=False)[2]
            shares.append(np.sum(np.square(own - own @ span.T @ span)) / np.sum(np.square(own)))
    assert np.mean(shares) == pytest.approx(INDEPENDENT_DISCREPANCY_SHARE, abs=0.05)
