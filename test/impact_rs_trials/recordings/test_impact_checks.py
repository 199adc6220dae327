# SPDX-License-Identifier: Apache-2.0
"""What holds under any contact law: a column with a wrong sign or unit is named, and right tables raise no doubt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from impact_table_cases import CUBE_HEADER, arm_table, cube, cube_rows, write_csv

from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.impact_checks import doubts_of
from impact_rs_trials.recordings.impact_table import ImpactTable, read_impact_table

Rows = Sequence[Sequence[object]]


def times(header: Sequence[str], rows: Rows, columns: Sequence[str], factor: float) -> Rows:
    """The rows with some columns times a factor."""
    places = {header.index(text) for text in header if text.partition(" ")[0] in columns}
    assert len(places) == len(columns)
    return [[factor * x if n in places else x for n, x in enumerate(row)] for row in rows]  # type: ignore[operator]


def tosses(path: Path, columns: Sequence[str] = (), factor: float = -1.0, seed: int = 0, **truth: float) -> ImpactTable:
    """Tossed cubes with some columns times a factor."""
    rows = cube_rows(cube(**{"friction": 0.3, "restitution": 0.3, **truth}), 40, seed)
    return read_impact_table(write_csv(path / "cubes.csv", CUBE_HEADER, times(CUBE_HEADER, rows, columns, factor)))


def pushes(path: Path, columns: Sequence[str] = ()) -> ImpactTable:
    header, rows = arm_table({}, 3)
    return read_impact_table(write_csv(path / "pushes.csv", header, times(header, rows, columns, -1.0)), PUSH)


PUSH = load_scenario("push")
BOTH = ("before", "after")


@pytest.mark.parametrize(
    ("columns", "factor"),
    [
        (("vx_before", "vx_after"), -1.0),
        (("vy_before", "vy_after"), -1.0),
        (("vx_after",), -1.0),
        (("vz_after",), -1.0),
        (("wy_before", "wy_after"), -1.0),
        (("wx_after", "wy_after", "wz_after"), -1.0),
        (("wx_after", "wy_after", "wz_after"), 180.0 / np.pi),
        (("vx_after", "vy_after", "vz_after"), 1e3),
    ],
)
def test_a_wrong_sign_or_unit_is_named_with_its_remedy(tmp_path: Path, columns: Sequence[str], factor: float) -> None:
    (doubt,) = doubts_of(tosses(tmp_path, columns, factor))
    assert doubt.endswith(f"factor: {1.0 / factor:.4g} for {', '.join(columns)}")


def test_the_sign_of_x_is_named_however_slippery_the_plane_is(tmp_path: Path) -> None:
    for friction in (0.1, 1.0):
        mirrored = tosses(tmp_path, ("x", "vx_before", "vx_after"), friction=friction, restitution=0.0)
        assert "factor: -1 for vx_before, vx_after" in doubts_of(mirrored)[0]


@pytest.mark.parametrize("joint", [1, 4])
def test_the_sign_of_a_joint_is_named(tmp_path: Path, joint: int) -> None:
    (doubt,) = doubts_of(pushes(tmp_path, (f"dq{joint}_after",)))
    assert f"factor: -1 for dq{joint}_after" in doubt


def test_right_tables_raise_no_doubt_whatever_friction_restitution_and_centre_of_mass(tmp_path: Path) -> None:
    """Thirty of them here; of 1,000 with 20 rows each none did."""
    rng = np.random.default_rng(0)
    for seed in range(30):
        truth = {"friction": rng.uniform(0.0, 1.2), "restitution": rng.uniform(0.0, 0.3)}
        if seed % 2:
            truth["com"] = rng.uniform(-0.02, 0.02, 3)
        assert doubts_of(tosses(tmp_path, seed=seed, **truth)) == []
    assert doubts_of(pushes(tmp_path)) == []


def test_what_no_factor_explains_is_said_without_a_remedy(tmp_path: Path) -> None:
    rows = [list(row) for row in cube_rows(cube(0.3, 0.3), 40)]
    first, last = CUBE_HEADER.index("vx_after [m/s]"), CUBE_HEADER.index("wz_after [rad/s]")
    noise = np.random.default_rng(0).standard_normal((40, last - first + 1)) * ([3.0] * 3 + [60.0] * 3)
    for row, values in zip(rows, noise, strict=True):
        row[first : last + 1] = list(values)
    (doubt,) = doubts_of(read_impact_table(write_csv(tmp_path / "noise.csv", CUBE_HEADER, rows)))
    assert "no factor" in doubt and "factor: " not in doubt


def test_an_outcome_in_another_unit_from_a_row_on_is_named(tmp_path: Path) -> None:
    """A ball's lateral velocity, which is noise: no law of mechanics sees that it is in mm/s from the 21st row on."""
    rng = np.random.default_rng(1)
    header = [f"v{axis}_before [m/s]" for axis in "xyz"] + [f"w{axis}_before [rad/s]" for axis in "xyz"]
    header += [f"v{axis}_after [m/s]" for axis in "xyz"] + ["mass [kg]", "radius [m]"]
    rows = []
    for number in range(40):
        vx, vz = rng.uniform(1.0, 2.0), -rng.uniform(1.0, 3.0)
        lateral = 1e-4 * rng.standard_normal() * (1e3 if number >= 20 else 1.0)
        rows.append([vx, 0.0, vz, 0.0, 0.0, 0.0, vx + 0.16 * vz, lateral, -0.6 * vz, 0.05, 0.03])
    (doubt,) = doubts_of(read_impact_table(write_csv(tmp_path / "balls.csv", header, rows)))
    assert doubt.startswith("vy_after is") and "another unit?" in doubt
    steps = [[*row[:7], row[7] / (1e3 if n >= 20 else 1.0), *row[8:]] for n, row in enumerate(rows)]
    assert doubts_of(read_impact_table(write_csv(tmp_path / "right.csv", header, steps))) == []
    slow = [[0.01 * row[0], *row[1:6], 0.01 * row[6], *row[7:]] if n < 20 else row for n, row in enumerate(steps)]
    assert doubts_of(read_impact_table(write_csv(tmp_path / "blocks.csv", header, slow))) == []  # another condition
