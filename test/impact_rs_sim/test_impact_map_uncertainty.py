# SPDX-License-Identifier: Apache-2.0
"""Intervals of a prediction and the budget of what makes them."""

from __future__ import annotations

import numpy as np
import pytest
from impact_map_cases import nominal

from impact_rs_sim.impact_map.derivatives import change, differentiate, velocity_names
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.impact_map.uncertainty import (
    Stopped,
    _switches,
    answer_of,
    draw,
    interval_of_draws,
    possible,
    predict,
    sources_of,
)
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scenarios.trial_settings import ASSUMED_MOTOR_INERTIA, Uncertainties
from impact_rs_sim.scene import Scene

NONE = dict.fromkeys(Uncertainties.model_fields, 0.0)
PROBLEM: ImpactProblem = nominal()
MODELS = {"arm": PROBLEM.physics.robot_model("arm")}


def test_mass_alone_gives_the_interval_of_its_derivative() -> None:
    predicted = predict(PROBLEM, Uncertainties(**NONE | {"object_mass": 0.02}), MODELS, draws=8)
    assert predicted.method == "linear"
    found = differentiate(PROBLEM)
    thing = PROBLEM.physics.object
    column = found.of("object.mass") * thing.mass
    column = column + sum(thing.inertia[axis] * found.of(f"object.inertia.{name}") for axis, name in enumerate("xyz"))
    index = predicted.names.index("object.velocity.y")
    half = 0.02 * abs(column[index])
    assert predicted.high[index] - predicted.low[index] == pytest.approx(2.0 * half, rel=1e-6)
    assert predicted.budget["object_mass"][index] == pytest.approx(1.0)


def test_shares_of_a_budget_add_up_and_intervals_add_in_squares() -> None:
    parts = {"object_mass": 0.02, "motor_inertia": 0.1}
    both = predict(PROBLEM, Uncertainties(**NONE | parts), MODELS, draws=8)
    alone = [predict(PROBLEM, Uncertainties(**NONE | {key: parts[key]}), MODELS, draws=8) for key in parts]
    np.testing.assert_allclose(both.deviation**2, sum(one.deviation**2 for one in alone), rtol=1e-9)
    index = both.names.index("arm.velocity.y")
    assert sum(share[index] for share in both.budget.values()) == pytest.approx(1.0)
    assert both.low[index] < both.nominal[index] < both.high[index]


def test_no_draw_of_an_assumed_motor_inertia_is_a_joint_without_motor() -> None:
    """Half of a 95 % interval of twice the number would make one in six motor inertias negative."""
    rng = np.random.default_rng(0)
    sources = sources_of(PROBLEM, Uncertainties(**NONE | {"motor_inertia": ASSUMED_MOTOR_INERTIA}))
    least, most = np.inf, 0.0
    for _ in range(100):
        drawn = change(PROBLEM, possible(PROBLEM, draw(sources, rng))).problem.motor_inertia["arm"]
        shares = drawn / PROBLEM.motor_inertia["arm"]
        least, most = min(least, shares.min()), max(most, shares.max())
    assert least == pytest.approx(0.1) and most > 3.0


def test_a_restitution_below_zero_is_in_no_interval() -> None:
    """Kills linear propagation across the end of a range: restitution of 0 and more makes the object faster only."""
    predicted = predict(PROBLEM, Uncertainties(**NONE | {"restitution": 0.2}), MODELS, draws=24)
    assert (predicted.method, predicted.switched) == ("monte_carlo", 0.0)
    index = predicted.names.index("object.velocity.y")
    slow, fast = sorted((abs(predicted.low[index]), abs(predicted.high[index])))
    assert slow == pytest.approx(abs(predicted.nominal[index]), rel=1e-6) and fast > 1.1 * slow


def test_draws_of_a_smooth_problem_scatter_as_linear_propagation_says() -> None:
    stated = Uncertainties(**NONE | {"object_mass": 0.02, "motor_inertia": 0.1, "link_inertia": 0.05})
    predicted = predict(PROBLEM, stated, MODELS, draws=8)
    rng, sources = np.random.default_rng(1), sources_of(PROBLEM, stated)
    sample = np.array([answer_of(PROBLEM, MODELS, draw(sources, rng))[0] for _ in range(150)])
    index = predicted.names.index("object.velocity.y")
    assert np.std(sample[:, index]) == pytest.approx(predicted.deviation[index], rel=0.2)


def test_where_contacts_switch_the_interval_is_that_of_the_draws() -> None:
    # Yaw of a few mrad lets an edge of the pad hit first.
    predicted = predict(PROBLEM, Uncertainties(**NONE | {"object_yaw": 0.012}), MODELS, draws=24)
    assert predicted.method == "monte_carlo"
    assert predicted.switched > 0.5
    index = predicted.names.index("object.velocity.y")
    assert predicted.budget["object_pose"][index] == pytest.approx(1.0)


def test_pads_come_on_until_they_touch() -> None:
    for amount in (-0.004, 0.004):
        moved = change(PROBLEM, {"object.position.y": amount})
        _, terms = moved.touching_terms(MODELS, {"arm"})
        pads = [contact for contact in terms.contacts if contact.partner == "arm"]
        assert len(pads) == 4
        velocities, states = answer_of(PROBLEM, MODELS, {"object.position.y": amount})
        assert states == answer_of(PROBLEM, MODELS, {})[1]
        np.testing.assert_allclose(velocities, answer_of(PROBLEM, MODELS, {})[0], atol=1e-6)


def test_every_velocity_has_a_name() -> None:
    predicted = predict(PROBLEM, Uncertainties(**NONE), MODELS, draws=2)
    assert len(predicted.names) == len(predicted.nominal) == 7 + 6 + 6
    assert predicted.names == velocity_names(PROBLEM)
    np.testing.assert_array_equal(predicted.low, predicted.high)


def test_the_interval_of_a_combination_includes_covariance() -> None:
    found = predict(PROBLEM, Uncertainties(**NONE | {"object_mass": 0.02}), MODELS, draws=8)
    assert found.method == "linear"
    for index, name in enumerate(found.names):
        assert found.interval_of({name: 1.0}) == pytest.approx((found.low[index], found.high[index]), abs=1e-12)
    one, other = "arm.velocity.y", "object.velocity.y"
    # One source alone moves both, so that the widths of a sum add, and those of a difference cancel.
    widths = {name: np.diff(found.interval_of({name: 1.0}))[0] for name in (one, other)}
    sum_ = np.diff(found.interval_of({one: 1.0, other: 1.0}))[0]
    difference = np.diff(found.interval_of({one: 1.0, other: -1.0}))[0]
    assert sum_ == pytest.approx(widths[one] + widths[other], rel=1e-6)
    assert difference == pytest.approx(abs(widths[one] - widths[other]), abs=1e-9)
    parts = {"object_mass": 0.02, "motor_inertia": 0.1}  # sources are independent: their widths add in squares
    squares = []
    for stated in (parts, *({key: value} for key, value in parts.items())):
        predicted = predict(PROBLEM, Uncertainties(**NONE | stated), MODELS, draws=8)
        squares.append(np.diff(predicted.interval_of({one: 1.0, other: 1.0}))[0] ** 2)
    assert squares[0] == pytest.approx(squares[1] + squares[2], rel=1e-9)


def test_the_interval_of_a_combination_of_draws_is_theirs() -> None:
    found = predict(PROBLEM, Uncertainties(**NONE | {"object_yaw": 0.012}), MODELS, draws=24)
    assert found.method == "monte_carlo"
    sum_ = (
        found.sample[:, found.names.index("arm.velocity.y")] + found.sample[:, found.names.index("object.velocity.y")]
    )
    expected = np.quantile(sum_, [0.025, 0.975])
    assert found.interval_of({"arm.velocity.y": 1.0, "object.velocity.y": 1.0}) == pytest.approx(expected)


def test_few_draws_give_nearly_the_interval_of_many_repeatably() -> None:
    predicted = predict(PROBLEM, Uncertainties(), MODELS)
    names, low, high = interval_of_draws(PROBLEM, Uncertainties(), MODELS, 16)
    place = names.index("arm.velocity.y")
    assert names == predicted.names
    assert high[place] - low[place] == pytest.approx(predicted.high[place] - predicted.low[place], rel=0.5)
    again = interval_of_draws(PROBLEM, Uncertainties(), MODELS, 16)
    assert np.array_equal(low, again[1])
    assert np.array_equal(high, again[2])


def at_impact(name: str, thing: str, case: str, **settings: float) -> tuple[ImpactProblem, Uncertainties]:
    scenario = load_scenario(name).with_settings(settings)
    return ImpactProblem.at_nominal_impact(Scene.resolve(scenario, thing, case), "reduced"), scenario.uncertainty


def test_a_box_out_of_reach_is_hit_in_no_draw() -> None:
    problem, stated = at_impact("excite", "none", "slow")
    predicted = predict(problem, stated, draws=16)
    before = problem.physics.robot_model("arm").jacobian(problem.arms["arm"].position) @ problem.arms["arm"].velocity
    index = predicted.names.index("arm.velocity.y")
    assert predicted.nominal[index] == pytest.approx(before[1])
    assert (predicted.method, predicted.switched, dict(predicted.switches)) == ("linear", 0.0, {})
    assert predicted.high[index] - predicted.low[index] < 0.02
    np.testing.assert_array_equal(predicted.sample[:, -6:], 0.0)  # the box stays where it is


def test_a_box_almost_in_reach_is_hit_in_some_draws_and_that_is_said() -> None:
    """A gap of 2.5 mm, a position known to 2 mm, a millimetre at which contacts close."""
    problem, stated = at_impact("excite", "none", "slow", object_gap=0.0025)
    predicted = predict(problem, stated, draws=60)
    share = predicted.switches["arm hits the object, in the prediction not"]
    assert 0.05 < share < 0.5
    index = predicted.names.index("object.velocity.y")
    assert predicted.nominal[index] == predicted.high[index] == 0.0
    assert np.mean(predicted.sample[:, index] < -0.1) == pytest.approx(share)


@pytest.mark.parametrize("draws", [4, 24])
def test_an_interval_contains_its_own_prediction(draws: int) -> None:
    """Yaw of either sign lets an edge of the pad hit first: the prediction, a flat pad, is the end of all draws."""
    stated = Uncertainties(**NONE | {"object_yaw": 0.012})
    predicted = predict(PROBLEM, stated, MODELS, draws=draws)
    _, low, high = interval_of_draws(PROBLEM, stated, MODELS, draws)
    assert predicted.method == "monte_carlo"
    assert np.all((predicted.low <= predicted.nominal) & (predicted.nominal <= predicted.high))
    assert np.all((low <= predicted.nominal) & (predicted.nominal <= high))
    for index, name in enumerate(predicted.names):
        assert predicted.interval_of({name: 1.0}) == pytest.approx((predicted.low[index], predicted.high[index]))


def test_contacts_that_switch_are_said_in_words() -> None:
    stick, slide, away = (("object", "arm", state) for state in ("stick", "slide", "open"))
    lifted, loaded = (("object", "support", state) for state in ("open", "stick"))
    usual = (stick, stick, lifted)
    assert _switches(usual, [(away, slide, lifted), (away, loaded), (slide, stick)]) == {
        "arm hits the object at 1 point, in the prediction at 2": pytest.approx(1 / 3),
        "arm does not hit the object, in the prediction it does": pytest.approx(1 / 3),
        "the object presses on its support, in the prediction not": pytest.approx(1 / 3),
        "arm hits the object and sticks or slides otherwise than in the prediction": pytest.approx(1 / 3),
    }
    assert _switches(usual, [usual] * 3) == {}


def test_contacts_of_a_neighbour_are_named_after_it() -> None:
    """Kills: contacts are told apart by their partner alone, so that "object hits the object" is said."""
    stick, slide = (("second", "object", state) for state in ("stick", "slide"))
    lifted, loaded = ([(body, "support", state) for body in ("object", "second")] for state in ("open", "stick"))
    assert _switches((stick, *lifted), [(slide, lifted[0], loaded[1])]) == {
        "the object hits second and sticks or slides otherwise than in the prediction": 1.0,
        "second presses on its support, in the prediction not": 1.0,
    }


def test_a_prediction_that_nobody_waits_for_ends_at_its_next_draw() -> None:
    asked = []
    with pytest.raises(Stopped):
        predict(PROBLEM, load_scenario("push").uncertainty, MODELS, stopped=lambda: asked.append(1) or len(asked) > 3)
    assert len(asked) == 4
