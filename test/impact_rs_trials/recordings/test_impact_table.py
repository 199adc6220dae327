# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts: what is read, and one clear line for everything that cannot be."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from impact_table_cases import CUBE_HEADER, MASS, SIZE, arm_table, cube, cube_rows, write_csv
from refusals import lacking, refusal
from shape_tosses import MASS as PYRAMID_MASS
from shape_tosses import PYRAMID_COM, moments, write_pyramid

from impact_rs_sim.errors import InputError
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.map_table import answer_table, write_answers
from impact_rs_trials.recordings.impacts.impact_checks import warnings_of
from impact_rs_trials.recordings.impacts.impact_columns import documentation
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable, read_impact_table
from impact_rs_trials.recordings.impacts.unsure_scene import nominal_values, with_value

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


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_are_read(tmp_path: Path, cubes: Rows, separator: str) -> None:
    """As a spreadsheet writes them where the comma is the decimal sign. Kills a reader that knows points alone."""
    header, *rows = write(tmp_path / "points.csv", cubes).read_text().splitlines()
    text = [header.replace(",", separator)] + [row.replace(",", separator).replace(".", ",") for row in rows]
    (tmp_path / "commas.csv").write_text("\n".join(text))
    for a, b in zip(read_cubes(tmp_path, cubes).rows, read_impact_table(tmp_path / "commas.csv").rows, strict=True):
        assert a.after == pytest.approx(b.after)


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


def test_assumed_and_unread_columns_are_listed(tmp_path: Path, cubes: Rows) -> None:
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
    assert row.physics.object.inertia == pytest.approx(nominal.moments * 3.0 / nominal.mass)


def rename(old: str, new: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda row: {new if key == old else key: value for key, value in row.items()}


def replaced(**cells: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    def change(row: dict[str, Any]) -> dict[str, Any]:
        names = {key.partition(" ")[0]: key for key in row}
        return row | {names.get(name, name): value for name, value in cells.items()}

    return change


def without(*names: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda row: {key: value for key, value in row.items() if key.partition(" ")[0] not in names}


def with_cells(**cells: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda row: row | cells


CUBES = [  # what happens to every row of a table of cubes, and words that the complaint has
    (rename("mass [kg]", "mas [kg]"), "'mas [kg]'|'mass [kg]'"),
    (without("vx_after"), "'vx_after [m/s]'|x [m], y [m], z [m], qx"),
    (rename("mass [kg]", "mass"), "'mass'|'mass [kg]' or 'mass [g]'"),
    (rename("x [m]", "x [ft]"), "'x [ft]'|'ft'|'x [m]' or 'x [mm]'"),
    (replaced(mass="heavy"), "row 1|'mass [kg]' = 'heavy'|[kg]"),
    (replaced(mass="3_7"), "row 1|'mass [kg]' = '3_7'"),
    (replaced(mass=""), "row 1|'mass [kg]'|empty"),
    (replaced(mass=-1.0), "row 1|'mass [kg]' = -1.0|> 0 [kg]"),
    (replaced(vx_before="nan"), "row 1|'vx_before [m/s]' = nan|finite"),
    (replaced(vx_before="1e300"), "row 1|'vx_before [m/s]' = 1e+300|1e+12"),
    (replaced(restitution=1.5), "'restitution [-]' = 1.5|between 0 and 1"),
    (replaced(qw=3.0), "row 1|(qx, qy, qz, qw) [-] = 3.|unit quaternion"),
    (replaced(vz_before=2.0, wx_before=0.0, wy_before=0.0, wz_before=0.0), "row 1|= 2.0|does not close|< 0 m/s"),
    (without("size_x", "size_y", "size_z"), "where the body touches|size"),
    (without("size_y"), "'size_y [m]'"),
    (with_cells(**{"q1 [rad]": 0.0}), "'q1 [rad]'|--scenario NAME"),
    (with_cells(**{f"n{axis} [-]": 1.0 for axis in "xyz"}), "(nx, ny, nz) [-] = 1.732051"),
]
PUSHES = [
    (replaced(object="cat_fod"), "row 1|'object' = 'cat_fod'|'push'|did you mean"),
    (without("dq3_after"), "'dq3_after [rad/s]'"),
    (with_cells(**{"q99 [rad]": 0.0}), "'q99 [rad]'|'push'"),
    (lambda row: row | {"y [m]": row["y [m]"] - 0.5}, "no pad touches|mm"),
]


@pytest.mark.parametrize(("change", "words"), CUBES, ids=[words for _, words in CUBES])
def test_a_wrong_cell_is_refused_with_row_column_value_and_unit(
    tmp_path: Path, cubes: Rows, change: Callable[[dict[str, Any]], dict[str, Any]], words: str
) -> None:
    said = refusal(read_cubes, tmp_path, [change(row) for row in cubes])
    assert said.startswith(str(tmp_path / "cubes.csv")) and not lacking(said, words)


@pytest.mark.parametrize(("change", "words"), PUSHES, ids=[words for _, words in PUSHES])
def test_a_wrong_cell_of_an_arm_is_refused_with_row_column_and_value(
    tmp_path: Path, pushes: Rows, change: Callable[[dict[str, Any]], dict[str, Any]], words: str
) -> None:
    assert not lacking(refusal(read_pushes, tmp_path, [change(row) for row in pushes]), words)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("cubes.txt", "x", ".csv or .parquet"),
        ("cubes.csv", "", "empty"),
        ("cubes.csv", "# nothing\n", "no header"),
        ("cubes.csv", "x [m],y [m]\n", "no rows"),
        ("cubes.csv", "x [m],x [m]\n1,2\n", "twice|x [m]"),
        ("cubes.csv", "x [m],y [m]\n1\n", "line 2|1 cells|expected 2"),
        ("cubes.parquet", "no table", "Parquet"),
    ],
)
def test_a_file_that_is_no_table_is_refused(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    assert not lacking(refusal(read_impact_table, tmp_path / name), f"{name}|{words}")
    assert not lacking(refusal(read_impact_table, tmp_path / "nowhere.csv"), "nowhere.csv|No such file")


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


def test_a_quantity_in_two_columns_of_different_units_is_refused(tmp_path: Path, cubes: Rows) -> None:
    """Kills a reader that takes the last of them: the mass of every row would be that of the other column."""
    said = refusal(read_cubes, tmp_path, [row | {"mass [g]": 1.0} for row in cubes])
    assert not lacking(said, "'mass [kg]' and 'mass [g]'|expected one of them")


@pytest.mark.parametrize("column", ["v_noise [m/s]", "w_noise_y [rad/s]", "n_noise [rad]"])
def test_a_negative_standard_deviation_is_refused(tmp_path: Path, cubes: Rows, column: str) -> None:
    """Kills a range without a lower end: squared, the sign of the noise would go unnoticed."""
    noise = dict.fromkeys((column, "w_noise_x [rad/s]", "w_noise_y [rad/s]", "w_noise_z [rad/s]"), 0.1)
    rows = [row | noise for row in cubes]
    rows[2][column] = -0.1
    said = refusal(read_cubes, tmp_path, rows)
    assert not lacking(said, f"row 3, column '{column}' = -0.1|expected a number >= 0")


def test_a_number_out_of_range_is_reported_in_the_unit_of_its_column(tmp_path: Path, cubes: Rows) -> None:
    """Kills a message with the number in SI beside the unit of the header: -5 [mm] would read -0.005 [mm]."""
    said = refusal(read_cubes, tmp_path, cubes, **{"contact_tolerance [mm]": -5.0})
    assert not lacking(said, "column 'contact_tolerance [mm]' = -5.0|>= 0 [mm]")


def test_missing_numbers_of_a_parquet_file_are_empty_cells(tmp_path: Path, cubes: Rows) -> None:
    """Kills a reader to which a missing distance is the text nan: rows with one distance would have two."""
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [
        {name: cell for name, cell in row.items() if not name.startswith(("vx_after", "vy_after", "vz_after", "w"))}
        | {f"w{axis}_before [rad/s]": row[f"w{axis}_before [rad/s]"] for axis in "xyz"}
        | {"flight_distance [m]": 0.3, "fall_height [m]": 0.2, "time [s]": None if number == 2 else float(number)}
        for number, row in enumerate(cubes)
    ]
    path = tmp_path / "cubes.parquet"
    parquet.write_table(pyarrow.Table.from_pylist(rows), path)
    assert not lacking(refusal(read_impact_table, path), "row 3, column 'time [s]'|this cell is empty")
    parquet.write_table(pyarrow.Table.from_pylist([row | {"time [s]": 0.0} for row in rows]), path)
    assert [row.distance.measured for row in read_impact_table(path).rows if row.distance] == [0.3] * len(rows)


def test_the_table_of_columns_on_the_page_is_that_of_the_code() -> None:
    """Kills a column that is read or written without a line on the page, and a unit that differs there.

    ``python -c "from impact_rs_trials.recordings.impacts import impact_columns as c; print(c.documentation())"`` prints
    it.
    """
    pages = (Path(__file__).parents[3] / "docs").glob("*.md")
    assert [page.name for page in pages if documentation() in page.read_text(encoding="utf-8")]


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
    assert "scenario 'push' has the shape of its objects" in refusal(
        read_pushes, tmp_path, pushes, **{"radius [m]": 0.1}
    )


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


# ---- what holds under any contact law -------------------------------------------------------------------------------


Cells = Sequence[Sequence[object]]


def times(header: Sequence[str], rows: Cells, columns: Sequence[str], factor: float) -> Cells:
    """The rows with some columns times a factor."""
    places = {header.index(text) for text in header if text.partition(" ")[0] in columns}
    assert len(places) == len(columns)
    return [[factor * x if n in places else x for n, x in enumerate(row)] for row in rows]  # type: ignore[operator]


def tosses(path: Path, columns: Sequence[str] = (), factor: float = -1.0, seed: int = 0, **truth: float) -> ImpactTable:
    """Tossed cubes with some columns times a factor."""
    rows = cube_rows(cube(**{"friction": 0.3, "restitution": 0.3, **truth}), 40, seed)
    return read_impact_table(write_csv(path / "cubes.csv", CUBE_HEADER, times(CUBE_HEADER, rows, columns, factor)))


def pushes_with(path: Path, columns: Sequence[str] = ()) -> ImpactTable:
    header, rows = arm_table({}, 3)
    return read_impact_table(write_csv(path / "pushes.csv", header, times(header, rows, columns, -1.0)), PUSH)


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
    (warning,) = warnings_of(tosses(tmp_path, columns, factor))
    assert warning.endswith(f"factor: {1.0 / factor:.4g} for {', '.join(columns)}")


def test_the_sign_of_x_is_named_however_slippery_the_plane_is(tmp_path: Path) -> None:
    for friction in (0.1, 1.0):
        mirrored = tosses(tmp_path, ("x", "vx_before", "vx_after"), friction=friction, restitution=0.0)
        assert "factor: -1 for vx_before, vx_after" in warnings_of(mirrored)[0]


@pytest.mark.parametrize("joint", [1, 4])
def test_the_sign_of_a_joint_is_named(tmp_path: Path, joint: int) -> None:
    (warning,) = warnings_of(pushes_with(tmp_path, (f"dq{joint}_after",)))
    assert f"factor: -1 for dq{joint}_after" in warning


def test_right_tables_raise_no_doubt_whatever_friction_restitution_and_centre_of_mass(tmp_path: Path) -> None:
    """Ten of them here; of 1,000 with 20 rows each none did."""
    rng = np.random.default_rng(0)
    for seed in range(10):
        truth = {"friction": rng.uniform(0.0, 1.2), "restitution": rng.uniform(0.0, 0.3)}
        if seed % 2:
            truth["com"] = rng.uniform(-0.02, 0.02, 3)
        assert warnings_of(tosses(tmp_path, seed=seed, **truth)) == []
    assert warnings_of(pushes_with(tmp_path)) == []


def test_a_doubt_that_no_factor_explains_has_no_remedy(tmp_path: Path) -> None:
    rows = [list(row) for row in cube_rows(cube(0.3, 0.3), 40)]
    first, last = CUBE_HEADER.index("vx_after [m/s]"), CUBE_HEADER.index("wz_after [rad/s]")
    noise = np.random.default_rng(0).standard_normal((40, last - first + 1)) * ([3.0] * 3 + [60.0] * 3)
    for row, values in zip(rows, noise, strict=True):
        row[first : last + 1] = list(values)
    (warning,) = warnings_of(read_impact_table(write_csv(tmp_path / "noise.csv", CUBE_HEADER, rows)))
    assert "no factor" in warning and "factor: " not in warning


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
    (warning,) = warnings_of(read_impact_table(write_csv(tmp_path / "balls.csv", header, rows)))
    assert warning.startswith("vy_after is") and "another unit?" in warning
    steps = [[*row[:7], row[7] / (1e3 if n >= 20 else 1.0), *row[8:]] for n, row in enumerate(rows)]
    assert warnings_of(read_impact_table(write_csv(tmp_path / "right.csv", header, steps))) == []
    slow = [[0.01 * row[0], *row[1:6], 0.01 * row[6], *row[7:]] if n < 20 else row for n, row in enumerate(steps)]
    assert warnings_of(read_impact_table(write_csv(tmp_path / "blocks.csv", header, slow))) == []  # another condition


# ---- what of a scenario may be unsure -------------------------------------------------------------------------------


GRAB = load_scenario("grab")


def pad_at(scenario: object, joints: np.ndarray) -> np.ndarray:
    """Origin of frame E [m]."""
    physics = Physics.nominal(scenario, next(iter(scenario.objects)))  # type: ignore[attr-defined]
    return np.asarray(next(iter(physics.robot_models().values())).placement(joints).translation)


def test_an_offset_of_the_flange_moves_the_pad_by_as_much_and_one_of_the_first_joint_along_its_axes() -> None:
    joints = np.array(next(iter(PUSH.robots.values())).impact.joint_guess)
    before = pad_at(PUSH, joints)
    moved = pad_at(with_value(PUSH, "flange_x", 0.01), joints) - before
    assert np.linalg.norm(moved) == pytest.approx(0.01)
    base = next(iter(PUSH.robots.values())).base.placement.rotation
    assert pad_at(with_value(PUSH, "joint1_z", 0.02), joints) - before == pytest.approx(0.02 * base[:, 2])


def test_a_longer_tool_moves_the_pad_along_its_axis_and_a_heavier_one_keeps_its_radii() -> None:
    joints = np.array(next(iter(PUSH.robots.values())).impact.joint_guess)
    (robot,) = PUSH.robots.values()
    longer = with_value(PUSH, "tool_length", robot.end_effector.length + 0.05)
    assert np.linalg.norm(pad_at(longer, joints) - pad_at(PUSH, joints)) == pytest.approx(0.05)
    (heavy,) = with_value(PUSH, "tool_mass", 2.0 * robot.end_effector.mass).robots.values()
    assert heavy.end_effector.inertia == pytest.approx(2.0 * np.array(robot.end_effector.inertia))


def test_every_name_changes_what_it_says_and_nothing_else() -> None:
    for scenario in (PUSH, GRAB):
        for name, (value, unit) in nominal_values(scenario).items():
            other = with_value(scenario, name, value + 0.003)
            changed = [
                own for own, (now, _) in nominal_values(other).items() if now != nominal_values(scenario)[own][0]
            ]
            assert changed == ([] if "joint" in name or "flange" in name else [name])
            assert other != scenario and unit in {"m", "kg", "-"}


def test_an_unknown_name_of_the_scene_is_refused_with_the_one_meant(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "pushes.csv", *arm_table({}, 1))
    with pytest.raises(InputError, match="did you mean 'tool_mass'"):
        read_impact_table(path, PUSH, unsure={"tol_mass": (0.1, 0.2)})


# ---- many questions to the impact map at once -----------------------------------------------------------------------


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


CAN = {"mass [kg]": 0.5, "shape": "cylinder", "size_x [m]": 0.08, "size_y [m]": 0.08, "size_z [m]": 0.14}
DROP = {f"v{axis}_{when} [m/s]": speed for when, speed in (("before", -1.0), ("after", 0.5)) for axis in "xyz"}


def lying(axis: Sequence[float], angle: float) -> dict[str, float]:
    """Pose of a body that is turned about an axis, and its motion."""
    quaternion = pin.Quaternion(pin.exp3(angle * np.array(axis))).coeffs().tolist()
    pose = dict(zip(("x [m]", "y [m]", "z [m]"), (0.0, 0.0, 0.1), strict=True))
    return pose | dict(zip(("qx [-]", "qy [-]", "qz [-]", "qw [-]"), quaternion, strict=True)) | DROP | SPIN


@pytest.mark.parametrize(
    ("body", "angle", "count"),
    [
        (CAN, 0.0, 8),  # it stands on its base,
        (CAN, 0.6, 1),  # comes with its rim,
        (CAN, np.pi / 2.0, 2),  # and lies on its wall
        (CAN | {"shape": "capsule"}, 0.0, 1),
        (CAN | {"shape": "capsule"}, np.pi / 2.0 - 0.005, 2),
        (CAN | {"shape": "sphere", "size_z [m]": 0.08}, 0.3, 1),
        (CAN | {"shape": ""}, 0.0, 4),
    ],
)
def test_a_free_body_touches_where_its_shape_does(
    tmp_path: Path, body: dict[str, Any], angle: float, count: int
) -> None:
    (row,) = read_cubes(tmp_path, [body | lying((1.0, 0.0, 0.0), angle)]).rows
    points = np.array([point.position for point in row.impact.points])
    assert len(points) == count
    shape, size = row.physics.object.shape, row.physics.object.size
    depth = float(shape.support(size, -pin.exp3(np.array([angle, 0.0, 0.0]))[2]))
    np.testing.assert_allclose(points[:, 2].min(), 0.1 - depth, atol=1e-12)
    assert np.ptp(points[:, 2]) <= 1e-3


def test_the_rim_of_a_can_touches_as_a_whole_where_its_tilt_is_below_the_tolerance(tmp_path: Path) -> None:
    """8 mm across the base of 80 mm at a tilt of 0.1; kills neighbours on a rim that are taken for other contacts."""
    pose = CAN | lying((1.0, 0.0, 0.0), 0.1)
    counts = [
        len(read_cubes(tmp_path, [pose | {"contact_tolerance [mm]": tolerance}]).rows[0].impact.points)
        for tolerance in (1.0, 7.5, 8.5)
    ]
    assert counts == [1, 1, 8]


def test_a_mesh_gives_hull_centre_of_mass_and_moments_and_may_be_stretched(tmp_path: Path) -> None:
    """A pyramid: com at a quarter of its height, moments by tables of solids; in a file of other units, its extents."""
    write_pyramid(tmp_path / "pyramid.stl")
    row = {"mass [kg]": PYRAMID_MASS, "mesh": "pyramid.stl"} | lying((1.0, 0.0, 0.0), 0.0)
    (own,) = read_cubes(tmp_path, [row]).rows
    np.testing.assert_allclose(own.physics.object.com_offset, PYRAMID_COM, atol=1e-9)
    np.testing.assert_allclose(own.physics.object.inertia, moments("mesh"), rtol=1e-6)
    assert len(own.impact.points) == 4
    a, b, c = 0.2, 0.05, 0.3
    sizes = dict(zip(("size_x [m]", "size_y [m]", "size_z [m]"), (a, b, c), strict=True))
    (other,) = read_cubes(tmp_path, [row | sizes]).rows
    squares = np.array([a * a / 20.0, b * b / 20.0, 3.0 * c * c / 80.0])
    np.testing.assert_allclose(other.physics.object.inertia, PYRAMID_MASS * (squares.sum() - squares), rtol=1e-6)
    np.testing.assert_allclose(other.physics.object.com_offset, [0.0, 0.0, -c / 4.0], atol=1e-9)
    np.testing.assert_allclose(np.ptp([one.position for one in other.impact.points], axis=0), [a, b, 0.0], atol=1e-9)


def test_another_mesh_under_one_name_is_another_table(tmp_path: Path) -> None:
    row = {"mass [kg]": PYRAMID_MASS, "mesh": "pyramid.stl"} | lying((1.0, 0.0, 0.0), 0.0)
    digests = []
    for end in ("", "\n"):
        path = write_pyramid(tmp_path / "pyramid.stl")
        path.write_text(path.read_text() + end)
        digests.append(read_cubes(tmp_path, [row]).digest)
    assert digests[0] != digests[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": "cylindre"}, r"column 'shape' = 'cylindre': expected .*cylinder; did you mean 'cylinder'"),
        ({"shape": "hull"}, "column or key mesh names the file of a mesh"),
        ({"size_y [m]": 0.09}, "a cylinder is round: size needs equal extents along x and y"),
        ({"mesh": "other.stl"}, "expected one of them"),
        ({"shape": "", "mesh": "other.stl"}, r"row 1, column 'mesh' = 'other.stl': no such file"),
        ({"radius [m]": 0.04}, "expected one of them; a ball touches below"),
    ],
)
def test_a_shape_that_cannot_be_is_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    row = CAN | lying((1.0, 0.0, 0.0), 0.4) | change
    assert re.search(message, refusal(read_cubes, tmp_path, [row]))


def test_a_shape_needs_extents_and_a_scenario_has_its_own(tmp_path: Path, pushes: Rows) -> None:
    row = without("size_x", "size_y", "size_z")(CAN | lying((1.0, 0.0, 0.0), 0.4))
    assert "column 'shape' without 'size_x [m]'" in refusal(read_cubes, tmp_path, [row])
    for name in ("shape", "mesh"):
        said = refusal(read_pushes, tmp_path, pushes, **{name: "box"})
        assert "scenario 'push' has the shape of its objects" in said


def test_an_unsure_radius_of_a_can_is_one_of_x_and_y(tmp_path: Path) -> None:
    path = write(tmp_path / "cans.csv", [CAN | lying((1.0, 0.0, 0.0), 0.4)])
    variants = read_impact_table(path, unsure={"size_x": (0.07, 0.09)}).variants
    sizes = np.array([one.table.rows[0].physics.object.size for one in variants])
    np.testing.assert_allclose(sizes[:, 0], sizes[:, 1])
    assert sizes[:, 0].min() == pytest.approx(0.07) and sizes[:, 0].max() == pytest.approx(0.09)
    np.testing.assert_allclose(sizes[:, 2], 0.14)


def test_a_scenario_with_neighbours_has_no_table_of_impacts(tmp_path: Path, pushes: Rows) -> None:
    """Else the neighbour would be left out of the prediction without a word."""
    rows = [row | {"object": "box"} for row in pushes]
    said = refusal(read_impact_table, write(tmp_path / "pushes.csv", rows), load_scenario("push_two_boxes"))
    assert "has neighbours, whose poses no table has: behind; take trials" in said
