# SPDX-License-Identifier: Apache-2.0
"""A robot is armed if its states come regularly and in time, it is where the trial starts, and it stays there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from robot_bench import PERIOD, PUSH, START, SWITCHED_ON, Robot, Wire, state_message

from impact_msgs_py.conversions import pose_to_message
from impact_rs_sim.errors import InputError
from impact_rs_trials.cell.arming import (
    ARMING_TIMEOUT_S,
    HOLDING_S,
    MIN_OBSERVED_S,
    Arming,
    ArmingLimits,
    distance_from_scenario,
)
from impact_rs_trials.cell.effort_arms import rest_until
from impact_rs_trials.cell.motion_capture import MOCAP, TrackerPoses
from impact_rs_trials.cell.robot_states import STATES

Motion = Callable[[float], dict[str, np.ndarray]]
STEADY: Motion = lambda time: {}  # noqa: E731
LIMITS = ArmingLimits(start=0.01, jitter=0.002)


def pose_message(stamp: int, frame: str = "tracker") -> bytes:
    there = PUSH.scene.object
    pose = PoseStamped(pose=pose_to_message(pin.SE3ToXYZQUAT(pin.SE3(there.rotation, there.position))))
    pose.header.frame_id = frame
    pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(stamp, 10**9)
    return bytes(serialize_message(pose))


class Bench:
    """A robot whose states are put on the wire beforehand, with stamps of every period."""

    def __init__(
        self,
        motion: Motion = STEADY,
        period: float = PERIOD,
        late: Callable[[int], float] = lambda step: 0.0,
        span: tuple[float, float] = (0.0, 1.2),
        mocap: TrackerPoses | None = None,
    ) -> None:
        self.robot = Robot()
        self.wire = Wire(self.robot.clock)
        for step in range(*(round(end / period) for end in span)):
            time = step * period
            stamp = SWITCHED_ON + round(1e9 * time)
            self.wire.put(100.0 + time + late(step), STATES, state_message(stamp, **motion(time)))
        self.arming = Arming(
            PUSH,
            self.robot.arms,
            mocap,
            self.wire,
            LIMITS,
            None,
            self.robot.clock,  # type: ignore[arg-type]
        )

    def run(self) -> str:
        found = self.arming.look()
        assert self.robot.sent == []  # nothing, as long as it is only looked at
        return found + self.arming.hold()


def refusal(bench: Bench) -> str:
    with pytest.raises(InputError) as error:
        bench.run()
    return str(error.value)


def test_a_robot_at_its_start_is_armed_and_told_of_and_held_since() -> None:
    bench = Bench()
    assert bench.run().startswith("jitter 0.000 ms, oldest state 0.000 ms, 50")
    np.testing.assert_allclose(bench.robot.sent, 0.0, atol=1e-9)
    assert MIN_OBSERVED_S + HOLDING_S <= bench.robot.clock.time - 100.0 < MIN_OBSERVED_S + HOLDING_S + 0.01
    assert len(bench.robot.sent) == pytest.approx(HOLDING_S / PERIOD, abs=2)
    assert bench.robot.arms.held


def test_a_robot_that_is_silent_or_stops_is_not_armed() -> None:
    silent, stops = Bench(span=(0.0, 0.0)), Bench(span=(0.0, 0.03))
    assert "no state of fr3_joint1 and the other joints on /joint_states: is the robot running?" in refusal(silent)
    assert silent.robot.clock.time == pytest.approx(100.0 + ARMING_TIMEOUT_S, abs=0.01)
    assert "/joint_states: 30 states in 3 s, expected 50" in refusal(stops)


@pytest.mark.parametrize("factor", [0.97, 1.03, 1.5])
def test_states_at_another_rate_than_the_scenarios_are_refused(factor: float) -> None:
    assert f"a state every {factor:.3f} ms; timing.control_period of the scenario is 1 ms" in refusal(
        Bench(period=factor * PERIOD)
    )


def test_a_period_that_is_one_percent_off_is_the_scenarios() -> None:
    assert Bench(period=1.01 * PERIOD).run()


@pytest.mark.parametrize(("pause", "armed"), [(3.5, False), (1.5, True)])
def test_one_late_state_that_delays_others_is_jitter_enough(pause: float, armed: bool) -> None:
    bench = Bench(late=lambda step: 1e-3 * max(0.0, pause - (step - 100)) if step >= 100 else 0.0)
    if armed:
        assert bench.run().startswith("jitter 1.500 ms")
    else:
        assert refusal(bench) == "not armed: states come with a jitter of 3.500 ms, arm_jitter_limit is 2 ms"


def test_a_robot_that_is_found_late_is_observed_as_long() -> None:
    """Kills an observation that begins before the robot is found, and ends after 50 states."""
    bench = Bench(late=lambda step: 1e-3 * max(0.0, 3.5 - (step - 800)) if step >= 800 else 0.0, span=(0.6, 2.0))
    assert refusal(bench) == "not armed: states come with a jitter of 3.500 ms, arm_jitter_limit is 2 ms"


@pytest.mark.parametrize(("age", "complaint"), [(0.02, "0.0200 s old"), (-0.02, "stamped 0.0200 s in the future")])
def test_stamps_of_another_clock_are_refused(age: float, complaint: str) -> None:
    bench = Bench()
    bench.robot.clock.now = lambda: SWITCHED_ON + round(1e9 * (bench.robot.clock.time - 100.0 + age))  # type: ignore[method-assign]
    assert f"not armed: /joint_states: the robot's state is {complaint}" in refusal(bench)


def test_a_time_that_is_not_known_is_said() -> None:
    bench = Bench()
    bench.robot.clock.known = False
    assert refusal(bench) == "not armed: no time on /clock, which use_sim_time asks for"


@pytest.mark.parametrize(
    ("motion", "complaint"),
    [
        (
            lambda time: {"position": START + [0, 0, 0, 0.02, 0, 0, 0]},
            "joint 4 of arm is +0.0200 rad from where the trial",
        ),
        (
            lambda time: {"position": START - [0, 0.02, 0, 0, 0, 0, 0]},
            "joint 2 of arm is -0.0200 rad from where the trial",
        ),
        (lambda time: {"velocity": np.full(7, 0.021)}, "arm moves at 0.021 rad/s"),
        (lambda time: {"velocity": np.full(7, -0.021)}, "arm moves at 0.021 rad/s"),
    ],
)
def test_an_arm_elsewhere_or_in_motion_is_not_armed(motion: Motion, complaint: str) -> None:
    bench = Bench(motion)
    found = refusal(bench)
    assert found.startswith(f"not armed: {complaint}")
    assert "held" not in found
    assert bench.robot.sent == []


def falling(time: float) -> dict[str, np.ndarray]:
    """From when it is held on, as with the wrong gravity convention."""
    since = max(0.0, time - MIN_OBSERVED_S - 0.05)
    return {"position": START - 0.5 * since**2, "velocity": np.full(7, -since)}


def test_an_arm_that_falls_when_held_is_not_armed_and_stays_braked() -> None:
    bench = Bench(falling)
    found = refusal(bench)
    assert "arm moves at 0.02" in found
    assert "while it was held; this node assumes that the robot adds gravity (robot_adds_gravity)" in found
    since = bench.robot.clock
    rest_until(bench.robot.arms, bench.wire, since.time + 0.05, since)  # type: ignore[arg-type]
    assert bench.robot.sent[-1] @ falling(since.time - 100.0)["velocity"] < 0.0  # against the motion
    assert not bench.robot.arms.held


def test_an_arm_that_is_held_must_go_on_reporting() -> None:
    bench = Bench(span=(0.0, MIN_OBSERVED_S + 0.1))
    assert "less than 0.2 s of states in 3 s while the robot was held" in refusal(bench)


def test_arms_of_the_trial_before_are_held_during_the_look() -> None:
    bench, before = Bench(), Robot()
    before.clock = before.states.clock = bench.robot.clock
    bench.arming._holder = before.arms
    bench.arming.look()
    assert len(before.sent) == pytest.approx(MIN_OBSERVED_S / PERIOD, abs=2)
    assert bench.robot.sent == []


@pytest.mark.parametrize(("taken", "armed"), [((0.3, 0.6), True), ((), False), ((-1.0,), False)])
def test_an_object_that_mocap_shall_see_must_have_been_seen_lately(taken: tuple[float, ...], armed: bool) -> None:
    bench = Bench(mocap=TrackerPoses("tracker", np.zeros(6)))
    for time in taken:
        bench.wire.put(100.0 + max(0.1, time), MOCAP, pose_message(SWITCHED_ON + round(1e9 * time)))
    if armed:
        assert bench.run().endswith(", object 0.0 mm and 0.0 deg from its place in the scenario")
    else:
        assert refusal(bench) == "not armed: no pose of the object on /mocap/object_pose in the last 0.5 s"


def test_an_object_that_was_seen_before_a_late_robot_was_found_is_not_seen_lately() -> None:
    """Kills an age that is compared when the pose comes and not when it is used."""
    bench = Bench(mocap=TrackerPoses("tracker", np.zeros(6)), span=(1.0, 2.5))
    bench.wire.put(100.1, MOCAP, pose_message(SWITCHED_ON + 10**8))
    assert refusal(bench) == "not armed: no pose of the object on /mocap/object_pose in the last 0.5 s"


def test_a_pose_in_another_frame_is_refused() -> None:
    bench = Bench(mocap=TrackerPoses("tracker", np.zeros(6)))
    bench.wire.put(100.1, MOCAP, pose_message(SWITCHED_ON, frame="world"))
    assert "frame_id of /mocap/object_pose = 'world': expected tracker" in refusal(bench)


def test_a_wrong_placement_of_the_tracker_shows_as_distance_and_angle() -> None:
    """As with a yaw that is 3 degrees off, and an origin 25 mm too high."""
    there = PUSH.scene.object
    turned = pin.SE3(
        pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(3.0)) @ there.rotation, there.position + [0.0, 0.0, 0.025]
    )
    pose = PoseStamped(pose=pose_to_message(pin.SE3ToXYZQUAT(turned)))
    assert distance_from_scenario(PUSH, pose) == "25.0 mm and 3.0 deg from its place in the scenario"
