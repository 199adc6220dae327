# SPDX-License-Identifier: Apache-2.0
"""Poses of a tracker are moved into world; what is no pose of the object is an object out of sight."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message, serialize_message

from impact_msgs_py.conversions import pose_from_message, pose_to_message
from impact_rs_sim.errors import InputError
from impact_rs_trials.cell.motion_capture import TrackerPoses, serialized

PLACEMENT = np.array([1.2, -0.7, 0.3, 0.4, -0.3, 2.1])  # m, rad
SEEN = pin.SE3ToXYZQUAT(pin.SE3(pin.exp3(np.array([0.3, -0.8, 1.4])), np.array([0.4, -0.1, 0.5])))


def pose_message(pose: np.ndarray, frame: str = "tracker") -> bytes:
    message = PoseStamped(pose=pose_to_message(pose))
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = 7, 123_456_789
    return bytes(serialize_message(message))


def test_a_pose_that_was_seen_from_elsewhere_is_found_again_in_world() -> None:
    """A truth in world, as the tracker would see it: turned about fixed axes, x first."""
    roll, pitch, yaw = PLACEMENT[3:]
    turn = pin.utils.rotate("z", yaw) @ pin.utils.rotate("y", pitch) @ pin.utils.rotate("x", roll)
    truth = pin.XYZQUATToSE3(SEEN)
    seen = pin.SE3ToXYZQUAT(pin.SE3(turn, PLACEMENT[:3]).actInv(truth))
    pose = TrackerPoses("tracker", PLACEMENT).read(pose_message(seen))
    assert pose is not None
    assert pose.header.frame_id == "world"
    assert (pose.header.stamp.sec, pose.header.stamp.nanosec) == (7, 123_456_789)
    found = pin.XYZQUATToSE3(pose_from_message(pose.pose))
    np.testing.assert_allclose(found.homogeneous, truth.homogeneous, atol=1e-12)


def test_in_a_frame_that_is_world_a_pose_stays_as_it_is_bit_by_bit() -> None:
    pose = TrackerPoses("world", np.zeros(6)).read(pose_message(SEEN, "world"))
    assert pose is not None
    np.testing.assert_array_equal(pose_from_message(pose.pose), SEEN)


def test_the_trackers_frame_is_on_tf_static_where_poses_are_moved_to() -> None:
    tracker = TrackerPoses("tracker", PLACEMENT)
    (frame,) = tracker.frames("cell_a/")
    assert (frame.parent, frame.name) == ("cell_a/world", "tracker")
    moved = tracker.read(pose_message(SEEN))
    assert moved is not None
    np.testing.assert_allclose(frame.placement.act(SEEN[:3]), pose_from_message(moved.pose)[:3], atol=1e-12)
    assert TrackerPoses("world", np.zeros(6)).frames("cell_a/") == []  # nor a loop of world and cell_a/world


@pytest.mark.parametrize("frame", ["world", "tracker_2", ""])
def test_a_pose_in_another_frame_is_refused(frame: str) -> None:
    with pytest.raises(InputError, match="frame_id of /mocap/object_pose = .*: expected tracker, see mocap_frame"):
        TrackerPoses("tracker", PLACEMENT).read(pose_message(SEEN, frame))


@pytest.mark.parametrize("pose", [np.full(7, np.nan), np.zeros(7), np.append(np.full(3, np.inf), SEEN[3:])])
def test_what_a_tracker_says_of_an_object_out_of_sight_is_no_pose(pose: np.ndarray) -> None:
    assert TrackerPoses("tracker", PLACEMENT).read(pose_message(pose)) is None


@pytest.mark.parametrize(
    "data",
    [b"", b"\0\1\0\0abc", pose_message(SEEN)[:-1], b"\0\1\0\0" + b"\xff" * 80],
    ids=["nothing", "short", "cut off", "endless"],
)
def test_bytes_that_are_no_pose_are_an_object_out_of_sight(data: bytes) -> None:
    assert TrackerPoses("tracker", PLACEMENT).read(data) is None


def test_a_pose_is_the_same_message_in_ros_again() -> None:
    pose = TrackerPoses("world", np.zeros(6)).read(pose_message(SEEN, "world"))
    assert pose is not None
    published = deserialize_message(serialized(pose), PoseStamped)
    assert published == deserialize_message(pose_message(SEEN, "world"), PoseStamped)
