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

with r_f the mean residual of n repeats. Without repeats the size is that of the scaled residuals.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, TypeVar

import numpy as np
from pydantic import AfterValidator

from impact_rs_sim.effects.base import Joints
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array, JointType, RobotFacts

Added = tuple[tuple[str, tuple[float, ...]], ...]
"""Effects added to a model: names with their parameter vectors."""

Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Feature:
    """Description of one entry of a feature vector.

    Attributes:
        phase: ``free``, ``impact`` or ``push``; for a recording ``moving up``, ``moving down`` or ``slow``.
        signal: Name of the signal.
        index: Joint (``joint1``) or axis (``x``), with the arm's name in front where there are several.
        bin: Number of the time bin within the phase.
        unit: Unit.
        relevance_limit: Smallest difference that matters in practice, in the unit; 0: none is set.
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
        """Phase, signal and index: the same for all time bins."""
        return self.phase, self.signal, self.index


@dataclass(frozen=True)
class Cluster:
    """Scaled residuals of measurements that are held out together.

    Attributes:
        name: Short name for tables.
        place: Scenario, object and case; for a recording its file and the stretch.
        layout: Clusters of one layout have the same features, and share their pure error.
        unit: Name of the unit that is held out: the cluster itself, or the recording of the stretch.
        contact: Whether there is a contact.
        features: Description of the entries.
        residuals: One row per repeat, ``(n, F)`` [-].
        sigma: Scale of each feature in its own unit, ``(F,)``.
        pure: Pure error of each feature over its scale, ``(F,)`` [-].
        discrepancy: Model discrepancy of each feature over its scale, ``(F,)`` [-].
        patterns: Patterns of the discrepancy, ``(k, F)`` [-]: it is a sum of these rows with standard normal
            amplitudes; column sums of squares equal those of ``discrepancy``. None: features are independent.
        alike: Clusters with the same value share the amplitudes; None: clusters of one layout do.
        late: Change of its residuals when commands act later by one standard deviation of their clock, ``(F,)`` [-];
            None: the clock is known.
    """

    name: str
    place: tuple[str, str, str]
    layout: str
    unit: str
    contact: bool
    features: tuple[Feature, ...]
    residuals: Array
    sigma: Array
    pure: Array
    discrepancy: Array
    patterns: Array | None = None
    alike: str | None = None
    late: Array | None = None

    @property
    def count(self) -> int:
        """Number of repeats."""
        return int(self.residuals.shape[0])

    @cached_property
    def moved_together(self) -> Array:
        """Change of the features by each pattern of discrepancy at amplitude 1, ``(k, F)`` [-]."""
        if self.patterns is not None:
            return self.patterns
        return np.diag(self.discrepancy)[self.discrepancy > 0.0]

    def only(self, kept: Sequence[bool], contact: bool) -> Cluster:
        """The cluster with some of its features.

        Args:
            kept: Which of them, ``F``.
            contact: Whether these features include a contact.
        """
        rows = np.array(kept)
        return replace(
            self,
            contact=contact,
            features=tuple(feature for feature, keep in zip(self.features, kept, strict=True) if keep),
            residuals=self.residuals[:, rows],
            sigma=self.sigma[rows],
            pure=self.pure[rows],
            discrepancy=self.discrepancy[rows],
            patterns=None if self.patterns is None else self.patterns[:, rows],
            late=None if self.late is None else self.late[rows],
        )

    @property
    def mean(self) -> Array:
        """Mean over the repeats, ``(F,)`` [-]."""
        return np.asarray(self.residuals.mean(axis=0))

    @property
    def error(self) -> float:
        """Mean square of the mean residual [-]."""
        return float(np.mean(np.square(self.mean)))

    @property
    def expected(self) -> float:
        """Expected :attr:`error` under repeatability and model discrepancy alone [-]; 0 where neither is known."""
        return float(np.mean(np.square(self.pure) / self.count + np.square(self.discrepancy)))


TIMES = "times repeatability"
"""Unit of sizes in multiples of repeatability."""


def _present_unit(unit: str) -> str:
    """``TIMES`` in the words of earlier versions."""
    return TIMES if unit == "times what repetition alone gives" else unit


ErrorUnit = Annotated[str, AfterValidator(_present_unit)]
"""Unit of errors in a document; documents of earlier versions are read."""


@dataclass(frozen=True)
class Identity:
    """Identity of the measurements.

    Attributes:
        digest: Digest of all measurements; empty: not known.
        count: Number of runs, rows or recordings.
        conditions: Names of the conditions.
    """

    digest: str
    count: int
    conditions: tuple[str, ...]


class Source(ABC):
    """Source of residuals and sensitivities: measurements, and a model that predicts them.

    Attributes:
        model: The model, to which effects are added.
        clusters: Residuals of the model.
        physics: Physics of one cluster under the model, for the number of joints.
        worlds: All distinct physics of the clusters under the model, for bounds of parameters.
        repeated: Whether clusters hold repeats; if not, clusters are stretches of time.
        cheap: Whether predictions are cheap enough to try several starts of a fit.
        remarks: Remarks on the measurements, for the reader.
        residual_unit: Unit of the size of residuals without repeats.
        size_unit: Unit of :meth:`size`.
        pieces: Name of the clusters without repeats, plural.
        of_motion: Whether motion before and after an impact was measured, or the impact alone.
        clock: Largest offset between the clocks of commands and measurements, either way [s]; a delay shorter than this
            cannot be distinguished from it.
        least_change: Without repeats, an effect is accepted if the interval of a parameter lies more than so many
            parameter scales from nominal; 0: the relevance limits of the features decide.
    """

    model: Model
    clusters: tuple[Cluster, ...]
    physics: Physics
    repeated: bool
    cheap: bool
    remarks: Sequence[str] = ()
    residual_unit: str = "N m"
    size_unit: str = TIMES
    pieces: str = "stretches of time"
    of_motion: bool = True
    clock: float = 0.0
    least_change: float = 1.0

    @property
    def worlds(self) -> Sequence[Physics]:
        """See the class."""
        return [self.physics]

    @property
    def joints(self) -> tuple[JointType, ...]:
        """Joint types, base to tip, of an arm that shares its parameters with all others; none without an arm.

        Raises:
            InputError: Arms with different joints have the same name.
        """
        found = {(name, joints) for world in self.worlds for name, joints in world.arm_joints}
        if not self.model.arms and len({joints for _, joints in found}) > 1:
            arms = ", ".join(f"{name} with {len(joints)} joints" for name, joints in sorted(found))
            raise InputError(f"arms {arms}: parameters carry the name of their arm; expected another name for each")
        arm = next(iter(self.physics.arms.values()), None)
        return () if arm is None else arm.facts.joint_types

    @property
    def identity(self) -> Identity:
        """Identity of the measurements; subclasses add runs or rows."""
        units = tuple(dict.fromkeys(item.unit for item in self.clusters))
        return Identity("", len(units), units)

    def size(self) -> float:
        """Size of the model's residuals, in multiples of repeatability (module text) [-]."""
        return size_of([item.error for item in self.clusters], [item.expected for item in self.clusters])

    def noise_size(self) -> float | None:
        """Value of :meth:`size` if only noise is left; None without repeats."""
        return 1.0 if any(np.any(item.pure > 0.0) for item in self.clusters) else None

    def residual_weight(self, item: Cluster) -> Array:
        """Factors from scaled residuals to ``residual_unit``, without repeats, ``(F,)``."""
        return item.sigma

    @property
    def free_motion(self) -> Source | None:
        """The clusters before contact, if they are cheaper to predict alone; else None."""
        return None

    def spread(self, function: Callable[[Source, Item], Made], items: Sequence[Item], what: str) -> list[Made]:
        """``function(source, item)`` of every item, in parallel processes if predictions are expensive.

        Args:
            function: Without side effects, and loadable by another process.
            items: Arguments.
            what: Purpose, shown as progress.
        """
        del what
        return [function(self, item) for item in items]

    @abstractmethod
    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        """Features, in their units, of clusters (by number) with effects on top of the model.

        Args:
            wanted: Number of the cluster, and the added effects.
            what: Purpose, shown as progress.

        Returns:
            ``(F,)`` each; None if a contact is missing, or if the effects give a body without positive inertia.
        """

    def differences(
        self, numbers: Sequence[int], before: Added, after: Added, what: str, every: bool = True
    ) -> list[Array | None]:
        """Change of features with a change of effects, in their units.

        Args:
            numbers: Of the clusters.
            before: Added effects before.
            after: Added effects after.
            what: Purpose, shown as progress.
            every: Whether to average over all repeats of a cluster; else one repeat stands for all.

        Returns:
            ``(F,)`` each; None where one of the two cannot be predicted.
        """
        del every
        found = self.predict([(number, added) for added in (before, after) for number in numbers], what)
        return [difference(a, b) for a, b in zip(found[: len(numbers)], found[len(numbers) :], strict=True)]

    @abstractmethod
    def measure_again(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """Residuals of the model with effects, on the scale of ``like``; None if they cannot be simulated."""


def with_per_arm_parameters(model: Model, worlds: Iterable[Physics], each_arm: bool = False) -> Model:
    """The model with separate effect parameters for every arm, where arms do not share them.

    Arms of one kind share parameters: that halves their number, and a motion of one arm informs about the other. Arms
    of different kinds have separate parameters.

    Args:
        model: The model; one with arms is returned unchanged.
        worlds: All measured physics.
        each_arm: Whether arms of one kind have separate parameters, too.

    Raises:
        InputError: ``each_arm``, and one name stands for several robots.
    """
    found: dict[str, list[RobotFacts]] = {}
    for physics in worlds:
        for name, arm in physics.arms.items():
            kinds = found.setdefault(name, [])
            if arm.facts not in kinds:
                kinds.append(arm.facts)
    several = [name for name, kinds in found.items() if len(kinds) > 1]
    if each_arm and several:
        raise InputError(f"arm {several[0]!r} is another robot in another scenario; expected another name for each")
    first = next(iter(found.values()), [])
    alike = all(kinds == first for kinds in found.values())
    if model.arms or several or (alike and not each_arm):
        return model
    return model.model_copy(update={"arms": {name: _joints_of(kinds[0]) for name, kinds in found.items()}})


def _joints_of(facts: RobotFacts) -> Joints:
    """The joints of an arm as in a model file."""
    return facts.joint_types if "prismatic" in facts.joint_types else facts.joint_count


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
