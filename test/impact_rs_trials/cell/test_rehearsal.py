# SPDX-License-Identifier: Apache-2.0
"""A rehearsal runs the cell against a stand-in of a driver, and its margins are those of physics."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_cli.main import main
from impact_rs_control.plan import TrialPlan
from impact_rs_ros.node_parameters import defaults_of, values_for
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Reflexes
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.cell import cell_rehearsal
from impact_rs_trials.cell.cell_rehearsal import Checklist, ExternalTorque, StandIn, VirtualTime, rehearse
from impact_rs_trials.cell.driver_profiles import PROFILES, DriverProfile, profile_of
from impact_rs_trials.cell.effort_arms import rest_until
from impact_rs_trials.cell.robot_states import joint_names
from impact_rs_trials.checked_bound import CheckedBound
from impact_rs_trials.spec import TrialSpec

PLAN = TrialSpec.of(load_scenario("push_fr3"), "parcel", "case_1").plan
FRANKA = PROFILES["franka_ros2"]
NO_REFLEXES = {"arm": Reflexes()}


def rehearsed(plan: TrialPlan, profile: DriverProfile, reflexes: dict[str, Reflexes]) -> Checklist:
    """A rehearsal with the parameters for the driver."""
    return rehearse(plan, profile, reflexes, values_for(profile, plan.arms))


def margin_of(found: Checklist, name: str) -> CheckedBound:
    (margin,) = [one for one in found.margins if name in one.name]
    return margin


@pytest.fixture(scope="module")
def passed() -> Checklist:
    reflexes = {"arm": Reflexes(external_torque_Nm=(80.0,) * 7, external_force_N=200.0)}
    return rehearsed(PLAN, FRANKA, reflexes)


def test_a_careful_push_arms_runs_and_passes_every_line(passed: Checklist) -> None:
    assert passed.passed, passed.to_json()
    start = ", ".join(f"{value:.4f}" for value in PLAN.arms["arm"].initial)
    assert passed.log[0] == f"arm starts at [{start}]"
    assert passed.log[1].startswith("armed: jitter 0.000 ms, oldest state 0.200 ms")
    assert any(line.startswith("trial over: OK") for line in passed.log)
    assert passed.unknown == []
    assert margin_of(passed, "age of a state").value == pytest.approx(FRANKA.state_latency, rel=1e-6)
    assert margin_of(passed, "answer of the controller").value == pytest.approx(
        cell_rehearsal.CONTROLLER_TIME_S, rel=1e-3
    )
    assert margin_of(passed, "torque rate").value <= FRANKA.torque_rate * (1.0 + 1e-9)
    assert 0.0 < margin_of(passed, "distance to joint limits").margin < np.pi


def test_the_watchdog_stops_the_arm_by_the_time_constant_of_its_brake(passed: Checklist) -> None:
    """exp(-t / 0.1 s) from some 1 rad/s to 0.02 rad/s takes 0.39 s, and command_timeout passes before it."""
    stop = margin_of(passed, "time to stop")
    (line,) = [line for line in passed.log if line.startswith("cell silent at ")]
    speed = float(line.split()[3])
    assert stop.value == pytest.approx(0.05 + 0.1 * np.log(speed / 0.02), abs=0.1)
    assert "the watchdog brakes" in line


def test_a_hit_beyond_a_threshold_stops_the_robot_and_the_cell_ends_the_trial() -> None:
    """8 N m: the hit makes 11 N m, noise of the estimate 5 N m."""
    low = rehearsed(PLAN, FRANKA, {"arm": Reflexes(external_torque_Nm=(8.0,) * 7)})
    assert "external torque of joint" in low.stopped and "threshold 8" in low.stopped
    assert "no state of the robot for 0.01" in low.failure  # franka_ros2 ends its broadcasters
    assert any("its states ended; the cell ended the trial" in line for line in low.log)
    assert any("the robot brought the arms to rest, which the cell did not see" in line for line in low.log)
    assert [one.name for one in low.margins if one.margin < 0.0] == ["arm external joint torque"]
    assert len(low.unknown) == 1 and "external force: up to" in low.unknown[0]
    assert low.verdict.startswith("rehearsal not passed: the robot stopped itself: arm, external torque of joint")
    assert margin_of(low, "time to stop").margin > 0.0  # with a dead cell as well


def test_a_robot_that_stops_itself_and_goes_on_reporting_is_noticed_by_its_rest() -> None:
    quiet = replace(FRANKA, states_end=False)
    found = rehearsed(PLAN, quiet, {"arm": Reflexes(external_force_N=20.0)})
    assert "arm has rested for 0.1 s more than 0.03 m from its references" in found.failure and not found.passed
    assert any("its states went on; the cell ended the trial" in line for line in found.log)


@pytest.mark.parametrize("states_end", [True, False])
def test_a_robot_that_has_stopped_itself_obeys_no_torque_and_reports_why(states_end: bool) -> None:
    """Against 20 N m on every joint, which move an arm whose reflexes have no threshold."""
    resting, states = {}, {}
    for threshold in (None, 1e-6):
        clock, heard = VirtualTime(), []
        own = {"arm": Reflexes(external_force_N=threshold)}
        robot = StandIn(PLAN, replace(FRANKA, states_end=states_end), own, clock, 0)
        robot.listeners.append(heard.append)
        robot.command("arm", np.full(7, 20.0))
        clock.pass_until(0.1, lambda: False)
        resting[threshold], states[threshold] = robot.at_rest, len(heard)
        robot.plant.close()
        assert bool(robot.error) == (threshold is not None)
    assert resting == {None: False, 1e-6: True}
    assert states[None] == pytest.approx(100, abs=1)
    assert (states[1e-6] < 5) == states_end


@pytest.mark.slow
@pytest.mark.parametrize("name", ["push_fr3", "grab_fr3"])
def test_a_shipped_scenario_passes_its_own_rehearsal(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rehearse", name]) == 0
    assert capsys.readouterr().out.rstrip().endswith("rehearsal passed")


LAUNCHED = Path(__file__).resolve().parents[3] / "config" / "drivers" / "fr3_cell.yaml"  # by the launch file


def test_with_joint_names_of_another_robot_in_the_file_there_is_no_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kills: a rehearsal that does not take the file that the launch file loads."""
    own = tmp_path / "cell.yaml"
    own.write_text(LAUNCHED.read_text().replace("fr3_joint{number}", "lbr_A{number}"))
    assert main(["rehearse", "push_fr3", "--parameters", str(own), "--json"]) == 1
    assert "no state of lbr_A1" in json.loads(capsys.readouterr().out)["failure"]


@pytest.mark.slow
def test_with_a_slower_watchdog_in_the_file_the_arm_rests_that_much_later(
    passed: Checklist, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "cell.yaml"
    own.write_text(LAUNCHED.read_text().replace("command_timeout: 0.05", "command_timeout: 0.3"))
    assert main(["rehearse", "push_fr3", "--parameters", str(own), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["parameters"]["watchdog"]["command_timeout"] == 0.3
    margins = document["margins"]
    (stop,) = [one["value"] for one in margins if one["name"].startswith("time to stop")]
    assert stop - margin_of(passed, "time to stop").value == pytest.approx(0.3 - 0.05, abs=0.1)


def test_the_wrong_gravity_convention_arms_nothing_and_motion_capture_is_named_as_not_rehearsed() -> None:
    given = {kind: dict(defaults_of(kind), joints=FRANKA.joints) for kind in ("cell", "watchdog")}
    given["cell"] |= {"mocap": True, "robot_adds_gravity": False}
    found = rehearse(PLAN, FRANKA, NO_REFLEXES, given)
    assert "mocap is true" in found.unknown[0]
    assert "while it was held" in found.failure  # the weight twice


def test_a_driver_that_the_cell_cannot_use_is_not_passed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rehearse", "push_ur5e", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["passed"] and document["failure"] == ""
    (why,) = document["blocking"]
    assert "no torques of the link side" in why and why in document["verdict"]
    assert "no torque-only mode" in PROFILES["lbr_fri_ros2_stack"].blocking[0]
    assert not FRANKA.blocking


def test_a_rehearsal_whose_pad_would_be_in_the_table_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The pad, whose lower edge is 30 mm above the table, 70 mm lower."""
    shipped = load_scenario("push_fr3")
    position = [*shipped.robots["arm"].impact.placement.translation[:2], shipped.support.height + 0.01]
    low = shipped.with_settings({"robots.arm.impact.position": [float(value) for value in position]})
    path = tmp_path / "low.yaml"
    path.write_text(low.model_dump_json())
    assert main(["rehearse", str(path)]) == 2
    assert "inside the support, whose surface is at z = 0.523 m" in " ".join(capsys.readouterr().err.split())


def test_the_verdict_says_what_was_not_checked() -> None:
    unknown = "arm external force: up to 80 N, no threshold is known"
    assert Checklist("driver").verdict == "rehearsal passed"
    assert (
        Checklist("driver", unknown=[unknown]).verdict == f"rehearsal passed, but for what was not checked: {unknown}"
    )
    assert Checklist("driver", unknown=[unknown], blocking=("no torques",)).verdict == (
        "rehearsal not passed: no torques. Do not run this on the robot"
    )


def test_a_driver_of_another_rate_is_refused_with_the_rate() -> None:
    found = rehearsed(PLAN, replace(FRANKA, period=0.002), NO_REFLEXES)
    assert not found.passed
    assert "a state every 2.000 ms; timing.control_period of the scenario is 1 ms" in found.failure


def test_states_that_come_too_late_are_refused() -> None:
    found = rehearsed(PLAN, replace(FRANKA, state_latency=0.02), NO_REFLEXES)
    assert "the robot's state is 0.0200 s old, state_timeout is 0.01 s" in found.failure


@pytest.mark.slow
def test_a_later_torque_swings_more() -> None:
    """A torque that is late by 12 ms in a loop of 1 kHz turns damping into drive, in a push at 0.5 m/s."""
    fast = TrialSpec.of(load_scenario("push_fr3"), "parcel", "case_2", 2.3).plan
    prompt, late = (
        rehearsed(fast, replace(FRANKA, command_latency=latency), NO_REFLEXES) for latency in (0.0002, 0.012)
    )
    assert margin_of(late, "joint velocity").value > margin_of(prompt, "joint velocity").value


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


@pytest.mark.slow
def test_the_command_fails_where_a_margin_is_negative(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rehearse", "push_fr3", "juice", "2", "--reflex-force", "40", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["passed"] and "threshold 40" in document["stopped"]
    assert {one["name"] for one in document["margins"] if one["margin"] < 0.0} == {"arm external force"}


IMPACT = PLAN.scene.scenario.timing.nominal_impact  # s


class Stalled(cell_rehearsal._Cell):
    """A cell whose process does not run for a while, and the torques that its robot was sent."""

    def __init__(self) -> None:
        own = {"joints": FRANKA.joints_of(PLAN.arms), "watchdog": True}
        given = {"cell": defaults_of("cell") | own, "watchdog": defaults_of("watchdog") | {"joints": own["joints"]}}
        super().__init__(PLAN, FRANKA, NO_REFLEXES, 0, given)
        self.merged = [(-self.robot.period, np.zeros(7))]  # franka_ros2 carries the weight itself
        command = self.robot.command
        self.robot.command = lambda arm, torque: (  # type: ignore[method-assign]
            self.merged.append((self.clock.time, torque.copy())),
            command(arm, torque),
        )
        assert self.watchdog is not None
        self.watchdog.arms._send = self.robot.command

    def stall(self, seconds: float) -> None:
        """States and torques go on, and come to a process that does not take them."""
        self.clock.pass_until(self.clock.time + seconds, lambda: False)

    def rest(self, seconds: float) -> None:
        """Held as after a trial."""
        until = self.clock.time + seconds
        while self.clock.time < until:
            rest_until(self.arms, self.inbox, self.clock.time + self.robot.period, self.clock)  # type: ignore[arg-type]

    def steepest(self) -> float:
        """Fastest change of a torque in the stream that reaches the robot [N m/s]; a pause permits no jump."""
        pairs = zip(self.merged, self.merged[1:], strict=False)
        return max(np.abs(b - a).max() / min(max(tb - ta, 1e-9), self.robot.period) for (ta, a), (tb, b) in pairs)


@pytest.mark.parametrize(
    ("phase", "stall"),
    [
        pytest.param(0.2 - IMPACT, 0.1, marks=pytest.mark.slow),  # at rest, before the approach
        pytest.param(-0.3, 0.03, marks=pytest.mark.slow),
        pytest.param(-0.15, 0.1, marks=pytest.mark.slow),
        (-0.05, 0.5),
        (0.0, 0.05),
        pytest.param(0.01, 0.2, marks=pytest.mark.slow),  # interim
        pytest.param(0.2, 0.03, marks=pytest.mark.slow),
        pytest.param(0.3, 0.5, marks=pytest.mark.slow),  # post
        (1.0, 0.2),  # after the end
    ],
)
def test_whenever_and_however_long_a_cell_stalls_the_robot_gets_one_stream_within_the_rate(
    phase: float, stall: float
) -> None:
    """``phase`` [s] from the nominal impact. Beside each other cell and watchdog made 4.3 N m from one to the next."""
    cell = Stalled()
    try:
        cell.arm()
        trial = cell.trial()
        while not trial.over and trial.now < round(1e9 * (IMPACT + phase)):
            trial.work(cell.clock.time + cell.robot.period)
        moving = not cell.robot.at_rest
        cell.stall(stall)
        watchdog = cell.watchdog
        assert watchdog is not None
        if moving:
            assert watchdog.braking == (stall > 0.05 + cell_rehearsal.WATCHDOG_POLL_S)
        while not trial.over:
            trial.work(cell.clock.time + cell.robot.period)
        assert bool(trial.failure) == (phase < 1.0)
        cell.rest(1.0)
        assert cell.robot.at_rest
        assert 100.0 < cell.steepest() <= FRANKA.torque_rate * (1.0 + 1e-6)
        if watchdog.braking:  # what the cell sends goes nowhere until the reset, and then follows the hold
            sent = len(cell.merged)
            watchdog.reset()
            cell.rest(0.1)
            assert len(cell.merged) - sent == pytest.approx(100, abs=2)
            assert cell.steepest() <= FRANKA.torque_rate * (1.0 + 1e-6)
    finally:
        cell.robot.plant.close()


@pytest.mark.parametrize(("begin", "looking"), [(0.2, True), (0.6, False)])
def test_a_cell_that_stalls_while_it_looks_or_holds_arms_nothing(begin: float, looking: bool) -> None:
    """``begin`` [s] of 0.1 s: the look lasts 0.5 s, and the hold 0.2 s more."""
    cell = Stalled()
    try:
        cell.clock.at(begin, lambda: cell.stall(0.1))
        with pytest.raises(InputError, match="the robot's state is 0.1"):
            cell.arm()
        assert (len(cell.merged) == 1) == looking
        if not looking:
            cell.rest(0.2)
            assert cell.steepest() <= FRANKA.torque_rate * (1.0 + 1e-6)
        assert cell.robot.at_rest
    finally:
        cell.robot.plant.close()
