# SPDX-License-Identifier: Apache-2.0
"""Rollouts of motions whose truth is known in closed form, or from another simulator.

An arm of one joint about a vertical axis has the constant inertia 0.11 kg m^2 and no weight: tau = 0.11 ddq.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_recordings import Columns, write_npz
from slender_arm import FLAT, mapping_of, slender_arm, swung, with_effects

from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.rollouts import (
    FreeMotion,
    RolloutDocument,
    free_of_contact,
    rolled_out,
    rollouts_of,
    starts_of,
    without,
)
from impact_rs_analysis.evidence.sources.recording_source import RecordingSource
from impact_rs_sim.model import Model
from impact_rs_sim.physics import Physics
from impact_rs_sim.readings import ArmReadings
from impact_rs_trials.recordings.mapping import Mapping
from impact_rs_trials.recordings.recording import ARM, read_recordings
from impact_rs_trials.runs import Run

from .conftest import COULOMB, with_friction

INERTIA = 0.11  # kg m^2
TIME = np.arange(0.0, 24.0, 0.01)


def flat(folder: Path) -> Mapping:
    return mapping_of(folder, slender_arm(("revolute",), FLAT), torque_measured_at="motor")


def swinging(torque_error: float = 0.0, friction: float = 0.0) -> Columns:
    """A slow swing by hand; friction of a torque measured before it."""
    omega = 2.0 * np.pi * 0.31
    q, dq, ddq = (
        values[:, None]
        for values in (
            0.8 * np.sin(omega * TIME),
            0.8 * omega * np.cos(omega * TIME),
            -0.8 * omega**2 * np.sin(omega * TIME),
        )
    )
    effort = INERTIA * ddq + torque_error + friction * np.tanh(dq / 0.005)
    return {"time": TIME, "position": q, "velocity": dq, "effort": effort}


def motion_of(columns: Columns, physics: Physics, **changed: object) -> FreeMotion:
    motion = FreeMotion(
        arm=ARM,
        physics=physics,
        time=columns["time"],
        position=columns["position"],
        velocity=columns["velocity"],
        acceleration=np.gradient(columns["velocity"], columns["time"], axis=0, edge_order=2),
        torque_time=columns["time"],
        torque=columns["effort"],
        begin=0.0,
        end=float(columns["time"][-1]),
    )
    return replace(motion, **changed)


def document_of(motion: FreeMotion, physics: Physics | None = None) -> RolloutDocument:
    found = rollouts_of([motion], None if physics is None else [physics])
    assert found is not None
    return found.document()


def test_a_constant_torque_error_grows_with_the_square_of_the_time_and_is_found_again(tmp_path: Path) -> None:
    """dq = dtau t^2 / (2 I): 0.05 N m turn the joint by 2.6, 65 and 1042 mrad.

    Kills a torque of the wrong sign, a conversion of the errors without the factor of two, and radians for degrees.
    """
    physics = with_effects(flat(tmp_path), {})
    found = document_of(motion_of(swinging(0.05), physics))
    assert [one.horizon_s for one in found.horizons] == [0.1, 0.5, 2.0]
    for one in found.horizons:
        (joint,) = one.joints
        expected = np.rad2deg(0.05 * one.horizon_s**2 / (2.0 * INERTIA))
        assert (joint.unit, joint.error) == ("deg", pytest.approx(expected, rel=0.01))
        assert joint.spread == (pytest.approx(expected, rel=0.02), pytest.approx(expected, rel=0.02))
        assert joint.as_torque == pytest.approx(0.05, rel=0.01)
        assert one.tool_deg == pytest.approx(expected, rel=0.01)
        assert one.tool_mm == pytest.approx(2e3 * 0.4 * np.sin(np.deg2rad(expected) / 2.0), rel=0.01)  # the chord
    assert (found.growth, found.exponent) == ("power", pytest.approx(2.0, abs=0.02))


def test_an_error_of_the_first_velocity_grows_linearly_and_one_of_an_unstable_arm_exponentially(tmp_path: Path) -> None:
    physics = with_effects(flat(tmp_path), {})
    columns = swinging()
    fast = columns | {"velocity": 1.05 * columns["velocity"]}
    assert document_of(motion_of(fast, physics)).exponent == pytest.approx(1.0, abs=0.02)

    (tmp_path / "upright").mkdir()
    model = with_effects(mapping_of(tmp_path / "upright", slender_arm(("revolute",)), torque_measured_at="motor"), {})
    upright = np.full((TIME.size, 1), np.pi / 2.0)  # a pendulum that stands on its head, held by no torque
    off = {"time": TIME, "position": upright, "velocity": 0.0 * upright, "effort": np.full((TIME.size, 1), 1e-5)}
    found = document_of(motion_of(off, model))
    rate = np.sqrt(2.0 * 9.81 * 0.2 / INERTIA)
    assert found.growth == "exponential"
    assert found.rate_per_s == pytest.approx(rate, rel=0.15)
    assert "exponentially" in found.in_words


def test_rollouts_off_by_more_than_a_turn_have_diverged_and_are_in_no_error(tmp_path: Path) -> None:
    """In 2 s 3 N m turn the joint by 54 rad, 0.01 N m by 0.18 rad. Kills an error of 3000 degrees, a silent loss."""
    physics = with_effects(flat(tmp_path), {})
    columns = swinging()
    late = columns["time"][:, None] > 12.0
    some = document_of(motion_of(columns | {"effort": columns["effort"] + np.where(late, 3.0, 0.01)}, physics))
    assert 0 < some.diverged < some.starts
    assert some.last.horizon_s == 2.0
    assert some.last.joints[0].spread[0] == pytest.approx(np.rad2deg(0.01 * 4.0 / (2.0 * INERTIA)), rel=0.02)
    assert f"{some.diverged} of {some.starts} have diverged" in some.in_words

    every = document_of(motion_of(columns | {"effort": columns["effort"] + 3.0}, physics))
    assert [one.horizon_s for one in every.horizons] == [0.1, 0.5]
    assert (every.diverged, every.all_diverged_after_s) == (0, 2.0)
    assert every.last.joints[0].error == pytest.approx(np.rad2deg(3.0 * 0.25 / (2.0 * INERTIA)), rel=0.01)
    assert len(every.time_s) == len(every.tool_mm) == 25
    assert "after 2 s all have diverged" in every.in_words
    assert rollouts_of([motion_of(columns | {"effort": columns["effort"] + 300.0}, physics)]) is None


def test_the_error_of_the_true_model_is_that_of_the_integrator(tmp_path: Path) -> None:
    """Of a pendulum with weight; half the step leaves a quarter. Kills a torque that is late by half a step."""
    physics = with_effects(mapping_of(tmp_path, slender_arm(("revolute",)), torque_measured_at="motor"), {})
    columns = swinging()
    columns["effort"] = columns["effort"] + 2.0 * 9.81 * 0.2 * np.cos(columns["position"])
    motion = motion_of(columns, physics)
    _, (starts,) = starts_of([motion])
    errors = []
    for step in (0.01, 0.005, 0.0025):
        found = rolled_out(motion, starts, 0.5, physics, step)
        assert found is not None
        errors.append(np.abs(found.joints[-1]).max())
    assert errors[1] < 2e-4  # rad
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.3)


def test_friction_that_is_planted_shows_and_with_it_the_error_falls_to_the_floor(tmp_path: Path) -> None:
    """Through reading and low-pass of a recording; kills friction of the wrong sign."""
    mapping = flat(tmp_path)
    (run,) = read_recordings(write_npz(tmp_path / "run.npz", swinging(friction=0.05)), mapping)
    source = RecordingSource.of([run], mapping, Model(name="nominal"))
    (motion,) = source.free_motions()
    before, after = (
        rollouts.document()
        for added in ((), (("joint_coulomb_friction", (0.05,)),))
        if (rollouts := source.rollouts([(motion, added)])) is not None
    )
    assert before.horizons[0].joints[0].as_torque == pytest.approx(0.05, rel=0.15)  # it turns round now and then
    for one, other in zip(before.horizons, after.horizons, strict=True):
        assert other.joints[0].error < 0.1 * one.joints[0].error


def test_readings_are_corrected_once(tmp_path: Path) -> None:
    """With the right sensor model the integrator's error is left; kills one that is applied twice, or backwards."""
    bare = with_effects(flat(tmp_path), {})
    readings = ArmReadings(
        position_scale=1.02, position_offset=0.1, velocity_gain=0.9, torque_gain=1.1, torque_offset=0.3
    )
    columns = swinging()
    read = columns | {
        "position": 1.02 * columns["position"] + 0.1,
        "velocity": 1.02 * 0.9 * columns["velocity"],
        "effort": 1.1 * columns["effort"] + 0.3,
    }
    physics = replace(bare, arms={ARM: replace(bare.arms[ARM], readings=readings)})
    wrong, right = document_of(motion_of(read, bare)), document_of(motion_of(read, physics))
    assert right.last.joints[0].error < 1e-2 < 1.0 < wrong.last.joints[0].error  # degrees
    late = columns | {"velocity": np.interp(TIME - 0.05, TIME, columns["velocity"][:, 0])[:, None]}
    delayed = replace(bare, arms={ARM: replace(bare.arms[ARM], readings=ArmReadings(velocity_delay=0.05))})
    errors = [document_of(motion_of(late, one)).last.joints[0].error for one in (bare, delayed)]
    assert errors[1] < 0.1 * errors[0]


def test_gain_and_offset_of_the_drive_act_as_in_the_torque_balance(tmp_path: Path) -> None:
    """tau_read = (tau - offset) / gain; kills a gain or an offset that is left out, or turned round."""
    columns, physics = (
        swinging(),
        with_effects(flat(tmp_path), {"torque_gain": {"gain_joint1": 1.2}, "torque_offset": {"offset_joint1": 0.2}}),
    )
    read = columns | {"effort": (columns["effort"] - physics.arms[ARM].torque_offset) / physics.arms[ARM].torque_gain}
    assert abs(read["effort"] - columns["effort"]).max() > 0.1  # N m
    assert document_of(motion_of(read, physics)).last.joints[0].error < 1e-2  # degrees


def test_a_command_is_held_and_acts_later(tmp_path: Path) -> None:
    """Kills a delay of the wrong sign, and commands that are interpolated."""
    bare = with_effects(flat(tmp_path), {})
    columns = swinging()
    sent = TIME[::5] - 0.02
    held = np.interp(TIME[::5] + 0.025, TIME, columns["effort"][:, 0])[:, None]  # the mean of its 50 ms
    motion = motion_of(columns, bare, torque_time=sent, torque=held, commanded=True, begin=0.1, end=20.0)
    late = replace(bare, arms={ARM: replace(bare.arms[ARM], actuation_delay=0.02)})
    at_once, later = (document_of(motion, one).last.joints[0].error for one in (bare, late))
    assert later < 0.1 * at_once


def test_starts_cover_the_motion_evenly_and_horizons_are_those_that_fit(tmp_path: Path) -> None:
    """Kills rollouts beyond the end of a motion, and starts that leave out a part."""
    motion = motion_of(swinging(), with_effects(flat(tmp_path), {}))
    horizon, (starts,) = starts_of([motion])
    assert (horizon, starts.size) == (2.0, 33)  # the third after each begins where it ends
    assert starts[0] >= 0.0 and starts[-1] + 2.0 <= motion.end + 1e-9
    assert np.ptp(np.diff(starts)) < 1e-9 and starts[0] < 0.5
    short = replace(motion, end=4.0)
    assert starts_of([short])[0] == 0.5
    assert starts_of([short, short, short])[0] == 2.0
    assert starts_of([replace(motion, end=0.3)])[0] == 0.0 and rollouts_of([replace(motion, end=0.3)]) is None
    pieces = without(motion, [(3.0, 4.0), (23.0, 25.0)])
    assert [(one.begin, one.end) for one in pieces] == [(0.0, 3.0), (4.0, 23.0)]
    found = rollouts_of(pieces)
    assert found is not None and found.apart.sum() == 10  # one in 3 s and nine in 19 s


def test_held_out_stretches_are_joined_where_they_are_neighbours(tmp_path: Path) -> None:
    mapping = flat(tmp_path)
    (run,) = read_recordings(write_npz(tmp_path / "run.npz", swinging()), mapping)
    source = RecordingSource.of([run], mapping, Model(name="nominal"))
    (whole,) = source.free_motions()
    first, second = source.free_motions([0, 1, 2, 5])
    assert first.begin == whole.begin and first.end < second.begin < second.end < whole.end
    every = source.free_motions(range(len(source.clusters)))
    assert [(one.begin, one.end) for one in every] == [(whole.begin, whole.end)]


def test_nothing_is_rolled_out_without_the_torque_of_every_joint(tmp_path: Path) -> None:
    mapping = mapping_of(tmp_path, slender_arm(("revolute",) * 2), torque_measured_at="motor")
    columns = swung(mapping, {}, seconds=12.0)
    columns["effort"][:, 1] = 0.0
    (run,) = read_recordings(write_npz(tmp_path / "run.npz", columns), mapping)
    assert RecordingSource.of([run], mapping, Model(name="nominal")).rollouts() is None


def test_a_trial_of_another_simulator_is_predicted_with_its_friction(free: Run, rubbed: Run) -> None:
    """Commands of a trial in Bullet, with elastic joints and a torque loop, drive rigid joints with B and friction.

    Kills commands without gravity, motors without inertia, and friction that drives.
    """
    motions = [free_of_contact(run, {}, run.physics) for run in (free, rubbed)]
    fitting, missing, found = (
        rollouts_of(own, None if physics is None else [physics])
        for own, physics in zip(
            (motions[0], motions[1], motions[1]), (None, None, with_friction(rubbed.physics)), strict=True
        )
    )
    assert fitting is not None and missing is not None and found is not None
    horizons = [one.document().horizons[0] for one in (fitting, missing, found)]
    good, bad, mended = (np.array([joint.as_torque for joint in one.joints]) for one in horizons)
    assert np.all(good < 0.05) and np.all(mended < 0.35 * COULOMB)
    np.testing.assert_allclose(bad, COULOMB, rtol=0.4)


def test_of_a_hit_only_the_motion_before_it_is_rolled_out(measured_hit: MeasuredRun) -> None:
    motions = free_of_contact(measured_hit, measured_hit.impacts, measured_hit.physics)
    assert len(motions) == len(measured_hit.impacts)
    assert all(motion.end < min(measured_hit.impacts.values()) for motion in motions)
