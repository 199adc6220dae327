# SPDX-License-Identifier: Apache-2.0
"""Trials and campaigns through the nodes: in real time, without impact, hidden effects, cancelled, diverged."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from impact_rs.action import RunCampaign
from node_trials import begun, goal, one_trial, result_of, spin_until, whole_trial
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from impact_rs_analysis.investigation.rounds import trials_of
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_cli.node_benches import NodesBench
from impact_rs_cli.terminal import Terminal
from impact_rs_ros.graph import Graph, run_trial
from impact_rs_sim.effects import library
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, load_model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.blind import Secret
from impact_rs_trials.campaign import PlannedTrials, make_manifest, run_one
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign

STATES = topics.joint_states("arm")


@contextmanager
def realtime(graph: Graph) -> Iterator[None]:
    """A plant in real time, on a machine that may be busy."""
    for on, limit in ((True, 1.0), (False, 0.05)):
        changed = [Parameter("realtime", value=on), Parameter("missed_ticks_limit", value=limit)]
        request = SetParameters.Request(parameters=[one.to_parameter_msg() for one in changed])
        answers = graph.call(SetParameters, "plant/set_parameters", request).results
        assert all(answer.successful for answer in answers)
        if on:
            yield


def test_in_real_time_the_plant_does_not_wait_and_all_is_recorded(graph: Graph, tmp_path: Path, short: str) -> None:
    with realtime(graph):
        started = time.monotonic()
        result = graph.call_trial(goal(tmp_path, scenario=short))
        took = time.monotonic() - started
    assert result.outcome != "ABORTED", result.message
    bag = TrialBag.open(Path(result.bag_path))
    samples = bag.counts[STATES]
    assert samples == bag.counts[topics.truth_joint_states("arm")]
    assert took > bag.info.spec.scenario.timing.control_period * (samples - 1)
    # An arm that is led late on a busy machine may run away, which ends the trial.
    assert samples == 801 or (result.outcome == "DIVERGED" and samples < 801)
    missed = samples - bag.counts[topics.joint_command("arm")]  # a busy machine misses ticks
    assert missed >= 0
    assert missed == 0 or f" of {samples - 1} ticks without a torque in time" in bag.reason


def test_a_free_motion_ends_well_without_impact(graph: Graph, tmp_path: Path) -> None:
    shipped = load_scenario("excite")
    timing = shipped.timing.model_copy(update={"duration": 1.9})  # s; the slow case needs more
    scenario = shipped.model_copy(update={"cases": {"fast": shipped.cases["fast"]}, "timing": timing})
    path = tmp_path / "free.yaml"
    path.write_text(scenario.model_dump_json(), encoding="utf-8")
    bag = whole_trial(graph, tmp_path, make_manifest(str(path), ["none"], ["fast"], [1.0], trials=1))
    assert bag.counts[topics.impact_event("arm")] == 0
    assert bag.counts[STATES] == scenario.timing.ticks + 1


def test_hidden_effects_change_the_trial_and_stay_hidden(graph: Graph, tmp_path: Path, short: str) -> None:
    model = hidden_model()
    bag = whole_trial(graph, tmp_path / "nodes", one_trial(short, seed=5), model)
    assert bag.info.model_yaml == ""
    assert bag.counts[topics.TRUTH_MODEL] == 1
    for file in bag.path.glob("*.yaml"):
        assert model.effects[0].name not in file.read_text()

    plan = bag.info.spec.plan
    record_trial(plan, bag.info, tmp_path / "inprocess", model.apply(plan.scene.physics))
    record_trial(plan, bag.info, tmp_path / "nominal")
    expected, nominal = (TrialBag.open(tmp_path / name).joints(STATES).position for name in ("inprocess", "nominal"))
    np.testing.assert_allclose(bag.joints(STATES).position, expected, rtol=0.0, atol=1e-9)
    assert np.abs(nominal - expected).max() > 1e-6


def hidden_model() -> Model:
    """One effect of the library, away from its nominal value."""
    name, effect = next((name, effect) for name, effect in library().items() if "friction" in name)
    parameters = {
        scalar.name: ParameterValue(estimate=0.9 * scalar.nominal + 0.1 * scalar.upper, unit=scalar.unit)
        for scalar in effect.scalars(load_facts("franka_fer").joint_count)
    }
    return Model(name="hidden", effects=(ModelEffect(name=name, parameters=parameters),))


def test_a_cancelled_trial_leaves_a_readable_bag(graph: Graph, tmp_path: Path) -> None:
    handle = begun(graph, graph.run_trial, goal(tmp_path))
    handle.cancel_goal_async()
    answer = result_of(graph, handle.get_result_async())
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.outcome == "ABORTED"
    assert TrialBag.open(Path(answer.result.bag_path)).outcome == "ABORTED"


def campaign(scenario: str, folder: Path, trials: int) -> RunCampaign.Goal:
    values = {"scenario": scenario, "objects": ["parcel"], "cases": ["1"], "velocity_scales": [1.0]}
    return RunCampaign.Goal(**values, trials=trials, output_directory=str(folder))


def test_a_campaign_runs_what_is_missing(graph: Graph, tmp_path: Path, short: str) -> None:
    answers = []
    for _ in range(2):
        handle = result_of(graph, graph.run_campaign.send_goal_async(campaign(short, tmp_path, 1)))
        answer = result_of(graph, handle.get_result_async()).result
        answers.append((answer.success, answer.finished, answer.failed, answer.skipped))
    assert answers == [(True, 1, 0, 0), (True, 0, 0, 1)]


def test_a_cancelled_campaign_counts_its_trial_neither_way(graph: Graph, tmp_path: Path, short: str) -> None:
    handle = result_of(graph, graph.run_campaign.send_goal_async(campaign(short, tmp_path, 2)))
    bag = tmp_path / ".partial" / "parcel__case_1__s1.000__r0"
    spin_until(graph, bag.exists, "no trial begins")
    handle.cancel_goal_async()
    result = result_of(graph, handle.get_result_async()).result
    assert (result.success, result.message) == (False, "cancelled")
    assert (result.finished, result.failed) == (0, 0)


def test_a_plant_that_blows_up_has_its_reason_through_the_nodes_too(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = (config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8")
    light = tmp_path / "light.yaml"
    light.write_text(shipped.replace("facts: franka_fer", "facts: franka_fr3"), encoding="utf-8")
    manifest = make_manifest(str(light), ["cat_food"], ["2"], [1.0], trials=1)
    key = manifest.keys[0]
    told = run_one(tmp_path / "inprocess", manifest.trial(key))
    answers = []
    monkeypatch.setattr(
        graph, "call_trial", lambda goal, call=graph.call_trial: answers.append(call(goal)) or answers[-1]
    )
    report = run_trial(graph, tmp_path / "nodes", manifest, key)
    assert [(answer.success, answer.outcome) for answer in answers] == [(False, "DIVERGED")]  # and it is not run again
    assert (report.outcome, report.message) == (told.outcome, told.message)
    assert (report.outcome, report.message[:13]) == ("DIVERGED", "arm joint7 at")
    bag = TrialBag.open(tmp_path / "nodes" / key.name)
    assert (bag.outcome, bag.reason) == (report.outcome, report.message)
    assert bag.counts == TrialBag.open(tmp_path / "inprocess" / key.name).counts | {
        topic: count for topic, count in bag.counts.items() if topic == "/diagnostics" or topic == "/truth/model"
    }


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
