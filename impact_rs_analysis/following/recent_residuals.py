# SPDX-License-Identifier: Apache-2.0
"""Exponentially weighted moving average (EWMA) of the residuals, which corrects the prediction of the next hit.

No model is quite right: a surface wears slowly, and a change may be attributed to a similar effect. The residuals are
then correlated from hit to hit. Their exponentially weighted mean,

    b <- b + g (r - b),

is the optimal predictor of a random walk in white noise, a steady-state Kalman filter (Muth 1960, *Journal of the
American Statistical Association* 55). r is the whitened residual of a hit of one group. The gain g is the member of
``EWMA_GAINS`` with the smallest recent prediction error; without drift it is 0: no correction. The posterior and the
change-point test do not use the correction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from impact_rs_sim.robots.robot import Array

EWMA_GAINS = np.array([0.0, 0.1, 0.2, 0.4])  # candidate gains g [-]; 0: no correction
FORGETTING_FACTOR = 0.97  # of the squared errors per hit: the last thirty choose the gain
MIN_LEAD = 0.5  # in mean squares, of a gain over no correction


class RecentResiduals:
    """Means of recent residuals of one hypothesis, by group of hits."""

    def __init__(self) -> None:
        self._means: dict[str, Array] = {}  # by group: b for each gain, (G, F)
        self._squares = np.zeros(EWMA_GAINS.size)  # weighted sum of squared errors for each gain, (G,)

    def expected(self, group: str, size: int) -> Array:
        """Predicted residual of the next hit of a group, ``(size,)``, whitened [-].

        Args:
            group: The group.
            size: Number of features.
        """
        means = self._means.get(group)
        return np.zeros(size) if means is None else np.asarray(means[self._best_gain])

    def update(self, group: str, residual: Array, weight: float) -> None:
        """Update with the residual of a hit.

        Args:
            group: Its group.
            residual: Whitened, ``(F,)`` [-].
            weight: Weight of the hit [-]; below 1 for an odd hit.
        """
        means = self._means.setdefault(group, np.zeros((EWMA_GAINS.size, residual.size)))
        errors = residual - means
        self._squares = FORGETTING_FACTOR * self._squares + weight * np.mean(np.square(errors), axis=1)
        means += weight * EWMA_GAINS[:, None] * errors

    @property
    def _best_gain(self) -> int:
        """Gain with the smallest recent error, if it leads over no correction."""
        return int(np.argmin(self._squares + MIN_LEAD * (EWMA_GAINS > 0.0)))

    def saved(self) -> dict[str, Any]:
        """State as a JSON document."""
        means = {group: values.tolist() for group, values in self._means.items()}
        return {"squares": self._squares.tolist(), "means": means}

    @classmethod
    def restored(cls, document: Mapping[str, Any]) -> Self:
        """Residuals from the document of :meth:`saved`."""
        residuals = cls()
        residuals._squares = np.array(document["squares"])
        residuals._means = {group: np.array(values) for group, values in document["means"].items()}
        return residuals
