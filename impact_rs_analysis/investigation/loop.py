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
from impact_rs_analysis.investigation.round_state import stands
from impact_rs_analysis.investigation.rounds import (
    PlannedTrial,
    Round,
    WantedTrials,
    folder_of,
    laws_found,
    measured,
    newest_model,
    read_rounds,
    searches_in_vain,
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

FIRST, FEW, MORE = 6, 2, 4  # trials of the first round, of one with little to decide, and of any other
FALLING_ERROR_RATIO = 0.7  # held-out error over that of the round before; below, trials are missing and not a law

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
            write_whole(self.directory / LOG_FILE, log_of(self.settings, read_rounds(self.directory, self.settings)))
            self._after()
            if ended:
                return read_ending(self.directory)

    def _step(self, rounds: list[Round]) -> bool:
        """Do the first step that has not been done; returns whether it was the last one."""
        last = rounds[-1] if rounds else None
        if last is not None and (done := last.decision) is not None:
            if done.action == "end" and done.spent and self.budget > done.budget:
                (self.directory / ENDING_FILE).unlink(missing_ok=True)
                (last.directory / "decision.json").unlink()  # there are trials again
                return False
            if missing := [name for name in done.models if not (self.directory / name).exists()]:
                self._add(last, missing[0])
                return False
            if done.action == "end":
                write_whole(self.directory / ENDING_FILE, _json(ending_of(self.settings, rounds)))
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
            (last.diagnosis is None, lambda here: self._diagnose(here, here.model, "diagnosis.json")),
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
        here = folder_of(self.directory, number)
        left = self.budget - measured(rounds)
        if rounds and left <= 0:
            self._end(rounds[-1], f"The budget of {self.budget} trials is spent.")
            return
        document = rounds[-1].open if rounds else None
        fresh = bool(rounds) and self._to_be_tried(rounds[-1])
        show = rounds[-1].shown if rounds else ()
        count = min(left, FEW if fresh or show else size_of_round(rounds[-1] if rounds else None))
        self._say(f"Round {number}: design of {count} trials at most, {left} are left")
        wanted = WantedTrials(
            self._model(newest_model(self.settings, rounds) if fresh else self.settings.model),
            rounds,
            None if fresh or show else document,
            count,
            self.settings.seed + number - 1,
            show,
        )
        plan = self._bench.design(wanted)
        if rounds and (promised := best_decision_probability(plan, left)) < MIN_WORTHWHILE_PROBABILITY:
            self._give_up(rounds[-1], promised, left)
        else:
            write_plan(plan, here / "plan.yaml")

    def _give_up(self, last: Round, promised: float, left: int) -> None:
        """End the investigation if the remaining trials cannot decide what is open."""
        why = (
            f"No trial that can be planned here distinguishes the explanations left: all {left} trials left would do "
            f"so with {100.0 * promised:.0f} % at best."
        )
        self._end(last, why)

    def _end(self, last: Round, why: str) -> None:
        """End the investigation undecided, because further trials are not possible or do not help."""
        done = last.decision
        assert done is not None
        reason = f"{done.reason} {why}"
        end = done.model_copy(update={"action": "end", "verdict": UNDECIDED, "reason": reason, "spent": True})
        self._say(f"Round {last.number}: end. {reason}")
        self._write(last, "decision.json", end)

    def _predict(self, here: Round) -> None:
        model = self._model(here.model)
        specs = {label_of(one.trial.spec): one.trial.spec for one in here.trials}
        found = tuple(predicted(model, spec) for spec in specs.values() if spec.scenario.excursion is None)
        self._write(here, "prediction.json", Predictions(model=ModelIdentity.of(model), impacts=found))

    def _check(self, here: Round) -> None:
        assert here.prediction is not None
        against = self._bench.read()
        source, first = against(self._model(here.model)), against(self._model(self.settings.model))
        found = prediction_error(source, self.directory / RUNS / here.folder, here.prediction, first)
        self._write(here, "prediction_error.json", found)

    def _compare(self, here: Round) -> None:
        self._say(f"Round {here.number}: model {here.model} against all trials")
        self._write(here, "compare.json", compare(self._bench.read()(self._model(here.model))))

    def _diagnose_again(self, here: Round) -> None:
        self._diagnose(here, self.settings.model, "again.json", self._model(here.model))

    def _diagnose(self, here: Round, file: str, name: str, earlier: Model | None = None) -> None:
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
        document = document.model_copy(update={"model": ModelIdentity.of(model)})
        self._say(f"Round {here.number}: {name}: {done.add[index]}")
        output = self.directory / name
        save_model(add_effects(model, Path(parent), document, source, [done.add[index]], output, False), output)

    def _to_be_tried(self, here: Round) -> bool:
        """Whether the newest model has not been tried yet: it was made after the round, or no trial of it is usable."""
        made = here.decision is not None and here.decision.action == "add"
        return made or (here.model != self.settings.model and not here.fails(self.settings))

    def _wants_a_law(self, rounds: Sequence[Round]) -> bool:
        """Whether to search for a law: the residual has no known effect, repeatedly or finally."""
        now = rounds[-1].basis
        if now is None or not now.verdict.leaves_residuals or stands(self.settings, rounds[-1]):
            return False
        if searches_in_vain(rounds) >= MAX_VAIN_DISCOVERIES:
            return False
        before = rounds[-2].basis if len(rounds) > 1 else None
        again = before is not None and before.verdict.leaves_residuals and not _falls(before, now)
        return again or bool(laws_found(rounds)) or self.budget <= measured(rounds)

    def _model(self, name: str) -> Model:
        return load_model(name if name == self.settings.model else self.directory / name)

    def _write(self, here: Round, name: str, document: Schema) -> None:
        write_whole(here.directory / name, _json(document))


def size_of_round(last: Round | None) -> int:
    """Trials of the next round, unless it tries a model.

    Few trials between known effects: a diagnosis is cheaper than unnecessary trials. More trials to show that nothing
    is missing, that no effect explains the residual, or which law does.

    Args:
        last: The round before; None: nothing was measured yet.
    """
    if last is None:
        return FIRST
    found = last.open
    named = found is not None and (found.named or found.suspected) and not found.verdict.leaves_residuals
    return FEW if named and last.laws is None else MORE


def _falls(before: DiagnosisDocument, now: DiagnosisDocument) -> bool:
    """Whether the error falls clearly with more trials: then trials are missing, not a law."""
    return bool(now.named) and now.held_out_error_after < FALLING_ERROR_RATIO * before.held_out_error_after


def _json(document: Schema) -> str:
    return json.dumps(document.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"
