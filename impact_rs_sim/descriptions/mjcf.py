# SPDX-License-Identifier: Apache-2.0
"""A scene as a MuJoCo model (MJCF).

* B is ``armature``, Coulomb friction ``frictionloss``, viscous friction ``damping``. Offset and gain of the commanded
  torque belong to the actuators.
* A single active contact of MuJoCo accelerates as ``a = -b v - k r`` (MuJoCo documentation, "Computation", solver
  parameters). For a rigid pad ``solref`` is a time constant T = 2 / b and a damping ratio, from which the restitution
  follows (:mod:`impact_rs_sim.damping_of_restitution`).
* For a compliant pad and the support ``solref`` is negative, with the units N/m and N s/m. A contact of MuJoCo adds a
  virtual mass m to the bodies (its regularisation is R = 1 / m); with the inverse weight w of both bodies, its
  impedance is ``d = w m / (1 + w m)``. Stiffness K and damping C are then ``-(1 - d) w K`` and ``-(1 - d) w C``, with K
  and C of the face shared by its corners. The virtual masses are small against those of the bodies.
* MuJoCo's friction cones are convex: a point that slides at v is pushed away from its partner at a share of ``mu v``.
  Under a sliding object, slow friction (``solreffriction``) on a small mass suppresses this; at rigid pads it remains.
"""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_sim.damping_of_restitution import damping_ratio_of, restitution_of
from impact_rs_sim.descriptions.exported_scene import FACE_CORNERS, ExportedQuantity, ExportedScene
from impact_rs_sim.impact_map.contacts import SUPPORT, SUPPORT_THICKNESS
from impact_rs_sim.physics import ArmPhysics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import quaternion_of
from impact_rs_sim.shapes import BOX, ConvexShape

SUPPORTED_QUANTITIES = frozenset(ExportedQuantity)
TIME_STEP_S = 5e-5  # of MuJoCo's integrator
CONTACT_MARGIN_M = 1e-5  # distance below which points touch
# Time steps over the phase angle of a bouncing rigid contact; MuJoCo needs at least 2
MIN_STEPS_PER_BOUNCE_RADIAN = 10.0
MIN_DAMPING_RATIO = 1e-3  # of a contact with restitution 1; MuJoCo does not accept 0
MAX_IMPEDANCE = 0.9999  # of a rigid contact; MuJoCo's largest
PAD_VIRTUAL_MASS_RATIO = 0.005  # mass that a corner of a compliant pad adds, over the mass of the impact [-]
# Mass that a corner of the object on its support adds, over the mass of the object [-]
SUPPORT_VIRTUAL_MASS_RATIO = 0.02
PAD_FRICTION_RATE_PER_S = 1e4  # of the friction of a compliant pad
SUPPORT_FRICTION_RATE_PER_S = 300.0  # of the friction of the support
NORMAL_OVER_FRICTION_REGULARISATION = 1e4  # MuJoCo's impratio [-]


def write(scene: ExportedScene) -> tuple[str, list[str]]:
    """The model, and notes on how its numbers follow from the scene.

    Bodies, joints and actuators are ``ARM_link1`` ..., ``ARM_joint1`` ...; the body ``object`` is free or fixed; the
    keyframe ``impact`` is the state just before the impact.
    """
    root = Xml.Element("mujoco", model=scene.title.replace(" ", "_"))
    Xml.SubElement(root, "compiler", angle="radian", autolimits="false", balanceinertia="false")
    Xml.SubElement(
        root,
        "option",
        timestep=_text(TIME_STEP_S),
        gravity=_text(*scene.physics.gravity),
        integrator="implicitfast",
        cone="elliptic",
        solver="Newton",
        impratio=_text(NORMAL_OVER_FRICTION_REGULARISATION),
        iterations="100",
        ls_iterations="200",  # the line search of rigid pads on a yielding support needs more than the default of 50
        tolerance="1e-12",
    )
    world = Xml.SubElement(root, "worldbody")
    actuators = Xml.Element("actuator")
    for name, arm in scene.physics.arms.items():
        _arm(world, actuators, scene, name, arm)
    _object(root, world, scene)
    remarks = [*_contacts(root, scene), *_remarks(scene)]
    root.append(actuators)
    key = Xml.SubElement(Xml.SubElement(root, "keyframe"), "key", name="impact")
    state = scene.object
    positions = [arm.position for arm in scene.arms.values()]
    velocities = [arm.velocity for arm in scene.arms.values()]
    if not scene.physics.object.fixed:
        positions += [state.position, _quaternion(state.rotation)]
        velocities += [state.twist[:3], state.rotation.T @ state.twist[3:]]
    key.set("qpos", _text(*np.concatenate(positions)))
    key.set("qvel", _text(*np.concatenate(velocities)))
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode"), remarks


def _remarks(scene: ExportedScene) -> list[str]:
    inertia = {"reduced": "B_theta", "rotor": "B_rho", "zero": "0"}[scene.motor_inertia_name]
    return [
        f"armature is the motor inertia B = {inertia}; frictionloss and damping are Coulomb and viscous joint friction",
        "an actuator takes the commanded joint torque; biasprm and gainprm are its offset and gain",
        "the keyframe 'impact' is the state just before the impact",
    ]


def _arm(world: Xml.Element, actuators: Xml.Element, scene: ExportedScene, name: str, arm: ArmPhysics) -> None:
    facts, tool, limits = arm.facts, arm.end_effector, arm.facts.limits
    coulomb, viscous = scene.friction(name)
    body = _body(world, f"{name}_base", arm.base.translation, arm.base.rotation)
    for index, (origin, link) in enumerate(zip(facts.joints, facts.links, strict=True)):
        joint_name = f"{name}_joint{index + 1}"
        body = _body(body, f"{name}_link{index + 1}", np.array(origin.xyz), pin.rpy.rpyToMatrix(*origin.rpy))
        _inertial(body, link.mass, np.array(link.com), link.inertia_matrix)
        Xml.SubElement(
            body,
            "joint",
            name=joint_name,
            type="slide" if origin.type == "prismatic" else "hinge",
            axis="0 0 1",
            limited="true",
            range=_text(limits.position_min_rad[index], limits.position_max_rad[index]),
            armature=_text(scene.motor_inertia[name][index]),
            frictionloss=_text(coulomb[index]),
            damping=_text(viscous[index]),
        )
        torque = limits.torque_Nm[index]
        Xml.SubElement(
            actuators,
            "general",
            name=joint_name,
            joint=joint_name,
            biastype="affine",
            gainprm=_text(arm.torque_gain[index]),
            biasprm=_text(arm.torque_offset[index], 0.0, 0.0),
            forcelimited="true",
            forcerange=_text(-torque, torque),
        )
    position = np.array(facts.flange.xyz) + facts.flange.rotation @ tool.mount.translation
    rotation = facts.flange.rotation @ tool.mount.rotation
    body = _body(body, f"{name}_end_effector", position, rotation)
    _inertial(body, tool.mass, tool.com, tool.inertia)
    Xml.SubElement(body, "site", name=f"{name}_E")
    pad = tool.pad_placement
    _geom(body, name, tool.shape, np.array(tool.pad_size), pad.translation, pad.rotation)


def _object(root: Xml.Element, world: Xml.Element, scene: ExportedScene) -> None:
    physics, object_ = scene.physics, scene.physics.object
    body = _body(world, "object", scene.object.position, scene.object.rotation)
    if object_.shape.kind == "hull":
        corners = np.array(object_.shape.corners).ravel()
        Xml.SubElement(Xml.SubElement(root, "asset"), "mesh", name="object", vertex=_text(*corners))
    if not object_.fixed:
        Xml.SubElement(body, "freejoint", name="object")
        _inertial(body, object_.mass, object_.com_offset, np.diag(object_.inertia))
    _geom(body, "object", object_.shape, object_.size, np.zeros(3), np.eye(3))
    height = scene.standing_height
    if height is not None:
        size = np.array([*physics.support_size, SUPPORT_THICKNESS])
        _box(world, SUPPORT, size, np.array([0.0, 0.0, height - SUPPORT_THICKNESS / 2.0]), np.eye(3))


def _contacts(root: Xml.Element, scene: ExportedScene) -> list[str]:
    """Add the contact pairs; returns notes on their numbers."""
    physics, contact, remarks = scene.physics, Xml.SubElement(root, "contact"), []
    lightness = 1.0 / physics.object.mass
    ratio = max(damping_ratio_of(scene.restitution), MIN_DAMPING_RATIO)
    for name, arm in physics.arms.items():
        pair = _pair(contact, name, physics.pad_friction, physics.rolling_arm)
        if scene.pads == "rigid" or arm.pad_stiffness is None:
            pair.set("solref", _text(TIME_STEP_S * max(2.0, MIN_STEPS_PER_BOUNCE_RADIAN / ratio), ratio))
            pair.set("solimp", _text(MAX_IMPEDANCE, MAX_IMPEDANCE, 1e-3, 0.5, 2.0))
            remarks.append(
                f"{name}: solref is (time constant [s], damping ratio); the ratio {ratio:.4g} has the restitution "
                f"{restitution_of(ratio):.3g} of a single impact (the model's: {scene.restitution:g})"
            )
            continue
        weight = _inverse_weight(scene, name) + lightness
        virtual = PAD_VIRTUAL_MASS_RATIO * scene.impact_mass(name)
        law = (arm.pad_stiffness, arm.pad_damping)
        impedance = _set_law(pair, law, virtual, weight, PAD_FRICTION_RATE_PER_S)
        remarks.append(
            f"{name}: solref is -(1 - d) w K / {FACE_CORNERS}, -(1 - d) w C / {FACE_CORNERS}: "
            f"the pad's K = {law[0]:g} N/m and "
            f"C = {law[1]:g} N s/m are shared by {FACE_CORNERS} corners, d = {impedance:.4g} is the impedance and "
            f"w = {weight:.5g} 1/kg the inverse weight of both bodies; a square impact has the restitution "
            f"{scene.restitution_of_pad(name):.3g}"
        )
    if physics.support_height is not None:
        pair = _pair(contact, SUPPORT, physics.support_friction, physics.rolling_arm)
        virtual = SUPPORT_VIRTUAL_MASS_RATIO * physics.object.mass
        _set_law(pair, scene.support_contact, virtual, lightness, SUPPORT_FRICTION_RATE_PER_S)
        remarks.append("support: {:.6g} N/m and {:.6g} N s/m under the whole object".format(*scene.support_contact))
    remarks.append(
        "friction is convex in MuJoCo: where a point slides at v, its partner is pushed off at up to mu v, and the "
        "jump differs from that of Coulomb friction"
    )
    return remarks


def _pair(contact: Xml.Element, partner: str, friction: float, rolling_arm: float) -> Xml.Element:
    """Friction between the object and a partner; all others pass through each other."""
    return Xml.SubElement(
        contact,
        "pair",
        name=f"object_{partner}",
        geom1=partner,
        geom2="object",
        condim="6" if rolling_arm else "3",
        friction=_text(friction, friction, 0.0, rolling_arm, rolling_arm),
        margin=_text(CONTACT_MARGIN_M),
    )


def _set_law(
    pair: Xml.Element, law: tuple[float, float], virtual_mass: float, weight: float, friction_rate: float
) -> float:
    """Give a pair stiffness and damping of the whole face [N/m, N s/m]; returns the impedance."""
    impedance = weight * virtual_mass / (1.0 + weight * virtual_mass)
    pair.set("solref", _text(*(-(1.0 - impedance) * weight / FACE_CORNERS * value for value in law)))
    pair.set("solreffriction", _text(-1e-9, -impedance * friction_rate))
    pair.set("solimp", _text(impedance, impedance, 1e-3, 0.5, 2.0))
    return impedance


def _inverse_weight(scene: ExportedScene, name: str) -> float:
    """MuJoCo's ``body_invweight0`` of an end effector: mean of ``diag(J M^-1 J^T)``, J of its centre of mass [1/kg].

    In the configuration in which all joints are at 0.
    """
    arm, model = scene.physics.arms[name], scene.physics.robot_model(name)
    zero = np.zeros(arm.facts.joint_count)
    jacobian = model.jacobian(zero)
    lever = model.placement(zero).rotation @ arm.end_effector.com
    linear = jacobian[:3] - pin.skew(lever) @ jacobian[3:]
    inertia = model.mass_matrix(zero) + np.diag(scene.motor_inertia[name])
    return float(np.trace(linear @ np.linalg.solve(inertia, linear.T)) / 3.0)


def _body(parent: Xml.Element, name: str, position: Array, rotation: Array) -> Xml.Element:
    return Xml.SubElement(parent, "body", name=name, pos=_text(*position), quat=_text(*_quaternion(rotation)))


def _inertial(body: Xml.Element, mass: float, com: Array, inertia: Array) -> None:
    entries = [inertia[index] for index in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    Xml.SubElement(body, "inertial", pos=_text(*com), mass=_text(mass), fullinertia=_text(*entries))


def _box(body: Xml.Element, name: str, size: Array, position: Array, rotation: Array) -> None:
    _geom(body, name, BOX, size, position, rotation)


def _geom(body: Xml.Element, name: str, shape: ConvexShape, size: Array, position: Array, rotation: Array) -> None:
    half = size / 2.0
    extents = {
        "sphere": half[:1],
        "capsule": np.array([half[0], half[2] - half[0]]),
        "cylinder": np.array([half[0], half[2]]),
    }.get(shape.kind, half)
    is_hull = shape.kind == "hull"
    geom = Xml.SubElement(body, "geom", name=name, type="mesh" if is_hull else shape.kind)
    if is_hull:
        geom.set("mesh", name)
    else:
        geom.set("size", _text(*extents))
    geom.set("pos", _text(*position))
    geom.set("quat", _text(*_quaternion(rotation)))
    geom.set("contype", "0")
    geom.set("conaffinity", "0")


def _quaternion(rotation: Array) -> Array:
    """w, x, y, z, ``(4,)``."""
    return np.roll(quaternion_of(rotation), 1)


def _text(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
