# SPDX-License-Identifier: Apache-2.0
"""A convex object from its mesh: corners of its hull, centre of mass and inertia of an even density.

Mass, first and second moments of the polyhedron are sums over the tetrahedra between the origin and its triangles
(a, b, c), of volume V = det(a, b, c) / 6, with centre (a + b + c) / 4 and second moments
V / 20 (a a^T + b b^T + c c^T + s s^T), s = a + b + c (Tonon 2004). They belong to the mesh itself, with all of its
corners. Contact takes the hull (Barber et al. 1996, Qhull); a mesh that is smaller than its hull is refused unless the
caller accepts the hull.

Over a closed surface the integral of x n^T is V times the unit matrix (Gauss's theorem for the functions x, y, z); an
opening of area A at a distance d from the centre changes it by A d.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import coal
import numpy as np
import scipy

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import is_file
from impact_rs_sim.robots.bodies import inertia_of
from impact_rs_sim.robots.robot import Array

MAX_CORNERS = 200  # of a hull; of finer hulls the corners that are furthest in as many directions are kept
MAX_HULL_EXCESS = 0.02  # volume of the hull over volume of the mesh, minus 1, of a convex mesh [-]
MAX_OPEN_SHARE = 1e-3  # error of a closed surface in Gauss's theorem over the volume; float32 corners have 1e-6 [-]
MAX_PRODUCT_SHARE = 0.01  # product of inertia over the trace of a body with principal axes x, y, z [-]


@dataclass(frozen=True)
class ObjectMesh:
    """Geometry and inertia of an object from its mesh.

    Attributes:
        corners: Corners of the hull, from the middle of its bounding box, ``(k, 3)`` [m].
        size: Extents, ``(3,)`` [m].
        com: Centre of mass from that middle, ``(3,)`` [m].
        moments: Moments of inertia about the centre of mass over the mass, ``(3,)`` [m^2].
        volume: Volume of the mesh itself [m^3].
        hull_excess: Volume of the hull over volume of the mesh, minus 1 [-].
        middle: Middle of the bounding box in the axes of the file, ``(3,)`` [m].
    """

    corners: Array
    size: Array
    com: Array
    moments: Array
    volume: float
    hull_excess: float
    middle: Array

    def stretched(self, size: Array) -> ObjectMesh:
        """The mesh with other extents: second moments grow with the square of the stretch of their axis.

        Args:
            size: Extents, ``(3,)`` [m].
        """
        ratio = np.asarray(size) / self.size
        second = (0.5 * np.sum(self.moments) - self.moments) * ratio**2
        return replace(
            self,
            corners=self.corners * ratio,
            size=np.asarray(size, dtype=float),
            com=self.com * ratio,
            moments=np.sum(second) - second,
            volume=self.volume * float(np.prod(ratio)),
            middle=self.middle * ratio,
        )


def read_object_mesh(path: Path, scale: float = 1.0, convex: bool = True) -> ObjectMesh:
    """The object of a mesh file (STL, OBJ, DAE or PLY); its z points up at rest.

    Args:
        path: The file.
        scale: Metres per unit of length of the file.
        convex: Whether a body that is not convex is refused.

    Raises:
        InputError: No such file, no closed surface, or a body that is not convex or whose principal axes of inertia are
            not its own axes.
    """
    if not is_file(path):
        raise InputError("no such file", file=path)
    try:
        mesh = coal.MeshLoader().load(str(path), np.full(3, scale))
    except (ValueError, RuntimeError, IndexError) as error:
        raise InputError(f"expected a mesh as STL, OBJ, DAE or PLY: {error}", file=path) from None
    return object_mesh(*triangles_of(mesh), path, convex)


def triangles_of(mesh: coal.BVHModelBase) -> tuple[Array, Array]:
    """Corners of a loaded mesh, ``(k, 3)`` [m], and corner numbers of its triangles, ``(m, 3)``."""
    numbers = [mesh.tri_indices(index) for index in range(mesh.num_tris)]
    points = np.array(mesh.vertices(), dtype=float).reshape(-1, 3)
    return points, np.array([[triangle[0], triangle[1], triangle[2]] for triangle in numbers], dtype=int)


def object_mesh(points: Array, triangles: Array, path: Path, convex: bool = True) -> ObjectMesh:
    """The object of a closed surface.

    Args:
        points: Corners, ``(k, 3)`` [m].
        triangles: Corner numbers, anticlockwise seen from outside, ``(m, 3)``.
        path: File, for errors.
        convex: Whether a body that is not convex is refused.

    Raises:
        InputError: As :func:`read_object_mesh`.
    """
    try:
        hull = scipy.spatial.ConvexHull(points)
    except (scipy.spatial.QhullError, ValueError):  # too few corners, or all of them in one plane
        message = "it is flat or empty; expected a body with a volume: export the solid, not a face or a drawing of it"
        raise InputError(message, file=path) from None
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    points = points - middle
    a, b, c = (points[triangles[:, side]] for side in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    volume = float(volumes.sum())
    _check_closed((a, b, c), volume, hull.volume, path)
    excess = float(hull.volume / volume - 1.0)
    if convex and excess > MAX_HULL_EXCESS:
        raise InputError(
            f"it is not convex: its hull has {excess:.0%} more volume; one convex body can be hit, "
            "no hollow and no handle",
            file=path,
        )
    s = a + b + c
    com = np.einsum("i,ij->j", volumes, s) / (4.0 * volume)
    second = sum(np.einsum("i,ij,ik->jk", volumes, corner, corner) for corner in (a, b, c, s)) / (20.0 * volume)
    moments = principal_moments(inertia_of(np.asarray(second) - np.outer(com, com)), path)
    corners = points[hull.vertices]
    if len(corners) > MAX_CORNERS:
        corners = _furthest(corners)
    half = np.maximum(corners.max(axis=0), -corners.min(axis=0))
    return ObjectMesh(corners, 2.0 * half, com, moments, volume, excess, middle)


def principal_moments(inertia: Array, path: Path) -> Array:
    """Diagonal of an inertia whose principal axes are those of the body, ``(3,)``.

    Args:
        inertia: About the centre of mass in axes of the body, over the mass or not, ``(3, 3)``.
        path: File, for errors.

    Raises:
        InputError: Its principal axes differ from those of the body.
    """
    products = np.abs(inertia - np.diag(np.diag(inertia))).max()
    if products > MAX_PRODUCT_SHARE * np.trace(inertia):
        cosine = (
            np.abs(np.linalg.eigh(inertia)[1]).max(axis=0).min()
        )  # between a principal axis and the nearest of x, y, z
        turned = np.degrees(np.arccos(min(cosine, 1.0)))
        raise InputError(
            f"its principal axes of inertia are turned by about {turned:.0f} degrees against its axes; turn it "
            "in its file so that they are its own",
            file=path,
        )
    return np.diag(inertia).copy()


def _check_closed(sides: tuple[Array, Array, Array], volume: float, hull_volume: float, path: Path) -> None:
    """Refuse a surface with openings, or with normals that point inwards."""
    a, b, c = sides
    area = np.cross(b - a, c - a) / 2.0
    missed = np.einsum("ij,ik->jk", (a + b + c) / 3.0, area) - volume * np.eye(3)
    open_share = float(np.abs(missed).max()) / hull_volume
    if open_share > MAX_OPEN_SHARE:
        raise InputError(
            f"its surface does not close around a volume: openings miss {open_share:.1%} of the hull's volume; close "
            "its holes in the program that made it, or export the solid again",
            file=path,
        )
    if not 0.0 < volume <= hull_volume * (1.0 + 1e-6):
        raise InputError(
            f"its surface does not close around a volume (found {volume:.3g} m^3, its hull has {hull_volume:.3g} m^3); "
            "let the normals of its triangles point outwards",
            file=path,
        )


def _furthest(corners: Array) -> Array:
    """The corners that are furthest along the axes and in directions spread evenly over the sphere."""
    count = MAX_CORNERS - 6
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)  # golden angle
    across = np.sqrt(1.0 - height**2)
    spread = np.column_stack((across * np.cos(turn), across * np.sin(turn), height))
    directions = np.vstack((spread, np.eye(3), -np.eye(3)))
    return corners[np.unique(np.argmax(directions @ corners.T, axis=1))]
