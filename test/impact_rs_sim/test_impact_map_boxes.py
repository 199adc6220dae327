# SPDX-License-Identifier: Apache-2.0
"""The compiled contact search finds the points of a plain one, in the same order."""

from __future__ import annotations

import clipping
import numpy as np
import pinocchio as pin
import pytest

from impact_rs_sim import _kernel
from impact_rs_sim.impact_map.contacts import ALIGNED, Box, Meeting


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
    touching = 0
    for _ in range(150):
        partner, thing = placed(rng, tilt)
        separation, normal, on_object = _kernel.separating_face(partner.parts, thing.parts, ALIGNED)
        expected = clipping.separating_face(partner, thing)
        assert separation == pytest.approx(expected[0], abs=1e-14)
        np.testing.assert_allclose(normal, expected[1], atol=1e-14)
        assert on_object == expected[2]
        plain = clipping.touching(Meeting("arm", partner, thing, *expected), 3e-3)
        positions, gaps = _kernel.touching(partner.parts, thing.parts, normal, on_object, 3e-3)
        assert len(positions) == len(gaps) == len(plain)
        touching += bool(len(plain))
        for position, gap, (its_position, its_gap) in zip(positions, gaps, plain, strict=True):
            np.testing.assert_allclose(position, its_position, atol=1e-13)
            assert gap == pytest.approx(its_gap, abs=1e-13)
    assert touching > 20


def test_a_box_of_the_wrong_size_is_told() -> None:
    box = Box(np.zeros(3), np.eye(3), np.ones(3))
    with pytest.raises(ValueError, match="centre: expected 3 numbers, got 2"):
        _kernel.separating_face((np.zeros(2), *box.parts[1:]), box.parts, ALIGNED)
