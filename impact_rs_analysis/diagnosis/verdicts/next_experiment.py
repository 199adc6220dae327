# SPDX-License-Identifier: Apache-2.0
"""The next experiment: the most informative trial for the open questions of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from impact_rs_analysis.design.design import Decide
from impact_rs_analysis.design.discrimination import RIVAL_RANGE_SCALES, Discrimination
from impact_rs_analysis.design.explanations import AS_IS, Decision, Explanation, estimated
from impact_rs_analysis.design.forecast import forecast_of
from impact_rs_analysis.design.possible_trials import PossibleTrial, trials_of
from impact_rs_analysis.design.selection import most_informative
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, NextExperiment
from impact_rs_analysis.diagnosis.verdicts.model_verdict import Findings
from impact_rs_analysis.evidence.replays.measured_runs import Runs
from impact_rs_analysis.evidence.source import Source
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.effects import Effect
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.scenarios.scenario_files import load_scenario

FREE_MOTION_SCENARIO = "excite"


def next_experiment(findings: Findings, effects_by_name: dict[str, Effect]) -> NextExperiment | None:
    """Experiment that discriminates the first pair of tied effects; None for trials without such a pair."""
    tie = next((rival for rival in findings.rivals if rival.tied), None)
    source = findings.search.source
    if source.runs is None:
        return _of_recordings(findings, effects_by_name) if source.of_motion else None
    if tie is None or findings.chosen is None:
        return None
    assert isinstance(source, ReplaySource)
    explanations = [
        Explanation(name, fit.candidate.effects_at(fit.estimate))
        for name, fit in ((tie.instead_of, findings.chosen), (tie.name, tie.fit))
    ]
    decision = Decision.between(explanations, "rivals")
    trials = forecast_of(source.model, _own_trials(source.runs), source.store, runs=source.runs).under(decision)
    best = most_informative(Discrimination(decision, trials), trials)
    if best is None:
        return None
    trial, gain = best
    scenario, item, case = trial.cluster.condition_key
    action = f"measure {trial.name} more often" if trial.repeats else f"measure {trial.name}"
    return NextExperiment(
        splits=(tie.instead_of, tie.name),
        scenario=scenario,
        object=item,
        case=case,
        expected_information=gain,
        already_measured=bool(trial.repeats),
        advice=f"{action}: {tie.instead_of} and {tie.name} differ most there",
    )


def left_open(document: DiagnosisDocument, model: Model) -> Decide | None:
    """The decision that a diagnosis leaves open, for a plan of trials with the model of :func:`considered`.

    Ties: which of the rivals is present, each with the other effects found. Suspicions: whether each suspected effect
    is present in addition to the effects found. Without either: the parameters of the effects found. Without effects:
    which effect is missing (None).

    Args:
        document: The diagnosis.
        model: The diagnosed model.

    Raises:
        InputError: The diagnosis is of another model.
    """
    if document.model.digest != model.digest:
        raise InputError(
            f"this is a diagnosis of model {document.model.name!r}, not of {model.name!r}; give the diagnosed model"
        )
    effects_of = {effect.name: effect for effect in document.effects if effect.parameters}
    ties = dict.fromkeys(
        (name, rival) for name in document.named for rival in effects_of[name].rivals if rival in effects_of
    )
    alternatives = [
        tuple(dict.fromkeys(rival if named == name else named for named in document.named)) for name, rival in ties
    ]
    alternatives += [(*document.named, name) for name in document.suspected if name in effects_of]
    if not document.named and not alternatives:
        return None

    def decide(source: Source) -> Decision:
        effects = source.known_effects

        def explanation(names: Sequence[str]) -> Explanation:
            centre: list[tuple[str, tuple[float, ...]]] = []
            deviations, bounds = {}, {}
            for effect_name in names:
                scalars = effects[effect_name].scalars(source.joints)
                values = effects_of[effect_name].parameters
                centre.append((effect_name, tuple(values[scalar.name].estimate for scalar in scalars)))
                widths = [np.diff(values[scalar.name].interval)[0] / (2.0 * NORMAL_95) for scalar in scalars]
                deviations[effect_name] = np.minimum(widths, [RIVAL_RANGE_SCALES * scalar.scale for scalar in scalars])
                bounds[effect_name] = effects[effect_name].bounds_in(source.worlds)
            return estimated("+".join(names) or AS_IS, tuple(centre), deviations, bounds)

        of_named = explanation(document.named)
        if not alternatives:
            return Decision("parameters", (of_named,))
        pairs = tuple((0, number) for number in range(1, 1 + len(alternatives)))
        return Decision("rivals", (of_named, *map(explanation, alternatives)), pairs)

    return decide


def considered(document: DiagnosisDocument, model: Model) -> Model:
    """The diagnosed model with the effects that a diagnosis considered in addition to the library, not switched on.

    These are user-defined effects, laws of a discovery, and separate parameters of each arm.

    Args:
        document: The diagnosis.
        model: The diagnosed model.
    """
    formulas = {spec.name: spec for spec in (*model.formulas, *document.formulas)}
    return model.model_copy(update={"formulas": tuple(formulas.values()), "arms": document.arms or model.arms})


def _own_trials(runs: Runs) -> list[PossibleTrial]:
    """All trials of the scenarios of native runs, and of free motion; none for runs of other controllers."""
    scenarios = {run.spec.scenario.name: run.spec.scenario for run in runs.runs if run.spec is not None}
    if scenarios and FREE_MOTION_SCENARIO not in scenarios:
        with suppress(InputError):
            scenarios[FREE_MOTION_SCENARIO] = load_scenario(FREE_MOTION_SCENARIO)
    return [trial for name, scenario in scenarios.items() for trial in trials_of(name, scenario) if trial.of_file]


def _of_recordings(findings: Findings, effects_by_name: dict[str, Effect]) -> NextExperiment:
    """Advice on what to record next, by where the confusable effects act."""
    tied = {name for rival in findings.rivals if rival.tied for name in (rival.name, rival.instead_of)}
    motor = sorted(name for name in tied if effects_by_name[name].acts_on == "motor side")
    rigid = sorted(name for name in tied if name not in motor and not effects_by_name[name].of_measurement)
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
        splits=tuple(sorted(findings.search.screening.unmeasured)),
    )
