# SPDX-License-Identifier: Apache-2.0
"""The likeliest assignment of streams to the roles of the joints; names decide what numbers cannot."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin
import pytest
from joint_recordings import Columns, swinging

from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.importing.candidates import SignalCandidate, guess_of
from impact_rs_trials.recordings.importing.import_texts import PossibleReading
from impact_rs_trials.recordings.importing.joint_search import Assignment, JointSearch
from impact_rs_trials.recordings.importing.joint_streams import JointStream
from impact_rs_trials.recordings.mapping import MountedEndEffector
from impact_rs_trials.recordings.readers.guesses import holds_a_turn, quaternion_order
from impact_rs_trials.recordings.readers.series import Series

TIME = np.arange(0.0, 8.0, 0.01)
CENTRE, JOINTS = np.array([0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1]), np.arange(7)


@functools.cache
def model() -> RobotModel:
    return RobotModel(load_facts("kuka_iiwa7"), MountedEndEffector().build())


@functools.cache
def swing() -> Columns:
    return swinging(model(), TIME, CENTRE, (0.11 + 0.02 * JOINTS, 0.31 + 0.03 * JOINTS), (0.35, 0.1))


def assigned(**streams: np.ndarray) -> Assignment:
    """The assignment of streams by the stems of their columns, in the order of the file."""
    return searched(**streams)[0]


def stem_of(reading: PossibleReading) -> str:
    """Stem of the columns of a possible reading."""
    return str(reading.source["columns"][0]).removesuffix("_1")


def searched(**streams: np.ndarray) -> tuple[Assignment, JointSearch]:
    """The assignment with its search."""
    listed = []
    for stem, values in streams.items():
        columns = [f"{stem}_{joint}" for joint in range(1, 8)]
        candidate = SignalCandidate(f"{columns[0]} … {columns[-1]}", {"columns": columns}, False, guess_of(stem), 7)
        listed.append(JointStream("", candidate, Series(stem, TIME, values)))
    search = JointSearch(listed, model())
    return search.best(search.motions()), search


@pytest.mark.parametrize(
    ("names", "taken"),
    [
        (("tau_des", "tau_meas"), "tau_meas"),
        (("tau_meas", "tau_des"), "tau_meas"),
        (("a", "b"), "a"),
        (("b", "a"), "b"),
    ],
)
def test_of_two_torques_names_say_which_was_measured(names: tuple[str, str], taken: str) -> None:
    """The first fits better, as commanded torques do. Kills a choice by likelihood; without names: the first."""
    motion, noise = swing(), np.random.default_rng(0).normal(0.0, 2.0, (TIME.size, 7))
    fits = {names[0]: motion["effort"], names[1]: motion["effort"] + noise}
    found = assigned(q=motion["position"], dq=motion["velocity"], **fits)
    assert found.torques[0].stream.series.label == taken
    listed = found.alternatives["torque"]
    assert {stem_of(one) for one in listed} == set(names)
    assert listed[1].behind == pytest.approx(6.0 if taken == "tau_meas" else 0.0, abs=3.1)


def test_the_pose_of_a_tool_is_no_torque() -> None:
    """Height and tilt of a tool go with the gravity torque of an arm that moves in a plane.

    Kills torques and currents read in a pose.
    """
    time = np.linspace(0.0, 60.0, 1200)
    swung = swinging(model(), time, CENTRE, (0.015 + 0.0027 * JOINTS, 0.041 + 0.004 * JOINTS), (0.3, 0.1))
    q = CENTRE + (swung["position"] - CENTRE) * (JOINTS % 2)
    poses = np.array([pin.SE3ToXYZQUAT(model().placement(one)) for one in q])
    streams = [
        JointStream("", SignalCandidate(name, {"column": name}, False, guess_of(name), 7), Series(name, time, values))
        for name, values in (("q", q), ("a", poses))
    ]
    search = JointSearch(streams, model())
    assert search.best(search.without_velocity()).torques == ()


def test_four_joints_of_which_one_stands_at_one_radian_are_no_quaternion() -> None:
    """Kills a search for quaternions in signals of joints that are held."""
    held = np.zeros((50, 7))
    held[:, 3], held[:, 5] = 1.01, np.linspace(0.0, 1.0, 50)
    assert not holds_a_turn(held)


def test_positions_are_those_whose_velocities_and_torques_fit_best() -> None:
    """Positions that were asked for run ahead. Kills an assignment by names or by positions alone."""
    motion = swing()
    ahead = np.vstack((motion["position"][5:], np.repeat(motion["position"][-1:], 5, axis=0)))
    found = assigned(a=ahead, b=motion["position"], c=motion["velocity"], d=motion["effort"])
    assert found.position.stream.series.label == "b"
    assert found.velocity is not None and found.velocity.stream.series.label == "c"
    first, *others = found.alternatives["position"]
    asked = next(one for one in others if stem_of(one) == "a")
    assert stem_of(first) == "b" and asked.behind > 20.0


@pytest.mark.parametrize("order", ["p v a", "a v p"])
def test_velocities_and_accelerations_are_no_positions_and_velocities(order: str) -> None:
    """Accelerations that a filter derived from velocities fit these without noise, which velocities of encoders do not.

    Kills an assignment that leaves the positions over, of which the velocities are the derivative.
    """
    motion, noise = swing(), 0.02 * np.random.default_rng(0).normal(size=(TIME.size, 7))
    velocity = motion["velocity"] + noise
    streams = {"p": motion["position"], "v": velocity, "a": np.gradient(velocity, TIME, axis=0)}
    found = assigned(**{name: streams[name] for name in order.split()}, tau=motion["effort"])
    assert found.position.stream.series.label == "p"
    assert found.velocity is not None and found.velocity.stream.series.label == "v"
    assert found.torques[0].stream.series.label == "tau"


def test_a_position_beside_it_by_a_constant_is_as_likely_and_its_name_decides() -> None:
    """Kills a margin that hides an equal reading: both have the same derivative."""
    motion = swing()
    found = assigned(q_des=motion["position"] + 1e-4, q=motion["position"], dq=motion["velocity"], tau=motion["effort"])
    assert found.position.stream.series.label == "q"
    first, second = found.alternatives["position"][:2]
    assert first.behind == 0.0 and stem_of(second) == "q_des" and 0.0 < second.behind < 30.0


@pytest.mark.parametrize("gear", [1.0, 80.0])
def test_angles_of_motors_are_found_beside_the_positions_with_their_gear_ratio(gear: float) -> None:
    """theta = N (q + C tau) + c; kills a reading of commanded positions, and of a copy, as motors."""
    q, dq, tau = (swing()[name] for name in ("position", "velocity", "effort"))
    found, search = searched(
        position=q,
        velocity=dq,
        torque=tau,
        position_copy=q,
        motor_pos_desired=q + 1e-3 * dq,
        motor_pos=gear * (q + 2e-4 * tau) + 0.3,
    )
    motors = search.motors(found)
    assert motors is not None and motors.stream.series.label == "motor_pos"
    assert motors.best.unit == "rad"
    ratio = 1.0 / np.array(motors.best.further.get("factor", np.ones(7)))
    np.testing.assert_allclose(ratio, gear, rtol=1e-3)
    alone, search = searched(position=q, velocity=dq, torque=tau, motor_pos=q)
    assert search.motors(alone) is None  # the same numbers once more show no deflection


@pytest.mark.parametrize("order", ["abcd", "cdab"])
@pytest.mark.parametrize("with_torque", [True, False])
def test_a_command_without_noise_is_not_taken_for_the_motion_that_follows_it(order: str, with_torque: bool) -> None:
    """Its velocity fits its position better than any measured one. Kills a choice by that, and the lag's other sign."""
    motion, rng = swing(), np.random.default_rng(3)
    commanded = swinging(model(), TIME + 0.04, CENTRE, (0.11 + 0.02 * JOINTS, 0.31 + 0.03 * JOINTS), (0.35, 0.1))
    pairs = {
        "a": commanded["position"],
        "b": commanded["velocity"],
        "c": motion["position"] + rng.normal(0.0, 3e-4, (TIME.size, 7)),
        "d": motion["velocity"] + rng.normal(0.0, 0.02, (TIME.size, 7)),
    }
    friction = 2.0 * np.tanh(motion["velocity"] / 0.01)
    torque = {"e": motion["effort"] + friction + rng.normal(0.0, 0.5, (TIME.size, 7))} if with_torque else {}
    found = assigned(**{name: pairs[name] for name in order}, **torque)
    assert found.velocity is not None
    assert (found.position.stream.series.label, found.velocity.stream.series.label) == ("c", "d")
    assert [one.stream.series.label for one in found.torques] == [*torque]
    listed = {stem_of(one): one.behind for one in reversed(found.alternatives["position"])}
    assert 0.0 < listed["a"] - listed["c"] < 1e3  # both are shown, and the velocities do not decide


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_w_of_a_quaternion_is_found_where_its_sign_changes(order: str) -> None:
    """Kills: the magnitude of the median, which is about 0 if a tracker jumps between q and -q."""
    quaternion = np.tile([0.9999, 0.01, 0.005, 0.0][:: 1 if order == "wxyz" else -1], (200, 1))
    quaternion[1::2] *= -1.0
    guess = quaternion_order(quaternion)
    assert guess is not None and (guess.value, guess.sure) == (order, True)
