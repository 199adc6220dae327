# SPDX-License-Identifier: Apache-2.0
"""A flexible joint that the torque loop drives apart is found before anything is simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from trials import nominal_physics

from impact_rs_sim.drive import Drive
from impact_rs_sim.drive_stability import joint_stability, spectral_radius

PERIOD = 0.00025  # s
NOMINAL = nominal_physics("cat_food")


def stretch_after(link: float, motor: float, stiffness: float, damping: float, steps: int) -> float:
    """Largest stretch in the last of ``steps`` steps of the drive itself and a free link, from 1 rad [rad]."""
    arm = NOMINAL.arms["arm"]
    alike = replace(
        arm,
        motor_inertia_rotor=np.full(7, 3.0 * motor),
        motor_inertia_reduced=np.full(7, motor),
        stiffness=np.full(7, stiffness),
        damping=np.full(7, damping),
    )
    drive = Drive(alike, PERIOD)
    drive.position = np.ones(7)
    position, velocity, largest = np.zeros(7), np.zeros(7), 0.0
    still = np.zeros(7)
    for step in range(steps):
        drive.sense(position, velocity)
        velocity = velocity + PERIOD * drive.transmission_torque / link
        position = position + PERIOD * velocity
        drive.step(still)
        stretch = abs(float(drive.position[0] - position[0]))
        if stretch > 1e3:
            return stretch
        if step > steps - 50:
            largest = max(largest, stretch)
    return largest


@settings(max_examples=40)
@given(
    link=st.floats(1e-4, 1.0),
    motor=st.floats(0.02, 1.0),
    stiffness=st.floats(1e3, 2e4),
    damping=st.floats(1.0, 40.0),
)
def test_the_spectral_radius_tells_whether_the_drive_itself_diverges(
    link: float, motor: float, stiffness: float, damping: float
) -> None:
    found = joint_stability(link, motor, stiffness, damping, PERIOD)
    assume(abs(found.spectral_radius - 1.0) > 0.02)
    assert (stretch_after(link, motor, stiffness, damping, 600) > 1.0) == (found.spectral_radius > 1.0)


@given(
    link=st.floats(1e-3, 1.0), stiffness=st.floats(1e3, 2e4), damping=st.floats(0.5, 40.0), share=st.floats(0.5, 1.5)
)
def test_what_would_do_is_just_what_does(link: float, stiffness: float, damping: float, share: float) -> None:
    """On either side of the damping, the stiffness and the period that are told, stability changes."""
    assume(abs(share - 1.0) > 1e-3)
    found = joint_stability(link, 0.1, stiffness, damping, PERIOD)
    for told, change in (
        (found.damping_below, lambda value: joint_stability(link, 0.1, stiffness, value, PERIOD)),
        (found.stiffness_below, lambda value: joint_stability(link, 0.1, value, damping, PERIOD)),
        (found.period_below, lambda value: joint_stability(link, 0.1, stiffness, damping, value)),
    ):
        if told > 0.0:
            assert (change(share * told).spectral_radius < 1.0) == (share < 1.0)


def test_without_damping_a_joint_swings_for_ever() -> None:
    assert joint_stability(0.1, 0.1, 1e4, 0.0, PERIOD).spectral_radius == pytest.approx(1.0, abs=1e-9)


def test_uncoupled_joints_are_as_stable_as_the_worst_of_them() -> None:
    link, motor = np.array([0.5, 0.001]), np.array([0.2, 0.07])
    stiffness, damping = np.array([14000.0, 8000.0]), np.array([12.0, 6.0])
    inverse = np.linalg.inv(np.diag(link)) + np.diag(1.0 / motor)
    singles = [
        joint_stability(*values, PERIOD).spectral_radius for values in zip(link, motor, stiffness, damping, strict=True)
    ]
    assert spectral_radius(inverse, stiffness, damping, PERIOD) == pytest.approx(max(singles))


def test_links_that_are_coupled_are_less_stable_together() -> None:
    mass = np.array([[0.5, 0.09], [0.09, 0.02]])
    inverse = np.linalg.inv(mass)
    stiffness, damping, motor = np.array([14000.0, 14000.0]), np.array([12.0, 12.0]), 0.2
    together = spectral_radius(inverse + np.eye(2) / motor, stiffness, damping, PERIOD)
    alone = max(joint_stability(1.0 / inverse[i, i], motor, 14000.0, 12.0, PERIOD).spectral_radius for i in (0, 1))
    assert together > alone > 0.0
