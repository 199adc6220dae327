# SPDX-License-Identifier: Apache-2.0
"""Start of a fit of the tracker's frame, from hits in which pads lie on faces.

If the error of the frame exceeds the motion of the pad before the impact, object and pad interpenetrate at the start of
a replay, where sensitivities are useless.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from impact_rs_analysis.evidence.measured_runs import MeasuredRun
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.contact_frame import FOLLOWED, TOUCHING, PadOnFace, contact_frame

MIN_STANDARD_ERRORS = 1.0  # of the tracker frame from nominal; nearer, nominal is as good a start


def tracker_frame_start(runs: Iterable[MeasuredRun]) -> Array | None:
    """x, y [m] and yaw [rad] of the effect ``tracker_frame`` from hits, ``(3,)``; None: as exact as hits can tell."""
    touches = [touch for run in runs if run.hit and run.setup.tracked for touch in _touches(run)]
    try:
        found = contact_frame(touches, np.zeros(3), 0.0)
    except (InputError, np.linalg.LinAlgError):
        return None
    if not np.any(np.abs(np.append(found.position[:2], found.yaw)) > MIN_STANDARD_ERRORS * found.error):
        return None
    back = pin.rpy.rpyToMatrix(0.0, 0.0, -found.yaw)  # from A to the frame that readings are in
    return np.append(-(back @ np.append(found.position[:2], 0.0))[:2], -found.yaw)


def _touches(run: MeasuredRun) -> list[PadOnFace]:
    """Pad and face of every arm of a hit."""
    signals, physics = run.signals, run.setup.physics
    seen, start = signals.object_time, run.setup.windows[-1].object
    found = []
    for name, impact in run.impacts.items():
        first, last = (impact + moment for moment in TOUCHING)
        rows = np.flatnonzero((seen >= first) & (seen <= last))
        if not rows.size:
            continue
        model = physics.robot_model(name)
        joints = signals.arms[name].position
        ends = np.array([impact, min(impact + FOLLOWED, float(signals.time[-1]), float(seen[-1]))])
        pads = [model.placement(q) for q in _at(seen[rows], signals.time, joints)]
        way = np.diff([model.placement(q).translation[:2] for q in _at(ends, signals.time, joints)], axis=0)[0]
        found.append(
            PadOnFace(
                run=run.name,
                pad=np.array([pad.translation for pad in pads]),
                pad_normal=np.array([pad.rotation[:, 2] for pad in pads]),
                position=signals.object_position[rows],
                rotation=np.array([pin.Quaternion(q).matrix() for q in signals.object_quaternion[rows]]),
                size=physics.object.size,
                standing=float(start.position[2]),
                standing_height=float(start.position[2]),
                pad_way=way,
                object_way=np.diff(_at(ends, seen, signals.object_position[:, :2]), axis=0)[0],
            )
        )
    way = np.mean([touch.pad_way for touch in found], axis=0) if found else np.zeros(2)
    return [PadOnFace(**{**vars(touch), "pad_way": way}) for touch in found]


def _at(moments: Array, time: Array, values: Array) -> Array:
    """Values at moments, ``(m, k)``."""
    return np.column_stack([np.interp(moments, time, column) for column in values.T])
