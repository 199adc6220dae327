# SPDX-License-Identifier: Apache-2.0
"""Description of a laboratory's runs: ``experiment.yaml``, and the table of runs that it names.

    scenario: push                                # robots, objects, support and contact come from here
    mapping: joint_state_effort_controller        # where the signals are
    runs: runs.csv                                # bag, object, kind; further columns become conditions

Several arms have one mapping each (``mapping: {left: left.yaml, right: right.yaml}``), or a common one with ``{arm}``
in its names. References and control of the scenario are not used, because another controller moved the arm.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
import pinocchio as pin
from pydantic import Field, PrivateAttr, field_validator, model_validator

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import Positive, PositiveVector3, Schema, Vector3, load
from impact_rs_sim.shapes import check_extents
from impact_rs_trials.file_names import EXPERIMENT_FILE, RUN_TABLE
from impact_rs_trials.recordings.free_bodies import body_of_mesh, body_of_shape
from impact_rs_trials.recordings.mapping import Mapping, load_mapping
from impact_rs_trials.recordings.readers.run_finder import find_run, name_of
from impact_rs_trials.recordings.readers.table_columns import read_columns

HIT = "hit"
FREE_MOTION = "free motion"
KINDS = (HIT, FREE_MOTION)
NO_OBJECT = "none"
BODY = "body"  # object of runs without a robot
COLUMNS = ("bag", "object", "kind")
SESSION = "session"  # column of the table of runs that the table of impacts has as well
YAML = (".yaml", ".yml")
FRICTION_SIGMA_SHARE = 0.1  # relative standard deviation of a scenario's friction if it gives none
MAX_LISTED_RUNS = 20  # in an error

Result = TypeVar("Result")


class FramePlacement(Schema):
    """Placement of one frame in another."""

    position: Vector3 = Field((0.0, 0.0, 0.0), description="origin of the frame [m]")
    rpy: Vector3 = Field((0.0, 0.0, 0.0), description="roll, pitch and yaw of the frame [rad]")

    @property
    def placement(self) -> pin.SE3:
        """The placement as a transform."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), np.array(self.position))


class MotionCapture(FramePlacement):
    """Placement of the world of the motion capture in the inertial frame A of the scenario."""

    estimate: bool = Field(
        False,
        description="estimate position and yaw from the impacts; roll, pitch, and the position across hits of one "
        "direction keep the given values",
    )
    bodies: dict[str, FramePlacement] = Field(
        default_factory=dict,
        description="by object: geometric centre and axes in the tracked frame",
    )


class Body(Schema):
    """A body without a robot that hits a fixed plane."""

    mass: Positive = Field(description="mass [kg]")
    shape: Literal["box", "sphere", "capsule", "cylinder"] = Field(
        "box", description="shape with the extents size; capsule and cylinder have the axis z [-]"
    )
    mesh: str | None = Field(
        None,
        description="mesh file, a path from this file's folder, in place of shape: gives hull, extents where size is "
        "absent, centre of mass and inertia (even density)",
    )
    size: PositiveVector3 | None = Field(None, description="extent along its own axes [m]")
    radius: Positive | None = Field(None, description="radius of a ball [m]")
    shell: bool = Field(False, description="whether a ball is hollow, 2/3 m r^2; else solid, 2/5 m r^2")
    inertia: PositiveVector3 | None = Field(
        None,
        description="principal moments about the centre of mass, along its own axes [kg m^2]; absent: homogeneous",
    )
    place: FramePlacement = Field(
        default_factory=FramePlacement, description="geometric centre and axes in the tracked frame"
    )
    spin: Vector3 | None = Field(
        None,
        description="angular velocity before impact of a ball without tracked rotation, in axes of the tracker [rad/s]",
    )

    @property
    def item(self) -> ObjectPhysics:
        """The rigid body."""
        if self.mesh is not None:
            body = body_of_mesh(Path(self.mesh), self.mass, self.size)
        elif self.radius is not None:
            body = body_of_shape("sphere", self.mass, [2.0 * self.radius] * 3, self.shell)
        else:
            assert self.size is not None
            body = body_of_shape(self.shape, self.mass, self.size)
        return body if self.inertia is None else replace(body, inertia=np.array(self.inertia))

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if self.radius is not None and (self.size is not None or self.mesh is not None or self.shape != "box"):
            raise ValueError("radius is for a ball: leave out shape, mesh and size [m]")
        if self.radius is None and self.mesh is None and self.size is None:
            raise ValueError("expected size, with shape, or mesh, or radius of a ball [m]")
        if self.mesh is not None and self.shape != "box":
            raise ValueError("expected either shape or mesh")
        if self.mesh is None and self.size is not None:
            check_extents(self.shape, self.size)
        if self.spin is not None and self.radius is None:
            raise ValueError("spin is for balls: the rotation of a box must be tracked")
        return self


class Plane(Schema):
    """The plane that a body hits, in the world of the tracker."""

    height: float = Field(0.0, description="distance from the origin along its normal [m]")
    normal: Vector3 = Field((0.0, 0.0, 1.0), description="its normal, towards the body [-]")
    friction: Annotated[float, Field(ge=0.0)] = Field(0.3, description="assumed Coulomb coefficient [-]")
    restitution: Annotated[float, Field(ge=0.0, le=1.0)] = Field(0.0, description="assumed restitution [-]")
    gravity: Vector3 = Field((0.0, 0.0, -9.81), description="free fall in the tracker's world [m/s^2]")

    @field_validator("normal")
    @classmethod
    def _has_a_direction(cls, normal: Vector3) -> Vector3:
        if not any(normal):
            raise ValueError("the normal has no direction; expected a vector that is not zero")
        return normal


class Experiment(Schema):
    """An experiment file; :func:`load_experiment` reads one."""

    scenario: str | None = Field(
        None,
        description="name or path of the scenario, if a robot hits",
    )
    body: Body | None = Field(None, description="a body without a robot, in place of scenario")
    plane: Plane | None = Field(None, description="the plane that it hits; absent: z = 0")
    mapping: str | dict[str, str] = Field(
        "joint_state_effort_controller",
        description="name or path of the mapping; one by arm, or one for all with {arm} for the name",
    )
    runs: str = Field(RUN_TABLE, description="table of runs, a path from the recordings or from this file")
    motion_capture: MotionCapture = Field(
        default_factory=MotionCapture,
        description="world frame of the motion capture in the inertial frame of the scenario",
    )
    friction_noise: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        FRICTION_SIGMA_SHARE,
        description="relative standard deviation of the support's friction from hit to hit [-], which sliding "
        "distances have; velocities from them have half. Without the error that all hits share: the effect "
        "support_friction has it",
    )
    _file: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _robot_or_body(self) -> Self:
        if (self.scenario is None) == (self.body is None):
            raise ValueError(
                "expected either scenario, where a robot hits, or body, where a body without one hits a plane"
            )
        if self.plane is not None and self.body is None:
            raise ValueError("plane goes with body; with a robot, the scenario has the surroundings")
        return self

    @property
    def file(self) -> Path | None:
        """File that it was read from."""
        return self._file

    @property
    def folder(self) -> Path:
        """Folder of the file, to which its paths are relative."""
        return Path() if self.file is None else self.file.parent

    def load_scenario(self) -> Scenario:
        """The scenario.

        Raises:
            InputError: The file is missing or breaks its schema, or the experiment has a body without a robot.
        """
        if self.scenario is None:
            raise InputError(
                "a body without a robot hits a plane: impact-rs impacts makes a table of its impacts, which compare "
                "and diagnose take with --impacts", file=self.file, key="body",
            )  # fmt: skip
        return load_scenario(self._path(self.scenario))

    def load_mappings(self, arms: Collection[str]) -> dict[str, Mapping]:
        """The mapping of every arm.

        Args:
            arms: Names of the scenario's arms.

        Raises:
            InputError: A mapping is missing or breaks its schema.
        """
        if isinstance(self.mapping, str):
            return dict.fromkeys(arms, load_mapping(self._path(self.mapping)))
        for arm in arms:
            if arm not in self.mapping:
                raise InputError(f"no mapping of arm {arm!r}", file=self.file, key="mapping")
        for arm in self.mapping:
            if arm not in arms:
                expected = f"expected {', '.join(arms)}{did_you_mean(arm, arms)}"
                raise InputError(f"the scenario has no such arm, {expected}", file=self.file, key="mapping", value=arm)
        return {arm: load_mapping(self._path(self.mapping[arm])) for arm in arms}

    def _path(self, name: str) -> str:
        return str(self.folder / name) if name.endswith(YAML) else name


def load_experiment(path: Path) -> Experiment:
    """Read an experiment file.

    Raises:
        InputError: It is missing, breaks the schema, or names an unknown scenario or mapping.
    """
    if path.is_dir():
        raise InputError(f"a folder where an experiment file is expected, {EXPERIMENT_FILE} for example", file=path)
    experiment = load(Experiment, path)
    if experiment.body is not None and experiment.body.mesh is not None:
        mesh = str((path.parent / experiment.body.mesh).absolute())
        body = experiment.body.model_copy(update={"mesh": mesh})
        _in_key(path, "body.mesh", mesh, lambda: body.item)
        experiment = experiment.model_copy(update={"body": body})
    experiment._file = path
    if experiment.scenario is None:
        return experiment
    scenario = _in_key(path, "scenario", experiment.scenario, experiment.load_scenario)
    mappings = experiment.mapping if isinstance(experiment.mapping, dict) else {"": experiment.mapping}
    for arm, mapping in mappings.items():
        key = f"mapping.{arm}" if arm else "mapping"
        _in_key(path, key, mapping, functools.partial(load_mapping, experiment._path(mapping)))
    experiment.load_mappings(scenario.robots)
    for name in experiment.motion_capture.bodies:
        _in_key(path, "motion_capture.bodies", name, functools.partial(scenario.object, name))
    return experiment


@dataclass(frozen=True)
class RunRow:
    """One row of the table of runs.

    Attributes:
        path: File or folder of the recording.
        object: Name of the object that was hit; None in free motion.
        hit: Whether something is hit.
        condition: Further columns, joined by ``/``.
        session: Column ``session``, a part of the condition; empty: the table has no such column.
    """

    path: Path
    object: str | None
    hit: bool
    condition: str
    session: str = ""

    @property
    def name(self) -> str:
        """Name of the recording, without the ending of a file."""
        return name_of(self.path)

    @property
    def label(self) -> str:
        """The name, prefixed with the session, because names may repeat between sessions."""
        return f"{self.session}/{self.name}" if self.session else self.name


def read_runs(directory: Path, experiment: Experiment, scenario: Scenario | None) -> list[RunRow]:
    """The table of runs, checked: every recording exists and is named once, and every object is known.

    Args:
        directory: Folder of the recordings.
        experiment: Names the table.
        scenario: Scenario with the objects; None: a body without a robot, which is called body.

    Raises:
        InputError: It cannot be used; the message names file, line, column, value and expected range.
    """
    if not directory.is_dir():
        problem = "a file where the folder of the recordings is expected" if directory.is_file() else "no such folder"
        raise InputError(problem, file=directory)
    paths = [directory / experiment.runs, experiment.folder / experiment.runs]
    path = next((place for place in paths if place.is_file()), None)
    if path is None:
        suggestion = did_you_mean(experiment.runs, [file.name for file in directory.iterdir() if file.is_file()])
        folders = f"{directory} or {experiment.folder}" if experiment.folder != directory else str(directory)
        raise InputError(f"no table of runs {experiment.runs!r} in {folders}{suggestion}", file=directory)
    objects = [BODY] if scenario is None else list(scenario.objects)
    mappings = list(experiment.load_mappings([BODY] if scenario is None else scenario.robots).values())
    rows = _table(path)
    condition_columns = [name for name in rows[0][1] if name not in COLUMNS]
    line_of: dict[Path, int] = {}
    runs = []
    for line, cells in rows:
        kind, name = cells["kind"], cells["object"]
        if kind not in KINDS:
            raise _wrong(path, line, "kind", kind, f"expected {HIT!r} or {FREE_MOTION!r}{did_you_mean(kind, KINDS)}")
        hit = kind == HIT
        if hit and name not in objects:
            expected_objects = ", ".join(objects)
            owner = "an experiment with body" if scenario is None else f"scenario {scenario.name!r}"
            raise _wrong(
                path,
                line,
                "object",
                name,
                f"expected an object of {owner}: {expected_objects}{did_you_mean(name, objects)}",
            )
        if not hit and name not in (NO_OBJECT, ""):
            raise _wrong(path, line, "object", name, f"expected {NO_OBJECT!r}, nothing is touched in free motion")
        try:
            recording = find_run(directory, cells["bag"], mappings)
        except InputError as error:
            raise _wrong(path, line, "bag", cells["bag"], error.message) from None
        if recording in line_of:
            raise _wrong(path, line, "bag", cells["bag"], f"stands in line {line_of[recording]} already")
        line_of[recording] = line
        condition = "/".join(cells[name] for name in condition_columns)
        runs.append(RunRow(recording, name if hit else None, hit, condition, cells.get(SESSION, "")))
    return runs


def run_named(table: Sequence[RunRow], directory: Path, name: str) -> RunRow:
    """Find a run by the name of its recording, or by its path in the folder if the name is ambiguous.

    Args:
        table: All runs.
        directory: Folder of the recordings.
        name: Name or path, with or without the ending of the file.

    Raises:
        InputError: No run or several runs have this name.
    """
    paths = {run.path: Path(os.path.relpath(run.path, directory)) for run in table}
    names_of = {
        run.path: {run.name, run.path.name, str(paths[run.path]), str(paths[run.path].with_suffix(""))} for run in table
    }
    matches = [run for run in table if name in names_of[run.path]]
    if len(matches) == 1:
        return matches[0]
    if matches:
        candidates = ", ".join(str(paths[run.path]) for run in matches)
        raise InputError(f"several runs have this name: {candidates}; name one by its path", key="run", value=name)
    names = [run.name for run in table]
    suggestion = did_you_mean(name, names)
    listed = f"{', '.join(names[:MAX_LISTED_RUNS])}{' ...' if len(names) > MAX_LISTED_RUNS else ''}"
    raise InputError(
        f"the table of runs names no such run{suggestion or f'; expected one of {listed}'}", key="run", value=name
    )


def _table(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Cells of every row by column, with its line number, without empty rows and quoted comments."""
    table = read_columns(path, recorded=False)
    if not table.cells:
        raise InputError(f"an empty table; expected the columns {', '.join(COLUMNS)}", file=path)
    header = list(table.cells)
    for name in COLUMNS:
        if name not in header:
            suggestion = did_you_mean(name, header)
            raise InputError(
                f"no column {name!r} in line {table.header}{suggestion}; found: {', '.join(header)}", file=path
            )
    rows = [[str(cell).strip() for cell in row] for row in zip(*table.cells.values(), strict=True)]
    lines = table.lines or range(1, len(rows) + 1)
    filled = [(line, row) for line, row in zip(lines, rows, strict=True) if any(row) and not row[0].startswith("#")]
    if not filled:
        raise InputError(f"no run below the header {','.join(header)}", file=path)
    return [(line, dict(zip(header, row, strict=True))) for line, row in filled]


def _wrong(path: Path, line: int, column: str, value: str, message: str) -> InputError:
    return InputError(message, file=path, key=f"line {line}, {column}", value=value)


def _in_key(path: Path, key: str, value: str, load: Callable[[], Result]) -> Result:
    """Result of ``load``; its errors name the key and the file that refer to it."""
    try:
        return load()
    except InputError as error:
        if error.file is not None and error.file != str(path):
            raise  # the error is in that file
        raise InputError(error.message, file=path, key=key, value=value) from None
