# SPDX-License-Identifier: Apache-2.0
"""The URDF says what the facts say, and Pinocchio reads it back."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim.robot import Flange
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.urdf import joint_names, write_scene_urdf, write_urdf

ROBOT = load_scenario("push").robots["arm"]
FACTS, EFFECTOR = ROBOT.robot_facts, ROBOT.end_effector.build()


@pytest.fixture(scope="module")
def model() -> pin.Model:
    return pin.buildModelFromXML(write_urdf(FACTS, EFFECTOR))


def test_every_link_has_its_mass_centre_and_inertia(model: pin.Model) -> None:
    for index, link in enumerate(FACTS.links[:-1], start=1):
        found = model.inertias[index]
        assert found.mass == pytest.approx(link.mass)
        np.testing.assert_allclose(found.lever, link.com, atol=1e-12)
        np.testing.assert_allclose(found.inertia, link.inertia_matrix, atol=1e-12)


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


def test_joints_stand_where_the_facts_say_and_turn_about_their_own_z(model: pin.Model) -> None:
    assert list(model.names)[1:] == joint_names(FACTS)
    for index, origin in enumerate(FACTS.joints, start=1):
        placement = model.jointPlacements[index]
        np.testing.assert_allclose(placement.translation, origin.xyz, atol=1e-12)
        np.testing.assert_allclose(placement.rotation, pin.rpy.rpyToMatrix(*origin.rpy), atol=1e-12)
        assert model.joints[index].shortname() == "JointModelRZ"


def test_limits_are_those_of_the_facts(model: pin.Model) -> None:
    limits = FACTS.limits
    np.testing.assert_allclose(model.lowerPositionLimit, limits.position_min_rad)
    np.testing.assert_allclose(model.upperPositionLimit, limits.position_max_rad)
    np.testing.assert_allclose(model.velocityLimit, limits.velocity_rad_s)
    np.testing.assert_allclose(model.effortLimit, limits.torque_Nm)


def test_what_moves_weighs_the_sum_of_links_and_end_effector(model: pin.Model) -> None:
    assert pin.computeTotalMass(model) == pytest.approx(sum(link.mass for link in FACTS.links) + EFFECTOR.mass)


def test_only_the_pad_collides_and_its_face_is_in_the_origin_of_its_frame() -> None:
    robot = Xml.fromstring(write_urdf(FACTS, EFFECTOR))
    collisions = [(link.get("name"), shape) for link in robot.iter("link") for shape in link.iter("collision")]
    ((name, shape),) = collisions
    assert name == "end_effector"
    size = np.array(shape.find("geometry/box").get("size").split(), dtype=float)
    origin = np.array(shape.find("origin").get("xyz").split(), dtype=float)
    np.testing.assert_allclose(size, EFFECTOR.pad_size)
    assert origin[2] + size[2] / 2.0 == pytest.approx(0.0)


def test_a_prefix_names_links_and_leaves_joints_alone() -> None:
    robot = Xml.fromstring(write_urdf(FACTS, EFFECTOR, prefix="left_"))
    assert all(link.get("name").startswith("left_") for link in robot.iter("link"))
    for joint in robot.iter("joint"):
        assert not joint.get("name").startswith("left_")
        assert joint.find("parent").get("link").startswith("left_")


def test_a_scene_for_viewers_has_every_link_hanging_on_the_world() -> None:
    text = write_scene_urdf({"left": (FACTS, EFFECTOR), "right": (FACTS, EFFECTOR)}, (0.1, 0.2, 0.3), (0.4, (1.0, 2.0)))
    scene = Xml.fromstring(text)
    links = {link.get("name") for link in scene.iter("link")}
    assert {"world", "left_base", "right_end_effector", "object", "support"} <= links
    assert {joint.find("child").get("link") for joint in scene.iter("joint")} == links - {"world"}
    assert {joint.find("parent").get("link") for joint in scene.iter("joint")} == {"world"}
    box = scene.find("link[@name='object']/visual/geometry/box")
    assert [float(value) for value in box.get("size").split()] == [0.1, 0.2, 0.3]
    top = scene.find("link[@name='support']/visual")
    height = (
        float(top.find("origin").get("xyz").split()[2]) + float(top.find("geometry/box").get("size").split()[2]) / 2
    )
    assert height == pytest.approx(0.4)
    assert "support" not in {
        link.get("name")
        for link in Xml.fromstring(write_scene_urdf({"left": (FACTS, EFFECTOR)}, (0.1, 0.2, 0.3), None)).iter("link")
    }
