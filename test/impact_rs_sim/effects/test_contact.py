"""Contacts: a box on a pad that lies like a tray, and on a table."""

from dataclasses import replace

import numpy as np
import pytest
from bench import BOX, GRAVITY, REACH, bench, run, slope, switched_on, with_support

ON_PAD = (REACH, 0.0, BOX / 2.0)
DEAD = 1.8 * np.sqrt(2.0e4)  # N s/m, 0.9 of the critical damping of 1 kg on the pad: restitution 0.0015


def slowed_by(name, scale, **sliding):
    """Deceleration of a box that slides along +x, away from the axis, under an effect of friction [m/s^2]."""
    physics = switched_on(with_support(bench(), -1.0), name, scale=scale)
    motion = run(physics, seconds=0.1, box_twist=(0.6, 0.0, 0.0, 0.0, 0.0, 0.0), **sliding)
    return -slope(motion.time, motion.box_velocity[:, 0], 0.01, 0.06)


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.6])
def test_support_friction_slows_a_sliding_box_by_mu_g(scale):
    found = slowed_by("support_friction", scale, box=(1.0, 0.0, -1.0 + BOX / 2.0))
    assert found == pytest.approx(scale * 0.3 * GRAVITY, rel=0.02)


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.6])
def test_pad_friction_slows_a_box_that_slides_on_the_pad_by_mu_g(scale):
    settled = BOX / 2.0 - GRAVITY / 2.0e4
    found = slowed_by("pad_friction", scale, box=(REACH, 0.0, settled))
    assert found == pytest.approx(scale * 0.5 * GRAVITY, rel=0.03)


@pytest.mark.parametrize("scale", [0.5, 1.0, 4.0])
def test_a_box_sinks_into_the_pad_by_its_weight_over_the_stiffness(scale):
    motion = run(switched_on(bench(), "pad_compliance", scale=scale), seconds=1.0, box=ON_PAD)
    assert BOX / 2.0 - motion.box[-1, 2] == pytest.approx(GRAVITY / (scale * 2.0e4), rel=0.02)


def test_a_rigid_pad_stays_rigid():
    physics = bench()
    rigid = replace(physics, arms={"arm": replace(physics.arms["arm"], pad_stiffness=None)})
    for name, values in (("pad_compliance", {"scale": 3.0}), ("restitution", {"restitution": 0.5})):
        assert switched_on(rigid, name, **values).arms["arm"] is rigid.arms["arm"]


def bounce(restitution):
    """Speed after over speed before of a box of 1 kg that is dropped on a pad that cannot give way."""
    physics = bench()
    arm = replace(physics.arms["arm"], pad_damping=DEAD)
    physics = switched_on(replace(physics, arms={"arm": arm}), "restitution", restitution=restitution)
    motion = run(physics, seconds=0.08, box=(REACH, 0.0, BOX / 2.0 + 0.01), box_twist=(0.0, 0.0, -1.0, 0.0, 0.0, 0.0))
    return motion.box_velocity[:, 2].max() / -motion.box_velocity[:, 2].min()


@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.9])
def test_a_box_bounces_off_the_pad_with_its_restitution(restitution):
    assert bounce(restitution) == pytest.approx(restitution, abs=0.08)


def test_more_restitution_is_less_damping_and_none_is_the_pad_as_it_was():
    physics = bench()
    assert switched_on(physics, "restitution").arms["arm"] is physics.arms["arm"]
    dampings = [
        switched_on(physics, "restitution", restitution=value).arms["arm"].pad_damping for value in (0.2, 0.4, 0.6)
    ]
    assert np.all(np.diff([physics.arms["arm"].pad_damping, *dampings]) < 0.0)
