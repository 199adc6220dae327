# SPDX-License-Identifier: Apache-2.0
"""The result table: mismatch in percent of the estimate, its mean with sign and without, ours beside the paper's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.measure.analyze import Analysis, ExperimentSet, Prediction
from impact_rs_analysis.measure.linear_fit import fit_zero_crossing
from impact_rs_analysis.measure.published import paper_row
from impact_rs_analysis.measure.table import result_table, shown_contacts
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS


def experiment(scenario: str, item: str, case: str, truth: float, errors: dict[str, float]) -> ExperimentSet:
    """A set whose line crosses zero at ``truth`` [m/s], with predictions that are wrong by ``errors`` [%]."""
    rng = np.random.default_rng(0)
    velocity = truth * np.repeat([0.8, 1.0, 1.2], 3)
    fit = fit_zero_crossing(velocity, 1.1 * (velocity - truth) + 0.02 * rng.standard_normal(9))
    predictions = {name: Prediction(fit.estimate * (1.0 + error / 100.0), error) for name, error in errors.items()}
    settled = {name: Prediction(fit.estimate * (1.0 + error / 200.0), error / 2.0) for name, error in errors.items()}
    row = paper_row(scenario, item, case)
    return ExperimentSet(
        scenario, item, case, "y", f"{item}: {case}", (), fit, predictions, settled, ante_velocity=-0.7, published=row
    )


def analysis(*sets: ExperimentSet) -> Analysis:
    return Analysis(Path("."), sets, (), (), (), ())


FIRST = experiment("push", "cat_food", "case_2", -0.55, {"reduced": 2.0, "rotor": 5.0, "zero": -3.0})
SECOND = experiment("push", "juice", "case_1", -0.40, {"reduced": -4.0, "rotor": 1.0, "zero": -5.0})
THIRD = experiment("grab", "juice", "case_1", 0.30, {"reduced": 8.0, "rotor": -2.0, "zero": 0.0})


@pytest.mark.parametrize(("contact", "share", "key"), [("first", 1.0, ""), ("settled", 0.5, "_settled")])
def test_bias_is_the_mean_with_sign_and_quality_the_mean_without(contact: str, share: float, key: str) -> None:
    """The errors of the settled contact are half of those of the first, and have a table of their own."""
    found = analysis(FIRST, SECOND)
    *rows, bias, quality = result_table(found)
    assert [row.label for row in rows] == ["cat_food: case_2", "juice: case_1"]
    assert [row.of_contact(contact)["reduced"] for row in rows] == pytest.approx([2.0 * share, -4.0 * share])
    mean = {"reduced": -1.0 * share, "rotor": 3.0 * share, "zero": -4.0 * share}
    size = {"reduced": 3.0 * share, "rotor": 3.0 * share, "zero": 4.0 * share}
    assert (bias.of_contact(contact), quality.of_contact(contact)) == (pytest.approx(mean), pytest.approx(size))
    assert (bias.label, bias.signed) == ("Average error", True)
    assert (quality.label, quality.signed) == ("Absolute error", False)
    assert found.average_error(contact) == pytest.approx(mean)
    assert found.absolute_error(contact) == pytest.approx(size)
    document = found.to_json()
    assert document[f"absolute_error_percent{key}"] == pytest.approx(size)
    prediction = document["sets"][0][f"predictions{key}"]["reduced"]
    assert prediction["error_percent"] == pytest.approx(2.0 * share)


def test_the_nearest_model_of_a_set_is_counted_for_each_contact() -> None:
    first = experiment("push", "juice", "case_1", 0.4, {"reduced": -4.0, "rotor": 1.0, "zero": -5.0})
    settled = {name: Prediction(0.4, error) for name, error in {"reduced": 0.1, "rotor": 3.0, "zero": -2.0}.items()}
    found = analysis(replace(first, predictions_settled=settled), FIRST)
    assert found.nearest("first") == {"reduced": 1, "rotor": 1, "zero": 0}
    assert found.nearest("settled") == {"reduced": 2, "rotor": 0, "zero": 0}


def test_scenarios_have_averages_and_all_sets_count_once_in_the_whole() -> None:
    rows = {row.label: row for row in result_table(analysis(FIRST, SECOND, THIRD))}
    assert rows["push: average error"].errors["reduced"] == pytest.approx(-1.0)
    assert rows["grab: average error"].errors["reduced"] == pytest.approx(8.0)
    assert rows["All: average error"].errors["reduced"] == pytest.approx(2.0)
    assert rows["All: absolute error"].errors["reduced"] == pytest.approx(14.0 / 3.0)


def test_an_estimate_is_a_speed_with_the_larger_half_of_its_interval() -> None:
    row = result_table(analysis(FIRST))[0]
    low, high = FIRST.fit.interval or (0.0, 0.0)
    assert row.estimate == pytest.approx(-FIRST.fit.estimate)
    assert row.estimate > 0.0
    assert FIRST.interval == pytest.approx((-high, -low))
    assert row.half_interval == pytest.approx(max(FIRST.fit.estimate - low, high - FIRST.fit.estimate))
    assert row.half_interval > min(FIRST.fit.estimate - low, high - FIRST.fit.estimate)


def test_the_papers_averages_are_over_the_rows_that_it_has() -> None:
    unknown = experiment("push", "tin", "case_1", -0.4, dict.fromkeys(MOTOR_INERTIA_MODELS, 0.0))
    *_, bias, quality = result_table(analysis(FIRST, SECOND, unknown))
    rows = [paper_row("push", "cat_food", "case_2"), paper_row("push", "juice", "case_1")]
    for model in MOTOR_INERTIA_MODELS:
        errors = [row.errors[model] for row in rows]
        assert bias.paper_errors[model] == pytest.approx(np.mean(errors))
        assert quality.paper_errors[model] == pytest.approx(np.mean(np.abs(errors)))


def test_no_sets_make_no_table() -> None:
    assert result_table(analysis()) == []
    assert set(analysis().average_error("first").values()) == {None}


def test_a_set_that_repeats_nothing_published_has_no_published_number() -> None:
    row, bias, quality = result_table(analysis(replace(FIRST, published=None)))
    assert {entry.paper_errors is None for entry in (row, bias, quality)} == {True}
    assert row.paper_estimate is None


def test_the_settled_contact_is_shown_only_where_its_errors_differ() -> None:
    rows = result_table(analysis(FIRST, SECOND))
    assert shown_contacts(rows) == ("first", "settled")
    flat = replace(FIRST, predictions_settled=FIRST.predictions)
    assert shown_contacts(result_table(analysis(flat))) == ("first",)
    off = {name: Prediction(0.0, one.error + 0.006) for name, one in FIRST.predictions.items()}
    assert shown_contacts(result_table(analysis(flat, replace(flat, predictions_settled=off)))) == ("first", "settled")
    assert shown_contacts([]) == ("first",)


def test_the_nearest_prediction_fits_only_within_the_intervals_of_both() -> None:
    """Estimate 0.55 m/s; interval of the prediction 3 % of it to one side and 4 % to the other."""
    (row, *averages) = result_table(analysis(FIRST))
    assert FIRST.fit.interval is not None
    own = 100.0 * max(abs(bound / FIRST.fit.estimate - 1.0) for bound in FIRST.fit.interval)
    assert row.tolerance == pytest.approx(own)
    assert (row.nearest("first"), row.fits("first")) == ("reduced", own > 2.0)
    nominal, estimate = FIRST.predictions["reduced"].velocity, FIRST.fit.estimate
    wide = replace(FIRST, prediction_interval=(nominal - 0.03 * abs(estimate), nominal + 0.04 * abs(estimate)))
    (row, *_) = result_table(analysis(wide))
    assert row.tolerance == pytest.approx(np.hypot(own, 4.0))
    assert row.fits("first")
    shift = 0.117 * estimate
    far = {name: Prediction(one.velocity + shift, one.error + 11.7) for name, one in FIRST.predictions.items()}
    moved = (wide.prediction_interval[0] + shift, wide.prediction_interval[1] + shift)  # type: ignore[index]
    (row, *_) = result_table(analysis(replace(wide, predictions=far, prediction_interval=moved)))
    assert row.tolerance == pytest.approx(np.hypot(own, 4.0))
    assert (row.nearest("first"), row.fits("first")) == ("zero", False)  # +8.7 %, the others are farther
    assert all(average.tolerance is None for average in averages)
