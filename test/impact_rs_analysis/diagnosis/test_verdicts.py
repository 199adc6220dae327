# SPDX-License-Identifier: Apache-2.0
"""What is said, rule by rule, and that the way it is said does not depend on how large an effect is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import documents
import numpy as np
import pytest
import scipy
from analytic_world import EFFECTS, FEATURES, TIPPING, AnalyticSource, direction, knowing, means_of
from intervals import assert_covers

from impact_rs_analysis.diagnosis.diagnose import _identifiability, diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument
from impact_rs_analysis.diagnosis.scoring import held_against_truth
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence, Fit
from impact_rs_analysis.diagnosis.search.hold_out import HoldOut, hold_out
from impact_rs_analysis.diagnosis.verdict import NOTHING, DiagnosisVerdict
from impact_rs_analysis.diagnosis.verdicts.effect_verdicts import _alike_at_joints, undetermined
from impact_rs_analysis.diagnosis.verdicts.model_verdict import (
    change_interval,
    excludes_nominal,
    reported_p,
)
from impact_rs_analysis.diagnosis.verdicts.residuals import residual_size, residuals_by_signal
from impact_rs_analysis.diagnosis.verdicts.words import not_excluded
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array


def said(source: AnalyticSource, *names: str) -> DiagnosisDocument:
    knowing(source, *(EFFECTS[name] for name in names or ("straight", "bent", "payload")))
    return diagnose(source, source.model)


def effect(document: DiagnosisDocument, name: str) -> EffectDocument:
    found = document.effect(name)
    assert found is not None
    return found


def test_nothing_is_missing_and_one_is_what_repetition_gives() -> None:
    """Over 20 campaigns the error of a right model is 1 on average, and the verdict says so in nearly all."""
    documents = [said(AnalyticSource(seed)) for seed in range(20)]
    assert np.mean([d.held_out_error_before for d in documents]) == pytest.approx(1.0, abs=0.05)
    assert all(d.noise_floor == 1.0 for d in documents)
    assert sum(str(d.verdict) == "NOTHING-MISSING" for d in documents) >= 18


@pytest.mark.parametrize("spoiled", ["failed", "residuals"])
def test_only_what_the_hold_out_supports_is_named(spoiled: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches without the data that they predict must predict them better, and all of them.

    Kills: what cannot be simulated in a condition counts as predicted by the model.
    """

    def unsupported(source: AnalyticSource, *given: Any) -> HoldOut | None:
        found = hold_out(source, *given)
        assert found is not None
        if spoiled == "residuals":
            return replace(found, residuals=tuple(item.mean for item in source.clusters))
        return replace(found, failed=(2,))

    source = AnalyticSource(1, (("straight", (5.0,)),))
    assert said(source).named == ("straight",)
    monkeypatch.setattr("impact_rs_analysis.diagnosis.diagnose.hold_out", unsupported)
    document = said(source)
    assert document.named == () and str(document.verdict) == "NONE-EXPLAINS"
    assert document.held_out_error_after == document.held_out_error_before
    assert document.suspected == ()
    assert any(remark.startswith("not named") and "straight" in remark for remark in document.remarks)


@pytest.mark.parametrize("repeated", [True, False])
def test_a_lower_error_on_unseen_data_is_enough_with_repeats_alone(
    repeated: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: the interval of the change, which asks for twice the effect, or a majority of the folds."""

    def hardly(source: AnalyticSource, *given: Any) -> HoldOut | None:
        found = hold_out(source, *given)
        rest = tuple(item.mean * (0.9 if number == 0 else 1.0) for number, item in enumerate(source.clusters))
        return found and replace(found, residuals=rest, **({"chosen": (("straight",), *((),) * 5)} if repeated else {}))

    monkeypatch.setattr("impact_rs_analysis.diagnosis.diagnose.hold_out", hardly)
    source = AnalyticSource(1, (("straight", (5.0,)),), design=(3,) * 6 if repeated else (1,) * 24, repeated=repeated)
    assert said(source).named == (("straight",) if repeated else ())


def test_without_repeats_the_effect_that_folds_do_not_find_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def one_of_them(source: AnalyticSource, *given: Any) -> HoldOut | None:
        found = hold_out(source, *given)
        return found and replace(found, chosen=(("straight", "payload"),) * 3 + (("straight",),) * 3)

    source = AnalyticSource(1, (("straight", (5.0,)), ("payload", (3.0, 0.5))), design=(1,) * 24, repeated=False)
    assert set(said(source).named) == {"straight", "payload"}
    monkeypatch.setattr("impact_rs_analysis.diagnosis.diagnose.hold_out", one_of_them)
    assert said(source).named == ("straight",)


@pytest.mark.parametrize("value", [1.0, 5.0, 40.0])
def test_the_headline_is_the_effect_however_large_it_is(value: float) -> None:
    document = said(AnalyticSource(1, (("straight", (value,)),)))
    assert str(document.verdict) == "straight" and document.named == ("straight",)
    found = document.effects[0]
    assert str(found.verdict) == "CONFIRMED" and found.chosen_in_folds == 6
    assert_covers(found.parameters["a"].interval, value, 2.67 / np.sqrt(18.0 * FEATURES))
    assert document.held_out_error_after < 1.5
    assert found.sizes[0].value > found.sizes[0].floor


def test_folds_that_were_not_searched_do_not_count_as_folds_that_missed_an_effect() -> None:
    """Kills: found in 0 of 3 folds, which two contrasts cannot search."""
    document = said(AnalyticSource(1, (("straight", (5.0,)),), design=(2, 2, 2)))
    assert document.named == ("straight",) and document.effects[0].chosen_in_folds is None
    assert (document.hold_out.folds, document.hold_out.searched) == (3, 0)


def test_p_is_a_bound_where_noise_is_not_known() -> None:
    document = said(AnalyticSource(1, (("straight", (40.0,)),)))
    assert document.design.least_p == reported_p(1e-6) == 0.0005
    assert document.lack_of_fit.before == pytest.approx(0.001)  # of 999 draws
    assert document.effects[0].p_value == 0.0005


def test_what_is_significant_and_too_small_to_matter_is_said_with_its_size() -> None:
    """60 repeats see a tenth of the noise; the relevance limit is larger than all that it moves."""
    document = said(AnalyticSource(2, (("straight", (0.06,)),), design=(60,) * 8))
    assert str(document.verdict) == "PRESENT-BUT-SMALL" and document.named == ("straight",)
    assert str(document.effects[0].verdict) == "PRESENT-BUT-SMALL"
    assert "m/s" in document.summary and "at most" in document.summary


def test_what_explains_most_is_named_and_the_rest_given_in_units() -> None:
    document = said(AnalyticSource(3, (("straight", (20.0,)), ("outside", (5.0,)))))
    assert str(document.verdict) == "PARTLY{straight}" and document.named == ("straight",)
    assert document.unexplained.share_of_excess == pytest.approx(25.0 / 425.0, rel=0.5)
    rest = document.unexplained.where[0]
    assert rest.unit == "m/s" and rest.value > rest.floor


def test_a_rest_is_partly_unexplained_where_it_is_both_significant_and_relevant() -> None:
    """Sixty repeats see a rest of no relevance; two repeats leave one by chance. Kills: one of both alone."""
    small = said(AnalyticSource(2, (("straight", (5.0,)), ("outside", (0.1,))), design=(60,) * 8))
    assert small.lack_of_fit.after is not None and small.lack_of_fit.after < 0.01
    chance = said(AnalyticSource(2, (("straight", (5.0,)),), design=(2,) * 3))
    assert any(rest.value > rest.floor for rest in chance.unexplained.where)
    assert str(small.verdict) == str(chance.verdict) == "straight"


def test_an_effect_whose_size_may_be_nothing_has_no_size_although_it_predicts() -> None:
    """3, 2 and 1 in three conditions: 2 +- 4.3 / sqrt(3). Kills: an effect is confirmed whatever its interval holds."""
    found = effect(said(changing(1, (3.0, 2.0, 1.0)), "straight"), "straight")
    assert_covers(found.parameters["a"].interval, 0.0, 4.3 / np.sqrt(3.0))
    assert str(found.verdict) == "NOT-IDENTIFIABLE"


@pytest.mark.parametrize(
    ("outside", "verdict"), [(0.0, "straight"), (1.0, "straight"), (5.0, "PARTLY{straight}"), (30.0, "NONE-EXPLAINS")]
)
def test_without_repeats_the_headline_follows_from_what_is_left_beyond_noise(outside: float, verdict: str) -> None:
    """As in recordings, of which a residual above twice the noise needs a cause."""
    truth = (("straight", (20.0,)), ("outside", (outside,)))
    document = said(AnalyticSource(3, truth, design=(1,) * 16, repeated=False))
    assert document.named == ("straight",) and str(document.verdict) == verdict


def test_what_the_scale_of_a_torque_may_explain_needs_no_further_effect() -> None:
    """The same residual is none of a signal whose calibration is uncertain by as much."""
    source = AnalyticSource(3, (("straight", (20.0,)), ("outside", (5.0,))), design=(1,) * 16, repeated=False)
    unsure = tuple(replace(item, calibrations=np.full((1, FEATURES), 5.0) / item.sigma) for item in source.clusters)
    source.clusters = unsure
    assert str(said(source).verdict) == "straight"


def test_what_nothing_explains_is_said() -> None:
    document = said(AnalyticSource(4, (("outside", (5.0,)),)))
    assert str(document.verdict) == "NONE-EXPLAINS"


def test_a_design_that_is_too_small_says_so_and_how_much_is_needed() -> None:
    document = said(AnalyticSource(5, (("straight", (40.0,)),), design=(2, 2, 1)))
    assert str(document.verdict) == "TOO-FEW-REPEATS"
    assert "1 more repeat" in document.summary
    assert {str(found.verdict) for found in document.effects} == {"TOO-FEW-REPEATS"}


def test_two_conditions_are_refused() -> None:
    with pytest.raises(InputError, match="at least 3 are needed"):
        said(AnalyticSource(6, design=(3, 3)))


def test_effects_that_look_alike_are_confusable_both_ways() -> None:
    document = said(AnalyticSource(7, (("straight", (5.0,)),)), "straight", "twin_of_straight", "bent")
    assert str(document.verdict) == "straight"
    assert document.confusable == (("straight", "twin_of_straight"),)
    assert str(effect(document, "straight").verdict) == "CONFUSABLE-WITH{twin_of_straight}"
    twin = effect(document, "twin_of_straight")
    assert str(twin.verdict) == "CONFUSABLE-WITH{straight}"
    assert twin.parameters["c"].estimate == pytest.approx(10.0, abs=0.4)


def test_a_known_simulator_error_leaves_nothing_missing() -> None:
    verdicts = [said(AnalyticSource(seed, discrepancy=0.6, simulator=seed)).verdict for seed in range(10)]
    assert verdicts.count(NOTHING) >= 9


def test_what_is_left_has_the_unit_of_the_signal_and_no_noise_in_it() -> None:
    """A shift of 3 in one signal of unit noise and 2,000 repeats is reported as 3."""
    source = AnalyticSource(8, design=(2_000, 2_000, 2_000))
    own = np.array([f % 4 == 0 for f in range(FEATURES)])
    clusters = tuple(replace(item, residuals=item.residuals + 3.0 * own / item.sigma) for item in source.clusters)
    evidence = Evidence(source, (0, 1, 2), clusters)
    rests = {rest.signal: rest for rest in residuals_by_signal(evidence, means_of(clusters))}
    assert rests["signal 0"].value == pytest.approx(3.0, rel=1e-2)
    assert all(rests[f"signal {number}"].value < 0.05 for number in (1, 2, 3))
    assert rests["signal 0"].share > 0.99


def test_the_scale_of_errors_is_that_of_repetition() -> None:
    """Noise of variance 1 in n repeats: a mean residual of size s is reported as s sqrt(n)."""
    source = AnalyticSource(9, design=(4, 4, 4))
    evidence = Evidence.of(source)
    rest = [np.full(FEATURES, 2.0) / item.sigma for item in source.clusters]
    assert residual_size(evidence, rest) == pytest.approx(2.0 * np.sqrt(4.0))


def test_where_only_noise_is_left_the_rest_is_next_to_nothing() -> None:
    """Noise of 1 in 3 repeats is 0.58 in their mean; only what exceeds that by chance is reported."""
    sizes = []
    for seed in range(10):
        evidence = Evidence.of(AnalyticSource(seed))
        sizes += [rest.value for rest in residuals_by_signal(evidence, means_of(evidence.clusters))]
    assert np.mean(sizes) < 0.15


def changing(seed: int, sizes: Sequence[float], truth: Added = ()) -> AnalyticSource:
    """A world in which ``straight`` has another size in every cluster, of 60 repeats each."""
    source = AnalyticSource(seed, truth, design=(60,) * len(sizes))
    source._measured = [
        rows + size * direction(number, 0)
        for number, (rows, size) in enumerate(zip(source._measured, sizes, strict=True))
    ]
    source.clusters = tuple(
        replace(item, residuals=rows / item.sigma) for item, rows in zip(source.clusters, source._measured, strict=True)
    )
    return source


@pytest.mark.parametrize("beside", [(), (("straight", (5.0,)),)])
def test_what_is_significant_and_stops_at_nothing_is_no_improvement(beside: Added) -> None:
    """A size below zero is seen clearly by its score; the estimate cannot follow, and is nothing at all."""
    source = AnalyticSource(0, (("one_sided", (-0.06,)), *beside), design=(60,) * 8)
    document = said(source, "one_sided", *(name for name, _ in beside))
    found = effect(document, "one_sided")
    assert found.p_value is not None and found.p_value < 0.01
    assert found.parameters["d"].interval[0] == found.parameters["d"].estimate == 0.0
    assert str(found.verdict) == "NO-IMPROVEMENT" and "contains the nominal value" in found.reason


@pytest.mark.parametrize("beside", [(), (("one_sided", (5.0,)),)])
def test_what_is_small_and_may_as_well_be_nothing_is_not_named(beside: Added) -> None:
    """Three conditions that disagree about its size: the search accepts it, its interval contains zero."""
    document = said(changing(1, (0.12, 0.08, 0.03), beside), "straight", *(name for name, _ in beside))
    found = effect(document, "straight")
    low, high = found.parameters["a"].interval
    assert low < 0.0 < found.parameters["a"].estimate < high
    assert str(found.verdict) == "NO-IMPROVEMENT"
    assert document.named == tuple(name for name, _ in beside)


def test_what_is_small_and_certain_is_named_where_conditions_disagree_less() -> None:
    document = said(changing(0, (0.12, 0.08, 0.03)), "straight")
    found = effect(document, "straight")
    assert found.parameters["a"].interval[0] > 0.0
    assert (str(found.verdict), document.named) == ("PRESENT-BUT-SMALL", ("straight",))


def test_errors_of_an_effect_alone_and_of_what_it_adds_are_given() -> None:
    """Two that are there: alone each leaves the other, and what a third adds to both is nothing."""
    document = said(AnalyticSource(1, (("straight", (9.0,)), ("one_sided", (5.0,)))), "straight", "one_sided", "bent")
    straight, one_sided, bent = (effect(document, name) for name in ("straight", "one_sided", "bent"))
    both = straight.held_out_error_after
    assert both == one_sided.held_out_error_after and both is not None and both < 1.5
    assert straight.held_out_error_alone == pytest.approx(one_sided.held_out_error_others, rel=1e-3)
    assert one_sided.held_out_error_alone == pytest.approx(straight.held_out_error_others, rel=1e-3)
    assert both < straight.held_out_error_alone / 3.0 < one_sided.held_out_error_alone / 3.0  # type: ignore[operator]
    assert bent.held_out_error_others == pytest.approx(both)
    assert bent.held_out_error_after == pytest.approx(both, rel=0.2)
    assert bent.held_out_error_alone == pytest.approx(document.held_out_error_before, rel=0.2)


def test_an_effect_that_explains_all_is_as_good_alone() -> None:
    found = said(AnalyticSource(1, (("straight", (5.0,)),))).effects[0]
    assert found.held_out_error_alone == found.held_out_error_after
    assert found.held_out_error_others == found.held_out_error_before


def test_a_small_effect_beside_one_that_matters_leaves_the_whole_large() -> None:
    document = said(changing(0, (0.12, 0.08, 0.03), (("one_sided", (5.0,)),)), "straight", "one_sided")
    assert str(effect(document, "one_sided").verdict) == "CONFIRMED"
    assert str(effect(document, "straight").verdict) == "PRESENT-BUT-SMALL"
    assert str(document.verdict) == "one_sided+straight"


def test_what_soon_changes_nothing_more_is_not_excluded_however_large() -> None:
    """Its sensitivity at nominal would exclude all beyond a few scales; what changes in proportion is excluded."""
    document = said(AnalyticSource(3), "straight", "slight")
    _, high = effect(document, "slight").parameters["w"].interval
    assert str(document.verdict) == "NOTHING-MISSING" and high > 20.0
    assert document.not_excluded == {"slight": "w"}
    assert not_excluded(document).startswith("slight (w ")


def test_what_first_changes_something_far_away_is_not_excluded_and_what_is_named_is_not_listed() -> None:
    """A contact sticks up to six scales of its friction: those are possible."""
    document = said(AnalyticSource(3, (("straight", (5.0,)),)), "straight", "twin_of_straight", "sticking")
    low, high = effect(document, "sticking").parameters["h"].interval
    assert document.named == ("straight",) and document.not_excluded == {"sticking": "h"}
    assert low < -6.0 and high > 6.0


def fitted(source: AnalyticSource, *names: str, change: Array | None = None) -> Fit:
    """Effects together, linearised where they do nothing; with a change [parameter scales] in place of the best."""
    search = Search([EFFECTS[name] for name in names], Evidence.of(source))
    found = search.screening.linear_fit_with(None, names[0])
    for name in names[1:]:
        found = search.screening.linear_fit_with(found, name)
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


def test_an_effect_is_certain_where_one_interval_leaves_out_nothing() -> None:
    """The lever of a payload is a shape: it says where the payload is, not whether it is there."""
    source = AnalyticSource(1, (("payload", (3.0, 0.5)),))
    best = fitted(source, "payload")
    half = best.half_widths
    assert excludes_nominal(best, "payload")
    for mass, expected in ((1.1, True), (-1.1, True), (0.9, False)):
        moved = Fit(best.candidate, best.evidence, best.problem, np.array([mass * half[0], 9.0]))
        assert excludes_nominal(moved, "payload") == expected


def test_a_wide_interval_determines_nothing_unless_it_leaves_out_the_nominal_value() -> None:
    """Kills: width alone, or place alone."""
    estimates, half_widths = np.array([10.0, 50.0, 10.0]), np.array([30.0, 30.0, 15.0])
    found: Any = SimpleNamespace(distance_from_nominal=estimates, half_widths=half_widths)
    assert undetermined(found).tolist() == [True, False, False]


def test_estimates_that_move_against_each_other_are_listed() -> None:
    """Two parameters do nearly the same: what one gets more, the other gets less."""
    found = fitted(AnalyticSource(1), "twin_of_straight")
    alike = tuple(np.stack((j[:, 0], j[:, 0] + 0.2 * j[:, 1]), axis=1) for j in found.candidate.jacobians)
    (pair,) = _identifiability(Fit.of(replace(found.candidate, jacobians=alike), found.evidence)).correlated
    assert {pair.first, pair.second} == {"c", "c_2"} and pair.correlation < -0.8


@pytest.mark.parametrize(("verdict", "correct"), [("NOTHING-MISSING", True), ("PRESENT-BUT-SMALL", False)])
def test_where_nothing_is_hidden_only_nothing_missing_is_right(tmp_path: Path, verdict: str, correct: bool) -> None:
    (tmp_path / "truth.json").write_text(json.dumps({"kind": "null", "effects": []}))
    document = documents.diagnosis("minimal").model_copy(update={"verdict": DiagnosisVerdict.parse(verdict)})
    found = held_against_truth(tmp_path, document)
    assert (found.correct, found.headline) == (correct, correct)


def test_an_effect_is_identified_where_one_of_its_parameters_is() -> None:
    """How high the weight of a box lies hardly moves anything until it tips; that it is pushed is clear."""
    source = knowing(AnalyticSource(1, (("tipping", (5.0, 0.0)),), design=(2,) * 3), TIPPING)
    (effect,) = diagnose(source, source.model).effects
    low, high = effect.parameters["height"].interval
    assert low < -4.0 and high > 4.0
    assert effect.parameters["g"].interval[1] - effect.parameters["g"].interval[0] < 1.0
    assert str(effect.verdict) == "CONFIRMED"


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
    verdicts = [one and DiagnosisVerdict.parse(one) for one in joints]
    assert _alike_at_joints(verdicts) == rivals
