# SPDX-License-Identifier: Apache-2.0
"""Search for recordings and runs.

A *recording* is a file or the folder of a bag (:func:`find_recordings`). A *run* is one experiment. A mapping describes
how recordings contain runs (:func:`find_runs`):

    hit_1.csv, hit_2.mcap/                  a recording is a run
    recordings.h5/Rec_001, log.csv/3        a recording holds several (:mod:`inner_runs`), called as files in a folder
    run_1/joints.csv, run_1/pose.csv        a run is a folder with the files that the mapping names
    joints_1.csv, pose_1.csv                a run is the name that replaces ``{run}`` in them

A table of runs names them (:func:`find_run`). Hidden files and folders hold neither: they are copies of editors and
file systems, or half-written.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_trials.file_names import BAG_METADATA, RUN_TABLE
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.readers.array_file import ArrayFile
from impact_rs_trials.recordings.readers.inner_runs import RUN
from impact_rs_trials.recordings.readers.json_table import JSON_SUFFIXES
from impact_rs_trials.recordings.readers.lerobot import INFO
from impact_rs_trials.recordings.readers.table_columns import run_names
from impact_rs_trials.recordings.readers.text_file import suffix_of

ROS1_SUFFIX = ".bag"
BAG_SUFFIXES = (".db3", ".mcap", ROS1_SUFFIX)
# Endings of tables that may also be notes: read if they are named, or if a folder has no other recordings.
NOTE_SUFFIXES = (".txt", ".dat", *JSON_SUFFIXES)
TABLE_SUFFIXES = (".csv", ".tsv", ".parquet", ".npy", *NOTE_SUFFIXES)
TORCH_SUFFIX = ".pt"  # like notes: the file may hold the weights of a network
ARRAY_SUFFIXES = (".npz", ".h5", ".hdf5", ".mat", TORCH_SUFFIX)
FILE_SUFFIXES = (*BAG_SUFFIXES, *TABLE_SUFFIXES, *ARRAY_SUFFIXES)
SEARCHED_SUFFIXES = tuple(suffix for suffix in FILE_SUFFIXES if suffix not in (*NOTE_SUFFIXES, TORCH_SUFFIX))
PLACEHOLDERS = ("run", "object", "arm")  # of names of files in a mapping


def natural_key(name: str | Path) -> list[tuple[bool, int, str]]:
    """Natural sort key: run 9 comes before run 10."""
    parts = re.split(r"(\d+)", str(name))
    return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


def visible(folder: Path, paths: Iterable[Path]) -> list[Path]:
    """Paths below a folder that are not hidden: no name below the folder begins with a dot."""
    return [path for path in paths if not any(name.startswith(".") for name in path.relative_to(folder).parts)]


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a bag."""
    return (path / BAG_METADATA).is_file()


def name_of(path: Path) -> str:
    """Name of a run, without the ending of a file."""
    return path.stem if suffix_of(path) in FILE_SUFFIXES and not path.is_dir() else path.name


def unique_names(names: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """Names of recordings; repeated names become paths from their common folder, for example ``day_1/log.csv``.

    Args:
        names: Names of the recordings.
        paths: Paths of the recordings.
    """
    folders: dict[str, list[Path]] = {}
    for name, path in zip(names, paths, strict=True):
        folders.setdefault(name, []).append(path.parent)
    return [
        name if len(folders[name]) == 1 else path.relative_to(os.path.commonpath(folders[name])).as_posix()
        for name, path in zip(names, paths, strict=True)
    ]


def find_recordings(path: Path, notes: bool = False) -> list[Path]:
    """The recording at ``path``, or all recordings below a folder, sorted by path.

    Tables of runs and the descriptions of LeRobot data sets are left out.

    Args:
        path: File or folder.
        notes: Whether texts are recordings, too, if a folder has no other recordings.

    Raises:
        InputError: No recording is found.
    """
    if path.is_file():
        if suffix_of(path) not in FILE_SUFFIXES:
            suffixes = ", ".join(FILE_SUFFIXES)
            raise InputError(f"expected a recording ({suffixes}), or a folder of them; spreadsheets as .csv", file=path)
        return [path]
    if not path.is_dir():
        raise InputError("no such file or folder", file=path)
    if is_bag_folder(path):
        return [path]
    bags = {file.parent for file in visible(path, path.rglob(BAG_METADATA))}
    data_sets = {file.parent for file in path.rglob(str(INFO))}
    files = {
        file
        for file in visible(path, path.rglob("*"))
        if suffix_of(file) in FILE_SUFFIXES and file.name != RUN_TABLE and file.parent not in bags and file.is_file()
        if data_sets.isdisjoint(file.parents)
    }
    searched_files = {file for file in files if suffix_of(file) in SEARCHED_SUFFIXES}
    recordings = bags | (searched_files if searched_files or bags or not notes else files)
    if not recordings:
        expected = f"{', '.join(FILE_SUFFIXES if notes else SEARCHED_SUFFIXES)} or the folder of a bag"
        raise InputError(f"no recording here; expected {expected}", file=path)
    return sorted(recordings)


def find_runs(path: Path, mapping: Mapping) -> list[Path]:
    """The runs at a path.

    Args:
        path: A recording, a run inside of it, the name of a run in files of its name, or a folder of any of these.
        mapping: Describes how recordings contain runs.

    Raises:
        InputError: No run is found, or a recording cannot be read.
    """
    patterns = _file_patterns(mapping)
    if path.is_dir() and None not in patterns:
        runs = _spread_below(path, mapping) if mapping.spread else _run_folders(path, mapping)
        if not runs:
            files = ", ".join(sorted(map(str, patterns)))
            raise InputError(
                f"no run here has the files that signals.NAME.file of the mapping names: {files}", file=path
            )
        return runs
    if mapping.spread and path.parent.is_dir() and not path.exists():
        if path not in (neighbours := _spread_runs(path.parent, mapping)):
            names = ", ".join(run.name for run in neighbours) or "none"
            raise InputError(f"no run of this name; runs that signals.NAME.file finds here: {names}", file=path)
        return [path]
    if not mapping.holds_runs:
        return find_recordings(path, notes=True)
    recordings = [] if path.parent.is_file() else find_recordings(path, notes=True)
    return [run for file in recordings for run in _runs_inside(file, mapping)] or [path]


def find_run(folder: Path, name: str, mappings: Sequence[Mapping]) -> Path:
    """Find a run of a table of runs: a recording, with or without its ending, or a run of :func:`find_runs`.

    Args:
        folder: Folder of the recordings.
        name: Name or path of the run, relative to the folder.
        mappings: Mappings of all arms.

    Raises:
        InputError: No run or several runs have this name.
    """
    if not name:
        raise InputError("expected the name of a recording")
    path = folder / name
    if all(mapping.spread for mapping in mappings):
        runs = _spread_runs(path.parent, mappings[0]) if path.parent.is_dir() else []
        if path in runs:
            return path
        files = ", ".join(sorted({str(file) for mapping in mappings for file in _file_patterns(mapping)}))
        suggestion = did_you_mean(path.name, [run.name for run in runs])
        raise InputError(f"no such run among the files {files} in {path.parent}{suggestion}")
    try:
        if path.exists() or path.parent.is_file() and any(mapping.holds_runs for mapping in mappings):
            return path
    except (OSError, ValueError):  # a name that no file can have
        raise InputError("expected the name of a recording") from None
    neighbours = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    matches = [file for file in neighbours if file.name != name_of(file) == path.name]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise InputError(f"{', '.join(file.name for file in matches)} are all there; name one of them")
    names = [item.name for item in neighbours] + [item.stem for item in neighbours]
    raise InputError(f"no such recording in {path.parent}{did_you_mean(path.name, names)}")


def _file_patterns(mapping: Mapping) -> set[str | None]:
    """File patterns of the signals of a mapping; None: the run's own file."""
    return {source.file for source in mapping.signals.values()}


def _spread_below(folder: Path, mapping: Mapping) -> list[Path]:
    """Runs of :func:`_spread_runs` in a folder and its subfolders; each folder is a session."""
    below = sorted(
        (subfolder for subfolder in visible(folder, folder.rglob("*")) if subfolder.is_dir()), key=natural_key
    )
    return [run for session in (folder, *below) for run in _spread_runs(session, mapping)]


def _spread_runs(folder: Path, mapping: Mapping) -> list[Path]:
    """Runs whose signals lie in several files of a folder, each with the run's name, in natural order."""
    runs = set()
    for pattern in filter(None, _file_patterns(mapping)):
        expression = re.escape(pattern)
        for part in PLACEHOLDERS:
            expression = _with_group(expression, re.escape(f"{{{part}}}"), part)
        files = visible(folder, folder.iterdir())
        runs |= {match["run"] for file in files if (match := re.fullmatch(expression, file.name))}
    return [folder / run for run in sorted(runs, key=natural_key)]


def _run_folders(folder: Path, mapping: Mapping) -> list[Path]:
    """Folders of one run each, which have all files of the mapping: this folder, or folders below it."""
    files = sorted(filter(None, _file_patterns(mapping)))
    folders = {file_path.parent for file_path in visible(folder, folder.rglob(Path(files[0]).name))}
    return sorted((run for run in folders if all((run / file).is_file() for file in files)), key=natural_key)


def _runs_inside(file: Path, mapping: Mapping) -> list[Path]:
    """Runs inside a file (:mod:`inner_runs`), each named as a file in a folder; the file itself if it is one run."""
    if mapping.run_column is not None and suffix_of(file) in TABLE_SUFFIXES:
        runs = dict.fromkeys(run_names(file, mapping.table, mapping.run_column))
        if unusable := [run for run in runs if "/" in run or run in ("", ".", "..")]:
            message = "expected the name of a run in every row, without /"
            raise InputError(message, file=file, key=f"column {mapping.run_column}", value=unusable[0])
        return [file / run for run in runs]
    arrays = {source.array for source in mapping.signals.values() if source.array is not None and RUN in source.array}
    if not arrays or suffix_of(file) not in ARRAY_SUFFIXES:
        return [file]
    runs_found: set[str] = set()
    names = ArrayFile.names_of(file)
    for array in arrays:
        expression = _with_group(re.escape(array.strip("/")), re.escape(RUN), "run")
        runs_found |= {match["run"] for name in names if (match := re.fullmatch(expression, name))}
    return [file / run for run in sorted(runs_found, key=natural_key)] if runs_found - {file.stem} else [file]


def _with_group(expression: str, placeholder: str, name: str) -> str:
    """A regular expression with a placeholder as a named group: text without a slash, equal at all positions."""
    once = expression.replace(placeholder, f"(?P<{name}>[^/]+)", 1)
    return once.replace(placeholder, f"(?P={name})")
