# SPDX-License-Identifier: Apache-2.0
"""One trial while it is recorded: received messages are stored unchanged in its bag, and judged at its end.

Messages are stored undecoded; trial time is read from the stamp, which is at a fixed position. On a robot, whose stamps
are ROS time, the first signal of the trial has trial time 0. ``/truth/model`` has no stamp. ``/tf`` and ``/clock`` are
computed from the measured signals.
"""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable

from impact_rs_control.plan import TrialPlan
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.cdr import Readable
from impact_rs_trials.bags.derived import DERIVED, DerivedMessages
from impact_rs_trials.bags.outcome import ArmRecord, TrialRecord, Verdict, judge
from impact_rs_trials.bags.reader import ControllerColumns, JointColumns, PoseColumns, columns_of
from impact_rs_trials.bags.types import STAMP_ROUNDING_S, typestore
from impact_rs_trials.bags.writer import BagWriter

JUDGED = (topics.joint_states, topics.controller_state)  # signals of an arm that reach the end of a trial
EVERY_TICK = (*JUDGED, topics.joint_command)  # signals of an arm from tick 0 on
ENDS_EARLY = ("DIVERGED", "LIMIT")  # outcomes for which a plant may stop early
_HEADER_STAMP_BYTES = 4  # offset of the timestamp, after the CDR encapsulation
_SEQUENCE_STAMP_BYTES = 8  # offset of the timestamp, after the length of a sequence


class OpenTrial:
    """One trial while it is recorded.

    Args:
        name: Scenario and name of the trial.
        bag: Its bag, open.
        arms: Names of the arms.
        duration: End of the trial [s].
        plan: The trial; None: it has no scenario of impact_rs.
        tracked: Names of the objects whose poses are published.
        ros_time: Whether stamps are ROS time, and the first signal of every tick is that of tick 0.

    Attributes:
        counts: Number of messages in the bag, by topic.
        refused: Number of messages that are not in the bag because they cannot be read or their stamp lies outside the
            trial, by topic.
    """

    def __init__(
        self,
        name: str,
        bag: BagWriter,
        arms: list[str],
        duration: float,
        plan: TrialPlan | None,
        tracked: Collection[str],
        ros_time: bool = False,
    ) -> None:
        self.bag = bag
        self.name = name
        self._duration = duration
        self._awaited = {name(arm) for arm in arms for name in EVERY_TICK}
        self.counts: Counter[str] = Counter()
        self._arms = arms
        self._plan = plan
        neighbours = () if plan is None else tuple(neighbour.name for neighbour in plan.scene.physics.neighbours)
        kinds = topics.recorded(arms, neighbours=neighbours)
        self._stamp_offset = {
            topic: _SEQUENCE_STAMP_BYTES if kind == topics.TF_MESSAGE else _HEADER_STAMP_BYTES
            for topic, kind in kinds.items()
        }
        self._derived = None if plan is None else DerivedMessages(plan, tracked)
        if self._derived is not None:
            bag.write_raw(topics.TF_STATIC, 0, self._derived.static())
        self._origin_ns: int | None = None if ros_time else 0  # stamp of tick 0
        self._early: list[tuple[str, bytes]] = []  # messages that came before the stamp of tick 0 was known
        self._last: dict[str, int] = {}  # trial time [ns] of the newest message, by topic
        self._readable = {topic: Readable(typestore(), kind) for topic, kind in kinds.items()}
        self.refused: Counter[str] = Counter()
        judged = {topics.OBJECT_POSE, *(name(arm) for arm in arms for name in JUDGED)}
        self._kinds = {topic: kind for topic, kind in kinds.items() if topic in judged}
        self._judged: dict[str, list[bytes]] = defaultdict(list)  # messages of these topics

    def store(self, topic: str, data: bytes) -> None:
        """Write a message, unless it is computed here or repeats the last one."""
        if self._derived is not None and topic in DERIVED:
            return
        if not self._has_begun(topic, data):
            return
        if (now := self._time_of(topic, data)) is None:
            self.refused[topic] += 1
            return
        if topic in self._awaited and self._plan is not None:
            if now and topic not in self._last:  # belongs to an abandoned trial that still runs
                return
            if 1e-9 * now > self._duration + STAMP_ROUNDING_S:
                self.refused[topic] += 1
                return
        if self._is_repeated(topic, now):
            return
        self.bag.write_raw(topic, now, data)
        self.counts[topic] += 1
        if topic in self._kinds:
            self._judged[topic].append(data)
        if self._derived is not None:
            self._write_derived(self._derived.receive(topic, now, data))

    def _is_repeated(self, topic: str, now: int) -> bool:
        """Whether the last message of this topic has the same trial time [ns]; always false for diagnostics."""
        repeated = topic != topics.DIAGNOSTICS and self._last.get(topic) == now
        if topic != topics.DIAGNOSTICS:
            self._last[topic] = now
        return repeated

    def _has_begun(self, topic: str, data: bytes) -> bool:
        """Whether the origin is known: by the first signal of the trial at the latest; other messages wait for it."""
        if self._origin_ns is not None:
            return True
        first = topic in self._awaited and self.readable(topic, data)
        origin = self._stamp_of(topic, data) if first else None
        if origin is None:
            self._early.append((topic, data))
            return False
        self._origin_ns = origin
        self.bag.begin(origin)
        if self._derived is not None:
            self._derived.begin(origin)
        early, self._early = self._early, []
        for message in early:
            self.store(*message)
        return True

    def has(self, topic: str) -> bool:
        """Whether this is a topic of the trial."""
        return topic in self._readable

    def readable(self, topic: str, data: bytes) -> bool:
        """Whether bytes are a message of this topic."""
        return self._readable[topic](data)

    def _time_of(self, topic: str, data: bytes) -> int | None:
        """Trial time of a message [ns]; None: it does not belong to this trial."""
        if not self.readable(topic, data):
            return None
        if topic == topics.TRUTH_MODEL:  # published once, and without a timestamp
            return 0
        if topic == topics.DIAGNOSTICS:  # its timestamp is not trial time
            return max(self._last.values(), default=0)
        stamp, origin = self._stamp_of(topic, data), self._origin_ns
        return None if stamp is None or origin is None or stamp < origin else stamp - origin

    def _stamp_of(self, topic: str, data: bytes) -> int | None:
        """Stamp of a message [ns]; None: a sequence without elements."""
        try:
            seconds, nanoseconds = struct.unpack_from("<iI" if data[1] else ">iI", data, self._stamp_offset[topic])
        except struct.error:
            return None
        return int(seconds * 1_000_000_000 + nanoseconds)

    def complete(self) -> None:
        """Write computed messages that waited for a pose of the object."""
        if self._derived is not None:
            self._write_derived(self._derived.remaining())

    def _write_derived(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        for name, now, data in messages:
            self.bag.write_raw(name, now, data)
            self.counts[name] += 1

    @property
    def time(self) -> float:
        """Trial time of the newest message [s]."""
        return 1e-9 * max(self._last.values(), default=0)

    def summary(self, outcome: str) -> str:
        """Line for the log about the end of the trial; the caller appends the path."""
        return f"{self.name}: {outcome} after {self.time:.3f} s, {self.bag.messages} messages in"

    def missing(self, expected: dict[str, int]) -> str:
        """Topics with fewer messages than expected, with both numbers, as text; empty: no such topic."""
        return ", ".join(
            f"{topic} {self.counts[topic]} of {count}"
            for topic, count in expected.items()
            if self.counts[topic] < count and (self._derived is None or topic not in DERIVED)
        )

    def verdict(self) -> Verdict:
        """Outcome of the trial by the recorded signals; without a scenario, only whether there was an impact."""
        if self._plan is not None:
            verdict = judge(self._plan, TrialRecord({arm: self._arm(arm) for arm in self._arms}, self._object()))
        else:
            hit = all(self.counts[topics.impact_event(arm)] for arm in self._arms)
            verdict = Verdict("OK") if hit else Verdict("NO-IMPACT")
        cut_off = "" if verdict.outcome in ENDS_EARLY else self.cut_off()
        return Verdict("ABORTED", cut_off) if cut_off else verdict

    def cut_off(self) -> str:
        """Message about signals that end before the trial; empty: no such signal."""
        ends = {}
        for topic in (name(arm) for arm in self._arms for name in JUDGED):
            last, count = 1e-9 * self._last.get(topic, 0), self.counts[topic]
            period = last / (count - 1) if self._plan is None and count > 1 else 0.0  # else the last tick has a stamp
            if not last > self._duration - 1.5 * period - STAMP_ROUNDING_S:
                ends[topic] = f"{topic} ends at {last:.3f} s"
        return f"{', '.join(ends.values())}; the trial ends at {self._duration:.3f} s" if ends else ""

    def note(self) -> str:
        """Warning about the recording, for any outcome, in one line; may be empty."""
        refused = ", ".join(f"{topic} {count}" for topic, count in self.refused.items())
        return (
            f"{self.refused.total()} messages are not in the bag, unreadable or not of this trial: {refused}"
            if refused
            else ""
        )

    def _arm(self, arm: str) -> ArmRecord:
        commands = ControllerColumns.of(self._columns(topics.controller_state(arm)))
        return ArmRecord(
            joints=JointColumns.of(self._columns(topics.joint_states(arm))),
            command_time=commands.time,
            command=commands.commanded_torque,
            qp_status=commands.qp_status,
            hit=self.counts[topics.impact_event(arm)] > 0,
            mode=commands.mode,
        )

    def _object(self) -> PoseColumns:
        return PoseColumns.of(self._columns(topics.OBJECT_POSE))

    def _columns(self, topic: str) -> dict[str, Array]:
        try:
            return columns_of(self._kinds[topic], self._judged[topic], origin_ns=self._origin_ns or 0)
        except ValueError:
            raise InputError(f"{topic} has messages of different lengths: who else publishes?") from None
