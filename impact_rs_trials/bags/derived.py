# SPDX-License-Identifier: Apache-2.0
"""``/tf``, ``/tf_static`` and ``/clock`` for the bag, computed from measured signals.

They follow from measured joint positions and the pose of the object, so the recorder computes from the recorded
messages what the plant publishes. It does not record them because several graphs share the first two, no node can
publish those where ``tf2_msgs`` is not installed (it is not on PyPI), and a user's own plant need not publish any.
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
        self._known: dict[int, dict[str, Array]] = {}  # joint positions by arm, of ticks that are not written yet
        bodies = plan.scene.physics.bodies
        self._seen: dict[str, list[tuple[int, bytes]]] = {  # when [ns], and poses, of those that are tracked
            name: [] for name in bodies if tracked is None or name in tracked
        }
        self._body_of = {topics.pose(name): name for name in self._seen}
        self._unseen = set(bodies) - set(self._seen)

    def begin(self, origin_ns: int) -> None:
        """Tick 0 has this stamp [ns]."""
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
            self._seen[self._body_of[topic]].append((nanoseconds, data))
        elif topic in self._sources and self._frames.due(tick := nanoseconds // self._period_ns):
            arm = self._sources[topic]
            if (signals := self._readers[arm].read(data)).complaint:
                return
            self._known.setdefault(tick, {})[arm] = signals.values[0]
        else:
            return
        last = min((own[-1][0] if own else -1 for own in self._seen.values()), default=-1)
        yield from self._known_until(last // self._period_ns)

    def rest(self) -> Iterator[tuple[str, int, bytes]]:
        """Messages of the ticks that still wait for a pose of an object at the end of a trial."""
        self._unseen |= {name for name, own in self._seen.items() if not own}
        self._seen = {name: own for name, own in self._seen.items() if own}
        yield from self._known_until(max(self._known, default=0))

    def _known_until(self, last: int) -> Iterator[tuple[str, int, bytes]]:
        """Messages of the ticks with states of all arms, and a pose of every tracked object, up to a tick."""
        for tick in sorted(self._known):
            if self._seen and tick > last:
                return
            if len(self._known[tick]) < len(self._sources):
                continue
            time = self._maker.nanoseconds(tick)
            frames = self._frames.at(self._known.pop(tick), self._seen_at(time))
            shown = [one for one in frames if one.name not in self._unseen]
            transforms = self._maker.transforms(tick, shown)
            yield topics.TF, time, bytes(self._store.serialize_cdr(transforms, topics.TF_MESSAGE))
            yield topics.CLOCK, time, bytes(self._store.serialize_cdr(self._maker.clock(tick), topics.CLOCK_TYPE))

    def _seen_at(self, time: int) -> dict[str, tuple[Array, Array]]:
        """Last position and quaternion of the bodies that were seen, at a time [ns] (zero-order hold)."""
        found = {}
        for name, seen in self._seen.items():
            if (row := bisect_right(seen, time, key=lambda one: one[0])) == 0:
                continue
            pose = self._store.deserialize_cdr(seen[row - 1][1], topics.POSE).pose  # type: ignore[attr-defined]
            values = pose_values(pose)
            found[name] = values[:3], values[3:]
        return found
