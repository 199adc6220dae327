# SPDX-License-Identifier: Apache-2.0
"""Geometry that is not known well: whether a verdict turns on it, and intervals that hold over its range."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ball_impacts import RADIUS, Racket, ball_table
from impact_table_cases import CUBE_HEADER, cube, cube_rows, write_csv
from refusals import refusal

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

NOMINAL = load_model(Path("nominal"))
NOISE = (0.1, 10.0)  # m/s, rad/s
CONSIDERED = ["restitution", "support_friction"]


def diagnosed(path: Path, effects: Sequence[str] = CONSIDERED, **unsure: tuple[float, float]) -> DiagnosisDocument:
    return diagnose(ImpactTableSource(read_impact_table(path, unsure=unsure), NOMINAL), NOMINAL, effects)


def tracked(rows: Sequence[Sequence[float]], offset: Sequence[float]) -> list[list[float]]:
    """Rows of a point of the body beside its centre, which is what a tracker measured."""
    found = []
    for row in rows:
        own = np.array(row, dtype=float)
        lever = pin.Quaternion(own[3:7]).matrix() @ offset
        own[:3] += lever
        for start in (7, 13):
            own[start : start + 3] += np.cross(own[start + 3 : start + 6], lever)
        found.append(own.tolist())
    return found


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Balls with mu = 0.2 and e = 0.55 that are believed to have 0.3 and 0."""
    path, racket = tmp_path_factory.mktemp("balls") / "balls.csv", Racket(lambda speed: 0.55, 0.2)
    return ball_table(path, racket, rows=40, noise=NOISE, stated=False, friction=0.3, restitution=0.0)


@pytest.mark.slow
def test_a_size_on_which_nothing_turns_widens_the_intervals(balls: Path) -> None:
    plain, unsure = diagnosed(balls), diagnosed(balls, radius=(0.019, 0.021))
    assert unsure.named == plain.named
    assert "The names stay over the whole range of radius, 0.019 to 0.021 m: restitution 0.5" in unsure.summary
    inner, outer = (one.effect("support_friction").parameters["friction"] for one in (plain, unsure))
    assert outer.estimate == inner.estimate
    assert outer.interval[0] < inner.interval[0] - 0.001 and outer.interval[1] > inner.interval[1] + 0.001
    assert [view.value for view in unsure.views] == pytest.approx([0.019, 0.0195, 0.01975, 0.02025, 0.0205, 0.021])


@pytest.mark.slow
def test_the_mass_of_a_free_body_changes_no_interval(balls: Path) -> None:
    """Against a fixed body it cancels."""
    plain, unsure = diagnosed(balls), diagnosed(balls, mass=(0.002, 0.004))
    for name in CONSIDERED:
        for key, own in unsure.effect(name).parameters.items():
            assert own.interval == pytest.approx(plain.effect(name).parameters[key].interval, abs=1e-6)


def test_a_verdict_that_turns_on_a_size_says_so_and_which_size_the_data_prefer(tmp_path: Path) -> None:
    """Nothing is missing but a fifth of the radius; with the small one the slip is wrong."""
    racket = Racket(lambda speed: 0.5, 0.4)
    path = ball_table(
        tmp_path / "balls.csv", racket, rows=90, noise=(0.02, 2.0), stated=False, friction=0.4, restitution=0.5
    )
    lines = path.read_text().replace(f",{1e3 * RADIUS},", f",{0.8e3 * RADIUS},")
    path.write_text(lines)
    document = diagnosed(path, [*CONSIDERED, "tangential_restitution", "drilling_friction"], radius=(0.016, 0.02))
    assert document.named
    assert "The verdict turns on radius: " in document.summary
    assert "with 0.02 m it is NOTHING-MISSING" in document.summary
    assert "The data prefer radius = 0.02 m: held-out error 0." in document.summary


def test_a_tracked_point_beside_the_centre_is_moved_to_it(tmp_path: Path) -> None:
    rows = cube_rows(cube(0.2, 0.3), 20)
    there = write_csv(tmp_path / "tracked.csv", CUBE_HEADER, tracked(rows, (0.0, 0.008, 0.0)))
    (*_, variant) = read_impact_table(there, unsure={"offset_y": (0.0, 0.008)}).variants
    centre = read_impact_table(write_csv(tmp_path / "centre.csv", CUBE_HEADER, rows))
    assert (variant.of, variant.value, variant.unit) == ("offset_y", 0.008, "m")
    for own, other in zip(variant.table.rows, centre.rows, strict=True):
        np.testing.assert_allclose(own.after, other.after, atol=1e-12)
        np.testing.assert_allclose(own.impact.object.twist, other.impact.object.twist, atol=1e-12)
        np.testing.assert_allclose(own.impact.object.position, other.impact.object.position, atol=1e-12)


def test_a_plane_that_is_tilted_about_x_has_a_normal_that_leans_against_y(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(), 12))
    (low, *_, high) = read_impact_table(path, unsure={"tilt_x": (-0.02, 0.02)}).variants
    normals = [one.table.rows[0].impact.points[0].normal for one in (low, high)]
    np.testing.assert_allclose(normals, [[0.0, np.sin(0.02), np.cos(0.02)], [0.0, -np.sin(0.02), np.cos(0.02)]])


def test_what_cannot_be_unsure_is_refused_with_what_can(balls: Path) -> None:
    said = refusal(lambda: read_impact_table(balls, unsure={"size_z": (0.1, 0.2)}))
    assert "--unsure: nothing called 'size_z' can be unsure here; known: mass, radius, offset_x" in said
