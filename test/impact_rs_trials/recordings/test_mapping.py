# SPDX-License-Identifier: Apache-2.0
"""Mapping files: units are turned into SI, and what makes no sense is refused with the key."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from refusals import lacking, refusal

from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import RobotFacts, load_facts
from impact_rs_sim.schema import validate
from impact_rs_trials.recordings.checks.clock_offset import FOUND_BY, OBJECT_SIGNALS
from impact_rs_trials.recordings.mapping import (
    SHIFTED_SIGNALS,
    Mapping,
    MountedEndEffector,
    load_mapping,
    mapping_names,
)

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


def signals(name: str, **keys: object) -> dict:
    """The signals with other keys of one, which is left out without any."""
    found = content()["signals"]
    changed = found.pop(name) | keys
    return found | ({name: changed} if keys else {})


@pytest.mark.parametrize(
    ("signal", "keys", "factor"),
    [
        ("position", {"unit": "deg"}, np.pi / 180.0),
        ("position", {"unit": "mrad"}, 1e-3),
        ("velocity", {"unit": "deg/s"}, np.pi / 180.0),
        ("torque", {"unit": "mN m"}, 1e-3),
        ("torque", {"unit": "mN m", "factor": -2.0}, -2e-3),  # on top of the unit
    ],
)
def test_units_are_turned_into_si(signal: str, keys: dict, factor: float) -> None:
    assert mapping(signals=signals(signal, **keys)).factor(signal) == pytest.approx(factor)


def test_an_offset_is_added_after_the_factor_in_the_unit() -> None:
    """As where an encoder turns the other way and counts from another zero."""
    zero = [0.0, -90.0, 90.0, 0.0, 0.0, 0.0, 0.0]
    own = mapping(signals=signals("position", unit="deg", factor=-1.0, offset=zero))
    np.testing.assert_allclose(own.to_si("position", np.full((1, 7), 30.0)), np.radians([np.array(zero) - 30.0]))


def test_a_mapping_without_velocities_is_one_and_without_torques_is_none() -> None:
    assert "velocity" not in mapping(signals=signals("velocity")).signals
    with pytest.raises(InputError, match="signals.torque is missing; position and torque are needed"):
        mapping(signals=signals("torque"))


def test_currents_become_torques_by_the_constant_of_each_joint() -> None:
    constants = [10.0, 9.0, 8.0, 7.0, 6.0, 5.0, 4.0]
    own = mapping(signals=signals("torque", unit="mA"), torque_measured_at="motor", torque_constant=constants)
    np.testing.assert_allclose(own.to_si("torque", np.full((2, 7), 500.0)), [0.5 * np.array(constants)] * 2)
    np.testing.assert_array_equal(own.factor("velocity"), 1.0)


CURRENTS = {"torque_constant": [9.0] * 7, "torque_measured_at": "motor"}
MISTAKES = [
    ({"signals": signals("torque", unit="A")}, "signals.torque.unit|torque_constant"),
    ({"signals": signals("torque", unit="A"), "torque_constant": [9.0] * 7}, "torque_measured_at: motor"),
    ({"signals": signals("torque", unit=["A"] * 6 + ["N m"]), **CURRENTS}, "signals.torque.unit|mixes"),
    ({"torque_constant": [9.0] * 7}, "torque_constant|currents"),
    ({"torque_constant": [9.0] * 6}, "torque_constant|6|7"),
    ({"torque_constant": [0.0] * 7}, "torque_constant|> 0"),
    ({"signals": signals("torque")}, "signals.torque"),
    ({"signals": signals("torque", unit="lbf")}, "signals.torque.unit|'lbf'"),
    ({"signals": signals("torque", unit="rad")}, "signals.torque.unit|N m"),
    ({"motor_inertia": [0.1] * 6}, "motor_inertia|6|7"),
    ({"motor_inertia": [-0.1] * 7}, "motor_inertia|>= 0"),
    ({"low_pass": 0.0}, "low_pass"),
    ({"colour": "red"}, "colour|unknown key"),
    ({"torque_measured_at": "gear"}, "torque_measured_at"),
    ({"signals": signals("position", clock="own")}, "signals.position.clock|signals.position.delay"),
]


@pytest.mark.parametrize(("changes", "words"), MISTAKES, ids=[words for _, words in MISTAKES])
def test_a_wrong_key_of_a_mapping_is_refused(changes: dict, words: str) -> None:
    assert not lacking(refusal(mapping, **changes), "mine.yaml|" + words)


def test_only_signals_with_an_estimated_offset_have_their_own_clock() -> None:
    """Kills: clock: own is accepted for desired positions, whose stamps then stay as they are."""
    assert set(FOUND_BY) | set(OBJECT_SIGNALS) == set(SHIFTED_SIGNALS)
    target = {"column": "d{joint}", "unit": "rad", "clock": "own"}
    assert not lacking(
        refusal(mapping, signals=content()["signals"] | {"q_desired": target}),
        "mine.yaml|signals.q_desired.clock|not estimated|signals.q_desired.delay",
    )
    assert mapping(signals=signals("torque", clock="own")).signals["torque"].clock == "own"


def test_another_number_of_joints_than_the_robot_has_is_refused() -> None:
    with pytest.raises(InputError, match="franka_fer has 7 joints, the mapping names 6"):
        _ = mapping(joints=JOINTS[:6]).facts


def test_an_end_effector_weighs_what_is_stated_and_an_empty_flange_nothing() -> None:
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

    def of_robot(robot: str) -> Mapping:
        (lab / "mapping.yaml").write_text(json.dumps(content(robot=robot)), encoding="utf-8")
        return load_mapping("lab/mapping.yaml")

    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "mine.yaml").write_text("not: facts", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert of_robot("robots/mine.yaml").facts == load_facts("franka_fer")
    with pytest.raises(InputError, match="no robot 'lab/robots/other.yaml'"):
        _ = of_robot("robots/other.yaml").facts
    absolute = str(lab / "robots" / "mine.yaml")
    assert of_robot(absolute).robot == absolute


def rail_under_the_first_joint(folder: Path) -> dict:
    """A mapping of a FER whose first joint slides."""
    data = load_facts("franka_fer").model_dump()
    data["joints"][0]["type"] = "prismatic"
    (folder / "rail.yaml").write_text(json.dumps(RobotFacts.model_validate(data).model_dump(mode="json")))
    units = {"position": ["mm"] + 6 * ["deg"], "velocity": ["m/s"] + 6 * ["rad/s"], "torque": ["N"] + 6 * ["mN m"]}
    columns = {name: {"column": f"{name}{{joint}}", "unit": unit} for name, unit in units.items()}
    return content(robot=str(folder / "rail.yaml"), signals=columns)


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
        (["m", *5 * ["rad"], "mm"], "signals.position.unit = 'mm': joint 7 of .* turns, expected rad or mrad or deg"),
        (["m", "rad"], "signals.position.unit lists 2 units, expected one or 7, one per joint"),
        (["m"] + 6 * ["turns"], "signals.position.unit is 'turns', expected one of"),
    ],
)
def test_a_unit_of_another_kind_of_joint_is_refused(tmp_path: Path, unit: object, complaint: str) -> None:
    data = rail_under_the_first_joint(tmp_path)
    data["signals"]["position"]["unit"] = unit
    with pytest.raises(InputError, match=complaint):
        _ = validate(Mapping, data, "mine.yaml").facts


def ball(**keys: object) -> Mapping:
    source = {"columns": ["px", "py"], "unit": "mm", **keys}
    return mapping(robot="none", joints=[], signals={"object_position": source})


def test_two_columns_of_a_position_lie_in_the_plane_of_a_camera_and_have_a_factor_each() -> None:
    """Kills a width of three alone, and factors without columns."""
    np.testing.assert_allclose(ball(factor=[2.0, -2.0]).to_si("object_position", np.ones((1, 2))), [[2e-3, 0.0, -2e-3]])
    np.testing.assert_allclose(ball(columns=["x", "y", "z"]).to_si("object_position", np.ones((1, 3))), [[1e-3] * 3])


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ({"columns": ["px", "py", "pz", "q"]}, "signals.object_position.columns lists 4 columns, expected 3"),
        ({"factor": [1.0, 1.0, 1.0]}, "signals.object_position.factor lists 3 numbers, expected one"),
        ({"unit": ["mm", "mm"]}, "signals.object_position.unit lists 2 units, expected one"),
        (
            {"columns": None, "column": "p", "entries": [1, 2]},
            "signals.object_position.entries lists 2 numbers, expected 3",
        ),
    ],
)
def test_another_number_of_columns_factors_or_entries_is_refused(keys: dict, complaint: str) -> None:
    """Kills entries in a plane, which only columns may lie in, and a list for what is one for all columns."""
    with pytest.raises(InputError, match=complaint):
        ball(**keys)


@pytest.mark.parametrize("name", mapping_names())
def test_every_shipped_mapping_loads_and_fits_its_robot(name: str) -> None:
    loaded = load_mapping(name)
    assert loaded.facts.joint_count == len(loaded.joints)


def test_a_slip_of_the_pen_in_the_name_is_answered_with_the_name_meant(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'joint_state'"):
        load_mapping("joint_sate")
    with pytest.raises(InputError, match="none.yaml"):
        load_mapping(tmp_path / "none.yaml")
