# SPDX-License-Identifier: Apache-2.0
"""Detection of impacts from joint signals: momentum observer with a threshold above its own noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from impact_rs_analysis.evidence.replays.features import LOSS_WINDOW_S, onset_level, onsets_of
from impact_rs_analysis.evidence.replays.replay import WINDOW_BEFORE_IMPACT_S
from impact_rs_control.detection import ImpactDetector
from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.trial_settings import Detection
from impact_rs_trials.runs import Run

OBSERVER_GAIN_1_S = 500.0  # of the momentum observer
OBSERVER_SETTLING_S = 0.01  # five time constants of the observer
MIN_FORCE_NOISE_RATIO = 8.0  # threshold of the observed force over its noise
MIN_SHARE_OF_PEAK_FORCE = 0.15  # threshold over the largest force
MIN_SHARE_OF_TOP_SPEED = 0.25  # slower contacts are no planned impact
MAX_FORCE_RISE_S = 0.02  # from the begin of the impact to the largest force


def impacts_of(run: Run) -> dict[str, tuple[float, float]]:
    """Begin of the impact [s] and its loss of speed [m/s], by arm.

    Raises:
        InputError: An arm has no impact.
    """
    impacts = {}
    for name, arm in run.signals.arms.items():
        model = run.physics.robot_model(name)
        time = run.signals.time
        observed = observe(time, arm.position, arm.velocity, arm.torque, model)
        velocity, force = observed.velocity, observed.sudden
        for start, end in run.gaps:  # the end of an interpolated gap looks like an impact
            force[(time > start) & (time < end + OBSERVER_SETTLING_S)] = 0.0
        row = first_rise(force, np.linalg.norm(velocity, axis=1), run.period)
        begin, level = math.nan, None
        if row is not None:
            first = max(0, row - round((WINDOW_BEFORE_IMPACT_S + 0.01) / run.period))
            rows = slice(first, row + round(LOSS_WINDOW_S / run.period))
            level = onset_level(time[rows], velocity[rows])
            begin = math.nan if level is None else float(onsets_of(time[rows], velocity[None, rows], level)[0])
        if math.isnan(begin) or level is None:
            raise InputError(f"arm {name!r} hits nothing: no sudden force slows it down")
        impacts[name] = (begin, level)
    return impacts


@dataclass(frozen=True)
class Observed:
    """End-effector signals estimated from joint signals.

    Attributes:
        velocity: Velocity of the origin of E in A, ``(k, 3)`` [m/s].
        force: External force on the end effector, axes of A, ``(k, 3)`` [N].
        sudden: Sudden part of it against the direction in which E is fastest, ``(k,)`` [N].
    """

    velocity: Array
    force: Array
    sudden: Array


def observe(time: Array, position: Array, velocity: Array, torque: Array, model: RobotModel) -> Observed:
    """Velocity of the end effector, and the external force from the momentum observer.

    Args:
        time: Samples, ``(k,)`` [s].
        position: q, ``(k, n)`` [rad].
        velocity: dq, ``(k, n)`` [rad/s].
        torque: tau_J, ``(k, n)`` [N m].
        model: Nominal rigid-body model.
    """
    moving = np.array([(model.jacobian(q) @ dq)[:3] for q, dq in zip(position, velocity, strict=True)])
    fastest = moving[int(np.argmax(np.linalg.norm(moving, axis=1)))]
    period = float(np.median(np.diff(time)))
    gain = min(OBSERVER_GAIN_1_S, 1.0 / period)  # above 2 / period the discrete observer is unstable
    settings = Detection(observer_gain=gain, threshold=1e9, arm_before=1.0)
    direction = fastest / (np.linalg.norm(fastest) or 1.0)  # an arm at rest has none
    detector = ImpactDetector(model, settings, direction, period)
    force, sudden = np.empty((time.size, 3)), np.empty(time.size)
    for row, (q, dq, tau) in enumerate(zip(position, velocity, torque, strict=True)):
        detector.update(q, dq, tau, model.terms(q, dq))
        force[row], sudden[row] = detector.wrench[:3], detector.force
    return Observed(moving, force, sudden)


def first_rise(force: Array, speed: Array, period: float) -> int | None:
    """Sample in which a sudden force begins; None without one.

    Args:
        force: Sudden part of the force, ``(k,)`` [N].
        speed: Speed of the end effector, ``(k,)`` [m/s].
        period: Period of the samples [s].
    """
    fast = np.maximum.accumulate(speed > MIN_SHARE_OF_TOP_SPEED * speed.max())
    if not np.any(fast):
        return None
    peak = int(np.argmax(np.where(fast, force, -np.inf)))
    quiet = force[: max(0, peak - round(MAX_FORCE_RISE_S / period))]
    quiet = quiet[quiet.size // 10 :]  # the observer starts from rest
    if quiet.size < 10:
        return None
    noise = float(np.median(np.abs(quiet - np.median(quiet)))) / 0.6745
    threshold = max(MIN_FORCE_NOISE_RATIO * noise, MIN_SHARE_OF_PEAK_FORCE * float(force[peak]))
    above = np.nonzero(fast & (force > threshold))[0]
    return int(above[0]) if above.size else None
