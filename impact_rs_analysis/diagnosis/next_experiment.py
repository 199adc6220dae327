# SPDX-License-Identifier: Apache-2.0
"""The next best experiment: where the predictions of two explanations differ most."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from impact_rs_analysis.diagnosis.document import NextExperiment
from impact_rs_analysis.diagnosis.verdicts import Findings
from impact_rs_analysis.evidence.cluster import Added
from impact_rs_analysis.evidence.measured_runs import MeasuredRun, Runs
from impact_rs_analysis.evidence.replay_cache import Replay, with_effects
from impact_rs_analysis.evidence.replays import ReplaySource, layout_of
from impact_rs_analysis.evidence.simulated_trials import simulated
from impact_rs_sim.effects import Effect
from impact_rs_sim.errors import InputError
from impact_rs_sim.robot import Array
from impact_rs_sim.scenario import load_scenario
from impact_rs_trials.runs import label_of
from impact_rs_trials.spec import TrialSpec

COMPANION = "excite"


def next_experiment(found: Findings, known: dict[str, Effect]) -> NextExperiment | None:
    """Experiment for the first pair of confusable effects; None for trials without such a pair."""
    tie = next((rival for rival in found.rivals if rival.tied), None)
    source = found.search.source
    if source.runs is None:
        return _of_recordings(found, known) if source.of_motion else None
    if tie is None or found.chosen is None:
        return None
    assert isinstance(source, ReplaySource)
    first, second = (fit.candidate.split(fit.estimate) for fit in (found.chosen, tie.fit))
    best: tuple[float, MeasuredRun] | None = None
    for run in _possible(source, first):
        pair = source.store([Replay(run.setup, source.model, added) for added in (first, second)], "next experiment")
        if pair[0] is None or pair[1] is None:
            continue
        # Twice the expected log likelihood ratio of one more trial.
        gain = float(np.sum(np.square((pair[0] - pair[1]) / _sigma(source, run))))
        if best is None or gain > best[0]:
            best = (gain, run)
    if best is None:
        return None
    gain, run = best
    measured = run.condition in source.runs.conditions
    what = f"measure {run.condition} more often" if measured else f"measure {run.condition}"
    return NextExperiment(
        splits=(tie.instead_of, tie.name),
        scenario=run.place[0],
        object=run.place[1],
        case=run.place[2],
        expected_information=gain,
        already_measured=measured,
        advice=f"{what}: {tie.instead_of} and {tie.name} differ most there",
    )


def _possible(source: ReplaySource, added: Added) -> list[MeasuredRun]:
    """The measured runs, and every other condition of these scenarios and of free motion, simulated.

    Args:
        source: The measured runs.
        added: Effects in the simulation of trials that were not measured.
    """
    found = [group[0] for group in source.conditions]
    known = set(source.runs.conditions)
    for spec in _specs(source.runs):
        if label_of(spec) in known:
            continue
        with suppress(InputError):  # a pose out of reach or a trial without contact is no proposal
            physics = with_effects(source.model, spec.scene.physics, added)
            found.append(MeasuredRun.of(simulated(spec, physics)))
    return found


def _specs(runs: Runs) -> list[TrialSpec]:
    """All trials of the scenarios of native trials; none of a laboratory's runs, whose controller is unknown."""
    specs = {run.spec.scenario.name: run.spec for run in runs.runs if run.spec is not None}
    if specs and COMPANION not in specs:
        with suppress(InputError):
            scenario = load_scenario(COMPANION)
            specs[COMPANION] = TrialSpec.of(scenario, next(iter(scenario.objects)), next(iter(scenario.cases)))
    return [
        replace(spec, object=object_name, case=case, scale=1.0)
        for spec in specs.values()
        for object_name in spec.scenario.objects
        for case in spec.scenario.cases
    ]


def _sigma(source: ReplaySource, run: MeasuredRun) -> Array:
    """Scale of a run's features: that of measured runs of its layout, else the relevance limits."""
    for item in source.clusters:
        if item.layout == layout_of(run):
            return item.sigma
    return np.array([feature.relevance_limit for feature in run.features])


def _of_recordings(found: Findings, known: dict[str, Effect]) -> NextExperiment:
    """Advice on what to record next, by where the confusable effects act."""
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
        advice="run an impact campaign, because contact and object act on nothing in a free motion",
        splits=tuple(sorted(found.search.unmeasured)),
    )
