# SPDX-License-Identifier: Apache-2.0
"""Scenario files: read and refused, their page, and the friction compensation beside them."""

import copy
import json
import os
import re
import shutil
from pathlib import Path

import pytest
import yaml

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.scenarios.friction_compensation import TASKS
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_docs import markdown
from impact_rs_sim.scenarios.scenario_files import load_scenario, scenario_path
from impact_rs_sim.scenarios.trial_settings import Gains, Timing
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import validate

# ---- scenarios ------------------------------------------------------------------------------------------------------

PUSH = config_directory() / "scenarios" / "push.yaml"


@pytest.fixture(scope="module")
def text():
    return yaml.safe_load(scenario_path("push").read_text(encoding="utf-8"))


def broken(text, key, value):
    data = copy.deepcopy(text)
    *parents, last = key.split(".")
    place = data
    for part in parents:
        place = place[part]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return data


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("objects.juice.mass", -2.2, ["objects.juice.mass = -2.2", "[kg]"]),
        ("objects.juice.mass", "heavy", ["objects.juice.mass = 'heavy'", "[kg]"]),
        ("objects.juice.mass", float("nan"), ["objects.juice.mass", "[kg]"]),
        ("objects.juice.mass", None, ["objects.juice.mass", "missing", "[kg]"]),
        ("objects.juice.colour", "red", ["objects.juice.colour", "unknown key"]),
        ("contact.frictoin", 0.3, ["contact.frictoin", "did you mean 'friction'"]),
        (
            "robots.arm.drive.motor_inertia_rotor",
            [0.6, 0.6, 0.45, 0.45, 0.2, 0.2, -0.2],
            ["motor_inertia_rotor", "[kg m^2]"],
        ),
        ("robots.arm.drive.stiffness", [14000] * 6, ["6 entries", "one per joint (7)"]),
        ("robots.arm.end_effector.inertia", [1e-3, 1e-3, 3e-3], ["robots.arm.end_effector", "no rigid body"]),
        ("robots.arm.impact.pad_normal", [0, -2, 0], ["pad_normal"]),
        ("contact.restitution", 1.5, ["contact.restitution = 1.5", "[-]"]),
        ("timing.window_after", 5.0, ["timing", "window", "[s]"]),
        ("axis", "w", ["axis = 'w'", "'x', 'y' or 'z'"]),
        ("robots.arm.facts", "panda9", ["panda9", "known robots: franka_fer"]),
        ("robots.arm.drive.type", "rigid", ["motor_inertia_reduced", "rigid"]),
        ("robots.arm.drive.motor_inertia_reduced", None, ["motor_inertia_reduced", "required", "[kg m^2]", "rigid"]),
        ("cases.case_1.robots.arm.posture", {"joint_8": 0.1}, ["joint_8", "7 joints"]),
        ("cases.case_1.robots.arm.posture", {"elbow": 0.1}, ["elbow", "joint_N"]),
        ("cases.case_1.robots.arm.posture", {"joint_1": 0.1}, ["joint_1", "once"]),
    ],
)
def test_error_names_file_key_value_and_what_was_expected(text, key, value, expected):
    with pytest.raises(InputError) as caught:
        validate(Scenario, broken(text, key, value), "my_push.yaml")
    message = str(caught.value)
    assert "\n" not in message
    for part in ["my_push.yaml", *expected]:
        assert part in message


def test_joints_of_the_posture_task_are_told_in_the_order_of_the_arm(text):
    data = broken(text, "cases.case_1.robots.arm.posture", {"joint_6": 1.4, "joint_3": 0.5})
    held = validate(Scenario, data, PUSH).cases["case_1"].robots["arm"].posture_joints
    assert list(held.items()) == [(0, -0.277), (2, 0.5), (5, 1.4)]
    free = validate(Scenario, broken(text, "cases.case_1.robots.arm.joint_1", None), PUSH)
    assert free.cases["case_1"].robots["arm"].posture_joints == {}


def test_a_robot_without_torque_sensors_has_no_torque_loop(text):
    facts = load_facts("franka_fer").model_copy(update={"joint_torque_loop": False}).model_dump()
    with pytest.raises(InputError, match=r"has no torque loop that could shape its inertia: drive.type: rigid"):
        validate(Scenario, broken(text, "robots.arm.facts", facts), PUSH)


def test_without_a_torque_loop_the_links_carry_the_rotor_inertia(text):
    data = broken(broken(text, "robots.arm.drive.motor_inertia_reduced", None), "robots.arm.drive.type", "rigid")
    scenario = validate(Scenario, data, PUSH)
    arm = Physics.nominal(scenario, "juice").arms["arm"]
    assert arm.motor_inertia_reduced.tolist() == list(scenario.robots["arm"].drive.motor_inertia_rotor)
    again = Scenario.model_validate_json(scenario.model_dump_json())
    assert again == scenario


def test_a_bag_of_a_scenario_without_new_keys_reads_as_it_always_did(text):
    written = validate(Scenario, text, PUSH).model_dump(mode="json")
    assert "type" not in written["robots"]["arm"]["drive"]
    assert "posture" not in written["cases"]["case_1"]["robots"]["arm"]


def test_unknown_names_list_those_that_exist():
    scenario = load_scenario("push")
    with pytest.raises(InputError, match="parcel, cat_food, juice"):
        Scene.resolve(scenario, "dog_food", "1")
    with pytest.raises(InputError, match="case_1, case_2, case_3"):
        Scene.resolve(scenario, "juice", "4")
    with pytest.raises(InputError, match="known scenarios: .*push"):
        load_scenario("pusch")


def test_case_2_differs_in_velocity_only_and_case_3_in_configuration_only():
    scenario = load_scenario("push")
    one, two, three = (Scene.resolve(scenario, "juice", case) for case in "123")
    model = one.models["arm"]
    velocity = [s.models["arm"].jacobian(s.arms["arm"].position) @ s.arms["arm"].velocity for s in (one, two, three)]
    assert one.arms["arm"].position == pytest.approx(two.arms["arm"].position)
    assert velocity[0][1] == pytest.approx(velocity[2][1]) == pytest.approx(-0.5)
    assert velocity[1][1] == pytest.approx(-0.7)
    assert abs(one.arms["arm"].position[0] - three.arms["arm"].position[0]) > 0.2
    assert model.placement(one.arms["arm"].position).isApprox(model.placement(three.arms["arm"].position), 1e-7)


def test_a_scenario_that_follows_the_first_impact_reads_as_it_always_did() -> None:
    push = load_scenario("push")
    assert push.control.reference_contact == "first"
    assert "reference_contact" not in push.model_dump_json()
    control = push.control.model_copy(update={"reference_contact": "settled"})
    other = push.model_copy(update={"control": control})
    assert other.digest != push.digest
    assert Scenario.model_validate_json(other.model_dump_json()).control.reference_contact == "settled"


def test_what_is_assumed_is_no_part_of_the_motion() -> None:
    """A friction compensation belongs to the motion: it stays valid when an assumption is marked, or known better."""
    push = load_scenario("push")
    assert push.robots["arm"].drive.assumed == ("stiffness", "damping")
    known = push.with_settings({"robots.arm.drive.assumed": [], "uncertainty.motor_inertia": 0.05})
    assert known.digest == push.digest
    assert "assumed" not in known.model_dump_json()
    with pytest.raises(InputError, match="assumed names motor_inertia_reduced, which is not in this section"):
        load_scenario("push_ur5e").with_settings({"robots.arm.drive.assumed": ["motor_inertia_reduced"]})


def test_a_setting_replaces_one_value_of_the_scenario_alone():
    own = load_scenario("grab")
    assert own.with_settings({}) is own
    changed = own.with_settings({"control.clamp_force": 90.0, "objects.juice.size": [0.2, 0.1, 0.1]})
    assert changed.control.clamp_force == 90.0
    assert changed.objects["juice"].size == (0.2, 0.1, 0.1)
    assert changed.with_settings({"control.clamp_force": 60.0, "objects.juice.size": own.objects["juice"].size}) == own


def test_a_setting_that_files_leave_out_can_be_made():
    changed = load_scenario("push").with_settings(
        {"contact.restitution_law": "poisson", "uncertainty.object_mass": 0.1}
    )
    assert changed.contact.restitution_law == "poisson"
    assert changed.uncertainty.object_mass == 0.1


def scenario_with_a_robot_beside_it(folder: Path, facts: str = "robots/mine.yaml") -> Path:
    """The scenario push, with its robot's facts in a file of the user's own."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = folder / "robots" / "mine.yaml"
    robot.parent.mkdir()
    robot.write_text((config_directory() / "robots" / "franka_fer.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    path = folder / "mine.yaml"
    path.write_text(PUSH.read_text(encoding="utf-8").replace("facts: franka_fer", f"facts: {facts}"), encoding="utf-8")
    return path


def test_robot_facts_by_path_are_found_and_travel_with_the_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = scenario_with_a_robot_beside_it(tmp_path / "laboratory")
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("laboratory/mine.yaml")
    assert scenario.robots["arm"].robot_facts == load_facts("franka_fer")
    recorded = scenario.model_dump_json()
    shutil.rmtree(path.parent)
    assert Scenario.model_validate_json(recorded) == scenario
    assert Scenario.model_validate_json(recorded).robots["arm"].robot_facts == load_facts("franka_fer")


def test_a_robot_file_that_is_not_there_or_wrong_is_told_by_its_own_name(tmp_path: Path) -> None:
    path = scenario_with_a_robot_beside_it(tmp_path / "one", "robots/other.yaml")
    with pytest.raises(InputError, match="other.yaml: cannot be read"):
        load_scenario(str(path))
    path = scenario_with_a_robot_beside_it(tmp_path / "two")
    robot = path.parent / "robots" / "mine.yaml"
    robot.write_text(robot.read_text(encoding="utf-8").replace("mass: 4.970684", "mass: -1"), encoding="utf-8")
    with pytest.raises(InputError, match=r"mine.yaml: links.0.mass = -1"):
        load_scenario(str(path))


def test_a_robot_by_name_is_written_by_its_name() -> None:
    assert load_scenario("push").model_dump()["robots"]["arm"]["facts"] == "franka_fer"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("0.012516", "-0.012516", "links.6.inertia has the principal moment -0.0126"),
        ("position_min_rad: [-2.8973", "position_min_rad: [2.9", "position_min_rad.0 = 2.9 must be below"),
    ],
)
def test_a_robot_that_cannot_be_is_refused_before_it_moves(tmp_path: Path, old: str, new: str, told: str) -> None:
    facts = (config_directory() / "robots" / "franka_fer.yaml").read_text(encoding="utf-8")
    assert old in facts
    (tmp_path / "robot.yaml").write_text(facts.replace(old, new), encoding="utf-8")
    push = (config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(push.replace("facts: franka_fer", "facts: robot.yaml"), encoding="utf-8")
    with pytest.raises(InputError, match="mine.yaml: robots.arm.*" + re.escape(told)):
        load_scenario(str(tmp_path / "mine.yaml"))


# ---- the page about scenario files ----------------------------------------------------------------------------------

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scenarios.md"


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == markdown(), (
        "run: python -m impact_rs_sim.scenarios.scenario_docs > docs/scenarios.md"
    )


@pytest.mark.parametrize("schema", [Timing, Gains])
def test_every_number_has_a_unit(schema: type) -> None:
    for name, field in schema.model_fields.items():
        assert re.search(r"\[.+\]", field.description), f"{name} has no unit"


# ---- the file with the friction compensation ------------------------------------------------------------------------

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
        (_with_nan, ["sets.cat_food.case_2.arm.ante.x", "[m/s^2]"]),
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


@pytest.mark.parametrize("name", ["object", "support"])
def test_a_robot_called_as_another_body_is_refused(name):
    """Kills pads that get the friction of the support, and maps with two bodies of one name."""
    data = yaml.safe_load(PUSH.read_text(encoding="utf-8").replace(" arm:", f" {name}:"))
    with pytest.raises(InputError, match=f"robots.{name}: another body has this name; choose another one"):
        validate(Scenario, data, "mine.yaml")


def test_a_changed_robot_file_is_read_again(tmp_path: Path) -> None:
    """Kills a cache that asks the time of the scenario file alone."""
    path = scenario_with_a_robot_beside_it(tmp_path)
    assert load_scenario(str(path)).robots["arm"].robot_facts.links[6].mass != 2.0
    facts = path.parent / "robots" / "mine.yaml"
    content = yaml.safe_load(facts.read_text())
    content["links"][6]["mass"] = 2.0
    facts.write_text(yaml.safe_dump(content))
    os.utime(facts, ns=(0, facts.stat().st_mtime_ns + 1_000_000))
    assert load_scenario(str(path)).robots["arm"].robot_facts.links[6].mass == 2.0


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"excursion.end": list(load_scenario("excite").excursion.start)}, "excursion.end must differ from start"),
        ({"cases.slow.robots.arm.ante_velocity": [0.0, 0.0, 0.0]}, "cases.slow.robots.arm.ante_velocity is 0"),
    ],
)
def test_an_excursion_without_a_way_or_a_speed_is_refused(settings, expected):
    """Kills a duration of 0 / v or s / 0 seconds, which ends in joints at nan."""
    with pytest.raises(InputError, match=expected):
        load_scenario("excite").with_settings(settings)
