# SPDX-License-Identifier: Apache-2.0
"""Contents of a foreign recording, and candidates for the signals of every arm.

A proposal follows from their names; the user checks and changes it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as AbstractMapping
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import combinations_with_replacement, permutations
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.decimals import decimal
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import RobotFacts
from impact_rs_trials.recordings.mapping import REQUIRED, TableLayout
from impact_rs_trials.recordings.readers.array_file import ArrayFile
from impact_rs_trials.recordings.readers.bag_file import (
    POSE_PARTS,
    deserialized,
    open_bag,
    register,
    typestore_for,
    unreadable,
)
from impact_rs_trials.recordings.readers.lerobot import DESIRED, MEASURED, data_set_of
from impact_rs_trials.recordings.readers.run_finder import ARRAY_SUFFIXES, BAG_SUFFIXES, TABLE_SUFFIXES, is_bag_folder
from impact_rs_trials.recordings.readers.table_columns import read_columns
from impact_rs_trials.recordings.readers.table_file import BETWEEN, BRACKETS
from impact_rs_trials.recordings.readers.text_file import suffix_of
from impact_rs_trials.recordings.readers.transforms import are_transforms

MAX_JOINT_NUMBERS = 40  # in a sample of a stream that may hold joints
MAX_NESTED_FIELDS = 3  # of a message
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
NAME_FIELDS = ("name", "joint_names")  # of sensor_msgs/JointState, and of trajectory_msgs and control_msgs
DEFINING = ("sensor_msgs", "trajectory_msgs", "control_msgs")  # packages whose messages state quantity and unit
STATIC = "/tf_static"  # frames that do not move are no pose of an object
OBJECT_POSE: Final = "object_pose"
Q_DESIRED: Final = "q_desired"
# Parts of an arm from base to tip, for joints that are named after them and not numbered.
PARTS = ("rail", "base", "shoulder_pan", "shoulder_lift", "shoulder", "upper_arm", "elbow", "forearm", "wrist")
PART_OF_ARM = re.compile(rf"({'|'.join(PARTS)})(_?\d)?(_joint)?(?=[^a-z]|$)", re.IGNORECASE)
MAX_GRIPPER_NUMBERS = 2  # in addition to the numbers of the joints
MAX_ROWS_READ = 50  # of a table whose columns are listed
FINGERS = re.compile("finger|gripper|hand", re.IGNORECASE)
SIDES = re.compile("left|right", re.IGNORECASE)
COMMANDED = re.compile(
    r"des|ref|target|goal|action|cmd|cmp|command|comput|set_?point|(^|_)(d|control|ctrl)([_.\d]|$)|filt|err",
    re.IGNORECASE,
)
WORD = re.compile(r"[^\W_]+")


@dataclass(frozen=True)
class SignalCandidate:
    """A field or column of a recording that may hold a signal.

    Attributes:
        label: Its name in lists.
        source: Its keys in a mapping, without unit.
        pose: Whether it is a pose; else numbers of joints.
        guess: Signal suggested by the name; empty: unknown.
        width: Numbers per sample.
        joints: Names of its joints, base to tip if the names show it; empty: not named.
        stamped: Whether its samples have timestamps; messages of a bag without a header do not.
        first: Index of the first number in a wider signal, of which the candidate is a part; None: whole signal.
        defined: Whether the file format defines the signal, not a name that a user chose.
    """

    label: str
    source: dict[str, Any]
    pose: bool
    guess: str = ""
    width: int = 0
    joints: tuple[str, ...] = ()
    stamped: bool = True
    first: int | None = None
    defined: bool = False


@dataclass(frozen=True)
class Proposal:
    """Proposed signals of an arm.

    Attributes:
        joints: Names of its joints, base to tip.
        signals: Indices of candidates, by signal.
    """

    joints: tuple[str, ...]
    signals: dict[str, int] = field(default_factory=dict)


def candidates_of(path: Path, layout: TableLayout | None = None) -> list[SignalCandidate]:
    """Candidates for signals in a recording.

    Args:
        path: The recording.
        layout: Lines of names and rows of a text table; None: names first, then rows.

    Raises:
        InputError: It cannot be read.
    """
    if is_bag_folder(path) or suffix_of(path) in BAG_SUFFIXES:
        return _in_bag(path)
    if suffix_of(path) in TABLE_SUFFIXES:
        return _in_table(path, layout or TableLayout())
    if suffix_of(path) in ARRAY_SUFFIXES:
        return _in_arrays(path)
    raise InputError("no recording that can be looked at", file=path)


def propose(candidates: Sequence[SignalCandidate], arms: dict[str, int]) -> dict[str, Proposal]:
    """Proposed signals of every arm.

    Args:
        candidates: Candidates of the recording.
        arms: Number of joints, by arm.
    """
    proposals = {}
    for index, (arm, count) in enumerate(arms.items()):
        signals: dict[str, int] = {}
        for name in (*REQUIRED, "command"):
            fitting = [
                number
                for number, candidate in enumerate(candidates)
                if candidate.guess == name and (candidate.joints or candidate.width == count)
            ]
            of_arm = [number for number in fitting if len(arms) > 1 and arm in candidates[number].label]
            of_no_other_arm = [
                number
                for number in fitting
                if not any(other_arm in candidates[number].label for other_arm in arms if other_arm != arm)
            ]
            if of_arm or of_no_other_arm:
                # Signals without the name of an arm are in the order of the arms.
                signals[name] = of_arm[0] if of_arm else of_no_other_arm[min(index, len(of_no_other_arm) - 1)]
            elif name in REQUIRED and (
                numeric := [number for number, candidate in enumerate(candidates) if not candidate.pose]
            ):
                signals[name] = numeric[0]
        joint_names = candidates[signals["position"]].joints if "position" in signals else ()
        proposals[arm] = Proposal(joints_of(joint_names, arm, len(arms) > 1, count), signals)
    return proposals


def joints_of(names: Sequence[str], arm: str, several_arms: bool, count: int) -> tuple[str, ...]:
    """The joints of an arm among the names of a recording; numbered if there are no names.

    Args:
        names: Joint names in the recording, base to tip.
        arm: Name of the arm.
        several_arms: Whether there are other arms.
        count: How many joints it has.
    """
    if not names:
        return tuple(f"joint{number}" for number in range(1, count + 1))
    joints = [name for name in names if several_arms and arm in name] or list(names)
    if len(joints) > count:
        joints = [name for name in joints if not FINGERS.search(name)]
    return tuple(joints[:count])


def parts_of(candidate: SignalCandidate, count: int) -> list[SignalCandidate]:
    """Parts of a wider signal with as many numbers as an arm has joints; the other numbers may be a gripper.

    Args:
        candidate: A signal that may be wider.
        count: How many joints the arm has.

    Returns:
        The first numbers, the numbers from the second on, and so on; empty if the signal has as many numbers as joints,
        many more, or names its joints.
    """
    excess, source = candidate.width - count, candidate.source
    if candidate.pose or candidate.joints or "names" in source or not 0 < excess <= MAX_GRIPPER_NUMBERS or count == 1:
        return []  # for one joint every column is a candidate already
    parts = []
    for first in range(excess + 1):
        position = "first" if first == 0 else "last" if first == excess else "middle"
        part_source = {**source, "entries": list(range(first + 1, first + count + 1))}
        if "columns" in source:
            part_source = {"columns": source["columns"][first : first + count]}
        elif "{joint}" in source.get("column", ""):
            columns = [source["column"].replace("{joint}", str(number)) for number in part_source["entries"]]
            part_source = {"columns": columns} if first else source  # {joint} counts the joints from 1
        label = f"{candidate.label}, the {position} {count}"
        parts.append(replace(candidate, label=label, source=part_source, width=count, first=first))
    return parts


def of_side(candidates: Sequence[SignalCandidate], facts: RobotFacts) -> list[SignalCandidate]:
    """Candidates except joints of the left side of a robot whose links are called right, or the reverse."""
    robot_sides = {side[0].lower() for link in facts.links if (side := SIDES.search(link.name))}
    if len(robot_sides) != 1:
        return list(candidates)
    sides = [{side[0].lower() for name in candidate.joints if (side := SIDES.search(name))} for candidate in candidates]
    return [
        candidate
        for candidate, named_sides in zip(candidates, sides, strict=True)
        if not named_sides or named_sides & robot_sides
    ]


def in_order(candidate: SignalCandidate, order: Sequence[int]) -> SignalCandidate:
    """A candidate with reordered joints.

    Args:
        candidate: Signal of joints without names.
        order: Index from 0 of the number of each joint, base to tip.
    """
    source = dict(candidate.source)
    if "{joint}" in source.get("column", ""):
        pattern = source.pop("column")
        source["columns"] = [pattern.replace("{joint}", str(number + 1)) for number in range(len(order))]
    key = "columns" if "columns" in source else "entries"
    whole = source.get(key, range(1, len(order) + 1))
    return replace(candidate, source={**source, key: [whole[number] for number in order]})


def width_of(shape: tuple[int, ...]) -> int:
    """Numbers per sample of an array, samples x numbers or transposed as in MATLAB; 0: not a signal."""
    if len(shape) != 2:
        return 0
    width = shape[0] if shape[0] <= MAX_JOINT_NUMBERS < shape[1] else shape[1]
    return width if width <= MAX_JOINT_NUMBERS else 0


def single_candidates(columns: AbstractMapping[str, Sequence[str] | NDArray[Any]], key: str) -> list[SignalCandidate]:
    """Columns or arrays with one number per sample: signals of a robot with one joint.

    Args:
        columns: Contents by name.
        key: Their key in a mapping, ``column`` or ``array``.
    """
    return [
        SignalCandidate(name, {key: name}, False, guess_of(name), 1)
        for name, cells in columns.items()
        if np.ndim(cells) == 1 and vector_width(cells) == 1
    ]


def _in_bag(path: Path) -> list[SignalCandidate]:
    """The first message of every topic."""
    candidates: list[SignalCandidate] = []
    store = typestore_for(path)
    topics: set[str] = set()
    try:
        with open_bag(path) as reader:
            for connection in reader.connections:
                register(store, connection)
            for connection, _, data in reader.messages():
                if connection.topic in topics:
                    continue
                topics.add(connection.topic)
                message = deserialized(store, path, data, connection.msgtype)
                candidates += _in_message(connection.topic, connection.msgtype, message)
                if len(topics) == len(reader.topics):
                    break
    except InputError:
        raise
    except Exception as error:  # a damaged file can fail anywhere inside the library
        raise unreadable(path, error) from None
    return candidates


def _in_message(topic: str, kind: str, message: Any) -> Iterator[SignalCandidate]:
    if _holds_pose(message) and not topic.endswith(STATIC):
        yield SignalCandidate(topic, {"topic": topic, "type": kind}, True, OBJECT_POSE)
    for path, numbers in _numbers(message):
        source = {"topic": topic, "type": kind, "field": path}
        joints: tuple[str, ...] = ()
        parent, _, name = path.rpartition(".")
        for prefix in (f"{parent}.", ""):  # names next to the numbers, or in the message itself
            key, names = _names(reduce(getattr, filter(None, prefix.split(".")), message))
            if key and len(names) == numbers:
                source["names"] = f"{prefix}{key}".lstrip(".")
                joints = tuple(sorted(names, key=_base_to_tip))
                break
        guess = "command" if "command" in topic else guess_of(name)
        label, stamped = f"{topic}: {path} ({numbers})", hasattr(message, "header")
        defined = kind.partition("/")[0] in DEFINING and guess in ("position", "velocity", "acceleration")
        yield SignalCandidate(label, source, False, guess, numbers, joints, stamped, defined=defined)


def _names(message: Any) -> tuple[str, list[str]]:
    """Field of a message that names its joints, and the names; empty: it has none."""
    for key in NAME_FIELDS:
        names = getattr(message, key, None)
        if isinstance(names, list) and names and all(isinstance(name, str) for name in names):
            return key, names
    return "", []


def _base_to_tip(name: str) -> tuple[int, list[Any]]:
    part = next((position for position, part in enumerate(PARTS) if part in name), 0)
    return part, [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def _holds_pose(message: Any, depth: int = MAX_NESTED_FIELDS) -> bool:
    if hasattr(message, "transforms"):
        return True
    if any(hasattr(message, a) and hasattr(message, b) for a, b in POSE_PARTS):
        return True
    inner = (getattr(message, name, None) for name in ("pose", "transform"))
    return depth > 0 and any(_holds_pose(part, depth - 1) for part in inner if part is not None)


def _numbers(message: Any, prefix: str = "", depth: int = MAX_NESTED_FIELDS) -> Iterator[tuple[str, int]]:
    """Path and size of the fields with several numbers."""
    for name, value in vars(message).items():
        if name.startswith("__"):
            continue
        path = f"{prefix}{name}"
        if isinstance(value, np.ndarray):
            if value.ndim == 1 and 0 < value.size <= MAX_JOINT_NUMBERS and np.issubdtype(value.dtype, np.floating):
                yield path, int(value.size)
        elif depth > 0 and hasattr(value, "__msgtype__") and name != "header":
            yield from _numbers(value, f"{path}.", depth - 1)


def _in_table(path: Path, layout: TableLayout) -> list[SignalCandidate]:
    """Columns that differ in a number, in a part of an arm, or in the name of a joint; columns of vectors; poses."""
    candidates = []
    cells = read_columns(path, layout).cells
    columns = list(cells)
    groups: dict[str, dict[int, str]] = {}
    parts: dict[str, list[str]] = {}
    for column in columns:
        for number in re.finditer(r"\d+", column):
            pattern = f"{column[: number.start()]}{{joint}}{column[number.end() :]}"
            groups.setdefault(pattern, {})[int(number[0])] = column
        if part := PART_OF_ARM.search(column):
            parts.setdefault(f"{column[: part.start()]}…{column[part.end() :]}", []).append(column)
    for pattern, of_number in groups.items():
        first, last = min(of_number), max(of_number)
        if first > 1 or len(of_number) < 2 or len(of_number) != last - first + 1:
            continue
        names = [of_number[number] for number in range(first, last + 1)]
        counted = names == [pattern.replace("{joint}", str(number)) for number in range(1, len(names) + 1)]
        source = {"column": pattern} if counted else {"columns": names}  # not from 1, or with zeros before the number
        candidates.append(SignalCandidate(f"{names[0]} … {names[-1]}", source, False, guess_of(pattern), len(names)))
    for pattern, members in parts.items():
        if len(members) > 1:
            names = sorted(members, key=_base_to_tip)
            label = f"{names[0]} … {names[-1]}"
            candidates.append(SignalCandidate(label, {"columns": names}, False, guess_of(pattern), len(names)))
    candidates += [
        candidate
        for candidate in _of_named_joints(columns)
        if candidate.label not in {listed.label for listed in candidates}
    ]
    named_vectors = list(_named_vectors(path, {column: vector_width(cells[column]) for column in columns}))
    candidates += named_vectors
    for column in columns:
        width = vector_width(cells[column])
        if width > 1 and not any(vector.source["column"] == column for vector in named_vectors):
            pose = width == len(POSE_COLUMNS) and _is_of_an_object(column)
            guess = OBJECT_POSE if pose else guess_of(column)
            candidates.append(SignalCandidate(f"{column} ({width})", {"column": column}, pose, guess, width))
    for column in columns:
        prefix = column.removesuffix("qw")
        names = [f"{prefix}{axis}" for axis in POSE_COLUMNS]
        if prefix != column and set(names) <= set(columns):
            candidates.append(SignalCandidate(f"{names[0]} … {names[-1]}", {"columns": names}, True, OBJECT_POSE))
    return candidates


def _named_vectors(path: Path, widths: dict[str, int]) -> Iterator[SignalCandidate]:
    """Vectors of a LeRobot data set: the arm of each side without its gripper, by the names of the numbers."""
    data = data_set_of(path)
    for column, names in ({} if data is None else data.names).items():
        if len(names) != widths.get(column, 0):
            continue
        sides: dict[str, list[int]] = {}
        for index, name in enumerate(names):
            side = SIDES.search(name)
            if not FINGERS.search(name):
                sides.setdefault(side[0].lower() if side else "", []).append(index)
        for indices in sides.values():
            joints = tuple(names[index] for index in indices)
            if len(indices) > 1:
                label, source = f"{column}: {joints[0]} … {joints[-1]}", {"column": column}
                entries = [index + 1 for index in indices]
                guess = {MEASURED: "position", DESIRED: Q_DESIRED}.get(column) or guess_of(column)
                yield SignalCandidate(label, {**source, "entries": entries}, False, guess, len(indices), joints)


def _of_named_joints(columns: Sequence[str]) -> Iterator[SignalCandidate]:
    """Columns of joints that have names: ``lift_position``, ``arm_1_position``, ... or ``tau_lift``, ``tau_arm_1``.

    The name of a joint stands between words before and words after. A group has the same word before or after, or the
    joints that occur between two pairs of words: ``q_hip``, ``q_knee`` are a group where ``q_des_hip``, ``q_des_knee``
    are others. Targets and measured signals are in different groups.
    """
    columns_by_joint: dict[str, dict[str, str]] = {}  # by the words before and after the joint
    for column in columns:
        words = list(WORD.finditer(column))
        for first, last in combinations_with_replacement(words, 2):
            pattern = f"{column[: first.start()]}…{column[last.end() :]}"
            if guess_of(pattern):
                columns_by_joint.setdefault(pattern, {})[column[first.start() : last.end()]] = column
    groups = {
        tuple(of_joint.values()): pattern
        for pattern, of_joint in columns_by_joint.items()
        if len(WORD.findall(pattern)) == 1
    }
    targets = {column for column in columns if COMMANDED.search(column)}
    several = [(pattern, of_joint) for pattern, of_joint in columns_by_joint.items() if len(of_joint) > 1]
    for (pattern, of_joint), (_, of_other) in permutations(several, 2):
        joints = of_joint.keys() & of_other.keys()
        if len(joints) < 2:
            continue
        members = tuple(column for joint, column in of_joint.items() if joint in joints)
        if members in groups or not (targets.isdisjoint(members) or targets.issuperset(members)):
            continue
        if len({re.sub(r"\d+", "", joint) for joint in joints}) > 1:  # numbered joints are a group already
            groups[members] = pattern
    for members, pattern in groups.items():
        if 1 < len(members) <= MAX_JOINT_NUMBERS:
            label, source = f"{members[0]} … {members[-1]}", {"columns": list(members)}
            yield SignalCandidate(label, source, False, guess_of(pattern), len(members))


def _in_arrays(path: Path) -> list[SignalCandidate]:
    candidates = []
    for name, shape in ArrayFile.shapes_of(path).items():
        if are_transforms(shape):
            label = f"{name} ({' × '.join(map(str, shape))})"
            candidates.append(SignalCandidate(label, {"array": name}, True, OBJECT_POSE, len(POSE_COLUMNS)))
            continue
        width = width_of(shape)
        if width < 2:
            continue
        pose = width == len(POSE_COLUMNS) and _is_of_an_object(name)
        guess = OBJECT_POSE if pose else guess_of(name)
        candidates.append(SignalCandidate(f"{name} ({shape[0]} × {shape[1]})", {"array": name}, pose, guess, width))
    return candidates


def vector_width(cells: Sequence[str] | NDArray[Any]) -> int:
    """Numbers per cell of a column; 0: it holds something else, or the cells differ."""
    if not isinstance(cells, list):
        return 1
    widths = {len(numbers_in(cell)) for cell in cells[:MAX_ROWS_READ] if cell.strip()}
    return widths.pop() if len(widths) == 1 else 0


def numbers_in(cell: str) -> list[float]:
    """Numbers of a cell, ``0.1 0.2`` or ``[0.1, 0.2]``; empty if it holds anything else."""
    try:
        return [decimal(part) for part in BETWEEN.split(cell.strip(BRACKETS)) if part]
    except ValueError:
        return []


def _is_of_an_object(name: str) -> bool:
    return "pose" in name.lower() or "object" in name.lower()


def guess_of(name: str) -> str:
    """The signal suggested by a name; empty: unknown."""
    low = name.lower()
    for part, signal in (("command|cmd|desired", "command"), ("ddq|qdd(?!es)|ddot|accel", "acceleration"),
                         ("vel|dq", "velocity"), ("pos", "position"), ("eff|tau|tor", "torque"), ("q", "position"),
                         ("curr|(^|[^a-z])i([^a-z]|$)", "torque")):  # fmt: skip
        if re.search(part, low):
            return signal
    return ""
