# SPDX-License-Identifier: Apache-2.0
"""The plant as a user of a real robot would meet it: from its measurements."""

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
import pytest
from trials import plan_of

from impact_rs_control.closed_loop import make_plant
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Load, LoadState


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
    period = plan.scene.scenario.timing.control_period
    rng = np.random.default_rng(3)
    frequency, phase = rng.uniform(1.0, 3.0, 7), rng.uniform(0.0, 2.0 * np.pi, 7)
    amplitude = np.array([3.0, 3.0, 2.0, 2.0, 0.8, 0.8, 0.5])
    positions, velocities, torques = [], [], []
    start = plant.measure().arms["arm"].position
    for tick in range(600):
        measured = plant.measure().arms["arm"]
        q, dq = measured.position, measured.velocity
        torque = model.inverse_dynamics(q, dq, np.zeros(7)) - 40.0 * (q - start) * amplitude / 3.0
        torque += amplitude * np.sin(2.0 * np.pi * frequency * tick * period + phase)
        positions.append(q)
        velocities.append(dq)
        torques.append(torque)
        plant.step({"arm": torque})
    plant.close()
    velocity = np.array(velocities)
    acceleration = (velocity[2:] - velocity[:-2]) / (2.0 * period)
    middle = slice(60, -60)
    for joint in range(7):
        rigid = np.array(
            [
                model.inverse_dynamics(q, dq, a)
                for q, dq, a in zip(positions[1:-1], velocity[1:-1], acceleration, strict=True)
            ]
        )
        # The torque acts from this tick to the next, the central difference stands at the tick: mean of two.
        applied = (np.array(torques)[1:-1] + np.array(torques)[:-2]) / 2.0
        left = (applied - rigid)[middle, joint]
        motor = acceleration[middle, joint]
        apparent = float(left @ motor / (motor @ motor))
        arm = plan.scene.physics.arms["arm"]
        assert apparent == pytest.approx(arm.motor_inertia_reduced[joint], rel=0.03)
        assert apparent < 0.5 * arm.motor_inertia_rotor[joint]


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


@pytest.mark.parametrize(("tilt", "slides"), [(0.05, False), (0.4, True)])
def test_an_object_on_a_slope_slides_with_what_friction_leaves(plan, tilt, slides):
    """g (sin a - mu cos a), or not at all."""
    quiet = without_noise(plan)
    gravity = 9.81 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    physics = replace(quiet.scene.physics, gravity=gravity, support_friction=0.2)
    plant = make_plant(quiet, 0, physics)
    hold = physics.robot_model("arm").gravity_torque(plan.arms["arm"].initial)
    start = plant.truth().object.position
    for _ in range(200):
        plant.step({"arm": hold})
    way = plant.truth().object.position - start
    plant.close()
    expected = 0.5 * 9.81 * (np.sin(tilt) - 0.2 * np.cos(tilt)) * 0.2**2 if slides else 0.0
    assert way[0] == pytest.approx(expected, rel=0.03, abs=1e-6)


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
