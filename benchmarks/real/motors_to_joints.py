# SPDX-License-Identifier: Apache-2.0
"""Joint angles and torques of an arm of which motors were recorded, also where two joints share a shaft.

With the matrix R of motor turns over joint turns, q = R^-1 m + offset and tau = R^T of the torques of the motors. R is
diagonal but for couplings, ``--coupling MOTOR JOINT RATIO``: this motor turns with that joint as well.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np


def main() -> None:
    """Read two tables of numbers with names above, write one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("angles", type=Path, help="CSV with the angles of the motors [rad]")
    parser.add_argument("torques", type=Path, help="CSV with the torques of the motors [N m]")
    parser.add_argument("output", type=Path, help="CSV to write: t, q1, ..., tau1, ... [s, rad, N m]")
    parser.add_argument("--ratios", type=float, nargs="+", required=True, help="motor turns over joint turns")
    parser.add_argument("--offsets", type=float, nargs="+", required=True, help="joint angles at motor angle 0 [rad]")
    parser.add_argument("--coupling", type=float, nargs=3, action="append", default=[], help="motor, joint, ratio")
    parser.add_argument("--rate", type=float, required=True, help="sampling rate [Hz]")
    args = parser.parse_args()
    turns = np.diag(args.ratios)
    for motor, joint, ratio in args.coupling:
        turns[int(motor) - 1, int(joint) - 1] = ratio
    angles, torques = (np.genfromtxt(file, delimiter=",", skip_header=1) for file in (args.angles, args.torques))
    time = np.arange(len(angles)) / args.rate
    table = np.column_stack((time, angles @ np.linalg.inv(turns).T + args.offsets, torques @ turns))
    numbers = range(1, len(args.ratios) + 1)
    names = ",".join(["t", *(f"q{n}" for n in numbers), *(f"tau{n}" for n in numbers)])
    np.savetxt(args.output, table, delimiter=",", header=names, comments="", fmt="%.8g")


if __name__ == "__main__":
    main()
