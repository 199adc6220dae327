# SPDX-License-Identifier: Apache-2.0
"""A planted transform is found again from hits; what they do not determine stays as given, with a remark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from known_recordings import ARM

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.recordings.checks.plausibility import (
    check_gravity_torque,
    check_object,
    check_touch,
    gravity_torques,
    height_on_support,
    noticed,
)
from impact_rs_trials.recordings.contact_frame import PadOnFace, contact_frame
from impact_rs_trials.recordings.experiment import RunRow
from impact_rs_trials.recordings.laboratory import Laboratory
from impact_rs_trials.recordings.laboratory_runs import read_one
from impact_rs_trials.recordings.pad_and_object import touches_of

from .conftest import LaboratoryFolder

SIZE = np.array([0.25, 0.18, 0.16])
WORLD = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2.4), np.array([1.3, -0.7, 0.25]))  # of the motion capture, in A
GIVEN, NO_YAW = np.zeros(3), 0.0


def touch(direction: float, beside: float = 0.01, apart: float = 0.0, tilt: float = 0.0, number: int = 0) -> PadOnFace:
    """A pad that goes in a direction [rad], beside the middle of the face and apart from it [m], and tilted [rad]."""
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, direction)
    centre = np.array([0.4, -0.1, 0.48]) + turn @ [0.0, 0.05 * number, 0.0]
    normal = turn[:, 0]
    pad = centre - normal * (SIZE[1] / 2.0 + apart) + beside * turn[:, 1] + [0.0, 0.0, 0.02]
    axes = turn @ pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 2.0)  # the face is that of the object's y axis
    seen = WORLD.inverse() * pin.SE3(axes, centre)
    way = 0.05 * turn[:2, 0]
    tilted = pin.rpy.rpyToMatrix(0.0, 0.0, tilt) @ normal
    return PadOnFace(
        run=f"run_{number}", pad=np.tile(pad, (3, 1)), pad_normal=np.tile(tilted, (3, 1)),
        position=np.tile(seen.translation, (3, 1)), rotation=np.tile(seen.rotation, (3, 1, 1)), size=SIZE,
        standing=0.48, standing_height=float(seen.translation[2]), pad_displacement=way,
        object_displacement=(WORLD.rotation.T @ np.append(way, 0.0))[:2],
    )  # fmt: skip


def scattered(rng: np.random.Generator, directions: Sequence[float], apart: float, tilt: float) -> list[PadOnFace]:
    """Pads that are apart [m] and tilted [rad] at random."""
    return [
        touch(direction, apart=rng.normal(0.0, apart), tilt=rng.normal(0.0, tilt), number=number)
        for number, direction in enumerate(directions)
    ]


def test_hits_in_several_directions_tell_everything() -> None:
    touches = [touch(direction, number=n) for n, direction in enumerate((-1.6, -1.5, -0.4, 0.3))]
    found = contact_frame(touches, GIVEN, NO_YAW)
    np.testing.assert_allclose(found.position, WORLD.translation, atol=1e-8)
    assert found.yaw == pytest.approx(2.4, abs=1e-9)
    assert found.undetermined is None
    assert found.scatter < 1e-8
    assert found.tilt < 1e-8
    assert "stays as given" not in str(found)


def test_across_hits_in_one_direction_the_position_stays_as_given() -> None:
    touches = [touch(-np.pi / 2.0, number=number) for number in range(4)]
    given = np.array([1.25, 0.3, 9.0])
    found = contact_frame(touches, given, NO_YAW)
    np.testing.assert_allclose(found.position, [1.25, -0.7, 0.25], atol=1e-6)
    assert found.yaw == pytest.approx(2.4, abs=1e-6)
    assert np.abs(found.undetermined) == pytest.approx([1.0, 0.0], abs=1e-6)
    assert found.error[0] < 1e-6
    assert "the position stays as given: all hits are across that direction" in str(found)
    assert "in 4 hits: position [1.2500, -0.7000, 0.2500] m, yaw 2.4000 rad" in str(found)


def test_scatter_of_the_hits_is_that_of_the_answer() -> None:
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(60):
        touches = scattered(rng, (-1.6, -1.6, -1.6, 0.0, 0.0, 0.0), 0.002, 0.02)
        found = contact_frame(touches, GIVEN, NO_YAW)
        off = np.append(found.position[:2] - WORLD.translation[:2], found.yaw - 2.4)
        errors.append(off / found.error)
        assert found.scatter < 0.006
    assert 0.6 < np.std(errors) < 1.3


@pytest.mark.parametrize(("directions", "unknowns"), [((-1.6, -0.4, 0.3, 1.0), 3), ((-1.6, -1.6, -1.6, -1.6), 2)])
def test_every_unknown_takes_one_degree_of_freedom(directions: tuple[float, ...], unknowns: int) -> None:
    """The same hits three times have three times the squares: the variance goes as 1 / (numbers - unknowns)."""
    touches = scattered(np.random.default_rng(3), directions, 0.01, 0.1)
    once, thrice = contact_frame(touches, GIVEN, NO_YAW), contact_frame(3 * touches, GIVEN, NO_YAW)
    np.testing.assert_allclose(thrice.position, once.position, atol=1e-7)
    freedom = np.array([2 * len(touches) - unknowns, 6 * len(touches) - unknowns])
    np.testing.assert_allclose(thrice.error**2 * freedom[1], once.error**2 * freedom[0], rtol=1e-5)


def test_objects_that_do_not_move_leave_the_yaw_to_start_from() -> None:
    still = [replace(touch(-1.5), object_displacement=np.zeros(2))]
    assert contact_frame(still, GIVEN, 2.3).yaw == pytest.approx(2.4, abs=1e-6)
    quarter = np.pi / 2.0  # a box looks the same from its other faces
    assert contact_frame(still, GIVEN, 2.4 + quarter).yaw == pytest.approx(2.4 - 3.0 * quarter, abs=1e-6)


def test_without_a_hit_there_is_nothing_to_tell() -> None:
    with pytest.raises(InputError, match="motion_capture.estimate: no hit has both"):
        contact_frame([], GIVEN, NO_YAW)


def pushed(laboratory: LaboratoryFolder, start: float = 0.0) -> np.ndarray:
    """The box goes with the pad from a time on [s], and is seen in the planted world; its centre in A, ``(p, 3)``."""
    signals = laboratory.signals
    poses, centres = [], []
    for moment in 1e-9 * signals.object_time:
        row = round(1e3 * max(moment, start))
        pad = ARM.placement(signals.position[min(row, len(signals.position) - 1)])
        normal = pad.rotation[:, 2]
        yaw = np.arctan2(normal[1], normal[0]) + np.pi / 2.0
        centre = pad.translation + 0.09 * np.append(normal[:2] / np.linalg.norm(normal[:2]), 0.0)
        centre[2] = 0.485
        centres.append(centre)
        placed = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, yaw), centre)
        poses.append(pin.SE3ToXYZQUAT(WORLD.inverse() * placed))
    laboratory.change(pose=np.array(poses))
    return np.array(centres)


def test_an_experiment_finds_the_world_of_its_motion_capture(laboratory: LaboratoryFolder) -> None:
    centres = pushed(laboratory)
    laboratory.bag()
    assert "pose in another frame" in laboratory.refusal()
    normal = ARM.placement(laboratory.signals.position[460]).rotation[:2, 2]
    off = WORLD.translation[:2] + 0.2 * normal / np.linalg.norm(normal)  # one hit fixes the position along its way
    laboratory.experiment["motion_capture"] = {"estimate": True, "position": [*map(float, off), 0.0]}
    (run,) = laboratory.read()
    np.testing.assert_allclose(run.signals.object_position, centres[: len(run.signals.object_position)], atol=0.01)
    remark = next(one for one in run.remarks if one.startswith("motion capture placed from contact in 1 hits"))
    assert "stays as given" in remark
    alone = read_one(laboratory.path, laboratory.load(), "run_1", map)
    np.testing.assert_array_equal(alone.signals.object_position, run.signals.object_position)


def test_the_frame_is_estimated_on_the_clock_of_the_joints(laboratory: LaboratoryFolder) -> None:
    """Kills: poses at the stamps of the tracker's own clock, with which pad and face of two moments are compared."""
    laboratory.change(position=2.0 * laboratory.signals.position[400] - laboratory.signals.position)
    laboratory.change(velocity=-laboratory.signals.velocity)
    pushed(laboratory, start=0.4)
    laboratory.experiment["motion_capture"] = {"estimate": True, "position": [1.3, -0.7, 0.0]}
    time, frames = laboratory.signals.object_time, []
    for late, clock in ((0, "shared"), (150_000_000, "own")):
        laboratory.change(object_time=time + late)
        laboratory.mapping({"object_pose": {"clock": clock}})
        run = RunRow(laboratory.bag(clock), "parcel", True, "")
        (touch,) = touches_of((Laboratory.of(laboratory.load()), run))
        frames.append(contact_frame([touch], WORLD.translation, 2.4))
    shared, own = frames
    assert own.yaw == pytest.approx(shared.yaw, abs=1e-3)
    np.testing.assert_allclose(own.position, shared.position, atol=1e-3)


# ---- physics tells wrong frames, wrong signs and forgotten gravity from right ones ----------------------------------


SCENE_FILE = load_scenario("push")
SCENE = Scene.resolve(SCENE_FILE, "parcel", "case_1")
MODEL, STATE = SCENE.models["arm"], SCENE.arms["arm"]
RUN = Path("run_1")
TOUCHING = np.append(SCENE.object.position, [0.0, 0.0, 0.0, 1.0])  # the pad's middle lies on the object's face


def doubt_of_touch(offset: float, quaternion: np.ndarray | None = None) -> list[str]:
    """The check of an object that is ``offset`` [m] further along -y than where the pad touches it."""
    pose = TOUCHING + [0.0, -offset, 0.0, 0.0, 0.0, 0.0, 0.0]
    if quaternion is not None:
        pose[3:] = quaternion
    return check_touch(RUN, SCENE_FILE, MODEL, "parcel", STATE.position[None], pose[None])


def test_a_pad_that_touches_says_nothing() -> None:
    assert doubt_of_touch(0.0) == doubt_of_touch(0.004) == doubt_of_touch(-0.004) == []


@pytest.mark.parametrize(("offset", "said"), [(0.02, "20.0 mm short of"), (-0.02, "20.0 mm inside")])
def test_the_distance_between_pad_and_object_is_noted(offset: float, said: str) -> None:
    (remark,) = doubt_of_touch(offset)
    assert f"the middle of the pad is {said} 'parcel'" in remark


@pytest.mark.parametrize(
    ("offset", "said"), [(0.3, "never comes nearer to 'parcel' than 0.300 m"), (-0.07, "is 0.070 m inside 'parcel'")]
)
def test_a_pad_that_cannot_have_touched_is_refused(offset: float, said: str) -> None:
    with pytest.raises(InputError, match=f"run_1: the pad {said}: pose in another frame"):
        doubt_of_touch(offset)


def test_an_object_turned_a_quarter_is_met_at_another_depth() -> None:
    """0.25 m x 0.18 m: the face lies 35 mm nearer."""
    (remark,) = doubt_of_touch(0.0, np.array(pin.Quaternion(pin.utils.rotate("z", np.pi / 2.0)).coeffs()))
    assert "35.0 mm inside" in remark


def test_the_height_on_the_support_is_that_of_the_side_it_lies_on() -> None:
    lying = np.array(pin.Quaternion(pin.utils.rotate("x", np.pi / 2.0)).coeffs())
    pose = TOUCHING.copy()
    pose[2:] = [0.405 + 0.09, *lying]
    assert "does not point up" in check_object(RUN, SCENE.scenario, "arm", "parcel", np.zeros(1), pose[None])[0]
    pose[2] -= 0.06
    with pytest.raises(InputError, match=r"expected 0.495 m high on the support \(-0.060 m off\)"):
        check_object(RUN, SCENE.scenario, "arm", "parcel", np.zeros(1), pose[None])


def test_a_ball_is_as_high_and_as_far_whatever_its_axes() -> None:
    """Kills: a ball as the box of its extents, up to 0.73 radii too high and too near."""
    scenario = load_scenario("hit_ball")
    name, ball = next((name, item) for name, item in scenario.objects.items() if item.shape == "sphere")
    radius = ball.size[0] / 2.0
    rotation = pin.rpy.rpyToMatrix(np.pi / 4.0, np.arctan(np.sqrt(0.5)), 0.0)
    assert height_on_support(scenario, name, rotation) == pytest.approx(scenario.support.height + radius)
    pad = MODEL.placement(STATE.position)
    centre = pad.translation + radius * pad.rotation[:, 2]
    touching = pin.SE3ToXYZQUAT(pin.SE3(rotation @ pad.rotation, centre))
    assert check_touch(RUN, scenario, MODEL, name, STATE.position[None], touching[None]) == []


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
        check_gravity_torque(RUN, "torque", MODEL, position, torque, "why")
    else:
        with pytest.raises(
            InputError, match=rf"torque holds {times:.2f} times the gravity torque .* expected about 1: why"
        ):
            check_gravity_torque(RUN, "torque", MODEL, position, torque, "why")


def test_a_weight_is_noticed_in_proportion_to_the_arm() -> None:
    """About 1 N m of a Franka arm; of one with a tenth of the mass a tenth, so that its signs are checked as well."""
    links = [
        link.model_copy(update={"mass": link.mass / 10.0, "inertia": tuple(m / 10.0 for m in link.inertia)})
        for link in MODEL.facts.links
    ]
    light = RobotModel(MODEL.facts.model_copy(update={"links": tuple(links)}), MODEL.end_effector)
    assert noticed(MODEL) == pytest.approx(1.0, rel=1e-3)
    assert noticed(light) == pytest.approx(0.1, rel=1e-3)
