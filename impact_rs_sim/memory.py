# SPDX-License-Identifier: Apache-2.0
"""Memory of formulas: the first-order lag z of a quantity u with a time constant T,

    T dz/dt = u - z.

From one evaluation to the next u counts as linear in time, for which the step is exact at any length h (T held):

    z_1 = u_1 - (u_1 - u_0) (1 - exp(-r)) / r + (z_0 - u_0) exp(-r),    r = h / T

so that z lags by T whatever the sampling, is u for T = 0, and stays where it was for an infinite T. The first
evaluation has z = u: what was before is taken for steady. ``src/twin_formula.cpp`` takes the same step.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Any

import numpy as np

from impact_rs_sim.robot import Array


class Memory:
    """What the lags of one simulation remember; a new one knows nothing, as at the start of a trial."""

    def __init__(self) -> None:
        self._known: dict[object, tuple[float, float, float]] = {}
        self._parts: dict[object, Memory] = {}

    def part(self, owner: object) -> Memory:
        """The memory of one of several owners: of an arm, or of an effect."""
        return self._parts.setdefault(owner, Memory())

    def lag(self, key: object, time: float, value: float, constant: float) -> float:
        """A lag after a step to ``time`` [s]; asked again at the same time, what it was.

        Args:
            key: Which one.
            time: Now [s].
            value: u now.
            constant: T [s].
        """
        before, last, lagged = self._known.get(key, (time, value, value))
        if time > before:
            kept, passed = _step(np.float64(time - before), np.float64(constant))
            lagged = float(value - (value - last) * passed + (lagged - last) * kept)
        if time > before or key not in self._known:
            self._known[key] = (time, value, lagged)
        return lagged


def lag_along(time: Array, value: Any, constant: Any) -> Array:
    """A lag over samples in the order of time, ``(k,)``.

    Args:
        time: When they are, ``(k,)`` [s].
        value: u, a number or ``(k,)``.
        constant: T, a number or ``(k,)`` [s].
    """
    u = np.broadcast_to(np.asarray(value, dtype=float), time.shape)
    kept, passed = _step(np.diff(time), np.broadcast_to(np.asarray(constant, dtype=float), time.shape)[1:])
    added = u[1:] - np.diff(u) * passed - u[:-1] * kept
    steps = zip(kept.tolist(), added.tolist(), strict=True)
    return np.array(list(accumulate(steps, lambda z, step: step[0] * z + step[1], initial=float(u[0]))))


def _step(length: Any, constant: Any) -> tuple[Any, Any]:
    """exp(-r) and (1 - exp(-r)) / r of steps with these time constants; 0 and 0 where these are not positive."""
    with np.errstate(all="ignore"):
        ratio = np.where(constant <= 0.0, np.inf, length / constant)
        passed = np.where(ratio > 0.0, -np.expm1(-ratio) / ratio, 1.0)
    return np.exp(-ratio), passed
