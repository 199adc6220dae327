# SPDX-License-Identifier: Apache-2.0
"""Trials without noise, to be replayed, and what least squares say of a table; few null statistics are drawn here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from intervals import assert_covers

from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.search import null_distribution
from impact_rs_analysis.evidence.replays.features import onset_level, onsets_of
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.replays.simulated_trials import simulated
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.runs import ArmSignals, Run
from impact_rs_trials.spec import TrialSpec

COULOMB = np.array([0.3, 0.25, 0.2, 0.25, 0.15, 0.12, 0.1])  # N m


def replayed(run: MeasuredRun, physics: Physics | None = None) -> Array:
    """Features of the replay of a run, by default with the physics that is known of it."""
    found = run.setup.features_of(run.setup.replayed(physics or run.physics))
    assert found is not None
    return found


def residuals(run: Run, physics: Physics | None = None) -> dict[tuple[str, str], Array]:
    """Measured minus replayed features over their relevance limits, by phase and signal."""
    measured = MeasuredRun.of(run)
    found: dict[tuple[str, str], list[float]] = {}
    for feature, a, b in zip(measured.features, measured.measured, replayed(measured, physics), strict=True):
        found.setdefault((feature.phase, feature.signal), []).append((a - b) / feature.relevance_limit)
    return {key: np.array(values) for key, values in found.items()}


def free_starts(run: MeasuredRun) -> list[float]:
    """Begin of every window of free motion [s]."""
    return [window.time[0] for window in run.setup.windows if not window.contact]


def onset(time: Array, velocity: Array) -> tuple[float | None, float]:
    """Loss of speed that marks an impact [m/s], and the time at which so much is lost [s]; NaN: never."""
    level = onset_level(time, velocity)
    return level, float("nan") if level is None else float(onsets_of(time, velocity[None], level)[0])


def with_signals(run: Run, change: Callable[[ArmSignals], ArmSignals], **of_run: object) -> Run:
    """The run with other signals of every arm."""
    arms = {name: change(arm) for name, arm in run.signals.arms.items()}
    return replace(run, signals=replace(run.signals, arms=arms), **of_run)


def with_arms(physics: Physics, change: Callable[[ArmPhysics], ArmPhysics]) -> Physics:
    return replace(physics, arms={name: change(arm) for name, arm in physics.arms.items()})


def with_friction(physics: Physics) -> Physics:
    """Coulomb friction on the motor side of every joint."""
    return with_arms(physics, lambda arm: replace(arm, friction=replace(arm.friction, coulomb=COULOMB)))


HIT = TrialSpec.of(load_scenario("push"), "juice", "case_2")
EXCITED = TrialSpec.of(load_scenario("excite"), "none", "fast")


@pytest.fixture(scope="session")
def hit() -> Run:
    """A push, as it would be measured without noise."""
    return simulated(HIT, HIT.scene.physics, "bullet")


@pytest.fixture(scope="session")
def free() -> Run:
    """A free motion there and back."""
    return simulated(EXCITED, EXCITED.scene.physics, "bullet")


@pytest.fixture(scope="session")
def rubbed() -> Run:
    """The same with friction hidden in it."""
    return simulated(EXCITED, with_friction(EXCITED.scene.physics), "bullet")


@pytest.fixture(scope="session")
def measured_hit(hit: Run) -> MeasuredRun:
    return MeasuredRun.of(hit)


@pytest.fixture(scope="session")
def measured_free(free: Run) -> MeasuredRun:
    return MeasuredRun.of(free)


@pytest.fixture(autouse=True, scope="module")  # a package without __init__ would be the whole session
def few_draws() -> Iterator[None]:
    """999 draws in place of 4999: p values are as right, only coarser."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(null_distribution, "NULL_DRAWS", 999)
        null_distribution._rotations.cache_clear()
        yield
    null_distribution._rotations.cache_clear()


def assert_intervals(
    source: ImpactTableSource,
    document: DiagnosisDocument,
    truth: Mapping[tuple[str, str], float],
    noise: Sequence[float],
    repeats: int = 1,
) -> None:
    """Intervals of a table hold the truth, and are those of weighted least squares with the noise that is known.

    With sensitivities J by differences and weights W (energy; or 1 / sigma^2 of means of repeats) the covariance is
    (J^T W J)^-1 J^T W S W J (J^T W J)^-1, S that of the noise.

    Args:
        source: The table.
        document: Its diagnosis, of which all effects that are named are fitted together.
        truth: Value of some effects' parameters.
        noise: Standard deviation of every entry of a row, ``(F,)``.
        repeats: Rows of a condition, which stand together.
    """
    named = {name: document.effect(name).parameters for name in document.named}
    places = [(name, parameter) for name, parameters in named.items() for parameter in parameters]

    def predicted(moved: tuple[str, str], by: float) -> Array:
        added = tuple(
            (name, tuple(one.estimate + by * one.scale * ((name, own) == moved) for own, one in parameters.items()))
            for name, parameters in named.items()
        )
        found = source.predicted_with(added)
        return found.reshape(-1, repeats, found.shape[1]).mean(axis=1).ravel()

    step = 0.05
    jacobian = np.array([(predicted(place, step) - predicted(place, -step)) / (2.0 * step) for place in places]).T
    rows = jacobian.shape[0] // len(noise)
    if repeats == 1:
        weight = np.square(source.energy_weights).ravel()
    else:
        weight = np.tile(1.0 / np.square(source.clusters[0].sigma), rows)
    variance = np.tile(np.square(noise) / repeats, rows)
    inverse = np.linalg.inv(jacobian.T * weight @ jacobian)
    covariance = inverse @ (jacobian.T * (weight**2 * variance) @ jacobian) @ inverse
    for place, width in zip(places, NORMAL_95 * np.sqrt(np.diag(covariance)), strict=True):
        if place in truth:
            found = named[place[0]][place[1]]
            assert_covers(found.interval, truth[place], width * found.scale)
