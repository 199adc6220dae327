# SPDX-License-Identifier: Apache-2.0
"""From a diagnosis to a better model, and back through its versions."""

import json
from pathlib import Path

import pytest

from impact_rs_analysis.diagnosis.add import add_effect
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, read_document
from impact_rs_analysis.diagnosis.history import versions
from impact_rs_analysis.diagnosis.scoring import score
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model, save_model

TRUE_SCALE = 1.6


@pytest.fixture(scope="module")
def document(diagnosed: Path) -> DiagnosisDocument:
    return read_document(diagnosed)


def _truth(directory: Path, hidden_campaign: Path, kind: str, effects: dict[str, float]) -> Path:
    directory.mkdir()
    (directory / "runs").symlink_to(hidden_campaign)
    content = {
        "kind": kind,
        "outside": None,
        "effects": [
            {"name": name, "parameters": {"scale": {"value": value, "unit": "-"}}} for name, value in effects.items()
        ],
    }
    (directory / "truth.json").write_text(json.dumps(content))
    return directory


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
    assert found.parameters["scale"].estimate == pytest.approx(TRUE_SCALE, rel=0.1)


def test_adding_an_effect_names_the_parent_and_keeps_the_interval(
    document: DiagnosisDocument, diagnosed: Path, tmp_path: Path
) -> None:
    child_file = tmp_path / "models" / "model_2.yaml"
    nominal = load_model("nominal")
    child = add_effect(nominal, Path("nominal"), document, diagnosed, "support_friction", child_file, False)
    save_model(child, child_file)
    read = load_model(child_file)
    assert read == child
    assert read.parent_digest == nominal.digest
    value, said = read.effects[0].parameters["scale"], document.effects[0].parameters["scale"]
    assert (value.estimate, value.ci95) == (said.estimate, said.ci95)
    chain = versions(child_file)
    assert [entry.effect_added for entry in chain] == [None, "support_friction"]


def test_a_diagnosis_of_another_model_version_is_refused(
    document: DiagnosisDocument, diagnosed: Path, tmp_path: Path
) -> None:
    child_file = tmp_path / "model_2.yaml"
    child = add_effect(
        load_model("nominal"), Path("nominal"), document, diagnosed, "support_friction", child_file, False
    )
    with pytest.raises(InputError, match=f"digest {document.model.digest}.*not of 'model_2'"):
        add_effect(child, child_file, document, diagnosed, "support_friction", tmp_path / "model_3.yaml", False)


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
    other = document.effects[0].model_copy(update={"verdict": verdict})
    changed = document.model_copy(update={"effects": (other,)})
    arguments = (load_model("nominal"), Path("nominal"), changed, diagnosed, other.name, tmp_path / "m.yaml", force)
    if message is None:
        assert add_effect(*arguments).effects[0].name == other.name
    else:
        with pytest.raises(InputError, match=message):
            add_effect(*arguments)


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
    single = _truth(tmp_path / "single", hidden_campaign, "single", {"support_friction": TRUE_SCALE})
    found = score(single, document, diagnosed)
    assert found.correct and found.by_own_name and found.also_named == ()
    wrong = _truth(tmp_path / "wrong", hidden_campaign, "single", {"motor_inertia_scale": 1.2})
    found = score(wrong, document, diagnosed)
    assert not found.correct and found.also_named == ("support_friction",) and found.intervals_cover is None
    both = {"support_friction": TRUE_SCALE, "object_mass": 1.1}
    assert not score(_truth(tmp_path / "pair", hidden_campaign, "pair", both), document, diagnosed).correct
    null = _truth(tmp_path / "null", hidden_campaign, "null", {})
    assert not score(null, document, diagnosed).correct
    nothing = document.model_copy(update={"verdict": "NOTHING-MISSING", "named": ()})
    assert score(null, nothing, diagnosed).correct


def test_a_diagnosis_of_another_campaign_is_refused(
    document: DiagnosisDocument, diagnosed: Path, push_campaign: Path, tmp_path: Path
) -> None:
    other = _truth(tmp_path / "other", push_campaign, "single", {"support_friction": TRUE_SCALE})
    with pytest.raises(InputError, match="other runs"):
        score(other, document, diagnosed)
