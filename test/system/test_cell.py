# SPDX-License-Identifier: Apache-2.0
"""The cell node between our nodes and a robot of ros2_control, which ``effort_robot.py`` stands for."""

from __future__ import annotations

import json
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial
from node_trials import TRIES, configuration, plant_action, result_of, spin_until
from processes import PATIENCE, Running, running
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RclParameter
from sensor_msgs.msg import JointState

from impact_rs_analysis.measure.analyze import ExperimentSet, analyze_campaign
from impact_rs_cli.main import main
from impact_rs_ros.graph import Graph
from impact_rs_ros.node_processes import NodeProcesses
from impact_rs_ros.qos import AWAITED, STREAM
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.spec import TrialSpec

ROBOT = Path(__file__).resolve().parents[1] / "shared" / "effort_robot.py"
TRIAL = ["cat_food", "case_2"]
SLOW = (  # refusals on a busy machine; the last ones until a new watchdog is heard, and a killed one forgotten
    "is the robot running?",
    " states in 3 s",
    "a state every ",
    "not armed: the watchdog brakes",
    "not armed: the watchdog passes no torques on",
    "there is no watchdog, and",
    "one that was killed is forgotten",
)
READY = 60.0  # s, until such a robot is armed; never reached on a machine that works
SCALES = (0.8, 1.0, 1.2)  # of the predicted velocity; the zero crossing of the net feedback needs three
TRACKER = (1.2, -0.7, 0.3, 0.05, -0.03, 2.1)  # m and rad, where motion capture has its frame
PATIENT: dict[
    str, Any
] = {  # a shared machine keeps no times; what is late is tested with a clock of its own, in test_cell_trial.py
    "joints": "fr3_joint{number}",
    "mocap": True,
    "mocap_frame": "tracker",
    **dict(zip(("mocap_x", "mocap_y", "mocap_z", "mocap_roll", "mocap_pitch", "mocap_yaw"), TRACKER, strict=True)),
    "use_sim_time": True,
    "watchdog": False,
    "watchdog_timeout": 5.0,
    "state_timeout": 5.0,
    "answer_timeout": 5.0,
    "late_torque_share": 1.0,
    "arm_jitter_limit": 5.0,
}
EXPERIMENT = "/**/experiment: {ros__parameters: {service_timeout: 60.0, progress_timeout: 10.0, finish_timeout: 20.0}}"


def command_of(module: str, values: dict[str, Any]) -> list[str]:
    """How a node is started with these parameters."""
    words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", f"impact_rs_ros.{module}", "--ros-args", *words]


class Cell:
    """Our nodes with the cell among them, and what stands for the robot, as each test wants it."""

    def __init__(self, graph: Graph, environment: dict[str, str], root: Path) -> None:
        self.graph = graph
        self.environment = environment
        self.root = root
        self._trials = 0
        self._robot = False

    @contextmanager
    def robot(self, *options: str) -> Iterator[Running]:
        """A robot that is switched on."""
        command = [sys.executable, str(ROBOT), "push", *TRIAL, "--tracker", *map(str, TRACKER), *options]
        with running(command, self.environment) as robot:
            robot.line("ready")
            self._robot = True
            yield robot
            self._robot = False

    @contextmanager
    def parameter(self, name: str, value: float) -> Iterator[None]:
        """A cell with another value of a parameter."""
        for other in (value, PATIENT[name]):
            request = SetParameters.Request(parameters=[RclParameter(name, value=other).to_parameter_msg()])
            assert self.graph.call(SetParameters, "cell/set_parameters", request).results[0].successful
            if other == value:
                yield

    def run(self, scale: float = 1.0, folder: Path | None = None) -> RunTrial.Result:
        """One trial; a robot that is switched on is asked for until it is found, and fast enough."""
        deadline = time.monotonic() + READY
        while True:
            result = self._run(scale, folder)
            slow = any(reason in result.message for reason in SLOW)
            if not (self._robot and slow and time.monotonic() < deadline):
                return result

    def _run(self, scale: float, folder: Path | None) -> RunTrial.Result:
        goal = RunTrial.Goal(scenario="push", object_name="cat_food", case_name="2", velocity_scale=scale)
        self._trials += 1
        goal.output_directory = str(folder or self.root / str(self._trials))
        return self.graph.call_trial(goal)


@pytest.fixture(scope="module")
def cell(domain_ids: Callable[[], int], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    domain_id, root = domain_ids(), tmp_path_factory.mktemp("cell")
    environment = {"ROS_DOMAIN_ID": str(domain_id)}
    patient = root / "experiment.yaml"
    patient.write_text(EXPERIMENT)
    with (
        running(command_of("cell_node", PATIENT), environment),
        Graph.running("push", domain_id, parameters=patient, root=root, without=["plant"]) as graph,
    ):
        yield Cell(graph, environment, root)


@dataclass(frozen=True)
class Pushes:
    """A push at each of three post-impact references, and what came of one more without moving the arm back."""

    folder: Path
    results: list[RunTrial.Result]
    again: RunTrial.Result

    @property
    def bags(self) -> list[TrialBag]:
        """Of the trials."""
        return [TrialBag.open(Path(result.bag_path)) for result in self.results]


@pytest.fixture(scope="module")
def pushes(cell: Cell) -> Pushes:
    """Pushes of a robot that is put to the start before each, and a last one where it is not."""
    folder = cell.root / "pushes"
    results = []
    for scale in SCALES:
        with cell.robot():
            results.append(cell.run(scale, folder))
            if scale == SCALES[-1]:
                again = cell.run()
    return Pushes(folder, results, again)


@pytest.mark.slow
def test_a_push_goes_through_a_robot_of_ros2_control(pushes: Pushes) -> None:
    assert [(result.outcome, result.message) for result in pushes.results] == [("OK", "")] * len(SCALES)
    for bag in pushes.bags:
        assert bag.counts[topics.joint_states("arm")] == bag.counts[topics.joint_command("arm")] == 1801
        assert bag.counts[topics.controller_state("arm")] == 1801
        assert bag.origin_ns > 0  # stamps are of the robot's clock
        assert bag.joints(topics.joint_states("arm")).time[0] == 0.0
        assert bag.missing == [topics.motor_states("arm"), topics.TRUTH]  # no robot tells these
    # The arm was held where the trial left it, and nobody has moved it back.
    assert pushes.again.outcome == "ABORTED"
    assert "rad from where the trial starts, start_tolerance is 0.01 rad; move the arm to [" in pushes.again.message


@pytest.mark.slow
def test_the_arm_is_still_until_it_is_led_so_its_weight_is_carried_once(pushes: Pushes) -> None:
    """Carried twice or not at all, some 30 N m would move it; the brake, M dq / 0.1 s, would let that reach rad/s."""
    for bag in pushes.bags:
        plan, scenario = bag.info.spec.plan, bag.info.spec.scenario
        arm = bag.joints(topics.joint_states("arm"))
        still = arm.time < scenario.timing.nominal_impact - scenario.timing.approach
        placed = 5.0 * scenario.scatter.joint_position  # rad, by whoever moved it to the start
        assert np.abs(arm.position[still] - plan.arms["arm"].initial).max() < placed + 1e-4
        assert np.abs(arm.velocity[still]).max() < 6.0 * scenario.sensors.joint_velocity_noise


@pytest.mark.slow
def test_the_impact_is_detected_when_the_pad_gets_there(pushes: Pushes) -> None:
    for result, bag in zip(pushes.results, pushes.bags, strict=True):
        assert bag.counts[topics.impact_event("arm")] == 1
        scenario = bag.info.spec.scenario
        # The box stands up to three standard deviations off, and the force needs some ms to rise and to be observed.
        early = 3.0 * scenario.scatter.object_position / abs(bag.info.ante_velocity)
        assert -early < result.detected_time - bag.info.nominal_impact_time < early + 0.005  # s


@pytest.mark.slow
def test_poses_of_a_tracker_frame_are_recorded_in_world_at_their_time(pushes: Pushes) -> None:
    for bag in pushes.bags:
        seen, scene = bag.poses(topics.OBJECT_POSE), bag.info.spec.scene
        steps = np.diff(seen.time) / scene.scenario.sensors.object_period
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
        assert np.median(steps) == pytest.approx(1.0)  # the cell listens best effort: one may get lost
        assert seen.time[-1] > bag.info.duration - 0.02  # s, though they come late
        off = seen.position[0] - scene.object.position
        assert np.abs(off[:2]).max() < 4.0 * scene.scenario.scatter.object_position
        assert abs(off[2]) < 6.0 * scene.scenario.sensors.object_position_noise
        assert abs(seen.quaternion[0] @ [0.0, 0.0, 0.0, 1.0]) > np.cos(4.0 * scene.scenario.scatter.object_yaw / 2.0)
        assert seen.position[-1, 1] < seen.position[0, 1] - 0.1  # m, pushed along -y
        assert np.ptp(seen.position[:, 2]) < 1e-3  # m, on its support


@pytest.fixture(scope="module")
def found(pushes: Pushes) -> ExperimentSet:
    """What ``analyze`` says of the pushes: measured velocity after the impact, and predictions."""
    (found,) = analyze_campaign(pushes.folder).sets
    assert len(found.trials) == len(SCALES)
    return found


@pytest.mark.slow
def test_the_velocity_after_impact_lies_between_none_and_all_of_the_motors(found: ExperimentSet) -> None:
    """Between B = 0 and B_rho: not less than none of the motors takes part in the impact, and not more than all.

    How much does is up to torque loop and elasticity, and MuJoCo's robot has its own. No model is fitted, and where the
    box stands, how smooth its support is and the noise are one draw of the scenario's scatter.
    """
    none, whole = (abs(found.predictions[model].velocity) for model in ("zero", "rotor"))
    assert none < found.estimate < whole


@pytest.mark.slow
def test_bags_of_the_cell_are_compared_as_those_of_a_laboratory(
    pushes: Pushes, found: ExperimentSet, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot tells no motor states, so an experiment file says what the bags are.

    Replayed from the measured state with the recorded torque, the model goes through the impact as MuJoCo's robot did:
    nearer than half of what motors without inertia would change.
    """
    experiment = pushes.folder / "experiment.yaml"
    experiment.write_text("scenario: push\nmapping: impact_rs\n")
    (pushes.folder / "runs.csv").write_text(f"bag,object,kind\n{pushes.bags[1].path.name},cat_food,hit\n")
    assert main(["compare", str(pushes.folder), "--experiment", str(experiment), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["trials"], document["skipped"]) == (1, [])
    (velocity,) = [
        signal
        for signal in document["levels"]["trial"]["signals"]
        if (signal["phase"], signal["signal"]) == ("impact", "end-effector velocity")
    ]
    reduced, none = (found.predictions[model].velocity for model in ("reduced", "zero"))
    assert velocity["error"] < abs(reduced - none) / 2.0  # m/s


@pytest.mark.slow
def test_nothing_is_armed_without_a_robot_that_is_ready(cell: Cell) -> None:
    nobody = cell.run()
    with cell.robot("--offset", "0.02"):
        elsewhere = cell.run()
    with cell.robot(), cell.parameter("arm_jitter_limit", 1e-6):
        unsteady = cell.run()
    assert {result.outcome for result in (nobody, elsewhere, unsteady)} == {"ABORTED"}
    assert "no state of fr3_joint1 and the other joints on /joint_states: is the robot running?" in nobody.message
    assert re.search(r" of arm is \+0\.020\d rad from where the trial starts", elsewhere.message)  # offset and scatter
    assert "not armed: states come with a jitter of " in unsteady.message
    assert unsteady.message.endswith(" ms, arm_jitter_limit is 0.001 ms")


@pytest.mark.slow
def test_a_robot_with_nonsense_or_no_states_ends_the_trial(cell: Cell) -> None:
    with cell.robot("--nan-after", "600"):
        nonsense = cell.run()
    with cell.robot("--silent-after", "600"), cell.parameter("state_timeout", 1.0):
        silent = cell.run()
    assert {nonsense.outcome, silent.outcome} == {"ABORTED"}
    assert "position of fr3_joint1 is nan" in nonsense.message
    assert "no state of the robot for 1.0" in silent.message


@dataclass(frozen=True)
class LedCell:
    """A cell, its watchdog and its robot as processes, and who leads the arm; neither recorder nor experiment."""

    graph: Graph  # of the controller alone, or of no node
    processes: dict[str, Running]  # of the others
    scenario: str

    def run(self) -> str:
        """Why a trial ended, which began as soon as the robot could be armed; empty: all is well, or the cell died."""
        plan = TrialSpec.of(load_scenario(self.scenario), *TRIAL).plan
        request = configuration(plan, attempt=0)  # asked again it is no repeated request: it has an answer of its own
        request.ros_time = True
        if self.graph.processes:
            answer = self.graph.call(ConfigureTrial, "controller/configure_trial", request)
            assert answer.success, answer.message
        else:
            self._lead(plan.scene.models["arm"])
        deadline = time.monotonic() + READY
        while not (armed := self.graph.call(ConfigureTrial, "plant/configure_trial", request, READY)).success:
            assert any(reason in armed.message for reason in SLOW) and time.monotonic() < deadline, armed.message
        client = plant_action(self.graph)
        spin_until(self.graph, client.server_is_ready, "the cell runs no trial")
        cell = self.processes["cell"].process
        goal = result_of(self.graph, client.send_goal_async(RunTrial.Goal()))
        over = goal.get_result_async()
        spin_until(self.graph, lambda: over.done() or cell.poll() is not None, "it does not end")
        return over.result().result.message if over.done() else ""

    def _lead(self, model: RobotModel) -> None:
        """In the place of a controller: the weight, and a torque that turns the arm at its base faster and faster."""
        node = self.graph.node
        publisher = node.create_publisher(JointState, topics.joint_command("arm"), STREAM)

        def answer(state: JointState) -> None:
            torque = model.gravity_torque(np.array(state.position))
            torque[0] += 3.0  # N m, some 3 rad/s^2
            publisher.publish(JointState(header=state.header, name=state.name, effort=torque.tolist()))

        node.create_subscription(JointState, topics.joint_states("arm"), answer, AWAITED)

    def comes_to_rest(self, victim: str, states: int) -> None:
        """After a kill while it moved, within so many states of the robot, which waits for no one."""
        killed, after = self.processes["robot"].line("killed at"), self.processes["robot"].line(" after ")
        assert self.processes[victim].process.wait(PATIENCE) == -signal.SIGKILL
        assert float(killed.split()[2]) > 0.1  # rad/s
        others = {name: one.end(signal.SIGTERM)[1] for name, one in self.processes.items() if name != victim}
        assert after.startswith("at rest after "), others
        assert int(after.split()[3]) < states


@contextmanager
def led_cell(
    domain: int, folder: Path, scenario: str, *robot: object, ours: Sequence[str] = (), **changes: float
) -> Iterator[LedCell]:
    """All of it, ready, with these nodes of ours; among the options of the robot names stand for process ids."""
    environment = {"ROS_DOMAIN_ID": str(domain)}
    own = PATIENT | {"mocap": False, "watchdog": True, "scenario": scenario} | changes
    of_both = {name: own[name] for name in ("joints", "use_sim_time", "state_timeout", "scenario")}
    nodes = NodeProcesses.of(scenario, folder, domain)
    graph = Graph(nodes, ours, domain)
    with ExitStack() as stack:
        stack.callback(graph.close)
        stack.callback(nodes.stop)
        processes: dict[str, Running] = {}
        for kind, values in (("cell", own), ("watchdog", of_both)):
            processes[kind] = stack.enter_context(running(command_of(f"{kind}_node", values), environment))
        words = [str(processes[word].process.pid if word in processes else word) for word in robot]
        command = [sys.executable, str(ROBOT), scenario, *TRIAL, *words]
        processes["robot"] = stack.enter_context(running(command, environment))
        graph.start()
        processes["watchdog"].line("ready: serves")
        processes["robot"].line("ready")
        yield LedCell(graph, processes, scenario)


@pytest.fixture
def push_500(tmp_path: Path) -> str:
    """A push of a robot of 500 Hz, as UR's are: half the messages."""
    path = tmp_path / "push_500.yaml"
    path.write_text(load_scenario("push").with_settings({"timing.control_period": 0.002}).model_dump_json())
    return str(path)


@pytest.mark.timeout(300)  # s, of which a machine whose cores are all busy may need two thirds
def test_after_a_cell_is_killed_in_a_trial_the_watchdog_brakes_the_arm(
    domain_ids: Callable[[], int], tmp_path: Path, push_500: str
) -> None:
    """The effort controller keeps the torque of that moment; nothing but another process can take it away."""
    killed = "--kill", "cell", "--kill-after", 50, "--slower", 5
    with led_cell(domain_ids(), tmp_path, push_500, *killed) as cell:
        assert cell.run() == "", "it was not killed in the trial"
        cell.comes_to_rest("cell", 750)


@pytest.mark.slow
def test_after_a_watchdog_is_killed_in_a_trial_the_cell_brakes_the_arm_itself(
    domain_ids: Callable[[], int], tmp_path: Path, push_500: str
) -> None:
    """Whoever is left of the two brakes the arm: its effort controller keeps the last torque for ever."""
    killed = "--kill", "watchdog", "--kill-after", 50, "--slower", 5
    for _ in range(TRIES):
        with led_cell(domain_ids(), tmp_path, push_500, *killed, watchdog_timeout=0.1) as cell:
            reason = cell.run()
            if "the watchdog brakes the arms" in reason:
                continue  # on a busy machine it has braked a cell that was late, before it was killed
            assert "the watchdog passed no torques on for 0.1 s" in reason
            cell.comes_to_rest("watchdog", 1750)
            return
    pytest.fail("the watchdog braked before it was killed")


@pytest.mark.slow
@pytest.mark.parametrize(("after", "stall"), [(100, 30), (290, 100), (450, 500)])
def test_a_cell_that_stalls_in_a_trial_and_comes_back_makes_one_stream_with_its_watchdog(
    domain_ids: Callable[[], int], tmp_path: Path, after: int, stall: int
) -> None:
    """SIGSTOP before, at and after the impact, for so many milliseconds of the robot's time.

    Each torque that reaches the robot, whoever decided it, follows the one before within the rate of a period.
    """
    for _ in range(TRIES):
        with led_cell(domain_ids(), tmp_path, "push", "--stall", "cell", after, stall, ours=["controller"]) as cell:
            reason = cell.run()
            print(reason)  # shown where the robot never gets as far as the stall
            begun, merged = (cell.processes["robot"].line(text) for text in ("stalled at", "merged: at most"))
        if float(begun.split()[2]) > 0.1:  # rad/s
            break  # else a busy machine has starved the cell before, and the watchdog has braked
    if braked := stall > 50:  # command_timeout; the limits of this cell are patient, and a busy machine adds to 30 ms
        assert reason
    assert float(begun.split()[2]) > 0.1, reason  # rad/s
    largest, late, speed = (float(merged.split()[index]) for index in (3, 6, 10))
    assert 0.0 < largest <= 1000.0 * 0.001 + 1e-6, reason  # torque_rate_limit by the period
    assert late > 100
    assert speed < 0.02 or not braked  # rad/s
