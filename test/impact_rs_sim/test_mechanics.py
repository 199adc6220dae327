# SPDX-License-Identifier: Apache-2.0
"""Bullet and the twin as plants: what rests, tick by tick as in one call, a trial on either, equal numbers."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from closed_forms import restitution_of
from trials import plan_of
from twin_scene import AGAINST_Y, BOX_MASS, PERIOD, RAIL_MASS, SIZE, TOWARDS_Y, rail, resting, scene

from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Load, LoadState, Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.plant.mechanics import Mechanics, Simulator
from impact_rs_sim.plant.plant import SIMULATORS, PlantExtension
from impact_rs_sim.plant.twin_mechanics import TwinMechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.robot_model import STANDARD_GRAVITY
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, BodyState, Scene
from impact_rs_sim.twin import Result, TwinJob, rests, simulate

# ---- an object rests only where its support holds it ----------------------------------------------------------------

G = 9.81  # m/s^2
TABLE = 0.4  # m
STANDS = TABLE + SIZE[2] / 2.0  # m, the middle of the box
TICK = 4  # periods of the torque loop
EDGE = 1.0  # m, end of the table along x
BOTH = pytest.mark.parametrize("simulator", ["bullet", "twin"])


def table(**changes: object) -> Physics:
    """A box on a table, and a rail far away."""
    far = rail(np.array([0.0, 9.0, 5.0]), AGAINST_Y)
    values = {"support_height": TABLE, "gravity": np.array(STANDARD_GRAVITY)} | changes
    return scene({"rail": far}, **values)


def box(height: float = STANDS, x: float = 0.0, tilt: float = 0.0) -> BodyState:
    """At rest, with its middle at ``x`` and ``height`` [m], turned about y [rad]."""
    return BodyState(np.array([x, 0.0, height]), pin.rpy.rpyToMatrix(0.0, tilt, 0.0), np.zeros(6))


def on_its_edge(tilt: float) -> BodyState:
    """Turned about the edge on which it stands."""
    return box(TABLE + (SIZE[0] * np.sin(tilt) + SIZE[2] * np.cos(tilt)) / 2.0, tilt=tilt)


@contextmanager
def started(simulator: Simulator, physics: Physics, state: BodyState) -> Iterator[Mechanics]:
    mechanics = SIMULATORS[simulator].load(physics, PERIOD)
    still = np.zeros(1)
    mechanics.start({"rail": ArmState(still, still)}, {"rail": DriveStart(still, still)}, state)
    yield mechanics
    mechanics.close()


def heights(simulator: Simulator, physics: Physics, state: BodyState, seconds: float) -> Array:
    """Of the middle of the box above where it starts, after every tick, ``(k,)`` [m]."""
    found = []
    with started(simulator, physics, state) as mechanics:
        for tick in range(round(seconds / (TICK * PERIOD))):
            mechanics.step({"rail": np.zeros(1)}, TICK, tick * TICK * PERIOD)
            found.append(mechanics.object_state().position[2] - state.position[2])
    return np.array(found)


def stays(sinks: Array) -> bool:
    """Whether the box does not move at all; Bullet's solver goes once to within its tolerance."""
    return bool(np.ptp(sinks) == 0.0 and abs(sinks[0]) < 1e-9)


@BOTH
def test_a_box_in_the_air_falls_by_half_g_t_squared(simulator: Simulator) -> None:
    """From 200 mm above the table, which it reaches after 0.202 s; a step of first order is half a step off in t."""
    fallen = heights(simulator, table(), box(STANDS + 0.2), 0.19)
    time = np.arange(1, fallen.size + 1) * TICK * PERIOD
    assert np.all(np.abs(fallen + 0.5 * G * time**2) <= 0.51 * G * time * PERIOD)
    assert heights(simulator, table(), box(STANDS + 0.2), 0.4)[-1] == pytest.approx(-0.2, abs=0.03)


@BOTH
def test_a_box_on_its_edge_tips_over(simulator: Simulator) -> None:
    """About the edge, with (I + m r^2) dw = m g times the lever; the middle sinks by the lever times the angle."""
    tilt, seconds = np.deg2rad(20.0), 0.05
    state, corner = on_its_edge(tilt), np.array([SIZE[0], 0.0, SIZE[2]]) / 2.0
    lever = SIZE[0] / 2.0 * np.cos(tilt) - SIZE[2] / 2.0 * np.sin(tilt)
    physics = table(support_friction=2.0)
    about_edge = physics.object.inertia[1] + physics.object.mass * (corner @ corner)
    sunk = 0.5 * physics.object.mass * G * lever**2 / about_edge * seconds**2
    assert heights(simulator, physics, state, seconds)[-1] == pytest.approx(-sunk, rel=0.06)


@BOTH
@pytest.mark.parametrize("beyond", [-0.02, 0.02])
def test_a_box_falls_off_the_table_once_its_centre_of_mass_is_beyond_the_end(
    simulator: Simulator, beyond: float
) -> None:
    sinks = heights(simulator, table(), box(x=EDGE + beyond), 0.3)
    assert sinks[-1] < -0.02 if beyond > 0.0 else stays(sinks)


@BOTH
def test_a_box_falls_where_its_centre_of_mass_is_beyond_the_end_whatever_its_middle(simulator: Simulator) -> None:
    heavy_side = table()
    heavy_side = replace(heavy_side, object=replace(heavy_side.object, com_offset=np.array([0.04, 0.0, 0.0])))
    assert heights(simulator, heavy_side, box(x=EDGE - 0.02), 0.3)[-1] < -0.02
    assert stays(heights(simulator, heavy_side, box(x=EDGE - 0.06), 0.1))


@BOTH
def test_a_box_that_stands_does_not_move_at_all(simulator: Simulator) -> None:
    assert stays(heights(simulator, table(), box(), 0.1))
    compliant = table(support_compliance=1e-4)  # its weight presses the surface down to where it stands
    assert stays(heights(simulator, compliant, box(), 0.1))


def test_what_rests_follows_the_line_of_gravity() -> None:
    """A tall box on a slope whose friction holds it: it tips where gravity leaves its foot, at tan = width / height."""
    tall = table(support_friction=2.0)
    size = np.array([0.1, 0.1, 0.4])
    tall = replace(tall, object=replace(tall.object, size=size))
    state = box(TABLE + 0.2)
    for slope, holds in ((0.2, True), (0.24, True), (0.26, False), (-0.24, True), (-0.26, False)):
        leaning = replace(tall, gravity=np.array([slope * G, 0.0, -G]))
        assert rests(leaning, state) is holds


def test_nothing_rests_that_moves_slides_floats_or_has_no_support() -> None:
    assert rests(table(), box())
    assert not rests(table(), replace(box(), twist=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-9])))
    assert not rests(table(support_height=None), box())
    assert not rests(table(gravity=np.zeros(3)), box())
    assert not rests(table(gravity=np.array([0.31 * G, 0.0, -G])), box())
    assert not rests(table(), box(STANDS + 0.003))
    assert rests(table(), box(STANDS + 0.001))  # as near as a pose is measured


# ---- the twin tick by tick, and a trial on it -----------------------------------------------------------------------


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


class Pull(Load):
    """A share of the joint torque on the motor, and a force that grows with the height of the object."""

    @property
    def reads_scene(self) -> bool:
        return True

    def motor_torque(self, state: LoadState) -> Array | None:
        assert state.joint_torque is not None
        return 0.5 * state.joint_torque

    def joint_torque(self, state: LoadState) -> Array | None:
        return np.array([3.0 * state.scene["object_z"]])


class Touching(Pull):
    """A load between pad and object."""

    @property
    def touches(self) -> bool:
        return True


def test_a_load_of_a_python_class_acts_as_its_formula() -> None:
    """Kills a twin that calls it with time, q and dq alone."""
    law = {"motor_torque": {"joint1": "0.5 * tau1"}, "joint_torque": {"joint1": "c * object_z"}}
    number = {"c": {"unit": "N/m", "lower": 0.0, "upper": 9.0, "scale": 1.0}}
    formula = FormulaEffect(
        FormulaSpec.model_validate({"name": "law", "sentence": "A law.", "parameters": number, **law})
    )
    physics, speeds = table(), []
    of_class = {name: replace(arm, loads=(Pull(),)) for name, arm in physics.arms.items()}
    for own in (replace(physics, arms=of_class), formula.apply_vector(physics, np.array([3.0]))):
        with started("twin", own, box()) as mechanics:
            for tick in range(50):
                mechanics.step({"rail": np.full(1, 2.0)}, TICK, tick * TICK * PERIOD)
            speeds.append(mechanics.arm("rail").velocity)
    np.testing.assert_allclose(speeds[0], speeds[1], rtol=1e-12)
    assert abs(speeds[0][0]) > 0.01


def test_a_load_of_a_python_class_between_pad_and_object_is_refused() -> None:
    """Kills a twin that leaves it out without a word."""
    physics = table()
    physics = replace(physics, arms={name: replace(arm, loads=(Touching(),)) for name, arm in physics.arms.items()})
    with pytest.raises(InputError, match="robots.rail: the twin has no load between pad and object"):
        TwinMechanics.load(physics, PERIOD)


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


# ---- a push and a grab, refined -------------------------------------------------------------------------------------

TICKS, SUBSTEPS = 80, 4
BEFORE = 0.01  # s, from the start to the contact


@dataclass(frozen=True)
class Hit:
    """The start of a hit at the nominal impact configuration, held by the torque of gravity."""

    scene: Scene
    arms: dict[str, ArmState]
    drives: dict[str, DriveStart]
    torque: dict[str, Array]

    @staticmethod
    def of(name: str) -> Hit:
        scenario = load_scenario(name)
        scene = Scene.resolve(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
        arms, drives, torque = {}, {}, {}
        for arm, state in scene.arms.items():
            q = state.position - BEFORE * state.velocity
            load = scene.physics.robot_model(arm).gravity_torque(q)
            arms[arm] = ArmState(q, state.velocity)
            drives[arm], torque[arm] = DriveStart(load, np.zeros_like(q)), load
        return Hit(scene, arms, drives, torque)

    def by_twin(self, factor: int = 1) -> Result:
        periods = TICKS * SUBSTEPS * factor
        job = TwinJob(
            self.scene.physics,
            self.arms,
            self.drives,
            {name: torque[None] for name, torque in self.torque.items()},
            dict.fromkeys(self.arms, np.zeros(periods, dtype=np.int32)),
            np.arange(TICKS + 1) * (PERIOD * SUBSTEPS),
            PERIOD / factor,
            object=self.scene.object,
        )
        (result,) = simulate([job])
        assert not result.failed and not result.failure
        return result

    def by_plant(self, factor: int = 1) -> tuple[dict[str, Array], Array]:
        """Joint velocities and twist of the object at the end."""
        mechanics = BulletMechanics.load(self.scene.physics, PERIOD / factor)
        try:
            mechanics.start(self.arms, self.drives, self.scene.object)
            for _ in range(TICKS):
                mechanics.step(self.torque, SUBSTEPS * factor, 0.0)
            speeds = {name: link.velocity for name, link in mechanics.links.items()}
            return speeds, mechanics.world.object_state().twist
        finally:
            mechanics.close()


@pytest.mark.parametrize(("scenario", "speed", "turning"), [("push", 1e-4, 1e-3), ("grab", 3e-4, 2e-3)])
def test_a_hit_goes_on_as_in_the_plant(scenario: str, speed: float, turning: float) -> None:
    """At 64 kHz, 70 ms after the first contact."""
    hit = Hit.of(scenario)
    result, (speeds, twist) = hit.by_twin(16), hit.by_plant(16)
    assert np.linalg.norm(twist[:3]) > 0.2
    np.testing.assert_allclose(result.twists[-1, :3], twist[:3], atol=speed)
    for name, arm in result.arms.items():
        np.testing.assert_allclose(arm.velocity[-1], speeds[name], atol=turning)


def test_at_4_khz_the_twin_is_nearer_to_the_fine_plant_than_the_plant_is() -> None:
    """The plant's implicit spring damps by h k; the twin's does not."""
    hit = Hit.of("push")
    fine, coarse, twin = hit.by_plant(8)[1], hit.by_plant()[1], hit.by_twin().twists[-1]
    assert np.abs(twin - fine)[:3].max() < 0.5 * np.abs(coarse - fine)[:3].max()


# ---- equal numbers on one machine and on another --------------------------------------------------------------------

HIT = """
import numpy as np
from impact_rs_sim.drive import DriveStart
from impact_rs_sim.impact_map import ImpactProblem
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene
from impact_rs_sim.twin import TwinJob, simulate

problem = ImpactProblem.at_nominal_impact(Scene.resolve(load_scenario("push"), "cat_food", "case_2"))
state, still, ticks = problem.arms["arm"], np.zeros(7), 400
job = TwinJob(
    problem.physics, problem.arms, {"arm": DriveStart(still, still)}, {"arm": still[None]},
    {"arm": np.zeros(ticks, dtype=np.int32)}, np.arange(ticks + 1) * 0.00025, 0.00025, object=problem.object,
)
(result,) = simulate([job])
assert result.contact_steps > 100
print(np.hstack((result.arms["arm"].velocity[-1], result.twists[-1])).tobytes().hex())
"""


def hit(**environment: str) -> bytes:
    """Velocities of joints and object after 0.1 s, from a process of its own."""
    run = [sys.executable, "-c", HIT]
    done = subprocess.run(run, env=os.environ | environment, capture_output=True, text=True, check=True)
    return bytes.fromhex(done.stdout.split()[-1])


@pytest.mark.skipif(platform.machine() != "x86_64" or platform.libc_ver()[0] != "glibc", reason="glibc chooses on x86")
def test_another_processor_has_the_numbers_of_this_one_to_nine_digits() -> None:
    here = hit()
    assert hit() == here
    plain = np.frombuffer(hit(GLIBC_TUNABLES="glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-AVX2_Usable"))
    velocities = np.frombuffer(here)
    np.testing.assert_allclose(plain, velocities, rtol=0.0, atol=1e-9 * np.max(np.abs(velocities)))
