# SPDX-License-Identifier: Apache-2.0
"""The scene at the nominal impact: pads at faces, objects on their support, velocities as the case wants them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.scenario import CaseRobot, Scenario, load_scenario
from impact_rs_sim.scene import BodyState, Scene, _impact_velocity

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
    slides = SimpleNamespace(jacobian=lambda q: np.eye(6)[:, :2], joint_count=2)
    np.testing.assert_allclose(_impact_velocity(slides, np.zeros(2), np.array([0.3, -0.4, 0.0]), None), [0.3, -0.4])
    with pytest.raises(InputError, match=r"beyond these joints: the nearest velocity is off by 0\.5"):
        _impact_velocity(slides, np.zeros(2), np.array([0.3, -0.4, 0.5]), None)


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
