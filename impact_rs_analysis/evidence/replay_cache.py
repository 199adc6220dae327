# SPDX-License-Identifier: Apache-2.0
"""Cache of replays, because comparisons and diagnoses need many of them repeatedly.

A result depends only on the start of the replay, the model and the added effects.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TypeVar

import numpy as np

from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.measured_runs import Setup
from impact_rs_sim.errors import NotABody
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.version import package_version
from impact_rs_trials.workers import Map

CACHE_VERSION = 11
EFFORT_OF_CONTACT = 20.0  # of a sample with contact, in samples of free motion
# Samples of free motion per task, 30 to 200 ms of work: a task has an overhead of some milliseconds.
LEAST_BATCH, LARGEST_BATCH = 4_000.0, 30_000.0
BATCHES = 16  # at least, so that workers finish at about the same time

Progress = Callable[[str, int, int], None]

Item = TypeVar("Item")
Made = TypeVar("Made")


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
    def digest(self) -> str:
        """Digest that identifies its result."""
        known = self.model.known_effects
        used = (*(item.name for item in self.model.effects), *(name for name, _ in self.added))
        code = tuple(known[name].identity for name in used)
        text = repr((CACHE_VERSION, package_version(), self.setup.digest, self.model.digest, self.added, code))
        return hashlib.sha256(text.encode()).hexdigest()[:32]

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
    physics, known = model.apply(physics), model.known_effects
    for name, values in added:
        physics = known[name].apply_vector(physics, np.array(values))
    return physics


def run_replay(task: Replay) -> Array | None:
    """Features of one replay, as :func:`run_batch`."""
    return run_batch([task])[0]


def run_batch(tasks: Sequence[Replay]) -> list[Array | None]:
    """Features of replays of one or several runs; None if an expected impact is missing.

    None also if the added effects give a body without positive inertia or an unstable simulation: a fit then tries a
    smaller step.

    Raises:
        InputError: The model itself is not valid.
    """
    found: list[Array | None] = [None] * len(tasks)
    for _, group in groupby(range(len(tasks)), lambda number: tasks[number].setup.digest):
        numbers, simulations = [], []
        for number in group:
            task = tasks[number]
            try:
                simulations.append(task.setup.replayed(task.physics))
                numbers.append(number)
            except NotABody:
                if not task.added:
                    raise
        if not simulations:
            continue
        for number, values in zip(numbers, tasks[numbers[0]].setup.features_of_all(simulations), strict=True):
            blown_up = values is not None and not np.isfinite(values).all()
            found[number] = None if blown_up and tasks[number].added else values
    return found


def _batches(missing: dict[str, Replay]) -> list[list[str]]:
    """Batches of replays of one run: its start state is sent once, and its free motion is shared."""
    grouped: dict[str, list[str]] = {}
    for digest, task in missing.items():
        grouped.setdefault(task.setup.digest, []).append(digest)
    efforts = {run: _effort(missing[own[0]].setup) for run, own in grouped.items()}
    total = sum(len(own) * efforts[run] for run, own in grouped.items())
    size = min(max(total / BATCHES, LEAST_BATCH), LARGEST_BATCH)
    batches: list[list[str]] = []
    left = 0.0
    for run, own in grouped.items():
        for digest in own:
            if left < efforts[run]:
                batches.append([])
                left = size
            batches[-1].append(digest)
            left -= efforts[run]
    return batches


def _effort(setup: Setup) -> float:
    """Computation time of a replay, in samples of free motion."""
    return sum(window.time.size * (EFFORT_OF_CONTACT if window.contact else 1.0) for window in setup.windows)


def cache_directory() -> Path:
    """Folder of the results: ``$XDG_CACHE_HOME/impact_rs`` or ``~/.cache/impact_rs``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "impact_rs" / "replays"


class ReplayCache:
    """Makes missing replays in parallel, and caches their results.

    Args:
        map_tasks: Parallel map.
        progress: Called with (what, done, total) while a batch runs.
    """

    def __init__(self, map_tasks: Map, progress: Progress | None = None) -> None:
        self._map = map_tasks
        self._progress = progress
        self._known: dict[str, Array | None] = {}
        self._directory = cache_directory()

    def in_one_process(self) -> ReplayCache:
        """A copy that makes replays in its own process, without progress reports; it can be pickled."""
        store = ReplayCache(map)
        store._known = self._known
        return store

    def spread(self, function: Callable[[Item], Made], items: Sequence[Item], what: str) -> list[Made]:
        """``function`` of every item over the map, with progress reports."""
        found = []
        self._report_progress(what, 0, len(items))
        for result in self._map(function, items):
            found.append(result)
            self._report_progress(what, len(found), len(items))
        return found

    def __call__(self, tasks: Sequence[Replay], what: str = "replays") -> list[Array | None]:
        """Features of each replay, in order."""
        digests = [task.digest for task in tasks]
        missing: dict[str, Replay] = {}
        for task, digest in zip(tasks, digests, strict=True):
            if digest not in self._known and not self._load(digest):
                missing.setdefault(digest, task)
        batches = _batches(missing)
        done = 0
        results = self._map(run_batch, [tuple(missing[digest] for digest in batch) for batch in batches])
        for batch, found in zip(batches, results, strict=True):
            for digest, result in zip(batch, found, strict=True):
                self._known[digest] = result
                self._save(digest, result)
            done += len(batch)
            self._report_progress(what, done, len(missing))
        return [self._known[digest] for digest in digests]

    def _report_progress(self, what: str, done: int, total: int) -> None:
        if self._progress is not None:
            self._progress(what, done, total)

    def _load(self, digest: str) -> bool:
        path = self._directory / digest[:2] / f"{digest}.npy"
        try:
            values = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError):
            return False
        self._known[digest] = None if values.size == 0 else values
        return True

    def _save(self, digest: str, result: Array | None) -> None:
        path = self._directory / digest[:2] / f"{digest}.npy"
        temporary = path.with_suffix(f".{os.getpid()}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("wb") as file:
                np.save(file, np.zeros(0) if result is None else result, allow_pickle=False)
            temporary.replace(path)
        except OSError:
            temporary.unlink(missing_ok=True)  # the result is valid without the cache
