# SPDX-License-Identifier: Apache-2.0
"""What names in a recording hint at: signals, arms, and joints from base to tip."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from known_recordings import JOINTS, BagFormat, Signals
from ruamel.yaml import YAML

from impact_rs_cli.main import main
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_import import import_urdf
from impact_rs_trials.recordings.importing import candidates
from impact_rs_trials.recordings.importing.candidates import (
    SignalCandidate,
    candidates_of,
    guess_of,
    joints_of,
    propose,
)
from impact_rs_trials.recordings.importing.import_texts import Line, flow, mapping_text
from impact_rs_trials.recordings.importing.joint_streams import JointStream
from impact_rs_trials.recordings.importing.measured_limits import measured_limits
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.relations import DECISIVE_LOG_ODDS

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


@pytest.mark.parametrize(
    ("patterns", "joints"),
    [
        (("q_{}", "dq_{}", "q_des_{}"), ("hip_abduction", "hip_pitch", "knee")),
        (("observation.state.{}.pos", "action.{}.pos"), ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_roll")),
    ],
)
def test_names_of_joints_stand_between_the_words_that_several_signals_share(
    tmp_path: Path, patterns: tuple[str, ...], joints: tuple[str, ...]
) -> None:
    """Kills: groups by the first or the last word alone, in which q_des_hip is one of the joints of q."""
    columns = [[pattern.format(joint) for joint in joints] for pattern in patterns]
    names = ["time", *(name for signal in columns for name in signal)]
    (tmp_path / "run.csv").write_text(f"{','.join(names)}\n{','.join(['0.5'] * len(names))}\n", encoding="utf-8")
    sources = [candidate.source for candidate in candidates_of(tmp_path / "run.csv")]
    assert all({"columns": signal} in sources for signal in columns)
    assert {"columns": [signal[0] for signal in columns]} not in sources  # one joint, measured and desired


def test_numbers_with_leading_zeros_are_read_by_the_names_of_the_columns(tmp_path: Path) -> None:
    """Kills: the pattern q{joint} for q01, q02, which the reader fills with 1, 2."""
    names = [f"{signal}{joint:02}" for signal in ("q", "dq") for joint in range(1, 4)]
    (tmp_path / "run.csv").write_text(f"t,{','.join(names)}\n{','.join(['0.5'] * 7)}\n", encoding="utf-8")
    sources = [candidate.source for candidate in candidates_of(tmp_path / "run.csv")]
    assert sources == [{"columns": names[:3]}, {"columns": names[3:]}]


@pytest.mark.parametrize("name", ["ddq_des", "target_qdd_0", "q_ddot", "acceleration_1"])
def test_the_name_of_an_acceleration_hints_at_no_position_or_velocity(name: str) -> None:
    """Kills a desired velocity with its acceleration that is read as a motion."""
    columns = SignalCandidate(name, {"columns": [name]}, False, guess_of(name), 1)
    stream = JointStream("", columns, Series(name, np.arange(3.0), np.zeros((3, 1))))
    assert stream.log_prior("velocity") < 0.0 and stream.log_prior("position") < 0.0


def test_a_field_that_a_message_defines_weighs_more_than_a_name() -> None:
    """A planned velocity and acceleration fit each other without noise. Kills a field that weighs like a column."""
    name = SignalCandidate("/state: actual.velocities (1)", {"field": "actual.velocities"}, False, "velocity", 1)
    by_name, by_format = (
        JointStream("", replace(name, defined=defined), Series("v", np.arange(3.0), np.zeros((3, 1))))
        for defined in (False, True)
    )
    assert by_format.log_prior("velocity") - by_name.log_prior("velocity") > DECISIVE_LOG_ODDS
    assert by_name.log_prior("position") - by_format.log_prior("position") > DECISIVE_LOG_ODDS


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


# ---- what import writes is what a reader of YAML reads, whatever columns are called ---------------------------------


NAMES = [
    "on", "off", "On", "OFF", "null", "Null", "true", "True", "No", "Yes", "y", "N", "a ", " a", "a b", "q.1", "a: b",
    "a #b", "[q]", "a,b", "1e3", "_1", "0x1f", ".inf", "nan", "~", "-", "q/1", "{joint}", "é", "'q'", '"q"', "",
]  # fmt: skip


def both(text: str) -> list[object]:
    """What readers of YAML 1.1 and 1.2 read."""
    return [yaml.safe_load(text), YAML(typ="safe").load(text)]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_read_back_as_it_is(name: str) -> None:
    assert both(f"column: {flow(name)}") == [{"column": name}] * 2
    assert both(f"columns: {flow([name, name])}") == [{"columns": [name, name]}] * 2
    assert both(f"time: {flow({'column': name})}") == [{"time": {"column": name}}] * 2


@given(name=st.text(st.characters(exclude_categories=["Cs", "Cc"])))
def test_any_name_is_read_back_as_it_is(name: str) -> None:
    assert both(f"columns: {flow([name])}") == [{"columns": [name]}] * 2


@pytest.mark.parametrize("value", [1e-5, 3e10, 2.5e-7, 0.1, 3.0, -4e-6, True, False, 12])
def test_numbers_stay_numbers(value: float) -> None:
    assert both(f"value: {flow(value)}") == [{"value": value}] * 2


def test_plain_names_stay_without_quotation_marks() -> None:
    text = mapping_text({"robot": "ur10e", "signals": {"position": {"column": "q"}}}, [Line("robot", "ur10e", "given")])
    assert "robot: ur10e   # given" in text and "column: q\n" in text


# ---- limits that a URDF lacks are the measured ranges of the joints, and each is noted ------------------------------


BODY = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)
ARM = (
    f'<robot name="arm"><link name="base"/><link name="upper">{BODY}</link><link name="fore">{BODY}</link>'
    '<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>'
    '<limit lower="0" upper="0" velocity="0" effort="0"/></joint>'
    '<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><axis xyz="0 0 1"/>'
    '<limit lower="-2" upper="2" velocity="3"/></joint></robot>'
)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """As a drawing program writes it: zeros, and no effort."""
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    return tmp_path / "arm.urdf"


def recording(path: Path, names: str, turn: float = 1.0) -> Path:
    """Positions of two joints, the second at twice the range of the first, their velocities and torques."""
    time = np.linspace(0.0, 2.0 * np.pi, 200)
    first, second = np.sin(time) + 0.2, 2.0 * np.sin(time)
    rates = np.cos(time), -2.5 * np.cos(time)
    efforts = 4.0 * np.cos(time), 7.0 * np.cos(time)
    np.savetxt(
        path, turn * np.column_stack([first, second, *rates, *efforts]), delimiter=",", header=names, comments=""
    )
    return path


NUMBERED_COLUMNS = "q1,q2,dq1,dq2,tau1,tau2"
NAMED = "shoulder_position,elbow_position,shoulder_velocity,elbow_velocity,shoulder_effort,elbow_effort"
TURNED = "position_tilt,position_swing,velocity_tilt,velocity_swing,effort_tilt,effort_swing"


@pytest.mark.parametrize("names", [NUMBERED_COLUMNS, NAMED])
def test_limits_that_are_missing_or_0_are_measured_and_said(urdf: Path, tmp_path: Path, names: str) -> None:
    robot = import_urdf(urdf, measured=partial(measured_limits, recording(tmp_path / "log.csv", names)))
    limits = robot.facts.limits
    assert limits.position_min_rad == pytest.approx((-0.8, -2.0), abs=1e-3)  # of the elbow it is that of the URDF
    assert limits.position_max_rad == pytest.approx((1.2, 2.0), abs=1e-3)
    assert limits.velocity_rad_s == pytest.approx((1.0, 3.0), abs=1e-3)
    assert limits.torque_Nm == pytest.approx((4.0, 7.0), abs=1e-3)
    noted = [note for note in robot.notes if "as measured" in note]
    assert [note.split(" as measured")[0] for note in noted] == [
        "Limits of joint shoulder",
        "Velocity limit of joint shoulder",
        "Effort limit of joint shoulder",
        "Effort limit of joint elbow",
    ]


def test_targets_are_no_measured_limits(tmp_path: Path) -> None:
    """Kills: the first columns that may be positions, which are the targets."""
    names = "position_des_1,position_des_2,q_1,q_2,tau_1,tau_2"
    path = recording(tmp_path / "log.csv", names)
    assert measured_limits(path, ["a", "b"])["a", "position"] == pytest.approx((-1.0, 1.0), abs=1e-3)  # of q_1


def test_vectors_in_cells_are_refused_as_what_they_are(tmp_path: Path) -> None:
    """Kills: a vector that is read as one number, and a file that is called damaged."""
    (tmp_path / "log.csv").write_text("t;position\n" + "0.1;[0.1, 0.2]\n" * 60, encoding="utf-8")
    with pytest.raises(InputError, match="no 2 columns of positions"):
        measured_limits(tmp_path / "log.csv", ["a", "b"])


def test_columns_named_after_joints_may_stand_in_any_order(tmp_path: Path) -> None:
    found = measured_limits(recording(tmp_path / "log.csv", TURNED), ["swing", "tilt"])
    assert found["tilt", "position"] == pytest.approx((-0.8, 1.2), abs=1e-3)
    assert found["swing", "effort"] == pytest.approx((7.0,), abs=1e-3)


def test_given_limits_go_before_measured_ones(urdf: Path, tmp_path: Path) -> None:
    shown = partial(measured_limits, recording(tmp_path / "log.csv", NUMBERED_COLUMNS))
    robot = import_urdf(urdf, limits=["*.effort=10", "shoulder.position=-3:3"], measured=shown)
    assert robot.facts.limits.torque_Nm == (10.0, 10.0)
    assert robot.facts.limits.position_max_rad == (3.0, 2.0)


def test_a_recording_that_does_not_say_it_is_refused(urdf: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="limit effort.*--limits shoulder.effort=MOST gives it, or --measured"):
        import_urdf(urdf, limits=["*.position=-3:3", "*.velocity=3"])
    with pytest.raises(InputError, match="no 2 columns of positions"):
        measured_limits(recording(tmp_path / "log.csv", "a,b,c,d,e,f"), ["shoulder", "elbow"])
    with pytest.raises(InputError, match="expected rad or m, not degrees or mm"):
        measured_limits(recording(tmp_path / "log.csv", NUMBERED_COLUMNS, turn=57.3), ["shoulder", "elbow"])
    with pytest.raises(InputError, match="expected a table"):
        measured_limits(tmp_path / "log.mcap", ["shoulder", "elbow"])


def test_the_command_writes_facts_with_measured_limits(urdf: Path, tmp_path: Path) -> None:
    log, mine = recording(tmp_path / "log.csv", NAMED), tmp_path / "mine.yaml"
    assert main(["robot", "import", str(urdf), "--measured", str(log), "-o", str(mine)]) == 0
    assert load_facts(str(mine)).limits.torque_Nm == pytest.approx((4.0, 7.0), abs=1e-3)
    assert "# Effort limit of joint elbow as measured" in mine.read_text(encoding="utf-8")
