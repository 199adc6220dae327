# SPDX-License-Identifier: Apache-2.0
"""Campaigns in the closed-form world of the tests, made clusters as a diagnosis makes them of trials.

Runs of some conditions and repeats are drawn: features with an effect in them, noise, and the error of a simulator. The
code of a diagnosis makes clusters of them, scaled by the pure error that their own repeats give, by half the relevance
limit and by the discrepancy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from analytic_world import FEATURES, PHYSICS, AnalyticSource, features

from impact_rs_analysis.evidence.cluster import Added, Feature
from impact_rs_analysis.evidence.discrepancy import NO_DISCREPANCY, Discrepancy, DiscrepancyEntry, Patterns
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs, Setup
from impact_rs_analysis.evidence.sources.run_source import clusters_of
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.runs import NONE, Signals

WHITE = np.eye(FEATURES)  # root of the covariance of independent features
DRIFT = 2.0  # standard deviations over a campaign
PATTERNS = 6  # of the discrepancy: as many variants of a simulation
THE_PATTERNS = 77  # their seed; they are the same in every campaign, as measured ones are


@dataclass(frozen=True)
class Simulator:
    """Error of the simulator of a campaign.

    Attributes:
        size: Ratio of the standard deviations of error and noise in every feature, as in the discrepancy [-].
        kind: ``measured``: its error is a sum of the patterns of the discrepancy, with standard normal amplitudes.
            ``new``: an error of equal size in directions of no pattern.
    """

    size: float = 0.0
    kind: Literal["measured", "new"] = "measured"

    def error(self, rng: np.random.Generator, spread: Array) -> Array:
        """Error of one simulator, equal in all conditions, ``(F,)``."""
        if self.kind == "new":
            return np.asarray(self.size * spread * rng.standard_normal(FEATURES))
        return np.asarray(rng.standard_normal(PATTERNS) @ self.patterns(spread))

    def patterns(self, spread: Array) -> Array:
        """Rows whose squares add up to the square of the error in every feature, ``(k, F)``."""
        return np.asarray(self.size * spread * _patterns())

    def discrepancy(self, labels: Sequence[Feature], spread: Array) -> Discrepancy:
        """Discrepancy that a diagnosis is given."""
        if not self.size:
            return NO_DISCREPANCY
        groups: dict[tuple[str, str, str], list[float]] = {}
        for feature, value in zip(labels, self.size * spread, strict=True):
            groups.setdefault(feature.group, []).append(float(value))
        return Discrepancy(
            provenance=None,
            variants={},
            entries=tuple(
                DiscrepancyEntry(
                    kind="free",
                    phase=phase,
                    signal=signal,
                    index=index,
                    unit="m/s",
                    value=min(values),  # of a bin counts the rms of this and its own, which is the size
                    by_bin=tuple(float(np.sqrt(2.0 * value**2 - min(values) ** 2)) for value in values),
                )
                for (phase, signal, index), values in groups.items()
            ),
            patterns=(
                Patterns(
                    kind="free",
                    features=tuple((label.phase, label.signal, label.index, label.bin) for label in labels),
                    rows=tuple(map(tuple, self.patterns(spread).tolist())),
                ),
            ),
        )


EXACT = Simulator()


@cache
def _patterns() -> Array:
    rows = np.random.default_rng(THE_PATTERNS).standard_normal((PATTERNS, FEATURES))
    return np.asarray(rows / np.sqrt(np.sum(np.square(rows), axis=0)))


class Campaign(AnalyticSource):
    """Runs of a campaign, made clusters by the code of a diagnosis.

    Args:
        seed: Of the noise and of the simulator's error.
        design: Conditions and repeats.
        truth: Hidden effects.
        limit: Relevance limit, in multiples of the noise.
        root: Root of the covariance of the noise, ``(F, F)``.
        noise: ``normal``, ``heavy``, ``heavy trials`` or ``drift`` (:func:`draw`).
        simulator: What the simulator is off by.
    """

    def __init__(
        self,
        seed: int,
        design: tuple[int, int],
        truth: Added = (),
        limit: float = 0.3,
        root: Array = WHITE,
        noise: str = "normal",
        simulator: Simulator = EXACT,
    ) -> None:
        conditions, repeats = design
        super().__init__(seed, truth, design=(repeats,) * conditions)
        spread = np.sqrt(np.sum(np.square(root), axis=0))
        labels = tuple(
            Feature("impact", f"signal {f % 4}", "x", f // 4, "m/s", limit * float(spread[f])) for f in range(FEATURES)
        )
        simulator_error = simulator.error(np.random.default_rng([seed, 1]), spread)
        noises = draw(np.random.default_rng(seed), conditions * repeats, root, noise)
        rows = [features(n // repeats, truth) + simulator_error + noises[n] for n in range(conditions * repeats)]
        runs = tuple(_run(f"{n // repeats}", labels, values) for n, values in enumerate(rows))
        self.discrepancy = simulator.discrepancy(labels, spread)
        clusters, _ = clusters_of(Runs(Path(), runs, ()), rows, self.discrepancy)
        self.clusters = tuple(replace(item, contact=True) for item in clusters)
        self._measured = [np.array(rows[n * repeats : (n + 1) * repeats]) for n in range(conditions)]


def draw(rng: np.random.Generator, count: int, root: Array, noise: str = "normal") -> Array:
    """Noise of some runs, ``(count, F)``.

    Args:
        rng: What it is drawn from.
        count: Of the runs.
        root: Root of the covariance, ``(F, F)``.
        noise: ``normal``; ``heavy``: Student's t with 3 degrees of freedom, direction by direction; ``heavy trials``:
            the same factor for all features of a run; ``drift``: normal, and every feature drifts by two standard
            deviations over the campaign, whose conditions are interleaved in random order.
    """
    if noise == "heavy":
        return np.asarray(rng.standard_t(3, (count, FEATURES)) / np.sqrt(3.0) @ root)
    values = rng.standard_normal((count, FEATURES)) @ root
    if noise == "heavy trials":
        values /= np.sqrt(rng.chisquare(3, (count, 1)))
    if noise == "drift":
        order = rng.permutation(count) / (count - 1.0) - 0.5
        values += DRIFT * order[:, None] * np.sqrt(np.sum(np.square(root), axis=0)) * rng.choice([-1.0, 1.0], FEATURES)
    return np.asarray(values)


def standard_error(design: tuple[int, int], name: str, root: Array = WHITE, simulator: Simulator = EXACT) -> float:
    """Standard error of the best linear estimate of a linear effect with one parameter, all covariances known.

    1 / se^2 = j^T C^-1 j with j the changes of the means of all conditions and C = S / n (condition by condition) plus
    P^T P (the same error in all of them): Gauss-Markov.

    Args:
        design: Conditions and repeats.
        name: Of the effect.
        root: Root of the covariance S of the noise, ``(F, F)``.
        simulator: Its patterns P are part of the covariance.
    """
    conditions, repeats = design
    changes = np.concatenate([features(number, ((name, (1.0,)),)) for number in range(conditions)])
    spread = np.sqrt(np.sum(np.square(root), axis=0))
    patterns = simulator.patterns(spread)
    noise_covariance, error_covariance = root.T @ root / repeats, patterns.T @ patterns
    covariance = np.kron(np.eye(conditions), noise_covariance) + np.kron(
        np.ones((conditions, conditions)), error_covariance
    )
    return float(1.0 / np.sqrt(changes @ np.linalg.solve(covariance, changes)))


def _run(condition: str, labels: tuple[Feature, ...], measured: Array) -> MeasuredRun:
    setup = Setup((), PHYSICS, 0.0, "command", False, False, None, tuple(range(len(labels))), {})
    return MeasuredRun(
        path=Path(condition), name=condition, condition=condition, condition_key=("world", "object", condition),
        hit=False, physics=PHYSICS, signals=Signals(NONE, {}), setup=setup, features=labels, measured=measured,
        impacts={}, free=0,
    )  # fmt: skip
