# SPDX-License-Identifier: Apache-2.0
"""The compiled laws: as they are written down, with derivatives that finite differences find, and solved."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from impact_map_cases import nominal, one_point
from test_impact_map_cones import sliding, terms_of

from impact_rs_sim.impact_map import cones
from impact_rs_sim.impact_map.laws import (
    COMPLIANCE,
    ContactTerms,
    delassus,
    harden,
    linearise,
    newton,
    yielding_velocity,
)

STEP = 1e-7


def random_terms(rng: np.random.Generator, count: int, restitution: float = 0.0) -> ContactTerms:
    """Points of a body with as many velocities as it takes, pressed in some way."""
    size = 13
    jacobian = rng.standard_normal((3 * count, size))
    half = rng.standard_normal((size, size))
    inertia = half @ half.T + np.eye(size)
    response = np.linalg.solve(inertia, jacobian.T)
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    before = rng.standard_normal(size)
    approach = np.sum(normals * (jacobian @ before).reshape(-1, 3), axis=1)
    return ContactTerms(
        contacts=[None] * count,
        restitution=restitution,
        before=before,
        jacobian=jacobian,
        response=response,
        normals=normals,
        friction=rng.uniform(0.0, 0.5, count),
        rebound=restitution * np.minimum(approach, 0.0),
        inverse_mass=np.einsum("ij,ji->i", jacobian, response).reshape(-1, 3).mean(axis=1),
        mobility=1.0,
    )


def written_down(terms: ContactTerms, impulses: np.ndarray, velocity: np.ndarray, least: np.ndarray) -> np.ndarray:
    """F as the head of the module has it."""
    found = []
    for i, normal in enumerate(terms.normals):
        ratio = 1.0 / terms.inverse_mass[i]
        pressing, opening = normal @ impulses[i], normal @ velocity[i]
        tangential, slip = impulses[i] - pressing * normal, velocity[i] - opening * normal
        wanted, radius = tangential - ratio * slip, terms.friction[i] * max(pressing, 0.0)
        length = np.linalg.norm(wanted)
        disk = wanted if length <= radius else radius * wanted / length
        found.append((pressing - max(least[i], pressing - ratio * opening)) * normal + tangential - disk)
    return np.array(found)


@pytest.mark.parametrize("count", [1, 3, 8, 16])
def test_laws_are_those_that_are_written_down_in_every_state(count: int) -> None:
    rng = np.random.default_rng(count)
    seen = set()
    for _ in range(30):
        terms = random_terms(rng, count)
        impulses = rng.standard_normal((count, 3)) + rng.uniform(0.0, 3.0) * terms.normals
        velocity, least = 0.3 * rng.standard_normal((count, 3)), rng.choice([0.0, 0.2], count)
        linear = linearise(terms, impulses, velocity, least)
        np.testing.assert_allclose(linear.defect, written_down(terms, impulses, velocity, least), atol=1e-13)
        seen |= set(linear.state)
        moved, shaken = rng.standard_normal((2, count, 3))
        grip = rng.standard_normal(count)
        along = np.einsum("mij,mj->mi", linear.by_impulse, moved)
        along += np.einsum("mij,mj->mi", linear.by_velocity, shaken) + linear.by_friction * grip[:, None]
        near = [
            written_down(
                replace(terms, friction=terms.friction + step * grip),
                impulses + step * moved,
                velocity + step * shaken,
                least,
            )
            for step in (STEP, -STEP)
        ]
        smooth = linear.margin > 1e-4
        difference = (near[0] - near[1]) / (2.0 * STEP)
        np.testing.assert_allclose(along[smooth], difference[smooth], rtol=1e-5, atol=1e-5)
    assert seen == {"open", "stick", "slide"}


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("count", [1, 2, 4, 8, 16])
def test_random_points_are_solved_to_the_last_digits(count: int, restitution: float) -> None:
    rng = np.random.default_rng(100 + count)
    answered = 0
    for _ in range(10):
        terms = random_terms(rng, count, restitution)
        impulses, converged, _ = terms.kernel.solve(COMPLIANCE)
        if not converged:  # with couplings that no body has there may be no answer
            continue
        answered += 1
        velocity = terms.before + terms.response @ impulses.ravel()
        assert terms.residual(impulses, velocity).largest < 1e-10
        settled, converged = newton(terms, impulses)
        if not converged:  # where the compliance decides about a state that it does not have without
            continue
        yielding = yielding_velocity(terms, delassus(terms), settled)
        np.testing.assert_allclose(linearise(terms, settled, yielding).defect, 0.0, atol=1e-10)
    # Where no velocity opens all points against their friction, as in 8 of 10 draws of 16 points of 13 velocities,
    # points that must bounce need not have an answer.
    assert answered >= (8 if count < 16 or restitution == 0.0 else 3)


@pytest.mark.parametrize("case", [nominal, one_point, sliding])
def test_hardening_takes_out_what_the_compliance_let_points_yield(case) -> None:
    terms = terms_of(case())
    soft, converged = newton(terms, cones.solve_cones(terms)[0], compliance=1e-5)
    assert converged
    hard = harden(terms, soft, compliance=1e-5)

    def residual(impulses: np.ndarray) -> float:
        return terms.residual(impulses, terms.before + terms.response @ impulses.ravel()).largest

    assert residual(soft) > 1e-8
    assert residual(hard) < 1e-11
    np.testing.assert_allclose(hard, soft, atol=1e-3)


def test_where_newtons_method_fails_admm_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    terms = terms_of(nominal())
    expected, _ = cones.solve_contacts(terms)
    given_up = SimpleNamespace(solve=lambda compliance: (np.zeros_like(expected), False, 7))
    kernel = terms.kernel
    without = replace(terms)
    without.__dict__["kernel"] = SimpleNamespace(
        solve=given_up.solve, newton=kernel.newton, harden=kernel.harden, judge=kernel.judge
    )
    impulses, steps = cones.solve_contacts(without)
    assert steps > 7
    np.testing.assert_allclose(terms.response @ impulses.ravel(), terms.response @ expected.ravel(), atol=1e-10)
