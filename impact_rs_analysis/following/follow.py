# SPDX-License-Identifier: Apache-2.0
"""Follows a model from hit to hit: learns the scatter, updates the posterior, tests for change, and predicts.

The first hits teach the scatter (:mod:`.scatter`). From then on every instant

1. is predicted by each hypothesis before its outcome is looked at,
2. updates the posterior of each (:mod:`.posterior`), and its probability by how well it predicted,
3. is tested for a change, on the likeliest hypothesis (:mod:`.change`).

A change replaces the hypotheses by its explanations, at most ``MOST``: each with the parameters of one effect free,
linearised anew about their estimate (Gauss-Newton on the hits since the change). Later hits raise or lower them, as in
multiple-model estimation (Magill 1965), and predictions are their mixture.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np
import scipy

from impact_rs_analysis.design.selection import CONDITIONS, REPEATS
from impact_rs_analysis.diagnosis.candidate import Candidate
from impact_rs_analysis.diagnosis.diagnose import effects_for
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.following.announcement import (
    APART,
    CHECKS,
    HitlessCheck,
    ProposedMeasurement,
    in_words,
    measurement_words,
    most_decisive,
)
from impact_rs_analysis.following.change import MEAN_TIME, TIED, Calibration, ChangeExplanation, ChangeTest, support
from impact_rs_analysis.following.hits import Door, Hit
from impact_rs_analysis.following.lessons import (
    Cause,
    Change,
    Followed,
    HitDocument,
    NextHit,
    Predicted,
)
from impact_rs_analysis.following.posterior import (
    WIDE,
    WIDTH,
    WINDOW,
    HitEvidence,
    Posterior,
    log_density,
    squared_distance,
    unpredicted_log_density,
    weight_of,
)
from impact_rs_analysis.following.recent_residuals import RecentResiduals
from impact_rs_analysis.following.scatter import HitScatter, deviations_of, scatter_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robot import Array

LEARNT = 20  # hits that teach the scatter
LEAST_FREEDOM = 10  # of the scatter: its standard deviations are known to 22 % then
MOST = 4  # hypotheses at a time
TRIED = 5  # explanations that are linearised anew at a hit
GROWN = 1.0  # of the logarithm of the statistic since an attempt in vain, before the next one
RULED_OUT = 1e-3  # probability below which a hypothesis is dropped
RULED_IN = 0.95  # probability from which the cause is said to be known
STEPS = 4  # of Gauss-Newton about an explanation
KEPT = 0.5  # of the promised fall of the residuals; an explanation with less is none
LEAST_GAIN = 4.0  # fall of the squares of the others, of one parameter two standard deviations
NEAR = 0.1  # parameter scales; a shorter step ends it
UNPREDICTED = "the model predicts no impact, or no velocities that obey the contact laws"
WALL_CLOCK = 1e9  # s since 1970; an earlier stamp counts from another moment


@dataclass(frozen=True)
class Origin:
    """What was known when an effect changed.

    Attributes:
        point: Point of the linearisation before, ``(p,)``.
        past: Posterior of all hits before, with an empty window.
        numbers: Parameters of the effect.
        old: Their values before, ``(p_e,)``.
    """

    point: Array
    past: Posterior
    numbers: tuple[int, ...]
    old: Array


@dataclass(eq=False)
class Hypothesis:
    """One belief about what the cell is.

    Attributes:
        point: Values of all parameters about which it is linearised, ``(p,)``.
        posterior: State of its parameters.
        log_weight: Logarithm of its probability.
        effect: Effect that changed last; empty: none did.
        origin: What that change started from; None: none did, or it is older than the window.
        tried: Statistic at which nothing was found that explains a change; it is looked for again once it has grown.
        recent: What it left of the last hits.
    """

    point: Array
    posterior: Posterior
    log_weight: float = 0.0
    effect: str = ""
    origin: Origin | None = None
    tried: float = -math.inf
    recent: RecentResiduals = field(default_factory=RecentResiduals)


@dataclass(frozen=True)
class HitsSince:
    """The hits since the last change.

    Attributes:
        since: Name of the first of them.
        conditions: Condition of each, in time order.
    """

    since: str
    conditions: tuple[str, ...]

    @property
    def diagnosable(self) -> bool:
        """Whether they are enough for a full diagnosis: three conditions, and three more hits than conditions."""
        known = len(set(filter(None, self.conditions)))
        count = len(self.conditions)
        if not known:  # rows that repeat nothing
            return count >= CONDITIONS * REPEATS
        return known >= CONDITIONS and count - known >= (REPEATS - 1) * CONDITIONS


class Follower:
    """Follows a model through hits.

    Args:
        door: Gives hits and predictions; its model is replaced by one without the effects that are followed.
        model: What is believed at the start.
        only: Effects to look at beside those of the model; None: all that hits can show.
        learnt: Hits that teach the scatter.
        mean_time: Mean number of hits to a false alarm, at least.
    """

    def __init__(
        self,
        door: Door,
        model: Model,
        only: Sequence[str] | None = None,
        learnt: int = LEARNT,
        mean_time: float = MEAN_TIME,
    ) -> None:
        self.door, self.model, self._only, self._learnt, self._mean_time = door, model, only, learnt, mean_time
        self._believed = [item for item in model.effects if _same(model, item)]
        kept = tuple(item for item in model.effects if item not in self._believed)
        door.model = model.model_copy(update={"effects": kept})
        self._first: list[Hit] = []
        self._scatter: dict[str, HitScatter] = {}
        self._limits: dict[str, Array] = {}
        self._names: list[str] = []
        self._jacobians: dict[tuple[str, bytes, tuple[int, ...]], Array] = {}
        self._plans: dict[tuple[bytes, tuple[int, ...]], tuple[Array, list[Added]]] = {}
        self._last: dict[str, Hit] = {}
        self.active: tuple[int, ...] = ()
        self._announced: list[str] = []
        self.calibration = Calibration()
        self.candidate: Candidate | None = None
        self.hypotheses: list[Hypothesis] = []
        self.changed: HitsSince | None = None

    @property
    def watching(self) -> bool:
        """Whether the scatter is known, so that changes are looked for."""
        return bool(self._scatter)

    def arrived(self, handled: Callable[[], None] = lambda: None) -> Iterator[HitDocument]:
        """Take the hits that have arrived since the last call, in time order.

        Args:
            handled: Called after each instant, once the caller has taken all of its documents: what is saved then
                never knows more than was said.

        Raises:
            InputError: The measurements cannot be read, or the model predicts none of the first hits.
        """
        for _, together in groupby(self.door.arrived(), key=lambda hit: hit.stamp):
            yield from self.take(list(together))
            handled()

    def take(self, instant: Sequence[Hit]) -> list[HitDocument]:
        """Take simultaneous hits, whose order does not matter.

        Args:
            instant: Hits with one stamp.
        """
        instant = sorted(instant, key=lambda hit: hit.name)
        for hit in instant:
            self._names.append(hit.name)
            self._last[hit.condition] = hit
        for hit in instant:
            if hit.hits or "" not in self._last or not self._last[""].hits:
                self._last[""] = hit
        if self.changed is not None:
            self.changed = HitsSince(
                self.changed.since, (*self.changed.conditions, *(hit.condition for hit in instant))
            )
        documents = self._watch([hit for hit in instant if hit.layout in self._scatter])
        unknown = [hit for hit in instant if hit.layout not in self._scatter]
        self._first += unknown
        for layout in dict.fromkeys(hit.layout for hit in unknown):
            if self._enough(layout):
                self._begin(layout)
        return [documents[hit.name] if hit.name in documents else _learning(hit) for hit in instant]

    @property
    def likeliest(self) -> Hypothesis:
        """The hypothesis with the largest probability."""
        return max(self.hypotheses, key=lambda one: one.log_weight)

    def followed(self) -> tuple[Followed, ...]:
        """Believed parameters, by the likeliest hypothesis."""
        if self.candidate is None:
            return ()
        return self._followed(self.likeliest, self.likeliest.posterior.followed, self._start)

    def prediction(self, condition: str = "") -> NextHit | None:
        """What the next hit of a condition will measure, if it starts as the last one did; None while learning.

        Args:
            condition: The condition; empty: that of the last trial that hit something, else of the last free motion.
        """
        hit = self._last.get(condition)
        if hit is None or not self.watching or hit.layout not in self._scatter:
            return None
        found = [self._predicted(one, hit) for one in self.hypotheses]
        shares = self.probabilities()
        known = [(share, *one) for share, one in zip(shares, found, strict=True) if one is not None]
        if not known:
            return None
        total = sum(share for share, _, _ in known)
        mean = sum(share * value for share, value, _ in known) / total
        variance = sum(share * (own + np.square(value - mean)) for share, value, own in known) / total
        half = scipy.special.stdtrit(self.calibration.freedom, 0.975) * np.sqrt(variance * self.calibration.of_hits)
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

    def probabilities(self) -> Array:
        """Probability of every hypothesis, ``(h,)``."""
        weights = np.array([one.log_weight for one in self.hypotheses])
        weights = np.exp(weights - weights.max())
        return np.asarray(weights / weights.sum())

    def model_now(self, name: str, parent: str) -> Model:
        """The model with the parameters that are believed now, by the likeliest hypothesis.

        Args:
            name: Its name.
            parent: File of the model that was given.

        Raises:
            InputError: Nothing is followed yet.
        """
        if self.candidate is None:
            raise InputError(
                f"too few hits to follow a model: {len(self._names)} of {self._learnt} that teach the scatter"
            )
        found, values = self.model, self._values(self.likeliest)
        known = {one.parameter: one for one in self.followed()}
        for effect, part in self.candidate.parts:
            names = [f"{effect.name}.{scalar.name}" for scalar in self.candidate.scalars[part]]
            if not any(own in known for own in names):
                continue
            parameters = {}
            for own, scalar, value in zip(names, self.candidate.scalars[part], values[part], strict=True):
                interval = known[own].ci95 if own in known else None
                parameters[scalar.name] = ParameterValue(estimate=float(value), unit=scalar.unit, ci95=interval)
            found = found.with_effect(ModelEffect(name=effect.name, parameters=parameters), name, parent)
        note = f"followed through {len(self._names)} hits, the last of them {self._names[-1]}"
        return found.model_copy(
            update={"name": name, "parent": parent, "parent_digest": self.model.digest, "note": note}
        )

    def saved(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """All that a later run needs to go on, as a document and arrays (:mod:`.state`)."""
        arrays: dict[str, Array] = {}
        hypotheses = []
        for number, one in enumerate(self.hypotheses):
            own = one.posterior
            arrays |= {
                f"point{number}": one.point,
                f"information{number}": own.information,
                f"vector{number}": own.vector,
            }
            origin = None
            if one.origin is not None:
                past = one.origin.past
                arrays |= {f"past{number}": past.information, f"past_vector{number}": past.vector}
                arrays |= {f"old{number}": one.origin.old, f"before{number}": one.origin.point}
                origin = {"followed": past.followed, "groups": _ends(past), "numbers": one.origin.numbers}
            hypotheses.append(
                {
                    "origin": origin,
                    "followed": own.followed,
                    "groups": _ends(own),
                    "window": [[(e.hit.name, e.weight) for e in instant] for instant in own.window],
                    "log_weight": one.log_weight,
                    "effect": one.effect,
                    "tried": None if math.isinf(one.tried) else one.tried,
                    "recent": one.recent.saved(),
                }
            )
        for number, scatter in enumerate(self._scatter.values()):
            arrays |= {f"whiten{number}": scatter.whiten, f"sigma{number}": scatter.sigma}
        document = {
            "model": self.model.digest,
            "names": self._names,
            "first": [hit.name for hit in self._first],
            "last": {condition: hit.name for condition, hit in self._last.items()},
            "announced": self._announced,
            "changed": None if self.changed is None else [self.changed.since, self.changed.conditions],
            "active": self.active,
            "layouts": list(self._scatter),
            "calibration": vars(self.calibration),
            "proportion": None if self.candidate is None else vars(self.proportion),
            "hypotheses": hypotheses,
        }
        return document, arrays

    def restore(self, document: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
        """Go on where :meth:`saved` was called.

        Raises:
            InputError: A hit that the state needs is gone.
        """
        windows = [name for h in document["hypotheses"] for instant in h["window"] for name, _ in instant]
        needed = [*document["first"], *document["last"].values(), *windows]
        hits = self.door.recalled(needed, document["names"])
        self._names, self._announced = list(document["names"]), list(document["announced"])
        if (changed := document.get("changed")) is not None:
            self.changed = HitsSince(changed[0], tuple(changed[1]))
        self._first = [hits[name] for name in document["first"]]
        self._last = {condition: hits[name] for condition, name in document["last"].items()}
        if document["proportion"] is None:
            return
        self.consider(self.door.source(list(hits.values())), Proportion(**document["proportion"]))
        self.active = tuple(document["active"])
        self._scatter = {
            layout: HitScatter(arrays[f"whiten{n}"], arrays[f"sigma{n}"])
            for n, layout in enumerate(document["layouts"])
        }
        self.calibration = Calibration(**{**document["calibration"], "whole": tuple(document["calibration"]["whole"])})
        self.hypotheses = []
        for number, one in enumerate(document["hypotheses"]):
            point = arrays[f"point{number}"]
            posterior = _posterior(one, arrays[f"information{number}"], arrays[f"vector{number}"])
            origin = None
            if (own := one["origin"]) is not None:
                past = _posterior(own, arrays[f"past{number}"], arrays[f"past_vector{number}"])
                origin = Origin(arrays[f"before{number}"], past, tuple(own["numbers"]), arrays[f"old{number}"])
            for instant in one["window"]:
                evidence = [(self._evidence(hits[name], point), weight) for name, weight in instant]
                posterior.add([replace(e, weight=weight) for e, weight in evidence if e is not None])
            tried = -math.inf if one["tried"] is None else one["tried"]
            recent = RecentResiduals.restored(one["recent"])
            self.hypotheses.append(
                Hypothesis(point, posterior, one["log_weight"], one["effect"], origin, tried, recent)
            )

    def _enough(self, layout: str) -> bool:
        """Whether the first hits of a layout teach its scatter."""
        own = [hit for hit in self._first if hit.layout == layout]
        if len(self._names) < self._learnt or len(own) < self._learnt // 2:
            return False
        _, freedom = deviations_of([hit.measured for hit in own], [hit.condition for hit in own])
        return freedom >= min(LEAST_FREEDOM, self._learnt // 2 - 1)

    def _begin(self, layout: str) -> None:
        """Learn the scatter of a layout from its first hits, and begin to watch it."""
        first = [hit for hit in self._first if hit.layout == layout]
        self._first = [hit for hit in self._first if hit.layout != layout]
        if self.candidate is None:
            source = self.door.source(first)
            self._deviations, self._stated = self.consider(source, source.proportion)
        assert self.candidate is not None
        known, point = self.active if self.hypotheses else (), self._start
        self._look_at(range(point.size))
        found = [(hit, one) for hit in first if (one := self._linearised(hit, point, self.active)) is not None]
        if len(found) < 0.5 * len(first):
            raise InputError(f"model {self.model.name!r} predicts {len(found)} of the first {len(first)} hits")
        residuals = [(hit, hit.measured - predicted) for hit, (predicted, _) in found]
        jacobians = [jacobian for _, (_, jacobian) in found]
        self._limits[layout] = self.door.limits(first, layout)
        self._scatter[layout], freedom = _scatter(residuals, self._limits[layout])
        calibration, freedom = self.calibration, max(freedom, 2)
        calibration.freedom = float(freedom) if not self.hypotheses else min(calibration.freedom, float(freedom))
        moving = np.max([np.max(np.abs(jacobian), axis=0) for jacobian in jacobians], axis=0) > 0.0
        self._look_at(sorted({*known, *np.flatnonzero(moving).tolist()}))
        if not self.hypotheses:
            stated = [number for number in self._stated if number in self.active]
            self.hypotheses = [Hypothesis(point, Posterior.of(stated, self._deviations[stated]))]
        for hypothesis in self.hypotheses:
            evidence = [e for hit, _ in found if (e := self._evidence(hit, hypothesis.point)) is not None]
            hypothesis.posterior.make_room((one.hit.group, one.patterns.shape[1]) for one in evidence)
            hypothesis.posterior.believe(evidence)
        self._calibrate(layout, residuals, jacobians)

    def _look_at(self, parameters: Sequence[int]) -> None:
        """Take sensitivities to these parameters alone from now on."""
        self.active = tuple(parameters)
        self._plans.clear()
        self._jacobians.clear()

    def consider(self, source: Source, proportion: Proportion) -> tuple[Array, list[int]]:
        """Choose effects and their parameters.

        Args:
            source: Some hits.
            proportion: Size of what was measured, to which ranges and scales are in proportion.

        Returns:
            Standard deviations of the parameters in scales, ``(p,)``, and the numbers of those that the model states
            with an interval.
        """
        known = [item.name for item in self._believed]
        library = source.model.known_effects
        names = [effect.name for effect in effects_for(source, self._only)]
        names += [name for name in known if name not in names]
        effects = tuple(library[name].in_proportion(proportion) for name in names)
        candidate = Candidate.of(effects, source)
        point = candidate.nominal.copy()
        deviations = np.minimum(WIDE, candidate.prior)
        followed: list[int] = []
        for item in self._believed:
            part = candidate.part(item.name)
            for number in range(part.start, part.stop):
                value = item.parameters.get(candidate.scalars[number].name)
                if value is None:  # nominal
                    continue
                point[number] = value.estimate
                if value.ci95 is not None:
                    width = (value.ci95[1] - value.ci95[0]) / (2.0 * NORMAL_95)
                    deviations[number] = max(width / candidate.scale[number], 1e-6)
                    followed.append(number)
        self._start, self._joints, self.proportion = point, source.joints, proportion
        self.active = tuple(range(point.size))
        self.candidate = replace(candidate, point=point)
        return deviations, followed

    def _calibrate(self, layout: str, residuals: Sequence[tuple[Hit, Array]], jacobians: Sequence[Array]) -> None:
        """Variance of the scores: of every first hit by the scatter of the others."""
        test = self._test(self.hypotheses[0])
        square, expected = self.calibration.whole
        for left, (hit, residual) in enumerate(residuals):
            others = [one for n, one in enumerate(residuals) if n != left]
            alike = [value for one, value in others if one.condition == hit.condition] or [v for _, v in others]
            scatter, _ = _scatter(others, self._limits[layout])
            whitened = scatter.whiten @ (residual - np.mean(alike, axis=0)) / math.sqrt(1.0 + 1.0 / len(alike))
            square, expected = square + float(whitened @ whitened), expected + whitened.size
            jacobian = scatter.whiten @ jacobians[left]
            for name, places in test.effects.items():
                columns = jacobian[:, [test.active[place] for place in places]]
                basis, values, _ = np.linalg.svd(columns, full_matrices=False)
                basis = basis[:, values > 1e-6 * max(float(values[0]), 1e-300)]
                self.calibration.add(name, float(np.sum(np.square(basis.T @ whitened))), float(basis.shape[1]))
        self.calibration.whole = square, expected

    def _test(self, hypothesis: Hypothesis) -> ChangeTest:
        assert self.candidate is not None
        return ChangeTest(
            replace(self.candidate, point=hypothesis.point), self.active, self.calibration, self._mean_time
        )

    def _watch(self, fresh: Sequence[Hit]) -> dict[str, HitDocument]:
        """Predict, update and test; what each hit taught, by its name."""
        if not fresh:
            return {}
        begun = time.perf_counter()
        errors: dict[str, tuple[float, float, bool]] = {}
        best = self.likeliest
        for hypothesis in self.hypotheses:
            taken = []
            for hit in fresh:
                evidence = self._evidence(hit, hypothesis.point)
                if evidence is None:
                    hypothesis.log_weight += unpredicted_log_density(len(hit.features), self.calibration.freedom)
                    if hypothesis is best:
                        self.door.skipped[hit.name] = UNPREDICTED
                    continue
                posterior = hypothesis.posterior
                posterior.make_room([(hit.group, evidence.patterns.shape[1])])
                innovation, covariance = posterior.innovation(evidence)
                distance = squared_distance(innovation, covariance, self.calibration.of_hits)
                weight = weight_of(distance, innovation.size)
                hypothesis.log_weight += log_density(distance, covariance, self.calibration.freedom)
                taken.append(replace(evidence, weight=weight))
                left = innovation - hypothesis.recent.expected(hit.group, innovation.size)
                hypothesis.recent.take(hit.group, innovation, weight)
                if hypothesis is best:
                    size = math.sqrt(float(np.mean(np.square(left))))
                    self.calibration.hits += 1
                    self.calibration.odd += weight < 1.0
                    errors[hit.name] = size, self._error_of_model(hit, evidence, hypothesis.point), weight < 1.0
            if taken:
                hypothesis.posterior.add(taken)
            if len(hypothesis.posterior.window) == WINDOW:
                hypothesis.origin = None
        resolved = self._weigh()
        statistic, change = self._tested(fresh)
        spent = 1e3 * (time.perf_counter() - begun) / len(fresh)
        documents = {}
        for hit in fresh:
            error, last = errors.get(hit.name), hit is fresh[-1]
            documents[hit.name] = HitDocument(
                name=hit.name,
                stamp=hit.stamp,
                condition=hit.condition,
                error=None if error is None else error[0],
                of_model=None if error is None else error[1],
                evidence=statistic / math.log(10.0),
                odd=error is not None and error[2],
                change=change if last else None,
                resolved=resolved if last else "",
                milliseconds=spent,
            )
        return documents

    def _error_of_model(self, hit: Hit, evidence: HitEvidence, point: Array) -> float:
        """Error of the model as it was given, in standard deviations of a hit, rms over the features."""
        assert self.candidate is not None
        off = evidence.residual
        if not np.array_equal(point, self._start):
            (given,) = self.door.predict(hit, [replace(self.candidate, point=self._start).split(self._start)])
            off = off if given is None else self._scatter[hit.layout].whiten @ (hit.measured - given)
        return math.sqrt(float(np.mean(np.square(off))))

    def _weigh(self) -> str:
        """Drop hypotheses that are ruled out; what is now known for certain."""
        several = len(self.hypotheses) > 1
        shares = self.probabilities()
        most = float(shares.max())
        self.hypotheses = [h for h, share in zip(self.hypotheses, shares, strict=True) if share > RULED_OUT]
        top = max(one.log_weight for one in self.hypotheses)
        for one in self.hypotheses:
            one.log_weight -= top
        if several and most > RULED_IN:
            self.hypotheses = [self.likeliest]
            best = self.likeliest
            return f"it is {best.effect}" if best.effect else ""
        return ""

    def _tested(self, instant: Sequence[Hit]) -> tuple[float, Change | None]:
        """Logarithm of the statistic, and the change that it shows."""
        best = self.likeliest
        if not best.posterior.window:
            return 0.0, None
        test = self._test(best)
        statistic, ratios = test.statistics(best.posterior)
        if statistic < test.threshold:
            best.tried = -math.inf
        elif statistic > best.tried + GROWN:
            if best.origin is not None:  # or is it its linearisation?
                refined = self._refined(best)
                self.hypotheses[self.hypotheses.index(best)] = best = refined
                test = self._test(best)
                statistic, ratios = test.statistics(best.posterior)
            best.tried = statistic
            if statistic >= test.threshold:
                held = self._explanations(best, test, ratios)
                other = None if held and held[0][0].effect == best.effect else self._others(best)
                if other is not None and (not held or other[2] > held[0][0].log_ratio):
                    return statistic, self._changed(*other[:2], statistic, instant[-1], instead=best.effect)
                if held:
                    return statistic, self._changed(best, held, statistic, instant[-1])
        if len(best.posterior.window) > 1 and statistic < 0.5 * test.threshold:
            for name, (square, rank) in test.quiet(best.posterior).items():
                self.calibration.add(name, min(square, 9.0 * max(rank, 1.0)), rank)
            self.calibration.freedom += 1.0
        return statistic, None

    def _changed(
        self,
        before: Hypothesis,
        held: Sequence[tuple[ChangeExplanation, Hypothesis]],
        statistic: float,
        hit: Hit,
        instead: str = "",
    ) -> Change:
        """Replace the hypotheses by the explanations of a change."""
        assert self.candidate is not None
        window = list(before.posterior.window)
        found, hypotheses = [one for one, _ in held], [self._complete(hypothesis) for _, hypothesis in held]
        first = window[found[0].start][0].hit
        for one, hypothesis in zip(found, hypotheses, strict=True):
            hypothesis.log_weight = one.log_ratio
        self.hypotheses = hypotheses  # the likeliest first
        evidence = [e for instant in window[found[0].start :] for e in instant]
        self.calibration.hits -= len(evidence)  # they are not quiet
        self.calibration.odd -= sum(e.weight < 1.0 for e in evidence)
        since = [e.hit for e in evidence]
        self.changed = HitsSince(first.name, tuple(one.condition for one in since))
        scenes = [one.physics for one in since if one.hits] or [first.physics]
        shares = self.probabilities()
        causes = []
        old = self._values(before)
        for one, share, hypothesis in zip(found, shares, hypotheses, strict=True):
            part = self.candidate.part(one.effect)
            parameters = self._followed(hypothesis, range(part.start, part.stop), old)
            new = old.copy()  # of this effect alone
            new[part] = self._values(hypothesis)[part]
            pairs = [(self._scene(old, scene), self._scene(new, scene)) for scene in scenes]
            start = window[one.start][0].hit
            causes.append(
                Cause(
                    effect=one.effect, share=float(share), since=start.name, parameters=parameters,
                    words=in_words(one.effect, parameters, pairs),
                )
            )  # fmt: skip
        again = found[0].effect in self._announced
        self._announced.append(found[0].effect)
        apart = self._apart() if len(causes) > 1 else ""
        words = f"since {_when(first)} {' or '.join(cause.words for cause in causes)}"
        if instead:
            words = f"{words}, and not {instead}"
        return Change(
            hit=hit.name,
            since=first.name,
            since_time=first.stamp if first.timed else None,
            hits=len(since),
            log10_ratio=found[0].log_ratio / math.log(10.0),
            false_alarm=math.exp(min(statistic, 300.0)),
            causes=tuple(causes),
            again=again,
            instead=instead,
            apart=apart,
            words=f"{words}; {apart}" if apart else words,
        )

    def _explanations(
        self, before: Hypothesis, test: ChangeTest, statistics: dict[str, Array]
    ) -> list[tuple[ChangeExplanation, Hypothesis]]:
        """Explanations of a change that hold once they are linearised anew, the likeliest first."""
        tried = test.explanations(before.posterior, statistics)[:TRIED]
        if not tried:
            return []
        held = [found for one in tried if (found := self._held(before, one)) is not None]
        held.sort(key=lambda pair: -pair[0].log_ratio)
        tie = math.log(TIED)
        promising = any(one.effect == tried[0].effect for one, _ in held)
        # What promises most may hold at a later hit: the others need more evidence than it.
        if not held or held[0][0].log_ratio < test.threshold - (0.0 if promising else tie):
            return []
        return [pair for pair in held if pair[0].log_ratio > held[0][0].log_ratio + tie][:MOST]

    def _others(self, best: Hypothesis) -> tuple[Hypothesis, list[tuple[ChangeExplanation, Hypothesis]], float] | None:
        """What explains the hits since the last change better than the effect that was named then.

        Returns:
            The hypothesis before that change, the explanations of all hits since, and by how much the logarithm of the
            likelihood ratio of the first exceeds that of the effect that was named; None: there is none.
        """
        origin = best.origin
        if origin is None:
            return None
        hits = [[e.hit for e in instant] for instant in best.posterior.window]
        before = Hypothesis(origin.point, origin.past.copy())
        for instant in hits:
            evidence = [e for hit in instant if (e := self._evidence(hit, before.point)) is not None]
            before.posterior.make_room((e.hit.group, e.patterns.shape[1]) for e in evidence)
            weights = {e.hit.name: e.weight for own in best.posterior.window for e in own}
            before.posterior.add([replace(e, weight=weights[e.hit.name]) for e in evidence])
        test = self._test(before)
        _, statistics = test.statistics(before.posterior)
        held = self._explanations(before, test, statistics)
        if not held or held[0][0].effect == best.effect:
            return None
        lead = self._ratio(before, held[0][1]) - self._ratio(before, best)
        return None if lead <= 0.0 else (before, held, lead)

    def _held(self, before: Hypothesis, one: ChangeExplanation) -> tuple[ChangeExplanation, Hypothesis] | None:
        """An explanation, linearised anew; None where it does not keep what it promised, or few hits speak for it.

        A contact that grips does not change with more friction, though it does with much less. And of hits that are odd
        now and then, in the same way, two make no change: without the quarter that speaks for it most, the other hits
        must still speak for it. Its likelihood ratio is corrected by what it explains more or less than promised, and
        by the information about its parameters there (Laplace).
        """
        fitted = self._about(before, one)
        gains = self._gains(before, fitted)
        inflation = self.calibration.of(one.effect)
        speaking = sum(gain > inflation for gain in gains)
        since = [e for instant in before.posterior.window[one.start :] for e in instant]
        if speaking < self.calibration.least_hits(self._mean_time, since):
            return None
        if sum(gains) <= KEPT * one.gain or support(gains) <= LEAST_GAIN * inflation:
            return None
        promised = one.gain / inflation - float(one.change @ one.change) / WIDTH**2
        first = self._evidence_of(promised, one.determinant, one.change.size)
        return replace(one, log_ratio=one.log_ratio + self._ratio(before, fitted) - first), fitted

    def _gains(self, before: Hypothesis, fitted: Hypothesis) -> list[float]:
        """Fall of the sum of squared whitened residuals of every hit since a change."""
        past = {e.hit.name: e for instant in before.posterior.window for e in instant}
        found = []
        for evidence in (e for instant in fitted.posterior.window for e in instant):
            old = past[evidence.hit.name]
            first, second = before.posterior.rest(old), fitted.posterior.rest(evidence)
            found.append(old.weight * float(first @ first - second @ second))
        return found

    def _ratio(self, before: Hypothesis, fitted: Hypothesis) -> float:
        """Logarithm of the likelihood ratio of an explanation about its estimate, by the hits since then."""
        assert self.candidate is not None and fitted.origin is not None
        numbers, inflation = list(fitted.origin.numbers), self.calibration.of(fitted.effect)
        place = [fitted.posterior.followed.index(number) for number in numbers]
        covariance = inflation * fitted.posterior.covariance_of_followed()[np.ix_(place, place)]
        known = np.linalg.inv(covariance) - np.eye(len(place)) / (inflation * WIDE**2)
        moved = (self._values(fitted)[numbers] - fitted.origin.old) / self.candidate.scale[numbers]
        prior = float(moved @ np.linalg.solve(covariance + WIDTH**2 * np.eye(len(place)), moved))
        _, determinant = np.linalg.slogdet(np.eye(len(place)) + WIDTH**2 * known)
        explained = sum(self._gains(before, fitted)) / inflation - prior
        return self._evidence_of(explained, float(determinant), len(place))

    def _evidence_of(self, explained: float, determinant: float, size: int) -> float:
        """Logarithm of a likelihood ratio, by Student's t: what is explained, and log det(1 + D I D)."""
        nu = self.calibration.freedom
        return 0.5 * (nu + size) * math.log1p(max(explained, 0.0) / nu) - 0.5 * determinant

    def _about(self, before: Hypothesis, one: ChangeExplanation) -> Hypothesis:
        """An explanation, linearised about its estimate."""
        assert self.candidate is not None
        part = self.candidate.part(one.effect)
        numbers = list(range(part.start, part.stop))
        seen = [n for n in numbers if n in self.active]
        point = before.point.copy()
        old = self._values(before)[numbers]
        point[numbers] = old
        point[seen] += self.candidate.scale[seen] * one.change
        past = before.posterior.copy()
        hits = [[e.hit for e in instant] for instant in past.window[one.start :]]
        past.believe_before(one.start)
        past.forget_window()
        if len(seen) < len(numbers):  # what changed shows shapes that nothing depended on before
            self._look_at(sorted({*self.active, *numbers}))
        return self._fitted(Origin(before.point, past, tuple(numbers), old), hits, point, one.effect)

    def _fitted(self, origin: Origin, hits: Sequence[Sequence[Hit]], point: Array, effect: str) -> Hypothesis:
        """Gauss-Newton on the hits since a change, with the parameters of its effect free."""
        assert self.candidate is not None
        own, numbers = self.candidate, list(origin.numbers)
        scale, lower, upper = own.scale[numbers], own.lower[numbers], own.upper[numbers]
        followed = tuple(dict.fromkeys((*origin.past.followed, *numbers)))
        point = point.copy()
        point[numbers] = np.clip(point[numbers], lower, upper)
        point = own.possible(point)
        for step in range(STEPS):
            posterior = self._believed_since(origin, followed, hits, point, followed)
            place = [posterior.followed.index(n) for n in numbers]
            there = point.copy()
            there[numbers] = np.clip(point[numbers] + scale * posterior.mean[place], lower, upper)
            there = own.possible(there)
            if step == STEPS - 1 or np.all(np.abs(there - point)[numbers] < NEAR * scale):
                break
            point = there
        return Hypothesis(point, posterior, effect=effect, origin=origin)

    def _complete(self, fitted: Hypothesis) -> Hypothesis:
        """The same with sensitivities to all parameters, for the test of the next hits."""
        assert fitted.origin is not None
        hits = [[e.hit for e in instant] for instant in fitted.posterior.window]
        whole = self._believed_since(fitted.origin, fitted.posterior.followed, hits, fitted.point, self.active)
        return replace(fitted, posterior=whole)

    def _believed_since(
        self, origin: Origin, followed: tuple[int, ...], hits: Sequence[Sequence[Hit]], point: Array,
        parameters: Sequence[int],
    ) -> Posterior:  # fmt: skip
        """Posterior of what was known before a change and the hits since then, linearised about a point."""
        assert self.candidate is not None
        numbers = list(origin.numbers)
        shift = (origin.old - point[numbers]) / self.candidate.scale[numbers]
        posterior = origin.past.refollowed(followed, numbers, shift)
        for instant in hits:
            evidence = [e for hit in instant if (e := self._evidence(hit, point, parameters)) is not None]
            posterior.make_room((e.hit.group, e.patterns.shape[1]) for e in evidence)
            weighed = [replace(e, weight=self._weight(posterior, e)) for e in evidence]
            if weighed:
                posterior.add(weighed)
        return posterior

    def _weight(self, posterior: Posterior, evidence: HitEvidence) -> float:
        """Weight of a hit."""
        innovation, covariance = posterior.innovation(evidence)
        return weight_of(squared_distance(innovation, covariance, self.calibration.of_hits), innovation.size)

    def _refined(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis, linearised about what the hits since its change say by now."""
        if hypothesis.origin is None:
            return hypothesis
        hits = [[e.hit for e in instant] for instant in hypothesis.posterior.window]
        found = self._complete(self._fitted(hypothesis.origin, hits, self._values(hypothesis), hypothesis.effect))
        found.log_weight, found.recent = hypothesis.log_weight, hypothesis.recent
        return found

    def _values(self, hypothesis: Hypothesis) -> Array:
        """Believed values of all parameters, ``(p,)``."""
        assert self.candidate is not None
        values = hypothesis.point.copy()
        for place, number in enumerate(hypothesis.posterior.followed):
            values[number] += self.candidate.scale[number] * hypothesis.posterior.mean[place]
        return self.candidate.possible(np.clip(values, self.candidate.lower, self.candidate.upper))

    def _followed(self, hypothesis: Hypothesis, numbers: Sequence[int], old: Array) -> tuple[Followed, ...]:
        """Parameters with their intervals and changes."""
        assert self.candidate is not None
        own, posterior = self.candidate, hypothesis.posterior
        values = self._values(hypothesis)
        covariance = posterior.covariance_of_followed()
        wide = scipy.special.stdtrit(self.calibration.freedom, 0.975)
        names = [effect.name for effect, part in own.parts for _ in range(part.start, part.stop)]
        found = []
        for number in numbers:
            place = posterior.followed.index(number)
            inflation = self.calibration.of(names[number])
            half = wide * own.scale[number] * math.sqrt(float(covariance[place, place]) * inflation)
            scalar = own.scalars[number]
            value = float(values[number])
            found.append(
                Followed(
                    parameter=f"{names[number]}.{scalar.name}",
                    estimate=value,
                    ci95=(value - half, value + half),
                    change=value - float(old[number]),
                    unit=scalar.unit,
                )
            )
        return tuple(found)

    def _apart(self) -> str:
        """What distinguishes the explanations best: a hit that was measured, a check without one, or a new trial."""
        names = [one.effect for one in self.hypotheses]
        shares = self.probabilities().tolist()[1:]
        measured = [(name, hit) for name, hit in self._last.items() if name]
        measured = measured or [(f"the kind of {hit.name}", hit) for hit in self._last.values()]
        found = [self._proposed_hit(f"one hit of {name}", hit) for name, hit in measured]
        found += [self._checked(check) for check in CHECKS]
        free = [self._seen_free(name) for name in names]
        if any(free) and self._last[""].physics.arms:
            seen = " and ".join(name for name, own in zip(names, free, strict=True) if own)
            apart = tuple(math.inf if own != free[0] else 0.0 for own in free[1:])
            found.append(ProposedMeasurement("a free motion", apart, f"{seen} would show there"))
        best = most_decisive(found, shares)
        if best is None or min(best.distances) <= APART:
            hits = self.door.unmeasured([hit for _, hit in measured])
            found += [self._proposed_hit(f"a hit of {hit.condition}, not measured yet,", hit) for hit in hits]
            best = most_decisive(found, shares)
        if best is not None:
            return measurement_words(best, names[0], names[1:])
        return "no hit of these kinds and nothing that can be measured without one distinguishes them"

    def _proposed_hit(self, words: str, hit: Hit) -> ProposedMeasurement:
        """How well a hit distinguishes the likeliest explanation from the others."""
        first, *others = (self._forecast(one, hit) for one in self.hypotheses)
        distances = []
        for other in others:
            if first is None or other is None:
                distances.append(0.0)
                continue
            apart, covariance = first[0] - other[0], 0.5 * (first[1] + other[1])
            distances.append(math.sqrt(squared_distance(apart, covariance, self.calibration.of_hits)))
        return ProposedMeasurement(words, tuple(distances), f"{min(distances):.1f} standard deviations")

    def _forecast(self, hypothesis: Hypothesis, hit: Hit) -> tuple[Array, Array] | None:
        """Mean ``(F,)`` and covariance ``(F, F)`` of what a hit will measure, whitened; None without a contact."""
        evidence = self._evidence(hit, hypothesis.point) if hit.layout in self._scatter else None
        if evidence is None:
            return None
        posterior = hypothesis.posterior.copy()
        posterior.make_room([(hit.group, evidence.patterns.shape[1])])
        innovation, covariance = posterior.innovation(evidence)
        return self._scatter[hit.layout].whiten @ hit.measured - innovation, covariance

    def _checked(self, check: HitlessCheck) -> ProposedMeasurement:
        """How well a measurement without a hit distinguishes the likeliest explanation from the others."""
        read = [self._read(check, one) for one in self.hypotheses]
        (first, width), *others = read
        noise = check.least / APART
        distances = tuple(abs(first - other) / math.sqrt(noise**2 + width**2 + own**2) for other, own in others)
        unit = f" {check.unit}" if check.unit else ""
        expected = (f"{value:.3g}{unit} if {one.effect}" for (value, _), one in zip(read, self.hypotheses, strict=True))
        return ProposedMeasurement(f"one measurement, {check.words},", distances, ", ".join(expected))

    def _read(self, check: HitlessCheck, hypothesis: Hypothesis) -> tuple[float, float]:
        """What a measurement without a hit reads, and its standard deviation for the parameters are uncertain."""
        assert self.candidate is not None
        physics, values = self._last[""].physics, self._values(hypothesis)
        centre = check.of(self._scene(values, physics))
        slopes = []
        for number in hypothesis.posterior.followed:
            step = 0.1 * self.candidate.scale[number]
            step = step if values[number] + step <= self.candidate.upper[number] else -step
            step = self.candidate.step_with_bodies(values, number, step)
            moved = values + step * (np.arange(values.size) == number)
            slopes.append((check.of(self._scene(moved, physics)) - centre) * self.candidate.scale[number] / step)
        covariance = hypothesis.posterior.covariance_of_followed()
        return centre, math.sqrt(max(float(np.array(slopes) @ covariance @ np.array(slopes)), 0.0))

    def _scene(self, values: Array, physics: Physics) -> Physics:
        """Physics with the effects that are followed at some values."""
        assert self.candidate is not None
        for effect, part in self.candidate.parts:
            if np.any(values[part] != self.candidate.nominal[part]):
                physics = effect.apply_vector(physics, values[part])
        return physics

    def _seen_free(self, name: str) -> bool:
        assert self.candidate is not None
        return any(effect.name == name and effect.seen_in(contact=False) for effect in self.candidate.effects)

    def _predicted(self, hypothesis: Hypothesis, hit: Hit) -> tuple[Array, Array] | None:
        """Mean and variance of what a hit like this one measures, ``(F,)`` each, in its units."""
        if hit.layout not in self._scatter:
            return None
        evidence = self._evidence(hit, hypothesis.point)
        if evidence is None:
            return None
        hypothesis.posterior.make_room([(hit.group, evidence.patterns.shape[1])])
        innovation, covariance = hypothesis.posterior.innovation(evidence)
        innovation = innovation - hypothesis.recent.expected(hit.group, innovation.size)
        unwhiten = np.linalg.inv(self._scatter[hit.layout].whiten)
        return hit.measured - unwhiten @ innovation, np.diag(unwhiten @ covariance @ unwhiten.T)

    def _evidence(self, hit: Hit, point: Array, parameters: Sequence[int] | None = None) -> HitEvidence | None:
        """What a hit says about a point and parameters around it (None: all active ones); None without a contact."""
        found = self._linearised(hit, point, self.active if parameters is None else parameters)
        if found is None:
            return None
        predicted, jacobian = found
        whiten = self._scatter[hit.layout].whiten
        return HitEvidence(hit, whiten @ (hit.measured - predicted), whiten @ jacobian, whiten @ hit.discrepancy.T)

    def _linearised(self, hit: Hit, point: Array, parameters: Sequence[int]) -> tuple[Array, Array] | None:
        """Predicted features ``(F,)`` and sensitivities per scale ``(F, p)`` at a point; None without a contact.

        Sensitivities to other parameters are 0.
        """
        assert self.candidate is not None
        own, numbers = replace(self.candidate, point=point), tuple(parameters)
        key = (hit.shared, point.tobytes(), numbers)
        if hit.shared and key in self._jacobians:
            (predicted,) = self.door.predict(hit, [own.split(point)])
            return None if predicted is None else (predicted, self._jacobians[key])
        if (plan := self._plans.get(key[1:])) is None:
            steps = own.steps(self._joints)
            moved = [point + steps[number] * (np.arange(point.size) == number) for number in numbers]
            plan = self._plans[key[1:]] = steps, [own.split(one) for one in (point, *moved)]
        steps, points = plan
        predicted, *others = self.door.predict(hit, points)
        if predicted is None:
            return None
        jacobian = np.zeros((predicted.size, point.size))
        for number, there in zip(numbers, others, strict=True):
            if there is not None:
                jacobian[:, number] = (there - predicted) * own.scale[number] / steps[number]
        if hit.shared:
            self._jacobians[key] = jacobian
        return predicted, jacobian


def _learning(hit: Hit) -> HitDocument:
    """A hit that teaches the scatter."""
    return HitDocument(
        name=hit.name,
        stamp=hit.stamp,
        condition=hit.condition,
        error=None,
        of_model=None,
        evidence=None,
        milliseconds=0.0,
    )


def _scatter(residuals: Sequence[tuple[Hit, Array]], limits: Array) -> tuple[HitScatter, int]:
    """Scatter of hits of one layout, and its degrees of freedom."""
    deviations, freedom = deviations_of([value for _, value in residuals], [hit.condition for hit, _ in residuals])
    stated = np.max([hit.noise for hit, _ in residuals], axis=0)
    return scatter_of(deviations, freedom, stated, limits), freedom


def _same(model: Model, item: ModelEffect) -> bool:
    """Whether an entry has the parameters that the effect of its name has now; older files may have others."""
    return model.effect_of(item).parameters == model.known_effects[item.name].parameters


def _ends(posterior: Posterior) -> dict[str, tuple[int, int]]:
    """Columns of the groups of a posterior, for the state."""
    return {group: (part.start, part.stop) for group, part in posterior.groups.items()}


def _posterior(document: Mapping[str, Any], information: Array, vector: Array) -> Posterior:
    """A posterior of the state, with an empty window."""
    groups = {group: slice(*ends) for group, ends in document["groups"].items()}
    return Posterior(tuple(document["followed"]), information, vector, groups)


def _when(hit: Hit) -> str:
    """When a hit was, for the reader: the wall clock, or its name."""
    if not hit.timed or hit.stamp < WALL_CLOCK:
        return hit.name
    return f"{time.strftime('%Y-%m-%d %H:%M:%S', time.localtime(hit.stamp))} ({hit.name})"
