# SPDX-License-Identifier: Apache-2.0
"""The simulated plant as the bench of an investigation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from impact_rs_analysis.application.measurements import read_trials
from impact_rs_analysis.application.observer import Observer
from impact_rs_analysis.design.design import design, missing_effect
from impact_rs_analysis.design.possible_trials import Envelope
from impact_rs_analysis.diagnosis.search.effect_selection import ProgressCallback
from impact_rs_analysis.diagnosis.verdicts.next_experiment import considered, left_open
from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_analysis.investigation.loop import Against
from impact_rs_analysis.investigation.rounds import PlannedTrial, WantedTrials, trials_of
from impact_rs_analysis.investigation.rule_design import rule_design
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_trials.blind import RUNS, BlindTask, Secret, run_task
from impact_rs_trials.experiment_plan import ExperimentPlan
from impact_rs_trials.file_names import BAG_METADATA
from impact_rs_trials.workers import Map

NO_SECRET = Secret((), None, 0.0, "")


class PlantBench:
    """The simulated plant in this process.

    Args:
        directory: Folder of the investigation.
        settings: Settings of the investigation.
        map_tasks: Workers.
        observer: Shows progress and warnings.
        secret: Hidden effect of the plant.
        record: Records a trial; by default :func:`run_task` on the plant.
    """

    def __init__(
        self,
        directory: Path,
        settings: Settings,
        map_tasks: Map,
        observer: Observer,
        secret: Secret = NO_SECRET,
        record: Callable[[BlindTask], str] = run_task,
    ) -> None:
        self.runs, self.settings, self.secret = directory / RUNS, settings, secret
        self._record = record
        self.map_tasks, self.observer = map_tasks, observer
        self._cache = ReplayCache(map_tasks)
        self._read: tuple[int, Runs, dict[str, Source]] | None = None

    @property
    def rank(self) -> ProgressCallback:
        """Shows explanations with their error while a search runs."""
        return self.observer.rank

    def measure(self, trials: Sequence[PlannedTrial]) -> None:
        """Record trials on the plant."""
        self.runs.mkdir(parents=True, exist_ok=True)
        runs, secret = str(self.runs.absolute()), self.secret
        tasks = [
            BlindTask(runs, planned.trial, secret.hidden, secret.outside, secret.strength, planned.folder)
            for planned in trials
        ]
        with self.observer.progress("trials") as report:
            for count, (planned, outcome) in enumerate(
                zip(trials, self.map_tasks(self._record, tasks), strict=True), start=1
            ):
                if outcome != "OK":
                    self.observer.warn(f"{planned.path}: {outcome}")
                report(count, len(tasks))

    def read(self) -> Against:
        """All trials against a model; bags are read again only if new ones exist."""
        runs = self._runs()
        assert self._read is not None
        sources = self._read[2]

        def against(model: Model) -> Source:
            key = f"{model.digest} {[spec.name for spec in model.formulas]}"
            if key not in sources:
                sources[key] = ReplaySource.of(runs, model, self._cache)
            return sources[key]

        return against

    def _runs(self) -> Runs:
        count = sum(1 for _ in self.runs.rglob(BAG_METADATA))
        if self._read is None or self._read[0] != count:
            self._read = count, self.measured_runs(), {}
        return self._read[1]

    def measured_runs(self) -> Runs:
        """All trials."""
        return read_trials(self.runs, self.map_tasks, self.observer)

    def design(self, wanted: WantedTrials) -> ExperimentPlan:
        """The most decisive trials for the open question; trials by rule if no plan is possible."""
        envelope = Envelope(cell=self.settings.envelope)
        try:
            decision, model = None, wanted.model
            if (document := wanted.document) is not None:
                decision, model = left_open(document, model), considered(document, model)
            if decision is None:
                effects = wanted.show or self.settings.effects
                decision = missing_effect(effects, whether_any=bool(wanted.done) and document is None)
            runs = self._runs() if wanted.done else None
            with self.observer.stages() as stage:
                plan = design(
                    model,
                    self.settings.scenarios,
                    wanted.budget,
                    self.map_tasks,
                    decision,
                    runs,
                    envelope=envelope,
                    seed=wanted.seed,
                    progress=stage,
                )
            self.check(plan)
            return plan
        except InputError as error:
            self.observer.warn(f"trials by rule instead of by design: {error}")
            return rule_design(self.settings, wanted)

    def check(self, plan: ExperimentPlan) -> None:
        """Refuse a plan that leaves the envelope.

        Raises:
            InputError: A trial is outside the envelope.
        """
        if self.settings.envelope is not None:
            for planned in trials_of(plan, ""):
                self.settings.envelope.check(planned.trial.spec)
