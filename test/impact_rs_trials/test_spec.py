# SPDX-License-Identifier: Apache-2.0
"""One way from a scenario's text to references: the same text gives the same trial, another text another one."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.envelope import CellEnvelope, demand_of
from impact_rs_trials.spec import TrialSpec, recorded_scenario

PUSH = load_scenario("push")


@pytest.fixture
def spec() -> TrialSpec:
    return TrialSpec.of(PUSH, "cat_food", "2")


def changed(spec: TrialSpec, **values: object) -> TrialSpec:
    """The same trial of a scenario with other values."""
    return replace(spec, scenario_json=json.dumps(json.loads(spec.scenario_json) | values))


def test_the_scenario_comes_back_from_its_text(spec: TrialSpec) -> None:
    assert spec.scenario == PUSH
    assert spec.case == "case_2"


def test_repeats_share_their_plan_and_scales_their_scene(spec: TrialSpec) -> None:
    same = TrialSpec(str(spec.scenario_json), "cat_food", "case_2")
    faster = replace(spec, scale=1.1)
    assert same.plan is spec.plan
    assert faster.scene is spec.scene
    assert faster.plan.reference_post_velocity == pytest.approx(1.1 * spec.plan.reference_post_velocity, rel=1e-12)


def test_a_heavier_object_in_the_text_takes_more_of_the_velocity(spec: TrialSpec) -> None:
    objects = json.loads(spec.scenario_json)["objects"]
    objects["cat_food"]["mass"] *= 2.0
    heavier = changed(spec, objects=objects)
    assert abs(heavier.plan.predicted_post_velocity) < 0.9 * abs(spec.plan.predicted_post_velocity)


def test_more_motor_inertia_in_the_reference_keeps_more_of_the_velocity(spec: TrialSpec) -> None:
    post = [
        abs(replace(spec, motor_inertia=model).plan.predicted_post_velocity) for model in ("zero", "reduced", "rotor")
    ]
    assert post == sorted(post)
    assert post[0] < post[2]


def test_text_that_is_no_scenario_is_told_with_its_file(spec: TrialSpec) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        _ = replace(spec, scenario_json="{").scenario
    with pytest.raises(InputError, match=r"bags/one: axis = 'up'"):
        recorded_scenario(changed(spec, axis="up").scenario_json, "bags/one")


def test_an_unknown_object_or_case_is_told(spec: TrialSpec) -> None:
    with pytest.raises(InputError, match="no object 'dog_food'"):
        TrialSpec.of(PUSH, "dog_food", "2")
    with pytest.raises(InputError, match="no case '7'"):
        TrialSpec.of(PUSH, "cat_food", "7")
    with pytest.raises(InputError, match="no object 'dog_food'"):
        _ = replace(spec, object="dog_food").plan


# ---- envelope of a cell ---------------------------------------------------------------------------------------------


SLOW = TrialSpec.of(PUSH, "parcel", "case_1")  # 0.5 m/s
FAST = TrialSpec.of(PUSH, "parcel", "case_2")  # 0.7 m/s
LIMITS = CellEnvelope(scenarios=("push",), objects=("parcel",), cases=("case_1",), speed=0.55, impulse=1.0)


def test_the_impulse_is_the_momentum_that_the_object_gets() -> None:
    """m v of the parcel along the push; the support takes the rest of what is not along it."""
    motion, scene = demand_of(SLOW), SLOW.scene
    impact = SLOW.plan.impact
    assert impact is not None
    momentum = scene.physics.object.mass * np.linalg.norm(impact.object_twist[:3])
    assert motion.impulse == pytest.approx(momentum, rel=0.2)
    heavier = demand_of(TrialSpec.of(PUSH, "juice", "case_1"))
    assert heavier.impulse > 2.0 * motion.impulse


def test_the_speed_is_at_least_that_of_the_case_and_grows_with_the_reference() -> None:
    assert 0.5 <= demand_of(SLOW).speed < 0.52
    assert 0.7 <= demand_of(FAST).speed < 0.72
    assert demand_of(TrialSpec.of(PUSH, "parcel", "case_1", 1.2)).speed > 0.52
    assert demand_of(TrialSpec.of(load_scenario("excite"), "none", "fast")).impulse == 0.0


def test_a_trial_at_its_limits_is_inside() -> None:
    motion = demand_of(SLOW)
    assert LIMITS.model_copy(update={"speed": motion.speed, "impulse": motion.impulse}).complaint(SLOW) == ""


def test_objects_that_may_be_hit_say_nothing_of_a_free_motion() -> None:
    free = TrialSpec.of(load_scenario("excite"), "none", "slow")
    envelope = CellEnvelope(scenarios=("push", "excite"), objects=("parcel",), speed=0.55, impulse=1.0)
    assert envelope.complaint(free) == ""
    assert "speed" in envelope.model_copy(update={"speed": 0.3}).complaint(free)


@pytest.mark.parametrize(
    ("update", "complaint"),
    [
        ({"speed": 0.45}, "reference speed 0.5 m/s, the envelope allows 0.45 m/s"),
        ({"impulse": 0.1}, "N s, the envelope allows 0.1 N s"),
        ({"joint_speed": 0.01}, "speed of a joint over its limit"),
        ({"objects": ("juice",)}, "parcel is not in the envelope"),
        ({"cases": ("case_2",)}, "case_1 is not in the envelope"),
        ({"scenarios": ("grab",)}, "push is not in the envelope"),
    ],
)
def test_a_trial_outside_is_refused_with_value_and_limit(update: dict[str, object], complaint: str) -> None:
    envelope = LIMITS.model_copy(update=update)
    assert complaint in envelope.complaint(SLOW)
    with pytest.raises(InputError, match="push/parcel/case_1 leaves the envelope"):
        envelope.check(SLOW)
