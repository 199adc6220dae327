# SPDX-License-Identifier: Apache-2.0
"""An object from a mesh or a URDF: closed forms of volume, centre of mass and inertia, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy

from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.object_proposal import ASSUMED_DENSITY_KG_M3, ProposedObject, propose_object
from impact_rs_sim.scenarios.object_spec import ObjectSpec

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


def outward(points: np.ndarray) -> np.ndarray:
    """Triangles of a hull, seen from outside anticlockwise."""
    hull = scipy.spatial.ConvexHull(points)
    found = []
    for corners, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = points[corners]
        found.append(corners if np.cross(b - a, c - a) @ plane[:3] > 0.0 else corners[::-1])
    return np.array(found)


def stl(path: Path, points: np.ndarray, triangles: np.ndarray) -> Path:
    """An STL file in text."""
    lines = ["solid body"]
    for triangle in triangles:
        corners = [f"vertex {x!r} {y!r} {z!r}" for x, y, z in points[triangle].tolist()]
        lines += ["facet normal 0 0 0", "outer loop", *corners, "endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid body"]), encoding="utf-8")
    return path


def urdf(path: Path, geometry: str, inertial: str = "", origin: str = "", more: str = "") -> Path:
    """A URDF of one body."""
    collision = f"<collision>{origin}<geometry>{geometry}</geometry></collision>"
    path.write_text(f'<robot name="b"><link name="b">{inertial}{collision}</link>{more}</robot>', encoding="utf-8")
    return path


def inertial(mass: float, moments: tuple[float, float, float], com: str = "0 0 0", ixy: float = 0.0) -> str:
    """An inertial of a URDF."""
    x, y, z = moments
    tensor = f'<inertia ixx="{x}" ixy="{ixy}" ixz="0" iyy="{y}" iyz="0" izz="{z}"/>'
    return f'<inertial><origin xyz="{com}"/><mass value="{mass}"/>{tensor}</inertial>'


def spec_of(proposed: ProposedObject) -> ObjectSpec:
    """The object as a scenario reads it."""
    return ObjectSpec.model_validate(proposed.spec)


def test_a_box_in_millimetres_has_the_mass_and_inertia_of_its_density(tmp_path: Path) -> None:
    """Wherever its origin; kills a volume without the cube of the scale."""
    path = stl(tmp_path / "my box.stl", CUBE * [80.0, 120.0, 200.0] + [7.0, -9.0, 30.0], outward(CUBE))
    proposed = propose_object(path, density=700.0, scale=0.001)
    spec, size = spec_of(proposed), np.array([0.08, 0.12, 0.2])
    assert proposed.name == "my_box"
    assert spec.mass == pytest.approx(700.0 * np.prod(size), rel=1e-5)
    np.testing.assert_allclose(spec.size, size, rtol=1e-6)
    np.testing.assert_allclose(spec.com_offset, 0.0, atol=1e-8)
    np.testing.assert_allclose(spec.moments, spec.mass / 12.0 * (np.sum(size**2) - size**2), rtol=1e-5)
    assert len(spec.form.faces) == 6  # corners keep the digits that join the triangles of a face
    assert "density of 700" in proposed.origins[1] and "assumed" not in proposed.origins[1]


def test_a_cone_has_its_centre_of_mass_and_inertia(tmp_path: Path) -> None:
    """V = pi r^2 h / 3, a quarter of h above its base, 3/10 m r^2 and 3/20 m r^2 + 3/80 m h^2, for many sides."""
    sides, r, h = 180, 0.05, 0.16
    angle = 2.0 * np.pi * np.arange(sides) / sides
    points = np.vstack((np.column_stack((r * np.cos(angle), r * np.sin(angle), 0.0 * angle)), [[0.0, 0.0, h]]))
    spec = spec_of(propose_object(stl(tmp_path / "cone.stl", points, outward(points)), mass=0.3))
    assumed = spec_of(propose_object(tmp_path / "cone.stl"))
    assert assumed.mass == pytest.approx(ASSUMED_DENSITY_KG_M3 * np.pi * r**2 * h / 3.0, rel=1e-3)
    np.testing.assert_allclose(spec.com_offset, [0.0, 0.0, h / 4.0 - h / 2.0], atol=1e-6)
    across = 0.3 * (0.15 * r**2 + 3.0 / 80.0 * h**2)
    np.testing.assert_allclose(spec.moments, [across, across, 0.3 * 0.3 * r**2], rtol=2e-3)


def test_a_hollow_mesh_keeps_its_own_mass_below_its_hull(tmp_path: Path) -> None:
    """An L of two cubes and a corner: hull 7/6 of it in volume; the L gives mass and centre."""
    square = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]) * 0.05
    points = np.vstack([np.column_stack((square, np.full(6, z))) for z in (0.0, 0.1)])
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    wall = [[i, (i + 1) % 6, (i + 1) % 6 + 6] for i in range(6)] + [[i, (i + 1) % 6 + 6, i + 6] for i in range(6)]
    triangles = np.vstack((cap[:, ::-1], cap + 6, wall))
    turn = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]]) / np.sqrt(2.0)
    proposed = propose_object(stl(tmp_path / "angle.stl", points @ turn, triangles), density=1000.0)
    assert proposed.spec["mass"] == pytest.approx(1000.0 * 3.0 * 0.05**2 * 0.1, rel=1e-5)
    assert "with 17% more volume than the mesh" in proposed.origins[0]


def test_shapes_and_inertial_of_a_urdf(tmp_path: Path) -> None:
    """A cylinder lies along y of its link, 3 cm off; its moments turn into its axes, its centre of mass follows."""
    lying = '<origin xyz="0.03 0 0" rpy="1.5707963267948966 0 0"/>'
    path = urdf(
        tmp_path / "can.urdf",
        '<cylinder radius="0.04" length="0.2"/>',
        inertial(0.8, (0.004, 0.001, 0.0038), "0.03 0.01 0"),
        lying,
    )
    spec = spec_of(propose_object(path))
    assert (spec.shape, spec.mass) == ("cylinder", 0.8)
    np.testing.assert_allclose(spec.size, [0.08, 0.08, 0.2])
    np.testing.assert_allclose(spec.moments, [0.004, 0.0038, 0.001], rtol=1e-6)
    np.testing.assert_allclose(spec.com_offset, [0.0, 0.0, -0.01], atol=1e-9)  # z of the cylinder is -y of the link
    np.testing.assert_allclose(spec.rotation @ spec.com_offset, [0.0, 0.01, 0.0], atol=1e-9)
    heavier = spec_of(propose_object(path, mass=1.6))
    np.testing.assert_allclose(heavier.moments, 2.0 * spec.moments, rtol=1e-6)
    ball = propose_object(urdf(tmp_path / "ball.urdf", '<sphere radius="0.03"/>'))
    assert spec_of(ball).moments[0] == pytest.approx(0.4 * ball.spec["mass"] * 0.03**2)
    assert ball.spec["mass"] == pytest.approx(1000.0 * 4.0 / 3.0 * np.pi * 0.03**3) and "assumed" in ball.origins[1]


def test_a_fixed_joint_adds_its_link(tmp_path: Path) -> None:
    """A lid of 0.1 kg at 10 cm on a body of 0.3 kg at 0: the common centre is at 2.5 cm."""
    lid = f'<link name="lid">{inertial(0.1, (1e-4, 1e-4, 1e-4))}</link>'
    joint = '<joint name="j" type="{}"><parent link="b"/><child link="lid"/><origin xyz="0 0 0.1"/>{}</joint>'
    box = '<box size="0.1 0.1 0.3"/>', inertial(0.3, (1e-3, 1e-3, 1e-3))
    spec = spec_of(propose_object(urdf(tmp_path / "jar.urdf", *box, more=lid + joint.format("fixed", ""))))
    assert spec.mass == pytest.approx(0.4)
    np.testing.assert_allclose(spec.com_offset, [0.0, 0.0, 0.025], atol=1e-12)
    np.testing.assert_allclose(spec.moments[0], 1.1e-3 + 0.3 * 0.1 / 0.4 * 0.1**2, rtol=1e-9)
    hinged = urdf(tmp_path / "hinged.urdf", *box, more=lid + joint.format("continuous", '<axis xyz="0 0 1"/>'))
    with pytest.raises(InputError, match="1 joints that move"):
        propose_object(hinged)


def test_a_mesh_of_a_urdf_is_read_with_its_scale(tmp_path: Path) -> None:
    stl(tmp_path / "part.stl", CUBE * [80.0, 60.0, 200.0], outward(CUBE))
    mesh = '<mesh filename="part.stl" scale="0.001 0.001 0.001"/>'
    path = urdf(tmp_path / "part.urdf", mesh, inertial(1.0, (0.004, 0.004, 0.001), "0.04 0.03 0.08"))
    spec = spec_of(propose_object(path))
    np.testing.assert_allclose(spec.size, [0.08, 0.06, 0.2], rtol=1e-6)
    np.testing.assert_allclose(spec.com_offset, [0.0, 0.0, -0.02], atol=1e-8)
    with pytest.raises(InputError, match="no such mesh"):
        propose_object(urdf(tmp_path / "gone.urdf", '<mesh filename="gone.stl"/>'))


def test_files_that_are_no_object_are_refused_with_a_remedy(tmp_path: Path) -> None:
    triangles = outward(CUBE)
    in_millimetres = stl(tmp_path / "bottle.stl", CUBE * [70.0, 70.0, 200.0], triangles)
    with pytest.raises(InputError, match=r"extent is 200 m; .*if the file is in millimetres, say --scale 0.001"):
        propose_object(in_millimetres)
    for left_out in range(12):  # one triangle of a cube, wherever the origin
        opened = stl(tmp_path / "open.stl", CUBE * 0.1 + 3.0, np.delete(triangles, left_out, axis=0))
        with pytest.raises(InputError, match=r"does not close around a volume: .*close its holes"):
            propose_object(opened)
    flat = stl(tmp_path / "flat.stl", CUBE * [0.1, 0.1, 0.0], triangles)
    with pytest.raises(InputError, match="it is flat or empty; .*export the solid"):
        propose_object(flat)
    box = '<box size="0.1 0.1 0.1"/>'
    wrong = {
        "no rigid body has these moments": inertial(1.0, (0.001, 0.001, 0.01)),
        "axes of inertia are turned": inertial(1.0, (0.001, 0.001, 0.001), ixy=0.0005),
        "lies outside of its shape": inertial(1.0, (0.001, 0.001, 0.001), "0 0 30"),
    }
    for said, own in wrong.items():
        with pytest.raises(InputError, match=said):
            propose_object(urdf(tmp_path / "wrong.urdf", box, own))
    for numbers in ({"mass": 0.0}, {"density": -1.0}, {"scale": float("nan")}):
        with pytest.raises(InputError, match="expected a number > 0"):
            propose_object(in_millimetres, **numbers)
    with pytest.raises(InputError, match="inertia"):
        propose_object(urdf(tmp_path / "point.urdf", box, inertial(1.0, (0.0, 0.0, 0.0))))
    with pytest.raises(InputError, match="expected one of them"):
        propose_object(in_millimetres, mass=1.0, density=1.0)
    with pytest.raises(InputError, match="URDF is in metres"):
        propose_object(urdf(tmp_path / "box.urdf", box), scale=0.001)
    with pytest.raises(InputError, match="2 shapes; expected one convex body"):
        propose_object(urdf(tmp_path / "two.urdf", box, origin=f"<geometry>{box}</geometry></collision><collision>"))
    with pytest.raises(InputError, match="cannot be read as a URDF"):
        propose_object(stl(tmp_path / "text.urdf", CUBE, triangles))
