# SPDX-License-Identifier: Apache-2.0
"""Balls that bounce by closed forms, otherwise in one session than in another: what depends on what is found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from ball_impacts import MASS, RADIUS, TWIST, Racket, bounced, thrown
from impact_table_cases import arm_table, write_csv

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.dependence_verdicts import correlation_of, covariate_documents
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import CONFIRMED, DependenceDocument, DiagnosisDocument
from impact_rs_analysis.diagnosis.hold_out import folds_of
from impact_rs_analysis.evidence.impact_tables import ImpactTableSource
from impact_rs_analysis.evidence.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_analysis.evidence.source import Covariate
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, load_model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.recordings.impact_table import read_impact_table

NOMINAL = load_model(Path("nominal"))
CONSIDERED = ["restitution", "support_friction", "restitution_fall"]
NOISE = np.repeat((0.1, 10.0), 3)  # m/s, rad/s
Circumstances = dict[str, float | str]


def sessions(rng: np.random.Generator, row: int) -> Circumstances:
    """Two sessions in turn, at any temperature."""
    return {"session": "AB"[row % 2], "temperature": float(rng.uniform(15.0, 35.0))}


def bouncier(own: Circumstances) -> Racket:
    """Restitution of 0.52 in one session and 0.61 in the other."""
    return Racket(lambda speed: 0.52 if own["session"] == "A" else 0.61, 0.2)


def warmer(own: Circumstances) -> Racket:
    """Friction that falls by 0.01 a degree."""
    return Racket(lambda speed: 0.55, 0.25 - 0.01 * (float(own["temperature"]) - 25.0))


def made(
    path: Path,
    law: Callable[[Circumstances], Racket] = bouncier,
    circumstances: Callable[[np.random.Generator, int], Circumstances] = sessions,
    seed: int = 0,
    rows: int = 90,
    assumed: tuple[float, float] = (0.3, 0.0),
    repeats: int = 0,
    names: Sequence[str] = ("session", "temperature [degC]"),
    mass: float = 1e3 * MASS,
) -> Path:
    """A table of hollow balls that are believed to have a friction and a restitution; with conditions if repeated."""
    rng = np.random.default_rng(seed)
    header = [
        f"{name}_{tail} [{'m/s' if name[0] == 'v' else 'rad/s'}]" for tail in ("before", "after") for name in TWIST
    ]
    header += ["mass [g]", "radius [mm]", "shell [-]", "friction [-]", "restitution [-]", *names]
    found, before = [], thrown(rng)
    for row in range(rows):
        own = circumstances(rng, row)
        if not repeats or row % repeats == 0:
            before = thrown(rng)
        state = before + (0.2 * NOISE * rng.standard_normal(6) if repeats else 0.0)
        after = bounced(state, law(own)) + NOISE * rng.standard_normal(6)
        values = [own[name.partition(" ")[0]] for name in names]
        condition = [f"c{row // repeats}"] if repeats else []
        found.append([*state, *after, mass, 1e3 * RADIUS, 1.0, *assumed, *values, *condition])
    return write_csv(path, [*header, *(["condition"] if repeats else [])], found)


def diagnosed(path: Path, *covariates: str) -> DiagnosisDocument:
    table = read_impact_table(path, covariates=covariates or ("session", "temperature"))
    return diagnose(ImpactTableSource(table, NOMINAL), NOMINAL, CONSIDERED)


def found(document: DiagnosisDocument) -> dict[tuple[str, str], DependenceDocument]:
    return {(one.effect, one.covariate): one for one in document.dependences if one.found}


def of_levels(one: DependenceDocument, parameter: str = "restitution") -> dict[str, tuple[float, float]]:
    """Intervals by level."""
    return {level: own[parameter].interval for level, own in one.levels.items()}


@pytest.fixture(scope="module")
def two_sessions(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DiagnosisDocument]:
    path = made(tmp_path_factory.mktemp("sessions") / "balls.csv")
    return path, diagnosed(path)


def test_a_restitution_that_differs_between_sessions_is_found_and_nothing_else(
    two_sessions: tuple[Path, DiagnosisDocument],
) -> None:
    _, document = two_sessions
    ((pair, one),) = found(document).items()
    assert (pair, one.verdict) == (("restitution", "session"), CONFIRMED)
    intervals = of_levels(one)
    assert intervals["A"][0] < 0.52 < intervals["A"][1] < intervals["B"][0] < 0.61 < intervals["B"][1]
    assert one.held_out_error_after < 0.9 * one.held_out_error_before
    assert document.held_out_error_after == pytest.approx(one.held_out_error_after, rel=0.05)
    assert set(document.named) == {"restitution", "support_friction"}
    assert not document.confusable
    assert "restitution depends on session: 0.5" in document.summary
    assert " in A, 0.6" in document.summary and "; held-out error 0." in document.summary
    tried = {(other.effect, other.covariate) for other in document.dependences}
    assert tried == {(effect, name) for effect in CONSIDERED for name in ("session", "temperature")}
    assert all(other.p_value is None or other.p_value > 0.01 for other in document.dependences if not other.found)


def test_a_friction_that_falls_with_temperature_is_found_with_its_slope(tmp_path: Path) -> None:
    document = diagnosed(made(tmp_path / "balls.csv", warmer))
    ((pair, one),) = found(document).items()
    assert pair == ("support_friction", "temperature")
    low, high = one.per_unit["friction"].interval
    assert -0.0125 < low < -0.01 < high < -0.0075
    assert one.per_unit["friction"].unit == "1/degC"
    (covariate,) = (item for item in document.covariates if item.name == "temperature")
    low, high = one.at_mean["friction"].interval
    assert low < 0.25 - 0.01 * (covariate.mean - 25.0) - 0.3 < high
    assert " per degC; held-out error " in document.summary


@pytest.mark.parametrize("seed", range(10))
def test_where_nothing_depends_on_anything_nothing_is_said(tmp_path: Path, seed: int) -> None:
    def everywhere(rng: np.random.Generator, row: int) -> Circumstances:
        return sessions(rng, row) | {"place": f"place {row // 20}"}

    names = ("session", "temperature [degC]", "place")
    path = made(tmp_path / "balls.csv", lambda own: Racket(lambda speed: 0.55, 0.2), everywhere, seed, names=names)
    document = diagnosed(path, "session", "temperature", "place")
    assert not found(document)
    assert (
        "No dependence was found on session (a value for each level) or temperature (a straight line, curves of 3, 5"
        in (document.summary)
    )
    assert "or place (a value for each level)." in document.summary
    assert all(item.tried and not item.goes_with for item in document.covariates)


def test_names_of_levels_order_of_rows_and_units_do_not_matter(
    tmp_path: Path, two_sessions: tuple[Path, DiagnosisDocument]
) -> None:
    path, document = two_sessions
    header, *rows = [line.split(",") for line in path.read_text().splitlines()]
    place, mass = header.index("session"), header.index("mass [g]")
    names = {"A": "late", "B": "early"}
    header[mass] = "mass [kg]"
    for row in rows:
        row[place], row[mass] = names[row[place]], str(float(row[mass]) / 1e3)
    one = found(document)["restitution", "session"]
    for order in (range(len(rows)), np.random.default_rng(1).permutation(len(rows))):
        again = diagnosed(write_csv(tmp_path / "balls.csv", header, [rows[number] for number in order]))
        ((pair, other),) = found(again).items()
        assert pair == ("restitution", "session")
        assert {name: other.levels[names[name]]["restitution"].estimate for name in names} == pytest.approx(
            {name: one.levels[name]["restitution"].estimate for name in names}, abs=1e-3
        )


def test_a_slope_has_the_unit_of_its_number(tmp_path: Path) -> None:
    """Kelvin in tenths: the same line, with a tenth of the slope about another mean."""

    def tenths(rng: np.random.Generator, row: int) -> Circumstances:
        own = sessions(rng, row)
        return own | {"warmth": 10.0 * (float(own["temperature"]) + 273.15)}

    path = made(tmp_path / "balls.csv", warmer, tenths, names=("temperature [degC]", "warmth [dK]"))
    plain = found(diagnosed(path, "temperature"))["support_friction", "temperature"].per_unit["friction"]
    fine = found(diagnosed(path, "warmth"))["support_friction", "warmth"].per_unit["friction"]
    assert 10.0 * fine.estimate == pytest.approx(plain.estimate, rel=1e-3)
    assert (plain.unit, fine.unit) == ("1/degC", "1/dK")


def test_what_is_more_in_one_session_and_less_in_another_is_found_where_nothing_is_missing_on_average(
    tmp_path: Path,
) -> None:
    path = made(tmp_path / "balls.csv", assumed=(0.2, 0.565))
    document = diagnosed(path)
    assert document.verdict == "restitution"
    intervals = of_levels(found(document)["restitution", "session"])
    assert (
        intervals["A"][0]
        < 0.52 - 0.565
        < intervals["A"][1]
        < 0.0
        < intervals["B"][0]
        < 0.61 - 0.565
        < intervals["B"][1]
    )


def test_an_effect_that_the_model_has_may_depend_on_a_session_beyond_that(
    two_sessions: tuple[Path, DiagnosisDocument],
) -> None:
    """With mean restitution and friction in the model nothing is missing on average, and no other effect is blamed."""
    path, _ = two_sessions
    items = [("restitution", "restitution", 0.565), ("support_friction", "friction", -0.1)]
    effects = [
        ModelEffect(name=name, parameters={key: ParameterValue(estimate=value, unit="-")}) for name, key, value in items
    ]
    model = Model(name="pooled", effects=tuple(effects))
    source = ImpactTableSource(read_impact_table(path, covariates=["session"]), model)
    document = diagnose(source, model)
    assert not document.named
    ((pair, one),) = found(document).items()
    assert pair == ("restitution", "session")
    intervals = of_levels(one)
    assert intervals["A"][0] < 0.52 - 0.565 < intervals["A"][1] < 0.0
    assert 0.0 < intervals["B"][0] < 0.61 - 0.565 < intervals["B"][1]


def test_rows_of_one_condition_in_other_sessions_are_no_repeats(tmp_path: Path) -> None:
    path = made(tmp_path / "balls.csv", rows=48, repeats=6)
    table = read_impact_table(path, covariates=["session"])
    source = ImpactTableSource(table, NOMINAL)
    assert source.repeated
    assert [(item.name, item.unit, item.count) for item in source.clusters[:2]] == [
        ("c0, session A", "c0", 3),
        ("c0, session B", "c0", 3),
    ]
    together = ImpactTableSource(read_impact_table(path), NOMINAL)
    normal, pooled = (one.clusters[0].pure[0] * one.clusters[0].sigma[0] for one in (source, together))
    assert normal == pytest.approx(NOISE[0], rel=0.2) and pooled > 1.5 * normal
    document = diagnosed(path, "session")
    intervals = of_levels(found(document)["restitution", "session"])
    assert intervals["A"][0] < 0.52 < intervals["A"][1] < intervals["B"][0] < 0.61 < intervals["B"][1]
    assert document.error_unit == "times repeatability"


def test_an_object_that_was_heavier_in_one_session_is_so_for_joints_and_object_alike(tmp_path: Path) -> None:
    header, light = arm_table({"object_mass": [1.1]}, 3, seed=1)
    _, heavy = arm_table({"object_mass": [1.3]}, 3, seed=2)
    rows = [[*row, session] for session, part in (("A", light), ("B", heavy)) for row in part]
    table = read_impact_table(
        write_csv(tmp_path / "pushes.csv", [*header, "session"], rows), load_scenario("push"), covariates=["session"]
    )
    source = ImpactTableSource(table, NOMINAL, discrepancy=NO_MAP_DISCREPANCY)
    document = diagnose(source, NOMINAL, ["object_mass"])
    intervals = of_levels(found(document)["object_mass", "session"], "scale")
    assert intervals["A"][0] < 1.1 < intervals["A"][1] < intervals["B"][0] < 1.3 < intervals["B"][1]
    assert [view.verdict for view in document.views[:2]] == ["object_mass", "object_mass"]  # and no more is missing


def test_covariates_that_go_together_are_said(tmp_path: Path) -> None:
    def cold_first(rng: np.random.Generator, row: int) -> Circumstances:
        return {"session": "AB"[row % 2], "temperature": float(rng.normal(20.0 + 10.0 * (row % 2), 0.5))}

    document = diagnosed(made(tmp_path / "balls.csv", bouncier, cold_first))
    assert "goes with temperature (correlation 0.99" in document.summary or "goes with session" in document.summary
    ((_, one),) = found(document).items()
    assert one.effect == "restitution" and len(one.rivals) == 1
    assert one.verdict.startswith("CONFUSABLE-WITH{restitution ")
    assert "these data cannot distinguish that from restitution " in document.summary


def test_a_covariate_that_goes_with_the_impact_speed_is_said(tmp_path: Path) -> None:
    """The velocity along the normal is the impact speed of a ball, with the other sign."""
    table = read_impact_table(made(tmp_path / "balls.csv", rows=30), covariates=["session", "vz_before"])
    session, velocity = covariate_documents(ImpactTableSource(table, NOMINAL))
    assert (session.goes_with, session.levels) == ({}, ("A", "B"))
    assert velocity.goes_with == pytest.approx({"impact speed": 1.0})
    assert velocity.unit == "m/s" and velocity.range[1] < 0.0


def test_numbers_of_sessions_may_be_names(tmp_path: Path) -> None:
    """Up and down again: no line, with as much in the first session as in the last."""

    def numbered(rng: np.random.Generator, row: int) -> Circumstances:
        return {"session": row % 3 + 1}

    def law(own: Circumstances) -> Racket:
        return Racket(lambda speed: 0.61 if own["session"] == 2 else 0.52, 0.2)

    document = diagnosed(made(tmp_path / "balls.csv", law, numbered, names=("session",)), "session")
    ((pair, one),) = found(document).items()
    assert (pair, one.verdict, set(one.levels)) == (("restitution", "session"), CONFIRMED, {"1", "2", "3"})
    assert {level: round(own["restitution"].estimate, 1) for level, own in one.levels.items()} == {
        "1": 0.5,
        "2": 0.6,
        "3": 0.5,
    }
    assert len(document.dependences) == len(CONSIDERED)  # a way each
    assert "in 1, 0.6" in document.summary


SHEETS = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 250.0, 340.0)  # of paper that a ball falls on


def on_paper(own: Circumstances) -> Racket:
    """Restitution that falls, rises and falls again with the number of sheets; a straight line through it is flat."""
    at, restitution = (0.0, 3.5, 5.0, 6.0), (0.49, 0.34, 0.59, 0.24)
    return Racket(lambda speed: float(np.interp(np.log(float(own["sheets"])), at, restitution)), 0.2)


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DiagnosisDocument]:
    def measured(rng: np.random.Generator, row: int) -> Circumstances:
        return {"sheets": SHEETS[rng.integers(len(SHEETS))], "height": float(rng.uniform(0.1, 0.5))}

    path = made(
        tmp_path_factory.mktemp("paper") / "balls.csv", on_paper, measured, rows=120, names=("sheets", "height")
    )
    return path, diagnosed(path, "sheets", "height")


def test_a_restitution_that_falls_rises_and_falls_with_a_number_is_found_as_a_curve(
    paper: tuple[Path, DiagnosisDocument],
) -> None:
    _, document = paper
    ((pair, one),) = found(document).items()
    assert (pair, one.verdict) == (("restitution", "sheets"), CONFIRMED)
    values = {float(knot): own["restitution"].estimate for knot, own in one.curve.items()}
    knots = sorted(values)
    at = [np.interp(sheets, knots, [values[knot] for knot in knots]) for sheets in SHEETS]
    truth = [on_paper({"sheets": sheets}).restitution(0.0) for sheets in SHEETS]
    assert at == pytest.approx(truth, abs=0.06)
    assert one.held_out_error_after < 0.9 * one.held_out_error_before
    assert (
        "restitution depends on sheets: " in document.summary and "(a curve, linear between these)" in document.summary
    )


def test_a_restitution_that_depends_on_a_number_is_not_added_as_one_value(
    tmp_path: Path, paper: tuple[Path, DiagnosisDocument]
) -> None:
    _, document = paper
    arguments = (NOMINAL, Path("nominal"), document, tmp_path / "diagnosis.json", ["restitution"], tmp_path / "m.yaml")
    with pytest.raises(InputError, match="restitution depends on sheets, and a model has one value for all"):
        add_effects(*arguments, False)
    assert "depends on sheets, the mean was taken" in add_effects(*arguments, True).note
    add_effects(*arguments[:4], ["support_friction"], tmp_path / "m.yaml", False)


def test_a_covariate_that_is_constant_within_every_condition_is_said_to_be_undecidable(tmp_path: Path) -> None:
    def own_surface(rng: np.random.Generator, row: int) -> Circumstances:
        return {"surface": f"surface {row // 6}"}

    path = made(tmp_path / "balls.csv", circumstances=lambda rng, row: own_surface(rng, row) | {"session": "A"},
                rows=48, repeats=6, names=("surface", "session"))  # fmt: skip
    document = diagnosed(path, "surface")
    assert "each level of surface was measured in one condition only" in document.summary
    assert "leave out column 'condition'" in document.summary


def test_levels_that_were_measured_too_seldom_are_not_judged(tmp_path: Path) -> None:
    def alone(rng: np.random.Generator, row: int) -> Circumstances:
        return {"session": f"number {row}", "temperature": 20.0}

    path = made(tmp_path / "balls.csv", lambda own: Racket(lambda speed: 0.55, 0.2), alone, rows=30)
    document = diagnosed(path)
    assert not document.dependences
    assert "Measured under too few circumstances to be judged: session, temperature." in document.summary


def test_folds_take_neighbours_in_turn_and_no_session_as_a_whole(tmp_path: Path) -> None:
    table = read_impact_table(made(tmp_path / "balls.csv", rows=90), covariates=["session"])
    source = ImpactTableSource(table, NOMINAL).knowing(())
    folds = folds_of(source)
    assert sorted(number for fold in folds for number in fold.held) == list(range(90))
    for fold in folds:
        assert set(fold.held) | set(fold.training) == set(range(90)) and not set(fold.held) & set(fold.training)
        assert [number // 6 for number in fold.held] == list(range(15))  # one of six neighbours each
        assert {source.covariates[0].values[number][0] for number in fold.held} == {"A", "B"}


def test_a_diagnosis_without_covariates_says_nothing_of_them(tmp_path: Path) -> None:
    table = read_impact_table(made(tmp_path / "balls.csv", rows=30))
    document = diagnose(ImpactTableSource(table, NOMINAL), NOMINAL, ["restitution"])
    assert not document.covariates and not document.dependences and "depend" not in document.summary


def covariate(*values: float | str) -> Covariate:
    return Covariate("any", "", (tuple(values),))


def test_a_level_goes_with_what_it_decides_and_not_with_what_it_leaves_open() -> None:
    session = covariate("A", "A", "B", "B")
    assert correlation_of(session, covariate("x", "x", "y", "y")) == pytest.approx(1.0)
    assert correlation_of(session, covariate(1.0, 2.0, 1.0, 2.0)) == pytest.approx(0.0, abs=1e-12)
    assert correlation_of(covariate(1.0, 2.0, 3.0), covariate(-2.0, -4.0, -6.0)) == pytest.approx(1.0)
    assert correlation_of(session, covariate("x", "x", "x", "x")) == 0.0
