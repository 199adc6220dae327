# SPDX-License-Identifier: Apache-2.0
"""``/tf`` for the bag where nobody can publish it: ``tf2_msgs`` is not on PyPI.

The transforms follow from measured joint positions and the tracked object alone; from the recorded messages the
recorder works out the same ones that the plant would have published.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.joint_signals import joint_signals
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.bags.types import typestore


class Transforms:
    """Makes the transforms of one trial.

    Args:
        plan: The trial.
    """

    def __init__(self, plan: TrialPlan) -> None:
        timing, sensors = plan.scene.scenario.timing, plan.scene.scenario.sensors
        self._store = typestore()
        self._maker = MessageMaker(RosbagsTypes(), plan)
        self._period_ns = self._maker.nanoseconds(1)
        self._object_every = max(1, round(sensors.object_period / timing.control_period))
        self._frames = FrameSource(plan.scene)
        self._sources = [*(topics.joint_states(arm) for arm in plan.arms)]
        self._arms = list(plan.arms)
        self._known: dict[int, dict[str, bytes]] = {}

    def receive(self, topic: str, nanoseconds: int, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Take a recorded message; hands out time [ns] and serialized transforms as soon as they are known."""
        if topic != topics.OBJECT_POSE and topic not in self._sources:
            return
        tick = nanoseconds // self._period_ns
        if not self._frames.due(tick):
            return
        known = self._known.setdefault(tick, {})
        known[topic] = data
        sees_object = tick % self._object_every == 0
        if len(known) < len(self._sources) + sees_object:
            return
        del self._known[tick]
        arms = {arm: joint_signals(known[topics.joint_states(arm)]).values[0] for arm in self._arms}
        seen = None
        if sees_object:
            pose = self._store.deserialize_cdr(known[topics.OBJECT_POSE], topics.POSE).pose  # type: ignore[attr-defined]
            at, turn = pose.position, pose.orientation
            seen = np.array([at.x, at.y, at.z]), np.array([turn.x, turn.y, turn.z, turn.w])
        message = self._maker.transforms(tick, self._frames.placements(arms, seen))
        yield nanoseconds, bytes(self._store.serialize_cdr(message, topics.TF_MESSAGE))
