# SPDX-License-Identifier: Apache-2.0
"""The momentum observer: nothing in free motion, a known force with its sign, size and delay; sudden forces alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
import pytest
from trials import scene_of

from impact_rs_control.detection import BASELINE_TIME_S, ImpactDetector, separable_wrench
from impact_rs_sim import _kernel
from impact_rs_sim.robots.robot_model import RigidTerms
from impact_rs_sim.scenarios.trial_settings import Detection

SCENE = scene_of("push", "cat_food", "case_2")
MODEL = SCENE.models["arm"]
START = SCENE.arms["arm"].position
COUNT = START.size
PERIOD = 1e-3  # s
FINE = 1e-4  # s; for the motions, so that what is left is not the observer's sampling
SUBSTEPS = 5
DIRECTION = np.array([0.0, -1.0, 0.0])
SETTINGS = Detection(observer_gain=500.0, threshold=15.0, arm_before=0.3)

UR5E = scene_of("push_ur5e", "parcel", "case_1")
ELBOWS = (None, 0.3, 0.05, 0.005, 0.0)  # rad, of the UR5e; None: as it starts, 0: singular

Torque = Callable[[float], np.ndarray]


def detector(settings: Detection = SETTINGS, period: float = PERIOD) -> ImpactDetector:
    return ImpactDetector(MODEL, settings, DIRECTION, period)


def motion(drive: Torque, force: np.ndarray, ticks: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """q, dq and tau_J of M ddq + C dq + g = tau_J + J^T f, from rest; ``drive`` comes on top of the gravity torque."""
    q, dq = START.copy(), np.zeros(COUNT)
    step = FINE / SUBSTEPS
    for tick in range(ticks):
        torque = MODEL.gravity_torque(q) + drive(tick * FINE)
        yield q, dq, torque
        for _ in range(SUBSTEPS):
            terms = MODEL.terms(q, dq)
            dq = dq + step * np.linalg.solve(terms.mass_matrix, torque + terms.jacobian[:3].T @ force - terms.bias)
            q = q + step * dq


def watch(observer: ImpactDetector, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> bool:
    return observer.update(q, dq, torque, MODEL.terms(q, dq))


def push_at_rest(observer: ImpactDetector, force: np.ndarray) -> bool:
    """One tick of an arm at rest that ``force`` ``(3,)`` [N] presses on: tau_J = g - J^T f."""
    pressed = MODEL.gravity_torque(START) - MODEL.jacobian(START)[:3].T @ force
    return watch(observer, START, np.zeros(COUNT), pressed)


def fast(time: float) -> np.ndarray:
    """Torques that bring joints 1, 2 and 4 to speed at once: then Coriolis torques are large."""
    torque = np.zeros(COUNT)
    torque[[0, 1, 3]] = np.array([25.0, -30.0, 15.0]) * np.sin(2.0 * np.pi * time / 0.8)
    return torque


def test_free_motion_of_fast_joints_leaves_no_force() -> None:
    observer = detector(period=FINE)
    forces, coriolis = [], 0.0
    for q, dq, torque in motion(fast, np.zeros(3), 500):
        assert not watch(observer, q, dq, torque)
        forces.append(np.linalg.norm(observer.wrench[:3]))
        bias = MODEL.terms(q, dq).bias - MODEL.gravity_torque(q)
        coriolis = max(coriolis, float(np.linalg.norm(bias)))
    assert coriolis > 2.0, "the motion must have Coriolis torques that a wrong sign would show [N m]"
    assert max(forces) < 0.4


@pytest.mark.parametrize("force", [(12.0, -7.0, 5.0), (-4.0, 9.0, -11.0)])
def test_a_known_force_on_a_moving_arm_is_recovered_with_its_sign_and_size(force: tuple) -> None:
    observer = detector(period=FINE)
    for q, dq, torque in motion(lambda time: 0.3 * fast(time), np.array(force), 1000):
        watch(observer, q, dq, torque)
    np.testing.assert_allclose(observer.wrench[:3], force, atol=0.3)
    np.testing.assert_allclose(observer.wrench[3:], 0.0, atol=0.1)


def test_the_estimate_approaches_the_force_at_the_observer_gain() -> None:
    """r_k = (1 - (1 - K_o Delta t)^k) tau_ext."""
    gain = 50.0
    observer = detector(SETTINGS.model_copy(update={"observer_gain": gain}))
    for tick in range(1, 61):
        push_at_rest(observer, np.array([0.0, 30.0, 0.0]))
        share = 1.0 - (1.0 - gain * PERIOD) ** tick
        np.testing.assert_allclose(observer.wrench[:3], [0.0, 30.0 * share, 0.0], atol=1e-6)


@pytest.mark.parametrize(("size", "hit"), [(1.2, True), (0.95, False), (-1.2, False)])
def test_a_sudden_force_against_the_motion_alone_is_an_impact(size: float, hit: bool) -> None:
    """The arm moves along -y, so an obstacle pushes along +y."""
    observer = detector()
    for _ in range(20):
        assert not push_at_rest(observer, np.zeros(3))
    force = -size * SETTINGS.threshold * DIRECTION
    assert any(push_at_rest(observer, force) for _ in range(10)) == hit


def test_a_force_across_the_motion_is_no_impact() -> None:
    observer = detector()
    assert not any(push_at_rest(observer, np.array([40.0, 0.0, -40.0])) for _ in range(50))


def test_a_sudden_force_on_top_of_a_slow_one_is_found() -> None:
    """As a payload that the model does not know: a ramp r leaves r times the time constant, and then nothing."""
    observer, rate = detector(), 60.0  # N/s
    for tick in range(1, 1001):
        assert not push_at_rest(observer, np.array([0.0, rate * tick * PERIOD, 0.0]))
        if tick == 500:
            assert observer.force == pytest.approx(rate * BASELINE_TIME_S, rel=0.03)
    for _ in range(300):
        assert not push_at_rest(observer, np.array([0.0, rate, 0.0]))
    assert observer.force == pytest.approx(0.0, abs=0.1)
    assert any(push_at_rest(observer, np.array([0.0, rate + 1.2 * SETTINGS.threshold, 0.0])) for _ in range(10))


def test_what_counts_as_an_impact_is_not_forgotten_while_it_lasts() -> None:
    observer = detector()
    push_at_rest(observer, np.zeros(3))
    found = [push_at_rest(observer, -2.0 * SETTINGS.threshold * DIRECTION) for _ in range(500)]
    assert all(found[5:])
    assert observer.force == pytest.approx(2.0 * SETTINGS.threshold, rel=0.1)


@pytest.mark.parametrize(("missed", "error"), [(1, 3.0), (10, 20.0)])
def test_measurements_that_are_missed_leave_little_force(missed: int, error: float) -> None:
    """Kills one period per call: 6 N behind one missed state of a fast arm, and 68 N behind ten."""
    observer, last, forces = detector(), 0, []
    for tick, (q, dq, torque) in enumerate(islice(motion(fast, np.zeros(3), 2000), 0, None, round(PERIOD / FINE))):
        if tick % 50 < 50 - missed:
            observer.update(q, dq, torque, MODEL.terms(q, dq), max(1, tick - last))
            last = tick
            forces.append(observer.force)
    assert np.abs(forces).max() < error  # N


def bent(elbow: float | None) -> np.ndarray:
    """The UR5e where its push starts, with another angle of the elbow."""
    q = UR5E.arms["arm"].position.copy()
    q[2] = q[2] if elbow is None else elbow
    return q


def ur5e_detector() -> ImpactDetector:
    return ImpactDetector(UR5E.models["arm"], UR5E.scenario.control.detection, DIRECTION, PERIOD)


@pytest.mark.parametrize("elbow", ELBOWS)
def test_sensor_noise_is_no_impact_in_any_pose(elbow: float | None) -> None:
    """0.05 N m and 2 mrad/s; the inverse of all six rows of J made 39 hits of it at 0.3 rad and 113 at 0.05 rad."""
    model, q, observer, rng = UR5E.models["arm"], bent(elbow), ur5e_detector(), np.random.default_rng(0)
    hits, forces = 0, []
    for _ in range(200):
        dq = 0.002 * rng.standard_normal(6)
        torque = model.gravity_torque(q) + 0.05 * rng.standard_normal(6)
        hits += observer.update(q, dq, torque, model.terms(q, dq))
        forces.append(np.append(observer.wrench[:3], observer.force))
    assert hits == 0
    assert 1.0 < np.abs(forces).max() < 50.0  # N; across the approach, where it was up to 1.2 kN


@pytest.mark.parametrize("elbow", ELBOWS)
@pytest.mark.parametrize("force", [-30.0, 8.0, 200.0])
def test_a_contact_force_against_the_approach_is_recovered_in_any_pose(elbow: float | None, force: float) -> None:
    """r = -J^T n f. What is recorded as the wrench holds the same force."""
    model, q, observer, still = UR5E.models["arm"], bent(elbow), ur5e_detector(), np.zeros(6)
    observer.update(q, still, model.gravity_torque(q), model.terms(q, still))
    pressed = model.gravity_torque(q) + model.jacobian(q)[:3].T @ DIRECTION * force  # tau_J = g - J^T f
    share = UR5E.scenario.control.detection.observer_gain * PERIOD  # of the force, in the first tick
    hit = observer.update(q, still, pressed, model.terms(q, still))
    assert observer.force == pytest.approx(share * force, rel=1e-9)
    assert hit == (share * force > observer.threshold)
    np.testing.assert_allclose(observer.wrench, np.append(-share * force * DIRECTION, np.zeros(3)), atol=1e-6)


def terms_of(jacobian: np.ndarray, inertia: np.ndarray) -> RigidTerms:
    zero = np.zeros(len(inertia))
    return RigidTerms(inertia, zero, jacobian, np.zeros(6), np.zeros(3), np.eye(3), np.zeros(6))


def test_along_a_direction_in_which_the_arm_cannot_move_there_is_no_force() -> None:
    """Bearings carry it: joints feel only what moves them, whatever rounding leaves of that row of J."""
    rng = np.random.default_rng(3)
    for left in (0.0, 1e-17, 1e-5):
        jacobian = rng.standard_normal((6, 7))
        jacobian[1] *= left
        observer = _kernel.Observer(7, 500.0, PERIOD, 15.0, 0.02, DIRECTION)
        for _ in range(20):
            hit = observer.update(
                np.zeros(7),
                rng.standard_normal(7),
                terms_of(jacobian, np.diag(rng.uniform(0.1, 2.0, 7))),
                np.zeros((7, 7)),
            )
            assert not hit and observer.force == 0.0
            assert observer.wrench[1] == 0.0
            assert np.isfinite(observer.wrench).all()
        # The same in NumPy; nothing else holds its least leverage.
        (found,) = separable_wrench(jacobian[None], np.eye(7)[None], rng.standard_normal((1, 7)))
        assert found[1] == 0.0 and np.abs(found).max() < 1e3


@pytest.mark.parametrize("elbow", [*ELBOWS, 1e-5])
def test_the_wrench_is_that_of_all_components_that_can_be_separated(elbow: float | None) -> None:
    """Forces first; compiled and in NumPy, and where all can be separated the inverse of the whole mobility."""
    model, q, observer, still = UR5E.models["arm"], bent(elbow), ur5e_detector(), np.zeros(6)
    rng = np.random.default_rng(1)
    axes = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # the approach first
    jacobian, mass = model.jacobian(q), model.mass_matrix(q)
    jacobian[:3] = axes @ jacobian[:3]
    observer.update(q, still, model.gravity_torque(q), model.terms(q, still))
    torque = rng.standard_normal(6)
    observer.update(q, still, model.gravity_torque(q) - torque, model.terms(q, still))
    gained = UR5E.scenario.control.detection.observer_gain * PERIOD * torque
    (found,) = separable_wrench(jacobian[None], mass[None], gained[None])
    np.testing.assert_allclose(observer.wrench, np.append(axes.T @ found[:3], found[3:]), rtol=1e-9, atol=1e-12)
    response = jacobian @ np.linalg.solve(mass, np.column_stack((jacobian.T, gained)))
    kept = np.arange(6 if elbow is None else 5)
    np.testing.assert_allclose(found[kept], np.linalg.solve(response[np.ix_(kept, kept)], response[kept, 6]), rtol=1e-9)
    if elbow is not None:
        assert found[5] == 0.0


def test_an_arm_of_three_joints_has_a_wrench_of_forces() -> None:
    """J M^-1 J^T has rank 3: forces explain all that three joints feel."""
    rng = np.random.default_rng(2)
    jacobian, force = rng.standard_normal((6, 3)), np.array([3.0, -4.0, 5.0])
    (found,) = separable_wrench(jacobian[None], np.diag([1.0, 2.0, 0.5])[None], (jacobian[:3].T @ force)[None])
    np.testing.assert_allclose(found, np.append(force, np.zeros(3)), atol=1e-9)
