# SPDX-License-Identifier: Apache-2.0
"""What the controller commands, mode by mode; the quadratic program below it; the compiled tick is that of NumPy."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trials import plan_of

from impact_rs_analysis.measure.net_feedback import zero_order_hold_integral
from impact_rs_control.closed_loop import make_plant, run_closed_loop
from impact_rs_control.controller import IDLE_TASK_WEIGHT, ArmCommand, Controller, Mode
from impact_rs_control.detection import BASELINE_TIME_S
from impact_rs_control.fallback import holding_torque
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_control.qp import AccelerationProblem, AccelerationQp, JointLimits, QpSolution, QpStatus
from impact_rs_control.references import SampledPath
from impact_rs_sim import _kernel
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Limits
from impact_rs_sim.robots.robot_model import RigidTerms
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import Scene

# ---- controller -----------------------------------------------------------------------------------------------------

ARM = "arm"
PUSH = load_scenario("push")
TIMING = PUSH.timing
PERIOD = TIMING.control_period
NOMINAL = round(TIMING.nominal_impact / PERIOD)  # tick of T_nom
INTERIM = round(PUSH.control.interim_duration / PERIOD)  # ticks
STILL = np.zeros(len(PUSH.robots[ARM].impact.joint_guess))  # rad/s
POSITION_LIMITS = ("position_min_rad", "position_max_rad")
STAGES = {"ante": (Mode.ANTE, 1.0), "hit": (Mode.INTERIM, 0.0), "half": (Mode.INTERIM, 0.5), "post": (Mode.POST, 1.0)}


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    """A push whose gains, references and feedforward differ from mode to mode, so that no two can be mistaken."""
    gains = PUSH.control.gains.model_copy(
        update={"position": 210.0, "orientation": 400.0, "orientation_post": 90.0, "posture": 300.0}
    )
    scenario = PUSH.model_copy(update={"control": PUSH.control.model_copy(update={"gains": gains})})
    planned = plan_trial(Scene.resolve(scenario, "cat_food", "case_2"))
    rng = np.random.default_rng(2)
    arm = planned.arms[ARM]
    count = arm.wrench.shape[0]

    def path(of: SampledPath) -> SampledPath:
        return SampledPath(
            *(
                values + 0.01 * rng.standard_normal(values.shape[1])
                for values in (of.position, of.velocity, of.acceleration)
            )
        )

    def constant(*values: float) -> np.ndarray:
        return np.broadcast_to(np.array(values), (count, len(values)))

    changed = replace(
        arm,
        ante_position=path(arm.ante_position),
        post_position=path(arm.post_position),
        ante_posture=path(arm.ante_posture),
        post_posture=path(arm.post_posture),
        rotation=SampledPath(constant(0.0), constant(0.07), constant(0.3)),
        wrench=constant(3.0, -20.0, 4.0, 0.3, -0.2, 0.1),
        ante_friction=constant(0.3, -0.2, 0.5, 1.0, -2.0, 0.7, 0.4),
        post_friction=constant(-0.6, 0.1, 0.2, -0.5, 0.9, 1.1, -0.8),
    )
    return replace(planned, arms={ARM: changed})


def measured(plan: TrialPlan, seed: int = 0) -> ArmMeasurement:
    """A state off every reference: some mm, mrad and cm/s away from the nominal impact."""
    rng = np.random.default_rng(seed)
    state = plan.scene.arms[ARM]
    q = state.position + 0.004 * rng.standard_normal(state.position.size)
    dq = state.velocity + 0.05 * rng.standard_normal(state.position.size)
    return measurement(q, dq, plan.scene.models[ARM].gravity_torque(q))


def measurement(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> ArmMeasurement:
    return ArmMeasurement(q, dq, torque, q, dq)


def command_in(plan: TrialPlan, stage: str, state: ArmMeasurement, tick: int = NOMINAL + 20) -> ArmCommand:
    """The command of one tick, with the impact as long ago as the stage says."""
    controller = Controller(plan)
    if stage != "ante":
        controller.arms[ARM].begin_interim(tick - {"hit": 0, "half": INTERIM // 2, "post": INTERIM}[stage])
    return controller.update(tick, {ARM: state})[ARM]


def joint_acceleration(plan: TrialPlan, command: ArmCommand, state: ArmMeasurement) -> np.ndarray:
    """ddq that the desired torque asks for (paper eq. eom_ante)."""
    terms = plan.scene.models[ARM].terms(state.position, state.velocity)
    inertia = terms.mass_matrix + np.diag(plan.scene.physics.arms[ARM].motor_inertia_reduced)
    return np.linalg.solve(inertia, command.torque - terms.bias)


def task_acceleration(plan: TrialPlan, command: ArmCommand, state: ArmMeasurement) -> np.ndarray:
    """Accelerations of position and orientation of E and of joint 1, ``(7,)``."""
    ddq = joint_acceleration(plan, command, state)
    terms = plan.scene.models[ARM].terms(state.position, state.velocity)
    return np.append(terms.jacobian @ ddq + terms.drift, ddq[0])


def pushed(plan: TrialPlan, state: ArmMeasurement, tick: int) -> np.ndarray:
    """Lambda^-1 f_d (paper eq. a_p_f) and what the same torque does to joint 1, ``(7,)``."""
    model = plan.scene.models[ARM]
    jacobian = model.jacobian(state.position)
    inertia = model.mass_matrix(state.position) + np.diag(plan.scene.physics.arms[ARM].motor_inertia_reduced)
    joints = np.linalg.solve(inertia, jacobian.T @ plan.arms[ARM].wrench[tick])
    return np.append(jacobian @ joints, joints[0])


@pytest.mark.parametrize("stage", STAGES)
def test_every_task_error_of_its_mode_is_zero(plan: TrialPlan, stage: str) -> None:
    """Paper eqs. e_pos_ante, e_pos_int, e_pos_post, e_theta_ante and the posture task; the damping is critical.

    d(feedback) / d(velocity error) = gamma 2 sqrt(k): 0 at the impact, half way after half of the interim.
    """
    mode, gamma = STAGES[stage]
    arm, gains, tick = plan.arms[ARM], plan.scene.scenario.control.gains, NOMINAL + 20
    for seed in range(3):
        state = measured(plan, seed)
        command = command_in(plan, stage, state, tick)
        assert (command.mode, command.gamma) == (mode, pytest.approx(gamma))
        after = mode is not Mode.ANTE
        path, posture = (arm.post_position, arm.post_posture) if after else (arm.ante_position, arm.ante_posture)
        k_p, k_q = gains.position, gains.posture
        k_theta = gains.orientation_post if after else gains.orientation
        model = plan.scene.models[ARM]
        place, twist = model.placement(state.position), model.jacobian(state.position) @ state.velocity
        tilt = place.rotation @ pin.log3(place.rotation.T @ arm.orientation[tick])
        feedback = np.concatenate(
            (
                gamma * 2.0 * np.sqrt(k_p) * (path.velocity[tick] - twist[:3])
                + k_p * (path.position[tick] - place.translation),
                gamma * 2.0 * np.sqrt(k_theta) * (0.07 * arm.pad_normal - twist[3:]) + k_theta * tilt,
                gamma * 2.0 * np.sqrt(k_q) * (posture.velocity[tick] - state.velocity[:1])
                + k_q * (posture.position[tick] - state.position[:1]),
            )
        )
        reference = np.concatenate((path.acceleration[tick], 0.3 * arm.pad_normal, posture.acceleration[tick]))
        expected = reference + feedback + (arm.post_friction if after else arm.ante_friction)[tick]
        if after:
            expected = expected + pushed(plan, state, tick)
        np.testing.assert_allclose(task_acceleration(plan, command, state), expected, atol=1e-4)
        np.testing.assert_allclose(command.task_feedback, feedback, atol=1e-9)
        np.testing.assert_allclose(command.feedback, feedback[:3], atol=1e-9)
        np.testing.assert_allclose(np.append(command.position, command.twist), np.append(place.translation, twist))
        assert command.qp_status is QpStatus.SOLVED


def test_a_redundant_joint_is_braked_without_moving_the_pad() -> None:
    """Seven joints without a posture task: along the null vector of J, ddq = -2 sqrt(k_q) dq; across it, the tasks."""
    case = PUSH.cases["case_1"]
    robot = case.robots[ARM].model_copy(update={"joint_1": None})
    free = PUSH.model_copy(update={"cases": {"case_1": case.model_copy(update={"robots": {ARM: robot}})}})
    plan = plan_trial(Scene.resolve(free, "cat_food", "case_1"))
    assert plan.arms[ARM].posture == ()
    state = plan.scene.arms[ARM]
    idle = np.linalg.svd(plan.scene.models[ARM].jacobian(state.position))[2][-1]
    slow, fast = (measurement(state.position, state.velocity + speed * idle, np.zeros(7)) for speed in (0.0, 0.2))
    rate = 2.0 * np.sqrt(PUSH.control.gains.posture)
    found = [joint_acceleration(plan, command_in(plan, "ante", one, NOMINAL), one) for one in (slow, fast)]
    assert idle @ (found[1] - found[0]) == pytest.approx(-rate * 0.2, rel=0.05)
    jacobian, drift = (
        plan.scene.models[ARM].jacobian(state.position),
        [plan.scene.models[ARM].terms(one.position, one.velocity).drift.copy() for one in (slow, fast)],
    )
    np.testing.assert_allclose(jacobian @ found[0] + drift[0], jacobian @ found[1] + drift[1], atol=0.05)


def test_a_tilted_pad_is_turned_back(plan: TrialPlan) -> None:
    """The sign of the orientation task, from the outside: alpha brings R towards R_d."""
    model, desired = plan.scene.models[ARM], plan.arms[ARM].orientation[0]
    state = measured(plan)
    state = replace(state, velocity=STILL)
    still = replace(plan.arms[ARM], rotation=SampledPath(*[np.zeros_like(plan.arms[ARM].rotation.position)] * 3))
    command = command_in(replace(plan, arms={ARM: still}), "ante", state)
    rotation = model.placement(state.position).rotation
    angle = np.linalg.norm(pin.log3(rotation.T @ desired))
    turned = pin.exp3(1e-3 * command.task_feedback[3:6] / np.linalg.norm(command.task_feedback[3:6])) @ rotation
    assert np.linalg.norm(pin.log3(turned.T @ desired)) == pytest.approx(angle - 1e-3, abs=1e-9)


def test_gamma_grows_with_time_until_the_interim_mode_ends(plan: TrialPlan) -> None:
    """gamma = (t - T_imp) / Delta t_int."""
    controller, state, start = Controller(plan), measured(plan), NOMINAL
    controller.arms[ARM].begin_interim(start)
    commands = [controller.update(start + tick, {ARM: state})[ARM] for tick in range(INTERIM + 5)]
    assert [command.gamma for command in commands[:INTERIM]] == pytest.approx(np.arange(INTERIM) / INTERIM)
    assert {command.mode for command in commands[:INTERIM]} == {Mode.INTERIM}
    assert [(command.mode, command.gamma) for command in commands[INTERIM:]] == [(Mode.POST, 1.0)] * 5


def test_net_feedback_is_the_sum_of_the_feedback_over_the_window(plan: TrialPlan) -> None:
    """Paper eq. a_fb_net: from T_nom - 0.1 s to T_nom + 0.6 s, the held feedback times the period."""
    controller, state = Controller(plan), measured(plan)
    commands = [controller.update(tick, {ARM: state})[ARM] for tick in range(TIMING.ticks + 1)]
    feedback = np.array([command.feedback for command in commands])
    time = np.arange(TIMING.ticks + 1) * PERIOD
    inside = (time > 0.8 - 0.5 * PERIOD) & (time < 1.5 - 0.5 * PERIOD)
    assert inside.sum() == 700
    np.testing.assert_allclose(commands[-1].net_feedback, PERIOD * feedback[inside].sum(axis=0), atol=1e-12)
    assert not np.any(commands[799].net_feedback)
    np.testing.assert_array_equal(commands[1500].net_feedback, commands[-1].net_feedback)


@pytest.mark.parametrize(
    ("nominal", "ticks"), [(0.9, [800, 1500]), (0.81, [710, 1410]), (0.99, [890, 1590]), (0.9005, [801, 1501])]
)
def test_the_window_begins_and_ends_at_the_first_ticks_from_its_times_on(
    plan: TrialPlan, nominal: float, ticks: list[int]
) -> None:
    """Kills: times are compared to the last bit, so that 0.81 s - 0.1 s = 0.7100000000000001 s is one tick later."""
    timing = TIMING.model_copy(update={"nominal_impact": nominal})
    scenario = plan.scene.scenario.model_copy(update={"timing": timing})
    moved = replace(plan, scene=replace(plan.scene, scenario=scenario))
    assert list(Controller(moved).arms[ARM]._window) == ticks


@pytest.mark.parametrize("every", [2, 7])
def test_feedback_is_held_over_ticks_that_are_missed(plan: TrialPlan, every: int) -> None:
    """Kills one period per call, which recorded a net feedback too small by the share of missed ticks."""
    controller, state = Controller(plan), measured(plan)
    ticks = range(3, TIMING.ticks + 1, every)
    commands = [controller.update(tick, {ARM: state})[ARM] for tick in ticks]
    feedback = np.array([command.feedback for command in commands])
    _, expected = zero_order_hold_integral(PERIOD * np.array(ticks), feedback[:, 1], 0.8, 1.5)
    assert commands[-1].net_feedback[1] == pytest.approx(expected, rel=1e-9)


def limited(plan: TrialPlan, **changes: np.ndarray) -> TrialPlan:
    """The plan with other joint limits."""
    arm = plan.scene.physics.arms[ARM]
    limits = Limits(**{**arm.facts.limits.model_dump(), **{name: tuple(values) for name, values in changes.items()}})
    facts = arm.facts.model_copy(update={"limits": limits})
    physics = replace(plan.scene.physics, arms={ARM: replace(arm, facts=facts)})
    return replace(plan, scene=replace(plan.scene, physics=physics))


def demanding(plan: TrialPlan, joint_1: float) -> TrialPlan:
    """The plan with a step of joint 1's reference, ``joint_1`` [rad] away."""
    arm = plan.arms[ARM]
    away = replace(arm.ante_posture, position=arm.ante_posture.position + joint_1)
    return replace(plan, arms={ARM: replace(arm, ante_posture=away)})


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_no_joint_is_sent_beyond_its_position_limit_on_either_side(plan: TrialPlan, side: float) -> None:
    """Paper eq. const_q: where joint 1 is after one period at the commanded acceleration."""
    state = replace(measured(plan), velocity=STILL)
    room = 2e-6  # rad, a few times what 10 rad/s^2 do in one period
    low, high = (np.array(getattr(plan.scene.physics.arms[ARM].facts.limits, name)) for name in POSITION_LIMITS)
    (high if side > 0.0 else low)[0] = state.position[0] + side * room
    bounded = limited(demanding(plan, side * 0.5), position_min_rad=low, position_max_rad=high)
    reach = []
    for each in (demanding(plan, side * 0.5), bounded):
        ddq = joint_acceleration(plan, command_in(each, "ante", state), state)
        reach.append(side * 0.5 * PERIOD**2 * ddq[0])
    assert reach[0] > 5.0 * room
    assert reach[1] == pytest.approx(room, rel=1e-3)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_no_joint_is_sent_beyond_its_velocity_limit_in_either_direction(plan: TrialPlan, side: float) -> None:
    """Paper eq. const_dq."""
    state = measured(plan)
    velocity = np.zeros_like(state.velocity)
    velocity[0] = side * 0.3
    state = replace(state, velocity=velocity)
    bound = np.array(plan.scene.physics.arms[ARM].facts.limits.velocity_rad_s)
    bound[0] = 0.31
    ddq = joint_acceleration(
        plan, command_in(limited(demanding(plan, side * 0.5), velocity_rad_s=bound), "ante", state), state
    )
    assert side * velocity[0] + side * PERIOD * ddq[0] == pytest.approx(0.31, rel=1e-6)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("joint", [0, 1, 3])
def test_no_joint_gets_more_than_its_torque_limit_in_either_direction(plan: TrialPlan, joint: int, side: float) -> None:
    """Paper eq. const_tau, of the whole torque: what gravity takes is no longer there to accelerate with."""
    state = replace(measured(plan), velocity=STILL)
    bound = np.array(plan.scene.physics.arms[ARM].facts.limits.torque_Nm)
    for demand in (-2.0, 2.0, -8.0, 8.0):
        free = command_in(demanding(plan, demand), "ante", state).torque[joint]
        if side * free > 0.0:
            break
    bound[joint] = 0.7 * abs(free)
    torque = command_in(limited(demanding(plan, demand), torque_Nm=bound), "ante", state).torque
    assert side * free > 0.0
    assert torque[joint] == pytest.approx(side * bound[joint], rel=1e-6)
    assert np.all(np.abs(torque) <= bound + 1e-6)


def test_a_torque_within_its_limits_leaves_where_limits_contradict(plan: TrialPlan) -> None:
    """Beyond the stops at speed no acceleration obeys all limits, and the relaxed one asks for more torque."""
    limits = plan.scene.physics.arms[ARM].facts.limits
    state = replace(measured(plan), velocity=np.full(STILL.size, 1.5))
    low, bound = np.array(limits.position_min_rad), 0.3 * np.array(limits.torque_Nm)
    beyond = limited(plan, position_min_rad=low, position_max_rad=state.position - 1e-3, torque_Nm=bound)
    command = command_in(beyond, "ante", state)
    assert command.qp_status is QpStatus.RELAXED
    assert np.all(np.abs(command.torque) <= bound)
    assert {-1.0, 1.0} <= set(command.torque / bound)


def test_where_the_qp_fails_the_arm_is_braked(plan: TrialPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    """By gravity and damping; neither the failed acceleration nor the last torque is on the arm."""
    controller, state = Controller(plan).arms[ARM], replace(measured(plan), velocity=np.full(STILL.size, 0.3))
    led = controller.command(0, state, controller.watch(0, state))
    failed = QpSolution(np.zeros(STILL.size), QpStatus.FAILED, 0, 0.0)
    monkeypatch.setattr(controller._qp, "solve", lambda problem: failed)
    command = controller.command(1, state, controller.watch(1, state))
    model, motors = plan.scene.models[ARM], plan.scene.physics.arms[ARM].motor_inertia_reduced
    braked = holding_torque(model, motors, state.position, state.velocity)
    assert command.qp_status is QpStatus.FAILED
    np.testing.assert_allclose(command.torque, braked)
    assert state.velocity @ (braked - model.gravity_torque(state.position)) < 0.0
    assert np.abs(command.torque - led.torque).max() > 1.0  # N m


@pytest.mark.parametrize("signal", ["position", "velocity"])
def test_a_reading_that_is_no_number_leaves_the_weight_at_the_last_one(plan: TrialPlan, signal: str) -> None:
    controller, state = Controller(plan).arms[ARM], measured(plan)
    controller.command(0, state, controller.watch(0, state))
    broken = replace(state, **{signal: np.full(STILL.size, np.nan)})
    command = controller.command(1, broken, controller.watch(1, broken))
    assert command.qp_status is QpStatus.FAILED
    np.testing.assert_allclose(command.torque, plan.scene.models[ARM].gravity_torque(state.position))


def test_where_limits_bind_the_heavier_task_gives_way_less(plan: TrialPlan) -> None:
    """The weights of paper eq. QP_ante: a torque limit spoils the tasks in inverse order of their weights."""
    state = replace(measured(plan), velocity=STILL)
    bound = np.array(plan.scene.physics.arms[ARM].facts.limits.torque_Nm)
    bound[0] = 0.3 * abs(command_in(demanding(plan, 0.5), "ante", state).torque[0])
    wanted = task_acceleration(plan, command_in(demanding(plan, 0.5), "ante", state), state)
    missed = {}
    for heavy in ("position_weight", "orientation_weight", "posture_weight"):
        each = limited(demanding(plan, 0.5), torque_Nm=bound)
        control = each.scene.scenario.control
        gains = control.gains.model_copy(update={heavy: 1e4})
        scenario = each.scene.scenario.model_copy(update={"control": control.model_copy(update={"gains": gains})})
        each = replace(each, scene=replace(each.scene, scenario=scenario))
        error = wanted - task_acceleration(plan, command_in(each, "ante", state), state)
        missed[heavy] = np.array([np.linalg.norm(error[rows]) for rows in (slice(0, 3), slice(3, 6), slice(6, 7))])
    for row, heavy in enumerate(missed):
        others = [missed[name][row] for name in missed if name != heavy]
        assert missed[heavy][row] < 0.05 * min(others)


def pressed(plan: TrialPlan, arm: str, force: np.ndarray) -> ArmMeasurement:
    """An arm at rest at its impact pose, on which ``force`` ``(3,)`` [N] presses."""
    q, model = plan.scene.arms[arm].position, plan.scene.models[arm]
    return measurement(q, np.zeros_like(q), model.gravity_torque(q) - model.jacobian(q)[:3].T @ force)


def test_an_impact_is_detected_once_armed_with_its_measurement(plan: TrialPlan) -> None:
    settings = plan.scene.scenario.control.detection
    force = np.array([0.0, 2.0 * settings.threshold, 0.0])
    armed = round((TIMING.nominal_impact - settings.arm_before) / PERIOD)
    found = {}
    for start in (armed - 200, armed + 5):
        controller = Controller(plan)
        for tick in range(start - 20, start):
            controller.update(tick, {ARM: pressed(plan, ARM, np.zeros(3))})
        states = [controller.update(tick, {ARM: pressed(plan, ARM, force)})[ARM] for tick in range(start, start + 50)]
        found[start] = [(start + row, each.detection) for row, each in enumerate(states) if each.detection is not None]
    assert not found[armed - 200]
    ((tick, detection),) = found[armed + 5]
    assert detection.time == pytest.approx(tick * PERIOD)
    assert detection.force > detection.threshold == settings.threshold
    assert detection.wrench[1] > settings.threshold
    np.testing.assert_allclose(detection.twist, 0.0)


def test_the_first_arm_that_hits_takes_both_out_of_the_ante_mode() -> None:
    planned = plan_of("grab", "cat_food", "case_1")
    controller, start = Controller(planned), round(planned.scene.scenario.timing.nominal_impact / PERIOD)
    against = -100.0 * planned.arms["left"].approach_direction
    for tick in range(start, start + 10):
        states = {"left": against if tick > start else np.zeros(3), "right": np.zeros(3)}
        commands = controller.update(tick, {arm: pressed(planned, arm, force) for arm, force in states.items()})
    assert {command.mode for command in commands.values()} == {Mode.INTERIM}
    assert len({command.gamma for command in commands.values()}) == 1
    assert controller.arms["left"].detection is not None
    assert controller.arms["right"].detection is None


# ---- the quadratic program ------------------------------------------------------------------------------------------

COUNT = 7
POSITION, SPEED, TORQUE = np.full(COUNT, 2.5), np.full(COUNT, 2.0), np.array([87.0] * 4 + [12.0] * 3)


def make_qp():
    return AccelerationQp(JointLimits(-POSITION, POSITION, SPEED, TORQUE), PERIOD)


def problem(**values):
    """Decoupled unit joints at rest that want nothing, but for the values given."""
    still = {name: np.zeros(COUNT) for name in ("targets", "bias", "position", "velocity")}
    return AccelerationProblem(
        **{"tasks": np.eye(COUNT), "weights": np.ones(COUNT), "inertia": np.eye(COUNT), **still, **values}
    )


def random_problem(seed, target_scale=5.0, **values):
    rng = np.random.default_rng(seed)
    tasks = rng.standard_normal((COUNT, COUNT))
    root = rng.standard_normal((COUNT, COUNT))
    inertia = root @ root.T / COUNT + 0.3 * np.eye(COUNT)
    targets = target_scale * rng.standard_normal(COUNT)
    return problem(tasks=tasks, targets=targets, inertia=inertia, bias=rng.standard_normal(COUNT), **values)


@given(st.integers(0, 10_000))
def test_without_active_limits_the_tasks_are_met_exactly(seed):
    asked = random_problem(seed, target_scale=1e-3)
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    condition = np.linalg.cond(asked.tasks)
    np.testing.assert_allclose(asked.tasks @ solution.acceleration, asked.targets, atol=1e-6 * condition)


@given(st.integers(0, 10_000))
def test_torque_limits_hold_whatever_the_tasks_want(seed):
    asked = random_problem(seed, target_scale=1e3)
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    assert np.all(np.abs(asked.inertia @ solution.acceleration + asked.bias) <= TORQUE + 1e-6)


@given(st.integers(0, 10_000))
def test_the_program_is_the_weighted_least_squares_problem_of_the_paper(seed):
    """Paper eq. QP_ante: 1/2 x^T H x + g^T x is half of ||A x - b||^2_W, a constant and the regularisation aside."""
    rng = np.random.default_rng(seed)
    asked = random_problem(seed, weights=rng.uniform(0.1, 10.0, COUNT))
    program = make_qp().program(asked)

    def cost(x):
        return x @ program.hessian @ x / 2.0 + program.gradient @ x

    def paper(x):
        error = asked.tasks @ x - asked.targets
        return error @ (asked.weights * error) / 2.0

    x, y = rng.standard_normal((2, COUNT))
    assert cost(x) - cost(y) == pytest.approx(paper(x) - paper(y), rel=1e-6, abs=1e-6)


def test_velocity_limit_is_not_crossed_in_the_next_step():
    """Paper eq. const_dq."""
    asked = problem(targets=np.full(COUNT, 50.0), inertia=0.1 * np.eye(COUNT), velocity=np.full(COUNT, 1.999))
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    assert np.all(asked.velocity + PERIOD * solution.acceleration <= SPEED + 1e-9)


def test_position_limit_is_not_crossed_in_the_next_step():
    """Paper eq. const_q."""
    asked = problem(targets=np.full(COUNT, 50.0), inertia=1e-3 * np.eye(COUNT), position=POSITION - 1e-6)
    solution = make_qp().solve(asked)
    assert solution.status is QpStatus.SOLVED
    assert np.all(asked.position + 0.5 * PERIOD**2 * solution.acceleration <= POSITION + 1e-9)


@pytest.mark.parametrize("overshoot", [1e-4, 0.1])
def test_contradicting_limits_are_relaxed_and_reported_never_nan(overshoot):
    """Beyond the joint stop at speed: position, velocity and torque limits cannot all hold."""
    qp = make_qp()
    asked = random_problem(1, position=POSITION + overshoot, velocity=np.full(COUNT, 1.5))
    solution = qp.solve(asked)
    assert solution.status is QpStatus.RELAXED
    assert np.isfinite(solution.acceleration).all()
    assert solution.acceleration.mean() < 0.0  # it brakes

    still = np.zeros(COUNT)
    healthy = qp.solve(replace(asked, targets=1e-3 * asked.targets, position=still, velocity=still))
    assert healthy.status is QpStatus.SOLVED


def test_limits_that_overflow_have_no_answer():
    """Neither bounds nor slack hold 1e200 rad; the minimiser without bounds would ignore them all."""
    solution = make_qp().solve(random_problem(1, position=np.full(COUNT, 1e200)))
    assert solution.status is QpStatus.FAILED
    np.testing.assert_array_equal(solution.acceleration, 0.0)


def test_singular_tasks_still_have_an_answer():
    tasks = np.zeros((COUNT, COUNT))
    tasks[0, 0] = 1.0
    solution = make_qp().solve(problem(tasks=tasks, targets=np.ones(COUNT)))
    assert solution.status is QpStatus.SOLVED
    np.testing.assert_allclose(solution.acceleration, [1.0] + [0.0] * 6, atol=1e-6)


def test_warm_start_does_not_change_the_answer():
    warm = make_qp()
    for seed in range(20):
        asked = random_problem(seed, target_scale=100.0)
        cold = make_qp().solve(asked)
        np.testing.assert_allclose(warm.solve(asked).acceleration, cold.acceleration, atol=1e-5)


@pytest.mark.parametrize("name", ["targets", "position", "velocity", "bias", "inertia"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_none_have_no_answer_and_cost_no_time(name, value):
    broken = problem()
    broken = replace(broken, **{name: np.array(getattr(broken, name))})
    getattr(broken, name).flat[3] = value
    solution = make_qp().solve(broken)
    assert solution.status is QpStatus.FAILED
    np.testing.assert_array_equal(solution.acceleration, 0.0)
    assert solution.solve_time < 0.1


def test_a_state_beyond_all_bounds_is_given_up_soon():
    solution = make_qp().solve(problem(position=np.full(COUNT, 1e4), velocity=np.full(COUNT, 1e5)))
    assert solution.status is not QpStatus.SOLVED
    assert np.isfinite(solution.acceleration).all()
    assert solution.solve_time < 1.0


# ---- the compiled tick ----------------------------------------------------------------------------------------------


class Reference:
    """The controller of one arm in NumPy, away from limits; modes are given."""

    def __init__(self, plan: TrialPlan, name: str) -> None:
        self.scenario, self.plan = plan.scene.scenario, plan.arms[name]
        self.model = plan.scene.physics.robot_model(name)
        self.motor_inertia = np.diag(plan.scene.physics.arms[name].motor_inertia_reduced)
        self.integral: np.ndarray | None = None
        self.residual, self.baseline = np.zeros(self.model.joint_count), 0.0

    def wrench(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        period, settings = self.scenario.timing.control_period, self.scenario.control.detection
        terms = self.model.terms(q, dq)
        coriolis = pin.computeCoriolisMatrix(self.model.pinocchio, self.model.data, q, dq)
        momentum = terms.mass_matrix @ dq
        self.integral = momentum.copy() if self.integral is None else self.integral
        self.integral += period * (torque + coriolis.T @ dq - (terms.bias - coriolis @ dq) + self.residual)
        self.residual = settings.observer_gain * (momentum - self.integral)
        response = terms.jacobian @ np.linalg.inv(terms.mass_matrix)
        found = np.linalg.solve(response @ terms.jacobian.T, response @ self.residual)
        force = -float(self.plan.approach_direction @ found[:3]) - self.baseline
        if force < settings.threshold:
            self.baseline += period / BASELINE_TIME_S * force
        return found

    def torque(self, tick: int, mode: Mode, gamma: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        plan, gains = self.plan, self.scenario.control.gains
        terms, held, after = self.model.terms(q, dq), list(self.plan.posture), mode is not Mode.ANTE
        position = plan.post_position if after else plan.ante_position
        posture = plan.post_posture if after else plan.ante_posture
        k_theta = gains.orientation_post if after else gains.orientation
        gain = np.repeat((gains.position, k_theta, gains.posture), (3, 3, len(held)))
        tilt = terms.rotation @ pin.log3(terms.rotation.T @ plan.orientation[tick])
        error = np.concatenate((position.position[tick] - terms.position, tilt, posture.position[tick] - q[held]))
        turning = [plan.pad_normal * part[tick, 0] for part in (plan.rotation.velocity, plan.rotation.acceleration)]
        wanted = np.concatenate((position.velocity[tick], turning[0], posture.velocity[tick]))
        moving = np.concatenate((terms.jacobian @ dq, dq[held]))
        feedback = 2.0 * np.sqrt(gain) * gamma * (wanted - moving) + gain * error
        ahead = np.concatenate((position.acceleration[tick], turning[1], posture.acceleration[tick]))
        friction = (plan.post_friction if after else plan.ante_friction)[tick]
        inertia = terms.mass_matrix + self.motor_inertia
        rows = np.vstack((terms.jacobian, np.eye(self.model.joint_count)[held]))
        targets = ahead + feedback + friction - np.concatenate((terms.drift, np.zeros(len(held))))
        if after:
            targets += rows @ np.linalg.solve(inertia, terms.jacobian.T @ plan.wrench[tick])
        weights = np.repeat((gains.position_weight, gains.orientation_weight, gains.posture_weight), (3, 3, len(held)))
        if len(rows) < self.model.joint_count:
            rows = np.vstack((rows, np.eye(self.model.joint_count)))
            targets = np.concatenate((targets, -2.0 * np.sqrt(gains.posture) * dq))
            weights = np.concatenate((weights, np.full(self.model.joint_count, IDLE_TASK_WEIGHT)))
        hessian = rows.T * weights @ rows + 1e-9 * np.eye(self.model.joint_count)
        return inertia @ np.linalg.solve(hessian, rows.T * weights @ targets) + terms.bias


@pytest.mark.parametrize(("name", "object_name", "case"), [("push", "cat_food", "case_2"), ("grab", "juice", "case_1")])
def test_torque_and_wrench_are_those_of_numpy_through_all_modes(name: str, object_name: str, case: str) -> None:
    plan = plan_of(name, object_name, case)
    references = {arm: Reference(plan, arm) for arm in plan.arms}
    plant, modes = make_plant(plan, 4), set()
    for tick in run_closed_loop(plan, plant):
        for arm, measured in tick.measurement.arms.items():
            command, reference = tick.commands[arm], references[arm]
            q, dq = measured.position, measured.velocity
            np.testing.assert_allclose(
                command.wrench, reference.wrench(q, dq, measured.torque), rtol=0.0, atol=1e-9
            )  # N, N m
            expected = reference.torque(tick.number, command.mode, command.gamma, q, dq)
            np.testing.assert_allclose(command.torque, expected, rtol=0.0, atol=1e-11)  # N m
            modes.add(command.mode)
    plant.close()
    assert modes == set(Mode)


@pytest.mark.parametrize("angle", [1e-9, 0.3, 1.9, 2.2, 2.8, 3.14, 3.5, 4.2])
def test_an_orientation_error_is_the_shortest_turn_whatever_its_size(angle: float) -> None:
    """Beyond 120 degrees the compiled tick takes another branch, and beyond 180 the turn the other way round."""
    rng, nothing = np.random.default_rng(round(1e3 * angle)), np.zeros(6)
    for _ in range(20):
        axis = rng.standard_normal(3)
        axes = pin.exp3(rng.standard_normal(3))
        wanted = axes @ pin.exp3(angle * axis / np.linalg.norm(axis))
        phase = (np.zeros((1, 3)), np.zeros((1, 6)), np.zeros((1, 6)), np.ones(6))
        law = _kernel.TaskLaw(np.ones(6), (), phase, phase, wanted[None], np.zeros((1, 6)), idle_rate=0.0, idle=False)
        terms = RigidTerms(np.eye(6), nothing, np.eye(6), nothing, np.zeros(3), axes, nothing)
        tilt = law.decide(0, False, 0.0, nothing, nothing, terms)[0][3:]
        np.testing.assert_allclose(tilt, axes @ pin.log3(axes.T @ wanted), atol=1e-9)


def arrays(told: Any) -> list[np.ndarray]:
    """Every array in a message, however deep."""
    if isinstance(told, np.ndarray):
        return [told]
    if isinstance(told, dict):
        return [found for value in told.values() for found in arrays(value)]
    if is_dataclass(told):
        return [found for field in fields(told) for found in arrays(getattr(told, field.name))]
    return []


def test_what_a_tick_told_stays_as_it_was_when_the_trial_goes_on() -> None:
    plan = plan_of("push", "cat_food", "case_2")
    plant, kept, as_it_was = make_plant(plan, 0), [], []
    for tick in run_closed_loop(plan, plant):
        told = (tick.measurement, tick.commands, plant.truth())
        kept.append([found for part in told for found in arrays(part)])
        as_it_was.append(copy.deepcopy(kept[-1]))
        if tick.number == 950:
            break
    plant.close()
    assert len(kept[0]) > 15
    for now, then in zip(kept, as_it_was, strict=True):
        for one, other in zip(now, then, strict=True):
            np.testing.assert_array_equal(one, other)
