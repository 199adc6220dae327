# SPDX-License-Identifier: Apache-2.0
"""Impacts of a ball on something heavy in closed form, and tables of them; nothing of the impact map is used.

With the normal n up, a ball of mass m, radius r and moment I = k m r^2 touches at -r n with u = v + omega x (-r n), so
an impulse along the face changes its slip by (1 + 1/k) L_t / m. It leaves with (Walton 1993; Cross 2002)

    L_n = m (1 + e) |v_n|
    L_t = -m k / (1 + k) (1 + beta) u_t, shortened to mu L_n where it is longer
    M_n = -I (1 + gamma) omega_n,        shortened to a L_n where it is longer
    M_t = -I omega_t                     shortened to b L_n where it is longer; if mu = 0
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from impact_table_cases import write_csv

MASS, RADIUS = 0.0027, 0.02  # kg, m; a ball of table tennis
HOLLOW, SOLID = 2.0 / 3.0, 2.0 / 5.0
Law = Callable[[float], float]  # of a speed [m/s]
NOISE = (0.16, 14.0)  # m/s, rad/s; what is left of real impacts on a racket
TWIST = [f"{kind}{axis}" for kind in "vw" for axis in "xyz"]


@dataclass(frozen=True)
class Racket:
    """What a ball hits.

    Attributes:
        restitution: e of the closing speed.
        friction: mu [-].
        tangential: beta of the slip.
        drilling: a [m].
        spin: gamma [-].
        rolling: b [m]; of a face without friction.
    """

    restitution: Law = lambda speed: 0.5
    friction: float = 0.2
    tangential: Law = lambda slip: 0.0
    drilling: float = 0.0
    spin: float = 0.0
    rolling: float = 0.0


def bounced(twist: np.ndarray, racket: Racket, share: float = HOLLOW) -> np.ndarray:
    """Twist after an impact on a face whose normal is z, ``(6,)`` [m/s, rad/s]."""
    velocity, turning = twist[:3], twist[3:]
    inertia = share * MASS * RADIUS**2
    fall = -velocity[2]
    slip = np.array([velocity[0] - RADIUS * turning[1], velocity[1] + RADIUS * turning[0]])
    speed = float(np.hypot(*slip))
    pressing = MASS * (1.0 + racket.restitution(fall)) * fall
    along = -MASS * share / (1.0 + share) * (1.0 + racket.tangential(speed)) * slip
    along *= min(1.0, racket.friction * pressing / max(float(np.hypot(*along)), 1e-300))
    drilling = -inertia * (1.0 + racket.spin) * turning[2]
    drilling = float(np.clip(drilling, -racket.drilling * pressing, racket.drilling * pressing))
    moment = np.array([RADIUS * along[1], -RADIUS * along[0], drilling])  # (0, 0, -r) x L
    if racket.rolling:
        assert racket.friction == 0.0
        rolling = inertia * float(np.hypot(*turning[:2]))
        moment[:2] = -inertia * turning[:2] * min(1.0, racket.rolling * pressing / max(rolling, 1e-300))
    return np.concatenate((velocity + np.array([*along, pressing]) / MASS, turning + moment / inertia))


def thrown(rng: np.random.Generator) -> np.ndarray:
    """Twist of a ball that comes from above, as a machine throws it, ``(6,)`` [m/s, rad/s]."""
    speed, angle, way = rng.uniform(3.0, 9.0), rng.uniform(0.0, 1.2), rng.uniform(-np.pi, np.pi)
    flat = speed * np.sin(angle)
    velocity = [flat * np.cos(way), flat * np.sin(way), -speed * np.cos(angle)]
    return np.array([*velocity, *rng.uniform(-200.0, 200.0, 3)])


def ball_table(
    path: Path,
    racket: Racket,
    rows: int = 150,
    seed: int = 0,
    noise: Sequence[float] = NOISE,
    stated: bool = True,
    **assumed: float,
) -> Path:
    """A table of hollow balls; ``assumed`` are friction and restitution, ``stated`` whether it has the noise."""
    rng = np.random.default_rng(seed)
    header = [f"{name}_before [{'m/s' if name[0] == 'v' else 'rad/s'}]" for name in TWIST]
    header += [f"{name}_after [{'m/s' if name[0] == 'v' else 'rad/s'}]" for name in TWIST]
    header += ["mass [g]", "radius [mm]", "shell [-]", *(f"{name} [-]" for name in assumed)]
    header += ["v_noise [m/s]", "w_noise [rad/s]"] if stated else []
    found = []
    for _ in range(rows):
        before = thrown(rng)
        after = bounced(before, racket) + np.repeat(noise, 3) * rng.standard_normal(6)
        own = list(noise) if stated else []
        found.append([*before, *after, 1e3 * MASS, 1e3 * RADIUS, 1.0, *assumed.values(), *own])
    return write_csv(path, header, found)


def turned_ball_table(path: Path, angle: float) -> Path:
    """A table of 120 balls with topspin on a rough face; spins are seen in axes turned about x by an angle [rad]."""
    axes = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), -np.sin(angle)], [0.0, np.sin(angle), np.cos(angle)]])
    rng, noise, rows = np.random.default_rng(0), np.repeat((0.05, 3.0), 3), []
    for _ in range(120):
        speed, incidence = rng.uniform(3.0, 9.0), rng.uniform(0.2, 1.2)
        spin = [rng.normal(0.0, 5.0), rng.uniform(-250.0, 250.0), rng.normal(0.0, 5.0)]
        before = np.array([speed * np.sin(incidence), 0.0, -speed * np.cos(incidence), *spin])
        after = bounced(before, Racket(lambda v: 0.6, 0.6)) + noise * rng.standard_normal(6)
        seen = [value for twist in (before, after) for value in (*twist[:3], *(axes @ twist[3:]))]
        rows.append([*seen, 1e3 * MASS, 1e3 * RADIUS, 1.0, 0.05, 3.0])
    header = [
        f"{name}_{tail} [{'m/s' if name[0] == 'v' else 'rad/s'}]" for tail in ("before", "after") for name in TWIST
    ]
    return write_csv(path, [*header, "mass [g]", "radius [mm]", "shell [-]", "v_noise [m/s]", "w_noise [rad/s]"], rows)
