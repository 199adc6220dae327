# SPDX-License-Identifier: Apache-2.0
"""Runs as a source of evidence: clusters are conditions with their repeats, predicted by the replay twin."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import zip_longest
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.calibration import with_intervals
from impact_rs_analysis.evidence.cluster import SCALE, TIMES, Added, Cluster, pooled_error
from impact_rs_analysis.evidence.discrepancy import MAX_SQUARE_ANGLE_RAD, Discrepancy, Kind, measured_discrepancy
from impact_rs_analysis.evidence.levels import Comparison, condition_scores, level_of, score_of, signal_levels, where_of
from impact_rs_analysis.evidence.replays.ante_impact import obliqueness
from impact_rs_analysis.evidence.replays.contact_estimate import contact_estimate, contact_starts
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.replays.replay_cache import Replay, ReplayCache
from impact_rs_analysis.evidence.rollouts import MAX_ROLLOUT_STARTS, FreeMotion, free_of_contact, without
from impact_rs_analysis.evidence.source import Identity, Item, Output, RequiredEffect, Source, with_per_arm_parameters
from impact_rs_analysis.evidence.tracks import Track, tracks_of_runs
from impact_rs_sim.effects import PAD_POSITION, Effect
from impact_rs_sim.effects.sensing import COMMAND_CLOCK_OFFSET, TRACKED_POINT, TRACKER_FRAME
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.runs import NONE, Signals
from impact_rs_trials.workers import Map

TRACKER_EFFECTS = (TRACKER_FRAME, TRACKED_POINT)
CONTACT_EFFECTS = (*TRACKER_EFFECTS, PAD_POSITION)  # possible reasons why the replay of an impact misses the object
MAX_MISSED_SHARE = 0.5  # of the runs with an impact; if the replay misses more, the model is refused

LEVELS = {  # description and phases of every level
    "free_motion": ("torque balances and deflection in windows without contact", ("free",)),
    "trial": (
        "the replay from before the impact to the end of the push: velocity, contact force and object motion",
        ("impact", "push"),
    ),
}


def clusters_of(
    runs: Runs, residuals: Sequence[Array], discrepancy: Discrepancy | None = None
) -> tuple[tuple[Cluster, ...], list[str]]:
    """Residuals of all runs as clusters, in order of appearance.

    Without repeats of a layout its features have no pure error. They are then scaled by the relevance limits, with a
    remark.

    Args:
        runs: The runs.
        residuals: Measured minus predicted features per run, in their units.
        discrepancy: Model discrepancy of the twin; None: the shipped one.

    Returns:
        Clusters, and remarks for the user.
    """
    discrepancy = measured_discrepancy() if discrepancy is None else discrepancy
    firsts: dict[str, MeasuredRun] = {}
    grouped: dict[str, list[Array]] = {}
    stamps: dict[str, list[float]] = {}
    for run, residual in zip(runs.runs, residuals, strict=True):
        firsts.setdefault(run.condition, run)
        stamps.setdefault(run.condition, []).append(np.nan if run.recorded is None else run.recorded)
        grouped.setdefault(run.condition, []).append(residual)
    rows = {condition: np.array(values) for condition, values in grouped.items()}
    layouts = {condition: layout_of(first) for condition, first in firsts.items()}
    pure = pure_errors(firsts, rows)
    clusters = []
    for condition, values in rows.items():
        first, layout = firsts[condition], layouts[condition]
        spread = pure[condition]
        limit = np.array([feature.relevance_limit for feature in first.features]) / 2.0
        kind = kind_of(first)
        size = Proportion.of(first.physics)
        factor = np.array([size.factor(feature.unit) for feature in first.features])  # to the size of this robot
        systematic, patterns = discrepancy.of(first.features, kind), discrepancy.patterns_of(first.features, kind)
        systematic, patterns = factor * systematic, None if patterns is None else factor * patterns
        pure_error = np.zeros_like(limit) if spread is None else spread
        sigma = np.sqrt(pure_error**2 + limit**2 + systematic**2)
        clusters.append(
            Cluster(
                name=condition,
                condition_key=first.condition_key,
                layout=layout,
                unit=condition,
                contact=first.hit,
                features=first.features,
                residuals=values / sigma,
                sigma=sigma,
                pure_error=pure_error / sigma,
                discrepancy=systematic / sigma,
                patterns=None if patterns is None else patterns / sigma,
                # On oblique hits the difference between simulators depends on the condition.
                discrepancy_key=condition if kind == "oblique" else f"{layout}, {kind}",
                timestamps=None if np.isnan(stamps[condition]).any() else np.array(stamps[condition]),
            )
        )
    alone = [item.name for item in clusters if pure[item.name] is None]
    remarks = []
    if alone:
        remarks.append(
            f"not repeated, so differences are in multiples of the relevance limit and not of repeatability: "
            f"{', '.join(alone)}; two trials of one condition give the repeatability"
        )
    return tuple(clusters), remarks


def pure_errors(firsts: dict[str, MeasuredRun], rows: dict[str, Array]) -> dict[str, Array | None]:
    """Pure error by condition, ``(F,)`` in the features' units; None without repeats in its family.

    The error of a feature is pooled over the conditions of one family (:attr:`MeasuredRun.family`) that have it.

    Args:
        firsts: A run of every condition.
        rows: Residuals of its repeats, ``(n, F)``.
    """
    families: dict[tuple[object, ...], list[str]] = {}
    for condition, run in firsts.items():
        families.setdefault(run.family, []).append(condition)
    errors: dict[str, Array | None] = {}
    for members in families.values():
        whole = pooled_error([rows[condition] for condition in members if not firsts[condition].lost])
        columns_of = {c: {feature: column for column, feature in enumerate(firsts[c].features)} for c in members}
        for condition in members:
            if not any(firsts[member].lost for member in members):
                errors[condition] = whole
                continue
            columns = [
                pooled_error([rows[c][:, [column[feature]]] for c, column in columns_of.items() if feature in column])
                for feature in firsts[condition].features
            ]
            pooled = [column for column in columns if column is not None]
            errors[condition] = np.concatenate(pooled) if len(pooled) == len(columns) else None
    return errors


def kind_of(run: MeasuredRun) -> Kind:
    """Kind of the model discrepancy of a run."""
    if not run.hit:
        return "free"
    return "oblique" if obliqueness(run) > MAX_SQUARE_ANGLE_RAD else "square"


def layout_of(run: MeasuredRun) -> str:
    """Key of the composition of a run's feature vector."""
    counted = dict.fromkeys(feature.group[:2] for feature in run.features)
    bins = ", ".join(f"{phase} {signal} {bin_count(run, phase, signal)}" for phase, signal in counted)
    lost = f", without {', '.join(map(str, run.lost))}" if run.lost else ""
    arms = ", ".join(run.setup.physics.arms)
    return f"{'hit' if run.hit else 'free'}: {arms}, {len(run.features)} features: {bins}{lost}"


def bin_count(run: MeasuredRun, phase: str, signal: str) -> int:
    """Number of time bins of a signal."""
    return 1 + max(feature.bin for feature in run.features if (feature.phase, feature.signal) == (phase, signal))


def _replays_of(runs: Runs, model: Model, store: ReplayCache, added: Added = ()) -> list[Array | None]:
    """Predicted features of every run; None where the replay hits nothing."""
    bare = model.containing(name for name, _ in added)
    return store([Replay(run.setup, bare, added) for run in runs.runs], "replays of the model")


def _residuals_if_all_hit(runs: Runs, predicted: Sequence[Array | None]) -> list[Array] | None:
    """Residuals of every run; None if a replay hits nothing or is not finite."""
    residuals = [
        run.measured - values
        for run, values in zip(runs.runs, predicted, strict=True)
        if values is not None and np.isfinite(values).all()
    ]
    return residuals if len(residuals) == len(predicted) else None


def _with_late(
    clusters: Sequence[Cluster], runs: Runs, residuals: Sequence[Array], model: Model, store: ReplayCache
) -> tuple[Cluster, ...]:
    """Clusters with the systematic error of the command clock."""
    firsts = {run.condition: values for run, values in zip(reversed(runs.runs), reversed(residuals), strict=True)}
    late = {name: run for name, run in runs.late.items() if name in firsts}
    predicted = store([Replay(run.setup, model) for run in late.values()], "clock of the commands")
    moved = {
        name: run.measured - values - firsts[name]
        for (name, run), values in zip(late.items(), predicted, strict=True)
        if values is not None and np.isfinite(values).all()
    }
    return tuple(
        replace(item, calibrations=(moved[item.name] / item.sigma)[None, :]) if item.name in moved else item
        for item in clusters
    )


class ReplaySource(Source):
    """Runs against the replay twin of a model.

    Args:
        runs: The runs.
        model: The model.
        store: Cache of replays.
        clusters: Residuals of the model by condition, in the order of ``runs.conditions``.
        discrepancy: Model discrepancy of the twin.
        remarks: Remarks for the reader.

    Attributes:
        conditions: Runs of every cluster, in the order of clusters.
    """

    repeated = True
    runs: Runs

    def __init__(
        self,
        runs: Runs,
        model: Model,
        store: ReplayCache,
        clusters: tuple[Cluster, ...],
        discrepancy: Discrepancy,
        remarks: Sequence[str] = (),
    ) -> None:
        self.runs, self.model, self.store, self.clusters = runs, model, store, clusters
        self.discrepancy, self.remarks, self.clock = discrepancy, tuple(remarks), runs.clock
        self.conditions = list(runs.conditions.values())
        self._effects = model.known_effects
        self.physics = model.apply(self.conditions[0][0].setup.physics)
        self._numbers = {item.name: number for number, item in enumerate(clusters)}
        repeated = self.noise_size() is not None
        self.size_unit = TIMES if repeated else "-"
        self.size_is = (
            "size of the difference between measurement and replay over all features and conditions, in multiples of "
            f"{'repeatability' if repeated else SCALE}"
        )

    @cached_property
    def worlds(self) -> Sequence[Physics]:
        """See :attr:`Source.worlds`."""
        return [self.model.apply(runs[0].setup.physics) for runs in self.conditions]

    @cached_property
    def identity(self) -> Identity:
        """See :attr:`Source.identity`; its digest opens every bag."""
        return Identity(self.runs.digest, len(self.runs.runs), tuple(self.runs.conditions), self.runs.recorded)

    @classmethod
    def of(
        cls,
        runs: Runs,
        model: Model,
        store: ReplayCache,
        discrepancy: Discrepancy | None = None,
        each_arm: bool = False,
    ) -> ReplaySource:
        """Replay every run with the model.

        Where replays hit nothing and one of ``CONTACT_EFFECTS`` makes all of them hit, it is added to the model
        (:attr:`Source.required`). Otherwise these runs are left out, with a remark.

        Args:
            runs: The runs.
            model: The model.
            store: Cache of replays.
            discrepancy: Model discrepancy of the twin; None: the shipped one.
            each_arm: Whether arms of one kind have separate parameters (:func:`with_per_arm_parameters`).

        Raises:
            InputError: Most replays with this model have no impact, or one is not finite.
        """
        discrepancy = measured_discrepancy() if discrepancy is None else discrepancy
        model = with_per_arm_parameters(model, [run.setup.physics for run in runs.runs], each_arm)
        predicted = _replays_of(runs, model, store)
        missed = [run for run, values in zip(runs.runs, predicted, strict=True) if values is None]
        with_contact_effect = cls._with_contact_effect(runs, model, store, discrepancy, len(missed)) if missed else None
        most = len(missed) > MAX_MISSED_SHARE * sum(run.hit for run in runs.runs)
        if with_contact_effect is None and most:
            raise InputError(
                f"with model {model.name!r} the replay hits nothing; are the poses of the object in the frame of the "
                "robot, and is it the object of the scenario? motion_capture in the experiment file says where they "
                "are measured",
                file=missed[0].path,
            )
        alone = None if most else cls._of_hits(runs, predicted, model, store, discrepancy)._with_calibration_errors()
        if with_contact_effect is None:
            assert alone is not None
            return alone
        with_contact_effect.without_required = alone
        return with_contact_effect._with_calibration_errors()

    @classmethod
    def _of_hits(
        cls, runs: Runs, predicted: Sequence[Array | None], model: Model, store: ReplayCache, discrepancy: Discrepancy
    ) -> ReplaySource:
        """The source of the runs whose replay has its impact, without systematic errors of a calibration."""
        residuals, hits, missed = [], [], []
        for run, values in zip(runs.runs, predicted, strict=True):
            if values is None:
                missed.append(Path(run.path).name)
                continue
            if not np.isfinite(values).all():
                raise InputError(f"with model {model.name!r} the replay is not finite or not solved", file=run.path)
            residuals.append(run.measured - values)
            hits.append(run)
        if missed:
            remark = f"left out, because with model {model.name!r} the replay hits nothing: {', '.join(missed)}"
            runs = runs.only(hits, remark)
        return cls._of_residuals(runs, residuals, model, store, discrepancy)

    @classmethod
    def _with_contact_effect(
        cls, runs: Runs, model: Model, store: ReplayCache, discrepancy: Discrepancy, missed: int
    ) -> ReplaySource | None:
        """The source with the effect that makes every replay hit, with the smallest residuals; None: no such effect."""
        impacts, present = sum(run.hit for run in runs.runs), {item.name for item in model.effects}
        candidates: list[tuple[RequiredEffect, list[Array], Model]] = []
        for name in (effect.name for effect in CONTACT_EFFECTS if effect.name not in present):
            effect = model.known_effects[name]
            estimate = contact_estimate(effect, runs.runs)
            if estimate is None or (item := estimate.item) is None:
                continue
            extended = model.with_effect(item, name=model.name, parent=model.name)
            residuals = _residuals_if_all_hit(runs, _replays_of(runs, extended, store))
            if residuals is None:
                continue
            clusters, _ = clusters_of(runs, residuals, discrepancy)
            candidates.append((RequiredEffect(item, score_of(clusters), missed, impacts), residuals, extended))
        if not candidates:
            return None
        candidates.sort(key=lambda candidate: candidate[0].size)
        (best, residuals, extended), required = candidates[0], tuple(candidate for candidate, *_ in candidates)
        remark = (
            f"with model {model.name!r} the replays of {missed} of {impacts} impacts hit nothing, and with "
            f"{best.item.name} as estimated from the impacts all of them hit; all errors are computed with it"
        )
        runs = replace(runs, remarks=(*runs.remarks, remark))
        source = cls._of_residuals(runs, residuals, extended, store, discrepancy)
        source.required = required
        return source

    @classmethod
    def _of_residuals(
        cls, runs: Runs, residuals: Sequence[Array], model: Model, store: ReplayCache, discrepancy: Discrepancy
    ) -> ReplaySource:
        """The source without systematic errors of a calibration."""
        clusters, remarks = clusters_of(runs, residuals, discrepancy)
        clusters = _with_late(clusters, runs, residuals, model, store)
        return cls(runs, model, store, clusters, discrepancy, (*runs.remarks, *remarks))

    def size_by_declared_model(self, added: Added) -> float | None:
        """See :meth:`Source.size_by_declared_model`."""
        predicted = _replays_of(self.runs, self.declared_model, self.store, added)
        residuals = _residuals_if_all_hit(self.runs, predicted)
        if residuals is None:
            return None
        clusters, _ = clusters_of(self.runs, residuals, self.discrepancy)
        return score_of(clusters)

    def _with_calibration_errors(self) -> ReplaySource:
        """The source with the systematic errors of the calibration and of the required effect."""
        self.clusters = with_intervals(self, self.clusters)
        return self

    def compare_levels(self) -> Comparison:
        """See :meth:`Source.compare_levels`: free motion, and the replay through the impact."""
        limited = self.noise_size() is None
        return Comparison(
            levels={name: level_of(text, self.clusters, phases, limited) for name, (text, phases) in LEVELS.items()},
            where=tuple(where_of(self.clusters, limited)),
            conditions=condition_scores(self.clusters),
            joints=tuple(signal_levels(self.clusters, by_joint=True, by_limit=limited)[0]),
        )

    def tracks(self, map_tasks: Map, added: Added = ()) -> tuple[Track, ...]:
        """See :meth:`Source.tracks`: the first run of every condition and its replay."""
        return tracks_of_runs(self.runs, self.model, map_tasks, added)

    def free_motions(self, numbers: Sequence[int] | None = None) -> tuple[FreeMotion, ...]:
        """See :meth:`Source.free_motions`: up to ``MAX_ROLLOUT_STARTS`` runs before the impact, conditions in turn."""
        chosen = range(len(self.conditions)) if numbers is None else numbers
        turns = zip_longest(*(self.conditions[number] for number in chosen))
        runs = [run for turn in turns for run in turn if run is not None and run.signals.time.size]
        worlds: dict[int, Physics] = {}
        parts = []
        for run in runs[:MAX_ROLLOUT_STARTS]:
            if id(run.setup.physics) not in worlds:
                worlds[id(run.setup.physics)] = self.model.apply(run.setup.physics)
            motions = free_of_contact(run, run.impacts, worlds[id(run.setup.physics)], run.setup.windows[0].age)
            parts += [part for motion in motions for part in without(motion, run.gaps)]
        return tuple(parts)

    def predict(self, requests: Sequence[tuple[int, Added]], purpose: str) -> list[Array | None]:
        """See :meth:`Source.predict`; the first run of every condition is replayed."""
        return self.store([self._replay(self.conditions[number][0], added) for number, added in requests], purpose)

    def _replay(self, run: MeasuredRun, added: Added) -> Replay:
        """A replay of a run with effects; for the cache key its model has only the formulas of these effects."""
        return Replay(run.setup, self.model.containing(name for name, _ in added), added)

    @cached_property
    def free_motion_part(self) -> ReplaySource | None:
        """See :attr:`Source.free_motion_part`; a replay of an impact costs as much as several of free motion."""
        if not any(item.contact for item in self.clusters):
            return None
        masks = [[feature.phase == "free" for feature in item.features] for item in self.clusters]
        clusters = tuple(item.only(mask, contact=False) for item, mask in zip(self.clusters, masks, strict=True))
        bare = tuple(
            replace(run, signals=Signals(NONE, {}), setup=run.setup.free_motion_part) for run in self.runs.runs
        )
        return ReplaySource(replace(self.runs, runs=bare, late={}), self.model, self.store, clusters, self.discrepancy)

    def offers(self, effect: Effect) -> bool:
        """See :meth:`Source.offers`; in trials of this software commands and joints share a clock."""
        return super().offers(effect) and (self.clock > 0.0 or effect.name != COMMAND_CLOCK_OFFSET.name)

    def starts(self, name: str) -> Sequence[Array]:
        """See :meth:`Source.starts`: frame of the tracker, and tracked point."""
        return self._tracker_starts.get(name, ())

    @cached_property
    def _tracker_starts(self) -> Mapping[str, Sequence[Array]]:
        """Estimates from the impacts by effect."""
        return {effect.name: contact_starts(effect, self.runs.runs) for effect in TRACKER_EFFECTS}

    def distribute(
        self, function: Callable[[Source, Item], Output], items: Sequence[Item], purpose: str
    ) -> list[Output]:
        """See :meth:`Source.distribute`; every process gets a copy of the cache."""
        bare = tuple(replace(run, signals=Signals(NONE, {})) for run in self.runs.runs)  # for figures and clusters only
        runs, store = replace(self.runs, runs=bare, late={}), self.store.in_one_process()
        alone = ReplaySource(runs, self.model, store, self.clusters, self.discrepancy, self.remarks)
        alone._tracker_starts = self._tracker_starts  # the copy has no signals
        return self.store.distribute(partial(function, alone), items, purpose)

    def residuals_with(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """See :meth:`Source.residuals_with`; every run is replayed from its own start."""
        groups = [self.conditions[self._numbers[item.name]] for item in like]
        tasks = [self._replay(run, added) for group in groups for run in group]
        features = self.store(tasks, "every run again")
        if any(values is None for values in features):
            return None
        predicted = iter(features)
        return [
            replace(
                item, residuals=np.array([run.measured - np.asarray(next(predicted)) for run in group]) / item.sigma
            )
            for item, group in zip(like, groups, strict=True)
        ]
