# SPDX-License-Identifier: Apache-2.0
"""Change-point detection: a Shiryaev-Roberts test over effects and moments of change.

Under the hypothesis (e, s) the parameters of effect e moved by eta at instant s, and stayed. With the normal equations
of the posterior (:mod:`.posterior`), which holds all hits, and sums over the hits from s on

    S = sum J^T (r - H m) = b - A^T m,        I = B - A^T L^-1 A

are score and information of eta with all other uncertain parts of the state (other parameters, discrepancy) fitted: the
generalised likelihood ratio of Willsky and Jones (1976) for a linear system. With the prior eta ~ N(0, W^2), W =
``CHANGE_PRIOR_SCALES`` parameter scales, the mean of the likelihood ratio LR
(:mod:`impact_rs_analysis.inference.student`) is 1 where nothing changed. So the sum over moments of change, averaged
over effects,

    R = mean_e sum_s LR(e, s)

is a Shiryaev-Roberts statistic: R - (number of instants) is a martingale, and the mean number of instants to a false
alarm at R >= A is at least A (Pollak 1985; 1987). It needs no table of thresholds, reacts within the delay of Page's
CUSUM (1954) to first order (Lorden 1971), and favours no effect for its number of parameters.

The variance of each effect's score is calibrated on quiet hits: an excess variance deflates the score
(:class:`Calibration`). A change needs two instants, the later confirming the earlier; a single outlier is not a change.
If a share p of the quiet hits are outliers, tails are heavier than R assumes: k outliers in a row have the probability
p^k, and a change needs so many hits that p^k <= 1 / A.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from impact_rs_analysis.diagnosis.search.candidate import Candidate, bounded
from impact_rs_analysis.following.posterior import CHANGE_PRIOR_SCALES, ODD_HIT_PROBABILITY, HitEvidence, Posterior
from impact_rs_analysis.inference.student import DECISIVE_LIKELIHOOD_RATIO, log_ratios, squares
from impact_rs_sim.robots.robot import Array

MEAN_TIME_TO_FALSE_ALARM = 10_000.0  # instants, at least, under the stated noise
TRIED_INSTANTS_SINCE_CHANGE = (1, 2, 3, 4, 5, 6, 8, 11, 15, 21, 29, 40)  # instants since a change that are tried
ODD_SHARE_PRIOR_HITS = 20  # prior weight of the expected share of odd hits, in hits
MAX_ODD_SHARE = 0.2  # of hits; with more a change would need seven hits or more
LEFT_OUT_SHARE = 0.25  # of the hits since a change, those that support it most; the other hits must support it as well


@dataclass(frozen=True)
class ChangeExplanation:
    """One effect as the cause of a change.

    Attributes:
        effect: Name.
        start: Instant of the window from which on it acts.
        change: eta, in parameter scales, ``(p_e,)``.
        log_ratio: Logarithm of its likelihood ratio against no change.
        gain: Predicted fall of the sum of squared whitened residuals of the hits since then, to first order.
        determinant: log det(1 + D I D).
    """

    effect: str
    start: int
    change: Array
    log_ratio: float
    gain: float = 0.0
    determinant: float = 0.0


@dataclass
class Calibration:
    """Variance inflation of every effect's score, and of whole hits, estimated from quiet hits.

    Attributes:
        squares: Sum of T_0 of single hits, by effect.
        ranks: Sum of their expected values.
        whole: Sum of squared Mahalanobis distances, and of their expected values.
        freedom: Degrees of freedom of the scatter.
        odd: Number of quiet hits that were odd.
        hits: Number of quiet hits.
    """

    squares: dict[str, float] = field(default_factory=dict)
    ranks: dict[str, float] = field(default_factory=dict)
    whole: tuple[float, float] = (0.0, 0.0)
    freedom: float = 1.0
    odd: int = 0
    hits: int = 0

    def least_hits(self, mean_time: float, since: Sequence[HitEvidence]) -> int:
        """Number of hits that a change needs, at least two.

        Args:
            mean_time: Mean number of hits to a false alarm, at least.
            since: Hits since the change, which are not quiet.
        """
        odd = max(self.odd - sum(hit_evidence.weight < 1.0 for hit_evidence in since), 0)
        share = (odd + ODD_SHARE_PRIOR_HITS * ODD_HIT_PROBABILITY) / (
            max(self.hits - len(since), 0) + ODD_SHARE_PRIOR_HITS
        )
        return max(2, math.ceil(math.log(max(mean_time, 1.0)) / -math.log(min(share, MAX_ODD_SHARE))))

    def add(self, effect: str, square: float, rank: float) -> None:
        """Take the score of a quiet hit into account."""
        self.squares[effect] = self.squares.get(effect, 0.0) + square
        self.ranks[effect] = self.ranks.get(effect, 0.0) + rank

    def of(self, effect: str) -> float:
        """Factor of the variance of an effect's score, at least 1 [-]."""
        ranks = self.ranks.get(effect, 0.0)
        return 1.0 if ranks <= 0.0 else max(1.0, self.squares[effect] / ranks)

    @property
    def of_hits(self) -> float:
        """Factor of the variance of whole hits, at least 1 [-]."""
        square, expected = self.whole
        return 1.0 if expected <= 0.0 else max(1.0, square / expected)


class ChangeTest:
    """The test of one hypothesis.

    Args:
        posterior: Its hits.
        candidate: Effects with their parameters, at the point about which it is linearised.
        active: Parameters that some hit depends on, by number.
        calibration: Calibration of the scores.
        mean_time: Mean number of instants to a false alarm, at least.
    """

    def __init__(
        self, posterior: Posterior, candidate: Candidate, active: Sequence[int], calibration: Calibration,
        mean_time: float = MEAN_TIME_TO_FALSE_ALARM,
    ) -> None:  # fmt: skip
        self.posterior, self.candidate, self.active = posterior, candidate, tuple(active)
        self.calibration, self.mean_time = calibration, mean_time
        index_of = {number: index for index, number in enumerate(self.active)}
        self.effects = {
            effect.name: indices
            for effect, part in candidate.parts
            if (indices := [index_of[n] for n in range(part.start, part.stop) if n in index_of])
        }

    @property
    def threshold(self) -> float:
        """Threshold of log R."""
        return math.log(self.mean_time)

    def statistics(self) -> tuple[float, dict[str, Array]]:
        """Logarithm of R, and of LR by effect and moment of change, ``(s,)``."""
        count = len(self.posterior.window)
        information, score = self._reduced([count - age for age in TRIED_INSTANTS_SINCE_CHANGE if age <= count])
        ratios = {
            name: self._log_ratios(information[:, indices][:, :, indices], score[:, indices], name)
            for name, indices in self.effects.items()
        }
        all_ratios = np.array(list(ratios.values()))
        if not all_ratios.size:
            return -math.inf, ratios
        return float(scipy.special.logsumexp(all_ratios)) - math.log(len(ratios)), ratios

    def explanations(self, statistics: dict[str, Array]) -> list[ChangeExplanation]:
        """Explanations of a change that the last instant confirms and the hits support, by falling likelihood.

        They use the present linearisation: a nonlinear one may turn out likelier, or fail.

        Args:
            statistics: Result of :meth:`statistics`.
        """
        least = math.log(DECISIVE_LIKELIHOOD_RATIO)
        possible = (self._explained(name) for name, ratios in statistics.items() if float(np.max(ratios)) > least)
        likely = [e for e in possible if e is not None and e.log_ratio > least]
        gains = [self._gains(explanation) for explanation in likely]
        supported = [replace(e, gain=sum(g)) for e, g in zip(likely, gains, strict=True) if support(g) > 0.0]
        return sorted(filter(self._enough, supported), key=lambda explanation: -explanation.log_ratio)

    def _enough(self, explanation: ChangeExplanation) -> bool:
        """Whether there are enough hits since a change."""
        since = self.posterior.since(explanation.start)
        return len(since) >= self.calibration.least_hits(self.mean_time, since)

    def _gains(self, explanation: ChangeExplanation) -> list[float]:
        """Fall of the sum of squared whitened residuals of every hit since a change, to first order."""
        numbers, now = [self.active[index] for index in self.effects[explanation.effect]], self.posterior.now
        cross, _, _ = self.posterior.suffixes([explanation.start], numbers)
        moved = now.solve(cross[0] @ explanation.change)  # the state is fitted anew
        gains = []
        for evidence in self.posterior.since(explanation.start):
            columns, observed = now.observed(evidence)
            first = now.residual_of(evidence)
            second = first + observed @ moved[columns] - evidence.jacobian[:, numbers] @ explanation.change
            gains.append(evidence.weight * float(first @ first - second @ second))
        return gains

    def quiet(self) -> dict[str, tuple[float, float]]:
        """T_0 of the last instant alone, and its expected value, by effect."""
        information, score = self._reduced([len(self.posterior.window) - 1])
        scores = {}
        for name, indices in self.effects.items():
            before, _, _, rank = squares(information[:, indices][:, :, indices], score[:, indices])
            scores[name] = float(before[0]), float(rank[0])
        return scores

    def _reduced(self, starts: Sequence[int]) -> tuple[Array, Array]:
        """I ``(s, p, p)`` and S ``(s, p)`` of all active parameters."""
        now = self.posterior.now
        cross, information_of_changes, score = self.posterior.suffixes(starts, self.active)
        count, size, many = cross.shape
        solved = now.solve(np.swapaxes(cross, 0, 1).reshape(size, count * many)).reshape(size, count, many)
        information = information_of_changes - np.einsum("snp,nsq->spq", cross, solved, optimize=True)
        return information, score - np.einsum("snp,n->sp", cross, now.mean)

    def _log_ratios(self, information: Array, score: Array, name: str) -> Array:
        """Log LR of one effect by moment of change, ``(s,)``, deflated by the calibration."""
        inflation = self.calibration.of(name)
        return log_ratios(information / inflation, score / inflation, CHANGE_PRIOR_SCALES, self.calibration.freedom)

    def _explained(self, name: str) -> ChangeExplanation | None:
        """An effect within its range from its likeliest moment on; None where the last instant speaks against it."""
        last = len(self.posterior.window) - 1
        indices, inflation = self.effects[name], self.calibration.of(name)
        numbers = [self.active[index] for index in indices]
        lower, upper = self._room(numbers)
        prior = inflation * np.eye(len(indices)) / CHANGE_PRIOR_SCALES**2
        starts = list(range(last, -1, -1))
        information, score = self._reduced(starts)
        information, score = information[:, indices][:, :, indices], score[:, indices]
        best: ChangeExplanation | None = None
        ratios = self._log_ratios(information, score, name)
        for case in np.argsort(-ratios).tolist():
            start, unbounded = starts[case], float(ratios[case])
            if best is not None and unbounded <= best.log_ratio:
                break  # bounds only lower it
            if start == last:
                continue
            total = _positive(information[case]) + prior
            eta = bounded(total, score[case], lower, upper)
            gain = float(score[case] @ eta - 0.5 * eta @ total @ eta) / inflation
            free = float(score[case] @ np.linalg.solve(total, score[case])) / (2.0 * inflation)
            # An active bound lowers the gain; the log ratio falls in proportion.
            ratio = unbounded if free <= 0.0 else unbounded - (free - gain) * min(1.0, max(unbounded, 1.0) / free)
            if best is None or ratio > best.log_ratio:
                earlier = _positive(information[case] - information[0]) + prior
                early = bounded(earlier, score[case] - score[0], lower, upper)
                confirmed = float(score[0] @ early - 0.5 * early @ information[0] @ early) > 0.0
                if confirmed:
                    _, determinant = np.linalg.slogdet(CHANGE_PRIOR_SCALES**2 / inflation * total)
                    best = ChangeExplanation(name, start, eta, ratio, determinant=float(determinant))
        return best

    def _room(self, numbers: Sequence[int]) -> tuple[Array, Array]:
        """Least and largest change of some parameters within their ranges, in scales, ``(p,)`` each."""
        candidate = self.candidate
        now = dict(zip(self.posterior.followed, self.posterior.now.mean.tolist(), strict=False))
        values = np.array([candidate.point[n] + candidate.scale[n] * now.get(n, 0.0) for n in numbers])
        scale = candidate.scale[list(numbers)]
        lower = np.minimum((candidate.lower[list(numbers)] - values) / scale, -1e-9)
        return lower, np.maximum((candidate.upper[list(numbers)] - values) / scale, 1e-9)


def support(gains: Sequence[float]) -> float:
    """Trimmed sum of gains: support of an explanation without the quarter of the hits that supports it most.

    Args:
        gains: Fall of the sum of squared whitened residuals of each hit.
    """
    most = math.ceil(len(gains) * LEFT_OUT_SHARE)
    return float(sum(sorted(gains)[:-most]))


def _positive(matrix: Array) -> Array:
    """Nearest positive semidefinite matrix; a difference of informations may be indefinite."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
