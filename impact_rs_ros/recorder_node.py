# SPDX-License-Identifier: Apache-2.0
"""The recorder as a node: stores what it receives, as it receives it, in one bag per trial.

Messages are stored undecoded; trial time is read from the stamp, which stands at a fixed place. Two topics are special:
``/truth/model`` has no stamp, and ``/tf`` is worked out from others where its type is not installed. ``/trial_info``
and ``/robot_description`` are latched for others; the recorder is told them when the trial is configured.
"""

from __future__ import annotations

import struct
import time
from collections import Counter, defaultdict
from contextlib import ExitStack

from impact_rs.srv import ConfigureTrial, FinishTrial
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import available
from impact_rs_ros.process import NodeProgram, run
from impact_rs_ros.qos import RECORD
from impact_rs_ros.transforms import Transforms
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_sim.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.outcome import ArmRecord, TrialRecord, Verdict, judge
from impact_rs_trials.bags.reader import ControllerColumns, JointColumns, PoseColumns, columns_of
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.bags.writer import LATCHED, BagWriter

MATCHING = 5.0  # s, for publishers to be discovered
SILENCE = 3.0  # s, after which a trial of which nothing more comes is over, and nobody is left to say so
OPTIONAL = (topics.TF, topics.DIAGNOSTICS, topics.TRUTH_MODEL)  # nobody may publish these, and nothing is wrong
_HEADER_FIRST = 4  # byte of the stamp behind the CDR encapsulation
_SEQUENCE_FIRST = 8  # the same with the length of a sequence before it


class OpenTrial:
    """One trial on its way into a bag.

    Args:
        bag: Its bag, open.
        arms: Names of the arms.
        plan: The trial, where it is one of ours.
    """

    def __init__(self, bag: BagWriter, arms: list[str], plan: TrialPlan | None) -> None:
        self.bag = bag
        self.counts: Counter[str] = Counter()
        self._arms = arms
        self._plan = plan
        self._stamp_at = {
            topic: _SEQUENCE_FIRST if kind == topics.TF_MESSAGE else _HEADER_FIRST
            for topic, kind in topics.recorded(arms).items()
        }
        self._transforms = Transforms(plan) if plan is not None and not available(topics.TF_MESSAGE) else None
        self._last: dict[str, int] = {}
        per_arm = (topics.joint_states, topics.controller_state)
        judged = {topics.OBJECT_POSE, *(name(arm) for arm in arms for name in per_arm)}
        self._kinds = {topic: kind for topic, kind in topics.recorded(arms).items() if topic in judged}
        self._judged: dict[str, list[bytes]] = defaultdict(list)  # messages of these topics

    def store(self, topic: str, data: bytes) -> None:
        """Write a message, unless it was sent again because the answer to it was lost."""
        now = 0
        if topic != topics.TRUTH_MODEL:  # said once, and without a stamp
            seconds, nanoseconds = struct.unpack_from("<iI" if data[1] else ">iI", data, self._stamp_at[topic])
            now = seconds * 1_000_000_000 + nanoseconds
        if topic != topics.DIAGNOSTICS:
            if self._last.get(topic) == now:
                return
            self._last[topic] = now
        self.bag.write_raw(topic, now, data)
        self.counts[topic] += 1
        if topic in self._kinds:
            self._judged[topic].append(data)
        if self._transforms is not None:
            for at, transforms in self._transforms.receive(topic, now, data):
                self.bag.write_raw(topics.TF, at, transforms)
                self.counts[topics.TF] += 1

    def missing(self, expected: dict[str, int]) -> str:
        """Which of the expected numbers of messages are not reached yet, in words; empty: none."""
        return ", ".join(
            f"{topic} {self.counts[topic]} of {count}"
            for topic, count in expected.items()
            if self.counts[topic] < count
        )

    def verdict(self) -> Verdict:
        """How the trial ended, by what was recorded; of one that is not ours, no more than whether it hit."""
        if self._plan is not None:
            return judge(self._plan, TrialRecord({arm: self._arm(arm) for arm in self._arms}, self._object()))
        hit = all(self.counts[topics.impact_event(arm)] for arm in self._arms)
        return Verdict("OK") if hit else Verdict("NO-IMPACT")

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
        return columns_of(self._kinds[topic], self._judged[topic])


class RecorderNode(NodeProgram):
    """Writes with a :class:`~impact_rs_trials.bags.writer.BagWriter`."""

    kind = "recorder"

    def __init__(self) -> None:
        super().__init__()
        self._arms: list[str] = []
        self._inbox = Inbox(self.node, "inbox", RECORD, raw=True)
        self._open = ExitStack()  # the bag of the trial that is recorded
        self._recording: OpenTrial | None = None
        self._messages = 0
        self._heard = 0.0  # when the last message of the trial came, on the monotonic clock [s]; 0: none did

    def offer(self) -> None:
        self.node.create_service(ConfigureTrial, "~/configure_trial", self._on_configure)
        self.node.create_service(FinishTrial, "~/finish_trial", self._on_finish)

    def turn(self) -> None:
        self.executor.spin_once(timeout_sec=self.parameter("drain_period"))
        self._drain()
        self._end_silent()
        self.diagnose()

    def status(self) -> tuple[str, dict[str, object]]:
        return "ok", {"messages": self._messages}

    def connect(self, arms: list[str]) -> None:
        if arms != self._arms:
            recorded = topics.recorded(arms).items()
            self._inbox.connect({topic: kind for topic, kind in recorded if topic not in LATCHED})
            self._arms = arms

    def _await_publishers(self) -> None:
        """Wait until every topic of the trial has its publishers; a recorder that was just started meets them late.

        Raises:
            InputError: Some topics stay without a publisher.
        """
        deadline = time.monotonic() + MATCHING
        while missing := self._unmatched():
            if time.monotonic() > deadline:
                raise InputError(f"recorder: nobody publishes {', '.join(missing)}; are plant and controller running?")
            time.sleep(0.005)

    def _unmatched(self) -> list[str]:
        return [
            topic
            for topic, count in self._inbox.publishers().items()
            if topic not in OPTIONAL and count < max(1, self.node.count_publishers(topic))
        ]

    def _drain(self) -> None:
        """Write what has been received; outside a trial, throw it away."""
        if self._recording is None:
            self._inbox.clear()
            return
        self._inbox.gather()
        for topic, data in self._inbox.take():
            self._recording.store(topic, data)
            if topic != topics.DIAGNOSTICS:  # which nodes tell without a trial as well
                self._heard = time.monotonic()
        self._messages = self._recording.counts.total()

    def _end_silent(self) -> None:
        """Close the bag of a trial whose nodes are all gone."""
        recording = self._recording
        if recording is not None and self._heard and time.monotonic() > self._heard + SILENCE:
            self.log.warning(f"recorded {recording.bag.path}: ABORTED: nothing came for {SILENCE:g} s")
            self._abort()

    def _on_configure(
        self, request: ConfigureTrial.Request, response: ConfigureTrial.Response
    ) -> ConfigureTrial.Response:
        self._abort()
        try:
            info = TrialInfo.from_message(request.trial)
            plan = info.spec.plan if info.scenario_json else None
            if not request.bag_path:
                raise InputError("ConfigureTrial.bag_path is empty; the recorder needs to know where to write")
            path = self.output(request.bag_path, "bag_path")
            self.connect(list(info.robots))
            self._await_publishers()
            self._inbox.clear()
            bag = self._open.enter_context(BagWriter.create(path, self._arms))
            bag.describe(info)
            bag.write_raw(topics.TRIAL_INFO, 0, serialize_message(request.trial))
            bag.write_raw(topics.ROBOT_DESCRIPTION, 0, serialize_message(String(data=request.robot_description)))
            self._recording = OpenTrial(bag, self._arms, plan)
            self._heard = 0.0
        except InputError as error:
            self.log.error(f"trial refused: {error}")
            response.message = str(error)
            return response
        except Exception as error:  # a node outlives every trial
            self._open.close()
            self.log.error(f"cannot open the bag: {full_traceback(error)}")
            response.message = f"recorder: {type(error).__name__}: {error}"
            return response
        self.log.info(f"recording {request.bag_path}")
        response.success = True
        return response

    def _on_finish(self, request: FinishTrial.Request, response: FinishTrial.Response) -> FinishTrial.Response:
        recording = self._recording
        if recording is None:
            response.message = "recorder: there is no bag to finish"
            return response
        bag = recording.bag
        missing = self._complete(recording, dict(zip(request.topics, request.counts, strict=False)))
        if request.aborted or missing:
            verdict = Verdict("ABORTED", request.reason or f"messages were published and not received: {missing}")
            self._abort()
        else:
            try:
                verdict = recording.verdict()
                bag.finish(verdict.outcome, verdict.reason)
            except OSError as error:
                verdict = Verdict("ABORTED", f"the bag cannot be closed: {error}")
            self._recording = None
            self._open.close()
        text = f"recorded {bag.path}: {verdict.outcome}, {bag.messages} messages"
        if verdict.outcome == "OK":
            self.log.info(text)
        else:
            self.log.warning(f"{text}: {verdict.reason}")
        response.success = verdict.outcome != "ABORTED" or bool(request.aborted)
        response.message = verdict.reason
        response.outcome = verdict.outcome
        response.messages = bag.messages
        response.topics = list(recording.counts)
        response.counts = list(recording.counts.values())
        return response

    def _complete(self, recording: OpenTrial, expected: dict[str, int]) -> str:
        """Receive until everything is there; returns what is missing."""
        deadline = time.monotonic() + self.parameter("completion_timeout")
        while True:
            self._drain()
            missing = recording.missing(expected)
            left = deadline - time.monotonic()
            if not missing or left <= 0.0:
                return missing
            self._inbox.wait(left)

    def _abort(self) -> None:
        """Close the bag as far as it got; it stays readable under its hidden name."""
        try:
            with self._open:  # it is closed, too, where what is left cannot be written
                if self._recording is not None:
                    self._drain()
        except OSError as error:  # its folder is gone or full; the next trial has another bag
            self.log.error(f"the bag of an aborted trial cannot be closed: {error}")
        self._recording = None

    def close(self) -> None:
        self._abort()
        self._inbox.close()


def main() -> None:
    """Run the node."""
    run(RecorderNode)


if __name__ == "__main__":
    main()
