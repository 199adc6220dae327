# SPDX-License-Identifier: Apache-2.0
"""Measured and predicted signals over time, for figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from impact_rs_analysis.evidence.animation import Animation, animation_of_motion, animation_of_run
from impact_rs_analysis.evidence.torque_balance import ARM
from impact_rs_sim.robot import Array

if TYPE_CHECKING:  # pages with tracks do not import their sources
    from impact_rs_analysis.evidence.aligned import AlignedRun
    from impact_rs_analysis.evidence.recordings import RecordingSource

AXES = "xyz"


@dataclass(frozen=True)
class TrackSignal:
    """One signal, measured and predicted.

    Attributes:
        name: Name of the signal.
        unit: Its unit.
        measured: Measured values, ``(k,)`` in the unit.
        predicted: Predicted values, ``(k,)`` in the unit.
    """

    name: str
    unit: str
    measured: Array
    predicted: Array


@dataclass(frozen=True)
class TrackSet:
    """Signals on one clock.

    Attributes:
        label: Name of the trial, or of recording and model.
        impact: Begin of the impact [s]; None without an impact.
        time: Of the trial or since the start of the recording, ``(k,)`` [s].
        signals: The signals, ``(k,)`` each.
        animation: The run for the 3D view; None if positions are not known.
    """

    label: str
    impact: float | None
    time: Array
    signals: tuple[TrackSignal, ...]
    animation: Animation | None = None


def tracks_of_runs(aligned: Sequence[AlignedRun]) -> tuple[TrackSet, ...]:
    """Tracks of runs against their replays, those with an impact first; windows are separated by NaN."""
    return tuple(
        TrackSet(
            label=label,
            impact=item.impact,
            time=_parted(item.time, item.starts),
            signals=tuple(
                replace(
                    signal,
                    measured=_parted(signal.measured, item.starts),
                    predicted=_parted(signal.predicted, item.starts),
                )
                for signal in _signals(item)
            ),
            animation=animation_of_run(item, label),
        )
        for item in sorted(aligned, key=lambda item: not item.run.hit)
        for label in [item.run.condition.removeprefix(f"{item.run.place[0]}/").replace("/", ", ")]
    )


def _parted(values: Array, starts: Sequence[int]) -> Array:
    """Values with a NaN before every window but the first, which breaks the line."""
    return np.insert(values.astype(float), list(starts[1:]), np.nan)


def tracks_of_recordings(source: RecordingSource, rests: Mapping[str, Array]) -> tuple[TrackSet, ...]:
    """Torque of every joint of every recording, recorded and predicted by one or several models.

    Args:
        source: The recordings.
        rests: By label, torque residuals of a model for all recordings, ``(k, n)`` [N m].
    """
    found = []
    recorded = source.balance.recorded
    units = [joint.effort for joint in source.physics.arms[ARM].facts.units]
    for label, rest in rests.items():
        start = 0
        for recording, motion in zip(source.recordings, source.motions, strict=True):
            time = motion.time[motion.kept]
            rows = slice(start, start + time.size)
            start += time.size
            measured, predicted = recorded[rows], (recorded - rest)[rows]
            name = label if len(source.motions) == 1 else f"{recording.path.name}, {label}"
            found.append(
                TrackSet(
                    label=name,
                    impact=None,
                    time=time,
                    signals=tuple(
                        TrackSignal(f"torque of joint {joint + 1}", unit, measured[:, joint], predicted[:, joint])
                        for joint, unit in enumerate(units)
                    ),
                    animation=animation_of_motion(name, source.physics, ARM, motion),
                )
            )
    return tuple(found)


def _signals(item: AlignedRun) -> list[TrackSignal]:
    """Signals of a run: end effectors along the main axis first, then joints, then the object."""
    found: list[TrackSignal] = []
    main = item.run.axis
    axes = [(axis, AXES[axis], "m/s") for axis in (main, *(axis for axis in range(3) if axis != main))]
    for arm, measured in item.measured.arms.items():
        predicted = item.predicted.arms[arm]
        units = item.run.setup.physics.arms[arm].facts.units
        torques = [(joint, str(joint + 1), unit.effort) for joint, unit in enumerate(units)]
        speeds = [(joint, str(joint + 1), unit.velocity) for joint, unit in enumerate(units)]
        own = [
            *_columns("end-effector velocity", measured.twist, predicted.twist, axes),
            *_columns("torque of joint", measured.torque, predicted.torque, torques),
            *_columns("velocity of joint", measured.velocity, predicted.velocity, speeds),
        ]
        several = len(item.measured.arms) > 1
        found += [replace(signal, name=f"{arm}: {signal.name}") for signal in own] if several else own
    a, b = item.measured, item.predicted
    if np.isfinite(a.object_yaw).any():
        plane = [(axis, AXES[axis], "m") for axis in range(2)]
        found += _columns("object position", a.object_position, b.object_position, plane)
        speeds = [(axis, AXES[axis], "m/s") for axis in range(2)]
        found += _columns("object velocity", _rate(item, a.object_position), _rate(item, b.object_position), speeds)
        found.append(TrackSignal("object yaw", "rad", a.object_yaw, b.object_yaw))
        found.append(TrackSignal("object yaw rate", "rad/s", _rate(item, a.object_yaw), _rate(item, b.object_yaw)))
    return found


def _rate(item: AlignedRun, values: Array) -> Array:
    """Time derivative of a position, window by window; NaN for a window of one sample."""
    found = np.full(values.shape, np.nan)
    for start, end in pairwise([*item.starts, len(values)]):
        if end - start > 1:
            found[start:end] = np.gradient(values[start:end], item.time[start:end], axis=0)
    return found


def _columns(name: str, measured: Array, predicted: Array, picks: Iterable[tuple[int, str, str]]) -> list[TrackSignal]:
    return [TrackSignal(f"{name} {label}", unit, measured[:, i], predicted[:, i]) for i, label, unit in picks]
