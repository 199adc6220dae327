# SPDX-License-Identifier: Apache-2.0
"""Units of files and their factors to SI."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_trials.recordings.file_units import FACTORS, SLIDES, TURNS, is_unit, si_unit


def test_the_first_unit_of_every_quantity_is_the_si_unit() -> None:
    """Kills a table that begins with another unit: what is written in SI would be labelled with that."""
    for si, units in FACTORS.items():
        assert next(iter(units)) == si
        assert units[si] == 1.0


def test_prefixes_and_degrees_have_their_factors() -> None:
    """Kills a factor that is its own inverse, or one of another prefix."""
    for units in FACTORS.values():
        for unit, factor in units.items():
            if unit in ("g", "ms", "mm") or unit.startswith(("mrad", "mm/", "mN", "mA")):
                assert factor in (1e-3, 9.80665), unit  # gramme and standard gravity share their sign
    assert FACTORS["rad"]["deg"] == FACTORS["rad/s"]["deg/s"] == np.radians(1.0)


@pytest.mark.parametrize("text", ["[rad]", "(N m)", "N*m", "nm", "deg/s^2", "RAD/S", "-", "", "[us]"])
def test_a_unit_below_a_column_name_is_recognised_however_it_is_spelled(text: str) -> None:
    assert is_unit(text)


@pytest.mark.parametrize("text", ["q1", "0.3", "time", "x", "joint"])
def test_names_and_numbers_are_no_units(text: str) -> None:
    """Kills a test that takes every short word for a unit: names of columns would be skipped as a line of units."""
    assert not is_unit(text)


def test_a_joint_whose_position_is_a_length_has_its_other_quantities_in_units_of_slides() -> None:
    """Kills a look-up that ignores how the joint moves: a velocity of 3 mm/s would be labelled rad/s."""
    assert si_unit("velocity", "mm", "position") == next(iter(SLIDES["velocity"])) == "m/s"
    assert si_unit("torque", "deg/s", "velocity") == next(iter(TURNS["torque"])) == "N m"
    assert si_unit("wrench", "N, N m", "wrench") == "N, N m"
