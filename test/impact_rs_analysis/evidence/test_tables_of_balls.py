# SPDX-License-Identifier: Apache-2.0
"""Balls that bounce by closed forms, with noise and wrong assumptions: the law that acts is named, and no other."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from ball_impacts import NOISE, Racket, ball_table
from impact_table_cases import write_csv

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.evidence.impact_tables import ImpactTableSource
from impact_rs_analysis.evidence.map_discrepancy import LINEAR
from impact_rs_sim.effects.formula import FormulaParameter, FormulaSpec
from impact_rs_sim.model import Model, load_model
from impact_rs_trials.recordings.impact_table import read_impact_table

NOMINAL = load_model(Path("nominal"))
CONSIDERED = [
    "restitution",
    "restitution_fall",
    "support_friction",
    "tangential_restitution",
    "drilling_friction",
    "rolling_resistance",
]


def of_balls(path: Path, racket: Racket, friction: float, restitution: float) -> DiagnosisDocument:
    """What 150 impacts lack that are believed to have these two numbers."""
    table = read_impact_table(ball_table(path, racket, friction=friction, restitution=restitution))
    return diagnose(ImpactTableSource(table, NOMINAL), NOMINAL, CONSIDERED)


@pytest.mark.parametrize(
    ("racket", "assumed", "truth"),
    [
        pytest.param(
            Racket(lambda v: 0.53, 0.212),
            (0.3, 0.45),
            {"restitution": {"restitution": 0.08}, "support_friction": {"friction": -0.088}},
            id="restitution and friction alone",
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
        ),
        pytest.param(
            Racket(lambda v: 0.53, 0.0, rolling=0.001),
            (0.02, 0.45),
            {"restitution": {"restitution": 0.08}, "rolling_resistance": {"arm": 0.001}},
            id="a smooth face that resists rolling",
        ),
    ],
)
def test_the_law_of_a_contact_is_named_with_its_numbers(
    tmp_path: Path, racket: Racket, assumed: tuple[float, float], truth: dict[str, dict[str, float]]
) -> None:
    document = of_balls(tmp_path / "balls.csv", racket, *assumed)
    assert set(document.named) >= set(truth)
    assert set(document.named) - set(truth) <= {"support_friction"}
    assert document.noise_floor is not None
    assert document.held_out_error_after < 1.1 * document.noise_floor
    for effect, parameters in truth.items():
        for name, value in parameters.items():
            found = document.effect(effect).parameters[name]
            low, high = found.interval
            assert found.estimate == pytest.approx(value, abs=max(1.5 * (high - low) / 2.0, 1e-6)), (effect, name)


@pytest.mark.parametrize("friction", [0.0, 0.1, 1.0])  # none, less and more than there is
def test_the_friction_that_is_assumed_does_not_matter(tmp_path: Path, friction: float) -> None:
    document = of_balls(tmp_path / "balls.csv", Racket(lambda v: 0.53, 0.212), friction, 0.0)
    assert set(document.named) == {"restitution", "support_friction"}
    low, high = document.effect("support_friction").parameters["friction"].interval
    assert low - 0.002 <= 0.212 - friction <= high + 0.002


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
    low, high = document.effect("yielding_contact").parameters["c"].interval
    assert low - 0.1 <= 0.6 <= high + 0.1
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
    assert {feature.signal for feature in source.signals} == {LINEAR}
    assert source.measured.shape == source.predicted.shape == (len(rows), 3)
    np.testing.assert_array_equal(source.noise, np.full((len(rows), 3), NOISE[0]))
    document = diagnose(source, NOMINAL, CONSIDERED)
    assert set(document.named) == {"restitution", "support_friction"}
    for name, parameter, truth in (("restitution", "restitution", 0.08), ("support_friction", "friction", -0.088)):
        low, high = document.effect(name).parameters[parameter].interval
        assert low <= truth <= high
