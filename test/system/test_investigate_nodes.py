# SPDX-License-Identifier: Apache-2.0
"""Trials of an investigation through the nodes: where the loop looks for them, with what the plant hides."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from impact_rs_analysis.investigation import Settings, trials_of
from impact_rs_cli.node_benches import NodesBench
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.model import load_model
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.blind import Secret
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign


@pytest.mark.slow
def test_two_scenarios_of_a_round_run_through_one_set_of_nodes_with_a_hidden_effect(
    tmp_path: Path, domain_ids: Callable[[], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A variant of a push that no shipped file has, and free motion; the nominal physics stay in the bags."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_ids()))
    settings = Settings(scenarios=("push", "excite"), model_digest=load_model("nominal").digest, via="nodes")
    plan = ExperimentPlan(
        model="nominal",
        model_digest=settings.model_digest,
        aim="effects",
        method="design",
        budget=6,
        campaigns=(
            PlannedCampaign(
                folder="push_soft",
                scenario="push",
                settings={"name": "push_soft", "contact.friction": 0.4},
                conditions=(PlannedTrials(object="parcel", case="case_1", trials=1),),
            ),
            PlannedCampaign(
                folder="excite", scenario="excite", conditions=(PlannedTrials(object="none", case="fast", trials=1),)
            ),
        ),
    )
    hidden = Secret.drawn(0, "single", "object_mass").model
    bench = NodesBench(tmp_path, settings, map, Terminal(as_json=True), hidden)  # type: ignore[arg-type]
    trials = trials_of(plan, "round_01")
    bench.measure(trials)
    bags = [TrialBag.open(tmp_path / "runs" / one.path) for one in trials]
    assert [(bag.outcome, bag.info.scenario, bag.info.via) for bag in bags] == [
        ("OK", "push_soft", "nodes"),
        ("OK", "excite", "nodes"),
    ]
    assert bags[0].info.spec.scenario.contact.friction == 0.4
    assert bags[0].info.seed == trials[0].trial.seed
    assert bags[0].info.spec.scene.physics.object.mass == 0.6  # kg, what the scenario says
    runs = bench.measured_runs()
    assert len(runs.runs) == 2 and not runs.skipped
