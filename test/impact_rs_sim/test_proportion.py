# SPDX-License-Identifier: Apache-2.0
"""Size of a robot beside the arm for which limits were chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.paths import config_directory
from impact_rs_sim.physics import Physics
from impact_rs_sim.proportion import Proportion, reach_of
from impact_rs_sim.robot import RobotFacts, load_facts
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


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_axes_that_meet_in_one_point_have_the_reach_of_their_mass(joints: int) -> None:
    """A point mass at 0.2 m about the common point: it can be moved as far as that, and no more."""
    link = {"mass": 1.5, "com": (0.0, 0.12, 0.16), "inertia": (1e-9, 0, 0, 1e-9, 0, 1e-9)}
    limit = (1.0,) * joints
    limits = {"position_min_rad": (-1.0,) * joints, "position_max_rad": limit, "velocity_rad_s": limit}
    facts = RobotFacts.model_validate(
        {
            "source": "by hand",
            "joints": [{"xyz": (0.0, 0.0, 0.3 * (joint == 0)), "rpy": (0.0, 0.0, 0.0)} for joint in range(joints)],
            "flange": {"xyz": (0.0, 0.0, 0.0)},
            "limits": limits | {"torque_Nm": limit},
            "links": [link] * joints,
        }
    )
    assert reach_of(facts) == pytest.approx(0.2, rel=1e-6)
    assert Proportion.of_robots([facts], np.array([0.0, 0.0, -9.81])).factor("m/N") > 0.0


@pytest.mark.parametrize("robot", sorted(path.stem for path in (config_directory() / "robots").glob("*.yaml")))
def test_the_reach_of_an_arm_is_the_length_of_its_chain(robot: str) -> None:
    facts = load_facts(robot)
    places = [*(joint.xyz for joint in facts.joints[1:]), facts.flange.xyz]
    assert reach_of(facts) == pytest.approx(sum(float(np.linalg.norm(place)) for place in places), abs=1e-12)


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
