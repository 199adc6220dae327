# SPDX-License-Identifier: Apache-2.0
"""The torque loop runs with B_rho; what is felt is B_theta. Stability of a drive, and drives that are assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from trials import nominal_physics

from impact_rs_sim.assumed_drive import assumed_drive
from impact_rs_sim.drive import Drive, DriveStart
from impact_rs_sim.physics import JointFriction, Physics, ShaftFriction
from impact_rs_sim.plant.bullet_world import BulletWorld
from impact_rs_sim.robots.drive_stability import joint_stability, spectral_radius
from impact_rs_sim.robots.robot import RobotFacts, load_facts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState

# ---- the torque loop ------------------------------------------------------------------------------------------------

PERIOD = 0.00025  # s


@pytest.fixture
def arm(scene):
    return scene.physics.arms["arm"]


@pytest.fixture(scope="module")
def arm_of_scene():
    return nominal_physics().arms["arm"]


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


def numbers(low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    """Seven numbers of a range, one per joint."""
    return st.lists(st.floats(low, high), min_size=7, max_size=7).map(np.array)


@given(
    coulomb=numbers(0.0, 5.0),
    uneven=numbers(-1.0, 1.0),
    load=numbers(0.0, 0.5),
    shafts=numbers(0.0, 5.0),
    ratio=st.floats(-2.0, 2.0),
    velocity=numbers(-3.0, 3.0),
    transmitted=numbers(-80.0, 80.0),
)
def test_friction_by_load_direction_and_shaft_only_ever_takes_power(
    coulomb, uneven, load, shafts, ratio, velocity, transmitted
):
    """At each joint, and of shafts over all joints; kills a sign of the transmitted torque, and a reaction left out."""
    own = replace(JointFriction.none(7), coulomb=coulomb, asymmetry=uneven * coulomb, load=load)
    assert np.all(own.torque(velocity, transmitted) * velocity <= 1e-12)
    shared = replace(JointFriction.none(7), shafts=(ShaftFriction(shafts[:6], shafts[1:], ratio),))
    assert shared.torque(velocity, transmitted) @ velocity <= 1e-9


@settings(max_examples=20)
@given(uneven=numbers(-0.3, 0.3), load=numbers(0.0, 0.3), shafts=numbers(0.0, 1.0), start=numbers(-0.5, 0.5))
def test_compiled_drive_has_the_friction_of_its_docstring(arm_of_scene, uneven, load, shafts, start):
    """Kills a transmitted torque without its damper, a shaft that acts on one joint alone, and a joint off by one."""
    shared = ShaftFriction(shafts[:6], 0.5 * shafts[1:], -0.7), ShaftFriction(shafts[1:], 0.1 * shafts[:6], 1.0)
    friction = JointFriction(
        *np.outer((0.4, 0.2, 0.3, 0.05), np.ones(7)), None, np.linspace(0.005, 0.1, 7), uneven, load, shared
    )
    arm = replace(arm_of_scene, friction=friction)
    drive = Drive(arm, PERIOD)
    drive.reset(np.zeros(7), np.linspace(-40.0, 30.0, 7))
    drive.velocity = start
    drive.sense(np.zeros(7), np.zeros(7))
    torque = friction.torque(start, drive.transmission_torque)
    drive.step(np.zeros(7))
    shaping = arm.motor_inertia_rotor / arm.motor_inertia_reduced
    np.testing.assert_allclose(drive.friction_torque, shaping * torque, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("part", ["asymmetry", "load", "shafts"])
def test_part_of_friction_that_is_zero_changes_no_bit(arm, part):
    """k = 0 is Coulomb friction, and friction alike in both directions is symmetric: bit by bit, law and drive."""
    plain = JointFriction(np.full(7, 0.4), np.full(7, 0.2), np.full(7, 0.3), np.full(7, 0.05))
    nothing = (ShaftFriction(np.zeros(6), np.zeros(6), 1.0),) if part == "shafts" else np.zeros(7)
    both = plain, replace(plain, **{part: nothing})
    velocity = np.linspace(-0.4, 0.3, 7)
    torques = [friction.torque(velocity, np.full(7, 20.0)) for friction in both]
    np.testing.assert_array_equal(*torques)
    motions = []
    for friction in both:
        drive = Drive(replace(arm, friction=friction), PERIOD)
        drive.reset(np.zeros(7), np.full(7, 20.0))
        for _ in range(50):
            drive.sense(np.zeros(7), np.zeros(7))
            drive.step(np.full(7, 3.0))
        motions.append(drive.velocity)
    np.testing.assert_array_equal(*motions)


def test_friction_that_grows_with_the_load_doubles_with_it(arm):
    """A motor that turns at a constant speed needs k |tau_J| of torque, against motion in both directions."""
    friction = replace(JointFriction.none(7), load=np.full(7, 0.1))
    for load, velocity in ((20.0, 0.3), (40.0, 0.3), (-40.0, 0.3), (40.0, -0.3)):
        found = friction.torque(np.full(7, velocity), np.full(7, load))
        np.testing.assert_allclose(found, -0.1 * abs(load) * np.sign(velocity))


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


def test_commands_sent_before_the_start_arrive_after_it(arm):
    """Two periods late, as without delay and two periods later. Kills: a clock that does not begin at 0."""
    load, still = np.linspace(1.0, 5.0, 7), np.zeros(7)
    sent = (load + 2.0, load + 1.0)
    earlier = ((-np.inf, load), (-2.0 * PERIOD, sent[0]), (-PERIOD, sent[1]))
    late, prompt = Drive(replace(arm, actuation_delay=2.0 * PERIOD), PERIOD), Drive(arm, PERIOD)
    late.start(ArmState(still, still), DriveStart(load, still, earlier))
    prompt.start(ArmState(still, still), DriveStart(load, still))
    for torque in sent:
        for drive, desired in ((late, load), (prompt, torque)):
            drive.sense(still, still)
            drive.step(desired)
        np.testing.assert_allclose(late.velocity, prompt.velocity, rtol=1e-9)
    assert np.all(prompt.velocity > 0.0)


# ---- stability, found before anything is simulated ------------------------------------------------------------------

NOMINAL = nominal_physics("cat_food")


def stretch_after(link: float, motor: float, stiffness: float, damping: float, steps: int) -> float:
    """Largest stretch in the last of ``steps`` steps of the drive itself and a free link, from 1 rad [rad]."""
    arm = NOMINAL.arms["arm"]
    alike = replace(
        arm,
        motor_inertia_rotor=np.full(7, 3.0 * motor),
        motor_inertia_reduced=np.full(7, motor),
        stiffness=np.full(7, stiffness),
        damping=np.full(7, damping),
    )
    drive = Drive(alike, PERIOD)
    drive.position = np.ones(7)
    position, velocity, largest = np.zeros(7), np.zeros(7), 0.0
    still = np.zeros(7)
    for step in range(steps):
        drive.sense(position, velocity)
        velocity = velocity + PERIOD * drive.transmission_torque / link
        position = position + PERIOD * velocity
        drive.step(still)
        stretch = abs(float(drive.position[0] - position[0]))
        if stretch > 1e3:
            return stretch
        if step > steps - 50:
            largest = max(largest, stretch)
    return largest


@settings(max_examples=40)
@given(
    link=st.floats(1e-4, 1.0),
    motor=st.floats(0.02, 1.0),
    stiffness=st.floats(1e3, 2e4),
    damping=st.floats(1.0, 40.0),
)
def test_the_spectral_radius_tells_whether_the_drive_itself_diverges(
    link: float, motor: float, stiffness: float, damping: float
) -> None:
    found = joint_stability(link, motor, stiffness, damping, PERIOD)
    assume(abs(found.spectral_radius - 1.0) > 0.005)
    assert (stretch_after(link, motor, stiffness, damping, 1200) > 1.0) == (found.spectral_radius > 1.0)


@given(
    link=st.floats(1e-3, 1.0), stiffness=st.floats(1e3, 2e4), damping=st.floats(0.5, 40.0), share=st.floats(0.5, 1.5)
)
def test_what_would_do_is_just_what_does(link: float, stiffness: float, damping: float, share: float) -> None:
    """On either side of the damping, the stiffness and the period that are told, stability changes."""
    assume(abs(share - 1.0) > 1e-3)
    found = joint_stability(link, 0.1, stiffness, damping, PERIOD)
    for told, change in (
        (found.damping_below, lambda value: joint_stability(link, 0.1, stiffness, value, PERIOD)),
        (found.stiffness_below, lambda value: joint_stability(link, 0.1, value, damping, PERIOD)),
        (found.period_below, lambda value: joint_stability(link, 0.1, stiffness, damping, value)),
    ):
        if told > 0.0:
            assert (change(share * told).spectral_radius < 1.0) == (share < 1.0)


def test_without_damping_a_joint_swings_for_ever() -> None:
    assert joint_stability(0.1, 0.1, 1e4, 0.0, PERIOD).spectral_radius == pytest.approx(1.0, abs=1e-9)


def test_uncoupled_joints_are_as_stable_as_the_worst_of_them() -> None:
    link, motor = np.array([0.5, 0.001]), np.array([0.2, 0.07])
    stiffness, damping = np.array([14000.0, 8000.0]), np.array([12.0, 6.0])
    inverse = np.linalg.inv(np.diag(link)) + np.diag(1.0 / motor)
    singles = [
        joint_stability(*values, PERIOD).spectral_radius for values in zip(link, motor, stiffness, damping, strict=True)
    ]
    assert spectral_radius(inverse, stiffness, damping, PERIOD) == pytest.approx(max(singles))


def test_links_that_are_coupled_are_less_stable_together() -> None:
    mass = np.array([[0.5, 0.09], [0.09, 0.02]])
    inverse = np.linalg.inv(mass)
    stiffness, damping, motor = np.array([14000.0, 14000.0]), np.array([12.0, 12.0]), 0.2
    together = spectral_radius(inverse + np.eye(2) / motor, stiffness, damping, PERIOD)
    alone = max(joint_stability(1.0 / inverse[i, i], motor, 14000.0, 12.0, PERIOD).spectral_radius for i in (0, 1))
    assert together > alone > 0.0


# ---- drives that are assumed ----------------------------------------------------------------------------------------

UR5E, FR3, FER = (load_facts(name) for name in ("ur5e", "franka_fr3", "franka_fer"))


@pytest.mark.parametrize("facts", [FER, FR3, UR5E])
def test_assumed_drives_are_stable_and_as_published_where_that_is_known(facts: RobotFacts) -> None:
    effector = load_scenario("push").robots["arm"].end_effector.build()
    values = {name: np.array(row) for name, row in assumed_drive(facts, effector, PERIOD).items()}
    inertia = values.get("motor_inertia_reduced", values["motor_inertia_rotor"])
    model = RobotModel(facts, effector)
    inverse = np.linalg.inv(model.mass_matrix(0.3 * np.ones(facts.joint_count))) + np.diag(1.0 / inertia)
    assert spectral_radius(inverse, values["stiffness"], values["damping"], PERIOD) < 1.0
    assert ("motor_inertia_reduced" in values) == facts.joint_torque_loop
    published = facts.reflected_rotor_inertia_other_source_kg_m2
    if published is not None:
        np.testing.assert_allclose(values["motor_inertia_rotor"], published, rtol=5e-3)


@pytest.mark.parametrize("facts", [FR3, UR5E, load_facts("kuka_iiwa14")])
def test_link_velocity_feedback_leaves_an_assumed_drive_stable(facts: RobotFacts) -> None:
    """Eigenvalues of motor, spring and link with the feedback 40 / s of the controller through both inertias.

    B ddtheta = -(M + B) d dq - s,  M ddq = s,  s = K (theta - q) + D (dtheta - dq): the joint by itself, with the
    link that it has in the middle of its range.
    """
    model = RobotModel(facts, load_scenario("push").robots["arm"].end_effector.build())
    values = {name: np.array(row) for name, row in assumed_drive(facts, model.end_effector, PERIOD).items()}
    motors = values.get("motor_inertia_reduced", values["motor_inertia_rotor"])
    inertia = 1.0 / np.diag(np.linalg.inv(model.mass_matrix(0.5 * (model.position_min + model.position_max) + 0.3)))
    for joint in range(3):
        m, b, k, d = inertia[joint], motors[joint], values["stiffness"][joint], values["damping"][joint]
        system = np.array(
            [
                [0.0, 0.0, 1.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [-k / m, k / m, -d / m, d / m],
                [k / b, -k / b, d / b - (m + b) * 40.0 / b, -d / b],
            ]
        )
        assert np.linalg.eigvals(system).real.max() < 1e-6
