# SPDX-License-Identifier: Apache-2.0
"""The impact map of one measured impact: closed forms of a free body, and the planned map where poses are exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impact_map_cases import SCENE
from impact_table_cases import MASS, SIZE, UP, cube, tossed

from impact_rs_sim.effects import library
from impact_rs_sim.errors import Infeasible
from impact_rs_sim.impact_map import ImpactProblem, compute_impact_map
from impact_rs_sim.impact_map.measured import (
    PAD_REACH,
    MeasuredImpact,
    MeasuredImpacts,
    points_of_scene,
    points_on_plane,
    points_that_touch,
    restitution_of,
    solve_measured,
)
from impact_rs_sim.impact_map.problem import EnergyGain
from impact_rs_sim.scene import BodyState

INERTIA = MASS * 0.01 / 6.0  # kg m^2
LEVER = np.array([0.0, 0.0, -0.05])  # m, from the centre to a contact point below it


def on_its_middle(twist: list[float]) -> MeasuredImpact:
    """A body that touches the plane right below its centre."""
    body = BodyState(np.array([0.3, -0.2, 0.05]), np.eye(3), np.array(twist))
    return MeasuredImpact({}, body, points_on_plane([body.position + LEVER], UP))


def energy(velocity: np.ndarray, inertia: np.ndarray) -> float:
    """Kinetic energy [J]."""
    return 0.5 * float(velocity @ inertia @ velocity)


@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0])
def test_a_central_impact_throws_back_with_minus_e_times_the_speed(restitution: float) -> None:
    after, _ = solve_measured(cube(0.7, restitution), on_its_middle([0.0, 0.0, -1.3, 0.0, 0.0, 0.0]))
    assert after == pytest.approx([0.0, 0.0, 1.3 * restitution, 0.0, 0.0, 0.0], abs=1e-6)


def test_a_measured_impact_that_gains_energy_is_refused_unless_a_fit_asks() -> None:
    """Newton's law with e = 0.9 on a corner that sticks: Kane's paradox, of one free body."""
    body = BodyState(np.array([0.0, 0.0, 0.0845]), np.eye(3), np.array([0.2, 0.0, 0.04, 0.0, -25.0, 0.0]))
    impact = MeasuredImpact({}, body, points_on_plane([body.position + np.array([-0.0984, 0.0, -0.0845])], UP))
    after, system = solve_measured(cube(2.0, 0.9), impact, may_gain_energy=True)
    assert energy(after, system.inertia) > energy(system.velocity, system.inertia)
    with pytest.raises(EnergyGain, match="restitution e = 0.9"):
        solve_measured(cube(2.0, 0.9), impact)
    solve_measured(cube(2.0, 0.0), impact)


@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_sliding_friction_is_mu_times_the_normal_impulse(restitution: float) -> None:
    """L_n = m (1 + e) |v_n|, L_t = mu L_n against sliding; dv = L / m, domega = r x L / I."""
    friction, fall = 0.1, 1.2
    after, _ = solve_measured(cube(friction, restitution), on_its_middle([2.0, 0.0, -fall, 0.0, 0.0, 0.0]))
    normal = MASS * (1.0 + restitution) * fall
    impulse = np.array([-friction * normal, 0.0, normal])
    assert after[:3] == pytest.approx(np.array([2.0, 0.0, -fall]) + impulse / MASS, abs=1e-6)
    assert after[3:] == pytest.approx(np.cross(LEVER, impulse) / INERTIA, abs=1e-5)


def test_much_friction_stops_the_contact_point() -> None:
    impact = on_its_middle([0.5, 0.2, -1.0, 0.0, 0.0, 3.0])
    after, _ = solve_measured(cube(5.0), impact)
    assert after[:3] + np.cross(after[3:], LEVER) == pytest.approx(np.zeros(3), abs=1e-6)


def test_without_friction_nothing_happens_along_the_plane() -> None:
    impact = tossed(np.random.default_rng(3))
    after, _ = solve_measured(cube(0.0, 0.3), impact)
    assert after[:2] == pytest.approx(impact.object.twist[:2], abs=1e-6)


@pytest.mark.parametrize(("friction", "restitution"), [(0.0, 1.0), (0.0, 0.5), (0.3, 0.0), (1.5, 0.0)])
def test_energy_never_grows(friction: float, restitution: float) -> None:
    """Without friction, or without restitution; with both, Newton's law may let it grow."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        after, system = solve_measured(cube(friction, restitution), impact := tossed(rng))
        assert energy(after, system.inertia) <= energy(impact.object.twist, system.inertia) * (1.0 + 1e-6)


def test_a_fixed_plane_does_not_know_how_heavy_the_body_is() -> None:
    impact, physics = tossed(np.random.default_rng(6)), cube(0.3, 0.2)
    heavier = library()["object_mass"].apply_vector(physics, np.array([2.0]))
    assert solve_measured(heavier, impact)[0] == pytest.approx(solve_measured(physics, impact)[0], abs=1e-6)


def test_restitution_stays_between_none_and_all_of_it() -> None:
    effect = library()["restitution"]
    assert restitution_of(effect.apply_vector(cube(restitution=0.2), np.array([0.3]))) == pytest.approx(0.5)
    assert np.concatenate(effect.bounds(cube(restitution=0.2))) == pytest.approx([-0.2, 0.8])
    assert np.concatenate(effect.bounds(cube())) == pytest.approx([0.0, 1.0])
    assert restitution_of(replace(cube(), bounce=1.7)) == 1.0
    assert restitution_of(replace(cube(), bounce=-0.1)) == 0.0


def test_a_bounce_is_of_one_impact_and_not_of_a_push_that_goes_on() -> None:
    bounced = library()["restitution"].apply_vector(SCENE.physics, np.array([0.4]))
    assert restitution_of(bounced) == pytest.approx(SCENE.physics.restitution + 0.4)
    assert ImpactProblem.at_nominal_impact(replace(SCENE, physics=bounced)).restitution == SCENE.physics.restitution


def test_corner_edge_and_face_touch_with_one_two_and_four_corners() -> None:
    def count(turn: np.ndarray) -> int:
        return len(points_that_touch(BodyState(np.zeros(3), turn, np.zeros(6)), SIZE, UP))

    c, s = np.cos(0.3), np.sin(0.3)
    edge = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    corner = edge @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    assert [count(turn) for turn in (corner, edge, np.eye(3))] == [1, 2, 4]


def test_at_an_exact_pose_it_is_the_planned_map() -> None:
    points = points_of_scene(SCENE.physics, SCENE.arms, SCENE.object, SCENE.models)
    after, system = solve_measured(SCENE.physics, MeasuredImpact(SCENE.arms, SCENE.object, points))
    planned = compute_impact_map(ImpactProblem.at_nominal_impact(SCENE), "exact")
    joints, _, twist = system.split(after)
    assert joints["arm"] == pytest.approx(planned.joint_velocity["arm"], abs=1e-4)
    assert twist == pytest.approx(planned.object_twist, abs=1e-4)


@pytest.mark.parametrize("off", [-0.004, 0.004])  # m
def test_bodies_that_seem_to_overlap_or_to_stay_apart_touch_all_the_same(off: float) -> None:
    moved = replace(SCENE.object, position=SCENE.object.position + [0.0, off, 0.0])
    points = points_of_scene(SCENE.physics, SCENE.arms, moved, SCENE.models)
    exact = points_of_scene(SCENE.physics, SCENE.arms, SCENE.object, SCENE.models)
    assert [point.partner for point in points] == [point.partner for point in exact]


def test_a_pad_that_is_far_off_hits_nothing() -> None:
    far = replace(SCENE.object, position=SCENE.object.position + [0.0, -2.0 * PAD_REACH, 0.0])
    with pytest.raises(
        Infeasible, match=r"no pad touches the object: the nearest is 40 mm away, expected at most 20 mm"
    ):
        points_of_scene(SCENE.physics, SCENE.arms, far, SCENE.models)


@pytest.mark.parametrize("hidden", [{"friction": 0.3}, {"restitution": 0.5}, {"friction": 0.9, "restitution": 0.2}])
def test_beginning_at_impulses_of_other_physics_changes_no_answer_and_saves_steps(hidden: dict[str, float]) -> None:
    """Cubes on their corners, edges and faces: the laws have one answer, wherever Newton's method begins."""
    rng = np.random.default_rng(2)
    impacts = [tossed(rng) for _ in range(40)]
    flat = BodyState(np.array([0.0, 0.0, 0.05]), np.eye(3), np.array([0.4, 0.1, -1.0, 0.0, 0.3, 0.2]))
    impacts.append(MeasuredImpact({}, flat, points_that_touch(flat, SIZE, UP)))
    other = [cube(**hidden)] * len(impacts)
    near = MeasuredImpacts(impacts, other)
    near.solve([cube()] * len(impacts))
    resumed, few = near.solve(other)
    alone, many = MeasuredImpacts(impacts, other).solve(other)
    assert resumed == pytest.approx(alone, abs=1e-8)
    assert few.steps.mean() < 0.7 * many.steps.mean()
