# SPDX-License-Identifier: Apache-2.0
"""Tables whose velocities were measured in axes of another frame, or at a point beside the centre.

Balls bounce by closed forms and cubes by the map; readings are made of the true twists with numpy alone.
"""

from __future__ import annotations

import csv
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ball_impacts import Racket, ball_table
from impact_table_cases import CUBE_HEADER, NOISE, cube, cube_rows, write_csv

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.effects import library
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_checks import other_axes, warnings_of
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

NOMINAL = load_model(Path("nominal"))
RACKET = Racket(lambda speed: 0.6, 0.3)  # as is believed
FRAMES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
ABOUT_Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
Y_FOR_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])  # a mirror
CONTACT = ["restitution", "support_friction", "tangential_restitution", "drilling_friction", "rolling_resistance"]


def balls(path: Path, frame: np.ndarray, rows: int = 90, walls: bool = False) -> Path:
    """Balls whose spins are read in other axes, which may be left-handed ones: ``w = F omega``.

    Args:
        path: The table.
        frame: F.
        rows: Number of impacts.
        walls: Whether each hits a wall of another normal; on one plane the sense of the spin about it is not seen.
    """
    ball_table(path, RACKET, rows=rows, noise=(0.05, 3.0), friction=0.3, restitution=0.6)
    header, *cells = list(csv.reader(path.open()))
    values, rng = np.array(cells, dtype=float), np.random.default_rng(3)
    turns = [pin.Quaternion(*rng.standard_normal(4)).normalized().matrix() if walls else np.eye(3) for _ in cells]
    for kind, tail in product("vw", ("before", "after")):
        own = [place for place, name in enumerate(header) if name[0] == kind and name[2:].startswith(f"_{tail}")]
        seen = np.einsum("nij,nj->ni", turns, values[:, own])
        values[:, own] = seen @ frame.T if kind == "w" else seen
    normals = [turn[:, 2] for turn in turns]
    return write_csv(path, [*header, "nx [-]", "ny [-]", "nz [-]"], np.hstack((values, normals)).tolist())


def test_each_frame_of_spins_is_found_by_laws_that_hold_for_every_contact(tmp_path: Path) -> None:
    """All 24 turns and their mirrors; kills a transposed turn, a lost sign, and a turn that is left out."""
    assert len(FRAMES) == 48
    for frame in FRAMES:
        table = read_impact_table(balls(tmp_path / "balls.csv", frame, rows=8, walls=True))
        found = other_axes(table)
        if np.array_equal(frame, np.eye(3)):
            assert found == []
            continue
        assert [other.of for other in found] == ["spins"]
        np.testing.assert_allclose(found[0].sign * found[0].rotation, frame)
        np.testing.assert_allclose(found[0].sign * pin.exp3(found[0].vector), frame, atol=1e-9)


def test_the_axes_are_said_in_words(tmp_path: Path) -> None:
    table = read_impact_table(balls(tmp_path / "balls.csv", ABOUT_Z))
    (warning,) = warnings_of(table)
    assert warning.endswith("are left where angular velocities are in axes turned by 90 degrees about z")
    table = read_impact_table(balls(tmp_path / "balls.csv", -np.eye(3), walls=True))
    assert other_axes(table)[0].in_words == "angular velocities are in left-handed axes"


@pytest.mark.parametrize(
    ("frame", "name"),
    [
        (ABOUT_Z, "spin_axes"),
        pytest.param(ABOUT_Z @ ABOUT_Z, "spin_axes", marks=pytest.mark.slow),
        pytest.param(Y_FOR_Z, "mirrored_spins", marks=pytest.mark.slow),
    ],
)
def test_spins_of_another_frame_are_a_fault_of_the_reading(tmp_path: Path, frame: np.ndarray, name: str) -> None:
    """No effect of the contact is named for them; kills a fit that starts at nominal alone."""
    table = read_impact_table(balls(tmp_path / "balls.csv", frame, walls=name == "mirrored_spins"))
    source = ImpactTableSource(table, NOMINAL)
    document = diagnose(source, NOMINAL, [*CONTACT, "spin_axes", "mirrored_spins"])
    assert document.named == (name,)
    assert document.summary.startswith("The measurement: angular velocities are in "), document.summary
    found = document.effect(name).parameters
    turn = pin.exp3(np.array([found[axis].estimate for axis in "xyz"]))
    sign = found["factor"].estimate if "factor" in found else 1.0
    np.testing.assert_allclose(sign * turn, frame, atol=0.02)
    assert document.held_out_error_after < 1.1 * document.noise_floor


def test_a_mirror_that_no_impact_shows_is_not_named(tmp_path: Path) -> None:
    """On one plane a mirrored turn and a plain one do the same; kills a hand of the axes that the laws do not show."""
    assert {other.sign for other in other_axes(read_impact_table(balls(tmp_path / "balls.csv", Y_FOR_Z)))} == {1.0}
    assert not other_axes(read_impact_table(balls(tmp_path / "balls.csv", np.diag([1.0, 1.0, -1.0]))))


def test_nothing_is_offered_and_nothing_named_where_the_axes_are_right(tmp_path: Path) -> None:
    """Kills starts, and effects of readings, that are tried on every table."""
    source = ImpactTableSource(read_impact_table(balls(tmp_path / "balls.csv", np.eye(3))), NOMINAL)
    offered = {name for name, effect in library().items() if effect.acts_on == "sensing" and source.offers(effect)}
    assert offered == {"spin_axes"}  # a ball whose orientation is not known has no tracked point
    assert [len(source.starts(name)) for name in ("spin_axes", "mirrored_spins", "twist_axes")] == [0, 0, 0]
    assert not diagnose(source, NOMINAL, [*CONTACT, "spin_axes"]).named


def cubes(path: Path, count: int = 60) -> Path:
    return write_csv(path, [*CUBE_HEADER, "v_noise [m/s]", "w_noise [rad/s]"], noisy(cube_rows(cube(), count)))


def noisy(rows: list[list[float]]) -> list[list[float]]:
    """Rows with their noise in two more columns."""
    return [[*row, *NOISE[:2]] for row in rows]


def test_velocities_of_another_frame_than_the_pose_are_found(tmp_path: Path) -> None:
    """Both velocities turned about the normal, beside which contacts still close: the lever decides."""
    rows = np.array(cube_rows(cube(), 30))
    for start in (7, 10, 13, 16):
        rows[:, start : start + 3] = rows[:, start : start + 3] @ ABOUT_Z.T
    path = tmp_path / "cubes.csv"
    kept = []
    for row in noisy(rows.tolist()):
        try:  # the spin of some would open the contact
            read_impact_table(write_csv(path, [*CUBE_HEADER, "v_noise [m/s]", "w_noise [rad/s]"], [row]))
        except ValueError:
            continue
        kept.append(row)
    assert len(kept) > 20
    table = read_impact_table(write_csv(path, [*CUBE_HEADER, "v_noise [m/s]", "w_noise [rad/s]"], kept))
    (found,) = other_axes(table)
    assert found.of == "twists"
    np.testing.assert_allclose(found.rotation, ABOUT_Z)
    assert found.in_words == "velocities and angular velocities are in axes turned by 90 degrees about z"


@pytest.mark.slow
@pytest.mark.parametrize("measured_points", [False, True])
def test_a_marker_beside_the_centre_is_found(tmp_path: Path, measured_points: bool) -> None:
    """10 mm off; kills a lever that is not turned with the body, and contact points that move with a wrong centre."""
    offset = np.array([0.01, -0.004, 0.006])
    rng, rows = np.random.default_rng(1), []
    for row in cube_rows(cube(), 120, noise=False):
        own = np.array(row)
        turn = pin.Quaternion(*own[[6, 3, 4, 5]]).matrix()
        low = (turn @ (np.array(list(product((-0.05, 0.05), repeat=3)))).T).T
        corner = own[:3] + low[np.argmin(low[:, 2])]
        lever = turn @ offset
        own[:3] += lever
        for start in (7, 13):
            own[start : start + 3] += np.cross(own[start + 3 : start + 6], lever)
        own[13:19] += np.repeat(NOISE[:2], 3) * rng.standard_normal(6)
        rows.append([*own, *NOISE[:2], *(corner if measured_points else ())])
    header = [*CUBE_HEADER, "v_noise [m/s]", "w_noise [rad/s]"]
    header += [f"p{axis} [m]" for axis in "xyz"] if measured_points else []
    source = ImpactTableSource(read_impact_table(write_csv(tmp_path / "cubes.csv", header, rows)), NOMINAL)
    effects = ["restitution", "support_friction", "object_com_offset", "spin_axes", "tracked_point_of_impact"]
    document = diagnose(source, NOMINAL, effects)
    assert document.named == ("tracked_point_of_impact",)
    for axis, truth in zip("xyz", offset, strict=True):
        found = document.effect("tracked_point_of_impact").parameters[axis]
        low, high = found.interval
        assert low <= truth <= high and high - low < 0.004, axis


def test_cubes_that_are_tracked_at_their_centre_have_no_marker_beside_it(tmp_path: Path) -> None:
    source = ImpactTableSource(read_impact_table(cubes(tmp_path / "cubes.csv")), NOMINAL)
    assert source.offers(library()["tracked_point_of_impact"])
    assert not diagnose(source, NOMINAL, ["support_friction", "spin_axes", "tracked_point_of_impact"]).named


def test_noise_by_axis_is_that_of_the_contact_axes(tmp_path: Path) -> None:
    """diag(T C T^T); kills noise that is not turned with the features, and columns in another order."""
    path = balls(tmp_path / "balls.csv", np.eye(3), rows=12)
    header, *cells = list(csv.reader(path.open()))
    noise = np.array([0.03, 0.05, 0.02, 1.0, 4.0, 2.0])
    kept = [place for place, name in enumerate(header) if "noise" not in name]
    names = [f"{kind}_noise_{axis} [{unit}]" for kind, unit in (("v", "m/s"), ("w", "rad/s")) for axis in "xyz"]
    rows = [[*(row[place] for place in kept), *noise] for row in cells]
    table = read_impact_table(write_csv(path, [*(header[place] for place in kept), *names], rows))
    assert not table.assumed and not table.unread
    np.testing.assert_array_equal(table.noise[3], noise)
    source = ImpactTableSource(table, NOMINAL)
    impact = table.rows[3].impact
    normal = np.array([0.0, 0.0, 1.0])
    slip = impact.object.point_velocity(impact.points[0].position) * [1.0, 1.0, 0.0]
    sliding = slip / np.linalg.norm(slip)
    expected = [
        np.sqrt(np.square(direction) @ np.square(part))
        for part in (noise[:3], noise[3:])
        for direction in (normal, sliding, np.cross(normal, sliding))
    ]
    np.testing.assert_allclose(source.noise[3], expected)
