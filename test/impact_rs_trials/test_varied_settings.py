# SPDX-License-Identifier: Apache-2.0
"""Campaigns beside a campaign: one setting at a time, at half and twice its value, with the seeds of the campaign."""

from pathlib import Path

import pytest
from trials import made_up

from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.campaign import make_manifest, run_campaigns
from impact_rs_trials.store import Folder
from impact_rs_trials.varied_settings import SETTINGS, sensitivity_manifests, varied_folders, with_sensitivity

GRAB = make_manifest("grab", ["parcel"], seed=3)


def test_one_setting_at_a_time_is_halved_and_doubled() -> None:
    own = load_scenario("grab")
    found = sensitivity_manifests(GRAB)
    assert set(found) == {(setting.name, factor) for setting in SETTINGS for factor in setting.factors}
    for (name, factor), manifest in found.items():
        scenario = manifest.trial(manifest.keys[0]).spec.scenario
        pairs = {
            "clamp_force": [(scenario.control.clamp_force, own.control.clamp_force)],
            "interim_duration": [(scenario.control.interim_duration, own.control.interim_duration)],
            "orientation_gain": [
                (scenario.control.gains.orientation, own.control.gains.orientation),
                (scenario.control.gains.orientation_post, own.control.gains.orientation_post),
            ],
            "pad_stiffness": [
                (scenario.robots[arm].end_effector.pad.stiffness, own.robots[arm].end_effector.pad.stiffness)
                for arm in own.robots
            ],
        }
        for setting, values in pairs.items():
            for varied, usual in values:
                assert varied == pytest.approx(usual * (factor if setting == name else 1.0))


def test_a_varied_trial_has_the_seed_of_the_trial_it_is_held_against() -> None:
    seeds = {key.scale: GRAB.trial(key).seed for key in GRAB.keys if key.case == "case_1" and key.repeat == 0}
    for manifest in sensitivity_manifests(GRAB).values():
        assert {key.scale for key in manifest.keys} == {0.8, 1.0, 1.2}
        for key in manifest.keys:
            assert (key.case, key.repeat) == ("case_1", 0)
            assert manifest.trial(key).seed == seeds[key.scale]


def test_what_a_scenario_does_not_use_is_not_varied() -> None:
    assert not [key for key in sensitivity_manifests(make_manifest("push")) if key[0] == "clamp_force"]


def test_settings_of_the_campaign_itself_stay() -> None:
    firm = make_manifest("grab", ["parcel"], settings={"control.clamp_force": 100.0, "control.interim_duration": 0.08})
    found = sensitivity_manifests(firm)
    assert found["clamp_force", 1.5].settings == {"control.clamp_force": 150.0, "control.interim_duration": 0.08}
    assert found["pad_stiffness", 0.5].settings["control.clamp_force"] == 100.0


def test_varied_campaigns_are_found_in_the_campaign_folder(tmp_path: Path) -> None:
    campaign = Folder(tmp_path)

    campaigns = with_sensitivity(campaign, GRAB)
    places = [store for store, _ in run_campaigns(campaigns, run=made_up)]
    assert {str(place): places.count(place) for place in campaigns} == {
        str(store): len(manifest.keys) for store, manifest in campaigns.items()
    }
    assert set(varied_folders(tmp_path)) == set(sensitivity_manifests(GRAB))
    assert varied_folders(tmp_path)["clamp_force", 0.5] == "sensitivity/clamp_force_x0.5"
    (tmp_path / "sensitivity" / "notes_xy").mkdir()
    assert len(varied_folders(tmp_path)) == len(campaigns) - 1
