# SPDX-License-Identifier: Apache-2.0
"""Documents of hits and changes: messages of the node ``identify`` and ``impact-rs follow --json``."""

from __future__ import annotations

from pydantic import Field

from impact_rs_sim.schema import Schema


class Predicted(Schema):
    """One predicted number of the next hit."""

    signal: str = Field(description="name of the signal")
    index: str = Field(description="joint or axis")
    phase: str = Field(description="phase of the motion")
    bin: int = Field(0, description="time bin within the phase")
    value: float = Field(description="predicted, in the unit")
    ci95: tuple[float, float] = Field(description="95 % interval of what will be measured, in the unit")
    unit: str = Field(description="unit")


class NextHit(Schema):
    """Prediction of the next hit of a condition from the initial state of the last one."""

    condition: str = Field(description="condition; empty: the condition of the last hit")
    like: str = Field(description="hit whose start it is")
    values: tuple[Predicted, ...] = Field(description="predicted numbers")


class Followed(Schema):
    """Believed value of a parameter."""

    parameter: str = Field(description="EFFECT.PARAMETER")
    estimate: float = Field(description="believed value, in the unit")
    ci95: tuple[float, float] = Field(description="95 % interval, in the unit")
    change: float = Field(description="change against the value before, in the unit")
    unit: str = Field(description="unit")


class PublishedPrediction(NextHit):
    """Message of ``identify/prediction``."""

    followed: tuple[Followed, ...] = Field(description="believed parameters")


class Cause(Schema):
    """One explanation of a change."""

    effect: str = Field(description="name of the effect; empty: none of the library")
    share: float = Field(description="probability among the explanations that are named")
    since: str = Field(description="first hit after the change")
    parameters: tuple[Followed, ...] = Field(description="its parameters that moved")
    words: str = Field(description="the explanation in words")


class Change(Schema):
    """A change of the cell."""

    hit: str = Field(description="hit at which it was found")
    since: str = Field(description="first hit after the change, by the likeliest explanation")
    since_time: float | None = Field(None, description="when that was, seconds since 1970; null: not known")
    hits: int = Field(description="hits since then")
    log10_ratio: float = Field(description="evidence: decimal logarithm of the likelihood ratio against no change")
    false_alarm: float = Field(description="mean number of hits to a false alarm at this evidence, at least")
    causes: tuple[Cause, ...] = Field(description="explanations, the likeliest first")
    again: bool = Field(False, description="whether the likeliest effect was announced before: it drifts")
    instead: str = Field("", description="effect that was named for the same hits before; empty: it is a new change")
    apart: str = Field("", description="what decides between the explanations")
    words: str = Field(description="the change in a sentence")


class PublishedChange(Change):
    """Message of ``identify/change``."""

    diagnose: str = Field(description="command of the full diagnosis")


class RefusedHit(Schema):
    """A measurement without a usable hit: message of ``identify/refused``."""

    hit: str = Field(description="bag or row; empty: the look itself failed")
    reason: str = Field(description="why")


class HitDocument(Schema):
    """Result of one hit."""

    name: str = Field(description="the hit")
    stamp: float = Field(description="its time [s], or the number of its row")
    condition: str = Field(description="its condition; empty: it repeats nothing")
    error: float | None = Field(None, description="prediction error before the hit was seen, in multiples of its "
                                "standard deviation (rms over features); null while the scatter is learnt")  # fmt: skip
    of_model: float | None = Field(None, description="prediction error of the given model; null while it is learnt")
    evidence: float | None = Field(None, description="log10 of the statistic of the test; null while it is learnt")
    odd: bool = Field(False, description="whether the hit is beyond what 999 of 1,000 do, and weighs less")
    change: Change | None = Field(None, description="change that this hit confirms; null: none")
    resolved: str = Field("", description="explanation that hits have ruled in; empty: none at this hit")
    milliseconds: float = Field(0.0, description="time that its update took [ms]")


class ChangeDiagnosis(Schema):
    """Full diagnosis that the last change called for."""

    command: str = Field(description="the command that makes it")
    file: str = Field(description="its file")
    verdict: str = Field("", description="its verdict; empty: it has not ended well")
    words: str = Field(description="how it ended, in words")


class FollowDocument(Schema):
    """All of ``impact-rs follow --json``."""

    model: str = Field(description="name of the model")
    hits: tuple[HitDocument, ...] = Field(description="hits, in time order")
    followed: tuple[Followed, ...] = Field(description="believed parameters after the last hit")
    prediction: NextHit | None = Field(description="of the next hit; null while the scatter is learnt")
    diagnosis: ChangeDiagnosis | None = Field(None, description="full diagnosis of the hits since the last change; "
                                              "null: there is none")  # fmt: skip
    skipped: dict[str, str] = Field(description="what gave no hit, and why")
