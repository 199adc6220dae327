# SPDX-License-Identifier: Apache-2.0
"""Meshes of a robot keep their shape on the way into a page, and what is no mesh is left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import PHYSICS

from impact_rs_analysis.report.scene_3d import scene_data
from impact_rs_analysis.report.surface import MAX_FACES, surface_of
from impact_rs_sim.robots.robot import Mesh

DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="millimeter" meter="0.001"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">0 0 0 100 0 0 0 100 0</float_array>
<technique_common><accessor source="#pa" count="3" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes>
<visual_scene id="s"><node id="n"><matrix>1 0 0 10 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""


def ball(rings: int, radius: float = 0.1) -> np.ndarray:
    """Triangles of a ball, ``(f, 3, 3)``."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings), indexing="ij")
    points = radius * np.stack((np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.concatenate((np.stack((a, b, c), axis=2), np.stack((a, c, d), axis=2))).reshape(-1, 3, 3)


def write_stl(path: Path, corners: np.ndarray) -> Path:
    rows = np.zeros(len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    rows["corners"] = corners
    path.write_bytes(b"solid by chance".ljust(80) + len(corners).to_bytes(4, "little") + rows.tobytes())
    return path


def test_a_fine_mesh_becomes_coarse_and_stays_a_ball(tmp_path: Path) -> None:
    found = surface_of(write_stl(tmp_path / "ball.stl", ball(120)).as_uri())
    assert found is not None
    assert MAX_FACES / 3 < len(found.faces) <= MAX_FACES
    assert np.linalg.norm(found.vertices, axis=1) == pytest.approx(0.1, abs=0.008)
    assert set(np.unique(found.faces)) <= set(range(len(found.vertices)))
    a, b, c = (found.vertices[found.faces[:, corner]] for corner in range(3))
    volume = np.sum(np.einsum("ij,ij->i", a, np.cross(b, c))) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.1**3, rel=0.1)  # every triangle looks outward as before


def test_a_mesh_in_text_is_read_as_one_in_numbers(tmp_path: Path) -> None:
    corners = ball(4)
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in facet)
        + "endloop\nendfacet\n"
        for facet in corners
    )
    (tmp_path / "text.stl").write_text(f"solid ball\n{facets}endsolid ball\n")
    text = surface_of((tmp_path / "text.stl").as_uri())
    binary = surface_of(write_stl(tmp_path / "binary.stl", corners).as_uri())
    assert text is not None
    assert binary is not None
    assert text.vertices == pytest.approx(binary.vertices, abs=1e-7)
    assert np.array_equal(text.faces, binary.faces)


def test_obj_and_dae_files_are_read_in_their_own_units(tmp_path: Path) -> None:
    """A DAE file in millimetres, with a node that is moved by 10 mm, as viewers of ROS 2 show it."""
    (tmp_path / "two.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 4\nf 1 2 5\n")
    found = surface_of((tmp_path / "two.obj").as_uri())
    assert found is not None
    assert len(found.faces) == 3  # the square is two triangles
    assert np.ptp(found.vertices, axis=0).tolist() == [1.0, 1.0, 1.0]
    (tmp_path / "one.dae").write_text(DAE)
    moved = surface_of((tmp_path / "one.dae").as_uri())
    assert moved is not None
    assert np.sort(moved.vertices, axis=0) == pytest.approx(np.array([[0.01, 0, 0], [0.01, 0, 0], [0.11, 0.1, 0]]))
    (tmp_path / "bad.dae").write_text(DAE[:300])
    assert surface_of((tmp_path / "bad.dae").as_uri()) is None


@pytest.mark.parametrize("content", [b"", b"<COLLADA/>", b"solid x\nvertex 1 2\n", b"solid x\nvertex 1 2 nan\n" * 3])
def test_what_is_no_mesh_is_none(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "file.stl").write_bytes(content)
    assert surface_of((tmp_path / "file.stl").as_uri()) is None


def test_a_mesh_of_a_package_is_found_where_ros_installs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "share" / "arm_description" / "meshes"
    folder.mkdir(parents=True)
    write_stl(folder / "link.stl", ball(4))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'other'}:{tmp_path}")
    assert surface_of("package://arm_description/meshes/link.stl") is not None
    assert surface_of("package://arm_description/meshes/nothing.stl") is None


def test_a_link_shows_its_mesh_and_one_whose_mesh_is_away_its_simple_shape(tmp_path: Path) -> None:
    arm = PHYSICS.arms["left"]
    here = Mesh(file=write_stl(tmp_path / "here.stl", ball(4)).as_uri(), xyz=(0.0, 0.0, 0.1), scale=(2.0, 2.0, 2.0))
    away = Mesh(file=(tmp_path / "away.dae").as_uri())
    links = list(arm.facts.links)
    links[0] = links[0].model_copy(update={"meshes": (here,)})
    links[1] = links[1].model_copy(update={"meshes": (here, away)})
    facts = arm.facts.model_copy(update={"links": tuple(links)})
    scene = scene_data(replace(PHYSICS, arms=PHYSICS.arms | {"left": replace(arm, facts=facts)}))
    (shown,) = scene["links"]["left_link1"]
    assert (shown["kind"], shown["position"]) == ("mesh", [0.0, 0.0, 0.1])
    assert scene["links"]["left_link2"] == scene_data(PHYSICS)["links"]["left_link2"]
    assert "cylinder" in {shape["kind"] for shape in scene["links"]["left_link2"]}
