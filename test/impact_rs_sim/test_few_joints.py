# SPDX-License-Identifier: Apache-2.0
"""Arms that cannot hold a pose: joints at impact are given, and the impact map is that of the closed form."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml

from impact_rs_cli.main import main
from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.impact_map import ImpactProblem, predict_impact
from impact_rs_sim.impact_map.uniqueness import uniqueness_of
from impact_rs_sim.paths import config_directory
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.schema import validate

PUSH = yaml.safe_load((config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8"))
MASS, LENGTH, OWN = 2.0, 0.35, 0.01  # kg, m, kg m^2 of every link, with its centre in its middle
MOTOR = 0.3  # kg m^2, B_theta
TIP = 0.04  # m, of the end effector

Data = dict[str, Any]


def facts(count: int, upright: bool) -> Data:
    """Links of one kind in the plane x-y, or ``upright`` in the plane x-z, stretched along x at q = 0."""
    first = (np.pi / 2.0, 0.0, 0.0) if upright else (0.0, 0.0, 0.0)
    origins = [
        {"xyz": (LENGTH if joint else 0.0, 0, 0), "rpy": (0, 0, 0) if joint else first} for joint in range(count)
    ]
    link = {"mass": MASS, "com": (LENGTH / 2.0, 0.0, 0.0), "inertia": (OWN, 0, 0, OWN, 0, OWN)}
    limits = {"position_min_rad": -3.0, "position_max_rad": 3.0, "velocity_rad_s": 6.0, "torque_Nm": 80.0}
    return {
        "source": "by hand",
        "joints": origins,
        "flange": {"xyz": (LENGTH, 0, 0), "rpy": (0, np.pi / 2.0, 0)},
        "limits": {name: [value] * count for name, value in limits.items()},
        "links": [link] * count,
    }


def scenario(count: int, position: tuple[float, ...], velocity: tuple[float, ...], **others: Any) -> Data:
    """The scenario push with such an arm, a metre above the ground; ``others`` by dotted key."""
    data: Data = json.loads(json.dumps(PUSH))
    robot = data["robots"]["arm"]
    robot["facts"] = facts(count, others.pop("upright", False))
    robot["base"] = {"position": [0.0, 0.0, 1.0]}
    robot["end_effector"] |= {"mass": 1e-9, "com": [0, 0, 0], "inertia": [1e-12] * 3, "length": TIP, "mount_yaw": 0.0}
    robot["drive"] = {
        "motor_inertia_rotor": [0.6] * count,
        "motor_inertia_reduced": [MOTOR] * count,
        "stiffness": [1e4] * count,
        "damping": [10.0] * count,
    }
    robot["impact"] = {"joint_position": list(position)}
    data["support"]["height"] = 1.0 - data["objects"]["cat_food"]["size"][2] / 2.0
    data["cases"] = {"case_1": {"label": "one", "robots": {"arm": {"ante_velocity": list(velocity)}}}}
    for key, value in others.items():
        *above, last = key.split(".")
        place = data
        for part in above:
            place = place[part]
        place[last] = value
    return data


def scene_of(data: Data) -> Scene:
    return Scene.resolve(validate(Scenario, data, "mine.yaml"), "cat_food", "case_1")


POINT = 2e-4  # m, a pad so small that it touches in a point: a face that turns with its arm hits with an edge
SMOOTH = {
    "contact.friction": 0.0,
    "support.friction": 0.0,
    "contact.restitution": 0.0,
    "robots.arm.end_effector.pad": {"size": [POINT, POINT, 0.005]},
}


@pytest.mark.parametrize("engine", ["exact", "bullet"])
def test_a_pendulum_hits_with_its_inertia_over_the_square_of_its_length(engine: str) -> None:
    """v^+ = m_eff v^- / (m_eff + m_box) with m_eff = (I + m c^2 + B) / l^2, c to the centre and l to the pad.

    It hangs from a horizontal axis and swings along x; the pad looks along the arm's y at its tip.
    """
    data = scenario(1, (-np.pi / 2.0,), (0.5, 0.0, 0.0), upright=True, **SMOOTH)
    arm = data["robots"]["arm"]["facts"]
    arm["flange"] = {"xyz": (LENGTH, 0.0, 0.0), "rpy": (-np.pi / 2.0, 0.0, 0.0)}  # +y of the link is +x of A there
    data["robots"]["arm"]["end_effector"]["length"] = 1e-9
    data["support"]["height"] = 1.0 - LENGTH - data["objects"]["cat_food"]["size"][2] / 2.0
    scene = scene_of(data)
    assert scene.arms["arm"].velocity == pytest.approx([0.5 / LENGTH])
    inertia = OWN + MASS * (LENGTH / 2.0) ** 2 + MOTOR
    effective = inertia / LENGTH**2
    np.testing.assert_allclose(scene.object.rotation, np.eye(3), atol=1e-9)
    result = predict_impact(ImpactProblem.at_nominal_impact(scene), engine=engine)
    wanted = effective * 0.5 / (effective + scene.physics.object.mass)
    assert result.joint_velocity["arm"] == pytest.approx([wanted / LENGTH], rel=POINT / LENGTH)
    assert result.object_twist[0] == pytest.approx(wanted, rel=POINT / LENGTH)


def effective_mass(scene: Scene) -> float:
    """Of the arm along its pad's normal, with B_theta."""
    model, q = scene.models["arm"], scene.arms["arm"].position
    normal = model.placement(q).rotation[:, 2]
    return model.effective_mass(q, normal, scene.physics.arms["arm"].motor_inertia_reduced)


@pytest.mark.parametrize(
    ("position", "upright"),
    [((0.4, -1.1, 0.9), False), ((0.6, 1.0), False), ((0.5, -1.2, 0.7), True), ((0.9, -0.9), True)],
)
def test_few_joints_push_a_smooth_box_by_their_effective_mass(position: tuple[float, ...], upright: bool) -> None:
    """In the middle of its face: v_n^+ of the box is m_eff v_n^- / (m_eff + m_box), whatever the arm does across."""
    heading = np.array([0.0, 0.0, sum(position)]) if not upright else np.array([0.0, -sum(position), 0.0])
    normal = pin.exp3(heading)[:, 0]
    data = scenario(len(position), position, tuple(0.4 * normal), upright=upright, **SMOOTH)
    pad = scene_pad(data)
    data["support"]["height"] = float(pad.translation[2]) - data["objects"]["cat_food"]["size"][2] / 2.0
    scene = scene_of(data)
    result = {name: predict_impact(ImpactProblem.at_nominal_impact(scene), engine=name) for name in ENGINES}
    mass = effective_mass(scene)
    wanted = mass * 0.4 / (mass + scene.physics.object.mass)
    for engine, found in result.items():
        assert found.object_twist[:3] @ normal == pytest.approx(wanted, rel=POINT / LENGTH), engine
    for name in ("joint_velocity", "end_effector_twist"):
        first, second = (getattr(found, name)["arm"] for found in result.values())
        np.testing.assert_allclose(first, second, atol=1e-3)


ENGINES = ("exact", "bullet")


def scene_pad(data: Data) -> pin.SE3:
    return validate(Scenario, data, "mine.yaml").robots["arm"].impact_placement


def test_the_object_stands_square_before_the_pad_wherever_that_looks() -> None:
    scene = scene_of(scenario(3, (0.4, -1.1, 0.9 + 0.3), (0.2, 0.1, 0.0)))
    pad = scene.models["arm"].placement(scene.arms["arm"].position)
    normal, size = pad.rotation[:, 2], scene.physics.object.size
    np.testing.assert_allclose(np.sort(np.abs(normal @ scene.object.rotation))[:2], 0.0, atol=1e-9)
    along = int(np.argmax(np.abs(normal @ scene.object.rotation)))
    assert (scene.object.position - pad.translation) @ normal == pytest.approx(size[along] / 2.0)
    assert np.linalg.norm((scene.object.position - pad.translation)[:2] @ np.array([-normal[1], normal[0]])) < 1e-9
    assert abs(pin.log3(scene.object.rotation)[2]) <= np.pi / 4.0


def test_a_pad_that_looks_a_little_up_touches_with_its_edge_and_no_deeper() -> None:
    for tilt in (-0.02, 0.02):
        data = scenario(2, (0.9, -0.9 + tilt), (0.3, 0.0, 0.0), upright=True)
        data["support"]["height"] = float(scene_pad(data).translation[2]) - 0.05
        problem = ImpactProblem.at_nominal_impact(scene_of(data))
        contacts = [one for one in predict_impact(problem).contacts if one.body_b == "arm"]
        assert contacts and min(abs(one.gap) for one in contacts) < 1e-6


def test_given_joints_turn_the_pad_as_little_as_they_can() -> None:
    """Three joints in a plane leave it as it is; of two, what they must turn follows from the velocity."""
    planar = scene_of(scenario(3, (0.4, -1.1, 0.9), (0.2, 0.1, 0.0)))
    twist = planar.models["arm"].jacobian(planar.arms["arm"].position) @ planar.arms["arm"].velocity
    np.testing.assert_allclose(twist, [0.2, 0.1, 0, 0, 0, 0], atol=1e-9)
    two = scene_of(scenario(2, (0.6, 1.0), (0.2, 0.1, 0.0)))
    twist = two.models["arm"].jacobian(two.arms["arm"].position) @ two.arms["arm"].velocity
    np.testing.assert_allclose(twist[:3], [0.2, 0.1, 0], atol=1e-9)
    assert abs(twist[5]) > 0.1


def test_friction_and_intervals_are_answered_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The whole command, on a file with facts beside it."""
    data = scenario(3, (0.4, -1.1, 0.9), (0.2, 0.1, 0.0))
    (tmp_path / "planar.yaml").write_text(json.dumps(data["robots"]["arm"]["facts"]))
    data["robots"]["arm"]["facts"] = "planar.yaml"
    (tmp_path / "mine.yaml").write_text(json.dumps(data))
    arguments = ["map", str(tmp_path / "mine.yaml"), "cat_food", "1", "--json"]
    for more in ([], ["--uncertainty"], ["--derivatives"], ["--contact", "settled"], ["--engine", "bullet"]):
        assert main([*arguments, *more]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["residual"]["momentum"] < 1e-4
        assert len(found["post"]["joint_velocity"]["arm"]) == 3
    scene = scene_of(scenario(3, (0.4, -1.1, 0.9), (0.2, 0.1, 0.0)))
    assert uniqueness_of(ImpactProblem.at_nominal_impact(scene)).answers >= 1


def test_a_scenario_with_given_joints_travels_as_text() -> None:
    own = validate(Scenario, scenario(2, (0.6, 1.0), (0.2, 0.1, 0.0)), "mine.yaml")
    assert Scenario.model_validate_json(own.model_dump_json()) == own
    assert set(own.model_dump()["robots"]["arm"]["impact"]) == {"joint_position"}
    pose = validate(Scenario, PUSH, "push.yaml").model_dump()["robots"]["arm"]["impact"]
    assert set(pose) == {"position", "pad_normal", "pad_up", "joint_guess"}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("robots.arm.impact", {}, "mine.yaml: robots.arm.impact: expected joint_position, or position, pad_normal"),
        (
            "robots.arm.impact",
            {"joint_position": [0.4, -1.1, 0.9], "pad_up": [0, 0, 1]},
            "mine.yaml: robots.arm.impact: joint_position stands beside pad_up, expected one of both",
        ),
        (
            "robots.arm.impact",
            {"joint_position": [0.4, -1.1]},
            r"robots.arm: impact.joint_position must have one entry per joint \(3\) \[rad\]",
        ),
        ("object_position", [0.4, 0.2], "robots.arm.impact.joint_position says where the object stands"),
        (
            "cases.case_1.robots.arm",
            {"ante_velocity": [0.2, 0.1, 0.0], "joint_1": 0.4},
            "robots.arm.impact.joint_position holds every joint: leave joint_1 and posture out of cases.case_1",
        ),
    ],
)
def test_a_slip_of_the_pen_is_told_with_its_key(key: str, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as told:
        validate(Scenario, scenario(3, (0.4, -1.1, 0.9), (0.2, 0.1, 0.0), **{key: value}), "mine.yaml")
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("data", "kind", "message"),
    [
        (
            scenario(2, (0.6, 1.0), (0.0, 0.0, 0.3)),
            Infeasible,
            r"robots.arm.impact of scenario 'push': ante_velocity .* is beyond these joints there: .* off by 0.3 m/s",
        ),
        (scenario(2, (3.1, 1.0), (0.2, 0.1, 0.0)), Infeasible, r"joint 1 at 3.1 rad is outside its limits \[-3, 3\]"),
        (
            scenario(2, (0.9, -0.2), (0.2, 0.0, 0.0), upright=True),
            InputError,
            "robots.arm.impact.joint_position: the pad looks up there, by 40 degrees; .* expected at most 18",
        ),
        (
            scenario(3, (0.4, -1.1, 0.9), (0.2, 0.1, 0.0), **{"support.height": 0.2}),
            InputError,
            r"joint_position: the pad is at z = 1 m there, the object stands from 0.2 to .* expected another support",
        ),
    ],
)
def test_joints_that_hit_nothing_are_told(data: Data, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message) as told:
        scene_of(data)
    assert "\n" not in str(told.value)


def test_a_campaign_with_such_an_arm_is_refused_before_it_begins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, folder = tmp_path / "mine.yaml", tmp_path / "trials"
    file.write_text(json.dumps(scenario(3, (0.4, -1.1, 0.9), (0.2, 0.1, 0.0))), encoding="utf-8")
    assert main(["campaign", str(file), "-o", str(folder), "--objects", "cat_food", "--trials", "1"]) == 2
    told = capsys.readouterr().err
    assert "robots.arm: the arm has 3 joints" in told and len(told.splitlines()) == 1
    assert not folder.exists()
