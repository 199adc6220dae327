# SPDX-License-Identifier: Apache-2.0
"""The two engines of the impact map side by side over random problems: how far they agree, and why not.

Problems lie about the impact of the scenario ``push``, of another robot about that of its own, as `scenario new` makes
it.
"""

from __future__ import annotations

import argparse

import numpy as np
from random_impacts import random_problem

from benchmarks.harness import Case, Row, Work, draw_options, map_draws
from benchmarks.results import Table
from impact_rs_sim.impact_map import BulletEngine, ExactEngine, ImpactMapError, ImpactResult, kinetic_energy
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.scenario_draft import draft

LIMIT = 0.5  # % of the ante-impact speed, above which a reason is printed
LAWFUL = 1e-5  # m/s, residual below which an answer obeys the laws


def difference(bullet: ImpactResult, exact: ImpactResult) -> float:
    """Largest difference in a linear velocity of end effector or object [m/s]."""
    arms = [np.abs(bullet.end_effector_twist[n] - exact.end_effector_twist[n])[:3] for n in bullet.joint_velocity]
    return float(np.max([*arms, np.abs(bullet.object_twist - exact.object_twist)[:3]]))


def same_points(bullet: ImpactResult, exact: ImpactResult) -> bool:
    """Whether both found the same contact points, to a tenth of a millimetre."""
    if len(bullet.contacts) != len(exact.contacts):
        return False
    theirs = np.array([contact.position for contact in exact.contacts])
    return all(
        np.min(np.linalg.norm(theirs - contact.position, axis=1), initial=np.inf) < 1e-4 for contact in bullet.contacts
    )


def reason(bullet: ImpactResult, exact: ImpactResult) -> str:
    """Why two answers differ."""
    broken = [
        f"{result.engine} breaks {result.residual.worst[0]} by {result.residual.worst[1]:.1e} m/s"
        for result in (bullet, exact)
        if result.residual.largest > LAWFUL
    ]
    if broken:
        return "; ".join(broken)
    if not same_points(bullet, exact):
        return f"contact points differ ({len(bullet.contacts)} and {len(exact.contacts)})"
    return "both obey all laws on the same points: redundant contacts with friction have several solutions"


def push_of(robot: str | None) -> Scenario:
    """The push of a robot in ``config/robots``; None: the shipped one."""
    return load_scenario("push") if robot is None else draft(robot, load_facts(robot), "push").scenario


def add_options(parser: argparse.ArgumentParser) -> None:
    """Whose problems, and how many."""
    draw_options(parser, 200)
    parser.add_argument("--robots", nargs="+", default=[""], help="robots of config/robots; default: that of push")


def cases(options: argparse.Namespace) -> list[Case]:
    """Robots."""
    return [Case(robot or "push", robot or None) for robot in options.robots]


def draw_case(case: Case, options: argparse.Namespace, seed: int) -> Row | None:
    """One problem by both engines; None: one of them has no answer."""
    del options
    problem = random_problem(push_of(case.inputs), np.random.default_rng([0, seed]))
    engines = (BulletEngine(problem.physics), ExactEngine(problem.physics))
    try:
        bullet, exact = (engine.solve(problem) for engine in engines)
    except ImpactMapError:
        return None
    finally:
        for engine in engines:
            engine.close()
    ((name, state),) = problem.arms.items()
    speed = float(np.linalg.norm((engines[0].models[name].jacobian(state.position) @ state.velocity)[:3]))
    percent = 100.0 * difference(bullet, exact) / speed
    if percent > LIMIT:
        print(f"problem {seed}: {percent:.2f} %, {reason(bullet, exact)}", flush=True)
    return {
        "percent": percent,
        "unique": uniqueness_of(problem).unique,
        "energy": kinetic_energy(problem, exact) / kinetic_energy(problem),
        "residual": exact.residual.largest,
    }


def run(case: Case, work: Work) -> Row:
    """All problems of a robot."""
    return {
        "problems": [
            problem for problem in map_draws(draw_case, case, work.options, work.map_tasks) if problem is not None
        ]
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for each robot, differences in percent of the ante-impact speed."""
    columns = ("Random pushes", "answered", "with a unique answer", "of these: median", "95 %", "largest [%]")
    columns += ("others, largest [%]", "residual of exact, largest [m/s]")
    lines = []
    for row in rows:
        with_unique_answer, with_several_answers = (
            [problem["percent"] for problem in row["problems"] if problem["unique"] is unique]
            for unique in (True, False)
        )
        lines.append(
            (
                f"{row['name']}, {options.draws}",
                str(len(row["problems"])),
                str(len(with_unique_answer)),
                *(f"{value:.2g}" for value in np.percentile(with_unique_answer, (50, 95, 100))),
                f"{max(with_several_answers, default=0.0):.2g}",
                f"{max(problem['residual'] for problem in row['problems']):.0e}",
            )
        )
    return Table(columns, tuple(lines))
