# SPDX-License-Identifier: Apache-2.0
"""Free bodies by shape, extents and mass, of an even density; tables of impacts and experiments describe them so."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.files import is_file
from impact_rs_sim.physics import ObjectPhysics
from impact_rs_sim.scenarios.object_mesh import ObjectMesh, read_object_mesh
from impact_rs_sim.shapes import KINDS, ConvexShape, check_extents, hull_of

FREE_KINDS = tuple(kind for kind in KINDS if kind != "hull")  # a hull is that of a mesh
HOLLOW = 2.0 / 3.0  # m r^2, moment of a ball that is a thin shell
ROUND_AXES = {"sphere": "xyz", "capsule": "xy", "cylinder": "xy"}  # equal extents of a shape


def body_of_shape(kind: str, mass: float, size: Sequence[float], shell: bool = False) -> ObjectPhysics:
    """A homogeneous body.

    Args:
        kind: One of ``FREE_KINDS``; capsule and cylinder have the axis z.
        mass: Mass [kg].
        size: Extents along its axes, ``(3,)`` [m].
        shell: Whether it is a hollow ball.

    Raises:
        ValueError: There is no such shape, or it is round and the extents are not.
    """
    if kind not in FREE_KINDS:
        hint = "; column or key mesh names the file of a mesh" if kind in ("hull", "mesh") else ""
        raise ValueError(f"expected {', '.join(FREE_KINDS)}{did_you_mean(kind, FREE_KINDS)}{hint}")
    extents = np.array(size, dtype=float)
    check_extents(kind, extents.tolist())
    shape = next(ConvexShape(free_kind) for free_kind in FREE_KINDS if free_kind == kind)
    inertia = np.full(3, HOLLOW * mass * (extents[0] / 2.0) ** 2) if shell else shape.moments(mass, extents)
    return ObjectPhysics(mass, extents, inertia, np.zeros(3), shape)


def body_of_mesh(path: Path, mass: float, size: Sequence[float] | None = None) -> ObjectPhysics:
    """The convex hull of a mesh, with the centre of mass and the moments of the mesh for an even density.

    Args:
        path: File of the mesh (:mod:`impact_rs_sim.scenarios.object_mesh`).
        mass: Mass [kg].
        size: Extents to which the mesh is stretched, ``(3,)`` [m]; None: its own, in metres.

    Raises:
        InputError: It cannot be read, is no solid, or not convex.
    """
    if not is_file(path):
        raise InputError("no such file", file=path)
    mesh = _mesh(path, path.stat().st_mtime_ns)
    if size is not None:
        mesh = mesh.stretched(np.array(size))
    try:
        shape = hull_of(tuple(map(tuple, mesh.corners.tolist())))
    except ValueError as error:
        raise InputError(f"its hull cannot be hit: {error}", file=path) from None
    return ObjectPhysics(mass, mesh.size, mass * mesh.moments, mesh.com, shape)


@functools.lru_cache(maxsize=16)
def _mesh(path: Path, modified: int) -> ObjectMesh:
    """The mesh of a file as it was at a time."""
    del modified
    return read_object_mesh(path)
