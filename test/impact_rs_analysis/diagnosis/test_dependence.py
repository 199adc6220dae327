# SPDX-License-Identifier: Apache-2.0
"""What depends on a circumstance is found: in a world with a closed form, gate by gate, and in tables of balls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from analytic_world import EFFECTS, InSessions, direction, knowing
from ball_impacts import MASS, RADIUS, TWIST, Racket, bounced, thrown
from impact_table_cases import arm_table, write_csv
from intervals import assert_covers

from impact_rs_analysis.diagnosis import dependence
from impact_rs_analysis.diagnosis.dependence import Dependences, dependences_of
from impact_rs_analysis.diagnosis.dependence_verdicts import correlation_of, covariate_documents, dependence_documents
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DependenceDocument, DiagnosisDocument
from impact_rs_analysis.diagnosis.search.effect_selection import Search
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.search.hold_out import Fold, folds_of
from impact_rs_analysis.diagnosis.verdict import CONFIRMED
from impact_rs_analysis.diagnosis.verdicts.model_verdict import Findings
from impact_rs_analysis.evidence.source import Covariate
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import NO_MAP_DISCREPANCY
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, load_model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

OF_SESSION = "straight by level of session"
HALF = 1.96 / np.sqrt(12.0 * 40.0)  # of a size in one session: 12 rows of 40 features with noise of 1


def in_session(session: str | float, warmth: float) -> float:
    """2 in one session and 5 in the other."""
    return 2.0 if session == "A" else 5.0


def depending(source: InSessions, *names: str) -> Dependences:
    """Dependences of what a search with one value for all circumstances finds."""
    search = Search([EFFECTS[name] for name in names or ("straight", "bent")], Evidence.of(source))
    found = dependences_of(Findings(search, search.forward_selection(), (), None, {}))
    assert found is not None
    return found


@cache
def honest() -> Dependences:
    return depending(InSessions(1, in_session))


def test_an_effect_that_depends_on_a_covariate_is_shown_by_its_own_name() -> None:
    """With one estimate for all circumstances. Kills: the name or the estimates of the pair in a document."""
    source = knowing(InSessions(1, in_session, 2.0), EFFECTS["straight"], EFFECTS["twin_of_straight"])
    document = diagnose(source, source.model)
    assert (str(document.verdict), document.named) == ("PARTLY{straight}", ("straight",))
    straight, twin = document.effects
    assert (straight.name, list(straight.parameters)) == ("straight", ["a"])
    assert straight.parameters["a"].estimate == pytest.approx(3.5, abs=0.3)
    assert (twin.name, str(twin.verdict), twin.rivals) == ("twin_of_straight", "NO-IMPROVEMENT", ())
    assert OF_SESSION not in document.model_dump_json()


def only(found: Dependences) -> DependenceDocument:
    """The one dependence that is found."""
    (one,) = (one for one in dependence_documents(found) if one.accepted)
    return one


@pytest.mark.parametrize(("p", "accepted"), [(0.0045, True), (0.0055, False)])
def test_a_dependence_is_accepted_where_it_is_significant_among_all_pairs(
    p: float, accepted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two pairs half of 1 % decides; the sizes pass every other gate. Kills: p not asked, or not adjusted."""

    def fold_results(evidence: Evidence, fitted: object, found: dict[str, object]) -> dict[str, float]:
        return {name: p if name == OF_SESSION else 1.0 for name in found}

    monkeypatch.setattr(dependence, "_p_values", fold_results)
    choice = depending(InSessions(1, in_session)).choice
    assert [pair.name for pair in choice.pairs] == ([OF_SESSION] if accepted else [])
    assert accepted or choice.p_values[OF_SESSION] == pytest.approx(2.0 * p)


@pytest.mark.parametrize(("outside", "accepted"), [(2.5, True), (5.5, False)])
def test_a_dependence_is_accepted_where_it_lowers_the_error_by_a_tenth(outside: float, accepted: bool) -> None:
    """1.5^2 of 1.5^2 + outside^2, both significant: 26 % and 7 %. Kills: the gain is not asked after the fit."""
    choice = depending(InSessions(1, in_session, outside)).choice
    assert [pair.name for pair in choice.pairs] == ([OF_SESSION] if accepted else [])
    assert choice.p_values[OF_SESSION] < 0.005


@pytest.mark.parametrize(
    ("folds", "better", "supported"), [(6, True, True), (4, True, True), (3, True, False), (6, False, False)]
)
def test_a_dependence_is_supported_where_most_folds_find_it_and_predict_better_with_it(
    folds: int, better: bool, supported: bool
) -> None:
    """Hold-outs as they might be, of a dependence that is there. Kills: majority or held-out error not asked."""
    source, whole = InSessions(1, in_session), honest()
    assert len(whole.folds) == 6 and [pair.name for pair in whole.pairs] == [OF_SESSION]
    after = whole.after if better else whole.before

    def fold_results(function: object, tasks: Sequence[Fold], what: str) -> list[object]:
        return [
            ((OF_SESSION,) if number < folds else (), {n: (whole.before[n], after[n]) for n in fold.held_out})
            for number, fold in enumerate(tasks)
        ]

    source.distribute = fold_results  # type: ignore[assignment, method-assign]
    found = depending(source)
    assert [pair.name for pair in found.choice.pairs] == [OF_SESSION]
    assert [pair.name for pair in found.pairs] == ([OF_SESSION] if supported else [])
    assert (found.fit is not None and OF_SESSION in found.fit.candidate.names) == supported


def test_a_row_that_is_held_out_does_not_change_its_prediction_by_dependences() -> None:
    """Spoil one row along the effect. Kills: a fold is fitted with what it has to predict."""
    spoiled = InSessions(1, in_session)
    spoiled.spoil(7, 4.0 * direction(7, 0))
    found = [(InSessions(1, in_session), honest()), (spoiled, depending(spoiled))]
    for rests in ([one.before for _, one in found], [one.after for _, one in found]):
        predicted = [source.clusters[7].mean - rest[7] for (source, _), rest in zip(found, rests, strict=True)]
        np.testing.assert_allclose(*predicted, atol=1e-6)


@pytest.mark.parametrize(
    ("again", "settled"), [((OF_SESSION,), True), (("bent",), True), (("straight",), False), ((), False)]
)
def test_a_search_with_dependences_settles_them_where_it_finds_them_or_other_effects(
    again: tuple[str, ...], settled: bool
) -> None:
    """Kills: what scatter hides is taken for an answer."""
    first, second = (cast(Findings, SimpleNamespace(names=names)) for names in (("straight",), again))
    assert honest().confirmed_by(first, second) == settled


def test_where_nothing_depends_on_anything_nothing_is_said() -> None:
    """In 12 worlds, one for each way to depend on the session or the temperature."""
    for seed in range(12):
        warmth = np.random.default_rng(seed).uniform(15.0, 35.0, 24)
        found = depending(InSessions(seed, lambda session, warm: 3.0, warmth=warmth.tolist()))
        assert len(found.tried) >= 4 and not found.pairs, seed


@pytest.mark.parametrize("mean", [3.5, 0.0])
def test_sizes_that_differ_between_sessions_are_found_also_where_nothing_is_missing_on_average(mean: float) -> None:
    one = only(depending(InSessions(1, lambda session, warm: mean + (1.5 if session == "B" else -1.5))))
    assert (one.effect, one.covariate, one.verdict, one.chosen_in_folds) == ("straight", "session", CONFIRMED, 6)
    for level, truth in (("A", mean - 1.5), ("B", mean + 1.5)):
        assert_covers(one.levels[level]["a"].interval, truth, HALF)
    assert one.held_out_error_before == pytest.approx(np.hypot(1.0, 1.5), rel=0.1)
    assert one.held_out_error_after == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("unit", [1.0, 10.0])
def test_a_size_that_falls_with_temperature_is_found_with_its_slope_in_any_unit(unit: float) -> None:
    """0.1 a degree over 20 degrees: the half width is 1.96 over the root of 40 sum (T - mean)^2."""
    warmth = np.random.default_rng(0).uniform(15.0, 35.0, 24)
    found = depending(
        InSessions(2, lambda session, warm: 3.0 - 0.1 * (warm / unit - 25.0), warmth=(unit * warmth).tolist())
    )
    one = only(found)
    slope = one.per_unit["a"]
    assert (one.covariate, slope.unit) == ("warmth", "1/degC")
    assert_covers(slope.interval, -0.1 / unit, 1.96 / unit / np.sqrt(40.0 * np.sum(np.square(warmth - warmth.mean()))))
    assert_covers(one.at_mean["a"].interval, 3.0 - 0.1 * (warmth.mean() - 25.0), HALF / np.sqrt(2.0))


def test_a_size_that_falls_rises_and_falls_with_a_number_is_found_as_a_curve() -> None:
    at, sizes = (15.0, 20.0, 28.0, 35.0), (5.0, 2.0, 6.0, 1.0)
    warmth = np.random.default_rng(0).uniform(15.0, 35.0, 60)
    found = depending(
        InSessions(3, lambda session, warm: float(np.interp(warm, at, sizes)), count=60, warmth=warmth.tolist())
    )
    one = only(found)
    knots = sorted(map(float, one.curve))
    values = [one.curve[f"{knot:g}"]["a"].estimate for knot in knots]
    assert (one.verdict, len(knots)) == (CONFIRMED, 5)
    assert np.interp(warmth, knots, values) == pytest.approx(np.interp(warmth, at, sizes), abs=0.8)


def test_numbers_of_sessions_may_be_names() -> None:
    """Up and down again: no line, with as much in the first session as in the last."""
    sessions = [float(number % 3 + 1) for number in range(24)]
    one = only(depending(InSessions(1, lambda session, warm: 5.0 if session == 2.0 else 2.0, sessions=sessions)))
    assert one.verdict == CONFIRMED
    assert {level: own["a"].estimate for level, own in one.levels.items()} == pytest.approx(
        {"1": 2.0, "2": 5.0, "3": 2.0}, abs=2.0 * HALF
    )


def test_covariates_that_go_together_are_rivals_of_each_other() -> None:
    """What was cold was also measured first; a level predicts as well as the temperature."""
    warmth = [20.0 + 10.0 * (row % 2) + 0.05 * np.sin(row) for row in range(24)]
    source = InSessions(1, in_session, warmth=warmth)
    assert {item.name: dict(item.goes_with) for item in covariate_documents(source)} == {
        "session": pytest.approx({"warmth": 1.0}, abs=1e-3), "warmth": pytest.approx({"session": 1.0}, abs=1e-3)
    }  # fmt: skip
    one = only(depending(source))
    assert len(one.rivals) == 1 and str(one.verdict) == f"CONFUSABLE-WITH{{{one.rivals[0]}}}"


NOMINAL = load_model(Path("nominal"))
CONSIDERED = ["restitution", "support_friction", "restitution_fall"]
NOISE = np.repeat((0.1, 10.0), 3)  # m/s, rad/s
Circumstances = dict[str, float | str]


def sessions(rng: np.random.Generator, row: int) -> Circumstances:
    """Two sessions in turn, at any temperature."""
    return {"session": "AB"[row % 2], "temperature": float(rng.uniform(15.0, 35.0))}


WIDE = 0.007  # half width of a restitution of 45 balls whose velocity is off by 0.1 of about 5 m/s


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
    return {(one.effect, one.covariate): one for one in document.dependences if one.accepted}


@pytest.fixture(scope="module")
def table_of_two_sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("sessions") / "balls.csv", rows=72)


@pytest.fixture(scope="module")
def two_sessions(table_of_two_sessions: Path) -> tuple[Path, DiagnosisDocument]:
    return table_of_two_sessions, diagnosed(table_of_two_sessions)


@pytest.mark.slow
def test_a_restitution_that_differs_between_sessions_is_found_and_nothing_else(
    two_sessions: tuple[Path, DiagnosisDocument],
) -> None:
    _, document = two_sessions
    ((pair, one),) = found(document).items()
    assert (pair, one.verdict) == (("restitution", "session"), CONFIRMED)
    for level, truth in (("A", 0.52), ("B", 0.61)):
        assert_covers(one.levels[level]["restitution"].interval, truth, WIDE)
    assert one.held_out_error_after < 0.9 * one.held_out_error_before
    assert document.held_out_error_after == pytest.approx(one.held_out_error_after, rel=0.05)
    assert set(document.named) == {"restitution", "support_friction"}
    assert not document.confusable
    assert "restitution depends on session: 0.5" in document.summary
    assert " in A, 0.6" in document.summary and "; held-out error 0." in document.summary
    tried = {(other.effect, other.covariate) for other in document.dependences}
    assert tried == {(effect, name) for effect in CONSIDERED for name in ("session", "temperature")}
    assert all(other.p_value is None or other.p_value > 0.01 for other in document.dependences if not other.accepted)


@pytest.mark.slow
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


def test_an_effect_that_the_model_has_may_depend_on_a_session_beyond_that(table_of_two_sessions: Path) -> None:
    """With mean restitution and friction in the model nothing is missing on average, and no other effect is blamed."""
    items = [("restitution", "restitution", 0.565), ("support_friction", "friction", -0.1)]
    effects = [
        ModelEffect(name=name, parameters={key: ParameterValue(estimate=value, unit="-")}) for name, key, value in items
    ]
    model = Model(name="pooled", effects=tuple(effects))
    source = ImpactTableSource(read_impact_table(table_of_two_sessions, covariates=["session"]), model)
    document = diagnose(source, model)
    assert not document.named
    ((pair, one),) = found(document).items()
    assert pair == ("restitution", "session")
    for level, truth in (("A", 0.52 - 0.565), ("B", 0.61 - 0.565)):
        assert_covers(one.levels[level]["restitution"].interval, truth, WIDE)


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
    normal, pooled = (one.clusters[0].pure_error[0] * one.clusters[0].sigma[0] for one in (source, together))
    assert normal == pytest.approx(NOISE[0], rel=0.2) and pooled > 1.5 * normal


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "options", "words"),
    [
        (bouncier, {"rows": 48, "repeats": 6}, "restitution depends on session: 0.5"),
        (warmer, {}, " per degC; held-out error "),
        (
            lambda own: Racket(lambda speed: 0.55, 0.2),
            {},
            "No dependence was found on session (a value for each level) or temperature (a straight line, ",
        ),
    ],
    ids=["repeats", "slope", "nothing"],
)
def test_dependences_of_balls_are_found_and_said(
    law: Callable[[Circumstances], Racket], options: dict[str, int], words: str, tmp_path: Path
) -> None:
    document = diagnosed(made(tmp_path / "balls.csv", law, **options))
    assert words in document.summary and len(found(document)) == ("No" not in words)


@pytest.mark.slow
def test_an_object_that_was_heavier_in_one_session_is_so_for_joints_and_object_alike(tmp_path: Path) -> None:
    header, light = arm_table({"object_mass": [1.1]}, 3, seed=1)
    _, heavy = arm_table({"object_mass": [1.3]}, 3, seed=2)
    rows = [[*row, session] for session, part in (("A", light), ("B", heavy)) for row in part]
    table = read_impact_table(
        write_csv(tmp_path / "pushes.csv", [*header, "session"], rows), load_scenario("push"), covariates=["session"]
    )
    source = ImpactTableSource(table, NOMINAL, discrepancy=NO_MAP_DISCREPANCY)
    document = diagnose(source, NOMINAL, ["object_mass"])
    levels = found(document)["object_mass", "session"].levels
    for level, truth in (("A", 1.1), ("B", 1.3)):
        assert_covers(levels[level]["scale"].interval, truth, 0.02)
    assert [str(view.verdict) for view in document.views[:2]] == ["object_mass"] * 2  # and no more is missing


def test_a_covariate_that_goes_with_the_impact_speed_is_said(tmp_path: Path) -> None:
    """The velocity along the normal is the impact speed of a ball, with the other sign."""
    table = read_impact_table(made(tmp_path / "balls.csv", rows=30), covariates=["session", "vz_before"])
    session, velocity = covariate_documents(ImpactTableSource(table, NOMINAL))
    assert (session.goes_with, session.levels) == ({}, ("A", "B"))
    assert velocity.goes_with == pytest.approx({"impact speed": 1.0})
    assert velocity.unit == "m/s" and velocity.range[1] < 0.0


def test_a_covariate_that_is_constant_within_every_condition_is_said_to_be_undecidable(tmp_path: Path) -> None:
    def own_surface(rng: np.random.Generator, row: int) -> Circumstances:
        return {"surface": f"surface {row // 6}"}

    path = made(tmp_path / "balls.csv", circumstances=lambda rng, row: own_surface(rng, row) | {"session": "A"},
                rows=48, repeats=6, names=("surface", "session"))  # fmt: skip
    (surface,) = covariate_documents(ImpactTableSource(read_impact_table(path, covariates=["surface"]), NOMINAL))
    assert "each level of surface was measured in one condition only" in surface.why_not
    assert "leave out column 'condition'" in surface.why_not


def test_levels_that_were_measured_too_seldom_are_not_judged(tmp_path: Path) -> None:
    def alone(rng: np.random.Generator, row: int) -> Circumstances:
        return {"session": f"number {row}", "temperature": 20.0}

    path = made(tmp_path / "balls.csv", lambda own: Racket(lambda speed: 0.55, 0.2), alone, rows=30)
    document = diagnosed(path)
    assert not document.dependences
    assert "Measured under too few circumstances to be judged: session, temperature." in document.summary


def test_folds_take_neighbours_in_turn_and_no_session_as_a_whole(tmp_path: Path) -> None:
    table = read_impact_table(made(tmp_path / "balls.csv", rows=90), covariates=["session"])
    source = ImpactTableSource(table, NOMINAL).with_dependences(())
    folds = folds_of(source)
    assert sorted(number for fold in folds for number in fold.held_out) == list(range(90))
    for fold in folds:
        assert set(fold.held_out) | set(fold.training) == set(range(90)) and not set(fold.held_out) & set(fold.training)
        assert [number // 6 for number in fold.held_out] == list(range(15))  # one of six neighbours each
        assert {source.covariates[0].values[number][0] for number in fold.held_out} == {"A", "B"}


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
