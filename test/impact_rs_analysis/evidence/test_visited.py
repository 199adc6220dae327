# SPDX-License-Identifier: Apache-2.0
"""Measured ranges of the symbols of formulas."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from impact_rs_analysis.evidence.visited import measured_ranges
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.runs import ArmSignals, Run, Signals
from impact_rs_trials.spec import TrialSpec


def test_ranges_hold_for_all_arms() -> None:
    """Kills: a dict of the symbols of all arms, which keeps those of the last one. Formulas are computed by arm."""
    scenario = load_scenario("grab")
    physics = TrialSpec.of(scenario, next(iter(scenario.objects)), next(iter(scenario.cases))).scene.physics
    time = np.linspace(0.0, 1.0, 90)
    arms = {}
    for name, direction in zip(physics.arms, (-1.0, 1.0), strict=True):
        position = np.zeros((time.size, physics.arms[name].facts.joint_count))
        position[:, 0], position[:, 1] = direction * (1.0 + time), direction
        arms[name] = ArmSignals(position, np.zeros_like(position), np.zeros_like(position))
    run = Run(Path("run"), "run", "run", ("", "", ""), False, physics, Signals(time, arms))
    source: Any = SimpleNamespace(contact_speeds={}, runs=SimpleNamespace(runs=[run]))
    ranges = measured_ranges(source, ["q1 * q2"])
    assert ranges["q1"] == pytest.approx((-2.0, 2.0), abs=0.02)
    assert ranges["q1 * q2"] == pytest.approx((1.0, 2.0), abs=0.02)
    assert ranges["t"] == pytest.approx((0.0, 1.0), abs=0.02)
