# SPDX-License-Identifier: Apache-2.0
"""One way from a scenario's text to references: the same text gives the same trial, another text another one."""

import json
from dataclasses import replace

import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.scenario import load_scenario
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
