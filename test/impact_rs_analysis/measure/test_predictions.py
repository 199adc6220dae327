# SPDX-License-Identifier: Apache-2.0
"""What the paper's three motor inertias predict for a set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from intervals import assert_covers

from impact_rs_analysis.measure.predictions import predict, prediction_interval
from impact_rs_sim.impact_map import CONTACTS, ImpactProblem, compute_impact_map, settle
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS
from impact_rs_sim.scenario import load_scenario
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


def test_both_engines_predict_the_same() -> None:
    first, second = (predict(PUSH, "parcel", "case_1", engine=engine) for engine in ("exact", "bullet"))
    assert first == pytest.approx(second, abs=2e-3)


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
