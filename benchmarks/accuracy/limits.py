# SPDX-License-Identifier: Apache-2.0
"""Speed limits against hits in MuJoCo: missed limits and needless refusals.

A condition is a scenario, an object, a case, a place of the hit, and thresholds, all drawn at random. ``impact-rs
limits`` says how fast the arm may hit there. Then arms whose parameters are drawn from the stated uncertainties hit in
the MuJoCo cell, carried by the nominal model (``--impedance``: led by an impedance controller that knows nothing of
impacts). A *missed* limit is a hit at an allowed speed that exceeds a bound, a *needless* refusal one at a refused
speed that exceeds none. Closing speeds are uniform between 0 and twice the middle speed, up to which the bounds hold in
half of the draws.

``--calibrate`` measures how far jumps and largest values of MuJoCo lie from those of the twin, on the pushes of
:mod:`tools.discrepancy`, which the benchmark does not use: ``JUMP_SHARES`` and ``PEAK_SHARES``.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
import pinocchio as pin
from mujoco_cell import MujocoCell

from benchmarks.foreign.laboratory import DAMPING, STIFFNESS
from benchmarks.harness import Case, Row, Work
from benchmarks.results import Table
from impact_rs_analysis.evidence.replays.simulated_trials import quiet
from impact_rs_analysis.limits.drawn_hits import (
    HIT_WINDOW_S,
    JUMP_SHARES,
    PEAK_SHARES,
    Hits,
    drawn,
    drawn_springs,
    quantities,
    touching,
)
from impact_rs_analysis.limits.hit_bounds import Thresholds
from impact_rs_analysis.limits.poses import moved
from impact_rs_analysis.limits.speed import SpeedLimit, speed_limit
from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map.uncertainty import draw, possible, sources_of
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import reach_of
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmMotion, ArmState, BodyState, Scene
from tools.discrepancy import OBLIQUE, SQUARE, oblique

SCENARIOS = ("push_fr3", "push_ur5e", "push_iiwa7", "push")
PLACES = 0.08  # m, that the hit is moved at most along x and z
JUMPS, TORQUES, FORCES = (0.2, 1.0), (15.0, 80.0), (40.0, 300.0)  # rad/s, N m, N: thresholds are drawn from these
NO_BOUND = 1e9  # N m, N


def hit(
    scene: Scene, physics: Physics, arms: Mapping[str, ArmState], body: BodyState, impedance: bool = False
) -> Array:
    """Quantities of one hit in MuJoCo, ``(k,)``.

    Args:
        scene: What controller and observer of the robot believe.
        physics: The truth.
        arms: States of the arms when their pads touch.
        body: State of the object.
        impedance: Whether a Cartesian impedance follows the motion before the hit, and pushes on; else the arm has the
            torque that carries it, as in the interim mode of reference spreading, whose velocity feedback is off.
    """
    timing = scene.scenario.timing
    period = timing.drive_period
    fast = quiet(scene.scenario)
    fast = fast.model_copy(
        update={"timing": timing.model_copy(update={"control_period": period, "duration": HIT_WINDOW_S + period})}
    )
    cell = MujocoCell(fast, physics, {name: arm.position for name, arm in arms.items()}, body, seed=0)
    starts = {}
    for name, arm in arms.items():
        for joint, speed in enumerate(arm.velocity, start=1):
            for side in ("joint", "motor"):
                cell.data.qvel[cell.model.joint(f"{name}/{side}{joint}").dofadr[0]] = speed
        placement = scene.models[name].placement(arm.position)
        starts[name] = placement, scene.models[name].jacobian(arm.position)[:3] @ arm.velocity
    rows: dict[str, list[ArmMotion]] = {name: [] for name in arms}
    ticks = round(HIT_WINDOW_S / period)
    for tick in range(ticks + 1):
        time, torques = tick * period, {}
        measured = cell.measure().arms
        for name, motion in measured.items():
            rows[name].append(
                ArmMotion(motion.position, motion.velocity, motion.torque, motion.position, motion.velocity)
            )
            model, (placement, velocity) = scene.models[name], starts[name]
            terms, present = model.terms(motion.position, motion.velocity), model.placement(motion.position)
            position_error = placement.translation + time * velocity - present.translation
            rotation_error = present.rotation @ pin.log3(present.rotation.T @ placement.rotation)
            velocity_error = np.concatenate((velocity, np.zeros(3))) - terms.jacobian @ motion.velocity
            force = STIFFNESS * np.concatenate((position_error, rotation_error)) + DAMPING * velocity_error
            torques[name] = terms.bias + (terms.jacobian.T @ force if impedance else 0.0)
        if tick < ticks:
            cell.step(torques)
    signals = {}
    for name, row in rows.items():
        stacked = [np.array([getattr(motion, field) for motion in row]) for field in ("position", "velocity", "torque")]
        signals[name] = ArmMotion(*stacked, stacked[0], stacked[1])
    return quantities(scene, np.arange(ticks + 1) * period, signals)


def calibrated() -> dict[str, float]:
    """How far MuJoCo is from the twin: ``JUMP_SHARES`` by kind of the hit, then ``PEAK_SHARES``."""
    deviations: dict[str, list[float]] = {kind: [] for kind in (*JUMP_SHARES, *PEAK_SHARES)}
    scenes = [Scene.resolve(load_scenario(name), item, case) for name, item, case in SQUARE]
    scenes += [
        Scene.resolve(oblique(load_scenario(name), case, *angles), item, case) for name, item, case, *angles in OBLIQUE
    ]
    for scene in scenes:
        hits = Hits(scene, Thresholds())
        problem = touching(scene)
        twin = hits.values(1.0)[0]
        mujoco = hit(scene, *drawn(problem, scene.models, {}, scene.physics.arms))
        (arm,) = scene.physics.arms.values()
        jumps = np.array(hits.bounds.kinds) == "jump"
        deviations[hits.kind] += ((mujoco - twin)[jumps] * reach_of(arm.facts) / hits.speed).tolist()
        for kind in PEAK_SHARES:
            of_kind = np.array(hits.bounds.kinds) == kind
            largest = of_kind & (twin >= 0.3 * twin[of_kind].max())
            deviations[kind] += np.log(mujoco[largest] / twin[largest]).tolist()
    return {kind: float(np.sqrt(np.mean(np.square(values)))) for kind, values in deviations.items()}


@dataclass(frozen=True)
class Outcome:
    """One hit.

    Attributes:
        condition: Number of the condition.
        speed: Closing speed [m/s].
        limit: What was said to be allowed [m/s].
        middle: Up to which the bounds hold in half of the draws [m/s].
        worst: Largest quantity over its bound in MuJoCo [-].
        kind: Its kind.
    """

    condition: int
    speed: float
    limit: float
    middle: float
    worst: float
    kind: str

    @property
    def missed(self) -> bool:
        """Allowed, and a bound was exceeded."""
        return self.speed <= self.limit and self.worst > 1.0

    @property
    def needless(self) -> bool:
        """Refused, and no bound was exceeded."""
        return self.speed > self.limit and self.worst <= 1.0


def condition(number: int, draws: int, reflexes: bool = True) -> tuple[Hits, SpeedLimit]:
    """A condition and what is said of it; without thresholds of reflexes jumps, speeds and torques bound the speed."""
    rng = np.random.default_rng(1000 + number)
    while True:
        scenario = load_scenario(SCENARIOS[number % len(SCENARIOS)])
        item, case = (str(rng.choice(list(names))) for names in (scenario.objects, scenario.cases))
        x, z = rng.uniform(-PLACES, PLACES, 2)
        jump, torque, force = (float(rng.uniform(*ends)) for ends in (JUMPS, TORQUES, FORCES))
        limits = Thresholds(jump, torque, force) if reflexes else Thresholds(jump, NO_BOUND, NO_BOUND)
        try:
            scene = Scene.resolve(moved(scenario, x, z), item, case)
        except Infeasible:
            continue
        hits = Hits(scene, limits, draws=draws, seed=number)
        limit = speed_limit(hits)
        if 0.0 < limit.median < np.inf:
            return hits, limit


def add_options(parser: argparse.ArgumentParser) -> None:
    """How the arm is led, and how many hits."""
    parser.add_argument("--calibrate", action="store_true", help="measure JUMP_SHARES and PEAK_SHARES instead")
    parser.add_argument("--impedance", action="store_true", help="an impedance controller leads the arm")
    parser.add_argument("--no-reflexes", action="store_true", help="without thresholds of external torque and force")
    parser.add_argument("--conditions", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first condition")
    parser.add_argument("--hits", type=int, default=26, help="of every condition")
    parser.add_argument("--draws", type=int, default=200, help="of every speed limit")


def cases(options: argparse.Namespace) -> list[Case]:
    """Conditions; of a calibration one case."""
    numbers = range(options.first, options.first + options.conditions)
    return [Case("calibration")] if options.calibrate else [Case(f"condition_{number}", number) for number in numbers]


def run(case: Case, work: Work) -> Row:
    """Hits of one condition."""
    options, number = work.options, case.inputs
    if number is None:
        return {"shares": calibrated()}
    hits, limit = condition(number, options.draws, not options.no_reflexes)
    scene = hits.scene
    problem = touching(scene)
    sources = sources_of(problem, scene.scenario.uncertainty)
    rng = np.random.default_rng(10_000 + number)
    outcomes = []
    for _ in range(options.hits):
        amounts = possible(problem, draw(sources, rng))
        springs = {name: drawn_springs(arm, rng) for name, arm in scene.physics.arms.items()}
        physics, arms, body = drawn(problem, scene.models, amounts, springs)
        speed = float(rng.uniform(0.02, 2.0)) * limit.median
        moving = {name: replace(arm, velocity=speed / hits.speed * arm.velocity) for name, arm in arms.items()}
        ratios = hit(scene, physics, moving, body, options.impedance) / hits.bounds.values
        worst = int(np.argmax(ratios))
        outcome = Outcome(number, speed, limit.speed, limit.median, float(ratios[worst]), hits.bounds.kinds[worst])
        outcomes.append(asdict(outcome))
    return {"hits": outcomes, "assumed": scene.scenario.name != "push"}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row for all hits, and for those with a published and an assumed motor inertia."""
    if options.calibrate:
        return Table(
            ("Kind", "share"), tuple((kind, f"{value:.4f}") for row in rows for kind, value in row["shares"].items())
        )
    led = "led by an impedance controller" if options.impedance else "carried by its torque"
    led += ", no thresholds of reflexes" if options.no_reflexes else ""
    parts = {f"{led}, {len(rows)} conditions": rows}
    if not options.impedance and not options.no_reflexes:
        parts["... whose motor inertia is published"] = [row for row in rows if not row["assumed"]]
        parts["... whose motor inertia is assumed"] = [row for row in rows if row["assumed"]]
    columns = ("Arm is", "Hits", "Allowed", "Within all bounds", "Missed limits", "Largest allowed hit over its bound")
    columns += ("Needless refusals, of all hits", "of hits within all bounds")
    return Table(
        columns,
        tuple(
            summary(name, [Outcome(**outcome) for row in part_rows for outcome in row["hits"]])
            for name, part_rows in parts.items()
        ),
    )


def summary(name: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    """Figures of some hits."""
    missed, needless = sum(outcome.missed for outcome in outcomes), sum(outcome.needless for outcome in outcomes)
    safe, allowed = (
        sum(outcome.worst <= 1.0 for outcome in outcomes),
        [outcome.worst for outcome in outcomes if outcome.speed <= outcome.limit],
    )
    refused = f"{needless} ({100.0 * needless / max(len(outcomes), 1):.1f} %)"
    counts = (len(outcomes), len(allowed), safe, missed)
    return (
        name,
        *map(str, counts),
        f"{max(allowed, default=0.0):.2f}",
        refused,
        f"{100.0 * needless / max(safe, 1):.1f} %",
    )
