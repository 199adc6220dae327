# SPDX-License-Identifier: Apache-2.0
"""Expected discrimination of a set of trials between explanations.

Scaled features y of all trials are, under an explanation h with n repeats of condition c,

    y_c = m_ch + S_ch^T a_h + P_c^T b + e_c,     a_h, b ~ N(0, 1),     var(e_c) = s_c^2 / n + l_c^2 / 4 + u d_c^2

with the centre m_h of the explanation, its parameters a_h in standard deviations, the discrepancy d of the simulation
along patterns P that conditions share (a share u of it feature by feature), the scatter s and the relevance limit l.
Columns of a belief (:mod:`impact_rs_analysis.inference.belief`) are P, and of every explanation m_h and S_h; conditions
are its observations. The expected squared (Mahalanobis) distance of two explanations is

    g_ij = (m_i - m_j)^T V_ij^-1 (m_i - m_j),    V_ij = var(e) + P^T P + S_i^T S_i + S_j^T S_j

where at least one is estimated (Box and Hill 1967, *Discrimination among mechanistic models*, whose criterion weighs a
difference of predictions by their variances). Where neither is estimated, it is the squared residual that the best fit
of j leaves of a noticeable change of one parameter k of i (Atkinson and Fedorov 1975, *The design of experiments for
discriminating between two rival models*: T-optimality, the rival is fitted anew),

    g_ijk = S_ik^T V_j^-1 S_ik,    V_j = var(e) + P^T P + w^2 S_j^T S_j

with a range of w scales for the rival's parameters. A pair without estimates has the mean probability
(:func:`impact_rs_analysis.inference.ahead.probability`) over the parameters, in the direction in which this mean is
smaller. The degrees of freedom of the scatter are the sum of n - 1 over conditions. For parameters the gain is their
information, log det(1 + S V^-1 S^T) / 2 (D-optimality; Lindley 1956, *On a measure of the information provided by an
experiment*).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from impact_rs_analysis.design.explanations import Decision
from impact_rs_analysis.design.forecast import ForecastTrial
from impact_rs_analysis.design.possible_trials import PossibleTrial
from impact_rs_analysis.inference.ahead import distance, probability
from impact_rs_analysis.inference.belief import Belief, Observation, fitted_out, observation_of
from impact_rs_sim.robots.robot import Array

RIVAL_RANGE_SCALES = 10.0  # w, range of a fit in parameter scales: the largest that blind campaigns hide
TIE_BREAK_WEIGHT = 1e-3  # of the second term of the utility, which decides where the first is saturated


class Discrimination:
    """Information of sets of trials about a decision.

    Args:
        decision: Explanations to be distinguished.
        trials: Every trial that may be counted.
    """

    def __init__(self, decision: Decision, trials: Sequence[ForecastTrial]) -> None:
        self.decision = decision
        self._trials = {trial.name: trial for trial in trials}
        ends = np.cumsum([0, *(1 + len(explanation.varied) for explanation in decision.explanations)])
        self._centres = ends[:-1]
        self._spreads = [np.arange(start + 1, end) for start, end in zip(ends[:-1], ends[1:], strict=True)]
        self._observations: dict[tuple[str, int], Observation] = {}

    @cached_property
    def measured(self) -> dict[str, int]:
        """Repeats by condition before the plan."""
        return {name: trial.repeats for name, trial in self._trials.items() if trial.repeats}

    def trial(self, name: str) -> PossibleTrial | None:
        """How a condition is run; None: it cannot be planned."""
        return self._trials[name].trial

    @cached_property
    def counted(self) -> dict[str, int]:
        """Repeats before the plan whose information no estimate contains yet; all of them if nothing is estimated."""
        return self.measured if self.decision.aim == "effects" else {}

    def with_more(self, picked: Mapping[str, int]) -> dict[str, int]:
        """Counted repeats by condition with further ones."""
        return {name: self.counted.get(name, 0) + picked.get(name, 0) for name in {**self.counted, **picked}}

    def freedom(self, picked: Mapping[str, int]) -> float:
        """Degrees of freedom of the scatter, from the repeats of all trials before the plan and further ones."""
        names = {**self.measured, **picked}
        return float(sum(max(self.measured.get(name, 0) + picked.get(name, 0) - 1, 0) for name in names))

    def total(self, counts: Mapping[str, int]) -> Belief:
        """Information of conditions with given repeats about centres and parameters."""
        count = sum(1 + len(rows) for rows in self._spreads)
        belief = Belief.of(range(count), np.full(count, np.inf))
        for name in sorted(counts):  # so that a sum does not depend on the order of the choice
            if counts[name]:
                belief.add(self._observation(name, counts[name]))
        return belief

    def added(self, total: Belief, name: str, before: int, after: int) -> Belief:
        """The total with ``after`` repeats of a condition in the place of ``before``."""
        belief = total.copy()
        if before:
            belief.add(self._observation(name, before), -1.0)
        if after:
            belief.add(self._observation(name, after))
        return belief

    def gains(self, total: Belief) -> list[list[Array]]:
        """Squared distances of every pair, by direction and case, ``(cases,)`` [-]."""
        inner, _ = total.of_parameters()
        unexplained = [np.diag(fitted_out(inner, rows, RIVAL_RANGE_SCALES)) for rows in self._spreads]
        distances = []
        for i, j in self.decision.pairs:
            first, second = self.decision.explanations[i], self.decision.explanations[j]
            if first.estimated or second.estimated:
                spreads = np.concatenate((self._spreads[i], self._spreads[j]))
                distances.append([np.array([distance(inner, self._centres[i], self._centres[j], spreads)])])
                continue
            directions = [(first, i, j), (second, j, i)]
            distances.append([unexplained[rival][self._spreads[n]] for e, n, rival in directions if e.varied])
        return distances

    def probabilities(self, total: Belief, freedom: float = np.inf) -> Array:
        """Probability that the next diagnosis distinguishes them, for every pair, ``(pairs,)`` [-].

        Args:
            total: Information of the trials.
            freedom: Degrees of freedom of the scatter; infinite: it is known.
        """
        return _means(self.gains(total), lambda cases: probability(cases, freedom))

    def information(self, total: Belief) -> float:
        """Information on the parameters of all explanations, half the log determinant [nat]."""
        rows = np.concatenate(self._spreads)
        inner, _ = total.of_parameters()
        return 0.5 * float(np.linalg.slogdet(np.eye(len(rows)) + inner[np.ix_(rows, rows)])[1])

    def utility(self, total: Belief, freedom: float = np.inf) -> float:
        """Utility that the choice of trials maximises; monotone in the trials.

        For parameters their information. For pairs of explanations the mean probability that the next diagnosis
        distinguishes them, plus ``TIE_BREAK_WEIGHT`` times the mean of log(1 + g), which chooses between trials where
        every pair is decided, or no pair.

        Args:
            total: Information of the trials.
            freedom: Degrees of freedom of the scatter; infinite: it is known.
        """
        if self.decision.aim == "parameters":
            return self.information(total)
        gains = self.gains(total)
        first = _means(gains, lambda cases: probability(cases, freedom))
        second = _means(gains, lambda cases: np.log1p(np.maximum(cases, 0.0)))
        return float(np.mean(first) + TIE_BREAK_WEIGHT * np.mean(second))

    def _observation(self, name: str, repeats: int) -> Observation:
        """One condition with so many repeats."""
        key = name, repeats
        if key not in self._observations:
            trial = self._trials[name]
            rows = [np.vstack((centre, spread)) for centre, spread in zip(trial.centres, trial.spreads, strict=True)]
            unknown = np.zeros(len(trial.cluster.features))
            self._observations[key] = observation_of(trial.cluster, unknown, np.vstack(rows).T, repeats)
        return self._observations[key]


def _means(gains: Sequence[Sequence[Array]], of: Callable[[Array], Array]) -> Array:
    """Mean over the cases for every pair, the smaller of both directions, ``(pairs,)``."""
    if not gains:
        return np.zeros(0)
    all_cases = [cases for directions in gains for cases in directions]
    counts = [cases.size for cases in all_cases]
    starts = np.cumsum([0, *counts[:-1]])
    means = iter((np.add.reduceat(of(np.concatenate(all_cases)), starts) / counts).tolist())
    return np.array([min(next(means) for _ in directions) for directions in gains])
