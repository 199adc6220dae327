"""Model discrepancy: how far equally valid simulations of the same parameters differ.

Nobody's simulator is exactly right. Contact settings, the regularisation of friction, the step and the physics engine are
choices that no measurement made; what changes with them cannot be blamed on the robot. ``config/discrepancy.yaml`` holds
what was measured, per phase, signal and index, with its provenance.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot import Array
from impact_rs_sim.schema import Schema, load


class DiscrepancyEntry(Schema):
    """Discrepancy of one signal."""

    hit: bool = Field(description="whether it is of trials in which something is hit")
    phase: str = Field(description="free, impact or push")
    signal: str = Field(description="what it is")
    index: str = Field(description="joint (joint1 ...) or axis (x, y, z)")
    value: float = Field(ge=0.0, description="root mean square difference between the simulations, in the unit")
    unit: str = Field(description="unit of the signal")
    variants: dict[str, float] = Field({}, description="the same by variant of the simulation")


class Discrepancy(Schema):
    """``config/discrepancy.yaml``."""

    provenance: str = Field(description="what was run, when, with which versions, and the command")
    variants: dict[str, str] = Field(description="variants of the simulation, a sentence each")
    entries: tuple[DiscrepancyEntry, ...] = Field(description="discrepancy of every signal")

    def of(self, features: Sequence[Feature], hit: bool) -> Array:
        """Discrepancy of features in their units, ``(F,)``; 0 where none was measured.

        Args:
            features: What they are; of two arms both have the discrepancy of one.
            hit: Whether something is hit in their trials.
        """
        known = {(e.phase, e.signal, e.index): e.value for e in self.entries if e.hit == hit}
        return np.array([known.get((f.phase, f.signal, f.index.rsplit(".", 1)[-1]), 0.0) for f in features])


NO_DISCREPANCY = Discrepancy(provenance="switched off", variants={}, entries=())


@functools.cache
def measured_discrepancy() -> Discrepancy:
    """The shipped one.

    Raises:
        InputError: ``config/discrepancy.yaml`` breaks the schema.
    """
    return load(Discrepancy, config_directory() / "discrepancy.yaml")
