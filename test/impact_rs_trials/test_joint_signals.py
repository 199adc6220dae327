# SPDX-License-Identifier: Apache-2.0
"""What comes in is put into the order of the joints, or told to be useless; nothing else gets through."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impact_rs_trials.bags.joint_signals import MAX_JOINTS, JointReader, joint_signals, names_of

NAMES = ["arm_joint1", "arm_joint22", "arm_joint3", "x"]
VALUES = {"position": [1.0, 2.0, 3.0, 4.0], "velocity": [5.0, 6.0, 7.0, 8.0], "effort": [9.0, 10.0, 11.0, 12.0]}


def sent(names: list[str] = NAMES, **changes: list[float]) -> bytes:
    return bytes(serialize_message(JointState(name=names, **VALUES | changes)))


@given(st.permutations(range(4)))
def test_values_come_in_the_order_of_the_joints_whatever_the_message_has(order: list[int]) -> None:
    reader = JointReader(NAMES)
    shuffled = {field: [values[number] for number in order] for field, values in VALUES.items()}
    for _ in range(2):  # the second one finds its order remembered
        found = reader.read(sent([NAMES[number] for number in order], **shuffled))
        assert found.complaint == ""
        for values, wanted in zip(found.values, VALUES.values(), strict=True):
            np.testing.assert_array_equal(values, wanted)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (sent(velocity=[5.0, np.nan, 7.0, 8.0]), "velocity of arm_joint22 is nan"),
        (sent(NAMES[::-1], position=[np.inf, 2.0, 3.0, 4.0]), "position of x is inf"),
        (sent(position=[1.0, 2.0, 3.0]), "3 values of position, expected 4"),
        (sent(effort=[]), "0 values of effort, expected 4"),
        (sent(NAMES[:3]), "joints arm_joint1, arm_joint22, arm_joint3; expected arm_joint1, "),
        (sent([]), "joints none; expected"),
        (sent(["x"] * 4), "joints x, x, x, x; expected"),
        (sent(["y" * 10_000, *NAMES[1:]]), "joints yyy"),
    ],
)
def test_what_cannot_be_used_is_told(data: bytes, complaint: str) -> None:
    found = JointReader(NAMES).read(data)
    assert found.complaint.startswith(complaint)
    assert len(found.complaint) < 400


def test_what_is_not_needed_may_be_absent_and_must_still_be_finite() -> None:
    reader = JointReader(NAMES, ("effort",))
    assert reader.read(sent(position=[], velocity=[])).complaint == ""
    assert reader.read(sent(position=[np.nan] * 4)).complaint == "position of arm_joint1 is nan"
    assert reader.read(sent(effort=[])).complaint == "0 values of effort, expected 4"


@given(st.permutations(range(4)), st.integers(0, 3), st.sampled_from(list(VALUES)))
def test_a_number_that_is_none_is_told_by_the_name_it_came_with(order: list[int], bad: int, field: str) -> None:
    names = [NAMES[number] for number in order]
    values = list(VALUES[field])
    values[bad] = np.nan
    assert JointReader(NAMES).read(sent(names, **{field: values})).complaint == f"{field} of {names[bad]} is nan"


def test_control_characters_in_names_do_not_break_the_complaint() -> None:
    complaint = JointReader(NAMES).read(sent(["arm\njoint\x1b[2J", *NAMES[1:]])).complaint
    assert complaint.startswith("joints arm?joint?[2J, ")
    assert complaint.isprintable()


HEADER = b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4)  # little-endian, stamp 0, empty frame_id
HUGE = struct.pack("<I", 2**32 - 1)


def judged(data: bytes) -> None:
    """Any bytes: a result, no larger than they are, that can be used or says why not."""
    decoded, read = joint_signals(data), JointReader(NAMES).read(data)
    assert sum(values.nbytes for values in decoded.values) + len(decoded.names) <= len(data) + 4
    assert len(names_of(decoded)) <= len(data) // 4
    assert len(read.complaint) < 400
    if not decoded.readable:
        assert decoded.complaint == read.complaint == f"joint signals cannot be read ({len(data)} bytes)"
        assert decoded.stamp == read.stamp == 0
        assert names_of(decoded) == []
    if not read.complaint:
        assert [values.size for values in read.values] == [4, 4, 4]
        assert all(np.isfinite(values).all() for values in read.values)


@given(st.binary(max_size=300))
@example(b"")
@example(b"\0")
@example(bytes(7))
@example(b"\0\1\0\0" + bytes(12))
@example(HEADER + HUGE)  # 4 thousand million names
@example(HEADER + struct.pack("<I", 1) + HUGE)  # one name of 4 GB
@example(HEADER + struct.pack("<I", 0) + HUGE + bytes(64))  # 32 GB of positions
@example(b"\0\0\0\0" + bytes(8) + b"\xff\xff\xff\xff")  # a frame_id without end, big-endian
def test_random_bytes_are_never_more_than_a_complaint(data: bytes) -> None:
    judged(data)


@given(st.data())
def test_a_message_that_was_cut_off_cannot_be_read(data: st.DataObject) -> None:
    whole = sent()
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    judged(cut)
    assert not joint_signals(cut).readable


@given(st.lists(st.integers(0, 8 * len(sent()) - 1), min_size=1, max_size=8))
def test_flipped_bits_are_read_as_numbers_or_complained_about(bits: list[int]) -> None:
    flipped = bytearray(sent())
    for bit in bits:
        flipped[bit // 8] ^= 1 << bit % 8
    judged(bytes(flipped))


def big_endian(names: list[str], values: list[list[float]]) -> bytes:
    """A ``sensor_msgs/JointState`` of a big-endian machine, stamped 1.5 s."""
    data = b"\0\0\0\0" + struct.pack(">iII", 1, 500_000_000, 1) + bytes(1)

    def add(item: bytes, size: int) -> None:
        nonlocal data
        data += bytes(-(len(data) - 4) % size) + item

    add(struct.pack(">I", len(names)), 4)
    for name in names:
        add(struct.pack(">I", len(name) + 1) + name.encode() + b"\0", 4)
    for sequence in values:
        add(struct.pack(">I", len(sequence)), 4)
        if sequence:
            add(struct.pack(f">{len(sequence)}d", *sequence), 8)
    return data


@given(st.lists(st.lists(st.floats(allow_nan=False), max_size=5), min_size=3, max_size=3))
def test_a_big_endian_message_is_read_as_it_was_meant(values: list[list[float]]) -> None:
    found = joint_signals(big_endian(NAMES, values))
    assert found.stamp == 1_500_000_000
    assert names_of(found) == NAMES
    assert [list(field) for field in found.values] == values


def test_more_joints_than_any_robot_has_cost_neither_time_nor_memory() -> None:
    judged(many := sent([""] * (MAX_JOINTS + 1)))
    assert not joint_signals(many).readable
    judged(long := sent(["y" * 200_000, *NAMES[1:]]))
    assert not joint_signals(long).readable
    judged(sent(position=[0.0] * 25_000))  # 200 kB, and each of it in order
