# SPDX-License-Identifier: Apache-2.0
"""Comparison of a model with measurements: where it fails, and one score per model.

Trials are compared on three levels:

* **jump**: the impact map with the model's physics against the measured velocity jump,
* **free motion**: torque balances and deflections in windows without contact,
* **trial**: the replay from before the impact through the push;

recordings on one level, the torque balance of free motion; tables of impacts on one level, the velocities just after
the impact. Every difference is given in its unit and in multiples of repeatability, so that torques and velocities can
be ranked together. The score of trials is minimised by the diagnosis: the size of the mean residuals over repeatability
(:func:`impact_rs_analysis.evidence.cluster.size_of`) [-]. The score of recordings is the root mean square of the torque
residual [N m]; the score of impacts without repeats is the root mean square of the velocity residual
(:mod:`impact_rs_analysis.evidence.sources.table_source`) [m/s].
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from impact_rs_analysis.diagnosis.agreement import AgreementDocument, agreement_of
from impact_rs_analysis.diagnosis.document import CalibrationIdentity, ModelIdentity
from impact_rs_analysis.diagnosis.jump import jump_level
from impact_rs_analysis.evidence.calibration import NO_CALIBRATION, LaboratoryCalibration
from impact_rs_analysis.evidence.cluster import ErrorUnit
from impact_rs_analysis.evidence.discrepancy import DiscrepancyDocument
from impact_rs_analysis.evidence.levels import Cell, ConditionScore, Level, RecordingDocument, SignalLevel, rounded
from impact_rs_analysis.evidence.rollouts import RolloutDocument
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.visited import extrapolations
from impact_rs_analysis.measure.arms import ArmDocument, arms_of, assumptions
from impact_rs_sim.model import Model
from impact_rs_sim.schema import Schema, omitted


class LeftOut(Schema):
    """A bag that was left out."""

    name: str = Field(description="path below the folder")
    reason: str = Field(description="why")


class ComparisonDocument(Schema):
    """``compare --json``."""

    source: Literal["trials", "recordings", "impacts"] = Field(description="what was compared")
    model: ModelIdentity = Field(description="compared model")
    calibration: CalibrationIdentity | None = omitted(None, description="known faults of the readings")
    trials: int = Field(description="trials, or recordings")
    runs_digest: str = omitted("", description="digest of the measurements; empty for recordings")
    conditions: tuple[ConditionScore, ...] = Field(description="by condition or recording")
    score: float = Field(description="score of the model")
    score_is: str = Field(description="definition of the score")
    score_unit: ErrorUnit = Field(description="its unit")
    noise_floor: float | None = Field(description="score of noise alone; null: no repeats")
    levels: dict[str, Level] = Field(description="jump, free_motion and trial; recording; or impacts")
    where: tuple[Cell, ...] = Field(description="residuals by signal, largest first")
    arms: tuple[ArmDocument, ...] = Field((), description="arms of the measurements; empty: a free body")
    joints: tuple[SignalLevel, ...] = Field((), description="signals of trials by arm and joint")
    not_measured: tuple[str, ...] = Field((), description="quantities that were not measured")
    skipped: tuple[LeftOut, ...] = Field((), description="bags that were left out")
    recording: RecordingDocument | None = Field(None, description="how recordings were read")
    discrepancy: DiscrepancyDocument = Field(
        default_factory=DiscrepancyDocument, description="model discrepancy of the simulation"
    )
    remarks: tuple[str, ...] = Field((), description="remarks for the reader")
    rollouts: RolloutDocument | None = omitted(
        None, description="open-loop predictions of the motion; null: no torque or too little free motion was measured"
    )
    agreement: AgreementDocument = omitted(AgreementDocument(), description="which readings agree with each other")


def compare(
    source: Source, model: Model | None = None, calibration: LaboratoryCalibration = NO_CALIBRATION
) -> ComparisonDocument:
    """Compare a model with measurements.

    Args:
        source: Measurements with the model's predictions.
        model: The model of the file; None: the model of the source, without calibration.
        calibration: Faults of the readings; the model of the source contains them.
    """
    model = source.declared_model if model is None else model
    comparison, runs, noise = source.compare_levels(), source.runs, source.noise_size()
    jump, remarks = ({}, []) if runs is None else jump_level(runs, source.model, source.discrepancy)
    skipped = source.left_out
    if runs is not None:
        skipped = tuple((path.removeprefix(f"{runs.directory}/"), why) for path, why in runs.skipped)
    arms, rollouts, identity = arms_of(source.worlds), source.rollouts(), source.identity
    return ComparisonDocument(
        source=source.kind,
        model=ModelIdentity.of(model),
        calibration=CalibrationIdentity.of(calibration),
        trials=identity.count,
        runs_digest=identity.digest,
        conditions=comparison.conditions,
        score=rounded(source.size()),
        score_is=source.size_is,
        score_unit=source.size_unit,
        noise_floor=None if noise is None else rounded(noise),
        levels=jump | comparison.levels,
        where=comparison.where,
        arms=arms,
        joints=comparison.joints,
        not_measured=source.not_measured,
        skipped=tuple(LeftOut(name=name, reason=why) for name, why in skipped),
        recording=source.recording,
        discrepancy=source.discrepancy_document,
        remarks=(*source.comparison_remarks, *remarks, *extrapolations(source), *assumptions(arms)),
        rollouts=None if rollouts is None else rollouts.document(),
        agreement=agreement_of(source),
    )
