# SPDX-License-Identifier: Apache-2.0
"""Mapping files: units are turned into SI, and what makes no sense is refused with the key."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot import RobotFacts, load_facts
from impact_rs_sim.schema import validate
from impact_rs_trials.recordings.mapping import Mapping, MountedEndEffector, load_mapping, mapping_names

JOINTS = [f"joint{number}" for number in range(1, 8)]


def content(**changes: object) -> dict:
    signals = {
        "position": {"column": "q{joint}", "unit": "rad"},
        "velocity": {"column": "dq{joint}", "unit": "rad/s"},
        "torque": {"column": "tau{joint}", "unit": "N m"},
    }
    return {"description": "d", "robot": "franka_fer", "joints": JOINTS, "signals": signals, **changes}


def mapping(**changes: object) -> Mapping:
    return validate(Mapping, content(**changes), "mine.yaml")


@pytest.mark.parametrize(
    ("signal", "unit", "factor"),
    [
        ("position", "deg", np.pi / 180.0),
        ("position", "mrad", 1e-3),
        ("velocity", "deg/s", np.pi / 180.0),
        ("torque", "mN m", 1e-3),
    ],
)
def test_units_are_turned_into_si(signal: str, unit: str, factor: float) -> None:
    signals = content()["signals"]
    signals[signal] = {**signals[signal], "unit": unit}
    assert mapping(signals=signals).factor(signal) == pytest.approx(factor)


def test_a_factor_of_its_own_comes_on_top_of_the_unit() -> None:
    signals = content()["signals"]
    signals["torque"] = {**signals["torque"], "unit": "mN m", "factor": -2.0}
    assert mapping(signals=signals).factor("torque") == pytest.approx(-2e-3)


def without(name: str) -> dict:
    return {key: value for key, value in content()["signals"].items() if key != name}


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"signals": without("torque")}, "signals.torque is missing"),
        (
            {"signals": {**content()["signals"], "torque": {"column": "t", "unit": "lbf"}}},
            "signals.torque.unit is 'lbf'",
        ),
        ({"signals": {**content()["signals"], "torque": {"column": "t", "unit": "rad"}}}, "N m"),
        ({"motor_inertia": [0.1] * 6}, "motor_inertia has 6 entries, expected 7"),
        ({"motor_inertia": [-0.1] * 7}, ">= 0"),
        ({"low_pass": 0.0}, "low_pass"),
        ({"colour": "red"}, "unknown key"),
        ({"torque_measured_at": "gear"}, "torque_measured_at"),
    ],
)
def test_what_makes_no_sense_is_refused(changes: dict, complaint: str) -> None:
    with pytest.raises(InputError, match="mine.yaml") as caught:
        mapping(**changes)
    assert complaint in str(caught.value)


def test_another_number_of_joints_than_the_robot_has_is_refused() -> None:
    with pytest.raises(InputError, match="franka_fer has 7 joints, the mapping names 6"):
        _ = mapping(joints=JOINTS[:6]).facts


def test_an_end_effector_weighs_what_it_is_said_to_weigh_and_an_empty_flange_nothing() -> None:
    mounted = MountedEndEffector(
        mass=0.73, com=(0.01, 0.0, -0.03), inertia=(0.001, 0.0001, 0.0, 0.0025, 0.0, 0.0017), length=0.1
    ).build()
    assert (mounted.mass, mounted.length) == (0.73, 0.1)
    np.testing.assert_array_equal(mounted.com, [0.01, 0.0, -0.03])
    np.testing.assert_array_equal(mounted.inertia, mounted.inertia.T)
    assert (mounted.inertia[0, 1], mounted.inertia[1, 1], mounted.inertia[2, 2]) == (0.0001, 0.0025, 0.0017)
    assert 0.0 < MountedEndEffector().build().mass < 1e-9


def test_a_robot_beside_its_mapping_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the facts of a scenario are; the working directory does not count."""
    lab = tmp_path / "lab"
    (lab / "robots").mkdir(parents=True)
    facts = (config_directory() / "robots" / "franka_fer.yaml").read_text(encoding="utf-8")
    (lab / "robots" / "mine.yaml").write_text(facts, encoding="utf-8")
    (lab / "mapping.yaml").write_text(json.dumps(content(robot="robots/mine.yaml")), encoding="utf-8")
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "mine.yaml").write_text("not: facts", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert load_mapping("lab/mapping.yaml").facts == load_facts("franka_fer")
    (lab / "mapping.yaml").write_text(json.dumps(content(robot="robots/other.yaml")), encoding="utf-8")
    with pytest.raises(InputError, match="no robot 'lab/robots/other.yaml'"):
        _ = load_mapping("lab/mapping.yaml").facts
    absolute = str(lab / "robots" / "mine.yaml")
    (lab / "mapping.yaml").write_text(json.dumps(content(robot=absolute)), encoding="utf-8")
    assert load_mapping("lab/mapping.yaml").robot == absolute


def rail_under_the_first_joint(folder: Path) -> dict:
    """A mapping of a FER whose first joint slides."""
    data = load_facts("franka_fer").model_dump()
    data["joints"][0]["type"] = "prismatic"
    (folder / "rail.yaml").write_text(json.dumps(RobotFacts.model_validate(data).model_dump(mode="json")))
    units = {"position": ["mm"] + 6 * ["deg"], "velocity": ["m/s"] + 6 * ["rad/s"], "torque": ["N"] + 6 * ["mN m"]}
    signals = {name: {"column": f"{name}{{joint}}", "unit": unit} for name, unit in units.items()}
    return content(robot=str(folder / "rail.yaml"), signals=signals)


def test_joints_that_slide_have_units_of_their_own(tmp_path: Path) -> None:
    loaded = validate(Mapping, rail_under_the_first_joint(tmp_path), "mine.yaml")
    assert loaded.facts.units[0].effort == "N"
    ones = np.ones((2, 7))
    np.testing.assert_allclose(loaded.to_si("position", ones), np.tile([1e-3, *6 * [np.pi / 180.0]], (2, 1)))
    np.testing.assert_allclose(loaded.to_si("torque", ones), np.tile([1.0, *6 * [1e-3]], (2, 1)))


@pytest.mark.parametrize(
    ("unit", "complaint"),
    [
        ("rad", "signals.position.unit = 'rad': joint 1 of .*rail.yaml slides, expected m or mm"),
        (
            ["m"] + 5 * ["rad"] + ["mm"],
            "signals.position.unit = 'mm': joint 7 of .* turns, expected rad or mrad or deg",
        ),
        (["m", "rad"], "signals.position.unit lists 2 units, expected one or 7, one per joint"),
        (["m"] + 6 * ["turns"], "signals.position.unit is 'turns', expected one of"),
    ],
)
def test_a_unit_of_another_kind_of_joint_is_refused(tmp_path: Path, unit: object, complaint: str) -> None:
    data = rail_under_the_first_joint(tmp_path)
    data["signals"]["position"]["unit"] = unit
    with pytest.raises(InputError, match=complaint):
        _ = validate(Mapping, data, "mine.yaml").facts


@pytest.mark.parametrize("name", mapping_names())
def test_every_shipped_mapping_loads_and_fits_its_robot(name: str) -> None:
    loaded = load_mapping(name)
    assert loaded.facts.joint_count == len(loaded.joints)


def test_a_slip_of_the_pen_in_the_name_is_answered_with_the_name_meant(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'joint_state'"):
        load_mapping("joint_sate")
    with pytest.raises(InputError, match="none.yaml"):
        load_mapping(tmp_path / "none.yaml")
