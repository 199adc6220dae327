"""Runs of the twin, boiled down to features and kept.

They depend on scenario, model, effects and start, and on nothing that was measured besides. Results are kept on disk:
comparing, diagnosing and comparing again ask for many of them more than once.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.features import extract
from impact_rs_analysis.evidence.runs import Condition, Runs
from impact_rs_analysis.evidence.twin import Start, observed_until, run_twin
from impact_rs_sim.errors import InputError, NotABody
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array
from impact_rs_sim.version import package_version
from impact_rs_trials.workers import Map

CACHE_VERSION = 8

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Rollout:
    """One closed-loop run of the twin: a model with further effects at given values.

    Attributes:
        condition: What is run.
        model: Model underneath.
        added: Effect name and its parameter vector, on top of the model.
        start: Where the trial starts; None: where the plan says.
    """

    condition: Condition
    model: Model
    added: Added = ()
    start: Start | None = None

    @property
    def digest(self) -> str:
        """Identity of its result."""
        known = self.model.known_effects
        used = (*(item.name for item in self.model.effects), *(name for name, _ in self.added))
        code = tuple(known[name].identity for name in used)
        start = None if self.start is None else self.start.identity
        text = repr(
            (CACHE_VERSION, package_version(), self.condition, self.model.digest, self.added, code, start),
        )
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def run_rollout(rollout: Rollout) -> Array | None:
    """Features of one rollout; None where nothing was hit although it should.

    None also where the added effects leave an arm that is no body: a fit that asks for it will try a smaller step.

    Raises:
        InputError: The model itself cannot be.
    """
    plan = rollout.condition.plan
    physics = rollout.model.apply(plan.scene.physics)
    known = rollout.model.known_effects
    for name, values in rollout.added:
        physics = known[name].apply_vector(physics, np.array(values))
    start = Start.nominal(plan) if rollout.start is None else rollout.start
    try:
        return extract(run_twin(plan, physics, start, observed_until(plan)), plan)
    except NotABody:
        if not rollout.added:
            raise
        return None


def cache_directory() -> Path:
    """Where results of rollouts are kept: ``$XDG_CACHE_HOME/impact_rs`` or ``~/.cache/impact_rs``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "impact_rs" / "rollouts"


class RolloutStore:
    """Runs rollouts that were not run before, in parallel, and keeps their results.

    Args:
        map_tasks: Parallel map.
        progress: Called with (what, done, total) while a batch runs.
    """

    def __init__(self, map_tasks: Map, progress: Progress | None = None) -> None:
        self._map = map_tasks
        self._progress = progress or (lambda *_: None)
        self._known: dict[str, Array | None] = {}
        self._directory = cache_directory()

    def __call__(self, rollouts: list[Rollout], what: str = "twin rollouts") -> list[Array | None]:
        """Features of each rollout, in order."""
        digests = [rollout.digest for rollout in rollouts]
        missing: dict[str, Rollout] = {}
        for rollout, digest in zip(rollouts, digests, strict=True):
            if digest not in self._known and not self._load(digest):
                missing.setdefault(digest, rollout)
        total = len(missing)
        for done, (digest, result) in enumerate(
            zip(missing, self._map(run_rollout, list(missing.values())), strict=True), start=1
        ):
            self._known[digest] = result
            self._save(digest, result)
            self._progress(what, done, total)
        return [self._known[digest] for digest in digests]

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


def residuals(runs: Runs, model: Model, store: RolloutStore, added: Added = ()) -> list[Array]:
    """Measured minus predicted features of every trial, the twin started where the trial started.

    Args:
        runs: Measurements.
        model: What we believe.
        store: Runs the twin.
        added: Effects on top of the model.

    Raises:
        InputError: With this model nothing is hit, or the model blows up.
    """
    twins = store([Rollout(trial.condition, model, added, trial.start) for trial in runs.trials], "twin of every trial")
    found = []
    for trial, predicted in zip(runs.trials, twins, strict=True):
        if predicted is None:
            raise InputError(f"with model {model.name!r} nothing is hit in {trial.condition.label}", file=trial.path)
        if not np.isfinite(predicted).all():
            raise InputError(f"with model {model.name!r} the twin of {trial.condition.label} is not finite")
        found.append(trial.features - predicted)
    return found
