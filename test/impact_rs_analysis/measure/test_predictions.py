"""What the paper's three motor inertias predict for a set."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_analysis.measure.predictions import predict
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
        answer = compute_impact_map(ImpactProblem.at_nominal_impact(scene, model), "pinocchio")
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
    first, second = (predict(PUSH, "parcel", "case_1", engine=engine) for engine in ("pinocchio", "bullet"))
    assert first == pytest.approx(second, abs=2e-3)
