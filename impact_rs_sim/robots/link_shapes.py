# SPDX-License-Identifier: Apache-2.0
"""Simple shapes of the links of an arm without meshes: tubes and housings, from robot facts.

Two joint axes in space have a common normal (Denavit and Hartenberg 1955). A link runs from its joint along the joint
axis to that normal, along the normal, and along the next axis to the next joint; between parallel axes it runs across
at the height of its centre of mass. Each joint has a housing along its axis. Radii decrease from base to tip with the
cube root of the torque limits: a motor of twice the size has about eight times the torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from impact_rs_sim.robots.robot import Array, RobotFacts

TUBE_RADIUS_RATIO = 0.048  # radius of the thickest tube over the length of the arm [-]
MIN_TUBE_RADIUS_M = 0.02  # m
MIN_RADIUS_SHARE = 0.55  # share of the radius that does not depend on the torque limit [-]
HOUSING_RATIOS = (1.12, 1.15)  # radius and half length of a housing over the radius of the tube [-]
RING_LENGTH_RATIO = 0.22  # length of the ring at each end of a housing over its radius [-]
MIN_PARALLEL_COSINE = 0.999  # of the angle between two axes that are parallel
MIN_TUBE_LENGTH_M = 1e-4  # m, of a tube
TOOL_RADIUS_M = 0.03  # of the tube from flange to pad
FOOT_RATIOS = (1.35, 0.06)  # radius of the foot over radius of the first tube, height over length of the arm [-]


@dataclass(frozen=True)
class Shape:
    """A cylinder, or with equal ends a ball.

    Attributes:
        start: Centre of one end in the link, ``(3,)`` [m].
        end: Centre of the other, ``(3,)`` [m].
        radius: Its radius [m].
        colour: ``shell`` or ``joint``.
    """

    start: Array
    end: Array
    radius: float
    colour: str = "shell"


def link_shapes(facts: RobotFacts) -> list[list[Shape]]:
    """Shapes of the base and of every link, in their own frames."""
    origins = [np.array(joint.xyz) for joint in facts.joints] + [np.array(facts.flange.xyz)]
    axes = [pin.rpy.rpyToMatrix(*joint.rpy)[:, 2] for joint in facts.joints] + [facts.flange.rotation[:, 2]]
    length = sum(float(np.linalg.norm(origin)) for origin in origins)
    torque = np.cbrt(np.array(facts.limits.torque_Nm) / max(facts.limits.torque_Nm))
    radii = np.maximum(
        MIN_TUBE_RADIUS_M, TUBE_RADIUS_RATIO * length * (MIN_RADIUS_SHARE + (1.0 - MIN_RADIUS_SHARE) * torque)
    )
    foot = Shape(np.zeros(3), np.array([0.0, 0.0, FOOT_RATIOS[1] * length]), FOOT_RATIOS[0] * float(radii[0]), "joint")
    shapes = [[foot, *_tubes(np.zeros(3), origins[0], axes[0], np.zeros(3), float(radii[0]))]]
    for index, (link, joint) in enumerate(zip(facts.links, facts.joints, strict=True)):
        radius = float(radii[index])
        tubes = _tubes(np.zeros(3), origins[index + 1], axes[index + 1], np.array(link.com), radius)
        shapes.append([*(_housing(radius) if joint.type == "revolute" else ()), *tubes])
    return shapes


def _housing(radius: float) -> list[Shape]:
    """Housing of a joint along the axis of its link, with a ring at each end."""
    wide, half = HOUSING_RATIOS[0] * radius, HOUSING_RATIOS[1] * radius
    up = np.array([0.0, 0.0, 1.0])
    ends = [
        Shape(side * half * up, side * (half + RING_LENGTH_RATIO * radius) * up, wide, "joint") for side in (-1.0, 1.0)
    ]
    return [Shape(-half * up, half * up, wide), *ends]


def _tubes(start: Array, end: Array, axis: Array, com: Array, radius: float) -> list[Shape]:
    """Tubes from joint to joint, with a ball at every corner."""
    corners = [start, *_corners(end, axis, com), end]
    distinct = [corners[0]]
    for corner in corners[1:]:
        if float(np.linalg.norm(corner - distinct[-1])) > MIN_TUBE_LENGTH_M:
            distinct.append(corner)
    tubes = [Shape(a, b, radius) for a, b in zip(distinct, distinct[1:], strict=False)]
    return [*tubes, *(Shape(corner, corner, radius) for corner in distinct[1:-1])]


def _corners(end: Array, axis: Array, com: Array) -> list[Array]:
    """Corners of the common-normal path of a link from its own axis z to the next axis."""
    own_axis = np.array([0.0, 0.0, 1.0])
    if abs(float(own_axis @ axis)) > MIN_PARALLEL_COSINE:
        first = float(com[2]) * own_axis
        return [first, np.array([end[0], end[1], first[2]])]
    normal = np.cross(own_axis, axis)
    along_own, across, along_next = np.linalg.solve(np.column_stack((own_axis, normal, axis)), end)
    del along_next
    return [along_own * own_axis, along_own * own_axis + across * normal]
