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

Velocities are made anew here, because those in the files were differenced across the impact: free flight is fitted on
both sides, as ``impact-rs impacts`` does it, and what gives no state before and after is left out.

Files are read without PyTorch: they are pickles with the numbers behind them, and only what a tensor needs is let in.
"""

from __future__ import annotations

import argparse
import io
import math
import pickle
import struct
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.robot import Array
from impact_rs_trials.recordings.experiment import Body, Plane
from impact_rs_trials.recordings.impacts.body_impacts import TrackedBody, impacts_of_bodies
from impact_rs_trials.recordings.impacts.found_impacts import body_columns, tracked_body
from impact_rs_trials.recordings.impacts.impact_rows import table_text

HALF_WIDTH = 0.0524  # m, the unit of length in the files
MASS = 0.37  # kg
INERTIA = 0.00081  # kg m^2
PERIOD = 1.0 / 148.0  # s

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


def tracked(path: Path, cube: Body, board: Plane) -> TrackedBody:
    """The motion in the file of one toss."""
    states = read_tensor(path)
    states = states.reshape(-1, states.shape[-1])
    pose = np.column_stack((HALF_WIDTH * states[:, :3], states[:, 4:7], states[:, 3]))
    return tracked_body(path.stem, PERIOD * np.arange(len(pose)), pose, cube, board)


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
    cube = Body(mass=MASS, size=(2.0 * HALF_WIDTH,) * 3, inertia=(INERTIA,) * 3)
    board = Plane(friction=friction, restitution=restitution)
    impacts, left_out = impacts_of_bodies([tracked(path, cube, board) for path in files], cube)
    # Only the first impact of a toss: those after it are repeats of the same throw.
    first = [impact for impact in impacts if ", impact " not in impact.run]
    output.write_text(table_text(first, body_columns(cube, board)), encoding="utf-8")
    reasons = Counter(
        omission.reason.split(":")[0].split(" at ")[0] for omission in left_out if ", impact " not in omission.name
    )
    omitted = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
    say(f"{output}: {len(first)} of {len(files)} tosses" + (f"; left out: {omitted}" if omitted else ""))
    return len(first)


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
