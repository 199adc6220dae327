# SPDX-License-Identifier: Apache-2.0
"""The one URDF: written from the facts, loaded by Pinocchio, by PyBullet and by viewers.

Links are ``base``, ``link1`` ... ``linkN`` and ``end_effector``; joints are ``joint1`` ... ``jointN``. Only the pad has
a collision shape: arm against scene is out of scope, and a self-collision of coarse shapes would be a
force that no real robot feels. Visual shapes are plain cylinders between joint origins.
"""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_sim.robot import Array, EndEffector, RobotFacts


def joint_names(facts: RobotFacts) -> list[str]:
    """Names of the joints in order, as in the URDF and in every ``sensor_msgs/JointState``."""
    return [f"joint{index + 1}" for index in range(facts.joint_count)]


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _inertial(link: Xml.Element, mass: float, com: Array, inertia: Array) -> None:
    inertial = Xml.SubElement(link, "inertial")
    Xml.SubElement(inertial, "origin", xyz=_text(com), rpy="0 0 0")
    Xml.SubElement(inertial, "mass", value=repr(float(mass)))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = {name: repr(float(inertia[index])) for name, index in entries.items()}
    Xml.SubElement(inertial, "inertia", values)


def _visual(link: Xml.Element, start: Array, end: Array, radius: float, colour: str) -> None:
    span = end - start
    length = float(np.linalg.norm(span))
    if length < 1e-6:
        return
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), span / length).matrix()
    visual = Xml.SubElement(link, "visual")
    rpy = pin.rpy.matrixToRpy(rotation)
    Xml.SubElement(visual, "origin", xyz=_text((start + end) / 2.0), rpy=_text(rpy))
    geometry = Xml.SubElement(visual, "geometry")
    Xml.SubElement(geometry, "cylinder", radius=repr(radius), length=repr(length))
    material = Xml.SubElement(visual, "material", name=f"colour_{colour.replace(' ', '_')}")
    Xml.SubElement(material, "color", rgba=colour)


def _mount_rpy(facts: RobotFacts, end_effector: EndEffector) -> Array:
    """Roll, pitch, yaw of E in the last link, ``(3,)`` [rad]."""
    if not any(facts.flange.rpy):
        return np.array([0.0, 0.0, end_effector.mount_yaw])  # to the last bit, which a matrix would not keep
    yaw = pin.rpy.rpyToMatrix(0.0, 0.0, end_effector.mount_yaw)
    return np.asarray(pin.rpy.matrixToRpy(facts.flange.rotation @ yaw))


def write_urdf(facts: RobotFacts, end_effector: EndEffector, name: str = "arm", prefix: str = "") -> str:
    """URDF of an arm with its end effector.

    Args:
        facts: Kinematics, inertials and limits.
        end_effector: Mass, inertia and pad.
        name: Robot name of the URDF.
        prefix: Prefix of every link name, for viewers that show several robots (joint names stay as they are).
    """
    robot = Xml.Element("robot", name=name)
    base = Xml.SubElement(robot, "link", name=f"{prefix}base")
    _inertial(base, 1.0, np.zeros(3), 0.01 * np.eye(3))  # fixed to the world; Bullet warns where it is absent
    _visual(base, np.zeros(3), np.array([0.0, 0.0, 0.14]), 0.09, "0.92 0.92 0.94 1")
    limits = facts.limits
    previous, carrier = "base", base
    for index, (origin, inertials) in enumerate(zip(facts.joints, facts.links, strict=True)):
        link_name = f"link{index + 1}"
        joint = Xml.SubElement(robot, "joint", name=f"joint{index + 1}", type=origin.type)
        Xml.SubElement(joint, "parent", link=f"{prefix}{previous}")
        Xml.SubElement(joint, "child", link=f"{prefix}{link_name}")
        Xml.SubElement(joint, "origin", xyz=_text(origin.xyz), rpy=_text(origin.rpy))
        Xml.SubElement(joint, "axis", xyz="0 0 1")
        Xml.SubElement(
            joint,
            "limit",
            lower=repr(limits.position_min_rad[index]),
            upper=repr(limits.position_max_rad[index]),
            velocity=repr(limits.velocity_rad_s[index]),
            effort=repr(limits.torque_Nm[index]),
        )
        Xml.SubElement(joint, "dynamics", damping="0.0", friction="0.0")
        if origin.type == "prismatic":
            rail = pin.rpy.rpyToMatrix(*origin.rpy)[:, 2]
            ends = (limits.position_min_rad[index], limits.position_max_rad[index])
            start, end = (np.array(origin.xyz) + position * rail for position in ends)
            _visual(carrier, start, end, 0.02, "0.25 0.27 0.30 1")
        link = Xml.SubElement(robot, "link", name=f"{prefix}{link_name}")
        _inertial(link, inertials.mass, np.array(inertials.com), inertials.inertia_matrix)
        axis = np.array([0.0, 0.0, 0.065])
        _visual(link, -axis, axis, 0.055, "0.25 0.27 0.30 1")
        following = facts.joints[index + 1].xyz if index + 1 < facts.joint_count else facts.flange.xyz
        _visual(link, np.zeros(3), np.array(following), 0.045, "0.92 0.92 0.94 1")
        previous, carrier = link_name, link

    mount = Xml.SubElement(robot, "joint", name="end_effector_mount", type="fixed")
    Xml.SubElement(mount, "parent", link=f"{prefix}{previous}")
    Xml.SubElement(mount, "child", link=f"{prefix}end_effector")
    origin_e = np.array(facts.flange.xyz) + facts.flange.rotation @ np.array([0.0, 0.0, end_effector.length])
    Xml.SubElement(mount, "origin", xyz=_text(origin_e), rpy=_text(_mount_rpy(facts, end_effector)))
    link = Xml.SubElement(robot, "link", name=f"{prefix}end_effector")
    _inertial(link, end_effector.mass, end_effector.com, end_effector.inertia)
    thickness = end_effector.pad_size[2]
    _visual(
        link,
        np.array([0.0, 0.0, -end_effector.length]),
        np.array([0.0, 0.0, -thickness]),
        0.03,
        "0.25 0.27 0.30 1",
    )
    for kind in ("visual", "collision"):
        shape = Xml.SubElement(link, kind)
        place = _text(end_effector.pad_placement.translation)
        Xml.SubElement(shape, "origin", xyz=place, rpy=_text((*end_effector.pad_tilt, 0.0)))
        Xml.SubElement(Xml.SubElement(shape, "geometry"), "box", size=_text(end_effector.pad_size))
        if kind == "visual":
            material = Xml.SubElement(shape, "material", name="pad")
            Xml.SubElement(material, "color", rgba="0.85 0.35 0.2 1")
    Xml.indent(robot)
    return '<?xml version="1.0"?>\n' + Xml.tostring(robot, encoding="unicode") + "\n"


def write_scene_urdf(
    arms: dict[str, tuple[RobotFacts, EndEffector]],
    object_size: tuple[float, float, float],
    support: tuple[float, tuple[float, float]] | None,
) -> str:
    """URDF of the whole scene for viewers; poses come from ``/tf``.

    Every link hangs on ``world`` by a floating joint, because ``/tf`` states every frame in the world frame.

    Args:
        arms: Facts and end effector by arm; links are called ``ARM_link1`` and so on.
        object_size: Extent of the object along x, y, z [m]; its link is called ``object``.
        support: Height of the surface and its extent along x, y [m], or None.
    """
    scene = Xml.Element("robot", name="scene")
    Xml.SubElement(scene, "link", name="world")

    def hang(link: Xml.Element) -> None:
        name = link.get("name", "")
        scene.append(link)
        joint = Xml.SubElement(scene, "joint", name=f"{name}_in_world", type="floating")
        Xml.SubElement(joint, "parent", link="world")
        Xml.SubElement(joint, "child", link=name)

    for name, (facts, end_effector) in arms.items():
        for link in Xml.fromstring(write_urdf(facts, end_effector, prefix=f"{name}_")).iter("link"):
            hang(link)
    boxes = [("object", object_size, (0.0, 0.0, 0.0), "0.76 0.6 0.42 1")]
    if support is not None:
        height, (x, y) = support
        boxes.append(("support", (x, y, 0.02), (0.0, 0.0, height - 0.01), "0.55 0.6 0.65 1"))
    for name, size, origin, colour in boxes:
        link = Xml.Element("link", name=name)
        visual = Xml.SubElement(link, "visual")
        Xml.SubElement(visual, "origin", xyz=_text(origin), rpy="0 0 0")
        Xml.SubElement(Xml.SubElement(visual, "geometry"), "box", size=_text(size))
        Xml.SubElement(Xml.SubElement(visual, "material", name=name), "color", rgba=colour)
        hang(link)
    Xml.indent(scene)
    return '<?xml version="1.0"?>\n' + Xml.tostring(scene, encoding="unicode") + "\n"
