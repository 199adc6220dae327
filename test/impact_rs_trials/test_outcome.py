# SPDX-License-Identifier: Apache-2.0
"""How a trial ended is judged by what was measured: each rule at its limit, and a plant that really blows up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trials import BRIEF, plan_of, recorded

from impact_rs_control.closed_loop import RUNAWAY, make_plant, run_closed_loop
from impact_rs_control.controller import Mode
from impact_rs_control.plan import TrialPlan
from impact_rs_control.qp import QpStatus
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.outcome import MAX_SUNK_SHARE, ArmRecord, TickLog, TrialRecord, Verdict, judge
from impact_rs_trials.bags.reader import JointColumns, PoseColumns, TrialBag
from impact_rs_trials.spec import TrialSpec

PUSH = plan_of("push", "cat_food", "case_2")
GRAB = plan_of("grab", "cat_food", "case_2")
EXCITE = plan_of("excite", "none", "slow")
LIMITS = load_scenario("push").robots["arm"].robot_facts.limits
TICKS = 200
TIME = np.arange(TICKS) * 1e-3
MIDDLE = 0.5 * (np.array(LIMITS.position_min_rad) + np.array(LIMITS.position_max_rad))
JOINT, SINCE = 5, 40  # the sixth joint, from 40 ms on


def arm_record(hit: bool = True) -> ArmRecord:
    """An arm that stands in the middle of all its limits."""
    still = np.zeros((TICKS, 7))
    joints = JointColumns(TIME, still + MIDDLE, still.copy(), still.copy())
    mode = np.full(TICKS, Mode.ANTE)
    return ArmRecord(joints, TIME, still.copy(), np.full(TICKS, QpStatus.SOLVED), hit, mode)


def record(plan: TrialPlan, arm: ArmRecord | None = None, lift: float = 0.0) -> TrialRecord:
    """A trial in which every arm did the same, and the object rose upright by ``lift`` [m]."""
    position = np.zeros((TICKS, 3))
    position[:, 2] = 0.5 + np.linspace(0.0, lift, TICKS)
    upright = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (TICKS, 4))
    return TrialRecord(dict.fromkeys(plan.arms, arm or arm_record()), PoseColumns(TIME, position, upright))


def with_signal(name: str, value: float, ticks: int) -> TrialRecord:
    """A push in which a signal of joint 6 has a value for some ticks."""
    arm = arm_record()
    values = {"command": arm.command, "effort": arm.joints.effort, "velocity": arm.joints.velocity}
    signal = values.get(name, arm.joints.position)
    signal[SINCE : SINCE + ticks, JOINT] = value
    return record(PUSH, arm)


def leaning(angle: float, ticks: int, axis: tuple[float, float, float], start: float = 0.0) -> TrialRecord:
    """A push whose object, turned about the vertical by ``start`` [rad], leans by an angle [rad] for some ticks."""
    told = record(PUSH)
    turned = np.array([0.0, 0.0, np.sin(start / 2), np.cos(start / 2)])
    quaternion = np.tile(turned, (TICKS, 1))
    x, y, z = np.sin(angle / 2) * np.array(axis)
    w, (_, _, c, d) = np.cos(angle / 2), turned
    # The product of the lean with what was there before: (x, y, z, w) * (0, 0, c, d).
    quaternion[SINCE : SINCE + ticks] = [x * d + y * c, y * d - x * c, z * d + w * c, w * d - z * c]
    return replace(told, object=replace(told.object, quaternion=quaternion))


def test_a_trial_within_all_limits_is_ok() -> None:
    assert judge(PUSH, record(PUSH)) == Verdict("OK")
    assert judge(EXCITE, record(EXCITE, arm_record(hit=False))) == Verdict("OK")
    assert judge(GRAB, record(GRAB, lift=GRAB.expected_lift)) == Verdict("OK")


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("name", "what", "limit", "unit", "longest"),
    [
        ("velocity", "speed", LIMITS.velocity_rad_s[JOINT], "rad/s", 5),
        ("effort", "torque", LIMITS.torque_Nm[JOINT], "N m", 50),
        ("command", "commanded torque", LIMITS.torque_Nm[JOINT], "N m", 50),
    ],
)
def test_a_limit_may_be_passed_for_a_moment(
    name: str, what: str, limit: float, unit: str, longest: int, sign: float
) -> None:
    value = sign * 1.5 * limit
    assert judge(PUSH, with_signal(name, value, longest)) == Verdict("OK")
    verdict = judge(PUSH, with_signal(name, value, longest + 1))
    told = f"{what} {value:.4g} {unit} against {sign * limit:.4g} {unit}, beyond it for {longest + 1} ms from 0.040 s"
    assert verdict == Verdict("LIMIT", f"arm joint6: {told}")


@pytest.mark.parametrize("name", ["velocity", "effort", "command"])
def test_a_signal_held_at_its_limit_is_not_beyond_it(name: str) -> None:
    limit = LIMITS.velocity_rad_s[JOINT] if name == "velocity" else LIMITS.torque_Nm[JOINT]
    assert judge(PUSH, with_signal(name, limit, TICKS)) == Verdict("OK")


def test_a_joint_at_its_torque_limit_rings_but_its_command_does_not() -> None:
    value = 1.04 * LIMITS.torque_Nm[JOINT]
    assert judge(PUSH, with_signal("effort", value, TICKS)).outcome == "OK"
    assert judge(PUSH, with_signal("command", value, TICKS)).outcome == "LIMIT"


@pytest.mark.parametrize(
    ("stop", "way"), [(LIMITS.position_min_rad[JOINT], -1.0), (LIMITS.position_max_rad[JOINT], 1.0)]
)
def test_a_joint_beyond_either_stop_is_told_with_that_stop(stop: float, way: float) -> None:
    assert judge(PUSH, with_signal("position", stop, TICKS)) == Verdict("OK")
    assert judge(PUSH, with_signal("position", stop + 0.1 * way, 5)) == Verdict("OK")
    told = f"position {stop + 0.1 * way:.4g} rad against {stop:.4g} rad, beyond it for 6 ms from 0.040 s"
    assert judge(PUSH, with_signal("position", stop + 0.1 * way, 6)) == Verdict("LIMIT", f"arm joint6: {told}")


def test_time_beyond_a_limit_counts_altogether_also_of_what_oscillates() -> None:
    arm = arm_record()
    arm.joints.velocity[SINCE : SINCE + 12 : 2, JOINT] = 1.2 * LIMITS.velocity_rad_s[JOINT]
    verdict = judge(PUSH, record(PUSH, arm))
    assert (verdict.outcome, "for 6 ms from 0.040 s" in verdict.reason) == ("LIMIT", True)


@pytest.mark.parametrize("joint", [0, 5])
def test_one_sample_beyond_twice_its_speed_limit_is_a_joint_that_ran_away(joint: int) -> None:
    limit, arm = LIMITS.velocity_rad_s[joint], arm_record()
    arm.joints.velocity[SINCE, joint] = -RUNAWAY * limit
    assert judge(PUSH, record(PUSH, arm)) == Verdict("OK")
    arm.joints.velocity[SINCE, joint] = -2.01 * limit
    told = f"arm joint{joint + 1} at {2.01 * limit:.4g} rad/s against {limit:.4g} rad/s at 0.040 s"
    assert judge(PUSH, record(PUSH, arm)) == Verdict("DIVERGED", told)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("name", "what"), [("position", "position"), ("effort", "torque"), ("command", "commanded torque")]
)
def test_a_number_that_is_none_is_a_plant_that_diverged(name: str, what: str, value: float) -> None:
    assert judge(PUSH, with_signal(name, value, 1)) == Verdict("DIVERGED", f"arm joint6: {what} not finite at 0.040 s")
    assert judge(PUSH, with_signal("velocity", value, 1)).outcome == "DIVERGED"


def test_a_qp_without_solution_is_told_when_it_lasts() -> None:
    arm = arm_record()
    arm.qp_status[SINCE : SINCE + 50] = QpStatus.RELAXED
    assert judge(PUSH, record(PUSH, arm)) == Verdict("OK")
    arm.qp_status[SINCE + 50] = QpStatus.FAILED
    told = "arm: no torque within the limits solved its QP for 51 ms from 0.040 s"
    assert judge(PUSH, record(PUSH, arm)) == Verdict("INFEASIBLE", told)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
@pytest.mark.parametrize("start", [0.0, 2.0])
def test_an_object_that_leans_more_than_20_degrees_has_tipped_over(
    axis: tuple[float, float, float], start: float
) -> None:
    assert judge(PUSH, leaning(np.radians(19.9), TICKS, axis, start)).outcome == "OK"
    told = "the object leaned by 21 degrees against 20 degrees from 0.040 s"
    assert judge(PUSH, leaning(np.radians(21.0), 6, axis, start)) == Verdict("TIPPED", told)
    assert judge(PUSH, leaning(np.radians(21.0), 5, axis, start)).outcome == "OK"


def test_an_impact_that_is_told_before_the_pad_can_be_there_is_none() -> None:
    """The window of a push begins at 0.8 s; a mode that is left on its first tick is in time."""
    begin = PUSH.scene.scenario.timing.window[0]
    time = begin - 0.1 + TIME
    for row, expected in ((99, "EARLY"), (100, "OK"), (150, "OK")):
        arm = replace(arm_record(), command_time=time)
        arm.mode[row:] = Mode.INTERIM
        found = judge(PUSH, record(PUSH, arm))
        assert found.outcome == expected
        if expected != "OK":
            assert "at 0.799 s, before the window from 0.800 s: raise control.detection.threshold" in found.reason
    assert judge(EXCITE, record(EXCITE, arm)) == Verdict("OK")


def test_the_object_of_a_free_motion_may_lean() -> None:
    assert judge(EXCITE, leaning(np.radians(80.0), TICKS, (1.0, 0.0, 0.0))).outcome == "OK"


@pytest.mark.parametrize("lift", [-1e-3, -1e-12, 0.0, 1e-12, 1e-3])
def test_a_pushed_object_cannot_be_dropped(lift: float) -> None:
    assert judge(PUSH, record(PUSH, lift=lift)) == Verdict("OK")


def seen_until(end: float, lift: float) -> TrialRecord:
    """A grab whose object is seen until ``end`` [s], risen by ``lift`` [m]."""
    whole = record(GRAB, lift=lift)
    return replace(whole, object=replace(whole.object, time=np.linspace(0.0, end, TICKS)))


def test_a_clamped_object_that_rises_too_little_was_dropped() -> None:
    end, enough = GRAB.scene.scenario.timing.duration, (1.0 - MAX_SUNK_SHARE) * GRAB.expected_lift
    assert judge(GRAB, seen_until(end, 1.01 * enough)) == Verdict("OK")
    unseen = replace(record(GRAB), object=PoseColumns(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4))))
    assert judge(GRAB, unseen) == Verdict("OK")  # a laboratory without a tracker
    message = f"the object rose {0.99 * enough:.3f} m until {end:.3f} s, it was to rise {GRAB.expected_lift:.3f} m"
    assert judge(GRAB, seen_until(end, 0.99 * enough)) == Verdict("DROPPED", message)


def test_an_object_that_is_lost_from_sight_on_its_way_up_was_not_dropped() -> None:
    """Kills a comparison of the last pose seen with the lift at the end of the trial."""
    lost = GRAB.scene.scenario.timing.nominal_impact + 0.2
    risen = GRAB.expected_lift_at(lost)
    assert 0.0 < risen < MAX_SUNK_SHARE * GRAB.expected_lift
    assert judge(GRAB, seen_until(lost, risen)) == Verdict("OK")
    assert judge(GRAB, seen_until(lost, risen - 0.6 * GRAB.expected_lift)).outcome == "DROPPED"


def test_without_impact_nothing_is_said_of_the_object() -> None:
    assert judge(GRAB, record(GRAB, arm_record(hit=False))) == Verdict("NO-IMPACT", "left, right detected no impact")
    one = record(GRAB, lift=GRAB.expected_lift)
    one.arms["right"] = arm_record(hit=False)
    assert judge(GRAB, one) == Verdict("NO-IMPACT", "right detected no impact")


def test_the_gravest_is_told_and_of_equally_grave_ones_the_earliest() -> None:
    arm = arm_record(hit=False)
    arm.qp_status[:] = QpStatus.RELAXED
    assert judge(PUSH, record(PUSH, arm)).outcome == "INFEASIBLE"
    arm.joints.velocity[100:, 2] = 1.1 * LIMITS.velocity_rad_s[2]
    arm.joints.velocity[50:, 3] = 1.1 * LIMITS.velocity_rad_s[3]
    assert judge(PUSH, record(PUSH, arm)).reason.startswith("arm joint4: speed")
    arm.joints.velocity[150, 1] = 9.0 * LIMITS.velocity_rad_s[1]
    arm.joints.velocity[150, 0] = 8.0 * LIMITS.velocity_rad_s[0]
    assert judge(PUSH, record(PUSH, arm)).reason.startswith("arm joint2 at")


def test_a_damper_too_strong_for_a_wrist_ends_the_trial_and_names_it(tmp_path: Path) -> None:
    """h^2 K + 2 h D < 4 m (impact_rs_sim.robots.drive_stability): an FR3's wrist is too light for the drive of push."""
    scenario = load_scenario("push").with_settings({"robots.arm.facts": "franka_fr3"})
    verdict = recorded(TrialSpec.of(scenario, "cat_food", "case_2").plan, tmp_path / "trial", seed=1)
    assert verdict.outcome == "DIVERGED"
    assert verdict.reason.startswith("arm joint7 at")
    bag = TrialBag.open(tmp_path / "trial")
    assert (bag.outcome, bag.reason) == (verdict.outcome, verdict.reason)
    assert 0.01 < bag.controller("arm").time[-1] < 0.2  # it does not run on for the 1.8 s that were planned


def test_a_tall_box_on_a_rough_table_tips_over_when_it_is_hit(tmp_path: Path) -> None:
    tall = {"objects.cat_food.size": [0.24, 0.05, 0.9], "support.friction": 1.0}
    plan = TrialSpec.of(load_scenario("push").with_settings(tall), "cat_food", "case_2").plan
    verdict = recorded(plan, tmp_path / "trial", seed=1)
    assert verdict.outcome == "TIPPED"
    assert 0.9 < float(verdict.reason.split()[-2]) < 1.8  # s: after the impact


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e8])
def test_nan_ends_a_trial_at_once_without_a_traceback(value: float) -> None:
    class Broken:
        """A plant whose encoder of joint 4 fails at the third tick."""

        def __init__(self) -> None:
            self.plant, self.asked = make_plant(PUSH, 1), 0
            self.step, self.close = self.plant.step, self.plant.close

        def measure(self):  # noqa: ANN202
            measured = self.plant.measure()
            self.asked += 1
            if self.asked == 3:
                measured.arms["arm"].position[3] = measured.arms["arm"].velocity[3] = value
            return measured

    cell = Broken()
    with np.errstate(all="ignore"):
        ticks = list(run_closed_loop(PUSH, cell))
    cell.close()
    assert [tick.number for tick in ticks] == [0, 1, 2]


@pytest.mark.parametrize(
    ("axis", "angle", "outcome"), [("z", 90.0, "OK"), ("x", 25.0, "TIPPED"), ("y", 25.0, "TIPPED")]
)
def test_an_object_that_starts_askew_may_turn_about_the_vertical(axis: str, angle: float, outcome: str) -> None:
    askew = Rotation.from_euler("xy", (40.0, 30.0), degrees=True)
    moved = Rotation.from_euler(axis, angle, degrees=True) * askew
    found = record(PUSH)
    quaternion = np.tile(askew.as_quat(), (TICKS, 1))
    quaternion[SINCE:] = moved.as_quat()
    verdict = judge(PUSH, replace(found, object=replace(found.object, quaternion=quaternion)))
    assert verdict.outcome == outcome
    assert outcome == "OK" or "leaned by 25 degrees" in verdict.reason


@pytest.mark.parametrize("kind", ["speed", "position", "status", "mode"])
def test_of_two_arms_the_one_that_failed_first_is_named(kind: str) -> None:
    both = record(GRAB, lift=GRAB.expected_lift)
    for name, since in (("left", 60), ("right", 50)):
        arm = both.arms[name] = arm_record()
        if kind == "speed":
            arm.joints.velocity[since, JOINT] = 9.0 * LIMITS.velocity_rad_s[JOINT]
        elif kind == "position":
            arm.joints.position[since, JOINT] = np.nan
        elif kind == "status":
            arm.qp_status[since:] = QpStatus.FAILED
        else:
            arm.mode[since:] = Mode.INTERIM
    verdict = judge(GRAB, both)
    assert verdict.outcome == {"status": "INFEASIBLE", "mode": "EARLY"}.get(kind, "DIVERGED")
    assert verdict.reason.startswith("right")


@pytest.mark.parametrize(("low", "high", "worst"), [(-1.5, 1.2, -1.5), (-1.2, 1.5, 1.5)])
def test_the_value_farthest_beyond_either_limit_is_reported(low: float, high: float, worst: float) -> None:
    limit, arm = LIMITS.velocity_rad_s[JOINT], arm_record()
    arm.joints.velocity[SINCE : SINCE + 6, JOINT] = high * limit
    arm.joints.velocity[SINCE + 6 : SINCE + 12, JOINT] = low * limit
    expected = f"speed {worst * limit:.4g} rad/s against {np.sign(worst) * limit:.4g} rad/s"
    assert expected in judge(PUSH, record(PUSH, arm)).reason


def test_a_witness_keeps_status_and_impact_of_a_trial() -> None:
    plan = plan_of("push", "juice", "case_1", **BRIEF)
    whole, early = TickLog(plan), TickLog(plan)
    plant = make_plant(plan, 1)
    for tick in run_closed_loop(plan, plant):
        whole.append(tick)
        if tick.number < 10:
            early.append(tick)
    plant.close()
    arm = whole.record().arms["arm"]
    assert arm.hit and not early.record().arms["arm"].hit
    assert arm.qp_status.shape == arm.command_time.shape and set(arm.qp_status) == {QpStatus.SOLVED}
    assert judge(plan, whole.record()) == Verdict("OK")
