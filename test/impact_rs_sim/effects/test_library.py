"""Effects: nothing at their nominal values, their own signature otherwise, and found again by a fit."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from impact_rs_analysis.evidence.rollouts import Rollout, run_rollout
from impact_rs_analysis.evidence.runs import Condition
from impact_rs_sim.effects import BUILT_IN, Effect, library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.physics import LoadState, Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

NAMES = [effect.name for effect in BUILT_IN]


@pytest.fixture(scope="module")
def physics():
    return Physics.nominal(load_scenario("push"), "juice")


def condition(scenario, thing, case):
    return Condition(TrialSpec.of(load_scenario(scenario), thing, case))


@pytest.fixture(scope="module")
def conditions():
    return {"free": condition("excite", "none", "fast"), "contact": condition("push", "juice", "case_2")}


@pytest.fixture(scope="module")
def nominal_features(conditions):
    return {kind: run_rollout(Rollout(item, Model(name="nominal"))) for kind, item in conditions.items()}


def nominal(effect):
    return np.array([scalar.nominal for scalar in effect.scalars(7)])


@pytest.mark.parametrize("name", NAMES)
def test_effect_at_its_nominal_values_changes_nothing(name, physics):
    effect = library()[name]
    same = effect.apply_vector(physics, nominal(effect))
    for arm in same.arms:
        before, after = physics.arms[arm], same.arms[arm]
        for field in (
            "motor_inertia_rotor",
            "motor_inertia_reduced",
            "stiffness",
            "damping",
            "torque_offset",
            "torque_gain",
        ):
            np.testing.assert_array_equal(getattr(before, field), getattr(after, field))
        assert after.end_effector.mass == pytest.approx(before.end_effector.mass)
        np.testing.assert_allclose(after.end_effector.com, before.end_effector.com, atol=1e-15)
        np.testing.assert_allclose(after.end_effector.inertia, before.end_effector.inertia, atol=1e-15)
        assert (after.pad_stiffness, after.pad_damping) == pytest.approx((before.pad_stiffness, before.pad_damping))
        np.testing.assert_array_equal(after.friction.torque(np.full(7, 0.3)), before.friction.torque(np.full(7, 0.3)))
        assert after.actuation_delay == before.actuation_delay
    np.testing.assert_allclose(same.gravity, physics.gravity, atol=1e-15)
    assert same.object.mass == pytest.approx(physics.object.mass)
    assert (same.pad_friction, same.support_friction) == (physics.pad_friction, physics.support_friction)


@pytest.mark.parametrize("name", NAMES)
def test_effect_says_what_it_is_in_words_units_and_bounds(name):
    effect = library()[name]
    assert effect.sentence.endswith(".") and effect.acts_on
    for scalar in effect.scalars(7):
        assert scalar.lower <= scalar.nominal <= scalar.upper
        assert scalar.scale > 0.0 and scalar.unit and scalar.meaning


@pytest.mark.parametrize("name", NAMES)
def test_planted_effect_is_recovered_through_the_twin(name, conditions, nominal_features):
    """A size is planted along a direction; the features of the twin lead back to it."""
    effect: Effect = library()[name]
    kind = "contact" if effect.phases == ("contact",) else "free"
    direction = np.array([scalar.scale for scalar in effect.scalars(7)])
    if name == "joint_stribeck_friction":
        direction[-1] = 0.0
    if name == "end_effector_payload":
        direction[1:] = 0.0
    if name == "pad_friction":
        direction[:] = -0.4  # more friction on a pad that sticks anyway cannot be seen; less makes it slide
    floor = np.array([feature.floor for feature in conditions[kind].features])

    def features(size):
        values = nominal(effect) + size * direction
        vector = tuple(float(value) for value in values)
        return run_rollout(Rollout(conditions[kind], Model(name="nominal"), ((name, vector),)))

    planted = 2.0
    rng = np.random.default_rng(0)
    base = nominal_features[kind]
    measured = features(planted) + 0.3 * floor * rng.standard_normal(floor.size)
    if name == "pad_friction":  # nothing happens until the pad slides: no slope to follow, but a minimum to find
        found = minimize_scalar(
            lambda size: np.sum(np.square((features(size) - measured) / floor)),
            bounds=(0.0, 2.45),
            method="bounded",
            options={"maxiter": 12, "xatol": 0.02},
        ).x
        assert found == pytest.approx(planted, rel=0.1)
        return
    slope = (features(1.5) - base) / floor / 1.5
    assert np.abs(slope).max() > 1.0, "one scale of the effect must be seen in at least one feature"
    found = float(slope @ ((measured - base) / floor) / (slope @ slope))
    secant = (features(found) - base) / floor / found
    found = float(secant @ ((measured - base) / floor) / (secant @ secant))
    assert found == pytest.approx(planted, rel=0.1)


def test_wrong_number_of_parameters_is_refused(physics):
    with pytest.raises(InputError, match="7 finite numbers"):
        library()["torque_offset"].apply_vector(physics, np.zeros(6))
    with pytest.raises(InputError, match="7 finite numbers"):
        library()["torque_offset"].apply_vector(physics, np.full(7, np.nan))


def test_payload_follows_the_parallel_axis_theorem(physics):
    values = np.array([0.5, 0.03, -0.02, 0.05])
    tool = library()["end_effector_payload"].apply_vector(physics, values).arms["arm"].end_effector
    before = physics.arms["arm"].end_effector
    origin = before.inertia + before.mass * (before.com @ before.com * np.eye(3) - np.outer(before.com, before.com))
    added = values[0] * (values[1:] @ values[1:] * np.eye(3) - np.outer(values[1:], values[1:]))
    about_origin = tool.inertia + tool.mass * (tool.com @ tool.com * np.eye(3) - np.outer(tool.com, tool.com))
    np.testing.assert_allclose(about_origin, origin + added, atol=1e-12)
    np.testing.assert_allclose(tool.mass * tool.com, before.mass * before.com + values[0] * values[1:], atol=1e-12)


def test_tilt_turns_gravity_but_keeps_its_size(physics):
    tilted = library()["base_tilt"].apply_vector(physics, np.array([0.05, -0.03])).gravity
    assert np.linalg.norm(tilted) == pytest.approx(9.81)
    assert tilted[1] == pytest.approx(-9.81 * np.sin(0.05) * np.cos(-0.03), rel=1e-3)


def test_spring_pulls_back_in_proportion_to_distance(physics):
    load = library()["external_spring"].apply_vector(physics, np.array([1.0, 2.0, 3.0, 50.0])).arms["arm"].loads[0]
    here = np.array([0.4, 0.0, 0.5])
    state = LoadState(0.0, np.zeros(7), np.zeros(7), here + np.array([0.1, 0.0, 0.0]), np.zeros(3), here)
    np.testing.assert_allclose(load.end_effector_force(state), [1.0 - 5.0, 2.0, 3.0])
