# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the impact map in closed form against central differences of the map itself, over random problems.

    python benchmarks/impact_map_derivatives.py [--problems 500] [--seed 0] [--compliance 1e-5]

A column counts where the map has the same contact states at the problem and at every point of the difference. The step
is the one at which the differences agree best with each other (Ridders 1982); where they disagree by more than
``TRUSTED``, the difference itself is no measure and is listed apart: at the map's own compliance of 1e-8 rounding shows
in the answer from the tenth digit on, at 1e-5 much later. The derivatives are the same code.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_rs_sim.impact_map.cones import solve_contacts
from impact_rs_sim.impact_map.derivatives import differentiate
from impact_rs_sim.impact_map.laws import COMPLIANCE, newton, states
from impact_rs_sim.impact_map.perturbation import change
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem
from impact_rs_sim.impact_map.sampling import random_problem
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_sim.scenario import load_scenario

STEPS = (1.6e-3, 4e-4, 1e-4, 2.5e-5, 6.25e-6)  # each a quarter of the one before, in units of the parameter
TRUSTED = 3e-6  # relative, how well two differences must agree to be a measure
GOAL = 1e-5

console = Console(width=130)


def solved(
    problem: ImpactProblem, models: dict[str, RobotModel], name: str, amount: float, compliance: float
) -> tuple[Array, object]:
    """u^+ with one parameter changed, and the contact states with which points bounce (None: no answer)."""
    system, terms = change(problem, {name: amount}).terms(models)
    impulses, converged = newton(terms, solve_contacts(terms)[0], compliance=compliance)
    where = tuple(contact.partner for contact in terms.contacts)
    return system.velocity + terms.response @ impulses.ravel(), (
        where,
        states(terms, impulses, compliance),
        tuple((terms.rebound < 0.0).tolist()),
    ) if converged else None


def difference(
    problem: ImpactProblem, models: dict[str, RobotModel], name: str, compliance: float
) -> tuple[Array | None, float]:
    """The best central difference, fourth order, and how well it agrees with its neighbour; None: at a switch."""
    _, nominal = solved(problem, models, name, 0.0, compliance)
    slopes = []
    for step in STEPS:
        (high, above), (low, below) = (solved(problem, models, name, sign * step, compliance) for sign in (1.0, -1.0))
        slopes.append((high - low) / (2.0 * step) if above == below == nominal else None)
    best, doubt = None, np.inf
    richer = [
        None if a is None or b is None else (16.0 * b - a) / 15.0 for a, b in zip(slopes, slopes[1:], strict=False)
    ]
    for coarse, fine in zip(richer, richer[1:], strict=False):
        if coarse is None or fine is None:
            continue
        apart = float(np.linalg.norm(coarse - fine) / max(np.linalg.norm(fine), 1e-3))
        if apart < doubt:
            best, doubt = fine, apart
    return best, doubt


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=500, help="number of random problems")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random problems")
    parser.add_argument("--columns", type=int, default=6, help="parameters drawn per problem; 0: all")
    parser.add_argument("--compliance", type=float, default=COMPLIANCE, help="rho of the contact points [-]")
    options = parser.parse_args()
    scenario = load_scenario("push")
    errors: dict[str, list[float]] = {}
    switched, noisy, times, misses = 0, 0, [], []
    for index in range(options.problems):
        rng = np.random.default_rng([options.seed, index])
        problem = random_problem(scenario, rng)
        models = problem.physics.robot_models()
        start = time.perf_counter()
        try:
            found = differentiate(problem, models, options.compliance)
        except ImpactMapError as error:
            misses.append(f"problem {index}: {error}")
            continue
        times.append(1e3 * (time.perf_counter() - start))
        names = [parameter.name for parameter in found.parameters]
        chosen = rng.permutation(names)[: options.columns or len(names)]
        for name in chosen:
            wanted, doubt = difference(problem, models, str(name), options.compliance)
            if wanted is None:
                switched += 1
            elif doubt > TRUSTED:
                noisy += 1
            else:
                # a derivative that vanishes is compared in m/s or rad/s per unit, of which 1e-3 is little
                error = float(np.linalg.norm(found.of(name) - wanted) / max(np.linalg.norm(wanted), 1e-3))
                errors.setdefault(name.rstrip("0123456789").rstrip("."), []).append(error)
                if error > GOAL:
                    misses.append(f"problem {index}, {name}: {error:.1e}, differences agree to {doubt:.1e}")
    table = Table(
        "parameter", "columns", "median", "95 %", "max", title=f"{options.problems} problems, seed {options.seed}"
    )
    for name in sorted(errors):
        table.add_row(name, str(len(errors[name])), *(f"{v:.1e}" for v in np.percentile(errors[name], [50, 95, 100])))
    together = np.concatenate([np.array(values) for values in errors.values()])
    table.add_row("all", str(together.size), *(f"{value:.1e}" for value in np.percentile(together, [50, 95, 100])))
    console.print(table)
    console.print(f"{np.mean(together <= GOAL):.2%} within {GOAL:g}; {switched} columns at a switch, {noisy} where the")
    console.print(
        f"differences disagree with each other by more than {TRUSTED:g}; {np.median(times):.1f} ms for all columns"
    )
    for miss in misses:
        console.print(miss)


if __name__ == "__main__":
    main()
