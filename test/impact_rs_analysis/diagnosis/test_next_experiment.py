# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis leaves open, as the decision of a plan."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scene_source import of_scene

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, EstimateDocument, read_document
from impact_rs_analysis.diagnosis.search.candidate import Candidate
from impact_rs_analysis.diagnosis.verdicts.model_verdict import Findings
from impact_rs_analysis.diagnosis.verdicts.next_experiment import considered, left_open, next_experiment
from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_analysis.evidence.replays.replay_cache import ReplayCache
from impact_rs_analysis.evidence.sources.run_source import ReplaySource
from impact_rs_sim.effects import library
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, ModelEffect, ParameterValue, load_model
from impact_rs_sim.numbers import NORMAL_95
from impact_rs_sim.physics import Physics
from impact_rs_sim.scenarios.scenario_files import load_scenario


@pytest.fixture(scope="module")
def document(diagnosed: Path) -> DiagnosisDocument:
    """The diagnosis of a support that is rougher than stated."""
    return read_document(diagnosed)


@pytest.fixture(scope="module")
def world() -> Physics:
    return Physics.nominal(load_scenario("push"), "juice")


def tied(document: DiagnosisDocument) -> DiagnosisDocument:
    """The same with an effect that explains it as well."""
    own = document.effects[0].model_copy(update={"rivals": ("object_mass",)})
    rival = EffectDocument(
        name="object_mass",
        verdict=f"CONFUSABLE-WITH{{{own.name}}}",
        rivals=(own.name,),
        parameters={"scale": EstimateDocument(estimate=1.3, ci95=(1.1, 1.5), unit="-", nominal=1.0)},
        held_out_error_before=2.0,
        held_out_error_after=1.0,
        p_value=0.001,
    )
    return document.model_copy(update={"effects": (own, rival)})


def test_a_tie_leaves_open_which_of_both_is_there(document: DiagnosisDocument, world: Physics) -> None:
    decide = left_open(tied(document), load_model("nominal"))
    assert decide is not None
    decision = decide(of_scene(load_model("nominal"), world))
    assert decision.aim == "rivals"
    assert decision.pairs == ((0, 1),)
    first, second = decision.explanations
    found = document.effects[0]
    (parameter,) = found.parameters.values()
    assert first.centre == ((found.name, (parameter.estimate,)),)
    assert second.centre == (("object_mass", (1.3,)),)
    ((_, (moved,)),) = second.varied[0]
    assert moved - 1.3 == pytest.approx(0.2 / NORMAL_95)


def test_the_next_experiment_after_a_tie_in_contact_is_a_push(hidden_campaign: Path) -> None:
    """Friction of the support against mass of the object: free motion, which was measured as well, shows neither."""
    source = ReplaySource.of(read_runs(hidden_campaign, map), load_model("nominal"), ReplayCache(map))

    def fit(name: str, value: float) -> SimpleNamespace:
        candidate = Candidate.of((library()[name],), source)
        return SimpleNamespace(candidate=candidate, estimate=np.array([value]))

    rival = SimpleNamespace(name="object_mass", instead_of="support_friction", fit=fit("object_mass", 1.2), tied=True)
    found = cast(
        Findings,
        SimpleNamespace(rivals=(rival,), chosen=fit("support_friction", 0.1), search=SimpleNamespace(source=source)),
    )
    proposed = next_experiment(found, source.model.known_effects)
    assert proposed is not None
    assert proposed.splits == ("support_friction", "object_mass")
    assert proposed.scenario == "push"
    assert proposed.expected_information is not None and proposed.expected_information > 1.0
    measured = f"push/{proposed.object}/{proposed.case}" in source.runs.conditions
    assert proposed.already_measured == measured
    assert ("more often" in proposed.advice) == measured


def test_without_a_tie_the_size_is_open(document: DiagnosisDocument, world: Physics) -> None:
    decide = left_open(document, load_model("nominal"))
    assert decide is not None
    decision = decide(of_scene(load_model("nominal"), world))
    assert decision.aim == "parameters"
    assert decision.explanations[0].effects == set(document.named)
    assert len(decision.explanations[0].varied) == 1


def test_an_unknown_interval_is_as_wide_as_the_prior_and_not_infinite(
    document: DiagnosisDocument, world: Physics
) -> None:
    rival = tied(document).effects[1]
    unknown = {"scale": rival.parameters["scale"].model_copy(update={"ci95": None})}
    open_ended = tied(document).model_copy(
        update={"effects": (tied(document).effects[0], rival.model_copy(update={"parameters": unknown}))}
    )
    decide = left_open(open_ended, load_model("nominal"))
    assert decide is not None
    ((_, (moved,)),) = decide(of_scene(load_model("nominal"), world)).explanations[1].varied[0]
    assert np.isfinite(moved) and moved != 1.3


def test_without_a_named_effect_everything_is_open(document: DiagnosisDocument) -> None:
    assert left_open(document.model_copy(update={"named": ()}), load_model("nominal")) is None


def test_a_suspicion_leaves_open_whether_the_effect_is_there(document: DiagnosisDocument, world: Physics) -> None:
    suspicion = document.model_copy(update={"named": (), "suspected": document.named})
    decide = left_open(suspicion, load_model("nominal"))
    assert decide is not None
    decision = decide(of_scene(load_model("nominal"), world))
    assert (decision.aim, decision.pairs) == ("rivals", ((0, 1),))
    without, suspected = decision.explanations
    assert without.centre == () and suspected.effects == set(document.named)


def test_a_suspicion_beside_an_effect_is_tried_beside_it(document: DiagnosisDocument, world: Physics) -> None:
    decide = left_open(tied(document).model_copy(update={"suspected": ("object_mass",)}), load_model("nominal"))
    assert decide is not None
    *_, beside = decide(of_scene(load_model("nominal"), world)).explanations
    assert [name for name, _ in beside.centre] == [*document.named, "object_mass"]


def test_a_formula_of_the_diagnosis_can_be_decided_on(document: DiagnosisDocument, world: Physics) -> None:
    """Laws of a discovery and effects of --formulas are in the document and not in the model."""
    drag = FormulaSpec.model_validate(
        {
            "name": "drag",
            "sentence": "Drag.",
            "end_effector_force": {"y": "-c * vy"},
            "parameters": {"c": {"unit": "N s/m", "nominal": 0.0, "lower": 0.0, "upper": 50.0, "scale": 1.0}},
        }
    )
    law = document.effects[0].model_copy(
        update={
            "name": "drag",
            "rivals": ("object_mass",),
            "parameters": {"c": EstimateDocument(estimate=5.0, ci95=(4.0, 6.0), unit="N s/m", nominal=0.0)},
        }
    )
    found = tied(document).model_copy(
        update={"named": ("drag",), "effects": (law, tied(document).effects[1]), "formulas": (drag,)}
    )
    model = load_model("nominal")
    decide = left_open(found, model)
    assert decide is not None
    first, second = decide(of_scene(considered(found, model), world)).explanations
    assert first.centre == (("drag", (5.0,)),) and second.centre == (("object_mass", (1.3,)),)
    assert considered(found, model).containing(()).digest == model.digest


def test_a_diagnosis_of_another_model_is_refused(document: DiagnosisDocument) -> None:
    item = ModelEffect(name="object_mass", parameters={"scale": ParameterValue(estimate=1.2, unit="-")})
    other: Model = load_model("nominal").with_effect(item, "heavier", "nominal.yaml")
    with pytest.raises(InputError, match="diagnosis of model 'nominal', not of 'heavier'"):
        left_open(document, other)
