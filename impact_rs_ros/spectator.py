# SPDX-License-Identifier: Apache-2.0
"""A passive observer of a running graph.

It keeps the newest sample of every signal, best effort, and decodes it only on request: a stream of 1 kHz is not
decoded a thousand times a second, and no publisher waits for the observer.
"""

from __future__ import annotations

import json
import logging
import math
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any, Self

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from impact_rs_ros import identify_node
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import decoded, document_of, message_type
from impact_rs_ros.middleware import discovery, set_middleware
from impact_rs_ros.names import full_namespace, resolved
from impact_rs_ros.qos import LATCHED, WATCH
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.joint_signals import joint_signals, names_of
from impact_rs_trials.bags.messages import pose_values
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.snapshot import IdentifyMessages, Situation, Snapshot

log = logging.getLogger(__name__)

STATES = "/joint_states"  # of a robot without a trial, beside its /robot_description
MAX_JOINT_SILENCE_S = 1.0  # without a joint state, after which the robot is taken to be at rest
PUBLISHER_POLL_S = 0.5  # between two counts of publishers
FOLLOWED = {f"/identify/{name}": f"impact_rs/msg/{kind.__name__}" for name, kind in identify_node.TOPICS.items()}
MAX_KEPT_CHANGES = 20  # the newest
DESCRIBING = {topics.TRIAL_INFO: topics.TRIAL_INFO_TYPE, topics.ROBOT_DESCRIPTION: topics.STRING}


class Spectator:
    """The newest state of a graph; :meth:`watching` makes one.

    Args:
        node: Node of this process, in the namespace of the graph.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._location = f"ROS domain {node.context.get_domain_id()}, namespace {node.get_namespace()}"
        self._latched = Inbox(node, LATCHED)
        self._latched.connect(DESCRIBING | FOLLOWED)
        self._signals = Inbox(node, WATCH, raw=True)
        self._signals.connect({STATES: topics.JOINT_STATE})
        self._info: TrialInfo | None = None
        self._snapshot = Snapshot("absent", self._location)
        self._arm_of: dict[str, str] = {}  # by topic of its contact wrench
        self._neighbour_of: dict[str, str] = {}  # by topic of its pose
        self._last_joint_state = -float("inf")  # when the last joint state came, on the monotonic clock [s]
        self._published = False
        self._last_count = -float("inf")  # when publishers were last counted [s]

    @classmethod
    @contextmanager
    def watching(cls, namespace: str = "") -> Iterator[Self]:
        """A context manager with a spectator, in the ROS domain of the environment.

        Args:
            namespace: ROS namespace of the graph; empty: the root.

        Raises:
            InputError: ROS does not allow such a namespace.
        """
        full = full_namespace(namespace)
        set_middleware(os.environ)
        log.info(discovery(os.environ))
        with ExitStack() as stack:
            context = Context()
            rclpy.init(context=context)
            stack.callback(rclpy.try_shutdown, context=context)
            node = rclpy.create_node(f"spectator_{os.getpid()}", context=context, namespace=full)
            stack.callback(node.destroy_node)
            spectator = cls(node)
            stack.callback(spectator.close)
            yield spectator

    def look(self) -> Snapshot:
        """The present state of the graph; returns at once."""
        self._latched.gather()
        for topic, message in self._latched.take():
            if topic == topics.TRIAL_INFO:
                self._take_trial(message)
            elif topic in FOLLOWED:
                self._update(followed=_with_document(self._snapshot.followed, topic, json.dumps(document_of(message))))
            elif self._info is None:
                self._show(description=message.data)
        self._signals.gather()
        for topic, data in self._signals.take():
            self._take_state(topic, data)
        return self._now()

    def close(self) -> None:
        """Destroy the subscriptions."""
        self._latched.close()
        self._signals.close()

    def _now(self) -> Snapshot:
        """The last snapshot, with the present situation."""
        clock = time.monotonic()
        if clock - self._last_count > PUBLISHER_POLL_S:
            self._last_count = clock
            published = STATES if self._info is None else topics.TRIAL_INFO
            self._published = any(self._publishers(topic) for topic in (topics.TRIAL_INFO, published))
        situation: Situation
        if clock - self._last_joint_state < MAX_JOINT_SILENCE_S:
            situation = "running"
        elif self._snapshot.positions:
            situation = "over" if self._published else "gone"
        else:
            situation = "idle" if self._published else "absent"
        return self._update(situation=situation)

    def _publishers(self, topic: str) -> int:
        return self._node.count_publishers(resolved(self._node, topic))

    def _update(self, **changes: Any) -> Snapshot:
        """Change fields of the snapshot, and return it."""
        changed = {name: value for name, value in changes.items() if getattr(self._snapshot, name) is not value}
        if changed:
            self._snapshot = Snapshot(**vars(self._snapshot) | changed)
        return self._snapshot

    def _show(self, **scene: Any) -> None:
        """Begin a new scene, whose state is unknown."""
        snapshot = self._snapshot
        self._snapshot = Snapshot(
            snapshot.situation, self._location, snapshot.number + 1, followed=snapshot.followed, **scene
        )

    def _take_trial(self, message: Any) -> None:
        """Begin a trial, in a new scene or in the present one."""
        info = TrialInfo.from_message(message)
        before, self._info = self._info, info
        title = f"{info.scenario}, {info.object}, {info.case_name}, scale {info.velocity_scale:g}, repeat {info.repeat}"
        if before is not None and (before.scenario_json, before.object) == (info.scenario_json, info.object):
            self._update(title=title, forces={})
            return
        try:
            spec = info.spec
            self._show(title=title, physics=Physics.nominal(spec.scenario, spec.object))
        except InputError as error:
            self._show(title=title, complaint=f"{topics.TRIAL_INFO}: {error}")
            return
        arms = list(spec.scenario.robots)  # their names are valid in topics
        self._arm_of = {topics.truth_contact_wrench(arm): arm for arm in arms}
        of_arms = [name(arm) for arm in arms for name in (topics.joint_states, topics.controller_state)]
        self._neighbour_of = {topics.pose(name): name for name in spec.scenario.neighbours}
        names = [*of_arms, topics.OBJECT_POSE, *self._neighbour_of, *self._arm_of]
        kinds = topics.recorded(arms, neighbours=tuple(spec.scenario.neighbours))
        self._signals.connect({name: kinds[name] for name in names})

    def _take_pose(self, topic: str, data: bytes) -> None:
        """Take the pose of the object or of a neighbour."""
        message = decoded(data, message_type(topics.POSE))
        if message is None:
            return
        pose, name = _tracked_pose(message.pose), self._neighbour_of.get(topic)
        self._update(**({"object": pose} if name is None else {"neighbours": self._snapshot.neighbours | {name: pose}}))

    def _take_state(self, topic: str, data: bytes) -> None:
        if topic in self._arm_of:
            message = decoded(data, message_type(topics.WRENCH))
            if message is None:
                return
            wrench = message.wrench.force
            force = -np.array([wrench.x, wrench.y, wrench.z])  # the message has the force of the object on the pad
            if np.isfinite(force).all():
                self._update(forces=self._snapshot.forces | {self._arm_of[topic]: force})
        elif topic == topics.OBJECT_POSE or topic in self._neighbour_of:
            self._take_pose(topic, data)
        elif topic.endswith("/controller_state"):
            message = decoded(data, message_type(topics.CONTROLLER_STATE))
            if message is not None and math.isfinite(message.trial_time):
                self._update(time=message.trial_time)
        else:
            signals = joint_signals(data)
            position, velocity, _ = signals.values
            names = names_of(signals)
            if position.size != len(names) or not np.isfinite(position).all():
                return
            positions = dict(zip(names, position.tolist(), strict=True))
            self._update(positions=self._snapshot.positions | positions)
            if velocity.size == len(names) and np.isfinite(velocity).all():
                moving = dict(zip(names, velocity.tolist(), strict=True))
                self._update(velocities=self._snapshot.velocities | moving)
            self._last_joint_state = time.monotonic()


def _tracked_pose(pose: Any) -> Array | None:
    """Pose of an object, ``(7,)``; None: not tracked."""
    values = pose_values(pose)
    return values if np.isfinite(values).all() and np.any(values[3:]) else None


def _with_document(followed: IdentifyMessages, topic: str, text: str) -> IdentifyMessages:
    """Documents of followed hits, with one more."""
    name = topic.rpartition("/")[2]
    changes: dict[str, Any] = {name: text}
    if name == "change":
        earlier_changes = [
            change for change in followed.changes if change != text
        ]  # a node that was started again repeats it
        changes = {"changes": (*earlier_changes, text)[-MAX_KEPT_CHANGES:]}
    return replace(followed, **changes)
