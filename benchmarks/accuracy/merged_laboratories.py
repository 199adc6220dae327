# SPDX-License-Identifier: Apache-2.0
"""Simulated laboratories, merged by the shipped code: coverage, width, and the odd laboratory.

Every laboratory reports four parameters with their standard errors, drawn between half and one and a half of the usual
one. The truth is planted: all alike; each off by a small deviation of its own; one laboratory off in one parameter;
and, with six laboratories and two robots, a parameter that differs by robot. Estimates are normal. Packages go through
``merge_packages``, with all its checks.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from evidence_packages import package_of

from benchmarks.harness import Case, Row, Work, draw_options, map_draws, percent
from benchmarks.results import Table
from impact_rs_analysis.sharing.evidence_package import EvidencePackage
from impact_rs_analysis.sharing.merged_evidence import MergedEvidence, merge_packages

PARAMETERS = ("law_1", "law_2", "law_3", "law_4")
TRUTH = 1.0
USUAL = 0.1  # standard error


def package(laboratory: str, robot: str, values: list[float], errors: list[float]) -> EvidencePackage:
    """Package of one laboratory."""
    return package_of(laboratory, dict(zip(PARAMETERS, zip(values, errors, strict=True), strict=True)), robot)


def merged(
    rng: np.random.Generator, robots: list[str], tau: float, shift: float, wrong: int, by_robot: float
) -> MergedEvidence:
    """One merge; the last laboratory is off in some parameters, and the second robot in the second parameter.

    Args:
        rng: Draws everything.
        robots: Robot of every laboratory.
        tau: Deviation between laboratories, over the usual standard error.
        shift: Of the odd laboratory, over its standard error.
        wrong: In how many parameters.
        by_robot: Between robots, over the usual standard error.
    """
    packages = []
    for number, robot in enumerate(robots):
        errors = USUAL * rng.uniform(0.5, 1.5, len(PARAMETERS))
        values = TRUTH + tau * USUAL * rng.standard_normal(errors.size) + errors * rng.standard_normal(errors.size)
        if number == len(robots) - 1:
            values[:wrong] += shift * errors[:wrong]
        if robot != robots[0]:
            values[1] += by_robot * USUAL
        packages.append(package(f"laboratory {number + 1}", robot, values.tolist(), errors.tolist()))
    return merge_packages(packages)


SAME, TWO = ["arm"] * 5, ["first", "second"] * 3
# robots; deviation between laboratories; of the odd one; in how many parameters; between robots
PLANTED = {
    "all alike": (SAME, 0.0, 0.0, 0, 0.0),
    "laboratories deviate by 0.5": (SAME, 0.5, 0.0, 0, 0.0),
    "laboratories deviate by 1": (SAME, 1.0, 0.0, 0, 0.0),
    "one is off by 4 in one parameter": (SAME, 0.0, 4.0, 1, 0.0),
    "one is off by 6 in one parameter": (SAME, 0.0, 6.0, 1, 0.0),
    "one is off by 8 in one parameter": (SAME, 0.0, 8.0, 1, 0.0),
    "one is off by 5 in all four": (SAME, 0.0, 5.0, 4, 0.0),
    "robots differ by 6, six laboratories": (TWO, 0.0, 0.0, 0, 6.0),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many merges."""
    draw_options(parser, 500)


def cases(options: argparse.Namespace) -> list[Case]:
    """The planted truths."""
    del options
    return [Case(name, planted) for name, planted in PLANTED.items()]


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> Row:
    """One merge."""
    del options
    robots, _, shift, wrong, by_robot = case.inputs
    evidence = merged(np.random.default_rng([7, seed]), *case.inputs)
    odd, odd_parameters = f"laboratory {len(robots)}", {f"{name}.size" for name in PARAMETERS[:wrong]}
    row: Row = {"covered": [], "narrower": [], "belongs": ""}
    row["named"] = odd in evidence.odd if shift else None
    row["others"] = any(
        name != odd or not shift or not set(where) <= odd_parameters for name, where in evidence.odd.items()
    )
    for parameter in evidence.parameters:
        if by_robot and parameter.effect == "law_2":
            row["belongs"] = " or ".join(parameter.belongs_to)
            continue
        low, high = parameter.pooled.ci95
        row["covered"].append(low <= TRUTH <= high)
        widths = [contribution.ci95[1] - contribution.ci95[0] for contribution in parameter.contributions]
        row["narrower"].append(high - low < float(np.median(widths)))
    return row


def run(case: Case, work: Work) -> Row:
    """Shares of all merges [%]."""
    rows = map_draws(draw_case, case, work.options, work.map_tasks)
    belongs = Counter(row["belongs"] for row in rows if row["belongs"])
    return {
        **{key: percent(value for row in rows for value in row[key]) for key in ("covered", "narrower")},
        **{key: percent(row[key] for row in rows) for key in ("named", "others")},
        "belongs": ", ".join(f"{name} {100.0 * count / len(rows):.1f}" for name, count in belongs.most_common()),
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for what was planted [%]."""
    del options
    columns = (
        "Planted, in standard errors",
        "Shared: truth in the 95 % interval",
        "Narrower than the median laboratory",
    )
    columns += ("Odd laboratory named", "Another is named", "Belongs to")
    lines = [
        (
            row["name"],
            *("–" if np.isnan(row[key]) else f"{row[key]:.1f}" for key in ("covered", "narrower", "named", "others")),
            row["belongs"] or "–",
        )
        for row in rows
    ]
    return Table(columns, tuple(lines))
