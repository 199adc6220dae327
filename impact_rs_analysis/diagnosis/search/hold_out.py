# SPDX-License-Identifier: Apache-2.0
"""Nested cross-validation (hold-out): every cluster is predicted by a search that has not seen it.

Held-out data influence neither shortlist, nor selection, nor estimate of the effects that predict them. For every fold
the whole search (:mod:`impact_rs_analysis.diagnosis.search.effect_selection`) runs on the training clusters, and the
model with the selected effects predicts the fold. A fit of a fold starts at the fit of the same effects to all
clusters, which saves simulations; it ends at the optimum of the training clusters. Fits of impacts start at nominal:
they are cheap, and secants from other points mislead where contacts slip.

A search needs two clusters that depend on an effect, to predict one from the other, and as many repeats as any verdict.
With fewer, or without processor time, the fold fits the effects that the search of all clusters selected, and does not
test the selection.

Conditions are held out with all their repeats, several recordings as whole recordings, and a single recording in runs
of neighbouring stretches, with a guard stretch on either side. Where effects may depend on covariates
(``Source.interleaved``) folds are interleaved, one of every six neighbours each: a session of neighbouring rows in one
fold could not be predicted from the other sessions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.diagnosis.search.budget import UNLIMITED, Budget
from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.thresholds import MIN_CLUSTERS, MIN_CLUSTERS_OF_EFFECT
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.source import Source
from impact_rs_sim.effects import Effect
from impact_rs_sim.progress import HOLD_OUT
from impact_rs_sim.robots.robot import Array


@dataclass(frozen=True)
class Fold:
    """Clusters that are held out together, and those that predict them.

    Attributes:
        held: Indices of the predicted clusters.
        training: Indices of the clusters of the search.
    """

    held: tuple[int, ...]
    training: tuple[int, ...]


@dataclass(frozen=True)
class HoldOut:
    """Held-out errors.

    Attributes:
        folds: The folds.
        residuals: Mean residuals after prediction, ``(F,)`` per cluster [-].
        chosen: Names of the effects that predict each fold.
        searched: Whether a search of the training clusters has selected them; else they were only fitted, because too
            few clusters or repeats are left for a search.
        failed: Indices of the clusters in which the effects of the fold cannot be simulated, such as a hit that they
            predict to miss; their ``residuals`` are those of the model.
        added: The effects that predict each fold, with their estimates.
    """

    folds: tuple[Fold, ...]
    residuals: tuple[Array, ...]
    chosen: tuple[tuple[str, ...], ...]
    searched: tuple[bool, ...]
    failed: tuple[int, ...] = ()
    added: tuple[Added, ...] = ()

    @property
    def found(self) -> tuple[tuple[str, ...], ...]:
        """Names of the effects that the search of each fold has selected."""
        return tuple(names for names, own in zip(self.chosen, self.searched, strict=True) if own)


def folds_of(source: Source) -> list[Fold]:
    """Folds of a source; empty with too few clusters for a hold-out."""
    units: dict[str, list[int]] = {}
    for number, item in enumerate(source.clusters):
        units.setdefault(item.unit, []).append(number)
    groups: list[list[int]]
    if len(units) >= MIN_CLUSTERS:
        owners = list(units.values())
        count = min(source.folds, len(owners))
        groups = [[number for owner in owners[start::count] for number in owner] for start in range(count)]
    elif source.repeated:
        return []
    else:
        numbers = np.arange(len(source.clusters))
        parts = _in_turn(numbers, source.folds) if source.interleaved else np.array_split(numbers, source.folds)
        groups = [part.tolist() for part in parts]
    result = []
    for held in groups:
        alone = source.repeated or source.interleaved or len(units) >= MIN_CLUSTERS
        beside = set() if alone else _neighbours(source, held)
        training = tuple(n for n in range(len(source.clusters)) if n not in held and n not in beside)
        result.append(Fold(tuple(held), training))
    return result


def _in_turn(numbers: NDArray[np.int_], folds: int) -> list[NDArray[np.int_]]:
    """Interleaved folds, randomised within every group of neighbours: alternating conditions would fill one fold."""
    rng = np.random.default_rng(0)
    drawn = np.concatenate([rng.permutation(folds) for _ in range(0, numbers.size, folds)])[: numbers.size]
    return [numbers[drawn == fold] for fold in range(folds)]


def _neighbours(source: Source, held: Sequence[int]) -> set[int]:
    """Guard stretches: neighbours of the held-out ones on the same recording."""
    near = {number + step for number in held for step in (-1, 1)} - set(held)
    units = {source.clusters[number].unit for number in held}
    return {n for n in near if 0 <= n < len(source.clusters) and source.clusters[n].unit in units}


def hold_out(
    source: Source,
    effects: Sequence[Effect],
    chosen: Candidate,
    known: Mapping[tuple[str, ...], Candidate],
    budget: Budget = UNLIMITED,
) -> HoldOut | None:
    """Run the search on all but one fold in turn; None with too few clusters for a hold-out.

    Args:
        source: Measurements with the model's predictions.
        effects: Effects to consider.
        chosen: Effects that the search of all clusters found.
        known: Results of its fits, by names of effects (:attr:`Search.ended`).
        budget: Processor time, in equal shares for all folds; it lists what a fold does not try.
    """
    folds = folds_of(source)
    if not folds:
        return None
    searched = [
        not budget.leaves_out("the searches of the hold-out")
        and _seen_by(chosen, fold.training) >= MIN_CLUSTERS_OF_EFFECT
        and Evidence.of(source, fold.training).null.shortage is None
        for fold in folds
    ]
    tasks = list(zip(folds, searched, strict=True))
    limit = budget.remaining / len(folds)
    task = partial(_predicted, effects, chosen, dict(known), limit, budget)
    names, fitted, left, left_out = zip(*source.spread(task, tasks, HOLD_OUT), strict=True)
    rest = {n: own for fold, every in zip(folds, left, strict=True) for n, own in zip(fold.held, every, strict=True)}
    failed = tuple(sorted(number for number, own in rest.items() if own is None))
    ordered = tuple(item.mean if (own := rest[n]) is None else own for n, item in enumerate(source.clusters))
    if any(left_out):
        budget.add(f"all of the search in {sum(map(bool, left_out))} of {len(folds)} folds of the hold-out")
    return HoldOut(tuple(folds), ordered, names, tuple(searched), failed, fitted)


def _seen_by(chosen: Candidate, clusters: Sequence[int]) -> int:
    """Smallest number of clusters that depend on a chosen effect, over the chosen effects."""
    return min(sum(bool(np.any(chosen.jacobians[number][:, part])) for number in clusters) for _, part in chosen.parts)


def _predicted(
    effects: Sequence[Effect],
    chosen: Candidate,
    known: Mapping[tuple[str, ...], Candidate],
    limit: float,
    whole: Budget,
    source: Source,
    task: tuple[Fold, bool],
) -> tuple[tuple[str, ...], Added, list[Array | None], tuple[str, ...]]:
    """Effects selected without a fold, with their estimates, and what they predict of it.

    Returns:
        Names, effects with estimates, mean residuals of its clusters (None: not simulated), and what was not tried.
    """
    fold, searched = task
    budget = Budget(limit, whole.clock, whole.stop)
    evidence = Evidence.of(source, fold.training, budget)
    search = Search(effects, evidence, known=known, earlier=chosen.split(chosen.point))
    found = search.forward_selection() if searched else search.fitted(chosen.names)
    if found is not None and searched:
        found, _ = search.exchange(found)
    added: Added = () if found is None else found.candidate.split(found.estimate)
    rest = held_out_residuals(source, added, fold.held)
    return () if found is None else found.candidate.names, added, rest, tuple(budget.left_out)


def held_out_residuals(source: Source, added: Added, held: Sequence[int]) -> list[Array | None]:
    """Mean residuals of held-out clusters with effects, ``(F,)`` each [-]; None: they cannot be simulated there.

    Repeats differ in slip: each is predicted from its own start.
    """
    found = [source.residuals_with(added, [source.clusters[number]]) for number in held]
    return [None if own is None else own[0].mean for own in found]
