# SPDX-License-Identifier: Apache-2.0
"""The story of an investigation (``log.md``)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from impact_rs_analysis.investigation.endings import ending_of
from impact_rs_analysis.investigation.error_test import p_in_words
from impact_rs_analysis.investigation.rounds import Round
from impact_rs_analysis.investigation.settings import Settings

LOG_FILE = "log.md"


def log_of(settings: Settings, rounds: Sequence[Round]) -> str:
    """The story of an investigation, in Markdown."""
    asked = f"Scenarios {', '.join(settings.scenarios)}; first model {settings.model}; trials run {settings.where}."
    if settings.blind is not None:
        asked += f" The plant hides what seed {settings.blind.seed} draws ({settings.blind.kind})."
    lines = ["# Investigation", "", asked, ""]
    for here in rounds:
        lines += [f"## Round {here.number}", "", *_round_lines(here), ""]
    if rounds and (last := rounds[-1].decision) is not None and last.action == "end":
        end = ending_of(settings, rounds)
        lines += [f"## End: {end.verdict}", "", end.summary, "", f"{end.trials} trials in {end.rounds} rounds.", ""]
    return "\n".join(lines)


def _round_lines(here: Round) -> Iterator[str]:
    """One line per step of a round."""
    if (plan := here.plan) is not None:
        yield f"* Design: {plan.trials} trials. {plan.summary}".rstrip()
        for campaign in plan.campaigns:
            for one in campaign.conditions:
                what = one.what or f"{campaign.folder}/{one.object}/{one.case}"
                yield f"    * {one.buys or f'{one.trials} x {what}'}"
    if (prediction := here.prediction) is not None:
        for forecast in prediction.impacts:
            yield (
                f"* Prediction of {prediction.model.name} for {forecast.condition}: "
                f"end effector {forecast.arm:+.3f} m/s, object {forecast.object:+.3f} m/s after the impact"
            )
    if (checked := here.prediction_error) is not None:
        if checked.error is not None:
            chance = "" if checked.p_value is None else f" ({p_in_words(checked.p_value)} if it is right)"
            yield (
                f"* Prediction error of {checked.model.name} in the {checked.trials} trials of this round: "
                f"{checked.error:.3g} {checked.unit}{chance}"
            )
        for impact in checked.impacts:
            expected, seen = impact.predicted, impact.object
            tracked = "" if seen is None else f", object {seen:+.3f} m/s (predicted {expected.object:+.3f})"
            yield (
                f"    * {impact.condition}: measured end effector {impact.arm:+.3f} m/s (predicted {expected.arm:+.3f})"
                f"{tracked}"
            )
    if (comparison := here.comparison) is not None:
        floor = "" if comparison.noise_floor is None else f" (noise: {comparison.noise_floor:.3g})"
        yield (
            f"* Comparison: {comparison.model.name} against {comparison.trials} trials: error {comparison.score:.3g} "
            f"× repeatability{floor}"
        )
    if here.diagnosis is not None:
        yield f"* Diagnosis of {here.diagnosis.model.name}: {here.diagnosis.verdict}. {here.diagnosis.summary}"
    if here.again is not None:
        yield f"* It does not hold. Diagnosis of the first model: {here.again.verdict}. {here.again.summary}"
    if here.discovery is not None:
        yield f"* Discovery: {here.discovery.verdict}. {here.discovery.summary}"
    if (decision := here.decision) is not None:
        made = f" ({', '.join(decision.models)})" if decision.models else ""
        yield f"* Decision: {decision.action}{made}. {decision.reason}"
