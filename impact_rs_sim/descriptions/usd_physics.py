# SPDX-License-Identifier: Apache-2.0
"""Physics of a scene as a layer of USD (text, .usda) over the robot imported from the URDF of :mod:`.urdf_scene`.

Masses are in ``PhysicsMassAPI``, friction and restitution of ``PhysicsMaterialAPI`` (UsdPhysics); B is
``physxJoint:armature`` and the compliance of a pad ``physxMaterial:compliantContactStiffness`` (PhysX schema). Prims
are named as links and joints of the URDF: ``/MODEL/ARM_link1``, ``/MODEL/joints/ARM_joint1``, ``/MODEL/object``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from impact_rs_sim.descriptions.exported_scene import FACE_CORNERS, ExportedQuantity, ExportedScene
from impact_rs_sim.impact_map.contacts import SUPPORT
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import quaternion_of

SUPPORTED_QUANTITIES = frozenset(
    {
        ExportedQuantity.MOTOR_INERTIA,
        ExportedQuantity.CONTACT_FRICTION,
        ExportedQuantity.RESTITUTION,
        ExportedQuantity.PAD_COMPLIANCE,
    }
)
OBJECT_FRICTION = 1e3  # larger than any pair's coefficient: a pair takes the smaller of both


def write(scene: ExportedScene) -> tuple[str, list[str]]:
    """The layer, and notes on how its numbers follow from the scene."""
    physics, object_ = scene.physics, scene.physics.object
    name = "_".join(physics.arms)
    lines = [
        "(",
        f'    defaultPrim = "{name}"',
        "    kilogramsPerUnit = 1",
        "    metersPerUnit = 1",
        '    upAxis = "Z"',
        ")",
        "",
        f'over "{name}"',
        "{",
    ]
    remarks = [
        "physxJoint:armature is the motor inertia B seen from the joint",
        "materials combine by the smaller value, and the object has the larger ones",
        "custom attributes impact_rs:* are for readers; no simulator takes them",
    ]
    for arm_name, arm in physics.arms.items():
        coulomb, viscous = scene.friction(arm_name)
        for index, link in enumerate(arm.facts.links, start=1):
            lines += _mass(f"{arm_name}_link{index}", link.mass, np.array(link.com), link.inertia_matrix)
        tool = arm.end_effector
        lines += _mass(f"{arm_name}_end_effector", tool.mass, tool.com, tool.inertia, f"/{name}/materials/{arm_name}")
        joints = []
        for index in range(arm.facts.joint_count):
            values = (
                ("float physxJoint:armature", scene.motor_inertia[arm_name][index]),
                ("custom double impact_rs:coulomb_friction", coulomb[index]),
                ("custom double impact_rs:viscous_friction", viscous[index]),
            )
            attributes = [f"{key} = {float(value)!r}" for key, value in values]
            joints += _over(f"{arm_name}_joint{index + 1}", ["PhysxJointAPI"], attributes)
        lines += _block("over", "joints", joints)
    if object_.fixed:  # without PhysicsRigidBodyAPI it is a static collider
        lines += _over("object", ["MaterialBindingAPI"], [_binding(f"/{name}/materials/object")])
    else:
        com, moments = object_.com_offset, np.diag(object_.inertia)
        lines += _mass("object", object_.mass, com, moments, f"/{name}/materials/object")
    materials = _material("object", OBJECT_FRICTION, 1.0)
    for arm_name, arm in physics.arms.items():
        compliant = []
        if scene.pads == "compliant" and arm.pad_stiffness is not None:
            compliant = [
                f"float physxMaterial:compliantContactStiffness = {arm.pad_stiffness / FACE_CORNERS!r}",
                f"float physxMaterial:compliantContactDamping = {arm.pad_damping / FACE_CORNERS!r}",
            ]
            remarks.append(
                f"{arm_name}: stiffness {arm.pad_stiffness:g} N/m and damping {arm.pad_damping:g} N s/m of the pad are "
                f"shared by {FACE_CORNERS} corners; "
                f"restitution {scene.restitution_of_pad(arm_name):.3g} follows from them"
            )
        materials += _material(arm_name, physics.pad_friction, scene.restitution, compliant)
    if physics.support_height is not None:
        materials += _material(SUPPORT, physics.support_friction, 0.0)
        lines += _over(SUPPORT, ["MaterialBindingAPI"], [_binding(f"/{name}/materials/{SUPPORT}")])
    lines += [*_block("def Scope", "materials", materials), "}"]
    return "\n".join(lines) + "\n", remarks


def _mass(name: str, mass: float, com: Array, inertia: Array, material: str = "") -> list[str]:
    """A body; principal axes follow from its inertia."""
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    attributes = [
        f"float physics:mass = {float(mass)!r}",
        f"point3f physics:centerOfMass = {_tuple(com)}",
        f"float3 physics:diagonalInertia = {_tuple(moments)}",
        f"quatf physics:principalAxes = {_tuple(np.roll(quaternion_of(axes), 1))}",
    ]
    schemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    if material:
        return _over(name, [*schemas, "MaterialBindingAPI"], [*attributes, _binding(material)])
    return _over(name, schemas, attributes)


def _binding(material: str) -> str:
    return f"rel material:binding:physics = <{material}>"


def _material(name: str, friction: float, restitution: float, further: Iterable[str] = ()) -> list[str]:
    attributes = [
        f"float physics:staticFriction = {float(friction)!r}",
        f"float physics:dynamicFriction = {float(friction)!r}",
        f"float physics:restitution = {float(restitution)!r}",
        'uniform token physxMaterial:frictionCombineMode = "min"',
        'uniform token physxMaterial:restitutionCombineMode = "min"',
        *further,
    ]
    return _over(name, ["PhysicsMaterialAPI", "PhysxMaterialAPI"], attributes, "def Material")


def _over(name: str, schemas: list[str], attributes: Iterable[str], kind: str = "over") -> list[str]:
    listed = ", ".join(f'"{schema}"' for schema in schemas)
    head = [f'{kind} "{name}" (', f"    prepend apiSchemas = [{listed}]", ")", "{"]
    return list(_indented([*head, *(f"    {attribute}" for attribute in attributes), "}"]))


def _block(kind: str, name: str, lines: list[str]) -> list[str]:
    return list(_indented([f'{kind} "{name}"', "{", *lines, "}"]))


def _indented(lines: Iterable[str]) -> Iterator[str]:
    return (f"    {line}" for line in lines)


def _tuple(values: Iterable[float]) -> str:
    return "(" + ", ".join(repr(float(value)) for value in values) + ")"
