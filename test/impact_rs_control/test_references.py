"""References: smooth, coincident at T_nom, extended past it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_control.references import ViaPoint, ante_impact_path, carry_path, post_impact_path, sample_path
from impact_rs_sim.scenario import load_scenario

POSITION = np.array([0.4, -0.1, 0.5])
VELOCITY = np.array([0.0, -0.7, 0.05])
NORMAL = np.array([0.0, -1.0, 0.0])


@pytest.fixture(scope="module")
def timing():
    return load_scenario("push").timing


def finite(low, high):
    return st.floats(low, high, allow_nan=False)


vectors = st.lists(finite(-2.0, 2.0), min_size=3, max_size=3).map(np.array)


@given(st.lists(st.tuples(vectors, vectors, vectors), min_size=2, max_size=4))
def test_path_meets_position_velocity_and_acceleration_at_every_via_point(points):
    times = 0.3 + 0.5 * np.arange(len(points))
    path = sample_path([ViaPoint(t, *point) for t, point in zip(times, points, strict=True)], times)
    for row, (position, velocity, acceleration) in enumerate(points):
        np.testing.assert_allclose(path.position[row], position, atol=1e-9)
        np.testing.assert_allclose(path.velocity[row], velocity, atol=1e-8)
        np.testing.assert_allclose(path.acceleration[row], acceleration, atol=1e-6)


def test_velocity_and_acceleration_are_derivatives_of_position_everywhere(timing):
    times = np.arange(0.0, 1.8, 1e-4)
    for path in (
        ante_impact_path(timing, POSITION, VELOCITY, times),
        post_impact_path(timing, POSITION, VELOCITY, times),
        carry_path(timing, POSITION, VELOCITY, 0.9 * VELOCITY, NORMAL, NORMAL, times),
    ):
        np.testing.assert_allclose(np.gradient(path.position, times, axis=0), path.velocity, atol=2e-3)
        change = np.gradient(path.velocity, times, axis=0)
        jumps = np.abs(change - path.acceleration).max(axis=1) > 0.05
        assert jumps.sum() <= 4  # acceleration itself is continuous but has kinks at via points


def test_references_coincide_at_nominal_impact_and_their_velocities_jump(timing):
    """Paper eq. pos_refs_imp."""
    at_impact = np.array([timing.nominal_impact])
    after = np.array([0.01, -0.55, 0.0])
    ante = ante_impact_path(timing, POSITION, VELOCITY, at_impact)
    post = carry_path(timing, POSITION, after, 0.9 * after, NORMAL, NORMAL, at_impact)
    np.testing.assert_allclose(ante.position, post.position, atol=1e-12)
    np.testing.assert_allclose(ante.velocity[0], VELOCITY, atol=1e-12)
    np.testing.assert_allclose(post.velocity[0], after, atol=1e-12)


def test_both_references_go_on_where_the_other_is_nominally_active(timing):
    nominal = timing.nominal_impact
    late = ante_impact_path(timing, POSITION, VELOCITY, np.array([nominal + 0.05]))
    early = post_impact_path(timing, POSITION, VELOCITY, np.array([nominal - 0.05]))
    np.testing.assert_allclose(late.velocity[0], VELOCITY, atol=1e-9)
    np.testing.assert_allclose(late.position[0], POSITION + 0.05 * VELOCITY, atol=1e-9)
    np.testing.assert_allclose(early.velocity[0], VELOCITY, atol=1e-12)
    np.testing.assert_allclose(early.position[0], POSITION - 0.05 * VELOCITY, atol=1e-12)


def test_arm_that_hits_nothing_comes_to_rest(timing):
    end = ante_impact_path(timing, POSITION, VELOCITY, np.array([timing.duration, timing.duration + 1.0]))
    np.testing.assert_allclose(end.velocity, 0.0, atol=1e-9)
    np.testing.assert_allclose(end.position[0], end.position[1], atol=1e-9)


def test_sliding_across_the_face_ends_long_before_the_push(timing):
    after = np.array([0.08, -0.55, -0.02])
    path = carry_path(timing, POSITION, after, after, NORMAL, NORMAL, np.array([timing.nominal_impact + timing.slide]))
    np.testing.assert_allclose(path.velocity[0, [0, 2]], 0.0, atol=1e-9)
    assert path.velocity[0, 1] < -0.3


def test_pads_that_hold_an_object_end_at_its_faces_and_rise_together(timing):
    up, left, right = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])
    velocities = {"left": np.array([0.10, 0.02, 0.36]), "right": np.array([0.06, -0.01, 0.34])}
    common = np.mean(list(velocities.values()), axis=0)
    times = np.array([timing.nominal_impact, timing.nominal_impact + timing.slide, timing.duration])
    paths = {
        name: carry_path(timing, POSITION, velocities[name], common, up, normal, times)
        for name, normal in (("left", left), ("right", right))
    }
    for name, path in paths.items():
        np.testing.assert_allclose(path.velocity[0], velocities[name], atol=1e-12)
        np.testing.assert_allclose(path.position[1:, 1], POSITION[1], atol=1e-12)
    np.testing.assert_allclose(paths["left"].position[1:], paths["right"].position[1:], atol=1e-12)
    assert np.all(paths["left"].position[-1, 2] > POSITION[2] + 0.1)
