# SPDX-License-Identifier: Apache-2.0
"""Impact tables: one row per impact and nothing else, as CSV or Parquet.

Two kinds of rows. Without joint positions **one free body hits a fixed plane**: a tossed cube, or a ball on a racket so
heavy that it goes on as it was (velocities are then those relative to it). With them
**an arm (or two) hits an object**; robots, pads and support are then those of a scenario. A column is headed by its
name and its unit in brackets, ``mass [kg]``. Everything is in axes of the world A, twists are those of the geometric
centre, and *before* and *after* are just before and just after the impact.

==========================================  ========  ============================================================
column                                      unit      what it is
==========================================  ========  ============================================================
``x`` ``y`` ``z``                           m         geometric centre of the body, or of the object; of a ball optional
``qx`` ``qy`` ``qz`` ``qw``                 -         its orientation: unit quaternion from its own axes to A; of a ball
                                                      optional
``vx_before`` ... ``vz_before``             m/s       velocity of the centre just before
``wx_before`` ... ``wz_before``             rad/s     angular velocity just before
``vx_after`` ... ``vz_after``               m/s       velocity of the centre just after; or, measured later:
``slide_distance``                          m         horizontal way from the impact to rest, on the support of an arm's
                                                      object; empty in a row with a ``flight_distance``
``flight_distance``                         m         horizontal way of the centre while it flies and falls
``fall_height``                             m         by how much it falls in that flight
``support_friction``                        -         Coulomb coefficient of that support, as measured; absent or empty:
                                                      that of the scenario
``wx_after`` ... ``wz_after``               rad/s     angular velocity just after; without any, velocities of the
                                                      centre and of joints are compared
``mass``                                    kg        mass; of an object: that of the scenario where it is absent
``ixx`` ``iyy`` ``izz``                     kg m^2    principal moments about the centre, along the body's own axes;
                                                      absent: of a homogeneous box of that size, or of a ball
``size_x`` ``size_y`` ``size_z``            m         extent of the box along its own axes; of a free body optional
                                                      where contact points are given
``radius``                                  m         of a free body that is a ball; it touches below its centre
``shell``                                   -         of a ball: 1 hollow, 2/3 m r^2; 0 or absent solid, 2/5 m r^2
``px`` ``py`` ``pz``                        m         contact point; further ones ``px2`` ``py2`` ``pz2`` and so on,
                                                      empty where a row has fewer. Absent or all empty: from the
                                                      geometry
``nx`` ``ny`` ``nz``                        -         unit normal into the body; absent: up, or that of the nearest
                                                      faces of pad and object
``friction``                                -         Coulomb coefficient that is assumed: of a free body on its plane
                                                      (absent: 0.3), of pads on an object (absent: the scenario's)
``restitution``                             -         Newton restitution that is assumed; absent: 0, or the scenario's
``q1`` ``q2`` ...                           rad       joint positions; with several arms ``left.q1`` and so on
``dq1_before`` ... , ``dq1_after`` ...      rad/s     joint velocities just before and just after; without any after,
                                                      the object alone is compared
``B1`` ``B2`` ...                           kg m^2    motor inertia that is assumed; absent: B_theta of the scenario
``object``                                            name of the scenario's object; absent: its only one
``condition``                                         rows of one condition are repeats of each other
``time``                                    s         when the row was measured, from any moment on
``contact_tolerance``                       m         how much further off than the nearest a point may be that touches,
                                                      where the geometry says which do: pose noise times the width
``v_noise`` ``w_noise`` ``dq_noise``        m/s or    standard deviation of a measured change of velocity, where it is
                                            rad/s     known
``v_noise_x`` ... ``w_noise_x`` ...         m/s or    the same along each axis of A, in the place of ``v_noise`` and
                                            rad/s     ``w_noise``
``distance_noise``                          m         of a distance, likewise
``p_noise``                                 m         standard deviation of the place of the contact points, which move
                                                      together; counts as noise of the prediction
``n_noise``                                 rad       of the direction of their normal, about either tangent; likewise
==========================================  ========  ============================================================

Lengths may also be in mm, masses in g, angles in deg. Any column may also be declared a covariate: a circumstance
under which rows were measured, a number or the name of a level. Other columns are left alone. Cells of a CSV file are
separated by commas, semicolons or tabs; empty lines and lines that begin with # are skipped.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.decimals import decimal
from impact_rs_sim.errors import Infeasible, InputError, did_you_mean
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.impact_map.measured import (
    FRICTION,
    RESTITUTION,
    SUPPORT_FRICTION,
    MeasuredImpact,
    corners_that_touch,
    points_of_scene,
    points_on_plane,
)
from impact_rs_sim.optional_packages import require
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_trials.recordings.csv_rows import csv_rows
from impact_rs_trials.recordings.distances import Distance
from impact_rs_trials.recordings.unsure_scene import known_of_scene, with_another
from impact_rs_trials.since import measured_since

SUFFIXES = (".csv", ".parquet")
FACTORS: dict[str, dict[str, float]] = {  # from the unit of a header to SI
    "s": {"s": 1.0, "ms": 1e-3},
    "m": {"m": 1.0, "mm": 1e-3},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "rad": {"rad": 1.0, "deg": np.pi / 180.0},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180.0},
    "kg": {"kg": 1.0, "g": 1e-3},
    "kg m^2": {"kg m^2": 1.0},
    "-": {"-": 1.0, "": 1.0},
    "": {"": 1.0, "-": 1.0},
}
ASSUMED_FRICTION = 0.3  # of a free body on a plane, where a table says nothing; dry solids lie around it
UNIT_LENGTH = 1e-3  # how far a unit quaternion or a normal may be from length 1; what remains is rounding
MOMENTS = 1e-3  # by how much a moment of inertia may exceed the sum of the others: rounding
UP = np.array([0.0, 0.0, 1.0])
AXES = "xyz"
MOST_POINTS = 8  # contact points that a row may name
WIDER = 4.0  # tolerances; points between a quarter of one and so many may touch or not
TOLERANCE = "contact_tolerance"
TIME = "time"
OF_BODY = ("mass", "ixx", "iyy", "izz", "size_x", "size_y", "size_z", "radius")  # columns that may be unsure
UNSEEN_GEOMETRY = {  # what else may be unsure, 0 in a table: its unit
    "offset_x": "m",  # of the tracked point from the centre, along the body's own axes
    "offset_y": "m",
    "offset_z": "m",
    "tilt_x": "rad",  # of the plane's normal about x and y of A
    "tilt_y": "rad",
}
DISTANCES = ("slide_distance", "flight_distance")
OF_DISTANCES = (*DISTANCES, "fall_height", SUPPORT_FRICTION, "distance_noise")  # not read beside velocities just after
OF_CONTACTS = ("p_noise", "n_noise")
SWEPT = (0.25, 0.5, 1.0)  # shares of the way from the assumed value to either end of a range
LARGEST = 1e12  # in any unit; no measured number is larger, and squares of much larger ones are infinite
SLIP = 0.75  # likeness from which an unknown column is taken for a slip of the pen


@dataclass(frozen=True)
class ImpactRow:
    """One impact.

    Attributes:
        number: Row of the table, counted from 1 without the header.
        condition: Name of the condition that it repeats; empty: unknown.
        object_name: Name of the object; empty: a free body.
        physics: Nominal physics; rows with the same nominal physics share one.
        impact: State just before, and contact points.
        after: Measured u^+, joint velocities of every arm and then the twist of the centre, ``(nv,)`` [rad/s, m/s].
        wider: The impact with more contact points, those within ``WIDER`` tolerances; None: there are no more.
        narrower: The impact with fewer, those within a tolerance over ``WIDER`` (no pose is known better than
            ``GAP_TOLERANCE``); None: there are no fewer.
        time: When it was measured, seconds since 1970 or since any other moment [s]; None: not known.
        circumstances: Its covariates by name, numbers or names of levels.
        distance: How far the object went afterwards, where that was measured in place of its velocity.
        contact_noise: Standard deviations of the place of the contact points [m] and of their normal [rad].
    """

    number: int
    condition: str
    object_name: str
    physics: Physics
    impact: MeasuredImpact
    after: Array
    wider: MeasuredImpact | None = None
    narrower: MeasuredImpact | None = None
    time: float | None = None
    circumstances: Mapping[str, float | str] = field(default_factory=dict)
    distance: Distance | None = None
    contact_noise: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Variant:
    """A table read with another value of something that is not known well.

    Attributes:
        of: What it is: a column of the body, an ``UNSEEN_GEOMETRY``, or a number of the scenario
            (:mod:`impact_rs_trials.recordings.unsure_scene`).
        value: Its value, in the unit; of a column whose rows differ, their mean.
        unit: Unit.
        table: The table with it.
    """

    of: str
    value: float
    unit: str
    table: ImpactTable


@dataclass(frozen=True)
class ImpactTable:
    """A table of impacts.

    Attributes:
        path: Its file.
        digest: Of its bytes.
        rows: Its impacts.
        arms: Names of the arms; empty: free bodies.
        joints: Whether joint velocities after the impact were measured.
        centre: Whether velocities of the centre after the impact were measured; if not, distances were.
        turning: Whether angular velocities after the impact were measured.
        tolerance: How much further off than the nearest a point may be that touches [m]; of rows that say it
            themselves, their mean.
        noise: Standard deviation of a measured change of velocity in the order of ``after``, ``(rows, nv)``
            [rad/s, m/s], nan of what was not measured; None: said nowhere.
        assumed: Assumptions where the table has no column, as text.
        unread: Columns that are not used.
        covariates: Units of the covariates by name; empty where a header says none.
        variants: The table with other values of what is not known well, over its range.
    """

    path: Path
    digest: str
    rows: tuple[ImpactRow, ...]
    arms: tuple[str, ...]
    noise: Array | None
    assumed: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    joints: bool = True
    centre: bool = True
    turning: bool = True
    tolerance: float = GAP_TOLERANCE
    covariates: Mapping[str, str] = field(default_factory=dict)
    variants: tuple[Variant, ...] = ()

    def since(self, when: str) -> ImpactTable:
        """The rows that were measured from a moment on.

        Args:
            when: A row, ``row 7``, or a time in column ``time`` (:func:`impact_rs_trials.since.measured_since`).

        Raises:
            InputError: There is no such moment.
        """
        stamps = {name_of_row(row.number): row.number if row.time is None else row.time for row in self.rows}
        found = measured_since(when, stamps, all(row.time is not None for row in self.rows))
        part = self.part([place for place, row in enumerate(self.rows) if name_of_row(row.number) in found])
        digest = hashlib.sha256(f"{self.digest} {sorted(found)}".encode()).hexdigest()[: len(self.digest)]
        return replace(part, digest=digest)

    def part(self, places: Sequence[int]) -> ImpactTable:
        """Some rows, by position."""
        noise = None if self.noise is None else self.noise[list(places)]
        variants = tuple(replace(one, table=one.table.part(places)) for one in self.variants)
        return replace(self, rows=tuple(self.rows[place] for place in places), noise=noise, variants=variants)


def name_of_row(number: int) -> str:
    """Name of a row, counted from 1 without the header."""
    return f"row {number}"


def read_impact_table(
    path: Path,
    scenario: Scenario | None = None,
    questions: bool = False,
    tolerance: float = GAP_TOLERANCE,
    covariates: Sequence[str] = (),
    unsure: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> ImpactTable:
    """Read a table of impacts.

    Args:
        path: CSV or Parquet file.
        scenario: Robots, pads and support of rows of arms; None: rows of free bodies.
        questions: Whether the rows ask for the velocities after: their columns may be absent and are not read.
        tolerance: How much further off than the nearest a point may be that touches [m].
        covariates: Names of the columns that say under which circumstances a row was measured. A column of numbers is
            a number, in the unit of its header; any other holds names of levels.
        unsure: Ranges of what is not known well, in SI units: of columns of the body, whose rows keep their ratios, of
            ``UNSEEN_GEOMETRY``, or of numbers of the scenario (:mod:`impact_rs_trials.recordings.unsure_scene`).

    Raises:
        InputError: It cannot be read, a column is missing or has another unit, or a row is no impact; the message names
            row and column, what is there, and what was expected.
    """
    header, cells, digest = _read(path)
    reader = _Reader(path, header, cells, scenario, questions, tolerance, tuple(covariates))
    table, found = reader.table(digest), []
    for name, (low, high) in unsure.items():
        assumed, unit = reader.assumed_geometry(name)
        values = {
            assumed + share * (end - assumed) for end in (low, high) for share in SWEPT if not np.isclose(end, assumed)
        }
        for value in sorted(values):
            try:
                other = reader.with_geometry(name, value, assumed).table(digest)
            except InputError as error:
                raise InputError(
                    f"with {name} = {value:.4g} {unit}: {error.message}", file=path, key=error.key
                ) from None
            found.append(Variant(name, value, unit, other))
    return replace(table, variants=tuple(found))


Cells = list[dict[str, Any]]


def _read(path: Path) -> tuple[list[str], Cells, str]:
    """Headers, rows and digest of a file."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"expected a table of impacts ({' or '.join(SUFFIXES)})", file=path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    if not data:
        raise InputError("this file is empty", file=path)
    header, rows = (_csv if path.suffix == ".csv" else _parquet)(path)
    if len(set(header)) != len(header):
        twice = sorted({name for name in header if header.count(name) > 1})
        raise InputError(f"columns that appear twice: {', '.join(twice)}", file=path)
    if not rows:
        raise InputError("no rows; expected one per impact", file=path)
    return header, rows, hashlib.sha256(data).hexdigest()


def _csv(path: Path) -> tuple[list[str], Cells]:
    lines = csv_rows(path)
    if not lines:
        raise InputError("no header; expected names of columns with their units", file=path)
    (_, header), *rows = lines
    header = [name.strip() for name in header]
    for number, (_, row) in enumerate(rows, start=1):
        if len(row) != len(header):
            said = f"expected {len(header)} cells as in the header, got {len(row)}"
            raise InputError(said, file=path, key=_row(number))
    return header, [dict(zip(header, row, strict=True)) for _, row in rows]


def _parquet(path: Path) -> tuple[list[str], Cells]:
    require("pyarrow", path)
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
        names = [str(name).strip() for name in table.column_names]
        rows = [{str(name).strip(): value for name, value in row.items()} for row in table.to_pylist()]
    except Exception as error:  # a damaged file can fail anywhere inside the library
        text = (str(error).splitlines() or [""])[0]
        raise InputError(f"not a readable Parquet file ({type(error).__name__}: {text})", file=path) from None
    return names, rows


def _row(number: int) -> str:
    return f"row {number}"


def _name_and_unit(header: str) -> tuple[str, str]:
    """Name of a column, and its unit in brackets; empty without one."""
    name, _, unit = header.partition("[")
    return name.strip(), unit.strip().removesuffix("]").strip()


def _numbers(texts: Sequence[str]) -> list[float] | None:
    """Numbers of all cells of a column; None where one is something else."""
    try:
        return [decimal(text) for text in texts]
    except ValueError:
        return None


def _triple(stem: str, tail: str = "") -> list[str]:
    return [f"{stem}{axis}{tail}" for axis in AXES]


POSE = {**dict.fromkeys(_triple(""), "m"), **dict.fromkeys(("qx", "qy", "qz", "qw"), "-")}
TWISTS = {
    **dict.fromkeys([*_triple("v", "_before"), *_triple("v", "_after")], "m/s"),
    **dict.fromkeys([*_triple("w", "_before"), *_triple("w", "_after")], "rad/s"),
}
BODY = {
    "mass": "kg",
    **dict.fromkeys(("ixx", "iyy", "izz"), "kg m^2"),
    **dict.fromkeys(_triple("size_"), "m"),
    "radius": "m",
    "shell": "-",
    **dict.fromkeys(_triple("n"), "-"),
    **{name + tail: "m" for tail in ("", *map(str, range(2, MOST_POINTS + 1))) for name in _triple("p")},
    FRICTION: "-",
    RESTITUTION: "-",
    "slide_distance": "m",
    "flight_distance": "m",
    "fall_height": "m",
    SUPPORT_FRICTION: "-",
    "v_noise": "m/s",
    "w_noise": "rad/s",
    "dq_noise": "rad/s",
    **dict.fromkeys(_triple("v_noise_"), "m/s"),
    **dict.fromkeys(_triple("w_noise_"), "rad/s"),
    "distance_noise": "m",
    "p_noise": "m",
    "n_noise": "rad",
    TOLERANCE: "m",
    TIME: "s",
    "condition": "",
    "object": "",
}
JOINT_COLUMN = re.compile(r"(?:(?P<arm>.+)\.)?(?:q|dq|B)[0-9]+(?:_before|_after)?")


@dataclass
class _Reader:
    """Turns cells into impacts.

    Attributes:
        path: File, for messages.
        header: Headers of the file.
        cells: Rows by header.
        scenario: Of rows of arms.
        questions: Whether velocities after the impact are to be predicted.
        tolerance: How much further off than the nearest a point may be that touches [m].
        covariates: Names of the columns that say under which circumstances a row was measured.
        geometry: Factors of columns of the body, and values of ``UNSEEN_GEOMETRY`` [m, rad].
    """

    path: Path
    header: list[str]
    cells: Cells
    scenario: Scenario | None
    questions: bool = False
    tolerance: float = GAP_TOLERANCE
    covariates: tuple[str, ...] = ()
    geometry: Mapping[str, float] = field(default_factory=dict)
    _where: dict[str, str] = field(default_factory=dict)  # header by name of a column
    _factor: dict[str, float] = field(default_factory=dict)
    _unit: dict[str, str] = field(default_factory=dict)
    _physics: dict[tuple[Any, ...], tuple[Physics, dict[str, RobotModel]]] = field(default_factory=dict)

    def table(self, digest: str) -> ImpactTable:
        """All rows, checked."""
        declared = self._declared()
        unread = [text for text in self._columns() if text not in declared.values()]
        if self._centre_after:
            unread += [self._where[name] for name in OF_DISTANCES if name in self._where]
        self._demand()
        circumstances = self._circumstances(declared)
        rows = tuple(
            replace(self._impact(number, cells), circumstances=own)
            for number, (cells, own) in enumerate(zip(self.cells, circumstances, strict=True), start=1)
        )
        noise, assumed = self._noise(rows), self._assumed()
        tolerances = [self._tolerance(number, cells) for number, cells in enumerate(self.cells, start=1)]
        return ImpactTable(
            path=self.path,
            digest=digest,
            rows=rows,
            arms=self._arms,
            noise=noise,
            assumed=assumed,
            unread=tuple(unread),
            joints=self._joints_after,
            centre=self._centre_after,
            turning=self._turning_after,
            tolerance=float(np.mean(tolerances)),
            covariates={name: _name_and_unit(text)[1] for name, text in declared.items()},
        )

    def assumed_geometry(self, name: str) -> tuple[float, str]:
        """What a table that was read assumes of something that may be unsure, and its SI unit.

        Raises:
            InputError: There is nothing of that name here.
        """
        known = [column for column in OF_BODY if column in self._where]
        known += [own for own in UNSEEN_GEOMETRY if not (self._arms and own.startswith("tilt"))]
        if not self._turning_after:
            known = [own for own in known if not own.startswith("offset")]
        known += [SUPPORT_FRICTION] if self._scales(SUPPORT_FRICTION) else []
        of_scene = {} if self.scenario is None else known_of_scene(self.scenario)
        known += [own for own in of_scene if own not in known]
        if name not in known:
            raise InputError(
                f"nothing called {name!r} can be unsure here{did_you_mean(name, known)}; known: {', '.join(known)}",
                file=self.path,
                key="--unsure",
            )
        if name in UNSEEN_GEOMETRY:
            return 0.0, UNSEEN_GEOMETRY[name]
        if not self._scales(name):
            return of_scene[name]
        rows = [(number, cells) for number, cells in enumerate(self.cells, start=1) if self._text(cells, name)]
        return float(np.mean([self._value(number, cells, name) for number, cells in rows])), BODY[name]

    def _scales(self, name: str) -> bool:
        """Whether something that may be unsure is a column, whose rows keep their ratios."""
        return name in self._where and (name in OF_BODY or (name == SUPPORT_FRICTION and not self._centre_after))

    def with_geometry(self, name: str, value: float, assumed: float) -> _Reader:
        """A reader of the same table with another value of something that may be unsure.

        Args:
            name: What.
            value: Its value, in SI units.
            assumed: What :meth:`assumed_geometry` says of it.
        """
        if self._scales(name) or name in UNSEEN_GEOMETRY:
            own = value / assumed if self._scales(name) else value
            return replace(self, geometry={name: own}, _physics={})
        assert self.scenario is not None
        return replace(self, scenario=with_another(self.scenario, name, value), _physics={})

    def _declared(self) -> dict[str, str]:
        """Headers of the covariates by their names."""
        there = {_name_and_unit(text)[0]: text for text in self.header}
        for place, name in enumerate(self.covariates):
            if name in self.covariates[:place]:
                raise InputError(f"column {name!r} is named twice", file=self.path, key="--covariates")
            if name not in there:
                raise InputError(
                    f"no column {name!r}{did_you_mean(name, there)}; there are: {', '.join(there)}",
                    file=self.path,
                    key="--covariates",
                )
        return {name: there[name] for name in self.covariates}

    def _circumstances(self, declared: Mapping[str, str]) -> list[dict[str, float | str]]:
        """Covariates of every row: numbers where a whole column holds such, else names of levels."""
        found: list[dict[str, float | str]] = [{} for _ in self.cells]
        for name, text in declared.items():
            levels = ["" if cells[text] is None else str(cells[text]).strip() for cells in self.cells]
            for number, level in enumerate(levels, start=1):
                if not level:
                    raise self._wrong(number, f"column {text!r}", None, "this cell is empty; a covariate has a value")
            values: Sequence[float | str] = _numbers(levels) or levels
            for number, value in enumerate(values, start=1):
                if isinstance(value, float) and not np.isfinite(value):
                    raise self._wrong(number, f"column {text!r}", value, "expected a finite number")
            for own, value in zip(found, values, strict=True):
                own[name] = value
        return found

    @property
    def _arms(self) -> tuple[str, ...]:
        return () if self.scenario is None else tuple(self.scenario.robots)

    @property
    def _is_ball(self) -> bool:
        return "radius" in self._where

    @property
    def _joints_after(self) -> bool:
        """Whether some joint has a velocity after the impact."""
        columns = (name for arm in self._arms for name in self._of_joints(arm, "dq", "_after"))
        return any(name in self._where for name in columns)

    @property
    def _centre_after(self) -> bool:
        """Whether the velocity of the centre after the impact is asked for: no distance stands in its place."""
        given = any(name in self._where for name in _triple("v", "_after"))
        return given or not any(name in self._where for name in DISTANCES)

    @property
    def _turning_after(self) -> bool:
        """Whether the body has an angular velocity after the impact."""
        return any(name in self._where for name in _triple("w", "_after"))

    def _tolerance(self, number: int, cells: Mapping[str, Any]) -> float:
        """How much further off than the nearest a point of a row may be that touches [m]."""
        if TOLERANCE not in self._where:
            return self.tolerance
        value = self._value(number, cells, TOLERANCE)
        if value < 0.0:
            raise self._wrong(number, f"column {self._where[TOLERANCE]!r}", value, "expected a distance >= 0 [m]")
        return value

    def _joints(self, arm: str) -> int:
        assert self.scenario is not None
        return self.scenario.robots[arm].robot_facts.joint_count

    def _label(self, arm: str) -> str:
        return f"{arm}." if len(self._arms) > 1 else ""

    def _of_joints(self, arm: str, stem: str, tail: str = "") -> list[str]:
        return [f"{self._label(arm)}{stem}{joint + 1}{tail}" for joint in range(self._joints(arm))]

    def _with_units(self, arm: str, names: list[str], quantity: str) -> dict[str, str]:
        """Columns of an arm's joints with their units."""
        assert self.scenario is not None
        units = self.scenario.robots[arm].robot_facts.units
        return {name: getattr(unit, quantity) for name, unit in zip(names, units, strict=True)}

    def _state_of(self, arm: str) -> dict[str, str]:
        """Columns of positions and velocities of an arm's joints with their units."""
        return {
            **self._with_units(arm, self._of_joints(arm, "q"), "position"),
            **self._with_units(arm, self._of_joints(arm, "dq", "_before"), "velocity"),
            **self._with_units(arm, self._of_joints(arm, "dq", "_after"), "velocity"),
        }

    def _columns(self) -> list[str]:
        """Find the columns that are known, with their units; returns the others."""
        known = {**POSE, **TWISTS, **BODY}
        for arm in self._arms:
            known |= self._state_of(arm)
            known |= self._with_units(arm, self._of_joints(arm, "B"), "inertia")
        unread = []
        for text in self.header:
            name, unit = _name_and_unit(text)
            if name not in known:
                unread.append(text)
                continue
            factors = FACTORS[known[name]]
            if unit not in factors:
                said = f"unit {unit!r}" if "[" in text else "no unit"
                expected = " or ".join(f"'{name} [{one}]'" for one in factors if one)
                raise InputError(f"column {text!r} has {said}; expected {expected}", file=self.path)
            self._where[name], self._factor[name], self._unit[name] = text, factors[unit], unit or known[name]
        undeclared = [text for text in unread if _name_and_unit(text)[0] not in self.covariates]
        joints = [text for text in undeclared if JOINT_COLUMN.fullmatch(_name_and_unit(text)[0])]
        if joints and self.scenario is None:
            raise InputError(
                f"column {joints[0]!r} is of an arm; --scenario NAME says which robot, pad and support there were",
                file=self.path,
            )
        if joints:
            expected = ", ".join(f"{arm} has {self._joints(arm)}" for arm in self._arms)
            raise InputError(
                f"column {joints[0]!r} is of no joint of scenario {self._name} ({expected})", file=self.path
            )
        free = [name for name in known if name not in self._where]
        for text in undeclared:
            name = _name_and_unit(text)[0]
            if close := get_close_matches(name, free, n=1, cutoff=SLIP):
                unit = known[close[0]]
                meant = f"{close[0]} [{unit}]" if unit else close[0]
                raise InputError(f"no column is called {text!r}; did you mean {meant!r}?", file=self.path)
        return unread

    @property
    def _name(self) -> str:
        return "" if self.scenario is None else repr(self.scenario.name)

    def _demand(self) -> None:
        """Refuse a table that lacks a column."""
        self._demand_of_a_ball()
        needed = dict(TWISTS) if self._is_ball else {**POSE, **TWISTS}
        for group in (_triple(""), ["qx", "qy", "qz", "qw"]):
            if any(name in self._where for name in group):
                needed |= {name: POSE[name] for name in group}
        for arm in self._arms:
            needed |= self._state_of(arm)
            if not self._joints_after:
                needed = {
                    name: unit for name, unit in needed.items() if name not in self._of_joints(arm, "dq", "_after")
                }
        if not self._turning_after:
            needed = {name: unit for name, unit in needed.items() if name not in _triple("w", "_after")}
        if not self._centre_after:
            needed = {name: unit for name, unit in needed.items() if name not in _triple("v", "_after")}
            self._demand_of_distances()
        if self.scenario is None:
            needed["mass"] = "kg"
        of_noise = [_triple(f"{stem}_noise_") for stem in "vw"]
        for group in (_triple("n"), _triple("size_"), ["ixx", "iyy", "izz"], *of_noise, *self._point_columns()):
            if any(name in self._where for name in group):
                needed |= {name: BODY[name] for name in group}
        if any(f"{self._label(arm)}B1" in self._where for arm in self._arms):
            for arm in self._arms:
                needed |= self._with_units(arm, self._of_joints(arm, "B"), "inertia")
        for name, unit in needed.items():
            if self.questions and name.endswith("_after"):
                continue
            if name not in self._where:
                wanted = f"{name} [{unit}]"
                others = set(self.header) - set(self._where.values())
                raise InputError(
                    f"no column {wanted!r}{did_you_mean(wanted, others)}; there are: {', '.join(self.header)}",
                    file=self.path,
                )
        shaped = "size_x" in self._where or self._is_ball
        if self.scenario is None and not (shaped or "px" in self._where):
            raise InputError(
                "nothing says where the body touches; expected its size ('size_x [m]' ...) or contact points "
                f"('px [m]' ...); there are: {', '.join(self.header)}",
                file=self.path,
            )
        if self.scenario is None and not (shaped or "ixx" in self._where):
            raise InputError(
                "nothing says how hard the body is to turn; expected principal moments ('ixx [kg m^2]' ...) or its "
                f"size ('size_x [m]' ...); there are: {', '.join(self.header)}",
                file=self.path,
            )

    def _demand_of_distances(self) -> None:
        """Refuse a table with a distance that no law makes of a velocity."""
        if "slide_distance" in self._where and self.scenario is None:
            where = self._where["slide_distance"]
            said = "a free body has no support on which it slides; flight_distance and fall_height say how far it flew"
            raise InputError(f"column {where!r}: {said}", file=self.path)
        if "flight_distance" in self._where and "fall_height" not in self._where:
            where = self._where["flight_distance"]
            raise InputError(f"column {where!r} without 'fall_height [m]': how far the centre fell", file=self.path)
        if self._turning_after:
            names = [self._where[name] for name in DISTANCES if name in self._where]
            said = f"column {names[0]!r} stands in place of velocities after; leave out wx_after, wy_after, wz_after"
            raise InputError(said, file=self.path)

    def _demand_of_a_ball(self) -> None:
        """Refuse a ball with the shape of something else."""
        if self._is_ball and self.scenario is not None:
            raise InputError(
                f"column {self._where['radius']!r} is of a free ball; objects of scenario {self._name} are boxes",
                file=self.path,
            )
        others = [name for name in ("size_x", "px") if self._is_ball and name in self._where]
        if others:
            said = f"columns {self._where['radius']!r} and {self._where[others[0]]!r}: expected one of them"
            raise InputError(f"{said}; a ball touches below its centre", file=self.path)
        if "shell" in self._where and not self._is_ball:
            raise InputError(f"column {self._where['shell']!r} without 'radius [m]': it is of balls", file=self.path)

    @staticmethod
    def _point_columns() -> list[list[str]]:
        return [_triple("p", tail) for tail in ("", *map(str, range(2, MOST_POINTS + 1)))]

    def _value(self, number: int, cells: Mapping[str, Any], name: str) -> float:
        """One number in SI units."""
        text, unit = cells[self._where[name]], self._unit[name]
        key = f"{_row(number)}, column {self._where[name]!r}"
        if text is None or (isinstance(text, str) and not text.strip()):
            raise InputError(f"this cell is empty; expected a number [{unit}]", file=self.path, key=key)
        try:
            value = decimal(text) if isinstance(text, str) else float(text)
        except (TypeError, ValueError):
            raise InputError(f"expected a number [{unit}]", file=self.path, key=key, value=text) from None
        if not np.isfinite(value):
            raise InputError(f"expected a finite number [{unit}]", file=self.path, key=key, value=value)
        if abs(value) > LARGEST:
            raise InputError(f"expected a number up to {LARGEST:g} [{unit}]", file=self.path, key=key, value=value)
        return value * self._factor[name] * self.geometry.get(name, 1.0)

    def _values(self, number: int, cells: Mapping[str, Any], names: Sequence[str]) -> Array:
        return np.array([self._value(number, cells, name) for name in names])

    def _after(self, number: int, cells: Mapping[str, Any], names: Sequence[str]) -> Array:
        return np.full(len(names), np.nan) if self.questions else self._values(number, cells, names)

    def _wrong(self, number: int, names: str, value: object, message: str) -> InputError:
        return InputError(message, file=self.path, key=f"{_row(number)}, {names}", value=value)

    def _text(self, cells: Mapping[str, Any], name: str) -> str:
        value = cells[self._where[name]] if name in self._where else None
        return "" if value is None else str(value).strip()

    def _impact(self, number: int, cells: Mapping[str, Any]) -> ImpactRow:
        body = BodyState(
            position=self._values(number, cells, _triple("")) if "x" in self._where else np.zeros(3),
            rotation=self._rotation(number, cells) if "qx" in self._where else np.eye(3),
            twist=self._values(number, cells, [*_triple("v", "_before"), *_triple("w", "_before")]),
        )
        spin = _triple("w", "_after")
        turning = self._after(number, cells, spin) if self._turning_after else np.full(len(spin), np.nan)
        moving = self._after(number, cells, _triple("v", "_after")) if self._centre_after else np.full(3, np.nan)
        after = [moving, turning]
        if any(lever := [self.geometry.get(f"offset_{axis}", 0.0) for axis in AXES]):
            # v of the centre = v of the tracked point - omega x lever
            off = body.rotation @ lever
            moved = np.concatenate((body.twist[:3] - np.cross(body.twist[3:], off), body.twist[3:]))
            body = BodyState(body.position - off, body.rotation, moved)
            after[0] = after[0] - np.cross(turning, off)
        normal = self._tilted(self._normal(number, cells))
        given = self._given_points(number, cells)
        object_name = self._object(number, cells)
        physics, models = self._assumption(number, cells, object_name)
        arms = {}
        for place, arm in enumerate(self._arms):
            arms[arm] = ArmState(
                self._values(number, cells, self._of_joints(arm, "q")),
                self._values(number, cells, self._of_joints(arm, "dq", "_before")),
            )
            names = self._of_joints(arm, "dq", "_after")
            unknown = np.full(len(names), np.nan)
            after.insert(place, self._after(number, cells, names) if self._joints_after else unknown)
        on_pad = {next(iter(arms)): (given, normal)} if given and len(arms) == 1 else None
        upwards = UP if normal is None else normal

        def with_points(tolerance: float) -> MeasuredImpact:
            if arms:
                points = points_of_scene(physics, arms, body, models, on_pad, tolerance)
            elif given:
                points = points_on_plane(given, upwards)
            elif self._is_ball:
                points = points_on_plane([body.position - physics.object.size[0] / 2.0 * upwards], upwards)
            else:
                points = corners_that_touch(body, physics.object.size, upwards, tolerance)
            return MeasuredImpact(arms, body, points, bool(given))

        tolerance = self._tolerance(number, cells)
        try:
            impact, wider = with_points(tolerance), with_points(WIDER * tolerance)
            narrower = with_points(max(tolerance / WIDER, min(tolerance, GAP_TOLERANCE)))
        except Infeasible as error:
            raise self._wrong(number, "pose of pad and object", None, error.message) from None
        fewer, more = (None if len(other.points) == len(impact.points) else other for other in (narrower, wider))
        closing = impact.closing_speed(physics, models)
        if not closing > 0.0:
            raise self._wrong(
                number,
                "normal velocity of the contact before [m/s]",
                round(-closing, 6),
                "no impact: the contact does not close; expected a velocity < 0 m/s against the normal",
            )
        condition = self._text(cells, "condition")
        time = self._value(number, cells, TIME) if TIME in self._where else None
        distance, noise = self._distance(number, cells, physics), self._contact_noise(number, cells)
        after_all = np.concatenate(after)
        row = ImpactRow(number, condition, object_name, physics, impact, after_all, more, fewer, time)
        return replace(row, distance=distance, contact_noise=noise)

    def _distance(self, number: int, cells: Mapping[str, Any], physics: Physics) -> Distance | None:
        """How far the object of a row went; None: its velocity was measured."""
        if self._centre_after or self.questions:
            return None
        given = [name for name in DISTANCES if self._text(cells, name)]
        names = " and ".join(repr(self._where[name]) for name in DISTANCES if name in self._where)
        if len(given) != 1:
            raise self._wrong(number, f"column {names}", None, "expected one distance in every row [m]")
        (name,), noise, friction, fall = given, None, None, None
        if "distance_noise" in self._where:
            noise = self._positive(number, cells, "distance_noise", zero=True)
        if name == "flight_distance":
            fall = self._positive(number, cells, "fall_height", zero=True)
        elif self._text(cells, SUPPORT_FRICTION):
            friction = self._positive(number, cells, SUPPORT_FRICTION)
        elif not physics.support_friction > 0.0:
            raise self._wrong(
                number, "support.friction of the scenario", 0.0, "an object slides on without end; expected > 0 [-]"
            )
        return Distance(self._positive(number, cells, name), fall, friction, noise)

    def _contact_noise(self, number: int, cells: Mapping[str, Any]) -> tuple[float, float]:
        """Standard deviations of place [m] and normal [rad] of the contact points of a row."""
        place, normal = (
            self._positive(number, cells, name, zero=True) if name in self._where else 0.0 for name in OF_CONTACTS
        )
        return place, normal

    def _positive(self, number: int, cells: Mapping[str, Any], name: str, zero: bool = False) -> float:
        """A number above 0, or not below it."""
        value = self._value(number, cells, name)
        if not (value >= 0.0 if zero else value > 0.0):
            expected = f"expected a number {'>=' if zero else '>'} 0 [{self._unit[name]}]"
            raise self._wrong(number, f"column {self._where[name]!r}", value, expected)
        return value

    def _rotation(self, number: int, cells: Mapping[str, Any]) -> Array:
        quaternion = self._values(number, cells, ("qx", "qy", "qz", "qw"))
        length = float(np.linalg.norm(quaternion))
        if abs(length - 1.0) > UNIT_LENGTH:
            raise self._wrong(
                number, "length of (qx, qy, qz, qw) [-]", round(length, 6), "expected a unit quaternion: length 1"
            )
        x, y, z, w = quaternion / length
        return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())

    def _tilted(self, normal: Array | None) -> Array | None:
        """The normal of a plane that is tilted further."""
        tilt = [self.geometry.get(name, 0.0) for name in ("tilt_x", "tilt_y")]
        if not any(tilt):
            return normal
        return np.asarray(pin.rpy.rpyToMatrix(*tilt, 0.0) @ (UP if normal is None else normal))

    def _normal(self, number: int, cells: Mapping[str, Any]) -> Array | None:
        if "nx" not in self._where:
            return None
        normal = self._values(number, cells, _triple("n"))
        length = float(np.linalg.norm(normal))
        if abs(length - 1.0) > UNIT_LENGTH:
            raise self._wrong(
                number, "length of (nx, ny, nz) [-]", round(length, 6), "expected a unit normal: length 1"
            )
        return normal / length

    def _given_points(self, number: int, cells: Mapping[str, Any]) -> list[Array]:
        found = []
        for names in self._point_columns():
            if names[0] in self._where and any(self._text(cells, name) for name in names):
                found.append(self._values(number, cells, names))
        if not found and self.scenario is None and not (self._is_ball or "size_x" in self._where):
            message = "no contact point; expected at least one [m], or columns 'size_x [m]' ... for the geometry"
            raise self._wrong(number, "columns 'px', 'py', 'pz'", None, message)
        return found

    def _object(self, number: int, cells: Mapping[str, Any]) -> str:
        """Name of the scenario's object in a row; empty: a free body."""
        if self.scenario is None:
            return ""
        known = self.scenario.objects
        name = self._text(cells, "object")
        if not name and len(known) == 1:
            return next(iter(known))
        if name not in known:
            raise self._wrong(
                number,
                "column 'object'",
                name,
                f"expected an object of scenario {self._name}{did_you_mean(name, known)}; known: {', '.join(known)}",
            )
        return name

    def _assumption(
        self, number: int, cells: Mapping[str, Any], object_name: str
    ) -> tuple[Physics, dict[str, RobotModel]]:
        """Physics of a row before any effect; rows that assume the same share one."""
        names = ("mass", "ixx", "iyy", "izz", *_triple("size_"), "radius", "shell", FRICTION, RESTITUTION)
        own = {name: self._value(number, cells, name) for name in names if name in self._where}
        for name, value in own.items():
            low = 0.0 if name in (FRICTION, RESTITUTION, "shell") else np.finfo(float).tiny
            if value < low or (name == RESTITUTION and value > 1.0) or (name == "shell" and value not in (0.0, 1.0)):
                expected = {FRICTION: ">= 0 [-]", RESTITUTION: "between 0 and 1 [-]", "shell": "0 (solid) or 1 [-]"}
                unit = self._unit[name]
                raise self._wrong(
                    number,
                    f"column {self._where[name]!r}",
                    value,
                    f"expected a number {expected.get(name, f'> 0 [{unit}]')}",
                )
        moments = [own[name] for name in ("ixx", "iyy", "izz") if name in own]
        if moments and max(moments) > (1.0 + MOMENTS) * (sum(moments) - max(moments)):
            raise self._wrong(
                number,
                "columns 'ixx', 'iyy', 'izz'",
                moments,
                "no body has these principal moments; expected none larger than the sum of the other two [kg m^2]",
            )
        motors = {
            arm: tuple(self._values(number, cells, self._of_joints(arm, "B")))
            for arm in self._arms
            if self._of_joints(arm, "B")[0] in self._where
        }
        for arm, values in motors.items():
            if min(values) < 0.0:
                joint = int(np.argmin(values))
                name = self._of_joints(arm, "B")[joint]
                unit = self._with_units(arm, self._of_joints(arm, "B"), "inertia")[name]
                raise self._wrong(number, f"column {name!r}", values[joint], f"expected a number >= 0 [{unit}]")
        key = (object_name, *own.items(), *motors.items())
        if key not in self._physics:
            physics = self._free(own) if self.scenario is None else self._of_scene(object_name, own, motors)
            self._physics[key] = physics, physics.robot_models()
        return self._physics[key]

    @staticmethod
    def _free(own: Mapping[str, float]) -> Physics:
        """A free body: an object without arms, on a support without an edge."""
        size = np.array([own.get(name, 2.0 * own.get("radius", 0.0)) for name in _triple("size_")])
        share = 2.0 / 3.0 if own.get("shell") else 2.0 / 5.0
        ball = np.full(3, share * own["mass"] * own.get("radius", 0.0) ** 2)
        box = own["mass"] / 12.0 * (np.sum(np.square(size)) - np.square(size))
        own_shape = ball if "radius" in own else box
        inertia = np.array([own[name] for name in ("ixx", "iyy", "izz")]) if "ixx" in own else own_shape
        return Physics(
            arms={},
            object=ObjectPhysics(own["mass"], size, inertia, np.zeros(3), round="radius" in own),
            support_height=None,
            support_size=(np.inf, np.inf),
            support_friction=own.get(FRICTION, ASSUMED_FRICTION),
            pad_friction=0.0,
            restitution=own.get(RESTITUTION, 0.0),
        )

    def _of_scene(self, object_name: str, own: Mapping[str, float], motors: Mapping[str, tuple[float, ...]]) -> Physics:
        """A scenario with what the table knows better."""
        assert self.scenario is not None
        physics = Physics.nominal(self.scenario, object_name)
        box = physics.object
        mass = own.get("mass", box.mass)
        size = np.array([own.get(name, value) for name, value in zip(_triple("size_"), box.size, strict=True)])
        inertia = box.inertia * mass / box.mass
        if "size_x" in own:
            inertia = mass / 12.0 * (np.sum(np.square(size)) - np.square(size))
        if "ixx" in own:
            inertia = np.array([own[name] for name in ("ixx", "iyy", "izz")])
        arms = {
            name: replace(arm, motor_inertia_reduced=np.array(motors[name])) if name in motors else arm
            for name, arm in physics.arms.items()
        }
        return replace(
            physics,
            arms=arms,
            object=ObjectPhysics(mass, size, inertia, box.com_offset),
            pad_friction=own.get(FRICTION, physics.pad_friction),
            restitution=own.get(RESTITUTION, physics.restitution),
        )

    def _noise(self, rows: Sequence[ImpactRow]) -> Array | None:
        """Standard deviations in the order of ``after``, ``(rows, nv)``; None where the table says nothing.

        Of what the table states no noise of, while it does of others, it is 0: not known.
        """
        wanted = self._noise_columns()
        if not any(self._states_noise(name) for name in (*wanted, *OF_CONTACTS)) or self.questions:
            return None
        found = []
        for row, cells in zip(rows, self.cells, strict=True):
            names = [["dq_noise"]] * (row.after.size - 6) + [
                [f"{stem}_{axis}", stem] for stem in ("v_noise", "w_noise") for axis in AXES
            ]
            found.append([self._noise_of(row.number, cells, own) if own[-1] in wanted else np.nan for own in names])
        return np.array(found)

    def _noise_of(self, number: int, cells: Mapping[str, Any], names: Sequence[str]) -> float:
        """Standard deviation by the first of some columns that is there; 0: there is none."""
        there = [name for name in names if name in self._where]
        return self._value(number, cells, there[0]) if there else 0.0

    def _noise_columns(self) -> dict[str, str]:
        """Noise columns of what was measured after the impact, with what they are the noise of."""
        wanted = {"v_noise": "v*_after"} if self._centre_after else {"distance_noise": "distances"}
        wanted |= {"w_noise": "w*_after"} if self._turning_after else {}
        return wanted | ({"dq_noise": "dq*_after"} if self._joints_after else {})

    def _states_noise(self, name: str) -> bool:
        """Whether a table has a noise column, or those of the axes in its place."""
        return name in self._where or f"{name}_x" in self._where

    def _assumed(self) -> tuple[str, ...]:
        """What is taken where the table says nothing."""
        noise = self._noise_columns()
        some = any(self._states_noise(name) for name in (*noise, *OF_CONTACTS))
        unknown = tuple(
            f"no column '{name}', though other noise is stated: how much of the residual of {columns} is noise is not "
            f"known{'' if columns == 'distances' else '; without these columns the other signals are compared alone'}"
            for name, columns in noise.items()
            if some and not self._states_noise(name)
        )
        if self.scenario is not None:
            return unknown
        taken = {FRICTION: ASSUMED_FRICTION, RESTITUTION: 0.0}
        return unknown + tuple(
            f"no column '{name} [-]': {value:g} is assumed, and estimates are relative to that"
            for name, value in taken.items()
            if name not in self._where
        )
