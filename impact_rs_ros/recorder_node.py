# SPDX-License-Identifier: Apache-2.0
"""The recorder as a node: stores received messages unchanged, in one bag per trial.

Messages are stored undecoded; trial time is read from the stamp, which is at a fixed position. On a robot, whose stamps
are ROS time, the first signal of the trial has trial time 0. ``/truth/model`` has no
stamp. ``/trial_info`` comes with the request that configures the trial, and the descriptions follow from it. Other
graphs publish on ``/tf``, ``/clock`` and ``/diagnostics`` as well: the first two are computed from the measured signals
of this graph, and of the third only the messages of its own nodes are stored.
"""

from __future__ import annotations

import struct
import time
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence
from contextlib import ExitStack

from diagnostic_msgs.msg import DiagnosticArray
from impact_rs.srv import ConfigureTrial, FinishTrial
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.derived import DERIVED, DerivedMessages
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import decoded
from impact_rs_ros.names import resolved
from impact_rs_ros.presence import SubscriptionsMatched
from impact_rs_ros.process import HARDWARE, NodeProgram, run
from impact_rs_ros.qos import RECORD
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.cdr import Readable
from impact_rs_trials.bags.outcome import ArmRecord, TrialRecord, Verdict, judge
from impact_rs_trials.bags.reader import ControllerColumns, JointColumns, PoseColumns, columns_of
from impact_rs_trials.bags.record import descriptions
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.bags.writer import BagWriter, partial_path
from impact_rs_trials.spec import TrialSpec

MATCHING_S = 2.0  # for publishers to be discovered; shorter than a caller's wait before it repeats a request
SAVE_PERIOD_S = 0.2  # of a trial that is lost when the recorder is killed
# Topics that need not be recorded from the first message on.
UNAWAITED = (topics.TF, topics.TF_STATIC, topics.DIAGNOSTICS, topics.TRUTH_MODEL)
JUDGED = (topics.joint_states, topics.controller_state)  # signals of an arm that reach the end of a trial
EVERY_TICK = (*JUDGED, topics.joint_command)  # signals of an arm from tick 0 on
ENDS_EARLY = ("DIVERGED", "LIMIT")  # outcomes for which a plant may stop early
STAMP_ROUNDING_S = 1e-6  # of timestamps; far less than a period
_HEADER_STAMP_BYTES = 4  # offset of the timestamp, after the CDR encapsulation
_SEQUENCE_STAMP_BYTES = 8  # offset of the timestamp, after the length of a sequence


class OpenTrial:
    """One trial while it is recorded.

    Args:
        name: Scenario and name of the trial.
        bag: Its bag, open.
        arms: Names of the arms.
        duration: When the trial ends [s].
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
        beside = () if plan is None else tuple(one.name for one in plan.scene.physics.neighbours)
        kinds = topics.recorded(arms, neighbours=beside)
        self._stamp_at = {
            topic: _SEQUENCE_STAMP_BYTES if kind == topics.TF_MESSAGE else _HEADER_STAMP_BYTES
            for topic, kind in kinds.items()
        }
        self._derived = None if plan is None else DerivedMessages(plan, tracked)
        if self._derived is not None:
            bag.write_raw(topics.TF_STATIC, 0, self._derived.static())
        self._origin_ns: int | None = None if ros_time else 0  # stamp of tick 0
        self._early: list[tuple[str, bytes]] = []  # what came before it was known
        self._last: dict[str, int] = {}  # trial time [ns] of the newest message, by topic
        self._readable = {topic: Readable(typestore(), kind) for topic, kind in kinds.items()}
        self.refused: Counter[str] = Counter()
        judged = {topics.OBJECT_POSE, *(name(arm) for arm in arms for name in JUDGED)}
        self._kinds = {topic: kind for topic, kind in kinds.items() if topic in judged}
        self._judged: dict[str, list[bytes]] = defaultdict(list)  # messages of these topics

    def store(self, topic: str, data: bytes) -> None:
        """Write a message, unless it is computed here, or is a repetition of the last one."""
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
        """Whether the last message of this topic has the same trial time [ns]; diagnostics have none of their own."""
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
            seconds, nanoseconds = struct.unpack_from("<iI" if data[1] else ">iI", data, self._stamp_at[topic])
        except struct.error:
            return None
        return int(seconds * 1_000_000_000 + nanoseconds)

    def complete(self) -> None:
        """Write computed messages that waited for a pose of the object."""
        if self._derived is not None:
            self._write_derived(self._derived.rest())

    def _write_derived(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        for name, now, data in messages:
            self.bag.write_raw(name, now, data)
            self.counts[name] += 1

    @property
    def time(self) -> float:
        """Trial time of the newest message [s]."""
        return 1e-9 * max(self._last.values(), default=0)

    def summary(self, outcome: str) -> str:
        """How it ended, for the log; a path follows."""
        return f"{self.name}: {outcome} after {self.time:.3f} s, {self.bag.messages} messages in"

    def missing(self, expected: dict[str, int]) -> str:
        """Topics with fewer messages than expected, with both numbers, as text; empty: not any."""
        return ", ".join(
            f"{topic} {self.counts[topic]} of {count}"
            for topic, count in expected.items()
            if self.counts[topic] < count and (self._derived is None or topic not in DERIVED)
        )

    def verdict(self) -> Verdict:
        """How the trial ended, judged by the recorded signals; without a scenario, only whether there was an impact."""
        if self._plan is not None:
            verdict = judge(self._plan, TrialRecord({arm: self._arm(arm) for arm in self._arms}, self._object()))
        else:
            hit = all(self.counts[topics.impact_event(arm)] for arm in self._arms)
            verdict = Verdict("OK") if hit else Verdict("NO-IMPACT")
        cut = "" if verdict.outcome in ENDS_EARLY else self.cut_off()
        return Verdict("ABORTED", cut) if cut else verdict

    def cut_off(self) -> str:
        """Signals that end before the trial; empty: not any."""
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


class RecorderNode(NodeProgram):
    """Writes with a :class:`~impact_rs_trials.bags.writer.BagWriter`."""

    kind = "recorder"
    managed = True

    def __init__(self) -> None:
        super().__init__()
        self._arms: list[str] = []
        self._neighbours: tuple[str, ...] = ()
        self._inbox = Inbox(self.node, RECORD, raw=True)
        self._open = ExitStack()  # the bag of the trial that is recorded
        self._recording: OpenTrial | None = None
        self._attempt = 0  # the last one that was configured
        self._finished: FinishTrial.Response | None = None  # answer on the end of the trial before
        self._messages = 0
        self._failure = ""  # why the last bag is not a complete trial
        self._saved = 0.0  # when the bag was last written to the disk, on the monotonic clock [s]
        self._subscriptions = SubscriptionsMatched(self.node, ["plant", "controller"])

    def rehearse(self, spec: TrialSpec) -> None:
        DerivedMessages(spec.plan)
        for kind in set(topics.recorded(list(spec.plan.arms)).values()):
            Readable(typestore(), kind)(b"")  # the first message of a type compiles the code that reads it

    def offer(self) -> None:
        self.node.create_service(ConfigureTrial, "~/configure_trial", self._on_configure)
        self.node.create_service(FinishTrial, "~/finish_trial", self._on_finish)

    def turn(self) -> None:
        if self._recording is None:
            super().turn()
        else:
            self.serve(self.parameter("drain_period"))
            self.diagnose()
        self._drain()

    def status(self) -> tuple[str, dict[str, object]]:
        refused = 0 if self._recording is None else self._recording.refused.total()
        line = f"{refused} messages unreadable or not of this trial: who else publishes?" if refused else "ok"
        return line, {"messages": self._messages, "refused_messages": refused}

    def failure(self) -> str:
        return self._failure

    def connect(self, arms: list[str], neighbours: Sequence[str] = ()) -> None:
        if (arms, tuple(neighbours)) != (self._arms, self._neighbours):
            self._arms = []  # until it has succeeded: a name of an arm may not be valid in a topic
            recorded = topics.recorded(arms, neighbours=neighbours).items()
            latched = topics.latched(arms, neighbours)
            self._inbox.connect({topic: kind for topic, kind in recorded if topic not in latched})
            self._arms, self._neighbours = arms, tuple(neighbours)

    def _await_publishers(self) -> None:
        """Wait until the recorder and the publishers of the trial's topics have discovered each other.

        Discovery of nodes that were just started takes a while.

        Raises:
            InputError: A topic that every trial needs has no publisher, or one whose QoS does not match. Or plant or
                controller has not discovered the recorder.
        """
        deadline = time.monotonic() + MATCHING_S
        needed = topics.needed(self._arms)
        self._subscriptions.begin()
        while (unmatched := self._unmatched(needed)) or self._subscriptions.awaited():
            if time.monotonic() > deadline:
                break
            time.sleep(0.005)
        undiscovered = [topic.removesuffix("/alive") for topic in self._subscriptions.awaited()]
        absent = [topic for topic in unmatched if not self._publishers(topic)]
        unreceived = [topic for topic in unmatched if topic not in absent]
        wrong = [f"no publisher of {', '.join(absent)}; are plant and controller running?"] if absent else []
        if unreceived:
            wrong.append(f"{', '.join(unreceived)}: published, but not received; is the publisher's QoS reliable?")
        if undiscovered:  # the beginning of the trial would be lost
            wrong.append(
                f"{' and '.join(undiscovered)} did not discover the recorder's subscriptions within {MATCHING_S:g} s"
            )
        if undiscovered or not set(needed).isdisjoint(unmatched):
            raise InputError(f"recorder: {'; '.join(wrong)}")
        for line in wrong:
            self.log.warning(line)

    def _unmatched(self, needed: list[str]) -> list[str]:
        """Topics with a publisher that is not matched yet, and needed ones without any."""
        return [
            topic
            for topic, count in self._inbox.publishers().items()
            if topic not in UNAWAITED and count < max(int(topic in needed), self._publishers(topic))
        ]

    def _publishers(self, topic: str) -> int:
        """Number of publishers of a topic of this graph."""
        return self.node.count_publishers(resolved(self.node, topic))

    def _drain(self) -> None:
        """Write received messages; outside a trial, discard them."""
        if self._recording is None:
            self._inbox.clear()
            return
        self._inbox.gather()
        for topic, data in self._inbox.take():
            if topic == topics.DIAGNOSTICS and self._recording.readable(topic, data) and self._of_other_graph(data):
                continue
            self._recording.store(topic, data)
        self._messages = self._recording.counts.total()
        if time.monotonic() > self._saved + SAVE_PERIOD_S:
            self._recording.bag.save()
            self._saved = time.monotonic()

    def _of_other_graph(self, data: bytes) -> bool:
        """Whether diagnostics come from a node of impact_rs in another namespace."""
        message = decoded(data, DiagnosticArray)
        return message is not None and any(
            status.hardware_id == HARDWARE and status.name.rpartition("/")[0] != self.node.get_namespace().rstrip("/")
            for status in message.status
        )

    def _on_configure(
        self, request: ConfigureTrial.Request, response: ConfigureTrial.Response
    ) -> ConfigureTrial.Response:
        if self.active and request.attempt and request.attempt == self._attempt:
            response.success = True  # a repeated request, because the answer took long
            return response
        self._abort()
        self._attempt, self._finished = 0, None
        self._failure = ""
        with self.answering(response, "open the bag"):
            self.check_active()
            info = TrialInfo.from_message(request.trial)
            plan = info.spec.plan if info.scenario_json else None
            if not request.bag_path:
                raise InputError("ConfigureTrial.bag_path is empty; the recorder needs to know where to write")
            path = self.output(request.bag_path, "bag_path")
            self.connect(list(info.robots), info.neighbours)
            self._await_publishers()
            self._inbox.clear()
            name = f"{info.scenario}/{info.key.name}"
            publishers = self._inbox.publishers()
            tracked = [name for name in ("object", *info.neighbours) if publishers[topics.pose(name)] > 0]
            origin = None if request.ros_time else 0
            bag = self._open.enter_context(
                BagWriter.create(path, self._arms, origin_ns=origin, neighbours=info.neighbours)
            )
            bag.describe(info)
            bag.write_raw(topics.TRIAL_INFO, 0, serialize_message(request.trial))
            own = {topics.ROBOT_DESCRIPTION: request.robot_description}
            for topic, urdf in (own if plan is None else descriptions(plan.scene.physics)).items():
                bag.write_raw(topic, 0, serialize_message(String(data=urdf)))
            bag.save()
            duration = (
                info.duration
                if plan is None
                else plan.scene.scenario.timing.ticks * plan.scene.scenario.timing.control_period
            )
            self._recording = OpenTrial(name, bag, self._arms, duration, plan, tracked, request.ros_time)
            self._attempt = request.attempt
            self.log.debug(f"recording {path}")
            response.success = True
        if not response.success:
            self._open.close()
            self._failure = response.message
        return response

    def _on_finish(self, request: FinishTrial.Request, response: FinishTrial.Response) -> FinishTrial.Response:
        recording = self._recording
        if recording is None or request.attempt not in (0, self._attempt):
            response.message = "recorder: there is no bag to finish"
            return self._finished or response  # a repeated request, whose first answer was lost
        bag = recording.bag
        expected = {topic: count for topic, count in zip(request.topics, request.counts, strict=False) if count}
        unknown = [topic for topic in expected if not recording.has(topic)]
        if unknown and not request.aborted:
            response.message = f"recorder: {', '.join(unknown)} is no topic of {recording.name}, which is recorded"
            return response
        missing = self._complete(recording, expected)
        verdict = Verdict("ABORTED", request.reason or f"messages were published and not received: {missing}")
        if not request.aborted and not missing:
            verdict = self._verdict(recording)
            if verdict.outcome == "ABORTED" and recording.cut_off():  # the request may concern another trial
                response.message = f"recorder: {recording.name} is not over: {verdict.reason}"
                return response
        recording.complete()
        note = "; ".join(filter(None, (recording.note(), "" if request.aborted else request.reason)))
        verdict = Verdict(verdict.outcome, "; ".join(filter(None, (verdict.reason, note))))
        if verdict.outcome == "ABORTED":
            self._abort()
        else:
            try:
                bag.finish(verdict.outcome, verdict.reason)
            except OSError as error:
                verdict = Verdict("ABORTED", f"the bag cannot be closed: {error}")
            self._recording = None
            self._open.close()
        self._failure = verdict.reason if verdict.outcome == "ABORTED" else ""
        path = bag.path if verdict.outcome != "ABORTED" else partial_path(bag.path)
        text = f"{recording.summary(verdict.outcome)} {path}"
        if verdict == Verdict("OK"):
            self.log.info(text)
        else:
            self.log.warning(f"{text}: {verdict.reason}")
        response.success = verdict.outcome != "ABORTED" or bool(request.aborted)
        response.message = verdict.reason
        response.outcome = verdict.outcome
        response.messages = bag.messages
        response.topics = list(recording.counts)
        response.counts = list(recording.counts.values())
        self._finished = response
        return response

    def _verdict(self, recording: OpenTrial) -> Verdict:
        """Outcome of the trial; ABORTED if unknown."""
        try:
            return recording.verdict()
        except InputError as error:
            return Verdict("ABORTED", str(error))
        except Exception as error:  # another publisher's messages are among the judged ones
            self.log.error(f"cannot judge the trial: {full_traceback(error)}")
            return Verdict("ABORTED", f"the recording cannot be judged: {type(error).__name__}: {error}")

    def _complete(self, recording: OpenTrial, expected: dict[str, int]) -> str:
        """Receive until the expected messages have arrived; returns the missing ones after the timeout."""
        deadline = time.monotonic() + self.parameter("completion_timeout")
        while True:
            self._drain()
            missing = recording.missing(expected)
            left = deadline - time.monotonic()
            if not missing or left <= 0.0:
                return missing
            self._inbox.wait(left)

    def _abort(self) -> None:
        """Close the incomplete bag; it stays readable under its hidden name."""
        try:
            with self._open:  # closes it even if the remaining messages cannot be written
                if self._recording is not None:
                    self._drain()
        except OSError as error:  # its folder is gone or full; the next trial has another bag
            self.log.error(f"the bag of an aborted trial cannot be closed: {error}")
        self._recording = None

    def deactivate(self) -> None:
        """Close the bag of a running trial as aborted, and disconnect."""
        super().deactivate()
        if self._recording is not None:
            self._failure = f"recorder was deactivated at t = {self._recording.time:.3f} s"
            self._finished = FinishTrial.Response(outcome="ABORTED", message=self._failure)
        self._abort()
        self._inbox.close()
        self._arms = []

    def close(self) -> None:
        self._abort()
        self._subscriptions.close()
        self._inbox.close()


def main() -> None:
    """Run the node."""
    run(RecorderNode)


if __name__ == "__main__":
    main()
