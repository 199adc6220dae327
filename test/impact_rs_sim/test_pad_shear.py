# SPDX-License-Identifier: Apache-2.0
"""A box that a known force drags along a pad that stands still: closed forms of spring, creep and slip."""

from __future__ import annotations

import numpy as np
import pytest

from impact_rs_sim.plant.pad_shear import ContactBody, PadContacts, PadShear

MASS, MOMENT = 1.0, 0.004  # kg, kg m^2 about the normal
HALF, LOAD, FRICTION = 0.05, 20.0, 0.5  # m, N in all, -
CORNERS = HALF * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
UP = np.array([0.0, 0.0, 1.0])
STEP = 2.5e-4  # s
EVEN = np.full(4, LOAD / 4.0)
ALONG = np.eye(3)
COMPLIANCE, CREEP = 1.5e-5, 1e-3
STILL = ContactBody(np.zeros(3), np.zeros(6), np.zeros((6, 6)))


def dragged(shear, pull, seconds, twist=0.0, step=STEP, start=0.0, loads=EVEN, rotation=ALONG):
    """Way and speed of the box under a force along x [N] of time and a torque about the normal, ``(k, 4)``."""
    mobility = np.diag([1.0 / MASS] * 3 + [1.0 / MOMENT] * 3)
    state, rows = np.array([0.0, 0.0, start, 0.0]), []  # x, angle, their rates
    for number in range(round(seconds / step)):
        velocity = np.array([state[2], 0.0, 0.0, 0.0, 0.0, state[3]])
        thing = ContactBody(np.array([state[0], 0.0, 0.0]), velocity, mobility)
        points = CORNERS + thing.position
        forces = shear.step(PadContacts(points, loads, UP), thing, STILL, rotation)
        total, torque = forces.sum(axis=0), np.cross(points - thing.position, forces).sum(axis=0)[2]
        force = pull(number * step) if callable(pull) else pull
        state[2:] += step * np.array([(total[0] + force) / MASS, (torque + twist) / MOMENT])
        state[:2] += step * state[2:]
        rows.append(state.copy())
    return np.array(rows)


@pytest.mark.parametrize("compliance", [2e-6, 1.5e-5, 1e-4])
@pytest.mark.parametrize("pull", [4.0, -6.0])
def test_the_face_is_sheared_by_force_times_compliance(compliance, pull):
    found = dragged(PadShear(compliance, 0.0, FRICTION, STEP), pull, 0.3)[-1]
    assert found[0] == pytest.approx(pull * compliance, rel=1e-3)
    assert found[2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("creep", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("compliance", [0.0, COMPLIANCE])
def test_under_load_it_creeps_at_force_times_creep(creep, compliance):
    motion = dragged(PadShear(compliance, creep, FRICTION, STEP), 4.0, 0.5)
    assert motion[-1, 2] == pytest.approx(4.0 * creep, rel=1e-3)


def test_shear_comes_back_when_the_load_ends_and_creep_stays():
    def until(time):
        return 5.0 if time < 0.2 else 0.0

    motion = dragged(PadShear(COMPLIANCE, CREEP, FRICTION, STEP), until, 0.5)
    before, after = motion[round(0.2 / STEP) - 1], motion[-1]
    # Creep is the impulse of friction times c, which is that of the load when all is at rest again.
    assert after[0] == pytest.approx(5.0 * CREEP * 0.2, rel=1e-3)
    stopping = MASS * before[2] * CREEP
    assert before[0] - after[0] == pytest.approx(5.0 * COMPLIANCE - stopping, rel=0.01)
    assert after[2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("compliance", "creep"), [(COMPLIANCE, 0.0), (0.0, CREEP), (COMPLIANCE, CREEP)])
def test_beyond_its_friction_the_box_slips_with_what_is_left(compliance, creep):
    pull = 2.0 * FRICTION * LOAD
    motion = dragged(PadShear(compliance, creep, FRICTION, STEP), pull, 0.2)
    rate = (motion[-1, 2] - motion[len(motion) // 2, 2]) / 0.1
    assert rate == pytest.approx((pull - FRICTION * LOAD) / MASS, rel=0.01)


def test_just_below_its_friction_the_box_stays():
    motion = dragged(PadShear(COMPLIANCE, 0.0, FRICTION, STEP), lambda t: min(t / 0.1, 0.95) * FRICTION * LOAD, 0.3)
    assert motion[-1, 0] == pytest.approx(0.95 * FRICTION * LOAD * COMPLIANCE, rel=0.01)


def test_points_carry_friction_as_they_carry_load():
    """With its force through the middle of the load, so that nothing turns, all points hold up to their cones."""
    loads = LOAD * np.array([0.4, 0.1, 0.1, 0.4])
    pull = 0.95 * FRICTION * LOAD
    motion = dragged(PadShear(COMPLIANCE, 0.0, FRICTION, STEP), lambda t: min(t / 0.1, 1.0) * pull, 0.3, loads=loads)
    assert motion[-1, 0] == pytest.approx(pull * COMPLIANCE, rel=0.01)


def test_a_box_that_slid_keeps_no_more_shear_than_its_friction_holds():
    """It slides to rest, and springs back by no more than mu N C."""
    motion = dragged(PadShear(COMPLIANCE, 0.0, FRICTION, STEP), 0.0, 0.3, start=0.5)
    stop = 0.5**2 / (2.0 * FRICTION * LOAD / MASS)
    assert motion[-1, 0] == pytest.approx(stop, abs=2.0 * FRICTION * LOAD * COMPLIANCE)
    assert motion[:, 0].max() - motion[-1, 0] <= FRICTION * LOAD * COMPLIANCE
    assert motion[-1, 2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("twist", [0.1, -0.2])
def test_a_torque_twists_the_face_by_compliance_over_radius_squared(twist):
    motion = dragged(PadShear(COMPLIANCE, 0.0, FRICTION, STEP), 0.0, 0.3, twist=twist)
    assert motion[-1, 1] == pytest.approx(twist * COMPLIANCE / (2.0 * HALF**2), rel=1e-3)


def test_a_torque_beyond_the_friction_of_all_corners_turns_the_box():
    most = FRICTION * LOAD * HALF * np.sqrt(2.0)
    motion = dragged(PadShear(COMPLIANCE, 0.0, FRICTION, STEP), 0.0, 0.02, twist=1.5 * most)
    rate = (motion[-1, 3] - motion[-41, 3]) / (40 * STEP)
    assert rate == pytest.approx(0.5 * most / MOMENT, rel=0.01)


def test_the_swing_is_that_of_a_mass_on_a_damped_spring():
    """Overshoot exp(-pi z / sqrt(1 - z^2)) of the ratio 0.5 after half a period."""
    motion = dragged(PadShear(COMPLIANCE, 0.0, FRICTION, 5e-5), 4.0, 0.1, step=5e-5)
    root = np.sqrt(0.75)
    assert motion[:, 0].max() / (4.0 * COMPLIANCE) == pytest.approx(1.0 + np.exp(-np.pi * 0.5 / root), rel=0.02)
    assert 5e-5 * np.argmax(motion[:, 0]) == pytest.approx(np.pi * np.sqrt(COMPLIANCE) / root, rel=0.04)


def test_smaller_steps_converge_to_one_motion():
    def end(step):
        return dragged(PadShear(COMPLIANCE, CREEP, FRICTION, step), 4.0, 0.01, step=step)[-1]

    finest = end(STEP / 32.0)
    errors = [np.abs(end(STEP / number) - finest)[[0, 2]] for number in (1, 2, 4)]
    assert np.all(errors[1] < 0.65 * errors[0]) and np.all(errors[2] < 0.65 * errors[1])


@pytest.mark.parametrize("pads", [1, 2])
@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_without_any_compliance_it_is_the_rigid_pad_up_to_a_step(pads, step):
    """Stable, and yields by no more than the force moves the free box within some steps."""
    mobility = max(1.0 / MASS, 2.0 * HALF**2 / MOMENT)  # of sliding, of turning
    motion = dragged(PadShear(0.0, 1e-12, FRICTION, step, pads), 4.0, 0.5, step=step)
    assert motion[-1, 0] == pytest.approx(4.0 * pads * step**2 * mobility, rel=1e-3)
    assert abs(motion[-1, 2]) < 1e-9
    hard = dragged(PadShear(1e-9, 0.0, FRICTION, step, pads), 4.0, 0.5, step=step)
    assert hard[-1, 0] == pytest.approx(4.0 * pads * step * (step + 1e-9**0.5) * mobility, rel=1e-3)


def test_a_pad_that_lets_go_forgets_its_shear():
    shear = PadShear(COMPLIANCE, 0.0, FRICTION, STEP)
    dragged(shear, 4.0, 0.1)
    assert np.abs(shear.force[0]) == pytest.approx(4.0, rel=1e-3)
    shear.release()
    first = dragged(shear, 0.0, STEP)
    np.testing.assert_array_equal(first[-1], 0.0)


def test_points_without_load_carry_nothing():
    shear = PadShear(COMPLIANCE, 0.0, FRICTION, STEP)
    loads = np.array([LOAD, LOAD, 0.0, 0.0])
    thing = ContactBody(np.zeros(3), np.array([0.01, 0.02, 0.3, 0.0, 0.0, 0.1]), np.eye(6))
    forces = shear.step(PadContacts(CORNERS, loads, UP), thing, STILL, np.eye(3))
    assert not np.any(forces[2:]) and not np.any(forces[:, 2])
    assert np.all(forces[:2] @ [0.01, 0.02, 0.0] < 0.0)
    assert np.all(np.linalg.norm(forces, axis=1) <= FRICTION * loads + 1e-12)


def test_shear_turns_with_the_pad():
    """Pad and box turn together by a right angle: the force that was along x is along y."""
    shear = PadShear(COMPLIANCE, 0.0, FRICTION, STEP)
    askew = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    dragged(shear, 4.0, 0.3, rotation=askew)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ askew
    rest = ContactBody(np.array([0.0, 4.0 * COMPLIANCE, 0.0]), np.zeros(6), np.eye(6))
    forces = shear.step(PadContacts(CORNERS + rest.position, np.full(4, LOAD / 4.0), UP), rest, STILL, turned)
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, -4.0, 0.0], atol=0.02)
