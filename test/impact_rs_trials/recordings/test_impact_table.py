# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts: what is read, and one clear line for everything that cannot be."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from impact_table_cases import CUBE_HEADER, MASS, SIZE, arm_table, cube, cube_rows, write_csv
from refusals import refusal

from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings import impact_table
from impact_rs_trials.recordings.impact_table import ImpactTable, read_impact_table

PUSH = load_scenario("push")
Rows = list[dict[str, Any]]  # by header


@pytest.fixture(scope="module")
def cubes() -> Rows:
    """Five impacts by header."""
    return [dict(zip(CUBE_HEADER, row, strict=True)) for row in cube_rows(cube(0.2, 0.3), 5)]


@pytest.fixture(scope="module")
def pushes() -> Rows:
    """Impacts of the arm by header."""
    header, rows = arm_table({}, 1)
    return [dict(zip(header, row, strict=True)) for row in rows]


def write(path: Path, rows: Rows, **further: Any) -> Path:
    """A table of rows by header, with ``further`` cells that are the same in every row."""
    rows = [row | further for row in rows]
    return write_csv(path, list(rows[0]), [list(row.values()) for row in rows])


def read_cubes(folder: Path, rows: Rows, **further: Any) -> ImpactTable:
    return read_impact_table(write(folder / "cubes.csv", rows, **further))


def read_pushes(folder: Path, rows: Rows, **further: Any) -> ImpactTable:
    return read_impact_table(write(folder / "pushes.csv", rows, **further), PUSH)


def test_a_cube_comes_out_as_it_went_in(tmp_path: Path, cubes: Rows) -> None:
    table = read_cubes(tmp_path, cubes)
    assert (len(table.rows), table.arms, table.noise, table.assumed, table.unread) == (5, (), None, (), ())
    for row, cells in zip(table.rows, cubes, strict=True):
        assert row.impact.object.position == pytest.approx([cells[f"{axis} [m]"] for axis in "xyz"])
        assert row.impact.object.twist[2] == pytest.approx(cells["vz_before [m/s]"])
        assert row.after[3] == pytest.approx(cells["wx_after [rad/s]"])
        assert row.physics.object.inertia == pytest.approx(MASS * SIZE**2 / 6.0)  # a homogeneous cube
        assert row.physics.support_friction == 0.5
    assert table.rows[0].physics is table.rows[1].physics


def test_parquet_says_what_csv_says(tmp_path: Path, cubes: Rows) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pyarrow.Table.from_pylist(cubes), tmp_path / "cubes.parquet")
    other = read_impact_table(tmp_path / "cubes.parquet")
    for a, b in zip(read_cubes(tmp_path, cubes).rows, other.rows, strict=True):
        assert a.after == pytest.approx(b.after)
        assert a.impact.object.rotation == pytest.approx(b.impact.object.rotation)


def test_units_of_the_header_are_turned_into_si(tmp_path: Path, cubes: Rows) -> None:
    si, others = (
        read_cubes(tmp_path, cubes),
        {
            "mass [kg]": ("mass [g]", 1e3),
            "size_x [m]": ("size_x [mm]", 1e3),
            "wz_after [rad/s]": ("wz_after [deg/s]", 180.0 / np.pi),
        },
    )
    rows = [
        {others.get(key, (key,))[0]: value * others[key][1] if key in others else value for key, value in row.items()}
        for row in cubes
    ]
    for a, b in zip(si.rows, read_cubes(tmp_path, rows).rows, strict=True):
        assert a.after == pytest.approx(b.after)
        assert a.physics.object.mass == pytest.approx(b.physics.object.mass)
        assert a.physics.object.size == pytest.approx(b.physics.object.size)


def test_contact_points_and_normal_may_be_given(tmp_path: Path, cubes: Rows) -> None:
    geometric = read_cubes(tmp_path, cubes).rows[0].impact.points[0]
    given = {f"p{axis} [m]": value for axis, value in zip("xyz", geometric.position, strict=True)}
    given |= {"px2 [m]": "", "py2 [m]": "", "pz2 [m]": "", "nx [-]": 0.0, "ny [-]": 0.0, "nz [-]": 1.0}
    (row,) = read_cubes(tmp_path, cubes[:1], **given).rows
    (point,) = row.impact.points
    assert point.position == pytest.approx(geometric.position)
    assert point.normal == pytest.approx(geometric.normal)


def test_what_is_assumed_and_what_is_not_read_is_said(tmp_path: Path, cubes: Rows) -> None:
    table = read_cubes(tmp_path, [without("friction", "restitution")(row) for row in cubes], who="me")
    assert table.unread == ("who",)
    assert len(table.assumed) == 2
    assert "'friction [-]': 0.3 is assumed" in table.assumed[0]


def test_impacts_of_an_arm_take_robot_pad_and_support_from_the_scenario(tmp_path: Path, pushes: Rows) -> None:
    table = read_pushes(tmp_path, pushes)
    (name,) = table.arms
    for row, cells in zip(table.rows, pushes, strict=True):
        assert (row.object_name, row.condition) == (cells["object"], cells["condition"])
        assert row.impact.arms[name].position[0] == pytest.approx(cells["q1 [rad]"])
        assert row.after[1] == pytest.approx(cells["dq2_after [rad/s]"])
        assert {point.partner for point in row.impact.points} == {name, "support"}
        assert row.physics.object.mass == PUSH.objects[row.object_name].mass


def test_motor_inertia_and_mass_of_a_table_go_before_those_of_the_scenario(tmp_path: Path, pushes: Rows) -> None:
    (name,) = PUSH.robots
    count = PUSH.robots[name].robot_facts.joint_count
    own = {f"B{joint + 1} [kg m^2]": 0.1 * (joint + 1) for joint in range(count)} | {"mass [kg]": 3.0}
    (row,) = read_pushes(tmp_path, pushes[:1], **own).rows
    assert row.physics.arms[name].motor_inertia_reduced == pytest.approx(0.1 * np.arange(1, count + 1))
    nominal = PUSH.objects[row.object_name]
    assert row.physics.object.mass == 3.0
    assert row.physics.object.inertia == pytest.approx(nominal.inertia * 3.0 / nominal.mass)


def rename(old: str, new: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda row: {new if key == old else key: value for key, value in row.items()}


def replaced(**cells: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    def change(row: dict[str, Any]) -> dict[str, Any]:
        names = {key.partition(" ")[0]: key for key in row}
        return row | {names.get(name, name): value for name, value in cells.items()}

    return change


def without(*names: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda row: {key: value for key, value in row.items() if key.partition(" ")[0] not in names}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (rename("mass [kg]", "mas [kg]"), r"no column is called 'mas \[kg\]'; did you mean 'mass \[kg\]'\?"),
        (without("vx_after"), r"no column 'vx_after \[m/s\]'; there are: x \[m\], y \[m\], z \[m\], qx"),
        (rename("mass [kg]", "mass"), r"column 'mass' has no unit; expected 'mass \[kg\]' or 'mass \[g\]'"),
        (rename("x [m]", "x [ft]"), r"column 'x \[ft\]' has unit 'ft'; expected 'x \[m\]' or 'x \[mm\]'"),
        (replaced(mass="heavy"), r"row 1, column 'mass \[kg\]' = 'heavy': expected a number \[kg\]"),
        (replaced(mass="3_7"), r"row 1, column 'mass \[kg\]' = '3_7': expected a number"),
        (replaced(mass=""), r"row 1, column 'mass \[kg\]': this cell is empty; expected a number \[kg\]"),
        (replaced(mass=-1.0), r"row 1, column 'mass \[kg\]' = -1.0: expected a number > 0 \[kg\]"),
        (replaced(vx_before="nan"), r"row 1, column 'vx_before \[m/s\]' = nan: expected a finite number \[m/s\]"),
        (replaced(vx_before="1e300"), r"row 1, column 'vx_before \[m/s\]' = 1e\+300: expected a number up to 1e\+12"),
        (replaced(restitution=1.5), r"'restitution \[-\]' = 1.5: expected a number between 0 and 1 \[-\]"),
        (replaced(qw=3.0), r"row 1, length of \(qx, qy, qz, qw\) \[-\] = 3\.\d+: expected a unit quaternion"),
        (
            replaced(vz_before=2.0, wx_before=0.0, wy_before=0.0, wz_before=0.0),
            r"row 1, normal velocity of the contact before \[m/s\] = 2.0: no impact: the contact does not close; "
            r"expected a velocity < 0 m/s",
        ),
        (without("size_x", "size_y", "size_z"), r"nothing says where the body touches; expected its size"),
        (without("size_y"), r"no column 'size_y \[m\]'; there are: x \[m\], "),
        (lambda row: row | {"q1 [rad]": 0.0}, r"column 'q1 \[rad\]' is of an arm; --scenario NAME says which"),
        (lambda row: row | {f"n{a} [-]": 1.0 for a in "xyz"}, r"length of \(nx, ny, nz\) \[-\] = 1.732051: expected a"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_in_one_line(
    tmp_path: Path, cubes: Rows, change: Callable[[dict[str, Any]], dict[str, Any]], message: str
) -> None:
    said = refusal(read_cubes, tmp_path, [change(row) for row in cubes])
    assert said.startswith(str(tmp_path / "cubes.csv")) and re.search(message, said)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (replaced(object="cat_fod"), r"row 1, column 'object' = 'cat_fod': expected an object of scenario 'push'; did"),
        (without("dq3_after"), r"no column 'dq3_after \[rad/s\]'"),
        (lambda row: row | {"q99 [rad]": 0.0}, r"column 'q99 \[rad\]' is of no joint of scenario 'push'"),
        (lambda row: row | {"y [m]": row["y [m]"] - 0.5}, r"no pad touches the object: the nearest is \d+ mm away"),
    ],
)  # fmt: skip
def test_so_it_is_of_impacts_of_an_arm(
    tmp_path: Path, pushes: Rows, change: Callable[[dict[str, Any]], dict[str, Any]], message: str
) -> None:
    assert re.search(message, refusal(read_pushes, tmp_path, [change(row) for row in pushes]))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cubes.txt", "x", r"expected a table of impacts \(.csv or .parquet\)"),
        ("cubes.csv", "", "this file is empty"),
        ("cubes.csv", "# nothing\n", "no header"),
        ("cubes.csv", "x [m],y [m]\n", "no rows; expected one per impact"),
        ("cubes.csv", "x [m],x [m]\n1,2\n", r"columns that appear twice: x \[m\]"),
        ("cubes.csv", "x [m],y [m]\n1\n", "row 1: expected 2 cells as in the header, got 1"),
        ("cubes.parquet", "no table", "not a readable Parquet file"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    assert re.search(message, refusal(read_impact_table, tmp_path / name))
    assert "cannot be read: No such file" in refusal(read_impact_table, tmp_path / "nowhere.csv")


@pytest.mark.parametrize("moments", [(1.0, 1e-9, 1e-9), (1e-9, 1.0, 1e-9), (0.2, 0.1, 0.301)])
def test_moments_that_no_body_has_are_refused(tmp_path: Path, cubes: Rows, moments: tuple[float, float, float]) -> None:
    own = dict(zip(("ixx [kg m^2]", "iyy [kg m^2]", "izz [kg m^2]"), moments, strict=True))
    message = "row 1, columns 'ixx', 'iyy', 'izz' .*no body has these principal moments"
    assert re.search(message, refusal(read_cubes, tmp_path, cubes, **own))


def test_a_thin_plate_is_a_body(tmp_path: Path, cubes: Rows) -> None:
    own = {"ixx [kg m^2]": 0.1, "iyy [kg m^2]": 0.1, "izz [kg m^2]": 0.2}
    table = read_cubes(tmp_path, cubes, **own)
    assert table.rows[0].physics.object.inertia == pytest.approx([0.1, 0.1, 0.2])


def test_noise_stands_in_the_order_of_the_velocities(tmp_path: Path, cubes: Rows, pushes: Rows) -> None:
    own = {"v_noise [m/s]": 0.01, "w_noise [rad/s]": 0.2}
    free = read_cubes(tmp_path, cubes, **own)
    np.testing.assert_allclose(free.noise, np.tile([0.01] * 3 + [0.2] * 3, (5, 1)))
    arm = read_pushes(tmp_path, pushes, **own, **{"dq_noise [rad/s]": 0.003})
    np.testing.assert_allclose(arm.noise[0], [0.003] * 7 + [0.01] * 3 + [0.2] * 3)


def test_noise_of_one_kind_may_be_unknown_and_that_is_said(tmp_path: Path, cubes: Rows) -> None:
    table = read_cubes(tmp_path, cubes, **{"v_noise [m/s]": 0.01})
    np.testing.assert_allclose(table.noise, np.tile([0.01] * 3 + [0.0] * 3, (5, 1)))
    (said,) = (text for text in table.assumed if "w_noise" in text)
    assert "of w*_after is noise is not known; without these columns" in said
    assert not any("v_noise" in text for text in table.assumed)


def test_every_column_is_documented() -> None:
    """In the module as on the page; of columns alike for all axes or points, the first."""
    page = (Path(__file__).parents[3] / "docs" / "your_data.md").read_text(encoding="utf-8")
    known = {**impact_table.POSE, **impact_table.TWISTS, **impact_table.BODY}
    others = ("y", "z", "qy", "qz", "qw", "iyy", "izz", "size_y", "size_z", "ny", "nz", "py", "pz")
    firsts = [n for n in known if n not in others and n[1:2] not in ("y", "z") and not n[-1].isdigit()]
    for name in [*firsts, "px2", "q1", "dq1_before", "B1"]:
        if name.endswith("_after") or name.startswith("dq1"):
            continue  # named with the one before
        assert f"``{name}``" in (impact_table.__doc__ or ""), name
        assert f"`{name}`" in page, name


def test_a_row_without_contact_points_takes_those_of_the_geometry(tmp_path: Path, cubes: Rows) -> None:
    lowest = [read_cubes(tmp_path, cubes).rows[number].impact.points[0].position for number in range(2)]
    given = [row | dict.fromkeys(("px [m]", "py [m]", "pz [m]"), "") for row in cubes]
    given[1] |= dict(zip(("px [m]", "py [m]", "pz [m]"), (lowest[1] + 0.001).tolist(), strict=True))
    table = read_cubes(tmp_path, given)
    np.testing.assert_allclose(table.rows[0].impact.points[0].position, lowest[0])
    np.testing.assert_allclose(table.rows[1].impact.points[0].position, lowest[1] + 0.001)


BALL = {"mass [g]": 2.7, "radius [mm]": 20.0}
FALL = {f"v{axis}_{when} [m/s]": speed for when, speed in (("before", -1.0), ("after", 0.5)) for axis in "xyz"}
SPIN = {f"w{axis}_{when} [rad/s]": 3.0 for when in ("before", "after") for axis in "xyz"}


@pytest.mark.parametrize(("shell", "share"), [({}, 0.4), ({"shell [-]": 0}, 0.4), ({"shell [-]": 1}, 2.0 / 3.0)])
def test_a_ball_touches_below_its_centre(tmp_path: Path, shell: dict[str, float], share: float) -> None:
    normal = dict(zip(("nx [-]", "ny [-]", "nz [-]"), (0.6, 0.0, 0.8), strict=True))
    (row,) = read_cubes(tmp_path, [BALL | FALL | SPIN | shell | normal]).rows
    np.testing.assert_allclose(row.physics.object.inertia, share * 0.0027 * 0.02**2)
    np.testing.assert_allclose(row.impact.points[0].position, [-0.012, 0.0, -0.016])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shell [-]": 0.5}, r"column 'shell \[-\]' = 0.5: expected a number 0 \(solid\) or 1 \[-\]"),
        ({"radius [mm]": 0.0}, r"column 'radius \[mm\]' = 0.0: expected a number > 0 \[mm\]"),
        (dict.fromkeys(("size_x [m]", "size_y [m]", "size_z [m]"), 0.1), "expected one of them; a ball touches below"),
        (dict.fromkeys(("px [m]", "py [m]", "pz [m]"), 0.1), "expected one of them; a ball touches below"),
    ],
)
def test_a_ball_that_cannot_be_is_refused(tmp_path: Path, change: dict[str, float], message: str) -> None:
    assert re.search(message, refusal(read_cubes, tmp_path, [BALL | FALL | SPIN | change]))


def test_a_shell_needs_a_radius_and_a_scenario_has_no_balls(tmp_path: Path, cubes: Rows, pushes: Rows) -> None:
    assert "it is of balls" in refusal(read_cubes, tmp_path, cubes, **{"shell [-]": 1})
    assert "objects of scenario 'push' are boxes" in refusal(read_pushes, tmp_path, pushes, **{"radius [m]": 0.1})


def test_a_covariate_of_numbers_is_a_number_and_any_other_holds_levels(tmp_path: Path, cubes: Rows) -> None:
    own = [{"run": number, "mas [bar]": f"{number}.5", "place": ("1", "two")[number % 2]} for number in range(5)]
    rows = [row | more for row, more in zip(cubes, own, strict=True)]
    path = write(tmp_path / "cubes.csv", rows)
    table = read_impact_table(path, covariates=("mas", "place", "mass"))
    assert (table.covariates, table.unread) == ({"mas": "bar", "place": "", "mass": "kg"}, ("run",))
    assert [row.circumstances for row in table.rows[:2]] == [
        {"mas": 0.5, "place": "1", "mass": MASS},
        {"mas": 1.5, "place": "two", "mass": MASS},
    ]
    assert table.rows[0].physics is table.rows[1].physics  # circumstances are no assumption


def test_a_covariate_that_is_not_there_or_empty_is_refused(tmp_path: Path, cubes: Rows) -> None:
    path = write(tmp_path / "cubes.csv", [row | {"session": "A" if n else " "} for n, row in enumerate(cubes)])
    said = refusal(lambda: read_impact_table(path, covariates=["sesion"]))
    assert "--covariates: no column 'sesion'; did you mean 'session'?" in said
    said = refusal(lambda: read_impact_table(path, covariates=["session"]))
    assert "row 1, column 'session': this cell is empty" in said
    path = write(tmp_path / "cubes.csv", [row | {"warmth [K]": 300 if n else "nan"} for n, row in enumerate(cubes)])
    said = refusal(lambda: read_impact_table(path, covariates=["warmth"]))
    assert "row 1, column 'warmth [K]' = nan: expected a finite number" in said
    assert "named twice" in refusal(lambda: read_impact_table(path, covariates=["warmth", "warmth"]))
