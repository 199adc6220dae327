# SPDX-License-Identifier: Apache-2.0
"""The highest approach speed at which all bounds of a robot hold in at least 99 % of the draws.

With y_kd(v) the quantity k of the draw d at the closing speed v and b_k its bound, it is the largest v with

    Q_0.99 over d of  max_k y_kd(v) / b_k  <=  1,

and of a kind of quantities alone the same with the maximum over those. Between the speeds that were simulated y is
interpolated linearly, and beyond the last one extrapolated: hits are nearly proportional to their speed. Each of these
searches ends where the speed differs by less than 1 % from one that was simulated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_rs_analysis.limits.drawn_hits import Hits
from impact_rs_analysis.limits.hit_bounds import KINDS
from impact_rs_sim.errors import Infeasible
from impact_rs_sim.robots.robot import Array

HOLD_PROBABILITY = 0.99  # share of the draws in which all bounds hold
SPEED_TOLERANCE = 0.01  # relative change of the speed that ends the search
MAX_SIMULATED_SPEEDS = 5  # speeds that one search simulates at most
MIN_STABLE_SHARE = 0.9  # of the draws
MAX_SPEED_M_S = 10.0  # of the fastest industrial robots (ABB IRB 360); bounds beyond do not matter


@dataclass(frozen=True)
class SpeedLimit:
    """Speed limit of an arm in one scene.

    Attributes:
        object_name: Object.
        case_name: Case.
        planned: Closing speed of the scenario [m/s].
        speed: Highest closing speed at which all bounds hold with ``HOLD_PROBABILITY`` [m/s]; 0: not even at rest.
        middle: Highest speed at which they hold in half of the draws [m/s].
        by_kind: The same as ``speed`` for each kind of quantities alone [m/s]; inf: beyond every speed of interest.
        binding: Quantity that is nearest to its bound there.
        unknown: Kinds without any bound.
        draws: Draws that are stable.
    """

    object_name: str
    case_name: str
    planned: float
    speed: float
    middle: float
    by_kind: Mapping[str, float]
    binding: str
    unknown: tuple[str, ...]
    draws: int

    @property
    def allowed(self) -> bool:
        """Whether the speed of the scenario is allowed."""
        return self.planned <= self.speed

    def to_json(self) -> dict[str, object]:
        """As JSON; speeds beyond every interest are null."""
        return {
            "object": self.object_name,
            "case": self.case_name,
            "planned_m_s": self.planned,
            "limit_m_s": _finite(self.speed),
            "half_m_s": _finite(self.middle),
            "by_kind_m_s": {kind: _finite(speed) for kind, speed in self.by_kind.items()},
            "binding": self.binding,
            "allowed": self.allowed,
            "without_bound": list(self.unknown),
            "draws": self.draws,
            "level": HOLD_PROBABILITY,
        }


def speed_limit(hits: Hits) -> SpeedLimit:
    """The highest approach speed of a scene.

    Raises:
        Infeasible: Too many draws are unstable at the period of the torque loop.
    """
    curve = _Curve(hits)
    curve.add(1.0)
    kinds = np.array(hits.bounds.kinds)
    everything = np.arange(kinds.size)
    of_kind = {kind: np.flatnonzero(kinds == kind) for kind in KINDS if kind not in hits.bounds.unknown}
    curve.settle(everything, HOLD_PROBABILITY)
    curve.settle(everything, 0.5)
    for which in sorted(of_kind.values(), key=lambda which: curve.limit(which, HOLD_PROBABILITY)):
        curve.settle(which, HOLD_PROBABILITY)
    found = curve.limit(everything, HOLD_PROBABILITY)
    scene = hits.scene

    def speed(scale: float) -> float:
        return float("inf") if scale >= curve.highest else scale * hits.speed

    return SpeedLimit(
        object_name=scene.object_name,
        case_name=scene.case_name,
        planned=hits.speed,
        speed=speed(found),
        middle=speed(curve.limit(everything, 0.5)),
        by_kind={kind: speed(curve.limit(which, HOLD_PROBABILITY)) for kind, which in of_kind.items()},
        binding=hits.bounds.names[curve.worst(found)],
        unknown=hits.bounds.unknown,
        draws=curve.draws,
    )


class _Curve:
    """Quantities over their bounds at some speeds, and between them.

    Attributes:
        highest: Scale of the highest speed of interest [-].
    """

    def __init__(self, hits: Hits) -> None:
        self._hits = hits
        self._known = {0.0: hits.rest}
        self.highest = MAX_SPEED_M_S / hits.speed

    def add(self, scale: float) -> None:
        """Simulate one more speed."""
        self._known[scale] = self._hits.ratios(scale)
        self._usable = np.all([np.isfinite(rows).all(axis=1) for rows in self._known.values()], axis=0)
        if self.draws < MIN_STABLE_SHARE * self._usable.size:
            raise Infeasible(
                f"only {self.draws} of {self._usable.size} draws of the hit are stable; expected more damping in joints"
                " or pads, or a shorter timing.drive_period (impact-rs robot check says which)"
            )

    def settle(self, which: NDArray[np.intp], level: float) -> None:
        """Simulate the limit of some quantities, until it hardly differs from a simulated speed."""
        for _ in range(MAX_SIMULATED_SPEEDS):
            found = self.limit(which, level)
            if any(abs(found - scale) <= SPEED_TOLERANCE * found for scale in self._known):
                return
            self.add(found)

    @property
    def draws(self) -> int:
        """Draws that are stable at every speed."""
        return int(self._usable.sum())

    def at(self, scale: float) -> Array:
        """Quantities over their bounds, ``(draws, k)``."""
        scales = sorted(self._known)
        place = int(np.clip(np.searchsorted(scales, scale), 1, len(scales) - 1))
        low, high = scales[place - 1], scales[place]
        share = (scale - low) / (high - low)
        return np.asarray(((1.0 - share) * self._known[low] + share * self._known[high])[self._usable])

    def quantile(self, scale: float, which: NDArray[np.intp], level: float) -> float:
        """Quantile over the draws of the largest of some ratios."""
        return float(np.quantile(self.at(scale)[:, which].max(axis=1), level, method="higher"))

    def limit(self, which: NDArray[np.intp], level: float) -> float:
        """Largest scale at which the quantile is at most 1, by bisection; 0: not even at rest; ``highest``: beyond."""
        if self.quantile(0.0, which, level) > 1.0:
            return 0.0
        if self.quantile(self.highest, which, level) <= 1.0:
            return self.highest
        low, high = 0.0, self.highest
        while high - low > 1e-4 * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.quantile(middle, which, level) <= 1.0 else (low, middle)
        return low

    def worst(self, scale: float) -> int:
        """Number of the quantity whose quantile is largest."""
        return int(np.argmax(np.quantile(self.at(min(scale, self.highest)), HOLD_PROBABILITY, axis=0)))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
