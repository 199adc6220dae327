# SPDX-License-Identifier: Apache-2.0
"""Whether an error is that of a right model: levels and power by draws, with the scatter of few repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import binom

from impact_rs_analysis.evidence.cluster import Cluster, Feature, pooled_error
from impact_rs_analysis.investigation.error_test import p_in_words, p_of_error
from impact_rs_sim.robots.robot import Array

FEATURES = 12


@dataclass(frozen=True)
class Campaign:
    """Conditions with repeats; the noise lives in some directions, its scale is estimated from the repeats.

    Attributes:
        counts: Repeats by condition.
        directions: In which the noise is, with as much again in each feature; 0: in every feature alike.
        limit: Relevance limit over the noise of a feature.
        discrepancy: What simulations differ by, over the noise of a feature.
    """

    counts: tuple[int, ...] = (2, 2, 2)
    directions: int = 0
    limit: float = 0.02
    discrepancy: float = 0.0

    def clusters(self, seed: int, shift: float = 0.0) -> list[Cluster]:
        """Residuals of a model that is right within limit and discrepancy; ``shift``: every feature is off by it."""
        rng, fixed = np.random.default_rng([seed, 1]), np.random.default_rng(0)
        root = np.vstack((fixed.standard_normal((self.directions, FEATURES)), np.eye(FEATURES) / 10.0))
        root = root if self.directions else np.eye(FEATURES)
        patterns = self.discrepancy * fixed.standard_normal((2, FEATURES))
        own = rng.standard_normal(2) @ patterns + shift
        below = self.limit / 2.0 * rng.standard_normal((len(self.counts), FEATURES))
        rows = [
            rng.standard_normal((n, len(root))) @ root + own + one for n, one in zip(self.counts, below, strict=True)
        ]
        pure, systematic = pooled_error(rows), np.sqrt(np.sum(np.square(patterns), axis=0))
        assert pure is not None
        sigma = np.sqrt(pure**2 + (self.limit / 2.0) ** 2 + systematic**2)
        features = tuple(Feature("impact", "signal", "x", number, "m/s", self.limit) for number in range(FEATURES))
        return [
            Cluster(
                name=str(number),
                condition_key=("world", "object", str(number)),
                layout="hit",
                unit=str(number),
                contact=True,
                features=features,
                residuals=values / sigma,
                sigma=sigma,
                pure_error=pure / sigma,
                discrepancy=systematic / sigma,
                patterns=patterns / sigma,
            )
            for number, values in enumerate(rows)
        ]

    def p_values(self, tested: Sequence[Sequence[int]], draws: int, shift: float = 0.0) -> Array:
        return np.array([p_of_error(self.clusters(seed, shift), tested) for seed in range(draws)])


ALL = [[0, 1]] * 3
LAST = [[], [], [0, 1]]


@pytest.mark.parametrize(
    ("tested", "campaign"),
    [
        (ALL, Campaign(directions=3)),
        (LAST, Campaign(directions=3)),
        (ALL, Campaign(directions=3, discrepancy=3.0)),
        (ALL, Campaign(directions=3, limit=4.0)),
        (ALL, Campaign(directions=2, limit=2.0)),
        (ALL, Campaign(directions=1, limit=2.0)),
    ],
)
def test_a_right_model_fails_as_often_as_the_level_says(tested: list[list[int]], campaign: Campaign) -> None:
    """Two-sided, at 1, 5 and 30 %, for scatter in some directions, as that of trials.

    Degrees of freedom of features instead of directions, discrepancy or limit left out of expectation or variance, or
    a mean without its repeats leave the band.
    """
    found = campaign.p_values(tested, 1000)
    for level in (0.01, 0.05, 0.3):
        low, high = binom.ppf([1e-4, 1 - 1e-4], found.size, level)
        assert 0.6 * low <= np.count_nonzero(found <= level) <= 1.4 * high


def test_with_scatter_in_every_feature_alone_a_right_model_fails_no_more_often() -> None:
    """Three contrasts do not say that there are so many directions: the test is careful there."""
    found = Campaign().p_values(ALL, 500)
    assert np.count_nonzero(found <= 0.01) <= binom.ppf(1 - 1e-4, found.size, 0.01)
    assert np.count_nonzero(found <= 0.5) > 0.1 * found.size


def test_an_error_beyond_noise_is_seen_and_one_below_the_relevance_limit_is_not() -> None:
    """Of two standard deviations in every feature, which is a third of half the limit."""
    assert np.mean(Campaign().p_values(ALL, 60, shift=2.0) <= 0.01) > 0.9
    assert np.mean(Campaign(limit=12.0).p_values(ALL, 60, shift=2.0) <= 0.01) < 0.1


def test_a_p_value_beyond_what_is_known_of_tails_is_a_bound() -> None:
    assert (p_in_words(0.0123), p_in_words(1e-9)) == ("p = 0.012", "p < 0.0005")


def test_single_trials_say_nothing() -> None:
    campaign = Campaign()
    single = [item.__class__(**{**vars(item), "residuals": item.residuals[:1]}) for item in campaign.clusters(0)]
    assert p_of_error(single, [[0]] * 3) is None
    assert p_of_error(campaign.clusters(0), [[]] * 3) is None
    assert p_of_error(campaign.clusters(0), LAST) == p_of_error(campaign.clusters(0), LAST)
