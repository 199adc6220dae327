# SPDX-License-Identifier: Apache-2.0
"""A change as a person says it: kilograms, percent, and the parameters behind them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.following.announcement import in_words
from impact_rs_analysis.following.documents import Followed
from impact_rs_analysis.following.proposals import ProposedMeasurement, measurement_words, most_decisive
from impact_rs_sim.effects import library
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario

PUSH = load_scenario("push")
JUICE, PARCEL = (Physics.nominal(PUSH, name) for name in ("juice", "parcel"))


def words(effect: str, name: str, before: Sequence[float], after: Sequence[float], *scenes: Physics) -> str:
    """The change of the first parameter, known to 0.01."""
    old, new = before[0], after[0]
    moved = Followed(
        parameter=f"{effect}.{name}", estimate=new, ci95=(new - 0.01, new + 0.01), change=new - old, unit="-"
    )
    law = library()[effect]
    pairs = [tuple(law.apply_vector(scene, np.array(values)) for values in (before, after)) for scene in scenes]
    return in_words(effect, [moved], pairs)  # type: ignore[arg-type]


def test_mass_is_said_in_kilograms_of_the_objects_that_were_hit() -> None:
    light, heavy = (f"{0.246 * scene.object.mass:.2g}" for scene in (PARCEL, JUICE))
    interval = "(object_mass: scale +0.246 [0.236, 0.256])"
    assert words("object_mass", "scale", [1.0], [1.246], JUICE) == f"the object is {heavy} kg heavier {interval}"
    both = words("object_mass", "scale", [1.0], [1.246], JUICE, PARCEL)
    assert both == f"the object is {light} to {heavy} kg heavier {interval}"
    assert words("object_mass", "scale", [1.246], [1.0], JUICE).startswith(f"the object is {heavy} kg lighter (")


def test_friction_is_said_in_percent_of_what_it_was_just_before() -> None:
    friction = JUICE.support_friction
    first = words("support_friction", "friction", [0.0], [0.1], JUICE, PARCEL)
    assert first.startswith(f"friction of the support is {10.0 / friction:.2g} % higher (support_friction: friction")
    again = words("support_friction", "friction", [0.1], [0.0], JUICE)
    assert again.startswith(f"friction of the support is {10.0 / (friction + 0.1):.2g} % lower (")


def test_joints_that_warm_up_lose_a_share_of_their_friction_and_from_none_gain_it_in_newton_metres() -> None:
    before, after = [0.2] * 7, [0.15] * 7
    warmer = words("joint_coulomb_friction", "coulomb_joint1", before, after, JUICE)
    assert warmer.startswith("dry friction of the joints is 25 % lower (joint_coulomb_friction: coulomb_joint1 -0.050")
    assert words("joint_coulomb_friction", "coulomb_joint1", [0.0] * 7, before, JUICE).startswith(
        "dry friction of the joints is 0.2 N m higher (joint_coulomb_friction: coulomb_joint1 +0.200"
    )


def test_friction_of_a_pad_without_any_is_said_as_it_is() -> None:
    smooth = replace(JUICE, pad_friction=0.0)
    assert words("pad_friction", "friction", [0.0], [0.25], smooth).startswith("friction of the pad is 0.25 higher (")


HIT, LIFT = ProposedMeasurement("a hit", (1.0, 9.0), "9"), ProposedMeasurement("a lift", (9.0, 1.0), "12 N")


@pytest.mark.parametrize(
    ("found", "shares", "expected"),
    [
        ((HIT, LIFT), (0.3, 0.2), "a lift distinguishes mass from friction (12 N)"),
        ((HIT, LIFT), (0.2, 0.3), "a hit distinguishes mass from inertia (9)"),
        ((HIT, LIFT, ProposedMeasurement("both", (9.0, 9.0), "1")), (0.2, 0.3), "both distinguishes them (1)"),
        (
            (ProposedMeasurement("another hit", (1.0, 9.0), "9"), HIT),
            (0.2, 0.3),
            "another hit distinguishes mass from inertia (9)",
        ),
    ],
)
def test_what_tells_the_likelier_causes_apart_is_proposed_and_of_equals_the_first(
    found: Sequence[ProposedMeasurement], shares: Sequence[float], expected: str
) -> None:
    best = most_decisive(found, shares)
    assert best is not None and measurement_words(best, "mass", ("friction", "inertia")) == expected


def test_what_tells_nothing_apart_is_not_proposed() -> None:
    assert most_decisive([ProposedMeasurement("a hit", (1.0, 1.9), "1")], (0.2, 0.3)) is None
