# SPDX-License-Identifier: Apache-2.0
"""Two arms grab a box: symmetry of the prediction, and a box that is really lifted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_sim.effects import library
from impact_rs_sim.impact_map import compute_impact_map
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.robot import Link, RobotFacts
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import ArmState, Scene
from impact_rs_trials.bags.outcome import Verdict, Witness, judge

GRAB = load_scenario("grab")
SCENE = Scene.resolve(GRAB, "cat_food", "case_1")
MIRROR = np.diag([1.0, -1.0, 1.0])
JOINTS = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # axes in the mirror plane turn the other way


def mirrored(facts: RobotFacts, model: RobotModel) -> RobotFacts:
    """The arm seen in a mirror: at zero, joint axes lie in the mirror plane or across it; only inertials change."""
    places = model.link_placements(pin.neutral(model.pinocchio))
    base = places["base"].rotation
    links = []
    for number, link in enumerate(facts.links, start=1):
        turn = base.T @ places[f"link{number}"].rotation
        flip = turn.T @ MIRROR @ turn
        inertia = flip @ link.inertia_matrix @ flip.T
        entries = tuple(float(inertia[index]) for index in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
        links.append(Link(mass=link.mass, com=tuple((flip @ np.array(link.com)).tolist()), inertia=entries))
    return facts.model_copy(update={"links": tuple(links)})


def mirrored_problem() -> ImpactProblem:
    """The nominal grab with a right arm that is the left one's mirror image."""
    problem = ImpactProblem.at_nominal_impact(SCENE)
    left = problem.arms["left"]
    facts = mirrored(problem.physics.arms["left"].facts, SCENE.models["left"])
    arms = {**problem.physics.arms, "right": replace(problem.physics.arms["right"], facts=facts)}
    state = ArmState(JOINTS * left.position, JOINTS * left.velocity)
    return replace(problem, physics=replace(problem.physics, arms=arms), arms={"left": left, "right": state})


def test_the_mirror_image_of_an_arm_weighs_the_same_everywhere() -> None:
    problem = mirrored_problem()
    left, right = (problem.physics.robot_model(name) for name in ("left", "right"))
    for seed in range(5):
        q = np.random.default_rng(seed).uniform(left.position_min, left.position_max)
        expected = np.diag(JOINTS) @ left.mass_matrix(q) @ np.diag(JOINTS)
        np.testing.assert_allclose(right.mass_matrix(JOINTS * q), expected, atol=1e-10)


@pytest.mark.parametrize("engine", ["exact", "bullet"])
def test_a_mirrored_scene_gives_a_mirrored_answer(engine: str) -> None:
    """Redundant friction must not turn up as a rotation of the box out of the mirror plane."""
    result = compute_impact_map(mirrored_problem(), engine)
    left, right = result.end_effector_twist["left"], result.end_effector_twist["right"]
    speed = float(np.linalg.norm(GRAB.cases["case_1"].robots["left"].ante_velocity))
    tolerance = (1e-5 if engine == "exact" else 2e-3) * speed
    np.testing.assert_allclose(right[:3], MIRROR @ left[:3], atol=tolerance)
    np.testing.assert_allclose(result.object_twist[[1, 3, 5]], 0.0, atol=10.0 * tolerance)
    np.testing.assert_allclose(
        result.joint_velocity["right"], JOINTS * result.joint_velocity["left"], atol=0.05 * speed
    )


def test_the_box_is_lifted_by_both_arms() -> None:
    result = compute_impact_map(ImpactProblem.at_nominal_impact(SCENE))
    assert result.object_twist[2] > 0.5 * GRAB.cases["case_1"].robots["left"].ante_velocity[2]
    for name, side in (("left", -1.0), ("right", 1.0)):
        assert abs(result.end_effector_twist[name][1]) < 0.1 * 0.3, "nothing goes on towards the box"
        assert side * SCENE.models[name].jacobian(SCENE.arms[name].position)[1] @ SCENE.arms[name].velocity > 0.29


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    return plan_trial(SCENE)


def test_pads_meet_the_faces_of_every_object() -> None:
    for name, spec in GRAB.objects.items():
        for arm, side in (("left", 1.0), ("right", -1.0)):
            place = GRAB.impact_placement(arm, name).translation
            assert side * place[1] == pytest.approx(spec.size[1] / 2.0)


def _run(plan: TrialPlan, physics=None):  # noqa: ANN001, ANN202
    plant = make_plant(plan, 5, physics)
    heights, modes, detections, witness = [], [], {}, Witness(plan)
    try:
        for tick in run_closed_loop(plan, plant):
            witness.see(tick)
            if tick.measurement.object is not None:
                heights.append(tick.measurement.object.position[2])
            modes.append({int(command.mode) for command in tick.commands.values()})
            for name, command in tick.commands.items():
                if command.detection is not None:
                    detections[name] = command.detection.time
    finally:
        plant.close()
    return np.array(heights), modes, detections, judge(plan, witness.record())


def test_both_arms_leave_the_ante_mode_together_and_hold_the_box(plan: TrialPlan) -> None:
    heights, modes, detections, verdict = _run(plan)
    assert all(len(mode) == 1 for mode in modes)
    assert set(detections) == {"left", "right"}
    assert abs(detections["left"] - detections["right"]) < 0.02
    lift = heights[-1] - heights[0]
    assert lift == pytest.approx(plan.expected_lift, rel=0.1)
    assert np.ptp(heights[-10:]) < 1e-3
    assert verdict == Verdict("OK")


def test_slippery_pads_drop_the_box(plan: TrialPlan) -> None:
    nominal = plan.scene.physics
    physics = library()["pad_friction"].apply_vector(nominal, np.array([-0.9 * nominal.pad_friction]))
    assert _run(plan, physics)[-1].outcome == "DROPPED"
