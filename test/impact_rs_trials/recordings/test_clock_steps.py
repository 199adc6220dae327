# SPDX-License-Identifier: Apache-2.0
"""A clock that is set back in the middle of a recording cuts it, and its parts are read as they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from joint_recordings import write_csv, write_npz

from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.mapping import load_mapping
from impact_rs_trials.recordings.readers.clock_steps import MAX_STEPS_BACK, PAUSE_S, without_steps_back
from impact_rs_trials.recordings.readers.guesses import clock_of
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.recording import ARM, read_recordings

PLAIN = load_mapping("joint_state").model_copy(update={"low_pass": 10.0})
ROWS, PHASE = np.arange(400), np.arange(7)
TIME = 0.01 * ROWS  # s
POSITION = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.5]) + 0.3 * np.sin(2.0 * TIME[:, None] + PHASE)
VELOCITY = 0.6 * np.cos(2.0 * TIME[:, None] + PHASE)
MODEL = RobotModel(PLAIN.facts, PLAIN.end_effector.build())
TORQUE = np.array([MODEL.gravity_torque(q) for q in POSITION])
COLUMNS = {"time": TIME, "position": POSITION, "velocity": VELOCITY, "effort": TORQUE}


@pytest.mark.parametrize("write", [write_npz, write_csv])
@pytest.mark.parametrize("back", [0.03, 0.5, 30.0])
def test_a_recording_is_cut_where_the_clock_was_set_back(
    tmp_path: Path, write: Callable[..., Path], back: float
) -> None:
    """Kills a piece that begins a sample late, an offset of another sign, and a step that is not named."""
    path = write(
        tmp_path / ("a.npz" if write is write_npz else "a.csv"), COLUMNS | {"time": TIME - back * (ROWS >= 220)}
    )
    first, second = read_recordings(path, PLAIN)
    assert first.signals.time.size == 220 and second.signals.time.size == 180
    joined = np.concatenate([run.signals.arms[ARM].position for run in (first, second)])
    np.testing.assert_allclose(joined, POSITION, atol=1e-12)
    assert second.signals.time[0] - first.signals.time[-1] == pytest.approx(PAUSE_S + 0.01)
    for run in (first, second):
        assert any(f"the clock was set back by {back:.4g} s at t = 2.190 s" in remark for remark in run.remarks)


def test_velocities_that_are_derivatives_know_nothing_of_the_other_side_of_a_step(tmp_path: Path) -> None:
    """Kills a difference over the step, which is off by 30 %."""
    path = write_npz(tmp_path / "a.npz", COLUMNS | {"time": TIME - 0.5 * (ROWS >= 220)})
    signals = {name: own for name, own in PLAIN.signals.items() if name != "velocity"}
    pieces = read_recordings(path, PLAIN.model_copy(update={"signals": signals}))
    found = np.concatenate([run.signals.arms[ARM].velocity for run in pieces])
    inside = (ROWS % 399 > 1) & ~np.isin(ROWS, (218, 219, 220, 221))
    np.testing.assert_allclose(found[inside], VELOCITY[inside], atol=1e-4)
    np.testing.assert_allclose(found[218:222], VELOCITY[218:222], atol=0.02)


def test_signals_whose_clocks_disagree_about_steps_are_left_as_they_are() -> None:
    straight, once = Series("a", TIME, POSITION), Series("b", TIME - (ROWS >= 50), POSITION)
    often = Series("c", TIME - 1.0 * (ROWS // 20), POSITION)
    assert often.time.size // 20 > MAX_STEPS_BACK
    for pair in ({"position": straight, "torque": once}, {"position": often, "torque": often}):
        found, remarks = without_steps_back(pair)
        assert remarks == [] and all(found[name] is pair[name] for name in pair)


@pytest.mark.parametrize(("jitter", "found"), [(0.05, True), (0.4, False)])
def test_an_unnamed_clock_that_was_set_back_is_known_by_its_even_steps(jitter: float, found: bool) -> None:
    """A quantity that rises and falls once is no clock. Kills an evenness that no column or every column has."""
    random = np.random.default_rng(5)
    rising = np.cumsum(0.01 * (1.0 + jitter * random.uniform(-1.0, 1.0, 400)))
    rising[250:] -= 1.0
    guess = clock_of({"a": rising, "b": random.normal(size=400)})
    assert (guess is not None) == found
    assert guess is None or guess.value == "a"
