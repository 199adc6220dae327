# SPDX-License-Identifier: Apache-2.0
"""A real robot in the plant's place: ros2_control on one side, controller, recorder and experiment on the other.

From arming until the node ends, the arms are either led by the controller, in a trial, or braked and held.

With the parameter ``watchdog`` the torques go to the watchdog node, which alone sends them to the robot. If the
watchdog has forwarded no torque for ``watchdog_timeout``, because it has died, the cell bypasses it: it brakes the
arms itself, and sends empty messages, after which a watchdog that comes back forwards nothing. ``docs/safety.md`` has
the safety argument.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Sequence

import numpy as np
from rclpy.publisher import Publisher
from std_msgs.msg import Bool, Float64MultiArray

from impact_rs_control.plan import TrialPlan
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.message_types import torques_of
from impact_rs_ros.names import frame_prefix, on_network, resolved
from impact_rs_ros.presence import UNKNOWN
from impact_rs_ros.process import run
from impact_rs_ros.qos import COMMAND, LATCHED, WATCH
from impact_rs_ros.robot_clock import RobotClock
from impact_rs_ros.trial_node import SUBSCRIBER_POLL_S, TRIAL_SLICE_S, LeadingNode
from impact_rs_ros.watchdog_node import BRAKING_TOPIC, TORQUES, WatchdogNode
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.cell.arming import Arming, ArmingLimits
from impact_rs_trials.cell.cell_trial import CellTrial, TrialLimits
from impact_rs_trials.cell.effort_arms import (
    MAX_BRAKING_S,
    EffortArms,
    arms_of,
    commands_topic,
    rest_until,
    watched_topic,
)
from impact_rs_trials.cell.motion_capture import COORDINATES, MOCAP, TrackerPoses
from impact_rs_trials.cell.robot_states import STATES

DISCOVERY_S = 1.0  # in which the effort controllers, and the names of all publishers of torques, must be found
ECHO_POLL_S = 0.005  # between two checks of the torques that the watchdog passed on
PUBLISHER_POLL_S = 0.1  # between two checks who else publishes topics reserved for this cell or one robot


class CellNode(LeadingNode[CellTrial]):
    """Runs trials on a robot that ros2_control drives."""

    kind = "cell"
    replaced_node = "plant"
    ros_time = True

    def __init__(self) -> None:
        super().__init__()
        self._topics: dict[str, str] = {}  # torque topic of an arm: the watchdog's, or the robot's
        self._publishers: dict[str, Publisher] = {}  # of torques, by topic
        self._clock = RobotClock(self.node)
        self._echo = Inbox(self.node, WATCH, raw=True)  # torques forwarded by the watchdog
        self._forwarded: dict[str, Array] = {}  # last torque that the watchdog forwarded, by arm
        self._unforwarded_since: float | None = None  # time of the first torque that was not forwarded [s]
        self._echo_checked = 0.0  # time of the last check of the echo [s]
        self._bypassing = False  # whether the watchdog has died, and the cell sends torques directly
        self._held_arms: EffortArms | None = None  # arms that received torques, held between trials
        self._state_publishers = 1  # publishers of joint states when the trial was armed
        self._publishers_checked = 0.0
        self._watchdog_brakes = False
        self.node.create_subscription(Bool, on_network(BRAKING_TOPIC), self._on_watchdog, LATCHED)

    def received(self, arms: list[str]) -> dict[str, str]:
        tracker_topics = {MOCAP: topics.POSE} if self.parameter("mocap") else {}
        return (
            {STATES: topics.JOINT_STATE}
            | {topics.joint_command(arm): topics.JOINT_STATE for arm in arms}
            | tracker_topics
        )

    def published(self, arms: list[str]) -> dict[str, str]:
        tracker_topics = {topics.OBJECT_POSE: topics.POSE} if self.parameter("mocap") else {}
        return (
            {topics.joint_states(arm): topics.JOINT_STATE for arm in arms}
            | {topics.TF_STATIC: topics.TF_MESSAGE}
            | tracker_topics
        )

    def streams(self, maker: StreamMaker) -> dict[str, Stream]:
        return {topics.joint_states(arm): maker.joint_states(arm) for arm in self.arms}

    def connect(self, arms: list[str], neighbours: Sequence[str] = ()) -> None:
        super().connect(arms, neighbours)
        topic_of = watched_topic if self.parameter("watchdog") else commands_topic
        self._topics = {arm: topic_of(arm) for arm in arms}
        watched = {commands_topic(arm): TORQUES for arm in arms if self.parameter("watchdog")}
        if set(self._echo.publishers()) != set(watched):
            self._echo.connect(watched)
        wanted = set(self._topics.values()) | set(watched)
        for topic in set(self._publishers) - wanted:
            self.node.destroy_publisher(self._publishers.pop(topic))
        for topic in wanted - set(self._publishers):
            self._publishers[topic] = self.node.create_publisher(Float64MultiArray, on_network(topic), COMMAND)

    def disconnect(self) -> None:
        """Keep the connections: the arms rest and are held while the node is inactive, as between two trials."""

    def cleanup(self) -> None:
        """Brake the arms, and leave them at rest with their last torque."""
        super().cleanup()
        self.brake()
        self._held_arms = None
        self.connect([])
        super().disconnect()

    def turn(self) -> None:
        if self.running or self._held_arms is None:
            super().turn()
            return
        self._rest(TRIAL_SLICE_S)
        self.serve(0.0)
        self.diagnose()

    def wait(self) -> None:
        if self._held_arms is not None:
            self._rest(SUBSCRIBER_POLL_S)

    def work(self, trial: CellTrial, until: float) -> None:
        now = time.monotonic()
        if self._bypassing and trial.begun and not trial.over:
            trial.stop(f"the watchdog passed no torques on for {self.parameter('watchdog_timeout'):g} s: is it alive?")
        if trial.begun and not trial.over and now - self._publishers_checked > PUBLISHER_POLL_S:
            self._publishers_checked = now
            if complaint := self._unexpected_publishers():
                trial.stop(complaint)
        super().work(trial, until)

    def prepare(self, plan: TrialPlan, maker: MessageMaker, info: TrialInfo, ros_time: bool) -> CellTrial:
        del info, ros_time
        arms = arms_of(plan, self.parameter, self._clock, self._send)
        mocap = None
        if self.parameter("mocap"):
            placement = np.array([self.parameter(f"mocap_{name}") for name in COORDINATES])
            mocap = TrackerPoses(self.parameter("mocap_frame"), placement)
        start = self.parameter("start_tolerance")
        self._state_publishers = self.node.count_publishers(resolved(self.node, STATES))
        self._await_publisher_names()
        if complaint := self._unexpected_publishers():
            raise InputError(f"not armed: {complaint}")
        self.inbox.clear()
        self._clock.forget()
        arming_limits = ArmingLimits(start, self.parameter("arm_jitter_limit"))
        arming = Arming(plan, arms, mocap, self.inbox, arming_limits, self._held_arms)
        arming_report = arming.look()
        self._await_listeners()
        self._held_arms = arms
        self.log.info(f"armed: {arming_report}{self._hold(arming)}")
        limits = TrialLimits(
            state_timeout=self.parameter("state_timeout"),
            answer_timeout=self.parameter("answer_timeout"),
            late_torque_share=self.parameter("late_torque_share"),
            start_tolerance=start,
            start_delay=self.parameter("start_delay"),
        )
        prefix = frame_prefix(self.node.get_namespace())
        frames = [*FrameSource(plan.scene, prefix, links=False).static, *(mocap.frames(prefix) if mocap else ())]
        maker.origin_ns = self._clock.now()  # of the frames; the trial chooses its own
        self.outbox.later(topics.TF_STATIC, maker.transforms(0, frames))
        return CellTrial(plan, maker, arms, limits, mocap, self.inbox, self.outbox)

    def _hold(self, arming: Arming) -> str:
        """Hold the arms for a moment, through the watchdog if there is one; returns the result.

        Raises:
            InputError: The arms move, or the watchdog forwards nothing.
        """
        was_bypassing, self._bypassing = (
            self._bypassing,
            False,
        )  # a watchdog that was started again may have arms that rest
        self._echo.clear()
        self._forwarded, self._unforwarded_since = {}, None
        try:
            holding_report = arming.hold()
            if self.parameter("watchdog") and (self._bypassing or len(self._forwarded) < len(self.arms)):
                raise InputError("not armed: the watchdog passes no torques on: does it hear the robot's states?")
        except InputError:
            self._bypassing = self._bypassing or was_bypassing
            raise
        return holding_report

    def close(self) -> None:
        self.brake()
        self._echo.close()
        self._clock.close()
        super().close()

    def brake(self) -> None:
        """Brake until the arms are at rest, where the last torque of the robot may stay."""
        until = time.monotonic() + MAX_BRAKING_S
        while self._held_arms is not None and not self._held_arms.held:
            if time.monotonic() > until:
                self.log.error(f"the arms did not come to rest within {MAX_BRAKING_S:g} s: press the emergency stop")
                return
            self._rest(SUBSCRIBER_POLL_S)

    def _rest(self, seconds: float) -> None:
        if self._held_arms is not None:
            rest_until(self._held_arms, self.inbox, time.monotonic() + seconds, time.monotonic)

    def _on_watchdog(self, message: Bool) -> None:
        self._watchdog_brakes = message.data

    def _send(self, arm: str, torque: Array) -> None:
        message, direct = Float64MultiArray(data=array("d", torque.tobytes())), commands_topic(arm)
        if self._bypassing:
            self._publishers[direct].publish(message)
            self._publishers[self._topics[arm]].publish(Float64MultiArray())  # for a watchdog that comes back
            return
        self._publishers[self._topics[arm]].publish(message)
        if self._topics[arm] != direct:
            self._check_echo(self._clock.steady())

    def _check_echo(self, now: float) -> None:
        """Check the torques that the watchdog forwards; bypass it after a long silence."""
        if 0.0 <= now - self._echo_checked < ECHO_POLL_S:
            return
        patience = self.parameter("watchdog_timeout")
        stalled, self._echo_checked = now - self._echo_checked > patience / 2.0, now
        self._echo.gather()
        arm_of = {commands_topic(arm): arm for arm in self.arms}
        forwarded = {
            arm_of[topic]: torque for topic, data in self._echo.take() if (torque := torques_of(data)) is not None
        }
        self._forwarded |= forwarded
        if (
            forwarded or stalled or self._unforwarded_since is None
        ):  # torques that this process did not send cannot be forwarded
            self._unforwarded_since = now
        if (
            now - self._unforwarded_since <= patience
            or self._held_arms is None
            or len(self._forwarded) < len(self.arms)
        ):
            return
        self._bypassing = True
        self.log.error(f"the watchdog passed no torques on for {patience:g} s: braking without it")
        for arm, torque in self._forwarded.items():
            self._held_arms.continue_from(arm, torque)

    def _leave(self) -> str:
        """Leave the trial with arms that rest: while the next one is loaded, the robot keeps its last torque."""
        outcome = super()._leave()
        self.brake()
        return outcome

    def _unexpected_publishers(self) -> str:
        """Names of unexpected publishers of reserved topics; empty: not any."""
        cell_name = self.node.get_name(), self.node.get_namespace()
        watchdog = WatchdogNode.kind, cell_name[1]
        robot_topics = {resolved(self.node, commands_topic(arm)) for arm in self.arms}
        for topic in self._torque_topics():
            unexpected = [
                (info.node_name, info.node_namespace) for info in self.node.get_publishers_info_by_topic(topic)
            ]
            expected_nodes = [cell_name]
            if self.parameter("watchdog") and topic in robot_topics:
                expected_nodes.append(watchdog)
            for node in expected_nodes:
                if node in unexpected:
                    unexpected.remove(node)
            if unexpected:
                names = ", ".join(f"{namespace.rstrip('/')}/{name}" for name, namespace in unexpected)
                remedy = "stop it (one that was killed is forgotten after 20 s)"
                if watchdog in unexpected and not self.parameter("watchdog"):
                    remedy = "set the parameter watchdog, so that torques go through it, or stop it"
                return f"{names} can send torques on {topic} as well: {remedy}"
        if self._watchdog_brakes:
            reset = self.node.resolve_service_name("watchdog/reset")
            return f"the watchdog brakes the arms: ros2 service call {reset} std_srvs/srv/Trigger when it is safe"
        if self.parameter("watchdog") and not self.node.count_publishers(resolved(self.node, BRAKING_TOPIC)):
            namespace_arguments = "" if cell_name[1] == "/" else f" --ros-args -r __ns:={cell_name[1]}"
            command = f"ros2 run impact_rs watchdog{namespace_arguments}"
            return f"there is no watchdog, and the parameter watchdog asks for one: {command}"
        sources = self.node.count_publishers(resolved(self.node, STATES))
        if sources > max(1, self._state_publishers):
            topic = resolved(self.node, STATES)
            return f"{sources} publishers on {topic}, {self._state_publishers} when the trial was armed"
        return ""

    def _torque_topics(self) -> list[str]:
        """Full names of all topics that carry torques to the robot."""
        return [resolved(self.node, topic) for topic in self._publishers]

    def _await_publisher_names(self) -> None:
        """Wait for the names of all publishers of torques; unnamed ones are strangers, a watchdog is not."""
        until = time.monotonic() + DISCOVERY_S
        while time.monotonic() < until and any(
            info.node_name == UNKNOWN
            for topic in self._torque_topics()
            for info in self.node.get_publishers_info_by_topic(topic)
        ):
            self.inbox.wait(SUBSCRIBER_POLL_S)
            self._rest(SUBSCRIBER_POLL_S)

    def _await_listeners(self) -> None:
        """Wait for subscribers to the torques, which may be discovered after the states."""
        until = time.monotonic() + DISCOVERY_S
        for arm in self.arms:
            for topic in {self._topics[arm]: None, commands_topic(arm): None}:
                name = resolved(self.node, topic)
                own_subscriptions = topic != self._topics[arm]  # the cell itself subscribes to the watchdog's output
                while self._publishers[topic].get_subscription_count() <= own_subscriptions:
                    if time.monotonic() > until:
                        remedy = "is the effort controller active, is the topic remapped?"
                        if topic != commands_topic(arm):
                            remedy = "does the watchdog have the scenario of the trial?"
                        raise InputError(f"not armed: nothing listens to torques on {name}: {remedy}")
                    self.inbox.wait(SUBSCRIBER_POLL_S)
                    self._rest(SUBSCRIBER_POLL_S)


def main() -> None:
    """Run the node."""
    run(CellNode)


if __name__ == "__main__":
    main()
