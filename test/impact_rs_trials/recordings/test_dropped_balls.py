# SPDX-License-Identifier: Apache-2.0
"""Impact tables of heights and durations: speeds at the plane in closed form, and their propagated noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from impact_table_cases import write_csv

from impact_rs_sim.errors import InputError
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable, read_impact_table

G = 9.81  # m/s^2
DROPS = [0.25, 0.45, 0.65]  # m


def table_of(folder: Path, header: list[str], rows: list[list[float]]) -> ImpactTable:
    return read_impact_table(write_csv(folder / "drops.csv", header, rows))


def test_heights_and_durations_give_the_speeds_of_free_fall(tmp_path: Path) -> None:
    """v = sqrt(2 g h) = g t / 2. Kills h for the height in cm, a fall of twice the height, and a sign."""
    by_height = table_of(tmp_path, ["drop_height [cm]", "rebound_height [cm]"], [[100 * h, 64 * h] for h in DROPS])
    times = [[np.sqrt(8.0 * h / G), 0.8 * np.sqrt(8.0 * h / G)] for h in DROPS]
    by_time = table_of(tmp_path, ["flight_before [s]", "flight_after [s]"], times)
    mixed = table_of(
        tmp_path, ["drop_height [m]", "flight_after [ms]"], [[h, 1e3 * t[1]] for h, t in zip(DROPS, times, strict=True)]
    )
    for table in (by_height, by_time, mixed):
        for height, row in zip(DROPS, table.rows, strict=True):
            speed = np.sqrt(2.0 * G * height)
            np.testing.assert_allclose(row.impact.object.twist, [0, 0, -speed, 0, 0, 0], rtol=1e-12)
            np.testing.assert_allclose(row.after[:3], [0, 0, 0.8 * speed], rtol=1e-12, atol=1e-15)
        assert not table.turning and table.noise is None
        assert any("without drag" in said for said in table.assumed)


def test_noise_of_heights_becomes_that_of_the_rebound(tmp_path: Path) -> None:
    """By a simulation of measured heights: kills a noise of one height alone, or with e in the wrong place."""
    drop, e, sigma = 0.4, 0.7, 0.003
    noise = np.random.default_rng(0).normal(0.0, sigma, (2, 20000))
    before, after = (np.sqrt(2.0 * G * (h + own)) for h, own in zip((drop, e**2 * drop), noise, strict=True))
    header = ["drop_height [m]", "rebound_height [m]", "height_noise [mm]"]
    table = table_of(tmp_path, header, [[drop, e**2 * drop, 1e3 * sigma]])
    assert table.noise is not None
    assert table.noise[0, 2] == pytest.approx((after - e * before).std(), rel=0.03)
    assert table.noise[0, 0] == table.noise[0, 1] == 0.0
    in_time = table_of(tmp_path, ["flight_before [s]", "flight_after [s]", "flight_noise [s]"], [[0.5, 0.3, 0.001]])
    assert in_time.noise is not None
    assert in_time.noise[0, 2] == pytest.approx(0.5 * G * 0.001 * np.hypot(1.0, 0.6))


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (["rebound_height [m]", "mass [kg]"], "without 'drop_height [m]' or 'flight_before [s]'"),
        (["drop_height [m]", "flight_before [s]"], "expected one of them"),
        (["drop_height [m]", "vz_before [m/s]"], "expected one of them"),
        (["drop_height [m]", *(f"w{axis}_before [rad/s]" for axis in "xyz")], "expected one of them"),
        (["drop_height [m]", "rebound_height [m]", "v_noise [m/s]"], "expected one of them"),
        (["drop_height [m]", "flight_after [s]", "height_noise [cm]"], "column 'flight_noise [s]' is missing"),
        (["drop_height [m]", "mass [kg]"], "no column 'vx_after"),
        (["h0 [cm]", "h1 [cm]"], "of a ball that falls straight 'drop_height [m]' or 'flight_before [s]'"),
    ],
)
def test_a_table_that_lacks_a_flight_names_the_columns_it_may_have(
    header: list[str], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said.replace("[", r"\[").replace("(", r"\(")):
        table_of(tmp_path, header, [[0.3 for _ in header]])
