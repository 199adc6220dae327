# SPDX-License-Identifier: Apache-2.0
"""Forecast: simulated candidate trials, their scatter, and their features under every explanation.

A trial is simulated once in closed loop with the model and judged as a measured one: it is rejected if it exceeds a
limit of joints or torques, misses, or tips over. Its replays under the explanations give the features of a diagnosis.
The scatter is taken from the trials measured so far, else from trials simulated with the scenario's noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from impact_rs_analysis.design.explanations import Decision, Explanation
from impact_rs_analysis.design.possible_trials import NO_ENVELOPE, Envelope, PossibleTrial
from impact_rs_analysis.evidence.cluster import Added, Cluster
from impact_rs_analysis.evidence.discrepancy import measured_discrepancy
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.replays.replay_cache import Replay, ReplayCache, with_effects
from impact_rs_analysis.evidence.replays.simulated_trials import simulated_and_judged
from impact_rs_analysis.evidence.source import with_per_arm_parameters
from impact_rs_analysis.evidence.sources.run_source import ReplaySource, clusters_of
from impact_rs_sim.effects import Effect
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.seeds import seed_of
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec

NOISY_TRIALS, NOISY_REPEATS = 3, 3  # per family of trials: six degrees of freedom of the scatter
ACCEPTED_OUTCOMES = ("OK", "DROPPED")  # a forecast ends before the object is lifted


@dataclass(frozen=True)
class ForecastTrial:
    """A possible trial with its predictions.

    Attributes:
        name: Name of its condition.
        trial: How to run it; None: a condition that was measured and cannot be planned again.
        cluster: Scale, scatter and discrepancy of its features.
        centres: Change of the features by each explanation's centre, scaled, ``(h, F)`` [-].
        spreads: Change of the features by one standard deviation of each parameter, ``(p, F)`` by explanation [-].
        repeats: Number of repeats measured.
    """

    name: str
    trial: PossibleTrial | None
    cluster: Cluster
    centres: Array
    spreads: tuple[Array, ...]
    repeats: int = 0


@dataclass(frozen=True)
class Forecast:
    """Simulated trials, ready for predictions.

    Attributes:
        source: Possible and measured trials, all in the form of measurements.
        trials: Possible trials by condition.
        repeats: How often a condition was measured.
        refused: Trials beyond limits, with the reason.
    """

    source: ReplaySource
    trials: dict[str, PossibleTrial]
    repeats: dict[str, int]
    refused: tuple[tuple[str, str], ...]

    def under(self, decision: Decision) -> list[ForecastTrial]:
        """Every trial under the explanations of a decision."""
        source, effects = self.source, self.source.model.known_effects
        requests: list[tuple[int, Added]] = []
        for number, item in enumerate(source.clusters):
            requests.append((number, ()))
            for explanation in decision.explanations:
                if _shown(explanation, item, effects):
                    requests += [(number, added) for added in explanation.all_added]
        features = dict(zip(requests, source.predict(requests, "predictions"), strict=True))
        forecasts = []
        for number, item in enumerate(source.clusters):
            base = features[number, ()]
            assert base is not None  # the source keeps no other
            columns = [
                _columns([features[number, added] for added in explanation.all_added], base, item)
                if _shown(explanation, item, effects)
                else np.zeros((1 + len(explanation.varied), base.size))
                for explanation in decision.explanations
            ]
            complete = [rows for rows in columns if rows is not None]
            if len(complete) == len(columns):  # without an impact there is nothing to compare
                forecasts.append(
                    ForecastTrial(
                        name=item.name,
                        trial=self.trials.get(item.name),
                        cluster=item,
                        centres=np.array([rows[0] for rows in complete]),
                        spreads=tuple(rows[1:] for rows in complete),
                        repeats=self.repeats.get(item.name, 0),
                    )
                )
        return forecasts


def _columns(predicted: Sequence[Array | None], base: Array, item: Cluster) -> Array | None:
    """Scaled change of the features by the centre, then by every deviation, ``(1 + p, F)``; None without an impact.

    Args:
        predicted: Features by :attr:`Explanation.all_added`, ``(F,)`` each.
        base: Features of the model as it is, ``(F,)``.
        item: Scale of the features.
    """
    hits = [row for row in predicted if row is not None]
    if len(hits) < len(predicted):
        return None
    centre, *varied = hits
    return np.array([centre - base, *(row - centre for row in varied)]) / item.sigma


def forecast_of(
    model: Model,
    trials: Sequence[PossibleTrial],
    store: ReplayCache,
    envelope: Envelope = NO_ENVELOPE,
    runs: Runs | None = None,
    seed: int = 0,
) -> Forecast:
    """Simulate trials with a model, and their scatter.

    Args:
        model: The model.
        trials: The possible trials.
        store: Makes replays, and spreads simulations.
        envelope: Envelope of the cell.
        runs: Trials measured so far, for their scatter and information.
        seed: Seed of the simulated scatter.

    Raises:
        InputError: No trial is within the limits, or the model is not valid.
    """
    conditions = {} if runs is None else runs.conditions
    tasks = [_Task(trial.spec, model, envelope) for trial in trials if trial.name not in conditions]
    results = store.distribute(_simulated, tasks, "trials on the twin")
    simulated = [run for run in results if isinstance(run, MeasuredRun)]
    refused = tuple(run for run in results if not isinstance(run, MeasuredRun))
    measured = () if runs is None else runs.runs
    if not simulated and not measured:
        first = f", the first because: {refused[0][1]}" if refused else ""
        raise InputError(f"none of {len(trials)} trials is within the limits{first}")
    noisy = _noisy(simulated, [run for group in conditions.values() for run in group[:2] if len(group) > 1])
    repeated = [
        run
        for run in store.distribute(
            _simulated,
            [
                _Task(spec, model, NO_ENVELOPE, seed_of(seed, f"{label_of(spec)} {repeat}"))
                for spec in noisy
                for repeat in range(NOISY_REPEATS)
            ],
            "scatter on the twin",
        )
        if isinstance(run, MeasuredRun)
    ]
    alike = {run.condition: run.features for run in simulated}
    repeated = [run for run in repeated if run.features == alike[run.condition]]
    scattered = {run.condition for run in repeated}
    all_runs = [*measured, *repeated, *(run for run in simulated if run.condition not in scattered)]
    joined = Runs(Path() if runs is None else runs.directory, tuple(all_runs), ())
    model = with_per_arm_parameters(model, [run.setup.physics for run in all_runs])
    predicted = store([Replay(run.setup, model.containing(())) for run in all_runs], "replays of the model")
    predicted_runs = [(run, row) for run, row in zip(all_runs, predicted, strict=True) if row is not None]
    joined = replace(joined, runs=tuple(run for run, _ in predicted_runs))
    discrepancy = measured_discrepancy()
    clusters, _ = clusters_of(joined, [run.measured - row for run, row in predicted_runs], discrepancy)
    source = ReplaySource(joined, model, store, clusters, discrepancy)
    return Forecast(
        source,
        {trial.name: trial for trial in trials},
        {name: len(group) for name, group in conditions.items()},
        refused,
    )


@dataclass(frozen=True)
class _Task:
    spec: TrialSpec
    model: Model
    envelope: Envelope
    seed: int | None = None


def _simulated(task: _Task) -> MeasuredRun | tuple[str, str]:
    """The simulated trial, or its name and the reason of its rejection."""
    name = label_of(task.spec)
    try:
        physics = with_effects(task.model, task.spec.scene.physics, ())
        run, verdict = simulated_and_judged(task.spec, physics, seed=task.seed)
        if verdict.outcome not in ACCEPTED_OUTCOMES:
            return name, f"{verdict.outcome}: {verdict.reason}"
        measured_run = MeasuredRun.of(run)
    except InputError as error:  # out of reach, or no contact
        return name, str(error)
    force = largest_force(measured_run)
    if task.envelope.force is not None and force > task.envelope.force:
        return name, f"contact force {force:.0f} N, limit {task.envelope.force:g} N"
    return measured_run


def largest_force(run: MeasuredRun) -> float:
    """Largest contact force of any arm at an impact, in the mean over a time bin [N]."""
    components = [
        value
        for feature, value in zip(run.features, run.measured, strict=True)
        if (feature.phase, feature.signal) == ("impact", "contact force")
    ]
    return float(np.linalg.norm(np.reshape(components, (-1, 3)), axis=1).max(initial=0.0))


def _noisy(simulated: Sequence[MeasuredRun], repeated: Sequence[MeasuredRun]) -> list[TrialSpec]:
    """Trials whose scatter is simulated: some of each family without measured repeats."""
    measured_families = {run.family for run in repeated}
    groups: dict[tuple[object, ...], list[TrialSpec]] = {}
    for run in simulated:
        if run.family not in measured_families and run.spec is not None:
            groups.setdefault(run.family, []).append(run.spec)
    chosen = []
    for specs in groups.values():
        indices = np.unique(np.linspace(0, len(specs) - 1, NOISY_TRIALS).round().astype(int))
        chosen += [specs[index] for index in indices]
    return chosen


def _shown(explanation: Explanation, item: Cluster, effects: Mapping[str, Effect]) -> bool:
    """Whether an explanation changes features of a cluster."""
    return any(effects[name].seen_in(item.contact) for name in explanation.effects)
