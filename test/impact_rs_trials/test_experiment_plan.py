# SPDX-License-Identifier: Apache-2.0
"""Plans: written, read, and run as campaigns."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.campaign import Manifest
from impact_rs_trials.experiment_plan import (
    SCENARIO_FILE,
    ExperimentPlan,
    PlannedCampaign,
    PlannedPair,
    manifests_of,
    read_plan,
    write_plan,
)

SLOW = {
    "label": "case 1 at 0.25 m/s",
    "robots": {"arm": {"ante_velocity": [0.0, -0.25, 0.0], "joint_1": -0.277, "joint_1_velocity": None}},
}


def plan(**changes: Any) -> ExperimentPlan:
    content: dict[str, Any] = {
        "model": "nominal",
        "model_digest": "0",
        "aim": "effects",
        "method": "design",
        "budget": 7,
        "seed": 5,
        "pairs": (PlannedPair(first="a", second="b", before=0.5, after=0.9),),
        "campaigns": [
            {
                "folder": "push",
                "scenario": "push",
                "settings": {"cases.slow": SLOW},
                "conditions": [
                    {"object": "parcel", "case": "case_2", "trials": 3, "what": "a push"},
                    {"object": "juice", "case": "slow", "trials": 2},
                ],
            },
            {"folder": "excite", "scenario": "excite", "conditions": [{"object": "none", "case": "fast", "trials": 2}]},
        ],
    }
    return ExperimentPlan.model_validate(content | changes)


def test_a_plan_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_plan(plan(), tmp_path / "plan.yaml")
    assert read_plan(tmp_path / "plan.yaml") == plan()
    assert plan().trials == 7


def test_every_condition_has_its_own_repeats_and_blocks_alternate() -> None:
    manifest = manifests_of(plan())["push"]
    names = [key.name for key in manifest.keys]
    assert sorted(names) == sorted(key.name for key in manifest.in_order)
    assert names == [
        *(f"parcel__case_2__s1.000__r{n}" for n in range(3)),
        *(f"juice__slow__s1.000__r{n}" for n in range(2)),
    ]
    assert [key.repeat for key in manifest.in_order] == [0, 0, 1, 1, 2]


def test_a_trial_runs_at_the_speed_of_the_plan() -> None:
    manifest = manifests_of(plan())["push"]
    spec = manifest.trial(manifest.keys[-1]).spec
    assert spec.plan.ante_velocity == pytest.approx(-0.25)


def test_nodes_find_the_variant_as_a_file(tmp_path: Path) -> None:
    def file_of(campaign: PlannedCampaign) -> Path:
        return tmp_path / campaign.folder / SCENARIO_FILE

    found = manifests_of(plan(), file_of=file_of)
    assert found["excite"].scenario == "excite"
    assert found["push"].settings == {}
    written, settings = load_scenario(found["push"].scenario), manifests_of(plan())["push"]
    key = settings.keys[-1]
    assert written == load_scenario("push").with_settings({"cases.slow": SLOW})
    assert found["push"].trial(key).spec.plan.ante_velocity == settings.trial(key).spec.plan.ante_velocity


def test_a_manifest_without_a_plan_is_written_as_before() -> None:
    manifest = Manifest(
        scenario="push", objects=("parcel",), cases=("case_1",), velocity_scales=(1.0,), trials=2, seed=0
    )
    assert "planned" not in manifest.model_dump(mode="json")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        (("campaigns", 0, "scenario"), "pusch", "no scenario 'pusch'"),
        (("campaigns", 0, "conditions", 0, "object"), "box", "no object 'box'"),
        (("campaigns", 0, "conditions", 1, "case"), "slower", "no case 'slower'"),
        (("campaigns", 0, "conditions", 0, "trials"), 0, "trials"),
        (("campaigns", 1, "folder"), "push", "two campaigns have the folder push"),
        (("campaigns", 1, "folder"), "../push", "folder"),
        (("method",), "best", "method"),
    ],
)
def test_a_wrong_plan_is_named_with_file_and_place(
    tmp_path: Path, key: tuple[str | int, ...], value: object, words: str
) -> None:
    path = tmp_path / "plan.yaml"
    write_plan(plan(), path)
    data = yaml.safe_load(path.read_text())
    place = data
    for part in key[:-1]:
        place = place[part]
    place[key[-1]] = value
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match=words) as error:
        read_plan(path)
    assert "plan.yaml" in str(error.value)
