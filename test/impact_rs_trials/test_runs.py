# SPDX-License-Identifier: Apache-2.0
"""One type of signals: what was measured, which drive a replay has, and what a trial in this process gives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_control.closed_loop import run_closed_loop
from impact_rs_sim.errors import InputError
from impact_rs_sim.plant.plant import Plant
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.runs import NONE, ArmSignals, Run, signals_of_ticks
from impact_rs_trials.since import measured_since


@pytest.fixture(scope="module")
def run(push_campaign: Path) -> Run:
    return TrialBag.open(push_campaign / "cat_food__case_2__s1.000__r0").run()


def without(run: Run, **left_out: np.ndarray) -> Run:
    arms = {name: replace(arm, **left_out) for name, arm in run.signals.arms.items()}
    return replace(run, signals=replace(run.signals, arms=arms))


def test_replay_is_driven_by_the_command_where_it_is_known(run: Run) -> None:
    bare = without(run, command_time=NONE, command=NONE)
    assert (run.drive, bare.drive) == ("command", "joint torque")


def test_motor_counts_as_measured_with_both_its_signals(run: Run) -> None:
    assert run.motor_measured
    assert not without(run, motor_velocity=NONE).motor_measured


def test_selected_samples_leave_empty_signals_empty_and_other_clocks_out() -> None:
    time = np.arange(4.0)
    columns = np.tile(time[:, None], (1, 2))
    arm = ArmSignals(columns, columns, columns, command_time=time[:2], command=columns[:2])
    some = arm.at(slice(1, 3))
    assert np.array_equal(some.position[:, 0], [1.0, 2.0])
    assert (some.motor_position.size, some.command.size) == (0, 0)
    assert some.measured == ("position", "velocity", "torque")


def test_commands_are_shifted_arm_by_arm(run: Run) -> None:
    shifted = run.commands_later({"arm": 0.002})
    assert shifted.signals.arms["arm"].command_time - run.signals.arms["arm"].command_time == pytest.approx(0.002)
    assert np.array_equal(shifted.signals.arms["arm"].command, run.signals.arms["arm"].command)


def test_overlap_with_a_gap_counts_from_either_side(run: Run) -> None:
    torn = replace(run, gaps=((0.2, 0.3),))
    assert [torn.within_gap(*times) for times in ((0.0, 0.2), (0.1, 0.21), (0.25, 0.26), (0.3, 0.4))] == [
        False,
        True,
        True,
        False,
    ]


def test_trial_in_this_process_gives_the_signals_of_its_bag(push_campaign: Path, run: Run) -> None:
    info = TrialBag.open(push_campaign / "cat_food__case_2__s1.000__r0").info
    plan = info.spec.plan
    initial = {name: arm.initial for name, arm in plan.arms.items()}
    plant = Plant.for_trial(plan.scene.scenario, plan.scene.physics, initial, plan.scene.object, seed=info.seed)
    ticks = [tick for tick, _ in zip(run_closed_loop(plan, plant), range(200), strict=False)]
    plant.close()
    signals = signals_of_ticks(ticks)
    assert signals.time == pytest.approx(run.signals.time[:200])
    for name, arm in signals.arms.items():
        for signal in ("position", "velocity", "torque", "motor_position", "command"):
            assert getattr(arm, signal).shape == getattr(run.signals.arms[name], signal)[:200].shape
            assert getattr(arm, signal) == pytest.approx(getattr(run.signals.arms[name], signal)[:200], abs=1e-3)


# ---- --since --------------------------------------------------------------------------------------------------------


NOON = 1_764_154_800.0  # 2025-11-26 11:00 UTC
RUNS = {"push/a": NOON, "push/c": NOON + 60.0, "push/b": NOON + 60.0, "push/d": NOON + 120.0}


@pytest.mark.parametrize(
    ("when", "found"),
    [
        ("push/a", "abcd"),
        ("push/b", "bcd"),  # c was measured at the same time
        ("2025-11-26T11:01:30+00:00", "d"),
        (str(NOON + 1.0), "bcd"),
    ],
)
def test_a_name_or_a_time_is_a_moment(when: str, found: str) -> None:
    assert measured_since(when, RUNS) == {f"push/{letter}" for letter in found}


def test_a_date_without_dashes_is_no_number_of_seconds() -> None:
    """Kills: `float(text)` before `fromisoformat`, for which 20251127 was a day of 1970 and all runs were newer."""
    day_later = {**RUNS, "push/e": NOON + 2 * 86400.0}
    assert measured_since("20251127", day_later) == measured_since("2025-11-27", day_later) == {"push/e"}
    with pytest.raises(InputError, match="or a time such as 2026-11-26T14:32"):
        measured_since("2025", RUNS)
    assert measured_since("20", {"row 1": 10.0, "row 2": 30.0}) == {"row 2"}  # seconds since a table's own origin


def test_a_moment_without_measurements_is_named_with_what_there_is() -> None:
    with pytest.raises(InputError, match="did you mean 'push/a'"):
        measured_since("pushs/a", RUNS)
    with pytest.raises(InputError, match="nothing was measured since then; the last is 'push/d'"):
        measured_since("2030-01-01", RUNS)
    with pytest.raises(InputError, match="expected a name, for example 'row 2'$"):
        measured_since("2", {"row 1": 1.0, "row 2": 2.0}, timed=False)
