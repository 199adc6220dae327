# SPDX-License-Identifier: Apache-2.0
"""Many questions to the impact map at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from impact_rs_sim.errors import InputError
from impact_rs_trials.map_table import answer_table, write_answers
from impact_rs_trials.recordings.impact_table import read_impact_table

HEADER = (
    "x [m],y [m],z [m],qx,qy,qz,qw,vx_before [m/s],vy_before [m/s],vz_before [m/s],wx_before [rad/s],"
    "wy_before [rad/s],wz_before [rad/s],mass [kg],size_x [m],size_y [m],size_z [m],"
    "px [m],py [m],pz [m],friction,restitution"
)


def table_of(path: Path, falls: list[float], restitution: float) -> Path:
    """Cubes that fall on the point below their middle."""
    rows = [f"0,0,0.05,0,0,0,1,0,0,{-fall},0,0,0,1,0.1,0.1,0.1,0,0,0,0.2,{restitution}" for fall in falls]
    path.write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    return path


@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_every_row_bounces_with_its_restitution(tmp_path: Path, restitution: float) -> None:
    falls = [0.5 + 0.01 * k for k in range(120)]  # more than one task
    table = read_impact_table(table_of(tmp_path / "tosses.csv", falls, restitution), questions=True)
    answers = answer_table(table)
    assert answers.messages == {}
    np.testing.assert_allclose(answers.after[:, 2], restitution * np.array(falls), atol=1e-6)
    np.testing.assert_allclose(answers.after[:, [0, 1, 3, 4, 5]], 0.0, atol=1e-6)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_answers_are_written_row_by_row(tmp_path: Path, suffix: str) -> None:
    table = read_impact_table(table_of(tmp_path / "tosses.csv", [1.0, 2.0], 0.5), questions=True)
    target = tmp_path / f"answers{suffix}"
    write_answers(table, answer_table(table), target)
    if suffix == ".csv":
        lines = target.read_text(encoding="utf-8").splitlines()
        assert lines[0].startswith("row,condition,vx_after [m/s]")
        assert float(lines[2].split(",")[4]) == pytest.approx(1.0, abs=1e-6)
    else:
        import pyarrow.parquet

        found = pyarrow.parquet.read_table(target).to_pydict()
        assert found["vz_after [m/s]"] == pytest.approx([0.5, 1.0], abs=1e-6)


def test_velocities_after_are_demanded_where_they_are_no_question(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="vx_after"):
        read_impact_table(table_of(tmp_path / "tosses.csv", [1.0], 0.0))
    table = read_impact_table(tmp_path / "tosses.csv", questions=True)
    with pytest.raises(InputError, match=r"\.csv or \.parquet"):
        write_answers(table, answer_table(table), tmp_path / "answers.txt")
