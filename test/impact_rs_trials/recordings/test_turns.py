# SPDX-License-Identifier: Apache-2.0
"""Angles within one turn, as controllers of Kinova report them, are continuous once they are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from impact_rs_sim.robots.robot import load_facts
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.readers.sources import read_series
from impact_rs_trials.recordings.readers.turns import unwrapped

FACTS = load_facts("kinova_gen3")
TIME = np.arange(0.0, 4.0, 0.01)
# Joint 1 passes zero, joint 2 stays below it, joint 3 passes half a turn, which its limits allow.
Q = np.column_stack(
    [0.5 * np.sin(TIME), 0.2 * np.sin(TIME) - 0.5, 3.0 + 0.3 * np.sin(TIME), *4 * [0.3 + 0.2 * np.sin(TIME)]]
)


def series_of(values: np.ndarray) -> Series:
    return Series("column 'q'", TIME, values)


@pytest.mark.parametrize("first", [0.0, -np.pi])
def test_angles_are_continuous_and_within_the_limits(first: float) -> None:
    """Kills: jumps by a full turn are left in, and a joint a turn above its limits without a jump stays there."""
    read = unwrapped(series_of(np.mod(Q - first, 2.0 * np.pi) + first), FACTS)
    np.testing.assert_allclose(read.values, Q, atol=1e-12)
    assert len(read.remarks) == 1 and "within one turn: unwrapped" in read.remarks[0]


def test_other_jumps_and_continuous_angles_stay_as_they_are() -> None:
    """Kills: any jump is rounded to a full turn, and a fault is read as a wrapped angle."""
    faulty = Q.copy()
    faulty[100, 0] += 4.5
    for values in (Q, faulty, np.rad2deg(Q)):
        signal = series_of(values)
        assert unwrapped(signal, FACTS) is signal


def test_a_motion_of_more_than_half_a_turn_in_a_gap_is_no_jump() -> None:
    """Eight seconds without a sample, in which joint 1 goes from -2 to 2 rad. Kills: any step above half a turn."""
    values = Q.copy()
    values[:, 0] = np.where(TIME < 2.0, -2.0, 2.0)
    series = Series("column 'q'", TIME + 8.0 * (TIME >= 2.0), values)
    assert unwrapped(series, FACTS) is series


def test_blank_cells_do_not_hide_a_jump() -> None:
    """Kills: a column with a missing number is not unwrapped."""
    wrapped = np.mod(Q, 2.0 * np.pi)
    wrapped[50, 0] = np.nan
    np.testing.assert_allclose(np.delete(unwrapped(series_of(wrapped), FACTS).values, 50, 0), np.delete(Q, 50, 0))


def test_a_mapping_reads_positions_and_targets_in_the_same_turn(tmp_path: Path) -> None:
    """Kills: desired positions in the turn of the limits, a full turn away from the positions of an endless joint."""
    targets = Q + 0.02
    q = np.column_stack([Q[:, :2], Q[:, 2] - 2.9, Q[:, 3:]])
    targets = np.column_stack([targets[:, :2], q[:, 2] - 0.25, targets[:, 3:]])
    names = [f"{signal}_{joint}" for signal in ("q", "d") for joint in range(1, 8)]
    rows = np.column_stack([TIME, np.mod(np.rad2deg(np.column_stack([q, targets])), 360.0)])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=",".join(["time", *names]), comments="")
    mapping = Mapping.model_validate(
        {
            "description": "angles within one turn",
            "robot": "kinova_gen3",
            "joints": [f"joint{number}" for number in range(1, 8)],
            "torque_measured_at": "motor",
            "servo": {"kp": [10.0] * 7},
            "signals": {
                "position": {"column": "q_{joint}", "unit": "deg"},
                "q_desired": {"column": "d_{joint}", "unit": "deg"},
            },
        }
    )
    read = read_series(tmp_path / "a.csv", mapping, ("position", "velocity", "q_desired"), ())
    np.testing.assert_allclose(read["position"].values, q, atol=1e-6)
    np.testing.assert_allclose(read["q_desired"].values, targets, atol=1e-6)
    assert np.abs(read["velocity"].values).max() < 1.0
