# SPDX-License-Identifier: Apache-2.0
"""Friction compensation after the paper's Appendix A: what is identified, and what it does to the net feedback."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from trials import BRIEF, scene_of, ticks_of

from impact_rs_control.closed_loop import make_plant
from impact_rs_control.controller import Controller
from impact_rs_control.friction_identification import identify_arm, run_free_motion
from impact_rs_control.plan import plan_trial
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.scenarios.friction_compensation import FrictionCompensation
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey


def rough_scene(friction, compensation=None):
    scenario = load_scenario("push")
    arm = scenario.robots["arm"]
    rough = arm.model_copy(update={"drive": arm.drive.model_copy(update={"friction": friction})})
    changed = scenario.model_copy(update={"robots": {"arm": rough}, "friction_compensation": compensation})
    return Scene.resolve(changed, "cat_food", "case_2")


def model(name, values, unit):
    parameters = {key: ParameterValue(estimate=value, unit=unit) for key, value in values.items()}
    return Model(name=name, effects=(ModelEffect(name=name, parameters=parameters),))


@pytest.fixture(scope="module")
def smooth():
    return rough_scene("none")


@pytest.fixture(scope="module")
def identified():
    return identify_arm(rough_scene("identified"), "arm", runs=1, seed=0)


@pytest.fixture(scope="module")
def compensated(identified):
    rough = rough_scene("identified")
    compensation = FrictionCompensation(
        scenario="push",
        scenario_digest=rough.scenario.digest,
        runs=1,
        seed=0,
        period=0.01,
        sets={"cat_food": {"case_2": {"arm": identified}}},
    )
    return rough_scene("identified", compensation)


def final_commands(scene):
    return [tick.commands["arm"] for tick, _ in ticks_of(plan_trial(scene), seed=5)]


def test_without_friction_nothing_but_noise_is_identified(smooth, identified):
    found = identify_arm(smooth, "arm", runs=1, seed=0)
    for phase in ("ante", "post"):
        rows = getattr(found, phase).rows
        assert np.abs(rows.mean(axis=0)).max() < 0.01
        assert rows.std(axis=0).max() < 0.15
        assert np.abs(getattr(identified, phase).rows).max() > 3.0


def test_a_known_torque_offset_is_identified_as_the_acceleration_it_causes(smooth):
    """a_fric = -J (M + B_theta)^-1 tau, where the arm moves at constant velocity and where it rests."""
    offset = np.array([0.4, -0.6, 0.5, 0.7, -0.2, 0.3, 0.1])
    effects = model("torque_offset", {f"offset_joint{i + 1}": value for i, value in enumerate(offset)}, "N m")
    found = identify_arm(smooth, "arm", runs=1, seed=0, effects=effects)
    plan, robot = plan_trial(smooth), smooth.models["arm"]
    arm, inertia = plan.arms["arm"], np.diag(smooth.physics.arms["arm"].motor_inertia_reduced)

    def expected(q):
        terms = robot.terms(q, np.zeros(offset.size))
        joints = np.linalg.solve(terms.mass_matrix + inertia, offset)
        return -np.append(terms.jacobian @ joints, joints[0])

    at_impact = smooth.arms["arm"].position
    for rows, path, posture in (
        (found.ante.rows, arm.ante_position, arm.ante_posture),
        (found.post.rows, arm.post_position, arm.post_posture),
    ):
        end = pin.SE3(arm.orientation[-1], path.position[-1])
        at_end = robot.inverse_kinematics(end, {0: float(posture.position[-1, 0])}, at_impact)
        for samples, q in ((rows[88:93], at_impact), (rows[-12:], at_end)):
            for task in (slice(3), slice(3, 6), slice(6, 7)):
                tolerance = 0.04 * np.linalg.norm(expected(q)[task]) + 0.02
                assert samples.mean(axis=0)[task] == pytest.approx(expected(q)[task], abs=tolerance)


@pytest.fixture(scope="module")
def brief(smooth):
    """A short approach: what is asked of it does not depend on the motion."""
    timing = smooth.scenario.timing.model_copy(update=BRIEF)
    return replace(smooth, scenario=smooth.scenario.model_copy(update={"timing": timing}))


def test_the_same_seed_identifies_the_same_and_another_does_not(brief):
    first, again, other = (identify_arm(brief, "arm", runs=1, seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_what_changes_the_jump_changes_nothing_in_the_compensation(brief):
    """An identification that hit the object would take the error of the impact map for friction."""
    heavier = model("object_mass", {"scale": 1.3}, "-")
    assert identify_arm(brief, "arm", runs=1, seed=0, effects=heavier) == identify_arm(brief, "arm", runs=1, seed=0)


def test_compensation_is_fed_forward_and_is_no_part_of_the_net_feedback(smooth):
    plan = plan_trial(smooth)
    extra = np.array([0.3, -0.2, 0.5, 1.0, -2.0, 0.7, 0.4])
    arm = replace(plan.arms["arm"], ante_friction=np.broadcast_to(extra, plan.arms["arm"].ante_friction.shape))
    plant = make_plant(plan, seed=0)
    measured = plant.measure().arms
    plant.close()
    in_window = round(smooth.scenario.timing.window[0] / smooth.scenario.timing.control_period) + 1
    controllers = Controller(plan), Controller(replace(plan, arms={"arm": arm}))
    without, with_it = (controller.update(in_window, measured)["arm"] for controller in controllers)
    assert np.any(without.net_feedback)
    assert np.array_equal(without.net_feedback, with_it.net_feedback)
    without, with_it = (controller.update(0, measured)["arm"] for controller in controllers)
    assert np.array_equal(without.feedback, with_it.feedback)
    terms = smooth.models["arm"].terms(measured["arm"].position, measured["arm"].velocity)
    inertia = terms.mass_matrix + np.diag(smooth.physics.arms["arm"].motor_inertia_reduced)
    joints = np.linalg.solve(inertia, with_it.torque - without.torque)
    assert np.append(terms.jacobian @ joints, joints[0]) == pytest.approx(extra, abs=1e-5)


def test_compensation_leaves_the_net_feedback_of_a_smooth_arm(smooth, compensated):
    net = {
        name: final_commands(scene)[-1].net_feedback[1]
        for name, scene in (("smooth", smooth), ("rough", rough_scene("identified")), ("compensated", compensated))
    }
    assert abs(net["rough"] - net["smooth"]) > 0.04
    assert abs(net["compensated"] - net["smooth"]) < 0.005


def test_compensated_friction_leaves_no_task_any_feedback_in_free_motion(smooth, compensated):
    """Not even the share that lags behind: it would be a few percent, and a pad that sticks would hold it."""

    def approach(scene):
        rows = run_free_motion(plan_trial(scene), "arm", "ante", scene.physics, seed=3)[300:880]
        return np.sqrt(np.mean(rows.reshape(-1, 20, 7).mean(axis=1) ** 2, axis=0))

    noise, rough, left = (approach(scene) for scene in (smooth, rough_scene("identified"), compensated))
    assert np.all(rough > 5.0 * noise)
    assert np.all(left < 0.07 * rough + 2.0 * noise)


def test_the_nodes_plan_the_same_compensation(compensated):
    plan = plan_trial(compensated)
    info = TrialInfo.of(plan, TrialKey("cat_food", "case_2", 1.0, 0), 0, "nodes")
    again = info.spec.plan.arms["arm"]
    assert np.array_equal(again.ante_friction, plan.arms["arm"].ante_friction)
    assert np.array_equal(again.post_friction, plan.arms["arm"].post_friction)
    assert np.any(again.post_friction)


def test_a_set_that_was_not_identified_is_refused(compensated):
    with pytest.raises(InputError, match=r"juice case_1; it has: cat_food case_2"):
        plan_trial(Scene.resolve(compensated.scenario, "juice", "case_1"))


def test_identification_needs_a_run_and_an_impact_to_serve(smooth):
    with pytest.raises(InputError, match="runs = 0"):
        identify_arm(smooth, "arm", runs=0, seed=0)
    with pytest.raises(InputError, match="hits nothing"):
        identify_arm(scene_of("excite", "none", "fast"), "arm", runs=1, seed=0)
