# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts as a source of evidence: the impact map predicts what every row measured just after.

Features are the post-impact velocities: of the joints, of the body's centre, and its angular velocity. Those of a free
body are given in contact axes, which are comparable between rows: along the ``normal``, along the ``sliding`` direction
just before the impact, and ``across`` both. Those of an object are given in x, y and z. Two kinds of clusters:

* **Conditions.** With enough repeats a cluster is a condition. Every repeat is predicted from its own ante-impact
  state, and the prediction of a condition is the mean over its repeats, so that its mean residual is linear in the
  error of the map. The pure error is the scatter of the repeats. Rows that were measured under other circumstances
  (covariates) are no repeats of each other: a condition has a cluster for each level, and for the lower and the upper
  half of a number. They are held out together.
* **Blocks.** Without repeats a cluster is a block of neighbouring rows, like a stretch of a recording. The scatter of
  the scores between blocks replaces the pure error. Blocks are held out in runs of neighbours, with a guard on either
  side, because drift from row to row (wear, the person who tosses) would leak into the prediction.

Linear and angular velocities of blocks are weighted by kinetic energy. A difference du of a row has the size of the
velocity at which the body has the same energy, coordinate by coordinate,

    d = sqrt(sum_i H_ii du_i^2 / m)                                      [m/s]

with H the inertia of body and joints, motors included, and m the mass of the body: the energy norm of the difference
where H is diagonal, as for a free body of equal moments of inertia. Every entry has the scale

    sigma_i = s / sqrt(H_ii / m),        s^2 = mean of d^2 over the rows / number of entries of a row

(a measured distance has the weight of the velocity that causes it, :mod:`impact_rs_trials.recordings.distances`)

so that fits minimise the reported error. Scaling each signal by its own residual would be wrong: the signal with the
largest effect of a missing term would then have the smallest weight in its estimate.

Tables of arms have a discrepancy of the rigid map (:mod:`impact_rs_analysis.evidence.map_discrepancy`). With repeats it
is part of sigma, without them of the expected squares. Joints and object of an arm also have verdicts of their own, and
so have other contact points where they may change the verdict (:meth:`ImpactTableSource.views`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import pinocchio as pin
import scipy

from impact_rs_analysis.evidence.ante_impact import obliqueness_of
from impact_rs_analysis.evidence.calibration import with_intervals
from impact_rs_analysis.evidence.cluster import TIMES, Added, Cluster, Feature, pooled_error
from impact_rs_analysis.evidence.discrepancy import DiscrepancyDocument
from impact_rs_analysis.evidence.features import AXES
from impact_rs_analysis.evidence.levels import (
    Comparison,
    ConditionScore,
    condition_scores,
    level_of,
    rounded,
    where_of,
    where_of_blocks,
)
from impact_rs_analysis.evidence.map_discrepancy import (
    ANGULAR_VELOCITY_AFTER,
    JOINT_VELOCITY_AFTER,
    NO_MAP_DISCREPANCY,
    VELOCITY_AFTER,
    HitKind,
    MapDiscrepancy,
    lengths_of,
    measured_map_discrepancy,
)
from impact_rs_analysis.evidence.minimum_data import MIN_CLUSTERS, MIN_DEGREES_OF_FREEDOM
from impact_rs_analysis.evidence.neighbour_noise import nearest_neighbour_noise
from impact_rs_analysis.evidence.replays import MAX_SQUARE_ANGLE_RAD
from impact_rs_analysis.evidence.source import (
    MAX_NUMBERS_AS_LEVELS,
    Covariate,
    Identity,
    Item,
    Made,
    Source,
    View,
    with_per_arm_parameters,
)
from impact_rs_analysis.evidence.tracks import ComparedSignal, Track
from impact_rs_sim.effects import Effect
from impact_rs_sim.effects.depending import Depending, level_name
from impact_rs_sim.effects.formula import CONTACT_SYMBOLS
from impact_rs_sim.effects.sensing import MIRRORED_SPINS, SPIN_AXES, TRACKED_POINT_OF_IMPACT, TWIST_AXES
from impact_rs_sim.errors import InputError, NotABody
from impact_rs_sim.impact_map.contacts import SUPPORT, contact_frame
from impact_rs_sim.impact_map.laws import System
from impact_rs_sim.impact_map.measured import MeasuredImpact, MeasuredImpacts, restitution_of
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.recent import Recent
from impact_rs_sim.robot import Array
from impact_rs_trials.recordings.impact_checks import OtherAxes, doubts_of, other_axes
from impact_rs_trials.recordings.impact_table import WIDER, ImpactTable
from impact_rs_trials.workers import Map

MAX_BLOCKS = 24  # a fold leaves 18 for the search, and the test needs 12
MAX_SMALL_BLOCKS = 120  # where effects may depend on covariates
MIN_ROWS_OF_HALF = 2  # of a condition on either side of the median of a number
# Of the closing speed: 5 mm/s at 1 m/s, the resolution of body velocities by motion capture.
RELEVANCE_SHARE_OF_SPEED = 0.005
MIN_SCALE_M_S = 1e-6  # a model with smaller residuals is exact
CACHED_PHYSICS = 1024  # physics with effects, the last ones
CACHED_PREDICTIONS_BYTES = 48_000_000  # of predictions of the whole table, the last ones
MAX_SEARCHED_ROWS_OF_ARMS = 96  # of a larger table; four in each block
MAX_SEARCHED_ROWS_OF_BODIES = 960  # of free bodies, whose map is a twentieth of the work
FOLDS_OF_LARGE_TABLE = 3  # all rows outside the search are held out as well
SEARCHED_ROWS_OF_LEVEL = 24  # of each level of a covariate, in a search of some rows
MAX_DISTINCT_NUMBERS = 32  # of a covariate; the mean of a group is within some hundredths of the range
MAX_NEIGHBOUR_SCATTER_RATIO = 0.8  # scatter of neighbours over the residual; above, it says nothing
MAX_LEVELS_SHOWN = 8  # of a covariate, in a remark
MIN_CONTACT_CHANGE_RATIO = 0.2  # change by other contact points over the residual; above, they may decide
MAX_ENERGY_RATIO = 1.05  # kinetic energy after over before; rows above it are reported
MIN_ROWS_OF_ENERGY = 3  # for a test of their mean
ENERGY_CONFIDENCE = 0.999  # one-sided, of the mean energy ratio being above MAX_ENERGY_RATIO: no table of impacts

CONTACT_AXES = ("normal", "sliding", "across")
MIN_SLIDING_SPEED_M_S = 1e-6  # slower contacts have no sliding direction: any tangent is taken
NO_DISCREPANCY_REMARK = (
    "model discrepancy of the rigid impact map is taken as 0: finite duration and compliance of real impacts count "
    "against the model"
)
DISTANCE_AFTER = "distance after"
PARTS_OF_ROW = ("joints", "object")  # of an arm, which also have verdicts of their own
NO_REPEATS_REMARK = (
    "too few rows are repeats of each other (column 'condition'), so blocks of neighbouring rows are held out instead"
)
NO_NOISE_REMARK = (
    "the noise is not known: there are neither repeats nor columns 'v_noise [m/s]' and 'w_noise [rad/s]'; unexplained "
    "residuals may be noise"
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
class _Group:
    """Rows of one cluster, by position in the table."""

    name: str
    unit: str
    rows: tuple[int, ...]


class ImpactTableSource(Source):
    """A table of impacts against the impact map of a model.

    Args:
        table: The measurements.
        model: The model.
        each_arm: Whether arms of one kind have parameters of their own.
        discrepancy: Discrepancy of the rigid map, for arms; None: the shipped one.
        remarks: Whether to check the table for remarks.
        map_tasks: Parallel map for :meth:`spread`; None: this process.

    Attributes:
        predicted: u^+ of the model in the axes of the features, ``(rows, nv)`` [rad/s, m/s].
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
        self._map = map_tasks
        model = with_per_arm_parameters(model, [row.physics for row in table.rows], each_arm)
        self.table, self.model = table, model
        known = measured_map_discrepancy() if discrepancy is None else discrepancy
        self._map_discrepancy = known if table.arms else NO_MAP_DISCREPANCY
        distinct = {id(row.physics): row.physics for row in table.rows}
        places = {number: place for place, number in enumerate(distinct)}
        self._world_of = [places[id(row.physics)] for row in table.rows]
        self._worlds = [model.apply(physics) for physics in distinct.values()]
        self.physics = self._worlds[0]
        self._effects = model.known_effects
        self._axes = np.array([_axes_of(row.impact) for row in table.rows])
        groups = _conditions(table)
        self.repeated = groups is not None
        self._groups = tuple(_blocks(table) if groups is None else groups)
        self.size_unit = TIMES if self.repeated else self.residual_unit
        self.size_is = SIZE_TEXT_WITH_REPEATS if self.repeated else SIZE_TEXT_WITHOUT_REPEATS
        self._impacts = MeasuredImpacts([row.impact for row in table.rows], self._of_rows(self._worlds))
        self._altered = Recent[Physics | None](CACHED_PHYSICS)
        self._known = Recent[Array](self._kept_answers)
        self._select_entries(_entries(table, joints=table.joints, body=True))
        self.impossible = self._energy_gain_words()
        self.remarks = tuple(self._remarks()) if remarks else ()

    def _select_entries(self, seen: EntryIndices) -> None:
        """Restrict the comparison to some entries of the rows."""
        self._selected = seen
        self._featured = Recent[list[Array | None]](CACHED_PHYSICS)
        self.signals, self.worth = tuple(self._all_signals[place] for place in seen), self._all_worth[:, seen]
        self.measured = self._all_measured[:, seen]
        self.noise = None if self._all_noise is None else self._all_noise[:, seen]
        self.predicted = self.predicted_with(())
        self.clusters = self._clusters()

    @property
    def _kept_answers(self) -> int:
        """Number of cached predictions of the whole table."""
        return max(1, CACHED_PREDICTIONS_BYTES // self._all_worth.nbytes)

    @property
    def covariates(self) -> tuple[Covariate, ...]:
        """See :attr:`Source.covariates`."""
        rows, units = self.table.rows, self.table.covariates
        return tuple(self._covariate(name, units[name], [row.circumstances[name] for row in rows]) for name in units)

    @property
    def state(self) -> tuple[Covariate, ...]:
        """See :attr:`Source.state`: the impact speed."""
        return (self._covariate("impact speed", "m/s", self._impacts.closing_speeds.tolist()),)

    @property
    def contact_speeds(self) -> dict[str, Array]:
        """See :attr:`Source.contact_speeds`."""
        contact = self._impacts.contacts(self._of_rows(self._worlds))
        closes = contact.closing > 0.0
        return dict(zip(CONTACT_SYMBOLS, (contact.closing[closes], contact.slip[closes]), strict=True))

    def _covariate(self, name: str, unit: str, values: Sequence[float | str]) -> Covariate:
        """A covariate from its values by row."""
        return Covariate(name, unit, tuple(tuple(values[row] for row in group.rows) for group in self._groups))

    def with_dependences(self, effects: Sequence[Depending]) -> ImpactTableSource:
        """See :meth:`Source.with_dependences`; many different numbers are binned, each bin with its mean.

        Blocks are small: a session may have few rows, and a sign-flip test needs several blocks in each.
        """
        found = copy.copy(self)
        if not self.repeated and not self.interleaved:
            found._groups, found.interleaved = tuple(_blocks(self.table, MAX_SMALL_BLOCKS)), True
            found._featured = Recent(CACHED_PHYSICS)  # by group
            found.clusters = found._clusters()
        found._effects = self._effects | {effect.name: effect for effect in effects}
        shown = {name: self._shown(name) for name in dict.fromkeys(effect.covariate for effect in effects)}
        places: dict[tuple[int, tuple[float | str, ...]], int] = {}
        found._worlds, found._world_of = [], []
        for row, world in enumerate(self._world_of):
            values = tuple(of_rows[row] for of_rows in shown.values())
            if (world, values) not in places:
                places[world, values] = len(places)
                before = self._worlds[world]
                circumstances = {**before.circumstances, **dict(zip(shown, values, strict=True))}
                found._worlds.append(replace(before, circumstances=circumstances))
            found._world_of.append(places[world, values])
        found._altered, found._featured = (
            Recent(CACHED_PHYSICS),
            Recent(max(1, CACHED_PREDICTIONS_BYTES // 4 // self._all_worth.nbytes)),
        )
        return found

    def _shown(self, name: str) -> list[float | str]:
        """A covariate by row; of more than ``MAX_DISTINCT_NUMBERS`` numbers the means of groups of equal size."""
        values = [row.circumstances[name] for row in self.table.rows]
        numbers = np.array([value for value in values if isinstance(value, float)])
        if len(set(values)) <= MAX_DISTINCT_NUMBERS or not numbers.size:
            return values
        for group in np.array_split(np.argsort(numbers, kind="stable"), MAX_DISTINCT_NUMBERS):
            numbers[group] = numbers[group].mean()
        return list(numbers.tolist())

    def offers(self, effect: Effect) -> bool:
        """See :meth:`Source.offers`; faults of readings need a free body with measured rotation."""
        turned = bool(self.table.turning and not self.table.arms)
        wanted = {
            MIRRORED_SPINS.name: bool(self.starts(MIRRORED_SPINS.name)),
            TWIST_AXES.name: bool(self.starts(TWIST_AXES.name)),
            TRACKED_POINT_OF_IMPACT.name: self._oriented,
        }
        return super().offers(effect) and (
            effect.acts_on != "sensing" or (turned and wanted.get(effect.name, effect.name == SPIN_AXES.name))
        )

    @property
    def _oriented(self) -> bool:
        """Whether the orientation of the body was measured, with which a tracked point rotates."""
        return any(np.any(row.impact.object.rotation != np.eye(3)) for row in self.table.rows)

    def starts(self, name: str) -> Sequence[Array]:
        """See :meth:`Source.starts`: permutations of axes that agree better with the laws of every contact.

        Near 180 degrees the sensitivity is orthogonal to the finite change, so that the fit starts at 120 degrees.
        """
        exact = all(world.twist_readings.exact for world in self._worlds)  # else the model corrects the table
        kinds = {SPIN_AXES.name: ("spins", 1.0), MIRRORED_SPINS.name: ("spins", -1.0), TWIST_AXES.name: ("twists", 1.0)}
        if name not in kinds or not exact:
            return ()
        found = [other for other in self._other_axes if (other.of, other.sign) == kinds[name]]
        tail = [-1.0] if name == MIRRORED_SPINS.name else []
        shares = [2.0 / 3.0 if np.linalg.norm(other.vector) > 0.9 * np.pi else 1.0 for other in found]
        return [np.append(share * other.vector, tail) for share, other in zip(shares, found, strict=True)]

    @cached_property
    def _other_axes(self) -> list[OtherAxes]:
        """See :func:`impact_rs_trials.recordings.impact_checks.other_axes`."""
        return other_axes(self.table)

    @property
    def known_effects(self) -> dict[str, Effect]:
        """See :attr:`Source.known_effects`."""
        return self._effects

    @property
    def discrepancy_document(self) -> DiscrepancyDocument:
        """See :attr:`Source.discrepancy_document`: of the rigid map, for arms."""
        return self._map_discrepancy.document

    def searched(self) -> ImpactTableSource:
        """See :meth:`Source.searched`: evenly spaced rows, or conditions and repeats, and some of each level."""
        enough = MAX_SEARCHED_ROWS_OF_ARMS if self.table.arms else MAX_SEARCHED_ROWS_OF_BODIES
        if len(self.table.rows) <= enough:
            return self
        chosen = set() if self.repeated else _subsample(range(len(self.table.rows)), enough)
        if self.repeated:
            most = max(enough // len(self._groups), MIN_DEGREES_OF_FREEDOM)
            groups = _subsample(range(len(self._groups)), enough // most)
            chosen |= {row for group in groups for row in _subsample(self._groups[group].rows, most)}
        for name in self.table.covariates:
            values = [row.circumstances[name] for row in self.table.rows]
            for level in dict.fromkeys(value for value in values if isinstance(value, str)):
                chosen |= _subsample([n for n, value in enumerate(values) if value == level], SEARCHED_ROWS_OF_LEVEL)
        found = self._of(self.table.part(sorted(chosen)), remarks=False)
        found.remarks, found.folds = self.remarks, FOLDS_OF_LARGE_TABLE
        return found

    def unseen(self, searched: Source, added: Added) -> tuple[str, ...]:
        """See :meth:`Source.unseen`."""
        if searched is self:
            return ()
        known = {row.number for row in searched.table.rows} if isinstance(searched, ImpactTableSource) else set()
        others = [place for place, row in enumerate(self.table.rows) if row.number not in known]
        before, after = (
            self._energy_rms((self.measured - found)[others], others)
            for found in (self.predicted, self.predicted_with(added) if added else self.predicted)
        )
        noise = "" if self.noise is None else f" (noise alone: {self._energy_rms(self.noise[others], others):.3g})"
        fall = f"falls from {before:.3g} to {after:.3g} m/s" if added else f"is {before:.3g} m/s"
        return (
            f"{len(known)} of {len(self.table.rows)} rows were searched, evenly taken: effects and intervals are "
            f"theirs. On the {len(others)} others the error {fall}{noise}",
        )

    def spread(self, function: Callable[[Source, Item], Made], items: Sequence[Item], what: str) -> list[Made]:
        """See :meth:`Source.spread`."""
        if self._map is None:
            return super().spread(function, items, what)
        alone = copy.copy(self)
        alone._map, alone.table = None, replace(self.table, variants=())
        alone._known, alone._altered, alone._featured = (
            Recent(self._kept_answers),
            Recent(CACHED_PHYSICS),
            Recent(CACHED_PHYSICS),
        )
        return list(self._map(partial(function, alone), items))

    def views(self) -> tuple[View, ...]:
        """See :meth:`Source.views`.

        Joints and object of an arm, other contact points if they may decide, and values of uncertain quantities.
        """
        found = [View(name, part) for name, part in self._parts().items()]
        for times in (1.0 / WIDER, WIDER):
            if self._contacts_matter(times):
                how = f"points within {1e3 * times * self.table.tolerance:g} mm"
                found.append(View(how, self._with_contacts(times), "--contact-tolerance"))
        for one in self.table.variants:
            source = self._of(one.table, remarks=False)
            name = f"{one.of} = {one.value:.4g} {one.unit}".removesuffix(" -")
            found.append(View(name, source, "--unsure", one.of, one.value, one.unit))
        return tuple(found)

    @property
    def identity(self) -> Identity:
        """See :attr:`Source.identity`; without repeats the table is its only condition."""
        names = tuple(item.name for item in self.clusters) if self.repeated else (self.table.path.name,)
        return Identity(self.table.digest, len(self.table.rows), names)

    def _parts(self) -> dict[str, ImpactTableSource]:
        """Joints and object of an arm, each alone; none without an arm, or if the object alone was measured."""
        found = {}
        for name in PARTS_OF_ROW if self.table.arms and self.table.joints else ():
            found[name] = copy.copy(self)
            found[name]._select_entries(_entries(self.table, joints=name == "joints", body=name == "object"))
        return found

    @property
    def comparison_remarks(self) -> Sequence[str]:
        """See :attr:`Source.comparison_remarks`; with the errors of joints and object, and of rows by covariate."""
        sizes = ", ".join(f"{name} {part.size():.3g}" for name, part in self._parts().items())
        apart = [f"apart: {sizes} {self.size_unit}"] if sizes else []
        squares = np.sum(np.square((self.measured - self.predicted) * self.worth), axis=1)
        for name in self.table.covariates:
            groups = _by_circumstance(self.table, name, range(len(squares)))
            parts = {label: float(np.sqrt(np.mean(squares[own]))) for label, own in groups.items()}
            shown = ", ".join(
                f"{size:.3g} m/s with {label}" for label, size in sorted(parts.items())[:MAX_LEVELS_SHOWN]
            )
            left = len(parts) - MAX_LEVELS_SHOWN
            apart.append(f"differences by {name}: {shown}{f' and {left} more' if left > 0 else ''}")
        return (*self.remarks, *apart)

    @cached_property
    def _all_signals(self) -> tuple[Feature, ...]:
        """Description of the entries of a row, the same for all rows, ``nv`` of them."""
        found = []
        for name in self.table.rows[0].impact.arms:
            label = f"{name}." if len(self.table.arms) > 1 else ""
            for joint, units in enumerate(self.table.rows[0].physics.arms[name].facts.units, start=1):
                found.append(
                    Feature("impact", JOINT_VELOCITY_AFTER, f"{label}joint{joint}", 0, units.velocity, 0.0, name)
                )
        names = AXES if self.table.arms else CONTACT_AXES
        found += [Feature("impact", VELOCITY_AFTER, axis, 0, "m/s", 0.0) for axis in names]
        found += [Feature("impact", ANGULAR_VELOCITY_AFTER, axis, 0, "rad/s", 0.0) for axis in names]
        limits = RELEVANCE_SHARE_OF_SPEED * self._speed / lengths_of(found, self.physics)
        signals = [replace(f, relevance_limit=float(limit)) for f, limit in zip(found, limits, strict=True)]
        if self._distances:
            lasting = float(np.sqrt(np.mean(np.square(self._lasting))))
            signals.append(
                Feature(
                    "impact", DISTANCE_AFTER, "horizontal", 0, "m", RELEVANCE_SHARE_OF_SPEED * self._speed * lasting
                )
            )
        return tuple(signals)

    @property
    def _distances(self) -> bool:
        """Whether distances were measured instead of velocities of the centre."""
        return not self.table.centre

    @cached_property
    def _lasting(self) -> Array:
        """Derivative of the distance by the velocity of every row, ``(rows,)`` [s]."""
        worlds = self._of_rows(self._worlds)
        velocities, _ = self._impacts.solve(worlds)
        found = []
        for row, velocity, world in zip(self.table.rows, velocities, worlds, strict=True):
            assert row.distance is not None
            if np.isnan(velocity).any():
                raise InputError("no velocities obey the contact laws", file=self.table.path, key=f"row {row.number}")
            found.append(row.distance.lasting(velocity[-6:-3], world))
        return np.array(found)

    @cached_property
    def _all_measured(self) -> Array:
        """Measured entries of all rows, ``(rows, n)`` [rad/s, m/s, m], NaN where not measured."""
        found = _in_axes(np.array([row.after for row in self.table.rows]), self._axes)
        if not self._distances:
            return found
        ways = [np.nan if row.distance is None else row.distance.way for row in self.table.rows]
        return np.column_stack((found, ways))

    @cached_property
    def _all_noise(self) -> Array | None:
        """Standard deviations of all entries, of measurement and prediction, ``(rows, n)``; None: not stated."""
        if self.table.noise is None:
            return None
        found = self.table.noise.copy()
        for own in (slice(-6, -3), slice(-3, None)):  # diag(T C T^T) with the variances C along the axes of A
            found[:, own] = np.sqrt(np.einsum("nij,nj->ni", np.square(self._axes), np.square(found[:, own])))
        if self._distances:
            ways = [np.nan if row.distance is None else row.distance.noise or 0.0 for row in self.table.rows]
            found = np.column_stack((found, np.array(ways, dtype=float)))
        return np.hypot(found, self._noise_of_contacts)

    @cached_property
    def _noise_of_contacts(self) -> Array:
        """Noise of the predictions by errors of contact positions and normals, ``(rows, n)``."""
        worlds, squares = self._of_rows(self._worlds), np.zeros_like(self._all_measured)
        stated = np.array([row.contact_noise for row in self.table.rows])
        if not stated.any():
            return squares
        here = self._entries_of(self._impacts, worlds)
        for along in range(5):  # three axes for the position, two tangents for the normal
            impacts = [_moved(row.impact, along, *row.contact_noise) for row in self.table.rows]
            there = self._entries_of(MeasuredImpacts(impacts, worlds), worlds)
            squares += np.square(np.nan_to_num(there - here))
        return np.sqrt(squares)

    def _entries_of(
        self, impacts: MeasuredImpacts, worlds: Sequence[Physics], rows: Sequence[int] | None = None
    ) -> Array:
        """Entries of some rows (None: all) as predicted by the map, ``(rows, n)``, NaN without a solution."""
        places = range(len(self.table.rows)) if rows is None else rows
        velocity, _ = impacts.solve(worlds)
        found = _in_axes(velocity, self._axes[list(places)])
        if not self._distances:
            return found
        ways = []
        for place, own, world in zip(places, velocity, worlds, strict=True):
            distance = self.table.rows[place].distance
            assert distance is not None
            ways.append(distance.predicted(own[-6:-3], world))
        return np.column_stack((found, ways))

    @cached_property
    def _speed(self) -> float:
        """Closing speed of the impacts, root mean square [m/s]."""
        return float(np.sqrt(np.mean(np.square(self._impacts.closing_speeds))))

    @property
    def proportion(self) -> Proportion:
        """See :attr:`Source.proportion`; for a free body by its mass, moments of inertia and closing speed."""
        return Proportion.of(self.physics) if self.table.arms else Proportion.of_body(self.physics.object, self._speed)

    @cached_property
    def _systems(self) -> tuple[System, ...]:
        """Inertia and kinematics of every row under the model."""
        models = [physics.robot_models() for physics in self._worlds]
        return tuple(
            row.impact.system(self._worlds[world], models[world])
            for row, world in zip(self.table.rows, self._world_of, strict=True)
        )

    @cached_property
    def _all_worth(self) -> Array:
        """Energy weights: velocity of the body with the energy of 1 rad/s or 1 m/s, ``(rows, nv)`` [m, -]."""
        inertia = np.array([system.inertia for system in self._systems])
        turned = inertia.copy()  # H T^T, then T H T^T, with T the axes
        turned = np.swapaxes(_columns_in_axes(turned, self._axes), 1, 2)
        diagonal = np.einsum("nii->ni", _columns_in_axes(turned, self._axes))
        masses = np.array([self._worlds[world].object.mass for world in self._world_of])
        worth = np.sqrt(diagonal / masses[:, None])
        return np.column_stack((worth, 1.0 / self._lasting)) if self._distances else np.asarray(worth)

    def residual_weight(self, item: Cluster) -> Array:
        """See :meth:`Source.residual_weight`; the mean over all entries of a row times their number is d^2."""
        rows = next(group.rows for group in self._groups if group.name == item.name)
        worth = self.worth[list(rows)]
        worth = worth.mean(axis=0) if self.repeated else worth.ravel()
        return np.asarray(item.sigma * worth * np.sqrt(len(self.signals)))

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        """See :meth:`Source.predict`."""
        del what
        found = {added: self._features(added) for added in dict.fromkeys(added for _, added in wanted)}
        return [found[added][number] for number, added in wanted]

    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """See :meth:`Source.residuals_with`; every repeat starts from its own state."""
        numbers = {item.name: number for number, item in enumerate(self.clusters)}
        answers = self._answers(added)
        result = []
        for item in like:
            number = numbers[item.name]
            rows = self._rows(number, answers)
            if rows is None:
                return None
            rest = self.measured[list(self._groups[number].rows)] - rows
            result.append(replace(item, residuals=(rest if self.repeated else rest.reshape(1, -1)) / item.sigma))
        return result

    def predicted_with(self, added: Added) -> Array:
        """u^+ of all rows for the model with effects, as ``predicted``, ``(rows, nv)`` [rad/s, m/s].

        Raises:
            InputError: The effects give a body without positive inertia, or some row has no solution.
        """
        found = self._answers(added)
        if found is None:
            raise InputError("with these effects the body has no positive inertia", file=self.table.path)
        unsolved = np.flatnonzero(np.isnan(found).any(axis=1))
        if unsolved.size:
            row = self.table.rows[unsolved[0]]
            raise InputError("no velocities obey the contact laws", file=self.table.path, key=f"row {row.number}")
        return found

    def predict_row(self, row: int, added: Sequence[Added]) -> list[Array | None]:
        """u^+ of one row for the model with each of some sets of effects, solved together, ``(nv,)`` [rad/s, m/s].

        Args:
            row: Position of the row.
            added: Sets of effects.

        Returns:
            None where the effects give a body without positive inertia, or no velocities obey the laws.
        """
        found: dict[int, Array] = {}
        each = [self._world_with(self._world_of[row], effects) for effects in added]
        worlds = {number: physics for number, physics in enumerate(each) if physics is not None}
        if worlds:
            physics_of = list(worlds.values())
            impact = self.table.rows[row].impact
            several = MeasuredImpacts([impact] * len(physics_of), physics_of)
            entries = self._entries_of(several, physics_of, [row] * len(physics_of))[:, self._selected]
            found = dict(zip(worlds, entries, strict=True))
        return [None if n not in found or np.isnan(found[n]).any() else found[n] for n in range(len(added))]

    def _world_with(self, place: int, added: Added) -> Physics | None:
        """One of the physics with effects; None without positive inertia."""

        def changed() -> Physics | None:
            physics = self._worlds[place]
            try:
                for name, values in added:
                    physics = self._effects[name].apply_vector(physics, np.array(values))
            except NotABody:
                return None
            return physics

        return self._altered.of((place, added), changed)

    def map_discrepancy_of(self, row: int) -> Array:
        """Discrepancy of the rigid map for the compared entries of a row, ``(F,)``."""
        if not self.table.arms:
            return np.zeros(len(self.signals))
        world, speed = self._worlds[self._world_of[row]], float(self._impacts.closing_speeds[row])
        return self._discrepancy_of(row, world, speed)[self._selected]

    def _discrepancy_of(self, row: int, world: Physics, speed: float) -> Array:
        """Discrepancy of the rigid map of all entries of a row, ``(n,)``."""
        velocities = self._all_signals[:-1] if self._distances else self._all_signals
        found = self._map_discrepancy.of(velocities, world, speed, self._kinds[row])
        return np.append(found, found[-6] * self._lasting[row]) if self._distances else found

    def size(self) -> float:
        """See :meth:`Source.size`; without repeats, root mean square over the rows of d of the module [m/s]."""
        if self.repeated:
            return super().size()
        return self._energy_rms(self.measured - self.predicted)

    def noise_size(self) -> float | None:
        """:meth:`size` of noise alone; None if the noise is not known."""
        if self.repeated:
            return super().noise_size()
        if self.noise is None:
            return None
        return self._energy_rms(self.noise)

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
            found = self.predicted_with(added)
            predictions = {"model": self.predicted, "model with the effects found": found}
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
        return self._worlds

    def _of_rows(self, worlds: Sequence[Physics]) -> list[Physics]:
        """The physics of every row."""
        return [worlds[place] for place in self._world_of]

    def _rows(self, number: int, answers: Array | None) -> Array | None:
        """u^+ of the rows of a cluster out of those of all rows, ``(n, nv)``; None without a solution."""
        rows = None if answers is None else answers[list(self._groups[number].rows)]
        return None if rows is None or np.isnan(rows).any() else rows

    def _features(self, added: Added) -> list[Array | None]:
        """:meth:`predict` of every cluster, cached: a diagnosis needs the same effects repeatedly."""

        def made() -> list[Array | None]:
            answers = self._answers(added)
            found = [self._rows(number, answers) for number in range(len(self._groups))]
            return [rows if rows is None else rows.mean(axis=0) if self.repeated else rows.ravel() for rows in found]

        return self._featured.of(added, made)

    def _answers(self, added: Added) -> Array | None:
        """u^+ of all rows as features, ``(rows, nv)``, NaN without a solution; None without positive inertia.

        All rows are solved at once, and cached by all inputs of the map.
        """
        worlds = self._worlds
        try:
            for name, values in added:
                worlds = [self._effects[name].apply_vector(physics, np.array(values)) for physics in worlds]
        except NotABody:
            return None
        key = b"".join(_map_key(physics) for physics in worlds)
        solved = self._known.of(key, lambda: self._entries_of(self._impacts, self._of_rows(worlds)))
        return solved[:, self._selected]

    @cached_property
    def _kinds(self) -> list[HitKind]:
        """Kind of the hit of every row."""
        found: list[HitKind] = []
        for row, world in zip(self.table.rows, self._world_of, strict=True):
            impact, physics = row.impact, self._worlds[world]
            oblique = bool(impact.arms) and obliqueness_of(physics, impact.arms, impact.object) > MAX_SQUARE_ANGLE_RAD
            found.append("oblique" if oblique else "square")
        return found

    @cached_property
    def _map_discrepancy_of_all(self) -> Array:
        """Discrepancy of the rigid map of all entries of a row, rms over the rows, ``(nv,)``."""
        if not self.table.arms:
            return np.zeros(len(self._all_signals))
        rows = [
            self._discrepancy_of(row, self._worlds[world], float(speed))
            for row, (world, speed) in enumerate(zip(self._world_of, self._impacts.closing_speeds, strict=True))
        ]
        return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))

    @property
    def _map_discrepancy_rms(self) -> Array:
        """Discrepancy of the rigid map for the compared entries, rms over the rows, ``(F,)``."""
        return self._map_discrepancy_of_all[self._selected]

    def _clusters(self) -> tuple[Cluster, ...]:
        rest = self.measured - self.predicted
        limit = np.array([feature.relevance_limit for feature in self.signals]) / 2.0
        if self.repeated:
            pooled = pooled_error([rest[list(group.rows)] for group in self._groups])
            assert pooled is not None
            self._pooled, stated = pooled, self._stated_noise()
            pure = pooled if stated is None else np.maximum(pooled, stated)
            sigma = np.broadcast_to(np.sqrt(pure**2 + limit**2 + self._map_discrepancy_rms**2), rest.shape)
            noise = np.broadcast_to(pure, rest.shape)
        else:
            sigma = max(self.size() / np.sqrt(len(self.signals)), MIN_SCALE_M_S) / self.worth
            noise = np.zeros_like(rest) if self.noise is None else self.noise
        return with_intervals(self, [self._cluster(group, rest, sigma, noise) for group in self._groups])

    def _cluster(self, group: _Group, rest: Array, sigma: Array, noise: Array) -> Cluster:
        rows = list(group.rows)
        shown = rows[:1] if self.repeated else rows
        features = tuple(replace(feature, phase=self._phase(row)) for row in shown for feature in self.signals)
        scaled = rest[rows] / sigma[rows]
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
            discrepancy=(self._map_discrepancy_rms / sigma[shown]).ravel(),
            discrepancy_key=group.name if self._kinds[rows[0]] == "oblique" else None,
            timestamps=np.array(rows, dtype=float) if self.repeated else None,
        )

    def _phase(self, number: int) -> str:
        """Phase name of a row: the part of the body that is hit."""
        row = self.table.rows[number]
        if row.impact.arms:
            return "on the pad"
        if row.physics.object.round:
            return "of a ball"
        return {1: "on a corner", 2: "on an edge"}.get(len(row.impact.points), "on a face")

    def _remarks(self) -> list[str]:
        remarks = [*doubts_of(self.table), *self.table.assumed]
        if not self._map_discrepancy.entries:
            remarks.append(NO_DISCREPANCY_REMARK)
        if not self.repeated:
            remarks.append(NO_REPEATS_REMARK)
            if self.noise is None:
                remarks.append(NO_NOISE_REMARK)
                scatter = self.scatter_of_neighbours(self.measured - self.predicted)
                if scatter is not None and scatter < MAX_NEIGHBOUR_SCATTER_RATIO * self.size():
                    remarks.append(
                        f"impacts of neighbouring states scatter by {scatter:.3g} m/s: larger residuals of the model "
                        "are not noise"
                    )
        if (unsure := self._unsure_contacts()) is not None:
            remarks.append(unsure)
        if self.repeated and (stated := self._stated_noise()) is not None:
            ratio = float(np.sqrt(np.mean(np.square(self._pooled / np.maximum(stated, MIN_SCALE_M_S)))))
            remarks.append(
                f"repeats scatter {ratio:.2g} times as much as the noise columns state; the larger of both is used for "
                "every velocity"
            )
        if self.noise is not None and (own := self._energy_rms(self._noise_of_contacts[:, self._selected])) > 0.0:
            remarks.append(f"errors of contact positions and normals (p_noise, n_noise) are {own:.2g} m/s of the noise")
        gained = [
            row.number
            for row, ratio in zip(self.table.rows, self._energy_ratios, strict=True)
            if ratio > MAX_ENERGY_RATIO
        ]
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
        """The same measurements with the contact points of another tolerance.

        Args:
            times: The tolerance over that of the table, ``WIDER`` or its inverse [-].
        """
        rows = []
        for row in self.table.rows:
            other = row.wider if times > 1.0 else row.narrower
            rows.append(replace(row, impact=row.impact if other is None else other, wider=None, narrower=None))
        table = replace(self.table, rows=tuple(rows), tolerance=times * self.table.tolerance)
        return self._of(table, remarks=True)

    def _of(self, table: ImpactTable, remarks: bool) -> ImpactTableSource:
        """Another table against the same model."""
        found = ImpactTableSource(table, self.model, False, self._map_discrepancy, remarks, self._map)
        found.folds = self.folds
        return found

    def _contacts_moved(self, times: float) -> float:
        """Change of the predictions by the contact points of another tolerance, energy rms [m/s]."""
        others = [(n, row.wider if times > 1.0 else row.narrower) for n, row in enumerate(self.table.rows)]
        changed = [(number, impact) for number, impact in others if impact is not None]
        if not changed:
            return 0.0
        numbers, impacts = [number for number, _ in changed], [impact for _, impact in changed]
        physics = [self._worlds[self._world_of[number]] for number in numbers]
        entries = self._entries_of(MeasuredImpacts(impacts, physics), physics, numbers)[:, self._selected]
        moved = np.zeros_like(self.predicted)
        moved[numbers] = np.nan_to_num(entries - self.predicted[numbers])
        return self._energy_rms(moved)

    def _contacts_matter(self, times: float) -> bool:
        """Whether the contact points of another tolerance may change the verdict."""
        return self._contacts_moved(times) > MIN_CONTACT_CHANGE_RATIO * self._energy_rms(self.measured - self.predicted)

    def _energy_rms(self, rest: Array, rows: Sequence[int] | None = None) -> float:
        """Energy rms of differences ``(rows, F)``: root mean square of d over rows (None: all) [m/s]."""
        worth = self.worth if rows is None else self.worth[list(rows)]
        return float(np.sqrt(np.mean(np.sum(np.square(rest * worth), axis=1))))

    def _unsure_contacts(self) -> str | None:
        """Remark on the sensitivity to the contact points; None: insensitive, or points were measured."""
        count = sum(row.wider is not None for row in self.table.rows)
        if not count:
            return None
        return (
            f"which points touch is unsure in {count} of {len(self.table.rows)} rows: with "
            f"{1e3 * WIDER * self.table.tolerance:g} in place of {1e3 * self.table.tolerance:g} mm predictions move by "
            f"{self._contacts_moved(WIDER):.2g} m/s, beside {self._energy_rms(self.measured - self.predicted):.2g} m/s "
            "between measurement and model (--contact-tolerance)"
        )

    def scatter_of_neighbours(self, rest: Array) -> float | None:
        """Scatter of rows with neighbouring ante-impact states, an upper limit of the noise [m/s].

        The state of a free body is its twist and the position of its contact, in contact axes.

        Args:
            rest: Residuals of a model, ``(rows, nv)``; the smoother they are, the lower is the limit.

        Returns:
            None with too few rows, or with arms, whose states have too many coordinates.
        """
        if self.table.arms:
            return None
        before = _in_axes(np.array([row.impact.object.twist for row in self.table.rows]), self._axes)
        levers = [
            axes @ (np.mean([point.position for point in row.impact.points], axis=0) - row.impact.object.position)
            for row, axes in zip(self.table.rows, self._axes, strict=True)
        ]
        found = nearest_neighbour_noise(np.hstack((before, levers)), rest)
        return None if found is None else self._energy_rms(found)

    def _stated_noise(self) -> Array | None:
        """Standard deviation of the noise columns by feature, ``(nv,)``; None: there are none."""
        return None if self.noise is None else np.sqrt(np.mean(np.square(self.noise), axis=0))

    def _energy_gain_words(self) -> str:
        """Sentence if kinetic energy grows on average over the rows, by a t-test; else empty."""
        ratios = self._energy_ratios[np.isfinite(self._energy_ratios)]
        if ratios.size < MIN_ROWS_OF_ENERGY:
            return ""
        error = float(ratios.std(ddof=1)) / np.sqrt(ratios.size)
        if (
            float(ratios.mean()) - float(scipy.stats.t.ppf(ENERGY_CONFIDENCE, ratios.size - 1)) * error
            <= MAX_ENERGY_RATIO
        ):
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
        found = []
        for row, system in zip(self.table.rows, self._systems, strict=True):
            before, after = (float(u @ system.inertia @ u) for u in (system.velocity, row.after))
            found.append(after / max(before, 1e-300))
        return np.array(found)  # nan where something was not measured after


def _subsample(rows: Sequence[int], most: int) -> set[int]:
    """Evenly spaced subsample of some rows, of at most ``most``."""
    if len(rows) <= most:
        return set(rows)
    return {rows[place] for place in np.linspace(0, len(rows) - 1, most).round().astype(int)}


EntryIndices = list[int]


def _entries(table: ImpactTable, joints: bool, body: bool) -> EntryIndices:
    """Indices of the measured entries of a row, of the joints, of the body, or of both."""
    count = table.rows[0].after.size
    found = list(range(count - 6)) if joints else []
    if body and table.centre:
        found += range(count - 6, count - 3)
    if body and table.turning:
        found += range(count - 3, count)
    return [*found, count] if body and not table.centre else found


def _moved(impact: MeasuredImpact, along: int, place: float, normal: float) -> MeasuredImpact:
    """An impact with contact points moved along an axis of their frames, or with tilted normals.

    Args:
        impact: The impact; where there are arms, points on the support stay.
        along: 0 to 2: points along two tangents and the normal; 3 and 4: normals about the tangents.
        place: Displacement [m].
        normal: Tilt angle [rad].
    """
    points = []
    for point in impact.points:
        frame = contact_frame(point.normal)
        if impact.arms and point.partner == SUPPORT:
            points.append(point)
        elif along < len(frame):
            points.append(replace(point, position=point.position + place * frame[along]))
        else:
            points.append(replace(point, normal=np.asarray(pin.exp3(normal * frame[along - 3]) @ point.normal)))
    return replace(impact, points=tuple(points))


def _conditions(table: ImpactTable) -> list[_Group] | None:
    """Conditions with their repeats; None with too few repeats."""
    grouped: dict[str, list[int]] = {}
    for number, row in enumerate(table.rows):
        name = ", ".join(filter(None, (row.object_name, row.condition))) if row.condition else f"row {row.number}"
        grouped.setdefault(name, []).append(number)
    parts = [
        _Group(", ".join([name, *labels]), name, tuple(rows))
        for name, whole in grouped.items()
        for labels, rows in _split_by_covariates(table, whole)
    ]
    freedom = sum(len(part.rows) - 1 for part in parts)
    if len(grouped) < MIN_CLUSTERS or freedom < MIN_DEGREES_OF_FREEDOM:
        return None
    return parts


def _split_by_covariates(table: ImpactTable, whole: list[int]) -> list[tuple[list[str], list[int]]]:
    """Rows of a condition by levels of all covariates, and by halves of numbers, with their labels."""
    parts: list[tuple[list[str], list[int]]] = [([], whole)]
    for name in table.covariates:
        split = []
        for labels, rows in parts:
            own = _by_circumstance(table, name, rows)
            halves = len({row.circumstances[name] for row in table.rows}) > MAX_NUMBERS_AS_LEVELS
            numbers = isinstance(table.rows[rows[0]].circumstances[name], float)
            # Halves of a number are repeats of each other only if several rows are left in both.
            whole_part = len(own) == 1 or (numbers and halves and min(map(len, own.values())) < MIN_ROWS_OF_HALF)
            split += [(labels, rows)] if whole_part else [([*labels, label], some) for label, some in own.items()]
        parts = split
    return parts


def _by_circumstance(table: ImpactTable, name: str, rows: Sequence[int]) -> dict[str, list[int]]:
    """Rows by level of a covariate, or by halves of a number about its median, under their labels."""
    values, unit = [table.rows[row].circumstances[name] for row in rows], table.covariates[name]
    numbers = [value for value in values if isinstance(value, float)]
    many = len({row.circumstances[name] for row in table.rows}) > MAX_NUMBERS_AS_LEVELS
    middle = float(np.median(numbers)) if numbers and many else None
    found: dict[str, list[int]] = {}
    for row, value in zip(rows, values, strict=True):
        label = level_name(value)
        if isinstance(value, float) and middle is not None:
            label = f"{'up to' if value <= middle else 'above'} {middle:.4g}"
        found.setdefault(f"{name} {label} {unit if numbers else ''}".strip(), []).append(row)
    return found


def _blocks(table: ImpactTable, most: int = MAX_BLOCKS) -> list[_Group]:
    """Blocks of neighbouring rows of about equal length, ``most`` at most, within one unit."""
    count = len(table.rows)
    blocks = min(count, most)
    edges = np.arange(blocks + 1) * count // blocks
    found = []
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        name = f"row {low + 1}" if high - low == 1 else f"rows {low + 1} to {high}"
        found.append(_Group(name, str(table.path), tuple(range(low, high))))
    return found


def _axes_of(impact: MeasuredImpact) -> Array:
    """Axes of the features in A, as rows, ``(3, 3)``: contact axes of a free body, else the axes of A."""
    if impact.arms:
        return np.eye(3)
    normal = impact.points[0].normal
    velocity = np.mean([impact.object.point_velocity(point.position) for point in impact.points], axis=0)
    sliding = velocity - (velocity @ normal) * normal
    speed = float(np.linalg.norm(sliding))
    tangent = sliding / speed if speed > MIN_SLIDING_SPEED_M_S else contact_frame(normal)[0]
    return np.array([normal, tangent, np.cross(normal, tangent)])


def _in_axes(velocity: Array, axes: Array) -> Array:
    """u ``(rows, nv)`` with the twist of the body expressed in the axes of every row."""
    return _columns_in_axes(velocity[:, :, None], axes)[:, :, 0]


def _columns_in_axes(columns: Array, axes: Array) -> Array:
    """As :func:`_in_axes`, for several columns, ``(rows, nv, k)``."""
    result = columns.copy()
    for place in (-6, -3):
        own = slice(place, place + 3 or None)
        result[:, own] = axes @ columns[:, own]
    return result


def _map_key(physics: Physics) -> bytes:
    """Cache key: all parameters of the impact map besides its state."""
    body = physics.object
    contact = (physics.support_friction, physics.pad_friction, restitution_of(physics), physics.rolling_arm)
    parts = [np.array(contact), np.array(physics.twist_readings.numbers), body.com_offset]
    if physics.arms:
        parts += [np.array([body.mass]), body.inertia]
    else:
        # Against a fixed body the mass cancels, up to rounding.
        parts += [np.array([float(f"{moment:.12g}") for moment in body.inertia / body.mass])]
    for arm in physics.arms.values():
        tool = arm.end_effector
        parts += [np.array([tool.mass, tool.length, tool.mount_yaw]), tool.com, tool.inertia.ravel()]
        parts += [arm.motor_inertia_reduced, arm.base.homogeneous.ravel()]
    numbers = b"".join(np.ascontiguousarray(part, dtype=float).tobytes() for part in parts)
    return numbers + repr(physics.contact_laws).encode()
