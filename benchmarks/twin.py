# SPDX-License-Identifier: Apache-2.0
"""The twin against the Bullet plant on replayed hits: ``./run python benchmarks/twin.py [square] [oblique] [grab]``.

Noise-free runs of the plant are replayed by both simulators from the same start under the same torque. Printed are, in
units of the model discrepancy (``config/discrepancy.yaml``, with half of the relevance limit of a feature), as rms over
features and runs: twin minus Bullet, and what a quarter of the step (16 kHz, torque loop and all) changes in either.
Processor time is that of the window of a hit, Bullet and twin in turns, in one process and one thread; ratios are
medians.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pinocchio as pin

from impact_rs_analysis.evidence.discrepancy import measured_discrepancy
from impact_rs_analysis.evidence.measured_runs import MeasuredRun, Setup
from impact_rs_analysis.evidence.replay import Window, replays
from impact_rs_analysis.evidence.replays import kind_of
from impact_rs_analysis.evidence.simulated_trials import observed, quiet
from impact_rs_sim.bullet_mechanics import BulletMechanics
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant import Plant
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import Scenario, load_scenario
from impact_rs_sim.scene import ArmMotion, BodyState
from impact_rs_sim.twin import TwinJob, simulate
from impact_rs_trials.runs import ArmSignals, Signals
from impact_rs_trials.spec import TrialSpec

OBJECTS = ("parcel", "cat_food", "juice")
CASES = ("case_1", "case_2", "case_3")
TILTS = ((0.05, 0.02), (-0.05, 0.0), (0.0, -0.03))  # rad, of the pad about the vertical and about x
DRIFTS = ((0.15, 0.08), (-0.10, -0.05), (0.05, 0.10))  # of the velocity along x and z, over that along the normal
KINDS = ("square", "oblique", "grab")
TURNS = 5  # of the timing


def oblique(scenario: Scenario, case: str, tilt: tuple[float, float], drift: tuple[float, float]) -> Scenario:
    """The scenario with a pad that is tilted and a velocity off its normal."""
    (name, robot), spec = next(iter(scenario.robots.items())), scenario.cases[case]
    turn = pin.rpy.rpyToMatrix(tilt[1], 0.0, tilt[0])
    axes = {key: tuple(turn @ np.array(getattr(robot.impact, key))) for key in ("pad_normal", "pad_up")}
    tilted = robot.model_copy(update={"impact": robot.impact.model_copy(update=axes)})
    wanted = spec.robots[name]
    along = -wanted.ante_velocity[1]
    velocity = (drift[0] * along, wanted.ante_velocity[1], drift[1] * along)
    hit = spec.model_copy(update={"robots": {name: wanted.model_copy(update={"ante_velocity": velocity})}})
    return scenario.model_copy(update={"robots": {name: tilted}, "cases": {**scenario.cases, case: hit}})


def specs(kind: str) -> Iterator[tuple[str, TrialSpec]]:
    """Trials of a kind, with their names."""
    if kind == "grab":
        grab = load_scenario("grab")
        case = next(iter(grab.cases))
        yield from ((f"grab {name}", TrialSpec.of(grab, name, case)) for name in list(grab.objects)[:2])
        return
    push = load_scenario("push")
    for name in OBJECTS:
        for case, tilt, drift in zip(CASES, TILTS, DRIFTS, strict=True):
            scenario = oblique(push, case, tilt, drift) if kind == "oblique" else push
            yield f"{kind} {name} {case}", TrialSpec.of(scenario, name, case)


def measured(spec: TrialSpec) -> MeasuredRun:
    """A noise-free run of the plant."""
    plan = spec.plan
    initial = {name: arm.initial for name, arm in plan.arms.items()}
    plant = Plant.for_trial(quiet(plan.scene.scenario), plan.scene.physics, initial, plan.scene.object, seed=0)
    return MeasuredRun.of(observed(spec, plant))


def job_of(hit: Window, physics: Physics, period: float) -> TwinJob:
    """Job of the twin for the window of a hit."""
    return TwinJob(physics, hit.arms, hit.drives, hit.torque, hit.acting, hit.time, period, object=hit.object)


def finer(window: Window, factor: int) -> Window:
    """The window with a torque loop that runs ``factor`` times as fast, under the same torque."""
    acting = {name: np.repeat(rows, factor) for name, rows in window.acting.items()}
    return replace(window, acting=acting)


def by_bullet(setup: Setup, physics: Physics, factor: int = 1) -> list[Signals]:
    """Signals of all windows by Bullet."""
    period = setup.drive_period / factor
    return [bullet_signals(finer(window, factor), physics, period) for window in setup.windows]


def bullet_signals(window: Window, physics: Physics, period: float) -> Signals:
    """Signals of a window by the mechanics of the plant."""
    mechanics = BulletMechanics.load(physics, period)
    away = BodyState(np.array([0.0, 50.0, 50.0]), np.eye(3), np.zeros(6))
    mechanics.start(window.arms, window.drives, window.object if window.contact else away)
    motions: dict[str, list[ArmMotion]] = {name: [mechanics.arm(name)] for name in window.arms}
    poses = [mechanics.world.object_pose()]
    for tick, time_ in enumerate(window.time[:-1]):
        for row in range(tick * window.substeps, (tick + 1) * window.substeps):
            torque = {name: window.torque[name][acting[row]] for name, acting in window.acting.items()}
            mechanics.step(torque, 1, time_)
        for name, kept in motions.items():
            kept.append(mechanics.arm(name))
        poses.append(mechanics.world.object_pose())
    tracked = mechanics.world.tracked(np.array(poses))
    mechanics.close()
    arms = {
        name: ArmSignals(*(np.array([getattr(motion, field.name) for motion in kept]) for field in fields(ArmMotion)))
        for name, kept in motions.items()
    }
    if not window.contact:
        return Signals(window.time, arms)
    seen = np.column_stack([np.interp(window.seen, window.time, column) for column in tracked.T])
    return Signals(window.time, arms, window.seen, seen[:, :3], seen[:, 3:])


def by_twin(setup: Setup, physics: Physics, factor: int = 1) -> list[Signals]:
    """Signals of all windows by the twin."""
    windows = [finer(window, factor) for window in setup.windows]
    return replays([(windows, physics)], setup.drive_period / factor, setup.drive)[0]


def seconds(run: object, *arguments: object) -> float:
    """Processor time of a call."""
    start = time.process_time()
    run(*arguments)  # type: ignore[operator]
    return time.process_time() - start


def rms(rows: list[Array]) -> str:
    """Root mean square and largest 5 % of all numbers."""
    values = np.concatenate(rows)
    return f"{np.sqrt(np.mean(np.square(values))):.2f} (95 %: {np.quantile(np.abs(values), 0.95):.2f})"


def main() -> None:
    """Print one line per run and one per kind."""
    discrepancy = measured_discrepancy()
    for kind in sys.argv[1:] or KINDS:
        found: dict[str, list[Array]] = {}
        ratios = []
        for name, spec in specs(kind):
            run = measured(spec)
            setup, physics = run.setup, run.setup.physics
            limit = np.array([feature.relevance_limit for feature in run.features])
            sigma = np.hypot(discrepancy.of(run.features, kind_of(run)), limit / 2.0)
            touching = np.array([feature.phase != "free" for feature in run.features])
            features = {
                "twin": setup.features_of(by_twin(setup, physics)),
                "twin at 16 kHz": setup.features_of(by_twin(setup, physics, 4)),
                "Bullet": setup.features_of(by_bullet(setup, physics)),
                "Bullet at 16 kHz": setup.features_of(by_bullet(setup, physics, 4)),
            }
            pairs = (("twin", "Bullet"), ("Bullet", "Bullet at 16 kHz"), ("twin", "twin at 16 kHz"))
            for one, other in (*pairs, ("twin at 16 kHz", "Bullet at 16 kHz")):
                difference = ((features[one] - features[other]) / sigma)[touching]
                found.setdefault(f"{one} - {other}", []).append(difference)
            hit = setup.windows[-1]
            taken: dict[str, list[float]] = {"Bullet": [], "twin": []}
            for _ in range(TURNS):
                taken["Bullet"].append(seconds(bullet_signals, hit, physics, setup.drive_period))
                taken["twin"].append(seconds(simulate, [job_of(hit, physics, setup.drive_period)]))
            bullet, own = (1e3 * float(np.median(values)) for values in taken.values())
            ratios.append(bullet / own)
            (result,) = simulate([job_of(hit, physics, setup.drive_period)])
            print(
                f"{name}: Bullet {bullet:.1f} ms, twin {own:.2f} ms, {bullet / own:.1f} times; {result.steps} steps, "
                f"{result.contact_steps} with contact, {result.iterations / max(result.contact_steps, 1):.2f} "
                f"iterations a step, {result.fallbacks} fallbacks, {len(result.failed)} failed, residual "
                f"{result.residual:.0e} m/s",
                flush=True,
            )
        print(f"{kind}: processor time of a hit {np.median(ratios):.1f} times less; over the discrepancy:")
        for pair, rows in found.items():
            print(f"  {pair}: {rms(rows)}")


if __name__ == "__main__":
    main()
