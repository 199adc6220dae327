# SPDX-License-Identifier: Apache-2.0
"""The reported spread of u^+ against brute force: projected Gauss-Seidel from many starts, over random problems.

    python benchmarks/impact_map_uniqueness.py [--problems 200] [--starts 12] [--sweeps 5000]

Brute force counts where it obeys the laws to ``LAWFUL``. It cannot find more than there is, and seldom finds the ends
of a family; so what is held against it is the verdict (more or less than 0.1 % of the ante-impact speed apart), that it
never finds more than was reported, and, on unique problems, that it finds the reported answer.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test" / "impact_rs_sim"))
from gauss_seidel import gauss_seidel  # noqa: E402

from impact_rs_sim.impact_map.contacts import find_contacts, meetings  # noqa: E402
from impact_rs_sim.impact_map.laws import (
    ContactTerms,  # noqa: E402
    build_system,  # noqa: E402
)
from impact_rs_sim.impact_map.sampling import random_problem  # noqa: E402
from impact_rs_sim.impact_map.uniqueness import lawful_answers, spread_of  # noqa: E402
from impact_rs_sim.scenario import load_scenario  # noqa: E402

LAWFUL = 1e-6  # m/s
console = Console(width=130)


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=200, help="number of random problems")
    parser.add_argument("--starts", type=int, default=12, help="starts of brute force per problem")
    parser.add_argument("--sweeps", type=int, default=5000, help="sweeps of brute force, at most")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random problems")
    options = parser.parse_args()
    scenario = load_scenario("push")
    reported, brute, apart, missed = [], [], [], 0
    for index in range(options.problems):
        rng = np.random.default_rng([options.seed, index])
        problem = random_problem(scenario, rng)
        models = problem.physics.robot_models()
        placements = {name: models[name].placement(arm.position) for name, arm in problem.arms.items()}
        contacts = find_contacts(problem.physics, meetings(problem.physics, problem.object, placements))
        system = build_system(problem, models)
        terms = ContactTerms.of(system, contacts, problem.restitution)
        answers = lawful_answers(terms)
        ours = spread_of(system, answers)
        # One start from nothing, the others with most of the load on one point.
        loads = 0.1 * rng.random((options.starts, len(contacts), 1))
        loads[np.arange(options.starts), rng.integers(len(contacts), size=options.starts)] += 2.0
        loads[0] = 0.0
        impulses, _ = gauss_seidel(terms, loads * terms.normals, options.sweeps)
        velocities = [terms.before + terms.response @ one.ravel() for one in impulses]
        kept = [
            velocity
            for one, velocity in zip(impulses, velocities, strict=True)
            if terms.residual(one, velocity).largest <= LAWFUL
        ]
        if len(kept) < 2:
            missed += 1
            continue
        theirs = spread_of(system, kept)
        reported.append(ours.relative)
        brute.append(theirs.relative)
        apart.append(min(spread_of(system, [answers[0], velocity]).spread for velocity in kept))
    reported_, brute_ = np.array(reported), np.array(brute)
    table = Table("over the problems that brute force solves", "value", title=f"{options.problems} problems")
    table.add_row("solved by brute force (two starts or more)", str(reported_.size))
    table.add_row(
        "not unique (> 0.1 %): reported / brute force", f"{np.sum(reported_ > 1e-3)} / {np.sum(brute_ > 1e-3)}"
    )
    table.add_row("same verdict", str(np.sum((reported_ > 1e-3) == (brute_ > 1e-3))))
    table.add_row(
        "brute force finds more than reported (by > 1e-5 of the speed)", str(np.sum(brute_ > reported_ + 1e-5))
    )
    both = reported_ > 1e-3
    table.add_row(
        "brute force / reported where not unique, median",
        f"{np.median(brute_[both] / reported_[both]):.2f}" if both.any() else "-",
    )
    table.add_row(
        "reported spread, median / 95 % / max",
        "{:.1e} / {:.1e} / {:.1e}".format(*np.percentile(reported_, [50, 95, 100])),
    )
    unique = np.array(apart)[reported_ <= 1e-5]
    table.add_row(
        f"reported answer from the nearest of brute force, {unique.size} problems reported unique to 1e-5, 95 % / max",
        "{:.1e} / {:.1e} m/s".format(*np.percentile(unique, [95, 100])) if unique.size else "-",
    )
    console.print(table)


if __name__ == "__main__":
    main()
