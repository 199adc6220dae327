# SPDX-License-Identifier: Apache-2.0
"""Source of evidence: measurements, and a model that predicts them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from impact_rs_analysis.evidence.cluster import TIMES, Added, Cluster, difference
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY, Discrepancy, DiscrepancyDocument
from impact_rs_analysis.evidence.levels import Comparison, RecordingDocument, condition_scores, score_of, where_of
from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_analysis.evidence.rollouts import FreeMotion, Rollouts, rollouts_of
from impact_rs_analysis.evidence.tracks import Track
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.base import Joints
from impact_rs_sim.effects.depending import Depending
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array, JointType, RobotFacts
from impact_rs_trials.workers import Map

MAX_NUMBERS_AS_LEVELS = 8  # different numbers of a covariate that may be levels, such as sessions 1 to 5

Item = TypeVar("Item")
Output = TypeVar("Output")


@dataclass(frozen=True)
class Identity:
    """Identity of the measurements.

    Attributes:
        digest: Digest of all measurements; empty: not known.
        count: Number of runs, rows or recordings.
        conditions: Names of the conditions.
        recorded: Time of the last run, seconds since 1970; None: not known.
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
        unit: Unit of numbers; empty: not known.
        values: Values by cluster and row.
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
    """A sensitivity analysis: part of the measurements, or another assumption, with a separate verdict.

    Attributes:
        name: Name of the part or assumption, in words.
        source: The evidence.
        option: Command-line option that sets the assumption; empty: a part of the signals.
        of: Uncertain quantity; empty: the contact points.
        value: Assumed value, in the unit.
        unit: Unit.
    """

    name: str
    source: Source
    option: str = ""
    of: str = ""
    value: float = 0.0
    unit: str = ""


@dataclass(frozen=True)
class RequiredEffect:
    """An effect without which replays of some impacts hit nothing.

    Attributes:
        item: The effect with its estimate, from the distances of pads and objects at the impacts.
        size: Size of the residuals with the effect, as :meth:`Source.size`.
        missed: Number of impacts whose replay hits nothing without the effect.
        impacts: Number of all impacts.
    """

    item: ModelEffect
    size: float
    missed: int
    impacts: int


class Source(ABC):
    """Source of residuals and sensitivities: measurements, and a model that predicts them.

    Attributes:
        kind: Kind of measurement, as in documents.
        model: The model, to which effects are added.
        clusters: Residuals of the model.
        physics: Physics of one cluster under the model, for the number of joints.
        required: Alternative effects that make every replay hit where the declared model misses impacts, best first.
            The model has the first; its interval is a systematic error of all clusters. Empty: no impact is missed.
        without_required: Source with the declared model, without the runs whose impact it misses; None: no effect is
            required, or too few runs remain.
        worlds: All distinct physics of the clusters under the model, for bounds of parameters.
        repeated: Whether clusters hold repeats; if not, clusters are stretches of time.
        remarks: Remarks on the measurements, for the reader.
        impossible: Violation of a law that holds for every contact, such as a gain of energy; empty: no violation.
        comparison_remarks: Remarks for a comparison.
        runs: Runs of trials; None: recordings or a table of impacts.
        left_out: Path and reason of recordings that are too short; for trials see ``runs``.
        recording: How recordings were read; None: no recordings.
        discrepancy: Model discrepancy.
        size_is: Definition of :meth:`size`.
        not_measured: Quantities that were not measured.
        noise_by_joint: Whether the noise of every joint is unknown, so that gains are also judged joint by joint.
        residual_unit: Unit of the size of residuals without repeats.
        size_unit: Unit of :meth:`size`.
        pieces: Name of the clusters without repeats, plural.
        of_motion: Whether motion before and after an impact was measured, or the impact alone.
        clock: Largest offset between the clocks of commands and measurements, either way [s]; a delay shorter than this
            cannot be distinguished from it.
        least_change: Without repeats, smallest distance of a parameter's interval from nominal for an effect to be
            accepted [parameter scales]; 0: the relevance limits of the features decide.
        covariates: Circumstances on which an effect may depend.
        interleaved: Whether folds are interleaved; if not, a fold consists of neighbouring clusters.
        whole_units: Whether one unit (condition or recording) predicts another; if not, folds hold out parts of every
            unit.
        folds: Largest number of folds of the cross-validation; above five the held-out error changes little.
        state: Variables of the state that may be confounded with a covariate, such as the impact speed.
        progress: Called with (stage, done, total); None: not reported.
    """

    kind: Literal["trials", "recordings", "impacts"] = "trials"
    model: Model
    clusters: tuple[Cluster, ...]
    physics: Physics
    repeated: bool
    required: tuple[RequiredEffect, ...] = ()
    without_required: Source | None = None
    remarks: Sequence[str] = ()
    runs: Runs | None = None
    left_out: tuple[tuple[str, str], ...] = ()
    recording: RecordingDocument | None = None
    discrepancy: Discrepancy = NO_DISCREPANCY
    size_is: str = "size of the difference between measurement and model, in multiples of repeatability"
    not_measured: tuple[str, ...] = ()
    impossible: str = ""
    noise_by_joint: bool = False
    residual_unit: str = "N m"
    size_unit: str = TIMES
    pieces: str = "stretches of time"
    of_motion: bool = True
    clock: float = 0.0
    least_change: float = 1.0
    interleaved: bool = False
    whole_units: bool = True
    folds: int = 6
    progress: Callable[[str, int, int], None] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """State for a worker process, which does not report progress."""
        return {name: value for name, value in vars(self).items() if name not in ("progress", "without_required")}

    def report(self, stage: str, done: int = 0, total: int = 0) -> None:
        """Report progress; 0 of 0: nothing is expected to be done in this stage."""
        if self.progress is not None:
            self.progress(stage, done, total)

    @property
    def declared_model(self) -> Model:
        """The model as given, without the required effect (:attr:`required`)."""
        added = {required.item.name for required in self.required[:1]}
        effects = tuple(item for item in self.model.effects if item.name not in added)
        return self.model.model_copy(update={"effects": effects}) if added else self.model

    def size_by_declared_model(self, added: Added) -> float | None:
        """Size of all residuals by the declared model with effects; None: some replay hits nothing."""
        raise NotImplementedError

    @property
    def free_motion_part(self) -> Source | None:
        """Source of free motion alone, with equal cluster indices; None: its predictions are not cheaper."""
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
        """Closing and sliding speed of closing contacts, by symbol of formulas [m/s]; empty: no single impacts."""
        return {}

    @property
    def comparison_remarks(self) -> Sequence[str]:
        """See the class."""
        return self.remarks

    @property
    def proportion(self) -> Proportion:
        """Mass, length and time scale of the robot, for ranges of parameters and noticeable changes."""
        return Proportion.of(self.physics)

    @property
    def discrepancy_document(self) -> DiscrepancyDocument:
        """Entry of the model discrepancy in a document."""
        return self.discrepancy.document

    @property
    def worlds(self) -> Sequence[Physics]:
        """See the class."""
        return [self.physics]

    @property
    def joints(self) -> tuple[JointType, ...]:
        """Joint types, base to tip, of the arm whose parameters all arms share; empty without an arm.

        Raises:
            InputError: Arms with different joints have one name.
        """
        joints_of_arms = {(name, joints) for world in self.worlds for name, joints in world.arm_joints}
        if not self.model.arms and len({joints for _, joints in joints_of_arms}) > 1:
            arms = ", ".join(f"{name} with {len(joints)} joints" for name, joints in sorted(joints_of_arms))
            raise InputError(f"arms {arms}: parameters carry the name of their arm; expected a different name for each")
        arm = next(iter(self.physics.arms.values()), None)
        return () if arm is None else arm.facts.joint_types

    @property
    def identity(self) -> Identity:
        """Identity of the measurements; subclasses add runs or rows."""
        units = tuple(dict.fromkeys(item.unit for item in self.clusters))
        return Identity("", len(units), units)

    def size(self) -> float:
        """Size of the model's residuals, in multiples of repeatability (:func:`.size_of`) [-]."""
        return score_of(self.clusters)

    def noise_size(self) -> float | None:
        """:meth:`size` of noise alone; None without repeats."""
        return 1.0 if any(np.any(item.pure_error > 0.0) for item in self.clusters) else None

    def residual_weight(self, item: Cluster) -> Array:
        """Factors from scaled residuals to ``residual_unit``, without repeats, ``(F,)``."""
        return item.sigma

    def distribute(
        self, function: Callable[[Source, Item], Output], items: Sequence[Item], purpose: str
    ) -> list[Output]:
        """Results ``function(source, item)`` of all items, from parallel processes if predictions are expensive.

        Args:
            function: A pure function that can be pickled.
            items: Arguments.
            purpose: Purpose, shown as progress.
        """
        results = []
        self.report(purpose, 0, len(items))
        for item in items:
            results.append(function(self, item))
            self.report(purpose, len(results), len(items))
        return results

    @abstractmethod
    def predict(self, requests: Sequence[tuple[int, Added]], purpose: str) -> list[Array | None]:
        """Features, in their units, of clusters under the model with added effects.

        Args:
            requests: Pairs of a cluster's index and the added effects.
            purpose: Purpose, shown as progress.

        Returns:
            Features ``(F,)`` by request; None if a contact is missing, or if the effects leave no positive inertia.
        """

    def differences(self, numbers: Sequence[int], before: Added, after: Added, purpose: str) -> list[Array | None]:
        """Change of features with a change of effects, in their units.

        Args:
            numbers: Numbers of the clusters.
            before: Added effects before.
            after: Added effects after.
            purpose: Purpose, shown as progress.

        Returns:
            Changes ``(F,)`` by cluster; None if a prediction before or after fails.
        """
        predicted = self.predict([(number, added) for added in (before, after) for number in numbers], purpose)
        return [difference(a, b) for a, b in zip(predicted[: len(numbers)], predicted[len(numbers) :], strict=True)]

    @property
    def known_effects(self) -> dict[str, Effect]:
        """Effects that the source can predict, by name."""
        return self.model.known_effects

    def offers(self, effect: Effect) -> bool:
        """Whether a search considers an effect; no effects of the bare arm, nor of neighbours without neighbours."""
        has_neighbours = any(world.neighbours for world in self.worlds)
        return not effect.calibrates and (effect.acts_on != "neighbour" or has_neighbours)

    def starts(self, name: str) -> Sequence[Array]:
        """Additional initial values ``(p,)`` of the fit of an effect, suggested by the measurements."""
        del name
        return ()

    def with_dependences(self, effects: Sequence[Depending]) -> Source:
        """The source with effects that depend on covariates, and interleaved folds.

        Args:
            effects: Dependent effects, with distinct names.
        """
        raise NotImplementedError(f"{type(self).__name__} has no covariates")

    def searched(self) -> Source:
        """The source for a search: all measurements, or a subsample of a large table."""
        return self

    def unseen(self, searched: Source, added: Added) -> tuple[str, ...]:
        """Remarks on the error of effects for rows outside the subsample of :meth:`searched`.

        Args:
            searched: Subsample of the search.
            added: Effects of the search, added to the model.
        """
        del searched, added
        return ()

    def views(self) -> tuple[View, ...]:
        """Parts of the measurements and other assumptions, each with a separate verdict (sensitivity analysis)."""
        return ()

    def compare_levels(self) -> Comparison:
        """Residuals of the model by level, signal and condition."""
        return Comparison({}, tuple(where_of(self.clusters)), condition_scores(self.clusters))

    def tracks(self, map_tasks: Map, added: Added = ()) -> tuple[Track, ...]:
        """Measured and predicted signals over time.

        Args:
            map_tasks: Parallel map.
            added: Effects added to the model; for recordings and tables a second curve.
        """
        del map_tasks, added
        return ()

    def joint_sizes(self, residuals: Sequence[Array]) -> list[tuple[str, float, float, str]]:
        """Joint, rms residual torque, noise and unit, for recordings of one arm.

        Args:
            residuals: Residuals by cluster, ``(F,)`` [-].
        """
        del residuals
        return []

    def free_motions(self, numbers: Sequence[int] | None = None) -> tuple[FreeMotion, ...]:
        """Motions without contact for rollouts of the model; empty if the driving torque is not known.

        Args:
            numbers: Indices of the clusters that contain the motions; None: all measurements.
        """
        del numbers
        return ()

    def rollouts(self, parts: Sequence[tuple[FreeMotion, Added]] | None = None) -> Rollouts | None:
        """Rollouts of the model; None if motions are too short, an arm has no inertia, or a load is not finite.

        Args:
            parts: Motions, each with effects added to the model; None: all motions, without added effects.
        """
        parts = [(motion, ()) for motion in self.free_motions()] if parts is None else parts
        try:
            return rollouts_of([motion for motion, _ in parts], [self._rolled(*part) for part in parts])
        except (InputError, np.linalg.LinAlgError):  # a body without positive inertia, or a load that diverges
            return None

    def _rolled(self, motion: FreeMotion, added: Added) -> Physics:
        """Physics of a motion with effects."""
        physics = motion.physics
        for name, values in added:
            physics = self.known_effects[name].apply_vector(physics, np.array(values))
        return physics

    @abstractmethod
    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """Residuals of the model with effects, on the scale of ``like``; None if they cannot be simulated."""


def with_per_arm_parameters(model: Model, worlds: Iterable[Physics], each_arm: bool = False) -> Model:
    """The model with separate effect parameters for every arm, where arms do not share them.

    Arms of one kind share parameters: two arms have half as many, and the motion of one arm informs about the other.
    Arms of different kinds have separate parameters.

    Args:
        model: The model; one with arms is returned unchanged.
        worlds: All measured physics.
        each_arm: Whether also arms of one kind have separate parameters.

    Raises:
        InputError: ``each_arm``, and several robots have one name.
    """
    kinds_of_arm: dict[str, list[RobotFacts]] = {}
    for physics in worlds:
        for name, arm in physics.arms.items():
            kinds = kinds_of_arm.setdefault(name, [])
            if arm.facts not in kinds:
                kinds.append(arm.facts)
    several = [name for name, kinds in kinds_of_arm.items() if len(kinds) > 1]
    if each_arm and several:
        raise InputError(f"arm {several[0]!r} is another robot in another scenario; expected another name for each")
    first = next(iter(kinds_of_arm.values()), [])
    alike = all(kinds == first for kinds in kinds_of_arm.values())
    if model.arms or several or (alike and not each_arm):
        return model
    return model.model_copy(update={"arms": {name: _joints_of(kinds[0]) for name, kinds in kinds_of_arm.items()}})


def _joints_of(facts: RobotFacts) -> Joints:
    """The joints of an arm as in a model file."""
    return facts.joint_types if "prismatic" in facts.joint_types else facts.joint_count
