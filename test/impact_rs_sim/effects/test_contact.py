# SPDX-License-Identifier: Apache-2.0
"""Contacts: a box on a pad that lies like a tray, and on a table."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from bench import BOX, GRAVITY, REACH, bench, run, slope, switched_on, with_support
from closed_forms import restitution_of
from trials import scene_of

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.effects import library
from impact_rs_sim.impact_map import BulletEngine, ExactEngine, ImpactProblem
from impact_rs_sim.impact_map.contacts import contact_pairs, find_contacts
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.twin import TwinJob, simulate

ON_PAD = (REACH, 0.0, BOX / 2.0)
DAMPED = 0.9  # of the critical damping of 1 kg on the pad


def slowed_by(name, more, **sliding):
    """Deceleration of a box that slides along +x, away from the axis, under an effect of friction [m/s^2]."""
    physics = switched_on(with_support(bench(), -1.0), name, friction=more)
    motion = run(physics, seconds=0.1, box_twist=(0.6, 0.0, 0.0, 0.0, 0.0, 0.0), **sliding)
    return -slope(motion.time, motion.box_velocity[:, 0], 0.01, 0.06)


@pytest.mark.parametrize("more", [-0.15, 0.0, 0.18])
def test_support_friction_slows_a_sliding_box_by_mu_g(more):
    found = slowed_by("support_friction", more, box=(1.0, 0.0, -1.0 + BOX / 2.0))
    assert found == pytest.approx((0.3 + more) * GRAVITY, rel=0.02)


@pytest.mark.parametrize("more", [-0.25, 0.0, 0.3])
def test_pad_friction_slows_a_box_that_slides_on_the_pad_by_mu_g(more):
    settled = BOX / 2.0 - GRAVITY / 2.0e4
    found = slowed_by("pad_friction", more, box=(REACH, 0.0, settled))
    assert found == pytest.approx((0.5 + more) * GRAVITY, rel=0.03)


@pytest.mark.parametrize("name", ["support_friction", "pad_friction"])
def test_a_smooth_contact_may_be_rough_and_none_has_less_than_no_friction(name):
    smooth = replace(bench(), **{name: 0.0})
    assert getattr(switched_on(smooth, name, friction=0.4), name) == 0.4
    assert np.concatenate(library()[name].bounds(smooth)) == pytest.approx([0.0, 2.0])
    assert np.concatenate(library()[name].bounds(replace(smooth, **{name: 0.3}))) == pytest.approx([-0.3, 2.0])
    assert getattr(switched_on(smooth, name, friction=-0.4), name) == 0.0  # a step of a fit


@pytest.mark.parametrize("scale", [0.5, 1.0, 4.0])
def test_a_box_sinks_into_the_pad_by_its_weight_over_the_stiffness(scale):
    motion = run(switched_on(bench(), "pad_compliance", scale=scale), seconds=1.0, box=ON_PAD)
    assert BOX / 2.0 - motion.box[-1, 2] == pytest.approx(GRAVITY / (scale * 2.0e4), rel=0.02)


def test_a_rigid_pad_stays_rigid():
    physics = bench()
    rigid = replace(physics, arms={"arm": replace(physics.arms["arm"], pad_stiffness=None)})
    for name, values in (("pad_compliance", {"scale": 3.0}), ("restitution", {"restitution": 0.5})):
        assert switched_on(rigid, name, **values).arms["arm"] is rigid.arms["arm"]


def bounce(more):
    """Speed after over speed before of a box of 1 kg that is dropped on a pad that cannot give way."""
    physics = bench()
    arm = replace(physics.arms["arm"], pad_damping=2.0 * DAMPED * np.sqrt(2.0e4))
    physics = switched_on(replace(physics, arms={"arm": arm}), "restitution", restitution=more)
    motion = run(physics, seconds=0.08, box=(REACH, 0.0, BOX / 2.0 + 0.01), box_twist=(0.0, 0.0, -1.0, 0.0, 0.0, 0.0))
    return motion.box_velocity[:, 2].max() / -motion.box_velocity[:, 2].min()


@pytest.mark.parametrize("more", [0.05, 0.15, 0.45, 0.75])
def test_a_box_bounces_off_the_pad_with_the_restitution_that_the_effect_adds(more):
    """To that of the damped pad; gravity takes a hundredth."""
    assert bounce(more) == pytest.approx(restitution_of(DAMPED) + more, abs=0.02)


@pytest.mark.parametrize(("item", "case"), [("parcel", "case_1"), ("cat_food", "case_2"), ("juice", "case_3")])
def test_the_effect_adds_its_restitution_to_that_of_the_pad_of_a_push(item, case):
    """By the closed form with the mass with which arm and object meet, at the configuration of every case."""
    scene = scene_of("push", item, case)
    problem = ImpactProblem.at_nominal_impact(scene)
    model, state, inertia = scene.models["arm"], problem.arms["arm"], problem.motor_inertia["arm"]
    normal = model.placement(state.position).rotation[:, 2]
    mass = 1.0 / (1.0 / model.effective_mass(state.position, normal, inertia) + 1.0 / scene.physics.object.mass)

    def restitution(more):
        arm = switched_on(scene.physics, "restitution", restitution=more).arms["arm"]
        return restitution_of(arm.pad_damping / (2.0 * np.sqrt(arm.pad_stiffness * mass)))

    for more in (0.05, 0.1, 0.2, 0.3, 0.5, 0.7):
        assert restitution(more) == pytest.approx(restitution(0.0) + more, abs=0.005)
    assert restitution(0.99) == pytest.approx(1.0)


@pytest.mark.parametrize("more", [0.2, 0.7])
def test_the_object_leaves_the_pad_of_a_flexible_arm_with_the_restitution_that_the_effect_adds(more):
    """Springs of the joints and the torque loop take and give a few hundredths while the contact lasts."""
    scene, ticks = scene_of("push", "cat_food", "case_2"), 40
    physics = replace(switched_on(scene.physics, "restitution", restitution=more), support_friction=0.0)
    model, state = scene.models["arm"], scene.arms["arm"]
    normal = model.placement(state.position).rotation[:, 2]
    closing = normal @ model.jacobian(state.position)[:3] @ state.velocity
    start = ArmState(state.position - 0.002 / closing * state.velocity, state.velocity)
    weight = model.gravity_torque(state.position)
    job = TwinJob(
        physics,
        {"arm": start},
        {"arm": DriveStart(weight, np.zeros(7))},
        {"arm": weight[None]},
        {"arm": np.zeros(4 * ticks, dtype=np.int32)},
        np.arange(ticks + 1) * 1e-3,
        2.5e-4,
        scene.object,
    )
    (result,) = simulate([job])
    arm = result.arms["arm"]
    pad = [model.jacobian(q)[:3] @ dq for q, dq in zip(arm.position, arm.velocity, strict=True)]
    leaving = (result.twists[:, :3] - np.array(pad)) @ normal
    assert leaving.max() / closing == pytest.approx(0.157 + more, abs=0.03)


def leaning(physics, push):
    """The same where gravity also pulls along +x, the way the arm of the bench cannot move [m/s^2]."""
    return replace(physics, gravity=np.array([push, 0.0, -GRAVITY]))


SETTLED = (REACH, 0.0, BOX / 2.0 - GRAVITY / 2.0e4)


@pytest.mark.parametrize("push", [2.0, -3.0])
@pytest.mark.parametrize("compliance", [1.5e-5, 1e-4])
def test_a_pad_yields_along_its_face_by_force_times_compliance(push, compliance):
    """The weight also leans the box over, for the pad yields to the moment with K a^2 / 4."""
    physics = switched_on(leaning(bench(), push), "pad_shear", compliance=compliance)
    motion = run(physics, seconds=0.4, box=SETTLED)
    leans = (BOX / 2.0) ** 2 / (2.0e4 * BOX**2 / 4.0)
    assert motion.box[-1, 0] - REACH == pytest.approx(push * (compliance + leans), rel=0.02)


@pytest.mark.parametrize("push", [2.0, -3.0])
def test_what_sticks_to_a_pad_creeps_at_force_times_creep(push):
    physics = switched_on(leaning(bench(), push), "pad_creep", creep=1e-3)
    motion = run(physics, seconds=0.3, box=SETTLED)
    assert motion.box_velocity[-1, 0] == pytest.approx(1e-3 * push, rel=0.02)


def test_what_the_sheared_pad_does_to_the_box_the_box_does_to_the_arm():
    """Nothing else turns the turntable: its momentum about the axis and that of the box keep their sum."""
    physics = switched_on(bench(), "pad_shear", compliance=1e-4)
    motion = run(physics, seconds=0.06, box=SETTLED, box_twist=(0.0, 0.1, 0.0, 0.0, 0.0, 0.0))
    of_box = motion.box[:, 0] * motion.box_velocity[:, 1] - motion.box[:, 1] * motion.box_velocity[:, 0]
    passed = of_box[0] - of_box[-1]
    assert passed > 0.01
    # The box turns with the pad at most: its moment is small beside what it passes on.
    assert motion.momentum[-1] == pytest.approx(passed, abs=1.2 * BOX**2 / 6.0 * abs(motion.velocity[-1]) + 1e-4)


AWAKE = (0.0, 0.0, 0.0, 0.0, 0.0, 1e-9)  # rad/s; a box at rest would sleep until it is touched


@pytest.mark.parametrize("compliance", [2e-5, 1e-4])
def test_a_box_sinks_into_its_support_by_its_weight_times_the_compliance(compliance):
    """From the surface without a load to where the scenario says that it stands, with the damping of ratio 0.5."""
    physics = switched_on(with_support(bench(), -1.0), "support_compliance", compliance=compliance)
    stands, sinks = -1.0 + BOX / 2.0, GRAVITY * compliance
    motion = run(physics, seconds=0.3, box=(1.0, 0.0, stands + sinks), box_twist=AWAKE)
    assert motion.box[-1, 2] == pytest.approx(stands, abs=0.02 * sinks)
    deepest = 1.0 + np.exp(-np.pi * 0.5 / np.sqrt(0.75))
    assert (stands + sinks - motion.box[:, 2].min()) / sinks == pytest.approx(deepest, rel=0.04)


@pytest.mark.parametrize("pitch", [0.02, -0.03])
def test_a_box_on_a_tilted_pad_slides_down_the_slope(pitch):
    """z(x) = -x tan(pitch): without friction it accelerates with g sin(pitch) cos(pitch) along +x."""
    physics = replace(switched_on(bench(), "pad_tilt", pitch=pitch), pad_friction=0.0)
    motion = run(physics, seconds=0.3, box=(REACH, 0.0, BOX / 2.0 + abs(pitch) * BOX / 2.0))
    assert slope(motion.time, motion.box_velocity[:, 0], 0.1, 0.28) == pytest.approx(
        GRAVITY * np.sin(pitch) * np.cos(pitch), rel=0.05
    )
    assert np.abs(motion.box[:, 1]).max() < 1e-4


@pytest.mark.parametrize("angle", ["roll", "pitch"])
def test_a_tilted_pad_meets_the_box_with_an_edge_and_earlier(angle):
    """By half the edge of the box times the tilt."""
    speed, gap, tilt = 0.1, 3e-3, 0.04

    def onset(physics):
        motion = run(
            physics,
            seconds=0.05,
            box=(REACH, 0.0, BOX / 2.0 + gap),
            box_twist=(0.0, 0.0, -speed, 0.0, 0.0, 0.0),
        )
        falling = -speed - GRAVITY * motion.time
        return motion.time[np.argmax(motion.box_velocity[:, 2] - falling > 5e-3)]

    def falls(way):
        return (np.sqrt(speed**2 + 2.0 * GRAVITY * way) - speed) / GRAVITY

    flat = onset(bench())
    assert flat == pytest.approx(falls(gap), abs=2e-3)
    for sign in (1.0, -1.0):
        tilted = onset(switched_on(bench(), "pad_tilt", **{angle: sign * tilt}))
        assert flat - tilted == pytest.approx(falls(gap) - falls(gap - tilt * BOX / 2.0), abs=1.5e-3)


@pytest.mark.parametrize("longer", [0.004, -0.004])
def test_a_longer_tool_meets_the_object_that_much_earlier(longer):
    """A box falls on the pad from 10 mm above it; kills a wrong sign of z, and an offset that turns with the tilt."""
    gap, speed = 0.01, 0.2

    def onset(physics):
        motion = run(
            physics, seconds=0.08, box=(REACH, 0.0, BOX / 2.0 + gap), box_twist=(0.0, 0.0, -speed, 0.0, 0.0, 0.0)
        )
        falling = -speed - GRAVITY * motion.time
        return motion.time[np.argmax(motion.box_velocity[:, 2] - falling > 5e-3)]

    def falls(way):
        return (np.sqrt(speed**2 + 2.0 * GRAVITY * way) - speed) / GRAVITY

    moved = onset(switched_on(bench(), "pad_position", z=longer)) - onset(bench())
    assert moved == pytest.approx(falls(gap - longer) - falls(gap), abs=1.5e-3)


SCENE = scene_of("push", "juice", "case_2")


def pushed(**tilt):
    """The push at its nominal impact, with a tilted pad."""
    physics = switched_on(SCENE.physics, "pad_tilt", **tilt)
    return ImpactProblem.at_nominal_impact(replace(SCENE, physics=physics))


def pad_points(problem):
    """Where the pad touches, in axes of E from its origin, ``(m, 3)`` [m]."""
    place = problem.physics.robot_model("arm").placement(problem.arms["arm"].position)
    found = find_contacts(problem.physics, contact_pairs(problem.physics, problem.object, {"arm": place}))
    return np.array([place.rotation.T @ (p.position - place.translation) for p in found if p.partner == "arm"])


@pytest.mark.parametrize(("angle", "axis", "sign"), [("roll", 1, 1.0), ("pitch", 0, -1.0)])
def test_a_tilted_pad_touches_with_the_edge_that_the_tilt_brings_forward(angle, axis, sign):
    """Roll about x brings +y forward (out of the pad), pitch about y brings -x forward; the other way mirrored."""
    assert len(pad_points(pushed())) == 4
    there, back = (pad_points(pushed(**{angle: side * 0.05})) for side in (1.0, -1.0))
    assert len(there) == len(back) == 2
    assert np.all(sign * there[:, axis] > 0.01) and np.all(sign * back[:, axis] < -0.01)


@pytest.mark.parametrize("tilt", [{"roll": 0.03}, {"pitch": -0.03}, {"roll": 0.04, "pitch": 0.03}])
def test_both_engines_see_the_tilted_pad_alike(tilt):
    problem = pushed(**tilt)
    answers = []
    for kind in (ExactEngine, BulletEngine):
        engine = kind(problem.physics)
        answers.append(engine.solve(problem))
        engine.close()
    first, second = answers
    assert len(first.contacts) == len(second.contacts) < 8
    assert first.object_twist[1] < -0.05
    np.testing.assert_allclose(first.object_twist, second.object_twist, atol=5e-3)


def tipping(physics, place, seconds=0.01):
    """A box that stands on an edge along y and falls over: angular acceleration, and normal force from its motion."""
    lean = 0.5  # rad, short of pi / 4, where it would stand
    rotation = pin.rpy.rpyToMatrix(0.0, lean, 0.0)
    low = BOX / 2.0 * (np.cos(lean) + np.sin(lean))
    step = 1e-4
    world = BulletWorld.load(
        physics, time_step=step, gravity=True, compliant_pads=True, iterations=200, residual_threshold=1e-16
    )
    world.set_arm("arm", ArmState(np.zeros(1), np.zeros(1)))
    world.set_object(BodyState(np.array(place) + [0.0, 0.0, low], rotation, np.zeros(6)))
    twists = []
    for _ in range(round(seconds / step)):
        world.apply_torque("arm", np.zeros(1))
        world.step()
        twists.append(world.object_state().twist)
    world.close()
    late = len(twists) // 2
    change = (twists[-1] - twists[late]) / (step * (len(twists) - 1 - late))
    return change[4], physics.object.mass * (GRAVITY + change[2])


@pytest.mark.parametrize("partner", ["support", "pad"])
@pytest.mark.parametrize("arm", [1e-3, 4e-3])
def test_a_moment_of_the_normal_force_times_the_arm_resists_tipping(partner, arm):
    """About the edge: (m a^2 / 6 + m a^2 / 2) dw = m g lever - arm N, slower by arm N over the inertia."""
    physics = replace(bench(), pad_friction=1.0, support_friction=1.0)
    place = (1.0, 0.0, -1.0)
    if partner == "support":
        physics = with_support(physics, -1.0)
    else:  # a tray that cannot bounce
        rigid = replace(physics.arms["arm"], pad_stiffness=None)
        physics, place = replace(physics, arms={"arm": rigid}), (REACH, 0.0, 0.0)
    free, _ = tipping(physics, place)
    found, load = tipping(switched_on(physics, "rolling_resistance", arm=arm), place)
    inertia = BOX**2 / 6.0 + BOX**2 / 2.0
    assert free == pytest.approx(-GRAVITY * BOX / np.sqrt(2.0) * np.sin(np.pi / 4.0 - 0.5) / inertia, rel=0.02)
    assert found - free == pytest.approx(arm * load / inertia, rel=0.05)


def test_the_moment_does_nothing_to_a_box_that_slides_on_its_face():
    physics = with_support(bench(), -1.0)
    found = [
        run(one, seconds=0.1, box=(1.0, 0.0, -1.0 + BOX / 2.0), box_twist=(0.6, 0.0, 0.0, 0.0, 0.0, 0.0))
        for one in (physics, switched_on(physics, "rolling_resistance", arm=4e-3))
    ]
    np.testing.assert_allclose(found[1].box, found[0].box, atol=5e-5)  # where Bullet's solver stops, step by step


def test_the_range_of_a_user_for_restitution_is_not_widened():
    """Kills: the lower end given by a user falls to minus the assumed restitution."""
    physics, effect = replace(bench(), restitution=0.5), library()["restitution"]
    given = effect.with_parameters(lambda own: own.within(0.0, 0.2))
    wide = effect.with_parameters(lambda own: own.within(-0.9, 0.9))
    for bounded, expected in ((given, [0.0, 0.2]), (wide, [-0.5, 0.5]), (effect, [-0.5, 0.5])):
        assert np.concatenate(bounded.bounds(physics)) == pytest.approx(expected)
