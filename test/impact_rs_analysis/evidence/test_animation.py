# SPDX-License-Identifier: Apache-2.0
"""What is seen in 3D is what was measured: forces and velocities agree with what the plant knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.evidence.aligned import align
from impact_rs_analysis.evidence.animation import (
    OBJECT,
    Animation,
    animation_of_bag,
    animation_of_laboratory,
    animation_of_run,
)
from impact_rs_analysis.evidence.impacts import observe
from impact_rs_analysis.evidence.measured import MeasuredRun
from impact_rs_analysis.evidence.run import Run
from impact_rs_sim.model import load_model
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.recordings.clock import Gap
from impact_rs_trials.recordings.laboratory import LaboratoryArm, LaboratoryRun


@pytest.fixture(scope="module")
def bag(push_campaign: Path) -> TrialBag:
    return TrialBag.open(push_campaign / "cat_food__case_2__s1.000__r0")


@pytest.fixture(scope="module")
def animation(bag: TrialBag) -> Animation:
    return animation_of_bag(bag)


@pytest.fixture(scope="module")
def replayed(hit: Run) -> Animation:
    """A push without noise beside the model that made it."""
    return animation_of_run(align(MeasuredRun.of(hit), load_model("nominal")), "a push")


@pytest.fixture(scope="module")
def laboratory_run(bag: TrialBag) -> LaboratoryRun:
    """The same push, as a laboratory would have recorded it."""
    joints, seen = bag.joints(topics.joint_states("arm")), bag.poses(topics.OBJECT_POSE)
    none = np.zeros((0, 7))
    return LaboratoryRun(
        path=bag.path, name="run_1", object=bag.info.object, hit=True, condition="",
        time=joints.time,
        arms={"arm": LaboratoryArm(
            position=joints.position, velocity=joints.velocity, torque=joints.effort, motor_position=none,
            motor_velocity=none, command_time=np.zeros(0), command=none, wrench_time=np.zeros(0),
            wrench=np.zeros((0, 6)),
        )},
        object_time=seen.time, object_position=seen.position, object_quaternion=seen.quaternion,
        gaps=(), remarks=(),
    )  # fmt: skip


def test_a_run_of_a_laboratory_is_seen_as_our_own_trial_with_its_impact_from_joint_signals(
    bag: TrialBag, animation: Animation, laboratory_run: LaboratoryRun
) -> None:
    seen = animation_of_laboratory(laboratory_run, bag.info.spec.scenario)
    for name in ("joints", "rates", "forces", "velocities"):
        np.testing.assert_allclose(getattr(seen.measured, name)["arm"], getattr(animation.measured, name)["arm"])
    np.testing.assert_allclose(seen.measured.object, animation.measured.object)
    assert (seen.label, seen.starts, seen.model) == ("run_1", (0,), None)
    assert seen.impact == pytest.approx(animation.impact, abs=0.003)
    assert [jump.body for jump in seen.measured.jumps] == ["arm", OBJECT]


def test_nothing_is_seen_in_the_gaps_of_a_run(bag: TrialBag, laboratory_run: LaboratoryRun) -> None:
    torn = replace(laboratory_run, gaps=(Gap(0.2, 0.1), Gap(1.5, 0.05)))
    seen = animation_of_laboratory(torn, bag.info.spec.scenario)
    assert not np.any((seen.time > 0.2005) & (seen.time < 0.2995))
    assert seen.time[list(seen.starts)] == pytest.approx([0.0, 0.3, 1.55])
    assert seen.measured.joints["arm"].shape[0] == seen.measured.forces["arm"].shape[0] == seen.time.size


def test_a_run_that_hits_nothing_or_whose_object_nobody_tracked_is_seen_all_the_same(
    bag: TrialBag, laboratory_run: LaboratoryRun
) -> None:
    arm = laboratory_run.arms["arm"]
    still = replace(laboratory_run, arms={"arm": replace(arm, velocity=0.0 * arm.velocity)})
    assert animation_of_laboratory(still, bag.info.spec.scenario).impact is None
    empty = np.zeros(0)
    lost = replace(
        laboratory_run, object_time=empty, object_position=np.zeros((0, 3)), object_quaternion=np.zeros((0, 4))
    )
    seen = animation_of_laboratory(lost, bag.info.spec.scenario)
    assert np.isnan(seen.measured.object).all()
    assert [jump.body for jump in seen.measured.jumps] == ["arm"]


def test_the_force_is_that_on_the_object_as_the_plant_knows_it(bag: TrialBag, animation: Animation) -> None:
    """Its impulse over the impact and the push, along the motion; the plant tells the force on the pad."""
    known = [message.wrench.force.y for message in bag.messages(topics.truth_contact_wrench("arm"))]
    assert animation.impact is not None
    rows = (animation.time > animation.impact - 0.02) & (animation.time < animation.impact + 0.1)
    seen = animation.measured.forces["arm"][rows, 1]
    assert seen.sum() == pytest.approx(-np.sum(np.array(known)[rows]), rel=0.1)
    assert seen.sum() < 0.0  # the arm pushes along -y


def test_velocities_are_those_before_and_after_the_impact(bag: TrialBag, animation: Animation) -> None:
    arm, thing = animation.measured.jumps
    assert (arm.body, thing.body) == ("arm", OBJECT)
    assert arm.before[1] == pytest.approx(bag.info.ante_velocity, rel=0.01)
    assert np.abs(thing.before).max() < 0.02
    twists = bag.messages(topics.TRUTH_OBJECT_TWIST)
    stamps = np.array([message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in twists])
    rows = (stamps > animation.impact + 0.006) & (stamps < animation.impact + 0.04)
    known = np.mean([twists[row].twist.linear.y for row in np.flatnonzero(rows)])
    assert thing.after[1] == pytest.approx(known, abs=0.02)
    assert arm.before[1] < arm.after[1] < 0.0


def test_nothing_of_the_truth_is_looked_at(bag: TrialBag, animation: Animation, tmp_path: Path, rewrite_bag) -> None:
    rewrite_bag(bag.path, tmp_path / bag.path.name, lambda topic: not topic.startswith(topics.TRUTH))
    found = animation_of_bag(TrialBag.open(tmp_path / bag.path.name))
    assert np.array_equal(found.measured.object, animation.measured.object)
    assert np.array_equal(found.measured.forces["arm"], animation.measured.forces["arm"])


def test_an_object_that_nobody_tracked_is_not_seen(bag: TrialBag, tmp_path: Path, rewrite_bag: Callable) -> None:
    rewrite_bag(bag.path, tmp_path / "bag", lambda topic: topic != topics.OBJECT_POSE)
    found = animation_of_bag(TrialBag.open(tmp_path / "bag"))
    assert np.isnan(found.measured.object).all()
    assert [jump.body for jump in found.measured.jumps] == ["arm"]


def test_an_object_is_turned_as_it_was_tracked(bag: TrialBag, animation: Animation) -> None:
    seen = bag.poses(topics.OBJECT_POSE)
    rows = np.searchsorted(animation.time, seen.time - 1e-9)
    assert animation.measured.object[rows, :3] == pytest.approx(seen.position, abs=1e-9)
    same = np.abs(np.sum(animation.measured.object[rows, 3:] * seen.quaternion, axis=1))  # q and -q are one orientation
    assert same == pytest.approx(1.0, abs=1e-9)


def test_a_bag_without_joint_states_is_refused_by_their_name(bag: TrialBag, tmp_path: Path, rewrite_bag) -> None:
    rewrite_bag(bag.path, tmp_path / "bag", lambda topic: topic != "/arm/joint_states")
    with pytest.raises(BagError, match="/arm/joint_states has no joint positions"):
        animation_of_bag(TrialBag.open(tmp_path / "bag"))


def test_joint_states_without_velocities_show_the_motion_alone(bag: TrialBag, tmp_path: Path) -> None:
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer

    store = typestore()
    with Reader(bag.path) as reader, Writer(tmp_path / "b", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kept = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for connection, moment, data in reader.messages():
            if connection.topic == "/arm/joint_states":
                message = store.deserialize_cdr(data, connection.msgtype)
                message.velocity = message.effort = np.zeros(0)
                data = store.serialize_cdr(message, connection.msgtype)
            writer.write(kept[connection.topic], moment, data)
    found = animation_of_bag(TrialBag.open(tmp_path / "b")).measured
    assert found.joints["arm"].shape[1] == 7
    assert (found.rates, found.velocities, found.forces) == ({}, {}, {})
    assert [jump.body for jump in found.jumps] == [OBJECT]


def test_the_model_that_made_a_run_moves_as_the_run(replayed: Animation) -> None:
    measured, model = replayed.measured, replayed.model
    assert model is not None
    assert model.joints["arm"] == pytest.approx(measured.joints["arm"], abs=2e-3)
    assert model.object[:, :3] == pytest.approx(measured.object[:, :3], abs=5e-3)
    for mine, theirs in zip(model.jumps, measured.jumps, strict=True):
        assert mine.after == pytest.approx(theirs.after, abs=0.02)


def test_the_object_stands_where_it_will_be_hit_before_it_is(replayed: Animation) -> None:
    """In windows of free motion nobody looks at it."""
    contact = replayed.starts[-1]
    assert replayed.measured.object[0] == pytest.approx(replayed.measured.object[contact], abs=1e-3)
    assert np.isfinite(replayed.measured.object).all()


def test_a_free_motion_has_no_object_and_no_impact(free: Run) -> None:
    found = animation_of_run(align(MeasuredRun.of(free), load_model("nominal")), "there and back")
    assert found.impact is None
    assert np.isnan(found.measured.object).all()
    assert found.measured.jumps == ()


def test_the_force_of_a_slow_recording_stays_one(hit: Run) -> None:
    """At 100 Hz an observer with the gain for 1 kHz would grow without bound."""
    arm, rows = hit.signals.arms["arm"], slice(None, None, 10)
    signals = [values[rows] for values in (hit.signals.time, arm.position, arm.velocity, arm.torque)]
    force = observe(*signals, hit.physics.robot_model("arm")).force
    assert np.abs(force).max() < 300.0  # N
