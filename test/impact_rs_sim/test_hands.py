# SPDX-License-Identifier: Apache-2.0
"""Robots that hit with two hands at once: two arms on one torso, fixed or floating.

Held against maximal coordinates (every body free, every joint a constraint), where a pad is a point of one body.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import scipy
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from trees import DUAL_ARM, free_bodies, hands_scenario, random_facts, random_state, robot_of

from impact_rs_cli.main import main
from impact_rs_sim.errors import Infeasible, InputError, UnreachablePose
from impact_rs_sim.impact_map import ImpactProblem, ImpactResult, compute_impact_map, kinetic_energy, settle
from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.derivatives import differentiate
from impact_rs_sim.impact_map.measured import MeasuredImpact, solve_measured
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array, EndEffector, RobotFacts, load_facts
from impact_rs_sim.robots.robot_import import import_urdf, save_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.schema import validate

SEEDS = st.integers(0, 2**32 - 1)
TOOL = robot_of(0.4)
OTHER = EndEffector(0.7, np.array([0.01, 0.0, -0.03]), np.diag([2e-3, 1e-3, 1.5e-3]), 0.07, 0.4, (0.01, 0.01, 0.01))


def random_hands(rng: np.random.Generator, floating: bool) -> tuple[RobotFacts, RobotModel, Array]:
    """A tree of five links with a pad on the flange and another one anywhere, and a state of it."""
    data = random_facts(rng, 5, floating)
    place = {"xyz": tuple(rng.uniform(-0.2, 0.2, 3)), "rpy": tuple(rng.uniform(-3.0, 3.0, 3))}
    data["hands"] = [{"name": "other", "link": f"link{rng.integers(1, 6)}", **place}]
    facts = RobotFacts.model_validate(data)
    return facts, RobotModel(facts, TOOL, hands={"other": OTHER}), random_state(rng, facts)


def by_free_bodies(facts: RobotFacts, model: RobotModel, q: Array) -> tuple[Array, Array]:
    """Changes of the twists of both frames E ``(12, 12)`` and of v ``(nv, 12)`` by impulsive wrenches on both.

    The tools are bodies of their own here: added to the free link that carries them.
    """
    tips = [model.placement(q), model.placement(q, "other")]
    inertia, rows, carried, velocity = free_bodies(facts, q, tips[0])
    first, number = int(facts.floating_base is not None), facts.link_of(facts.hands[0])
    here = slice(6 * (first + number - 1), 6 * (first + number))
    other = np.zeros_like(carried)
    other[:, here] = pin.SE3(np.eye(3), tips[1].translation).toActionMatrixInverse()
    both = np.vstack((carried, other))
    for row, (tool, tip) in enumerate(zip((TOOL, OTHER), tips, strict=True)):
        own = np.flatnonzero(np.any(both[6 * row : 6 * row + 6] != 0.0, axis=0))
        block = slice(6 * (own[0] // 6), 6 * (own[0] // 6) + 6)
        inertia[block, block] += tip.act(pin.Inertia(tool.mass, tool.com, tool.inertia)).matrix()
    whole = np.block([[inertia, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    moved = np.linalg.lstsq(whole, np.vstack((both.T, np.zeros((len(rows), 12)))), rcond=None)[0][: len(inertia)]
    return both @ moved, velocity @ moved


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, floating=st.booleans())
def test_an_impulse_on_one_hand_moves_the_other_as_the_free_bodies_of_the_tree_do(seed: int, floating: bool) -> None:
    """J (M + B)^-1 J^T with J of both hands: own and coupling blocks. Kills: a hand without mass, or with its own M."""
    facts, model, q = random_hands(np.random.default_rng(seed), floating)
    jacobian = np.vstack((model.jacobian(q), model.jacobian(q, "other")))
    response = jacobian @ np.linalg.solve(model.mass_matrix(q), jacobian.T)
    twists, velocity = by_free_bodies(facts, model, q)
    np.testing.assert_allclose(response, twists, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(np.linalg.solve(model.mass_matrix(q), jacobian.T), velocity, rtol=1e-6, atol=1e-7)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, restitution=st.floats(0.0, 1.0), floating=st.booleans())
def test_two_hands_hit_as_the_free_bodies_of_the_tree_do(seed: int, restitution: float, floating: bool) -> None:
    """0 <= L perpendicular to G L + (1 + e) c >= 0 at two smooth points of each hand, G by maximal coordinates.

    Solved as least squares under L >= 0 (Lawson and Hanson); u^+ of robot and object from these impulses. Kills: a
    second block of velocities for the other hand, Delassus blocks between hands left out.
    """
    rng = np.random.default_rng(seed)
    scenario = validate(Scenario, hands_scenario(), "mine.yaml")
    physics = Physics.nominal(scenario, "box")
    facts, model, q = random_hands(rng, floating)
    arm = replace(physics.arms["robot"], facts=facts, end_effector=TOOL, hands={"other": OTHER}, base=model.base)
    arm = replace(arm, motor_inertia_reduced=np.full(facts.joint_count, 1e-12))
    physics = replace(physics, arms={"robot": arm}, restitution=restitution, pad_friction=0.0)
    body = BodyState(rng.uniform(-0.5, 0.5, 3), pin.exp3(rng.standard_normal(3)), rng.standard_normal(6))
    points, wrenches = [], []
    for row, (pad, hand) in enumerate((("robot", ""), ("other", "other"))):
        tip, normal = model.placement(q, hand), rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        for offset in rng.uniform(-0.05, 0.05, (2, 3)):
            points.append(ContactPoint(pad, tip.translation + offset, normal, 0.0, 0.0))
            wrench = np.zeros(12)
            wrench[6 * row : 6 * row + 6] = np.concatenate((normal, np.cross(offset, normal)))
            wrenches.append(wrench)
    of_hands = np.array(wrenches)
    of_object = np.array([[*p.normal, *np.cross(p.position - body.position, p.normal)] for p in points])
    own = pin.Inertia(physics.object.mass, physics.object.com_offset, np.diag(physics.object.inertia))
    spatial = pin.SE3(body.rotation, np.zeros(3)).act(own).matrix()
    twists, velocity = by_free_bodies(facts, model, q)
    start = rng.standard_normal(model.joint_count)
    jacobian = np.vstack((model.jacobian(q), model.jacobian(q, "other")))
    speed = of_object @ body.twist - of_hands @ jacobian @ start
    delassus = of_object @ np.linalg.solve(spatial, of_object.T) + of_hands @ twists @ of_hands.T
    wanted = speed + restitution * np.minimum(speed, 0.0)
    root = scipy.linalg.sqrtm(delassus).real
    assume(np.min(speed) < -0.1 and np.linalg.cond(delassus) < 1e6)
    impulse, _ = scipy.optimize.nnls(root, -np.linalg.solve(root, wanted))
    after = np.concatenate(
        (start - velocity @ of_hands.T @ impulse, body.twist + np.linalg.solve(spatial, of_object.T @ impulse))
    )
    impact = MeasuredImpact({"robot": ArmState(q, start)}, body, tuple(points))
    found, _ = solve_measured(physics, impact, may_gain_energy=True)
    np.testing.assert_allclose(found, after, rtol=1e-5, atol=1e-5)


def test_a_hand_from_a_urdf_is_where_mujoco_has_it(tmp_path: Path) -> None:
    """Pose and Jacobian of the right hand by MuJoCo, which reads the URDF itself; through the written file."""
    (tmp_path / "robot.urdf").write_text(DUAL_ARM, encoding="utf-8")
    robot = import_urdf(tmp_path / "robot.urdf", tip="left_hand_pad", move=["right_*"], hands=["right_hand"])
    save_facts(robot, "A robot.", tmp_path / "robot.yaml")
    facts = load_facts(str(tmp_path / "robot.yaml"))
    assert facts == robot.facts and [hand.name for hand in facts.hands] == ["right_hand"] and not facts.is_chain
    nothing = EndEffector(1e-12, np.zeros(3), 1e-15 * np.eye(3), 0.0, 0.0, (0.01, 0.01, 0.01))
    model, theirs = RobotModel(facts, nothing, hands={"right_hand": nothing}), mujoco.MjModel.from_xml_string(DUAL_ARM)
    data = mujoco.MjData(theirs)
    rows = [theirs.joint(name).dofadr[0] for name in robot.joints]
    q = np.array([0.3, 0.4, -0.2, 0.5, 0.1])
    data.qpos[rows] = q
    mujoco.mj_forward(theirs, data)
    body, found = theirs.body("right_hand").id, model.placement(q, "right_hand")
    np.testing.assert_allclose(found.translation, data.xpos[body], atol=1e-9)
    np.testing.assert_allclose(found.rotation, data.xmat[body].reshape(3, 3), atol=1e-9)
    linear, angular = np.zeros((2, 3, theirs.nv))
    mujoco.mj_jacBody(theirs, data, linear, angular, body)
    np.testing.assert_allclose(model.jacobian(q, "right_hand"), np.vstack((linear, angular))[:, rows], atol=1e-9)
    with pytest.raises(InputError, match="--hand: no link 'rihgt_hand' among the kept ones.*right_hand"):
        import_urdf(tmp_path / "robot.urdf", tip="left_hand_pad", move=["right_*"], hands=["rihgt_hand"])


# ---------------------------------------------------------------------------------------------------------------------
# Two arms on a torso with a box between their hands


def scene_of(data: dict[str, Any]) -> Scene:
    return Scene.resolve(validate(Scenario, data, "mine.yaml"), "box", "case_1")


def solved(data: dict[str, Any]) -> tuple[Scene, ImpactProblem, ImpactResult]:
    scene = scene_of(data)
    problem = ImpactProblem.at_nominal_impact(scene)
    return scene, problem, compute_impact_map(problem)


@pytest.mark.parametrize("floating", [False, True])
def test_mirrored_hands_stop_a_box_between_them(floating: bool) -> None:
    """Equal hits from both sides: mirrored impulses and joints; nothing turns or moves sideways, nor the box at all."""
    _, problem, result = solved(hands_scenario(floating))
    impulse = {name: sum(c.impulse for c in result.contacts if c.body_b == name) for name in ("robot", "right")}
    np.testing.assert_allclose(impulse["robot"], [1.0, -1.0, 1.0] * impulse["right"], atol=1e-9)
    assert impulse["right"][1] > 0.05
    np.testing.assert_allclose(result.object_twist, 0.0, atol=1e-9)
    *base, waist, left, right = result.joint_velocity["robot"]
    np.testing.assert_allclose([*base[1:6:2], *base[5:6], waist, left + right], 0.0, atol=1e-9)  # vy, wx, wz
    if not floating:
        assert kinetic_energy(problem) > 0.05 > 1e-9 > kinetic_energy(problem, result)


@pytest.mark.parametrize("floating", [False, True])
def test_hands_that_are_too_fast_are_refused_with_joint_and_unit(floating: bool) -> None:
    """Kills: the components of a floating base are counted as joints."""
    with pytest.raises(Infeasible, match=r"needs -10 rad/s in joint 2, its limit is 9 rad/s"):
        scene_of(hands_scenario(floating, left=[0.0, -3.0, 0.0], right=[0.0, 1.5, 0.0]))


def test_a_hit_of_the_left_hand_moves_the_right_one_over_the_torso() -> None:
    """The right hand rests at the box: by Gauss' principle with one contact on each hand and all velocities in one row.

    Kills: the coupling block J_left M^-1 J_right^T left out.
    """
    scene, problem, result = solved(hands_scenario(right=[0.0, 0.0, 0.0], round_pads=True))
    arm, model, object_ = problem.arms["robot"], scene.models["robot"], scene.physics.object
    rows = np.zeros((2, 9))  # n of left into the box is -y, of right +y
    rows[0, :3], rows[1, :3] = model.jacobian(arm.position)[1], -model.jacobian(arm.position, "right")[1]
    rows[0, 4], rows[1, 4] = -1.0, 1.0
    inertia = scipy.linalg.block_diag(
        model.inertia(arm.position, problem.motor_inertia["robot"]), object_.mass * np.eye(3), np.diag(object_.inertia)
    )
    before = np.concatenate((arm.velocity, np.zeros(6)))
    impulse = -np.linalg.solve(rows @ np.linalg.solve(inertia, rows.T), rows @ before)
    after = before + np.linalg.solve(inertia, rows.T @ impulse)
    assert np.all(impulse > 0.0)
    np.testing.assert_allclose(result.object_twist, after[3:], atol=1e-7)
    np.testing.assert_allclose(result.joint_velocity["robot"], after[:3], atol=1e-7)
    mobility = rows[:, :3] @ np.linalg.solve(inertia[:3, :3], rows[:, :3].T)
    assert abs(mobility[0, 1]) > 0.03 * mobility[0, 0]
    assert abs(after[0]) > 0.03  # the torso turns, which did not before
    assert abs(before[0]) < 1e-9


def test_a_torso_as_heavy_as_the_earth_carries_two_separate_arms() -> None:
    """The map of two robots, each mounted where the torso has its shoulder, to all digits that are left of 1e9 kg."""
    data = hands_scenario(left=[0.0, -0.5, 0.0], right=[0.0, 0.3, 0.0], friction=0.4)
    torso = data["robots"]["robot"]["facts"]["links"][0]
    torso |= {"mass": 1e9, "com": [0.0, 0.0, 0.0], "inertia": [1e9, 0.0, 0.0, 1e9, 0.0, 1e9]}
    _, problem, one = solved(data)
    whole, parts = problem.physics.arms["robot"], {}
    facts, tools = whole.facts, {"robot": whole.end_effector, **whole.hands}
    for number, (name, flange) in enumerate((("robot", facts.flange), ("right", facts.hands[0])), start=1):
        own = {
            "joints": (facts.joints[number].model_copy(update={"parent": ""}),),
            "flange": facts.flange.model_copy(update={"xyz": flange.xyz, "rpy": flange.rpy, "link": ""}),
            "hands": (),
            "links": (facts.links[number],),
            "limits": type(facts.limits)(**{key: values[:1] for key, values in facts.limits}),
        }
        motor = whole.motor_inertia_reduced[number : number + 1]
        arm = replace(whole, facts=facts.model_copy(update=own), end_effector=tools[name], hands={})
        parts[name] = replace(arm, motor_inertia_rotor=motor, motor_inertia_reduced=motor)
    state = problem.arms["robot"]
    two = ImpactProblem(
        physics=replace(problem.physics, arms=parts),
        arms={
            name: ArmState(state.position[place], state.velocity[place])
            for name, place in (("robot", slice(1, 2)), ("right", slice(2, 3)))
        },
        object=problem.object,
        motor_inertia={name: part.motor_inertia_reduced for name, part in parts.items()},
    )
    assert abs(state.velocity[0]) < 1e-6  # the torso rests before, too heavy to be moved
    answer = compute_impact_map(two)
    np.testing.assert_allclose(one.object_twist, answer.object_twist, atol=2e-6)
    for name, joint in (("robot", 1), ("right", 2)):
        np.testing.assert_allclose(one.joint_velocity["robot"][joint], answer.joint_velocity[name][0], atol=2e-6)
        np.testing.assert_allclose(one.end_effector_twist[name], answer.end_effector_twist[name], atol=2e-6)


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS, friction=st.floats(0.0, 0.8))
def test_a_floating_robot_and_the_box_between_its_hands_keep_their_momentum(seed: int, friction: float) -> None:
    """Linear and angular momentum of all, about the origin of A; no energy is gained."""
    rng = np.random.default_rng(seed)
    scene = scene_of(hands_scenario(True, left=[0.0, -0.5, 0.0], right=[0.0, 0.3, 0.0], friction=friction))
    problem = ImpactProblem.at_nominal_impact(scene)
    arm = problem.arms["robot"]
    problem = replace(
        problem,
        arms={"robot": ArmState(arm.position, arm.velocity + 0.05 * rng.standard_normal(arm.velocity.size))},
        motor_inertia={"robot": np.zeros(3)},
        object=replace(problem.object, position=problem.object.position, twist=0.02 * rng.standard_normal(6)),
        physics=replace(problem.physics, support_height=None),
    )
    result = compute_impact_map(problem)

    def momentum(velocity: Array, twist: Array) -> Array:
        model, body = scene.models["robot"], problem.object
        pin.computeCentroidalMomentum(model.pinocchio, model.data, arm.position, velocity)
        of_robot = pin.SE3(np.eye(3), model.data.com[0]).act(model.data.hg).vector
        object_ = problem.physics.object
        inertia = pin.SE3(body.rotation, body.position).act(
            pin.Inertia(object_.mass, object_.com_offset, np.diag(object_.inertia))
        )
        return np.asarray(
            of_robot + inertia.matrix() @ np.append(twist[:3] + np.cross(body.position, twist[3:]), twist[3:])
        )

    before = momentum(problem.arms["robot"].velocity, problem.object.twist)
    np.testing.assert_allclose(momentum(result.joint_velocity["robot"], result.object_twist), before, atol=1e-8)
    assert sum(float(np.linalg.norm(one.impulse)) for one in result.contacts) > 0.05
    assert kinetic_energy(problem, result) <= kinetic_energy(problem) * (1.0 + 1e-9)


def test_all_laws_of_the_map_know_both_hands() -> None:
    """Settled contact: the faces stay on the box. Poisson without restitution is Newton. Derivatives by differences."""
    scene, problem, result = solved(hands_scenario(left=[0.0, -0.5, 0.0], right=[0.0, 0.2, 0.0], friction=0.4))
    poisson = compute_impact_map(replace(problem, restitution_law="poisson"))
    np.testing.assert_allclose(poisson.joint_velocity["robot"], result.joint_velocity["robot"], atol=1e-7)
    np.testing.assert_allclose(poisson.end_effector_twist["right"], result.end_effector_twist["right"], atol=1e-7)
    lasting = settle(problem)
    for name in ("robot", "right"):
        assert lasting.end_effector_twist[name][1] == pytest.approx(lasting.object_twist[1], abs=0.05)
    found, step = differentiate(problem, scene.models), 1e-5
    assert {"robot.contact_point.x", "right.contact_point.y"} <= {one.name for one in found.parameters}
    sides = []
    for sign in (1.0, -1.0):
        arm = problem.arms["robot"]
        moved = ArmState(arm.position, arm.velocity + sign * step * np.eye(3)[2])
        sides.append(compute_impact_map(replace(problem, arms={"robot": moved})).end_effector_twist["right"])
    rows = [name.startswith("right.") for name in found.names]
    assert sum(rows) == 6
    np.testing.assert_allclose(found.of("robot.velocity.3")[rows], (sides[0] - sides[1]) / (2.0 * step), atol=1e-5)


REFUSED: list[tuple[str, Any, str]] = [
    ("robots.robot.hands.rihgt", "rename", "hands.rihgt: by hand has no such hand; it has: right.*--hand LINK"),
    ("robots.robot.hands.right.impact", {"position": [0, 0, 1], "pad_normal": [0, 1, 0], "pad_up": [0, 0, 1]},
     "hands.right.impact: joint_position says where the hand is"),
    ("cases.case_1.robots.robot.hands", {}, "case_1.robots.robot.hands names .., expected a velocity of each hand"),
    ("robots.robot.hands.right.end_effector", "absent", "robots.robot.hands.right.end_effector"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value", "message"), REFUSED)
def test_mistakes_in_hands_name_key_and_remedy(key: str, value: Any, message: str) -> None:
    data = hands_scenario()
    *above, last = key.split(".")
    place: Any = data
    for part in above:
        place = place[int(part) if part.isdigit() else part]
    if value == "rename":
        place[last] = place.pop("right")
    elif value == "absent":
        place.pop(last)
    else:
        place[last] = value
    with pytest.raises(InputError, match=message):
        validate(Scenario, data, "mine.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"link": "nowhere"}, "hands.0.link: 'nowhere' is no link that moves; there are: base, torso, left_arm"),
        ({"link": "base"}, "hands.0.link: 'base' is no link that moves"),
        ({"name": ""}, "hands.0.name"),
    ],
)
def test_facts_whose_hand_is_nowhere_are_refused(change: dict[str, str], message: str) -> None:
    facts = hands_scenario()["robots"]["robot"]["facts"]
    facts["hands"][0] |= change
    with pytest.raises(InputError, match=message):
        validate(RobotFacts, facts, "robot.yaml")


def test_hands_called_as_another_body_are_refused() -> None:
    data = json.loads(json.dumps(hands_scenario()).replace('"right"', '"object"'))
    with pytest.raises(InputError, match="robots.robot.hands.object: another body has this name"):
        validate(Scenario, data, "mine.yaml")


def test_hands_that_do_not_meet_the_object_at_once_are_refused() -> None:
    data = hands_scenario()
    data["objects"]["box"]["size"][1] -= 0.012
    with pytest.raises(Infeasible, match="'robot' is 6 mm from the object, accepted are 1 mm"):
        ImpactProblem.at_nominal_impact(scene_of(data))


def test_velocities_that_the_joints_cannot_give_to_both_hands_are_refused() -> None:
    with pytest.raises(UnreachablePose, match="ante_velocity .* and of right .* m/s is beyond these joints there"):
        scene_of(hands_scenario(left=[0.0, 0.0, 0.3], right=[0.0, 0.3, 0.0]))


def test_the_command_prints_both_hands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(hands_scenario()))), encoding="utf-8")
    assert main(["map", str(tmp_path / "mine.yaml"), "box", "case_1", "--json", "--derivatives", "--uncertainty"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer["post"]["end_effector_twist"]) == {"robot", "right"} == set(answer["ante"]["end_effector_twist"])
    assert list(answer["post"]["joint_velocity"]) == ["robot"]
    assert answer["residual"]["momentum"] < 1e-9
