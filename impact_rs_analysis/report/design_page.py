# SPDX-License-Identifier: Apache-2.0
"""Page and table of a design study: measures and ranks of all designs."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import plotly.graph_objects as go

from impact_rs_analysis.measure.design_study import MEASURES, Design, DesignStudy
from impact_rs_analysis.report.figures import SERIES_COLOURS
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.page_names import DESIGN_STUDY_PAGE, DESIGNS_TABLE
from impact_rs_analysis.report.plots import TEMPLATE
from impact_rs_sim.numbers import CONFIDENCE_LEVEL

MAX_TABLE_DESIGNS = 15  # designs of a table
SYMBOLS = ("circle", "diamond", "square", "cross", "x")


@dataclass(frozen=True)
class DesignPage:
    """Content of ``design_study.html.j2``.

    Attributes:
        title: Heading.
        summary: Conditions of the study in a sentence.
        plots: The figures.
        tables: By measure: its label with unit, and rows of design, value, interval and ranks.
        failed: Designs without an answer, with the reason.
    """

    title: str
    summary: str
    plots: tuple[Plot, ...]
    tables: dict[str, list[tuple[str, ...]]]
    failed: dict[str, str]


def write_design_study(study: DesignStudy, directory: Path) -> Path:
    """Write ``design_study.html`` and ``designs.csv``, a row per design.

    Returns:
        The page.

    Raises:
        InputError: They cannot be written.
    """
    conditions = study.conditions
    robots = list(dict.fromkeys(design.robot for design in study.designs))
    page = DesignPage(
        title="Design study",
        summary=f"{len(study.designs)} designs of {len(robots)} robots hit {conditions.object_name} of "
        f"{conditions.scenario.name} at {conditions.speed:g} m/s, square and free of support. "
        f"Intervals of {CONFIDENCE_LEVEL:.0%}: "
        f"{conditions.draws} draws from the uncertainties of the scenario. Poses are random.",
        plots=(
            Plot(
                "hits",
                _hits(study, robots),
                caption="Each point is a design: colour is the robot, form the pad; open: B<sub>θ</sub>, filled: "
                "B<sub>ρ</sub>. Further up it hits harder, further left the joints bear it better.",
                zoom=True,
            ),
            Plot(
                "sensitivity",
                _sensitivity(study, robots),
                caption="By how many percent the object is faster for one percent more motor inertia in all joints. "
                "A pose with a large value shows which motor inertia a robot has.",
            ),
        ),
        tables={
            f"{measure.label} [{measure.unit}]": [
                (design.name, *_texts(design, name), f"{best} to {worst}")
                for design, best, worst in study.ranked(name)[:MAX_TABLE_DESIGNS]
            ]
            for name, measure in MEASURES.items()
        },
        failed=dict(study.failed),
    )
    files = {DESIGN_STUDY_PAGE: render("design_study.html.j2", page), DESIGNS_TABLE: design_table(study)}
    return write_files(directory, files)[0]


def design_table(study: DesignStudy) -> str:
    """All designs as CSV: value, interval and ranks of every measure; headers are name and unit."""
    ranks = {
        name: {design.name: (number, best, worst) for number, (design, best, worst) in enumerate(study.ranked(name), 1)}
        for name in MEASURES
    }
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    head = ["robot", "pose", "motor_inertia", "pad", "joint_positions [rad, m]"]
    for name, measure in MEASURES.items():
        head += [f"{name}{end} [{measure.unit}]" for end in ("", "_low", "_high")]
        head += [f"{name}_rank{end}" for end in ("", "_best", "_worst")]
    writer.writerow(head)
    for design in study.designs:
        row: list[object] = [design.robot, design.pose, design.motor_inertia, design.pad]
        row.append(" ".join(f"{value:.6g}" for value in design.position))
        for name in MEASURES:
            estimate = design.measures[name]
            row += [f"{value:.6g}" for value in (estimate.value, estimate.low, estimate.high)]
            row += [*ranks[name][design.name]]
        writer.writerow(row)
    return text.getvalue()


def _texts(design: Design, measure: str) -> tuple[str, str]:
    estimate = design.measures[measure]
    return f"{estimate.value:.3g}", f"[{estimate.low:.3g}, {estimate.high:.3g}]"


def _hits(study: DesignStudy, robots: list[str]) -> go.Figure:
    """Impulse over joint jump."""
    traces = []
    for number, robot in enumerate(robots):
        designs = [design for design in study.designs if design.robot == robot]
        pads = list(study.conditions.pads)
        symbols = [
            SYMBOLS[pads.index(design.pad) % len(SYMBOLS)] + ("-open" if design.motor_inertia == "reduced" else "")
            for design in designs
        ]
        traces.append(
            go.Scatter(
                x=[round(design.measures["joint_jump"].value, 5) for design in designs],
                y=[round(design.measures["impulse"].value, 5) for design in designs],
                text=[design.name for design in designs],
                mode="markers",
                marker={"color": SERIES_COLOURS[number % len(SERIES_COLOURS)], "symbol": symbols, "size": 6},
                name=robot,
            )
        )
    figure = go.Figure(traces, layout={"template": TEMPLATE})
    return figure.update_layout(
        height=520,
        xaxis={"title": {"text": "largest joint jump over the joint's velocity limit [-]"}},
        yaxis={"title": {"text": "impulse on the object [N s]"}},
    )


def _sensitivity(study: DesignStudy, robots: list[str]) -> go.Figure:
    """Sensitivities by robot and motor inertia."""
    traces = []
    for number, kind in enumerate(study.conditions.motor_inertias):
        designs = [design for design in study.designs if design.motor_inertia == kind]
        traces.append(
            go.Box(
                x=[design.robot for design in designs],
                y=[round(design.measures["sensitivity"].value, 6) for design in designs],
                name={"reduced": "B_theta", "rotor": "B_rho"}[kind],
                marker={"color": SERIES_COLOURS[number]},
                boxpoints=False,
            )
        )
    figure = go.Figure(traces, layout={"template": TEMPLATE})
    return figure.update_layout(
        height=380,
        boxmode="group",
        xaxis={"title": {"text": "robot"}, "categoryorder": "array", "categoryarray": robots},
        yaxis={"title": {"text": "sensitivity to motor inertia [-]"}},
    )
