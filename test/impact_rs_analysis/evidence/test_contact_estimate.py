# SPDX-License-Identifier: Apache-2.0
"""Impacts say where the tracker sees an object, before any replay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.evidence.replays.contact_estimate import (
    DISTANCE_SD_M,
    PRIOR_SCALES,
    contact_estimate,
    contact_starts,
)
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_sim.effects import library
from impact_rs_trials.runs import Run

from .test_readings_of_replays import turned

FRAME, POINT, PAD = (library()[name] for name in ("tracker_frame", "tracked_point", "pad_position"))


def test_a_frame_that_is_turned_is_corrected_along_the_normal(hit: Run) -> None:
    """One impact determines only the offset along the normal. Kills a frame in place of its inverse."""
    seen = MeasuredRun.of(turned(hit, 0.05, 0.0, 0.01))
    found = contact_estimate(FRAME, [seen])
    assert found is not None and found.values[2] > 0.01
    box, reading = MeasuredRun.of(hit).setup.windows[-1].object, seen.setup.windows[-1].object
    position, _ = FRAME.apply_vector(hit.physics, found.values).tracker.pose_of(reading.position, reading.rotation)
    across = box.rotation.T @ (position - box.position)
    assert np.min(np.abs(across[:2])) < 0.003


def test_a_tracked_point_is_found_along_the_normal_and_left_across_it(hit: Run) -> None:
    """Kills a step that is not held where impacts say nothing, and a point of the wrong sign."""
    signals = hit.signals
    axes = MeasuredRun.of(hit).setup.windows[-1].object.rotation
    offset = np.array([0.012, 0.012, 0.0])
    shifted = replace(hit, signals=replace(signals, object_position=signals.object_position + axes @ offset))
    found = contact_estimate(POINT, [MeasuredRun.of(shifted)])
    assert found is not None
    along, across = sorted(found.values, reverse=True)
    assert along == pytest.approx(0.012, abs=0.002) and abs(across) < 0.001


def test_a_pad_that_sits_farther_out_is_found_with_its_interval(hit: Run) -> None:
    """Kills a pad that is not moved, and a deviation without the prior or without the distance's own."""
    moved = replace(hit, physics=PAD.apply_vector(hit.physics, np.array([0.0, 0.0, -0.012])))
    found = contact_estimate(PAD, [MeasuredRun.of(moved)])
    assert found is not None
    assert found.values[2] == pytest.approx(0.012, abs=0.002)
    assert DISTANCE_SD_M / 2.0 < found.deviations[2] < 1.5 * DISTANCE_SD_M
    across = [PRIOR_SCALES * scalar.scale for scalar in PAD.scalars(1)[:2]]
    assert found.deviations[:2] == pytest.approx(across, rel=0.05)
    assert found.item is not None
    low, high = found.item.parameters["z"].ci95 or (0.0, 0.0)
    assert low < 0.012 < high and high - low == pytest.approx(2.0 * 1.96 * found.deviations[2], rel=1e-3)


def test_an_estimate_out_of_its_range_is_no_entry_of_a_model(hit: Run) -> None:
    """Kills a model with a frame that the library would refuse to read."""
    found = contact_estimate(FRAME, [MeasuredRun.of(turned(hit, 0.05, 0.0, 0.01))])
    assert found is not None and found.item is not None
    assert replace(found, values=np.array([0.3, 0.0, 0.0])).item is None


def test_exact_poses_give_no_other_start(hit: Run) -> None:
    assert contact_estimate(FRAME, [MeasuredRun.of(hit)]) is None


def test_runs_without_tracking_give_none(hit: Run) -> None:
    blind = replace(hit, signals=replace(hit.signals, object_time=np.zeros(0)))
    assert contact_estimate(FRAME, [MeasuredRun.of(blind)]) is None


def test_fits_start_from_a_shift_a_turn_and_both(hit: Run) -> None:
    """Kills a start from the mixture alone, from which a descent does not find a frame that is only shifted."""
    seen = MeasuredRun.of(turned(hit, 0.03, 0.0, 0.0))
    shift, turn, both = contact_starts(FRAME, [seen])
    assert shift[2] == 0.0 and np.linalg.norm(shift[:2]) > 0.005
    assert np.all(turn[:2] == 0.0) and turn[2] > 0.01
    assert 0.0 < both[2] < turn[2] and 0.0 < np.linalg.norm(both[:2]) < np.linalg.norm(shift[:2])
    assert len(contact_starts(POINT, [seen])) == 1
    assert contact_starts(FRAME, [MeasuredRun.of(hit)]) == []
