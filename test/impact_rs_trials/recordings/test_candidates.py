# SPDX-License-Identifier: Apache-2.0
"""What names in a recording hint at: signals, arms, and joints from base to tip."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from known_recordings import JOINTS, BagFormat, Signals

from impact_rs_trials.recordings import candidates
from impact_rs_trials.recordings.candidates import SignalCandidate, candidates_of, joints_of, propose

NUMBERED = tuple(f"joint{number}" for number in range(1, 8))


def test_a_bag_offers_its_fields_with_the_joints_in_order(tmp_path: Path) -> None:
    found = candidates_of(BagFormat().write(tmp_path / "run", Signals.known()))
    assert [one.label for one in found] == [
        "/joint_states: position (7)", "/joint_states: velocity (7)", "/joint_states: effort (7)",
        "/effort_controller/commands: data (7)", "/mocap/box/pose",
    ]  # fmt: skip
    assert found[0].joints == tuple(sorted(JOINTS))
    proposal = propose(found, {"arm": 7})["arm"]
    assert proposal.joints == tuple(sorted(JOINTS))
    assert proposal.signals == {"position": 0, "velocity": 1, "torque": 2, "command": 3}


def test_tables_and_arrays_offer_groups_of_columns_and_arrays(tmp_path: Path) -> None:
    names = [f"{signal}_{joint}" for signal in ("q", "dq", "tau") for joint in range(1, 8)]
    names += [f"box_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    rows = np.zeros((5, 1 + len(names)))
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=",".join(["time", *names]), comments="")
    found = {one.guess: one.source for one in candidates_of(tmp_path / "run.csv")}
    assert found["position"] == {"column": "q_{joint}"}
    assert found["velocity"] == {"column": "dq_{joint}"}
    assert found["object_pose"]["columns"][-1] == "box_qw"
    np.savez(tmp_path / "run.npz", time=rows[:, 0], position=rows[:, :7], object_pose=rows[:, -7:])
    found = {one.guess: one.source for one in candidates_of(tmp_path / "run.npz")}
    assert found == {"position": {"array": "position"}, "object_pose": {"array": "object_pose"}}


def named(label: str, guess: str, width: int = 7) -> SignalCandidate:
    return SignalCandidate(label, {"array": label}, False, guess, width)


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        (("right_q", "left_q"), {"left": 1, "right": 0}),  # by the name of the arm
        (("robot_1_q", "robot_2_q"), {"left": 0, "right": 1}),  # in the order of the arms
        (("q",), {"left": 0, "right": 0}),  # one for both, which is refused later
    ],
)
def test_signals_are_given_to_arms_by_name_or_in_order(labels: tuple[str, ...], expected: dict[str, int]) -> None:
    found = propose([named(label, "position") for label in labels], {"left": 7, "right": 7})
    assert {arm: own.signals["position"] for arm, own in found.items()} == expected


def test_a_signal_as_wide_as_an_arm_is_taken_for_its_own() -> None:
    candidates = [named("a_q", "position", 7), named("b_q", "position", 6)]
    found = propose(candidates, {"left": 7, "right": 6})
    assert {arm: own.signals["position"] for arm, own in found.items()} == {"left": 0, "right": 1}


@pytest.mark.parametrize(
    ("names", "several", "count", "expected"),
    [
        ((), False, 7, NUMBERED),
        (("finger_joint1", "finger_joint2", *NUMBERED), False, 7, NUMBERED),
        (("left_j1", "left_j2", "right_j1", "right_j2"), True, 2, ("left_j1", "left_j2")),
        (NUMBERED[:3], False, 7, NUMBERED[:3]),  # too few, which is told
    ],
)
def test_joints_of_an_arm_are_found_among_those_of_others(
    names: tuple[str, ...], several: bool, count: int, expected: tuple[str, ...]
) -> None:
    assert joints_of(names, "left", several, count) == expected


def test_joints_that_are_named_after_parts_of_the_arm_go_from_base_to_tip(tmp_path: Path) -> None:
    """As the driver of Universal Robots publishes them: by the alphabet."""
    names = ["elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3"]
    joints = [f"{name}_joint" for name in names]
    found = candidates_of(BagFormat(joints=joints, order=range(6)).write(tmp_path / "run", Signals.known()))
    assert [name.removesuffix("_joint") for name in found[0].joints] == [
        "shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3",
    ]  # fmt: skip


def test_joints_are_in_the_order_of_their_numbers_and_not_of_their_letters() -> None:
    names = [f"joint{number}" for number in (10, 2, 1, 9)]
    message = SimpleNamespace(name=names, position=np.zeros(4))
    (found,) = candidates._in_message("/joint_states", "sensor_msgs/msg/JointState", message)
    assert found.joints == ("joint1", "joint2", "joint9", "joint10")
