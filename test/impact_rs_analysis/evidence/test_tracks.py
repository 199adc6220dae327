# SPDX-License-Identifier: Apache-2.0
"""Tracks show what was measured: every signal once, on one clock, forces and velocities as the plant knows them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from trials import plan_of, recorded

from impact_rs_analysis.evidence import tracks
from impact_rs_analysis.evidence.replays.impacts import observe
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.replays.simulated_trials import simulated
from impact_rs_analysis.evidence.tracks import (
    OBJECT,
    ComparedSignal,
    Track,
    TrackSide,
    track_of_bag,
    track_of_recording,
    track_of_run,
)
from impact_rs_sim.model import load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.runs import ArmSignals, Run, Signals
from impact_rs_trials.spec import TrialSpec

from .conftest import with_signals


@pytest.fixture(scope="module")
def bag(push_campaign: Path) -> TrialBag:
    return TrialBag.open(push_campaign / "cat_food__case_2__s1.000__r0")


@pytest.fixture(scope="module")
def track(bag: TrialBag) -> Track:
    return track_of_bag(bag)


@pytest.fixture(scope="module")
def beside(measured_hit: MeasuredRun) -> Track:
    """A push without noise beside the model that made it."""
    return track_of_run(measured_hit, load_model("nominal"))


def seen(track: Track) -> TrackSide:
    """What was measured."""
    assert track.measured is not None
    return track.measured


def curves_of(track: Track) -> dict[str, ComparedSignal]:
    found = {curve.name: curve for curve in track.curves}
    assert len(found) == len(track.curves)
    return found


def test_label_and_impact_are_those_of_the_run(
    beside: Track, measured_free: MeasuredRun, measured_hit: MeasuredRun
) -> None:
    there = track_of_run(measured_free, load_model("nominal"))
    assert (beside.label, there.label) == ("juice, case_2", "none, fast")
    assert beside.impact == pytest.approx(min(measured_hit.impacts.values()))
    assert "object yaw" in curves_of(beside) and "object yaw" not in curves_of(there)
    assert (there.impact, seen(there).jumps) == (None, ())  # free motion has neither impact nor object
    assert np.isnan(seen(there).object).all()


def test_condition_of_another_laboratory_has_no_scenario_in_its_label(measured_hit: MeasuredRun) -> None:
    run = replace(measured_hit, condition="juice/pose_a/fast")
    assert track_of_run(run, load_model("nominal")).label == "juice, pose_a, fast"


def test_curves_have_their_column_unit_and_side(beside: Track) -> None:
    curves = curves_of(beside)
    assert len(curves) == 3 + 7 + 7 + 6
    assert beside.curves[0].name == "end-effector velocity y"  # the direction of motion comes first
    assert beside.predicted is not None
    measured, predicted = seen(beside).arms["arm"], beside.predicted.arms["arm"]
    for name, unit, signal, column in (
        ("end-effector velocity y", "m/s", "twist", 1),
        ("end-effector velocity x", "m/s", "twist", 0),
        ("torque of joint 6", "N m", "torque", 5),
        ("velocity of joint 1", "rad/s", "velocity", 0),
    ):
        assert curves[name].unit == unit
        assert np.array_equal(curves[name].measured, getattr(measured, signal)[:, column])
        assert np.array_equal(curves[name].predicted, getattr(predicted, signal)[:, column])


def test_object_velocity_is_the_slope_of_its_position_within_a_window(beside: Track) -> None:
    curve, place = curves_of(beside)["object velocity y"], seen(beside).object[:, 1]
    for start, end in zip(beside.starts, (*beside.starts[1:], beside.time.size), strict=True):
        moved = np.trapezoid(curve.measured[start:end], beside.time[start:end])
        assert moved == pytest.approx(place[end - 1] - place[start], abs=1e-4)
    assert curves_of(beside)["object yaw rate"].unit == "rad/s"


def test_two_arms_are_named_in_their_curves() -> None:
    plan = TrialSpec.of(load_scenario("grab"), "juice", "case_1")
    grabbed = track_of_run(MeasuredRun.of(simulated(plan, plan.scene.physics, "bullet")), load_model("nominal"))
    assert {"left: torque of joint 1", "right: torque of joint 1"} <= set(curves_of(grabbed))


def test_a_trial_is_shown_where_all_of_its_arms_were_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills an arm that stands still after its last state."""
    recorded(plan_of("grab", "juice", "case_1"), tmp_path / "grab")
    bag, read = TrialBag.open(tmp_path / "grab"), tracks._joint_states

    def cut(bag: TrialBag, arm: str) -> tuple[np.ndarray, ArmSignals]:
        time, signals = read(bag, arm)
        rows = np.arange(time.size)
        kept = (rows >= 100) & (rows < time.size - 200) if arm == "right" else rows >= 0
        return time[kept], signals.at(kept)

    whole = track_of_bag(bag)
    monkeypatch.setattr(tracks, "_joint_states", cut)
    shown = track_of_bag(bag)
    np.testing.assert_array_equal(shown.time, whole.time[100:-200])
    np.testing.assert_array_equal(seen(shown).arms["left"].position, seen(whole).arms["left"].position[100:-200])


def test_recorded_run_looks_like_the_trial_it_is(bag: TrialBag, track: Track) -> None:
    shown = track_of_recording(bag.run())
    for name in ("position", "velocity", "force", "twist"):
        np.testing.assert_allclose(getattr(seen(shown).arms["arm"], name), getattr(seen(track).arms["arm"], name))
    np.testing.assert_allclose(seen(shown).object, seen(track).object)
    assert (shown.starts, shown.predicted) == ((0,), None)
    assert shown.impact == pytest.approx(track.impact, abs=0.003)
    assert [jump.body for jump in seen(shown).jumps] == ["arm", OBJECT]


def test_nothing_is_shown_within_gaps(bag: TrialBag) -> None:
    shown = track_of_recording(replace(bag.run(), gaps=((0.2, 0.3), (1.5, 1.55))))
    assert not np.any((shown.time > 0.2005) & (shown.time < 0.2995))
    assert shown.time[list(shown.starts)] == pytest.approx([0.0, 0.3, 1.55])
    arm = seen(shown).arms["arm"]
    assert len(arm.position) == len(arm.force) == shown.time.size


def test_run_without_impact_or_tracking_is_shown_all_the_same(bag: TrialBag) -> None:
    run = bag.run()
    still = with_signals(run, lambda arm: replace(arm, velocity=0.0 * arm.velocity))
    assert track_of_recording(still).impact is None
    shown = seen(track_of_recording(replace(run, signals=Signals(run.signals.time, run.signals.arms))))
    assert np.isnan(shown.object).all()
    assert [jump.body for jump in shown.jumps] == ["arm"]


def test_force_on_the_object_is_that_of_the_plant(bag: TrialBag, track: Track) -> None:
    """Its impulse over the impact and the push, along the motion; the truth has the force on the pad."""
    known = [message.wrench.force.y for message in bag.messages(topics.truth_contact_wrench("arm"))]
    assert track.impact is not None
    rows = (track.time > track.impact - 0.02) & (track.time < track.impact + 0.1)
    total = seen(track).arms["arm"].force[rows, 1].sum()
    assert total == pytest.approx(-np.sum(np.array(known)[rows]), rel=0.1)
    assert total < 0.0  # the arm pushes along -y


def test_jumps_are_velocities_before_and_after_the_impact(bag: TrialBag, track: Track) -> None:
    assert track.impact is not None
    arm, hit = seen(track).jumps
    assert (arm.body, hit.body) == ("arm", OBJECT)
    assert arm.before[1] == pytest.approx(bag.info.ante_velocity, rel=0.01)
    assert np.abs(hit.before).max() < 0.02
    twists = bag.messages(topics.TRUTH_OBJECT_TWIST)
    stamps = np.array([message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in twists])
    rows = (stamps > track.impact + 0.006) & (stamps < track.impact + 0.04)
    known = np.mean([twists[row].twist.linear.y for row in np.flatnonzero(rows)])
    assert hit.after[1] == pytest.approx(known, abs=0.02)
    assert arm.before[1] < arm.after[1] < 0.0


@pytest.fixture
def without(bag: TrialBag, tmp_path: Path, rewrite_bag: Callable) -> Callable[[str], TrialBag]:
    """The bag without topics that begin so."""

    def write(topic: str) -> TrialBag:
        rewrite_bag(bag.path, tmp_path / bag.path.name, lambda one: not one.startswith(topic))
        return TrialBag.open(tmp_path / bag.path.name)

    return write


def test_truth_is_not_read(track: Track, without: Callable[[str], TrialBag]) -> None:
    found = seen(track_of_bag(without(topics.TRUTH)))
    assert np.array_equal(found.object, seen(track).object)
    assert np.array_equal(found.arms["arm"].force, seen(track).arms["arm"].force)


def test_untracked_object_is_not_shown(without: Callable[[str], TrialBag]) -> None:
    found = seen(track_of_bag(without(topics.OBJECT_POSE)))
    assert np.isnan(found.object).all()
    assert [jump.body for jump in found.jumps] == ["arm"]


def test_object_is_where_and_turned_as_it_was_tracked(bag: TrialBag, track: Track) -> None:
    tracked = bag.poses(topics.OBJECT_POSE)
    shown = seen(track).object[np.searchsorted(track.time, tracked.time - 1e-9)]
    assert shown[:, :3] == pytest.approx(tracked.position, abs=1e-9)
    same = np.abs(np.sum(shown[:, 3:] * tracked.quaternion, axis=1))  # q and -q are one orientation
    assert same == pytest.approx(1.0, abs=1e-9)


def test_bag_without_joint_states_is_refused_by_topic(without: Callable[[str], TrialBag]) -> None:
    with pytest.raises(BagError, match="/arm/joint_states has no joint positions"):
        track_of_bag(without("/arm/joint_states"))


def test_positions_alone_show_the_motion_alone(bag: TrialBag, tmp_path: Path) -> None:
    store = typestore()
    with Reader(bag.path) as reader, Writer(tmp_path / "b", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kept = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for connection, moment, data in reader.messages():
            if connection.topic == "/arm/joint_states":
                message = store.deserialize_cdr(data, connection.msgtype)
                message.velocity = message.effort = np.zeros(0)
                data = store.serialize_cdr(message, connection.msgtype)
            writer.write(kept[connection.topic], moment, data)
    found = seen(track_of_bag(TrialBag.open(tmp_path / "b")))
    arm = found.arms["arm"]
    assert arm.position.shape[1] == 7
    assert (arm.velocity.size, arm.twist.size, arm.force.size) == (0, 0, 0)
    assert [jump.body for jump in found.jumps] == [OBJECT]


def test_model_that_made_a_run_moves_as_the_run(beside: Track) -> None:
    measured, model = seen(beside), beside.predicted
    assert model is not None
    assert model.arms["arm"].position == pytest.approx(measured.arms["arm"].position, abs=2e-3)
    assert model.object[:, :3] == pytest.approx(measured.object[:, :3], abs=5e-3)
    for mine, theirs in zip(model.jumps, measured.jumps, strict=True):
        assert mine.after == pytest.approx(theirs.after, abs=0.02)


def test_object_rests_where_it_will_be_hit_before_the_impact(beside: Track) -> None:
    place = seen(beside).object
    assert place[0] == pytest.approx(place[beside.starts[-1]], abs=1e-3)
    assert np.isfinite(place).all()


def test_force_of_a_slow_recording_stays_bounded(hit: Run) -> None:
    """At 100 Hz an observer with the gain for 1 kHz would grow without bound."""
    arm, rows = hit.signals.arms["arm"], slice(None, None, 10)
    signals = [values[rows] for values in (hit.signals.time, arm.position, arm.velocity, arm.torque)]
    force = observe(*signals, hit.physics.robot_model("arm")).force
    assert np.abs(force).max() < 300.0  # N
