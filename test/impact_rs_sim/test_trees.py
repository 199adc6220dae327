# SPDX-License-Identifier: Apache-2.0
"""Robots that are trees: branches, joints that follow others, floating bases.

Held against bodies that are all free, with a constraint for every joint (maximal coordinates): no inertia matrix of
joints, no recursion of Pinocchio, and mimic joints as equations between velocities.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import scipy
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from trees import (
    DUAL_ARM,
    PANDA_FINGERS,
    TREE_LINK,
    random_facts,
    random_state,
    random_tree,
    robot_of,
    struck,
    thrown_at_ball,
    tree_scenario,
    with_tool,
)

from impact_rs_analysis.limits.drawn_hits import Hits
from impact_rs_analysis.limits.hit_bounds import NO_THRESHOLDS
from impact_rs_control.plan import check_joint_counts
from impact_rs_ros import impact_map_node
from impact_rs_sim.descriptions.exported_scene import ExportedScene
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map, kinetic_energy, predict_impact
from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.derivatives import differentiate
from impact_rs_sim.impact_map.laws import ContactTerms
from impact_rs_sim.impact_map.measured import MeasuredImpact, solve_measured
from impact_rs_sim.model import load_model
from impact_rs_sim.proportion import reach_of
from impact_rs_sim.robot_check import check_facts
from impact_rs_sim.robots.robot import Array, RobotFacts, load_facts
from impact_rs_sim.robots.robot_import import import_urdf, save_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.schema import validate
from impact_rs_sim.twin import TwinJob, simulate
from impact_rs_trials.recordings.importing.measured_limits import measured_limits
from impact_rs_trials.scenario_draft import draft
from impact_rs_workbench import prediction

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, count=st.integers(1, 7), floating=st.booleans())
def test_any_tree_answers_an_impulse_as_its_free_bodies_do_under_the_constraints_of_its_joints(
    seed: int, count: int, floating: bool
) -> None:
    rng = np.random.default_rng(seed)
    facts, model, q = random_tree(rng, count, floating)
    inertia, jacobian, tip = model.at_impact(q)
    inertia = np.triu(inertia) + np.triu(inertia, 1).T
    response = jacobian @ np.linalg.solve(inertia, jacobian.T)
    np.testing.assert_allclose(response, struck(facts, q, tip)[0], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(model.mass_matrix(q), inertia, atol=1e-12)
    np.testing.assert_allclose(model.jacobian(q), jacobian, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, count=st.integers(3, 8), floating=st.booleans())
def test_joints_that_follow_reduce_the_inertia_by_their_constraint(seed: int, count: int, floating: bool) -> None:
    """q = G q_r + q_0, M_r = G^T M G, J_r = J G, g_r = G^T g with the tree in which every joint moves by itself."""
    rng = np.random.default_rng(seed)
    facts, model, q = random_tree(rng, count, floating, mimics=0.5)
    data = json.loads(facts.model_dump_json())
    for origin in data["joints"]:
        origin.pop("mimic", None)
    data["limits"] = {name: [value] * count for name, value in TREE_LIMITS.items()}
    whole = RobotModel(RobotFacts.model_validate(data), model.end_effector)
    of_joints, offsets = np.zeros((count, facts.joint_count)), np.zeros(count)
    for number, (joint, coordinate) in enumerate(zip(facts.joints, facts.coordinates, strict=True)):
        of_joints[number, coordinate] = 1.0 if joint.mimic is None else joint.mimic.ratio
        offsets[number] = 0.0 if joint.mimic is None else joint.mimic.offset
    full = np.concatenate((q[: q.size - facts.joint_count], of_joints @ facts.joints_of(q) + offsets))
    of_all = scipy.linalg.block_diag(np.eye(facts.base_size), of_joints)
    np.testing.assert_allclose(model.mass_matrix(q), of_all.T @ whole.mass_matrix(full) @ of_all, atol=1e-9)
    np.testing.assert_allclose(model.jacobian(q), whole.jacobian(full) @ of_all, atol=1e-9)
    np.testing.assert_allclose(model.gravity_torque(q), of_all.T @ whole.gravity_torque(full), atol=1e-9)


TREE_LIMITS = {"position_min_rad": -3.0, "position_max_rad": 3.0, "velocity_rad_s": 9.0, "torque_Nm": 90.0}


def imported(folder: Path, text: str, **options: Any) -> tuple[RobotFacts, tuple[str, ...], tuple[str, ...]]:
    """Facts of a URDF, through the written file; names of the joints, notes."""
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    robot = import_urdf(folder / "robot.urdf", **options)
    save_facts(robot, "A robot.", folder / "robot.yaml")
    assert load_facts(str(folder / "robot.yaml")) == robot.facts
    return robot.facts, robot.joints, robot.notes


@pytest.mark.parametrize("moving", [(), ("right_*",), ("right_*", "left_finger_1")])
def test_two_arms_on_a_torso_have_the_inertia_that_mujoco_gives_them(tmp_path: Path, moving: tuple[str, ...]) -> None:
    """qM of MuJoCo, which reads the URDF itself; held joints have no row, and a finger follows the other."""
    facts, names, notes = imported(tmp_path, DUAL_ARM, tip="left_hand_pad", move=moving)
    still = {"right_1", "right_2", "left_finger_1", "left_finger_2"} - {
        name for name in DUAL_NAMES if any(name.startswith(pattern.rstrip("*")) for pattern in moving)
    }
    still -= {"left_finger_2"} if "left_finger_1" in names else set()
    assert set(names) == set(DUAL_NAMES) - still - {"left_finger_2"}
    assert names[:3] == ("waist", "left_1", "left_2")
    assert all(name in " ".join(notes) for name in still)
    model, theirs = RobotModel(facts, weightless_pad()), mujoco.MjModel.from_xml_string(DUAL_ARM)
    data = mujoco.MjData(theirs)
    follower = np.zeros((len(DUAL_NAMES), len(names)))
    order = [theirs.joint(place).name for place in range(theirs.njnt)]
    for column, name in enumerate(names):
        follower[order.index(name), column] = 1.0
    if "left_finger_1" in names:
        follower[order.index("left_finger_2"), names.index("left_finger_1")] = -0.8
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = rng.uniform(0.0, 0.5, len(names))
        data.qpos[:] = follower @ q
        for name in still:
            data.qpos[order.index(name)] = {"left_finger_1": 0.01, "left_finger_2": -0.008}.get(name, 0.0)
        mujoco.mj_forward(theirs, data)
        whole = np.zeros((theirs.nv, theirs.nv))
        mujoco.mj_fullM(theirs, data, whole)
        np.testing.assert_allclose(model.mass_matrix(q), follower.T @ whole @ follower, rtol=1e-6, atol=1e-8)


DUAL_NAMES = ("waist", "left_1", "left_2", "left_finger_1", "left_finger_2", "right_1", "right_2")


def weightless_pad() -> Any:
    return robot_of(weight=1e-12)


def test_the_fingers_of_a_hand_stand_still_by_themselves_as_if_they_were_locked(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    facts, names, notes = imported(tmp_path, PANDA_FINGERS, tip="hand_tcp")
    locked, _, _ = imported(tmp_path / "one", PANDA_FINGERS, tip="hand_tcp", lock=["finger_*=0"])
    assert facts.is_chain and names == ("wrist",)
    assert facts.links == locked.links
    assert any("finger_1 at 0, finger_2 at 0" in note and "--move" in note for note in notes)


def test_a_second_arm_that_moves_takes_part_in_the_impact(tmp_path: Path) -> None:
    """Held, it is a lump on the torso; loose, it weighs less there: the pad meets a lighter robot, by MuJoCo's M."""
    held, _, _ = imported(tmp_path, DUAL_ARM, tip="left_hand_pad")
    (tmp_path / "loose").mkdir()
    loose, names, _ = imported(tmp_path / "loose", DUAL_ARM, tip="left_hand_pad", move=["right_*"])
    direction, effector = np.array([0.6, 0.8, 0.0]), weightless_pad()
    models = [RobotModel(facts, effector) for facts in (held, loose)]
    q = [np.array([0.2, 0.4, -0.3]), np.array([0.2, 0.4, -0.3, 0.0, 0.0])]
    mobile = [model.mobility(own, direction, np.zeros(own.size)) for model, own in zip(models, q, strict=True)]
    assert mobile[1] > 1.01 * mobile[0]
    whole = models[1].mass_matrix(q[1])
    row = direction @ models[1].jacobian(q[1])[:3]
    fixed = row[:3] @ np.linalg.solve(whole[:3, :3], row[:3])  # second arm held: its columns are struck out
    assert mobile[0] == pytest.approx(fixed, rel=1e-9)
    assert names == ("waist", "left_1", "left_2", "right_1", "right_2")


def test_a_robot_whose_base_floats_has_the_inertia_of_its_urdf_on_a_free_flyer(tmp_path: Path) -> None:
    """Pinocchio's of the same links, whose torso is the root; the finger that follows by its constraint."""
    start, end = DUAL_ARM.index('<joint name="waist"'), DUAL_ARM.index('<joint name="left_1"')
    text = (DUAL_ARM[:start] + DUAL_ARM[end:]).replace('<link name="base"/>', "")
    facts, names, _ = imported(tmp_path, text, tip="left_hand_pad", move=["*"], floating=True)
    model, theirs = RobotModel(facts, weightless_pad()), pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    columns = np.zeros((theirs.nv, 6 + len(names)))
    columns[:6, :6] = np.eye(6)
    for number, name in enumerate(names, start=6):
        columns[theirs.joints[theirs.getJointId(name)].idx_v, number] = 1.0
    follower = theirs.joints[theirs.getJointId("left_finger_2")].idx_v
    columns[follower, 6 + names.index("left_finger_1")] = -0.8
    q = random_state(np.random.default_rng(4), facts)
    full = np.concatenate((q[:7], columns[6:, 6:] @ q[7:]))
    whole = pin.crba(theirs, theirs.createData(), full)
    whole = np.triu(whole) + np.triu(whole, 1).T
    np.testing.assert_allclose(model.mass_matrix(q), columns.T @ whole @ columns, atol=1e-9)
    assert names == ("left_1", "left_2", "left_finger_1", "right_1", "right_2")


def test_a_mast_follows_its_first_stage_through_the_others(tmp_path: Path) -> None:
    """Stage 3 follows stage 2, which follows stage 1: q_3 = 0.5 (2 q_1 + 0.1) - 0.3; all carry each other."""
    stages = [TREE_URDF_LINK.format(number) for number in (1, 2, 3)]
    joints = [
        MAST_STAGE.format(number, number - 1, mimic)
        for number, mimic in enumerate(
            (
                "",
                '<mimic joint="lift_1" multiplier="2" offset="0.1"/>',
                '<mimic joint="lift_2" multiplier="0.5" offset="-0.3"/>',
            ),
            start=1,
        )
    ]
    text = f'<robot name="mast"><link name="stage_0"/>{"".join(stages + joints)}</robot>'
    facts, names, _ = imported(tmp_path, text)
    assert names == ("lift_1",)
    found = [(joint.mimic.ratio, joint.mimic.offset) for joint in facts.joints if joint.mimic is not None]
    np.testing.assert_allclose(found, [(2.0, 0.1), (1.0, -0.25)])
    model = RobotModel(facts, weightless_pad())
    np.testing.assert_allclose(model.mass_matrix(np.zeros(1)), [[2.0 * (1.0 + 9.0 + 16.0)]])  # speeds 1, 3 and 4


def test_a_follower_on_the_fixed_base_moves_with_its_leader(tmp_path: Path) -> None:
    """Kills the loss of joints on a fixed base: a gantry of two columns of 2 kg moves both, with a beam of 2 kg."""
    follow = '<mimic joint="lift_1"/>'
    joints = [MAST_STAGE.format(1, 0, ""), MAST_STAGE.format(2, 1, ""), MAST_STAGE.format(3, 0, follow)]
    links = [TREE_URDF_LINK.format(number) for number in (1, 2, 3)]
    text = f'<robot name="gantry"><link name="stage_0"/>{"".join(links + joints)}</robot>'
    facts, names, _ = imported(tmp_path, text, tip="stage_2")
    assert names == ("lift_1", "lift_2")
    np.testing.assert_allclose(RobotModel(facts, weightless_pad()).mass_matrix(np.zeros(2)), [[6.0, 2.0], [2.0, 2.0]])
    (tmp_path / "held").mkdir()
    held, _, _ = imported(tmp_path / "held", text, tip="stage_2", lock=["lift_3=0"])
    assert held.is_chain


def test_a_locked_joint_holds_those_that_follow_it(tmp_path: Path) -> None:
    _, names, notes = imported(tmp_path, DUAL_ARM, tip="left_hand_pad", lock=["left_finger_1=0.05"])
    assert "Joint left_finger_1 is held at 0.05 m, as given." in notes
    assert "Joint left_finger_2 is held at -0.04 m, as given." in notes
    assert not any("left_finger" in name for name in names)


def test_a_lock_is_a_name_before_a_pattern_the_last_of_two_and_within_the_limits(tmp_path: Path) -> None:
    """Kills names with brackets as patterns, the first of two places, 57 rad for degrees, leaders of held joints."""
    stages = [TREE_URDF_LINK.format(number) for number in (0, 1, 2, 3)]
    follow = '<mimic joint="lift[{}]" multiplier="2"/>'
    joints = [
        MAST_STAGE.format(number, number - 1, mimic).replace(f"lift_{number}", f"lift[{number}]")
        for number, mimic in ((1, ""), (2, follow.format(1)), (3, follow.format(2)))
    ]
    text = f'<robot name="mast">{"".join(stages + joints)}</robot>'
    _, names, notes = imported(tmp_path, text, lock=["lift[2]=0.9", "lift[2]=0.2"])
    assert names == ("lift[1]",)
    held = {"Joint lift[2] is held at 0.2 m, as given.", "Joint lift[3] is held at 0.4 m, as given."}
    assert held <= set(notes)
    with pytest.raises(InputError, match=r"joint lift\[2\] is held at 57 m, expected -1 to 1 m"):
        imported(tmp_path, text, lock=["lift[2]=57"])


TREE_URDF_LINK = (
    '<link name="stage_{0}"><inertial><mass value="2"/>'
    '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>'
)
MAST_STAGE = (
    '<joint name="lift_{0}" type="prismatic"><parent link="stage_{1}"/><child link="stage_{0}"/><axis xyz="0 0 1"/>{2}'
    '<limit lower="-1" upper="1" velocity="2" effort="50"/></joint>'
)
REFUSED_TREES: list[tuple[dict[str, Any], str]] = [
    ({"tip": "left_hand_pad", "move": ["rihgt_1"]}, "no joint 'rihgt_1' moves beside the path.*did you mean 'right_1'"),
    ({"tip": "left_hand_pad", "move": ["left_1"]}, "no joint 'left_1' moves beside the path"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED_TREES)
def test_what_cannot_move_beside_the_path_is_refused(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        imported(tmp_path, DUAL_ARM, **options)


def changed(facts: RobotFacts, **keys: Any) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(facts.model_dump_json())
    for key, value in keys.items():
        *above, last = (int(part) if part.isdigit() else part for part in key.split("__"))
        place: Any = data
        for part in above:
            place = place[part]
        place[last] = value
    return data


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"joints__2__parent": "nowhere"}, "joints.2.parent: 'nowhere' is no link that can carry it"),
        ({"joints__4__parent": "left_hand"}, "joints.4.parent"),  # right_2 after right_1, which closed that branch
        ({"flange__link": "nowhere"}, "flange.link: 'nowhere'"),
        ({"flange__link": "base"}, "flange.link: the base is fixed"),
        ({"joints__1__mimic": {"joint": "right_9"}}, "joints.1.mimic.joint: 'right_9' is no joint that moves"),
        ({"joints": [], "links": []}, "joints is empty, expected at least one, or floating_base"),
    ],
)
def test_facts_of_no_tree_are_refused_with_the_key(tmp_path: Path, keys: dict[str, Any], message: str) -> None:
    facts, _, _ = imported(tmp_path, DUAL_ARM, tip="left_hand_pad", move=["right_*"])
    with pytest.raises(InputError, match=message):
        validate(RobotFacts, changed(facts, **keys), "robot.yaml")


# ---------------------------------------------------------------------------------------------------------------------
# Floating base


def test_a_free_body_meets_a_wall_with_its_mass_at_that_point() -> None:
    """m_eff = 1 / (1 / m + (r x n)^T I^-1 (r x n)), by hand; v_n^+ = -e v_n^-, no impulse along a smooth wall."""
    rng = np.random.default_rng(5)
    for restitution in (0.0, 0.3, 1.0):
        scene, problem = thrown_at_ball(rng, random_facts(rng, 0, True), restitution, fixed=True)
        facts, (arm,) = scene.physics.arms["robot"].facts, problem.arms.values()
        model = scene.models["robot"]
        result = compute_impact_map(problem)
        (contact,) = [one for one in result.contacts if one.body_b == "robot"]
        pose, link, tool = pin.XYZQUATToSE3(arm.position), facts.floating_base, model.end_effector
        assert link is not None
        tip = model.placement(arm.position)
        whole = pose.act(pin.Inertia(link.mass, np.array(link.com), link.inertia_matrix))
        whole += tip.act(pin.Inertia(tool.mass, tool.com, tool.inertia))
        lever, normal = contact.position - whole.lever, contact.normal  # from the robot into the wall
        arm_of = np.cross(lever, normal)
        mass = 1.0 / (1.0 / whole.mass + arm_of @ np.linalg.solve(whole.inertia, arm_of))
        twist = pose.toActionMatrix() @ arm.velocity  # at the origin of A
        closing = (twist[:3] + np.cross(twist[3:], contact.position)) @ normal
        np.testing.assert_allclose(contact.impulse, normal * mass * (1.0 + restitution) * closing, rtol=1e-6)
        after = pose.toActionMatrix() @ result.joint_velocity["robot"]
        opening = (after[:3] + np.cross(after[3:], contact.position)) @ normal
        assert opening == pytest.approx(-restitution * closing, abs=1e-9)


def momentum(scene: Scene, position: Array, velocity: Array, twist: Array, body: BodyState) -> Array:
    """Linear momentum, and angular momentum about the origin of A, of robot and object, ``(6,)``."""
    model = scene.models["robot"]
    matrix, offset = model.facts.reduction
    joints = (matrix @ model.facts.columns_of(model.facts.joints_of(position)) + offset)[6:]
    pin.computeCentroidalMomentum(
        model.pinocchio, model.data, np.concatenate((position[:7], joints)), matrix @ velocity
    )
    about = pin.SE3(np.eye(3), model.data.com[0])
    of_robot = about.act(model.data.hg).vector
    object_ = scene.physics.object
    own = pin.SE3(body.rotation, body.position)
    inertia = own.act(pin.Inertia(object_.mass, object_.com_offset, np.diag(object_.inertia)))
    at_origin = np.concatenate((twist[:3] + np.cross(body.position, twist[3:]), twist[3:]))
    return np.asarray(of_robot + inertia.matrix() @ at_origin)


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS, count=st.integers(0, 4), restitution=st.floats(0.0, 1.0), friction=st.floats(0.0, 0.8))
def test_robot_and_object_in_space_keep_their_momentum(
    seed: int, count: int, restitution: float, friction: float
) -> None:
    """Whatever restitution, friction and joints are; of smooth bodies the energy does not grow either."""
    rng = np.random.default_rng(seed)
    scene, problem = thrown_at_ball(
        rng, random_facts(rng, count, True), restitution if friction == 0.0 else 0.0, friction
    )
    (arm,) = problem.arms.values()
    result = compute_impact_map(problem)
    before = momentum(scene, arm.position, arm.velocity, problem.object.twist, problem.object)
    after = momentum(scene, arm.position, result.joint_velocity["robot"], result.object_twist, problem.object)
    np.testing.assert_allclose(after, before, atol=1e-8)
    assert float(np.linalg.norm(sum(one.impulse for one in result.contacts))) > 0.01
    assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-9)


@pytest.mark.parametrize("restitution", [0.0, 0.25, 0.5, 0.75, 1.0])
@pytest.mark.parametrize("count", [1, 4])
def test_a_smooth_impact_takes_the_energy_that_its_restitution_leaves(restitution: float, count: int) -> None:
    """dT = -(1 - e^2) m_eff c^2 / 2 with the closing speed c; 1 / m_eff by maximal coordinates, and the ball's."""
    rng = np.random.default_rng(11)
    scene, problem = thrown_at_ball(rng, random_facts(rng, count, True), restitution)
    (arm,) = problem.arms.values()
    model, result = scene.models["robot"], compute_impact_map(problem)
    (contact,) = [one for one in result.contacts if one.body_b == "robot"]
    tip = model.placement(arm.position)
    facts = with_tool(model)
    wrench = np.concatenate((contact.normal, np.cross(contact.position - tip.translation, contact.normal)))
    inverse = wrench @ struck(facts, arm.position, tip)[0] @ wrench + 1.0 / scene.physics.object.mass
    twist = model.jacobian(arm.position) @ arm.velocity
    closing = float(wrench @ twist - contact.normal @ problem.object.twist[:3])
    lost = kinetic_energy(problem) - kinetic_energy(problem, result)
    assert lost == pytest.approx((1.0 - restitution**2) * closing**2 / inverse / 2.0, rel=1e-5, abs=1e-12)
    assert contact.impulse @ contact.normal == pytest.approx((1.0 + restitution) * closing / inverse, rel=1e-5)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, restitution=st.floats(0.0, 1.0), floating=st.booleans())
def test_four_smooth_points_obey_a_solve_by_scipy(seed: int, restitution: float, floating: bool) -> None:
    """0 <= L perpendicular to G L + (1 + e) J_n u^- >= 0, as least squares under L >= 0 (Lawson and Hanson)."""
    rng = np.random.default_rng(seed)
    scene, problem = thrown_at_ball(rng, random_facts(rng, 5, floating), restitution)
    arm = problem.arms["robot"]
    tip, normal = scene.models["robot"].placement(arm.position), np.array([0.0, 0.0, 1.0])
    points = tuple(
        ContactPoint("robot", tip.translation + tip.rotation @ np.array([x, y, 0.0]), tip.rotation @ normal, 0.0, 0.0)
        for x in (-0.02, 0.02)
        for y in (-0.02, 0.02)
    )
    impact = MeasuredImpact(problem.arms, problem.object, points)
    physics = replace(scene.physics, restitution=restitution, pad_friction=0.0)
    system = impact.system(physics, scene.models)
    terms = ContactTerms.of(system, points, restitution)
    rows = np.einsum("mi,miv->mv", terms.normals, terms.jacobian.reshape(4, 3, -1))
    speed = rows @ system.velocity
    wanted = speed + restitution * np.minimum(speed, 0.0)
    root = scipy.linalg.sqrtm(np.linalg.inv(system.inertia)).real @ rows.T
    # min |root L + d|^2 / 2 with root^T d = wanted: its conditions are the laws
    shift = np.linalg.lstsq(root.T, wanted, rcond=None)[0]
    assume(np.min(speed) < 0.0)
    assume(np.max(np.abs(root.T @ shift - wanted)) < 1e-9)  # else points of a face that open and close at once
    impulse, _ = scipy.optimize.nnls(root, -shift)
    after = system.velocity + np.linalg.solve(system.inertia, rows.T @ impulse)
    velocity, _ = solve_measured(physics, impact, scene.models, may_gain_energy=True)
    np.testing.assert_allclose(velocity, after, atol=1e-6)


def test_a_base_as_heavy_as_the_earth_is_a_mounted_one() -> None:
    rng = np.random.default_rng(7)
    floating, model, q = random_tree(rng, 5, True)
    heavy = TREE_LINK | {"mass": 1e9, "inertia": (1e9, 0.0, 0.0, 1e9, 0.0, 1e9)}
    data = changed(floating, floating_base=heavy)
    tied = {**data, "flange": {**data["flange"], "link": data["flange"].get("link", "").replace("base", "link5")}}
    loose = RobotModel(RobotFacts.model_validate(tied), model.end_effector)
    tied.pop("floating_base")
    fixed = RobotModel(RobotFacts.model_validate(tied), model.end_effector, pin.XYZQUATToSE3(q[:7]))
    n = np.array([0.6, 0.0, 0.8])
    motors = np.full(floating.joint_count, 0.1)
    np.testing.assert_allclose(loose.link_placements(q)["base"].homogeneous, fixed.base.homogeneous, atol=1e-12)
    assert loose.mobility(q, n, motors) == pytest.approx(fixed.mobility(q[7:], n, motors), rel=1e-6)
    np.testing.assert_allclose(loose.jacobian(q)[:, 6:], fixed.jacobian(q[7:]), atol=1e-9)


def test_derivatives_of_a_prediction_know_a_floating_base() -> None:
    """By the velocity of a joint, and by the mass of the object, against differences of the map."""
    rng = np.random.default_rng(2)
    scene, problem = thrown_at_ball(rng, random_facts(rng, 2, True, mimics=0.0), 0.0)
    found, step = differentiate(problem, scene.models), 1e-5
    assert "robot.base_vx" in found.names and "robot.joint_velocity.2" in found.names
    (arm,) = problem.arms.values()
    velocities = []
    for sign in (1.0, -1.0):
        moved = ArmState(arm.position, arm.velocity + sign * step * np.eye(8)[7])
        velocities.append(compute_impact_map(replace(problem, arms={"robot": moved})).joint_velocity["robot"])
    slope = (velocities[0] - velocities[1]) / (2.0 * step)
    np.testing.assert_allclose(found.of("robot.velocity.2")[:8], slope, atol=1e-5)


@pytest.mark.parametrize(
    ("position", "velocity", "message"),
    [
        (np.zeros(2), np.zeros(8), "arms.robot.position: expected 9 values"),
        (np.array([0, 0, 0, 0, 0, 0, 2.0, 0, 0]), np.zeros(8), "expected a unit quaternion x, y, z, w of the base"),
        (np.array([0, 0, 0, 0, 0, 0, 1.0, 0, 0]), np.zeros(2), "arms.robot.velocity: expected 8 values"),
    ],
)
def test_a_state_that_lacks_its_base_is_refused(position: Array, velocity: Array, message: str) -> None:
    rng = np.random.default_rng(2)
    _, problem = thrown_at_ball(rng, random_facts(rng, 2, True, mimics=0.0), 0.0)
    with pytest.raises(InputError, match=message):
        compute_impact_map(replace(problem, arms={"robot": ArmState(position, velocity)}))


# ---------------------------------------------------------------------------------------------------------------------
# Where chains alone are computed


def tree_scene(**others: Any) -> Scene:
    return Scene.resolve(validate(Scenario, tree_scenario(**others), "mine.yaml"), "box", "case_1")


REFUSERS: dict[str, Callable[[Scene], object]] = {
    "the controller": lambda scene: check_joint_counts(scene.scenario),
    "the URDF that simulators and viewers load": lambda scene: scene.physics.description(),
    "the simulator": lambda scene: scene.models["robot"].chain,
    "the engine bullet": lambda scene: predict_impact(ImpactProblem.at_nominal_impact(scene), engine="bullet"),
    "the twin": lambda scene: simulate([TwinJob(scene.physics, scene.arms, {}, {}, {}, np.array([0.0, 1e-3]), 1e-3)]),
    "an exported world": lambda scene: ExportedScene.of(scene, load_model(Path("nominal"))),
    "the search for a speed limit": lambda scene: Hits(scene, NO_THRESHOLDS),
    "a scenario with trials": lambda scene: draft("mine", scene.physics.arms["robot"].facts, "push"),
    "this service, whose messages have joints alone,": lambda scene: impact_map_node._problem(
        SimpleNamespace(motor_inertia="reduced"), scene
    ),
    "the workbench, which draws them,": lambda scene: prediction._problem(scene.scenario, None, None),
}


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("what", REFUSERS)
def test_what_computes_chains_refuses_a_tree_and_says_what_takes_it(what: str, floating: bool) -> None:
    scene = tree_scene(floating=floating)
    predict_impact(ImpactProblem.at_nominal_impact(scene))
    said = f"robot.*: {what} takes serial arms on a fixed base.*by hand.*impact-rs map and tables of impacts take it"
    with pytest.raises(InputError, match=said):
        REFUSERS[what](scene)


def test_a_body_without_joints_is_a_robot_if_its_base_floats() -> None:
    """A drone of 10 kg and a tool of 0.4 kg meet a box of 1.2 kg: v^+ of both is v m / (m + m_box) on the line."""
    data = tree_scenario(floating=True)
    robot = data["robots"]["robot"]
    facts = robot["facts"]
    facts |= {"joints": [], "links": [], "limits": {name: [] for name in facts["limits"]}}
    facts["flange"] |= {"link": "base", "xyz": (0.3, 0.0, 0.0)}
    robot["impact"], robot["base"]["yaw"] = {"joint_position": []}, 0.4
    ahead = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    data["cases"]["case_1"]["robots"]["robot"]["ante_velocity"] = list(0.5 * ahead)
    robot["drive"] |= {name: [] for name, value in robot["drive"].items() if isinstance(value, list)}
    scene = Scene.resolve(validate(Scenario, data, "mine.yaml"), "box", "case_1")
    result = predict_impact(ImpactProblem.at_nominal_impact(scene))
    assert scene.arms["robot"].velocity == pytest.approx([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])  # in its own axes
    assert result.object_twist[:3] @ ahead == pytest.approx(0.5 * 10.4 / 11.6, rel=1e-3)
    assert [check.outcome for check in check_facts(scene.physics.arms["robot"].facts)] == ["ok"] * 3


@pytest.mark.parametrize("floating", [False, True])
def test_the_reach_of_a_robot_is_that_of_its_way_to_the_pad(floating: bool) -> None:
    """0.2 m from the waist to the left arm and 0.3 m along it; the right arm has no part in it."""
    assert reach_of(tree_scene(floating=floating).physics.arms["robot"].facts) == pytest.approx(0.5)


def test_effects_of_links_move_those_that_follow_as_well(tmp_path: Path) -> None:
    """One mass scale per coordinate: the finger that follows is as much heavier as the other, and so M says."""
    facts, names, _ = imported(tmp_path, DUAL_ARM, tip="left_hand_pad", move=["*"])
    scene = tree_scene()
    arm = scene.physics.arms["robot"]
    count = facts.joint_count
    physics = replace(scene.physics, arms={"robot": replace(arm, facts=facts)})
    scales = np.ones(count)
    scales[names.index("left_finger_1")] = 2.0
    heavier = library()["link_mass"].apply_vector(physics, scales).arms["robot"].facts
    ratio = [after.mass / before.mass for before, after in zip(facts.links, heavier.links, strict=True)]
    by_name = {link.name: value for link, value in zip(facts.links, ratio, strict=True)}
    assert {name for name, value in by_name.items() if value == 2.0} == {"left_finger_1_link", "left_finger_2_link"}
    assert sum(value != 1.0 for value in ratio) == 2


def test_a_tip_that_follows_a_joint_beside_the_path_is_imported(tmp_path: Path) -> None:
    """Kills the rule that a joint stands behind the one it follows: fingers of 2 kg on a lift of 2 kg."""
    stages = [TREE_URDF_LINK.format(number) for number in (0, 1, 2, 3)]
    joints = [MAST_STAGE.format(1, 0, ""), MAST_STAGE.format(2, 1, '<mimic joint="lift_3"/>')]
    text = f'<robot name="lift">{"".join([*stages, *joints, MAST_STAGE.format(3, 1, "")])}</robot>'
    facts, names, _ = imported(tmp_path, text, tip="stage_2", move=["lift_3"])
    assert names == ("lift_1", "lift_3")
    np.testing.assert_allclose(RobotModel(facts, weightless_pad()).mass_matrix(np.zeros(2)), [[6.0, 4.0], [4.0, 4.0]])


def test_a_hand_named_twice_is_refused_in_one_line(tmp_path: Path) -> None:
    """Kills facts that are built unchecked: the exception of the schema came through."""
    with pytest.raises(InputError, match=r"robot.urdf: hands.1.name: another hand is called 'right_hand'"):
        imported(tmp_path, DUAL_ARM, tip="left_hand_pad", move=["right_*"], hands=["right_hand", "right_hand"])


def test_a_chain_with_a_follower_is_said_to_need_a_lock(tmp_path: Path) -> None:
    """Kills a remedy that changes nothing: without --move, --hand and --floating it was imported already."""
    stages = [TREE_URDF_LINK.format(number) for number in (0, 1, 2)]
    joints = [MAST_STAGE.format(1, 0, ""), MAST_STAGE.format(2, 1, '<mimic joint="lift_1"/>')]
    facts, _, _ = imported(tmp_path, f'<robot name="mast">{"".join([*stages, *joints])}</robot>')
    with pytest.raises(InputError, match="with --lock JOINT=PLACE of every joint that follows"):
        facts.check_chain("the plant", "robots.arm.model")


def test_a_joint_called_as_pinocchios_free_flyer_is_a_joint_of_the_file(tmp_path: Path) -> None:
    """Kills the search of joints by name: base and first link changed places."""
    links = [TREE_URDF_LINK.format(number) for number in (0, 1, 2)]
    joints = [MAST_STAGE.format(1, 0, "").replace("lift_1", "root_joint"), MAST_STAGE.format(2, 1, "")]
    facts, _, _ = imported(tmp_path, f'<robot name="mast">{"".join([*links, *joints])}</robot>', floating=True)
    mass = RobotModel(facts, weightless_pad()).mass_matrix(np.array([0, 0, 0, 0, 0, 0, 1.0, 0, 0]))
    assert mass[2, 2] == pytest.approx(6.0) and mass[2, 6] == pytest.approx(4.0)


def test_limits_of_a_follower_narrow_those_of_its_leader(tmp_path: Path) -> None:
    """Kills followers beyond their hard stops: q_2 = -2 q_1 + 0.2 within -1 ... 1 m, at most 2 m/s."""
    stages = [TREE_URDF_LINK.format(number) for number in (0, 1, 2)]
    joints = [
        MAST_STAGE.format(1, 0, ""),
        MAST_STAGE.format(2, 1, '<mimic joint="lift_1" multiplier="-2" offset="0.2"/>'),
    ]
    text = f'<robot name="mast">{"".join([*stages, *joints])}</robot>'
    facts, _, notes = imported(tmp_path, text)
    limits = facts.limits
    found = (*limits.position_min_rad, *limits.position_max_rad, *limits.velocity_rad_s, *limits.torque_Nm)
    assert found == pytest.approx((-0.4, 0.6, 1.0, 50.0))
    assert any("Limits of joint lift_1 are narrowed by the limits of lift_2" in note for note in notes)
    apart = text.replace('offset="0.2"', 'offset="9"')
    (tmp_path / "apart").mkdir()
    facts, _, notes = imported(tmp_path / "apart", apart)
    assert facts.limits.position_max_rad == (1.0,)
    assert any("Position limits of joint lift_2 are left out: lift_1" in note for note in notes)
    (tmp_path / "given").mkdir()
    facts, _, _ = imported(tmp_path / "given", text, limits=["lift_1.position=-1:1"])
    assert facts.limits.position_max_rad == (1.0,)


def test_a_drone_and_a_floating_robot_whose_joints_are_locked_are_imported(tmp_path: Path) -> None:
    """Kills ``joints:`` without rows in the written file, which YAML reads as null; a table has no limits of them."""
    drone = f'<robot name="drone">{TREE_URDF_LINK.format(0)}</robot>'
    shown = partial(measured_limits, tmp_path / "log.csv")
    facts, names, _ = imported(tmp_path, drone, tip="stage_0", floating=True, measured=shown)
    assert names == () and facts.floating_base is not None and facts.floating_base.mass == 2.0
    (tmp_path / "locked").mkdir()
    locked = drone.replace("</robot>", TREE_URDF_LINK.format(1) + MAST_STAGE.format(1, 0, "") + "</robot>")
    facts, names, _ = imported(tmp_path / "locked", locked, tip="stage_1", floating=True, lock=["*=0"])
    assert names == () and facts.floating_base is not None and facts.floating_base.mass == 4.0


def test_a_scenario_of_a_floating_robot_needs_its_joints() -> None:
    data = tree_scenario(floating=True)
    pose = {"position": [0, 0, 1], "pad_normal": [1, 0, 0], "pad_up": [0, 0, 1], "joint_guess": [0.0] * 2}
    data["robots"]["robot"]["impact"] = pose
    with pytest.raises(InputError, match="a base that floats reaches any pose; expected joint_position"):
        validate(Scenario, data, "mine.yaml")
