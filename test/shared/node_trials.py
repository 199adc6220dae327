# SPDX-License-Identifier: Apache-2.0
"""Trials through running nodes: goals, waiting, what happens in mid-trial, and nodes beside the graph."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial
from processes import until
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.context import Context
from rclpy.node import Node

from impact_msgs_py.conversions import pose_to_message
from impact_rs_control.plan import TrialPlan
from impact_rs_ros.graph import Graph, run_trial
from impact_rs_ros.message_types import RosidlTypes
from impact_rs_ros.trial_session import starting_joints
from impact_rs_sim.model import Model
from impact_rs_sim.rotations import quaternion_of
from impact_rs_trials.bags.messages import MessageMaker
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.trial_info import TrialInfo, TrialKey
from impact_rs_trials.campaign import Manifest, make_manifest

TRIES = 3
Feedback = Callable[[RunTrial.Impl.FeedbackMessage], None]


def goal(folder: Path, **changes: Any) -> RunTrial.Goal:
    """A push of the parcel."""
    values = {"scenario": "push", "object_name": "parcel", "case_name": "1", "velocity_scale": 1.0, "seed": 5}
    return RunTrial.Goal(**values | {"output_directory": str(folder)} | changes)


def one_trial(scenario: str = "push", seed: int = 0) -> Manifest:
    """A campaign of one push of the parcel."""
    return make_manifest(scenario, ["parcel"], ["1"], [1.0], trials=1, seed=seed)


def whole_trial(graph: Graph, folder: Path, manifest: Manifest, plant_model: Model | None = None) -> TrialBag:
    """A trial through nodes of which none is lost; one that a busy machine starves counts as frozen, and is excused."""
    for number in range(TRIES):
        place = folder / f"try_{number}"
        report = run_trial(graph, place, manifest, manifest.keys[0], plant_model)
        if " froze" not in report.message:
            break
    assert (report.outcome, report.message) == ("OK", ""), report.trace
    return TrialBag.open(place / manifest.keys[0].name)


def spin_until(graph: Graph, condition: Callable[[], Any], what: str = "nothing comes") -> Any:
    """What the condition returns once it is true."""
    return until(condition, lambda: graph.spin(0.05), what)


def result_of(graph: Graph, future: Any) -> Any:
    """Result of a future of the graph's node."""
    spin_until(graph, future.done, "no answer")
    return future.result()


def begun(graph: Graph, client: ActionClient, request: Any) -> ClientGoalHandle:
    """A goal that is accepted and has told how far it is."""
    heard: list[object] = []
    accepted = result_of(graph, client.send_goal_async(request, feedback_callback=heard.append))
    spin_until(graph, lambda: heard, "no feedback")
    return accepted


def plant_action(graph: Graph) -> ActionClient:
    """Client of the action by which plant or cell runs a trial."""
    client: ActionClient = graph._actions["plant"]["plant/run_trial"]
    return client


def in_trial(act: Callable[[], object], after: float = 0.2) -> Feedback:
    """Feedback that acts once, when the trial time is beyond ``after`` [s]."""
    done: list[object] = []

    def feedback(message: RunTrial.Impl.FeedbackMessage) -> None:
        if message.feedback.time > after and not done:
            done.append(act() or True)

    return feedback


def configuration(plan: TrialPlan, bag: Path = Path(), attempt: int = 7) -> ConfigureTrial.Request:
    """What the experiment node asks plant, controller and recorder to prepare for."""
    placed, scene = plan.scene.object, plan.scene
    info = TrialInfo.of(plan, TrialKey(scene.object_name, scene.case_name, 1.0, 0), 3, "nodes")
    return ConfigureTrial.Request(
        attempt=attempt,
        trial=MessageMaker(RosidlTypes(), plan).trial_info(info),
        bag_path=str(bag),
        start=starting_joints(plan),
        object_pose=pose_to_message(np.concatenate((placed.position, quaternion_of(placed.rotation)))),
    )


@contextmanager
def participant(domain: int, name: str, namespace: str = "", **options: Any) -> Iterator[Node]:
    """A node of another program in a ROS domain; nothing runs it."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        node = rclpy.create_node(name, context=context, namespace=namespace, **options)
        yield node
        node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


@contextmanager
def beside(graph: Graph, name: str, namespace: str = "") -> Iterator[Node]:
    """A node of another program, in the process of the test; nothing runs it."""
    other = rclpy.create_node(name, namespace=namespace, context=graph.node.context, start_parameter_services=False)
    try:
        yield other
    finally:
        other.destroy_node()
