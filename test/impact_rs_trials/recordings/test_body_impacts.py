# SPDX-License-Identifier: Apache-2.0
"""Tossed bodies by closed forms, seen through a noisy tracker: what was planted on both sides of an impact is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from impact_rs_trials.recordings.body_impacts import TrackedBody, impacts_of_bodies
from impact_rs_trials.recordings.experiment import Body, Plane
from impact_rs_trials.recordings.found_impacts import tracked_body
from impact_rs_trials.recordings.motion_fits import fly

GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2
CUBE = Body(mass=0.4, size=(0.1, 0.1, 0.1))
SLAB = Body(mass=0.4, size=(0.16, 0.06, 0.1))
TILTED = pin.rpy.rpyToMatrix(0.5, 0.4, 0.2)
BEFORE = np.array([0.6, -0.3, -1.4, 2.0, -1.0, 3.0])  # of the centre, m/s and rad/s
AFTER = np.array([0.4, -0.2, 0.5, -3.0, 2.0, 1.0])


def free_turn(body: Body, rotation: np.ndarray, turning: np.ndarray, time: np.ndarray) -> list[np.ndarray]:
    """Euler's equations by steps of 0.2 ms, forwards or backwards."""
    moments = body.moments
    found, w, turn, now = [], rotation.T @ turning, rotation, 0.0
    for moment in time:
        steps = max(1, int(abs(moment - now) / 2e-4))
        h = (moment - now) / steps
        for _ in range(steps):
            middle = w + 0.5 * h * np.cross(moments * w, w) / moments
            turn, w = turn @ pin.exp3(h * middle), w + h * np.cross(moments * middle, middle) / moments
        found.append(turn)
        now = moment
    return found


def toss(
    body: Body = CUBE,
    rate: float = 150.0,
    noise: float = 5e-5,
    seed: int = 0,
    impacts: int = 1,
    turn: np.ndarray = TILTED,
) -> TrackedBody:
    """Flight, an impact at a moment between two samples, and flight."""
    rng = np.random.default_rng(seed)
    time = (np.arange(-16, 26 if impacts == 2 else 17) + rng.uniform(0.2, 0.8)) / rate
    place = np.array([0.2, 0.1, 0.3])
    before, after = time[time < 0.0], time[time >= 0.0]
    turns = free_turn(body, turn, BEFORE[3:], before[::-1])[::-1] + free_turn(body, turn, AFTER[3:], after)
    places = [
        place + twist[:3] * t + 0.5 * GRAVITY * t**2
        for t, twist in [(t, BEFORE) for t in before] + [(t, AFTER) for t in after]
    ]
    position = np.array(places) + noise * rng.standard_normal((time.size, 3))
    rotation = np.array([pin.exp3(noise / 0.05 * rng.standard_normal(3)) @ one for one in turns])
    if impacts == 2:
        late = time > 14.0 / rate
        position[late] += np.outer(time[late] - 14.0 / rate, [0.0, 0.0, 0.9])
    return TrackedBody(f"toss_{seed}", time - time[0], position, rotation, GRAVITY)


@pytest.mark.parametrize(("body", "noise"), [(CUBE, 1e-5), (CUBE, 2e-4), (SLAB, 5e-5)], ids=["fine", "coarse", "slab"])
def test_both_sides_are_recovered_within_the_noise_that_is_said(body: Body, noise: float) -> None:
    runs = [toss(body, noise=noise, seed=seed) for seed in range(30)]
    found, left_out = impacts_of_bodies(runs, body)
    assert not left_out
    changes = np.array([impact.after - impact.before for impact in found]) - (AFTER - BEFORE)
    sigma = np.array([np.repeat(impact.noise, 3) for impact in found])
    # The moment of the impact is uncertain as well, and g times that is in the vertical velocities of both sides.
    each = np.sqrt(np.mean(np.square(changes / sigma), axis=0))
    np.testing.assert_allclose(each, 1.0, atol=0.45)
    for impact, run in zip(found, runs, strict=True):
        first = run.time[np.argmax(run.time >= impact.time)]
        assert abs(first - impact.time) <= 1.0 / 150.0


def test_gyroscopic_torques_are_in_the_flight_of_a_slab() -> None:
    """Without them the angular velocity of an uneven body is off by more than its noise."""
    run = toss(SLAB, noise=0.0, seed=3)
    rows = slice(20, 33)
    at = float(run.time[20])
    motions = [
        fly(run.time[rows], run.position[rows], run.rotation[rows], GRAVITY, moments, at)
        for moments in (SLAB.moments, np.ones(3))
    ]
    start = run.time[20] - run.time[np.argmax(run.time > 16.0 / 150.0)]
    assert abs(start) < 0.05
    right, wrong = (motion.scatter[1] for motion in motions)
    assert right < 0.3 * wrong


def test_a_second_impact_is_a_second_row() -> None:
    found, _ = impacts_of_bodies([toss(impacts=2, noise=1e-5)], CUBE)
    assert [impact.run for impact in found] == ["toss_0", "toss_0, impact 2"]
    np.testing.assert_allclose(found[1].after[2] - found[1].before[2], 0.9, atol=0.02)


def test_what_gives_no_row_is_said_with_the_reason() -> None:
    run = toss()
    flat = toss(turn=np.eye(3), seed=1)
    cases = {
        "recorded twice: the same heights as toss_0": [run, replace(run, run="again")],
        "edge or a face": [flat],
        "too few samples of free flight": [_cut(run, 13, 33)],
        "nothing is hit": [_cut(run, 0, 15)],
        "samples, at least": [_cut(run, 0, 8)],
        "the tracker is so noisy": [toss(noise=5e-3)],
        "the tracker does not see the impact": [_without(run, range(13, 20))],
    }
    for reason, runs in cases.items():
        _, left_out = impacts_of_bodies(runs, CUBE)
        assert any(reason in one.reason for one in left_out), (reason, left_out)


def _cut(run: TrackedBody, first: int, last: int) -> TrackedBody:
    return _without(run, [row for row in range(len(run.time)) if not first <= row < last])


def _without(run: TrackedBody, rows: object) -> TrackedBody:
    kept = [row for row in range(len(run.time)) if row not in set(rows)]  # type: ignore[call-overload]
    return replace(run, time=run.time[kept], position=run.position[kept], rotation=run.rotation[kept])


def test_a_tilted_plane_and_a_marker_off_the_centre_change_nothing() -> None:
    """The same toss, tracked at a corner in a world whose plane leans."""
    run, lean = toss(noise=0.0), pin.rpy.rpyToMatrix(0.3, -0.2, 0.0)
    place = {"position": (0.05, 0.02, -0.01), "rpy": (0.1, 0.0, 0.0)}
    body = Body.model_validate(CUBE.model_dump() | {"place": place})
    inner = body.place.placement.inverse()
    pose = []
    for position, rotation in zip(run.position, run.rotation, strict=True):
        level = pin.SE3(lean.T, np.zeros(3)) * pin.SE3(rotation, position + [0.0, 0.0, 0.7])
        pose.append(pin.SE3ToXYZQUAT(level * inner))
    normal = tuple(float(one) for one in lean.T[:, 2])
    gravity = tuple(float(one) for one in lean.T @ GRAVITY)
    seen = tracked_body("toss", run.time, np.array(pose), body, Plane(height=0.7, normal=normal, gravity=gravity))
    (plain,), (found,) = (impacts_of_bodies([one], CUBE)[0] for one in (run, seen))
    np.testing.assert_allclose(found.before[[2, 5]], plain.before[[2, 5]], atol=1e-6)
    np.testing.assert_allclose(found.position[2], plain.position[2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found.after[:3]), np.linalg.norm(plain.after[:3]), atol=1e-6)
