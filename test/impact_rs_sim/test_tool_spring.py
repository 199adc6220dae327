# SPDX-License-Identifier: Apache-2.0
"""A spring and damper between flange and pad in the twin: closed forms of impacts, balances, limits, refusals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from closed_forms import restitution_of
from twin_scene import AGAINST_Y, BOX_MASS, PERIOD, RAIL_MASS, SIZE, TOWARDS_Y, rail, resting, run, scene

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import ObjectPhysics, Physics
from impact_rs_sim.plant.bullet_mechanics import BulletMechanics
from impact_rs_sim.robots.robot import Array
from impact_rs_sim.robots.tool_spring import ToolSpring, about, is_a_spring
from impact_rs_sim.scenarios.robot_spec import ToolCompliance
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import validate
from impact_rs_sim.shapes import SPHERE
from impact_rs_sim.twin import Result

SPEED = 0.5  # m/s
FACE = -SIZE[1] / 2.0  # m, where the box has its face along y
STIFFNESS = 4e4  # N/m
REDUCED = RAIL_MASS * BOX_MASS / (RAIL_MASS + BOX_MASS)  # kg
BALL = ObjectPhysics(math.inf, np.full(3, 0.16), np.full(3, math.inf), np.zeros(3), SPHERE)


def spring(diagonal: list[float], lag: float = 0.0) -> ToolSpring | None:
    """A spring about the origin of E."""
    return ToolSpring.of(np.diag(diagonal), lag)


def along(compliance: float, lag: float = 0.0) -> ToolSpring | None:
    """A spring along the pad's normal."""
    return spring([0.0, 0.0, compliance, 0.0, 0.0, 0.0], lag)


def hit(tool: ToolSpring | None, lever: float = 0.0, **changes: Any) -> Physics:
    """A rail towards the face of the box, or of another object, ``lever`` beside its middle [m]."""
    pad = {"pad_stiffness": None, **changes.pop("pad", {})}
    return scene({"rail": rail(np.array([lever, FACE, 0.0]), TOWARDS_Y, tool_spring=tool, **pad)}, **changes)


def energy(found: Result, tick: int) -> float:
    """Kinetic energy of rail and box [J]."""
    twist, quaternion = found.twists[tick], found.poses[tick, 3:]
    axes = pin.Quaternion(quaternion).matrix()
    moments = BOX_MASS / 12.0 * (np.sum(np.square(SIZE)) - np.square(SIZE))
    turning = axes.T @ twist[3:]
    rail_speed = found.arms["rail"].velocity[tick, 0]
    return float(RAIL_MASS * rail_speed**2 + BOX_MASS * twist[:3] @ twist[:3] + moments @ np.square(turning)) / 2.0


@pytest.mark.parametrize("pad_stiffness", [None, 6e4])
def test_two_masses_part_after_half_a_period_of_the_springs_in_series(pad_stiffness: float | None) -> None:
    """T = pi sqrt(m C), C = 1/k + 1/k_pad, elastic. Kills a spring in parallel with the pad, an implicit spring."""
    compliance = 1.0 / STIFFNESS + (0.0 if pad_stiffness is None else 1.0 / pad_stiffness)
    found = run(hit(along(1.0 / STIFFNESS), pad={"pad_stiffness": pad_stiffness}), [SPEED], resting(), 0.06)
    rail_speed, box_speed = found.arms["rail"].velocity[:, 0], found.twists[:, 1]
    assert rail_speed[-1] == pytest.approx((RAIL_MASS - BOX_MASS) / (RAIL_MASS + BOX_MASS) * SPEED, abs=3e-3 * SPEED)
    assert box_speed[-1] == pytest.approx(2.0 * RAIL_MASS / (RAIL_MASS + BOX_MASS) * SPEED, abs=3e-3 * SPEED)
    np.testing.assert_allclose(RAIL_MASS * rail_speed + BOX_MASS * box_speed, RAIL_MASS * SPEED, atol=1e-8)
    assert energy(found, -1) == pytest.approx(energy(found, 0), rel=5e-3)
    changes = np.abs(np.diff(rail_speed))
    duration = PERIOD * np.count_nonzero(changes > 0.02 * changes.max())
    assert duration == pytest.approx(math.pi * math.sqrt(REDUCED * compliance), abs=3.0 * PERIOD)


@pytest.mark.parametrize("ratio", [0.05, 0.2, 0.6])
def test_the_damper_of_a_tool_takes_what_a_spring_and_damper_take(ratio: float) -> None:
    """e of a mass on spring and damper that part at force zero; kills a damper of half or twice the lag."""
    lag = 2.0 * ratio * math.sqrt(REDUCED / STIFFNESS)
    found = run(hit(along(1.0 / STIFFNESS, lag)), [SPEED], resting(), 0.06)
    e = restitution_of(ratio)
    assert found.twists[-1, 1] - found.arms["rail"].velocity[-1, 0] == pytest.approx(e * SPEED, abs=0.01 * SPEED)


def test_a_blow_beside_the_axis_tilts_the_pad() -> None:
    """On a fixed ball at the lever r the spring has C_zz + r^2 C_rot: depth v sqrt(m C)."""
    lever, turns = 0.03, 0.02  # m, rad/(N m)
    compliance = 1.0 / STIFFNESS + lever**2 * turns
    tool = spring([0.0, 0.0, 1.0 / STIFFNESS, 0.0, turns, 0.0])
    found = run(hit(tool, lever, object=BALL), [0.1], resting(), 0.08, refinement=4)
    depth = found.arms["rail"].position[:, 0].max()
    assert depth == pytest.approx(0.1 * math.sqrt(RAIL_MASS * compliance), rel=0.02)
    assert found.arms["rail"].velocity[-1, 0] == pytest.approx(-0.1, rel=0.02)


def test_two_soft_tools_stop_a_box_between_them() -> None:
    """Each rail turns back after pi sqrt(m C) of its own spring; kills the place of one arm's spring in another's."""
    compliances = {"left": 1.0 / STIFFNESS, "right": 4.0 / STIFFNESS}
    places = {"left": (FACE, TOWARDS_Y), "right": (-FACE, AGAINST_Y)}
    arms = {
        name: rail(np.array([0.0, *places[name][:1], 0.0]), places[name][1], pad_stiffness=None, tool_spring=along(c))
        for name, c in compliances.items()
    }
    heavy = replace(BALL, size=SIZE, shape=hit(None).object.shape)
    found = run(scene(arms, object=heavy), [SPEED, SPEED], resting(), 0.08)
    for name, compliance in compliances.items():
        position, velocity = found.arms[name].position[:, 0], found.arms[name].velocity[:, 0]
        assert position.max() == pytest.approx(SPEED * math.sqrt(RAIL_MASS * compliance), rel=5e-3)
        assert velocity[-1] == pytest.approx(-SPEED, rel=5e-3)
        turned_back = PERIOD * np.argmax(velocity < 0.0)
        assert turned_back == pytest.approx(math.pi / 2.0 * math.sqrt(RAIL_MASS * compliance), abs=2.0 * PERIOD)


def any_compliance(seed: int) -> Array:
    """A full compliance matrix, some 1e-5 m/N and 1e-3 rad/(N m)."""
    root = np.random.default_rng(seed).standard_normal((6, 6)) / math.sqrt(6.0)
    scale = np.array([5e-3] * 3 + [0.03] * 3)
    return np.asarray((scale[:, None] * root) @ (scale[:, None] * root).T)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_any_spring_keeps_momentum_and_a_damped_one_gains_no_energy(seed: int, friction: float) -> None:
    """Along the rail, and E = const without damper and friction; kills an asymmetric block of the step's equations."""
    for lag in (0.0, 2e-4):
        tool = ToolSpring.of(any_compliance(seed), lag)
        physics = hit(tool, 0.02, pad_friction=friction, pad={"pad_stiffness": 2e5})
        found = run(physics, [SPEED], resting(), 0.06, refinement=4)
        rail_speed, box_speed = found.arms["rail"].velocity[:, 0], found.twists[:, 1]
        np.testing.assert_allclose(RAIL_MASS * rail_speed + BOX_MASS * box_speed, RAIL_MASS * SPEED, atol=1e-8)
        assert energy(found, -1) < 1.005 * energy(found, 0)
        if lag == friction == 0.0:
            assert energy(found, -1) > 0.995 * energy(found, 0)
        assert box_speed[-1] > rail_speed[-1]


def test_a_stiff_tool_is_the_rigid_one() -> None:
    damped = {"pad_stiffness": 2e5, "pad_damping": 300.0}
    stiff, rigid = (
        run(hit(tool, 0.03, pad_friction=0.4, pad=damped), [SPEED], resting(), 0.04)
        for tool in (ToolSpring.of(1e-6 * any_compliance(0), 1e-4), None)
    )
    np.testing.assert_allclose(stiff.twists, rigid.twists, atol=2e-4 * SPEED)
    np.testing.assert_allclose(stiff.arms["rail"].velocity, rigid.arms["rail"].velocity, atol=2e-4 * SPEED)
    assert spring([0.0] * 6) is None


def test_a_tool_pressed_on_a_wall_rests_where_force_times_compliance_leave_it() -> None:
    """Kills half the spring's force; the damper brings it to rest."""
    wall = replace(BALL, size=SIZE, shape=hit(None).object.shape)
    compliance, force, lag = 1e-4, 40.0, 2e-2
    found = run(hit(along(compliance, lag), object=wall), [0.0], resting(), 0.6, force=force)
    assert found.arms["rail"].position[-1, 0] == pytest.approx(force * compliance, rel=1e-3)


def test_compliance_matrices_have_their_rank_and_come_back() -> None:
    for rank in range(1, 7):
        root = np.random.default_rng(rank).standard_normal((6, rank)) * np.array([[1e-3]] * 3 + [[0.1]] * 3)
        tool = ToolSpring.of(root @ root.T, 0.0)
        assert tool is not None and len(tool.motions) == rank
        np.testing.assert_allclose(tool.compliance, root @ root.T, rtol=1e-6, atol=1e-12)


def test_a_beam_has_its_elastic_centre_in_the_middle() -> None:
    """Tip of a cantilever: L^3/3EI, L^2/2EI, L/EI (Timoshenko), from L^3/12EI and L/EI at L/2; kills the sign of c."""
    length, bending = 0.3, 50.0  # m, N m^2
    middle = np.diag([length**3 / 12.0 / bending, 0.0, 0.0, 0.0, length / bending, 0.0])
    tip = about(middle, np.array([0.0, 0.0, -length / 2.0]))
    assert tip[0, 0] == pytest.approx(length**3 / 3.0 / bending)
    assert tip[0, 4] == tip[4, 0] == pytest.approx(length**2 / 2.0 / bending)  # +x turns +z towards +x, about +y
    assert tip[4, 4] == pytest.approx(length / bending)


PUSH = load_scenario("push").model_dump(mode="json")


def with_compliance(compliance: dict[str, Any]) -> dict[str, Any]:
    """The scenario push with a compliant tool."""
    arm = PUSH["robots"]["arm"]
    return PUSH | {"robots": {"arm": arm | {"end_effector": arm["end_effector"] | {"compliance": compliance}}}}


def rows(*changes: tuple[int, int, float]) -> list[list[float]]:
    """A matrix of ones with some entries changed."""
    found = np.eye(6)
    for i, j, value in changes:
        found[i, j] = value
    return np.asarray(found).tolist()


@pytest.mark.parametrize(
    ("compliance", "complaint"),
    [
        ({"diagonal": [1e-5, 0, 0, 0, 0, -1e-3]}, "compliance.*diagonal: an entry is below 0"),
        ({"matrix": rows((0, 4, 0.5))}, "compliance.*matrix: not symmetric"),
        ({"matrix": rows((0, 4, 2.0), (4, 0, 2.0))}, "an eigenvalue below 0"),
        ({"matrix": rows((0, 0, 0.0), (0, 4, 0.1), (4, 0, 0.1))}, "an eigenvalue below 0"),
        ({}, "compliance.*expected one of both"),
        ({"diagonal": [0.0] * 6, "matrix": rows()}, "expected one of both"),
        ({"diagonal": [0.0] * 5}, "compliance.diagonal"),
        ({"diagonal": [0.0] * 6, "lag": -1.0}, "compliance.lag"),
    ],
)
def test_what_is_no_spring_is_refused_with_its_key(compliance: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        validate(type(load_scenario("push")), with_compliance(compliance), "mine.yaml")


def test_a_scenario_gives_its_spring_to_the_twin_and_bullet_refuses_it() -> None:
    """About the origin of E; files without the key are written without it."""
    assert "compliance" not in PUSH["robots"]["arm"]["end_effector"]
    given = {"diagonal": [1e-5, 1e-5, 1e-6, 1e-3, 1e-3, 0.0], "centre": [0.0, 0.0, -0.08], "lag": 1e-3}
    scenario = validate(type(load_scenario("push")), with_compliance(given), "mine.yaml")
    physics = Physics.nominal(scenario, next(iter(scenario.objects)))
    tool = physics.arms["arm"].tool_spring
    assert tool is not None and tool.lag == 1e-3 and is_a_spring(tool.compliance)
    assert tool.compliance[0, 0] == pytest.approx(1e-5 + 0.08**2 * 1e-3)
    with pytest.raises(InputError, match=r"robots.arm.end_effector.compliance.*--plant twin"):
        BulletMechanics.load(physics, PERIOD)
    assert ToolCompliance(diagonal=(0.0,) * 6).build() is None
