# SPDX-License-Identifier: Apache-2.0
"""95 % intervals of parameters by profile likelihood, corrected by simulation.

Where features are nonlinear (a box tips, a contact slips), the sensitivities at the estimate do not hold at the end of
an interval. An end starts at the half width h of the linear model (:attr:`Fit.half_widths`) and is simulated with the
other parameters moved along the profile of the linear model,

    b(h) = b + h A^-1 e_i / (A^-1)_ii,        Q(b(h)) - Q(b) = h^2 / (A^-1)_ii        (linear model)

It moves out until the sum of squares Q rises at least ``MIN_RISE_RATIO`` times as much. Where Q rises much more, the
valley is curved, as for the length of a cable and the position of its end, and the other parameters are fitted again.

The search of one end is a generator, which yields the point that it needs next and receives the features there. The
searches of all ends advance together, with one batch of predictions in each round.
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
MAX_RISE_RATIO = 2.0  # likewise; above, the other parameters are fitted again at the end

Offsets = tuple[Array, ...]  # per cluster, scaled features at a point minus those at the candidate's origin, (F,) each
Simulations = Generator[Array, Offsets | None, float]  # yields points, (p,); None: a cluster cannot be simulated there


def intervals_of(wanted: Sequence[tuple[Fit, Sequence[int]]]) -> list[tuple[Array, Array]]:
    """Lower and upper ends of 95 % intervals in units of the parameters, ``(k,)`` each, for every fit.

    Bounds of physics cut intervals off; the range of a search does not.

    Args:
        wanted: Fits to evidence of one source, each with the indices of k parameters.
    """
    profiles = [(Profile(fitted), list(parameters)) for fitted, parameters in wanted]
    ends = [
        (profile, profile.end(index, side))
        for side in (-1.0, 1.0)
        for profile, parameters in profiles
        for index in parameters
    ]
    found = iter(_results(ends))
    low, high = ([np.array([next(found) for _ in own]) for _, own in profiles] for _ in range(2))
    estimates = [profile.fitted.estimate[own] for profile, own in profiles]
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
        return self.fitted.with_room

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
        least = self._squares((yield fitted.estimate))
        least = least if np.isfinite(least) else 0.0  # there is no reference: the end stays at its linear value
        lower, upper = candidate.lower[index], candidate.upper[index]
        for _ in range(MAX_INTERVAL_DOUBLINGS):
            step = side * reach * inverse[:, index] / inverse[index, index] * candidate.scale
            point = np.clip(fitted.estimate + step, candidate.lower, candidate.upper)
            if not lower < point[index] < upper:  # the end is the bound, however little the squares rise there
                break
            rise = self._squares((yield point)) - least
            if rise > MAX_RISE_RATIO * linear_rise and candidate.curved(index):
                rise = min(rise, (yield from self._refitted(index, point)) - least)
            if rise >= MIN_RISE_RATIO * linear_rise:
                break
            reach *= 2.0
        end = fitted.estimate[index] + side * reach * candidate.scale[index]
        return float(np.clip(end, lower, upper))

    def _refitted(self, index: int, point: Array) -> Simulations:
        """Sum of squares at one parameter value: others fitted by sensitivities at the estimate."""
        wide, evidence = self._candidate, self.fitted.evidence
        held = np.arange(point.size) == index
        lower, upper = np.where(held, point, wide.lower), np.where(held, point, wide.upper)
        candidate, found = replace(wide, lower=lower, upper=upper), np.inf
        for _ in range(MAX_STEPS_OF_TRIALS):
            offsets = yield point
            if offsets is None:
                break
            squares = self._squares(offsets)
            if squares > (1.0 - MIN_RELATIVE_DECREASE) * found:
                return min(squares, found)
            found, point = squares, Fit.of(replace(candidate, point=point, offsets=offsets), evidence).estimate
        return found

    def _squares(self, offsets: Offsets | None) -> float:
        """Sum of squared scaled residuals with all repeats [-]; infinite where they cannot be simulated."""
        if offsets is None:
            return np.inf
        pairs = zip(self.fitted.evidence.clusters, offsets, strict=True)
        rests = [(item.count, item.mean - offset) for item, offset in pairs]
        return sum(count * float(rest @ rest) for count, rest in rests)


def _results(searches: Sequence[tuple[Profile, Simulations]]) -> list[float]:
    """Results of searches, which advance together: one batch of predictions in each round."""
    found = [np.nan] * len(searches)
    points = {number: next(search) for number, (_, search) in enumerate(searches)}
    while points:
        offsets = _offsets([(searches[number][0].fitted, point) for number, point in points.items()])
        following = {}
        for number, own in zip(points, offsets, strict=True):
            try:
                following[number] = searches[number][1].send(own)
            except StopIteration as end:
                found[number] = end.value
        points = following
    return found


def _offsets(wanted: Sequence[tuple[Fit, Array]]) -> list[Offsets | None]:
    """Offsets of every fit at a point, from one batch of predictions; each prediction is made once."""
    pairs = [(fitted, fitted.candidate.origin, fitted.candidate.split(point)) for fitted, point in wanted]
    tasks = dict.fromkeys((n, added) for fit, *ends in pairs for added in ends for n in fit.evidence.numbers)
    predictions = wanted[0][0].evidence.source.predict(list(tasks), ENDS)
    features = dict(zip(tasks, predictions, strict=True))
    found: list[Offsets | None] = []
    for fitted, before, after in pairs:
        offsets = []
        for number, item in zip(fitted.evidence.numbers, fitted.evidence.clusters, strict=True):
            a, b = features[number, before], features[number, after]
            if a is None or b is None:
                break
            offsets.append((b - a) / item.sigma)
        found.append(tuple(offsets) if len(offsets) == len(fitted.evidence.numbers) else None)
    return found
