# SPDX-License-Identifier: Apache-2.0
"""An investigation: design, predict, measure, compare, diagnose and add, again and again, until nothing is missing.

The folder is the state. Every step reads what is there, makes one file that is missing, and writes it whole, so that an
investigation that was interrupted anywhere goes on where it stopped:

    investigation.yaml              what was asked
    runs/round_NN/FOLDER/TRIAL      bags
    rounds/NN/plan.yaml             which trials, and why
    rounds/NN/prediction.json       what the model predicts for them, written before they are measured
    rounds/NN/prediction_error.json the same held against what was then measured
    rounds/NN/compare.json          the model against all trials
    rounds/NN/diagnosis.json        what the model lacks
    rounds/NN/again.json            what the first model lacks, where the present one does not hold
    rounds/NN/discovery.json        a law, where no effect of the library explains the trials
    rounds/NN/decision.json         what to do next, and why
    model_N.yaml                    models, each with its parent
    ending.json, log.md             the end, and the whole story in words

A model is made from the first one by one diagnosis of all trials: estimates of an early model are not kept, so no later
trial has to be explained by an effect that only makes up for their error. It is then tried on trials that were measured
after it was made.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Any, Literal, Protocol

import scipy
import yaml
from pydantic import Field

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.compare import ComparisonDocument, compare
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.discover import discover
from impact_rs_analysis.diagnosis.discovery_document import FOUND, DiscoveryDocument, write_discovery
from impact_rs_analysis.diagnosis.document import (
    CONFIRMED,
    NOTHING,
    SMALL,
    TOO_FEW,
    DiagnosisDocument,
    ModelIdentity,
    read_document,
    write_document,
)
from impact_rs_analysis.diagnosis.grammar import load_grammar
from impact_rs_analysis.diagnosis.search import ProgressCallback
from impact_rs_analysis.diagnosis.words import not_excluded, shown_unnamed
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.prediction_check import PredictionError, Predictions, predicted, prediction_error
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model, load_model, save_model
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.schema import Schema, SchemaType, load, load_mapping, validate
from impact_rs_trials.blind import KINDS, RUNS
from impact_rs_trials.campaign import Trial
from impact_rs_trials.envelope import CellEnvelope
from impact_rs_trials.experiment_plan import ExperimentPlan, read_plan, write_plan
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec

SETTINGS, ROUNDS, ENDING, LOG = "investigation.yaml", "rounds", "ending.json", "log.md"
FIRST, FEW, MORE = 6, 2, 4  # trials of the first round, of one with little to decide, and of any other
LOUD = 1.5  # times the noise, of an error that is not nothing, however few trials it comes from
FALL = 0.7  # of the held-out error of the round before, below which trials and no law are missing
MOST_DISCOVERIES = 2  # that find no law; each takes minutes
CERTAIN = 0.9999  # the largest probability that is counted with
WORTHWHILE = 0.75  # probability of the right decision that all trials left must promise
EXPLAINED, LAW, MISSES_NOTHING, UNDECIDED = "EXPLAINED", "LAW-HOLDS", NOTHING, "UNDECIDED"


class BlindChoice(Schema):
    """What the plant hides, as ``blind make`` draws it."""

    seed: int = Field(ge=0, description="seed that draws effect and size")
    kind: Literal["single", "pair", "null", "outside"] = Field("single", description="what is hidden")
    effect: str | None = Field(None, description="effect that is hidden; null: drawn")
    magnitude: float | None = Field(None, description="its size in parameter scales [-]; null: drawn")


class Settings(Schema):
    """What an investigation was asked (``investigation.yaml``)."""

    scenarios: tuple[str, ...] = Field(min_length=1, description="names or paths of scenarios")
    model: str = Field("nominal", description="the first model: nominal, or a file")
    model_digest: str = Field(description="digest of its physics")
    via: Literal["inprocess", "nodes", "cell"] = Field("inprocess", description="where trials run")
    seed: int = Field(0, ge=0, description="seed of scatter and noise")
    effects: tuple[str, ...] = Field((), description="effects to consider; none: the library")
    blind: BlindChoice | None = Field(None, description="what the plant hides; null: nothing on purpose")
    envelope: CellEnvelope | None = Field(None, description="which trials may run; null: all that can be planned")

    @property
    def where(self) -> str:
        """Where trials run, in words."""
        return {"inprocess": "in this program", "nodes": "through the ROS 2 nodes", "cell": "on a real cell"}[self.via]


class RoundDecision(Schema):
    """What to do after a round, and why (``decision.json``)."""

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


class Ending(Schema):
    """How an investigation ended (``ending.json``)."""

    verdict: str = Field(description="EXPLAINED, LAW-HOLDS, NOTHING-MISSING or UNDECIDED")
    summary: str = Field(description="the end in words")
    model: str = Field(description="file of the last model")
    effects: tuple[str, ...] = Field((), description="effects that it has beyond the first model")
    laws: tuple[str, ...] = Field((), description="those of them that are laws beyond the library")
    candidates: tuple[str, ...] = Field((), description="effects and laws that may be missing where it is undecided")
    not_excluded: tuple[str, ...] = Field(
        (), description="effects that could be there at a noticeable size, and that the trials would hardly show"
    )
    trials: int = Field(description="trials that were measured")
    rounds: int = Field(description="rounds")

    @property
    def certain(self) -> bool:
        """Whether it says what is missing, or that nothing is."""
        return self.verdict != UNDECIDED


@dataclass(frozen=True)
class PlannedTrial:
    """One trial of a round.

    Attributes:
        folder: Folder of its bag below ``runs``.
        scenario: Name or path of its scenario.
        settings: Values that the scenario has instead of its own.
        campaign_seed: Seed of its campaign.
        trial: What runs.
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
    """What is on disk of one round; None: that step is still to be done.

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
        """What the next trials shall decide: laws or effects found, and what a model that did not hold may lack."""
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
    def folder(self) -> str:
        """Folder of its trials below ``runs``."""
        return f"round_{self.number:02d}"

    @property
    def trials(self) -> list[PlannedTrial]:
        """The trials of its plan, in the order of the plan."""
        return [] if self.plan is None else trials_of(self.plan, self.folder)


Against = Callable[[Model], Source]
Say = Callable[[str], None]


class Bench(Protocol):
    """Where trials are measured and read."""

    def measure(self, trials: Sequence[PlannedTrial]) -> None:
        """Measure trials that have no bag yet; returns when all have one."""

    def read(self) -> Against:
        """All trials against a model."""

    def design(
        self,
        model: Model,
        done: Sequence[Round],
        document: DiagnosisDocument | None,
        budget: int,
        seed: int,
        show: Sequence[str] = (),
    ) -> ExperimentPlan:
        """The next trials, at most ``budget``, for what a document leaves open.

        Without a document they show whether one of the effects of ``show`` is missing (none: of all).
        """

    @property
    def rank(self) -> ProgressCallback:
        """Shows explanations with their error while a search runs."""


class Investigation:
    """An investigation in its folder.

    Args:
        directory: The folder.
        settings: What was asked.
        budget: Trials at most.
        bench: Where trials are measured.
        say: Called with a line about every step.
        after: Called after every step.
    """

    def __init__(
        self,
        directory: Path,
        settings: Settings,
        budget: int,
        bench: Bench,
        say: Say = lambda line: None,
        after: Callable[[], None] = lambda: None,
    ) -> None:
        self.directory, self.settings, self.budget = directory, settings, budget
        self._bench, self._say, self._after = bench, say, after

    def run(self) -> Ending:
        """Take steps until the end; what is on disk is kept.

        Raises:
            InputError: The first model has changed, or a file cannot be used.
        """
        if load_model(self.settings.model).digest != self.settings.model_digest:
            raise InputError(
                "this model was changed since the investigation began; undo that, or begin another in a new folder",
                file=self.settings.model,
            )
        while True:
            rounds = read_rounds(self.directory, self.settings)
            ended = self._step(rounds)
            write_whole(self.directory / LOG, log_of(self.settings, read_rounds(self.directory, self.settings)))
            self._after()
            if ended:
                return read_ending(self.directory)

    def _step(self, rounds: list[Round]) -> bool:
        """Do the first step that has not been done; returns whether it was the last one."""
        last = rounds[-1] if rounds else None
        if last is not None and (done := last.decision) is not None:
            if done.action == "end" and done.spent and self.budget > done.budget:
                (self.directory / ENDING).unlink(missing_ok=True)
                (last.directory / "decision.json").unlink()  # there are trials again
                return False
            if missing := [name for name in done.models if not (self.directory / name).exists()]:
                self._add(last, missing[0])
                return False
            if done.action == "end":
                write_whole(self.directory / ENDING, _json(ending_of(self.settings, rounds)))
                return True
            last = None
        if last is None:
            self._plan(rounds)
            return False
        todo = [one for one in last.trials if not (self.directory / RUNS / one.path).exists()]
        for missing_step, step in (
            (last.prediction is None, self._predict),
            (bool(todo), lambda here: self._bench.measure(todo)),
            (last.prediction_error is None, self._check),
            (last.comparison is None, self._compare),
            (last.diagnosis is None, self._diagnose),
            (last.again is None and self._fails(last), self._diagnose_again),
            (last.discovery is None and self._wants_a_law(rounds), self._discover),
        ):
            if missing_step:
                step(last)
                return False
        self._decide(rounds)
        return False

    def _plan(self, rounds: Sequence[Round]) -> None:
        number = len(rounds) + 1
        here = _folder(self.directory, number)
        left = self.budget - measured(rounds)
        document = rounds[-1].open if rounds else None
        fresh = bool(rounds) and self._to_be_tried(rounds[-1])
        show = rounds[-1].decision.show if rounds and rounds[-1].decision is not None else ()
        count = min(left, FEW if fresh or show else size_of_round(rounds[-1] if rounds else None))
        self._say(f"Round {number}: design of {count} trials at most, {left} are left")
        plan = self._bench.design(
            self._model(_model_after(self.settings, rounds) if fresh else self.settings.model),
            rounds,
            None if fresh or show else document,
            count,
            self.settings.seed + number - 1,
            show,
        )
        if rounds and (promised := promise(plan, left)) < WORTHWHILE:
            self._give_up(rounds[-1], promised, left)
        else:
            write_plan(plan, here / "plan.yaml")

    def _give_up(self, last: Round, promised: float, left: int) -> None:
        """Let a round end the investigation whose open decision no trial would make."""
        done = last.decision
        assert done is not None
        reason = (
            f"{done.reason} And no trial that can be planned here distinguishes what is possible: with all {left} "
            f"trials left the decision would be right with {100.0 * promised:.0f} % at best."
        )
        end = done.model_copy(update={"action": "end", "verdict": UNDECIDED, "reason": reason, "spent": True})
        self._say(f"Round {last.number}: end. {reason}")
        self._write(last, "decision.json", end)

    def _predict(self, here: Round) -> None:
        model = self._model(here.model)
        specs = {label_of(one.trial.spec): one.trial.spec for one in here.trials}
        found = tuple(predicted(model, spec) for spec in specs.values() if spec.scenario.excursion is None)
        self._write(here, "prediction.json", Predictions(model=_identity(model), impacts=found))

    def _check(self, here: Round) -> None:
        assert here.prediction is not None
        source = self._bench.read()(self._model(here.model))
        found = prediction_error(source, self.directory / RUNS / here.folder, here.prediction)
        self._write(here, "prediction_error.json", found)

    def _compare(self, here: Round) -> None:
        self._say(f"Round {here.number}: model {here.model} against all trials")
        self._write(here, "compare.json", compare(self._bench.read()(self._model(here.model))))

    def _diagnose(self, here: Round) -> None:
        self._diagnosis(here, here.model, "diagnosis.json")

    def _diagnose_again(self, here: Round) -> None:
        self._diagnosis(here, self.settings.model, "again.json", self._model(here.model))

    def _diagnosis(self, here: Round, file: str, name: str, earlier: Model | None = None) -> None:
        self._say(f"Round {here.number}: what model {file} lacks")
        model = self._model(file)
        present = {item.name for item in model.effects}
        only = [effect for effect in self.settings.effects if effect not in present] or None
        document = diagnose(self._bench.read()(model), model, only, self._bench.rank, earlier=earlier)
        write_document(document, here.directory / name)

    def _discover(self, here: Round) -> None:
        self._say(f"Round {here.number}: a law that the library does not have")
        model = self._model(self.settings.model)
        found = discover(
            self._bench.read(), model, load_grammar(), list(self.settings.effects) or None, self._bench.rank
        )
        write_discovery(found, here.directory / "discovery.json")

    def _decide(self, rounds: Sequence[Round]) -> None:
        decision = decide(self.settings, rounds, self.budget)
        self._say(f"Round {rounds[-1].number}: {decision.action}. {decision.reason}")
        self._write(rounds[-1], "decision.json", decision)

    def _add(self, here: Round, name: str) -> None:
        """Write one model of a decision; the earlier ones are there."""
        done = here.decision
        assert done is not None
        index = done.models.index(name)
        source = here.directory / done.source
        document = read_document(source)
        before = done.base if index == 0 else done.models[index - 1]
        parent = str(self.directory / before) if before else self.settings.model
        model = load_model(parent)
        # Estimates are those of all effects together, so that a child takes them from the diagnosis of its parent.
        document = document.model_copy(update={"model": _identity(model)})
        self._say(f"Round {here.number}: {name}: {done.add[index]}")
        output = self.directory / name
        save_model(add_effects(model, Path(parent), document, source, [done.add[index]], output, False), output)

    def _to_be_tried(self, here: Round) -> bool:
        """Whether the newest model has not been tried yet: it was made after the round, or no trial of it is usable."""
        made = here.decision is not None and here.decision.action == "add"
        return made or (here.model != self.settings.model and not self._fails(here))

    def _fails(self, here: Round) -> bool:
        """Whether a model with effects does not hold."""
        return here.model != self.settings.model and here.diagnosis is not None and not holds(here.diagnosis)

    def _wants_a_law(self, rounds: Sequence[Round]) -> bool:
        """Whether it is time for a law: what remains has no name, again or for good."""
        now = rounds[-1].basis
        if now is None or not now.calls_for_a_law or _settled(self.settings, rounds[-1]):
            return False
        if _without_a_law(rounds) >= MOST_DISCOVERIES:
            return False
        before = rounds[-2].basis if len(rounds) > 1 else None
        again = before is not None and before.calls_for_a_law and not _falls(before, now)
        return again or bool(_laws_found(rounds)) or self.budget <= measured(rounds)

    def _model(self, name: str) -> Model:
        return load_model(name if name == self.settings.model else self.directory / name)

    def _write(self, here: Round, name: str, document: Schema) -> None:
        write_whole(here.directory / name, _json(document))


def size_of_round(last: Round | None) -> int:
    """Trials of the next round, unless it tries a model.

    Few between effects that have names: a diagnosis is cheaper than trials that were not needed. That nothing is
    missing, that no effect explains what is, and which law does, takes more.

    Args:
        last: The round before; None: nothing was measured yet.
    """
    if last is None:
        return FIRST
    found = last.open
    named = found is not None and (found.named or found.suspected) and not found.calls_for_a_law
    return FEW if named and last.laws is None else MORE


def holds(document: DiagnosisDocument) -> bool:
    """Whether a model lacks nothing that matters: no effect is suspected, and the error is that of noise."""
    return document.verdict == SMALL or (document.verdict == NOTHING and not document.suspected and not _loud(document))


def _loud(document: DiagnosisDocument) -> bool:
    """Whether an error is far beyond the noise, although too few repeats do not show it for certain."""
    return document.held_out_error_before > LOUD * document.noise_floor


def _falls(before: DiagnosisDocument, now: DiagnosisDocument) -> bool:
    """Whether more trials leave clearly less unexplained: then estimates are short of trials, and no law is missing."""
    return bool(now.named) and now.held_out_error_after < FALL * before.held_out_error_after


def _settled(settings: Settings, here: Round) -> bool:
    """Whether a model with effects has stood the trial."""
    return here.model != settings.model and _tried(here) and here.diagnosis is not None and holds(here.diagnosis)


def _tried(here: Round) -> bool:
    """Whether a trial of the round can be used."""
    return here.prediction_error is not None and here.prediction_error.trials > 0


def _without_a_law(rounds: Sequence[Round]) -> int:
    """Discoveries that found no law."""
    return sum(one.discovery is not None and one.laws is None for one in rounds)


def _laws_found(rounds: Sequence[Round]) -> tuple[str, ...]:
    """The laws that the last discovery with laws found, with what is tied with them."""
    for one in reversed(rounds):
        if one.discovery is not None and one.laws is not None:
            return tuple(dict.fromkeys(name for law in one.discovery.laws for name in (law.name, *law.tied_with)))
    return ()


def decide(settings: Settings, rounds: Sequence[Round], budget: int) -> RoundDecision:
    """What to do after the last of some rounds.

    Args:
        settings: What was asked.
        rounds: All rounds, the last one complete but for its decision.
        budget: Trials at most.
    """
    here, basis = rounds[-1], rounds[-1].basis
    assert here.diagnosis is not None and basis is not None
    left = budget - measured(rounds)

    def more(
        reason: str, candidates: tuple[tuple[str, ...], ...] = (), stop: str = "", show: tuple[str, ...] = ()
    ) -> RoundDecision:
        if left > 0 and not stop:
            return RoundDecision(action="measure", reason=reason, tied=candidates, show=show, budget=budget)
        why = stop or f"the budget of {budget} trials is spent"
        return RoundDecision(
            action="end",
            verdict=UNDECIDED,
            reason=f"{reason} And {why}.",
            tied=candidates,
            spent=not stop,
            budget=budget,
        )

    def add(names: Sequence[str], source: str, reason: str, base: str = "") -> RoundDecision:
        first = 2 + sum(len(one.decision.models) for one in rounds if one.decision is not None)
        files = tuple(f"model_{first + index}.yaml" for index in range(len(names)))
        tried = "It is tried on new trials."
        if here.model != settings.model and not base and set(names) == _added(rounds):
            tried = "The estimates are renewed with all trials. They are tried on new ones."
        if left <= 0:
            tried = f"No trial is left to try {files[-1]} on: the budget of {budget} trials is spent."
        return RoundDecision(
            action="add" if left > 0 else "end",
            verdict="" if left > 0 else UNDECIDED,
            reason=f"{reason} {tried}",
            add=tuple(names),
            models=files,
            source=source,
            base=base,
            tied=() if left > 0 else tuple((name,) for name in (*sorted(_added(rounds) if base else ()), *names)),
            spent=left <= 0,
            budget=budget,
        )

    show = _worth_a_look(rounds, basis) if left > 0 else ()
    if _settled(settings, here):
        if show:
            return more(f"{here.model} holds. {_look(basis, show)}", show=show)
        return RoundDecision(
            action="end",
            verdict=LAW if _laws_added(rounds) else EXPLAINED,
            reason=f"{_predicts(here)}, and lacks nothing in all {here.diagnosis.runs.trials}: "
            f"{here.diagnosis.summary}{_what_trials_hardly_show(here.diagnosis)}",
            not_excluded=tuple(here.diagnosis.not_excluded),
            budget=budget,
        )
    if basis.verdict == TOO_FEW:
        return more(f"Too few repeats for a verdict: {basis.design.shortage}.")
    if holds(basis):
        before = rounds[-2].basis if len(rounds) > 1 else None
        if before is None or not holds(before) or not _tried(here):
            return more(f"{basis.summary} New trials have to confirm it.")
        if show:
            return more(f"{basis.summary} {_look(basis, show)}", show=show)
        return RoundDecision(
            action="end",
            verdict=MISSES_NOTHING,
            reason=f"{basis.summary} New trials do not change it.{_what_trials_hardly_show(basis)}",
            not_excluded=tuple(basis.not_excluded),
            budget=budget,
        )
    if basis.verdict == NOTHING and basis.suspected:
        names = " and ".join(basis.suspected)
        return more(f"{names} lowers the error, but not surely on unseen conditions.", (basis.suspected,))
    if basis.verdict == NOTHING:
        return more(
            f"Nothing stands out, but the error of {basis.held_out_error_before:.3g} is far beyond the noise of "
            f"{basis.noise_floor:.3g}: too few repeats to say what it is."
        )
    if here.laws is not None and here.discovery is not None:
        texts = [f"{law.place} = {law.formula}." for law in here.discovery.laws if law.name in here.laws.named]
        ties = [law.tie for law in here.discovery.laws if law.tie and law.name in here.laws.named]
        return _named(here.laws, "discovery.json", " ".join([here.discovery.summary, *texts, *ties]), add, more)
    if here.discovery is not None or basis.calls_for_a_law:
        possible = _laws_found(rounds) or (*basis.named, *basis.suspected)
        count, stop = _without_a_law(rounds), ""
        reason = (
            f"{' and '.join(basis.named)} explains a part" if basis.named else "No effect of the library explains it"
        )
        reason = f"{reason}: {basis.summary}"
        if here.discovery is not None:
            reason += f" {here.discovery.verdict}: {here.discovery.summary}"
            stop = f"{count} discoveries have found no law" if count >= MOST_DISCOVERIES else ""
        return more(reason, (possible,) if possible else (), stop)
    if further := _further(rounds):
        assert here.diagnosis is not None
        reason = f"Beside what {here.model} has, {' and '.join(further)} is named again: {here.diagnosis.summary}"
        return add(further, "diagnosis.json", reason, here.model)
    if _explained_again(rounds):
        renewed = add(basis.named, "again.json", "")
        reason = (
            f"{_predicts(here)}. By all {basis.runs.trials} trials the first model lacks the same: {basis.summary} The "
            f"estimates of {renewed.models[-1]} are from all of them.{_what_trials_hardly_show(basis)}"
        )
        end = {"action": "end", "verdict": EXPLAINED, "reason": reason, "tied": (), "spent": False}
        return renewed.model_copy(update={**end, "not_excluded": tuple(basis.not_excluded)})
    return _named(basis, "again.json" if here.again is not None else "diagnosis.json", basis.summary, add, more)


def _predicts(here: Round) -> str:
    """How well the newest model predicts the newest trials."""
    found = here.prediction_error
    assert found is not None
    return (
        f"{here.model} predicts the {found.trials} trials that were measured after it was made with an error of "
        f"{found.error:.3g} {found.unit}"
    )


def _explained_again(rounds: Sequence[Round]) -> bool:
    """Whether the first model is explained by what the newest one has, which has predicted the newest trials.

    No more than noise is left. What the newest model seems to lack is then the error of its estimates, from fewer
    trials: it is alike in all of them, and something explains a part of it.
    """
    again, checked = rounds[-1].again, rounds[-1].prediction_error
    if again is None or checked is None or checked.error is None or set(again.named) != _added(rounds):
        return False
    confirmed = all((effect := again.effect(name)) is not None and effect.verdict == CONFIRMED for name in again.named)
    predicted = checked.error <= LOUD * again.noise_floor and again.held_out_error_after <= again.noise_floor
    return confirmed and predicted and not _laws_added(rounds)


def _worth_a_look(rounds: Sequence[Round], document: DiagnosisDocument) -> tuple[str, ...]:
    """Effects of which more trials are measured before an end, as long as these make them more significant."""
    before = rounds[-2] if len(rounds) > 1 else None
    looked = before.decision.show if before is not None and before.decision is not None else ()
    return tuple(
        name
        for name in (document.nominally_significant if document.verdict == NOTHING else ())
        if name not in looked or _alone(document, name) < _alone(before.basis if before else None, name)
    )


def _alone(document: DiagnosisDocument | None, name: str) -> float:
    """p-value of an effect as if it were tested alone."""
    effect = None if document is None else document.effect(name)
    return 1.0 if effect is None or effect.p_value_alone is None else effect.p_value_alone


def _look(document: DiagnosisDocument, names: Sequence[str]) -> str:
    """Why more trials of some effects are measured."""
    found = [f"{name} (p = {_alone(document, name):.2g})" for name in names]
    return f"Tested alone, {' and '.join(found)} would be significant: trials that show it or exclude it."


def _what_trials_hardly_show(document: DiagnosisDocument) -> str:
    """A sentence about effects that could be there at a noticeable size; empty: there are none."""
    effects = ", ".join(filter(None, [shown_unnamed(document), not_excluded(document)]))
    return f" Not excluded at a noticeable size: {effects}." if effects else ""


def _named(
    found: DiagnosisDocument,
    source: str,
    summary: str,
    add: Callable[[Sequence[str], str, str], RoundDecision],
    more: Callable[..., RoundDecision],
) -> RoundDecision:
    """What to do with effects and laws that a diagnosis names: all are added where all are confirmed."""
    unsure = [effect for name in found.named if (effect := found.effect(name)) and effect.verdict != CONFIRMED]
    if not unsure:
        return add(found.named, source, summary)
    reason = "; ".join(f"{effect.name} is {effect.verdict}" for effect in unsure)
    alone = tuple((name,) for name in found.named if not any(name in group for group in found.confusable))
    return more(f"{reason}. {summary}", (*found.confusable, *alone))


def promise(plan: ExperimentPlan, left: int) -> float:
    """Largest probability of the right decision between two explanations that all trials left can promise [-].

    The squared distance of two explanations grows at most in proportion to the trials, and every further one is a
    degree of freedom of the scatter. 1: the plan is not for rivals.

    Args:
        plan: The next trials.
        left: Trials left, those of the plan among them.
    """
    if plan.aim != "rivals" or not plan.pairs:
        return 1.0
    best = min(max(pair.after for pair in plan.pairs), CERTAIN)
    if not plan.freedom:
        return NormalDist().cdf(NormalDist().inv_cdf(best) * math.sqrt(left / plan.trials))
    half = scipy.special.stdtrit(plan.freedom, best) * math.sqrt(left / plan.trials)
    return float(scipy.special.stdtr(plan.freedom + left - plan.trials, half))


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


def begin(directory: Path, settings: Settings) -> Settings:
    """The settings of a folder, which are written where it has none.

    Raises:
        InputError: It holds another investigation.
    """
    path = directory / SETTINGS
    if path.exists():
        present = load(Settings, path)
        if present != settings:
            changed = [name for name in Settings.model_fields if getattr(present, name) != getattr(settings, name)]
            raise InputError(
                f"this folder holds another investigation (it differs in {', '.join(changed)}); give the same options "
                "again, only --budget may grow, or choose another folder",
                file=path,
            )
        return present
    write_whole(path, yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False))
    return settings


def read_settings(directory: Path) -> Settings:
    """What was asked.

    Raises:
        InputError: There is no investigation in the folder.
    """
    path = directory / SETTINGS
    if not path.exists():
        raise InputError(f"no investigation here: there is no {SETTINGS}", file=directory)
    return load(Settings, path)


def read_ending(directory: Path) -> Ending:
    """How an investigation ended.

    Raises:
        InputError: It has not ended.
    """
    path = directory / ENDING
    if not path.exists():
        raise InputError(f"this investigation has not ended: there is no {ENDING}", file=directory)
    return validate(Ending, load_mapping(path), path)


def read_rounds(directory: Path, settings: Settings) -> list[Round]:
    """All rounds that have begun.

    Raises:
        InputError: A file is not what it should be.
    """
    found: list[Round] = []
    while (here := _folder(directory, len(found) + 1)) and (here / "plan.yaml").exists():
        found.append(
            Round(
                number=len(found) + 1,
                directory=here,
                model=_model_after(settings, found),
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


def _read(kind: type[SchemaType], path: Path) -> SchemaType | None:
    """A file of a step; None: that step is still to be done."""
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"not whole ({error}); remove it, and the step is done again", file=path) from None
    return validate(kind, content, path)


def _read_diagnosis(path: Path) -> DiagnosisDocument | None:
    return read_document(path) if path.exists() else None


def _folder(directory: Path, number: int) -> Path:
    return directory / ROUNDS / f"{number:02d}"


def _model_after(settings: Settings, rounds: Sequence[Round]) -> str:
    """The newest model."""
    made = [one.decision.models[-1] for one in rounds if one.decision is not None and one.decision.models]
    return made[-1] if made else settings.model


def _last_addition(rounds: Sequence[Round]) -> RoundDecision | None:
    return next((one.decision for one in reversed(rounds) if one.decision is not None and one.decision.models), None)


def _additions(rounds: Sequence[Round]) -> list[RoundDecision]:
    """The decisions that led from the first model to the newest one."""
    made = {one.decision.models[-1]: one.decision for one in rounds if one.decision is not None and one.decision.models}
    found, last = list[RoundDecision](), _last_addition(rounds)
    while last is not None:
        found.insert(0, last)
        last = made[last.base] if last.base else None
    return found


def _added(rounds: Sequence[Round]) -> set[str]:
    """Effects that the newest model has beyond the first one."""
    return {name for one in _additions(rounds) for name in one.add}


def _further(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Effects that the newest model lacks for certain, beside nothing else, and not for the first time.

    The one before lacked them as well or perhaps, or the newest trials were measured to show them. The first model is
    explained by what the newest one has, because a small effect beside a large one lowers the error of the first model
    by too little.
    """
    if len(rounds) < 2 or rounds[-1].again is None or set(rounds[-1].again.named) != _added(rounds):
        return ()
    before, now = rounds[-2].diagnosis, rounds[-1].diagnosis
    looked = () if rounds[-2].decision is None else rounds[-2].decision.show
    if (
        before is None
        or now is None
        or not now.named
        or not {*now.named} <= {*before.named, *before.suspected, *looked}
    ):
        return ()
    if (rounds[-2].model == rounds[-1].model and not looked) or {*now.named} & _added(rounds):
        return ()  # the same estimates, which may be off
    confirmed = all((effect := now.effect(name)) is not None and effect.verdict == CONFIRMED for name in now.named)
    return now.named if confirmed else ()


def _laws_added(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Those of them that a discovery proposed."""
    laws = {law.name for one in rounds if one.discovery is not None for law in one.discovery.laws}
    proposed = (one for one in _additions(rounds) if one.source == "discovery.json")
    return tuple(name for one in proposed for name in one.add if name in laws)


def _identity(model: Model) -> ModelIdentity:
    return ModelIdentity(name=model.name, digest=model.digest)


def _json(document: Schema) -> str:
    return json.dumps(document.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"


def ending_of(settings: Settings, rounds: Sequence[Round]) -> Ending:
    """The end that the last decision says."""
    last = rounds[-1].decision
    assert last is not None and last.action == "end"
    certain = last.verdict in (EXPLAINED, LAW)
    names = tuple(sorted(_added(rounds))) if certain else ()
    candidates = tuple(dict.fromkeys(name for group in last.tied for name in group))
    what = {
        EXPLAINED: f"Missing: {' and '.join(names)}.",
        LAW: f"Missing, by a law that holds: {' and '.join(names)}.",
        MISSES_NOTHING: "Nothing is missing.",
        UNDECIDED: "I cannot tell what is missing" + (f"; possible: {', '.join(candidates)}." if candidates else "."),
    }[last.verdict]
    return Ending(
        verdict=last.verdict,
        summary=f"{what} {last.reason}",
        model=_model_after(settings, rounds) if certain else settings.model,
        effects=names,
        laws=_laws_added(rounds) if certain else (),
        candidates=candidates,
        not_excluded=last.not_excluded,
        trials=measured(rounds),
        rounds=len(rounds),
    )


def log_of(settings: Settings, rounds: Sequence[Round]) -> str:
    """The story of an investigation, in Markdown."""
    asked = f"Scenarios {', '.join(settings.scenarios)}; first model {settings.model}; trials run {settings.where}."
    if settings.blind is not None:
        asked += f" The plant hides what seed {settings.blind.seed} draws ({settings.blind.kind})."
    lines = ["# Investigation", "", asked, ""]
    for here in rounds:
        lines += [f"## Round {here.number}", "", *_round_lines(here), ""]
    if rounds and (last := rounds[-1].decision) is not None and last.action == "end":
        end = ending_of(settings, rounds)
        lines += [f"## End: {end.verdict}", "", end.summary, "", f"{end.trials} trials in {end.rounds} rounds.", ""]
    return "\n".join(lines)


def _round_lines(here: Round) -> Iterator[str]:
    """One line per step of a round."""
    if (plan := here.plan) is not None:
        yield f"* Design: {plan.trials} trials. {plan.summary}".rstrip()
        for campaign in plan.campaigns:
            for one in campaign.conditions:
                what = one.what or f"{campaign.folder}/{one.object}/{one.case}"
                yield f"    * {one.buys or f'{one.trials} x {what}'}"
    if (prediction := here.prediction) is not None:
        for said in prediction.impacts:
            yield (
                f"* Prediction of {prediction.model.name} for {said.condition}: end effector {said.arm:+.3f} m/s, "
                f"object {said.object:+.3f} m/s after the impact"
            )
    if (checked := here.prediction_error) is not None:
        if checked.error is not None:
            yield (
                f"* Prediction error of {checked.model.name} in the {checked.trials} trials of this round: "
                f"{checked.error:.3g} {checked.unit}"
            )
        for impact in checked.impacts:
            said, seen = impact.predicted, impact.object
            tracked = "" if seen is None else f", object {seen:+.3f} m/s (predicted {said.object:+.3f})"
            yield (
                f"    * {impact.condition}: measured end effector {impact.arm:+.3f} m/s (predicted {said.arm:+.3f})"
                f"{tracked}"
            )
    if (comparison := here.comparison) is not None:
        floor = "" if comparison.noise_floor is None else f" (noise: {comparison.noise_floor:.3g})"
        yield (
            f"* Comparison: {comparison.model.name} against {comparison.trials} trials: error {comparison.score:.3g} "
            f"× repeatability{floor}"
        )
    if here.diagnosis is not None:
        yield f"* Diagnosis of {here.diagnosis.model.name}: {here.diagnosis.verdict}. {here.diagnosis.summary}"
    if here.again is not None:
        yield f"* It does not hold. Diagnosis of the first model: {here.again.verdict}. {here.again.summary}"
    if here.discovery is not None:
        yield f"* Discovery: {here.discovery.verdict}. {here.discovery.summary}"
    if (decision := here.decision) is not None:
        made = f" ({', '.join(decision.models)})" if decision.models else ""
        yield f"* Decision: {decision.action}{made}. {decision.reason}"


def judged(ending: Ending, kind: str, hidden: Sequence[str], laws: Collection[str] | None = None) -> tuple[bool, bool]:
    """Whether an end is right, and whether it is surely wrong.

    Right is: every hidden effect and no other, or undecided among candidates with all of them; where nothing is hidden,
    NOTHING-MISSING; of a cause outside the library, a law for it that holds and no other effect, or undecided with such
    a law among the candidates or without any candidate. An undecided end is never surely wrong, nor is one that misses
    only hidden effects that it says are not excluded.

    Args:
        ending: The end.
        kind: Kind of what is hidden, one of ``KINDS``.
        hidden: Hidden effects of the library, or the cause outside it.
        laws: Names of the laws that are right for a cause outside the library; None: of every law.
    """
    assert kind in KINDS
    named = set(ending.effects if ending.certain else ending.candidates)
    if kind == "outside":
        true = named - set(library()) if laws is None else named & set(laws)
        right = (ending.verdict == LAW and named == true) if ending.certain else (bool(true) or not named)
    elif not ending.certain:
        right = bool(hidden) and set(hidden) <= named
    else:
        right = named == set(hidden) and (ending.verdict == MISSES_NOTHING) == (not hidden)
    missed = set(hidden) - named
    open_still = kind != "outside" and named <= set(hidden) and missed <= set(ending.not_excluded)
    return right, ending.certain and not right and not open_still
