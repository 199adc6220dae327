# SPDX-License-Identifier: Apache-2.0
"""``/tf``, ``/tf_static`` and ``/clock`` for the bag, computed from measured signals.

They follow from measured joint positions and the pose of the object, so the recorder computes them from the recorded
messages. It does not record the published ones because several graphs share ``/tf`` and ``/tf_static``, no node can
publish transforms without ``tf2_msgs`` (not on PyPI), and a user's own plant need not publish any of the three.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Iterator

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.joint_signals import JointReader
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes, pose_values
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.bags.types import typestore

DERIVED = frozenset({topics.TF, topics.TF_STATIC, topics.CLOCK})


class DerivedMessages:
    """Makes the transforms and the clock of one trial.

    Args:
        plan: The trial.
        tracked: Names of the objects whose poses are published; the frames of others are left out. None: all.
    """

    def __init__(self, plan: TrialPlan, tracked: Collection[str] | None = None) -> None:
        self._store = typestore()
        self._maker = MessageMaker(RosbagsTypes(), plan)
        self._period_ns = self._maker.nanoseconds(1)
        self._frames = FrameSource(plan.scene)
        self._sources = {topics.joint_states(arm): arm for arm in plan.arms}
        self._readers = {arm: JointReader(names, ("position",)) for arm, names in self._maker.joints.items()}
        self._positions: dict[int, dict[str, Array]] = {}  # joint positions by arm, of ticks that are not written yet
        bodies = plan.scene.physics.bodies
        self._poses: dict[str, list[tuple[int, bytes]]] = {  # times [ns] and messages of tracked bodies
            name: [] for name in bodies if tracked is None or name in tracked
        }
        self._body_of = {topics.pose(name): name for name in self._poses}
        self._untracked = set(bodies) - set(self._poses)

    def begin(self, origin_ns: int) -> None:
        """Set the stamp of tick 0 [ns]."""
        self._maker.origin_ns = origin_ns

    def static(self) -> bytes:
        """The serialized message of ``/tf_static``, for the begin of the trial."""
        transforms = self._maker.transforms(0, self._frames.static)
        return bytes(self._store.serialize_cdr(transforms, topics.TF_MESSAGE))

    def receive(self, topic: str, nanoseconds: int, data: bytes) -> Iterator[tuple[str, int, bytes]]:
        """Take a recorded message; yields topics, times [ns] and serialized messages as soon as they are known.

        Object and neighbours have their last measured pose. A tracker has its own stamps, and its poses come late: a
        tick waits for a pose of the same or a later time.
        """
        if topic in self._body_of:
            self._poses[self._body_of[topic]].append((nanoseconds, data))
        elif topic in self._sources and self._frames.due(tick := nanoseconds // self._period_ns):
            arm = self._sources[topic]
            if (signals := self._readers[arm].read(data)).complaint:
                return
            self._positions.setdefault(tick, {})[arm] = signals.values[0]
        else:
            return
        last = min((poses[-1][0] if poses else -1 for poses in self._poses.values()), default=-1)
        yield from self._messages_until(last // self._period_ns)

    def remaining(self) -> Iterator[tuple[str, int, bytes]]:
        """Messages of the ticks that still wait for a pose of an object at the end of a trial."""
        self._untracked |= {name for name, poses in self._poses.items() if not poses}
        self._poses = {name: poses for name, poses in self._poses.items() if poses}
        yield from self._messages_until(max(self._positions, default=0))

    def _messages_until(self, last: int) -> Iterator[tuple[str, int, bytes]]:
        """Messages up to a tick, of the ticks with states of all arms and a pose of every tracked object."""
        for tick in sorted(self._positions):
            if self._poses and tick > last:
                return
            if len(self._positions[tick]) < len(self._sources):
                continue
            time = self._maker.nanoseconds(tick)
            frames = self._frames.at(self._positions.pop(tick), self._poses_at(time))
            shown = [frame for frame in frames if frame.name not in self._untracked]
            transforms = self._maker.transforms(tick, shown)
            yield topics.TF, time, bytes(self._store.serialize_cdr(transforms, topics.TF_MESSAGE))
            yield topics.CLOCK, time, bytes(self._store.serialize_cdr(self._maker.clock(tick), topics.CLOCK_TYPE))

    def _poses_at(self, time: int) -> dict[str, tuple[Array, Array]]:
        """Last position and quaternion of every tracked body at a time [ns] (zero-order hold)."""
        poses = {}
        for name, messages in self._poses.items():
            if (row := bisect_right(messages, time, key=lambda message: message[0])) == 0:
                continue
            pose = self._store.deserialize_cdr(messages[row - 1][1], topics.POSE).pose  # type: ignore[attr-defined]
            values = pose_values(pose)
            poses[name] = values[:3], values[3:]
        return poses
