# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with the nodes ends a trial with an error, and nothing else."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from impact_rs.action import RunCampaign, RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import JointState

from impact_rs_ros.graph import Graph, GraphError, run_trial, run_trials_through_nodes
from impact_rs_ros.node_processes import NODES
from impact_rs_sim.effects import library
from impact_rs_sim.effects.formula import FormulaParameter, FormulaSpec
from impact_rs_sim.model import Model, ModelEffect
from impact_rs_sim.model import ParameterValue as ParameterBelief
from impact_rs_sim.robot import load_facts
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import BagError, TrialBag
from impact_rs_trials.bags.record import record_trial
from impact_rs_trials.campaign import FAILURES, make_manifest

PATIENCE = 60.0  # s, of the tests; never reached on a machine that works


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A push of less than half the length, for trials of which only the end is looked at."""
    scenario = load_scenario("push")
    timing = {"nominal_impact": 0.45, "approach": 0.4, "overrun": 0.1, "stop": 0.15, "push": 0.25, "slide": 0.1}
    changed = scenario.timing.model_copy(update=timing | {"window_after": 0.25, "duration": 0.8})  # s
    path = tmp_path_factory.mktemp("scenarios") / "short.yaml"
    path.write_text(scenario.model_copy(update={"timing": changed}).model_dump_json(), encoding="utf-8")
    return str(path)


def goal(folder: Path, **changes: object) -> RunTrial.Goal:
    values = {"scenario": "push", "object_name": "parcel", "case_name": "1", "velocity_scale": 1.0, "seed": 5}
    return RunTrial.Goal(**values | {"output_directory": str(folder)} | changes)


def readable(path: Path) -> bool:
    """Whether a bag is closed: its checksums come last."""
    try:
        TrialBag.open(path)
    except BagError:
        return False
    return True


def spin_until(graph: Graph, condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        graph.spin(0.05)


@pytest.mark.parametrize("victim", ["controller", "plant"])
def test_a_node_killed_in_mid_trial_ends_the_trial_and_not_the_campaign(
    graph: Graph, tmp_path: Path, short: str, victim: str
) -> None:
    def kill(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > 0.2:
            graph.processes[victim].kill()

    result = graph.call_trial(goal(tmp_path), kill)
    assert (result.success, result.outcome) == (False, "ABORTED")
    assert result.message
    bag = TrialBag.open(Path(result.bag_path))
    assert bag.outcome == "ABORTED"
    assert 200 < bag.counts[topics.joint_states("arm")] < 1801
    assert len(bag.joints(topics.joint_states("arm")).time) == bag.counts[topics.joint_states("arm")]

    (line,) = graph.revive()
    assert victim in line and "SIGKILL" in line
    graph.wait_until_ready()
    manifest = make_manifest(short, ["parcel"], ["1"], [1.0], trials=1)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert (report.outcome, report.message) == ("OK", "")


def test_a_frozen_recorder_ends_the_trial_with_its_name_and_what_it_wrote_is_read(
    graph: Graph, tmp_path: Path, short: str
) -> None:
    def stop(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > 0.5:
            graph.processes["recorder"].send_signal(signal.SIGSTOP)

    result = graph.call_trial(goal(tmp_path), stop)
    assert (result.success, result.outcome) == (False, "ABORTED")
    assert result.message == "node /recorder was killed or froze"
    bag = TrialBag.open(Path(result.bag_path))
    assert bag.outcome == "ABORTED"
    assert "cut off at t = " in bag.reason
    assert bag.counts[topics.joint_states("arm")] > 200
    spin_until(graph, lambda: bool(graph.presence.gone("recorder")), "the runner notices nothing")
    assert graph.end_frozen() == ["recorder"]
    assert graph.revive()[0].startswith("node recorder did not answer any more")
    graph.wait_until_ready()
    assert graph.call_trial(goal(tmp_path, scenario=short)).outcome == "OK"


@pytest.mark.parametrize("name", ["plant", "controller", "recorder"])
def test_a_node_that_is_there_twice_is_named_and_no_trial_runs(
    graph: Graph, tmp_path: Path, short: str, name: str
) -> None:
    environment = graph.nodes.environment
    command = [sys.executable, "-m", f"impact_rs_ros.{name}_node"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT) as second:
        try:
            spin_until(graph, lambda: graph.presence.duplicates(name) == [name], "the second one is not met")
            result = graph.call_trial(goal(tmp_path))
        finally:
            second.terminate()
    assert (result.success, result.outcome) == (False, "ABORTED")
    assert f"two nodes are called /{name}" in result.message
    assert not [path for path in tmp_path.iterdir() if path.name[0] != "."]
    after = graph.call_trial(goal(tmp_path, scenario=short))
    assert after.outcome == "OK", after.message


def test_a_second_publisher_of_torques_is_named_and_the_trial_is_aborted(
    graph: Graph, tmp_path: Path, short: str
) -> None:
    stranger = rclpy.create_node("stranger", namespace="cell", context=graph.node.context)
    try:
        stranger.create_publisher(JointState, topics.joint_command("arm"), 10)
        result = graph.call_trial(goal(tmp_path))
    finally:
        stranger.destroy_node()
    assert (result.success, result.outcome) == (False, "ABORTED")
    assert "/arm/joint_command is published by /cell/stranger and /controller" in result.message
    spin_until(graph, lambda: len(graph.presence.publishers(topics.joint_command("arm"))) == 1, "it does not leave")
    assert graph.call_trial(goal(tmp_path, scenario=short)).outcome == "OK"


@pytest.mark.parametrize("name", NODES)
def test_a_node_that_is_killed_while_it_starts_is_started_again(graph: Graph, name: str) -> None:
    graph.nodes.kill(name)
    graph.revive()
    graph.nodes.kill(name)
    graph.wait_until_ready()
    assert graph.processes[name].poll() is None
    assert graph.answers(name)


def test_a_node_that_cannot_start_ends_the_waiting(domain_ids: Callable[[], int], tmp_path: Path) -> None:
    parameters = tmp_path / "wrong.yaml"
    parameters.write_text("/impact_map:\n  ros__parameters:\n    engine: steam\n")
    refused = pytest.raises(GraphError, match="impact_map ended with exit code 2.*engine")
    with refused, Graph.running("push", domain_ids(), parameters):
        pass


@pytest.mark.parametrize("victim", ["recorder", "experiment"])
def test_without_recorder_or_experiment_a_trial_fails_and_the_next_one_runs(
    graph: Graph, tmp_path: Path, short: str, victim: str
) -> None:
    def kill(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > 0.3:
            graph.processes[victim].kill()

    with pytest.raises(GraphError, match=f"node {victim} died"):
        graph.call_trial(goal(tmp_path), kill)
    (path,) = tmp_path.glob(".partial/*")
    assert TrialBag.open(path).outcome == "ABORTED"
    assert TrialBag.open(path).counts[topics.joint_states("arm")] > 100
    (line,) = graph.revive()
    assert victim in line and "SIGKILL" in line
    graph.wait_until_ready()
    manifest = make_manifest(short, ["parcel"], ["1"], [1.0], trials=1)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert (report.outcome, report.message) == ("OK", "")


def test_a_trial_whose_experiment_node_is_killed_leaves_a_readable_bag(graph: Graph, tmp_path: Path) -> None:
    def kill(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > 0.2:
            graph.processes["experiment"].kill()

    with pytest.raises(GraphError, match="node experiment died"):
        graph.call_trial(goal(tmp_path), kill)
    graph.revive()
    graph.wait_until_ready()
    (path,) = tmp_path.glob(".partial/*")
    spin_until(graph, lambda: readable(path), "the recorder closes no bag")
    bag = TrialBag.open(path)
    assert bag.outcome == "ABORTED"
    assert bag.counts[topics.joint_states("arm")] > 200


@pytest.mark.parametrize("victim", ["plant", "experiment"])
def test_a_node_that_hangs_is_started_again_and_its_trial_run_once_more(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, victim: str
) -> None:
    call_trial, stopped = graph.call_trial, []

    def stop_once(goal: RunTrial.Goal) -> RunTrial.Result:
        def stop(message: RunTrial.Impl.FeedbackMessage) -> None:
            if message.feedback.time > 0.2 and not stopped:
                stopped.append(graph.processes[victim].pid)
                graph.processes[victim].send_signal(signal.SIGSTOP)

        return call_trial(goal, stop)

    monkeypatch.setattr(graph, "call_trial", stop_once)
    manifest = make_manifest("push", ["parcel"], ["1"], [1.0], trials=1)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert report.outcome == "OK", report
    assert report.message.startswith(f"node {victim} did not answer any more and is started again")
    assert graph.processes[victim].pid != stopped[0]
    assert not Path(f"/proc/{stopped[0]}").exists()


def test_an_experiment_node_that_only_seemed_to_hang_does_not_go_on_with_its_trial_beside_the_next(
    graph: Graph, tmp_path: Path, short: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers, before, asked = graph.answers, graph.processes["experiment"].pid, []

    def deaf_once(name: str) -> bool:
        if name == "experiment" and not asked:
            asked.append(name)
            return False
        return answers(name)

    monkeypatch.setattr(graph, "answers", deaf_once)
    monkeypatch.setattr("impact_rs_ros.graph.SILENCE", 0.0)
    manifest = make_manifest(short, ["parcel"], ["1"], [1.0], trials=1)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert asked
    assert report.outcome == "OK", report
    assert report.message.startswith("node experiment did not answer any more and is started again")
    assert graph.processes["experiment"].pid != before


def test_in_real_time_the_plant_does_not_wait_and_every_sample_is_recorded(graph: Graph, tmp_path: Path) -> None:
    def realtime(on: bool) -> None:
        value = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=on)
        limit = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=1.0 if on else 0.05)  # a busy machine
        changed = [Parameter(name="realtime", value=value), Parameter(name="missed_ticks_limit", value=limit)]
        for result in graph.call(
            SetParameters, "plant/set_parameters", SetParameters.Request(parameters=changed)
        ).results:
            assert result.successful, result.reason

    realtime(True)
    try:
        started = time.monotonic()
        result = graph.call_trial(goal(tmp_path))
        took = time.monotonic() - started
    finally:
        realtime(False)
    assert result.outcome != "ABORTED", result.message
    bag = TrialBag.open(Path(result.bag_path))
    samples = bag.counts[topics.joint_states("arm")]
    assert samples == bag.counts[topics.truth_joint_states("arm")]
    assert took > bag.info.spec.scenario.timing.control_period * (samples - 1)
    # An arm that is led late on a busy machine may run away, which ends the trial.
    assert samples == 1801 or (result.outcome == "DIVERGED" and samples < 1801)
    missed = samples - bag.counts[topics.joint_command("arm")]  # a busy machine misses ticks
    assert missed >= 0
    assert missed == 0 or f" of {samples - 1} ticks without a torque in time" in bag.reason


def test_an_excursion_ends_well_without_impact(graph: Graph, tmp_path: Path) -> None:
    scenario = load_scenario("excite")
    manifest = make_manifest("excite", [next(iter(scenario.objects))], [next(iter(scenario.cases))], [1.0], trials=1)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert (report.outcome, report.message) == ("OK", "")
    bag = TrialBag.open(tmp_path / manifest.keys[0].name)
    assert bag.counts[topics.impact_event("arm")] == 0
    assert bag.counts[topics.joint_states("arm")] == scenario.timing.ticks + 1


def test_effects_hidden_in_the_plant_change_the_trial_and_stay_hidden(graph: Graph, tmp_path: Path) -> None:
    model = hidden_model()
    manifest = make_manifest("push", ["parcel"], ["1"], [1.0], trials=1, seed=5)
    key = manifest.keys[0]
    report = run_trial(graph, tmp_path / "nodes", manifest, key, plant_model=model)
    assert (report.outcome, report.message) == ("OK", "")
    bag = TrialBag.open(tmp_path / "nodes" / key.name)
    assert bag.info.model_yaml == ""
    assert bag.counts[topics.TRUTH_MODEL] == 1
    for file in bag.path.glob("*.yaml"):
        assert model.effects[0].name not in file.read_text()

    plan = bag.info.spec.plan
    record_trial(plan, bag.info, tmp_path / "inprocess", model.apply(plan.scene.physics))
    expected = TrialBag.open(tmp_path / "inprocess").joints(topics.joint_states("arm"))
    np.testing.assert_allclose(bag.joints(topics.joint_states("arm")).position, expected.position, rtol=0.0, atol=1e-9)
    record_trial(plan, bag.info, tmp_path / "nominal")
    nominal = TrialBag.open(tmp_path / "nominal").joints(topics.joint_states("arm"))
    assert np.abs(nominal.position - expected.position).max() > 1e-6


def hidden_model() -> Model:
    """One effect of the library, away from its nominal value."""
    name, effect = next((name, effect) for name, effect in library().items() if "friction" in name)
    parameters = {
        scalar.name: ParameterBelief(estimate=0.9 * scalar.nominal + 0.1 * scalar.upper, unit=scalar.unit)
        for scalar in effect.scalars(load_facts("franka_fer").joint_count)
    }
    return Model(name="hidden", effects=(ModelEffect(name=name, parameters=parameters),))


def test_why_a_trial_failed_stands_in_its_campaign_with_what_the_nodes_wrote(
    graph: Graph, tmp_path: Path, short: str
) -> None:
    grows = FormulaParameter(unit="N m", nominal=0.0, lower=0.0, upper=1.0, scale=0.1)
    spec = FormulaSpec(
        name="drag", sentence="It bursts.", joint_torque={"joint2": "c * exp(exp(20))"}, parameters={"c": grows}
    )
    value = ParameterBelief(estimate=1.0, unit="N m")
    bursts = Model(name="m", formulas=(spec,), effects=(ModelEffect(name="drag", parameters={"c": value}),))
    manifest = make_manifest(short, ["parcel"], ["1"], [1.0], trials=1)
    key = manifest.keys[0]
    report = run_trial(graph, tmp_path, manifest, key, plant_model=bursts)
    assert report.outcome == "ABORTED"
    assert "blows up" in report.message
    assert "node experiment wrote:\n[WARN]" in report.trace
    assert (tmp_path / FAILURES / f"{key.name}.txt").read_text().startswith(report.message)
    assert run_trial(graph, tmp_path, manifest, key).outcome == "OK"
    assert not (tmp_path / FAILURES).exists()


@pytest.mark.parametrize("text", ["effects: [", "name: x\neffects: [{name: gremlins, parameters: {}}]"])
def test_a_model_that_is_none_is_refused(graph: Graph, tmp_path: Path, text: str) -> None:
    with pytest.raises(GraphError, match="rejected the trial: .*goal rejected: .*plant_model"):
        graph.call_trial(goal(tmp_path, plant_model=text))


@pytest.mark.parametrize("node", NODES)
def test_interrupting_a_node_that_still_imports_prints_no_traceback(node: str) -> None:
    command = [sys.executable, "-m", f"impact_rs_ros.{node}_node"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        spin_until_loading(process.pid)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)
    assert output == ""


def spin_until_loading(pid: int) -> None:
    """Wait until a process begins to import NumPy, which comes before everything that takes long."""
    deadline = time.monotonic() + PATIENCE
    while "_multiarray_umath" not in Path(f"/proc/{pid}/maps").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def test_a_cancelled_trial_leaves_a_readable_bag(graph: Graph, tmp_path: Path) -> None:
    seen = []
    sent = graph.run_trial.send_goal_async(goal(tmp_path), feedback_callback=seen.append)
    spin_until(graph, sent.done, "no answer to the goal")
    spin_until(graph, lambda: bool(seen), "no feedback")
    handle = sent.result()
    handle.cancel_goal_async()
    result = handle.get_result_async()
    spin_until(graph, result.done, "no result")
    assert result.result().status == GoalStatus.STATUS_CANCELED
    assert result.result().result.outcome == "ABORTED"
    assert TrialBag.open(Path(result.result().result.bag_path)).outcome == "ABORTED"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"scenario": "nowhere"}, "no scenario 'nowhere'"),
        ({"object_name": "piano"}, "no object 'piano'"),
        ({"case_name": "9"}, "no case '9'"),
        ({"velocity_scale": -1.0}, "velocity scale"),
        ({"motor_inertia": "large"}, "motor-inertia model"),
    ],
)
def test_a_trial_that_cannot_be_is_rejected_with_a_reason(
    graph: Graph, tmp_path: Path, changes: dict[str, object], reason: str
) -> None:
    with pytest.raises(GraphError, match=f"goal rejected: .*{reason}"):
        graph.call_trial(goal(tmp_path, **changes))


@pytest.mark.parametrize("changes", [{"output_directory": "/etc"}, {"scenario": "../../x.yaml"}])
def test_requests_name_nothing_outside_the_roots(graph: Graph, tmp_path: Path, changes: dict[str, str]) -> None:
    with pytest.raises(GraphError, match="goal rejected: .*expected a path below"):
        graph.call_trial(goal(tmp_path, **changes))
    request = ConfigureTrial.Request(bag_path="/tmp/../etc/bag")
    request.trial.robots = ["arm"]
    answer = graph.call(ConfigureTrial, "recorder/configure_trial", request)
    assert not answer.success
    assert "bag_path" in answer.message


def test_a_bag_is_never_overwritten(graph: Graph, tmp_path: Path) -> None:
    (tmp_path / "parcel__case_1__s1.000__r0").mkdir()
    result = graph.call_trial(goal(tmp_path))
    assert not result.success
    assert "exists already" in result.message


def test_a_campaign_runs_what_is_missing(graph: Graph, tmp_path: Path, short: str) -> None:
    request = RunCampaign.Goal(
        scenario=short,
        objects=["parcel"],
        cases=["1"],
        velocity_scales=[1.0],
        trials=1,
        output_directory=str(tmp_path),
    )
    answers = []
    for _ in range(2):
        sent = graph.run_campaign.send_goal_async(request)
        spin_until(graph, sent.done, "no answer to the goal")
        result = sent.result().get_result_async()
        spin_until(graph, result.done, "no result")
        answer = result.result().result
        answers.append((answer.success, answer.finished, answer.failed, answer.skipped))
    assert answers == [(True, 1, 0, 0), (True, 0, 0, 1)]


def test_the_recorder_says_what_is_missing(graph: Graph, tmp_path: Path) -> None:
    configure = graph.node.create_client(ConfigureTrial, "recorder/configure_trial")
    finish = graph.node.create_client(FinishTrial, "recorder/finish_trial")
    spin_until(graph, lambda: configure.service_is_ready() and finish.service_is_ready(), "no recorder")
    request = ConfigureTrial.Request(bag_path=str(tmp_path / "bag"))
    request.trial.robots = ["arm"]
    ready = configure.call_async(request)
    spin_until(graph, ready.done, "no answer")
    assert ready.result().success, ready.result().message
    (file,) = (tmp_path / ".partial" / "bag").iterdir()
    inode = file.stat().st_ino
    again = configure.call_async(request)  # because the answer took long
    spin_until(graph, again.done, "no answer")
    assert again.result().success
    assert file.stat().st_ino == inode
    done = finish.call_async(FinishTrial.Request(topics=["/arm/joint_states"], counts=[5]))
    spin_until(graph, done.done, "no answer")
    again = finish.call_async(FinishTrial.Request())  # whose first answer got lost
    spin_until(graph, again.done, "no answer")
    assert again.result() == done.result()
    assert not done.result().success
    assert done.result().outcome == "ABORTED"
    assert "/arm/joint_states 0 of 5" in done.result().message


def test_a_node_ends_in_order_when_it_is_told_to(graph: Graph) -> None:
    for name, number in (("impact_map", signal.SIGTERM), ("recorder", signal.SIGINT)):
        process = graph.processes[name]
        process.send_signal(number)
        assert process.wait(PATIENCE) == 0
        assert "Traceback" not in graph.nodes.output(name)
    assert len(graph.revive()) == 2
    graph.wait_until_ready()


def test_trials_of_a_campaign_run_in_nodes_that_are_gone_afterwards(
    domain_ids: Callable[[], int], tmp_path: Path
) -> None:
    manifest = make_manifest("push", ["juice"], ["3"], [0.9], trials=1, seed=2)
    before = set(descendants(os.getpid()))
    reports = list(run_trials_through_nodes(tmp_path, manifest, manifest.keys, domain_ids()))
    assert [(report.outcome, report.message) for report in reports] == [("OK", "")]
    assert TrialBag.open(tmp_path / manifest.keys[0].name).info.key == manifest.keys[0]
    assert set(descendants(os.getpid())) <= before


def test_up_tells_what_died_and_stops_on_interrupt(domain_ids: Callable[[], int]) -> None:
    environment = dict(os.environ, ROS_DOMAIN_ID=str(domain_ids()), PYTHONUNBUFFERED="1")
    program = "import sys; from impact_rs_ros.graph import up; sys.exit(up('push'))"
    with subprocess.Popen(
        [sys.executable, "-c", program],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if "The nodes are up" in line:
                break
        nodes = descendants(process.pid)
        assert len(nodes) == len(NODES)
        victim = next(pid for pid, command in nodes.items() if "impact_map_node" in command)
        os.kill(victim, signal.SIGKILL)
        for line in process.stdout:
            said.append(line)
            if "node impact_map died (SIGKILL)" in line:
                break
        nodes = descendants(process.pid)
        process.send_signal(signal.SIGINT)
        said += process.stdout.readlines()
        assert process.wait(PATIENCE) == 0
    assert "Traceback" not in "".join(said)
    assert not [pid for pid in nodes if Path(f"/proc/{pid}").exists()]


def descendants(parent: int) -> dict[int, str]:
    """Command lines of the child processes of a process."""
    found = {}
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            try:
                stat = (path / "stat").read_text()
                command = (path / "cmdline").read_text().replace("\0", " ")
            except OSError:  # gone meanwhile
                continue
            if int(stat.rsplit(")", 1)[1].split()[1]) == parent:
                found[int(path.name)] = command
    return found
