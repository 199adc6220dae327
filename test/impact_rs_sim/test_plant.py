# SPDX-License-Identifier: Apache-2.0
"""The plant as a user of a real robot would meet it: its measurements, its sensors, effects outside the library."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
import pytest
from trials import plan_of

from impact_rs_control.closed_loop import make_plant
from impact_rs_control.plan import TrialPlan
from impact_rs_sim.drive import Drive
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Load, LoadState
from impact_rs_sim.plant.plant import Plant, PlantExtension
from impact_rs_sim.plant.sensors import ArmSensors, ObjectTracker
from impact_rs_sim.plant.unmodelled import (
    LAWS,
    OUTSIDE,
    Backlash,
    DriftingFriction,
    FlexibleBase,
    HiddenLaw,
    TorqueRipple,
)
from impact_rs_sim.scenarios.trial_settings import Sensors
from impact_rs_sim.scene import ArmMotion, ArmState

# ---- the plant ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plan():
    return plan_of("push", "cat_food", "2")


def without_noise(plan):
    """The same trial with ideal sensors and no scatter."""
    scenario = plan.scene.scenario
    quiet = scenario.sensors.model_copy(
        update={name: 0.0 for name in type(scenario.sensors).model_fields if name != "object_period"}
    )
    still = scenario.scatter.model_copy(update=dict.fromkeys(type(scenario.scatter).model_fields, 0.0))
    scene = replace(plan.scene, scenario=scenario.model_copy(update={"sensors": quiet, "scatter": still}))
    return replace(plan, scene=scene)


def test_motor_inertia_identified_from_motion_is_the_reduced_one(plan):
    """tau_d - M ddq - h = B ddq in free motion; the fit finds B_theta although the motor is integrated with B_rho."""
    plan = without_noise(plan)
    plant, model = make_plant(plan, seed=0), plan.scene.models["arm"]
    period, arm = plan.scene.scenario.timing.control_period, plan.scene.physics.arms["arm"]
    rng = np.random.default_rng(3)
    frequency, phase = rng.uniform(1.0, 3.0, 7), rng.uniform(0.0, 2.0 * np.pi, 7)
    amplitude = np.array([3.0, 3.0, 2.0, 2.0, 0.8, 0.8, 0.5])
    start, rows = plant.measure().arms["arm"].position, []
    for tick in range(600):
        measured = plant.measure().arms["arm"]
        torque = model.inverse_dynamics(measured.position, measured.velocity, np.zeros(7))
        swing = np.sin(2.0 * np.pi * frequency * tick * period + phase)
        torque += amplitude * (swing - 40.0 / 3.0 * (measured.position - start))
        rows.append((measured.position, measured.velocity, torque))
        plant.step({"arm": torque})
    plant.close()
    q, dq, torque = (np.array(column) for column in zip(*rows, strict=True))
    ddq = (dq[2:] - dq[:-2]) / (2.0 * period)
    rigid = np.array([model.inverse_dynamics(*state) for state in zip(q[1:-1], dq[1:-1], ddq, strict=True)])
    # The torque acts from this tick to the next, the central difference stands at the tick: mean of two.
    left, ddq = ((torque[1:-1] + torque[:-2]) / 2.0 - rigid)[60:-60], ddq[60:-60]
    apparent = np.sum(left * ddq, axis=0) / np.sum(ddq**2, axis=0)
    np.testing.assert_allclose(apparent, arm.motor_inertia_reduced, rtol=0.03)


def run(plan, seed, ticks=30):
    plant = make_plant(plan, seed)
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    for _ in range(ticks):
        plant.step({"arm": hold})
    measured, truth = plant.measure(), plant.truth()
    plant.close()
    return measured, truth


def test_the_seed_decides_a_trial_bit_by_bit(plan):
    first, _ = run(plan, 7)
    again, _ = run(plan, 7)
    other, _ = run(plan, 8)
    np.testing.assert_array_equal(first.arms["arm"].velocity, again.arms["arm"].velocity)
    np.testing.assert_array_equal(first.arms["arm"].torque, again.arms["arm"].torque)
    assert np.any(first.arms["arm"].position != other.arms["arm"].position)


def test_arm_and_object_at_rest_stay_where_they_are(plan):
    _, truth = run(without_noise(plan), 0, ticks=400)
    np.testing.assert_allclose(truth.arms["arm"].position, plan.arms["arm"].initial, atol=2e-5)
    np.testing.assert_allclose(truth.object.position, plan.scene.object.position, atol=2e-5)


def test_measurement_is_quantised_and_noisy_as_the_scenario_says(plan):
    sensors = plan.scene.scenario.sensors
    plant = make_plant(plan, 1)
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    velocity_error, steps = [], []
    for _ in range(500):
        measured, truth = plant.measure().arms["arm"], plant.truth().arms["arm"]
        velocity_error.append(measured.velocity - truth.velocity)
        steps.append(measured.position / sensors.joint_position_resolution)
        assert np.all(np.abs(measured.position - truth.position) <= sensors.joint_position_resolution / 2.0 + 1e-15)
        plant.step({"arm": hold})
    plant.close()
    assert np.std(velocity_error) == pytest.approx(sensors.joint_velocity_noise, rel=0.05)
    assert np.allclose(steps, np.round(steps), atol=1e-6)


def test_torque_that_is_no_torque_is_refused(plan):
    plant = make_plant(plan, 0)
    for bad in (np.full(7, np.nan), np.zeros(6)):
        with pytest.raises(InputError, match="7 finite numbers"):
            plant.step({"arm": bad})
    plant.close()


@dataclass(frozen=True)
class Known(Load):
    """A load of known numbers, which keeps what it was told."""

    force: np.ndarray | None = None
    torque: np.ndarray | None = None
    motor: np.ndarray | None = None
    told: list[LoadState] = field(default_factory=list)

    def motor_torque(self, state: LoadState) -> np.ndarray | None:
        self.told.append(state)
        return self.motor

    def joint_torque(self, state: LoadState) -> np.ndarray | None:
        return self.torque

    def end_effector_force(self, state: LoadState) -> np.ndarray | None:
        return self.force


def loaded(plan, *loads):
    """A plant without noise whose arm has loads, and its rigid model."""
    quiet = without_noise(plan)
    arm = quiet.scene.physics.arms["arm"]
    physics = replace(quiet.scene.physics, arms={"arm": replace(arm, loads=loads)})
    return make_plant(quiet, 0, physics), quiet.scene.models["arm"]


def motion_of(plant, torque, ticks):
    """q and dq after every tick under a constant desired torque."""
    states = []
    for _ in range(ticks):
        plant.step({"arm": torque})
        truth = plant.truth().arms["arm"]
        states.append((truth.position, truth.velocity))
    plant.close()
    return states


PUSHES = {
    "force on the end effector": lambda model, q: (
        Known(force=np.array([6.0, -9.0, 4.0])),
        model.jacobian(q)[:3].T @ [6.0, -9.0, 4.0],
    ),
    "torque on the joints": lambda model, q: (Known(torque=np.linspace(1.0, -2.0, 7)), np.linspace(1.0, -2.0, 7)),
    "torque on the motors": lambda model, q: (Known(motor=np.linspace(1.0, -2.0, 7)), np.linspace(1.0, -2.0, 7)),
}


@pytest.mark.parametrize("kind", PUSHES)
def test_a_load_accelerates_the_arm_as_the_rigid_model_says(plan, kind):
    """(M + B_theta) ddq = tau_load while gravity is held: with its sign, and with the inertia of links and motors."""
    start = plan.arms["arm"].initial
    load, torque = PUSHES[kind](plan.scene.models["arm"], start)
    plant, model = loaded(plan, load)
    ticks = 100
    q, dq = motion_of(plant, model.gravity_torque(start), ticks)[-1]
    inertia = model.mass_matrix(start) + np.diag(plan.scene.physics.arms["arm"].motor_inertia_reduced)
    expected = np.linalg.solve(inertia, torque)
    time = ticks * plan.scene.scenario.timing.control_period
    np.testing.assert_allclose(
        q - start, 0.5 * expected * time**2, rtol=0.1, atol=0.04 * np.abs(expected).max() * time**2
    )
    tip = model.jacobian(start) @ (q - start)
    wanted = model.jacobian(start) @ expected * 0.5 * time**2
    np.testing.assert_allclose(tip, wanted, atol=0.05 * np.linalg.norm(wanted))


def test_loads_that_oppose_each_other_leave_the_arm_at_rest(plan):
    """A force at E against the joint torque that it amounts to: J^T f, from both sides."""
    start, force = plan.arms["arm"].initial, np.array([6.0, -9.0, 4.0])
    torque = plan.scene.models["arm"].jacobian(start)[:3].T @ force
    plant, model = loaded(plan, Known(force=force), Known(torque=-torque))
    states = motion_of(plant, model.gravity_torque(start), 100)
    np.testing.assert_allclose(states[-1][0], start, atol=1e-5)


def test_the_torque_sensor_feels_what_the_joints_carry(plan):
    """At rest tau_J = g - J^T f: a force that carries a part of the arm's weight leaves less to its joints."""
    start, force = plan.arms["arm"].initial, np.array([0.0, 0.0, 20.0])
    plant, model = loaded(plan, Known(force=force))
    hold = model.gravity_torque(start) - model.jacobian(start)[:3].T @ force
    felt = []
    for _ in range(150):
        plant.step({"arm": hold})
        felt.append(plant.measure().arms["arm"].torque)
    plant.close()
    np.testing.assert_allclose(np.mean(felt[60:], axis=0), hold, atol=0.05)


def test_a_load_is_told_time_place_and_speed(plan):
    load = Known()
    plant, model = loaded(plan, load)
    states = motion_of(plant, model.gravity_torque(plan.arms["arm"].initial) + np.linspace(2.0, 1.0, 7), 50)
    q, dq = states[-2]
    state = load.told[-1]
    assert state.time == pytest.approx(0.049)
    np.testing.assert_array_equal(state.joint_position, q)
    np.testing.assert_array_equal(state.joint_velocity, dq)
    np.testing.assert_allclose(state.position, model.placement(q).translation)
    np.testing.assert_allclose(state.velocity, model.jacobian(q)[:3] @ dq)
    np.testing.assert_allclose(state.impact_position, plan.scene.scenario.robots["arm"].impact.position)


def test_the_tracker_sees_the_object_once_per_its_period(plan):
    plant = make_plant(plan, 0)
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    seen = []
    for _ in range(13):
        measured = plant.measure()
        assert (measured.object is None) == (plant.truth().object is None)
        if measured.object is not None:
            assert measured.object.time == measured.time
            seen.append(measured.time)
        plant.step({"arm": hold})
    plant.close()
    assert seen == pytest.approx([0.0, 0.004, 0.008, 0.012])


def test_trials_scatter_as_the_scenario_says(plan):
    """Pose of the object in the plane, start of the arm and friction of the support, over many seeds."""
    scatter = plan.scene.scenario.scatter.model_copy(update={"support_friction": 0.05})
    scenario = plan.scene.scenario.model_copy(update={"scatter": scatter})
    scattered = replace(plan, scene=replace(plan.scene, scenario=scenario))
    poses, yaws, starts, frictions = [], [], [], []
    for seed in range(80):
        plant = make_plant(scattered, seed)
        truth = plant.truth()
        poses.append(truth.object.position - plan.scene.object.position)
        yaws.append(pin.log3(truth.object.rotation))
        starts.append(truth.arms["arm"].position - plan.arms["arm"].initial)
        frictions.append(plant.physics.support_friction / plan.scene.physics.support_friction - 1.0)
        plant.close()
    share = 4.0 / np.sqrt(2.0 * 80.0)
    for values, noise in (
        (np.array(poses)[:, 0], scatter.object_position),
        (np.array(poses)[:, 1], scatter.object_position),
        (np.array(yaws)[:, 2], scatter.object_yaw),
        (np.array(starts), scatter.joint_position),
        (np.array(frictions), 0.05),
    ):
        assert np.std(values) == pytest.approx(noise, rel=share)
        assert abs(np.mean(values)) < 4.0 * noise / np.sqrt(80.0)
    np.testing.assert_allclose(np.array(poses)[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.array(yaws)[:, :2], 0.0, atol=1e-9)


def test_a_turned_object_is_scattered_about_the_vertical(plan):
    """Kills: the yaw turns about z of the object, which lies, and tips it into its support."""
    lying = replace(plan.scene.object, rotation=pin.rpy.rpyToMatrix(np.pi / 2.0, 0.0, 0.0))
    plant = make_plant(replace(plan, scene=replace(plan.scene, object=lying)), 0)
    turn = pin.log3(plant.truth().object.rotation @ lying.rotation.T)
    plant.close()
    np.testing.assert_allclose(turn[:2], 0.0, atol=1e-9)
    assert abs(turn[2]) > 1e-5


def test_a_trial_ends_when_its_time_is_up(plan):
    short = plan.scene.scenario.timing.model_copy(update={"duration": 0.003})
    scenario = plan.scene.scenario.model_copy(update={"timing": short})
    plant = make_plant(replace(plan, scene=replace(plan.scene, scenario=scenario)), 0)
    hold = {"arm": plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)}
    for _ in range(3):
        plant.step(hold)
    assert plant.time == pytest.approx(0.003)
    with pytest.raises(InputError, match=r"over after 0\.003 s"):
        plant.step(hold)
    plant.close()


# ---- sensors --------------------------------------------------------------------------------------------------------

SAMPLES, JOINTS = 4000, 3
NOISY = Sensors(
    joint_position_resolution=1e-3,
    joint_velocity_noise=0.02,
    joint_torque_noise=0.5,
    object_position_noise=1e-3,
    object_orientation_noise=0.01,
)
IDEAL = Sensors(**dict.fromkeys(set(Sensors.model_fields) - {"object_period"}, 0.0))
Q, DQ, TORQUE = np.array([0.30034, -1.2, 0.5]), np.array([0.1, 0.2, -0.3]), np.array([5.0, -10.0, 1.0])
THETA, DTHETA = Q + 0.01, DQ - 0.05
MOTION = ArmMotion(Q, DQ, TORQUE, THETA, DTHETA)
# Four standard deviations of a standard deviation estimated from all samples.
SHARE = 4.0 / np.sqrt(2.0 * SAMPLES * JOINTS)


@pytest.fixture(scope="module")
def errors() -> dict[str, np.ndarray]:
    """Measured less true, ``(SAMPLES, JOINTS)`` by signal."""
    sensors = ArmSensors(NOISY, JOINTS, SAMPLES, np.random.default_rng(1))
    measured = [sensors.measure(tick, MOTION) for tick in range(SAMPLES)]
    truth = {"position": Q, "velocity": DQ, "torque": TORQUE, "motor_position": THETA, "motor_velocity": DTHETA}
    return {name: np.array([getattr(each, name) for each in measured]) - value for name, value in truth.items()}


@pytest.mark.parametrize(("name", "noise"), [("velocity", 0.02), ("motor_velocity", 0.02), ("torque", 0.5)])
def test_noise_has_the_stated_size_and_no_bias(errors: dict[str, np.ndarray], name: str, noise: float) -> None:
    assert np.std(errors[name]) == pytest.approx(noise, rel=SHARE)
    assert np.abs(np.mean(errors[name])) < 4.0 * noise / np.sqrt(SAMPLES * JOINTS)


def test_noise_is_white_and_its_own_in_every_joint_and_signal(errors: dict[str, np.ndarray]) -> None:
    rows = np.hstack([errors[name] for name in ("velocity", "motor_velocity", "torque")])
    between = np.corrcoef(rows.T) - np.eye(rows.shape[1])
    in_time = [np.corrcoef(column[:-1], column[1:])[0, 1] for column in rows.T]
    assert np.abs(between).max() < 5.0 / np.sqrt(SAMPLES)
    assert np.abs(in_time).max() < 5.0 / np.sqrt(SAMPLES)


def test_an_encoder_gives_the_nearest_of_its_steps() -> None:
    sensors = ArmSensors(NOISY, JOINTS, 1, np.random.default_rng(0))
    for angle in (0.30034, 0.30066, -0.30034, -0.30066):
        q = np.full(JOINTS, angle)
        measured = sensors.measure(0, ArmMotion(q, DQ, TORQUE, -q, DTHETA))
        np.testing.assert_allclose(measured.position, np.round(angle, 3), atol=1e-12)
        np.testing.assert_allclose(measured.motor_position, np.round(-angle, 3), atol=1e-12)


def test_ideal_sensors_give_copies_of_the_truth() -> None:
    q = Q.copy()
    measured = ArmSensors(IDEAL, JOINTS, 1, np.random.default_rng(0)).measure(
        0, ArmMotion(q, DQ, TORQUE, THETA, DTHETA)
    )
    q += 1.0
    for value, truth in (
        (measured.position, Q),
        (measured.velocity, DQ),
        (measured.torque, TORQUE),
        (measured.motor_position, THETA),
        (measured.motor_velocity, DTHETA),
    ):
        np.testing.assert_array_equal(value, truth)


def test_the_same_tick_is_measured_the_same_twice() -> None:
    sensors = ArmSensors(NOISY, JOINTS, 5, np.random.default_rng(1))
    first, again, other = (sensors.measure(tick, MOTION) for tick in (2, 2, 3))
    np.testing.assert_array_equal(first.velocity, again.velocity)
    assert np.all(first.velocity != other.velocity)


def test_the_tracker_is_off_in_position_and_turn_by_what_the_scenario_says() -> None:
    tracker = ObjectTracker(NOISY, SAMPLES, np.random.default_rng(3))
    position, rotation = np.array([0.4, -0.1, 0.5]), pin.rpy.rpyToMatrix(0.3, -0.2, 1.0)
    shifts, turns = [], []
    for sample in range(SAMPLES):
        seen = tracker.measure(sample, 0.1 * sample, position, rotation)
        assert seen.time == 0.1 * sample
        shifts.append(seen.position - position)
        turns.append(pin.log3(rotation.T @ pin.Quaternion(seen.quaternion).matrix()))
    for values, noise in ((shifts, 1e-3), (turns, 0.01)):
        assert np.std(values) == pytest.approx(noise, rel=SHARE)
        assert np.abs(np.mean(values, axis=0)).max() < 4.0 * noise / np.sqrt(SAMPLES)


def test_an_ideal_tracker_tells_the_pose_as_x_y_z_w() -> None:
    seen = ObjectTracker(IDEAL, 1, np.random.default_rng(0)).measure(0, 0.0, Q, pin.rpy.rpyToMatrix(0.0, 0.0, 0.8))
    np.testing.assert_allclose(seen.quaternion, [0.0, 0.0, np.sin(0.4), np.cos(0.4)], atol=1e-12)
    np.testing.assert_array_equal(seen.position, Q)


# ---- effects outside the library ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def juice() -> TrialPlan:
    return plan_of("push", "juice", "case_1")


class Posed:
    """Stands for a plant at one moment."""

    def __init__(self, juice: TrialPlan, velocity: float, time: float = 0.0) -> None:
        self.physics = juice.scene.physics
        self.time = time
        self._state = ArmState(juice.arms["arm"].initial, np.full(7, velocity))

    def link_state(self, arm: str) -> ArmState:
        return self._state


def test_a_transmission_with_play_carries_what_is_beyond_it(juice: TrialPlan) -> None:
    arm = juice.scene.physics.arms["arm"]
    play = 3e-4
    for stretch, passed in ((0.5 * play, 0.0), (-0.9 * play, 0.0), (4.0 * play, 3.0 * play), (-2.0 * play, -play)):
        drive = Drive(replace(arm, damping=np.zeros(7)), 2.5e-4)
        drive.position = np.full(7, stretch)
        drive.sense(np.zeros(7), np.zeros(7))
        Backlash(1.0, 0).after_sense(Posed(juice, 0.0), "arm", drive)
        np.testing.assert_allclose(drive.elastic_torque, arm.stiffness * passed, atol=1e-9)
        np.testing.assert_allclose(drive.transmission_torque, arm.stiffness * passed, atol=1e-9)


def test_drifting_friction_opposes_motion_and_grows_with_time_and_repeat(juice: TrialPlan) -> None:
    def torque(velocity: float, time: float, repeat: int, magnitude: float = 1.0) -> float:
        found = DriftingFriction(magnitude, repeat).joint_torque(Posed(juice, velocity, time), "arm")
        assert np.ptp(found) == 0.0
        return float(found[0])

    assert torque(1.0, 0.0, 0) == pytest.approx(-0.3 * 0.2)
    assert torque(-1.0, 0.0, 0) == pytest.approx(0.3 * 0.2)
    assert torque(1.0, 1.5, 0) - torque(1.0, 0.5, 0) == pytest.approx(-0.3)
    assert torque(1.0, 0.0, 2) - torque(1.0, 0.0, 0) == pytest.approx(-0.3)
    assert torque(1.0, 0.0, 0, 2.0) == pytest.approx(2.0 * torque(1.0, 0.0, 0))
    assert torque(0.0, 1.0, 1) == 0.0


def test_torque_ripple_repeats_sixty_times_a_turn_and_does_no_work(juice: TrialPlan) -> None:
    def torque(ahead: float) -> float:
        posed = Posed(juice, 0.3)
        posed._state = ArmState(np.full(7, ahead), np.zeros(7))
        return float(TorqueRipple(2.0, 0).joint_torque(posed, "arm")[0])

    period = 2.0 * np.pi / 60.0
    assert torque(0.7 + period) == pytest.approx(torque(0.7))
    found = [torque(ahead) for ahead in np.linspace(0.0, period, 200, endpoint=False)]
    assert max(found) == pytest.approx(0.2, rel=1e-3)
    assert np.mean(found) == pytest.approx(0.0, abs=1e-12)


def test_a_lubricated_support_brakes_more_the_faster_the_object_slides(juice: TrialPlan) -> None:
    """dv/dt = -mu g (1 + s v) from v0: (1 + s v) falls as exp(-s mu g t), in closed form."""
    slope, duration = 0.5 * 4.0, 0.1
    extension = OUTSIDE["lubricated_support"](4.0, 0)
    plant = make_plant(juice, 0, extension=extension)
    state = plant.world.object_state()
    plant.world.set_object(
        replace(state, position=state.position - [0.7, 0.5, 0.0], twist=np.array([0.8, 0.6, 0.0, 0.0, 0.0, 0.0]))
    )
    hold = juice.scene.models["arm"].gravity_torque(juice.arms["arm"].initial)
    for _ in range(round(duration / 0.001)):
        plant.step({"arm": hold})
    left = float(np.linalg.norm(plant.world.object_state().twist[:2]))
    braking = slope * plant.physics.support_friction * 9.81 * duration
    assert left == pytest.approx(((1.0 + slope) * np.exp(-braking) - 1.0) / slope, rel=0.02)
    plant.close()


def settled(juice: TrialPlan, extension: PlantExtension | None) -> Plant:
    """A plant that has held its pose for a tenth of a second."""
    plant = make_plant(juice, 0, extension=extension)
    hold = juice.scene.models["arm"].gravity_torque(juice.arms["arm"].initial)
    for _ in range(100):
        plant.step({"arm": hold})
    return plant


def test_loose_contents_are_a_part_of_the_mass_and_rest_on_the_object(juice: TrialPlan) -> None:
    extension = OUTSIDE["loose_contents"](1.0, 0)
    plant = settled(juice, extension)
    client = plant.world.client
    bodies = range(client.getNumBodies())
    movable = {body: client.getDynamicsInfo(body, -1)[0] for body in bodies if body not in plant.world.arms.values()}
    inside = {body: mass for body, mass in movable.items() if mass > 0.0}
    assert sum(inside.values()) == pytest.approx(juice.scene.physics.object.mass)
    assert inside[plant.world.object] == pytest.approx(0.8 * juice.scene.physics.object.mass)
    (slab,) = set(inside) - {plant.world.object}
    top = plant.world.object_state().position[2] + juice.scene.physics.object.size[2] / 2.0
    assert client.getBasePositionAndOrientation(slab)[0][2] == pytest.approx(top + 0.01, abs=5e-4)
    plant.close()


def test_a_flexible_base_is_still_where_nothing_pushes_it(juice: TrialPlan) -> None:
    plant = settled(juice, None)
    plain = plant.truth().arms["arm"].position
    plant.close()
    plant = settled(juice, OUTSIDE["flexible_base"](1.0, 0))
    np.testing.assert_allclose(plant.truth().arms["arm"].position, plain, atol=1e-4)
    plant.close()


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_larger_outside_effect_changes_a_trial_more(juice: TrialPlan, name: str) -> None:
    """Seen where the arm is after it was driven into the object by the same torques."""
    earlier = {"duration": 0.5, "nominal_impact": 0.3, "approach": 0.3, "window_after": 0.1}
    short = juice.scene.scenario.timing.model_copy(update=earlier)
    scenario = juice.scene.scenario.model_copy(update={"timing": short})
    arm = juice.scene.arms["arm"]
    model = juice.scene.models["arm"]
    driven = replace(
        juice,
        scene=replace(juice.scene, scenario=scenario),
        arms={"arm": replace(juice.arms["arm"], initial=arm.position)},
    )
    push = model.gravity_torque(arm.position) + model.jacobian(arm.position)[:3].T @ np.array([0.0, -25.0, 0.0])
    ends = []
    for extension in (None, OUTSIDE[name](1.0, 1), OUTSIDE[name](4.0, 1)):
        plant = make_plant(driven, 0, extension=extension)
        for _ in range(250):
            plant.step({"arm": push})
        ends.append(np.append(plant.truth().arms["arm"].position, plant.world.object_state().position))
        plant.close()
    small, large = (np.linalg.norm(end - ends[0]) for end in ends[1:])
    assert 1e-6 < small < large


@pytest.fixture(scope="module")
def grab() -> TrialPlan:
    return plan_of("grab", "juice", "case_1")


def pushed(grab: TrialPlan, extension: PlantExtension, torque: float = 0.0) -> Plant:
    """The plant of two arms after ten periods with a further torque on joint 1 of the left one [N m]."""
    plant = make_plant(grab, 0, extension=extension)
    hold = {name: grab.scene.models[name].gravity_torque(arm.initial) for name, arm in grab.arms.items()}
    hold["left"][0] += torque
    for _ in range(10):
        plant.step(hold)
    return plant


def test_a_law_of_the_object_acts_once_beside_two_arms(grab: TrialPlan) -> None:
    """Kills: a push for every arm. Twice the weight upwards lifts the object with g."""
    weight = grab.scene.physics.object.mass * 9.81
    plant = pushed(grab, HiddenLaw("object", lambda state: np.array([0.0, 0.0, 2.0 * weight])))
    speed = plant.world.object_state().twist[2]
    plant.close()
    assert speed == pytest.approx(9.81 * 0.01, rel=0.05)


def test_the_base_of_an_arm_at_rest_is_still_beside_one_that_moves(grab: TrialPlan) -> None:
    """Kills: one base whose momentum is that of one arm, then of the other."""
    base = FlexibleBase(1.0, 0)
    plant = pushed(grab, base, torque=5.0)
    left, right = (np.abs(base.joint_torque(plant, name)).max() for name in ("left", "right"))
    plant.close()
    assert right < 0.02 * left


@pytest.mark.parametrize(("scenario", "name", "case"), [("excite", "none", "slow"), ("push", "juice", "case_1")])
def test_a_spring_pulls_the_object_that_is_hit_and_none_out_of_reach(scenario: str, name: str, case: str) -> None:
    juice = plan_of(scenario, name, case)
    plant = make_plant(juice, 0, extension=LAWS["object_spring_from_place"](4000.0, 0))
    position = plant.world.object_state().position - [0.0, 0.3, 0.0]
    plant.world.set_object(replace(plant.world.object_state(), position=position))
    hold = juice.scene.models["arm"].gravity_torque(juice.arms["arm"].initial)
    for _ in range(20):
        plant.step({"arm": hold})
    moved = plant.world.object_state().position - position
    plant.close()
    assert moved[1] > 1e-3 if scenario == "push" else np.linalg.norm(moved) < 1e-4
