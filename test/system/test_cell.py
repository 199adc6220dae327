# SPDX-License-Identifier: Apache-2.0
"""The cell node between our nodes and a robot of ros2_control, which ``effort_robot.py`` stands for."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from impact_rs.action import RunTrial
from processes import running
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RclParameter

from impact_rs_ros.graph import Graph
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

ROBOT = Path(__file__).resolve().parents[1] / "shared" / "effort_robot.py"
TRIAL = ["push", "cat_food", "case_2"]
PATIENT: dict[
    str, Any
] = {  # a shared machine keeps no times; what is late is tested with a clock of its own, in test_cell_trial.py
    "joints": "fr3_joint{number}",
    "mocap": True,
    "use_sim_time": True,
    "state_timeout": 5.0,
    "answer_timeout": 5.0,
    "arm_jitter_limit": 5.0,
}


class Cell:
    """Our nodes with the cell among them, and what stands for the robot, as each test wants it."""

    def __init__(self, graph: Graph, environment: dict[str, str], root: Path) -> None:
        self.graph = graph
        self._environment = environment
        self._root = root
        self._trials = 0
        self._robot = False

    @contextmanager
    def robot(self, *options: str) -> Iterator[None]:
        """A robot that is switched on."""
        with running([sys.executable, str(ROBOT), *TRIAL, *options], self._environment) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            self._robot = True
            yield
            self._robot = False

    @contextmanager
    def parameter(self, name: str, value: bool | float) -> Iterator[None]:
        """A cell with another value of a parameter."""
        for wanted in (value, PATIENT[name]):
            message = RclParameter(name, value=wanted).to_parameter_msg()
            request = SetParameters.Request(parameters=[message])
            assert self.graph.call(SetParameters, "plant/set_parameters", request).results[0].successful
            if wanted is value:
                yield

    def run(self) -> RunTrial.Result:
        """One trial; a robot that is switched on may have to be found first."""
        for _ in range(5):
            result = self._run()
            if not self._robot or "is the robot running?" not in result.message:
                break
        return result

    def _run(self) -> RunTrial.Result:
        goal = RunTrial.Goal(scenario="push", object_name="cat_food", case_name="2", velocity_scale=1.0)
        self._trials += 1
        goal.output_directory = str(self._root / str(self._trials))
        return self.graph.call_trial(goal)


@pytest.fixture(scope="module")
def cell(domain_ids: Callable[[], int], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    domain_id, root = domain_ids(), tmp_path_factory.mktemp("cell")
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain_id)}
    values = [word for name, value in PATIENT.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", "impact_rs_ros.cell_node", "--ros-args", *values]
    with running(command, environment), Graph.running("push", domain_id, root=root, without=["plant"]) as graph:
        yield Cell(graph, environment, root)


# First: no trial before it holds the arm.
def test_a_robot_that_was_taken_for_one_that_compensates_gravity_falls_as_soon_as_it_is_held(cell: Cell) -> None:
    with cell.robot("--no-gravity"):
        falling = cell.run()
    assert falling.outcome == "ABORTED"
    assert "not armed: arm moves at " in falling.message
    assert "while it was held; this node believes that the robot adds gravity" in falling.message


def test_a_push_goes_through_a_robot_of_ros2_control(cell: Cell) -> None:
    with cell.robot():
        result = cell.run()
        again = cell.run()
    assert (result.outcome, result.message) == ("OK", "")
    bag = TrialBag.open(Path(result.bag_path))
    assert bag.counts[topics.joint_states("arm")] == bag.counts[topics.joint_command("arm")] == 1801
    pushed = bag.poses(topics.OBJECT_POSE)
    assert pushed.position[-1, 1] < pushed.position[0, 1] - 0.1  # m, along -y
    assert np.ptp(pushed.position[:, 2]) < 1e-3  # m
    # The arm was held where the trial left it, and nobody has moved it back.
    assert again.outcome == "ABORTED"
    assert "rad from where the trial starts, start_tolerance is 0.01 rad; move the arm to [" in again.message


def test_nothing_is_armed_without_a_robot_that_is_ready(cell: Cell) -> None:
    nobody = cell.run()
    with cell.robot("--offset", "0.02"):
        elsewhere = cell.run()
    with cell.robot(), cell.parameter("arm_jitter_limit", 1e-6):
        unsteady = cell.run()
    assert {result.outcome for result in (nobody, elsewhere, unsteady)} == {"ABORTED"}
    assert "nobody tells the joints 'fr3_joint{number}' on /joint_states: is the robot running?" in nobody.message
    assert " of arm is +0.0200 rad from where the trial starts" in elsewhere.message
    assert "not armed: states come with a jitter of " in unsteady.message
    assert unsteady.message.endswith(" ms, arm_jitter_limit is 0.001 ms")


def test_a_robot_that_tells_nonsense_or_nothing_ends_the_trial_with_the_reason(cell: Cell) -> None:
    with cell.robot("--nan-after", "600"):
        nonsense = cell.run()
    with cell.robot("--silent-after", "600"), cell.parameter("state_timeout", 1.0):
        silent = cell.run()
    assert {nonsense.outcome, silent.outcome} == {"ABORTED"}
    assert "position of fr3_joint1 is nan" in nonsense.message
    assert "no state of the robot for 1.0" in silent.message
