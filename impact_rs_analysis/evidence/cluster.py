# SPDX-License-Identifier: Apache-2.0
"""Evidence: scaled residuals, the common form of all measurements.

A *cluster* is held out as a whole: the repeats of a condition, or a stretch of a recording. Its residuals are measured
minus predicted features, each divided by

    sigma_f^2 = s_f^2 + (l_f / 2)^2 + d_f^2

with s_f the pure error (scatter of repeats, pooled over clusters of one layout, or the noise of a recorded signal), l_f
the relevance limit (smallest difference that matters), and d_f the model discrepancy: the difference between equally
valid simulations of the same parameters (:mod:`impact_rs_analysis.evidence.discrepancy`). Repeats share one
sensitivity; a model is fitted to their mean.

Sizes of residuals are multiples of repeatability:

    size^2 = sum_f r_f^2 / sum_f (s_f^2 / n + d_f^2) / sigma_f^2

with r_f the mean residual of n repeats. Without repeats and discrepancy the denominator is 1 per feature: the size is
the root mean square of the scaled residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
import scipy
from pydantic import AfterValidator

from impact_rs_sim.robots.robot import Array

# Share of the differences of a left-out simulator that the others do not span: 14 to 67 %, 34 % on average.
INDEPENDENT_DISCREPANCY_SHARE = 1.0 / 3.0
# Share of the square of a variant's differences that is common to all conditions: 32 to 71 % in nine square hits.
SHARED_DISCREPANCY_SHARE = 0.55
# Student's t with 5 degrees of freedom over the normal distribution, both at 99 %: six simulators give the size.
DISCREPANCY_QUANTILE_RATIO = float(scipy.stats.t.ppf(0.995, 5) / scipy.stats.norm.ppf(0.995))

Added = tuple[tuple[str, tuple[float, ...]], ...]
"""Effects added to a model: names with their parameter vectors."""


@dataclass(frozen=True)
class Feature:
    """Description of one entry of a feature vector.

    Attributes:
        phase: ``free``, ``impact`` or ``push``; for a recording ``moving up``, ``moving down`` or ``slow``.
        signal: Name of the signal.
        index: Joint (``joint1``) or axis (``x``), with the arm's name in front where there are several.
        bin: Number of the time bin within the phase.
        unit: Unit.
        relevance_limit: Smallest difference that matters in practice, in the unit; 0: not set.
        arm: Name of the arm; empty for signals without an arm, and with a single arm.
    """

    phase: str
    signal: str
    index: str
    bin: int
    unit: str
    relevance_limit: float
    arm: str = ""

    @property
    def group(self) -> tuple[str, str, str]:
        """Phase, signal and index, common to all time bins."""
        return self.phase, self.signal, self.index


@dataclass(frozen=True)
class Cluster:
    """Scaled residuals of measurements that are held out together.

    Attributes:
        name: Short name for tables.
        condition_key: Scenario, object and case; for a recording its file and the stretch.
        layout: Clusters of one layout have the same features, and share their pure error.
        unit: Name of the unit that is held out: the cluster itself, or the recording of the stretch.
        contact: Whether there is a contact.
        features: Description of the entries.
        residuals: One row per repeat, ``(n, F)`` [-].
        sigma: Scale of each feature in its own unit, ``(F,)``.
        pure_error: Pure error of each feature over its scale, ``(F,)`` [-].
        discrepancy: Model discrepancy of each feature over its scale, ``(F,)`` [-].
        patterns: Patterns of the discrepancy, ``(k, F)`` [-]: the discrepancy is a sum of these rows with standard
            normal amplitudes; the squares of a column add up to the square of ``discrepancy``. None: features are
            independent.
        discrepancy_key: Clusters with one key share the amplitudes of the patterns; None: clusters of one layout do.
        calibrations: Systematic errors that all clusters share (clock of the commands, scale of a joint's torque):
            change of the residuals by one standard deviation of each, ``(k, F)`` [-]; None: all are exact.
        timestamps: Time of each repeat, in any unit, ``(n,)``; None: not known.
    """

    name: str
    condition_key: tuple[str, str, str]
    layout: str
    unit: str
    contact: bool
    features: tuple[Feature, ...]
    residuals: Array
    sigma: Array
    pure_error: Array
    discrepancy: Array
    patterns: Array | None = None
    discrepancy_key: str | None = None
    calibrations: Array | None = None
    timestamps: Array | None = None

    @property
    def count(self) -> int:
        """Number of repeats."""
        return int(self.residuals.shape[0])

    @property
    def discrepancy_group(self) -> str:
        """Key of clusters that share the amplitudes of the discrepancy: ``discrepancy_key``, or the layout."""
        return self.layout if self.discrepancy_key is None else self.discrepancy_key

    @cached_property
    def discrepancy_factor(self) -> Array:
        """Factor L of the discrepancy covariance L^T L: its patterns, or one row per feature, ``(k, F)`` [-].

        Clusters of a group share amplitudes, row by row, so features without a discrepancy have a row of zeros.
        """
        return np.diag(self.discrepancy) if self.patterns is None else self.patterns

    @property
    def shared_discrepancy(self) -> Array:
        """Factor of the discrepancy that all clusters of a group share, ``(k, F)`` [-]."""
        return np.asarray(math.sqrt(SHARED_DISCREPANCY_SHARE) * self._full_discrepancy)

    @property
    def unshared_discrepancy(self) -> Array:
        """Factor of the discrepancy of this cluster alone, ``(k, F)`` [-]."""
        return np.asarray(math.sqrt(1.0 - SHARED_DISCREPANCY_SHARE) * self._full_discrepancy)

    @cached_property
    def _full_discrepancy(self) -> Array:
        """Factor of the discrepancy along its patterns and outside them, ``(k, F)`` [-]."""
        outside = math.sqrt(INDEPENDENT_DISCREPANCY_SHARE) * np.diag(self.discrepancy)
        factor = self.discrepancy_factor if self.patterns is None else np.vstack((self.patterns, outside))
        return DISCREPANCY_QUANTILE_RATIO * factor

    def only(self, mask: Sequence[bool], contact: bool) -> Cluster:
        """The cluster with some of its features.

        Args:
            mask: Mask of the features, ``F``.
            contact: Whether these features include a contact.
        """
        rows = np.array(mask)
        return replace(
            self,
            contact=contact,
            features=tuple(feature for feature, keep in zip(self.features, mask, strict=True) if keep),
            residuals=self.residuals[:, rows],
            sigma=self.sigma[rows],
            pure_error=self.pure_error[rows],
            discrepancy=self.discrepancy[rows],
            patterns=None if self.patterns is None else self.patterns[:, rows],
            calibrations=None if self.calibrations is None else self.calibrations[:, rows],
        )

    @cached_property
    def mean(self) -> Array:
        """Mean over the repeats, ``(F,)`` [-]; read-only."""
        mean = np.asarray(self.residuals.mean(axis=0))
        mean.flags.writeable = False
        return mean

    @property
    def error(self) -> float:
        """Mean square of the mean residual [-]."""
        return float(np.mean(np.square(self.mean)))

    @property
    def limit_squares(self) -> Array:
        """(l_f / 2)^2 / sigma_f^2, the share of the relevance limits in the squared scales, ``(F,)`` [-]."""
        return np.asarray(np.maximum(1.0 - np.square(self.pure_error) - np.square(self.discrepancy), 0.0))

    @property
    def expected_squares(self) -> Array:
        """Expected squares of the mean residual under repeatability and model discrepancy alone, ``(F,)`` [-]."""
        return np.asarray(np.square(self.pure_error) / self.count + np.square(self.discrepancy))

    @property
    def expected(self) -> float:
        """Expected :attr:`error` under repeatability and model discrepancy alone [-]; 0 where neither is known."""
        return float(np.mean(self.expected_squares))


TIMES = "times repeatability"
"""Unit of sizes in multiples of repeatability."""


SCALE = "the scale of each signal (half its relevance limit, and the model discrepancy)"
"""Unit of sizes without repeats."""


def _present_unit(unit: str) -> str:
    """``TIMES`` for its text in earlier versions."""
    return TIMES if unit == "times what repetition alone gives" else unit


ErrorUnit = Annotated[str, AfterValidator(_present_unit)]
"""Unit of errors in a document; documents of earlier versions are read."""


def difference(before: Array | None, after: Array | None) -> Array | None:
    """After minus before; None if one is unknown."""
    return None if before is None or after is None else np.asarray(after - before)


def size_of(errors: Array | Sequence[float], expected: Array | Sequence[float]) -> float:
    """Size of mean square residuals in multiples of repeatability (module text).

    Args:
        errors: Mean square of the mean residual by cluster, ``(c,)`` [-].
        expected: Its expectation under repeatability and discrepancy alone, ``(c,)`` [-].
    """
    unit = float(np.mean(expected))
    return math.sqrt(float(np.mean(errors)) / (unit if unit > 0.0 else 1.0))


def pooled_error(rows: Sequence[Array]) -> Array | None:
    """Pure error of features, pooled over clusters, ``(F,)``; None without repeats.

    Args:
        rows: Per cluster, residuals of its repeats in their own units, ``(n, F)``.
    """
    freedom = sum(values.shape[0] - 1 for values in rows)
    if freedom < 1:
        return None
    squares = sum(((values - values.mean(axis=0)) ** 2).sum(axis=0) for values in rows)
    return np.asarray(np.sqrt(squares / freedom))
