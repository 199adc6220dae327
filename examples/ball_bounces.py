# SPDX-License-Identifier: Apache-2.0
"""Turn flights of table tennis balls (SpinDOE) into a table of impacts, a row per ball: its first bounce on the table.

    git clone https://github.com/cogsys-tuebingen/spindoe
    ./run python examples/ball_bounces.py spindoe/data/trajectories/trajectories.zip ball_bounces.csv
    ./run impact-rs diagnose --impacts ball_bounces.csv -o diagnosis.json

The data (Gossard, Tebbe, Ziegler and Zell 2023) are 232 flights, tracked at some 145 Hz to the millimetre. A file holds
time and centre of the ball, ``t;x;y;z`` in s and m, z up; ``index.csv`` holds the spin before the bounce in rad/s. The
spin after it was not measured, so velocities alone are compared.

The data do not say in which frame the spin is. Of the 24 turns of the axes one explains best both the Magnus
acceleration in flight (c w x v with c = 0.0010, as positive as lift is) and the direction in which the table pushes the
ball, against its slip: (x, z, -y), the frame of a camera that looks along y.
"""

from __future__ import annotations

import argparse
import csv
import io
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.impacts.motion_fits import FittedMotion, move

MASS, RADIUS = 0.0027, 0.020  # kg, m: the laws of table tennis
WINDOW = 0.1  # s of flight on either side
FEWEST = 8  # samples there: with fewer a parabola hardly shows its scatter
LOW = 0.1  # m; the table is near z = 0
FASTEST = 2.0 * np.pi * 160.0  # rad/s; the fastest spins that were ever measured are 150 turns a second
HEADER = (
    "run",
    *(f"v{axis}_before [m/s]" for axis in "xyz"),
    *(f"w{axis}_before [rad/s]" for axis in "xyz"),
    *(f"v{axis}_after [m/s]" for axis in "xyz"),
    *("v_noise [m/s]", "mass [kg]", "radius [m]", "shell [-]", "friction [-]", "restitution [-]"),
)


def bounce(time: Array, position: Array) -> tuple[Array, Array, float] | str:
    """Velocity just before and just after the first bounce and its standard deviation; or why there is none.

    Args:
        time: Stamps, ``(k,)`` [s].
        position: Of the centre, ``(k, 3)`` [m].
    """
    height = position[:, 2]
    lowest = next(
        (k for k in range(1, len(time) - 1) if height[k] < LOW and height[k - 1] > height[k] <= height[k + 1]), None
    )
    if lowest is None:
        return "no bounce on the table"
    before = np.flatnonzero((time > time[lowest] - WINDOW) & (np.arange(len(time)) < lowest))
    after = np.flatnonzero((time < time[lowest] + WINDOW) & (np.arange(len(time)) > lowest))
    if min(before.size, after.size) < FEWEST:
        return f"fewer than {FEWEST} samples of flight on a side"
    edges = float(time[before[-1]]), float(time[after[0]])
    fits = [
        move(time[rows], position[rows], np.tile(np.eye(3), (rows.size, 1, 1)), at)
        for rows, at in zip((before, after), edges, strict=True)
    ]
    contact_time = _meeting(fits[0], fits[1], edges)
    if contact_time is None:
        return "the flights before and after do not meet"
    ante, post = (fit.at(contact_time)[2][:3] for fit in fits)
    return ante, post, float(np.hypot(fits[0].noise[0], fits[1].noise[0]))


def _meeting(ante: FittedMotion, post: FittedMotion, edge: tuple[float, float]) -> float | None:
    """Time at which both have the same height; None: they have not, between these samples."""
    (p, _, u), (q, _, v) = ante.at(edge[0]), post.at(edge[0])
    bend = 0.5 * (ante.acceleration[2] - post.acceleration[2])
    roots = np.roots([bend, u[2] - v[2], p[2] - q[2]])
    inside = [float(root.real) for root in roots if abs(root.imag) < 1e-12 and 0.0 <= root.real <= edge[1] - edge[0]]
    return edge[0] + min(inside) if inside else None


def write_table(
    archive: Path, output: Path, friction: float, restitution: float, say: Callable[[str], None] = print
) -> int:
    """Write the table of all flights of an archive; returns how many rows it has.

    Raises:
        InputError: The archive holds no flights.
    """
    try:
        with zipfile.ZipFile(archive) as files:
            index = next(name for name in files.namelist() if name.endswith("index.csv"))
            spins = list(csv.DictReader(io.StringIO(files.read(index).decode())))
            flights = {
                row["traj_file"]: files.read(index.replace("index.csv", f"{int(row['traj_file']):03d}.csv")).decode()
                for row in spins
            }
    except (OSError, zipfile.BadZipFile, StopIteration, KeyError, ValueError) as error:
        raise InputError(f"no archive of flights with an index.csv ({error})", file=archive) from None
    rows, left_out = [], Counter[str]()
    for row in spins:
        x, y, z = (float(row[f"{axis}_spin"]) for axis in "xyz")
        spin = np.array([x, z, -y])  # from the frame of the camera, which looks along y of the table
        flight = np.array([[float(cell) for cell in line.split(";")] for line in flights[row["traj_file"]].split()])
        flight = flight[np.diff(flight[:, 0], prepend=-np.inf) > 0.0]  # some stamps stand twice
        result = bounce(flight[:, 0], flight[:, 1:])
        if np.linalg.norm(spin) > FASTEST:
            result = "spin of more than 160 turns a second"
        if isinstance(result, str):
            left_out[result] += 1
            continue
        before, after, noise = result
        rows.append([row["traj_file"], *before, *spin, *after, noise, MASS, RADIUS, 1.0, friction, restitution])
    if not rows:
        raise InputError("no flight has a bounce", file=archive)
    with output.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([HEADER, *([row[0], *(f"{cell:.6g}" for cell in row[1:])] for row in rows)])
    omitted = ", ".join(f"{count} {reason}" for reason, count in left_out.items())
    say(f"{output}: {len(rows)} of {len(spins)} flights" + (f"; left out: {omitted}" if omitted else ""))
    return len(rows)


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive", type=Path, help="trajectories.zip of SpinDOE")
    parser.add_argument("output", type=Path, help="table to write, .csv")
    parser.add_argument("--friction", type=float, default=0.3, help="Coulomb coefficient to assume [-]; default 0.3")
    parser.add_argument("--restitution", type=float, default=0.5, help="restitution to assume [-]; default 0.5")
    args = parser.parse_args()
    write_table(args.archive, args.output, args.friction, args.restitution)


if __name__ == "__main__":
    main()
