# SPDX-License-Identifier: Apache-2.0
"""Physics tells wrong frames, wrong signs and forgotten gravity from right ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.recordings.plausibility import check_object, check_touch, check_weight, gravity_torques, noticed

SCENE = Scene.resolve(load_scenario("push"), "parcel", "case_1")
MODEL, STATE = SCENE.models["arm"], SCENE.arms["arm"]
RUN = Path("run_1")
TOUCHING = np.append(SCENE.object.position, [0.0, 0.0, 0.0, 1.0])  # the pad's middle lies on the object's face
SIZE = SCENE.physics.object.size


def touch(offset: float, quaternion: np.ndarray | None = None) -> list[str]:
    """The check of an object that is ``offset`` [m] further along -y than where the pad touches it."""
    pose = TOUCHING + [0.0, -offset, 0.0, 0.0, 0.0, 0.0, 0.0]
    if quaternion is not None:
        pose[3:] = quaternion
    return check_touch(RUN, MODEL, "parcel", SIZE, STATE.position[None], pose[None])


def test_a_pad_that_touches_says_nothing() -> None:
    assert touch(0.0) == touch(0.004) == touch(-0.004) == []


@pytest.mark.parametrize(("offset", "said"), [(0.02, "20.0 mm short of"), (-0.02, "20.0 mm inside")])
def test_what_motion_capture_and_robot_disagree_by_is_said(offset: float, said: str) -> None:
    (remark,) = touch(offset)
    assert f"the middle of the pad is {said} 'parcel'" in remark


@pytest.mark.parametrize(
    ("offset", "said"), [(0.3, "never comes nearer to 'parcel' than 0.300 m"), (-0.07, "is 0.070 m inside 'parcel'")]
)
def test_a_pad_that_cannot_have_touched_is_refused(offset: float, said: str) -> None:
    with pytest.raises(InputError, match=f"run_1: the pad {said}: pose in another frame"):
        touch(offset)


def test_an_object_turned_a_quarter_is_met_at_another_depth() -> None:
    """0.25 m x 0.18 m: the face lies 35 mm nearer."""
    (remark,) = touch(0.0, np.array(pin.Quaternion(pin.utils.rotate("z", np.pi / 2.0)).coeffs()))
    assert "35.0 mm inside" in remark


def test_the_height_on_the_support_is_that_of_the_side_it_lies_on() -> None:
    lying = np.array(pin.Quaternion(pin.utils.rotate("x", np.pi / 2.0)).coeffs())
    pose = TOUCHING.copy()
    pose[2:] = [0.405 + 0.09, *lying]
    assert "does not point up" in check_object(RUN, SCENE.scenario, "arm", "parcel", np.zeros(1), pose[None])[0]
    pose[2] -= 0.06
    with pytest.raises(InputError, match=r"expected 0.495 m high on the support \(-0.060 m off\)"):
        check_object(RUN, SCENE.scenario, "arm", "parcel", np.zeros(1), pose[None])


def test_an_object_that_is_never_moved_is_noted() -> None:
    poses = np.tile(TOUCHING, (3, 1))
    (remark,) = check_object(RUN, SCENE.scenario, "arm", "parcel", 0.1 * np.arange(3), poses)
    assert "never moves by 2 mm" in remark
    poses[-1, 1] -= 0.1
    assert check_object(RUN, SCENE.scenario, "arm", "parcel", 0.1 * np.arange(3), poses) == []


@pytest.mark.parametrize(("times", "right"), [(1.0, True), (1.3, True), (0.0, False), (2.0, False), (-1.0, False)])
def test_torques_hold_the_weight_of_the_arm_once(times: float, right: bool) -> None:
    position = STATE.position + 0.1 * np.arange(3)[:, None]
    torque = times * gravity_torques(MODEL, position)
    if right:
        check_weight(RUN, "torque", MODEL, position, torque, "why")
    else:
        with pytest.raises(InputError, match=rf"torque holds {times:.2f} times the weight .* expected about 1: why"):
            check_weight(RUN, "torque", MODEL, position, torque, "why")


def test_a_weight_is_noticed_in_proportion_to_the_arm() -> None:
    """About 1 N m of a Franka arm; of one with a tenth of the mass a tenth, so that its signs are checked as well."""
    links = [
        link.model_copy(update={"mass": link.mass / 10.0, "inertia": tuple(m / 10.0 for m in link.inertia)})
        for link in MODEL.facts.links
    ]
    light = RobotModel(MODEL.facts.model_copy(update={"links": tuple(links)}), MODEL.end_effector)
    assert noticed(MODEL) == pytest.approx(1.0, rel=1e-3)
    assert noticed(light) == pytest.approx(0.1, rel=1e-3)
