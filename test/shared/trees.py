# SPDX-License-Identifier: Apache-2.0
"""Robots that are trees: URDFs, random facts, scenarios, and impacts of them in space."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from impact_rs_sim.impact_map import ImpactProblem
from impact_rs_sim.impact_map.contacts import contact_pairs
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.schema import validate

PUSH = yaml.safe_load((config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8"))
LIMITS = {"position_min_rad": -3.0, "position_max_rad": 3.0, "velocity_rad_s": 9.0, "torque_Nm": 90.0}
TREE_LINK = {"mass": 2.0, "com": (0.1, 0.0, 0.02), "inertia": (0.01, 0.0, 0.0, 0.03, 0.0, 0.03)}
RADIUS = 0.03  # m, of the round pad
DRIVE = {"type": "rigid", "stiffness": 1e4, "damping": 10.0, "motor_inertia_rotor": 0.05}

_BODY = (
    '<inertial><origin xyz="{0} 0.01 0.02"/><mass value="{1}"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="0.003" izz="0.025"/></inertial>'
)


def _link(name: str, mass: float, reach: float = 0.1) -> str:
    return f'<link name="{name}">{_BODY.format(reach, mass)}</link>'


def _joint(ends: str, xyz: str, axis: str = "0 0 1", kind: str = "revolute", more: str = "") -> str:
    """A joint, by its name, the link that carries it and the link that it carries."""
    name, parent, child = ends.split()
    limit = '<limit lower="-2" upper="2" velocity="3" effort="40"/>'
    if kind == "prismatic":
        limit = '<limit lower="0.01" upper="0.5" velocity="3" effort="40"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="0.2 -0.1 0.3"/><axis xyz="{axis}"/>{limit if kind != "fixed" else ""}{more}</joint>'
    )


_FOLLOWS = '<mimic joint="left_finger_1" multiplier="-0.8" offset="0"/>'
DUAL_ARM = "".join(
    (
        '<robot name="dual"><link name="base"/>',
        _link("torso", 8.0),
        *(
            _link(f"{side}_{part}", mass)
            for side in ("left", "right")
            for part, mass in (("upper", 3.0), ("hand", 1.5))
        ),
        _link("left_finger_1_link", 0.4, 0.05),
        _link("left_finger_2_link", 0.4, 0.05),
        '<link name="left_hand_pad"/>',
        _joint("waist base torso", "0 0 0.4"),
        _joint("left_1 torso left_upper", "0 0.2 0.3", "0 1 0"),
        _joint("left_2 left_upper left_hand", "0.3 0 0", "1 0 1"),
        _joint("left_finger_2 left_hand left_finger_2_link", "0.1 -0.03 0", "0 1 0", "prismatic", _FOLLOWS),
        _joint("left_finger_1 left_hand left_finger_1_link", "0.1 0.03 0", "0 1 0", "prismatic"),
        _joint("left_mount left_hand left_hand_pad", "0.15 0 0", kind="fixed"),
        _joint("right_1 torso right_upper", "0 -0.2 0.3", "0 1 0"),
        _joint("right_2 right_upper right_hand", "0.3 0 0", "1 0 1"),
        "</robot>",
    )
)  # a torso, two arms, and on the left hand two fingers of which the second follows the first, and stands before it
PANDA_FINGERS = "".join(
    (
        '<robot name="hand"><link name="base"/>',
        _link("hand", 0.73),
        '<link name="hand_tcp"/>',
        _link("finger_1_link", 0.015, 0.01),
        _link("finger_2_link", 0.015, 0.01),
        _joint("wrist base hand", "0 0 0.2"),
        _joint("tcp hand hand_tcp", "0 0 0.1034", kind="fixed"),
        _joint("finger_1 hand finger_1_link", "0 0 0.0584", "0 1 0", "revolute"),
        _joint("finger_2 hand finger_2_link", "0 0 0.0584", "0 -1 0", "revolute", '<mimic joint="finger_1"/>'),
        "</robot>",
    )
)


def robot_of(weight: float = 0.4) -> EndEffector:
    """A round pad of some weight [kg]."""
    inertia = weight * 1e-3 * np.eye(3)
    return EndEffector(weight, np.array([0.0, 0.0, -0.02]), inertia, 0.05, 0.0, (0.01, 0.01, 0.01))


def random_body(rng: np.random.Generator) -> dict[str, Any]:
    """A body of six random points."""
    points = rng.standard_normal((6, 3)) * 0.1
    off = points - points.mean(axis=0)
    inertia = sum(np.dot(p, p) * np.eye(3) - np.outer(p, p) for p in off) + 1e-4 * np.eye(3)
    entries = tuple(float(value) for value in np.asarray(inertia)[np.triu_indices(3)])
    return {"mass": float(rng.uniform(0.5, 4.0)), "com": tuple(rng.uniform(-0.1, 0.1, 3)), "inertia": entries}


def random_facts(rng: np.random.Generator, count: int, floating: bool, mimics: float = 0.25) -> dict[str, Any]:
    """A tree of ``count`` links with a share of joints that follow others, in depth-first order."""
    joints: list[dict[str, Any]] = []
    branch, leaders = [0], []
    for number in range(1, count + 1):
        keep = int(rng.integers(1, len(branch) + 1))
        parent = branch[keep - 1]
        if parent == 0 and not floating and number > 1 and rng.random() < 0.7:
            parent = branch[-1]
            keep = len(branch)
        branch = [*branch[:keep], number]
        joint: dict[str, Any] = {
            "type": "prismatic" if rng.random() < 0.3 else "revolute",
            "xyz": tuple(rng.uniform(-0.3, 0.3, 3)),
            "rpy": tuple(rng.uniform(-3.0, 3.0, 3)),
            "name": f"j{number}",
            "parent": f"link{parent}" if parent else "base",
        }
        if leaders and rng.random() < mimics:
            ratio = float(rng.choice([-1, 1]) * rng.uniform(0.3, 2.0))
            joint["mimic"] = {"joint": str(rng.choice(leaders)), "ratio": ratio, "offset": float(rng.normal())}
        else:
            leaders.append(f"j{number}")
        joints.append(joint)
    carrier = int(rng.integers(0 if floating else 1, count + 1))
    facts: dict[str, Any] = {
        "source": "by chance",
        "joints": joints,
        "flange": {
            "xyz": tuple(rng.uniform(-0.2, 0.2, 3)),
            "rpy": tuple(rng.uniform(-3.0, 3.0, 3)),
            "link": f"link{carrier}" if carrier else "base",
        },
        "limits": {name: [value] * len(leaders) for name, value in LIMITS.items()},
        "links": [random_body(rng) | {"name": f"link{number}"} for number in range(1, count + 1)],
        "joint_torque_loop": False,
    }
    return facts | ({"floating_base": random_body(rng)} if floating else {})


def random_state(rng: np.random.Generator, facts: RobotFacts) -> Array:
    """q of a robot anywhere."""
    joints = rng.uniform(-1.5, 1.5, facts.joint_count)
    pose = np.concatenate((rng.uniform(-1.0, 1.0, 3), rng.standard_normal(4)))
    pose[3:] /= np.linalg.norm(pose[3:])
    return np.concatenate((pose[: 7 if facts.base_size else 0], joints))


def random_tree(
    rng: np.random.Generator, count: int, floating: bool, mimics: float = 0.25
) -> tuple[RobotFacts, RobotModel, Array]:
    """A tree with a weightless pad, and a state of it."""
    facts = RobotFacts.model_validate(random_facts(rng, count, floating, mimics))
    return facts, RobotModel(facts, robot_of(1e-12)), random_state(rng, facts)


def scenario_of(facts: dict[str, Any], object_: dict[str, Any], joints: list[float], **others: Any) -> dict[str, Any]:
    """The scenario push with another robot, called ``robot``, and one object."""
    data: dict[str, Any] = json.loads(json.dumps(PUSH))
    count = len(joints)
    robot = data["robots"].pop("arm")
    pad = others.pop("pad", {"size": [2.0 * RADIUS] * 3, "shape": "sphere"})
    tool = {"mass": 0.4, "com": [0, 0, -0.02], "inertia": [4e-4] * 3, "length": 0.05, "mount_yaw": 0.0, "pad": pad}
    robot |= {
        "facts": facts,
        "base": {"position": [0.0, 0.0, 1.0]},
        "end_effector": tool,
        "drive": {key: value if isinstance(value, str) else [value] * count for key, value in DRIVE.items()},
        "impact": {"joint_position": joints},
    }
    data["robots"] = {"robot": robot}
    data["objects"] = {next(iter(object_)): next(iter(object_.values()))}
    data.pop("object_position", None)
    data["cases"] = {"case_1": {"label": "one", "robots": {"robot": {"ante_velocity": [0.5, 0.0, 0.0]}}}}
    for key, value in others.items():
        section, name = key.split("__")
        data[section][name] = value
    return data


def thrown_at_ball(
    rng: np.random.Generator, facts: dict[str, Any], restitution: float, friction: float = 0.0, fixed: bool = False
) -> tuple[Scene, ImpactProblem]:
    """A robot anywhere in space whose round pad hits a ball that flies, or one that is fixed."""
    ball: dict[str, Any] = {"label": "ball", "size": [0.2, 0.2, 0.2], "shape": "sphere"}
    ball |= {"fixed": True} if fixed else {"mass": 0.8}
    joints = [0.0] * len(facts["limits"]["torque_Nm"])
    data = scenario_of(
        facts,
        {"ball": ball},
        joints,
        contact__friction=friction,
        contact__restitution=restitution,
        support__height=-50.0,
    )
    scenario = validate(Scenario, data, "thrown.yaml")
    physics = Physics.nominal(scenario, "ball")
    model = physics.robot_model("robot")
    q = random_state(rng, model.facts)
    tip = model.placement(q)
    centre = tip.translation - RADIUS * tip.rotation[:, 2]
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    place = centre + (RADIUS + 0.1) * direction
    rotation = pin.exp3(rng.standard_normal(3))
    twist = np.zeros(6) if fixed else rng.standard_normal(6)
    velocity = rng.standard_normal(model.joint_count)
    body = BodyState(place, rotation, twist)
    (pair,) = [one for one in contact_pairs(physics, body, {"robot": tip}) if one.partner == "robot"]
    jacobian = model.jacobian(q)
    lever = place - 0.1 * direction - tip.translation
    closing = direction @ ((jacobian[:3] - pin.skew(lever) @ jacobian[3:]) @ velocity)
    apart = direction @ body.point_velocity(place - 0.1 * direction)
    if closing - apart < 0.2:  # the other way round, and along the line
        row = direction @ (jacobian[:3] - pin.skew(lever) @ jacobian[3:])
        velocity = velocity + row * (apart + 1.0 - closing) / max(float(row @ row), 1e-6)
    assert abs(pair.separation) < 1e-9
    arms = {"robot": ArmState(q, velocity)}
    scene = Scene(scenario, "ball", "case_1", physics, {"robot": model}, arms, body)
    problem = ImpactProblem(
        physics, arms, body, {"robot": np.zeros(model.facts.joint_count)}, restitution, measured=True
    )
    return scene, problem


def tree_facts(floating: bool) -> dict[str, Any]:
    """A torso that turns about z, or floats as well, with two arms in the plane x-y; the left one has the pad."""
    arm = TREE_LINK | {"com": (0.15, 0.0, 0.0)}
    facts: dict[str, Any] = {
        "source": "by hand",
        "joints": [
            {"xyz": (0, 0, 0), "rpy": (0, 0, 0), "name": "waist"},
            {"xyz": (0, 0.2, 0), "rpy": (0, 0, 0), "name": "left"},
            {"xyz": (0, -0.2, 0), "rpy": (0, 0, 0), "name": "right", "parent": "torso"},
        ],
        "flange": {"xyz": (0.3, 0, 0), "rpy": (0, np.pi / 2.0, 0), "link": "left_arm"},
        "limits": {name: [value] * 3 for name, value in LIMITS.items()},
        "links": [TREE_LINK | {"name": "torso", "mass": 6.0}, arm | {"name": "left_arm"}, arm | {"name": "right_arm"}],
        "joint_torque_loop": False,
    }
    return facts | ({"floating_base": TREE_LINK | {"mass": 10.0, "com": (0.0, 0.0, 0.0)}} if floating else {})


def tree_scenario(floating: bool = False, **others: Any) -> dict[str, Any]:
    """That robot before a box that stands a metre above the ground."""
    size = PUSH["objects"]["cat_food"]["size"]
    box = {"box": {"label": "box", "mass": 1.2, "size": size}}
    pad = {"size": [0.04, 0.04, 0.01]}
    height = 1.0 - size[2] / 2.0
    return scenario_of(tree_facts(floating), box, [0.3, -0.3, 0.2], pad=pad, support__height=height, **others)


def free_bodies(facts: RobotFacts, q: Array, tip: pin.SE3) -> tuple[Array, Array, Array, Array]:
    """A robot in maximal coordinates: every body is free, and every joint a constraint.

    Twists are those of the points of every body at the origin of A. Nothing but the placements of the facts and the
    laws of Newton and Euler is used.

    Returns:
        Inertia of the b bodies ``(6 b, 6 b)``, constraints of their twists ``(c, 6 b)``, and the maps of their twists
        to the twist of frame E in E[A] ``(6, 6 b)`` and to v ``(nv, 6 b)``.
    """
    joints = facts.joints_of(q)
    base = pin.XYZQUATToSE3(q[:7]) if facts.base_size else pin.SE3.Identity()
    bodies = [link for link in (facts.floating_base, *facts.links) if link is not None]
    first, places = len(bodies) - len(facts.links), [base]
    rows: list[Array] = []
    along: list[Array] = []
    for number, (joint, parent) in enumerate(zip(facts.joints, facts.parents, strict=True)):
        ratio, offset = (1.0, 0.0) if joint.mimic is None else (joint.mimic.ratio, joint.mimic.offset)
        moved = np.array([0.0, 0.0, ratio * joints[facts.coordinates[number]] + offset])
        before = places[parent] * pin.SE3(pin.rpy.rpyToMatrix(*joint.rpy), np.array(joint.xyz))
        slides = joint.type == "prismatic"
        places.append(before * (pin.SE3(np.eye(3), moved) if slides else pin.SE3(pin.exp3(moved), np.zeros(3))))
        axes = before.toActionMatrixInverse()  # the relative twist in the axes of the joint
        relative = np.zeros((6, 6 * len(bodies)))
        relative[:, 6 * (first + number) : 6 * (first + number) + 6] = axes
        if (carrier := first + parent - 1) >= 0:
            relative[:, 6 * carrier : 6 * carrier + 6] = -axes
        free = 2 if slides else 5
        rows += [row for place, row in enumerate(relative) if place != free]
        along.append(relative[free])
        if joint.mimic is not None:
            rows.append(relative[free] - ratio * along[facts.coordinates.index(facts.coordinates[number])])
    inertia = np.zeros((6 * len(bodies), 6 * len(bodies)))
    for number, (link, place) in enumerate(zip(bodies, places[1 - first :], strict=True)):
        own = pin.Inertia(link.mass, np.array(link.com), link.inertia_matrix)
        inertia[6 * number : 6 * number + 6, 6 * number : 6 * number + 6] = place.act(own).matrix()
    carried, of_base = np.zeros((2, 6, 6 * len(bodies)))
    carrier = 6 * (first + facts.flange_link - 1)
    carried[:, carrier : carrier + 6] = pin.SE3(np.eye(3), tip.translation).toActionMatrixInverse()
    of_base[:, :6] = base.toActionMatrixInverse()
    leaders = [row for row, joint in zip(along, facts.joints, strict=True) if joint.mimic is None]
    velocity = np.array([*of_base[: facts.base_size], *leaders])
    return inertia, np.array(rows).reshape(-1, len(inertia)), carried, velocity


def struck(facts: RobotFacts, q: Array, tip: pin.SE3) -> tuple[Array, Array]:
    """Changes of the twist of E ``(6, 6)`` and of v ``(nv, 6)`` by an impulsive wrench on E, in E[A].

    From the laws of all bodies with the impulses of their joints as multipliers (KKT).
    """
    inertia, rows, carried, velocity = free_bodies(facts, q, tip)
    whole = np.block([[inertia, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    moved = np.linalg.lstsq(whole, np.vstack((carried.T, np.zeros((len(rows), 6)))), rcond=None)[0][: len(inertia)]
    return carried @ moved, velocity @ moved


def with_tool(model: RobotModel) -> RobotFacts:
    """The robot with its end effector part of the link with the flange."""
    facts, place = model.facts, model.pinocchio.frames[model.pinocchio.getFrameId("end_effector")]
    body = model.pinocchio.inertias[place.parentJoint]
    inertia = tuple(body.inertia[np.triu_indices(3)].tolist())
    link = {"mass": float(body.mass), "com": tuple(body.lever.tolist()), "inertia": inertia}
    if not facts.flange_link:
        assert facts.floating_base is not None
        return facts.model_copy(update={"floating_base": facts.floating_base.model_copy(update=link)})
    links = list(facts.links)
    links[facts.flange_link - 1] = links[facts.flange_link - 1].model_copy(update=link)
    return facts.model_copy(update={"links": tuple(links)})


def hands_scenario(
    floating: bool = False,
    left: tuple[float, ...] | list[float] = (0.0, -0.5, 0.0),
    right: tuple[float, ...] | list[float] = (0.0, 0.5, 0.0),
    friction: float = 0.0,
    round_pads: bool = False,
) -> dict[str, Any]:
    """That robot with a box between its two hands, which look at each other and come at these velocities [m/s]."""
    facts = tree_facts(floating)
    # z of either flange to the other hand, and the faces of the pads (0.05 m before it) in line with the shoulders
    facts["flange"] |= {"xyz": (0.3, 0.05, 0), "rpy": (np.pi / 2.0, 0, 0)}
    facts["hands"] = [{"name": "right", "xyz": (0.3, -0.05, 0), "rpy": (-np.pi / 2.0, 0, 0), "link": "right_arm"}]
    box = {"box": {"label": "box", "mass": 1.2, "size": [0.2, 0.4, 0.2]}}
    pad: dict[str, Any] = {"size": [0.04, 0.04, 0.01]}
    if round_pads:
        pad = {"size": [2.0 * RADIUS] * 3, "shape": "sphere"}
    data = scenario_of(facts, box, [0.0, 0.0, 0.0], pad=pad, support__height=0.9, contact__friction=friction)
    robot = data["robots"]["robot"]
    robot["hands"] = {"right": {"end_effector": json.loads(json.dumps(robot["end_effector"]))}}
    data["cases"]["case_1"]["robots"]["robot"] = {"ante_velocity": list(left), "hands": {"right": list(right)}}
    data["support"]["friction"] = 0.0
    return data
