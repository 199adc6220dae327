# SPDX-License-Identifier: Apache-2.0
"""Turn the cube tosses of ContactNets into a table of impacts, one row per toss.

    git clone https://github.com/DAIRLab/contact-nets
    ./run python examples/cube_tosses.py contact-nets/data/tosses_processed cube_tosses.csv
    ./run impact-rs compare --impacts cube_tosses.csv
    ./run impact-rs diagnose --impacts cube_tosses.csv -o diagnosis.json

The data (Pfrommer, Halm and Posa 2020; BSD-3-Clause) are 570 tosses of an acrylic cube onto a board, tracked at 148 Hz.
A file holds one tensor ``(1, samples, 19)``: position of the centre and, further on, its velocity, both in half widths
of the cube; a quaternion w, x, y, z; an angular velocity in axes of the body; and six columns of control, all zero. The
board is the plane z = 0.

Velocities are made anew here, because those in the files were differenced across the impact. In free flight

    p(t) = p_0 + v t + g t^2 / 2,        R(t) = exp(omega t) R_0

with omega constant in axes of the world, for the moments of a cube are all alike. Both are fitted to ``SAMPLES``
samples before the first impact and as many after it; the impact is where the two parabolas meet. Left out is

* a toss without that many undisturbed samples on both sides,
* one that lands on an edge or a face: its next corner comes so soon that two impacts look like one,
* one that is there twice: 33 tosses are, turned about the vertical, and would be held out against themselves.

Files are read without PyTorch: they are pickles with the numbers behind them, and only what a tensor needs is let in.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import pickle
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array

HALF_WIDTH = 0.0524  # m, the unit of length in the files
MASS = 0.37  # kg
INERTIA = 0.00081  # kg m^2
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2
PERIOD = 1.0 / 148.0  # s
SAMPLES = 5  # on either side; more of them reach into the next bounce
DISTURBED = 8.0  # m/s^2 off free fall, three times what tracking noise alone makes of second differences
LONGEST = 2  # disturbed second differences in a row; a single impact, between two samples or on one, makes no more
NEXT_CORNER = 0.01  # m, of the second lowest corner above the lowest; at 1 m/s it comes within two samples
SLOWEST = 0.2  # m/s; below it the cube comes down so gently that noise decides
HEADER = (
    ["toss", "x [m]", "y [m]", "z [m]", "qx [-]", "qy [-]", "qz [-]", "qw [-]"]
    + [f"{name}_{when} [{unit}]" for when in ("before", "after") for stem, unit in (("v", "m/s"), ("w", "rad/s"))
       for name in (f"{stem}x", f"{stem}y", f"{stem}z")]
    + ["mass [kg]", "ixx [kg m^2]", "iyy [kg m^2]", "izz [kg m^2]", "size_x [m]", "size_y [m]", "size_z [m]"]
    + ["friction [-]", "restitution [-]", "v_noise [m/s]", "w_noise [rad/s]"]
)  # fmt: skip

DTYPES = {"DoubleStorage": "<f8", "FloatStorage": "<f4"}


class _Tensors(pickle.Unpickler):
    """Reads a pickled tensor as storage, offset and shape, and refuses whatever else a pickle could do."""

    def find_class(self, module: str, name: str) -> Any:
        """Only what a tensor is made of."""
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return lambda storage, offset, shape, *_: (storage, offset, shape)
        if (module, name) == ("collections", "OrderedDict"):
            return dict
        if module == "torch" and name in DTYPES:
            return name
        raise pickle.UnpicklingError(f"{module}.{name} is no part of a tensor")

    def persistent_load(self, pid: Any) -> Any:
        """Type and key of a storage."""
        return pid[1], pid[2]


def read_tensor(path: Path) -> Array:
    """The tensor in a file of ``torch.save``, old format or zip.

    Raises:
        InputError: It holds something else.
    """
    data = path.read_bytes()
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                root = archive.namelist()[0].split("/")[0]
                (kind, key), offset, shape = _Tensors(io.BytesIO(archive.read(f"{root}/data.pkl"))).load()
                raw = archive.read(f"{root}/data/{key}")
        else:
            file = io.BytesIO(data)
            for _ in range(3):  # magic number, version, machine
                _Tensors(file).load()
            (kind, key), offset, shape = _Tensors(file).load()
            _Tensors(file).load()  # keys of the storages
            (count,) = struct.unpack("<q", file.read(8))
            raw = file.read(count * np.dtype(DTYPES[kind]).itemsize)
        values = np.frombuffer(raw, DTYPES[kind])
        return values[offset : offset + math.prod(shape)].reshape(shape).astype(float)
    except (pickle.UnpicklingError, EOFError, KeyError, IndexError, ValueError, TypeError, struct.error) as error:
        raise InputError(f"no tensor of a toss ({type(error).__name__}: {error})", file=path) from None


@dataclass(frozen=True)
class Flight:
    """Free flight fitted to some samples.

    Attributes:
        start: Time of its first sample [s].
        position: p_0, ``(3,)`` [m].
        velocity: v, ``(3,)`` [m/s].
        rotation: R_0, ``(3, 3)``.
        turning: omega in axes of the world, ``(3,)`` [rad/s].
        scatter: Root mean square of what the fit leaves of positions [m] and angles [rad].
    """

    start: float
    position: Array
    velocity: Array
    rotation: Array
    turning: Array
    scatter: tuple[float, float]

    @staticmethod
    def of(first: int, positions: Array, rotations: Array) -> Flight:
        """Fit the samples from number ``first`` on, ``(n, 3)`` [m] and ``(n, 3, 3)``."""
        time = PERIOD * np.arange(len(positions))
        basis = np.column_stack((np.ones_like(time), time))
        falling = positions - 0.5 * np.outer(time**2, GRAVITY)
        line = np.linalg.lstsq(basis, falling, rcond=None)[0]
        turned = np.array([pin.log3(rotation @ rotations[0].T) for rotation in rotations])
        spin = np.linalg.lstsq(basis, turned, rcond=None)[0]
        freedom = 3 * (len(time) - 2)
        scatter = [
            float(np.sqrt(np.sum(np.square(v - basis @ f)) / freedom)) for v, f in ((falling, line), (turned, spin))
        ]
        return Flight(
            PERIOD * first, line[0], line[1], pin.exp3(spin[0]) @ rotations[0], spin[1], (scatter[0], scatter[1])
        )

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Position ``(3,)`` [m], rotation ``(3, 3)`` and twist ``(6,)`` [m/s, rad/s] at a time [s]."""
        t = time - self.start
        position = self.position + self.velocity * t + 0.5 * GRAVITY * t**2
        twist = np.concatenate((self.velocity + GRAVITY * t, self.turning))
        return position, pin.exp3(self.turning * t) @ self.rotation, twist


@dataclass(frozen=True)
class Toss:
    """The first impact of a toss.

    Attributes:
        position: Centre, ``(3,)`` [m].
        rotation: Axes of the cube, ``(3, 3)``.
        before: Twist just before, ``(6,)`` [m/s, rad/s].
        after: Twist just after, ``(6,)`` [m/s, rad/s].
        scatter: Of both fits together, positions [m] and angles [rad].
    """

    position: Array
    rotation: Array
    before: Array
    after: Array
    scatter: tuple[float, float]


def first_impact(states: Array) -> Toss | str:
    """The first impact in the states of a toss, ``(samples, 13 or more)`` as in the files; or why there is none."""
    positions = HALF_WIDTH * states[:, :3]
    rotations = np.array([pin.Quaternion(*row).normalized().matrix() for row in states[:, 3:7]])
    off = np.abs(np.diff(positions[:, 2], n=2) / PERIOD**2 - GRAVITY[2]) > DISTURBED  # of sample 1, 2, ...
    if not off.any():
        return "nothing is hit"
    first = int(np.argmax(off))
    length = int(np.argmin(np.append(off[first:], False)))
    begin, end = first, first + length + 2  # of the samples around the impact; those outside fly freely
    if length > LONGEST:
        return "several impacts in a row"
    if begin < SAMPLES or end + SAMPLES > len(states):
        return "too few samples of free flight"
    if off[end - 1 : end - 1 + SAMPLES - 1].any():
        return "too few samples of free flight"
    ante = Flight.of(begin - SAMPLES + 1, *(v[begin - SAMPLES + 1 : begin + 1] for v in (positions, rotations)))
    post = Flight.of(end, *(v[end : end + SAMPLES] for v in (positions, rotations)))
    # Both fall with g, so the difference of their heights is a straight line.
    gap, slope = ante.at(0.0)[0][2] - post.at(0.0)[0][2], ante.at(0.0)[2][2] - post.at(0.0)[2][2]
    time = float(np.clip(-gap / slope, PERIOD * begin, PERIOD * end))
    position, rotation, before = ante.at(time)
    if before[2] > -SLOWEST:
        return "too slow"
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    lowest, second = np.sort(HALF_WIDTH * signs @ rotation[2])[:2]
    if second - lowest < NEXT_CORNER:
        return "on an edge or a face"
    scatter = tuple(float(np.hypot(a, b)) for a, b in zip(ante.scatter, post.scatter, strict=True))
    return Toss(position, rotation, before, post.at(time)[2], (scatter[0], scatter[1]))


def row_of(name: str, toss: Toss, friction: float, restitution: float) -> list[object]:
    """One row of the table."""
    quaternion = pin.Quaternion(toss.rotation).coeffs()
    # Slope of a line through n samples of scatter s at a period h: s / h sqrt(12 / (n (n^2 - 1))).
    slope = math.sqrt(12.0 / (SAMPLES * (SAMPLES**2 - 1.0))) / PERIOD
    numbers = [*toss.position, *quaternion, *toss.before, *toss.after, MASS, *[INERTIA] * 3, *[2.0 * HALF_WIDTH] * 3]
    numbers += [friction, restitution, toss.scatter[0] * slope, toss.scatter[1] * slope]
    return [name, *(f"{number:.9g}" for number in numbers)]


def write_table(
    folder: Path, output: Path, friction: float, restitution: float, say: Callable[[str], None] = print
) -> int:
    """Write the table of all tosses of a folder; returns how many rows it has.

    Raises:
        InputError: There is no toss here, or a file is none.
    """
    files = sorted(folder.glob("*.pt"), key=lambda path: (len(path.stem), path.stem))
    if not files:
        raise InputError("no toss here; expected files called 0.pt, 1.pt and so on", file=folder)
    left_out: dict[str, int] = {}
    rows, heights = [], set()
    for path in files:
        states = read_tensor(path)
        states = states.reshape(-1, states.shape[-1])
        found = first_impact(states)
        if (height := states[:, 2].round(6).tobytes()) in heights:
            found = "there twice"
        heights.add(height)
        if isinstance(found, str):
            left_out[found] = left_out.get(found, 0) + 1
        else:
            rows.append(row_of(path.stem, found, friction, restitution))
    with output.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([HEADER, *rows])
    reasons = ", ".join(f"{count} {reason}" for reason, count in left_out.items())
    say(f"{output}: {len(rows)} of {len(files)} tosses" + (f"; left out: {reasons}" if reasons else ""))
    return len(rows)


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder data/tosses_processed of ContactNets")
    parser.add_argument("output", type=Path, help="table to write, .csv")
    parser.add_argument("--friction", type=float, default=0.3, help="Coulomb coefficient to assume [-]; default 0.3")
    parser.add_argument("--restitution", type=float, default=0.0, help="restitution to assume [-]; default 0")
    args = parser.parse_args()
    write_table(args.folder, args.output, args.friction, args.restitution)


if __name__ == "__main__":
    main()
