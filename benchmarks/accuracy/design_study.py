# SPDX-License-Identifier: Apache-2.0
"""The design study by a second engine: do steps of Bullet rank the designs as the exact map does?

Every design is asked twice without uncertainties, of the engines ``exact`` and ``bullet`` of the impact map; Kendall's
tau of both orders is printed for each measure, over all designs and within a robot (the smallest).
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.stats import kendalltau

from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_analysis.measure.design_study import (
    MEASURES,
    PADS,
    ROBOTS,
    DesignConditions,
    problems_of,
    random_poses,
    values_by,
)
from impact_rs_sim.impact_map import ImpactMapError
from impact_rs_sim.scenarios.scenario_files import load_scenario


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many designs."""
    parser.add_argument("--poses", type=int, default=100, help="poses per robot")
    parser.add_argument("--pads", nargs="+", default=list(PADS), choices=PADS, help="pads")


def cases(options: argparse.Namespace) -> list[Case]:
    """The robots."""
    del options
    return [Case(robot) for robot in ROBOTS]


def run(case: Case, work: Work) -> Row:
    """Measures of all designs of a robot by both engines, ``(designs, 2, measures)``."""
    conditions = DesignConditions(load_scenario("push"), "cat_food", pads=tuple(work.options.pads))
    designs, failed = [], 0
    for stance in random_poses(case.name, conditions, work.options.poses)[0]:
        for _, _, problem in problems_of(conditions, stance):
            try:
                designs.append([list(values_by(engine, problem).values()) for engine in ("exact", "bullet")])
            except ImpactMapError:
                failed += 1
    return {"designs": designs, "failed": failed, "said": f"{len(designs)} designs, {failed} without an answer"}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each measure."""
    del options
    robots = [np.array(row["designs"]) for row in rows]
    together = np.concatenate(robots)

    def tau(designs: np.ndarray, column: int) -> float:
        return float(kendalltau(designs[:, 0, column], designs[:, 1, column]).statistic)

    columns = (
        "Measure",
        f"Kendall's tau, {len(together)} designs of {len(robots)} robots",
        "Within a robot, the least",
    )
    lines = [
        (
            name.replace("_", " "),
            f"{tau(together, column):.4f}",
            f"{min(tau(robot_designs, column) for robot_designs in robots):.3f}",
        )
        for column, name in enumerate(MEASURES)
    ]
    return Table(columns, tuple(lines))
