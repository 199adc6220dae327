# SPDX-License-Identifier: Apache-2.0
"""What a fit changes in every signal, and whether that matters: in a world with a closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_world import EFFECTS, FLOOR, AnalyticSource, direction

from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.search.relevance import changes_of, exceeds_relevance_limit, noticeable, sizes_of
from impact_rs_sim.robots.robot import Array

LARGEST = max(np.abs(direction(number, 0)).max() for number in range(6))  # of a change by one scale of ``straight``


def fitted(source: AnalyticSource, name: str, change: float) -> Fit:
    """An effect, linearised where it does nothing, with an estimate [parameter scales] in place of the best."""
    found = Search([EFFECTS[name]], Evidence.of(source)).screening.linear_fit_with(None, name)
    return Fit(found.candidate, found.evidence, found.problem, np.array([change]))


@pytest.mark.parametrize(("distance", "size"), [(None, 2.5), (np.array([0.5]), 0.5)])
def test_a_linear_effect_changes_every_signal_by_what_it_adds(distance: Array | None, size: float) -> None:
    """Kills: a change in scaled features, with its sign, or from another place than the one that is given."""
    found = changes_of(fitted(AnalyticSource(1), "straight", -2.5), distance=distance)
    for number, moved in enumerate(found):
        np.testing.assert_allclose(moved, size * np.abs(direction(number, 0)), rtol=1e-6)


@pytest.mark.parametrize(("share", "enough"), [(0.99, False), (1.01, True)])
def test_a_change_matters_beyond_the_relevance_limit_of_one_signal(share: float, enough: bool) -> None:
    """Kills: all signals asked, or the limit in multiples of the noise."""
    assert exceeds_relevance_limit(fitted(AnalyticSource(1), "straight", share * FLOOR / LARGEST)) == enough


def test_what_an_effect_moves_is_listed_from_the_most_noticeable_on() -> None:
    """Kills: sizes sorted by value, or another than the largest change of a signal."""
    found = fitted(AnalyticSource(1), "straight", 5.0)
    limits = {f"signal {number}": limit for number, limit in enumerate((0.1, 3.0, 0.3, 1.0))}
    labels = tuple(replace(one, relevance_limit=limits[one.signal]) for one in found.evidence.clusters[0].features)
    clusters = tuple(replace(item, features=labels) for item in found.evidence.clusters)
    sizes = sizes_of(replace(found, evidence=replace(found.evidence, clusters=clusters)), "straight")
    largest = [max(np.abs(direction(number, 0))[own::4].max() for number in range(6)) for own in (0, 2, 3)]
    assert [(size.signal, size.floor) for size in sizes] == [("signal 0", 0.1), ("signal 2", 0.3), ("signal 3", 1.0)]
    np.testing.assert_allclose([size.value for size in sizes], 5.0 * np.array(largest), rtol=1e-6)


def test_what_stops_at_a_bound_is_not_noticeable() -> None:
    """Its interval means nothing there."""
    source = AnalyticSource(1, repeated=False)
    source.least_change = 0.1  # type: ignore[misc]
    assert noticeable(fitted(source, "one_sided", 49.0))
    assert not noticeable(fitted(source, "one_sided", 50.0))
