# SPDX-License-Identifier: Apache-2.0
"""Contact points of pad, object and support; the compiled search finds those of a plain one, in the same order."""

from __future__ import annotations

from dataclasses import replace

import clipping
import numpy as np
import pinocchio as pin
import pytest
from impact_map_cases import ENGINES, LEAN, MODEL, crossed, nominal, one_point

from impact_rs_sim import _kernel
from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map import ImpactProblem, check_problem, compute_impact_map
from impact_rs_sim.impact_map.contacts import (
    ALIGNED,
    ContactPair,
    ContactPoint,
    ConvexBody,
    contact_frame,
    contact_pairs,
    find_contacts,
)
from impact_rs_sim.scene import BodyState

# ---- points of a scene ----------------------------------------------------------------------------------------------


def contacts_of(problem: ImpactProblem, partner: str) -> list[ContactPoint]:
    placements = {"arm": MODEL.placement(problem.arms["arm"].position)}
    found = contact_pairs(problem.physics, problem.object, placements)
    return [c for c in find_contacts(problem.physics, found) if c.partner == partner]


def moved(problem: ImpactProblem, shift: tuple[float, float, float], yaw: float = 0.0) -> ImpactProblem:
    body = problem.object
    rotation = pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ body.rotation
    return replace(problem, object=BodyState(body.position + np.array(shift), rotation, body.twist))


def test_flat_pad_touches_with_its_four_corners() -> None:
    points = contacts_of(nominal(), "arm")
    assert len(points) == 4
    np.testing.assert_allclose(np.mean([p.position for p in points], axis=0), [0.428, -0.061, 0.485], atol=1e-9)
    for point in points:
        np.testing.assert_allclose(point.normal, [0.0, -1.0, 0.0], atol=1e-9)
        assert point.gap == pytest.approx(0.0, abs=1e-9)


def test_object_stands_on_its_four_lower_corners() -> None:
    points = contacts_of(nominal(), "support")
    corners = np.array([[sx * 0.12, sy * 0.08] for sx in (-1, 1) for sy in (-1, 1)]) + [0.428, -0.141]
    found = np.array([p.position[:2] for p in points])
    assert sorted(map(tuple, np.round(found, 9))) == sorted(map(tuple, np.round(corners, 9)))


def test_contact_ends_where_the_object_does() -> None:
    points = contacts_of(moved(nominal(), (0.1, 0.0, 0.0)), "arm")
    # The face spans x = 0.408 .. 0.648 m, the pad 0.378 .. 0.478 m
    xs = [p.position[0] for p in points]
    assert min(xs) == pytest.approx(0.408) and max(xs) == pytest.approx(0.478)


def test_one_degree_of_yaw_leaves_an_edge() -> None:
    turn = np.radians(1.0)
    body = nominal().object.position
    reach = 0.05 * np.sin(turn) + 0.08 * (np.cos(turn) - 1.0)
    points = contacts_of(moved(nominal(), (0.0, -reach, 0.0), turn), "arm")
    assert len(points) == 2
    assert points[0].position[0] == pytest.approx(points[1].position[0], abs=1e-6)
    assert body[0] - 0.06 < points[0].position[0] < body[0] + 0.06


def test_tilt_about_two_axes_leaves_a_corner() -> None:
    problem = one_point()
    assert len(contacts_of(problem, "arm")) == 1


@pytest.mark.parametrize(("gap", "count"), [(0.0005, 4), (0.002, 0), (-0.0005, 4)])
def test_a_small_gap_counts_as_touching(gap: float, count: int) -> None:
    points = contacts_of(moved(nominal(), (0.0, -gap, 0.0)), "arm")
    assert len(points) == count
    for point in points:
        assert point.gap == pytest.approx(gap, abs=1e-9)


def test_contact_frame_is_right_handed_with_the_normal_last() -> None:
    for normal in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]):
        frame = contact_frame(np.array(normal))
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(frame[2], normal)


@pytest.mark.parametrize("gap", [0.0005, 0.0, -0.0005])
def test_each_point_lies_on_its_own_body_and_the_gap_between_them(gap: float) -> None:
    """The pad's face is the plane y = -0.061 m, and its normal goes into the object."""
    for point in contacts_of(moved(nominal(), (0.0, -gap, 0.0)), "arm"):
        assert point.partner_position[1] == pytest.approx(-0.061, abs=1e-9)
        assert point.position[1] == pytest.approx(-0.061 - gap, abs=1e-9)


def test_each_pair_has_its_own_friction() -> None:
    problem = nominal(pad_friction=0.7, support_friction=0.2)
    assert {point.friction for point in contacts_of(problem, "arm")} == {0.7}
    assert {point.friction for point in contacts_of(problem, "support")} == {0.2}


@pytest.mark.parametrize(("gap", "count"), [(0.02, 0), (0.0005, 1), (0.0, 1), (-0.0005, 1)])
def test_edges_that_cross_touch_in_one_point_along_their_common_normal(gap: float, count: int) -> None:
    problem = crossed(gap)
    (pair,) = check_problem(problem)  # 20 mm of air are no overlap
    assert pair.separation == pytest.approx(gap, abs=1e-12)
    points = compute_impact_map(problem).contacts
    assert len(points) == len(contacts_of(problem, "arm")) == count
    for point in points:
        pad = MODEL.placement(problem.arms["arm"].position) * problem.physics.arms["arm"].end_effector.pad_placement
        np.testing.assert_allclose(pad.rotation.T @ point.normal, [0.0, np.sin(LEAN), np.cos(LEAN)], atol=1e-12)
        assert point.gap == pytest.approx(gap, abs=1e-12)


def test_edges_that_overlap_are_refused_by_what_they_overlap() -> None:
    with pytest.raises(Infeasible, match="penetrates 'arm' by 3 mm"):
        check_problem(crossed(-0.003))


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_bullet_hits_an_edge_with_an_edge_as_the_exact_engine_does(restitution: float) -> None:
    problem = replace(crossed(0.0, pad_friction=0.4), restitution=restitution)
    exact, bullet = (compute_impact_map(problem, engine) for engine in ENGINES[::-1])
    (point,), (other,) = exact.contacts, bullet.contacts
    np.testing.assert_allclose(other.position, point.position, atol=1e-5)
    np.testing.assert_allclose(other.normal, point.normal, atol=1e-6)
    assert np.linalg.norm(point.impulse) > 0.1  # N s
    np.testing.assert_allclose(bullet.object_twist, exact.object_twist, atol=2e-3)


# ---- the compiled search against a plain one ------------------------------------------------------------------------


def crossing_boxes(rng: np.random.Generator) -> tuple[ConvexBody, ConvexBody]:
    """Two boxes in any orientation, some millimetres apart or into each other along the line of their centres."""
    partner, thing = (
        ConvexBody(np.zeros(3), pin.exp3(rng.normal(size=3)), rng.uniform(0.03, 0.1, 3)) for _ in range(2)
    )
    way = rng.normal(size=3)
    low, high = 0.0, 1.0
    for _ in range(24):
        middle = 0.5 * (low + high)
        apart = clipping.meet(partner, ConvexBody(middle * way, thing.rotation, thing.half))[0] > 0.0
        low, high = (low, middle) if apart else (middle, high)
    centre = high * way + rng.normal(0.0, 2e-3) * way / np.linalg.norm(way)
    return partner, ConvexBody(centre, thing.rotation, thing.half)


def placed(rng: np.random.Generator, tilt: float) -> tuple[ConvexBody, ConvexBody]:
    """Two boxes face to face up to a tilt [rad], a few millimetres apart or into each other."""
    partner, thing = (rng.uniform(0.02, 0.2, 3) for _ in range(2))
    turn = pin.exp3(rng.standard_normal(3))
    quarter = pin.exp3(rng.integers(0, 4) * np.pi / 2.0 * np.eye(3)[rng.integers(3)])
    rotation = turn @ quarter @ pin.exp3(tilt * rng.standard_normal(3))
    axis = turn[:, rng.integers(3)]
    reach = np.abs(turn.T @ axis) @ partner + np.abs(rotation.T @ axis) @ thing
    aside = 0.05 * rng.standard_normal(3)
    aside -= axis * (axis @ aside)
    centre = rng.standard_normal(3)
    away = rng.choice([-1.0, 1.0]) * (reach + rng.normal(0.0, 2e-3)) * axis
    return ConvexBody(centre, turn, partner), ConvexBody(centre + away + aside, rotation, thing)


@pytest.mark.parametrize("tilt", [0.0, 1e-6, 0.004, 0.5])
def test_compiled_and_plain_search_find_the_same_points_in_the_same_order(tilt: float) -> None:
    rng = np.random.default_rng(3)
    touching = crossing = 0
    for number in range(120):
        partner, thing = crossing_boxes(rng) if tilt == 0.5 and number % 2 else placed(rng, tilt)
        separation, normal, on_object, edges = _kernel.meet(partner.parts, thing.parts, ALIGNED)
        expected = clipping.meet(partner, thing)
        assert separation == pytest.approx(expected[0], abs=1e-14)
        np.testing.assert_allclose(normal, expected[1], atol=1e-14)
        assert (on_object, edges) == expected[2:]
        crossing += edges is not None
        plain = clipping.touching(ContactPair("arm", partner, thing, *expected), 3e-3)
        positions, gaps = _kernel.touching(partner.parts, thing.parts, normal, on_object, edges, 3e-3)
        assert len(positions) == len(gaps) == len(plain)
        touching += bool(len(plain))
        for position, gap, (its_position, its_gap) in zip(positions, gaps, plain, strict=True):
            np.testing.assert_allclose(position, its_position, atol=1e-13)
            assert gap == pytest.approx(its_gap, abs=1e-13)
    assert touching > 20
    assert crossing > 20 if tilt == 0.5 else True


def test_edges_that_pass_each_other_beyond_an_end_separate_nothing() -> None:
    """Boxes some way apart, where such edges are many; kills a search that looks at one of the two ends alone."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        partner, thing = (
            ConvexBody(rng.normal(0.0, 0.15, 3), pin.exp3(rng.normal(size=3)), rng.uniform(0.03, 0.1, 3))
            for _ in range(2)
        )
        found, expected = _kernel.meet(partner.parts, thing.parts, ALIGNED), clipping.meet(partner, thing)
        assert found[0] == pytest.approx(expected[0], abs=1e-14)
        np.testing.assert_allclose(found[1], expected[1], atol=1e-14)
        assert found[2:] == expected[2:]


def test_edges_that_cross_separate_boxes_that_no_face_does() -> None:
    # One cube of 0.1 m stands on an edge along y, another one on an edge along x below it.
    lower = ConvexBody(np.zeros(3), pin.utils.rotate("x", np.pi / 4.0), np.full(3, 0.05))
    for gap, count in ((0.02, 0), (0.0005, 1), (0.0, 1), (-0.0005, 1)):
        centre = np.array([0.0, 0.0, 0.1 * np.sqrt(2.0) + gap])
        upper = ConvexBody(centre, pin.utils.rotate("y", np.pi / 4.0), np.full(3, 0.05))
        separation, normal, on_object, edges = _kernel.meet(lower.parts, upper.parts, ALIGNED)
        assert (separation, edges) == (pytest.approx(gap, abs=1e-15), (0, 1))
        np.testing.assert_allclose(normal, [0.0, 0.0, 1.0], atol=1e-15)
        positions, gaps = _kernel.touching(lower.parts, upper.parts, normal, on_object, edges, 1e-3)
        assert gaps == pytest.approx([gap] * count, abs=1e-15)
        assert len(positions) == count
        for position in positions:
            np.testing.assert_allclose(position, [0.0, 0.0, 0.05 * np.sqrt(2.0) + gap], atol=1e-15)


def test_a_box_that_juts_out_beyond_a_tilted_pad_does_not_overlap_it() -> None:
    # The lower edge of the pad along x passes the upper one of the box along y at 1 mm. Either goes on beyond the other
    # body, below whose face it lies: the directions of faces have them overlap by 2 mm and more.
    tilt = np.radians(3.0)
    pad = ConvexBody(np.zeros(3), pin.utils.rotate("x", tilt), np.array([0.05, 0.05, 0.01]))
    box = ConvexBody(np.zeros(3), pin.utils.rotate("y", tilt), np.array([0.05, 0.15, 0.02]))
    down, up = (np.abs(one.rotation[2]) @ one.half for one in (pad, box))
    box = replace(box, centre=np.array([0.07, 0.0, -down - up - 1e-3]))
    assert clipping.separating_face(pad, box)[0] < -0.002
    separation, normal, *_, edges = _kernel.meet(pad.parts, box.parts, ALIGNED)
    assert separation == pytest.approx(1e-3, abs=1e-15)
    assert edges is None  # a corner of the faces, clipped to each other
    _, gaps = _kernel.touching(pad.parts, box.parts, normal, False, None, 2e-3)
    assert min(gaps) == pytest.approx(1e-3, rel=2.0 * (1.0 - np.cos(tilt)))


def test_boxes_that_are_nearly_parallel_touch_in_a_few_points_within_their_faces() -> None:
    # Corners on edges of the other face, up to rounding: clipping keeps or cuts them, and may bend the polygon.
    rng = np.random.default_rng(11)
    counts = set()
    for _ in range(600):
        half = rng.choice([0.05, 0.05, 0.03, 0.1], 3)
        other = half if rng.random() < 0.5 else rng.choice([0.05, 0.03, 0.1], 3)
        turn = pin.exp3(rng.normal(size=3))
        tilt = 10.0 ** rng.uniform(-17.0, -3.0, 3) * rng.normal(size=3)
        rotation = turn @ pin.exp3(tilt) @ pin.exp3(np.array([0.0, 0.0, rng.choice([0.0, 0.25, 0.5, 1.0]) * np.pi]))
        aside = rng.choice([0.0, 0.02, 1e-17, 0.05], 2) * rng.normal(size=2)
        apart = turn @ np.array([*aside, half[2] + other[2] + 10.0 ** rng.uniform(-17.0, -4.0) * rng.normal()])
        centre = rng.normal(size=3)
        partner, thing = ConvexBody(centre, turn, half), ConvexBody(centre + apart, rotation, other)
        _, normal, on_object, edges = _kernel.meet(partner.parts, thing.parts, ALIGNED)
        positions, gaps = _kernel.touching(partner.parts, thing.parts, normal, on_object, edges, 1e-3)
        counts.add(len(positions))
        for box, points in ((thing, positions), (partner, positions - gaps[:, None] * normal)):
            assert np.all(np.abs((points - box.centre) @ box.rotation) <= box.half + 1e-9 + np.abs(gaps)[:, None])
    assert {4, 8} <= counts <= set(range(9))


def test_a_box_of_the_wrong_size_is_told() -> None:
    box = ConvexBody(np.zeros(3), np.eye(3), np.ones(3))
    with pytest.raises(ValueError, match="centre: expected 3 numbers, got 2"):
        _kernel.meet((np.zeros(2), *box.parts[1:]), box.parts, ALIGNED)
    with pytest.raises(ValueError, match="edges: expected two axes"):
        _kernel.touching(box.parts, box.parts, np.eye(3)[2], False, (0, 3), 1e-3)
