# SPDX-License-Identifier: Apache-2.0
"""The summary never contradicts the tables: of random documents, and of diagnoses of random worlds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from analytic_world import EFFECTS, AnalyticSource, knowing
from contradictions import contradictions
from hypothesis import given, settings
from hypothesis import strategies as st

from impact_rs_analysis.diagnosis.dependence_verdicts import _scaled
from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.diagnosis.document import (
    BudgetDocument,
    DiagnosisDocument,
    EffectDocument,
    EstimateDocument,
    JointError,
    ModelIdentity,
    ResidualDocument,
    RunsIdentity,
    SizeDocument,
    UnexplainedDocument,
    ViewDocument,
    explained,
)
from impact_rs_analysis.diagnosis.verdict import (
    AT_BOUND,
    CONFIRMED,
    NO_IMPROVEMENT,
    NONE,
    NOTHING,
    DiagnosisVerdict,
    Kind,
)
from impact_rs_analysis.diagnosis.verdicts.words import (
    _change,
    not_excluded,
    not_tried,
    remaining,
    shown_unnamed,
    summary_of,
)
from impact_rs_analysis.evidence.cluster import TIMES, Added
from impact_rs_sim.numbers import estimate_in_line

NAMES = ("friction", "offset", "restitution", "payload")


@st.composite
def effects(draw: st.DrawFn, named: tuple[str, ...], before: float) -> tuple[EffectDocument, ...]:
    """One row for every name, the named ones confirmed or at a bound."""
    found = []
    for name in NAMES:
        bound = name in named and draw(st.booleans())
        own = draw(st.floats(-5.0, 5.0).filter(lambda value: abs(value) > 0.1))
        half = abs(own) * draw(st.floats(0.01, 0.9))
        estimate = EstimateDocument(
            estimate=own, ci95=(own - half, own + half), unit=draw(st.sampled_from(["-", "N m"])), nominal=0.0,
            range=(-5.0, 5.0), at_bound=bound,
        )  # fmt: skip
        limit = draw(st.floats(1e-3, 1.0))
        found.append(
            EffectDocument(
                name=name,
                of_measurement=draw(st.booleans()),
                verdict=AT_BOUND if bound else CONFIRMED if name in named else NO_IMPROVEMENT,
                reason="" if name in named else draw(st.sampled_from(["it hardly lowers the error"])),
                parameters={"size": estimate},
                held_out_error_before=before,
                held_out_error_after=before * draw(st.floats(0.5, 0.99)),
                held_out_error_others=before,
                p_value=draw(st.sampled_from([0.0005, 0.02, 0.6])),
                sizes=(SizeDocument(phase="push", signal="velocity", value=0.5 * limit, unit="m/s", floor=limit),),
            )
        )
    return tuple(found)


@st.composite
def documents(draw: st.DrawFn) -> DiagnosisDocument:
    """Documents that a diagnosis may make: named effects lower the error beyond doubt, by however little."""
    kind = draw(st.sampled_from([Kind.NOTHING, Kind.NONE, Kind.SMALL, Kind.PARTLY, Kind.NAMED]))
    source, unit = draw(st.sampled_from([("trials", TIMES), ("recordings", "N m"), ("impacts", "m/s")]))
    noise = 1.0 if unit == TIMES else draw(st.sampled_from([0.0, 0.0123]))
    named = draw(st.lists(st.sampled_from(NAMES), unique=True, min_size=1).map(tuple))
    named = () if kind is Kind.NOTHING or (kind in (Kind.NONE, Kind.SMALL) and draw(st.booleans())) else named
    before = draw(st.floats(1.05, 500.0)) * (noise or 1.0)
    lowest, highest = {Kind.NONE: (1e-6, 0.49), Kind.PARTLY: (0.5, 0.999)}.get(kind, (1e-6, 0.999))
    share = draw(st.floats(lowest, highest)) if named else 0.0
    after = float(np.sqrt(before**2 - share * (before**2 - noise**2)))
    rests = [
        ResidualDocument(phase="push", signal="force", index=axis, value=draw(st.floats(0.0, 2.0)), unit="N",
                     floor=1.0, share=0.1, times_noise=2.0)
        for axis in "xyz"
    ]  # fmt: skip
    confusable = ((named[0], "spring"),) if named and draw(st.booleans()) else ()
    views = []
    for name, option in (("joints", ""), ("object", ""), ("points within 4 mm", "--contact-tolerance")):
        own = draw(st.lists(st.sampled_from(NAMES), unique=True).map(tuple))
        verdict = DiagnosisVerdict(Kind.NAMED, own) if own else draw(st.sampled_from([NOTHING, NONE]))
        views.append(
            ViewDocument(
                name=name, option=option, verdict=verdict, named=own, held_out_error_before=before,
                held_out_error_after=before * (draw(st.floats(0.1, 0.9999)) if own else 1.0),
            )
        )  # fmt: skip
    document = DiagnosisDocument(
        source=source,
        verdict=DiagnosisVerdict(kind, named if kind in (Kind.PARTLY, Kind.NAMED) else ()),
        named=named,
        effects=draw(effects(named, before)),
        confusable=confusable,
        unexplained=UnexplainedDocument(where=tuple(rests)),
        model=ModelIdentity(name="nominal", digest=""),
        runs=RunsIdentity(digest="", trials=12, conditions=()),
        error_unit=unit,
        noise_floor=noise,
        held_out_error_before=before,
        held_out_error_after=after,
        held_out_change_ci95=(after - before - 0.1, -1e-9),
        views=tuple(views) if source == "impacts" else (),
    )
    return document.model_copy(update={"summary": summary_of(document)})


@pytest.mark.parametrize("examples", [80, pytest.param(400, marks=pytest.mark.slow)])
def test_the_summary_of_a_random_document_contradicts_nothing(examples: int) -> None:
    @settings(max_examples=examples, deadline=None, derandomize=True, database=None)
    @given(documents())
    def check(document: DiagnosisDocument) -> None:
        assert contradictions(document) == [], document.summary
        assert "  " not in document.summary and document.summary.endswith(".")

    check()


def test_a_contradiction_is_seen() -> None:
    """Sentences of former versions."""
    document = DiagnosisDocument(
        verdict="friction", named=("friction",), effects=(), confusable=(), noise_floor=1.0,
        summary="Model 'nominal' lacks friction. Held-out error: 1.52 → 1.63 × repeatability.",
        model=ModelIdentity(name="nominal", digest=""), runs=RunsIdentity(digest="", trials=12, conditions=()),
        held_out_error_before=1.52, held_out_error_after=1.63, held_out_change_ci95=(-0.1, 0.3),
    )  # fmt: skip
    found = contradictions(document)
    assert any("falls from 1.52 to 1.63" in text for text in found)
    assert any("the error does not fall" in text for text in found)
    assert any("has no row" in text for text in found)
    without_repeats = document.model_copy(update={"error_unit": "N m", "held_out_error_after": 1.4})
    assert any("the error may change by 0.3" in text for text in contradictions(without_repeats))


def test_what_the_hold_out_does_not_support_is_suspected() -> None:
    source = AnalyticSource(1)
    nothing = diagnose(source, source.model).model_copy(update={"verdict": NOTHING, "named": ()})
    assert "show nothing missing in model" in summary_of(nothing) and "straight" not in summary_of(nothing)
    doubtful = summary_of(nothing.model_copy(update={"suspected": ("straight",)}))
    assert "for certain. straight may be missing" in doubtful and "More conditions decide" in doubtful
    unexplained = nothing.model_copy(update={"verdict": NONE, "suspected": ("straight",)})
    assert "explains why for certain. straight may be missing" in summary_of(unexplained)


def test_an_interval_beyond_zero_is_not_said_to_leave_an_effect_possible() -> None:
    """Of two effects that are not named, one is shown by its interval, the other may or may not be there."""
    effects = tuple(
        EffectDocument(
            name=name,
            verdict=NO_IMPROVEMENT,
            parameters={"size": EstimateDocument(estimate=2.0, ci95=(low, 4.0), unit="N m", nominal=0.0, scale=1.0)},
            held_out_error_before=2.0,
            held_out_error_after=1.9,
            p_value=0.5,
        )
        for name, low in (("friction", 1.0), ("offset", -1.0))
    )
    document = DiagnosisDocument(
        verdict=NOTHING,
        effects=effects,
        confusable=(),
        model=ModelIdentity(name="m", digest=""),
        runs=RunsIdentity(digest="", trials=6, conditions=()),
        noise_floor=1.0,
        held_out_error_before=2.0,
        held_out_error_after=2.0,
    )
    assert not_excluded(document) == "offset (size -1 to 4 N m)"
    assert shown_unnamed(document) == "friction (size 1 to 4 N m)"


@pytest.mark.parametrize(("named", "depends"), [((), True), (("pad",), True), (("mass",), False)])
def test_a_verdict_that_depends_on_an_assumption_says_so(named: tuple[str, ...], depends: bool) -> None:
    view = ViewDocument(
        name="contacts at the corners", option="estimate", named=("mass",),
        verdict=DiagnosisVerdict(Kind.NAMED, ("mass",)), held_out_error_before=1.83, held_out_error_after=0.845,
    )  # fmt: skip
    source = AnalyticSource(1)
    document = diagnose(source, source.model)
    verdict = DiagnosisVerdict(Kind.NAMED, named) if named else NOTHING
    summary = summary_of(
        document.model_copy(update={"verdict": verdict, "named": named, "views": (view,), "held_out_error_after": 2.0})
    )
    assert ("with contacts at the corners it is mass, 1.83 → 0.845 (estimate)." in summary) is depends
    assert ("The data prefer this assumption: held-out error 2 → 0.845" in summary) is depends
    near = document.model_copy(update={"named": ("pad",), "views": (view,), "held_out_error_after": 0.9})
    assert "it is mass" in summary_of(near) and "prefer" not in summary_of(near)


def test_shares_are_those_of_squared_errors_beyond_noise() -> None:
    assert explained(2.0, 1.0, 1.0) == 1.0
    assert explained(2.0, 2.0, 1.0) == 0.0
    assert explained(2.0, 3.0, 1.0) < 0.0
    assert explained(2.0, 1.0, 0.0) == pytest.approx(0.75)


@pytest.mark.parametrize(("before", "after"), [(0.9, 0.8), (0.8, 0.9), (1.0, 1.1), (1e5, 1e200)])
def test_of_an_error_within_noise_nothing_is_left_to_explain(before: float, after: float) -> None:
    """Kills: a share of an excess of 1e-300, which is 1e299 with either sign or overflows."""
    assert explained(before, after, max(before, 1.0)) == 1.0


HIDDEN = [
    (),
    (("straight", (0.4,)),),
    (("straight", (1.2,)), ("bent", (0.5,))),
    (("outside", (2.0,)), ("straight", (0.7,))),
    (("payload", (1.0, 0.7)),),
    (("of_joints", (0.6, 0.0, 0.3, 0.0, 0.0, 1.0, 0.0)),),
    (("one_sided", (2.0,)), ("outside", (0.5,))),
]


@pytest.mark.parametrize(
    ("design", "seeds"),
    [
        ((2, 2, 2), range(1)),
        *(pytest.param(design, range(3), marks=pytest.mark.slow) for design in ((2, 2, 2), (3, 3, 3), (2,) * 6)),
    ],
)
@pytest.mark.parametrize("hidden", HIDDEN, ids=str)
def test_a_diagnosis_contradicts_nothing(hidden: Added, design: tuple[int, ...], seeds: Sequence[int]) -> None:
    """Faint effects in few conditions, where hold-out, p values and intervals are most likely to disagree."""
    for seed in seeds:
        source = AnalyticSource(seed, hidden, design)
        knowing(source, *(EFFECTS[name] for name in ("straight", "bent", "payload", "of_joints", "one_sided")))
        document = diagnose(source, source.model)
        assert contradictions(document) == [], (seed, document.summary)


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (-0.01, "Nothing is left beyond noise."),
        (0.004, "Nothing is left beyond noise."),
        (0.07, "7 % of the error beyond noise remains."),
        (1.2, "All of the error beyond noise remains."),
        (None, ""),
    ],
)
def test_no_negative_share_of_the_error_remains(share: float | None, text: str) -> None:
    source = AnalyticSource(1)
    document = diagnose(source, source.model).model_copy(update={"held_out_error_before": 2.0, "noise_floor": 1.0})
    left = document.unexplained.model_copy(update={"share_of_excess": share})
    assert remaining(document.model_copy(update={"unexplained": left})) == text


@pytest.mark.parametrize(("after", "text"), [(1.04, "nearly all of the error"), (3.0, "99 % of the error")])
def test_at_least_one_more_effect_is_not_missing_beside_100_percent(after: float, text: str) -> None:
    source = AnalyticSource(1, (("straight", (4.0,)),))
    partly = {"verdict": DiagnosisVerdict(Kind.PARTLY, ("straight",)), "named": ("straight",), "noise_floor": 1.0}
    update = partly | {"held_out_error_before": 25.9, "held_out_error_after": after}
    document = diagnose(source, source.model).model_copy(update=update)
    assert f"which explains {text} beyond noise, and at least one more effect." in summary_of(document)


def residual(signal: str, index: str, value: float, unit: str, times_noise: float) -> ResidualDocument:
    return ResidualDocument(
        phase="free",
        signal=signal,
        index=index,
        value=value,
        unit=unit,
        share=1.0 / times_noise,
        times_noise=times_noise,
    )


def recording(*residuals: ResidualDocument) -> DiagnosisDocument:
    """A diagnosis of recordings with an effect that leaves these residuals."""
    source = AnalyticSource(1, (("straight", (4.0,)),))
    update = {
        "verdict": DiagnosisVerdict(Kind.PARTLY, ("straight",)),
        "named": ("straight",),
        "error_unit": "N m",
        "joints": (JointError(joint="joint1", before=1.1, after=0.022, noise=0.049, unit="N m"),),
        "unexplained": UnexplainedDocument(where=residuals),
    }
    return diagnose(source, source.model).model_copy(update=update)


def test_the_largest_residual_of_a_recording_is_that_of_the_signal_that_exceeds_its_noise_most() -> None:
    """Kills: the joint with the largest torque error, and torques by phase, of which a document has the first alone."""
    velocities = [
        residual("velocity of positions", "joint2", 0.0063, "rad/s", 1.8),
        residual("velocity of positions", "joint3", 0.0086, "rad/s", 2.13),
    ]
    torque = residual("torque", "joint2", 0.5, "N m", 3.0)
    assert "Largest residual: 0.0086 rad/s in the velocity of positions of joint3, 2.1 times its noise." in summary_of(
        recording(torque, *velocities)
    )
    assert "No residual exceeds its noise." in summary_of(recording(torque))
    loud = JointError(joint="joint2", before=1.1, after=0.03, noise=0.005, unit="N m")
    quiet = JointError(joint="joint1", before=1.1, after=0.3, noise=0.2, unit="N m")
    document = recording(*velocities).model_copy(update={"joints": (quiet, loud)})
    assert "Largest residual: 0.03 N m in the torque of joint2, 6 times its noise." in summary_of(document)


@pytest.mark.parametrize(("limit", "text"), [(3600.0, "3600 s"), (12.5, "12.5 s")])
def test_the_processor_time_has_no_exponent(limit: float, text: str) -> None:
    """Kills: "3.6e+03 s"."""
    assert f"the processor time of {text} was spent" in not_tried(BudgetDocument(limit=limit, left_out=("a",)))


@pytest.mark.parametrize("per", ["K", "m/s", "belt_speed"])
@pytest.mark.parametrize(("unit", "text"), [("-", ""), ("N m", " N m"), ("N m s/rad", " N m s/rad")])
def test_a_change_is_per_unit_of_its_covariate(unit: str, text: str, per: str) -> None:
    """Kills: a unit split at its last stroke, as "1/m per s"."""
    change = _scaled(EstimateDocument(estimate=0.2, ci95=(0.1, 0.3), unit=unit, meaning="a"), 1.0, per)
    assert _change(change, per) == f"+{estimate_in_line(0.2, (0.1, 0.3))}{text} per {per}"
    assert change.unit == f"{'1' if unit == '-' else unit}/{'(m/s)' if per == 'm/s' else per}"
