# SPDX-License-Identifier: Apache-2.0
"""Follows a model from hit to hit: learns the scatter, updates the posterior, tests for change, and predicts.

The scatter is learnt from the first hits (:mod:`.learning`). Every later instant is predicted before its outcome is
used, updates the posterior, and is tested for a change (:mod:`.watch`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from impact_rs_analysis.design.selection import MIN_REPEATS
from impact_rs_analysis.evidence.minimum_data import MIN_CLUSTERS, MIN_DEGREES_OF_FREEDOM
from impact_rs_analysis.following.change import MEAN_TIME_TO_FALSE_ALARM
from impact_rs_analysis.following.documents import Followed, HitDocument, NextHit
from impact_rs_analysis.following.hits import Hit, HitSource
from impact_rs_analysis.following.learning import Learning
from impact_rs_analysis.following.watch import HitWatch
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue

LEARNING_HITS = 20  # from which the scatter is estimated


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
        """Whether the hits suffice for a full diagnosis: three conditions, and three more hits than conditions."""
        conditions = len(set(filter(None, self.conditions)))
        count = len(self.conditions)
        if not conditions:  # rows that repeat nothing
            return count >= MIN_CLUSTERS * MIN_REPEATS
        return conditions >= MIN_CLUSTERS and count - conditions >= MIN_DEGREES_OF_FREEDOM


class Follower:
    """Follows a model through hits.

    Args:
        hit_source: Gives hits and predictions; its model is replaced by one without the effects that are followed.
        model: Model at the start.
        only: Effects to follow in addition to the effects of the model; None: all observable effects.
        learnt: Number of hits from which the scatter is estimated.
        mean_time: Mean number of hits to a false alarm, at least.

    Attributes:
        learning: Hits of layouts whose scatter is not known yet.
        watch: Hypotheses since then; None: no scatter is known.
        names: All hits, in time order.
        last: Last hit of every condition; empty condition: last trial with a contact.
        changed: The hits since the last change; None: there was none.
    """

    def __init__(
        self,
        hit_source: HitSource,
        model: Model,
        only: Sequence[str] | None = None,
        learnt: int = LEARNING_HITS,
        mean_time: float = MEAN_TIME_TO_FALSE_ALARM,
    ) -> None:
        self.hit_source, self.model = hit_source, model
        self.learning = Learning(hit_source, model, only, learnt, mean_time)
        self.watch: HitWatch | None = None
        self.names: list[str] = []
        self.last: dict[str, Hit] = {}
        self.changed: HitsSince | None = None

    @property
    def watching(self) -> bool:
        """Whether the scatter is known, so that changes are looked for."""
        return self.watch is not None

    def arrived(self, handled: Callable[[], None] = lambda: None) -> Iterator[HitDocument]:
        """Process the hits that have arrived since the last call, in time order.

        Args:
            handled: Called after each instant, once the caller has taken all of its documents: a state saved
                then contains no hit that was not reported.

        Raises:
            InputError: The measurements cannot be read, or the model predicts none of the first hits.
        """
        for _, together in groupby(self.hit_source.arrived(), key=lambda hit: hit.stamp):
            yield from self.take(list(together))
            handled()

    def take(self, instant: Sequence[Hit]) -> list[HitDocument]:
        """Process simultaneous hits, whose order does not matter.

        Args:
            instant: Hits with one stamp.
        """
        instant = sorted(instant, key=lambda hit: hit.name)
        for hit in instant:
            self.names.append(hit.name)
            self.last[hit.condition] = hit
        for hit in instant:
            if hit.has_contact or "" not in self.last or not self.last[""].has_contact:
                self.last[""] = hit
        if self.changed is not None:
            conditions = (*self.changed.conditions, *(hit.condition for hit in instant))
            self.changed = replace(self.changed, conditions=conditions)
        watched = [hit for hit in instant if self._knows(hit)]
        unwatched = [hit for hit in instant if not self._knows(hit)]
        documents: dict[str, HitDocument] = {}
        if watched and self.watch is not None:
            documents, since = self.watch.take(watched, self.last)
            if since:
                self.changed = HitsSince(since[0].name, tuple(hit.condition for hit in since))
        self.learning.first += unwatched
        for layout in dict.fromkeys(hit.layout for hit in unwatched):
            if self.learning.enough(layout, len(self.names)):
                hypotheses = self.learning.begin(layout, [] if self.watch is None else self.watch.hypotheses)
                if self.watch is None and self.learning.hit_model is not None:
                    self.watch = HitWatch(self.learning.hit_model, hypotheses)
        for hit in unwatched:
            documents[hit.name] = HitDocument(name=hit.name, stamp=hit.stamp, condition=hit.condition)
        return [documents[hit.name] for hit in instant]

    def _knows(self, hit: Hit) -> bool:
        """Whether the scatter of a hit is known."""
        return self.watch is not None and hit.layout in self.watch.hit_model.whiten

    def followed(self) -> tuple[Followed, ...]:
        """Parameters with intervals by the likeliest hypothesis."""
        if self.watch is None:
            return ()
        best, hits = self.watch.likeliest, self.watch.hit_model
        return hits.followed(best, best.posterior.followed, hits.candidate.point)

    def prediction(self, condition: str = "") -> NextHit | None:
        """Prediction of the next hit of a condition from the initial state of the last one; None while learning.

        Args:
            condition: The condition; empty: of the last trial with a contact, else of the last free motion.
        """
        hit = self.last.get(condition)
        return None if hit is None or self.watch is None or not self._knows(hit) else self.watch.prediction(hit)

    def model_now(self, name: str, parent: str) -> Model:
        """Model with the present estimates of the likeliest hypothesis.

        Args:
            name: Its name.
            parent: File of the model that was given.

        Raises:
            InputError: Nothing is followed yet.
        """
        if self.watch is None:
            raise InputError(
                f"too few hits to follow a model: {len(self.names)} of {self.learning.learnt} that teach the scatter"
            )
        candidate = self.watch.hit_model.candidate
        model, values = self.model, self.watch.hit_model.values(self.watch.likeliest)
        interval_of = {parameter.parameter: parameter.ci95 for parameter in self.followed()}
        for effect, part in candidate.parts:
            intervals = {s.name: interval_of.get(f"{effect.name}.{s.name}") for s in candidate.scalars[part]}
            if any(intervals.values()):
                parameters = {
                    s.name: ParameterValue(estimate=float(value), unit=s.unit, ci95=intervals[s.name])
                    for s, value in zip(candidate.scalars[part], values[part], strict=True)
                }
                model = model.with_effect(ModelEffect(name=effect.name, parameters=parameters), name, parent)
        note = f"followed through {len(self.names)} hits, the last of them {self.names[-1]}"
        return model.model_copy(
            update={"name": name, "parent": parent, "parent_digest": self.model.digest, "note": note}
        )
