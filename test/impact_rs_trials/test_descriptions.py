# SPDX-License-Identifier: Apache-2.0
"""The URDFs of a bag are kinematic: joints move them as /tf says, under the names of /ARM/joint_states."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin
import pybullet
import pytest
from trials import BRIEF, plan_of, recorded

from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

TOLERANCE = 1e-6  # m, and of rotation matrices


@pytest.fixture(scope="module", params=["push", "grab"])
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> TrialBag:
    """A quarter of a second with one arm, and with two."""
    path = tmp_path_factory.mktemp("descriptions") / request.param
    recorded(plan_of(request.param, "cat_food", "case_2", **BRIEF), path, seed=3)
    return TrialBag.open(path)


def urdf(bag: TrialBag, topic: str) -> str:
    (message,) = bag.messages(topic)
    return message.data


def stamp(header: Any) -> int:
    """When [ns]."""
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def transforms(bag: TrialBag) -> Iterator[tuple[int, dict[str, tuple[str, pin.SE3]]]]:
    """Time [ns]; parent and placement in it by frame."""
    (static,) = (message.transforms for message in bag.messages(topics.TF_STATIC))
    for message in bag.messages(topics.TF):
        found, time = {}, stamp(message.transforms[0].header)
        for item in (*static, *message.transforms):
            at, turn = item.transform.translation, item.transform.rotation
            rotation = pin.Quaternion(turn.w, turn.x, turn.y, turn.z).matrix()
            placement = pin.SE3(rotation, np.array([at.x, at.y, at.z]))
            found[item.child_frame_id] = item.header.frame_id, placement
        yield time, found


def described(bag: TrialBag) -> dict[str, list[str]]:
    """Arms by the topic that describes them."""
    arms = list(bag.info.robots)
    return {topics.ROBOT_DESCRIPTION: arms, **{topics.robot_description(arm): [arm] for arm in arms}}


def test_its_joints_have_the_names_of_the_joint_states_in_their_order(bag: TrialBag) -> None:
    for topic, arms in described(bag).items():
        model = pin.buildModelFromXML(urdf(bag, topic))
        names = [name for arm in arms for name in bag.messages(topics.joint_states(arm))[0].name]
        assert list(model.names)[1:] == names


def test_forward_kinematics_of_the_joint_states_are_the_transforms(bag: TrialBag) -> None:
    states = {
        arm: {stamp(message.header): message.position for message in bag.messages(topics.joint_states(arm))}
        for arm in bag.info.robots
    }
    for topic, arms in described(bag).items():
        model = pin.buildModelFromXML(urdf(bag, topic))
        data = model.createData()
        links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY and frame.name != "world"]
        moved = []
        for time, frames in transforms(bag):
            pin.framesForwardKinematics(model, data, np.concatenate([states[arm][time] for arm in arms]))
            for link in links:
                placement, parent = pin.SE3.Identity(), link
                while parent != "world":
                    parent, step = frames[parent]
                    placement = step * placement
                expected = data.oMf[model.getFrameId(link)]
                np.testing.assert_allclose(placement.homogeneous, expected.homogeneous, rtol=0.0, atol=TOLERANCE)
            moved.append(placement.translation)
        assert len(moved) > 10
        assert np.ptp(moved, axis=0).max() > 0.01 or links[-1] == "support"


def test_transforms_are_those_of_robot_state_publisher(bag: TrialBag) -> None:
    """Parent and child of every joint; what is beside them are the object and the pads, which are shapes of a link."""
    joints = Xml.fromstring(urdf(bag, topics.ROBOT_DESCRIPTION)).findall("joint")
    expected = {joint.find("child").get("link"): joint.find("parent").get("link") for joint in joints}
    beside = {"object": "world"} | {f"{arm}_pad": f"{arm}_end_effector" for arm in bag.info.robots}
    for _, frames in transforms(bag):
        assert {frame: parent for frame, (parent, _) in frames.items()} == expected | beside


def test_moving_links_have_limits_inertials_and_visuals(bag: TrialBag) -> None:
    seen = set()
    for topic in (*described(bag), topics.OBJECT_DESCRIPTION):
        robot = Xml.fromstring(urdf(bag, topic))
        for joint in robot.findall("joint"):
            if joint.get("type") != "fixed":
                assert joint.get("type") == "revolute"
                limit = joint.find("limit")
                assert float(limit.get("lower")) < float(limit.get("upper"))
                assert float(limit.get("effort")) > 0.0 < float(limit.get("velocity"))
        for link in robot.findall("link"):
            if link.get("name") != "world":
                assert float(link.find("inertial/mass").get("value")) > 0.0
                assert link.find("visual/geometry") is not None
                seen.add(link.get("name"))
    assert seen == {frame for _, frames in transforms(bag) for frame in frames if not frame.endswith("_pad")}


def test_descriptions_are_read_by_urdfdom_pinocchio_and_bullet_without_a_warning(
    bag: TrialBag, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    """By urdfdom, which RViz and robot_state_publisher read with, by Pinocchio and by Bullet."""
    for topic in (*described(bag), topics.OBJECT_DESCRIPTION):
        text = urdf(bag, topic)
        path = tmp_path / "robot.urdf"
        path.write_text(text)
        check = Path(sys.executable).with_name("check_urdf")
        said = subprocess.run([check, path], capture_output=True, text=True, check=True)
        assert "Successfully Parsed" in said.stdout
        assert not said.stderr
        pin.buildModelFromXML(text)
        client = pybullet.connect(pybullet.DIRECT)
        capfd.readouterr()
        assert pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client) >= 0
        told = "".join(capfd.readouterr()).lower()
        pybullet.disconnect(client)
        assert "warning" not in told and "error" not in told, told
