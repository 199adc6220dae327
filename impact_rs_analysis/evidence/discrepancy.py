"""Model discrepancy: how far equally valid simulations of the same parameters differ.

Nobody's simulator is exactly right. Contact settings, the regularisation of friction, the step and the physics engine
are choices that no measurement made; what changes with them cannot be blamed on the robot. ``config/discrepancy.yaml``
holds what was measured, per phase, signal and index, with its provenance (``benchmarks/foreign/discrepancy.py`` makes
it). It points the same way in all conditions and not in all time bins, so every feature has an amplitude of its own
that all clusters of a layout share.
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
    unit: str = Field(description="unit of the signal")
    value: float = Field(ge=0.0, description="rms of variant minus twin over conditions and time bins, in the unit")
    largest: str = Field("", description="variant that lies furthest off, of which value and by_bin are")
    by_bin: tuple[float, ...] = Field((), description="the same, bin by bin")
    by_variant: dict[str, float] = Field({}, description="rms of every variant")
    shared_over_conditions: float | None = Field(None, description="share of the square common to all conditions [-]")
    shared_over_bins: float | None = Field(None, description="share of the square common to all bins [-]")

    def of_bin(self, number: int) -> float:
        """Discrepancy of one time bin, in the unit: half the signal's, half the bin's, which few trials define."""
        own = self.by_bin[number] if number < len(self.by_bin) else self.value
        return float(np.sqrt(0.5 * (self.value**2 + own**2)))


class Provenance(Schema):
    """How the discrepancy was measured."""

    date: str = Field(description="day")
    command: str = Field(description="command")
    revision: str = Field("", description="revision of the sources")
    versions: dict[str, str] = Field({}, description="versions of the packages")
    seconds: float = Field(0.0, description="how long it took [s]")
    conditions: tuple[str, ...] = Field((), description="what was run")
    combined: str = Field("", description="how variants were put together")


class Discrepancy(Schema):
    """``config/discrepancy.yaml``."""

    provenance: Provenance | None = Field(description="how it was measured; null: switched off")
    variants: dict[str, str] = Field(description="variants of the simulation, a sentence each")
    entries: tuple[DiscrepancyEntry, ...] = Field(description="discrepancy of every signal")

    def of(self, features: Sequence[Feature], hit: bool) -> Array:
        """Discrepancy of features in their units, ``(F,)``; 0 where none was measured.

        Args:
            features: What they are; of two arms both have the discrepancy of one.
            hit: Whether something is hit in their trials.
        """
        known = {(e.phase, e.signal, e.index): e for e in self.entries if e.hit == hit}
        found = []
        for feature in features:
            entry = known.get((feature.phase, feature.signal, feature.index.rsplit(".", 1)[-1]))
            found.append(0.0 if entry is None else entry.of_bin(feature.bin))
        return np.array(found)

    @property
    def in_words(self) -> str:
        """Where it comes from."""
        if self.provenance is None:
            return "switched off"
        return (
            f"{len(self.variants)} simulations of the same parameters against the twin in "
            f"{len(self.provenance.conditions)} conditions, {self.provenance.date} ({', '.join(self.variants)})"
        )


NO_DISCREPANCY = Discrepancy(provenance=None, variants={}, entries=())


@functools.cache
def measured_discrepancy() -> Discrepancy:
    """The shipped one.

    Raises:
        InputError: ``config/discrepancy.yaml`` breaks the schema.
    """
    return load(Discrepancy, config_directory() / "discrepancy.yaml")
