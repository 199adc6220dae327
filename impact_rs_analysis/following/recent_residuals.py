# SPDX-License-Identifier: Apache-2.0
"""What the last hits leave, for the prediction of the next one.

No model is quite right: a surface wears slowly, and a change may be followed under the name of a similar one. What is
left then is alike from hit to hit. Its exponentially weighted mean,

    b <- b + g (r - b),

is the best prediction of a random walk that is seen through noise (Muth 1960, *Journal of the American Statistical
Association* 55). r are the whitened residuals of one group of hits. The gain g is the one of ``GAINS`` that predicted
the last hits best; without drift that is 0, and nothing is corrected. Posterior and test for changes do not know of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from impact_rs_sim.robot import Array

GAINS = np.array([0.0, 0.1, 0.2, 0.4])
MEMORY = 0.97  # share of the squared errors that stays with every hit: the last thirty choose the gain
LEAD = 0.5  # mean squares by which a gain must have done better than none


class RecentResiduals:
    """Means of recent residuals of one hypothesis, by group of hits."""

    def __init__(self) -> None:
        self._means: dict[str, Array] = {}  # (G, F), of each gain
        self._squares = np.zeros(GAINS.size)  # of the errors of each gain

    def expected(self, group: str, size: int) -> Array:
        """What the next hit of a group will leave, ``(size,)``, whitened [-].

        Args:
            group: The group.
            size: Number of features.
        """
        known = self._means.get(group)
        return np.zeros(size) if known is None else np.asarray(known[self._best])

    def take(self, group: str, residual: Array, weight: float) -> None:
        """Take what a hit left.

        Args:
            group: Its group.
            residual: Whitened, ``(F,)`` [-].
            weight: Of the hit [-]; an odd one moves nothing far.
        """
        means = self._means.setdefault(group, np.zeros((GAINS.size, residual.size)))
        off = residual - means
        self._squares = MEMORY * self._squares + weight * np.mean(np.square(off), axis=1)
        means += weight * GAINS[:, None] * off

    @property
    def _best(self) -> int:
        """The gain that did best, with a lead over none."""
        return int(np.argmin(self._squares + LEAD * (GAINS > 0.0)))

    def saved(self) -> dict[str, Any]:
        """State as a JSON document."""
        return {"squares": self._squares.tolist(), "means": {name: own.tolist() for name, own in self._means.items()}}

    @classmethod
    def restored(cls, document: Mapping[str, Any]) -> Self:
        """As they were when :meth:`saved` was called."""
        found = cls()
        found._squares = np.array(document["squares"])
        found._means = {name: np.array(own) for name, own in document["means"].items()}
        return found
