"""The next best experiment: where two explanations would predict the most different things."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from impact_rs_analysis.diagnosis.document import NextExperiment
from impact_rs_analysis.diagnosis.verdicts import Findings
from impact_rs_analysis.evidence.recordings import RecordingSource
from impact_rs_analysis.evidence.rollouts import Rollout
from impact_rs_analysis.evidence.runs import Condition, Runs
from impact_rs_analysis.evidence.trials import TrialSource
from impact_rs_sim.effects import Effect
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.spec import TrialSpec

COMPANION = "excite"


def next_experiment(found: Findings, known: dict[str, Effect]) -> NextExperiment | None:
    """What to measure to split the first tie; None when there is none and trials were measured."""
    tie = next((rival for rival in found.rivals if rival.tied), None)
    source = found.search.source
    if isinstance(source, RecordingSource):
        return _of_recordings(found, known)
    if tie is None or found.chosen is None or not isinstance(source, TrialSource):
        return None
    best: tuple[float, Condition] | None = None
    for condition in _possible(source.runs):
        pair = source.store(
            [Rollout(condition, source.model, fit.candidate.split(fit.estimate)) for fit in (found.chosen, tie.fit)],
            "next experiment",
        )
        if pair[0] is None or pair[1] is None:
            continue
        # Twice the expected log likelihood ratio of one more trial.
        gain = float(np.sum(np.square((pair[0] - pair[1]) / _sigma(source, condition))))
        if best is None or gain > best[0]:
            best = (gain, condition)
    if best is None:
        return None
    gain, condition = best
    measured = condition in source.conditions
    what = f"measure {condition.label} more often" if measured else f"measure {condition.label}"
    return NextExperiment(
        splits=(tie.instead_of, tie.name),
        scenario=condition.scenario,
        object=condition.object,
        case=condition.case,
        expected_information=gain,
        already_measured=measured,
        advice=f"{what}: {tie.instead_of} and {tie.name} differ most there",
    )


def _possible(runs: Runs) -> list[Condition]:
    """Every condition of the measured scenarios, and of the free-motion companion."""
    specs = {condition.scenario: condition.spec for condition in runs.conditions}
    if COMPANION not in specs:
        with suppress(InputError):
            scenario = load_scenario(COMPANION)
            specs[COMPANION] = TrialSpec.of(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
    return [
        Condition(replace(spec, object=thing, case=case, scale=1.0))
        for spec in specs.values()
        for thing in spec.scenario.objects
        for case in spec.scenario.cases
    ]


def _sigma(source: TrialSource, condition: Condition) -> Array:
    count = len(condition.features)
    for item in source.clusters:
        if item.sigma.size == count:
            return item.sigma
    return np.array([feature.floor for feature in condition.features])


def _of_recordings(found: Findings, known: dict[str, Effect]) -> NextExperiment:
    """What to record next, in plain words: by where the effects act that are not told apart."""
    tied = {name for rival in found.rivals if rival.tied for name in (rival.name, rival.instead_of)}
    motor = sorted(name for name in tied if known[name].acts_on == "motor side")
    rigid = sorted(name for name in tied if known[name].acts_on != "motor side")
    if len(motor) > 1:
        return NextExperiment(
            advice="record the same motion at a quarter and at twice the speed: friction that does not depend on speed "
            "stays, friction that does changes",
            splits=tuple(motor),
        )
    if len(rigid) > 1:
        return NextExperiment(
            advice="hold still in ten poses far apart, once with a known mass of 0.5 kg to 1 kg on the flange",
            splits=tuple(rigid),
        )
    return NextExperiment(
        advice="run an impact campaign, because motor inertia, contact and object act on nothing in a free motion",
        splits=tuple(sorted(found.search.unmeasured)),
    )
