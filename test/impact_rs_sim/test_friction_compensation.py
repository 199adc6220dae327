# SPDX-License-Identifier: Apache-2.0
"""The file with the friction compensation: what it holds, and what a user reads when it does not fit."""

import json

import pytest
import yaml

from impact_rs_sim.errors import InputError
from impact_rs_sim.friction_compensation import TASKS
from impact_rs_sim.scenario import Scenario, load_scenario, scenario_path

COUNT = 181  # samples of 10 ms in a trial of 1.8 s


@pytest.fixture
def content():
    samples = {task: [0.0] * COUNT for task in TASKS}
    return {
        "scenario": "push",
        "scenario_digest": load_scenario("push").digest,
        "runs": 5,
        "seed": 0,
        "period": 0.01,
        "sets": {"cat_food": {"case_2": {"arm": {"ante": samples, "post": samples}}}},
    }


def loaded(folder, content, change="", named="friction.yaml"):
    (folder / "friction.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(content))))
    text = scenario_path("push").read_text(encoding="utf-8") + change
    (folder / "push.yaml").write_text(f"{text}\nfriction_compensation: {named}\n")
    return load_scenario(str(folder / "push.yaml"))


def _sets(content):
    return content["sets"]["cat_food"]["case_2"]


def _with_nan(content):
    _sets(content)["arm"]["ante"] = _sets(content)["arm"]["ante"] | {"x": [float("nan")] * COUNT}


def _too_short(content):
    _sets(content)["arm"]["post"] = _sets(content)["arm"]["post"] | {"joint_1": [0.0] * 7}


def _two_arms(content):
    _sets(content)["amr"] = _sets(content)["arm"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda c: c["sets"].update(dog_food={}), ["sets.dog_food", "no such object", "cat_food"]),
        (lambda c: c["sets"]["cat_food"].update(case_9={}), ["sets.cat_food.case_9", "no such case", "case_1"]),
        (_two_arms, ["sets.cat_food.case_2.amr", "no such arm", "did you mean 'arm'"]),
        (lambda c: _sets(c).pop("arm"), ["sets.cat_food.case_2", "arm 'arm' is missing"]),
        (_with_nan, ["sets.cat_food.case_2.arm.ante.x", "finite", "[m/s^2]"]),
        (_too_short, ["sets.cat_food.case_2.arm.post.joint_1", "7 samples, expected 181", "0.01 s"]),
        (lambda c: c.update(scenario_digest="0123"), ["scenario_digest = '0123'", "identify it again"]),
        (lambda c: c.update(period=-0.01), ["period = -0.01", "[s]"]),
        (lambda c: c.pop("runs"), ["runs", "missing"]),
    ],
)
def test_error_names_the_compensation_file_and_the_place_in_it(tmp_path, content, change, expected):
    change(content)
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, content)
    message = str(caught.value)
    assert "\n" not in message
    for part in ["friction.yaml", *expected]:
        assert part in message


def test_a_compensation_that_is_not_there_is_named_with_the_scenario(tmp_path, content):
    with pytest.raises(InputError, match=r"push\.yaml: friction_compensation = .*other\.yaml.*no such file"):
        loaded(tmp_path, content, named="other.yaml")


def test_another_scenario_is_refused_and_another_number_of_trials_is_not(tmp_path, content):
    fitting = loaded(tmp_path, content).model_copy(update={"trials": 9, "velocity_scales": (1.0, 1.1)})
    assert fitting.digest == content["scenario_digest"]
    text = scenario_path("push").read_text(encoding="utf-8").replace("position: 200.0 ", "position: 300.0 ")
    (tmp_path / "stiff.yaml").write_text(f"{text}\nfriction_compensation: friction.yaml\n")
    with pytest.raises(InputError, match="another version of scenario 'push'"):
        load_scenario(str(tmp_path / "stiff.yaml"))


def test_a_changed_compensation_is_read_again(tmp_path, content):
    assert loaded(tmp_path, content).friction_compensation.runs == 5
    content["runs"] = 6
    (tmp_path / "friction.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(content))))
    assert load_scenario(str(tmp_path / "push.yaml")).friction_compensation.runs == 6


def test_a_recorded_scenario_holds_and_checks_its_compensation(tmp_path, content):
    scenario = loaded(tmp_path, content)
    text = scenario.model_dump_json()
    assert Scenario.model_validate_json(text) == scenario
    broken = json.loads(text)
    broken["friction_compensation"]["scenario_digest"] = "0123"
    with pytest.raises(ValueError, match="identify it again"):
        Scenario.model_validate(broken)


def test_a_scenario_without_compensation_is_recorded_without_the_key():
    assert "friction_compensation" not in load_scenario("push").model_dump()
    assert "friction_compensation" not in load_scenario("push").model_dump_json()
