# SPDX-License-Identifier: Apache-2.0
"""Trials and campaigns through the nodes: in real time, without impact, with hidden effects, cancelled, continued."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from action_msgs.msg import GoalStatus
from impact_rs.action import RunCampaign
from node_trials import begun, goal, one_trial, result_of, spin_until, whole_trial
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from impact_rs_ros.graph import Graph
from impact_rs_sim.effects import library
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.robot import load_facts
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.campaign import make_manifest

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
