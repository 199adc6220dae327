# SPDX-License-Identifier: Apache-2.0
"""A scene with two arms of different kinds, and runs in it to be shown in 3D."""

from __future__ import annotations

import numpy as np
from mixed_grab import MIXED

from impact_rs_analysis.evidence.tracks import ArmTrack, Track, TrackSide
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array

PHYSICS = Physics.nominal(MIXED, next(iter(MIXED.objects)))


def joints_track(
    time: Array,
    *sides: dict[str, Array],
    starts: tuple[int, ...] = (0,),
    impact: float | None = None,
    physics: Physics = PHYSICS,
) -> Track:
    """A run whose joints alone are known: measured, and predicted by a model where there is a second side."""
    unseen = np.full((time.size, 7), np.nan)
    both = [TrackSide({name: ArmTrack(q) for name, q in side.items()}, unseen) for side in sides]
    return Track("run", time, impact, starts, (), physics, both[0], both[1] if len(both) > 1 else None)
