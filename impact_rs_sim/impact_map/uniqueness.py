# SPDX-License-Identifier: Apache-2.0
"""Spread of the solutions where the contact laws have several.

A face that touches with more than three points can share a load among them in many ways. While its points stick or
slide without friction, all of these give the same u^+. If they slide with friction, the friction of a point follows its
load, and u^+ belongs to a family. The loads of a family form a polytope, at whose corners at most three points of a
face are loaded. So the problem is solved for every choice of three points of every such face, with the solution of the
impact map as first guess. The solutions that obey the laws of the whole problem span the **spread**.

The impact map returns the solution for points of equal compliance (:mod:`impact_rs_sim.impact_map.laws`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_rs_sim.impact_map.contacts import find_contacts
from impact_rs_sim.impact_map.laws import ContactTerms, System, build_system, newton, solve_contacts
from impact_rs_sim.impact_map.problem import ImpactProblem, check_problem
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import RobotModel

WARNING = 1e-3  # of the ante-impact speed; a prediction with a larger spread gets a warning
LAWFUL = 1e-6  # m/s, largest residual at all points of a solution for some of them
MAX_CHOICES = 200  # choices of points that are tried; two faces of four points have 25
CHOICE = "contact points of equal compliance (least norm)"


@dataclass(frozen=True)
class Uniqueness:
    """Spread of the solutions of one problem.

    Attributes:
        spread: Largest difference of two answers in a linear velocity of an end effector or the object [m/s].
        relative: Spread over the largest ante-impact speed of all bodies [-].
        answers: Number of lawful solutions found, including the solution of the impact map.
    """

    spread: float
    relative: float
    answers: int

    @property
    def unique(self) -> bool:
        """Whether the solutions agree within ``WARNING`` of the ante-impact speed."""
        return self.relative <= WARNING

    @property
    def warning(self) -> str:
        """Warning for the user; empty if the solution is unique."""
        if self.unique:
            return ""
        return (
            f"u+ is not unique: answers that obey all laws differ by {self.spread:.2g} m/s ({self.relative:.2%} of the "
            f"ante-impact speed), because sliding points can share their load in many ways; shown is the answer for "
            f"{CHOICE}"
        )


def uniqueness_of(problem: ImpactProblem, models: Mapping[str, RobotModel] | None = None) -> Uniqueness:
    """Spread of the solutions of a problem; of its compression phase under Poisson's law.

    Args:
        problem: The problem.
        models: Rigid-body models by arm, where the caller has them already.

    Raises:
        InputError: The problem is refused (see :func:`check_problem`).
    """
    if models is None:
        models = problem.physics.robot_models()
    pairs = check_problem(problem, models)
    system = build_system(problem, models)
    restitution = problem.restitution if problem.restitution_law == "newton" else 0.0
    terms = ContactTerms.of(system, find_contacts(problem.physics, pairs), restitution)
    return spread_of(system, lawful_answers(terms))


def lawful_answers(terms: ContactTerms) -> list[Array]:
    """u^+ of every solution found, the solution of the impact map first, ``(nv,)`` each."""
    chosen, _ = solve_contacts(terms)
    answers = [terms.before + terms.response @ chosen.ravel()]
    for choice in itertools.islice(
        _choices([(contact.body, contact.partner) for contact in terms.contacts]), MAX_CHOICES
    ):
        impulses = np.zeros_like(chosen)
        impulses[choice], converged = newton(_at_points(terms, choice), chosen[choice])
        velocity = terms.before + terms.response @ impulses.ravel()
        if converged and terms.residual(impulses, velocity).largest <= LAWFUL:
            answers.append(velocity)
    return answers


def spread_of(system: System, answers: Sequence[Array]) -> Uniqueness:
    """Spread of solutions ``(nv,)`` of one problem."""
    speeds = np.array([_linear(system, answer) for answer in answers])
    spread = float(np.max(np.ptp(speeds, axis=0)))
    before = float(np.max(np.linalg.norm(_linear(system, system.velocity).reshape(-1, 3), axis=1)))
    return Uniqueness(spread, spread / before if before > 0.0 else 0.0, len(answers))


def _linear(system: System, velocity: Array) -> Array:
    """Linear velocities of all end effectors and objects, in a row [m/s]."""
    _, twists, object_ = system.split(velocity)
    neighbours = system.neighbour_twists(velocity)
    return np.concatenate([twist[:3] for twist in (*twists.values(), object_, *neighbours.values())])


def _choices(partners: Sequence[tuple[str, str]]) -> itertools.chain[list[int]]:
    """Choices of points: of every face with more than three points, three or all of them."""
    faces = []
    for name in dict.fromkeys(partners):
        points = [index for index, partner in enumerate(partners) if partner == name]
        corners = list(itertools.combinations(points, 3)) if len(points) > 3 else []
        faces.append([tuple(points), *corners])
    product = itertools.product(*faces)
    next(product)  # all points of all faces: the problem itself
    return itertools.chain(sorted(itertools.chain(*choice)) for choice in product)


def _at_points(terms: ContactTerms, points: Sequence[int]) -> ContactTerms:
    """The problem at some of its contact points."""
    rows = np.ravel([[3 * point, 3 * point + 1, 3 * point + 2] for point in points])
    indices = list(points)
    return replace(
        terms,
        contacts=[terms.contacts[point] for point in points],
        jacobian=terms.jacobian[rows],
        response=terms.response[:, rows],
        normals=terms.normals[indices],
        friction=terms.friction[indices],
        rebound=terms.rebound[indices],
        inverse_mass=terms.inverse_mass[indices],
    )
