# SPDX-License-Identifier: Apache-2.0
"""Discrepancy of the rigid impact map: how far simulated impacts of flexible arms lie from it.

``./run python -m tools.map_discrepancy -o config/map_discrepancy.yaml`` (needs the extra ``peers``).
Pushes of :mod:`tools.discrepancy` are run without noise and scatter by Bullet, the twin and MuJoCo: drives
with springs, a compliant pad, a controller. Each gives one row of a table: the state in the tick before the object
moves, and velocities after. The map has the same parameters, and contact points from the geometry. With du the
difference, v_n the closing speed, l the reach of the arm and r the radius of gyration of the object, shares of the
closing speed are

    joints  l du / v_n,        centre  du / v_n,        rotation  r du / v_n

as rms over joints or axes, and over conditions. The simulator that lies furthest off counts, as for trials. Just after
is 5 to 15 ms: a pad of some ms has let go or settled, and the controller has hardly begun. What the same velocities
differ by later is listed beside it.
"""

from __future__ import annotations

import argparse
import datetime
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.tables.map_discrepancy import (
    ANGULAR_VELOCITY_AFTER,
    JOINT_VELOCITY_AFTER,
    VELOCITY_AFTER,
    HitKind,
    lengths_of,
)
from impact_rs_control.closed_loop import run_closed_loop, without_garbage_collection
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.impact_map.measured import MeasuredImpact, points_of_scene, solve_measured
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_trials.bags.trial_info import git_revision
from impact_rs_trials.spec import TrialSpec
from tools.discrepancy import VARIANTS, Variant, specs_by_kind

SIMULATORS = ("bullet", "twin_quarter_step", "mujoco")
WINDOWS = {"5 to 15 ms": (0.005, 0.015), "20 to 40 ms": (0.020, 0.040)}  # s after the begin of the impact
MOVES = 0.01  # m/s, of an object that is hit
TICKS_BEFORE = 2
EXPECTED = 0.3  # s; before it an object that settles on its support may move as fast
KINDS: tuple[HitKind, ...] = ("square", "oblique")
BODY = {VELOCITY_AFTER: "m/s", ANGULAR_VELOCITY_AFTER: "rad/s"}


Row = tuple[float, ArmState, BodyState]


def rows_of(plan: TrialPlan, variant: Variant) -> list[Row]:
    """Time, arm and object at every tick until well after the impact, of a trial with one arm."""
    plant: Any = variant.make(plan)
    (name,) = plan.arms
    rows: list[Row] = []
    until = plan.scene.scenario.timing.nominal_impact + 2.0 * WINDOWS["20 to 40 ms"][1]
    try:
        with without_garbage_collection():
            for tick in run_closed_loop(plan, plant):
                arm, body = tick.measurement.arms[name], plant.object_state()
                rows.append((tick.measurement.time, ArmState(arm.position.copy(), arm.velocity.copy()), body))
                if tick.measurement.time >= until:
                    break
    finally:
        plant.close()
    return rows


def shares_of(spec: TrialSpec, variant: Variant) -> Array:
    """Simulated velocities in every window minus those of the map, over the closing speed, ``(windows, F)`` [-]."""
    plan = spec.plan
    physics, (name,) = plan.scene.physics, plan.arms
    rows = rows_of(plan, variant)
    times = np.array([time for time, _, _ in rows])
    speeds = np.array([np.linalg.norm(body.twist[:3]) for _, _, body in rows])
    onset = int(np.argmax((speeds > MOVES) & (times > EXPECTED))) - TICKS_BEFORE
    _, arm, body = rows[onset]
    models, arms = physics.robot_models(), {name: arm}
    impact = MeasuredImpact(arms, body, points_of_scene(physics, arms, body, models))
    predicted, _ = solve_measured(physics, impact, models)
    scale = lengths_of(features_of(physics), physics) / impact.closing_speed(physics, models)

    def within(window: tuple[float, float]) -> Array:
        time_since_onset = times - times[onset]
        chosen = np.flatnonzero((time_since_onset >= window[0]) & (time_since_onset <= window[1]))
        velocities = [np.concatenate((rows[k][1].velocity, rows[k][2].twist)) for k in chosen.tolist()]
        return np.asarray((np.mean(velocities, axis=0) - predicted) * scale)

    return np.array([within(window) for window in WINDOWS.values()])


def features_of(physics: Physics) -> tuple[Feature, ...]:
    """Velocities of the joints of an arm and of the object."""
    ((name, arm),) = physics.arms.items()
    joints = [
        Feature("", JOINT_VELOCITY_AFTER, f"joint{number}", 0, units.velocity, 0.0, name)
        for number, units in enumerate(arm.facts.units, start=1)
    ]
    body = [Feature("", signal, axis, 0, unit, 0.0) for signal, unit in BODY.items() for axis in "xyz"]
    return (*joints, *body)


def measure() -> list[dict[str, Any]]:
    """Entries of the file."""
    entries = []
    for kind in KINDS:
        specs = specs_by_kind()[kind]
        shares = {v.name: np.array([shares_of(spec, v) for spec in specs]) for v in VARIANTS if v.name in SIMULATORS}
        features = features_of(specs[0].plan.scene.physics)
        for signal in (JOINT_VELOCITY_AFTER, *BODY):
            indices = [number for number, feature in enumerate(features) if feature.signal == signal]
            sizes = {
                name: np.sqrt(np.mean(np.square(rows[:, :, indices]), axis=(0, 2))) for name, rows in shares.items()
            }
            largest = np.max(list(sizes.values()), axis=0)
            entries.append(
                {
                    "kind": kind,
                    "signal": signal,
                    "share": rounded(largest[0]),
                    "by_window": {name: rounded(value) for name, value in zip(WINDOWS, largest, strict=True)},
                    "by_simulator": {name: rounded(size[0]) for name, size in sizes.items()},
                }
            )
    return entries


def rounded(value: float) -> float:
    """Three digits."""
    return float(f"{value:.3g}")


def document(entries: list[dict[str, Any]], seconds: float) -> dict[str, Any]:
    """Content of the file."""
    return {
        "provenance": {
            "date": datetime.date.today().isoformat(),
            "command": "./run python -m tools.map_discrepancy -o config/map_discrepancy.yaml",
            "revision": git_revision(),
            "versions": {name: version(name) for name in ("impact-rs", "pybullet", "mujoco", "pin", "numpy")},
            "seconds": round(seconds),
            "conditions": [f"{kind}: {spec.object}, {spec.case}" for kind in KINDS for spec in specs_by_kind()[kind]],
            "combined": "max over simulators of the rms over conditions and over joints or axes, 5 to 15 ms after",
        },
        "entries": entries,
    }


HEADER = """\
# Discrepancy of the rigid impact map: how far simulators of flexible arms with compliant pads lie from it, as shares of
# the closing speed (joints: times reach; rotation of the object: times its radius of gyration).
# Made by tools/map_discrepancy.py, which says how; do not edit by hand.
"""


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, help="file to write, YAML")
    arguments = parser.parse_args()
    began = time.perf_counter()
    entries = measure()
    content = document(entries, time.perf_counter() - began)
    text = yaml.safe_dump(content, sort_keys=False, width=118)
    print(text)
    if arguments.output is not None:
        arguments.output.write_text(HEADER + text, encoding="utf-8")


if __name__ == "__main__":
    main()
