# SPDX-License-Identifier: Apache-2.0
"""The judge of every engine: an answer made wrong in one known way is found out, in that way and by that much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impact_map_cases import SCENE, nominal, one_point, with_velocity

from impact_rs_sim.impact_map import ImpactProblem, Residual
from impact_rs_sim.impact_map.contacts import meetings
from impact_rs_sim.impact_map.engine import Answer
from impact_rs_sim.impact_map.exact import ExactEngine
from impact_rs_sim.impact_map.laws import build_system

SMALL = 1e-6  # m/s, what is left of a right answer


def answer_of(problem: ImpactProblem) -> Answer:
    engine = ExactEngine(problem.physics)
    placements = {name: engine.models[name].placement(state.position) for name, state in problem.arms.items()}
    system = build_system(problem, engine.models)
    return engine._solve(problem, system, meetings(problem.physics, problem.object, placements))


def with_impulses(answer: Answer, impulses: np.ndarray) -> Residual:
    """Residual of other impulses, with the velocity that they lead to."""
    velocity = answer.terms.before + answer.terms.response @ impulses.ravel()
    return answer.terms.residual(impulses, velocity)


@pytest.fixture(scope="module")
def face() -> Answer:
    return answer_of(nominal())


@pytest.fixture(scope="module")
def point() -> Answer:
    """One corner, sliding: the arm moves across the face as well, and friction is low."""
    problem = one_point(pad_friction=0.1)
    state = problem.arms["arm"]
    jacobian = SCENE.models["arm"].jacobian(state.position)
    across = np.linalg.pinv(jacobian) @ np.array([0.5, 0.0, 0.2, 0.0, 0.0, 0.0])
    return answer_of(with_velocity(problem, state.velocity + across))


def test_a_right_answer_has_no_residual(face: Answer, point: Answer) -> None:
    for answer in (face, point):
        assert answer.terms.residual(answer.impulses, answer.velocity).largest < SMALL


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_too_little_impulse_leaves_a_velocity_of_penetration(point: Answer, share: float) -> None:
    """Without an impulse the points approach at -J_n u^-; each part of the impulse takes away its part."""
    approach = -point.terms.split((point.terms.jacobian @ point.terms.before).reshape(-1, 3))[0]
    found = with_impulses(point, share * point.impulses)
    assert found.penetration_velocity == pytest.approx((1.0 - share) * approach[0], rel=1e-3)
    assert found.momentum < SMALL
    assert found.worst[0].startswith("Newton")


@pytest.mark.parametrize("share", [1.1, 1.5])
def test_too_much_impulse_separates_a_point_that_carries_it(point: Answer, share: float) -> None:
    approach = -point.terms.split((point.terms.jacobian @ point.terms.before).reshape(-1, 3))[0]
    found = with_impulses(point, share * point.impulses)
    assert found.complementarity == pytest.approx((share - 1.0) * approach[0], rel=1e-3)
    assert found.penetration_velocity == 0.0


def test_a_contact_that_pulls_breaks_complementarity(point: Answer) -> None:
    found = with_impulses(point, -0.1 * point.impulses)
    assert found.complementarity > 0.01
    assert with_impulses(point, 0.0 * point.impulses).complementarity < SMALL


def test_friction_beyond_the_cone_is_found_out(point: Answer) -> None:
    pressing, friction = point.terms.split(point.impulses)
    outside = pressing[:, None] * point.terms.normals + 1.3 * friction
    assert with_impulses(point, outside).friction_cone > 1e-3


def test_a_sliding_point_without_its_friction_is_found_out(point: Answer) -> None:
    slides, _ = point.terms.sliding(point.impulses, point.velocity)
    assert slides.all()
    pressing, friction = point.terms.split(point.impulses)
    for share in (0.0, 0.7, -1.0):
        wrong = pressing[:, None] * point.terms.normals + share * friction
        assert with_impulses(point, wrong).friction_cone > 1e-3


def test_friction_that_does_not_oppose_the_sliding_velocity_is_found_out(point: Answer) -> None:
    """Turned by some degrees about the normal; the size stays on the cone."""
    pressing, friction = point.terms.split(point.impulses)
    normal = point.terms.normals[0]
    turned = friction[0] * np.cos(0.3) + np.cross(normal, friction[0]) * np.sin(0.3)
    wrong = pressing[:, None] * point.terms.normals + turned
    assert with_impulses(point, wrong).friction_cone > 1e-3


def test_a_point_that_sticks_needs_any_friction_inside_its_cone() -> None:
    rough = answer_of(one_point(pad_friction=1.0))
    slides, _ = rough.terms.sliding(rough.impulses, rough.velocity)
    assert not slides.any()
    assert rough.terms.residual(rough.impulses, rough.velocity).friction_cone < SMALL
    pressing, friction = rough.terms.split(rough.impulses)
    slipping = pressing[:, None] * rough.terms.normals + 0.5 * friction
    assert with_impulses(rough, slipping).friction_cone > 1e-3


def test_a_velocity_without_its_impulses_breaks_the_momentum_balance(face: Answer) -> None:
    for index in (0, face.velocity.size - 4):
        velocity = face.velocity.copy()
        velocity[index] += 0.03
        found = face.terms.residual(face.impulses, velocity)
        assert found.momentum == pytest.approx(0.03, rel=1e-6)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_restitution_asks_for_its_share_of_the_approach_back(restitution: float) -> None:
    """J_n u^+ = -e J_n u^- at a point that carries an impulse; with another e the answer is wrong by the difference."""
    problem = replace(one_point(pad_friction=0.0), restitution=restitution)
    answer = answer_of(problem)
    before, after = (
        answer.terms.split((answer.terms.jacobian @ velocity).reshape(-1, 3))[0]
        for velocity in (answer.terms.before, answer.velocity)
    )
    assert after[0] == pytest.approx(-restitution * before[0], abs=SMALL)
    other = answer_of(replace(problem, restitution=0.25)).terms
    found = other.residual(answer.impulses, answer.velocity)
    wrong = (restitution - 0.25) * -before[0]
    assert found.complementarity == pytest.approx(max(wrong, 0.0), abs=SMALL)
    assert found.penetration_velocity == pytest.approx(max(-wrong, 0.0), abs=SMALL)


def test_the_worst_law_is_named_and_nan_is_the_worst_of_all() -> None:
    laws = {
        "penetration_velocity": "Newton",
        "complementarity": "complem",
        "friction_cone": "Coulomb",
        "momentum": "mom",
    }
    for law, name in laws.items():
        residual = Residual(**{**dict.fromkeys(laws, 1e-3), law: 2e-3})
        assert residual.worst[0].startswith(name)
        assert residual.largest == 2e-3
        assert not Residual(**{**dict.fromkeys(laws, 1e-3), law: float("nan")}).largest <= 1.0
