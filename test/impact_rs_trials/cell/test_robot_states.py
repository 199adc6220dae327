# SPDX-License-Identifier: Apache-2.0
"""A state of the robot is usable if it is new, fresh, complete, within limits and agrees with the states before."""

from __future__ import annotations

import numpy as np
import pytest
from robot_bench import GRAB, JOINTS, LIMIT, MODEL, PERIOD, START, WEIGHT, Robot, state_message

from impact_rs_sim.errors import InputError
from impact_rs_trials.cell.robot_states import EXTRA, StateReader, joint_names


def test_a_usable_state_is_the_latest_and_ages() -> None:
    robot = Robot()
    assert robot.states.age == np.inf
    states = robot.state(age=0.004)
    assert states.complaint == "" and robot.states.latest is states
    np.testing.assert_array_equal(states.arms["arm"].position, START)
    assert robot.states.age == pytest.approx(0.004)
    robot.clock.time += 0.5
    assert robot.states.age == pytest.approx(0.504)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"velocity": np.array([np.nan, 0, 0, 0, 0, 0, 0])}, "velocity of fr3_joint1 is nan"),
        ({"effort": np.array([0, 0, 0, 0, 0, 0, -np.inf])}, "effort of fr3_joint7 is -inf"),
        ({"effort": np.array([0, 0, 1e6, 0, 0, 0, 0])}, "fr3_joint3 measures 1e+06 N m, more than 5 times its limit"),
        ({"position": np.full(3, 0.1)}, "3 values of position, expected 7"),
        ({"effort": np.zeros(8)}, "8 values of effort, expected 7"),
        ({"velocity": np.zeros(0)}, "0 values of velocity, expected 7"),
        ({"names": JOINTS[:6] + ["finger"]}, "no fr3_joint7 among fr3_joint1"),
        ({"names": JOINTS[:6] + ["fr3_joint6"]}, "no fr3_joint7"),
        (
            {"names": [*JOINTS, "fr3_joint2"], **{k: np.zeros(8) for k in ("position", "velocity", "effort")}},
            "fr3_joint2 is 2 times in one message",
        ),
        ({"position": START + [0, 0, 3.0, 0, 0, 0, 0]}, "fr3_joint3 at "),
        ({"velocity": np.array([0, 0, 0, 0, 3.0, 0, 0])}, "fr3_joint5 at 3 rad/s, limit "),
        ({"age": LIMIT + 1e-4}, "the robot's state is 0.0101 s old, state_timeout is 0.01 s"),
        ({"age": -PERIOD - 1e-4}, "the robot's state is stamped 0.0011 s in the future, by this machine's clock"),
        (
            {"position": START + [0, 0.1, 0, 0, 0, 0, 0]},
            "position of fr3_joint2 changed by 0.1 rad more than its velocity",
        ),
    ],
)
def test_a_state_that_is_not_usable_says_why_and_leaves_the_latest_one(
    changes: dict[str, object], complaint: str
) -> None:
    robot = Robot()
    before = robot.state()
    robot.clock.time += 0.02
    found = robot.state(**changes)
    assert found.complaint.startswith(complaint)
    assert found.stamp == robot.clock.now() - round(1e9 * changes.get("age", 0.0))
    assert robot.states.latest is before
    assert robot.states.age == pytest.approx(PERIOD + 0.02)


def test_stamps_at_the_limits_are_usable() -> None:
    robot = Robot()
    assert robot.state(age=LIMIT).complaint == ""
    assert robot.state(age=-PERIOD).complaint == ""


def test_a_frozen_encoder_is_noticed_under_control_and_not_at_rest() -> None:
    for led in (True, False):
        robot, complaints = Robot(), set()
        for step in range(200):
            if led:
                robot.states.commanded["arm"] = WEIGHT + 0.2 * MODEL.torque_max * np.sin(0.05 * step)
            complaints.add(robot.state().complaint)
        assert any("a frozen sensor" in complaint for complaint in complaints) is led


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0abc", b"\0" * 7, bytes(range(256)) * 4, b"\0\1\0\0" + b"\xff" * 60])
def test_bytes_that_are_no_message_are_silence_and_counted(data: bytes) -> None:
    robot = Robot()
    before = robot.state()
    assert robot.states.read(data) is robot.states.read(data) is None
    assert robot.states.latest is before
    assert robot.states.unreadable == 2


def test_a_repeated_state_is_no_sign_of_life_and_many_are_a_complaint() -> None:
    robot = Robot()
    robot.state()
    message = robot.message()
    for _ in range(EXTRA):
        robot.clock.time += 1e-5
        assert robot.states.read(message) is None
    assert robot.states.age == pytest.approx(EXTRA * 1e-5)
    assert "are there two publishers of these joints?" in robot.states.read(message).complaint


def test_a_second_robot_on_the_same_topic_is_noticed_by_its_stamps() -> None:
    robot, complaints = Robot(), []
    for _ in range(60):
        complaints.append(robot.state().complaint)
        robot.clock.time += 0.3 * PERIOD
        found = robot.states.read(robot.message(position=START + 1e-3))
        complaints.append("" if found is None else found.complaint)
        robot.clock.time -= 0.3 * PERIOD
    assert any("two publishers of these joints" in complaint for complaint in complaints)


def test_stamps_that_jitter_by_a_third_of_the_period_are_one_robots() -> None:
    rng, robot = np.random.default_rng(3), Robot()
    found = [robot.state(age=float(age)) for age in rng.uniform(0.0, 0.3 * PERIOD, 300)]
    assert all(states is not None and states.complaint == "" for states in found)


def test_a_robot_restarted_with_an_earlier_clock_is_old_not_repeated() -> None:
    robot = Robot()
    robot.state()
    assert "old, state_timeout" in robot.state(age=1000.0).complaint


def test_joints_are_found_among_others_and_messages_of_others_ignored() -> None:
    reader = StateReader(joint_names("{arm}_fr3_joint{number}", {"left": 2, "right": 2}))

    def read(names: list[str]):  # noqa: ANN202
        numbers = [float(1 + index) for index in range(len(names))]
        finger = [np.nan if name == "finger" else value for name, value in zip(names, numbers, strict=True)]
        return reader.read(state_message(0, np.array(numbers), np.array(numbers), np.array(finger), names))

    found = read(["right_fr3_joint2", "finger", "left_fr3_joint1", "right_fr3_joint1", "left_fr3_joint2"])
    assert found.complaint == ""
    np.testing.assert_array_equal(found.arms["left"].position, [3.0, 5.0])
    np.testing.assert_array_equal(found.arms["right"].torque, [4.0, 1.0])
    assert read(["finger", "other_finger"]) is None


@pytest.mark.parametrize(("pattern", "missing"), [("fr3_joint{number}", "{arm}"), ("{arm}_joint", "{number}")])
def test_joints_of_two_arms_need_names_of_their_own(pattern: str, missing: str) -> None:
    with pytest.raises(InputError, match=f"expected {missing} in it: 14 joints of ") as error:
        joint_names(pattern, {arm: GRAB.scene.models[arm].joint_count for arm in GRAB.arms})
    assert error.value.key == "joints"
    assert len(set(sum(joint_names("{arm}_{number}", {"a": 7, "b": 7}).values(), []))) == 14


@pytest.mark.parametrize(("pattern", "count"), [("a,,b", 3), ("a,b,", 3), ("a, ", 2)])
def test_a_joint_without_a_name_is_refused(pattern: str, count: int) -> None:
    """Kills a joint named "", which no message has."""
    with pytest.raises(InputError, match="a name is empty: expected one joint between two commas"):
        joint_names(pattern, {"arm": count})


def test_states_that_come_faster_than_the_scenarios_period_are_told_so() -> None:
    """Kills a complaint that blames a second publisher alone."""
    robot, complaints = Robot(), []
    for _ in range(60):
        robot.clock.time += 0.5 * PERIOD
        states = robot.states.read(robot.message())
        complaints.append(states.complaint if states else "")
    assert complaints[-1].endswith("Or do the states come faster than timing.control_period, 1 ms?")


def test_a_state_that_was_overtaken_is_no_new_one() -> None:
    robot = Robot()
    newest = robot.state()
    assert robot.states.read(robot.message(age=0.3 * LIMIT)) is None
    assert robot.states.latest is newest


def test_the_largest_age_of_a_state_is_kept() -> None:
    robot = Robot()
    for age in (0.2 * LIMIT, 0.7 * LIMIT, 0.1 * LIMIT):
        robot.clock.time += LIMIT
        assert robot.state(age=age).complaint == ""
    assert robot.states.oldest == pytest.approx(0.7 * LIMIT)


def test_the_motors_of_a_robot_are_where_its_links_are() -> None:
    measured = Robot().state(velocity=np.full(7, 1e-3)).arms["arm"]
    np.testing.assert_array_equal(measured.motor_position, measured.position)
    np.testing.assert_array_equal(measured.motor_velocity, measured.velocity)
