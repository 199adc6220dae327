# SPDX-License-Identifier: Apache-2.0
"""Hits say where the frame of the tracker is, before any replay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.evidence.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.tracker_start import tracker_frame_start
from impact_rs_sim.effects import library
from impact_rs_trials.runs import Run

from .test_readings_of_replays import turned


def test_a_frame_that_is_turned_is_found_from_hits(hit: Run) -> None:
    """Kills a frame in place of its inverse: both have the sign of x, y and yaw alike only for small shifts."""
    found = tracker_frame_start([MeasuredRun.of(turned(hit, 0.05, 0.0, 0.01))])
    assert found is not None and found[2] == pytest.approx(0.05, abs=0.006)
    box = MeasuredRun.of(hit).setup.windows[-1].object
    physics = library()["tracker_frame"].apply_vector(hit.physics, found)
    seen = MeasuredRun.of(turned(hit, 0.05, 0.0, 0.01)).setup.windows[-1].object
    position, _ = physics.tracker.pose_of(seen.position, seen.rotation)
    across = box.rotation.T @ (position - box.position)  # the hit tells the distance to the face alone
    assert np.min(np.abs(across[:2])) < 0.003


def test_exact_poses_give_no_other_start(hit: Run) -> None:
    assert tracker_frame_start([MeasuredRun.of(hit)]) is None


def test_runs_without_tracking_give_none(hit: Run) -> None:
    blind = replace(hit, signals=replace(hit.signals, object_time=np.zeros(0)))
    assert tracker_frame_start([MeasuredRun.of(blind)]) is None
