# SPDX-License-Identifier: Apache-2.0
"""URDF of robots: written from the facts, loaded by Pinocchio and PyBullet, and, mounted in the world, by viewers.

Links are ``base``, ``link1`` ... ``linkN`` and ``end_effector``; joints are ``joint1`` ... ``jointN``. Only the pad has
a collision shape, because contact of coarse link shapes would cause unreal forces; the clearance of links is checked
before a trial (:mod:`impact_rs_sim.clearance`). Visual shapes are meshes, or the simple shapes of
:mod:`impact_rs_sim.robots.link_shapes`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.link_shapes import TOOL_RADIUS_M, Shape, link_shapes
from impact_rs_sim.robots.robot import Array, Colours, EndEffector, Mesh, RobotFacts
from impact_rs_sim.shapes import BOX, CYLINDER, SPHERE, ConvexShape

WORLD = "world"  # the inertial frame A
# Mass, centre of mass, inertia of links fixed to the world; Bullet warns without them
_FIXED_LINK_INERTIAL = (1.0, np.zeros(3), 0.01 * np.eye(3))


def joint_names(facts: RobotFacts) -> list[str]:
    """Names of the joints in order, as in the URDF; a ``sensor_msgs/JointState`` has them with the prefix ``ARM_``."""
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
    """A cylinder, or with equal ends a ball."""
    span = end - start
    length = float(np.linalg.norm(span))
    visual = Xml.SubElement(link, "visual")
    rotation = np.eye(3) if length == 0.0 else _rotation_to(span / length)
    rpy = pin.rpy.matrixToRpy(rotation)
    Xml.SubElement(visual, "origin", xyz=_text((start + end) / 2.0), rpy=_text(rpy))
    geometry = Xml.SubElement(visual, "geometry")
    if length == 0.0:
        Xml.SubElement(geometry, "sphere", radius=repr(radius))
    else:
        Xml.SubElement(geometry, "cylinder", radius=repr(radius), length=repr(length))
    material = Xml.SubElement(visual, "material", name=f"colour_{colour.replace(' ', '_')}")
    Xml.SubElement(material, "color", rgba=colour)


def _rotation_to(axis: Array) -> Array:
    """Rotation of z to an axis, ``(3, 3)``."""
    return np.asarray(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix())


def _simple(link: Xml.Element, shapes: Iterable[Shape], colours: Colours) -> None:
    for shape in shapes:
        colour = colours.shell if shape.colour == "shell" else colours.joint
        _visual(link, shape.start, shape.end, shape.radius, f"{_text(colour)} 1")


def _meshes(link: Xml.Element, meshes: tuple[Mesh, ...]) -> bool:
    """Add the meshes, if any; returns whether there are any."""
    for mesh in meshes:
        visual = Xml.SubElement(link, "visual")
        Xml.SubElement(visual, "origin", xyz=_text(mesh.xyz), rpy=_text(mesh.rpy))
        Xml.SubElement(Xml.SubElement(visual, "geometry"), "mesh", filename=mesh.file, scale=_text(mesh.scale))
    return bool(meshes)


def _mount_rpy(facts: RobotFacts, end_effector: EndEffector) -> Array:
    """Roll, pitch, yaw of E in the last link, ``(3,)`` [rad]."""
    if not any(facts.flange.rpy):
        return np.array(end_effector.mount_numbers[3:])  # exact to the last bit, unlike through a matrix
    return np.asarray(pin.rpy.matrixToRpy(facts.flange.rotation @ end_effector.mount.rotation))


@functools.lru_cache(maxsize=64)
def write_urdf(
    facts: RobotFacts, end_effector: EndEffector, name: str = "arm", prefix: str = "", meshes: bool = False
) -> str:
    """URDF of an arm with its end effector.

    Args:
        facts: Kinematics, inertials and limits.
        end_effector: Mass, inertia and pad.
        name: Robot name of the URDF.
        prefix: Prefix of every name of a link and of a joint, where several arms are in one URDF.
        meshes: Show the meshes of the facts, if any (for viewers); else simple shapes.

    Raises:
        InputError: The robot is a tree.
    """
    facts.check_chain("the URDF that simulators and viewers load", f"robots.{prefix.removesuffix('_') or name}")
    robot = Xml.Element("robot", name=name)
    base = Xml.SubElement(robot, "link", name=f"{prefix}base")
    _inertial(base, *_FIXED_LINK_INERTIAL)
    shapes, colours = link_shapes(facts), facts.colours
    if not (meshes and _meshes(base, facts.base_meshes)):
        _simple(base, shapes[0], colours)
    limits = facts.limits
    previous, carrier = "base", base
    for index, (origin, inertials) in enumerate(zip(facts.joints, facts.links, strict=True)):
        link_name = f"link{index + 1}"
        joint = Xml.SubElement(robot, "joint", name=f"{prefix}joint{index + 1}", type=origin.type)
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
        if not (meshes and _meshes(link, inertials.meshes)):
            _simple(link, shapes[index + 1], colours)
        previous, carrier = link_name, link

    mount = Xml.SubElement(robot, "joint", name=f"{prefix}end_effector_mount", type="fixed")
    Xml.SubElement(mount, "parent", link=f"{prefix}{previous}")
    Xml.SubElement(mount, "child", link=f"{prefix}end_effector")
    origin_e = np.array(facts.flange.xyz) + facts.flange.rotation @ end_effector.mount.translation
    Xml.SubElement(mount, "origin", xyz=_text(origin_e), rpy=_text(_mount_rpy(facts, end_effector)))
    link = Xml.SubElement(robot, "link", name=f"{prefix}end_effector")
    _inertial(link, end_effector.mass, end_effector.com, end_effector.inertia)
    thickness = end_effector.pad_size[2]
    _visual(
        link,
        end_effector.mount.inverse().translation,
        np.array([0.0, 0.0, -thickness]),
        TOOL_RADIUS_M,
        "0.25 0.27 0.30 1",
    )
    for kind in ("visual", "collision"):
        shape = Xml.SubElement(link, kind)
        centre = _text(end_effector.pad_placement.translation)
        Xml.SubElement(shape, "origin", xyz=centre, rpy=_text((*end_effector.pad_tilt, 0.0)))
        _geometry(Xml.SubElement(shape, "geometry"), end_effector.shape, np.array(end_effector.pad_size))
        if kind == "visual":
            material = Xml.SubElement(shape, "material", name="pad")
            Xml.SubElement(material, "color", rgba="0.85 0.35 0.2 1")
    return _document(robot)


def write_description(
    arms: Mapping[str, tuple[RobotFacts, EndEffector, pin.SE3]],
    support: tuple[float, tuple[float, float]] | None,
    meshes: bool = True,
) -> str:
    """URDF of mounted arms and their support, from link ``world`` on; for viewers and other programs.

    Links are ``ARM_base``, ``ARM_link1`` ... ``ARM_end_effector``; joints ``ARM_joint1`` ..., as in every
    ``sensor_msgs/JointState``, and ``ARM_mount``, ``ARM_end_effector_mount``, which are fixed.

    Args:
        arms: Facts, end effector and placement of the base in A, by arm.
        support: Height of the surface and its extent along x, y [m]; its link is ``support``. None: no support.
        meshes: Show the meshes of arms that have some; else simple shapes.
    """
    scene = Xml.Element("robot", name="_".join(arms))
    Xml.SubElement(scene, "link", name=WORLD)
    for name, (facts, end_effector, base) in arms.items():
        scene.extend(Xml.fromstring(write_urdf(facts, end_effector, prefix=f"{name}_", meshes=meshes)))
        _fix(scene, f"{name}_mount", f"{name}_base", base)
    if support is not None:
        height, (x, y) = support
        link = Xml.SubElement(scene, "link", name="support")
        _inertial(link, *_FIXED_LINK_INERTIAL)
        _box(link, np.array([x, y, 0.02]), np.array([0.0, 0.0, height - 0.01]), "support", "0.55 0.6 0.65 1")
        _fix(scene, "support_mount", "support", pin.SE3.Identity())
    return _document(scene)


def write_object_description(
    size: Array, inertial: tuple[float, Array, Array], shape: ConvexShape = BOX, name: str = "object"
) -> str:
    """URDF of an object: the one link with its name, whose frame is at the middle of its extents.

    Args:
        size: Extent along x, y, z, ``(3,)`` [m].
        inertial: Mass [kg], infinite of a fixed object, which has no ``inertial``; centre of mass in the link, ``(3,)``
            [m]; inertia about it, ``(3, 3)`` [kg m^2].
        shape: Shape within the extents; a capsule, which URDF lacks, becomes a cylinder and two balls.
        name: Its name.
    """
    robot = Xml.Element("robot", name=name)
    link = Xml.SubElement(robot, "link", name=name)
    if math.isfinite(inertial[0]):
        _inertial(link, *inertial)
    colour = "0.76 0.6 0.42 1"
    if shape.kind == "capsule":
        tube = np.array([size[0], size[1], size[2] - size[0]])
        _geometry(_shown(link, np.zeros(3), "object", colour), CYLINDER, tube)
        for end in (-tube[2] / 2.0, tube[2] / 2.0):
            _geometry(_shown(link, np.array([0.0, 0.0, end]), "object", colour), SPHERE, size)
    else:
        _geometry(_shown(link, np.zeros(3), "object", colour), shape, size)
    return _document(robot)


def _fix(robot: Xml.Element, name: str, link: str, placement: pin.SE3) -> None:
    """Fix a link to the world."""
    joint = Xml.SubElement(robot, "joint", name=name, type="fixed")
    Xml.SubElement(joint, "parent", link=WORLD)
    Xml.SubElement(joint, "child", link=link)
    rpy = pin.rpy.matrixToRpy(placement.rotation)
    Xml.SubElement(joint, "origin", xyz=_text(placement.translation), rpy=_text(rpy))


def _geometry(geometry: Xml.Element, shape: ConvexShape, size: Array) -> None:
    """A box, sphere or cylinder."""
    radius = repr(float(size[0]) / 2.0)
    if shape.kind == "sphere":
        Xml.SubElement(geometry, "sphere", radius=radius)
    elif shape.kind == "cylinder":
        Xml.SubElement(geometry, "cylinder", radius=radius, length=repr(float(size[2])))
    else:
        Xml.SubElement(geometry, "box", size=_text(size))


def _box(link: Xml.Element, size: Array, centre: Array, name: str, colour: str) -> None:
    Xml.SubElement(_shown(link, centre, name, colour), "box", size=_text(size))


def _shown(link: Xml.Element, centre: Array, name: str, colour: str) -> Xml.Element:
    """The geometry of a visual shape of a link, still empty."""
    visual = Xml.SubElement(link, "visual")
    Xml.SubElement(visual, "origin", xyz=_text(centre), rpy="0 0 0")
    geometry = Xml.SubElement(visual, "geometry")
    Xml.SubElement(Xml.SubElement(visual, "material", name=name), "color", rgba=colour)
    return geometry


def _document(robot: Xml.Element) -> str:
    Xml.indent(robot)
    return '<?xml version="1.0"?>\n' + Xml.tostring(robot, encoding="unicode") + "\n"
