# SPDX-License-Identifier: Apache-2.0
"""Model discrepancy: difference between equally valid simulations of the same parameters.

No simulator is exact. Contact settings, regularisation of friction, time step and physics engine are free choices, so
residuals that depend on them are not evidence of a missing effect. ``config/discrepancy.yaml`` holds the discrepancy by
phase, signal and index, with its provenance (made by ``tools/discrepancy.py``), and
``config/discrepancy_patterns.csv`` its patterns over the features.

Square and oblique hits have separate values. On oblique hits (pad and face not parallel, or velocity not along the
normal) contact friction matters, and simulators regularise it differently. On square hits the differences of simulators
are common to all conditions, on oblique hits they vary with the condition.
"""

from __future__ import annotations

import csv
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from impact_rs_analysis.evidence.cluster import Feature
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.schema import Schema, load

Kind = Literal["free", "square", "oblique"]

MAX_SQUARE_ANGLE_RAD = 0.02  # up to 1 degree simulators agree as well as on square hits


class DiscrepancyEntry(Schema):
    """Discrepancy of one signal."""

    kind: Kind = Field(description="free: no contact; square: face on face, along the normal; oblique: any other hit")
    phase: str = Field(description="free, impact or push")
    signal: str = Field(description="name of the signal")
    index: str = Field(description="joint (joint1 ...) or axis (x, y, z)")
    unit: str = Field(description="unit of the signal")
    value: float = Field(ge=0.0, description="rms of variant minus replay over conditions and time bins, in the unit")
    largest: str = Field("", description="variant with the largest difference, from which value and by_bin are taken")
    by_bin: tuple[float, ...] = Field((), description="rms by time bin, in the unit")
    by_variant: dict[str, float] = Field({}, description="rms of every variant")
    shared_over_conditions: float | None = Field(None, description="share of the square common to all conditions [-]")
    shared_over_bins: float | None = Field(None, description="share of the square common to all bins [-]")

    def of_bin(self, number: int) -> float:
        """Discrepancy of one time bin, in the unit: root mean square of the values of signal and bin."""
        bin_value = self.by_bin[number] if number < len(self.by_bin) else self.value
        return float(np.sqrt(0.5 * (self.value**2 + bin_value**2)))


class Patterns(Schema):
    """Patterns over the features by which variants differ, in trials of one kind."""

    kind: Kind = Field(description="free, square or oblique")
    features: tuple[tuple[str, str, str, int], ...] = Field(description="phase, signal, index and bin, by column")
    rows: tuple[tuple[float, ...], ...] = Field(description="variant minus replay, by variant and condition, in units")


class Provenance(Schema):
    """How the discrepancy was measured."""

    date: str = Field(description="day")
    command: str = Field(description="command")
    revision: str = Field("", description="revision of the sources")
    versions: dict[str, str] = Field({}, description="versions of the packages")
    seconds: float = Field(0.0, description="duration of the computation [s]")
    conditions: tuple[str, ...] = Field((), description="simulated conditions")
    combined: str = Field("", description="how variants were combined")


class DiscrepancyDocument(Schema):
    """Model discrepancy that was allowed for."""

    used: bool = Field(False, description="whether it is part of sigma, intervals and verdicts")
    provenance: str = Field("", description="how it was measured")


class Discrepancy(Schema):
    """``config/discrepancy.yaml``."""

    provenance: Provenance | None = Field(description="how it was measured; null: switched off")
    variants: dict[str, str] = Field(description="variants of the simulation, a sentence each")
    entries: tuple[DiscrepancyEntry, ...] = Field(description="discrepancy of every signal")
    patterns: tuple[Patterns, ...] = Field((), description="from discrepancy_patterns.csv")

    def of(self, features: Sequence[Feature], kind: Kind) -> Array:
        """Discrepancy of features in their units, ``(F,)``; 0 where it was not measured.

        Args:
            features: The features; every arm has the discrepancy of a single arm.
            kind: Kind of their runs.
        """
        entries = {(e.phase, e.signal, e.index): e for e in self.entries if e.kind == kind}
        values = []
        for feature in features:
            entry = entries.get((feature.phase, feature.signal, feature.index.rsplit(".", 1)[-1]))
            values.append(0.0 if entry is None else entry.of_bin(feature.bin))
        return np.array(values)

    def patterns_of(self, features: Sequence[Feature], kind: Kind) -> Array | None:
        """Patterns of the discrepancy over features, ``(k, F)`` in their units; None: no patterns of this kind.

        The squares of a column add up to the square of :meth:`of`. A feature without a pattern is independent.
        """
        table = next((table for table in self.patterns if table.kind == kind), None)
        if table is None:
            return None
        size = self.of(features, kind)
        column_of = {feature: column for column, feature in enumerate(table.features)}
        columns = [column_of.get((f.phase, f.signal, f.index.rsplit(".", 1)[-1], f.bin)) for f in features]
        rows = np.array(table.rows)
        patterns = np.array([np.zeros(len(rows)) if column is None else rows[:, column] for column in columns]).T
        norms = np.sqrt(np.square(patterns).sum(axis=0))
        patterns *= np.divide(size, norms, out=np.zeros_like(norms), where=norms > 0.0)
        alone = np.diag(np.where(norms > 0.0, 0.0, size))
        return np.vstack((patterns, alone[np.any(alone > 0.0, axis=1)]))

    @property
    def document(self) -> DiscrepancyDocument:
        """Its entry in a document."""
        return DiscrepancyDocument(used=bool(self.entries), provenance=self.in_words)

    @property
    def in_words(self) -> str:
        """Provenance in words."""
        if self.provenance is None:
            return "switched off"
        return (
            f"{len(self.variants)} simulations of the same parameters against the replay in "
            f"{len(self.provenance.conditions)} conditions, {self.provenance.date} ({', '.join(self.variants)})"
        )


DISCREPANCY_FILE, PATTERNS_FILE = "discrepancy.yaml", "discrepancy_patterns.csv"
NO_DISCREPANCY = Discrepancy(provenance=None, variants={}, entries=())


@functools.cache
def measured_discrepancy() -> Discrepancy:
    """The shipped model discrepancy.

    Raises:
        InputError: ``config/discrepancy.yaml`` breaks the schema.
    """
    discrepancy = load(Discrepancy, config_directory() / DISCREPANCY_FILE)
    return discrepancy.model_copy(update={"patterns": tuple(read_patterns(config_directory() / PATTERNS_FILE))})


def read_patterns(path: Path) -> list[Patterns]:
    """Read the table of :func:`write_patterns`.

    Raises:
        InputError: It cannot be read.
    """
    tables: dict[str, tuple[list[str], list[list[float]]]] = {}
    header: list[str] = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for line in csv.reader(file):
                if line[0] == "kind":
                    header = line[3:]
                else:
                    values = [float(value) for value in line[3:]]
                    if len(values) != len(header):
                        raise ValueError(f"{len(values)} values under {len(header)} features")
                    tables.setdefault(line[0], (header, []))[1].append(values)
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"no table of patterns: {error}", file=path) from None
    return [
        Patterns(kind=kind, features=tuple(_parsed(name) for name in header), rows=tuple(map(tuple, rows)))
        for kind, (header, rows) in tables.items()
    ]


def _parsed(name: str) -> tuple[str, str, str, int]:
    phase, signal, index, number = name.split("|")
    return phase, signal, index, int(number)


def write_patterns(
    path: Path, tables: Mapping[Kind, tuple[Sequence[Feature], Sequence[tuple[str, str, Sequence[float]]]]]
) -> None:
    """Write the feature changes of all variants: blocks of one kind, each with a header line.

    Args:
        path: CSV file.
        tables: By kind, features by column, and rows of variant, condition and values in the features' units.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for kind, (features, rows) in tables.items():
            names = [f"{feature.phase}|{feature.signal}|{feature.index}|{feature.bin}" for feature in features]
            writer.writerow(["kind", "variant", "condition", *names])
            for variant, condition, values in rows:
                writer.writerow([kind, variant, condition, *(f"{value:.4g}" for value in values)])
