# SPDX-License-Identifier: Apache-2.0
"""Outcomes of tables, and how well they are known: distances of slides and flights, and noise of the contact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from impact_table_cases import arm_table, write_csv
from intervals import assert_covers

from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.measured import MeasuredImpacts
from impact_rs_sim.model import load_model
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

NOMINAL = load_model(Path("nominal"))
PUSH = load_scenario("push")
G = 9.81
AFTER = (
    "vx_after [m/s]",
    "vy_after [m/s]",
    "vz_after [m/s]",
    "wx_after [rad/s]",
    "wy_after [rad/s]",
    "wz_after [rad/s]",
)
NOISE = 0.002  # m


def slides(
    hidden: dict[str, list[float]], friction: float, measured: bool = False
) -> tuple[list[str], list[list[object]]]:
    """Pushes of an arm, of which the joints and the way to rest were measured: D = v^2 / (2 mu g)."""
    header, rows = arm_table(hidden, 3)
    rng = np.random.default_rng(1)
    first = header.index(AFTER[0])
    kept = [n for n, name in enumerate(header) if name not in AFTER]
    found = []
    for row in rows:
        speed = float(np.hypot(*row[first : first + 2]))  # type: ignore[arg-type]
        way = speed**2 / (2.0 * friction * G) + NOISE * rng.standard_normal()
        found.append([*(row[n] for n in kept), way, NOISE, *([friction] if measured else [])])
    columns = ["slide_distance [m]", "distance_noise [m]", "dq_noise [rad/s]"]
    found = [[*row[: len(kept) + 2], 0.005, *row[len(kept) + 2 :]] for row in found]
    return [header[n] for n in kept] + columns + (["support_friction [-]"] if measured else []), found


def source_of(path: Path, table: tuple[list[str], list[list[object]]], **how: object) -> ImpactTableSource:
    read = read_impact_table(write_csv(path, *table), PUSH, **how)  # type: ignore[arg-type]
    return ImpactTableSource(read, NOMINAL, discrepancy=NO_MAP_DISCREPANCY)


def test_the_friction_of_a_support_is_found_by_how_far_objects_slide(tmp_path: Path) -> None:
    truth = PUSH.support.friction + 0.08
    source = source_of(tmp_path / "slides.csv", slides({}, truth))
    document = diagnose(source, NOMINAL, ["support_friction", "restitution"])
    assert document.named == ("support_friction",)
    assert_covers(document.effect("support_friction").parameters["friction"].interval, 0.08, 0.016)


def test_a_restitution_is_found_by_joints_and_by_how_far_objects_slide(tmp_path: Path) -> None:
    source = source_of(tmp_path / "slides.csv", slides({"restitution": [0.3]}, 0.5, measured=True))
    document = diagnose(source, NOMINAL, ["restitution", "object_mass"])
    assert document.named == ("restitution",)
    assert_covers(document.effect("restitution").parameters["restitution"].interval, 0.3, 0.01)
    worst = {row.signal for row in compare(source).where}
    assert "distance after" in worst


def test_a_distance_is_worth_the_velocity_that_makes_it(tmp_path: Path) -> None:
    """Of a small dv: dD = v dv / (mu g), so that the score in m/s is that of a table of velocities."""
    header, rows = slides({}, 0.5, measured=True)
    source = source_of(tmp_path / "slides.csv", ([name.replace("condition", "name") for name in header], rows))
    (object_alone,) = (view.source for view in source.views() if view.name == "object")
    assert isinstance(object_alone, ImpactTableSource)
    way, predicted = object_alone.measured[:, 0], object_alone.predicted[:, 0]
    apart = np.sqrt(2.0 * 0.5 * G * way) - np.sqrt(2.0 * 0.5 * G * predicted)
    assert object_alone.size() == pytest.approx(float(np.sqrt(np.mean(apart**2))), rel=0.02)


def test_a_friction_of_the_slide_that_is_not_known_is_found_as_a_nuisance(tmp_path: Path) -> None:
    """With less than the right friction objects should have gone further, which no effect explains."""
    right = 0.5
    table = slides({}, right, measured=True)
    table = table[0], [[*row[:-1], 0.8 * right] for row in table[1]]
    source = source_of(tmp_path / "slides.csv", table, unsure={"support_friction": (0.4, 0.5)})
    values = [view.value for view in source.views() if view.of == "support_friction"]
    assert values == pytest.approx([0.425, 0.45, 0.5])
    summary = diagnose(source, NOMINAL, ["restitution"]).summary
    assert "The data prefer support_friction = 0.5: held-out error" in summary


def test_the_mass_of_a_tool_that_is_not_known_is_found_as_a_nuisance(tmp_path: Path) -> None:
    """Pushes by a tool half a kilogram heavier than the scenario says."""
    tool = next(iter(PUSH.robots.values())).end_effector
    header, rows = arm_table({"end_effector_payload": [0.5, *tool.com]}, 3)
    mass = tool.mass
    path = write_csv(tmp_path / "pushes.csv", header, rows)
    table = read_impact_table(path, PUSH, unsure={"tool_mass": (mass, mass + 0.5)})
    source = ImpactTableSource(table, NOMINAL, discrepancy=NO_MAP_DISCREPANCY)
    summary = diagnose(source, NOMINAL, ["pad_friction"]).summary
    assert f"The data prefer tool_mass = {mass + 0.5:.4g} kg" in summary


@pytest.mark.parametrize("fall", [0.0, 0.7])
def test_the_restitution_of_a_ball_is_found_by_how_far_it_flies(tmp_path: Path, fall: float) -> None:
    """A ball without spin on a smooth plane: v_z = e v, v_x stays, D = v_x (v_z + sqrt(v_z^2 + 2 g h)) / g."""
    rng = np.random.default_rng(3)
    header = [f"{kind}{axis}_before [{unit}]" for kind, unit in (("v", "m/s"), ("w", "rad/s")) for axis in "xyz"]
    header += ["mass [kg]", "radius [m]", "friction [-]", "restitution [-]", "flight_distance [m]", "fall_height [m]"]
    rows, slopes = [], []  # of D over e [m]
    for _ in range(48):
        along, down = rng.uniform(0.5, 1.5), rng.uniform(1.0, 3.0)
        up = 0.6 * down
        way = along * (up + np.sqrt(up**2 + 2.0 * G * fall)) / G + NOISE * rng.standard_normal()
        slopes.append(along * (down + up * down / np.sqrt(up**2 + 2.0 * G * fall)) / G)
        rows.append([along, 0.0, -down, 0.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.5, way, fall, NOISE])
    path = write_csv(tmp_path / "flights.csv", [*header, "distance_noise [m]"], rows)
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution", "support_friction"])
    assert document.named == ("restitution",)
    half = NORMAL_95 * NOISE / np.linalg.norm(slopes)
    assert_covers(document.effect("restitution").parameters["restitution"].interval, 0.1, float(half))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slide_distance [m]": ""}, "expected one distance in every row"),
        ({"slide_distance [m]": -0.1}, r"expected a number > 0 \[m\]"),
        ({"distance_noise [m]": -0.1}, r"expected a number >= 0 \[m\]"),
    ],
)
def test_a_distance_that_cannot_be_is_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    header, rows = slides({}, 0.5)
    rows[3] = [change.get(name, value) for name, value in zip(header, rows[3], strict=True)]
    with pytest.raises(InputError, match=message):
        read_impact_table(write_csv(tmp_path / "slides.csv", header, rows), PUSH)


def test_distances_beside_velocities_are_not_used_and_that_is_said(tmp_path: Path) -> None:
    header, rows = arm_table({}, 3)
    path = write_csv(tmp_path / "pushes.csv", [*header, "slide_distance [m]"], [[*row, ""] for row in rows])
    assert read_impact_table(path, PUSH).unread == ("slide_distance [m]",)


# ---- where it touches ------------------------------------------------------------------------------------------------


def test_noise_of_place_and_normal_reaches_the_prediction(tmp_path: Path) -> None:
    """A smooth ball that falls straight down: v_t = (1 + e) V dn, w = (1 + e) V |(dp, r dn)| / (2/5 r^2)."""
    v, e, r, dp, dn = 2.0, 0.5, 0.02, 1e-5, 1e-3
    kinds = (("v", "m/s"), ("w", "rad/s"))
    whens = ("before", "after")
    header = [f"{kind}{axis}_{when} [{unit}]" for when in whens for kind, unit in kinds for axis in "xyz"]
    header += ["mass [kg]", "radius [m]", "friction [-]", "restitution [-]", "v_noise [m/s]", "w_noise [rad/s]"]
    row = [0.0, 0.0, -v, 0.0, 0.0, 0.0, 0.0, 0.0, e * v, 0.0, 0.0, 0.0, 0.1, r, 0.0, e, 0.0, 0.0]
    path = write_csv(tmp_path / "balls.csv", [*header, "p_noise [m]", "n_noise [rad]"], [[*row, dp, dn]] * 12)
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    assert source.noise is not None
    names = [f"{feature.signal} {feature.index}" for feature in source.signals]
    noise = dict(zip(names, source.noise[0], strict=True))
    assert noise["velocity after across"] == pytest.approx((1.0 + e) * v * dn, rel=1e-3)
    assert noise["velocity after sliding"] == pytest.approx((1.0 + e) * v * dn, rel=1e-3)
    turned = (1.0 + e) * v * np.hypot(dp, r * dn) / (0.4 * r**2)
    assert noise["angular velocity after across"] == pytest.approx(turned, rel=1e-3)
    assert noise["velocity after normal"] < 1e-2 * noise["velocity after across"]
    assert any("p_noise and n_noise" in remark for remark in source.remarks)


@pytest.mark.parametrize("mass, doubt", [(1.25, ("object_mass",)), (1.0, ())])
def test_an_error_that_the_discrepancy_of_the_map_covers_is_no_proof_that_nothing_is_missing(
    tmp_path: Path, mass: float, doubt: tuple[str, ...]
) -> None:
    read = read_impact_table(write_csv(tmp_path / "pushes.csv", *arm_table({"object_mass": [mass]}, 3)), PUSH)
    document = diagnose(ImpactTableSource(read, NOMINAL), NOMINAL, ["object_mass", "pad_friction"])
    assert document.named == () and document.within_discrepancy == doubt
    assert ("the discrepancy of the rigid map" in document.summary) == bool(doubt)


def test_impacts_solved_near_another_answer_have_the_same_answer(tmp_path: Path) -> None:
    rows = read_impact_table(write_csv(tmp_path / "pushes.csv", *arm_table({}, 3)), PUSH).rows
    impacts, nominal = [row.impact for row in rows], [row.physics for row in rows]
    resumed = MeasuredImpacts(impacts, nominal)
    resumed.solve(nominal)
    rng = np.random.default_rng(0)
    for _ in range(10):
        drawn = (
            ("object_mass", [rng.uniform(0.5, 2.0)]),
            ("restitution", [rng.uniform(0.0, 0.6)]),
            ("support_friction", [rng.uniform(-0.3, 0.5)]),
        )
        changed = {id(one): one for one in nominal}
        for name, values in drawn:
            changed = {key: library()[name].apply_vector(one, np.array(values)) for key, one in changed.items()}
        physics = [changed[id(one)] for one in nominal]
        found, _ = resumed.solve(physics)
        anew, _ = MeasuredImpacts(impacts, physics).solve(physics)
        np.testing.assert_allclose(found, anew, atol=1e-6)
