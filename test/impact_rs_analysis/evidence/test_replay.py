# SPDX-License-Identifier: Apache-2.0
"""The replay twin does what was measured when its physics are right, and shows where they are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from impact_rs_analysis.evidence.features import onset_level, onset_of
from impact_rs_analysis.evidence.impacts import impacts_of
from impact_rs_analysis.evidence.measured import MeasuredRun
from impact_rs_analysis.evidence.replay import (
    AFTER_IMPACT,
    BEFORE_IMPACT,
    FREE,
    _held,
    _joint_fit,
    _slope_fit,
    free_starts,
    windows_of,
)
from impact_rs_analysis.evidence.run import Run
from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.robot import Array

from .conftest import COULOMB, with_friction


def left(run: Run, physics: Physics | None = None) -> dict[tuple[str, str], Array]:
    """Measured minus replayed features over their floors, by phase and signal."""
    measured = MeasuredRun.of(run)
    predicted = measured.setup.features_of(measured.setup.replayed(physics or run.physics))
    assert predicted is not None
    found: dict[tuple[str, str], list[float]] = {}
    for feature, a, b in zip(measured.features, measured.measured, predicted, strict=True):
        found.setdefault((feature.phase, feature.signal), []).append((a - b) / feature.relevance_limit)
    return {key: np.array(values) for key, values in found.items()}


def by_joint_torque(run: Run) -> Run:
    """What a laboratory has that records no command."""
    return replace(run, command={}, command_time={})


def without_motors(run: Run) -> Run:
    """What a laboratory has whose motors are not measured."""
    empty = np.zeros((0, run.physics.joint_count))
    arms = {n: replace(a, motor_position=empty, motor_velocity=empty) for n, a in run.signals.arms.items()}
    return replace(run, signals=replace(run.signals, arms=arms))


def test_with_the_right_physics_nothing_is_left_that_anyone_cares_about(hit: Run, free: Run) -> None:
    for run in (hit, free):
        for key, values in left(run).items():
            assert np.sqrt(np.mean(np.square(values))) < 0.3, key


def test_without_motors_it_is_the_same(hit: Run) -> None:
    for key, values in left(without_motors(hit)).items():
        assert np.sqrt(np.mean(np.square(values))) < 0.4, key


def test_measured_joint_torque_moves_the_links_as_the_motors_did(hit: Run, free: Run) -> None:
    for run in (hit, free):
        found = left(by_joint_torque(run))
        assert not [key for key in found if key[1] == "motor torque balance"]
        assert np.sqrt(np.mean(np.square(found["free", "link torque balance"]))) < 0.5
    # A torque that is sampled at 1 kHz does not know what it does within a millisecond of an impact.
    assert np.max(np.abs(left(by_joint_torque(hit))["impact", "joint velocity jump"])) < 3.0


def test_friction_shows_with_its_torque_and_its_sign_on_the_motor_side(rubbed: Run, free: Run) -> None:
    """b_m = tau_d - tau_J - B ddtheta = -tau_fric: where a joint moves up, friction takes coulomb away."""
    measured = MeasuredRun.of(rubbed)
    predicted = measured.setup.features_of(measured.setup.replayed(rubbed.physics))
    checked = 0
    for feature, a, b in zip(measured.features, measured.measured, predicted, strict=True):
        if feature.signal != "motor torque balance":
            continue
        joint = int(feature.index.removeprefix("joint")) - 1
        speed = measured.signals[feature.bin].arms["arm"].velocity[:, joint]
        if np.min(np.abs(speed)) > 0.05:  # beyond the smoothed sign
            checked += 1
            assert a - b == pytest.approx(np.sign(speed[0]) * COULOMB[joint], abs=0.02)
    assert checked > 20
    assert np.max(np.abs(left(rubbed, with_friction(rubbed.physics))["free", "motor torque balance"])) < 1.0


def test_measured_joint_torque_knows_no_friction(rubbed: Run) -> None:
    found = left(by_joint_torque(rubbed))["free", "link torque balance"]
    assert np.sqrt(np.mean(np.square(found))) < 0.5


def test_a_late_command_is_a_delay(free: Run) -> None:
    """What was sent 3 ms later than it acted, and what acts 3 ms after it was sent, differ by that sign alone."""
    early = replace(free, command_time={name: time - 0.003 for name, time in free.command_time.items()})
    delayed = replace(
        free.physics,
        arms={name: replace(arm, actuation_delay=0.003) for name, arm in free.physics.arms.items()},
    )
    assert np.max(np.abs(left(early)["free", "motor torque balance"])) > 5.0
    assert np.sqrt(np.mean(np.square(left(early, delayed)["free", "motor torque balance"]))) < 0.5


def test_a_heavier_object_takes_more_speed(hit: Run) -> None:
    heavier = replace(hit.physics, object=replace(hit.physics.object, mass=1.2 * hit.physics.object.mass))
    assert np.max(np.abs(left(hit, heavier)["impact", "object velocity"])) > 5.0


def test_the_start_is_a_local_fit_of_position_and_velocity_together() -> None:
    time = np.arange(200) * 0.001
    q = (0.3 + 0.8 * time - 2.0 * time**2 + 5.0 * time**3)[:, None]
    dq = (0.8 - 4.0 * time + 15.0 * time**2)[:, None]
    position, velocity = _joint_fit(time, q, dq, 0.1)
    assert position[0] == pytest.approx(0.3 + 0.08 - 0.02 + 0.005, abs=1e-9)
    assert velocity[0] == pytest.approx(0.8 - 0.4 + 0.15, abs=1e-7)
    torque, rate = _slope_fit(time, (2.0 + 30.0 * time)[:, None], 0.1)
    assert (torque[0], rate[0]) == pytest.approx((5.0, 30.0))


def test_the_start_is_surer_than_a_sample() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(200) * 0.001
    q, dq = 0.5 * time, np.full(200, 0.5)
    errors = []
    for _ in range(200):
        noisy = (q + 1e-5 * rng.standard_normal(200))[:, None], (dq + 2e-3 * rng.standard_normal(200))[:, None]
        errors.append(_joint_fit(time, *noisy, 0.1)[1][0] - 0.5)
    assert np.std(errors) < 1e-3
    assert abs(np.mean(errors)) < 2e-4


def test_windows_lie_in_motion_and_before_the_impact_and_do_not_overlap(hit: Run) -> None:
    impact = next(iter(MeasuredRun.of(hit).impacts.values()))
    windows = windows_of(hit, {"arm": impact})
    *free, last = windows
    assert len(free) == 4 and all(not window.contact for window in free) and last.contact
    ends = [(window.time[0], window.time[-1]) for window in free]
    assert all(end - start == pytest.approx(FREE, abs=2e-3) for start, end in ends)
    assert all(a[1] <= b[0] + 1e-9 for a, b in zip(ends, ends[1:], strict=False))
    assert ends[-1][1] < impact - BEFORE_IMPACT + 1e-3
    assert last.time[0] == pytest.approx(impact - BEFORE_IMPACT, abs=1e-3)
    assert last.time[-1] == pytest.approx(impact + AFTER_IMPACT, abs=1e-3)


def test_the_onset_is_where_a_given_loss_is_lost_between_two_ticks() -> None:
    time = np.arange(100) * 0.001
    speed = np.where(time < 0.02, 0.5, np.maximum(0.5 - 20.0 * (time - 0.02), 0.4))  # 0.1 m/s lost in 5 ms
    velocity = np.outer(speed, [0.0, -1.0, 0.0])
    level = onset_level(time, velocity)
    assert level == pytest.approx(0.025)  # a twentieth of the speed
    assert onset_of(time, velocity, level) == pytest.approx(0.02 + 0.025 / 20.0, abs=1e-9)
    assert onset_of(time, np.outer(np.full(100, 0.5), [0.0, -1.0, 0.0]), level) is None


def test_a_light_object_takes_little_and_noise_is_no_impact() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(100) * 0.001
    light = 0.5 - np.where(time < 0.02, 0.0, 0.02)
    noise = 0.0005 * rng.standard_normal(100)
    level = onset_level(time, np.outer(light + noise, [0.0, -1.0, 0.0]))
    assert level is not None and 0.003 < level < 0.02
    assert onset_of(time, np.outer(light + noise, [0.0, -1.0, 0.0]), level) == pytest.approx(0.02, abs=0.001)
    assert onset_level(time, np.outer(0.5 + noise, [0.0, -1.0, 0.0])) is None


def test_the_impact_is_found_in_joint_signals_and_where_there_is_none_nothing_is_found(hit: Run, free: Run) -> None:
    truth = hit.spec.scene.scenario.timing.nominal_impact
    assert MeasuredRun.of(hit).impacts["arm"] == pytest.approx(truth, abs=0.005)
    with pytest.raises(InputError, match="no impact found|hits nothing"):
        MeasuredRun.of(replace(free, hit=True))


def test_repeats_share_the_features_that_all_of_them_have(hit: Run) -> None:
    from pathlib import Path

    from impact_rs_analysis.evidence.runs import Runs

    kept = hit.signals.time <= 1.15  # the recording ends before the push does
    cut = replace(
        hit,
        signals=replace(
            hit.signals,
            time=hit.signals.time[kept],
            arms={
                name: replace(
                    arm,
                    **{
                        key: getattr(arm, key)[kept]
                        for key in ("position", "velocity", "torque", "motor_position", "motor_velocity", "command")
                    },
                )
                for name, arm in hit.signals.arms.items()
            },
        ),
    )
    runs = Runs.of(Path("here"), [MeasuredRun.of(hit), MeasuredRun.of(cut)])
    whole, short = runs.runs
    assert whole.features == short.features
    assert {feature.bin for feature in short.features if feature.phase == "push"} == {0}
    assert len(whole.measured) == len(whole.features) < len(MeasuredRun.of(hit).features)
    predicted = whole.setup.features_of(whole.setup.replayed(hit.physics))
    floors = np.array([feature.relevance_limit for feature in whole.features])
    assert np.sqrt(np.mean(np.square((whole.measured - predicted) / floors))) < 0.3


@pytest.mark.parametrize("gap", [None, 1])
def test_the_part_before_the_hit_is_measured_and_replayed_as_in_the_whole(hit: Run, gap: int | None) -> None:
    """Window by window, with friction that only the model has, and also where a gap took a window."""
    run = hit
    if gap is not None:
        start = free_starts(hit, {name: begin for name, (begin, _) in impacts_of(hit).items()})[gap]
        run = replace(hit, gaps=((start + 0.04, start + 0.06),))
    whole = MeasuredRun.of(run)
    part = whole.free_part
    assert part is not None and not part.hit
    rows = [number for number, feature in enumerate(whole.features) if feature.phase == "free"]
    assert part.features == tuple(whole.features[row] for row in rows)
    np.testing.assert_array_equal(part.measured, whole.measured[rows])
    np.testing.assert_allclose(part.setup.features_of(part.signals), part.measured, atol=1e-12)
    physics = with_friction(run.physics)
    predicted = whole.setup.features_of(whole.setup.replayed(physics))
    np.testing.assert_allclose(part.setup.features_of(part.setup.replayed(physics)), predicted[rows], atol=1e-12)


def test_a_command_that_begins_within_a_period_of_the_torque_loop_acts_for_its_share_of_it() -> None:
    period, values = 2.5e-4, np.array([[1.0], [2.0], [4.0]])
    grid = period * np.arange(12)
    torque, acting = _held(np.array([0.0, 1.1e-3, 2.1e-3]), values, grid, period)
    assert torque[acting].ravel() == pytest.approx([1.0] * 4 + [1.6] + [2.0] * 3 + [3.2] + [4.0] * 3)
    impulse = 1.0 * 1.1e-3 + 2.0 * 1.0e-3 + 4.0 * 0.9e-3
    assert period * float(torque[acting].sum()) == pytest.approx(impulse)


def test_commands_on_the_edges_of_the_torque_loop_act_as_they_were_sent() -> None:
    period, values = 2.5e-4, np.array([[1.0], [2.0], [4.0]])
    sent = np.array([0.0, 1.0e-3 + 1e-12, 2.0e-3 - 1e-12])
    torque, acting = _held(sent, values, period * np.arange(12), period)
    np.testing.assert_array_equal(torque, values)
    np.testing.assert_array_equal(acting, np.repeat([0, 1, 2], 4))
