# SPDX-License-Identifier: Apache-2.0
"""One problem gives the same numbers, whichever part of the program solves it."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from impact_rs.msg import ImpactProblem as ImpactProblemMessage
from impact_rs.srv import PredictImpact

from impact_msgs_py.conversions import twist_from_message
from impact_rs_analysis.measure.predictions import predict_arms
from impact_rs_cli.main import main
from impact_rs_control.plan import plan_trial
from impact_rs_ros.graph import Graph
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, predict_impact
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_workbench.prediction import MapQuery, answer

# The engine on Bullet is 0.7 mm/s off the exact velocity of this object: the largest of all shipped problems.
OBJECT, CASE, MOTORS = "juice", "case_1", "rotor"
SCENE = Scene.resolve(load_scenario("grab"), OBJECT, CASE)
PROBLEM = ImpactProblem.at_nominal_impact(SCENE, MOTORS)
EXACT = compute_impact_map(PROBLEM, "exact")


def service(graph: Graph, engine: str = "") -> PredictImpact.Response:
    problem = ImpactProblemMessage(scenario="grab", object_name=OBJECT, case_name=CASE, motor_inertia=MOTORS)
    request = PredictImpact.Request(problem=problem, engine=engine)
    return graph.call(PredictImpact, "impact_map/predict", request, timeout=60.0)


def test_bullet_is_another_solver_with_velocities_of_its_own() -> None:
    bullet = compute_impact_map(PROBLEM, "bullet")
    assert np.max(np.abs(bullet.object_twist[:3] - EXACT.object_twist[:3])) > 3e-4


def test_python_functions_and_references_predict_the_same_velocities() -> None:
    for result in (compute_impact_map(PROBLEM), predict_impact(PROBLEM), plan_trial(SCENE, 1.0, MOTORS).impact):
        assert result is not None
        assert result.engine == "exact"
        np.testing.assert_array_equal(result.object_twist, EXACT.object_twist)
    axis = SCENE.scenario.axis_index
    predicted = predict_arms(SCENE.scenario, OBJECT, CASE)[MOTORS]
    assert predicted == {name: twist[axis] for name, twist in EXACT.end_effector_twist.items()}


def test_command_line_predicts_the_same_velocities(capfd: pytest.CaptureFixture) -> None:
    assert main(["map", "grab", OBJECT, CASE, "--motor-inertia", MOTORS, "--json"]) == 0
    document = json.loads(capfd.readouterr().out)
    assert document["engine"] == "exact"
    np.testing.assert_array_equal(document["post"]["object_twist"], EXACT.object_twist)


def test_workbench_predicts_the_same_velocities() -> None:
    question = MapQuery(scenario="grab", object=OBJECT, case=CASE, motor_inertia=MOTORS, moving=True)
    rows = answer(SCENE.scenario, question)["rows"]
    speeds = {(row["body"], row["axis"]): row["after"] for row in rows}
    bodies = {**EXACT.end_effector_twist, "object": EXACT.object_twist}
    assert speeds == {(name, axis): twist["xyz".index(axis)] for name, twist in bodies.items() for axis in "xyz"}


def test_service_predicts_the_same_velocities(graph: Graph) -> None:
    response = service(graph)
    assert response.success, response.message
    assert response.engine == "exact"
    twist = twist_from_message(response.body_twists[0].twist)
    np.testing.assert_allclose(twist, EXACT.object_twist, rtol=0, atol=1e-12)


def test_example_predicts_the_same_velocities() -> None:
    path = Path(__file__).parents[2] / "examples" / "predict.py"
    spec = importlib.util.spec_from_file_location("predict", path)
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    scenario = load_scenario("push")
    problem = ImpactProblem.at_nominal_impact(Scene.resolve(scenario, "cat_food", "case_2"), MOTORS)
    twist = compute_impact_map(problem, "exact").end_effector_twist["arm"]
    assert example.main()[MOTORS] == twist[scenario.axis_index]


def test_former_name_of_the_engine_is_accepted(graph: Graph, capfd: pytest.CaptureFixture) -> None:
    assert compute_impact_map(PROBLEM, "pinocchio").engine == "exact"
    assert main(["map", "grab", OBJECT, CASE, "--engine", "pinocchio", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["engine"] == "exact"
    response = service(graph, "pinocchio")
    assert response.success, response.message
    assert response.engine == "exact"
