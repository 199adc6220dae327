# SPDX-License-Identifier: Apache-2.0
"""Convex shapes of bodies: box, sphere, capsule, cylinder, and the convex hull of a mesh.

A shape K about the middle of its bounding box is known by its support function

    h(d) = max_{x in K} d . x

(Rockafellar 1970, sec. 13; van den Bergen 2003, sec. 4.3), for a unit vector d in axes of the body, with extents 2 a:

=========  ======================================================  ==========================
box        a_x |d_x| + a_y |d_y| + a_z |d_z|                       corners, edges, six faces
sphere     r                                                       r = a_x = a_y = a_z
capsule    r + (a_z - r) |d_z|                                     r = a_x = a_y, axis z
cylinder   r sqrt(d_x^2 + d_y^2) + a_z |d_z|                       r = a_x = a_y, axis z
hull       max_i d . p_i                                           corners p_i
=========  ======================================================  ==========================

Along a normal n the distance of bodies P and O is s(n) = n . (c_O - c_P) - h_P(n) - h_O(-n). Their signed separation is
the largest s; if it is negative, its magnitude is the shortest translation that separates them. It lies at features of
the bodies that face each other: a face and any feature, two crossing edges, a corner and a curved wall, a rim and an
edge (the separating axis theorem, Gottschalk et al. 1996, with curved features). These features, clipped to each other,
give the contact points: of a flat cap eight points of its rim, fixed to the body, or the furthest point of its rim if
it is tilted by more than a milliradian. Tipping about a direction between two of the eight begins up to 8 % early.

``src/shapes.cpp`` finds them; two boxes have their own routine (``src/boxes.cpp``).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rs_sim import _kernel

Array = NDArray[np.float64]

Kind = Literal["box", "sphere", "capsule", "cylinder", "hull"]
KINDS: tuple[Kind, ...] = get_args(Kind)
COPLANAR = 1e-10  # 1 - cosine of the angle between triangles of one face


@dataclass(frozen=True)
class ConvexShape:
    """Shape of a body, up to its extents.

    Attributes:
        kind: Kind of the shape.
        corners: Corners of a hull, from the middle of its bounding box [m].
        faces: Faces of a hull: corner numbers, anticlockwise seen from outside.
    """

    kind: Kind = "box"
    corners: tuple[tuple[float, float, float], ...] = ()
    faces: tuple[tuple[int, ...], ...] = ()

    @property
    def is_box(self) -> bool:
        """Whether it is a box."""
        return self.kind == "box"

    @property
    def kernel(self) -> _kernel.Shape | None:
        """The shape for the compiled geometry; None: a box."""
        return None if self.is_box else _kernel_shape(self)

    def support(self, size: Array, direction: Array) -> Array | float:
        """Support function h, ``(...)`` [m].

        Args:
            size: Extents of the body along its axes, ``(3,)`` [m].
            direction: Unit vectors in axes of the body, ``(..., 3)``.
        """
        half, along = np.asarray(size) / 2.0, np.abs(direction)
        if self.kind == "box":
            return np.asarray(along @ half)
        if self.kind == "hull":
            return np.max(np.asarray(direction) @ np.array(self.corners).T, axis=-1)
        across = 1.0 if self.kind != "cylinder" else np.hypot(along[..., 0], along[..., 1])
        length = {"sphere": 0.0, "capsule": half[2] - half[0], "cylinder": half[2]}[self.kind]
        return np.asarray(half[0] * across + length * along[..., 2])

    def distance(self, size: Array, point: Array) -> float:
        """Signed distance from the surface to a point, negative inside [m]; of a hull to its nearest face plane.

        Args:
            size: Extents of the body along its axes, ``(3,)`` [m].
            point: In axes of the body, from its middle, ``(3,)`` [m].
        """
        half, along = np.asarray(size) / 2.0, np.abs(point)
        across = float(np.hypot(along[0], along[1]))
        if self.kind == "box":
            beyond = along - half
        elif self.kind == "cylinder":
            beyond = np.array([across, along[2]]) - half[1:]
        elif self.kind == "hull":
            corners = np.array([[self.corners[number] for number in face[:3]] for face in self.faces])
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            beyond = np.array([np.max(np.einsum("ki,ki->k", normals, point - corners[:, 0]))])
        else:
            beyond = np.array([np.hypot(across, max(along[2] - (half[2] - half[0]), 0.0)) - half[0]])
        return float(np.linalg.norm(np.maximum(beyond, 0.0)) + min(float(np.max(beyond)), 0.0))

    def first_points(self, size: Array, direction: Array, tolerance: float = 0.0) -> Array:
        """Candidates for the points that touch a plane first, ``(k, 3)`` [m].

        These are the corners; for a round body the corners of its section through axis and direction, because along a
        rim the height is a cosine. Eight fixed points represent the rim of a cylinder that is level up to a tolerance.

        Args:
            size: Extents of the body along its axes, ``(3,)`` [m].
            direction: Unit vector towards the plane, in axes of the body, ``(3,)``.
            tolerance: Largest difference of heights of points that touch together [m].
        """
        half = np.asarray(size) / 2.0
        if self.kind == "box":
            return np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) * size / 2.0
        if self.kind == "hull":
            return np.array(self.corners)
        if self.kind == "sphere":
            return half[:1] * direction[None, :]
        if self.kind == "capsule":
            return half[0] * direction + (half[2] - half[0]) * np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        tilt = float(np.hypot(direction[0], direction[1]))
        turns = np.pi / 4.0 * np.arange(8)
        if tilt > 0.0 and size[0] * tilt > tolerance:
            turns = np.arctan2(direction[1], direction[0]) + np.array([0.0, np.pi])
        rim = half[0] * np.column_stack((np.cos(turns), np.sin(turns)))
        return np.array([[x, y, z] for z in (half[2], -half[2]) for x, y in rim])

    def moments(self, mass: float, size: Array) -> Array:
        """Principal moments of inertia of a homogeneous body about its middle, ``(3,)`` [kg m^2].

        Args:
            mass: Mass [kg].
            size: Extents along its axes, ``(3,)`` [m].

        Raises:
            ValueError: A hull: its moments come with its mesh.
        """
        x, y, z = np.asarray(size, dtype=float).tolist()
        r = x / 2.0
        if self.kind == "box":
            return mass / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
        if self.kind == "sphere":
            return np.full(3, 0.4 * mass * r * r)
        if self.kind == "cylinder":
            return mass * np.array([(3.0 * r * r + z * z) / 12.0, (3.0 * r * r + z * z) / 12.0, r * r / 2.0])
        if self.kind == "capsule":  # a cylinder of length l between two halves of a ball, 3 r / 8 from their bases
            length = z - 2.0 * r
            tube = mass * length / (length + 4.0 / 3.0 * r)
            ends = mass - tube
            across = tube * (length**2 / 12.0 + r * r / 4.0)
            across += ends * (0.4 * r * r + length**2 / 4.0 + 3.0 / 8.0 * length * r)
            return np.array([across, across, tube * r * r / 2.0 + ends * 0.4 * r * r])
        raise ValueError("a hull has the moments of its mesh")


@functools.lru_cache(maxsize=64)
def hull_of(corners: tuple[tuple[float, float, float], ...]) -> ConvexShape:
    """The convex hull of points around the origin, with triangles of one plane joined to one face.

    Args:
        corners: From the middle of their bounding box, four or more [m].

    Raises:
        ValueError: They lie in a plane, or the origin is not inside.
    """
    points = np.array(corners, dtype=float)
    try:
        hull = scipy.spatial.ConvexHull(points)
    except (scipy.spatial.QhullError, ValueError):
        raise ValueError("corners: expected four points or more that are not in a plane [m]") from None
    planes: dict[int, set[int]] = {}
    owner = np.full(len(hull.simplices), -1)
    for start in range(len(hull.simplices)):  # neighbours with one normal are one face
        stack = [start] if owner[start] < 0 else []
        while stack:
            triangle = stack.pop()
            if owner[triangle] >= 0:
                continue
            owner[triangle] = start
            planes.setdefault(start, set()).update(hull.simplices[triangle].tolist())
            for neighbour in hull.neighbors[triangle]:
                if hull.equations[neighbour, :3] @ hull.equations[start, :3] > 1.0 - COPLANAR:
                    stack.append(int(neighbour))
    faces = []
    for start, numbers in planes.items():
        normal = hull.equations[start, :3]
        indices = np.array(sorted(numbers))
        offsets = points[indices] - points[indices].mean(axis=0)
        first = offsets[0] / np.linalg.norm(offsets[0])
        angle = np.arctan2(offsets @ np.cross(normal, first), offsets @ first)
        faces.append(indices[np.argsort(angle)])
    vertices = np.unique(np.concatenate(faces))
    new_index = {int(vertex): index for index, vertex in enumerate(vertices)}
    shape = ConvexShape(
        "hull",
        tuple(tuple(points[vertex].tolist()) for vertex in vertices),
        tuple(tuple(new_index[int(vertex)] for vertex in face) for face in faces),
    )
    shape.kernel  # noqa: B018  refuses faces that do not close around the origin
    return shape


def check_extents(kind: str, size: Sequence[float]) -> None:
    """Refuse extents that a shape cannot fill.

    Args:
        kind: Kind of the shape.
        size: Extents along x, y, z, ``(3,)`` [m].

    Raises:
        ValueError: It is round, and the extents are not.
    """
    x, y, z = size
    if kind in ("sphere", "capsule", "cylinder") and x != y:
        raise ValueError(f"a {kind} is round: size needs equal extents along x and y [m]")
    if kind == "sphere" and z != x:
        raise ValueError("a sphere has three equal extents: size is its diameter along x, y and z [m]")
    if kind == "capsule" and z < x:
        raise ValueError("a capsule is at least as long as its diameter: size needs z >= x [m]")


BOX, SPHERE, CAPSULE, CYLINDER = (ConvexShape(kind) for kind in ("box", "sphere", "capsule", "cylinder"))


@functools.lru_cache(maxsize=64)
def _kernel_shape(shape: ConvexShape) -> _kernel.Shape:
    corners = np.array(shape.corners) if shape.kind == "hull" else None
    return _kernel.Shape(shape.kind, corners, [list(face) for face in shape.faces])
