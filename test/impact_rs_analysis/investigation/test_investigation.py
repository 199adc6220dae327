# SPDX-License-Identifier: Apache-2.0
"""Steps and decisions of an investigation, on diagnoses that are given; each step may be killed."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from documents import comparison, diagnosis
from processes import killed_at_file

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, EstimateDocument, ModelIdentity
from impact_rs_analysis.diagnosis.laws.discovery_document import DiscoveryDocument, LawDocument
from impact_rs_analysis.diagnosis.verdict import SMALL, DiagnosisVerdict
from impact_rs_analysis.investigation import loop
from impact_rs_analysis.investigation.endings import Ending, judged, read_ending
from impact_rs_analysis.investigation.loop import Investigation
from impact_rs_analysis.investigation.policy import MAX_VAIN_DISCOVERIES
from impact_rs_analysis.investigation.prediction_check import CheckedImpact, PredictionError, Predictions
from impact_rs_analysis.investigation.rounds import (
    PlannedTrial,
    Round,
    RoundDecision,
    WantedTrials,
    read_rounds,
    trials_of,
)
from impact_rs_analysis.investigation.settings import BlindChoice, Settings, begin
from impact_rs_analysis.report.family_tree import family_of, gains_of, write_investigation
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model, load_model
from impact_rs_trials.campaign import PlannedTrials
from impact_rs_trials.envelope import CellEnvelope
from impact_rs_trials.experiment_plan import ExperimentPlan, PlannedCampaign, PlannedPair

FRICTION, MASS = "support_friction", "object_mass"
PARAMETERS = {
    FRICTION: {"friction": {"estimate": 0.1, "ci95": (0.08, 0.12), "unit": "-"}},
    MASS: {"scale": {"estimate": 1.2, "ci95": (1.1, 1.3), "unit": "-"}},
    "tracker_delay": {"delay": {"estimate": 0.02, "ci95": (0.018, 0.022), "unit": "s"}},
}
SETTINGS = Settings(scenarios=("push", "excite"), model_digest=load_model("nominal").digest)


def said(verdict: str, *effects: str, of: str = "CONFIRMED", **more: Any) -> DiagnosisDocument:
    """A diagnosis that names effects, each with one verdict."""
    found = tuple(
        EffectDocument(
            name=name,
            verdict=of,
            parameters=PARAMETERS[name],
            held_out_error_before=9.0,
            held_out_error_after=1.0,
            p_value=0.001,
        )
        for name in effects
    )
    update = {
        "verdict": DiagnosisVerdict.parse(verdict),
        "named": effects,
        "effects": found,
        "suspected": (),
        "confusable": (),
        "views": (),
    }
    return diagnosis().model_copy(
        update={"summary": f"{verdict}.", "next_experiment": None, "formulas": (), "views": ()} | update | more
    )


CLEAN = said("NOTHING-MISSING", held_out_error_before=1.0, noise_floor=1.0)


class FakeBench:
    """Trials that are folders, and a diagnosis for every (number of effects of the model, trials) that is asked for."""

    rank = staticmethod(lambda *_: None)

    def __init__(self, directory: Path, answer: Callable[[Model, int], DiagnosisDocument]) -> None:
        self.directory, self.answer = directory, answer
        self.measured: list[str] = []
        self.last: DiagnosisDocument | None = None
        self.shown: list[tuple[str, ...]] = []

    def measure(self, trials: Sequence[PlannedTrial]) -> None:
        for one in trials:
            self.measured.append(one.path)
            (self.directory / "runs" / one.path).mkdir(parents=True)

    def read(self) -> Callable[[Model], Any]:
        return lambda model: (self, model)

    def design(self, wanted: WantedTrials) -> ExperimentPlan:
        self.last = wanted.document
        self.shown.append(tuple(wanted.show))
        one = PlannedTrials(object="parcel", case="case_1", trials=wanted.budget)
        return ExperimentPlan(
            model=wanted.model.name,
            model_digest=wanted.model.digest,
            aim="effects",
            method="fixed",
            budget=wanted.budget,
            seed=wanted.seed,
            campaigns=(PlannedCampaign(folder="push", scenario="push", conditions=(one,)),),
        )


Start = Callable[..., tuple[Investigation, FakeBench]]


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Start:
    """An investigation with given diagnoses."""

    def diagnosed(
        source: tuple[FakeBench, Model], model: Model, *_: Any, earlier: Model | None = None
    ) -> DiagnosisDocument:
        bench, _ = source
        if earlier is not None:
            assert earlier.effects and not model.effects  # the first model again, from the estimates of the newest
        found = bench.answer(model, len(list((bench.directory / "runs").glob("*/*/*"))))
        return found.model_copy(update={"model": ModelIdentity(name=model.name, digest=model.digest)})

    monkeypatch.setattr(loop, "diagnose", diagnosed)

    def checked(source: tuple[FakeBench, Model], folder: Path, predictions: Predictions, _: Any) -> PredictionError:
        """The parcel is 10 mm/s slower than predicted; a right model would be off by as much."""
        impacts = tuple(
            CheckedImpact(condition=one.condition, trials=2, predicted=one, arm=one.arm + 0.01, object=None)
            for one in predictions.impacts
        )
        count, unit = len(list(folder.glob("*/*"))), "times repeatability"
        found = PredictionError(model=predictions.model, trials=count, error=1.23, unit=unit, impacts=impacts)
        return found.model_copy(update=dict.fromkeys(("p_value", "p_value_of_all", "p_value_of_first"), 0.4))

    monkeypatch.setattr(loop, "compare", lambda source: comparison())
    monkeypatch.setattr(loop, "prediction_error", checked)

    def made(
        answer: Callable[[Model, int], DiagnosisDocument],
        budget: int = 60,
        folder: str = "one",
        discovered: Callable[..., DiscoveryDocument] | None = None,
    ) -> tuple[Investigation, FakeBench]:
        directory = tmp_path / folder
        if discovered is not None:
            monkeypatch.setattr(loop, "discover", discovered)
        begin(directory, SETTINGS)
        bench = FakeBench(directory, answer)
        return Investigation(directory, SETTINGS, budget, bench), bench

    return made


def friction_then_nothing(model: Model, trials: int) -> DiagnosisDocument:
    del trials
    return CLEAN if model.effects else said(FRICTION, FRICTION)


def test_an_effect_that_is_found_is_added_and_tried_on_new_trials(start: Start) -> None:
    investigation_, bench = start(friction_then_nothing)
    ending = investigation_.run()
    assert (ending.verdict, ending.effects, ending.model) == ("EXPLAINED", (FRICTION,), "model_2.yaml")
    assert ending.trials == len(bench.measured) == loop.FIRST + loop.FEW
    model = load_model(investigation_.directory / "model_2.yaml")
    assert model.effects[0].parameters["friction"].estimate == 0.1
    assert "predicts the 2 trials that were measured after it was made" in ending.summary


def test_a_fault_of_the_readings_is_called_one_at_the_end(start: Start) -> None:
    delay = said("tracker_delay", "tracker_delay")
    late = start(lambda model, _: CLEAN if model.effects else delay)[0].run()
    assert "tracker_delay is a fault of this laboratory's readings" in late.summary
    assert "laboratory" not in start(friction_then_nothing, folder="physics")[0].run().summary


def test_two_effects_are_two_models_with_the_estimates_of_one_diagnosis(start: Start) -> None:
    both = said(f"{FRICTION}+{MASS}", FRICTION, MASS)
    investigation_, _ = start(lambda model, trials: CLEAN if model.effects else both)
    ending = investigation_.run()
    assert ending.effects == (MASS, FRICTION)
    last = load_model(investigation_.directory / ending.model)
    assert [item.name for item in last.effects] == [FRICTION, MASS]
    family = family_of(SETTINGS, read_rounds(investigation_.directory, SETTINGS))
    assert [(one.name, one.parent, one.generation) for one in family] == [
        ("nominal", None, 0),
        ("model_2.yaml", "nominal", 1),
        ("model_3.yaml", "model_2.yaml", 2),
    ]


def test_nothing_is_missing_only_where_a_second_batch_of_trials_says_so_too(start: Start) -> None:
    investigation_, bench = start(lambda model, trials: CLEAN)
    ending = investigation_.run()
    assert (ending.verdict, ending.effects, ending.model) == ("NOTHING-MISSING", (), "nominal")
    assert ending.rounds == 2 and len(bench.measured) == loop.FIRST + loop.MORE


def hinting(p_value: float, after: float = 1.1, most: float = 1.5, error: float = 1.2) -> DiagnosisDocument:
    """Nothing is missing; mass lowers the error, and could be up to ``most`` (nominal 1, a noticeable change 0.1)."""
    scale = EstimateDocument(estimate=1.1, ci95=(1.0, most), unit="-", nominal=1.0, scale=0.1)
    mass = EffectDocument(
        name=MASS,
        verdict="NO-IMPROVEMENT",
        parameters={"scale": scale},
        held_out_error_before=error,
        held_out_error_after=after,
        p_value=0.5,
        p_value_alone=p_value,
    )
    return CLEAN.model_copy(update={"effects": (mass,), "held_out_error_before": error, "held_out_error_after": error})


def test_what_would_be_significant_if_tested_alone_is_looked_at_once_more_before_the_end(start: Start) -> None:
    """Of a model that holds, and of the first one; no longer once trials exclude it."""
    for first, done in ((said(FRICTION, FRICTION), ("EXPLAINED", (FRICTION,))), (CLEAN, ("NOTHING-MISSING", ()))):
        last = loop.FIRST + (loop.FEW if first is not CLEAN else loop.MORE)

        def answer(model: Model, trials: int, first: Any = first, last: int = last) -> DiagnosisDocument:
            return first if not model.effects and first is not CLEAN else hinting(0.01 if trials <= last else 0.3)

        investigation_, bench = start(answer, folder=done[0])
        ending = investigation_.run()
        assert (ending.verdict, ending.effects) == done
        assert bench.shown == [(), (), (MASS,)] and bench.last is None
        assert ending.trials == last + loop.FEW
        reason = read_rounds(investigation_.directory, SETTINGS)[1].decision
        assert reason is not None and f"{MASS} (p = 0.01) would be significant" in reason.reason


FOUND_AT = loop.FIRST + loop.FEW  # trials; with more of them mass shows


def little_mass(model: Model, trials: int, first: DiagnosisDocument) -> DiagnosisDocument:
    """Friction is found at once; mass only by the trials that are measured because it could be there.

    Args:
        model: The diagnosed model.
        trials: All that were measured.
        first: What the first model is found to lack once mass shows.
    """
    if {item.name for item in model.effects} == {FRICTION, MASS}:
        return CLEAN
    if model.effects:
        return hinting(0.02) if trials <= FOUND_AT else said(MASS, MASS)
    return said(FRICTION, FRICTION) if trials <= FOUND_AT else first


def test_a_small_second_effect_is_found_by_trials_that_show_it(start: Start) -> None:
    both = said(f"{FRICTION}+{MASS}", FRICTION, MASS)
    ending = start(lambda model, trials: little_mass(model, trials, both))[0].run()
    assert (ending.verdict, ending.effects) == ("EXPLAINED", (MASS, FRICTION))
    assert ending.trials == FOUND_AT + 2 * loop.FEW


def test_a_small_second_effect_that_the_first_model_hardly_shows_is_added_to_the_newest(start: Start) -> None:
    """The first model is explained by friction alone, with all trials."""
    investigation_, _ = start(lambda model, trials: little_mass(model, trials, said(FRICTION, FRICTION)))
    ending = investigation_.run()
    assert (ending.verdict, ending.effects) == ("EXPLAINED", (MASS, FRICTION))
    assert ending.trials == FOUND_AT + 2 * loop.FEW
    family = family_of(SETTINGS, read_rounds(investigation_.directory, SETTINGS))
    assert [one.parent for one in family] == [None, "nominal", "model_2.yaml"]


@pytest.mark.parametrize(
    "hint", [hinting(0.06), hinting(0.01, after=1.3), hinting(0.01, most=1.09), hinting(0.01, 0.8, 1.5, 0.9)]
)
def test_what_is_excluded_or_not_significant_even_alone_or_cannot_lower_the_error_ends(
    start: Start, hint: DiagnosisDocument
) -> None:
    ending = start(lambda model, trials: hint if model.effects else said(FRICTION, FRICTION))[0].run()
    assert ending.trials == loop.FIRST + loop.FEW


def test_what_is_too_small_to_matter_is_not_looked_at(start: Start) -> None:
    small = hinting(0.01).model_copy(update={"verdict": SMALL})
    ending = start(lambda model, trials: small if model.effects else said(FRICTION, FRICTION))[0].run()
    assert ending.trials == loop.FIRST + loop.FEW


def test_looks_go_on_while_trials_make_an_effect_more_significant(start: Start) -> None:
    values = iter([0.04, 0.03, 0.02, 0.02])
    investigation_, bench = start(lambda model, _: hinting(next(values)) if model.effects else said(FRICTION, FRICTION))
    ending = investigation_.run()
    assert (ending.verdict, ending.effects) == ("EXPLAINED", (FRICTION,))
    assert [show for show in bench.shown if show] == [(MASS,)] * 3
    assert MASS in ending.not_excluded
    few, _ = start(
        lambda model, trials: hinting(0.01) if model.effects else said(FRICTION, FRICTION),
        budget=loop.FIRST + loop.FEW,
        folder="few",
    )
    assert few.run().verdict == "EXPLAINED"  # no trial is left for it


def test_a_model_that_fails_on_new_trials_is_left_and_the_first_one_diagnosed_again(start: Start) -> None:
    """Friction at first; with all trials mass explains them, and the model with mass holds."""

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        if model.effects:
            return CLEAN if model.effects[0].name == MASS else said(MASS, MASS)
        return said(FRICTION, FRICTION) if trials <= loop.FIRST else said(MASS, MASS)

    investigation_, _ = start(answer)
    ending = investigation_.run()
    assert ending.effects == (MASS,)
    family = family_of(SETTINGS, read_rounds(investigation_.directory, SETTINGS))
    assert [(one.parent, one.effect, one.last) for one in family[1:]] == [
        ("nominal", FRICTION, False),
        ("nominal", MASS, True),
    ]


def test_what_a_model_that_fails_may_lack_is_decided_by_the_next_trials(tmp_path: Path) -> None:
    """Beside what the first model is found to lack, and no more than that diagnosis knows."""
    first = said(f"PARTLY{{{FRICTION}}}", FRICTION, MASS, named=(FRICTION,))
    failed = said("NONE-EXPLAINS").model_copy(update={"suspected": (MASS, "unheard_of")})
    here = Round(2, tmp_path, "model_2.yaml", diagnosis=failed, again=first)
    assert here.open is not None and here.open.suspected == (MASS,) and here.open.named == (FRICTION,)
    assert replace(here, again=None).open is failed


def test_renewed_estimates_of_the_same_effect_are_tried_on_new_trials(start: Start) -> None:
    """The model from 6 trials does not hold; that with the same effect from 8 does."""

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        if not model.effects:
            return said(FRICTION, FRICTION)
        return said(MASS, MASS) if model.name == "model_2" else CLEAN

    investigation_, _ = start(answer)
    ending = investigation_.run()
    assert (ending.verdict, ending.effects, ending.model) == ("EXPLAINED", (FRICTION,), "model_3.yaml")
    assert ending.trials == loop.FIRST + 2 * loop.FEW


@pytest.mark.parametrize(
    ("left", "of", "p_value", "ends"),
    [
        (0.8, "CONFIRMED", 0.01, True),
        (0.8, "CONFIRMED", 0.009, False),
        (1.1, "CONFIRMED", 0.4, False),
        (0.8, "AT-BOUND", 0.4, False),
    ],
)
def test_what_a_model_that_predicts_new_trials_seems_to_lack_is_the_error_of_its_estimates(
    start: Start, monkeypatch: pytest.MonkeyPatch, left: float, of: str, p_value: float, ends: bool
) -> None:
    """New trials are off by as much as those of a right model, and the same explains the first model down to noise."""
    check = loop.prediction_error
    monkeypatch.setattr(loop, "prediction_error", lambda *a: check(*a).model_copy(update={"p_value": p_value}))

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        if model.effects:
            return said(MASS, MASS, held_out_error_before=1.05, noise_floor=1.0)
        verdict = "CONFIRMED" if trials <= loop.FIRST else of
        return said(FRICTION, FRICTION, of=verdict, held_out_error_after=left, noise_floor=1.0)

    investigation_, _ = start(answer, loop.FIRST + 3 * loop.FEW)
    ending = investigation_.run()
    assert (ending.trials == loop.FIRST + loop.FEW) == ends
    if ends:
        assert (ending.verdict, ending.effects, ending.model) == ("EXPLAINED", (FRICTION,), "model_3.yaml")
        assert "predicts the 2 trials that were measured after it was made" in ending.summary
        assert (investigation_.directory / "model_3.yaml").exists()


@pytest.mark.parametrize("answer", ["effect", "nothing"])
def test_trials_that_cannot_be_used_try_and_confirm_nothing(
    start: Start, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    """The second round has no usable trial; the third has."""
    check = loop.prediction_error

    def unusable(source: Any, folder: Path, *more: Any) -> PredictionError:
        found = check(source, folder, *more)
        return found.model_copy(update={"trials": 0, "error": None}) if folder.name == "round_02" else found

    monkeypatch.setattr(loop, "prediction_error", unusable)
    investigation_, bench = start({"effect": friction_then_nothing, "nothing": lambda *_: CLEAN}[answer])
    ending = investigation_.run()
    assert (bench.last is None) == (answer == "effect")  # the model is tried again, for whatever else it may lack
    assert (ending.verdict, ending.rounds) == ({"effect": "EXPLAINED", "nothing": "NOTHING-MISSING"}[answer], 3)


def test_a_model_that_never_holds_is_no_explanation(start: Start) -> None:
    investigation_, _ = start(lambda model, trials: said(MASS, MASS) if model.effects else said(FRICTION, FRICTION), 12)
    ending = investigation_.run()
    assert (ending.verdict, ending.certain, ending.effects) == ("UNDECIDED", False, ())
    assert ending.candidates == (FRICTION,)


@pytest.mark.parametrize("name", ["effect", "law"])
def test_a_model_that_no_trial_was_left_for_is_no_explanation(start: Start, name: str) -> None:
    investigation_, _ = start(
        {"effect": friction_then_nothing, "law": outside}[name],
        budget=loop.FIRST,
        discovered=lambda *_: law_found(),
    )
    ending = investigation_.run()
    assert (ending.verdict, ending.certain, ending.effects, ending.laws) == ("UNDECIDED", False, (), ())
    assert ending.candidates == ({"effect": FRICTION, "law": DRAG.name}[name],)
    assert "No trial is left to try model_2.yaml on" in ending.summary


def test_one_round_that_shows_nothing_is_not_certain(start: Start) -> None:
    investigation_, bench = start(lambda model, trials: CLEAN, budget=6)
    ending = investigation_.run()
    assert (ending.verdict, ending.certain, ending.candidates) == ("UNDECIDED", False, ())
    assert "New trials have to confirm it. And the budget of 6 trials is spent." in ending.summary
    assert Investigation(investigation_.directory, SETTINGS, 10, bench).run().verdict == "NOTHING-MISSING"


def tie(model: Model, trials: int) -> DiagnosisDocument:
    del model, trials
    return said(FRICTION, FRICTION, of=f"CONFUSABLE-WITH{{{MASS}}}", confusable=((FRICTION, MASS),))


def test_a_tie_that_no_trial_splits_ends_with_i_cannot_tell_and_both_names(start: Start) -> None:
    investigation_, bench = start(tie, budget=20)
    ending = investigation_.run()
    assert (ending.verdict, ending.certain) == ("UNDECIDED", False)
    assert ending.candidates == (FRICTION, MASS)
    assert "I cannot tell" in ending.summary and "the budget of 20 trials is spent" in ending.summary
    assert len(bench.measured) == 20
    assert bench.last is not None and bench.last.confusable  # the design knows what to split


def test_a_budget_that_is_smaller_than_before_ends_what_is_open(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted before the second plan. Kills a plan of no trials, or of -4."""
    investigation_, bench = start(tie, budget=20)
    design = FakeBench.design

    def interrupted(self: FakeBench, wanted: WantedTrials) -> ExperimentPlan:
        if wanted.done:
            raise KeyboardInterrupt
        return design(self, wanted)

    monkeypatch.setattr(FakeBench, "design", interrupted)
    with pytest.raises(KeyboardInterrupt):
        investigation_.run()
    ending = Investigation(investigation_.directory, SETTINGS, 2, bench).run()
    assert (ending.verdict, ending.candidates) == ("UNDECIDED", (FRICTION, MASS))
    assert "The budget of 2 trials is spent." in ending.summary


@pytest.mark.parametrize("budget", [1, 3, 8, 9, 13])
def test_no_more_trials_than_the_budget(start: Start, budget: int) -> None:
    for name, answer in {"tie": tie, "null": lambda *_: CLEAN, "single": friction_then_nothing}.items():
        investigation_, bench = start(answer, budget, name)
        assert investigation_.run().trials == len(bench.measured) <= budget


@pytest.mark.parametrize(("sure", "suspected"), [(True, False), (True, True), (False, False)])
def test_a_small_effect_that_is_named_again_beside_a_large_one_is_added_to_it(
    start: Start, sure: bool, suspected: bool
) -> None:
    """The first model is explained by the large one alone, however often it is asked. A doubtful one is not added."""

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        found = {one.name for one in model.effects}
        if not found:
            return said(FRICTION, FRICTION)
        if MASS in found:
            return CLEAN
        if suspected and trials == loop.FIRST + loop.FEW:
            return CLEAN.model_copy(update={"suspected": (MASS,)})
        return said(MASS, MASS, of="CONFIRMED" if sure else "PRESENT-BUT-SMALL")

    investigation_, _ = start(answer, budget=20)
    ending = investigation_.run()
    rounds = read_rounds(investigation_.directory, SETTINGS)
    if not sure:
        assert (ending.verdict, ending.candidates, ending.trials) == ("UNDECIDED", (FRICTION,), 20)
        return
    assert (ending.verdict, ending.effects, ending.trials) == ("EXPLAINED", (MASS, FRICTION), 12)
    model = load_model(investigation_.directory / ending.model)
    assert [one.name for one in model.effects] == [FRICTION, MASS]
    last = family_of(SETTINGS, rounds)[-1]
    assert (last.name, last.parent, last.generation) == ("model_4.yaml", "model_3.yaml", 2)


@pytest.mark.parametrize(("after", "ends", "larger"), [(0.001, True, 30), (0.95, False, 24)])
def test_a_tie_that_no_trial_splits_ends_before_the_budget_is_spent(
    start: Start, monkeypatch: pytest.MonkeyPatch, after: float, ends: bool, larger: int
) -> None:
    """Where two trials decide with 0.1 %, fourteen do with 42 %, and 24 with 68 %."""
    design = FakeBench.design

    def rivals(self: FakeBench, wanted: WantedTrials) -> ExperimentPlan:
        pairs = (PlannedPair(first=FRICTION, second=MASS, before=0.0, after=after),)
        plan = design(self, wanted)
        return plan.model_copy(update={"aim": "rivals", "pairs": pairs}) if wanted.done else plan

    monkeypatch.setattr(FakeBench, "design", rivals)
    investigation_, bench = start(tie, budget=20)
    ending = investigation_.run()
    assert (ending.verdict, ending.candidates) == ("UNDECIDED", (FRICTION, MASS))
    assert ending.trials == (6 if ends else 20)
    assert ("would do so with a probability of 42 % at best" in ending.summary) == ends
    further = Investigation(investigation_.directory, SETTINGS, larger, bench).run()
    assert further.trials > ending.trials


def test_a_larger_budget_goes_on_after_the_end_of_a_spent_one(start: Start) -> None:
    def answer(model: Model, trials: int) -> DiagnosisDocument:
        return friction_then_nothing(model, trials) if trials > 10 else tie(model, trials)

    investigation_, bench = start(answer, budget=6)
    assert investigation_.run().verdict == "UNDECIDED"
    larger = Investigation(investigation_.directory, SETTINGS, 40, bench)
    untried, bench_ = start(friction_then_nothing, 6, "untried")
    assert not untried.run().certain
    tried = Investigation(untried.directory, SETTINGS, 40, bench_).run()
    assert (tried.effects, tried.trials, tried.model) == ((FRICTION,), 8, "model_2.yaml")
    assert (larger.run().verdict, read_ending(investigation_.directory).effects) == ("EXPLAINED", (FRICTION,))


def test_too_few_repeats_and_a_suspicion_ask_for_more_trials(start: Start) -> None:
    def answer(model: Model, trials: int) -> DiagnosisDocument:
        if trials <= 6:
            return said("TOO-FEW-REPEATS")
        if trials <= 10:
            return CLEAN.model_copy(update={"suspected": (FRICTION,)})
        return friction_then_nothing(model, trials)

    investigation_, _ = start(answer)
    assert investigation_.run().effects == (FRICTION,)
    actions = [one.decision.action for one in read_rounds(investigation_.directory, SETTINGS) if one.decision]
    assert actions == ["measure", "measure", "add", "end"]


def test_an_error_beyond_that_of_a_right_model_is_not_nothing_however_few_the_trials(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though no effect stands out; at a level of 1 %."""
    check = loop.prediction_error

    def first_model_is_off(until: int, p_value: float) -> None:
        def checked(source: Any, folder: Path, *more: Any) -> PredictionError:
            late = len(list(folder.parent.glob("*/*/*"))) > until
            return check(source, folder, *more).model_copy(update={"p_value_of_all": 0.4 if late else p_value})

        monkeypatch.setattr(loop, "prediction_error", checked)

    first_model_is_off(until=60, p_value=0.009)
    ending = start(lambda *_: CLEAN, budget=16)[0].run()
    assert ending.verdict == "UNDECIDED" and "would hardly have an error of 1 (p = 0.009): too few" in ending.summary
    first_model_is_off(until=8, p_value=0.009)
    ending = start(lambda *_: CLEAN, folder="quiet")[0].run()
    assert (ending.verdict, ending.trials) == ("NOTHING-MISSING", 14)
    first_model_is_off(until=60, p_value=0.01)
    assert start(lambda *_: CLEAN, folder="level")[0].run().verdict == "NOTHING-MISSING"


def test_the_first_model_that_is_diagnosed_again_has_an_error_of_its_own(tmp_path: Path) -> None:
    """Not that of the model that failed: a mix-up of the two p-values is noticed either way."""
    ours = PredictionError(
        model=CLEAN.model, trials=2, error=1.0, unit="-", p_value=0.4, p_value_of_all=0.001, p_value_of_first=0.4
    )
    here = Round(2, tmp_path, "model_2.yaml", prediction_error=ours, diagnosis=CLEAN)
    assert here.fails(SETTINGS) and not here.basis_holds
    again = replace(here, again=CLEAN)
    assert again.fails(SETTINGS) and again.basis_holds
    other = replace(again, prediction_error=ours.model_copy(update={"p_value_of_all": 0.4, "p_value_of_first": 0.001}))
    assert not other.fails(SETTINGS) and not other.basis_holds


def test_what_no_effect_explains_is_first_measured_again_and_then_a_law_is_looked_for(start: Start) -> None:
    looked = []

    def discovered(source_of: Any, model: Model, *_: Any) -> DiscoveryDocument:
        looked.append(model.name)
        return DiscoveryDocument(verdict="NO-LAW-HOLDS", summary="No law holds.", error_unit="times repeatability")

    partly = said(f"PARTLY{{{FRICTION}}}", FRICTION, held_out_error_after=4.0)
    investigation_, bench = start(lambda *_: partly, budget=20, discovered=discovered)
    ending = investigation_.run()
    assert ending.verdict == "UNDECIDED" and "NO-LAW-HOLDS" in ending.summary
    assert ending.candidates == (FRICTION,)
    assert "2 discoveries have found no law" in ending.summary
    assert len(looked) == MAX_VAIN_DISCOVERIES and len(bench.measured) == 14
    first, second = read_rounds(investigation_.directory, SETTINGS)[:2]
    assert first.discovery is None and second.discovery is not None


def test_no_law_is_looked_for_while_more_trials_explain_more(start: Start) -> None:
    """A friction of many parameters: partly explained with 6 and 10 trials, with 14 wholly."""
    rest = {6: 17.5, 10: 5.3}

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        if model.effects or trials not in rest:
            return friction_then_nothing(model, trials)
        return said(f"PARTLY{{{FRICTION}}}", FRICTION, held_out_error_before=25.8, held_out_error_after=rest[trials])

    investigation_, _ = start(answer, discovered=lambda *_: pytest.fail("the library explains it"))
    assert investigation_.run().effects == (FRICTION,)


DRAG = FormulaSpec.model_validate(
    {
        "name": "end_effector_drag",
        "sentence": "Drag.",
        "end_effector_force": {"y": "-drag * vy"},
        "parameters": {"drag": {"unit": "N s/m", "nominal": 0.0, "lower": 0.0, "upper": 50.0, "scale": 1.0}},
    }
)


def law_found(verdict: str = "CONFIRMED", tied: tuple[str, ...] = ()) -> DiscoveryDocument:
    """A drag of 5 N s/m that explains everything, alone or tied with others."""
    numbers = {"drag": {"estimate": 5.0, "ci95": (4.8, 5.2), "unit": "N s/m"}}
    effect = EffectDocument(
        name=DRAG.name,
        verdict=verdict,
        parameters=numbers,
        held_out_error_before=9.0,
        held_out_error_after=1.0,
        p_value=0.001,
    )
    model = load_model("nominal")
    found = said(DRAG.name).model_copy(
        update={
            "named": (DRAG.name,),
            "effects": (effect,),
            "formulas": (DRAG,),
            "confusable": ((DRAG.name, *tied),) if tied else (),
            "model": ModelIdentity(name=model.name, digest=model.digest),
        }
    )
    law = LawDocument(
        name=DRAG.name,
        sentence="Drag.",
        place="force on the end effector",
        formula="-drag * vy",
        parameters=numbers,
        verdict=verdict,
        held_out_error_before=9.0,
        held_out_error_after=1.0,
        p_value=0.001,
        tied_with=tied,
    )
    return DiscoveryDocument(
        verdict="LAW-FOUND", summary="A law holds.", laws=(law,), error_unit="times repeatability", diagnosis=found
    )


def outside(model: Model, trials: int) -> DiagnosisDocument:
    """No effect of the library explains the trials; with a law they are explained."""
    del trials
    return CLEAN if model.effects else said("NONE-EXPLAINS")


def test_a_law_that_is_found_is_added_as_a_formula_and_tried(start: Start) -> None:
    investigation_, _ = start(outside, discovered=lambda *_: law_found())
    ending = investigation_.run()
    assert (ending.verdict, ending.laws, ending.effects) == ("LAW-HOLDS", (DRAG.name,), (DRAG.name,))
    model = load_model(investigation_.directory / ending.model)
    assert model.formulas[0].end_effector_force == {"y": "-drag * vy"}
    assert model.effects[0].parameters["drag"].estimate == 5.0
    assert judged(ending, "outside", ("drag",)) == (True, False)


def test_laws_that_predict_equally_well_are_designed_for_and_listed_at_the_end(start: Start) -> None:
    """However often they are found, for a tie is a law. Friction, which explains a part, is no rival."""
    looked: list[int] = []

    def discovered(*_: Any) -> DiscoveryDocument:
        looked.append(1)
        return law_found("CONFUSABLE-WITH{cable, object_mass}", ("cable", MASS))

    partly = said(f"PARTLY{{{FRICTION}}}", FRICTION, held_out_error_after=4.0)
    investigation_, bench = start(lambda *_: partly, budget=28, discovered=discovered)
    ending = investigation_.run()
    assert (ending.verdict, ending.candidates, ending.effects) == ("UNDECIDED", (DRAG.name, "cable", MASS), ())
    assert "the budget of 28 trials is spent" in ending.summary
    assert len(looked) > MAX_VAIN_DISCOVERIES
    assert bench.last is not None and bench.last.named == (DRAG.name,) and bench.last.formulas == (DRAG,)


def test_laws_once_found_are_fitted_again_and_not_forgotten(start: Start) -> None:
    """Though more trials leave less to friction, and although two later discoveries do not find the laws again."""
    none = DiscoveryDocument(verdict="NO-LAW-HOLDS", summary="No law holds.", error_unit="times repeatability")
    answers = [law_found("CONFUSABLE-WITH{cable}", ("cable",)), none, none]
    rest = {6: 8.0, 10: 7.0, 14: 4.0}

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        return said(f"PARTLY{{{FRICTION}}}", FRICTION, held_out_error_after=rest.get(trials, 2.0))

    investigation_, bench = start(answer, discovered=lambda *_: answers.pop(0))
    ending = investigation_.run()
    assert (ending.verdict, ending.candidates) == ("UNDECIDED", (DRAG.name, "cable"))
    assert len(bench.measured) == 18 and not answers


def test_a_tie_between_laws_that_further_trials_split_ends_with_the_law(start: Start) -> None:
    answers = [law_found("CONFUSABLE-WITH{cable}", ("cable",))] * 3 + [law_found()]
    investigation_, _ = start(outside, discovered=lambda *_: answers.pop(0))
    ending = investigation_.run()
    assert (ending.verdict, ending.laws, answers) == ("LAW-HOLDS", (DRAG.name,), [])


class Killed(BaseException):
    """The power went."""


def story(directory: Path) -> dict[str, str]:
    """Everything that an investigation wrote."""
    return {
        path.relative_to(directory).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted(directory.rglob("*"))
        if path.is_file()
    }


def test_a_kill_before_or_after_every_write_loses_nothing(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file of every step, killed before it is there and just after: the end is that of an undisturbed run."""
    both = said(f"{FRICTION}+{MASS}", FRICTION, MASS)

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        if model.effects:
            return CLEAN if len(model.effects) == 2 else said(MASS, MASS)
        return said(FRICTION, FRICTION) if trials <= loop.FIRST else both

    undisturbed, bench = start(answer)
    undisturbed.run()
    expected, trials = story(undisturbed.directory), bench.measured
    assert len(expected) > 15
    writers = ("write_whole", "write_plan", "write_document", "save_model")
    real = {name: getattr(loop, name) for name in writers}
    done: set[Path] = set()
    kills = 0

    def killing(name: str) -> Callable[..., None]:
        def write(*arguments: Any) -> None:
            nonlocal kills
            path = next(one for one in arguments if isinstance(one, Path))
            if path in done:  # log.md, which is written after every step
                real[name](*arguments)
                return
            kills += 1
            if kills % 2:
                raise Killed
            done.add(path)
            real[name](*arguments)
            raise Killed

        return write

    killed, bench = start(answer, folder="killed")
    for name in writers:
        monkeypatch.setattr(loop, name, killing(name))
    for _ in range(200):
        try:
            killed.run()
            break
        except Killed:
            continue
    assert kills == 2 * len(done) >= 2 * (len(expected) - 2)  # all but the settings, which were there
    assert story(killed.directory) == expected
    assert bench.measured == trials  # no trial is measured twice


@pytest.mark.parametrize(
    ("name", "after"),
    [
        ("decision.json", False),
        ("ending.json", True),
        *(
            pytest.param(name, after, marks=pytest.mark.slow)
            for name in ("discovery.json", "model_2.yaml", "decision.json", "ending.json")
            for after in (False, True)
            if (name, after) not in (("decision.json", False), ("ending.json", True))
        ),
    ],
)
def test_sigkill_at_a_file_of_an_investigation_with_a_law_loses_nothing(start: Start, name: str, after: bool) -> None:
    """A real SIGKILL: nothing is tidied up."""
    undisturbed, bench = start(outside, discovered=lambda *_: law_found())
    undisturbed.run()
    expected = story(undisturbed.directory)
    killed, _ = start(outside, folder="killed")
    assert killed_at_file(killed.run, name, after)
    there = next((killed.directory / "rounds").rglob(name), killed.directory / name)
    assert there.exists() == after
    killed.run()
    found = story(killed.directory)
    left = [path for path in found if path.endswith(".partial")]
    assert len(left) == (not after)
    assert {path: text for path, text in found.items() if path not in left} == expected
    trials = sorted(path.name for path in (killed.directory / "runs").glob("*/*/*"))
    assert trials == sorted(Path(path).name for path in bench.measured)  # none is missing, none is measured twice


def test_a_kill_between_two_trials_repeats_none(start: Start) -> None:
    killed, bench = start(friction_then_nothing)
    measure = bench.measure

    def only_three(trials: Sequence[PlannedTrial]) -> None:
        measure(trials[:3])
        raise Killed

    bench.measure = only_three  # type: ignore[method-assign]
    with pytest.raises(Killed):
        killed.run()
    bench.measure = measure  # type: ignore[method-assign]
    assert killed.run().effects == (FRICTION,)
    assert len(bench.measured) == len(set(bench.measured)) == loop.FIRST + loop.FEW


def test_a_damaged_file_of_a_step_is_named_with_the_remedy(start: Start) -> None:
    investigation_, _ = start(friction_then_nothing)
    investigation_.run()
    damaged = investigation_.directory / "rounds" / "02" / "decision.json"
    damaged.write_text(damaged.read_text()[:40])
    with pytest.raises(
        InputError, match="decision.json: incomplete or damaged .* remove it, and the step is done again"
    ):
        investigation_.run()
    damaged.unlink()
    assert investigation_.run().effects == (FRICTION,)


def test_another_question_in_the_same_folder_is_refused(start: Start) -> None:
    killed, _ = start(friction_then_nothing)
    other = SETTINGS.model_copy(update={"seed": 5, "blind": BlindChoice(seed=5)})
    with pytest.raises(InputError, match="holds another investigation \\(it differs in seed, blind\\)"):
        begin(killed.directory, other)
    wider = SETTINGS.model_copy(update={"envelope": CellEnvelope(scenarios=("push",), speed=9.0, impulse=9.0)})
    with pytest.raises(InputError, match="it differs in envelope"):
        begin(killed.directory, wider)


def test_a_first_model_that_was_changed_is_refused(start: Start) -> None:
    investigation_, bench = start(friction_then_nothing)
    settings = SETTINGS.model_copy(update={"model_digest": "0" * 16})
    with pytest.raises(InputError, match="was changed since the investigation began"):
        Investigation(investigation_.directory, settings, 60, bench).run()


def test_a_prediction_is_on_disk_before_its_trials(start: Start) -> None:
    """The end effector of the nominal arm leaves a push of the parcel at 0.5 m/s with a part of it, along -y."""
    investigation_, bench = start(friction_then_nothing)
    seen: list[bool] = []
    measure = bench.measure

    def measured(trials: Sequence[PlannedTrial]) -> None:
        folder = sorted((investigation_.directory / "rounds").iterdir())[-1]
        content = json.loads((folder / "prediction.json").read_text())
        seen.append(content["impacts"][0]["condition"] == "push/parcel/case_1")
        assert -0.5 < content["impacts"][0]["arm"] < -0.3
        measure(trials)

    bench.measure = measured  # type: ignore[method-assign]
    investigation_.run()
    assert seen == [True, True]


def test_repeats_of_a_plan_alternate_and_rounds_draw_other_noise() -> None:
    one, two = (PlannedTrials(object=name, case="case_1", trials=2) for name in ("parcel", "juice"))
    plan = ExperimentPlan(
        model="nominal",
        model_digest="",
        aim="effects",
        method="fixed",
        budget=4,
        seed=3,
        campaigns=(PlannedCampaign(folder="push", scenario="push", conditions=(one, two)),),
    )
    trials = trials_of(plan, "round_01")
    assert [(one.trial.key.object, one.trial.repeat) for one in trials] == [
        ("parcel", 0), ("juice", 0), ("parcel", 1), ("juice", 1),
    ]  # fmt: skip
    later = trials_of(plan.model_copy(update={"seed": 4}), "round_02")
    assert {one.trial.seed for one in trials}.isdisjoint(one.trial.seed for one in later)


def test_the_log_and_the_page_give_every_decision_with_its_reason(start: Start) -> None:
    investigation_, _ = start(friction_then_nothing)
    ending = investigation_.run()
    rounds = read_rounds(investigation_.directory, SETTINGS)
    text = (investigation_.directory / "log.md").read_text()
    page = write_investigation(SETTINGS, rounds, investigation_.directory / "report").read_text()
    for here in rounds:
        assert isinstance(here.decision, RoundDecision)
        assert here.decision.reason in text
    assert ending.summary in text and "EXPLAINED" in page and FRICTION in page
    assert (
        "Prediction error of model_2 in the 2 trials of this round: 1.23 times repeatability (p = 0.4 if it is right)"
        in text
    )
    assert "with an error of 1.23 times repeatability" in ending.summary and "<td>1.23</td>" in page
    arm = rounds[1].prediction.impacts[0].arm if rounds[1].prediction else 0.0
    assert f"measured end effector {arm + 0.01:+.3f} m/s (predicted {arm:+.3f})" in text
    assert all((one.directory / "prediction_error.json").exists() for one in rounds)
    assert [one.total for one in gains_of(rounds)] == [6, 8]


def end(verdict: str, effects: tuple[str, ...] = (), candidates: tuple[str, ...] = ()) -> Ending:
    return Ending(
        verdict=verdict, summary="", model="nominal", effects=effects, candidates=candidates, trials=8, rounds=1
    )


@pytest.mark.parametrize(
    ("ending", "kind", "hidden", "right", "wrong"),
    [
        (end("EXPLAINED", ("a",)), "single", ("a",), True, False),
        (end("EXPLAINED", ("b",)), "single", ("a",), False, True),
        (end("EXPLAINED", ("a",)), "pair", ("a", "b"), False, True),
        (end("EXPLAINED", ("a", "b")), "pair", ("b", "a"), True, False),
        (end("NOTHING-MISSING"), "null", (), True, False),
        (end("NOTHING-MISSING"), "single", ("a",), False, True),
        (end("EXPLAINED", ("a",)), "null", (), False, True),
        (end("UNDECIDED", (), ("a", "b")), "single", ("a",), True, False),
        (end("UNDECIDED", (), ("b",)), "single", ("a",), False, False),
        (end("UNDECIDED"), "null", (), False, False),
        (end("LAW-HOLDS", ("law",)), "outside", ("drag",), True, False),
        (end("EXPLAINED", ("a",)), "outside", ("drag",), False, True),
        (end("LAW-HOLDS", ("law", MASS)), "outside", ("drag",), False, True),
        (end("UNDECIDED"), "outside", ("drag",), True, False),
        (end("UNDECIDED", (), (FRICTION,)), "outside", ("drag",), False, False),
        (end("UNDECIDED", (), (FRICTION, "law")), "outside", ("drag",), True, False),
    ],
)
def test_an_end_is_right_undecided_or_surely_wrong(
    ending: Ending, kind: str, hidden: tuple[str, ...], right: bool, wrong: bool
) -> None:
    assert judged(ending, kind, hidden) == (right, wrong)


@pytest.mark.parametrize(
    ("verdict", "named", "open_still", "wrong"),
    [
        ("EXPLAINED", (FRICTION,), (MASS,), False),
        ("EXPLAINED", (FRICTION,), ("pad_friction",), True),
        ("EXPLAINED", (FRICTION, "pad_tilt"), (MASS,), True),
        ("NOTHING-MISSING", (), (FRICTION, MASS), False),
        ("NOTHING-MISSING", (), (MASS,), True),
    ],
)
def test_what_an_end_does_not_exclude_is_not_surely_wrong(
    verdict: str, named: tuple[str, ...], open_still: tuple[str, ...], wrong: bool
) -> None:
    """It is not right either; and a name that is not hidden, or a hidden one that is excluded, is wrong."""
    ending = end(verdict, named).model_copy(update={"not_excluded": open_still})
    assert judged(ending, "pair", (FRICTION, MASS)) == (False, wrong)


def test_an_end_says_what_its_trials_would_hardly_show(start: Start) -> None:
    """Pad friction of 0.14 is 1.4 times a noticeable change; a mass that is right to 5 % is excluded."""

    def answer(model: Model, trials: int) -> DiagnosisDocument:
        if not model.effects:
            return friction_then_nothing(model, trials)
        others = (
            EffectDocument(
                name=name,
                verdict="NO-IMPROVEMENT",
                parameters={parameter: EstimateDocument(estimate=0.0, unit=unit, ci95=ci, nominal=at, scale=0.1)},
                held_out_error_before=1.0,
                held_out_error_after=1.0,
                p_value=0.6,
            )
            for name, parameter, unit, ci, at in (
                ("pad_friction", "friction", "-", (-0.14, 0.08), 0.0),
                (MASS, "scale", "-", (0.97, 1.05), 1.0),
            )
        )
        return CLEAN.model_copy(update={"effects": tuple(others)})

    ending = start(answer)[0].run()
    assert (ending.verdict, ending.not_excluded) == ("EXPLAINED", ("pad_friction",))
    assert "Not excluded at a noticeable size: pad_friction (friction -0.14 to 0.08)." in ending.summary


@pytest.mark.parametrize(
    ("ending", "right", "wrong"),
    [
        (end("LAW-HOLDS", ("drag_square",)), True, False),
        (end("LAW-HOLDS", ("cable",)), False, True),
        (end("LAW-HOLDS", ("drag_square", FRICTION)), False, True),
        (end("UNDECIDED", (), ("cable", "drag_square")), True, False),
        (end("UNDECIDED", (), ("cable",)), False, False),
        (end("UNDECIDED"), True, False),
    ],
)
def test_laws_that_are_known_to_be_right_are_asked_for(ending: Ending, right: bool, wrong: bool) -> None:
    assert judged(ending, "outside", ("drag",), ("drag_square", "slip_square")) == (right, wrong)
