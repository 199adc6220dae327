# SPDX-License-Identifier: Apache-2.0
"""A real robot in the plant's place: ros2_control on one side, controller, recorder and experiment on the other.

Every message of the robot's joint states is one tick: it is checked, goes to the controller with the stamp of its tick,
and the torque that comes back goes to the robot. Anything late, beyond a limit, or not a number ends the trial with its
reason, and the arms are braked and held. They are held from when a trial is configured until the node ends, whenever
the controller does not lead them.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import median

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Float64MultiArray

from impact_msgs_py.conversions import pose_from_message
from impact_rs_control.guard import state_complaint, torque_complaint
from impact_rs_control.plan import TrialPlan
from impact_rs_ros.effort_arms import REST, ArmStates, EffortArms, joint_names
from impact_rs_ros.exchange import Inbox, Outbox
from impact_rs_ros.joint_signals import JointReader
from impact_rs_ros.motion_capture import COORDINATES, MOCAP, TrackerPoses
from impact_rs_ros.names import on_network, resolved
from impact_rs_ros.parameters import value
from impact_rs_ros.process import run
from impact_rs_ros.qos import COMMAND, WATCH
from impact_rs_ros.trial_node import CONNECTING, MATCHING, SLICE, LeadingNode, LeadingTrial
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.trial_info import TrialInfo

STATES = "/joint_states"  # of joint_state_broadcaster
REPEAT = 0.25  # s, until the first state is told the controller again
ARMING, ARMING_STATES, ARMING_PATIENCE = 0.5, 50, 3.0  # s, states, s: how long jitter is measured, at least and at most
HOLDING = 0.2  # s of the robot's time, that it must stay where it is held before it is led
PERIOD_TOLERANCE = 0.02  # of the period, that the states of the robot may come faster or slower
BRAKING = 0.6  # s, that the arms may take to rest before a trial is left; six times the time constant of the brake


def commands_topic(arm: str) -> str:
    """What the arm's JointGroupEffortController listens to."""
    return f"/{arm}/effort_controller/commands"


@dataclass(frozen=True)
class Patience:
    """What is late; the node's parameters of these names.

    Attributes:
        state_timeout: A state that is older, or did not come for so long [s].
        answer_timeout: A torque that takes longer [s].
    """

    state_timeout: float
    answer_timeout: float


class RobotClock:
    """The clock of the robot's stamps: this machine's, or with ``use_sim_time`` that of a simulator.

    Args:
        node: Who wants to know the time.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._inbox: Inbox | None = None
        self._simulated = 0
        if value(node, "use_sim_time"):  # past the executor of the node, which does not run while a trial does
            self._inbox = Inbox(node, "clock", WATCH)
            self._inbox.connect({topics.CLOCK: topics.CLOCK_TYPE})

    def now(self) -> int:
        """Time [ns]."""
        if self._inbox is None:
            return int(self._node.get_clock().now().nanoseconds)
        self._inbox.gather()
        for _, message in self._inbox.take():
            self._simulated = message.clock.sec * 10**9 + message.clock.nanosec
        return self._simulated

    @property
    def told(self) -> bool:
        """Whether the time is known; that of a simulator is not until it is heard."""
        return self.now() != 0

    def forget(self) -> None:
        """Time of a simulator that was heard before says nothing of one that was started since."""
        if self._inbox is not None:
            self._inbox.clear()
            self._simulated = 0

    def close(self) -> None:
        """Listen no more."""
        if self._inbox is not None:
            self._inbox.close()


class CellTrial(LeadingTrial):
    """One trial of real arms.

    Args:
        plan: The trial.
        arms: The robot.
        patience: What is late.
        start_tolerance: How far a joint may be from where the trial starts [rad].
        mocap: What the object's poses say.
        inbox: Where the robot's states, the object's poses and the controller's torques come in.
        outbox: Where they go out to controller and recorder.
        robot_clock: The clock of the robot's stamps [ns].
        clock: A clock that never goes back [s].
    """

    def __init__(
        self,
        plan: TrialPlan,
        arms: EffortArms,
        patience: Patience,
        start_tolerance: float,
        mocap: TrackerPoses,
        inbox: Inbox,
        outbox: Outbox,
        robot_clock: Callable[[], int],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(plan)
        self.arms = arms
        self._plan = plan
        self._patience = patience
        self._start_tolerance = start_tolerance
        self._mocap = mocap
        self._inbox = inbox
        self._outbox = outbox
        self._robot_clock = robot_clock
        self._clock = clock
        self._period_ns = round(plan.scene.scenario.timing.control_period * 1e9)
        self._joints = self._maker.joints
        self._arm_of = {topics.joint_command(arm): arm for arm in plan.arms}
        self._readers = {arm: JointReader(names, ("effort",)) for arm, names in self._joints.items()}
        self._origin: int | None = None  # the robot's time at tick 0 [ns]; None: the controller has not answered it yet
        self._tick = 0
        self._first: dict[str, bytes] = {}  # what was told of tick 0, by topic
        self._told = 0.0  # when
        self._heard = clock()  # when the last state came that could be used
        self._asked: dict[int, float] = {}  # when the controller was asked, by tick that has no answer
        self._answered = dict.fromkeys(plan.arms, -1)
        self._lost = 0
        self._oldest = self._slowest = 0.0  # s

    def begin(self) -> None:
        self.begun = True
        self._heard = self._told = self._clock()
        self._asked = {0: self._heard}

    def rest(self, until: float) -> None:
        """Brake and hold, where the controller does not lead, until ``until`` on the clock."""
        while (left := until - self._clock()) > 0.0:
            self._inbox.wait(min(left, 1e-9 * self._period_ns))
            for topic, data in self._inbox.take():
                if topic == STATES and (states := self.arms.read(data)) is not None and not states.complaint:
                    self._heard = self._clock()
                    self.arms.hold()
            if self._silent > self._patience.state_timeout:
                self.arms.let_go()

    def work(self, until: float) -> None:
        while not self.over and (left := until - self._clock()) > 0.0:
            self._inbox.wait(min(left, self._patience.state_timeout, self._patience.answer_timeout))
            for topic, data in self._inbox.take():
                if topic == STATES:
                    self._measured(self.arms.read(data))
                elif topic == MOCAP:
                    self._seen(data)
                else:
                    self._commanded(self._arm_of[topic], data)
                if self.over:
                    return
            self._look_at_the_clock()
            if self._outbox.due:
                self._outbox.flush()

    def stop(self, failure: str) -> None:
        """End before the end, and brake."""
        super().stop(failure)
        if self._silent > self._patience.state_timeout:
            self.arms.let_go()
        else:
            self.arms.hold()

    def end(self) -> str:
        return "OK"

    def status(self) -> tuple[str, dict[str, object]]:
        line = self.failure or (f"{self._lost} states without a torque" if self._lost else "ok")
        return line, {
            **self.tick_statistics(),
            "oldest_state [s]": f"{self._oldest:.6f}",
            "slowest_answer [s]": f"{self._slowest:.6f}",
            "missed_ticks": self._lost,
            "rate_limited_torques": self.arms.limited,
        }

    @property
    def _silent(self) -> float:
        """Time since the last state that could be used [s]."""
        return self._clock() - self._heard

    @property
    def _time(self) -> str:
        return f"at t = {1e-9 * self.now:.3f} s"

    def _measured(self, states: ArmStates | None) -> None:
        """Take a state of the robot, check it, and ask the controller."""
        if states is None:
            return
        now = self._clock()
        if not states.complaint:
            self._heard = now
        if complaint := states.complaint or self._late(states) or self._beyond_a_limit(states):
            self.stop(f"{self._time}: {complaint}")
            return
        if self._origin is None:
            self._ask_first(states, now)
            return
        tick = round((states.stamp - self._origin) / self._period_ns)
        if tick <= self._tick:
            return
        if (tick - self._tick) * self._period_ns > 1e9 * self._patience.state_timeout + self._period_ns:
            self.stop(f"{self._time}: {tick - self._tick - 1} states of the robot are missing")
            return
        if tick > self._last:
            if self._tick < self._last:
                self.stop(f"{self._time}: the last state of the trial is missing")
            return
        self._tick, self.now = tick, tick * self._period_ns
        self._asked[tick] = now
        for arm, measured in states.arms.items():
            self._outbox.now(topics.joint_states(arm), tick, measured)
        self._tick_times.append(self._clock() - now)

    def _ask_first(self, states: ArmStates, now: float) -> None:
        """Tell the state of tick 0 until it is answered; the arms rest meanwhile, and time does not pass."""
        self.arms.hold()
        if not self._first:
            if complaint := start_complaint(self._plan, states, self._start_tolerance):
                self.stop(complaint)
                return
            self._first = {
                topics.joint_states(arm): self._outbox.now(topics.joint_states(arm), 0, measured)
                for arm, measured in states.arms.items()
            }
        elif now - self._told > REPEAT:
            self._told = now
            for topic, data in self._first.items():
                self._outbox.repeat(topic, data)

    def _late(self, states: ArmStates) -> str:
        age = 1e-9 * (self._robot_clock() - states.stamp)
        self._oldest = max(self._oldest, age)
        limit = self._patience.state_timeout
        return "" if abs(age) <= limit else f"the robot's state is {age:.4f} s old, state_timeout is {limit:g} s"

    def _beyond_a_limit(self, states: ArmStates) -> str:
        for name, arm in states.arms.items():
            model = self._plan.scene.models[name]
            if complaint := state_complaint(model, self._joints[name], arm.position, arm.velocity):
                return complaint
        return ""

    def _commanded(self, arm: str, data: bytes) -> None:
        """Take a torque of the controller, check it, and send it to the robot."""
        signals = self._readers[arm].read(data)
        tick = round(signals.stamp / self._period_ns)
        if not self._answered[arm] < tick <= self._tick or not self._first:
            return  # of the trial before, or told twice
        model, joints = self._plan.scene.models[arm], self._joints[arm]
        if complaint := signals.complaint or torque_complaint(model, joints, signals.values[2]):
            self.stop(f"{topics.joint_command(arm)} {self._time}: {complaint}")
            return
        self._answered[arm] = tick
        if self._origin is not None:
            self.arms.command(arm, signals.values[2])
        done = [asked for asked in self._asked if asked <= min(self._answered.values())]
        for asked in done:
            took = self._clock() - self._asked.pop(asked)
            if self._origin is not None and asked == tick:
                self._slowest = max(self._slowest, took)
                if took > self._patience.answer_timeout:
                    self._too_slow(took)
                    return
        self._lost += max(0, len(done) - 1)
        if done and self._origin is None and self.arms.states is not None:
            self._origin = self.arms.states.stamp
        self.over = self._last not in self._asked and self._tick == self._last

    def _too_slow(self, took: float) -> None:
        limit = self._patience.answer_timeout
        self.stop(f"{self._time}: no torque of the controller for {took:.4f} s, answer_timeout is {limit:g} s")

    def _look_at_the_clock(self) -> None:
        """Notice what does not come."""
        silent, limit = self._silent, self._patience.state_timeout
        if silent > limit:
            self.stop(f"{self._time}: no state of the robot for {silent:.4f} s, state_timeout is {limit:g} s")
        elif self._asked:
            waited = self._clock() - next(iter(self._asked.values()))
            if self._origin is not None and waited > self._patience.answer_timeout:
                self._too_slow(waited)
            elif self._origin is None and waited > CONNECTING:
                self.stop(f"the controller does not answer the first state within {CONNECTING:g} s")

    def _seen(self, data: bytes) -> None:
        """Pass on where the object is, in trial time and in the world frame."""
        if self._origin is None:
            return
        try:
            pose = self._mocap.read(data)
        except InputError as error:
            self.stop(f"{self._time}: {error}")
            return
        if pose is None:
            return
        stamp = pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec - self._origin
        if 0 <= stamp <= self._last * self._period_ns:
            pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(stamp, 10**9)
            self._outbox.later(topics.OBJECT_POSE, pose)


def start_complaint(plan: TrialPlan, states: ArmStates, tolerance: float) -> str:
    """Why the arms are not where a trial starts, at rest; empty: they are.

    Args:
        plan: The trial.
        states: Of the arms.
        tolerance: How far a joint may be away [rad].
    """
    for name, own in plan.arms.items():
        arm = states.arms[name]
        away = arm.position - own.initial
        index = int(np.argmax(np.abs(away)))
        if abs(away[index]) > tolerance:
            start = ", ".join(f"{value:.4f}" for value in own.initial)
            return (
                f"joint {index + 1} of {name} is {away[index]:+.4f} rad from where the trial starts, start_tolerance "
                f"is {tolerance:g} rad; move the arm to [{start}]"
            )
        if not np.all(np.abs(arm.velocity) <= REST):
            fastest = np.abs(arm.velocity).max()
            return f"{name} moves at {fastest:.3g} rad/s; a trial starts at rest, below {REST:g} rad/s"
    return ""


def off_its_place(plan: TrialPlan, pose: PoseStamped) -> str:
    """How far the object is from where the scenario has it, in words; shows what a wrong placement of the tracker does.

    Args:
        plan: The trial.
        pose: Of the object, in ``world``.
    """
    nominal = pin.SE3(plan.scene.object.rotation, plan.scene.object.position)
    there = nominal.actInv(pin.XYZQUATToSE3(pose_from_message(pose.pose)))
    distance, angle = (float(np.linalg.norm(part)) for part in (there.translation, pin.log3(there.rotation)))
    return f"{1e3 * distance:.1f} mm and {np.degrees(angle):.1f} deg from its place in the scenario"


class CellNode(LeadingNode[CellTrial]):
    """Runs trials on a robot that ros2_control drives."""

    kind = "cell"
    name = "plant"

    def __init__(self) -> None:
        super().__init__()
        self._commands: dict[str, Publisher] = {}
        self._robot_clock = RobotClock(self.node)
        self._object: PoseStamped | None = None  # where it was last seen while the robot is armed

    def received(self, arms: list[str]) -> dict[str, str]:
        seen = {MOCAP: topics.POSE} if self.parameter("mocap") else {}
        return {STATES: topics.JOINT_STATE} | {topics.joint_command(arm): topics.JOINT_STATE for arm in arms} | seen

    def published(self, arms: list[str]) -> dict[str, str]:
        seen = {topics.OBJECT_POSE: topics.POSE} if self.parameter("mocap") else {}
        return {topics.joint_states(arm): topics.JOINT_STATE for arm in arms} | seen

    def streams(self, maker: StreamMaker) -> dict[str, Stream]:
        return {topics.joint_states(arm): maker.joint_states(arm) for arm in self.arms}

    def connect(self, arms: list[str]) -> None:
        super().connect(arms)
        for arm in arms:
            if arm not in self._commands:
                name = on_network(commands_topic(arm))
                self._commands[arm] = self.node.create_publisher(Float64MultiArray, name, COMMAND)

    def turn(self) -> None:
        if self.running or self.trial is None:
            super().turn()
            return
        self.trial.rest(time.monotonic() + SLICE)
        self.executor.spin_once(timeout_sec=0.0)
        self.diagnose()

    def wait(self) -> None:
        if self.trial is not None:
            self.trial.rest(time.monotonic() + MATCHING)

    def prepare(self, plan: TrialPlan, info: TrialInfo) -> CellTrial:
        del info
        models = {arm: plan.scene.models[arm] for arm in plan.arms}
        pattern = self.parameter("joints")
        joints = {arm: joint_names(pattern, arm, model.joint_count) for arm, model in models.items()}
        if len(models) > 1 and "{arm}" not in pattern:
            raise InputError(f"expected {{arm}} in it, for the arms {', '.join(models)}", key="joints", value=pattern)
        arms = EffortArms(
            models,
            joints,
            self.parameter("robot_adds_gravity"),
            self.parameter("torque_rate_limit") * plan.scene.scenario.timing.control_period,
            self._send,
        )
        patience = Patience(self.parameter("state_timeout"), self.parameter("answer_timeout"))
        tolerance = self.parameter("start_tolerance")
        placement = np.array([self.parameter(f"mocap_{name}") for name in COORDINATES])
        mocap = TrackerPoses(self.parameter("mocap_frame"), placement)
        self._arm(plan, arms, mocap, patience, tolerance)
        return CellTrial(plan, arms, patience, tolerance, mocap, self.inbox, self.outbox, self._robot_clock.now)

    def close(self) -> None:
        self._brake()
        self._robot_clock.close()
        super().close()

    def _send(self, arm: str, torque: Array) -> None:
        self._commands[arm].publish(Float64MultiArray(data=array("d", torque.tobytes())))

    def _leave(self) -> str:
        """Leave the trial with arms that rest: while the next one is loaded, the robot keeps its last torque."""
        outcome = super()._leave()
        self._brake()
        return outcome

    def _brake(self) -> None:
        """Go on until what the robot was sent last may stay."""
        if self.trial is None:
            return
        until = time.monotonic() + BRAKING
        while not self.trial.arms.held:
            if time.monotonic() > until:
                self.log.error(f"the arms do not come to rest within {BRAKING:g} s: press the emergency stop")
                return
            self.trial.rest(time.monotonic() + MATCHING)

    def _arm(
        self, plan: TrialPlan, arms: EffortArms, mocap: TrackerPoses, patience: Patience, tolerance: float
    ) -> None:
        """Look at the robot for a moment before it is led, then hold it for another.

        Raises:
            InputError: It is not where the trial starts, its states do not come as the trial needs them, this process
                does not get them in time, or it does not stay where it is held.
        """
        limit = self.parameter("arm_jitter_limit")
        period = plan.scene.scenario.timing.control_period
        topic = resolved(self.node, STATES)
        arrivals: list[float] = []
        stamps: list[int] = []
        age = 0.0
        began = time.monotonic()
        self.inbox.clear()
        self._robot_clock.forget()
        self._object = None
        for states in self._heed(arms, mocap, None if self.trial is None else self.trial.arms):
            if not self._robot_clock.told:
                continue
            arrivals.append(time.monotonic())
            stamps.append(states.stamp)
            age = max(age, abs(1e-9 * (self._robot_clock.now() - states.stamp)))
            if complaint := start_complaint(plan, states, tolerance):
                raise InputError(f"not armed: {complaint}")
            if arrivals[-1] > began + ARMING and len(stamps) >= ARMING_STATES:
                break
        if arms.states is None:
            raise InputError(f"nobody tells the joints {self.parameter('joints')!r} on {topic}: is the robot running?")
        if not self._robot_clock.told:
            raise InputError(f"nobody tells the time on {topics.CLOCK}, which use_sim_time asks for")
        if len(stamps) < ARMING_STATES:
            raise InputError(f"{topic}: {len(stamps)} states in {ARMING_PATIENCE:g} s, expected {ARMING_STATES}")
        steps = 1e-9 * np.diff(np.array(stamps))
        if abs(median(steps.tolist()) - period) > PERIOD_TOLERANCE * period:
            raise InputError(
                f"{topic}: a state every {1e3 * median(steps.tolist()):.3f} ms; timing.control_period of the scenario "
                f"is {1e3 * period:g} ms"
            )
        if age > patience.state_timeout:
            raise InputError(
                f"{topic}: a state is {age:.4f} s off this node's clock, state_timeout is {patience.state_timeout:g} "
                "s: are the clocks of both machines the same?"
            )
        jitter = float(np.abs(np.diff(np.array(arrivals)) - steps).max())
        if jitter > limit:
            raise InputError(
                f"not armed: states come with a jitter of {1e3 * jitter:.3f} ms, arm_jitter_limit is {1e3 * limit:g} ms"
            )
        if self.parameter("mocap") and self._object is None:
            raise InputError(f"no pose of the object on {resolved(self.node, MOCAP)}")
        self._take_over(plan, arms, mocap, tolerance)
        told = f"armed: jitter {1e3 * jitter:.3f} ms, oldest state {1e3 * age:.3f} ms, {len(stamps)} states"
        self.log.info(told if self._object is None else f"{told}, object {off_its_place(plan, self._object)}")

    def _take_over(self, plan: TrialPlan, arms: EffortArms, mocap: TrackerPoses, tolerance: float) -> None:
        """Hold the arms for a moment.

        Raises:
            InputError: They do not stay: above all where robot and node differ on who carries their weight.
        """
        assert arms.states is not None
        until = arms.states.stamp + round(1e9 * HOLDING)
        for states in self._heed(arms, mocap, arms):
            if complaint := start_complaint(plan, states, tolerance):
                arms.let_go()
                adds = "adds" if self.parameter("robot_adds_gravity") else "does not add"
                raise InputError(
                    f"not armed: {complaint}, while it was held; this node believes that the robot {adds} gravity "
                    f"(robot_adds_gravity)"
                )
            if states.stamp >= until:
                return
        raise InputError(f"not armed: the robot told less than {HOLDING:g} s in {ARMING_PATIENCE:g} s")

    def _heed(self, arms: EffortArms, mocap: TrackerPoses, holder: EffortArms | None) -> Iterator[ArmStates]:
        """The robot's states for a while, each when it comes; the object's poses are looked at on the way.

        Args:
            arms: Who reads the states.
            mocap: Who reads the poses.
            holder: Who holds the arms meanwhile, for what holds them must not grow old; None: nobody yet.

        Raises:
            InputError: A state or pose cannot be used.
        """
        until, first = time.monotonic() + ARMING_PATIENCE, True
        while time.monotonic() < until:
            self.inbox.wait(MATCHING)
            for name, data in self.inbox.take():
                if name == MOCAP:
                    self._object = mocap.read(data) or self._object
                if name != STATES or (states := arms.read(data)) is None:
                    continue
                if first:  # of a robot that was only just found
                    until, first = time.monotonic() + ARMING_PATIENCE, False
                if states.complaint:
                    raise InputError(f"{resolved(self.node, STATES)}: {states.complaint}")
                if holder is not None:
                    holder.read(data)
                    holder.hold()
                yield states


def main() -> None:
    """Run the node."""
    run(CellNode)


if __name__ == "__main__":
    main()
