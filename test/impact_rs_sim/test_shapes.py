# SPDX-License-Identifier: Apache-2.0
"""Convex bodies: support functions, moments of inertia, separation along the best normal, and contact points."""

from __future__ import annotations

import hashlib
import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest
import scipy

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map.contacts import ALIGNED, ConvexBody
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.shapes import BOX, CAPSULE, CYLINDER, SPHERE, ConvexShape

CUBE = ConvexShape(
    "hull",
    tuple(itertools.product((-0.1, 0.1), (-0.06, 0.06), (-0.05, 0.05))),  # corners 0 to 7, x outermost
    ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)),
)
ROUND = (SPHERE, CAPSULE, CYLINDER)
PAIRS = [pair for pair in itertools.product((BOX, *ROUND), repeat=2) if pair != (BOX, BOX)]
# Digest of separation, normal, owner, edges and contact points of 2000 pairs of boxes by version 0.2.0, before there
# were other bodies. They take sums, products, quotients and roots only, which every processor rounds alike.
BOXES_OF_0_2_0 = "3c4457f835ca87e26a1681c7fe24476c88e6090a9ac59c81d907eccba8367c1f"


def body(rng: np.random.Generator, shape: ConvexShape) -> ConvexBody:
    """A body of random extents and axes at the origin."""
    half = rng.uniform(0.03, 0.1, 3)
    if shape.kind == "hull":
        half = np.array([0.1, 0.06, 0.05])
    elif shape.kind != "box":
        half[1] = half[0]
        half[2] = {"sphere": half[0], "capsule": half[0] + half[2], "cylinder": half[2]}[shape.kind]
    return ConvexBody(np.zeros(3), pin.exp3(rng.normal(size=3)), half, shape)


def meet(partner: ConvexBody, thing: ConvexBody) -> tuple[float, Array]:
    separation, normal, *_ = _kernel.meet(partner.parts, thing.parts, ALIGNED)
    return separation, normal


def points(partner: ConvexBody, thing: ConvexBody, tolerance: float = 1e-3) -> tuple[Array, Array]:
    """Contact points on ``thing`` and their gaps."""
    _, normal, on_object, edges = _kernel.meet(partner.parts, thing.parts, ALIGNED)
    return _kernel.touching(partner.parts, thing.parts, normal, on_object, edges, tolerance)


def apart(partner: ConvexBody, thing: ConvexBody, normals: Array) -> Array:
    """s(n) of unit normals, ``(k, 3)``, by the support functions in Python."""
    return np.asarray(
        normals @ (thing.centre - partner.centre)
        - partner.shape.support(2.0 * partner.half, normals @ partner.rotation)
        - thing.shape.support(2.0 * thing.half, -normals @ thing.rotation)
    )


def best(partner: ConvexBody, thing: ConvexBody, rng: np.random.Generator) -> float:
    """Largest s by search from many normals, without any knowledge of faces, edges and rims."""
    normals = rng.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    starts = normals[np.argsort(apart(partner, thing, normals))[-5:]]

    def overlap(n: Array) -> float:
        return -float(apart(partner, thing, (n / np.linalg.norm(n))[None])[0])

    found = [scipy.optimize.minimize(overlap, n, method="Nelder-Mead", options={"fatol": 1e-13}) for n in starts]
    return max(-result.fun for result in found)


def brought(partner: ConvexBody, thing: ConvexBody, way: Array, separation: float) -> ConvexBody:
    """``thing`` moved along ``way`` to a separation [m]."""

    def at(distance: float) -> ConvexBody:
        return ConvexBody(distance * way, thing.rotation, thing.half, thing.shape)

    distance = scipy.optimize.brentq(lambda d: meet(partner, at(d))[0] - separation, 0.01, 1.0)
    return at(distance)


def test_two_boxes_touch_bit_for_bit_as_in_version_0_2_0() -> None:
    """Kills a box path that goes through the general routine, whose points differ in their last bits."""
    rng, digest = np.random.default_rng(5), hashlib.sha256()
    for number in range(2000):
        scale = 1.0 if number % 2 else 1e-3  # every second pair is nearly parallel
        turns = [
            scipy.spatial.transform.Rotation.from_quat([*(scale * rng.uniform(-1.0, 1.0, 3)), 1.0]) for _ in range(2)
        ]
        partner, thing = (
            ConvexBody(centre, turn.as_matrix(), rng.uniform(0.03, 0.1, 3))
            for centre, turn in zip((np.zeros(3), rng.uniform(-0.12, 0.12, 3)), turns, strict=True)
        )
        separation, normal, on_object, edges = _kernel.meet(partner.parts, thing.parts, ALIGNED)
        digest.update(np.array([separation, *normal, on_object]).tobytes() + repr(edges).encode())
        positions, gaps = _kernel.touching(partner.parts, thing.parts, normal, on_object, edges, 0.02)
        digest.update(positions.tobytes() + gaps.tobytes())
    assert digest.hexdigest() == BOXES_OF_0_2_0


@pytest.mark.parametrize(("own", "other"), PAIRS, ids=lambda shape: shape.kind)
@pytest.mark.parametrize("separation", [-3e-3, 2e-3])
def test_no_normal_separates_two_bodies_better(own: ConvexShape, other: ConvexShape, separation: float) -> None:
    """Kills a list of normals without rims on edges (misses up to 7 mm), corners on walls, or ends of capsules."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        partner, thing = body(rng, own), body(rng, other)
        way = rng.normal(size=3)
        thing = brought(partner, thing, way / np.linalg.norm(way), separation)
        found, normal = meet(partner, thing)
        assert apart(partner, thing, normal[None])[0] == pytest.approx(found, abs=1e-14)
        two_rims = own.kind == other.kind == "cylinder"  # their common normal is sought along walls only
        assert best(partner, thing, rng) <= found + (1e-4 if two_rims else 1e-9)


def of_coal(shape: ConvexShape, half: Array) -> coal.ShapeBase:
    """The shape in Coal."""
    x, y, z = (2.0 * half).tolist()
    if shape.kind == "sphere":
        return coal.Sphere(x / 2.0)
    if shape.kind == "capsule":
        return coal.Capsule(x / 2.0, z - x)
    return coal.Cylinder(x / 2.0, z) if shape.kind == "cylinder" else coal.Box(x, y, z)


@pytest.mark.parametrize(("own", "other"), PAIRS, ids=lambda shape: shape.kind)
def test_bodies_that_are_apart_are_as_far_from_each_other_as_in_coal(own: ConvexShape, other: ConvexShape) -> None:
    """An iterative search of its own (GJK, to 1e-6 m), which knows no features."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        partner, thing = body(rng, own), body(rng, other)
        way = rng.normal(size=3)
        thing = brought(partner, thing, way / np.linalg.norm(way), 1e-3)
        placed = [coal.Transform3s(one.rotation, one.centre) for one in (partner, thing)]
        shapes = [of_coal(one.shape, one.half) for one in (partner, thing)]
        found = coal.distance(shapes[0], placed[0], shapes[1], placed[1], coal.DistanceRequest(), coal.DistanceResult())
        assert found == pytest.approx(1e-3, abs=2e-5)


@pytest.mark.parametrize("shape", [BOX, *ROUND, CUBE], ids=lambda shape: shape.kind)
def test_the_distance_to_a_point_is_the_largest_over_all_directions(shape: ConvexShape) -> None:
    """Kills: the distance to the bounding box. Points near a face, because of a hull the face planes count."""
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    size = 2.0 * body(rng, shape).half
    support = shape.support(size, directions)
    for point in ([0.3, 0.01, 0.0], [0.01, 0.0, -0.3], 0.35 * size * [1.0, 0.1, 0.2]):
        expected = float(np.max(directions @ point - support))
        assert shape.distance(size, np.asarray(point)) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(("own", "other"), PAIRS, ids=lambda shape: shape.kind)
def test_roles_swap_and_bodies_turn_together_without_effect(own: ConvexShape, other: ConvexShape) -> None:
    rng = np.random.default_rng(4)
    turn = pin.exp3(np.array([0.3, -0.8, 0.5]))
    for _ in range(5):
        partner, thing = body(rng, own), body(rng, other)
        thing = ConvexBody(rng.normal(0.0, 0.08, 3), thing.rotation, thing.half, thing.shape)
        found, normal = meet(partner, thing)
        back, opposite = meet(thing, partner)
        assert back == pytest.approx(found, abs=1e-9)
        np.testing.assert_allclose(opposite, -normal, atol=1e-4)
        turned = [ConvexBody(turn @ one.centre, turn @ one.rotation, one.half, one.shape) for one in (partner, thing)]
        assert meet(*turned)[0] == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize("other", [BOX, *ROUND], ids=lambda shape: shape.kind)
def test_a_hull_of_eight_corners_is_a_box(other: ConvexShape) -> None:
    """Separation and contact points; kills an edge whose arc of normals is crossed on the wrong side."""
    rng = np.random.default_rng(6)
    for _ in range(40):
        thing = body(rng, other)
        way = rng.normal(size=3)
        hull = body(rng, CUBE)
        thing = brought(hull, thing, way / np.linalg.norm(way), rng.choice([-2e-3, 5e-4]))
        box = ConvexBody(hull.centre, hull.rotation, hull.half)
        assert meet(hull, thing)[0] == pytest.approx(meet(box, thing)[0], abs=1e-9)
        found, expected = points(hull, thing), points(box, thing)
        assert len(found[1]) == len(expected[1])
        order, other_order = np.lexsort(found[0].round(6).T), np.lexsort(expected[0].round(6).T)
        np.testing.assert_allclose(found[0][order], expected[0][other_order], atol=1e-7)


def test_a_standing_cylinder_touches_its_table_with_eight_points_of_its_rim_and_a_tilted_one_with_its_lowest() -> None:
    table = ConvexBody(np.array([0.0, 0.0, -0.05]), np.eye(3), np.array([1.0, 1.0, 0.05]))
    half = np.array([0.04, 0.04, 0.1])
    positions, gaps = points(table, ConvexBody(np.array([0.0, 0.0, 0.1]), np.eye(3), half, CYLINDER))
    assert len(gaps) == 8 and gaps == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(np.linalg.norm(positions[:, :2], axis=1), 0.04)
    tilt = 0.2
    for turn in np.linspace(0.0, 2.0 * np.pi, 13):  # in whichever direction
        axis = np.array([np.cos(turn), np.sin(turn), 0.0])
        rotation = pin.exp3(
            tilt * np.cross([0.0, 0.0, 1.0], axis)
        )  # its top goes along `axis`, and so does its low side
        height = 0.1 * np.cos(tilt) + 0.04 * np.sin(tilt)
        positions, gaps = points(table, ConvexBody(np.array([0.0, 0.0, height]), rotation, half, CYLINDER), 1e-6)
        assert gaps == pytest.approx([0.0], abs=1e-12)
        lever = 0.04 * np.cos(tilt) - 0.1 * np.sin(tilt)
        np.testing.assert_allclose(positions[0], [*(lever * axis[:2]), 0.0], atol=1e-12)


@pytest.mark.parametrize("shape", [CYLINDER, CAPSULE])
@pytest.mark.parametrize("tilt", [-0.05, -0.002, 1e-5, 0.002, 0.05])
def test_a_wall_that_runs_over_a_face_is_tilted_against_it_and_touches_along_a_line(
    shape: ConvexShape, tilt: float
) -> None:
    """Ends of the face at gaps +- half its height times the tilt; kills the normal of the wall, which has one point."""
    face = ConvexBody(np.zeros(3), np.eye(3), np.array([0.05, 0.02, 0.05]))
    way = np.array([0.0, 0.06 / (1.0 if shape is CAPSULE else np.cos(tilt)) + 0.02, 0.0])
    wall = ConvexBody(way, pin.utils.rotate("x", tilt), np.array([0.06, 0.06, 0.3]), shape)
    found, gaps = points(face, wall, 0.01)
    np.testing.assert_allclose(sorted(found[:, 2]), [-0.05, 0.05], atol=1e-9)
    np.testing.assert_allclose(gaps, -found[:, 2] * np.tan(tilt), atol=1e-9)
    beside = ConvexBody(way + [0.0, -0.0001, 0.07], pin.utils.rotate("z", np.pi / 2) @ pin.utils.rotate("x", np.pi / 2),
                        np.array([0.06, 0.06, 0.3]), shape)  # fmt: skip
    assert meet(face, beside)[1][2] > 0.05  # along the edge and beyond it: the normal of the wall


def test_a_lying_cylinder_touches_along_a_line_that_ends_with_its_table() -> None:
    table = ConvexBody(np.array([0.0, 0.0, -0.05]), np.eye(3), np.array([0.5, 0.5, 0.05]))
    lying = pin.exp3(np.array([0.0, np.pi / 2.0, 0.0]))  # its axis along x
    thing = ConvexBody(np.array([0.45, 0.1, 0.03]), lying, np.array([0.03, 0.03, 0.1]), CYLINDER)
    positions, gaps = points(table, thing)
    assert gaps == pytest.approx([0.0, 0.0], abs=1e-12)
    np.testing.assert_allclose(np.sort(positions[:, 0]), [0.35, 0.5], atol=1e-12)
    np.testing.assert_allclose(positions[:, 1:], [[0.1, 0.0]] * 2, atol=1e-12)


@pytest.mark.parametrize("shape", ROUND, ids=lambda shape: shape.kind)
def test_moments_of_a_homogeneous_body_are_those_of_its_points(shape: ConvexShape) -> None:
    """By 400,000 points of the bounding box that lie inside; kills a capsule whose ends have no 3 r / 8."""
    rng = np.random.default_rng(7)
    size = {"sphere": np.full(3, 0.1), "capsule": np.array([0.1, 0.1, 0.25])}.get(shape.kind, np.array([0.1, 0.1, 0.3]))
    cloud = rng.uniform(-size / 2.0, size / 2.0, (400_000, 3))
    length = size[2] / 2.0 - (0.0 if shape.kind == "cylinder" else 0.05)
    beyond = 0.0 if shape.kind == "cylinder" else np.maximum(np.abs(cloud[:, 2]) - length, 0.0)
    inside = cloud[np.hypot(np.hypot(cloud[:, 0], cloud[:, 1]), beyond) < 0.05]
    squares = np.mean(np.square(inside), axis=0)
    assert shape.moments(2.0, size) == pytest.approx(2.0 * (squares.sum() - squares), rel=0.01)


def test_a_hull_that_is_none_is_refused() -> None:
    corners = np.array(CUBE.corners)
    faces = [list(face) for face in CUBE.faces]
    for wrong, words in (
        (faces[:-1], "one face only"),
        ([face[::-1] for face in faces], "origin is not inside"),
        ([*faces[:-1], [0, 1]], "three corners"),
        ([*faces[:-1], [0, 1, 9]], "no such corner"),
    ):
        with pytest.raises(ValueError, match=words):
            _kernel.Shape("hull", corners, wrong)
    with pytest.raises(ValueError, match="one or more"):  # its furthest corner would lie beyond them
        _kernel.Shape("hull", corners[:0], [])
    with pytest.raises(ValueError, match="kind"):
        _kernel.Shape("torus")
