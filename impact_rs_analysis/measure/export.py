# SPDX-License-Identifier: Apache-2.0
"""A campaign as one file for other tools: a row per trial (Parquet), or all measured signals (HDF5).

Only the robot's own topics are exported; ``/truth`` stays in the bags. Column names end with their unit; the
attribute ``units`` of a dataset is its unit.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from impact_rs_analysis.measure.analyze import SkippedBag
from impact_rs_analysis.measure.net_feedback import net_feedback
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole
from impact_rs_sim.optional_packages import require
from impact_rs_sim.robots.robot import Array, joined_units
from impact_rs_sim.version import package_version
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag, reason_of
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.store import Folder
from impact_rs_trials.workers import Map

PACKAGE_BY_SUFFIX = {".parquet": "pyarrow", ".h5": "h5py", ".hdf5": "h5py"}

CONTROLLER_UNITS = {
    "mode": "0 ante-impact, 1 interim, 2 post-impact",
    "gamma": "1",
    "ante_position": "m",
    "ante_velocity": "m/s",
    "ante_acceleration": "m/s^2",
    "post_position": "m",
    "post_velocity": "m/s",
    "post_acceleration": "m/s^2",
    "position": "m",
    "twist": "m/s, rad/s",
    "feedback_acceleration": "m/s^2",
    "net_feedback": "m/s",
    "external_wrench": "N, N m",
}


@dataclass(frozen=True)
class Exported:
    """Result of an export.

    Attributes:
        trials: Number of trials in the file.
        skipped: Bags that could not be read.
    """

    trials: int
    skipped: tuple[SkippedBag, ...]


def check_target(path: Path) -> None:
    """Check the target file before bags are read.

    Raises:
        InputError: The ending is not .parquet, .h5 or .hdf5, it is a folder, or a package is not installed.
    """
    if path.suffix not in PACKAGE_BY_SUFFIX:
        raise InputError(
            f"expected a name that ends with {', '.join(PACKAGE_BY_SUFFIX)}, or a folder without ending", file=path
        )
    if path.is_dir():
        raise InputError("this is a folder; expected the name of a file", file=path)
    require(PACKAGE_BY_SUFFIX[path.suffix], path)


def export(directory: Path, path: Path, map_tasks: Map, progress: Callable[[int, int], None]) -> Exported:
    """Write all readable trials below a folder into one file, atomically.

    Args:
        directory: Folder with bags of trials at any depth.
        path: File that ends with .parquet, .h5 or .hdf5; an existing one is replaced.
        map_tasks: Parallel map; not used for signals.
        progress: Called with the number of bags read and the number of all bags.

    Raises:
        InputError: As :func:`check_target`, no readable trial in the folder, or a file that cannot be written.
    """
    check_target(path)
    bags = sorted(directory / name for name in Folder(directory).stamps())
    trials, skipped = 0, []
    write = _parquet if path.suffix == ".parquet" else _hdf5
    with whole(path) as partial:
        for number, skip in enumerate(write(directory, bags, partial, map_tasks), start=1):
            if skip is None:
                trials += 1
            else:
                skipped.append(skip)
            progress(number, len(bags))
        if not trials:
            reason = f"; {skipped[0].name}: {skipped[0].reason}" if skipped else ""
            raise InputError(f"no readable trials here{reason}", file=directory)
    return Exported(trials, tuple(skipped))


def trial_row(path: Path) -> dict[str, Any] | SkippedBag:
    """One trial as a row: plan, outcome and measurements; or the reason why it cannot be read.

    If the net feedback is not valid (no impact, object dropped, gaps in the recording), ``remark`` has the reason.
    """
    try:
        bag = TrialBag.open(path)
        impact_times = {f"{arm}_impact_time_s": _or_none(bag.impact_time(arm)) for arm in bag.info.robots}
    except Exception as error:  # a damaged bag must not stop the others
        return SkippedBag(path.name, reason_of(error))
    net, impact, remark = None, None, ""
    try:
        measured = net_feedback(bag)
        net, impact = measured.net, measured.impact
        remark = "" if impact else "no impact in the window"
    except Exception as error:
        remark = reason_of(error)
    info = bag.info
    return {
        "trial": path.name,
        **_identity(info),
        "outcome": bag.outcome,
        "impact": impact,
        "ante_velocity_m_s": info.ante_velocity,
        "predicted_post_velocity_m_s": info.predicted_post_velocity,
        "reference_post_velocity_m_s": info.reference_post_velocity,
        "net_feedback_m_s": net,
        **impact_times,
        "window_start_s": info.window_start,
        "window_end_s": info.window_end,
        "remark": remark,
        "via": info.via,
        "git_revision": info.git_revision,
        "package_version": info.package_version,
    }


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def _identity(info: TrialInfo) -> dict[str, Any]:
    return {
        "scenario": info.scenario,
        "object": info.object,
        "case": info.case_name,
        "velocity_scale": info.velocity_scale,
        "repeat": info.repeat,
        "seed": info.seed,
        "motor_inertia": info.motor_inertia,
        "axis": info.axis,
    }


def _parquet(directory: Path, bags: list[Path], target: Path, map_tasks: Map) -> Iterator[SkippedBag | None]:
    import pyarrow.parquet

    rows = []
    for bag, row in zip(bags, map_tasks(trial_row, bags), strict=True):
        if isinstance(row, SkippedBag):
            yield row
        else:
            rows.append({**row, "bag": _place(directory, bag)})
            yield None
    pyarrow.parquet.write_table(table_of(rows), target)


def _place(directory: Path, bag: Path) -> str:
    """Path of a bag below the campaign."""
    return bag.name if bag == directory else str(bag.relative_to(directory))


def table_of(rows: list[dict[str, Any]]) -> Any:
    """Rows as a :class:`pyarrow.Table` with the union of their columns: arms differ from scenario to scenario."""
    import pyarrow

    columns = dict.fromkeys(name for row in rows for name in row)
    return pyarrow.table({name: _column(name, [row.get(name) for row in rows]) for name in columns})


def _column(name: str, values: list[Any]) -> Any:
    """A column whose type is fixed, even if all its values are missing."""
    import pyarrow

    kind = {
        "seed": pyarrow.uint64(),
        "stamp": pyarrow.uint64(),
        "repeat": pyarrow.uint32(),
        "impact": pyarrow.bool_(),
    }.get(name)
    if kind is None and name.endswith(("_s", "velocity_scale")):
        kind = pyarrow.float64()
    return pyarrow.array(values, kind or pyarrow.string())


def _hdf5(directory: Path, bags: list[Path], target: Path, map_tasks: Map) -> Iterator[SkippedBag | None]:
    import h5py

    del map_tasks
    with _Target(target) as raw, raw.failing_in_words(), h5py.File(raw, "w") as file:
        file.attrs["made_by"] = f"impact-rs {package_version()}"
        for path in bags:
            name = _place(directory, path)
            try:
                _hdf5_trial(file.create_group(name), TrialBag.open(path))
                skip = None
            except Exception as error:  # as in a table
                if name in file:
                    del file[name]
                skip = SkippedBag(path.name, reason_of(error))
            if raw.error is not None:
                break
            yield skip


class _Target(io.FileIO):
    """A file for HDF5, whose library crashes on a failed write: the first error is kept, and later writes are ignored.

    Attributes:
        error: Error of the first failed write; None without one.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.error: OSError | None = None

    @contextmanager
    def failing_in_words(self) -> Iterator[None]:
        """Raise the first write error at the end of the context, instead of the error of the library."""
        try:
            yield
        except Exception:
            if self.error is None:
                raise
        if self.error is not None:
            raise self.error

    def write(self, data: Any) -> int:
        """Write all data, or keep the error."""
        size = memoryview(data).nbytes
        remaining = memoryview(data).cast("B")
        try:
            while remaining and self.error is None:
                remaining = remaining[super().write(remaining) :]
        except OSError as error:
            self.error = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Change the length, or keep the error."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0


def _hdf5_trial(group: Any, bag: TrialBag) -> None:
    for key, value in _identity(bag.info).items():
        group.attrs[key] = value
    group.attrs["outcome"] = bag.outcome
    for key in ("ante_velocity", "predicted_post_velocity", "reference_post_velocity"):
        group.attrs[f"{key}_m_s"] = getattr(bag.info, key)
    for arm in bag.info.robots:
        group.attrs[f"{arm}_impact_time_s"] = bag.impact_time(arm)
        for name, (columns, units) in _signals(bag, arm).items():
            _datasets(group.create_group(f"{arm}/{name}"), columns, units)
    for body in ("object", *bag.info.neighbours):
        _datasets(group.create_group(body), bag.poses(topics.pose(body)), {"position": "m", "quaternion": "1"})


def _signals(bag: TrialBag, arm: str) -> dict[str, tuple[Any, dict[str, str]]]:
    """Columns of an arm and their units, by name of the group; every topic has its own time stamps."""
    joints = bag.info.spec.scenario.robots[arm].robot_facts.units
    quantities = ("position", "velocity", "effort")
    units = {name: joined_units(getattr(joint, name) for joint in joints) for name in quantities}
    return {
        "joint_states": (bag.joints(topics.joint_states(arm)), units),
        "motor_states": (bag.joints(topics.motor_states(arm)), {name: units[name] for name in quantities[:2]}),
        "joint_command": (bag.joints(topics.joint_command(arm)), {"effort": units["effort"]}),
        "controller_state": (bag.controller(arm), CONTROLLER_UNITS),
    }


def _datasets(group: Any, columns: Any, units: dict[str, str]) -> None:
    for name, unit in {"time": "s", **units}.items():
        values: Array = getattr(columns, name)
        group.create_dataset(name, data=values, compression="gzip" if values.size else None).attrs["units"] = unit
