# SPDX-License-Identifier: Apache-2.0
"""Object and surroundings: mass, centre of mass; where gravity comes from, and which way a cable pulls."""

from dataclasses import replace

import numpy as np
import pytest
from bench import (
    BOX,
    FIRST_MOMENT,
    GRAVITY,
    MASS_MATRIX,
    MOTOR_INERTIA,
    PAD,
    REACH,
    bench,
    run,
    slope,
    switched_on,
    with_support,
)

from impact_rs_sim.effects import library
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario

# ---- object ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_object_mass_is_what_the_pad_carries(scale):
    motion = run(switched_on(bench(), "object_mass", scale=scale), seconds=1.0, box=(REACH, 0.0, BOX / 2.0))
    assert BOX / 2.0 - motion.box[-1, 2] == pytest.approx(scale * GRAVITY / 2.0e4, rel=0.02)


def test_the_inertia_of_the_object_grows_with_its_mass():
    physics = bench()
    heavier = switched_on(physics, "object_mass", scale=2.5).object
    np.testing.assert_allclose(heavier.inertia, 2.5 * physics.object.inertia)


def test_all_neighbours_grow_heavier_and_the_object_does_not():
    physics = Physics.nominal(load_scenario("push_two_boxes"), "box")
    changed = switched_on(physics, "neighbour_mass", scale=1.5)
    ((was, now),) = ((one.body, other.body) for one, other in zip(physics.neighbours, changed.neighbours, strict=True))
    assert now.mass == pytest.approx(1.5 * was.mass)
    np.testing.assert_allclose(now.inertia, 1.5 * was.inertia)
    assert changed.object is physics.object
    assert switched_on(physics, "object_friction", friction=-0.1).object_friction == pytest.approx(0.3)
    assert switched_on(physics, "object_friction", friction=-1.0).object_friction == 0.0


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_spinning_box_turns_about_the_place_where_its_centre_of_mass_is(axis):
    """Let go with spin w about z and its middle at rest: the centre of mass c flies with w x c, the middle circles."""
    offset = {"x": np.array([0.03, 0.0, 0.0]), "y": np.array([0.0, 0.03, 0.0])}[axis]
    spin = 6.0
    physics = switched_on(bench(), "object_com_offset", **{axis: 0.03})
    start = np.array([5.0, 0.0, 3.0])
    motion = run(physics, seconds=0.3, box=tuple(start), box_twist=(0.0, 0.0, 0.0, 0.0, 0.0, spin))
    time = motion.time[:, None]
    cosine, sine = np.cos(spin * motion.time), np.sin(spin * motion.time)
    turned = np.stack((cosine * offset[0] - sine * offset[1], sine * offset[0] + cosine * offset[1], 0.0 * cosine), 1)
    flight = spin * np.array([-offset[1], offset[0], 0.0])
    expected = start + offset + flight * time - turned + np.array([0.0, 0.0, -GRAVITY / 2.0]) * time**2
    np.testing.assert_allclose(motion.box, expected, atol=2e-3)
    assert np.abs(motion.box - start)[-1, :2].max() > 0.02


@pytest.mark.parametrize("offset", [0.03, -0.03])
def test_a_box_stands_on_its_sides_wherever_its_centre_of_mass_is(offset):
    """Upright on a table it stays where it is; laid over the edge of the pad it falls only with its weight outside."""
    table = with_support(switched_on(bench(), "object_com_offset", z=offset), -1.0)
    start = (1.0, 0.0, -1.0 + BOX / 2.0)
    np.testing.assert_allclose(run(table, seconds=0.2, box=start).box[-1], start, atol=1e-3)
    physics = switched_on(bench(), "object_com_offset", x=offset)
    motion = run(physics, seconds=0.2, box=(REACH + PAD / 2.0, 0.0, BOX / 2.0))
    fallen = BOX / 2.0 - motion.box[-1, 2]
    assert fallen > 0.02 if offset > 0.0 else fallen == pytest.approx(GRAVITY / 2.0e4, abs=1e-3)


def test_a_centre_of_mass_stays_inside_every_box_it_is_looked_for_in():
    effect = library()["object_com_offset"]
    plain = bench()
    flat = replace(plain, object=replace(plain.object, size=np.array([0.3, 0.1, 0.06])))
    filled = effect.apply_vector(flat, np.array([0.0, 0.02, 0.0]))
    np.testing.assert_allclose(effect.bounds(flat), ([-0.08, -0.05, -0.03], [0.08, 0.05, 0.03]))
    np.testing.assert_allclose(effect.bounds(filled), ([-0.08, -0.07, -0.03], [0.08, 0.03, 0.03]))
    np.testing.assert_allclose(effect.bounds_in([flat, filled]), ([-0.08, -0.05, -0.03], [0.08, 0.03, 0.03]))


def test_offsets_along_all_three_axes_add_to_what_is_there():
    effect = library()["object_com_offset"]
    once = effect.apply_vector(bench(), np.array([0.01, 0.02, 0.03]))
    twice = effect.apply_vector(once, np.array([0.01, 0.0, -0.01]))
    np.testing.assert_allclose(twice.object.com_offset, [0.02, 0.02, 0.02])


# ---- surroundings ---------------------------------------------------------------------------------------------------

INERTIA = MASS_MATRIX + MOTOR_INERTIA


@pytest.mark.parametrize("angle", [0.1, -0.1])
def test_things_fall_to_the_side_that_the_tilt_lowers(angle):
    """Roll about +x lifts the side +y, so things fall to -y; pitch about +y lowers the side +x, so they fall there."""
    sine, cosine = GRAVITY * np.sin(angle), GRAVITY * np.cos(angle)
    for name, gravity in (("roll", (0.0, -sine, -cosine)), ("pitch", (sine, 0.0, -cosine))):
        motion = run(switched_on(bench(), "base_tilt", **{name: angle}), seconds=0.2, box=(5.0, 0.0, 3.0))
        found = [slope(motion.time, motion.box_velocity[:, axis], 0.0, 0.2) for axis in range(3)]
        np.testing.assert_allclose(found, gravity, atol=1e-6)


def test_tilt_turns_a_level_turntable_downhill():
    motion = run(switched_on(bench(), "base_tilt", roll=0.1), seconds=0.25)
    expected = -FIRST_MOMENT * GRAVITY * np.sin(0.1) / INERTIA
    assert slope(motion.time, motion.velocity, 0.1, 0.2) == pytest.approx(expected, rel=0.02)


def test_roll_and_pitch_together_keep_the_size_of_gravity():
    tilted = switched_on(bench(), "base_tilt", roll=0.05, pitch=-0.03).gravity
    expected = GRAVITY * np.array([np.sin(-0.03), -np.sin(0.05) * np.cos(-0.03), -np.cos(0.05) * np.cos(-0.03)])
    np.testing.assert_allclose(tilted, expected, atol=1e-12)


@pytest.mark.parametrize("pull", [3.0, -3.0])
def test_a_cable_turns_the_arm_to_the_side_it_pulls_to(pull):
    motion = run(switched_on(bench(), "external_spring", pull_y=pull), seconds=0.25)
    assert slope(motion.time, motion.velocity, 0.1, 0.2) == pytest.approx(pull * REACH / INERTIA, rel=0.02)


@pytest.mark.parametrize("side", [0.1, -0.1])
def test_a_spring_pulls_with_stiffness_times_distance(side):
    physics = bench()
    anchored = replace(physics.arms["arm"], impact_position=np.array([REACH, side, 0.0]))
    physics = switched_on(replace(physics, arms={"arm": anchored}), "external_spring", stiffness=40.0)
    motion = run(physics, seconds=0.1)
    away = np.sin(motion.position[-1]) * REACH
    assert 0.0 < away / side < 0.2
    assert slope(motion.time, motion.velocity, 0.0, 0.099) == pytest.approx(40.0 * side * REACH / INERTIA, rel=0.05)
