# SPDX-License-Identifier: Apache-2.0
"""Trials without noise, to be replayed; the functions here are all that the tests know of how a replay is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.evidence.features import onset_level, onsets_of
from impact_rs_analysis.evidence.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.simulated_trials import simulated
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario
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
