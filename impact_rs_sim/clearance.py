# SPDX-License-Identifier: Apache-2.0
"""Clearance of arms from each other, and of arms and pads from support and ground, checked before a trial starts.

Coal, the collision library below Pinocchio, finds distances.

Between two arms every link is a capsule from its joint to the next one: a coarse, conservative hull. Against support
and ground a link has its simple shapes (:mod:`impact_rs_sim.robots.link_shapes`), the end effector its tube, and the
pad its box.

A scenario does not state where its table ends: arms may be mounted inside its extent, and pads that grab may come from
beside it. Only the part below the object is certain, from its start to the end of the push, with a rim around it. The
ground is the plane z = 0 of A, or lower if a base or the support is lower. Links next to the base that overlap the
ground in every sampled pose are part of the mounting, not a collision.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map.contacts import SUPPORT_THICKNESS
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.link_shapes import TOOL_RADIUS_M, Shape, link_shapes
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import TIP, RobotModel
from impact_rs_sim.scene import BodyState

LINK_RADIUS_M = 0.06  # of the capsule around a link; conservative for the shipped arms
MIN_LINK_LENGTH_M = 1e-6  # joints with a common origin have no link between them
MAX_ROUNDING_OVERLAP_M = 1e-6  # a smaller overlap is rounding
SUPPORT_RIM_M = 0.02  # by which a table extends at least beyond the object on it; assumed, thickness of the pads

Capsule = tuple[str, coal.Capsule, coal.Transform3s]


def capsules(model: RobotModel, q: Array) -> list[Capsule]:
    """Capsules around an arm: name, shape and placement of every link with a length.

    Args:
        model: The arm.
        q: Joint positions, ``(n,)`` [rad].
    """
    placements = model.link_placements(q)
    names = ["base", *(f"link{index + 1}" for index in range(model.joint_count))]
    pad = model.placement(q)
    origins = [placements[name].translation for name in names] + [pad.translation - LINK_RADIUS_M * pad.rotation[:, 2]]
    shapes = []
    for name, start, end in zip(names, origins, origins[1:], strict=False):
        length = float(np.linalg.norm(end - start))
        if length < MIN_LINK_LENGTH_M:
            continue
        along = (end - start) / length
        across = np.linalg.svd(along[None])[2][1:]
        rotation = np.column_stack((across[0], np.cross(along, across[0]), along))
        shapes.append((name, coal.Capsule(LINK_RADIUS_M, length), coal.Transform3s(rotation, 0.5 * (start + end))))
    return shapes


def check_clearance(models: dict[str, RobotModel], positions: dict[str, Array], when: str) -> None:
    """Check that the arms do not collide with each other.

    Args:
        models: Arms by name.
        positions: Joint positions by arm, ``(n,)`` [rad].
        when: Name of the moment, for the message.

    Raises:
        Infeasible: Two arms touch; names their links and by how much they overlap.
    """
    shapes_by_arm = {name: capsules(model, positions[name]) for name, model in models.items()}
    for first, second in combinations(shapes_by_arm, 2):
        for name, shape, pose in shapes_by_arm[first]:
            for other_link, other_shape, other_pose in shapes_by_arm[second]:
                gap = coal.distance(shape, pose, other_shape, other_pose, coal.DistanceRequest(), coal.DistanceResult())
                if gap < 0.0:
                    raise Infeasible(
                        f"arms {first!r} and {second!r} collide {when}: {name} and {other_link} overlap by "
                        f"{-gap:.3f} m; move their bases apart or choose other impact poses"
                    )


@dataclass(frozen=True)
class Penetration:
    """Maximum penetration of an arm into support or ground along a path.

    Attributes:
        part: The link, the end effector or the pad, in words.
        partner: ``support`` or ``ground``.
        surface: Height of its surface [m].
        depth: Penetration depth [m].
        index: Sample of the path.
    """

    part: str
    partner: str
    surface: float
    depth: float
    index: int


def deepest_penetration(
    physics: Physics, name: str, positions: Array, object_: BodyState, displacement: Array
) -> Penetration | None:
    """Maximum penetration of an arm into support or ground along a path; None without a collision.

    Args:
        physics: Parameters of the scene.
        name: The arm.
        positions: Joint positions along the path, ``(k, n)`` [rad].
        object_: Pose of the object.
        displacement: Displacement of the object on its support, in A, ``(3,)`` [m].
    """
    model, obstacles = physics.robot_model(name), _obstacles(physics, object_, displacement)
    parts = _collision_bodies(model)
    depths = np.zeros((len(obstacles), len(positions), len(parts)))
    for index, q in enumerate(positions):
        links = model.link_placements(q)
        for number, part in enumerate(parts):
            for obstacle_index, obstacle in enumerate(obstacles):
                depths[obstacle_index, index, number] = obstacle.depth(part, links[part.link])
    mounting = np.minimum.accumulate((depths[-1] > MAX_ROUNDING_OVERLAP_M).all(axis=0)) & [
        part.link != TIP for part in parts
    ]
    depths[-1][:, mounting] = 0.0
    deepest = tuple(int(pose) for pose in np.unravel_index(np.argmax(depths), depths.shape))
    if depths[deepest] <= MAX_ROUNDING_OVERLAP_M:
        return None
    part, obstacle = parts[deepest[2]], obstacles[deepest[0]]
    return Penetration(part.name, obstacle.name, obstacle.top, float(depths[deepest]), deepest[1])


Solid = tuple[coal.CollisionGeometry, coal.Transform3s]


@dataclass(frozen=True)
class _MovingBody:
    """Convex shapes that move with a link: placements in it, and bounding spheres, ``(m, 3)`` and ``(m,)`` [m]."""

    name: str
    link: str
    shapes: list[tuple[coal.CollisionGeometry, pin.SE3]]

    @functools.cached_property
    def spheres(self) -> tuple[Array, Array]:
        for shape, _ in self.shapes:
            shape.computeLocalAABB()
        centres = np.array([pose.act(shape.aabb_center) for shape, pose in self.shapes])
        return centres, np.array([shape.aabb_radius for shape, _ in self.shapes])


@dataclass(frozen=True)
class _Obstacle:
    """An obstacle: the intersection of convex solids; its highest point is ``top`` [m]."""

    name: str
    solids: tuple[Solid, ...]
    top: float

    def depth(self, part: _MovingBody, link: pin.SE3) -> float:
        """Penetration depth of a part [m]; 0 without a collision."""
        centres, radii = part.spheres
        deepest, low = 0.0, centres @ link.rotation[2] + link.translation[2] - radii
        for index in np.flatnonzero(low < self.top):
            shape, shape_placement = part.shapes[index]
            placement = link * shape_placement
            pose = coal.Transform3s(placement.rotation, placement.translation)
            deepest = max(deepest, min(_penetration_depth((shape, pose), solid) for solid in self.solids))
        return deepest


def _penetration_depth(first: Solid, second: Solid) -> float:
    """Penetration depth of two convex solids by GJK/EPA; negative: their distance [m]."""
    return -float(coal.distance(*first, *second, coal.DistanceRequest(), coal.DistanceResult()))


def _obstacles(physics: Physics, object_: BodyState, displacement: Array) -> list[_Obstacle]:
    """Obstacles: the known part of the support, if there is one, and the ground."""
    height, obstacles = physics.support_height, []
    ground = min(0.0, *(float(arm.base.translation[2]) for arm in physics.arms.values()))
    if height is not None:
        ground, centre_height = min(ground, height), height - SUPPORT_THICKNESS / 2.0
        reach = np.abs(object_.rotation[:2]) @ physics.object.size / 2.0 + SUPPORT_RIM_M
        low, high = (ends(np.zeros(2), displacement[:2]) for ends in (np.minimum, np.maximum))
        certain_part = coal.Box(*(high - low + 2.0 * reach), SUPPORT_THICKNESS)
        centre_below = np.append(object_.position[:2] + (low + high) / 2.0, centre_height)
        table = coal.Box(*physics.support_size, SUPPORT_THICKNESS)
        placements = (coal.Transform3s(np.eye(3), pose) for pose in (centre_below, np.array([0.0, 0.0, centre_height])))
        obstacles.append(_Obstacle("support", tuple(zip((certain_part, table), placements, strict=True)), height))
    plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), ground)
    return [*obstacles, _Obstacle("ground", ((plane, coal.Transform3s.Identity()),), ground)]


def _collision_bodies(model: RobotModel) -> list[_MovingBody]:
    """Collision bodies of the links (without the base), the end effector and the pad."""
    effector = model.end_effector
    links = link_shapes(model.facts)[1:]
    tube = Shape(effector.mount.inverse().translation, np.array([0.0, 0.0, -effector.pad_size[2]]), TOOL_RADIUS_M)
    return [
        *(
            _MovingBody(f"link {number}", f"link{number}", [_collider(shape) for shape in shapes])
            for number, shapes in enumerate(links, start=1)
        ),
        _MovingBody("its end effector", TIP, [_collider(tube)]),
        _MovingBody("its pad", TIP, [(coal.Box(*effector.pad_size), effector.pad_placement)]),
    ]


def _collider(shape: Shape) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """A simple shape and its placement in the link."""
    length = float(np.linalg.norm(shape.end - shape.start))
    if length < MIN_LINK_LENGTH_M:
        return coal.Sphere(shape.radius), pin.SE3(np.eye(3), shape.start)
    axis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (shape.end - shape.start) / length)
    return coal.Cylinder(shape.radius, length), pin.SE3(axis.matrix(), (shape.start + shape.end) / 2.0)
