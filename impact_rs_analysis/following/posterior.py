# SPDX-License-Identifier: Apache-2.0
"""Posterior of what a model believes, updated hit by hit: linear and Gaussian.

The residual of hit i, whitened by the scatter R of the hits, is linear in the state x,

    r_i = H_i x + noise,        cov(noise) = 1,        H_i = [J_i of the parameters followed | patterns of discrepancy]

x holds changes of parameters from the point of the linearisation, in parameter scales, and the amplitudes of the model
discrepancy, standard normal before the first hit and the same for all hits of a group. So a constant misfit of a
condition is learnt, and is no change. With information matrix and vector (Kalman filter in information form; Anderson
and Moore 1979, *Optimal Filtering*, sec. 6.3)

    L = L_0 + sum w_i H_i^T H_i,        h = h_0 + sum w_i H_i^T r_i,        x ~ N(L^-1 h, L^-1)

the order of hits in the window does not matter. A hit that the posterior finds beyond the quantile q of chi square
weighs w = q / d^2 with d its Mahalanobis distance, else 1 (Huber 1964), so that one odd hit moves nothing far.

The last hits are kept one by one (the *window*): a change is looked for among them (:mod:`.change`). Before the window
the misfit of a model may wander, as where joints warm up or a sensor drifts: from one instant of its group to the next
every amplitude is a' = sqrt(1 - q) a + sqrt(q) w with w standard normal and q = ``DRIFT`` (a first-order Gauss-Markov
process whose variance stays 1; Anderson and Moore 1979, sec. 2.3). What goes slowly is then no change of a parameter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_analysis.following.hits import Hit
from impact_rs_sim.robot import Array

WINDOW = 48  # instants; a change older than that is believed
WIDTH = 3.0  # parameter scales; changes that are looked for are about as large
WIDE = 10.0  # parameter scales; prior of a parameter whose change was found, which hits then determine
DRIFT = 0.003  # of the variance of an amplitude, renewed from one instant of its group to the next
ODD = 1e-3  # share of hits beyond the quantile at which they lose weight


@dataclass(frozen=True)
class HitEvidence:
    """What one hit says, whitened.

    Attributes:
        hit: The hit.
        residual: Measured minus predicted at the point of the linearisation, ``(F,)`` [-].
        jacobian: Sensitivity to every parameter, per scale, ``(F, p)`` [-].
        patterns: Discrepancy at amplitude 1, ``(F, k)`` [-].
        weight: See the module [-].
    """

    hit: Hit
    residual: Array
    jacobian: Array
    patterns: Array
    weight: float = 1.0


@dataclass
class _Sums:
    """Contribution of one instant: blocks of the normal equations at some columns of the state."""

    columns: NDArray[np.int_]
    state: Array
    cross: Array
    jacobian: Array
    score_state: Array
    score: Array


@dataclass
class Posterior:
    """State of one hypothesis.

    Attributes:
        followed: Parameters that are part of the state, by number.
        information: L before the window, ``(n, n)``.
        vector: h before the window, ``(n,)``.
        groups: Columns of the discrepancy amplitudes, by group of hits.
        window: Evidence by instant, oldest first.
    """

    followed: tuple[int, ...]
    information: Array
    vector: Array
    groups: dict[str, slice] = field(default_factory=dict)
    window: list[tuple[HitEvidence, ...]] = field(default_factory=list)
    _sums: list[list[_Sums]] = field(default_factory=list)
    _total: tuple[Array, Array] | None = None

    @classmethod
    def of(cls, followed: Sequence[int], deviations: Array) -> Posterior:
        """Before any hit.

        Args:
            followed: Parameters that are followed.
            deviations: Standard deviation of each, in parameter scales, ``(f,)``.
        """
        return cls(tuple(followed), np.diag(1.0 / np.square(deviations)), np.zeros(len(followed)))

    @property
    def mean(self) -> Array:
        """Mean of the state, ``(n,)``."""
        return self._solved[1]

    @property
    def factor(self) -> Array:
        """Lower Cholesky factor of L, ``(n, n)``."""
        return self._solved[0]

    @property
    def _solved(self) -> tuple[Array, Array]:
        total = self._total
        if total is None:
            information, vector = self.information.copy(), self.vector.copy()
            for sums in self._sums:
                for one in sums:
                    information[np.ix_(one.columns, one.columns)] += one.state
                    vector[one.columns] += one.score_state
            factor = np.asarray(np.linalg.cholesky(information))
            total = self._total = factor, _solve(factor, vector)
        return total

    def solve(self, columns: Array) -> Array:
        """L^-1 of some columns, ``(n, m)``."""
        return _solve(self.factor, columns)

    def make_room(self, hits: Iterable[tuple[str, int]]) -> None:
        """Add the discrepancy amplitudes of groups that were not seen before.

        Args:
            hits: Group and number of patterns of each hit.
        """
        for group, count in hits:
            if group in self.groups:
                continue
            size = len(self.vector)
            grown = np.eye(size + count)
            grown[:size, :size] = self.information
            self.information, self.vector = grown, np.concatenate((self.vector, np.zeros(count)))
            self.groups[group] = slice(size, size + count)
            self._total = None

    def observation(self, evidence: HitEvidence) -> tuple[NDArray[np.int_], Array]:
        """Columns of the state that a hit depends on, ``(m,)``, and H at them, ``(F, m)``."""
        own = self.groups[evidence.hit.group]
        columns = np.concatenate((np.arange(len(self.followed)), np.arange(own.start, own.stop)))
        return columns, np.hstack((evidence.jacobian[:, list(self.followed)], evidence.patterns))

    def innovation(self, evidence: HitEvidence) -> tuple[Array, Array]:
        """Residual that the state leaves, ``(F,)``, and its covariance, ``(F, F)``, whitened [-]."""
        columns, observed = self.observation(evidence)
        own = np.zeros((len(self.vector), observed.shape[0]))
        own[columns] = observed.T
        covariance = np.eye(observed.shape[0]) + observed @ self.solve(own)[columns]
        return evidence.residual - observed @ self.mean[columns], covariance

    def rest(self, evidence: HitEvidence) -> Array:
        """Residual of a hit that the state leaves, ``(F,)`` [-]."""
        columns, observed = self.observation(evidence)
        return np.asarray(evidence.residual - observed @ self.mean[columns])

    def add(self, instant: Sequence[HitEvidence]) -> None:
        """Take an instant into the window, and believe the oldest of a full one."""
        self.window.append(tuple(instant))
        self._sums.append([self._sums_of(one) for one in instant])
        self._total = None
        while len(self.window) > WINDOW:
            self._believe()

    def believe(self, evidence: Iterable[HitEvidence]) -> None:
        """Take hits that are older than the window."""
        for one in evidence:
            self._take(self._sums_of(one))
        self._total = None

    def _take(self, one: _Sums) -> None:
        self.information[np.ix_(one.columns, one.columns)] += one.state
        self.vector[one.columns] += one.score_state

    def _believe(self) -> None:
        """Move the oldest instant of the window into what is believed."""
        for one in self._sums.pop(0):
            self._take(one)
        for group in sorted({evidence.hit.group for evidence in self.window.pop(0)}):
            self.drift(group)

    def believe_before(self, start: int) -> None:
        """Believe the instants of the window before one of them."""
        for _ in range(start):
            self._believe()
        self._total = None

    def drift(self, group: str) -> None:
        """Let the amplitudes of a group wander by one instant, see the module.

        Args:
            group: Of hits.
        """
        own = self.groups[group]
        unit, kept = np.eye(own.stop - own.start), math.sqrt(1.0 - DRIFT)
        coupling, past = self.information[:, own].copy(), self.vector[own].copy()
        coupling[own] = -kept / DRIFT * unit  # with the amplitudes as they will be
        gone = np.linalg.solve(self.information[own, own] + kept**2 / DRIFT * unit, coupling.T)
        self.information[own], self.information[:, own], self.vector[own] = 0.0, 0.0, 0.0
        self.information[own, own] = unit / DRIFT
        self.information -= coupling @ gone
        self.vector -= gone.T @ past
        self._total = None

    def forget_window(self) -> None:
        """Leave the instants of the window out."""
        self.window.clear()
        self._sums.clear()
        self._total = None

    def _sums_of(self, one: HitEvidence) -> _Sums:
        columns, observed = self.observation(one)
        weighed, residual = one.weight * observed.T, one.residual
        return _Sums(
            columns,
            weighed @ observed,
            weighed @ one.jacobian,
            one.weight * one.jacobian.T @ one.jacobian,
            weighed @ residual,
            one.weight * one.jacobian.T @ residual,
        )

    def suffixes(self, starts: Sequence[int], parameters: Sequence[int]) -> tuple[Array, Array, Array]:
        """Normal equations of changes of parameters that begin at instants of the window.

        Args:
            starts: Instants, by position in the window, falling.
            parameters: Numbers of the parameters.

        Returns:
            Cross information with the state ``(s, n, p)``, information ``(s, p, p)`` and score ``(s, p)``.
        """
        size, count, chosen = len(self.vector), len(parameters), list(parameters)
        cross, own, score = np.zeros((size, count)), np.zeros((count, count)), np.zeros(count)
        found: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
        last = len(self.window)
        for start in starts:
            for place in range(last - 1, start - 1, -1):
                for one in self._sums[place]:
                    cross[one.columns] += one.cross[:, chosen]
                    own += one.jacobian[np.ix_(chosen, chosen)]
                    score += one.score[chosen]
            last = start
            for kept, now in zip(found, (cross, own, score), strict=True):
                kept.append(now.copy())
        return np.array(found[0]), np.array(found[1]), np.array(found[2])

    def copy(self) -> Posterior:
        """A copy that can be changed."""
        return replace(
            self,
            information=self.information.copy(),
            vector=self.vector.copy(),
            groups=dict(self.groups),
            window=list(self.window),
            _sums=list(self._sums),
            _total=None,
        )

    def covariance_of_followed(self) -> Array:
        """Covariance of the parameters followed, in parameter scales, ``(f, f)``."""
        count = len(self.followed)
        return self.solve(np.eye(len(self.vector), count))[:count]

    def refollowed(self, followed: Sequence[int], fresh: Sequence[int], shift: Array) -> Posterior:
        """What is believed, with other parameters followed and an empty window.

        Args:
            followed: Parameters that are followed from now on, the present ones among them.
            fresh: Those of them that may be anything now: what was known of them is forgotten.
            shift: Centre of the prior of the fresh ones from the point of the linearisation, in scales, ``(fresh,)``.
        """
        old, kept = len(self.followed), [n for n, one in enumerate(self.followed) if one not in fresh]
        forgotten = [n for n, one in enumerate(self.followed) if one in fresh]
        stay = np.array([*kept, *range(old, len(self.vector))], dtype=int)
        information, vector = self.information, self.vector
        if forgotten:
            coupling = information[stay][:, forgotten]
            gone = np.linalg.solve(information[forgotten][:, forgotten], coupling.T)
            vector = vector[stay] - gone.T @ vector[forgotten]
            information = information[stay][:, stay] - coupling @ gone
            information = 0.5 * (information + information.T)
        names = [self.followed[n] for n in kept]
        order = [*names, *fresh]
        size, new = len(vector), len(fresh)
        grown, moved = np.zeros((size + new, size + new)), np.zeros(size + new)
        place = np.array([*range(len(names)), *range(len(order), size + new)], dtype=int)
        grown[np.ix_(place, place)], moved[place] = information, vector
        for number, centre in zip(range(len(names), len(order)), shift, strict=True):
            grown[number, number] = 1.0 / WIDE**2
            moved[number] = centre / WIDE**2
        where = [order.index(one) for one in followed]
        rest = list(range(len(order), size + new))
        index = np.array([*where, *rest], dtype=int)
        offset = len(order) - old
        groups = {name: slice(own.start + offset, own.stop + offset) for name, own in self.groups.items()}
        return Posterior(tuple(followed), grown[np.ix_(index, index)], moved[index], groups)


def _solve(factor: Array, right: Array) -> Array:
    """L^-1 of columns by its Cholesky factor."""
    if not right.shape[0]:
        return right
    return np.asarray(scipy.linalg.cho_solve((factor, True), right, check_finite=False))


def squared_distance(innovation: Array, covariance: Array, inflation: float = 1.0) -> float:
    """Squared Mahalanobis distance of a hit [-].

    Args:
        innovation: Whitened, ``(F,)``.
        covariance: Its covariance, ``(F, F)``.
        inflation: Variance of hits over that of the covariance.
    """
    return float(innovation @ np.linalg.solve(covariance, innovation)) / inflation


def weight_of(distance: float, size: int) -> float:
    """Weight of a hit with a squared distance and so many features [-]."""
    return min(1.0, float(scipy.special.chdtri(size, ODD)) / max(distance, 1e-300))


def log_density(distance: float, covariance: Array, freedom: float) -> float:
    """Logarithm of the density of a hit, up to a constant: Student's t, for its scale is estimated.

    Args:
        distance: Squared distance of the hit.
        covariance: Its covariance, ``(F, F)``.
        freedom: Degrees of freedom of the scatter.
    """
    _, determinant = np.linalg.slogdet(covariance)
    return -0.5 * float(determinant) - 0.5 * (freedom + len(covariance)) * math.log1p(distance / freedom)


def unpredicted_log_density(size: int, freedom: float) -> float:
    """:func:`log_density` of a hit that a hypothesis does not predict at all: that of a certain prediction, just odd.

    Args:
        size: Number of features of the hit.
        freedom: Degrees of freedom of the scatter.
    """
    return log_density(float(scipy.special.chdtri(size, ODD)), np.eye(size), freedom)
