# SPDX-License-Identifier: Apache-2.0
"""The twin against the plant on replayed hits: features over the model discrepancy, and processor time.

Noise-free runs of the plant are replayed by both simulators from the same start under the same torque. Rows are, in
units of the model discrepancy (``config/discrepancy.yaml``, with half of the relevance limit of a feature), rms over
features and runs: twin minus plant, and what a quarter of the step (16 kHz, torque loop and all) changes in either.
Processor time is that of the window of a hit, plant and twin in turns, in one process and one thread.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import partial

import numpy as np

from benchmarks.harness import Case, Row, Work, in_turns
from benchmarks.results import Table
from impact_rs_analysis.evidence.discrepancy import measured_discrepancy
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Setup
from impact_rs_analysis.evidence.replays.replay import Window, replays
from impact_rs_analysis.evidence.replays.simulated_trials import observed, quiet
from impact_rs_analysis.evidence.sources.run_source import kind_of
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.plant.plant import Plant
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmMotion, BodyState
from impact_rs_sim.twin import TwinJob, simulate
from impact_rs_trials.runs import ArmSignals, Signals
from impact_rs_trials.spec import TrialSpec
from tools.discrepancy import OBLIQUE, SQUARE, oblique

KINDS = ("square", "oblique", "grab")
PAIRS = {
    "twin - plant, both at 4 kHz": ("twin", "plant"),
    "plant at 4 kHz - plant at 16 kHz": ("plant", "plant at 16 kHz"),
    "twin at 4 kHz - twin at 16 kHz, torque loop and all": ("twin", "twin at 16 kHz"),
    "twin - plant, both at 16 kHz": ("twin at 16 kHz", "plant at 16 kHz"),
}
TURNS = 5  # of the timing


def specs(kind: str) -> Iterator[TrialSpec]:
    """Trials of a kind."""
    if kind == "grab":
        grab = load_scenario("grab")
        yield from (TrialSpec.of(grab, name, next(iter(grab.cases))) for name in list(grab.objects)[:2])
    elif kind == "square":
        yield from (TrialSpec.of(load_scenario(name), item, case) for name, item, case in SQUARE)
    else:
        for name, item, case, *angles in OBLIQUE:
            yield TrialSpec.of(oblique(load_scenario(name), case, *angles), item, case)


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
    far_away = BodyState(np.array([0.0, 50.0, 50.0]), np.eye(3), np.zeros(6))
    mechanics.start(window.arms, window.drives, window.object if window.contact else far_away)
    motions: dict[str, list[ArmMotion]] = {name: [mechanics.arm(name)] for name in window.arms}
    poses = [mechanics.world.object_pose()]
    for tick, time_ in enumerate(window.time[:-1]):
        for row in range(tick * window.substeps, (tick + 1) * window.substeps):
            torque = {name: window.torque[name][acting[row]] for name, acting in window.acting.items()}
            mechanics.step(torque, 1, time_)
        for name, motion_rows in motions.items():
            motion_rows.append(mechanics.arm(name))
        poses.append(mechanics.world.object_pose())
    tracked = mechanics.world.tracked(np.array(poses))
    mechanics.close()
    arms = {
        name: ArmSignals(
            *(np.array([getattr(motion, field.name) for motion in motion_rows]) for field in fields(ArmMotion))
        )
        for name, motion_rows in motions.items()
    }
    if not window.contact:
        return Signals(window.time, arms)
    tracked_rows = np.column_stack([np.interp(window.tracked_times, window.time, column) for column in tracked.T])
    return Signals(window.time, arms, window.tracked_times, tracked_rows[:, :3], tracked_rows[:, 3:])


def by_twin(setup: Setup, physics: Physics, factor: int = 1) -> list[Signals]:
    """Signals of all windows by the twin."""
    windows = [finer(window, factor) for window in setup.windows]
    return replays([(windows, physics)], setup.drive_period / factor, setup.drive)[0]


def add_options(parser: argparse.ArgumentParser) -> None:
    """How many hits."""
    parser.add_argument("--hits", type=int, default=9, help="of each kind, at most")


def cases(options: argparse.Namespace) -> list[Case]:
    """Hits."""
    specs_by_kind = {kind: list(specs(kind)) for kind in KINDS}
    return [
        Case(f"{kind} {spec.object} {spec.case}", (kind, spec))
        for kind, kind_specs in specs_by_kind.items()
        for spec in kind_specs[:: -(-len(kind_specs) // options.hits)]  # of all objects, however few
    ]


def run(case: Case, work: Work) -> Row:
    """Differences of one hit over the discrepancy, and the ratio of processor times."""
    del work
    kind, spec = case.inputs
    run_ = measured(spec)
    setup, physics = run_.setup, run_.setup.physics
    limit = np.array([feature.relevance_limit for feature in run_.features])
    sigma = np.hypot(measured_discrepancy().of(run_.features, kind_of(run_)), limit / 2.0)
    touching = np.array([feature.phase != "free" for feature in run_.features])
    features = {
        "twin": setup.features_of(by_twin(setup, physics)),
        "twin at 16 kHz": setup.features_of(by_twin(setup, physics, 4)),
        "plant": setup.features_of(by_bullet(setup, physics)),
        "plant at 16 kHz": setup.features_of(by_bullet(setup, physics, 4)),
    }
    hit = setup.windows[-1]
    calls = {
        "plant": partial(bullet_signals, hit, physics, setup.drive_period),
        "twin": partial(simulate, [job_of(hit, physics, setup.drive_period)]),
    }
    seconds = {name: float(np.median(values)) for name, values in in_turns(calls, TURNS).items()}
    differences = {name: ((features[a] - features[b]) / sigma)[touching] for name, (a, b) in PAIRS.items()}
    return {
        "kind": kind,
        "off": differences,
        "ratio": seconds["plant"] / seconds["twin"],
        "said": f"plant {1e3 * seconds['plant']:.1f} ms, twin {1e3 * seconds['twin']:.2f} ms",
    }


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """Kinds beside each other."""
    del options
    rows_by_kind = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}
    rows_by_kind = {kind: kind_rows for kind, kind_rows in rows_by_kind.items() if kind_rows}
    lines = [
        (
            name,
            *(
                f"{np.sqrt(np.mean(np.square(np.concatenate([row['off'][name] for row in kind_rows])))):.2f}"
                for kind_rows in rows_by_kind.values()
            ),
        )
        for name in PAIRS
    ]
    ratios = [f"{np.median([row['ratio'] for row in kind_rows]):.0f}" for kind_rows in rows_by_kind.values()]
    lines.append(("processor time of a hit, plant over twin (median, one process)", *ratios))
    return Table(("rms of features over the model discrepancy", *rows_by_kind), tuple(lines))
