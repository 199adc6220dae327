# SPDX-License-Identifier: Apache-2.0
"""The rows of a campaign as a folder of Parquet files that grows with it: no bag is read twice.

``part-*.parquet`` hold the rows of :func:`~impact_rs_analysis.measure.export.trial_row` with two more columns: ``bag``
is the path of the bag below the campaign, and ``stamp`` changes when the bag is rewritten. Bags without a row, or with
another stamp, are read. Parts are written atomically, and rewritten in two cases only. The old row of a rewritten bag
is removed before the bag is read, so that no bag has two rows. A new arm adds its columns to every part, because many
readers take the columns of the first file for all.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from impact_rs_analysis.measure.analyze import SkippedBag
from impact_rs_analysis.measure.export import table_of, trial_row
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole
from impact_rs_sim.optional_packages import require
from impact_rs_sim.version import package_version
from impact_rs_trials.bags.reader import reason_of
from impact_rs_trials.store import Folder, Store, open_store, owned
from impact_rs_trials.workers import Map

ROWS_PER_PART = 2000  # kept in memory, and lost if an export is killed
PART_NAME = re.compile(r"part-\d+\.parquet")
CAMPAIGN_KEY = b"impact_rs_campaign"  # in the metadata of every part: location of its bags


@dataclass(frozen=True)
class Extended:
    """Result of an export into a data set.

    Attributes:
        trials: Number of trials in the data set.
        read: Number of trials that this export has read.
        skipped: Bags that could not be read; the next export tries them again.
    """

    trials: int
    read: int
    skipped: tuple[SkippedBag, ...]


def extend(
    campaign: str | Path | Store,
    folder: Path,
    map_tasks: Map,
    progress: Callable[[int, int], None],
    max_rows: int = ROWS_PER_PART,
) -> Extended:
    """Bring a data set up to date with a campaign. Rows of deleted bags stay.

    Args:
        campaign: Folder with bags of trials at any depth, or its URL; it may grow meanwhile.
        folder: Folder of the data set; made if missing.
        map_tasks: Parallel map.
        progress: Called with the number of new bags read and the number of all new bags.
        max_rows: Largest number of rows of a part.

    Raises:
        InputError: The folder is no data set of this campaign, or another process uses it; a part cannot be read or
            written; there is no bag or no readable trial; a package is not installed.
    """
    require("pyarrow", folder)
    store = open_store(campaign)
    _check(folder)
    stamps = store.stamps()
    added, skipped = 0, []
    with owned(Folder(folder), "data set"):
        parts = _Parts(folder, str(store))
        recorded_stamps = parts.stamps()
        changed = sorted(name for name, stamp in stamps.items() if recorded_stamps.get(name) != stamp)
        parts.drop(recorded_stamps.keys() & changed)
        for start in range(0, len(changed), max_rows):
            names = changed[start : start + max_rows]
            new_rows: list[dict[str, Any]] = []
            try:
                rows_by_name = zip(names, map_tasks(functools.partial(_row, store), names), strict=True)
                for number, (name, row) in enumerate(rows_by_name, start=start + 1):
                    if isinstance(row, SkippedBag):
                        skipped.append(row)
                    else:
                        new_rows.append({**row, "bag": name, "stamp": stamps[name]})
                    progress(number, len(changed))
            finally:  # keep rows that were read before an interrupt
                parts.add(new_rows)
            added += len(new_rows)
        trials = len(recorded_stamps.keys() - changed) + added
        if not trials:
            reason = f"; {skipped[0].name}: {skipped[0].reason}" if skipped else ""
            raise InputError(f"no readable trials here{reason}", file=str(store))
    return Extended(trials, added, tuple(skipped))


def _row(store: Store, name: str) -> dict[str, Any] | SkippedBag:
    try:
        with store.getting(name) as directory:
            return trial_row(directory / name)
    except Exception as error:  # a damaged bag must not stop the others
        return SkippedBag(name, reason_of(error))


def _paths(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("part-*") if PART_NAME.fullmatch(path.name))


def _check(folder: Path) -> None:
    """Check for a data set, an empty folder, or no folder; hidden files are ignored."""
    if folder.exists() and not folder.is_dir():
        raise InputError("this is a file; expected the name of a folder", file=folder)
    foreign = {path.name for path in folder.glob("[!.]*") if not PART_NAME.fullmatch(path.name)}
    if foreign:
        raise InputError(f"is not a data set: it holds {min(foreign)}; choose an empty or a new folder", file=folder)


class _Parts:
    """The parts of a data set, all with the same columns.

    Args:
        folder: Their folder, locked by this process.
        campaign: Location of their bags, for the metadata of every part.

    Raises:
        InputError: A part cannot be read, or belongs to another data set.
    """

    def __init__(self, folder: Path, campaign: str) -> None:
        self._folder = folder
        self._metadata = {CAMPAIGN_KEY: campaign.encode(), b"made_by": f"impact-rs {package_version()}".encode()}
        for path in folder.glob(".part-*.partial"):  # left by a killed export
            path.unlink(missing_ok=True)
        schemas = [self._of_campaign(path) for path in _paths(folder)]
        self._schema = self._united(schemas)
        self._conform()

    def stamps(self) -> dict[str, int]:
        """Stamp of every bag that has a row, by name of the bag."""
        stamps: dict[str, int] = {}
        for path in _paths(self._folder):
            with _opened(path) as part:
                columns = part.read(["bag", "stamp"]).to_pydict()
            stamps.update(zip(columns["bag"], columns["stamp"], strict=True))
        return stamps

    def drop(self, names: Collection[str]) -> None:
        """Remove the rows of bags, and parts that become empty."""
        import pyarrow.compute

        for path in _paths(self._folder) if names else ():
            with _opened(path) as part:
                table = part.read()
            dropped = pyarrow.compute.is_in(table["bag"], pyarrow.array(list(names)))
            remaining = table.filter(pyarrow.compute.invert(dropped))
            if not remaining.num_rows:
                path.unlink()
            elif remaining.num_rows < table.num_rows:
                self._write(path, remaining)

    def add(self, rows: list[dict[str, Any]]) -> None:
        """Add a part, unless there are no rows."""
        if not rows:
            return
        table = table_of(rows)
        united = self._united([self._schema, table.schema])
        if not united.equals(self._schema):
            self._schema = united
            self._conform()
        last = max((int(path.stem.removeprefix("part-")) for path in _paths(self._folder)), default=-1)
        self._write(self._folder / f"part-{last + 1:05d}.parquet", table)

    def _of_campaign(self, path: Path) -> Any:
        """Schema of a part, checked to belong to this data set."""
        with _opened(path) as part:
            schema = part.schema_arrow
        recorded_campaign, campaign = (schema.metadata or {}).get(CAMPAIGN_KEY), self._metadata[CAMPAIGN_KEY]
        if recorded_campaign is None:
            raise InputError("is not part of a data set of impact-rs; choose another folder", file=path)
        if recorded_campaign != campaign:
            raise InputError(
                f"holds the trials of {recorded_campaign.decode()}; choose another folder for {campaign.decode()}",
                file=self._folder,
            )
        return schema

    def _united(self, schemas: list[Any]) -> Any:
        """Union of the columns of several schemas."""
        import pyarrow

        try:
            return pyarrow.unify_schemas([pyarrow.schema([]), *schemas]).with_metadata(self._metadata)
        except pyarrow.ArrowException as error:
            raise InputError(
                f"holds rows of another version ({error}); choose another folder", file=self._folder
            ) from None

    def _conform(self) -> None:
        """Give every part all columns."""
        for path in _paths(self._folder):
            with _opened(path) as part:
                if part.schema_arrow.names != self._schema.names:
                    self._write(path, part.read())

    def _write(self, path: Path, table: Any) -> None:
        import pyarrow
        import pyarrow.parquet

        columns = [
            table[field.name] if field.name in table.column_names else pyarrow.nulls(table.num_rows, field.type)
            for field in self._schema
        ]
        with whole(path) as aside:
            pyarrow.parquet.write_table(pyarrow.table(columns, schema=self._schema), aside, compression="zstd")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A part, opened for reading.

    Raises:
        InputError: The file is damaged, or no Parquet file.
    """
    import pyarrow
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(path) as part:
            yield part
    except (OSError, pyarrow.ArrowException) as error:
        words = " ".join(str(error).split())
        raise InputError(f"cannot be read ({words}); remove it, and its bags are read again", file=path) from None
