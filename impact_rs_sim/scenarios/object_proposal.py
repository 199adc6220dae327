# SPDX-License-Identifier: Apache-2.0
"""An object of a scenario from its mesh or its URDF, with all assumptions in words.

A mesh gives the hull, and centre of mass and inertia of an even density; the user gives mass or density. A URDF gives
the shape of its collision geometry (box, sphere, cylinder, or hull of a mesh) and the inertial of all links that are
fixed to each other (Pinocchio, Carpentier et al. 2019). Its inertia I and centre of mass c in axes of the link become
R^T I R and R^T (c - p) in axes of the shape at (R, p).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import coal
import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import is_file
from impact_rs_sim.robots.bodies import is_physically_consistent
from impact_rs_sim.robots.mesh_files import mesh_address, mesh_path
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.object_mesh import (
    MAX_HULL_EXCESS,
    ObjectMesh,
    object_mesh,
    principal_moments,
    read_object_mesh,
    triangles_of,
)
from impact_rs_sim.scenarios.object_spec import ObjectSpec
from impact_rs_sim.schema import validate
from impact_rs_sim.shapes import ConvexShape, Kind

ASSUMED_DENSITY_KG_M3 = 1000.0  # of water; foods, filled bottles and most plastics lie within 30 % of it
EXTENTS_M = (0.005, 2.0)  # plausible largest extents of an object that a pad hits; others indicate a wrong unit
CORNER_DIGITS = 9  # decimals of corners in metres; so fine that the corners of a face stay in one plane


@dataclass(frozen=True)
class ProposedObject:
    """An object for a scenario.

    Attributes:
        name: Its key.
        spec: Its keys (:class:`~impact_rs_sim.scenarios.object_spec.ObjectSpec`).
        origins: Sources of shape, mass and inertia, as text.
    """

    name: str
    spec: Mapping[str, Any]
    origins: tuple[str, ...]


@dataclass(frozen=True)
class _Shape:
    """A shape, with volume [m^3], centre of mass [m] and moments over the mass [m^2] of an even density."""

    kind: Kind
    size: Array
    volume: float
    com: Array
    moments: Array
    middle: Array
    corners: Array | None = None
    origin: str = ""


def propose_object(
    path: Path, mass: float | None = None, density: float | None = None, scale: float | None = None
) -> ProposedObject:
    """The object of a mesh (STL, OBJ, DAE, PLY) or a URDF; its z points up at rest.

    Args:
        path: The file.
        mass: Mass, instead of the mass in the file [kg].
        density: Even density, instead of the mass in the file [kg/m^3].
        scale: Metres per unit of length of a mesh; None: 1.

    Raises:
        InputError: No such file, no body, no closed surface, several bodies, or a unit that cannot be right.
    """
    if not is_file(path):
        raise InputError("no such file", file=path)
    for option, number in (("--mass", mass), ("--density", density), ("--scale", scale)):
        if number is not None and not number > 0.0:
            raise InputError(f"found {number:g}; expected a number > 0", key=option)
    if mass is not None and density is not None:
        raise InputError("a mass and a density: expected one of them", file=path, key="--density")
    inertia, placement = pin.Inertia.Zero(), pin.SE3.Identity()
    if path.suffix == ".urdf":
        if scale is not None:
            raise InputError("a URDF is in metres; its <mesh scale=...> has the unit of a mesh", key="--scale")
        shape, placement, inertia = _of_urdf(path)
    else:
        shape = _of_mesh(read_object_mesh(path, 1.0 if scale is None else scale, convex=False))
    _check_extent(float(np.max(shape.size)), path)
    inertia_in_shape = placement.actInv(inertia) if inertia.mass > 0.0 else inertia
    spec, origins = _mass_properties(shape, inertia_in_shape, mass, density, path)
    spec = {"shape": shape.kind, "size": shape.size.tolist()} | spec
    if not np.allclose(placement.rotation, np.eye(3), atol=1e-9):
        spec["rpy"] = pin.rpy.matrixToRpy(placement.rotation).tolist()
        origins.append("it stands as its link does, z up")
    if shape.corners is not None:
        spec["corners"] = shape.corners.round(CORNER_DIGITS).tolist()
    spec = {"label": path.stem} | spec
    validate(ObjectSpec, spec, path)
    return ProposedObject(re.sub(r"[^A-Za-z0-9_]", "_", path.stem), spec, (shape.origin, *origins))


def _mass_properties(
    shape: _Shape, inertia: pin.Inertia, mass: float | None, density: float | None, path: Path
) -> tuple[dict[str, Any], list[str]]:
    """Mass, centre of mass and inertia of a scenario's object, and their sources; ``inertia`` is that of a URDF."""
    has_inertial = inertia.mass > 0.0
    assumed = not has_inertial and mass is None and density is None
    density = ASSUMED_DENSITY_KG_M3 if assumed else density
    total_mass = mass if mass is not None else density * shape.volume if density is not None else float(inertia.mass)
    by_file = "of the URDF's inertial"
    origin = "given" if mass is not None else by_file if density is None else f"by a density of {density:g} kg/m^3"
    origins = [f"mass {total_mass:.4g} kg {origin}{', which is assumed: weigh it and say --mass' if assumed else ''}"]
    if density is None:
        origins[0] += f" ({total_mass / shape.volume:.0f} kg/m^3)"
    com, moments = shape.com, shape.moments
    if has_inertial and density is None:
        com = np.array(inertia.lever) - shape.middle
        moments = principal_moments(np.array(inertia.inertia) / inertia.mass, path)
        if not is_physically_consistent(1.0, np.diag(moments)):
            expected = "no rigid body has these moments; expected none larger than the sum of the other two [kg m^2]"
            raise InputError(f"{moments * inertia.mass}: {expected}", file=path, key="inertial")
        if np.any(np.abs(com) > 0.5 * shape.size):
            position_text = (
                f"its centre of mass {com.round(4).tolist()} m lies outside of its shape, {shape.size.tolist()} m"
            )
            raise InputError(f"{position_text}: origin of the inertial and of the collision are of one link", file=path)
        origins.append(f"centre of mass and inertia {by_file}{', scaled to the mass' if mass is not None else ''}")
    else:
        origins.append("centre of mass and inertia of an even density, with nothing hollow that the file does not have")
    return {"mass": total_mass, "com_offset": com.tolist(), "inertia": (total_mass * moments).tolist()}, origins


def _check_extent(extent: float, path: Path) -> None:
    """Refuse an implausible extent, and suggest a scale."""
    low, high = EXTENTS_M
    if low <= extent <= high:
        return
    units = {0.001: "millimetres", 0.01: "centimetres", 0.0254: "inches", 1000.0: "kilometres"}
    scale = next((factor for factor in units if low <= extent * factor <= high), None)
    remedy = "" if scale is None else f"; if the file is in {units[scale]}, say --scale {scale:g} (in a URDF scale=...)"
    raise InputError(
        f"its largest extent is {extent:.4g} m; expected {low:g} to {high:g} m, as a pad can push{remedy}", file=path
    )


def _of_mesh(mesh: ObjectMesh) -> _Shape:
    origin = f"convex hull of the mesh, {len(mesh.corners)} corners"
    if mesh.hull_excess > MAX_HULL_EXCESS:
        origin += (
            f", with {mesh.hull_excess:.0%} more volume than the mesh: flat pads and tables touch a body where they "
            "touch its hull, a small or round pad reaches into a hollow that this object does not have"
        )
    return _Shape("hull", mesh.size, mesh.volume, mesh.com, mesh.moments, mesh.middle, mesh.corners, origin)


def _of_urdf(path: Path) -> tuple[_Shape, pin.SE3, pin.Inertia]:
    """Shape and its placement in the first link, and inertia about that link's origin in its axes."""
    try:
        document = Xml.fromstring(path.read_text(encoding="utf-8"))
        for mesh in document.iter("mesh"):
            address = mesh_address(mesh.get("filename", ""), path)
            file = None if address is None else mesh_path(address)
            if file is None:
                raise InputError("no such mesh", file=path, key=mesh.get("filename", ""))
            mesh.set("filename", str(file))
        text = Xml.tostring(document, encoding="unicode")
        model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
        kinds = (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL)
        geometries = [list(pin.buildGeomFromUrdfString(model, text, kind).geometryObjects) for kind in kinds]
    except (OSError, UnicodeDecodeError, ValueError, RuntimeError, Xml.ParseError) as error:
        raise InputError(f"cannot be read as a URDF: {str(error).strip()}", file=path) from None
    if model.njoints > 2:
        raise InputError(f"it has {model.njoints - 2} joints that move; expected one rigid body: fix them", file=path)
    shapes, source = (
        (geometries[0], "collision") if geometries[0] else (geometries[1], "visual (there is no collision)")
    )
    if len(shapes) != 1:
        message = (
            f"{len(shapes)} shapes; expected one convex body: one <collision>, as a box, a cylinder, or a mesh of all"
        )
        raise InputError(message, file=path, key="collision")
    shape = _of_geometry(shapes[0].geometry, source, path)
    return shape, shapes[0].placement, model.inertias[1]


def _of_geometry(geometry: coal.CollisionGeometry, source: str, path: Path) -> _Shape:
    """The shape of a collision geometry of a URDF."""
    if isinstance(geometry, coal.BVHModelBase):
        return _of_mesh(object_mesh(*triangles_of(geometry), path, convex=False))
    kind: Kind
    if isinstance(geometry, coal.Box):
        kind, size = "box", 2.0 * np.array(geometry.halfSide)
    elif isinstance(geometry, coal.Sphere):
        kind, size = "sphere", np.full(3, 2.0 * geometry.radius)
    elif isinstance(geometry, coal.Cylinder):
        kind, size = "cylinder", 2.0 * np.array([geometry.radius, geometry.radius, geometry.halfLength])
    else:
        raise InputError(f"no such shape: {type(geometry).__name__}; expected box, sphere, cylinder or mesh", file=path)
    shares = {"box": 1.0, "sphere": np.pi / 6.0, "cylinder": np.pi / 4.0}  # of the bounding box
    volume = float(shares[kind] * np.prod(size))
    moments = ConvexShape(kind).moments(1.0, size)
    return _Shape(kind, size, volume, np.zeros(3), moments, np.zeros(3), origin=f"{kind} of the URDF's {source}")
