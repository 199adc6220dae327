# SPDX-License-Identifier: Apache-2.0
"""Energy, and Poisson's law of restitution, held against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from impact_map_cases import PUSH, nominal, one_point
from random_impacts import random_problem

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import compute_impact_map
from impact_rs_sim.impact_map.contacts import ContactPoint
from impact_rs_sim.impact_map.laws import ContactTerms, solve_contacts
from impact_rs_sim.impact_map.problem import EnergyGain
from impact_rs_sim.impact_map.solve import Solution, check_energy, solve_poisson


def planar(
    inertia: np.ndarray, rows: np.ndarray, before: np.ndarray, friction: float, restitution: float
) -> ContactTerms:
    """One contact point of a planar mechanism: ``rows`` are J along the tangent x and the normal z, ``(2, n)``."""
    jacobian = np.zeros((3, before.size))
    jacobian[0], jacobian[2] = rows
    response = np.linalg.solve(inertia, jacobian.T)
    up = np.array([0.0, 0.0, 1.0])
    return ContactTerms(
        contacts=[ContactPoint("support", np.zeros(3), up, 0.0, friction)],
        restitution=restitution,
        before=before,
        jacobian=jacobian,
        response=response,
        normals=up[None],
        friction=np.array([friction]),
        rebound=np.array([restitution * min(jacobian[2] @ before, 0.0)]),
        inverse_mass=np.array([np.trace(jacobian @ response) / 3.0]),
        mobility=float(1.0 / inertia[0, 0]),
    )


def double_pendulum(restitution: float, friction: float) -> tuple[ContactTerms, np.ndarray]:
    """Kane's: two rods of 1 kg and 1 m whose tip meets a rough floor, moving as in Kane and Levinson (1985)."""
    first, second = np.radians(20.0), np.radians(30.0)
    c1, s1, c2, s2 = np.cos(first), np.sin(first), np.cos(second), np.sin(second)
    coupling = 0.5 * np.cos(first - second)
    inertia = np.array([[4.0 / 3.0, coupling], [coupling, 1.0 / 3.0]])
    # Angles from straight down, so the tip is at (sin, -cos) of both rods.
    rows = np.array([[c1, c2], [s1, s2]])
    return planar(inertia, rows, np.array([-0.1, -0.2]), friction, restitution), inertia


def energy(inertia: np.ndarray, velocity: np.ndarray) -> float:
    """Kinetic energy [J]."""
    return float(0.5 * velocity @ inertia @ velocity)


def routh(terms: ContactTerms, restitution: float) -> np.ndarray:
    """u^+ by integrating Darboux's equations over the normal impulse in small steps, sliding or sticking."""
    rows, response = terms.jacobian[[0, 2]], terms.response[:, [0, 2]]
    (of_tangent, coupled), (_, of_normal) = (rows @ response).tolist()
    tangent, normal = (rows @ terms.before).tolist()
    mu, along, total, compressed = float(terms.friction[0]), 0.0, 0.0, None
    step = 1e-5 * -normal / of_normal
    resting = min(max(-coupled / of_tangent, -mu), mu)  # tangential impulse per normal one that keeps a point at rest
    while compressed is None or total < (1.0 + restitution) * compressed:
        share = -math.copysign(mu, tangent) if abs(tangent) > 2.0 * step else resting
        along, total = along + step * share, total + step
        tangent += step * (of_tangent * share + coupled)
        normal += step * (coupled * share + of_normal)
        if compressed is None and normal >= 0.0:
            compressed = total
    return np.asarray(terms.before + response @ [along, total])


@pytest.mark.parametrize("law", ["newton", "poisson"])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_without_friction_one_point_knows_one_law(law: str, restitution: float) -> None:
    problem = replace(one_point(pad_friction=0.0), restitution=restitution)
    newton = compute_impact_map(problem, "exact")
    other = compute_impact_map(replace(problem, restitution_law=law), "exact")
    np.testing.assert_allclose(other.joint_velocity["arm"], newton.joint_velocity["arm"], atol=1e-6)
    np.testing.assert_allclose(other.object_twist, newton.object_twist, atol=1e-6)


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("friction", [0.0, 0.05, 2.0])
@pytest.mark.parametrize("angle", [0.3, 0.9, 1.3])
def test_a_rod_that_hits_with_friction_follows_rouths_diagram(
    angle: float, friction: float, restitution: float
) -> None:
    # A thin rod, 1 kg and 1 m, at an angle to the floor: u = (vx, vz, w) of its centre, its lower end hits.
    lever = 0.5 * np.array([-np.cos(angle), -np.sin(angle)])
    rows = np.array([[1.0, 0.0, lever[1]], [0.0, 1.0, -lever[0]]])
    terms = planar(np.diag([1.0, 1.0, 1.0 / 12.0]), rows, np.array([2.0, -1.0, 0.0]), friction, restitution)
    found = solve_poisson(terms)
    np.testing.assert_allclose(found.velocity, routh(terms, restitution), atol=2e-4)


def test_kanes_pendulum_gains_energy_by_newton_loses_it_by_poisson() -> None:
    gained = False
    for friction in (0.3, 0.5, 0.7):
        for restitution in (0.7, 0.9):
            terms, inertia = double_pendulum(restitution, friction)
            before = energy(inertia, terms.before)
            newton = terms.before + terms.response @ solve_contacts(terms)[0].ravel()
            gained = gained or energy(inertia, newton) > before * (1.0 + 1e-3)
            found = solve_poisson(terms)
            assert energy(inertia, found.velocity) <= before
    assert gained


def test_poisson_returns_its_share_of_the_normal_impulse() -> None:
    terms, _ = double_pendulum(0.6, 0.4)
    found = solve_poisson(terms)
    compressed = solve_contacts(replace(terms, restitution=0.0, rebound=np.zeros(1)))[0]
    assert found.impulses[0, 2] == pytest.approx(1.6 * compressed[0, 2], rel=1e-6)


def test_an_answer_that_gains_energy_is_an_error_with_a_hint() -> None:
    terms, inertia = double_pendulum(0.9, 0.7)
    impulses, _ = solve_contacts(terms)
    velocity = terms.before + terms.response @ impulses.ravel()
    answer = Solution(terms, impulses, velocity, 1)
    gain = energy(inertia, velocity) - energy(inertia, terms.before)
    assert answer.energy_gain == pytest.approx(gain, rel=1e-9)
    assert gain > 0.0
    before = energy(inertia, terms.before)
    with pytest.raises(EnergyGain, match=r"gains .* J.*restitution_law 'poisson'"):
        check_energy(before, gain, impulses, terms.residual(impulses, velocity), 0.9)
    lossy = solve_poisson(terms)
    answer = Solution(terms, lossy.impulses, lossy.velocity, 1)
    check_energy(before, answer.energy_gain, lossy.impulses, lossy.residual, 0.9)


@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_without_restitution_both_laws_are_one(seed: int) -> None:
    problem = random_problem(PUSH, np.random.default_rng(seed), 0.0)
    newton = compute_impact_map(problem, "exact")
    poisson = compute_impact_map(replace(problem, restitution_law="poisson"), "exact")
    np.testing.assert_allclose(poisson.object_twist, newton.object_twist, atol=1e-5)


def test_bullet_knows_newtons_law_only() -> None:
    with pytest.raises(InputError, match="'exact' has both laws"):
        compute_impact_map(replace(nominal(), restitution_law="poisson"), "bullet")


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(InputError, match="newton, poisson"):
        compute_impact_map(replace(nominal(), restitution_law="hunt"), "exact")
