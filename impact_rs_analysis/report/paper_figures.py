# SPDX-License-Identifier: Apache-2.0
"""Page of the published experiment: mismatch that a motor-inertia scale explains."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_rs_analysis.measure.paper import ROTOR_SCALE, SCALE_GRID, PaperResult, PaperStudy
from impact_rs_analysis.report.figures import BLACK, BLUE, RED, Curve, Figure, Note, Panel
from impact_rs_analysis.report.page import Plot, render, write_files
from impact_rs_analysis.report.plots import curves_plot
from impact_rs_analysis.report.png import write_png
from impact_rs_sim.files import whole_folder
from impact_rs_sim.numbers import estimate_in_line


@dataclass(frozen=True)
class PaperPage:
    """Content of ``paper.html.j2``.

    Attributes:
        title: Heading.
        answer: Result in a sentence.
        scale: Motor-inertia scale of the fit to all rows [-].
        plot: Mismatch over the scale.
        rows: Published rows with their mismatch at the scale [%].
    """

    title: str
    answer: str
    scale: float
    plot: Plot
    rows: tuple[tuple[PaperResult, float], ...]


def paper_figure(study: PaperStudy) -> Figure:
    """Mean absolute mismatch over the scale, for all rows and for each scenario."""
    colours = {"all rows": BLACK, "push": BLUE, "grab": RED}
    groups = {"all rows": list(study.results)}
    for name in study.by_scenario:
        groups[name] = [result for result in study.results if result.scenario == name]
    fits = {"all rows": study.all_rows, **study.by_scenario}
    curves = []
    for name, results in groups.items():
        fit = fits[name]
        error = np.abs([result.mismatch(SCALE_GRID[::10]) for result in results]).mean(axis=0)
        low, high = fit.interval
        colour = colours.get(name, BLACK)
        curves.append(Curve("", SCALE_GRID[::10], error, colour))
        curves.append(
            Curve(
                f"{name}: {estimate_in_line(fit.scale, fit.interval, least=2)}, "
                f"{fit.error_nominal:.2f} % → {fit.error_fitted:.2f} %",
                np.array([fit.scale]), np.array([fit.error_fitted]), colour, line="none", marker="circle",
                error=(max(fit.scale - low, 0.0), max(high - fit.scale, 0.0)),
            )
        )  # fmt: skip
    return Figure(
        name="paper_motor_inertia",
        title="Published experiment: how much a motor-inertia scale explains",
        caption=study.sentence[0].upper() + study.sentence[1:] + ".",
        x_label="motor-inertia scale s, B = s B<sub>θ</sub> [-]",
        panels=(Panel("mean absolute mismatch [%]", tuple(curves)),),
        notes=(Note(0.0, "B = 0"), Note(1.0, "B<sub>θ</sub>"), Note(ROTOR_SCALE, "B<sub>ρ</sub>")),
        x_range=(-0.05, ROTOR_SCALE + 0.05),
    )


def write_paper(study: PaperStudy, directory: Path) -> list[Path]:
    """Write the figure as PNG and as HTML, with the table.

    Returns:
        The page, the numbers and the PNG.

    Raises:
        InputError: The folder cannot be written.
    """
    figure = paper_figure(study)
    page = PaperPage(
        title="The published experiment as a measurement",
        answer=figure.caption,
        scale=study.all_rows.scale,
        plot=Plot(figure.name, curves_plot(figure), zoom=True),
        rows=tuple(zip(study.results, study.fitted.tolist(), strict=True)),
    )
    data = json.dumps(study.to_json(), indent=2) + "\n"
    with whole_folder(directory) as aside:
        written = write_files(aside, {"paper.html": render("paper.html.j2", page), "paper.json": data})
        written.append(write_png(figure, aside / f"{figure.name}.png"))
    return [directory / file.name for file in written]
