# SPDX-License-Identifier: Apache-2.0
"""The figures show the numbers of the result table."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np

from impact_rs_analysis.measure.analyze import ExperimentSet, Prediction
from impact_rs_analysis.measure.linear_fit import fit_zero_crossing
from impact_rs_analysis.measure.net_feedback import TrialFeedback
from impact_rs_analysis.report.figures import fit_figure


def test_speeds_of_a_prediction_against_the_motion_are_negative() -> None:
    """Kills: magnitudes of the ends of an interval that straddles zero, and of a prediction against the estimate."""
    velocity = -0.05 * np.array([0.5, 1.0, 1.5])
    nets = velocity + 0.05 + np.array([1e-3, -2e-3, 1e-3])
    trials = [
        SimpleNamespace(info=SimpleNamespace(reference_post_velocity=x), net=y)
        for x, y in zip(velocity, nets, strict=True)
    ]
    predictions = dict.fromkeys(("reduced", "rotor", "zero"), Prediction(0.01, -120.0))
    entry = ExperimentSet(
        "push", "parcel", "case_1", "y", "parcel", cast(tuple[TrialFeedback, ...], trials),
        fit_zero_crossing(velocity, nets), predictions, predictions, prediction_interval=(-0.02, 0.04),
    )  # fmt: skip
    labels = [curve.label for curve in fit_figure(entry).panels[0].curves]
    assert "B<sub>θ</sub>, 95 %: −0.040 to 0.020 m/s" in labels
    assert "Prediction, B<sub>ρ</sub>: −0.010 m/s (−120.00 %)" in labels
