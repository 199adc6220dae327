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
    introduction = (
        f"Scenarios {', '.join(settings.scenarios)}; first model {settings.model}; trials run {settings.where}."
    )
    if settings.blind is not None:
        introduction += f" The plant hides what seed {settings.blind.seed} draws ({settings.blind.kind})."
    lines = ["# Investigation", "", introduction, ""]
    for round_ in rounds:
        lines += [f"## Round {round_.number}", "", *_round_lines(round_), ""]
    if rounds and (last := rounds[-1].decision) is not None and last.action == "end":
        end = ending_of(settings, rounds)
        lines += [f"## End: {end.verdict}", "", end.summary, "", f"{end.trials} trials in {end.rounds} rounds.", ""]
    return "\n".join(lines)


def _round_lines(round_: Round) -> Iterator[str]:
    """One line per step of a round."""
    if (plan := round_.plan) is not None:
        yield f"* Design: {plan.trials} trials. {plan.summary}".rstrip()
        for campaign in plan.campaigns:
            for condition in campaign.conditions:
                name = condition.what or f"{campaign.folder}/{condition.object}/{condition.case}"
                yield f"    * {condition.buys or f'{condition.trials} x {name}'}"
    if (prediction := round_.prediction) is not None:
        for forecast in prediction.impacts:
            yield (
                f"* Prediction of {prediction.model.name} for {forecast.condition}: "
                f"end effector {forecast.arm:+.3f} m/s, object {forecast.object:+.3f} m/s after the impact"
            )
    if (checked := round_.prediction_error) is not None:
        if checked.error is not None:
            p_words = "" if checked.p_value is None else f" ({p_in_words(checked.p_value)} if it is right)"
            yield (
                f"* Prediction error of {checked.model.name} in the {checked.trials} trials of this round: "
                f"{checked.error:.3g} {checked.unit}{p_words}"
            )
        for impact in checked.impacts:
            expected, measured_object = impact.predicted, impact.object
            tracked = (
                ""
                if measured_object is None
                else f", object {measured_object:+.3f} m/s (predicted {expected.object:+.3f})"
            )
            yield (
                f"    * {impact.condition}: measured end effector {impact.arm:+.3f} m/s (predicted {expected.arm:+.3f})"
                f"{tracked}"
            )
    if (comparison := round_.comparison) is not None:
        noise = "" if comparison.noise_floor is None else f" (noise: {comparison.noise_floor:.3g})"
        yield (
            f"* Comparison: {comparison.model.name} against {comparison.trials} trials: error {comparison.score:.3g} "
            f"× repeatability{noise}"
        )
    if round_.diagnosis is not None:
        yield f"* Diagnosis of {round_.diagnosis.model.name}: {round_.diagnosis.verdict}. {round_.diagnosis.summary}"
    if round_.again is not None:
        yield f"* It does not hold. Diagnosis of the first model: {round_.again.verdict}. {round_.again.summary}"
    if round_.discovery is not None:
        yield f"* Discovery: {round_.discovery.verdict}. {round_.discovery.summary}"
    if (decision := round_.decision) is not None:
        models = f" ({', '.join(decision.models)})" if decision.models else ""
        yield f"* Decision: {decision.action}{models}. {decision.reason}"
