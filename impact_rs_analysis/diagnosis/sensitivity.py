"""How the features move when a parameter moves: finite differences through the twin, in closed loop.

They depend on scenario, model and effect, not on the measurement, so they are kept on disk and used again by the next
diagnosis of the same model.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_rs_analysis.bags.trial_info import package_version
from impact_rs_analysis.comparison.features import extract
from impact_rs_analysis.comparison.runs import Condition
from impact_rs_analysis.comparison.twin import Start, observed_until, run_twin
from impact_rs_analysis.workers import Map
from impact_rs_sim.effects import Effect
from impact_rs_sim.model import JOINT_COUNT, Model
from impact_rs_sim.robot import Array

CACHE_VERSION = 5


@dataclass(frozen=True)
class Rollout:
    """One closed-loop run of the twin: a model with further effects at given values.

    Attributes:
        condition: What is run.
        model: Model underneath.
        added: Effect name and its parameter vector, on top of the model.
    """

    condition: Condition
    model: Model
    added: tuple[tuple[str, tuple[float, ...]], ...] = ()

    @property
    def digest(self) -> str:
        """Identity of its result."""
        text = repr((CACHE_VERSION, package_version(), self.condition, self.model.digest, self.added))
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def run_rollout(rollout: Rollout) -> Array | None:
    """Features of one rollout; None where nothing was hit although it should."""
    plan = rollout.condition.plan
    physics = rollout.model.apply(plan.scene.physics)
    known = rollout.model.known_effects
    for name, values in rollout.added:
        physics = known[name].apply_vector(physics, np.array(values))
    return extract(run_twin(plan, physics, Start.nominal(plan), observed_until(plan)), plan)


def cache_directory() -> Path:
    """Where results of rollouts are kept: ``$XDG_CACHE_HOME/impact_rs`` or ``~/.cache/impact_rs``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "impact_rs" / "rollouts"


class RolloutStore:
    """Runs rollouts that were not run before, in parallel, and keeps their results.

    Args:
        map_tasks: Parallel map.
        progress: Called with (done, total) while a batch runs.
    """

    def __init__(self, map_tasks: Map, progress: Callable[[str, int, int], None] | None = None) -> None:
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


def steps(effect: Effect, at: Array) -> Array:
    """Finite-difference step per parameter, the other way where a bound is in its way."""
    scalars = effect.scalars(JOINT_COUNT)
    return np.array(
        [
            scalar.step if scalar.lower <= value + scalar.step <= scalar.upper else -scalar.step
            for scalar, value in zip(scalars, at, strict=True)
        ]
    )


def nominal_vector(effect: Effect) -> Array:
    """Parameter values at which an effect does nothing."""
    return np.array([scalar.nominal for scalar in effect.scalars(JOINT_COUNT)])


def concerns(effect: Effect, condition: Condition) -> bool:
    """Whether an effect can be seen in a condition at all."""
    return condition.plan.expects_impact or "free" in effect.phases
