# SPDX-License-Identifier: Apache-2.0
"""``/tf`` and ``/clock`` for the bag, worked out from what was measured.

Several graphs share these topics, nobody can publish the first where ``tf2_msgs`` is not installed (it is not on PyPI),
and somebody else's plant need not publish either. Both follow from measured joint positions and the tracked object:
from the recorded messages the recorder works out the same ones that the plant publishes.
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

DERIVED = frozenset({topics.TF, topics.CLOCK})


class DerivedMessages:
    """Makes the transforms and the clock of one trial.

    Args:
        plan: The trial.
        tracked: Whether somebody tells the pose of the object; else its frame is left out.
    """

    def __init__(self, plan: TrialPlan, tracked: bool = True) -> None:
        self._tracked = tracked
        timing, sensors = plan.scene.scenario.timing, plan.scene.scenario.sensors
        self._store = typestore()
        self._maker = MessageMaker(RosbagsTypes(), plan)
        self._period_ns = self._maker.nanoseconds(1)
        self._object_every = max(1, round(sensors.object_period / timing.control_period))
        self._frames = FrameSource(plan.scene)
        self._sources = [*(topics.joint_states(arm) for arm in plan.arms)]
        self._arms = list(plan.arms)
        self._known: dict[int, dict[str, bytes]] = {}

    def receive(self, topic: str, nanoseconds: int, data: bytes) -> Iterator[tuple[str, bytes]]:
        """Take a recorded message; hands out topics with serialized messages of the same time as soon as known."""
        if topic not in self._sources and not (self._tracked and topic == topics.OBJECT_POSE):
            return
        tick = nanoseconds // self._period_ns
        if not self._frames.due(tick):
            return
        known = self._known.setdefault(tick, {})
        known[topic] = data
        sees_object = self._tracked and tick % self._object_every == 0
        if len(known) < len(self._sources) + sees_object:
            return
        del self._known[tick]
        arms = {arm: joint_signals(known[topics.joint_states(arm)]).values[0] for arm in self._arms}
        seen = None
        if sees_object:
            pose = self._store.deserialize_cdr(known[topics.OBJECT_POSE], topics.POSE).pose  # type: ignore[attr-defined]
            at, turn = pose.position, pose.orientation
            seen = np.array([at.x, at.y, at.z]), np.array([turn.x, turn.y, turn.z, turn.w])
        frames = self._frames.at(arms, seen)
        transforms = self._maker.transforms(tick, [one for one in frames if self._tracked or one.name != "object"])
        yield topics.TF, bytes(self._store.serialize_cdr(transforms, topics.TF_MESSAGE))
        yield topics.CLOCK, bytes(self._store.serialize_cdr(self._maker.clock(tick), topics.CLOCK_TYPE))
