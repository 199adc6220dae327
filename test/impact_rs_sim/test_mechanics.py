# SPDX-License-Identifier: Apache-2.0
"""Bullet and the twin as plants: an object rests only where its support holds it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from twin_scene import AGAINST_Y, PERIOD, SIZE, rail, scene

from impact_rs_sim.drive import DriveStart
from impact_rs_sim.mechanics import Mechanics, Simulator
from impact_rs_sim.physics import Physics
from impact_rs_sim.plant import SIMULATORS
from impact_rs_sim.robot import Array
from impact_rs_sim.robot_model import STANDARD_GRAVITY
from impact_rs_sim.scene import ArmState, BodyState
from impact_rs_sim.twin import rests

G = 9.81  # m/s^2
TABLE = 0.4  # m
STANDS = TABLE + SIZE[2] / 2.0  # m, the middle of the box
TICK = 4  # periods of the torque loop
EDGE = 1.0  # m, end of the table along x
BOTH = pytest.mark.parametrize("simulator", ["bullet", "twin"])


def table(**changes: object) -> Physics:
    """A box on a table, and a rail far away."""
    far = rail(np.array([0.0, 9.0, 5.0]), AGAINST_Y)
    values = {"support_height": TABLE, "gravity": np.array(STANDARD_GRAVITY)} | changes
    return scene({"rail": far}, **values)


def box(height: float = STANDS, x: float = 0.0, tilt: float = 0.0) -> BodyState:
    """At rest, with its middle at ``x`` and ``height`` [m], turned about y [rad]."""
    return BodyState(np.array([x, 0.0, height]), pin.rpy.rpyToMatrix(0.0, tilt, 0.0), np.zeros(6))


def on_its_edge(tilt: float) -> BodyState:
    """Turned about the edge on which it stands."""
    return box(TABLE + (SIZE[0] * np.sin(tilt) + SIZE[2] * np.cos(tilt)) / 2.0, tilt=tilt)


@contextmanager
def started(simulator: Simulator, physics: Physics, state: BodyState) -> Iterator[Mechanics]:
    mechanics = SIMULATORS[simulator].load(physics, PERIOD)
    still = np.zeros(1)
    mechanics.start({"rail": ArmState(still, still)}, {"rail": DriveStart(still, still)}, state)
    yield mechanics
    mechanics.close()


def heights(simulator: Simulator, physics: Physics, state: BodyState, seconds: float) -> Array:
    """Of the middle of the box above where it starts, after every tick, ``(k,)`` [m]."""
    found = []
    with started(simulator, physics, state) as mechanics:
        for tick in range(round(seconds / (TICK * PERIOD))):
            mechanics.step({"rail": np.zeros(1)}, TICK, tick * TICK * PERIOD)
            found.append(mechanics.object_state().position[2] - state.position[2])
    return np.array(found)


def stays(sinks: Array) -> bool:
    """Whether the box does not move at all; Bullet's solver goes once to within its tolerance."""
    return bool(np.ptp(sinks) == 0.0 and abs(sinks[0]) < 1e-9)


@BOTH
def test_a_box_in_the_air_falls_by_half_g_t_squared(simulator: Simulator) -> None:
    """From 200 mm above the table, which it reaches after 0.202 s; a step of first order is half a step off in t."""
    fallen = heights(simulator, table(), box(STANDS + 0.2), 0.19)
    time = np.arange(1, fallen.size + 1) * TICK * PERIOD
    assert np.all(np.abs(fallen + 0.5 * G * time**2) <= 0.51 * G * time * PERIOD)
    assert heights(simulator, table(), box(STANDS + 0.2), 0.4)[-1] == pytest.approx(-0.2, abs=0.03)


@BOTH
def test_a_box_on_its_edge_tips_over(simulator: Simulator) -> None:
    """About the edge, with (I + m r^2) dw = m g times the lever; the middle sinks by the lever times the angle."""
    tilt, seconds = np.deg2rad(20.0), 0.05
    state, corner = on_its_edge(tilt), np.array([SIZE[0], 0.0, SIZE[2]]) / 2.0
    lever = SIZE[0] / 2.0 * np.cos(tilt) - SIZE[2] / 2.0 * np.sin(tilt)
    physics = table(support_friction=2.0)
    about_edge = physics.object.inertia[1] + physics.object.mass * (corner @ corner)
    sunk = 0.5 * physics.object.mass * G * lever**2 / about_edge * seconds**2
    assert heights(simulator, physics, state, seconds)[-1] == pytest.approx(-sunk, rel=0.06)


@BOTH
@pytest.mark.parametrize("beyond", [-0.02, 0.02])
def test_a_box_falls_off_the_table_once_its_centre_of_mass_is_beyond_the_end(
    simulator: Simulator, beyond: float
) -> None:
    sinks = heights(simulator, table(), box(x=EDGE + beyond), 0.3)
    assert sinks[-1] < -0.02 if beyond > 0.0 else stays(sinks)


@BOTH
def test_a_box_falls_where_its_centre_of_mass_is_beyond_the_end_whatever_its_middle(simulator: Simulator) -> None:
    heavy_side = table()
    heavy_side = replace(heavy_side, object=replace(heavy_side.object, com_offset=np.array([0.04, 0.0, 0.0])))
    assert heights(simulator, heavy_side, box(x=EDGE - 0.02), 0.3)[-1] < -0.02
    assert stays(heights(simulator, heavy_side, box(x=EDGE - 0.06), 0.1))


@BOTH
def test_a_box_that_stands_does_not_move_at_all(simulator: Simulator) -> None:
    assert stays(heights(simulator, table(), box(), 0.1))
    compliant = table(support_compliance=1e-4)  # its weight presses the surface down to where it stands
    assert stays(heights(simulator, compliant, box(), 0.1))


def test_what_rests_follows_the_line_of_gravity() -> None:
    """A tall box on a slope whose friction holds it: it tips where gravity leaves its foot, at tan = width / height."""
    tall = table(support_friction=2.0)
    size = np.array([0.1, 0.1, 0.4])
    tall = replace(tall, object=replace(tall.object, size=size))
    state = box(TABLE + 0.2)
    for slope, holds in ((0.2, True), (0.24, True), (0.26, False), (-0.24, True), (-0.26, False)):
        leaning = replace(tall, gravity=np.array([slope * G, 0.0, -G]))
        assert rests(leaning, state) is holds


def test_nothing_rests_that_moves_slides_floats_or_has_no_support() -> None:
    assert rests(table(), box())
    assert not rests(table(), replace(box(), twist=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-9])))
    assert not rests(table(support_height=None), box())
    assert not rests(table(gravity=np.zeros(3)), box())
    assert not rests(table(gravity=np.array([0.31 * G, 0.0, -G])), box())
    assert not rests(table(), box(STANDS + 0.003))
    assert rests(table(), box(STANDS + 0.001))  # as near as a pose is measured
