# SPDX-License-Identifier: Apache-2.0
"""The two impact-map engines side by side: agreement over random problems, and time per warm call and in a batch.

OMP_NUM_THREADS=1 python benchmarks/impact_map.py [--robot franka_fr3] [--problems 300] [--calls 200] [--seed 0]

Problems lie about the impact of the scenario ``push``, of another robot about that of its own, as `scenario new` makes
it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_rs_sim.impact_map import (
    BulletEngine,
    ExactEngine,
    ImpactMapError,
    ImpactProblem,
    ImpactResult,
    kinetic_energy,
)
from impact_rs_sim.impact_map.batch import ImpactBatch, solve_batch
from impact_rs_sim.impact_map.sampling import random_problem
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.robot import load_facts
from impact_rs_sim.scenario import Scenario, load_scenario
from impact_rs_sim.scene import ArmState, Scene
from impact_rs_trials.scenario_draft import draft

LIMIT = 0.5  # % of the ante-impact speed
BATCH = 10_000  # questions
LAWFUL = 1e-5  # m/s, residual below which an answer obeys the laws

console = Console(width=130)


def spread(values: Sequence[float], digits: str) -> list[str]:
    """Median, 95 % and maximum as text."""
    return [format(float(value), digits) for value in np.percentile(values, [50, 95, 100])]


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


def agreement(scenario: Scenario, problems: int, seed: int) -> None:
    """Disagreement, residuals, energy and times over random problems."""
    percent, unique, gains, failures = [], [], [], []
    residuals: dict[str, list[float]] = {"bullet": [], "exact": []}
    times: dict[str, list[float]] = {"bullet": [], "exact": []}
    outliers = Table("problem", "%", "e", "mu pad", "mu support", "why")
    for index in range(problems):
        problem = random_problem(scenario, np.random.default_rng([seed, index]))
        engines = (BulletEngine(problem.physics), ExactEngine(problem.physics))
        try:
            answers = [[engine.solve(problem) for _ in range(2)][-1] for engine in engines]
        except ImpactMapError as error:
            failures.append(f"problem {index}: {error}")
            continue
        finally:
            for engine in engines:
                engine.close()
        bullet, exact = answers
        ((name, state),) = problem.arms.items()
        speed = float(np.linalg.norm((engines[0].models[name].jacobian(state.position) @ state.velocity)[:3]))
        percent.append(100.0 * difference(bullet, exact) / speed)
        unique.append(uniqueness_of(problem).unique)
        gains.append(kinetic_energy(problem, exact) / kinetic_energy(problem))
        for answer in answers:
            residuals[answer.engine].append(answer.residual.largest)
            times[answer.engine].append(1e3 * answer.elapsed)
        if percent[-1] > LIMIT:
            physics = problem.physics
            numbers = (problem.restitution, physics.pad_friction, physics.support_friction)
            outliers.add_row(str(index), f"{percent[-1]:.2f}", *(f"{n:.2f}" for n in numbers), reason(bullet, exact))
    table = Table("over random problems", "median", "95 %", "max", title=f"{problems} problems, seed {seed}")
    table.add_row("disagreement, % of ante-impact speed", *spread(percent, ".4f"))
    alone = [value for value, is_unique in zip(percent, unique, strict=True) if is_unique]
    table.add_row(f"of these on the {len(alone)} with a unique answer", *spread(alone, ".4f"))
    for name in residuals:
        table.add_row(f"{name}: residual, m/s", *spread(residuals[name], ".1e"))
        table.add_row(f"{name}: warm call, ms", *spread(times[name], ".2f"))
    table.add_row("energy after / before", *spread(gains, ".4f"))
    console.print(table)
    if outliers.row_count:
        console.print(f"{outliers.row_count} above {LIMIT} %:")
        console.print(outliers)
    for failure in failures:
        console.print(f"no answer, {failure}")


def timing(scenario: Scenario, calls: int) -> None:
    """Warm calls at the nominal impact of a push."""
    scene = Scene.resolve(scenario, "cat_food", "case_2")
    columns = ("nominal push, warm call", "motor inertia", "median, ms", "5 % .. 95 %, ms", "steps", "residual, m/s")
    table = Table(*columns)
    for kind in (BulletEngine, ExactEngine):
        engine = kind(scene.physics)
        for motor in ("zero", "reduced", "rotor"):
            problem = ImpactProblem.at_nominal_impact(scene, motor)
            answers = [engine.solve(problem) for _ in range(calls + 1)][1:]
            low, middle, high = 1e3 * np.percentile([answer.elapsed for answer in answers], [5, 50, 95])
            last = answers[-1]
            row = (f"{middle:.2f}", f"{low:.2f} .. {high:.2f}", str(last.iterations), f"{last.residual.largest:.1e}")
            table.add_row(kind.name, motor, *row)
        engine.close()
    console.print(table)


def batches(names: Sequence[str], seed: int) -> None:
    """Processor time of many questions at once: what differs are motor inertias and states about the nominal impact."""
    table = Table("batch of 10,000", "joint positions by", "a second", "us each", "one warm call, us", "residual, m/s")
    for name in names:
        scene = Scene.resolve(load_scenario(name), "cat_food", "case_2")
        problem = ImpactProblem.at_nominal_impact(scene)
        for moved in (0.0, 1e-4, 1e-3):  # rad
            rng = np.random.default_rng(seed)

            def about(values: np.ndarray, scale: float, rng: np.random.Generator = rng) -> np.ndarray:
                return values + scale * rng.standard_normal((BATCH, values.size))

            arms = {
                arm: ArmState(about(state.position, moved), about(state.velocity, 0.02))
                for arm, state in problem.arms.items()
            }
            motors = {arm: b * rng.uniform(0.5, 1.5, (BATCH, b.size)) for arm, b in problem.motor_inertia.items()}
            batch = ImpactBatch(problem.physics, arms, problem.object, motors, measured=True)
            start = time.process_time()
            found = solve_batch(batch)
            elapsed = time.process_time() - start
            answered = BATCH - len(found.refused)
            engine, single = ExactEngine(problem.physics), []
            for number in range(0, BATCH, BATCH // 200):
                if number not in found.refused:
                    asked = replace(batch.problem(number), physics=problem.physics)
                    engine.solve(asked)
                    start = time.process_time()
                    engine.solve(asked)
                    single.append(1e6 * (time.process_time() - start))
            table.add_row(
                f"{name}, {answered} answers",
                f"{moved:g} rad",
                f"{BATCH / elapsed:.0f}",
                f"{1e6 * elapsed / BATCH:.0f}",
                f"{np.median(single):.0f}",
                f"{np.nanpercentile(found.residual, 99):.0e} (99 %)",
            )
    console.print(table)


def main() -> None:
    """Run all parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", help="a robot of config/robots, by name; default: that of the scenario push")
    parser.add_argument("--problems", type=int, default=300, help="number of random problems")
    parser.add_argument("--calls", type=int, default=200, help="number of timed calls")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random problems")
    options = parser.parse_args()
    scenario = push_of(options.robot)
    timing(scenario, options.calls)
    batches(("push", "grab"), options.seed)
    agreement(scenario, options.problems, options.seed)


if __name__ == "__main__":
    main()
