# SPDX-License-Identifier: Apache-2.0
"""Runs of a laboratory: commands on the clock of the states, and the jump in the measured state."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mixed_grab import write_experiment

from impact_rs_analysis.evidence.replays import command_clock
from impact_rs_analysis.evidence.replays.ante_impact import (
    ante_impact_state,
    obliqueness,
    obliqueness_of,
    problem_of,
)
from impact_rs_analysis.evidence.replays.command_clock import (
    command_offset,
    measured_or_why_not,
    read_laboratory_runs,
    read_runs_of_scenes,
)
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs, read_runs, read_trial
from impact_rs_analysis.evidence.replays.simulated_trials import simulated
from impact_rs_analysis.evidence.sources.run_source import layout_of, pure_errors
from impact_rs_analysis.measure.velocity_jumps import jumps_of
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import compute_impact_map
from impact_rs_sim.impact_map.contacts import SUPPORT, contact_pairs
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags.reader import OF_THE_TWIN
from impact_rs_trials.campaign import make_manifest, run_one
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.runs import NONE, Run
from impact_rs_trials.spec import TrialSpec

from .conftest import COULOMB, free_starts, with_signals


def stamped(run: Run, late: float) -> Run:
    """The run with commands whose stamps are so much too late [s]."""
    return run.commands_later(dict.fromkeys(run.signals.arms, late))


def runs_of(*runs: MeasuredRun) -> Runs:
    return Runs.of(Path("here"), runs)


# ---- commands -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("late", [-0.0003, 0.0, 0.0003])
def test_an_offset_below_half_a_period_is_found_also_with_friction(free: Run, rubbed: Run, late: float) -> None:
    for run in (free, rubbed):
        offset, error = command_offset([stamped(run, late)], "arm")
        assert offset == pytest.approx(-late, abs=2e-4)
        assert abs(offset + late) < 3.0 * error < 5e-4
    assert COULOMB.max() > 0.2


def test_a_delay_of_milliseconds_is_left_for_the_diagnosis(free: Run) -> None:
    """And the clock is as uncertain as before: uniform over a period of 1 ms. Kills a clock taken for exact."""
    assert command_offset([stamped(free, -0.003)], "arm") == (0.0, pytest.approx(1e-3 / np.sqrt(12.0)))
    without = with_signals(free, lambda arm: replace(arm, command_time=NONE, command=NONE))
    assert command_offset([without], "arm") == (0.0, 0.0)


def test_a_shift_brings_commands_to_where_they_act(free: Run) -> None:
    late = stamped(free, 0.0003)
    again = late.commands_later({"arm": command_offset([late], "arm")[0]})
    assert np.max(np.abs(again.signals.arms["arm"].command_time - free.signals.arms["arm"].command_time)) < 2e-4


def test_a_run_at_rest_is_left_out_with_the_reason(free: Run) -> None:
    """Kills: the first moving sample of a run in which no joint moves, an IndexError that lost the other runs."""
    still = with_signals(free, lambda arm: replace(arm, velocity=np.zeros_like(arm.velocity)))
    reason = "no joint moves for the length of a window of free motion"
    assert measured_or_why_not(still) == (str(free.path), reason)
    assert command_offset([still], "arm") == (0.0, 0.0)


def test_runs_with_a_later_clock_have_the_age_of_their_condition(free: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills: late runs of age 0, whose difference to the residuals of the condition contains drift times age."""
    hours = {
        name: replace(free, condition=name, path=Path(name), recorded=1.7e9 + 3600.0 * n) for n, name in enumerate("ab")
    }
    monkeypatch.setattr(command_clock, "read_laboratory", lambda *_: (list(hours.values()), []))
    runs = read_runs_of_scenes(Path("here"), [None], map)
    ages = {run.condition: {window.age for window in run.setup.windows} for run in runs.runs}
    assert ages == {"a": {0.0}, "b": {3600.0}}
    assert {name: {window.age for window in run.setup.windows} for name, run in runs.late.items()} == ages


# ---- gaps -----------------------------------------------------------------------------------------------------------


def torn(run: Run, start: float, end: float, condition: str | None = None) -> MeasuredRun:
    """The run as it is read with a gap: nothing between is known, and something else stands there."""
    wrong = np.where((run.signals.time > start) & (run.signals.time < end), 30.0, 0.0)[:, None]  # N m
    changed = with_signals(run, lambda arm: replace(arm, torque=arm.torque + wrong), gaps=((start, end),))
    return replace(MeasuredRun.of(changed), condition=condition or run.condition)


def test_windows_that_no_gap_touches_are_as_without_it(free: Run, measured_free: MeasuredRun) -> None:
    whole, start = measured_free, free_starts(measured_free)[5]
    gapped = torn(free, start + 0.02, start + 0.06)
    assert (whole.lost, gapped.lost) == ((), (5,))
    assert [window.number for window in gapped.setup.windows] == [n for n in range(whole.free) if n != 5]
    known = dict(zip(whole.features, whole.measured, strict=True))
    assert gapped.measured == pytest.approx([known[feature] for feature in gapped.features], abs=1e-12)
    # Of repeats what all of them have is used, and its pure error is that of all conditions.
    runs = runs_of(whole, gapped).runs
    assert [run.features for run in runs] == [gapped.features, gapped.features]
    assert runs[0].lost == (5,)
    np.testing.assert_array_equal(runs[0].measured, runs[1].measured)


def test_a_window_that_one_run_lost_is_given_up_by_all_alike(free: Run, measured_free: MeasuredRun) -> None:
    whole, starts = measured_free, free_starts(measured_free)
    runs = runs_of(whole, torn(free, starts[5], starts[5] + 0.05, "other")).runs
    assert [run.lost for run in runs] == [(5,), (5,)]
    assert layout_of(runs[0]) == layout_of(runs[1])
    # More than half of the windows are not given up for others.
    gone = torn(free, starts[1], starts[-2], "other")
    assert len(gone.lost) > whole.free / 2
    assert [run.lost for run in runs_of(whole, gone).runs] == [(), gone.lost]


def test_a_repeat_that_moves_for_less_time_has_lost_nothing(measured_free: MeasuredRun) -> None:
    whole = measured_free
    first = {feature for feature in whole.features if feature.bin < whole.free - 1}
    shorter = replace(whole.only(first), free=whole.free - 1)
    assert [run.lost for run in runs_of(whole, shorter).runs] == [(), ()]


def test_a_gap_that_ends_before_a_window_spoils_the_fit_of_its_start(free: Run, measured_free: MeasuredRun) -> None:
    start = free_starts(measured_free)[3]
    assert torn(free, start - 0.03, start - 0.004).lost in ((3,), (2, 3))


def test_pure_error_is_pooled_over_conditions_with_and_without_gaps(free: Run, measured_free: MeasuredRun) -> None:
    whole, start = measured_free, free_starts(measured_free)[5]
    other = torn(free, start, start + 0.05, "other")
    scatter = np.random.default_rng(0).standard_normal((2, len(whole.features)))
    left = [feature in other.features for feature in whole.features]
    found = pure_errors({whole.condition: whole, "other": other}, {whole.condition: scatter, "other": scatter[:, left]})
    expected = np.std(scatter, axis=0, ddof=1)
    assert found[whole.condition] == pytest.approx(expected)
    assert found["other"] == pytest.approx(expected[left])
    assert layout_of(whole) != layout_of(other)


def test_a_gap_before_the_impact_takes_free_motion_one_about_it_the_run(hit: Run, measured_hit: MeasuredRun) -> None:
    start = free_starts(measured_hit)[0]
    gapped = torn(hit, start + 0.02, start + 0.06)
    assert 0 in gapped.lost
    known = dict(zip(measured_hit.features, measured_hit.measured, strict=True))
    assert gapped.measured == pytest.approx([known[feature] for feature in gapped.features], abs=1e-9)
    impact = measured_hit.impacts["arm"]
    with pytest.raises(InputError, match="a gap lies in the window about the impact"):
        torn(hit, impact - 0.06, impact - 0.025)


# ---- the impact map of a run ----------------------------------------------------------------------------------------


def test_the_state_before_the_impact_is_that_at_the_impact(measured_hit: MeasuredRun) -> None:
    """And not milliseconds before."""
    state = ante_impact_state(measured_hit)["arm"]
    twist = measured_hit.physics.robot_model("arm").jacobian(state.position) @ state.velocity
    assert twist[1] == pytest.approx(-0.7, abs=0.005)
    assert obliqueness(measured_hit) < 0.01


def test_a_tilted_pad_hits_obliquely_and_a_pad_at_rest_by_its_normal_alone(measured_hit: MeasuredRun) -> None:
    """Kills the normal of the flange in place of the pad's, and an angle of no velocity that is not a number."""
    physics, box = measured_hit.physics, measured_hit.setup.windows[-1].object
    states = ante_impact_state(measured_hit)
    tilted = library()["pad_tilt"].apply_vector(physics, np.array([0.06, 0.0]))
    assert obliqueness_of(tilted, states, box) == pytest.approx(0.06, abs=0.01)
    resting = {name: replace(state, velocity=np.zeros_like(state.velocity)) for name, state in states.items()}
    assert obliqueness_of(tilted, resting, box) == pytest.approx(0.06, abs=0.01)


def test_the_map_of_a_run_has_the_restitution_law_of_its_scenario(measured_hit: MeasuredRun) -> None:
    """Kills a problem that falls back to Newton's law."""
    assert problem_of(measured_hit, measured_hit.physics).restitution_law == "newton"
    assert (
        problem_of(measured_hit, replace(measured_hit.physics, restitution_law="poisson")).restitution_law == "poisson"
    )


def test_pad_and_object_touch_in_what_the_map_is_asked(measured_hit: MeasuredRun) -> None:
    farther = tuple(
        replace(window, object=replace(window.object, position=window.object.position + [0.0, -0.004, 0.0]))
        for window in measured_hit.setup.windows
    )
    apart = replace(measured_hit, setup=replace(measured_hit.setup, windows=farther))
    physics = measured_hit.physics
    for run in (measured_hit, apart):
        problem = problem_of(run, physics)
        placements = {"arm": physics.robot_model("arm").placement(problem.arms["arm"].position)}
        gaps = [m.separation for m in contact_pairs(physics, problem.object, placements) if m.partner != SUPPORT]
        assert gaps == pytest.approx([0.0], abs=1e-9)
    result = compute_impact_map(problem_of(measured_hit, physics), "exact")
    assert -0.6 < result.end_effector_twist["arm"][1] < -0.4


def test_what_the_map_is_asked_about_a_tilted_pad_is_the_pad_face_on_face(measured_hit: MeasuredRun) -> None:
    """It turns the wrist until the pad is parallel, and not the flange, which is askew then."""
    physics = library()["pad_tilt"].apply_vector(measured_hit.physics, np.array([0.03, -0.02]))
    problem = problem_of(measured_hit, physics)
    pad = physics.arms["arm"].end_effector.pad_placement
    face = (physics.robot_model("arm").placement(problem.arms["arm"].position) * pad).rotation[:, 2]
    np.testing.assert_allclose(face, [0, -1, 0], atol=1e-6)
    straight = problem_of(measured_hit, measured_hit.physics)
    results = [compute_impact_map(one, "exact") for one in (problem, straight)]
    speeds = [result.end_effector_twist["arm"][1] for result in results]
    assert speeds[0] == pytest.approx(speeds[1], rel=0.05)


def test_with_nothing_hidden_the_reduced_inertia_predicts_the_speed_after(measured_hit: MeasuredRun) -> None:
    """Frictionless plant: some tenths of a percent to some percent, and nearer than without the torque loop."""
    theirs = replace(measured_hit, spec=None)
    found = jumps_of(runs_of(theirs, theirs))
    assert abs(found.errors["reduced"]) < 5.0
    assert found.errors["reduced"] < found.errors["rotor"]
    (jump,) = found.jumps
    assert jump.before == pytest.approx(0.7, abs=0.01)
    assert 0.4 < jump.after < 0.6
    assert jump.interval == pytest.approx((jump.after, jump.after))
    settled = jumps_of(runs_of(theirs), "settled")
    assert (found.to_json()["contact"], settled.to_json()["contact"]) == ("first", "settled")
    assert settled.errors["reduced"] == pytest.approx(found.errors["reduced"], abs=0.5)  # the face was closed already


def test_a_pad_that_comes_at_an_angle_takes_the_object_along_sideways() -> None:
    """15 degrees beside the normal, inside the cone of friction: bound along the way alone, the prediction lags."""
    scenario = load_scenario("push")
    case = scenario.cases["case_1"]
    (arm,) = case.robots
    beside = case.robots[arm].model_copy(update={"ante_velocity": (-0.12, -0.48, 0.05)})
    oblique = scenario.model_copy(update={"cases": {"case_1": case.model_copy(update={"robots": {arm: beside}})}})
    trial = TrialSpec.of(oblique, "juice", "case_1")
    measured = MeasuredRun.of(replace(simulated(trial, trial.scene.physics, "bullet"), spec=None))
    assert 0.2 < obliqueness(measured) < 0.3
    found = jumps_of(runs_of(measured))
    assert abs(found.errors["reduced"]) < 0.8
    assert found.errors["reduced"] < found.errors["rotor"]


def test_of_two_arms_all_is_seen_that_is_seen_of_the_same_trial_of_our_own(tmp_path: Path, mixed_trial: Path) -> None:
    ours = read_trial(mixed_trial)
    runs = read_laboratory_runs(tmp_path, load_experiment(write_experiment(tmp_path, mixed_trial)), map)
    assert runs.clock == pytest.approx(5e-4)  # half a sampling period of 1 ms
    (theirs,) = runs.runs
    assert isinstance(ours, MeasuredRun)
    assert theirs.features == ours.features
    assert theirs.impacts == pytest.approx(ours.impacts)
    limits = np.array([feature.relevance_limit for feature in ours.features])  # a window may end a sample later
    assert np.max(np.abs(theirs.measured - ours.measured) / limits) < 1.0
    with pytest.raises(InputError, match="the jump is analysed for a single arm"):
        jumps_of(runs)


# ---- Folders of trials, read for a diagnosis


def test_runs_that_the_twin_made_are_remarked_once(push_campaign: Path, tmp_path: Path) -> None:
    manifest = make_manifest("push", ["cat_food"], ["2"], [0.9], trials=1, plant="twin")
    run_one(tmp_path, manifest.trial(manifest.keys[0]))
    (made,), one = tmp_path.iterdir(), next(push_campaign.glob("cat_food*1.200*"))
    shutil.copytree(made, tmp_path / "again" / made.name)
    shutil.copytree(one, tmp_path / one.name)
    runs = read_runs(tmp_path, map)
    assert len(runs.runs) == 3 and runs.remarks == (OF_THE_TWIN,)


def test_runs_since_one_of_them_are_those_recorded_later_and_another_set_of_measurements(
    hidden_campaign: Path, tmp_path: Path
) -> None:
    """In the order in which they were recorded, not in that of their names."""
    folder = tmp_path / "runs"
    shutil.copytree(hidden_campaign, folder)
    order = [f"{name}__r{repeat}" for name in ("push/juice__case_1__s1.000", "push/parcel__case_1__s1.000")
             for repeat in (1, 0)]  # fmt: skip
    for number, name in enumerate(order):
        os.utime(folder / name, (1e9 + number, 1e9 + number))
    for name in ("excite/none__fast__s1.000__r0", "excite/none__fast__s1.000__r1"):
        os.utime(folder / name, (9e8, 9e8))
    runs = read_runs(folder, map)
    later = runs.since("push/juice__case_1__s1.000__r0")
    assert sorted(run.name for run in later.runs) == [
        "juice__case_1__s1.000__r0",
        "parcel__case_1__s1.000__r0",
        "parcel__case_1__s1.000__r1",
    ]
    assert later.remarks[-1] == "only runs since push/juice__case_1__s1.000__r0: 3 of 6"
    assert later.digest != runs.digest == runs.since("excite/none__fast__s1.000__r0").digest
    with pytest.raises(InputError, match="nothing was measured since then"):
        runs.since("2002-01-01")
