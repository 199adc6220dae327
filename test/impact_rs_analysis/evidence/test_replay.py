# SPDX-License-Identifier: Apache-2.0
"""A replay does what was measured when its physics are right, and shows where they are wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.search.candidate import Candidate, linearise
from impact_rs_analysis.evidence.discrepancy import measured_discrepancy
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays.simulated_trials import simulated
from impact_rs_analysis.evidence.sources.run_source import ReplaySource, kind_of
from impact_rs_sim.effects import library
from impact_rs_sim.effects.formula import FormulaEffect, FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import ArmPhysics, Physics
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.tool_spring import ToolSpring
from impact_rs_trials.runs import NONE, Run

from .conftest import COULOMB, EXCITED, HIT, onset, replayed, residuals, with_arms, with_friction, with_signals

PERIOD = 2.5e-4  # s, of the torque loop
MOTOR = ("free", "motor torque balance")
LINK = ("free", "link torque balance")


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def by_joint_torque(run: Run) -> Run:
    """What a laboratory has that records no command."""
    return with_signals(run, lambda arm: replace(arm, command_time=NONE, command=NONE))


def without_motors(run: Run) -> Run:
    """What a laboratory has whose motors are not measured."""
    empty = np.zeros((0, run.physics.joint_count))
    return with_signals(run, lambda arm: replace(arm, motor_position=empty, motor_velocity=empty))


def commands_later(run: Run, seconds: float) -> Run:
    return run.commands_later(dict.fromkeys(run.signals.arms, seconds))


# ---- what is left of it ---------------------------------------------------------------------------------------------


def test_with_the_right_physics_free_motion_leaves_less_than_the_relevance_limit(hit: Run, free: Run) -> None:
    for run, limit in ((hit, 0.3), (free, 0.3), (without_motors(hit), 0.4)):
        for (phase, signal), values in residuals(run).items():
            if phase == "free":
                assert rms(values) < limit, signal


def scaled(run: MeasuredRun) -> Array:
    """Residuals scaled by relevance limit and model discrepancy: plant and twin are two simulators."""
    systematic = measured_discrepancy().of(run.features, kind_of(run))
    scale = np.hypot([feature.relevance_limit / 2.0 for feature in run.features], systematic)
    return np.asarray((run.measured - replayed(run)) / scale)


def test_with_the_right_physics_a_hit_leaves_no_more_than_simulators_differ_by(measured_hit: MeasuredRun) -> None:
    assert rms(scaled(measured_hit)) < 1.0


def test_a_replay_has_the_compliance_of_the_tool() -> None:
    """Kills a spring that neither the replay nor the digest of what is replayed knows."""
    tool = ToolSpring.of(np.diag([2e-5, 2e-5, 2e-5, 2e-3, 2e-3, 2e-3]), 5e-4)
    soft = with_arms(HIT.scene.physics, lambda arm: replace(arm, tool_spring=tool))
    run = simulated(HIT, soft)
    right, rigid = (
        np.concatenate([values for (phase, _), values in residuals(run, physics).items() if phase != "free"])
        for physics in (soft, None)
    )
    assert rms(right) < 0.5 and rms(rigid) > 5.0 * rms(right)
    setup = MeasuredRun.of(run).setup
    assert setup.digest != replace(setup, physics=soft).digest


def test_measured_joint_torque_moves_the_links_as_the_motors_did(hit: Run, free: Run) -> None:
    for run in (hit, free):
        found = residuals(by_joint_torque(run))
        assert not [key for key in found if key[1] == "motor torque balance"]
        assert rms(found[LINK]) < 0.5
    # A torque that is sampled at 1 kHz does not know what it does within a millisecond of an impact.
    jumps = [residuals(run)["impact", "joint velocity jump"] for run in (hit, by_joint_torque(hit))]
    assert np.max(np.abs(jumps[1] - jumps[0])) < 3.0


def test_friction_shows_with_its_torque_and_its_sign_on_the_motor_side(rubbed: Run) -> None:
    """b_m = tau_d - tau_J - B ddtheta = -tau_fric: where a joint moves up, friction takes coulomb away."""
    measured = MeasuredRun.of(rubbed)
    checked = 0
    for feature, a, b in zip(measured.features, measured.measured, replayed(measured), strict=True):
        if feature.signal != "motor torque balance":
            continue
        joint = int(feature.index.removeprefix("joint")) - 1
        speed = measured.windowed[feature.bin].arms["arm"].velocity[:, joint]
        if np.min(np.abs(speed)) > 0.05:  # beyond the smoothed sign
            checked += 1
            assert a - b == pytest.approx(np.sign(speed[0]) * COULOMB[joint], abs=0.02)
    assert checked > 20
    assert np.max(np.abs(residuals(rubbed, with_friction(rubbed.physics))[MOTOR])) < 1.0
    assert rms(residuals(by_joint_torque(rubbed))[LINK]) < 0.5  # measured joint torque knows no friction


def test_replays_remember_what_was_before_their_windows() -> None:
    """A Maxwell element of a second on motor 4: windows of a tenth of a second do not see where it began."""
    element = FormulaSpec.model_validate(
        {
            "name": "seal",
            "sentence": "A seal yields and creeps.",
            "motor_torque": {"joint4": "-c * lag(dq4, 1)"},
            "parameters": {"c": {"unit": "N m s/rad", "lower": 0, "upper": 50, "scale": 1}},
        }
    )
    known = FormulaEffect(element).apply_vector(EXCITED.scene.physics, np.array([10.0]))
    run = simulated(EXCITED, known, "bullet")
    measured = MeasuredRun.of(run)
    forgetful = tuple(replace(window, before={}) for window in measured.setup.windows)
    sizes = []
    for setup, physics in (
        (measured.setup, known),
        (replace(measured.setup, windows=forgetful), known),
        (measured.setup, EXCITED.scene.physics),
    ):
        features = setup.features_of(setup.replayed(physics))
        own = [f.signal == "motor torque balance" and f.index.endswith("joint4") for f in measured.features]
        limits = np.array([feature.relevance_limit for feature in measured.features])
        sizes.append(rms(((measured.measured - features) / limits)[own]))
    assert sizes[0] < 0.3 and sizes[1] > 3.0 * sizes[0] and sizes[2] > 3.0 * sizes[0], sizes


def test_a_heavier_object_takes_more_speed(hit: Run) -> None:
    heavier = replace(hit.physics, object=replace(hit.physics.object, mass=1.2 * hit.physics.object.mass))
    assert np.max(np.abs(residuals(hit, heavier)["impact", "object velocity"])) > 5.0


# ---- commands -------------------------------------------------------------------------------------------------------


def test_a_late_command_is_a_delay(free: Run) -> None:
    """What was sent 3 ms later than it acted, and what acts 3 ms after it was sent, differ by that sign alone."""
    early = commands_later(free, -0.003)
    delayed = with_arms(free.physics, lambda arm: replace(arm, actuation_delay=0.003))
    assert np.max(np.abs(residuals(early)[MOTOR])) > 5.0
    assert rms(residuals(early, delayed)[MOTOR]) < 0.5


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_a_command_within_a_period_of_the_torque_loop_acts_for_its_share(free: Run, share: float) -> None:
    """Torque balances change by the same share of what a whole period later changes."""
    runs = [MeasuredRun.of(commands_later(free, late * PERIOD)) for late in (0.0, share, 1.0)]
    rows = [feature.signal in (MOTOR[1], LINK[1]) for feature in runs[0].features]
    on_time, between, later = (replayed(run)[rows] for run in runs)
    whole = np.max(np.abs(later - on_time))
    assert whole > 0.02  # N m
    np.testing.assert_allclose(between - on_time, share * (later - on_time), atol=1e-3 * whole)


def test_commands_on_the_edges_of_the_torque_loop_act_as_they_were_sent(free: Run, measured_free: MeasuredRun) -> None:
    expected = replayed(measured_free)
    for early in (-1e-9, 1e-9):
        found = replayed(MeasuredRun.of(commands_later(free, early)))
        np.testing.assert_allclose(found, expected, atol=1e-6)


# ---- where a replay starts ------------------------------------------------------------------------------------------


def test_a_start_is_a_local_fit_of_position_and_velocity_together(free: Run) -> None:
    """Exact for a motion that is a cubic of time; its torque is that of a line."""
    time = free.signals.time
    t, one = (time - 0.9)[:, None], np.ones(7)
    start = free.signals.arms["arm"].position[0]
    position, velocity = start + 0.16 * t - 0.4 * t**2 + 0.5 * t**3, (0.16 - 0.8 * t + 1.5 * t**2) * one
    torque = (2.0 + 30.0 * t) * one
    moved = with_signals(free, lambda arm: replace(arm, position=position, velocity=velocity, torque=torque))
    for window in MeasuredRun.of(moved).setup.windows:
        row = int(np.argmin(np.abs(time - window.time[0])))
        np.testing.assert_allclose(window.arms["arm"].position, position[row], atol=1e-9)
        np.testing.assert_allclose(window.arms["arm"].velocity, velocity[row], atol=1e-7)
        np.testing.assert_allclose(window.drives["arm"].torque, torque[row], atol=1e-9)
        np.testing.assert_allclose(window.drives["arm"].torque_rate, 30.0, rtol=1e-9)


def test_a_start_is_surer_than_a_sample(free: Run) -> None:
    rng, errors, true = np.random.default_rng(0), [], free.signals.arms["arm"]
    for _ in range(10):
        position = true.position + 1e-5 * rng.standard_normal(true.position.shape)
        velocity = true.velocity + 2e-3 * rng.standard_normal(true.velocity.shape)
        noisy = with_signals(free, lambda arm, q=position, dq=velocity: replace(arm, position=q, velocity=dq))
        for window in MeasuredRun.of(noisy).setup.windows:
            row = int(np.argmin(np.abs(free.signals.time - window.time[0])))
            errors.append(window.arms["arm"].velocity - true.velocity[row])
    assert np.std(errors) < 1e-3
    assert abs(np.mean(errors)) < 2e-4


def test_windows_lie_in_motion_before_the_impact_and_do_not_overlap(measured_hit: MeasuredRun) -> None:
    impact = measured_hit.impacts["arm"]
    *free, last = measured_hit.setup.windows
    assert len(free) == 4 and all(not window.contact for window in free) and last.contact
    ends = [(window.time[0], window.time[-1]) for window in free]
    assert [end - start for start, end in ends] == pytest.approx([0.1] * 4, abs=2e-3)
    assert all(a[1] <= b[0] + 1e-9 for a, b in zip(ends, ends[1:], strict=False))
    assert ends[-1][1] < impact - 0.02 + 1e-3
    assert (last.time[0], last.time[-1]) == pytest.approx((impact - 0.02, impact + 0.4), abs=1e-3)


# ---- where an impact begins -----------------------------------------------------------------------------------------


TIME = np.arange(100) * 0.001  # s


def along_y(speed: Array) -> Array:
    return np.outer(speed, [0.0, -1.0, 0.0])


def test_the_onset_is_where_a_given_loss_is_lost_between_two_ticks() -> None:
    speed = np.where(TIME < 0.02, 0.5, np.maximum(0.5 - 20.0 * (TIME - 0.02), 0.4))  # 0.1 m/s lost in 5 ms
    level, begin = onset(TIME, along_y(speed))
    assert level == pytest.approx(0.025)  # a twentieth of the speed
    assert begin == pytest.approx(0.02 + 0.025 / 20.0, abs=1e-9)
    assert np.isnan(onset(TIME, along_y(np.full(100, 0.5)))[1])


def test_a_light_object_takes_little_and_noise_is_no_impact() -> None:
    noise = 0.0005 * np.random.default_rng(0).standard_normal(100)
    level, begin = onset(TIME, along_y(0.5 - np.where(TIME < 0.02, 0.0, 0.02) + noise))
    assert level is not None and 0.003 < level < 0.02
    assert begin == pytest.approx(0.02, abs=0.001)
    assert onset(TIME, along_y(0.5 + noise))[0] is None


def test_the_impact_is_found_in_joint_signals_and_none_in_free_motion(measured_hit: MeasuredRun, free: Run) -> None:
    assert measured_hit.spec is not None
    truth = measured_hit.spec.scene.scenario.timing.nominal_impact
    assert measured_hit.impacts["arm"] == pytest.approx(truth, abs=0.005)
    with pytest.raises(InputError, match="no impact found|hits nothing"):
        MeasuredRun.of(replace(free, hit=True))


# ---- features -------------------------------------------------------------------------------------------------------


def test_repeats_share_the_features_that_all_of_them_have(hit: Run, measured_hit: MeasuredRun) -> None:
    kept = hit.signals.time <= 1.15  # the recording ends before the push does
    arms = {
        name: replace(arm.at(kept), command_time=arm.command_time[kept], command=arm.command[kept])
        for name, arm in hit.signals.arms.items()
    }
    cut = replace(hit, signals=replace(hit.signals, time=hit.signals.time[kept], arms=arms))
    whole, short = Runs.of(Path("here"), [measured_hit, MeasuredRun.of(cut)]).runs
    assert whole.features == short.features
    assert {feature.bin for feature in short.features if feature.phase == "push"} == {0}
    assert len(whole.measured) == len(whole.features) < len(measured_hit.features)
    assert rms(scaled(whole)) < 1.0


# ---- A verdict must not depend on the unit of mass: the same motion of a robot whose masses and torques are larger


HEAVIER = 1.3


def heavier_arm(arm: ArmPhysics) -> ArmPhysics:
    links = tuple(
        link.model_copy(
            update={"mass": HEAVIER * link.mass, "inertia": tuple(HEAVIER * value for value in link.inertia)}
        )
        for link in arm.facts.links
    )
    tool = arm.end_effector
    assert arm.pad_stiffness is not None
    return replace(
        arm,
        facts=arm.facts.model_copy(update={"links": links}),
        end_effector=replace(tool, mass=HEAVIER * tool.mass, inertia=HEAVIER * tool.inertia),
        motor_inertia_rotor=HEAVIER * arm.motor_inertia_rotor,
        motor_inertia_reduced=HEAVIER * arm.motor_inertia_reduced,
        stiffness=HEAVIER * arm.stiffness,
        damping=HEAVIER * arm.damping,
        pad_stiffness=HEAVIER * arm.pad_stiffness,
        pad_damping=HEAVIER * arm.pad_damping,
    )


def heavier_scene(physics: Physics) -> Physics:
    box = physics.object
    return replace(
        with_arms(physics, heavier_arm), object=replace(box, mass=HEAVIER * box.mass, inertia=HEAVIER * box.inertia)
    )


def heavier(run: Run) -> Run:
    """The run in a unit of mass that is smaller."""
    moved = with_signals(run, lambda arm: replace(arm, torque=HEAVIER * arm.torque, command=HEAVIER * arm.command))
    return replace(moved, physics=heavier_scene(run.physics))


def source_of(run: Run) -> ReplaySource:
    return ReplaySource.of(Runs.of(Path("here"), [MeasuredRun.of(run)]), load_model("nominal"), ReplayCache(map))


@pytest.fixture(scope="module")
def sources() -> tuple[ReplaySource, ReplaySource]:
    run = simulated(HIT, with_friction(HIT.scene.physics))
    return source_of(run), source_of(heavier(run))


def test_scaled_residuals_are_the_same(sources: tuple[ReplaySource, ReplaySource]) -> None:
    (light,), (heavy,) = (source.clusters for source in sources)
    np.testing.assert_allclose(heavy.residuals, light.residuals, atol=1e-3 * np.abs(light.residuals).max())
    np.testing.assert_allclose(heavy.discrepancy, light.discrepancy, rtol=1e-6)
    assert np.abs(light.residuals).max() > 10.0


@pytest.mark.parametrize("name", ["joint_coulomb_friction", "object_mass", "torque_offset", "pad_compliance"])
def test_sensitivities_to_a_noticeable_change_are_the_same(
    sources: tuple[ReplaySource, ReplaySource], name: str
) -> None:
    found = []
    for source in sources:
        effect = library()[name].in_proportion(Proportion.of(source.physics))
        candidate = linearise(Candidate.of((effect,), source), source.clusters, (0,), source)
        assert candidate is not None
        found.append(candidate.jacobians[0])
    np.testing.assert_allclose(found[1], found[0], atol=1e-3 * np.abs(found[0]).max())
