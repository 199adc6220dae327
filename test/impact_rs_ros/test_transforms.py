# SPDX-License-Identifier: Apache-2.0
"""Transforms made from recorded messages are those that the plant would have published."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_control.closed_loop import make_plant
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_ros.transforms import Transforms
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.bags.record import FrameSource
from impact_rs_trials.bags.types import typestore

STORE = typestore()
TICKS = 50


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    return plan_trial(Scene.resolve(load_scenario("push"), "juice", "case_1"))


@pytest.fixture(scope="module")
def recorded(plan: TrialPlan) -> tuple[list[tuple[str, int, bytes]], dict[int, bytes]]:
    """Messages of the plant with their stamps [ns], and the transforms by stamp."""
    maker, frames, plant = MessageMaker(RosbagsTypes(), plan), FrameSource(plan.scene), make_plant(plan, 0)
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
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
            expected[now] = bytes(STORE.serialize_cdr(sent, topics.TF_MESSAGE))
        plant.step({"arm": hold})
    plant.close()
    return messages, expected


@pytest.mark.parametrize("order", ["as sent", "object first", "shuffled"])
def test_transforms_follow_from_the_messages_in_whatever_order_they_come(
    plan: TrialPlan, recorded: tuple[list, dict], order: str
) -> None:
    messages, expected = recorded
    if order == "object first":
        messages = sorted(messages, key=lambda message: (message[1], message[0] != topics.OBJECT_POSE))
    if order == "shuffled":
        messages = [messages[index] for index in np.random.default_rng(0).permutation(len(messages))]
        messages.sort(key=lambda message: message[1])
    transforms = Transforms(plan)
    found = dict(pair for message in messages for pair in transforms.receive(*message))
    assert found == expected
    assert len(found) == 3


def test_other_topics_change_nothing(plan: TrialPlan) -> None:
    assert list(Transforms(plan).receive(topics.CLOCK, 0, b"")) == []
