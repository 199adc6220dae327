# SPDX-License-Identifier: Apache-2.0
"""Contact points of pad, object and support."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from impact_map_cases import ENGINES, LEAN, MODEL, crossed, nominal, one_point

from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map import BulletEngine, ExactEngine, ImpactProblem, check_problem, compute_impact_map
from impact_rs_sim.impact_map.contacts import ContactPoint, contact_frame, find_contacts, meetings
from impact_rs_sim.scene import BodyState


def contacts_of(problem: ImpactProblem, partner: str) -> list[ContactPoint]:
    placements = {"arm": MODEL.placement(problem.arms["arm"].position)}
    found = meetings(problem.physics, problem.object, placements)
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


def test_bullet_finds_the_same_contact_points() -> None:
    problem = nominal()
    answers = []
    for engine in (BulletEngine(problem.physics), ExactEngine(problem.physics)):
        points = [(c.body_b, *np.round(c.position, 6)) for c in engine.solve(problem).contacts]
        answers.append(sorted(points))
        engine.close()
    for first, second in zip(*answers, strict=True):
        assert first[0] == second[0]
        np.testing.assert_allclose(first[1:], second[1:], atol=2e-6)


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
    (meeting,) = check_problem(problem)  # 20 mm of air are no overlap
    assert meeting.separation == pytest.approx(gap, abs=1e-12)
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
