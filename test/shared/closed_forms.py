# SPDX-License-Identifier: Apache-2.0
"""Closed forms that more than one test holds simulators against."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq


def restitution_of(ratio: float) -> float:
    """Restitution of a mass on a spring and damper that push only (Schwager and Poeschel 2007, eq. 18).

    Args:
        ratio: Damping over critical damping [-].
    """
    if ratio < 1.0:
        damped = np.sqrt(1.0 - ratio**2)  # over the undamped frequency, as all rates here
        return float(np.exp(-ratio / damped * np.arctan2(2.0 * ratio * damped, ratio**2 - damped**2)))
    creeping = np.sqrt(ratio**2 - 1.0)
    return float(np.exp(-ratio / creeping * np.log((ratio + creeping) / (ratio - creeping))))


def restitution_of_hunt_and_crossley(speed: float) -> float:
    """Restitution e of a contact f = k d^n (1 + a dd/dt), for any mass, k and n (Hunt and Crossley 1975).

    With v the rate of the penetration, m v dv / (1 + a v) = -k d^n dd; from contact to deepest point and back,
    a v_0 (1 + e) = log((1 + a v_0) / (1 - a e v_0)), which is e = 1 - 2 a v_0 / 3 where a v_0 is small.

    Args:
        speed: a v_0 [-].
    """
    return float(
        brentq(
            lambda e: np.log((1.0 + speed) / (1.0 - e * speed)) - speed * (1.0 + e),
            1e-9,
            min(1.0, (1.0 - 1e-12) / speed),
        )
    )
