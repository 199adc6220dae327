# SPDX-License-Identifier: Apache-2.0
"""Sources of hits in time order: measured features, and predictions of a model with effects.

A *hit* is one finished trial (a bag) or one impact (a row of a table). Both sources give features, their model
discrepancy, and predictions under effects added to the model.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.cluster import Added, Feature
from impact_rs_analysis.evidence.discrepancy import Discrepancy
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs, read_trial
from impact_rs_analysis.evidence.replays.replay_cache import Replay, ReplayCache, with_effects
from impact_rs_analysis.evidence.replays.simulated_trials import simulated_and_judged
from impact_rs_analysis.evidence.source import Source, with_per_arm_parameters
from impact_rs_analysis.evidence.sources.run_source import ReplaySource, clusters_of, layout_of
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import MapDiscrepancy
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario import Scenario
from impact_rs_sim.scene import ArmState
from impact_rs_trials.bags.reader import reason_of, recorded_at
from impact_rs_trials.recordings.impacts.impact_cells import name_of_row
from impact_rs_trials.recordings.impacts.impact_table import ImpactRow, ImpactTable
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.store import trials_below

PROPOSED_SPEED_FACTORS = ((2.0, "at twice the speed"), (0.5, "at half the speed"))  # of measured hits


@dataclass(frozen=True)
class Hit:
    """One trial or impact.

    Attributes:
        name: Name of the bag, or ``row 7``; the same whenever it is read.
        stamp: When it was measured [s], or the number of its row; hits with one stamp are simultaneous.
        timed: Whether the stamp is a time, in seconds since 1970.
        condition: Hits of one condition are repeats; empty: it repeats nothing.
        layout: Key of hits with equal features and equal scatter.
        group: Key of hits that share the amplitudes of the model discrepancy: its condition. With amplitudes common to
            conditions that alternate, a misfit would look like a change.
        features: Description of the entries.
        measured: Measured features, ``(F,)``.
        noise: Standard deviation of each feature, as stated with the measurement; 0: not stated, ``(F,)``.
        discrepancy: Patterns of the model discrepancy at amplitude 1, ``(k, F)``.
        physics: Nominal physics of its scene.
    """

    name: str
    stamp: float
    timed: bool
    condition: str
    layout: str
    group: str
    features: tuple[Feature, ...]
    measured: Array
    noise: Array
    discrepancy: Array
    physics: Physics

    @property
    def has_contact(self) -> bool:
        """Whether a feature belongs to an impact or push, and not all to free motion."""
        return any(feature.phase != "free" for feature in self.features)

    @property
    def shared(self) -> str:
        """Key of hits with equal initial states, which share sensitivities; empty: not shared."""
        return ""


class HitSource(ABC):
    """Source of hits in time order, and the model that predicts them.

    Attributes:
        model: The model.
        skipped: Name and reason of everything that gives no hit.
        waiting: Number of new hits that :meth:`arrived` has not yielded yet.
    """

    model: Model
    skipped: dict[str, str]
    _reported = 0  # entries of ``skipped``
    waiting: int = 0

    @abstractmethod
    def arrived(self) -> Iterator[Hit]:
        """New hits since the last call, in time order.

        Raises:
            InputError: The measurements cannot be read.
        """

    @abstractmethod
    def recalled(self, names: Sequence[str], handled: Sequence[str]) -> dict[str, Hit]:
        """Hits read again by name, after a restart.

        Args:
            names: Hits to read again.
            handled: All hits before the restart, which :meth:`arrived` skips from now on.

        Raises:
            InputError: One of them is gone.
        """

    def newly_skipped(self) -> dict[str, str]:
        """Entries of ``skipped`` since the last call."""
        reasons = dict(itertools.islice(self.skipped.items(), self._reported, None))
        self._reported = len(self.skipped)
        return reasons

    def limits(self, first: Sequence[Hit], layout: str) -> Array:
        """Relevance limits of the features of a layout, ``(F,)``.

        Args:
            first: Hits from which they follow.
            layout: The layout.
        """
        features = next(hit.features for hit in first if hit.layout == layout)
        return np.array([feature.relevance_limit for feature in features])

    def unmeasured(self, measured: Sequence[Hit]) -> Iterator[Hit]:
        """Candidate hits not measured yet, as predicted by the model; the condition describes them.

        Args:
            measured: The last hit of every condition.
        """
        yield from ()

    @abstractmethod
    def source(self, hits: Sequence[Hit]) -> Source:
        """Some hits as a source of evidence, with robots, ranges of parameters and noticeable changes."""

    @abstractmethod
    def predict(self, hit: Hit, added: Sequence[Added]) -> list[Array | None]:
        """Features of a hit under the model with each of some sets of effects, ``(F,)`` each; None: no contact."""


@dataclass(frozen=True)
class RowHit(Hit):
    """A row of a table.

    Attributes:
        source: Holds the row among others.
        index: Its row there.
    """

    source: ImpactTableSource
    index: int


class TableHitSource(HitSource):
    """Impacts of a table, in the order of its column ``time``, or of its rows.

    Args:
        read: Reads the table as it is now.
        model: The model.
        discrepancy: Discrepancy of the rigid map, for arms; None: as measured.
    """

    def __init__(
        self, read: Callable[[], ImpactTable], model: Model, discrepancy: MapDiscrepancy | None = None
    ) -> None:
        self._read, self._discrepancy = read, discrepancy
        self._table: ImpactTable | None = None
        self._handled: set[int] = set()  # numbers of rows
        self.model, self.skipped = model, {}

    def arrived(self) -> Iterator[Hit]:
        """See :meth:`HitSource.arrived`."""
        table = self._reread()
        fresh = [index for index, row in enumerate(table.rows) if row.number not in self._handled]
        self._handled |= {table.rows[index].number for index in fresh}
        hits = sorted(self._hits(table, fresh), key=lambda hit: (hit.stamp, hit.name))
        for count, hit in enumerate(hits, start=1):
            self.waiting = len(hits) - count
            yield hit

    def recalled(self, names: Sequence[str], handled: Sequence[str]) -> dict[str, Hit]:
        """See :meth:`HitSource.recalled`."""
        table = self._reread()
        index_of = {name_of_row(row.number): index for index, row in enumerate(table.rows)}
        if missing := [name for name in (*names, *handled) if name not in index_of]:
            raise InputError(f"{missing[0]}, which the state knows, is gone", file=table.path)
        self._handled = {row.number for row in table.rows if name_of_row(row.number) in set(handled)}
        return {hit.name: hit for hit in self._hits(table, [index_of[name] for name in dict.fromkeys(names)])}

    def limits(self, first: Sequence[Hit], layout: str) -> Array:
        """See :meth:`HitSource.limits`; they are shares of the closing speed of all first hits."""
        source = self.source(first)
        assert isinstance(source, ImpactTableSource)
        return np.array([feature.relevance_limit for feature in source.signals])

    def source(self, hits: Sequence[Hit]) -> Source:
        """See :meth:`HitSource.source`."""
        table = self._table
        assert table is not None
        names = {hit.name for hit in hits}
        indices = [index for index, row in enumerate(table.rows) if name_of_row(row.number) in names]
        indices.sort(key=lambda index: table.rows[index].object_name)  # the first row stands for the object
        return ImpactTableSource(table.part(indices), self.model, discrepancy=self._discrepancy)

    def predict(self, hit: Hit, added: Sequence[Added]) -> list[Array | None]:
        """See :meth:`HitSource.predict`."""
        assert isinstance(hit, RowHit)
        return hit.source.predict_row(hit.index, added)

    def unmeasured(self, measured: Sequence[Hit]) -> Iterator[Hit]:
        """See :meth:`HitSource.unmeasured`: measured hits at other speeds."""
        assert self._table is not None
        rows = {name_of_row(row.number): row for row in self._table.rows}
        for hit in measured:
            for factor, words in PROPOSED_SPEED_FACTORS:
                table = replace(self._table, rows=(_at_speed(rows[hit.name], factor),), noise=None, variants=())
                with suppress(InputError):  # the map has no solution
                    source = ImpactTableSource(table, self.model, discrepancy=self._discrepancy, remarks=False)
                    yield replace(_hit(source, 0), condition=f"{hit.condition or hit.name} {words}", group=hit.group)

    def _reread(self) -> ImpactTable:
        """The table as it is now, with a model for its arms."""
        table = self._table = self._read()
        self.model = with_per_arm_parameters(self.model, [row.physics for row in table.rows])
        return table

    def _hits(self, table: ImpactTable, indices: Sequence[int]) -> list[RowHit]:
        """Hits of some rows; those for which the map has no solution are left out, with the reason."""
        if not indices:
            return []
        try:
            source = ImpactTableSource(table.part(indices), self.model, discrepancy=self._discrepancy, remarks=False)
        except InputError as error:
            if len(indices) == 1:
                self.skipped[name_of_row(table.rows[indices[0]].number)] = str(error)
                return []
            half = len(indices) // 2
            return [*self._hits(table, indices[:half]), *self._hits(table, indices[half:])]
        return [_hit(source, index) for index in range(len(indices))]


def _at_speed(row: ImpactRow, factor: float) -> ImpactRow:
    """A row with all velocities times a factor."""
    impact = row.impact
    arms = {name: ArmState(state.position, factor * state.velocity) for name, state in impact.arms.items()}
    body = replace(impact.object, twist=factor * impact.object.twist)
    return replace(row, impact=replace(impact, arms=arms, object=body), after=factor * row.after)


def _hit(source: ImpactTableSource, index: int) -> RowHit:
    """One row of a source."""
    row = source.table.rows[index]
    condition = ", ".join(filter(None, (row.object_name, row.condition))) if row.condition else ""
    return RowHit(
        name=name_of_row(row.number),
        stamp=float(row.number) if row.time is None else row.time,
        timed=row.time is not None,
        condition=condition,
        layout="impacts",
        group=condition,
        features=source.signals,
        measured=source.measured[index],
        noise=np.zeros(source.measured.shape[1]) if source.noise is None else source.noise[index],
        discrepancy=np.diag(source.map_discrepancy_of(index)),
        physics=row.physics,
        source=source,
        index=index,
    )


@dataclass(frozen=True)
class BagHit(Hit):
    """A bag.

    Attributes:
        run: Its measured run.
    """

    run: MeasuredRun

    @property
    def shared(self) -> str:
        """See :attr:`Hit.shared`: repeats with the same signals have nearly equal initial states."""
        return self.group


class BagHitSource(HitSource):
    """Finished trials of a folder, in the order in which they were recorded.

    Args:
        directory: The folder.
        model: The model.
        store: Makes replays.
        discrepancy: Discrepancy of the twin; None: as measured.
    """

    def __init__(
        self,
        directory: Path,
        model: Model,
        store: ReplayCache,
        discrepancy: Discrepancy | None = None,
    ) -> None:
        self._directory, self._store, self._discrepancy = directory, store, discrepancy
        self._handled: set[Path] = set()
        self._conditions: set[str] = set()
        self._scenarios: dict[str, Scenario] = {}
        self.model, self.skipped = model, {}

    def arrived(self) -> Iterator[Hit]:
        """See :meth:`HitSource.arrived`; each bag is read when it is due; ``skipped`` names the others."""
        if not self._directory.is_dir():
            raise InputError("no such folder of trials", file=self._directory)
        fresh = [path for path in trials_below(self._directory) if path not in self._handled]
        fresh.sort(key=lambda path: (recorded_at(path), str(path)))
        for count, path in enumerate(fresh, start=1):
            self._handled.add(path)
            self.waiting = len(fresh) - count
            hit = self._read(path)
            if isinstance(hit, BagHit):
                yield hit
            else:
                self.skipped[str(path.relative_to(self._directory))] = hit

    def recalled(self, names: Sequence[str], handled: Sequence[str]) -> dict[str, Hit]:
        """See :meth:`HitSource.recalled`."""
        self._handled = {self._directory / name for name in handled}
        hits: dict[str, Hit] = {}
        for name in dict.fromkeys(names):
            run = read_trial(self._directory / name)
            if not isinstance(run, MeasuredRun):
                raise InputError(f"this trial, which the state knows, cannot be read: {run[1]}", file=run[0])
            hits[name] = self._arrived(run, self._directory / name)
        return hits

    def unmeasured(self, measured: Sequence[Hit]) -> Iterator[Hit]:
        """See :meth:`HitSource.unmeasured`: every object and case, simulated by the twin; what fails is left out."""
        del measured
        for scenario in list(self._scenarios.values()):
            for item, case in itertools.product(scenario.objects, scenario.cases):
                spec = TrialSpec.of(scenario, item, case)
                if label_of(spec) in self._conditions:
                    continue
                with suppress(InputError):  # out of reach, or no contact
                    run, verdict = simulated_and_judged(spec, with_effects(self.model, spec.scene.physics, ()))
                    if verdict.outcome == "OK":
                        yield self._hit(MeasuredRun.of(run), self._directory / label_of(spec), 0.0)

    def source(self, hits: Sequence[Hit]) -> Source:
        """See :meth:`HitSource.source`."""
        runs = Runs.of(self._directory, [hit.run for hit in hits if isinstance(hit, BagHit)])
        return ReplaySource.of(runs, self.model, self._store, self._discrepancy)

    def predict(self, hit: Hit, added: Sequence[Added]) -> list[Array | None]:
        """See :meth:`HitSource.predict`."""
        assert isinstance(hit, BagHit)
        return self._store([Replay(hit.run.setup, self.model, effects) for effects in added])

    def _read(self, path: Path) -> BagHit | str:
        """The hit of a bag, or the reason why it cannot be used."""
        run = read_trial(path)
        if not isinstance(run, MeasuredRun):
            return run[1]
        try:
            return self._arrived(run, path)
        except Exception as error:  # a trial with odd numbers must not stop the next ones
            return reason_of(error)

    def _arrived(self, run: MeasuredRun, path: Path) -> BagHit:
        """A trial that was measured."""
        self._conditions.add(run.condition)
        if run.spec is not None:
            self._scenarios[run.spec.scenario.name] = run.spec.scenario
        return self._hit(run, path, recorded_at(path) if run.recorded is None else run.recorded)

    def _hit(self, run: MeasuredRun, path: Path, stamp: float) -> BagHit:
        runs = Runs(self._directory, (run,), ())
        (cluster,), _ = clusters_of(runs, [np.zeros(run.measured.size)], self._discrepancy)
        return BagHit(
            name=str(path.relative_to(self._directory)),
            stamp=stamp,
            timed=True,
            condition=run.condition,
            layout=layout_of(run),
            group=f"{cluster.layout}: {run.condition}",
            features=run.features,
            measured=run.measured,
            noise=np.zeros(run.measured.size),
            discrepancy=cluster.discrepancy_factor * cluster.sigma,
            physics=run.physics,
            run=run,
        )
