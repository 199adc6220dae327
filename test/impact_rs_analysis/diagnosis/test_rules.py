# SPDX-License-Identifier: Apache-2.0
"""The rules that turn a fit into words, one by one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import documents
import numpy as np
import pytest
import scipy
from analytic_world import EFFECTS, FEATURES, TIPPING, AnalyticSource, knowing

from impact_rs_analysis.diagnosis.diagnose import _identifiability, diagnose
from impact_rs_analysis.diagnosis.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.hold_out import HoldOut
from impact_rs_analysis.diagnosis.scoring import held_against_truth
from impact_rs_analysis.diagnosis.search import Search, noticeable
from impact_rs_analysis.diagnosis.verdicts import Findings, _alike_at_joints, certain, change_interval, sizes_of
from impact_rs_sim.robot import Array


def fitted(source: AnalyticSource, *names: str, change: Array | None = None) -> Fit:
    """Effects together, linearised where they do nothing; with a change [parameter scales] in place of the best."""
    search = Search([EFFECTS[name] for name in names], Evidence.of(source))
    found = search.beside(None, names[0])
    for name in names[1:]:
        found = search.beside(found, name)
    return found if change is None else Fit(found.candidate, found.evidence, found.problem, change)


def test_a_change_of_the_error_has_the_interval_of_a_mean_over_conditions() -> None:
    """From 2 to 1 plus something small in every condition: the root mean square falls to 1 plus the mean of that."""
    source = AnalyticSource(1, design=(1,) * 6, repeated=False)
    small = 1e-3 * np.array([1.0, -2.0, 3.0, 0.0, 2.0, 4.0])
    before, after = 2.0 * np.ones((6, FEATURES)), (1.0 + small)[:, None] * np.ones((6, FEATURES))
    source.residual_weight = lambda item: 1.0  # type: ignore[assignment, method-assign, misc]
    found = change_interval(list(before), list(after), Evidence.of(source))
    expected = scipy.stats.t.interval(0.95, 5, loc=-1.0 + small.mean(), scale=scipy.stats.sem(small))
    assert found == pytest.approx(expected, abs=1e-5)


def test_an_estimate_at_the_value_where_it_does_nothing_is_at_no_bound() -> None:
    at = {
        value: fitted(AnalyticSource(1), "one_sided", change=np.array([value])).at_bound for value in (0.0, 9.0, 50.0)
    }
    assert {value: bool(found[0]) for value, found in at.items()} == {0.0: False, 9.0: False, 50.0: True}


def test_what_stops_at_a_bound_is_not_noticeable() -> None:
    """Its interval means nothing there."""
    source = AnalyticSource(1, repeated=False)
    source.least_change = 0.1  # type: ignore[misc]
    assert noticeable(fitted(source, "one_sided", change=np.array([49.0])))
    assert not noticeable(fitted(source, "one_sided", change=np.array([50.0])))


def test_an_effect_is_certain_where_one_interval_leaves_out_nothing() -> None:
    """The lever of a payload is a shape: it says where the payload is, not whether it is there."""
    source = AnalyticSource(1, (("payload", (3.0, 0.5)),))
    best = fitted(source, "payload")
    half = best.half_widths
    assert certain(best, "payload")
    for mass, expected in ((1.1, True), (-1.1, True), (0.9, False)):
        moved = Fit(best.candidate, best.evidence, best.problem, np.array([mass * half[0], 9.0]))
        assert certain(moved, "payload") == expected


def test_estimates_that_move_against_each_other_are_listed() -> None:
    """Two parameters do nearly the same: what one gets more, the other gets less."""
    found = fitted(AnalyticSource(1), "twin_of_straight")
    alike = tuple(np.stack((j[:, 0], j[:, 0] + 0.2 * j[:, 1]), axis=1) for j in found.candidate.jacobians)
    (pair,) = _identifiability(Fit.of(replace(found.candidate, jacobians=alike), found.evidence)).correlated
    assert {pair.first, pair.second} == {"c", "c_2"} and pair.correlation < -0.8


def test_what_an_effect_moves_is_listed_from_the_most_noticeable_on() -> None:
    source = AnalyticSource(1)
    found = fitted(source, "straight", change=np.array([5.0]))
    limits = {f"signal {number}": limit for number, limit in enumerate((0.1, 3.0, 0.3, 1.0))}
    labels = tuple(replace(feature, relevance_limit=limits[feature.signal]) for feature in source.clusters[0].features)
    clusters = tuple(replace(item, features=labels) for item in found.evidence.clusters)
    sizes = sizes_of(replace(found, evidence=replace(found.evidence, clusters=clusters)), "straight")
    assert [size.value / size.floor for size in sizes] == sorted((s.value / s.floor for s in sizes), reverse=True)
    assert sizes[0].signal == "signal 0"


@pytest.mark.parametrize(("without", "tied"), [(0, ()), (3, ()), (4, ("bent",)), (6, ("bent",))])
def test_an_effect_is_confusable_with_what_replaces_it_in_most_folds(without: int, tied: tuple) -> None:
    chosen = (("bent", "payload"),) * without + (("straight", "payload"),) * (6 - without)
    hold_out = HoldOut((), np.zeros(0), (), chosen)
    names: Any = SimpleNamespace(candidate=SimpleNamespace(names=("straight", "payload")))
    nothing: Any = None
    assert Findings(nothing, names, (), hold_out, {}).tied_with("straight") == tied


@pytest.mark.parametrize(("verdict", "correct"), [("NOTHING-MISSING", True), ("PRESENT-BUT-SMALL", False)])
def test_where_nothing_is_hidden_only_nothing_missing_is_right(tmp_path: Path, verdict: str, correct: bool) -> None:
    (tmp_path / "truth.json").write_text(json.dumps({"kind": "null", "effects": []}))
    document = documents.diagnosis("minimal").model_copy(update={"verdict": verdict})
    found = held_against_truth(tmp_path, document)
    assert (found.correct, found.headline) == (correct, correct)


def test_an_effect_is_identified_where_one_of_its_parameters_is() -> None:
    """How high the weight of a box lies hardly moves anything until it tips; that it is pushed is clear."""
    source = knowing(AnalyticSource(1, (("tipping", (5.0, 0.0)),), design=(2,) * 3), TIPPING)
    (effect,) = diagnose(source, source.model).effects
    low, high = effect.parameters["height"].interval
    assert low < -4.0 and high > 4.0
    assert effect.parameters["g"].interval[1] - effect.parameters["g"].interval[0] < 1.0
    assert effect.verdict == "CONFIRMED"


@pytest.mark.parametrize(
    ("joints", "rivals"),
    [
        (["CONFIRMED", "CONFUSABLE-WITH{link_mass}"], ()),
        (["NO-IMPROVEMENT", None], ()),
        (["CONFUSABLE-WITH{link_inertia, link_mass}", "NO-IMPROVEMENT", "CONFUSABLE-WITH{link_mass}"], ("link_mass",)),
        (["CONFUSABLE-WITH{link_mass}", "CONFUSABLE-WITH{torque_gain}"], ("link_mass", "torque_gain")),
    ],
)
def test_an_effect_is_no_surer_than_the_surest_of_its_joints(joints: list[str | None], rivals: tuple[str, ...]) -> None:
    assert _alike_at_joints(joints) == rivals
