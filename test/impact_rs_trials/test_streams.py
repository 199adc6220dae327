# SPDX-License-Identifier: Apache-2.0
"""A burst of samples becomes, byte for byte, the messages that it stands for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from trials import plan_of, ticks_of

from impact_rs_control.plan import TrialPlan
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.bags.streams import Stream, StreamMaker
from impact_rs_trials.bags.types import typestore

STORE = typestore()


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    timing = {"nominal_impact": 0.02, "approach": 0.02, "window_before": 0.01, "window_after": 0.01, "duration": 0.03}
    return plan_of("push", "juice", "case_1", **timing)


@pytest.fixture(scope="module")
def samples(plan: TrialPlan) -> list[tuple[int, Any, Any, Any]]:
    """Tick, measurement, truth and command of every tick."""
    return [
        (tick.number, tick.measurement.arms["arm"], truth.arms["arm"], tick.commands["arm"])
        for tick, truth in ticks_of(plan)
    ]


Case = tuple[str, Callable[[StreamMaker], Stream], Callable[[MessageMaker, int, tuple], Any], int]
CASES: dict[str, Case] = {
    "joint states": (
        topics.JOINT_STATE, lambda m: m.joint_states("arm"), lambda m, t, s: m.joint_states(t, "arm", s), 1
    ),
    "motor states": (
        topics.JOINT_STATE, lambda m: m.motor_states("arm"), lambda m, t, s: m.motor_states(t, "arm", s), 1
    ),
    "true states": (
        topics.JOINT_STATE, lambda m: m.joint_states("arm"), lambda m, t, s: m.joint_states(t, "arm", s), 2
    ),
    "contact wrench": (
        topics.WRENCH, lambda m: m.contact_wrench("arm"), lambda m, t, s: m.truth_contact_wrench(t, s), 2
    ),
    "joint command": (
        topics.JOINT_STATE, lambda m: m.joint_command("arm"), lambda m, t, s: m.joint_command(t, "arm", s.torque), 3
    ),
    "controller state": (
        topics.CONTROLLER_STATE,
        lambda m: m.controller_state("arm"),
        lambda m, t, s: m.controller_state(t, "arm", s),
        3,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_burst_is_what_the_messages_one_by_one_would_be(plan: TrialPlan, samples: list, name: str) -> None:
    kind, make, message, which = CASES[name]
    stream, maker = make(StreamMaker(plan)), MessageMaker(RosbagsTypes(), plan)
    for entry in samples:
        stream.add(entry[0], entry[which])
    expected = [bytes(STORE.serialize_cdr(message(maker, entry[0], entry[which]), kind)) for entry in samples]
    assert stream.take() == ([maker.nanoseconds(entry[0]) for entry in samples], expected)
    assert stream.take() == ([], [])


def test_a_sample_that_is_awaited_is_the_same_as_in_a_burst(plan: TrialPlan, samples: list) -> None:
    stream = StreamMaker(plan).joint_states("arm")
    for tick, measured, _, _ in samples[:3]:
        stream.add(tick, measured)
    assert stream.take()[1] == [stream.one(tick, measured) for tick, measured, _, _ in samples[:3]]


def test_a_sample_kept_after_a_burst_belongs_to_the_next(plan: TrialPlan, samples: list) -> None:
    stream = StreamMaker(plan).joint_command("arm")
    (first, *_, one), (second, *_, other) = samples[0], samples[1]
    stream.add(first, one)
    stream.take()
    stream.add(second, other)
    _, (row,) = stream.take()
    np.testing.assert_array_equal(STORE.deserialize_cdr(row, topics.JOINT_STATE).effort, other.torque)
