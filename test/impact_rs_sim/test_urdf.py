# SPDX-License-Identifier: Apache-2.0
"""Descriptions of arms as URDF: what is written, where meshes are, simple shapes for arms without."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.link_shapes import Shape, link_shapes
from impact_rs_sim.robots.mesh_files import mesh_address, mesh_path
from impact_rs_sim.robots.robot import Flange, RobotFacts, load_facts
from impact_rs_sim.robots.urdf import write_urdf
from impact_rs_sim.scenarios.scenario_files import load_scenario

# ---- what is written ------------------------------------------------------------------------------------------------

ROBOT = load_scenario("push").robots["arm"]
FACTS, EFFECTOR = ROBOT.robot_facts, ROBOT.end_effector.build()


@pytest.fixture(scope="module")
def model() -> pin.Model:
    return pin.buildModelFromXML(write_urdf(FACTS, EFFECTOR))


def test_the_last_link_carries_the_end_effector_where_the_flange_is(model: pin.Model) -> None:
    """Masses add; centre and inertia by the parallel-axis theorem, in axes of the last link."""
    link = FACTS.links[-1]
    place = pin.SE3(
        pin.rpy.rpyToMatrix(0.0, 0.0, EFFECTOR.mount_yaw), np.array(FACTS.flange.xyz) + [0.0, 0.0, EFFECTOR.length]
    )
    own = pin.Inertia(link.mass, np.array(link.com), link.inertia_matrix)
    carried = place.act(pin.Inertia(EFFECTOR.mass, EFFECTOR.com, EFFECTOR.inertia))
    expected = own + carried
    found = model.inertias[len(FACTS.links)]
    assert found.mass == pytest.approx(expected.mass)
    np.testing.assert_allclose(found.lever, expected.lever, atol=1e-12)
    np.testing.assert_allclose(found.inertia, expected.inertia, atol=1e-12)


def test_a_flange_askew_carries_the_end_effector_on_its_own_z() -> None:
    flange = Flange(xyz=(0.01, 0.02, 0.1), rpy=(0.4, -0.3, 0.2))
    model = pin.buildModelFromXML(write_urdf(FACTS.model_copy(update={"flange": flange}), EFFECTOR))
    found = model.frames[model.getFrameId("end_effector")].placement
    rotation = pin.rpy.rpyToMatrix(0.4, -0.3, 0.2)
    np.testing.assert_allclose(found.translation, [0.01, 0.02, 0.1] + EFFECTOR.length * rotation[:, 2], atol=1e-12)
    np.testing.assert_allclose(found.rotation, rotation @ pin.rpy.rpyToMatrix(0.0, 0.0, EFFECTOR.mount_yaw), atol=1e-12)


def test_limits_are_those_of_the_facts(model: pin.Model) -> None:
    limits = FACTS.limits
    np.testing.assert_allclose(model.lowerPositionLimit, limits.position_min_rad)
    np.testing.assert_allclose(model.upperPositionLimit, limits.position_max_rad)
    np.testing.assert_allclose(model.velocityLimit, limits.velocity_rad_s)
    np.testing.assert_allclose(model.effortLimit, limits.torque_Nm)


def test_only_the_pad_collides_and_its_face_is_in_the_origin_of_its_frame() -> None:
    robot = Xml.fromstring(write_urdf(FACTS, EFFECTOR))
    collisions = [(link.get("name"), shape) for link in robot.iter("link") for shape in link.iter("collision")]
    ((name, shape),) = collisions
    assert name == "end_effector"
    size = np.array(shape.find("geometry/box").get("size").split(), dtype=float)
    origin = np.array(shape.find("origin").get("xyz").split(), dtype=float)
    np.testing.assert_allclose(size, EFFECTOR.pad_size)
    assert origin[2] + size[2] / 2.0 == pytest.approx(0.0)


def test_a_prefix_names_links_and_joints() -> None:
    robot = Xml.fromstring(write_urdf(FACTS, EFFECTOR, prefix="left_"))
    for element in (*robot.iter("link"), *robot.iter("joint")):
        assert element.get("name").startswith("left_")
    for joint in robot.iter("joint"):
        assert joint.find("parent").get("link").startswith("left_")


# ---- meshes are found where a URDF says -----------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def no_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMPACT_RS_CONFIG", str(config_directory()))  # in an installed tree found by the other variable
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)


def file_at(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


@pytest.mark.parametrize("name", ["meshes/l 1.stl", "../meshes/l 1.stl", "/{folder}/meshes/l 1.stl"])
def test_a_path_is_relative_to_the_urdf(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "arm" if name.startswith("..") else tmp_path
    mesh = file_at(tmp_path / "meshes" / "l 1.stl")
    urdf = file_at(folder / "arm.urdf")
    monkeypatch.chdir(urdf.parent)
    for file in (urdf, Path("arm.urdf")):  # whatever the folder it is read from
        address = mesh_address(name.format(folder=str(tmp_path).strip("/")), file)
        assert address is not None
        assert mesh_path(address) == mesh


def test_an_installed_package_keeps_its_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that facts work on another machine with the package."""
    mesh = file_at(tmp_path / "install" / "share" / "arm_description" / "meshes" / "l1.stl")
    file_at(tmp_path / "src" / "arm_description" / "meshes" / "l1.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'other'}:{tmp_path / 'install'}")
    name = "package://arm_description/meshes/l1.stl"
    assert mesh_address(name, tmp_path / "src" / "arm_description" / "arm.urdf") == name
    assert mesh_path(name) == mesh


@pytest.mark.parametrize("urdf", ["src/arm_description/urdf/arm.urdf", "src/bringup/arm.urdf", "elsewhere/arm.urdf"])
def test_a_package_that_is_not_installed_is_found_above_the_urdf_or_where_the_user_says(
    tmp_path: Path, urdf: str
) -> None:
    mesh = file_at(tmp_path / "src" / "arm_description" / "meshes" / "l1.stl")
    name = "package://arm_description/meshes/l1.stl"
    given = [[tmp_path / "src"], [tmp_path / "src" / "arm_description"]] if urdf.startswith("else") else [[]]
    for packages in given:
        address = mesh_address(name, tmp_path / urdf, packages)
        assert address is not None
        assert mesh_path(address) == mesh
    if given != [[]]:
        assert mesh_address(name, tmp_path / urdf) == name


def test_what_is_nowhere_has_an_address_and_no_file(tmp_path: Path) -> None:
    for name in ("package://arm/l1.stl", f"file://{tmp_path}/l1.stl", "l1.stl"):
        address = mesh_address(name, tmp_path / "arm.urdf")
        assert address is not None
        assert mesh_path(address) is None
    assert mesh_address("model://arm/l1.stl", tmp_path / "arm.urdf") is None


# ---- simple shapes --------------------------------------------------------------------------------------------------

ROBOTS = ("franka_fer", "franka_fr3", "kinova_gen3", "kuka_iiwa7", "ur5e", "ur10e")


def tubes(shapes: list[Shape]) -> list[Shape]:
    """Cylinders of the shell that are no housing about the own axis."""
    return [one for one in shapes if one.colour == "shell" and np.any(one.start != one.end) and not _about(one)]


def _about(shape: Shape) -> bool:
    return bool(np.allclose(shape.start, -shape.end) and np.allclose(shape.end[:2], 0.0))


def ends(facts: RobotFacts) -> list[np.ndarray]:
    return [np.array(joint.xyz) for joint in facts.joints[1:]] + [np.array(facts.flange.xyz)]


@pytest.mark.parametrize("name", ROBOTS)
def test_tubes_lead_from_each_joint_to_the_next_one_without_a_gap(name: str) -> None:
    facts = load_facts(name)
    for shapes, end in zip(link_shapes(facts)[1:], ends(facts), strict=True):
        own = tubes(shapes)
        if np.linalg.norm(end) < 1e-3:
            continue
        assert own[0].start == pytest.approx(np.zeros(3))
        assert own[-1].end == pytest.approx(end)
        for before, after in zip(own, own[1:], strict=False):
            assert before.end == pytest.approx(after.start)


def test_the_elbow_of_a_fer_is_set_off_and_the_upper_arm_of_a_ur_lies_beside_its_shoulder() -> None:
    """The common normal of elbow and forearm of a FER is 82.5 mm; a tube of a UR lies at its centre of mass."""
    forearm = tubes(link_shapes(load_facts("franka_fer"))[4])
    assert [float(np.linalg.norm(one.end - one.start)) for one in forearm] == pytest.approx([0.0825, 0.384])
    upper = tubes(link_shapes(load_facts("ur5e"))[2])
    assert upper[1].start == pytest.approx([0.0, 0.0, 0.11336])
    assert upper[1].end == pytest.approx([-0.425, 0.0, 0.11336])
