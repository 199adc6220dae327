# SPDX-License-Identifier: Apache-2.0
"""A node that fails costs one repetition of its trial, and a trial that fails costs nothing else."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from itertools import count
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus
from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial
from lifecycle_msgs.srv import ChangeState
from node_trials import TRIES, beside, configuration, goal, one_trial, plant_action, result_of, spin_until
from processes import PATIENCE, running, until
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from impact_rs_ros import graph as graphs
from impact_rs_ros.graph import Graph, GraphError, run_trial, run_trials_through_nodes
from impact_rs_ros.message_types import available, message_type
from impact_rs_ros.names import on_network
from impact_rs_ros.node_processes import NODES, NodeProcesses
from impact_rs_ros.qos import WATCH
from impact_rs_sim.effects.formula import FormulaParameter, FormulaSpec
from impact_rs_sim.model import Model, ModelEffect, ParameterValue
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.campaign import FAILURES, make_manifest
from impact_rs_trials.spec import TrialSpec

STATES = topics.joint_states("arm")
SAMPLES = 801  # of the trial ``short``
SAVED = 100_000  # bytes, of some 100 ticks, that the bag of the disturbed trial holds
TIMEOUTS = "does not answer", "no progress", "silent for"  # in reasons of who has waited in vain
LOST = "was killed (SIGKILL)", "froze"
SECOND_START = "all nodes were started again"


class Attempts:
    """Trials of a graph, the first of which is disturbed; keeps why each ended and what its bag holds.

    It is disturbed after 0.2 s of its time, and not before so many bytes are on the disk: a busy recorder is late.
    """

    def __init__(self, graph: Graph, folder: Path, disturb: Callable[[], object], saved: int = 0) -> None:
        self.reasons: list[str] = []
        self.bags: list[TrialBag] = []
        self._call, self._folder = graph.call_trial, folder
        self._disturb, self._enough = disturb, saved
        self.disturbed: int | None = None  # which of them

    def __call__(self, wanted: RunTrial.Goal) -> RunTrial.Result:
        try:
            result = self._call(wanted, self._strike)
        except GraphError as error:
            self.reasons.append(str(error))
            raise
        finally:
            self.bags += [TrialBag.open(path) for path in self._folder.glob(".partial/*")]
        self.reasons.append(result.message)
        return result

    def _strike(self, told: RunTrial.Impl.FeedbackMessage) -> None:
        if self.disturbed is None and told.feedback.time > 0.2 and self._saved >= self._enough:
            self.disturbed = len(self.reasons)
            self._disturb()

    @property
    def _saved(self) -> int:
        return sum(path.stat().st_size for path in self._folder.glob(".partial/*/*.mcap"))


@pytest.fixture
def restarts(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """What was lost at every restart, which starts no more than that; how all are started again has its own test.

    The server of actions of a killed process is offered for some seconds more, and a goal sent to it is lost: where the
    experiment node is lost, all are started again.
    """
    found: list[list[str]] = []
    whole = graph.restart

    def restart() -> None:
        if "experiment" in (lost := graph.lost()):
            found.append(list(lost.values()))
            whole()
            return
        found.append(graph.replace_lost())
        assert not graph._await_started()

    monkeypatch.setattr(graph, "restart", restart)
    return found


@pytest.mark.parametrize(
    ("victim", "kind"),
    [
        ("plant", "SIGKILL"),
        pytest.param("recorder", "SIGSTOP", marks=pytest.mark.slow),
        pytest.param("controller", "SIGKILL", marks=pytest.mark.slow),
        pytest.param("experiment", "SIGSTOP", marks=pytest.mark.slow),
    ],
)
def test_trial_of_a_lost_node_is_repeated_and_the_node_named(
    graph: Graph,
    tmp_path: Path,
    short: str,
    monkeypatch: pytest.MonkeyPatch,
    restarts: list[list[str]],
    victim: str,
    kind: str,
) -> None:
    """Kills: a lease that nobody looks at; then a timeout ends the trial, later, and names a service."""
    manifest, call = one_trial(short), graph.call_trial
    for number in range(TRIES):
        restarts.clear()
        process = graph.processes[victim]
        folder = tmp_path / str(number)
        attempts = Attempts(graph, folder, lambda one=process: one.send_signal(signal.Signals[kind]), SAVED)
        monkeypatch.setattr(graph, "call_trial", attempts)
        report = run_trial(graph, folder, manifest, manifest.keys[0])
        monkeypatch.setattr(graph, "call_trial", call)
        if attempts.disturbed == 0 and report.message.count("node ") == 1:
            break  # else a busy machine has starved the recorder until the end, or another node, which counts as frozen
    assert not [one for one in TIMEOUTS if one in attempts.reasons[0]], attempts.reasons
    assert (report.outcome, len(attempts.reasons), len(restarts)) == ("OK", 2, 1), (report, attempts.reasons)
    assert report.message.startswith(f"node {victim} {LOST[kind == 'SIGSTOP']}")
    assert report.message.endswith(SECOND_START)
    assert not Path(f"/proc/{process.pid}").exists()
    assert attempts.bags[0].outcome == "ABORTED"
    recorded = len(attempts.bags[0].joints(STATES).time)
    assert recorded > 0
    # The experiment node is not in the lockstep: without it a fast machine reaches the end before the loss is noticed.
    assert victim == "experiment" or recorded < SAMPLES
    assert TrialBag.open(folder / manifest.keys[0].name).counts[STATES] == SAMPLES


@pytest.mark.parametrize(
    "victim",
    ["controller", pytest.param("plant", marks=pytest.mark.slow), pytest.param("recorder", marks=pytest.mark.slow)],
)
def test_a_node_that_is_deactivated_ends_its_trial_with_that_reason_and_serves_the_next_once_active(
    graph: Graph, tmp_path: Path, short: str, victim: str
) -> None:
    """By the services that ``ros2 lifecycle set`` calls; nothing is started again."""
    client = graph.node.create_client(ChangeState, f"{victim}/change_state")
    changed: list[Future] = []

    def change(label: str) -> Future:
        request = ChangeState.Request()
        request.transition.label = label
        return client.call_async(request)

    def activate() -> None:
        again = change("activate")
        spin_until(graph, again.done, "it does not activate")
        assert again.result().success

    def strike(told: RunTrial.Impl.FeedbackMessage) -> None:
        if not changed and told.feedback.time > 0.1:
            changed.append(change("deactivate"))

    for number in range(TRIES):
        changed.clear()
        result = graph.call_trial(goal(tmp_path / str(number), scenario=short), strike)
        spin_until(graph, changed[0].done, "it does not deactivate")
        assert changed[0].result().success
        if result.outcome != "OK":
            break  # else a busy machine has run the request after the end of the trial
        activate()
    assert result.outcome == "ABORTED"
    assert f"{victim} was deactivated at t = 0." in result.message
    refused = graph.call_trial(goal(tmp_path / "refused", scenario=short))
    assert f"/{victim} is not active: ros2 lifecycle set /{victim} activate" in refused.message
    activate()
    assert graph.call_trial(goal(tmp_path / "after", scenario=short)).outcome == "OK"
    graph.node.destroy_client(client)


def test_a_goal_of_the_plant_reports_its_time_and_ends_when_it_is_cancelled(graph: Graph, short: str) -> None:
    """Without a prepared trial it is aborted with the reason; a cancelled one is over at once."""
    refused = result_of(graph, plant_action(graph).send_goal_async(RunTrial.Goal()))
    answer = result_of(graph, refused.get_result_async())
    assert (answer.status, answer.result.message) == (GoalStatus.STATUS_ABORTED, "plant: configure a trial first")

    trial = configuration(TrialSpec.of(load_scenario(short), "parcel", "case_1").plan, attempt=11)
    for name in ("plant", "controller"):
        assert graph.call(ConfigureTrial, f"{name}/configure_trial", trial).success
    listening = [
        graph.node.create_subscription(message_type(kind), on_network(topic), lambda message: None, WATCH)
        for topic, kind in topics.recorded(["arm"]).items()
        if available(kind)
    ]
    times: list[float] = []
    run = plant_action(graph).send_goal_async(RunTrial.Goal(), lambda told: times.append(told.feedback.time))
    running_goal = result_of(graph, run)
    spin_until(graph, lambda: times and times[-1] > 0.1, "no feedback")
    assert len(result_of(graph, running_goal.cancel_goal_async()).goals_canceling) == 1
    answer = result_of(graph, running_goal.get_result_async())
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.message.startswith("plant was cancelled at t = 0.")
    assert (answer.result.success, answer.result.outcome) == (False, "ABORTED")
    done = graph.call(FinishTrial, "plant/finish_trial", FinishTrial.Request(attempt=11))
    assert (done.success, done.outcome, done.message) == (False, "ABORTED", answer.result.message)
    assert graph.call(FinishTrial, "controller/finish_trial", FinishTrial.Request(attempt=11, aborted=True)).success
    for subscription in listening:
        graph.node.destroy_subscription(subscription)


def test_the_service_that_ran_trials_answers_with_the_name_of_the_action(graph: Graph) -> None:
    answer = graph.call(Trigger, "plant/run_trial", Trigger.Request())
    assert not answer.success
    assert answer.message.startswith("/plant/run_trial is an action now: ros2 action send_goal /plant/run_trial ")


def test_a_bag_that_was_closed_before_the_answer_was_lost_is_kept(
    graph: Graph, tmp_path: Path, short: str, monkeypatch: pytest.MonkeyPatch, restarts: list[list[str]]
) -> None:
    call, manifest = graph.call_trial, one_trial(short)

    def unheard(wanted: RunTrial.Goal) -> RunTrial.Result:
        assert call(wanted).outcome == "OK"
        raise GraphError("no answer")

    monkeypatch.setattr(graph, "call_trial", unheard)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert (report.outcome, report.message) == ("OK", f"no answer; {SECOND_START}")
    assert len(restarts) == 1


def test_without_the_impact_map_a_trial_goes_on(
    graph: Graph, tmp_path: Path, short: str, monkeypatch: pytest.MonkeyPatch, restarts: list[list[str]]
) -> None:
    process = graph.processes["impact_map"]

    def kill() -> None:  # the trial may end before a process that was killed is gone
        process.kill()
        process.wait()

    attempts = Attempts(graph, tmp_path, kill)
    monkeypatch.setattr(graph, "call_trial", attempts)
    manifest = one_trial(short)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert (report.outcome, len(attempts.reasons)) == ("OK", 1)
    assert report.message.startswith("node impact_map was killed (SIGKILL)")
    assert (len(restarts), graph.lost()) == (1, {})


@pytest.mark.slow
def test_a_silent_experiment_node_ends_before_the_trial_is_repeated(
    graph: Graph, tmp_path: Path, short: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else its trial would go on beside the next one."""
    first, restart = graph.processes["experiment"], graph.restart

    def heard_again() -> None:
        monkeypatch.setattr(graphs, "MAX_SILENCE_S", PATIENCE)
        restart()

    monkeypatch.setattr(graphs, "MAX_SILENCE_S", 0.0)
    monkeypatch.setattr(graph, "restart", heard_again)
    manifest = one_trial(short)
    report = run_trial(graph, tmp_path, manifest, manifest.keys[0])
    assert (report.outcome, report.message) == ("OK", f"the experiment node is silent for 0 s; {SECOND_START}")
    assert first.poll() == 0


def test_nodes_start_again_where_one_is_killed_while_starting_or_freezes(
    domain_ids: Callable[[], int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kills: a start that gives up, a restart that waits for a frozen node to end by itself or that keeps a node."""
    domain, notified, started = domain_ids(), [], []
    nodes = NodeProcesses.of("push", tmp_path, domain)
    graph = Graph(nodes, ["impact_map", "recorder"], domain, foreign=["plant"], notify=notified.append)
    start, in_vain = nodes.start, f"no plant came within 0 s: .* in ROS domain {domain}; discovery: this machine only"

    def start_and_kill_once(name: str) -> None:
        start(name)
        started.append(name)
        if len(started) == 1:
            nodes.kill(name)

    monkeypatch.setattr(nodes, "start", start_and_kill_once)
    monkeypatch.setattr(graphs, "FOREIGN_TIMEOUT_S", 0.0)
    try:
        with pytest.raises(GraphError, match=in_vain):
            graph.start()
        assert started == ["impact_map", "recorder"] * 2
        spin_until(graph, lambda: len(graph.presence.absent()) == len(NODES) - 2, "not discovered")
        before = [process.pid for process in nodes.processes.values()]
        nodes.processes["recorder"].send_signal(signal.SIGSTOP)
        spin_until(graph, graph.lost, "not noticed that it froze")
        with pytest.raises(GraphError, match=in_vain):
            graph.restart()
        assert graph.lost() == {}
        assert not [pid for pid in before if Path(f"/proc/{pid}").exists()]
        assert [line.partition(":")[0] for line in notified] == ["waiting for a plant"] * 2
    finally:
        nodes.stop()
        graph.close()


def test_a_node_that_refuses_its_parameters_is_not_started_again(domain_ids: Callable[[], int], tmp_path: Path) -> None:
    parameters = tmp_path / "wrong.yaml"
    parameters.write_text("/impact_map:\n  ros__parameters:\n    engine: steam\n")
    others = [name for name in NODES if name != "impact_map"]
    before = set(descendants(os.getpid()))
    refused = pytest.raises(GraphError, match="impact_map ended with exit code 2.*engine")
    with refused, Graph.running("push", domain_ids(), parameters, without=others):
        pass
    assert set(descendants(os.getpid())) <= before


def test_a_lost_node_that_refused_its_parameters_stays_down(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph.nodes, "ended", lambda: {"plant": "ended with exit code 2"})
    monkeypatch.setattr(graph.nodes, "refused", lambda name: name == "plant")
    with pytest.raises(GraphError, match="node plant ended with exit code 2"):
        graph.replace_lost()


def test_a_second_node_of_one_name_is_named_and_no_trial_runs(graph: Graph, tmp_path: Path, short: str) -> None:
    """Each process discovers the second node by itself, the experiment node perhaps after a trial or two."""
    command = [sys.executable, "-m", "impact_rs_ros.plant_node"]
    output = {"stdout": subprocess.DEVNULL, "stderr": subprocess.STDOUT}
    folders = (tmp_path / str(number) for number in count())

    def not_ok() -> tuple[Path, RunTrial.Result] | None:
        folder = next(folders)
        result = graph.call_trial(goal(folder, scenario=short))
        return None if result.outcome == "OK" else (folder, result)

    with subprocess.Popen(command, env=graph.nodes.environment, **output) as second:
        try:
            spin_until(graph, graph.presence.duplicates, "the second one is not discovered")
            folder, result = spin_until(graph, not_ok, "trials run with two plants")
        finally:
            second.terminate()
    assert (result.success, result.outcome) == (False, "ABORTED")
    assert "two nodes are called /plant" in result.message
    assert not [path for path in folder.glob("*") if path.name[0] != "."]
    after = graph.call_trial(goal(tmp_path / "after", scenario=short))
    assert after.outcome == "OK", after.message


def test_why_a_trial_failed_stands_in_its_campaign(
    graph: Graph, tmp_path: Path, short: str, restarts: list[list[str]]
) -> None:
    grows = FormulaParameter(unit="N m", nominal=0.0, lower=0.0, upper=1.0, scale=0.1)
    spec = FormulaSpec(
        name="drag", sentence="It bursts.", joint_torque={"joint2": "c * exp(exp(20))"}, parameters={"c": grows}
    )
    value = ParameterValue(estimate=1.0, unit="N m")
    bursts = Model(name="m", formulas=(spec,), effects=(ModelEffect(name="drag", parameters={"c": value}),))
    manifest = one_trial(short)
    key = manifest.keys[0]
    report = run_trial(graph, tmp_path, manifest, key, plant_model=bursts)
    assert len(restarts) == 1
    assert report.outcome == "ABORTED"
    assert "blows up" in report.message
    assert "node experiment wrote:\n[WARN]" in report.trace
    assert (tmp_path / FAILURES / f"{key.name}.txt").read_text().startswith(report.message)
    assert run_trial(graph, tmp_path, manifest, key).outcome == "OK"
    assert not (tmp_path / FAILURES).exists()


def test_a_rejected_goal_has_its_reason(graph: Graph, tmp_path: Path) -> None:
    with pytest.raises(GraphError, match="rejected the trial: .*goal rejected: .*no object 'piano'"):
        graph.call_trial(goal(tmp_path, object_name="piano"))


def test_a_bag_outside_of_the_root_is_refused(graph: Graph) -> None:
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


def test_a_trial_that_nobody_publishes_or_not_reliably_is_not_recorded(graph: Graph, tmp_path: Path) -> None:
    """Kills: a recorder that waits for no publisher, or that counts one of another quality of service."""
    request = ConfigureTrial.Request(bag_path=str(tmp_path / "bag"))
    request.trial.robots = ["left"]
    topic = topics.joint_states("left")

    def refusal() -> str:
        answer = graph.call(ConfigureTrial, "recorder/configure_trial", request)
        assert not answer.success
        return answer.message

    assert f"no publisher of {topic}" in refusal()
    with beside(graph, "stranger") as other:
        other.create_publisher(JointState, topic, qos_profile_sensor_data)
        spin_until(graph, lambda: f"{topic}: published, but not received" in refusal(), "it is not discovered")


def test_a_recorder_names_what_is_missing_and_answers_again(graph: Graph, tmp_path: Path) -> None:
    configure = graph.node.create_client(ConfigureTrial, "recorder/configure_trial")
    finish = graph.node.create_client(FinishTrial, "recorder/finish_trial")
    spin_until(graph, lambda: configure.service_is_ready() and finish.service_is_ready(), "no recorder")
    request = ConfigureTrial.Request(attempt=1, bag_path=str(tmp_path / "bag"))
    request.trial.robots = ["arm"]
    ready = result_of(graph, configure.call_async(request))
    assert ready.success, ready.message
    (file,) = (tmp_path / ".partial" / "bag").iterdir()
    inode = file.stat().st_ino
    assert result_of(graph, configure.call_async(request)).success  # repeated, because the answer took long
    assert file.stat().st_ino == inode
    done = result_of(graph, finish.call_async(FinishTrial.Request(topics=[STATES], counts=[5])))
    assert result_of(graph, finish.call_async(FinishTrial.Request())) == done  # repeated, because the answer was lost
    assert (done.success, done.outcome) == (False, "ABORTED")
    assert "/arm/joint_states 0 of 5" in done.message


def test_requests_that_come_late_leave_the_trial_alone(graph: Graph, tmp_path: Path, short: str) -> None:
    """A request that a busy node answers late is sent again; it stands in a queue until the trial runs or is over."""
    plan = TrialSpec.of(load_scenario(short), "parcel", "case_1").plan
    configure = configuration(plan, tmp_path / "bag", attempt=7)
    members = ["plant", "controller", "recorder"]
    for name in members:
        answer = graph.call(ConfigureTrial, f"{name}/configure_trial", configure)
        assert answer.success, answer.message

    heard: list[object] = []
    states = graph.node.create_subscription(JointState, STATES, heard.append, WATCH)
    running_goal = result_of(graph, plant_action(graph).send_goal_async(RunTrial.Goal()))
    over = running_goal.get_result_async()
    spin_until(graph, lambda: len(heard) > 3, "no states")
    for name in members:
        assert graph.call(ConfigureTrial, f"{name}/configure_trial", configure).success
        assert not graph.call(FinishTrial, f"{name}/finish_trial", FinishTrial.Request(attempt=6)).success
    assert not over.done()
    assert result_of(graph, over).result.success
    graph.node.destroy_subscription(states)

    finish = FinishTrial.Request(attempt=7)
    for name in members:
        done = graph.call(FinishTrial, f"{name}/finish_trial", finish)
        assert (done.success, done.outcome, done.message) == (True, "OK", "")
        finish.topics, finish.counts = [*finish.topics, *done.topics], [*finish.counts, *done.counts]
        assert graph.call(ConfigureTrial, f"{name}/configure_trial", configure).success
        assert graph.call(FinishTrial, f"{name}/finish_trial", finish) == done  # no other trial began
    bag = TrialBag.open(tmp_path / "bag")
    assert bag.counts[STATES] == bag.counts[topics.joint_command("arm")] == SAMPLES


def test_a_node_interrupted_while_importing_prints_no_traceback() -> None:
    """As ``ros2 run`` starts it, in a terminal."""
    plant = Path(__file__).resolve().parents[2] / "scripts" / "plant"
    with running([sys.executable, str(plant)]) as node:
        maps = Path(f"/proc/{node.process.pid}/maps")
        until(lambda: "_multiarray_umath" in maps.read_text(), lambda: time.sleep(0.002))  # NumPy comes first
        assert node.end(signal.SIGINT)[1] == ""


def test_trials_of_a_campaign_run_one_after_the_other_once_their_nodes_are_ready(
    graph: Graph, tmp_path: Path, short: str, monkeypatch: pytest.MonkeyPatch, restarts: list[list[str]]
) -> None:
    """Kills: a campaign that goes on without asking whether a node was lost in between."""
    monkeypatch.setattr(Graph, "running", lambda *arguments, **options: nullcontext(graph))
    manifest = make_manifest(short, ["parcel"], ["1"], [1.0], trials=2)
    reports = []
    for report in run_trials_through_nodes(tmp_path, manifest, manifest.keys):
        if not reports:
            graph.nodes.kill("impact_map")
        reports.append((report.key, report.outcome, report.message))
    assert reports == [(key, "OK", "") for key in manifest.keys]
    assert [line.partition(" (")[0] for (line,) in restarts] == ["node impact_map was killed"]


@pytest.mark.slow
def test_up_starts_a_lost_node_again_and_stops_on_interrupt(domain_ids: Callable[[], int]) -> None:
    program = "import sys; from impact_rs_cli.commands.up import up; sys.exit(up('push'))"
    domain = {"ROS_DOMAIN_ID": str(domain_ids())}
    with running([sys.executable, "-c", program], domain, start_new_session=True) as up:
        up.line("The nodes are up")
        nodes = descendants(up.process.pid)
        assert len(nodes) == len(NODES)
        pid = {name: pid for pid, command in nodes.items() for name in NODES if f"{name}_node" in command}
        os.kill(pid["impact_map"], signal.SIGKILL)
        up.line("node impact_map was killed (SIGKILL)")
        os.kill(pid["recorder"], signal.SIGTERM)
        up.line("node recorder ended with exit code 0")  # in order
        nodes |= descendants(up.process.pid)
        assert len(nodes) == len(NODES) + 2  # the others go on
        code, printed = up.end(signal.SIGINT)
    assert code == 0
    assert "Traceback" not in printed
    assert not [pid for pid in nodes if Path(f"/proc/{pid}").exists()]


def descendants(parent: int) -> dict[int, str]:
    """Command lines of the child processes of a process."""
    found = {}
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            try:
                stat = (path / "stat").read_text()
                command = (path / "cmdline").read_text().replace("\0", " ")
            except OSError:  # it has ended
                continue
            if int(stat.rsplit(")", 1)[1].split()[1]) == parent:
                found[int(path.name)] = command
    return found
