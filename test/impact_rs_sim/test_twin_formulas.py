# SPDX-License-Identifier: Apache-2.0
"""Formulas on the object, its support and its pad: closed forms in the twin, reactions, and the same in the plant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from closed_forms import restitution_of_hunt_and_crossley
from twin_scene import AGAINST_Y, BOX_MASS, PERIOD, RAIL_MASS, SIZE, rail, resting, run, scene

from impact_rs_sim import _kernel
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.effects.formula import SYMBOLS, FormulaEffect, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Neighbour, Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.twin import TwinJob, simulate

FAR = rail(np.array([0.0, 5.0, 0.0]), AGAINST_Y)
G = 9.81
DRAG = {f"{axis}": f"-c * object_speed * object_v{axis}" for axis in "xyz"}


def effect(**formulas: Any) -> FormulaEffect:
    """An effect with a single parameter c."""
    number = {"unit": "-", "lower": -1e6, "upper": 1e6, "scale": 1.0}
    return FormulaEffect(
        FormulaSpec.model_validate({"name": "law", "sentence": "A law.", "parameters": {"c": number}, **formulas})
    )


def with_law(physics: Physics, c: float, **formulas: Any) -> Physics:
    return effect(**formulas).apply_vector(physics, np.array([c]))


def test_the_twin_has_the_symbols_of_formulas_in_their_order() -> None:
    assert tuple(_kernel.SYMBOLS) == tuple(SYMBOLS)


def test_drag_with_the_square_of_the_speed_slows_a_box_as_in_the_closed_form() -> None:
    """v = v_0 / (1 + c v_0 t / m), to the step's 0.05 %."""
    speed, c, time = np.array([0.3, -0.4, 0.0]), 8.0, 0.2
    box = resting(twist=np.array([*speed, 0.0, 0.0, 0.0]))
    result = run(with_law(scene({"far": FAR}), c, object_force=DRAG), [0.0], box, time)
    np.testing.assert_allclose(result.twists[-1, :3], speed / (1.0 + c * 0.5 * time / BOX_MASS), rtol=1e-3)


def test_a_moment_spins_the_box_up() -> None:
    physics, time = scene({"far": FAR}), 0.1
    result = run(with_law(physics, 0.01, object_moment={"z": "c"}), [0.0], resting(), time)
    assert result.twists[-1, 5] == pytest.approx(0.01 * time / physics.object.inertia[2], rel=5e-3)
    np.testing.assert_allclose(result.twists[-1, :5], 0.0, atol=1e-12)


def test_a_force_acts_at_the_middle_and_turns_a_box_whose_mass_lies_elsewhere() -> None:
    physics = scene({"far": FAR})
    offset, time = np.array([0.05, 0.0, 0.0]), 0.01
    physics = replace(physics, object=replace(physics.object, com_offset=offset))
    result = run(with_law(physics, 1.0, object_force={"y": "c"}), [0.0], resting(), time)
    spin = -offset[0] * time / physics.object.inertia[2]
    assert result.twists[-1, 5] == pytest.approx(spin, rel=0.02)


def test_friction_that_grows_with_load_and_speed_decays_exponentially() -> None:
    """On a support without friction of its own, v = v_0 exp(-c g t), and the support feels the weight."""
    c, time, height = 0.5, 0.1, -SIZE[2] / 2.0
    physics = scene({"far": FAR}, support_height=height, support_friction=0.0, gravity=np.array([0.0, 0.0, -G]))
    box = resting(twist=np.array([0.3, 0.4, 0.0, 0.0, 0.0, 0.0]))
    result = run(with_law(physics, c, support_tangential="c * support_force * support_slip"), [0.0], box, time)
    np.testing.assert_allclose(result.twists[-1, :2], np.exp(-c * G * time) * box.twist[:2], rtol=2e-3)


@pytest.mark.parametrize("law", ["support_normal", "support_tangential", "object_force"])
def test_a_neighbour_out_of_reach_changes_no_law_of_the_object(law: str) -> None:
    """Kills laws of the support that act at the last contact pair, which is that with the neighbour."""
    table = scene({"far": FAR}, support_height=-SIZE[2] / 2.0, gravity=np.array([0.0, 0.0, -G]))
    beside = replace(table, neighbours=(Neighbour("beside", table.object, np.array([0.0, 0.5, 0.0]), np.eye(3)),))
    formula: Any = {"x": "-c * support_force"} if law == "object_force" else "c * support_force"
    box = resting(twist=np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    free, alone, together = (
        run(with_law(physics, c, **{law: formula}), [0.0], box, 0.05)
        for physics, c in ((table, 0.0), (table, 0.3), (beside, 0.3))
    )
    np.testing.assert_allclose(together.twists, alone.twists, atol=1e-9)
    assert abs(alone.twists[-1, 0] - free.twists[-1, 0]) > 0.01


def test_only_the_value_of_a_formula_must_be_finite() -> None:
    """c / (1 + exp(large)) is 0. Kills a twin that gives up where an intermediate value overflows."""
    box = resting(twist=np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    result = run(
        with_law(scene({"far": FAR}), 1.0, object_force={"x": "-c / (1 + exp(1e4 * object_vx))"}), [0.0], box, 0.01
    )
    assert result.twists[-1, 0] == 0.3


def test_a_formula_nested_as_deep_as_its_text_allows_acts() -> None:
    """Kills a stack of the twin that is smaller than a formula of 1000 characters."""
    nested = "c" + "**(1" * 150 + ")" * 150
    chain = "c" + "**1" * 300
    for text in (nested, chain):
        result = run(with_law(scene({"far": FAR}), 1.0, object_force={"x": text}), [0.0], resting(), 0.01)
        assert result.twists[-1, 0] == pytest.approx(0.01 / BOX_MASS)


@pytest.mark.parametrize("law", ["contact_normal", "contact_tangential"])
def test_a_law_between_pad_and_object_has_its_reaction(law: str) -> None:
    """Momentum of rail and box together along the rail stays; it moves between them."""
    mass = rail(np.array([0.0, SIZE[1] / 2.0 + 1e-3, 0.0]), AGAINST_Y, pad_damping=100.0)
    start = resting(twist=np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
    alone, pushed = (
        run(physics, [0.5], start, 0.02)
        for physics in (scene({"rail": mass}), with_law(scene({"rail": mass}), 50.0, **{law: "c"}))
    )
    for result in (alone, pushed):
        momentum = RAIL_MASS * -result.arms["rail"].velocity[-1, 0] + BOX_MASS * result.twists[-1, 1]
        assert momentum == pytest.approx(-0.5 * RAIL_MASS, rel=1e-9)
    axis, sign = (1, -1.0) if law == "contact_normal" else (0, -1.0)
    assert sign * (pushed.twists[-1, axis] - alone.twists[-1, axis]) > 0.01


def bounced(speed: float, period: float, stiffness: float, c: float, law: str) -> tuple[float, float, float]:
    """Restitution of a box hit by the rail, deepest penetration [m] and how long they touch [s]."""
    gap = 1e-3
    mass = rail(np.array([0.0, SIZE[1] / 2.0 + gap, 0.0]), AGAINST_Y, pad_damping=0.0, pad_stiffness=stiffness)
    duration = gap / speed + 0.06
    result = run(with_law(scene({"rail": mass}), c, contact_normal=law), [speed], resting(), duration, period=period)
    arm = result.arms["rail"]
    parting = result.twists[-1, 1] + arm.velocity[-1, 0]
    depth = arm.position[:, 0] - gap + result.poses[:, 1]
    return -parting / speed, float(depth.max()), period * int(np.count_nonzero(depth > 0.0))


@pytest.mark.parametrize("fall", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("speed", [0.2, 0.8])
def test_a_pad_of_hunt_and_crossley_bounces_less_the_faster_it_is_hit(speed: float, fall: float) -> None:
    """f = k d (1 + a dd/dt): the spring of the pad, without its damper, and the product as a formula."""
    stiffness = 2e4
    found, _, _ = bounced(speed, PERIOD / 4.0, stiffness, stiffness * fall, "c * penetration * closing")
    assert found == pytest.approx(restitution_of_hunt_and_crossley(fall * speed), abs=3e-3)


@pytest.mark.parametrize("speed", [0.2, 0.8])
def test_a_pad_of_hertz_is_as_deep_and_as_long_in_touch_as_in_his_closed_form(speed: float) -> None:
    """f = K d^1.5: d_max = (5 m v^2 / (4 K))^(2/5), for 2.943 d_max / v, without loss (Johnson 1985, 11.4).

    A formula has the value at the begin of a step, so that a spring made of it gains energy with the step: halve it.
    """
    stiffness, reduced = 1e6, RAIL_MASS * BOX_MASS / (RAIL_MASS + BOX_MASS)
    coarse, fine = (
        np.array(bounced(speed, PERIOD / parts, 1.0, stiffness, "c * max(penetration, 0) ** 1.5")) for parts in (8, 16)
    )
    restitution, depth, time = 2.0 * fine - coarse
    deepest = (1.25 * reduced * speed**2 / stiffness) ** 0.4
    assert 0.0 < fine[0] - 1.0 < 0.6 * (coarse[0] - 1.0)
    assert restitution == pytest.approx(1.0, abs=1e-3)
    assert depth == pytest.approx(deepest, rel=1e-3)
    assert time == pytest.approx(2.943 * deepest / speed, rel=5e-3)


def test_a_sleeping_box_is_woken_by_a_force_and_not_by_drag() -> None:
    height = -SIZE[2] / 2.0
    physics = scene({"far": FAR}, support_height=height, gravity=np.array([0.0, 0.0, -G]))
    drag = run(with_law(physics, 9.0, object_force=DRAG), [0.0], resting(), 0.05)
    assert drag.contact_steps == 0
    pulled = run(with_law(physics, 5.0, object_force={"x": "c"}), [0.0], resting(), 0.2)
    assert pulled.twists[-1, 0] == pytest.approx((5.0 / BOX_MASS - 0.3 * G) * 0.2, rel=0.02)


def test_time_since_contact_starts_at_the_contact() -> None:
    gap, speed, c = 5e-3, 0.5, 50.0
    mass = rail(np.array([0.0, SIZE[1] / 2.0 + gap, 0.0]), AGAINST_Y, pad_damping=5e3)
    physics = with_law(scene({"rail": mass}), c, object_force={"x": "c * since_contact"})
    result = run(physics, [speed], resting(), 0.06)
    since = 0.06 - gap / speed
    assert result.twists[-1, 0] == pytest.approx(0.5 * c * since**2 / BOX_MASS, rel=0.02)


def test_a_formula_that_blows_up_on_the_object_says_so() -> None:
    physics = with_law(scene({"far": FAR}), 1.0, object_force={"x": "c / object_speed"})
    still = np.zeros(1)
    job = TwinJob(
        physics,
        {"far": ArmState(still, still)},
        {"far": DriveStart(still, still)},
        {"far": still[None]},
        {"far": np.zeros(4, dtype=np.int32)},
        np.arange(5) * PERIOD,
        PERIOD,
        object=resting(),
    )
    assert simulate([job])[0].failure == "effect 'law' blows up at t = 0.000 s"


@pytest.mark.parametrize("formulas", [{"object_force": {"x": "c * q1"}}, {"support_normal": "c * speed"}])
def test_a_law_of_the_object_knows_no_arm(formulas: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="unknown symbol"):
        effect(**formulas)


# Large enough to be seen beside what the two simulators differ by.
IN_THE_PLANT: list[tuple[float, dict[str, Any]]] = [
    (20.0, {"object_force": DRAG}),
    (2.0, {"object_moment": {"z": "c"}}),
    (30.0, {"contact_normal": "c"}),
    (2e7, {"contact_normal": "c * penetration ** 2"}),
    (2e5, {"contact_normal": "c * penetration * closing"}),
    (0.5, {"support_tangential": "c * support_force * support_slip"}),
    (400.0, {"object_force": {"y": "c * since_contact"}}),
    (0.3, {"joint_torque": {"joint4": "c * normal_force"}}),
    (0.1, {"motor_torque": {"joint2": "-c * tau2"}}),
    (100.0, {"contact_normal": "c * lag(closing, 0.001)"}),
    (1e4, {"contact_normal": "c * (penetration - lag(penetration, 0.02))"}),
    (0.5, {"support_tangential": "c * lag(support_force * support_slip, 0.01)"}),
    (20.0, {"object_force": {"y": "-c * lag(object_vy, 0.01)"}}),
    (0.3, {"joint_torque": {"joint4": "c * lag(normal_force, 0.01)"}}),
]


@pytest.mark.parametrize(("c", "formulas"), IN_THE_PLANT, ids=lambda value: str(value))
def test_a_law_changes_a_push_in_the_plant_as_in_the_twin(c: float, formulas: dict[str, Any]) -> None:
    scenario = load_scenario("push")
    found = Scene.resolve(scenario, "juice", "case_1")
    changes = []
    for moved in (by_twin, by_plant):
        before, after = (moved(found, physics) for physics in (found.physics, with_law(found.physics, c, **formulas)))
        changes.append(after - before)
    size = np.linalg.norm(changes[1])
    assert size > 5e-3
    # A normal force acts while the pads touch, which begins and ends in another step.
    assert np.linalg.norm(changes[0] - changes[1]) < (0.13 if "contact_normal" in formulas else 0.06) * size


def test_a_second_trial_of_the_plant_begins_without_memory() -> None:
    found = Scene.resolve(load_scenario("push"), "juice", "case_1")
    physics = with_law(found.physics, 5.0, joint_torque={"joint4": "-c * lag(dq4, 1)"})
    arms, drives, torque = starts(found)
    plant, ends = BulletMechanics.load(physics, PERIOD), []
    for time in (0.0, 7.0):
        plant.start(arms, drives, found.object)
        for tick in range(5):
            plant.step(torque, SUBSTEPS, time + tick * PERIOD * SUBSTEPS)
        ends.append(plant.arm("arm").velocity)
    plant.close()
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


TICKS, SUBSTEPS, BEFORE = 30, 4, 0.01  # until 20 ms after contact: a box that bounces meets the pad again later


def starts(found: Scene) -> tuple[dict[str, ArmState], dict[str, DriveStart], dict[str, Array]]:
    arms, drives, torque = {}, {}, {}
    for arm, state in found.arms.items():
        q = state.position - BEFORE * state.velocity
        load = found.physics.robot_model(arm).gravity_torque(q)
        arms[arm], drives[arm] = ArmState(q, state.velocity), DriveStart(load, np.zeros_like(q))
        torque[arm] = load
    return arms, drives, torque


def by_twin(found: Scene, physics: Physics) -> Array:
    arms, drives, torque = starts(found)
    job = TwinJob(
        physics,
        arms,
        drives,
        {name: own[None] for name, own in torque.items()},
        dict.fromkeys(arms, np.zeros(TICKS * SUBSTEPS, dtype=np.int32)),
        np.arange(TICKS + 1) * (PERIOD * SUBSTEPS),
        PERIOD,
        object=found.object,
    )
    (result,) = simulate([job])
    assert not result.failed and not result.failure
    return np.concatenate((result.arms["arm"].velocity[-1], result.twists[-1]))


def by_plant(found: Scene, physics: Physics) -> Array:
    arms, drives, torque = starts(found)
    plant = BulletMechanics.load(physics, PERIOD)
    plant.start(arms, drives, found.object)
    for tick in range(TICKS):
        plant.step(torque, SUBSTEPS, tick * PERIOD * SUBSTEPS)
    state: BodyState = plant.object_state()
    velocity = plant.arm("arm").velocity
    plant.close()
    return np.concatenate((velocity, state.twist))
