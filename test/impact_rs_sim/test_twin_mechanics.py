# SPDX-License-Identifier: Apache-2.0
"""The twin in the plant's place: tick by tick it is what it is in one call, and a trial on it is one on Bullet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import restitution_of
from trials import plan_of
from twin_scene import AGAINST_Y, BOX_MASS, PERIOD, RAIL_MASS, SIZE, TOWARDS_Y, rail, resting, scene

from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_sim.bullet_mechanics import BulletMechanics
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.mechanics import Simulator
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant import PlantExtension
from impact_rs_sim.robot import Array
from impact_rs_sim.scene import ArmState
from impact_rs_sim.twin import TwinJob, simulate
from impact_rs_sim.twin_mechanics import TwinMechanics

TICK = 4  # periods of the torque loop


def two_rails() -> Physics:
    """A delayed rail that hits a box, whose load is a formula, and one that stands behind."""
    spec = FormulaSpec.model_validate(
        {
            "name": "wind",
            "sentence": "Wind blows.",
            "end_effector_force": {"y": "-c * (1 + t) * vy"},
            "parameters": {"c": {"unit": "N s/m", "nominal": 0.0, "lower": 0.0, "upper": 9.0, "scale": 1.0}},
        }
    )
    late = rail(np.array([0.0, SIZE[1] / 2.0 + 2e-3, 0.0]), AGAINST_Y, pad_damping=400.0)
    behind = rail(np.array([0.0, -SIZE[1] / 2.0 - 0.01, 0.0]), TOWARDS_Y, pad_damping=400.0)
    physics = scene({"late": replace(late, actuation_delay=0.0013), "behind": behind}, pad_friction=0.5)
    return FormulaEffect(spec).apply_vector(physics, np.array([3.0]))


def test_tick_by_tick_it_moves_as_in_one_call() -> None:
    physics, ticks = two_rails(), 60
    torques = {name: np.cumsum(np.random.default_rng(4).normal(0.0, 2.0, (ticks, 1)), axis=0) for name in physics.arms}
    arms = {name: ArmState(np.zeros(1), np.full(1, 0.4)) for name in physics.arms}
    drives = dict.fromkeys(physics.arms, DriveStart(np.zeros(1), np.zeros(1)))
    acting = dict.fromkeys(physics.arms, np.repeat(np.arange(ticks, dtype=np.int32), TICK))
    time = np.arange(ticks + 1) * TICK * PERIOD
    (whole,) = simulate([TwinJob(physics, arms, drives, torques, acting, time, PERIOD, object=resting())])
    assert whole.contact_steps > 20
    mechanics = TwinMechanics.load(physics, PERIOD)
    mechanics.start(arms, drives, resting())
    for number in range(ticks):
        mechanics.step({name: rows[number] for name, rows in torques.items()}, TICK, time[number])
        np.testing.assert_array_equal(mechanics.arm("late").velocity, whole.arms["late"].velocity[number + 1])
        np.testing.assert_array_equal(mechanics.arm("behind").torque, whole.arms["behind"].torque[number + 1])
        np.testing.assert_array_equal(mechanics.object_state().twist, whole.twists[number + 1])
        np.testing.assert_array_equal(mechanics.object_state().position, whole.poses[number + 1, :3])


def test_pads_feel_what_the_box_gains() -> None:
    """Over a hit the forces on a pad, period by period, are minus the momentum of the free box."""
    physics = scene({"rail": rail(np.array([0.0, SIZE[1] / 2.0 + 1e-3, 0.0]), AGAINST_Y)})
    mechanics = TwinMechanics.load(physics, PERIOD)
    still = np.zeros(1)
    mechanics.start({"rail": ArmState(still, np.full(1, 0.005))}, {"rail": DriveStart(still, still)}, resting())
    impulse = np.zeros(3)
    for number in range(1200):
        mechanics.step({"rail": still}, 1, number * PERIOD)
        impulse += PERIOD * mechanics.pad_force("rail")
    gained = BOX_MASS * mechanics.object_state().twist[:3]
    assert gained[1] < -0.003
    np.testing.assert_allclose(impulse, -gained, atol=1e-9)


def trial(simulator: Simulator, seed: int = 3) -> tuple[Array, Array, Array]:
    """True joint velocities, twists of the object, and net feedback of a push with all its noise and scatter."""
    plan = plan_of("push", "cat_food", "case_2")
    plant = make_plant(plan, seed, simulator=simulator)
    velocities, twists, nets = [], [], []
    for tick in run_closed_loop(plan, plant):
        nets.append(tick.commands["arm"].net_feedback)
        truth = plant.truth()
        velocities.append(truth.arms["arm"].velocity)
        if truth.object is not None:
            twists.append(truth.object.twist)
    plant.close()
    return np.array(velocities), np.array(twists), nets[-1]


def test_a_trial_goes_as_in_bullet() -> None:
    """Equal before the impact, to rounding; after it within what their steps differ by."""
    (velocities, twists, net), (others, other_twists, other_net) = trial("twin"), trial("bullet")
    before = round(plan_of("push", "cat_food", "case_2").scene.scenario.timing.nominal_impact / 0.001) - 30
    np.testing.assert_allclose(velocities[:before], others[:before], atol=1e-8)  # rad/s
    assert np.abs(twists[:, 1]).max() > 0.3
    np.testing.assert_allclose(twists[-1, :3], other_twists[-1, :3], atol=5e-3)  # m/s
    np.testing.assert_allclose(net, other_net, atol=3e-3)  # m/s


def test_a_load_that_blows_up_is_the_users_mistake() -> None:
    plan = plan_of("push", "cat_food", "case_2")
    described = {
        "name": "root",
        "sentence": "It grows.",
        "joint_torque": {"joint1": "c * sqrt(0.0045 - t)"},
        "parameters": {"c": {"unit": "N m", "nominal": 0.0, "lower": 0.0, "upper": 9.0, "scale": 1.0}},
    }
    effect = FormulaEffect(FormulaSpec.model_validate(described))
    plant = make_plant(plan, 0, effect.apply_vector(plan.scene.physics, np.array([1.0])), simulator="twin")
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    with pytest.raises(InputError, match=r"effect 'root' blows up at t = 0\.005 s"):
        for _ in range(9):
            plant.step({"arm": hold})


def test_an_extension_of_bullet_is_refused() -> None:
    with pytest.raises(InputError, match="'bullet' only, not in 'twin'"):
        make_plant(plan_of("push", "cat_food", "case_2"), 0, extension=PlantExtension(), simulator="twin")


def bounced(ratio: float, step: float) -> float:
    """Restitution of Bullet's plant, mean over where in a step the contact begins."""
    stiffness, reduced, speed = 2e5, RAIL_MASS * BOX_MASS / (RAIL_MASS + BOX_MASS), 0.5
    damping, found = 2.0 * ratio * np.sqrt(stiffness * reduced), []
    for gap in np.linspace(1e-3, 1e-3 + speed * step, 8, endpoint=False):
        mass = rail(np.array([0.0, SIZE[1] / 2.0 + gap, 0.0]), AGAINST_Y, pad_stiffness=stiffness, pad_damping=damping)
        mechanics = BulletMechanics.load(scene({"rail": mass}), step)
        mechanics.world.set_arm("rail", ArmState(np.zeros(1), np.full(1, speed)))
        mechanics.world.set_object(resting())
        for _ in range(round(0.03 / step)):  # the rail alone, without its motor
            mechanics.world.step()
        rebound = mechanics.object_state().twist[1] + mechanics.world.arm_state("rail").velocity[0]
        found.append(-rebound / speed)
        mechanics.close()
    return float(np.mean(found))


@pytest.mark.parametrize("ratio", [0.01, 0.02, 0.05, 0.0625, 0.2, 0.5, 0.9])
def test_bullet_bounces_as_in_the_closed_form(ratio: float) -> None:
    """From 0.97 down to 0.16, at 4 kHz, to 0.012 of the speed before."""
    assert bounced(ratio, PERIOD) == pytest.approx(restitution_of(ratio), abs=0.012)


def test_bullet_without_a_damper_keeps_what_its_substeps_leave() -> None:
    assert bounced(0.0, PERIOD) == pytest.approx(0.974, abs=2e-3)


def test_bullet_nears_the_closed_form_with_its_step() -> None:
    errors = [abs(bounced(0.9, PERIOD / n) - restitution_of(0.9)) for n in (1, 4)]
    assert errors[1] < 0.35 * errors[0]


def test_in_substeps_forces_and_torques_are_those_of_a_step() -> None:
    """A pushed rail gains F t / m, and a pad that presses feels the force, however Bullet divides its step."""
    still, force, found = np.zeros(1), 3.0, []
    for damping in (4000.0, 5.0):
        mass = rail(np.array([0.0, SIZE[1] / 2.0, 0.0]), AGAINST_Y, pad_damping=damping)
        mechanics = BulletMechanics.load(scene({"rail": mass}), PERIOD)
        mechanics.world.set_arm("rail", ArmState(still, still))
        mechanics.world.set_object(resting())
        for _ in range(4000):
            mechanics.world.apply_torque("rail", np.full(1, force))
            mechanics.world.step()
        speed, push = mechanics.world.arm_state("rail").velocity[0], mechanics.pad_force("rail")[1]
        found.append((speed, push))
        assert speed == pytest.approx(force * 4000 * PERIOD / (RAIL_MASS + BOX_MASS), rel=1e-2)
        mechanics.close()
    assert found[0][1] == pytest.approx(force * BOX_MASS / (RAIL_MASS + BOX_MASS), rel=0.05)
