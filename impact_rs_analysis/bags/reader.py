"""Reading trials back, as columns. Ground truth stays where it is unless it is asked for by name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError

from impact_rs_analysis.bags import topics
from impact_rs_analysis.bags.trial_info import TrialInfo
from impact_rs_analysis.bags.types import typestore
from impact_rs_sim.robot import Array


class BagError(Exception):
    """A folder that is no readable trial: truncated, empty or foreign. The message names the folder and says why."""

    def __init__(self, path: Path, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: {reason}")


@dataclass(frozen=True)
class JointColumns:
    """One ``sensor_msgs/JointState`` topic as columns.

    Attributes:
        time: Header stamps, ``(k,)`` [s].
        position: ``(k, n)`` [rad]; empty where the topic has none.
        velocity: ``(k, n)`` [rad/s]; empty where the topic has none.
        effort: ``(k, n)`` [N m]; empty where the topic has none.
    """

    time: Array
    position: Array
    velocity: Array
    effort: Array


@dataclass(frozen=True)
class ControllerColumns:
    """The ``ControllerState`` topic of one arm as columns; see the message for units and frames.

    ``(k,)`` for scalars, ``(k, 3)``, ``(k, 6)`` or ``(k, n)`` for vectors.
    """

    time: Array
    mode: Array
    gamma: Array
    ante_position: Array
    ante_velocity: Array
    ante_acceleration: Array
    post_position: Array
    post_velocity: Array
    post_acceleration: Array
    ante_posture: Array
    post_posture: Array
    position: Array
    twist: Array
    feedback_acceleration: Array
    net_feedback: Array
    commanded_torque: Array
    external_wrench: Array
    qp_status: Array
    qp_iterations: Array
    qp_solve_time: Array


@dataclass(frozen=True)
class PoseColumns:
    """One ``geometry_msgs/PoseStamped`` topic as columns.

    Attributes:
        time: Header stamps, ``(k,)`` [s].
        position: ``(k, 3)`` [m].
        quaternion: x y z w, ``(k, 4)``.
    """

    time: Array
    position: Array
    quaternion: Array


class TrialBag:
    """One trial on disk; a topic is read when it is asked for.

    Args:
        path: Folder of the bag.

    Raises:
        BagError: The folder is no readable bag, or holds no ``/trial_info``.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._store = typestore()
        try:
            with Reader(path) as reader:
                self.counts = {connection.topic: connection.msgcount for connection in reader.connections}
                self.metadata = dict(reader.metadata.get("custom_data") or {})
                info = self._messages(reader, topics.TRIAL_INFO)
        except BagError:
            raise
        except (ReaderError, OSError) as error:
            raise BagError(path, f"not a readable bag ({error})") from None
        except Exception as error:  # a damaged file can fail anywhere inside the library
            raise BagError(path, f"damaged bag ({type(error).__name__}: {error})") from None
        if not info:
            raise BagError(path, f"no {topics.TRIAL_INFO}: not a trial of impact_rs")
        self.info = TrialInfo.from_message(info[0])

    @property
    def outcome(self) -> str:
        """``OK``, ``NO-IMPACT`` or ``ABORTED``, as the recorder wrote it."""
        return self.metadata.get("outcome", "ABORTED")

    def _messages(self, reader: Reader, topic: str) -> list[Any]:
        connections: list[Connection] = [c for c in reader.connections if c.topic == topic]
        return [
            self._store.deserialize_cdr(data, connection.msgtype)
            for connection, _, data in reader.messages(connections=connections)
        ]

    def messages(self, topic: str) -> list[Any]:
        """All messages of a topic, as objects of the ``rosbags`` typestore.

        Raises:
            BagError: The bag breaks off inside this topic.
        """
        try:
            with Reader(self.path) as reader:
                return self._messages(reader, topic)
        except Exception as error:
            raise BagError(self.path, f"{topic}: damaged ({type(error).__name__}: {error})") from None

    def joints(self, topic: str) -> JointColumns:
        """A JointState topic."""
        found = self.messages(topic)
        return JointColumns(
            _times(found),
            *(_stack([getattr(message, name) for message in found]) for name in ("position", "velocity", "effort")),
        )

    def controller(self, arm: str) -> ControllerColumns:
        """The ControllerState topic of an arm."""
        found = self.messages(topics.controller_state(arm))
        names = [name for name in ControllerColumns.__dataclass_fields__ if name != "time"]
        return ControllerColumns(
            _times(found), **{name: _stack([getattr(message, name) for message in found]) for name in names}
        )

    def poses(self, topic: str) -> PoseColumns:
        """A PoseStamped topic."""
        found = self.messages(topic)
        positions = [(m.pose.position.x, m.pose.position.y, m.pose.position.z) for m in found]
        quaternions = [
            (m.pose.orientation.x, m.pose.orientation.y, m.pose.orientation.z, m.pose.orientation.w) for m in found
        ]
        return PoseColumns(_times(found), _stack(positions), _stack(quaternions))

    def impact_time(self, arm: str) -> float:
        """Detected impact time of an arm [s]; NaN where nothing was detected."""
        found = self.messages(topics.impact_event(arm))
        return float(found[0].detected_time) if found else math.nan


def _times(messages: list[Any]) -> Array:
    return np.array([m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in messages])


def _stack(rows: list[Any]) -> Array:
    return np.array(rows, dtype=float) if rows else np.zeros(0)
