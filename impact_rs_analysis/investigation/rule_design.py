# SPDX-License-Identifier: Apache-2.0
"""Trials by rule, if no plan by expected decisions is possible."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from impact_rs_analysis.investigation.rounds import WantedTrials
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario import load_scenario
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec


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
