# SPDX-License-Identifier: Apache-2.0
"""Arms on their way to an object move as they do in Bullet, which takes over before anything is near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trials import plan_of

from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_control.plan import TrialPlan
from impact_rs_sim import approach
from impact_rs_sim.approach import NEAR, Approach
from impact_rs_sim.scene import ArmState, BodyState

AFTER = 10  # ticks after the nominal impact


def until_after_the_impact(plan: TrialPlan) -> tuple[np.ndarray, np.ndarray, int]:
    """True joint velocities, true twists of the object, and the number of ticks with a force on a pad."""
    plant = make_plant(plan, 1)
    timing = plan.scene.scenario.timing
    last = round(timing.nominal_impact / timing.control_period) + AFTER
    velocities, twists, touched = [], [], 0
    for tick in run_closed_loop(plan, plant):
        truth = plant.truth()
        velocities.append(np.concatenate([arm.velocity for arm in truth.arms.values()]))
        touched += any(np.any(arm.pad_force) for arm in truth.arms.values())
        if truth.object is not None:
            twists.append(truth.object.twist)
        if tick.number == last:
            break
    plant.close()
    return np.array(velocities), np.array(twists), touched


@pytest.mark.parametrize(("name", "object_name", "case"), [("push", "cat_food", "case_2"), ("grab", "juice", "case_1")])
def test_a_trial_is_the_same_with_and_without_bullet_before_the_impact(
    monkeypatch: pytest.MonkeyPatch, name: str, object_name: str, case: str
) -> None:
    plan = plan_of(name, object_name, case)
    without = until_after_the_impact(plan)
    monkeypatch.setattr(approach, "NEAR", np.inf)
    always = until_after_the_impact(plan)
    assert without[2] == always[2] > 0
    np.testing.assert_allclose(without[0], always[0], rtol=0.0, atol=1e-6)  # rad/s
    np.testing.assert_allclose(without[1], always[1], rtol=0.0, atol=1e-6)  # m/s, rad/s


def arms_at(plan: TrialPlan, positions: dict[str, np.ndarray], thing: BodyState) -> Approach:
    physics = plan.scene.physics
    arms = {name: ArmState(q, np.zeros_like(q)) for name, q in positions.items()}
    return Approach(physics, physics.robot_models(), 0.00025, arms, thing)


def test_a_pad_about_to_touch_is_near_and_one_far_away_is_not() -> None:
    plan = plan_of("push", "cat_food", "case_2")
    thing, start = plan.scene.object, {name: arm.initial for name, arm in plan.arms.items()}
    touching = {name: arm.position for name, arm in plan.scene.arms.items()}
    assert arms_at(plan, touching, thing).is_near
    assert not arms_at(plan, start, thing).is_near
    far = replace(thing, position=thing.position + np.array([0.0, 5.0, 0.0]))
    assert not arms_at(plan, touching, far).is_near


def test_an_object_on_its_edge_is_as_large_as_its_diagonal() -> None:
    plan = plan_of("push", "cat_food", "case_2")
    physics, start = plan.scene.physics, {name: arm.initial for name, arm in plan.arms.items()}
    pad = physics.robot_model("arm").placement(start["arm"]) * physics.arms["arm"].end_effector.pad_placement
    half = np.abs(pad.rotation) @ (np.array(physics.arms["arm"].end_effector.pad_size) / 2.0)
    box = plan.scene.object
    turned = np.array([[np.sqrt(0.5), -np.sqrt(0.5), 0.0], [np.sqrt(0.5), np.sqrt(0.5), 0.0], [0.0, 0.0, 1.0]])
    diagonal = float(physics.object.size[:2].sum()) * np.sqrt(0.5) / 2.0
    for gap, near in ((0.9 * NEAR, True), (1.1 * NEAR, False)):
        place = pad.translation + np.array([half[0] + diagonal + gap, 0.0, 0.0])
        assert arms_at(plan, start, replace(box, position=place, rotation=turned)).is_near is near


def test_two_pads_near_each_other_are_left_to_bullet() -> None:
    plan = plan_of("grab", "juice", "case_1")
    far = replace(plan.scene.object, position=plan.scene.object.position + np.array([0.0, 0.0, 5.0]))
    models = plan.scene.models
    left, right = plan.scene.arms.values()
    positions = dict(zip(models, (left.position, right.position), strict=True))
    assert not arms_at(plan, {name: arm.initial for name, arm in plan.arms.items()}, far).is_near
    first, second = models
    target = models[first].placement(positions[first])
    beside = target.copy()
    beside.rotation = models[second].placement(positions[second]).rotation
    met = models[second].inverse_kinematics(
        beside, {joint: positions[second][joint] for joint in plan.arms[second].posture}, positions[second]
    )
    assert arms_at(plan, {first: positions[first], second: met}, far).is_near


def test_a_state_that_is_nowhere_is_for_bullet() -> None:
    plan = plan_of("push", "cat_food", "case_2")
    assert arms_at(plan, {"arm": np.full(7, np.nan)}, plan.scene.object).is_near
