# SPDX-License-Identifier: Apache-2.0
"""Nested cross-validation (hold-out): every cluster is predicted by a search without it.

Held-out data influence neither shortlist, nor selection, nor estimate of the effects that predict them. For every fold
the whole search (:mod:`impact_rs_analysis.diagnosis.search.effect_selection`) runs on the training clusters, and the
model with the selected effects predicts the fold. To save simulations, fits of a fold start at the optimum of all
clusters; they end at the optimum of the training clusters. Fits of impacts start at nominal: they are cheap, and
secants from other points mislead if contacts slip.

A search needs two clusters that depend on an effect, to predict one from the other, and as many repeats as any verdict.
With fewer, or without processor time, a fold only fits the effects selected in all clusters and does not test their
selection.

Conditions are held out with all their repeats, several recordings as whole recordings, and a single recording in groups
of neighbouring stretches, with a guard stretch on either side. Where a joint moves in one recording alone, no other
recording predicts it (``Source.whole_units``): folds take such a group from every recording. If effects may depend on
covariates (``Source.interleaved``), folds are interleaved, with one of every six neighbours each: a session of
neighbouring rows in one fold could not be predicted from the other sessions.
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
    """Clusters that are held out together, and the clusters that predict them.

    Attributes:
        held_out: Indices of the predicted clusters.
        training: Indices of the clusters of the search.
    """

    held_out: tuple[int, ...]
    training: tuple[int, ...]


@dataclass(frozen=True)
class HoldOut:
    """Held-out errors.

    Attributes:
        folds: The folds.
        residuals: Mean held-out residuals, ``(F,)`` per cluster [-].
        chosen: Names of the effects that predict each fold.
        searched: By fold, whether a search of the training clusters selected the effects; else they were only fitted,
            because the training clusters have too few conditions or repeats for a search.
        failed: Indices of the clusters in which the effects of the fold cannot be simulated, such as a hit predicted to
            miss; their ``residuals`` are residuals of the model.
        added: The effects that predict each fold, with their estimates.
    """

    folds: tuple[Fold, ...]
    residuals: tuple[Array, ...]
    chosen: tuple[tuple[str, ...], ...]
    searched: tuple[bool, ...]
    failed: tuple[int, ...] = ()
    added: tuple[Added, ...] = ()

    @property
    def selected(self) -> tuple[tuple[str, ...], ...]:
        """Names of the effects that each search of a fold selected; folds without a search are omitted."""
        return tuple(names for names, was_searched in zip(self.chosen, self.searched, strict=True) if was_searched)


def folds_of(source: Source) -> list[Fold]:
    """Folds of a source; empty with too few clusters for a hold-out."""
    units: dict[str, list[int]] = {}
    for number, item in enumerate(source.clusters):
        units.setdefault(item.unit, []).append(number)
    groups: list[list[int]]
    independent = source.repeated or source.interleaved or holds_out_units(source)
    if holds_out_units(source):
        clusters_of_units = list(units.values())
        count = min(source.folds, len(clusters_of_units))
        groups = [[number for owner in clusters_of_units[start::count] for number in owner] for start in range(count)]
    elif source.repeated:
        return []
    elif source.interleaved:
        groups = _interleaved(np.arange(len(source.clusters)), source.folds)
    elif source.whole_units:
        groups = [part.tolist() for part in np.array_split(np.arange(len(source.clusters)), source.folds)]
    else:
        groups = _parts_of_units(list(units.values()), source.folds)
    folds = []
    for held_out in groups:
        guards = set() if independent else _guard_stretches(source, held_out)
        training = tuple(n for n in range(len(source.clusters)) if n not in held_out and n not in guards)
        folds.append(Fold(tuple(held_out), training))
    return folds


def holds_out_units(source: Source) -> bool:
    """Whether folds are whole units: conditions, or recordings."""
    return source.whole_units and len({item.unit for item in source.clusters}) >= MIN_CLUSTERS


def _interleaved(numbers: NDArray[np.int_], folds: int) -> list[list[int]]:
    """Interleaved folds, randomised within every group of neighbours: alternating conditions would fill one fold."""
    rng = np.random.default_rng(0)
    drawn = np.concatenate([rng.permutation(folds) for _ in range(0, numbers.size, folds)])[: numbers.size]
    return [numbers[drawn == fold].tolist() for fold in range(folds)]


def _parts_of_units(units: Sequence[Sequence[int]], folds: int) -> list[list[int]]:
    """Folds of neighbours from every unit; short units have fewer parts than there are folds."""
    groups: list[list[int]] = [[] for _ in range(folds)]
    first = 0
    for numbers in units:
        parts = np.array_split(numbers, min(folds, len(numbers)))
        for position, part in enumerate(parts, start=first):
            groups[position % folds] += part.tolist()
        first += len(parts)
    return [group for group in groups if group]


def _guard_stretches(source: Source, held_out: Sequence[int]) -> set[int]:
    """Guard stretches: neighbours of the held-out ones on the same recording."""
    clusters = source.clusters
    return {
        neighbour
        for number in held_out
        for neighbour in (number - 1, number + 1)
        if 0 <= neighbour < len(clusters) and clusters[neighbour].unit == clusters[number].unit
    } - set(held_out)


def hold_out(
    source: Source,
    effects: Sequence[Effect],
    chosen: Candidate,
    optima: Mapping[tuple[str, ...], Candidate],
    budget: Budget = UNLIMITED,
) -> HoldOut | None:
    """Run the search on all but one fold in turn; None with too few clusters for a hold-out.

    Args:
        source: Measurements with the model's predictions.
        effects: Effects to consider.
        chosen: Effects selected in all clusters.
        optima: Starts of fits, by names of effects (:attr:`Search.optima` of all clusters).
        budget: Processor time, in equal shares for all folds; steps that a fold does not try are listed in it.
    """
    folds = folds_of(source)
    if not folds:
        return None
    searched = [
        not budget.leaves_out("the searches of the hold-out")
        and _clusters_that_depend(chosen, fold.training) >= MIN_CLUSTERS_OF_EFFECT
        and Evidence.of(source, fold.training).null.shortage is None
        for fold in folds
    ]
    tasks = list(zip(folds, searched, strict=True))
    limit = budget.remaining / len(folds)
    task = partial(_predict_fold, effects, chosen, dict(optima), limit, budget)
    names, added, residuals, left_out = zip(*source.distribute(task, tasks, HOLD_OUT), strict=True)
    residual_of = {
        n: residual
        for fold, fold_residuals in zip(folds, residuals, strict=True)
        for n, residual in zip(fold.held_out, fold_residuals, strict=True)
    }
    failed = tuple(sorted(number for number, residual in residual_of.items() if residual is None))
    ordered = tuple(
        item.mean if (residual := residual_of[n]) is None else residual for n, item in enumerate(source.clusters)
    )
    if any(left_out):
        budget.add(f"steps of the search in {sum(map(bool, left_out))} of {len(folds)} folds of the hold-out")
    return HoldOut(tuple(folds), ordered, names, tuple(searched), failed, added)


def _clusters_that_depend(chosen: Candidate, clusters: Sequence[int]) -> int:
    """Smallest number of clusters that depend on a chosen effect, over the chosen effects."""
    return min(sum(bool(np.any(chosen.jacobians[number][:, part])) for number in clusters) for _, part in chosen.parts)


def _predict_fold(
    effects: Sequence[Effect],
    chosen: Candidate,
    optima: Mapping[tuple[str, ...], Candidate],
    limit: float,
    shared_budget: Budget,
    source: Source,
    task: tuple[Fold, bool],
) -> tuple[tuple[str, ...], Added, list[Array | None], tuple[str, ...]]:
    """Effects selected without a fold, with their estimates, and the residuals of the fold.

    Returns:
        Names, effects with estimates, mean residuals of the fold (None: not simulated), and steps that were not tried.
    """
    fold, searched = task
    budget = Budget(limit, shared_budget.clock, shared_budget.stop)
    evidence = Evidence.of(source, fold.training, budget)
    search = Search(effects, evidence, full_data_optima=optima, earlier=chosen.effects_at(chosen.point))
    fitted = search.forward_selection() if searched else search.fitted(chosen.names)
    if fitted is not None and searched:
        fitted, _ = search.exchange(fitted)
    added: Added = () if fitted is None else fitted.candidate.effects_at(fitted.estimate)
    residuals = held_out_residuals(source, added, fold.held_out)
    return () if fitted is None else fitted.candidate.names, added, residuals, tuple(budget.left_out)


def held_out_residuals(source: Source, added: Added, held_out: Sequence[int]) -> list[Array | None]:
    """Mean residuals of held-out clusters with effects, ``(F,)`` each [-]; None: a cluster cannot be simulated.

    Repeats differ in slip, so each is predicted from its measured start.
    """
    predictions = [source.residuals_with(added, [source.clusters[number]]) for number in held_out]
    return [None if clusters is None else clusters[0].mean for clusters in predictions]
