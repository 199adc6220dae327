# SPDX-License-Identifier: Apache-2.0
"""The published experiment as a measurement."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.measure.paper import paper_results, study_paper
from impact_rs_cli.main import main


def test_interpolation_meets_the_published_predictions() -> None:
    for result in paper_results():
        for curve in ("parabola", "hyperbola"):
            ends = result.mismatch(np.array([0.0, 1.0, 3.0]), curve)
            assert ends == pytest.approx([result.row.zero, result.row.reduced, result.row.rotor], abs=1e-9)


def test_one_motor_inertia_scale_is_not_decisive() -> None:
    study = study_paper()
    fit = study.all_rows
    assert fit.scale == pytest.approx(0.51, abs=0.02)
    assert fit.interval == pytest.approx((0.36, 0.95), abs=0.02)
    assert (fit.error_nominal, fit.error_fitted) == pytest.approx((3.54, 3.05), abs=0.01)
    assert fit.error_fitted < fit.error_held_out < fit.error_nominal
    assert study.by_scenario["push"].scale == pytest.approx(0.36, abs=0.02)
    assert study.by_scenario["grab"].scale == pytest.approx(0.84, abs=0.02)
    assert (len(study.results), len(study.unexplained)) == (18, 8)
    assert study.verdict == "NOT-DECISIVE"


def test_paper_command_writes_figure_and_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "--json", "-o", str(tmp_path / "report")]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "NOT-DECISIVE"
    assert {path.suffix for path in (tmp_path / "report").iterdir()} == {".html", ".json", ".png"}
