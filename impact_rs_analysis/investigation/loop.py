# SPDX-License-Identifier: Apache-2.0
"""Steps of an investigation, a state machine on the files of its folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.compare import compare
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, ModelIdentity, read_document, write_document
from impact_rs_analysis.diagnosis.laws.discover import discover
from impact_rs_analysis.diagnosis.laws.discovery_document import write_discovery
from impact_rs_analysis.diagnosis.laws.grammar import load_grammar
from impact_rs_analysis.diagnosis.search.effect_selection import ProgressCallback
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.investigation.endings import ENDING_FILE, UNDECIDED, Ending, ending_of, read_ending
from impact_rs_analysis.investigation.policy import MAX_VAIN_DISCOVERIES, decide
from impact_rs_analysis.investigation.prediction_check import Predictions, predicted, prediction_error
from impact_rs_analysis.investigation.promise import MIN_WORTHWHILE_PROBABILITY, best_decision_probability
from impact_rs_analysis.investigation.round_state import validated
from impact_rs_analysis.investigation.rounds import (
    PlannedTrial,
    Round,
    WantedTrials,
    folder_of,
    laws_found,
    newest_model,
    planned_trials,
    read_rounds,
    vain_discoveries,
)
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_analysis.investigation.story import LOG_FILE, log_of
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model, load_model, save_model
from impact_rs_sim.schema import Schema
from impact_rs_trials.blind import RUNS
from impact_rs_trials.experiment_plan import ExperimentPlan, write_plan
from impact_rs_trials.runs import label_of

FIRST, FEW, MORE = 6, 2, 4  # trials of the first round, of a round with little to decide, of other rounds
FALLING_ERROR_RATIO = 0.7  # held-out error over the error of the round before; below, trials are missing, not a law

Against = Callable[[Model], Source]
Say = Callable[[str], None]


class Bench(Protocol):
    """Where trials are measured and read."""

    def measure(self, trials: Sequence[PlannedTrial]) -> None:
        """Measure trials that have no bag yet; returns when all have one."""

    def read(self) -> Against:
        """All trials against a model."""

    def design(self, wanted: WantedTrials) -> ExperimentPlan:
        """The next trials."""

    @property
    def rank(self) -> ProgressCallback:
        """Shows explanations with their error while a search runs."""


class Investigation:
    """An investigation in its folder.

    Args:
        directory: The folder.
        settings: Settings of the investigation.
        budget: Largest number of trials.
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
        """Take steps until the end; existing files are kept.

        Raises:
            InputError: The first model has changed, or a file cannot be used.
        """
        if load_model(self.settings.model).digest != self.settings.model_digest:
            raise InputError(
                "this model was changed since the investigation began; undo the change, or begin another one in a "
                "new folder",
                file=self.settings.model,
            )
        while True:
            rounds = read_rounds(self.directory, self.settings)
            ended = self._step(rounds)
            write_whole(self.directory / LOG_FILE, log_of(self.settings, read_rounds(self.directory, self.settings)))
            self._after()
            if ended:
                return read_ending(self.directory)

    def _step(self, rounds: list[Round]) -> bool:
        """Do the first pending step; returns whether it was the last one."""
        last = rounds[-1] if rounds else None
        if last is not None and (decision := last.decision) is not None:
            if decision.action == "end" and decision.spent and self.budget > decision.budget:
                (self.directory / ENDING_FILE).unlink(missing_ok=True)
                (last.directory / "decision.json").unlink()  # a larger budget: trials are possible again
                return False
            if missing := [name for name in decision.models if not (self.directory / name).exists()]:
                self._add(last, missing[0])
                return False
            if decision.action == "end":
                write_whole(self.directory / ENDING_FILE, _json(ending_of(self.settings, rounds)))
                return True
            last = None
        if last is None:
            self._plan(rounds)
            return False
        unmeasured = [planned for planned in last.trials if not (self.directory / RUNS / planned.path).exists()]
        for missing_step, step in (
            (last.prediction is None, self._predict),
            (bool(unmeasured), lambda round_: self._bench.measure(unmeasured)),
            (last.prediction_error is None, self._check),
            (last.comparison is None, self._compare),
            (last.diagnosis is None, lambda round_: self._diagnose(round_, round_.model, "diagnosis.json")),
            (last.again is None and last.fails(self.settings), self._diagnose_again),
            (last.discovery is None and self._wants_a_law(rounds), self._discover),
        ):
            if missing_step:
                step(last)
                return False
        self._decide(rounds)
        return False

    def _plan(self, rounds: Sequence[Round]) -> None:
        number = len(rounds) + 1
        folder = folder_of(self.directory, number)
        remaining = self.budget - planned_trials(rounds)
        if rounds and remaining <= 0:
            self._end(rounds[-1], f"The budget of {self.budget} trials is spent.")
            return
        document = rounds[-1].open if rounds else None
        untested_model = bool(rounds) and self._to_be_tried(rounds[-1])
        to_show = rounds[-1].shown if rounds else ()
        count = min(remaining, FEW if untested_model or to_show else size_of_round(rounds[-1] if rounds else None))
        self._say(f"Round {number}: design of {count} trials at most, {remaining} are left")
        wanted = WantedTrials(
            self._model(newest_model(self.settings, rounds) if untested_model else self.settings.model),
            rounds,
            None if untested_model or to_show else document,
            count,
            self.settings.seed + number - 1,
            to_show,
        )
        plan = self._bench.design(wanted)
        if rounds and (probability := best_decision_probability(plan, remaining)) < MIN_WORTHWHILE_PROBABILITY:
            self._give_up(rounds[-1], probability, remaining)
        else:
            write_plan(plan, folder / "plan.yaml")

    def _give_up(self, last: Round, probability: float, remaining: int) -> None:
        """End the investigation if the remaining trials cannot decide the open question."""
        reason = (
            f"No possible trial distinguishes the remaining explanations: all {remaining} remaining trials would "
            f"do so with a probability of {100.0 * probability:.0f} % at best."
        )
        self._end(last, reason)

    def _end(self, last: Round, cause: str) -> None:
        """End the investigation undecided: further trials are not possible or would not help."""
        decision = last.decision
        assert decision is not None
        reason = f"{decision.reason} {cause}"
        final = decision.model_copy(update={"action": "end", "verdict": UNDECIDED, "reason": reason, "spent": True})
        self._say(f"Round {last.number}: end. {reason}")
        self._write(last, "decision.json", final)

    def _predict(self, round_: Round) -> None:
        model = self._model(round_.model)
        specs = {label_of(planned.trial.spec): planned.trial.spec for planned in round_.trials}
        impacts = tuple(predicted(model, spec) for spec in specs.values() if spec.scenario.excursion is None)
        self._write(round_, "prediction.json", Predictions(model=ModelIdentity.of(model), impacts=impacts))

    def _check(self, round_: Round) -> None:
        assert round_.prediction is not None
        against = self._bench.read()
        source, first = against(self._model(round_.model)), against(self._model(self.settings.model))
        checked = prediction_error(source, self.directory / RUNS / round_.folder, round_.prediction, first)
        self._write(round_, "prediction_error.json", checked)

    def _compare(self, round_: Round) -> None:
        self._say(f"Round {round_.number}: model {round_.model} against all trials")
        self._write(round_, "compare.json", compare(self._bench.read()(self._model(round_.model))))

    def _diagnose_again(self, round_: Round) -> None:
        self._diagnose(round_, self.settings.model, "again.json", self._model(round_.model))

    def _diagnose(self, round_: Round, model_file: str, output_name: str, earlier: Model | None = None) -> None:
        self._say(f"Round {round_.number}: what model {model_file} lacks")
        model = self._model(model_file)
        present = {present_effect.name for present_effect in model.effects}
        only = [effect for effect in self.settings.effects if effect not in present] or None
        document = diagnose(self._bench.read()(model), model, only, self._bench.rank, earlier=earlier)
        write_document(document, round_.directory / output_name)

    def _discover(self, round_: Round) -> None:
        self._say(f"Round {round_.number}: a law that the library does not have")
        model = self._model(self.settings.model)
        discovery = discover(
            self._bench.read(), model, load_grammar(), list(self.settings.effects) or None, self._bench.rank
        )
        write_discovery(discovery, round_.directory / "discovery.json")

    def _decide(self, rounds: Sequence[Round]) -> None:
        decision = decide(self.settings, rounds, self.budget)
        self._say(f"Round {rounds[-1].number}: {decision.action}. {decision.reason}")
        self._write(rounds[-1], "decision.json", decision)

    def _add(self, round_: Round, name: str) -> None:
        """Write one model of a decision; its earlier models exist."""
        decision = round_.decision
        assert decision is not None
        index = decision.models.index(name)
        source = round_.directory / decision.source
        document = read_document(source)
        parent_name = decision.base if index == 0 else decision.models[index - 1]
        parent = str(self.directory / parent_name) if parent_name else self.settings.model
        model = load_model(parent)
        # The estimates are from a fit of all effects together, so a child takes them from the diagnosis of its parent.
        document = document.model_copy(update={"model": ModelIdentity.of(model)})
        self._say(f"Round {round_.number}: {name}: {decision.add[index]}")
        output = self.directory / name
        save_model(add_effects(model, Path(parent), document, source, [decision.add[index]], output, False), output)

    def _to_be_tried(self, round_: Round) -> bool:
        """Whether the newest model is untested: it was made after the round, or the round has no usable trial."""
        new_model = round_.decision is not None and round_.decision.action == "add"
        return new_model or (round_.model != self.settings.model and not round_.fails(self.settings))

    def _wants_a_law(self, rounds: Sequence[Round]) -> bool:
        """Whether to search for a law: no effect explains the residual, in two rounds or at the end of the budget."""
        now = rounds[-1].basis
        if now is None or not now.verdict.leaves_residuals or validated(self.settings, rounds[-1]):
            return False
        if vain_discoveries(rounds) >= MAX_VAIN_DISCOVERIES:
            return False
        before = rounds[-2].basis if len(rounds) > 1 else None
        again = before is not None and before.verdict.leaves_residuals and not _falls(before, now)
        return again or bool(laws_found(rounds)) or self.budget <= planned_trials(rounds)

    def _model(self, name: str) -> Model:
        return load_model(name if name == self.settings.model else self.directory / name)

    def _write(self, round_: Round, name: str, document: Schema) -> None:
        write_whole(round_.directory / name, _json(document))


def size_of_round(last_round: Round | None) -> int:
    """Trials of the next round, unless it tries a model.

    Few trials decide between known effects: a diagnosis is cheaper than unnecessary trials. More trials show that
    nothing is missing, that no effect explains the residual, or which law explains it.

    Args:
        last_round: The round before; None: no trial was measured yet.
    """
    if last_round is None:
        return FIRST
    question = last_round.open
    named = question is not None and (question.named or question.suspected) and not question.verdict.leaves_residuals
    return FEW if named and last_round.laws is None else MORE


def _falls(before: DiagnosisDocument, now: DiagnosisDocument) -> bool:
    """Whether more trials clearly lower the error: then trials are missing, not a law."""
    return bool(now.named) and now.held_out_error_after < FALLING_ERROR_RATIO * before.held_out_error_after


def _json(document: Schema) -> str:
    return json.dumps(document.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"
