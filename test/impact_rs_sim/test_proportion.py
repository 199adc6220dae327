# SPDX-License-Identifier: Apache-2.0
"""Size of a robot beside the arm for which limits were chosen."""

from __future__ import annotations

from dataclasses import replace

import pytest

from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.scenario import load_scenario


def of(physics: Physics, mass: float = 1.0) -> Proportion:
    """Proportion of the arms with links of so many times their mass."""
    arms = {}
    for name, arm in physics.arms.items():
        links = tuple(link.model_copy(update={"mass": mass * link.mass}) for link in arm.facts.links)
        arms[name] = replace(arm, facts=arm.facts.model_copy(update={"links": links}))
    return Proportion.of(replace(physics, arms=arms))


@pytest.mark.parametrize("scenario", ["push", "grab", "excite"])
def test_a_franka_arm_is_the_measure(scenario: str) -> None:
    loaded = load_scenario(scenario)
    size = Proportion.of(Physics.nominal(loaded, next(iter(loaded.objects))))
    for unit in ("N m", "kg", "rad/s", "m/s", "N s/m", "m/(s N)", "-"):
        assert size.factor(unit) == pytest.approx(1.0, abs=1e-6)


def test_torques_of_a_heavier_arm_are_larger_and_its_speeds_are_not() -> None:
    physics = Physics.nominal(load_scenario("push"), "juice")
    size = of(physics, 3.0)
    expected = {"N m": 3.0, "N": 3.0, "kg": 3.0, "m/N": 1.0 / 3.0, "rad/s": 1.0, "m/s": 1.0, "s": 1.0, "-": 1.0}
    for unit, factor in expected.items():
        assert size.factor(unit) == pytest.approx(factor, rel=1e-6), unit


def test_on_the_moon_everything_takes_longer() -> None:
    physics = Physics.nominal(load_scenario("push"), "juice")
    moon = Proportion.of(replace(physics, gravity=physics.gravity / 6.0))
    assert moon.factor("s") == pytest.approx(6.0**0.5, rel=1e-4)
    assert moon.factor("N m") == pytest.approx(1.0 / 6.0, rel=1e-4)  # of its own weight


def test_a_scene_without_an_arm_has_no_proportion() -> None:
    physics = Physics.nominal(load_scenario("push"), "juice")
    assert Proportion.of(replace(physics, arms={})) == Proportion()


def test_a_unit_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="'lb' is not understood"):
        Proportion().factor("lb m")


def test_ranges_of_an_effect_grow_with_the_robot_and_ratios_do_not() -> None:
    size = Proportion(mass=2.0)
    for effect in library().values():
        for before, after in zip(effect.parameters, effect.in_proportion(size).parameters, strict=True):
            factor = size.factor(before.unit)
            assert (after.lower, after.upper, after.scale) == pytest.approx(
                (factor * before.lower, factor * before.upper, factor * before.scale)
            )
            assert before.unit != "-" or after == before
