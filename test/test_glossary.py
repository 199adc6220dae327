# SPDX-License-Identifier: Apache-2.0
"""The words of the project: names in the glossary exist, and words that need a translation only become fewer."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("impact_rs_sim", "impact_rs_control", "impact_rs_trials", "impact_rs_analysis", "impact_rs_ros")
GLOSSARY = ROOT / "docs" / "glossary.md"
HEAD = ["Term", "Name in code", "Symbol", "Unit", "Meaning", "Literature"]

RIDDLES = re.compile(r"(?<![a-z])(?:told|tells?|things?|somebody|nobody|whoever)(?![a-z])", re.IGNORECASE)
TEXT = {".cpp", ".css", ".hpp", ".html", ".js", ".md", ".msg", ".action", ".py", ".pyi", ".srv", ".yaml"}
# As counted on 23 November 2026. Lower a number when its count falls; all of them go to 0.
MOST = {
    "README.md": 0,
    "docs": 2,
    "examples": 0,
    "impact_rs_analysis": 58,
    "impact_rs_cli": 0,
    "impact_rs_commands": 0,
    "impact_rs_control": 0,
    "impact_rs_ros": 7,
    "impact_rs_sim": 6,
    "impact_rs_trials": 28,
    "impact_rs_workbench": 0,
}


def rows() -> Iterator[list[str]]:
    """The cells of every row of the glossary's tables."""
    for line in GLOSSARY.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| ") and cells != HEAD:
            yield cells


def defined(tree: ast.AST) -> Iterator[str]:
    """Classes, functions and assigned names."""
    for item in ast.walk(tree):
        if isinstance(item, ast.ClassDef | ast.FunctionDef):
            yield item.name
        elif isinstance(item, ast.Name | ast.Attribute) and isinstance(item.ctx, ast.Store):
            yield item.id if isinstance(item, ast.Name) else item.attr


def names_in_code() -> set[str]:
    """Modules, names that they define, and ``Class.member`` with the members of base classes."""
    names: set[str] = set()
    members: dict[str, set[str]] = defaultdict(set)
    bases: dict[str, set[str]] = defaultdict(set)
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py*") if path.suffix != ".pyc"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names |= {module, *defined(tree)}
        for item in ast.walk(tree):
            if isinstance(item, ast.ClassDef):
                members[item.name].update(defined(item))
                bases[item.name].update(ast.unparse(base).rpartition(".")[2] for base in item.bases)
    for owner in list(members):
        for family in (owner, *bases[owner]):
            names |= {f"{owner}.{member}" for member in members[family]}
    return names


def test_every_term_has_a_name_in_code_and_a_meaning() -> None:
    found = list(rows())
    assert len(found) >= 60
    assert [row for row in found if len(row) != len(HEAD) or not (row[0] and "`" in row[1] and row[4])] == []


def test_no_term_has_two_meanings() -> None:
    terms = [term for term, *_ in rows()]
    assert sorted(terms) == sorted(set(terms))


def test_every_name_in_the_glossary_is_in_the_code() -> None:
    known = names_in_code()
    named = {name: term for term, column, *_ in rows() for name in re.findall(r"`([^`]+)`", column)}
    assert {name: term for name, term in named.items() if name not in known} == {}


def test_words_that_need_a_translation_do_not_return() -> None:
    def count(folder: str) -> int:
        place = ROOT / folder
        files = [place] if place.is_file() else [path for path in place.rglob("*") if path.suffix in TEXT]
        return sum(len(RIDDLES.findall(path.read_text(encoding="utf-8"))) for path in files)

    counts = {folder: count(folder) for folder in MOST}
    assert {folder: number for folder, number in counts.items() if number > MOST[folder]} == {}
