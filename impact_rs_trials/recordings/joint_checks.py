# SPDX-License-Identifier: Apache-2.0
"""Checks of a recorded arm, joint by joint, that need no friction model: signs and units.

* *Velocity* is the derivative of position: sum dq/dt v / sum (dq/dt)^2 = 1. After moving averages, for encoders are
  quantised, the two go together at least; where they do not, columns were mixed up.
* *Torque* carries the arm's weight, which positions alone give: sum g tau / sum g^2 = 1.
* *Energy*: a torque drives a joint against its friction, so that the power (tau - g) v is rarely negative. Where the
  weight says nothing, as at a vertical axis, the sign of that correlation does.

A ratio far from 1 counts only if the two signals go together (their correlation); noise and friction lower it and
do not turn its sign.
"""

from __future__ import annotations

import numpy as np

from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import RobotModel
from impact_rs_trials.recordings.guesses import smoothed
from impact_rs_trials.recordings.mapping import Mapping, SignalName
from impact_rs_trials.recordings.plausibility import CHECKED, gravity_torques, noticed
from impact_rs_trials.runs import ArmSignals

RATIO = (0.5, 2.0)
TOGETHER = 0.8  # least correlation of signals that differ by a factor
APART = 0.5  # correlation, after moving averages, below which a velocity is not the derivative of its position
AGAINST = -0.5  # correlation of torque and velocity below which a torque drives nothing
MOVES = 0.02  # of the data sheet's velocity, rms, from which a joint moves


def doubts_of_arm(
    time: Array, arm: ArmSignals, mapping: Mapping, model: RobotModel, contact: bool = False
) -> list[str]:
    """What looks wrong in the signals of an arm: which joint, by how much, and the remedy in the mapping.

    Args:
        time: Stamps, ``(k,)`` [s].
        arm: Recorded position, velocity and torque.
        mapping: Knows the robot.
        model: Nominal arm, for its weight.
        contact: Whether something else pushes the arm, so that torques say nothing of weight and friction.
    """
    rows = np.unique(np.linspace(0, time.size - 1, CHECKED).astype(int))
    weight, derived = gravity_torques(model, arm.position[rows]), np.gradient(arm.position, time, axis=0)
    moves = [_rms(own) > MOVES * most for own, most in zip(derived.T, mapping.facts.limits.velocity_rad_s, strict=True)]
    at, places = smoothed(time, arm.position)
    slopes, means = np.gradient(places, at, axis=0), smoothed(time, arm.velocity)[1]
    speeds: dict[int, str] = {}
    mixed = []
    torques: dict[int, str] = {}
    factors = {"velocity": np.ones(len(moves)), "torque": np.ones(len(moves))}
    for joint, moving in enumerate(moves):
        own, heavy = weight[:, joint], _rms(weight[:, joint]) > noticed(model)
        if moving and (ratio := _ratio(arm.velocity[:, joint], derived[:, joint])) is not None:
            speeds[joint] = f"is {ratio:.2g} times the derivative of its position, expected 1"
            factors["velocity"][joint] = _remedy(ratio)
        if moving and abs(together := _together(means[:, joint], slopes[:, joint])) < APART:
            mixed.append(f"of joint {joint + 1} (correlation {together:.2f})")
        if contact or not np.ptp(arm.torque[:, joint]):  # not measured
            continue
        if heavy and (ratio := _ratio(arm.torque[rows, joint], own)) is not None:
            torques[joint] = f"is {ratio:.2g} times the arm's weight, expected 1"
            factors["torque"][joint] = _remedy(ratio)
        against = _together(arm.torque[rows, joint] - own, factors["velocity"][joint] * arm.velocity[rows, joint])
        if moving and not heavy and against < AGAINST:
            torques[joint] = f"points against its motion (correlation {against:.2f}), as if friction drove it"
            factors["torque"][joint] = -1.0
    remark = f"velocity {', '.join(mixed)} is not the derivative of its position: columns of other joints?"
    return [
        *([remark] if mixed and "velocity" in mapping.signals else []),
        *_remarks("velocity", speeds, factors["velocity"], mapping),
        *_remarks("torque", torques, factors["torque"], mapping),
    ]


def _remarks(name: SignalName, doubts: dict[int, str], factors: Array, mapping: Mapping) -> list[str]:
    """One remark for a signal, with the factors that would put it right."""
    if not doubts or name not in mapping.signals:
        return []
    every = factors * np.array(mapping.signals[name].factor)
    remedy = f"{every[0]:.3g}" if np.all(every == every[0]) else f"[{', '.join(f'{value:.3g}' for value in every)}]"
    what = "; ".join(f"of joint {joint + 1} {text}" for joint, text in doubts.items())
    why = "wrong sign, unit or joint" + (", or a load that the mapping lacks" if name == "torque" else "")
    return [f"{name} {what}: {why}? Remedy in the mapping: signals.{name}.factor: {remedy}"]


def _ratio(values: Array, expected: Array) -> float | None:
    """By how much a signal differs from what it should be; None: about 1, or they do not go together."""
    ratio = float(values @ expected) / float(expected @ expected)
    return None if RATIO[0] < ratio < RATIO[1] or abs(_together(values, expected)) < TOGETHER else ratio


def _remedy(ratio: float) -> float:
    return -1.0 if RATIO[0] < -ratio < RATIO[1] else 1.0 / ratio


def _together(first: Array, second: Array) -> float:
    """Correlation about zero."""
    return float(first @ second) / max(float(np.linalg.norm(first) * np.linalg.norm(second)), 1e-300)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
