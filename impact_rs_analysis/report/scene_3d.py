# SPDX-License-Identifier: Apache-2.0
"""Scene as ``replay.js`` reads it: joints and links of a URDF with their shapes, and the object's box.

The page receives joint positions and computes the forward kinematics: joint frame in its parent, then rotation about,
or translation along, the joint axis.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_analysis.report.page import packed
from impact_rs_analysis.report.surface import surface_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.robots.urdf import joint_names
from impact_rs_sim.rotations import quaternion_of

DEFAULT_COLOUR = "0.88 0.88 0.9 1"  # RGBA, as in a URDF
MOVING_JOINT_TYPES = ("revolute", "continuous", "prismatic")  # have a joint state
STICK_RADIUS_M = 0.03  # for links without usable shapes
SPHERE_POINTS = (9, 16)  # from pole to pole, and around


def scene_data(physics: Physics) -> dict[str, Any]:
    """Joints and links with their shapes, and the object's box.

    Returns:
        ``arms`` in the order of the data; ``joints`` with ``parent``, ``child``, ``type``, ``position`` [m] and
        ``quaternion`` (x y z w) in the parent, ``axis`` where it is not z, and ``column`` if it moves;
        ``links``: shapes with pose in the link and colour, by name of the link; ``root``: the fixed link;
        ``object``: extent along its axes [m], and ``object_shape`` if it is no box; ``neighbours``: extents and shapes
        of neighbouring objects, if there are any.
    """
    robot, simplified = (Xml.fromstring(physics.description(meshes)) for meshes in (True, False))
    links = {
        link.get("name", ""): _shapes(link) or _shapes(simple)
        for link, simple in zip(robot.iter("link"), simplified.iter("link"), strict=True)
    }
    scene = _scene(robot, moving_joints(physics), list(physics.arms), links) | _object(physics.object)
    neighbours = [_object(neighbour.body) for neighbour in physics.neighbours]
    return scene | {"neighbours": neighbours} if neighbours else scene


def _object(body: ObjectPhysics) -> dict[str, Any]:
    """Extents of an object, and its shape if it is no box."""
    extents = {"object": body.size.tolist()}
    return extents if body.shape.is_box else extents | {"object_shape": _object_shape(body)}


def moving_joints(physics: Physics) -> list[str]:
    """Names of the joints in the URDF and in joint states, in the order of the data: arm after arm."""
    return [
        f"{arm}_{joint}" for arm, physics_of_arm in physics.arms.items() for joint in joint_names(physics_of_arm.facts)
    ]


def described_scene(urdf: str) -> tuple[dict[str, Any], list[str]]:
    """The scene of any URDF, and the names of its moving joints, in the order of the data.

    A link is shown with its visual shapes; with its collision shapes if a visual mesh cannot be read; otherwise as
    sticks to its child joints.

    Raises:
        InputError: It is no URDF of one robot.
    """
    try:
        robot = Xml.fromstring(urdf)
        moving = [joint.get("name", "") for joint in robot.findall("joint") if _moves(joint)]
        links = {
            link.get("name", ""): _shapes(link) or _shapes(link, "collision") or _sticks(robot, link)
            for link in robot.findall("link")
        }
        scene = _scene(robot, moving, [], links) | {"object": None}
    except (Xml.ParseError, ValueError, TypeError) as error:
        raise InputError(f"no URDF that can be drawn: {error}") from None
    return scene, moving


def _scene(robot: Xml.Element, moving: Sequence[str], arms: list[str], links: dict[str, Any]) -> dict[str, Any]:
    joints = []
    for joint in robot.findall("joint"):
        name, axis = joint.get("name", ""), joint.find("axis")
        direction = _vector("1 0 0" if axis is None else axis.get("xyz", "1 0 0"))
        moved = {"column": moving.index(name)} if name in moving else {}
        if moved and direction != [0.0, 0.0, 1.0]:
            moved["axis"] = (np.array(direction) / (np.linalg.norm(direction) or 1.0)).tolist()
        ends = {end: _link(joint, end) for end in ("parent", "child")}
        if unknown := set(ends.values()) - set(links):
            raise ValueError(f"joint {name!r} has no link {unknown.pop()!r}")
        joints.append({**ends, "type": joint.get("type"), **_origin(joint), **moved})
    children = [joint["child"] for joint in joints]
    roots = [name for name in links if name not in children]
    if len(roots) != 1 or len(set(children)) != len(children):
        raise ValueError("its links are no tree")
    return {
        "arms": arms,
        "joints": joints,
        "links": links,
        "root": roots[0],
    }


def _moves(joint: Xml.Element) -> bool:
    return joint.get("type") in MOVING_JOINT_TYPES and joint.find("mimic") is None


def _link(joint: Xml.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _origin(element: Xml.Element) -> dict[str, list[float]]:
    origin = element.find("origin")
    attributes = {"xyz": "0 0 0", "rpy": "0 0 0"} | ({} if origin is None else origin.attrib)
    quaternion = quaternion_of(pin.rpy.rpyToMatrix(*_vector(attributes["rpy"])))
    return {"position": _vector(attributes["xyz"]), "quaternion": quaternion.tolist()}


def _shapes(link: Xml.Element, kind: str = "visual") -> list[dict[str, Any]]:
    """Shapes of a link; empty if one of its meshes cannot be read."""
    shapes = [_shape(visual) for visual in link.iter(kind)]
    return [shape for shape in shapes if shape is not None] if None not in shapes else []


def _shape(visual: Xml.Element) -> dict[str, Any] | None:
    geometry, colour = visual.find("geometry/*"), visual.find("material/color")
    if geometry is None:
        return None
    rgba = DEFAULT_COLOUR if colour is None else colour.get("rgba", DEFAULT_COLOUR)
    shape = {"kind": geometry.tag, **_origin(visual), "colour": _numbers(rgba)[:3]}
    if geometry.tag == "sphere":
        return shape | {"kind": "mesh"} | _ball(*_numbers(geometry.get("radius", "")))
    if geometry.tag != "mesh":
        return shape | {name: _numbers(text) for name, text in geometry.attrib.items()}
    surface = surface_of(geometry.get("filename", ""))
    if surface is None:
        return None
    scaled = surface.vertices * _numbers(geometry.get("scale", "1 1 1"))
    return shape | {"vertices": packed(scaled), "faces": packed(surface.faces.astype(float))}


def _object_shape(object_: ObjectPhysics) -> dict[str, Any]:
    """Shape of an object that is no box."""
    radius, length = float(object_.size[0]) / 2.0, float(object_.size[2])
    if object_.shape.kind == "hull":
        fans = [(face[0], *pair) for face in object_.shape.faces for pair in itertools.pairwise(face[1:])]
        corners = np.array(object_.shape.corners)
        return {"kind": "mesh", "vertices": packed(corners), "faces": packed(np.array(fans, dtype=float))}
    if object_.shape.kind == "cylinder":
        return {"kind": "cylinder", "radius": [radius], "length": [length]}
    return {"kind": "mesh"} | _ball(radius, length / 2.0 - radius)


def _ball(radius: float, half_tube: float = 0.0) -> dict[str, Any]:
    """A sphere, or a capsule with a tube between its halves, as a mesh."""
    rows, columns = SPHERE_POINTS
    polar, around = np.meshgrid(
        np.linspace(0.0, np.pi, rows), 2.0 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    points = radius * np.stack((np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)), axis=-1)
    points[..., 2] += half_tube * np.sign(rows // 2 - np.arange(rows))[:, None]  # its middle row stays at the middle
    a = np.arange((rows - 1) * columns).reshape(rows - 1, columns)
    b = np.roll(a, -1, axis=1)
    faces = np.stack((a, a + columns, b, b, a + columns, b + columns), axis=-1)
    return {"vertices": packed(points.reshape(-1, 3)), "faces": packed(faces.reshape(-1, 3).astype(float))}


def _sticks(robot: Xml.Element, link: Xml.Element) -> list[dict[str, Any]]:
    """Sticks from the origin of a link with unreadable shapes to its child joints."""
    sticks = []
    if link.find("visual") is None:
        return []
    for joint in robot.findall("joint"):
        end = np.array(_origin(joint)["position"])
        length = float(np.linalg.norm(end))
        if _link(joint, "parent") == link.get("name") and length > STICK_RADIUS_M:
            rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length)
            pose = {"position": (0.5 * end).tolist(), "quaternion": rotation.coeffs().tolist()}
            size = {"radius": [STICK_RADIUS_M], "length": [length]}
            sticks.append({"kind": "cylinder", **pose, "colour": _numbers(DEFAULT_COLOUR)[:3], **size})
    return sticks


def _vector(text: str) -> list[float]:
    numbers = _numbers(text)
    if len(numbers) != 3:
        raise ValueError(f"{text!r} where three numbers are expected")
    return numbers


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]
