# SPDX-License-Identifier: Apache-2.0
"""A node of somebody else in the plant's place: waited for, told what is wrong with it, and good for whole trials."""

from __future__ import annotations

import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial
from node_trials import participant, spin_until
from processes import running
from rclpy.action import ActionServer
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from impact_rs_cli.main import main
from impact_rs_ros.graph import Graph
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "foreign_plant.py"
WAITING = "waiting for a plant: /plant/configure_trial, /plant/finish_trial, the action /plant/run_trial; for "
TRIAL = "cat_food__case_2__s1.000__r0"
pytestmark = pytest.mark.slow


@contextmanager
def silent_plant(domain_id: int, best_effort: bool = False) -> Iterator[list[ConfigureTrial.Request]]:
    """A node that serves what a plant serves and agrees to everything; it publishes nothing, or not reliably.

    Hands out what it is asked to configure.
    """
    asked: list[ConfigureTrial.Request] = []

    def agree(request: object, response: object) -> object:
        if isinstance(request, ConfigureTrial.Request):
            asked.append(request)
        response.success = True
        return response

    with participant(domain_id, "plant") as node:
        for name, kind in {"configure_trial": ConfigureTrial, "finish_trial": FinishTrial}.items():
            node.create_service(kind, f"~/{name}", agree)
        runs = ActionServer(node, RunTrial, "~/run_trial", lambda goal: RunTrial.Result())
        if best_effort:
            node.create_publisher(JointState, topics.joint_states("arm"), qos_profile_sensor_data)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        over = threading.Event()

        def spin() -> None:
            while not over.is_set():
                executor.spin_once(timeout_sec=0.05)

        thread = threading.Thread(target=spin)
        thread.start()
        try:
            yield asked
        finally:
            over.set()
            thread.join()
            runs.destroy()
            executor.shutdown()


def test_a_campaign_runs_with_the_example_in_the_place_of_our_plant(
    domain_ids: Callable[[], int], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The campaign waits for it, its bags are whole without what it does not tell, and are analysed."""
    domain = {"ROS_DOMAIN_ID": str(domain_ids())}
    runs = tmp_path / "runs"
    scope = ["--objects", "cat_food", "--cases", "2", "--scales", "0.8", "1.0", "1.2", "--trials", "1"]
    command = [sys.executable, "-m", "impact_rs_cli.main", "campaign", "push", "-o", str(runs), *scope]
    with running([*command, "--via", "nodes", "--without", "plant"], domain) as campaign:
        campaign.line(WAITING)
        with running([sys.executable, str(EXAMPLE)], domain) as plant:
            code, printed = campaign.end()
            _, by_plant = plant.end(signal.SIGTERM)
    assert code == 0, printed
    assert "3 of 3 trials are there (3 OK)" in printed
    assert by_plant.count("push/cat_food, case_2: OK after 1.800 s") >= 3
    assert "Traceback" not in by_plant

    bag = TrialBag.open(runs / TRIAL)
    assert bag.missing == ["/arm/motor_states", "/truth"]
    assert bag.metadata["missing"] == "/arm/motor_states, /truth"
    assert bag.counts[topics.joint_states("arm")] == bag.counts[topics.joint_command("arm")] == 1801
    assert (bag.counts[topics.OBJECT_POSE], bag.counts[topics.TF]) == (451, 91)
    pushed = bag.poses(topics.OBJECT_POSE)
    assert pushed.position[-1, 1] < pushed.position[0, 1] - 0.1  # m, along -y
    assert np.ptp(pushed.position[:, 2]) < 1e-3  # m, it stays on its support

    capfd.readouterr()
    assert main(["analyze", str(runs), "-o", str(tmp_path / "report"), "--json"]) == 0
    (measured,) = json.loads(capfd.readouterr().out)["sets"]
    assert abs(measured["predictions"]["reduced"]["error_percent"]) < 3.0  # it carries B_theta and hides nothing
    assert main(["compare", str(runs), "-o", str(tmp_path / "compare"), "--jobs", "1"]) != 0
    assert "no /arm/motor_states, which the replay of a model starts from" in capfd.readouterr().err


def test_a_graph_waits_for_a_foreign_node_and_says_what_is_wrong_with_it(
    domain_ids: Callable[[], int], tmp_path: Path
) -> None:
    domain_id = domain_ids()
    goal = RunTrial.Goal(
        scenario="push", object_name="cat_food", case_name="2", velocity_scale=1.0, output_directory=str(tmp_path)
    )
    asked: list[list[ConfigureTrial.Request]] = []
    with (
        ExitStack() as provided,
        Graph.running(
            "push",
            domain_id,
            root=tmp_path,
            without=["plant"],
            notify=lambda line: asked.append(provided.enter_context(silent_plant(domain_id))),
        ) as graph,
    ):
        assert list(graph.processes) == ["impact_map", "controller", "recorder", "experiment"]
        unpublished = graph.call_trial(goal)
        request = asked[0][0]
        with silent_plant(domain_id, best_effort=True):
            states = topics.joint_states("arm")
            spin_until(graph, lambda: graph.node.count_publishers(states), "the publisher is not discovered")
            unheard = graph.call_trial(goal)
    assert (unpublished.success, unpublished.outcome) == (False, "ABORTED")
    assert unpublished.message == "recorder: no publisher of /arm/joint_states; are plant and controller running?"
    assert unheard.message.startswith(
        "recorder: /arm/joint_states: published, but not received; is the publisher's QoS"
    )
    assert list(request.start.name) == [f"arm_joint{number}" for number in range(1, 8)]
    assert len(request.start.position) == 7
    assert request.object_pose.position.z == pytest.approx(0.405 + 0.16 / 2)
