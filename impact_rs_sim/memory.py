# SPDX-License-Identifier: Apache-2.0
"""First-order lags (low-pass filters) of formulas.

A lag z of a quantity u with a time constant T obeys

    T dz/dt = u - z.

Between evaluations u is linear in time (first-order hold) and 1/T takes its mean. For a constant T the step is exact
for any h:

    z_1 = u_1 - (u_1 - u_0) (1 - exp(-r)) / r + (z_0 - u_0) exp(-r),    r = h (1/T_0 + 1/T_1) / 2

so that z lags by T at any sampling, equals u for T = 0, and is constant for an infinite T. At the first evaluation
z = u (steady state before the start), or a given initial value. ``src/twin_formula.cpp`` takes the same step.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Any

import numpy as np

from impact_rs_sim.robots.robot import Array


class Memory:
    """State of the lags of one simulation; a new one is empty, as at the start of a trial."""

    def __init__(self) -> None:
        self._known: dict[object, tuple[float, float, float, float]] = {}
        self._parts: dict[object, Memory] = {}

    def part(self, owner: object) -> Memory:
        """Separate state of one owner, an arm or an effect."""
        return self._parts.setdefault(owner, Memory())

    def lag(self, key: object, time: float, value: float, constant: float, start: float | None = None) -> float:
        """Output of a lag after a step to ``time`` [s]; a repeated call at the same time returns the same value.

        Args:
            key: Identifies the lag.
            time: Present time [s].
            value: Present u.
            constant: Present T [s].
            start: z at the first evaluation; None: u.
        """
        rate = float(_rate(constant))
        last_time, last_value, last_rate, lagged = self._known.get(
            key, (time, value, rate, value if start is None else start)
        )
        if time > last_time:
            decay, mean_decay = _step((time - last_time) * (last_rate + rate) / 2.0)
            lagged = float(value - (value - last_value) * mean_decay + (lagged - last_value) * decay)
        if time > last_time or key not in self._known:
            self._known[key] = (time, value, rate, lagged)
        return lagged


def lag_along(time: Array, value: Any, constant: Any, start: Any = None) -> Array:
    """Output of a lag along increasing times, ``(k,)``.

    Args:
        time: Times, ``(k,)`` [s].
        value: u, a number or ``(k,)``.
        constant: T, a number or ``(k,)`` [s].
        start: z at the first sample, a number or the first of ``(k,)``; None: u.
    """
    u = np.broadcast_to(np.asarray(value, dtype=float), time.shape)
    rate = np.broadcast_to(_rate(constant), time.shape)
    decay, mean_decay = _step(np.diff(time) * (rate[1:] + rate[:-1]) / 2.0)
    inputs = u[1:] - np.diff(u) * mean_decay - u[:-1] * decay
    steps = zip(decay.tolist(), inputs.tolist(), strict=True)
    first = float(u[0] if start is None else np.broadcast_to(start, time.shape)[0])
    return np.array(list(accumulate(steps, lambda z, step: step[0] * z + step[1], initial=first)))


def _rate(constant: Any) -> Any:
    """1/T; infinite where T is not positive."""
    with np.errstate(all="ignore"):
        return np.where(np.asarray(constant) <= 0.0, np.inf, 1.0 / np.asarray(constant, dtype=float))


def _step(ratio: Any) -> tuple[Any, Any]:
    """exp(-r) and (1 - exp(-r)) / r."""
    with np.errstate(all="ignore"):
        return np.exp(-ratio), np.where(ratio > 0.0, -np.expm1(-ratio) / ratio, 1.0)
