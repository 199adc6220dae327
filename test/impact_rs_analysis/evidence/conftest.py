# SPDX-License-Identifier: Apache-2.0
"""Trials without noise, to be replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.evidence.run import Run
from impact_rs_analysis.evidence.twin import simulated
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

COULOMB = np.array([0.3, 0.25, 0.2, 0.25, 0.15, 0.12, 0.1])  # N m


def spec(scenario: str = "push", thing: str = "juice", case: str = "case_2") -> TrialSpec:
    return TrialSpec.of(load_scenario(scenario), thing, case)


def with_friction(physics: Physics) -> Physics:
    """Coulomb friction on the motor side of every joint."""
    arms = {name: replace(arm, friction=replace(arm.friction, coulomb=COULOMB)) for name, arm in physics.arms.items()}
    return replace(physics, arms=arms)


@pytest.fixture(scope="session")
def hit() -> Run:
    """A push, as it would be measured without noise."""
    return simulated(spec(), spec().scene.physics)


@pytest.fixture(scope="session")
def free() -> Run:
    """A free motion there and back."""
    free_spec = spec("excite", "none", "fast")
    return simulated(free_spec, free_spec.scene.physics)


@pytest.fixture(scope="session")
def rubbed() -> Run:
    """The same with friction hidden in it."""
    free_spec = spec("excite", "none", "fast")
    return simulated(free_spec, with_friction(free_spec.scene.physics))
