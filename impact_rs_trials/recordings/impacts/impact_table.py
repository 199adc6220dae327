# SPDX-License-Identifier: Apache-2.0
"""Impact tables: one row per impact and nothing else, as CSV or Parquet.

Two kinds of rows. Without joint positions **one free body hits a fixed plane**: a tossed cube, or a ball on a racket so
heavy that its motion does not change (velocities are then relative to it). With them
**an arm (or two) hits an object**; a scenario then has robots, pads and support.
:mod:`impact_rs_trials.recordings.impacts.impact_columns` lists the columns.

Units of a header may be others of the same quantity (:mod:`impact_rs_trials.recordings.file_units`). Any column may
also be declared a covariate: a circumstance of the measurement, a number or the name of a level. Other
columns are ignored. Cells of a CSV file are separated by commas, semicolons or tabs; empty lines and lines that
begin with # are skipped.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import Infeasible, InputError, did_you_mean
from impact_rs_sim.files import is_file
from impact_rs_sim.impact_map.contacts import GAP_TOLERANCE
from impact_rs_sim.impact_map.measured import (
    MeasuredImpact,
    points_of_scene,
    points_on_plane,
    points_that_touch,
)
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.robot import BASE_POSE_SIZE, Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.rotations import AXES
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.shapes import check_extents
from impact_rs_trials.recordings.free_bodies import ROUND_AXES, body_of_mesh, body_of_shape
from impact_rs_trials.recordings.impacts import impact_columns as col
from impact_rs_trials.recordings.impacts.distances import Distance
from impact_rs_trials.recordings.impacts.impact_cells import ImpactCells, name_of_row
from impact_rs_trials.recordings.impacts.impact_columns import ColumnGroup, arm_label, name_and_unit
from impact_rs_trials.recordings.impacts.impact_contents import TableContents, read_with_contents, unread
from impact_rs_trials.recordings.impacts.unsure_scene import nominal_values, with_value
from impact_rs_trials.recordings.readers.text_file import suffix_of
from impact_rs_trials.since import measured_since

SUFFIXES = (".csv", ".parquet")
ASSUMED_FRICTION = 0.3  # of a free body on a plane, if a table has no column; typical of dry solids
MAX_LENGTH_ERROR = 1e-3  # of a unit quaternion or normal, from rounding
MAX_MOMENT_EXCESS_SHARE = 1e-3  # of a moment of inertia over the sum of the others, from rounding
UNIT_QUATERNION = "expected a unit quaternion: length 1"
UP = np.array([0.0, 0.0, 1.0])
MAX_TOLERANCE_FACTOR = 4.0  # points between 1 / 4 and 4 tolerances may touch or not
OF_BODY = (col.MASS, col.MOMENTS, col.SIZE, col.RADIUS)  # columns that may be unsure
BODY_UNITS = {name: column.unit for column in OF_BODY for name in column.names}
# Noise columns by axis that may replace a single column.
OF_AXES = {col.V_NOISE: col.V_NOISE_AXES, col.W_NOISE: col.W_NOISE_AXES}
ALONE = "; without these columns the other signals are compared alone"
UNSEEN_GEOMETRY = {  # units of other uncertain quantities, which are 0 in a table
    "offset_x": "m",  # of the tracked point from the centre, along the body's own axes
    "offset_y": "m",
    "offset_z": "m",
    "tilt_x": "rad",  # of the plane's normal about x and y of A
    "tilt_y": "rad",
}
SWEPT_SHARES = (0.25, 0.5, 1.0)  # of the difference between either end of a range and the assumed value


@dataclass(frozen=True)
class ImpactRow:
    """One impact.

    Attributes:
        number: Row of the table, counted from 1 without the header.
        condition: Name of the condition that it repeats; empty: unknown.
        object_name: Name of the object; empty: a free body.
        physics: Nominal physics; rows with the same nominal physics share one.
        impact: State just before, and contact points.
        after: Measured u^+, v of every arm and then the twist of the centre, ``(nv,)`` [rad/s, m/s].
        wider: The impact with the contact points within ``MAX_TOLERANCE_FACTOR`` tolerances; None: equal points.
        narrower: The impact with the contact points within a tolerance over ``MAX_TOLERANCE_FACTOR`` (no pose is known
            better than ``GAP_TOLERANCE``); None: equal points.
        time: Time of the measurement, seconds since 1970 or since any other moment [s]; None: unknown.
        circumstances: Its covariates by name, numbers or names of levels.
        distance: Distance that the object travelled afterwards, if measured instead of its velocity.
        contact_noise: Standard deviations of the positions of the contact points [m] and of their normal [rad].
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
    """A table read with another value of an uncertain quantity.

    Attributes:
        of: Name of the quantity: a column of the body, an ``UNSEEN_GEOMETRY``, or a number of the scenario
            (:mod:`impact_rs_trials.recordings.impacts.unsure_scene`).
        value: Its value, in the unit; the mean if the rows of a column differ.
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
        path: The file.
        digest: Digest of its bytes and of its meshes.
        rows: The impacts.
        arms: Names of the arms; empty: free bodies.
        joints: Whether joint velocities after the impact were measured.
        centre: Whether velocities of the centre after the impact were measured; if not, distances were.
        turning: Whether angular velocities after the impact were measured.
        tolerance: Largest extra distance of a touching point beyond the nearest one [m]; with a column the mean.
        noise: Standard deviation of a measured change of velocity in the order of ``after``, ``(rows, nv)``
            [rad/s, m/s], nan if not measured; None: unknown.
        assumed: Assumptions for missing columns, as text.
        unread: Headers of unused columns.
        covariates: Units of the covariates by name; empty if the header has no unit.
        variants: The table with other values of the uncertain quantities, over their ranges.
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
        """The rows measured from a moment on.

        Args:
            when: A row, ``row 7``, or a time in column ``time`` (:func:`impact_rs_trials.since.measured_since`).

        Raises:
            InputError: No row was measured at that moment.
        """
        stamps = {name_of_row(row.number): row.number if row.time is None else row.time for row in self.rows}
        chosen = measured_since(when, stamps, all(row.time is not None for row in self.rows))
        part = self.part([index for index, row in enumerate(self.rows) if name_of_row(row.number) in chosen])
        digest = hashlib.sha256(f"{self.digest} {sorted(chosen)}".encode()).hexdigest()[: len(self.digest)]
        return replace(part, digest=digest)

    def part(self, indices: Sequence[int]) -> ImpactTable:
        """Some rows, by position."""
        noise = None if self.noise is None else self.noise[list(indices)]
        variants = tuple(replace(variant, table=variant.table.part(indices)) for variant in self.variants)
        return replace(self, rows=tuple(self.rows[index] for index in indices), noise=noise, variants=variants)


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
        questions: Whether velocities after are to be predicted: their columns may be absent and are not read.
        tolerance: Largest extra distance of a touching point beyond the nearest one [m].
        covariates: Names of the columns with circumstances of the measurement. A column of numbers is
            a number, in the unit of its header; any other holds names of levels.
        unsure: Ranges of uncertain quantities, in SI units: columns of the body, whose rows keep their ratios,
            ``UNSEEN_GEOMETRY``, or numbers of the scenario (:mod:`impact_rs_trials.recordings.impacts.unsure_scene`).

    Raises:
        InputError: It cannot be read, a column is missing or has another unit, or a row is no impact; the message has
            row, column, found and expected value.
    """
    digest = _digest(path)
    cells, contents, declared = read_with_contents(path, scenario, questions, covariates)
    digest = _with_meshes(digest, cells)
    reader = _Reader(cells, contents, tolerance, declared)
    table, variants = reader.table(digest), []
    for name, (low, high) in unsure.items():
        assumed, unit = reader.assumed_geometry(name)
        values = {
            assumed + share * (end - assumed)
            for end in (low, high)
            for share in SWEPT_SHARES
            if not np.isclose(end, assumed)
        }
        for value in sorted(values):
            try:
                variant_table = reader.with_geometry(name, value, assumed).table(digest)
            except InputError as error:
                raise InputError(
                    f"with {name} = {value:.4g} {unit}: {error.message}", file=path, key=error.key
                ) from None
            variants.append(Variant(name, value, unit, variant_table))
    return replace(table, variants=tuple(variants))


def _digest(path: Path) -> str:
    """Digest of the bytes of a file, which is a table."""
    if suffix_of(path) not in SUFFIXES:
        raise InputError(f"expected a table of impacts ({' or '.join(SUFFIXES)})", file=path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    if not data:
        raise InputError("this file is empty", file=path)
    return hashlib.sha256(data).hexdigest()


def _with_meshes(digest: str, cells: ImpactCells) -> str:
    """Digest of a table and of the files of its meshes."""
    names = {cells.text(row, col.MESH.first) for row in range(len(cells))}
    files = [cells.path.parent / name for name in sorted(names) if name]
    mesh_digests = "".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files if is_file(file))
    return hashlib.sha256(f"{digest}{mesh_digests}".encode()).hexdigest() if mesh_digests else digest


@dataclass(frozen=True)
class _Reader:
    """Turns cells into impacts.

    Attributes:
        cells: The table.
        contents: Its contents.
        tolerance: Largest extra distance of a touching point beyond the nearest one, without a column [m].
        covariates: Headers by name.
        geometry: Values of ``UNSEEN_GEOMETRY`` [m, rad].
        physics: Shared physics and models of rows, by their assumptions.
    """

    cells: ImpactCells
    contents: TableContents
    tolerance: float
    covariates: dict[str, str]
    geometry: Mapping[str, float] = field(default_factory=dict)
    physics: dict[tuple[Any, ...], tuple[Physics, dict[str, RobotModel]]] = field(default_factory=dict)

    def table(self, digest: str) -> ImpactTable:
        """All rows, checked."""
        cells, contents = self.cells, self.contents
        circumstances = cells.circumstances(self.covariates)
        rows = tuple(
            replace(self._impact(row), circumstances=covariates_of_row)
            for row, covariates_of_row in enumerate(circumstances)
        )
        return ImpactTable(
            path=cells.path,
            digest=digest,
            rows=rows,
            arms=contents.arms,
            noise=self._noise(rows),
            assumed=self._assumed(),
            unread=unread(cells, contents, self.covariates),
            joints=contents.joints,
            centre=contents.centre,
            turning=contents.turning,
            tolerance=float(np.mean([self._tolerance(row) for row in range(len(cells))])),
            covariates={name: name_and_unit(header)[1] for name, header in self.covariates.items()},
        )

    def assumed_geometry(self, name: str) -> tuple[float, str]:
        """Value that a table assumes for an uncertain quantity, and its SI unit.

        Raises:
            InputError: The table has no uncertain quantity of that name.
        """
        names = [column for column in BODY_UNITS if column in self.cells]
        names += [quantity for quantity in UNSEEN_GEOMETRY if not (self.contents.arms and quantity.startswith("tilt"))]
        if not self.contents.turning:
            names = [quantity for quantity in names if not quantity.startswith("offset")]
        names += [col.SUPPORT_FRICTION.first] if self._is_scaled_column(col.SUPPORT_FRICTION.first) else []
        scenario = self.contents.scenario
        scenario_values = {} if scenario is None else nominal_values(scenario)
        names += [quantity for quantity in scenario_values if quantity not in names]
        if name not in names:
            raise InputError(
                f"nothing called {name!r} can be unsure here{did_you_mean(name, names)}; known: {', '.join(names)}",
                file=self.cells.path,
                key="--unsure",
            )
        if name in UNSEEN_GEOMETRY:
            return 0.0, UNSEEN_GEOMETRY[name]
        if not self._is_scaled_column(name):
            return scenario_values[name]
        values = [self.cells.value(row, name) for row in range(len(self.cells)) if self.cells.text(row, name)]
        if len(values) < len(self.cells):
            raise InputError(
                f"column {name!r} is empty in {len(self.cells) - len(values)} of {len(self.cells)} rows, which have "
                "the value of the scenario; expected numbers in all rows or in none",
                file=self.cells.path,
                key="--unsure",
            )
        return float(np.mean(values)), BODY_UNITS.get(name, col.SUPPORT_FRICTION.unit)

    def _is_scaled_column(self, name: str) -> bool:
        """Whether an uncertain quantity is a column, whose rows keep their ratios."""
        of_support = name == col.SUPPORT_FRICTION.first and not self.contents.centre
        filled = name in self.cells and any(self.cells.text(row, name) for row in range(len(self.cells)))
        return filled and (name in BODY_UNITS or of_support)

    def with_geometry(self, name: str, value: float, assumed: float) -> _Reader:
        """A reader of the same table with another value of an uncertain quantity.

        Args:
            name: Name of the quantity.
            value: Its value, in SI units.
            assumed: Its value by :meth:`assumed_geometry`.
        """
        if self._is_scaled_column(name):
            scale = dict.fromkeys(self._columns_scaled_with(name), value / assumed)
            return replace(self, cells=replace(self.cells, scale=scale), physics={})
        if name in UNSEEN_GEOMETRY:
            return replace(self, geometry={name: value}, physics={})
        assert self.contents.scenario is not None
        scenario = with_value(self.contents.scenario, name, value)
        return replace(self, contents=replace(self.contents, scenario=scenario), physics={})

    def _columns_scaled_with(self, name: str) -> set[str]:
        """The column and those that change in proportion: equal extents of round bodies, such as a sphere."""
        kinds = {self.cells.text(row, col.SHAPE.first) for row in range(len(self.cells))}
        equal = [{f"size_{axis}" for axis in ROUND_AXES.get(kind, "")} for kind in kinds]
        return {name}.union(*(extents for extents in equal if name in extents))

    def _tolerance(self, row: int) -> float:
        """Largest extra distance of a touching point of a row beyond the nearest one [m]."""
        return self.cells.value_or(row, col.TOLERANCE, self.tolerance)

    def _velocity_after(self, row: int, names: Sequence[str], measured: bool) -> Array:
        """Velocities after the impact; nan if not measured or to be predicted."""
        available = measured and not self.contents.questions
        return self.cells.values(row, names) if available else np.full(len(names), np.nan)

    def _impact(self, row: int) -> ImpactRow:
        """One impact without its circumstances."""
        cells, contents = self.cells, self.contents
        body = BodyState(
            position=cells.values(row, col.POSITION.names) if col.POSITION in cells else np.zeros(3),
            rotation=self._rotation(row) if col.ORIENTATION in cells else np.eye(3),
            twist=cells.values(row, [*col.V_BEFORE.names, *col.W_BEFORE.names]),
        )
        v_after = self._velocity_after(row, col.V_AFTER.names, contents.centre)
        w_after = self._velocity_after(row, col.W_AFTER.names, contents.turning)
        if any(offset := [self.geometry.get(f"offset_{axis}", 0.0) for axis in AXES]):
            # v of the centre = v of the tracked point - omega x lever
            lever = body.rotation @ offset
            twist = np.concatenate((body.twist[:3] - np.cross(body.twist[3:], lever), body.twist[3:]))
            body = BodyState(body.position - lever, body.rotation, twist)
            v_after = v_after - np.cross(w_after, lever)
        arms = {arm: self._arm(row, arm) for arm in contents.arms}
        dq_after = [self._velocity_after(row, contents.names(col.DQ_AFTER, arm), contents.joints) for arm in arms]
        object_name = self._object(row)
        physics, models = self._assumption(row, object_name)
        impact, narrower, wider = self._contacts(row, arms, body, physics, models)
        closing = impact.closing_speed(physics, models)
        if not closing > 0.0:
            raise cells.error(
                row, "normal velocity of the contact before [m/s]", round(-closing, 6),
                "no impact: the contact does not close; expected a velocity < 0 m/s against the normal",
            )  # fmt: skip
        return ImpactRow(
            number=row + 1,
            condition=cells.text(row, col.CONDITION.first),
            object_name=object_name,
            physics=physics,
            impact=impact,
            after=np.concatenate((*dq_after, v_after, w_after)),
            wider=None if len(wider.points) == len(impact.points) else wider,
            narrower=None if len(narrower.points) == len(impact.points) else narrower,
            time=cells.value_or(row, col.TIME, None),
            distance=self._distance(row, physics),
            contact_noise=self._contact_noise(row),
        )

    def _arm(self, row: int, arm: str) -> ArmState:
        """State of an arm before the impact."""
        position, velocity = (
            self.cells.values(row, self.contents.names(columns, arm)) for columns in (col.Q, col.DQ_BEFORE)
        )
        assert self.contents.scenario is not None
        if self.contents.scenario.robots[arm].robot_facts.floating_base is not None:
            orientation = col.BASE_ORIENTATION.of_arm(arm_label(arm, self.contents.arms))
            position[3:BASE_POSE_SIZE] = self._unit_vector(row, orientation, UNIT_QUATERNION)
        return ArmState(position, velocity)

    def _contacts(
        self, row: int, arms: dict[str, ArmState], body: BodyState, physics: Physics, models: dict[str, RobotModel]
    ) -> tuple[MeasuredImpact, MeasuredImpact, MeasuredImpact]:
        """An impact with its contact points by the tolerance, by a smaller one, and by a larger one."""
        normal, measured_points = self._tilted(self._normal(row)), self._measured_points(row)
        on_pad = {next(iter(arms)): (measured_points, normal)} if measured_points and len(physics.pads) == 1 else None
        upwards = UP if normal is None else normal

        def with_points(tolerance: float) -> MeasuredImpact:
            if arms:
                points = points_of_scene(physics, arms, body, models, on_pad, tolerance)
            elif measured_points:
                points = points_on_plane(measured_points, upwards)
            else:
                item = physics.object
                points = points_that_touch(body, item.size, upwards, tolerance, item.shape)
            return MeasuredImpact(arms, body, points, bool(measured_points))

        tolerance = self._tolerance(row)
        smaller = max(tolerance / MAX_TOLERANCE_FACTOR, min(tolerance, GAP_TOLERANCE))
        try:
            return with_points(tolerance), with_points(smaller), with_points(MAX_TOLERANCE_FACTOR * tolerance)
        except Infeasible as error:
            raise self.cells.error(row, "pose of pad and object", None, error.message) from None

    def _distance(self, row: int, physics: Physics) -> Distance | None:
        """Displacement of the object of a row; None: its velocity was measured."""
        cells = self.cells
        if self.contents.centre or self.contents.questions:
            return None
        filled = [column for column in col.DISTANCES if cells.text(row, column.first)]
        if len(filled) != 1:
            names = " and ".join(repr(cells.header(column)) for column in col.DISTANCES if column in cells)
            raise cells.error(row, f"column {names}", None, "expected one distance in every row [m]")
        (column,), friction, fall = filled, None, None
        noise = cells.value_or(row, col.DISTANCE_NOISE, None)
        if column == col.FLIGHT_DISTANCE:
            fall = cells.value(row, col.FALL_HEIGHT.first)
        elif cells.text(row, col.SUPPORT_FRICTION.first):
            friction = cells.value(row, col.SUPPORT_FRICTION.first)
        elif not physics.support_friction > 0.0:
            text = "an object slides on without end; expected > 0 [-]"
            raise cells.error(row, "support.friction of the scenario", 0.0, text)
        return Distance(cells.value(row, column.first), fall, friction, noise)

    def _contact_noise(self, row: int) -> tuple[float, float]:
        """Standard deviations of position [m] and normal [rad] of the contact points of a row; 0: unknown."""
        position, normal = (self.cells.value_or(row, column, 0.0) for column in col.CONTACT_NOISE)
        return position, normal

    def _rotation(self, row: int) -> Array:
        x, y, z, w = self._unit_vector(row, col.ORIENTATION, UNIT_QUATERNION)
        return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())

    def _normal(self, row: int) -> Array | None:
        """Normal of the contact; None: not measured."""
        return (
            self._unit_vector(row, col.NORMAL, "expected a unit normal: length 1") if col.NORMAL in self.cells else None
        )

    def _unit_vector(self, row: int, columns: ColumnGroup, expected: str) -> Array:
        """Numbers of some columns, whose length is 1 up to rounding."""
        values = self.cells.values(row, columns.names)
        length = float(np.linalg.norm(values))
        if abs(length - 1.0) > MAX_LENGTH_ERROR:
            raise self.cells.error(row, f"length of ({', '.join(columns.names)}) [-]", round(length, 6), expected)
        return np.asarray(values / length)

    def _tilted(self, normal: Array | None) -> Array | None:
        """The normal after a further tilt of the plane."""
        tilt = [self.geometry.get(name, 0.0) for name in ("tilt_x", "tilt_y")]
        if not any(tilt):
            return normal
        return np.asarray(pin.rpy.rpyToMatrix(*tilt, 0.0) @ (UP if normal is None else normal))

    def _measured_points(self, row: int) -> list[Array]:
        """Measured contact points."""
        cells = self.cells
        points = [
            cells.values(row, point.names)
            for point in col.POINTS
            if point in cells and any(cells.text(row, name) for name in point.names)
        ]
        if not points and self.contents.scenario is None and not self.contents.shaped:
            text = f"no contact point; expected at least one [m], or columns {col.SIZE.header!r} ... for the geometry"
            raise cells.error(row, f"columns {', '.join(map(repr, col.POINTS[0].names))}", None, text)
        return points

    def _object(self, row: int) -> str:
        """Name of the scenario's object in a row; empty: a free body."""
        scenario = self.contents.scenario
        if scenario is None:
            return ""
        objects = scenario.objects
        name = self.cells.text(row, col.OBJECT.first)
        if not name and len(objects) == 1:
            return next(iter(objects))
        if name not in objects:
            text = f"expected an object of scenario {scenario.name!r}{did_you_mean(name, objects)}"
            raise self.cells.error(row, f"column {col.OBJECT.first!r}", name, f"{text}; known: {', '.join(objects)}")
        return name

    def _assumption(self, row: int, object_name: str) -> tuple[Physics, dict[str, RobotModel]]:
        """Physics of a row before any effect, shared between rows with equal assumptions."""
        cells, contents = self.cells, self.contents
        assumed = (*OF_BODY, col.SHELL, col.FRICTION, col.RESTITUTION)
        values = {name: cells.value(row, name) for column in assumed if column in cells for name in column.names}
        moments = [values[name] for name in col.MOMENTS.names if name in values]
        if moments and max(moments) > (1.0 + MAX_MOMENT_EXCESS_SHARE) * (sum(moments) - max(moments)):
            raise cells.error(
                row, f"columns {', '.join(map(repr, col.MOMENTS.names))}", moments,
                "no body has these principal moments; expected none larger than the sum of the other two [kg m^2]",
            )  # fmt: skip
        motors = {
            arm: tuple(cells.values(row, names).tolist())
            for arm in contents.arms
            if (names := contents.names(col.MOTOR_INERTIA, arm)) and names[0] in cells
        }
        kind, mesh = cells.text(row, col.SHAPE.first), cells.text(row, col.MESH.first)
        key = (object_name, kind, mesh, *values.items(), *motors.items())
        if key not in self.physics:
            free = contents.scenario is None
            physics = self._free(row, values) if free else self._of_scene(object_name, values, motors)
            self.physics[key] = physics, physics.robot_models()
        return self.physics[key]

    def _free(self, row: int, values: Mapping[str, float]) -> Physics:
        """A free body: an object without arms, on a support without an edge."""
        body = self._free_body(row, values)
        return Physics(
            arms={},
            object=replace(body, inertia=_moments(values, body.inertia)),
            support_height=None,
            support_size=(np.inf, np.inf),
            support_friction=values.get(col.FRICTION.first, ASSUMED_FRICTION),
            pad_friction=0.0,
            restitution=values.get(col.RESTITUTION.first, 0.0),
        )

    def _free_body(self, row: int, values: Mapping[str, float]) -> ObjectPhysics:
        """A free body of homogeneous density by shape, mesh or radius; without these, a body known by its moments."""
        cells, mass = self.cells, values[col.MASS.first]
        size = [values[name] for name in col.SIZE.names] if col.SIZE.first in values else None
        kind, mesh = cells.text(row, col.SHAPE.first), cells.text(row, col.MESH.first)
        if col.RADIUS.first in values:
            return body_of_shape(
                "sphere", mass, [2.0 * values[col.RADIUS.first]] * 3, bool(values.get(col.SHELL.first))
            )
        if kind and mesh:
            raise cells.column_error(
                row, col.SHAPE.first, kind, f"and {col.MESH.first} = {mesh!r}: expected one of them"
            )
        if mesh:
            try:
                return body_of_mesh(cells.path.parent / mesh, mass, size)
            except InputError as error:
                raise cells.column_error(row, col.MESH.first, mesh, error.message) from None
        if size is None and col.MESH in cells:
            raise cells.column_error(
                row, col.MESH.first, None, f"this cell is empty; expected a file, or {col.SIZE.header!r} ..."
            )
        try:
            return body_of_shape(kind or "box", mass, size or [0.0] * 3)
        except ValueError as error:
            raise cells.column_error(row, col.SHAPE.first, kind, str(error)) from None

    def _of_scene(
        self, object_name: str, values: Mapping[str, float], motors: Mapping[str, tuple[float, ...]]
    ) -> Physics:
        """A scenario with the values of the table."""
        assert self.contents.scenario is not None
        physics = Physics.nominal(self.contents.scenario, object_name)
        body = physics.object
        body.check_free("a table of impacts")
        if body.fixed and values.keys() & {*col.MASS.names, *col.MOMENTS.names}:
            raise InputError(f"object {object_name!r} is fixed and has neither mass nor moments: leave these out")
        mass = values.get(col.MASS.first, body.mass)
        size = np.array([values.get(name, value) for name, value in zip(col.SIZE.names, body.size, strict=True)])
        inertia = body.inertia if body.fixed else body.inertia * mass / body.mass
        if col.SIZE.first in values:
            inertia = self._moments_of_size(object_name, body, mass, size)
        arms = {
            name: replace(arm, motor_inertia_reduced=np.array(motors[name])) if name in motors else arm
            for name, arm in physics.arms.items()
        }
        return replace(
            physics,
            arms=arms,
            object=replace(body, mass=mass, size=size, inertia=_moments(values, inertia)),
            pad_friction=values.get(col.FRICTION.first, physics.pad_friction),
            restitution=values.get(col.RESTITUTION.first, physics.restitution),
        )

    @staticmethod
    def _moments_of_size(object_name: str, body: ObjectPhysics, mass: float, size: Array) -> Array:
        """Principal moments of a homogeneous object with the size of the table, ``(3,)`` [kg m^2]."""
        if body.shape.kind == "hull":
            raise InputError(f"object {object_name!r} is the hull of a mesh, which has its size: leave size_x ... out")
        try:
            check_extents(body.shape.kind, size.tolist())
        except ValueError as error:
            raise InputError(f"object {object_name!r}: {error}", key=col.SIZE.header) from None
        return body.inertia if body.fixed else body.shape.moments(mass, size)

    @property
    def _noise_columns(self) -> dict[ColumnGroup, str]:
        """Noise columns of the signals measured after the impact, with the names of the signals."""
        contents = self.contents
        columns = {col.V_NOISE: "v*_after"} if contents.centre else {col.DISTANCE_NOISE: "distances"}
        columns |= {col.W_NOISE: "w*_after"} if contents.turning else {}
        return columns | ({col.DQ_NOISE: "dq*_after"} if contents.joints else {})

    def _states_noise(self, *columns: ColumnGroup) -> bool:
        """Whether the table has at least one of these noise columns, or its columns by axis."""
        return any(column in self.cells or OF_AXES.get(column, column) in self.cells for column in columns)

    def _noise(self, rows: Sequence[ImpactRow]) -> Array | None:
        """Standard deviations in the order of ``after``, ``(rows, nv)``; None if the table has no noise column.

        Signals without a noise column in a table with others have 0: unknown.
        """
        columns = self._noise_columns
        if not self._states_noise(*columns, *col.CONTACT_NOISE) or self.contents.questions:
            return None
        noise = []
        for row, impact in enumerate(rows):
            signals = ((col.DQ_NOISE, impact.after.size - 6), (col.V_NOISE, 3), (col.W_NOISE, 3))
            parts = [
                self._noise_of(row, column, count) if column in columns else np.full(count, np.nan)
                for column, count in signals
            ]
            noise.append(np.concatenate(parts))
        return np.array(noise)

    def _noise_of(self, row: int, column: ColumnGroup, count: int) -> Array:
        """Standard deviations of some signals of a row: by axis, else of one column, else 0 (unknown)."""
        axes = OF_AXES.get(column, column)
        if axes in self.cells and axes != column:
            return self.cells.values(row, axes.names)
        return np.full(count, self.cells.value_or(row, column, 0.0))

    def _assumed(self) -> tuple[str, ...]:
        """Assumptions for missing columns, as text."""
        wanted = self._noise_columns
        stated = self._states_noise(*wanted, *col.CONTACT_NOISE)
        remarks = self.cells.assumed + tuple(
            f"no column '{column.first}', though other noise is stated: how much of the residual of {signals} is noise "
            f"is not known{'' if column == col.DISTANCE_NOISE else ALONE}"
            for column, signals in wanted.items()
            if stated and not self._states_noise(column)
        )
        if self.contents.scenario is not None:
            return remarks
        defaults = {col.FRICTION: ASSUMED_FRICTION, col.RESTITUTION: 0.0}
        return remarks + tuple(
            f"no column {column.header!r}: {value:g} is assumed, and estimates are relative to that"
            for column, value in defaults.items()
            if column not in self.cells
        )


def _moments(values: Mapping[str, float], default: Array) -> Array:
    """Principal moments in the columns of a row, or a default without these columns, ``(3,)`` [kg m^2]."""
    return np.array([values[name] for name in col.MOMENTS.names]) if col.MOMENTS.first in values else default
