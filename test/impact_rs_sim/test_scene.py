# SPDX-License-Identifier: Apache-2.0
"""The scene at the nominal impact, its nominal physics, and that no arm is in another, the table or the ground."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from trials import scene_of

from impact_rs_control.plan import plan_trial
from impact_rs_sim.clearance import LINK_RADIUS_M, capsules, check_clearance, deepest_penetration
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import MOTOR_INERTIA_MODELS, JointFriction, Load, LoadState, Physics
from impact_rs_sim.robots.robot import SigmoidFriction
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import CaseRobot
from impact_rs_sim.scene import BodyState, Scene, _impact_velocity

# ---- scene ----------------------------------------------------------------------------------------------------------

PUSH, GRAB, EXCITE = (load_scenario(name) for name in ("push", "grab", "excite"))


@pytest.mark.parametrize(("scenario", "case"), [(PUSH, "case_1"), (PUSH, "case_3"), (GRAB, "case_1"), (GRAB, "case_2")])
def test_arms_hit_with_velocity_and_pose_of_their_case_without_turning(scenario: Scenario, case: str) -> None:
    scene = Scene.resolve(scenario, "juice", case)
    for name, state in scene.arms.items():
        model, wanted = scene.models[name], scenario.cases[case].robots[name]
        twist = model.jacobian(state.position) @ state.velocity
        np.testing.assert_allclose(twist, [*wanted.ante_velocity, 0.0, 0.0, 0.0], atol=1e-9)
        assert state.position[0] == wanted.joint_1
        normal = model.placement(state.position).rotation[:, 2]
        np.testing.assert_allclose(normal, scenario.robots[name].impact.pad_normal, atol=1e-8)


def test_without_a_wish_for_joint_1_the_joints_move_as_little_as_they_can() -> None:
    scene = Scene.resolve(PUSH, "juice", "case_1")
    state, model = scene.arms["arm"], scene.models["arm"]
    jacobian = model.jacobian(state.position)
    still = np.linalg.svd(jacobian)[2][-1]
    np.testing.assert_allclose(jacobian @ still, 0.0, atol=1e-9)
    assert abs(still @ state.velocity) < 1e-9


def test_a_velocity_of_joint_1_is_kept_beside_that_of_the_end_effector() -> None:
    case = PUSH.cases["case_1"]
    robot = case.robots["arm"].model_copy(update={"joint_1_velocity": 0.2})
    changed = PUSH.model_copy(update={"cases": {"case_1": case.model_copy(update={"robots": {"arm": robot}})}})
    scene = Scene.resolve(changed, "juice", "case_1")
    state = scene.arms["arm"]
    assert state.velocity[0] == pytest.approx(0.2)
    twist = scene.models["arm"].jacobian(state.position) @ state.velocity
    np.testing.assert_allclose(twist, [*robot.ante_velocity, 0.0, 0.0, 0.0], atol=1e-9)


def with_case(scenario: Scenario, **changes: object) -> Scenario:
    """The scenario with one case of its only arm changed."""
    case = scenario.cases["case_1"]
    robot = CaseRobot(**(case.robots["arm"].model_dump() | changes))
    return scenario.model_copy(update={"cases": {"case_1": case.model_copy(update={"robots": {"arm": robot}})}})


def test_any_joint_may_resolve_the_redundancy_or_none() -> None:
    wanted = PUSH.robots["arm"].impact.placement
    other = with_case(PUSH, joint_1=None, posture={"joint_3": 0.4})
    free = with_case(PUSH, joint_1=None)
    for scenario, held in ((other, {2: 0.4}), (free, {})):
        scene = Scene.resolve(scenario, "juice", "case_1")
        q = scene.arms["arm"].position
        assert all(q[joint] == position for joint, position in held.items())
        found = scene.models["arm"].placement(q)
        np.testing.assert_allclose(found.translation, wanted.translation, atol=1e-9)
        np.testing.assert_allclose(found.rotation, wanted.rotation, atol=1e-9)


def test_a_pose_that_is_out_of_reach_is_told_with_its_keys_and_by_how_far() -> None:
    impact = PUSH.robots["arm"].impact.model_copy(update={"position": (0.43, -2.0, 0.485)})
    robot = PUSH.robots["arm"].model_copy(update={"impact": impact})
    far = PUSH.model_copy(update={"robots": {"arm": robot}})
    with pytest.raises(InputError, match=r"cases.case_1, robots.arm.impact .* nearest pose is 1\.\d+ m and .* rad off"):
        Scene.resolve(far, "juice", "case_1")


def test_an_unreachable_velocity_is_refused_with_the_amount_missed() -> None:
    """Two joints that slide along x and y, asked to move along z as well."""
    slides = SimpleNamespace(jacobian=lambda q, hand: np.eye(6)[:, :2], joint_count=2)
    np.testing.assert_allclose(
        _impact_velocity(slides, np.zeros(2), {"": np.array([0.3, -0.4, 0.0])}, None), [0.3, -0.4]
    )
    with pytest.raises(InputError, match=r"beyond these joints: the nearest velocity is off by 0\.5"):
        _impact_velocity(slides, np.zeros(2), {"": np.array([0.3, -0.4, 0.5])}, None)


@pytest.mark.parametrize("thing", PUSH.objects)
def test_a_pushed_object_stands_with_a_face_in_the_plane_of_the_pad(thing: str) -> None:
    scene = Scene.resolve(PUSH, thing, "case_1")
    size = np.array(PUSH.objects[thing].size)
    face = scene.object.position[1] + size[1] / 2.0
    assert face == pytest.approx(PUSH.robots["arm"].impact.position[1])
    assert scene.object.position[0] == pytest.approx(PUSH.robots["arm"].impact.position[0])
    assert scene.object.position[2] - size[2] / 2.0 == pytest.approx(PUSH.support.height)
    np.testing.assert_array_equal(scene.object.twist, 0.0)


@pytest.mark.parametrize("thing", GRAB.objects)
def test_both_pads_of_a_grab_touch_opposite_faces(thing: str) -> None:
    scene = Scene.resolve(GRAB, thing, "case_1")
    half = np.array(GRAB.objects[thing].size)[1] / 2.0
    for name, state in scene.arms.items():
        place = scene.models[name].placement(state.position)
        normal = place.rotation[:, 2]
        assert (scene.object.position - place.translation) @ normal == pytest.approx(half, abs=1e-8)


def test_a_gap_keeps_the_object_off_the_pad() -> None:
    scene = Scene.resolve(EXCITE, "none", "fast")
    pad = scene.models["arm"].placement(scene.arms["arm"].position)
    size = np.array(EXCITE.objects["none"].size)
    away = (scene.object.position - pad.translation) @ pad.rotation[:, 2]
    assert away == pytest.approx(np.abs(pad.rotation[:, 2]) @ size / 2.0 + EXCITE.object_gap)


def test_a_joint_that_would_have_to_be_too_fast_is_named() -> None:
    case = PUSH.cases["case_1"]
    robot = case.robots["arm"].model_copy(update={"ante_velocity": (0.0, -9.0, 0.0)})
    changed = PUSH.model_copy(update={"cases": {"case_1": case.model_copy(update={"robots": {"arm": robot}})}})
    with pytest.raises(InputError, match=r"case_1: arm 'arm' needs .* rad/s in joint \d, its limit is"):
        Scene.resolve(changed, "juice", "case_1")


def test_a_point_of_a_turning_body_moves_across_its_lever() -> None:
    body = BodyState(np.array([1.0, 2.0, 3.0]), np.eye(3), np.array([0.1, 0.2, 0.3, 0.0, 0.0, 2.0]))
    np.testing.assert_allclose(body.point_velocity(np.array([1.5, 2.0, 9.0])), [0.1, 0.2 + 1.0, 0.3])


# ---- nominal physics and joint friction -----------------------------------------------------------------------------

FRICTION = JointFriction(
    coulomb=np.array([0.5, 0.3]),
    viscous=np.array([0.2, 0.1]),
    stribeck=np.array([0.4, 0.6]),
    stribeck_velocity=np.array([0.1, 0.05]),
)


def test_far_from_rest_coulomb_and_viscous_friction_oppose_the_motion() -> None:
    for velocity in (2.0, -2.0):
        expected = -np.sign(velocity) * (FRICTION.coulomb + FRICTION.viscous * abs(velocity))
        np.testing.assert_allclose(FRICTION.torque(np.full(2, velocity)), expected, atol=1e-9)


def test_breakaway_excess_falls_to_1_over_e_at_the_stribeck_velocity() -> None:
    velocity = FRICTION.stribeck_velocity
    expected = FRICTION.coulomb + FRICTION.stribeck / np.e + FRICTION.viscous * velocity
    np.testing.assert_allclose(-FRICTION.torque(velocity), expected, rtol=1e-6)


def test_friction_vanishes_at_rest_and_is_full_soon_after() -> None:
    np.testing.assert_array_equal(FRICTION.torque(np.zeros(2)), 0.0)
    slow = FRICTION.torque(np.full(2, 4.0 * FRICTION.smoothing))
    full = FRICTION.coulomb + FRICTION.stribeck * np.exp(
        -np.square(4.0 * FRICTION.smoothing / FRICTION.stribeck_velocity)
    )
    np.testing.assert_allclose(-slow, full + FRICTION.viscous * 4.0 * FRICTION.smoothing, rtol=1e-3)


def test_identified_friction_is_the_published_sigmoid_against_the_motion() -> None:
    """Gaz et al. 2019: tau_f = a / (1 + exp(-b (dq + c))) - a / (1 + exp(-b c)); it vanishes at rest."""
    a, b, c = np.array([0.55, 0.87]), np.array([5.1, 9.1]), np.array([0.0395, 0.0258])
    friction = replace(JointFriction.none(2), sigmoid=SigmoidFriction(a=tuple(a), b=tuple(b), c=tuple(c)))
    np.testing.assert_allclose(friction.torque(np.zeros(2)), 0.0, atol=1e-15)
    rest = a / (1.0 + np.exp(-b * c))
    np.testing.assert_allclose(friction.torque(np.full(2, 50.0)), rest - a, rtol=1e-9)
    np.testing.assert_allclose(friction.torque(np.full(2, -50.0)), rest, rtol=1e-9)
    step = 1e-6
    slope = (friction.torque(np.full(2, step)) - friction.torque(np.full(2, -step))) / (2.0 * step)
    np.testing.assert_allclose(slope, -b * rest * (1.0 - rest / a), rtol=1e-6)


def test_no_friction_is_none_and_any_part_of_it_is_some() -> None:
    none = JointFriction.none(2)
    assert none.is_zero
    assert not np.any(none.torque(np.array([1.0, -3.0])))
    for name in ("coulomb", "viscous", "stribeck"):
        assert not replace(none, **{name: np.array([0.0, 0.1])}).is_zero
    sigmoid = SigmoidFriction(a=(0.1, 0.1), b=(5.0, 5.0), c=(0.0, 0.0))
    assert not replace(none, sigmoid=sigmoid).is_zero


def test_the_three_motor_inertias_are_those_of_the_scenario() -> None:
    arm = Physics.nominal(PUSH, "juice").arms["arm"]
    drive = PUSH.robots["arm"].drive
    expected = {"reduced": drive.motor_inertia_reduced, "rotor": drive.motor_inertia_rotor, "zero": np.zeros(7)}
    assert set(expected) == set(MOTOR_INERTIA_MODELS)
    for name, values in expected.items():
        np.testing.assert_array_equal(arm.motor_inertia(name), values)


def test_nominal_physics_takes_each_number_from_its_own_key() -> None:
    robot = PUSH.robots["arm"]
    pad = robot.end_effector.pad.model_copy(update={"stiffness": 1.2e5, "damping": 77.0})
    drive = robot.drive.model_copy(
        update={
            "stiffness": tuple(np.linspace(1e4, 2e4, 7)),
            "damping": tuple(np.linspace(1.0, 2.0, 7)),
            "actuation_delay": 0.002,
        }
    )
    end_effector = robot.end_effector.model_copy(update={"pad": pad})
    scenario = PUSH.model_copy(
        update={
            "robots": {"arm": robot.model_copy(update={"end_effector": end_effector, "drive": drive})},
            "contact": PUSH.contact.model_copy(update={"friction": 0.61, "restitution": 0.2}),
            "support": PUSH.support.model_copy(update={"friction": 0.17, "height": 0.3}),
        }
    )
    physics = Physics.nominal(scenario, "juice")
    arm = physics.arms["arm"]
    assert (physics.pad_friction, physics.restitution) == (0.61, 0.2)
    assert (physics.support_friction, physics.support_height) == (0.17, 0.3)
    assert (arm.pad_stiffness, arm.pad_damping, arm.actuation_delay) == (1.2e5, 77.0, 0.002)
    np.testing.assert_array_equal(arm.stiffness, drive.stiffness)
    np.testing.assert_array_equal(arm.damping, drive.damping)
    np.testing.assert_array_equal(arm.torque_gain, 1.0)
    np.testing.assert_array_equal(arm.torque_offset, 0.0)
    np.testing.assert_allclose(physics.gravity, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(arm.impact_position, robot.impact.position)


def test_a_box_has_the_moments_of_a_homogeneous_one() -> None:
    """m / 12 (y^2 + z^2) about x, and so on; by summing over a grid of points."""
    thing = Physics.nominal(PUSH, "juice").object
    axes = [(np.arange(60) + 0.5) / 60.0 * size - size / 2.0 for size in thing.size]
    x, y, z = (values.ravel() for values in np.meshgrid(*axes, indexing="ij"))
    grid = [np.mean(y**2 + z**2), np.mean(x**2 + z**2), np.mean(x**2 + y**2)]
    np.testing.assert_allclose(thing.inertia, thing.mass * np.array(grid), rtol=1e-3)


def test_the_robot_model_feels_the_gravity_of_its_physics() -> None:
    physics = Physics.nominal(PUSH, "juice")
    q = np.array(PUSH.robots["arm"].impact.joint_guess)
    level = physics.robot_model("arm").gravity_torque(q)
    assert np.abs(level).max() > 5.0
    upside_down = replace(physics, gravity=-physics.gravity).robot_model("arm")
    np.testing.assert_allclose(upside_down.gravity_torque(q), -level, atol=1e-9)
    none = replace(physics, gravity=np.zeros(3)).robot_model("arm")
    np.testing.assert_allclose(none.gravity_torque(q), 0.0, atol=1e-9)


def test_a_load_that_says_nothing_does_nothing() -> None:
    state = LoadState(0.0, np.zeros(7), np.zeros(7), np.zeros(3), np.zeros(3), np.zeros(3))
    assert (Load().motor_torque(state), Load().joint_torque(state), Load().end_effector_force(state)) == (None,) * 3


# ---- clearance ------------------------------------------------------------------------------------------------------

SCENE = scene_of("grab", "juice", "case_1")
POSITIONS = {name: state.position for name, state in SCENE.arms.items()}


def test_the_hull_ends_at_the_pad_and_has_no_gap() -> None:
    model = SCENE.models["left"]
    hull = capsules(model, POSITIONS["left"])
    ends = []
    for _, shape, place in hull:
        along = place.getRotation()[:, 2] * shape.halfLength
        ends.append((place.getTranslation() - along, place.getTranslation() + along))
    for (_, end), (start, _) in zip(ends, ends[1:], strict=False):
        np.testing.assert_allclose(end, start, atol=1e-9)
    pad = model.placement(POSITIONS["left"])
    np.testing.assert_allclose(ends[-1][1] + LINK_RADIUS_M * pad.rotation[:, 2], pad.translation, atol=1e-9)


def test_an_arm_inside_another_is_named_with_its_links_and_by_how_much() -> None:
    left = SCENE.models["left"]
    facts, effector = SCENE.physics.arms["left"].facts, SCENE.physics.arms["left"].end_effector
    shifted = RobotModel(
        facts, effector, pin.SE3(left.base.rotation, left.base.translation + np.array([0.0, -0.1, 0.0]))
    )
    positions = {"left": POSITIONS["left"], "right": POSITIONS["left"]}
    with pytest.raises(InputError, match=r"'left' and 'right' collide at the impact: \w+ and \w+ overlap by 0\.\d+ m"):
        check_clearance({"left": left, "right": shifted}, positions, "at the impact")


def test_bases_too_close_are_refused_before_the_trial() -> None:
    scenario = load_scenario("grab")
    content = scenario.model_dump()
    content["robots"]["left"]["base"]["position"] = [0.0, 0.05, 0.0]
    content["robots"]["right"]["base"]["position"] = [0.0, -0.05, 0.0]
    with pytest.raises(InputError, match="collide|reach"):
        plan_trial(Scene.resolve(type(scenario).model_validate(content), "juice", "case_1"))


def poses(scene: Scene, name: str = "arm") -> tuple[np.ndarray, np.ndarray]:
    """The pose of an arm at the impact, as a path of one sample."""
    return scene.arms[name].position[None], np.zeros(3)


@pytest.mark.parametrize("depth", [0.005, 0.015])
def test_a_pad_in_the_table_where_the_object_stands_is_found_with_its_depth(depth: float) -> None:
    """Raised by so much that the lower edge of the pad, 30 mm above it, is below its surface."""
    push = scene_of("push", "cat_food", "case_1")
    positions, way = poses(push)
    physics, place = push.physics, push.object.position
    assert deepest_penetration(physics, "arm", positions, push.object, way) is None
    raised = replace(physics, support_height=physics.support_height + 0.03 + depth)
    found = deepest_penetration(raised, "arm", positions, push.object, way)
    assert found is not None
    assert (found.part, found.partner, found.index) == ("its pad", "support", 0)
    assert found.depth == pytest.approx(depth, abs=1e-6)
    away = replace(push.object, position=place - [0.0, 0.1, 0.0])  # nobody knows whether the table reaches there
    assert deepest_penetration(raised, "arm", positions, away, way) is None
    assert deepest_penetration(raised, "arm", positions, away, np.array([0.0, 0.1, 0.0])) == found
    aside = replace(raised, support_size=(0.2, 0.2))  # ends before the object
    assert deepest_penetration(aside, "arm", positions, push.object, way) is None


def test_a_link_below_the_ground_is_found_and_the_mounting_is_not() -> None:
    push = scene_of("push", "cat_food", "case_1")
    positions, way = poses(push)
    model, physics = push.models["arm"], push.physics
    folded = positions.copy()
    folded[0, 1] = 2.0  # the shoulder lays the upper arm below the horizontal
    found = deepest_penetration(physics, "arm", folded, push.object, way)
    assert found is not None and found.partner == "ground"
    lowest = min(place.translation[2] for place in model.link_placements(folded[0]).values())
    assert -lowest < found.depth < -lowest + 0.2
    sunk = replace(
        physics, arms={"arm": replace(physics.arms["arm"], base=pin.SE3(np.eye(3), np.array([0, 0, -0.01])))}
    )
    assert deepest_penetration(sunk, "arm", positions, push.object, way) is None


@pytest.mark.parametrize("name", ["push", "push_fr3", "push_iiwa7", "push_ur5e", "grab", "grab_fr3", "excite"])
def test_shipped_scenarios_keep_clear_of_support_and_ground(name: str) -> None:
    scenario = load_scenario(name)
    for item in scenario.objects:
        for case in scenario.cases:
            plan_trial(Scene.resolve(scenario, item, case))
