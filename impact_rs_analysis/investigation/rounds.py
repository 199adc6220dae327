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
from impact_rs_sim.scenarios.scenario import load_scenario
from impact_rs_sim.schema import Schema, SchemaType, validate
from impact_rs_trials.campaign import Trial
from impact_rs_trials.experiment_plan import ExperimentPlan, read_plan
from impact_rs_trials.spec import TrialSpec

ROUNDS_FOLDER = "rounds"


class RoundDecision(Schema):
    """Decision after a round, with its reason (``decision.json``)."""

    action: Literal["measure", "add", "end"] = Field(description="what to do")
    reason: str = Field(description="why, in words")
    add: tuple[str, ...] = Field((), description="effects that the new models have, in order")
    models: tuple[str, ...] = Field((), description="their files, one for each effect")
    source: str = Field("", description="file of the round that has their estimates")
    base: str = Field("", description="file of the model that they are added to; empty: the first model")
    verdict: str = Field("", description="the end: EXPLAINED, LAW-HOLDS, NOTHING-MISSING or UNDECIDED")
    tied: tuple[tuple[str, ...], ...] = Field(
        (), description="effects and laws that may be missing, those together that the trials cannot distinguish"
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
    """Files of one round; None: that step is pending.

    Attributes:
        number: From 1.
        directory: Its folder.
        model: File of the model that it begins with, as ``Settings.model`` or a name in the investigation's folder.
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
        """The diagnosis that the decision is made from."""
        return self.again or self.diagnosis

    @property
    def open(self) -> DiagnosisDocument | None:
        """Open decisions for the next trials: found laws or effects, and candidates for a rejected model."""
        found = self.laws or self.basis
        if found is None or self.again is None or self.laws is not None:
            return found
        known = {effect.name for effect in found.effects if effect.parameters}
        beside = () if self.diagnosis is None else self.diagnosis.suspected
        names = dict.fromkeys((*found.suspected, *(name for name in beside if name in known - set(found.named))))
        return found.model_copy(update={"suspected": tuple(names)})

    @property
    def laws(self) -> DiagnosisDocument | None:
        """The diagnosis with the laws that its discovery found; None: there are none."""
        return None if self.discovery is None or self.discovery.verdict != FOUND else self.discovery.diagnosis

    @property
    def shown(self) -> tuple[str, ...]:
        """Effects that the trials after it were measured to show or to exclude."""
        return () if self.decision is None else self.decision.show

    @property
    def tried(self) -> bool:
        """Whether a trial of it can be used."""
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
        """Whether its model lacks nothing that matters."""
        p_value = None if self.prediction_error is None else self.prediction_error.p_value_of_all
        return self.diagnosis is not None and _lacks_nothing(self.diagnosis, p_value)

    @property
    def basis_holds(self) -> bool:
        """Whether the model that :attr:`basis` diagnoses lacks nothing that matters."""
        return self.basis is not None and _lacks_nothing(self.basis, self.p_of_basis)

    def fails(self, settings: Settings) -> bool:
        """Whether its model has effects and lacks something all the same."""
        return self.model != settings.model and self.diagnosis is not None and not self.model_holds


@dataclass(frozen=True)
class WantedTrials:
    """Purpose of the next trials: the open decision of a document.

    Attributes:
        model: The model that they are planned with.
        done: Rounds so far.
        document: The open decision; None: whether one of the effects of ``show`` is missing.
        budget: Trials at most.
        seed: Seed of scatter and noise.
        show: Effects; none: all.
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


def measured(rounds: Sequence[Round]) -> int:
    """Trials of the plans of some rounds."""
    return sum(one.plan.trials for one in rounds if one.plan is not None)


def trials_of(plan: ExperimentPlan, folder: str) -> list[PlannedTrial]:
    """The trials of a plan, repeat by repeat, with every condition once in each.

    Args:
        plan: The plan.
        folder: Folder of its campaigns.

    Raises:
        InputError: A scenario, object or case of it does not exist.
    """
    found = []
    for campaign in plan.campaigns:
        scenario = load_scenario(campaign.scenario).with_settings(campaign.settings)
        for condition in campaign.conditions:
            spec = TrialSpec.of(scenario, condition.object, condition.case, condition.scale)
            found += [
                PlannedTrial(
                    f"{folder}/{campaign.folder}",
                    campaign.scenario,
                    campaign.settings,
                    plan.seed,
                    Trial.of(spec, repeat, plan.seed),
                )
                for repeat in range(condition.trials)
            ]
    return sorted(found, key=lambda one: one.trial.repeat)


def read_rounds(directory: Path, settings: Settings) -> list[Round]:
    """All rounds that have begun.

    Raises:
        InputError: A file is not what it should be.
    """
    found: list[Round] = []
    while (here := folder_of(directory, len(found) + 1)) and (here / "plan.yaml").exists():
        found.append(
            Round(
                number=len(found) + 1,
                directory=here,
                model=newest_model(settings, found),
                plan=read_plan(here / "plan.yaml"),
                prediction=_read(Predictions, here / "prediction.json"),
                prediction_error=_read(PredictionError, here / "prediction_error.json"),
                comparison=_read(ComparisonDocument, here / "compare.json"),
                diagnosis=_read_diagnosis(here / "diagnosis.json"),
                again=_read_diagnosis(here / "again.json"),
                discovery=_read(DiscoveryDocument, here / "discovery.json"),
                decision=_read(RoundDecision, here / "decision.json"),
            )
        )
    return found


def folder_of(directory: Path, number: int) -> Path:
    """Folder of the files of a round."""
    return directory / ROUNDS_FOLDER / f"{number:02d}"


def _read(kind: type[SchemaType], path: Path) -> SchemaType | None:
    """A file of a step; None: that step is still to be done."""
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
    """The newest model."""
    made = [one.decision.models[-1] for one in rounds if one.decision is not None and one.decision.models]
    return made[-1] if made else settings.model


def models_made(rounds: Sequence[Round]) -> int:
    """Number of models that decisions have made."""
    return sum(len(one.decision.models) for one in rounds if one.decision is not None)


def _additions(rounds: Sequence[Round]) -> list[RoundDecision]:
    """The decisions that led from the first model to the newest one, newest first."""
    made = {one.decision.models[-1]: one.decision for one in rounds if one.decision is not None and one.decision.models}
    found, name = list[RoundDecision](), next(reversed(made), "")
    while name:
        found.append(made[name])
        name = made[name].base
    return found


def added(rounds: Sequence[Round]) -> set[str]:
    """Effects that the newest model has beyond the first one."""
    return {name for one in _additions(rounds) for name in one.add}


def laws_added(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Added laws that a discovery proposed."""
    laws = {law.name for one in rounds if one.discovery is not None for law in one.discovery.laws}
    proposed = (one for one in reversed(_additions(rounds)) if one.source == "discovery.json")
    return tuple(name for one in proposed for name in one.add if name in laws)


def laws_found(rounds: Sequence[Round]) -> tuple[str, ...]:
    """The laws that the last discovery with laws found, with what is tied with them."""
    for one in reversed(rounds):
        if one.discovery is not None and one.laws is not None:
            return tuple(dict.fromkeys(name for law in one.discovery.laws for name in (law.name, *law.tied_with)))
    return ()


def searches_in_vain(rounds: Sequence[Round]) -> int:
    """Discoveries that found no law."""
    return sum(one.discovery is not None and one.laws is None for one in rounds)
