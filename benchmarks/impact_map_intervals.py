# SPDX-License-Identifier: Apache-2.0
"""How often the truth lies inside the told interval, with the truth drawn from the stated uncertainties.

    python benchmarks/impact_map_intervals.py [--truths 200] [--draws 200]

For every scenario below: intervals by ``map --uncertainty``, then truths through the map itself from another seed.
"""

from __future__ import annotations

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_rs_sim.impact_map import ImpactMapError, ImpactProblem
from impact_rs_sim.impact_map.uncertainty import answer_of, draw, predict, sources_of
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene

CASES = (("push", "cat_food", "case_2"), ("push", "juice", "case_1"))
SEED = 12345
console = Console(width=130)


def main() -> None:
    """Draw and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--truths", type=int, default=200, help="truths per case")
    parser.add_argument("--draws", type=int, default=200, help="draws behind an interval")
    options = parser.parse_args()
    table = Table(
        "case", "uncertainties", "method", "switched", "truths", "inside, all", "least", "most", "linear velocities"
    )
    for name, thing, case in CASES:
        scenario = load_scenario(name)
        scene = Scene.resolve(scenario, thing, case)
        problem = ImpactProblem.at_nominal_impact(scene)
        stated = scenario.uncertainty
        square = {"object_position": 0.0, "object_yaw": 0.0, "joint_position": 0.0}
        for label, one in (("all", stated), ("poses known", stated.model_copy(update=square))):
            told = predict(problem, one, scene.models, options.draws)
            sources, rng, truths = sources_of(problem, one), np.random.default_rng(SEED), []
            for _ in range(options.truths):
                try:
                    truths.append(answer_of(problem, scene.models, draw(sources, rng))[0])
                except ImpactMapError:
                    continue
            inside = np.mean((np.array(truths) >= told.low) & (np.array(truths) <= told.high), axis=0)
            linear = [share for share, label_ in zip(inside, told.names, strict=True) if ".velocity." in label_]
            table.add_row(
                f"{name} {thing} {case}",
                label,
                told.method,
                f"{told.switched:.0%}",
                str(len(truths)),
                f"{np.mean(inside):.1%}",
                f"{np.min(inside):.1%}",
                f"{np.max(inside):.1%}",
                f"{np.mean(linear):.1%}",
            )
    console.print(table)


if __name__ == "__main__":
    main()
