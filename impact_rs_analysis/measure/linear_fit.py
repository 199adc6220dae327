# SPDX-License-Identifier: Apache-2.0
"""From net feedback to the experimental estimate (paper sec. Experimental results).

Per set of trials, with reference velocity x_i and net feedback y_i:

    y_i = a + b x_i + e_i,          estimate x0 = -a / b  (zero crossing)

The reference velocities are set by the experimenter, the feedback scatters: this is inverse regression, and x0 is a
ratio of two correlated estimates. Its confidence interval is Fieller's (1954), exact for normal e_i: all x for which
the hypothesis a + b x = 0 is not rejected,

    (a + b x)^2 <= t^2 s^2 (1/n + (x - x_mean)^2 / S_xx),

where t is the 97.5 % quantile of Student's t with n - 2 degrees of freedom. (The delta method, its limit for a steep
line, is too narrow for few trials.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from impact_rs_sim.numbers import CONFIDENCE_LEVEL
from impact_rs_sim.robots.robot import Array


class FitError(Exception):
    """The trials determine no estimate; the message names the missing data."""


@dataclass(frozen=True)
class LineFit:
    """Line through net feedback over reference velocity.

    Attributes:
        intercept: a [m/s].
        slope: b [-].
        estimate: Zero crossing -a/b: experimental estimate of the post-impact velocity [m/s].
        interval: 95 % interval of the estimate, low then high [m/s]; None if the data bound it on one side
            only, or on neither.
        r_squared: Share of the variance that the line explains [-].
        scatter: Standard deviation of the residuals [m/s].
        count: Trials.
    """

    intercept: float
    slope: float
    estimate: float
    interval: tuple[float, float] | None
    r_squared: float
    scatter: float
    count: int

    def at(self, velocity: Array) -> Array:
        """Net feedback of the line at reference velocities ``(k,)`` [m/s], ``(k,)`` [m/s]."""
        return self.intercept + self.slope * velocity


def fit_zero_crossing(velocity: Array, net: Array, confidence: float = CONFIDENCE_LEVEL) -> LineFit:
    """Fit the line and find its zero crossing with a Fieller interval.

    Args:
        velocity: Post-impact reference velocity of every trial, ``(n,)`` [m/s].
        net: Net feedback of every trial, ``(n,)`` [m/s].
        confidence: Coverage of the interval [-].

    Raises:
        FitError: Fewer than three trials, fewer than two reference velocities, or a level line.
    """
    velocity, net = np.asarray(velocity, dtype=float), np.asarray(net, dtype=float)
    count = velocity.size
    distinct = np.unique(np.round(velocity, 9)).size
    if count < 3 or distinct < 2:
        raise FitError(
            f"{count} trial{'s' * (count != 1)} with impact at {distinct} post-impact "
            f"velocit{'y' if distinct == 1 else 'ies'}; a line with an interval needs at least 3 trials at 2 velocities"
        )
    mean = float(np.mean(velocity))
    sum_xx = float(np.sum(np.square(velocity - mean)))
    slope = float((velocity - mean) @ net / sum_xx)
    mean_net = float(np.mean(net))
    intercept = mean_net - slope * mean
    residuals = net - intercept - slope * velocity
    sum_yy = float(np.sum(np.square(net - mean_net)))
    sum_of_squares = float(residuals @ residuals)
    # A slope within rounding errors would divide by zero.
    if abs(slope) * math.sqrt(sum_xx) <= 1e-12 * max(1.0, float(np.max(np.abs(net)))):
        raise FitError("the net feedback does not depend on the post-impact velocity: there is no zero crossing")
    estimate = -intercept / slope
    scatter = math.sqrt(sum_of_squares / (count - 2))
    quantile = float(scipy.special.stdtrit(count - 2, 0.5 + confidence / 2.0))
    return LineFit(
        intercept=intercept,
        slope=slope,
        estimate=estimate,
        interval=_fieller(estimate, slope, mean, sum_xx, quantile * scatter, count),
        r_squared=1.0 - sum_of_squares / sum_yy,
        scatter=scatter,
        count=count,
    )


def _fieller(
    estimate: float, slope: float, mean: float, sum_xx: float, margin: float, count: int
) -> tuple[float, float] | None:
    """Fieller's interval, ``margin`` is t s [m/s]; None if the slope is not significant: the interval is unbounded."""
    g = margin * margin / (slope * slope * sum_xx)
    if g >= 1.0:
        return None
    distance = estimate - mean
    centre = mean + distance / (1.0 - g)
    half_width = margin / abs(slope) / (1.0 - g) * math.sqrt((1.0 - g) / count + distance * distance / sum_xx)
    return centre - half_width, centre + half_width
