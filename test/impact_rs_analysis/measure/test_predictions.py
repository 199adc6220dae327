# SPDX-License-Identifier: Apache-2.0
"""What the paper's three motor inertias predict for a set."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from intervals import assert_covers

from impact_rs_analysis.measure.far import FAR_MISMATCH, Jump, far_jumps, far_words
from impact_rs_analysis.measure.paper import paper_results, study_paper
from impact_rs_analysis.measure.predictions import predict, prediction_interval
from impact_rs_cli.main import main
from impact_rs_sim.impact_map import CONTACTS, ImpactProblem, compute_impact_map, settle
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene

PUSH = load_scenario("push")


def test_a_stiffer_motor_side_keeps_more_of_the_velocity() -> None:
    speeds = {model: -velocity for model, velocity in predict(PUSH, "cat_food", "case_2").items()}
    assert 0.0 < speeds["zero"] < speeds["reduced"] < speeds["rotor"] < 0.7


@pytest.mark.parametrize("scenario", ["push", "grab"])
def test_the_prediction_is_the_mean_over_the_arms_along_the_measured_axis(scenario: str) -> None:
    loaded = load_scenario(scenario)
    scene = Scene.resolve(loaded, "juice", "case_1")
    found = predict(loaded, "juice", "case_1")
    assert set(found) == set(MOTOR_INERTIA_MODELS)
    for model, velocity in found.items():
        answer = compute_impact_map(ImpactProblem.at_nominal_impact(scene, model), "exact")
        twists = list(answer.end_effector_twist.values())
        assert velocity == pytest.approx(np.mean([twist[{"push": 1, "grab": 2}[scenario]] for twist in twists]))


def test_the_settled_contact_is_predicted_when_it_is_asked_for() -> None:
    loaded = load_scenario("grab")
    scene = Scene.resolve(loaded, "parcel", "case_1")
    first, settled = (predict(loaded, "parcel", "case_1", contact) for contact in CONTACTS)
    for model, velocity in settled.items():
        twists = list(settle(ImpactProblem.at_nominal_impact(scene, model)).end_effector_twist.values())
        assert velocity == pytest.approx(np.mean([twist[2] for twist in twists]))
        assert velocity > first[model] + 5e-4


def test_the_interval_of_a_prediction_is_that_of_its_derivatives_and_shrinks_with_certainty() -> None:
    """Motor inertias known to 10 %, each joint by itself: half = |0.1 B_j dv/dB_j|; kills widths times two."""
    scenario = load_scenario("push")
    nominal = predict(scenario, "cat_food", "case_2")["reduced"]
    low, high = prediction_interval(scenario.model_dump_json(), "cat_food", "case_2")
    sure = scenario.with_settings({f"uncertainty.{name}": 0.0 for name, _ in scenario.uncertainty})
    sure = sure.with_settings({"uncertainty.motor_inertia": 0.1})
    inner = prediction_interval(sure.model_dump_json(), "cat_food", "case_2")
    problem = ImpactProblem.at_nominal_impact(Scene.resolve(scenario, "cat_food", "case_2"))
    (arm,), steps = problem.motor_inertia, 0.1 * np.eye(7)

    def speed(change: np.ndarray) -> float:
        motors = {arm: problem.motor_inertia[arm] * (1.0 + change)}
        return float(compute_impact_map(replace(problem, motor_inertia=motors)).end_effector_twist[arm][1])

    half = float(np.linalg.norm([0.5 * (speed(step) - speed(-step)) for step in steps]))
    assert_covers(inner, nominal, half, within=1.3)
    assert low < inner[0] < inner[1] < high


def test_a_law_without_intervals_gives_none() -> None:
    poisson = load_scenario("push").with_settings({"contact.restitution_law": "poisson", "contact.restitution": 0.2})
    assert prediction_interval(poisson.model_dump_json(), "cat_food", "case_2") is None


# ---- Predictions far outside of what was measured: where the limit is, and that it is said in one line


def test_published_predictions_are_at_most_about_half_as_far_as_far() -> None:
    worst = 0.0
    for result in paper_results():
        scenario = load_scenario(result.scenario)
        (ante, *_) = {arm.ante_velocity for arm in scenario.case(result.case).robots.values()}
        predicted = result.row.estimate * (1.0 + result.row.reduced / 100.0)
        jump = Jump(result.label, ante[scenario.axis_index], predicted, result.row.estimate)
        worst = max(worst, jump.mismatch)
    assert 0.4 * FAR_MISMATCH < worst < 0.52 * FAR_MISMATCH


@pytest.mark.parametrize("ante", [-0.5, 0.5])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_far_is_a_fifth_of_the_speed_before_the_impact_on_either_side(ante: float, side: float) -> None:
    near, beyond = (Jump("tin", ante, 0.5 * ante + side * share * ante, 0.5 * ante) for share in (0.199, 0.201))
    assert far_jumps([near, beyond]) == [beyond]
    assert beyond.mismatch == pytest.approx(0.201)


def test_the_farthest_is_named_in_one_line() -> None:
    jumps = [Jump("tin", -0.5, -0.30, -0.30), Jump("box", -0.5, -0.10, -0.30), Jump("jar", -0.5, -0.45, -0.20)]
    line = far_words(jumps)
    start = "2 of 3 predictions are far from the measurement, most for jar: -0.450 m/s predicted, -0.200"
    assert line.startswith(start) and "50% of the ante-impact speed" in line and "\n" not in line
    assert far_words(jumps[:1]) == ""


def test_without_a_speed_before_the_impact_nothing_is_far() -> None:
    assert far_jumps([Jump("tin", math.nan, 9.0, 0.1), Jump("tin", 0.0, 9.0, 0.1)]) == []


# ---- The published experiment as a measurement


def test_interpolation_meets_the_published_predictions() -> None:
    for result in paper_results():
        for curve in ("parabola", "hyperbola"):
            ends = result.mismatch(np.array([0.0, 1.0, 3.0]), curve)
            assert ends == pytest.approx([result.row.zero, result.row.reduced, result.row.rotor], abs=1e-9)


def test_one_motor_inertia_scale_is_not_decisive() -> None:
    study = study_paper()
    fit = study.all_rows
    assert fit.scale == pytest.approx(0.51, abs=0.02)
    assert fit.interval == pytest.approx((0.36, 0.95), abs=0.02)
    assert (fit.error_nominal, fit.error_fitted) == pytest.approx((3.54, 3.05), abs=0.01)
    assert fit.error_fitted < fit.error_held_out < fit.error_nominal
    assert study.by_scenario["push"].scale == pytest.approx(0.36, abs=0.02)
    assert study.by_scenario["grab"].scale == pytest.approx(0.84, abs=0.02)
    assert (len(study.results), len(study.unexplained)) == (18, 8)
    assert study.verdict == "NOT-DECISIVE"


def test_paper_command_writes_figure_and_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "--json", "-o", str(tmp_path / "report")]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "NOT-DECISIVE"
    assert {path.suffix for path in (tmp_path / "report").iterdir()} == {".html", ".json", ".png"}
