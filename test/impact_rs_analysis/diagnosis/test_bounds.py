# SPDX-License-Identifier: Apache-2.0
"""Ranges of parameters that a user gives: read, refused, and kept by the fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from impact_table_cases import CUBE_HEADER, cube, cube_rows, write_csv

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.search.bounds import read_bounds, with_bounds
from impact_rs_analysis.diagnosis.verdict import AT_BOUND
from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impacts.impact_table import read_impact_table

NOMINAL = load_model(Path("nominal"))
COULOMB = "joint_coulomb_friction.coulomb"


def test_ranges_come_from_the_command_line_and_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "ranges.yaml"
    path.write_text(f"{COULOMB}: [0, 20]\n", encoding="utf-8")
    found = read_bounds(["restitution.restitution=0:8e-1", str(path)], library())
    assert found == {"restitution.restitution": (0.0, 0.8), COULOMB: (0.0, 20.0)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("restitution.restitutio=0:1", "did you mean 'restitution.restitution'"),
        ("restitution=0:1", "known: actuation_delay.delay"),
        ("restitution.restitution=1:0", "the lower one first"),
        ("restitution.restitution=0:inf", "two finite numbers"),
        ("restitution.restitution=0", "expected EFFECT.PARAMETER=LOW:HIGH"),
        ("restitution.restitution=0.1:0.3", "must hold 0"),
        ("missing.yaml", "cannot be read"),
    ],
)
def test_mistakes_are_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=r"(?s).*") as caught:
        read_bounds([text], library())
    assert said in str(caught.value)


def test_a_file_with_other_content_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ranges.yaml"
    path.write_text(f"{COULOMB}: wide\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"ranges\.yaml: joint_coulomb_friction\.coulomb.*expected \[LOW, HIGH\]"):
        read_bounds([str(path)], library())


def test_bounds_of_an_unknown_parameter_are_refused_in_python_too(tmp_path: Path) -> None:
    """Kills a diagnosis that ignores them."""
    path = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(restitution=0.5), 12))
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    with pytest.raises(InputError, match=r"did you mean 'restitution\.restitution'"):
        diagnose(source, NOMINAL, ["restitution"], bounds={"restitution.restitutio": (0.0, 0.3)})


def test_a_given_range_is_not_widened_and_other_parameters_keep_theirs() -> None:
    effect = with_bounds(library()["joint_coulomb_friction"], {COULOMB: (0.0, 0.2)})
    (own,) = (parameter for parameter in effect.parameters if parameter.name == "coulomb")
    assert (own.lower, own.upper) == (0.0, 0.2)
    assert own.widened() is own
    other = library()["torque_gain"]
    assert with_bounds(other, {COULOMB: (0.0, 0.2)}) is other


def test_an_estimate_at_a_given_bound_is_said_in_the_summary(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "cubes.csv", CUBE_HEADER, cube_rows(cube(restitution=0.5), 40))
    source = ImpactTableSource(read_impact_table(path), NOMINAL)
    document = diagnose(source, NOMINAL, ["restitution"], bounds={"restitution.restitution": (0.0, 0.3)})
    found = document.effect("restitution")
    assert found is not None
    estimate = found.parameters["restitution"]
    assert (found.verdict, estimate.range, estimate.at_bound) == (AT_BOUND, (0.0, 0.3), True)
    assert estimate.estimate == pytest.approx(0.3)
    assert "restitution is AT-BOUND (restitution = 0.3): another effect may be missing." in document.summary
    speed = np.sqrt(np.mean([row.impact.closing_speed(row.physics, {}) ** 2 for row in source.table.rows]))
    limits = {limit.signal: limit.limit for limit in document.limits}
    assert limits["velocity after"] == pytest.approx(0.005 * speed)
    gyration = 0.1 / np.sqrt(6.0)  # of the cube
    assert limits["angular velocity after"] == pytest.approx(0.005 * speed / gyration)
    assert document.proportion.time == pytest.approx(1.0 / speed)
