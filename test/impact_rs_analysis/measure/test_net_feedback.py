# SPDX-License-Identifier: Apache-2.0
"""The measure: an integral of a held signal, and trials that must not enter a fit."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from impact_rs_analysis.measure.net_feedback import MAX_GAP_S, net_feedback, zero_order_hold_integral
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.trial_info import OUTCOMES


def test_the_integral_of_a_held_signal_is_exact() -> None:
    time = np.array([0.0, 0.1, 0.25, 0.4, 0.5])
    signal = np.array([1.0, 2.0, -1.0, 4.0, 8.0])
    course, total = zero_order_hold_integral(time, signal, 0.05, 0.45)
    assert total == pytest.approx(1.0 * 0.05 + 2.0 * 0.15 - 1.0 * 0.15 + 4.0 * 0.05)
    np.testing.assert_allclose(course, [0.0, 0.05, 0.35, 0.2, total])


def test_the_integral_stops_at_the_end_of_the_window() -> None:
    course, total = zero_order_hold_integral(np.linspace(0.0, 1.0, 11), np.ones(11), 0.2, 0.5)
    assert total == pytest.approx(0.3)
    assert course[-1] == pytest.approx(0.3)


@pytest.fixture
def bag(push_campaign: Path) -> Path:
    return push_campaign / "cat_food__case_2__s1.000__r0"


def test_the_analysis_gets_what_the_controller_integrated(push_campaign: Path) -> None:
    for path in push_campaign.glob("cat_food__*"):
        bag = TrialBag.open(path)
        assert net_feedback(bag).net == pytest.approx(bag.controller("arm").net_feedback[-1, 1], abs=1e-12)


def test_a_trial_hits_near_the_nominal_time(bag: Path) -> None:
    trial = net_feedback(TrialBag.open(bag))
    assert trial.impact
    assert trial.impact_times[0] == pytest.approx(trial.info.nominal_impact_time, abs=0.02)


def test_a_trial_without_detected_impact_is_flagged(bag: Path, tmp_path: Path, rewrite_bag: Callable) -> None:
    rewrite_bag(bag, tmp_path / "bag", lambda topic: "impact_event" not in topic)
    assert not net_feedback(TrialBag.open(tmp_path / "bag")).impact


def test_a_bag_without_controller_states_is_refused(bag: Path, tmp_path: Path, rewrite_bag: Callable) -> None:
    rewrite_bag(bag, tmp_path / "bag", lambda topic: "controller_state" not in topic)
    with pytest.raises(BagError, match="controller states"):
        net_feedback(TrialBag.open(tmp_path / "bag"))


PERIOD = 1e-3  # s
TIMES = np.arange(1801) * PERIOD


def recorded(feedback: dict[str, np.ndarray], time: np.ndarray = TIMES, **changes: object) -> SimpleNamespace:
    """What the measure reads of a bag, made up: feedback ``(k, 3)`` [m/s^2] by arm."""
    text = load_scenario("push" if "arm" in feedback else "grab").model_dump_json()
    info = SimpleNamespace(
        scenario="grab", axis="z", robots=tuple(feedback), window_start=0.8, window_end=1.5, nominal_impact_time=0.9,
        scenario_json=text,
    )  # fmt: skip
    hits = {arm: 0.9 + 0.01 * number for number, arm in enumerate(feedback)}
    columns = {
        arm: SimpleNamespace(
            time=time,
            feedback_acceleration=values,
            twist=np.column_stack((values + 10.0, values + 20.0)),
            ante_velocity=values + 30.0,
            post_velocity=values + 40.0,
            commanded_torque=np.full((time.size, 7), 11.9),
        )  # fmt: skip
        for arm, values in feedback.items()
    }
    bag = SimpleNamespace(
        path=Path("made_up"), info=info, metadata={}, controller=columns.__getitem__, impact_time=hits.__getitem__,
        counts={},
    )  # fmt: skip
    for name, value in changes.items():
        setattr(info if hasattr(info, name) else bag, name, value)
    return bag


def constant(*values: float) -> np.ndarray:
    return np.tile(np.array(values), (TIMES.size, 1))


UP, STILL = constant(0.0, 0.0, 1.0), constant(0.0, 0.0, 0.0)


@pytest.mark.parametrize(("axis", "expected"), [("x", 0.7), ("y", 1.4), ("z", -2.1)])
def test_a_constant_feedback_along_the_axis_counts_for_the_whole_window(axis: str, expected: float) -> None:
    """Paper eq. a_fb_net: t2 - t1 = 0.7 s of 1, 2 and -3 m/s^2."""
    trial = net_feedback(recorded({"arm": constant(1.0, 2.0, -3.0)}, axis=axis))
    assert trial.net == pytest.approx(expected, abs=1e-12)
    assert trial.integral[800] == pytest.approx(0.0, abs=1e-12)
    assert trial.integral[1500:] == pytest.approx(expected, abs=1e-12)
    level = constant(1.0, 2.0, -3.0)[0]["xyz".index(axis)]
    for name, shift in (("velocity", 10.0), ("feedback", 0.0), ("ante_reference", 30.0), ("post_reference", 40.0)):
        np.testing.assert_allclose(getattr(trial, name), level + shift, err_msg=name)


def test_feedback_outside_the_window_does_not_count() -> None:
    feedback = np.zeros((TIMES.size, 3))
    feedback[:800, 2] = feedback[1500:, 2] = 100.0
    feedback[800:1500, 2] = np.where(np.arange(700) % 2, 1.0, -0.5)
    assert net_feedback(recorded({"arm": feedback})).net == pytest.approx(0.25 * 0.7, abs=1e-12)


def test_two_arms_count_with_their_mean() -> None:
    """Paper sec. Dual-arm grabbing scenario."""
    trial = net_feedback(recorded({"left": UP, "right": 3.0 * UP}))
    assert trial.net == pytest.approx(2.0 * 0.7, abs=1e-12)
    assert trial.nets == pytest.approx({"left": 0.7, "right": 3.0 * 0.7}, abs=1e-12)
    assert trial.spread == pytest.approx(0.01)


def test_arms_with_stamps_of_their_own_are_brought_to_one_clock() -> None:
    """A feedback that grows with time is the same signal at shifted stamps."""
    late = TIMES + 0.4 * PERIOD
    bag = recorded({"left": np.outer(TIMES, [0.0, 0.0, 1.0]), "right": STILL})
    right = bag.controller("right")
    right.time, right.feedback_acceleration = late, np.outer(late, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(net_feedback(bag).feedback[1:], TIMES[1:], atol=1e-12)


@pytest.mark.parametrize("moments", [(0.9, np.nan), (np.nan, 0.9)])
def test_the_spread_is_nan_whichever_arm_has_no_hit(moments: tuple[float, float]) -> None:
    """Kills: max() - min(), which skip a nan that does not come first: 0 s."""
    assert np.isnan(replace(net_feedback(recorded({"left": UP, "right": UP})), impact_times=moments).spread)


@pytest.mark.parametrize(
    ("moments", "impact"), [((0.8, 1.5), True), ((0.79, 0.9), False), ((0.9, 1.51), False), ((0.9, np.nan), False)]
)
def test_every_arm_must_hit_within_the_window(moments: tuple[float, float], impact: bool) -> None:
    trial = net_feedback(recorded({"left": UP, "right": UP}))
    assert replace(trial, impact_times=moments).impact == impact


@pytest.mark.parametrize(
    ("kept", "complaint"),
    [
        (TIMES > 0.85, "the window lasts"),
        (TIMES < 1.4, "the window lasts"),
        ((TIMES < 1.0) | (TIMES > 1.0 + 1.5 * MAX_GAP_S), "no controller state from 0.999 s"),
        (TIMES < 0.0005, "1 controller states"),
    ],
)
def test_a_recording_with_a_hole_in_the_window_is_refused(kept: np.ndarray, complaint: str) -> None:
    with pytest.raises(BagError, match=complaint):
        net_feedback(recorded({"arm": UP[kept]}, TIMES[kept]))


def test_a_hole_outside_the_window_costs_nothing() -> None:
    kept = (TIMES < 0.3) | (TIMES > 0.5)
    assert net_feedback(recorded({"arm": UP[kept]}, TIMES[kept])).net == pytest.approx(0.7)


@pytest.mark.parametrize("outcome", sorted(set(OUTCOMES) - {"OK", "NO-IMPACT", "EARLY"}) + ["FORGOTTEN"])
def test_a_trial_that_went_wrong_never_enters(outcome: str) -> None:
    bag = recorded({"arm": UP}, metadata={"outcome": outcome}, outcome=outcome, reason="too fast")
    with pytest.raises(BagError, match=f"{outcome}: too fast"):
        net_feedback(bag)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [({"axis": "w"}, "axis 'w'"), ({"window_start": 1.5, "window_end": 0.8}, "is empty or not finite")],
)
def test_a_trial_that_does_not_say_what_to_measure_is_refused(change: dict, complaint: str) -> None:
    with pytest.raises(BagError, match=complaint):
        net_feedback(recorded({"arm": UP}, **change))


def test_stamps_that_go_back_and_numbers_that_are_none_are_refused() -> None:
    time = TIMES.copy()
    time[900] = time[898]
    with pytest.raises(BagError, match="do not increase"):
        net_feedback(recorded({"arm": UP}, time))
    bag = recorded({"arm": UP})
    broken = UP.copy()
    broken[1000, 2] = np.nan
    bag.controller("arm").feedback_acceleration = broken
    with pytest.raises(BagError, match="feedback signal is not finite"):
        net_feedback(bag)


@pytest.mark.parametrize(("start", "known"), [(1.0, 0.020), (1.496, 0.0), (0.2, 0.0)])
def test_a_joint_at_its_torque_limit_within_the_window_is_named(start: float, known: float) -> None:
    """20 ms at -12 N m: inside the window, less than 5 ms inside it, before it."""
    bag = recorded({"left": UP, "right": UP})
    assert net_feedback(bag).limited == ()
    first = round(1e3 * start)
    bag.controller("right").commanded_torque[first : first + 20, 5] = -12.0
    assert dict(net_feedback(bag).limited) == ({"right joint6": pytest.approx(known)} if known else {})
