# SPDX-License-Identifier: Apache-2.0
"""The recorder as a node: stores received messages unchanged, in one bag per trial.

``/trial_info`` comes with the request that configures the trial, and the descriptions follow from it. Other graphs
publish on ``/diagnostics`` as well: only the messages of this graph's nodes are stored.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack

from diagnostic_msgs.msg import DiagnosticArray
from impact_rs.srv import ConfigureTrial, FinishTrial
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import decoded
from impact_rs_ros.names import resolved
from impact_rs_ros.presence import SubscriptionsMatched
from impact_rs_ros.process import HARDWARE, run
from impact_rs_ros.qos import RECORD
from impact_rs_ros.trial_services import TrialServices
from impact_rs_sim.errors import InputError, full_traceback
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.cdr import Readable
from impact_rs_trials.bags.derived import DerivedMessages
from impact_rs_trials.bags.open_trial import OpenTrial
from impact_rs_trials.bags.outcome import Verdict
from impact_rs_trials.bags.record import descriptions
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.bags.writer import BagWriter, partial_path
from impact_rs_trials.spec import TrialSpec

MATCHING_S = 5.0  # for publishers to be discovered, on a busy machine; well below a service_timeout of 10 s
SAVE_PERIOD_S = 0.2  # of a trial that is lost when the recorder is killed
# Topics that need not be recorded from the first message on.
UNAWAITED = (topics.TF, topics.TF_STATIC, topics.DIAGNOSTICS, topics.TRUTH_MODEL)


class RecorderNode(TrialServices):
    """Writes with a :class:`~impact_rs_trials.bags.writer.BagWriter`."""

    kind = "recorder"

    def __init__(self) -> None:
        super().__init__()
        self._arms: list[str] = []
        self._neighbours: tuple[str, ...] = ()
        self._inbox = Inbox(self.node, RECORD, raw=True)
        self._open = ExitStack()  # the bag of the trial that is recorded
        self._recording: OpenTrial | None = None
        self._messages = 0
        self._failure = ""  # why the last bag is not a complete trial
        self._saved = 0.0  # when the bag was last written to the disk, on the monotonic clock [s]
        self._subscriptions = SubscriptionsMatched(self.node, ["plant", "controller"])

    def rehearse(self, spec: TrialSpec) -> None:
        DerivedMessages(spec.plan)
        for kind in set(topics.recorded(list(spec.plan.arms)).values()):
            Readable(typestore(), kind)(b"")  # the first message of a type compiles the code that reads it

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
        self._subscriptions.close()
        absent = [topic for topic in unmatched if not self._publishers(topic)]
        unreceived = [topic for topic in unmatched if topic not in absent]
        complaints = [f"no publisher of {', '.join(absent)}; are plant and controller running?"] if absent else []
        if unreceived:
            complaints.append(f"{', '.join(unreceived)}: published, but not received; is the publisher's QoS reliable?")
        if undiscovered:  # the beginning of the trial would be lost
            complaints.append(
                f"{' and '.join(undiscovered)} did not discover the recorder's subscriptions within {MATCHING_S:g} s"
            )
        if undiscovered or not set(needed).isdisjoint(unmatched):
            raise InputError(f"recorder: {'; '.join(complaints)}")
        for line in complaints:
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

    @property
    def in_trial(self) -> bool:
        return self._recording is not None

    def begin_trial(self, request: ConfigureTrial.Request, response: ConfigureTrial.Response) -> None:
        del response
        self._abort()
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
        tracked = [body for body in ("object", *info.neighbours) if publishers[topics.pose(body)] > 0]
        origin = None if request.ros_time else 0
        with ExitStack() as opened:  # closes it if it cannot be used
            new = BagWriter.create(path, self._arms, origin_ns=origin, neighbours=info.neighbours)
            bag = opened.enter_context(new)
            bag.describe(info)
            bag.write_raw(topics.TRIAL_INFO, 0, serialize_message(request.trial))
            description = {topics.ROBOT_DESCRIPTION: request.robot_description}
            for topic, urdf in (description if plan is None else descriptions(plan.scene.physics)).items():
                bag.write_raw(topic, 0, serialize_message(String(data=urdf)))
            bag.save()
            duration = (
                info.duration
                if plan is None
                else plan.scene.scenario.timing.ticks * plan.scene.scenario.timing.control_period
            )
            self._recording = OpenTrial(name, bag, self._arms, duration, plan, tracked, request.ros_time)
            self._open = opened.pop_all()
        self.log.debug(f"recording {path}")

    def _on_configure(
        self, request: ConfigureTrial.Request, response: ConfigureTrial.Response
    ) -> ConfigureTrial.Response:
        answer = super()._on_configure(request, response)
        self._failure = answer.message  # empty: it records
        return answer

    def finish_trial(self, request: FinishTrial.Request, response: FinishTrial.Response) -> None:
        recording = self._recording
        assert recording is not None
        bag = recording.bag
        expected = {topic: count for topic, count in zip(request.topics, request.counts, strict=False) if count}
        unknown = [topic for topic in expected if not recording.has(topic)]
        if unknown and not request.aborted:
            response.message = f"recorder: {', '.join(unknown)} is no topic of {recording.name}, which is recorded"
            return
        missing = self._complete(recording, expected)
        verdict = Verdict("ABORTED", request.reason or f"messages were published and not received: {missing}")
        if not request.aborted and not missing:
            verdict = self._verdict(recording)
            if verdict.outcome == "ABORTED" and recording.cut_off():  # the request may concern another trial
                response.message = f"recorder: {recording.name} is not over: {verdict.reason}"
                return
        recording.complete()
        note = "; ".join(filter(None, (recording.note(), "" if request.aborted else request.reason)))
        verdict = Verdict(verdict.outcome, "; ".join(filter(None, (verdict.reason, note))))
        if verdict.outcome == "ABORTED":
            self._abort()
        else:
            try:
                bag.finish(verdict.outcome, verdict.reason)
            except (OSError, InputError) as error:
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
            remaining = deadline - time.monotonic()
            if not missing or remaining <= 0.0:
                return missing
            self._inbox.wait(remaining)

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
        self._inbox.close()


def main() -> None:
    """Run the node."""
    run(RecorderNode)


if __name__ == "__main__":
    main()
