# SPDX-License-Identifier: Apache-2.0
"""The numbers on which a verdict turns, halved and doubled: what becomes of small campaigns of the closed-form world.

Each number of ``docs/diagnosis.md`` that decides with repeats is changed alone, in those cells of the board ``small``
that say most: nothing hidden and a simulator that is off, an effect of six standard errors, an outside cause.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from benchmarks.boards import small
from benchmarks.harness import Case, Row, Work, draw_options, map_draws
from benchmarks.results import Table

NUMBERS = (
    "SIGNIFICANCE_LEVEL", "MIN_DEGREES_OF_FREEDOM", "PRIOR_DEGREES_OF_FREEDOM", "INDEPENDENT_DISCREPANCY_SHARE",
    "PRIOR_DEVIATION", "MIN_GAIN_SHARE", "TIE_LOG_RATIO", "MIN_EXPLAINED_SHARE",
)  # fmt: skip
FACTORS = (0.5, 2.0)
AS_IT_IS = "as it is"
CELLS = (
    ("3x2", "nothing", small.DISCREPANCY),
    ("3x2", f"{small.HIDDEN} 6", 0.0),
    ("3x2", f"{small.OUTSIDE} 2", small.DISCREPANCY),
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many draws."""
    draw_options(parser, 60)
    parser.set_defaults(correlated=False)


def cases(options: argparse.Namespace) -> list[Case]:
    """As they are, then every number halved and doubled."""
    del options
    changed = [(name, factor) for name in NUMBERS for factor in FACTORS]
    return [Case(AS_IT_IS, ("", 1.0)), *(Case(f"{name} × {factor:g}", (name, factor)) for name, factor in changed)]


@contextmanager
def multiplied(name: str, factor: float) -> Iterator[None]:
    """Every module of the analysis sees the number times a factor; a number of repeats is rounded."""
    modules = [m for n, m in sys.modules.items() if n.startswith("impact_rs_analysis.") and name and name in vars(m)]
    original = [getattr(module, name) for module in modules]
    try:
        for module, value in zip(modules, original, strict=True):
            setattr(module, name, max(1, round(factor * value)) if isinstance(value, int) else factor * value)
        yield
    finally:
        for module, value in zip(modules, original, strict=True):
            setattr(module, name, value)


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> list[Row]:
    """The diagnoses of one draw of every cell."""
    with multiplied(*case.inputs):
        return [small.draw_case(Case(case.name, cell), options, seed) for cell in CELLS]


def run(case: Case, work: Work) -> Row:
    """All draws."""
    return {"draws": map_draws(draw_case, case, work.options, work.map_tasks)}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Shares of every cell, a row for each change."""
    del options
    lines = []
    for row in rows:
        cells = []
        for index, (_, hidden, _) in enumerate(CELLS):
            draws = [draw[index] for draw in row["draws"]]
            outcomes = np.array([small.outcome(hidden, draw) for draw in draws])
            cells += [small.with_error(list(outcomes[:, 0])), small.with_error(list(outcomes[:, 2]))]
        lines.append((row["name"], *cells))
    head = [
        f"{design}, {'discrepancy' if discrepancy else 'exact'}, {hidden}: {measure} [%]"
        for design, hidden, discrepancy in CELLS
        for measure in ("right", "wrong name")
    ]
    return Table(("number", *head), tuple(lines))
