# SPDX-License-Identifier: Apache-2.0
"""Inertial parameters of rigid bodies: those of clouds of points, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_sim.bodies import inertia_of, is_body, reaches, second_moments
from impact_rs_sim.robot import Array


def of_points(masses: Array, places: Array) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about the centre of points."""
    mass = float(masses.sum())
    com = masses @ places / mass
    moments = np.einsum("k,ki,kj->ij", masses, places - com, places - com)
    return mass, com, inertia_of(moments)


def pseudo_inertia(mass: float, com: Array, inertia: Array) -> Array:
    """P of Wensing, Kim and Slotine 2018, ``(4, 4)``."""
    first = mass * com
    return np.block([[second_moments(inertia) + np.outer(first, com), first[:, None]], [first, mass]])


def test_points_of_any_masses_are_a_body() -> None:
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 4, 20):  # from a point and a rod on
        mass, _, inertia = of_points(rng.uniform(0.1, 2.0, count), rng.normal(size=(count, 3)))
        assert is_body(mass, inertia)


def test_a_body_is_what_has_a_positive_definite_pseudo_inertia() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(500):
        mass, com, inertia = of_points(rng.uniform(0.1, 2.0, 5), rng.normal(size=(5, 3)))
        other = rng.normal(size=(3, 3))
        mass, inertia = mass + rng.normal(), inertia + other + other.T
        found.append(is_body(mass, inertia))
        assert found[-1] == bool(np.linalg.eigvalsh(pseudo_inertia(mass, com, inertia))[0] > 0.0)
    assert 50 < sum(found) < 450


def test_moments_beyond_the_triangle_inequality_are_of_no_body() -> None:
    assert is_body(1.0, np.diag([1.0, 2.0, 3.0]))  # a plate
    assert not is_body(1.0, np.diag([1.0, 2.0, 3.001]))
    assert not is_body(0.0, np.eye(3)) and not is_body(-1.0, np.eye(3))


def test_second_moments_and_inertia_are_each_other_s_inverse() -> None:
    inertia = np.array([[3.0, 0.1, 0.2], [0.1, 4.0, -0.3], [0.2, -0.3, 5.0]])
    assert inertia_of(second_moments(inertia)) == pytest.approx(inertia)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)])
def test_a_homogeneous_ellipsoid_reaches_as_far_as_its_semi_axes(direction: tuple[float, float, float]) -> None:
    """Second moments of a homogeneous ellipsoid are m a^2 / 5 along each semi-axis a."""
    mass, semi, com = 2.0, np.array([0.3, 0.2, 0.05]), np.array([1.0, -2.0, 0.5])
    inertia = inertia_of(np.diag(mass * semi**2 / 5.0))
    edge = np.array(direction) / np.linalg.norm(np.array(direction) / semi)
    assert reaches(mass, com, inertia, com + 0.999 * edge)
    assert not reaches(mass, com, inertia, com + 1.001 * edge)
    rod = inertia_of(np.diag([mass * 0.3**2 / 5.0, 0.0, 0.0]))
    assert reaches(mass, com, rod, com + np.array([0.29, 0.0, 0.0]))
    assert not reaches(mass, com, rod, com + np.array([0.0, 0.001, 0.0]))
