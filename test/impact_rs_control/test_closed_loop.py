# SPDX-License-Identifier: Apache-2.0
"""Reference spreading in closed loop: what the paper's argument rests on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from trials import plan_of, scene_of, ticks_of

from impact_rs_control.closed_loop import ran_away
from impact_rs_control.controller import Mode
from impact_rs_control.plan import plan_trial
from impact_rs_control.qp import QpStatus
from impact_rs_sim.errors import InputError
from impact_rs_sim.sensors import ArmMeasurement


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
