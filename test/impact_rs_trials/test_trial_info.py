# SPDX-License-Identifier: Apache-2.0
"""Identity of a trial: what it was is told with every field, and read back from bags of every version."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from trials import plan_of

from impact_rs_control.plan import TrialPlan
from impact_rs_trials.bags.messages import MessageMaker, RosbagsTypes
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
from impact_rs_trials.bags.types import typestore

KEY = TrialKey("juice", "case_1", 0.9, 3)


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    return plan_of("push", "juice", "case_1", 0.9)


@pytest.fixture(scope="module")
def info(plan: TrialPlan) -> TrialInfo:
    return TrialInfo.of(plan, KEY, KEY.seed(5), "inprocess", "model text")


def test_it_says_what_was_planned(info: TrialInfo, plan: TrialPlan) -> None:
    assert info.key == KEY
    assert info.predicted_post_velocity == plan.predicted_post_velocity
    assert info.reference_post_velocity == pytest.approx(0.9 * info.predicted_post_velocity)
    assert info.ante_velocity == -0.5
    assert (info.window_start, info.window_end, info.nominal_impact_time) == pytest.approx((0.8, 1.5, 0.9))
    assert (info.robots, info.axis, info.duration) == (("arm",), "y", 1.8)
    assert (info.motor_inertia, info.via, info.model_yaml) == ("reduced", "inprocess", "model text")


def test_the_trial_can_be_planned_again_from_it(info: TrialInfo, plan: TrialPlan) -> None:
    again = info.spec.plan
    assert again is info.spec.plan
    assert again.scene.scenario == plan.scene.scenario
    np.testing.assert_array_equal(again.arms["arm"].post_position.position, plan.arms["arm"].post_position.position)


def test_a_message_holds_every_field(info: TrialInfo, plan: TrialPlan) -> None:
    assert TrialInfo.from_message(MessageMaker(RosbagsTypes(), plan).trial_info(info)) == info
    assert set(info.values()) == {name for name, _ in typestore().fielddefs["impact_rs/msg/TrialInfo"][1]}


def test_a_message_of_version_0_1_0_is_read_by_its_former_names(info: TrialInfo) -> None:
    values = info.values()
    values["scenario_yaml"] = values.pop("scenario_json")
    assert TrialInfo.from_message(SimpleNamespace(**values)) == info


def test_a_message_that_lacks_a_field_is_of_another_kind(info: TrialInfo) -> None:
    values = info.values()
    del values["axis"]
    with pytest.raises(AttributeError, match="axis"):
        TrialInfo.from_message(SimpleNamespace(**values))


def test_bag_names_are_unique_and_seeds_follow_from_them() -> None:
    assert KEY.name == "juice__case_1__s0.900__r3"
    keys = [TrialKey("juice", "case_1", scale, repeat) for scale in (0.8, 1.0) for repeat in range(3)]
    assert len({key.name for key in keys}) == len(keys)
    seeds = {(campaign, key): key.seed(campaign) for campaign in (0, 1) for key in keys}
    assert len(set(seeds.values())) == len(seeds)
    assert keys[0].seed(0) == TrialKey("juice", "case_1", 0.8, 0).seed(0)
