# SPDX-License-Identifier: Apache-2.0
"""A table of pushes by an arm with springs in its joints and a pad that bounces, simulated by Bullet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from impact_table_cases import POSE, write_csv
from intervals import assert_covers

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_control.closed_loop import run_closed_loop
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_sim.plant.plant import Plant
from impact_rs_sim.scenarios.scenario import load_scenario
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.spec import TrialSpec

NOMINAL = load_model(Path("nominal"))
CONSIDERED = ["restitution", "motor_inertia_scale", "object_mass", "pad_friction"]
BOUNCE = 0.5  # of a body of 1 kg on the pad: it sets the damping of the pad
AFTER = (0.004, 0.012)  # s after the begin of the impact
NOISE = np.repeat((0.005, 0.003, 0.02), (7, 3, 3))  # rad/s, m/s, rad/s


def pushed(object_name: str, case: str, seed: int) -> list[object]:
    """Row of one simulated push: the state in the tick before the object moves, and velocities just after."""
    scenario = load_scenario("push")
    plan = TrialSpec.of(scenario, object_name, case).plan
    truth = library()["restitution"].apply_vector(plan.scene.physics, np.array([BOUNCE]))
    initial = {name: arm.initial for name, arm in plan.arms.items()}
    plant = Plant.for_trial(scenario, truth, initial, plan.scene.object, seed)
    ticks, hit = [], np.inf
    for tick in run_closed_loop(plan, plant):
        (arm,), body = tick.measurement.arms.values(), plant.object_state()
        ticks.append((tick.measurement.time, arm.position.copy(), arm.velocity.copy(), body))
        if np.isinf(hit) and tick.measurement.time > 0.3 and np.linalg.norm(body.twist[:3]) > 0.02:
            hit, onset = tick.measurement.time, len(ticks) - 3
        if tick.measurement.time > hit + AFTER[1]:
            break
    plant.close()
    _, position, _, body = ticks[onset]
    before = np.mean([velocity for _, _, velocity, _ in ticks[onset - 8 : onset + 1]], axis=0)
    chosen = [t for t in ticks if AFTER[0] <= t[0] - ticks[onset][0] <= AFTER[1]]
    after = np.mean([np.concatenate((velocity, state.twist)) for _, _, velocity, state in chosen], axis=0)
    after = after + NOISE * np.random.default_rng(seed).standard_normal(13)
    turn = pin.Quaternion(body.rotation).coeffs()
    return [object_name, case, *position, *before, *after[:7], *body.position, *turn, *np.zeros(6), *after[7:]]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> ImpactTableSource:
    twist = [f"{kind}{axis}_{{}} [{unit}]" for kind, unit in (("v", "m/s"), ("w", "rad/s")) for axis in "xyz"]
    header = ["object", "condition", *(f"q{joint} [rad]" for joint in range(1, 8))]
    header += [f"dq{joint}_{when} [rad/s]" for when in ("before", "after") for joint in range(1, 8)]
    header += [*POSE, *(name.format(when) for when in ("before", "after") for name in twist)]
    rows = [
        pushed(name, f"case_{case}", 10 * case + repeat)
        for name in ("parcel", "juice")
        for case in (1, 2, 3)
        for repeat in range(2)
    ]
    path = write_csv(tmp_path_factory.mktemp("pushes") / "pushes.csv", header, rows)
    return ImpactTableSource(read_impact_table(path, load_scenario("push")), NOMINAL)


def bounced(source: ImpactTableSource) -> float:
    """Speed at which object and pad part over that at which they come, along y, mean over the rows [-]."""
    found = []
    for row in source.table.rows:
        ((name, state),) = row.impact.arms.items()
        jacobian = row.physics.robot_model(name).jacobian(state.position)
        before, after = ((jacobian @ velocity)[1] for velocity in (state.velocity, row.after[:7]))
        found.append((row.after[8] - after) / before)
    return float(np.mean(found))


@pytest.mark.slow
def test_a_pad_that_bounces_is_named_beside_the_discrepancy_of_the_rigid_map(source: ImpactTableSource) -> None:
    document = diagnose(source, NOMINAL, CONSIDERED)
    assert document.named == ("restitution",)
    assert_covers(document.effect("restitution").parameters["restitution"].interval, bounced(source), 0.13)
    assert document.discrepancy.used
    (item,) = (view for view in document.views if view.name == "object")
    assert item.named == ("restitution",)
    assert item.held_out_error_after < 0.5 * item.held_out_error_before
    assert "The object alone: restitution (" in document.summary
