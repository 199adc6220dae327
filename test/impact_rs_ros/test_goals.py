# SPDX-License-Identifier: Apache-2.0
"""What a goal may name; one that cannot be run is rejected at once with a reason in the log."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from impact_rs.action import RunCampaign, RunTrial
from rclpy.action import GoalResponse

from impact_rs_ros.experiment_node import ExperimentNode
from impact_rs_ros.roots import below, scenario_below
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.spec import TrialSpec

TRIAL = {"object_name": "cat_food", "case_name": "2"}
NO_EFFECT = "name: x\neffects: [{name: gremlins, parameters: {}}]"


class Offline(ExperimentNode):
    """An experiment node without a middleware, for the scenario ``push``."""

    def __init__(self, root: Path) -> None:
        self.lines: list[str] = []
        self.described: list[Any] = []
        self.log = SimpleNamespace(error=self.lines.append, warning=self.lines.append)  # type: ignore[assignment]
        self._busy, self._cancelling = threading.Lock(), threading.Event()
        self._parameters = {"scenario": "push", "config_root": "", "data_root": str(root)}
        self._session = SimpleNamespace(describe=self.described.append)  # type: ignore[assignment]

    def parameter(self, name: str) -> Any:
        return self._parameters[name]


@pytest.mark.parametrize(
    "goal", [RunTrial.Goal(**TRIAL), RunTrial.Goal(**TRIAL, velocity_scale=0.8), RunCampaign.Goal()]
)
def test_a_goal_that_can_be_run_is_accepted(goal: Any, tmp_path: Path) -> None:
    assert Offline(tmp_path)._on_goal(goal) == GoalResponse.ACCEPT


@pytest.mark.parametrize(
    ("goal", "why"),
    [
        (RunTrial.Goal(**TRIAL | {"object_name": "dog_food"}), "dog_food"),
        (RunTrial.Goal(**TRIAL | {"case_name": "9"}), "9"),
        (RunTrial.Goal(**TRIAL, scenario="pushh"), "pushh"),
        (RunTrial.Goal(**TRIAL, scenario="../../x.yaml"), "config_root"),
        (RunTrial.Goal(**TRIAL, velocity_scale=0.0), "velocity scale = 0.0"),
        (RunTrial.Goal(**TRIAL, motor_inertia="heavy"), "heavy"),
        (RunTrial.Goal(**TRIAL, output_directory="/elsewhere"), "data_root"),
        (RunTrial.Goal(**TRIAL, plant_model="effects: ["), "plant_model"),
        (RunTrial.Goal(**TRIAL, plant_model=NO_EFFECT), "gremlins"),
        (RunCampaign.Goal(objects=["dog_food"]), "dog_food"),
        (RunCampaign.Goal(velocity_scales=[-1.0]), "velocity scale = -1.0"),
        (RunCampaign.Goal(motor_inertia="heavy"), "heavy"),
        (RunCampaign.Goal(output_directory="/elsewhere"), "data_root"),
    ],
)
def test_a_goal_that_cannot_be_run_is_rejected_with_a_reason(goal: Any, why: str, tmp_path: Path) -> None:
    node = Offline(tmp_path)
    assert node._on_goal(goal) == GoalResponse.REJECT
    (line,) = node.lines
    assert line.startswith("goal rejected: ")
    assert why in line


def test_the_scene_is_described_before_the_first_trial(tmp_path: Path) -> None:
    node, spec = Offline(tmp_path), TrialSpec.of(load_scenario("push"), "juice", "case_1")
    node.rehearse(spec)
    assert node.described == [spec.plan]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "root"
    (folder / "deep").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (folder / "out").symlink_to(tmp_path / "elsewhere")
    (folder / "self").symlink_to(folder / "self")
    return folder


@pytest.mark.parametrize("path", ["", "deep", "deep/new/newer", "deep/../other", "./x"])
def test_what_lies_below_the_root_is_found_from_there(root: Path, path: str) -> None:
    assert below(path, str(root), "output_directory", "data_root") == Path(os.path.normpath(root / path))
    assert below(str(root / path), str(root), "output_directory", "data_root").is_relative_to(root)


@pytest.mark.parametrize(
    "path", ["..", "../elsewhere", "/etc", "out/x", "deep/../../x", "../root2", "a\0b", "self/x/y"]
)
def test_what_lies_elsewhere_is_refused_links_followed(root: Path, path: str) -> None:
    with pytest.raises(InputError, match="output_directory"):
        found = below(path, str(root), "output_directory", "data_root")
        assert path == "self/x/y" and found.is_relative_to(root)  # newer systems resolve it to itself
        raise InputError("expected", key="output_directory")


def test_without_a_root_it_is_the_working_directory(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(root)
    assert below("deep", "", "output_directory", "data_root") == root / "deep"
    with pytest.raises(InputError, match=f"below {root} \\(parameter data_root\\)"):
        below("..", "", "output_directory", "data_root")


def test_a_scenario_is_shipped_or_the_nodes_own_or_below_the_root(root: Path) -> None:
    own = str(root.parent / "mine.yaml")
    assert scenario_below("", own, str(root)) == own
    assert scenario_below("grab", own, str(root)) == "grab"
    assert scenario_below(str(root / ".." / "mine.yaml"), own, str(root)) == own
    assert scenario_below("deep/a.yaml", own, str(root)) == str(root / "deep" / "a.yaml")
    for name in ("../other.yaml", "/etc/passwd", "../../config/scenarios/push", "push/../../x"):
        with pytest.raises(InputError, match="config_root"):
            scenario_below(name, own, str(root))
