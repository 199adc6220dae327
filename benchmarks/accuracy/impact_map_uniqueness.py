# SPDX-License-Identifier: Apache-2.0
"""The reported spread of u^+ against brute force: projected Gauss-Seidel from many starts, over random problems.

Brute force counts where it obeys the laws to ``LAWFUL``. It cannot find more than there is, and seldom finds the ends
of a family; so what is held against it is the verdict (more or less than 0.1 % of the ante-impact speed apart), that it
never finds more than was reported, and, on unique problems, that it finds the reported answer.
"""

from __future__ import annotations

import argparse

import numpy as np
from gauss_seidel import gauss_seidel
from random_impacts import random_problem

from benchmarks.harness import Case, Row, Work, draw_options, map_draws
from benchmarks.results import Table
from impact_rs_sim.impact_map.contacts import contact_pairs, find_contacts
from impact_rs_sim.impact_map.laws import ContactTerms, build_system
from impact_rs_sim.impact_map.uniqueness import lawful_answers, spread_of
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import pad_placements

LAWFUL = 1e-6  # m/s
OPEN = 1e-3  # of the ante-impact speed: a spread that is reported as not unique
UNIQUE = 1e-5


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many problems, and how brute the force."""
    draw_options(parser, 200)
    parser.add_argument("--starts", type=int, default=12, help="starts of brute force per problem")
    parser.add_argument("--sweeps", type=int, default=5000, help="sweeps of brute force, at most")


def cases(options: argparse.Namespace) -> list[Case]:
    """All problems at once."""
    del options
    return [Case("random pushes")]


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> tuple[float, float, float] | None:
    """Reported spread, that of brute force, and distance of the nearest of its answers; None: it solves nothing."""
    del case
    rng = np.random.default_rng([0, seed])
    problem = random_problem(load_scenario("push"), rng)
    models = problem.physics.robot_models()
    placements = pad_placements(problem.physics, models, problem.arms)
    contacts = find_contacts(problem.physics, contact_pairs(problem.physics, problem.object, placements))
    system = build_system(problem, models)
    terms = ContactTerms.of(system, contacts, problem.restitution)
    answers = lawful_answers(terms)
    # One start from nothing, the others with most of the load on one point.
    loads = 0.1 * rng.random((options.starts, len(contacts), 1))
    loads[np.arange(options.starts), rng.integers(len(contacts), size=options.starts)] += 2.0
    loads[0] = 0.0
    impulses, _ = gauss_seidel(terms, loads * terms.normals, options.sweeps)
    velocities = [terms.before + terms.response @ impulse.ravel() for impulse in impulses]
    lawful = [
        velocity
        for impulse, velocity in zip(impulses, velocities, strict=True)
        if terms.residual(impulse, velocity).largest <= LAWFUL
    ]
    if len(lawful) < 2:
        return None
    nearest = min(spread_of(system, [answers[0], velocity]).spread for velocity in lawful)
    return float(spread_of(system, answers).relative), float(spread_of(system, lawful).relative), float(nearest)


def run(case: Case, work: Work) -> Row:
    """Solve all."""
    return {
        "found": [
            spreads for spreads in map_draws(draw_case, case, work.options, work.map_tasks) if spreads is not None
        ]
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Spreads beside each other."""
    reported, brute, nearest = np.array(rows[0]["found"]).T
    unique, reported_open = nearest[reported <= UNIQUE], reported > OPEN
    distance_words = (
        f"{np.percentile(unique, 95):.1e} m/s, at most {unique.max():.1e} m/s ({unique.size} problems)"
        if unique.size
        else "–"
    )
    lines = [
        (f"brute force obeys the laws to {LAWFUL:.0e} m/s from two starts or more", f"{reported.size} problems"),
        ("more than 0.1 % apart: reported / brute force", f"{reported_open.sum()} / {(brute > OPEN).sum()}"),
        ("same verdict", f"{(reported_open == (brute > OPEN)).sum()} of {reported.size}"),
        ("brute force finds a larger spread than reported", str((brute > reported + UNIQUE).sum())),
        (
            f"returned solution from the nearest of brute force, where the spread is below {UNIQUE:.0e}",
            f"95 %: {distance_words}",
        ),
        (
            "reported spread, median / 95 % / largest, of the ante-impact speed",
            "{:.2g} / {:.2g} / {:.2g} %".format(*(100.0 * np.percentile(reported, (50, 95, 100)))),
        ),
    ]
    return Table((f"{options.draws} random pushes, brute force from {options.starts} starts", ""), tuple(lines))
