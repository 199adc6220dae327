# SPDX-License-Identifier: Apache-2.0
"""A scene as one URDF: arms, support and the object, which floats.

A URDF has masses, centres of mass, inertias, limits, and Coulomb and viscous joint friction (``dynamics``). It has
neither motor inertia nor contact laws.
"""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_sim.descriptions.exported_scene import ExportedQuantity, ExportedScene
from impact_rs_sim.robots.urdf import WORLD, write_description, write_object_description

SUPPORTED_QUANTITIES = frozenset(
    {ExportedQuantity.COULOMB_FRICTION, ExportedQuantity.VISCOUS_FRICTION, ExportedQuantity.PAD_TILT}
)


def write(scene: ExportedScene) -> tuple[str, list[str]]:
    """The file, and notes on how its numbers follow from the scene."""
    physics, object_ = scene.physics, scene.physics.object
    height = scene.standing_height
    arms = {name: (arm.facts, arm.end_effector, arm.base) for name, arm in physics.arms.items()}
    support = None if height is None else (height, physics.support_size)
    root = Xml.fromstring(write_description(arms, support, meshes=False))
    for name in arms:
        for index, (coulomb, viscous) in enumerate(zip(*scene.friction(name), strict=True), start=1):
            dynamics = root.find(f"joint[@name='{name}_joint{index}']/dynamics")
            assert dynamics is not None, "every joint that moves has dynamics"
            dynamics.set("friction", repr(float(coulomb)))
            dynamics.set("damping", repr(float(viscous)))
    described = write_object_description(
        object_.size, (object_.mass, object_.com_offset, np.diag(object_.inertia)), object_.shape
    )
    root.extend(Xml.fromstring(described))
    joint = Xml.SubElement(root, "joint", name="object", type="fixed" if object_.fixed else "floating")
    Xml.SubElement(joint, "parent", link=WORLD)
    Xml.SubElement(joint, "child", link="object")
    turn = pin.rpy.matrixToRpy(scene.object.rotation)
    xyz, rpy = (" ".join(repr(float(value)) for value in values) for values in (scene.object.position, turn))
    Xml.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    Xml.indent(root)
    positions = "; ".join(
        f"{name} {' '.join(f'{value:.6g}' for value in state.position)}" for name, state in scene.arms.items()
    )
    return Xml.tostring(root, encoding="unicode"), [
        "dynamics: friction is Coulomb friction, damping viscous friction of the joint",
        "the object is fixed to the world"
        if object_.fixed
        else "the object floats (joint type 'floating'); at the impact it is at its origin",
        f"joint positions at the impact: {positions}",
        *(["the object is shown as the box of its extents"] if object_.shape.kind == "hull" else []),
    ]
