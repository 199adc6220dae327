# SPDX-License-Identifier: Apache-2.0
"""A scene as a world of SDFormat with the elements that Drake adds.

* B is ``drake:rotor_inertia`` with a ``drake:gear_ratio`` of 1. Viscous friction is ``damping``; Drake's parser leaves
  ``friction`` out, so Coulomb friction is listed as left out.
* Point contact: stiffness ``drake:point_contact_stiffness`` of a corner of the pad, a sphere; dissipation of Hunt and
  Crossley, and ``drake:relaxation_time`` C / K of the SAP solver, both from the restitution
  (:mod:`impact_rs_sim.damping_of_restitution`), or from K and C where pads are compliant. Pads overlap the
  object by a micrometre at the impact: Drake sees no shapes that only touch.
* Hydroelastic contact of a compliant pad: its pressure grows from 0 at the face to the modulus E at its middle, half
  the thickness h below, so that the face A has the stiffness ``K = 2 E A / h`` (Elandt et al. 2019).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_sim.damping_of_restitution import damping_ratio_of, dissipation_of
from impact_rs_sim.descriptions.exported_scene import FACE_CORNERS, ExportedQuantity, ExportedScene
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.contacts import SUPPORT, SUPPORT_THICKNESS
from impact_rs_sim.physics import ArmPhysics
from impact_rs_sim.robots.robot import Array

SUPPORTED_QUANTITIES = frozenset(
    {
        ExportedQuantity.MOTOR_INERTIA,
        ExportedQuantity.VISCOUS_FRICTION,
        ExportedQuantity.CONTACT_FRICTION,
        ExportedQuantity.RESTITUTION,
        ExportedQuantity.PAD_COMPLIANCE,
        ExportedQuantity.SUPPORT_COMPLIANCE,
        ExportedQuantity.PAD_TILT,
    }
)
XML_NAMESPACE = "drake.mit.edu"
INITIAL_OVERLAP_M = 1e-6  # of pads and object at the impact; Drake detects contact of overlapping shapes only
CORNER_SPHERE_RADIUS_M = 1e-3  # of the spheres at the corners of pads and object
SUPPORT_DISSIPATION_S_M = 1e3  # Hunt-Crossley, of a rigid support: a falling object does not bounce
RIGID_STIFFNESS_N_M = 1e30  # of a rigid partner; the pair then has the stiffness of the other partner
RIGID_RATE_PER_S = 1e6  # sqrt(K / m) of a compliant contact that stands for a rigid one


def write(scene: ExportedScene) -> tuple[str, list[str]]:
    """The file, and notes on how its numbers follow from the scene.

    Models are the arms by name, ``object`` and ``support``; the links and joints of an arm are ``base``, ``link1`` ...,
    ``end_effector``, and ``joint1`` ....

    Raises:
        InputError: An object or a pad is no box.
    """
    bodies = [scene.physics.object.shape, *(arm.end_effector.shape for arm in scene.physics.arms.values())]
    if round_ones := [shape.kind for shape in bodies if not shape.is_box]:
        raise InputError(
            f"a world of Drake has pads and objects that touch with spheres at their corners, which a {round_ones[0]} "
            "lacks; mjcf has its shape",
            key="format",
            value="drake",
        )
    root = Xml.Element("sdf", {"version": "1.9", "xmlns:drake": XML_NAMESPACE})
    world = Xml.SubElement(root, "world", name=scene.title.replace(" ", "_"))
    remarks = [
        "drake:rotor_inertia is the motor inertia B seen from the joint, so drake:gear_ratio is 1",
        "damping is the viscous joint friction",
    ]
    for name, arm in scene.physics.arms.items():
        remarks += _arm(world, scene, name, arm)
    remarks += _object(world, scene)
    remarks += [
        "state at the impact, by joint [rad, rad/s]: "
        + "; ".join(
            f"{name} q {_short(state.position)}, dq {_short(state.velocity)}" for name, state in scene.arms.items()
        ),
        "the pads touch with spheres at their corners; friction of a pair is 2 m n / (m + n) of both coefficients, "
        "which are equal",
        "with rigid pads choose the solver TAMSI and steps of 10 us; the convex solvers SAP, lagged and similar push "
        "what slides away from its partner",
    ]
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode"), remarks


def _arm(world: Xml.Element, scene: ExportedScene, name: str, arm: ArmPhysics) -> list[str]:
    facts, tool, limits = arm.facts, arm.end_effector, arm.facts.limits
    _, viscous = scene.friction(name)
    model = Xml.SubElement(world, "model", name=name)
    link = _link(model, "base", None, arm.base.translation, arm.base.rotation)
    _inertial(link, 1.0, np.zeros(3), 0.01 * np.eye(3))
    fixed = Xml.SubElement(model, "joint", name="mount", type="fixed")
    Xml.SubElement(fixed, "parent").text = "world"
    Xml.SubElement(fixed, "child").text = "base"
    previous = "base"
    for index, (origin, own_link) in enumerate(zip(facts.joints, facts.links, strict=True)):
        link_name, joint_name = f"link{index + 1}", f"joint{index + 1}"
        rotation = pin.rpy.rpyToMatrix(*origin.rpy)
        link = _link(model, link_name, previous, np.array(origin.xyz), rotation)
        _inertial(link, own_link.mass, np.array(own_link.com), own_link.inertia_matrix)
        joint = Xml.SubElement(model, "joint", name=joint_name, type=origin.type)
        Xml.SubElement(joint, "parent").text = previous
        Xml.SubElement(joint, "child").text = link_name
        axis = Xml.SubElement(joint, "axis")
        Xml.SubElement(axis, "xyz").text = "0 0 1"
        limit = Xml.SubElement(axis, "limit")
        for key, values in (
            ("lower", limits.position_min_rad),
            ("upper", limits.position_max_rad),
            ("effort", limits.torque_Nm),
            ("velocity", limits.velocity_rad_s),
        ):
            Xml.SubElement(limit, key).text = repr(float(values[index]))
        dynamics = Xml.SubElement(axis, "dynamics")
        Xml.SubElement(dynamics, "damping").text = repr(float(viscous[index]))
        Xml.SubElement(joint, "drake:rotor_inertia").text = repr(float(scene.motor_inertia[name][index]))
        Xml.SubElement(joint, "drake:gear_ratio").text = "1"
        previous = link_name
    position = np.array(facts.flange.xyz) + facts.flange.rotation @ tool.mount.translation
    rotation = facts.flange.rotation @ tool.mount.rotation
    link = _link(model, "end_effector", previous, position, rotation)
    _inertial(link, tool.mass, tool.com, tool.inertia)
    fixed = Xml.SubElement(model, "joint", name="end_effector_mount", type="fixed")
    Xml.SubElement(fixed, "parent").text = previous
    Xml.SubElement(fixed, "child").text = "end_effector"
    pad = tool.pad_placement
    visual = Xml.SubElement(link, "visual", name="pad")
    _pose(visual, pad.translation, pad.rotation)
    _box(visual, np.array(tool.pad_size))
    stiffness, dissipation, relaxation, remarks = _pad_law(scene, name, arm)
    half = np.array(tool.pad_size) / 2.0
    for number, corner in enumerate(_corners(half[0], half[1])):
        centre = pad.translation + pad.rotation @ [*corner, half[2] - CORNER_SPHERE_RADIUS_M + INITIAL_OVERLAP_M]
        law = (stiffness / FACE_CORNERS, dissipation, relaxation)
        _sphere(link, f"corner{number}", centre, law, scene.physics.pad_friction)
    if scene.pads == "compliant" and arm.pad_stiffness is not None:
        modulus = stiffness * tool.pad_size[2] / (2.0 * tool.pad_size[0] * tool.pad_size[1])
        remarks.append(
            f"{name}: for hydroelastic contact give the pad, a box of {_short(tool.pad_size)} m, the modulus "
            f"{modulus:.6g} Pa and the same dissipation, and leave the spheres at its corners out"
        )
    return remarks


def _pad_law(scene: ExportedScene, name: str, arm: ArmPhysics) -> tuple[float, float, float, list[str]]:
    """Stiffness of the whole pad [N/m], Hunt-Crossley dissipation [s/m], relaxation time [s], and notes on them."""
    mass, speed = scene.impact_mass(name), max(scene.closing_speed(name), 1e-3)
    e = scene.restitution_of_pad(name)
    dissipation = dissipation_of(e, speed)
    if scene.pads == "compliant" and arm.pad_stiffness is not None:
        stiffness = arm.pad_stiffness
        relaxation = arm.pad_damping / stiffness
        source = f"the pad's K and C (relaxation time C / K), which a mass of {mass:.4g} kg meets"
    else:
        stiffness, relaxation = mass * RIGID_RATE_PER_S**2, _relaxation(e)
        source = (
            f"a rigid pad, that a mass of {mass:.4g} kg leaves after some {1e6 * math.pi / RIGID_RATE_PER_S:.2g} us"
        )
    return (
        stiffness,
        dissipation,
        relaxation,
        [
            f"{name}: point_contact_stiffness {stiffness / FACE_CORNERS:.6g} N/m of one of {FACE_CORNERS} corners: "
            f"{source}; hunt_crossley_dissipation {dissipation:.5g} s/m has the restitution {e:.3g} at "
            f"{speed:.4g} m/s, relaxation_time {relaxation:.4g} s (solver SAP) at any speed"
        ],
    )


def _relaxation(restitution: float) -> float:
    """C / K of a spring and damper with :data:`RIGID_RATE_PER_S` and ``restitution`` [s]."""
    return 2.0 * damping_ratio_of(restitution) / RIGID_RATE_PER_S


def _object(world: Xml.Element, scene: ExportedScene) -> list[str]:
    physics, object_ = scene.physics, scene.physics.object
    model = Xml.SubElement(world, "model", name="object")
    link = _link(model, "object", None, scene.object.position, scene.object.rotation)
    if object_.fixed:
        Xml.SubElement(model, "static").text = "true"
    else:
        _inertial(link, object_.mass, object_.com_offset, np.diag(object_.inertia))
    visual = Xml.SubElement(link, "visual", name="object")
    _box(visual, object_.size)
    body = Xml.SubElement(link, "collision", name="object")
    _pose(body, np.array([0.0, 0.0, CORNER_SPHERE_RADIUS_M]), np.eye(3))  # feet below stand on the support
    _box(body, object_.size - [0.0, 0.0, 2.0 * CORNER_SPHERE_RADIUS_M])
    _material(body, None, physics.pad_friction)
    height = scene.standing_height
    if height is None:
        return []
    if physics.support_compliance:
        stiffness, damping = scene.support_contact
    else:
        stiffness, damping = object_.mass * RIGID_RATE_PER_S**2, object_.mass * RIGID_RATE_PER_S
    half = object_.size / 2.0
    law = (stiffness / FACE_CORNERS, SUPPORT_DISSIPATION_S_M, damping / stiffness)
    for number, corner in enumerate(_corners(half[0] - CORNER_SPHERE_RADIUS_M, half[1] - CORNER_SPHERE_RADIUS_M)):
        _sphere(
            link,
            f"corner{number}",
            np.array([*corner, -half[2] + CORNER_SPHERE_RADIUS_M]),
            law,
            physics.support_friction,
        )
    model = Xml.SubElement(world, "model", name=SUPPORT)
    Xml.SubElement(model, "static").text = "true"
    link = _link(model, SUPPORT, None, np.array([0.0, 0.0, height - SUPPORT_THICKNESS / 2.0]), np.eye(3))
    size = np.array([*physics.support_size, SUPPORT_THICKNESS])
    for kind in ("visual", "collision"):
        shape = Xml.SubElement(link, kind, name=SUPPORT)
        _box(shape, size)
    _material(shape, None, physics.support_friction)
    return [
        f"support: {stiffness:.6g} N/m under the whole object, which stands on {FACE_CORNERS} spheres at its corners, "
        f"{2e3 * CORNER_SPHERE_RADIUS_M:g} mm below its box; relaxation time {damping / stiffness:.4g} s"
    ]


def _sphere(link: Xml.Element, name: str, centre: Array, law: tuple[float, float, float], friction: float) -> None:
    collision = Xml.SubElement(link, "collision", name=name)
    _pose(collision, centre, np.eye(3))
    sphere = Xml.SubElement(Xml.SubElement(collision, "geometry"), "sphere")
    Xml.SubElement(sphere, "radius").text = repr(CORNER_SPHERE_RADIUS_M)
    _material(collision, law, friction)


def _material(collision: Xml.Element, law: tuple[float, float, float] | None, friction: float) -> None:
    """Contact properties: stiffness [N/m], dissipation [s/m], relaxation time [s]; None: rigid."""
    stiffness, dissipation, relaxation = law or (RIGID_STIFFNESS_N_M, 0.0, 0.0)
    properties = Xml.SubElement(collision, "drake:proximity_properties")
    for key, value in (
        ("point_contact_stiffness", stiffness),
        ("hunt_crossley_dissipation", dissipation),
        ("relaxation_time", relaxation),
        ("mu_dynamic", friction),
        ("mu_static", friction),
    ):
        Xml.SubElement(properties, f"drake:{key}").text = repr(float(value))


def _corners(x: float, y: float) -> tuple[tuple[float, float], ...]:
    return ((-x, -y), (-x, y), (x, -y), (x, y))


def _link(model: Xml.Element, name: str, parent: str | None, position: Array, rotation: Array) -> Xml.Element:
    """A link, placed in its parent where the joints are at 0; None: in the world."""
    link = Xml.SubElement(model, "link", name=name)
    _pose(link, position, rotation, parent)
    return link


def _inertial(link: Xml.Element, mass: float, com: Array, inertia: Array) -> None:
    inertial = Xml.SubElement(link, "inertial")
    _pose(inertial, com, np.eye(3))
    Xml.SubElement(inertial, "mass").text = repr(float(mass))
    entries = Xml.SubElement(inertial, "inertia")
    for key, index in (
        ("ixx", (0, 0)),
        ("ixy", (0, 1)),
        ("ixz", (0, 2)),
        ("iyy", (1, 1)),
        ("iyz", (1, 2)),
        ("izz", (2, 2)),
    ):
        Xml.SubElement(entries, key).text = repr(float(inertia[index]))


def _box(shape: Xml.Element, size: Array) -> None:
    Xml.SubElement(Xml.SubElement(Xml.SubElement(shape, "geometry"), "box"), "size").text = _text(size)


def _pose(element: Xml.Element, position: Array, rotation: Array, relative_to: str | None = None) -> None:
    pose = Xml.SubElement(element, "pose")
    if relative_to is not None:
        pose.set("relative_to", relative_to)
    pose.text = _text([*position, *pin.rpy.matrixToRpy(rotation)])


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _short(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
