# SPDX-License-Identifier: Apache-2.0
"""Simplified meshes of a robot for a page, from STL, DAE and OBJ files of its URDF.

The vertices in a cell of a grid are merged into their mean (Rossignac and Borrel 1993); the cells grow until the number
of triangles is at most ``MAX_FACES``. As in the viewers of ROS 2, a DAE file has its own unit of length, and its
``up_axis`` is ignored.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
from numpy.typing import NDArray

from impact_rs_sim.robots.mesh_files import mesh_path
from impact_rs_sim.robots.robot import Array

MAX_FACES = 1200  # per mesh; twenty such meshes are 0.5 MB of a page
MAX_INITIAL_CELLS = 64  # along the longest side
COARSENING_FACTOR = 0.8  # ratio of the numbers of cells in successive attempts
MAX_MESH_BYTES = 50_000_000  # of a file; a larger mesh is replaced by a simple shape
HEADER, RECORD = 84, 50  # bytes, of a binary STL
COAL_SUFFIXES = (".dae", ".obj")  # loaded by coal, which comes with Pinocchio
UNIT = re.compile(rb"""<unit\b[^>]*\bmeter\s*=\s*["']([^"']+)""")  # of a DAE file [m]
VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


@dataclass(frozen=True)
class Surface:
    """Triangles.

    Attributes:
        vertices: In the units of the file, ``(v, 3)``.
        faces: Rows of the vertices of every triangle, ``(f, 3)``.
    """

    vertices: Array
    faces: NDArray[np.int64]


@functools.lru_cache(maxsize=64)
def surface_of(address: str) -> Surface | None:
    """The mesh at an address of :func:`~impact_rs_sim.robots.mesh_files.mesh_path`; None without a readable file."""
    path = mesh_path(address)
    try:
        if path is None or path.stat().st_size > MAX_MESH_BYTES:
            return None
        corners = _loaded(path) if path.suffix.lower() in COAL_SUFFIXES else _corners(path.read_bytes())
    except (OSError, ValueError, RuntimeError):  # coal raises the latter two
        return None
    return _coarse(corners) if corners.size and np.isfinite(corners).all() else None


def _corners(data: bytes) -> Array:
    """Corners of the triangles of an STL file, binary or text, ``(f, 3, 3)``; empty for another file."""
    count = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    if len(data) == HEADER + RECORD * count:
        kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        return np.frombuffer(data, kind, offset=HEADER)["corners"].astype(float)
    if not data.lstrip().startswith(b"solid"):
        return np.zeros((0, 3, 3))
    return np.array([[float(word) for word in coordinates] for coordinates in VERTEX.findall(data)]).reshape(-1, 3, 3)


def _loaded(path: Path) -> Array:
    """Corners of the triangles of a DAE or OBJ file, ``(f, 3, 3)`` [m]."""
    mesh = coal.MeshLoader().load(str(path), np.ones(3))
    triangles = (mesh.tri_indices(row) for row in range(mesh.num_tris))
    faces = [[triangle[corner] for corner in range(3)] for triangle in triangles]
    unit = UNIT.search(path.read_bytes()) if path.suffix.lower() == ".dae" else None
    scale = 1.0 if unit is None else float(unit[1])
    return scale * np.asarray(mesh.vertices()).reshape(-1, 3)[np.array(faces, dtype=int).reshape(-1, 3)]


def _coarse(corners: Array) -> Surface:
    points = corners.reshape(-1, 3)
    low, side = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
    cells = float(MAX_INITIAL_CELLS)
    while True:
        grid = np.floor((points - low) / side * cells).astype(int)
        _, rows = np.unique(grid, axis=0, return_inverse=True)
        faces = rows.reshape(-1, 3)
        not_degenerate = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
        remaining = faces[[row for row in first if not_degenerate[row]]]
        if len(remaining) <= MAX_FACES:
            break
        cells *= COARSENING_FACTOR
    sums = np.zeros((rows.max() + 1, 3))
    np.add.at(sums, rows.ravel(), points)
    return Surface(sums / np.bincount(rows.ravel())[:, None], remaining)
