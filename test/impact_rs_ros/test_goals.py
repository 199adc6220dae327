# SPDX-License-Identifier: Apache-2.0
"""A goal that cannot be run is rejected at once, and the log says why; it is not accepted and aborted."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from impact_rs.action import RunCampaign, RunTrial
from rclpy.action import GoalResponse

from impact_rs_ros.experiment_node import ExperimentNode


class Offline(ExperimentNode):
    """An experiment node without a middleware, for the scenario ``push``."""

    def __init__(self, root: Path) -> None:
        self.told: list[str] = []
        self.log = SimpleNamespace(error=self.told.append, warning=self.told.append)  # type: ignore[assignment]
        self._busy, self._cancelling = threading.Lock(), threading.Event()
        self._parameters = {"scenario": "push", "config_root": "", "data_root": str(root)}

    def parameter(self, name: str) -> Any:
        return self._parameters[name]


TRIAL = {"object_name": "cat_food", "case_name": "2"}


@pytest.mark.parametrize(
    "goal", [RunTrial.Goal(**TRIAL), RunTrial.Goal(**TRIAL, velocity_scale=0.8), RunCampaign.Goal()]
)
def test_what_can_be_run_is_accepted(goal: Any, tmp_path: Path) -> None:
    assert Offline(tmp_path)._on_goal(goal) == GoalResponse.ACCEPT


@pytest.mark.parametrize(
    ("goal", "why"),
    [
        (RunTrial.Goal(**TRIAL | {"object_name": "dog_food"}), "dog_food"),
        (RunTrial.Goal(**TRIAL | {"case_name": "9"}), "9"),
        (RunTrial.Goal(**TRIAL, scenario="pushh"), "pushh"),
        (RunTrial.Goal(**TRIAL, velocity_scale=0.0), "velocity scale = 0.0"),
        (RunTrial.Goal(**TRIAL, motor_inertia="heavy"), "heavy"),
        (RunTrial.Goal(**TRIAL, output_directory="/elsewhere"), "data_root"),
        (RunTrial.Goal(**TRIAL, plant_model="effects: ["), "plant_model"),
        (RunCampaign.Goal(objects=["dog_food"]), "dog_food"),
        (RunCampaign.Goal(velocity_scales=[-1.0]), "velocity scale = -1.0"),
        (RunCampaign.Goal(motor_inertia="heavy"), "heavy"),
        (RunCampaign.Goal(output_directory="/elsewhere"), "data_root"),
    ],
)
def test_what_cannot_be_run_is_rejected_with_a_reason(goal: Any, why: str, tmp_path: Path) -> None:
    node = Offline(tmp_path)
    assert node._on_goal(goal) == GoalResponse.REJECT
    (line,) = node.told
    assert line.startswith("goal rejected: ")
    assert why in line
