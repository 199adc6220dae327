# SPDX-License-Identifier: Apache-2.0
"""Transforms and clock made from recorded messages are those that the plant would have published."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_control.closed_loop import make_plant
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.derived import DerivedMessages
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.spec import TrialSpec

STORE = typestore()
PLAN = TrialSpec.of(load_scenario("push"), "juice", "case_1").plan
Messages = list[tuple[str, int, bytes]]  # topics, stamps [ns], bytes
Recorded = tuple[Messages, dict[tuple[int, str], bytes]]  # and transforms and clock by stamp and topic
TICKS = 50


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """What the plant publishes."""
    maker, frames, plant = MessageMaker(RosbagsTypes(), PLAN), FrameSource(PLAN.scene), make_plant(PLAN, 0)
    hold = PLAN.scene.models["arm"].gravity_torque(PLAN.arms["arm"].initial)
    messages, expected = [], {}
    for tick in range(TICKS):
        measured, now = plant.measure(), maker.nanoseconds(tick)
        state = maker.joint_states(tick, "arm", measured.arms["arm"])
        messages.append((topics.joint_states("arm"), now, bytes(STORE.serialize_cdr(state, topics.JOINT_STATE))))
        if measured.object is not None:
            pose = maker.object_pose(tick, measured.object)
            messages.append((topics.OBJECT_POSE, now, bytes(STORE.serialize_cdr(pose, topics.POSE))))
        if frames.due(tick):
            sent = maker.transforms(tick, frames.frames(measured))
            expected[now, topics.TF] = bytes(STORE.serialize_cdr(sent, topics.TF_MESSAGE))
            expected[now, topics.CLOCK] = bytes(STORE.serialize_cdr(maker.clock(tick), topics.CLOCK_TYPE))
        plant.step({"arm": hold})
    plant.close()
    return messages, expected


def made_by(derived: DerivedMessages, messages: Messages) -> dict[tuple[int, str], bytes]:
    """What is worked out while these messages come, by time [ns] and topic."""
    return {(at, name): made for topic, now, data in messages for name, at, made in derived.receive(topic, now, data)}


@pytest.mark.parametrize("order", ["as sent", "object first", "shuffled"])
def test_transforms_and_clock_follow_from_messages_in_any_order(recorded: Recorded, order: str) -> None:
    messages, expected = recorded
    if order == "object first":
        messages = sorted(messages, key=lambda message: (message[1], message[0] != topics.OBJECT_POSE))
    if order == "shuffled":
        messages = [messages[index] for index in np.random.default_rng(0).permutation(len(messages))]
        messages.sort(key=lambda message: message[1])
    derived = DerivedMessages(PLAN)
    found = made_by(derived, messages)
    assert found == expected
    assert len(found) == 2 * 3


def test_the_frame_of_an_object_that_nobody_tracks_is_left_out(recorded: Recorded) -> None:
    messages, expected = recorded
    derived = DerivedMessages(PLAN, tracked=())
    found = made_by(derived, messages)
    assert list(found) == list(expected)
    for key in (key for key in found if key[1] == topics.TF):
        frames, whole = (
            [one.child_frame_id for one in STORE.deserialize_cdr(data, topics.TF_MESSAGE).transforms]
            for data in (found[key], expected[key])
        )
        assert frames == [name for name in whole if name != "object"]
        assert len(frames) == len(whole) - 1


def with_tracker_of_its_own(messages: list, poses: dict[float, float], late: float) -> Messages:
    """Joint states as they were, and poses with an x [m] by when they were taken [s], each so late [s]."""
    told = [(now, (topic, now, data)) for topic, now, data in messages if topic != topics.OBJECT_POSE]
    _, _, like = next(message for message in messages if message[0] == topics.OBJECT_POSE)
    for taken, x in poses.items():
        pose = STORE.deserialize_cdr(like, topics.POSE)
        pose.pose.position.x = x
        told.append(
            (
                round(1e9 * (taken + late)),
                (topics.OBJECT_POSE, round(1e9 * taken), bytes(STORE.serialize_cdr(pose, topics.POSE))),
            )
        )
    return [message for _, message in sorted(told, key=lambda one: one[0])]


def test_an_object_with_its_own_tracker_times_is_where_it_was_last_seen(recorded: Recorded) -> None:
    poses = {0.0035 + 0.0083 * number: 0.1 * number for number in range(5)}  # the last at 0.0367 s, before tick 40
    derived = DerivedMessages(PLAN)
    found = made_by(derived, with_tracker_of_its_own(recorded[0], poses, late=0.006))
    assert list(found) == [(now, topic) for now in (0, 20_000_000) for topic in (topics.TF, topics.CLOCK)]
    found |= {(at, name): made for name, at, made in derived.remaining()}
    assert list(found) == list(recorded[1])
    seen = {
        now: one.transform.translation.x
        for (now, name), made in found.items()
        if name == topics.TF
        for one in STORE.deserialize_cdr(made, topics.TF_MESSAGE).transforms
        if one.child_frame_id == "object"
    }
    assert seen == {0: PLAN.scene.object.position[0], 20_000_000: pytest.approx(0.1), 40_000_000: pytest.approx(0.4)}


def test_an_object_that_was_never_seen_has_no_frame(recorded: Recorded) -> None:
    derived = DerivedMessages(PLAN)
    assert made_by(derived, with_tracker_of_its_own(recorded[0], {}, late=0.0)) == {}
    untracked = DerivedMessages(PLAN, tracked=())
    expected = made_by(untracked, recorded[0])
    assert {(at, name): made for name, at, made in derived.remaining()} == expected


def test_other_topics_change_nothing() -> None:
    assert list(DerivedMessages(PLAN).receive(topics.CLOCK, 0, b"")) == []


def test_joints_in_another_order_give_the_same_frames_and_wrong_ones_none(recorded: Recorded) -> None:
    def turned(data: bytes) -> bytes:
        state = STORE.deserialize_cdr(data, topics.JOINT_STATE)
        for field in ("name", "position", "velocity", "effort"):
            setattr(state, field, getattr(state, field)[::-1].copy())
        return bytes(STORE.serialize_cdr(state, topics.JOINT_STATE))

    messages = [(topic, now, data if topic == topics.OBJECT_POSE else turned(data)) for topic, now, data in recorded[0]]
    assert made_by(DerivedMessages(PLAN), messages) == recorded[1]
    broken = [(topic, now, data if topic == topics.OBJECT_POSE else data[:-8]) for topic, now, data in messages]
    assert made_by(DerivedMessages(PLAN), broken) == {}
