# SPDX-License-Identifier: Apache-2.0
"""The torque loop runs with B_rho; what is felt is B_theta."""

from dataclasses import replace

import numpy as np
import pytest
from trials import nominal_physics

from impact_rs_sim.bullet_world import BulletWorld
from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.physics import JointFriction, Physics
from impact_rs_sim.scene import ArmState

PERIOD = 0.00025  # s


@pytest.fixture
def arm(scene):
    return scene.physics.arms["arm"]


def test_locked_link_leaves_motor_with_reduced_inertia_and_spring(arm):
    """B_theta ddtheta + K theta = 0: the eigenfrequency is sqrt(K / B_theta), not sqrt(K / B_rho)."""
    arm = replace(arm, damping=np.zeros(7))
    period = PERIOD / 20.0
    drive = Drive(arm, period)
    drive.reset(np.zeros(7), 10.0 * np.ones(7))
    crossings = [[] for _ in range(7)]
    previous = drive.position.copy()
    for step in range(40000):
        drive.sense(np.zeros(7), np.zeros(7))
        drive.step(np.zeros(7))
        for joint in np.flatnonzero(previous * drive.position < 0.0):
            crossings[joint].append(step * period)
        previous = drive.position.copy()
    frequency = np.array([np.pi * (len(c) - 1) / (c[-1] - c[0]) for c in crossings])
    np.testing.assert_allclose(frequency, np.sqrt(arm.stiffness / arm.motor_inertia_reduced), rtol=2e-3)


def test_free_motor_accelerates_with_the_reduced_inertia(arm):
    drive = Drive(arm, PERIOD)
    torque = np.linspace(1.0, 2.0, 7)
    for _ in range(400):
        drive.sense(drive.position, drive.velocity)
        drive.step(torque)
    np.testing.assert_allclose(drive.velocity, torque / arm.motor_inertia_reduced * 400 * PERIOD, rtol=1e-12)


def test_friction_is_felt_as_stated_at_the_desired_torque(arm):
    """tau_fric = B_theta B_rho^-1 tau_fric,m: a motor pushed with exactly its friction keeps its velocity."""
    friction = JointFriction(np.full(7, 0.5), np.full(7, 0.3), np.zeros(7), np.full(7, 0.05))
    drive = Drive(replace(arm, friction=friction), PERIOD)
    drive.velocity = np.full(7, 0.8)
    for _ in range(400):
        drive.sense(drive.position, drive.velocity)
        drive.step(np.full(7, 0.5 + 0.3 * 0.8))
    np.testing.assert_allclose(drive.velocity, 0.8, rtol=1e-9)


def test_friction_only_ever_takes_power(arm):
    sigmoid = replace(JointFriction.none(7), sigmoid=arm.facts.friction)
    stribeck = JointFriction(np.full(7, 0.4), np.full(7, 0.2), np.full(7, 0.3), np.full(7, 0.05))
    for friction in (sigmoid, stribeck):
        for velocity in np.linspace(-2.0, 2.0, 41):
            assert np.all(friction.torque(np.full(7, velocity)) * velocity <= 1e-12)


def test_actuation_delay_shifts_the_torque_by_that_time(arm):
    drive = Drive(replace(arm, actuation_delay=4 * PERIOD), PERIOD)
    drive.reset(np.zeros(7), np.zeros(7))
    moved = []
    for _ in range(6):
        drive.sense(drive.position, drive.velocity)
        drive.step(np.ones(7))
        moved.append(bool(np.any(drive.velocity)))
    assert moved == [False] * 4 + [True] * 2


def test_delay_between_two_periods_is_the_mean_of_both(arm):
    """Half a period more of delay: half of the first torque arrives."""
    drive = Drive(replace(arm, actuation_delay=1.5 * PERIOD), PERIOD)
    drive.reset(np.zeros(7), np.zeros(7))
    velocity, torque = [], np.ones(7)
    for _ in range(4):
        drive.sense(drive.position, drive.velocity)
        drive.step(torque)
        velocity.append(drive.velocity[0] * arm.motor_inertia_reduced[0] / PERIOD)
    np.testing.assert_allclose(velocity, [0.0, 0.5, 1.5, 2.5], atol=1e-12)


def energy_defect(physics: Physics, period: float, duration: float) -> float:
    """Largest |energy - work put in| over a free motion, relative to the largest kinetic energy."""
    arm, model = physics.arms["arm"], physics.robot_model("arm")
    world = BulletWorld.load(
        physics, time_step=period, gravity=True, compliant_pads=True, iterations=20, residual_threshold=0.0
    )
    q = np.array([-0.3, -0.3, 0.5, -2.2, -1.2, 1.5, -0.6])
    load = model.gravity_torque(q)
    drive = Drive(arm, period)
    drive.reset(q, load)
    world.set_arm("arm", ArmState(q, np.zeros(7)))
    state = world.arm_state("arm")

    def energy():
        import pinocchio as pin

        stretch = drive.position - state.position
        kinetic = 0.5 * state.velocity @ model.mass_matrix(state.position) @ state.velocity
        motor = 0.5 * arm.motor_inertia_rotor @ np.square(drive.velocity)
        spring = 0.5 * arm.stiffness @ np.square(stretch)
        potential = pin.computePotentialEnergy(model.pinocchio, model.data, state.position)
        return kinetic + motor, kinetic + motor + spring + potential

    _, start = energy()
    work, worst, largest = 0.0, 0.0, 0.0
    for step in range(round(duration / period)):
        time = step * period
        torque = load + 4.0 * np.sin(2.0 * np.pi * 2.0 * time) * np.array([1, -1, 1, -1, 0.5, 0.5, 0.3])
        world.apply_torque("arm", drive.transmission_torque)
        old_motor, old_link = drive.velocity.copy(), state.velocity
        damping_torque = drive.transmission_torque - drive.elastic_torque  # a new array: the drive updates in place
        drive.step(torque)
        world.step()
        state = world.arm_state("arm")
        motor, link = (old_motor + drive.velocity) / 2.0, (old_link + state.velocity) / 2.0
        work += period * (drive.actuation_torque + drive.friction_torque) @ motor
        work -= period * damping_torque @ (motor - link)
        drive.sense(state.position, state.velocity)
        kinetic, total = energy()
        worst, largest = max(worst, abs(total - start - work)), max(largest, kinetic)
    world.close()
    return worst / largest


def test_energy_balance_of_plant_and_drive_closes_as_the_step_shrinks(scene):
    friction = JointFriction(np.full(7, 0.5), np.full(7, 0.3), np.zeros(7), np.full(7, 0.05))
    arm = replace(scene.physics.arms["arm"], friction=friction)
    physics = replace(scene.physics, arms={"arm": arm})
    coarse, fine = (energy_defect(physics, period, 0.5) for period in (PERIOD, PERIOD / 2.0))
    assert coarse < 0.01
    assert fine < 0.6 * coarse


def test_motor_of_a_locked_link_rings_down_by_damping_over_inertia(arm):
    """B_theta ddtheta + D dtheta + K theta = 0: amplitude falls as exp(-D t / 2 B_theta)."""
    period = PERIOD / 20.0
    drive = Drive(arm, period)
    drive.reset(np.zeros(7), 10.0 * np.ones(7))
    peaks, previous, before = [[] for _ in range(7)], drive.position.copy(), np.zeros(7)
    for step in range(8000):
        drive.sense(np.zeros(7), np.zeros(7))
        drive.step(np.zeros(7))
        velocity = drive.position - previous
        for joint in np.flatnonzero((before > 0.0) & (velocity <= 0.0)):
            peaks[joint].append((step * period, previous[joint]))
        previous, before = drive.position.copy(), velocity
    rates = []
    for found in peaks:
        times, heights = np.array(found[:4]).T
        rates.append(-np.polyfit(times, np.log(heights), 1)[0])
    np.testing.assert_allclose(rates, arm.damping / (2.0 * arm.motor_inertia_reduced), rtol=0.02)


def test_link_torque_is_spring_stretch_plus_damping(arm):
    """tau_J = K (theta - q), and D K^-1 dtau_J = D (dtheta - dq) on top for the link."""
    drive = Drive(arm, PERIOD)
    theta, dtheta = np.linspace(0.1, 0.2, 7), np.linspace(-1.0, 1.0, 7)
    q, dq = theta - np.linspace(-1e-3, 2e-3, 7), np.linspace(0.3, -0.4, 7)
    drive.position, drive.velocity = theta.copy(), dtheta.copy()
    drive.sense(q, dq)
    np.testing.assert_allclose(drive.elastic_torque, arm.stiffness * (theta - q), atol=1e-9)
    np.testing.assert_allclose(
        drive.transmission_torque, arm.stiffness * (theta - q) + arm.damping * (dtheta - dq), atol=1e-9
    )


def test_a_drive_at_rest_under_its_load_stays_at_rest(arm):
    """Held by the torque that it carries; the loop adds nothing of its own."""
    load, q = np.linspace(-30.0, 40.0, 7), np.linspace(-1.0, 1.0, 7)
    drive = Drive(arm, PERIOD)
    drive.reset(q, load)
    start = drive.position.copy()
    np.testing.assert_allclose(start - q, load / arm.stiffness, atol=1e-15)
    for _ in range(100):
        drive.sense(q, np.zeros(7))
        drive.step(load)
    np.testing.assert_allclose(drive.position, start, atol=1e-12)
    np.testing.assert_allclose(drive.transmission_torque, load, atol=1e-9)
    np.testing.assert_allclose(drive.actuation_torque, load, atol=1e-9)


def test_gain_offset_and_load_act_on_the_desired_torque(arm):
    """B_theta ddtheta = g tau_d + o + tau_load for a motor that carries nothing."""
    gain, offset, load = np.linspace(0.8, 1.2, 7), np.linspace(-0.5, 0.5, 7), np.linspace(0.3, -0.2, 7)
    drive = Drive(replace(arm, torque_gain=gain, torque_offset=offset), PERIOD)
    desired = np.linspace(2.0, 1.0, 7)
    for step in range(200):
        if step == 100:
            drive.load(load)
        drive.sense(drive.position, drive.velocity)
        drive.step(desired)
    expected = (200.0 * (gain * desired + offset) + 100.0 * load) * PERIOD / arm.motor_inertia_reduced
    np.testing.assert_allclose(drive.velocity, expected, rtol=1e-9)


def test_a_command_acts_at_once_and_position_integrates_velocity(arm):
    drive = Drive(arm, PERIOD)
    way = np.zeros(7)
    for step in range(100):
        drive.sense(drive.position, drive.velocity)
        drive.step(np.ones(7) if step < 40 else -np.ones(7))
        way += PERIOD * drive.velocity
    np.testing.assert_allclose(drive.velocity, (40.0 - 60.0) * PERIOD / arm.motor_inertia_reduced, atol=1e-9)
    np.testing.assert_allclose(drive.position, way, atol=1e-12)


@pytest.mark.parametrize("periods", [0.25, 1.0, 3.6])
def test_a_delayed_torque_arrives_whole_and_late_by_the_delay(arm, periods):
    """Momentum of a pulse is the same, and its centre is later by the delay."""
    pulse = np.zeros(40)
    pulse[3:9] = [1.0, 3.0, 2.0, 5.0, 1.0, 2.0]
    arrived = {}
    for delay in (0.0, periods):
        drive = Drive(replace(arm, actuation_delay=delay * PERIOD), PERIOD)
        drive.reset(np.zeros(7), np.zeros(7))
        velocity = [0.0]
        for value in pulse:
            drive.sense(drive.position, drive.velocity)
            drive.step(np.full(7, value))
            velocity.append(drive.velocity[0])
        arrived[delay] = np.diff(velocity) * arm.motor_inertia_reduced[0] / PERIOD
    assert arrived[periods].sum() == pytest.approx(pulse.sum())
    centre = {delay: np.arange(40) @ torque / torque.sum() for delay, torque in arrived.items()}
    assert centre[periods] - centre[0.0] == pytest.approx(periods)


def test_friction_acts_on_the_motor_that_is_scaled_by_the_loop(arm):
    """tau_fric,m = B_rho B_theta^-1 tau_fric (paper, below eq. EOM_motor_mod), against the motor's velocity."""
    friction = JointFriction(np.full(7, 0.5), np.full(7, 0.3), np.zeros(7), np.full(7, 0.05))
    drive = Drive(replace(arm, friction=friction), PERIOD)
    drive.velocity = np.full(7, 0.8)
    drive.sense(drive.position, drive.velocity)
    drive.step(np.zeros(7))
    shaping = arm.motor_inertia_rotor / arm.motor_inertia_reduced
    np.testing.assert_allclose(drive.friction_torque, -shaping * (0.5 + 0.3 * 0.8), rtol=1e-9)
    assert np.all(drive.velocity < 0.8)


def test_a_drive_started_in_motion_stretches_its_spring_at_that_rate() -> None:
    """K (dtheta - dq) = dtau_J, and the link receives tau_J + D K^-1 dtau_J (paper eq. EOM_link)."""
    arm = nominal_physics().arms["arm"]
    drive, period = Drive(arm, 0.00025), 0.00025
    torque, rate = np.linspace(-5.0, 8.0, 7), np.linspace(300.0, -200.0, 7)
    link = ArmState(np.zeros(7), np.linspace(-1.0, 1.0, 7))
    drive.start(link, DriveStart(torque, rate))
    np.testing.assert_allclose(arm.stiffness * (drive.position - link.position), torque)
    np.testing.assert_allclose(arm.stiffness * (drive.velocity - link.velocity), rate)
    np.testing.assert_allclose(drive.transmission_torque, torque + arm.damping / arm.stiffness * rate)
    drive.sense(link.position + period * link.velocity - period * drive.velocity, link.velocity)
    np.testing.assert_allclose(drive.elastic_torque, torque + period * rate)


def test_until_a_delayed_command_arrives_the_drive_carries_its_load(arm):
    load, periods = np.linspace(1.0, 5.0, 7), 4
    drive = Drive(replace(arm, actuation_delay=periods * PERIOD), PERIOD)
    drive.reset(np.zeros(7), load)
    for step in range(periods + 1):
        drive.sense(np.zeros(7), np.zeros(7))
        drive.step(load + 1.0)
        if step < periods:
            np.testing.assert_allclose(drive.velocity, 0.0, atol=1e-12)
    assert np.all(drive.velocity > 0.0)
