# SPDX-License-Identifier: Apache-2.0
"""Tables of impacts as evidence: a planted truth is found, and nothing where nothing is hidden."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest
from impact_table_cases import CUBE_HEADER, NOISE, arm_table, cube, cube_rows, write_csv
from intervals import assert_covers

from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.dependence import terms_of
from impact_rs_analysis.diagnosis.diagnose import diagnose, effects_for
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, NOTHING
from impact_rs_analysis.evidence.sources import table_source as impact_tables
from impact_rs_analysis.evidence.sources.table_source import MAX_DISTINCT_NUMBERS, MAX_SMALL_BLOCKS, ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import (
    JOINT_VELOCITY_AFTER,
    NO_MAP_DISCREPANCY,
    measured_map_discrepancy,
)
from impact_rs_analysis.evidence.tables.row_groups import BLOCKS
from impact_rs_sim.effects import library
from impact_rs_sim.effects.depending import Depending
from impact_rs_sim.model import load_model
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

from .conftest import assert_intervals

NOMINAL = load_model(Path("nominal"))
OF_CUBES = ["object_mass", "object_com_offset", "restitution", "support_friction"]
BODY = np.repeat(NOISE[:2], 3)  # m/s, rad/s
PUSHED = np.repeat((NOISE[2], 0.005, 0.02), (7, 3, 3))  # rad/s, m/s, rad/s; of an arm and its object


def of_cubes(path: Path, truth: Physics, **columns: float) -> ImpactTableSource:
    """Impacts of cubes that do what ``truth`` says; ``columns`` are further ones, the same in every row."""
    names = [f"{name} [{'m/s' if name == 'v_noise' else 'rad/s'}]" for name in columns]
    rows = [[*row, *columns.values()] for row in cube_rows(truth, 60)]
    return ImpactTableSource(read_impact_table(write_csv(path, [*CUBE_HEADER, *names], rows)), NOMINAL)


def of_pushes(path: Path, hidden: dict[str, list[float]], repeats: int, seed: int = 0) -> ImpactTableSource:
    """Impacts of an arm that obey a rigid map."""
    table = read_impact_table(write_csv(path, *arm_table(hidden, repeats, seed)), load_scenario("push"))
    return ImpactTableSource(table, NOMINAL, discrepancy=NO_MAP_DISCREPANCY)


def confirmed(document: DiagnosisDocument) -> set[str]:
    return {effect.name for effect in document.effects if effect.verdict == CONFIRMED}


def assert_only(document: DiagnosisDocument, *effects: str) -> None:
    """These effects are confirmed and named, and no others."""
    assert confirmed(document) == set(document.named) == set(effects)


@pytest.fixture(scope="module")
def tossed(tmp_path_factory: pytest.TempPathFactory) -> tuple[ImpactTableSource, DiagnosisDocument]:
    """Cubes with mu = 0.2 and e = 0.3 that are believed to have 0.5 and 0."""
    source = of_cubes(tmp_path_factory.mktemp("cubes") / "cubes.csv", cube(0.2, 0.3))
    return source, diagnose(source, NOMINAL, OF_CUBES)


def test_friction_and_restitution_of_a_cube_are_found_and_nothing_else(
    tossed: tuple[ImpactTableSource, DiagnosisDocument],
) -> None:
    source, document = tossed
    assert_only(document, "support_friction", "restitution")
    truth = {("support_friction", "friction"): 0.2 - 0.5, ("restitution", "restitution"): 0.3}
    assert_intervals(source, document, truth, BODY)
    assert document.held_out_error_after < 0.05 * document.held_out_error_before
    assert (document.source, document.error_unit, document.runs.trials) == ("impacts", "m/s", 60)
    assert document.runs.digest == source.table.digest
    assert not document.effect("object_mass").measured  # it cancels


def test_the_score_is_the_energy_norm_of_what_is_left(tossed: tuple[ImpactTableSource, DiagnosisDocument]) -> None:
    """With all moments alike, sum_i H_ii du_i^2 / m = |dv|^2 + I / m |domega|^2 in any axes."""
    source, document = tossed
    raw = np.array([row.after for row in source.table.rows]) - _in_world(source)
    square = np.sum(raw[:, :3] ** 2, axis=1) + 0.01 / 6.0 * np.sum(raw[:, 3:] ** 2, axis=1)
    found = compare(source)
    assert found.score == pytest.approx(np.sqrt(square.mean()), rel=1e-6)
    assert document.held_out_error_before == pytest.approx(found.score, rel=1e-6)
    assert (found.score_unit, found.noise_floor) == ("m/s", None)


def _in_world(source: ImpactTableSource) -> np.ndarray:
    """Predicted velocities in axes of the world."""
    both = source.predicted.reshape(-1, 2, 3)
    return np.einsum("nij,nki->nkj", np.array(source.entries.axes), both).reshape(-1, 6)


def test_blocks_hold_every_row_once_and_are_of_one_unit(tossed: tuple[ImpactTableSource, DiagnosisDocument]) -> None:
    source, _ = tossed
    rows = [row for group in source._groups for row in group.rows]
    assert rows == list(range(60))
    assert len(source.clusters) == BLOCKS
    assert {item.unit for item in source.clusters} == {str(source.table.path)}  # so neighbours guard each other
    assert {feature.index for item in source.clusters for feature in item.features} == {"normal", "sliding", "across"}


def test_a_centre_of_mass_off_the_middle_is_found(tmp_path: Path) -> None:
    source = of_cubes(tmp_path / "cubes.csv", cube(com=(0.012, 0.0, 0.0)))
    document = diagnose(source, NOMINAL, ["object_com_offset", "restitution"])
    assert str(document.verdict) == "object_com_offset"
    found = document.effect("object_com_offset").parameters  # rows on a corner decide: half widths as looked at
    assert_covers(found["x"].interval, 0.012, 8.7e-5)


@pytest.mark.parametrize("noise", [{}, {"v_noise": NOISE[0], "w_noise": NOISE[1]}])
def test_where_nothing_is_hidden_nothing_is_missing(tmp_path: Path, noise: dict[str, float]) -> None:
    source = of_cubes(tmp_path / "cubes.csv", cube(), **noise)
    document = diagnose(source, NOMINAL, OF_CUBES)
    assert (document.verdict, document.named) == (NOTHING, ())
    if noise:
        assert document.held_out_error_before == pytest.approx(document.noise_floor, rel=0.1)
    else:
        assert any("the noise is not known" in remark for remark in document.remarks)


def test_what_no_effect_explains_is_said_where_the_noise_is_known(tmp_path: Path) -> None:
    """Velocities after the impact that have nothing to do with those before it."""
    rows = np.array(cube_rows(cube(), 60, noise=False))
    rows[:, 13:19] = rows[::-1, 13:19]
    header = [*CUBE_HEADER, "v_noise [m/s]", "w_noise [rad/s]"]
    table = read_impact_table(write_csv(tmp_path / "cubes.csv", header, np.hstack((rows, [[0.01, 0.1]] * 60))))
    document = diagnose(ImpactTableSource(table, NOMINAL), NOMINAL, ["restitution", "support_friction"])
    assert document.verdict.leaves_residuals


def test_a_limit_that_is_no_friction_at_all_is_found_at_its_bound(tmp_path: Path) -> None:
    source = of_cubes(tmp_path / "cubes.csv", cube(0.0))
    document = diagnose(source, NOMINAL, ["restitution", "support_friction"])
    assert document.named == ("support_friction",)
    low, high = document.effect("support_friction").parameters["friction"].interval
    assert low == -0.5
    assert high < -0.475


def test_rows_that_gain_energy_are_named(tmp_path: Path) -> None:
    rows = cube_rows(cube(), 20, noise=False)
    rows[3][13:16] = [5.0, 0.0, 0.0]
    source = ImpactTableSource(read_impact_table(write_csv(tmp_path / "cubes.csv", CUBE_HEADER, rows)), NOMINAL)
    (remark,) = (text for text in source.remarks if "1 of 20 rows leave with over 5 % more kinetic energy" in text)
    assert "rows 4" in remark


def test_motor_inertia_of_an_arm_is_found_from_its_jumps(tmp_path: Path) -> None:
    source = of_pushes(tmp_path / "pushes.csv", {"motor_inertia_scale": [1.3]}, repeats=4)
    document = diagnose(source, NOMINAL, ["motor_inertia_scale", "object_mass", "restitution"])
    assert source.repeated
    assert_only(document, "motor_inertia_scale")
    assert_intervals(source, document, {("motor_inertia_scale", "scale"): 1.3}, PUSHED, repeats=4)
    joints, item = (view.source.size() for view in source.views()[:2])
    assert f"apart: joints {joints:.3g}, object {item:.3g} times repeatability" in source.comparison_remarks
    assert joints > 1.2 * item  # a motor that is heavier than assumed shows in its own joint
    assert {feature.signal for feature in source.signals} >= {JOINT_VELOCITY_AFTER}


@pytest.mark.slow
def test_joints_that_a_stiff_controller_holds_are_told_from_heavier_motors(tmp_path: Path) -> None:
    """All resist more by the same inertia, motors by a factor of their own. Kills control that scales the inertia."""
    stiffness, duration = 7000.0, 0.03
    added = (0.25 - 1.0 / np.pi**2) * stiffness * duration**2
    source = of_pushes(tmp_path / "pushes.csv", {"stiff_control": [added]}, repeats=4)
    document = diagnose(source, NOMINAL, ["stiff_control", "motor_inertia_scale", "object_mass", "restitution"])
    assert_only(document, "stiff_control")
    assert_intervals(source, document, {("stiff_control", "inertia"): added}, PUSHED, repeats=4)


def test_pushes_without_anything_hidden_lack_nothing(tmp_path: Path) -> None:
    source = of_pushes(tmp_path / "pushes.csv", {}, repeats=3)
    document = diagnose(source, NOMINAL, ["motor_inertia_scale", "object_mass", "restitution"])
    assert document.verdict == NOTHING
    assert "The joints alone: nothing missing" in document.summary
    assert "The object alone: nothing missing" in document.summary
    assert compare(source).score < 2.0  # times repetition


def test_a_condition_is_predicted_as_the_mean_of_its_repeats(tmp_path: Path) -> None:
    source = of_pushes(tmp_path / "pushes.csv", {}, repeats=2)
    (found,) = source.predict([(1, ())], "")
    rows = source._groups[1].rows
    assert found == pytest.approx(source.predicted[list(rows)].mean(axis=0))
    (again,) = source.residuals_with((), source.clusters[1:2])
    assert again.residuals == pytest.approx(source.clusters[1].residuals)
    item = source.clusters[1]
    assert item.mean * item.sigma == pytest.approx((source.measured - source.predicted)[list(rows)].mean(axis=0))
    limits = np.array([feature.relevance_limit for feature in source.signals]) / 2.0  # kills a scale without them
    assert np.square(item.sigma) == pytest.approx(np.square(item.pure_error * item.sigma) + np.square(limits), rel=1e-9)


def test_every_effect_that_the_map_knows_changes_what_is_remembered(tmp_path: Path) -> None:
    """Answers are kept by what the map depends on; kills any number left out of that key."""
    cubes, pushes = of_cubes(tmp_path / "cubes.csv", cube()), of_pushes(tmp_path / "pushes.csv", {}, repeats=2)
    moved = set()
    for source in (cubes, pushes):
        for effect in effects_for(source):
            candidate = Candidate.of((effect,), source)
            added = candidate.effects_at(candidate.nearest_consistent(candidate.nominal + 0.5 * candidate.scale))
            (alone,) = source.predict_row(0, [added])
            assert alone is not None
            np.testing.assert_allclose(source.predicted_with(added)[0], alone, atol=1e-7, err_msg=effect.name)
            moved |= {effect.name} if np.abs(alone - source.predicted[0]).max() > 1e-6 else set()
    assert moved >= {*OF_CUBES, "motor_inertia_scale", "end_effector_payload", "tangential_restitution"}


@pytest.mark.parametrize(
    ("counts", "conditions"), [((4, 4), 0), ((2, 2, 2), 3), ((2, 2, 1), 0), ((3, 3, 3), 3)], ids=str
)
def test_conditions_are_three_with_three_repeats_in_all_or_else_rows_stand_in_blocks(
    tmp_path: Path, counts: Sequence[int], conditions: int
) -> None:
    """Kills either of both bounds."""
    header, rows = arm_table({}, 4)
    some = [row for place, count in enumerate(counts) for row in rows[4 * place : 4 * place + count]]
    table = read_impact_table(write_csv(tmp_path / "pushes.csv", header, some), load_scenario("push"))
    source = ImpactTableSource(table, NOMINAL, remarks=False)
    assert source.repeated == bool(conditions)
    assert len(source.clusters) == (conditions or sum(counts))


def test_a_condition_called_like_a_row_is_not_that_row(tmp_path: Path) -> None:
    """Kills: two clusters called "row 4", and the condition got the residuals of the row."""
    labels = ["row 4"] * 3 + [""] + ["b"] * 3 + ["c"] * 3
    rows = [[*row, label] for row, label in zip(cube_rows(cube(), 10), labels, strict=True)]
    table = read_impact_table(write_csv(tmp_path / "cubes.csv", [*CUBE_HEADER, "condition"], rows))
    source = ImpactTableSource(table, NOMINAL, remarks=False)
    units, keys = ({getattr(item, name) for item in source.clusters} for name in ("unit", "condition_key"))
    assert len(units) == len(keys) == 4
    again = source.residuals_with((), source.clusters)
    assert again is not None
    for item, found in zip(source.clusters, again, strict=True):
        np.testing.assert_allclose(found.residuals, item.residuals)


@pytest.mark.parametrize(("repeats", "parts"), [(3, 6), (4, 12)])
def test_halves_of_a_number_are_conditions_of_their_own_where_both_have_two_rows(
    tmp_path: Path, repeats: int, parts: int
) -> None:
    """Kills halves of one row, which are no repeats, and halves that are never made."""
    header, rows = arm_table({}, repeats)
    warm = [[*row, 20.0 + (n % repeats) + 0.01 * n] for n, row in enumerate(rows)]
    path = write_csv(tmp_path / "pushes.csv", [*header, "temperature [degC]"], warm)
    table = read_impact_table(path, load_scenario("push"), covariates=["temperature"])
    source = ImpactTableSource(table, NOMINAL, remarks=False)
    assert source.repeated and len(source.clusters) == parts
    assert len({item.unit for item in source.clusters}) == 6  # halves of a condition are held out together


def test_many_numbers_are_taken_as_means_of_groups_and_blocks_are_small_where_effects_depend(tmp_path: Path) -> None:
    """Kills single numbers as groups, groups that are not of equal size, and blocks as large as before."""
    rows = [[*row, float(n)] for n, row in enumerate(cube_rows(cube(), 128, noise=False))]
    path = write_csv(tmp_path / "cubes.csv", [*CUBE_HEADER, "temperature [degC]"], rows)
    source = ImpactTableSource(read_impact_table(path, covariates=["temperature"]), NOMINAL, remarks=False)
    (given,) = source.covariates
    linear = Depending(library()["restitution"], given.name, terms_of(source)[given.name][0])
    known = source.with_dependences([linear])
    assert (len(source.clusters), len(known.clusters)) == (BLOCKS, MAX_SMALL_BLOCKS)
    shown = [float(world.circumstances["temperature"]) for world in known.worlds]
    assert shown == [1.5 + 4.0 * n for n in range(MAX_DISTINCT_NUMBERS)]


def test_an_object_whose_robot_was_not_measured_after_the_impact_is_compared_alone(tmp_path: Path) -> None:
    header, rows = arm_table({"object_mass": [1.15]}, 4, seed=1)
    kept = [number for number, name in enumerate(header) if not (name.startswith("dq") and "_after" in name)]
    path = write_csv(tmp_path / "pushes.csv", [header[k] for k in kept], [[row[k] for k in kept] for row in rows])
    source = ImpactTableSource(read_impact_table(path, load_scenario("push")), NOMINAL, discrepancy=NO_MAP_DISCREPANCY)
    assert {feature.signal for feature in source.signals}.isdisjoint({JOINT_VELOCITY_AFTER})
    assert not any(view.name == "object" for view in source.views())  # it is looked at anyway
    assert source.measured.shape == source.predicted.shape == (len(rows), 6)
    document = diagnose(source, NOMINAL, ["object_mass", "restitution"])
    assert_only(document, "object_mass")
    assert_intervals(source, document, {("object_mass", "scale"): 1.15}, PUSHED[7:], repeats=4)


@pytest.mark.parametrize(("stated", "larger"), [(1e-6, False), (0.5, True)])
def test_stated_noise_counts_beside_repeats_where_it_is_larger(tmp_path: Path, stated: float, larger: bool) -> None:
    header, rows = arm_table({}, 3)
    names = ["v_noise [m/s]", "w_noise [rad/s]", "dq_noise [rad/s]"]
    path = write_csv(tmp_path / "pushes.csv", [*header, *names], [[*row, *[stated] * 3] for row in rows])
    source = ImpactTableSource(read_impact_table(path, load_scenario("push")), NOMINAL)
    item = source.clusters[0]
    assert np.allclose(item.pure_error * item.sigma, stated) == larger
    (remark,) = (text for text in source.remarks if "the noise columns say" in text)
    assert ("0.0" in remark) == larger


def test_noise_of_joints_that_were_not_measured_is_not_asked_for(tmp_path: Path) -> None:
    header, rows = arm_table({}, 2)
    kept = [number for number, name in enumerate(header) if not (name.startswith("dq") and "_after" in name)]
    header = [*(header[k] for k in kept), "v_noise [m/s]", "w_noise [rad/s]"]
    path = write_csv(tmp_path / "pushes.csv", header, [[*(row[k] for k in kept), 0.01, 0.1] for row in rows])
    source = ImpactTableSource(read_impact_table(path, load_scenario("push")), NOMINAL)
    assert source.noise is not None
    np.testing.assert_array_equal(source.noise[0], [0.01] * 3 + [0.1] * 3)


def test_contacts_that_a_millimetre_decides_are_reported(tmp_path: Path) -> None:
    """A cube that comes down on an edge, with the opposite one 2 mm above the plane."""
    rows = cube_rows(cube(), 20, noise=False)
    half = 0.5 * 0.02  # rad, of a cube of 0.1 m
    for row in rows:
        row[3:7] = [np.sin(half), 0.0, 0.0, np.cos(half)]
        row[7:13] = [0.3, 0.0, -1.0, 0.0, 0.0, 0.0]
    path = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, rows)
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    (remark,) = (text for text in source.remarks if "which points touch is unsure" in text)
    assert "in 20 of 20 rows: with 4 in place of 1 mm" in remark
    assert {len(row.impact.points) for row in source.table.rows} == {2}
    wide = read_impact_table(path, tolerance=0.005)
    assert {len(row.impact.points) for row in wide.rows} == {4}
    assert not any("which points touch" in text for text in ImpactTableSource(wide, NOMINAL).remarks)


def wrist_jumps(rows: list[list[object]], header: list[str], size: float) -> list[list[object]]:
    """Joints 5 to 7 jump by as much as no rigid map can, differently in every condition."""
    rng, places = np.random.default_rng(5), [header.index(f"dq{joint}_after [rad/s]") for joint in (5, 6, 7)]
    jumps: dict[tuple[object, ...], np.ndarray] = {}
    for row in rows:
        jump = jumps.setdefault(tuple(row[:2]), size * rng.standard_normal(3))
        for place, value in zip(places, jump, strict=True):
            row[place] = float(row[place]) + value
    return rows


def test_a_wrist_that_no_rigid_map_describes_does_not_drown_the_object(tmp_path: Path) -> None:
    header, rows = arm_table({"restitution": [0.5]}, 3)
    path = write_csv(tmp_path / "pushes.csv", header, wrist_jumps(rows, header, 1.0))
    source = ImpactTableSource(read_impact_table(path, load_scenario("push")), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution", "object_mass"])
    joints, item = document.views[:2]
    assert (joints.name, item.name) == ("joints", "object")
    assert item.named == ("restitution",)
    assert item.held_out_error_after < 0.5 * item.held_out_error_before
    assert joints.verdict.leaves_residuals
    assert "The object alone: restitution (" in document.summary


def test_the_discrepancy_of_the_map_grows_with_the_closing_speed_and_not_with_the_size_of_the_robot(
    tmp_path: Path,
) -> None:
    header, rows = arm_table({}, 2)
    table = read_impact_table(write_csv(tmp_path / "pushes.csv", header, rows), load_scenario("push"))
    source = ImpactTableSource(table, NOMINAL)
    features, known = source.signals, measured_map_discrepancy()
    slow, fast = (known.of(features, source.physics, speed, "square") for speed in (0.5, 1.0))
    assert fast == pytest.approx(2.0 * slow)
    assert np.all(known.of(features, source.physics, 1.0, "oblique") >= fast)
    sigma = source.clusters[0].sigma
    assert np.all(sigma > ImpactTableSource(table, NOMINAL, discrepancy=NO_MAP_DISCREPANCY).clusters[0].sigma)
    assert not of_cubes(tmp_path / "cubes.csv", cube()).clusters[0].discrepancy.any()  # a free body has no drives


def test_a_verdict_that_turns_on_the_contact_points_says_so(tmp_path: Path) -> None:
    """Cubes that come down flat are measured with 0.6 degrees of tilt: by a millimetre, an edge hits."""
    rng, rows = np.random.default_rng(2), []
    for row in cube_rows(cube(restitution=0.5), 40, noise=False):
        speed = rng.uniform(0.5, 2.0)
        row[3:7] = [0.0, 0.0, 0.0, 1.0]
        row[7:13], row[13:19] = [0.0, 0.0, -speed, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5 * speed, 0.0, 0.0, 0.0]
        row[13:19] += rng.standard_normal(6) * np.repeat(NOISE[:2], 3)
        half = 0.5 * np.deg2rad(1.2)
        row[3:7] = [np.sin(half), 0.0, 0.0, np.cos(half)]
        rows.append(row)
    path = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, rows)
    document = diagnose(ImpactTableSource(read_impact_table(path), NOMINAL), NOMINAL, OF_CUBES)
    (view,) = document.views
    assert view.named == ("restitution",)
    assert "The verdict depends on an assumption: with points within 4 mm it is restitution" in document.summary
    wide = ImpactTableSource(read_impact_table(path, tolerance=0.005), NOMINAL)
    assert [view.name for view in wide.views()] == ["points within 1.25 mm"]


def test_a_tolerance_of_a_row_counts_before_that_of_the_table(tmp_path: Path) -> None:
    rows = cube_rows(cube(), 12, noise=False)
    half = 0.5 * 0.02  # rad, of a cube of 0.1 m
    for row in rows:
        row[3:7] = [np.sin(half), 0.0, 0.0, np.cos(half)]
        row[7:13] = [0.3, 0.0, -1.0, 0.0, 0.0, 0.0]
    for number, row in enumerate(rows):
        row.append(3.0 if number < 6 else 1.0)
    path = write_csv(tmp_path / "cubes.csv", [*CUBE_HEADER, "contact_tolerance [mm]"], rows)
    table = read_impact_table(path)
    assert [len(row.impact.points) for row in table.rows] == [4] * 6 + [2] * 6
    assert table.tolerance == pytest.approx(0.002)


# ---- large tables ----------------------------------------------------------------------------------------------------


def test_a_large_table_is_searched_in_part_and_checked_on_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are taken evenly from every block; what is found predicts the others, and the document says how well."""
    monkeypatch.setattr(impact_tables, "MAX_SEARCHED_ROWS_OF_BODIES", 48)
    rows = cube_rows(cube(0.2, 0.3), 240)
    header = [*CUBE_HEADER, "surface []"]
    table = read_impact_table(
        write_csv(
            tmp_path / "cubes.csv", header, [[*row, "rare" if n < 30 else "usual"] for n, row in enumerate(rows)]
        ),
        covariates=["surface"],
    )
    source = ImpactTableSource(table, NOMINAL)
    part = source.searched()
    assert len(part.clusters) == BLOCKS
    assert sum(row.circumstances["surface"] == "rare" for row in part.table.rows) == 24
    plain = ImpactTableSource(replace(table, covariates={}), NOMINAL)
    document = diagnose(plain, NOMINAL, ["restitution", "support_friction"])
    assert set(document.named) == {"support_friction", "restitution"}
    assert document.runs.trials == 240
    (said,) = (remark for remark in document.remarks if "rows were searched" in remark)
    assert said.startswith("48 of 240 rows were searched") and "On the 192 others the error falls from" in said


def test_a_search_of_all_rows_is_that_of_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills: a sample that holds the whole table, with fewer folds, and the mean error of no other rows (nan)."""
    monkeypatch.setattr(impact_tables, "MAX_SEARCHED_ROWS_OF_BODIES", 30)
    rows = [[*row, f"day {number // 12}"] for number, row in enumerate(cube_rows(cube(), 36))]
    path = write_csv(tmp_path / "cubes.csv", [*CUBE_HEADER, "session []"], rows)
    source = ImpactTableSource(read_impact_table(path, covariates=["session"]), NOMINAL, remarks=False)
    assert source.searched() is source
    assert source.unseen(source.searched(), ()) == ()


@pytest.mark.slow
def test_workers_find_what_one_process_finds(tmp_path: Path) -> None:
    """Sources travel to other processes without what belongs to this one."""
    table = read_impact_table(write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2, 0.3), 36)))
    alone = ImpactTableSource(table, NOMINAL)

    def elsewhere(function: Callable[..., Any], items: Sequence[Any]) -> Iterator[Any]:
        return map(pickle.loads(cloudpickle.dumps(function)), items)

    sent = ImpactTableSource(table, NOMINAL, map_tasks=elsewhere)
    first, second = (diagnose(one, NOMINAL, ["restitution", "support_friction"]) for one in (alone, sent))
    assert first.named == second.named and first.hold_out == second.hold_out
    assert first.held_out_error_after == pytest.approx(second.held_out_error_after, rel=1e-9)


def test_a_source_travels_without_its_variants_and_kept_predictions(tmp_path: Path) -> None:
    """Kills a state with either: every task would carry the table several times, and megabytes of answers.

    And one with the reports of its process, which no pickle holds: every hold-out on workers ended with that.
    """
    path = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(0.2, 0.3), 36))
    plain = ImpactTableSource(read_impact_table(path), NOMINAL)
    source = ImpactTableSource(read_impact_table(path, unsure={"size_x": (0.09, 0.11)}), NOMINAL)
    assert source.table.variants
    for step in range(200):
        source.predict_row(0, [(("restitution", (step / 400.0,)),)])
        source.predict([(0, (("restitution", (step / 400.0,)),))], "")
    source.progress = lambda *_: None
    sent = pickle.dumps(source)
    assert len(sent) == pytest.approx(len(pickle.dumps(plain)), rel=0.02)
    there = pickle.loads(sent)
    assert not there.table.variants and there.progress is None
    np.testing.assert_array_equal(there.predicted, source.predicted)


def test_one_statement_has_one_noise(tmp_path: Path) -> None:
    """The level is the root mean square of its cells, in the same multiples: noise and discrepancy of the map."""
    header, rows = arm_table({"restitution": [0.2]}, 4)
    header = [name if name != "condition" else "label" for name in header]
    header += ["v_noise [m/s]", "w_noise [rad/s]", "dq_noise [rad/s]"]
    path = write_csv(tmp_path / "pushes.csv", header, [[*row, 0.002, 0.01, 0.002] for row in rows])
    source = ImpactTableSource(read_impact_table(path, load_scenario("push")), NOMINAL, remarks=False)
    document = compare(source)
    assert not source.repeated
    counts = {"parcel": 12, "cat_food": 12}
    squares = sum(counts[cell.object] * cell.times_noise**2 for cell in document.where)
    rows_of_all = sum(counts[cell.object] for cell in document.where)
    assert document.levels["impacts"].times_noise == pytest.approx(np.sqrt(squares / rows_of_all), rel=1e-6)
    assert max(cell.times_noise for cell in document.where) < 10.0 * document.levels["impacts"].times_noise
