# SPDX-License-Identifier: Apache-2.0
"""Impacts of a cube on one corner, with friction and restitution, solved by hand; nothing of the impact map is used.

With c the centre of mass, r from c to the corner, the mass m and the moment I of a cube about c, the velocity of the
corner changes by G L with G = 1 / m - [r]x [r]x / I. Either the corner sticks, G L = -u_t - (1 + e) u_n with L inside
the cone, or it slides along d = (cos a, sin a, 0) with L = L_n (n - mu d), and a is the root of

    u_t^+(a)  across  d(a)  = 0,    u_t^+(a) . d(a) >= 0
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import scipy
from impact_table_cases import CUBE_HEADER, write_csv

MASS, WIDTH, MOMENT = 0.37, 0.1048, 8.1e-4  # kg, m, kg m^2; the cube of ContactNets
NOISE = (0.005, 0.1)  # m/s, rad/s
UP = np.array([0.0, 0.0, 1.0])


def skew(vector: np.ndarray) -> np.ndarray:
    return np.cross(np.eye(3), vector)  # rows e_i x v, so that (e_i x v) . w = e_i . (v x w)


def impulse(velocity: np.ndarray, mobility: np.ndarray, friction: float, restitution: float) -> np.ndarray:
    """L at a corner that comes with ``velocity``, ``(3,)`` [N s]."""
    fall = -velocity[2]
    sticking = np.linalg.solve(mobility, -velocity + restitution * fall * UP)
    if np.hypot(*sticking[:2]) <= friction * sticking[2]:
        return sticking

    def sliding(angle: float) -> tuple[np.ndarray, np.ndarray]:
        way = np.array([np.cos(angle), np.sin(angle), 0.0])
        unit = UP - friction * way
        return unit * (1.0 + restitution) * fall / float(UP @ mobility @ unit), way

    def across(angle: float) -> float:
        pushed, way = sliding(angle)
        after = velocity + mobility @ pushed
        return float(way[0] * after[1] - way[1] * after[0])

    grid = np.linspace(-np.pi, np.pi, 361)
    values = np.array([across(angle) for angle in grid])
    for place in np.flatnonzero(np.diff(np.sign(values))):
        pushed, way = sliding(scipy.optimize.brentq(across, grid[place], grid[place + 1], xtol=1e-14))
        if pushed[2] >= 0.0 and float((velocity + mobility @ pushed) @ way) >= -1e-12:
            return pushed
    raise AssertionError("neither sticks nor slides")


def toss(rng: np.random.Generator, friction: float, restitution: float, com: np.ndarray) -> np.ndarray:
    """Position, quaternion, twist of the centre before and after, ``(19,)``, of one that lands on a corner."""
    while True:
        turn = pin.Quaternion(*rng.standard_normal(4)).normalized().matrix()
        corners = WIDTH / 2.0 * np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) @ turn.T
        lowest, second = corners[np.argsort(corners[:, 2])[:2]]
        velocity = np.array([*rng.uniform(-1.5, 1.5, 2), -rng.uniform(0.6, 2.0)])
        turning = rng.normal(0.0, 4.0, 3)
        coming = velocity + np.cross(turning, lowest)
        if second[2] - lowest[2] > 0.01 and coming[2] < -0.3:
            break
    middle = turn @ com
    lever = lowest - middle
    mobility = np.eye(3) / MASS - skew(lever) @ skew(lever) / MOMENT
    pushed = impulse(coming, mobility, friction, restitution)
    after = turning + np.cross(lever, pushed) / MOMENT
    of_middle = velocity + np.cross(turning, middle) + pushed / MASS
    place = np.array([0.1, 0.2, -lowest[2]])
    before = [*velocity, *turning]
    return np.array([*place, *pin.Quaternion(turn).coeffs(), *before, *(of_middle - np.cross(after, middle)), *after])


def toss_table(
    path: Path,
    assumed: float,
    rows: int = 150,
    seed: int = 0,
    friction: float = 0.18,
    restitution: float = 0.27,
    com: Sequence[float] = (0.0, 0.0, 0.0068),
    noise: Sequence[float] = NOISE,
) -> Path:
    """A table in the form of ``examples/cube_tosses.py``, with some friction assumed and e = 0."""
    rng = np.random.default_rng(seed)
    header = [*CUBE_HEADER, "ixx [kg m^2]", "iyy [kg m^2]", "izz [kg m^2]", "v_noise [m/s]", "w_noise [rad/s]"]
    found = []
    for _ in range(rows):
        row = toss(rng, friction, restitution, np.array(com))
        row[13:] += np.repeat(noise, 3) * rng.standard_normal(6)
        found.append([*row, MASS, *[WIDTH] * 3, assumed, 0.0, *[MOMENT] * 3, *noise])
    return write_csv(path, header, found)
