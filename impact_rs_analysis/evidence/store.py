# SPDX-License-Identifier: Apache-2.0
"""Replays that were made before are kept: comparing, diagnosing and comparing again ask for many more than once.

A result depends on what the replay starts from, the model and the effects on top, and on nothing else.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.cluster import Added, Item, Made
from impact_rs_analysis.evidence.measured import Setup
from impact_rs_sim.errors import NotABody
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.version import package_version
from impact_rs_trials.workers import Map

CACHE_VERSION = 11
EFFORT_OF_CONTACT = 20.0  # of a sample with contact, in samples of free motion
# Such samples that a worker is sent together, 30 to 200 ms of work: a task costs the scheduler, and us, some ms.
LEAST_BATCH, LARGEST_BATCH = 4_000.0, 30_000.0
BATCHES = 16  # rather than larger ones, so that workers end together

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Replay:
    """One replay to be made: a run under a model with further effects at given values.

    Attributes:
        setup: What it starts from.
        model: Model underneath.
        added: Effect name and its parameter vector, on top of the model.
    """

    setup: Setup
    model: Model
    added: Added = ()

    @property
    def digest(self) -> str:
        """Identity of its result."""
        known = self.model.known_effects
        used = (*(item.name for item in self.model.effects), *(name for name, _ in self.added))
        code = tuple(known[name].identity for name in used)
        text = repr((CACHE_VERSION, package_version(), self.setup.digest, self.model.digest, self.added, code))
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    @property
    def physics(self) -> Physics:
        """What is believed in it.

        Raises:
            NotABody: The effects leave no body.
        """
        return with_effects(self.model, self.setup.physics, self.added)


def with_effects(model: Model, physics: Physics, added: Added) -> Physics:
    """Nominal physics with a model and further effects.

    Raises:
        NotABody: The effects leave no body.
    """
    physics, known = model.apply(physics), model.known_effects
    for name, values in added:
        physics = known[name].apply_vector(physics, np.array(values))
    return physics


def run_replay(task: Replay) -> Array | None:
    """Features of one replay; None where nothing is hit although it should be.

    None also where the added effects leave an arm that is no body or that blows up: a fit that asks for it will try a
    smaller step.

    Raises:
        InputError: The model itself cannot be.
    """
    try:
        found = task.setup.features_of(task.setup.replayed(task.physics))
    except NotABody:
        if not task.added:
            raise
        return None
    blown_up = found is not None and not np.isfinite(found).all()
    return None if blown_up and task.added else found


def run_batch(tasks: Sequence[Replay]) -> list[Array | None]:
    """Features of replays, as :func:`run_replay`."""
    return [run_replay(task) for task in tasks]


def _batches(missing: dict[str, Replay]) -> list[list[str]]:
    """Replays of one run side by side: what they start from travels once, and shares its free motion."""
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
    """What a replay takes, in samples of free motion."""
    return sum(window.time.size * (EFFORT_OF_CONTACT if window.contact else 1.0) for window in setup.windows)


def cache_directory() -> Path:
    """Where results are kept: ``$XDG_CACHE_HOME/impact_rs`` or ``~/.cache/impact_rs``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "impact_rs" / "replays"


class ReplayStore:
    """Makes replays that were not made before, in parallel, and keeps their results.

    Args:
        map_tasks: Parallel map.
        progress: Called with (what, done, total) while a batch runs.
    """

    def __init__(self, map_tasks: Map, progress: Progress | None = None) -> None:
        self._map = map_tasks
        self._progress = progress
        self._known: dict[str, Array | None] = {}
        self._directory = cache_directory()

    def in_one_process(self) -> ReplayStore:
        """A store of the same replays that makes further ones where it is, and says nothing; others can load it."""
        store = ReplayStore(map)
        store._known = self._known
        return store

    def spread(self, function: Callable[[Item], Made], items: Sequence[Item], what: str) -> list[Made]:
        """``function`` of every item over the map, told like replays."""
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
            temporary.unlink(missing_ok=True)  # a cache that cannot be written is no reason to stop
