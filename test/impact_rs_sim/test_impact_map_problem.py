# SPDX-License-Identifier: Apache-2.0
"""Every question that the impact map refuses, and how it says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impact_map_cases import PUSH, SCENE, nominal, with_velocity

from impact_rs_sim.errors import Infeasible, InputError
from impact_rs_sim.impact_map import ImpactProblem, check_problem, sampling
from impact_rs_sim.impact_map.exact import ExactEngine
from impact_rs_sim.scene import ArmState, BodyState

GOOD = nominal()
ARM = GOOD.arms["arm"]
BODY = GOOD.object


def _position(q: np.ndarray) -> ImpactProblem:
    return replace(GOOD, arms={"arm": ArmState(q, ARM.velocity)})


def _body(**changes: np.ndarray) -> ImpactProblem:
    return replace(GOOD, object=replace(BODY, **changes))


def _thing(**changes: object) -> ImpactProblem:
    return replace(GOOD, physics=replace(GOOD.physics, object=replace(GOOD.physics.object, **changes)))


def _motor(values: np.ndarray) -> ImpactProblem:
    return replace(GOOD, motor_inertia={"arm": values})


def _with(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = np.array(values, dtype=float)
    changed[index] = value
    return changed


REFUSED = {
    "non-finite position": (_position(_with(ARM.position, 2, np.nan)), "finite.*rad"),
    "short position": (_position(ARM.position[:6]), r"7 values \[rad\]"),
    "position beyond its limit": (_position(_with(ARM.position, 3, 1.0)), "joint 4.*limits.*rad"),
    "non-finite velocity": (with_velocity(GOOD, _with(ARM.velocity, 0, np.inf)), "finite.*rad/s"),
    "velocity beyond its limit": (with_velocity(GOOD, _with(ARM.velocity, 1, 5.0)), "joint 2.*rad/s"),
    "negative motor inertia": (_motor(_with(np.ones(7), 4, -0.1)), r"motor inertia >= 0 kg m\^2"),
    "short motor inertia": (_motor(np.ones(3)), "7 values"),
    "unknown arm": (replace(GOOD, motor_inertia={"left": np.ones(7)}), "one entry per arm"),
    "restitution above one": (replace(GOOD, restitution=1.2), "between 0 and 1"),
    "restitution not a number": (replace(GOOD, restitution=float("nan")), "between 0 and 1"),
    "negative mass": (_thing(mass=-1.0), "mass > 0 kg"),
    "zero inertia": (_thing(inertia=np.zeros(3)), r"> 0 kg m\^2"),
    "zero size": (_thing(size=np.array([0.1, 0.0, 0.1])), "> 0 m"),
    "negative friction": (nominal(pad_friction=-0.1), "friction coefficient >= 0"),
    "non-finite object position": (_body(position=np.array([0.0, np.nan, 0.0])), "finite.*m"),
    "non-finite twist": (_body(twist=np.full(6, np.nan)), "finite.*m/s"),
    "stretched rotation": (_body(rotation=1.1 * np.eye(3)), "rotation matrix"),
    "reflection": (_body(rotation=np.diag([1.0, 1.0, -1.0])), "rotation matrix"),
    "pad in the object": (_body(position=BODY.position + [0.0, 0.004, 0.0]), "penetrates 'arm' by 4 mm"),
    "object in the support": (_body(position=BODY.position - [0.0, 0.0, 0.003]), "penetrates 'support' by 3 mm"),
}


STATES = ("position beyond its limit", "velocity beyond its limit", "pad in the object", "object in the support")


@pytest.mark.parametrize("case", REFUSED)
def test_bad_question_is_refused(case: str) -> None:
    """A state that cannot be is told apart from numbers that mean nothing: a search samples on past the first alone."""
    problem, message = REFUSED[case]
    with pytest.raises(InputError, match=message) as caught:
        check_problem(problem)
    assert isinstance(caught.value, Infeasible) == (case in STATES)


def test_sampling_passes_over_impossible_states_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def check(problem: ImpactProblem) -> None:
        asked.append(problem)
        if len(asked) < 3:
            raise Infeasible("the pad is in the object")
        raise InputError("a mistake")

    monkeypatch.setattr(sampling, "check_problem", check)
    with pytest.raises(InputError, match="a mistake"):
        sampling.random_problem(PUSH, np.random.default_rng(0))
    assert len(asked) == 3


def test_a_warm_engine_refuses_it_in_the_same_words() -> None:
    engine = ExactEngine(GOOD.physics)
    for values in (ARM.position[:6], np.append(ARM.position, 0.0)):
        with pytest.raises(InputError, match=r"7 values \[rad\]"):
            engine.solve(_position(values))


def test_nominal_question_passes() -> None:
    check_problem(GOOD)


def test_unknown_motor_inertia_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="reduced, rotor, zero"):
        ImpactProblem.at_nominal_impact(SCENE, "none")


def test_touching_within_the_tolerance_passes() -> None:
    check_problem(replace(GOOD, object=BodyState(BODY.position + [0.0, 0.0005, 0.0], BODY.rotation, BODY.twist)))


@pytest.mark.parametrize("motor", ["reduced", "rotor", "zero"])
def test_the_nominal_problem_is_taken_from_the_scene(motor: str) -> None:
    scene = replace(SCENE, physics=replace(SCENE.physics, restitution=0.35))
    problem = ImpactProblem.at_nominal_impact(scene, motor)
    assert problem.restitution == 0.35
    np.testing.assert_array_equal(problem.motor_inertia["arm"], scene.physics.arms["arm"].motor_inertia(motor))
    np.testing.assert_array_equal(problem.arms["arm"].velocity, scene.arms["arm"].velocity)
    np.testing.assert_array_equal(problem.object.position, scene.object.position)
