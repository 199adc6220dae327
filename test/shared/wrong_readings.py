# SPDX-License-Identifier: Apache-2.0
"""Recordings that are read wrongly: each fault as it would be made of right columns, without the library's readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from joint_recordings import Columns

SECOND = np.array([0.0, 1.0, 0.0])  # of three joints
LATE = 0.015  # s


@dataclass(frozen=True)
class Fault:
    """A fault of a reading.

    Attributes:
        effect: Effect of the library that it is.
        key: Its parameter that is off.
        value: True value of that.
        made: Right columns to wrong ones.
    """

    effect: str
    key: str
    value: float
    made: Callable[[Columns], Columns]

    @property
    def planted(self) -> dict[str, dict[str, float]]:
        """The effect with its value."""
        return {self.effect: {self.key: self.value}}


def filtered(time: np.ndarray, values: np.ndarray, *denominator: float) -> np.ndarray:
    """Output of a filter, coefficients of falling powers of s, at rest before the first sample, ``(k, n)``."""
    start = values[0]
    return np.column_stack(
        [
            first + scipy.signal.lsim(([1.0], denominator), own - first, time)[1]
            for first, own in zip(start, values.T, strict=True)
        ]
    )


def later(time: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """Values of ``delay`` before, ``(k, n)``."""
    return np.asarray(scipy.interpolate.make_interp_spline(time, values, k=5)(time - delay))


def _second_times(factor: float, *names: str) -> Callable[[Columns], Columns]:
    """Signals of the second joint multiplied by a factor."""
    return lambda c: c | {name: c[name] * (1.0 + (factor - 1.0) * SECOND) for name in names}


def _of_previous(share: float) -> Callable[[Columns], Columns]:
    """The torque sensor of the second joint reads a share of the torque of the first."""
    return lambda c: c | {"effort": c["effort"] + share * c["effort"][:, [0]] * SECOND}


OFFSET = Fault("encoder_offset", "offset_joint2", 0.01, lambda c: c | {"position": c["position"] + 0.01 * SECOND})
SCALE = Fault("encoder_scale", "scale_joint2", 1.02, _second_times(1.02, "position", "velocity"))
CROSSTALK = Fault("torque_sensor_crosstalk", "from_previous_joint2", 0.03, _of_previous(0.03))
TORQUE_LAG = Fault(
    "torque_sensor_lag", "lag", LATE, lambda c: c | {"effort": filtered(c["time"], c["effort"], LATE, 1.0)}
)
VELOCITY_LAG = Fault(
    "velocity_lag", "lag", LATE, lambda c: c | {"velocity": filtered(c["time"], c["velocity"], LATE, 1.0)}
)
BUTTERWORTH = 0.5 * LATE**2, LATE, 1.0
TORQUE_BUTTERWORTH = Fault(
    "torque_sensor_butterworth", "lag", LATE, lambda c: c | {"effort": filtered(c["time"], c["effort"], *BUTTERWORTH)}
)
VELOCITY_BUTTERWORTH = Fault(
    "velocity_butterworth", "lag", LATE, lambda c: c | {"velocity": filtered(c["time"], c["velocity"], *BUTTERWORTH)}
)
VELOCITY_DELAY = Fault(
    "velocity_delay", "delay", LATE, lambda c: c | {"velocity": later(c["time"], c["velocity"], LATE)}
)
VELOCITY_GAIN = Fault("velocity_gain", "gain_joint2", 1.03, _second_times(1.03, "velocity"))
FAULTS = (
    OFFSET,
    SCALE,
    CROSSTALK,
    TORQUE_LAG,
    TORQUE_BUTTERWORTH,
    VELOCITY_LAG,
    VELOCITY_BUTTERWORTH,
    VELOCITY_DELAY,
    VELOCITY_GAIN,
)
