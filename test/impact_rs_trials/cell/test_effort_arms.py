# SPDX-License-Identifier: Apache-2.0
"""What a robot is sent: torques within a rate, the brake on fresh states alone, and otherwise its weight."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from robot_bench import (
    GRAB,
    MODEL,
    MOTORS,
    PERIOD,
    RATE,
    START,
    STILL,
    WEIGHT,
    Robot,
    TestClock,
    Wire,
    state_message,
)

from impact_rs_control.fallback import MAX_STATE_AGE_S, SETTLING_TIME_S, holding_torque
from impact_rs_trials.cell.effort_arms import EffortArms, rest_until
from impact_rs_trials.cell.robot_states import STATES, RobotStates, joint_names

STEP = RATE * PERIOD  # N m
MOVING = np.full(7, 0.5)


def moving_robot(speed: float = 0.5) -> Robot:
    """It moves at this speed [rad/s] in every joint, and the controller has just sent five newton metres too much."""
    robot = Robot()
    for count in range(5):
        robot.state(position=START + speed * PERIOD * count, velocity=np.full(7, speed))
        robot.arms.command("arm", WEIGHT + 5.0)
    return robot


def test_the_robot_is_sent_a_torque_without_the_weight_that_it_carries() -> None:
    for adds, expected in ((True, np.full(7, 0.5)), (False, WEIGHT + 0.5)):
        robot = Robot(adds_gravity=adds)
        robot.state()
        robot.arms.command("arm", WEIGHT + 0.5)
        np.testing.assert_allclose(robot.sent, [expected])
        assert robot.arms.limited == 0


def test_the_rate_is_that_of_time_and_not_of_messages() -> None:
    robot = Robot()
    for _ in range(10):  # in one instant, as of states that waited in a queue
        robot.states.read(robot.message())
        robot.arms.command("arm", WEIGHT + 5.0)
    assert np.abs(robot.sent[-1]).max() == pytest.approx(STEP)
    robot.clock.time += 0.4 * PERIOD
    robot.arms.command("arm", WEIGHT + 5.0)
    assert robot.sent[-1].max() == pytest.approx(1.4 * STEP)
    robot.clock.time += 1.0  # a pause permits no jump
    robot.arms.command("arm", WEIGHT + 50.0)
    assert robot.sent[-1].max() == pytest.approx(2.4 * STEP)
    robot.clock.time -= 1.0  # nor does a clock that goes back
    robot.arms.command("arm", WEIGHT + 50.0)
    assert robot.sent[-1].max() == pytest.approx(2.4 * STEP)
    assert robot.arms.limited == 13


def test_the_brake_is_that_of_the_fallback_and_answers_a_state_once() -> None:
    robot = Robot()
    for count in range(100):
        robot.state(position=START + 0.5 * PERIOD * count, velocity=MOVING)
        robot.arms.rest()
        robot.arms.rest()
    assert len(robot.sent) == 100
    position = START + 0.5 * PERIOD * 99
    np.testing.assert_allclose(
        robot.sent[-1], holding_torque(MODEL, MOTORS, position, MOVING) - MODEL.gravity_torque(position)
    )
    assert all(np.all(np.abs(after - before) <= STEP + 1e-9) for before, after in pairwise(robot.sent))


def test_a_robot_that_was_never_heard_is_sent_nothing() -> None:
    robot = Robot()
    robot.arms.rest()
    assert robot.sent == []
    assert not robot.arms.held


@pytest.mark.parametrize("speed", [0.5, 0.0])
def test_without_a_fresh_state_the_brake_is_released_within_the_rate(speed: float) -> None:
    robot = moving_robot(speed)
    assert robot.states.commanded
    robot.clock.time += MAX_STATE_AGE_S + 1e-6
    for _ in range(10):
        robot.arms.rest()
        robot.clock.time += PERIOD
    np.testing.assert_allclose(robot.sent[-1], 0.0, atol=1e-9)
    assert not robot.arms.held  # whether they rest is not known
    assert not robot.states.commanded
    assert np.abs(np.diff(robot.sent, axis=0)).max() <= STEP + 1e-9


@pytest.mark.parametrize(
    "changes",
    [
        {"age": 0.2},
        {"age": -0.2},
        {"velocity": np.array([0, 0, 0, 1000.0, 0, 0, 0])},
        {"velocity": np.full(7, np.nan)},
        {"effort": np.full(7, 1e6)},
        {"position": START + [0, 0.8, 0, 0, 0, 0, 0]},
    ],
)
def test_the_brake_never_acts_on_a_state_that_is_refused(changes: dict[str, object]) -> None:
    robot = moving_robot()
    for count in range(200):
        if "age" not in changes:
            changes["position"] = changes.get("position", START) + 1e-9 * count
        robot.state(**changes)
        robot.arms.rest()
    released = robot.sent[-100:]
    np.testing.assert_allclose(released, np.zeros((100, 7)), atol=1e-9)


class MovingArm:
    """(M + B) ddq + C dq = tau: an arm whose weight is carried, ``extra`` [N m] aside."""

    def __init__(self, robot: Robot, velocity: float, extra: np.ndarray = STILL) -> None:
        self.robot, self.velocity, self.position = robot, np.full(7, velocity), START.copy()
        self.extra = extra
        self.past: list[tuple[int, np.ndarray, np.ndarray]] = []

    @property
    def energy(self) -> float:
        """Kinetic [J]."""
        return float(0.5 * self.velocity @ (MODEL.mass_matrix(self.position) + np.diag(MOTORS)) @ self.velocity)

    def step(self) -> None:
        """A period."""
        terms = MODEL.terms(self.position, self.velocity)
        torque = self.robot.sent[-1] + self.extra + MODEL.gravity_torque(self.position)
        self.velocity = self.velocity + PERIOD * np.linalg.solve(
            terms.mass_matrix + np.diag(MOTORS), torque - terms.bias
        )
        self.position = self.position + PERIOD * self.velocity
        self.robot.clock.time += PERIOD
        self.past.append((self.robot.clock.now(), self.position, self.velocity))


@pytest.mark.parametrize("delay", [0.0, 0.005, 0.1, 0.2, 0.5])
def test_whatever_the_delay_of_its_states_a_brake_gives_the_arm_no_energy(delay: float) -> None:
    """A brake that answers states of 0.2 s ago would reach 50 rad/s within three seconds."""
    robot = Robot()
    robot.state(velocity=np.full(7, 0.3))
    robot.arms.rest()
    arm, behind = MovingArm(robot, 0.3), round(delay / PERIOD)
    energies = [arm.energy]
    for _ in range(1000):
        arm.step()
        if len(arm.past) > behind:
            robot.states.read(state_message(*arm.past[-1 - behind]))
        robot.arms.rest()
        energies.append(arm.energy)
    assert max(energies) <= energies[0] * 1.001
    assert (energies[-1] < 1e-6 * energies[0]) is (delay <= 0.005)


def test_one_state_that_is_repeated_for_ever_does_not_drive_the_arm() -> None:
    robot = Robot()
    robot.state(velocity=np.full(7, 0.3))
    robot.arms.rest()
    message, arm = robot.message(velocity=np.full(7, 0.3)), MovingArm(robot, 0.3)
    energies = [arm.energy]
    for _ in range(1000):
        arm.step()
        robot.states.read(message)
        robot.arms.rest()
        energies.append(arm.energy)
    assert max(energies) <= energies[0] * 1.001


def test_fresh_states_of_a_frozen_encoder_do_not_drive_the_arm() -> None:
    """Kills a check for frozen sensors that ends with the torques of the controller: 2 rad/s after 1.5 s."""
    robot = Robot()
    robot.state(velocity=np.full(7, 0.1))
    robot.arms.rest()
    arm = MovingArm(robot, 0.1)
    energies = [arm.energy]
    for _ in range(1000):
        arm.step()
        robot.states.read(robot.message(velocity=np.full(7, 0.1)))
        robot.arms.rest()
        energies.append(arm.energy)
    assert max(energies) <= energies[0] * 1.001
    assert not robot.arms.held


def test_a_frozen_encoder_is_noticed_behind_torques_that_are_passed_on() -> None:
    """Kills a watchdog that finds states usable which the cell refuses."""
    robot, complaints = Robot(), set()
    for step in range(200):
        complaints.add(robot.state().complaint)
        robot.arms.pass_on("arm", 0.2 * MODEL.torque_max * np.sin(0.05 * step))
    assert any("a frozen sensor" in complaint for complaint in complaints)


def test_an_arm_whose_weight_is_assumed_wrongly_creeps_instead_of_falling() -> None:
    """Near dq = T (M + B)^-1 dtau, here -0.1 rad/s; a released arm would have -0.5 rad/s by then."""
    robot = Robot()
    robot.state()
    robot.arms.rest()
    arm = MovingArm(robot, 0.0, extra=(MODEL.mass_matrix(START) + np.diag(MOTORS)) @ np.full(7, -1.0))
    for _ in range(500):
        arm.step()
        robot.states.read(state_message(*arm.past[-1]))
        robot.arms.rest()
    np.testing.assert_allclose(arm.velocity, -SETTLING_TIME_S, atol=SETTLING_TIME_S)
    assert not robot.arms.held


def test_arms_are_held_when_all_rest_and_no_leading_torque_is_left() -> None:
    clock, sent = TestClock(), []
    names = joint_names("{arm}_{number}", dict.fromkeys(GRAB.arms, 7))
    models = {arm: GRAB.scene.models[arm] for arm in GRAB.arms}
    states = RobotStates(models, names, PERIOD, 0.01, clock)
    arms = EffortArms(states, dict.fromkeys(models, MOTORS), True, RATE, lambda arm, torque: sent.append(torque))
    first, second = GRAB.arms

    def state(speed: dict[str, float]) -> None:
        clock.time += PERIOD
        joints = [name for own in names.values() for name in own]
        position = np.concatenate([GRAB.arms[arm].initial for arm in names])
        velocity = np.concatenate([np.full(7, speed.get(arm, 0.0)) for arm in names])
        states.read(state_message(clock.now(), position, velocity, np.zeros(14), joints))

    for moving in (first, second):
        state({moving: 0.05})
        arms.rest()
        assert not arms.held, moving
    for _ in range(10):
        state({})
        arms.rest()
    assert arms.held
    state({})
    arms.command(first, GRAB.scene.models[first].gravity_torque(GRAB.arms[first].initial) + 5.0)
    assert not arms.held
    for _ in range(5):
        state({})
        arms.command(first, GRAB.scene.models[first].gravity_torque(GRAB.arms[first].initial) + 5.0)
    state({})
    arms.rest()
    assert not arms.held  # it rests, but the torque that led it is still there


def test_the_brake_acts_on_the_newest_of_states_that_have_waited() -> None:
    robot = Robot()
    wire = Wire(robot.clock)
    for count in range(20):
        stamp = robot.clock.now() + round(count * 1e9 * PERIOD)
        wire.put(robot.clock.time + 0.0191, STATES, state_message(stamp, START, np.full(7, 0.001 * count)))
    robot.states._timeout = 0.1
    rest_until(robot.arms, wire, robot.clock.time + 0.0195, robot.clock)  # type: ignore[arg-type]
    assert len(robot.sent) == 1
    assert robot.states.latest is not None
    assert robot.states.latest.arms["arm"].velocity[0] == pytest.approx(0.019)
