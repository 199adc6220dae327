# SPDX-License-Identifier: Apache-2.0
"""Which of many files belong to one run, and which hold the same of different runs, by their names.

    hit_1.csv, hit_2.csv                                       a file per run
    IIWA_7_hit_{run}.csv, object_1_hit_{run}.csv               a file per signal and run in one folder
    run_1/joints.csv, run_1/pose.csv, run_2/joints.csv, ...    a folder per run

Names that differ in numbers alone are of one kind; the last number that differs is the run's.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.sources import (
    FILE_SUFFIXES,
    NOTE_SUFFIXES,
    SEARCHED_SUFFIXES,
    is_bag_folder,
    name_of,
    natural,
)

NUMBER = re.compile(r"\d+")


@dataclass(frozen=True)
class FileGroups:
    """Files by kind and run.

    Attributes:
        folder: Folder that runs are named from.
        kinds: Files by run, by name of the kind with ``{run}`` for the run.
        runs: Names of the runs as seen from the folder, in natural order.
        spread: Whether a run lies in several files, so that every signal needs its ``file``.
    """

    folder: Path
    kinds: dict[str, dict[str, Path]]
    runs: tuple[str, ...]
    spread: bool


def recordings_in(paths: Sequence[Path]) -> list[Path]:
    """Files and bags at paths; of folders those inside.

    Raises:
        InputError: There is none, or one cannot be read.
    """
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError("no such file or folder", file=path)
        if path.is_file() and path.suffix not in FILE_SUFFIXES:
            raise InputError(f"no recording; expected a bag or one of {', '.join(FILE_SUFFIXES)}", file=path)
        if path.is_file() or is_bag_folder(path):
            found.append(path)
            continue
        bags = {file.parent for file in path.rglob("metadata.yaml")}
        inside = [
            file
            for file in path.rglob("*")
            if file.suffix in FILE_SUFFIXES and file.is_file() and not bags & {file.parent}
        ]
        searched = [file for file in inside if file.suffix in SEARCHED_SUFFIXES]
        found += [*bags, *(searched or [file for file in inside if file.suffix in NOTE_SUFFIXES])]
    if not found:
        raise InputError(f"no recording here; expected a bag or one of {', '.join(FILE_SUFFIXES)}", file=paths[0])
    return sorted(dict.fromkeys(found), key=lambda path: natural(str(path)))


def group_files(files: Sequence[Path]) -> FileGroups:
    """Files by kind and run.

    Args:
        files: Files and folders of bags, at least one.
    """
    folders = sorted({file.parent for file in files})
    shapes: dict[str, list[Path]] = {}
    for file in files:
        shapes.setdefault(NUMBER.sub("0", file.name), []).append(file)
    if len(folders) > 1 and all(_same_names(files, folder, folders[0]) for folder in folders):
        above = folders[0].parent
        kinds = {name: {f.parent.name: f for f in files if f.name == name} for name in sorted({f.name for f in files})}
        return FileGroups(above, kinds, tuple(sorted((f.name for f in folders), key=natural)), True)
    if len(shapes) == 1 or len(files) == 1:
        folder = folders[0] if len(folders) == 1 else Path(*_common(folders))
        by_run = {str(file.relative_to(folder)): file for file in files}
        return FileGroups(folder, {"": by_run}, tuple(by_run), False)
    kinds = {}
    for alike in shapes.values():
        for file in alike:
            place = _place_of_run(file.name, alike, files)
            numbers = list(NUMBER.finditer(file.name))
            if place is None:
                kinds.setdefault(file.name, {})[file.parent.name] = file
                continue
            start, end = numbers[place].span()
            kinds.setdefault(f"{file.name[:start]}{{run}}{file.name[end:]}", {})[numbers[place][0]] = file
    runs = sorted({run for by_run in kinds.values() for run in by_run}, key=natural)
    return FileGroups(folders[0], kinds, tuple(runs), True)


def _same_names(files: Sequence[Path], folder: Path, other: Path) -> bool:
    names = [{file.name for file in files if file.parent == one} for one in (folder, other)]
    return names[0] == names[1] and len(names[0]) > 1


def _place_of_run(name: str, alike: Sequence[Path], every: Sequence[Path]) -> int | None:
    """Which number of a name is that of the run: the last that differs; of a single file that which others share."""
    columns = list(zip(*(NUMBER.findall(file.name) for file in alike), strict=True))
    differing = [place for place, column in enumerate(columns) if len(set(column)) > 1]
    if differing:
        return differing[-1]
    others: dict[str, set[str]] = {}
    for file in every:
        others.setdefault(NUMBER.sub("0", file.name), set()).update(NUMBER.findall(file.name))
    own = enumerate(NUMBER.findall(name))
    shared = [place for place, number in own if all(number in numbers for numbers in others.values())]
    return shared[-1] if shared and len(others) > 1 else None


def _common(folders: Sequence[Path]) -> tuple[str, ...]:
    parts = []
    for column in zip(*(folder.parts for folder in folders), strict=False):
        if len(set(column)) > 1:
            break
        parts.append(column[0])
    return tuple(parts)


def run_name(run: str) -> str:
    """Name of a run in the table of runs."""
    return name_of(Path(run))
