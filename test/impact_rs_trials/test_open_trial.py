# SPDX-License-Identifier: Apache-2.0
"""A bag is OK only if it reaches the end of its own trial, and holds nothing that is no message of it."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, Writer
from sensor_msgs.msg import JointState

from impact_rs_sim.errors import InputError
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.derived import DERIVED
from impact_rs_trials.bags.open_trial import OpenTrial
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.bags.writer import BagWriter, partial_path

END = 1.8  # s
STATES, COMMANDS, CONTROLLER = topics.joint_states("arm"), topics.joint_command("arm"), topics.controller_state("arm")
Messages = list[tuple[float, tuple[str, bytes]]]  # trial times [s], topics and bytes
Begin = Callable[..., OpenTrial]


@pytest.fixture(scope="module")
def messages(push_campaign: Path) -> Messages:
    """What a recorder receives in a whole trial, with trial times [s]."""
    bag = push_campaign / "cat_food__case_2__s1.000__r0"
    left_out = {*topics.latched(["arm"]), *DERIVED}
    with Reader(bag) as reader:
        return [(1e-9 * at, (c.topic, bytes(data))) for c, at, data in reader.messages() if c.topic not in left_out]


@pytest.fixture
def opened(push_campaign: Path, tmp_path: Path) -> Iterator[Begin]:
    """Begins to record that trial; one of somebody else has no plan."""
    whole = TrialBag.open(push_campaign / "cat_food__case_2__s1.000__r0")
    info, (identity,) = whole.info, whole.serialized(topics.TRIAL_INFO)
    bags: list[BagWriter] = []

    def begin(ours: bool = True, ros_time: bool = False) -> OpenTrial:
        bags.append(BagWriter.create(tmp_path / str(len(bags)), ["arm"], origin_ns=None if ros_time else 0))
        plan = info.spec.plan if ours else None
        bags[-1].write_raw(topics.TRIAL_INFO, 0, identity)
        return OpenTrial("push/it", bags[-1], ["arm"], info.duration, plan, ["object"], ros_time)

    yield begin
    for bag in bags:
        bag.__exit__(None, None, None)


def joints(seconds: int, count: int = 7) -> bytes:
    """A well-formed message, stamped ``seconds`` [s]."""
    values = [0.0] * count
    message = JointState(name=["a"] * 7, position=values, velocity=values, effort=values)
    message.header.stamp.sec = seconds
    return bytes(serialize_message(message))


def stored(trial: OpenTrial, messages: Messages, until: float = END, but: str = "") -> OpenTrial:
    for at, message in messages:
        if at <= until + 1e-6 or (but and message[0] != but):
            trial.store(*message)
    return trial


@pytest.mark.parametrize("ours", [True, False])
def test_a_trial_that_was_recorded_to_its_end_is_ok(opened: Begin, messages: Messages, ours: bool) -> None:
    trial = stored(opened(ours), messages)
    assert trial.verdict().outcome == "OK"
    assert trial.note() == ""
    came = Counter(topic for _, (topic, _) in messages)
    assert {topic: trial.counts[topic] for topic in came} == came


@pytest.mark.parametrize("ours", [True, False])
@pytest.mark.parametrize("until", [0.0, 0.001, 0.5, 1.2, END - 0.002])
def test_a_trial_that_is_cut_off_is_never_ok(opened: Begin, messages: Messages, ours: bool, until: float) -> None:
    verdict = stored(opened(ours), messages, until).verdict()
    assert verdict.outcome == "ABORTED"
    assert verdict.reason == (
        f"{STATES} ends at {until:.3f} s, {CONTROLLER} ends at {until:.3f} s; the trial ends at 1.800 s"
    )


@pytest.mark.parametrize("topic", [STATES, CONTROLLER])
def test_every_signal_that_is_judged_reaches_the_end(opened: Begin, messages: Messages, topic: str) -> None:
    verdict = stored(opened(), messages, END - 0.001, but=topic).verdict()
    assert verdict.outcome == "ABORTED"
    assert verdict.reason == f"{topic} ends at 1.799 s; the trial ends at 1.800 s"


def test_a_trial_without_any_message_is_aborted(opened: Begin) -> None:
    assert opened(False).verdict().outcome == "ABORTED"


def test_what_is_no_message_of_the_trial_is_not_in_the_bag_and_counted(opened: Begin, messages: Messages) -> None:
    trial = opened()
    before = trial.bag.messages  # frames that do not move are there from the beginning
    trial.store(STATES, b"\0\1\0\0abc")
    for topic in topics.recorded(["arm"]):
        if topic not in DERIVED:
            trial.store(topic, b"")
    assert trial.bag.messages == before
    trial.store(COMMANDS, joints(0))
    trial.store(STATES, joints(-1))
    trial.store(COMMANDS, joints(1_700_000_000))
    assert trial.bag.messages == before + 1
    assert trial.refused[STATES] == 3
    assert trial.refused[COMMANDS] == 2
    stored(trial, messages)
    assert trial.verdict().outcome == "OK"
    assert f"{STATES} 3" in trial.note()
    assert trial.note().startswith(f"{trial.refused.total()} messages are not in the bag, unreadable or not of this")


def test_messages_of_an_abandoned_trial_are_not_in_the_next_bag(opened: Begin, messages: Messages) -> None:
    trial = opened()
    before = trial.bag.messages
    for at, (topic, data) in messages:
        if at > 1.0 and topic in (STATES, COMMANDS, CONTROLLER):
            trial.store(topic, data)
    assert trial.bag.messages == before
    stored(trial, messages)
    assert (trial.verdict().outcome, trial.note()) == ("OK", "")
    assert trial.counts[STATES] == 1801


def restamped(data: bytes, by: int) -> bytes:
    """A message with a header whose stamp is ``by`` [ns] later."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return data[:4] + struct.pack("<iI", *divmod(seconds * 10**9 + nanoseconds + by, 10**9)) + data[12:]


@pytest.mark.parametrize("origin", [1, 1_700_000_000_123_456_789])
def test_a_trial_has_the_same_numbers_whenever_it_began(
    opened: Begin, messages: Messages, push_campaign: Path, origin: int
) -> None:
    """In seconds since 1970 as a double the times would be off by up to 0.12 us."""
    trial = opened(ros_time=True)
    trial.store(topics.OBJECT_POSE, restamped(messages[0][1][1], origin - 1))  # of a tracker, before the trial
    for _, (topic, data) in messages:
        trial.store(topic, restamped(data, origin))
    trial.complete()
    assert trial.verdict().outcome == "OK"
    assert trial.time == pytest.approx(END)
    trial.bag.finish("OK")
    with Reader(trial.bag.path) as reader:
        assert {time - origin for _, time, _ in reader.messages()} >= {0, 1_000_000, 1_800_000_000}
        assert reader.start_time == origin
    plain, later = TrialBag.open(push_campaign / "cat_food__case_2__s1.000__r0"), TrialBag.open(trial.bag.path)
    assert (plain.origin_ns, later.origin_ns) == (0, origin)
    for topic in (STATES, COMMANDS, topics.motor_states("arm"), topics.truth_joint_states("arm")):
        for mine, other in zip(vars(plain.joints(topic)).values(), vars(later.joints(topic)).values(), strict=True):
            np.testing.assert_array_equal(mine, other)
    for name, values in vars(plain.controller("arm")).items():
        np.testing.assert_array_equal(values, getattr(later.controller("arm"), name))
    np.testing.assert_array_equal(plain.run().signals.time, later.run().signals.time)
    (frame,) = later.messages(topics.TF)[1].transforms[:1]
    assert frame.header.stamp.sec * 10**9 + frame.header.stamp.nanosec - origin == 20_000_000


def test_a_trial_in_ros_time_aligns_with_another_recording_of_the_robot(
    opened: Begin, messages: Messages, tmp_path: Path
) -> None:
    """Merged by time, as ``ros2 bag convert`` does, every state stands beside the robot's own of the same moment."""
    origin, store = 1_700_000_000_123_456_789, typestore()
    trial = opened(ros_time=True)
    for _, (topic, data) in messages:
        trial.store(topic, restamped(data, origin))
    trial.bag.finish("OK")
    states = [data for _, (topic, data) in messages if topic == STATES]
    with Writer(tmp_path / "robot", version=9) as writer:  # recorded by another program, 0.2 ms after each state
        connection = writer.add_connection("/joint_states", topics.JOINT_STATE, typestore=store)
        for data in states:
            stamp = restamped(data, origin)
            seconds, nanoseconds = struct.unpack_from("<iI", stamp, 4)
            writer.write(connection, seconds * 10**9 + nanoseconds + 200_000, stamp)
    with AnyReader([trial.bag.path, tmp_path / "robot"], default_typestore=store) as reader:
        merged = [
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
            if connection.topic in (STATES, "/joint_states")
        ]
    assert [topic for topic, _ in merged] == [STATES, "/joint_states"] * len(states)
    for (_, ours), (_, robots) in zip(merged[::2], merged[1::2], strict=True):
        assert ours.header.stamp == robots.header.stamp
        np.testing.assert_array_equal(ours.position, robots.position)


def test_a_trial_in_ros_time_that_was_cut_off_is_read_in_trial_time(opened: Begin, messages: Messages) -> None:
    origin = 1_700_000_000_123_456_789
    trial = opened(ros_time=True)
    for at, (topic, data) in messages:
        if at < 0.5:
            trial.store(topic, restamped(data, origin))
    trial.bag.save()
    found = TrialBag.open(partial_path(trial.bag.path))
    assert found.origin_ns == origin
    assert found.reason.startswith("the recording was cut off at t = 0.499 s")
    np.testing.assert_array_equal(found.joints(STATES).time, [1e-9 * (1_000_000 * tick) for tick in range(500)])


def test_a_message_with_too_many_joints_is_recorded_and_nothing_judged(opened: Begin, messages: Messages) -> None:
    trial = opened()
    trial.store(STATES, joints(0, 8_000))  # 200 kB
    assert trial.counts[STATES] == 1
    assert trial.counts[topics.TF] == 0
    stored(trial, messages)
    with pytest.raises(InputError, match="/arm/joint_states has messages of different lengths: who else publishes"):
        trial.verdict()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50)
@given(data=st.data())
def test_whatever_comes_on_whatever_topic_is_stored_or_counted(
    opened: Begin, messages: Messages, data: st.DataObject
) -> None:
    trial = opened()
    topic, whole = messages[data.draw(st.integers(0, len(messages) - 1))][1]
    if data.draw(st.booleans()):
        trial.store(topic, whole)  # its layout is known then
        whole = whole[:4] + struct.pack("<i", 1) + whole[8:]  # another stamp
    changed = bytearray(whole)
    for bit in data.draw(st.lists(st.integers(0, 8 * len(whole) - 1), max_size=6)):
        changed[bit // 8] ^= 1 << bit % 8
    before, sent = trial.counts[topic] + trial.refused[topic], bytes(changed)
    trial.store(topic, sent[: data.draw(st.integers(0, len(sent)))])
    assert trial.counts[topic] + trial.refused[topic] - before in (0, 1)  # 0: it has the stamp of the last one


class Bag:
    """Remembers what is written, and when [ns]."""

    def __init__(self) -> None:
        self.written: list[tuple[str, int]] = []

    def write_raw(self, topic: str, nanoseconds: int, data: bytes) -> None:
        self.written.append((topic, nanoseconds))


def test_diagnostics_are_stored_at_the_trial_time_of_the_newest_signal() -> None:
    values = [0.0] * 7
    state = JointState(name=["a"] * 7, position=values, velocity=values, effort=values)
    bag, told = Bag(), DiagnosticArray()
    trial = OpenTrial("push/one", bag, ["arm"], 1.8, None, tracked=["object"])  # type: ignore[arg-type]
    state.header.stamp.nanosec = 200_000_000
    told.header.stamp.sec = 1_790_000_000
    for topic, message in (
        (topics.DIAGNOSTICS, told),
        (topics.joint_states("arm"), state),
        (topics.DIAGNOSTICS, told),
    ):
        trial.store(topic, bytes(serialize_message(message)))
    assert bag.written == [
        (topics.DIAGNOSTICS, 0),
        (topics.joint_states("arm"), 200_000_000),
        (topics.DIAGNOSTICS, 200_000_000),
    ]
    assert trial.time == 0.2
