# SPDX-License-Identifier: Apache-2.0
"""The compiled contact search finds the points of a plain one, in the same order."""

from __future__ import annotations

from dataclasses import replace

import clipping
import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map.contacts import ALIGNED, Box, Meeting


def crossed(rng: np.random.Generator) -> tuple[Box, Box]:
    """Two boxes in any orientation, some millimetres apart or into each other along the line of their centres."""
    partner, thing = (Box(np.zeros(3), pin.exp3(rng.normal(size=3)), rng.uniform(0.03, 0.1, 3)) for _ in range(2))
    way = rng.normal(size=3)
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        apart = clipping.meet(partner, Box(middle * way, thing.rotation, thing.half))[0] > 0.0
        low, high = (low, middle) if apart else (middle, high)
    centre = high * way + rng.normal(0.0, 2e-3) * way / np.linalg.norm(way)
    return partner, Box(centre, thing.rotation, thing.half)


def placed(rng: np.random.Generator, tilt: float) -> tuple[Box, Box]:
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
    return Box(centre, turn, partner), Box(centre + away + aside, rotation, thing)


@pytest.mark.parametrize("tilt", [0.0, 1e-6, 0.004, 0.5])
def test_compiled_and_plain_search_find_the_same_points_in_the_same_order(tilt: float) -> None:
    rng = np.random.default_rng(3)
    touching = crossing = 0
    for number in range(150):
        partner, thing = crossed(rng) if tilt == 0.5 and number % 2 else placed(rng, tilt)
        separation, normal, on_object, edges = _kernel.meet(partner.parts, thing.parts, ALIGNED)
        expected = clipping.meet(partner, thing)
        assert separation == pytest.approx(expected[0], abs=1e-14)
        np.testing.assert_allclose(normal, expected[1], atol=1e-14)
        assert (on_object, edges) == expected[2:]
        crossing += edges is not None
        plain = clipping.touching(Meeting("arm", partner, thing, *expected), 3e-3)
        positions, gaps = _kernel.touching(partner.parts, thing.parts, normal, on_object, edges, 3e-3)
        assert len(positions) == len(gaps) == len(plain)
        touching += bool(len(plain))
        for position, gap, (its_position, its_gap) in zip(positions, gaps, plain, strict=True):
            np.testing.assert_allclose(position, its_position, atol=1e-13)
            assert gap == pytest.approx(its_gap, abs=1e-13)
    assert touching > 20
    assert crossing > 20 if tilt == 0.5 else True


def test_edges_that_cross_separate_boxes_that_no_face_does() -> None:
    # One cube of 0.1 m stands on an edge along y, another one on an edge along x below it.
    lower = Box(np.zeros(3), pin.utils.rotate("x", np.pi / 4.0), np.full(3, 0.05))
    for gap, count in ((0.02, 0), (0.0005, 1), (0.0, 1), (-0.0005, 1)):
        centre = np.array([0.0, 0.0, 0.1 * np.sqrt(2.0) + gap])
        upper = Box(centre, pin.utils.rotate("y", np.pi / 4.0), np.full(3, 0.05))
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
    pad = Box(np.zeros(3), pin.utils.rotate("x", tilt), np.array([0.05, 0.05, 0.01]))
    box = Box(np.zeros(3), pin.utils.rotate("y", tilt), np.array([0.05, 0.15, 0.02]))
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
        partner, thing = Box(centre, turn, half), Box(centre + apart, rotation, other)
        _, normal, on_object, edges = _kernel.meet(partner.parts, thing.parts, ALIGNED)
        positions, gaps = _kernel.touching(partner.parts, thing.parts, normal, on_object, edges, 1e-3)
        counts.add(len(positions))
        for box, points in ((thing, positions), (partner, positions - gaps[:, None] * normal)):
            assert np.all(np.abs((points - box.centre) @ box.rotation) <= box.half + 1e-9 + np.abs(gaps)[:, None])
    assert {4, 8} <= counts <= set(range(9))


def test_a_box_of_the_wrong_size_is_told() -> None:
    box = Box(np.zeros(3), np.eye(3), np.ones(3))
    with pytest.raises(ValueError, match="centre: expected 3 numbers, got 2"):
        _kernel.meet((np.zeros(2), *box.parts[1:]), box.parts, ALIGNED)
    with pytest.raises(ValueError, match="edges: expected two axes"):
        _kernel.touching(box.parts, box.parts, np.eye(3)[2], False, (0, 3), 1e-3)
