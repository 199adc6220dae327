# SPDX-License-Identifier: Apache-2.0
"""Ends of intervals by profile likelihood: where the squares rise enough, in few batches of predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from analytic_world import EFFECTS, AnalyticSource, features, linearised

from impact_rs_analysis.diagnosis.search.fit import Fit
from impact_rs_analysis.diagnosis.search.intervals import MAX_INTERVAL_DOUBLINGS, MIN_RISE_RATIO, intervals_of
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_sim.robots.robot import Array


class Counting(AnalyticSource):
    """The world, with the size of every batch of predictions; ``lost`` effects cannot be simulated."""

    def __init__(self, seed: int, truth: Added = (), lost: Sequence[str] = ()) -> None:
        super().__init__(seed, truth)
        self.batches: list[int] = []
        self.lost = set(lost)

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        self.batches.append(len(wanted))
        found = super().predict(wanted, what)
        return [
            None if self.lost & {name for name, _ in added} else values
            for (_, added), values in zip(wanted, found, strict=True)
        ]


def fit_of(name: str, source: AnalyticSource) -> Fit:
    """Linear fit of an effect."""
    return Fit.of(*linearised(source, EFFECTS[name]))


def squares(fitted: Fit, name: str, value: float) -> float:
    """Sum of squares of an effect of one parameter, by the closed form of the world."""
    clusters = fitted.evidence.clusters
    rests = [item.mean - features(n, ((name, (value,)),)) / item.sigma for n, item in enumerate(clusters)]
    return float(sum(item.count * rest @ rest for item, rest in zip(clusters, rests, strict=True)))


@pytest.mark.parametrize(
    ("name", "hidden", "widened"), [("straight", 2.0, 0), ("saturated", 0.3, 0), ("slight", 0.0, 1)]
)
def test_an_end_is_the_first_doubling_at_which_the_squares_rise_half_as_much_as_linearly(
    name: str, hidden: float, widened: int
) -> None:
    """Kills: an end at the linear half width whatever the simulation says, and one that doubles once too often.

    ``slight`` saturates at 0.5, far inside the linear half width: no value is excluded, and every doubling is used.
    """
    fitted = fit_of(name, AnalyticSource(3, ((name, (hidden,)),)))
    start, half = fitted.estimate[0], fitted.half_widths[0] * fitted.candidate.scale[0]
    rise = MIN_RISE_RATIO * fitted.half_widths[0] ** 2 * fitted.problem.total[0, 0]
    [(_, high)] = intervals_of([(fitted, [0])])
    ends = [min(start + 2.0**k * half, fitted.widened_to_intervals.upper[0]) for k in range(MAX_INTERVAL_DOUBLINGS + 1)]
    enough = [squares(fitted, name, end) - squares(fitted, name, start) >= rise for end in ends]
    first = enough.index(True) if True in enough else ends.index(fitted.widened_to_intervals.upper[0])
    assert high[0] == pytest.approx(ends[first], rel=1e-9)
    assert min(first, 1) == widened


def test_ends_of_all_intervals_advance_together() -> None:
    """As many batches as the longest search has rounds, and the ends of a search of one parameter at a time.

    Kills one batch for every effect and end, which leaves vector lanes and workers idle.
    """
    names = ("straight", "bent", "slight", "of_joints", "twin_of_straight", "one_sided")
    source = Counting(4, (("straight", (2.0,)), ("slight", (0.1,))))
    fits = [fit_of(name, source) for name in names]
    wanted = [(fitted, range(fitted.candidate.point.size)) for fitted in fits]
    alone, rounds = [], []
    for fitted, parameters in wanted:
        for index in parameters:
            source.batches = []
            alone += intervals_of([(fitted, [index])])
            rounds.append(len(source.batches))
    source.batches = []
    together = intervals_of(wanted)
    assert len(source.batches) == max(rounds) <= sum(rounds) / 5
    for side in (0, 1):
        np.testing.assert_array_equal(
            np.concatenate([ends[side] for ends in together]), np.concatenate([ends[side] for ends in alone])
        )


def test_no_prediction_is_asked_for_twice_in_a_round() -> None:
    """The model and the estimate of a fit with 7 parameters are predicted once, not for each of its 14 ends."""
    source = Counting(5)
    fitted = fit_of("of_joints", source)
    source.batches = []
    intervals_of([(fitted, range(7))])
    clusters = len(source.clusters)
    assert source.batches[:2] == [2 * clusters, (1 + 14) * clusters]


def test_an_end_that_cannot_be_simulated_is_far_enough() -> None:
    """Kills a search that goes on, or fails, where a hit is missed: the squares are infinite there."""
    source = Counting(6, (("straight", (2.0,)),))
    fitted = fit_of("straight", source)
    [linear] = intervals_of([(fitted, [0])])
    source.lost = {"straight"}
    [lost] = intervals_of([(fitted, [0])])
    np.testing.assert_array_equal(lost, linear)


def test_nothing_is_predicted_where_nothing_is_wanted() -> None:
    source = Counting(7)
    fitted = fit_of("straight", source)
    source.batches = []
    [(low, high)] = intervals_of([(fitted, [])])
    assert intervals_of([]) == [] and low.size == high.size == 0 and source.batches == []


def test_an_end_at_a_bound_of_physics_is_not_simulated() -> None:
    """The lower end is the bound, whatever happens there. Kills a batch of replays whose result decides nothing."""
    source = Counting(8, (("one_sided", (0.02,)),))
    fitted = fit_of("one_sided", source)
    source.batches = []
    [(low, high)] = intervals_of([(replace(fitted, change=np.array([0.02])), [0])])
    clusters = len(source.clusters)
    assert low[0] == 0.0 < high[0] and set(source.batches) == {2 * clusters}  # the model, and one point at a time
