# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts as a source of evidence: the impact map predicts the velocities just after the impact of every row.

Features are the post-impact velocities: of the joints, of the body's centre, and its angular velocity. Velocities of a
free body are in contact axes, which are comparable between rows: along the ``normal``, along the ``sliding`` direction
just before the impact, and ``across`` both. Velocities of an object hit by an arm are in x, y and z. Two kinds of
clusters:

* **Conditions.** With enough repeats a cluster is a condition. Every repeat is predicted from its own ante-impact
  state, and the prediction of a condition is the mean over its repeats, so that its mean residual is linear in the
  error of the map. The pure error is the scatter of the repeats. Rows under different circumstances (covariates) are no
  repeats of each other: a condition has a cluster for each level, and for the lower and the upper half of a number.
  Clusters of one condition are held out together.
* **Blocks.** Without repeats a cluster is a block of neighbouring rows, like a stretch of a recording. The scatter of
  the scores between blocks replaces the pure error. Blocks are held out in runs of neighbours, with a guard on either
  side, because drift from row to row (wear, the person who tosses) would leak into the prediction.

Linear and angular velocities of blocks are weighted by kinetic energy. A difference du of a row is converted to the
velocity at which the body has equal energy, coordinate by coordinate,

    d = sqrt(sum_i H_ii du_i^2 / m)                                      [m/s]

with H the inertia of body and joints, motors included, and m the mass of the body: the energy norm of the difference
where H is diagonal, as for a free body with equal moments of inertia. Every entry has the scale

    sigma_i = s / sqrt(H_ii / m),        s^2 = mean of d^2 over the rows / number of entries of a row

so that fits minimise the reported error. A distance measured in place of a velocity is converted to a velocity
(:mod:`impact_rs_trials.recordings.impacts.distances`). Scaling each signal by its residual would be wrong: the signal
with the largest effect of a missing term would then have the smallest weight in its estimate.

Tables of arms have a discrepancy of the rigid map (:mod:`impact_rs_analysis.evidence.tables.map_discrepancy`): with
repeats a part of sigma, without repeats a part of the expected residual. Joints and object are also judged separately,
and so are other contact points where they may decide the verdict (:meth:`ImpactTableSource.views`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy

from impact_rs_analysis.evidence.calibration import with_intervals
from impact_rs_analysis.evidence.cluster import TIMES, Added, Cluster, pooled_error
from impact_rs_analysis.evidence.discrepancy import DiscrepancyDocument
from impact_rs_analysis.evidence.levels import (
    Comparison,
    ConditionScore,
    condition_scores,
    level_of,
    rounded,
    where_of,
    where_of_blocks,
)
from impact_rs_analysis.evidence.minimum_data import MIN_DEGREES_OF_FREEDOM
from impact_rs_analysis.evidence.source import (
    Covariate,
    Identity,
    Item,
    Output,
    Source,
    View,
    with_per_arm_parameters,
)
from impact_rs_analysis.evidence.tables.map_discrepancy import (
    NO_MAP_DISCREPANCY,
    MapDiscrepancy,
    measured_map_discrepancy,
)
from impact_rs_analysis.evidence.tables.neighbour_noise import nearest_neighbour_noise
from impact_rs_analysis.evidence.tables.row_groups import (
    RowGroup,
    blocks,
    by_circumstance,
    conditions,
    evenly,
)
from impact_rs_analysis.evidence.tables.row_predictions import MAX_ALTERED, RowPredictions, cache_size
from impact_rs_analysis.evidence.tables.table_entries import TableEntries, turned
from impact_rs_analysis.evidence.tracks import ComparedSignal, Track
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.depending import Depending
from impact_rs_sim.effects.formula import CONTACT_SYMBOLS
from impact_rs_sim.effects.sensing import MIRRORED_SPINS, SPIN_AXES, TRACKED_POINT_OF_IMPACT, TWIST_AXES
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.measured import MeasuredImpacts
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.recent import Recent
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.impacts.impact_checks import OtherAxes, other_axes, warnings_of
from impact_rs_trials.recordings.impacts.impact_columns import CONDITION, N_NOISE, P_NOISE, V_NOISE, W_NOISE
from impact_rs_trials.recordings.impacts.impact_table import MAX_TOLERANCE_FACTOR, ImpactTable
from impact_rs_trials.workers import Map

MAX_SMALL_BLOCKS = 120  # at most, where effects may depend on covariates
MIN_SCALE_M_S = 1e-6  # m/s; a model with smaller residuals is exact
MAX_SEARCHED_ROWS_OF_ARMS = 96  # rows of a larger table that a search uses; four in each block
MAX_SEARCHED_ROWS_OF_BODIES = 960  # for free bodies, whose map takes a twentieth of the time
FOLDS_OF_LARGE_TABLE = 3  # rows outside the search are held out as well
SEARCHED_ROWS_OF_LEVEL = 24  # rows by level of a covariate that a search uses
MAX_DISTINCT_NUMBERS = 32  # numbers of a covariate; the mean of a group is within some hundredths of the range
MAX_NEIGHBOUR_SCATTER_RATIO = 0.8  # over the residual of the model; a larger scatter of neighbours is not reported
MAX_LEVELS_SHOWN = 8  # levels of a covariate in a remark
MIN_CONTACT_CHANGE_RATIO = 0.2  # over the residual of the model; a larger change by other contacts may decide a verdict
MAX_ENERGY_RATIO = 1.05  # kinetic energy after over before; rows above it are reported
MIN_ROWS_OF_ENERGY = 3  # rows whose mean is judged
ENERGY_CONFIDENCE = 0.999  # one-sided confidence of the mean of all rows, for an energy that no impact allows

NO_DISCREPANCY_REMARK = (
    "model discrepancy of the rigid impact map is taken as 0: finite duration and compliance of real impacts count "
    "against the model"
)
PARTS_OF_ROW = ("joints", "object")  # parts of a row of an arm that are also judged separately
NO_REPEATS_REMARK = (
    f"too few rows are repeats of each other (column '{CONDITION.header}'), so blocks of neighbouring rows are held "
    "out instead"
)
NO_NOISE_REMARK = (
    f"the noise is not known: there are neither repeats nor columns '{V_NOISE.header}' and '{W_NOISE.header}'; "
    "unexplained residuals may be noise"
)

LEVEL_TEXT = "velocities just after every impact, measured and predicted by the impact map from the state before"
SIZE_TEXT_WITH_REPEATS = (
    "size of the difference between measured and predicted velocities over all conditions, in multiples of "
    "repeatability"
)
SIZE_TEXT_WITHOUT_REPEATS = (
    "root mean square over the impacts of measured minus predicted velocity; angular and joint velocities are weighted "
    "by their kinetic energy"
)


@dataclass(frozen=True)
class _Comparison:
    """Measurements, model and settings of a comparison.

    Attributes:
        table: The measurements.
        model: The model.
        predictions: Predictions of the rows.
        groups: Rows by cluster.
        repeated: Whether clusters are conditions with repeats.
        columns: Indices of the entries that are compared.
        map_tasks: Parallel map of :meth:`ImpactTableSource.distribute`; None: this process.
        interleaved: See :attr:`Source.interleaved`.
        cached_feature_sets: Number of sets of effects whose features are cached.
    """

    table: ImpactTable
    model: Model
    predictions: RowPredictions
    groups: tuple[RowGroup, ...]
    repeated: bool
    columns: tuple[int, ...]
    map_tasks: Map | None
    interleaved: bool = False
    cached_feature_sets: int = MAX_ALTERED


class ImpactTableSource(Source):
    """A table of impacts against the impact map of a model.

    Args:
        table: The measurements.
        model: The model.
        each_arm: Whether arms of one kind have separate parameters.
        discrepancy: Discrepancy of the rigid map, for arms; None: as measured.
        remarks: Whether to look for remarks.
        map_tasks: Parallel map of :meth:`distribute`; None: this process.

    Attributes:
        entries: All entries of the rows.
        predicted: Compared entries of the model, ``(rows, F)`` [rad/s, m/s, m].
        measured: Measured u^+, as ``predicted``.

    Raises:
        InputError: The impact map has no solution for some row.
    """

    kind = "impacts"
    not_measured = ("motion before and after", "torques", "forces")
    residual_unit = "m/s"
    pieces = "blocks of rows"
    of_motion = False
    least_change = 0.0  # relevance limits decide; rows are independent, unlike samples of a torque

    def __init__(
        self,
        table: ImpactTable,
        model: Model,
        each_arm: bool = False,
        discrepancy: MapDiscrepancy | None = None,
        remarks: bool = True,
        map_tasks: Map | None = None,
    ) -> None:
        model = with_per_arm_parameters(model, [row.physics for row in table.rows], each_arm)
        discrepancy = measured_map_discrepancy() if discrepancy is None else discrepancy
        distinct = {id(row.physics): row.physics for row in table.rows}
        index_of = {number: index for index, number in enumerate(distinct)}
        entries = TableEntries(
            table=replace(table, variants=()),
            worlds=tuple(model.apply(physics) for physics in distinct.values()),
            world_of=tuple(index_of[id(row.physics)] for row in table.rows),
            map_discrepancy=discrepancy if table.arms else NO_MAP_DISCREPANCY,
        )
        groups = conditions(table)
        self._adopt(
            _Comparison(
                table=table,
                model=model,
                predictions=RowPredictions.of(entries, model.known_effects),
                groups=tuple(blocks(table) if groups is None else groups),
                repeated=groups is not None,
                columns=_columns(table, joints=table.joints, body=True),
                map_tasks=map_tasks,
            )
        )
        self.impossible = self._energy_gain()
        self.remarks = tuple(self._remarks()) if remarks else ()

    def _adopt(self, comparison: _Comparison) -> None:
        """Predict the rows and compute the clusters of a comparison."""
        self._comparison, self._predictions, self._groups = comparison, comparison.predictions, comparison.groups
        self.table, self.model = comparison.table, comparison.model
        self.repeated, self.interleaved = comparison.repeated, comparison.interleaved
        self.entries = entries = comparison.predictions.entries
        self.physics = entries.worlds[0]
        self.size_unit = TIMES if self.repeated else self.residual_unit
        self.size_is = SIZE_TEXT_WITH_REPEATS if self.repeated else SIZE_TEXT_WITHOUT_REPEATS
        self._columns = columns = list(comparison.columns)
        self._feature_cache = Recent[list[Array | None]](comparison.cached_feature_sets)
        self.signals, self.energy_weights = (
            tuple(entries.signals[column] for column in columns),
            entries.energy_weights[:, columns],
        )
        self.measured = entries.measured[:, columns]
        self.noise = None if entries.noise is None else entries.noise[:, columns]
        self.predicted = self.predicted_with(())
        self.clusters = self._clusters()

    def _copy_with(self, comparison: _Comparison) -> ImpactTableSource:
        """A source of these measurements with another comparison."""
        source = ImpactTableSource.__new__(ImpactTableSource)
        source._adopt(comparison)
        source.impossible, source.remarks, source.folds = self.impossible, self.remarks, self.folds
        return source

    def __getstate__(self) -> dict[str, Any]:
        """State for another process, without variants of the table, parallel map and caches."""
        chosen = replace(self._comparison, map_tasks=None, table=self.entries.table)
        bare = {"_comparison": chosen, "table": chosen.table, "_feature_cache": Recent(chosen.cached_feature_sets)}
        return {**super().__getstate__(), **bare}

    @property
    def covariates(self) -> tuple[Covariate, ...]:
        """See :attr:`Source.covariates`."""
        rows, units = self.table.rows, self.table.covariates
        return tuple(self._covariate(name, units[name], [row.circumstances[name] for row in rows]) for name in units)

    @property
    def state(self) -> tuple[Covariate, ...]:
        """See :attr:`Source.state`: the impact speed."""
        return (self._covariate("impact speed", "m/s", self.entries.impacts.closing_speeds.tolist()),)

    @property
    def contact_speeds(self) -> dict[str, Array]:
        """See :attr:`Source.contact_speeds`."""
        contact = self.entries.impacts.contacts(self.entries.physics_of_rows)
        closes = contact.closing > 0.0
        return dict(zip(CONTACT_SYMBOLS, (contact.closing[closes], contact.slip[closes]), strict=True))

    def _covariate(self, name: str, unit: str, values: Sequence[float | str]) -> Covariate:
        """A covariate from its values by row."""
        return Covariate(name, unit, tuple(tuple(values[row] for row in group.rows) for group in self._groups))

    def with_dependences(self, effects: Sequence[Depending]) -> ImpactTableSource:
        """See :meth:`Source.with_dependences`; many different numbers are replaced by means of groups of close ones.

        Blocks are small: a session may have few rows, and a test by signs of blocks needs several in each.
        """
        chosen = self._comparison
        if not chosen.repeated and not chosen.interleaved:
            chosen = replace(chosen, groups=tuple(blocks(self.table, MAX_SMALL_BLOCKS)), interleaved=True)
        shown = {name: self._grouped_covariate(name) for name in dict.fromkeys(effect.covariate for effect in effects)}
        predictions = self._predictions.with_dependences(effects, shown)
        return self._copy_with(
            replace(chosen, predictions=predictions, cached_feature_sets=cache_size(self.entries, 4))
        )

    def _grouped_covariate(self, name: str) -> list[float | str]:
        """A covariate by row; above ``MAX_DISTINCT_NUMBERS`` different numbers, means of groups of equal size."""
        values = [row.circumstances[name] for row in self.table.rows]
        numbers = np.array([value for value in values if isinstance(value, float)])
        if len(set(values)) <= MAX_DISTINCT_NUMBERS or not numbers.size:
            return values
        for group in np.array_split(np.argsort(numbers, kind="stable"), MAX_DISTINCT_NUMBERS):
            numbers[group] = numbers[group].mean()
        return list(numbers.tolist())

    def offers(self, effect: Effect) -> bool:
        """See :meth:`Source.offers`; effects of sensors need a free body whose angular velocity was measured."""
        turned = bool(self.table.turning and not self.table.arms)
        measurable = {
            MIRRORED_SPINS.name: bool(self.starts(MIRRORED_SPINS.name)),
            TWIST_AXES.name: bool(self.starts(TWIST_AXES.name)),
            TRACKED_POINT_OF_IMPACT.name: self._oriented,
        }
        return super().offers(effect) and (
            effect.acts_on != "sensing" or (turned and measurable.get(effect.name, effect.name == SPIN_AXES.name))
        )

    @property
    def _oriented(self) -> bool:
        """Whether the orientation of the body was measured, which moves a tracked point."""
        return any(np.any(row.impact.object.rotation != np.eye(3)) for row in self.table.rows)

    def starts(self, name: str) -> Sequence[Array]:
        """See :meth:`Source.starts`: rotations of axes by right angles that the laws of every contact favour.

        At a half turn the sensitivities are at right angles to the change by the half turn, so a fit that starts there
        does not move; it starts at two thirds of the half turn.
        """
        # With other readings in the model, the axes of the table are not the axes of the model.
        exact = all(world.twist_readings.exact for world in self._predictions.worlds)
        kinds = {SPIN_AXES.name: ("spins", 1.0), MIRRORED_SPINS.name: ("spins", -1.0), TWIST_AXES.name: ("twists", 1.0)}
        if name not in kinds or not exact:
            return ()
        suggestions = [axes for axes in self._other_axes if (axes.of, axes.sign) == kinds[name]]
        tail = [-1.0] if name == MIRRORED_SPINS.name else []
        shares = [2.0 / 3.0 if np.linalg.norm(axes.vector) > 0.9 * np.pi else 1.0 for axes in suggestions]
        return [np.append(share * axes.vector, tail) for share, axes in zip(shares, suggestions, strict=True)]

    @cached_property
    def _other_axes(self) -> list[OtherAxes]:
        """See :func:`impact_rs_trials.recordings.impacts.impact_checks.other_axes`."""
        return other_axes(self.table)

    @property
    def known_effects(self) -> dict[str, Effect]:
        """See :attr:`Source.known_effects`."""
        return dict(self._predictions.effects)

    @property
    def discrepancy_document(self) -> DiscrepancyDocument:
        """See :attr:`Source.discrepancy_document`: of the rigid map, for arms."""
        return self.entries.map_discrepancy.document

    def searched(self) -> ImpactTableSource:
        """See :meth:`Source.searched`: evenly spaced rows, or conditions with their repeats, and rows of each level."""
        enough = MAX_SEARCHED_ROWS_OF_ARMS if self.table.arms else MAX_SEARCHED_ROWS_OF_BODIES
        if len(self.table.rows) <= enough:
            return self
        chosen = set() if self.repeated else evenly(range(len(self.table.rows)), enough)
        if self.repeated:
            most = max(enough // len(self._groups), MIN_DEGREES_OF_FREEDOM)
            several = [number for number, group in enumerate(self._groups) if len(group.rows) > 1]
            single = [number for number, group in enumerate(self._groups) if len(group.rows) == 1]
            groups = evenly(several, enough // most)  # without repeats the noise is unknown
            groups |= evenly(single, enough // most - len(groups))
            chosen |= {row for group in groups for row in evenly(self._groups[group].rows, most)}
        for name in self.table.covariates:
            values = [row.circumstances[name] for row in self.table.rows]
            for level in dict.fromkeys(value for value in values if isinstance(value, str)):
                chosen |= evenly([n for n, value in enumerate(values) if value == level], SEARCHED_ROWS_OF_LEVEL)
        if len(chosen) == len(self.table.rows):
            return self
        subsample = self._of(self.table.part(sorted(chosen)), remarks=False)
        subsample.remarks, subsample.folds = self.remarks, FOLDS_OF_LARGE_TABLE
        return subsample

    def unseen(self, searched: Source, added: Added) -> tuple[str, ...]:
        """See :meth:`Source.unseen`."""
        if searched is self:
            return ()
        assert isinstance(searched, ImpactTableSource)
        searched_rows = {row.number for row in searched.table.rows}
        unsearched = [index for index, row in enumerate(self.table.rows) if row.number not in searched_rows]
        before, after = (
            self._energy_norm((self.measured - predicted)[unsearched], unsearched)
            for predicted in (self.predicted, self.predicted_with(added) if added else self.predicted)
        )
        noise = (
            "" if self.noise is None else f" (noise alone: {self._energy_norm(self.noise[unsearched], unsearched):.3g})"
        )
        fall = f"falls from {before:.3g} to {after:.3g} m/s" if added else f"is {before:.3g} m/s"
        return (
            f"{len(searched_rows)} of {len(self.table.rows)} rows were searched, evenly taken: effects and intervals "
            f"are theirs. On the {len(unsearched)} others the error {fall}{noise}",
        )

    def distribute(
        self, function: Callable[[Source, Item], Output], items: Sequence[Item], purpose: str
    ) -> list[Output]:
        """See :meth:`Source.distribute`."""
        tasks = self._comparison.map_tasks
        if tasks is None:
            return super().distribute(function, items, purpose)
        return list(tasks(partial(function, self), items))

    def views(self) -> tuple[View, ...]:
        """See :meth:`Source.views`.

        Joints and object of an arm, other contact points where they may decide, and other values of unsure quantities.
        """
        views = [View(name, part) for name, part in self._parts().items()]
        for times in (1.0 / MAX_TOLERANCE_FACTOR, MAX_TOLERANCE_FACTOR):
            if self._contacts_matter(times):
                how = f"points within {1e3 * times * self.table.tolerance:g} mm"
                views.append(View(how, self._with_contacts(times), "--contact-tolerance"))
        for variant in self.table.variants:
            source = self._of(variant.table, remarks=False)
            name = f"{variant.of} = {variant.value:.4g} {variant.unit}".removesuffix(" -")
            views.append(View(name, source, "--unsure", variant.of, variant.value, variant.unit))
        return tuple(views)

    @property
    def identity(self) -> Identity:
        """See :attr:`Source.identity`; without repeats the table is its only condition."""
        names = tuple(item.name for item in self.clusters) if self.repeated else (self.table.path.name,)
        return Identity(self.table.digest, len(self.table.rows), names)

    def _parts(self) -> dict[str, ImpactTableSource]:
        """Sources of joints and object of an arm; empty without an arm, or if only the object was measured."""
        if not (self.table.arms and self.table.joints):
            return {}
        columns = {name: _columns(self.table, joints=name == "joints", body=name == "object") for name in PARTS_OF_ROW}
        return {name: self._copy_with(replace(self._comparison, columns=columns[name])) for name in PARTS_OF_ROW}

    @property
    def comparison_remarks(self) -> Sequence[str]:
        """See :attr:`Source.comparison_remarks`; with the sizes for joints and object, and by covariate."""
        sizes = ", ".join(f"{name} {part.size():.3g}" for name, part in self._parts().items())
        remarks = [f"apart: {sizes} {self.size_unit}"] if sizes else []
        squares = np.sum(np.square((self.measured - self.predicted) * self.energy_weights), axis=1)
        for name in self.table.covariates:
            groups = by_circumstance(self.table, name, range(len(squares)))
            parts = {label: float(np.sqrt(np.mean(squares[rows]))) for label, rows in groups.items()}
            first = sorted(parts.items())[:MAX_LEVELS_SHOWN]
            shown = ", ".join(f"{size:.3g} m/s with {label}" for label, size in first)
            hidden = len(parts) - MAX_LEVELS_SHOWN
            remarks.append(f"differences by {name}: {shown}{f' and {hidden} more' if hidden > 0 else ''}")
        return (*self.remarks, *remarks)

    @property
    def proportion(self) -> Proportion:
        """See :attr:`Source.proportion`; for a free body by its mass, moments of inertia and closing speed."""
        return (
            Proportion.of(self.physics)
            if self.table.arms
            else Proportion.of_body(self.physics.object, self.entries.speed)
        )

    def residual_weight(self, item: Cluster) -> Array:
        """See :meth:`Source.residual_weight`; the mean over all entries of a row times their number is d^2."""
        rows = next(group.rows for group in self._groups if group.name == item.name)
        worth = self.energy_weights[list(rows)]
        worth = worth.mean(axis=0) if self.repeated else worth.ravel()
        return np.asarray(item.sigma * worth * np.sqrt(len(self.signals)))

    def predict(self, requests: Sequence[tuple[int, Added]], purpose: str) -> list[Array | None]:
        """See :meth:`Source.predict`."""
        del purpose
        features = {added: self._features(added) for added in dict.fromkeys(added for _, added in requests)}
        return [features[added][number] for number, added in requests]

    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """See :meth:`Source.residuals_with`; every repeat starts from its own state."""
        numbers = {item.name: number for number, item in enumerate(self.clusters)}
        entries = self._predicted_entries(added)
        result = []
        for item in like:
            number = numbers[item.name]
            rows = self._rows(number, entries)
            if rows is None:
                return None
            residuals = self.measured[list(self._groups[number].rows)] - rows
            residuals = residuals if self.repeated else residuals.reshape(1, -1)
            result.append(replace(item, residuals=residuals / item.sigma))
        return result

    def predicted_with(self, added: Added) -> Array:
        """u^+ of all rows for the model with effects, as ``predicted``, ``(rows, nv)`` [rad/s, m/s].

        Raises:
            InputError: The effects give a body without positive inertia, or some row has no solution.
        """
        predicted = self._predicted_entries(added)
        if predicted is None:
            raise InputError("with these effects the body has no positive inertia", file=self.table.path)
        unsolved = np.flatnonzero(np.isnan(predicted).any(axis=1))
        if unsolved.size:
            row = self.table.rows[unsolved[0]]
            raise InputError("no velocities obey the contact laws", file=self.table.path, key=f"row {row.number}")
        return predicted

    def predict_row(self, row: int, added: Sequence[Added]) -> list[Array | None]:
        """u^+ of one row for the model with each of some sets of effects, solved together, ``(nv,)`` [rad/s, m/s].

        Args:
            row: Position of the row.
            added: Sets of effects.

        Returns:
            None where the effects give a body without positive inertia, or no velocities obey the laws.
        """
        predictions = [
            None if values is None else values[self._columns] for values in self._predictions.one_row(row, added)
        ]
        return [None if values is None or np.isnan(values).any() else values for values in predictions]

    def map_discrepancy_of(self, row: int) -> Array:
        """Discrepancy of the rigid map of the entries of a row that are compared, ``(F,)``."""
        if not self.table.arms:
            return np.zeros(len(self.signals))
        entries = self.entries
        world, speed = entries.worlds[entries.world_of[row]], float(entries.impacts.closing_speeds[row])
        return entries.discrepancy_of(row, world, speed)[self._columns]

    def size(self) -> float:
        """See :meth:`Source.size`; without repeats, root mean square over the rows of d of the module [m/s]."""
        if self.repeated:
            return super().size()
        return self._energy_norm(self.measured - self.predicted)

    def noise_size(self) -> float | None:
        """Value of :meth:`size` if only noise is left; None if the noise is not known."""
        if self.repeated:
            return super().noise_size()
        if self.noise is None:
            return None
        return self._energy_norm(self.noise)

    def compare_levels(self) -> Comparison:
        """See :meth:`Source.compare_levels`: the velocities just after the impact."""
        phases = tuple(dict.fromkeys(feature.phase for item in self.clusters for feature in item.features))
        whole = ConditionScore(name=self.table.path.name, repeats=len(self.clusters), score=rounded(self.size()))
        return Comparison(
            levels={"impacts": level_of(LEVEL_TEXT, self.clusters, phases)},
            where=tuple((where_of if self.repeated else where_of_blocks)(self.clusters)),
            conditions=condition_scores(self.clusters) if self.repeated else (whole,),
        )

    def tracks(self, map_tasks: Map, added: Added = ()) -> tuple[Track, ...]:
        """See :meth:`Source.tracks`: measured and predicted velocities by row, for a scatter plot."""
        del map_tasks
        predictions = {"the model": self.predicted}
        if added:
            with_effects = self.predicted_with(added)
            predictions = {"model": self.predicted, "model with the effects found": with_effects}
        number = np.array([float(row.number) for row in self.table.rows])
        return tuple(
            Track(
                label=label,
                time=number,
                curves=tuple(
                    ComparedSignal(f"{feature.signal} {feature.index}", feature.unit, self.measured[:, i], values[:, i])
                    for i, feature in enumerate(self.signals)
                ),
            )
            for label, values in predictions.items()
        )

    @property
    def worlds(self) -> Sequence[Physics]:
        """See :attr:`Source.worlds`."""
        return self._predictions.worlds

    def _rows(self, number: int, entries: Array | None) -> Array | None:
        """Rows of a cluster in the entries of all rows, ``(n, F)``; None without a solution."""
        rows = None if entries is None else entries[list(self._groups[number].rows)]
        return None if rows is None or np.isnan(rows).any() else rows

    def _features(self, added: Added) -> list[Array | None]:
        """:meth:`predict` of every cluster, cached: a diagnosis repeats requests."""

        def features() -> list[Array | None]:
            entries = self._predicted_entries(added)
            clusters = [self._rows(number, entries) for number in range(len(self._groups))]
            return [rows if rows is None else rows.mean(axis=0) if self.repeated else rows.ravel() for rows in clusters]

        return self._feature_cache.of(added, features)

    def _predicted_entries(self, added: Added) -> Array | None:
        """Compared entries of all rows with effects, ``(rows, F)``, nan without solution; None: no positive inertia."""
        entries = self._predictions.all_rows(added)
        return None if entries is None else entries[:, self._columns]

    @property
    def _map_discrepancy(self) -> Array:
        """Discrepancy of the rigid map of the compared entries, rms over the rows, ``(F,)``."""
        return self.entries.discrepancy[self._columns]

    def _clusters(self) -> tuple[Cluster, ...]:
        residuals = self.measured - self.predicted
        limit = np.array([feature.relevance_limit for feature in self.signals]) / 2.0
        if self.repeated:
            pooled = pooled_error([residuals[list(group.rows)] for group in self._groups])
            assert pooled is not None
            self._pooled, stated = pooled, self._stated_noise()
            pure = pooled if stated is None else np.maximum(pooled, stated)
            sigma = np.broadcast_to(np.sqrt(pure**2 + limit**2 + self._map_discrepancy**2), residuals.shape)
            noise = np.broadcast_to(pure, residuals.shape)
        else:
            sigma = max(self.size() / np.sqrt(len(self.signals)), MIN_SCALE_M_S) / self.energy_weights
            noise = np.zeros_like(residuals) if self.noise is None else self.noise
        return with_intervals(self, [self._cluster(group, residuals, sigma, noise) for group in self._groups])

    def _cluster(self, group: RowGroup, residuals: Array, sigma: Array, noise: Array) -> Cluster:
        rows = list(group.rows)
        shown = rows[:1] if self.repeated else rows
        features = tuple(replace(feature, phase=self._phase(row)) for row in shown for feature in self.signals)
        scaled = residuals[rows] / sigma[rows]
        first = self.table.rows[rows[0]]
        return Cluster(
            name=group.name,
            condition_key=(
                self.table.path.name,
                first.object_name,
                (first.condition or group.name) if self.repeated else "",
            ),
            layout="impacts" if self.repeated else group.name,
            unit=group.unit,
            contact=True,
            features=features,
            residuals=scaled if self.repeated else scaled.reshape(1, -1),
            sigma=sigma[shown].ravel(),
            pure_error=(noise[shown] / sigma[shown]).ravel(),
            discrepancy=(self._map_discrepancy / sigma[shown]).ravel(),
            discrepancy_key=group.name if self.entries.kinds[rows[0]] == "oblique" else None,
            timestamps=np.array(rows, dtype=float) if self.repeated else None,
        )

    def _phase(self, number: int) -> str:
        """Phase name of a row: the part of the body that is hit."""
        row = self.table.rows[number]
        if row.impact.arms:
            return "on the pad"
        if row.physics.object.round:
            return "of a ball"
        of_shape = {"cylinder": ("on its rim", "on its wall"), "capsule": ("on an end", "on its wall")}
        corner, edge = of_shape.get(row.physics.object.shape.kind, ("on a corner", "on an edge"))
        return {1: corner, 2: edge}.get(len(row.impact.points), "on a face")

    def _remarks(self) -> list[str]:
        remarks = [*warnings_of(self.table), *self.table.assumed]
        if not self.entries.map_discrepancy.entries:
            remarks.append(NO_DISCREPANCY_REMARK)
        if not self.repeated:
            remarks.append(NO_REPEATS_REMARK)
            if self.noise is None:
                remarks.append(NO_NOISE_REMARK)
                scatter = self.scatter_of_neighbours(self.measured - self.predicted)
                if scatter is not None and scatter < MAX_NEIGHBOUR_SCATTER_RATIO * self.size():
                    remarks.append(
                        f"impacts of neighbouring states scatter by {scatter:.3g} m/s: larger residuals of the model "
                        "are no noise"
                    )
        if (unsure := self._contact_remark()) is not None:
            remarks.append(unsure)
        if self.repeated and (stated := self._stated_noise()) is not None:
            ratio = float(np.sqrt(np.mean(np.square(self._pooled / np.maximum(stated, MIN_SCALE_M_S)))))
            remarks.append(
                f"repeats scatter {ratio:.2g} times as much as the noise columns say; the larger of both is used for "
                "every velocity"
            )
        contact_noise = (
            0.0 if self.noise is None else self._energy_norm(self.entries.noise_of_contacts[:, self._columns])
        )
        if contact_noise > 0.0:
            remarks.append(
                f"position and normal of the contacts, known to {P_NOISE.first} and {N_NOISE.first}, are "
                f"{contact_noise:.2g} m/s of the noise"
            )
        ratios = zip(self.table.rows, self._energy_ratios, strict=True)
        gained = [row.number for row, ratio in ratios if ratio > MAX_ENERGY_RATIO]
        if gained and not self.impossible:
            shown = ", ".join(str(number) for number in gained[:5]) + (" ..." if len(gained) > 5 else "")
            remarks.append(
                f"{len(gained)} of {len(self.table.rows)} rows leave with over "
                f"{100.0 * (MAX_ENERGY_RATIO - 1.0):.0f} % more kinetic energy than before (rows {shown}), which no "
                "impact can cause: an external force acted, or velocities are wrong"
            )
        if self.table.unread:
            remarks.append(f"columns that are not used: {', '.join(self.table.unread)}")
        return remarks

    def _with_contacts(self, times: float) -> ImpactTableSource:
        """These measurements with the contact points of another tolerance.

        Args:
            times: The tolerance over that of the table, ``MAX_TOLERANCE_FACTOR`` or its inverse [-].
        """
        rows = []
        for row in self.table.rows:
            impact = row.wider if times > 1.0 else row.narrower
            rows.append(replace(row, impact=row.impact if impact is None else impact, wider=None, narrower=None))
        table = replace(self.table, rows=tuple(rows), tolerance=times * self.table.tolerance)
        return self._of(table, remarks=True)

    def _of(self, table: ImpactTable, remarks: bool) -> ImpactTableSource:
        """Source of another table with this model."""
        source = ImpactTableSource(
            table, self.model, False, self.entries.map_discrepancy, remarks, self._comparison.map_tasks
        )
        source.folds = self.folds
        return source

    def _contacts_moved(self, times: float) -> float:
        """Change of predictions with the contact points of another tolerance, as :meth:`size` [m/s]."""
        alternatives = [(n, row.wider if times > 1.0 else row.narrower) for n, row in enumerate(self.table.rows)]
        changed = [(number, impact) for number, impact in alternatives if impact is not None]
        if not changed:
            return 0.0
        numbers, impacts = [number for number, _ in changed], [impact for _, impact in changed]
        physics = [self.entries.worlds[self.entries.world_of[number]] for number in numbers]
        entries = self.entries.predicted(MeasuredImpacts(impacts, physics), physics, numbers)[:, self._columns]
        moved = np.zeros_like(self.predicted)
        moved[numbers] = np.nan_to_num(entries - self.predicted[numbers])
        return self._energy_norm(moved)

    def _contacts_matter(self, times: float) -> bool:
        """Whether the contact points of another tolerance may decide a verdict."""
        return self._contacts_moved(times) > MIN_CONTACT_CHANGE_RATIO * self._energy_norm(
            self.measured - self.predicted
        )

    def _energy_norm(self, differences: Array, rows: Sequence[int] | None = None) -> float:
        """Rms over rows (None: all) of d (module text) for differences ``(rows, F)`` [m/s]."""
        worth = self.energy_weights if rows is None else self.energy_weights[list(rows)]
        return float(np.sqrt(np.mean(np.sum(np.square(differences * worth), axis=1))))

    def _contact_remark(self) -> str | None:
        """Remark on the influence of unsure contact points; None: no influence, or points were measured."""
        count = sum(row.wider is not None for row in self.table.rows)
        if not count:
            return None
        return (
            f"which points touch is unsure in {count} of {len(self.table.rows)} rows: with "
            f"{1e3 * MAX_TOLERANCE_FACTOR * self.table.tolerance:g} in place of {1e3 * self.table.tolerance:g} mm "
            f"predictions move by {self._contacts_moved(MAX_TOLERANCE_FACTOR):.2g} m/s, compared with "
            f"{self._energy_norm(self.measured - self.predicted):.2g} m/s between measurement and model "
            "(--contact-tolerance)"
        )

    def scatter_of_neighbours(self, residuals: Array) -> float | None:
        """Upper limit of the noise: size of the scatter of rows with nearly equal ante-impact states [m/s].

        The state of a free body is its twist and the position of its contact, in contact axes.

        Args:
            residuals: Residuals of a model, ``(rows, F)``; a better model gives a lower limit.

        Returns:
            None with too few rows, or with arms, whose states have too many coordinates.
        """
        if self.table.arms:
            return None
        before = turned(np.array([row.impact.object.twist for row in self.table.rows]), self.entries.axes)
        levers = [
            axes @ (np.mean([point.position for point in row.impact.points], axis=0) - row.impact.object.position)
            for row, axes in zip(self.table.rows, self.entries.axes, strict=True)
        ]
        noise = nearest_neighbour_noise(np.hstack((before, levers)), residuals)
        return None if noise is None else self._energy_norm(noise)

    def _stated_noise(self) -> Array | None:
        """Standard deviation of the noise columns by feature, ``(F,)``; None: no noise columns."""
        return None if self.noise is None else np.sqrt(np.mean(np.square(self.noise), axis=0))

    def _energy_gain(self) -> str:
        """Sentence on a gain of kinetic energy over all rows; empty: no significant gain."""
        ratios = self._energy_ratios[np.isfinite(self._energy_ratios)]
        if ratios.size < MIN_ROWS_OF_ENERGY:
            return ""
        error = float(ratios.std(ddof=1)) / np.sqrt(ratios.size)
        least = float(ratios.mean()) - float(scipy.stats.t.ppf(ENERGY_CONFIDENCE, ratios.size - 1)) * error
        if least <= MAX_ENERGY_RATIO:
            return ""
        return (
            f"kinetic energy grows in {np.count_nonzero(ratios > 1.0)} of {len(self.table.rows)} rows, by "
            f"{100.0 * (float(ratios.mean()) - 1.0):.0f} % on average, which no impact can cause: an external force "
            "acted, velocities before and after are not those of the same body in the same axes and units, or they are "
            "exchanged"
        )

    @cached_property
    def _energy_ratios(self) -> Array:
        """Measured kinetic energy after over before, ``(rows,)`` [-]."""
        ratios = []
        for row, system in zip(self.table.rows, self.entries.systems, strict=True):
            before, after = (float(u @ system.inertia @ u) for u in (system.velocity, row.after))
            ratios.append(after / max(before, 1e-300))
        return np.array(ratios)  # nan where a velocity after was not measured


def _columns(table: ImpactTable, joints: bool, body: bool) -> tuple[int, ...]:
    """Indices of the measured entries of joints or body, or of both."""
    count = table.rows[0].after.size
    columns = list(range(count - 6)) if joints else []
    if body and table.centre:
        columns += range(count - 6, count - 3)
    if body and table.turning:
        columns += range(count - 3, count)
    return (*columns, count) if body and not table.centre else tuple(columns)
