"""The plant as a user of a real robot would meet it: from its measurements."""

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_control.closed_loop import make_plant
from impact_rs_control.plan import plan_trial
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.scene import Scene


@pytest.fixture(scope="module")
def plan():
    return plan_trial(Scene.resolve(load_scenario("push"), "cat_food", "2"))


def without_noise(plan):
    """The same trial with ideal sensors and no scatter."""
    scenario = plan.scene.scenario
    quiet = scenario.sensors.model_copy(
        update={name: 0.0 for name in type(scenario.sensors).model_fields if name != "object_period"}
    )
    still = scenario.scatter.model_copy(update={name: 0.0 for name in type(scenario.scatter).model_fields})
    scene = replace(plan.scene, scenario=scenario.model_copy(update={"sensors": quiet, "scatter": still}))
    return replace(plan, scene=scene)


def test_apparent_motor_inertia_identified_from_a_motion_is_the_reduced_one(plan):
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


def test_same_seed_gives_the_same_trial_bit_by_bit_and_another_seed_another_one(plan):
    first, _ = run(plan, 7)
    again, _ = run(plan, 7)
    other, _ = run(plan, 8)
    np.testing.assert_array_equal(first.arms["arm"].velocity, again.arms["arm"].velocity)
    np.testing.assert_array_equal(first.arms["arm"].torque, again.arms["arm"].torque)
    assert np.any(first.arms["arm"].position != other.arms["arm"].position)


def test_arm_held_by_gravity_torque_and_object_on_its_support_stay_where_they_are(plan):
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
