# SPDX-License-Identifier: Apache-2.0
"""Posterior of one hypothesis: a belief (:mod:`impact_rs_analysis.inference.belief`) that learns hit by hit.

The last hits are kept individually (the *window*): change points are sought among them (:mod:`.change`). The order of
hits in the window does not matter. A hit that the posterior finds beyond the quantile q of chi square weighs w = q /
d^2 with d its Mahalanobis distance, else 1 (Huber 1964), so that an outlier has a bounded influence.

Before the window the model discrepancy is a Gauss-Markov process (joints that warm up, a drifting sensor): from one
instant of its group to the next, the share ``DISCREPANCY_RENEWAL`` of the variance of every amplitude is renewed. A
slow drift is therefore not announced as a change of a parameter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from impact_rs_analysis.following.hits import Hit
from impact_rs_analysis.inference.belief import Belief, Observation
from impact_rs_analysis.inference.student import log_density
from impact_rs_sim.robots.robot import Array

WINDOW_INSTANTS = 48  # an older change is accepted
CHANGE_PRIOR_SCALES = 3.0  # prior standard deviation of a tested change, in parameter scales
# Prior standard deviation after a change was found, in parameter scales; hits then determine it
FOUND_CHANGE_PRIOR_SCALES = 10.0
# Share of an amplitude's variance that is renewed from one instant of its group to the next
DISCREPANCY_RENEWAL = 0.003
ODD_HIT_PROBABILITY = 1e-3  # share of hits beyond the quantile at which Huber weights set in


@dataclass(frozen=True, eq=False)
class HitEvidence(Observation):
    """Evidence of one hit: linearised observation.

    Attributes:
        hit: The hit.
    """

    hit: Hit = field(kw_only=True)


@dataclass
class Posterior:
    """State of one hypothesis.

    Attributes:
        before: Belief from the hits before the window.
        window: Evidence by instant, oldest first.
    """

    before: Belief
    window: list[tuple[HitEvidence, ...]] = field(default_factory=list)
    _now: Belief | None = None

    @property
    def now(self) -> Belief:
        """Belief from all hits; read-only."""
        if self._now is None:
            self._now = self.before.copy()
            for evidence in self.since():
                self._now.add(evidence)
        return self._now

    @property
    def followed(self) -> tuple[int, ...]:
        """Parameters that are part of the state, by number."""
        return self.before.parameters

    @property
    def hits(self) -> list[list[Hit]]:
        """Hits of the window by instant."""
        return [[evidence.hit for evidence in instant] for instant in self.window]

    def since(self, start: int = 0) -> list[HitEvidence]:
        """Evidence of the window from an instant on."""
        return [evidence for instant in self.window[start:] for evidence in instant]

    def add(self, instant: Sequence[HitEvidence]) -> None:
        """Add an instant to the window; the oldest of a full window is absorbed into the belief."""
        for evidence in instant:
            self.before.columns(evidence)
        self.window.append(tuple(instant))
        self.absorb_before(len(self.window) - WINDOW_INSTANTS)
        self._now = None

    def absorb(self, evidence: Iterable[HitEvidence]) -> None:
        """Absorb hits older than the window."""
        for hit_evidence in evidence:
            self.before.add(hit_evidence)
        self._now = None

    def absorb_before(self, start: int) -> None:
        """Absorb the instants of the window before ``start``."""
        for _ in range(start):
            instant = self.window.pop(0)
            self.absorb(instant)
            for group in sorted({evidence.group for evidence in instant}):
                self.before.drift(group, DISCREPANCY_RENEWAL)

    def copy(self) -> Posterior:
        """A copy that can be changed."""
        return Posterior(self.before.copy(), list(self.window))

    def suffixes(self, starts: Sequence[int], parameters: Sequence[int]) -> tuple[Array, Array, Array]:
        """Normal equations of changes of parameters that begin at instants of the window.

        Args:
            starts: Instants, by position in the window, falling.
            parameters: Numbers of the parameters.

        Returns:
            Cross information with the state ``(s, n, p)``, information ``(s, p, p)`` and score ``(s, p)``.
        """
        now, chosen = self.now, np.array(parameters, dtype=int)
        size, count = len(now.vector), len(chosen)
        # rows: the state, the changes; columns: the changes
        partial_sums, total, score = [], np.zeros((size + count, count)), np.zeros(count)
        last = len(self.window)
        for start in starts:
            for evidence in (evidence for instant in self.window[start:last] for evidence in instant):
                columns, normal_columns = now.columns(evidence)
                total[columns] += evidence.normal[normal_columns[:, None], chosen]
                total[size:] += evidence.normal[chosen[:, None], chosen]
                score += evidence.normal[chosen, -1]
            last = start
            partial_sums.append((total.copy(), score.copy()))
        sums = np.array([block for block, _ in partial_sums])
        return sums[:, :size], sums[:, size:], np.array([partial_score for _, partial_score in partial_sums])


def huber_weight(distance: float, size: int) -> float:
    """Huber weight of a hit from its squared Mahalanobis distance and number of features [-]."""
    return min(1.0, float(scipy.special.chdtri(size, ODD_HIT_PROBABILITY)) / max(distance, 1e-300))


def unpredicted_log_density(size: int, freedom: float) -> float:
    """Log density assigned to a hit that a hypothesis cannot predict: at the limit of an odd hit, without covariance.

    Args:
        size: Number of features of the hit.
        freedom: Degrees of freedom of the scatter.
    """
    return log_density(float(scipy.special.chdtri(size, ODD_HIT_PROBABILITY)), 0.0, size, freedom)
