# SPDX-License-Identifier: Apache-2.0
"""Predictions far outside of what was measured: where the limit is, and that it is said in one line."""

from __future__ import annotations

import math

import pytest

from impact_rs_analysis.measure.far import FAR, Jump, far_jumps, far_words
from impact_rs_analysis.measure.paper import paper_results
from impact_rs_sim.scenario import load_scenario


def test_published_predictions_are_at_most_about_half_as_far_as_far() -> None:
    worst = 0.0
    for result in paper_results():
        scenario = load_scenario(result.scenario)
        (ante, *_) = {arm.ante_velocity for arm in scenario.case(result.case).robots.values()}
        predicted = result.row.estimate * (1.0 + result.row.reduced / 100.0)
        jump = Jump(result.label, ante[scenario.axis_index], predicted, result.row.estimate)
        worst = max(worst, jump.mismatch)
    assert 0.4 * FAR < worst < 0.52 * FAR


@pytest.mark.parametrize("ante", [-0.5, 0.5])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_far_is_a_fifth_of_the_speed_before_the_impact_on_either_side(ante: float, side: float) -> None:
    near, beyond = (Jump("tin", ante, 0.5 * ante + side * share * ante, 0.5 * ante) for share in (0.199, 0.201))
    assert far_jumps([near, beyond]) == [beyond]
    assert beyond.mismatch == pytest.approx(0.201)


def test_the_farthest_is_named_in_one_line() -> None:
    jumps = [Jump("tin", -0.5, -0.30, -0.30), Jump("box", -0.5, -0.10, -0.30), Jump("jar", -0.5, -0.45, -0.20)]
    line = far_words(jumps)
    start = "2 of 3 predictions are far from the measurement, most for jar: -0.450 m/s predicted, -0.200"
    assert line.startswith(start) and "50% of the ante-impact speed" in line and "\n" not in line
    assert far_words(jumps[:1]) == ""


def test_without_a_speed_before_the_impact_nothing_is_far() -> None:
    assert far_jumps([Jump("tin", math.nan, 9.0, 0.1), Jump("tin", 0.0, 9.0, 0.1)]) == []
