# SPDX-License-Identifier: Apache-2.0
"""An effect without which replays miss the object is named before those that a search finds."""

from __future__ import annotations

from pathlib import Path

import pytest
from analytic_world import EFFECTS, AnalyticSource, knowing

from impact_rs_analysis.diagnosis.add import add_effects
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import DiagnosisDocument
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, NONE, SMALL, TOO_FEW
from impact_rs_analysis.diagnosis.verdicts.required import with_required
from impact_rs_analysis.evidence.source import RequiredEffect
from impact_rs_sim.effects import library
from impact_rs_sim.model import Model, ModelEffect, ParameterValue

FRAME, PAD = library()["tracker_frame"], library()["pad_position"]


def required(name: str, size: float) -> RequiredEffect:
    values = {
        scalar.name: ParameterValue(estimate=0.01, unit=scalar.unit, ci95=(0.008, 0.012))
        for scalar in library()[name].scalars(1)
    }
    return RequiredEffect(ModelEffect(name=name, parameters=values), size, 4, 18)


def diagnosed(truth: tuple[tuple[str, tuple[float, ...]], ...], *needed: RequiredEffect) -> DiagnosisDocument:
    source = AnalyticSource(5, truth)
    source.required = needed
    known = knowing(source, EFFECTS["straight"], EFFECTS["bent"], FRAME, PAD).model
    source.model = known.model_copy(update={"effects": tuple(one.item for one in needed[:1])})
    return diagnose(source, only=("straight", "bent"))


def test_it_is_named_before_what_the_search_finds() -> None:
    document = diagnosed((("straight", (6.0,)),), required("tracker_frame", 2.0))
    assert str(document.verdict) == "tracker_frame+straight"
    assert (document.named, document.faults, document.missing) == (
        ("tracker_frame", "straight"), ("tracker_frame",), ("straight",),
    )  # fmt: skip
    frame = document.effect("tracker_frame")
    assert frame is not None and frame.verdict == CONFIRMED and frame.parameters["x"].ci95 == (0.008, 0.012)
    assert "the frame of the object tracker is off by x 10.0 mm [8.0, 12.0]" in document.summary
    assert "tracker_frame: the replays of 4 of 18 impacts hit nothing without it." in document.summary
    assert "Held-out error, with tracker_frame:" in document.summary
    assert document.model.digest == Model(name="nominal").digest
    assert [one.effect for one in document.calibrate] == ["tracker_frame"]


def test_alone_it_is_the_verdict() -> None:
    document = diagnosed((), required("tracker_frame", 2.0))
    assert str(document.verdict) == "tracker_frame" and document.summary.count("→") == 0
    assert "No physical effect is missing." in document.summary


@pytest.mark.parametrize(("size", "tied"), [(2.1, True), (3.0, False)])
def test_another_one_with_residuals_as_small_is_a_rival(size: float, tied: bool) -> None:
    document = diagnosed((), required("tracker_frame", 2.0), required("pad_position", size))
    assert document.confusable == ((("tracker_frame", "pad_position"),) if tied else ())
    frame = document.effect("tracker_frame")
    assert frame is not None and (frame.verdict == CONFIRMED) is not tied


def test_of_the_physics_it_is_missing_in_the_model(tmp_path: Path) -> None:
    document = diagnosed((), required("pad_position", 2.0))
    assert document.missing == ("pad_position",) and "Model 'nothing' lacks pad_position." in document.summary
    child = add_effects(
        Model(name="nominal"), tmp_path / "nominal.yaml", document, tmp_path / "d.json", document.named,
        tmp_path / "child.yaml", False,
    )  # fmt: skip
    (item,) = child.effects
    assert item.parameters["z"].estimate == 0.01
    assert "the replays of 4 of 18 impacts hit nothing without it" in child.note


def test_residuals_that_no_effect_explains_leave_it_named() -> None:
    document = diagnosed((("outside", (6.0,)),), required("tracker_frame", 2.0))
    assert str(document.verdict) == "PARTLY{tracker_frame}"
    assert "At least one more effect" in document.summary and "0 %" not in document.summary


def test_what_is_too_small_to_matter_is_not_named_with_it_and_too_few_data_name_nothing() -> None:
    source, document = AnalyticSource(5), diagnosed((("straight", (6.0,)),))
    source.required = (required("tracker_frame", 2.0),)
    assert with_required(document.model_copy(update={"verdict": SMALL}), source).named == ("tracker_frame",)
    assert with_required(document.model_copy(update={"verdict": NONE}), source).named == ("tracker_frame", "straight")
    few = document.model_copy(update={"verdict": TOO_FEW})
    assert with_required(few, source) is few


@pytest.mark.parametrize(("size", "needed"), [(1.9, False), (2.1, True), (None, True)])
def test_it_is_not_required_beside_another_effect_with_which_replays_hit_and_fit_better(
    size: float | None, needed: bool
) -> None:
    """A filter of the velocities shows impacts late. Kills: the competitor's replays are not asked, or not its size."""
    source, alone = (
        knowing(AnalyticSource(5, (("straight", (6.0,)),)), EFFECTS["straight"], EFFECTS["bent"], FRAME)
        for _ in range(2)
    )
    frame, asked = required("tracker_frame", 2.0), []
    source.required, source.without_required = (frame,), alone
    source.model = source.model.model_copy(update={"effects": (frame.item,)})
    source.size_by_declared_model = lambda added: (asked.append(added), size)[1]  # type: ignore[method-assign]
    document = diagnose(source, only=("straight", "bent"))
    assert (document.required, document.missing) == (("tracker_frame",) if needed else (), ("straight",))
    [((name, values),)] = asked
    assert name == "straight" and values == (pytest.approx(6.0, abs=0.2),)
