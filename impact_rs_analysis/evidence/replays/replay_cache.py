# SPDX-License-Identifier: Apache-2.0
"""Cache of replays in memory: comparisons and diagnoses need many of them repeatedly.

The key is the start of the replay, the model and the added effects, on which alone the result depends.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.replays.measured_runs import Setup
from impact_rs_sim.effects.base import SINGLE_IMPACT
from impact_rs_sim.errors import NotABody
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.workers import Map, on_threads

MIN_BATCH, MAX_BATCH = 4, 32  # replays per task, 30 to 300 ms of work: a task has an overhead of milliseconds
MIN_BATCHES = 16  # so that workers finish at about the same time

_models_lock = threading.Lock()  # rigid-body models, which features share, are not thread-safe

Progress = Callable[[str, int, int], None]
Key = tuple[str, str, Added]  # digests of start and model, and the effects, which determine a replay

Item = TypeVar("Item")
Output = TypeVar("Output")


@dataclass(frozen=True)
class Replay:
    """One replay: a run under a model with added effects at given values.

    Attributes:
        setup: Its start state and inputs.
        model: The model.
        added: Names of added effects with their parameter vectors.
    """

    setup: Setup
    model: Model
    added: Added = ()

    @property
    def physics(self) -> Physics:
        """Its physics.

        Raises:
            NotABody: The effects leave no body.
        """
        return with_effects(self.model, self.setup.physics, self.added)


def with_effects(model: Model, physics: Physics, added: Added) -> Physics:
    """Nominal physics with a model and added effects.

    Raises:
        NotABody: The effects leave no body.
    """
    physics, effects = model.apply(physics), model.known_effects
    for name, values in added:
        physics = effects[name].apply_vector(physics, np.array(values))
    return physics


def run_replay(task: Replay) -> Array | None:
    """Features of one replay, as :func:`run_batch`."""
    return run_batch([task])[0]


@on_threads
def run_batch(tasks: Sequence[Replay]) -> list[Array | None]:
    """Features of replays of one run; None if an expected impact is missing.

    None also if the added effects give a body without positive inertia or an unstable simulation: a fit then tries a
    smaller step.

    Raises:
        InputError: The model itself is not valid.
    """
    results: list[Array | None] = [None] * len(tasks)
    setup, physics = tasks[0].setup, {}
    for number, task in enumerate(tasks):
        try:
            physics[number] = task.physics
        except NotABody:
            if not task.added:
                raise
    if not physics:
        return results
    simulations = setup.replayed_all(list(physics.values()))
    with _models_lock:
        features = setup.features_of_all(simulations)
    for number, values in zip(physics, features, strict=True):
        blown_up = values is not None and not np.isfinite(values).all()
        results[number] = None if blown_up and tasks[number].added else values
    return results


def _batches(missing: Iterable[Replay]) -> list[tuple[Replay, ...]]:
    """Batches of replays of one run: its start state is sent once, and its features are computed together."""
    grouped: dict[str, list[Replay]] = {}
    for task in missing:
        grouped.setdefault(task.setup.digest, []).append(task)
    total = sum(map(len, grouped.values()))
    size = min(max(math.ceil(total / MIN_BATCHES), MIN_BATCH), MAX_BATCH)
    return [tuple(run[start : start + size]) for run in grouped.values() for start in range(0, len(run), size)]


def _joined(setup: Setup, parts: Sequence[Array | None]) -> Array | None:
    """Features of a replay from the features of its parts; None if a part has no features."""
    joined = np.empty(len(setup.used))
    for (_, rows), values in zip(setup.parts, parts, strict=True):
        if values is None:
            return None
        joined[rows] = values
    return joined


class ReplayCache:
    """Computes missing replays in parallel, and caches their results.

    Args:
        map_tasks: Parallel map.
        progress: Called with (purpose, done, total) while a batch runs.
    """

    def __init__(self, map_tasks: Map, progress: Progress | None = None) -> None:
        self._map = map_tasks
        self._progress = progress
        self._features: dict[Key, Array | None] = {}
        self._phases: dict[tuple[str, str], tuple[str, ...]] = {}  # by model and effect

    def in_one_process(self) -> ReplayCache:
        """A copy that makes replays in its own process, without progress reports; it can be pickled."""
        store = ReplayCache(map)
        store._features = self._features
        return store

    def distribute(self, function: Callable[[Item], Output], items: Sequence[Item], purpose: str) -> list[Output]:
        """``function`` of every item over the map, with progress reports."""
        results = []
        self._report_progress(purpose, 0, len(items))
        for result in self._map(function, items):
            results.append(result)
            self._report_progress(purpose, len(results), len(items))
        return results

    def __call__(self, tasks: Sequence[Replay], purpose: str = "replays") -> list[Array | None]:
        """Features of each replay, in order."""
        digests = {id(model): model.digest for model in {id(task.model): task.model for task in tasks}.values()}
        parts = [self._parts(task, digests[id(task.model)]) for task in tasks]
        missing = {key: part for task_parts in parts for key, part in task_parts.items() if key not in self._features}
        key_of = {id(part): key for key, part in missing.items()}
        batches = _batches(missing.values())
        done = 0
        for batch, results in zip(batches, self._map(run_batch, batches), strict=True):
            self._features.update(zip((key_of[id(part)] for part in batch), results, strict=True))
            done += len(batch)
            self._report_progress(purpose, done, len(missing))
        return [
            _joined(task.setup, [self._features[key] for key in keys]) for task, keys in zip(tasks, parts, strict=True)
        ]

    def _parts(self, task: Replay, model: str) -> dict[Key, Replay]:
        """Free motion and contact of a replay, each with the effects that act in it, by their cache keys.

        Args:
            task: The replay.
            model: Digest of its model.
        """
        parts = {}
        for setup, _ in task.setup.parts:
            added = tuple(item for item in task.added if self._acts(task.model, model, item[0], setup))
            parts[setup.digest, model, added] = Replay(setup, task.model, added)
        return parts

    def _acts(self, model: Model, digest: str, effect: str, part: Setup) -> bool:
        """Whether an effect acts in a part; effects of tables of impacts act in no replay."""
        if (digest, effect) not in self._phases:
            self._phases[digest, effect] = model.known_effects[effect].phases
        phases = self._phases[digest, effect]
        return phases != SINGLE_IMPACT if part.contact else "free" in phases

    def _report_progress(self, purpose: str, done: int, total: int) -> None:
        if self._progress is not None:
            self._progress(purpose, done, total)
