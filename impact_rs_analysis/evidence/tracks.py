"""Measured against predicted signals over time, whoever measured them: what a reader looks at after the numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from impact_rs_sim.robot import Array

if TYPE_CHECKING:  # a page that shows tracks does not need what they are made from
    from impact_rs_analysis.evidence.aligned import AlignedTrial
    from impact_rs_analysis.evidence.recordings import RecordingSource
    from impact_rs_analysis.evidence.runs import Condition

AXES = "xyz"


@dataclass(frozen=True)
class TrackSignal:
    """One signal, measured and predicted.

    Attributes:
        name: What it is.
        unit: Its unit.
        measured: Measured values, ``(k,)`` in the unit.
        predicted: What the model says, ``(k,)`` in the unit.
    """

    name: str
    unit: str
    measured: Array
    predicted: Array


@dataclass(frozen=True)
class TrackSet:
    """Signals on one clock.

    Attributes:
        label: Which trial, or which recording and model.
        impact: Nominal impact [s]; None where nothing is hit.
        time: Of the trial or since the start of the recording, ``(k,)`` [s].
        signals: The signals, ``(k,)`` each.
    """

    label: str
    impact: float | None
    time: Array
    signals: tuple[TrackSignal, ...]


def tracks_of_trials(aligned: Sequence[AlignedTrial]) -> tuple[TrackSet, ...]:
    """Tracks of trials against their twins, those with an impact first."""
    return tuple(
        TrackSet(
            label=_label(trial.condition),
            impact=trial.condition.plan.scene.scenario.timing.nominal_impact if _hits(trial) else None,
            time=trial.time,
            signals=tuple(_signals(trial)),
        )
        for trial in sorted(aligned, key=lambda trial: not _hits(trial))
    )


def tracks_of_recordings(source: RecordingSource, rests: Mapping[str, Array]) -> tuple[TrackSet, ...]:
    """Torque of every joint of every recording, recorded and predicted by one or several models.

    Args:
        source: The recordings.
        rests: By label, what a model leaves of the torque of all recordings, ``(k, n)`` [N m].
    """
    found = []
    recorded = source.balance.recorded
    for label, rest in rests.items():
        start = 0
        for recording, motion in zip(source.recordings, source.motions, strict=True):
            time = motion.time[motion.kept]
            rows = slice(start, start + time.size)
            start += time.size
            measured, predicted = recorded[rows], (recorded - rest)[rows]
            found.append(
                TrackSet(
                    label=label if len(source.motions) == 1 else f"{recording.path.name}, {label}",
                    impact=None,
                    time=time,
                    signals=tuple(
                        TrackSignal(f"torque of joint {joint + 1}", "N m", measured[:, joint], predicted[:, joint])
                        for joint in range(recorded.shape[1])
                    ),
                )
            )
    return tuple(found)


def _hits(trial: AlignedTrial) -> bool:
    return trial.condition.plan.expects_impact


def _label(condition: Condition) -> str:
    place = condition.case if condition.object == "none" else f"{condition.object}, {condition.case}"
    return place if condition.scale == 1.0 else f"{place} ({condition.scale:g} v)"


def _signals(trial: AlignedTrial) -> list[TrackSignal]:
    """What is shown of a trial: end effectors along the main axis first, then their joints, then the object."""
    found: list[TrackSignal] = []
    main = trial.condition.plan.scene.scenario.axis_index
    axes = [(axis, AXES[axis]) for axis in (main, *(axis for axis in range(3) if axis != main))]
    for arm, measured in trial.measured.arms.items():
        predicted = trial.predicted.arms[arm]
        joints = [(joint, str(joint + 1)) for joint in range(measured.position.shape[1])]
        own = [
            *_columns("end-effector velocity", "m/s", measured.twist, predicted.twist, axes),
            *_columns("feedback", "m/s^2", measured.feedback, predicted.feedback, axes),
            *_columns("torque of joint", "N m", measured.torque, predicted.torque, joints),
            *_columns("velocity of joint", "rad/s", measured.velocity, predicted.velocity, joints),
        ]
        several = len(trial.measured.arms) > 1
        found += [replace(signal, name=f"{arm}: {signal.name}") for signal in own] if several else own
    if _hits(trial):
        a, b = trial.measured, trial.predicted
        found += _columns("object position", "m", a.object_position, b.object_position, list(enumerate(AXES[:2])))
        found.append(TrackSignal("object yaw", "rad", a.object_yaw, b.object_yaw))
    return found


def _columns(
    name: str, unit: str, measured: Array, predicted: Array, picks: Iterable[tuple[int, str]]
) -> list[TrackSignal]:
    return [TrackSignal(f"{name} {label}", unit, measured[:, i], predicted[:, i]) for i, label in picks]
