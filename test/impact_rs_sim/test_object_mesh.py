# SPDX-License-Identifier: Apache-2.0
"""Objects from meshes: hull, centre of mass and inertia, and the impacts of the shape that the mesh stands for."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
import scipy
import yaml

from impact_rs_analysis.report.scene_3d import scene_data
from impact_rs_sim.descriptions import mjcf
from impact_rs_sim.descriptions.exported_scene import ExportedScene
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.model import load_model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.object_mesh import MAX_CORNERS, object_mesh, read_object_mesh
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.shapes import hull_of

PUSH = config_directory() / "scenarios" / "push.yaml"
BOX = np.array([0.24, 0.16, 0.16])  # m, of cat_food
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


def triangles_of(points: Array) -> Array:
    """Triangles of the hull of points, seen from outside anticlockwise."""
    hull = scipy.spatial.ConvexHull(points)
    found = hull.simplices.copy()
    a, b, c = (points[found[:, side]] for side in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    found[inward] = found[inward][:, ::-1]
    return found


def written(path: Path, points: Array, triangles: Array) -> Path:
    """An OBJ file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()] + [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def scenario_with(folder: Path, points: Array, **spec: object) -> Scenario:
    """``push`` with one object from a mesh."""
    written(folder / "thing.obj", points, triangles_of(points))
    data = yaml.safe_load(PUSH.read_text(encoding="utf-8"))
    data["objects"] = {"thing": {"label": "Thing", "mass": 1.3, "mesh": "thing.obj"} | spec}
    (folder / "mine.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    return load_scenario(str(folder / "mine.yaml"))


def egg(count: int = 100) -> Array:
    """Corners of an ellipsoid with semi-axes 8, 6, 8 cm."""
    rng = np.random.default_rng(2)
    points = rng.normal(size=(count, 3))
    points = np.vstack((points, -points)) / np.linalg.norm(np.vstack((points, -points)), axis=1)[:, None]
    return np.asarray(points * [0.08, 0.06, 0.08])


def test_a_box_as_a_mesh_is_the_box(tmp_path: Path) -> None:
    """Centre of mass, inertia and impact; kills moments about the corner of the mesh, and a face for each triangle."""
    scenario = scenario_with(tmp_path, CUBE * BOX + [3.0, -1.0, 0.5])
    thing, box = scenario.object("thing"), load_scenario("push").object("cat_food")
    np.testing.assert_allclose(thing.size, box.size, atol=1e-6)
    np.testing.assert_allclose(thing.moments, box.moments, rtol=1e-5)
    np.testing.assert_allclose(thing.com_offset, 0.0, atol=1e-6)
    assert len(thing.form.faces) == 6  # two triangles are one face
    found, expected = (
        compute_impact_map(ImpactProblem.at_nominal_impact(Scene.resolve(one, name, "case_1")))
        for one, name in ((scenario, "thing"), (load_scenario("push"), "cat_food"))
    )
    assert len(found.contacts) == len(expected.contacts) == 8
    np.testing.assert_allclose(found.object_twist, expected.object_twist, atol=1e-6)
    np.testing.assert_allclose(found.joint_velocity["arm"], expected.joint_velocity["arm"], atol=1e-6)


def test_moments_of_a_mesh_grow_with_a_mass_that_is_set_later(tmp_path: Path) -> None:
    """Kills an inertia that is fixed with the mass of the file."""
    scenario = scenario_with(tmp_path, CUBE * BOX)
    heavier = scenario.with_settings({"objects.thing.mass": 2.6}).object("thing")
    np.testing.assert_allclose(heavier.moments, 2.0 * scenario.object("thing").moments)


def test_a_recorded_scenario_holds_its_mesh(tmp_path: Path) -> None:
    scenario = scenario_with(tmp_path, egg())
    again = Scenario.model_validate(json.loads(scenario.model_dump_json()))
    assert again.object("thing") == scenario.object("thing") and again.digest == scenario.digest
    shown = scene_data(Scene.resolve(scenario, "thing", "case_1").physics)["object_shape"]
    assert shown["kind"] == "mesh"


def test_given_mass_properties_stand_in_the_place_of_those_of_the_mesh(tmp_path: Path) -> None:
    thing = scenario_with(tmp_path, CUBE * BOX, inertia=[0.004, 0.005, 0.006], com_offset=[0.0, 0.01, 0.0]).object(
        "thing"
    )
    assert thing.moments.tolist() == [0.004, 0.005, 0.006] and thing.com_offset == (0.0, 0.01, 0.0)


def test_inertia_of_a_pyramid_has_the_closed_form(tmp_path: Path) -> None:
    """A square pyramid: m (s^2 / 20 + 3 h^2 / 80) across its axis and m s^2 / 10 about it."""
    base, height = 0.1, 0.2
    points = np.array([[x, y, 0.0] for x in (-base, base) for y in (-base, base)] + [[0.0, 0.0, height]])
    mesh = object_mesh(points, triangles_of(points), tmp_path)
    np.testing.assert_allclose(mesh.com, [0.0, 0.0, height / 4.0 - height / 2.0], atol=1e-12)
    side = 2.0 * base
    across = side**2 / 20.0 + 3.0 * height**2 / 80.0
    np.testing.assert_allclose(mesh.moments, [across, across, side**2 / 10.0], rtol=1e-9)


def test_a_fine_mesh_keeps_200_corners_and_its_extents(tmp_path: Path) -> None:
    points = egg(3000)
    mesh = object_mesh(points, triangles_of(points), tmp_path)
    assert len(mesh.corners) <= MAX_CORNERS
    np.testing.assert_allclose(mesh.size, 2.0 * np.abs(points).max(axis=0), rtol=1e-6)
    lost = max(float((points @ n).max() - (mesh.corners @ n).max()) for n in np.eye(3)[[0, 1, 2]])
    assert lost < 1e-12
    assert len(hull_of(tuple(map(tuple, mesh.corners.tolist()))).corners) == len(mesh.corners)


def test_a_mesh_that_is_no_convex_body_is_refused_with_a_sentence(tmp_path: Path) -> None:
    points = np.vstack((CUBE, CUBE + [3.0, 0.0, 0.0])) * 0.1  # two cubes
    both = np.vstack((triangles_of(CUBE), triangles_of(CUBE) + 8))
    with pytest.raises(InputError, match="not convex: its hull has 100% more volume"):
        object_mesh(points, both, tmp_path / "two.obj")
    with pytest.raises(InputError, match="does not close"):
        object_mesh(CUBE, triangles_of(CUBE)[:, ::-1], tmp_path / "inside_out.obj")
    turned = CUBE * [0.3, 0.1, 0.1] @ np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(InputError, match="principal axes of inertia are turned by about 37 degrees"):
        object_mesh(turned, triangles_of(turned), tmp_path / "turned.obj")
    sheet = CUBE[:, [0, 1, 0]]  # tilted, so that all its extents are positive
    with pytest.raises(InputError, match="a body with a volume"):
        object_mesh(sheet, triangles_of(CUBE), tmp_path / "sheet.obj")
    with pytest.raises(InputError, match="no such file"):
        read_object_mesh(tmp_path / "none.stl")
    with pytest.raises(InputError, match="objects.thing.size"):
        scenario_with(tmp_path, CUBE, size=[1.0, 1.0, 1.0])
    push = load_scenario("push")
    with pytest.raises(InputError, match="corners belong to shape: hull"):
        push.with_settings({"objects.parcel.shape": "hull"})
    for shape, told in (((0.0, 0.0, 0.0),) * 4, "four points or more"), (tuple(map(tuple, CUBE + 1.0)), "origin"):
        with pytest.raises(ValueError, match=told):
            hull_of(shape)


def test_mujoco_reads_a_mesh_and_a_ball_of_a_scenario(tmp_path: Path) -> None:
    """Extents of the geom are those of the object; kills a radius that is a diameter."""
    for scenario, name in ((scenario_with(tmp_path, CUBE * BOX), "thing"), (load_scenario("hit_ball"), "solid")):
        scene = Scene.resolve(scenario, name, "case_1")
        exported = ExportedScene.of(scene, load_model("nominal"))
        model = mujoco.MjModel.from_xml_string(mjcf.write(exported)[0])
        half = np.array(scenario.object(name).size) / 2.0
        if name == "thing":
            extents = np.sort(np.ptp(model.mesh_vert, axis=0))  # MuJoCo turns it to its principal axes
            assert extents == pytest.approx(np.sort(2.0 * half), rel=1e-5)
        else:
            assert model.geom("object").size[0] == pytest.approx(half[0])
