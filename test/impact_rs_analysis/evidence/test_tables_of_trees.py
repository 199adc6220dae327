# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts of a robot that floats, has two arms, and joints that follow others.

The truth is computed in maximal coordinates (every body free, every joint a constraint): a smooth ball that a round pad
hits takes L = (1 + e) c / (1 / m + n^T W n) along the line of their centres, with the robot's response W.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from impact_table_cases import POSE, write_csv
from intervals import assert_covers
from trees import RADIUS, hands_scenario, scenario_of, struck, tree_facts, with_tool

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_cli.main import main
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.measured import MeasuredImpact, points_of_scene, solve_measured
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import RobotFacts
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.schema import validate
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table
from impact_rs_trials.recordings.mapping import load_mapping

NOMINAL = load_model(Path("nominal"))
CONSIDERED = ["restitution", "motor_inertia_scale", "object_mass", "end_effector_payload"]
MASS, BALL, RESTITUTION = 0.8, 0.1, 0.4  # kg and m, mass and radius of the ball; its restitution
NOISE = 0.003  # m/s or rad/s, of every velocity
BASE = [
    *(f"base_{name} [{unit}]" for name, unit in zip(("x", "y", "z", "qx", "qy", "qz", "qw"), "mmm----", strict=True))
]


def facts_of(floating: bool) -> dict[str, Any]:
    """Two arms on a torso; the second joint of the right one follows the first, and nothing drives the joints."""
    facts = tree_facts(floating)
    hand = {"xyz": (0.3, 0, 0), "rpy": (0.4, 0, 0), "name": "right_2", "mimic": {"joint": "right", "ratio": -0.7}}
    facts["joints"].append(hand)
    facts["links"].append({**facts["links"][0], "name": "right_hand", "mass": 1.0})
    return facts


def scenario(floating: bool) -> dict[str, Any]:
    ball = {"ball": {"label": "ball", "mass": MASS, "size": [2.0 * BALL] * 3, "shape": "sphere"}}
    still = {"contact__friction": 0.0, "contact__restitution": RESTITUTION, "support__height": -50.0}
    data = scenario_of(facts_of(floating), ball, [0.3, -0.3, 0.2], **still)
    data["robots"]["robot"]["drive"]["motor_inertia_rotor"] = [1e-9] * 3
    return data


def header(floating: bool) -> list[str]:
    kinds = [(f"{kind}{axis}", unit) for kind, unit in (("v", "m/s"), ("w", "rad/s")) for axis in "xyz"]
    found = ["condition", *(BASE if floating else []), *(f"q{joint} [rad]" for joint in (1, 2, 3))]
    for when in ("before", "after"):
        found += [f"base_{name}_{when} [{unit}]" for name, unit in kinds if floating]
        found += [f"dq{joint}_{when} [rad/s]" for joint in (1, 2, 3)]
    twists = [f"{name}_{when} [{unit}]" for when in ("before", "after") for name, unit in kinds]
    return [*found, *POSE, *twists, "dq_noise [rad/s]", "v_noise [m/s]", "w_noise [rad/s]"]


def hit(
    data: dict[str, Any], rng: np.random.Generator, kind: int, mass: float = MASS, payload: float = 0.0
) -> list[object]:
    """A row of condition ``kind``: the robot anywhere, and a ball that comes from where the pad looks.

    The truth has a ball of ``mass``, and a ``payload`` 4 cm behind the pad with a radius of gyration of 5 cm [kg].
    """
    physics = Physics.nominal(validate(Scenario, data, "mine.yaml"), "ball")
    model = physics.robot_model("robot")
    floats = model.facts.base_size > 0
    own = np.random.default_rng(kind)  # what the rows of a condition share
    pose = np.concatenate((own.uniform(-1.0, 1.0, 3), own.standard_normal(4)))[: 7 if floats else 0]
    pose[3:] /= np.linalg.norm(pose[3:]) if floats else 1.0
    q = np.concatenate((pose, own.uniform(-1.0, 1.0, 3) + rng.normal(0.0, 0.02, 3)))
    tip = model.placement(q)
    centre = tip.translation - RADIUS * tip.rotation[:, 2]
    normal = tip.rotation @ pin.exp3(own.uniform(-0.5, 0.5, 3))[:, 2]
    place = centre + (RADIUS + BALL) * normal
    velocity = 0.3 * own.standard_normal(model.joint_count)
    contact = place - BALL * normal
    wrench = np.concatenate((normal, np.cross(contact - tip.translation, normal)))
    body = np.array([payload, 0.0, 0.0, -0.04, 0.05])
    truth = library()["end_effector_payload"].apply_vector(physics, body)
    of_twist, of_velocity = struck(with_tool(truth.robot_model("robot")), q, tip)
    twist = np.zeros(6)
    coming = wrench @ model.jacobian(q) @ velocity
    twist[:3] = (coming - rng.uniform(0.8, 1.4)) * normal + 0.1 * own.standard_normal(3)
    closing = coming - normal @ twist[:3]
    impulse = (1.0 + RESTITUTION) * closing / (1.0 / mass + wrench @ of_twist @ wrench)
    after = velocity - of_velocity @ wrench * impulse
    thrown = twist + np.concatenate((impulse / mass * normal, np.zeros(3)))
    after, thrown = (one + rng.normal(0.0, NOISE, one.size) for one in (after, thrown))
    turn = pin.Quaternion(pin.exp3(own.standard_normal(3))).coeffs()
    return [f"c{kind}", *q, *velocity, *after, *place, *turn, *twist, *thrown, NOISE, NOISE, NOISE]


def source_of(folder: Path, floating: bool, rigid: bool = True, **truth: float) -> ImpactTableSource:
    """Evidence of 18 hits; ``rigid``: of a robot that is known to have no elastic drives."""
    rng, data = np.random.default_rng(17), scenario(floating)
    rows = [hit(data, rng, kind, **truth) for kind in range(6) for _ in range(3)]
    table = read_impact_table(
        write_csv(folder / "hits.csv", header(floating), rows), validate(Scenario, data, "mine.yaml")
    )
    return ImpactTableSource(table, NOMINAL, discrepancy=NO_MAP_DISCREPANCY if rigid else None)


@pytest.mark.parametrize(
    ("floating", "rigid", "truth", "half_width"),
    [
        pytest.param(True, True, 1.25, 0.006, marks=pytest.mark.slow),
        (False, True, 1.25, 0.007),
        (True, False, 1.6, 0.17),
        pytest.param(False, False, 1.6, 0.16, marks=pytest.mark.slow),
    ],
)
def test_the_mass_of_a_ball_is_named_in_a_table_of_a_tree(
    tmp_path: Path, floating: bool, rigid: bool, truth: float, half_width: float
) -> None:
    source = source_of(tmp_path, floating, rigid, mass=truth * MASS)
    signals = [feature.index for feature in source.clusters[0].features]
    assert ("base_wz" in signals) == floating and "joint3" in signals and "joint4" not in signals
    document = diagnose(source, NOMINAL, CONSIDERED)
    assert document.named == ("object_mass",)
    assert_covers(document.effect("object_mass").parameters["scale"].interval, truth, half_width)


def test_a_body_on_the_hand_of_a_floating_robot_is_named_with_its_mass(tmp_path: Path) -> None:
    document = diagnose(source_of(tmp_path, True, payload=0.6), NOMINAL, CONSIDERED)
    assert document.named == ("end_effector_payload",)
    found = document.effect("end_effector_payload").parameters
    assert_covers(found["mass"].interval, 0.6, 0.017)
    assert_covers(found["com_z"].interval, -0.04, 0.01)


@pytest.mark.parametrize("floating", [True, False])
def test_nothing_is_named_in_a_table_of_a_tree_without_a_hidden_effect(tmp_path: Path, floating: bool) -> None:
    document = diagnose(source_of(tmp_path, floating), NOMINAL, CONSIDERED)
    assert document.named == ()
    assert document.verdict.kind == "NOTHING-MISSING"


def hit_of_hands(rng: np.random.Generator, kind: int, mass: float) -> list[object]:
    """A row of a box between two hands of a mounted torso; the truth has a box of ``mass`` times its own."""
    physics = Physics.nominal(validate(Scenario, scenario_of_hands(), "mine.yaml"), "box")
    model, own = physics.robot_model("robot"), np.random.default_rng(kind)
    q = rng.normal(0.0, 0.01, 3)
    velocity = np.array([0.0, -1.0, 1.0]) * own.uniform(0.8, 1.8, 3) + own.uniform(-0.3, 0.3) * np.eye(3)[0]
    body = BodyState(np.array([0.3, 0.0, 1.0]), np.eye(3), np.concatenate((own.uniform(-0.2, 0.2, 3), np.zeros(3))))
    arms = {"robot": ArmState(q, velocity)}
    impact = MeasuredImpact(arms, body, points_of_scene(physics, arms, body, {"robot": model}))
    assert [point.partner for point in impact.points] == ["robot", "right"]
    truth = replace(physics, object=replace(physics.object, mass=mass * physics.object.mass))
    after = solve_measured(truth, impact)[0] + rng.normal(0.0, NOISE, 9)
    return [f"c{kind}", *q, *velocity, *after[:3], *body.position, 0, 0, 0, 1, *body.twist, *after[3:], *[NOISE] * 3]


def scenario_of_hands() -> dict[str, Any]:
    data = hands_scenario(round_pads=True)
    data["support"]["height"] = -50.0
    return data


def test_the_mass_of_a_box_between_two_hands_is_named_in_a_table(tmp_path: Path) -> None:
    """No column more than of one hand: the geometry finds the points of both. Kills: the other hand left out."""
    rng = np.random.default_rng(5)
    rows = [hit_of_hands(rng, kind, 1.25) for kind in range(6) for _ in range(3)]
    path = write_csv(tmp_path / "hits.csv", header(False), rows)
    table = read_impact_table(path, validate(Scenario, scenario_of_hands(), "mine.yaml"))
    document = diagnose(ImpactTableSource(table, NOMINAL, discrepancy=NO_MAP_DISCREPANCY), NOMINAL, CONSIDERED)
    assert document.named == ("object_mass",)
    assert_covers(document.effect("object_mass").parameters["scale"].interval, 1.25, 0.13)


def test_answers_to_a_table_have_the_columns_of_the_base(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``map --table`` predicts every row as the maximal coordinates do, up to the noise that stands in the table."""
    data = json.loads(json.dumps(scenario(True)))
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    rng = np.random.default_rng(17)
    rows = [hit(data, rng, kind) for kind in range(3)]
    names = header(True)
    table = write_csv(tmp_path / "hits.csv", names, rows)
    command = ["map", str(tmp_path / "mine.yaml"), "--table", str(table), "-o", str(tmp_path / "answers.csv")]
    assert main(command) == 0
    found = (tmp_path / "answers.csv").read_text(encoding="utf-8").splitlines()
    columns = found[0].split(",")
    for text, row in zip(found[1:], rows, strict=True):
        answer = dict(zip(columns, text.split(","), strict=True))
        for name in (*(f"base_{kind}_after" for kind in ("vx", "vy", "wz")), "dq3_after", "vx_after"):
            (column,) = [one for one in names if one.startswith(f"{name} ")]
            assert float(answer[column]) == pytest.approx(float(row[names.index(column)]), abs=5.0 * NOISE), name


@pytest.mark.parametrize(
    ("drop", "value", "message"),
    [
        ("base_vx_before [m/s]", None, r"no column 'base_vx_before \[m/s\]'"),
        ("base_qw [-]", 7.0, "row 1, length of .base_qx, base_qy, base_qz, base_qw.*expected a unit quaternion"),
        ("base_wz_after [rad/s]", None, r"no column 'base_wz_after \[rad/s\]'"),
    ],
)
def test_a_base_that_a_table_does_not_say_is_refused(
    tmp_path: Path, drop: str, value: float | None, message: str
) -> None:
    data, names = scenario(True), header(True)
    row = hit(data, np.random.default_rng(1), 0)
    place = names.index(drop)
    if value is None:
        names, row = names[:place] + names[place + 1 :], row[:place] + row[place + 1 :]
    else:
        row[place] = value
    table = write_csv(tmp_path / "hits.csv", names, [row])
    with pytest.raises(InputError, match=message):
        read_impact_table(table, validate(Scenario, data, "mine.yaml"))


def test_a_base_that_floats_in_the_table_alone_is_refused(tmp_path: Path) -> None:
    """The scenario's robot is mounted; its file lacks ``floating_base``."""
    row = hit(scenario(True), np.random.default_rng(1), 0)
    table = write_csv(tmp_path / "hits.csv", header(True), [row])
    said = r"column 'base_x \[m\]' belongs to no joint or floating base of scenario 'push' \(robot has 3\)"
    with pytest.raises(InputError, match=said):
        read_impact_table(table, validate(Scenario, scenario(False), "mine.yaml"))


@pytest.mark.parametrize("floating", [True, False])
def test_a_recording_of_a_tree_is_refused_with_what_takes_it(tmp_path: Path, floating: bool) -> None:
    facts = RobotFacts.model_validate(facts_of(floating))
    (tmp_path / "robot.yaml").write_text(json.dumps(facts.model_dump(mode="json")), encoding="utf-8")
    content = {
        "description": "by hand",
        "robot": "robot.yaml",
        "joints": ["a", "b", "c"],
        "signals": {"position": {"array": "q", "unit": "rad"}, "torque": {"array": "tau", "unit": "N m"}},
    }
    (tmp_path / "mapping.yaml").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match="robot: a recording takes serial arms.*tables of impacts take it"):
        _ = load_mapping(tmp_path / "mapping.yaml").facts
