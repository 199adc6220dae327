# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo cell obeys the same parameters as our plant, though nothing else is shared."""

from __future__ import annotations

import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

cell_module = pytest.importorskip("mujoco_cell")

from impact_rs_analysis.evidence.replays.simulated_trials import quiet  # noqa: E402
from impact_rs_control.closed_loop import make_plant, run_closed_loop  # noqa: E402
from impact_rs_control.plan import plan_trial  # noqa: E402
from impact_rs_sim.effects import library  # noqa: E402
from impact_rs_sim.scenarios.scenario_files import load_scenario  # noqa: E402
from impact_rs_sim.scene import Scene  # noqa: E402

STEP = cell_module.STEP


def planned(scenario: str, object_name: str, case: str):
    """A trial with ideal sensors and no scatter."""
    plan = plan_trial(Scene.resolve(load_scenario(scenario), object_name, case))
    return replace(plan, scene=replace(plan.scene, scenario=quiet(plan.scene.scenario)))


@pytest.fixture(scope="module")
def plan():
    return planned("push", "cat_food", "case_2")


def make_cell(plan, physics=None, modify=None):
    scene = plan.scene
    initial = {name: arm.initial for name, arm in plan.arms.items()}
    return cell_module.MujocoCell(scene.scenario, physics or scene.physics, initial, scene.object, 0, modify)


def with_arm(physics, **changes):
    return replace(physics, arms={name: replace(arm, **changes) for name, arm in physics.arms.items()})


def test_mass_matrix_and_gravity_torque_are_those_of_pinocchio(plan) -> None:
    tilted = library()["base_tilt"].apply_vector(plan.scene.physics, np.array([0.05, -0.08]))
    physics = library()["end_effector_payload"].apply_vector(tilted, np.array([0.7, 0.03, -0.02, 0.01]))
    model = physics.robot_model("arm")
    described = cell_module.compile_scene(physics, STEP)
    data, matrix = mujoco.MjData(described), np.zeros((described.nv, described.nv))
    joints = [described.joint(f"arm/joint{index + 1}") for index in range(model.joint_count)]
    dofs = [joint.dofadr[0] for joint in joints]
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = rng.uniform(model.position_min, model.position_max)
        data.qpos[[joint.qposadr[0] for joint in joints]] = q
        mujoco.mj_forward(described, data)
        mujoco.mj_fullM(described, data, matrix)
        expected = model.mass_matrix(q)
        np.testing.assert_allclose(matrix[np.ix_(dofs, dofs)], expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(data.qfrc_bias[dofs], model.gravity_torque(q), atol=1e-9)


def test_apparent_motor_inertia_is_the_reduced_one_though_the_rotors_have_theirs(plan) -> None:
    """tau_d - M ddq - h = B ddq in free motion: the torque law at work, on bodies that turn with B_rho."""
    cell, model = make_cell(plan), plan.scene.models["arm"]
    physics, period = plan.scene.physics.arms["arm"], plan.scene.scenario.timing.control_period
    count = model.joint_count
    rng = np.random.default_rng(3)
    frequency, phase = rng.uniform(1.0, 3.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    amplitude = np.linspace(3.0, 0.5, count)
    start = cell.measure().arms["arm"].position
    rows = []
    for tick in range(500):
        measured = cell.measure().arms["arm"]
        torque = model.inverse_dynamics(measured.position, measured.velocity, np.zeros(count))
        torque += amplitude * (
            np.sin(2.0 * np.pi * frequency * tick * period + phase) - 10.0 * (measured.position - start)
        )
        rows.append((measured.position, measured.velocity, torque))
        cell.step({"arm": torque})
    q, dq, torque = (np.array(column) for column in zip(*rows, strict=True))
    ddq = (dq[2:] - dq[:-2]) / (2.0 * period)
    rigid = np.array([model.inverse_dynamics(*state) for state in zip(q[1:-1], dq[1:-1], ddq, strict=True)])
    left = ((torque[1:-1] + torque[:-2]) / 2.0 - rigid)[60:-60]  # held torque: mean of two ticks, as the difference
    apparent = np.sum(left * ddq[60:-60], axis=0) / np.sum(np.square(ddq[60:-60]), axis=0)
    np.testing.assert_allclose(apparent, physics.motor_inertia_reduced, rtol=0.03)
    np.testing.assert_allclose(
        [cell.model.body(f"arm/rotor{i + 1}").inertia[2] for i in range(count)], physics.motor_inertia_rotor
    )


def test_the_springs_carry_stiffness_times_deflection_which_is_the_link_torque(plan) -> None:
    cell = make_cell(plan)
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    for _ in range(100):
        cell.step({"arm": hold})
    measured = cell.measure().arms["arm"]
    stiffness = plan.scene.physics.arms["arm"].stiffness
    np.testing.assert_allclose(measured.torque, stiffness * (measured.motor_position - measured.position))
    np.testing.assert_allclose(measured.torque, hold, atol=1e-3)
    np.testing.assert_allclose(measured.position, plan.arms["arm"].initial, atol=1e-8)


class PressedPad:
    """Object in front of a pad that cannot move, without gravity and support: what the pad does to it."""

    def __init__(self, plan, spread: float = cell_module.CORNERS) -> None:
        physics = replace(plan.scene.physics, support_height=None, gravity=np.zeros(3))
        self.pad = physics.arms["arm"]
        self.box = physics.object
        self.model = cell_module.compile_scene(physics, STEP, cell_module.ContactSettings(pad_spread=spread))
        self.data = mujoco.MjData(self.model)
        impact = plan.scene.arms["arm"].position
        for kind, index in itertools.product(("joint", "motor"), range(impact.size)):
            joint = self.model.joint(f"arm/{kind}{index + 1}")
            self.data.qpos[joint.qposadr[0]] = impact[index]
            self.model.dof_armature[joint.dofadr[0]] = 1e9  # kg m^2
        state = plan.scene.object
        self.object = self.model.joint("object")
        self._pose = slice(self.object.qposadr[0], self.object.qposadr[0] + 7)
        self.dofs = slice(self.object.dofadr[0], self.object.dofadr[0] + 6)
        self.data.qpos[self._pose] = [*state.position, 1.0, 0.0, 0.0, 0.0]
        self.front = state.position.copy()

    def step(self, force=(0.0,) * 6) -> None:
        """One step with a wrench on the object."""
        self.data.qfrc_applied[self.dofs] = force
        mujoco.mj_step(self.model, self.data)

    @property
    def depth(self) -> float:
        """How far the object's middle has come towards the pad (+y) [m]."""
        return float(self.data.qpos[self._pose][1] - self.front[1])


@pytest.fixture
def pressed(plan) -> PressedPad:
    return PressedPad(plan)


@pytest.mark.parametrize(("spread", "shape"), [(cell_module.LAYER, 1.0 / 12.0), (cell_module.CORNERS, 1.0 / 4.0)])
def test_a_pressed_pad_gives_way_by_force_over_stiffness_and_tilts_as_it_says(plan, spread, shape) -> None:
    """Against tilting a layer of stiffness K and width w has K w^2 / 12, four springs in its corners K w^2 / 4."""
    pressed = PressedPad(plan, spread)
    force, moment = 20.0, 0.05  # N, N m
    for _ in range(3000):
        pressed.step((0.0, force, 0.0, 0.0, 0.0, moment))
    assert pressed.depth == pytest.approx(force / pressed.pad.pad_stiffness, rel=0.01)
    width = pressed.pad.end_effector.pad_size[0]
    tilt = 2.0 * pressed.data.qpos[pressed.object.qposadr[0] + 6]
    assert tilt == pytest.approx(moment / (pressed.pad.pad_stiffness * width**2 * shape), rel=0.02)


def test_an_object_thrown_at_the_pad_moves_as_spring_and_damper_say_until_they_would_pull(pressed) -> None:
    """m ddy = -K y - B dy with f >= 0, mass of the object (and the little that MuJoCo adds)."""
    stiffness, damping, mass = pressed.pad.pad_stiffness, pressed.pad.pad_damping, pressed.box.mass
    speed, steps = 0.5, 120
    pressed.data.qvel[pressed.dofs][:] = [0.0, speed, 0.0, 0.0, 0.0, 0.0]
    depths = []
    for _ in range(steps):
        pressed.step()
        depths.append(pressed.depth)

    def motion(_: float, state: np.ndarray) -> list[float]:
        depth, velocity = state
        return [velocity, -max(stiffness * depth + damping * velocity, 0.0) / mass]

    times = STEP * np.arange(1, steps + 1)
    exact = solve_ivp(motion, (0.0, times[-1]), [0.0, speed], t_eval=times, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(depths, exact.y[0], atol=0.04 * exact.y[0].max())
    assert pressed.data.qvel[pressed.dofs][1] == pytest.approx(exact.y[1, -1], rel=0.05)


def test_sliding_friction_of_the_pad_is_mu_times_the_normal_force(pressed, plan) -> None:
    normal, mu, arm = 50.0, plan.scene.physics.pad_friction, pressed.box.size[1] / 2.0
    for pull in (0.8 * mu * normal, 1.2 * mu * normal):
        for _ in range(800):
            pressed.step((pull, normal, 0.0, 0.0, 0.0, -arm * pull))  # as if it pulled in the face
        velocity = pressed.data.qvel[pressed.dofs][0]
        if pull < mu * normal:
            assert abs(velocity) < 1e-4  # it sticks
            assert abs(pressed.data.qpos[pressed.object.qposadr[0]] - pressed.front[0]) < 1e-4
    pushed = (1.2 - 1.0) * mu * normal / pressed.box.mass * 800 * STEP
    assert velocity == pytest.approx(pushed, rel=0.05)


def test_a_delayed_command_arrives_when_its_delay_is_over(plan) -> None:
    delay, given = 2.5e-3, 5
    cell = make_cell(plan, with_arm(plan.scene.physics, actuation_delay=delay))
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    speeds = []
    for tick in range(12):
        speeds.append(np.abs(cell.measure().arms["arm"].motor_velocity).max())
        cell.step({"arm": hold + 5.0 * (tick >= given)})
    assert max(speeds[: given + 3]) < 1e-9  # ticks at 1 kHz: nothing has moved up to 2 ms after the command
    assert speeds[given + 3] > 1e-3


@pytest.mark.parametrize(
    "names",
    [
        (),
        ("joint_load_dependent_friction",),
        ("joint_asymmetric_friction",),
        ("joint_difference_friction",),
        ("joint_coulomb_friction", "joint_reversal_width"),
    ],
)
def test_free_motion_agrees_with_our_plant(names: tuple[str, ...]) -> None:
    """With friction as well, which the cell writes out for itself: kills a wrong sign or motor in either."""
    plan = planned("excite", "none", "fast")
    physics = plan.scene.physics
    for name in names:
        effect = library()[name]
        values = [scalar.nominal + 3.0 * scalar.scale for scalar in effect.scalars(physics.joints)]
        physics = effect.apply_vector(physics, np.array(values))
    cells = {"ours": make_plant(plan, 0, physics), "mujoco": make_cell(plan, physics)}
    seen = {}
    for name, cell in cells.items():
        ticks = []
        for tick in run_closed_loop(plan, cell):
            ticks.append(tick.measurement.arms["arm"])
            if tick.number == 900:
                break
        cell.close()
        seen[name] = {key: np.array([getattr(t, key) for t in ticks]) for key in ("position", "velocity", "torque")}
    for key, tolerance in (("position", 1e-4), ("velocity", 1e-3), ("torque", 0.02)):
        gap = np.sqrt(np.mean(np.square(seen["ours"][key] - seen["mujoco"][key])))
        assert gap < tolerance, (key, gap)


def test_a_push_with_nothing_hidden_ends_as_on_our_plant(plan) -> None:
    """After contact is whole again, pad and object move as ours do: within 1 % of the ante-impact speed."""
    last, seen = {}, {}
    for name, cell in (("ours", make_plant(plan, 0)), ("mujoco", make_cell(plan))):
        for tick in run_closed_loop(plan, cell):
            last[tick.number] = tick.measurement
            if tick.number == 1300:
                break
        measured = last[1300].arms["arm"]
        velocity = plan.scene.models["arm"].jacobian(measured.position)[:3] @ measured.velocity
        drift = (last[1300].object.position - last[1200].object.position) / 0.1
        seen[name] = np.concatenate((velocity, drift))
        cell.close()
    np.testing.assert_allclose(seen["mujoco"], seen["ours"], atol=0.007)
    assert seen["ours"][1] < -0.3  # they move at all


# Others only recordings measure; sensors of the cell are exact.
OF_TRIALS = {name for name, effect in library().items() if not effect.calibrates and not effect.of_measurement}


@pytest.mark.parametrize("name", sorted(OF_TRIALS - set(cell_module.UNKNOWN_HERE)))
def test_every_effect_of_the_library_that_it_knows_can_be_hidden(plan, name: str) -> None:
    """It compiles, runs, and where the effect can be felt in free motion something moves otherwise."""
    effect = library()[name]
    joint_count = plan.scene.models["arm"].joint_count
    values = [s.nominal + 3.0 * s.scale * (1.0 if s.upper > s.nominal else -1.0) for s in effect.scalars(joint_count)]
    hold = plan.scene.models["arm"].gravity_torque(plan.arms["arm"].initial)
    ends = []
    for physics in (plan.scene.physics, effect.apply_vector(plan.scene.physics, np.array(values))):
        cell = make_cell(plan, physics)
        for tick in range(60):
            cell.step({"arm": hold + np.where(tick < 30, 3.0, -3.0)})
        ends.append(cell.measure().arms["arm"])
    assert np.isfinite(ends[1].velocity).all()
    felt = np.abs(ends[1].velocity - ends[0].velocity).max() > 1e-6
    assert felt == ("free" in effect.phases)
