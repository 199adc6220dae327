# SPDX-License-Identifier: Apache-2.0
"""Drift over a campaign: found among repeats, named with its size, and no effect of the conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from analytic_world import FEATURES, AnalyticSource, assert_uniform, correlated

from impact_rs_analysis.diagnosis.drift import drift_in_words, drift_of, low_confidence_sentence
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANCE_LEVEL
from impact_rs_analysis.evidence.cluster import Cluster

CONDITIONS, REPEATS = 6, 3
COUNT = CONDITIONS * REPEATS
LISTED = np.arange(COUNT, dtype=float).reshape(CONDITIONS, REPEATS)
SIGNAL = np.arange(FEATURES) % 4 == 2  # "signal 2"
RANDOM = np.random.default_rng(0).permutation(COUNT).astype(float).reshape(CONDITIONS, REPEATS)


def campaign(seed: int, order: np.ndarray, change: float = 0.0) -> list[Cluster]:
    """Clusters measured in an order, with a signal that changes so much from the first to the last run."""
    clusters = AnalyticSource(seed, design=(REPEATS,) * CONDITIONS, correlation=correlated()).clusters
    return [
        replace(
            item,
            residuals=item.residuals + np.outer(stamps / (COUNT - 1.0), change * SIGNAL) / item.sigma,
            timestamps=1e9 + 60.0 * stamps,
        )
        for item, stamps in zip(clusters, order, strict=True)
    ]


def test_without_drift_p_is_uniform() -> None:
    assert_uniform([drift_of(campaign(seed, RANDOM)).p_value for seed in range(200)])  # type: ignore[union-attr]


@pytest.mark.parametrize("change", [-30.0, 30.0])
def test_a_drift_is_named_with_its_size_and_direction(change: float) -> None:
    found = drift_of(campaign(1, RANDOM, change))
    assert found is not None and found.p_value < SIGNIFICANCE_LEVEL and not found.confounded
    assert found.signal == "signal 2" and found.runs == COUNT
    assert found.change == pytest.approx(change, rel=0.2)
    words = drift_in_words(found)
    assert ("falls" if change < 0.0 else "rises") in words and "18 runs" in words and "low confidence" not in words


def test_in_an_order_by_conditions_a_drift_lowers_the_confidence() -> None:
    found = drift_of(campaign(1, LISTED, 90.0))
    assert found is not None and found.confounded and found.p_value < SIGNIFICANCE_LEVEL
    assert drift_in_words(found).startswith("low confidence") and "random order" in drift_in_words(found)
    assert low_confidence_sentence(found).startswith("Confidence is low: the signal 2 x drifts")
    quiet = drift_of(campaign(1, LISTED))
    assert quiet is not None and "No drift is seen" in drift_in_words(quiet)
    assert (
        low_confidence_sentence(quiet)
        == low_confidence_sentence(drift_of(campaign(1, RANDOM, 90.0)))
        == low_confidence_sentence(None)
        == ""
    )


def test_what_a_model_lacks_is_no_drift() -> None:
    """Conditions differ by a hundred standard deviations, and repeats of one do not."""
    clusters = [replace(item, residuals=item.residuals + 100.0 * n) for n, item in enumerate(campaign(2, RANDOM))]
    found, before = drift_of(clusters), drift_of(campaign(2, RANDOM))
    assert found is not None and before is not None and found.p_value == before.p_value


def test_signals_of_unrepeated_conditions_take_no_part() -> None:
    """Kills: groups of features from all clusters, where a signal without repeats has the largest correlation, 0."""
    for seed in range(20):
        clusters = campaign(seed, RANDOM)
        other = tuple(replace(feature, signal="deflection") for feature in clusters[0].features)
        single = replace(
            clusters[0], layout="push", features=other, residuals=clusters[0].residuals[:1], timestamps=np.array([2e9])
        )
        found, before = drift_of([*clusters, single]), drift_of(clusters)
        assert found is not None and before is not None
        assert (found.signal, found.p_value) == (before.signal, before.p_value)


@pytest.mark.parametrize("stamps", [[None] * 6, [np.zeros(3)] * 6])
def test_where_the_order_is_unknown_nothing_is_said(stamps: Sequence[np.ndarray | None]) -> None:
    clusters = [replace(item, timestamps=own) for item, own in zip(campaign(0, RANDOM), stamps, strict=True)]
    assert drift_of(clusters) is None and drift_in_words(None) == ""


def test_a_single_repeat_too_few_decides_nothing() -> None:
    clusters = campaign(0, RANDOM)
    alone = [replace(item, residuals=item.residuals[:1], timestamps=item.timestamps[:1]) for item in clusters]
    assert drift_of([clusters[0], *alone[1:]]) is None
