# SPDX-License-Identifier: Apache-2.0
"""What comes in is put into the order of the joints, or told to be useless; nothing else gets through."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impact_rs_ros.joint_signals import JointReader

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
