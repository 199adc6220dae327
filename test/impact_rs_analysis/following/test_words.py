# SPDX-License-Identifier: Apache-2.0
"""A change as a person says it: kilograms, percent, and the parameters behind them."""

from dataclasses import replace

import pytest

from impact_rs_analysis.following.lessons import Followed
from impact_rs_analysis.following.words import in_words
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario

PUSH = load_scenario("push")
JUICE, PARCEL = (Physics.nominal(PUSH, name) for name in ("juice", "parcel"))


def moved(parameter: str, before: float, after: float, half: float, unit: str = "-") -> Followed:
    return Followed(
        parameter=parameter, estimate=after, ci95=(after - half, after + half), change=after - before, unit=unit
    )


def of_mass(mass: float) -> Physics:
    return replace(JUICE, object=replace(JUICE.object, mass=mass))


@pytest.mark.parametrize(
    ("masses", "said"),
    [((1.25,), "the object is 0.31 kg heavier"), ((1.25, 0.5), "the object is 0.12 to 0.31 kg heavier")],
)
def test_mass_is_said_in_kilograms_of_the_objects_that_were_hit(masses: tuple[float, ...], said: str) -> None:
    words = in_words("object_mass", [moved("object_mass.scale", 1.0, 1.246, 0.007)], [of_mass(m) for m in masses])
    assert words == f"{said} (object_mass: scale +0.2460 [0.2390, 0.2530])"


def test_friction_is_said_in_percent_of_what_it_was_and_a_second_change_of_the_new_value() -> None:
    friction = JUICE.support_friction
    first = in_words("support_friction", [moved("support_friction.friction", 0.0, 0.1, 0.01)], [JUICE, PARCEL])
    assert first.startswith(f"friction of the support is {10.0 / friction:.2g} % higher (support_friction: friction")
    again = in_words("support_friction", [moved("support_friction.friction", 0.1, 0.0, 0.01)], [JUICE])
    assert f"is {10.0 / (friction + 0.1):.2g} % lower" in again


def test_what_has_no_value_before_is_said_by_its_parameter_alone() -> None:
    rubbed = moved("joint_coulomb_friction.coulomb_joint3", 0.0, 0.2, 0.01, "N m")
    assert in_words("joint_coulomb_friction", [rubbed], [JUICE]) == (
        "joint_coulomb_friction: coulomb_joint3 +0.200 N m [0.190, 0.210]"
    )
    warmer = moved("joint_coulomb_friction.coulomb_joint3", 0.2, 0.15, 0.01, "N m")
    assert in_words("joint_coulomb_friction", [warmer], [JUICE]).startswith("friction of joint 3 25 % lower")
