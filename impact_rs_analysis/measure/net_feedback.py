# SPDX-License-Identifier: Apache-2.0
"""The measure: net feedback of one trial (paper eqs. fb_error, a_fb_net).

    a_fb,net = integral of a_fb(t) dt from t1 to t2

The controller holds its command between two ticks, so the recorded a_fb(t_k) acts from t_k to t_{k+1} (zero-order
hold), and its integral is a sum, without a quadrature error. It is taken along the measured axis and averaged over the
arms (paper sec. Dual-arm grabbing scenario).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_rs_analysis.measure.departure import Departure, departures
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.rotations import AXES
from impact_rs_trials.bags.reader import BagError, ControllerColumns, TrialBag
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.spec import recorded_scenario

TORQUE_LIMIT_TOLERANCE = 1e-3  # relative distance from the torque limit, below which a torque is limited
MIN_LIMITED_TIME_S = 0.005  # at a torque limit; shorter times change the feedback by less than its noise
# Outcomes that are analysed; a bag of a real robot may have none, and trials without impact are not fitted.
ANALYSED_OUTCOMES = ("OK", "NO-IMPACT", "EARLY")
MAX_GAP_S = 0.02  # the feedback in a longer gap exceeds the resolution of the measure


@dataclass(frozen=True)
class TrialFeedback:
    """One trial along the measured axis, mean over its arms.

    Attributes:
        path: Folder of the bag.
        info: Identity of the trial.
        impact_times: Detected impact time of every arm [s]; NaN where none was detected.
        time: Trial time of the samples, ``(k,)`` [s].
        velocity: Measured end-effector velocity, ``(k,)`` [m/s].
        feedback: a_fb, ``(k,)`` [m/s^2].
        integral: Integral of a_fb since t1, constant after t2, ``(k,)`` [m/s].
        ante_reference: Velocity of the ante-impact reference, ``(k,)`` [m/s].
        post_reference: Velocity of the post-impact reference, ``(k,)`` [m/s].
        net: a_fb,net [m/s].
        nets: a_fb,net of every arm [m/s].
        limited: Joints at their torque limit within the window, with the duration [s]; their feedback was not
            delivered, so the integral is not valid.
        departures: Separation of object and pads after the hit.
    """

    path: Path
    info: TrialInfo
    impact_times: tuple[float, ...]
    time: Array
    velocity: Array
    feedback: Array
    integral: Array
    ante_reference: Array
    post_reference: Array
    net: float
    nets: dict[str, float]
    limited: tuple[tuple[str, float], ...] = ()
    departures: tuple[Departure, ...] = ()

    @property
    def name(self) -> str:
        """Folder name of the bag."""
        return self.path.name

    @property
    def impact(self) -> bool:
        """Whether every arm hit within the window; a trial without impact does not enter a fit."""
        start, end = self.info.window_start, self.info.window_end
        return all(start <= moment <= end for moment in self.impact_times)

    @property
    def spread(self) -> float:
        """Time between the first and the last arm's impact [s]; NaN where an arm detected none."""
        return float(np.ptp(self.impact_times))


def zero_order_hold_integral(time: Array, signal: Array, start: float, end: float) -> tuple[Array, float]:
    """Integral of a signal under a zero-order hold: it keeps its value until the next sample (paper eq. a_fb_net).

    Args:
        time: Sample times, increasing, ``(k,)`` [s].
        signal: Samples, ``(k,)`` [m/s^2].
        start: t1 [s].
        end: t2 [s].

    Returns:
        The integral from ``start`` to every sample, 0 before ``start`` and constant after ``end``, ``(k,)`` [m/s]; and
        the integral from ``start`` to ``end`` [m/s].
    """
    edges = np.clip(np.append(time, max(end, time[-1])), start, end)
    increments = signal * np.diff(edges)
    cumulative = np.cumsum(increments)
    return np.concatenate(([0.0], cumulative[:-1])), float(cumulative[-1])


def net_feedback(bag: TrialBag) -> TrialFeedback:
    """Net feedback of one trial; ``/truth`` is not read.

    Raises:
        BagError: The trial failed, or the bag is damaged, has gaps, or does not cover the window from t1 to t2.
    """
    info = bag.info
    if bag.metadata.get("outcome", "OK") not in ANALYSED_OUTCOMES:
        raise BagError(bag.path, f"{bag.outcome}: {bag.reason}")
    if info.axis not in AXES or not info.robots:
        raise BagError(bag.path, f"its trial_info names axis {info.axis!r} and {len(info.robots)} robots")
    axis = AXES.index(info.axis)
    columns = {arm: bag.controller(arm) for arm in info.robots}
    time = next(iter(columns.values())).time
    signals: dict[str, list[Array]] = {name: [] for name in ("velocity", "feedback", "ante", "post")}
    for arm, controller in columns.items():
        _check_coverage(bag, arm, controller.time)
        for name, values in (
            ("velocity", controller.twist[:, axis]),
            ("feedback", controller.feedback_acceleration[:, axis]),
            ("ante", controller.ante_velocity[:, axis]),
            ("post", controller.post_velocity[:, axis]),
        ):
            if not np.all(np.isfinite(values)):
                raise BagError(bag.path, f"arm {arm!r}: the recorded {name} signal is not finite everywhere")
            signals[name].append(np.interp(time, controller.time, values))
    nets = {
        arm: zero_order_hold_integral(time, values, info.window_start, info.window_end)[1]
        for arm, values in zip(columns, signals["feedback"], strict=True)
    }
    mean_signals = {name: np.mean(values, axis=0) for name, values in signals.items()}
    integral, net = zero_order_hold_integral(time, mean_signals["feedback"], info.window_start, info.window_end)
    return TrialFeedback(
        path=bag.path,
        info=info,
        impact_times=tuple(bag.impact_time(arm) for arm in info.robots),
        time=time,
        velocity=mean_signals["velocity"],
        feedback=mean_signals["feedback"],
        integral=integral,
        ante_reference=mean_signals["ante"],
        post_reference=mean_signals["post"],
        net=net,
        nets=nets,
        limited=tuple(entry for arm, controller in columns.items() for entry in _limited(bag, arm, controller)),
        departures=departures(bag, columns),
    )


def _limited(bag: TrialBag, arm: str, controller: ControllerColumns) -> Iterator[tuple[str, float]]:
    """Joints of an arm at their torque limit within the window, with the duration [s]."""
    info = bag.info
    limit = np.array(recorded_scenario(info.scenario_json, bag.path).robots[arm].robot_facts.limits.torque_Nm)
    inside = (controller.time >= info.window_start) & (controller.time < info.window_end)
    at_limit = np.abs(controller.commanded_torque[inside]) >= (1.0 - TORQUE_LIMIT_TOLERANCE) * limit
    duration = at_limit.sum(axis=0) * float(np.median(np.diff(controller.time)))
    for joint in np.flatnonzero(duration > MIN_LIMITED_TIME_S):
        yield f"{arm} joint{joint + 1}", float(duration[joint])


def _check_coverage(bag: TrialBag, arm: str, time: Array) -> None:
    start, end = bag.info.window_start, bag.info.window_end
    if not (math.isfinite(start) and math.isfinite(end) and start < end):
        raise BagError(bag.path, f"its window from {start} s to {end} s is empty or not finite")
    if time.size < 2:
        raise BagError(bag.path, f"arm {arm!r} has {time.size} controller states")
    steps = np.diff(time)
    if np.any(steps <= 0.0):
        raise BagError(bag.path, f"arm {arm!r}: the stamps of the controller states do not increase")
    if time[0] > start or time[-1] + MAX_GAP_S < end:
        raise BagError(
            bag.path,
            f"arm {arm!r} is recorded from {time[0]:.3f} s to {time[-1]:.3f} s, "
            f"the window lasts from {start:.3f} s to {end:.3f} s",
        )
    inside = (time[1:] >= start) & (time[:-1] <= end)
    if np.max(steps[inside]) > MAX_GAP_S:
        worst = int(np.argmax(np.where(inside, steps, 0.0)))
        raise BagError(
            bag.path, f"arm {arm!r}: no controller state from {time[worst]:.3f} s to {time[worst + 1]:.3f} s"
        )
