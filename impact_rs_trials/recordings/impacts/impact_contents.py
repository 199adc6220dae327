# SPDX-License-Identifier: Apache-2.0
"""Contents of an impact table: free bodies, balls or arms, and the signals measured after the impacts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_trials.recordings.impacts import impact_columns as col
from impact_rs_trials.recordings.impacts.dropped_balls import with_velocities
from impact_rs_trials.recordings.impacts.impact_cells import ImpactCells, read_cells
from impact_rs_trials.recordings.impacts.impact_columns import (
    ColumnGroup,
    JointColumnGroup,
    arm_label,
    is_joint_column,
    name_and_unit,
    with_unit,
)

MIN_SIMILARITY = 0.75  # ratio of difflib, from which an unknown column is taken for a misspelled one


@dataclass(frozen=True)
class TableContents:
    """Contents of a table.

    Attributes:
        scenario: Robots, pads and support of rows of arms; None: free bodies.
        questions: Whether velocities after the impact are to be predicted and not read.
        ball: Whether the bodies are balls.
        shaped: Whether the geometry of the bodies is known.
        joints: Whether some joint has a velocity after the impact.
        centre: Whether the velocity of the centre after the impact is compared, not a distance.
        turning: Whether the body has an angular velocity after the impact.
    """

    scenario: Scenario | None
    questions: bool
    ball: bool
    shaped: bool
    joints: bool
    centre: bool
    turning: bool

    @classmethod
    def of(cls, cells: ImpactCells, scenario: Scenario | None, questions: bool) -> TableContents:
        """Contents by the columns of a table."""
        return cls(
            scenario,
            questions,
            ball=col.RADIUS in cells,
            shaped=any(column in cells for column in (col.SIZE, col.RADIUS, col.MESH)),
            joints=any(column in cells for column in _joint_columns(scenario, col.DQ_AFTER)),
            centre=col.V_AFTER in cells or not any(column in cells for column in col.DISTANCES),
            turning=col.W_AFTER in cells,
        )

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms; empty: free bodies."""
        return () if self.scenario is None else tuple(self.scenario.robots)

    def names(self, columns: JointColumnGroup, arm: str) -> tuple[str, ...]:
        """Names of the columns of an arm: its floating base, then its joints."""
        assert self.scenario is not None
        return columns.names(arm_label(arm, self.arms), self.scenario.robots[arm].robot_facts)


def read_with_contents(
    path: Path, scenario: Scenario | None, questions: bool, covariates: Sequence[str]
) -> tuple[ImpactCells, TableContents, dict[str, str]]:
    """Cells and contents of a table, and the headers of its covariates by name.

    Raises:
        InputError: Not a table; a column is missing, has a wrong unit or no meaning; or two columns contradict.
    """
    if scenario is not None and scenario.neighbours:
        text = f"scenario {scenario.name!r} has neighbours, whose poses no table has: {', '.join(scenario.neighbours)}"
        raise InputError(f"{text}; take trials (diagnose DIRECTORY), or a scenario without neighbours", file=path)
    groups = [*col.COLUMNS, *(column for columns in col.JOINT_COLUMNS for column in _joint_columns(scenario, columns))]
    cells = with_velocities(read_cells(path, groups))
    declared = _declared(cells, covariates)
    _check_others(cells, groups, scenario, declared)
    contents = TableContents.of(cells, scenario, questions)
    for contradiction in _contradictions(cells, contents):
        raise InputError(contradiction, file=path)
    _check_needed(cells, contents)
    return cells, contents, declared


def unread(cells: ImpactCells, contents: TableContents, covariates: dict[str, str]) -> tuple[str, ...]:
    """Headers of the columns that are not used."""
    headers = [header for header in cells.unknown if header not in covariates.values()]
    if contents.centre:
        headers += [
            cells.header(column) for column in col.COLUMNS if column in cells and column.instead_of == col.V_AFTER.first
        ]
    return tuple(headers)


def _joint_columns(scenario: Scenario | None, columns: JointColumnGroup) -> Iterator[ColumnGroup]:
    """Columns of all joints of all arms."""
    robots = {} if scenario is None else scenario.robots
    for arm, robot in robots.items():
        yield from columns.of_arm(arm_label(arm, robots), robot.robot_facts)


def _declared(cells: ImpactCells, covariates: Sequence[str]) -> dict[str, str]:
    """Headers of the covariates by their names."""
    headers = {name_and_unit(header)[0]: header for header in cells.columns}
    for position, name in enumerate(covariates):
        if name in covariates[:position]:
            raise InputError(f"column {name!r} is named twice", file=cells.path, key="--covariates")
        if name not in headers:
            text = f"no column {name!r}{did_you_mean(name, headers)}; there are: {', '.join(headers)}"
            raise InputError(text, file=cells.path, key="--covariates")
    return {name: headers[name] for name in covariates}


def _check_others(
    cells: ImpactCells, groups: Sequence[ColumnGroup], scenario: Scenario | None, declared: dict[str, str]
) -> None:
    """Refuse unknown columns that belong to joints, or resemble a known column."""
    undeclared = [header for header in cells.unknown if header not in declared.values()]
    joints = [header for header in undeclared if is_joint_column(name_and_unit(header)[0])]
    if joints and scenario is None:
        text = "belongs to an arm; give robot, pad and support with --scenario NAME"
        raise InputError(f"column {joints[0]!r} {text}", file=cells.path)
    if joints and scenario is not None:
        counts = ", ".join(f"{arm} has {robot.robot_facts.joint_count}" for arm, robot in scenario.robots.items())
        text = f"column {joints[0]!r} belongs to no joint or floating base of scenario {scenario.name!r} ({counts})"
        raise InputError(text, file=cells.path)
    free = {name: group.unit for group in groups for name in group.names if name not in cells}
    for header in undeclared:
        if close := get_close_matches(name_and_unit(header)[0], free, n=1, cutoff=MIN_SIMILARITY):
            meant = with_unit(close[0], free[close[0]])
            raise InputError(f"no column is called {header!r}; did you mean {meant!r}?", file=cells.path)


def _check_needed(cells: ImpactCells, contents: TableContents) -> None:
    """Refuse a table that lacks a column."""
    if contents.scenario is None and not any(name in cells for name in (*col.V_BEFORE.names, *col.POSITION.names)):
        alternatives = " or ".join(repr(column.header) for column in col.FLIGHTS_BEFORE)
        text = f"no velocity before the impacts: expected {col.V_BEFORE.header!r} ..., or of a ball that falls straight"
        raise InputError(f"{text} {alternatives}; {_available(cells)}", file=cells.path)
    for column in _needed(cells, contents):
        for name, header in zip(column.names, column.headers, strict=True):
            if name not in cells:
                suggestion = did_you_mean(header, cells.unknown)
                raise InputError(f"no column {header!r}{suggestion}; {_available(cells)}", file=cells.path)
    if col.SHAPE in cells and col.SIZE not in cells:
        raise InputError(f"column {col.SHAPE.first!r} without {col.SIZE.header!r} ...: its extents", file=cells.path)
    if contents.scenario is None and not (contents.shaped or col.POINTS[0] in cells):
        text = f"expected its size ({col.SIZE.header!r} ...) or contact points ({col.POINTS[0].header!r} ...)"
        raise InputError(f"nothing says where the body touches; {text}; {_available(cells)}", file=cells.path)
    if contents.scenario is None and not (contents.shaped or col.MOMENTS in cells):
        text = f"expected principal moments ({col.MOMENTS.header!r} ...) or its size ({col.SIZE.header!r} ...)"
        raise InputError(f"nothing says how hard the body is to turn; {text}; {_available(cells)}", file=cells.path)


def _available(cells: ImpactCells) -> str:
    return f"there are: {', '.join(cells.columns)}"


def _needed(cells: ImpactCells, contents: TableContents) -> Iterator[ColumnGroup]:
    """Columns that a table must have."""
    yield from () if contents.ball else (col.POSITION, col.ORIENTATION)
    yield from (col.V_BEFORE, col.W_BEFORE)
    if contents.centre and not contents.questions:
        yield col.V_AFTER
    joints = [col.Q, col.DQ_BEFORE, *([col.DQ_AFTER] if contents.joints and not contents.questions else [])]
    if any(column in cells for column in _joint_columns(contents.scenario, col.MOTOR_INERTIA)):
        joints.append(col.MOTOR_INERTIA)
    for columns in joints:
        yield from _joint_columns(contents.scenario, columns)
    if contents.scenario is None:
        yield col.MASS
    after = (col.V_AFTER, col.W_AFTER) if contents.questions else ()
    yield from (column for column in col.COLUMNS if column in cells and column not in after)  # all components, or none


def _contradictions(cells: ImpactCells, contents: TableContents) -> Iterator[str]:
    """Errors, in words: columns that exclude or require each other, or do not fit the kind of rows."""
    header, scenario = cells.header, contents.scenario
    shaped = "" if scenario is None else f"scenario {scenario.name!r} has the shape of its objects"
    if contents.ball and scenario is not None:
        yield f"column {header(col.RADIUS)!r} is of a free ball; {shaped}"
    if col.SHELL in cells and not contents.ball:
        yield f"column {header(col.SHELL)!r} without {col.RADIUS.header!r}: it is of balls"
    for column in (col.SHAPE, col.MESH, col.SIZE, col.POINTS[0]):
        if contents.ball and column in cells:
            pair = f"columns {header(col.RADIUS)!r} and {header(column)!r}"
            yield f"{pair}: expected one of them; a ball touches below its centre"
    for column in (col.SHAPE, col.MESH):
        if scenario is not None and column in cells:
            yield f"column {header(column)!r} is of a free body; {shaped}"
    if not contents.centre:
        yield from _contradictions_of_distances(cells, contents)


def _contradictions_of_distances(cells: ImpactCells, contents: TableContents) -> Iterator[str]:
    """Errors of a table with distances, in words: columns with which no law predicts a distance."""
    header = cells.header
    if col.SLIDE_DISTANCE in cells and contents.scenario is None:
        text = "a free body has no support on which it slides; flight_distance and fall_height say how far it flew"
        yield f"column {header(col.SLIDE_DISTANCE)!r}: {text}"
    if col.FLIGHT_DISTANCE in cells and col.FALL_HEIGHT not in cells:
        yield f"column {header(col.FLIGHT_DISTANCE)!r} without {col.FALL_HEIGHT.header!r}: how far the centre fell"
    if contents.turning:
        first = next(header(column) for column in col.DISTANCES if column in cells)
        yield f"column {first!r} stands in place of velocities after; leave out {', '.join(col.W_AFTER.names)}"
