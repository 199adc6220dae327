# SPDX-License-Identifier: Apache-2.0
"""Preregistered predictions of a round's trials, and their comparison with the measurements.

The impact map (:func:`predict_impact`) predicts two velocities along the axis just after an impact [m/s]: end effector
and object. The measured values are means from 20 to 40 ms after the impact (end effector) and from 6 to 40 ms after it
(object). The prediction error is the size of the difference between measurement and replay
(:mod:`impact_rs_analysis.evidence.cluster`) in these trials alone, which the model has not seen. Its p-value is the
probability of an error at least as large under a right model (:mod:`.error_test`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy
from pydantic import Field

from impact_rs_analysis.diagnosis.document import ModelIdentity
from impact_rs_analysis.evidence.cluster import ErrorUnit, size_of
from impact_rs_analysis.evidence.levels import rounded
from impact_rs_analysis.evidence.replays.features import JUMP_WINDOWS_S, SETTLED_WINDOW
from impact_rs_analysis.evidence.replays.measured_runs import MeasuredRun
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.investigation.error_test import p_of_error
from impact_rs_sim.impact_map import predict_impact
from impact_rs_sim.impact_map.problem import ImpactProblem
from impact_rs_sim.model import Model
from impact_rs_sim.rotations import AXES
from impact_rs_sim.schema import Schema
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec

VELOCITY_SAMPLES = 21  # for the velocity of the end effector, 1 ms apart


class ImpactPrediction(Schema):
    """Prediction of a model for a condition before its measurement."""

    condition: str = Field(description="scenario, object and case")
    arm: float = Field(description="velocity of the end effector just after the impact along the axis [m/s]")
    object: float = Field(description="velocity of the object just after the impact along the axis [m/s]")


class Predictions(Schema):
    """``prediction.json``."""

    model: ModelIdentity = Field(description="model that predicts")
    impacts: tuple[ImpactPrediction, ...] = Field((), description="by condition with an impact")


class CheckedImpact(Schema):
    """A prediction and the mean of the trials that were measured after it."""

    condition: str = Field(description="scenario, object and case")
    trials: int = Field(description="trials of it in the round")
    predicted: ImpactPrediction = Field(description="the prediction")
    arm: float = Field(description="measured velocity of the end effector after the impact along the axis [m/s]")
    object: float | None = Field(
        description="measured velocity of the object after the impact along the axis [m/s]; null: not tracked"
    )


class PredictionError(Schema):
    """``prediction_error.json``."""

    model: ModelIdentity = Field(description="model that predicted")
    trials: int = Field(description="usable trials of the round")
    error: float | None = Field(description="error of the model in these trials, in the unit; null: none is usable")
    unit: ErrorUnit = Field(description="unit of the error")
    p_value: float | None = Field(None, description="p-value of the error if the model is right; null: not known")
    p_value_of_all: float | None = Field(None, description="p-value in all trials so far; null: not known")
    p_value_of_first: float | None = Field(
        None, description="p-value of the first model in all trials so far; null: not known"
    )
    impacts: tuple[CheckedImpact, ...] = Field((), description="by condition with an impact")


def predicted(model: Model, spec: TrialSpec) -> ImpactPrediction:
    """The velocities just after the impact that a model predicts, by the impact map."""
    scene, axis = spec.scene, spec.scenario.axis_index
    scene = replace(scene, physics=model.apply(scene.physics))
    result = predict_impact(ImpactProblem.at_nominal_impact(scene), spec.scenario.control.reference_contact)
    arms = [float(twist[axis]) for twist in result.end_effector_twist.values()]
    return ImpactPrediction(
        condition=label_of(spec), arm=sum(arms) / len(arms), object=float(result.object_twist[axis])
    )  # fmt: skip


def prediction_error(
    source: Source, folder: Path, predictions: Predictions, first: Source | None = None
) -> PredictionError:
    """Predictions against the trials that were measured after them.

    Args:
        source: All trials so far against the model that predicted.
        folder: Folder of the trials of the round.
        predictions: The predictions.
        first: All trials so far against the first model; None: the first model predicted.
    """
    assert source.runs is not None
    squares, expected_squares, impacts, tested_rows = [], [], [], list[list[int]]()
    predicted_impacts = {impact.condition: impact for impact in predictions.impacts}
    conditions, folder = source.runs.conditions, folder.resolve()
    for cluster in source.clusters:
        paths = [Path(run.path).resolve() for run in conditions[cluster.name]]
        rows = [row for row, path in enumerate(paths) if path.is_relative_to(folder)]
        tested_rows.append(rows)
        if not rows:
            continue
        squares.append(float(np.mean(np.square(cluster.residuals[rows].mean(axis=0)))))
        expected_squares.append(
            float(np.mean(np.square(cluster.pure_error) / len(rows) + np.square(cluster.discrepancy)))
        )
        runs_of_round = [conditions[cluster.name][row] for row in rows]
        if (prediction := predicted_impacts.get(cluster.name)) is not None and cluster.contact:
            impacts.append(_measured(prediction, runs_of_round))
    return PredictionError(
        model=predictions.model,
        trials=sum(map(len, tested_rows)),
        error=rounded(size_of(squares, expected_squares)) if squares else None,
        unit=source.size_unit,
        p_value=p_of_error(source.clusters, tested_rows),
        p_value_of_all=_p_of_all(source),
        p_value_of_first=_p_of_all(first or source),
        impacts=tuple(impacts),
    )


def _p_of_all(source: Source) -> float | None:
    """p-value of the error in all trials of a source."""
    return p_of_error(source.clusters, [range(item.count) for item in source.clusters])


def _measured(prediction: ImpactPrediction, runs: Sequence[MeasuredRun]) -> CheckedImpact:
    """A prediction and the mean over trials of its condition."""
    objects = [value for run in runs if (value := _object_velocity(run)) is not None]
    return CheckedImpact(
        condition=prediction.condition,
        trials=len(runs),
        predicted=prediction,
        arm=float(np.mean([_arm_velocity(run) for run in runs])),
        object=float(np.mean(objects)) if objects else None,
    )


def _arm_velocity(run: MeasuredRun) -> float:
    """Velocity of the end effector after the impact along the axis, mean over the arms [m/s]."""
    velocities = []
    for name, impact_time in run.impacts.items():
        arm, model = run.signals.arms[name], run.setup.physics.robot_model(name)
        sample_times = impact_time + np.linspace(*JUMP_WINDOWS_S[SETTLED_WINDOW], VELOCITY_SAMPLES)
        samples = scipy.interpolate.make_interp_spline(run.signals.time, np.hstack([arm.position, arm.velocity]), 1)(
            sample_times
        )
        velocities += [(model.jacobian(q) @ dq)[run.axis] for q, dq in (np.split(sample, 2) for sample in samples)]
    return float(np.mean(velocities))


def _object_velocity(run: MeasuredRun) -> float | None:
    """Velocity of the object after the impact along the axis [m/s]; None: it was not tracked."""
    group = ("impact", "object velocity", AXES[run.axis])
    for feature, value in zip(run.features, run.measured, strict=True):
        if feature.group == group and feature.bin == 0:
            return float(value)
    return None
