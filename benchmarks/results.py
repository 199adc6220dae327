# SPDX-License-Identifier: Apache-2.0
"""Results of benchmarks, and the tables of ``docs/`` that are made from them.

``results/NAME.json`` has a table, the command that made it, revision and date, and the cost of a reference (one trial,
``impact-rs trial push cat_food case_2``) on that machine in that hour. A page has the table between two lines::

    [//]: # (results: NAME [NAME ...]) (columns: NUMBER ...)

    [//]: # (end of results)

``columns`` picks some, counted from 1; without it a page has all. Tables with the same columns stand below each other;
others beside each other, joined by their first column.
``./run python -m benchmarks --docs`` writes all pages.
"""

from __future__ import annotations

import datetime
import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

from impact_rs_sim.files import write_whole
from impact_rs_sim.version import git_revision

FOLDER = Path(__file__).parent / "results"
DOCS = Path(__file__).resolve().parents[1] / "docs"
BETWEEN = re.compile(
    r"(\[//\]: # \(results: ([\w ]+)\)(?: \(columns: ([\d ]+)\))?\n).*?(\[//\]: # \(end of results\)\n)", re.DOTALL
)


@dataclass(frozen=True)
class Table:
    """Cells, as they are printed."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def markdown(self) -> str:
        """As it stands in a page."""
        lines = (self.columns, ("---",) * len(self.columns), *self.rows)
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    def some(self, numbers: list[int]) -> Table:
        """Some of its columns, counted from 1."""
        rows = [tuple(row[number - 1] for number in numbers) for row in (self.columns, *self.rows)]
        return Table(rows[0], tuple(rows[1:]))

    def with_(self, other: Table) -> Table:
        """Both tables in one."""
        if self.columns == other.columns:
            return Table(self.columns, (*self.rows, *other.rows))
        own, theirs = ({row[0]: row[1:] for row in table.rows} for table in (self, other))
        sides = [(cells, len(table.columns) - 1) for cells, table in ((own, self), (theirs, other))]
        rows = [
            (name, *(cell for cells, width in sides for cell in cells.get(name, ("–",) * width)))
            for name in dict.fromkeys((*own, *theirs))
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

    @property
    def source(self) -> str:
        """One line for below the table."""
        day = datetime.date.fromisoformat(self.date)
        facts = [f"`{self.command}`" if self.command else "", f"{day.day} {day:%B %Y}"]
        facts += [f"revision {self.revision}"] if self.revision else []
        facts += [f"one trial cost {self.reference_s:g} s of processor time"] if self.reference_s else []
        return ", ".join(filter(None, facts))


def section(names: str, columns: str | None) -> str:
    """What stands between the marks for some results."""
    results = [Results.read(name) for name in names.split()]
    table = results[0].table
    for other in results[1:]:
        table = table.with_(other.table)
    sources = dict.fromkeys(one.source for one in results)
    rest = ""
    if columns:
        table = table.some([int(number) for number in columns.split()])
        files = ", ".join(f"[{name}.json](../benchmarks/results/{name}.json)" for name in names.split())
        rest = f" All columns: {files}."
    return f"\n{table.markdown}\n\nMeasured: {'; '.join(sources)}.{rest}\n\n"


def made(text: str) -> str:
    """A page with its tables made anew."""
    return BETWEEN.sub(lambda found: f"{found[1]}{section(found[2], found[3])}{found[4]}", text)


def write_pages() -> list[str]:
    """Make all tables of the docs anew. Returns the names of pages that changed."""
    changed = []
    for path in sorted(DOCS.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if (new := made(text)) != text:
            write_whole(path, new)
            changed.append(path.name)
    return changed
