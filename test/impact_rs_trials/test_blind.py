"""Blind campaigns: what is hidden is drawn from the seed, within the bounds that effects declare."""

import numpy as np
import pytest

from impact_rs_sim.effects import library
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.blind import draw, draw_truth, hide


@pytest.mark.parametrize("name", sorted(library()))
@pytest.mark.parametrize("joint_count", [6, 7])
def test_hidden_values_are_some_scales_from_nominal_within_nine_tenths_of_the_bounds(name, joint_count):
    for seed in range(40):
        for magnitude in (1.0, 4.0, 50.0):
            hidden = draw(name, magnitude, np.random.default_rng(seed), joint_count)
            scalars = library()[name].scalars(joint_count)
            assert len(hidden.values) == len(scalars)
            for value, scalar in zip(hidden.values, scalars, strict=True):
                if scalar.hidden is not None:
                    assert scalar.hidden[0] <= value <= scalar.hidden[1]
                    continue
                room = 0.9 * np.array([scalar.nominal - scalar.lower, scalar.upper - scalar.nominal])
                assert -room[0] - 1e-12 <= value - scalar.nominal <= room[1] + 1e-12
                side = room[1] if value > scalar.nominal else room[0]
                away = abs(value - scalar.nominal)
                assert away == pytest.approx(side) or 0.7 <= away / (magnitude * scalar.scale) <= 1.3


def test_a_hidden_payload_adds_mass_and_goes_up_to_nine_tenths_of_the_bound():
    masses = [draw("end_effector_payload", size, np.random.default_rng(7), 7).values[0] for size in (1.0, 100.0)]
    assert 0.07 <= masses[0] <= 0.13
    assert masses[1] == pytest.approx(2.7)


def test_effects_that_can_go_both_ways_do():
    offsets = np.array([draw("torque_offset", 1.0, np.random.default_rng(seed), 7).values for seed in range(20)])
    assert np.all((offsets > 0.0).any(axis=0) & (offsets < 0.0).any(axis=0))


def test_the_same_seed_hides_the_same_as_ever():
    """Numbers of the first release: published blind campaigns can be made again."""
    (payload,) = draw_truth(5, "single", "end_effector_payload", None)
    assert payload.values == pytest.approx(
        (0.8294326025098256, 0.01218952892703902, -0.021239183866414085, -0.04780629373298296), rel=1e-14
    )
    (sticky,) = draw_truth(3, "single", "joint_stribeck_friction", None)
    assert (sticky.values[0], sticky.values[-1]) == pytest.approx((0.20513311108996682, 0.07694738285947944), rel=1e-14)
    first, second = draw_truth(11, "pair", None, None)
    assert (first.name, second.name) == ("external_spring", "joint_stiffness")
    physics = hide(Physics.nominal(load_scenario("push"), "juice"), [payload])
    assert physics.arms["arm"].end_effector.mass == pytest.approx(0.6 + payload.values[0])
