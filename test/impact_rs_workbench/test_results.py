# SPDX-License-Identifier: Apache-2.0
"""What a click on a heat map opens."""

from __future__ import annotations

import pytest

from impact_rs_analysis.evidence.levels import Cell
from impact_rs_workbench.results import nearest_signal


@pytest.mark.parametrize(
    ("signal", "index", "expected"),
    [
        ("object velocity", "y", "object velocity y"),
        ("object rotation", "z", "object yaw rate"),
        ("joint velocity jump", "joint3", "velocity of joint 3"),
        ("motor torque balance", "left.joint5", "left: torque of joint 5"),
        ("contact force", "z", "end-effector velocity z"),
        ("end-effector rotation", "right.x", "right: end-effector velocity x"),
    ],
)
def test_a_cell_opens_the_signal_it_is_about(signal: str, index: str, expected: str) -> None:
    cell = Cell.model_construct(signal=signal, index=index)
    assert nearest_signal(cell) == expected
