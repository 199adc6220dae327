# SPDX-License-Identifier: Apache-2.0
"""Runs in 3D as ``replay.js`` reads them: scene and motion, as base64 float32."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.evidence.tracks import OBJECT, Track, TrackSide
from impact_rs_analysis.report.page import packed
from impact_rs_analysis.report.scene_3d import scene_data
from impact_rs_sim.robots.robot import Array

SLOW_BEFORE, SLOW_AFTER = 0.02, 0.06  # s before and after the impact, shown in slow motion
MIN_FRAME_PERIODS_S = (0.001, 0.01)  # near the impact and elsewhere; the page interpolates
MAX_ROWS_PER_RUN = 1500  # away from the impact; a recording may last for minutes
MAX_RUNS_OF_ALL_ROWS = 8  # with more runs the rows per run decrease in proportion


@dataclass(frozen=True)
class ReplayPart:
    """Runs of a page in 3D.

    Attributes:
        data: Data of the page's script (:func:`animation_data`).
        choose: Whether to show a selection of the run; otherwise the page has a selection in the same order.
    """

    data: dict[str, Any]
    choose: bool

    @classmethod
    def of(cls, tracks: Sequence[Track], choose: bool = True) -> ReplayPart | None:
        """Runs of a page; None without runs."""
        return cls(animation_data(tracks), choose and len(tracks) > 1) if tracks else None

    @property
    def labels(self) -> list[str]:
        """Names of the runs."""
        return [run["label"] for run in self.data["runs"]]


def animation_data(tracks: Sequence[Track]) -> dict[str, Any]:
    """Argument ``data`` of ``new ImpactReplay(element, data)``.

    Returns:
        ``scenes`` (:mod:`impact_rs_analysis.report.scene_3d`), and by run its label, number of its scene, beginning
        of the impact, interval of slow motion [s], times [s], first rows of its stretches, and its sides ``measured``
        and ``model``: joint positions of all arms side by side [rad], contact forces [N], poses
        of the object and of its neighbours [m, -], and velocities before and after the impact [m/s].
    """
    stride_factor = max(1.0, len(tracks) / MAX_RUNS_OF_ALL_ROWS)
    scenes: list[dict[str, Any]] = []
    runs = []
    for track in tracks:
        assert track.physics is not None
        scene = scene_data(track.physics)
        if scene not in scenes:
            scenes.append(scene)
        runs.append(
            _run_data(
                track,
                scenes.index(scene),
                (stride_factor * MIN_FRAME_PERIODS_S[0], stride_factor * MIN_FRAME_PERIODS_S[1]),
            )
        )
    return {"scenes": scenes, "runs": runs}


def _run_data(track: Track, scene: int, strides: tuple[float, float]) -> dict[str, Any]:
    assert track.measured is not None
    time, impact = track.time, track.impact
    shown = shown_rows(track, strides[0], max(strides[1], float(time[-1] - time[0]) / MAX_ROWS_PER_RUN))
    starts = np.searchsorted(shown, track.starts)
    slow = None if impact is None else [impact - SLOW_BEFORE, impact + SLOW_AFTER]
    return {
        "label": track.label,
        "scene": scene,
        "impact": impact,
        "slow": slow,
        "starts": starts.tolist(),
        "time": packed(time[shown]),
        "measured": _side(track.measured, shown),
        "model": None if track.predicted is None else _side(track.predicted, shown),
    }


def shown_rows(track: Track, fine: float, coarse: float) -> NDArray[np.int64]:
    """Rows for a page: dense about the impact, coarse elsewhere, and the ends of every stretch.

    Args:
        track: The run.
        fine: Time between rows about the impact, at least [s].
        coarse: Time between other rows [s].
    """
    time = track.time
    edges = (*track.starts, time.size)
    mask = np.zeros(time.size, dtype=bool)
    mask[[*track.starts, *(edge - 1 for edge in edges[1:])]] = True
    mask |= _first_of_each(time, coarse)
    if track.impact is not None:
        slow = (time >= track.impact - SLOW_BEFORE) & (time <= track.impact + SLOW_AFTER)
        mask |= slow & _first_of_each(time, fine)
    return np.flatnonzero(mask)


def _first_of_each(time: Array, period: float) -> NDArray[np.bool_]:
    """Mask of the first sample of every period."""
    steps = np.floor((time - time[0]) / period + 1e-3)
    return np.concatenate(([True], steps[1:] > steps[:-1]))


def _poses(poses: Array, shown: NDArray[np.int64]) -> str | None:
    """Poses of an object; None: not tracked."""
    return None if np.isnan(poses).all() else packed(poses[shown])


def _side(side: TrackSide, shown: NDArray[np.int64]) -> dict[str, Any]:
    forces = [arm.force for arm in side.arms.values()]
    return {
        "joints": packed(np.column_stack([arm.position for arm in side.arms.values()])[shown]),
        "forces": packed(np.column_stack(forces)[shown]) if all(force.size for force in forces) else None,
        "object": _poses(side.object, shown),
        **({"neighbours": [_poses(poses, shown) for poses in side.neighbours.values()]} if side.neighbours else {}),
        "jumps": [
            {
                "arm": None if jump.body == OBJECT else list(side.arms).index(jump.body),
                "place": jump.position.tolist(),
                "before": jump.before.tolist(),
                "after": jump.after.tolist(),
            }
            for jump in side.jumps
        ],
    }
