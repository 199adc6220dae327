# SPDX-License-Identifier: Apache-2.0
"""Trials whose predictions are written down, so that their information has a closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_rs_analysis.design.explanations import Decision, Explanation
from impact_rs_analysis.design.forecast import ForecastTrial
from impact_rs_analysis.design.possible_trials import PossibleTrial
from impact_rs_analysis.evidence.cluster import Cluster, Feature
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.experiment_plan import Aim
from impact_rs_trials.spec import TrialSpec

SCATTER, DISCREPANCY = 0.6, 0.5  # shares of a feature's scale; the rest is its relevance limit


def trial(
    name: str,
    centres: Sequence[Sequence[float]],
    spreads: Sequence[Array] = (),
    patterns: Array | None = None,
    repeats: int = 0,
    discrepancy: float = DISCREPANCY,
) -> ForecastTrial:
    """A trial with scaled features under explanations."""
    rows = np.atleast_2d(np.array(centres, dtype=float))
    count = rows.shape[1]
    cluster = Cluster(
        name=name,
        condition_key=("push", "parcel", name),
        layout="hit",
        unit=name,
        contact=True,
        features=tuple(Feature("push", "velocity", "x", n, "m/s", 0.001) for n in range(count)),
        residuals=np.zeros((max(repeats, 1), count)),
        sigma=np.ones(count),
        pure_error=np.full(count, SCATTER),
        discrepancy=np.full(count, discrepancy),
        patterns=patterns,
    )
    own = tuple(spreads) if len(spreads) else tuple(np.zeros((0, count)) for _ in rows)
    spec = TrialSpec.of(load_scenario("push"), "parcel", "case_1")
    return ForecastTrial(name, PossibleTrial("push", {}, None, spec, name), cluster, rows, own, repeats)


def estimated_pair(parameters: int = 0, aim: Aim = "rivals") -> Decision:
    """Two explanations with estimates, of so many uncertain parameters each."""
    one = (("mass", (1.0,)),)
    pair = [Explanation(name, one, tuple(one for _ in range(parameters))) for name in ("first", "second")]
    return Decision.between(pair, aim)
