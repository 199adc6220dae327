# SPDX-License-Identifier: Apache-2.0
"""Effects that depend on a circumstance: a value under each level, or a line over a number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impact_table_cases import cube

from impact_rs_sim.effects import library
from impact_rs_sim.effects.depending import Depending, Levels, Slope
from impact_rs_sim.physics import Physics

FRICTION, TANGENTIAL = library()["support_friction"], library()["tangential_restitution"]
BY_SESSION = Depending(FRICTION, "session", Levels(("A", "B")))
BY_TEMPERATURE = Depending(FRICTION, "temperature", Slope(mean=20.0, spread=5.0))


def under(**circumstances: float | str) -> Physics:
    return replace(cube(friction=0.5), circumstances=circumstances)


def test_a_level_has_its_own_value_and_an_unknown_one_the_mean() -> None:
    values = np.array([-0.2, 0.1])
    friction = {
        level: BY_SESSION.apply_vector(under(session=level), values).support_friction for level in ("A", "B", "C")
    }
    assert friction == pytest.approx({"A": 0.3, "B": 0.6, "C": 0.45})


def test_a_number_moves_the_value_along_a_line() -> None:
    """0.5 - 0.1 at the mean of 20, and 0.05 less with every 5 more."""
    at = [BY_TEMPERATURE.apply_vector(under(temperature=t), np.array([-0.1, -0.05])) for t in (15.0, 20.0, 30.0)]
    assert [physics.support_friction for physics in at] == pytest.approx([0.45, 0.4, 0.3])


def test_alike_under_all_circumstances_it_is_the_effect_itself() -> None:
    for pair, physics in ((BY_SESSION, under(session="B")), (BY_TEMPERATURE, under(temperature=31.0))):
        found = pair.apply_vector(physics, pair.at(np.array([-0.2]), ()))
        assert found.support_friction == FRICTION.apply_vector(physics, np.array([-0.2])).support_friction
        np.testing.assert_array_equal(pair.nominal(()), pair.at(FRICTION.nominal(()), ()))


def test_no_level_falls_below_no_friction_and_a_change_spans_the_range() -> None:
    lower, upper = BY_SESSION.bounds(under(session="A"))
    assert (lower.tolist(), upper.tolist()) == ([-0.5, -0.5], [2.0, 2.0])
    lower, upper = BY_TEMPERATURE.bounds(under(temperature=0.0))
    assert (lower.tolist(), upper.tolist()) == ([-0.5, -2.5], [2.0, 2.5])


def test_shapes_are_the_same_everywhere_and_cost_nothing() -> None:
    pair = Depending(TANGENTIAL, "session", Levels(("A", "B", "C")))
    assert [scalar.name for scalar in pair.scalars(())] == ["restitution A", "restitution B", "restitution C", "fall"]
    assert (pair.complexity(()), TANGENTIAL.complexity(())) == (3, 1)
    found = pair.apply_vector(under(session="B"), np.array([0.1, 0.4, 0.7, 0.02]))
    one = TANGENTIAL.apply_vector(under(session="B"), np.array([0.4, 0.02]))
    assert found.contact_laws == one.contact_laws
