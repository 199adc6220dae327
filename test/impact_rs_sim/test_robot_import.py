# SPDX-License-Identifier: Apache-2.0
"""A foreign URDF and the facts made from it are the same arm; what cannot be read is refused in one line."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from trials import nominal_physics

from impact_rs_sim.assumed_drive import assumed_drive
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import JointFriction
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.plant.bullet_world import mass_matrices
from impact_rs_sim.robots.robot import EndEffector, load_facts
from impact_rs_sim.robots.robot_import import FULL_TURN_RAD, facts_text, import_urdf, save_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.robots.urdf import write_description
from impact_rs_sim.robots.urdf_repairs import suspected_steiner_ratio
from impact_rs_sim.scene import ArmState, BodyState

PERIOD = 2.5e-4  # s, of the torque loop
LIMIT = '<limit lower="-2" upper="1.5" velocity="3" effort="40"/>'
BODY = """<inertial><origin xyz="0.1 0.02 0.03" rpy="0.1 0.2 0.3"/><mass value="2"/>
<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="0.003" izz="0.025"/></inertial>"""


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT, xyz: str = "0 0 0.2") -> str:
    origin = f'<origin xyz="{xyz}" rpy="0.3 -0.2 0.1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{origin}{inside}</joint>'
    )


def link(name: str, inside: str = BODY) -> str:
    return f'<link name="{name}">{inside}</link>'


ARM = (link("base"), link("upper"), link("fore"), joint("shoulder", "base", "upper"), joint("elbow", "upper", "fore"))


def write(folder: Path, *parts: str) -> Path:
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8")
    return file


def weightless() -> EndEffector:
    """So little on the flange that no test sees it."""
    return EndEffector(1e-15, np.zeros(3), 1e-18 * np.eye(3), 0.0, 0.0, (0.01, 0.01, 0.01))


def random_chain(rng: np.random.Generator, count: int) -> str:
    """Joints that turn or slide, with random axes, placements and bodies; a link beside each; a flange askew."""

    def numbers(values: np.ndarray) -> str:
        return " ".join(repr(float(value)) for value in values)

    def placement() -> str:
        return f'<origin xyz="{numbers(rng.uniform(-0.4, 0.4, 3))}" rpy="{numbers(rng.uniform(-3, 3, 3))}"/>'

    def body() -> str:
        points = rng.standard_normal((6, 3)) * 0.1  # a cloud of points is a body
        inertia = sum(np.dot(p, p) * np.eye(3) - np.outer(p, p) for p in points - points.mean(axis=0))
        entries = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), inertia[np.triu_indices(3)], strict=True)
        told = " ".join(f'{name}="{float(value)!r}"' for name, value in entries)
        return f'<inertial>{placement()}<mass value="{rng.uniform(0.2, 6)!r}"/><inertia {told}/></inertial>'

    named = ["0 0 1", "0 0 -1", "0 1 0", "-1 0 0"]
    parts, before = [link("base", "")], "base"
    for index in range(count):
        axis = named[rng.integers(4)] if rng.random() < 0.3 else numbers(rng.standard_normal(3))
        inside, moves = f'<axis xyz="{axis}"/>{LIMIT}', "prismatic" if rng.random() < 0.35 else "revolute"
        name, beside = f"link_{index}", f"beside_{index}"
        parts += [link(name, body()), link(beside, body())]
        for child, kind, what in ((name, moves, inside), (beside, "fixed", "")):
            parent = before if child == name else name
            parts.append(
                f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
                f"{placement()}{what}</joint>"
            )
        before = name
    parts += [link("tool", ""), f'<joint name="mount" type="fixed"><parent link="{before}"/><child link="tool"/>']
    return f'<robot name="arm">{"".join(parts)}{placement()}</joint></robot>'


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 8))
def test_the_facts_of_any_chain_have_the_dynamics_of_its_urdf(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int
) -> None:
    """M, g and J of the flange, through the written file, as Pinocchio has them of the URDF; Bullet's M as well."""
    rng = np.random.default_rng(seed)
    text = random_chain(rng, count)
    folder = tmp_path_factory.mktemp("chain")
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    save_facts(import_urdf(folder / "arm.urdf", tip="tool"), "An arm.", folder / "arm.yaml")
    facts = load_facts(str(folder / "arm.yaml"))
    ours = RobotModel(facts, weightless())
    theirs = pin.buildModelFromXML(text)
    data, frame = theirs.createData(), theirs.getFrameId("tool", pin.FrameType.BODY)
    positions = rng.uniform(-2.0, 1.5, (3, count))
    for q in positions:
        mass = np.triu(pin.crba(theirs, data, q))
        mass += np.triu(mass, 1).T
        np.testing.assert_allclose(ours.mass_matrix(q), mass, atol=1e-9 * np.abs(mass).max())
        gravity = pin.computeGeneralizedGravity(theirs, data, q)
        np.testing.assert_allclose(ours.gravity_torque(q), gravity, atol=1e-9 * max(1.0, np.abs(gravity).max()))
        jacobian = pin.computeFrameJacobian(theirs, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(ours.jacobian(q), jacobian, atol=1e-9)
        pin.framesForwardKinematics(theirs, data, q)
        np.testing.assert_allclose(ours.placement(q).homogeneous, data.oMf[frame].homogeneous, atol=1e-9)
    bullet = mass_matrices(facts, weightless(), positions)
    for q, matrix in zip(positions, bullet, strict=True):
        np.testing.assert_allclose(matrix, ours.mass_matrix(q), atol=1e-6 * np.abs(matrix).max())


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 8))
def test_any_chain_hits_a_box_without_diverging(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int
) -> None:
    """A box without weight before the pad, an assumed drive: the box goes ahead, and nobody gains energy."""
    rng = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("chain")
    (folder / "arm.urdf").write_text(random_chain(rng, count), encoding="utf-8")
    facts = import_urdf(folder / "arm.urdf", tip="tool").facts.model_copy(update={"joint_torque_loop": True})
    push = nominal_physics("cat_food")
    effector = push.arms["arm"].end_effector
    drive = {name: np.array(row) for name, row in assumed_drive(facts, effector, PERIOD).items()}
    still, one = np.zeros(count), np.ones(count)
    arm = replace(
        push.arms["arm"],
        facts=facts,
        friction=JointFriction.none(count),
        torque_offset=still,
        torque_gain=one,
        **drive,
    )
    physics = replace(push, arms={"arm": arm}, support_height=None, gravity=np.zeros(3))
    model = physics.robot_model("arm")
    q = rng.uniform(-1.5, 1.0, count)
    pad = model.placement(q)
    jacobian = model.jacobian(q)
    normal = pad.rotation[:, 2]
    row = normal @ jacobian[:3]
    dq = row * 0.3 / max(row @ row, 0.05)
    approach = float(row @ dq)
    assume(approach > 0.02)
    half = physics.object.size[2] / 2.0
    box = BodyState(pad.translation + (half + 1e-4) * normal, pad.rotation, np.zeros(6))
    mechanics = BulletMechanics.load(physics, PERIOD, may_sleep=False)
    mechanics.start({"arm": ArmState(q, dq)}, {"arm": DriveStart(still, still)}, box)
    inertia = model.mass_matrix(q) + np.diag(arm.motor_inertia_reduced)
    before = 0.5 * dq @ inertia @ dq
    for _ in range(20):
        mechanics.step({"arm": still}, 10, 0.0)
    link, thing, motor = mechanics.links["arm"], mechanics.world.object_state(), mechanics.drives["arm"].velocity
    mechanics.close()
    mass = model.mass_matrix(link.position)
    after = 0.5 * (link.velocity @ mass @ link.velocity + motor @ np.diag(arm.motor_inertia_reduced) @ motor)
    after += 0.5 * physics.object.mass * thing.twist[:3] @ thing.twist[:3]
    assert np.isfinite(after)
    assert after < 1.02 * before
    assert thing.twist[:3] @ normal > 0.0


def test_an_arm_that_turns_about_z_keeps_its_numbers(tmp_path: Path) -> None:
    parts = [part.replace("<limit", '<axis xyz="0 0 1"/><limit') for part in ARM]
    facts = import_urdf(write(tmp_path, *parts)).facts
    assert facts.joints[1].xyz == (0.0, 0.0, 0.2)
    assert facts.joints[1].rpy == pytest.approx((0.3, -0.2, 0.1), abs=1e-15)
    assert facts.links[0].com == (0.1, 0.02, 0.03)
    assert facts.limits.position_min_rad == (-2.0, -2.0)
    assert facts.limits.position_max_rad == (1.5, 1.5)
    assert facts.limits.velocity_rad_s == (3.0, 3.0)
    assert facts.limits.torque_Nm == (40.0, 40.0)
    assert facts.flange.rpy == (0.0, 0.0, 0.0)


def test_a_continuous_joint_gets_a_full_turn_to_either_side(tmp_path: Path) -> None:
    endless = joint("elbow", "upper", "fore", "continuous", '<limit velocity="3" effort="40"/>')
    robot = import_urdf(write(tmp_path, *ARM[:4], endless))
    assert robot.facts.limits.position_min_rad == (-2.0, -FULL_TURN_RAD)
    assert robot.facts.limits.position_max_rad == (1.5, FULL_TURN_RAD)
    assert any("elbow" in note and "full turn" in note for note in robot.notes)
    assert "elbow" in facts_text(robot, "An arm.").split("source:")[0]


def test_fixed_links_join_the_chain_up_to_the_flange(tmp_path: Path) -> None:
    camera, hand = joint("screws", "upper", "camera", "fixed", ""), joint("mount", "fore", "hand", "fixed", "")
    fingers = joint("grip", "hand", "finger", "prismatic")
    robot = import_urdf(
        write(tmp_path, *ARM, link("camera"), camera, link("hand"), hand, link("finger"), fingers), tip="fore"
    )
    assert [body.mass for body in robot.facts.links] == [4.0, 2.0]
    notes = " ".join(robot.notes)
    assert "camera" in notes and "hand, finger" in notes


def test_a_base_further_out_leaves_the_rest_behind(tmp_path: Path) -> None:
    robot = import_urdf(write(tmp_path, *ARM), base="upper")
    assert robot.joints == ("elbow",)


def test_a_mesh_beside_the_urdf_is_kept_and_one_that_is_not_there_is_noted(tmp_path: Path) -> None:
    names = ("meshes/here.stl", "meshes/away.stl", "package://nowhere/arm.stl", "model://arm/arm.stl")
    (tmp_path / "meshes").mkdir()
    here = tmp_path / "meshes" / "here.stl"
    here.touch()
    visuals = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in names)
    robot = import_urdf(write(tmp_path, link("base"), link("upper", BODY + visuals), *ARM[2:]))
    away = here.with_name("away.stl").as_uri()
    assert [mesh.file for mesh in robot.facts.links[0].meshes] == [here.as_uri(), away, names[2]]
    notes = [note for note in robot.notes if note.startswith("Mesh")]
    assert len(notes) == 3
    assert f"{names[3]} of link upper is left out" in notes[0]
    assert names[2] in notes[1] and "--package-path DIR" in notes[1]
    assert away in notes[2] and not any(here.as_uri() in note for note in notes)


def test_the_file_tells_what_a_urdf_does_not_hold(tmp_path: Path) -> None:
    text = facts_text(import_urdf(write(tmp_path, *ARM), source='a "maker", BSD'), "An arm.")
    for key in ("motor_inertia_rotor", "motor_inertia_reduced", "stiffness", "damping", "friction"):
        assert key in text.split("source:")[0]
    path = tmp_path / "arm.yaml"
    path.write_text(text, encoding="utf-8")
    assert load_facts(str(path)).source == 'a "maker", BSD'


def test_torque_sensors_are_not_made_up_and_links_keep_their_names(tmp_path: Path) -> None:
    robot = import_urdf(write(tmp_path, *ARM))
    save_facts(robot, "An arm.", tmp_path / "arm.yaml")
    facts = load_facts(str(tmp_path / "arm.yaml"))
    assert not facts.joint_torque_loop
    assert any("A URDF does not say whether joints measure their torque" in note for note in robot.notes)
    assert [link.name for link in facts.links] == ["upper", "fore"]


def test_negative_moments_of_all_links_are_refused_by_name_and_axis(tmp_path: Path) -> None:
    """Of the second link no entry on the diagonal is negative, but a principal moment is."""
    negative = BODY.replace('iyy="0.03"', 'iyy="-0.03"')
    tilted = BODY.replace('ixy="0.001"', 'ixy="0.05"')
    file = write(tmp_path, link("base"), link("upper", negative), link("fore", tilted), *ARM[3:])
    with pytest.raises(InputError, match="moments of inertia of bodies are positive") as refused:
        import_urdf(file)
    assert "link upper has iyy = -0.03 kg m^2; link fore has a principal moment of -0.02" in str(refused.value)


def elbow(kind: str = "revolute", inside: str = LIMIT, **changes: str) -> list[str]:
    """The arm with another last joint."""
    return [
        *ARM[:4],
        joint(**{"name": "elbow", "parent": "upper", "child": "fore", "kind": kind, "inside": inside} | changes),
    ]


GRIP = [*ARM, link("finger"), joint("grip", "upper", "finger", "prismatic")]
HALF = link("upper", '<inertial><mass value="1"/></inertial>')
NO_FORCE, NO_WAY = LIMIT.replace("40", "0"), '<limit velocity="3" effort="40"/>'
NO_EFFORT = '<limit lower="-1" upper="1" velocity="3"/>'
REFUSED: list[tuple[list[str], dict[str, Any], str]] = [  # parts, arguments, what the line names
    (elbow("planar"), {}, "elbow: .* is planar; expected one of revolute, continuous, prismatic"),
    (elbow("prismatic", NO_FORCE), {}, r"elbow: limit effort: expected > 0 \[N\], found 0"),
    (elbow("prismatic", NO_WAY), {}, r"elbow: limit: expected lower < upper \[m\], found 0 and 0"),
    (
        elbow(inside=f'{LIMIT}<mimic joint="sholder"/>'),
        {},
        "elbow: mimic: it follows 'sholder', expected another joint",
    ),
    (elbow(inside=f'{LIMIT}<mimic joint="elbow"/>'), {}, "elbow: mimic: it follows 'elbow', expected another joint"),
    (elbow("floating"), {}, "elbow: .* is floating; expected one of .*, or --base fore --floating"),
    ([*ARM, link("other"), joint("third", "upper", "other")], {}, "--tip: fore, other"),
    ([link("base"), link("upper", ""), *ARM[2:]], {}, "link upper: expected an <inertial> with a mass > 0"),
    ([link("base"), HALF, *ARM[2:]], {}, "link upper: inertia ixx: this is missing"),
    (elbow(inside=NO_EFFORT), {}, "elbow: limit effort: this is missing"),
    (elbow("continuous", ""), {}, "elbow: limit velocity: this is missing"),
    (elbow(inside=NO_FORCE), {}, r"elbow: limit effort: expected > 0 \[N m\], found 0"),
    (elbow(inside=LIMIT.replace("1.5", "-2")), {}, "elbow: limit: expected lower < upper"),
    (elbow(xyz="0 0 high"), {}, "elbow: origin xyz: expected 3 finite numbers, found '0 0 high'"),
    (elbow(inside='<axis xyz="0 0 0"/>' + LIMIT), {}, "length 0"),
    ([link("base"), link("upper"), joint("weld", "base", "upper", "fixed")], {}, "no joint moves below"),
    ([*ARM, link("astray")], {}, "links that hang on no joint: base, astray"),
    ([*ARM, link("a"), link("b"), joint("ab", "a", "b"), joint("ba", "b", "a")], {}, "in a ring: a, b"),
    ([*ARM, joint("again", "base", "fore")], {}, "link 'fore' hangs on joint 'elbow' as well"),
    (elbow(parent="uper"), {}, "its parent is 'uper'"),
    ([*ARM, link("fore")], {}, "link fore: there are two links of this name"),
    (elbow("hinge"), {}, "unknown type 'hinge'"),
    ([], {}, "no link"),
    (list(ARM), {"tip": "for"}, "no link 'for' for --tip; did you mean 'fore'"),
    (list(ARM), {"base": "bas"}, "no link 'bas' for --base; did you mean 'base'"),
    (list(ARM), {"base": "fore", "tip": "upper"}, "no chain leads from 'fore' to 'upper'"),
    (list(ARM), {"base": "base", "tip": "base"}, "no joint moves between"),
    (GRIP, {"tip": "fore", "move": ["grap"]}, "no joint 'grap' moves beside the path to the tip.*did you mean 'grip'"),
    (GRIP, {"tip": "fore", "lock": ["grap=0"]}, "no joint 'grap' moves; did you mean 'grip'"),
    (GRIP, {"tip": "fore", "lock": ["grip"]}, "--lock = 'grip': expected JOINT=PLACE, a number in rad or m"),
    (GRIP, {"tip": "fore", "lock": ["grip=open"]}, "--lock = 'grip=open': expected JOINT=PLACE"),
    (GRIP, {"tip": "fore", "lock": ["grip=nan"]}, "--lock = 'grip=nan': expected JOINT=PLACE"),
    *(
        (list(ARM), {"limits": [text]}, "expected JOINT.position=LOW:HIGH")
        for text in ("elbow.effort", "elbow.effort=1:2", "elbow.position=1", "elbow.effort=inf", "elbow.torque=3")
    ),
    (list(ARM), {"limits": ["elbo.effort=3"]}, "no joint 'elbo'; did you mean 'elbow'"),
    (list(ARM), {"limits": ["elbow.effort=0"]}, "expected > 0"),
]


@pytest.mark.parametrize(("parts", "arguments", "message"), REFUSED)
def test_what_is_no_arm_is_refused_in_one_line(
    tmp_path: Path, parts: list[str], arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as told:
        import_urdf(write(tmp_path, *parts), **arguments)
    assert "\n" not in str(told.value)


@settings(max_examples=20, deadline=None)
@given(st.floats(-1.5, 1.5), st.floats(-0.2, 0.2), st.floats(-1.5, 1.5))
def test_a_joint_that_was_held_is_fixed_where_it_stood(turn: float, slide: float, q: float) -> None:
    """Joints of the way and beside it: the arm left is the whole one with these coordinates."""
    parts = (
        *ARM,
        link("finger"),
        joint("grip", "upper", "finger", "prismatic"),
        link("wrist"),
        joint("roll", "fore", "wrist"),
    )
    with tempfile.TemporaryDirectory() as folder:
        file = write(Path(folder), *parts)
        whole = pin.buildModelFromXML(file.read_text(encoding="utf-8"))
        held = import_urdf(file, tip="wrist", lock=[f"[!er]*={turn!r}", f"grip={slide!r}"])  # a name goes before *
    assert held.joints == ("elbow", "roll")
    assert f"Joint grip is held at {slide:g} m, as given." in held.notes
    model = RobotModel(held.facts, weightless(), pin.SE3.Identity())
    places = {"shoulder": turn, "grip": slide, "elbow": q, "roll": -q}
    full = np.zeros(whole.nq)
    for name, place in places.items():
        full[whole.joints[whole.getJointId(name)].idx_q] = place
    data = whole.createData()
    rows = [whole.joints[whole.getJointId(name)].idx_v for name in held.joints]
    mass = pin.crba(whole, data, full)
    assert model.mass_matrix(np.array([q, -q])) == pytest.approx(mass[np.ix_(rows, rows)], abs=1e-9)
    weight = pin.computeGeneralizedGravity(whole, data, full)[rows]
    assert model.inverse_dynamics(np.array([q, -q]), np.zeros(2), np.zeros(2)) == pytest.approx(weight, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("arm.urdf.xacro", "<robot/>", "expand it first: xacro arm.urdf.xacro > robot.urdf"),
        ("arm.urdf", '<robot xmlns:xacro="x"><xacro:arm/></robot>', "this is xacro"),
        ("arm.urdf", '<robot><link name="${name}"/></robot>', "this is xacro"),
        ("arm.urdf", "<robot><link></robot>", "not valid XML"),
        ("arm.urdf", "<sdf/>", "the outermost element is <sdf>, expected <robot>"),
    ],
)
def test_a_file_that_is_no_urdf_is_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        import_urdf(tmp_path / name)


def test_a_urdf_that_xacro_made_is_taken(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    rest = '<ros2_control name="arm"><param name="min">${-2*pi}</param></ros2_control>'
    made = "<!-- made by\n <xacro:include filename='arm.xacro'/> -->"  # kills a search in comments
    file.write_text(f'<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">{made}{"".join(ARM)}{rest}</robot>')
    assert import_urdf(file).facts.joint_count == 2


def test_facts_are_never_overwritten_and_never_half_written(tmp_path: Path) -> None:
    robot = import_urdf(write(tmp_path, *ARM))
    target = tmp_path / "arm.yaml"
    target.write_text("mine")
    with pytest.raises(InputError, match="never overwritten"):
        save_facts(robot, "An arm.", target)
    with pytest.raises(InputError, match="ends in .yaml"):
        save_facts(robot, "An arm.", tmp_path / "arm.txt")
    assert target.read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.urdf", "arm.yaml"]


def test_a_folder_that_is_a_file_is_named_and_no_temporary_file(tmp_path: Path) -> None:
    """Kills the removal of a file that was never made, whose error hid the reason."""
    (tmp_path / "folder").write_text("a file", encoding="utf-8")
    with pytest.raises(InputError, match=r"folder/arm.yaml: cannot be written: \S*/folder is no folder"):
        save_facts(import_urdf(write(tmp_path, *ARM)), "An arm.", tmp_path / "folder" / "arm.yaml")


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 5))
def test_meshes_are_described_where_the_urdf_has_them(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int
) -> None:
    """Of base, links and what is fixed to them, through the written file; physics reads a URDF without meshes."""
    rng = np.random.default_rng(seed)
    robot = Xml.fromstring(random_chain(rng, count))
    placed: dict[str, tuple[str, pin.SE3]] = {}  # link and placement in it, by mesh
    for found in robot.findall("link"):
        name, file = found.get("name"), f"package://arm/{found.get('name')}.stl"
        xyz, rpy = rng.uniform(-0.3, 0.3, 3), rng.uniform(-3.0, 3.0, 3)
        visual = Xml.SubElement(found, "visual")
        Xml.SubElement(visual, "origin", xyz=" ".join(map(repr, xyz.tolist())), rpy=" ".join(map(repr, rpy.tolist())))
        Xml.SubElement(Xml.SubElement(visual, "geometry"), "mesh", filename=file, scale="0.001 0.001 0.001")
        placed[file] = name, pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
    folder = tmp_path_factory.mktemp("meshes")
    (folder / "arm.urdf").write_text(Xml.tostring(robot, encoding="unicode"), encoding="utf-8")
    save_facts(import_urdf(folder / "arm.urdf", tip="tool"), "An arm.", folder / "arm.yaml")
    facts = load_facts(str(folder / "arm.yaml"))
    assert "mesh" not in RobotModel(facts, weightless()).urdf

    text = write_description({"arm": (facts, weightless(), pin.SE3.Identity())}, None)
    ours, theirs = pin.buildModelFromXML(text), pin.buildModelFromXML(Xml.tostring(robot, encoding="unicode"))
    q = rng.uniform(-1.0, 1.0, count)
    frames = []
    for model in (ours, theirs):
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        frames.append({frame.name: data.oMf[index].copy() for index, frame in enumerate(model.frames)})
    shown = set()
    for found in Xml.fromstring(text).iter("link"):
        for visual in found.findall("visual"):
            if (mesh := visual.find("geometry/mesh")) is not None:
                origin = visual.find("origin")
                xyz, rpy = (np.array(origin.get(key).split(), dtype=float) for key in ("xyz", "rpy"))
                where = frames[0][found.get("name")] * pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
                name, inside = placed[mesh.get("filename")]
                np.testing.assert_allclose(where.homogeneous, (frames[1][name] * inside).homogeneous, atol=1e-9)
                assert mesh.get("scale") == "0.001 0.001 0.001"
                shown.add(mesh.get("filename"))
    assert shown == set(placed)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (BODY, BODY + BODY, "link upper: <link> has 2 <inertial>, expected one"),
        ('<mass value="2"/>', '<mass value="2"/><mass value="1"/>', "link base: <inertial> has 2 <mass>, expected one"),
        (
            '<origin xyz="0 0 0.2"',
            '<origin xyz="0 0 9"/><origin xyz="0 0 0.2"',
            "joint shoulder: <joint> has 2 <origin>",
        ),
        (LIMIT, f'<axis xyz="0 0 1"/><axis xyz="1 0 0"/>{LIMIT}', "joint shoulder: <joint> has 2 <axis>, expected one"),
        (LIMIT, LIMIT + LIMIT, "joint shoulder: <joint> has 2 <limit>, expected one"),
        ('name="elbow"', 'name="shoulder"', "joint shoulder: there are two joints of this name"),
    ],
)
def test_of_two_elements_none_is_taken(tmp_path: Path, old: str, new: str, said: str) -> None:
    parts = list(ARM)
    place = 1 if old == BODY else next(number for number, part in enumerate(parts) if old in part)
    parts[place] = parts[place].replace(old, new)
    with pytest.raises(InputError) as caught:
        import_urdf(write(tmp_path, *parts))
    assert said in str(caught.value)


@pytest.mark.parametrize("size", [1e200, 1e-3, 1.0])
def test_the_direction_of_an_axis_does_not_depend_on_its_length(tmp_path: Path, size: float) -> None:
    def facts(axis: str) -> RobotModel:
        parts = (*ARM[:3], joint("shoulder", "base", "upper", inside=f'<axis xyz="{axis}"/>{LIMIT}'), ARM[4])
        return RobotModel(import_urdf(write(tmp_path, *parts)).facts, weightless())

    q = np.array([0.3, -0.4])
    long, short = facts(f"{size!r} {-size!r} 0"), facts("1 -1 0")
    np.testing.assert_allclose(long.mass_matrix(q), short.mass_matrix(q), rtol=1e-12)
    np.testing.assert_allclose(long.jacobian(q), short.jacobian(q), atol=1e-12)


@pytest.mark.parametrize("number", ["3_7", "\uff11", "1d3"])
def test_numbers_of_a_urdf_are_decimal(tmp_path: Path, number: str) -> None:
    parts = [part.replace('<mass value="2"/>', f'<mass value="{number}"/>') for part in ARM]
    with pytest.raises(InputError, match="expected 1 finite number"):
        import_urdf(write(tmp_path, *parts))


# ---- what a URDF lacks or has wrong ---------------------------------------------------------------------------------


def test_a_parent_called_world_is_the_ground(tmp_path: Path) -> None:
    """As simulators write it, without a link of that name."""
    weld = '<joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>'
    robot = import_urdf(write(tmp_path, *ARM, weld))
    assert robot.facts.links == import_urdf(write(tmp_path, *ARM)).facts.links
    assert any("'world'" in note for note in robot.notes)
    with pytest.raises(InputError, match="its parent is 'ground', expected a link of this file"):
        import_urdf(write(tmp_path, *ARM, weld.replace("world", "ground")))


def test_limits_that_are_missing_or_0_are_given_by_hand_and_said(tmp_path: Path) -> None:
    bare = [*ARM[:3], joint("shoulder", "base", "upper", inside=""), joint("elbow", "upper", "fore", inside=LIMIT)]
    given = ["*.velocity=2", "*.effort=50", "shoulder.position=-1:1.2", "elbow.effort=9"]
    robot = import_urdf(write(tmp_path, *bare), limits=given)
    assert robot.facts.limits.position_min_rad == (-1.0, -2.0)
    assert robot.facts.limits.velocity_rad_s == (2.0, 2.0)
    assert robot.facts.limits.torque_Nm == (50.0, 9.0)
    assert "Limits of joint shoulder as given: -1 to 1.2 rad." in robot.notes
    assert "Effort limit of joint elbow as given: 9 N m." in robot.notes
    with pytest.raises(
        InputError, match=r"shoulder: limit: expected lower < upper .* --limits shoulder.position=LOW:HIGH"
    ):
        import_urdf(write(tmp_path, *bare), limits=given[:2])


def rod(mass: float, length: float, about_joint: bool, thick: float = 0.02) -> str:
    """Inertial of a rod along x, whose moments stand about its end or, as they should, about its middle."""
    across = mass * length**2 / (3.0 if about_joint else 12.0)
    moments = f'ixx="{mass * thick**2}" iyy="{across}" izz="{across}"'
    return (
        f'<inertial><origin xyz="{length / 2} 0 0"/><mass value="{mass}"/><inertia {moments} ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"
    )


def pendulum(folder: Path, inside: str) -> Path:
    axis = '<axis xyz="0 0 1"/>' + LIMIT
    parts = [link("base"), link("upper", inside), link("fore", inside), joint("shoulder", "base", "upper", inside=axis)]
    return write(folder, *parts, joint("elbow", "upper", "fore", inside=axis, xyz="0.6 0 0"))


def test_moments_about_the_joint_are_moved_to_the_centre_of_mass(tmp_path: Path) -> None:
    """Steiner: m l^2 / 3 about the end of a rod is m l^2 / 12 about its middle."""
    true = import_urdf(pendulum(tmp_path, rod(2.0, 0.6, False)))
    assert not any("about the joints" in note for note in true.notes)
    moved = import_urdf(pendulum(tmp_path, rod(2.0, 0.6, True)), inertia_at="joint")
    for one, other in zip(true.facts.links, moved.facts.links, strict=True):
        np.testing.assert_allclose(one.inertia, other.inertia, atol=1e-12)
    assert "Moments of inertia of fore were moved from the joint to the centre of mass (Steiner)." in moved.notes


def test_moments_of_a_locked_link_are_moved_from_its_joint_as_well(tmp_path: Path) -> None:
    """Kills the shift of moments after joints were locked: the forearm kept m l^2 / 3 about its end."""
    true = import_urdf(pendulum(tmp_path, rod(2.0, 0.6, False)), lock=["elbow=0.4"])
    moved = import_urdf(pendulum(tmp_path, rod(2.0, 0.6, True)), lock=["elbow=0.4"], inertia_at="joint")
    np.testing.assert_allclose(true.facts.links[0].inertia, moved.facts.links[0].inertia, atol=1e-12)
    suspected = import_urdf(pendulum(tmp_path, rod(2.0, 0.6, True)), lock=["elbow=0.4"]).notes
    assert any("upper (1.33 m r^2), fore (1.33 m r^2)" in note for note in suspected)


def test_a_slender_link_with_moments_about_its_joint_is_noticed() -> None:
    """A rod of 0.08 kg m^2 = m r^2 with 0.1 across and next to nothing along it; about its middle it has a third."""
    centre, axis = np.array([0.2, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    assert suspected_steiner_ratio(2.0, centre, np.diag([0.002, 0.1, 0.1]), axis, 1.0) == pytest.approx(1.25)
    assert suspected_steiner_ratio(2.0, centre, np.diag([0.002, 0.08 / 3.0, 0.08 / 3.0]), axis, 1.0) is None
    turned = pin.rpy.rpyToMatrix(0.0, 0.0, 0.7)  # the same link in other axes
    inertia = turned @ np.diag([0.002, 0.1, 0.1]) @ turned.T
    assert suspected_steiner_ratio(2.0, turned @ centre, inertia, axis, 1.0) == pytest.approx(1.25)
    flat = np.diag([0.002, 0.1, 0.05])  # about the joint no moment across r is less than m r^2
    assert suspected_steiner_ratio(2.0, centre, flat, axis, 1.0) is None


def test_one_moment_written_three_times_about_the_joint_is_recognised(tmp_path: Path) -> None:
    """As where a planar plant was identified: no body is left by Steiner, so its part is taken from each."""
    about_joint = 2.0 * 0.3**2 + 0.004
    moments = " ".join(f'{name}="{about_joint}"' for name in ("ixx", "iyy", "izz"))
    inside = (
        f'<inertial><origin xyz="0.3 0 0"/><mass value="2"/><inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    (note,) = [note for note in import_urdf(pendulum(tmp_path, inside)).notes if "about the joints" in note]
    assert "upper (1.02 m r^2), fore (1.02 m r^2)" in note
    assert "--inertia-at joint" in note
    moved = import_urdf(pendulum(tmp_path, inside), inertia_at="joint")
    np.testing.assert_allclose(moved.facts.links[0].inertia, [0.004, 0, 0, 0.004, 0, 0.004], atol=1e-12)


def test_too_little_inertia_is_not_about_the_joint(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no body has these moments about its joint"):
        import_urdf(pendulum(tmp_path, rod(2.0, 0.6, False)), inertia_at="joint")


@pytest.mark.parametrize(
    "name",
    sorted(path.stem for path in (config_directory() / "robots").glob("*.yaml")),
)
def test_links_of_real_arms_are_not_suspected(name: str) -> None:
    facts = load_facts(name)
    length = sum(float(np.linalg.norm(origin.xyz)) for origin in facts.joints)
    for one in facts.links:
        assert (
            suspected_steiner_ratio(one.mass, np.array(one.com), one.inertia_matrix, np.array([0, 0, 1.0]), length)
            is None
        )
