# SPDX-License-Identifier: Apache-2.0
"""Impacts say where the tracker sees an object, before any replay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.replays.tracker_start import tracker_start
from impact_rs_sim.effects import library
from impact_rs_trials.runs import Run

from .test_readings_of_replays import turned

FRAME, POINT = library()["tracker_frame"], library()["tracked_point"]


def test_a_frame_that_is_turned_is_corrected_along_the_normal(hit: Run) -> None:
    """One impact tells the distance to the face alone. Kills a frame in place of its inverse."""
    seen = MeasuredRun.of(turned(hit, 0.05, 0.0, 0.01))
    found = tracker_start(FRAME, [seen])
    assert found is not None and found[2] > 0.01
    box, reading = MeasuredRun.of(hit).setup.windows[-1].object, seen.setup.windows[-1].object
    position, _ = FRAME.apply_vector(hit.physics, found).tracker.pose_of(reading.position, reading.rotation)
    across = box.rotation.T @ (position - box.position)
    assert np.min(np.abs(across[:2])) < 0.003


def test_a_tracked_point_is_found_along_the_normal_and_left_across_it(hit: Run) -> None:
    """Kills a step that is not held where impacts say nothing, and a point of the wrong sign."""
    signals = hit.signals
    axes = MeasuredRun.of(hit).setup.windows[-1].object.rotation
    offset = np.array([0.012, 0.012, 0.0])
    shifted = replace(hit, signals=replace(signals, object_position=signals.object_position + axes @ offset))
    found = tracker_start(POINT, [MeasuredRun.of(shifted)])
    assert found is not None
    along, across = sorted(found, reverse=True)
    assert along == pytest.approx(0.012, abs=0.002) and abs(across) < 0.001


def test_exact_poses_give_no_other_start(hit: Run) -> None:
    assert tracker_start(FRAME, [MeasuredRun.of(hit)]) is None


def test_runs_without_tracking_give_none(hit: Run) -> None:
    blind = replace(hit, signals=replace(hit.signals, object_time=np.zeros(0)))
    assert tracker_start(FRAME, [MeasuredRun.of(blind)]) is None
