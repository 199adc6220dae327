# SPDX-License-Identifier: Apache-2.0
"""The highest approach speed at which all bounds of a robot hold in at least 99 % of the draws.

Let y_kd(v) be the quantity k in the draw d at the closing speed v [m/s], and b_k its bound. The limit is the largest v
with

    Q_0.99 over d of  max_k y_kd(v) / b_k  <=  1,

For one kind of quantities, the maximum is over that kind. y is interpolated linearly between the simulated speeds and
extrapolated beyond the last one: loads are nearly proportional to the speed of a hit. A search ends when the limit
differs by less than 1 % from a simulated speed.
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
        median: Highest closing speed at which all bounds hold in half of the draws [m/s].
        by_kind: Highest closing speed for the bounds of one kind alone [m/s]; inf: above ``MAX_SPEED_M_S``.
        binding: Quantity that is nearest to its bound at the limit.
        unknown: Kinds without any bound.
        draws: Number of stable draws.
    """

    object_name: str
    case_name: str
    planned: float
    speed: float
    median: float
    by_kind: Mapping[str, float]
    binding: str
    unknown: tuple[str, ...]
    draws: int

    @property
    def allowed(self) -> bool:
        """Whether the speed of the scenario is allowed."""
        return self.planned <= self.speed

    def to_json(self) -> dict[str, object]:
        """As JSON; speeds above ``MAX_SPEED_M_S`` are null."""
        return {
            "object": self.object_name,
            "case": self.case_name,
            "planned_m_s": self.planned,
            "limit_m_s": _finite(self.speed),
            "half_m_s": _finite(self.median),
            "by_kind_m_s": {kind: _finite(speed) for kind, speed in self.by_kind.items()},
            "binding": self.binding,
            "allowed": self.allowed,
            "without_bound": list(self.unknown),
            "draws": self.draws,
            "level": HOLD_PROBABILITY,
        }


def speed_words(speed: float) -> str:
    """A limit in a sentence."""
    return f"{speed:.3f} m/s" if np.isfinite(speed) else f"more than {MAX_SPEED_M_S:g} m/s"


def speed_limit(hits: Hits) -> SpeedLimit:
    """The highest approach speed of a scene.

    Raises:
        Infeasible: Too many draws are unstable at the period of the torque loop.
    """
    curve = _Curve(hits)
    curve.add(1.0)
    kinds = np.array(hits.bounds.kinds)
    all_columns = np.arange(kinds.size)
    columns_of_kind = {kind: np.flatnonzero(kinds == kind) for kind in KINDS if kind not in hits.bounds.unknown}
    curve.settle(all_columns, HOLD_PROBABILITY)
    curve.settle(all_columns, 0.5)
    for columns in sorted(columns_of_kind.values(), key=lambda columns: curve.limit(columns, HOLD_PROBABILITY)):
        curve.settle(columns, HOLD_PROBABILITY)
    scale_limit = curve.limit(all_columns, HOLD_PROBABILITY)
    scene = hits.scene

    def speed(scale: float) -> float:
        return float("inf") if scale >= curve.highest else scale * hits.speed

    return SpeedLimit(
        object_name=scene.object_name,
        case_name=scene.case_name,
        planned=hits.speed,
        speed=speed(scale_limit),
        median=speed(curve.limit(all_columns, 0.5)),
        by_kind={kind: speed(curve.limit(columns, HOLD_PROBABILITY)) for kind, columns in columns_of_kind.items()},
        binding=hits.bounds.names[curve.worst(scale_limit)],
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
        self._ratios = {0.0: hits.ratios_at_rest}
        self.highest = MAX_SPEED_M_S / hits.speed

    def add(self, scale: float) -> None:
        """Simulate one more speed."""
        self._ratios[scale] = self._hits.ratios(scale)
        self._stable = np.all([np.isfinite(rows).all(axis=1) for rows in self._ratios.values()], axis=0)
        if self.draws < MIN_STABLE_SHARE * self._stable.size:
            raise Infeasible(
                f"only {self.draws} of {self._stable.size} draws of the hit are stable; expected more damping in joints"
                " or pads, or a shorter timing.drive_period (impact-rs robot check says which)"
            )

    def settle(self, columns: NDArray[np.intp], level: float) -> None:
        """Simulate hits at the limit of some quantities until it hardly differs from a simulated speed."""
        for _ in range(MAX_SIMULATED_SPEEDS):
            limit = self.limit(columns, level)
            if any(abs(limit - scale) <= SPEED_TOLERANCE * limit for scale in self._ratios):
                return
            self.add(limit)

    @property
    def draws(self) -> int:
        """Number of draws that are stable at every simulated speed."""
        return int(self._stable.sum())

    def at(self, scale: float) -> Array:
        """Quantities over their bounds, ``(draws, k)``."""
        scales = sorted(self._ratios)
        upper = int(np.clip(np.searchsorted(scales, scale), 1, len(scales) - 1))
        low, high = scales[upper - 1], scales[upper]
        share = (scale - low) / (high - low)
        return np.asarray(((1.0 - share) * self._ratios[low] + share * self._ratios[high])[self._stable])

    def quantile(self, scale: float, columns: NDArray[np.intp], level: float) -> float:
        """Quantile over the draws of the largest ratio in some columns [-]."""
        return float(np.quantile(self.at(scale)[:, columns].max(axis=1), level, method="higher"))

    def limit(self, columns: NDArray[np.intp], level: float) -> float:
        """Largest scale at which the quantile is at most 1, by bisection; 0: not even at rest; ``highest``: beyond."""
        if self.quantile(0.0, columns, level) > 1.0:
            return 0.0
        if self.quantile(self.highest, columns, level) <= 1.0:
            return self.highest
        low, high = 0.0, self.highest
        while high - low > 1e-4 * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.quantile(middle, columns, level) <= 1.0 else (low, middle)
        return low

    def worst(self, scale: float) -> int:
        """Index of the quantity with the largest quantile."""
        return int(np.argmax(np.quantile(self.at(min(scale, self.highest)), HOLD_PROBABILITY, axis=0)))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
