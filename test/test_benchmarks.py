# SPDX-License-Identifier: Apache-2.0
"""Benchmarks and the docs: tables are those of the results, commands run, imported names exist; nothing is measured."""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from benchmarks import harness, results
from benchmarks.results import Results, Table

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SCRIPTS = sorted(path for folder in ("benchmarks", "tools") for path in (ROOT / folder).rglob("*.py"))


def test_tables_of_the_docs_are_made_from_the_results() -> None:
    """Kills a figure that is changed in a page alone, and a result that no page shows."""
    stale, shown = [], set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        shown |= {name for names in re.findall(r"\(results: ([\w ]+)\)", text) for name in names.split()}
        stale += [page.name] if results.with_tables(text) != text else []
    assert stale == [], "run: ./run python -m benchmarks --docs"
    assert shown == {path.stem for path in results.FOLDER.glob("*.json")}


def test_commands_of_results_and_pages_are_those_of_a_benchmark() -> None:
    """Kills a benchmark or an option that is renamed in the code alone."""
    written = [Results.read(path.stem).command for path in results.FOLDER.glob("*.json")]
    written += [
        line for page in PAGES for line in re.findall(r"\./run python -m benchmarks [^`|\n]+", page.read_text())
    ]
    asked = [shlex.split(line.split("benchmarks ")[1]) for line in written if "benchmarks " in line]
    assert len(asked) > 25
    for name, *words in asked:
        if name != "--docs":
            harness.parser_of(name).parse_args(words)


def test_the_list_of_wrong_lines_is_as_long_as_the_page_says() -> None:
    page = (ROOT / "docs" / "reliability.md").read_text()
    ((kernel, python),) = re.findall(r"(\d+) wrong lines of the kernel and (\d+) of Python", page)
    groups = tomllib.loads((ROOT / "benchmarks" / "mutation" / "mutation.toml").read_text())["lines"]
    counts = {
        kind: sum(len(one["mutants"]) for one in groups if one["file"].endswith(kind)) for kind in (".cpp", ".py")
    }
    assert (int(kernel), int(python)) == (counts[".cpp"], counts[".py"])


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_benchmark_or_tool_imports_names_that_exist(script: Path) -> None:
    """Kills a module or name of the packages that is renamed and not followed there."""
    missing = []
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("impact_"):
            module = importlib.import_module(str(node.module))
            names = [alias.name for alias in node.names if not hasattr(module, alias.name)]
            missing += [name for name in names if importlib.util.find_spec(f"{node.module}.{name}") is None]
    assert missing == []


class Squares:
    """A benchmark."""

    __doc__ = "Squares."

    def __init__(self) -> None:
        self.ran: list[str] = []

    def cases(self, options: argparse.Namespace) -> list[harness.Case]:
        del options
        return [harness.Case(f"square {number}", number) for number in range(3)]

    def run(self, case: harness.Case, work: harness.Work) -> harness.Row:
        assert work.folder.is_dir()
        self.ran.append(case.name)
        if case.inputs == 2 and len(self.ran) == 3:
            raise KeyboardInterrupt
        return {"square": case.inputs**2}

    def table(self, rows: list[harness.Row], options: argparse.Namespace) -> Table:
        del options
        return Table(("number", "square"), tuple((row["name"], str(row["square"])) for row in rows))


def test_an_interrupted_benchmark_goes_on_and_keeps_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills a loop that measures a kept case again, or keeps a case that was interrupted."""
    squares = Squares()
    monkeypatch.setattr(harness, "names", lambda: {"squares": "squares"})
    monkeypatch.setattr(harness.importlib, "import_module", lambda _: squares)
    with pytest.raises(KeyboardInterrupt):
        harness.run("squares", ["-o", str(tmp_path)])
    table = harness.run("squares", ["-o", str(tmp_path)])
    assert squares.ran == ["square 0", "square 1", "square 2", "square 2"]
    assert [square for _, square in table.rows] == ["0", "1", "4"]
    assert harness.run("squares", ["-o", str(tmp_path), "--only", "square 1"]).rows == (("square 1", "1"),)
    assert harness.run("squares", ["--seconds", "0"]).rows == ()


def test_results_come_back_as_they_were_saved_and_are_joined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills a cell in the wrong row of a joined table."""
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    ours = Results("./run x", "2026-11-27", "abc", 1.25, ("", "ours"), (("right", "3 of 4"), ("time", "2 s")))
    ours.save("ours")
    assert Results.read("ours") == ours
    Results("./run y", "2026-11-26", None, None, ("", "theirs"), (("time", "9 s"), ("wrong", "0"))).save("theirs")
    page = "before\n\n[//]: # (results: ours theirs)\n\nold\n\n[//]: # (end of results)\n\nafter\n"
    made = results.with_tables(page)
    assert "|  | ours | theirs |" in made and "| right | 3 of 4 | – |" in made
    assert "| time | 2 s | 9 s |" in made and "| wrong | – | 0 |" in made
    assert "\n`./run x`; `./run y`\n" in made
    chosen = results.with_tables(page.replace("(results: ours theirs)", "(results: ours) (columns: 1 2) (rows: 2)"))
    assert "| time | 2 s |" in chosen and "right" not in chosen
    assert Table(("", "a"), (("one", "not counted"), ("two", "2"))).some().rows == (("two", "2"),)
    assert "old" not in made and results.with_tables(made) == made
    assert Table(("a",), (("1",),)).with_(Table(("a",), (("2",),))).rows == (("1",), ("2",))


def test_shares_and_quantiles_are_what_they_say() -> None:
    """Kills None counted as false, and a share of the wrong total."""
    assert harness.share([True, False, None, 1]) == "2 of 3" and harness.share([None]) == "–"
    assert harness.percent([True, None, False, False, False]) == 25.0
    assert harness.quantiles(range(101)) == "50 (10 to 90)"
