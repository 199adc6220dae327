# SPDX-License-Identifier: Apache-2.0
"""Predictions of the sliders: physics that everybody expects of them, and no second way to say it."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_workbench.prediction import (
    MapQuery,
    answer,
    drawn,
    map_arguments,
    settings_of,
    slider_of,
    sliders_of,
    sweep,
)

PUSH = load_scenario("push")


def question(**values: object) -> MapQuery:
    content = {"scenario": "push", "object": "cat_food", "case": "case_2", "moving": True} | values
    return MapQuery.model_validate(content)


def after(**values: float) -> float:
    """Speed of the pad along the axis after the impact [m/s]."""
    rows = answer(PUSH, question(values={key.replace("__", "."): value for key, value in values.items()}))["rows"]
    return abs(next(row["after"] for row in rows if row["main"] and row["body"] == "arm"))


def test_a_heavier_object_takes_more_of_the_velocity() -> None:
    assert after(objects__cat_food__mass=2.5) < after() < after(objects__cat_food__mass=0.5)


def test_velocities_grow_with_the_speed_before() -> None:
    assert after(speed=0.5) == pytest.approx(0.5 * after(), rel=1e-3)


def test_a_bouncing_object_leaves_faster_than_the_pad() -> None:
    rows = answer(PUSH, question(values={"contact.restitution": 0.5}))["rows"]
    speed = {row["body"]: abs(row["after"]) for row in rows if row["main"]}
    assert speed["object"] > speed["arm"]


def test_what_is_known_worse_has_a_wider_interval() -> None:
    def width(value: float) -> float:
        rows = answer(PUSH, question(values={"uncertainty.object_mass": value}))["rows"]
        return next(float(row["high"] - row["low"]) for row in rows if row["main"])

    assert width(0.2) > 1.2 * width(0.005)


def test_more_motor_inertia_keeps_more_of_the_velocity_all_along_a_slider() -> None:
    slider = slider_of(PUSH, "cat_food", "objects.cat_food.mass")
    found = drawn(question(), slider, list(sweep(PUSH, question(), slider)))
    reduced, rotor, zero = (line["y"] for line in found["lines"])
    assert all(abs(a) > abs(b) > abs(c) for a, b, c in zip(rotor, reduced, zero, strict=True))
    assert all(low <= high for low, high in zip(found["low"], found["high"], strict=True))
    assert [line["chosen"] for line in found["lines"]] == [True, False, False]


def test_every_slider_is_a_key_of_the_scenario_within_its_ends() -> None:
    for scenario in (PUSH, load_scenario("grab"), load_scenario("push_iiwa7")):
        name = next(iter(scenario.objects))
        case = next(iter(scenario.cases))
        for slider in sliders_of(scenario, name):
            assert slider.low <= slider.value <= slider.high
            for value in (slider.low, slider.high):
                asked = question(object=name, case=case, values={slider.key: value})
                scenario.with_settings(settings_of(scenario, asked))


def test_a_slider_of_another_object_is_none() -> None:
    with pytest.raises(InputError, match=r"no slider 'objects.juice.mass'; known: speed, objects.cat_food.mass"):
        settings_of(PUSH, question(values={"objects.juice.mass": 1.0}))


def test_the_command_of_untouched_sliders_sets_nothing() -> None:
    assert map_arguments("push", "nominal", question(), {}) == ["map", "push", "cat_food", "case_2", "--uncertainty"]


def test_each_of_two_arms_has_its_figure_its_budget_and_its_impulse() -> None:
    grab, places = load_scenario("grab"), {}
    slider = slider_of(grab, "cat_food", "speed")
    for arm in ("left", "right"):
        asked = question(scenario="grab", arm=arm)
        found = answer(grab, asked)
        speed = {row["body"]: row["after"] for row in found["rows"] if row["main"]}
        assert (found["arm"], list(speed)) == (arm, ["left", "right", "object"])
        impulse = {name: value[1] for name, value in found["impulses"].items()}
        assert impulse["left"] < -0.1 < 0.1 < impulse["right"]  # N s, they clamp along y
        line = drawn(asked, slider, list(sweep(grab, asked, slider)))["lines"][0]["y"]
        places[arm] = np.interp(1.0, np.linspace(slider.low, slider.high, len(line)), line)
        assert places[arm] == pytest.approx(speed[arm], abs=0.01)
    assert abs(places["left"] - places["right"]) > 0.01
    with pytest.raises(InputError, match="scenario 'grab' has no arm 'lefd'; known: left, right"):
        answer(grab, question(scenario="grab", arm="lefd"))


def test_who_contributes_most_to_the_interval_stands_first() -> None:
    budget = answer(PUSH, question(moving=False))["budget"]
    shares = [entry["share"] for entry in budget]
    assert len(shares) > 1
    assert shares == sorted(shares, reverse=True)


def test_a_figure_over_one_slider_keeps_the_other_sliders() -> None:
    asked = question(values={"contact.restitution": 0.4})
    point = next(sweep(PUSH, asked, slider_of(PUSH, "cat_food", "speed")))
    same = answer(PUSH, question(values={"contact.restitution": 0.4, "speed": point.value}))
    (row,) = [row for row in same["rows"] if row["main"] and row["body"] == "arm"]
    assert point.arms["reduced"] == pytest.approx(row["after"])
    untouched = next(sweep(PUSH, question(), slider_of(PUSH, "cat_food", "speed")))
    assert point.arms["reduced"] != pytest.approx(untouched.arms["reduced"])
