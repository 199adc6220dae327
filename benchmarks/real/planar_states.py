# SPDX-License-Identifier: Apache-2.0
"""Turn states before and after impacts in a plane (MATLAB) into a table of impacts, as ``benchmarks.real`` needs it.

    ./run python benchmarks/real/planar_states.py data_ellipse.mat impacts.csv --mass 0.0364 --gyration 0.0192

The file holds a structure ``data`` with ``states_i`` and ``states_f``, ``(k, 6)``: x, y, theta and their rates; and
with ``n`` and ``d``, ``(k, 3)``, rows of the contact Jacobian along normal and tangent. With the contact point at
``(r_x, r_y)`` from the centre they are ``(0, 1, r_x)`` and ``(1, 0, -r_y)``: the contact point of the table is from
there, and the height of the centre above the plane (y of the file is twice that). The plane of motion is x, z of the
table; theta turns about -y. ``--mirror`` counts x the other way, where x and theta have opposite handedness.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.io

HEAD = (
    "x [m],y [m],z [m],qx,qy,qz,qw,vx_before [m/s],vy_before [m/s],vz_before [m/s],wx_before [rad/s],wy_before [rad/s],"
    "wz_before [rad/s],vx_after [m/s],vy_after [m/s],vz_after [m/s],wx_after [rad/s],wy_after [rad/s],wz_after [rad/s],"
    "mass [kg],ixx [kg m^2],iyy [kg m^2],izz [kg m^2],px [m],py [m],pz [m]"
)


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="MATLAB file with the structure data")
    parser.add_argument("output", type=Path, help="table to write")
    parser.add_argument("--mass", type=float, required=True, help="of the body [kg]")
    parser.add_argument("--gyration", type=float, required=True, help="radius of gyration in the plane [m]")
    parser.add_argument("--mirror", action="store_true", help="x of the file points the other way")
    args = parser.parse_args()
    data = scipy.io.loadmat(args.file, squeeze_me=True, struct_as_record=False)["data"]
    before, after = np.asarray(data.states_i), np.asarray(data.states_f)
    lever, height = np.asarray(data.n)[:, 2], np.asarray(data.d)[:, 2]
    for states in (before, after):
        states[:, [0, 3]] *= -1.0 if args.mirror else 1.0
    moment = args.mass * args.gyration**2
    rows = []
    for state_before, state_after, along, up in zip(before, after, lever, height, strict=True):
        x, _, theta, *rates = state_before
        pose = [x, 0.0, up, 0.0, -np.sin(0.5 * theta), 0.0, np.cos(0.5 * theta)]
        body = [args.mass, moment, moment, moment, x + along, 0.0, 0.0]
        rows.append([*pose, *_twist(rates), *_twist(state_after[3:]), *body])
    with args.output.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEAD.split(","))
        writer.writerows([f"{value:.12g}" for value in row] for row in rows)
    print(f"{args.output}: {len(rows)} impacts")


def _twist(rates: Sequence[float]) -> list[float]:
    """Velocity and angular velocity in axes of the table, of rates of x, y and theta."""
    along, up, turning = rates
    return [along, 0.0, up, 0.0, -turning, 0.0]


if __name__ == "__main__":
    main()
