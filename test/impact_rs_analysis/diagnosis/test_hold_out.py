# SPDX-License-Identifier: Apache-2.0
"""What is held out is seen by nothing that predicts it: neither the shortlist, nor the choice, nor the estimate."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_world import EFFECTS, TIPPING, AnalyticSource

from impact_rs_analysis.diagnosis.candidate import Candidate
from impact_rs_analysis.diagnosis.fit import Evidence
from impact_rs_analysis.diagnosis.hold_out import folds_of, hold_out
from impact_rs_analysis.diagnosis.search import Search
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_analysis.evidence.runs import read_runs
from impact_rs_analysis.evidence.store import ReplayStore
from impact_rs_sim.effects import Effect, library
from impact_rs_sim.model import load_model
from impact_rs_trials.workers import _packed, _work

pytestmark = pytest.mark.usefixtures("few_draws")


def test_every_condition_is_held_out_once_with_all_its_repeats() -> None:
    folds = folds_of(AnalyticSource(0, design=(2, 3, 2, 4)))
    assert sorted(number for fold in folds for number in fold.held) == [0, 1, 2, 3]
    assert all(set(fold.held) | set(fold.training) == {0, 1, 2, 3} for fold in folds)


def test_with_many_conditions_there_are_no_more_than_six_folds() -> None:
    folds = folds_of(AnalyticSource(0, design=(2,) * 11))
    assert len(folds) == 6
    assert sorted(number for fold in folds for number in fold.held) == list(range(11))


def test_two_conditions_hold_nothing_out() -> None:
    assert folds_of(AnalyticSource(0, design=(3, 3))) == []


def test_stretches_of_one_recording_are_predicted_without_those_that_touch_them() -> None:
    folds = folds_of(AnalyticSource(0, design=(1,) * 24, repeated=False))
    assert len(folds) == 6
    for fold in folds:
        assert not {n + step for n in fold.held for step in (-1, 1)} & set(fold.training)
        assert list(fold.held) == list(range(fold.held[0], fold.held[0] + 4))


def ended(source: AnalyticSource, effects: Sequence[Effect]) -> Mapping[tuple[str, ...], Candidate]:
    """Where the fits of the search over all clusters end."""
    search = Search.screened(effects, Evidence.of(source))
    search.choose()
    return search.ended


@pytest.mark.parametrize("begun", [False, True], ids=["from_nothing", "where_the_search_ended"])
@pytest.mark.parametrize("number", range(6))
def test_what_happens_in_a_held_out_cluster_changes_nothing_of_what_it_is_predicted_from(
    number: int, begun: bool
) -> None:
    """Spoil one cluster: its prediction stays the same, and so does the choice of its fold."""
    truth = (("straight", (4.0,)),)
    effects = [EFFECTS[name] for name in ("straight", "bent", "payload")]
    honest, spoiled = AnalyticSource(1, truth), AnalyticSource(1, truth)
    rows = spoiled.clusters[number].residuals
    rows += 50.0 * np.random.default_rng(number).standard_normal(rows.shape[1])
    first, second = (
        hold_out(source, effects, ended(source, effects) if begun else None) for source in (honest, spoiled)
    )
    assert first is not None and second is not None
    fold = next(index for index, fold in enumerate(first.folds) if number in fold.held)
    assert first.chosen[fold] == second.chosen[fold] == ("straight",)
    predicted = [
        source.clusters[number].mean - found.rest[number] for source, found in ((honest, first), (spoiled, second))
    ]
    np.testing.assert_allclose(predicted[0], predicted[1], atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "values"),
    [(EFFECTS["bent"], (9.0,)), (EFFECTS["inverse"], (2.5,)), (TIPPING, (2.0, 9.0)), (EFFECTS["payload"], (3.0, 2.0))],
    ids=lambda given: given.name if isinstance(given, Effect) else "",
)
def test_folds_that_begin_where_the_search_ended_predict_like_those_from_nothing_with_less_work(
    effect: Effect, values: tuple[float, ...]
) -> None:
    source = AnalyticSource(3, ((effect.name, values),), design=(3,) * 8)
    effects = [effect, EFFECTS["straight"], EFFECTS["of_motors"]]
    known, work, found = ended(source, effects), [], []
    before = set(source.asked)  # what was predicted once is known
    for start in (None, known):
        source.asked.clear()
        found.append(hold_out(source, effects, start))
        work.append(len(set(source.asked) - before))
    cold, warm = found
    assert cold is not None and warm is not None
    assert cold.chosen == warm.chosen
    assert set(warm.chosen) == {(effect.name,)}
    np.testing.assert_allclose(np.mean(warm.errors), np.mean(cold.errors), rtol=0.05)
    assert work[1] < 0.8 * work[0]


def test_what_only_a_held_out_cluster_tells_is_not_known_where_its_fold_begins() -> None:
    """A parameter that nothing else sees is where it does nothing, although the search over all has found it."""
    source = AnalyticSource(4, (("local", (5.0, 8.0)),))
    effects = [EFFECTS["local"], EFFECTS["straight"]]
    known = ended(source, effects)
    assert known["local",].point[1] == pytest.approx(8.0, abs=0.5)
    cold, warm = hold_out(source, effects), hold_out(source, effects, known)
    assert cold is not None and warm is not None
    np.testing.assert_allclose(warm.rest[0], cold.rest[0], atol=1e-6)
    assert warm.errors[0] > 10.0 * warm.errors[1:].max()


def test_fitting_noise_does_not_lower_the_error_on_unseen_clusters() -> None:
    worse = 0
    for seed in range(10):
        source = AnalyticSource(seed)
        found = hold_out(source, [EFFECTS[name] for name in ("of_joints", "of_motors", "straight")])
        assert found is not None
        before = np.mean([item.error for item in source.clusters])
        worse += found.errors.mean() >= before - 1e-12
    assert worse == 10


def test_a_true_effect_lowers_the_error_on_unseen_clusters_to_that_of_noise() -> None:
    source = AnalyticSource(2, (("of_joints", tuple(2.0 * (-1.0) ** j for j in range(7))),))
    found = hold_out(source, [EFFECTS[name] for name in ("of_joints", "of_motors", "straight")])
    assert found is not None
    assert all(names == ("of_joints",) for names in found.chosen)
    expected = np.mean([item.expected for item in source.clusters])
    assert found.errors.mean() < 2.0 * expected
    assert np.mean([item.error for item in source.clusters]) > 20.0 * expected


def test_a_fold_in_another_process_finds_the_friction_that_it_finds_here(
    hidden_campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def elsewhere(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        return (_work(_packed(function, item)) for item in items)

    runs, effects = read_runs(hidden_campaign, map), [library()["support_friction"]]
    here, there = (
        hold_out(ReplaySource.of(runs, load_model("nominal"), ReplayStore(way)), effects) for way in (map, elsewhere)
    )
    assert here is not None and there is not None
    np.testing.assert_array_equal(there.errors, here.errors)
    assert there.chosen == here.chosen
    assert ("support_friction",) in here.chosen
