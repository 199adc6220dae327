# SPDX-License-Identifier: Apache-2.0
"""Poses of the object from motion capture, moved from the tracker's frame into the frame ``world``.

    T_world_object = T_world_tracker T_tracker_object

with T_world_tracker from x y z and roll pitch yaw about fixed axes (REP-103): R = Rz(yaw) Ry(pitch) Rx(roll). It comes
from a calibration and is constant in a trial. It is therefore a parameter, which the cell publishes on /tf_static, and
is not looked up on /tf, where it could change or be missing while the arm moves (and pip does not install tf2).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import MAX_NORM_ERROR, quaternion_of
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import Frame, pose_values
from impact_rs_trials.bags.types import typestore

MOCAP = "/mocap/object_pose"
WORLD = "world"
COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
TrackedPose = Any  # ``geometry_msgs/PoseStamped`` of rosbags


class TrackerPoses:
    """Poses of the object from a tracker, transformed into ``world``.

    Args:
        frame: Name of the tracker's frame, the ``frame_id`` of its poses.
        placement: x y z [m] and roll pitch yaw [rad] of that frame in ``world``, ``(6,)``.
    """

    def __init__(self, frame: str, placement: Array) -> None:
        self.frame = frame
        self._origin = np.array(placement[:3])
        self._rotation = pin.rpy.rpyToMatrix(*(float(angle) for angle in placement[3:]))
        x, y, z, w = quaternion_of(self._rotation)
        # Matrix of the quaternion product q_tracker * q, order x y z w.
        self._left_product = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])

    def frames(self, prefix: str) -> list[Frame]:
        """The tracker's frame for ``/tf_static``, unless it is ``world``; ``prefix`` precedes ``world``."""
        if self.frame == WORLD:
            return []
        return [Frame(prefix + WORLD, self.frame, pin.SE3(self._rotation, self._origin))]

    def read(self, data: bytes) -> TrackedPose | None:
        """A pose in ``world`` with its original timestamp; None: no valid pose, for example of an occluded object.

        Bytes that are no message give None, too.

        Raises:
            InputError: The pose is not in the frame of the tracker.
        """
        try:
            pose: TrackedPose = typestore().deserialize_cdr(data, topics.POSE)
        except Exception:  # whatever rosbags finds wrong with the bytes
            return None
        if pose.header.frame_id != self.frame:
            frame = pose.header.frame_id
            raise InputError(f"expected {self.frame}, see mocap_frame", key=f"frame_id of {MOCAP}", value=frame)
        values = pose_values(pose.pose)
        position, quaternion = values[:3], values[3:]
        if not (np.isfinite(values).all() and abs(np.linalg.norm(quaternion) - 1.0) < MAX_NORM_ERROR):
            return None
        point, orientation = pose.pose.position, pose.pose.orientation
        point.x, point.y, point.z = (self._origin + self._rotation @ position).tolist()
        orientation.x, orientation.y, orientation.z, orientation.w = (self._left_product @ quaternion).tolist()
        pose.header.frame_id = WORLD
        return pose


def serialized(pose: TrackedPose) -> bytes:
    """The message of a pose."""
    return bytes(typestore().serialize_cdr(pose, topics.POSE))
