# SPDX-License-Identifier: Apache-2.0
"""Laws of a contact that a table of impacts shows and the library lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy
from ball_impacts import Racket, ball_table

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.laws.discover import discover
from impact_rs_analysis.diagnosis.laws.discovery_document import FOUND, LIBRARY, DiscoveryDocument
from impact_rs_analysis.diagnosis.laws.grammar import load_grammar
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_analysis.evidence.visited import measured_ranges
from impact_rs_sim.effects.formula import Formula
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import ImpactTable, read_impact_table

NOMINAL = load_model(Path("nominal"))
CONSIDERED = ["restitution", "restitution_fall", "support_friction", "tangential_restitution"]
NOISE = (0.05, 5.0)  # m/s, rad/s


def discovered(table: ImpactTable) -> DiscoveryDocument:
    return discover(lambda one: ImpactTableSource(table, one), NOMINAL, load_grammar(), CONSIDERED)


def hunt_crossley(speed: float, damping: float = 0.5) -> float:
    """Restitution of a Hunt-Crossley contact: h v (1 + e) = log((1 + h v) / (1 - h e v)), h in s/m."""
    w = damping * speed

    def rest(e: float) -> float:
        return float(w * (1.0 + e) - np.log((1.0 + w) / (1.0 - w * e)))

    return float(scipy.optimize.brentq(rest, 1e-9, min(1.0, (1.0 - 1e-12) / w)))


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> ImpactTable:
    """Balls whose restitution falls as a curve."""
    path = ball_table(tmp_path_factory.mktemp("bent") / "balls.csv", Racket(hunt_crossley, 0.2), rows=90, noise=NOISE)
    return read_impact_table(path)


@pytest.fixture(scope="module")
def bent(table: ImpactTable) -> DiscoveryDocument:
    return discovered(table)


def restitution_of(document: DiscoveryDocument, speed: np.ndarray) -> np.ndarray:
    """Restitution of all that was found together, ``(k,)``."""
    found = document.diagnosis.effect("restitution")
    constant = found.parameters["restitution"].estimate if "restitution" in document.diagnosis.named else 0.0
    total = np.full(speed.size, constant)
    for law in document.laws:
        if law.name in document.diagnosis.named and law.name.startswith("restitution_closing"):
            numbers = {name: value.estimate for name, value in law.parameters.items()}
            total += Formula(law.formula, {"v", *numbers})({"v": speed, **numbers})
    return total


@pytest.mark.slow
def test_a_restitution_that_falls_as_a_curve_is_described_by_a_law_that_bends(bent: DiscoveryDocument) -> None:
    document = bent
    assert document.verdict == FOUND
    best = document.laws[0]
    assert best.place == "coefficient of the contact: restitution" and best.valid.quantity == "v"
    speed = np.linspace(2.0, 8.0, 13)
    assert restitution_of(document, speed) == pytest.approx([hunt_crossley(v) for v in speed], abs=0.02)
    diagnosis = document.diagnosis
    assert diagnosis.held_out_error_after < 1.15 * diagnosis.noise_floor < 0.2 * diagnosis.held_out_error_before


@pytest.mark.slow
def test_a_model_with_the_law_lacks_nothing_more(tmp_path: Path, table: ImpactTable, bent: DiscoveryDocument) -> None:
    document = bent
    arguments = (NOMINAL, Path("nominal"), document.diagnosis, tmp_path / "discovery.json", document.diagnosis.named)
    child = add_effects(*arguments, tmp_path / "model_2.yaml", False)
    again = diagnose(ImpactTableSource(table, child), child, ["tangential_restitution", "restitution_fall"])
    assert str(again.verdict) == "NOTHING-MISSING"


def test_no_law_is_proposed_where_the_library_explains_a_table(tmp_path: Path) -> None:
    racket = Racket(lambda v: 0.7 - 0.03 * v, 0.2)
    document = discovered(read_impact_table(ball_table(tmp_path / "balls.csv", racket, rows=90, noise=NOISE)))
    assert (document.verdict, document.laws) == (LIBRARY, ())


@pytest.mark.slow
def test_no_law_is_proposed_where_the_noise_is_not_known_and_the_hold_out_supports_none(tmp_path: Path) -> None:
    racket = Racket(lambda v: 0.55, 0.2)
    path = ball_table(tmp_path / "balls.csv", racket, rows=90, noise=NOISE, stated=False)
    document = discovered(read_impact_table(path))
    assert document.verdict == LIBRARY and document.looked_at > len(CONSIDERED)
    assert set(document.diagnosis.named) == {"restitution", "support_friction"}


@pytest.mark.slow
def test_a_restitution_below_a_speed_of_which_nothing_comes_back_is_found_as_a_step(tmp_path: Path) -> None:
    racket = Racket(lambda v: 0.5 if v > 4.0 else 0.0, 0.2)
    document = discovered(read_impact_table(ball_table(tmp_path / "balls.csv", racket, rows=90, noise=NOISE)))
    best = document.laws[0]
    assert (document.verdict, best.name) == (FOUND, "restitution_closing_speed_step")
    low, high = best.parameters["start"].ci95
    assert 3.5 < low < 4.0 < high < 4.5
    assert best.parameters["c"].estimate == pytest.approx(0.5, abs=0.02)


def test_laws_of_a_contact_depend_on_the_speeds_at_the_contact(table: ImpactTable) -> None:
    """The slip of a ball is that of its lowest point, v + omega x (-r n)."""
    source = ImpactTableSource(table, NOMINAL)
    twists = np.array([row.impact.object.twist for row in table.rows])
    slip = np.hypot(twists[:, 0] - 0.02 * twists[:, 4], twists[:, 1] + 0.02 * twists[:, 3])
    assert source.contact_speeds["v"] == pytest.approx(-twists[:, 2])
    assert source.contact_speeds["slip"] == pytest.approx(slip)
    ranges = measured_ranges(source, ["slip / v"])
    assert ranges["v"] == pytest.approx(np.percentile(-twists[:, 2], (0.5, 99.5)))
    assert ranges["slip / v"] == pytest.approx(np.percentile(-slip / twists[:, 2], (0.5, 99.5)))
