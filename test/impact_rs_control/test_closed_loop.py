# SPDX-License-Identifier: Apache-2.0
"""Reference spreading in closed loop: a push, a grab, and what the paper's argument rests on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from trials import plan_of, scene_of, ticks_of

from impact_rs_control.closed_loop import make_plant, ran_away, run_closed_loop
from impact_rs_control.controller import Mode
from impact_rs_control.plan import TrialPlan, plan_trial
from impact_rs_control.qp import QpStatus
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map import compute_impact_map
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.plant.sensors import ArmMeasurement
from impact_rs_sim.robots.robot import Link, RobotFacts
from impact_rs_sim.robots.robot_model import RobotModel
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.scene import ArmState, Scene
from impact_rs_trials.bags.outcome import TickLog, Verdict, judge

# ---- push -----------------------------------------------------------------------------------------------------------


def run(plan, object_shift=None):
    if object_shift is not None:
        moved = replace(plan.scene.object, position=plan.scene.object.position + object_shift)
        plan = replace(plan, scene=replace(plan.scene, object=moved))
    return [
        SimpleNamespace(measurement=tick.measurement, commands=tick.commands, truth=truth)
        for tick, truth in ticks_of(plan)
    ]


@pytest.fixture(scope="module")
def scene():
    return scene_of("push", "cat_food", "2")


@pytest.fixture(scope="module")
def nominal(scene):
    return run(plan_trial(scene))


def detections(ticks):
    return [tick.commands["arm"].detection for tick in ticks if tick.commands["arm"].detection is not None]


def test_impact_is_detected_once_within_5_ms_of_first_contact(nominal):
    found = detections(nominal)
    contact = next(t.truth.time for t in nominal if np.any(t.truth.arms["arm"].pad_force))
    assert len(found) == 1
    assert 0.0 <= found[0].time - contact <= 0.005


def test_modes_follow_each_other_and_gamma_ramps_from_0_to_1(scene, nominal):
    modes = [tick.commands["arm"].mode for tick in nominal]
    assert modes == sorted(modes)
    assert set(modes) == set(Mode)
    interim = [t.commands["arm"].gamma for t in nominal if t.commands["arm"].mode is Mode.INTERIM]
    assert interim[0] == 0.0
    assert np.all(np.diff(interim) > 0.0)
    assert len(interim) == round(scene.scenario.control.interim_duration / scene.scenario.timing.control_period)


def test_before_impact_almost_no_feedback_is_needed(nominal):
    """The rigid model with B_theta is the right feedforward for the flexible arm (paper, below eq. eom_ante)."""
    early = [t.commands["arm"].feedback for t in nominal if 0.1 < t.measurement.time < 0.88]
    assert np.abs(np.mean(early, axis=0)).max() < 0.05


def test_qp_is_solved_in_every_tick(nominal):
    assert all(t.commands["arm"].qp_status is QpStatus.SOLVED for t in nominal)


def test_too_fast_a_reference_needs_push_and_too_slow_a_one_needs_braking(scene):
    """a_fb,net changes sign between 80 % and 120 % (paper sec. Validation methodology); the motion is along -y."""
    net = {}
    for scale in (0.8, 1.2):
        net[scale] = run(plan_trial(scene, scale))[-1].commands["arm"].net_feedback[1]
    assert net[0.8] > 0.02
    assert net[1.2] < -0.02


def test_without_object_the_arm_stops_and_reports_no_impact(scene):
    ticks = run(plan_trial(scene), object_shift=np.array([0.6, 0.0, 0.0]))
    assert not detections(ticks)
    assert {t.commands["arm"].mode for t in ticks} == {Mode.ANTE}
    assert np.abs(ticks[-1].commands["arm"].twist).max() < 0.02


def test_early_and_late_impact_are_both_caught(scene):
    plan = plan_trial(scene)
    for shift in (-0.03, 0.03):
        found = detections(run(plan, object_shift=np.array([0.0, shift, 0.0])))
        assert len(found) == 1
        assert found[0].time == pytest.approx(0.9 - shift / 0.7, abs=0.012)


def test_object_and_arm_move_together_in_the_end(nominal):
    last = nominal[1500]
    assert last.truth.object.twist[1] == pytest.approx(last.commands["arm"].twist[1], abs=0.01)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_velocity_scale_that_is_none_is_refused(scene, scale):
    with pytest.raises(InputError, match="velocity scale"):
        plan_trial(scene, scale)


def test_motor_inertia_model_that_is_none_is_refused(scene):
    with pytest.raises(InputError, match="reduced, rotor, zero"):
        plan_trial(scene, motor_inertia="rotors")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["position", "velocity", "torque", "command"])
def test_any_number_that_is_none_ends_a_trial_and_a_healthy_state_does_not(where: str, value: float) -> None:
    plan = plan_of("push", "cat_food", "case_2")
    numbers = {name: np.zeros(7) for name in ("position", "velocity", "torque", "command")}

    def ended() -> bool:
        state = [numbers[name] for name in ("position", "velocity", "torque", "position", "velocity")]
        with np.errstate(invalid="ignore"):
            return ran_away(plan, {"arm": ArmMeasurement(*state)}, {"arm": numbers["command"]})

    assert not ended()
    numbers[where][2] = value
    assert ended()


# ---- grab -----------------------------------------------------------------------------------------------------------

GRAB = load_scenario("grab")
SCENE = Scene.resolve(GRAB, "cat_food", "case_1")
MIRROR = np.diag([1.0, -1.0, 1.0])
JOINTS = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # axes in the mirror plane turn the other way


def mirrored(facts: RobotFacts, model: RobotModel) -> RobotFacts:
    """The arm seen in a mirror: at zero, joint axes lie in the mirror plane or across it; only inertials change."""
    places = model.link_placements(pin.neutral(model.pinocchio))
    base = places["base"].rotation
    links = []
    for number, link in enumerate(facts.links, start=1):
        turn = base.T @ places[f"link{number}"].rotation
        flip = turn.T @ MIRROR @ turn
        inertia = flip @ link.inertia_matrix @ flip.T
        entries = tuple(float(inertia[index]) for index in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
        links.append(Link(mass=link.mass, com=tuple((flip @ np.array(link.com)).tolist()), inertia=entries))
    return facts.model_copy(update={"links": tuple(links)})


def mirrored_problem() -> ImpactProblem:
    """The nominal grab with a right arm that is the left one's mirror image."""
    problem = ImpactProblem.at_nominal_impact(SCENE)
    left = problem.arms["left"]
    facts = mirrored(problem.physics.arms["left"].facts, SCENE.models["left"])
    arms = {**problem.physics.arms, "right": replace(problem.physics.arms["right"], facts=facts)}
    state = ArmState(JOINTS * left.position, JOINTS * left.velocity)
    return replace(problem, physics=replace(problem.physics, arms=arms), arms={"left": left, "right": state})


def test_the_mirror_image_of_an_arm_weighs_the_same_everywhere() -> None:
    problem = mirrored_problem()
    left, right = (problem.physics.robot_model(name) for name in ("left", "right"))
    for seed in range(5):
        q = np.random.default_rng(seed).uniform(left.position_min, left.position_max)
        expected = np.diag(JOINTS) @ left.mass_matrix(q) @ np.diag(JOINTS)
        np.testing.assert_allclose(right.mass_matrix(JOINTS * q), expected, atol=1e-10)


@pytest.mark.parametrize("engine", ["exact", "bullet"])
def test_a_mirrored_scene_gives_a_mirrored_answer(engine: str) -> None:
    """Redundant friction must not turn up as a rotation of the box out of the mirror plane."""
    result = compute_impact_map(mirrored_problem(), engine)
    left, right = result.end_effector_twist["left"], result.end_effector_twist["right"]
    speed = float(np.linalg.norm(GRAB.cases["case_1"].robots["left"].ante_velocity))
    tolerance = (1e-5 if engine == "exact" else 2e-3) * speed
    np.testing.assert_allclose(right[:3], MIRROR @ left[:3], atol=tolerance)
    np.testing.assert_allclose(result.object_twist[[1, 3, 5]], 0.0, atol=10.0 * tolerance)
    np.testing.assert_allclose(
        result.joint_velocity["right"], JOINTS * result.joint_velocity["left"], atol=0.05 * speed
    )


@pytest.fixture(scope="module")
def plan() -> TrialPlan:
    return plan_trial(SCENE)


def _run(plan: TrialPlan, physics=None):  # noqa: ANN001, ANN202
    plant = make_plant(plan, 5, physics)
    heights, modes, detections, log = [], [], {}, TickLog(plan)
    try:
        for tick in run_closed_loop(plan, plant):
            log.append(tick)
            if tick.measurement.object is not None:
                heights.append(tick.measurement.object.position[2])
            modes.append({int(command.mode) for command in tick.commands.values()})
            for name, command in tick.commands.items():
                if command.detection is not None:
                    detections[name] = command.detection.time
    finally:
        plant.close()
    return np.array(heights), modes, detections, judge(plan, log.record())


def test_both_arms_leave_the_ante_mode_together_and_hold_the_box(plan: TrialPlan) -> None:
    heights, modes, detections, verdict = _run(plan)
    assert all(len(mode) == 1 for mode in modes)
    assert set(detections) == {"left", "right"}
    assert abs(detections["left"] - detections["right"]) < 0.02
    lift = heights[-1] - heights[0]
    assert lift == pytest.approx(plan.expected_lift, rel=0.1)
    assert np.ptp(heights[-10:]) < 1e-3
    assert verdict == Verdict("OK")


def test_slippery_pads_drop_the_box(plan: TrialPlan) -> None:
    nominal = plan.scene.physics
    physics = library()["pad_friction"].apply_vector(nominal, np.array([-0.9 * nominal.pad_friction]))
    assert _run(plan, physics)[-1].outcome == "DROPPED"
