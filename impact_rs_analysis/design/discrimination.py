# SPDX-License-Identifier: Apache-2.0
"""Expected discrimination of a set of trials between explanations.

Scaled features y of all trials are, under an explanation h with n repeats of condition c,

    y_c = m_ch + S_ch^T a_h + P_c^T b + e_c,     a_h, b ~ N(0, 1),     var(e_c) = s_c^2 / n + l_c^2 / 4 + u d_c^2

with the centre m_h of the explanation, its parameters a_h in standard deviations, the discrepancy d of the simulation
along patterns P that conditions share (a share u of it feature by feature), the scatter s and the relevance limit l.
The expected squared distance of two explanations, in units of what blurs it, is

    g_ij = (m_i - m_j)^T V_ij^-1 (m_i - m_j),    V_ij = var(e) + P^T P + S_i^T S_i + S_j^T S_j

where one is estimated (Box and Hill 1967, *Discrimination among mechanistic models*, whose criterion weighs a
difference of predictions by their variances), and, where neither is, what the best fit of j leaves of a noticeable
change of one parameter k of i (Atkinson and Fedorov 1975, *The design of experiments for discriminating between two
rival models*: T-optimality, the rival fitted anew),

    g_ijk = S_ik^T V_j^-1 S_ik,    V_j = var(e) + P^T P + w^2 S_j^T S_j

with a range of w scales for the rival's parameters. The log likelihood ratio of two normal distributions a distance
sqrt(g) apart is normal with mean +-g/2 and variance g, so with equal odds and a known scatter the likelier explanation
is the right one with probability Phi(sqrt(g) / 2). A diagnosis estimates the scatter from repeats, n - 1 of each
condition. In the mean over what so few may say of it this is Student's distribution (1908),

    p = T_f(sqrt(g) / 2),    f = sum over conditions of (n_c - 1)

and of a pair without estimates in the mean over the parameters, in the direction in which that is less. For parameters
the gain is their information, log det(1 + S V^-1 S^T) / 2 (D-optimality; Lindley 1956, *On a measure of the information
provided by an experiment*). All follow from one matrix of inner products, a sum over conditions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
import scipy

from impact_rs_analysis.design.explanations import Decision
from impact_rs_analysis.design.forecast import ForecastTrial
from impact_rs_analysis.design.possible_trials import PossibleTrial
from impact_rs_analysis.evidence.cluster import Cluster
from impact_rs_sim.robot import Array

ALONE = 1.0 / 3.0  # share u of the discrepancy that measured patterns do not span, as in the null distribution
WIDE = 10.0  # scales w, as far as a fit may go: the largest that blind campaigns hide
LEAST_VARIANCE = 1e-6  # scaled; a feature without scatter and limit does not count without end
TIES = 1e-3  # weight of the second term of the utility, which chooses where the first one is decided


class Discrimination:
    """Information of sets of trials about a decision.

    Args:
        decision: What shall be distinguished.
        trials: Every trial that may be counted.
    """

    def __init__(self, decision: Decision, trials: Sequence[ForecastTrial]) -> None:
        self.decision = decision
        self._trials = {trial.name: trial for trial in trials}
        groups: dict[str, int] = {}
        for trial in trials:
            groups[_group(trial.cluster)] = len(_patterns(trial.cluster))
        ends = np.cumsum([0, *groups.values()])
        self._groups = {name: slice(ends[n], ends[n + 1]) for n, name in enumerate(groups)}
        self._patterns = int(ends[-1])
        self._centres = [self._patterns + n for n in range(len(decision.explanations))]
        edges = (
            self._patterns + len(self._centres) + np.cumsum([0, *(len(one.varied) for one in decision.explanations)])
        )
        self._spreads = [np.arange(edges[n], edges[n + 1]) for n in range(len(decision.explanations))]
        self._size = int(edges[-1])
        self._products: dict[tuple[str, int], Array] = {}

    @cached_property
    def measured(self) -> dict[str, int]:
        """Repeats by condition before the plan."""
        return {name: trial.repeats for name, trial in self._trials.items() if trial.repeats}

    def trial(self, name: str) -> PossibleTrial | None:
        """How a condition is run; None: it cannot be planned."""
        return self._trials[name].trial

    @cached_property
    def counted(self) -> dict[str, int]:
        """Repeats before the plan whose information is not yet in estimates; all where there are none."""
        return self.measured if self.decision.aim == "effects" else {}

    def with_more(self, picked: Mapping[str, int]) -> dict[str, int]:
        """Counted repeats by condition with further ones."""
        return {name: self.counted.get(name, 0) + picked.get(name, 0) for name in {**self.counted, **picked}}

    def freedom(self, picked: Mapping[str, int]) -> float:
        """Degrees of freedom of the scatter, from the repeats of all trials before the plan and further ones."""
        names = {**self.measured, **picked}
        return float(sum(max(self.measured.get(name, 0) + picked.get(name, 0) - 1, 0) for name in names))

    def total(self, counts: Mapping[str, int]) -> Array:
        """Inner products summed over conditions with so many repeats."""
        found = np.zeros((self._size, self._size))
        for name in sorted(counts):  # so that a sum does not depend on the order of the choice
            if counts[name]:
                self._add(found, name, counts[name], 1.0)
        return found

    def added(self, total: Array, name: str, before: int, after: int) -> Array:
        """The total with ``after`` repeats of a condition in the place of ``before``."""
        found = total.copy()
        if before:
            self._add(found, name, before, -1.0)
        if after:
            self._add(found, name, after, 1.0)
        return found

    def gains(self, total: Array) -> list[list[Array]]:
        """Squared distances of every pair: for each direction those of all cases, ``(cases,)`` [-]."""
        if not self.decision.pairs:
            return []
        inner = self._without_patterns(total)
        offset = self._patterns
        left = [np.diag(_fitted(inner, rows - offset, WIDE)) for rows in self._spreads]
        found = []
        for i, j in self.decision.pairs:
            first, second = self.decision.explanations[i], self.decision.explanations[j]
            if first.estimated or second.estimated:
                own = np.concatenate((self._spreads[i], self._spreads[j])) - offset
                way = np.zeros(len(inner))
                way[self._centres[i] - offset], way[self._centres[j] - offset] = 1.0, -1.0
                found.append([np.array([way @ _fitted(inner, own) @ way])])
                continue
            directions = [(first, i, j), (second, j, i)]
            found.append([left[other][self._spreads[own] - offset] for one, own, other in directions if one.varied])
        return found

    def probabilities(self, total: Array, freedom: float = np.inf) -> Array:
        """Probability of the right decision for every pair, ``(pairs,)`` [-].

        Args:
            total: Inner products.
            freedom: Degrees of freedom of the scatter; infinite: it is known.
        """
        gains = self.gains(total)
        return np.array([min(float(probability(cases, freedom).mean()) for cases in ways) for ways in gains])

    def information(self, total: Array) -> float:
        """Information on the parameters of all explanations, half the log determinant [nat]."""
        rows = np.concatenate(self._spreads) - self._patterns
        inner = self._without_patterns(total)[np.ix_(rows, rows)]
        return 0.5 * float(np.linalg.slogdet(np.eye(len(rows)) + inner)[1])

    def utility(self, total: Array, freedom: float = np.inf) -> float:
        """What the choice of trials maximises: it never falls with a further trial.

        The mean probability of the right decision over the pairs, and to a small part the mean of log(1 + g), which
        chooses between trials where everything is decided; for parameters their information.

        Args:
            total: Inner products.
            freedom: Degrees of freedom of the scatter; infinite: it is known.
        """
        if self.decision.aim == "parameters":
            return self.information(total)
        first, second = [], []
        for ways in self.gains(total):
            first.append(min(float(probability(cases, freedom).mean()) for cases in ways))
            second.append(min(float(np.log1p(np.maximum(cases, 0.0)).mean()) for cases in ways))
        return float(np.mean(first) + TIES * np.mean(second))

    def _without_patterns(self, total: Array) -> Array:
        """Inner products of what the patterns of discrepancy, at unknown amplitudes, do not explain."""
        count = self._patterns
        if not count:
            return total
        seen = np.flatnonzero(np.diag(total)[:count] > 0.0)
        across = total[seen, count:]
        inside = np.eye(seen.size) + total[np.ix_(seen, seen)]
        return np.asarray(total[count:, count:] - across.T @ np.linalg.solve(inside, across))

    def _add(self, total: Array, name: str, repeats: int, sign: float) -> None:
        trial = self._trials[name]
        columns = np.concatenate(
            (np.arange(self._patterns)[self._groups[_group(trial.cluster)]], np.arange(self._patterns, self._size))
        )
        total[np.ix_(columns, columns)] += sign * self._product(trial, repeats)

    def _product(self, trial: ForecastTrial, repeats: int) -> Array:
        """Inner products of the columns of one condition."""
        key = trial.name, repeats
        if key not in self._products:
            item = trial.cluster
            spread = [rows for rows in trial.spreads if len(rows)]
            rows = np.vstack([_patterns(item), trial.centres, *spread])
            self._products[key] = (rows / variance(item, repeats)) @ rows.T
        return self._products[key]


def variance(item: Cluster, repeats: int) -> Array:
    """Variance of the mean of scaled features that no pattern explains, ``(F,)`` [-]."""
    scatter, systematic = np.square(item.pure), np.square(item.discrepancy)
    limit = np.maximum(1.0 - scatter - systematic, 0.0)  # sigma^2 = s^2 + (l / 2)^2 + d^2
    alone = 1.0 if item.patterns is None else ALONE
    return np.maximum(scatter / repeats + limit + alone * systematic, LEAST_VARIANCE)


def probability(gain: Array, freedom: float = np.inf) -> Array:
    """Probability that the likelier of two explanations is the right one [-].

    Args:
        gain: Their squared distance [-].
        freedom: Degrees of freedom of the scatter; infinite: it is known; none: a single repeat says nothing of it.
    """
    half = np.sqrt(np.maximum(gain, 0.0)) / 2.0
    if np.isinf(freedom):
        return np.asarray(scipy.special.ndtr(half))
    return np.asarray(scipy.special.stdtr(freedom, half)) if freedom > 0.0 else np.full_like(half, 0.5)


def _patterns(item: Cluster) -> Array:
    """Patterns of discrepancy that conditions share, ``(k, F)`` [-]."""
    if item.patterns is None:
        return np.zeros((0, len(item.features)))
    return np.sqrt(1.0 - ALONE) * item.patterns


def _group(item: Cluster) -> str:
    """Conditions with the same group share the amplitudes of their patterns."""
    return item.layout if item.alike is None else item.alike


def _fitted(inner: Array, rows: Array, width: float = 1.0) -> Array:
    """Inner products of what a fit of some columns, with a normal prior of this width, leaves."""
    if not rows.size:
        return inner
    across = inner[rows]
    prior = np.eye(rows.size) / width**2
    return np.asarray(inner - across.T @ np.linalg.solve(prior + inner[np.ix_(rows, rows)], across))
