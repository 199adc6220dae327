# SPDX-License-Identifier: Apache-2.0
"""What is held out is seen by nothing that predicts it: neither the shortlist, nor the choice, nor the estimate."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from analytic_world import EFFECTS, FEATURES, AnalyticSource, Slipping

from impact_rs_analysis.diagnosis.search import effect_selection as search
from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.search.hold_out import HoldOut, folds_of, hold_out
from impact_rs_analysis.diagnosis.verdicts import model_verdict
from impact_rs_analysis.evidence.cluster import Added, Cluster
from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.effects import Effect, library
from impact_rs_sim.model import load_model
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.workers import _packed, _work


@pytest.mark.parametrize(("design", "count"), [((2, 3, 2, 4), 4), ((2,) * 11, 6)])
def test_every_condition_is_held_out_once_in_at_most_six_folds(design: tuple[int, ...], count: int) -> None:
    folds, all_of_them = folds_of(AnalyticSource(0, design=design)), set(range(len(design)))
    assert len(folds) == count
    assert sorted(number for fold in folds for number in fold.held_out) == sorted(all_of_them)
    assert all(set(fold.held_out) | set(fold.training) == all_of_them for fold in folds)


def test_two_conditions_hold_nothing_out() -> None:
    assert folds_of(AnalyticSource(0, design=(3, 3))) == []


def test_stretches_of_a_recording_are_predicted_without_their_neighbours() -> None:
    folds = folds_of(AnalyticSource(0, design=(1,) * 24, repeated=False))
    assert len(folds) == 6
    for fold in folds:
        assert not {n + step for n in fold.held_out for step in (-1, 1)} & set(fold.training)
        assert list(fold.held_out) == list(range(fold.held_out[0], fold.held_out[0] + 4))


@pytest.mark.parametrize("lengths", [(6, 6, 6, 6), (3, 4, 3, 4, 3), (20, 1, 3)])
def test_where_a_recording_alone_shows_a_joint_every_fold_leaves_a_part_of_it(lengths: tuple[int, ...]) -> None:
    """Kills folds that hold out whole recordings, and guards beyond the end of a recording."""
    source = AnalyticSource(0, design=(1,) * sum(lengths), repeated=False)
    units = [f"recording {number}" for number, length in enumerate(lengths) for _ in range(length)]
    source.clusters = tuple(replace(item, unit=unit) for item, unit in zip(source.clusters, units, strict=True))
    source.whole_units = False
    folds = folds_of(source)
    assert sorted(number for fold in folds for number in fold.held_out) == list(range(len(units)))
    for fold in folds:
        left_out = set(range(len(units))) - set(fold.held_out) - set(fold.training)
        touching = {n + step for n in fold.held_out for step in (-1, 1) if 0 <= n + step < len(units)}
        assert left_out == {
            n
            for n in touching - set(fold.held_out)
            if any(units[n] == units[m] for m in fold.held_out if abs(n - m) == 1)
        }
        for unit, length in zip(dict.fromkeys(units), lengths, strict=True):
            if length > 3:
                assert unit in {units[n] for n in fold.training}


def errors_of(found: HoldOut) -> Array:
    """Mean square scaled error by cluster."""
    return np.array([np.mean(np.square(values)) for values in found.residuals])


def held_out(source: Source, effects: Sequence[Effect], from_known: bool = True) -> HoldOut:
    evidence = Evidence.of(source)
    search = Search(effects, evidence)
    chosen = search.forward_selection()
    first = linearise(Candidate.of((effects[0],), source), evidence.clusters, evidence.numbers, source)
    candidate = first if chosen is None else chosen.candidate
    assert candidate is not None
    found = hold_out(source, effects, candidate, search.optima if from_known else {})
    assert found is not None
    return found


def error_of(source: AnalyticSource) -> float:
    return float(np.mean([item.error for item in source.clusters]))


WORLD = (("straight", (4.0,)),)
CONSIDERED = [EFFECTS[name] for name in ("straight", "bent", "payload")]


@functools.cache
def honest() -> tuple[AnalyticSource, HoldOut]:
    source = AnalyticSource(1, WORLD)
    return source, held_out(source, CONSIDERED)


@pytest.mark.parametrize("number", range(6))
def test_what_a_held_out_cluster_holds_does_not_change_its_prediction(number: int) -> None:
    """Spoil one cluster: its prediction stays the same, and so does the choice of its fold."""
    spoiled = AnalyticSource(1, WORLD)
    spoiled.spoil(number, 50.0 * np.random.default_rng(number).standard_normal(FEATURES))
    found = honest(), (spoiled, held_out(spoiled, CONSIDERED))
    fold = next(index for index, fold in enumerate(found[0][1].folds) if number in fold.held_out)
    assert [held.chosen[fold] for _, held in found] == [("straight",)] * 2
    predicted = [source.clusters[number].mean - held.residuals[number] for source, held in found]
    np.testing.assert_allclose(*predicted, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_fold_ends_at_the_same_place_from_wherever_it_begins(seed: int) -> None:
    """From nominal, or from where the fit of all clusters ended: same effects, same predictions."""
    source = AnalyticSource(seed, (("bent", (5.0,)), ("straight", (4.0,))))
    cold, warm = (held_out(source, CONSIDERED, known) for known in (False, True))
    assert warm.chosen == cold.chosen
    np.testing.assert_allclose(
        np.concatenate(warm.residuals), np.concatenate(cold.residuals), atol=0.05
    )  # of the noise


@pytest.mark.parametrize("looked", [True, False])
def test_a_fold_that_is_stuck_looks_where_the_search_of_all_clusters_has_ended(
    looked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Joints that stick make small minima; without the look, and without a simplex, some fold ends in one."""
    source = AnalyticSource(8, (("stick_slip", (8.3, -6.1, 5.2)),))
    chosen = Search([EFFECTS["stick_slip"]], Evidence.of(source)).forward_selection()
    assert chosen is not None
    monkeypatch.setattr(search, "nelder_mead", lambda fitted: fitted)
    if not looked:
        monkeypatch.setattr(Search, "_from_earlier_estimates", lambda *_: None)
    elsewhere = {("straight",): chosen.candidate}  # no fit of these effects to begin at
    found = hold_out(source, [EFFECTS["stick_slip"]], chosen.candidate, elsewhere)
    assert found is not None
    expected = float(Evidence.of(source).expected.mean())
    assert bool(errors_of(found).mean() < 1.5 * expected) == looked


def test_what_only_a_held_out_cluster_shows_is_unknown_to_its_fold() -> None:
    """A parameter that nothing else sees is where it does nothing, although the search over all has found it."""
    source = AnalyticSource(4, (("local", (5.0, 8.0)),))
    effects = [EFFECTS["local"], EFFECTS["straight"]]
    chosen = Search(effects, Evidence.of(source)).forward_selection()
    assert chosen is not None and chosen.estimate[1] == pytest.approx(8.0, abs=0.5)
    errors = errors_of(held_out(source, effects))
    assert errors[0] > 10.0 * errors[1:].max()


def test_with_one_hit_left_a_fold_fits_what_all_data_have_chosen() -> None:
    """Two hits and a free motion: nothing can be chosen from a single hit, but it predicts the other one."""
    source = AnalyticSource(3, (("bent", (5.0,)),), design=(3, 3, 3), free=(2,))
    found = held_out(source, [EFFECTS["bent"]])
    assert found.searched == (False, False, True) and found.chosen[:2] == (("bent",), ("bent",))
    assert np.all(errors_of(found)[:2] < 0.1 * np.array([item.error for item in source.clusters[:2]]))


def test_a_fold_with_too_few_repeats_to_choose_fits_what_all_data_have_chosen() -> None:
    """Kills: a search of a fold in which no p-value can be small, which takes any effect that noise likes."""
    for design, searched in (((2, 2, 2), False), ((2, 2, 2, 2), True)):
        found = held_out(AnalyticSource(3, (("straight", (3.0,)),), design=design), [EFFECTS["straight"]])
        assert found.searched == (searched,) * len(design) and found.chosen == (("straight",),) * len(design)
        assert found.selected == (found.chosen if searched else ())


def test_a_condition_in_which_the_effects_cannot_be_simulated_is_one_that_they_fail(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Kills: such a condition counts as predicted."""
    source = AnalyticSource(3, (("straight", (3.0,)),))
    again = source.residuals_with

    def missed(added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        return None if added and [item.name for item in like] == ["2"] else again(added, like)

    monkeypatch.setattr(source, "residuals_with", missed)
    found = held_out(source, [EFFECTS["straight"]])
    assert found.failed == (2,)
    assert found.residuals[2] == pytest.approx(source.clusters[2].mean)


def test_fitting_noise_does_not_lower_the_error_on_unseen_clusters() -> None:
    effects = [EFFECTS[name] for name in ("of_joints", "of_motors", "straight")]
    for source in map(AnalyticSource, range(10)):
        assert errors_of(held_out(source, effects)).mean() >= error_of(source) - 1e-12


def test_a_true_effect_lowers_the_held_out_error_to_that_of_noise() -> None:
    source = AnalyticSource(2, (("of_joints", tuple(2.0 * (-1.0) ** j for j in range(7))),))
    found = held_out(source, [EFFECTS[name] for name in ("of_joints", "of_motors", "straight")])
    assert all(names == ("of_joints",) for names in found.chosen)
    expected = np.mean([item.expected for item in source.clusters])
    assert errors_of(found).mean() < 2.0 * expected
    assert error_of(source) > 20.0 * expected


def test_every_repeat_is_predicted_from_its_own_start() -> None:
    """A box that slips off to another side in every repeat: the first one does not stand for them."""
    source = Slipping(2, (("straight", (4.0,)),))
    found = held_out(source, [EFFECTS["straight"]])
    assert all(names == ("straight",) for names in found.chosen)
    assert errors_of(found).mean() < 2.0 * np.mean([item.expected for item in source.clusters])


def test_a_fold_in_another_process_finds_the_friction_that_it_finds_here(
    hidden_campaign: Path,
) -> None:

    def elsewhere(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        return (_work(_packed(function, item))[0] for item in items)

    runs, effects = read_runs(hidden_campaign, map), [library()["support_friction"]]
    here, there = (
        held_out(ReplaySource.of(runs, load_model("nominal"), ReplayCache(way)), effects) for way in (map, elsewhere)
    )
    np.testing.assert_array_equal(errors_of(there), errors_of(here))
    assert there.chosen == here.chosen
    assert ("support_friction",) in here.chosen


@pytest.mark.parametrize("names", [("one", "other"), ("other", "one")])
def test_the_order_of_effects_does_not_decide_which_are_supported(
    names: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is found in half of the folds, and the other is no replacement of it. Kills: it is once it was dropped."""

    def fit_of(*kept: str) -> SimpleNamespace:
        return SimpleNamespace(candidate=SimpleNamespace(names=kept))

    stub = SimpleNamespace(
        evidence=SimpleNamespace(source=SimpleNamespace(repeated=False), means=()),
        without=lambda chosen, name: fit_of(*(own for own in chosen.candidate.names if own != name)),
    )
    held = SimpleNamespace(failed=False, residuals=(), selected=(("one",),) * 3 + (("other",),) * 3)
    monkeypatch.setattr(model_verdict, "change_interval", lambda *_: (-2.0, -1.0))
    assert model_verdict.supported_by_hold_out(stub, fit_of(*names), held) is None
