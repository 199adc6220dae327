# SPDX-License-Identifier: Apache-2.0
"""Roles of streams by their likelihood: planted roles are found with a decisive margin, chance relations never are."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from joint_recordings import Columns, swinging

from impact_rs_sim.robots.robot import load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_trials.recordings.importing.hypotheses import (
    RoleChoice,
    RoleHypothesis,
    choose,
    copies,
    is_magnitude,
    positions,
    torques,
    velocities,
)
from impact_rs_trials.recordings.joint_motion import JointMotion
from impact_rs_trials.recordings.mapping import MountedEndEffector
from impact_rs_trials.recordings.relations import DECISIVE_LOG_ODDS, effective_samples

TIME = np.arange(0.0, 8.0, 0.01)
CENTRE = np.array([0.1, 0.6, 0.2, -1.2, 0.3, 0.9, 0.1])  # rad


@functools.cache
def model() -> RobotModel:
    return RobotModel(load_facts("kuka_iiwa7"), MountedEndEffector().build())


@functools.cache
def swing(seed: int = 0) -> Columns:
    """An iiwa that swings about a bent pose, at frequencies of a seed."""
    frequencies = np.random.default_rng(seed).uniform(0.1, 0.5, (2, 7))
    return swinging(model(), TIME, CENTRE, (frequencies[0], frequencies[1]), (0.35, 0.1))


def motion(own: Columns) -> JointMotion:
    return JointMotion.of(TIME, own["position"], own["velocity"], model())


def read(own: JointMotion, raw: np.ndarray) -> RoleChoice:
    """The likeliest role of a stream beside a motion."""
    y = own.sampled(raw)
    choice = choose([*velocities(own, y), *copies(own, y), *torques(own, y)])
    assert choice is not None
    return choice


@pytest.mark.parametrize(("unit", "factor"), [("rad", 1.0), ("deg", 180.0 / np.pi), ("mrad", 1e3)])
def test_the_unit_of_positions_is_the_one_whose_range_they_fill(unit: str, factor: float) -> None:
    """Kills a density without the range: numbers in rad lie within the limits in deg as well."""
    found = choose(positions(factor * swing()["position"], model().facts), -np.inf)
    assert found is not None and found.best.unit == unit and found.sure


@pytest.mark.parametrize(("unit", "factor"), [("rad/s", 1.0), ("deg/s", -180.0 / np.pi), ("rpm", 30.0 / np.pi)])
def test_velocities_are_found_with_unit_and_sign(unit: str, factor: float) -> None:
    own = swing()
    still = JointMotion.of(TIME, own["position"], None, model())
    found = choose(velocities(still, still.sampled(factor * own["velocity"])))
    assert found is not None and found.sure and (found.best.role, found.best.unit) == ("velocity", unit)
    assert found.best.further == ({} if factor > 0.0 else {"factor": -1.0})


def test_a_velocity_at_another_rate_or_of_another_joint_is_none() -> None:
    """Kills a clipped factor that counts as noise, and a joint that refutes all others."""
    own = swing()
    still = JointMotion.of(TIME, own["position"], None, model())
    half = choose(velocities(still, still.sampled(0.25 * own["velocity"])))
    assert (
        half is not None and half.best.role == "other" and half.best.further["rate_"] == pytest.approx(0.25, abs=1e-3)
    )
    mixed = own["velocity"].copy()
    mixed[:, 3] = 0.02 * np.random.default_rng(0).standard_normal(TIME.size)
    found = choose(velocities(still, still.sampled(mixed)))
    assert found is not None and found.best.role == "velocity" and "joints 4 are not the deriv" in found.best.remarks[0]


@pytest.mark.parametrize(
    ("factor", "role", "unit"),
    [
        (np.ones(7), "torque", "N m"),
        (np.full(7, -1e3), "torque", "mN m"),
        (np.full(7, 1.3), "torque", "N m"),
        (np.full(7, 4.0), "current", "A"),  # no load makes a torque four times as large in every joint
        (1.0 / np.linspace(8.0, 14.0, 7), "current", "A"),
        (100.0 * np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0]), "other", ""),
    ],
)
def test_torques_and_currents_are_told_apart_through_friction_and_offset(
    factor: np.ndarray, role: str, unit: str
) -> None:
    """Kills a fit without friction or offset, and a prior that leaves out the factors."""
    own = swing()
    friction = 2.0 * np.tanh(own["velocity"] / 0.02) + 0.5
    found = read(motion(own), factor * (own["effort"] + friction))
    assert (found.best.role, found.best.unit) == (role, unit) and found.sure
    if role == "current":
        np.testing.assert_allclose(found.best.further["torque_constant"][1], 1.0 / factor[1], rtol=0.01)


def test_joints_that_contradict_are_not_said_to_show_nothing() -> None:
    """Kills: the torques of two joints in each other's columns, called joints that show nothing."""
    own, effort = motion(swing()), swing()["effort"]
    (best, *_) = torques(own, own.sampled(effort[:, [0, 3, 2, 1, 4, 5, 6]]))
    assert "times in joints 2, 4, with a correlation of" in best.evidence
    assert "columns of other joints?" in best.evidence


def test_torque_constants_are_those_of_joints_that_carry_weight() -> None:
    """Joint 1 turns about a vertical axis; its motor's own inertia would pass for a smaller constant."""
    own = swing()
    acceleration = np.gradient(own["velocity"], TIME, axis=0)
    found = read(motion(own), (own["effort"] + 0.5 * acceleration) / 10.0)
    assert found.best.role == "current"
    assert found.best.further["torque_constant"][0] == pytest.approx(10.0, rel=0.15)


def test_viscous_friction_is_no_velocity() -> None:
    """Kills a clipped factor whose residual counts as noise of a velocity."""
    own = swing()
    still = JointMotion.of(TIME, own["position"], None, model())
    noise = np.random.default_rng(0).standard_normal(own["velocity"].shape)
    drag = own["velocity"] * [10.0, 9.0, 3.3, 1.8, 3.2, 1.0, 5.0] + 0.5 * noise
    assert all(one.log_posterior < 0.0 for one in velocities(still, still.sampled(drag)) if one.role == "velocity")


def test_a_factor_that_is_fitted_costs_half_the_log_of_the_samples() -> None:
    """Schwarz (1978): noise that a torque explains by chance is unlikelier as a current than as noise."""
    noise = np.random.default_rng(0).standard_normal((TIME.size, 7))
    own = motion(swing())
    (current,) = [one for one in torques(own, own.sampled(noise)) if one.role == "current"]
    assert current.log_likelihood < -10.0


def test_a_torque_of_twice_the_size_is_assumed_and_the_other_reading_is_shown() -> None:
    """One joint: a torque of a load, or a current? Kills a margin that leaves out the next hypothesis."""
    choice = choose([RoleHypothesis("torque", "N m", "a", 12.0, -2.0), RoleHypothesis("current", "A", "b", 12.0, -4.0)])
    assert choice is not None and not choice.sure
    assert choice.margin == pytest.approx(2.0)
    assert choice.evidence == "a; next: current in A, log odds 2"


def test_a_late_copy_of_the_motion_in_another_unit_is_one() -> None:
    own = swing()
    late = np.degrees(np.roll(own["position"], 8, axis=0)) + 3.0
    found = read(motion(own), late)
    assert found.best.role == "copy" and found.best.evidence == "repeats the positions, in deg" and found.sure


def test_unrelated_motions_are_hardly_ever_decisive() -> None:
    """Streams of 40 other swings: kills samples that count as independent though they are smooth."""
    own, wrong = motion(swing()), 0
    for seed in range(1, 41):
        other = swing(seed)
        for raw in (other["velocity"], other["effort"] - other["effort"].mean(axis=0)):
            y = own.sampled(raw)
            hypotheses = [*velocities(own, y), *copies(own, y), *torques(own, y)]
            wrong += max(one.log_posterior for one in hypotheses if one.role != "other") > DECISIVE_LOG_ODDS
    assert wrong <= 2


def test_effective_samples_give_the_variance_of_chance_correlations() -> None:
    """Bartlett (1946): kills a sum over positive lags alone, and one without the lag 0."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, 600, 2000))
    smooth = np.empty_like(noise)
    smooth[:, 0] = noise[:, 0]
    for row in range(1, 600):
        smooth[:, row] = 0.9 * smooth[:, row - 1] + noise[:, row]
    first, second = smooth - smooth.mean(axis=1, keepdims=True)
    chance = np.sum(first * second, axis=0) / np.sqrt(np.sum(first**2, axis=0) * np.sum(second**2, axis=0))
    assert np.median(effective_samples(first, second)) == pytest.approx(1.0 / np.var(chance), rel=0.35)
    white = effective_samples(*noise)
    assert np.median(white) > 250.0


def test_magnitudes_of_torques_are_told_from_torques_of_one_sign() -> None:
    """A register without sign; else an offset, or joints that gravity alone loads. Kills a test of the stream alone."""
    own = motion(swing())
    effort, weight = swing()["effort"], np.abs(own.gravity_torque).max(axis=0) + 20.0
    assert is_magnitude(own, own.sampled(np.abs(effort)))
    assert not is_magnitude(own, own.sampled(effort))
    held = dataclasses.replace(own)
    held.__dict__["rigid_torque"] = own.rigid_torque + weight + 80.0  # as if every joint held a load on one side
    assert not is_magnitude(held, held.sampled(effort + weight + 80.0))
