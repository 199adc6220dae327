# SPDX-License-Identifier: Apache-2.0
"""Evidence: what every source of measurements comes down to before anything is explained.

A *cluster* is what is held out together: the repeats of a condition, or a stretch of a recording. Its residuals are
measured minus predicted features, each divided by

    sigma_f^2 = s_f^2 + (floor_f / 2)^2 + d_f^2

with s_f the pure error (what repeats of a trial scatter, pooled over clusters of one layout, or the noise of a recorded
signal), floor_f the difference below which nobody cares, and d_f the model discrepancy: how far equally valid
simulations of the same parameters differ (:mod:`impact_rs_analysis.evidence.discrepancy`). Repeats share one
sensitivity; what they average to is what a model has to explain.

Sizes are told on one scale, on which 1 is what repetition alone leaves:

    size^2 = sum_f r_f^2 / sum_f (s_f^2 / n + d_f^2) / sigma_f^2

with r_f the mean residual of n repeats; where nothing is known of repetition, the scaled residual itself is told.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from impact_rs_sim.effects.base import Joints
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array, JointType, RobotFacts

Added = tuple[tuple[str, tuple[float, ...]], ...]
"""Effects on top of a model: names with their parameter vectors."""

Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Feature:
    """Where one number of a feature vector comes from.

    Attributes:
        phase: ``free``, ``impact`` or ``push``; of a recording ``moving up``, ``moving down`` or ``slow``.
        signal: What it is.
        index: Joint (``joint1``) or axis (``x``), with the arm's name in front where there are several.
        bin: Number of the time bin within the phase.
        unit: Unit.
        relevance_limit: Smallest difference that matters in practice, in the unit; 0: none is set.
        arm: Name of the arm; empty: of none, or of the only one that there is.
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
        """Phase, signal and index: what its time bins have in common."""
        return self.phase, self.signal, self.index


@dataclass(frozen=True)
class Cluster:
    """Scaled residuals of what is held out together.

    Attributes:
        name: Short name for tables.
        place: Scenario, object and case; of a recording its file and the stretch.
        layout: Clusters of one layout have the same features, and share their pure error.
        unit: What is held out as a whole: the cluster itself, or the recording that it is a stretch of.
        contact: Whether something is hit.
        features: What the entries are.
        residuals: One row per repeat, ``(n, F)`` [-].
        sigma: Scale of each feature in its own unit, ``(F,)``.
        pure: Pure error of each feature over its scale, ``(F,)`` [-].
        discrepancy: Model discrepancy of each feature over its scale, ``(F,)`` [-].
        patterns: How it moves the features together, ``(k, F)`` [-]: a sum of these rows with normal amplitudes, whose
            squares add up to those of ``discrepancy``; None: every feature by itself.
        alike: Clusters of one name have the same amplitudes; None: those of one layout.
        late: What one standard deviation of the clock of commands, the same one everywhere, does to its residuals,
            ``(F,)`` [-]; None: their clock is known.
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
        """What discrepancy of amplitude 1 does, row by row, ``(k, F)`` [-]."""
        if self.patterns is not None:
            return self.patterns
        return np.diag(self.discrepancy)[self.discrepancy > 0.0]

    def only(self, kept: Sequence[bool], contact: bool) -> Cluster:
        """The cluster with some of its features.

        Args:
            kept: Which of them, ``F``.
            contact: Whether something is hit in what they tell.
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
        """What :attr:`error` is when only repetition and model discrepancy are left [-]; 0 where nothing is known."""
        return float(np.mean(np.square(self.pure) / self.count + np.square(self.discrepancy)))


TIMES = "times what repetition alone gives"
"""Unit of sizes in multiples of repetition."""


@dataclass(frozen=True)
class Identity:
    """What was measured.

    Attributes:
        digest: Of all of it; empty: not known.
        count: Runs, rows or recordings.
        conditions: Their names.
    """

    digest: str
    count: int
    conditions: tuple[str, ...]


class Source(ABC):
    """Where residuals and sensitivities come from: measurements, and a model that predicts them.

    Attributes:
        model: What is believed; effects are switched on on top of it.
        clusters: Residuals of the model.
        physics: Physics of one cluster under the model, for the number of joints.
        worlds: All different physics of clusters under the model, for bounds of parameters.
        repeated: Whether clusters hold repeats; if not, clusters are stretches of time.
        cheap: Whether predictions cost so little that several starting points can be tried.
        remarks: What a reader should know of the measurements.
        residual_unit: Where nothing is repeated, unit in which the size of residuals is told.
        size_unit: Unit of :meth:`size`.
        pieces: What clusters are where nothing is repeated.
        of_motion: Whether motion before and after an impact was measured, or the impact alone.
        clock: How far the stamps of commands may be off the clock of what was measured, either way [s]: that much of a
            delay nobody can tell from them.
        least_change: Where nothing is repeated, parameter scales beyond which the whole interval of an accepted effect
            lies; 0: its features have floors, by which it is judged.
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
        """How the joints of an arm that shares its parameters with all others move, base to tip; none without an arm.

        Raises:
            InputError: Arms whose joints are not alike go by one name, so that they cannot be told apart.
        """
        found = {(name, joints) for world in self.worlds for name, joints in world.arm_joints}
        if not self.model.arms and len({joints for _, joints in found}) > 1:
            told = ", ".join(f"{name} with {len(joints)} joints" for name, joints in sorted(found))
            raise InputError(
                f"arms {told}: parameters of different arms go by their names; expected another name for each"
            )
        arm = next(iter(self.physics.arms.values()), None)
        return () if arm is None else arm.facts.joint_types

    @property
    def identity(self) -> Identity:
        """What was measured; where runs or rows are known, a subclass says which."""
        units = tuple(dict.fromkeys(item.unit for item in self.clusters))
        return Identity("", len(units), units)

    def size(self) -> float:
        """Size of what the model leaves, in multiples of repetition (module text) [-]."""
        return size_of([item.error for item in self.clusters], [item.expected for item in self.clusters])

    def noise_size(self) -> float | None:
        """What :meth:`size` is if only repetition is left; None where nothing was repeated."""
        return 1.0 if any(np.any(item.pure > 0.0) for item in self.clusters) else None

    def residual_weight(self, item: Cluster) -> Array:
        """Factors that turn scaled residuals into ``residual_unit`` where nothing is repeated, ``(F,)``."""
        return item.sigma

    @property
    def free_motion(self) -> Source | None:
        """The same clusters before anything was hit, where a look at them alone is cheaper; None: it is not."""
        return None

    def spread(self, function: Callable[[Source, Item], Made], items: Sequence[Item], what: str) -> list[Made]:
        """``function(source, item)`` of every item, in processes side by side where predictions are dear.

        Args:
            function: Changes nothing; another process must be able to load it.
            items: What to do it with.
            what: What it is for, to tell the user.
        """
        del what
        return [function(self, item) for item in items]

    @abstractmethod
    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        """Features, in their units, of clusters (by number) with effects on top of the model.

        Args:
            wanted: Number of the cluster, and what is switched on.
            what: What it is for, to tell the user.

        Returns:
            ``(F,)`` each; None where nothing is hit although it should be, or where the effects leave no body.
        """

    def differences(
        self, numbers: Sequence[int], before: Added, after: Added, what: str, every: bool = True
    ) -> list[Array | None]:
        """What a change of effects does to features, in their units.

        Args:
            numbers: Of the clusters.
            before: What is switched on before.
            after: What is switched on after.
            what: What it is for, to tell the user.
            every: Whether it is the mean over all repeats of a cluster, or one of them stands for all.

        Returns:
            ``(F,)`` each; None where one of the two cannot be predicted.
        """
        del every
        found = self.predict([(number, added) for added in (before, after) for number in numbers], what)
        return [difference(a, b) for a, b in zip(found[: len(numbers)], found[len(numbers) :], strict=True)]

    @abstractmethod
    def measure_again(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """Residuals with effects on top of the model, on the scale of ``like``; None where that cannot be simulated."""


def with_per_arm_parameters(model: Model, worlds: Iterable[Physics], each_arm: bool = False) -> Model:
    """The model, knowing effects with parameters of its own for every arm where arms do not share them.

    Arms of one kind share them: what is missing in a model is looked for in the kind, with half as many parameters, and
    a motion of one arm tells of the other. Arms of different kinds have nothing to share.

    Args:
        model: What is believed; one that knows its arms already stays as it is.
        worlds: All physics that were measured.
        each_arm: Whether arms of one kind have their own, too.

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
    """The joints of an arm as a model file says them."""
    return facts.joint_types if "prismatic" in facts.joint_types else facts.joint_count


def difference(before: Array | None, after: Array | None) -> Array | None:
    """After minus before, where both are known."""
    return None if before is None or after is None else np.asarray(after - before)


def size_of(errors: Array | Sequence[float], expected: Array | Sequence[float]) -> float:
    """Size of mean square residuals on the scale on which 1 is what repetition alone leaves (module text).

    Args:
        errors: Mean square of the mean residual by cluster, ``(c,)`` [-].
        expected: What it would be if only repetition and discrepancy were left, ``(c,)`` [-].
    """
    unit = float(np.mean(expected))
    return math.sqrt(float(np.mean(errors)) / (unit if unit > 0.0 else 1.0))


def pooled_error(rows: Sequence[Array]) -> Array | None:
    """Pure error of features that several clusters share, ``(F,)``; None where nothing was repeated.

    Args:
        rows: Per cluster, residuals of its repeats in their own units, ``(n, F)``.
    """
    freedom = sum(values.shape[0] - 1 for values in rows)
    if freedom < 1:
        return None
    squares = sum(((values - values.mean(axis=0)) ** 2).sum(axis=0) for values in rows)
    return np.asarray(np.sqrt(squares / freedom))
