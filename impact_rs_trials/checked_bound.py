# SPDX-License-Identifier: Apache-2.0
"""A measured value and its bound: one line of a rehearsal's checklist."""

from __future__ import annotations

from dataclasses import asdict, dataclass

BOUND_ROUNDING_SHARE = 1e-6


@dataclass(frozen=True)
class CheckedBound:
    """One line of the checklist.

    Attributes:
        name: Name of the measured quantity.
        value: Largest measured value; for ``at_least`` the smallest.
        bound: Its bound.
        unit: Unit of value and bound.
        where: Joint, time or remark.
        at_least: Whether the bound is a lower one.
    """

    name: str
    value: float
    bound: float
    unit: str
    where: str
    at_least: bool = False

    @property
    def margin(self) -> float:
        """Margin of the value to the bound, in the unit; negative: beyond. Rounding errors are ignored."""
        margin = self.value - self.bound if self.at_least else self.bound - self.value
        return 0.0 if abs(margin) <= BOUND_ROUNDING_SHARE * abs(self.bound) else margin

    @property
    def holds(self) -> bool:
        """Whether the value is within its bound."""
        return self.margin >= 0.0

    @property
    def share(self) -> float | None:
        """Value over bound [-]; None: a lower bound, or 0."""
        return None if self.at_least or self.bound == 0.0 else self.value / self.bound

    def to_json(self) -> dict[str, object]:
        """As JSON."""
        return asdict(self) | {"margin": self.margin}
