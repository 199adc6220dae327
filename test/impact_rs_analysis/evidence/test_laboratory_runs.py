"""Runs of a laboratory: commands on the clock of the states, and the jump in the measured state."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.evidence.ante_impact import ante_impact_state, obliqueness, problem_of
from impact_rs_analysis.evidence.laboratory import _shifted, command_offset
from impact_rs_analysis.evidence.measured import MeasuredRun
from impact_rs_analysis.evidence.run import Run
from impact_rs_analysis.evidence.runs import Runs
from impact_rs_analysis.measure.laboratory import jumps_of
from impact_rs_sim.effects import library
from impact_rs_sim.impact_map import compute_impact_map
from impact_rs_sim.impact_map.contacts import SUPPORT, meetings

from .conftest import COULOMB


def stamped(run: Run, late: float) -> Run:
    """The run with commands whose stamps are so much too late [s]."""
    return replace(run, command_time={name: time + late for name, time in run.command_time.items()})


@pytest.mark.parametrize("late", [-0.0003, 0.0, 0.0003])
def test_an_offset_below_half_a_period_is_found_also_with_friction(free: Run, rubbed: Run, late: float) -> None:
    """The torque loop itself is half of its period, 0.125 ms, early."""
    for run in (free, rubbed):
        assert command_offset([stamped(run, late)]) == pytest.approx(-late, abs=1.5e-4)
    assert COULOMB.max() > 0.2


def test_a_delay_of_milliseconds_is_left_for_the_diagnosis(free: Run) -> None:
    assert command_offset([stamped(free, -0.003)]) == 0.0
    assert command_offset([replace(free, command={}, command_time={})]) == 0.0


def test_a_shift_brings_commands_to_where_they_act(free: Run) -> None:
    late = stamped(free, 0.0003)
    again = _shifted(late, command_offset([late]))
    name = next(iter(free.command_time))
    assert np.max(np.abs(again.command_time[name] - free.command_time[name])) < 2e-4


def test_the_state_before_the_impact_is_that_at_the_impact_and_not_milliseconds_before(hit: Run) -> None:
    measured = MeasuredRun.of(hit)
    state = ante_impact_state(measured)["arm"]
    twist = measured.setup.physics.robot_model("arm").jacobian(state.position) @ state.velocity
    assert twist[1] == pytest.approx(-0.7, abs=0.005)
    assert obliqueness(measured) < 0.01


def test_pad_and_object_touch_in_what_the_map_is_asked(hit: Run) -> None:
    measured = MeasuredRun.of(hit)
    apart = replace(
        measured,
        setup=replace(
            measured.setup,
            windows=tuple(
                replace(window, object=replace(window.object, position=window.object.position + [0.0, -0.004, 0.0]))
                for window in measured.setup.windows
            ),
        ),
    )
    physics = hit.physics
    for run in (measured, apart):
        problem = problem_of(run, physics)
        placements = {"arm": physics.robot_model("arm").placement(problem.arms["arm"].position)}
        gaps = [m.separation for m in meetings(physics, problem.object, placements) if m.partner != SUPPORT]
        assert gaps == pytest.approx([0.0], abs=1e-9)
    result = compute_impact_map(problem_of(measured, physics), "pinocchio")
    assert -0.6 < result.end_effector_twist["arm"][1] < -0.4


def test_what_the_map_is_asked_about_a_tilted_pad_is_the_pad_face_on_face(hit: Run) -> None:
    """It turns the wrist until the pad is parallel, and not the flange, which is askew then."""
    physics = library()["pad_tilt"].apply_vector(hit.physics, np.array([0.03, -0.02]))
    problem = problem_of(MeasuredRun.of(hit), physics)
    hand = physics.robot_model("arm").placement(problem.arms["arm"].position)
    np.testing.assert_allclose(
        (hand * physics.arms["arm"].end_effector.pad_placement).rotation[:, 2], [0, -1, 0], atol=1e-6
    )
    straight = problem_of(MeasuredRun.of(hit), hit.physics)
    results = [compute_impact_map(one, "pinocchio") for one in (problem, straight)]
    speeds = [result.end_effector_twist["arm"][1] for result in results]
    assert speeds[0] == pytest.approx(speeds[1], rel=0.05)


def test_without_anything_hidden_the_reduced_inertia_predicts_the_speed_after_the_impact(hit: Run) -> None:
    """Frictionless plant: some tenths of a percent to some percent, and nearer than without the torque loop."""
    light = replace(hit, spec=None)
    found = jumps_of(Runs.of(Path("here"), [MeasuredRun.of(light), MeasuredRun.of(light)]))
    assert abs(found.errors["reduced"]) < 4.0
    assert found.errors["reduced"] < found.errors["rotor"]
    (jump,) = found.jumps
    assert jump.before == pytest.approx(0.7, abs=0.01)
    assert 0.4 < jump.after < 0.6
    assert jump.interval == pytest.approx((jump.after, jump.after))
