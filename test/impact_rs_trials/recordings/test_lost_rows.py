# SPDX-License-Identifier: Apache-2.0
"""Rows that were lost while the timestamps go on: found by the motion of all joints, with number and place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from joint_recordings import Columns, write_npz
from slender_arm import mapping_of, slender_arm, swung

from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_trials.recordings.checks.lost_rows import without_lost_rows
from impact_rs_trials.recordings.mapping import Mapping, SignalName
from impact_rs_trials.recordings.readers.series import Series
from impact_rs_trials.recordings.recording import read_recordings

PERIOD, ROWS = 0.008, 3000  # s, of the controller of an arm; its encoders are read to 1e-5 rad
TIME = PERIOD * np.arange(ROWS)
OMEGA, PHASE = np.array([1.1, 1.7, 2.3, 0.8, 3.1, 2.9]), np.arange(6)
RESOLUTION = 1e-5  # rad


def motion(time: np.ndarray, noise: float = 2e-5) -> tuple[np.ndarray, np.ndarray]:
    """Positions with noise, and velocities [rad, rad/s]."""
    draws = np.random.default_rng(1).normal(0.0, 1.0, (2, time.size, 6))
    position = 0.5 * np.sin(OMEGA * time[:, None] + PHASE) + noise * draws[0]
    return np.round(position / RESOLUTION) * RESOLUTION, 0.5 * OMEGA * np.cos(OMEGA * time[:, None] + PHASE) + 0.01 * (
        draws[1]
    )


def series(true: np.ndarray, stamps: np.ndarray, with_velocity: bool) -> dict[SignalName, Series]:
    position, velocity = motion(true)
    found: dict[SignalName, Series] = {"position": Series("q", stamps, position)}
    return found | ({"velocity": Series("dq", stamps, velocity)} if with_velocity else {})


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("lost", [1, 3, 40])
def test_lost_rows_are_counted_where_they_are(with_velocity: bool, lost: int) -> None:
    """Kills a place that is a row off, a number that is one off, and an encoder that loses its rows alone."""
    kept = np.ones(ROWS, dtype=bool)
    for first in (500, 1300, 1309):
        kept[first : first + lost] = lost == 40 and first == 1309  # two places near each other, but for the long loss
    stamps = TIME[: kept.sum()]
    found, remarks = without_lost_rows(series(TIME[kept], stamps, with_velocity))
    late = found["position"].time - TIME[kept]
    assert np.max(np.abs(late)) < (0.05 * 80 * PERIOD if lost == 40 else 1e-6)  # a motion bends over 0.3 s
    (remark,) = remarks
    assert " rows were lost while timestamps went on: at t = 3.992 s (" in remark
    if lost < 40:
        assert remark.startswith(f"{3 * lost} rows were lost") and f"t = 3.992 s ({lost})" in remark


@pytest.mark.parametrize("with_velocity", [True, False])
def test_periods_in_which_no_time_passed_are_taken_out(with_velocity: bool) -> None:
    """Kills a correction of one sign alone."""
    stamps = TIME + 2.0 * PERIOD * (np.arange(ROWS) >= 700)
    found, (remark,) = without_lost_rows(series(TIME, stamps, with_velocity))
    np.testing.assert_allclose(found["position"].time, TIME, atol=1e-6)
    assert remark.startswith("2 periods are in the timestamps in which no time passed: at t = 5.592 s (2)")


def with_glitch(position: np.ndarray) -> np.ndarray:
    """One encoder slips, another shows a single wrong sample."""
    changed = position.copy()
    changed[800:, 2] += 0.02
    changed[1500, 4] += 0.02
    return changed


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("case", ["right", "gaps", "jitter", "glitch", "held", "rest"])
def test_whole_recordings_have_no_lost_rows(case: str, with_velocity: bool) -> None:
    """Kills evidence of one joint, of jitter, of repeated rows, of a stop, and of gaps that the timestamps show."""
    true = TIME
    if case == "jitter":
        true = TIME + 0.15 * PERIOD * np.random.default_rng(2).normal(size=ROWS)
    if case == "gaps":
        true = np.delete(TIME, [400, 900, 901, *range(1500, 1600)])
    stamps = TIME if case == "jitter" else true
    signals = series(true, stamps, with_velocity)
    if case == "glitch":
        signals["position"] = Series("q", stamps, with_glitch(signals["position"].values))
    if case == "held":  # every third row is written late, with the numbers of the row before it
        rows = np.arange(ROWS) - (np.arange(ROWS) % 7 == 3)
        signals = {name: Series(one.label, stamps, one.values[rows]) for name, one in signals.items()}
    if case == "rest":  # braking within 60 ms, standing, and starting again
        rows = np.concatenate((np.arange(1000), np.full(300, 1000), np.arange(1000, ROWS - 300)))
        smooth = np.convolve(np.pad(rows.astype(float), 4, mode="edge"), np.ones(9) / 9.0, "valid")
        signals = series(PERIOD * smooth, stamps, with_velocity=False)
    found, remarks = without_lost_rows(signals)
    assert remarks == []
    assert np.array_equal(found["position"].time, stamps)


def lost_log(folder: Path, with_velocity: bool) -> tuple[Mapping, Columns]:
    """24 s of a slender arm with friction, of which rows are lost at three places."""
    mapping = mapping_of(folder, slender_arm(("revolute",) * 3))
    if not with_velocity:
        signals = {name: own for name, own in mapping.signals.items() if name != "velocity"}
        mapping = mapping.model_copy(update={"signals": signals})
    log = swung(mapping, {}, seconds=24.0)
    kept = np.ones(log["time"].size, dtype=bool)
    for first, count in ((250, 2), (500, 3), (900, 30)):
        kept[first : first + count] = False
    return mapping, {name: own[kept] for name, own in log.items()} | {"time": log["time"][: kept.sum()]}


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_model_is_not_blamed_for_lost_rows(with_velocity: bool, tmp_path: Path) -> None:
    """Kills accelerations over a step of the positions: the residual is noise, 0.02 sqrt(3 / 25) N m."""
    mapping, log = lost_log(tmp_path, with_velocity)
    runs = read_recordings(write_npz(tmp_path / "run.npz", log), mapping)
    assert len(runs) == 2  # the long loss cuts
    assert any("rows were lost while" in remark and "t = 4.980 s (2)" in remark for remark in runs[0].remarks)
    source = RecordingSource.of(runs, mapping, Model(name="nominal"))
    torques = source.residuals[:, :3]
    assert np.sqrt(np.mean(np.square(torques))) < 0.02
