# SPDX-License-Identifier: Apache-2.0
"""Publishes what a graph does, without any node of ours: a trial, where its arms are, and its object."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from impact_rs.msg import ControllerState
from node_trials import participant
from rclpy.node import Node
from sensor_msgs.msg import JointState

from impact_rs_ros.message_types import RosidlTypes, message_type
from impact_rs_ros.names import on_network
from impact_rs_ros.qos import LATCHED, STREAM
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
from impact_rs_trials.spec import TrialSpec


class FakeGraph:
    """Publishers of one graph."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self._publishers: dict[str, Any] = {}

    def say(self, topic: str, kind: str, message: Any, latched: bool = False) -> None:
        """Publish something."""
        if topic not in self._publishers:
            qos = LATCHED if latched else STREAM
            self._publishers[topic] = self.node.create_publisher(message_type(kind), on_network(topic), qos)
        self._publishers[topic].publish(message)

    def trial(self, scenario: str, thing: str = "cat_food", repeat: int = 0) -> TrialSpec:
        """Announce that a trial begins."""
        spec = TrialSpec.of(load_scenario(scenario), thing, "2")
        info = TrialInfo.of(spec.plan, TrialKey(thing, spec.case, 1.0, repeat), 7, "nodes")
        message = MessageMaker(RosidlTypes(), spec.plan).trial_info(info)
        self.say(topics.TRIAL_INFO, topics.TRIAL_INFO_TYPE, message, latched=True)
        return spec

    def joints(self, arm: str, position: np.ndarray, time: float, velocity: np.ndarray | None = None) -> None:
        """Publish where the joints of an arm are and how fast, in another order than they have."""
        names = [f"{arm}_joint{number + 1}" for number in range(position.size)]
        message = JointState(name=names[::-1], position=position[::-1].tolist())
        if velocity is not None:
            message.velocity = velocity[::-1].tolist()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(time * 1e9), 10**9)
        self.say(topics.joint_states(arm), topics.JOINT_STATE, message)
        self.say(topics.controller_state(arm), topics.CONTROLLER_STATE, ControllerState(trial_time=time))

    def object(self, pose: np.ndarray, name: str = "object") -> None:
        """Publish where the object is, or a neighbour."""
        message = PoseStamped()
        at, turned = message.pose.position, message.pose.orientation
        at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w = (float(value) for value in pose)
        self.say(topics.pose(name), topics.POSE, message)

    def force_on_pad(self, arm: str, force: tuple[float, float, float]) -> None:
        """Publish the true force of the object on a pad."""
        message = WrenchStamped()
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
        self.say(topics.truth_contact_wrench(arm), topics.WRENCH, message)


@contextmanager
def fake_graph(domain: int, namespace: str = "") -> Iterator[FakeGraph]:
    """A graph in a ROS domain; its middleware is that of the environment."""
    with participant(domain, "fake", namespace) as node:
        yield FakeGraph(node)
