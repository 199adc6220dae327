# SPDX-License-Identifier: Apache-2.0
"""The page of speed limits says how fast an arm may hit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from reports import LIMIT

from impact_rs_analysis.report.speed_limits import write_limits
from impact_rs_sim.scenarios.scenario_files import load_scenario


def test_a_scene_without_a_limit_is_said_in_words(tmp_path: Path) -> None:
    """Kills: a least limit of inf m/s in the answer of the page."""
    unlimited = replace(LIMIT, speed=math.inf, median=math.inf, by_kind=dict.fromkeys(LIMIT.by_kind, math.inf))
    text = write_limits(load_scenario("push"), [unlimited], [], tmp_path).read_text(encoding="utf-8")
    assert "1 of 1 planned hits are allowed. The least is more than 10 m/s (parcel, case_1; joint 3 torque)." in text
