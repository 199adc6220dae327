# SPDX-License-Identifier: Apache-2.0
"""A rehearsal runs the cell against a stand-in of a driver, and its margins are those of physics."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from impact_rs_cli.main import main
from impact_rs_ros import cell_rehearsal
from impact_rs_ros.cell_rehearsal import Checklist, ExternalTorque, Margin, VirtualTime, rehearse
from impact_rs_ros.driver_profiles import PROFILES, profile_of
from impact_rs_ros.robot_states import joint_names
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Reflexes
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.sensors import ArmMeasurement
from impact_rs_trials.spec import TrialSpec

PLAN = TrialSpec.of(load_scenario("push_fr3"), "parcel", "case_1").plan
FRANKA = PROFILES["franka_ros2"]
NO_REFLEXES = {"arm": Reflexes()}


def margin_of(found: Checklist, name: str) -> Margin:
    (margin,) = [one for one in found.margins if name in one.name]
    return margin


@pytest.fixture(scope="module")
def passed() -> Checklist:
    reflexes = {"arm": Reflexes(external_torque_Nm=(80.0,) * 7, external_force_N=200.0)}
    return rehearse(PLAN, FRANKA, reflexes)


def test_a_careful_push_arms_runs_and_passes_every_line(passed: Checklist) -> None:
    assert passed.passed, passed.to_json()
    start = ", ".join(f"{value:.4f}" for value in PLAN.arms["arm"].initial)
    assert passed.log[0] == f"arm starts at [{start}]"
    assert passed.log[1].startswith("armed: jitter 0.000 ms, oldest state 0.200 ms")
    assert any(line.startswith("trial over: OK") for line in passed.log)
    assert passed.unknown == []
    assert margin_of(passed, "age of a state").value == pytest.approx(FRANKA.state_latency, rel=1e-6)
    assert margin_of(passed, "answer of the controller").value == pytest.approx(cell_rehearsal.COMPUTING, rel=1e-3)
    assert margin_of(passed, "torque rate").value <= FRANKA.torque_rate * (1.0 + 1e-9)
    assert 0.0 < margin_of(passed, "distance to joint limits").margin < np.pi


def test_the_watchdog_stops_the_arm_by_the_time_constant_of_its_brake(passed: Checklist) -> None:
    """exp(-t / 0.1 s) from some 1 rad/s to 0.02 rad/s takes 0.39 s, and command_timeout passes before it."""
    stop = margin_of(passed, "time to stop")
    (line,) = [line for line in passed.log if line.startswith("cell silent at ")]
    speed = float(line.split()[3])
    assert stop.value == pytest.approx(0.05 + 0.1 * np.log(speed / 0.02), abs=0.1)
    assert "the watchdog brakes" in line


def test_thresholds_that_the_hit_exceeds_fail_and_thresholds_that_are_not_known_are_said() -> None:
    low = rehearse(PLAN, FRANKA, {"arm": Reflexes(external_torque_Nm=(5.0,) * 7)})
    assert not low.passed and not low.failure
    assert [one.name for one in low.margins if one.margin < 0.0] == ["arm external joint torque"]
    assert len(low.unknown) == 1 and "external force: up to" in low.unknown[0]


def test_a_driver_of_another_rate_is_refused_with_the_rate() -> None:
    found = rehearse(PLAN, replace(FRANKA, period=0.002), NO_REFLEXES)
    assert not found.passed
    assert "a state every 2.000 ms; timing.control_period of the scenario is 1 ms" in found.failure


def test_states_that_come_too_late_are_refused() -> None:
    found = rehearse(PLAN, replace(FRANKA, state_latency=0.02), NO_REFLEXES)
    assert "the robot's state is 0.0200 s old, state_timeout is 0.01 s" in found.failure


def test_a_later_torque_swings_more(passed: Checklist) -> None:
    """A torque that is late by 12 ms in a loop of 1 kHz turns damping into drive."""
    assert FRANKA.command_latency < 0.001  # s
    late = rehearse(PLAN, replace(FRANKA, command_latency=0.012), NO_REFLEXES)
    assert margin_of(late, "joint velocity").value > margin_of(passed, "joint velocity").value


def test_the_external_torque_of_a_resting_arm_is_none_and_a_push_is_seen() -> None:
    (model,) = PLAN.scene.models.values()
    q = PLAN.arms["arm"].initial
    still, pushed = ExternalTorque(model, 500.0, 0.001), ExternalTorque(model, 500.0, 0.001)
    zero, load = np.zeros_like(q), np.linspace(5.0, -4.0, q.size)
    weight = model.gravity_torque(q)
    for _ in range(100):
        still.update(ArmMeasurement(q, zero, weight, q, zero))
        pushed.update(ArmMeasurement(q, zero, weight - load, q, zero))  # the joints give way: what holds it is outside
    np.testing.assert_allclose(still.torque, 0.0, atol=1e-9)
    np.testing.assert_allclose(pushed.torque, load, rtol=1e-6)
    assert still.force < 1e-9 < pushed.force


def test_events_happen_in_their_order_and_time_stops_at_what_was_waited_for() -> None:
    clock, seen = VirtualTime(), []
    for when, name in ((0.3, "c"), (0.1, "a"), (0.1, "b")):
        clock.at(when, lambda name=name: seen.append(name))  # type: ignore[misc]
    clock.pass_until(0.2, lambda: "b" in seen)
    assert (seen, clock.time) == (["a", "b"], 0.1)
    clock.pass_until(1.0, lambda: False)
    assert (seen, clock.time) == (["a", "b", "c"], 1.0)


def test_names_of_joints_may_be_listed_and_two_arms_need_their_own() -> None:
    profile = profile_of(load_scenario("push_ur5e"))
    assert joint_names(profile.joints_of(["arm"]), {"arm": 6})["arm"][0] == "shoulder_pan_joint"
    two = joint_names(FRANKA.joints_of(["left", "right"]), {"left": 7, "right": 7})
    assert (two["left"][0], two["right"][6]) == ("left_fr3_joint1", "right_fr3_joint7")
    with pytest.raises(InputError, match=r"6 names, expected one per joint of arm \(7\)"):
        joint_names(profile.joints, {"arm": 7})


def test_every_shipped_scenario_has_a_driver_of_its_rate() -> None:
    for name, driver in (
        ("push_fr3", "franka_ros2"),
        ("push_ur5e", "ur_robot_driver"),
        ("push_iiwa7", "lbr_fri_ros2_stack"),
    ):
        scenario = load_scenario(name)
        profile = profile_of(scenario)
        assert profile.name == driver
        assert scenario.timing.control_period == profile.period
    with pytest.raises(InputError, match="did you mean 'franka_ros2'"):
        profile_of(load_scenario("push"), "franka_ros")


def test_the_command_fails_where_a_margin_is_negative(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rehearse", "push_fr3", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["passed"] and document["failure"] == ""
    beyond = {one["name"] for one in document["margins"] if one["margin"] < 0.0}
    assert beyond == {"arm external joint torque", "arm external force"}  # of the examples of franka_ros2, at 0.5 m/s
