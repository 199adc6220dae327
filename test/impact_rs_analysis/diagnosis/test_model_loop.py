# SPDX-License-Identifier: Apache-2.0
"""From a diagnosis to a better model, and back through its versions."""

import json
import os
from pathlib import Path

import pytest

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.document import DependenceDocument, DiagnosisDocument, read_document
from impact_rs_analysis.diagnosis.history import versions
from impact_rs_analysis.diagnosis.scoring import Score, score
from impact_rs_analysis.diagnosis.verdict import NOTHING, DiagnosisVerdict
from impact_rs_sim.effects import library
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, load_model, save_model
from impact_rs_sim.numbers import rounded_interval

MORE_FRICTION = 0.18


@pytest.fixture(scope="module")
def document(diagnosed: Path) -> DiagnosisDocument:
    return read_document(diagnosed)


def _only(name: str) -> str:
    """The parameter of an effect that has one."""
    (parameter,) = library()[name].parameters
    return parameter.name


def blind(directory: Path, runs: Path, kind: str, **sizes: float) -> Path:
    """A blind campaign of these runs, whose truth is said to be these sizes of effects."""
    directory.mkdir()
    (directory / "runs").symlink_to(runs)
    hidden = [
        {"name": name, "parameters": {_only(name): {"value": value, "unit": "-"}}} for name, value in sizes.items()
    ]
    (directory / "truth.json").write_text(json.dumps({"kind": kind, "outside": None, "effects": hidden}))
    return directory


def add(
    document: DiagnosisDocument, diagnosed: Path, file: Path, model: Model | None = None, force: bool = False
) -> Model:
    """The first effect of the diagnosis added to the nominal model, or to another one."""
    of = (model or load_model("nominal"), Path("nominal") if model is None else file)
    return add_effects(*of, document, diagnosed, [document.effects[0].name], file, force)


def test_the_document_has_its_schema(diagnosed: Path) -> None:
    document = json.loads(diagnosed.read_text())
    assert {"verdict", "effects", "confusable", "unexplained", "next_experiment"} <= set(document)
    assert {"model", "runs", "lack_of_fit", "remarks", "noise_floor"} <= set(document)
    for effect in document["effects"]:
        assert {"name", "verdict", "parameters", "held_out_error_before", "held_out_error_after", "p_value"} <= set(
            effect
        )
        for value in effect["parameters"].values():
            assert len(value["ci95"]) == 2 and value["unit"]


def test_the_hidden_friction_is_named_and_estimated(document: DiagnosisDocument) -> None:
    assert document.named == ("support_friction",)
    found = document.effects[0]
    assert found.held_out_error_after < 0.5 * found.held_out_error_before
    assert found.parameters["friction"].estimate == pytest.approx(MORE_FRICTION, abs=0.02)


def test_adding_an_effect_names_the_parent_and_keeps_the_interval(
    document: DiagnosisDocument, diagnosed: Path, tmp_path: Path
) -> None:
    child_file = tmp_path / "models" / "model_2.yaml"
    child = add(document, diagnosed, child_file)
    save_model(child, child_file)
    read = load_model(child_file)
    assert read == child
    assert read.parent_digest == load_model("nominal").digest
    value, said = read.effects[0].parameters["friction"], document.effects[0].parameters["friction"]
    assert (value.estimate, value.ci95) == (said.estimate, rounded_interval(said.ci95))
    chain = versions(child_file)
    assert [entry.effect_added for entry in chain] == [None, "support_friction"]


def test_a_diagnosis_of_another_model_version_is_refused(
    document: DiagnosisDocument, diagnosed: Path, tmp_path: Path
) -> None:
    child = add(document, diagnosed, tmp_path / "model_2.yaml")
    with pytest.raises(InputError, match=f"digest {document.model.digest}.*not of 'model_2'"):
        add(document, diagnosed, tmp_path / "model_3.yaml", child)


@pytest.mark.parametrize(
    ("verdict", "force", "message"),
    [
        ("NO-IMPROVEMENT", False, "--force"),
        ("NOT-IDENTIFIABLE", True, "NOT-IDENTIFIABLE"),
        ("NO-IMPROVEMENT", True, None),
    ],
)
def test_an_effect_the_diagnosis_advises_against(
    document: DiagnosisDocument, diagnosed: Path, tmp_path: Path, verdict: str, force: bool, message: str | None
) -> None:
    other = document.effects[0].model_copy(update={"verdict": DiagnosisVerdict.parse(verdict)})
    changed = document.model_copy(update={"effects": (other,)})
    if message is None:
        assert add(changed, diagnosed, tmp_path / "m.yaml", force=force).effects[0].name == other.name
    else:
        with pytest.raises(InputError, match=message):
            add(changed, diagnosed, tmp_path / "m.yaml", force=force)


def test_an_effect_that_depends_on_a_covariate_is_added_as_its_mean_only_by_force(
    document: DiagnosisDocument, diagnosed: Path, tmp_path: Path
) -> None:
    """Kills ``if depends and not force`` without either half."""
    effect = document.effects[0]
    one = DependenceDocument(
        effect=effect.name, covariate="session", verdict="CONFIRMED", p_value=0.001, levels={"A": {}, "B": {}}
    )
    depending = document.model_copy(update={"dependences": (one,)})
    with pytest.raises(InputError, match=f"{effect.name} depends on session, and a model has one value for all"):
        add(depending, diagnosed, tmp_path / "m.yaml")
    assert "depends on session, the mean was taken" in add(depending, diagnosed, tmp_path / "m.yaml", force=True).note
    elsewhere = document.model_copy(update={"dependences": (one.model_copy(update={"effect": "another"}),)})
    assert "depends" not in add(elsewhere, diagnosed, tmp_path / "m.yaml").note


def test_a_parent_that_was_changed_since_is_refused(tmp_path: Path) -> None:
    (tmp_path / "parent.yaml").write_text("name: parent\neffects: []\n")
    (tmp_path / "child.yaml").write_text("name: child\nparent: parent.yaml\nparent_digest: abc\neffects: []\n")
    with pytest.raises(InputError, match="was changed after"):
        versions(tmp_path / "child.yaml")
    (tmp_path / "own.yaml").write_text("name: own\nparent: own.yaml\neffects: []\n")
    with pytest.raises(InputError, match="its own ancestor"):
        versions(tmp_path / "own.yaml")


def test_scores_of_blind_campaigns(
    document: DiagnosisDocument, diagnosed: Path, hidden_campaign: Path, tmp_path: Path
) -> None:
    def scored(kind: str, found: DiagnosisDocument = document, **scales: float) -> Score:
        folder = tmp_path / f"{kind}_{len(os.listdir(tmp_path))}"
        return score(blind(folder, hidden_campaign, kind, **scales), found, diagnosed)

    right = scored("single", support_friction=MORE_FRICTION)
    assert right.correct and right.by_own_name and right.also_named == ()
    wrong = scored("single", motor_inertia_scale=1.2)
    assert not wrong.correct and wrong.also_named == ("support_friction",) and wrong.intervals_cover is None
    assert not scored("pair", support_friction=MORE_FRICTION, object_mass=1.1).correct
    assert not scored("null").correct
    assert scored("null", document.model_copy(update={"verdict": NOTHING, "named": ()})).correct


def test_a_diagnosis_of_another_campaign_is_refused(
    document: DiagnosisDocument, diagnosed: Path, push_campaign: Path, tmp_path: Path
) -> None:
    other = blind(tmp_path / "other", push_campaign, "single", support_friction=MORE_FRICTION)
    with pytest.raises(InputError, match="other runs"):
        score(other, document, diagnosed)
