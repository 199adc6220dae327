# SPDX-License-Identifier: Apache-2.0
"""The design study by a second engine: do steps of Bullet rank the designs as the exact map does?

    ./run python -m benchmarks.design_study [--poses 100] [--pads wide narrow bouncy]

Every design is asked twice without uncertainties, of the engines ``exact`` and ``bullet`` of the impact map; Kendall's
tau of both orders is printed for each measure, over all designs and within a robot (the smallest).
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import kendalltau

from impact_rs_analysis.measure.design_study import (
    MEASURES,
    PADS,
    ROBOTS,
    DesignQuestion,
    problems_of,
    stances_of,
    values_by,
)
from impact_rs_sim.impact_map import ENGINES, ImpactMapError
from impact_rs_sim.scenario import load_scenario

console = Console(width=140)


def main() -> None:
    """Ask and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=100, help="poses per robot")
    parser.add_argument("--pads", nargs="+", default=list(PADS), choices=PADS, help="pads")
    options = parser.parse_args()
    question = DesignQuestion(load_scenario("push"), "cat_food", pads=tuple(options.pads))
    found: dict[str, list[tuple[str, list[float]]]] = defaultdict(list)
    start, failed = time.perf_counter(), 0
    for robot in ROBOTS:
        for stance in stances_of(robot, question, options.poses)[0]:
            for _, _, problem in problems_of(question, stance):
                try:
                    answers = {engine: list(values_by(engine, problem).values()) for engine in ENGINES}
                except ImpactMapError:
                    failed += 1
                    continue
                for engine, values in answers.items():
                    found[engine].append((robot, values))
        console.print(f"{robot}: {len(found['exact'])} designs after {time.perf_counter() - start:.0f} s")
    exact, bullet = (np.array([values for _, values in found[engine]]) for engine in ("exact", "bullet"))
    names = np.array([robot for robot, _ in found["exact"]])
    table = Table(title=f"Kendall's tau, exact against bullet, {len(names)} designs ({failed} without an answer)")
    for heading in ("measure", "all designs", "within a robot, least", "median difference [%]"):
        table.add_column(heading)
    for column, measure in enumerate(MEASURES):
        one, two = exact[:, column], bullet[:, column]
        within = min(kendalltau(one[names == robot], two[names == robot]).statistic for robot in ROBOTS)
        off = 100.0 * float(np.median(np.abs(two - one) / np.abs(one)))
        table.add_row(measure, f"{kendalltau(one, two).statistic:.4f}", f"{within:.4f}", f"{off:.3f}")
    console.print(table)


if __name__ == "__main__":
    main()
