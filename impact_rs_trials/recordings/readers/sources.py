# SPDX-License-Identifier: Apache-2.0
"""Signals of one run from all kinds of files."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Protocol

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_trials.recordings.mapping import Mapping, SignalName, SignalSource
from impact_rs_trials.recordings.readers.array_file import ArrayFile
from impact_rs_trials.recordings.readers.bag_file import BagFile
from impact_rs_trials.recordings.readers.run_finder import (
    ARRAY_SUFFIXES,
    BAG_SUFFIXES,
    FILE_SUFFIXES,
    SEARCHED_SUFFIXES,
    TABLE_SUFFIXES,
    is_bag_folder,
    name_of,
    visible,
)
from impact_rs_trials.recordings.readers.series import MissingSignal, Names, Series
from impact_rs_trials.recordings.readers.table_file import TableFile
from impact_rs_trials.recordings.readers.text_file import suffix_of
from impact_rs_trials.recordings.readers.turns import unwrapped


class SignalFile(Protocol):
    """A file that has signals."""

    def series(self, name: SignalName, source: SignalSource) -> Series:
        """One signal in SI units.

        Raises:
            MissingSignal: The file lacks it.
            InputError: It cannot be used.
        """


def read_series(
    path: Path,
    mapping: Mapping,
    wanted: Iterable[SignalName],
    needed: Collection[SignalName],
    names: Names | None = None,
) -> dict[SignalName, Series]:
    """Signals of one run at the timestamps of its files; velocity not in the mapping: derivative of position.

    Joint angles are continuous (:mod:`~impact_rs_trials.recordings.readers.turns`).

    Args:
        path: A file, or a run inside of it; the folder of a bag; or, if the mapping names files, their folder, or
            the name of a run next to them.
        mapping: Where the signals are.
        wanted: Signals to read, as far as the mapping has them.
        needed: Required signals.
        names: Values of the placeholders of the mapping; None: the run's name alone.

    Raises:
        InputError: A needed signal is missing, or something cannot be used.
    """
    names, wanted = names or Names(run=name_of(path)), tuple(wanted)
    sources = {name: mapping.signals[name] for name in wanted if name in mapping.signals}
    _check_is_read(path, mapping, names)
    files: dict[Path, list[SignalName]] = {}
    for name, source in sources.items():
        files.setdefault(_file_of(path, source, names), []).append(name)
    read: dict[SignalName, Series] = {}
    for file, signals in files.items():
        if not file.exists() and not set(needed) & set(signals):
            continue
        opened = open_file(file, mapping, names, tuple(signals))
        for name in signals:
            try:
                series = opened.series(name, sources[name])
            except MissingSignal as missing:
                if name in needed:
                    raise _needed(missing, name) from None
                continue
            if series.time.size == 0 and name in needed:
                raise InputError(f"{series.label} has no sample", file=file)
            if series.time.size:
                read[name] = series.without_repeats() if mapping.time.repeated == "keep_first" else series
    read |= _continuous_angles(read, mapping)
    if "velocity" in wanted and "velocity" not in sources and "position" in read:
        read["velocity"] = read["position"].derivative()
    return read


def _continuous_angles(read: dict[SignalName, Series], mapping: Mapping) -> dict[SignalName, Series]:
    """Positions of joints, and desired positions in the same turn."""
    if "position" not in read:
        return {}
    try:
        facts = mapping.facts
    except InputError:  # a preview shows signals of a mapping that an analysis refuses
        return {}
    position = unwrapped(read["position"], facts)
    if "q_desired" not in read:
        return {"position": position}
    return {"position": position, "q_desired": unwrapped(read["q_desired"], facts, position)}


def _check_is_read(path: Path, mapping: Mapping, names: Names) -> None:
    """Refuse a file that the mapping does not name: the named files next to it would be read in its place."""
    file_names = (
        {_file_of(path, source, names).name for source in mapping.signals.values()} if path.is_file() else set()
    )
    if file_names and path.name not in file_names:
        raise InputError(
            f"the mapping takes its signals from {', '.join(sorted(file_names))} in this folder and none from this "
            "file; name the folder, or take `file` out of the mapping where every file is a run",
            file=path,
        )


def _needed(missing: MissingSignal, name: SignalName) -> InputError:
    if name in ("position", "velocity", "torque"):
        return missing
    return MissingSignal(
        f"{missing.message}; where it was not recorded, take signals.{name} out of the mapping", file=missing.file
    )


def _file_of(path: Path, source: SignalSource, names: Names) -> Path:
    """The file or bag folder that a signal lies in."""
    if source.file is not None:
        folder = path if path.is_dir() and not is_bag_folder(path) else path.parent
        return folder / names.fill(source.file)
    if path.parent.is_file():  # a run inside of a file
        return path.parent
    if not path.is_dir() or is_bag_folder(path):
        return path
    files = sorted(file for file in visible(path, path.iterdir()) if suffix_of(file) in SEARCHED_SUFFIXES)
    if len(files) == 1:  # a bag that has lost its metadata.yaml, or a table in a folder of its own
        return files[0]
    if not files:
        raise InputError(
            f"no recording in this folder; expected metadata.yaml of a bag, or one of {', '.join(SEARCHED_SUFFIXES)}",
            file=path,
        )
    raise InputError(
        f"a folder of {len(files)} files ({', '.join(file.name for file in files[:3])}, ...) where one run is "
        "expected; name one of them, or say with `file` in the mapping which signal lies in which",
        file=path,
    )


def open_file(file: Path, mapping: Mapping, names: Names, wanted: tuple[SignalName, ...]) -> SignalFile:
    """A file of signals, read once.

    Args:
        file: A file, or the folder of a bag.
        mapping: Where the signals are.
        names: Values of the placeholders of the mapping.
        wanted: Signals that it should have.

    Raises:
        InputError: It cannot be read.
    """
    if not file.exists():
        folder = file.parent
        suggestion = did_you_mean(file.name, [other.name for other in folder.iterdir()]) if folder.is_dir() else ""
        raise InputError(f"no such file{suggestion} (it should have {', '.join(wanted)})", file=file)
    if file.is_file() and file.stat().st_size == 0:
        raise InputError("this file is empty", file=file)
    if file.is_dir() or suffix_of(file) in BAG_SUFFIXES:
        return BagFile(file, mapping, names, wanted)
    if suffix_of(file) in TABLE_SUFFIXES:
        return TableFile(file, mapping, names)
    if suffix_of(file) in ARRAY_SUFFIXES:
        return ArrayFile(file, mapping, names)
    raise InputError(f"no recording; expected a bag, {', '.join(FILE_SUFFIXES)}", file=file)
