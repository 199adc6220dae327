# SPDX-License-Identifier: Apache-2.0
"""Closed forms that more than one test holds simulators against."""

from __future__ import annotations

import numpy as np


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
