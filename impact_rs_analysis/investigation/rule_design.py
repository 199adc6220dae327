# SPDX-License-Identifier: Apache-2.0
"""Trials by rule, for when no plan by expected decisions is possible."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from impact_rs_analysis.investigation.rounds import WantedTrials
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_sim.errors import InputError
from impact_rs_sim.scenarios.scenario_files import load_scenario
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec


def rule_design(settings: Settings, wanted: WantedTrials) -> ExperimentPlan:
    """Trials by rule: two repeats of a few conditions, then the advice of the diagnosis, or else rare conditions.

    Args:
        settings: Settings of the investigation.
        wanted: Purpose of the trials; without a document: the first trials, or a test of a new model.
    """
    measured_trials = Counter(label_of(planned.trial.spec) for round_ in wanted.done for planned in round_.trials)
    repeats: dict[tuple[str, str, str], int] = {}
    for name in settings.scenarios:
        scenario = load_scenario(name)
        objects = list(scenario.objects) if scenario.excursion is None else list(scenario.objects)[:1]
        for case in scenario.cases:
            for object_name in objects:
                spec = TrialSpec.of(scenario, object_name, case)
                if settings.envelope is None or not settings.envelope.complaint(spec):
                    repeats[name, object_name, case] = measured_trials[label_of(spec)]
    if not repeats:
        raise InputError("no condition of these scenarios lies inside the envelope; expected wider limits")
    hits = [condition for condition in repeats if load_scenario(condition[0]).excursion is None]
    free = [condition for condition in repeats if condition not in hits]
    chosen: dict[tuple[str, str, str], int] = {}
    if not wanted.done:
        contrasting = [
            *hits[:1],
            *[condition for condition in reversed(hits) if condition[1] != hits[0][1]][:1],
            *hits[-1:],
        ]
        first_conditions = list(dict.fromkeys([*contrasting[:2], *free[:2], *hits]))
        for condition in first_conditions[: max(1, min(4, wanted.budget // 2))]:
            chosen[condition] = min(2, wanted.budget)
        reason = "Two objects and free motion, to find where the model fails."
    else:
        experiment = None if wanted.document is None else wanted.document.next_experiment
        advised = [
            condition
            for condition in repeats
            if experiment is not None
            and (load_scenario(condition[0]).name, *condition[1:])
            == (experiment.scenario, experiment.object, experiment.case)
        ]
        if experiment is not None and advised:
            chosen[advised[0]] = wanted.budget
            reason = f"{experiment.advice[:1].upper()}{experiment.advice[1:]}."
        else:
            least_measured = sorted(hits or free, key=lambda condition: repeats[condition])
            for condition in least_measured[: wanted.budget]:
                chosen[condition] = 1
            reason = "Conditions that were measured least."
    folders: dict[str, list[PlannedTrials]] = {}
    for (name, object_name, case), count in chosen.items():
        folders.setdefault(name, []).append(PlannedTrials(object=object_name, case=case, trials=count))
    return ExperimentPlan(
        model=wanted.model.name,
        model_digest=wanted.model.digest,
        aim="effects",
        method="fixed",
        budget=wanted.budget,
        seed=wanted.seed,
        summary=reason,
        campaigns=tuple(
            PlannedCampaign(folder=Path(name).stem, scenario=name, conditions=tuple(planned))
            for name, planned in folders.items()
        ),
    )
