# SPDX-License-Identifier: Apache-2.0
"""Rounds of an investigation on disk, and the models made by their decisions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from impact_rs_analysis.diagnosis.compare import ComparisonDocument
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document
from impact_rs_analysis.diagnosis.laws.discovery_document import FOUND, DiscoveryDocument
from impact_rs_analysis.diagnosis.thresholds import SIGNIFICANCE_LEVEL
from impact_rs_analysis.diagnosis.verdict import NOTHING, SMALL
from impact_rs_analysis.investigation.prediction_check import PredictionError, Predictions
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_sim.schema import Schema, SchemaType, validate
from impact_rs_trials.campaign import Trial
from impact_rs_trials.experiment_plan import ExperimentPlan, read_plan
from impact_rs_trials.spec import TrialSpec

ROUNDS_FOLDER = "rounds"


class RoundDecision(Schema):
    """Decision after a round, with its reason (``decision.json``)."""

    action: Literal["measure", "add", "end"] = Field(description="what to do")
    reason: str = Field(description="why, in words")
    add: tuple[str, ...] = Field((), description="effects of the new models, in order")
    models: tuple[str, ...] = Field((), description="files of the new models, one for each effect")
    source: str = Field("", description="file of the round with the estimates of these effects")
    base: str = Field("", description="file of the model to which the effects are added; empty: the first model")
    verdict: str = Field("", description="the end: EXPLAINED, LAW-HOLDS, NOTHING-MISSING or UNDECIDED")
    tied: tuple[tuple[str, ...], ...] = Field(
        (), description="effects and laws that may be missing, grouped if the trials cannot distinguish them"
    )
    not_excluded: tuple[str, ...] = Field(
        (), description="effects that could be there at a noticeable size, and that the trials would hardly show"
    )
    show: tuple[str, ...] = Field((), description="effects that the next trials shall show or exclude; none: any")
    spent: bool = Field(False, description="whether it ends because the budget is spent")
    budget: int = Field(description="trials that were allowed")


@dataclass(frozen=True)
class PlannedTrial:
    """One trial of a round.

    Attributes:
        folder: Folder of its bag below ``runs``.
        scenario: Name or path of its scenario.
        settings: Values that the scenario has instead of its own.
        campaign_seed: Seed of its campaign.
        trial: Specification of the trial.
    """

    folder: str
    scenario: str
    settings: dict[str, Any]
    campaign_seed: int
    trial: Trial

    @property
    def path(self) -> str:
        """Its bag below ``runs``."""
        return f"{self.folder}/{self.trial.key.name}"


@dataclass(frozen=True)
class Round:
    """Files of one round; None for a pending step.

    Attributes:
        number: From 1.
        directory: Its folder.
        model: File of its first model: ``Settings.model``, or a name in the folder of the investigation.
    """

    number: int
    directory: Path
    model: str
    plan: ExperimentPlan | None = None
    prediction: Predictions | None = None
    prediction_error: PredictionError | None = None
    comparison: ComparisonDocument | None = None
    diagnosis: DiagnosisDocument | None = None
    again: DiagnosisDocument | None = None
    discovery: DiscoveryDocument | None = None
    decision: RoundDecision | None = None

    @property
    def basis(self) -> DiagnosisDocument | None:
        """The diagnosis for the decision."""
        return self.again or self.diagnosis

    @property
    def open(self) -> DiagnosisDocument | None:
        """Open decisions for the next trials: found laws or effects, and candidates for a rejected model."""
        question = self.laws or self.basis
        if question is None or self.again is None or self.laws is not None:
            return question
        estimated = {effect.name for effect in question.effects if effect.parameters}
        suspected = () if self.diagnosis is None else self.diagnosis.suspected
        names = dict.fromkeys(
            (*question.suspected, *(name for name in suspected if name in estimated - set(question.named)))
        )
        return question.model_copy(update={"suspected": tuple(names)})

    @property
    def laws(self) -> DiagnosisDocument | None:
        """The diagnosis with the laws of its discovery; None without laws."""
        return None if self.discovery is None or self.discovery.verdict != FOUND else self.discovery.diagnosis

    @property
    def shown(self) -> tuple[str, ...]:
        """Effects that the next trials shall show or exclude."""
        return () if self.decision is None else self.decision.show

    @property
    def tried(self) -> bool:
        """Whether a trial of the round is usable."""
        return self.prediction_error is not None and self.prediction_error.trials > 0

    @property
    def folder(self) -> str:
        """Folder of its trials below ``runs``."""
        return f"round_{self.number:02d}"

    @property
    def trials(self) -> list[PlannedTrial]:
        """The trials of its plan, in the order of the plan."""
        return [] if self.plan is None else trials_of(self.plan, self.folder)

    @property
    def p_of_basis(self) -> float | None:
        """p-value of the error in all trials of the model that :attr:`basis` diagnoses; None: not known."""
        checked = self.prediction_error
        if checked is None:
            return None
        return checked.p_value_of_all if self.again is None else checked.p_value_of_first

    @property
    def model_holds(self) -> bool:
        """Whether its model lacks no relevant effect."""
        p_value = None if self.prediction_error is None else self.prediction_error.p_value_of_all
        return self.diagnosis is not None and _lacks_nothing(self.diagnosis, p_value)

    @property
    def basis_holds(self) -> bool:
        """Whether the model that :attr:`basis` diagnoses lacks no relevant effect."""
        return self.basis is not None and _lacks_nothing(self.basis, self.p_of_basis)

    def fails(self, settings: Settings) -> bool:
        """Whether its model has effects and still lacks some."""
        return self.model != settings.model and self.diagnosis is not None and not self.model_holds


@dataclass(frozen=True)
class WantedTrials:
    """Purpose of the next trials: the open decision of a document.

    Attributes:
        model: The model for planning.
        done: Rounds so far.
        document: The open decision; None: whether one of the effects of ``show`` is missing.
        budget: Largest number of trials.
        seed: Seed of scatter and noise.
        show: Effects; empty: all.
    """

    model: Model
    done: Sequence[Round]
    document: DiagnosisDocument | None
    budget: int
    seed: int
    show: Sequence[str] = ()


def _lacks_nothing(document: DiagnosisDocument, p_value: float | None) -> bool:
    """Whether no effect is suspected and the error is consistent with a right model."""
    if document.verdict == SMALL:
        return True
    return document.verdict == NOTHING and not document.suspected and (p_value is None or p_value >= SIGNIFICANCE_LEVEL)


def planned_trials(rounds: Sequence[Round]) -> int:
    """Number of trials in the plans of the rounds."""
    return sum(round_.plan.trials for round_ in rounds if round_.plan is not None)


def trials_of(plan: ExperimentPlan, folder: str) -> list[PlannedTrial]:
    """The trials of a plan, ordered by repeat: all conditions once, then all again.

    Args:
        plan: The plan.
        folder: Folder of its campaigns.

    Raises:
        InputError: A scenario, object or case of it does not exist.
    """
    planned = []
    for campaign in plan.campaigns:
        scenario = load_scenario(campaign.scenario).with_settings(campaign.settings)
        for condition in campaign.conditions:
            spec = TrialSpec.of(scenario, condition.object, condition.case, condition.scale)
            planned += [
                PlannedTrial(
                    f"{folder}/{campaign.folder}",
                    campaign.scenario,
                    campaign.settings,
                    plan.seed,
                    Trial.of(spec, repeat, plan.seed),
                )
                for repeat in range(condition.trials)
            ]
    return sorted(planned, key=lambda trial: trial.trial.repeat)


def read_rounds(directory: Path, settings: Settings) -> list[Round]:
    """All rounds that have begun.

    Raises:
        InputError: A file is damaged or has another format.
    """
    rounds: list[Round] = []
    while (folder := folder_of(directory, len(rounds) + 1)) and (folder / "plan.yaml").exists():
        rounds.append(
            Round(
                number=len(rounds) + 1,
                directory=folder,
                model=newest_model(settings, rounds),
                plan=read_plan(folder / "plan.yaml"),
                prediction=_read(Predictions, folder / "prediction.json"),
                prediction_error=_read(PredictionError, folder / "prediction_error.json"),
                comparison=_read(ComparisonDocument, folder / "compare.json"),
                diagnosis=_read_diagnosis(folder / "diagnosis.json"),
                again=_read_diagnosis(folder / "again.json"),
                discovery=_read(DiscoveryDocument, folder / "discovery.json"),
                decision=_read(RoundDecision, folder / "decision.json"),
            )
        )
    return rounds


def folder_of(directory: Path, number: int) -> Path:
    """Folder of the files of a round."""
    return directory / ROUNDS_FOLDER / f"{number:02d}"


def _read(kind: type[SchemaType], path: Path) -> SchemaType | None:
    """File of a step; None if the step is pending."""
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"incomplete or damaged ({error}); remove it, and the step is done again", file=path) from None
    return validate(kind, content, path)


def _read_diagnosis(path: Path) -> DiagnosisDocument | None:
    return read_document(path) if path.exists() else None


def newest_model(settings: Settings, rounds: Sequence[Round]) -> str:
    """File of the newest model."""
    models = [round_.decision.models[-1] for round_ in rounds if round_.decision is not None and round_.decision.models]
    return models[-1] if models else settings.model


def model_count(rounds: Sequence[Round]) -> int:
    """Number of models that decisions have made."""
    return sum(len(round_.decision.models) for round_ in rounds if round_.decision is not None)


def _additions(rounds: Sequence[Round]) -> list[RoundDecision]:
    """The decisions that led from the first model to the newest one, newest first."""
    decisions = {
        round_.decision.models[-1]: round_.decision
        for round_ in rounds
        if round_.decision is not None and round_.decision.models
    }
    additions, model = list[RoundDecision](), next(reversed(decisions), "")
    while model:
        additions.append(decisions[model])
        model = decisions[model].base
    return additions


def added_effects(rounds: Sequence[Round]) -> set[str]:
    """Effects that the newest model has beyond the first one."""
    return {name for decision in _additions(rounds) for name in decision.add}


def laws_added(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Added laws that a discovery proposed."""
    laws = {law.name for entry in rounds if entry.discovery is not None for law in entry.discovery.laws}
    proposed = (entry for entry in reversed(_additions(rounds)) if entry.source == "discovery.json")
    return tuple(name for entry in proposed for name in entry.add if name in laws)


def laws_found(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Laws of the last successful discovery, and the laws tied with them."""
    for round_ in reversed(rounds):
        if round_.discovery is not None and round_.laws is not None:
            return tuple(dict.fromkeys(name for law in round_.discovery.laws for name in (law.name, *law.tied_with)))
    return ()


def vain_discoveries(rounds: Sequence[Round]) -> int:
    """Number of discoveries without a law."""
    return sum(round_.discovery is not None and round_.laws is None for round_ in rounds)
