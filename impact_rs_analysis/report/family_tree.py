# SPDX-License-Identifier: Apache-2.0
"""Page of an investigation: family tree of its models, and information gain of each round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import plotly.graph_objects as go

from impact_rs_analysis.diagnosis.verdict import NO_IMPROVEMENT, UNIDENTIFIABLE
from impact_rs_analysis.investigation.endings import UNDECIDED, Ending, ending_of
from impact_rs_analysis.investigation.rounds import Round, measured
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
        parent: Its parent; None: it is the first.
        effect: Effect that it adds; empty: none.
        generation: Models between it and the first one, itself included.
        trials: Trials that it was made from.
        last: Whether it is the newest one.
    """

    name: str
    parent: str | None
    effect: str
    generation: int
    trials: int
    last: bool = False


@dataclass(frozen=True)
class Bought:
    """Gain from the trials of a round.

    Attributes:
        round: The round.
        total: Trials up to it.
        error: Error of its model with all trials, in multiples of repeatability; None: not compared yet.
        predicted: Error of its model in the trials of the round alone, which it had not seen; None: not known.
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
    bought: tuple[Bought, ...]
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
    family, bought = family_of(settings, rounds), bought_of(rounds)
    last = rounds[-1].decision if rounds else None
    ending = ending_of(settings, rounds) if last is not None and last.action == "end" else None
    plots = [Plot("family", family_plot(family), caption="Models from parent to child; grey: replaced by a later one.")]
    if any(one.error is not None for one in bought):
        caption = "Error of each round's model with all trials up to then; a round that tries a new model begins lower."
        plots.append(Plot("bought", bought_plot(bought), caption=caption))
    page = InvestigationPage(
        title="Investigation",
        settings=settings,
        ending=ending,
        undecided=ending is not None and ending.verdict == UNDECIDED,
        family=tuple(family),
        bought=tuple(bought),
        plots=tuple(plots),
    )
    return write_files(directory, {INVESTIGATION_PAGE: render("investigation.html.j2", page)})[0]


def family_of(settings: Settings, rounds: Sequence[Round]) -> list[FamilyMember]:
    """All models, the first one first."""
    found = [FamilyMember(settings.model, None, "", 0, 0)]
    for number, here in enumerate(rounds, start=1):
        if here.decision is None:
            continue
        parent = here.decision.base or settings.model
        first = 1 + next(one.generation for one in found if one.name == parent)
        pairs = zip(here.decision.models, here.decision.add, strict=True)
        for generation, (name, effect) in enumerate(pairs, start=first):
            found.append(FamilyMember(name, parent, effect, generation, measured(rounds[:number])))
            parent = name
    newest = {found[-1].name}
    for one in reversed(found):
        if one.name in newest and one.parent is not None:
            newest.add(one.parent)
    return [FamilyMember(**{**vars(one), "last": one.name in newest}) for one in found]


def bought_of(rounds: Sequence[Round]) -> list[Bought]:
    """Gain from the trials of every round."""
    found = []
    for number, here in enumerate(rounds, start=1):
        basis = here.basis
        possible = None
        if basis is not None:
            out = (NO_IMPROVEMENT, UNIDENTIFIABLE)
            left = {effect.name for effect in basis.effects if effect.measured and effect.verdict not in out}
            possible = len(left | set(basis.suspected))
        error = None if here.comparison is None else here.comparison.score
        predicted = None if here.prediction_error is None else here.prediction_error.error
        found.append(Bought(here, measured(rounds[:number]), error, predicted, possible))
    return found


def family_plot(family: Sequence[FamilyMember]) -> go.Figure:
    """The family tree: generations to the right, later models further down."""
    row, rows = 0, dict[str, float]()
    for one in family:
        row += 1 if one.generation <= 1 and rows else 0
        rows[one.name] = float(-row if one.generation else 0)
    known = {one.name: one for one in family}
    traces = []
    for one in family:
        if one.parent is not None:
            before = known[one.parent]
            traces.append(
                go.Scatter(
                    x=[before.generation, one.generation],
                    y=[rows[before.name], rows[one.name]],
                    mode="lines",
                    line={"color": BLUE if one.last else GREY},
                    hoverinfo="skip",
                    showlegend=False,
                )
            )
    traces.append(
        go.Scatter(
            x=[one.generation for one in family],
            y=[rows[one.name] for one in family],
            mode="markers+text",
            text=[f"{Path(one.name).stem}<br>{f'+ {one.effect}' if one.effect else ''}" for one in family],
            textposition="bottom center",
            marker={"size": 16, "color": [BLUE if one.last else GREY for one in family]},
            hovertext=[f"from {one.trials} trials" for one in family],
            showlegend=False,
        )
    )
    most = max(one.generation for one in family)
    return go.Figure(traces, layout={"template": TEMPLATE}).update_layout(
        height=180 + 90 * len(set(rows.values())),
        xaxis={"visible": False, "range": [-0.5, most + 0.5]},
        yaxis={"visible": False, "range": [min(rows.values()) - 0.8, 0.5]},
    )


def bought_plot(bought: Sequence[Bought]) -> go.Figure:
    """Error of the present model, and effects that may be missing, over the trials."""
    shown = [one for one in bought if one.error is not None]
    trace = go.Scatter(
        x=[one.total for one in shown],
        y=[one.error for one in shown],
        mode="lines+markers+text",
        line={"color": RED},
        text=[Path(one.round.model).stem for one in shown],
        textposition="top center",
        showlegend=False,
    )
    return go.Figure([trace], layout={"template": TEMPLATE}).update_layout(
        height=320,
        xaxis={"title": {"text": "trials measured"}},
        yaxis={"title": {"text": "error [× repeatability]"}, "type": "log"},
    )
