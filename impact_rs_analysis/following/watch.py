# SPDX-License-Identifier: Apache-2.0
"""Multiple-model estimation: every hypothesis predicts a hit and is updated with it.

The likeliest one is tested for a change. A change replaces the hypotheses by its causes (:mod:`.causes`). Later hits
update their probabilities (Magill 1965), and predictions are their mixture.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from impact_rs_analysis.following.announcement import in_words
from impact_rs_analysis.following.causes import Causes, Explained
from impact_rs_analysis.following.documents import Cause, Change, HitDocument, NextHit, Predicted
from impact_rs_analysis.following.hit_model import HitModel, Hypothesis
from impact_rs_analysis.following.hits import Hit
from impact_rs_analysis.following.posterior import WINDOW_INSTANTS, huber_weight, unpredicted_log_density
from impact_rs_analysis.following.proposals import distinguishing
from impact_rs_analysis.inference.student import log_density, squared_distance
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.since import MIN_WALL_CLOCK_S

RETRY_LOG_GROWTH = 1.0  # of the log statistic since a failed attempt, before the next one
MIN_HYPOTHESIS_PROBABILITY = 1e-3  # less likely hypotheses are dropped
MIN_KNOWN_CAUSE_PROBABILITY = 0.95  # from which the cause is reported as known
UNPREDICTED_REASON = "the model predicts no impact, or no velocities that obey the contact laws"


@dataclass
class HitWatch:
    """Hypotheses about the cell.

    Attributes:
        hit_model: Model that predicts the features of a hit.
        hypotheses: The hypotheses.
        announced: Effects announced as the likeliest cause of a change, in order.
    """

    hit_model: HitModel
    hypotheses: list[Hypothesis]
    announced: list[str] = field(default_factory=list)

    @property
    def likeliest(self) -> Hypothesis:
        """The hypothesis with the largest probability."""
        return max(self.hypotheses, key=lambda hypothesis: hypothesis.log_weight)

    def probabilities(self) -> Array:
        """Probability of every hypothesis, ``(h,)``."""
        return np.asarray(scipy.special.softmax([hypothesis.log_weight for hypothesis in self.hypotheses]))

    def prediction(self, hit: Hit) -> NextHit | None:
        """Features of a hit with this initial state if it makes contact; None: no hypothesis predicts a contact."""
        forecasts = [self.hit_model.predicted(hypothesis, hit) for hypothesis in self.hypotheses]
        shares = self.probabilities()
        contacts = [(share, *forecast) for share, forecast in zip(shares, forecasts, strict=True) if forecast]
        if not contacts:
            return None
        total = sum(share for share, _, _ in contacts)
        mean = sum(share * value for share, value, _ in contacts) / total
        calibration = self.hit_model.calibration
        within = sum(share * calibration.of_hits * variance for share, _, variance in contacts) / total
        between = sum(share * np.square(value - mean) for share, value, _ in contacts) / total
        half = scipy.special.stdtrit(calibration.freedom, 0.975) * np.sqrt(within + between)
        return NextHit(
            condition=hit.condition,
            like=hit.name,
            values=tuple(
                Predicted(
                    signal=feature.signal,
                    index=feature.index,
                    phase=feature.phase,
                    bin=feature.bin,
                    value=float(value),
                    ci95=(float(value - width), float(value + width)),
                    unit=feature.unit,
                )
                for feature, value, width in zip(hit.features, mean, half, strict=True)
            ),
        )

    def take(self, instant: Sequence[Hit], last: Mapping[str, Hit]) -> tuple[dict[str, HitDocument], list[Hit]]:
        """Predict, update and test.

        Args:
            instant: Simultaneous hits.
            last: The last hit of every condition.

        Returns:
            Documents of the hits by name, and the hits since the detected change; empty: no change.
        """
        begun = time.perf_counter()
        errors = self._updated(instant)
        resolved = self._pruned()
        # Without a prediction by the likeliest hypothesis there is nothing to test.
        statistic, change, since = self._tested(instant[-1], last) if errors else (self._statistic(), None, [])
        spent = 1e3 * (time.perf_counter() - begun) / len(instant)
        documents = {}
        for hit in instant:
            (error, of_model, odd), final = errors.get(hit.name, (None, None, False)), hit is instant[-1]
            documents[hit.name] = HitDocument(
                name=hit.name,
                stamp=hit.stamp,
                condition=hit.condition,
                error=error,
                of_model=of_model,
                evidence=statistic / math.log(10.0),
                odd=odd,
                change=change if final else None,
                resolved=resolved if final else "",
                milliseconds=spent,
            )
        return documents, since

    def _updated(self, instant: Sequence[Hit]) -> dict[str, tuple[float, float, bool]]:
        """Update every hypothesis with simultaneous hits.

        Returns:
            By name of a hit: errors of the likeliest hypothesis and of the given model, and whether the hit is an
            outlier.
        """
        errors: dict[str, tuple[float, float, bool]] = {}
        best, hit_model, calibration = self.likeliest, self.hit_model, self.hit_model.calibration
        for hypothesis in self.hypotheses:
            observations = []
            for hit in instant:
                evidence = hit_model.evidence(hit, hypothesis.point)
                if evidence is None:
                    hypothesis.log_weight += unpredicted_log_density(len(hit.features), calibration.freedom)
                    if hypothesis is best:
                        hit_model.hit_source.skipped[hit.name] = UNPREDICTED_REASON
                    continue
                innovation, covariance = hypothesis.posterior.now.predictive(evidence)
                distance = squared_distance(innovation, covariance, calibration.of_hits)
                weight = huber_weight(distance, innovation.size)
                log_determinant = float(np.linalg.slogdet(covariance)[1])
                hypothesis.log_weight += log_density(distance, log_determinant, innovation.size, calibration.freedom)
                observations.append(replace(evidence, weight=weight))
                corrected = innovation - hypothesis.recent.expected(hit.group, innovation.size)
                hypothesis.recent.update(hit.group, innovation, weight)
                if hypothesis is best:
                    rms_error = math.sqrt(float(np.mean(np.square(corrected))))
                    calibration.hits += 1
                    calibration.odd += weight < 1.0
                    errors[hit.name] = rms_error, hit_model.error_at_start(evidence, hypothesis.point), weight < 1.0
            if observations:
                hypothesis.posterior.add(observations)
            if len(hypothesis.posterior.window) == WINDOW_INSTANTS:  # the last change is too old to be revised
                hypothesis.origin = None
        return errors

    def _pruned(self) -> str:
        """Drop improbable hypotheses; returns the cause that has become certain."""
        several, shares = len(self.hypotheses) > 1, self.probabilities()
        self.hypotheses = [
            h for h, share in zip(self.hypotheses, shares, strict=True) if share > MIN_HYPOTHESIS_PROBABILITY
        ]
        best = self.likeliest
        top = best.log_weight
        for hypothesis in self.hypotheses:
            hypothesis.log_weight -= top
        if not several or float(shares.max()) <= MIN_KNOWN_CAUSE_PROBABILITY:
            return ""
        self.hypotheses = [best]
        return f"it is {best.effect}" if best.effect else ""

    def _statistic(self) -> float:
        """Logarithm of the statistic of the likeliest hypothesis; 0 with an empty window."""
        best = self.likeliest
        return self.hit_model.test(best).statistics()[0] if best.posterior.window else 0.0

    def _tested(self, hit: Hit, last: Mapping[str, Hit]) -> tuple[float, Change | None, list[Hit]]:
        """Logarithm of the statistic, the change that it shows at a hit, and the hits since then."""
        best, causes, calibration = self.likeliest, Causes(self.hit_model), self.hit_model.calibration
        if not best.posterior.window:
            return 0.0, None, []
        test = self.hit_model.test(best)
        statistic, ratios = test.statistics()
        if statistic < test.threshold:
            best.tried_statistic = -math.inf
        elif statistic > best.tried_statistic + RETRY_LOG_GROWTH:
            if best.origin is not None:  # the statistic may show a linearisation error alone
                refined = causes.refined(best)
                self.hypotheses[self.hypotheses.index(best)] = best = refined
                test = self.hit_model.test(best)
                statistic, ratios = test.statistics()
            best.tried_statistic = statistic
            if statistic >= test.threshold:
                explained = causes.of(best, test, ratios)
                revision = None if explained and explained[0][0].effect == best.effect else causes.instead_of(best)
                if revision is not None and (not explained or revision[2] > explained[0][0].log_ratio):
                    return statistic, *self._changed(*revision[:2], statistic, hit, last, instead=best.effect)
                if explained:
                    return statistic, *self._changed(best, explained, statistic, hit, last)
        if len(best.posterior.window) > 1 and statistic < 0.5 * test.threshold:
            for name, (square, rank) in test.quiet().items():
                calibration.add(name, min(square, 9.0 * max(rank, 1.0)), rank)
            calibration.freedom += 1.0
        return statistic, None, []

    def _changed(
        self,
        before: Hypothesis,
        explained: Explained,
        statistic: float,
        hit: Hit,
        last: Mapping[str, Hit],
        instead: str = "",
    ) -> tuple[Change, list[Hit]]:
        """Replace the hypotheses by the explanations of a change; the change, and the hits since then."""
        hit_model, calibration, window = self.hit_model, self.hit_model.calibration, before.posterior.window
        explanations, complete = [explanation for explanation, _ in explained], Causes(hit_model).complete
        self.hypotheses = [complete(hypothesis) for _, hypothesis in explained]  # the likeliest first
        for explanation, hypothesis in zip(explanations, self.hypotheses, strict=True):
            hypothesis.log_weight = explanation.log_ratio
        evidence = before.posterior.since(explanations[0].start)
        calibration.hits -= len(evidence)  # they are not quiet
        calibration.odd -= sum(e.weight < 1.0 for e in evidence)
        since = [e.hit for e in evidence]
        first = since[0]
        scenes = [hit_since.physics for hit_since in since if hit_since.has_contact] or [first.physics]
        shares, old = self.probabilities(), hit_model.values(before)
        causes = []
        for explanation, share, hypothesis in zip(explanations, shares, self.hypotheses, strict=True):
            part = hit_model.candidate.part(explanation.effect)
            parameters = hit_model.followed(hypothesis, range(part.start, part.stop), old)
            new = old.copy()  # of this effect alone
            new[part] = hit_model.values(hypothesis)[part]
            pairs = [(hit_model.scene(old, scene), hit_model.scene(new, scene)) for scene in scenes]
            causes.append(
                Cause(
                    effect=explanation.effect, share=float(share), since=window[explanation.start][0].hit.name,
                    parameters=parameters, words=in_words(explanation.effect, parameters, pairs),
                )
            )  # fmt: skip
        announced = explanations[0].effect in self.announced
        self.announced.append(explanations[0].effect)
        measurement = distinguishing(hit_model, self.hypotheses, shares.tolist()[1:], last) if len(causes) > 1 else ""
        words = f"since {_when(first)} {' or '.join(cause.words for cause in causes)}"
        words = f"{words}, and not {instead}" if instead else words
        change = Change(
            hit=hit.name,
            since=first.name,
            since_time=first.stamp if first.timed else None,
            hits=len(since),
            log10_ratio=explanations[0].log_ratio / math.log(10.0),
            false_alarm=math.exp(min(statistic, 300.0)),
            causes=tuple(causes),
            again=announced,
            instead=instead,
            apart=measurement,
            words=f"{words}; {measurement}" if measurement else words,
        )
        return change, since


def _when(hit: Hit) -> str:
    """Wall-clock time and name of a hit; without a time its name."""
    if not hit.timed or hit.stamp < MIN_WALL_CLOCK_S:
        return hit.name
    return f"{time.strftime('%Y-%m-%d %H:%M:%S', time.localtime(hit.stamp))} ({hit.name})"
