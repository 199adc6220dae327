# SPDX-License-Identifier: Apache-2.0
"""Columns of a table of impacts: names, units, ranges and meaning. Reading, writing, checks and documentation use them.

A header is a name and a unit in brackets, ``mass [kg]`` (:attr:`ColumnGroup.headers`). All vectors are in axes of the
world A; twists refer to the geometric centre; *before* and *after* are just before and just after the impact.

:func:`documentation` makes the table of the manual.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from impact_rs_sim.impact_map import measured
from impact_rs_sim.robots.robot import UNITS, RobotFacts
from impact_rs_sim.rotations import AXES

MAX_CONTACT_POINTS = 8  # of a row


@dataclass(frozen=True)
class Range:
    """Range of the numbers of a column.

    Attributes:
        words: The range in words, behind "expected".
        holds: Whether a number in SI units lies in it.
    """

    words: str
    holds: Callable[[float], bool]


ANY = Range("a number", lambda value: True)
POSITIVE = Range("a number > 0", lambda value: value >= sys.float_info.min)
NOT_NEGATIVE = Range("a number >= 0", lambda value: value >= 0.0)
SHARE = Range("a number between 0 and 1", lambda value: 0.0 <= value <= 1.0)
FLAG = Range("a number 0 (solid) or 1", lambda value: value in (0.0, 1.0))


@dataclass(frozen=True)
class ColumnGroup:
    """Columns of one quantity: all components of a vector, or a single column. A table has all of them or none.

    Attributes:
        names: Their names, without units.
        unit: SI unit; empty: a column of text.
        meaning: Description for the documentation.
        needed: Tables that need the columns, for the documentation.
        range: Range of the numbers.
        instead_of: Name of the column that these columns replace; empty: none.
    """

    names: tuple[str, ...]
    unit: str
    meaning: str
    needed: str = ""
    range: Range = ANY
    instead_of: str = ""

    def of_arm(self, label: str) -> ColumnGroup:
        """The columns of an arm with a label (:func:`arm_label`)."""
        return replace(self, names=tuple(label + name for name in self.names))

    @property
    def first(self) -> str:
        """The only name, or the first one."""
        return self.names[0]

    @property
    def headers(self) -> list[str]:
        """Names with their SI unit, as a table is written."""
        return [with_unit(name, self.unit) for name in self.names]

    @property
    def header(self) -> str:
        """The first of :attr:`headers`."""
        return self.headers[0]


@dataclass(frozen=True)
class JointColumnGroup:
    """Columns of one quantity of an arm: of its floating base, if it has one, then of all joints.

    Attributes:
        pattern: Name with ``{}`` for the number of the joint.
        quantity: Attribute of :class:`~impact_rs_sim.robots.robot.JointUnits` with the unit.
        meaning: Description for the documentation.
        needed: Tables that need the columns, for the documentation.
        range: Range of the numbers.
        of_base: Columns of the base.
    """

    pattern: str
    quantity: str
    meaning: str
    needed: str = ""
    range: Range = ANY
    of_base: tuple[ColumnGroup, ...] = ()

    def names(self, label: str, facts: RobotFacts) -> tuple[str, ...]:
        """Names for an arm; arguments as :meth:`of_arm`."""
        return tuple(name for column in self.of_arm(label, facts) for name in column.names)

    def of_arm(self, label: str, facts: RobotFacts) -> Iterator[ColumnGroup]:
        """The columns of a floating base, and a column for each joint of an arm, whose units may differ.

        Args:
            label: As :func:`arm_label`.
            facts: Its joints, and whether its base floats.
        """
        if facts.floating_base is not None:
            yield from (column.of_arm(label) for column in self.of_base)
        for joint, unit in enumerate(facts.units, start=1):
            name = label + self.pattern.format(joint)
            yield ColumnGroup((name,), getattr(unit, self.quantity), self.meaning, range=self.range)


def arm_label(arm: str, arms: Iterable[str]) -> str:
    """Prefix of the names of the columns of an arm: its name and a dot if there are several."""
    return f"{arm}." if len(tuple(arms)) > 1 else ""


def with_unit(name: str, unit: str) -> str:
    """A header: the name, and its unit in brackets if it has one."""
    return f"{name} [{unit}]" if unit else name


def name_and_unit(header: str) -> tuple[str, str]:
    """Name and unit of a header; the unit is empty without brackets."""
    name, _, unit = header.partition("[")
    return name.strip(), unit.strip().removesuffix("]").strip()


def is_joint_column(name: str) -> bool:
    """Whether a column of that name belongs to a joint or to the floating base of some arm."""
    return JOINT_NAME.fullmatch(name) is not None or name.rpartition(".")[2] in BASE_NAMES


def _vector(stem: str, tail: str = "") -> tuple[str, ...]:
    return tuple(f"{stem}{axis}{tail}" for axis in AXES)


POSITION = ColumnGroup(
    _vector(""), "m", "geometric centre of body or object (middle of its bounding box)", "not for a ball"
)
ORIENTATION = ColumnGroup(
    ("qx", "qy", "qz", "qw"), "-", "orientation: unit quaternion from its own axes to A", "not for a ball"
)
V_BEFORE = ColumnGroup(_vector("v", "_before"), "m/s", "velocity of the centre before", "yes")
W_BEFORE = ColumnGroup(_vector("w", "_before"), "rad/s", "angular velocity before", "yes")
V_AFTER = ColumnGroup(_vector("v", "_after"), "m/s", "velocity of the centre after", "yes, or a distance")
W_AFTER = ColumnGroup(_vector("w", "_after"), "rad/s", "angular velocity after; absent: not compared")
SLIDE_DISTANCE = ColumnGroup(
    ("slide_distance",),
    "m",
    "[measured later](your_data.md#outcomes-that-were-measured-later): horizontal distance from the impact to rest "
    "on the support; empty in a row with `flight_distance`",
    f"replaces `{V_AFTER.first}` ...",
    POSITIVE,
    V_AFTER.first,
)
FLIGHT_DISTANCE = ColumnGroup(
    ("flight_distance",),
    "m",
    "likewise: horizontal distance of the centre in a flight",
    f"replaces `{V_AFTER.first}` ...",
    POSITIVE,
    V_AFTER.first,
)
FALL_HEIGHT = ColumnGroup(
    ("fall_height",),
    "m",
    "fall of the centre in that flight; 0: down to the height of the impact",
    "flight",
    NOT_NEGATIVE,
    V_AFTER.first,
)
SUPPORT_FRICTION = ColumnGroup(
    (measured.SUPPORT_FRICTION,),
    "-",
    "measured Coulomb coefficient under the sliding object; absent or empty: the scenario's",
    range=POSITIVE,
    instead_of=V_AFTER.first,
)
DROP_HEIGHT = ColumnGroup(
    ("drop_height",),
    "m",
    "ball that bounces straight: height of its lowest point from which it falls",
    f"replaces `{V_BEFORE.first}` ...",
    POSITIVE,
)
FLIGHT_BEFORE = ColumnGroup(
    ("flight_before",), "s", "likewise: time since the bounce before", f"replaces `{V_BEFORE.first}` ...", POSITIVE
)
REBOUND_HEIGHT = ColumnGroup(
    ("rebound_height",), "m", "likewise: height to which it rises", f"replaces `{V_AFTER.first}` ...", NOT_NEGATIVE
)
FLIGHT_AFTER = ColumnGroup(
    ("flight_after",), "s", "likewise: time to the next bounce", f"replaces `{V_AFTER.first}` ...", NOT_NEGATIVE
)
MASS = ColumnGroup(("mass",), "kg", "mass; absent for an object: the scenario's", "free body", POSITIVE)
MOMENTS = ColumnGroup(
    ("ixx", "iyy", "izz"),
    "kg m^2",
    "principal moments about the centre of mass, along its own axes; absent: homogeneous",
    range=POSITIVE,
)
SHAPE = ColumnGroup(
    ("shape",),
    "",
    "shape of a free body: `box` (absent, empty), `sphere`, `capsule`, `cylinder` (axis z)",
)
MESH = ColumnGroup(
    ("mesh",),
    "",
    "in place of `shape`: mesh file, a path from the table's folder; gives hull, centre of mass, moments (even "
    "density), and absent extents",
)
SIZE = ColumnGroup(
    _vector("size_"),
    "m",
    "extent along its own axes; a free body needs it, a mesh, or contact points and moments",
    range=POSITIVE,
)
RADIUS = ColumnGroup(("radius",), "m", "radius of a free ball", range=POSITIVE)
SHELL = ColumnGroup(("shell",), "-", "ball: 1 hollow (2/3 m r²), 0 or absent solid (2/5 m r²)", range=FLAG)
POINTS = tuple(
    ColumnGroup(
        _vector("p", tail),
        "m",
        f"contact point in A; further ones `px2`, `py2`, `pz2` up to {MAX_CONTACT_POINTS}, empty if a row has fewer; "
        "all empty: from the geometry",
    )
    for tail in ("", *map(str, range(2, MAX_CONTACT_POINTS + 1)))
)
NORMAL = ColumnGroup(
    _vector("n"), "-", "unit normal into the body; absent: up, or of the nearest faces of pad and object"
)
FRICTION = ColumnGroup(
    (measured.FRICTION,),
    "-",
    "assumed Coulomb coefficient of a free body (absent: 0.3) or of pads (absent: the scenario's)",
    range=NOT_NEGATIVE,
)
RESTITUTION = ColumnGroup(
    (measured.RESTITUTION,), "-", "assumed Newton restitution; absent: 0, or the scenario's", range=SHARE
)
BASE_POSITION = ColumnGroup(_vector("base_"), "m", "position in A of a `floating_base`", "floating base")
BASE_ORIENTATION = ColumnGroup(
    ("base_qx", "base_qy", "base_qz", "base_qw"),
    "-",
    "its orientation: unit quaternion from its own axes to A",
    "floating base",
)
OF_BASE_BEFORE = (
    ColumnGroup(
        _vector("base_v", "_before"),
        "m/s",
        "its velocity before, in its own axes, as in ROS odometry",
        "floating base",
    ),
    ColumnGroup(_vector("base_w", "_before"), "rad/s", "its angular velocity before, in its own axes", "floating base"),
)
OF_BASE_AFTER = (
    ColumnGroup(_vector("base_v", "_after"), "m/s", "its velocity after, in its own axes", "with `dq1_after`"),
    ColumnGroup(
        _vector("base_w", "_after"), "rad/s", "its angular velocity after, in its own axes", "with `dq1_after`"
    ),
)
Q = JointColumnGroup(
    "q{}",
    "position",
    "joint positions, in the order of the robot's file without joints that follow others; of several arms `left.q1` "
    "...",
    "arm",
    of_base=(BASE_POSITION, BASE_ORIENTATION),
)
DQ_BEFORE = JointColumnGroup("dq{}_before", "velocity", "joint velocities before", "arm", of_base=OF_BASE_BEFORE)
DQ_AFTER = JointColumnGroup(
    "dq{}_after",
    "velocity",
    "joint velocities after; absent: not compared",
    of_base=OF_BASE_AFTER,
)
MOTOR_INERTIA = JointColumnGroup(
    "B{}",
    "inertia",
    "assumed motor inertia; absent: B_θ of the scenario",
    range=NOT_NEGATIVE,
)
OBJECT = ColumnGroup(("object",), "", "the scenario's object; needed if it has several")
CONDITION = ColumnGroup(("condition",), "", "rows of one condition are repeats")
TIME = ColumnGroup(("time",), "s", "time of the measurement, the order of `follow`")
TOLERANCE = ColumnGroup(
    ("contact_tolerance",),
    "m",
    "largest distance of a touching point beyond the nearest one; absent: `--contact-tolerance`",
    range=NOT_NEGATIVE,
)
V_NOISE = ColumnGroup(
    ("v_noise",),
    "m/s",
    "standard deviation of a measured change of velocity; absent next to other noise: unknown",
    range=NOT_NEGATIVE,
)
W_NOISE = ColumnGroup(("w_noise",), "rad/s", "likewise, of angular velocity", range=NOT_NEGATIVE)
DQ_NOISE = ColumnGroup(
    ("dq_noise",), "rad/s", "likewise, of joint velocity, and of the twist of a floating base", range=NOT_NEGATIVE
)
DISTANCE_NOISE = ColumnGroup(
    ("distance_noise",), "m", "likewise, of a distance", range=NOT_NEGATIVE, instead_of=V_AFTER.first
)
HEIGHT_NOISE = ColumnGroup(("height_noise",), "m", "likewise, of the heights of a bouncing ball", range=NOT_NEGATIVE)
FLIGHT_NOISE = ColumnGroup(("flight_noise",), "s", "likewise, of the times between its bounces", range=NOT_NEGATIVE)
V_NOISE_AXES = ColumnGroup(
    _vector("v_noise_"),
    "m/s",
    f"`{V_NOISE.first}` along each axis of A, in its place",
    range=NOT_NEGATIVE,
)
W_NOISE_AXES = ColumnGroup(
    _vector("w_noise_"), "rad/s", f"`{W_NOISE.first}` along each axis of A, in its place", range=NOT_NEGATIVE
)
P_NOISE = ColumnGroup(
    ("p_noise",),
    "m",
    "standard deviation of all contact points together, along each axis",
    range=NOT_NEGATIVE,
)
N_NOISE = ColumnGroup(
    ("n_noise",),
    "rad",
    "standard deviation of their normal, about each tangent",
    range=NOT_NEGATIVE,
)

DISTANCES = (SLIDE_DISTANCE, FLIGHT_DISTANCE)
FLIGHTS_BEFORE, FLIGHTS_AFTER = (DROP_HEIGHT, FLIGHT_BEFORE), (REBOUND_HEIGHT, FLIGHT_AFTER)
CONTACT_NOISE = (P_NOISE, N_NOISE)
COLUMNS: tuple[ColumnGroup, ...] = (
    POSITION, ORIENTATION, V_BEFORE, V_AFTER, W_BEFORE, W_AFTER, *DISTANCES, FALL_HEIGHT, SUPPORT_FRICTION,
    *FLIGHTS_BEFORE, *FLIGHTS_AFTER, MASS, MOMENTS, SHAPE, MESH, SIZE, RADIUS, SHELL, *POINTS, NORMAL, FRICTION,
    RESTITUTION, OBJECT, CONDITION, TIME, TOLERANCE, V_NOISE, W_NOISE, DQ_NOISE, DISTANCE_NOISE, HEIGHT_NOISE,
    FLIGHT_NOISE, V_NOISE_AXES, W_NOISE_AXES, *CONTACT_NOISE,
)  # fmt: skip
JOINT_COLUMNS = (Q, DQ_BEFORE, DQ_AFTER, MOTOR_INERTIA)

_STEMS, _TAILS = (
    "|".join(dict.fromkeys(columns.pattern.split("{}")[part] for columns in JOINT_COLUMNS)) for part in (0, 1)
)
BASE_NAMES = frozenset(name for joints in JOINT_COLUMNS for column in joints.of_base for name in column.names)
JOINT_NAME = re.compile(rf"(?:.+\.)?(?:{_STEMS})[0-9]+(?:{_TAILS})")  # of any arm

# Written by impact-rs impacts, so that a row can be found again; not read.
RUN = ColumnGroup(("run",), "", "run in which the impact was found")
SESSION = ColumnGroup(("session",), "", "session of that run")
IMPACT_TIME = ColumnGroup(("impact_time",), "s", "when, since the start of the run")
LAW = ColumnGroup(("law after",), "", "law that was fitted to the motion after the impact")


def documentation() -> str:
    """The table of columns in Markdown."""
    rows = []
    for column in COLUMNS:
        if column not in POINTS[1:]:
            rows.append((", ".join(f"`{name}`" for name in column.names), column.unit, column.needed, column.meaning))
        if column == RESTITUTION:
            for joints in JOINT_COLUMNS:
                first, second = (joints.pattern.format(joint) for joint in (1, 2))
                unit = getattr(UNITS["revolute"], joints.quantity)
                rows.append((f"`{first}`, `{second}` ...", unit, joints.needed, joints.meaning))
            for base in (column for joints in JOINT_COLUMNS for column in joints.of_base):
                rows.append((", ".join(f"`{name}`" for name in base.names), base.unit, base.needed, base.meaning))
    lines = [("Column", "Unit", "Needed", "Meaning"), ("---",) * 4, *rows]
    text = "\n".join("|" + "|".join(f" {cell} " if cell else " " for cell in line) + "|" for line in lines)
    return text.replace("| --- | --- | --- | --- |", "|---|---|---|---|").replace("kg m^2", "kg m²")
