# SPDX-License-Identifier: Apache-2.0
"""Discrepancy of the rigid impact map, for tables of impacts of arms.

The map is instantaneous; impacts with elastic drives and compliant pads are not, and joints ring after a real impact.
``config/map_discrepancy.yaml`` holds the difference between simulators of such arms and the map with the same
parameters (made by ``tools/map_discrepancy.py``), as shares of the closing speed v_n:

    joints  share v_n / l,        centre of the object  share v_n,        its rotation  share v_n / r

with the reach l of the arm and the radius of gyration r of the object. These dimensionless shares apply to other robots
as well.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_analysis.evidence.discrepancy import DiscrepancyDocument, Provenance
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import gyration_of, reach_of
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.schema import Schema, load

HitKind = Literal["square", "oblique"]

JOINT_VELOCITY_AFTER, VELOCITY_AFTER, ANGULAR_VELOCITY_AFTER = (
    "joint velocity after",
    "velocity after",
    "angular velocity after",
)
MAP_DISCREPANCY_FILE = "map_discrepancy.yaml"


class MapShare(Schema):
    """Discrepancy of one kind of signals."""

    kind: HitKind = Field(description="square: face on face, along the normal; oblique: any other hit")
    signal: str = Field(description="name of the signal")
    share: float = Field(ge=0.0, description="difference over the closing speed, 5 to 15 ms after [-]")
    by_window: dict[str, float] = Field({}, description="of the simulator that lies furthest off, by window [-]")
    by_simulator: dict[str, float] = Field({}, description="of every simulator, 5 to 15 ms after [-]")


class MapDiscrepancy(Schema):
    """``config/map_discrepancy.yaml``."""

    provenance: Provenance | None = Field(description="how it was measured; null: switched off")
    entries: tuple[MapShare, ...] = Field(description="shares of the closing speed")

    def of(self, features: Sequence[Feature], physics: Physics, speed: float, kind: HitKind) -> Array:
        """Discrepancy of the velocities after an impact in their units, ``(F,)``.

        Args:
            features: The features.
            physics: Arms and object.
            speed: Closing speed [m/s].
            kind: Kind of the hit.
        """
        shares = {entry.signal: entry.share for entry in self.entries if entry.kind == kind}
        return np.array([shares.get(f.signal, 0.0) * speed for f in features]) / lengths_of(features, physics)

    @property
    def document(self) -> DiscrepancyDocument:
        """Its entry in a document."""
        return DiscrepancyDocument(used=bool(self.entries), provenance=self.in_words)

    @property
    def in_words(self) -> str:
        """Provenance in words."""
        if self.provenance is None:
            return "switched off"
        count, simulators = len(self.provenance.conditions), ", ".join(self.entries[0].by_simulator)
        return f"the rigid map against {simulators} in {count} pushes, {self.provenance.date}"


NO_MAP_DISCREPANCY = MapDiscrepancy(provenance=None, entries=())


@functools.cache
def measured_map_discrepancy() -> MapDiscrepancy:
    """The shipped discrepancy of the rigid map.

    Raises:
        InputError: ``config/map_discrepancy.yaml`` breaks the schema.
    """
    return load(MapDiscrepancy, config_directory() / MAP_DISCREPANCY_FILE)


def lengths_of(features: Sequence[Feature], physics: Physics) -> Array:
    """Lever of every velocity [m]: reach of the arm, radius of gyration, or 1 for translations, ``(F,)``."""
    turning = gyration_of(physics.object)
    reach = {name: reach_of(arm.facts) for name, arm in physics.arms.items()}
    return np.array(
        [1.0 if f.unit == "m/s" else turning if f.signal == ANGULAR_VELOCITY_AFTER else reach[f.arm] for f in features]
    )
