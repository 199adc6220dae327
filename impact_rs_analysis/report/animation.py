# SPDX-License-Identifier: Apache-2.0
"""Runs in 3D as ``replay.js`` reads them: scene and motion, as base64 float32."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.evidence.animation import OBJECT, Animation, Movement
from impact_rs_analysis.report.page import packed
from impact_rs_analysis.report.scene import scene_data
from impact_rs_sim.robot import Array

SLOW_BEFORE, SLOW_AFTER = 0.02, 0.06  # s about the impact, shown in slow motion
STRIDES = (0.001, 0.01)  # s between samples of a page at least, about the impact and elsewhere; the page interpolates
MOST_ROWS = 1500  # per run, away from the impact; a recording may last for minutes
MOST_RUNS = 8  # with that many rows; with more runs the rows per run decrease in proportion


@dataclass(frozen=True)
class ReplayPart:
    """Runs of a page in 3D.

    Attributes:
        data: What the page's script reads (:func:`animation_data`).
        choose: Whether to show a selection of the run; else the page has its own, in the same order.
    """

    data: dict[str, Any]
    choose: bool

    @classmethod
    def of(cls, animations: Sequence[Animation], choose: bool = True) -> ReplayPart | None:
        """Runs of a page; None without runs."""
        return cls(animation_data(animations), choose and len(animations) > 1) if animations else None

    @property
    def labels(self) -> list[str]:
        """Names of the runs."""
        return [run["label"] for run in self.data["runs"]]


def animation_data(animations: Sequence[Animation]) -> dict[str, Any]:
    """Argument ``data`` of ``new ImpactReplay(element, data)``.

    Returns:
        ``scenes`` (:mod:`impact_rs_analysis.report.scene`), and by run its label, number of its scene, begin of the
        impact and of the slow part [s], times [s] with the rows in which stretches begin, and its sides ``measured``
        and ``model``: joint positions of all arms side by side [rad], contact forces [N], pose
        of the object [m, -], and velocities before and after the impact [m/s].
    """
    coarser = max(1.0, len(animations) / MOST_RUNS)
    scenes: list[dict[str, Any]] = []
    runs = []
    for animation in animations:
        scene = scene_data(animation.physics)
        if scene not in scenes:
            scenes.append(scene)
        runs.append(_run_data(animation, scenes.index(scene), (coarser * STRIDES[0], coarser * STRIDES[1])))
    return {"scenes": scenes, "runs": runs}


def _run_data(animation: Animation, scene: int, strides: tuple[float, float]) -> dict[str, Any]:
    time, impact = animation.time, animation.impact
    shown = shown_rows(animation, strides[0], max(strides[1], float(time[-1] - time[0]) / MOST_ROWS))
    starts = np.searchsorted(shown, animation.starts)
    slow = None if impact is None else [impact - SLOW_BEFORE, impact + SLOW_AFTER]
    return {
        "label": animation.label,
        "scene": scene,
        "impact": impact,
        "slow": slow,
        "starts": starts.tolist(),
        "time": packed(time[shown]),
        "measured": _side(animation.measured, shown),
        "model": None if animation.model is None else _side(animation.model, shown),
    }


def shown_rows(animation: Animation, fine: float, coarse: float) -> NDArray[np.int64]:
    """Rows for a page: dense about the impact, coarse elsewhere, and the ends of every stretch.

    Args:
        animation: The run.
        fine: Time between rows about the impact, at least [s].
        coarse: Time between other rows [s].
    """
    time = animation.time
    edges = (*animation.starts, time.size)
    kept = np.zeros(time.size, dtype=bool)
    kept[[*animation.starts, *(edge - 1 for edge in edges[1:])]] = True
    kept |= _first_of_each(time, coarse)
    if animation.impact is not None:
        slow = (time >= animation.impact - SLOW_BEFORE) & (time <= animation.impact + SLOW_AFTER)
        kept |= slow & _first_of_each(time, fine)
    return np.flatnonzero(kept)


def _first_of_each(time: Array, period: float) -> NDArray[np.bool_]:
    """The first sample of every period."""
    steps = np.floor((time - time[0]) / period + 1e-3)
    return np.concatenate(([True], steps[1:] > steps[:-1]))


def _side(movement: Movement, shown: NDArray[np.int64]) -> dict[str, Any]:
    forces = np.column_stack([movement.forces[arm] for arm in movement.joints]) if movement.forces else None
    return {
        "joints": packed(np.column_stack(list(movement.joints.values()))[shown]),
        "forces": None if forces is None else packed(forces[shown]),
        "object": None if np.isnan(movement.object).all() else packed(movement.object[shown]),
        "jumps": [
            {
                "arm": None if jump.body == OBJECT else list(movement.joints).index(jump.body),
                "place": jump.place.tolist(),
                "before": jump.before.tolist(),
                "after": jump.after.tolist(),
            }
            for jump in movement.jumps
        ],
    }
