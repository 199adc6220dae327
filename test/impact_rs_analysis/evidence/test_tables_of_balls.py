# SPDX-License-Identifier: Apache-2.0
"""Balls that bounce by closed forms, with noise and wrong assumptions: the law that acts is named, and no other."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import scipy
from ball_impacts import MASS, NOISE, RADIUS, TWIST, Racket, ball_table, bounced, turned_ball_table
from impact_table_cases import write_csv
from intervals import assert_covers

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.laws.discover import discover
from impact_rs_analysis.diagnosis.laws.grammar import load_grammar
from impact_rs_analysis.diagnosis.search.fit import Evidence
from impact_rs_analysis.diagnosis.verdict import TOO_FEW
from impact_rs_analysis.diagnosis.verdicts.residuals import beyond_stated_noise
from impact_rs_analysis.evidence.cluster import Cluster, Feature
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.tables.map_discrepancy import VELOCITY_AFTER
from impact_rs_sim.effects.formula import FormulaParameter, FormulaSpec
from impact_rs_sim.model import Model, load_model
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

from .conftest import assert_intervals

NOMINAL = load_model(Path("nominal"))
BODY = np.repeat(NOISE, 3)  # m/s, rad/s
CONSIDERED = [
    "restitution",
    "restitution_fall",
    "support_friction",
    "tangential_restitution",
    "drilling_friction",
    "rolling_resistance",
]


def of_balls(path: Path, racket: Racket, friction: float, restitution: float) -> ImpactTableSource:
    """150 impacts that are believed to have these two numbers."""
    return ImpactTableSource(
        read_impact_table(ball_table(path, racket, friction=friction, restitution=restitution)), NOMINAL
    )


@pytest.mark.parametrize(
    ("racket", "assumed", "truth"),
    [
        pytest.param(
            Racket(lambda v: 0.53, 0.212),
            (0.3, 0.45),
            {"restitution": {"restitution": 0.08}, "support_friction": {"friction": -0.088}},
            id="restitution and friction alone",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            Racket(lambda v: 0.912 - 0.0213 * v, 0.25),
            (0.3, 0.7),
            {
                "restitution": {"restitution": 0.212},
                "restitution_fall": {"fall": 0.0213},
                "support_friction": {"friction": -0.05},
            },
            id="restitution that falls with speed",
        ),
        pytest.param(
            Racket(lambda v: 0.6, 0.6, lambda s: 0.817 - 0.022 * s),
            (0.5, 0.5),
            {
                "restitution": {"restitution": 0.1},
                "support_friction": {"friction": 0.1},
                "tangential_restitution": {"restitution": 0.817, "fall": 0.022},
            },
            id="a slip that is thrown back",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            Racket(lambda v: 0.53, 0.212, drilling=0.001),
            (0.4, 0.2),
            {
                "restitution": {"restitution": 0.33},
                "support_friction": {"friction": -0.188},
                "drilling_friction": {"arm": 0.001},
            },
            id="a spin that is slowed",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            Racket(lambda v: 0.53, 0.0, rolling=0.001),
            (0.02, 0.45),
            {"restitution": {"restitution": 0.08}, "rolling_resistance": {"arm": 0.001}},
            id="a smooth face that resists rolling",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_law_of_a_contact_is_named_with_its_numbers(
    tmp_path: Path, racket: Racket, assumed: tuple[float, float], truth: dict[str, dict[str, float]]
) -> None:
    source = of_balls(tmp_path / "balls.csv", racket, *assumed)
    document = diagnose(source, NOMINAL, CONSIDERED)
    assert set(document.named) >= set(truth)
    assert set(document.named) - set(truth) <= {"support_friction"}
    assert document.noise_floor is not None
    assert document.held_out_error_after < 1.1 * document.noise_floor
    for effect, parameters in truth.items():
        for name, value in parameters.items():
            found = document.effect(effect).parameters[name]
            low, high = found.interval
            assert found.estimate == pytest.approx(value, abs=max(1.5 * (high - low) / 2.0, 1e-6)), (effect, name)


@pytest.mark.parametrize("friction", [0.0, *(pytest.param(value, marks=pytest.mark.slow) for value in (0.1, 1.0))])
def test_the_friction_that_is_assumed_does_not_matter(tmp_path: Path, friction: float) -> None:
    """None, less and more than there is."""
    source = of_balls(tmp_path / "balls.csv", Racket(lambda v: 0.53, 0.212), friction, 0.0)
    document = diagnose(source, NOMINAL, CONSIDERED[:4])
    assert set(document.named) == {"restitution", "support_friction"}
    truth = {("support_friction", "friction"): 0.212 - friction, ("restitution", "restitution"): 0.53}
    assert_intervals(source, document, truth, BODY)


def test_a_formula_of_ones_own_is_a_rival(tmp_path: Path) -> None:
    """Restitution of a contact that yields falls with the fourth root of the speed (Johnson 1985, sec. 11.5)."""
    unit = FormulaParameter(unit="-", lower=-1.0, upper=1.0, scale=0.05)
    law = FormulaSpec(
        name="yielding_contact",
        sentence="The contact yields.",
        contact={"restitution": "c * (1 - (v / 5) ** 0.25)"},
        parameters={"c": unit},
    )
    racket = Racket(lambda v: 0.5 + 0.6 * (1.0 - (v / 5.0) ** 0.25), 0.3)
    path = ball_table(tmp_path / "balls.csv", racket, friction=0.3, restitution=0.5)
    model = Model(name="nominal", formulas=(law,))
    source = ImpactTableSource(read_impact_table(path), model)
    document = diagnose(source, model, ["restitution", "yielding_contact", "support_friction"])
    assert document.named == ("yielding_contact",)
    assert document.effect("yielding_contact").parameters["c"].estimate == pytest.approx(0.6, abs=0.15)
    assert document.held_out_error_after < 1.1 * document.noise_floor


def test_a_ball_needs_no_pose_and_a_hollow_one_turns_more_slowly(tmp_path: Path) -> None:
    table = read_impact_table(ball_table(tmp_path / "balls.csv", Racket(), rows=12, noise=(0.0, 0.0)))
    physics = table.rows[0].physics
    assert physics.object.round
    np.testing.assert_allclose(physics.object.inertia, 2.0 / 3.0 * 0.0027 * 0.02**2)
    source = ImpactTableSource(table, NOMINAL)
    with_truth = source.predicted_with((("restitution", (0.5,)), ("support_friction", (-0.1,))))
    np.testing.assert_allclose(with_truth, source.measured, atol=1e-9)
    assert NOISE[0] < source.size()  # without the truth the difference is larger than the noise of real impacts


def test_a_ball_whose_spin_was_not_measured_after_the_impact_is_compared_by_its_velocity(tmp_path: Path) -> None:
    """A camera that follows the centre alone still shows both coefficients."""
    path = ball_table(tmp_path / "balls.csv", Racket(lambda v: 0.53, 0.212), friction=0.3, restitution=0.45)
    header, *rows = csv.reader(path.read_text().splitlines())
    kept = [n for n, name in enumerate(header) if not (name.startswith("w") and ("_after" in name or "_noise" in name))]
    seen = write_csv(tmp_path / "seen.csv", [header[n] for n in kept], [[row[n] for n in kept] for row in rows])
    source = ImpactTableSource(read_impact_table(seen), NOMINAL)
    assert {feature.signal for feature in source.signals} == {VELOCITY_AFTER}
    assert source.measured.shape == source.predicted.shape == (len(rows), 3)
    np.testing.assert_allclose(source.noise, NOISE[0])
    document = diagnose(source, NOMINAL, ["restitution", "support_friction"])
    assert set(document.named) == {"restitution", "support_friction"}
    truth = {("restitution", "restitution"): 0.08, ("support_friction", "friction"): -0.088}
    assert_intervals(source, document, truth, BODY[:3])


@pytest.mark.parametrize("stated", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_small_fall_of_restitution_is_named_beside_a_noisy_spin(tmp_path: Path, stated: bool) -> None:
    """Noise of 30 rad/s is nine tenths of the error, and the fall moves the velocity along the normal alone."""
    racket = Racket(lambda v: 0.7 - 0.0217 * v, 0.2)
    path = ball_table(tmp_path / "balls.csv", racket, rows=120, noise=(0.1, 30.0), stated=stated)
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution", "support_friction", "restitution_fall", "drilling_friction"])
    assert set(document.named) == {"restitution", "support_friction", "restitution_fall"}
    fall = document.effect("restitution_fall")
    assert str(fall.verdict) == "CONFIRMED" and fall.p_value <= 0.001
    assert_covers(fall.parameters["fall"].interval, 0.0217, 0.003)


def test_what_is_left_beyond_stated_noise_is_lack_of_fit(tmp_path: Path) -> None:
    """A face that is slippery in every second impact leaves 1.5 times the noise that is stated; no effect does so."""
    rng = np.random.default_rng(3)
    slippery, rough = (Racket(lambda v: 0.6, friction) for friction in (0.1, 0.3))
    (first, *one), (_, *other) = (
        list(csv.reader(ball_table(tmp_path / f"{n}.csv", racket, rows=120, seed=5, noise=(0.3, 10.0)).open()))
        for n, racket in enumerate((slippery, rough))
    )
    rows = [pair[int(rng.integers(2))] for pair in zip(one, other, strict=True)]
    mixed = read_impact_table(write_csv(tmp_path / "mixed.csv", first, rows))
    document = diagnose(ImpactTableSource(mixed, NOMINAL), NOMINAL, ["restitution", "support_friction"])
    assert document.noise_floor < document.held_out_error_after < 2.0 * document.noise_floor
    assert document.verdict.kind == "PARTLY" and "at least one more effect" in document.summary
    assert document.lack_of_fit.after <= 0.001
    alike = read_impact_table(write_csv(tmp_path / "alike.csv", first, one))
    document = diagnose(ImpactTableSource(alike, NOMINAL), NOMINAL, ["restitution", "support_friction"])
    assert str(document.verdict) == "+".join(document.named) and document.lack_of_fit.after > 0.01


def test_noise_passes_for_lack_of_fit_as_often_as_it_should() -> None:
    """The chi-square test, with noise alone and with a discrepancy that all rows share: p < 5 % in 5 % or fewer."""
    rng = np.random.default_rng(0)
    features = tuple(Feature("impact", "velocity", axis, 0, "m/s", 0.0) for axis in "xyz")
    for discrepancy, beyond in ((0.0, 1.4), (0.5, 5.0)):
        found = []
        for _ in range(400):
            shared = discrepancy * rng.standard_normal(3)
            rest = [shared + 0.5 * rng.standard_normal(3) for _ in range(40)]
            clusters = tuple(one_row(features, values, discrepancy) for values in rest)
            evidence = Evidence(None, tuple(range(40)), clusters)
            found.append(beyond_stated_noise(evidence, rest))
        assert np.mean(np.array(found) < 0.05) < 0.08
        assert beyond_stated_noise(evidence, [beyond * values for values in rest]) < 0.01


def one_row(features: tuple[Feature, ...], values: np.ndarray, discrepancy: float) -> Cluster:
    """A row with noise of 0.5 and a discrepancy, on the scale of 1."""
    own = {"name": "row", "condition_key": ("", "", ""), "layout": "impacts", "unit": "row", "contact": True}
    sizes = {"sigma": np.ones(3), "pure_error": np.full(3, 0.5), "discrepancy": np.full(3, discrepancy)}
    return Cluster(**own, features=features, residuals=values[None], **sizes)


@pytest.mark.parametrize("stated", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_more_restitution_and_a_fall_of_it_are_found_together_where_neither_helps_alone(
    tmp_path: Path, stated: bool
) -> None:
    """A restitution of 0.54 is right at the speeds that decide, so that more of it, or a fall of it alone, is wrong."""
    racket = Racket(lambda v: 0.7 - 0.03 * v, 0.2)
    assumed = {"friction": 0.2, "restitution": 0.54}
    path = ball_table(tmp_path / "balls.csv", racket, rows=120, noise=(0.1, 10.0), stated=stated, **assumed)
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    document = diagnose(source, NOMINAL, CONSIDERED[:4])
    assert set(document.named) == {"restitution", "restitution_fall"}
    truth = {("restitution", "restitution"): 0.16, ("restitution_fall", "fall"): 0.03}
    assert_intervals(source, document, truth, np.repeat((0.1, 10.0), 3))


def rebound_of_force(dissipation: float, speed: float) -> float:
    """Restitution of a force k x (1 + d dx/dt), integrated over the contact in units of 1 / omega."""
    ends = scipy.integrate.solve_ivp(
        lambda _, s: [s[1], -max(s[0], 0.0) * (1.0 + dissipation * s[1])], (0.0, 10.0), [0.0, speed],
        events=lambda t, s: s[0] if t > 1e-3 else 1.0, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    return float(-ends.y_events[0][0][1] / speed)


LAWS_THAT_BEND = ["restitution", "restitution_fall", "contact_dissipation", "restitution_threshold"]


@pytest.mark.parametrize(
    ("racket", "truth"),
    [
        (
            Racket(lambda v: rebound_of_force(0.1, v)),
            {"restitution": (1.0, 0.0021), "contact_dissipation": (0.1, 0.0014)},
        ),
        pytest.param(
            Racket(lambda v: 0.6 if v > 4.0 else 0.0),
            {"restitution": (0.6, 0.00092), "restitution_threshold": (4.0, 0.0)},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["dissipation", "threshold"],
)
def test_a_restitution_that_bends_with_speed_is_named_by_its_law(
    tmp_path: Path, racket: Racket, truth: dict[str, tuple[float, float]]
) -> None:
    """Kills a straight fall in the place of the curve: its residual is far above the noise."""
    table = ball_table(tmp_path / "balls.csv", racket, rows=90, noise=(0.02, 2.0), friction=0.2, restitution=0.0)
    source = ImpactTableSource(read_impact_table(table), NOMINAL)
    document = diagnose(source, NOMINAL, LAWS_THAT_BEND)
    assert set(document.named) == set(truth)
    for name, (value, half_width) in truth.items():
        first, *_ = document.effect(name).parameters.values()
        if half_width:
            assert_covers(first.interval, value, half_width)
        else:  # the law is smooth, and this threshold is a step
            assert first.estimate == pytest.approx(value, rel=0.03)


@pytest.mark.parametrize("stated", [True, False])
def test_impacts_that_gain_energy_in_every_row_are_no_lack_of_an_effect(tmp_path: Path, stated: bool) -> None:
    """A face that moves towards the ball by 1 m/s: what the table holds is not the velocity against it."""
    source = ImpactTableSource(read_impact_table(driven(tmp_path / "balls.csv", 1.0, stated)), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution", "support_friction"])
    assert str(document.verdict) == "IMPOSSIBLE-DATA" and not document.named
    assert document.summary.startswith("These 60 impacts break a law of every impact, so no effect is named: kinetic ")
    assert "kinetic energy grows in 60 of 60 rows" in document.summary and "lacks" not in document.summary
    assert {str(effect.verdict) for effect in document.effects} == {"NOT-IDENTIFIABLE"}
    assert not document.verdict.leaves_residuals and not document.not_excluded
    found = discover(lambda model: source, NOMINAL, load_grammar(), ["restitution"])
    assert str(found.verdict) == "IMPOSSIBLE-DATA" and not found.laws


def test_a_perfectly_elastic_ball_with_noise_gains_no_energy(tmp_path: Path) -> None:
    """Every second row gains some by noise."""
    source = ImpactTableSource(read_impact_table(driven(tmp_path / "balls.csv", 0.0, True)), NOMINAL)
    assert not source.impossible
    assert diagnose(source, NOMINAL, ["restitution", "support_friction"]).named == ("restitution",)


def driven(path: Path, speed: float, stated: bool) -> Path:
    """A table of 60 elastic balls on a smooth face that moves by ``speed`` [m/s] towards them."""
    path = ball_table(path, Racket(lambda v: 1.0, 0.0), rows=60, noise=(0.1, 5.0), stated=stated, friction=0.0)
    header, *rows = list(csv.reader(path.open()))
    up = header.index("vz_after [m/s]")
    return write_csv(path, header, [[*row[:up], float(row[up]) + 2.0 * speed, *row[up + 1 :]] for row in rows])


@pytest.mark.slow
def test_spins_in_axes_that_are_five_degrees_off_are_no_drilling_friction(tmp_path: Path) -> None:
    """Topspin on a rough face: seen from turned axes, a part of the spin about the normal is lost in every impact."""
    angle = np.radians(5.0)
    table = read_impact_table(turned_ball_table(tmp_path / "balls.csv", angle))
    document = diagnose(ImpactTableSource(table, NOMINAL), NOMINAL, [*CONSIDERED[:4], "drilling_friction", "spin_axes"])
    assert set(document.named) == {"restitution", "support_friction", "spin_axes"}
    assert_covers(document.effect("spin_axes").parameters["x"].interval, angle, 0.0033)
    assert document.held_out_error_after < 1.1 * document.noise_floor


def repeated_table(path: Path, racket: Racket, noise: float, rows: int = 6) -> ImpactTableSource:
    """Balls without spin in three conditions, twice each, believed to be without friction."""
    header = [
        f"{name}_{tail} [{'m/s' if name[0] == 'v' else 'rad/s'}]" for tail in ("before", "after") for name in TWIST
    ]
    rng, found = np.random.default_rng(0), []
    for row in range(rows):
        along, fall = ((1.0, 2.0), (0.6, 3.0), (2.0, 2.5))[row // 2]
        before = np.array([along, 0.0, -fall, 0.0, 0.0, 0.0])
        after = bounced(before, racket) + noise * np.repeat((1.0, 2500.0), 3) * rng.standard_normal(6)
        found.append([f"case {row // 2}", *before, *after, MASS, RADIUS, 1.0, 0.0, 0.6])
    assumed = ["mass [kg]", "radius [m]", "shell [-]", "friction [-]", "restitution [-]"]
    return ImpactTableSource(read_impact_table(write_csv(path, ["condition", *header, *assumed], found)), NOMINAL)


def test_two_effects_of_which_one_acts_only_beside_the_other_are_held_out_together(tmp_path: Path) -> None:
    """Folds of two conditions are fitted alone. Kills: they do not look beside; friction returns to 0 if it sticks."""
    source = repeated_table(tmp_path / "a.csv", Racket(lambda v: 0.6, 0.9, lambda s: 0.5), 0.004)
    document = diagnose(source)
    assert set(document.named) == {"support_friction", "tangential_restitution"}
    assert document.held_out_error_after < 0.5 * document.held_out_error_before
    tangential = document.effect("tangential_restitution")
    assert tangential is not None and tangential.parameters["restitution"].estimate == pytest.approx(0.5, abs=0.02)


def test_repeats_without_scatter_and_a_single_row_end_in_a_verdict(tmp_path: Path) -> None:
    """Simulated or rounded data. Kills a division by no noise, and one by no degree of freedom."""
    assert "restitution" in diagnose(repeated_table(tmp_path / "a.csv", Racket(lambda v: 0.8, 0.0), 0.0)).named
    assert diagnose(repeated_table(tmp_path / "b.csv", Racket(lambda v: 0.8), 0.0, 1)).verdict == TOO_FEW
