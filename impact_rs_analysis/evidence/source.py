# SPDX-License-Identifier: Apache-2.0
"""Source of evidence: measurements, and a model that predicts them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from impact_rs_analysis.evidence.cluster import TIMES, Added, Cluster, difference, size_of
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY, Discrepancy, DiscrepancyDocument
from impact_rs_analysis.evidence.levels import Comparison, RecordingDocument, condition_scores, where_of
from impact_rs_analysis.evidence.measured_runs import Runs
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.base import Joints
from impact_rs_sim.effects.depending import Depending
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robot import Array, JointType, RobotFacts
from impact_rs_trials.workers import Map

MAX_NUMBERS_AS_LEVELS = 8  # different numbers of a covariate that may be names, as of sessions 1 to 5

Item = TypeVar("Item")
Made = TypeVar("Made")


@dataclass(frozen=True)
class Identity:
    """Identity of the measurements.

    Attributes:
        digest: Digest of all measurements; empty: not known.
        count: Number of runs, rows or recordings.
        conditions: Names of the conditions.
        recorded: When the last run was recorded, seconds since 1970; None: not known.
    """

    digest: str
    count: int
    conditions: tuple[str, ...]
    recorded: float | None = None


@dataclass(frozen=True)
class Covariate:
    """A circumstance under which measurements were made: a number, or the name of a level.

    Attributes:
        name: Name.
        unit: Unit of numbers; empty: none is known.
        values: By cluster, row by row.
    """

    name: str
    unit: str
    values: tuple[tuple[float | str, ...], ...]

    @property
    def numeric(self) -> bool:
        """Whether it is a number."""
        return all(isinstance(value, float) for rows in self.values for value in rows)


@dataclass(frozen=True)
class View:
    """The same measurements looked at in another way, which gets a verdict of its own.

    Attributes:
        name: What is looked at, in words.
        source: The evidence.
        option: Option of the command line whose other value it is; empty: a part of the signals.
        of: What has another value there; empty: the points that touch.
        value: That value, in the unit.
        unit: Unit.
    """

    name: str
    source: Source
    option: str = ""
    of: str = ""
    value: float = 0.0
    unit: str = ""


class Source(ABC):
    """Source of residuals and sensitivities: measurements, and a model that predicts them.

    Attributes:
        kind: Kind of measurement, as in documents.
        model: The model, to which effects are added.
        clusters: Residuals of the model.
        physics: Physics of one cluster under the model, for the number of joints.
        worlds: All distinct physics of the clusters under the model, for bounds of parameters.
        repeated: Whether clusters hold repeats; if not, clusters are stretches of time.
        remarks: Remarks on the measurements, for the reader.
        impossible: How the measurements break a law of every impact, whatever the contact is like; empty: they do not.
        comparison_remarks: Those of them that a comparison shows.
        runs: Runs of trials; None: recordings or a table of impacts.
        left_out: Path and reason of recordings that are too short; those of trials are with the runs.
        recording: How recordings were read; None: no recordings.
        discrepancy: Model discrepancy that is allowed for.
        size_is: Definition of :meth:`size`.
        not_measured: Quantities that were not measured.
        noise_apart: Whether every joint has an unknown noise of its own: gains count against what is left of it, too.
        residual_unit: Unit of the size of residuals without repeats.
        size_unit: Unit of :meth:`size`.
        pieces: Name of the clusters without repeats, plural.
        of_motion: Whether motion before and after an impact was measured, or the impact alone.
        clock: Largest offset between the clocks of commands and measurements, either way [s]; a delay shorter than this
            cannot be distinguished from it.
        least_change: Without repeats, an effect is accepted if the interval of a parameter lies more than so many
            parameter scales from nominal; 0: the relevance limits of the features decide.
        covariates: Circumstances on which an effect may depend.
        interleaved: Whether clusters are held out in turn and not in runs of neighbours.
        folds: Number of parts that are held out in turn, at most: from five on, an error on unseen clusters changes
            little with it.
        state: What else measurements differ in and a covariate may go with, such as the impact speed.
    """

    kind: Literal["trials", "recordings", "impacts"] = "trials"
    model: Model
    clusters: tuple[Cluster, ...]
    physics: Physics
    repeated: bool
    remarks: Sequence[str] = ()
    runs: Runs | None = None
    left_out: tuple[tuple[str, str], ...] = ()
    recording: RecordingDocument | None = None
    discrepancy: Discrepancy = NO_DISCREPANCY
    size_is: str = "size of the difference between measurement and model, in multiples of repeatability"
    not_measured: tuple[str, ...] = ()
    impossible: str = ""
    noise_apart: bool = False
    residual_unit: str = "N m"
    size_unit: str = TIMES
    pieces: str = "stretches of time"
    of_motion: bool = True
    clock: float = 0.0
    least_change: float = 1.0
    interleaved: bool = False
    folds: int = 6

    @property
    def free_motion_part(self) -> Source | None:
        """Prediction of free motion alone, in the same numbers of clusters; None: it is not cheaper."""
        return None

    @property
    def covariates(self) -> tuple[Covariate, ...]:
        """See the class."""
        return ()

    @property
    def state(self) -> tuple[Covariate, ...]:
        """See the class."""
        return ()

    @property
    def contact_speeds(self) -> dict[str, Array]:
        """Closing and sliding speed of the points that close, by symbol of formulas [m/s]; empty: no single impacts."""
        return {}

    @property
    def comparison_remarks(self) -> Sequence[str]:
        """See the class."""
        return self.remarks

    @property
    def proportion(self) -> Proportion:
        """Size of what was measured, to which ranges of parameters and noticeable changes are in proportion."""
        return Proportion.of(self.physics)

    @property
    def discrepancy_document(self) -> DiscrepancyDocument:
        """What a document says of the model discrepancy that is allowed for."""
        return self.discrepancy.document

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
        return 1.0 if any(np.any(item.pure_error > 0.0) for item in self.clusters) else None

    def residual_weight(self, item: Cluster) -> Array:
        """Factors from scaled residuals to ``residual_unit``, without repeats, ``(F,)``."""
        return item.sigma

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

    def differences(self, numbers: Sequence[int], before: Added, after: Added, what: str) -> list[Array | None]:
        """Change of features with a change of effects, in their units.

        Args:
            numbers: Of the clusters.
            before: Added effects before.
            after: Added effects after.
            what: Purpose, shown as progress.

        Returns:
            ``(F,)`` each; None where one of the two cannot be predicted.
        """
        found = self.predict([(number, added) for added in (before, after) for number in numbers], what)
        return [difference(a, b) for a, b in zip(found[: len(numbers)], found[len(numbers) :], strict=True)]

    @property
    def known_effects(self) -> dict[str, Effect]:
        """Effects that it predicts with, by name."""
        return self.model.known_effects

    def offers(self, effect: Effect) -> bool:
        """Whether a search without a list of effects considers this one; those of the bare arm need recordings."""
        return not effect.calibrates

    def starts(self, name: str) -> Sequence[Array]:
        """Points ``(p,)`` other than nominal at which a search looks at an effect, as measurements suggest."""
        del name
        return ()

    def with_dependences(self, effects: Sequence[Depending]) -> Source:
        """The same measurements, predicted with further effects that depend on covariates, and held out in turn.

        Args:
            effects: By names that the model does not know.
        """
        raise NotImplementedError(f"{type(self).__name__} has no covariates")

    def searched(self) -> Source:
        """What a search looks at: all of it, or of a large table some rows."""
        return self

    def unseen(self, searched: Source, added: Added) -> tuple[str, ...]:
        """How well effects predict what :meth:`searched` left out, in words.

        Args:
            searched: What a search has seen.
            added: Effects that it found on top of the model.
        """
        del searched, added
        return ()

    def views(self) -> tuple[View, ...]:
        """Other ways to look at the measurements, which the diagnosis judges as well."""
        return ()

    def compare_levels(self) -> Comparison:
        """Residuals of the model by level, signal and place."""
        return Comparison({}, tuple(where_of(self.clusters)), condition_scores(self.clusters))

    def tracks(self, map_tasks: Map, added: Added = ()) -> tuple[Track, ...]:
        """Measured and predicted signals over time.

        Args:
            map_tasks: Parallel map.
            added: Effects found on top of the model; of recordings and tables shown beside it.
        """
        del map_tasks, added
        return ()

    def joint_sizes(self, rest: Sequence[Array]) -> list[tuple[str, float, float, str]]:
        """Joint, root mean square of its residual torque, noise and unit, for recordings of one arm.

        Args:
            rest: Residuals by cluster, ``(F,)`` [-].
        """
        del rest
        return []

    @abstractmethod
    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
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
