# SPDX-License-Identifier: Apache-2.0
"""CDR by columns: the bytes of the standard, worked out by hand, and any message there and back."""

from __future__ import annotations

import struct
from operator import attrgetter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from impact_rs_trials.bags import topics
from impact_rs_trials.bags.cdr import Readable, Template, decode, encode, number_paths, stacked
from impact_rs_trials.bags.types import typestore

STORE = typestore()
TYPES = STORE.types
WRENCH = topics.WRENCH
LITTLE = b"\x00\x01\x00\x00"  # encapsulation header of XCDR1, little endian


def header(frame: str, sec: int, nanosec: int):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def joint_state(frame: str, names: list[str], values: np.ndarray, sec: int = 0):
    return TYPES[topics.JOINT_STATE](
        header=header(frame, sec, 7), name=names, position=values, velocity=np.zeros(0), effort=-values
    )


def by_hand(frame: str, names: list[str], values: list[float], sec: int) -> bytes:
    """A JointState as the standard says: each value aligned to its own size, counted from behind the header."""
    body = b""

    def align(size: int) -> None:
        nonlocal body
        body += b"\0" * (-len(body) % size)

    def text(value: str) -> None:
        nonlocal body
        align(4)
        body += struct.pack("<I", len(value) + 1) + value.encode() + b"\0"

    def doubles(numbers: list[float]) -> None:
        nonlocal body
        align(4)
        body += struct.pack("<I", len(numbers))
        if numbers:
            align(8)
            body += struct.pack(f"<{len(numbers)}d", *numbers)

    body += struct.pack("<iI", sec, 7)
    text(frame)
    align(4)
    body += struct.pack("<I", len(names))
    for name in names:
        text(name)
    doubles(values)
    doubles([])
    doubles([-value for value in values])
    return LITTLE + body


@pytest.mark.parametrize("frame", ["", "w", "world", "a_frame"])
@pytest.mark.parametrize("names", [[], ["a"], ["a", "bc", ""], ["joint1", "joint2", "j3"]])
def test_columns_are_written_and_read_as_the_standard_says(frame: str, names: list[str]) -> None:
    rows = [np.arange(len(names)) + 0.5 * sec for sec in range(4)]
    expected = [by_hand(frame, names, row.tolist(), sec) for sec, row in enumerate(rows)]
    messages = [joint_state(frame, names, row, sec) for sec, row in enumerate(rows)]
    assert [bytes(row) for row in encode(STORE, topics.JOINT_STATE, messages)] == expected
    columns = decode(STORE, topics.JOINT_STATE, expected)
    np.testing.assert_array_equal(columns["position"], rows)
    np.testing.assert_array_equal(columns["effort"], -np.array(rows))
    np.testing.assert_array_equal(columns["header.stamp.sec"], range(4))
    np.testing.assert_array_equal(columns["header.stamp.nanosec"], 7)
    assert columns["velocity"].shape == (4, 0)


def test_numbers_of_the_other_byte_order_are_read_as_well() -> None:
    r"""``b"\x00\x00"``: big endian; nobody writes it here, some recorders do."""
    rows = []
    for sec in range(3):
        body = struct.pack(">iII", sec, 7, 2) + b"w\0" + b"\0\0" + struct.pack(">II", 1, 2) + b"a\0" + b"\0\0"
        body += struct.pack(">I", 1)
        body += b"\0" * (-len(body) % 8) + struct.pack(">d", 1.5 * sec)
        body += struct.pack(">II", 0, 0)
        rows.append(b"\x00\x00\x00\x00" + body)
    columns = decode(STORE, topics.JOINT_STATE, rows)
    np.testing.assert_array_equal(columns["position"], [[0.0], [1.5], [3.0]])
    np.testing.assert_array_equal(columns["header.stamp.sec"], range(3))


doubles = st.floats(width=64, allow_nan=True)


@given(st.lists(st.lists(doubles, min_size=6, max_size=6), min_size=1, max_size=6), st.text("abc", max_size=9))
def test_any_numbers_make_the_round_trip_bit_by_bit(values: list[list[float]], frame: str) -> None:
    vector = TYPES["geometry_msgs/msg/Vector3"]
    messages = [
        TYPES[WRENCH](
            header=header(frame, index, 3),
            wrench=TYPES["geometry_msgs/msg/Wrench"](force=vector(*row[:3]), torque=vector(*row[3:])),
        )
        for index, row in enumerate(values)
    ]
    rows = encode(STORE, WRENCH, messages)
    assert [bytes(row) for row in rows] == [bytes(STORE.serialize_cdr(message, WRENCH)) for message in messages]
    columns = decode(STORE, WRENCH, [bytes(row) for row in rows])
    found = np.column_stack([columns[f"wrench.{part}.{axis}"] for part in ("force", "torque") for axis in "xyz"])
    np.testing.assert_array_equal(found, np.array(values))


def test_a_template_changes_the_columns_it_is_given_and_keeps_the_rest() -> None:
    example = joint_state("world", ["a", "b"], np.array([1.0, 2.0]), 9)
    rows = Template.of(STORE, topics.JOINT_STATE, example).rows(
        {"header.stamp.sec": [4, 5], "position": [[0.5, 0.25], [7.0, 8.0]]}, 2
    )
    messages = [STORE.deserialize_cdr(row, topics.JOINT_STATE) for row in rows]
    assert [message.header.stamp.sec for message in messages] == [4, 5]
    assert [message.header.stamp.nanosec for message in messages] == [7, 7]
    np.testing.assert_array_equal([message.position for message in messages], [[0.5, 0.25], [7.0, 8.0]])
    np.testing.assert_array_equal([message.effort for message in messages], [[-1.0, -2.0]] * 2)
    assert {tuple(message.name) for message in messages} == {("a", "b")}


def test_arrays_that_change_their_length_have_no_columns() -> None:
    messages = [joint_state("w", ["a"] * count, np.zeros(count)) for count in (1, 2, 1)]
    rows = [bytes(STORE.serialize_cdr(message, topics.JOINT_STATE)) for message in messages]
    assert [bytes(row) for row in encode(STORE, topics.JOINT_STATE, messages)] == rows
    with pytest.raises(ValueError, match="inhomogeneous|shape"):
        decode(STORE, topics.JOINT_STATE, rows)


@pytest.mark.parametrize("other", [["a", "bc"], ["ab", "x"], ["ab", "c" * 9]], ids=["as long", "as names", "longer"])
def test_messages_of_another_layout_among_others_are_read_and_written_right(other: list[str]) -> None:
    messages = [joint_state("w", names, np.array([1.0, 2.0])) for names in (["ab", "c"], other, ["ab", "c"])]
    rows = [bytes(STORE.serialize_cdr(message, topics.JOINT_STATE)) for message in messages]
    assert [bytes(row) for row in encode(STORE, topics.JOINT_STATE, messages)] == rows
    np.testing.assert_array_equal(decode(STORE, topics.JOINT_STATE, rows)["position"], [[1.0, 2.0]] * 3)


def test_nothing_has_no_columns_and_a_message_cut_short_is_an_error() -> None:
    assert decode(STORE, topics.JOINT_STATE, []) == {}
    row = bytes(STORE.serialize_cdr(joint_state("w", ["a"], np.array([1.0])), topics.JOINT_STATE))
    with pytest.raises(Exception):  # noqa: B017  (whatever the library raises; the reader of bags says which bag)
        decode(STORE, topics.JOINT_STATE, [row[:-4]] * 3)


def test_paths_of_numbers_leave_out_text_and_name_what_is_nested() -> None:
    assert number_paths(STORE, topics.JOINT_STATE) == [
        "header.stamp.sec",
        "header.stamp.nanosec",
        "position",
        "velocity",
        "effort",
    ]
    assert "pose.orientation.w" in number_paths(STORE, topics.POSE)
    state = number_paths(STORE, topics.CONTROLLER_STATE)
    assert {"mode", "gamma", "twist", "net_feedback", "qp_iterations"} <= set(state)
    assert "robot" not in state


@given(st.data())
def test_bytes_are_readable_exactly_where_the_decoder_of_bags_reads_them(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from([topics.JOINT_STATE, topics.POSE, topics.STRING]))
    joints = joint_state("world", ["joint1", "joint22"], np.array([1.0, 2.0]))
    pose = by_hand("world", ["a"], [1.0], 3)  # of another type: read where its bytes happen to be such a message
    example = STORE.serialize_cdr(joints, topics.JOINT_STATE) if kind == topics.JOINT_STATE else pose
    readable = Readable(STORE, kind)
    readable(bytes(example))  # its layout is known from here on, where it is one
    changed = bytearray(example)
    for bit in data.draw(st.lists(st.integers(0, 8 * len(changed) - 1), max_size=6)):
        changed[bit // 8] ^= 1 << bit % 8
    sent = bytes(changed)[: data.draw(st.integers(0, len(changed)) | st.just(len(changed)))]
    try:
        STORE.deserialize_cdr(sent, kind)
        expected = True
    except Exception:
        expected = False
    assert readable(sent) == expected
    assert readable(sent) == expected


KINDS = (topics.JOINT_STATE, "std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Imu")


def drawn(data: st.DataObject, kind: str, lengths: dict[str, int], texts: dict[str, object], path: str = ""):
    """A message of any numbers, with lengths and strings given by field path."""
    content = {}
    for name, (node, payload) in STORE.fielddefs[kind][1]:
        place = f"{path}{name}"
        if node == Nodetype.NAME:
            content[name] = drawn(data, payload, lengths, texts, f"{place}.")
        elif node == Nodetype.BASE:
            base = payload[0]
            if base == "string":
                content[name] = texts.get(place, "")
                continue
            limits = None if base == "float64" else np.iinfo(base)
            content[name] = data.draw(doubles if limits is None else st.integers(limits.min, limits.max))
        elif payload[0][0] == Nodetype.NAME:
            content[name] = []
        elif payload[0][1][0] == "string":
            content[name] = texts.get(place, [])
        else:
            count = payload[1] if node == Nodetype.ARRAY else lengths.get(place, 0)
            content[name] = np.array(data.draw(st.lists(doubles, min_size=count, max_size=count)), dtype=float)
    return TYPES[kind](**content)


def same_bits(one: object, column: np.ndarray, row: int) -> bool:
    return np.asarray(one, column.dtype).tobytes() == np.ascontiguousarray(column[row]).tobytes()


@given(st.data(), st.sampled_from(KINDS), st.integers(1, 5))
def test_stacked_messages_hold_what_the_library_reads_bit_by_bit(data: st.DataObject, kind: str, count: int) -> None:
    """Kills: an offset without padding behind a name, a column that skips an array, values through another type."""
    lengths = {path: data.draw(st.integers(0, 4)) for path in ("position", "velocity", "effort", "data")}
    texts = {"header.frame_id": data.draw(st.text(max_size=6)), "name": data.draw(st.lists(st.text(max_size=5)))}
    texts = {path: text for path, text in texts.items() if "\0" not in "".join(text)}
    messages = [drawn(data, kind, lengths, texts) for _ in range(count)]
    rows = [bytes(STORE.serialize_cdr(one, kind)) for one in messages]
    whole = stacked(STORE, kind, rows)
    assert whole is not None
    for row, raw in enumerate(rows):
        read = STORE.deserialize_cdr(raw, kind)
        for path in number_paths(STORE, kind):
            assert same_bits(attrgetter(path)(read), attrgetter(path)(whole), row), path
        if kind == topics.JOINT_STATE:
            assert whole.name == read.name and whole.header.frame_id == read.header.frame_id


@given(st.integers(1, 6), st.sampled_from(["names", "frame", "length", "byte order"]))
def test_a_topic_that_changes_has_no_stack(at: int, what: str) -> None:
    """Kills: a layout taken from the first message alone."""
    rows = []
    for number in range(7):
        changed = number >= at
        names = ["b", "a"] if changed and what == "names" else ["a", "b"]
        frame = "v" if changed and what == "frame" else "w"
        count = 3 if changed and what == "length" else 2
        one = joint_state(frame, names, np.arange(count) + 0.5, number)
        little = not (changed and what == "byte order")
        rows.append(bytes(STORE.serialize_cdr(one, topics.JOINT_STATE, little_endian=little)))
    assert stacked(STORE, topics.JOINT_STATE, rows) is None
    assert stacked(STORE, topics.JOINT_STATE, rows[:at]) is not None
    assert stacked(STORE, topics.JOINT_STATE, []) is None


def test_messages_of_numbers_alone_in_both_byte_orders_have_no_stack() -> None:
    """No length or string differs. Kills: a byte order taken from the first, middle and last message."""
    kind = "geometry_msgs/msg/Vector3"
    messages = [TYPES[kind](x=1.5 * row, y=2.0, z=3.0) for row in range(6)]
    rows = [bytes(STORE.serialize_cdr(one, kind, little_endian=row != 1)) for row, one in enumerate(messages)]
    assert stacked(STORE, kind, rows) is None
    np.testing.assert_array_equal(decode(STORE, kind, rows)["x"], 1.5 * np.arange(6))


def test_arrays_with_described_dimensions_have_no_stack() -> None:
    """Kills: a list of messages taken for empty, in reading or writing."""
    layout, dimension = (TYPES[f"std_msgs/msg/MultiArray{part}"] for part in ("Layout", "Dimension"))
    kind = "std_msgs/msg/Float64MultiArray"
    dimensions = [[], [dimension(label="joint", size=2, stride=2)], []]
    messages = [TYPES[kind](layout=layout(dim=dim, data_offset=0), data=np.array([1.0, 2.0])) for dim in dimensions]
    rows = [bytes(STORE.serialize_cdr(one, kind)) for one in messages]
    assert stacked(STORE, kind, rows) is None and stacked(STORE, kind, rows[1:2]) is None
    assert stacked(STORE, kind, rows[::2]) is not None
    assert [bytes(row) for row in encode(STORE, kind, messages)] == rows
