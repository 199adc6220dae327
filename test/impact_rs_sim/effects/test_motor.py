# SPDX-License-Identifier: Apache-2.0
"""Drives: gain, delay and offset of the torque; friction and inertia of the motor; stiffness of the transmission."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from bench import ACROSS, FIRST_MOMENT, GRAVITY, MASS_MATRIX, MOTOR_INERTIA, STIFFNESS, bench, run, slope, switched_on

from impact_rs_sim.effects import library
from impact_rs_sim.impact_map.measured import MeasuredImpact, points_of_scene, solve_measured
from impact_rs_sim.physics import JointFriction, ShaftFriction
from impact_rs_sim.scene import Scene

# ---- actuation: gain times the desired torque, late, and an offset --------------------------------------------------

INERTIA = MASS_MATRIX + MOTOR_INERTIA


@pytest.mark.parametrize("offset", [0.4, -0.4])
def test_torque_offset_moves_a_joint_that_nobody_asked_to_move(offset):
    motion = run(switched_on(bench(), "torque_offset", offset_joint1=offset))
    assert slope(motion.time, motion.velocity, 0.2, 0.39) == pytest.approx(offset / INERTIA, rel=0.005)


def test_torque_gain_of_1_01_delivers_1_percent_more():
    asked = run(bench(), lambda time: 2.0)
    more = run(switched_on(bench(), "torque_gain", gain_joint1=1.01), lambda time: 2.0)
    assert asked.momentum[-1] == pytest.approx(2.0 * asked.time[-1], rel=1e-6)
    assert more.momentum[-1] / asked.momentum[-1] == pytest.approx(1.01, rel=1e-6)


def test_gain_does_not_multiply_the_offset():
    physics = switched_on(switched_on(bench(), "torque_gain", gain_joint1=1.2), "torque_offset", offset_joint1=0.5)
    motion = run(physics, lambda time: 2.0)
    assert motion.momentum[-1] == pytest.approx((1.2 * 2.0 + 0.5) * motion.time[-1], rel=1e-6)


@pytest.mark.parametrize("delay", [0.001, 0.0031, 0.02])
def test_actuation_delay_shifts_the_delivered_torque(delay):
    """A step of the desired torque at 50 ms begins to push at 50 ms and the delay; the momentum tells when."""
    motion = run(switched_on(bench(), "actuation_delay", delay=delay), lambda time: 2.0 if time > 0.0495 else 0.0)
    np.testing.assert_allclose(motion.momentum[motion.time < 0.05 + delay - 1e-9], 0.0, atol=1e-9)
    assert motion.momentum[-1] == pytest.approx(2.0 * (motion.time[-1] - 0.05 - delay), rel=1e-6)


# ---- motor side -----------------------------------------------------------------------------------------------------


def pushed(direction):
    """4 N m for 0.15 s, then nothing."""
    return lambda time: 4.0 * direction if time < 0.15 else 0.0


def test_without_friction_a_joint_that_is_let_go_keeps_its_speed():
    motion = run(bench(), pushed(1.0))
    assert motion.momentum[-1] == pytest.approx(4.0 * 0.15, rel=1e-3)
    assert slope(motion.time, motion.velocity, 0.25, 0.39) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_coulomb_friction_slows_a_joint_by_torque_over_inertia(direction):
    motion = run(switched_on(bench(), "joint_coulomb_friction", coulomb_joint1=0.3), pushed(direction))
    assert direction * motion.velocity[-1] > 0.1
    assert slope(motion.time, motion.velocity, 0.25, 0.39) == pytest.approx(-direction * 0.3 / INERTIA, rel=0.01)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_viscous_speed_decays_with_inertia_over_coefficient(direction):
    motion = run(switched_on(bench(), "joint_viscous_friction", viscous_joint1=0.5), pushed(direction))
    assert direction * motion.velocity[-1] > 0.1
    later = motion.time > 0.2
    decay = slope(motion.time[later], np.log(np.abs(motion.velocity[later])), 0.25, 0.39)
    assert decay == pytest.approx(-0.5 / INERTIA, rel=0.01)


def test_stribeck_friction_holds_a_joint_below_the_breakaway_torque():
    stuck = switched_on(bench(), "joint_stribeck_friction", breakaway_joint1=1.0)
    assert abs(run(stuck, lambda time: 0.5).position[-1]) < 2e-3
    free = run(bench(), lambda time: 0.5)
    assert free.position[-1] == pytest.approx(0.25 / INERTIA * free.time[-1] ** 2, rel=0.02)


@pytest.mark.parametrize("wider", [0.045, 0.145])
def test_a_joint_pushed_by_half_its_dry_friction_creeps_at_the_width_of_the_reversal(wider):
    """F_c tanh(v / v_r) = tau: v = v_r atanh(tau / F_c). Kills a width in place of that of the model."""
    rough = switched_on(bench(), "joint_coulomb_friction", coulomb_joint1=3.0)
    wide = switched_on(rough, "joint_reversal_width", width_joint1=wider)
    motion = run(wide, lambda time: 1.5)
    assert motion.velocity[-1] == pytest.approx((0.005 + wider) * np.arctanh(0.5), rel=1e-3)


def test_the_width_of_the_reversal_changes_all_dry_friction_of_its_joint_and_nothing_else():
    """Breakaway torque, asymmetry, load and shafts turn together; viscous friction has no direction."""
    n = 3
    dry = replace(
        JointFriction.none(n),
        stribeck=np.full(n, 0.4),
        asymmetry=np.full(n, 0.1),
        load=np.full(n, 0.02),
        shafts=(ShaftFriction(np.full(n - 1, 0.3), np.zeros(n - 1), -1.0),),
        stribeck_velocity=np.full(n, np.inf),
    )
    viscous = replace(JointFriction.none(n), viscous=np.full(n, 0.2))
    velocity, width = np.array([0.03, -0.06, 0.09]), np.array([0.01, 0.02, 0.04])
    wide = [replace(one, smoothing=width) for one in (dry, viscous)]
    s = np.tanh(velocity / width)
    shaft = 0.3 * np.tanh((velocity[:-1] - velocity[1:]) / width[:-1])
    expected = -(0.4 + 0.1 * s + 0.02 * 5.0) * s - np.append(shaft, 0.0) + np.append(0.0, shaft)
    np.testing.assert_allclose(wide[0].torque(velocity, np.full(n, -5.0)), expected, rtol=1e-12)
    np.testing.assert_array_equal(wide[1].torque(velocity), viscous.torque(velocity))


def test_no_load_dependent_friction_locks_a_joint_that_its_load_drives():
    """A load drives a joint back with (1 - k) of its torque. Kills a range that a fit widens beyond k = 1."""
    (coefficient,) = library()["joint_load_dependent_friction"].parameters
    widest = coefficient.widened().widened()
    most = replace(JointFriction.none(1), load=np.array([widest.upper]))
    assert widest.upper > 0.5
    assert abs(most.torque(np.array([-2.0]), np.array([-5.0]))[0]) <= 5.0


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_motor_inertia_scale_adds_to_the_inertia_that_a_torque_moves(scale):
    motion = run(switched_on(bench(), "motor_inertia_scale", scale=scale), lambda time: 2.0)
    expected = 2.0 / (MASS_MATRIX + scale * MOTOR_INERTIA)
    assert slope(motion.time, motion.velocity, 0.2, 0.39) == pytest.approx(expected, rel=0.005)


def test_added_motor_inertia_resists_as_much_as_the_assumed_one():
    scaled, added = (
        switched_on(bench(), name, **{parameter: value}).arms["arm"].motor_inertia_reduced
        for name, parameter, value in (
            ("motor_inertia_scale", "scale", 1.8),
            ("added_motor_inertia", "inertia_joint1", 0.12),
        )
    )
    np.testing.assert_allclose(added, scaled)


# ---- transmission: a load twists it by torque over stiffness --------------------------------------------------------


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_joint_stiffness_decides_how_far_weight_twists_a_joint(scale):
    """A pendulum that stands out level along +x falls about +y, so it is held by a negative torque."""
    weight = -FIRST_MOMENT * GRAVITY
    motion = run(switched_on(bench(ACROSS), "joint_stiffness", scale=scale), lambda time: weight)
    twist = motion.motor_position[-1] - motion.position[-1]
    assert twist == pytest.approx(weight / (scale * STIFFNESS), rel=1e-3)
    assert motion.torque[-1] == pytest.approx(weight, rel=1e-3)


@pytest.mark.parametrize(("stiffness", "damping"), [(50.0, 0.0), (0.0, 1.0), (40.0, 0.5)])
def test_a_joint_under_stiff_control_resists_an_impact_with_the_inertia_of_its_closed_form(
    stiffness: float, damping: float
) -> None:
    """An equation of motion that is integrated here; kills a wrong share of K T^2 or D T (by half or twice)."""
    inertia, duration = 0.8, 0.02

    def motion(t: float, state: np.ndarray) -> list[float]:
        held = stiffness * state[0] + damping * state[1]
        return [state[1], (np.sin(np.pi * t / duration) - held) / inertia]

    end = scipy.integrate.solve_ivp(motion, (0.0, duration), [0.0, 0.0], rtol=1e-10, atol=1e-14).y[1, -1]
    added = 2.0 * duration / np.pi / end - inertia
    expected = (0.25 - 1.0 / np.pi**2) * stiffness * duration**2 + 0.5 * damping * duration
    assert added == pytest.approx(expected, rel=0.02)


def test_an_arm_under_very_stiff_control_is_a_wall(scene: Scene) -> None:
    """No joint yields, and the object leaves with the speed of the pad. Kills control of some joints only."""
    (name,) = scene.arms
    locked = library()["stiff_control"].apply_vector(scene.physics, np.array([1e5]))
    points = points_of_scene(scene.physics, scene.arms, scene.object, scene.models)
    state, body = scene.arms[name], replace(scene.object, twist=np.zeros(6))
    jumps = []
    for physics in (scene.physics, locked):
        after, _ = solve_measured(physics, MeasuredImpact({name: state}, body, points))
        jumps.append(np.abs(after[:7] - state.velocity).max())
        pad = (scene.models[name].jacobian(state.position) @ after[:7])[:3]
    assert jumps[0] > 0.01 and jumps[1] < 1e-4
    assert after[7:10] @ pad > 0.9 * pad @ pad


def test_a_joint_that_slides_has_velocities_of_friction_behind_a_pinion():
    """5 mrad/s and 0.1 rad/s behind a pinion of 50 mm are 0.25 mm/s and 5 mm/s. Kills rad/s as m/s."""
    arm = bench().arms["arm"]
    facts = arm.facts.model_copy(
        update={"joints": tuple(joint.model_copy(update={"type": "prismatic"}) for joint in arm.facts.joints)}
    )
    assert JointFriction.none(facts.joint_types).smoothing == pytest.approx(0.005 * 0.05)
    slide = replace(bench(), arms={"arm": replace(arm, facts=facts)})
    sticky = switched_on(slide, "joint_stribeck_friction", breakaway_joint1=1.0, stribeck_velocity=0.1)
    assert sticky.arms["arm"].friction.stribeck_velocity == pytest.approx(0.1 * 0.05)
