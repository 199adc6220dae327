# SPDX-License-Identifier: Apache-2.0
"""Tracks show every signal once, on one clock, with the sides not swapped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from impact_rs_analysis.evidence import tracks
from impact_rs_analysis.evidence.aligned import AlignedRun, ArmTrack, Track
from impact_rs_analysis.evidence.torque_balance import ARM
from impact_rs_analysis.evidence.tracks import tracks_of_recordings, tracks_of_runs
from impact_rs_sim.robot import UNITS, load_facts

TIME = np.linspace(0.0, 1.8, 19)
UR5E = load_facts("ur5e")
SECOND = 10  # row in which the second window begins


@pytest.fixture(autouse=True)
def nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here nothing is seen in 3D, which would need a whole scene."""
    for name in ("animation_of_run", "animation_of_motion"):
        monkeypatch.setattr(tracks, name, lambda *_: None)


def arm(level: float) -> ArmTrack:
    """An arm of six joints whose signals are numbered by column above a level."""

    def columns(count: int) -> np.ndarray:
        return level + np.tile(np.arange(float(count)), (TIME.size, 1))

    return ArmTrack(columns(6), columns(6), columns(6), columns(3), columns(4), columns(6))


def aligned(*, hit: bool, arms: tuple[str, ...] = ("arm",), condition: str = "push/juice/case_2") -> AlignedRun:
    """A run that moves along y."""
    run = SimpleNamespace(
        condition=condition if hit else "excite/none/slow",
        place=("push" if hit else "excite", "", ""),
        hit=hit,
        axis=1,
        impacts={"arm": 0.9} if hit else {},
        setup=SimpleNamespace(physics=SimpleNamespace(arms=dict.fromkeys(arms, SimpleNamespace(facts=UR5E)))),
    )
    seen = 1.0 if hit else np.nan
    sides = [
        Track({name: arm(level) for name in arms}, np.full((TIME.size, 3), seen * level), np.full(TIME.size, seen))
        for level in (100.0, 200.0)
    ]
    return AlignedRun(run, TIME, (0, SECOND), *sides)  # type: ignore[arg-type]


def test_runs_with_an_impact_come_first_and_say_when() -> None:
    free, hit = aligned(hit=False), aligned(hit=True, condition="push/juice/case_2/s1.20")
    first, second = tracks_of_runs([free, hit])
    assert (first.label, first.impact) == ("juice, case_2, s1.20", 0.9)
    assert (second.label, second.impact) == ("none, slow", None)
    assert "object yaw" in [signal.name for signal in first.signals]
    assert "object yaw" not in [signal.name for signal in second.signals]


def test_conditions_of_a_laboratory_have_no_scenario_in_front() -> None:
    (found,) = tracks_of_runs([aligned(hit=True, condition="juice/pose_a/fast")])
    assert found.label == "juice, pose_a, fast"


def test_signals_have_their_column_their_unit_and_their_side() -> None:
    (found,) = tracks_of_runs([aligned(hit=True)])
    signals = {signal.name: signal for signal in found.signals}
    assert len(signals) == len(found.signals) == 3 + 6 + 6 + 6
    assert found.signals[0].name == "end-effector velocity y"  # the direction of motion is what one wants to see
    rows = np.isfinite(found.time)
    for name, unit, column in (
        ("end-effector velocity y", "m/s", 1),
        ("end-effector velocity x", "m/s", 0),
        ("torque of joint 6", "N m", 5),
        ("velocity of joint 1", "rad/s", 0),
    ):
        assert signals[name].unit == unit
        assert signals[name].measured[rows] == pytest.approx(100.0 + column)
        assert signals[name].predicted[rows] == pytest.approx(200.0 + column)


def test_velocities_of_the_object_are_the_slope_of_its_position_window_by_window() -> None:
    run = aligned(hit=True)
    moving = replace(run.measured, object_position=run.measured.object_position + np.outer(TIME, [3.0, -2.0, 0.0]))
    moving.object_position[SECOND:] += 5.0  # a step between two windows is no speed
    (found,) = tracks_of_runs([replace(run, measured=moving)])
    signals = {signal.name: signal for signal in found.signals}
    rows = np.isfinite(found.time)
    for axis, speed in (("x", 3.0), ("y", -2.0)):
        assert signals[f"object velocity {axis}"].unit == "m/s"
        assert signals[f"object velocity {axis}"].measured[rows] == pytest.approx(speed)
        assert signals[f"object velocity {axis}"].predicted[rows] == pytest.approx(0.0)
    assert signals["object yaw rate"].unit == "rad/s"


def test_a_line_breaks_between_two_windows_and_nowhere_else() -> None:
    (found,) = tracks_of_runs([aligned(hit=True)])
    for values in (found.time, *(signal.measured for signal in found.signals)):
        assert values.size == TIME.size + 1
        assert np.flatnonzero(np.isnan(values)).tolist() == [SECOND]
    assert np.delete(found.time, SECOND) == pytest.approx(TIME)


def test_of_two_arms_every_signal_says_whose_it_is() -> None:
    (found,) = tracks_of_runs([aligned(hit=True, arms=("left", "right"))])
    names = [signal.name for signal in found.signals]
    assert len(set(names)) == len(names) == 2 * 15 + 6
    assert "left: torque of joint 1" in names
    assert "right: torque of joint 1" in names


def test_recordings_are_cut_where_one_ends_and_the_next_begins() -> None:
    motions = [
        SimpleNamespace(time=np.arange(6.0), kept=slice(1, 5)),
        SimpleNamespace(time=np.arange(5.0), kept=slice(1, 4)),
    ]
    recorded = np.arange(14.0).reshape(7, 2)
    rail, turn = UNITS["prismatic"], UNITS["revolute"]
    source = SimpleNamespace(
        motions=motions,
        recordings=[SimpleNamespace(path=Path("a.db3")), SimpleNamespace(path=Path("b.db3"))],
        balance=SimpleNamespace(recorded=recorded),
        physics=SimpleNamespace(arms={ARM: SimpleNamespace(facts=SimpleNamespace(units=(rail, turn)))}),
    )
    rest = np.ones((7, 2))
    found = tracks_of_recordings(source, {"the model": rest, "with friction": 0.0 * rest})  # type: ignore[arg-type]
    assert [track.label for track in found] == [
        "a.db3, the model",
        "b.db3, the model",
        "a.db3, with friction",
        "b.db3, with friction",
    ]
    second = found[1]
    assert second.time == pytest.approx([1.0, 2.0, 3.0])
    assert second.signals[1].name == "torque of joint 2"
    assert [signal.unit for signal in second.signals] == ["N", "N m"]
    assert second.signals[1].measured == pytest.approx(recorded[4:, 1])
    assert second.signals[1].measured - second.signals[1].predicted == pytest.approx(1.0)
    assert found[3].signals[0].predicted == pytest.approx(recorded[4:, 0])
