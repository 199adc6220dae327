# SPDX-License-Identifier: Apache-2.0
"""95 % intervals of parameters by profile likelihood, corrected by simulation.

If features are nonlinear (a box tips, a contact slips), the sensitivities at the estimate do not hold at the end of an
interval. An end starts at the half width h of the linear model (:attr:`Fit.half_widths`) and is simulated with the
other parameters on the profile of the linear model,

    b(h) = b + h A^-1 e_i / (A^-1)_ii,        Q(b(h)) - Q(b) = h^2 / (A^-1)_ii        (linear model)

The end moves out until the sum of squares Q rises at least ``MIN_RISE_RATIO`` times as much as in the linear model. If
it rises much more, the valley is curved, as for the length of a cable and the position of its end, and the other
parameters are fitted again.

The search of one end is a generator: it yields the next point and receives the features at this point. The searches of
all ends advance together, with one batch of predictions in each round.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.diagnosis.search.fit import MAX_STEPS_OF_TRIALS, MIN_RELATIVE_DECREASE, Fit
from impact_rs_sim.progress import ENDS
from impact_rs_sim.robots.robot import Array

MAX_INTERVAL_DOUBLINGS = 8  # of the half width
MIN_RISE_RATIO = 0.5  # actual over linear rise of the squares at an end of the interval; below, the end moves out
MAX_RISE_RATIO = 2.0  # likewise; above, the other parameters are fitted again

Offsets = tuple[Array, ...]  # per cluster, scaled features at a point minus those at the candidate's origin, (F,) each
Simulations = Generator[Array, Offsets | None, float]  # yields points, (p,); None: a cluster cannot be simulated there


def intervals_of(requests: Sequence[tuple[Fit, Sequence[int]]]) -> list[tuple[Array, Array]]:
    """Lower and upper ends of 95 % intervals in units of the parameters, ``(k,)`` each, for every fit.

    Intervals end at bounds of physics, not at search limits.

    Args:
        requests: Fits to evidence of one source, with the indices of k parameters each.
    """
    profiles = [(Profile(fitted), list(parameters)) for fitted, parameters in requests]
    ends = [
        (profile, profile.end(index, side))
        for side in (-1.0, 1.0)
        for profile, parameters in profiles
        for index in parameters
    ]
    results = iter(_results(ends))
    low, high = ([np.array([next(results) for _ in indices]) for _, indices in profiles] for _ in range(2))
    estimates = [profile.fitted.estimate[indices] for profile, indices in profiles]
    return [(np.minimum(a, b), np.maximum(c, b)) for a, b, c in zip(low, estimates, high, strict=True)]


@dataclass(frozen=True)
class Profile:
    """Profile of the sum of squares about a fit.

    Attributes:
        fitted: The fit.
    """

    fitted: Fit

    @cached_property
    def _candidate(self) -> Candidate:
        """The candidate with ranges as wide as the intervals."""
        return self.fitted.widened_to_intervals

    @cached_property
    def _inverse(self) -> Array:
        """Inverse of the information, ``(p, p)``."""
        return np.linalg.inv(self.fitted.problem.total)

    def end(self, index: int, side: float) -> Simulations:
        """One end of the interval of a parameter, in its unit.

        Args:
            index: The parameter.
            side: -1: lower end; 1: upper end.
        """
        fitted, candidate, inverse = self.fitted, self._candidate, self._inverse
        reach = fitted.half_widths[index]
        linear_rise = reach**2 / inverse[index, index]
        lowest = self._squares((yield fitted.estimate))
        lowest = lowest if np.isfinite(lowest) else 0.0  # without a reference the end stays at its linear value
        lower, upper = candidate.lower[index], candidate.upper[index]
        for _ in range(MAX_INTERVAL_DOUBLINGS):
            step = side * reach * inverse[:, index] / inverse[index, index] * candidate.scale
            point = np.clip(fitted.estimate + step, candidate.lower, candidate.upper)
            if not lower < point[index] < upper:  # the end is the bound, however little the squares rise there
                break
            rise = self._squares((yield point)) - lowest
            if rise > MAX_RISE_RATIO * linear_rise and candidate.curved(index):
                rise = min(rise, (yield from self._refitted(index, point)) - lowest)
            if rise >= MIN_RISE_RATIO * linear_rise:
                break
            reach *= 2.0
        end = fitted.estimate[index] + side * reach * candidate.scale[index]
        return float(np.clip(end, lower, upper))

    def _refitted(self, index: int, point: Array) -> Simulations:
        """Sum of squares at one parameter value, with the others fitted by the sensitivities at the estimate."""
        widened, evidence = self._candidate, self.fitted.evidence
        fixed = np.arange(point.size) == index
        lower, upper = np.where(fixed, point, widened.lower), np.where(fixed, point, widened.upper)
        candidate, lowest = replace(widened, lower=lower, upper=upper), np.inf
        for _ in range(MAX_STEPS_OF_TRIALS):
            offsets = yield point
            if offsets is None:
                break
            squares = self._squares(offsets)
            if squares > (1.0 - MIN_RELATIVE_DECREASE) * lowest:
                return min(squares, lowest)
            lowest, point = squares, Fit.of(replace(candidate, point=point, offsets=offsets), evidence).estimate
        return lowest

    def _squares(self, offsets: Offsets | None) -> float:
        """Sum of squared scaled residuals with all repeats [-]; infinite where they cannot be simulated."""
        if offsets is None:
            return np.inf
        pairs = zip(self.fitted.evidence.clusters, offsets, strict=True)
        means = [(item.count, item.mean - offset) for item, offset in pairs]
        return sum(count * float(mean @ mean) for count, mean in means)


def _results(searches: Sequence[tuple[Profile, Simulations]]) -> list[float]:
    """Results of searches that advance together, with one batch of predictions in each round."""
    results = [np.nan] * len(searches)
    points = {number: next(search) for number, (_, search) in enumerate(searches)}
    while points:
        offsets = _offsets([(searches[number][0].fitted, point) for number, point in points.items()])
        next_points = {}
        for number, features_at_point in zip(points, offsets, strict=True):
            try:
                next_points[number] = searches[number][1].send(features_at_point)
            except StopIteration as end:
                results[number] = end.value
        points = next_points
    return results


def _offsets(requests: Sequence[tuple[Fit, Array]]) -> list[Offsets | None]:
    """Offsets of every fit at a point, from one batch of predictions; each prediction is made once."""
    pairs = [(fitted, fitted.candidate.origin, fitted.candidate.effects_at(point)) for fitted, point in requests]
    tasks = dict.fromkeys((n, added) for fit, *ends in pairs for added in ends for n in fit.evidence.numbers)
    predictions = requests[0][0].evidence.source.predict(list(tasks), ENDS)
    features = dict(zip(tasks, predictions, strict=True))
    results: list[Offsets | None] = []
    for fitted, before, after in pairs:
        offsets = []
        for number, item in zip(fitted.evidence.numbers, fitted.evidence.clusters, strict=True):
            first, second = features[number, before], features[number, after]
            if first is None or second is None:
                break
            offsets.append((second - first) / item.sigma)
        results.append(tuple(offsets) if len(offsets) == len(fitted.evidence.numbers) else None)
    return results
