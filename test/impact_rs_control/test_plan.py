# SPDX-License-Identifier: Apache-2.0
"""Plans: references that jump by the impact map, wrenches, compensation; limits of an arm."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from trials import scene_of

from impact_rs_control.arm_limits import MAX_MEASURED_TORQUE_RATIO, rate_limited, state_complaint, torque_complaint
from impact_rs_control.plan import TrialPlan, _pushing_wrench, plan_trial, tick_times
from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, settle
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.friction_compensation import TASKS, AccelerationSamples, ArmFriction, FrictionCompensation
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.spec import TrialSpec

# ---- plans ----------------------------------------------------------------------------------------------------------

PUSH = scene_of("push", "juice", "case_1")
GRAB = scene_of("grab", "juice", "case_1")
EXCITE = scene_of("excite", "none", "fast")
GRAVITY = 9.81  # m/s^2
SCALE = 0.8


@pytest.fixture(scope="module")
def push() -> TrialPlan:
    return plan_trial(PUSH, SCALE)


@pytest.fixture(scope="module")
def grab() -> TrialPlan:
    return plan_trial(GRAB, SCALE)


@pytest.fixture(scope="module")
def excite() -> TrialPlan:
    return plan_trial(EXCITE)


def at_impact(plan: TrialPlan) -> int:
    timing = plan.scene.scenario.timing
    return round(timing.nominal_impact / timing.control_period)


def test_references_follow_the_settled_contact_where_the_scenario_says_so(grab: TrialPlan) -> None:
    scenario = GRAB.scenario
    control = scenario.control.model_copy(update={"reference_contact": "settled"})
    scene = Scene.resolve(scenario.model_copy(update={"control": control}), "juice", "case_1")
    plan = plan_trial(scene, SCALE)
    answer = settle(ImpactProblem.at_nominal_impact(scene))
    for name, arm in plan.arms.items():
        wanted = SCALE * answer.end_effector_twist[name][:3]
        np.testing.assert_allclose(arm.post_position.velocity[at_impact(plan)], wanted, atol=1e-9)
    assert abs(plan.predicted_post_velocity - grab.predicted_post_velocity) > 1e-3


@pytest.mark.parametrize("scene", [PUSH, GRAB], ids=["push", "grab"])
@pytest.mark.parametrize("motor", ["reduced", "zero"])
def test_references_jump_by_the_impact_map_times_the_scale(scene: Scene, motor: str) -> None:
    plan = plan_trial(scene, SCALE, motor)
    answer = compute_impact_map(ImpactProblem.at_nominal_impact(scene, motor), "exact")
    tick = at_impact(plan)
    for name, arm in plan.arms.items():
        state = scene.arms[name]
        before = scene.models[name].jacobian(state.position)[:3] @ state.velocity
        np.testing.assert_allclose(arm.ante_position.velocity[tick], before, atol=1e-9)
        np.testing.assert_allclose(
            arm.post_position.velocity[tick], SCALE * answer.end_effector_twist[name][:3], atol=1e-9
        )
        np.testing.assert_allclose(arm.ante_posture.velocity[tick], state.velocity[0], atol=1e-9)
        np.testing.assert_allclose(arm.post_posture.velocity[tick], SCALE * answer.joint_velocity[name][0], atol=1e-9)
        np.testing.assert_allclose(arm.approach_direction, before / np.linalg.norm(before), atol=1e-12)
    axis = scene.scenario.axis_index
    mean = np.mean([twist[axis] for twist in answer.end_effector_twist.values()])
    assert plan.predicted_post_velocity == pytest.approx(mean)
    assert plan.reference_post_velocity == pytest.approx(SCALE * mean)
    before = [robot.ante_velocity[axis] for robot in scene.scenario.cases["case_1"].robots.values()]
    assert plan.ante_velocity == pytest.approx(np.mean(before))


def test_a_pushed_box_gets_support_friction_and_inertial_force(push: TrialPlan) -> None:
    """f_d = m a_d + mu m g v_d / |v_d| in the plane: what the box needs to follow the reference across the table."""
    arm, thing = push.arms["arm"], PUSH.physics.object
    plane = np.array([1.0, 1.0, 0.0])
    velocity, acceleration = arm.post_position.velocity * plane, arm.post_position.acceleration * plane
    moving = np.linalg.norm(velocity, axis=1) > 1e-3
    direction = velocity[moving] / np.linalg.norm(velocity[moving], axis=1, keepdims=True)
    needed = thing.mass * acceleration[moving] + PUSH.physics.support_friction * thing.mass * GRAVITY * direction
    assert (-needed[:, 1]).min() > 0.0
    assert np.abs(needed[:, 0]).max() > 0.1  # the predicted velocity has a part across the normal
    np.testing.assert_allclose(arm.wrench[moving, :3], needed, atol=1e-9)


def test_arms_that_push_one_box_share_its_mass(push: TrialPlan) -> None:
    """Kills the whole mass for each of them."""
    arm = push.arms["arm"]
    both = replace(PUSH, arms=dict.fromkeys(("arm", "other"), PUSH.arms["arm"]))
    np.testing.assert_allclose(2.0 * _pushing_wrench(both, "arm", arm.post_position), arm.wrench, atol=1e-12)


def test_the_force_on_a_pushed_box_does_not_turn_it(push: TrialPlan) -> None:
    """Moments cancel about the vertical through the centre of mass; tipping is kept by the support."""
    arm = push.arms["arm"]
    place = PUSH.scenario.impact_placement("arm", PUSH.object_name).translation
    about_centre = arm.wrench[:, 3:] + np.cross(place - PUSH.object.position, arm.wrench[:, :3])
    assert np.abs(arm.wrench[:, 5]).max() > 0.01
    np.testing.assert_allclose(about_centre[:, 2], 0.0, atol=1e-9)
    np.testing.assert_array_equal(arm.wrench[:, 3:5], 0.0)


def test_a_pad_passes_on_no_more_than_its_friction() -> None:
    physics: Physics = replace(PUSH.physics, pad_friction=0.02)
    wrench = plan_trial(replace(PUSH, physics=physics), SCALE).arms["arm"].wrench
    assert np.all(np.abs(wrench[:, 0]) <= 0.02 * -wrench[:, 1] + 1e-12)
    assert np.any(np.abs(wrench[:, 0]) > 0.99 * 0.02 * -wrench[:, 1])


def test_a_hanging_box_has_no_friction_and_a_slowing_box_no_pull() -> None:
    physics: Physics = replace(PUSH.physics, support_height=None)
    plan = plan_trial(replace(PUSH, physics=physics), SCALE)
    along = plan.arms["arm"].post_position.acceleration @ np.array([0.0, -1.0, 0.0])
    assert along.min() < -0.1
    expected = PUSH.physics.object.mass * np.maximum(along, 0.0)
    np.testing.assert_allclose(-plan.arms["arm"].wrench[:, 1], expected, atol=1e-9)


def test_two_arms_share_the_weight_and_clamp_with_opposite_forces(grab: TrialPlan) -> None:
    """Sum of both: m (a_d - g); each along its pad's normal: the clamping force and its share of that."""
    clamp, mass = GRAB.scenario.control.clamp_force, GRAB.physics.object.mass
    left, right = grab.arms["left"], grab.arms["right"]
    np.testing.assert_allclose(left.pad_normal, -right.pad_normal)
    total = left.wrench[:, :3] + right.wrench[:, :3]
    common = (left.post_position.acceleration + right.post_position.acceleration) / 2.0
    np.testing.assert_allclose(total, mass * (common + [0.0, 0.0, GRAVITY]), atol=1e-9)
    last = [arm.wrench[-1, :3] @ arm.pad_normal for arm in (left, right)]
    np.testing.assert_allclose(last, clamp, atol=1e-6)
    np.testing.assert_allclose(left.wrench[-1, 2], mass * GRAVITY / 2.0, atol=1e-6)


def test_an_arm_that_waits_is_approached_along_its_pads_normal() -> None:
    """Kills a direction 0 / 0, with which it never detects that it is hit."""
    content = GRAB.scenario.model_dump(mode="json")
    content["cases"][GRAB.case_name]["robots"]["right"]["ante_velocity"] = [0.0, 0.0, 0.0]
    waits = TrialSpec.of(Scenario.model_validate(content), GRAB.object_name, GRAB.case_name).plan.arms["right"]
    np.testing.assert_array_equal(waits.approach_direction, waits.pad_normal)


def test_an_excursion_without_speed_is_refused() -> None:
    """Kills legs of infinite duration."""
    content = load_scenario("excite").model_dump(mode="json")
    next(iter(content["cases"].values()))["robots"]["arm"]["ante_velocity"] = [0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match=r"robots\.arm\.ante_velocity is 0: expected the excursion's peak speed"):
        Scenario.model_validate(content)


def test_pads_that_clamp_a_box_rise_and_the_lift_is_that_of_their_mean(grab: TrialPlan, push: TrialPlan) -> None:
    tick = at_impact(grab)
    heights = [arm.post_position.position[[tick, -1], 2] for arm in grab.arms.values()]
    lift = np.mean([end - start for start, end in heights])
    assert grab.expected_lift == pytest.approx(lift)
    assert lift > 0.05
    assert push.expected_lift == 0.0


@pytest.mark.parametrize("name", ["push", "grab", "excite"])
def test_every_arm_starts_where_its_reference_does(name: str, request: pytest.FixtureRequest) -> None:
    plan: TrialPlan = request.getfixturevalue(name)
    for arm_name, arm in plan.arms.items():
        place = plan.scene.models[arm_name].placement(arm.initial)
        np.testing.assert_allclose(place.translation, arm.ante_position.position[0], atol=1e-7)
        np.testing.assert_allclose(place.rotation, arm.orientation[0], atol=1e-7)
        assert arm.initial[0] == pytest.approx(arm.ante_posture.position[0, 0], abs=1e-12)


def test_both_references_are_at_the_impact_pose_at_the_nominal_time(push: TrialPlan, grab: TrialPlan) -> None:
    """Paper eq. pos_refs_imp, for every arm."""
    for plan in (push, grab):
        tick = at_impact(plan)
        for name, arm in plan.arms.items():
            place = plan.scene.models[name].placement(plan.scene.arms[name].position)
            for path in (arm.ante_position, arm.post_position):
                np.testing.assert_allclose(path.position[tick], place.translation, atol=1e-8)
            np.testing.assert_allclose(arm.orientation[tick], place.rotation, atol=1e-8)


@pytest.mark.parametrize("scene", [PUSH, GRAB], ids=["push", "grab"])
def test_pads_end_where_the_scaled_common_motion_takes_them(scene: Scene) -> None:
    """Half of velocity times duration along the task's axis, with the mean over the arms of the predicted velocity."""
    plan = plan_trial(scene, SCALE)
    answer = compute_impact_map(ImpactProblem.at_nominal_impact(scene), "exact")
    axis, timing = scene.scenario.axis_index, scene.scenario.timing
    common = np.mean([twist[axis] for twist in answer.end_effector_twist.values()])
    for arm in plan.arms.values():
        way = arm.post_position.position[-1] - arm.post_position.position[at_impact(plan)]
        assert way[axis] == pytest.approx(SCALE * common * timing.push / 2.0, rel=1e-9)


def test_an_excursion_turns_and_peaks_at_the_speed_of_its_case(excite: TrialPlan) -> None:
    arm = excite.arms["arm"]
    settings = EXCITE.scenario.excursion
    assert settings is not None
    wanted = np.array(EXCITE.scenario.cases["fast"].robots["arm"].ante_velocity)
    speed = np.linalg.norm(arm.ante_position.velocity, axis=1)
    assert speed.max() == pytest.approx(np.linalg.norm(wanted), rel=1e-3)
    leg = EXCITE.scenario.excursion_leg(EXCITE.scenario.cases["fast"].robots["arm"])
    times = tick_times(EXCITE)
    there = int(np.searchsorted(times, settings.begin + leg + 0.5 * settings.rest))
    way = arm.ante_position.position[there] - arm.ante_position.position[0]
    np.testing.assert_allclose(way, np.subtract(settings.end, settings.start), atol=1e-6)
    np.testing.assert_allclose(arm.ante_position.position[-1], arm.ante_position.position[0], atol=1e-9)
    assert arm.ante_posture.position[there, 0] - arm.ante_posture.position[0, 0] == pytest.approx(settings.joint_1)
    turn = arm.orientation[there] @ arm.orientation[0].T
    np.testing.assert_allclose(pin.log3(turn), settings.twist * arm.pad_normal, atol=1e-9)
    assert not excite.expects_impact
    assert excite.predicted_post_velocity == 0.0


def test_the_rotation_reference_is_the_rate_of_the_orientation(excite: TrialPlan) -> None:
    """R_d(t + dt) = exp(w n dt) R_d(t), with the same n and w that the controller feeds forward."""
    arm = excite.arms["arm"]
    period = EXCITE.scenario.timing.control_period
    for tick in (250, 400, 700):
        turn = pin.log3(arm.orientation[tick + 1] @ arm.orientation[tick - 1].T) / (2.0 * period)
        np.testing.assert_allclose(turn, arm.rotation.velocity[tick, 0] * arm.pad_normal, atol=1e-4)


def test_a_compensation_is_planned_for_its_own_mode_and_time() -> None:
    """A feedforward that grows with time, another one before the impact than after it, between its samples as well."""
    period, duration = 0.01, PUSH.scenario.timing.duration
    taken = np.arange(int(duration / period + 1e-9) + 1)[:, None] * period
    slopes = {"ante": np.arange(1.0, len(TASKS) + 1.0), "post": -np.arange(1.0, len(TASKS) + 1.0)}
    friction = ArmFriction(**{name: AccelerationSamples.of(taken * slope) for name, slope in slopes.items()})
    compensation = FrictionCompensation(
        scenario=PUSH.scenario.name,
        scenario_digest=PUSH.scenario.digest,
        runs=1,
        seed=0,
        period=period,
        sets={PUSH.object_name: {PUSH.case_name: {"arm": friction}}},
    )
    scenario = PUSH.scenario.model_copy(update={"friction_compensation": compensation})
    arm = plan_trial(replace(PUSH, scenario=scenario)).arms["arm"]
    times = tick_times(PUSH)[:, None]
    np.testing.assert_allclose(arm.ante_friction, times * slopes["ante"], atol=1e-9)
    np.testing.assert_allclose(arm.post_friction, times * slopes["post"], atol=1e-9)
    without = plan_trial(PUSH).arms["arm"]
    assert not np.any(without.ante_friction)
    assert not np.any(without.post_friction)


PAD = "robots.arm.end_effector.pad"


def bouncing(**settings: float | None) -> Scene:
    """The push with another restitution and another pad."""
    keys = {"restitution": "contact.restitution", "damping": f"{PAD}.damping", "stiffness": f"{PAD}.stiffness"}
    changed = PUSH.scenario.with_settings({keys[name]: value for name, value in settings.items()})
    return Scene.resolve(changed, PUSH.object_name, PUSH.case_name)


def test_a_restitution_that_the_pad_does_not_have_is_refused_with_the_damping_that_gives_it() -> None:
    with pytest.raises(
        InputError, match=r"^contact\.restitution = 0\.5: the pad of 'arm' bounces off \w+ with 0\.20"
    ) as refused:
        plan_trial(bouncing(restitution=0.5))
    damping = re.search(rf"set {re.escape(PAD)}\.damping: (\d+\.?\d*) \[N s/m\]", str(refused.value))
    assert damping is not None
    plan = plan_trial(bouncing(restitution=0.5, damping=float(damping[1])))
    assert abs(plan.predicted_post_velocity) < 0.95 * abs(plan_trial(PUSH).predicted_post_velocity)


def test_a_rigid_pad_has_no_restitution() -> None:
    with pytest.raises(InputError, match="'arm' does not bounce, for it is rigid"):
        plan_trial(bouncing(restitution=0.5, stiffness=None))


def test_a_pad_that_goes_on_pushing_may_be_planned_without_restitution() -> None:
    assert plan_trial(bouncing(damping=0.0)).impact is not None


def pushed_at(height: float) -> Scene:
    """The push with the middle of the pad, which is 100 mm high, at another height; the table's top is at 0.405 m."""
    scenario = load_scenario("push").with_settings({"robots.arm.impact.position": [0.428, -0.061, height]})
    return Scene.resolve(scenario, "cat_food", "case_1")


@pytest.mark.parametrize(("height", "pad"), [(0.36, 0.095), (0.42, 0.035)])
def test_a_pad_below_the_table_is_refused_before_anything_moves(height: float, pad: float) -> None:
    """Named is what is deepest in it: the pad, or the flange, which is 23 mm thicker and follows the pad."""
    with pytest.raises(Infeasible, match=r"surface is at z = 0\.405 m, .*; raise robots\.arm\.impact") as refused:
        plan_trial(pushed_at(height))
    words = re.search(
        r"arm 'arm': (its pad|link 7) would be (\S+) m inside the support, .*, at (\S+) s of its reference",
        str(refused.value),
    )
    assert words is not None
    assert pad - 1e-3 < float(words[2]) < pad + 0.03
    timing = PUSH.scenario.timing
    assert timing.nominal_impact < float(words[3]) <= timing.duration


def test_a_link_that_comes_into_the_table_behind_the_pad_is_refused() -> None:
    """The flange is thicker than the pad is high, and goes where the object stood before it was pushed."""
    with pytest.raises(Infeasible, match=r"arm 'arm': link 7 would be 0\.0\d+ m inside the support"):
        plan_trial(pushed_at(0.452))


def test_an_excursion_into_the_ground_is_refused() -> None:
    changes = {"excursion.end": [0.0, 0.0, -0.5], "timing.duration": 5.0, "support.height": 0.01}
    down = load_scenario("excite").with_settings(changes)
    with pytest.raises(
        Infeasible, match=r"inside the ground, whose surface is at z = 0 m, at \d\.\d+ s of its reference"
    ):
        plan_trial(Scene.resolve(down, "none", "fast"))


def test_pads_that_grab_may_come_from_beside_and_below_the_table() -> None:
    """They start 0.1 m below its top; nobody says where it ends, and at the object they are above it."""
    scene = scene_of("grab", "cat_food", "case_2")
    plan = plan_trial(scene)
    lowest = min(arm.ante_position.position[0, 2] for arm in plan.arms.values())
    assert lowest < scene.scenario.support.height - 0.05


# ---- states and torques beyond the limits of an arm -----------------------------------------------------------------

PLAN = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
MODEL = PLAN.scene.models["arm"]
START = PLAN.arms["arm"].initial
JOINTS = [f"arm_joint{number + 1}" for number in range(7)]
STILL = np.zeros(7)


def at(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[index] = value
    return changed


def test_a_state_within_every_limit_is_no_complaint() -> None:
    assert state_complaint(MODEL, JOINTS, START, STILL, STILL) == ""
    assert (
        state_complaint(
            MODEL, JOINTS, MODEL.position_max, MODEL.velocity_max, -MAX_MEASURED_TORQUE_RATIO * MODEL.torque_max
        )
        == ""
    )


@pytest.mark.parametrize("beyond", [1e-6, 1.0, np.nan])
def test_a_joint_beyond_a_limit_is_told_by_name(beyond: float) -> None:
    high, low = MODEL.position_max[2] + beyond, MODEL.position_min[2] - beyond
    for position in (high, low):
        told = state_complaint(MODEL, JOINTS, at(START, 2, position), STILL, STILL)
        assert told.startswith("arm_joint3 at ") and told.endswith(f"to {MODEL.position_max[2]:.4g} rad")
    for velocity in (MODEL.velocity_max[5] + beyond, -MODEL.velocity_max[5] - beyond):
        told = state_complaint(MODEL, JOINTS, START, at(STILL, 5, velocity), STILL)
        assert told.startswith("arm_joint6 at ") and told.endswith(f"limit {MODEL.velocity_max[5]:.4g} rad/s")


@pytest.mark.parametrize("measured", [1e6, -1e6, np.nan])
def test_a_torque_that_no_impact_explains_is_no_measurement(measured: float) -> None:
    complaint = state_complaint(MODEL, JOINTS, START, STILL, at(STILL, 3, measured))
    assert complaint.startswith("arm_joint4 measures ") and complaint.endswith("more than 5 times its limit of 87 N m")


@pytest.mark.parametrize("beyond", [1e-3, np.nan, np.inf])
def test_a_torque_beyond_its_limit_is_told_by_name(beyond: float) -> None:
    assert torque_complaint(MODEL, JOINTS, MODEL.torque_max) == ""
    for torque in (MODEL.torque_max[1] + beyond, -MODEL.torque_max[1] - beyond):
        told = torque_complaint(MODEL, JOINTS, at(STILL, 1, torque))
        assert told.startswith("torque of ") and told.endswith(f"for arm_joint2, limit {MODEL.torque_max[1]:.4g} N m")


def test_a_torque_that_jumps_is_approached_at_the_largest_rate() -> None:
    before, wanted = np.array([0.0, 5.0, -5.0, 5.0]), np.array([0.5, 9.0, -9.0, 4.7])
    np.testing.assert_allclose(rate_limited(wanted, before, 1.0), [0.5, 6.0, -6.0, 4.7])
