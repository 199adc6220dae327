# SPDX-License-Identifier: Apache-2.0
"""Derivatives at constant contact states against central differences of the impact map itself, over random problems.

A column counts where the map has the same contact states at the problem and at every point of the difference. The step
is the one at which the differences agree best with each other (Ridders 1982); where they disagree by more than
``TRUSTED``, the difference itself is no measure and is counted apart: at the map's own compliance of 1e-8 rounding
shows in the answer from the tenth digit on, at 1e-5 much later. The derivatives are the same code.
"""

from __future__ import annotations

import argparse

import numpy as np
from random_impacts import random_problem

from benchmarks.harness import Case, Row, Work, draw_options, map_draws
from benchmarks.results import Table
from impact_rs_sim.impact_map.derivatives import all_velocities, change, differentiate
from impact_rs_sim.impact_map.laws import COMPLIANCE, newton, solve_contacts, states
from impact_rs_sim.impact_map.problem import ImpactMapError, ImpactProblem
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario

STEPS = (1.6e-3, 4e-4, 1e-4, 2.5e-5, 6.25e-6)  # each a quarter of the one before, in units of the parameter
TRUSTED = 3e-6  # relative, how well two differences must agree to be a measure
GOAL = 1e-5


def solved(
    problem: ImpactProblem, models: dict[str, RobotModel], name: str, amount: float, compliance: float
) -> tuple[Array, object]:
    """All velocities with one parameter changed, and the contact states with which points bounce (None: no answer)."""
    system, terms = change(problem, {name: amount}).terms(models)
    impulses, converged = newton(terms, solve_contacts(terms)[0], compliance=compliance)
    partners = tuple(contact.partner for contact in terms.contacts)
    return all_velocities(system, system.velocity + terms.response @ impulses.ravel()), (
        partners,
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
    best, disagreement = None, np.inf
    extrapolated = [
        None if a is None or b is None else (16.0 * b - a) / 15.0 for a, b in zip(slopes, slopes[1:], strict=False)
    ]
    for coarse, fine in zip(extrapolated, extrapolated[1:], strict=False):
        if coarse is None or fine is None:
            continue
        difference_ = float(np.linalg.norm(coarse - fine) / max(np.linalg.norm(fine), 1e-3))
        if difference_ < disagreement:
            best, disagreement = fine, difference_
    return best, disagreement


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many problems and parameters."""
    draw_options(parser, 500)
    parser.add_argument("--columns", type=int, default=2, help="parameters drawn per problem; 0: all")
    parser.add_argument(
        "--compliances", type=float, nargs="+", default=[1e-5, COMPLIANCE], help="of contact points [-]"
    )


def cases(options: argparse.Namespace) -> list[Case]:
    """Compliances."""
    return [Case(f"compliance {compliance:g}", compliance) for compliance in options.compliances]


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> list[float | str]:
    """Errors of some columns of a problem; those that could not be compared say why."""
    rng = np.random.default_rng([0, seed])
    problem = random_problem(load_scenario("push"), rng)
    models = problem.physics.robot_models()
    try:
        derivatives = differentiate(problem, models, [case.inputs])
    except ImpactMapError:
        return ["no answer"]
    names = [parameter.name for parameter in derivatives.parameters]
    results: list[float | str] = []
    for name in rng.permutation(names)[: options.columns or len(names)]:
        reference, disagreement = difference(problem, models, str(name), case.inputs)
        if reference is None:
            results.append("at a switch")
        elif disagreement > TRUSTED:
            results.append("not measurable")
        else:
            # a derivative that vanishes is compared in m/s or rad/s per unit, of which 1e-3 is little
            error = np.linalg.norm(derivatives.of(name) - reference) / max(np.linalg.norm(reference), 1e-3)
            results.append(float(error))
    return results


def run(case: Case, work: Work) -> Row:
    """Compare all."""
    return {
        "columns": [
            column for columns in map_draws(draw_case, case, work.options, work.map_tasks) for column in columns
        ]
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each compliance."""
    lines = []
    for row in rows:
        errors = np.array([entry for entry in row["columns"] if not isinstance(entry, str)])
        lines.append(
            (
                f"{options.draws} random problems, {row['name']}",
                str(errors.size),
                f"{100.0 * np.mean(errors <= GOAL):.1f} %",
                f"{np.median(errors):.1e}",
                f"{errors.max():.1e}",
                *(str(row["columns"].count(reason)) for reason in ("at a switch", "not measurable", "no answer")),
            )
        )
    columns = ("Derivatives against central differences", "columns", f"within {GOAL:g}", "median", "largest")
    return Table((*columns, "at a switch", "not measurable", "no answer"), tuple(lines))
