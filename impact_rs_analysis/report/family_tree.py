# SPDX-License-Identifier: Apache-2.0
"""Page of an investigation: family tree of its models, and information gain of each round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import plotly.graph_objects as go

from impact_rs_analysis.diagnosis.verdict import NO_IMPROVEMENT, UNIDENTIFIABLE
from impact_rs_analysis.investigation.endings import UNDECIDED, Ending, ending_of
from impact_rs_analysis.investigation.rounds import Round, planned_trials
from impact_rs_analysis.investigation.settings import Settings
from impact_rs_analysis.report.figures import BLUE, RED
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.page_names import INVESTIGATION_PAGE
from impact_rs_analysis.report.plots import TEMPLATE

GREY = "#888888"


@dataclass(frozen=True)
class FamilyMember:
    """One model.

    Attributes:
        name: Its file, or the first model.
        parent: Its parent; None for the first model.
        effect: Added effect; empty for the first model.
        generation: Number of added effects since the first model.
        trials: Number of trials from which it was made.
        last: Whether it is the newest model or one of its ancestors.
    """

    name: str
    parent: str | None
    effect: str
    generation: int
    trials: int
    last: bool = False


@dataclass(frozen=True)
class RoundGain:
    """Gain from the trials of a round.

    Attributes:
        round: The round.
        total: Number of trials up to this round.
        error: Error of its model in all trials so far, in multiples of repeatability; None: not compared yet.
        predicted: Error of its model in the unseen trials of the round; None: not known.
        possible: Effects that may still be missing; None: not diagnosed yet.
    """

    round: Round
    total: int
    error: float | None
    predicted: float | None
    possible: int | None


@dataclass(frozen=True)
class InvestigationPage:
    """Content of ``investigation.html.j2``."""

    title: str
    settings: Settings
    ending: Ending | None
    undecided: bool
    family: tuple[FamilyMember, ...]
    gains: tuple[RoundGain, ...]
    plots: tuple[Plot, ...]


def write_investigation(settings: Settings, rounds: Sequence[Round], directory: Path) -> Path:
    """Write ``investigation.html``.

    Args:
        settings: Settings of the investigation.
        rounds: All rounds that have begun.
        directory: Folder of the report.

    Returns:
        The page.

    Raises:
        InputError: It cannot be written.
    """
    family, gains = family_of(settings, rounds), gains_of(rounds)
    last = rounds[-1].decision if rounds else None
    ending = ending_of(settings, rounds) if last is not None and last.action == "end" else None
    plots = [Plot("family", family_plot(family), caption="Models from parent to child; grey: replaced by a later one.")]
    if any(gain.error is not None for gain in gains):
        caption = "Error of each round's model with all trials up to then; a round that tries a new model begins lower."
        plots.append(Plot("gain", gains_plot(gains), caption=caption))
    page = InvestigationPage(
        title="Investigation",
        settings=settings,
        ending=ending,
        undecided=ending is not None and ending.verdict == UNDECIDED,
        family=tuple(family),
        gains=tuple(gains),
        plots=tuple(plots),
    )
    return write_files(directory, {INVESTIGATION_PAGE: render("investigation.html.j2", page)})[0]


def family_of(settings: Settings, rounds: Sequence[Round]) -> list[FamilyMember]:
    """All models, the first one first."""
    family = [FamilyMember(settings.model, None, "", 0, 0)]
    for count, round_ in enumerate(rounds, start=1):
        if round_.decision is None:
            continue
        parent = round_.decision.base or settings.model
        first_generation = 1 + next(member.generation for member in family if member.name == parent)
        pairs = zip(round_.decision.models, round_.decision.add, strict=True)
        for generation, (name, effect) in enumerate(pairs, start=first_generation):
            family.append(FamilyMember(name, parent, effect, generation, planned_trials(rounds[:count])))
            parent = name
    ancestors = {family[-1].name}
    for member in reversed(family):
        if member.name in ancestors and member.parent is not None:
            ancestors.add(member.parent)
    return [replace(member, last=member.name in ancestors) for member in family]


def gains_of(rounds: Sequence[Round]) -> list[RoundGain]:
    """Gain from the trials of every round."""
    gains = []
    for count, round_ in enumerate(rounds, start=1):
        basis = round_.basis
        possible = None
        if basis is not None:
            excluded = (NO_IMPROVEMENT, UNIDENTIFIABLE)
            candidates = {effect.name for effect in basis.effects if effect.measured and effect.verdict not in excluded}
            possible = len(candidates | set(basis.suspected))
        error = None if round_.comparison is None else round_.comparison.score
        predicted = None if round_.prediction_error is None else round_.prediction_error.error
        gains.append(RoundGain(round_, planned_trials(rounds[:count]), error, predicted, possible))
    return gains


def family_plot(family: Sequence[FamilyMember]) -> go.Figure:
    """The family tree: generations from left to right, later models below earlier ones."""
    height, heights = 0, dict[str, float]()
    for member in family:
        height += 1 if member.generation <= 1 and heights else 0
        heights[member.name] = float(-height if member.generation else 0)
    by_name = {member.name: member for member in family}
    traces = []
    for member in family:
        if member.parent is not None:
            parent = by_name[member.parent]
            traces.append(
                go.Scatter(
                    x=[parent.generation, member.generation],
                    y=[heights[parent.name], heights[member.name]],
                    mode="lines",
                    line={"color": BLUE if member.last else GREY},
                    hoverinfo="skip",
                    showlegend=False,
                )
            )
    traces.append(
        go.Scatter(
            x=[member.generation for member in family],
            y=[heights[member.name] for member in family],
            mode="markers+text",
            text=[f"{Path(member.name).stem}<br>{f'+ {member.effect}' if member.effect else ''}" for member in family],
            textposition="bottom center",
            marker={"size": 16, "color": [BLUE if member.last else GREY for member in family]},
            hovertext=[f"from {member.trials} trials" for member in family],
            showlegend=False,
        )
    )
    last_generation = max(member.generation for member in family)
    return go.Figure(traces, layout={"template": TEMPLATE}).update_layout(
        height=180 + 90 * len(set(heights.values())),
        xaxis={"visible": False, "range": [-0.5, last_generation + 0.5]},
        yaxis={"visible": False, "range": [min(heights.values()) - 0.8, 0.5]},
    )


def gains_plot(gains: Sequence[RoundGain]) -> go.Figure:
    """Error of every round's model over the number of trials."""
    shown = [gain for gain in gains if gain.error is not None]
    trace = go.Scatter(
        x=[gain.total for gain in shown],
        y=[gain.error for gain in shown],
        mode="lines+markers+text",
        line={"color": RED},
        text=[Path(gain.round.model).stem for gain in shown],
        textposition="top center",
        showlegend=False,
    )
    return go.Figure([trace], layout={"template": TEMPLATE}).update_layout(
        height=320,
        xaxis={"title": {"text": "trials measured"}},
        yaxis={"title": {"text": "error [× repeatability]"}, "type": "log"},
    )
