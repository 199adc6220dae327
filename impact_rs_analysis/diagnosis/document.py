# SPDX-License-Identifier: Apache-2.0
"""The diagnosis as a file (``diagnosis.json``): one typed document for every kind of measurement.

Written by ``impact-rs diagnose``, read by ``add``, ``blind score``, ``history`` and the report. Files of version 0.1.0,
of trials and of recordings, are still read.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field

from impact_rs_analysis.diagnosis.thresholds import MAX_TIE_LOG_RATIO, MIN_REPORTED_P, UNADJUSTED_LEVEL
from impact_rs_analysis.diagnosis.verdict import SMALL, UNIDENTIFIABLE, DiagnosisVerdict
from impact_rs_analysis.evidence.calibration import LaboratoryCalibration
from impact_rs_analysis.evidence.cluster import TIMES, ErrorUnit
from impact_rs_analysis.evidence.discrepancy import DiscrepancyDocument
from impact_rs_analysis.evidence.levels import RecordingDocument
from impact_rs_analysis.evidence.rollouts import RolloutDocument, shown
from impact_rs_sim.effects.base import Parameter
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model
from impact_rs_sim.schema import Schema, omitted, read_json, validate

MAX_JSON_BYTES = 50_000_000  # a diagnosis usually has about 10 kB


class EstimateDocument(Schema):
    """One estimated number."""

    estimate: float = Field(description="estimate, in its unit")
    ci95: tuple[float, float] | None = Field(description="95 % interval, in its unit; null: no interval is known")
    unit: str = Field(description="unit, '-' where it has none")
    meaning: str = Field("", description="meaning of the parameter")
    joint: str | None = Field(None, description="joint of the parameter; null: the effect as a whole")
    arm: str | None = Field(None, description="arm of the parameter; null: arms share it")
    verdict: DiagnosisVerdict | None = Field(None, description="verdict on this joint; null: no verdict")
    p_value: float | None = Field(None, description="p-value of this joint's parameter being nominal, given all others")
    error_before: float | None = Field(None, description="held-out error of the joint without it, in the joint's unit")
    error_after: float | None = Field(None, description="held-out error of the joint with it, in the joint's unit")
    nominal: float | None = Field(None, description="value at which the effect does nothing, in its unit")
    scale: float | None = Field(None, description="a noticeable change, in its unit; null: a shape, which has none")
    range: tuple[float, float] | None = Field(None, description="range of the search, in its unit")
    at_bound: bool = Field(
        False, description="whether the data put the estimate at an end of the range, away from nominal"
    )

    @classmethod
    def of(cls, parameter: Parameter, estimate: float, ci95: tuple[float, float] | None, **further: Any) -> Self:
        """An estimate of a parameter, with unit, meaning, joint, arm, nominal value, scale and range.

        Args:
            parameter: The parameter.
            estimate: Its estimate, in its unit.
            ci95: Its 95 % interval, in its unit.
            further: Other fields of the document.
        """
        facts = {
            "unit": parameter.unit,
            "meaning": parameter.meaning,
            "joint": None if parameter.joint is None else f"joint{parameter.joint + 1}",
            "arm": parameter.arm or None,
            "nominal": parameter.nominal,
            "scale": None if parameter.shape else parameter.scale,
            "range": (parameter.lower, parameter.upper),
        }
        return cls(estimate=estimate, ci95=ci95, **(facts | further))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, in its unit; unbounded if it is unknown."""
        return (-math.inf, math.inf) if self.ci95 is None else self.ci95

    @property
    def excludes_nominal(self) -> bool:
        """Whether the interval excludes the value at which the effect does nothing."""
        low, high = self.interval
        return self.nominal is not None and not low <= self.nominal <= high

    @property
    def reach(self) -> float:
        """Largest distance of the interval from the value at which the effect does nothing [noticeable changes]."""
        if self.ci95 is None or self.nominal is None or not self.scale:
            return 0.0
        return max(abs(end - self.nominal) for end in self.ci95) / self.scale


def explained(before: float, after: float, noise: float) -> float:
    """Share of the squared error beyond noise that the effects explain [-]; negative if the error grows.

    It is 1 if the error of the model is not beyond noise: nothing is left to explain.

    Args:
        before: Held-out error without the effects.
        after: Held-out error with the effects.
        noise: Held-out error of noise alone; 0: unknown.
    """
    return (before**2 - after**2) / (before**2 - noise**2) if before > noise else 1.0


def tied_with_best(error: float, best: float) -> bool:
    """Whether a held-out error is tied with the lowest one: a log ratio of squares up to ``MAX_TIE_LOG_RATIO``."""
    return error <= best * math.exp(MAX_TIE_LOG_RATIO / 2.0)


class SizeDocument(Schema):
    """Largest change of one signal that an effect causes."""

    phase: str = Field(description="phase of the motion")
    signal: str = Field(description="name of the signal")
    value: float = Field(description="largest change of the signal, in the unit")
    unit: str = Field(description="unit")
    floor: float = Field(description="relevance limit: smallest difference that matters, in the unit")


class EffectDocument(Schema):
    """Verdict on one effect, with its evidence."""

    name: str = Field(description="effect")
    sentence: str = Field("", description="the effect in one sentence")
    of_measurement: bool = omitted(False, description="whether it is a fault of a reading, not physics")
    reading: str = omitted("", description="clause on the fault of the reading, with placeholders for its size")
    calibration: str = omitted("", description="experiment that determines the fault of the reading")
    verdict: DiagnosisVerdict = Field(
        description="CONFIRMED, CONFUSABLE-WITH{...}, PRESENT-BUT-SMALL, NOT-IDENTIFIABLE, NO-IMPROVEMENT, AT-BOUND or "
        "TOO-FEW-REPEATS"
    )
    reason: str = Field("", description="reason of the verdict, in words")
    rivals: tuple[str, ...] = Field((), description="effects that these measurements cannot distinguish from it")
    measured: bool = Field(True, description="whether some measured signal depends on it")
    parameters: dict[str, EstimateDocument] = Field(description="estimates by name")
    held_out_error_before: float | None = Field(description="error on unseen clusters without it; null: not measured")
    held_out_error_after: float | None = Field(description="error on unseen clusters with it; null: not measured")
    held_out_error_alone: float | None = Field(
        None, description="error on unseen clusters with this effect only; null: not measured"
    )
    held_out_error_others: float | None = Field(
        None,
        description="error on unseen clusters with the other effects of held_out_error_after, without this one: the "
        "difference is the contribution of this effect; null: not measured",
    )
    p_value: float | None = Field(description="p-value, adjusted for testing all effects; null: not measured")
    p_value_alone: float | None = Field(None, description="p-value if this were the only test; null: not measured")
    sizes: tuple[SizeDocument, ...] = Field((), description="changes of signals by the effect, largest first")
    chosen_in_folds: int | None = Field(None, description="folds of the hold-out whose search also selected it")

    @property
    def held_out_error_without(self) -> float | None:
        """Error on unseen clusters with the other effects of ``held_out_error_after``; null: not measured.

        In documents of earlier versions, which lack it, the error without any effect.
        """
        others = self.held_out_error_others
        return self.held_out_error_before if others is None else others

    @property
    def lowers(self) -> bool:
        """Whether the error on unseen clusters is lower with it."""
        return (self.held_out_error_after or 0.0) < (self.held_out_error_before or 0.0)


class CovariateDocument(Schema):
    """A circumstance of the measurements, on which effects may depend."""

    name: str = Field(description="column")
    unit: str = Field("", description="unit of numbers")
    levels: tuple[str, ...] = Field((), description="levels with values of their own; empty: a number")
    mean: float | None = Field(None, description="mean of numbers, in the unit")
    range: tuple[float, float] | None = Field(None, description="smallest and largest number, in the unit")
    tried: bool = Field(description="whether it varies enough to be tried")
    ways: tuple[str, ...] = omitted((), description="how effects were allowed to depend on it, in words")
    why_not: str = omitted(
        "", description="why it could not be tried, in words; empty: it was tried, or varies too little"
    )
    goes_with: dict[str, float] = Field(
        {},
        description="confounded covariates, or the impact speed, with the correlation [-]",
    )


class DependenceDocument(Schema):
    """Whether an effect that was found depends on a covariate."""

    effect: str = Field(description="effect")
    covariate: str = Field(description="covariate")
    verdict: DiagnosisVerdict = Field(
        description="CONFIRMED, CONFUSABLE-WITH{...}, PRESENT-BUT-SMALL, or NO-IMPROVEMENT: it does not depend on it"
    )
    reason: str = Field("", description="reason of the verdict, in words")
    p_value: float | None = Field(
        description="p-value of the effect not depending on it, adjusted for all pairs; null: not tried"
    )
    rivals: tuple[str, ...] = Field((), description="dependences that these measurements cannot distinguish from it")
    levels: dict[str, dict[str, EstimateDocument]] = Field({}, description="estimates by level and parameter")
    curve: dict[str, dict[str, EstimateDocument]] = omitted(
        {}, description="estimates along a curve, by value of a number and parameter; linear between them"
    )
    at_mean: dict[str, EstimateDocument] = Field({}, description="estimates at the mean of a number, by parameter")
    per_unit: dict[str, EstimateDocument] = Field({}, description="their changes per unit of the number, by parameter")
    chosen_in_folds: int | None = Field(None, description="folds of the hold-out that also select it")
    folds: int = Field(0, description="folds of the hold-out")
    held_out_error_before: float | None = Field(
        None, description="error on unseen clusters with the effects alone; null: not held out"
    )
    held_out_error_after: float | None = Field(
        None, description="error on unseen clusters with all accepted dependences; null: not held out"
    )

    @property
    def accepted(self) -> bool:
        """Whether these measurements show that the effect depends on the covariate."""
        return bool(self.levels or self.curve or self.at_mean)

    @property
    def suspected(self) -> bool:
        """Whether the effect may depend on the covariate, although this predicts unseen data no better."""
        return not self.accepted and not self.rivals and self.p_value is not None and bool(self.reason)


class ModelIdentity(Schema):
    """Which model was diagnosed."""

    name: str = Field(description="name of the model")
    digest: str = Field(description="digest of its physics")

    @classmethod
    def of(cls, model: Model) -> Self:
        """Identity of a model."""
        return cls(name=model.name, digest=model.digest)


class CalibrationIdentity(Schema):
    """Which calibration the readings were predicted with."""

    file: str = Field(description="its file")
    digest: str = Field(description="digest of its effects")
    effects: tuple[str, ...] = Field(description="faults of the readings")

    @classmethod
    def of(cls, calibration: LaboratoryCalibration) -> Self | None:
        """Identity of a calibration; None: it has no effect."""
        faults = calibration.faults
        names = tuple(item.name for item in faults.effects)
        return cls(file=str(calibration.file), digest=faults.digest, effects=names) if names else None


class RunsIdentity(Schema):
    """Which measurements were read."""

    digest: str = Field(description="digest of the bags' names, scenarios and seeds; empty for recordings")
    trials: int = Field(description="usable trials, or recordings")
    conditions: tuple[str, ...] = Field(description="conditions that were measured, or files")
    recorded: float | None = omitted(None, description="time of the last recording, seconds since 1970; null: unknown")


class ResidualDocument(Schema):
    """One remaining residual."""

    phase: str = Field(description="phase of the motion")
    signal: str = Field(description="name of the signal")
    index: str = Field(description="joint or axis")
    value: float = Field(0.0, description="root mean square beyond noise, in the unit")
    unit: str = Field("", description="unit")
    floor: float = Field(0.0, description="relevance limit: smallest difference that matters, in the unit")
    share: float = Field(description="share of the remaining sum of squares")
    times_noise: float = Field(description="root mean square in multiples of repeatability")

    @property
    def matters(self) -> bool:
        """Whether it is above its relevance limit."""
        return self.value >= self.floor


class UnexplainedDocument(Schema):
    """Residuals after the diagnosis."""

    share_of_excess: float | None = Field(
        None, description="share of the squared held-out error beyond noise that remains"
    )
    where: tuple[ResidualDocument, ...] = Field((), description="largest remaining residuals")


class NextExperiment(Schema):
    """Experiment that distinguishes effects which these data cannot."""

    advice: str = Field(description="instruction, in words")
    splits: tuple[str, ...] = Field((), description="effects that it distinguishes")
    scenario: str | None = Field(None, description="scenario to run")
    object: str | None = Field(None, description="its object")
    case: str | None = Field(None, description="its case")
    expected_information: float | None = Field(
        None, description="squared distance of the two predictions in units of the noise, for one more trial [-]"
    )
    already_measured: bool | None = Field(None, description="whether it was measured before")


class CalibrationExperiment(Schema):
    """Experiment that determines a fault of the readings."""

    effect: str = Field(description="effect of the measurement")
    experiment: str = Field(description="instruction, in words")


class CorrelatedPair(Schema):
    """Two correlated estimates."""

    first: str = Field(description="parameter")
    second: str = Field(description="parameter")
    correlation: float = Field(description="correlation of their estimates [-]")


class Identifiability(Schema):
    """How well the chosen parameters are determined."""

    singular_values: tuple[float, ...] = Field((), description="of the sensitivities, in parameter scales [-]")
    condition_number: float | None = Field(None, description="largest over smallest singular value [-]")
    correlated: tuple[CorrelatedPair, ...] = Field((), description="pairs with a correlation above 0.8")


class LackOfFit(Schema):
    """p-values of the residuals being noise."""

    before: float | None = Field(None, description="of the model; null: nothing was repeated")
    after: float | None = Field(None, description="with the chosen effects; null: nothing was repeated")


class HoldOutDocument(Schema):
    """How data were held out."""

    what: str = Field("", description="what was held out, in words")
    folds: int = Field(0, description="number of folds, each predicted from the other data")
    searched: int | None = Field(None, description="folds with a search of their own; null: all")


class DesignDocument(Schema):
    """Amount of data, and data that a verdict lacks."""

    clusters: int = Field(0, description="conditions, or stretches of recordings")
    freedom: int = Field(0, description="degrees of freedom of the noise")
    least_p: float = Field(MIN_REPORTED_P, description="smallest p-value that is reported")
    shortage: str | None = Field(None, description="missing data for a verdict; null: enough")


class BudgetDocument(Schema):
    """Processor time that a diagnosis may take."""

    limit: float | None = Field(None, description="processor time [s]; null: no limit")
    left_out: tuple[str, ...] = Field((), description="steps that were not tried because the time was spent")
    stopped: bool = Field(False, description="whether a user has stopped the search before its end (Ctrl-C)")


class DriftDocument(Schema):
    """The signal that changes most with the order of measurement, among repeats of the same condition."""

    phase: str = Field(description="phase of the motion")
    signal: str = Field(description="name of the signal")
    index: str = Field(description="joint or axis")
    change: float = Field(description="change of its residual from first to last run, rms over its bins, in the unit")
    unit: str = Field(description="unit")
    runs: int = Field(description="runs of the campaign")
    p_value: float = Field(description="p-value of no signal drifting, for all signals together")
    confounded: bool = Field(description="whether conditions were measured one after the other")


class ProportionDocument(Schema):
    """Size of the robot over the Franka arm, for which ranges and relevance limits are stated."""

    mass: float = Field(1.0, description="mass of its links, or of links that its recorded torques would drive [-]")
    length: float = Field(1.0, description="length of its reach [-]")
    time: float = Field(1.0, description="time of a free fall over its reach [-]")


class LimitDocument(Schema):
    """Relevance limit of one signal."""

    phase: str = Field(description="phase of the motion")
    signal: str = Field(description="name of the signal")
    limit: float = Field(description="smallest difference that matters, in the unit")
    unit: str = Field(description="unit")


class JointError(Schema):
    """Held-out error of one joint."""

    joint: str = Field(description="joint")
    before: float = Field(description="of the model [unit]")
    after: float = Field(description="with the chosen effects [unit]")
    noise: float = Field(description="noise of the recorded torque [unit]")
    unit: str = Field("N m", description="unit of all of them; N of a joint that slides")


class ViewDocument(Schema):
    """Verdict on a part of the measurements, or under another assumption (sensitivity analysis)."""

    name: str = Field(description="part of the measurements (joints or object of an arm), or other assumption")
    option: str = Field("", description="option with the other value; empty: a part of the signals")
    verdict: DiagnosisVerdict = Field(description="verdict, as in a diagnosis")
    named: tuple[str, ...] = Field(description="effects that it names")
    held_out_error_before: float = Field(description="held-out error of the model, in error_unit")
    held_out_error_after: float = Field(description="held-out error with the effects named, in error_unit")
    of: str = Field("", description="uncertain quantity with another value; empty: none, or the contact points")
    value: float | None = Field(None, description="its value, in the unit; null: no quantity")
    unit: str = Field("", description="unit")
    parameters: dict[str, dict[str, EstimateDocument]] = Field({}, description="estimates of the effects that it names")
    allowed: bool = Field(True, description="whether unseen data are predicted as well as with the best value")


class HeldOutRollouts(Schema):
    """Rollouts of held-out motions before and after."""

    before: RolloutDocument = Field(description="of the model")
    after: RolloutDocument = Field(description="with the effects found on the other folds")
    horizon_s: float | None = Field(
        None, description="horizon of the comparison: the longest at which either predicts better than chance [s]"
    )
    compared: int = Field(description="rollouts that do not overlap, paired")
    closer: int = Field(description="of these, rollouts that are closer to the measurement with the effects")
    p_value: float | None = Field(
        description="p-value of no difference (Wilcoxon signed-rank test); null: too few rollouts, or no difference"
    )

    @property
    def worse(self) -> bool:
        """Whether rollouts get worse with the effects, beyond the scatter over their starts."""
        few = 2 * self.closer < self.compared
        return few and self.p_value is not None and self.p_value < UNADJUSTED_LEVEL

    @property
    def in_words(self) -> str:
        """Errors before and after in one line."""
        pairs = list(zip(self.before.horizons, self.after.horizons, strict=False))
        tool = ", ".join(f"{shown(before.tool_mm)} → {shown(after.tool_mm)}" for before, after in pairs)
        time = ", ".join(f"{before.horizon_s:g}" for before, _ in pairs)
        number, worst = max(enumerate(self.before.last.joints), key=lambda item: item[1].error)
        joint = ", ".join(
            f"{shown(before.joints[number].error)} → {shown(after.joints[number].error)}" for before, after in pairs
        )
        test = "" if self.p_value is None else f" (Wilcoxon signed-rank test, p = {self.p_value:.2g})"
        return (
            f"rollouts of held-out motion, after {time} s: tool off by {tool} mm, {worst.joint} by {joint} "
            f"{worst.unit}; closer with the effects{self._when} in {self.closer} of {self.compared} that do not "
            f"overlap{test}"
        )

    @property
    def _when(self) -> str:
        """Horizon of the comparison, where it is not the longest one."""
        shorter = self.horizon_s is not None and self.horizon_s < self.after.last.horizon_s
        return f" after {self.horizon_s:g} s, beyond which neither predicts," if shorter else ""

    def disagreement(self, change: tuple[float, float] | None) -> str:
        """Sentence if the torque balance improves but rollouts get worse; else empty.

        Args:
            change: 95 % interval of the change of the held-out error.
        """
        if change is None or change[1] >= 0.0 or not self.worse:
            return ""
        return (
            "The two estimators disagree: with these effects the held-out error falls, but predictions in "
            f"{self.after.loop} over {self.horizon_s or self.after.last.horizon_s:g} s get worse in "
            f"{self.compared - self.closer} of "
            f"{self.compared} rollouts "
            f"(Wilcoxon signed-rank test, p = {self.p_value:.2g}), which is evidence of a wrong model class."
        )


class DiagnosisDocument(Schema):
    """``diagnosis.json``."""

    format: int = Field(2, description="version of this format")
    source: Literal["trials", "recordings", "impacts"] = Field("trials", description="what was diagnosed")
    verdict: DiagnosisVerdict = Field(
        description="NOTHING-MISSING, NONE-EXPLAINS, PRESENT-BUT-SMALL, TOO-FEW-REPEATS, IMPOSSIBLE-DATA, PARTLY{...}, "
        "or the missing effects joined by +"
    )
    impossible: str = omitted(
        "", description="how the measurements break a law of every impact, whatever the contact; empty: they do not"
    )
    summary: str = Field("", description="the verdict in words, with the largest residuals in units")
    measurement: str = omitted("", description="faults of the readings, in words; empty: no fault is named")
    calibrate: tuple[CalibrationExperiment, ...] = omitted(
        (), description="experiments for the effects of the measurement that are named, tied or suspected"
    )
    named: tuple[str, ...] = Field((), description="effects that the diagnosis chose")
    required: tuple[str, ...] = omitted(
        (), description="named effect without which replays of impacts hit nothing; all errors include it"
    )
    suspected: tuple[str, ...] = Field(
        (), description="effects that lower the error of all data, and the held-out error by less than its interval"
    )
    within_discrepancy: tuple[str, ...] = Field(
        (), description="effects that lower an error of impacts that is within the discrepancy of the rigid map"
    )
    effects: tuple[EffectDocument, ...] = Field(description="all effects, best first")
    confusable: tuple[tuple[str, ...], ...] = Field(description="effects that the data cannot distinguish")
    unexplained: UnexplainedDocument = Field(default_factory=UnexplainedDocument, description="remaining residuals")
    next_experiment: NextExperiment | None = Field(None, description="experiment that distinguishes confusable effects")
    model: ModelIdentity = Field(description="diagnosed model")
    calibration: CalibrationIdentity | None = omitted(None, description="known faults of the readings; null: none")
    runs: RunsIdentity = Field(description="measurements")
    error_unit: ErrorUnit = Field(TIMES, description="unit of all held-out errors")
    noise_floor: float = Field(description="held-out error of noise alone")
    held_out_error_before: float = Field(description="held-out error of the model")
    held_out_error_after: float = Field(description="held-out error with the effects found on the other clusters")
    held_out_change_ci95: tuple[float, float] | None = Field(
        None, description="95 % interval of after minus before over the clusters"
    )
    hold_out: HoldOutDocument = Field(default_factory=HoldOutDocument, description="how data were held out")
    lack_of_fit: LackOfFit = Field(default_factory=LackOfFit, description="p of the residuals being noise")
    design: DesignDocument = Field(
        default_factory=DesignDocument, description="amount of data, and data that a verdict lacks"
    )
    discrepancy: DiscrepancyDocument = Field(
        default_factory=DiscrepancyDocument, description="model discrepancy of the simulation"
    )
    identifiability: Identifiability = Field(
        default_factory=Identifiability, description="how well the parameters are determined"
    )
    joints: tuple[JointError, ...] = Field((), description="held-out error by joint, of recordings")
    rollouts: HeldOutRollouts | None = omitted(
        None, description="open-loop predictions of held-out motion; null: no effect found, or too little free motion"
    )
    recording: RecordingDocument | None = Field(None, description="how recordings were read")
    drift: DriftDocument | None = Field(None, description="drift over the campaign; null: order unknown or no repeats")
    proportion: ProportionDocument = Field(
        default_factory=ProportionDocument, description="size of the robot, from which ranges and limits follow"
    )
    limits: tuple[LimitDocument, ...] = Field((), description="relevance limits that were used")
    views: tuple[ViewDocument, ...] = Field((), description="verdicts on parts of the signals, or other contact points")
    covariates: tuple[CovariateDocument, ...] = Field((), description="declared circumstances")
    dependences: tuple[DependenceDocument, ...] = Field(
        (), description="dependences of effects on covariates, accepted ones first"
    )
    budget: BudgetDocument = Field(
        default_factory=BudgetDocument, description="processor time, and steps that were left out"
    )
    remarks: tuple[str, ...] = Field((), description="remarks for the reader")
    formulas: tuple[FormulaSpec, ...] = Field((), description="user-defined effects that were considered")
    arms: dict[str, int] = Field({}, description="joints of arms with parameters of their own; empty: shared")
    options: dict[str, Any] = omitted(
        {}, description="options of the command that select the measurements, by name, with absolute paths"
    )

    @property
    def faults(self) -> tuple[str, ...]:
        """Effects of the measurement that are named."""
        return self._named_of(measurement=True)

    @property
    def missing(self) -> tuple[str, ...]:
        """Effects of the physics that are named."""
        return self._named_of(measurement=False)

    def _named_of(self, measurement: bool) -> tuple[str, ...]:
        """Named effects of the measurement, or of the physics."""
        return tuple(name for name in self.named if self.is_of_measurement(name) == measurement)

    def is_of_measurement(self, name: str) -> bool:
        """Whether an effect is a fault of a reading and no physics."""
        effect = self.effect(name)
        return effect is not None and effect.of_measurement

    @property
    def dependent(self) -> dict[str, tuple[str, ...]]:
        """Covariates on which the parameters of an effect depend noticeably, by effect."""
        covariates: dict[str, tuple[str, ...]] = {}
        for dependence in self.dependences:
            if dependence.accepted and dependence.verdict != SMALL:
                covariates[dependence.effect] = (*covariates.get(dependence.effect, ()), dependence.covariate)
        return covariates

    @property
    def addable(self) -> tuple[str, ...]:
        """Named effects with one value for all measurements, determined by these measurements."""
        candidates = [(name, self.effect(name)) for name in self.named if name not in self.dependent]
        return tuple(name for name, effect in candidates if effect is not None and effect.verdict != UNIDENTIFIABLE)

    @property
    def not_excluded(self) -> dict[str, str]:
        """Effects that were not named, but may be present at a noticeable size, with their parameter of largest reach.

        By name of the effect, largest reach first; effects on which no signal depends are omitted.
        """
        if self.impossible:
            return {}
        named_or_tied = {*self.named, *(name for group in self.confusable for name in group)}
        entries = []
        for effect in self.effects:
            if effect.measured and effect.parameters and effect.name not in named_or_tied:
                name, widest = max(effect.parameters.items(), key=lambda item: item[1].reach)
                if widest.reach > 1.0:
                    entries.append((-widest.reach, effect.name, name))
        return {effect: name for _, effect, name in sorted(entries)}

    @property
    def nominally_significant(self) -> tuple[str, ...]:
        """Effects that are not excluded at a noticeable size, and would be significant (5 %) if tested alone.

        One in twenty absent effects is among them; more trials decide. Empty if the held-out error does not exceed
        noise and discrepancy: no effect would be named then.
        """
        if self.held_out_error_after <= self.noise_floor:
            return ()
        effects = [effect for name in self.not_excluded if (effect := self.effect(name)) is not None]
        return tuple(
            effect.name
            for effect in effects
            if effect.lowers and effect.p_value_alone is not None and effect.p_value_alone < UNADJUSTED_LEVEL
        )

    def effect(self, name: str) -> EffectDocument | None:
        """Document of one effect; None: the diagnosis did not consider it."""
        return next((effect for effect in self.effects if effect.name == name), None)


def write_document(document: DiagnosisDocument, path: Path) -> None:
    """Write ``diagnosis.json`` atomically; an earlier one is replaced.

    Raises:
        InputError: It cannot be written.
    """
    write_whole(path, json.dumps(document.model_dump(mode="json"), indent=2, allow_nan=False) + "\n")


def read_document(path: Path) -> DiagnosisDocument:
    """Read ``diagnosis.json``.

    Raises:
        InputError: The file is missing or no diagnosis.
    """
    data = read_json(path, "a diagnosis", MAX_JSON_BYTES)
    if not isinstance(data, dict):
        raise InputError("no diagnosis", file=path)
    if "laws" in data:  # a discovery holds the diagnosis that it comes from
        data = data.get("diagnosis")
        if not isinstance(data, dict):
            raise InputError("this discovery proposes no law", file=path)
    if "format" not in data:
        data = _of_first_format(data, path)
    return validate(DiagnosisDocument, data, path)


def _of_first_format(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """A diagnosis of version 0.1.0 in the present format; its errors stay on the scale of that version.

    Raises:
        InputError: The document is incomplete.
    """
    recording = data.get("kind") == "recording"
    known = set(DiagnosisDocument.model_fields)
    try:
        result = {key: value for key, value in data.items() if key in known and value is not None}
        result["effects"] = [_effect_of_first_format(effect) for effect in data["effects"]]
        result["unexplained"] = {
            "where": [
                {key: cell[key] for key in ("phase", "signal", "index", "share", "times_noise")}
                for cell in data["unexplained"].get("where", ())
            ]
        }
        result["error_unit"] = "N m" if recording else "times the noise"
        if recording:
            files = [Path(name).name for name in data["recording"]["files"]]
            result |= {"source": "recordings", "runs": {"digest": "", "trials": len(files), "conditions": files}}
            fields = set(RecordingDocument.model_fields)
            result["recording"] = {key: value for key, value in data["recording"].items() if key in fields}
        return result
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"not a whole diagnosis ({type(error).__name__}: {error})", file=path) from None


def _effect_of_first_format(effect: dict[str, Any]) -> dict[str, Any]:
    fields = ("name", "sentence", "verdict", "held_out_error_before", "held_out_error_after", "p_value")
    return {key: effect[key] for key in fields if key in effect} | {
        "parameters": _centre_of_mass(effect["parameters"]),
        "measured": effect["p_value"] is not None,
        "reason": effect.get("reason") or "",
    }


def _centre_of_mass(parameters: dict[str, Any]) -> dict[str, Any]:
    """First moments of a payload (version 0.1.0) as its centre of mass; other parameters unchanged."""
    moments = {name: value for name, value in parameters.items() if name.startswith("first_moment_")}
    if not moments:
        return parameters
    mass = parameters["mass"]["estimate"]
    centre = {
        name.replace("first_moment_", "com_"): {
            "estimate": value["estimate"] / mass if mass > 0.0 else 0.0,
            "ci95": None,
            "unit": "m",
            "meaning": "first moment over mass",
        }
        for name, value in moments.items()
    }
    return {name: value for name, value in parameters.items() if name not in moments} | centre
