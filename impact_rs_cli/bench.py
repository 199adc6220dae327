# SPDX-License-Identifier: Apache-2.0
"""Our plant as the bench of an investigation; :mod:`impact_rs_cli.node_benches` has the nodes and a real cell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from impact_rs_analysis.design.design import design, missing_effect
from impact_rs_analysis.design.possible_trials import Envelope
from impact_rs_analysis.diagnosis.next_experiment import considered, left_open
from impact_rs_analysis.diagnosis.search import ProgressCallback
from impact_rs_analysis.evidence.measured_runs import Runs
from impact_rs_analysis.evidence.replay_cache import ReplayCache
from impact_rs_analysis.evidence.replays import ReplaySource
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.investigation.loop import Against
from impact_rs_analysis.investigation.rounds import PlannedTrial, WantedTrials, trials_of
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_cli.measurements import read
from impact_rs_cli.terminal import Terminal
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.blind import RUNS, BlindTask, Secret, run_task
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec
from impact_rs_trials.workers import Map

NO_SECRET = Secret((), None, 0.0, "")


class PlantBench:
    """Our plant in this program.

    Args:
        directory: Folder of the investigation.
        settings: Settings of the investigation.
        map_tasks: Workers.
        terminal: Shows progress and warnings.
        secret: Hidden effect of the plant.
        record: Records a trial; :func:`run_task` on another cell than our plant.
    """

    def __init__(
        self,
        directory: Path,
        settings: Settings,
        map_tasks: Map,
        terminal: Terminal,
        secret: Secret = NO_SECRET,
        record: Callable[[BlindTask], str] = run_task,
    ) -> None:
        self.runs, self.settings, self.secret = directory / RUNS, settings, secret
        self._record = record
        self.map_tasks, self.terminal = map_tasks, terminal
        self._store = ReplayCache(map_tasks)
        self._known: tuple[int, Runs, dict[str, Source]] | None = None

    @property
    def rank(self) -> ProgressCallback:
        """Shows explanations with their error while a search runs."""
        return self.terminal.rank

    def measure(self, trials: Sequence[PlannedTrial]) -> None:
        """Record trials on the plant."""
        self.runs.mkdir(parents=True, exist_ok=True)
        runs, secret = str(self.runs.absolute()), self.secret
        tasks = [
            BlindTask(runs, one.trial, secret.hidden, secret.outside, secret.strength, one.folder) for one in trials
        ]
        with self.terminal.progress("trials") as report:
            for count, (one, outcome) in enumerate(
                zip(trials, self.map_tasks(self._record, tasks), strict=True), start=1
            ):
                if outcome != "OK":
                    self.terminal.warn(f"{one.path}: {outcome}")
                report(count, len(tasks))

    def read(self) -> Against:
        """All trials against a model; bags are read again only if there are more."""
        runs = self._runs()
        assert self._known is not None
        sources = self._known[2]

        def against(model: Model) -> Source:
            key = f"{model.digest} {[spec.name for spec in model.formulas]}"
            if key not in sources:
                sources[key] = ReplaySource.of(runs, model, self._store)
            return sources[key]

        return against

    def _runs(self) -> Runs:
        count = sum(1 for _ in self.runs.rglob("metadata.yaml"))
        if self._known is None or self._known[0] != count:
            self._known = count, self.measured_runs(), {}
        return self._known[1]

    def measured_runs(self) -> Runs:
        """All trials."""
        return read(self.runs, self.map_tasks, self.terminal)

    def design(self, wanted: WantedTrials) -> ExperimentPlan:
        """The most decisive trials for the open question; by rule if no plan is possible."""
        limits = Envelope(cell=self.settings.envelope)
        try:
            decide, known = None, wanted.model
            if (document := wanted.document) is not None:
                decide, known = left_open(document, known), considered(document, known)
            if decide is None:
                effects = wanted.show or self.settings.effects
                decide = missing_effect(effects, whether_any=bool(wanted.done) and document is None)
            runs = self._runs() if wanted.done else None
            with self.terminal.stages() as stage:
                plan = design(
                    known,
                    self.settings.scenarios,
                    wanted.budget,
                    self.map_tasks,
                    decide,
                    runs,
                    envelope=limits,
                    seed=wanted.seed,
                    progress=stage,
                )
            self.check(plan)
            return plan
        except InputError as error:
            self.terminal.warn(f"trials by rule instead of by design: {error}")
            return simple_design(self.settings, wanted)

    def check(self, plan: ExperimentPlan) -> None:
        """Refuse a plan that leaves the envelope.

        Raises:
            InputError: It does.
        """
        if self.settings.envelope is not None:
            for one in trials_of(plan, ""):
                self.settings.envelope.check(one.trial.spec)


def simple_design(settings: Settings, wanted: WantedTrials) -> ExperimentPlan:
    """Trials by rule: two repeats of a few conditions, then the trials that the diagnosis needs, else new conditions.

    Args:
        settings: Settings of the investigation.
        wanted: Purpose of the trials; without a document: the first ones, or a test of a new model.
    """
    measured = Counter(label_of(one.trial.spec) for here in wanted.done for one in here.trials)
    often: dict[tuple[str, str, str], int] = {}
    for name in settings.scenarios:
        scenario = load_scenario(name)
        objects = list(scenario.objects) if scenario.excursion is None else list(scenario.objects)[:1]
        for case in scenario.cases:
            for item in objects:
                spec = TrialSpec.of(scenario, item, case)
                if settings.envelope is None or not settings.envelope.complaint(spec):
                    often[name, item, case] = measured[label_of(spec)]
    if not often:
        raise InputError("no condition of these scenarios lies inside the envelope; expected limits that allow some")
    hits = [place for place in often if load_scenario(place[0]).excursion is None]
    free = [place for place in often if place not in hits]
    chosen: dict[tuple[str, str, str], int] = {}
    if not wanted.done:
        corners = [*hits[:1], *[place for place in reversed(hits) if place[1] != hits[0][1]][:1], *hits[-1:]]
        conditions = list(dict.fromkeys([*corners[:2], *free[:2], *hits]))[: max(3, wanted.budget // 2)][:4]
        for place in conditions:
            chosen[place] = 2
        reason = "Two objects and free motion, to find where the model fails."
    else:
        experiment = None if wanted.document is None else wanted.document.next_experiment
        asked = [
            place
            for place in often
            if experiment is not None
            and (load_scenario(place[0]).name, *place[1:]) == (experiment.scenario, experiment.object, experiment.case)
        ]
        if experiment is not None and asked:
            chosen[asked[0]] = wanted.budget
            reason = f"{experiment.advice[:1].upper()}{experiment.advice[1:]}."
        else:
            fewest = sorted(hits or free, key=lambda place: often[place])
            for place in fewest[: wanted.budget]:
                chosen[place] = 1
            reason = "Conditions that were measured least."
    folders: dict[str, list[PlannedTrials]] = {}
    for (name, item, case), count in chosen.items():
        folders.setdefault(name, []).append(PlannedTrials(object=item, case=case, trials=count))
    return ExperimentPlan(
        model=wanted.model.name,
        model_digest=wanted.model.digest,
        aim="effects",
        method="fixed",
        budget=wanted.budget,
        seed=wanted.seed,
        summary=reason,
        campaigns=tuple(
            PlannedCampaign(folder=Path(name).stem, scenario=name, conditions=tuple(conditions))
            for name, conditions in folders.items()
        ),
    )
