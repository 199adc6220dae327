# SPDX-License-Identifier: Apache-2.0
"""A node logs the lines of ``docs/nodes.md``: that it is ready, how a trial ended, what is wrong."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from impact_rs.action import RunCampaign, RunTrial
from impact_rs.msg import ImpactProblem
from impact_rs.srv import PredictImpact
from node_trials import begun, beside, result_of
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from impact_rs_ros.graph import Graph, GraphError, run_trial
from impact_rs_ros.node_processes import NODES
from impact_rs_ros.qos import STREAM
from impact_rs_sim.paths import config_directory
from impact_rs_trials.bags import topics
from impact_rs_trials.campaign import make_manifest

TABLE = Path(__file__).resolve().parents[2] / "docs" / "nodes.md"
WRITTEN = re.compile(r"\[(INFO|WARN|ERROR|FATAL)\] \[[\d.]+\] \[(\w+)\]: (.*)")
WORTH = {"INFO", "WARN", "ERROR", "FATAL"}


def documented() -> list[tuple[str, str, str]]:
    """Rows of the table: node, level, and line with ``<...>`` where it differs; a row for each of its nodes."""
    rows = []
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 4 and cells[1] in WORTH:
            nodes = NODES if cells[0] == "each" else re.findall(r"`(\w+)`", cells[0])
            rows += [(node, cells[1], cells[2].strip("`")) for node in nodes]
    return rows


def fits(row: tuple[str, str, str], line: tuple[str, str, str]) -> bool:
    """Whether a line that was written, as level, node and text, is that of a row."""
    pattern = "".join(".+" if part.startswith("<") else re.escape(part) for part in re.split(r"(<[^>]+>)", row[2]))
    return (line[1], line[0]) == row[:2] and re.fullmatch(pattern, line[2]) is not None


@pytest.mark.slow
def test_the_table_of_log_lines_is_what_the_nodes_write(
    domain_ids: Callable[[], int], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    domain_id = domain_ids()
    shipped = (config_directory() / "scenarios" / "push.yaml").read_text(encoding="utf-8")
    light = tmp_path / "light.yaml"
    light.write_text(shipped.replace("facts: franka_fer", "facts: franka_fr3"), encoding="utf-8")
    manifest = make_manifest("push", ["cat_food"], ["1"], [1.0], trials=1, seed=7)
    (key,) = manifest.keys
    runs_away = make_manifest(str(light), ["cat_food"], ["2"], [1.0], trials=1)
    goal = {"scenario": "push", "object_name": "cat_food", "case_name": "1", "velocity_scale": 1.0}
    with Graph.running("push", domain_id, quiet=False, root=tmp_path) as graph:
        assert run_trial(graph, tmp_path, manifest, key).outcome == "OK"
        assert run_trial(graph, tmp_path / "light", runs_away, runs_away.keys[0]).outcome == "DIVERGED"
        with pytest.raises(GraphError, match="rejected the trial"):
            graph.call_trial(RunTrial.Goal(scenario="push", object_name="dog_food", case_name="1"))
        assert "exists already" in graph.call_trial(RunTrial.Goal(**goal, seed=7, output_directory=".")).message
        _campaign_and_another_goal(graph, tmp_path, goal)
        _cancelled(graph, goal)
        for name in ("cat_food", "dog_food"):
            problem = ImpactProblem(scenario="push", object_name=name, case_name="1")
            graph.call(PredictImpact, "impact_map/predict", PredictImpact.Request(problem=problem), 60.0)
        unheard = graph.node.create_publisher(JointState, topics.motor_states("arm"), qos_profile_sensor_data)
        graph.call_trial(RunTrial.Goal(**goal, output_directory="unheard"))
        graph.node.destroy_publisher(unheard)
        _with_bytes_that_are_no_torque(graph, RunTrial.Goal(**goal, output_directory="bytes"))
        bad = RunTrial.Goal(**goal, output_directory="bad", plant_model="effects: [")
        with pytest.raises(GraphError, match="rejected the trial"):
            graph.call_trial(bad)
    lines = [found.groups() for found in WRITTEN.finditer("".join(capfd.readouterr()))]
    refused = subprocess.run(
        [sys.executable, "-m", "impact_rs_ros.plant_node", "--ros-args", "-p", "scenario:=nonsense"],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain_id)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    lines += [found.groups() for found in WRITTEN.finditer(refused.stderr)]
    lines = [line for line in lines if line[1] in NODES]  # and not what rclpy says in their inboxes
    rows = [row for row in documented() if row[0] != "cell"]  # which is no part of this graph
    strangers = [line for line in lines if not any(fits(row, line) for row in rows)]
    assert not strangers, f"docs/nodes.md does not have: {strangers}"
    seen = {row[1:] for row in rows if any(fits(row, line) for line in lines)}  # by whichever node
    assert not [row for row in rows if row[1:] not in seen], "docs/nodes.md has what nobody writes"

    told = [f"[{node}] {text}" for _, node, text in lines]
    own = f"/plant/configure_trial, /plant/finish_trial, /plant/run_trial in ROS domain {domain_id}, namespace /; "
    assert [line for line in told if line.startswith(f"[plant] ready: serves {own}scenario push, config_root ")]
    assert sum(f"push/{key.name}: OK" in line for line in told if str(tmp_path / "campaign") not in line) >= 4
    assert [line for line in told if line.startswith("[recorder]") and line.endswith(f"in {tmp_path / key.name}")]
    (line,) = (line for line in told if "dog_food" in line and line.startswith("[experiment]"))
    assert line.endswith("did you mean 'cat_food'?")


def _campaign_and_another_goal(graph: Graph, directory: Path, goal: dict[str, object]) -> None:
    request = RunCampaign.Goal(scenario="push", objects=["cat_food"], cases=["1"], velocity_scales=[1.0], trials=1)
    request.output_directory = str(directory / "campaign")
    accepted = begun(graph, graph.run_campaign, request)
    another = RunTrial.Goal(**goal, output_directory="another")
    assert not result_of(graph, graph.run_trial.send_goal_async(another)).accepted
    assert result_of(graph, accepted.get_result_async()).result.success


def _cancelled(graph: Graph, goal: dict[str, object]) -> None:
    accepted = begun(graph, graph.run_trial, RunTrial.Goal(**goal, output_directory="cancelled"))
    accepted.cancel_goal_async()
    assert result_of(graph, accepted.get_result_async()).result.outcome == "ABORTED"


def _with_bytes_that_are_no_torque(graph: Graph, goal: RunTrial.Goal) -> None:
    with beside(graph, "controller") as other:
        publisher = other.create_publisher(JointState, topics.joint_command("arm"), STREAM)
        result = graph.call_trial(goal, lambda _: publisher.publish(b"\0\1\0\0abc"))
    assert result.outcome == "OK", result.message
    assert "plant: " in result.message
