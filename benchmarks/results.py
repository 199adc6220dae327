# SPDX-License-Identifier: Apache-2.0
"""Results of benchmarks, and the tables of ``docs/`` that are made from them.

``results/NAME.json`` has a table, the command that made it, revision and date, and the cost of a reference (one trial,
``impact-rs trial push cat_food case_2``) on that machine in that hour. A page has the table between two lines::

    [//]: # (results: NAME [NAME ...]) (columns: NUMBER ...) (rows: NUMBER ...)

    [//]: # (end of results)

``columns`` and ``rows`` pick some, counted from 1; without them a page has all. Rows without an entry are left out.
Tables with the same columns stand below each other; others beside each other, joined by their first column.
``./run python -m benchmarks --docs`` writes all pages.
"""

from __future__ import annotations

import datetime
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

from impact_rs_sim.files import write_whole
from impact_rs_sim.version import git_revision

FOLDER = Path(__file__).parent / "results"
DOCS = Path(__file__).resolve().parents[1] / "docs"
BETWEEN = re.compile(
    r"(\[//\]: # \(results: ([\w ]+)\)(?: \(columns: ([\d ]+)\))?(?: \(rows: ([\d ]+)\))?\n)"
    r".*?(\[//\]: # \(end of results\)\n)",
    re.DOTALL,
)
NO_ENTRIES = {"", "–", "not counted"}


@dataclass(frozen=True)
class Table:
    """Cells, as they are printed."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def markdown(self) -> str:
        """As it stands in a page."""
        head, *rows = (f"| {' | '.join(line)} |" for line in (self.columns, *self.rows))
        return "\n".join((head, "|---" * len(self.columns) + "|", *rows))

    def some(self, columns: Sequence[int] = (), rows: Sequence[int] = ()) -> Table:
        """Some of its columns and rows, counted from 1, all if none is given; without rows that have no entry."""
        chosen = [self.rows[number - 1] for number in rows] if rows else self.rows
        head, *body = (
            tuple(row[number - 1] for number in columns) if columns else row for row in (self.columns, *chosen)
        )
        return Table(head, tuple(row for row in body if not NO_ENTRIES.issuperset(row[1:])))

    def with_(self, other: Table) -> Table:
        """Both tables in one."""
        if self.columns == other.columns:
            return Table(self.columns, (*self.rows, *other.rows))
        own_cells, other_cells = ({row[0]: row[1:] for row in table.rows} for table in (self, other))
        sides = [(cells, len(table.columns) - 1) for cells, table in ((own_cells, self), (other_cells, other))]
        rows = [
            (name, *(cell for cells, width in sides for cell in cells.get(name, ("–",) * width)))
            for name in dict.fromkeys((*own_cells, *other_cells))
        ]
        return Table((*self.columns, *other.columns[1:]), tuple(rows))


@dataclass(frozen=True)
class Results:
    """A table and where it comes from.

    Attributes:
        command: What made it.
        date: Day, ISO 8601.
        revision: Of the repository; None: not recorded then.
        reference_s: Processor time of one trial on that machine [s]; None: not measured then.
        columns: Headings.
        rows: Cells.
    """

    command: str
    date: str
    revision: str | None
    reference_s: float | None
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @classmethod
    def measured(cls, command: str, table: Table) -> Self:
        """Results of this machine, now."""
        from cost import seconds_of_a_trial  # test/shared

        today = datetime.date.today().isoformat()
        return cls(command, today, git_revision()[:8], round(seconds_of_a_trial(), 2), table.columns, table.rows)

    @classmethod
    def read(cls, name: str) -> Self:
        """A file of results."""
        content = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
        return cls(**{**content, "columns": tuple(content["columns"]), "rows": tuple(map(tuple, content["rows"]))})

    def save(self, name: str) -> None:
        """Write a file of results, a row a line."""
        head = {key: value for key, value in asdict(self).items() if key != "rows"}
        lines = [f'  "{key}": {json.dumps(value, ensure_ascii=False)},' for key, value in head.items()]
        rows = ",\n".join(f"    {json.dumps(row, ensure_ascii=False)}" for row in self.rows)
        write_whole(FOLDER / f"{name}.json", "\n".join(["{", *lines, '  "rows": [', rows, "  ]", "}\n"]))

    @property
    def table(self) -> Table:
        """The table alone."""
        return Table(self.columns, self.rows)


def section(names: str, columns: str | None, rows: str | None) -> str:
    """What stands between the marks for some results."""
    results = [Results.read(name) for name in names.split()]
    table = results[0].table
    for other in results[1:]:
        table = table.with_(other.table)
    table = table.some(*([int(number) for number in (chosen or "").split()] for chosen in (columns, rows)))
    commands = "; ".join(dict.fromkeys(f"`{result.command}`" for result in results if result.command))
    return f"\n{table.markdown}\n\n{commands}\n\n"


def with_tables(text: str) -> str:
    """A page with its tables made anew."""
    return BETWEEN.sub(lambda match: f"{match[1]}{section(match[2], match[3], match[4])}{match[5]}", text)


def write_pages() -> list[str]:
    """Make all tables of the docs anew. Returns the names of pages that changed."""
    changed = []
    for path in sorted(DOCS.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if (new := with_tables(text)) != text:
            write_whole(path, new)
            changed.append(path.name)
    return changed
