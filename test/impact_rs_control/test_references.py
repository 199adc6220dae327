# SPDX-License-Identifier: Apache-2.0
"""References: smooth, coincident at T_nom, extended past it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_control.references import (
    ViaPoint,
    ante_impact_path,
    carry_path,
    excursion_path,
    post_impact_path,
    run_up_path,
    sample_path,
)
from impact_rs_sim.scenarios.scenario_files import load_scenario

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


def test_outside_its_via_points_a_path_goes_straight_on():
    start, end = (ViaPoint(time, POSITION, VELOCITY, np.ones(3)) for time in (0.5, 1.0))
    path = sample_path([start, end], np.array([0.2, 0.5, 1.0, 1.4]))
    np.testing.assert_allclose(path.velocity, np.broadcast_to(VELOCITY, (4, 3)), atol=1e-9)
    np.testing.assert_allclose(path.acceleration, np.outer([0.0, 1.0, 1.0, 0.0], np.ones(3)), atol=1e-6)
    np.testing.assert_allclose(path.position[3] - path.position[2], 0.4 * VELOCITY, atol=1e-9)


def smooth_step(share):
    """Velocity of a quintic from rest that covers half of velocity times duration, over that velocity."""
    return 3.0 * share**2 - 2.0 * share**3


def test_the_approach_is_a_smooth_step_in_velocity_from_rest(timing):
    """Half of velocity times duration: the quintic's velocity is then 3 s^2 - 2 s^3, without overshoot."""
    start = timing.nominal_impact - timing.approach
    share = np.linspace(0.0, 1.0, 50)
    path = ante_impact_path(timing, POSITION, VELOCITY, start + share * timing.approach)
    np.testing.assert_allclose(path.velocity, np.outer(smooth_step(share), VELOCITY), atol=1e-9)
    np.testing.assert_allclose(POSITION - path.position[0], VELOCITY * timing.approach / 2.0, atol=1e-12)
    before = ante_impact_path(timing, POSITION, VELOCITY, np.array([0.0, start]))
    np.testing.assert_allclose(before.position[0], before.position[1], atol=1e-12)
    np.testing.assert_allclose(before.velocity, 0.0, atol=1e-12)


def test_the_reference_goes_on_for_the_overrun_and_stops_as_smoothly(timing):
    share = np.linspace(0.0, 1.0, 30)
    end = timing.nominal_impact + timing.overrun
    path = ante_impact_path(timing, POSITION, VELOCITY, end + share * timing.stop)
    np.testing.assert_allclose(path.position[0], POSITION + VELOCITY * timing.overrun, atol=1e-12)
    np.testing.assert_allclose(path.velocity, np.outer(smooth_step(1.0 - share), VELOCITY), atol=1e-9)


def test_the_push_ends_at_rest_after_half_of_velocity_times_duration(timing):
    share = np.linspace(0.0, 1.0, 30)
    path = post_impact_path(timing, POSITION, VELOCITY, timing.nominal_impact + share * timing.push)
    np.testing.assert_allclose(path.velocity, np.outer(smooth_step(1.0 - share), VELOCITY), atol=1e-9)
    np.testing.assert_allclose(path.position[-1], POSITION + VELOCITY * timing.push / 2.0, atol=1e-12)


def test_a_pad_follows_the_common_motion_without_displacement(timing):
    """Along the axis: the mean of the pads, for the whole push; across it: the mean's slide; the rest: gone again."""
    up, normal = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    velocity, common = np.array([0.10, 0.02, 0.36]), np.array([0.06, 0.05, 0.34])
    path = carry_path(timing, POSITION, velocity, common, up, normal, np.array([timing.duration]))
    expected = POSITION + [0.06 * timing.slide / 2.0, 0.0, 0.34 * timing.push / 2.0]
    np.testing.assert_allclose(path.position[0], expected, atol=1e-12)


def test_there_and_back_rests_at_both_ends_and_peaks_half_way(timing):
    """A quintic from rest to rest peaks at 15/8 of its mean speed."""
    start, end = np.array([0.1, 0.0]), np.array([0.4, -0.2])
    times = np.array([0.0, 0.2, 0.45, 0.7, 0.8, 0.9, 1.15, 1.4, 2.0])
    path = excursion_path(0.2, 0.5, 0.2, start, end, times)
    for row, place in ((0, start), (1, start), (3, end), (4, end), (5, end), (7, start), (8, start)):
        np.testing.assert_allclose(path.position[row], place, atol=1e-12)
        np.testing.assert_allclose(path.velocity[row], 0.0, atol=1e-9)
    np.testing.assert_allclose(path.velocity[2], 15.0 / 8.0 * (end - start) / 0.5, atol=1e-9)
    np.testing.assert_allclose(path.velocity[6], -path.velocity[2], atol=1e-9)
    turning = excursion_path(0.2, 0.5, 0.0, start, end, np.array([0.7, 1.2]))
    np.testing.assert_allclose(turning.position, [end, start], atol=1e-12)


def test_a_run_up_joins_the_post_path_before_the_measure_begins(timing):
    times = np.arange(round(timing.duration / 1e-3) + 1) * 1e-3
    post = post_impact_path(timing, POSITION, VELOCITY, times)
    path = run_up_path(timing, post, times)
    window = (times >= timing.nominal_impact - timing.window_before - 1e-9) & (times < timing.nominal_impact)
    np.testing.assert_allclose(path.velocity[window], np.broadcast_to(VELOCITY, (window.sum(), 3)), atol=1e-9)
    np.testing.assert_allclose(
        path.position[window], POSITION + np.outer(times[window] - timing.nominal_impact, VELOCITY), atol=1e-9
    )
    still = times < timing.nominal_impact - timing.approach
    np.testing.assert_allclose(path.velocity[still], 0.0, atol=1e-12)
    after = times >= timing.nominal_impact
    np.testing.assert_array_equal(path.position[after], post.position[after])
    np.testing.assert_allclose(np.gradient(path.position, times, axis=0), path.velocity, atol=2e-3)
