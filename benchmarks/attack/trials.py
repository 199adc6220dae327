# SPDX-License-Identifier: Apache-2.0
"""The trial that attacks on nodes disturb, and that must be OK afterwards."""

from __future__ import annotations

from pathlib import Path

from impact_rs.action import RunTrial


def trial_in(folder: Path) -> RunTrial.Goal:
    """A push, with its bag in a folder."""
    goal = RunTrial.Goal(scenario="push", object_name="juice", case_name="case_1", velocity_scale=1.0)
    goal.output_directory = str(folder)
    return goal
